//! What the Traffic page shows: captured frames, statistics of identifiers and calls, until the moment
//! that is shown.
//!
//! Inputs: the capture, the statistics, the filter and the selection of the page. Does not know how they
//! are drawn.

use super::capture::{
    CallPart, CallStats, Calls, CapturedHeartbeats, FrameStore, IdentifierStats, Identifiers,
    StatisticsCount, Traffic, Transfer,
};
use super::filter::{Filter, FrameMatcher};
use super::view::{EvidenceView, Page};
use super::{App, EvidenceItem};
use crate::frame::{BusIndex, Frame};
use crate::wire::id::Address;
use std::collections::BTreeMap;

impl App {
    /// The captured frames.
    pub fn capture(&self) -> &FrameStore {
        &self.traffic.capture
    }

    /// Statistics of the frames of each identifier.
    pub fn identifiers(&self) -> &Identifiers {
        let past = self.past.as_ref().and_then(|past| past.statistics.as_ref());
        past.map_or(&self.traffic.identifiers, |count| &count.statistics().identifiers)
    }

    /// Numbers of the frames on `height` lines, oldest first, and the selected one.
    pub fn frames_shown(&self, height: usize) -> (Vec<u64>, Option<u64>) {
        self.traffic.shown(&self.view, height)
    }

    /// Number of frames that the filter of the Traffic page hides; `None` without one, and until all
    /// frames are tested.
    pub fn hidden_frames(&self) -> Option<u64> {
        self.traffic.hidden(&self.view, u64::MAX).filter(|_| self.filter_due.is_none())
    }

    /// Returns true if only some of the DEBUG messages are shown, because there are many: there is no
    /// filter.
    pub fn is_debug_limited(&self) -> bool {
        self.traffic.is_debug_limited(&self.view)
    }

    /// The same as [`Self::hidden_frames`], of the frames until the moment that is shown.
    pub fn hidden_frames_shown(&self) -> Option<u64> {
        let until = self.traffic.end(&self.view);
        self.traffic.hidden(&self.view, until).filter(|_| self.filter_due.is_none())
    }

    /// Rows of the identifier view that match the filter.
    pub fn identifiers_shown(&self) -> Vec<&IdentifierStats> {
        let filter = self.filters.of(Page::Traffic).active();
        Traffic::identifiers_shown(self.identifiers(), &self.view, filter, self.shown_buses())
    }

    /// Statistics of calls.
    pub fn calls(&self) -> &Calls {
        let past = self.past.as_ref().and_then(|past| past.statistics.as_ref());
        past.map_or(&self.traffic.calls, |count| &count.statistics().calls)
    }

    /// Number of frames before the moment that is shown which the statistics lack: they are still
    /// counted.
    pub fn uncounted_frames(&self) -> u64 {
        let past = self.past.as_ref().and_then(|past| past.statistics.as_ref());
        past.map_or(0, StatisticsCount::left)
    }

    /// Rows of the view of calls that match the filter.
    pub fn calls_shown(&self) -> Vec<&CallStats> {
        let filter = self.filters.of(Page::Traffic).active();
        self.traffic.calls_shown(self.calls(), &self.view, filter, self.shown_buses())
    }

    /// What these frames, oldest first, are in calls, by number.
    pub fn call_parts(&self, shown: &[u64]) -> BTreeMap<u64, CallPart> {
        let end = self.traffic.end(&self.view);
        self.traffic.call_parts_of(self.shown_buses(), shown, end)
    }

    /// Text of the ISO 15765-2 transfer that a captured frame is part of.
    pub fn transfer_text(&self, number: u64) -> Option<String> {
        self.traffic.transfer_text(number)
    }

    /// The transfer that begins with a captured frame, as far as it is shown.
    pub fn transfer(&self, number: u64) -> Option<Transfer> {
        self.traffic.transfer(&self.view, number)
    }

    /// Returns true if the frames of the transfer that begins with a frame have rows of their own.
    pub fn is_transfer_open(&self, number: u64) -> bool {
        self.view.open_transfers.contains(&number)
    }

    /// Heartbeats of an address until the moment that is shown, newest first, as far as they are
    /// captured.
    pub fn heartbeats(&self, bus: BusIndex, address: Address) -> CapturedHeartbeats<'_> {
        let end = self.traffic.end(&self.view);
        self.traffic.heartbeats(self.shown_buses().profile(bus), bus, address, end)
    }

    /// Number of a frame in the capture; `None` once it was dropped.
    pub fn captured(&self, frame: &Frame) -> Option<u64> {
        self.traffic.number_of(frame)
    }

    /// The evidence, if only its own frames are shown.
    pub fn evidence_alone(&self) -> Option<&EvidenceView> {
        self.view.evidence_alone()
    }

    /// The piece of the open evidence that a captured frame is.
    pub fn piece_of(&self, frame: &Frame) -> Option<&EvidenceItem> {
        let pieces = &self.view.evidence.as_ref()?.pieces;
        pieces.iter().find(|piece| piece.frame.as_ref() == Some(frame))
    }

    /// The selected frame on the Traffic page.
    pub fn selected_frame(&self) -> Option<Frame> {
        match self.view.evidence_alone() {
            Some(evidence) => evidence.selected()?.1.frame,
            None if self.view.call_list().is_some() => {
                let call = self.selected_call()?;
                self.traffic.capture.get(call.request)
            }
            None if self.view.shows_calls() => {
                let rows = self.calls_shown();
                let selected = self.view.calls.index(rows.iter().map(|row| &row.key))?;
                rows.get(selected).and_then(|row| self.traffic.capture.get(row.last_number))
            }
            None if self.view.shows_identifiers() => {
                let rows = self.identifiers_shown();
                let selected = self.view.identifiers.index(rows.iter().map(|row| &row.key))?;
                rows.get(selected).map(|row| row.last)
            }
            None if self.traffic.has_no_match(&self.view) => None,
            None => self.traffic.capture.get(self.view.traffic?),
        }
    }

    /// Prepares a filter for the frames of a log: names are those of a frame's moment, as far as known.
    pub fn log_matcher(&self, filter: &Filter) -> FrameMatcher {
        let mut filter = filter.clone();
        filter.resolve(self.clock.wall(), None);
        filter.for_frames(&self.buses)
    }
}
