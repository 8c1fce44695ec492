//! Recorder: writes frames of a session to a file, as candump text or pcapng, on a thread of
//! its own, so that a slow disk delays neither the bus nor the screen.
//!
//! The queue of frames to be written is bounded; frames that do not fit are counted as lost, and
//! pcapng files contain that number. The file is flushed each second and at the end. With a size
//! limit, the next file starts before a file exceeds it: after `session.log` follow
//! `session_00002.log`, `session_00003.log`, …; each can be read on its own. Existing files are
//! never changed. After a write error, the file ends with its last flush and the recording stops;
//! the session continues.
//!
//! Frames arrive in batches, each of one bus. To sort them by time, frames of the last 250 ms are
//! held back.
//!
//! Does not know the source of frames or the layout of files: see `output`.

mod output;
mod target;

pub use target::{Size, Target};

use super::store::{Store, already_exists, not_written};
use crate::diagnostic::Diagnostic;
use crate::frame::{BusIndex, Frame};
use crate::log::LogFormat;
use crate::status::RecordingStatus;
use crate::text::printable_path;
use crate::time::{Duration as Span, Epoch};
use output::Output;
use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant as Monotonic};
use target::{LAST_FILE, SECOND_FILE, first_numbered, numbered};
use tokio::sync::Notify;

/// Capacity of the queue in frames: 8 s of a 1 Mbit/s bus at full load, some 6 MB.
const CAPACITY: usize = 65_536;
/// Interval of writes: a wake-up costs more than a frame.
const WRITE_EVERY: Duration = Duration::from_millis(100);
/// Interval of flushes and status updates: at most this much is lost in a crash.
const FLUSH_EVERY: Duration = Duration::from_secs(1);

/// Largest delay of the batches of one bus relative to those of another.
const BATCHES_APART: Span = Span::from_millis(250);

/// A recording in progress. Dropping it writes all queued frames and ends it.
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
    /// By bus; empty if not known.
    names: Vec<String>,
    /// Frames lost before they reached the recorder since the start, by bus.
    lost: Vec<u64>,
    /// Frames that did not fit into the queue, by bus.
    overflowed: Vec<u64>,
    stopped: bool,
    status: RecordingStatus,
    status_is_new: bool,
}

impl Recorder {
    /// Creates the first file and starts the thread.
    ///
    /// # Errors
    /// The file name does not show a log format; the file, or one that may follow it, already
    /// exists; or it cannot be created.
    pub fn create(target: &Target) -> Result<Self, Diagnostic> {
        let path = printable_path(&target.path);
        let format = LogFormat::of(&target.path).map_err(|fault| {
            Diagnostic::new(fault.to_string()).of(format_args!("--record {path}"))
        })?;
        if target.max_bytes.is_some()
            && let Some(there) = first_numbered(&target.path)
        {
            return Err(already_exists().of(printable_path(&there)));
        }
        let file = Output::create(&target.path, format).map_err(|error| {
            let store = Store::new(&target.path);
            let fault = store.check_new().err().or_else(|| store.missing_folder());
            fault.unwrap_or_else(|| not_written(&error)).of(&path)
        })?;
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
            .map_err(|error| not_written(&error).of(&path))?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Sets the Unix time of [`Instant::ZERO`](crate::time::Instant::ZERO). Call before the first
    /// frame.
    pub fn set_epoch(&self, epoch: Epoch) {
        self.shared.state().epoch = epoch;
    }

    /// Sets the name of a bus. A bus with frames in a pcapng file keeps its name in that file.
    pub fn name_bus(&self, bus: BusIndex, name: &str) {
        let mut state = self.shared.state();
        let own = entry(&mut state.names, bus);
        if own != name {
            name.clone_into(own);
        }
    }

    /// Sets the number of frames of a bus that were lost before they reached the recorder.
    pub fn note_lost(&self, bus: BusIndex, total: u64) {
        *entry(&mut self.shared.state().lost, bus) = total;
    }

    /// Sets the filter of the recorded frames, for the status.
    pub fn set_filter(&self, line: &str) {
        self.shared.state().status.filter = Some(crate::text::printable(line.as_bytes()));
    }

    /// Counts frames that do not match the filter.
    pub fn note_left_out(&self, count: u64) {
        self.shared.state().status.left_out += count;
    }

    /// Queues frames without blocking. Frames that do not fit are counted as lost.
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

    /// Queues frames that can wait, such as those of a log: blocks until there is room.
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

    /// Waits until the status has changed since it was last taken. For one consumer.
    pub async fn changed(&self) {
        while !self.shared.state().status_is_new {
            self.shared.news.notified().await;
        }
    }

    /// Returns the status.
    pub fn status(&self) -> RecordingStatus {
        self.shared.state().status.clone()
    }

    /// Returns the status if it has changed since it was last taken.
    pub fn take_status(&self) -> Option<RecordingStatus> {
        let mut state = self.shared.state();
        std::mem::take(&mut state.status_is_new).then(|| state.status.clone())
    }

    /// Writes all queued frames, ends the recording and returns its final status.
    pub fn finish(mut self) -> RecordingStatus {
        self.end();
        self.shared.state().status.clone()
    }

    fn end(&mut self) {
        self.shared.state().stopped = true;
        self.shared.work.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic of the thread is reported in the status.
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
    // A panic leaves no inconsistent state behind this lock, so poisoning is ignored.
    fn state(&self) -> MutexGuard<'_, RecorderState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl RecorderState {
    fn is_over(&self) -> bool {
        self.stopped || self.status.failure.is_some()
    }
}

/// State of the recorder thread.
struct Writer {
    shared: Arc<RecorderShared>,
    target: Target,
    output: Output,
    files: u32,
    /// Frames in the files before this one.
    frames_before: u64,
    /// Bytes in the files before this one.
    bytes_before: u64,
    /// Bus of the first frame.
    first_bus: Option<BusIndex>,
    /// True if frames of several buses were received.
    has_several: bool,
    /// With several buses: frames before which a frame of another bus may still arrive.
    held: Vec<Frame>,
}

impl Drop for Writer {
    /// Marks the recording as ended on any exit, a panic included, so that no caller blocks.
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

/// What the writer takes from the queue in one turn.
#[derive(Default)]
struct RecorderBatch {
    frames: Vec<Frame>,
    epoch: Epoch,
    names: Vec<String>,
    /// Frames lost since the start, by bus, including those that did not fit into the queue.
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

    /// Returns true if no frames were recorded or lost: such a file is removed.
    fn is_empty(&self, taken: &RecorderBatch) -> bool {
        self.frames_before == 0
            && self.output.frames == 0
            && taken.lost.iter().all(|lost| *lost == 0)
    }

    /// Waits at most `until_flush` until there is something to write or to stop, and takes it.
    fn take(&self, taken: &mut RecorderBatch, until_flush: Duration) {
        let state = self.shared.state();
        let (state, _) = self
            .shared
            .work
            .wait_timeout_while(state, until_flush, |state| {
                state.queue.is_empty() && !state.stopped
            })
            .unwrap_or_else(PoisonError::into_inner);
        // Collects frames, so that each write covers more of them.
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

    /// Keeps in `taken` the frames that can be written now. Frames of several buses are sorted by
    /// time, and the newest wait for those of other buses; frames of one bus keep their order.
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
                // A file holds at least one frame, whatever the size limit.
                self.output.write(frame, taken, u64::MAX)?;
            }
        }
        Ok(())
    }

    fn rotate(&mut self, taken: &RecorderBatch) -> io::Result<()> {
        self.output.finish(taken)?;
        // A file with this number created since then is not overwritten.
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

    /// Publishes the status. After a write error, only flushed frames count.
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
            filter: state.status.filter.clone(),
            left_out: state.status.left_out,
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

/// Returns the text of a write error.
fn why(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "the disk is full".into(),
        io::ErrorKind::FileTooLarge => "file size limit reached".into(),
        io::ErrorKind::ReadOnlyFilesystem => "the disk has become read-only".into(),
        _ => error.to_string(),
    }
}

/// Returns the value of a bus in a list by bus; extends the list if necessary.
fn entry<T: Default + Clone>(list: &mut Vec<T>, bus: BusIndex) -> &mut T {
    let at = usize::from(bus.0);
    if list.len() <= at {
        list.resize(at + 1, T::default());
    }
    &mut list[at]
}
