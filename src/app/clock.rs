//! Time in the program: the present moment, its place on the wall clock, the pace of a log.

use super::wall_clock::{DAY, WallClock};
use crate::status::Playback;
use crate::time::{Duration, Epoch, Instant};

const SECOND: Duration = Duration::from_secs(1);

/// The present moment and what it is measured against.
#[derive(Debug)]
pub(super) struct AppClock {
    now: Instant,
    /// Real time, if the caller sets it; otherwise it is `now`.
    real: Option<Instant>,
    wall: WallClock,
    /// Playback of logs, where all buses are logs.
    playback: Option<Playback>,
    /// Next whole second, at which ages and rates change.
    next_second: Instant,
}

impl AppClock {
    /// Returns a clock that stands at `now`.
    pub fn new(now: Instant, wall: WallClock) -> Self {
        let next_second = whole_second_after(now);
        Self { now, real: None, wall, playback: None, next_second }
    }

    /// The latest moment.
    pub fn now(&self) -> Instant {
        self.now
    }

    /// Sets the moment; an earlier one is ignored. Returns the latest.
    pub fn set(&mut self, now: Instant) -> Instant {
        self.now = self.now.max(now);
        self.now
    }

    /// Real time, which a log does not pause nor accelerate; its start is the caller's.
    pub fn real(&self) -> Instant {
        self.real.unwrap_or(self.now)
    }

    /// Sets the real time.
    pub fn set_real(&mut self, real: Instant) {
        self.real = Some(real);
    }

    /// Returns true if real time is set apart from the time of the buses.
    pub fn has_real(&self) -> bool {
        self.real.is_some()
    }

    /// Unix time of [`Instant::ZERO`].
    pub fn epoch(&self) -> Epoch {
        self.wall.epoch()
    }

    /// The wall clock.
    pub fn wall(&self) -> &WallClock {
        &self.wall
    }

    /// Seconds since 1970-01-01 00:00 on the wall clock; 0 before it.
    fn wall_seconds(&self, at: Instant) -> u64 {
        u64::try_from(self.wall.local(at) / 1_000_000).unwrap_or(0)
    }

    /// Seconds since midnight on the wall clock.
    pub fn second_of_day(&self, at: Instant) -> u64 {
        (self.wall.local(at).rem_euclid(DAY) / 1_000_000) as u64
    }

    /// The present moment for the name of a file: `20261121-060036`.
    pub fn stamp(&self) -> String {
        stamp(self.wall_seconds(self.now))
    }

    /// The date of a moment on the wall clock: `2026-11-21`.
    pub fn date_text(&self, at: Instant) -> String {
        let days = i64::try_from(self.wall.local(at).div_euclid(DAY)).unwrap_or(i64::MAX);
        let since = jiff::Span::new().try_days(days).ok();
        let date = since.and_then(|days| jiff::civil::date(1970, 1, 1).checked_add(days).ok());
        date.unwrap_or(jiff::civil::Date::MAX).to_string()
    }

    /// A moment on the wall clock with its date: `2026-11-21 06:00:36`.
    pub fn date_time_text(&self, at: Instant) -> String {
        let stamp = stamp(self.wall_seconds(at));
        // The year may have more than four digits.
        let (date, time) = stamp.split_once('-').unwrap_or((&stamp, "000000"));
        let (year, day) = date.split_at(date.len().saturating_sub(4));
        format!("{year}-{}-{} {}:{}:{}", &day[..2], &day[2..], &time[..2], &time[2..4], &time[4..])
    }

    /// Playback of logs; `None` unless all buses are logs.
    pub fn playback(&self) -> Option<Playback> {
        self.playback
    }

    /// Sets the playback; returns true if it changed.
    pub fn set_playback(&mut self, playback: Playback) -> bool {
        self.playback.replace(playback) != Some(playback)
    }

    /// Converts a wall-clock duration to log time; zero while the log is paused.
    pub fn scale_to_playback(&self, time: Duration) -> Duration {
        match self.playback {
            Some(playback) if playback.is_standing() => Duration::ZERO,
            Some(playback) => time.mul_f64(playback.speed),
            None => time,
        }
    }

    /// Next whole second.
    pub fn next_second(&self) -> Instant {
        self.next_second
    }

    /// Returns true once per second.
    pub fn take_second(&mut self, now: Instant) -> bool {
        let is_over = self.next_second <= now;
        if is_over {
            self.next_second = whole_second_after(now);
        }
        is_over
    }
}

fn whole_second_after(now: Instant) -> Instant {
    Instant::from_micros(now.as_micros() / 1_000_000 * 1_000_000) + SECOND
}

/// Date and time in the Gregorian calendar: `20261121-060036`.
fn stamp(wall_seconds: u64) -> String {
    let (days, second) = (wall_seconds / 86_400, wall_seconds % 86_400);
    // Days since 1970 to a date of the Gregorian calendar, counted from 0000-03-01.
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    let (hours, minutes, seconds) = (second / 3600, second / 60 % 60, second % 60);
    format!("{year:04}{month:02}{day:02}-{hours:02}{minutes:02}{seconds:02}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use jiff::tz::TimeZone;

    #[test]
    fn stamp_is_calendar_date() {
        assert_eq!(stamp(0), "19700101-000000");
        assert_eq!(stamp(951_782_400), "20000229-000000");
        assert_eq!(stamp(1_795_240_836), "20261121-060036");
    }

    #[test]
    fn second_is_taken_once() {
        let at = |millis| Instant::ZERO + Duration::from_millis(millis);
        let mut clock = AppClock::new(at(300), WallClock::new(Epoch::default(), TimeZone::UTC));
        assert!(!clock.take_second(at(999)) && clock.take_second(at(1000)));
        assert!(!clock.take_second(at(1999)));
        assert_eq!((clock.set(at(50)), clock.next_second()), (at(300), at(2000)));
    }

    #[test]
    fn paused_log_scales_durations_to_zero() {
        let mut clock =
            AppClock::new(Instant::ZERO, WallClock::new(Epoch::default(), TimeZone::UTC));
        assert_eq!(clock.scale_to_playback(SECOND), SECOND);
        assert!(clock.set_playback(Playback {
            speed: 2.0,
            is_paused: false,
            is_ended: false,
            ..Playback::default()
        }));
        assert_eq!(clock.scale_to_playback(SECOND), SECOND * 2);
        clock.set_playback(Playback {
            speed: 2.0,
            is_paused: true,
            is_ended: false,
            ..Playback::default()
        });
        assert_eq!(clock.scale_to_playback(SECOND), Duration::ZERO);
    }
}
