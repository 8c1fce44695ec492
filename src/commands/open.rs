//! From arguments to an open session: profile, settings, buses, des.json.

use super::{Failure, output};
use crate::app::{
    App, AppOptions, BusSelection, Filter, FrameSelector, ProjectFacts, RowKind, Signs,
};
use crate::bus::{self, BusSpec, CanInterface, Clock, LogDates, Options, Port};
use crate::catalogue::{Catalogue, CatalogueText};
use crate::cli::{self, CommonArgs, SessionArgs as Arguments};
use crate::dbc::{self, MessageDatabase};
use crate::diagnostic::{Diagnostic, nearest_word};
use crate::discovery::Config;
use crate::frame::{BusIndex, IdFilter};
use crate::keymap::Keymap;
use crate::project::Project;
use crate::regular_file;
use crate::shell::catalogue_folders::CatalogueFolders;
use crate::shell::config::{ConfigFolder, UserSettings};
use crate::shell::recorder::{Recorder, Size, Target};
use crate::shell::session::Session;
use crate::shell::store::Store;
use crate::status::RecordingStatus;
use crate::text::{SafeLines, printable, printable_path};
use crate::time::{Epoch, Instant};
use crate::wire::profile::Profile;
use std::fs;
use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Path of des.json, unless given.
const DEFAULT_FILE: &str = "des.json";

/// The user's settings and the arguments, combined.
#[derive(Clone)]
pub struct Setup {
    /// The user's settings folder.
    pub folder: Option<ConfigFolder>,
    /// The keys.
    pub keymap: Keymap,
    /// The settings of every bus's engine.
    pub config: Config,
    /// File of the profile; `None` for the built-in one.
    pub profile: Option<PathBuf>,
    /// Where des.json is: that of the first bus.
    pub file: PathBuf,
    /// The des.json files that further buses have in its place, in the order of the buses.
    pub own_files: Vec<Option<PathBuf>>,
    /// File of the project.
    pub project_path: Option<PathBuf>,
    /// The project.
    pub project: Option<Arc<Project>>,
    /// des.json of the command line.
    pub named_file: Option<PathBuf>,
    /// Folders of the catalogue that the command line or the project names.
    pub named_catalogue: Option<Vec<PathBuf>>,
    /// What is known of types of devices.
    pub catalogue: Arc<Catalogue>,
    /// Where it is read from, and what was read.
    pub catalogue_files: (CatalogueFolders, Vec<CatalogueText>),
    /// Messages of DBC files.
    pub messages: Arc<MessageDatabase>,
    /// Where frames are recorded.
    pub record: Option<Target>,
    /// Which frames are recorded: the line and its filter; `None` for all.
    pub record_filter: Option<(String, Filter)>,
    /// Patterns of the frames to receive; empty for all.
    pub only: Vec<IdFilter>,
    /// The buses were chosen from a list: adapters listen first.
    pub listens_first: bool,
    /// Name of the theme chosen with the buses; before that of the command line.
    pub chosen_theme: Option<String>,
    /// Name of the theme in the settings; `None` for the default.
    pub theme: Option<String>,
    /// Bytes per second to the terminal in the settings; `None` for the built-in number.
    pub screen_budget: Option<f64>,
    /// Signs in the settings; `None` for those of the terminal.
    pub signs: Option<Signs>,
    /// Errors in the user's settings. Already printed, but a screen hides that.
    pub warnings: Vec<String>,
}

impl Setup {
    /// Reads the user's settings, whose errors are warnings, and the profile of the arguments.
    ///
    /// # Errors
    /// The profile cannot be used, or the filter of the recording has a mistake.
    pub fn new(common: &CommonArgs) -> Result<Self, Failure> {
        Self::for_buses(common, &[])
    }

    /// The same, with the des.json files of these buses.
    ///
    /// # Errors
    /// As [`Setup::new`]; or the project has a mistake.
    pub fn for_buses(common: &CommonArgs, buses: &[BusSpec]) -> Result<Self, Failure> {
        let (project_path, project) = super::project::of(common)?.unzip();
        let profile_path = common.profile.clone().or_else(|| project.as_ref()?.profile.clone());
        let folder = ConfigFolder::of_user();
        let settings = folder.as_ref().map_or(Ok(UserSettings::default()), ConfigFolder::settings);
        let mut warnings = Vec::new();
        let settings = settings.unwrap_or_else(|why| warn(&mut warnings, &why));
        let keymap = folder.as_ref().map_or(Ok(Keymap::default()), ConfigFolder::keymap);
        let keymap = keymap.unwrap_or_else(|why| warn(&mut warnings, &why));
        let built_in = Config::default();
        let config = Config {
            profile: Arc::new(profile(profile_path.as_deref())?),
            listen_only: common.listen_only,
            send_requests: !common.no_scan,
            address: common.address,
            round_period: settings.round_period().unwrap_or(built_in.round_period),
            startup_budget: settings.start_share.unwrap_or(built_in.startup_budget),
            steady_budget: settings.steady_share.unwrap_or(built_in.steady_budget),
            // Two inspectors that start together must not pick the same address.
            seed: fastrand::u64(..),
            ..built_in
        };
        let own = project.as_ref().and_then(|project| project.catalogue.clone());
        let is_named = !common.catalogue.is_empty();
        let named_catalogue = if is_named { Some(common.catalogue.clone()) } else { own };
        if let Some(folder) = named_catalogue.iter().flatten().find(|folder| !folder.is_dir()) {
            let folder = printable_path(folder);
            return Err(Failure::Unusable(format!("catalogue {folder}: not a folder; name one")));
        }
        let signs = settings.signs.as_deref().and_then(Signs::from_name);
        let theme = settings.theme;
        let max_bytes = common.record_size.map(|Size(bytes)| bytes);
        let record = common.record.clone().map(|path| Target { path, max_bytes });
        let line = common.record_filter.as_deref();
        let record_filter = filter("--record-filter", line, RowKind::Frame)?;
        let line = line.filter(|_| !record_filter.is_empty());
        let record_filter = line.map(|line| (line.to_owned(), record_filter));
        let only = Vec::new();
        let mut setup = Self {
            folder,
            keymap,
            config,
            profile: profile_path,
            file: PathBuf::new(),
            own_files: Vec::new(),
            project_path,
            project: project.map(Arc::new),
            named_file: common.file.clone(),
            named_catalogue,
            catalogue: Arc::default(),
            catalogue_files: Default::default(),
            messages: Arc::new(messages(&common.dbc)?),
            record,
            record_filter,
            only,
            listens_first: false,
            chosen_theme: None,
            theme,
            screen_budget: settings.screen_budget,
            signs,
            warnings,
        };
        setup.find_files(buses);
        setup.read_catalogue(setup.catalogue_folders());
        Ok(setup)
    }

    /// Returns the des.json of a bus.
    pub fn file_of(&self, bus: &BusSpec) -> PathBuf {
        match (&self.named_file, &self.project) {
            (None, Some(project)) => project.file_of(bus).to_owned(),
            _ => self.shared_file(),
        }
    }

    /// Returns the des.json of buses without one of their own.
    fn shared_file(&self) -> PathBuf {
        let of_project = || self.project.as_ref().map(|project| project.file.clone());
        self.named_file.clone().or_else(of_project).unwrap_or_else(default_file)
    }

    /// Finds the des.json of each of these buses.
    fn find_files(&mut self, buses: &[BusSpec]) {
        let files: Vec<PathBuf> = buses.iter().map(|bus| self.file_of(bus)).collect();
        self.file = files.first().cloned().unwrap_or_else(|| self.shared_file());
        let mut known = vec![self.file.clone()];
        let own_files = files.into_iter().map(|file| {
            let file = as_known(&known, file);
            known.push(file.clone());
            (file != self.file).then_some(file)
        });
        self.own_files = own_files.collect();
    }

    /// The des.json files of the session, each once, that of the first bus first.
    fn files(&self) -> Vec<&Path> {
        let mut files = vec![self.file.as_path()];
        for file in self.own_files.iter().flatten() {
            if !files.contains(&file.as_path()) {
                files.push(file);
            }
        }
        files
    }

    /// Takes the des.json files of these buses, which were chosen since, and the catalogue beside them.
    pub fn choose_files(&mut self, buses: &[BusSpec]) {
        let before = (self.file.clone(), self.own_files.clone());
        self.find_files(buses);
        let is_changed = before != (self.file.clone(), self.own_files.clone());
        if is_changed && self.named_catalogue.is_none() {
            self.read_catalogue(self.catalogue_folders());
        }
    }

    /// The folders of the catalogue: without named ones, those beside the des.json files.
    fn catalogue_folders(&self) -> CatalogueFolders {
        match &self.named_catalogue {
            Some(folders) => CatalogueFolders::of(folders.clone()),
            // The folder of a project is meant for it.
            None => CatalogueFolders::beside(&self.files(), self.project.is_some()),
        }
    }

    /// Returns the name of a bus: that of the project, if the project has it.
    pub fn name_of(&self, bus: &BusSpec) -> String {
        self.project.as_ref().map_or_else(|| bus.to_string(), |project| project.name_of(bus))
    }

    /// What the project says about the buses.
    pub fn project_facts(&self) -> Arc<ProjectFacts> {
        let facts = self.project.as_ref().map(|project| project.facts(&[]));
        Arc::new(facts.unwrap_or_default())
    }

    /// Reads the catalogue; mistakes in its files are warnings.
    pub fn read_catalogue(&mut self, folders: CatalogueFolders) {
        let texts = folders.read();
        let catalogue = Catalogue::default().read(texts.clone());
        for file in catalogue.files() {
            if let Some(warning) = file.notice() {
                output::warn(&warning);
                self.warnings.push(warning);
            }
        }
        self.catalogue = Arc::new(catalogue);
        self.catalogue_files = (folders, texts);
    }

    /// Returns the setup for buses that were chosen from the list; what is recorded goes to a new file.
    pub fn for_selection(&self, wanted: &BusSelection) -> Self {
        let chosen_theme = wanted.theme.clone().or(self.chosen_theme.clone());
        let mut setup = Self { listens_first: true, chosen_theme, ..self.clone() };
        setup.config = selected_config(&setup.config, wanted);
        if wanted.records && setup.record.is_none() {
            setup.record = Some(Target { path: PathBuf::from("session.log"), max_bytes: None });
        }
        if let Some(target) = &mut setup.record {
            target.path = free_path(&target.path);
        }
        setup
    }

    /// Reads the profile again: it may have been saved since.
    ///
    /// # Errors
    /// It cannot be used.
    pub fn read_profile(&mut self) -> Result<(), Failure> {
        self.config.profile = Arc::new(profile(self.profile.as_deref())?);
        Ok(())
    }

    /// Starts the recording, if requested. Call when all else is open.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn recorder(&self) -> Result<Option<Recorder>, Failure> {
        let recorder = self.record.as_ref().map(Recorder::create).transpose()?;
        if let (Some(recorder), Some((line, _))) = (&recorder, &self.record_filter) {
            recorder.set_filter(line);
        }
        Ok(recorder)
    }

    /// Selects the frames that are recorded; `None` for all.
    pub fn record_selector(&self) -> Option<FrameSelector> {
        self.record_filter.as_ref().map(|(_, filter)| FrameSelector::new(filter.clone()))
    }
}

fn selected_config(config: &Config, wanted: &BusSelection) -> Config {
    Config {
        listen_only: config.listen_only || wanted.listen_only,
        send_requests: config.send_requests && !wanted.no_requests,
        ..config.clone()
    }
}

/// Returns this path, or the first one with a number behind its name that does not exist:
/// `session-2.log`.
fn free_path(path: &Path) -> PathBuf {
    let named = |number: u32| {
        let mut name = path.file_stem().unwrap_or_default().to_owned();
        name.push(format!("-{number}."));
        name.push(path.extension().unwrap_or_default());
        path.with_file_name(name)
    };
    let mut paths = std::iter::once(path.to_owned()).chain((2..=u32::MAX).map(named));
    // A file that cannot be seen is reported when it is created.
    paths.find(|path| !path.exists()).unwrap_or_else(|| path.to_owned())
}

/// Parses an option that is a filter; empty without it.
///
/// # Errors
/// The first mistake, with its column.
pub fn filter(option: &str, line: Option<&str>, rows: RowKind) -> Result<Filter, Failure> {
    let line = line.unwrap_or_default();
    Filter::parse(line, rows).map_err(|error| {
        let (text, column) = (printable(error.text().as_bytes()), error.column(line));
        Failure::Usage(format!("{option} {text}, column {column}"))
    })
}

/// Prints an error in the settings and returns the built-in value.
pub fn warn<T: Default>(warnings: &mut Vec<String>, why: &str) -> T {
    output::warn(format_args!("{why} (built-in values are used)"));
    warnings.push(SafeLines(why).to_string());
    T::default()
}

/// Where des.json is, unless it is given.
pub fn default_file() -> PathBuf {
    PathBuf::from(DEFAULT_FILE)
}

/// Reads a profile; `None` returns the assumed values.
pub fn profile(path: Option<&Path>) -> Result<Profile, Failure> {
    path.map_or_else(|| Ok(Profile::default()), super::profile::read)
}

/// Reads DBC files, in all at most of the largest size of one.
///
/// # Errors
/// A file cannot be read, or has a mistake.
fn messages(paths: &[PathBuf]) -> Result<MessageDatabase, Failure> {
    let mut messages = MessageDatabase::default();
    let mut size = 0;
    for path in paths {
        let missing = || Diagnostic::new("not found").with_remedy("check the name");
        let bytes = regular_file::read(path, dbc::MAX_FILE);
        let bytes = bytes.and_then(|bytes| bytes.ok_or_else(missing));
        let read = bytes.and_then(|bytes| {
            size += bytes.len() as u64;
            if size > dbc::MAX_FILE {
                let limit = dbc::MAX_FILE >> 20;
                let why = Diagnostic::new(format!("the DBC files have over {limit} MiB together"));
                return Err(why.with_remedy("leave some out"));
            }
            let wrong = |error: dbc::DbcError| {
                Diagnostic::new(error.to_string()).with_remedy("correct it, or leave --dbc out")
            };
            messages.add(&bytes).map_err(wrong)
        });
        read.map_err(|fault| fault.of(printable_path(path)))?;
    }
    Ok(messages)
}

/// The buses of the arguments; without any, the only CAN interface.
///
/// # Errors
/// A word names no bus, a bus is named twice, or none is named and there is not exactly one CAN
/// interface.
pub fn buses(arguments: &Arguments) -> Result<Vec<BusSpec>, Failure> {
    let mut buses: Vec<BusSpec> = arguments.buses.iter().map(known).collect::<Result<_, _>>()?;
    if buses.is_empty() {
        buses = super::project::buses(&arguments.common)?;
    }
    let stdins = buses.iter().filter(|bus| **bus == BusSpec::Stdin).count();
    if stdins > 1 {
        return Err(Failure::Usage("standard input (-) can be read only once".to_owned()));
    }
    if stdins > 0 && io::stdin().is_terminal() {
        let why = "standard input is a terminal; pipe a log: candump -L can0 | descan -";
        return Err(Failure::Usage(why.to_owned()));
    }
    for (at, bus) in buses.iter().enumerate() {
        // Every device would be listed twice, and descan would respond to itself.
        if let Some(other) = buses[..at].iter().find(|other| bus.is_same_bus(other)) {
            return Err(Failure::Usage(format!("{bus} is the same bus as {other}; name it once")));
        }
    }
    if !buses.is_empty() {
        return Ok(buses);
    }
    let there = bus::interfaces();
    match &there[..] {
        [only] => Ok(vec![BusSpec::SocketCan(only.name.clone())]),
        [] => Err(Failure::Usage(format!("no CAN interface found; {NAME_A_BUS}"))),
        several => {
            let names = names_of(several);
            Err(Failure::Usage(format!("several CAN interfaces: {names}; name one")))
        }
    }
}

/// What a user without a CAN interface can do.
const NAME_A_BUS: &str = if cfg!(target_os = "linux") {
    "name a bus (descan can0, descan file:LOG), or try it out: descan demo"
} else if cfg!(windows) {
    "name a bus (descan slcan:COM3@500000, descan file:LOG), or try it out: descan demo"
} else {
    "name a bus (descan slcan:/dev/cu.usbmodem1@500000, descan file:LOG), or try it out: descan demo"
};

fn names_of(interfaces: &[CanInterface]) -> String {
    interfaces.iter().map(|it| it.name.as_str()).collect::<Vec<_>>().join(", ")
}

/// Returns the path of the same file among the known ones, if it is there.
fn as_known(known: &[PathBuf], file: PathBuf) -> PathBuf {
    known.iter().find(|it| is_same_file(it, &file)).cloned().unwrap_or(file)
}

/// Returns true if two paths lead to the same file, which need not exist.
fn is_same_file(one: &Path, other: &Path) -> bool {
    let whole = |path: &Path| {
        let folder = path.parent().filter(|it| !it.as_os_str().is_empty());
        let beside = || {
            let folder = fs::canonicalize(folder.unwrap_or(Path::new("."))).ok()?;
            Some(folder.join(path.file_name()?))
        };
        fs::canonicalize(path).ok().or_else(beside)
    };
    one == other || whole(one).is_some_and(|path| whole(other) == Some(path))
}

/// Returns what a BUS argument names: a word is an interface, or a log in this folder.
///
/// # Errors
/// A word that names neither, and is not like the name of a CAN interface, which may appear later.
fn known(bus: &BusSpec) -> Result<BusSpec, Failure> {
    match bus {
        BusSpec::SocketCan(word) if !bus::interface_exists(word) => {
            // Also a pipe.
            if std::fs::metadata(word).is_ok_and(|it| !it.is_dir()) {
                Ok(BusSpec::File(word.into()))
            } else if bus::is_like_an_interface(word) {
                Ok(bus.clone())
            } else {
                Err(Failure::Usage(unknown_word(word)))
            }
        }
        _ => Ok(bus.clone()),
    }
}

/// The error for a word that is neither a command, a file nor a bus.
fn unknown_word(word: &str) -> String {
    if Path::new(word).is_dir() {
        return format!("{word} is a folder; name a log in it: descan {word}/session.log");
    }
    if word.contains(['.', '/']) {
        return format!("{word}: file not found; check the name, or name a bus: descan can0");
    }
    if word == "guide" {
        return format!(
            "{word} is not a command or a bus; descan help lists the pages of the guide"
        );
    }
    let program = cli::program();
    let names = program.get_subcommands().map(clap::Command::get_name);
    let nearest = nearest_word(word, names);
    let there = bus::interfaces();
    let remedy = match (nearest, &there[..]) {
        (Some(command), _) if command == word => {
            format!("the options of a command follow it: descan {command} --help")
        }
        (Some(command), _) => format!("did you mean the command descan {command}?"),
        (None, []) => format!("no CAN interface found; {NAME_A_BUS}"),
        (None, there) => format!("available: {}", names_of(there)),
    };
    format!("{word} is not a command or a bus; {remedy}")
}

/// Refuses `--speed` unless all buses are logs: beside a live bus, a log is replayed in real time.
pub fn check_speed(speed: Option<f64>, buses: &[BusSpec]) -> Result<(), Failure> {
    match speed {
        Some(_) if !buses.iter().all(is_log) => Err(Failure::Usage(
            "--speed needs a log and no live bus: leave it out, or name a log: file:LOG".to_owned(),
        )),
        _ => Ok(()),
    }
}

/// The clock of a session; logs keep the pace, times `speed`, and the dates of their recording.
pub fn clock(buses: &[BusSpec], speed: f64) -> Result<Clock, Failure> {
    // Beside a live bus, a log is replayed in real time, from now.
    if !buses.iter().all(is_log) {
        return Ok(Clock::start());
    }
    let are_several = buses.len() > 1;
    let dates = buses.iter().map(|bus| dates_of(bus, are_several));
    let logs: Vec<Option<LogDates>> = dates.collect::<Result<_, _>>()?;
    let epoch = match logs.iter().flatten().next() {
        Some(first) => Epoch::from_unix_micros(common_start(&logs, first)),
        None => Clock::start().epoch(),
    };
    let start_of = |log: &LogDates| Instant::from_micros(log.first - common_start(&logs, log));
    let starts = logs.iter().map(|log| log.as_ref().map(start_of)).collect();
    Ok(Clock::of_logs(epoch, speed, starts))
}

/// Start of the logs that were recorded at the same time as this one, or at the same time as one of
/// them, and so on. These keep their dates; recordings of other times begin together with them.
fn common_start(logs: &[Option<LogDates>], log: &LogDates) -> u64 {
    let mut all = *log;
    loop {
        let met = logs.iter().flatten().filter(|other| other.meets(&all));
        let next = met.fold(all, |all, other| LogDates {
            first: all.first.min(other.first),
            last: all.last.max(other.last),
            has_end: all.has_end && other.has_end,
        });
        if next == all {
            return all.first;
        }
        all = next;
    }
}

/// The log, if the input is one; `None` for buses.
///
/// # Errors
/// A log is combined with other buses, or `from` is given without a log.
pub fn log<'b>(
    buses: &'b [BusSpec],
    command: &str,
    from: Option<Duration>,
) -> Result<Option<&'b BusSpec>, Failure> {
    if from.is_some() && !buses.iter().any(is_log) {
        return Err(Failure::Usage(format!(
            "--from needs a log: leave it out, or name a log: descan {command} file:LOG"
        )));
    }
    match buses {
        [log] if is_log(log) => Ok(Some(log)),
        _ if buses.iter().any(is_log) => Err(Failure::Usage(format!(
            "a log cannot be combined with other buses: descan {command} file:LOG"
        ))),
        _ => Ok(None),
    }
}

/// Returns true if a bus is a log, on which nothing can be transmitted.
pub fn is_log(bus: &BusSpec) -> bool {
    matches!(bus, BusSpec::File(_) | BusSpec::Stdin)
}

/// The dates of a log; `None` if it is not a file, or has no frame. With `to_end` the last one is looked
/// for in all of it.
///
/// # Errors
/// It cannot be read, or is of another format.
fn dates_of(bus: &BusSpec, to_end: bool) -> Result<Option<LogDates>, Failure> {
    let BusSpec::File(path) = bus else { return Ok(None) };
    // A pipe is opened once: its writer ends when that is closed.
    if std::fs::metadata(path).is_ok_and(|it| !it.is_file() && !it.is_dir()) {
        return Ok(None);
    }
    let log = bus::open_log(path)?;
    let name = format_args!("file:{}", printable_path(path));
    let read = if to_end { LogDates::read_to_end(&log) } else { LogDates::read(&log) };
    let (summary, dates) = read.map_err(|error| Diagnostic::unreadable(name, &error))?;
    match summary.foreign {
        Some(foreign) => Err(Failure::Unusable(format!("{name}: {foreign}"))),
        None => Ok(dates),
    }
}

/// Opens the buses and joins them with the app.
pub fn session(
    buses: &[BusSpec],
    setup: &Setup,
    clock: Clock,
    options: AppOptions,
) -> Result<Session, Failure> {
    // Before opening: a replayed log runs while the other buses are opened.
    let start = clock.now();
    let mut ports: Vec<Port> = Vec::new();
    let mut named = Vec::new();
    for (index, spec) in buses.iter().enumerate() {
        let listen_only = setup.config.listen_only || is_log(spec);
        let index = BusIndex(index as u8);
        let only = setup.only.clone();
        let listens_first = setup.listens_first || has_unknown_rate(spec);
        let options = Options { listen_only, listens_first, only };
        let port = bus::open(spec, index, clock.clone(), options)?;
        named.push((setup.name_of(spec), Config { listen_only, ..setup.config.clone() }));
        ports.push(port);
    }
    let options = AppOptions {
        epoch: clock.epoch(),
        buses: named,
        logs: logs_of(buses),
        file_path: Some(setup.file.clone()),
        own_file_paths: setup.own_files.clone(),
        catalogue: Arc::clone(&setup.catalogue),
        messages: Arc::clone(&setup.messages),
        project: setup.project_facts(),
        ..options
    };
    let app = App::new(start, options);
    let mut session = Session::new(app, clock, ports, setup.files().into_iter().map(Store::new));
    if let Some(path) = &setup.profile {
        session.watch_profile(path);
    }
    if let Some(path) = &setup.project_path {
        session.watch_project(path);
    }
    let (folders, texts) = setup.catalogue_files.clone();
    session.watch_catalogue(folders, texts);
    if let Some(recorder) = setup.recorder()? {
        session.record(recorder, setup.record_selector());
    }
    Ok(session)
}

/// Returns the paths of the logs among the buses.
fn logs_of(buses: &[BusSpec]) -> Vec<PathBuf> {
    let path = |spec: &BusSpec| match spec {
        BusSpec::File(path) => Some(fs::canonicalize(path).unwrap_or_else(|_| path.clone())),
        _ => None,
    };
    buses.iter().filter_map(path).collect()
}

/// Returns true for an adapter that keeps its own bit rate.
fn has_unknown_rate(spec: &BusSpec) -> bool {
    matches!(spec, BusSpec::Slcan(adapter) if adapter.bitrate.is_none())
}

/// Opens further buses in a session; returns their names.
///
/// # Errors
/// The cause, as a message; buses before the one that cannot be opened stay open.
pub fn add_buses(
    session: &mut Session,
    setup: &Setup,
    wanted: &BusSelection,
) -> Result<Vec<String>, String> {
    let config = selected_config(&setup.config, wanted);
    let mut names = Vec::new();
    for argument in &wanted.buses {
        let spec: BusSpec = argument.parse().map_err(|fault: Diagnostic| fault.to_string())?;
        if let Some((_, name)) = session.open_buses().iter().find(|(it, _)| it.is_same_bus(&spec)) {
            return Err(format!("{argument} is the same bus as {name}, which is open"));
        }
        let next = session.next_bus().zip(session.clock().cloned());
        let (index, clock) = next.ok_or("a log is open: no bus can be added beside it")?;
        let (listen_only, only) = (config.listen_only, setup.only.clone());
        let options = Options { listen_only, listens_first: true, only };
        let port = bus::open(&spec, index, clock, options).map_err(|fault| fault.to_string())?;
        let name = setup.name_of(&spec);
        let file = setup.file_of(&spec);
        let open: Vec<PathBuf> =
            session.app.files().filter_map(|(_, file)| file.path().map(Into::into)).collect();
        let file = Some(as_known(&open, file)).filter(|file| *file != setup.file);
        session.add_bus(port, name.clone(), config.clone(), file);
        names.push(name);
    }
    Ok(names)
}

/// Prints on standard error what was recorded.
pub fn report_recording(status: Option<RecordingStatus>) {
    if let Some(status) = status {
        report_file("recorded", &status);
    }
}

/// Prints on standard error what was written.
pub fn report_written(status: &RecordingStatus) {
    report_file("wrote", status);
}

/// Prints what is in a file; without frames there is none, which the status says.
fn report_file(what: &str, status: &RecordingStatus) {
    if (status.frames, status.bytes) == (0, 0) && status.failure.is_none() {
        output::warn(status);
    } else {
        output::warn(format_args!("{what} {status}"));
    }
}
