//! When a log was recorded: the dates of its first and its last frame, without what is between.

use super::index::FilePart;
use super::packing;
use super::unpacking::unpacked_log;
use crate::log::{LogReader, LogSummary};
use crate::time::{Duration, Instant};
use std::fs::File;
use std::io::{self, BufReader};
use std::sync::Arc;

/// Reads a log to its end; returns the time of its last frame, counted from the first one. `None` if it is
/// stopped, or has no frame.
pub(super) fn last_time(
    log: FilePart,
    is_stopped: impl Fn() -> bool,
) -> io::Result<Option<Instant>> {
    let file = log.file();
    let mut reader = LogReader::new(BufReader::with_capacity(1 << 16, unpacked_log(log, &file)?));
    let mut frames = Vec::new();
    let mut last = None;
    while let Some(frame) = reader.next_frame()? {
        frames.clear();
        frames.push(frame);
        reader.take_buffered(&mut frames, 1024);
        last = frames.last().map(|frame| frame.time);
        if is_stopped() {
            return Ok(None);
        }
    }
    Ok(last)
}

/// The dates between which a log was recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogDates {
    /// Date of the first frame, in microseconds since 1970.
    pub first: u64,
    /// Date of the last frame, in microseconds since 1970; of the first one while it is not known.
    pub last: u64,
    /// The last frame was found: the end of the log can be read.
    pub has_end: bool,
}

impl LogDates {
    /// Reads the first frame of a log file and the last one; also returns the summary of the log up to
    /// its first frame. `None` without a frame.
    ///
    /// # Errors
    ///
    /// Those of the file system.
    pub fn read(log: &File) -> io::Result<(LogSummary, Option<Self>)> {
        let file = Arc::new(log.try_clone()?);
        let mut reader = LogReader::new(BufReader::new(unpacked_log(log, &file)?));
        reader.next_frame()?;
        let summary = reader.summary().clone();
        let Some(epoch) = summary.epoch else { return Ok((summary, None)) };
        // The end of a packed log is not looked for.
        let end =
            if packing(log)?.is_some() { None } else { reader.position().last_time_of(log)? };
        let last = epoch.unix_micros(end.unwrap_or(Instant::ZERO));
        let first = epoch.unix_micros(Instant::ZERO);
        Ok((summary, Some(Self { first, last, has_end: end.is_some() })))
    }

    /// Does as [`Self::read`]; where the end of the file does not show the last frame, reads all of them.
    ///
    /// # Errors
    ///
    /// Those of the file system.
    pub fn read_to_end(log: &File) -> io::Result<(LogSummary, Option<Self>)> {
        let (summary, dates) = Self::read(log)?;
        let Some(dates) = dates.filter(|dates| !dates.has_end) else {
            return Ok((summary, dates));
        };
        let file = FilePart::new(Arc::new(log.try_clone()?));
        let Some(last) = last_time(file, || false)? else { return Ok((summary, Some(dates))) };
        let last = summary.epoch.unwrap_or_default().unix_micros(last);
        Ok((summary, Some(Self { last, has_end: true, ..dates })))
    }

    /// Returns true if the two logs were recorded at the same time, if only for a moment.
    pub fn meets(&self, other: &Self) -> bool {
        self.first <= other.last && self.last >= other.first
    }

    /// Returns the time from the first frame to the last one, if that was found.
    pub fn length(&self) -> Option<Duration> {
        self.has_end.then(|| Duration::from_micros(self.last.saturating_sub(self.first)))
    }
}
