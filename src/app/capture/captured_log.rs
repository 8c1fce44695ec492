//! The captured frames as a log to be written: all, or those that match a filter.
//!
//! Input: the stored frames of a moment. Output: bytes of a log format, and how many frames they are.
//! Shares the memory of the frames, so that it can be written on another thread while more are captured.
//! Does not know where it is written.

use super::Traffic;
use super::frame_store::StoredFrames;
use crate::app::buses::{Bus, Buses};
use crate::app::filter::{Filter, FrameMatcher};
use crate::app::frame_selector::RecentFrames;
use crate::log::{LogEntry, LogFormat, LogTime};
use crate::time::Epoch;
use std::io;
use std::sync::Arc;

/// The frames that were captured at some time, as a log to be written.
#[derive(Clone, Debug)]
pub struct CapturedLog {
    frames: StoredFrames,
    /// Names and lost frames by bus.
    names: Vec<String>,
    lost: Vec<u64>,
    epoch: Epoch,
    format: &'static LogFormat,
    /// Which frames are written, prepared for what was known; `None` for all.
    selection: Option<(Filter, Arc<FrameMatcher>)>,
}

/// Frames in a log that was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrittenFrames {
    /// Written frames.
    pub written: u64,
    /// Captured frames, also those that do not match.
    pub captured: u64,
    /// Only frames that match a filter were written.
    pub is_selection: bool,
}

impl Traffic {
    /// The captured frames as a log of this format; with a filter, those that match.
    pub fn log(
        &self,
        buses: &Buses,
        epoch: Epoch,
        format: &'static LogFormat,
        filter: Option<&Filter>,
    ) -> CapturedLog {
        CapturedLog {
            frames: self.capture.snapshot(),
            names: buses.iter().map(|bus| bus.name.clone()).collect(),
            lost: buses.iter().map(Bus::lost).collect(),
            epoch,
            format,
            selection: filter.map(|filter| (filter.clone(), Arc::new(filter.for_frames(buses)))),
        }
    }
}

impl CapturedLog {
    /// Bytes that are written at once.
    const PART: usize = 1 << 18;

    /// Writes the log.
    ///
    /// # Errors
    ///
    /// Those of writing to `out`.
    pub fn write_to(&self, out: &mut impl io::Write) -> io::Result<WrittenFrames> {
        let (mut encoder, mut part) = (self.format.encoder(), Vec::new());
        encoder.begin(&mut part)?;
        let is_selection = self.selection.is_some();
        let mut frames = WrittenFrames { written: 0, captured: 0, is_selection };
        let mut recent =
            self.selection.as_ref().and_then(|(filter, _)| RecentFrames::for_filter(filter));
        for frame in self.frames.iter() {
            frames.captured += 1;
            let is_match = match (&self.selection, &mut recent) {
                (None, _) => true,
                (Some((_, matcher)), Some(recent)) => recent.is_match(matcher, &frame),
                (Some((_, matcher)), None) => matcher.is_match(&frame, None),
            };
            if !is_match {
                continue;
            }
            frames.written += 1;
            let time = LogTime::from_micros(self.epoch.unix_micros(frame.time));
            let interface = self.names.get(usize::from(frame.bus.0)).map_or("can", String::as_str);
            encoder.write(LogEntry { time, interface, frame }, u64::MAX, &mut part)?;
            if part.len() >= Self::PART {
                out.write_all(&part)?;
                part.clear();
            }
        }
        encoder.end(&self.names, &self.lost, &mut part)?;
        out.write_all(&part)?;
        Ok(frames)
    }
}

/// Equal if they are the same frames in memory.
impl PartialEq for CapturedLog {
    fn eq(&self, other: &Self) -> bool {
        let filter = |log: &Self| log.selection.as_ref().map(|(filter, _)| filter.clone());
        self.frames.is_same(&other.frames)
            && std::ptr::eq(self.format, other.format)
            && filter(self) == filter(other)
    }
}

impl Eq for CapturedLog {}
