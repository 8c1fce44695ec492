//! The times of candump's lines, in any of its ways to print them: `(1436509052.249713)`,
//! `(000.001500)` since the beginning or since the line before, `(2026-11-27 13:51:20.123456)`; with three
//! digits more after `-N`.
//!
//! Does not know what follows the time.

use super::LogTime;
use super::dates::{IsoDates, LocalDate};
use super::fields::{decimal, first_word};
use super::local_clock::LocalClock;
use super::plain_line;

/// Lines after which times in three digits of seconds count from the beginning.
const LINES: u8 = 8;

/// First time from which on it is taken for no difference, in microseconds: candump begins at 0, and no bus
/// is silent for as long.
const NO_DIFFERENCE: u64 = 100_000_000;

/// Begins a sequence that sets a colour.
pub(super) const ESCAPE: u8 = 0x1B;

/// What the lines so far say about the times of those that follow.
#[derive(Clone, Copy, Debug)]
pub(super) struct CandumpTimes {
    origin: TimeOrigin,
    /// Lines with a short time, up to [`LINES`].
    seen: u8,
    /// The last short time.
    last: LogTime,
    /// Sum of the short times.
    sum: LogTime,
    clock: LocalClock,
}

/// From where short times count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TimeOrigin {
    /// From one of the other two.
    Unknown,
    /// From the beginning, or from 1970.
    Fixed,
    /// From the line before.
    Previous,
}

/// The time of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PrintedTime {
    /// Since 1970.
    Unix(LogTime),
    /// In three digits of seconds: since 1970, the beginning, or the line before.
    Short(LogTime),
    /// A local date.
    Local(LocalDate),
}

impl CandumpTimes {
    /// Without lines.
    pub const NEW: Self = Self {
        origin: TimeOrigin::Unknown,
        seen: 0,
        last: LogTime::from_micros(0),
        sum: LogTime::from_micros(0),
        clock: LocalClock::NEW,
    };

    /// Returns what lines with these times say, before the first of them.
    pub fn of(times: impl Iterator<Item = PrintedTime>) -> Self {
        Self { origin: Self::of_lines(times).origin, ..Self::NEW }
    }

    /// Returns what lines with these times say, behind them.
    pub fn of_lines(times: impl Iterator<Item = PrintedTime>) -> Self {
        let mut all = Self::NEW;
        for time in times {
            all.since_origin(time);
        }
        all
    }

    /// Returns true if no line had a time.
    pub fn is_empty(&self) -> bool {
        self.origin == TimeOrigin::Unknown && self.seen == 0
    }

    /// Returns true if more lines are needed to know from where short times count.
    pub fn is_undecided(&self) -> bool {
        self.origin == TimeOrigin::Unknown && self.seen > 0
    }

    /// Returns true if the times count from 1970, or from the beginning.
    pub fn is_fixed(&self) -> bool {
        self.origin == TimeOrigin::Fixed
    }

    /// Takes the time of a line; returns it since 1970, or since the beginning.
    pub fn since_origin(&mut self, time: PrintedTime) -> LogTime {
        let time = match time {
            PrintedTime::Unix(time) => {
                self.fix_origin();
                return time;
            }
            PrintedTime::Local(date) => {
                self.fix_origin();
                return self.clock.moment_of(date);
            }
            PrintedTime::Short(time) => time,
        };
        // Each is below 1000 s: no log has as many lines as 2⁶⁴ µs take.
        self.sum = self.sum.checked_add(time).unwrap_or(self.sum);
        if self.seen == 0 && time.micros >= NO_DIFFERENCE && self.origin == TimeOrigin::Unknown {
            self.origin = TimeOrigin::Fixed;
        }
        if self.origin == TimeOrigin::Unknown {
            // Two frames do not begin at the same microsecond.
            if self.seen > 0 && self.last > LogTime::default() && time <= self.last {
                self.origin = TimeOrigin::Previous;
            }
            self.seen += 1;
            self.last = time;
            if self.seen == LINES && self.origin == TimeOrigin::Unknown {
                self.origin = TimeOrigin::Fixed;
            }
        }
        if self.origin == TimeOrigin::Previous { self.sum } else { time }
    }

    /// Takes a time that counts from no line.
    fn fix_origin(&mut self) {
        if self.origin == TimeOrigin::Unknown {
            self.origin = TimeOrigin::Fixed;
        }
    }

    /// What the lines say about local dates.
    pub fn clock(&self) -> &LocalClock {
        &self.clock
    }
}

/// Returns a line without the blanks and the colours before its text.
pub(super) fn without_colours(mut line: &[u8]) -> &[u8] {
    loop {
        line = line.trim_ascii_start();
        let [ESCAPE, b'[', rest @ ..] = line else { return line };
        let Some(end) = rest.iter().position(|&byte| byte == b'm') else { return line };
        line = &rest[end + 1..];
    }
}

/// Returns true if a line begins with a date, as `-t A` has it, whether there is such a day or not.
pub(super) fn has_date(line: &[u8]) -> bool {
    let (date, rest) = first_word(without_colours(line));
    let (time, _) = first_word(rest);
    let is_of = |text: &[u8], sign: u8| {
        text.iter().all(|byte| byte.is_ascii_digit() || [sign, b'.'].contains(byte))
    };
    let parts = date.strip_prefix(b"(").zip(time.strip_suffix(b")"));
    parts.is_some_and(|(date, time)| {
        is_of(date, b'-') && is_of(time, b':') && date.contains(&b'-') && time.contains(&b':')
    })
}

/// Splits a line into its time and the rest; `None` if it does not begin with one.
pub(super) fn split<'a>(line: &'a [u8], dates: &mut IsoDates) -> Option<(PrintedTime, &'a [u8])> {
    let line = without_colours(line);
    if let Some((time, rest)) = plain_line::time(line) {
        return Some((PrintedTime::Unix(time), rest));
    }
    let (word, rest) = first_word(line);
    let word = word.strip_prefix(b"(")?;
    if let Some(word) = word.strip_suffix(b")") {
        let point = word.iter().position(|&byte| byte == b'.').unwrap_or(word.len());
        let seconds = &word[..point];
        decimal(seconds)?;
        if word.contains(&b',') {
            return None;
        }
        let time = LogTime::of_seconds(word)?;
        let is_short = point == 3 && matches!(word.len(), 10 | 13);
        let time = if is_short { PrintedTime::Short(time) } else { PrintedTime::Unix(time) };
        return Some((time, rest));
    }
    let (time, rest) = first_word(rest);
    Some((PrintedTime::Local(dates.read(word, time.strip_suffix(b")")?)?), rest))
}
