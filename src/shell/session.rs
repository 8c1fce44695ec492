//! A session: the app, its buses and its file, and everything that passes between them.
//!
//! The screen is not part of it: the terminal UI and the commands without a screen drive the
//! same session. Everything is bounded: a batch of frames a turn, the newest reading of the
//! file, one save at a time.

use super::bitrate_search::{RunningSearch, SearchNews};
use super::file_watcher::FileWatcher;
use super::recorder::Recorder;
use super::store::{SaveError, Saved, Store, write_new};
use super::waiting::{file_changed, sleep_for};
use crate::app::{App, Effect, FileReading, SaveOutcome};
use crate::bus::{Clock, Port};
use crate::document::Document;
use crate::frame::{BusIndex, Frame};
use crate::status::RecordingStatus;
use crate::time::Instant;
use futures_util::future::select_all;
use std::future::{Future, pending};
use std::path::PathBuf;
use std::pin::Pin;
use std::time::Duration;
use tokio::task::{JoinHandle, spawn_blocking};

/// Frames taken in one turn, so that keys and the screen get theirs.
const BATCH: usize = 1024;

/// So much later than is due is no busy machine any more: the program was stopped, or could not
/// write to its terminal.
const STALL_THRESHOLD: Duration = Duration::from_millis(1500);

/// Why a session woke.
#[derive(Debug)]
pub enum SessionWake {
    /// Something is due.
    Due,
    /// A bus has frames, or its status changed.
    Buses,
    /// des.json was changed by somebody else.
    File(FileReading),
    /// Work on files is done.
    Done(Finished),
    /// The recording is longer, or over.
    Recording,
    /// The search for a bit rate has come further.
    Search(SearchNews),
}

/// What work on files came to.
#[derive(Debug)]
pub enum Finished {
    /// des.json was saved, or not.
    Saved(SaveOutcome, Vec<u8>),
    /// Another file was written, or not.
    Written(PathBuf, Result<(), String>),
}

/// Work on files, on a thread of its own.
struct Work {
    handle: JoinHandle<Finished>,
    /// Of des.json, not of another file.
    is_save: bool,
}

/// See the module's documentation.
pub struct Session {
    /// All state.
    pub app: App,
    clock: Clock,
    ports: Vec<Port>,
    /// How many of its interfaces' names each port has told.
    named: Vec<usize>,
    store: Option<Store>,
    watch: Option<FileWatcher>,
    /// What was found is being parsed: not on the thread that draws.
    reading: Option<JoinHandle<FileReading>>,
    work: Vec<Work>,
    recorder: Option<Recorder>,
    searching: Option<RunningSearch>,
    batch: Vec<Frame>,
    /// When it began, or went on after it was held up.
    resumed: Instant,
}

impl Session {
    /// Joins app, buses and file. The port at place n carries the bus of index n.
    pub fn new(app: App, clock: Clock, ports: Vec<Port>, store: Option<Store>) -> Self {
        let mut session = Self {
            app,
            resumed: clock.now(),
            clock,
            named: vec![0; ports.len()],
            ports,
            store,
            watch: None,
            reading: None,
            work: Vec::new(),
            recorder: None,
            searching: None,
            batch: Vec::with_capacity(BATCH),
        };
        session.report_playback();
        session.open_file();
        session
    }

    /// Records all frames from now on.
    pub fn record(&mut self, recorder: Recorder) {
        recorder.set_epoch(self.clock.epoch());
        self.app.handle_recording(self.now(), recorder.status());
        self.recorder = Some(recorder);
    }

    /// Ends the recording, where there is one; says what it came to.
    pub fn finish_recording(&mut self) -> Option<RecordingStatus> {
        self.recorder.take().map(Recorder::finish)
    }

    fn open_file(&mut self) {
        let Some(store) = &self.store else { return };
        let reading = store.read().map_err(|error| error.in_short());
        self.watch = Some(FileWatcher::spawn(store.clone(), reading.clone()));
        let missing_folder = store.missing_folder();
        self.app.handle_file(self.now(), reading.into());
        if let Some(folder) = missing_folder {
            self.app.handle_missing_folder(self.now(), &folder);
        }
    }

    /// The moment it is. Where frames of a log wait to be taken, it is not later than they are.
    pub fn now(&self) -> Instant {
        // In this order: a frame may come in between.
        let now = self.clock.now();
        let waits = || self.ports.iter().any(|port| port.queue().has_frames());
        if self.clock.playback().is_some() && waits() { now.min(self.app.now()) } else { now }
    }

    /// Waits for the next reason to do something. May be dropped while waiting.
    pub async fn next(&mut self) -> SessionWake {
        let deadline = self.app.poll_timeout().map(|at| self.clock.until(at));
        let due = sleep_for(deadline);
        let (watch, reading) = (self.watch.as_ref(), &mut self.reading);
        let file = async {
            let parsing = if let Some(parsing) = reading {
                parsing
            } else {
                let found = FileReading::from(file_changed(watch).await);
                reading.insert(spawn_blocking(|| found.parsed()))
            };
            let parsed = parsing.await;
            *reading = None;
            parsed.unwrap_or_else(|broken| FileReading::Error(format!("reader stopped: {broken}")))
        };
        let recorder = self.recorder.as_ref();
        let recording = async {
            match recorder {
                Some(recorder) => recorder.changed().await,
                None => pending().await,
            }
        };
        let searching = &mut self.searching;
        let search = async {
            match searching {
                Some(searching) => searching.next().await,
                None => pending().await,
            }
        };
        let ports = &self.ports;
        let buses = async {
            let ready: Vec<Pin<Box<dyn Future<Output = ()> + '_>>> =
                ports.iter().map(|port| Box::pin(port.queue().ready()) as _).collect();
            if ready.is_empty() {
                pending::<()>().await;
            }
            select_all(ready).await;
        };
        let work = &mut self.work;
        let done = async {
            if work.is_empty() {
                return pending().await;
            }
            let (result, at, _) = select_all(work.iter_mut().map(|it| &mut it.handle)).await;
            (result, at)
        };
        tokio::select! {
            biased;
            () = due => SessionWake::Due,
            reading = file => SessionWake::File(reading),
            (result, at) = done => {
                drop(self.work.swap_remove(at));
                match result {
                    Ok(finished) => SessionWake::Done(finished),
                    Err(broken) => {
                        let why = format!("saving stopped: {broken}");
                        SessionWake::Done(Finished::Saved(SaveOutcome::Failed(why), Vec::new()))
                    }
                }
            }
            () = recording => SessionWake::Recording,
            news = search => SessionWake::Search(news),
            () = buses => SessionWake::Buses,
        }
    }

    /// The moment it is; notices that it was not asked for long.
    fn begin_turn(&mut self) -> Instant {
        let now = self.now();
        if self.clock.playback().is_some() {
            return now;
        }
        let due = self.app.poll_timeout();
        if let Some(due) =
            due.filter(|due| *due >= self.resumed && now.since(*due) >= STALL_THRESHOLD)
        {
            self.resumed = now;
            // Since it last did something, it may have been stopped.
            let since = due.min(self.app.now());
            self.app.handle_stall(since, now);
        }
        now
    }

    /// Takes in what a wake brought.
    pub fn take(&mut self, wake: SessionWake) {
        let now = self.begin_turn();
        match wake {
            SessionWake::Due => {}
            SessionWake::Buses => self.take_buses(now),
            SessionWake::Recording => {
                if let Some(status) = self.recorder.as_ref().and_then(Recorder::take_status) {
                    self.app.handle_recording(now, status);
                }
            }
            SessionWake::Search(news) => self.take_search(now, news),
            SessionWake::File(reading) => self.app.handle_file(now, reading),
            SessionWake::Done(Finished::Saved(outcome, content)) => {
                if let Some(watch) = &self.watch {
                    // What is being parsed was read before.
                    let is_old = outcome.is_on_disk() && self.reading.take().is_some();
                    if is_old || self.app.file().is_superseded() {
                        watch.look_again();
                    } else if outcome.is_on_disk() {
                        watch.saved(content);
                    }
                }
                self.app.handle_saved(now, outcome);
            }
            SessionWake::Done(Finished::Written(path, result)) => {
                self.app.handle_written(now, &path, result);
            }
        }
    }

    fn take_search(&mut self, now: Instant, news: SearchNews) {
        let Some(bus) = self.searching.as_ref().map(|searching| searching.bus) else { return };
        match news {
            SearchNews::Progress(progress) => self.app.handle_bitrate_search(now, bus, progress),
            SearchNews::Over(result) => {
                self.searching = None;
                self.app.handle_bitrate(now, bus, result);
            }
        }
    }

    fn report_playback(&mut self) {
        if let Some(playback) = self.clock.playback() {
            self.app.handle_playback(self.now(), playback);
        }
    }

    fn take_buses(&mut self, now: Instant) {
        for (port_at, port) in self.ports.iter().enumerate() {
            let index = BusIndex(port_at as u8);
            if let Some(status) = port.queue().take_status() {
                // The further interfaces of a log are as their log is.
                for further in 0..self.named[port_at].max(1) {
                    let Ok(further) = u8::try_from(further) else { break };
                    let bus = BusIndex(index.0.saturating_add(further));
                    self.app.handle_bus(now, bus, status.clone());
                }
            }
            self.batch.clear();
            port.queue().drain(&mut self.batch, BATCH);
            // A log tells its interfaces' names as they turn up; the first is the port's bus.
            for (at, name) in port.queue().names().into_iter().enumerate().skip(self.named[port_at])
            {
                let Ok(further) = u8::try_from(at) else { break };
                let bus = BusIndex(index.0.saturating_add(further));
                if at == 0 || self.app.bus(bus).is_some() {
                    self.app.name_bus(bus, name);
                } else if let Some(first) = self.app.bus(index) {
                    let config = first.engine.config().clone();
                    self.app.add_bus(now, name, config);
                    self.app.handle_bus(now, bus, port.queue().status());
                }
                self.named[port_at] = at + 1;
            }
            if let Some(recorder) = &self.recorder {
                for (at, bus) in self.app.buses().iter().enumerate() {
                    let Ok(at) = u8::try_from(at) else { break };
                    recorder.name_bus(BusIndex(at), &bus.name);
                    recorder.note_lost(BusIndex(at), bus.lost());
                }
                recorder.record(&self.batch);
            }
            if self.clock.playback().is_none() {
                self.app.handle_frames(now, &self.batch);
                continue;
            }
            // Time may have leapt: what was due between two frames happens between them.
            for frame in &self.batch {
                self.app.advance_to(frame.time);
                self.app.handle_frames(frame.time, std::slice::from_ref(frame));
            }
        }
        // At the end of all logs time stands.
        self.report_playback();
    }

    /// Does what is due, sends what is to be sent, starts what is to be saved. What concerns
    /// the screen or the program itself comes back.
    pub fn flush_effects(&mut self) -> Vec<Effect> {
        let now = self.begin_turn();
        if self.clock.playback().is_some() {
            self.app.advance_to(now);
        }
        // Bounded: what is due can make something else due, but not for ever at one moment.
        for _ in 0..8 {
            if self.app.poll_timeout().is_none_or(|at| at > now) {
                break;
            }
            self.app.handle_timeout(now);
        }
        while let Some(frame) = self.app.poll_transmit(now) {
            if let Some(port) = self.ports.get(usize::from(frame.bus.0)) {
                // A full outbox is in the port's status; the engine notices that no echo comes.
                let _ = port.transmit(&frame);
            }
        }
        let mut rest = Vec::new();
        while let Some(effect) = self.app.poll_effect() {
            match effect {
                Effect::Save { expected, content } => self.start_save(expected, content),
                Effect::WriteFile { path, bytes } => {
                    let handle = spawn_blocking(move || {
                        let home = std::env::var_os("HOME").map(PathBuf::from);
                        let result = write_new(&path, home.as_deref(), &bytes);
                        Finished::Written(path, result)
                    });
                    self.work.push(Work { handle, is_save: false });
                }
                Effect::FindBitrate(index) => {
                    let Some(bus) = self.app.bus(index) else { continue };
                    let period = bus.engine.config().profile.heartbeat.period();
                    self.searching = Some(RunningSearch::begin(index, &bus.name, period));
                }
                Effect::Playback(command) => {
                    self.clock.control(command);
                    self.ports.iter().for_each(Port::wake);
                    self.report_playback();
                }
                other => rest.push(other),
            }
        }
        rest
    }

    /// fsync may take long on a network file system: not on the thread that draws.
    fn start_save(&mut self, expected: Option<Document>, content: Document) {
        let Some(store) = self.store.clone() else { return };
        let handle = spawn_blocking(move || {
            let expected = expected.as_ref().map(Document::source);
            let outcome = match store.save(expected, content.source()) {
                Ok(Saved { broken_links: 0 }) => SaveOutcome::Saved,
                Ok(Saved { broken_links: parted_from }) => SaveOutcome::Parted(parted_from),
                Err(SaveError::Changed(there)) => {
                    SaveOutcome::Changed(FileReading::Content(there).parsed())
                }
                Err(error) => SaveOutcome::Failed(error.in_short()),
            };
            Finished::Saved(outcome, content.source().to_vec())
        });
        self.work.push(Work { handle, is_save: true });
    }

    /// Waits for work on files that has begun, unless it is ended by Ctrl-C: nothing half-written is
    /// left behind. For the save of des.json only where that is wanted: whenever it breaks off, the
    /// file is whole, and as it was or as it was to be.
    /// Where nobody may be there to end it, it waits no longer than `patience`.
    pub async fn finish_work(&mut self, waits_for_save: bool, patience: Option<Duration>) {
        let wanted = |work: &Work| waits_for_save || !work.is_save;
        let deadline = patience.map(|patience| tokio::time::Instant::now() + patience);
        for work in std::mem::take(&mut self.work).into_iter().filter(wanted) {
            let is_late = async {
                match deadline {
                    Some(deadline) => tokio::time::sleep_until(deadline).await,
                    None => pending().await,
                }
            };
            tokio::select! {
                _ = work.handle => {}
                _ = tokio::signal::ctrl_c() => return,
                () = is_late => return,
            }
        }
    }
}
