//! Heartbeat period of each address: measured by its heartbeats, and before that is possible
//! expected from the profile and from the other addresses (protocol §4.6).
//!
//! A period is the median interval of one phase, measured per UID where several alternate. Two
//! equal devices half a period apart look like one with half the period, so half of the period that
//! was expected is never taken for a period.

use crate::time::Duration;
use crate::wire::id::Address;
use std::collections::VecDeque;

/// Intervals stored per address: with 30 % of the heartbeats lost, seven of nine are single periods
/// in every other window.
const MAX_INTERVALS: usize = 9;
/// Number of them that must agree with the median. Two senders in different phases make at most
/// five of nine agree.
const MIN_AGREEING: usize = 7;
/// Number of equal intervals, without any other, that are enough before the store is full: two of
/// them may be two periods each, because heartbeats were lost, but hardly five.
const MIN_INTERVALS: usize = 5;
/// Deviation of an interval from the median up to which both are one period; heartbeats have a low
/// priority and may wait on a busy bus. Tuned with the simulation.
const TOLERANCE: f64 = 0.15;
/// Deviation up to which the median intervals of devices are one period: they have the same setting,
/// and most of the jitter is not in a median. Tuned with the simulation.
const COMMON_TOLERANCE: f64 = 0.05;
/// Number of addresses whose common period is expected of another. Chosen: one may be special.
const MIN_OTHERS: usize = 2;
/// Number of intervals after one of the profile's period in which longer ones are not a period, but
/// lost heartbeats. With 30 % of the heartbeats lost, nine in a row that are not single periods are
/// rarer than one in 50,000; chosen: three times as many.
const LOSS_MEMORY: u32 = 30;
/// Longest single interval, in periods of the profile, by which presence is judged: two heartbeats
/// a minute apart are more likely those of a device that was off. Chosen.
const MAX_SINGLE: u32 = 10;
/// Longest interval, in periods of the profile, that may be a period, and the largest divisor of
/// one for the shortest: a longer one is an interruption, a shorter one a burst. From 17 ms to a
/// minute, for the default period of 1 s.
const MAX_PERIODS: u32 = 60;

/// Intervals between the heartbeats of one address.
#[derive(Clone, Debug, Default)]
struct Intervals {
    recent: VecDeque<Duration>,
    /// Median interval, if most agree with it.
    median: Option<Duration>,
    /// Period: the median, unless two equal devices explain it.
    measured: Option<Duration>,
    /// True if all stored intervals were known when it was measured.
    is_established: bool,
    /// Number of intervals since one of the profile's period; `None` if there was none.
    since_profile: Option<u32>,
}

impl Intervals {
    /// Returns the median interval, if enough of the stored ones agree with it. More senders make
    /// intervals shorter, so one shorter than `expected` must be without exception in a full store.
    fn regular_interval(&self, expected: Duration) -> Option<Duration> {
        let mut sorted: Vec<Duration> = self.recent.iter().copied().collect();
        sorted.sort_unstable();
        let median = *sorted.get(sorted.len().checked_sub(1)? / 2)?;
        let agreeing = sorted.iter().filter(|interval| is_near(**interval, median)).count();
        let is_shorter = median < expected && !is_near(median, expected);
        let least = match sorted.len() {
            MAX_INTERVALS if !is_shorter => MIN_AGREEING,
            count if count >= MIN_INTERVALS && !is_shorter => count,
            _ => MAX_INTERVALS,
        };
        (agreeing >= least).then_some(median)
    }

    /// Returns true if there are enough intervals and their mean and their median are `period`, as of
    /// a sender with much jitter.
    fn have_mean(&self, period: Duration) -> bool {
        let count = self.recent.len();
        let mean = self.recent.iter().sum::<Duration>().checked_div(count as u32);
        let middle = median(self.recent.iter().copied().collect());
        count >= MIN_INTERVALS
            && mean.is_some_and(|mean| is_near(mean, period))
            && middle.is_some_and(|middle| is_near(middle, period))
    }
}

/// Returns true if an interval is a period, within the tolerance.
fn is_near(interval: Duration, period: Duration) -> bool {
    deviates_by(interval, period) <= TOLERANCE
}

/// Returns the deviation of an interval from a period, as a fraction of the period.
fn deviates_by(interval: Duration, period: Duration) -> f64 {
    (interval.as_secs_f64() / period.as_secs_f64() - 1.0).abs()
}

/// What an interval between heartbeats changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PeriodChange {
    None,
    /// What presence is judged by, but not an expected period.
    Presence,
    /// An expected period.
    Expected,
}

/// Heartbeat period of each address on one bus.
#[derive(Clone, Debug)]
pub(super) struct HeartbeatPeriods {
    /// Period in the profile.
    profile: Duration,
    /// True if the user gave the profile: other addresses then do not change what is expected.
    is_given: bool,
    /// True if an interval of the profile's period was observed.
    is_observed: bool,
    intervals: Vec<Intervals>,
    /// Period of each address, measured or expected.
    expected: [Duration; Address::COUNT],
}

impl HeartbeatPeriods {
    pub fn new(profile: Duration, is_given: bool) -> Self {
        Self {
            profile,
            is_given,
            is_observed: false,
            intervals: (0..Address::COUNT).map(|_| Intervals::default()).collect(),
            expected: [profile; Address::COUNT],
        }
    }

    /// Returns the period of `address`: the measured one, or the one expected until it is measured.
    /// Evidence of conflicts is judged by it.
    pub fn of(&self, address: Address) -> Duration {
        self.expected[address.index()]
    }

    /// Returns the period by which the presence of `address` is judged. Before it is measured, the
    /// shortest interval so far may be the period.
    pub fn of_presence(&self, address: Address) -> Duration {
        let (expected, intervals) = (self.of(address), &self.intervals[address.index()]);
        if intervals.measured.is_some() || self.is_given {
            return expected;
        }
        match intervals.recent.iter().min() {
            Some(shortest)
                if intervals.recent.len() > 1 || *shortest <= self.profile * MAX_SINGLE =>
            {
                expected.max(self.rounded(*shortest))
            }
            _ => expected,
        }
    }

    /// Returns the period of each address.
    pub fn all(&self) -> &[Duration; Address::COUNT] {
        &self.expected
    }

    /// Returns the period of most addresses.
    pub fn typical(&self) -> Duration {
        let measured = self.intervals.iter().filter_map(|intervals| intervals.measured);
        median(measured.collect()).unwrap_or(self.profile)
    }

    /// Returns true if a single heartbeat of `address` shows when the next one is due: the profile is
    /// given, or an interval of its period was observed on the bus, or the period is known from this
    /// address or from the others.
    pub fn is_reliable(&self, address: Address) -> bool {
        self.is_given
            || self.is_observed
            || self.is_measured(address)
            || self.of(address) != self.profile
    }

    /// Notes the time between two heartbeats of one sender. Returns what changed by it.
    pub fn note_interval(&mut self, address: Address, interval: Duration) -> PeriodChange {
        if interval > self.profile * MAX_PERIODS || interval < self.profile / MAX_PERIODS {
            return PeriodChange::None;
        }
        let was_observed = self.is_observed;
        self.is_observed |= is_near(interval, self.profile);
        let intervals = &mut self.intervals[address.index()];
        intervals.since_profile = if is_near(interval, self.profile) {
            Some(0)
        } else {
            intervals.since_profile.map(|count| count.saturating_add(1))
        };
        if intervals.recent.len() == MAX_INTERVALS {
            intervals.recent.pop_front();
        }
        intervals.recent.push_back(interval);
        // The usual case: one more interval of the known period.
        if intervals.is_established && intervals.measured.is_some_and(|it| is_near(interval, it)) {
            return PeriodChange::None;
        }
        let may_be_losses = intervals.since_profile.is_some_and(|count| count < LOSS_MEMORY);
        let median = intervals.regular_interval(self.profile);
        let median = median.filter(|it| !may_be_losses || *it < self.profile.mul_f64(1.5));
        let median = median.map(|interval| self.rounded(interval));
        let measured = median.filter(|period| !self.is_half_of_expected(address, *period));
        let intervals = &mut self.intervals[address.index()];
        let before = (intervals.median, intervals.measured);
        if measured.is_some() {
            intervals.measured = measured;
            intervals.is_established = intervals.recent.len() == MAX_INTERVALS;
        }
        intervals.median = median.or(intervals.median);
        let has_changed = before != (intervals.median, intervals.measured);
        let is_unmeasured = intervals.measured.is_none();
        if has_changed || self.expectation(address) != self.of(address) {
            self.update_expected();
            PeriodChange::Expected
        } else if is_unmeasured || self.is_observed != was_observed {
            PeriodChange::Presence
        } else {
            PeriodChange::None
        }
    }

    /// Returns true if the period of `address` is measured.
    pub fn is_measured(&self, address: Address) -> bool {
        self.intervals[address.index()].measured.is_some()
    }

    /// Forgets all intervals.
    pub fn clear(&mut self) {
        *self = Self::new(self.profile, self.is_given);
    }

    /// Forgets the intervals of `address`: its device is lost. Those of a device whose period is not
    /// known stay: it may be so long that the device is lost between two heartbeats.
    pub fn forget(&mut self, address: Address) {
        if !self.is_measured(address) {
            return;
        }
        self.intervals[address.index()] = Intervals::default();
        self.update_expected();
    }

    /// Returns the period of the profile for an interval near to it, else the interval in whole
    /// milliseconds, so that multiples of it are times in whole microseconds.
    fn rounded(&self, interval: Duration) -> Duration {
        let millis = u64::try_from(interval.as_millis()).unwrap_or(u64::MAX);
        if is_near(interval, self.profile) { self.profile } else { Duration::from_millis(millis) }
    }

    /// Returns true if two equal devices explain the period: it is half of an earlier one, or half
    /// of what other addresses have, or the profile.
    fn is_half_of_expected(&self, address: Address, period: Duration) -> bool {
        let intervals = &self.intervals[address.index()];
        let earlier = intervals.measured.filter(|_| intervals.is_established);
        if earlier.is_some_and(|earlier| is_near(period * 2, earlier)) {
            return true;
        }
        period != self.profile && is_near(period * 2, self.expected_of_others(address))
    }

    /// Returns the period expected of an address by what is known of the others.
    fn expected_of_others(&self, address: Address) -> Duration {
        let others = if self.is_given { None } else { self.median_without(address) };
        others.unwrap_or(self.profile)
    }

    /// Returns the period expected of an address.
    fn expectation(&self, address: Address) -> Duration {
        let intervals = &self.intervals[address.index()];
        if let Some(measured) = intervals.measured {
            return measured;
        }
        if intervals.have_mean(self.profile) {
            return self.profile;
        }
        self.expected_of_others(address).max(self.profile)
    }

    /// Returns the median of the other addresses, if two or more are known and most agree: of
    /// different periods, none is to be expected.
    fn median_without(&self, address: Address) -> Option<Duration> {
        let others = self.intervals.iter().enumerate().filter(|(at, _)| *at != address.index());
        let medians: Vec<Duration> = others.filter_map(|(_, intervals)| intervals.median).collect();
        let count = medians.len();
        let median = median(medians.clone())?;
        let is_common = |period: &&Duration| deviates_by(**period, median) <= COMMON_TOLERANCE;
        let agreeing = medians.iter().filter(is_common).count();
        (count >= MIN_OTHERS && agreeing * 3 >= count * 2).then_some(median)
    }

    fn update_expected(&mut self) {
        for address in Address::all() {
            self.expected[address.index()] = self.expectation(address);
        }
    }
}

/// Returns the lower median; `None` of nothing.
fn median(mut periods: Vec<Duration>) -> Option<Duration> {
    periods.sort_unstable();
    periods.get(periods.len().checked_sub(1)? / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(number: u8) -> Address {
        Address::from_bits(number)
    }

    fn millis(millis: u64) -> Duration {
        Duration::from_millis(millis)
    }

    fn measured(given: bool, intervals: &[(u8, u64)]) -> HeartbeatPeriods {
        let mut periods = HeartbeatPeriods::new(millis(1000), given);
        for &(number, interval) in intervals {
            periods.note_interval(address(number), millis(interval));
        }
        periods
    }

    #[test]
    fn five_equal_intervals_are_the_period() {
        let intervals = [(1, 3010), (1, 2990), (1, 3000), (1, 3000), (1, 2995)];
        let periods = measured(false, &intervals[..4]);
        assert_eq!(periods.of(address(1)), millis(1000), "four may be three periods each");
        assert_eq!(periods.of_presence(address(1)), millis(2990), "it is not stale before");
        let periods = measured(false, &intervals);
        assert_eq!(periods.of(address(1)), millis(3000));
        let two = intervals.into_iter().chain(intervals.map(|(_, interval)| (2, interval)));
        let periods = measured(false, &two.collect::<Vec<_>>());
        assert_eq!(periods.of(address(3)), millis(3000), "expected of the others, too");
    }

    #[test]
    fn different_periods_of_others_are_not_expected() {
        let mixed = [[(2, 1800), (3, 4900), (4, 3000)]; MAX_INTERVALS].concat();
        assert_eq!(measured(false, &mixed).of(address(1)), millis(1000));
    }

    #[test]
    fn period_of_others_is_not_that_of_a_device_with_jitter() {
        let intervals = [1400, 700, 1300, 600, 1000].map(|interval| (1, interval));
        let others = [(2, 2500), (3, 2500)].repeat(MIN_INTERVALS);
        for order in [[&intervals[..], &others], [&others, &intervals]] {
            let periods = measured(false, &order.concat());
            assert_eq!(periods.of(address(1)), millis(1000));
            assert_eq!(periods.of(address(4)), millis(2500));
        }
    }

    #[test]
    fn lost_heartbeats_do_not_change_the_period() {
        let intervals = [1000, 2000, 1000, 1000, 3000, 1000, 1000, 1000, 1000];
        let periods = measured(false, &intervals.map(|interval| (1, interval)));
        assert_eq!(periods.of(address(1)), millis(1000));
    }

    #[test]
    fn half_of_the_expected_period_is_not_a_period() {
        let twice = [(1, 500); MAX_INTERVALS];
        assert_eq!(measured(false, &twice).of(address(1)), millis(1000), "by the profile");
        let slow = [[(2, 3000), (3, 3000), (1, 1500)]; MAX_INTERVALS].concat();
        assert_eq!(measured(false, &slow).of(address(1)), millis(3000), "by other addresses");
        let fast = [[(1, 500), (2, 500), (3, 500)]; MAX_INTERVALS + 1].concat();
        assert_eq!(measured(false, &fast).of(address(1)), millis(500), "all addresses have it");
        let slower = [(1, 2000); MAX_INTERVALS].into_iter().chain([(1, 1000); MAX_INTERVALS]);
        let slower: Vec<(u8, u64)> = slower.collect();
        assert_eq!(measured(false, &slower).of(address(1)), millis(2000), "by its own before");
    }

    #[test]
    fn two_phases_are_no_period() {
        for (short, long) in [(50, 950), (250, 750), (300, 700)] {
            let intervals = [[(1, short), (1, long)]; MAX_INTERVALS].concat();
            assert_eq!(measured(false, &intervals).of(address(1)), millis(1000), "{short} ms");
        }
    }

    #[test]
    fn given_profile_is_expected_until_the_period_is_measured() {
        let periods =
            measured(true, &[[(2, 3000)].repeat(MIN_INTERVALS), vec![(1, 3000)]].concat());
        assert_eq!(periods.of(address(1)), millis(1000));
        assert_eq!(periods.of(address(2)), millis(3000));
    }
}
