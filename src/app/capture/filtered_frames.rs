//! The stored frames that match a filter; without one, those that are left of many DEBUG messages.
//!
//! Inputs: the filter, the stored frames, names of devices. Frames are tested once, the newest first, in parts
//! that are small enough for a key to be handled between them. A bit per frame is kept.

use super::frame_store::FrameStore;
use crate::app::buses::Buses;
use crate::app::filter::{Filter, FrameMatcher};
use crate::frame::{BusIndex, Frame};
use std::collections::BTreeMap;
use std::ops::Range;

/// Most frames that are tested at once: some milliseconds.
const PART: u64 = 8192;
const BITS: u64 = u64::BITS as u64;

/// Without a filter, each device has one DEBUG message with a row in each part of time this long, in µs.
const DEBUG_PART: u64 = 100_000;

/// Frames with consecutive numbers that were tested.
#[derive(Debug, Default)]
struct TestedRange {
    /// Part of time of the last DEBUG message with a row, by bus and address.
    debug_parts: BTreeMap<(BusIndex, u8), u64>,
    /// Number behind the last one tested.
    end: u64,
    /// A bit for each frame, set if it matches.
    matches: Vec<u64>,
    count: u64,
}

impl TestedRange {
    /// Returns true if a frame is a DEBUG message, and another one of its device has a row in the same
    /// part of time.
    fn is_debug_repeated(&mut self, frame: &Frame, matcher: &FrameMatcher) -> bool {
        let Some(source) = matcher.debug_source(frame) else { return false };
        let part = frame.time.as_micros() / DEBUG_PART;
        self.debug_parts.insert((frame.bus, source.number()), part) == Some(part)
    }

    fn matches(&self, start: u64, number: u64) -> bool {
        let at = number - start;
        let word = self.matches.get((at / BITS) as usize);
        word.is_some_and(|word| word >> (at % BITS) & 1 != 0)
    }

    /// Number of matches before number `until`, of a range that begins with `start`.
    fn count(&self, start: u64, until: u64) -> u64 {
        if until >= self.end {
            return self.count;
        }
        let (words, rest) = ((until - start) / BITS, (until - start) % BITS);
        let whole = self.matches.iter().take(words as usize).map(|it| it.count_ones()).sum::<u32>();
        let last = self.matches.get(words as usize).map_or(0, |word| word & ((1 << rest) - 1));
        u64::from(whole + last.count_ones())
    }

    fn push(&mut self, start: u64, is_match: bool) {
        let at = self.end - start;
        if at.is_multiple_of(BITS) {
            self.matches.push(0);
        }
        if let Some(word) = self.matches.last_mut()
            && is_match
        {
            *word |= 1 << (at % BITS);
            self.count += 1;
        }
        self.end += 1;
    }
}

/// The frames that match a filter.
#[derive(Debug, Default)]
pub(super) struct FilteredFrames {
    filter: Filter,
    /// Prepared for what was known of the buses.
    matcher: Option<FrameMatcher>,
    /// Revisions of the names that were known when the frames were tested, where they count.
    names: u64,
    /// By the number of the first frame.
    tested: BTreeMap<u64, TestedRange>,
    /// Generation of the store that the ranges are of.
    generation: u64,
    /// True if only the newest frames are not tested.
    is_complete: bool,
    /// Devices send DEBUG messages so often that others would not be seen.
    limits_debug: bool,
}

impl FilteredFrames {
    /// Sets the filter; `None` for all frames.
    pub fn set(&mut self, filter: Option<&Filter>) {
        let filter = filter.cloned().unwrap_or_default();
        if self.filter != filter {
            let limits_debug = self.limits_debug;
            *self = Self { filter, limits_debug, ..Self::default() };
        }
    }

    /// Limits the DEBUG messages that are shown without a filter, or does not.
    pub fn limit_debug(&mut self, limits_debug: bool) {
        if self.limits_debug != limits_debug {
            let filter = std::mem::take(&mut self.filter);
            *self = Self { filter, limits_debug, ..Self::default() };
        }
    }

    /// Returns true if there is a filter, or DEBUG messages are limited.
    pub fn is_on(&self) -> bool {
        !self.filter.is_empty() || self.limits_debug
    }

    /// Returns true if DEBUG messages are limited.
    pub fn is_debug_limited(&self) -> bool {
        self.filter.is_empty() && self.limits_debug
    }

    /// Tests frames that were not tested, those before number `end` first, and of these the newest.
    /// Returns false if some remain.
    pub fn test(&mut self, store: &FrameStore, buses: &Buses, end: u64) -> bool {
        let names = buses.names_revision();
        if self.filter.needs_names() && self.names != names {
            self.tested.clear();
            self.is_complete = false;
        }
        self.names = names;
        let matcher = self.matcher.take().filter(|matcher| matcher.is_current(buses));
        let matcher = matcher.unwrap_or_else(|| self.filter.for_frames(buses));
        let is_complete = self.test_with(&matcher, store, end);
        self.matcher = Some(matcher);
        is_complete
    }

    fn test_with(&mut self, matcher: &FrameMatcher, store: &FrameStore, end: u64) -> bool {
        if self.generation != store.generation() {
            let kept: BTreeMap<u64, u64> = store.ranges().map(|it| (it.start, it.end)).collect();
            let is_kept = |start: &u64, range: &TestedRange| {
                kept.get(start).is_some_and(|end| range.end <= *end)
            };
            self.tested.retain(|start, range| is_kept(start, range));
            self.generation = store.generation();
            self.is_complete = false;
        }
        let mut budget = PART;
        // If only the newest are not tested, they come first.
        let end = if self.is_complete { u64::MAX } else { end };
        let before = store.ranges().rev().filter(|range| range.start < end);
        let behind = store.ranges().rev().take_while(|range| range.start >= end);
        for range in before.chain(behind) {
            let tested = self.tested.get(&range.start).map_or(range.start, |it| it.end);
            if tested == range.end {
                if self.is_complete {
                    break;
                }
                continue;
            }
            if budget == 0 {
                self.is_complete = false;
                return false;
            }
            budget = budget.saturating_sub(range.end - tested);
            self.test_range(store, matcher, range);
        }
        self.is_complete = true;
        true
    }

    fn test_range(&mut self, store: &FrameStore, matcher: &FrameMatcher, range: Range<u64>) {
        let limits_debug = self.is_debug_limited();
        let new = TestedRange { end: range.start, ..TestedRange::default() };
        let tested = self.tested.entry(range.start).or_insert(new);
        let untested = (range.end - tested.end) as usize;
        for (number, frame) in store.frames_from(tested.end).take(untested) {
            let is_match = if limits_debug {
                !tested.is_debug_repeated(&frame, matcher)
            } else {
                matcher.is_match(&frame, Some((store, number)))
            };
            tested.push(range.start, is_match);
        }
    }

    /// Number of tested frames before number `until` that do not match.
    pub fn hidden(&self, until: u64) -> u64 {
        let ranges = self.tested.range(..until);
        ranges.map(|(start, range)| until.min(range.end) - start - range.count(*start, until)).sum()
    }

    /// Returns true if a frame matches.
    pub fn contains(&self, number: u64) -> bool {
        let range = self.tested.range(..=number).next_back();
        range.is_some_and(|(start, range)| number < range.end && range.matches(*start, number))
    }

    /// Returns true if all frames are tested, and none before number `end` matches.
    pub fn has_no_match(&self, end: u64) -> bool {
        self.is_complete && self.before(end).next().is_none()
    }

    /// The matching frame before number `end` that is nearest in time to this one; `None` as long as it is not
    /// known.
    pub fn nearest(&self, store: &FrameStore, number: u64, end: u64) -> Option<u64> {
        if self.contains(number) {
            return Some(number);
        }
        let (before, after) =
            (self.before(number).next(), self.from(number).next().filter(|it| *it < end));
        let time = store.time_of(number).filter(|_| self.is_complete)?;
        let distance = |other: u64| {
            let other = store.time_of(other)?;
            Some(other.since(time).max(time.since(other)))
        };
        let near = before.into_iter().chain(after);
        near.min_by_key(|other| distance(*other))
    }

    /// Numbers of the matching frames from `from` on, oldest first.
    pub fn from(&self, from: u64) -> impl Iterator<Item = u64> {
        self.tested.iter().filter(move |(_, range)| range.end > from && range.count > 0).flat_map(
            move |(&start, range)| {
                (start.max(from)..range.end).filter(move |number| range.matches(start, *number))
            },
        )
    }

    /// Numbers of the matching frames before `until`, newest first.
    pub fn before(&self, until: u64) -> impl Iterator<Item = u64> {
        self.tested.range(..until).rev().filter(|(_, range)| range.count > 0).flat_map(
            move |(&start, range)| {
                let numbers = (start..range.end.min(until)).rev();
                numbers.filter(move |number| range.matches(start, *number))
            },
        )
    }
}
