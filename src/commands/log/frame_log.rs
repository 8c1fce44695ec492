//! Frames of a log as another log: `descan log --write`.
//!
//! Input: frames in the order of their times, of any bus. Output: a new file, and its size on standard
//! error. Does not know which frames match, nor the layout of files.

use super::super::{Failure, open};
use crate::app::App;
use crate::frame::{BusIndex, Frame};
use crate::shell::recorder::{Recorder, Target};
use std::path::Path;

/// Frames that are handed over at once: fewer locks than frames.
const PART: usize = 1024;

/// A log that is being written.
#[derive(Debug)]
pub struct FrameLog {
    /// `None` once it is finished.
    recorder: Option<Recorder>,
    part: Vec<Frame>,
    left_out: u64,
    is_begun: bool,
}

impl FrameLog {
    /// Creates the file.
    ///
    /// # Errors
    /// It exists, or cannot be written.
    pub fn create(path: &Path) -> Result<Self, Failure> {
        let recorder = Recorder::create(&Target { path: path.to_owned(), max_bytes: None })?;
        let part = Vec::with_capacity(PART);
        Ok(Self { recorder: Some(recorder), part, left_out: 0, is_begun: false })
    }

    /// Counts a frame that does not match.
    pub fn note_left_out(&mut self) {
        self.left_out += 1;
    }

    /// Writes a frame.
    ///
    /// # Errors
    /// The file cannot be written any more.
    pub fn write(&mut self, app: &App, frame: &Frame) -> Result<(), Failure> {
        self.part.push(*frame);
        if self.part.len() == PART { self.pass_on(app) } else { Ok(()) }
    }

    fn pass_on(&mut self, app: &App) -> Result<(), Failure> {
        let Some(recorder) = &self.recorder else { return Ok(()) };
        if !std::mem::replace(&mut self.is_begun, true) {
            recorder.set_epoch(app.epoch());
        }
        for (at, bus) in (0..=u8::MAX).zip(app.buses().iter()) {
            recorder.name_bus(BusIndex(at), &bus.name);
        }
        recorder.note_left_out(std::mem::take(&mut self.left_out));
        recorder.record_all(&self.part);
        self.part.clear();
        let status = recorder.status();
        match status.failure {
            Some(_) => Err(Failure::Unusable(format!("wrote {status}"))),
            None => Ok(()),
        }
    }

    /// Ends the file, and prints what is in it on standard error.
    ///
    /// # Errors
    /// It is not complete.
    pub fn finish(&mut self, app: &App) -> Result<(), Failure> {
        self.pass_on(app)?;
        let Some(recorder) = self.recorder.take() else { return Ok(()) };
        let status = recorder.finish();
        if status.failure.is_some() || status.lost > 0 {
            return Err(Failure::Unusable(format!("wrote {status}")));
        }
        open::report_written(&status);
        Ok(())
    }
}
