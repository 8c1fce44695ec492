//! Resolution of the times of the frames of one bus, as the times themselves show it: those of a
//! log in whole tenths of a second are multiples of a tenth from each other.

use super::rhythm;
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use std::fmt;

/// Longest resolution that is told from an unknown one: longer than any period.
const COARSEST: u64 = 1_000_000_000;
/// Shortest one that is told from the microsecond: less than any judged interval depends on.
const FINEST: u64 = 100;
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
            Self::Coarse(step) => write!(f, "times in steps of {step:?}")?,
        }
        write!(f, ": devices at one address that differ only in when they send may not be found")
    }
}

/// Resolution of the times of the frames of one bus.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimeResolution {
    /// Time of the first frame; `None` before it.
    first: Option<Instant>,
    /// Longest power of ten, in microseconds, of which all times since are multiples.
    micros: u64,
    /// True if the last frame has a time.
    is_timed: bool,
}

impl TimeResolution {
    pub const fn new() -> Self {
        Self { first: None, micros: COARSEST, is_timed: true }
    }

    /// Notes a frame received at `now`.
    #[inline]
    pub fn note(&mut self, now: Instant, frame: &Frame) {
        self.is_timed = !frame.is_timeless;
        if self.micros <= FINEST || !self.is_timed {
            return;
        }
        let first = *self.first.get_or_insert(now);
        let micros = now.as_micros().abs_diff(first.as_micros());
        while self.micros > FINEST && !micros.is_multiple_of(self.micros) {
            self.micros /= 10;
        }
    }

    /// Returns the resolution of the time of the last frame; `None` if that has no time.
    pub fn of_last_frame(&self) -> Option<Duration> {
        self.is_timed.then_some(Duration::from_micros(self.micros))
    }

    /// Returns what is doubtful of the times of the frames so far.
    pub fn doubt(&self) -> Option<TimeDoubt> {
        match self.of_last_frame() {
            None => Some(TimeDoubt::NoTimes),
            Some(step) if self.micros < COARSEST && step > rhythm::MAX_RESOLUTION => {
                Some(TimeDoubt::Coarse(step))
            }
            Some(_) => None,
        }
    }
}
