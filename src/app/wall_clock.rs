//! The wall clock: local time of moments. Its offset from UTC is that of the moment, as summer time has another
//! one than winter time.
//!
//! Local times are microseconds since 1970-01-01 00:00 on the wall clock, moments microseconds since
//! [`Instant::ZERO`], which may be negative.

use crate::time::{Epoch, Instant};
use jiff::Timestamp;
use jiff::tz::TimeZone;

/// Microseconds of a day.
pub(super) const DAY: i128 = 86_400_000_000;
/// How far before the start a time of day may lie.
const HOUR: i128 = 3_600_000_000;

/// A wall clock.
#[derive(Clone, Debug)]
pub(super) struct WallClock {
    epoch: Epoch,
    zone: TimeZone,
}

impl WallClock {
    /// Returns the clock of a time zone.
    pub fn new(epoch: Epoch, zone: TimeZone) -> Self {
        Self { epoch, zone }
    }

    /// Unix time of [`Instant::ZERO`].
    pub fn epoch(&self) -> Epoch {
        self.epoch
    }

    /// Returns the local time of a moment.
    pub fn local(&self, at: Instant) -> i128 {
        let unix = i128::from(self.epoch.unix_micros(at));
        unix + self.offset(unix)
    }

    /// Returns the moment of a local time: the first of two in an hour that is repeated, the one that is as much
    /// later for a time that the beginning of summer time leaves out.
    pub fn moment(&self, local: i128) -> i128 {
        self.moments(local).0
    }

    /// Returns the last moment until `until` at a time of day.
    pub fn last_at_time_of_day(&self, of_day: i128, until: Instant) -> i128 {
        let end = i128::from(until.as_micros());
        let found = self.at_time_of_day(of_day, end).filter(|at| *at <= end).max();
        found.unwrap_or(end)
    }

    /// Returns the first moment at a time of day, from an hour before the start on.
    pub fn first_at_time_of_day(&self, of_day: i128) -> i128 {
        let found = self.at_time_of_day(of_day, 0).filter(|at| *at >= -HOUR).min();
        found.unwrap_or(0)
    }

    /// Offset from UTC at a moment: `UTC+02:00`.
    pub fn offset_text(&self, at: Instant) -> String {
        let minutes = self.offset(i128::from(self.epoch.unix_micros(at))) / 60_000_000;
        let (sign, minutes) = (if minutes < 0 { '-' } else { '+' }, minutes.abs());
        format!("UTC{sign}{:02}:{:02}", minutes / 60, minutes % 60)
    }

    /// The moments at a time of day, of the day of a moment, the days around it, and one more on each side.
    fn at_time_of_day(&self, of_day: i128, moment: i128) -> impl Iterator<Item = i128> {
        let unix = self.start() + moment;
        let midnight = (unix + self.offset(unix)).div_euclid(DAY) * DAY;
        (-2..=2).flat_map(move |days: i128| {
            let (first, last) = self.moments(midnight + days * DAY + of_day);
            [first, last]
        })
    }

    /// The first and the last moment of a local time.
    fn moments(&self, local: i128) -> (i128, i128) {
        // Offsets differ by at most a day, and change less often.
        let [before, after] = [local - DAY, local + DAY].map(|unix| local - self.offset(unix));
        let shows = |unix: i128| unix + self.offset(unix) == local;
        let (first, last) = match (shows(before), shows(after)) {
            (true, true) => (before.min(after), before.max(after)),
            (false, true) => (after, after),
            (_, false) => (before, before),
        };
        (first - self.start(), last - self.start())
    }

    fn start(&self) -> i128 {
        i128::from(self.epoch.unix_micros(Instant::ZERO))
    }

    /// Offset from UTC at a Unix time, in microseconds.
    fn offset(&self, unix_micros: i128) -> i128 {
        let limit = if unix_micros < 0 { Timestamp::MIN } else { Timestamp::MAX };
        let at = i64::try_from(unix_micros).ok();
        let at = at.and_then(|at| Timestamp::from_microsecond(at).ok()).unwrap_or(limit);
        i128::from(self.zone.to_offset(at).seconds()) * 1_000_000
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The clock of Berlin, by its rule. It starts at a Unix time in seconds.
    fn berlin(start: u64) -> WallClock {
        let zone = TimeZone::posix("CET-1CEST,M3.5.0,M10.5.0/3").unwrap();
        WallClock::new(Epoch::from_unix_micros(start * 1_000_000), zone)
    }

    /// 2026-10-25 00:00 in UTC; an hour later summer time ends.
    const AUTUMN: u64 = 1_792_886_400;
    /// 2026-03-29 00:00 in UTC; an hour later summer time begins.
    const SPRING: u64 = 1_774_742_400;

    fn at(minutes: i128) -> Instant {
        Instant::from_micros(u64::try_from(minutes * 60_000_000).unwrap())
    }

    /// Hours and minutes of a local time.
    fn of_day(hours: i128, minutes: i128) -> i128 {
        (hours * 60 + minutes) * 60_000_000
    }

    #[test]
    fn offset_is_that_of_the_moment() {
        let clock = berlin(AUTUMN);
        let shown = |minutes| clock.local(at(minutes)).rem_euclid(DAY);
        assert_eq!(shown(30), of_day(2, 30));
        assert_eq!(shown(90), of_day(2, 30), "the hour is repeated");
        assert_eq!(shown(120), of_day(3, 0));
        assert_eq!(clock.offset_text(at(59)), "UTC+02:00");
        assert_eq!(clock.offset_text(at(60)), "UTC+01:00");
        assert_eq!(clock.offset_text(Instant::LATEST), "UTC+01:00");
    }

    #[test]
    fn repeated_local_time_is_the_first_and_a_skipped_one_later() {
        let (autumn, spring) = (berlin(AUTUMN), berlin(SPRING));
        let day = |clock: &WallClock| clock.local(at(0)).div_euclid(DAY) * DAY;
        let minutes = |clock: &WallClock, local| clock.moment(day(clock) + local) / 60_000_000;
        assert_eq!(minutes(&autumn, of_day(2, 30)), 30);
        assert_eq!(minutes(&autumn, of_day(1, 30)), -30);
        assert_eq!(minutes(&autumn, of_day(3, 0)), 120);
        assert_eq!(minutes(&spring, of_day(1, 30)), 30);
        assert_eq!(minutes(&spring, of_day(2, 30)), 90);
        assert_eq!(minutes(&spring, of_day(3, 30)), 90);
    }

    #[test]
    fn time_of_day_is_the_last_one_until_a_moment() {
        let clock = berlin(AUTUMN);
        let last = |hour, minute, until| {
            clock.last_at_time_of_day(of_day(hour, minute), at(until)) / 60_000_000
        };
        assert_eq!(last(2, 20, 200), 80, "the second of the repeated hour");
        assert_eq!(last(2, 20, 79), 20, "the first of it");
        assert_eq!(last(2, 40, 70), 40, "later on the clock, but before");
        assert_eq!(last(2, 20, 10), 20 - 24 * 60, "on the day before");
        assert_eq!(clock.first_at_time_of_day(of_day(1, 0)), -HOUR);
        assert_eq!(clock.first_at_time_of_day(of_day(0, 59)), 24 * HOUR - HOUR / 60);
    }
}
