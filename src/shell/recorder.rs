//! Recording: every frame of a session into a file, candump's text or pcapng, on a thread of its
//! own, so that a slow disk holds up neither the bus nor the screen.
//!
//! What waits to be written is bounded; what does not fit is left out and counted, and pcapng files
//! say how many were lost. The file is flushed each second and at the end. Where a size is given,
//! the next file begins before a file outgrows it: after `session.log` come `session_00002.log`,
//! `session_00003.log`, …; each can be read alone. No file that is there already is touched. Where
//! writing fails, the file ends with the last whole second and recording is over; the session
//! goes on.
//!
//! Does not know where frames come from.

use crate::bus::candump::write_line;
use crate::bus::pcapng;
use crate::frame::{BusIndex, Frame};
use crate::status::RecordingStatus;
use crate::time::Epoch;
use std::collections::VecDeque;
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant as Monotonic};
use tokio::sync::Notify;

/// Frames that may wait: eight seconds of a full 1 Mbit/s bus, some 6 MB.
const CAPACITY: usize = 65_536;
/// How often what is there is written: wake-ups cost more than frames.
const WRITE_EVERY: Duration = Duration::from_millis(100);
/// How often the file is flushed, and its size told: what a crash can cost.
const FLUSH_EVERY: Duration = Duration::from_secs(1);
/// Bytes that gather before they are written though it is not time to flush.
const GATHERED: usize = 1 << 16;
/// The second file of a recording has this number; the first has none.
const SECOND_FILE: u32 = 2;
const LAST_FILE: u32 = 99_999;

/// Where to record, and into files of which size.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    /// The first file.
    pub path: PathBuf,
    /// A file that would grow beyond so many bytes is followed by another.
    pub max_bytes: Option<u64>,
}

/// What a file's name says of its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// candump's text: `.log`, `.txt`, `.candump`.
    Candump,
    /// `.pcapng`.
    Pcapng,
}

/// A file name that says nothing of its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("end it with .log (also .txt, .candump) for candump's text, or with .pcapng")]
pub struct UnknownFormat;

impl Format {
    /// By the file's extension.
    pub fn of(path: &Path) -> Result<Self, UnknownFormat> {
        let extension = path.extension().and_then(|it| it.to_str()).unwrap_or_default();
        match extension.to_ascii_lowercase().as_str() {
            "log" | "txt" | "candump" => Ok(Format::Candump),
            "pcapng" => Ok(Format::Pcapng),
            _ => Err(UnknownFormat),
        }
    }
}

/// A size in bytes as it is written on the command line: `100M`, `500k`, `2G`, `65536`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size(pub u64);

impl Size {
    /// Smaller files would be mostly heads.
    const LEAST: u64 = 10_000;
}

impl FromStr for Size {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
        let unit = match text[digits.len()..].to_ascii_lowercase().as_str() {
            "" | "b" => 1,
            "k" | "kb" => 1_000,
            "m" | "mb" => 1_000_000,
            "g" | "gb" => 1_000_000_000,
            _ => 0,
        };
        let bytes = digits.parse().ok().and_then(|count: u64| count.checked_mul(unit));
        bytes
            .filter(|bytes| *bytes >= Self::LEAST)
            .map(Size)
            .ok_or("a size like 500k, 100M or 2G, at least 10k")
    }
}

/// Why a recording cannot begin.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The name says nothing of the content.
    #[error("--record {path}: {fault}")]
    Format {
        /// The file.
        path: String,
        /// What would be right.
        fault: UnknownFormat,
    },
    /// It, or one that would come after it, is there.
    #[error("{0} is there already and is not overwritten; name another file, or move it away")]
    Exists(String),
    /// It cannot be written.
    #[error("{path} cannot be recorded to: {cause}")]
    Unwritable {
        /// The file.
        path: String,
        /// Why.
        cause: io::Error,
    },
}

/// A recording that is under way. Dropping it ends it, with all that was recorded.
#[derive(Debug)]
pub struct Recorder {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    state: Mutex<State>,
    work: Condvar,
    room: Condvar,
    news: Notify,
}

#[derive(Debug, Default)]
struct State {
    queue: VecDeque<Frame>,
    epoch: Epoch,
    /// By bus; empty where it is not known.
    names: Vec<String>,
    /// Frames lost before they came here, by bus, since the start.
    lost: Vec<u64>,
    /// Frames that found the queue full, by bus.
    overflowed: Vec<u64>,
    stopped: bool,
    status: RecordingStatus,
    status_is_new: bool,
}

impl Recorder {
    /// Begins the first file.
    pub fn create(target: &Target) -> Result<Self, RecordError> {
        let path = shown(&target.path);
        let format = Format::of(&target.path)
            .map_err(|fault| RecordError::Format { path: path.clone(), fault })?;
        if target.max_bytes.is_some()
            && let Some(there) = first_numbered(&target.path)
        {
            return Err(RecordError::Exists(shown(&there)));
        }
        let unwritable = |cause: io::Error| match cause.kind() {
            io::ErrorKind::AlreadyExists => RecordError::Exists(path.clone()),
            _ => RecordError::Unwritable { path: path.clone(), cause },
        };
        let file = Output::create(&target.path, format).map_err(unwritable)?;
        let state = State { status: file.status(), ..State::default() };
        let shared = Arc::new(Shared {
            state: Mutex::new(state),
            work: Condvar::new(),
            room: Condvar::new(),
            news: Notify::new(),
        });
        let mut writer = Writer {
            shared: Arc::clone(&shared),
            target: target.clone(),
            output: file,
            files: 1,
            frames_before: 0,
            bytes_before: 0,
        };
        let thread = thread::Builder::new()
            .name("recorder".into())
            .spawn(move || writer.run())
            .map_err(unwritable)?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Says which Unix time the moments of frames count from. Before the first frame.
    pub fn set_epoch(&self, epoch: Epoch) {
        self.shared.state().epoch = epoch;
    }

    /// Says what a bus is called. Once it has frames in a pcapng file, it keeps its name there.
    pub fn name_bus(&self, bus: BusIndex, name: &str) {
        let mut state = self.shared.state();
        let own = entry(&mut state.names, bus);
        if own != name {
            name.clone_into(own);
        }
    }

    /// Says how many frames of a bus were lost since the start, before they came here.
    pub fn note_lost(&self, bus: BusIndex, total: u64) {
        *entry(&mut self.shared.state().lost, bus) = total;
    }

    /// Takes frames; never waits. Those that do not fit are counted.
    pub fn record(&self, frames: &[Frame]) {
        if frames.is_empty() {
            return;
        }
        let mut state = self.shared.state();
        if state.is_over() {
            return;
        }
        let was_empty = state.queue.is_empty();
        let room = CAPACITY - state.queue.len();
        let (fitting, lost) = frames.split_at(room.min(frames.len()));
        state.queue.extend(fitting);
        for frame in lost {
            *entry(&mut state.overflowed, frame.bus) += 1;
        }
        if !lost.is_empty() {
            state.status.lost += lost.len() as u64;
            state.status_is_new = true;
            self.shared.news.notify_one();
        }
        drop(state);
        if was_empty {
            self.shared.work.notify_one();
        }
    }

    /// Takes frames that can wait, as those of a log can: waits until there is room.
    pub fn record_all(&self, frames: &[Frame]) {
        for piece in frames.chunks(CAPACITY / 4) {
            let mut state = self.shared.state();
            while !state.is_over() && CAPACITY - state.queue.len() < piece.len() {
                self.shared.work.notify_one();
                state = self.shared.room.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
            drop(state);
            self.record(piece);
        }
    }

    /// Waits until its status has changed since it was taken. For one consumer.
    pub async fn changed(&self) {
        while !self.shared.state().status_is_new {
            self.shared.news.notified().await;
        }
    }

    /// Its status.
    pub fn status(&self) -> RecordingStatus {
        self.shared.state().status.clone()
    }

    /// Its status, if it has changed since it was last taken.
    pub fn take_status(&self) -> Option<RecordingStatus> {
        let mut state = self.shared.state();
        std::mem::take(&mut state.status_is_new).then(|| state.status.clone())
    }

    /// Writes what there still is, and says what was recorded.
    pub fn finish(mut self) -> RecordingStatus {
        self.end();
        self.shared.state().status.clone()
    }

    fn end(&mut self) {
        self.shared.state().stopped = true;
        self.shared.work.notify_one();
        if let Some(thread) = self.thread.take() {
            // Its panic is in the status.
            let _ = thread.join();
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.end();
    }
}

impl Shared {
    // A panic of the other side leaves nothing half-done in here, so its poison is ignored.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn is_over(&self) -> bool {
        self.stopped || self.status.failure.is_some()
    }
}

/// The thread.
struct Writer {
    shared: Arc<Shared>,
    target: Target,
    output: Output,
    files: u32,
    /// Frames in the files before this one.
    frames_before: u64,
    /// Bytes in the files before this one.
    bytes_before: u64,
}

impl Drop for Writer {
    /// However it ends, nobody waits for it.
    fn drop(&mut self) {
        let mut state = self.shared.state();
        if thread::panicking() {
            state.status.failure = Some("writing broke off: this is a bug in descan".into());
            state.status_is_new = true;
        }
        drop(state);
        self.shared.room.notify_one();
        self.shared.news.notify_one();
    }
}

/// What the writer takes over at once.
#[derive(Default)]
struct Taken {
    frames: Vec<Frame>,
    epoch: Epoch,
    names: Vec<String>,
    /// Frames lost since the start, by bus, those that found the queue full included.
    lost: Vec<u64>,
    stopped: bool,
}

impl Writer {
    fn run(&mut self) {
        let mut taken = Taken::default();
        let mut flushed = Monotonic::now();
        while !taken.stopped {
            self.take(&mut taken, FLUSH_EVERY.saturating_sub(flushed.elapsed()));
            let mut outcome = self.write(&taken);
            if outcome.is_ok() && (taken.stopped || flushed.elapsed() >= FLUSH_EVERY) {
                flushed = Monotonic::now();
                outcome = self.output.flush().and_then(|()| self.output.check_place());
            }
            if taken.stopped && outcome.is_ok() {
                outcome = if self.is_empty(&taken) {
                    self.output.remove()
                } else {
                    self.output.finish(&taken)
                };
            }
            let is_over = outcome.is_err();
            self.tell(outcome);
            if is_over {
                return;
            }
        }
    }

    /// Nothing came, and nothing was lost: such a file would only be in the way.
    fn is_empty(&self, taken: &Taken) -> bool {
        self.frames_before == 0
            && self.output.frames == 0
            && taken.lost.iter().all(|lost| *lost == 0)
    }

    /// Waits until it is time to write or to stop, at most `until_flush`, and takes what is there.
    fn take(&self, taken: &mut Taken, until_flush: Duration) {
        let state = self.shared.state();
        let (state, _) = self
            .shared
            .work
            .wait_timeout_while(state, until_flush, |state| {
                state.queue.is_empty() && !state.stopped
            })
            .unwrap_or_else(PoisonError::into_inner);
        // Lets frames gather.
        let (mut state, _) = self
            .shared
            .work
            .wait_timeout_while(state, WRITE_EVERY.min(until_flush), |state| {
                !state.stopped && state.queue.len() < CAPACITY / 2
            })
            .unwrap_or_else(PoisonError::into_inner);
        taken.frames.clear();
        taken.frames.extend(state.queue.drain(..));
        taken.epoch = state.epoch;
        taken.names.clone_from(&state.names);
        taken.lost.clone_from(&state.lost);
        for (bus, overflowed) in state.overflowed.iter().enumerate() {
            *entry(&mut taken.lost, BusIndex(bus as u8)) += overflowed;
        }
        taken.stopped = state.stopped;
        drop(state);
        self.shared.room.notify_one();
    }

    fn write(&mut self, taken: &Taken) -> io::Result<()> {
        let max_bytes = self.target.max_bytes.unwrap_or(u64::MAX);
        for frame in &taken.frames {
            if !self.output.write(frame, taken, max_bytes)? {
                self.rotate(taken)?;
                // A file holds at least one frame, whatever size was asked for.
                self.output.write(frame, taken, u64::MAX)?;
            }
        }
        Ok(())
    }

    fn rotate(&mut self, taken: &Taken) -> io::Result<()> {
        self.output.finish(taken)?;
        // One that was put there meanwhile is left alone.
        let number = self.output.number.max(SECOND_FILE - 1) + 1;
        for number in number..=LAST_FILE {
            match Output::create(&numbered(&self.target.path, number), self.output.format) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
                Ok(next) => {
                    self.frames_before += self.output.flushed_frames;
                    self.bytes_before += self.output.flushed;
                    let lost_before = taken.lost.clone();
                    self.output = Output { number, lost_before, ..next };
                    self.files += 1;
                    return Ok(());
                }
            }
        }
        Err(io::Error::other("there is no number left for the next file"))
    }

    /// Says how far it is; where it failed, what is flushed is what there is.
    fn tell(&mut self, outcome: io::Result<()>) {
        let failure = outcome.err().map(|error| {
            self.output.cut();
            why(&error)
        });
        let is_over = failure.is_some();
        let mut state = self.shared.state();
        let status = RecordingStatus {
            files: self.files,
            frames: self.frames_before + self.output.flushed_frames,
            bytes: self.bytes_before + self.output.flushed,
            lost: state.status.lost,
            failure,
            ..self.output.status()
        };
        if is_over {
            state.queue.clear();
        }
        if status != state.status && (is_over || status.bytes != state.status.bytes) {
            state.status = status;
            state.status_is_new = true;
            self.shared.news.notify_one();
        }
    }
}

/// Why it cannot go on, in words.
fn why(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "the disk is full".into(),
        io::ErrorKind::FileTooLarge => "the file may not grow any more".into(),
        io::ErrorKind::ReadOnlyFilesystem => "the disk cannot be written to any more".into(),
        _ => error.to_string(),
    }
}

/// One file.
struct Output {
    path: PathBuf,
    format: Format,
    file: File,
    /// What is yet to be written.
    gathered: Vec<u8>,
    /// Bytes in the file.
    written: u64,
    /// Bytes in the file that end with a whole line or block and were told.
    flushed: u64,
    /// Frames that were written, or are to be.
    frames: u64,
    /// Those of them that are among the flushed bytes: what there is, whatever fails later.
    flushed_frames: u64,
    /// 0: the first.
    number: u32,
    interfaces: Vec<Interface>,
    /// The last frame's time, in Unix microseconds.
    last_micros: u64,
    /// Frames lost, by bus, before this file began.
    lost_before: Vec<u64>,
}

/// A bus in a pcapng file; its place is its number there.
struct Interface {
    bus: BusIndex,
    frames: u64,
}

impl Output {
    fn create(path: &Path, format: Format) -> io::Result<Self> {
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
        if format == Format::Pcapng {
            pcapng::write_section(&mut output.gathered)?;
            output.flush()?;
        }
        Ok(output)
    }

    fn len(&self) -> u64 {
        self.written + self.gathered.len() as u64
    }

    /// Writes a frame; not if the file would grow beyond `max_bytes` by it.
    fn write(&mut self, frame: &Frame, taken: &Taken, max_bytes: u64) -> io::Result<bool> {
        let before = self.gathered.len();
        let interfaces = self.interfaces.len();
        let micros = taken.epoch.unix_micros(frame.time);
        match self.format {
            Format::Candump => {
                write_line(&mut self.gathered, taken.epoch, &word(taken, frame.bus), frame)?;
            }
            Format::Pcapng => {
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
    fn interface(&mut self, bus: BusIndex, taken: &Taken) -> io::Result<usize> {
        if let Some(at) = self.interfaces.iter().position(|it| it.bus == bus) {
            return Ok(at);
        }
        let name = taken.names.get(usize::from(bus.0)).map_or("", String::as_str);
        pcapng::write_interface(&mut self.gathered, name)?;
        self.interfaces.push(Interface { bus, frames: 0 });
        Ok(self.interfaces.len() - 1)
    }

    fn pass_on(&mut self) -> io::Result<()> {
        self.file.write_all(&self.gathered)?;
        self.written += self.gathered.len() as u64;
        self.gathered.clear();
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.pass_on()?;
        self.flushed = self.written;
        self.flushed_frames = self.frames;
        Ok(())
    }

    /// Whether anybody can still find the file: what is written to one that was deleted is lost.
    fn check_place(&self) -> io::Result<()> {
        if self.file.metadata()?.nlink() == 0 {
            return Err(io::Error::other("the file was deleted"));
        }
        Ok(())
    }

    /// Ends the file: pcapng says how many frames of each bus are in it, and how many were lost
    /// while it was written.
    fn finish(&mut self, taken: &Taken) -> io::Result<()> {
        if self.format == Format::Pcapng {
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
    fn remove(&mut self) -> io::Result<()> {
        let (own, there) = (self.file.metadata()?, std::fs::metadata(&self.path)?);
        if (own.dev(), own.ino()) == (there.dev(), there.ino()) {
            std::fs::remove_file(&self.path)?;
        }
        (self.gathered, self.written, self.flushed) = (Vec::new(), 0, 0);
        Ok(())
    }

    /// After a failure: no half line or block stays behind.
    fn cut(&mut self) {
        // A disk that cannot be written to may not allow it; readers bear a cut end.
        let _ = self.file.set_len(self.flushed);
        let _ = self.file.seek(SeekFrom::Start(self.flushed));
    }

    fn status(&self) -> RecordingStatus {
        RecordingStatus { path: shown(&self.path), ..RecordingStatus::default() }
    }
}

/// A bus's name as one word, as a line of a log has it.
fn word(taken: &Taken, bus: BusIndex) -> String {
    match taken.names.get(usize::from(bus.0)).map(String::as_str) {
        None | Some("") => format!("bus{}", bus.0),
        Some(name) => {
            let is_odd = |c: char| c.is_whitespace() || !crate::text::is_printable(c);
            name.replace(is_odd, "_")
        }
    }
}

/// The file of that number: `session.log`, `session_00002.log`.
fn numbered(path: &Path, number: u32) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("_{number:05}."));
    name.push(path.extension().unwrap_or_default());
    path.with_file_name(name)
}

/// A file that is there and would come after that one.
fn first_numbered(path: &Path) -> Option<PathBuf> {
    let stem = path.file_stem()?.to_str()?;
    let folder = path.parent().filter(|it| !it.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut there: Vec<PathBuf> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(|it| Some(it.ok()?.path()))
        .filter(|other| other.extension() == path.extension())
        .filter(|other| {
            let number = other.file_stem().and_then(|it| it.to_str()?.strip_prefix(stem));
            let digits = number.and_then(|it| it.strip_prefix('_')).unwrap_or_default();
            digits.len() == 5 && digits.bytes().all(|digit| digit.is_ascii_digit())
        })
        .collect();
    there.sort();
    there.into_iter().next()
}

fn shown(path: &Path) -> String {
    crate::text::printable(path.as_os_str().as_encoded_bytes())
}

/// The value of a bus in a list by bus, which grows as far as it must.
fn entry<T: Default + Clone>(list: &mut Vec<T>, bus: BusIndex) -> &mut T {
    let at = usize::from(bus.0);
    if list.len() <= at {
        list.resize(at + 1, T::default());
    }
    &mut list[at]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_as_they_are_written() {
        let size = |text: &str| text.parse().map(|Size(bytes)| bytes);
        assert_eq!(size("100M"), Ok(100_000_000));
        assert_eq!(size("500k"), Ok(500_000));
        assert_eq!(size("2GB"), Ok(2_000_000_000));
        assert_eq!(size("65536"), Ok(65_536));
        for wrong in ["", "M", "1k", "0", "-5M", "5x", "99999999999G", "1.5M"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_name_tells_the_format() {
        assert_eq!(Format::of(Path::new("a/b.LOG")), Ok(Format::Candump));
        assert_eq!(Format::of(Path::new("b.pcapng")), Ok(Format::Pcapng));
        for wrong in ["b", "b.pcap", ".log", "b.log.gz"] {
            assert_eq!(Format::of(Path::new(wrong)), Err(UnknownFormat), "{wrong}");
        }
    }

    #[test]
    fn files_that_come_after_have_numbers() {
        let second = numbered(Path::new("/tmp/a.b.log"), SECOND_FILE);
        assert_eq!(second, Path::new("/tmp/a.b_00002.log"));
    }
}
