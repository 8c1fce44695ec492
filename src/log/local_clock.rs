//! The moments of local dates, line by line: which of two hours a date stands for where summer time ends.
//!
//! Of two moments the first one is read; a line more than [`MAX_REORDER`] before the line above it is in the
//! second hour. Does not know how dates are written.

use super::LogTime;
use super::dates::LocalDate;
use super::summary::{DateDoubts, MAX_REORDER};

const REORDER: u64 = MAX_REORDER.as_micros() as u64;
/// Two dates with two moments that are farther apart are of two years, in microseconds.
const OTHER_YEAR: u64 = 86_400_000_000;

/// What the lines so far say about the dates of those that follow.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalClock {
    /// Date of the last line, and its moment.
    last: Option<(LocalDate, LogTime)>,
    /// First moment of the last date that has two.
    twofold: Option<u64>,
    /// The lines went from the first to the second hour.
    is_shown: bool,
    /// It is not known of some line in which hour it is.
    is_ambiguous: bool,
    /// The same of a line before the last step back or of another year.
    was_ambiguous: bool,
    has_skipped_date: bool,
    is_zone_unknown: bool,
}

impl LocalClock {
    /// Without lines.
    pub const NEW: Self = Self {
        last: None,
        twofold: None,
        is_shown: false,
        is_ambiguous: false,
        was_ambiguous: false,
        has_skipped_date: false,
        is_zone_unknown: false,
    };

    /// Returns the moment of the date of the next line.
    pub fn moment_of(&mut self, date: LocalDate) -> LogTime {
        let is_before_last =
            |time: LogTime| self.last.is_some_and(|(_, last)| time.micros + REORDER < last.micros);
        let time = date.second.filter(|_| is_before_last(date.first)).unwrap_or(date.first);
        let is_back = is_before_last(time);
        let is_of_other_year =
            |other: u64| date.second.is_some() && other.abs_diff(date.first.micros) > OTHER_YEAR;
        // A step back within the second hour shows that the one before was not the end of summer time; or
        // what follows is another recording.
        self.is_ambiguous |= self.is_shown && is_back && date.second.is_some();
        if is_back || self.twofold.is_some_and(is_of_other_year) {
            self.was_ambiguous |= self.is_ambiguous;
            (self.is_ambiguous, self.is_shown) = (false, false);
        }
        if let Some(second) = date.second.filter(|_| !self.is_shown) {
            self.note_twofold(date.first, second, time);
        }
        self.has_skipped_date |= date.is_skipped;
        self.is_zone_unknown |= date.is_zone_unknown;
        self.twofold = date.second.map(|_| date.first.micros).or(self.twofold);
        self.last = Some((date, time));
        time
    }

    /// Notes whether it is known in which of two hours a line is: `time` is one of its moments.
    fn note_twofold(&mut self, first: LogTime, second: LogTime, time: LogTime) {
        let mut is_change = false;
        if let Some((date, last)) = self.last.filter(|_| time == second) {
            // As the line above.
            let is_late = date.second.is_none() && last.micros.abs_diff(second.micros) <= REORDER;
            if is_late || date.second == Some(last) {
                return;
            }
            // After a smaller step the line above would be followed by a long silence: a clock that was set
            // right is as likely.
            is_change =
                last.micros > first.micros.midpoint(second.micros) && last.micros < second.micros;
        }
        (self.is_shown, self.is_ambiguous) = (is_change, !is_change);
    }

    /// Returns what is doubtful of the dates so far.
    pub fn doubts(&self) -> DateDoubts {
        let is_ambiguous = self.is_ambiguous || self.was_ambiguous;
        let is_zone_unknown = self.is_zone_unknown;
        DateDoubts { is_ambiguous, is_skipped: self.has_skipped_date, is_zone_unknown }
    }
}
