//! One file of a recording, as candump's text or as pcapng.

use super::{RecordFormat, RecorderBatch, shown};
use crate::bus::candump::write_line;
use crate::bus::pcapng;
use crate::frame::{BusIndex, Frame};
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
    pub format: RecordFormat,
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
    interfaces: Vec<OutputInterface>,
    /// The last frame's time, in Unix microseconds.
    last_micros: u64,
    /// Frames lost, by bus, before this file began.
    pub lost_before: Vec<u64>,
}

/// A bus in a pcapng file; its place is its number there.
struct OutputInterface {
    bus: BusIndex,
    frames: u64,
}

impl Output {
    pub fn create(path: &Path, format: RecordFormat) -> io::Result<Self> {
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        let mut output = Self {
            path: path.to_owned(),
            format,
            file,
            gathered: Vec::with_capacity(GATHERED + 4096),
            written: 0,
            flushed: 0,
            frames: 0,
            flushed_frames: 0,
            number: 0,
            interfaces: Vec::new(),
            last_micros: 0,
            lost_before: Vec::new(),
        };
        if format == RecordFormat::Pcapng {
            pcapng::write_section(&mut output.gathered)?;
            output.flush()?;
        }
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
        let before = self.gathered.len();
        let interfaces = self.interfaces.len();
        let micros = taken.epoch.unix_micros(frame.time);
        match self.format {
            RecordFormat::Candump => {
                write_line(&mut self.gathered, taken.epoch, &word(taken, frame.bus), frame)?;
            }
            RecordFormat::Pcapng => {
                let interface = self.interface(frame.bus, taken)?;
                pcapng::write_frame(&mut self.gathered, interface as u32, micros, frame)?;
            }
        }
        if self.len() > max_bytes {
            self.gathered.truncate(before);
            self.interfaces.truncate(interfaces);
            return Ok(false);
        }
        self.frames += 1;
        self.last_micros = micros;
        if let Some(interface) = self.interfaces.iter_mut().find(|it| it.bus == frame.bus) {
            interface.frames += 1;
        }
        if self.gathered.len() >= GATHERED {
            self.pass_on()?;
        }
        Ok(true)
    }

    /// The number of a bus in this file; it is described where it was not yet.
    fn interface(&mut self, bus: BusIndex, taken: &RecorderBatch) -> io::Result<usize> {
        if let Some(at) = self.interfaces.iter().position(|it| it.bus == bus) {
            return Ok(at);
        }
        let name = taken.names.get(usize::from(bus.0)).map_or("", String::as_str);
        pcapng::write_interface(&mut self.gathered, name)?;
        self.interfaces.push(OutputInterface { bus, frames: 0 });
        Ok(self.interfaces.len() - 1)
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

    /// Ends the file: pcapng says how many frames of each bus are in it, and how many were lost
    /// while it was written.
    pub fn finish(&mut self, taken: &RecorderBatch) -> io::Result<()> {
        if self.format == RecordFormat::Pcapng {
            // Those that had no frame may have lost some.
            for bus in 0..taken.names.len().min(256) {
                self.interface(BusIndex(bus as u8), taken)?;
            }
            for (at, interface) in self.interfaces.iter().enumerate() {
                let of =
                    |lost: &[u64]| lost.get(usize::from(interface.bus.0)).copied().unwrap_or(0);
                let lost = of(&taken.lost).saturating_sub(of(&self.lost_before));
                pcapng::write_statistics(
                    &mut self.gathered,
                    at as u32,
                    self.last_micros,
                    interface.frames,
                    lost,
                )?;
            }
        }
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

/// A bus's name as one word, as a line of a log has it.
fn word(taken: &RecorderBatch, bus: BusIndex) -> String {
    match taken.names.get(usize::from(bus.0)).map(String::as_str) {
        None | Some("") => format!("bus{}", bus.0),
        Some(name) => {
            let is_odd = |c: char| c.is_whitespace() || !crate::text::is_printable(c);
            name.replace(is_odd, "_")
        }
    }
}
