//! The stored frames that match a filter.
//!
//! Inputs: the filter line, the stored frames. Frames are tested once, the newest first, in parts
//! that are small enough for a key to be handled between them. A bit per frame is kept.

use super::frame_store::FrameStore;
use crate::app::buses::Buses;
use crate::app::filter::Filter;
use std::collections::BTreeMap;
use std::ops::Range;

/// Most frames that are tested at once: some milliseconds.
const PART: u64 = 4096;
const BITS: u64 = u64::BITS as u64;

/// Frames with consecutive numbers that were tested.
#[derive(Debug, Default)]
struct TestedRange {
    /// Number behind the last one tested.
    end: u64,
    /// A bit for each frame, set if it matches.
    matches: Vec<u64>,
    count: u64,
}

impl TestedRange {
    fn matches(&self, start: u64, number: u64) -> bool {
        let at = number - start;
        let word = self.matches.get((at / BITS) as usize);
        word.is_some_and(|word| word >> (at % BITS) & 1 != 0)
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
    line: String,
    filter: Filter,
    /// By the number of the first frame.
    tested: BTreeMap<u64, TestedRange>,
    /// Generation of the store that the ranges are of.
    generation: u64,
    /// True if only the newest frames are not tested.
    is_complete: bool,
}

impl FilteredFrames {
    /// Sets the filter line.
    pub fn set(&mut self, line: &str) {
        if self.line != line {
            *self = Self { line: line.to_owned(), filter: Filter::parse(line), ..Self::default() };
        }
    }

    /// Tests frames that were not tested, the newest first. Returns false if some remain.
    pub fn test(&mut self, store: &FrameStore, buses: &Buses) -> bool {
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
        for range in store.ranges().rev() {
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
            self.test_range(store, buses, range);
        }
        self.is_complete = true;
        true
    }

    fn test_range(&mut self, store: &FrameStore, buses: &Buses, range: Range<u64>) {
        let new = TestedRange { end: range.start, ..TestedRange::default() };
        let tested = self.tested.entry(range.start).or_insert(new);
        let untested = (range.end - tested.end) as usize;
        for (_, frame) in store.frames_from(tested.end).take(untested) {
            tested.push(range.start, self.filter.matches_frame(buses, &frame));
        }
    }

    /// Number of tested frames that do not match.
    pub fn hidden(&self) -> u64 {
        self.tested.iter().map(|(start, range)| range.end - start - range.count).sum()
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
