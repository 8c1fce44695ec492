//! A session: the app, its input, its file and its recording, and the event loop between them.
//!
//! The input is a set of buses, or one log that is read by its own clock: at once, as timed, or
//! live. The terminal UI and the commands without a screen drive the same session. Everything is
//! bounded: a batch of frames a turn, the newest content of the file, one save at a time. Does not
//! know the screen.

mod several_ports;

use super::bitrate_search::{RunningSearch, SearchNews};
use super::catalogue_folders::{CatalogueFolders, CatalogueWatcher};
use super::file_watcher::{DiskContent, FileWatcher};
use super::log_input::{LogBatch, LogInput, LogPace};
use super::plan_files::{PlanLock, latest_plan, write_plan};
use super::recorder::Recorder;
use super::store::{SaveError, Saved, Store, write_new};
use super::waiting::{catalogue_changed, file_changed, sleep_for};
use crate::address_plan::PlanRecord;
use crate::app::{
    App, Effect, FileIndex, FileReading, FrameSelector, InterleavedLogs, InterleavedOrder,
    SaveOutcome, WrittenFrames,
};
use crate::bus::{BusSpec, Clock, Port};
use crate::catalogue::CatalogueText;
use crate::diagnostic::Diagnostic;
use crate::discovery::Config;
use crate::document::Document;
use crate::frame::{BusIndex, Frame};
use crate::log::{LogDoubts, LogSummary};
use crate::project::Project;
use crate::regular_file::text_of;
use crate::status::{BusStatus, Link, RecordingStatus};
use crate::text::printable_path;
use crate::time::Instant;
use crate::wire::profile::Profile;
use futures_util::future::select_all;
use std::fs::File;
use std::future::{Future, pending};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant as Monotonic};
use tokio::task::{JoinHandle, spawn_blocking, yield_now};

/// Time after which a turn handles no further frames; keys and the screen are handled between turns.
const TURN: Duration = Duration::from_millis(5);

/// Part of the room for captured frames that the order of the frames of several logs may take.
const ORDER_PART: usize = 16;

/// How often it is checked whether frames of several logs still wait for an earlier one.
const RECHECK: Duration = Duration::from_millis(20);

/// Maximum number of frames handled before the time of the turn is checked.
const BATCH: usize = 64;

/// Delay of a wake-up above which the program counts as stalled: stopped, or blocked by its
/// terminal.
const STALL_THRESHOLD: Duration = Duration::from_millis(1500);

/// Why a session woke.
#[derive(Debug)]
pub enum SessionWake {
    /// Something is due.
    Due,
    /// A save is due again, or an empty file is accepted.
    FileDue,
    /// A bus has frames, or its status changed.
    Buses,
    /// Frames of the log were read, or its end; or it cannot be read.
    Log(io::Result<LogBatch>),
    /// Another program changed a des.json.
    File(FileIndex, FileReading),
    /// Another program changed the profile.
    Profile(DiskContent),
    /// Another program changed the project.
    Project(DiskContent),
    /// Another program changed a file of the catalogue.
    Catalogue(Vec<CatalogueText>),
    /// Work on files is done.
    FileJobDone(FileJobResult),
    /// The recording grew or stopped.
    Recording,
    /// The bit rate search progressed or ended.
    Search(SearchNews),
}

/// How the input of a session ended. Buses do not end.
#[derive(Debug)]
pub enum InputEnd {
    /// The end of the log, with what was read.
    Log(Box<LogSummary>),
    /// The end of the range of the log that is read.
    Range,
    /// The log cannot be read.
    Failed(io::Error),
}

/// Result of work on files.
#[derive(Debug)]
pub enum FileJobResult {
    /// Saving a des.json, with the content.
    Saved(FileIndex, SaveOutcome, Vec<u8>),
    /// Writing another file.
    Written(PathBuf, Result<(), Diagnostic>),
    /// Writing the captured frames.
    WrittenLog(PathBuf, Result<WrittenFrames, Diagnostic>),
    /// Writing the file of a plan.
    WrittenPlan(Result<(), String>),
    /// The last plan of a bus, with the name of its file.
    ReadLastPlan(String, Result<Option<Box<(String, PlanRecord)>>, String>),
}

/// Work on files, on a separate thread.
struct FileJob {
    handle: JoinHandle<FileJobResult>,
    /// The des.json that it saves; `None` for another file.
    saves: Option<FileIndex>,
}

/// A des.json on disk.
struct DesFile {
    store: Store,
    /// `None` for a log that is all there: it is compared with the file as it is at the start.
    watch: Option<FileWatcher>,
    /// Parses new content, off the thread that draws.
    reading: Option<JoinHandle<FileReading>>,
}

impl DesFile {
    /// Waits until another program changed the file. May be dropped while waiting.
    async fn next_reading(&mut self) -> FileReading {
        let parsing = if let Some(parsing) = &mut self.reading {
            parsing
        } else {
            let found = FileReading::from(file_changed(self.watch.as_ref()).await);
            self.reading.insert(spawn_blocking(|| found.parsed()))
        };
        let parsed = parsing.await;
        self.reading = None;
        parsed.unwrap_or_else(|broken| {
            FileReading::Error(Diagnostic::new(format!("reader stopped: {broken}")))
        })
    }
}

/// Where frames come from, and the clock that counts their time.
enum SessionInput {
    /// Buses, in real time; or logs among the buses' ports, at the pace of the clock.
    Ports {
        clock: Clock,
        ports: Vec<Port>,
        /// Buses of the interfaces of each port, once they are named.
        interfaces: Vec<Vec<BusIndex>>,
        /// The order of the frames of several logs, where all can be read again.
        order: Option<InterleavedOrder>,
    },
    /// One log, at its own pace. The settings are those of the engine of each interface.
    Log(Box<LogInput>, Box<Config>),
}

/// The text of a file that must be there, or why it cannot be read.
fn text_on_disk(content: DiskContent) -> Result<String, String> {
    let missing = || Diagnostic::new("file not found");
    let text = content.and_then(|content| text_of(content.ok_or_else(missing)?));
    text.map_err(|fault| fault.to_string())
}

/// See the module's documentation.
pub struct Session {
    /// All state.
    pub app: App,
    input: SessionInput,
    input_end: Option<InputEnd>,
    /// The des.json files, each at the place of its index.
    files: Vec<DesFile>,
    /// The profile's file, and what watches it.
    profile: Option<(PathBuf, FileWatcher)>,
    /// The project's file, and what watches it.
    project: Option<(PathBuf, FileWatcher)>,
    /// Watches the folders of the catalogue.
    catalogue: Option<CatalogueWatcher>,
    work: Vec<FileJob>,
    recorder: Option<Recorder>,
    /// Selects the recorded frames; `None` for all.
    selector: Option<FrameSelector>,
    searching: Option<RunningSearch>,
    batch: Vec<Frame>,
    /// Start of the session, or the end of the last stall.
    stall_checked_from: Instant,
    /// Start of the session, in real time.
    started: Monotonic,
    /// Held while a plan of addresses runs.
    plan_lock: Option<PlanLock>,
}

impl Session {
    /// A session on buses. The port at position n carries the bus of index n, and the store at position
    /// n is of the des.json of index n.
    pub fn new(
        mut app: App,
        clock: Clock,
        mut ports: Vec<Port>,
        stores: impl IntoIterator<Item = Store>,
    ) -> Self {
        // Frames can be read again by their numbers only if all are of logs.
        let logs: Option<Vec<_>> = ports.iter_mut().map(Port::take_frame_source).collect();
        let mut order = None;
        match logs {
            Some(mut logs) if logs.len() == 1 => {
                logs.drain(..).for_each(|it| app.set_frame_source(it));
            }
            Some(logs) if !logs.is_empty() => {
                let logs = InterleavedLogs::new(logs, app.capture().room() / ORDER_PART);
                order = Some(logs.order());
                app.set_frame_source(Box::new(logs));
            }
            _ => {}
        }
        let resumed = clock.now();
        ports.iter().for_each(Port::allow_collecting);
        let interfaces = vec![Vec::new(); ports.len()];
        Self::with_input(
            app,
            SessionInput::Ports { clock, ports, interfaces, order },
            resumed,
            stores,
        )
    }

    /// The number of the next bus; `None` if no bus can be added: beside a log, whose interfaces take
    /// the numbers after it, or with 256 buses.
    pub fn next_bus(&self) -> Option<BusIndex> {
        let SessionInput::Ports { clock, ports, .. } = &self.input else { return None };
        let is_one_each = ports.len() == self.app.buses().len();
        let next = u8::try_from(ports.len()).ok().map(BusIndex);
        next.filter(|_| is_one_each && clock.playback().is_none())
    }

    /// The buses with their names, without bit rates; none for a log that is read by its own clock.
    pub fn open_buses(&self) -> Vec<(BusSpec, String)> {
        let SessionInput::Ports { ports, .. } = &self.input else { return Vec::new() };
        let named = ports.iter().enumerate().filter_map(|(at, port)| {
            let bus = self.app.bus(own_bus(at)?)?;
            Some((port.name().parse().ok()?, bus.name_without_rates().to_owned()))
        });
        named.collect()
    }

    /// The clock of the buses; `None` for a log that is read by its own.
    pub fn clock(&self) -> Option<&Clock> {
        match &self.input {
            SessionInput::Ports { clock, .. } => Some(clock),
            SessionInput::Log(..) => None,
        }
    }

    /// Adds a bus, opened with the number of [`Self::next_bus`]; `file` is its own des.json, if it has
    /// not that of the session.
    pub fn add_bus(&mut self, port: Port, name: String, config: Config, file: Option<PathBuf>) {
        let (now, index) = (self.now(), self.next_bus());
        let SessionInput::Ports { ports, interfaces, .. } = &mut self.input else { return };
        self.app.add_bus(now, name, config);
        port.allow_collecting();
        ports.push(port);
        interfaces.push(Vec::new());
        let Some((index, path)) = index.zip(file) else { return };
        if self.app.set_file_of_bus(index, Some(path.clone())).is_some() {
            self.open_file(Store::new(&path));
        }
    }

    /// A session on one log. Its interfaces become buses with settings `config` as they are named.
    pub fn of_log(
        app: App,
        log: LogInput,
        config: Config,
        store: impl IntoIterator<Item = Store>,
    ) -> Self {
        let resumed = app.now();
        let config = Config { listen_only: true, ..config };
        Self::with_input(app, SessionInput::Log(Box::new(log), Box::new(config)), resumed, store)
    }

    fn with_input(
        app: App,
        input: SessionInput,
        resumed: Instant,
        stores: impl IntoIterator<Item = Store>,
    ) -> Self {
        let mut session = Self {
            app,
            input,
            input_end: None,
            started: Monotonic::now(),
            stall_checked_from: resumed,
            files: Vec::new(),
            profile: None,
            project: None,
            catalogue: None,
            work: Vec::new(),
            recorder: None,
            selector: None,
            searching: None,
            plan_lock: None,
            batch: Vec::with_capacity(BATCH),
        };
        session.app.set_real_time(Instant::ZERO);
        session.report_playback();
        stores.into_iter().for_each(|store| session.open_file(store));
        session
    }

    /// Watches the file of the profile: once another program saves it, frames are read by it.
    pub fn watch_profile(&mut self, path: &Path) {
        let store = Store::new(path);
        let known = store.read();
        self.profile = Some((path.to_owned(), FileWatcher::spawn(store, known)));
    }

    /// Watches the file of the project: once another program saves it, its facts are in force.
    pub fn watch_project(&mut self, path: &Path) {
        let store = Store::new(path);
        let known = store.read();
        self.project = Some((path.to_owned(), FileWatcher::spawn(store, known)));
    }

    /// Watches the folders of the catalogue; `known` is what was read.
    pub fn watch_catalogue(&mut self, folders: CatalogueFolders, known: Vec<CatalogueText>) {
        self.catalogue = Some(CatalogueWatcher::spawn(folders, known));
    }

    /// Records the selected frames from now on, all without a selector; of a log, without status in
    /// the app.
    pub fn record(&mut self, recorder: Recorder, selector: Option<FrameSelector>) {
        recorder.set_epoch(self.app.epoch());
        if let SessionInput::Ports { .. } = self.input {
            self.app.handle_recording(self.now(), recorder.status());
        }
        self.recorder = Some(recorder);
        self.selector = selector;
    }

    /// State of the recording; `None` without one.
    pub fn recording(&self) -> Option<RecordingStatus> {
        self.recorder.as_ref().map(Recorder::status)
    }

    /// Ends the recording and returns its final state; `None` without one.
    pub fn finish_recording(&mut self) -> Option<RecordingStatus> {
        self.recorder.take().map(Recorder::finish)
    }

    /// How the input ended, once.
    pub fn take_input_end(&mut self) -> Option<InputEnd> {
        self.input_end.take()
    }

    /// The log's summary; `None` for buses, and before the end of the log.
    pub fn log_summary(&self) -> Option<&LogSummary> {
        match &self.input {
            SessionInput::Log(log, _) => log.summary(),
            SessionInput::Ports { .. } => None,
        }
    }

    /// What is doubtful of the log, in the part read so far; `None` for buses.
    pub fn log_doubts(&self) -> Option<LogDoubts> {
        match &self.input {
            SessionInput::Log(log, _) => Some(log.doubts()),
            SessionInput::Ports { .. } => None,
        }
    }

    /// Opens the next des.json: reads it, and watches it.
    fn open_file(&mut self, store: Store) {
        let Ok(file) = u8::try_from(self.files.len()).map(FileIndex) else { return };
        let reading = store.read();
        let is_live = match &self.input {
            SessionInput::Ports { .. } => true,
            SessionInput::Log(log, _) => log.pace() == LogPace::Live,
        };
        let watch = is_live.then(|| FileWatcher::spawn(store.clone(), reading.clone()));
        let missing_folder = store.missing_folder();
        self.files.push(DesFile { store, watch, reading: None });
        self.app.handle_file(self.now(), file, reading.into());
        if let Some(fault) = missing_folder {
            self.app.handle_missing_folder(self.now(), file, &fault);
        }
    }

    /// Tells the app the real time: while a log is paused, nothing else does.
    pub fn update_real_time(&mut self) {
        self.app.set_real_time(self.real_time());
    }

    /// Real time since the start of the session.
    fn real_time(&self) -> Instant {
        Instant::ZERO + self.started.elapsed()
    }

    /// The session's time. While frames wait, not later than they are.
    pub fn now(&self) -> Instant {
        match &self.input {
            SessionInput::Ports { clock, ports, .. } => present(clock, ports, self.app.now()),
            SessionInput::Log(log, _) => {
                log.now().map_or(self.app.now(), |now| now.max(self.app.now()))
            }
        }
    }

    /// Returns true if time can advance in large steps, as in a log: deadlines between two frames
    /// are handled at their own times, and lateness is not a stall.
    fn is_replay(&self) -> bool {
        match &self.input {
            SessionInput::Ports { clock, .. } => clock.playback().is_some(),
            SessionInput::Log(..) => true,
        }
    }

    /// Waits for the next reason to do something. May be dropped while waiting.
    pub async fn next(&mut self) -> SessionWake {
        // The runtime delivers keys, signals and timers only to a task that waits; where frames
        // arrive faster than they are handled, nothing else here waits.
        yield_now().await;
        let awaited = self.awaited_ports();
        let awaits_all = match &self.input {
            SessionInput::Ports { ports, .. } => awaited.len() == ports.len(),
            SessionInput::Log(..) => true,
        };
        let timeout = self.app.poll_timeout();
        let real = self.app.poll_real_timeout().map(|at| at.since(self.real_time()));
        let file_due = sleep_for(real);
        let (is_replay, reached) = (self.is_replay(), self.app.now());
        let files = &mut self.files;
        let file = async {
            let indices = (0..=u8::MAX).map(FileIndex);
            let readings = indices.zip(files.iter_mut()).map(|(index, file)| {
                Box::pin(async move { SessionWake::File(index, file.next_reading().await) })
            });
            let readings: Vec<_> = readings.collect();
            if readings.is_empty() {
                return pending().await;
            }
            select_all(readings).await.0
        };
        let profile = file_changed(self.profile.as_ref().map(|(_, watcher)| watcher));
        let project = file_changed(self.project.as_ref().map(|(_, watcher)| watcher));
        let catalogue = catalogue_changed(self.catalogue.as_ref());
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
        // Deadlines before frames of a bus, whose time is their own; frames of a log before
        // deadlines, as their arrival is what moves its time.
        let (log, ports) = match &mut self.input {
            SessionInput::Ports { clock, ports, .. } => (None, Some((&*clock, &*ports))),
            SessionInput::Log(log, _) => (Some(log), None),
        };
        let batch_or_due = async {
            let Some(log) = log else { return pending().await };
            if let Some(batch) = log.next_or_due(timeout).await {
                SessionWake::Log(batch)
            } else {
                SessionWake::Due
            }
        };
        let due = async {
            let (Some((clock, ports)), Some(at)) = (ports, timeout) else { return pending().await };
            sleep_for(Some(clock.until(at))).await;
            // Frames of before may wait to be read: then those are what is waited for.
            if !is_replay && present(clock, ports, reached) < at {
                pending::<()>().await;
            }
        };
        let buses = async {
            let Some((_, ports)) = ports else { return pending().await };
            let awaited = awaited.into_iter().filter_map(|at| ports.get(at));
            let ready: Vec<Pin<Box<dyn Future<Output = ()> + '_>>> =
                awaited.map(|port| Box::pin(port.queue().ready()) as _).collect();
            if ready.is_empty() {
                pending::<()>().await;
            }
            // Where others wait for it, a log may also go on to a later frame that it does not deliver yet.
            let recheck = if awaits_all || !is_replay { None } else { Some(RECHECK) };
            tokio::select! {
                _ = select_all(ready) => {}
                () = sleep_for(recheck) => {}
            }
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
            wake = batch_or_due => wake,
            () = due => SessionWake::Due,
            () = file_due => SessionWake::FileDue,
            wake = file => wake,
            content = profile => SessionWake::Profile(content),
            content = project => SessionWake::Project(content),
            texts = catalogue => SessionWake::Catalogue(texts),
            (result, at) = done => {
                let saves = self.work.swap_remove(at).saves.unwrap_or_default();
                match result {
                    Ok(finished) => SessionWake::FileJobDone(finished),
                    Err(broken) => {
                        let why = Diagnostic::new(format!("saving stopped: {broken}"));
                        SessionWake::FileJobDone(FileJobResult::Saved(saves, SaveOutcome::Failed(why), Vec::new()))
                    }
                }
            }
            () = recording => SessionWake::Recording,
            news = search => SessionWake::Search(news),
            () = buses => SessionWake::Buses,
        }
    }

    /// Returns the time; handles a stall.
    fn begin_turn(&mut self) -> Instant {
        if let SessionInput::Ports { clock, .. } = &self.input
            && clock.playback().is_none()
            && let Some(due) = self.app.poll_timeout()
        {
            let now = clock.now();
            if due >= self.stall_checked_from && now.since(due) >= STALL_THRESHOLD {
                self.stall_checked_from = now;
                // It may have been stopped since its last turn.
                let since = due.min(self.app.now());
                self.app.handle_stall(since, now);
            }
        }
        self.now()
    }

    /// Handles what [`Session::next`] returned.
    pub fn handle_wake(&mut self, wake: SessionWake) {
        let now = self.begin_turn();
        let real = self.real_time();
        self.update_real_time();
        match wake {
            SessionWake::Due => {}
            SessionWake::FileDue => self.app.handle_real_timeout(real),
            SessionWake::Buses => self.receive_frames(now),
            SessionWake::Log(Ok(batch)) => {
                if let SessionInput::Log(log, _) = &mut self.input {
                    log.take(batch);
                }
            }
            SessionWake::Log(Err(error)) => self.input_end = Some(InputEnd::Failed(error)),
            SessionWake::Recording => {
                let status = self.recorder.as_ref().and_then(Recorder::take_status);
                if let (SessionInput::Ports { .. }, Some(status)) = (&self.input, status) {
                    self.app.handle_recording(now, status);
                }
            }
            SessionWake::Search(news) => self.take_search(now, news),
            SessionWake::File(file, reading) => self.app.handle_file(now, file, reading),
            SessionWake::Profile(content) => self.take_profile(now, content),
            SessionWake::Project(content) => self.take_project(now, content),
            SessionWake::Catalogue(texts) => {
                let catalogue = self.app.catalogue().read(texts);
                self.app.handle_catalogue(now, Arc::new(catalogue));
            }
            SessionWake::FileJobDone(FileJobResult::Saved(file, outcome, content)) => {
                self.update_watch(file, &outcome, content);
                self.app.handle_saved(now, file, outcome);
            }
            SessionWake::FileJobDone(FileJobResult::Written(path, result)) => {
                self.app.handle_written(now, &path, result);
            }
            SessionWake::FileJobDone(FileJobResult::WrittenLog(path, result)) => {
                self.app.handle_written_log(now, &path, result);
            }
            SessionWake::FileJobDone(FileJobResult::ReadLastPlan(bus, last)) => {
                self.app.handle_last_plan(now, &bus, last);
            }
            SessionWake::FileJobDone(FileJobResult::WrittenPlan(result)) => {
                self.app.handle_plan_written(now, result);
            }
        }
        self.advance_log();
    }

    fn take_profile(&mut self, now: Instant, content: DiskContent) {
        let Some((path, _)) = &self.profile else { return };
        let profile = text_on_disk(content)
            .and_then(|text| Profile::parse(&text).map_err(|error| error.with_line()));
        self.app.handle_profile(now, &printable_path(path), profile);
    }

    fn take_project(&mut self, now: Instant, content: DiskContent) {
        let Some((path, _)) = &self.project else { return };
        let folder = path.parent().unwrap_or(Path::new(""));
        let project = text_on_disk(content)
            .and_then(|text| Project::parse(&text, folder).map_err(|error| error.with_line()));
        let facts = project.map(|project| project.facts(&self.open_buses()));
        self.app.handle_project(now, &printable_path(path), facts);
    }

    /// Makes the file watch know the content of a save, or read the file again where that is not
    /// certain.
    fn update_watch(&mut self, file: FileIndex, outcome: &SaveOutcome, content: Vec<u8>) {
        let is_overtaken = self.app.file_at(file).is_base_changed();
        let Some(DesFile { watch: Some(watch), reading, .. }) =
            self.files.get_mut(usize::from(file.0))
        else {
            return;
        };
        if matches!(outcome, SaveOutcome::Failed(_)) && !is_overtaken {
            return;
        }
        // What is being parsed was read before, or while the content of a save that was put back
        // was there.
        let is_old = reading.take().is_some();
        if outcome.is_on_disk() && !is_old && !is_overtaken {
            watch.set_known(content);
        } else {
            watch.reread();
        }
    }

    /// Handles the frames of the log that are due, and advances the time.
    fn advance_log(&mut self) {
        let SessionInput::Log(log, config) = &mut self.input else { return };
        if self.input_end.is_some() {
            return;
        }
        self.batch.clear();
        let due = log.due();
        if self.recorder.is_some() {
            self.batch.extend_from_slice(due);
        }
        let mut rest = due;
        while let Some(first) = rest.first() {
            while let at @ 0..=255 = self.app.buses().len()
                && at <= usize::from(first.bus.0)
                && let Some(name) = log.interfaces().get(at)
            {
                self.app.add_bus(first.time, name.clone(), (**config).clone());
                set_link(&mut self.app, first.time, at, Link::Up);
            }
            // Up to the first frame of an interface that is no bus yet.
            let buses = self.app.buses().len();
            let is_known = |frame: &Frame| usize::from(frame.bus.0) < buses;
            let known = if buses >= log.interfaces().len() {
                rest.len()
            } else {
                rest.iter().position(|frame| !is_known(frame)).unwrap_or(rest.len()).max(1)
            };
            let (frames, after) = rest.split_at(known);
            let last = frames.last().map_or(first.time, |frame| frame.time);
            self.app.handle_frames(last, frames);
            rest = after;
        }
        let count = due.len();
        log.take_due(count);
        // Entries that cannot be read name no interface: they count on the first.
        let unreadable = log.doubts().entries.count;
        if let Some(status) = self.app.buses().first().map(|bus| bus.status.clone())
            && status.unreadable < unreadable
        {
            let now = self.app.now();
            self.app.handle_bus(now, BusIndex(0), BusStatus { unreadable, ..status });
        }
        if let Some(summary) = log.summary() {
            // Presence is evaluated at the last frame.
            let now = self.app.now();
            self.app.advance_to(now);
            self.input_end = Some(InputEnd::Log(Box::new(summary.clone())));
            self.end_buses(now);
            return;
        }
        if log.is_range_over() {
            self.app.advance_to(log.until().unwrap_or_default());
            self.input_end = Some(InputEnd::Range);
        } else if let Some(now) = log.now() {
            self.app.advance_to(now);
        }
        self.record_log_batch();
    }

    fn record_log_batch(&mut self) {
        self.select_recorded();
        let (SessionInput::Log(log, _), Some(recorder)) = (&self.input, &self.recorder) else {
            return;
        };
        for (at, name) in log.interfaces().iter().enumerate().take(256) {
            recorder.name_bus(BusIndex(at as u8), name);
        }
        // A file can wait until all is written; a program that sends lines may not.
        match log.pace() {
            LogPace::AtOnce => recorder.record_all(&self.batch),
            LogPace::Timed(_) | LogPace::Live => recorder.record(&self.batch),
        }
    }

    /// Ends the session at the end of the log's range: presence is evaluated at that moment,
    /// whatever follows in the log.
    pub fn end_range(&mut self) {
        let SessionInput::Log(log, _) = &self.input else { return };
        let Some(until) = log.until() else { return };
        self.app.handle_timeout(until);
        self.end_buses(until);
    }

    fn end_buses(&mut self, now: Instant) {
        for at in 0..self.app.buses().len() {
            set_link(&mut self.app, now, at, Link::Ended);
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
        if let SessionInput::Ports { clock, ports, .. } = &self.input
            && let Some(mut playback) = clock.playback()
        {
            // The end is reached when the last frame is handled.
            playback.is_ended &= !ports.iter().any(|port| port.queue().has_frames());
            self.app.handle_playback(self.now(), playback);
        }
    }

    /// Handles frames and statuses of the buses, for the time of a turn.
    fn receive_frames(&mut self, now: Instant) {
        let SessionInput::Ports { ports, .. } = &self.input else { return };
        let count = ports.len();
        let begun = Monotonic::now();
        if count == 1 {
            self.receive_status(now, 0);
            while self.receive_batch(now, 0) && begun.elapsed() < TURN {}
        } else {
            self.receive_statuses(now);
            while self.receive_merged(now) && begun.elapsed() < TURN {}
        }
        // Time stops at the end of all logs.
        self.report_playback();
    }

    fn receive_status(&mut self, now: Instant, port_at: usize) {
        let SessionInput::Ports { ports, .. } = &self.input else { return };
        if let Some(status) = ports[port_at].queue().take_status() {
            self.handle_status(now, port_at, &status);
        }
    }

    /// Handles the status of a port. That of a log applies to all its interfaces.
    fn handle_status(&mut self, now: Instant, port_at: usize, status: &BusStatus) {
        let SessionInput::Ports { interfaces, .. } = &self.input else { return };
        for bus in own_bus(port_at).into_iter().chain(interfaces[port_at].iter().copied().skip(1)) {
            self.app.handle_bus(now, bus, status.clone());
        }
    }

    /// Handles frames of a port; returns false if there are none.
    fn receive_batch(&mut self, now: Instant, port_at: usize) -> bool {
        self.batch.clear();
        self.take_frames(now, port_at, Instant::LATEST);
        self.handle_batch()
    }

    /// Appends frames of a port to the batch, not later than `until`.
    fn take_frames(&mut self, now: Instant, port_at: usize, until: Instant) {
        let SessionInput::Ports { ports, interfaces, order, .. } = &mut self.input else { return };
        let (port, named) = (&ports[port_at], &mut interfaces[port_at]);
        let Some(first) = own_bus(port_at) else { return };
        let before = self.batch.len();
        port.queue().drain_until(&mut self.batch, BATCH - before, until);
        // A log names its interfaces as they occur. The first is the port's bus; the others are buses of
        // their own, behind those of all ports.
        for (at, name) in (named.len()..).zip(port.queue().names_from(named.len())) {
            let bus = if at == 0 {
                self.app.name_bus(first, name);
                first
            } else {
                let Ok(next) = u8::try_from(self.app.buses().len()) else { break };
                let Some(config) = self.app.bus(first).map(|bus| bus.config().clone()) else {
                    break;
                };
                self.app.add_bus(now, name, config);
                self.app.handle_bus(now, BusIndex(next), port.queue().status());
                BusIndex(next)
            };
            named.push(bus);
            if let Some(order) = order {
                order.set_buses(port_at, named);
            }
        }
        let mut end = before;
        for at in before..self.batch.len() {
            let frame = self.batch[at];
            let interface = usize::from(frame.bus.0.wrapping_sub(first.0));
            // Of more interfaces than there are bus indices the frames are not taken.
            if interface < named.len().max(1) {
                self.batch[end] = frame.with_bus(named.get(interface).copied().unwrap_or(first));
                end += 1;
            }
        }
        self.batch.truncate(end);
        if let Some(order) = order {
            order.push(port_at, &self.batch[before..]);
        }
    }

    /// Records and handles the frames of the batch; returns false if there are none.
    fn handle_batch(&mut self) -> bool {
        if self.batch.is_empty() {
            return false;
        }
        if let Some(recorder) = &self.recorder {
            for (at, bus) in self.app.buses().iter().enumerate() {
                let Ok(at) = u8::try_from(at) else { break };
                recorder.name_bus(BusIndex(at), &bus.name);
                recorder.note_lost(BusIndex(at), bus.lost());
            }
            if self.selector.is_none() {
                recorder.record(&self.batch);
            }
        }
        // Frames that wait are later than these.
        self.app.handle_frames(self.now(), &self.batch);
        if self.selector.is_some() {
            self.select_recorded();
            self.recorder.as_ref().inspect(|recorder| recorder.record(&self.batch));
        }
        true
    }

    /// Removes the frames that are not to be recorded from the batch, once it is handled: names that
    /// it contains are known then.
    fn select_recorded(&mut self) {
        let (Some(selector), Some(recorder)) = (&mut self.selector, &self.recorder) else { return };
        selector.renew(&self.app);
        let all = self.batch.len();
        self.batch.retain(|frame| selector.is_match(frame));
        recorder.note_left_out((all - self.batch.len()) as u64);
    }

    /// Handles what is due, transmits frames, starts saving. Returns the effects for the screen or
    /// the program itself.
    pub fn flush_effects(&mut self) -> Vec<Effect> {
        let now = self.begin_turn();
        let is_log = matches!(self.input, SessionInput::Log(..));
        // The time of a log passes as its frames are handled.
        if self.is_replay() && !is_log {
            self.app.advance_to(now);
        }
        if !is_log && self.app.poll_timeout().is_some_and(|at| at <= now) {
            self.app.handle_timeout(now);
        }
        while let Some(frame) = self.app.poll_transmit(now) {
            if let SessionInput::Ports { ports, .. } = &self.input
                && let Some(port) = ports.get(usize::from(frame.bus.0))
            {
                // The port's status reports a full outbox; the engine detects the missing loopback.
                let _ = port.transmit(&frame);
                // Frames of all buses are handled in the order of their times: none holds up others.
                ports.iter().for_each(Port::expect_response);
            }
        }
        let mut rest = Vec::new();
        while let Some(effect) = self.app.poll_effect() {
            match effect {
                Effect::Save { file, expected, content } => {
                    self.start_save(file, expected, content);
                }
                Effect::WriteFile { path, bytes } => {
                    let write = move |file: &mut File| file.write_all(&bytes);
                    self.start_write(path, write, FileJobResult::Written);
                }
                Effect::WriteLog { path, log } => {
                    let write = move |file: &mut File| log.write_to(file);
                    self.start_write(path, write, FileJobResult::WrittenLog);
                }
                Effect::ReadLastPlan { bus } => {
                    let read = move || {
                        let last = latest_plan(&bus).map_err(|fault| fault.to_string());
                        let last = last.map(|last| last.map(Box::new));
                        FileJobResult::ReadLastPlan(bus, last)
                    };
                    self.work.push(FileJob { handle: spawn_blocking(read), saves: None });
                }
                Effect::WritePlan { name, bytes, is_new, runs_on } => {
                    let locked = self.lock_plan(runs_on);
                    let write = move || {
                        let written = locked.and_then(|()| write_plan(&name, &bytes, is_new));
                        FileJobResult::WrittenPlan(written)
                    };
                    self.work.push(FileJob { handle: spawn_blocking(write), saves: None });
                }
                Effect::ReadFile(file) => {
                    let Some(file) = self.files.get_mut(usize::from(file.0)) else { continue };
                    // What is being parsed was read before.
                    file.reading = None;
                    file.watch.as_ref().inspect(|watch| watch.reread());
                }
                Effect::FindBitrate(index) => {
                    let Some(bus) = self.app.bus(index) else { continue };
                    let period = bus.config().profile.heartbeat.period();
                    self.searching = Some(RunningSearch::begin(index, &bus.name, period));
                }
                Effect::Playback(command) => {
                    if let SessionInput::Ports { clock, ports, .. } = &self.input {
                        clock.control(command);
                        ports.iter().for_each(Port::wake);
                    }
                    self.report_playback();
                }
                other => rest.push(other),
            }
        }
        rest
    }

    /// Sees to it that no other program runs a plan on the bus on which one runs here.
    fn lock_plan(&mut self, runs_on: Option<String>) -> Result<(), String> {
        match runs_on {
            None => self.plan_lock = None,
            Some(bus) if self.plan_lock.is_none() => self.plan_lock = Some(PlanLock::take(&bus)?),
            Some(_) => {}
        }
        Ok(())
    }

    /// Writes a new file on a separate thread.
    fn start_write<T: Send + 'static>(
        &mut self,
        path: PathBuf,
        write: impl FnOnce(&mut File) -> io::Result<T> + Send + 'static,
        done: fn(PathBuf, Result<T, Diagnostic>) -> FileJobResult,
    ) {
        let handle = spawn_blocking(move || {
            let home = std::env::var_os("HOME").map(PathBuf::from);
            let result = write_new(&path, home.as_deref(), write);
            done(path, result)
        });
        self.work.push(FileJob { handle, saves: None });
    }

    /// Saves on a separate thread: fsync may take long on a network file system.
    fn start_save(&mut self, file: FileIndex, expected: Option<Document>, content: Document) {
        let Some(open) = self.files.get(usize::from(file.0)) else { return };
        let store = open.store.clone();
        let handle = spawn_blocking(move || {
            let expected = expected.as_ref().map(Document::source);
            let outcome = match store.save(expected, content.source()) {
                Ok(Saved { broken_links: 0 }) => SaveOutcome::Saved,
                Ok(Saved { broken_links: parted_from }) => SaveOutcome::LinksBroken(parted_from),
                Err(SaveError::Changed(there)) => {
                    SaveOutcome::Changed(FileReading::Content(there).parsed())
                }
                Err(SaveError::Unconfirmed(fault)) => SaveOutcome::Unconfirmed(fault),
                Err(SaveError::Failed(fault)) => SaveOutcome::Failed(fault),
            };
            FileJobResult::Saved(file, outcome, content.source().to_vec())
        });
        self.work.push(FileJob { handle, saves: Some(file) });
    }

    /// Waits for work on files that has started, until Ctrl-C or for `timeout`, so that no file is
    /// left half-written, and takes its results. Waits for a save of des.json only if `waits_for_save`: an interrupted
    /// save leaves either the old or the new content.
    pub async fn finish_work(&mut self, waits_for_save: bool, timeout: Option<Duration>) {
        let wanted = |work: &FileJob| waits_for_save || work.saves.is_none();
        let deadline = timeout.map(|timeout| tokio::time::Instant::now() + timeout);
        for work in std::mem::take(&mut self.work).into_iter().filter(wanted) {
            let is_late = async {
                match deadline {
                    Some(deadline) => tokio::time::sleep_until(deadline).await,
                    None => pending().await,
                }
            };
            tokio::select! {
                result = work.handle => {
                    if let Ok(result) = result {
                        self.handle_wake(SessionWake::FileJobDone(result));
                    }
                }
                _ = tokio::signal::ctrl_c() => return,
                () = is_late => return,
            }
        }
    }
}

/// The time of a session of buses that has handled what was until `reached`: not later than the frames
/// that wait.
fn present(clock: &Clock, ports: &[Port], reached: Instant) -> Instant {
    // In this order: a frame may arrive in between.
    let now = clock.now();
    if clock.playback().is_some() {
        let waits = ports.iter().any(|port| port.queue().has_frames());
        return if waits { now.min(reached) } else { now };
    }
    let complete = ports.iter().filter_map(|port| port.queue().complete_until());
    complete.fold(now, Instant::min).max(reached)
}

/// Index of the bus of a port, or of its first interface; `None` where there are more than bus indices.
fn own_bus(port: usize) -> Option<BusIndex> {
    u8::try_from(port).ok().map(BusIndex)
}

/// Sets the state of a log's bus.
fn set_link(app: &mut App, now: Instant, at: usize, link: Link) {
    let Some(bus) = app.buses().get(at) else { return };
    let status = BusStatus { link, ..bus.status.clone() };
    app.handle_bus(now, BusIndex(at as u8), status);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::AppOptions;
    use crate::discovery::Presence;
    use crate::wire::id::{Address, Header, Service};
    use crate::wire::node::{Heartbeat, Mode, Uid};
    use crate::wire::profile::Profile;
    use std::task::{Context, Poll, Waker};

    fn at(millis: u64) -> Instant {
        Instant::ZERO + Duration::from_millis(millis)
    }

    fn session(names: &[&str]) -> Session {
        let config = Config { listen_only: true, ..Config::default() };
        let buses = names.iter().map(|name| ((*name).to_owned(), config.clone())).collect();
        let app = App::new(Instant::ZERO, AppOptions { buses, ..AppOptions::default() });
        let ports = names.iter().map(|name| Port::for_test(name)).collect();
        Session::new(app, Clock::start(), ports, None)
    }

    fn port(session: &Session, port_at: usize) -> &Port {
        let SessionInput::Ports { ports, .. } = &session.input else { panic!("no buses") };
        &ports[port_at]
    }

    fn heartbeat(time: Instant) -> Frame {
        let profile = Profile::default();
        let (from, service) =
            (Address::from_bits(14), Service::from_bits(profile.services.heartbeat));
        let header = Header::unsolicited(from, 7, false, service);
        let beat =
            Heartbeat { uid: Some(Uid([1; 6])), mode: Some(Mode::Work), ..Heartbeat::default() };
        let data = beat.encode(&profile.heartbeat, &profile.modes.codes()).0;
        Frame::classic(header.encode(), &data).with_time(time)
    }

    /// Handles all that can be handled without waiting; returns false if there was nothing.
    fn run(session: &mut Session) -> bool {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        let _time = runtime.enter();
        let mut has_run = false;
        session.flush_effects();
        loop {
            // A session yields once before it waits.
            let wake = {
                let mut next = Box::pin(session.next());
                let mut context = Context::from_waker(Waker::noop());
                let first = next.as_mut().poll(&mut context);
                if first.is_pending() { next.as_mut().poll(&mut context) } else { first }
            };
            let Poll::Ready(wake) = wake else { return has_run };
            has_run = true;
            session.handle_wake(wake);
            session.flush_effects();
        }
    }

    #[test]
    fn device_is_not_lost_while_its_frames_are_collected() {
        let mut session = session(&["can0"]);
        // The clock jumps, and the program is not stopped meanwhile.
        session.stall_checked_from = Instant::LATEST;
        let beats: Vec<Frame> = (1..=5).map(|second| heartbeat(at(1000 * second))).collect();
        session.clock().unwrap().elapse(Duration::from_secs(5));
        port(&session, 0).queue().push_until(&beats, Some(at(5000)));
        assert!(run(&mut session));
        session.clock().unwrap().elapse(Duration::from_secs(1));
        let presence = |session: &Session| session.app.buses()[0].devices()[0].presence;
        assert!(!run(&mut session), "frames later than the last one may wait");
        assert_eq!(session.now(), at(5000));
        // The others were in time.
        let beats: Vec<Frame> = (6..=60).map(|second| heartbeat(at(1000 * second))).collect();
        port(&session, 0).queue().push_until(&beats, Some(at(60_000)));
        session.clock().unwrap().elapse(Duration::from_mins(1));
        assert!(run(&mut session));
        assert_eq!((session.now(), presence(&session)), (at(60_000), Presence::Online));
        port(&session, 0).queue().set_complete();
        assert!(run(&mut session));
        assert!(session.now() > at(65_000));
        assert_eq!(presence(&session), Presence::Lost);
    }

    #[test]
    fn frames_of_two_buses_are_handled_in_the_order_of_their_times() {
        let mut session = session(&["can0", "can1"]);
        let frame = |bus, millis| {
            Frame::classic(millis as u32, &[]).with_time(at(millis)).with_bus(BusIndex(bus))
        };
        session.clock().unwrap().elapse(Duration::from_millis(20));
        let times = |session: &Session| -> Vec<u64> {
            let frames = session.app.capture().frames_from(0);
            frames.map(|(_, frame)| frame.time.as_micros() / 1000).collect()
        };
        port(&session, 1).queue().push_until(&[frame(1, 3)], Some(at(3)));
        port(&session, 0).queue().push(&[frame(0, 2), frame(0, 5), frame(0, 9)]);
        run(&mut session);
        assert_eq!(times(&session), [2, 3], "can1 may have a frame before 5 ms");
        port(&session, 1).queue().push_until(&[frame(1, 7)], Some(at(7)));
        assert!(run(&mut session));
        assert_eq!(times(&session), [2, 3, 5, 7]);
        port(&session, 1).queue().set_complete();
        assert!(run(&mut session));
        assert_eq!(times(&session), [2, 3, 5, 7, 9]);
        assert!(session.now() >= at(20));
    }
}
