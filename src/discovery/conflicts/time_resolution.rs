//! Resolution of the times of the frames of one bus, as the times themselves show it: those of a
//! log in steps of a tenth of a second, or of the clock of a system, are multiples of it from each other.

use crate::frame::Frame;
use crate::time::{Duration, Instant};
use std::fmt;

/// Shortest step, in microseconds, that counts as a power of ten: the times of two senders alone, 200 ms
/// apart, are multiples of 200 ms at any resolution.
const MIN_DECIMAL_STEP: u64 = 100_000;
/// Resolution while all times are equal: longer than any period.
const UNKNOWN_RESOLUTION: Duration = Duration::from_secs(1_000);
/// Longest step, in microseconds, that no verdict depends on. Shorter ones are not measured.
const MAX_FINE_STEP: u64 = 100;
/// Smallest number of frames after which coarse times are reported. Chosen: shorter logs have them by
/// chance, or were written by hand.
const MIN_REPORTED_FRAMES: u32 = 100;
/// Longest resolution of times that show the number of senders by that of their heartbeats, and copies by
/// their delay: a tenth of the longest delay of copies with a constant RND7.
const MAX_RESOLUTION: Duration = Duration::from_millis(10);
/// The same as part of a period. Chosen: so that the rounding of an interval is less than the difference
/// between the intervals of two senders.
const MIN_STEPS_OF_PERIOD: u32 = 40;

/// Returns true if times with this resolution show neither copies nor the number of senders, only
/// that heartbeats alternate.
pub(super) fn is_coarse(resolution: Duration, period: Duration) -> bool {
    resolution > MAX_RESOLUTION || resolution * MIN_STEPS_OF_PERIOD > period
}

/// Why the times of the frames of one bus do not show some conflicts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeDoubt {
    /// They have none.
    NoTimes,
    /// They are in steps of this length.
    Coarse(Duration),
}

/// Formats the doubt, and what it is about.
impl fmt::Display for TimeDoubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoTimes => write!(f, "without times")?,
            Self::Coarse(step) => write!(f, "times in steps of {} ms", step.as_secs_f64() * 1e3)?,
        }
        write!(f, ": devices at one address that differ only in when they send may not be found")
    }
}

/// Resolution of the times of the frames of one bus.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimeResolution {
    /// Time of the first frame; `None` before it.
    first: Option<Instant>,
    /// Greatest common divisor of the times since, in microseconds; 0 while all are equal.
    divisor: u64,
    /// Number of frames noted while the divisor was longer than [`MAX_FINE_STEP`].
    frames: u32,
    /// True if the last frame has a time.
    is_timed: bool,
}

impl TimeResolution {
    pub const fn new() -> Self {
        Self { first: None, divisor: 0, frames: 0, is_timed: true }
    }

    /// Notes a frame received at `now`.
    #[inline]
    pub fn note(&mut self, now: Instant, frame: &Frame) {
        self.is_timed = !frame.is_timeless;
        if (1..=MAX_FINE_STEP).contains(&self.divisor) || !self.is_timed {
            return;
        }
        self.frames = self.frames.saturating_add(1);
        let first = *self.first.get_or_insert(now);
        self.divisor = gcd(now.as_micros().abs_diff(first.as_micros()), self.divisor);
    }

    /// Returns the resolution of the time of the last frame; `None` if that has no time.
    pub fn of_last_frame(&self) -> Option<Duration> {
        let micros = match self.divisor {
            0 => return self.is_timed.then_some(UNKNOWN_RESOLUTION),
            short if short < MIN_DECIMAL_STEP => short,
            long => {
                let powers =
                    std::iter::successors(Some(MIN_DECIMAL_STEP), |power| power.checked_mul(10));
                let dividing = powers.take_while(|power| long.is_multiple_of(*power));
                // 250 ms and the like are not: 50 ms divides both.
                dividing.last().unwrap_or_else(|| gcd(long, MIN_DECIMAL_STEP))
            }
        };
        self.is_timed.then_some(Duration::from_micros(micros))
    }

    /// Returns what is doubtful of the times of the frames so far.
    pub fn doubt(&self) -> Option<TimeDoubt> {
        match self.of_last_frame() {
            None => Some(TimeDoubt::NoTimes),
            Some(step) if step > MAX_RESOLUTION && self.frames >= MIN_REPORTED_FRAMES => {
                Some(TimeDoubt::Coarse(step))
            }
            Some(_) => None,
        }
    }
}

/// Returns the greatest common divisor; that of 0 and another number is the other one.
const fn gcd(mut one: u64, mut other: u64) -> u64 {
    while other != 0 {
        (one, other) = (other, one % other);
    }
    one
}
