//! Times in which the bus was down, and nothing could be received.
//!
//! Inputs: when the bus went down and came back. Output: for how long it was down since a moment, of which
//! the age of what was received before does not count. Bounded: of the oldest outages only the first
//! begin and the last end are known; what was received between is as old as that end.

use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// Number of outages that are stored. A controller that goes bus-off again and again, and receives during a
/// tenth of the time, has this many while a device with a period of 1 s becomes lost.
const MAX_OUTAGES: usize = 512;

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
        if self.past.len() > MAX_OUTAGES
            && let Some(oldest) = self.past.pop_front()
            && let Some(next) = self.past.front_mut()
        {
            next.from = oldest.from;
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
        self.since.is_some_and(|since| received > since)
    }

    /// Returns for how long the bus was down since `then`, without an outage that is going on.
    pub fn since(&self, then: Instant) -> Duration {
        let first = self.past.partition_point(|outage| outage.until <= then);
        let Some(outage) = self.past.get(first) else { return Duration::ZERO };
        outage.until.since(then.max(outage.from)) + self.total().saturating_sub(outage.total)
    }

    /// Returns for how long the bus was down since `then`, up to `now`.
    pub fn until(&self, then: Instant, now: Instant) -> Duration {
        let present = self.since.map(|since| now.since(since.max(then)));
        self.since(then) + present.unwrap_or_default()
    }

    /// Returns a moment at which what happened at `at` is as old as it was with the bus down meanwhile.
    pub fn shifted(&self, at: Instant) -> Instant {
        // Most buses have none.
        if self.past.is_empty() { at } else { at + self.since(at) }
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
            assert_eq!(outages.since(at(then)), Duration::from_millis(expected), "{then}");
        }
        assert_eq!(outages.shifted(at(2)), at(46));
    }

    #[test]
    fn outage_that_goes_on_counts_up_to_now() {
        let mut outages = flapping(1);
        outages.begin(at(20));
        assert_eq!(outages.since(at(0)), Duration::from_millis(9));
        assert_eq!(outages.until(at(0), at(50)), Duration::from_millis(39));
        assert_eq!(outages.until(at(30), at(50)), Duration::from_millis(20));
    }

    #[test]
    fn many_outages_are_never_counted_as_less() {
        let times = 3 * MAX_OUTAGES as u64;
        let outages = flapping(times);
        assert!(outages.past.len() <= MAX_OUTAGES);
        let end = times * 10;
        for then in (0..end).step_by(7) {
            let exact = (then..end).filter(|milli| milli % 10 != 0).count();
            let known = outages.since(at(then));
            assert!(known >= Duration::from_millis(exact as u64), "{then}: {known:?} {exact}");
            assert!(known <= at(end).since(at(then)), "{then}");
        }
        let recent = end - 10 * (MAX_OUTAGES as u64 - 1);
        assert_eq!(outages.since(at(recent)), Duration::from_millis((end - recent) * 9 / 10));
    }
}
