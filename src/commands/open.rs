//! From arguments to an open session: profile, settings, buses, des.json.

use super::Failure;
use crate::app::{App, AppOptions};
use crate::bus::{self, BusSpec, Clock, Options, Port};
use crate::cli::{CommonArgs, SessionArgs as Arguments};
use crate::discovery::Config;
use crate::frame::{BusIndex, IdPattern};
use crate::keymap::Keymap;
use crate::shell::config::{ConfigFolder, UserSettings, read_text};
use crate::shell::recorder::{Recorder, Size, Target};
use crate::shell::session::Session;
use crate::shell::store::Store;
use crate::status::RecordingStatus;
use crate::text::on_one_line;
use crate::time::Epoch;
use crate::wire::profile::Profile;
use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Where des.json is when nothing is said.
const DEFAULT_FILE: &str = "des.json";

/// What the settings folder and the arguments say together.
pub struct Setup {
    /// The user's settings folder.
    pub folder: Option<ConfigFolder>,
    /// The keys.
    pub keymap: Keymap,
    /// The settings of every bus's engine.
    pub config: Config,
    /// Where des.json is.
    pub file: PathBuf,
    /// Where all frames are recorded.
    pub record: Option<Target>,
    /// The only frames of interest; none: all are.
    pub only: Vec<IdPattern>,
    /// The theme's name, where one is chosen.
    pub theme: Option<String>,
    /// It was chosen on the command line: one that cannot be used is an error.
    pub theme_is_asked_for: bool,
    /// What is wrong in the user's settings. It was told already; a screen hides that.
    pub warnings: Vec<String>,
}

impl Setup {
    /// Reads the user's settings (what is wrong in them is a warning) and the profile (what is
    /// wrong in it is an error: it was asked for).
    pub fn new(common: &CommonArgs) -> Result<Self, Failure> {
        let folder = ConfigFolder::of_user();
        let settings = folder.as_ref().map_or(Ok(UserSettings::default()), ConfigFolder::settings);
        let mut warnings = Vec::new();
        let settings = settings.unwrap_or_else(|why| warn(&mut warnings, why));
        let keymap = folder.as_ref().map_or(Ok(Keymap::default()), ConfigFolder::keymap);
        let keymap = keymap.unwrap_or_else(|why| warn(&mut warnings, why));
        let built_in = Config::default();
        let config = Config {
            profile: Arc::new(profile(common.profile.as_deref())?),
            listen_only: common.listen_only,
            scan: !common.no_scan,
            address: common.address,
            round_period: settings.round_period().unwrap_or(built_in.round_period),
            start_share: settings.start_share.unwrap_or(built_in.start_share),
            steady_share: settings.steady_share.unwrap_or(built_in.steady_share),
            // Two inspectors that start together must not choose alike.
            seed: fastrand::u64(..),
            ..built_in
        };
        let file = common.file.clone().unwrap_or_else(|| PathBuf::from(DEFAULT_FILE));
        let theme = common.theme.clone().or(settings.theme);
        let theme_is_asked_for = common.theme.is_some();
        let max_bytes = common.record_size.map(|Size(bytes)| bytes);
        let record = common.record.clone().map(|path| Target { path, max_bytes });
        let only = Vec::new();
        Ok(Self { folder, keymap, config, file, record, only, theme, theme_is_asked_for, warnings })
    }

    /// Begins the recording, where one is asked for: when all else is open.
    pub fn recorder(&self) -> Result<Option<Recorder>, Failure> {
        let recorder = self.record.as_ref().map(Recorder::create).transpose();
        recorder.map_err(|error| Failure::Unusable(error.to_string()))
    }
}

/// Tells what is wrong in the settings; what is built in goes in its place.
pub fn warn<T: Default>(warnings: &mut Vec<String>, why: String) -> T {
    let _ = writeln!(io::stderr(), "descan: {why} (built-in values are used)");
    warnings.push(why);
    T::default()
}

/// The profile of that file; without one, what is assumed.
pub fn profile(path: Option<&Path>) -> Result<Profile, Failure> {
    let Some(path) = path else { return Ok(Profile::default()) };
    let unusable = |why: String| Failure::Unusable(format!("{}: {why}", path.display()));
    let text = read_text(path).map_err(|error| unusable(error.to_string()))?;
    let text = text.ok_or_else(|| unusable("file not found".to_owned()))?;
    Profile::parse(&text).map_err(|error| unusable(on_one_line(&error.to_string())))
}

/// The buses of the arguments; where none is given, the one CAN interface there is.
pub fn buses(arguments: &Arguments) -> Result<Vec<BusSpec>, Failure> {
    let stdins = arguments.buses.iter().filter(|bus| **bus == BusSpec::Stdin).count();
    if stdins > 1 {
        return Err(Failure::Usage("standard input (-) can be read only once".to_owned()));
    }
    for (at, bus) in arguments.buses.iter().enumerate() {
        if let Some(other) = arguments.buses[..at].iter().find(|other| is_same(bus, other)) {
            return Err(Failure::Usage(format!("{bus} is the same bus as {other}; name it once")));
        }
    }
    if !arguments.buses.is_empty() {
        return Ok(arguments.buses.clone());
    }
    let there = bus::interfaces();
    match &there[..] {
        [only] => Ok(vec![BusSpec::SocketCan(only.name.clone())]),
        [] => Err(Failure::Usage(
            "no CAN interface found; name a bus (descan can0, descan file:LOG), or try \
             it out: descan demo"
                .to_owned(),
        )),
        several => {
            let names: Vec<&str> = several.iter().map(|it| it.name.as_str()).collect();
            Err(Failure::Usage(format!("several CAN interfaces: {}; name one", names.join(", "))))
        }
    }
}

/// Whether two arguments mean one bus: every device would be there twice, and we would talk to
/// ourselves.
fn is_same(bus: &BusSpec, other: &BusSpec) -> bool {
    match (bus, other) {
        // However fast, there is one adapter.
        (BusSpec::Slcan(slcan), BusSpec::Slcan(other)) => slcan.device == other.device,
        // Each is simulated by itself.
        (BusSpec::Sim(_), _) => false,
        _ => bus == other,
    }
}

/// The clock of a session: logs keep the pace and the dates of their recording.
pub fn clock(buses: &[BusSpec], speed: f64) -> Result<Clock, Failure> {
    let log = buses.iter().find_map(|bus| match bus {
        BusSpec::File(path) => Some(path),
        _ => None,
    });
    // Beside a bus that is there a log runs as that does, now.
    if !buses.iter().all(is_log) {
        return Ok(Clock::start());
    }
    let epoch = match log {
        Some(path) => epoch_of(path)?,
        None => Clock::start().epoch(),
    };
    Ok(Clock::replaying(epoch, speed))
}

/// The log among the buses, where there is one: then it is the only one. `from` needs a log.
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

/// Whether a bus is a recording: nothing can be sent on it.
pub fn is_log(bus: &BusSpec) -> bool {
    matches!(bus, BusSpec::File(_) | BusSpec::Stdin)
}

fn epoch_of(path: &Path) -> Result<Epoch, Failure> {
    let unusable = |error: io::Error| {
        Failure::Unusable(format!("file:{} cannot be read: {error}", path.display()))
    };
    let log = bus::open_log(path).map_err(unusable)?;
    if !log.metadata().map_err(unusable)?.is_file() {
        return Ok(Clock::start().epoch());
    }
    let mut reader = crate::log::LogReader::new(BufReader::new(log));
    reader.next_frame().map_err(unusable)?;
    Ok(reader.tally().epoch.unwrap_or_default())
}

/// Opens the buses and joins them with the app.
pub fn session(
    buses: &[BusSpec],
    setup: &Setup,
    clock: Clock,
    options: AppOptions,
) -> Result<Session, Failure> {
    // A log may run for long before the last bus is open.
    let start = clock.now();
    let mut ports: Vec<Port> = Vec::new();
    let mut named = Vec::new();
    for (index, spec) in buses.iter().enumerate() {
        let listen_only = setup.config.listen_only || is_log(spec);
        let index = BusIndex(index as u8);
        let options = Options { listen_only, only: setup.only.clone() };
        let port = bus::open(spec, index, clock.clone(), options)
            .map_err(|error| Failure::Unusable(error.to_string()))?;
        named.push((port.name().to_owned(), Config { listen_only, ..setup.config.clone() }));
        ports.push(port);
    }
    let options = AppOptions {
        epoch: clock.epoch(),
        buses: named,
        file_path: Some(setup.file.clone()),
        ..options
    };
    let app = App::new(start, options);
    let mut session = Session::new(app, clock, ports, Some(Store::new(&setup.file)));
    if let Some(recorder) = setup.recorder()? {
        session.record(recorder);
    }
    Ok(session)
}

/// Says on standard error what was recorded.
pub fn report_recording(status: Option<RecordingStatus>) {
    if let Some(status) = status {
        let _ = writeln!(io::stderr(), "descan: recorded {status}");
    }
}

/// How far the wall clock is ahead of UTC; 0 where the system does not say. To be asked before
/// there are threads.
pub fn utc_offset_seconds() -> i32 {
    time::UtcOffset::current_local_offset().map_or(0, time::UtcOffset::whole_seconds)
}
