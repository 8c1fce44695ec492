//! Moments as they are typed: `13:51:20.250`, `2:05`, `-2m`, `+10s`, `50%`, `#5123`, `a`.
//!
//! Pure. Does not know what is shown at a moment.

use crate::app::typed_time::{parse_duration, parse_position, parse_time_of_day};
use crate::app::wall_clock::{DAY, WallClock};
use crate::time::{Duration, Instant};

/// Forms of a moment, for the prompt.
pub(super) const FORMS: &str =
    "13:51:20.250, 2:05 (since the start), -2m, +10s, 50%, #5123 (frame), a (mark)";

/// Moments that can be shown.
#[derive(Clone, Copy, Debug)]
pub(in crate::app) struct MomentRange<'a> {
    /// The first one.
    pub begin: Instant,
    /// The present, or the end of a log.
    pub end: Instant,
    /// False while the end of a log is looked for: `end` is the present.
    pub is_end_known: bool,
    /// The moment that is shown.
    pub shown: Instant,
    /// Number of all frames so far.
    pub frames: u64,
    /// A log is not read to its end: it may have more.
    pub has_more_frames: bool,
    /// The wall clock.
    pub wall: &'a WallClock,
    /// Letters of the marks, a bit for each.
    pub marks: u32,
}

/// A moment to go to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::app) enum MomentTarget {
    Time(Instant),
    /// After the frame with this number, counted from 0.
    Frame(u64),
    /// The mark with this letter.
    Mark(char),
}

impl MomentTarget {
    /// Parses a moment.
    ///
    /// # Errors
    /// What is wrong, in words.
    pub fn parse(text: &str, range: &MomentRange<'_>) -> Result<Self, String> {
        let no_form = || format!("{text}: not a moment; use {FORMS}");
        if let Some(number) = text.strip_prefix('#') {
            let number: u64 = number.parse().map_err(|_| no_form())?;
            return match number.checked_sub(1) {
                Some(index) if index < range.frames || range.has_more_frames => {
                    Ok(Self::Frame(index))
                }
                _ => Err(format!("#{number}: there are frames 1 to {} so far", range.frames)),
            };
        }
        if let [letter @ b'a'..=b'z'] = text.as_bytes() {
            let letter = char::from(*letter);
            let is_set = range.marks & mark_bit(letter) != 0;
            return is_set.then_some(Self::Mark(letter)).ok_or(format!("{letter}: not a mark"));
        }
        let (begin, end) = (range.begin, range.end);
        let not_kept = || {
            let (from, to) = (range.time_of_day(begin), range.time_of_day(end));
            format!("{text}: not kept; {from} to {to} is")
        };
        let time = if let Some(percent) = text.strip_suffix('%') {
            let percent: f64 = percent.trim_end().parse().map_err(|_| no_form())?;
            if !(0.0..=100.0).contains(&percent) {
                return Err(format!("{text}: from 0% to 100%"));
            }
            if !range.is_end_known {
                return Err(length_is_not_known(text));
            }
            begin + end.since(begin).mul_f64(percent / 100.0)
        } else if let Some(back) = text.strip_prefix('-') {
            let back = parse_duration(back, "s").ok_or_else(no_form)?;
            let time = range.shown.as_micros().checked_sub(micros(back));
            Instant::from_micros(time.ok_or_else(not_kept)?)
        } else if let Some(ahead) = text.strip_prefix('+') {
            range.shown + parse_duration(ahead, "s").ok_or_else(no_form)?
        } else {
            // Where no such time of day is kept, it may be the position that a log shows: 2:05.
            let of_day = parse_time_of_day(text).map(|of_day| range.at_wall_time(of_day));
            let position = parse_position(text).map(|position| Instant::ZERO + position);
            let is_kept = |time: &Instant| (begin..=end).contains(time);
            of_day.filter(is_kept).or(position.filter(is_kept)).or(of_day).ok_or_else(no_form)?
        };
        if (begin..=end).contains(&time) {
            return Ok(Self::Time(time));
        }
        if time > end && !range.is_end_known {
            return Err(length_is_not_known(text));
        }
        Err(not_kept())
    }
}

fn length_is_not_known(text: &str) -> String {
    format!("{text}: how long the log is, is being read; try again in a moment")
}

impl MomentRange<'_> {
    /// Returns the last moment until the end at this time of day, in microseconds.
    fn at_wall_time(&self, of_day: i128) -> Instant {
        let at = self.wall.last_at_time_of_day(of_day, self.end);
        // One before the start is not kept, nor is the latest moment there is.
        u64::try_from(at).map_or(Instant::LATEST, Instant::from_micros)
    }

    /// Returns the time of day of a moment: `13:51:20`.
    pub fn time_of_day(&self, at: Instant) -> String {
        let of_day = self.wall.local(at).rem_euclid(DAY) / 1000;
        let (seconds, millis) = (of_day / 1000, of_day % 1000);
        let (hours, minutes) = (seconds / 3600, seconds / 60 % 60);
        format!("{hours:02}:{minutes:02}:{:02}.{millis:03}", seconds % 60)
    }
}

/// Returns the bit of a letter in [`MomentRange::marks`]; 0 for any other character.
pub(in crate::app) fn mark_bit(letter: char) -> u32 {
    if letter.is_ascii_lowercase() { 1 << (letter as u32 - u32::from(b'a')) } else { 0 }
}

fn micros(duration: Duration) -> u64 {
    u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Epoch;
    use jiff::tz::TimeZone;

    fn at(seconds: f64) -> Instant {
        Instant::from_micros((seconds * 1e6) as u64)
    }

    /// From 23:59:50 on.
    fn wall() -> WallClock {
        let epoch = Epoch::from_unix_micros(20_000 * 86_400_000_000 - 10_000_000);
        WallClock::new(epoch, TimeZone::UTC)
    }

    /// For 40 s: kept from 23:59:55, and 0:00:20 is shown.
    fn range(wall: &WallClock) -> MomentRange<'_> {
        let (begin, end, shown) = (at(5.0), at(40.0), at(30.0));
        MomentRange {
            begin,
            end,
            is_end_known: true,
            shown,
            frames: 100,
            has_more_frames: false,
            wall,
            marks: mark_bit('c'),
        }
    }

    #[test]
    fn moments_are_read_in_all_forms() {
        let wall = wall();
        for (text, expected) in [
            ("23:59:55", 5.0),
            ("23:59:59.250", 9.25),
            ("0:00", 10.0),
            ("00:00:20", 30.0),
            ("-20s", 10.0),
            ("-20", 10.0),
            ("-0.5", 29.5),
            ("-250ms", 29.75),
            ("+10s", 40.0),
            ("+ 1 s", 31.0),
            ("0%", 5.0),
            ("50 %", 22.5),
            ("100%", 40.0),
            // No such time of day is kept: since the start.
            ("0:31", 31.0),
            ("0:39.5", 39.5),
        ] {
            let time = MomentTarget::parse(text, &range(&wall));
            assert_eq!(time, Ok(MomentTarget::Time(at(expected))), "{text}");
        }
        assert_eq!(MomentTarget::parse("#1", &range(&wall)), Ok(MomentTarget::Frame(0)));
        let open = MomentRange { has_more_frames: true, ..range(&wall) };
        assert_eq!(MomentTarget::parse("#101", &open), Ok(MomentTarget::Frame(100)));
        assert!(MomentTarget::parse("#0", &open).is_err());
        assert_eq!(MomentTarget::parse("c", &range(&wall)), Ok(MomentTarget::Mark('c')));
        assert_eq!(MomentTarget::parse("#100", &range(&wall)), Ok(MomentTarget::Frame(99)));
        let mut long = range(&wall);
        (long.begin, long.end) = (at(0.0), at(100_000.0));
        long.shown = at(90_000.0);
        let back = MomentTarget::parse("-1h30m", &long);
        assert_eq!(back, Ok(MomentTarget::Time(at(84_600.0))));
        // The same time of day occurred twice.
        let last = MomentTarget::parse("23:59:55", &long);
        assert_eq!(last, Ok(MomentTarget::Time(at(86_405.0))));
    }

    #[test]
    fn moments_behind_an_unknown_end_are_refused_for_now() {
        let wall = wall();
        let open = MomentRange { is_end_known: false, ..range(&wall) };
        for text in ["50%", "100%", "00:00:31", "0:41", "+11s"] {
            let fault = MomentTarget::parse(text, &open).unwrap_err();
            assert!(fault.contains("how long the log is, is being read"), "{text}: {fault}");
        }
        for text in ["23:59:55", "-20s", "+10s", "0:31"] {
            assert_eq!(MomentTarget::parse(text, &open), MomentTarget::parse(text, &range(&wall)));
        }
    }

    #[test]
    fn moments_that_are_not_kept_are_refused() {
        let wall = wall();
        for (text, said) in [
            ("23:59:54", "23:59:54: not kept; 23:59:55.000 to 00:00:30.000 is"),
            ("00:00:31", "not kept"),
            ("0:00:31", "not kept"),
            ("0:41", "not kept"),
            ("-26s", "not kept"),
            ("-99h", "-99h: not kept; 23:59:55.000 to 00:00:30.000 is"),
            ("-99999999999999999999h", "not a moment"),
            ("+11s", "not kept"),
            ("#0", "#0: there are frames 1 to 100"),
            ("#101", "#101: there are frames 1 to 100"),
            ("101%", "from 0% to 100%"),
            ("-1%", "from 0% to 100%"),
            ("nan%", "from 0% to 100%"),
            ("a", "a: not a mark"),
        ] {
            let fault = MomentTarget::parse(text, &range(&wall)).unwrap_err();
            assert!(fault.contains(said), "{text}: {fault}");
        }
        for text in [
            "",
            "-",
            "+",
            "#",
            "%",
            ":",
            "::",
            "1",
            "13",
            "24:00",
            "12:60",
            "12:00:60",
            "1:2:3:4",
            "12:00:nan",
            "12:00:-1",
            "+12:00",
            "-5x",
            "-1.2.3s",
            "#x",
            "#-1",
            "-s",
            "A",
            "cc",
            "-inf",
            "12:00:1e1",
            "１２:00",
            "-99999999999999999999h",
        ] {
            let fault = MomentTarget::parse(text, &range(&wall)).unwrap_err();
            assert!(fault.contains("not a moment"), "{text}: {fault}");
        }
    }
}
