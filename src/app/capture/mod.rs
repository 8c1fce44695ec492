//! Captured traffic: the frame ring, the frames that match the filter, frames as text, the state of
//! the recording.
//!
//! Inputs: frames, the filter of the Traffic page. Outputs: numbers and texts of the frames to
//! show.

pub(super) mod decoded;
pub(super) mod ring;

pub use decoded::{Decoded, hex};
pub use ring::{Capture, IdentifierKey, IdentifierKind, IdentifierStats};

use super::buses::{Bus, Buses};
use super::filter::Filter;
use super::view::{Page, View};
use crate::frame::Frame;
use crate::log::{LogEntry, LogFormat};
use crate::status::RecordingStatus;
use crate::time::Epoch;
use crate::wire::id::Header;
use crate::wire::isotp::Pci;
use std::collections::VecDeque;
use std::io;

/// Frames that are searched for the other parts of a transfer, in each direction.
const TRANSFER_SEARCH: usize = 4096;
/// Frames that are searched for an equal one around its time: buses may be slightly out of order.
const NEAR: u64 = 64;

/// The captured traffic.
#[derive(Debug)]
pub(super) struct Traffic {
    pub capture: Capture,
    filtered: FilteredFrames,
    recording: Option<RecordingStatus>,
}

/// Numbers of the frames that match the filter; each frame is decoded once.
#[derive(Debug, Default)]
struct FilteredFrames {
    filter: String,
    numbers: VecDeque<u64>,
    /// Number of the first frame that was not tested.
    next: u64,
}

impl Traffic {
    /// Returns an empty capture.
    pub fn new() -> Self {
        let filtered = FilteredFrames::default();
        Self { capture: Capture::new(), filtered, recording: None }
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

    /// Tests the frames that were captured since the last call, if the Traffic page is open and has
    /// a filter.
    pub fn renew_filter(&mut self, view: &View, buses: &Buses) {
        let line = view.filter(Page::Traffic);
        if view.page != Page::Traffic || line.is_empty() {
            return;
        }
        let filtered = &mut self.filtered;
        if filtered.filter != line {
            *filtered = FilteredFrames { filter: line.to_owned(), ..FilteredFrames::default() };
        }
        let (first, end) = (self.capture.first(), self.capture.end());
        while filtered.numbers.front().is_some_and(|&number| number < first) {
            filtered.numbers.pop_front();
        }
        let filter = Filter::parse(line);
        for number in filtered.next.max(first)..end {
            let frame = self.capture.get(number);
            if frame.is_some_and(|frame| filter.matches_frame(buses, frame)) {
                filtered.numbers.push_back(number);
            }
        }
        filtered.next = end;
    }

    /// Returns true if the filter applies: around evidence all frames are shown.
    fn is_filtered(view: &View) -> bool {
        !view.filter(Page::Traffic).is_empty() && view.evidence.is_none()
    }

    /// Numbers of the frames to show from `number` on, oldest first.
    pub fn from<'a>(&'a self, view: &View, number: u64) -> Box<dyn Iterator<Item = u64> + 'a> {
        let (first, end) = (number.max(self.capture.first()), self.end(view));
        if !Self::is_filtered(view) {
            return Box::new(first..end);
        }
        let numbers = &self.filtered.numbers;
        let start = numbers.partition_point(|&other| other < first);
        Box::new(numbers.range(start..).copied().take_while(move |&number| number < end))
    }

    /// Numbers of the frames to show before `number`, newest first.
    pub fn before<'a>(&'a self, view: &View, number: u64) -> Box<dyn Iterator<Item = u64> + 'a> {
        let (first, end) = (self.capture.first(), number.min(self.end(view)));
        if !Self::is_filtered(view) {
            return Box::new((first..end).rev());
        }
        let numbers = &self.filtered.numbers;
        let stop = numbers.partition_point(|&other| other < end);
        Box::new(numbers.range(..stop).rev().copied().take_while(move |&number| number >= first))
    }

    /// Numbers of the frames on `height` lines, oldest first, and the selected one; `None` while
    /// the newest frames are followed.
    pub fn shown(&self, view: &View, height: usize) -> (Vec<u64>, Option<u64>) {
        let end = self.end(view);
        let kept = |number: &u64| *number >= self.capture.first() && *number < end;
        let Some(selected) = view.traffic.filter(kept) else {
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

    /// Rows of the identifier view that match the filter, in the order of their keys.
    pub fn identifiers_shown(&self, view: &View, buses: &Buses) -> Vec<&IdentifierStats> {
        let filter = Filter::parse(view.filter(Page::Traffic));
        let rows = self.capture.identifiers().rows().iter();
        // With the identifier of the row: its random destination is shown as 0.
        let is_shown = |row: &&IdentifierStats| {
            let mut frame = row.last;
            frame.id = row.key.id;
            filter.matches_frame(buses, &frame)
        };
        let mut shown: Vec<&IdentifierStats> = rows.filter(is_shown).collect();
        shown.sort_by_key(|row| row.key);
        shown
    }

    /// Number of a frame in the capture; `None` once it was dropped.
    pub fn number_of(&self, frame: &Frame) -> Option<u64> {
        let at = self.capture.at_time(frame.time);
        let near = |number: &u64| self.capture.get(*number) == Some(frame);
        (at..self.capture.end())
            .take_while(|&number| {
                number < at + NEAR
                    || self.capture.get(number).is_some_and(|it| it.time == frame.time)
            })
            .find(near)
            .or_else(|| (at.saturating_sub(NEAR)..at).find(near))
    }

    /// Text of the ISO 15765-2 transfer that a frame is part of; `None` for other frames, or if
    /// its first frame is no longer in the capture.
    pub fn transfer_text(&self, buses: &Buses, number: u64) -> Option<String> {
        let frame = self.capture.get(number)?;
        let id = frame.platform_id()?;
        if Header::decode(id).service != buses.profile(frame.bus).des_service() {
            return None;
        }
        let same = |other: &&Frame| other.bus == frame.bus && other.platform_id() == Some(id);
        let is_first = |other: &&Frame| {
            matches!(Pci::decode(other.data(), other.is_fd), Ok(Pci::First { .. }))
        };
        if !matches!(
            Pci::decode(frame.data(), frame.is_fd),
            Ok(Pci::First { .. } | Pci::Consecutive { .. })
        ) {
            return None;
        }
        let (start, first) = (self.capture.first()..=number)
            .rev()
            .take(TRANSFER_SEARCH)
            .filter_map(|at| Some((at, self.capture.get(at)?)))
            .filter(|(_, other)| same(other))
            .find(|(_, other)| is_first(other))?;
        let message = decoded::reassemble(
            first,
            (start + 1..self.capture.end())
                .take(TRANSFER_SEARCH)
                .filter_map(|at| self.capture.get(at))
                .filter(same),
        )?;
        Some(decoded::describe_response(&message).0)
    }

    /// The captured frames as a log of this format.
    pub fn log(&self, buses: &Buses, epoch: Epoch, format: &LogFormat) -> io::Result<Vec<u8>> {
        let (mut encoder, mut log) = (format.encoder(), Vec::new());
        encoder.begin(&mut log)?;
        for (_, frame) in self.capture.iter() {
            let unix_micros = epoch.unix_micros(frame.time);
            let interface = buses.get(frame.bus).map_or("can", |bus| &bus.name);
            encoder.write(
                LogEntry { unix_micros, interface, frame: *frame },
                u64::MAX,
                &mut log,
            )?;
        }
        let names: Vec<String> = buses.iter().map(|bus| bus.name.clone()).collect();
        let lost: Vec<u64> = buses.iter().map(Bus::lost).collect();
        encoder.end(&names, &lost, &mut log)?;
        Ok(log)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discovery::Config;
    use crate::time::Instant;

    /// Frames with the numbers 0 to 9; those with even numbers are sent by descan.
    fn traffic() -> (Traffic, Buses) {
        let mut traffic = Traffic::new();
        for at in 0..10 {
            let frame = Frame::classic(1, &[]).with_time(Instant::from_micros(at));
            traffic.capture.push(&if at % 2 == 0 { frame.with_tx() } else { frame });
        }
        (traffic, Buses::new(Instant::ZERO, vec![("can0".into(), Config::default())]))
    }

    #[test]
    fn filter_selects_matching_frames() {
        let (mut traffic, buses) = traffic();
        let mut view = View { page: Page::Traffic, ..View::default() };
        assert_eq!(traffic.shown(&view, 3), (vec![7, 8, 9], None));
        view.set_filter(Page::Traffic, "tx".to_owned());
        traffic.renew_filter(&view, &buses);
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
