//! Time of an entry of a log, to the nanosecond.

use super::fields::fixed_point;

/// Time of an entry since 1970, or since another origin of the log's choice. Its microseconds have the
/// whole range of their type, which nanoseconds would cut to the years up to 2554.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct LogTime {
    /// Whole microseconds.
    pub micros: u64,
    /// Nanoseconds beyond them, 0 to 999.
    pub nanos: u16,
}

impl LogTime {
    /// Returns the time of this many microseconds.
    pub const fn from_micros(micros: u64) -> Self {
        Self { micros, nanos: 0 }
    }

    /// Returns the time of this many nanoseconds.
    pub const fn from_nanos(nanos: u64) -> Self {
        Self { micros: nanos / 1000, nanos: (nanos % 1000) as u16 }
    }

    /// Returns the sum of both; `None` behind the last microsecond.
    pub(super) fn checked_add(self, other: Self) -> Option<Self> {
        let nanos = self.nanos + other.nanos;
        let micros = self.micros.checked_add(other.micros)?;
        let micros = micros.checked_add(u64::from(nanos / 1000))?;
        Some(Self { micros, nanos: nanos % 1000 })
    }

    /// Returns a number of seconds such as `12.000345678`; further digits are cut off. `None` if the text is
    /// not a number, or too large.
    pub(super) fn of_seconds(text: &[u8]) -> Option<Self> {
        let micros = fixed_point::<6>(text)?;
        let point = text.iter().position(|byte| matches!(byte, b'.' | b','));
        let fraction = point.map_or(&[][..], |point| &text[point + 1..]);
        let digit = |place| fraction.get(place).map_or(0, |digit| u16::from(digit - b'0'));
        Some(Self { micros, nanos: digit(6) * 100 + digit(7) * 10 + digit(8) })
    }
}
