//! A story: the events that belong together, as steps with their times.
//!
//! Inputs: timeline entries with what they change. Output: the steps until a moment, and with
//! [`summary`](super::summary) the line of the story as of that moment. Bounded:
//! [`Story::MAX_STEPS`] steps; of more the first and the last ones are kept, and the last one of
//! each finding. Does not know which events belong together.

use super::change::StoryChange;
use crate::app::file::FileIndex;
use crate::app::notices::TimelineEntry;
use crate::app::problems::ProblemKey;
use crate::discovery::DeviceId;
use crate::frame::BusIndex;
use crate::time::{Duration, Instant};

/// Time after the last step within which a further event belongs to the story.
pub(super) const ATTACH_WITHIN: Duration = Duration::from_secs(10);
/// Steps at the beginning that are always kept.
const FIRST_STEPS: usize = 8;
/// Times of a repeated step that are kept; of more the first half and the last ones.
const MAX_REPEATS: usize = 16;

/// What joins events to a story.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum StoryKey {
    /// Presence, address and services of a device.
    Device(DeviceId),
    /// Modes of a device.
    Mode(DeviceId),
    /// A problem, and all that happens about its address.
    Problem(ProblemKey),
    /// The address of descan on a bus.
    Own(BusIndex),
    /// Acknowledgement of the frames of descan on a bus.
    Ack(BusIndex),
    /// DEBUG messages with one code.
    Debug(Option<BusIndex>, Option<DeviceId>, u16),
    /// Events with the same text; those about files, of the same des.json.
    Text(Option<BusIndex>, Option<DeviceId>, FileIndex, String),
}

/// A step of a story.
#[derive(Clone, Debug)]
pub struct StoryStep {
    /// Number of the step in its story, from 1.
    pub number: u32,
    /// The event.
    pub entry: TimelineEntry,
    /// What it changed.
    pub change: StoryChange,
    /// How many times the story had begun by then: 2 once it went on after it was over.
    pub cycle: u32,
    /// Times at which the event was repeated.
    repeats: Vec<Instant>,
}

impl StoryStep {
    /// Number of occurrences until a moment.
    pub fn times(&self, at: Instant) -> u32 {
        if at >= self.entry.last {
            return self.entry.times;
        }
        1 + self.repeats.iter().filter(|time| **time <= at).count() as u32
    }

    /// Time of the last occurrence until a moment.
    pub fn last(&self, at: Instant) -> Instant {
        let until = self.repeats.iter().filter(|time| **time <= at);
        until.copied().max().unwrap_or(self.entry.time)
    }

    fn repeat(&mut self, time: Instant) {
        if self.repeats.len() == MAX_REPEATS {
            self.repeats.remove(MAX_REPEATS / 2);
        }
        self.repeats.push(time);
        self.entry.times = self.entry.times.saturating_add(1);
        self.entry.last = self.entry.last.max(time);
    }
}

/// Events that belong together.
#[derive(Clone, Debug)]
pub struct Story {
    /// Number of the story, in the order in which they were created.
    pub id: u64,
    pub(super) key: StoryKey,
    steps: Vec<StoryStep>,
    /// Number of all steps.
    count: u32,
}

impl Story {
    /// Largest number of steps that are kept.
    pub const MAX_STEPS: usize = 24;

    pub(super) fn new(
        id: u64,
        key: StoryKey,
        mut entry: TimelineEntry,
        change: StoryChange,
    ) -> Self {
        (entry.last, entry.times) = (entry.time, 1);
        let step = StoryStep { number: 1, entry, change, cycle: 1, repeats: Vec::new() };
        Self { id, key, steps: vec![step], count: 1 }
    }

    /// Time of the first step.
    pub fn begin(&self) -> Instant {
        self.steps[0].entry.time
    }

    /// The steps that are kept, oldest first.
    pub fn steps(&self) -> &[StoryStep] {
        &self.steps
    }

    /// The steps until a moment, oldest first.
    pub fn steps_until(&self, at: Instant) -> impl DoubleEndedIterator<Item = &StoryStep> {
        self.steps.iter().filter(move |step| step.entry.time <= at)
    }

    /// Time of the last step or its last repetition until a moment; `None` before the first one.
    pub fn last_change(&self, at: Instant) -> Option<Instant> {
        self.steps_until(at).map(|step| step.last(at)).max()
    }

    /// The step with this number; `None` if it was dropped.
    pub fn step(&self, number: u32) -> Option<&StoryStep> {
        self.steps.iter().find(|step| step.number == number)
    }

    pub(super) fn into_steps(self) -> impl Iterator<Item = StoryStep> {
        self.steps.into_iter()
    }

    /// Number of steps that are kept.
    pub(super) fn step_count(&self) -> usize {
        self.steps.len()
    }

    /// Time of the last step.
    pub(super) fn last(&self) -> Instant {
        self.steps.iter().map(|step| step.entry.last).max().unwrap_or_default()
    }

    /// Returns true if an event at a moment may belong to the story although nothing is open.
    pub(super) fn is_recent(&self, at: Instant) -> bool {
        at.since(self.last()) <= ATTACH_WITHIN
    }

    /// Appends a step; one that repeats the last one is counted in it.
    pub(super) fn push(&mut self, mut entry: TimelineEntry, change: StoryChange) {
        let is_over = !self.is_open(entry.time);
        if let Some(last) = self.steps.last_mut() {
            let is_same = last.change == change && last.entry.text == entry.text;
            if is_same && matches!(change, StoryChange::Text | StoryChange::Debug(_)) {
                return last.repeat(entry.time);
            }
        }
        let cycle = self.steps.last().map_or(1, |step| step.cycle);
        self.count = self.count.saturating_add(1);
        (entry.last, entry.times) = (entry.time, 1);
        let repeats = Vec::new();
        let mut step = StoryStep { number: self.count, entry, change, cycle, repeats };
        // What is received with the end belongs to it, such as the reboot of a device that returns.
        let is_later = self.steps.last().is_some_and(|last| last.entry.time < step.entry.time);
        if is_over && is_later && step.change.opens() {
            step.cycle = cycle.saturating_add(1);
        }
        if self.steps.len() == Self::MAX_STEPS {
            self.drop_step();
        }
        self.steps.push(step);
    }

    /// Drops the first step behind the first ones that is not the last one of its finding.
    fn drop_step(&mut self) {
        let is_needed = |at: &usize| {
            let StoryChange::Finding { key, .. } = &self.steps[*at].change else { return false };
            let mut later = self.steps[at + 1..].iter();
            !later.any(
                |step| matches!(&step.change, StoryChange::Finding { key: it, .. } if it == key),
            )
        };
        let dropped = (FIRST_STEPS..self.steps.len()).find(|at| !is_needed(at));
        self.steps.remove(dropped.unwrap_or(FIRST_STEPS));
    }

    /// Assigns the steps before a moment, if given, to another device.
    pub(super) fn reassign(&mut self, was: DeviceId, before: Option<Instant>, device: DeviceId) {
        let is_before = |time: Instant| before.is_none_or(|before| time < before);
        for step in &mut self.steps {
            if step.entry.device == Some(was) && is_before(step.entry.time) {
                step.entry.device = Some(device);
            }
        }
    }
}
