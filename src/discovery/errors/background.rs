//! What breaks while nobody in particular is expected to send.

use crate::time::{Duration, Instant};

/// How long a run of broken frames counts as one thing, and how many frames it counts as.
const RUN: Duration = Duration::from_millis(50);
pub(super) const RUN_COUNTS: f64 = 3.0;
/// How soon what happens outside of windows is forgotten by half.
const HALF_LIFE: Duration = Duration::from_secs(10);

/// What breaks while nobody in particular is expected to send. Decays.
#[derive(Debug, Default)]
pub(super) struct Background {
    pub(super) broken: f64,
    pub(super) frames: f64,
    /// Up to here frames are counted.
    pub(super) counted: u64,
    pub(super) at: Instant,
    /// When the present run of broken frames began, its last one's number, and how much it
    /// counts so far.
    pub(super) run: (Instant, u64, f64),
}

impl Background {
    pub(super) fn advance(&mut self, now: Instant, frames: u64) {
        let passed = now.since(self.at).as_secs_f64() / HALF_LIFE.as_secs_f64();
        let left = 0.5f64.powf(passed);
        self.at = self.at.max(now);
        self.broken *= left;
        self.frames = self.frames * left + frames.saturating_sub(self.counted) as f64;
        self.counted = frames;
    }

    /// Counts a frame that broke, the `number`th of all. Of those that break one after the other
    /// only some count: it is one cause that breaks them, unless it goes on.
    pub(super) fn count(&mut self, now: Instant, broken: u64, number: u64) {
        let (began, last, counted) = self.run;
        let goes_on = number == last + 1 && now.since(began) < RUN;
        let (began, counted) = if goes_on { (began, counted) } else { (now, 0.0) };
        let more = (broken as f64).min(RUN_COUNTS - counted);
        self.broken += more;
        self.run = (began, number, counted + more);
    }

    pub(super) fn is_clean(&self) -> bool {
        self.broken <= 3.0 + (0.02 * self.frames).min(9.0)
    }
}
