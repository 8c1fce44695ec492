//! Dates in logs, which have no time zone: in the local time of this machine, as their programs write
//! them.

use super::LogTime;
use super::fields::{decimal, first_word, fixed_point, number};
use jiff::civil::DateTime;
use jiff::tz::{AmbiguousOffset, TimeZone};

/// Microseconds from 1970-01-01 back to 1899-12-30, from which TRC counts days.
const DAYS_BEFORE_1970: i128 = 25_569;
const MICROS_PER_DAY: i128 = 86_400_000_000;
/// The last date that is written as the beginning of a log, from which later times count: 9999-01-01 in UTC,
/// as years have four digits.
pub(super) const LAST_START: u64 = 253_370_764_800_000_000;
/// Parts of a day in which a fraction of days is read: 0.09 µs.
const PARTS_OF_DAY: i128 = 1_000_000_000_000;
/// Beginnings of the names of the months in English, German, French, Spanish, Italian and Russian, as ASC
/// has them, in lower case.
const MONTHS: [&[&str]; 12] = [
    &["jan", "ene", "gen", "янв"],
    &["feb", "fév", "fev", "фев"],
    &["mar", "mär", "mrz", "m\u{FFFD}r", "мар"],
    &["apr", "avr", "abr", "апр"],
    &["may", "mai", "mag", "май", "мая"],
    &["jun", "juin", "giu", "июн"],
    &["jul", "juil", "lug", "июл"],
    &["aug", "aoû", "aou", "ago", "авг"],
    &["sep", "set", "сен"],
    &["oct", "okt", "ott", "окт"],
    &["nov", "ноя"],
    &["dec", "dez", "déc", "dic", "дек"],
];

/// A local date and time of day, in microseconds since 1970.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LocalDate {
    /// The moment; the first one if the date comes twice.
    pub first: LogTime,
    /// The second moment, an hour later in most countries, if summer time ends in that hour.
    pub second: Option<LogTime>,
    /// No clock shows it, as summer time begins in that hour; read as if it did not.
    pub is_skipped: bool,
    /// It is read as one in UTC, as `TZ` names a time zone that is not known.
    pub is_zone_unknown: bool,
}

/// Returns the microseconds since 1970 of a local time; `None` before 1970.
fn unix_micros(local: DateTime) -> Option<u64> {
    let zoned = local.to_zoned(TimeZone::system()).ok()?;
    u64::try_from(zoned.timestamp().as_microsecond()).ok()
}

/// Returns the microseconds since 1970 of a local time, which is given as such microseconds in UTC.
pub(super) fn local_micros(micros: u64) -> Option<u64> {
    let timestamp = jiff::Timestamp::from_microsecond(i64::try_from(micros).ok()?).ok()?;
    unix_micros(TimeZone::UTC.to_datetime(timestamp))
}

/// Returns nanoseconds since 1970 in microseconds, rounded: they come from floating-point numbers. `None`
/// before 1970.
pub(super) fn unix_nanos_micros(nanos: i128) -> Option<u64> {
    u64::try_from((nanos + 500).div_euclid(1000)).ok().filter(|_| nanos > -500)
}

/// Returns the local time of microseconds since 1970, at most in the year 9999.
pub(super) fn local_time(unix_micros: u64) -> DateTime {
    let micros = i64::try_from(unix_micros).unwrap_or(i64::MAX);
    let timestamp = jiff::Timestamp::from_microsecond(micros).unwrap_or(jiff::Timestamp::MAX);
    TimeZone::system().to_datetime(timestamp)
}

/// Returns true if the local time of this moment, not after [`LAST_START`], comes twice, and is read as the
/// first.
pub(super) fn is_in_repeated_hour(micros: u64) -> bool {
    unix_micros(local_time(micros)).is_some_and(|read| read < micros)
}

/// Returns true if `TZ` names a time zone that is not known: local times are then those of UTC.
pub(super) fn is_zone_unknown() -> bool {
    // Without TZ, a machine that has no zone has UTC.
    TimeZone::try_system().is_err() && std::env::var_os("TZ").is_some()
}

/// Returns true if the local time of this moment comes twice, as summer time ends in that hour.
pub(super) fn comes_twice(micros: u64) -> bool {
    let ambiguous = TimeZone::system().to_ambiguous_timestamp(local_time(micros));
    matches!(ambiguous.offset(), AmbiguousOffset::Fold { .. })
}

/// Parses the date of an ASC log, without its weekday: `Sep 30 10:06:13.191 PM 2017`.
pub(super) fn asc_date(text: &[u8]) -> Option<LogTime> {
    // Logs of other code pages have letters that are not UTF-8.
    let text = String::from_utf8_lossy(text);
    let words: Vec<_> = text.split_whitespace().take(6).collect();
    let (month, day, time, half, year) = match *words {
        [month, day, time, year] => (month, day, time, None, year),
        [month, day, time, half, year] => (month, day, time, Some(half), year),
        _ => return None,
    };
    let month = month.to_lowercase();
    let is_month = |names: &&[&str]| names.iter().any(|name| month.starts_with(name));
    let month = MONTHS.iter().position(is_month)?;
    // Milliseconds, which python-can writes without leading zeros.
    let padded = match time.rsplit_once('.') {
        Some((whole, millis)) if millis.len() < 3 => Some(format!("{whole}.{millis:0>3}")),
        _ => None,
    };
    let time = padded.as_deref().unwrap_or(time);
    let (hour, minute, second) = time_of_day(time.as_bytes())?;
    let hour = match half.map(str::to_ascii_lowercase).as_deref() {
        None => hour,
        Some("am" | "a.m.") => hour % 12,
        Some("pm" | "p.m.") => hour % 12 + 12,
        Some(_) => return None,
    };
    let day = number(day.trim_end_matches(['.', ',']).as_bytes(), 10)?;
    civil(number(year.as_bytes(), 10)?, month as u32 + 1, day, (hour, minute, second))
}

/// Parses a date of PEAK's tools such as `18.12.2021 14:28:07.062.0`, in microseconds since 1970.
pub(super) fn day_month_year(text: &[u8]) -> Option<u64> {
    let (date, rest) = first_word(text);
    let (time, _) = first_word(rest);
    let mut parts = date.split(|&byte| byte == b'.').map(|part| number(part, 10));
    let (day, month, year) = (parts.next()??, parts.next()??, parts.next()??);
    // Behind the milliseconds are microseconds.
    let mut points = time.iter().enumerate().filter(|(_, byte)| **byte == b'.');
    let end = points.nth(1).map_or(time.len(), |(at, _)| at);
    Some(civil(year, month, day, time_of_day(&time[..end])?)?.micros)
}

/// Parses a date and a time of day in UTC such as `2026-11-27 14:28:07.062`, in microseconds since 1970.
pub(super) fn utc_date(text: &[u8]) -> Option<u64> {
    let date: jiff::civil::DateTime = std::str::from_utf8(text).ok()?.trim().parse().ok()?;
    u64::try_from(TimeZone::UTC.to_timestamp(date).ok()?.as_microsecond()).ok()
}

/// Reads dates such as `2026-11-27` with a time of day, line by line. Most are in the second of the one
/// before, for which the time zone is asked once.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct IsoDates {
    /// The last date, and its text up to the second.
    last: Option<([u8; DATE], [u8; SECOND], LocalDate)>,
}

/// Bytes of a date in four, two and two digits.
const DATE: usize = 10;
/// Bytes of a time of day up to the second, with the point behind it.
const SECOND: usize = 9;

impl IsoDates {
    /// Parses a date and a time of day; `None` if no clock shows them.
    pub fn read(&mut self, date: &[u8], time: &[u8]) -> Option<LocalDate> {
        let second = <[u8; DATE]>::try_from(date).ok().zip(time.first_chunk::<SECOND>().copied());
        let second = second.filter(|(_, time)| time.ends_with(b"."));
        if let Some(second) = second
            && let Some((date, time_before, last)) = self.last
            && second == (date, time_before)
        {
            let fraction = LogTime::of_seconds(&time[SECOND - 2..])?;
            let moment = |of: LogTime| LogTime {
                micros: of.micros / 1_000_000 * 1_000_000 + fraction.micros % 1_000_000,
                nanos: fraction.nanos,
            };
            return Some(LocalDate {
                first: moment(last.first),
                second: last.second.map(moment),
                ..last
            });
        }
        let read = iso_date(date, time)?;
        self.last = second.map(|(date, time)| (date, time, read));
        Some(read)
    }
}

/// Parses a date such as `2026-11-27` and a time of day.
fn iso_date(date: &[u8], time: &[u8]) -> Option<LocalDate> {
    let mut parts = date.split(|&byte| byte == b'-').map(|part| number(part, 10));
    let (year, month, day) = (parts.next()??, parts.next()??, parts.next()??);
    if parts.next().is_some() {
        return None;
    }
    let (hour, minute, time) = time_of_day(time)?;
    let local = seconds_of(year, month, day, (hour, minute, time))?;
    let moment = |local: jiff::Zoned| {
        let micros = u64::try_from(local.timestamp().as_microsecond()).ok()?;
        let micros = micros.checked_add(time.micros % 1_000_000)?;
        Some(LogTime { micros, nanos: time.nanos })
    };
    let zone = TimeZone::system();
    let ambiguous = zone.to_ambiguous_zoned(local);
    let second = matches!(ambiguous.offset(), AmbiguousOffset::Fold { .. })
        .then(|| moment(ambiguous.clone().later().ok()?))
        .flatten();
    let is_skipped = matches!(ambiguous.offset(), AmbiguousOffset::Gap { .. });
    let first = moment(ambiguous.compatible().ok()?)?;
    Some(LocalDate {
        first,
        second,
        is_skipped,
        is_zone_unknown: zone.is_unknown() && is_zone_unknown(),
    })
}

/// Returns the microseconds since 1970 of days since 1899-12-30, as TRC counts them, in local time.
pub(super) fn trc_date(days: &[u8]) -> Option<u64> {
    let local = jiff::Timestamp::from_microsecond(trc_micros(days)?).ok()?;
    unix_micros(TimeZone::UTC.to_datetime(local))
}

/// The same in UTC.
pub(super) fn trc_utc_date(days: &[u8]) -> Option<u64> {
    u64::try_from(trc_micros(days)?).ok()
}

/// Returns the microseconds from 1970 to days since 1899-12-30.
fn trc_micros(days: &[u8]) -> Option<i64> {
    let days = i128::from(fixed_point::<12>(days)?);
    let micros = (days * MICROS_PER_DAY + PARTS_OF_DAY / 2) / PARTS_OF_DAY;
    i64::try_from(micros - DAYS_BEFORE_1970 * MICROS_PER_DAY).ok()
}

/// Returns the days since 1899-12-30 of microseconds since 1970, as TRC counts them, to the microsecond.
pub(super) fn trc_days(unix_micros: u64) -> String {
    let local = local_time(unix_micros);
    let micros = TimeZone::UTC.to_timestamp(local).map_or(0, jiff::Timestamp::as_microsecond);
    let micros = (i128::from(micros) + DAYS_BEFORE_1970 * MICROS_PER_DAY).max(0);
    let fraction = micros % MICROS_PER_DAY * PARTS_OF_DAY / MICROS_PER_DAY;
    format!("{}.{fraction:012}", micros / MICROS_PER_DAY)
}

/// Returns the microseconds since 1970 of a system time of Windows, in UTC: year, month, day, hour, minute,
/// second, millisecond.
pub(super) fn system_time(fields: [u16; 7]) -> Option<u64> {
    let [year, month, day, hour, minute, second, millis] = fields;
    let small = |value: u16| i8::try_from(value).ok();
    let (month, day) = (small(month)?, small(day)?);
    let date = jiff::civil::Date::new(i16::try_from(year).ok()?, month, day).ok()?;
    let nanos = i32::from(millis).checked_mul(1_000_000)?;
    let time = jiff::civil::Time::new(small(hour)?, small(minute)?, small(second)?, nanos).ok()?;
    let timestamp = TimeZone::UTC.to_timestamp(date.to_datetime(time)).ok()?;
    u64::try_from(timestamp.as_microsecond()).ok()
}

/// Returns the system time of Windows of microseconds since 1970, in UTC: year, month, day of the week, day,
/// hour, minute, second, millisecond.
pub(super) fn system_time_of(unix_micros: u64) -> [u16; 8] {
    let micros = i64::try_from(unix_micros).unwrap_or(i64::MAX);
    let timestamp = jiff::Timestamp::from_microsecond(micros).unwrap_or(jiff::Timestamp::MAX);
    let at = TimeZone::UTC.to_datetime(timestamp);
    let weekday = at.weekday().to_sunday_zero_offset();
    [
        at.year().cast_unsigned(),
        i16::from(at.month()).cast_unsigned(),
        i16::from(weekday).cast_unsigned(),
        i16::from(at.day()).cast_unsigned(),
        i16::from(at.hour()).cast_unsigned(),
        i16::from(at.minute()).cast_unsigned(),
        i16::from(at.second()).cast_unsigned(),
        at.millisecond().cast_unsigned(),
    ]
}

/// Parses `10:06:13.191` as hour, minute and the time since the minute began.
fn time_of_day(text: &[u8]) -> Option<(u32, u32, LogTime)> {
    let mut parts = text.splitn(3, |&byte| byte == b':');
    let (hour, minute) = (number(parts.next()?, 10)?, number(parts.next()?, 10)?);
    Some((hour, minute, LogTime::of_seconds(parts.next().unwrap_or(b"0"))?))
}

/// Returns the moment of a local date and a time of day, as [`time_of_day`] has it.
fn civil(year: u32, month: u32, day: u32, time: (u32, u32, LogTime)) -> Option<LogTime> {
    let LogTime { micros, nanos } = time.2;
    let micros =
        unix_micros(seconds_of(year, month, day, time)?)?.checked_add(micros % 1_000_000)?;
    Some(LogTime { micros, nanos })
}

/// Returns a local date and a time of day, as [`time_of_day`] has it, in whole seconds.
fn seconds_of(year: u32, month: u32, day: u32, time: (u32, u32, LogTime)) -> Option<DateTime> {
    let (hour, minute, time) = time;
    let small = |value: u32| i8::try_from(value).ok();
    let second = i8::try_from(time.micros / 1_000_000).ok()?;
    let year = i16::try_from(year).ok()?;
    let date = jiff::civil::Date::new(year, small(month)?, small(day)?).ok()?;
    let time = jiff::civil::Time::new(small(hour)?, small(minute)?, second, 0).ok()?;
    Some(date.to_datetime(time))
}

/// Returns seconds and their fraction, in the nearest microseconds; `None` if the text is not a number. The
/// number may have an exponent.
pub(super) fn seconds(text: &[u8]) -> Option<u64> {
    let in_tenths = fixed_point::<7>(text).and_then(|tenths| tenths.checked_add(5));
    let rounded = in_tenths.map(|tenths| tenths / 10);
    rounded.or_else(|| fixed_point::<6>(text)).or_else(|| {
        let seconds: f64 = std::str::from_utf8(text).ok()?.parse().ok()?;
        let micros = (seconds * 1e6).round();
        let is_time = (0.0..=1e18).contains(&micros) && decimal(text).is_none();
        is_time.then_some(micros as u64)
    })
}
