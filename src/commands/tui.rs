//! `descan [BUS…]` and `descan demo`: the terminal UI, on real and on simulated buses.

use super::open::{self, Setup};
use super::report::counted;
use super::{EXIT_INTERRUPTED, EXIT_OK, EXIT_UNUSABLE, Failure, headless, output};
use crate::app::{AppOptions, BusChoice, COLOURLESS_THEME, ChoiceOutcome};
use crate::bus::{self, BusSpec, Clock};
use crate::cli::{CommonArgs, ScreenArgs, SessionArgs as Arguments};
use crate::regular_file::shown;
use crate::shell::config::ConfigFolder;
use crate::shell::session::Session;
use crate::shell::tui_loop::{self, ThemeLoader, TuiExit};
use crate::shell::{bus_picker, recovery, stop, terminal};
use anyhow::Context;
use std::future::poll_fn;
use std::io::IsTerminal;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::task::Poll;
use std::thread;
use std::time::Duration;

/// Longest time to finish a save after a signal or a closed terminal. The program ends within a
/// second; the rest of it is for the copy of edits that are not saved by then.
const SAVE_TIMEOUT: Duration = Duration::from_millis(600);

/// `descan [BUS…]`.
pub fn ui(arguments: &Arguments, speed: Option<f64>, screen: &ScreenArgs) -> Result<u8, Failure> {
    let has_terminal = std::io::stdout().is_terminal() && std::io::stdin().is_terminal();
    if arguments.buses.is_empty() && has_terminal {
        let interfaces = bus::interfaces();
        let mut up = interfaces.iter().filter(|interface| interface.up);
        let (Some(only), None) = (up.next(), up.next()) else {
            return choose(arguments, speed, screen);
        };
        let setup = Setup::new(&arguments.common)?;
        return open_and_show(&[BusSpec::SocketCan(only.name.clone())], &setup, speed, screen);
    }
    let buses = open::buses(arguments);
    if arguments.buses.is_empty() {
        needs_terminal()?;
    }
    // A mistyped command is reported before the missing terminal.
    let buses = buses?;
    needs_terminal()?;
    let setup = Setup::new(&arguments.common)?;
    open_and_show(&buses, &setup, speed, screen)
}

/// Shows the list of buses, then those that the user chooses.
fn choose(arguments: &Arguments, speed: Option<f64>, screen: &ScreenArgs) -> Result<u8, Failure> {
    let mut setup = Setup::new(&arguments.common)?;
    let reason = match bus::interfaces().len() {
        0 => "no CAN interface found",
        _ => "not exactly one CAN interface is up",
    };
    let choice = BusChoice::new(reason, bus_picker::offers());
    let wanted = screen.theme.as_deref().or(setup.theme.as_deref()).unwrap_or(usual_theme());
    let themes = ThemeLoader::new(setup.folder.clone(), wanted)
        .or_else(|_| ThemeLoader::new(None, usual_theme()))
        .map_err(Failure::Usage)?;
    let signs = setup.signs.unwrap_or_else(terminal::signs);
    terminal::restore_on_panic();
    let runtime = headless::runtime()?;
    let chosen = runtime.block_on(bus_picker::choose(choice, &themes.current, signs));
    runtime.shutdown_background();
    let Some(ChoiceOutcome::Open { buses, listen_only }) = chosen.context("the terminal")? else {
        return Ok(EXIT_OK);
    };
    let parse = |bus: &String| bus.parse().map_err(Failure::from);
    let buses = buses.iter().map(parse).collect::<Result<Vec<BusSpec>, Failure>>()?;
    setup.config.listen_only |= listen_only;
    open_and_show(&buses, &setup, speed, screen)
}

fn open_and_show(
    buses: &[BusSpec],
    setup: &Setup,
    speed: Option<f64>,
    screen: &ScreenArgs,
) -> Result<u8, Failure> {
    open::check_speed(speed, buses)?;
    for bus in buses {
        if let BusSpec::File(path) = bus {
            bus_picker::remember_log(path);
        }
    }
    let clock = open::clock(buses, speed.unwrap_or(1.0))?;
    show(buses, setup, clock, screen)
}

/// `descan demo`: a simulated bus, and a des.json of its own in a temporary folder.
pub fn demo(system: &str, common: &CommonArgs, screen: &ScreenArgs) -> Result<u8, Failure> {
    needs_terminal()?;
    let mut setup = Setup::new(common)?;
    let buses = [BusSpec::Sim(system.to_owned())];
    if common.file.is_some() {
        return show(&buses, &setup, Clock::start(), screen);
    }
    let folder = tempfile::Builder::new()
        .prefix("descan-demo-")
        .tempdir()
        .context("no temporary folder for the demo's des.json")?;
    setup.file = folder.path().join("des.json");
    std::fs::write(&setup.file, example(system)).context("the demo's des.json")?;
    let code = show(&buses, &setup, Clock::start(), screen)?;
    // An edited file is kept; otherwise the folder is deleted.
    let edited = std::fs::read(&setup.file).is_ok_and(|now| now != example(system).as_bytes());
    if edited {
        let kept = folder.keep().join("des.json");
        // The terminal may be gone.
        let _ = output::print(&format!("The demo's des.json is kept: {}\n", shown(&kept)));
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

fn needs_terminal() -> Result<(), Failure> {
    if std::io::stdout().is_terminal() {
        return Ok(());
    }
    let message = "the UI needs a terminal; without one use descan scan or descan watch";
    Err(Failure::Usage(message.to_owned()))
}

/// Name of the theme, unless one is given.
fn usual_theme() -> &'static str {
    let colourless = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    if colourless { COLOURLESS_THEME } else { "terminal" }
}

/// Shows the buses.
fn show(
    buses: &[BusSpec],
    setup: &Setup,
    clock: Clock,
    screen: &ScreenArgs,
) -> Result<u8, Failure> {
    let usual = usual_theme();
    let theme = screen.theme.as_deref();
    let mut wanted = theme.or(setup.theme.as_deref()).unwrap_or(usual);
    let mut warnings = setup.warnings.clone();
    let mut themes = match ThemeLoader::new(setup.folder.clone(), wanted) {
        // A theme from the settings does not prevent the start.
        Err(why) if theme.is_none() => {
            open::warn::<()>(&mut warnings, &format!("theme {wanted}: {why}"));
            wanted = usual;
            // The user's own theme may have that name; without the folder it is built-in.
            ThemeLoader::new(setup.folder.clone(), usual).or_else(|_| ThemeLoader::new(None, usual))
        }
        themes => themes,
    }
    .map_err(|why| Failure::Usage(format!("theme {wanted}: {why}")))?;
    let saved_filters = setup.folder.as_ref().map_or(Ok(Vec::new()), ConfigFolder::saved_filters);
    let saved_filters = saved_filters.unwrap_or_else(|why| open::warn(&mut warnings, &why));
    let options = AppOptions {
        saved_filters,
        keymap: setup.keymap.clone(),
        theme: wanted.to_owned(),
        themes: themes.names(),
        signs: setup.signs.unwrap_or_else(terminal::signs),
        theme_faults: themes.faults(),
        utc_offset_seconds: open::utc_offset_seconds(),
        warnings,
        capture_room: usize::try_from(screen.capture.0).ok(),
        ..AppOptions::default()
    };
    terminal::restore_on_panic();
    stop::exit_if_stuck(EXIT_INTERRUPTED, terminal::restore).context("no signals")?;
    let runtime = headless::runtime()?;
    let result = runtime.block_on(async {
        let mut session = open::session(buses, setup, clock, options)?;
        let ending = match catch_panic(tui_loop::run(&mut session, &mut themes)).await {
            Ok(ending) => ending.context("the terminal"),
            Err(panic) => {
                save_edits_at_risk(&session, &setup.file);
                resume_unwind(panic);
            }
        };
        // The user quits with unsaved edits only if they are not to be waited for.
        let gives_up = matches!(ending, Ok(TuiExit::Quit)) && session.app.file().unsaved() > 0;
        let is_asked_to_end = !matches!(ending, Ok(TuiExit::Quit));
        session.finish_work(!gives_up, is_asked_to_end.then_some(SAVE_TIMEOUT)).await;
        open::report_recording(session.finish_recording());
        let is_lost = save_edits_at_risk(&session, &setup.file);
        Ok::<_, Failure>((ending?, is_lost))
    });
    // Not dropped, which would wait for all blocking work.
    runtime.shutdown_background();
    Ok(match result? {
        (TuiExit::Quit, false) => EXIT_OK,
        (TuiExit::Quit, true) => EXIT_UNUSABLE,
        (TuiExit::Terminated | TuiExit::Hangup, _) => EXIT_INTERRUPTED,
    })
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

/// Writes and reports a recovery copy of edits that would be lost; returns true if there are any.
fn save_edits_at_risk(session: &Session, file: &Path) -> bool {
    let edits = session.app.edits_at_risk();
    if let Some((count, document)) = &edits {
        report_recovery_copy(file, *count, recovery::save_recovery_copy(document.source()));
    }
    edits.is_some()
}

/// Prints on standard error what was not saved, and the path of its recovery copy.
fn report_recovery_copy(file: &Path, count: usize, kept: std::io::Result<PathBuf>) {
    let (file, edits) = (shown(file), counted(count as u64, "edit"));
    let not_saved = format!("{edits} of {file} not saved");
    match kept {
        Ok(copy) => {
            output::warn(format_args!("{not_saved}; a copy with all edits is {}", shown(&copy)));
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
        assert_eq!(runtime.block_on(catch_panic(async { 7 })).unwrap(), 7);
        let panics = async {
            tokio::task::yield_now().await;
            resume_unwind(Box::new("a bug"));
        };
        let cause = runtime.block_on(catch_panic(panics)).unwrap_err();
        assert_eq!(cause.downcast_ref(), Some(&"a bug"));
    }
}
