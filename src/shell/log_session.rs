//! A log read by its own clock: the app, the log, and what passes between them.
//!
//! [`Session`](super::session::Session) is its sibling for buses that are there. The log is read
//! on a thread of its own, a few batches ahead. Everything happens at the log's times, however
//! fast it is read.

use super::file_watcher::{DiskContent, FileWatcher};
use super::recorder::Recorder;
use super::store::Store;
use super::waiting::{file_changed, sleep_for};
use crate::app::{App, AppOptions};
use crate::discovery::Config;
use crate::frame::{BusIndex, Frame};
use crate::log::{LogReader, LogSummary};
use crate::status::{BusStatus, Link, RecordingStatus};
use crate::time::{Epoch, Instant};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, BufReader};
use std::ops::ControlFlow;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant as Monotonic};
use tokio::sync::mpsc::{Receiver, Sender, channel};

/// Frames that are handed over at once at most.
const BATCH: usize = 1024;
/// Batches that may wait.
const BATCHES: usize = 4;
/// How long lines may stay away until time goes on without them: longer than a network usually
/// holds them up.
const INPUT_GRACE: Duration = Duration::from_secs(1);

/// How time passes while a log is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LogPace {
    /// From line to line, as fast as they can be read.
    AtOnce,
    /// As the lines were timed, so many times faster.
    Timed(f64),
    /// Lines are taken when they come; while none comes, time goes on from the last one.
    Live,
}

/// Why a recording woke.
#[derive(Debug)]
pub enum LogWake {
    /// A line, or something else, is due.
    Due,
    /// Lines were read.
    Read(Read),
    /// des.json was changed.
    File(DiskContent),
}

/// What was read of a log.
#[derive(Debug)]
pub enum Read {
    /// Frames, at least one.
    Frames {
        /// Which Unix time the log's start was.
        epoch: Epoch,
        /// The frames.
        frames: Vec<Frame>,
        /// The interfaces that were not named before.
        interfaces: Vec<String>,
    },
    /// All of it.
    End(LogSummary),
}

/// Part of a log that is read, in log time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LogRange {
    /// Start, from the log's first frame; earlier frames are skipped.
    pub from: Duration,
    /// Length, from the first frame read; `None` reads to the end of the log.
    pub time: Option<Duration>,
}

/// See the module's documentation.
pub struct LogSession {
    /// All state, from the first line on.
    app: Option<App>,
    options: AppOptions,
    config: Config,
    store: Store,
    watch: Option<FileWatcher>,
    log: Receiver<io::Result<Read>>,
    interfaces: Vec<String>,
    /// Frames that were read and are not due yet.
    waiting: VecDeque<Frame>,
    tally: Option<LogSummary>,
    recorder: Option<Recorder>,
    /// Frames that were taken and not recorded yet.
    unrecorded: Vec<Frame>,
    pace: LogPace,
    range: LogRange,
    /// Time of the first frame that is read.
    start: Instant,
    until: Option<Instant>,
    /// A moment of ours, and of the log: where its clock is reckoned from.
    anchor: Option<(Monotonic, Instant)>,
}

impl LogSession {
    /// Begins to read. `config` is that of every bus.
    pub fn new(
        log: File,
        pace: LogPace,
        range: LogRange,
        (options, config): (AppOptions, Config),
        file: &Path,
    ) -> io::Result<Self> {
        let (sender, receiver) = channel(BATCHES);
        // It may wait for a line for ever: nobody waits for it.
        thread::Builder::new().name("log".into()).spawn(move || {
            if let Err(error) = read(log, range.from, &sender) {
                let _ = sender.blocking_send(Err(error));
            }
        })?;
        Ok(Self {
            app: None,
            options: AppOptions { file_path: Some(file.to_owned()), ..options },
            config: Config { listen_only: true, ..config },
            store: Store::new(file),
            watch: None,
            log: receiver,
            interfaces: Vec::new(),
            waiting: VecDeque::new(),
            tally: None,
            recorder: None,
            unrecorded: Vec::new(),
            pace,
            range,
            start: Instant::ZERO,
            until: None,
            anchor: None,
        })
    }

    /// Records all frames from now on.
    pub fn record(&mut self, recorder: Recorder) {
        self.recorder = Some(recorder);
    }

    /// Ends the recording, where there is one; says what it came to.
    pub fn finish_recording(&mut self) -> Option<RecordingStatus> {
        self.recorder.take().map(Recorder::finish)
    }

    /// How the recording is, if that has changed since it was asked last.
    pub fn take_recording_status(&self) -> Option<RecordingStatus> {
        self.recorder.as_ref().and_then(Recorder::take_status)
    }

    /// Waits for the next reason to do something. May be dropped while waiting.
    pub async fn next(&mut self) -> io::Result<LogWake> {
        let due = sleep_for(self.due().map(|at| self.wait_until(at)));
        let file = file_changed(self.watch.as_ref());
        let may_read = self.waiting.is_empty() && self.tally.is_none();
        tokio::select! {
            biased;
            read = self.log.recv(), if may_read => {
                let broken = || io::Error::other("reader stopped: this is a bug in descan");
                read.unwrap_or_else(|| Err(broken())).map(LogWake::Read)
            }
            reading = file => Ok(LogWake::File(reading)),
            () = due => Ok(LogWake::Due),
        }
    }

    /// Takes in what a wake brought, frame by frame; `turn` is called after each, and when time
    /// passed. Breaks at the end.
    pub fn take<E>(
        &mut self,
        wake: LogWake,
        turn: &mut impl FnMut(&mut App) -> Result<(), E>,
    ) -> Result<ControlFlow<()>, E> {
        match wake {
            LogWake::Due => {}
            LogWake::Read(Read::Frames { epoch, frames, interfaces }) => {
                self.interfaces.extend(interfaces);
                self.begin(epoch, frames.first().map_or(Instant::ZERO, |frame| frame.time));
                let last = frames.last().map_or(Instant::ZERO, |frame| frame.time);
                match self.pace {
                    LogPace::AtOnce => {}
                    LogPace::Timed(_) => {
                        self.anchor.get_or_insert((Monotonic::now(), self.start));
                    }
                    LogPace::Live => self.anchor = Some((Monotonic::now(), last)),
                }
                self.waiting.extend(frames);
            }
            LogWake::Read(Read::End(tally)) => {
                self.begin(tally.epoch.unwrap_or_default(), tally.last);
                self.tally = Some(tally);
                let Some(app) = &mut self.app else { return Ok(ControlFlow::Break(())) };
                // What is there is judged at the last frame.
                let now = app.now();
                pass_time(app, now);
                for at in 0..app.buses().len() {
                    link(app, now, at, Link::Ended);
                }
                turn(app)?;
                return Ok(ControlFlow::Break(()));
            }
            LogWake::File(reading) => {
                let now = self.now();
                if let Some(app) = &mut self.app {
                    app.handle_file(now, reading.into());
                }
            }
        }
        let flow = self.advance(turn);
        self.record_taken();
        flow
    }

    /// All state, and what was read, where it was read to its end.
    pub fn finish(mut self) -> (App, Option<LogSummary>) {
        let app = self.app.take().unwrap_or_else(|| self.new_app(Epoch::default()));
        (app, self.tally)
    }

    fn record_taken(&mut self) {
        if let Some(recorder) = &self.recorder {
            for (at, name) in self.interfaces.iter().enumerate().take(256) {
                recorder.name_bus(BusIndex(at as u8), name);
            }
            // A file can wait until all is written; who sends lines now may not.
            match self.pace {
                LogPace::AtOnce => recorder.record_all(&self.unrecorded),
                LogPace::Timed(_) | LogPace::Live => recorder.record(&self.unrecorded),
            }
        }
        self.unrecorded.clear();
    }

    /// Creates the app at `start`, the time of the first frame: before it, the time is unknown.
    fn begin(&mut self, epoch: Epoch, start: Instant) {
        if self.app.is_none() {
            self.start = start;
            self.until = self.range.time.map(|time| start + time);
            self.app = Some(self.new_app(epoch));
        }
    }

    fn new_app(&mut self, epoch: Epoch) -> App {
        let options = AppOptions { epoch, ..std::mem::take(&mut self.options) };
        if let Some(recorder) = &self.recorder {
            recorder.set_epoch(epoch);
        }
        let mut app = App::new(self.start, options);
        let reading = self.store.read().map_err(|error| error.in_short());
        if self.pace == LogPace::Live {
            self.watch = Some(FileWatcher::spawn(self.store.clone(), reading.clone()));
        }
        app.handle_file(self.start, reading.into());
        app
    }

    /// When something is due: a frame, what the app waits for, the end.
    fn due(&self) -> Option<Instant> {
        let app = self.app.as_ref().filter(|_| self.pace != LogPace::AtOnce)?;
        let frame = self.waiting.front().map(|frame| frame.time);
        [frame, app.poll_timeout(), self.until].into_iter().flatten().min()
    }

    fn wait_until(&self, at: Instant) -> Duration {
        let Some((since, from)) = self.anchor else { return Duration::ZERO };
        let wait = at.since(from).div_f64(self.speed()) + self.patience();
        wait.saturating_sub(since.elapsed())
    }

    /// The log's time; without a clock all of it is over.
    fn now(&self) -> Instant {
        let Some((since, from)) = self.anchor else { return NEVER };
        from + since.elapsed().saturating_sub(self.patience()).mul_f64(self.speed())
    }

    fn speed(&self) -> f64 {
        if let LogPace::Timed(speed) = self.pace { speed } else { 1.0 }
    }

    /// While the next line is not known, its clock is held back: it may be on its way.
    fn patience(&self) -> Duration {
        if self.waiting.is_empty() { INPUT_GRACE } else { Duration::ZERO }
    }

    /// Takes the frames that are due, and lets time pass.
    fn advance<E>(
        &mut self,
        turn: &mut impl FnMut(&mut App) -> Result<(), E>,
    ) -> Result<ControlFlow<()>, E> {
        let until = self.until.unwrap_or(NEVER);
        loop {
            let now = self.now();
            let Some(app) = &mut self.app else { return Ok(ControlFlow::Continue(())) };
            match self.waiting.front().copied() {
                Some(frame) if frame.time <= now.min(until) => {
                    self.waiting.pop_front();
                    if self.recorder.is_some() {
                        self.unrecorded.push(frame);
                    }
                    take_frame(app, frame, &self.interfaces, &self.config);
                    turn(app)?;
                }
                waiting => {
                    let is_over = now >= until && (waiting.is_some() || self.anchor.is_some());
                    if is_over {
                        pass_time(app, until);
                    } else if self.anchor.is_some() {
                        pass_time(app, now);
                    }
                    turn(app)?;
                    return Ok(if is_over {
                        // Presence is judged at this moment, whatever follows in the log.
                        app.handle_timeout(until);
                        for at in 0..app.buses().len() {
                            link(app, until, at, Link::Ended);
                        }
                        ControlFlow::Break(())
                    } else {
                        ControlFlow::Continue(())
                    });
                }
            }
        }
    }
}

const NEVER: Instant = Instant::from_micros(u64::MAX);

fn take_frame(app: &mut App, frame: Frame, interfaces: &[String], config: &Config) {
    while let at @ 0..=255 = app.buses().len()
        && at <= usize::from(frame.bus.0)
        && let Some(name) = interfaces.get(at)
    {
        app.add_bus(frame.time, name.clone(), config.clone());
        link(app, frame.time, at, Link::Up);
    }
    pass_time(app, frame.time);
    // Who wrote the log is one of those who are watched.
    let mut heard = frame;
    heard.is_tx = false;
    app.handle_frames(frame.time, &[heard]);
}

fn link(app: &mut App, now: Instant, at: usize, link: Link) {
    let Some(bus) = app.buses().get(at) else { return };
    let status = BusStatus { link, ..bus.status.clone() };
    app.handle_bus(now, BusIndex(at as u8), status);
}

/// Lets everything happen that is due until `now`; without a screen nobody asks for anything.
fn pass_time(app: &mut App, now: Instant) {
    app.advance_to(now);
    while app.poll_effect().is_some() {}
}

/// Reads the log and hands over what is there from `from` on, before it waits for more.
fn read(log: File, from: Duration, to: &Sender<io::Result<Read>>) -> io::Result<()> {
    let mut reader = LogReader::new(BufReader::with_capacity(1 << 16, log));
    let mut named = 0;
    while let Some(frame) = reader.next_frame()? {
        let mut frames = vec![frame];
        while frames.len() < BATCH
            && let Some(frame) = reader.next_buffered()
        {
            frames.push(frame);
        }
        frames.retain(|frame| frame.time >= Instant::ZERO + from);
        if frames.is_empty() {
            continue;
        }
        let tally = reader.tally();
        let epoch = tally.epoch.unwrap_or_default();
        let interfaces = tally.interfaces[named..].to_vec();
        named = tally.interfaces.len();
        if to.blocking_send(Ok(Read::Frames { epoch, frames, interfaces })).is_err() {
            return Ok(());
        }
    }
    // Nobody may be left to learn of it.
    let _ = to.blocking_send(Ok(Read::End(reader.tally().clone())));
    Ok(())
}
