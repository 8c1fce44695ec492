//! Resolution of the times of the frames of one bus, as the times themselves show it: those of a
//! log in steps of a tenth of a second, or of the clock of a system, are multiples of it from each other.

use super::rhythm;
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use std::fmt;

/// Step from which on it is a power of ten: two senders alone, a fifth of a second apart, are in steps
/// of as much, too.
const DECIMAL: u64 = 100_000;
/// Resolution of equal times.
const UNKNOWN: Duration = Duration::from_secs(1_000);
/// Shortest one that is told from the microsecond: less than any judged interval depends on.
const FINEST: u64 = 100;

/// Number of frames whose times in steps are worth a word. Chosen: fewer have them by chance, or by hand.
const MIN_FRAMES: u32 = 100;

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
    /// Number of frames since, while that is no fine one.
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
        if (1..=FINEST).contains(&self.divisor) || !self.is_timed {
            return;
        }
        self.frames = self.frames.saturating_add(1);
        let first = *self.first.get_or_insert(now);
        self.divisor = gcd(now.as_micros().abs_diff(first.as_micros()), self.divisor);
    }

    /// Returns the resolution of the time of the last frame; `None` if that has no time. Of equal times
    /// it is longer than any period.
    pub fn of_last_frame(&self) -> Option<Duration> {
        let micros = match self.divisor {
            0 => return self.is_timed.then_some(UNKNOWN),
            short if short < DECIMAL => short,
            long => {
                let powers = std::iter::successors(Some(DECIMAL), |power| power.checked_mul(10));
                let dividing = powers.take_while(|power| long.is_multiple_of(*power));
                // A part of a tenth of a second is a divisor of the step.
                dividing.last().unwrap_or_else(|| gcd(long, DECIMAL))
            }
        };
        self.is_timed.then_some(Duration::from_micros(micros))
    }

    /// Returns what is doubtful of the times of the frames so far.
    pub fn doubt(&self) -> Option<TimeDoubt> {
        match self.of_last_frame() {
            None => Some(TimeDoubt::NoTimes),
            Some(step) if step > rhythm::MAX_RESOLUTION && self.frames >= MIN_FRAMES => {
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
