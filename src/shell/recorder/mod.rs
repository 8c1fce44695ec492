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
//! Frames of several buses come in batches of one bus each: they are put in order of time, for which
//! the last quarter of a second waits.
//!
//! Does not know where frames come from, nor how a file is laid out: `output` does.

mod output;
mod target;

pub use target::{Size, Target};

use crate::frame::{BusIndex, Frame};
use crate::log::{LogFormat, UnknownFormat};
use crate::status::RecordingStatus;
use crate::time::{Duration as Span, Epoch};
use output::Output;
use std::collections::VecDeque;
use std::io;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant as Monotonic};
use target::{LAST_FILE, SECOND_FILE, first_numbered, numbered};
use tokio::sync::Notify;

/// Frames that may wait: eight seconds of a full 1 Mbit/s bus, some 6 MB.
const CAPACITY: usize = 65_536;
/// How often what is there is written: wake-ups cost more than frames.
const WRITE_EVERY: Duration = Duration::from_millis(100);
/// How often the file is flushed, and its size told: what a crash can cost.
const FLUSH_EVERY: Duration = Duration::from_secs(1);

/// By how much the batches of one bus may come later than another's.
const BATCHES_APART: Span = Span::from_millis(250);

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
    #[error("{0} already exists; name another file")]
    Exists(String),
    /// It cannot be written.
    #[error("cannot record to {path}: {cause}")]
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
    shared: Arc<RecorderShared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct RecorderShared {
    state: Mutex<RecorderState>,
    work: Condvar,
    room: Condvar,
    news: Notify,
}

#[derive(Debug, Default)]
struct RecorderState {
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
        let format = LogFormat::of(&target.path)
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
        let state = RecorderState { status: file.status(), ..RecorderState::default() };
        let shared = Arc::new(RecorderShared {
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
            first_bus: None,
            has_several: false,
            held: Vec::new(),
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

impl RecorderShared {
    // A panic of the other side leaves nothing half-done in here, so its poison is ignored.
    fn state(&self) -> MutexGuard<'_, RecorderState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl RecorderState {
    fn is_over(&self) -> bool {
        self.stopped || self.status.failure.is_some()
    }
}

/// The thread.
struct Writer {
    shared: Arc<RecorderShared>,
    target: Target,
    output: Output,
    files: u32,
    /// Frames in the files before this one.
    frames_before: u64,
    /// Bytes in the files before this one.
    bytes_before: u64,
    /// Of the first frame.
    first_bus: Option<BusIndex>,
    /// Whether frames of several buses came.
    has_several: bool,
    /// Then: those that frames of another bus may still come before.
    held: Vec<Frame>,
}

impl Drop for Writer {
    /// However it ends, nobody waits for it.
    fn drop(&mut self) {
        let mut state = self.shared.state();
        if thread::panicking() {
            state.status.failure = Some("recorder stopped: this is a bug in descan".into());
            state.status_is_new = true;
        }
        drop(state);
        self.shared.room.notify_one();
        self.shared.news.notify_one();
    }
}

/// What the writer takes over at once.
#[derive(Default)]
struct RecorderBatch {
    frames: Vec<Frame>,
    epoch: Epoch,
    names: Vec<String>,
    /// Frames lost since the start, by bus, those that found the queue full included.
    lost: Vec<u64>,
    stopped: bool,
}

impl Writer {
    fn run(&mut self) {
        let mut taken = RecorderBatch::default();
        let mut flushed = Monotonic::now();
        while !taken.stopped {
            self.take(&mut taken, FLUSH_EVERY.saturating_sub(flushed.elapsed()));
            self.put_in_order(&mut taken);
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
    fn is_empty(&self, taken: &RecorderBatch) -> bool {
        self.frames_before == 0
            && self.output.frames == 0
            && taken.lost.iter().all(|lost| *lost == 0)
    }

    /// Waits until it is time to write or to stop, at most `until_flush`, and takes what is there.
    fn take(&self, taken: &mut RecorderBatch, until_flush: Duration) {
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

    /// Leaves what can be written: frames of several buses in order of time, and none that may
    /// still come after another's. Frames of one bus stay as they came.
    fn put_in_order(&mut self, taken: &mut RecorderBatch) {
        let Some(first) = self.first_bus.or(taken.frames.first().map(|frame| frame.bus)) else {
            return;
        };
        self.first_bus = Some(first);
        self.has_several |= taken.frames.iter().any(|frame| frame.bus != first);
        if !self.has_several {
            return;
        }
        let nothing_came = taken.frames.is_empty();
        self.held.append(&mut taken.frames);
        self.held.sort_by_key(|frame| frame.time);
        let newest = self.held.last().map(|frame| frame.time).unwrap_or_default();
        let ready = if nothing_came || taken.stopped {
            self.held.len()
        } else {
            let ready = self.held.partition_point(|it| newest.since(it.time) >= BATCHES_APART);
            ready.max(self.held.len().saturating_sub(CAPACITY))
        };
        taken.frames.extend(self.held.drain(..ready));
    }

    fn write(&mut self, taken: &RecorderBatch) -> io::Result<()> {
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

    fn rotate(&mut self, taken: &RecorderBatch) -> io::Result<()> {
        self.output.finish(taken)?;
        // One that was put there meanwhile is left alone.
        let number = self.output.number.max(SECOND_FILE - 1) + 1;
        for number in number..=LAST_FILE {
            match Output::create(&numbered(&self.target.path, number), self.output.format) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
                Ok(mut next) => {
                    self.frames_before += self.output.flushed_frames;
                    self.bytes_before += self.output.flushed;
                    next.number = number;
                    next.lost_before.clone_from(&taken.lost);
                    self.output = next;
                    self.files += 1;
                    return Ok(());
                }
            }
        }
        Err(io::Error::other("no number left for the next file"))
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
        io::ErrorKind::FileTooLarge => "file size limit reached".into(),
        io::ErrorKind::ReadOnlyFilesystem => "the disk has become read-only".into(),
        _ => error.to_string(),
    }
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
