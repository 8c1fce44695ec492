//! When a log was recorded: the dates of its first and its last frame, without what is between.

use crate::log::{LogReader, LogSummary};
use crate::time::{Duration, Instant};
use std::fs::File;
use std::io::{self, BufReader};

/// The dates between which a log was recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogDates {
    /// Date of the first frame, in microseconds since 1970.
    pub first: u64,
    /// Date of the last frame, in microseconds since 1970.
    pub last: u64,
}

impl LogDates {
    /// Reads the first frame of a log file and the last one; also returns the summary of the log up to
    /// its first frame. `None` without a frame.
    ///
    /// # Errors
    ///
    /// Those of the file system.
    pub fn read(log: &File) -> io::Result<(LogSummary, Option<Self>)> {
        let mut reader = LogReader::new(BufReader::new(log));
        reader.next_frame()?;
        let summary = reader.summary().clone();
        let Some(epoch) = summary.epoch else { return Ok((summary, None)) };
        let last = reader.position().last_time_of(log)?.unwrap_or(Instant::ZERO);
        let (first, last) = (epoch.unix_micros(Instant::ZERO), epoch.unix_micros(last));
        Ok((summary, Some(Self { first, last })))
    }

    /// Returns true if the two logs were recorded at the same time, if only for a moment.
    pub fn meets(&self, other: &Self) -> bool {
        self.first <= other.last && self.last >= other.first
    }

    /// Returns the time from the first frame to the last one.
    pub fn length(&self) -> Duration {
        Duration::from_micros(self.last.saturating_sub(self.first))
    }
}
