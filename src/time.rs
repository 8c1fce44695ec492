//! Moments and durations, in microseconds since a start.
//!
//! Time is an argument everywhere: no clock is read here. For wall-clock time (display, logs,
//! JSON), an [`Epoch`] has the Unix time of the start.

use core::fmt;
use core::ops::{Add, AddAssign, Sub};
pub use core::time::Duration;

/// A moment: microseconds since the start of the session, the log or the simulation.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Instant(u64);

impl Instant {
    /// The start.
    pub const ZERO: Instant = Instant(0);
    /// The latest moment of an input. Sums with any period of the program are later, so a deadline is
    /// never at the moment itself because it saturated.
    pub const LATEST: Instant = Instant(u64::MAX / 2);

    /// Returns the moment `micros` microseconds after the start.
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// Returns the microseconds since the start.
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Returns the seconds since the start.
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / 1e6
    }

    /// Returns the duration since `earlier`; zero if `earlier` is later.
    pub const fn since(self, earlier: Instant) -> Duration {
        Duration::from_micros(self.0.saturating_sub(earlier.0))
    }
}

impl Add<Duration> for Instant {
    type Output = Instant;
    fn add(self, rhs: Duration) -> Instant {
        Instant(self.0.saturating_add(u64::try_from(rhs.as_micros()).unwrap_or(u64::MAX)))
    }
}

impl AddAssign<Duration> for Instant {
    fn add_assign(&mut self, rhs: Duration) {
        *self = *self + rhs;
    }
}

impl Sub<Duration> for Instant {
    type Output = Instant;
    fn sub(self, rhs: Duration) -> Instant {
        Instant(self.0.saturating_sub(u64::try_from(rhs.as_micros()).unwrap_or(u64::MAX)))
    }
}

impl fmt::Debug for Instant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

/// Seconds with microseconds: `12.000345`.
impl fmt::Display for Instant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{:06}", self.0 / 1_000_000, self.0 % 1_000_000)
    }
}

/// Checks in debug builds that a state machine has no deadline at or before `now`, up to which its
/// timers were handled: otherwise its caller would call it without end.
///
/// # Panics
///
/// In debug builds, if there is such a deadline.
#[cfg(feature = "std")]
#[track_caller]
pub(crate) fn debug_assert_later(due: Option<Instant>, now: Instant) {
    debug_assert!(due.is_none_or(|due| due > now), "due at {due:?}, handled until {now:?}");
}

/// The Unix time of [`Instant::ZERO`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Epoch {
    unix_micros: u64,
}

impl Epoch {
    /// Creates an epoch `micros` microseconds after 1970-01-01 00:00 UTC.
    pub const fn from_unix_micros(micros: u64) -> Self {
        Self { unix_micros: micros }
    }

    /// Returns the Unix time of `at`, in microseconds.
    pub const fn unix_micros(self, at: Instant) -> u64 {
        self.unix_micros.saturating_add(at.0)
    }

    /// Returns the Unix time of `at`, in seconds, exact to the microsecond.
    pub fn unix_secs(self, at: Instant) -> f64 {
        self.unix_micros(at) as f64 / 1e6
    }

    /// Returns the microseconds from the start to a Unix time in microseconds; negative before the
    /// start.
    pub fn since_start(self, micros: u64) -> i128 {
        i128::from(micros) - i128::from(self.unix_micros)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instant_prints_whole_microseconds() {
        assert_eq!(Instant::from_micros(12_000_345).to_string(), "12.000345");
    }

    #[test]
    fn instant_saturates_at_the_start() {
        let at = Instant::from_micros(5);
        assert_eq!(at - Duration::from_secs(1), Instant::ZERO);
        assert_eq!(at.since(Instant::from_micros(9)), Duration::ZERO);
        assert_eq!(Epoch::from_unix_micros(100).since_start(7), -93);
    }
}
