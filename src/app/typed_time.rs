//! Durations, times of day and dates as they are typed.
//!
//! Pure. Does not know to what moments they refer.

use crate::time::Duration;
use jiff::civil;

/// Parses `90`, `90s`, `1.5s`, `250ms`, `2m`, `1h30m`; a number without a unit is of `unit`.
pub(super) fn parse_duration(text: &str, unit: &str) -> Option<Duration> {
    let (mut rest, mut sum) = (text.trim(), Duration::ZERO);
    if rest.is_empty() {
        return None;
    }
    while !rest.is_empty() {
        let end = rest.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(rest.len());
        let (number, after) = rest.split_at(end);
        let end = after.find(|c: char| c.is_ascii_digit() || c == '.').unwrap_or(after.len());
        let (own, after) = after.split_at(end);
        let seconds = match if own.trim().is_empty() { unit } else { own.trim() } {
            "h" => 3600.0,
            "m" | "min" => 60.0,
            "s" => 1.0,
            "ms" => 1e-3,
            "us" | "µs" => 1e-6,
            _ => return None,
        };
        let number: f64 = number.parse().ok()?;
        sum = sum.checked_add(Duration::try_from_secs_f64(number * seconds).ok()?)?;
        rest = after;
    }
    Some(sum)
}

/// Parses `13:51`, `13:51:20`, `13:51:20.250`: microseconds since midnight.
pub(super) fn parse_time_of_day(text: &str) -> Option<i128> {
    let is_plain = text.bytes().all(|byte| byte.is_ascii_digit() || b":.".contains(&byte));
    let mut parts = text.split(':');
    let hours: u32 = parts.next()?.parse().ok()?;
    let minutes: u32 = parts.next()?.parse().ok()?;
    let seconds: f64 = parts.next().map_or(Some(0.0), |text| text.parse().ok())?;
    let is_valid = hours < 24 && minutes < 60 && seconds < 60.0 && parts.next().is_none();
    let of_day = f64::from(hours * 3600 + minutes * 60) + seconds;
    (is_plain && is_valid).then(|| (of_day * 1e6).round() as i128)
}

/// Parses `2:05`, `2:05.250` and `1:02:05`, as the position in a log is shown: the time since its start.
pub(super) fn parse_position(text: &str) -> Option<Duration> {
    let with_hours = match text.matches(':').count() {
        1 => format!("0:{text}"),
        // A time of day may begin with 0.
        2 if !text.starts_with('0') => text.to_owned(),
        _ => return None,
    };
    let micros = parse_time_of_day(&with_hours)?;
    u64::try_from(micros).ok().map(Duration::from_micros)
}

/// Parses `2026-11-24` and `2026-11-24T13:51:20`: microseconds since 1970-01-01 00:00 on the same
/// clock.
pub(super) fn parse_date_time(text: &str) -> Option<i128> {
    let (date, of_day) = match text.split_once(['T', 't', ' ']) {
        Some((date, time)) => (date, parse_time_of_day(time)?),
        None => (text, 0),
    };
    let is_plain = date.bytes().all(|byte| byte.is_ascii_digit() || byte == b'-');
    let mut parts = date.split('-');
    let year: i16 = parts.next().filter(|year| year.len() == 4)?.parse().ok()?;
    let month: i8 = parts.next()?.parse().ok()?;
    let day: i8 = parts.next()?.parse().ok()?;
    if !is_plain || parts.next().is_some() {
        return None;
    }
    let date = civil::Date::new(year, month, day).ok()?;
    let since_1970 = date.duration_since(civil::date(1970, 1, 1));
    Some(since_1970.as_micros() + of_day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_counted_from_1970() {
        for (text, expected) in [
            ("1970-01-01", Some(0)),
            ("1970-01-02T00:00:01", Some(86_401_000_000)),
            ("2026-11-24t13:51", Some(1_795_528_260_000_000)),
            ("2000-02-29 23:59:59.5", Some(951_868_799_500_000)),
            ("2026-02-29", None),
            ("2026-13-01", None),
            ("26-11-24", None),
            ("2026-11-24T", None),
            ("2026-11-24T24:00", None),
            ("2026-11-24-01", None),
            ("+2026-11-24", None),
            ("2026-+1-24", None),
        ] {
            assert_eq!(parse_date_time(text), expected, "{text}");
        }
    }
}
