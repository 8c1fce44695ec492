//! Values of filter fields: lists, numbers, intervals, identifiers, bytes, moments.
//!
//! Pure: text in, something to compare with out. Does not know which field a value is of.

use crate::app::typed_time::{parse_date_time, parse_duration, parse_time_of_day};
use crate::app::wall_clock::WallClock;
use crate::time::{Duration, Instant};
use std::ops::Range;

/// The greatest service number (protocol §1.1).
const MAX_SERVICE: u64 = 0x3FF;

/// Splits a list at its commas outside of quotes; the parts with their place in it, without quotes.
pub(super) fn list(text: &str) -> Vec<(String, Range<usize>)> {
    let mut is_quoted = false;
    let parts = text.split(|c: char| {
        is_quoted ^= c == '"';
        c == ',' && !is_quoted
    });
    let mut at = 0;
    let place = |part: &str| {
        let range = at..at + part.len();
        at = range.end + 1;
        (part.replace('"', ""), range)
    };
    parts.map(place).collect()
}

/// Parses a range of values: `8`, `>8`, `>=8`, `<8`, `<=8`, `3..8` with both ends, `3..`, `..8`.
/// `parse` reads one value; values are whole numbers.
fn parse_range(text: &str, parse: impl Fn(&str) -> Option<u64>) -> Option<(u64, u64)> {
    let value = |text: &str| parse(text.trim());
    if let Some(text) = text.strip_prefix(">=") {
        return Some((value(text)?, u64::MAX));
    }
    if let Some(text) = text.strip_prefix("<=") {
        return Some((0, value(text)?));
    }
    if let Some(text) = text.strip_prefix('>') {
        return Some((value(text)?.checked_add(1)?, u64::MAX));
    }
    if let Some(text) = text.strip_prefix('<') {
        return Some((0, value(text)?.checked_sub(1)?));
    }
    if let Some((low, high)) = text.split_once("..") {
        let end = |text: &str, open| if text.is_empty() { Some(open) } else { value(text) };
        let (low, high) = (end(low, 0)?, end(high, u64::MAX)?);
        return (low <= high && text != "..").then_some((low, high));
    }
    let exact = value(text.strip_prefix('=').unwrap_or(text))?;
    Some((exact, exact))
}

fn parse_number(text: &str) -> Option<u64> {
    match text.strip_prefix("0x") {
        Some(hex) => u64::from_str_radix(hex, 16).ok().filter(|_| !hex.starts_with('+')),
        None => text.parse().ok().filter(|_| !text.starts_with('+')),
    }
}

/// A range of numbers, with both ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NumberRange(u64, u64);

impl NumberRange {
    /// Parses `8`, `0x1F`, `>8`, `3..8`.
    pub fn parse(text: &str) -> Option<Self> {
        parse_range(text, parse_number).map(|(low, high)| Self(low, high))
    }

    /// Parses a range of times, in microseconds: `>50ms`, `10ms..20ms`; without a unit,
    /// milliseconds.
    pub fn parse_interval(text: &str) -> Option<Self> {
        let micros = |text: &str| u64::try_from(parse_duration(text, "ms")?.as_micros()).ok();
        parse_range(text, micros).map(|(low, high)| Self(low, high))
    }

    /// Returns true if a service number is in it.
    pub fn has_service(self) -> bool {
        self.0 <= MAX_SERVICE
    }

    pub fn contains(self, value: u64) -> bool {
        (self.0..=self.1).contains(&value)
    }
}

/// Digits of an identifier, anywhere in it or all of them, or a range of identifiers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum IdPattern {
    Digits {
        /// Bits that are compared, from the last digit on.
        mask: u32,
        value: u32,
        count: usize,
        /// They are all digits.
        is_whole: bool,
    },
    Range(NumberRange),
}

impl IdPattern {
    /// Parses `0201`, `071?0001`, `=123`, `0x100..0x1FF`, `>0x100`.
    pub fn parse(text: &str) -> Option<Self> {
        let whole = text.strip_prefix('=').filter(|digits| !digits.starts_with("0x"));
        if text.contains("..") || text.starts_with(['<', '>', '=']) && whole.is_none() {
            return NumberRange::parse(text).map(Self::Range);
        }
        let digits = text.strip_prefix("0x").or(whole).unwrap_or(text);
        let digit = |c: char| match c {
            '?' => Some(None),
            _ => c.to_digit(16).map(Some),
        };
        let (mut mask, mut value, mut count) = (0, 0, 0);
        for c in digits.chars() {
            let digit = digit(c)?;
            count += 1;
            mask = mask << 4 | digit.map_or(0, |_| 0xF);
            value = value << 4 | digit.unwrap_or(0);
        }
        let is_whole = whole.is_some();
        let is_possible = if is_whole { matches!(count, 3 | 8) } else { (1..=8).contains(&count) };
        is_possible.then_some(Self::Digits { mask, value, count, is_whole })
    }

    /// Returns true if an identifier of so many digits matches.
    pub fn is_match(&self, id: u32, digits: usize) -> bool {
        match self {
            Self::Range(range) => range.contains(u64::from(id)),
            Self::Digits { mask, value, count, is_whole: true } => {
                digits == *count && id & mask == *value
            }
            Self::Digits { mask, value, count, is_whole: false } => digits
                .checked_sub(*count)
                .is_some_and(|last| (0..=last).any(|at| id >> (4 * at) & mask == *value)),
        }
    }
}

/// Bytes with wildcards.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct BytePattern {
    /// Mask and value of each byte.
    bytes: Vec<(u8, u8)>,
    is_at_start: bool,
    is_at_end: bool,
}

impl BytePattern {
    /// Parses `01 ?? 0F`, `01??0F`, `4?`; `^` is the first byte, `$` the end.
    pub fn parse(text: &str) -> Option<Self> {
        let text = text.trim();
        let (is_at_start, text) = match text.strip_prefix('^') {
            Some(rest) => (true, rest),
            None => (false, text),
        };
        let (is_at_end, text) = match text.strip_suffix('$') {
            Some(rest) => (true, rest),
            None => (false, text),
        };
        let digits: Vec<char> = text.chars().filter(|c| !c.is_whitespace()).collect();
        // Blanks stand between bytes only.
        let is_split = text.split_whitespace().any(|part| part.chars().count() % 2 == 1);
        let digit = |c: char| match c {
            '?' => Some((0, 0)),
            _ => c.to_digit(16).map(|digit| (0xF, digit as u8)),
        };
        let pairs = digits.chunks_exact(2).map(|pair| {
            let (high, low) = (digit(pair[0])?, digit(pair[1])?);
            Some((high.0 << 4 | low.0, high.1 << 4 | low.1))
        });
        let bytes: Vec<(u8, u8)> = pairs.collect::<Option<_>>()?;
        (!bytes.is_empty() && !is_split).then_some(Self { bytes, is_at_start, is_at_end })
    }

    /// Returns true if the pattern is in `data` and ends behind `from`.
    pub fn is_in(&self, data: &[u8], from: usize) -> bool {
        let Some(last) = data.len().checked_sub(self.bytes.len()) else { return false };
        let first = if self.is_at_end { last } else { (from + 1).saturating_sub(self.bytes.len()) };
        let last = if self.is_at_start { 0 } else { last };
        let is_at = |at: usize| {
            let found = data[at..].iter().zip(&self.bytes);
            found.into_iter().all(|(byte, (mask, value))| byte & mask == *value)
        };
        (first..=last).any(is_at)
    }
}

/// A moment that rows are compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TimeBound {
    typed: TypedTime,
    /// The moment that was typed, in microseconds from the start; `None` until it is known.
    at: Option<i64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TypedTime {
    /// Microseconds since midnight.
    OfDay(i128),
    /// Microseconds since 1970-01-01 00:00 on the wall clock.
    Date(i128),
    /// So long before the present.
    Ago(Duration),
}

impl TimeBound {
    /// Parses `13:51`, `13:51:20.250`, `2026-11-24T13:51`, `-2m`.
    pub fn parse(text: &str) -> Option<Self> {
        let typed = match text.strip_prefix('-') {
            Some(ago) => TypedTime::Ago(parse_duration(ago, "s")?),
            None => parse_time_of_day(text)
                .map(TypedTime::OfDay)
                .or_else(|| parse_date_time(text).map(TypedTime::Date))?,
        };
        Some(Self { typed, at: None })
    }

    /// Finds the moment: of a time of day the last one until the present, or if nothing says when
    /// that is, the first one from an hour before the start on.
    pub fn resolve(&mut self, clock: &WallClock, now: Option<Instant>) {
        let at = match self.typed {
            TypedTime::Date(local) => clock.moment(local),
            TypedTime::OfDay(of_day) => match now {
                Some(now) => clock.last_at_time_of_day(of_day, now),
                None => clock.first_at_time_of_day(of_day),
            },
            TypedTime::Ago(ago) => {
                let present = now.map_or(0, |now| i128::from(now.as_micros()));
                present - ago.as_micros().cast_signed()
            }
        };
        let bound = i128::from(i64::MAX);
        self.at = i64::try_from(at.clamp(-bound, bound)).ok();
    }

    /// Returns true if `time` is the moment or later; always until it is known.
    pub fn is_since(self, time: Instant) -> bool {
        self.at.is_none_or(|at| i128::from(at) <= i128::from(time.as_micros()))
    }

    /// Returns true if `time` is the moment or earlier; always until it is known.
    pub fn is_until(self, time: Instant) -> bool {
        self.at.is_none_or(|at| i128::from(at) >= i128::from(time.as_micros()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Epoch;
    use jiff::tz::TimeZone;

    #[test]
    fn numbers_and_ranges_are_read() {
        let holds = |text: &str| {
            let range = NumberRange::parse(text)?;
            let all: Vec<u64> = (0..=20).filter(|number| range.contains(*number)).collect();
            Some((*all.first()?, *all.last()?))
        };
        for (text, expected) in [
            ("8", Some((8, 8))),
            ("=8", Some((8, 8))),
            ("0x0a", Some((10, 10))),
            (">8", Some((9, 20))),
            (">=8", Some((8, 20))),
            ("<8", Some((0, 7))),
            ("<= 8", Some((0, 8))),
            ("3..8", Some((3, 8))),
            ("3..", Some((3, 20))),
            ("..8", Some((0, 8))),
            ("<0", None),
            ("8..3", None),
            ("..", None),
            ("", None),
            (">", None),
            ("+8", None),
            ("0x+8", None),
            ("-8", None),
            ("3..4..5", None),
            ("18446744073709551616", None),
            (">18446744073709551615", None),
        ] {
            assert_eq!(holds(text), expected, "{text}");
        }
        let is_in = |text, micros| NumberRange::parse_interval(text).unwrap().contains(micros);
        assert!(is_in(">50ms", 50_001) && !is_in(">50ms", 50_000));
        assert!(is_in("1.5..2s", 1_500) && is_in("1.5..2s", 2_000_000));
        assert!(is_in("<10", 9_999) && !is_in("<10", 10_000));
        assert!(NumberRange::parse_interval("1 parsec").is_none());
    }

    #[test]
    fn identifiers_match_by_digits_and_range() {
        let is_match = |text, id| IdPattern::parse(text).unwrap().is_match(id, 8);
        assert!(is_match("0201", 0x0201_5402) && is_match("5402", 0x0201_5402));
        assert!(is_match("201?4", 0x0201_5402) && !is_match("2015403", 0x0201_5402));
        assert!(is_match("????????", 7));
        assert!(is_match("0x100..0x1ff", 0x1FF) && !is_match("0x100..0x1ff", 0x200));
        assert!(!IdPattern::parse("0001").unwrap().is_match(1, 3));
        let is_whole = |id, digits| IdPattern::parse("=1?0").unwrap().is_match(id, digits);
        assert!(is_whole(0x1F0, 3) && !is_whole(0x1F1, 3) && !is_whole(0x1F0, 8));
        assert!(is_match("=02015402", 0x0201_5402) && !is_match("=02015402", 0x0201_5403));
        assert!(is_match("=0x100", 0x100) && !is_match("=0x100", 0x101));
        for text in ["", "x", "123456789", "0x", "1..x", "=", "=12", "=1234", "=12x"] {
            assert_eq!(IdPattern::parse(text), None, "{text}");
        }
    }

    #[test]
    fn bytes_match_with_wildcards() {
        let is_in = |text, data: &[u8]| BytePattern::parse(text).unwrap().is_in(data, 0);
        let data = [0x01, 0x7F, 0x0F, 0x40];
        for text in ["01 ?? 0f", "01??0F", "7? 0F 4?", "^01", "40$", "^017f0f40$", "??"] {
            assert!(is_in(text, &data), "{text}");
        }
        for text in ["01 0F", "^7F", "0F$", "017F0F40??", "^01$"] {
            assert!(!is_in(text, &data), "{text}");
        }
        assert!(!is_in("??", &[]));
        for text in ["", "0", "0 1", "0g", "^", "$", "01 ^02", "01 ?"] {
            assert_eq!(BytePattern::parse(text), None, "{text}");
        }
        let one = BytePattern::parse("0F").unwrap();
        assert!(one.is_in(&data, 2) && !one.is_in(&data, 3));
        let two = BytePattern::parse("0F40").unwrap();
        assert!(two.is_in(&data, 3) && !two.is_in(&data, 4));
        assert!(!BytePattern::parse("^01").unwrap().is_in(&data, 1));
    }

    #[test]
    fn times_refer_to_the_last_ones() {
        let seconds = |seconds: i128| seconds * 1_000_000;
        let instant = |micros: i128| Instant::from_micros(micros.try_into().unwrap());
        // From 23:59:50 on.
        let start = Epoch::from_unix_micros(20_000 * 86_400_000_000 - 10_000_000);
        let clock = WallClock::new(start, TimeZone::UTC);
        let at = |text, now: Option<i128>| {
            let mut bound = TimeBound::parse(text).unwrap();
            bound.resolve(&clock, now.map(instant));
            i128::from(bound.at.unwrap())
        };
        assert_eq!(at("0:00:10", Some(seconds(100))), seconds(20));
        assert_eq!(at("0:00:10", Some(seconds(90_000))), seconds(86_420));
        assert_eq!(at("0:00:10", None), seconds(20));
        assert_eq!(at("23:59", None), seconds(-50), "the minute in which it begins");
        assert_eq!(at("22:59", None), seconds(24 * 3600 - 3650));
        assert_eq!(at("-30", Some(seconds(100))), seconds(70));
        assert_eq!(at("-3m", Some(seconds(100))), seconds(-80));
        assert_eq!(at("2024-10-04T00:00:05", None), seconds(15));
        let mut before = TimeBound::parse("1990-01-01").unwrap();
        before.resolve(&clock, None);
        assert!(before.is_since(Instant::ZERO) && !before.is_until(Instant::ZERO));
        for text in ["", "-", "soon", "13", "25:00", "2024-10-32"] {
            assert_eq!(TimeBound::parse(text), None, "{text}");
        }
    }
}
