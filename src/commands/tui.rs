//! `descan [BUS…]` and `descan demo`: the terminal UI, on real and on simulated buses.

use super::open::{self, Setup};
use super::{EXIT_INTERRUPTED, EXIT_OK, EXIT_UNUSABLE, EXIT_USAGE, Failure, headless, output};
use crate::app::{App, AppOptions, Bus, BusChoice, BusOffer, BusSelection, COLOURLESS_THEME};
use crate::bus::{self, BusSpec, Clock, Options};
use crate::cli::{CommonArgs, ScreenArgs, SessionArgs as Arguments};
use crate::finding::{Finding, FindingState};
use crate::frame::BusIndex;
use crate::shell::bus_picker::PickerExit;
use crate::shell::bus_scout::BusScout;
use crate::shell::catalogue_folders::CatalogueFolders;
use crate::shell::config::ConfigFolder;
use crate::shell::frame_templates::frame_templates;
use crate::shell::paint_pace::SCREEN_BUDGET;
use crate::shell::recent_frames::recent_frames;
use crate::shell::recent_logs::{remember_contents, remember_log};
use crate::shell::session::Session;
use crate::shell::tui_loop::{self, LoopSettings, ThemeLoader, TuiExit};
use crate::shell::waiting::block_on;
use crate::shell::{bus_offers, bus_picker, recovery, stop, terminal};
use crate::sim::Scenario;
use crate::status::Link;
use crate::text::{counted, printable_path};
use anyhow::Context;
use jiff::tz::TimeZone;
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::future::poll_fn;
use std::io::IsTerminal;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::sync::Arc;
use std::task::Poll;
use std::thread;
use std::time::Duration;

/// Longest time to finish a save after a signal or a closed terminal. The program ends within a
/// second; the rest of it is for the copy of edits that are not saved by then.
const SAVE_TIMEOUT: Duration = Duration::from_millis(600);

/// `descan [BUS…]`.
pub fn ui(arguments: &Arguments, speed: Option<f64>, screen: &ScreenArgs) -> Result<u8, Failure> {
    let has_terminal = std::io::stdout().is_terminal();
    let mut arguments = arguments.clone();
    if arguments.buses.is_empty() && has_terminal {
        arguments.buses = super::project::buses(&arguments.common)?;
    }
    let arguments = &arguments;
    if arguments.buses.is_empty() && !has_terminal {
        return list_without_terminal();
    }
    let chooser = || Chooser::new(&arguments.common, &arguments.buses, screen);
    if arguments.buses.is_empty() && std::io::stdin().is_terminal() {
        if speed.is_some() {
            let why = "--speed needs a log: descan file:LOG --speed 10";
            return Err(Failure::Usage(why.to_owned()));
        }
        let interfaces = bus::interfaces();
        let mut up = interfaces.iter().filter(|interface| interface.up);
        let (Some(only), None) = (up.next(), up.next()) else {
            // The only one is waited for, as if it were named.
            if let [down] = &interfaces[..]
                && let Some(choice) = unusable(&[BusSpec::SocketCan(down.name.clone())])
            {
                return chooser()?.choose(choice);
            }
            let reason = match interfaces.len() {
                0 => "no CAN interface found",
                _ => "not exactly one CAN interface is up",
            };
            return chooser()?.choose(BusChoice::new(reason, Vec::new()));
        };
        let only = BusSpec::SocketCan(only.name.clone());
        return chooser()?.show_all(&[only], speed);
    }
    // A mistyped command is reported before the missing terminal.
    let buses = open::buses(arguments)?;
    match unusable(&buses) {
        Some(_) if !has_terminal => list_without_terminal(),
        Some(choice) => chooser()?.choose(choice),
        None => {
            needs_terminal()?;
            chooser()?.show_all(&buses, speed)
        }
    }
}

/// Prints the list of buses, and that the screen needs a terminal.
fn list_without_terminal() -> Result<u8, Failure> {
    // The message and the exit code are those of a missing terminal, also where nothing can be printed.
    let _ = output::print(&text_of(&bus_offers::offers()));
    needs_terminal().map(|()| EXIT_USAGE)
}

/// Returns the list that waits for the interfaces of the command line, if none of them can be used.
fn unusable(buses: &[BusSpec]) -> Option<BusChoice> {
    let mut awaited = Vec::new();
    let mut causes = Vec::new();
    let mut remedy = None;
    for bus in buses {
        let BusSpec::SocketCan(name) = bus else { return None };
        let options = Options { listen_only: true, ..Options::default() };
        // Its status is known at once.
        let port = bus::open(bus, BusIndex(0), Clock::start(), options).ok()?;
        let status = port.queue().status();
        if !matches!(status.link, Link::Down | Link::Missing | Link::NoKernel) {
            return None;
        }
        let fault = status.fault?;
        // The line of an interface that is down has its command.
        remedy = remedy.or(fault.remedy().filter(|_| status.link != Link::Down).map(str::to_owned));
        if !causes.iter().any(|cause| cause == fault.cause()) {
            causes.push(fault.cause().to_owned());
        }
        awaited.push(name.clone());
    }
    if awaited.is_empty() {
        return None;
    }
    let way_out = remedy.unwrap_or_else(|| "it opens when it is up".to_owned());
    let note = format!("waiting for {}: {way_out}", awaited.join(", "));
    let reason = format!("{}: waiting for it", causes.join(", "));
    let mut choice = BusChoice::new(reason, Vec::new()).waiting_for(awaited);
    choice.show(note);
    Some(choice)
}

/// The list of buses as text, where there is no terminal.
fn text_of(offers: &[BusOffer]) -> String {
    let mut text = String::new();
    let mut section = None;
    for offer in offers {
        if section.replace(offer.kind) != Some(offer.kind) {
            let _ = writeln!(text, "{}", offer.kind.title());
        }
        let command = offer.command.as_deref().map(|it| format!("  {it}")).unwrap_or_default();
        let _ = writeln!(text, "  {:<32} {}{command}", offer.argument, offer.facts);
    }
    text
}

/// Buses on the screen, one session after another, as they are chosen.
struct Chooser<'a> {
    screen: &'a ScreenArgs,
    /// The settings and arguments, whatever was chosen.
    setup: Setup,
    settings: LoopSettings,
}

impl<'a> Chooser<'a> {
    fn new(
        common: &CommonArgs,
        buses: &[BusSpec],
        screen: &'a ScreenArgs,
    ) -> Result<Self, Failure> {
        let setup = Setup::for_buses(common, buses)?;
        let screen_budget = setup.screen_budget.unwrap_or(SCREEN_BUDGET);
        let settings = LoopSettings { profile: Arc::clone(&setup.config.profile), screen_budget };
        terminal::restore_on_panic();
        stop::exit_if_stuck(EXIT_INTERRUPTED, terminal::restore).context("no signals")?;
        Ok(Self { screen, setup, settings })
    }

    /// Shows the list of buses, then those that the user chooses.
    fn choose(&self, choice: BusChoice) -> Result<u8, Failure> {
        let mut choice = choice.with_keymap(self.setup.keymap.clone());
        choice.handle_offers(bus_offers::offers());
        let wanted = self.screen.theme.as_deref().or(self.setup.theme.as_deref());
        let mut themes =
            ThemeLoader::new(self.setup.folder.clone(), wanted.unwrap_or(usual_theme()))
                .or_else(|_| ThemeLoader::new(None, usual_theme()))
                .map_err(Failure::Usage)?;
        let signs = self.setup.signs.unwrap_or_else(terminal::signs);
        let runtime = headless::runtime()?;
        let exit = block_on(&runtime, async {
            let scout = BusScout::spawn(Arc::clone(&self.settings.profile), Vec::new())?;
            bus_picker::choose(choice, scout, &mut themes, signs).await
        });
        runtime.shutdown_background();
        match exit.context("the terminal")? {
            PickerExit::Open(wanted) => {
                self.keep_theme(&wanted);
                self.show_chosen(&wanted)
            }
            PickerExit::Quit => Ok(EXIT_OK),
            PickerExit::Interrupted => Ok(EXIT_INTERRUPTED),
        }
    }

    /// Keeps a theme that was chosen in the list, as the theme picker does.
    fn keep_theme(&self, wanted: &BusSelection) {
        if let (Some(theme), Some(folder)) = (&wanted.theme, &self.setup.folder)
            && let Err(why) = folder.keep_theme(theme)
        {
            output::warn(format_args!("theme {theme} is not kept: {why}"));
        }
    }

    fn show_chosen(&self, wanted: &BusSelection) -> Result<u8, Failure> {
        let mut setup = self.setup.for_selection(wanted);
        let parse = |bus: &String| bus.parse().map_err(Failure::from);
        if wanted.profile.is_some() {
            setup.profile.clone_from(&wanted.profile);
        }
        if let Err(why) = setup.read_profile() {
            setup.warnings.push(format!("{why}; the profile before stays in force"));
        }
        let shown = wanted.buses.iter().map(parse).collect::<Result<Vec<BusSpec>, Failure>>();
        let result = shown.and_then(|buses| {
            setup.choose_files(&buses);
            show(&buses, None, &setup, self)
        });
        match result {
            // A log that was deleted, a scenario with a mistake.
            Err(Failure::Unusable(why) | Failure::Usage(why)) => {
                self.choose(BusChoice::new(why, Vec::new()))
            }
            shown => self.go_on(shown?),
        }
    }

    /// Shows the buses of the command line, then those that the user chooses.
    fn show_all(&self, buses: &[BusSpec], speed: Option<f64>) -> Result<u8, Failure> {
        open::check_speed(speed, buses)?;
        self.go_on(show(buses, speed, &self.setup, self)?)
    }

    fn go_on(&self, ending: Ending) -> Result<u8, Failure> {
        match ending {
            Ending::Over(code) => Ok(code),
            Ending::Reopen(wanted) => self.show_chosen(&wanted),
        }
    }
}

/// How a session on the screen ended.
enum Ending {
    /// With an exit code.
    Over(u8),
    /// Other buses were chosen.
    Reopen(BusSelection),
}

/// `descan demo`: a simulated bus, and a des.json of its own in a temporary folder.
pub fn demo(system: &str, common: &CommonArgs, screen: &ScreenArgs) -> Result<u8, Failure> {
    needs_terminal()?;
    let common = &CommonArgs { no_project: true, project: None, ..common.clone() };
    let mut chooser = Chooser::new(common, &[], screen)?;
    if common.profile.is_none() {
        // Its devices are known: their numbers are given.
        let scenario = Scenario::builtin(system).context("the demo's scenario")?;
        chooser.setup.config.profile = Arc::new(scenario.profile);
    }
    let buses = [BusSpec::Sim(system.to_owned())];
    if common.file.is_some() {
        return chooser.show_all(&buses, None);
    }
    let folder = tempfile::Builder::new()
        .prefix("descan-demo-")
        .tempdir()
        .context("no temporary folder for the demo's des.json")?;
    let file = folder.path().join("des.json");
    chooser.setup.file.clone_from(&file);
    std::fs::write(&file, example(system)).context("the demo's des.json")?;
    if common.catalogue.is_empty() && system == "boiler" {
        let devices = folder.path().join("devices");
        std::fs::create_dir(&devices).context("the demo's catalogue")?;
        for (name, text) in DEMO_CATALOGUE {
            std::fs::write(devices.join(name), text).context("the demo's catalogue")?;
        }
        chooser.setup.read_catalogue(CatalogueFolders::beside(&[&file], true));
    }
    let code = chooser.show_all(&buses, None)?;
    // An edited file is kept; otherwise the folder is deleted.
    let edited = std::fs::read(&file).is_ok_and(|now| now != example(system).as_bytes());
    if edited {
        let kept = folder.keep().join("des.json");
        // The terminal may be gone.
        let _ = output::print(&format!("The demo's des.json is kept: {}\n", printable_path(&kept)));
    }
    Ok(code)
}

/// The demo's des.json: static addresses as planned before the devices exist.
fn example(system: &str) -> &'static str {
    match system {
        "drone" => include_str!("demo/drone.json"),
        _ => include_str!("demo/boiler.json"),
    }
}

/// Types of the devices of the boiler.
const DEMO_CATALOGUE: [(&str, &str); 3] = [
    ("common.toml", include_str!("../../tests/project/devices/common.toml")),
    ("feeder.toml", include_str!("../../tests/project/devices/feeder.toml")),
    ("sensor.toml", include_str!("../../tests/project/devices/sensor.toml")),
];

fn needs_terminal() -> Result<(), Failure> {
    if std::io::stdout().is_terminal() {
        return Ok(());
    }
    let message = "the UI needs a terminal; without one use descan scan or descan watch";
    Err(Failure::Usage(message.to_owned()))
}

/// Reads the theme: the named one, that of the settings, or the usual one.
///
/// # Errors
/// The named one cannot be used; another one is a warning.
pub fn themes(
    folder: Option<&ConfigFolder>,
    named: Option<&str>,
    of_settings: Option<&str>,
    warnings: &mut Vec<String>,
) -> Result<ThemeLoader, Failure> {
    let usual = usual_theme();
    let wanted = named.or(of_settings).unwrap_or(usual);
    match ThemeLoader::new(folder.cloned(), wanted) {
        // A theme from the settings does not prevent the start.
        Err(why) if named.is_none() => {
            open::warn::<()>(warnings, &format!("theme {wanted}: {why}"));
            // The user's own theme may have that name; without the folder it is built-in.
            let themes = ThemeLoader::new(folder.cloned(), usual);
            let themes = themes.or_else(|_| ThemeLoader::new(None, usual));
            themes.map_err(|why| Failure::Usage(format!("theme {usual}: {why}")))
        }
        themes => themes.map_err(|why| Failure::Usage(format!("theme {wanted}: {why}"))),
    }
}

/// Name of the theme, unless one is given.
fn usual_theme() -> &'static str {
    if tui_loop::no_colour() { COLOURLESS_THEME } else { "terminal" }
}

/// Shows the buses.
fn show(
    buses: &[BusSpec],
    speed: Option<f64>,
    setup: &Setup,
    chooser: &Chooser,
) -> Result<Ending, Failure> {
    let clock = open::clock(buses, speed.unwrap_or(1.0))?;
    // Those that are logs.
    for bus in buses {
        if let BusSpec::File(path) = bus {
            remember_log(path);
        }
    }
    let screen = chooser.screen;
    let theme = setup.chosen_theme.as_deref().or(screen.theme.as_deref());
    let mut warnings = setup.warnings.clone();
    let own = setup.theme.as_deref();
    let mut themes = self::themes(setup.folder.as_ref(), theme, own, &mut warnings)?;
    let saved_filters = setup.folder.as_ref().map_or(Ok(Vec::new()), ConfigFolder::saved_filters);
    let saved_filters = saved_filters.unwrap_or_else(|why| open::warn(&mut warnings, &why));
    let options = AppOptions {
        saved_filters,
        recent_frames: recent_frames(),
        templates: frame_templates(),
        keymap: setup.keymap.clone(),
        theme: themes.current.name.clone(),
        themes: themes.names(),
        signs: setup.signs.unwrap_or_else(terminal::signs),
        theme_faults: themes.faults(),
        time_zone: Some(TimeZone::system()),
        warnings,
        capture_room: usize::try_from(screen.capture.0).ok(),
        learns_profile: true,
        ..AppOptions::default()
    };
    let runtime = headless::runtime()?;
    let result = block_on(&runtime, async {
        let mut session = open::session(buses, setup, clock, options)?;
        let add =
            |session: &mut Session, wanted: &BusSelection| open::add_buses(session, setup, wanted);
        let ui = tui_loop::run(&mut session, &mut themes, &chooser.settings, &add);
        let ending = match catch_panic(ui).await {
            Ok(ending) => ending.context("the terminal"),
            Err(panic) => {
                save_edits_at_risk(&session);
                resume_unwind(panic);
            }
        };
        // The user quits with unsaved edits only if they are not to be waited for.
        let gives_up = matches!(ending, Ok(TuiExit::Quit)) && session.app.unsaved_edits() > 0;
        let is_asked_to_end = !matches!(ending, Ok(TuiExit::Quit | TuiExit::Reopen(_)));
        session.finish_work(!gives_up, is_asked_to_end.then_some(SAVE_TIMEOUT)).await;
        open::report_recording(session.finish_recording());
        remember_logs(buses, &session.app);
        let is_lost = save_edits_at_risk(&session);
        Ok::<_, Failure>((ending?, is_lost))
    });
    // Not dropped, which would wait for all blocking work.
    runtime.shutdown_background();
    Ok(match result? {
        (TuiExit::Quit, false) => Ending::Over(EXIT_OK),
        (TuiExit::Quit | TuiExit::Reopen(_), true) => Ending::Over(EXIT_UNUSABLE),
        (TuiExit::Reopen(wanted), false) => {
            let theme = Some(themes.current.name.clone());
            let profile = wanted.profile.clone().or_else(|| setup.profile.clone());
            Ending::Reopen(BusSelection { theme, profile, ..wanted })
        }
        (TuiExit::Terminated | TuiExit::Hangup, _) => Ending::Over(EXIT_INTERRUPTED),
    })
}

/// Remembers for the list of buses what was found in logs that were read to their ends.
fn remember_logs(specs: &[BusSpec], app: &App) {
    let all = app.buses();
    for (at, spec) in specs.iter().enumerate() {
        // All interfaces of a single log; of several, those after the first have no fixed places.
        let own = if specs.len() == 1 { all } else { all.get(at..=at).unwrap_or_default() };
        let is_whole = own.iter().all(|bus| bus.status.link == Link::Ended) && !own.is_empty();
        let BusSpec::File(path) = spec else { continue };
        if is_whole && all.len() == own.len().max(specs.len()) {
            remember_contents(path, &contents(own));
        }
    }
}

/// The devices of buses, and their conflicts: `9 devices, 2 conflicts`.
fn contents(buses: &[Bus]) -> String {
    let devices = buses.iter().flat_map(Bus::devices).filter(|device| !device.is_debug).count();
    let is_conflict = |finding: &&Finding| {
        finding.key.kind.is_conflict() && finding.state == FindingState::Confirmed
    };
    // One address may be the subject of several findings.
    let conflicts = |bus: &Bus| {
        let confirmed = bus.findings().iter().filter(is_conflict);
        confirmed.flat_map(|finding| &finding.addresses).collect::<BTreeSet<_>>().len()
    };
    let conflicts: usize = buses.iter().map(conflicts).sum();
    let devices = counted(devices as u64, "device");
    if conflicts == 0 {
        devices
    } else {
        format!("{devices}, {}", counted(conflicts as u64, "conflict"))
    }
}

/// Returns the output of a future, or the cause of its panic.
async fn catch_panic<F: Future>(future: F) -> thread::Result<F::Output> {
    let mut future = pin!(future);
    poll_fn(|context| {
        let poll = catch_unwind(AssertUnwindSafe(|| future.as_mut().poll(context)));
        poll.map_or_else(|panic| Poll::Ready(Err(panic)), |poll| poll.map(Ok))
    })
    .await
}

/// Writes and reports recovery copies of edits that would be lost; returns true if there are any.
fn save_edits_at_risk(session: &Session) -> bool {
    let edits = session.app.edits_at_risk();
    for (file, count, document) in &edits {
        let path = session.app.file_at(*file).path().unwrap_or(Path::new(""));
        report_recovery_copy(path, *count, recovery::save_recovery_copy(document.source()));
    }
    !edits.is_empty()
}

/// Prints on standard error what was not saved, and the path of its recovery copy.
fn report_recovery_copy(file: &Path, count: usize, kept: std::io::Result<PathBuf>) {
    let (file, edits) = (printable_path(file), counted(count as u64, "edit"));
    let not_saved = format!("{edits} of {file} not saved");
    match kept {
        Ok(copy) => {
            output::warn(format_args!(
                "{not_saved}; a copy with all edits is {}",
                printable_path(&copy)
            ));
        }
        Err(why) => output::warn(format_args!("{not_saved}, and a copy cannot be written: {why}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panic_of_a_future_is_returned_after_it_was_pending() {
        let runtime = headless::runtime().unwrap();
        assert_eq!(block_on(&runtime, catch_panic(async { 7 })).unwrap(), 7);
        let panics = async {
            tokio::task::yield_now().await;
            resume_unwind(Box::new("a bug"));
        };
        let cause = block_on(&runtime, catch_panic(panics)).unwrap_err();
        assert_eq!(cause.downcast_ref(), Some(&"a bug"));
    }
}
