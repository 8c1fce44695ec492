//! Maps timestamps of a remote clock (adapter, server) to descan's clock, in microseconds.
//!
//! The least delayed frame of the last 10 to 20 s sets the offset; all others keep their distance to
//! it. So buffering on USB or TCP does not appear as heartbeat jitter. Only differences count: the
//! remote clock may have any origin. A clock that jumps back restarts the window.

use crate::time::{Duration, Instant};

/// How long the least delayed frame counts; twice that at most. Two clocks drift apart by less than
/// a few milliseconds in that time.
const WINDOW: Duration = Duration::from_secs(10);
/// Microseconds. A larger delay means that the remote clock was set back.
const MAX_DELAY: i64 = 5_000_000;

/// The offset of a remote clock, as far as its timestamps show it.
#[derive(Debug, Default)]
pub(in crate::bus) struct RemoteClock {
    window: Instant,
    /// The smallest difference between arrival and stamp in this window and the one before, in
    /// microseconds.
    fastest: Option<i64>,
    fastest_before: Option<i64>,
}

impl RemoteClock {
    /// The time at which a frame was on the bus: its timestamp, in microseconds of any origin, on
    /// descan's clock. Never later than `arrival`.
    pub fn local_time(&mut self, stamp_micros: i64, arrival: Instant) -> Instant {
        if arrival.since(self.window) >= WINDOW {
            self.window = arrival;
            self.fastest_before = self.fastest.take();
        }
        let arrived = i64::try_from(arrival.as_micros()).unwrap_or(i64::MAX);
        let difference = arrived.saturating_sub(stamp_micros);
        let fastest = [Some(difference), self.fastest, self.fastest_before];
        let fastest = fastest.into_iter().flatten().min().unwrap_or(difference);
        let delay = difference.saturating_sub(fastest);
        if delay > MAX_DELAY {
            *self = Self { window: arrival, fastest: Some(difference), fastest_before: None };
            return arrival;
        }
        self.fastest = Some(self.fastest.map_or(difference, |known| known.min(difference)));
        arrival - Duration::from_micros(delay.unsigned_abs())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> Instant {
        Instant::from_micros(millis.unsigned_abs() * 1000)
    }

    #[test]
    fn frames_delivered_together_keep_their_distance() {
        let mut clock = RemoteClock::default();
        let offset = 1_700_000_000_000_000;
        // On the bus at 100, 110, 120 ms; 2 ms of way, then a line that delivers at 150 ms.
        assert_eq!(clock.local_time(offset + 100_000, at(102)), at(102));
        assert_eq!(clock.local_time(offset + 110_000, at(150)), at(112));
        assert_eq!(clock.local_time(offset + 120_000, at(150)), at(122));
    }

    #[test]
    fn clock_that_was_set_is_followed_again() {
        let mut clock = RemoteClock::default();
        assert_eq!(clock.local_time(50_000_000, at(1_000)), at(1_000));
        // Set forward: at once.
        assert_eq!(clock.local_time(90_000_000, at(2_000)), at(2_000));
        // Set back by much: at once. By little: when what was fast before is forgotten.
        assert_eq!(clock.local_time(10_000_000, at(3_000)), at(3_000));
        assert_eq!(clock.local_time(10_000_000, at(4_000)), at(3_000));
        assert_eq!(clock.local_time(20_000_000, at(14_000)), at(13_000));
        assert_eq!(clock.local_time(30_000_000, at(24_000)), at(24_000));
    }

    #[test]
    fn wrong_timestamps_never_give_a_future_time() {
        let mut clock = RemoteClock::default();
        for (step, stamp) in (0..).zip([0, i64::MAX, i64::MIN, 5, i64::MAX, 0]) {
            let arrival = at(step * 100);
            assert!(clock.local_time(stamp, arrival) <= arrival);
        }
    }
}
