//! All state of the program: the engines, des.json, the capture, the timeline, and what the user
//! looks at. A state machine without I/O and without a clock, with four families of methods:
//!
//! * `handle_*`: frames, time, keys, file contents, the words of adapters: with the commands (that
//!   keys run) the only things that change it;
//! * commands: what the actions of [`crate::keymap`] do;
//! * `poll_transmit`, `poll_effect`: what is to be done outside;
//! * `poll_timeout`: when [`App::handle_timeout`] is to be called at the latest.
//!
//! Call one that changes it, drain the polls, draw if it is dirty. It does not know how it is
//! drawn, where frames come from, or how files are kept.
//!
//! ```text
//! buses     engine, adapter's words and meter of each bus
//! capture   the frames of the last while; statistics per identifier
//! timeline  what happened, in lines          events   from the engines' events to those lines
//! matching  which entry is which device
//! rows      what a row of Devices is         devices  how those rows are made
//! file      des.json, edits, undo            edits    the commands that edit it
//! problems  findings                         groups   from them to the rows of Problems
//! evidence  the frames of a problem          why      why a device is missing
//! traffic   frames in words                  filter   the filter line
//! page      which page, which part of it     cursor   what is selected
//! view      all that the user looks at       screen   where the regions are
//! prompt    lines being typed                navigate the commands that only look
//! ```

mod actions;
mod app_event;
mod bitrate;
mod buses;
mod capture;
mod cursor;
mod devices;
mod edits;
mod events;
mod evidence;
mod file;
mod filter;
mod matching;
mod missing_reason;
mod navigate;
mod page;
mod problem_groups;
mod problems;
mod prompt;
mod redundancy;
mod rows;
mod screen;
mod timeline;
mod traffic;
mod type_ahead;
mod view;

pub use app_event::{AppEvent, BusSnapshot, DeviceEvent, EventContext, EventLine, FileSnapshot};
pub use buses::{Bus, LoadMeter, LoadSecond, TxBlocked};
pub use capture::{Capture, IdentifierKey, IdentifierKind, IdentifierStats};
pub use cursor::Cursor;
pub use devices::concerns;
pub use evidence::EvidenceView;
pub use file::{Change, EditRefusal, FileProblem, FileReading, FileState, SaveOutcome, Saving};
pub use filter::{FILTER_FIELDS, FILTER_WORDS, Filter, FilterField};
pub use matching::Matching;
pub use missing_reason::spell;
pub use navigate::{Mouse, MouseKind};
pub use page::{Focus, Frozen, Page};
pub use problem_groups::{EvidenceItem, Problem, ProblemKey};
pub use problems::{Scope, same_services};
pub use prompt::{InputCheck, Prompt, PromptKind};
pub use redundancy::{Redundancy, RedundantDevice};
pub use rows::{Counts, FileStatus, Row, RowKey, RowState, SortBy};
pub use screen::{SPLIT_WIDTH, Screen, tabs};
pub use timeline::{Timeline, TimelineEntry, TimelineKind};
pub use traffic::{Decoded, clock, clock_millis, hex};
pub use view::View;

use crate::bitrate::{SearchOutcome, SearchProgress};
use crate::discovery::{Config, DeviceId, Finding, OwnAddress};
use crate::document::{Document, Entry};
use crate::frame::{BusIndex, Frame};
use crate::keymap::{Action, Key, KeyMode, Keymap};
use crate::status::{BusStatus, Playback, PlaybackCommand, RecordingStatus};
use crate::time::{Duration, Epoch, Instant};
use crate::wire::id::Address;
use std::collections::{BTreeSet, VecDeque};
use std::path::PathBuf;
use traffic::FilteredFrames;

/// What the program was started with.
#[derive(Clone, Debug, Default)]
pub struct AppOptions {
    /// Which Unix time [`Instant::ZERO`] was.
    pub epoch: Epoch,
    /// How far the wall clock is ahead of UTC.
    pub utc_offset_seconds: i32,
    /// The buses, with their names and the settings of their engines.
    pub buses: Vec<(String, Config)>,
    /// Where des.json is, or will be.
    pub file_path: Option<PathBuf>,
    /// Which key does what.
    pub keymap: Keymap,
    /// The theme's name.
    pub theme: String,
    /// The themes to choose from.
    pub themes: Vec<String>,
    /// What is wrong in the user's settings.
    pub warnings: Vec<String>,
    /// Keep happenings for [`App::poll_happening`].
    pub emit_events: bool,
    /// Of these only what fits, and what is about a whole bus or about us.
    pub event_filter: Filter,
}

/// What is to be done outside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Write des.json, if what is on disk is what is expected; then call [`App::handle_saved`].
    Save {
        /// What is to be on disk; `None`: no file.
        expected: Option<Document>,
        /// What is to be there afterwards.
        content: Document,
    },
    /// Write a new file; then call [`App::handle_written`].
    WriteFile {
        /// Where.
        path: PathBuf,
        /// What.
        bytes: Vec<u8>,
    },
    /// Put text into the user's clipboard.
    Copy(String),
    /// Draw with this theme from now on; then call [`App::handle_theme`].
    UseTheme(String),
    /// Look for the bit rate of this bus, listening only; meanwhile call
    /// [`App::handle_bitrate_search`], then [`App::handle_bitrate`].
    FindBitrate(BusIndex),
    /// Do this to the playing of logs; then call [`App::handle_playback`].
    Playback(PlaybackCommand),
    /// Ring.
    Bell,
    /// Draw everything anew.
    Redraw,
    /// Stop until the shell continues us.
    Suspend,
    /// End.
    Quit,
}

/// A word to the user, shown in the last line for a while.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StatusMessage {
    /// What.
    pub text: String,
    /// It says that something did not work.
    pub is_error: bool,
    /// It is about des.json: it may not hold any more when somebody else changes that.
    is_of_file: bool,
    until: Instant,
}

/// A question that waits for yes or no.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Question {
    /// Quit although edits are not saved?
    Quit,
    /// Delete this entry, while it is in these words?
    Delete(crate::document::EntryKey, String),
    /// Send the identify command to this device?
    Identify(DeviceId),
    /// Look for the bit rate of this bus?
    FindBitrate(BusIndex),
}

/// What is open over the page.
#[derive(Clone, Debug, Default)]
pub enum Overlay {
    /// Nothing.
    #[default]
    None,
    /// The help, scrolled by so many lines.
    Help(u16),
    /// A question.
    Question(Question),
    /// A line being typed.
    Prompt(Prompt),
    /// The two values of a conflict.
    Conflict,
}

/// All state of the program. See the module's documentation.
#[derive(Debug)]
pub struct App {
    /// The latest moment that was told.
    now: Instant,
    started: Instant,
    epoch: Epoch,
    utc_offset_seconds: i32,
    buses: Vec<Bus>,
    file: FileState,
    /// When a save that failed is tried again.
    save_again_at: Option<Instant>,
    /// It is being tried again, unasked.
    is_saving_again: bool,
    /// The copies of des.json with our edits: the one being written, and the last that is.
    copy_pending: Option<(PathBuf, Document)>,
    copy_saved: Option<(PathBuf, Document)>,
    /// The user quits although edits are not saved.
    edits_discarded: bool,
    capture: Capture,
    matches: FilteredFrames,
    timeline: Timeline,
    matching: Matching,
    file_findings: Vec<Finding>,
    /// Which entry such a finding is about.
    entries_of_findings: Vec<Option<usize>>,
    /// The problems that are not to count, for as long as the program runs.
    muted: BTreeSet<ProblemKey>,
    /// All problems in the order in which they were shown last.
    problem_order: Vec<ProblemKey>,
    rows: Vec<Row>,
    counts: Counts,
    view: View,
    overlay: Overlay,
    /// The line being typed when a conflict came up; it goes on afterwards.
    suspended_prompt: Option<Prompt>,
    message: Option<StatusMessage>,
    recording: Option<RecordingStatus>,
    playback: Option<Playback>,
    siblings: redundancy::RedundantDevices,
    /// The bus whose bit rate is being looked for.
    searched: Option<BusIndex>,
    type_ahead: Option<type_ahead::TypeAheadGuard>,
    keymap: Keymap,
    theme: String,
    themes: Vec<String>,
    outbox: VecDeque<Frame>,
    effects: VecDeque<Effect>,
    report: bool,
    interest: Filter,
    app_events: VecDeque<AppEvent>,
    /// A screen's size was told. Without one nothing waits until it is to be seen.
    has_screen: bool,
    /// Something happened since bus and file were compared.
    outdated: bool,
    /// Something on the screen changed.
    dirty: bool,
    /// Something changed that need not be seen at once; when it is to be seen.
    dirty_at: Option<Instant>,
    last_calm_draw: Instant,
    /// The next whole second, at which ages and rates change.
    next_second: Instant,
}

/// What the bus changes is drawn at most this often, however much the devices chatter.
const BUS_REDRAW_INTERVAL: Duration = Duration::from_millis(250);
/// How long a file that has become empty is held to be one that is being written.
const EMPTY_FOR: Duration = Duration::from_secs(1);
/// How long after a save failed it is tried again: there may be room on the disk by then.
const SAVE_AGAIN_AFTER: Duration = Duration::from_secs(10);
const MESSAGE_FOR: Duration = Duration::from_secs(6);
const SECOND: Duration = Duration::from_secs(1);
/// So long after the program was held up frames may still come that waited meanwhile.
const STALL_BACKLOG: Duration = Duration::from_millis(250);

impl App {
    /// The program at its start.
    pub fn new(now: Instant, options: AppOptions) -> Self {
        let buses = options.buses.into_iter().enumerate().map(|(index, (name, config))| {
            let bus = BusIndex(index as u8);
            Bus::new(now, name, Config { bus, ..config })
        });
        let mut app = Self {
            now,
            started: now,
            epoch: options.epoch,
            utc_offset_seconds: options.utc_offset_seconds,
            buses: buses.collect(),
            file: FileState::new(options.file_path),
            capture: Capture::new(),
            matches: FilteredFrames::default(),
            timeline: Timeline::default(),
            matching: Matching::default(),
            save_again_at: None,
            is_saving_again: false,
            copy_pending: None,
            copy_saved: None,
            edits_discarded: false,
            file_findings: Vec::new(),
            entries_of_findings: Vec::new(),
            muted: BTreeSet::new(),
            problem_order: Vec::new(),
            rows: Vec::new(),
            counts: Counts::default(),
            view: View { size: (80, 24), ..View::default() },
            overlay: Overlay::None,
            suspended_prompt: None,
            message: None,
            recording: None,
            playback: None,
            siblings: redundancy::RedundantDevices::default(),
            searched: None,
            type_ahead: None,
            keymap: options.keymap,
            theme: options.theme,
            themes: options.themes,
            outbox: VecDeque::new(),
            effects: VecDeque::new(),
            report: options.emit_events,
            interest: options.event_filter,
            app_events: VecDeque::new(),
            has_screen: false,
            outdated: false,
            dirty: true,
            dirty_at: None,
            last_calm_draw: now,
            next_second: whole_second_after(now),
        };
        for warning in options.warnings {
            let mut line = TimelineEntry::new(now, TimelineKind::Error, &warning);
            line.name = Some("settings".into());
            app.timeline.push(line);
            app.show_error(warning);
        }
        app
    }

    /// Gives a bus the name that is known now: a log says which interface it was taken from.
    pub fn name_bus(&mut self, index: BusIndex, name: String) {
        if let Some(bus) = self.buses.get_mut(usize::from(index.0)) {
            bus.name = name;
            self.refresh();
            self.dirty = true;
        }
    }

    /// One more bus, as when a log turns out to have several. At most 256.
    pub fn add_bus(&mut self, now: Instant, name: String, config: Config) {
        if let Ok(index) = u8::try_from(self.buses.len()) {
            let bus = BusIndex(index);
            self.buses.push(Bus::new(now, name, Config { bus, ..config }));
            self.refresh();
            self.dirty = true;
        }
    }

    // ---- handle_*: what comes from outside ------------------------------------------------

    /// Takes frames, each dated by its own time.
    pub fn handle_frames(&mut self, now: Instant, frames: &[Frame]) {
        self.now = self.now.max(now);
        for frame in frames {
            let Some(bus) = self.buses.get_mut(usize::from(frame.bus.0)) else { continue };
            if bus.in_quarantine(frame.time) {
                bus.engine.count_only(frame);
            } else {
                bus.engine.handle_frame(frame);
            }
            // The end may be told before the last frames come.
            bus.ended = bus.ended.map(|ended| ended.max(frame.time));
            let (bitrate, data_bitrate) = (bus.bits_per_second(), bus.status.data_bitrate);
            bus.meter.add(frame, bitrate, data_bitrate);
            self.capture.push(frame);
        }
        if !frames.is_empty() && self.view.page == Page::Traffic && self.view.frozen.is_none() {
            self.request_redraw();
        }
        self.take_events();
    }

    /// Does what is due at `now`.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.now = self.now.max(now);
        for bus in &mut self.buses {
            if bus.poll_timeout().is_some_and(|at| at <= now) && !bus.in_quarantine(now) {
                if bus.is_unreachable() {
                    bus.engine.wait_for_bus(now);
                }
                bus.engine.handle_timeout(now);
            }
        }
        self.take_events();
        if self.next_second <= now {
            self.next_second = whole_second_after(now);
            self.tick();
        }
        if self.message.as_ref().is_some_and(|message| message.until <= now) {
            self.message = None;
            self.dirty = true;
        }
        if self.save_again_at.is_some_and(|at| at <= now) {
            self.save_again_at = None;
            self.is_saving_again = true;
            self.save_pending();
        }
        if self.believes_empty_at().is_some_and(|at| at <= now) {
            let change = self.file.accept_empty();
            self.file_changed(change);
        }
        if self.dirty_at.is_some_and(|at| at <= now) {
            self.dirty = true;
            self.catch_up();
        }
    }

    /// Nothing could be done since `since`, as where the program was stopped: what came meanwhile
    /// is shown, but nobody is judged by it, and nobody by his silence.
    pub fn handle_stall(&mut self, since: Instant, now: Instant) {
        self.now = self.now.max(now);
        for bus in self.buses.iter_mut().filter(|bus| !bus.is_unreachable() && bus.ended.is_none())
        {
            bus.begin_quarantine(since, now + STALL_BACKLOG);
        }
        let seconds = now.since(since).as_secs_f64();
        let text = format!("stopped for {seconds:.1} s; not counted against devices");
        let mut line = TimelineEntry::new(now, TimelineKind::Error, text);
        line.name = Some("descan".into());
        self.report_line(line);
        self.dirty = true;
    }

    /// Lets everything happen on the buses that is due until `until`, each at its time, as where
    /// time leaps from one line of a log to the next.
    pub fn advance_to(&mut self, until: Instant) {
        // Not what only the screen waits for: there may be years of seconds where the clock was
        // set while the log was written.
        let next = |app: &App| app.buses.iter().filter_map(Bus::poll_timeout).min();
        while let Some(due) = next(self).filter(|due| *due <= until) {
            self.handle_timeout(due);
        }
        if self.poll_timeout().is_some_and(|due| due <= until) {
            self.handle_timeout(until);
        }
    }

    /// Takes a key: a prompt's, or an action's.
    pub fn handle_key(&mut self, now: Instant, key: Key) {
        self.now = self.now.max(now);
        if self.is_typed_ahead(key) {
            return;
        }
        self.dirty = true;
        self.message = None;
        self.catch_up();
        if matches!(self.overlay, Overlay::Prompt(_)) {
            self.type_key(key);
        } else if let Some(action) = self.keymap.lookup(self.mode(), key) {
            self.run(action);
            self.note_refused_line(action);
        }
    }

    /// Takes text that was pasted: into the line being typed, nowhere else.
    pub fn handle_paste(&mut self, now: Instant, text: &str) {
        self.now = self.now.max(now);
        self.paste(text);
    }

    /// Takes the size of the screen.
    pub fn handle_resize(&mut self, columns: u16, rows: u16) {
        self.view.size = (columns, rows);
        if !std::mem::replace(&mut self.has_screen, true) {
            self.settle_problems();
        }
        self.dirty = true;
        self.refresh_rows();
    }

    /// Takes what was found at des.json's path.
    pub fn handle_file(&mut self, now: Instant, reading: FileReading) {
        self.now = self.now.max(now);
        let was_emptied = self.file.emptied_since().is_some();
        let change = self.file.read(self.now, reading);
        self.file_changed(change);
        let is_emptied = self.file.emptied_since().is_some();
        self.dirty |= was_emptied || is_emptied;
        if was_emptied && !is_emptied && change == Change::None {
            // It is as it was: what waited is saved.
            self.save_pending();
        }
    }

    /// Takes that the folder does not exist in which des.json is to be begun; `folder` as it is to be
    /// shown.
    pub fn handle_missing_folder(&mut self, now: Instant, folder: &str) {
        self.now = self.now.max(now);
        let text = format!("no such folder yet: mkdir -p {folder}");
        self.timeline.push(TimelineEntry::new(self.now, TimelineKind::Error, &text));
        self.complain_of_file(format!("{}: {text}", self.file.name()));
    }

    /// Takes what became of an [`Effect::Save`].
    pub fn handle_saved(&mut self, now: Instant, outcome: SaveOutcome) {
        self.now = self.now.max(now);
        let before = self.file.problem().filter(|it| it.is_not_saved()).cloned();
        let is_retry = std::mem::take(&mut self.is_saving_again);
        let on_disk = self.file.on_disk().cloned();
        let parted = match &outcome {
            SaveOutcome::Parted(1) => {
                Some("; the other hard link keeps the old content".to_owned())
            }
            SaveOutcome::Parted(names) => {
                Some(format!("; {names} other hard links keep the old content"))
            }
            _ => None,
        };
        let change = self.file.handle_saved(self.now, outcome);
        // No edit is let through that pins a taken address, but the file may have been changed
        // while it waited to be saved.
        let clash = self.file.on_disk().zip(on_disk.as_ref()).filter(|_| change == Change::Saved);
        let clash = clash.and_then(|(now, before)| {
            let entries = now.entries();
            let clash = now.new_duplicate_address(before)?.entries.iter();
            let clash: Vec<&Entry> = clash.filter_map(|&at| entries.get(at)).collect();
            let address = clash.first()?.address?;
            let names: Vec<&str> = clash.iter().map(|entry| &*entry.name_text).collect();
            let (count, names) = (names.len(), names.join(", "));
            Some(format!("; warning: {count} entries share address {address}: {names}"))
        });
        let but: String = clash.into_iter().chain(parted).collect();
        let problem = self.file.problem().filter(|it| it.is_not_saved());
        self.save_again_at = problem.map(|_| self.now + SAVE_AGAIN_AFTER);
        let is_known = before.is_some() && before.as_ref() == problem;
        if is_retry && is_known {
            // It was told when it failed first.
            self.dirty = true;
            return;
        }
        if change == Change::Saved && (before.is_some() || !but.is_empty()) {
            let saved = if before.is_some() { "saved after retry" } else { "saved" };
            let text = format!("{saved}{but}");
            self.timeline.push(TimelineEntry::new(self.now, TimelineKind::File, &text));
            if but.is_empty() { self.say_of_file(text) } else { self.complain_of_file(text) }
        }
        // Why it is not saved is known where the edit before was not either; what was done is news.
        let done = self.message.take_if(|it| is_known && it.is_of_file && !it.is_error);
        self.file_changed(change);
        if done.is_some() {
            self.message = done;
        }
        if self.file.problem().is_none() {
            // What was read meanwhile may be why it was not saved.
            self.save_pending();
        }
        // What could not be saved may have been taken back: then that is no change of the file.
        self.quit_if_saved();
        self.dirty = true;
    }

    /// Takes what became of an [`Effect::WriteFile`].
    pub fn handle_written(
        &mut self,
        now: Instant,
        path: &std::path::Path,
        result: Result<(), String>,
    ) {
        self.now = self.now.max(now);
        let is_copy = |copying: &mut (PathBuf, Document)| copying.0 == path;
        let copy = self.copy_pending.take_if(is_copy);
        let path = crate::text::printable(path.as_os_str().as_encoded_bytes());
        match result {
            Ok(()) if copy.is_some() => {
                self.copy_saved = copy;
                let line = format!("a copy with all edits: {path}");
                self.show_info(&line);
                self.timeline.push(TimelineEntry::new(self.now, TimelineKind::File, line));
            }
            Ok(()) => self.show_info(format!("saved: {path}")),
            Err(why) => self.show_error(format!("not saved: {why}")),
        }
    }

    /// Takes what became of an [`Effect::UseTheme`].
    pub fn handle_theme(&mut self, now: Instant, result: Result<(), String>) {
        self.now = self.now.max(now);
        match result {
            Ok(()) => self.dirty = true,
            Err(why) => self.show_error(format!("theme {}: {why}", self.theme)),
        }
    }

    /// Takes what an adapter says of its bus.
    pub fn handle_bus(&mut self, now: Instant, index: BusIndex, status: BusStatus) {
        self.now = self.now.max(now);
        self.bus_changed(index, status);
    }

    /// Takes how the recording is.
    pub fn handle_recording(&mut self, now: Instant, status: RecordingStatus) {
        self.now = self.now.max(now);
        self.recording_changed(status);
    }

    /// Takes how far the search for a bus's bit rate has come.
    pub fn handle_bitrate_search(&mut self, now: Instant, bus: BusIndex, progress: SearchProgress) {
        self.now = self.now.max(now);
        self.report_bitrate_search(bus, progress);
    }

    /// Takes what the search for a bus's bit rate came to.
    pub fn handle_bitrate(
        &mut self,
        now: Instant,
        bus: BusIndex,
        result: Result<SearchOutcome, String>,
    ) {
        self.now = self.now.max(now);
        self.bitrate_found(bus, result);
    }

    /// Takes how logs are played, where there are nothing but logs.
    pub fn handle_playback(&mut self, now: Instant, playback: Playback) {
        self.now = self.now.max(now);
        if self.playback.replace(playback) != Some(playback) {
            // While time stands, nothing else becomes due.
            self.catch_up();
            self.dirty = true;
        }
    }

    // ---- poll_*: what is to be done outside, and when -------------------------------------

    /// The next frame to send; `frame.bus` says where.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        if let Some(frame) = self.outbox.pop_front() {
            return Some(frame);
        }
        self.buses.iter_mut().enumerate().find_map(|(index, bus)| {
            if bus.is_unreachable() {
                // It would be late when the bus is back, and that nobody takes it says nothing.
                bus.engine.wait_for_bus(now);
            }
            bus.engine.poll_transmit(now).map(|frame| frame.with_bus(BusIndex(index as u8)))
        })
    }

    /// The next thing to be done.
    pub fn poll_effect(&mut self) -> Option<Effect> {
        self.effects.pop_front()
    }

    /// The next thing that happened, where [`AppOptions::report`] is set.
    pub fn poll_app_event(&mut self) -> Option<AppEvent> {
        self.app_events.pop_front()
    }

    /// When [`App::handle_timeout`] is to be called at the latest.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let engines = self.buses.iter().filter_map(Bus::poll_timeout);
        let message = self.message.as_ref().map(|message| message.until);
        let calm = self.dirty_at.filter(|_| !self.dirty);
        let second = (!self.is_idle()).then_some(self.next_second);
        let file = self.save_again_at.into_iter().chain(self.believes_empty_at());
        engines.chain(message).chain(calm).chain(second).chain(file).min()
    }

    /// Whether the screen is not what it should be.
    pub fn is_dirty(&self) -> bool {
        self.dirty
    }

    /// The same; afterwards it is as if drawn.
    pub fn take_dirty(&mut self) -> bool {
        let dirty = std::mem::take(&mut self.dirty);
        if dirty {
            self.dirty_at = None;
            self.last_calm_draw = self.now;
        }
        dirty
    }

    // ---- what it is ------------------------------------------------------------------------

    /// The latest moment that was told.
    pub fn now(&self) -> Instant {
        self.now
    }

    /// The moment that ages are counted to: now, or, where nothing more will come, the end of
    /// the log.
    pub fn display_time(&self) -> Instant {
        let ended = self.buses.iter().map(|bus| bus.ended).collect::<Option<Vec<_>>>();
        ended.and_then(|ended| ended.into_iter().max()).unwrap_or(self.now)
    }

    /// Which Unix time the start was.
    pub fn epoch(&self) -> Epoch {
        self.epoch
    }

    /// Seconds since midnight 1970 on the wall clock.
    pub fn wall_seconds(&self, at: Instant) -> u64 {
        (self.epoch.unix_micros(at) / 1_000_000)
            .saturating_add_signed(i64::from(self.utc_offset_seconds))
    }

    /// The buses.
    pub fn buses(&self) -> &[Bus] {
        &self.buses
    }

    /// des.json.
    pub fn file(&self) -> &FileState {
        &self.file
    }

    /// The captured frames.
    pub fn capture(&self) -> &Capture {
        &self.capture
    }

    /// What happened.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    /// Which entry is which device.
    pub fn matching(&self) -> &Matching {
        &self.matching
    }

    /// What the user looks at.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// What is open over the page.
    pub fn overlay(&self) -> &Overlay {
        &self.overlay
    }

    /// The word to the user.
    pub fn message(&self) -> Option<&StatusMessage> {
        self.message.as_ref()
    }

    /// How logs are played, where there are nothing but logs.
    pub fn playback(&self) -> Option<Playback> {
        self.playback
    }

    /// How the recording is, where there is one.
    pub fn recording(&self) -> Option<&RecordingStatus> {
        self.recording.as_ref()
    }

    /// Which key does what.
    pub fn keymap(&self) -> &Keymap {
        &self.keymap
    }

    /// The key of an action, for a sentence; its name where it has none.
    pub fn key_of(&self, action: Action) -> String {
        self.keymap.key_text(action)
    }

    /// The theme's name.
    pub fn theme(&self) -> &str {
        &self.theme
    }

    /// Where the regions of the screen are.
    pub fn screen(&self) -> Screen {
        Screen::new(&self.view, self.buses.len())
    }

    /// What keys mean at the moment; lines being typed take them before.
    pub fn mode(&self) -> KeyMode {
        match self.overlay {
            Overlay::None | Overlay::Prompt(_) => KeyMode::Browse,
            Overlay::Help(_) => KeyMode::Help,
            Overlay::Question(_) => KeyMode::Confirm,
            Overlay::Conflict => KeyMode::Conflict,
        }
    }

    /// Whether an address on a bus is ours.
    pub fn is_own_address(&self, bus: BusIndex, address: Address) -> bool {
        let own = self.bus(bus).map(|bus| bus.engine.own_address());
        own == Some(OwnAddress::Held(address))
    }

    // ---- what all parts need ---------------------------------------------------------------

    fn show_info(&mut self, text: impl Into<String>) {
        let until = self.now + MESSAGE_FOR;
        self.message =
            Some(StatusMessage { text: text.into(), is_error: false, is_of_file: false, until });
        self.dirty = true;
    }

    fn show_error(&mut self, text: impl Into<String>) {
        self.show_info(text);
        if let Some(message) = &mut self.message {
            message.is_error = true;
        }
    }

    /// The same of what des.json says, or of what is wrong with it: for as long as that is so.
    fn say_of_file(&mut self, text: impl Into<String>) {
        self.show_info(text);
        if let Some(message) = &mut self.message {
            message.is_of_file = true;
        }
    }

    fn complain_of_file(&mut self, text: impl Into<String>) {
        self.show_error(text);
        if let Some(message) = &mut self.message {
            message.is_of_file = true;
        }
    }

    /// The file changed: what was said of it gives way, unless our edits, made again, keep it true.
    fn clear_file_message(&mut self, is_rebased: bool) {
        let gives_way = |it: &mut StatusMessage| it.is_of_file && (it.is_error || !is_rebased);
        self.message.take_if(gives_way);
    }

    /// The bus changed something: to be seen soon, but not at the bus's pace.
    fn request_redraw(&mut self) {
        let calm = self.scale_to_playback(BUS_REDRAW_INTERVAL);
        if self.dirty_at.is_none() {
            self.dirty_at = Some((self.last_calm_draw + calm).max(self.now));
        }
    }

    /// So much of a person's time, in that of a log, which may be faster or stand still.
    fn scale_to_playback(&self, time: Duration) -> Duration {
        match self.playback {
            Some(playback) if playback.is_standing() => Duration::ZERO,
            Some(playback) => time.mul_f64(playback.speed),
            None => time,
        }
    }

    /// When a file that has become empty is taken for an empty one.
    fn believes_empty_at(&self) -> Option<Instant> {
        Some(self.file.emptied_since()? + self.scale_to_playback(EMPTY_FOR))
    }

    /// Nothing on the screen counts seconds.
    fn is_idle(&self) -> bool {
        let quiet = |bus: &Bus| {
            bus.ended.is_some() || bus.meter.is_idle() && bus.engine.devices().is_empty()
        };
        // What costs most comes last: this is asked at every turn.
        let waits = || (0..self.buses.len()).any(|at| !self.is_search_complete(BusIndex(at as u8)));
        self.buses.iter().all(quiet) && !(self.file.is_there() && waits())
    }

    /// A second is over: rates and ages change.
    fn tick(&mut self) {
        let at_rest = self.is_idle();
        for bus in &mut self.buses {
            bus.meter.advance(self.now);
        }
        self.capture.tick();
        if !at_rest {
            self.refresh();
            self.filter_frames();
            self.dirty = true;
        }
    }

    /// Before there is something to draw: compares bus and file anew, if something happened since,
    /// and filters the frames that came.
    fn catch_up(&mut self) {
        if std::mem::take(&mut self.outdated) {
            self.refresh();
        }
        self.filter_frames();
    }

    fn refresh(&mut self) {
        self.outdated = false;
        self.refresh_siblings();
        self.refresh_problems(self.now);
        if self.has_screen {
            self.settle_problems();
            self.refresh_rows();
        }
    }
}

fn whole_second_after(now: Instant) -> Instant {
    Instant::from_micros(now.as_micros() / 1_000_000 * 1_000_000) + SECOND
}
