//! Times in which the bus was down, and nothing could be received.
//!
//! Inputs: when the bus went down and came back. Output: for how long it was down since a moment, which does
//! not count for the age of what was received before. Bounded: the last [`MAX_OUTAGES`] outages; the time
//! of earlier ones counts, so that nothing becomes younger.

use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// Number of outages that are stored. A controller at 1 Mbit/s is on the bus for 3 ms at least, in 32 frames with
/// errors, before it is bus-off: for longer than five periods of 1 s in so many times.
const MAX_OUTAGES: usize = 2048;

/// Tolerance of the reported begin and end of an outage. Twice the shortest interval at which the
/// state of a SocketCAN interface is read.
const TOLERANCE: Duration = Duration::from_millis(200);

/// An outage that is over.
#[derive(Clone, Copy, Debug)]
struct Outage {
    from: Instant,
    until: Instant,
    /// Duration of this outage and of all before.
    total: Duration,
}

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub(super) struct Outages {
    since: Option<Instant>,
    past: VecDeque<Outage>,
}

impl Outages {
    /// Starts an outage, unless one is going on.
    pub fn begin(&mut self, now: Instant) {
        self.since.get_or_insert(now);
    }

    /// Ends the outage. Returns true if there was one.
    pub fn end(&mut self, now: Instant) -> bool {
        let Some(from) = self.since.take() else { return false };
        let total = self.total() + now.since(from);
        self.past.push_back(Outage { from, until: now, total });
        if self.past.len() > MAX_OUTAGES {
            self.past.pop_front();
        }
        true
    }

    /// Returns true during an outage.
    pub fn is_on(&self) -> bool {
        self.since.is_some()
    }

    /// Returns true if a frame received at that time shows that the outage is over, whatever the
    /// adapter reports.
    pub fn is_contradicted_by(&self, received: Instant) -> bool {
        self.since.is_some_and(|since| received >= since)
    }

    /// Returns for how long the bus was down since `then`, without an outage that is going on.
    pub fn time_down_since(&self, then: Instant) -> Duration {
        let first = self.past.partition_point(|outage| outage.until <= then);
        let Some(outage) = self.past.get(first) else { return Duration::ZERO };
        outage.until.since(then.max(outage.from)) + self.total().saturating_sub(outage.total)
    }

    /// Returns for how long the bus was down since `then`, up to `now`.
    pub fn time_down_between(&self, then: Instant, now: Instant) -> Duration {
        let present = self.since.map(|since| now.since(since.max(then)));
        self.time_down_since(then) + present.unwrap_or_default()
    }

    /// Returns a moment at which what happened at `at` is as old as it was with the bus down meanwhile.
    pub fn shifted(&self, at: Instant) -> Instant {
        // Most buses have none.
        if self.past.is_empty() { at } else { at + self.time_down_since(at) }
    }

    fn total(&self) -> Duration {
        self.past.back().map(|last| last.total).unwrap_or_default()
    }

    /// Returns how many heartbeats, due between `last` and `now` every `period`, fell into outages.
    pub fn heartbeats_missed(&self, last: Instant, now: Instant, period: Duration) -> u64 {
        let steps = |until: Instant| until.since(last).as_nanos() / period.as_nanos().max(1);
        let most = steps(now + period / 2).saturating_sub(1);
        let first = self.past.partition_point(|outage| outage.until + TOLERANCE <= last);
        let mut counted = 0;
        let missed = self.past.iter().skip(first).map(|outage| {
            // Two close outages do not count a heartbeat twice.
            let before = steps(outage.from - TOLERANCE).max(counted);
            counted = steps(outage.until + TOLERANCE).min(most).max(before);
            counted - before
        });
        u64::try_from(missed.sum::<u128>()).unwrap_or(u64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::{Duration, Instant, MAX_OUTAGES, Outages};

    fn at(millis: u64) -> Instant {
        Instant::ZERO + Duration::from_millis(millis)
    }

    /// Down for 9 of each 10 ms, this many times.
    fn flapping(times: u64) -> Outages {
        let mut outages = Outages::default();
        for number in 0..times {
            outages.begin(at(number * 10 + 1));
            assert!(outages.end(at(number * 10 + 10)));
        }
        outages
    }

    #[test]
    fn time_of_outages_since_a_moment_is_exact() {
        let outages = flapping(5);
        for (then, expected) in [(0, 45), (1, 45), (2, 44), (10, 36), (11, 36), (45, 5), (50, 0)] {
            assert_eq!(
                outages.time_down_since(at(then)),
                Duration::from_millis(expected),
                "{then}"
            );
        }
        assert_eq!(outages.shifted(at(2)), at(46));
    }

    #[test]
    fn outage_that_goes_on_counts_up_to_now() {
        let mut outages = flapping(1);
        outages.begin(at(20));
        assert_eq!(outages.time_down_since(at(0)), Duration::from_millis(9));
        assert_eq!(outages.time_down_between(at(0), at(50)), Duration::from_millis(39));
        assert_eq!(outages.time_down_between(at(30), at(50)), Duration::from_millis(20));
    }

    #[test]
    fn nothing_becomes_younger_by_further_outages() {
        let mut outages = Outages::default();
        let moments = [0, 5, 500, 9999, 20_000];
        let mut ages = [Duration::ZERO; 5];
        for number in 0..3 * MAX_OUTAGES as u64 {
            outages.begin(at(number * 10 + 1));
            outages.end(at(number * 10 + 10));
            let now = at(number * 10 + 10);
            for (then, age) in
                moments.into_iter().zip(&mut ages).filter(|(then, _)| at(*then) < now)
            {
                let new = now.since(outages.shifted(at(then)));
                assert!(new >= *age, "{then} at {now}: {new:?} after {age:?}");
                *age = new;
            }
        }
        assert!(outages.past.len() <= MAX_OUTAGES);
        let end = 30 * MAX_OUTAGES as u64;
        let recent = end - 10 * (MAX_OUTAGES as u64 - 1);
        let expected = Duration::from_millis((end - recent) * 9 / 10);
        assert_eq!(outages.time_down_since(at(recent)), expected);
    }
}
