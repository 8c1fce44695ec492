//! State of the program: buses, des.json, capture, problems, timeline, input and view.
//!
//! A state machine without I/O and without a clock:
//!
//! * `handle_*` takes frames, time, keys, file contents and bus statuses; together with the
//!   actions of [`crate::keymap`] these are the only methods that change it;
//! * `poll_transmit`, `poll_effect` and `poll_app_event` return work for the shell;
//! * `poll_timeout` returns when [`App::handle_timeout`] is due.
//!
//! Call a method that changes it, drain the polls, draw if it is dirty. Does not know how it is
//! drawn, where frames come from, or how files are stored.
//!
//! [`App`] owns parts that do not know it, and wires them:
//!
//! ```text
//! clock     time, wall clock, playback       buses     engines, bus statuses, load
//! traffic   frame ring, filter, decoding     file      des.json, edits, undo, saving
//! problems  findings, grouped and muted      devices   rows of the Devices page
//! view      page, selections, regions        input     keymap, overlays, prompts
//! notices   message, timeline, events        listing   devices as entries of des.json
//! filter    the filter language          page_filters  the filter of each page
//! ```
//!
//! The wiring stands in `mod` (handlers, polls, accessors), `shown_state` and `traffic_page` (what is
//! shown of the present or of a past moment), `actions`, `events` (from parts to the timeline), `edits`
//! (commands that change the file or the bus) and `navigate` (commands that change the view).

mod actions;
mod address_plans;
mod alarm;
mod answer_text;
mod app_event;
mod beat_strip;
mod bitrate;
mod boards;
mod bus_choice;
mod buses;
mod call_list;
mod candidate_counts;
mod capture;
mod capture_saving;
mod clock;
mod compared_moments;
mod composer_dialog;
mod conflict_panel;
mod des_files;
mod des_search;
mod device_command;
mod device_page;
mod device_proof;
mod devices;
mod edits;
mod events;
mod file;
mod file_comparison;
mod file_inputs;
mod filter;
mod filter_commands;
mod fleet_screen;
mod followed_frames;
mod frame_selector;
mod frame_sides;
mod frames;
mod help_view;
mod history;
mod input;
mod inventory;
mod journal;
mod lanes;
mod listing;
mod load_bars;
mod marks;
mod navigate;
mod notices;
mod open_buses;
mod page_filters;
mod past;
mod pinned_moments;
mod places;
mod play;
mod problem_page;
mod problems;
mod profile_learning;
mod project_facts;
pub(crate) mod proof;
mod saved_filters;
mod sent_commands;
mod sent_frames;
mod shared_address;
mod shown_state;
mod signs;
mod stories;
mod story_lines;
mod theme_picker;
mod time_axis;
mod time_bar;
mod timeline_kind;
mod traffic_page;
mod typed_time;
mod varint;
mod versions;
mod view;
mod wall_clock;

pub use crate::document::same_services;
pub use address_plans::{PlanSession, PlanStart, PlanTask};
pub use alarm::Alarm;
pub use answer_text::format_millis;
pub use app_event::{AppEvent, BusSnapshot, DeviceEvent, EventContext, EventLine, FileSnapshot};
pub use beat_strip::{Beat, BeatKind, BeatStats};
pub use bus_choice::{
    BIT_RATES, BusChoice, BusOffer, BusSelection, ChoiceOutcome, OfferKind, OpenBuses,
};
pub use buses::{
    AddressHolder, AddressNames, Bus, Buses, ControllerStatus, ErrorKinds, LoadHistory, LoadMeter,
    LoadSample, LoadSecond, LoadShares, Redundancy, RedundantDevice, ShareCounts, TxBlocked,
};
pub use capture::decoded::summary_of;
pub use capture::{
    Call, CallCounts, CallKey, CallPart, CallResult, CallStats, Calls, CapturedHeartbeat,
    CapturedHeartbeats, CapturedLog, Decoded, FrameMeaning, FramePeriod, FrameRole,
    FrameStatistics, FrameStore, IdentifierKey, IdentifierKind, IdentifierRows, IdentifierStats,
    Identifiers, InterleavedLogs, InterleavedOrder, Latency, NOTED_BYTES, StatisticsCount,
    StoredFrames, Transfer, WrittenFrames, add_identifier,
};
pub use compared_moments::{ComparedMoment, ComparisonNote, ComparisonRow, MomentComparison};
pub use composer_dialog::{ComposerDialog, DialogField, MAX_TEMPLATES};
pub use conflict_panel::{BeatCell, BeatsOnAxis, ConflictPanel, MAX_COLUMNS, ordinal, side_letter};
use des_search::BusSearch;
pub use device_command::{COMMAND_FORMS, DeviceCommand};
pub use device_page::BEATS_PER_LINE;
use device_proof::BusProver;
pub use devices::concerns;
pub use file::{
    EditRefusal, EntryPlace, FileChange, FileError, FileIndex, FileReading, FileState, SaveOutcome,
    Saving,
};
pub use filter::{
    Completion, CompletionSource, FILTER_FIELDS, FILTER_WORDS, Filter, FilterError, FilterField,
    FrameMatcher, RowKind,
};
pub use fleet_screen::{
    BrokerLink, FLEET_KEYS, FleetDevice, FleetEffect, FleetEvent, FleetEventKind, FleetEventLog,
    FleetFilter, FleetPage, FleetProblem, FleetPrompt, FleetRegions, FleetRow, FleetRowKey,
    FleetScreen, FleetScreenOptions, FleetSort, FleetSums, GatewayFacts, GatewayRow, MAX_EVENTS,
    MAX_FLEET_PROBLEMS, MAX_GATEWAY_VERSIONS, VersionRow,
};
pub use frame_selector::FrameSelector;
pub use frame_sides::FrameSides;
pub use help_view::HelpView;
pub use history::{BusesReplay, Moment, RecordedBuses};
pub use input::parse_address;
pub use input::{FilterPrompt, InputCheck, Overlay, Prompt, PromptKind, Question};
pub use lanes::{Lane, LaneBoard, LaneCell, Lanes, format_step};
pub use listing::addition_refusal;
pub use load_bars::{LoadBar, bar_lines};
pub use marks::{MAX_MARKS, Mark, Marks};
pub use navigate::{Mouse, MouseKind};
pub use notices::{
    StatusMessage, Timeline, TimelineEntry, event_word, whose_other_services, whose_services,
};
pub use page_filters::PageFilter;
use page_filters::PageFilters;
pub use play::PlayPace;
use play::ReadingGoal;
pub use problems::{
    ConflictSide, ConflictSides, EvidenceItem, Matching, Problem, ProblemHeadline, ProblemKey,
    ProblemList, Scope, SideBasis, format_duration, growing_length_text, is_about, length_text,
};
use profile_learning::ProfileLearners;
pub use profile_learning::{ProfileReview, ProfileRow};
pub use project_facts::{ProjectFacts, RedundantTask, TaskDevice, TaskEnd, TaskState};
pub use saved_filters::{MAX_SAVED_FILTERS, SavedFilter, SavedFilterChange};
pub use sent_commands::EndedCommand;
use sent_commands::SentCommands;
pub(crate) use sent_commands::key_needed;
use sent_frames::Sendings;
pub use sent_frames::{SendingResult, SentAnswer, SentFrames};
pub use signs::Signs;
pub use stories::{
    HiddenKinds, Stories, Story, StoryChange, StoryKind, StoryLine, StorySign, StoryStep,
};
pub use story_lines::LineKey;
pub use theme_picker::COLOURLESS_THEME;
use theme_picker::Themes;
pub use time_axis::TimeAxis;
pub use time_bar::{BAR_LEFT, BAR_RIGHT, BarSign, TimeBar};
pub use timeline_kind::TimelineKind;
pub use versions::{
    ServiceInFile, ServiceTable, VersionCell, VersionNote, matrix_start, missing_services,
    printable, removed_services, twin_differences, version_before,
};
pub use view::{
    BarKey, Board, BusPageLayout, BusRegions, CallList, ChartSpan, ConflictAxis, Counts,
    DeviceView, DevicesPage, EvidenceView, FileStatus, Focus, Frozen, Page, ProblemsView, Row,
    RowKey, RowState, SPLIT_WIDTH, Screen, Selection, SortBy, TimeFormat, TimelineView,
    TrafficView, View,
};

use crate::bitrate::{SearchOutcome, SearchProgress};
use crate::catalogue::{Catalogue, CatalogueFile};
use crate::dbc::MessageDatabase;
use crate::diagnostic::Diagnostic;
use crate::discovery::{Config, Device, DeviceId};
use crate::document::{Document, Entry, NewEntry};
use crate::finding::Finding;
use crate::frame::{BusIndex, Frame};
use crate::keymap::{Action, Key, KeyMode, Keymap};
use crate::log::FrameSource;
use crate::status::{BusStatus, Playback, PlaybackCommand, RecordingStatus};
use crate::time::{Duration, Epoch, Instant, debug_assert_later};
use crate::wire::profile::Profile;
use alarm::Alarms;
use candidate_counts::CandidateCounts;
use capture::Traffic;
use clock::AppClock;
use devices::DeviceRows;
use file::{FileContent, FileEditors};
use file_comparison::FileComparison;
pub(crate) use file_inputs::Inputs;
use input::{Input, PromptContext, PromptOutcome, PromptResult};
use jiff::tz::TimeZone;
use lanes::LaneRecords;
use notices::Notices;
use past::Past;
use places::Place;
use play::Play;
use problems::Problems;
use std::collections::VecDeque;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use wall_clock::WallClock;

/// Contents of des.json that are kept for past moments. Chosen: edits of a long day; each is shared with
/// the undo steps.
const MAX_CONTENTS: usize = 256;
/// Time between two parts of the frames that are tested by the filter: keys are handled in it.
const FILTER_PAUSE: Duration = Duration::from_millis(1);
/// Time before and after a piece of evidence whose frames outlive the others.
const AROUND_EVIDENCE: Duration = Duration::from_secs(1);

/// Default of [`AppOptions::capture_room`].
pub const DEFAULT_CAPTURE: usize = 64_000_000;
/// Part of the room for the past that statistics of frames take.
const STATISTICS_PART: usize = 4;

/// Start parameters.
#[derive(Clone, Debug, Default)]
pub struct AppOptions {
    /// Unix time of [`Instant::ZERO`].
    pub epoch: Epoch,
    /// Time zone of the wall clock; `None`: UTC.
    pub time_zone: Option<TimeZone>,
    /// Names of the buses, and settings of their engines.
    pub buses: Vec<(String, Config)>,
    /// Paths of the logs that are read, whole.
    pub logs: Vec<PathBuf>,
    /// Path of des.json, which need not exist; `None` without a file.
    pub file_path: Option<PathBuf>,
    /// Paths of the des.json files that buses have in its place, in the order of the buses; `None`, and
    /// a bus behind the last one, has that of `file_path`.
    pub own_file_paths: Vec<Option<PathBuf>>,
    /// Keymap.
    pub keymap: Keymap,
    /// Name of the theme.
    pub theme: String,
    /// Names of all themes.
    pub themes: Vec<String>,
    /// Signs that the terminal can show.
    pub signs: Signs,
    /// Mistakes in themes of the user: name, and what is wrong.
    pub theme_faults: Vec<(String, String)>,
    /// Errors in the settings, for the user.
    pub warnings: Vec<String>,
    /// Queue events for [`App::poll_app_event`].
    pub emit_events: bool,
    /// Queue only events that match, and those about a whole bus or the program.
    pub event_filter: Filter,
    /// Filters that the user saved.
    pub saved_filters: Vec<SavedFilter>,
    /// Compositions sent in earlier runs, in words, the latest first.
    pub recent_frames: Vec<String>,
    /// Templates of compositions, in words.
    pub templates: Vec<String>,
    /// Bytes of memory for the captured frames and the past of the buses; `None`:
    /// [`DEFAULT_CAPTURE`]; 0: few frames, and no past.
    pub capture_room: Option<usize>,
    /// What is known of types of devices.
    pub catalogue: Arc<Catalogue>,
    /// Messages of DBC files.
    pub messages: Arc<MessageDatabase>,
    /// What the project says about the buses.
    pub project: Arc<ProjectFacts>,
    /// Learn the profile of each bus from its frames.
    pub learns_profile: bool,
    /// Capture no frames, and count neither their identifiers nor calls: nothing reads them.
    pub without_capture: bool,
}

/// Side effect that the app requests: file access, a bit rate search, quitting. The shell executes
/// it and reports the result with the method named at each variant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Write a des.json if the content on disk is `expected`; then call [`App::handle_saved`].
    Save {
        /// The file.
        file: FileIndex,
        /// Content on disk before; `None`: no file.
        expected: Option<Document>,
        /// Content to write.
        content: Document,
    },
    /// Read a des.json again, even if it seems unchanged; then call [`App::handle_file`].
    ReadFile(FileIndex),
    /// Write a new file; then call [`App::handle_written`].
    WriteFile {
        /// Path.
        path: PathBuf,
        /// Content.
        bytes: Vec<u8>,
    },
    /// Write the captured frames to a new file; then call [`App::handle_written_log`].
    WriteLog {
        /// Path.
        path: PathBuf,
        /// The frames.
        log: CapturedLog,
    },
    /// Read the last plan of a bus; then call [`App::handle_last_plan`].
    ReadLastPlan {
        /// Name of the bus.
        bus: String,
    },
    /// Write the file of a plan with this name, in place of its content before; then call
    /// [`App::handle_plan_written`].
    WritePlan {
        /// Name of the file.
        name: String,
        /// Content.
        bytes: Vec<u8>,
        /// The file must not exist.
        is_new: bool,
        /// Name of the bus, of which no other program may run a plan meanwhile; `None` once it ended.
        runs_on: Option<String>,
    },
    /// Copy text to the clipboard.
    Copy(String),
    /// Change the filters that are stored; then call [`App::handle_saved_filters`].
    ChangeFilters(SavedFilterChange),
    /// Use this theme; then call [`App::handle_theme`].
    UseTheme(String),
    /// Keep this theme in the settings; then call [`App::handle_kept_theme`].
    KeepTheme(String),
    /// Search the bit rate of this bus, listen-only; call [`App::handle_bitrate_search`] with the
    /// progress, [`App::handle_bitrate`] with the result.
    FindBitrate(BusIndex),
    /// Remember a composition that is sent, in words, for later runs.
    RememberFrame(String),
    /// Store a template of a composition, in words; call [`App::handle_lost_template`] if it fails.
    KeepTemplate(String),
    /// Control the playback of logs; then call [`App::handle_playback`].
    Playback(PlaybackCommand),
    /// Call [`App::handle_offers`] with the buses that can be opened, as long as
    /// [`App::bus_choice`] is shown.
    ListBuses,
    /// Open these buses: in place of all, or beside them; then call [`App::handle_opened`].
    OpenBuses(BusSelection),
    /// Ring the terminal bell.
    Bell,
    /// Redraw the whole screen.
    Redraw,
    /// Suspend the process.
    Suspend,
    /// Quit.
    Quit,
}

/// Borrows [`Inputs`] from the fields of an [`App`], so that its other fields can be changed.
macro_rules! inputs {
    ($app:expr) => {
        $crate::app::Inputs {
            now: $app.clock.now(),
            buses: &$app.buses,
            documents: $app.files.documents(),
            matching: $app.problems.matching(),
        }
    };
}
use inputs;

/// Borrows [`Inputs`] for the moment that is shown.
macro_rules! shown_inputs {
    ($app:expr) => {
        match &$app.past {
            Some(past) => $crate::app::Inputs {
                now: past.moment.time,
                buses: &past.buses,
                documents: $app.files.documents_of(&past.contents),
                matching: past.problems.matching(),
            },
            None => $crate::app::inputs!($app),
        }
    };
}
use shown_inputs;

/// Returns the times around the evidence of findings in which frames of an old block are kept.
fn pinned_times(buses: &Buses, block: Range<Instant>) -> Vec<Range<Instant>> {
    let evidence = buses.findings().flat_map(|finding| &finding.evidence);
    let times = evidence.map(|piece| piece.time - AROUND_EVIDENCE..piece.time + AROUND_EVIDENCE);
    times.filter(|times| times.start <= block.end && block.start < times.end).collect()
}

/// State of the program; see the documentation of the module.
#[derive(Debug)]
pub struct App {
    clock: AppClock,
    logs: Vec<PathBuf>,
    buses: RecordedBuses,
    traffic: Traffic,
    files: FileEditors,
    problems: Problems,
    devices: DeviceRows,
    view: View,
    input: Input,
    notices: Notices,
    themes: Themes,
    effects: VecDeque<Effect>,
    /// Nothing on the screen changed with time at the last full second.
    was_idle: bool,
    file_comparison: FileComparison,
    filters: PageFilters,
    /// When the next part of the frames is tested by the filter.
    filter_due: Option<Instant>,
    /// Numbers of rows by the candidates of the filter that is typed.
    candidate_counts: Option<Box<CandidateCounts>>,
    /// The moment that is shown in place of the present one.
    past: Option<Box<Past>>,
    /// The replay on the way to a moment, and when its next part is due.
    replay: Option<BusesReplay>,
    replay_due: Option<Instant>,
    /// The shown moment moves.
    play: Option<Play>,
    /// The moment to which a log is read, to be shown then.
    reading_ahead: Option<Instant>,
    /// What the log is read up to, and from which moment on.
    reading_goal: Option<(Instant, ReadingGoal)>,
    /// A log was paused because another moment is shown.
    is_log_held: bool,
    marks: Marks,
    /// Places that were left, oldest first.
    places: Vec<Place>,
    /// Templates of compositions, in words.
    templates: Vec<String>,
    saved_filters: Vec<SavedFilter>,
    time_bar: TimeBar,
    signs: Signs,
    alarms: Alarms,
    lane_records: LaneRecords,
    help: HelpView,
    /// The list of buses that is shown over the page.
    bus_choice: Option<Box<BusChoice>>,
    learners: ProfileLearners,
    commands: SentCommands,
    sendings: Sendings,
    /// The content of the composer.
    composer: Option<Box<ComposerDialog>>,
    search: Option<Box<BusSearch>>,
    /// The tests of a device.
    prover: Option<Box<BusProver>>,
    /// The plan of addresses.
    plan: Option<Box<PlanSession>>,
    /// Devices that are not heard keep no address in the next plan.
    forgets_absent_devices: bool,
    /// The comparison of two moments that is open.
    comparison: Option<Box<MomentComparison>>,
    /// The proof that is being written.
    proof: Option<proof::PendingProof>,
    /// Contents of the des.json files now, and before: with the time until which they were so, oldest
    /// first.
    contents: Vec<FileContent>,
    contents_before: VecDeque<(Instant, Vec<FileContent>)>,
}

impl App {
    /// Returns the program at its start.
    pub fn new(now: Instant, options: AppOptions) -> Self {
        let room = options.capture_room.unwrap_or(DEFAULT_CAPTURE);
        let past_room = history::past_room(room);
        let buses_room = past_room - past_room / STATISTICS_PART;
        let files = FileEditors::new(options.file_path, options.own_file_paths);
        let contents = files.contents();
        let zone = options.time_zone.unwrap_or(TimeZone::UTC);
        let clock = AppClock::new(now, WallClock::new(options.epoch, zone));
        let mut event_filter = options.event_filter;
        // Events of a log may be of any time.
        event_filter.resolve(clock.wall(), None);
        let mut buses = Buses::new(now, options.buses);
        buses.set_project(options.project);
        let mut app = Self {
            clock,
            logs: options.logs,
            buses: RecordedBuses::new(now, buses, buses_room),
            traffic: if options.without_capture {
                Traffic::off()
            } else {
                Traffic::new(room - past_room, past_room / STATISTICS_PART)
            },
            files,
            problems: Problems::default(),
            devices: DeviceRows::default(),
            view: View { size: (80, 24), ..View::default() },
            input: Input::new(options.keymap),
            notices: Notices::new(now, options.emit_events, event_filter),
            themes: Themes::new(options.theme, options.themes, options.theme_faults),
            effects: VecDeque::new(),
            was_idle: false,
            file_comparison: FileComparison::default(),
            filters: PageFilters::default(),
            filter_due: None,
            candidate_counts: None,
            past: None,
            replay: None,
            replay_due: None,
            play: None,
            reading_ahead: None,
            reading_goal: None,
            is_log_held: false,
            marks: Marks::default(),
            places: Vec::new(),
            templates: options.templates,
            saved_filters: options.saved_filters,
            time_bar: TimeBar::default(),
            signs: options.signs,
            alarms: Alarms::default(),
            lane_records: LaneRecords::default(),
            help: HelpView::default(),
            bus_choice: None,
            learners: ProfileLearners::new(options.learns_profile),
            commands: SentCommands::default(),
            sendings: Sendings::new(options.recent_frames),
            composer: None,
            search: None,
            prover: None,
            plan: None,
            forgets_absent_devices: false,
            comparison: None,
            proof: None,
            contents,
            contents_before: VecDeque::new(),
        };
        for warning in options.warnings {
            let mut line = TimelineEntry::new(now, TimelineKind::Error, &warning);
            line.name = Some("settings".into());
            app.notices.push_line(line);
            app.show_error(warning);
        }
        app.buses.set_catalogue(options.catalogue);
        app.buses.set_messages(options.messages);
        app
    }

    /// Renames a bus: the name of its interface is found in the log.
    pub fn name_bus(&mut self, index: BusIndex, name: String) {
        if self.buses.rename(self.clock.now(), index, name) {
            self.refresh_before_draw();
            self.notices.redraw.set_dirty();
        }
    }

    /// Adds a bus that starts at `now`, as for a log with several; at most 256 buses.
    pub fn add_bus(&mut self, now: Instant, name: String, config: Config) {
        self.learners.set_profile(config.profile.clone());
        if self.buses.add(now, name, config) {
            self.refresh_before_draw();
            self.notices.redraw.set_dirty();
        }
    }

    /// Sets the log that all frames come from: those that leave memory are read again from it when they
    /// are shown.
    pub fn set_frame_source(&mut self, source: Box<dyn FrameSource>) {
        let spare = self.traffic.capture.set_source(source);
        self.buses.add_room(spare / 3);
        self.traffic.add_history_room(spare / 8);
    }

    // ---- handle_*: input -------------------------------------------------------------------

    fn capture_frame(&mut self, frame: &Frame) {
        while let Some((numbers, times)) = self.traffic.capture.about_to_drop(frame.time) {
            self.buses.pin(&self.traffic.capture, numbers, pinned_times);
            self.traffic.capture.drop_oldest(&pinned_times(&self.buses, times));
        }
        self.traffic.push(frame, &self.buses);
    }

    /// Does what is due at `now`.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.compare_file_until(now);
        self.clock.set(now);
        self.step_des_search(now);
        self.step_prover(now);
        self.buses.handle_timeout(now);
        self.take_events();
        self.step_plan(now);
        self.step_sending(now);
        self.compare_file_after_timers();
        self.compare_file_until(now);
        if self.clock.take_second(now) {
            self.tick();
        }
        self.notices.expire(now);
        self.check_reading();
        if !self.clock.has_real() {
            self.run_screen_timers();
        }
        self.run_file_timers();
        self.notices.redraw.check_due(now);
        self.buses.keep_history(now, &self.traffic.capture);
        debug_assert_later(self.poll_timeout(), now);
    }

    /// Takes that the program was stopped from `since` to `now`: frames of that time are shown and
    /// do not count as evidence, and silence does not count against devices.
    pub fn handle_stall(&mut self, since: Instant, now: Instant) {
        self.clock.set(now);
        self.buses.handle_stall(since, now);
        self.note_gap_for_prover(now);
        let seconds = now.since(since).as_secs_f64();
        let text = format!("stopped for {seconds:.1} s; not counted against devices");
        let mut line = TimelineEntry::new(now, TimelineKind::Error, text);
        line.name = Some("descan".into());
        self.report_line(line);
        self.notices.redraw.set_dirty();
    }

    /// Runs all timers up to `until`, each at its time: time advances from one frame of a log to
    /// the next.
    pub fn advance_to(&mut self, until: Instant) {
        // Only the timers of the buses: the clock of the recording computer may have advanced by
        // years, and each of their seconds would be one timeout of the screen.
        while let Some(due) = self.buses.poll_timeout().filter(|due| *due <= until) {
            self.handle_timeout(due);
        }
        if self.poll_timeout().is_some_and(|due| due <= until) {
            self.handle_timeout(until);
        }
    }

    /// Handles a key: it goes to the open prompt, or executes its action.
    pub fn handle_key(&mut self, now: Instant, key: Key) {
        let now = self.clock.set(now);
        if self.input.is_typed_ahead(now, key) {
            return;
        }
        self.notices.redraw.set_dirty();
        self.notices.clear_message();
        self.renew_rows();
        if self.input.prompt().is_some() {
            self.handle_prompt_key(key);
        } else if self.type_in_help(key) || self.select_mark_of(key) || self.use_filter_of(key) {
        } else if let Some(action) = self.input.lookup_global(key) {
            self.run(action);
        } else if self.type_in_bus_choice(key) || self.type_in_composer(key) {
        } else if let Some(action) = self.input.lookup(key) {
            self.run(action);
            self.input.note_executed(now, action);
        } else if self.input.shows_conflict() {
            self.effects.push_back(Effect::Bell);
        } else if !self.input.has_overlay() {
            let help = self.key_of(Action::Help);
            self.show_error(format!("{key} has no use here; {help} lists the keys"));
        }
    }

    /// Takes pasted text: it goes to the open prompt, else nowhere.
    pub fn handle_paste(&mut self, now: Instant, text: &str) {
        self.clock.set(now);
        if let Some(prompt) = self.input.prompt_mut() {
            prompt.paste(text);
            self.prompt_changed();
        } else {
            self.paste_in_composer(text);
        }
    }

    /// Takes the size of the screen, in columns and rows.
    pub fn handle_resize(&mut self, columns: u16, rows: u16) {
        self.view.size = (columns, rows);
        self.renew_time_bar();
        if !std::mem::replace(&mut self.view.has_screen, true) {
            self.settle_alarm();
            self.settle_problems();
        }
        self.notices.redraw.set_dirty();
        self.refresh_rows();
    }

    /// Handles the line to which the details or the help were scrolled when they were drawn; `None`
    /// if nothing scrolls.
    pub fn handle_drawn(&mut self, scrolled: Option<u16>) {
        let Some(scrolled) = scrolled else { return };
        if !self.input.set_help_scroll(scrolled) {
            self.view.details_scroll = scrolled;
        }
    }

    /// Takes the profile `name`, which was saved by another program; a wrong one changes nothing.
    pub fn handle_profile(&mut self, now: Instant, name: &str, profile: Result<Profile, String>) {
        let now = self.clock.set(now);
        match profile {
            Ok(profile) => self.profile_changed(name, &Arc::new(profile)),
            Err(why) => {
                let text = format!("{name}: {why}; the profile before stays in force");
                self.report_wrong_file(now, text);
            }
        }
    }

    /// Takes what the project `name` says, which was saved by another program; a wrong one changes
    /// nothing.
    pub fn handle_project(
        &mut self,
        now: Instant,
        name: &str,
        project: Result<ProjectFacts, String>,
    ) {
        let now = self.clock.set(now);
        match project {
            Ok(project) if project == **self.buses.project() => {
                self.show_info(format!(
                    "{name}: saved; buses and files are read at the next start"
                ));
            }
            Ok(project) => {
                let project = Arc::new(project);
                self.buses.set_project(Arc::clone(&project));
                if let Some(past) = &mut self.past {
                    past.buses.set_project(project);
                }
                self.show_info(format!("{name}: read"));
                self.refresh();
            }
            Err(why) => {
                let text = format!("{name}: {why}; the project before stays in force");
                self.report_wrong_file(now, text);
            }
        }
        self.notices.redraw.set_dirty();
    }

    /// Takes what is known of types of devices: at the start, and when a file of it was saved.
    pub fn handle_catalogue(&mut self, now: Instant, catalogue: Arc<Catalogue>) {
        let now = self.clock.set(now);
        let before = Arc::clone(self.buses.catalogue());
        let notice_of = |catalogue: &Catalogue, path: &str| {
            catalogue.files().iter().find(|file| file.path == path)?.notice()
        };
        for file in catalogue.files() {
            let Some(text) = file.notice() else { continue };
            if notice_of(&before, &file.path).as_ref() != Some(&text) {
                self.report_wrong_file(now, text);
            }
        }
        let is_mended = |file: &&CatalogueFile| {
            file.notice().is_some() && notice_of(&catalogue, &file.path).is_none()
        };
        let mended: Vec<String> =
            before.files().iter().filter(is_mended).map(|file| file.path.clone()).collect();
        for path in mended {
            self.show_info(format!("{path}: read"));
        }
        self.buses.set_catalogue(Arc::clone(&catalogue));
        if let Some(past) = &mut self.past {
            past.buses.set_catalogue(catalogue);
        }
        self.refresh();
        self.filter_frames();
        self.notices.redraw.set_dirty();
    }

    /// Reports that a file with a mistake was saved, of which the content before stays in force.
    fn report_wrong_file(&mut self, now: Instant, text: String) {
        self.add_line_to_all_buses(TimelineKind::Error, &text);
        self.notices.emit(AppEvent::WrongFile(text.clone()));
        self.notices.file_error(now, text);
    }

    /// Takes the result of an [`Effect::WriteFile`]; `Err` with the cause.
    pub fn handle_written(&mut self, now: Instant, path: &Path, result: Result<(), Diagnostic>) {
        self.clock.set(now);
        if self.handle_written_profile(path, &result) || self.handle_written_proof(path, &result) {
            return self.notices.redraw.set_dirty();
        }
        let copied = self
            .files
            .indices()
            .find(|file| self.files.get_mut(*file).handle_written(path, result.is_ok()));
        if let Err(why) = &result
            && self.reopen_prompt(path, &format!("not saved: {why}"))
        {
            return;
        }
        let path = crate::text::printable_path(path);
        match result {
            Ok(()) if let Some(file) = copied => {
                let line = format!("a copy with all edits: {path}");
                let of_file = self.of_file(file);
                self.show_info(format!("{of_file}{line}"));
                self.add_file_line(file, TimelineKind::File, line);
            }
            Ok(()) => self.show_info(format!("saved: {path}")),
            Err(why) => self.show_error(format!("not saved: {why}")),
        }
    }

    /// Handles a new status of a bus.
    pub fn handle_bus(&mut self, now: Instant, index: BusIndex, status: BusStatus) {
        self.clock.set(now);
        self.bus_changed(index, status);
    }

    /// Takes the state of the recording.
    pub fn handle_recording(&mut self, now: Instant, status: RecordingStatus) {
        self.clock.set(now);
        self.recording_changed(status);
    }

    /// Takes the progress of an [`Effect::FindBitrate`].
    pub fn handle_bitrate_search(&mut self, now: Instant, bus: BusIndex, progress: SearchProgress) {
        self.clock.set(now);
        self.report_bitrate_search(bus, progress);
    }

    /// Takes the result of an [`Effect::FindBitrate`]; `Err` with the cause.
    pub fn handle_bitrate(
        &mut self,
        now: Instant,
        bus: BusIndex,
        result: Result<SearchOutcome, String>,
    ) {
        self.clock.set(now);
        self.bitrate_found(bus, result);
    }

    /// Takes the state of the playback, where all buses are logs.
    pub fn handle_playback(&mut self, now: Instant, playback: Playback) {
        self.clock.set(now);
        if self.clock.set_playback(playback) {
            if self.time_bar.end != self.last_moment() {
                // A log that stands has no further second.
                self.renew_time_bar();
            }
            if self.clock.playback().is_some_and(|it| it.is_ended) {
                self.notices.redraw.set_stale();
            }
            self.notices.redraw.set_dirty();
        }
        self.check_reading();
    }

    // ---- poll_*: output --------------------------------------------------------------------

    /// The next frame to transmit; `frame.bus` is the bus to transmit on.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.buses.poll_transmit(now)
    }

    /// The next work for the shell.
    pub fn poll_effect(&mut self) -> Option<Effect> {
        self.effects.pop_front()
    }

    /// The next event, where [`AppOptions::emit_events`] is set.
    pub fn poll_app_event(&mut self) -> Option<AppEvent> {
        self.notices.poll_event()
    }

    /// The moment at which [`App::handle_timeout`] is due.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let second = (!self.was_idle || !self.is_idle()).then_some(self.clock.next_second());
        let file = self.files_timeout().filter(|_| !self.clock.has_real());
        let parts = self.buses.poll_timeout().into_iter().chain(self.notices.poll_timeout());
        let screen = self.poll_screen_timeout().filter(|_| !self.clock.has_real());
        let own = self.search_timeout().into_iter().chain(self.plan_timeout());
        let own = own.chain(self.sending_timeout()).chain(self.prover_timeout());
        let own = own.chain(self.file_comparison_due());
        parts.chain(second).chain(file).chain(screen).chain(self.reading_ahead).chain(own).min()
    }

    /// Sets the real time, by which des.json is saved again and a file that has become empty is
    /// accepted: other programs keep to it, whatever the pace of a log. Without it, the time of the
    /// buses counts.
    pub fn set_real_time(&mut self, real: Instant) {
        self.clock.set_real(real);
    }

    /// When to call [`Self::handle_real_timeout`] next, in real time; `None` unless that is set.
    pub fn poll_real_timeout(&self) -> Option<Instant> {
        let due = self.files_timeout().into_iter().chain(self.poll_screen_timeout());
        due.min().filter(|_| self.clock.has_real())
    }

    /// Handles what is due at this real time.
    pub fn handle_real_timeout(&mut self, real: Instant) {
        self.clock.set_real(real);
        self.run_file_timers();
        self.run_screen_timers();
        debug_assert_later(self.poll_real_timeout(), real);
    }

    /// When to go on with what the screen waits for, in real time: a log may be paused meanwhile.
    fn poll_screen_timeout(&self) -> Option<Instant> {
        let comparison = self.comparison.as_ref().and_then(|comparison| comparison.due());
        let play = self.play.map(|play| play.due());
        let work = self.filter_due.into_iter().chain(self.replay_due);
        let candidates = self.candidate_counts.as_ref().and_then(|counts| counts.due());
        work.chain(comparison).chain(play).chain(candidates).min()
    }

    /// Goes on with the filter, a replay, a comparison and playing.
    fn run_screen_timers(&mut self) {
        let real = self.clock.real();
        if self.filter_due.is_some_and(|due| due <= real) {
            self.filter_frames();
        }
        if self.replay_due.is_some_and(|due| due <= real) {
            self.go_on_replaying();
        }
        if self.comparison.as_ref().is_some_and(|it| it.is_due(real)) {
            self.go_on_comparing();
        }
        self.go_on_counting_candidates();
        self.go_on_playing();
    }

    /// Returns true if the screen is out of date.
    pub fn is_dirty(&self) -> bool {
        self.notices.redraw.is_dirty()
    }

    /// Returns true if the screen is out of date, and counts it as drawn. Call it before each
    /// draw: it renews the rows.
    pub fn take_dirty(&mut self) -> bool {
        self.renew_rows();
        self.renew_followed();
        self.notices.redraw.take_dirty(self.clock.now())
    }

    /// Renews rows, problems and counts, if an engine reported something since they were made.
    /// Their cost grows with devices and findings, so they are made for a draw or a key, not for a
    /// frame.
    pub fn renew_rows(&mut self) {
        if self.notices.redraw.take_stale() {
            self.refresh_for_draw();
        }
        self.filter_frames();
    }

    // ---- the state of the parts ------------------------------------------------------------

    /// The latest moment that a handler was called with.
    pub fn now(&self) -> Instant {
        self.clock.now()
    }

    /// Paths of the logs that are read.
    pub(crate) fn logs(&self) -> &[PathBuf] {
        &self.logs
    }

    /// Unix time of [`Instant::ZERO`].
    pub fn epoch(&self) -> Epoch {
        self.clock.epoch()
    }

    /// The date of a moment on the wall clock: `2026-11-21`.
    pub fn date_text(&self, at: Instant) -> String {
        self.clock.date_text(at)
    }

    /// A moment on the wall clock with its date: `2026-11-21 06:00:36`.
    pub fn date_time_text(&self, at: Instant) -> String {
        self.clock.date_time_text(at)
    }

    /// Offset of the wall clock from UTC at a moment: `UTC+02:00`.
    pub fn utc_offset_text(&self, at: Instant) -> String {
        self.clock.wall().offset_text(at)
    }

    /// State of the playback; `None` unless all buses are logs.
    pub fn playback(&self) -> Option<Playback> {
        self.clock.playback()
    }

    /// Returns true if the bit rate of a bus is being searched.
    pub fn searches_bitrate_of(&self, bus: BusIndex) -> bool {
        self.shown_buses().searched() == Some(bus)
    }

    /// The entry of a row.
    pub fn entry_of(&self, row: &Row) -> Option<&Entry> {
        self.shown_documents().entry(row.entry?)
    }

    /// Entry of des.json for a device; `None` while its name is not known.
    pub fn new_entry(&self, device: &Device) -> Option<NewEntry> {
        listing::new_entry(&self.buses, self.files.documents(), device)
    }

    /// The assignment of entries to devices.
    pub fn matching(&self) -> &Matching {
        self.shown_problems().matching()
    }

    /// All findings: bus by bus, then those of the comparison with the file.
    pub fn findings(&self) -> impl Iterator<Item = &Finding> {
        self.shown_problems().findings(self.shown_buses())
    }

    /// Differences between file and buses at `now`; those that were found before have their times.
    pub fn compare(&self, now: Instant, scope: Scope) -> Vec<Finding> {
        let inputs = Inputs { now, ..inputs!(self) };
        self.problems.compare(inputs, scope)
    }

    /// The buses, now and in the past.
    pub fn history(&self) -> &RecordedBuses {
        &self.buses
    }

    /// State of the recording; `None` without one.
    pub fn recording(&self) -> Option<&RecordingStatus> {
        self.traffic.recording()
    }

    /// The timeline.
    pub fn timeline(&self) -> &Timeline {
        self.notices.timeline()
    }

    /// The message in the footer.
    pub fn message(&self) -> Option<&StatusMessage> {
        self.notices.message()
    }

    /// The view.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// Regions of the screen.
    pub fn screen(&self) -> Screen {
        self.view.screen(self.buses.len())
    }

    /// The overlay over the page.
    pub fn overlay(&self) -> &Overlay {
        self.input.overlay()
    }

    /// Mode in which keys are looked up; an open prompt takes keys before that.
    pub fn mode(&self) -> KeyMode {
        self.input.mode()
    }

    /// The open prompt.
    pub fn prompt(&self) -> Option<&Prompt> {
        self.input.prompt()
    }

    /// Validation of the open prompt.
    pub fn prompt_check(&self) -> Option<InputCheck> {
        let prompt = self.prompt()?;
        let failure = self.input.failure().map(|why| InputCheck::Rejected(why.to_owned()));
        Some(failure.unwrap_or_else(|| prompt.validate(self.open_prompt_context())))
    }

    /// Text before the line of the open prompt.
    pub fn prompt_label(&self) -> Option<String> {
        let prompt = self.prompt()?;
        let label = match &prompt.kind {
            PromptKind::NewEntry(_) | PromptKind::CopyPath(_) => {
                let documents = self.files.documents();
                let file = prompt.kind.file(documents).filter(|_| documents.are_several());
                let of = file.map(|file| format!(" ({})", documents.name(file)));
                prompt.kind.label().to_owned() + &of.unwrap_or_default()
            }
            kind => kind.label().to_owned(),
        };
        let id = match &prompt.kind {
            PromptKind::Address(prompt) => match prompt.key {
                RowKey::Device(id) => Some(id),
                RowKey::Entry(..) | RowKey::Board(..) => None,
            },
            _ => None,
        };
        let joined = |id: &DeviceId| {
            self.rows().iter().any(|row| row.has_device(*id) && !row.redundant_ids.is_empty())
        };
        let bus = id.filter(joined).and_then(|id| self.bus(id.bus));
        let on_bus = bus.map(|bus| format!("{label} on {} (Tab: next)", bus.name));
        Some(on_bus.unwrap_or(label))
    }

    /// Signs that the terminal can show.
    pub fn signs(&self) -> Signs {
        self.signs
    }

    /// The keymap.
    pub fn keymap(&self) -> &Keymap {
        self.input.keymap()
    }

    /// First key of an action, for a sentence; its name where it is unbound.
    pub fn key_of(&self, action: Action) -> String {
        self.keymap().key_text(action)
    }

    // ---- wiring that all commands need -----------------------------------------------------

    fn show_info(&mut self, text: impl Into<String>) {
        self.notices.info(self.clock.now(), text);
    }

    fn show_error(&mut self, text: impl Into<String>) {
        self.notices.error(self.clock.now(), text);
    }

    fn file_info(&mut self, text: impl Into<String>) {
        self.notices.file_info(self.clock.now(), text);
    }

    fn file_error(&mut self, text: impl Into<String>) {
        self.notices.file_error(self.clock.now(), text);
    }

    /// Adds a line to the timeline and to the events.
    fn report_line(&mut self, line: TimelineEntry) {
        if self.notices.emits_events() && self.notices.passes_filter(&self.buses, &line, &[]) {
            let event = self.line_event(&line);
            self.notices.emit(event);
        }
        self.notices.push_line(line);
    }

    fn list_height(&self) -> usize {
        self.screen().list_rows()
    }

    /// Requests a redraw after a change on the bus, at most every 250 ms.
    fn request_redraw(&mut self) {
        let interval = self.clock.scale_to_playback(notices::BUS_REDRAW_INTERVAL);
        self.notices.redraw.request(self.clock.now(), interval);
    }

    /// Returns true if nothing on the screen changes with time.
    pub fn is_idle(&self) -> bool {
        // The axis of the charts moves.
        if self.view.page == Page::Bus && self.buses.iter().any(|bus| bus.ended.is_none()) {
            return false;
        }
        if self.grows_on_timeline() {
            return false;
        }
        // The most expensive test comes last: this is called in every turn of the event loop.
        let waits = || (0..self.buses.len()).any(|at| !self.is_search_complete(BusIndex(at as u8)));
        self.buses.is_quiet() && !(self.files.are_any_there() && waits())
    }

    /// Renews rates and ages, once per second.
    fn tick(&mut self) {
        let is_idle = self.is_idle();
        let was_idle = std::mem::replace(&mut self.was_idle, is_idle);
        self.buses.tick(self.clock.now());
        self.traffic.tick(self.clock.now(), &self.buses);
        self.recount_candidates();
        self.renew_profile_difference();
        // What made it idle is shown, too.
        if !was_idle {
            self.renew_time_bar();
            self.refresh_before_draw();
            self.notices.redraw.set_dirty();
        }
    }

    /// Marks rows and problems as out of date; without a screen, renews them at once.
    fn refresh_before_draw(&mut self) {
        self.notices.redraw.set_stale();
        if !self.view.has_screen {
            self.renew_rows();
        }
    }

    /// Tests the next part of the frames by the filter, and counts the identifiers of a past moment.
    fn filter_frames(&mut self) {
        let is_counted = self.count_past_frames();
        let was_due = self.filter_due.take().is_some();
        self.traffic.set_filter(self.filters.of(Page::Traffic).active());
        let buses = self.past.as_ref().map_or(&*self.buses, |past| &past.buses);
        if !self.traffic.renew_filter(&mut self.view, buses) || !is_counted {
            self.filter_due = Some(self.clock.real() + FILTER_PAUSE);
        }
        if was_due {
            self.request_redraw();
        }
    }

    /// Renews everything that is made from buses and file.
    fn refresh(&mut self) {
        self.refresh_with(Self::refresh_problems);
    }

    /// The same; a log does not compare before the time at which that is due.
    fn refresh_for_draw(&mut self) {
        self.refresh_with(Self::compare_file_for_draw);
    }

    fn refresh_with(&mut self, compare: fn(&mut Self)) {
        self.notices.redraw.take_stale();
        self.note_content();
        self.refresh_redundancy();
        compare(self);
        if self.view.has_screen {
            self.settle_alarm();
            self.settle_problems();
            self.settle_bars();
            self.refresh_rows();
        }
    }

    fn refresh_rows(&mut self) {
        self.count_lanes();
        let inputs = shown_inputs!(self);
        let problems = self.past.as_ref().map_or(&self.problems, |past| &past.problems);
        let problems = problems.list(inputs.buses);
        let filter = self.filters.of(Page::Devices).active();
        self.devices.refresh(inputs, &problems, filter, &mut self.view);
    }

    fn problem_keys(&self) -> Vec<ProblemKey> {
        self.problems_shown().keys().cloned().collect()
    }

    /// After a change of the problems: keeps the selection on its problem.
    fn settle_problems(&mut self) {
        let shown = self.problem_keys();
        self.note_problem_rows(shown.len());
        let height = self.list_height();
        if self.view.page == Page::Problems {
            // A new first problem must not move under the key that is about to be pressed.
            self.view.problems.update_keeping(&shown, height);
        } else {
            self.view.problems.update(&shown, height);
        }
    }
}

impl Decoded {
    /// Decodes a frame with the names and the profile of its bus.
    pub fn of(app: &App, frame: &Frame) -> Self {
        Self::new(app.shown_buses(), frame)
    }
}

impl FrameMeaning {
    /// Decodes a frame with the profile of its bus.
    pub fn of(app: &App, frame: &Frame) -> Self {
        Self::new(app.shown_buses(), frame)
    }
}

/// A moment on the wall clock: `12:03:11`.
pub fn format_time_of_day(app: &App, at: Instant) -> String {
    let seconds = app.clock.second_of_day(at);
    format!("{:02}:{:02}:{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60)
}

/// A moment on the wall clock with milliseconds: `12:03:11.204`.
pub fn clock_millis(app: &App, at: Instant) -> String {
    let millis = app.epoch().unix_micros(at) / 1000 % 1000;
    format!("{}.{millis:03}", format_time_of_day(app, at))
}
