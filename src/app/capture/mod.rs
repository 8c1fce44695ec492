//! Captured traffic: the stored frames, those that match the filter, statistics of identifiers, frames
//! as text, the state of the recording.
//!
//! Inputs: frames, the filter of the Traffic page. Outputs: numbers and texts of the frames to
//! show.

pub(super) mod calls;
mod captured_log;
mod configuration_text;
mod counts_base;
pub(super) mod decoded;
mod filtered_frames;
mod frame_block;
pub(super) mod frame_store;
mod heartbeats;
pub(super) mod identifiers;
mod indexed_frames;
mod interleaved_logs;
mod row_set;
mod statistics;
pub(super) mod transfer;

pub use calls::{Call, CallKey, CallPart, CallResult, CallStats, Calls, Latency};
pub use captured_log::{CapturedLog, WrittenFrames};
pub(super) use configuration_text::descriptor_content;
pub use counts_base::{CallCounts, CountsBase};
pub use decoded::{Decoded, FrameMeaning, FrameRole};
pub use frame_block::BYTES_PER_FRAME;
pub use frame_store::{FrameStore, StoredFrames};
pub use heartbeats::{CapturedHeartbeat, CapturedHeartbeats};
pub use identifiers::{
    FramePeriod, IdentifierKey, IdentifierKind, IdentifierStats, Identifiers, NOTED_BYTES,
};
pub use interleaved_logs::{InterleavedLogs, InterleavedOrder};
pub use statistics::{FrameStatistics, IdentifierRows, StatisticsCount, add_identifier};
pub use transfer::Transfer;

use super::buses::Buses;
use super::filter::Filter;
use super::view::{CallOrder, IdentifierOrder, Page, TrafficView, View};
use crate::frame::Frame;
use crate::status::RecordingStatus;
use crate::time::{Duration, Instant};
use crate::wire::id::{Header, Service};
use crate::wire::isotp::Pci;
use filtered_frames::FilteredFrames;
use statistics::StatisticsHistory;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::ops::Range;
use transfer::first_frame_of;

/// Most transfers whose frames have rows of their own.
const MAX_OPEN_TRANSFERS: usize = 1024;
/// Frames that are read for the calls on the screen: the three seconds around one of two full buses, some
/// milliseconds.
const MAX_FRAMES_AROUND_CALLS: u64 = 65_536;
/// Frames that are searched for an equal one around its time: buses may be slightly out of order.
const NEAR: u64 = 64;

/// The captured traffic.
#[derive(Debug)]
pub(super) struct Traffic {
    pub capture: FrameStore,
    pub identifiers: Identifiers,
    pub calls: Calls,
    history: StatisticsHistory,
    filtered: FilteredFrames,
    recording: Option<RecordingStatus>,
    /// Nothing is captured.
    is_off: bool,
    /// Number of the DES service, by bus.
    des_services: Vec<Service>,
}

impl Traffic {
    /// Returns an empty capture of frames in at most `room` bytes, with statistics of past moments in at
    /// most `history_room`.
    pub fn new(room: usize, history_room: usize) -> Self {
        let capture = FrameStore::new(room);
        Self {
            history: StatisticsHistory::new(history_room, capture.capacity()),
            capture,
            identifiers: Identifiers::new(),
            calls: Calls::default(),
            filtered: FilteredFrames::default(),
            recording: None,
            is_off: false,
            des_services: Vec::new(),
        }
    }

    /// Returns a capture that stays empty.
    pub fn off() -> Self {
        Self { is_off: true, ..Self::new(0, 0) }
    }

    /// Adds a frame of these buses.
    pub fn push(&mut self, frame: &Frame, buses: &Buses) {
        if self.is_off {
            return;
        }
        let number = self.capture.end();
        let link = add_identifier(&mut self.identifiers, frame, number, buses).link;
        if let Some(bus) = buses.get(frame.bus) {
            self.calls.add(frame, number, &bus.config().profile);
        }
        if self.des_services.len() < buses.len() {
            self.des_services =
                buses.iter().map(|bus| bus.config().profile.des_service()).collect();
        }
        self.capture.push(frame, link);
    }

    /// Forgets the service numbers of the profile before. Call when the buses have another one.
    pub fn take_profile(&mut self) {
        self.des_services.clear();
    }

    /// Ends a second of these buses.
    pub fn tick(&mut self, now: Instant, buses: &Buses) {
        self.identifiers.tick();
        self.calls.tick(now, |bus| buses.profile(bus).calls.timeout());
        if !self.is_off {
            self.history.keep(now, &self.capture, &self.identifiers, &self.calls);
        }
    }

    /// Gives the statistics of past moments more room, in bytes.
    pub fn add_history_room(&mut self, more: usize) {
        self.history.add_room(more);
    }

    /// Begins to count the frames before `frames`, until a time: those that are stored, and those before
    /// as far as they are kept as statistics.
    pub fn count_until(&self, frames: u64, time: Instant) -> StatisticsCount {
        self.history.count(&self.capture, frames, time)
    }

    /// What the frames from `first` to `last` are in calls, by number, as of `end`, the number behind
    /// the last frame that is known.
    pub fn call_parts(
        &self,
        buses: &Buses,
        first: u64,
        last: u64,
        end: u64,
    ) -> BTreeMap<u64, CallPart> {
        let mut parts = BTreeMap::new();
        let (Some(begin), Some(until)) = (self.capture.time_of(first), self.capture.time_of(last))
        else {
            return parts;
        };
        let timeouts = buses.iter().map(|bus| bus.config().profile.calls.timeout());
        let timeout = timeouts.max().unwrap_or_default();
        let mut calls = Calls::default();
        // A request before may be open when the first frame is received.
        let from = self.capture.at_time(begin - 2 * timeout);
        let known = self.capture.frames_from(from).take_while(|(number, _)| *number < end);
        let mut last_time = until;
        for (number, frame) in known.take_while(|(_, frame)| frame.time <= until + timeout) {
            last_time = last_time.max(frame.time);
            let Some(bus) = buses.get(frame.bus) else { continue };
            let Some(part) = calls.add(&frame, number, &bus.config().profile) else { continue };
            if let CallPart::Response { request, .. } = part
                && let Some(CallPart::Request { responses, .. }) = parts.get_mut(&request)
            {
                *responses += 1;
            }
            if (first..=last).contains(&number) {
                parts.insert(number, part);
            }
        }
        for (number, part) in &mut parts {
            if let CallPart::Request { responses: 0, is_unanswered } = part {
                let asked = self.capture.time_of(*number).unwrap_or(last_time);
                *is_unanswered = last_time.since(asked) >= timeout;
            }
        }
        parts
    }

    /// What these frames, oldest first, are in calls, by number, as of `end`. Those of the newest calls only
    /// where too many frames lie around them.
    pub fn call_parts_of(&self, buses: &Buses, shown: &[u64], end: u64) -> BTreeMap<u64, CallPart> {
        let timeouts = buses.iter().map(|bus| bus.config().profile.calls.timeout());
        let timeout = timeouts.max().unwrap_or_default();
        let calls = shown.iter().rev().filter_map(|number| {
            let frame = self.capture.get(*number).filter(calls::is_call)?;
            Some((*number, frame.time))
        });
        let calls: Vec<(u64, Instant)> = calls.collect();
        let mut parts = BTreeMap::new();
        let mut room = MAX_FRAMES_AROUND_CALLS;
        // Frames around calls that are near each other are read once.
        for near in calls.chunk_by(|later, earlier| later.1.since(earlier.1) <= 3 * timeout) {
            let last = near[0];
            let behind = self.capture.at_time(last.1 + timeout).min(end);
            let is_in_room = |call: &&(u64, Instant)| {
                behind.saturating_sub(self.capture.at_time(call.1 - 2 * timeout)) <= room
            };
            let Some(first) = near.iter().take_while(is_in_room).last() else { break };
            room -= behind.saturating_sub(self.capture.at_time(first.1 - 2 * timeout));
            parts.extend(self.call_parts(buses, first.0, last.0, end));
        }
        parts
    }

    /// State of the recording; `None` without one.
    pub fn recording(&self) -> Option<&RecordingStatus> {
        self.recording.as_ref()
    }

    /// Takes the state of the recording; returns the one before.
    pub fn set_recording(&mut self, status: RecordingStatus) -> Option<RecordingStatus> {
        self.recording.replace(status)
    }

    /// Number behind the last frame to show; a frozen view keeps its end.
    pub fn end(&self, view: &View) -> u64 {
        view.frozen.map_or(self.capture.end(), |frozen| frozen.frames)
    }

    /// Sets the filter of the frames; `None` shows all.
    pub fn set_filter(&mut self, filter: Option<&Filter>) {
        self.filtered.set(filter);
    }

    /// Tests frames that were not tested, if the Traffic page is open and has a filter. Returns false
    /// if some remain.
    pub fn renew_filter(&mut self, view: &mut View, buses: &Buses) -> bool {
        if view.page != Page::Traffic {
            return true;
        }
        self.filtered.limit_debug(buses.devices().any(|it| it.debug_messages.is_frequent()));
        if !self.filtered.is_on() {
            return true;
        }
        let is_complete = self.filtered.test(&self.capture, buses, self.end(view));
        if let Some(selected) = view.traffic {
            let nearest = self.filtered.nearest(&self.capture, selected, self.end(view));
            view.traffic = Some(nearest.unwrap_or(selected));
        }
        is_complete
    }

    /// Number of tested frames before number `until` that the filter hides; `None` if it does not apply.
    pub fn hidden(&self, view: &View, until: u64) -> Option<u64> {
        let is_frames = view.traffic_view == TrafficView::Frames;
        let is_shown = view.page == Page::Traffic && is_frames && self.is_filtered(view);
        is_shown.then(|| self.filtered.hidden(until))
    }

    /// Returns true if only some of the DEBUG messages are shown, because there are many.
    pub fn is_debug_limited(&self, view: &View) -> bool {
        self.filtered.is_debug_limited() && self.is_filtered(view)
    }

    /// Returns true if the filter applies: around evidence all frames are shown.
    fn is_filtered(&self, view: &View) -> bool {
        self.filtered.is_on() && view.evidence.is_none()
    }

    /// Returns true if the filter hides all frames.
    pub fn has_no_match(&self, view: &View) -> bool {
        self.is_filtered(view) && self.filtered.has_no_match(self.end(view))
    }

    /// Numbers of the frames to show from `number` on, oldest first.
    pub fn from<'a>(&'a self, view: &'a View, number: u64) -> Box<dyn Iterator<Item = u64> + 'a> {
        let end = self.end(view);
        let until = move |number: &u64| *number < end;
        let all: Box<dyn Iterator<Item = u64>> = if self.is_filtered(view) {
            Box::new(self.filtered.from(number).take_while(until))
        } else {
            Box::new(self.capture.numbers_from(number).take_while(until))
        };
        if !Self::folds(view) {
            return all;
        }
        Box::new(all.filter(move |number| !self.is_folded(view, *number)))
    }

    /// Numbers of the frames to show before `number`, newest first.
    pub fn before<'a>(&'a self, view: &'a View, number: u64) -> Box<dyn Iterator<Item = u64> + 'a> {
        let end = number.min(self.end(view));
        let all: Box<dyn Iterator<Item = u64>> = if self.is_filtered(view) {
            Box::new(self.filtered.before(end))
        } else {
            Box::new(self.capture.numbers_before(end))
        };
        if !Self::folds(view) {
            return all;
        }
        Box::new(all.filter(move |number| !self.is_folded(view, *number)))
    }

    /// Numbers of the frames on `height` lines, oldest first, and the selected one; `None` while
    /// the newest frames are followed.
    pub fn shown(&self, view: &View, height: usize) -> (Vec<u64>, Option<u64>) {
        // The selection stays for the time when the filter is off.
        if self.has_no_match(view) {
            return (Vec::new(), None);
        }
        let end = self.end(view);
        let kept = |number: &u64| *number < end && self.capture.get(*number).is_some();
        let Some(selected) = view.traffic.filter(kept) else {
            let is_stored = |end: &u64| self.capture.get(end.saturating_sub(1)).is_some();
            let end = view.followed.map(|it| it.end).filter(is_stored).unwrap_or(end);
            let mut shown: Vec<u64> = self.before(view, end).take(height).collect();
            shown.reverse();
            return (shown, None);
        };
        let above = view.traffic_line.min(height.saturating_sub(1));
        let mut shown: Vec<u64> = self.before(view, selected).take(above).collect();
        shown.reverse();
        shown.push(selected);
        let below = height.saturating_sub(shown.len());
        shown.extend(self.from(view, selected + 1).take(below));
        if shown.len() < height {
            let missing = height - shown.len();
            let mut older: Vec<u64> = self.before(view, shown[0]).take(missing).collect();
            older.reverse();
            older.append(&mut shown);
            shown = older;
        }
        (shown, Some(selected))
    }

    /// Number of frames with these numbers that match the filter.
    pub fn count_between(&self, view: &View, numbers: Range<u64>) -> u64 {
        if !self.is_filtered(view) {
            return numbers.end.saturating_sub(numbers.start);
        }
        self.filtered.from(numbers.start).take_while(|number| *number < numbers.end).count() as u64
    }

    /// Moves the selected frame by `delta` on a list of `height` lines; below the newest frame the
    /// list follows again.
    pub fn move_by(&self, view: &mut View, delta: isize, height: usize) {
        let bottom = height.saturating_sub(1);
        let (shown, selected) = self.shown(view, height);
        let (from, line) = match selected {
            Some(selected) => {
                (selected, shown.iter().position(|&number| number == selected).unwrap_or(0))
            }
            None => match shown.last() {
                Some(&newest) => (newest, shown.len() - 1),
                None => return,
            },
        };
        let steps = delta.unsigned_abs();
        let to = if delta > 0 {
            self.from(view, from + 1).take(steps).last()
        } else {
            self.before(view, from).take(steps).last()
        };
        let Some(to) = to else {
            view.traffic = (delta < 0).then_some(from);
            return;
        };
        view.traffic = Some(to);
        view.traffic_line = line.saturating_add_signed(delta).min(bottom);
    }

    /// Rows of the view of identifiers that match the filter, in its order.
    pub fn identifiers_shown<'a>(
        identifiers: &'a Identifiers,
        view: &View,
        filter: Option<&Filter>,
        buses: &Buses,
    ) -> Vec<&'a IdentifierStats> {
        let matcher = filter.map(|filter| filter.for_frames(buses));
        let rows = identifiers.rows_of(|bus| buses.is_foreign(bus));
        // With the identifier of the row: its random destination is shown as 0.
        let is_shown = |row: &&IdentifierStats| {
            let mut frame = row.last;
            frame.id = row.key.id;
            matcher.as_ref().is_none_or(|matcher| matcher.is_match(&frame, None))
        };
        let mut shown: Vec<&IdentifierStats> = rows.filter(is_shown).collect();
        shown.sort_by_key(|row| row.key);
        let period = |row: &IdentifierStats| row.own_period(buses.is_foreign(row.key.bus));
        match view.identifier_sort.order {
            IdentifierOrder::Id => {}
            IdentifierOrder::Count => shown.sort_by_key(|row| Reverse(view.frame_count(row))),
            IdentifierOrder::Rate => shown.sort_by_key(|row| Reverse(row.rate)),
            IdentifierOrder::Period => {
                shown.sort_by_cached_key(|row| period(row).map_or(Duration::MAX, |it| it.mean));
            }
            IdentifierOrder::Jitter => {
                // A few intervals have no jitter that could be compared.
                shown.sort_by_cached_key(|row| {
                    Reverse(period(row).map(|it| (it.is_regular, it.jitter)))
                });
            }
            IdentifierOrder::Newest => shown.sort_by_key(|row| Reverse(row.last.time)),
        }
        if view.identifier_sort.is_reversed {
            shown.reverse();
        }
        shown
    }

    /// Rows of the view of calls whose last request matches the filter, in its order; not of buses that
    /// speak another protocol.
    pub fn calls_shown<'a>(
        &'a self,
        calls: &'a Calls,
        view: &View,
        filter: Option<&Filter>,
        buses: &Buses,
    ) -> Vec<&'a CallStats> {
        let matcher = filter.map(|filter| filter.for_frames(buses));
        let is_shown = |row: &&CallStats| {
            // Of another protocol nothing is a request.
            !buses.is_foreign(row.key.bus)
                && matcher.as_ref().is_none_or(|matcher| {
                    let frame = self.capture.get(row.last_number);
                    let stored = Some((&self.capture, row.last_number));
                    frame.is_some_and(|frame| matcher.is_match(&frame, stored))
                })
        };
        let mut shown: Vec<&CallStats> = calls.rows().iter().filter(is_shown).collect();
        shown.sort_by_key(|row| row.key);
        match view.call_sort.order {
            CallOrder::Client => {}
            CallOrder::Count => shown.sort_by_key(|row| Reverse(view.call_counts(row).calls)),
            CallOrder::Latency => {
                let latency =
                    |row: &CallStats| row.latency_of_last(view.call_counts(row).responses);
                shown.sort_by_cached_key(|row| Reverse(latency(row).map(|it| it.p99)));
            }
            CallOrder::Unanswered => {
                shown.sort_by_key(|row| Reverse(view.call_counts(row).unanswered));
            }
            CallOrder::Failed => shown.sort_by_key(|row| Reverse(view.call_counts(row).failed)),
            CallOrder::Newest => shown.sort_by_key(|row| Reverse(row.last)),
        }
        if view.call_sort.is_reversed {
            shown.reverse();
        }
        shown
    }

    /// Number of a frame in the capture; `None` once it was dropped.
    pub fn number_of(&self, frame: &Frame) -> Option<u64> {
        let at = self.capture.at_time(frame.time);
        let near = |number: &u64| self.capture.get(*number).as_ref() == Some(frame);
        (at..self.capture.end())
            .take_while(|&number| {
                number < at + NEAR
                    || self.capture.get(number).is_some_and(|it| it.time == frame.time)
            })
            .find(near)
            .or_else(|| (at.saturating_sub(NEAR)..at).find(near))
    }

    /// Number of the first frame of the transfer that a frame belongs to, which may be the frame itself;
    /// `None` for a frame of no transfer.
    fn transfer_of(&self, number: u64) -> Option<u64> {
        let frame = self.capture.get(number)?;
        let des = *self.des_services.get(usize::from(frame.bus.0))?;
        let is_des = frame.platform_id().is_some_and(|id| Header::decode(id).service == des);
        let is_first = matches!(Pci::decode(frame.data(), frame.is_fd), Ok(Pci::First { .. }));
        if is_des && is_first { Some(number) } else { first_frame_of(&self.capture, number, des) }
    }

    /// The transfer that begins with this frame, as far as it is shown; `None` for other frames.
    pub fn transfer(&self, view: &View, number: u64) -> Option<Transfer> {
        self.transfer_of(number).filter(|first| *first == number)?;
        Transfer::starting_at(&self.capture, number, self.end(view))
    }

    /// Returns true if a frame is shown in the row of the first frame of its transfer.
    fn is_folded(&self, view: &View, number: u64) -> bool {
        let first = self.transfer_of(number).filter(|first| *first < number);
        first.is_some_and(|first| {
            !view.open_transfers.contains(&first)
                && (!self.is_filtered(view) || self.filtered.contains(first))
        })
    }

    /// Returns true if the frames of transfers are shown in one row: around evidence each is.
    fn folds(view: &View) -> bool {
        view.evidence.is_none()
    }

    /// Shows the frames of the selected transfer in rows of their own, or in one row. Returns false
    /// without a transfer.
    pub fn toggle_transfer(&self, view: &mut View) -> bool {
        let selected = view.traffic.filter(|_| !self.has_no_match(view));
        let Some(first) = selected.and_then(|selected| self.transfer_of(selected)) else {
            return false;
        };
        if view.open_transfers.remove(&first) {
            view.traffic = Some(first);
        } else if view.open_transfers.len() < MAX_OPEN_TRANSFERS {
            view.open_transfers.insert(first);
        }
        true
    }

    /// Text of the ISO 15765-2 transfer that a frame is part of; `None` for other frames, or if
    /// its first frame is no longer in the capture.
    pub fn transfer_text(&self, number: u64) -> Option<String> {
        let first = self.transfer_of(number)?;
        let transfer = Transfer::starting_at(&self.capture, first, self.capture.end())?;
        Some(decoded::describe_response(&transfer.message).0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::filter::RowKind;
    use crate::discovery::Config;
    use crate::time::Instant;

    /// Frames with the numbers 0 to 9; those with even numbers are sent by descan.
    fn traffic() -> (Traffic, Buses) {
        let buses = Buses::new(Instant::ZERO, vec![("can0".into(), Config::default())]);
        let mut traffic = Traffic::new(0, 0);
        for at in 0..10 {
            let frame = Frame::classic(1, &[]).with_time(Instant::from_micros(at));
            let frame = if at % 2 == 0 { frame.with_tx() } else { frame };
            traffic.push(&frame, &buses);
        }
        (traffic, buses)
    }

    #[test]
    fn filter_selects_matching_frames() {
        let (mut traffic, buses) = traffic();
        let mut view = View { page: Page::Traffic, ..View::default() };
        assert_eq!(traffic.shown(&view, 3), (vec![7, 8, 9], None));
        traffic.set_filter(Some(&Filter::parse("tx", RowKind::Frame).unwrap()));
        traffic.renew_filter(&mut view, &buses);
        assert_eq!(traffic.shown(&view, 3), (vec![4, 6, 8], None));
        assert_eq!(traffic.from(&view, 3).collect::<Vec<_>>(), [4, 6, 8]);
    }

    #[test]
    fn selection_below_newest_frame_follows_again() {
        let (traffic, _) = traffic();
        let mut view = View { page: Page::Traffic, ..View::default() };
        traffic.move_by(&mut view, -2, 5);
        assert_eq!((view.traffic, view.traffic_line), (Some(7), 2));
        traffic.move_by(&mut view, 2, 5);
        assert_eq!(view.traffic, Some(9));
        traffic.move_by(&mut view, 1, 5);
        assert_eq!(view.traffic, None);
    }
}
