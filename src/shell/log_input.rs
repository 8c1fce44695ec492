//! A log read by its own clock, as the input of a session without a screen.
//!
//! A thread reads the log up to a few batches ahead. Everything happens at log time, however fast
//! the log is read.

use super::waiting::sleep_for;
use crate::bus::{unpacked_log, wall_micros};
use crate::frame::Frame;
use crate::log::{
    DateDoubts, DecodeStep, LogDoubts, LogReader, LogSummary, Unpacked, UnreadableEntries,
};
use crate::time::{Epoch, Instant};
use std::fs::File;
use std::io::{self, BufReader};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::{Duration, Instant as Monotonic};
use tokio::sync::mpsc::{Receiver, Sender, channel};

/// Frames in one batch at most.
const BATCH: usize = 1024;
/// Batches that wait at most.
const BATCHES: usize = 4;
/// Delay of log time while the next line is not known: longer than a network usually delays it.
const INPUT_GRACE: Duration = Duration::from_secs(1);

const NEVER: Instant = Instant::from_micros(u64::MAX);

/// How log time passes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LogPace {
    /// At once: from frame to frame, as fast as they can be read.
    AtOnce,
    /// As timed, this many times as fast as recorded.
    Timed(f64),
    /// Live: frames are due when they are read; between them time passes as in reality.
    Live,
}

/// Part of a log that is read, in log time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LogRange {
    /// Start, from the log's first frame; earlier frames are skipped.
    pub from: Duration,
    /// Length, from that start; `None` reads to the end of the log.
    pub time: Option<Duration>,
}

/// What was read of a log.
#[derive(Debug)]
pub enum LogBatch {
    /// Frames, at least one.
    Frames {
        /// Unix time of the log's first frame.
        epoch: Epoch,
        /// The frames, by time.
        frames: Vec<Frame>,
        /// The interfaces first named in this batch.
        interfaces: Vec<String>,
        /// Entries before the first of the frames that cannot be read; dates up to the last frame.
        doubts: LogDoubts,
    },
    /// The first entries cannot be read: it is probably not a log. Before any other batch, once.
    Doubtful(UnreadableEntries),
    /// The end of the log, with what was read in all.
    End(LogSummary),
}

impl LogBatch {
    /// Unix time of the log's first frame.
    pub fn epoch(&self) -> Epoch {
        match self {
            Self::Frames { epoch, .. } => *epoch,
            Self::Doubtful(_) => Epoch::default(),
            Self::End(summary) => summary.epoch.unwrap_or_default(),
        }
    }
}

/// The batches of a log that a thread reads ahead.
pub struct LogBatches {
    read: Receiver<io::Result<LogBatch>>,
    /// Lists of frames that are used again.
    spare: mpsc::Sender<Vec<Frame>>,
}

impl LogBatches {
    /// Starts to read `log`; frames earlier than `from` after its first one are skipped.
    ///
    /// # Errors
    /// No thread could be started.
    pub fn spawn(log: File, from: Duration) -> io::Result<Self> {
        let (to, read) = channel(BATCHES);
        let (spare, lists) = mpsc::channel();
        // Detached: it may wait for a line forever.
        thread::Builder::new().name("log".into()).spawn(move || {
            if let Err(error) = read_all(log, from, &to, &lists) {
                let _ = to.blocking_send(Err(error));
            }
        })?;
        Ok(Self { read, spare })
    }

    /// Waits for the next batch; not after [`LogBatch::End`]. May be dropped while waiting.
    ///
    /// # Errors
    /// The log cannot be read.
    pub async fn next(&mut self) -> io::Result<LogBatch> {
        let broken = || io::Error::other("reader stopped: this is a bug in descan");
        self.read.recv().await.unwrap_or_else(|| Err(broken()))
    }

    /// Takes a list of frames that is not needed any more.
    pub fn recycle(&self, frames: Vec<Frame>) {
        // The reader may have ended.
        let _ = self.spare.send(frames);
    }
}

/// See the module's documentation.
pub struct LogInput {
    batches: LogBatches,
    interfaces: Vec<String>,
    /// Frames that were read, by time; those from `next` on are not due yet.
    waiting: Vec<Frame>,
    next: usize,
    summary: Option<LogSummary>,
    /// Doubts of what was read, up to the last frame that was due.
    doubts: LogDoubts,
    /// The same up to the first frame of `waiting`, if that is the first one of its batch.
    next_doubts: Option<LogDoubts>,
    pace: LogPace,
    /// Start and end of the range that is read.
    start: Instant,
    until: Option<Instant>,
    /// True if a batch was read.
    has_begun: bool,
    /// A real time and the log time that it was: the origin of the log's clock.
    anchor: Option<(Monotonic, Instant)>,
}

impl LogInput {
    /// Starts to read `log`.
    ///
    /// # Errors
    /// No thread could be started.
    pub fn spawn(log: File, pace: LogPace, range: LogRange) -> io::Result<Self> {
        let start = Instant::ZERO + range.from;
        Ok(Self {
            batches: LogBatches::spawn(log, range.from)?,
            interfaces: Vec::new(),
            waiting: Vec::new(),
            next: 0,
            summary: None,
            doubts: LogDoubts::default(),
            next_doubts: None,
            pace,
            start,
            until: range.time.map(|time| start + time),
            has_begun: false,
            anchor: None,
        })
    }

    /// How log time passes.
    pub fn pace(&self) -> LogPace {
        self.pace
    }

    /// Names of the interfaces, in the order of their bus indices, as far as known.
    pub fn interfaces(&self) -> &[String] {
        &self.interfaces
    }

    /// What was read in all; `None` before the end of the log.
    pub fn summary(&self) -> Option<&LogSummary> {
        self.summary.as_ref()
    }

    /// What is doubtful of the log, up to the last frame that was due; at the end of the log, all.
    pub fn doubts(&self) -> LogDoubts {
        self.summary.as_ref().map_or(self.doubts, LogSummary::doubts)
    }

    /// The start of the range that is read, at which the session starts.
    pub fn start(&self) -> Instant {
        self.start
    }

    /// The end of the range that is read; `None` if that is the log's end.
    pub fn until(&self) -> Option<Instant> {
        self.until
    }

    /// Waits for the next batch, or, with `None`, until a frame, the app's `timeout` or the end of
    /// the range is due. No batch is read while frames wait, nor after the end. May be dropped
    /// while waiting.
    ///
    /// # Errors
    /// The log cannot be read.
    pub async fn next_or_due(&mut self, timeout: Option<Instant>) -> Option<io::Result<LogBatch>> {
        let frame = self.waiting.get(self.next).map(|frame| frame.time);
        let at = [frame, timeout, self.until].into_iter().flatten().min();
        // Without a log clock only a batch moves time.
        let has_clock = self.pace != LogPace::AtOnce && self.has_begun && !self.is_held();
        let due = sleep_for(at.filter(|_| has_clock).map(|at| self.wait_until(at)));
        let may_read = !self.has_waiting() && self.summary.is_none();
        tokio::select! {
            biased;
            batch = self.batches.next(), if may_read => Some(batch),
            () = due => None,
        }
    }

    /// Waits for the first batch. May be dropped while waiting.
    ///
    /// # Errors
    /// The log cannot be read.
    pub async fn first(&mut self) -> io::Result<LogBatch> {
        self.next_or_due(None).await.unwrap_or_else(|| Err(io::ErrorKind::UnexpectedEof.into()))
    }

    /// Takes a batch; its frames are due by log time.
    pub fn take(&mut self, batch: LogBatch) {
        self.has_begun |= !matches!(batch, LogBatch::Doubtful(_));
        match batch {
            LogBatch::Doubtful(_) => {}
            LogBatch::Frames { frames, interfaces, doubts, .. } => {
                self.interfaces.extend(interfaces);
                self.next_doubts = Some(doubts);
                let last = frames.last().map_or(Instant::ZERO, |frame| frame.time);
                match self.pace {
                    LogPace::AtOnce => {}
                    LogPace::Timed(_) => {
                        self.anchor.get_or_insert((Monotonic::now(), self.start));
                    }
                    LogPace::Live => self.anchor = Some((Monotonic::now(), last)),
                }
                // No batch is read while frames wait.
                let taken = std::mem::replace(&mut self.waiting, frames);
                self.batches.recycle(taken);
                self.next = 0;
            }
            LogBatch::End(summary) => self.summary = Some(summary),
        }
    }

    /// The frames that are due, within the range, oldest first; [`Self::take_due`] removes them.
    pub fn due(&self) -> &[Frame] {
        let now = self.paced().unwrap_or(NEVER).min(self.until.unwrap_or(NEVER));
        let waiting = self.waiting.get(self.next..).unwrap_or_default();
        &waiting[..waiting.partition_point(|frame| frame.time <= now)]
    }

    /// Removes the first `count` frames that wait.
    pub fn take_due(&mut self, count: usize) {
        if count > 0 {
            self.next += count;
            self.doubts = self.next_doubts.take().unwrap_or(self.doubts);
        }
    }

    fn has_waiting(&self) -> bool {
        self.next < self.waiting.len()
    }

    /// Returns true if the range ends before the log does, and all of it is read.
    pub fn is_range_over(&self) -> bool {
        let Some(until) = self.until else { return false };
        match self.now() {
            Some(now) => now >= until,
            None => self.has_waiting(),
        }
    }

    /// Log time; `None` without a clock: before the first frame, and if the log is read at once. It does
    /// not pass a frame that waits, nor, faster than recorded, what is read next.
    pub fn now(&self) -> Option<Instant> {
        let next = self.waiting.get(self.next).map(|frame| frame.time);
        let held = || self.waiting.last().map_or(self.start, |frame| frame.time);
        let limit = next.or_else(|| self.is_held().then(held));
        Some(self.paced()?.min(limit.unwrap_or(NEVER)))
    }

    /// Log time by the clock, whatever was read.
    fn paced(&self) -> Option<Instant> {
        let (since, from) = self.anchor?;
        Some(from + since.elapsed().saturating_sub(self.grace()).mul_f64(self.speed()))
    }

    /// Returns true while time stands until more is read: the grace is not long at this speed.
    fn is_held(&self) -> bool {
        self.speed() > 1.0 && !self.has_waiting() && self.summary.is_none()
    }

    fn wait_until(&self, at: Instant) -> Duration {
        let Some((since, from)) = self.anchor else { return Duration::ZERO };
        let wait = at.since(from).div_f64(self.speed()) + self.grace();
        wait.saturating_sub(since.elapsed())
    }

    fn speed(&self) -> f64 {
        if let LogPace::Timed(speed) = self.pace { speed } else { 1.0 }
    }

    /// Delay of log time: the next line may be on its way.
    fn grace(&self) -> Duration {
        if self.has_waiting() { Duration::ZERO } else { INPUT_GRACE }
    }
}

/// Reads the first frame; `None` if there is none. Sends a batch when it is doubtful that there is
/// one.
fn read_first(
    reader: &mut LogReader<BufReader<Unpacked<'_>>>,
    to: &Sender<io::Result<LogBatch>>,
) -> io::Result<Option<Frame>> {
    let mut is_reported = false;
    loop {
        match reader.step()? {
            DecodeStep::Frame(frame) => return Ok(Some(frame)),
            DecodeStep::End => return Ok(None),
            DecodeStep::Nothing if !is_reported && is_doubtful(reader) => {
                is_reported = true;
                let entries = reader.summary().unreadable_entries();
                // The receiver may be gone: the next batch shows it.
                let _ = to.blocking_send(Ok(LogBatch::Doubtful(entries)));
            }
            DecodeStep::Nothing => {}
        }
    }
}

fn is_doubtful(reader: &LogReader<BufReader<Unpacked<'_>>>) -> bool {
    reader.summary().is_doubtful(reader.source().buffer().is_empty())
}

/// Reads the log and sends the frames present from `from` on, before it waits for more. A batch
/// ends where entries cannot be read: they belong to the part before the next frame. It ends before the
/// first frame with a doubtful date, too.
fn read_all(
    log: File,
    from: Duration,
    to: &Sender<io::Result<LogBatch>>,
    spare: &mpsc::Receiver<Vec<Frame>>,
) -> io::Result<()> {
    let from = Instant::ZERO + from;
    let is_file = log.metadata()?.is_file();
    let log = Arc::new(log);
    let source = unpacked_log(Arc::clone(&log), &log)?;
    let mut reader = LogReader::new(BufReader::with_capacity(1 << 16, source));
    if !is_file {
        reader.date_arrivals(wall_micros);
    }
    let mut named = 0;
    let mut known_doubts = DateDoubts::default();
    let mut next = read_first(&mut reader, to)?;
    loop {
        let first = match next.take() {
            Some(frame) => Some(frame),
            None => reader.next_frame()?,
        };
        let Some(first) = first else { break };
        let mut frames = spare.try_recv().unwrap_or_default();
        frames.clear();
        frames.push(first);
        reader.take_buffered(&mut frames, BATCH);
        if first.time < from {
            reader.forget_unreadable();
            let skipped = frames.partition_point(|frame| frame.time < from);
            frames.drain(..skipped);
            if frames.is_empty() {
                continue;
            }
        }
        let entries = reader.summary().unreadable_entries();
        let mut dates = reader.summary().dates;
        known_doubts = known_doubts.union(dates);
        while frames.len() < BATCH
            && let Some(frame) = reader.next_buffered()
        {
            let summary = reader.summary();
            let is_doubt_new = summary.dates.union(known_doubts) != known_doubts;
            if summary.lost_entries() > entries.count || is_doubt_new {
                next = Some(frame);
                break;
            }
            dates = summary.dates;
            frames.push(frame);
            reader.take_buffered(&mut frames, BATCH);
        }
        let summary = reader.summary();
        let epoch = summary.epoch.unwrap_or_default();
        let interfaces = summary.interfaces[named..].to_vec();
        named = summary.interfaces.len();
        let doubts = LogDoubts { entries, dates };
        let batch = LogBatch::Frames { epoch, frames, interfaces, doubts };
        if to.blocking_send(Ok(batch)).is_err() {
            return Ok(());
        }
    }
    // The receiver may be gone.
    let _ = to.blocking_send(Ok(LogBatch::End(reader.summary().clone())));
    Ok(())
}
