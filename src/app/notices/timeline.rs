//! Timeline: one line per event of devices, buses, the file and edits. Lines outlive the devices.
//!
//! Bounded: 4096 lines. A line that repeats one of the last 8 within 5 s, or is of a DEBUG message
//! with the same code, is counted instead of added, and moves to the end.

use super::event_text::{event_word, finding_line, other_names};
use crate::app::buses::Buses;
use crate::app::file::FileIndex;
use crate::app::timeline_kind::TimelineKind;
use crate::discovery::{DeviceId, Event, EventKind};
use crate::finding::{Finding, FindingKind};
use crate::frame::BusIndex;
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::Mode;
use std::collections::VecDeque;

/// A line of the timeline.
#[derive(Clone, Debug)]
pub struct TimelineEntry {
    /// Number, ascending from 0. A line that is counted again gets a new one.
    pub number: u64,
    /// Time of the first occurrence.
    pub time: Instant,
    /// Time of the last occurrence.
    pub last: Instant,
    /// Bus; `None` for a line about the program or the file.
    pub bus: Option<BusIndex>,
    /// The des.json, of a line about it: one without bus and name.
    pub file: FileIndex,
    /// Device; `None` for a line about a bus, the program or the file.
    pub device: Option<DeviceId>,
    /// Address of the device at that time.
    pub address: Option<Address>,
    /// Name of the device at that time.
    pub name: Option<Name>,
    /// Names of other devices that the event is about.
    pub other_names: Vec<Name>,
    /// Words of the events, as in `watch --json`: several where events share the line.
    pub events: Vec<&'static str>,
    /// New mode of the device, where the line is about that.
    pub mode: Option<Mode>,
    /// Kind of the finding, where the line reports one.
    pub finding: Option<FindingKind>,
    /// Code of the DEBUG message, where the line reports one.
    pub debug_code: Option<u16>,
    /// Event, for the user.
    pub text: String,
    /// Kind of event.
    pub kind: TimelineKind,
    /// Number of occurrences.
    pub times: u32,
}

impl TimelineEntry {
    /// Name of the device that the line is about: at the time of the line, else the present one.
    pub fn device_name<'a>(&'a self, buses: &'a Buses) -> Option<&'a Name> {
        let known = || buses.device(self.device?)?.name.as_ref();
        self.name.as_ref().or_else(known)
    }
}

/// Lines of the timeline.
#[derive(Debug, Default)]
pub struct Timeline {
    entries: VecDeque<TimelineEntry>,
    next: u64,
    /// Lines with lower numbers do not change, because the user is reading them.
    held: u64,
}

impl Timeline {
    /// Largest number of lines.
    pub const ENTRIES: usize = 4096;
    /// Largest distance of a repetition, in time and (`REPEAT_LINES`) in lines.
    const REPEAT_WITHIN: Duration = Duration::from_secs(5);
    const REPEAT_LINES: usize = 8;

    /// Adds a line. A line that it repeats is removed and counted in it.
    pub fn push(&mut self, mut entry: TimelineEntry) {
        let last = self.entries.len().saturating_sub(Self::REPEAT_LINES)..self.entries.len();
        // Of DEBUG messages a device may send hundreds a second, each with other parameters.
        let is_same_message = |other: &TimelineEntry| {
            entry.debug_code.is_some() && other.debug_code == entry.debug_code
        };
        let repeated = last.rev().find(|&at| {
            let other = &self.entries[at];
            other.number >= self.held
                && other.device == entry.device
                && (other.bus, other.file) == (entry.bus, entry.file)
                && (other.text == entry.text || is_same_message(other))
                && entry.time.since(other.last) <= Self::REPEAT_WITHIN
        });
        if let Some(repeated) = repeated.and_then(|at| self.entries.remove(at)) {
            let TimelineEntry { text, time, .. } = entry;
            entry = TimelineEntry { times: repeated.times + 1, last: time, text, ..repeated };
        }
        if self.entries.len() == Self::ENTRIES {
            self.entries.pop_front();
        }
        entry.number = self.next;
        self.next += 1;
        self.entries.push_back(entry);
    }

    /// Inserts a line at its time, before the first later one: those get the next numbers. Returns the
    /// number of the line.
    pub fn insert(&mut self, mut entry: TimelineEntry) -> u64 {
        if self.entries.len() == Self::ENTRIES {
            self.entries.pop_front();
        }
        let later = self.entries.iter().position(|other| other.time > entry.time);
        let at = later.unwrap_or(self.entries.len());
        let number = self.entries.get(at).map_or(self.next, |other| other.number);
        for other in self.entries.iter_mut().skip(at) {
            other.number += 1;
        }
        self.next += 1;
        if self.held > number {
            self.held += 1;
        }
        entry.number = number;
        self.entries.insert(at, entry);
        number
    }

    /// Removes the line of the mark with this letter.
    pub fn remove_mark(&mut self, letter: char) {
        self.entries.retain(|entry| entry.kind != TimelineKind::Mark(letter));
    }

    /// Joins an entry with a line of the same device and time: `join` returns the new text for the
    /// two texts, or `None` for no match. If the new text does not begin with the old one, the line
    /// gets the kind of the entry and moves to the end. Returns the old text and the changed line;
    /// `None` without a match.
    pub fn amend(
        &mut self,
        entry: &TimelineEntry,
        join: impl Fn(&str, &str) -> Option<String>,
    ) -> Option<(String, TimelineEntry)> {
        let same = |other: &TimelineEntry| {
            entry.device.is_some()
                && other.device == entry.device
                && other.last == entry.time
                && other.times == 1
        };
        let first = self.entries.len().saturating_sub(Self::REPEAT_LINES);
        let joined = (first..self.entries.len()).rev().find_map(|at| {
            let other = self.entries.get(at).filter(|other| same(other))?;
            Some((at, join(&other.text, &entry.text)?))
        });
        let (at, text) = joined?;
        let other = &mut self.entries[at];
        other.address = entry.address.or(other.address);
        let before = std::mem::replace(&mut other.text, text);
        other.events.extend(&entry.events);
        other.other_names.extend(entry.other_names.iter().cloned());
        if other.text.starts_with(&before) {
            return Some((before, other.clone()));
        }
        other.kind = entry.kind;
        let amended = other.clone();
        // The line follows the events that led to it.
        for later in at + 1..self.entries.len() {
            self.entries.swap(later - 1, later);
            let number = self.entries[later].number;
            self.entries[later].number = self.entries[later - 1].number;
            self.entries[later - 1].number = number;
        }
        Some((before, amended))
    }

    /// Keeps the present lines unchanged while `holds`; else repetitions may be counted in them.
    pub fn pin_lines(&mut self, holds: bool) {
        self.held = if holds { self.next } else { 0 };
    }

    /// Assigns the lines of `was`, those before `before` if given, to `device`.
    pub fn reassign(&mut self, was: DeviceId, before: Option<Instant>, device: DeviceId) {
        let is_before = |entry: &TimelineEntry| before.is_none_or(|before| entry.time < before);
        for entry in self.entries.iter_mut().filter(|entry| entry.device == Some(was)) {
            if is_before(entry) {
                entry.device = Some(device);
            }
        }
    }

    /// Lines, oldest first.
    pub fn entries(&self) -> impl DoubleEndedIterator<Item = &TimelineEntry> + ExactSizeIterator {
        self.entries.iter()
    }

    /// The line with this number; `None` if it was removed.
    pub fn get(&self, number: u64) -> Option<&TimelineEntry> {
        let at = self.entries.binary_search_by_key(&number, |entry| entry.number).ok()?;
        self.entries.get(at)
    }

    /// Number of the next line.
    pub fn end(&self) -> u64 {
        self.next
    }
}

impl TimelineEntry {
    /// Returns a line about the program, the file or a bus.
    pub fn new(time: Instant, kind: TimelineKind, text: impl Into<String>) -> Self {
        Self {
            number: 0,
            time,
            last: time,
            bus: None,
            file: FileIndex::default(),
            device: None,
            address: None,
            name: None,
            other_names: Vec::new(),
            events: vec![kind.event_word()],
            mode: None,
            finding: None,
            debug_code: None,
            text: text.into(),
            kind,
            times: 1,
        }
    }

    /// Returns the line of an engine event.
    pub fn of_event(bus: BusIndex, event: &Event, kind: TimelineKind, text: String) -> Self {
        let mut line = Self::new(event.time, kind, text).on(bus);
        (line.device, line.address) = (event.device, event.address);
        line.name.clone_from(&event.name);
        line.events = vec![event_word(&event.kind)];
        line.other_names = other_names(&event.kind);
        match &event.kind {
            EventKind::Finding { key, .. } => line.finding = Some(key.kind),
            EventKind::Mode { to, .. } => line.mode = Some(*to),
            EventKind::DebugMessage { code, .. } => line.debug_code = Some(*code),
            _ => {}
        }
        line
    }

    /// Returns the line of a finding of the comparison with des.json.
    pub fn of_finding(time: Instant, finding: &Finding) -> Self {
        let (kind, text) = finding_line(finding.state, &finding.key, &finding.text);
        let key = &finding.key;
        let mut line = Self::new(time, kind, text);
        (line.bus, line.address, line.finding) = (key.bus, key.address, Some(key.kind));
        line.name.clone_from(&key.name);
        line.other_names.clone_from(&finding.names);
        line
    }

    /// Sets the bus of the line.
    #[must_use]
    pub fn on(mut self, bus: BusIndex) -> Self {
        self.bus = Some(bus);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timeline(lines: &[(u64, &str)]) -> Timeline {
        let mut timeline = Timeline::default();
        for &(second, text) in lines {
            timeline.push(line(second, text));
        }
        timeline
    }

    fn line(second: u64, text: &str) -> TimelineEntry {
        TimelineEntry::new(Instant::from_micros(second * 1_000_000), TimelineKind::File, text)
    }

    fn told(timeline: &Timeline) -> Vec<(u64, &str, u32)> {
        let seconds = |entry: &TimelineEntry| entry.last.as_micros() / 1_000_000;
        timeline.entries().map(|it| (seconds(it), &*it.text, it.times)).collect()
    }

    #[test]
    fn repeated_line_moves_behind_newer_lines() {
        let lines = [(0, "undone"), (1, "redone"), (2, "undone"), (3, "other"), (4, "undone")];
        let mut timeline = timeline(&lines);
        let expected = [(1, "redone", 1), (3, "other", 1), (4, "undone", 3)];
        assert_eq!(told(&timeline), expected);
        // Each line is found by its number; numbers ascend.
        let numbers: Vec<u64> = timeline.entries().map(|entry| entry.number).collect();
        assert!(numbers.is_sorted() && numbers.last() < Some(&timeline.end()), "{numbers:?}");
        for number in numbers {
            assert_eq!(timeline.get(number).unwrap().number, number);
        }
        assert!(timeline.get(0).is_none());
        timeline.push(line(10, "undone"));
        assert_eq!(told(&timeline)[3], (10, "undone", 1), "that was long ago");
    }

    #[test]
    fn frequent_line_leaves_room_for_others() {
        let mut timeline = timeline(&[(0, "first")]);
        for second in 0..10_000 {
            timeline.push(line(second, ["changed", "saved", "broken"][second as usize % 3]));
        }
        let expected = [
            (0, "first", 1),
            (9997, "saved", 3333),
            (9998, "broken", 3333),
            (9999, "changed", 3334),
        ];
        assert_eq!(told(&timeline), expected);
    }

    #[test]
    fn pinned_lines_do_not_change() {
        let mut timeline = timeline(&[(0, "changed"), (1, "saved")]);
        timeline.pin_lines(true);
        timeline.push(line(2, "changed"));
        timeline.push(line(3, "changed"));
        let expected = [(0, "changed", 1), (1, "saved", 1), (3, "changed", 2)];
        assert_eq!(told(&timeline), expected);
        timeline.pin_lines(false);
        timeline.push(line(4, "saved"));
        assert_eq!(told(&timeline).last(), Some(&(4, "saved", 2)));
    }
}
