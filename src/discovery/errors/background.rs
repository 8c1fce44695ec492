//! Errors outside of windows, while no single address is expected to send.

use crate::time::{Duration, Instant};

/// Time in which a run of failed frames counts as one cause, and its maximum count. A controller
/// repeats a destroyed frame at once: 32 times take 40 ms at 125 kbit/s.
const RUN_TIME: Duration = Duration::from_millis(50);
pub(super) const MAX_RUN_COUNT: f64 = 3.0;
/// Half-life of the errors and frames counted. As `MEMORY_SECONDS`.
const HALF_LIFE: Duration = Duration::from_secs(10);

/// Decaying count of the errors outside of windows.
#[derive(Clone, Debug, Default)]
pub(super) struct Background {
    pub(super) broken: f64,
    pub(super) frames: f64,
    /// Number of frames counted so far.
    pub(super) counted: u64,
    pub(super) at: Instant,
    /// Present run of failed frames: its begin, the number of its last frame, and its count so far.
    pub(super) run: (Instant, u64, f64),
}

impl Background {
    /// Applies the decay up to `now`, and counts frames up to number `frames`.
    pub(super) fn advance(&mut self, now: Instant, frames: u64) {
        let passed = now.since(self.at).as_secs_f64() / HALF_LIFE.as_secs_f64();
        let left = 0.5f64.powf(passed);
        self.at = self.at.max(now);
        self.broken *= left;
        self.frames = self.frames * left + frames.saturating_sub(self.counted) as f64;
        self.counted = frames;
    }

    /// Counts a failed frame, number `number` of all. Of frames that fail one after the other only
    /// some count: one cause fails them all, unless it continues.
    pub(super) fn count(&mut self, now: Instant, broken: u64, number: u64) {
        let (began, last, counted) = self.run;
        let goes_on = number == last + 1 && now.since(began) < RUN_TIME;
        let (began, counted) = if goes_on { (began, counted) } else { (now, 0.0) };
        let more = (broken as f64).min(MAX_RUN_COUNT - counted);
        self.broken += more;
        self.run = (began, number, counted + more);
    }

    /// Returns true if next to nothing fails outside of windows.
    pub(super) fn is_clean(&self) -> bool {
        self.broken <= 3.0 + (0.02 * self.frames).min(9.0)
    }
}
