//! Moments around the evidence of findings, whose frames are kept longer than others: the buses before
//! the first of these frames, and the inputs between them.
//!
//! Bounded in bytes: of more the oldest range is dropped. Does not know why frames are pinned, nor what
//! inputs do.

use super::buses::Buses;
use super::history::Moment;
use super::journal::PastInput;
use crate::time::Instant;
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

/// A range of consecutive frames, with what is needed to replay it.
#[derive(Clone, Debug)]
pub(super) struct PinnedRange {
    /// Numbers of the frames.
    pub frames: Range<u64>,
    /// Time of the first and of the last frame.
    pub first: Instant,
    pub last: Instant,
    /// Number of inputs before the first frame.
    pub inputs_before: u64,
    /// Buses before the first frame.
    pub buses: Arc<Buses>,
    /// Inputs between the frames, and the number of them that [`size`](Self::size) counts.
    pub inputs: Arc<Vec<PastInput>>,
    size: usize,
}

impl PinnedRange {
    /// Returns an empty range that begins with the frame `first` at a time, of these buses.
    pub fn new(first: u64, time: Instant, inputs_before: u64, buses: Buses) -> Self {
        let size = buses.size();
        let (buses, inputs) = (Arc::new(buses), Arc::default());
        Self { frames: first..first, first: time, last: time, inputs_before, buses, inputs, size }
    }

    /// Returns true if the frames before a moment are in the range, and it is not later than they are.
    fn has(&self, moment: &Moment) -> bool {
        let is_within = moment.frames > self.frames.start && moment.frames <= self.frames.end;
        is_within && moment.time >= self.first && moment.time <= self.last
    }

    /// Appends frames up to the number `end`, with the inputs between them.
    pub fn extend(&mut self, end: u64, last: Instant, inputs: impl Iterator<Item = PastInput>) {
        let all = Arc::make_mut(&mut self.inputs);
        let before = all.len();
        all.extend(inputs);
        self.size += (all.len() - before) * size_of::<PastInput>();
        (self.frames.end, self.last) = (end, last);
    }
}

/// The ranges of pinned frames.
#[derive(Debug, Default)]
pub(super) struct PinnedMoments {
    /// Oldest first.
    ranges: VecDeque<PinnedRange>,
}

impl PinnedMoments {
    /// The last range, if the frame `next` follows it.
    pub fn before(&mut self, next: u64) -> Option<&mut PinnedRange> {
        self.ranges.back_mut().filter(|range| range.frames.end == next)
    }

    /// Appends a range.
    pub fn push(&mut self, range: PinnedRange) {
        self.ranges.push_back(range);
    }

    /// Drops the oldest ranges of more than `room` bytes.
    pub fn drop_surplus(&mut self, room: usize) {
        while self.size() > room {
            self.ranges.pop_front();
        }
    }

    /// Drops the ranges with frames before this one.
    pub fn drop_before(&mut self, frame: u64) {
        while self.ranges.front().is_some_and(|range| range.frames.start < frame) {
            self.ranges.pop_front();
        }
    }

    /// The range in which a moment is.
    pub fn range_of(&self, moment: &Moment) -> Option<&PinnedRange> {
        self.ranges.iter().find(|range| range.has(moment))
    }

    /// Number of inputs before a moment after so many frames, if it is in a range. `is_before` is true
    /// for those inputs, and false for all later ones.
    pub fn inputs_before(
        &self,
        frames: u64,
        is_before: impl Fn(&PastInput) -> bool,
    ) -> Option<u64> {
        let is_within =
            |range: &&PinnedRange| frames > range.frames.start && frames <= range.frames.end;
        let range = self.ranges.iter().find(is_within)?;
        Some(range.inputs_before + range.inputs.partition_point(is_before) as u64)
    }

    /// Bytes of memory.
    pub fn size(&self) -> usize {
        self.ranges.iter().map(|range| range.size).sum()
    }
}
