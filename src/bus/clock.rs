//! The session's clock, and the dating of frames that the kernel stamped with the wall clock.
//!
//! Does not know what happens at a moment, only which moment it is.

use crate::time::{Duration, Epoch, Instant};
use std::time::{Instant as Monotonic, SystemTime, UNIX_EPOCH};

/// Counts from a start; every port and the loop share one.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Monotonic,
    epoch: Epoch,
    speed: f64,
}

impl Clock {
    /// Starts now.
    pub fn start() -> Self {
        Self::replaying(Epoch::from_unix_micros(wall_micros()), 1.0)
    }

    /// Starts now, but calls this moment `epoch` and runs `speed` times as fast: everything
    /// that is timed by it, ages and time-outs included, keeps the pace of the recording.
    /// A speed that is not a positive number counts as 1.
    pub fn replaying(epoch: Epoch, speed: f64) -> Self {
        let speed = if speed.is_finite() && speed > 0.0 { speed } else { 1.0 };
        Self { start: Monotonic::now(), epoch, speed }
    }

    /// The moment it is.
    pub fn now(&self) -> Instant {
        Instant::ZERO + self.run_in(self.start.elapsed())
    }

    /// Which Unix time the start was.
    pub fn epoch(&self) -> Epoch {
        self.epoch
    }

    /// How far this clock runs in a real `duration`.
    pub fn run_in(&self, duration: Duration) -> Duration {
        duration.mul_f64(self.speed)
    }

    /// How long to sleep until `at`; zero if it has passed.
    pub fn until(&self, at: Instant) -> Duration {
        at.since(self.now()).div_f64(self.speed)
    }
}

/// Dates the frames of one bus by the kernel's stamps.
///
/// A stamp says how old a frame is by the wall clock; the moment is that long before now on the
/// monotonic clock. So a wall clock that somebody sets does not move what was dated before, and
/// moments neither lie in the future nor run backwards.
#[derive(Debug)]
pub struct Dating {
    clock: Clock,
    now: Instant,
    wall_micros: u64,
    last: Instant,
}

impl Dating {
    /// Nothing dated yet.
    pub fn new(clock: Clock) -> Self {
        Self { clock, now: Instant::ZERO, wall_micros: 0, last: Instant::ZERO }
    }

    /// Reads both clocks: once for each batch of frames.
    pub fn read_clocks(&mut self) {
        self.set_clocks(self.clock.now(), wall_micros());
    }

    /// The moment of a frame with this stamp (Unix microseconds); now, where there is none.
    pub fn date(&mut self, stamp_micros: Option<u64>) -> Instant {
        let age = stamp_micros.map_or(0, |stamp| self.wall_micros.saturating_sub(stamp));
        self.last = self.last.max(self.now - Duration::from_micros(age));
        self.last
    }

    fn set_clocks(&mut self, now: Instant, wall_micros: u64) {
        self.now = now;
        self.wall_micros = wall_micros;
    }
}

fn wall_micros() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_micros() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dating_at(now: u64, wall: u64) -> Dating {
        let mut dating = Dating::new(Clock::start());
        dating.set_clocks(Instant::from_micros(now), wall);
        dating
    }

    #[test]
    fn dates_by_age() {
        let mut dating = dating_at(1_000, 5_000);
        assert_eq!(dating.date(Some(4_700)), Instant::from_micros(700));
        assert_eq!(dating.date(Some(4_900)), Instant::from_micros(900));
        assert_eq!(dating.date(None), Instant::from_micros(1_000));
    }

    #[test]
    fn a_set_wall_clock_neither_dates_into_the_future_nor_backwards() {
        let mut dating = dating_at(1_000, 5_000);
        assert_eq!(dating.date(Some(4_900)), Instant::from_micros(900));
        assert_eq!(dating.date(Some(9_999)), Instant::from_micros(1_000));
        dating.set_clocks(Instant::from_micros(2_000), 900_000);
        assert_eq!(dating.date(Some(5_100)), Instant::from_micros(1_000));
    }

    #[test]
    fn a_replaying_clock_is_as_fast_as_asked() {
        let clock = Clock::replaying(Epoch::from_unix_micros(7), 1_000.0);
        assert_eq!(clock.epoch().unix_micros(Instant::ZERO), 7);
        let at = clock.now() + Duration::from_secs(1_000);
        let wait = clock.until(at);
        assert!(wait <= Duration::from_secs(1) && wait > Duration::from_millis(900), "{wait:?}");
    }
}
