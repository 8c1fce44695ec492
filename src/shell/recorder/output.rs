//! One file of a recording.

use super::{RecorderBatch, shown};
use crate::frame::Frame;
use crate::log::{LogEncoder, LogEntry, LogFormat};
use crate::status::RecordingStatus;
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Bytes that gather before they are written though it is not time to flush.
const GATHERED: usize = 1 << 16;

/// One file.
pub struct Output {
    pub path: PathBuf,
    pub format: &'static LogFormat,
    encoder: Box<dyn LogEncoder>,
    file: File,
    /// What is yet to be written.
    gathered: Vec<u8>,
    /// Bytes in the file.
    written: u64,
    /// Bytes in the file that end with a whole line or block and were told.
    pub flushed: u64,
    /// Frames that were written, or are to be.
    pub frames: u64,
    /// Those of them that are among the flushed bytes: what there is, whatever fails later.
    pub flushed_frames: u64,
    /// 0: the first.
    pub number: u32,
    /// Frames lost, by bus, before this file began.
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

    /// Writes a frame; not if the file would grow beyond `max_bytes` by it.
    pub fn write(
        &mut self,
        frame: &Frame,
        taken: &RecorderBatch,
        max_bytes: u64,
    ) -> io::Result<bool> {
        let name = taken.names.get(usize::from(frame.bus.0)).map_or("", String::as_str);
        let unix_micros = taken.epoch.unix_micros(frame.time);
        let entry = LogEntry { unix_micros, interface: name, frame: *frame };
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

    /// Whether anybody can still find the file: what is written to one that was deleted is lost.
    pub fn check_place(&self) -> io::Result<()> {
        if self.file.metadata()?.nlink() == 0 {
            return Err(io::Error::other("the file was deleted"));
        }
        Ok(())
    }

    /// Ends the file, with the number of frames that were lost while it was written.
    pub fn finish(&mut self, taken: &RecorderBatch) -> io::Result<()> {
        let before = self.lost_before.iter().copied().chain(std::iter::repeat(0));
        let lost = taken.lost.iter().zip(before).map(|(lost, before)| lost.saturating_sub(before));
        self.encoder.end(&taken.names, &lost.collect::<Vec<_>>(), &mut self.gathered)?;
        self.flush()?;
        self.file.sync_data()
    }

    /// Takes the file away, if it is still the one at its place.
    pub fn remove(&mut self) -> io::Result<()> {
        let (own, there) = (self.file.metadata()?, std::fs::metadata(&self.path)?);
        if (own.dev(), own.ino()) == (there.dev(), there.ino()) {
            std::fs::remove_file(&self.path)?;
        }
        (self.gathered, self.written, self.flushed) = (Vec::new(), 0, 0);
        Ok(())
    }

    /// After a failure: no half line or block stays behind.
    pub fn cut(&mut self) {
        // A disk that cannot be written to may not allow it; readers bear a cut end.
        let _ = self.file.set_len(self.flushed);
        let _ = self.file.seek(SeekFrom::Start(self.flushed));
    }

    pub fn status(&self) -> RecordingStatus {
        RecordingStatus { path: shown(&self.path), ..RecordingStatus::default() }
    }
}
