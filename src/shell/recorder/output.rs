//! One file of a recording: collects encoded frames and writes them.

use super::RecorderBatch;
use crate::frame::Frame;
use crate::log::{LogEncoder, LogEntry, LogFormat, LogTime};
use crate::open_file::{is_at, link_count};
use crate::status::RecordingStatus;
use crate::text::printable_path;
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Bytes collected before they are written, even between flushes.
const GATHERED: usize = 1 << 16;

/// One file.
pub struct Output {
    pub path: PathBuf,
    pub format: &'static LogFormat,
    encoder: Box<dyn LogEncoder>,
    file: File,
    /// Encoded bytes that are not written yet.
    gathered: Vec<u8>,
    /// Bytes written to the file.
    written: u64,
    /// Bytes up to the last flush; they end with a whole line or block.
    pub flushed: u64,
    /// Frames encoded, whether written yet or not.
    pub frames: u64,
    /// Frames up to the last flush; these remain after a later error.
    pub flushed_frames: u64,
    /// Number of the file; 0 for the first.
    pub number: u32,
    /// Frames lost before this file started, by bus.
    pub lost_before: Vec<u64>,
}

impl Output {
    pub fn create(path: &Path, format: &'static LogFormat) -> io::Result<Self> {
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        let mut output = Self {
            path: path.to_owned(),
            format,
            encoder: format.encoder(),
            file,
            gathered: Vec::with_capacity(GATHERED + 4096),
            written: 0,
            flushed: 0,
            frames: 0,
            flushed_frames: 0,
            number: 0,
            lost_before: Vec::new(),
        };
        output.encoder.begin(&mut output.gathered)?;
        output.flush()?;
        Ok(output)
    }

    fn len(&self) -> u64 {
        self.written + self.gathered.len() as u64
    }

    /// Adds a frame. Adds nothing and returns false if the file would exceed `max_bytes`.
    pub fn write(
        &mut self,
        frame: &Frame,
        taken: &RecorderBatch,
        max_bytes: u64,
    ) -> io::Result<bool> {
        let name = taken.names.get(usize::from(frame.bus.0)).map_or("", String::as_str);
        let time = LogTime::from_micros(taken.epoch.unix_micros(frame.time));
        let entry = LogEntry { time, interface: name, frame: *frame };
        let room = max_bytes.saturating_sub(self.len());
        if !self.encoder.write(entry, room, &mut self.gathered)? {
            return Ok(false);
        }
        self.frames += 1;
        if self.gathered.len() >= GATHERED {
            self.pass_on()?;
        }
        Ok(true)
    }

    fn pass_on(&mut self) -> io::Result<()> {
        self.file.write_all(&self.gathered)?;
        self.written += self.gathered.len() as u64;
        self.gathered.clear();
        Ok(())
    }

    pub fn flush(&mut self) -> io::Result<()> {
        self.pass_on()?;
        self.flushed = self.written;
        self.flushed_frames = self.frames;
        Ok(())
    }

    /// Returns an error if the file was deleted: what is written to it would be lost.
    pub fn check_place(&self) -> io::Result<()> {
        if link_count(&self.file.metadata()?) == 0 {
            return Err(io::Error::other("the file was deleted"));
        }
        Ok(())
    }

    /// Ends and syncs the file, with the number of frames lost while it was written.
    pub fn finish(&mut self, taken: &RecorderBatch) -> io::Result<()> {
        let before = self.lost_before.iter().copied().chain(std::iter::repeat(0));
        let lost = taken.lost.iter().zip(before).map(|(lost, before)| lost.saturating_sub(before));
        self.encoder.end(&taken.names, &lost.collect::<Vec<_>>(), &mut self.gathered)?;
        self.flush()?;
        self.file.sync_data()
    }

    /// Deletes the file, unless another file has taken its path.
    pub fn remove(&mut self) -> io::Result<()> {
        if is_at(&self.file, &self.path)? {
            std::fs::remove_file(&self.path)?;
        }
        (self.gathered, self.written, self.flushed) = (Vec::new(), 0, 0);
        Ok(())
    }

    /// Truncates the file to its last flush, so that it does not end inside a line or block.
    pub fn cut(&mut self) {
        // This may fail on a disk with errors; readers accept an incomplete end.
        let _ = self.file.set_len(self.flushed);
        let _ = self.file.seek(SeekFrom::Start(self.flushed));
    }

    pub fn status(&self) -> RecordingStatus {
        RecordingStatus { path: printable_path(&self.path), ..RecordingStatus::default() }
    }
}
