//! `descan scan`: one enumeration, as tables or JSON. On a live bus it ends when every request is
//! complete or failed; a log is read at once, in log time.

use super::gate::BusGate;
use super::gate::require_valid_file;
use super::headless::{self, Limits, RunInput, RunOutcome, warn_all_tx_blocked, warn_foreign};
use super::open::{self, Setup};
use super::report::ScanReport;
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure, output};
use crate::app::{App, AppOptions, Bus, Scope};
use crate::bus::BusSpec;
use crate::cli::ScanArgs;
use crate::diagnostic::Diagnostic;
use crate::discovery::{Device, DiscoveryProgress};
use crate::document::{Document, Operation};
use crate::shell::log_input::LogPace;
use crate::shell::stop::StopReason;
use crate::shell::store::{Store, write_new};
use crate::status::Link;
use crate::text::{counted, printable_path};
use crate::time::Instant;
use std::io::{self, IsTerminal, Write};
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Duration;

/// Runs it.
pub fn run(scan: &ScanArgs) -> Result<u8, Failure> {
    if let Some(path) = &scan.write {
        Store::new(path).check_new().map_err(|fault| fault.of(printable_path(path)))?;
    }
    let buses = open::buses(&scan.run.session)?;
    let setup = Setup::for_buses(&scan.run.session.common, &buses)?;
    let log = open::log(&buses, "scan", scan.run.from)?;
    if scan.stay.is_some() && log.is_some() {
        return Err(Failure::Usage("--for needs a live bus; for a log use --time".to_owned()));
    }
    let RunOutcome { app, now, ending, recording } = if let Some(log) = log {
        read_log(log, (scan.run.from, scan.run.time), &setup, |_| Ok(()))?
    } else {
        let time = scan.stay.or(scan.run.time).unwrap_or(DEFAULT_TIME);
        let enough = |app: &App| scan.expect.is_none_or(|count| named_devices(app) >= count);
        look(&buses, &setup, time, |app, _| Ok(scan.stay.is_none() && enough(app)))?
    };
    if ending == Some(StopReason::Interrupted) {
        return Ok(EXIT_INTERRUPTED);
    }
    if !app.buses().iter().all(|bus| bus.ended.is_some()) {
        warn_incomplete(&app, ending);
    }
    warn_all_tx_blocked(&app, now);
    warn_foreign(&app, &mut Vec::new());
    let report = ScanReport::new(&app, now, Scope::Screen);
    report.print(scan.run.json, ScanReport::tables)?;
    if let Some(path) = &scan.write {
        write_document(&app, path)?;
    }
    recording?;
    require_valid_file(&app)?;
    let is_short = is_short_of(scan.expect, named_devices(&app));
    Ok(if report.has_findings() || is_short { EXIT_FINDINGS } else { EXIT_OK })
}

/// Number of present devices with a known name, debug devices left out.
fn named_devices(app: &App) -> usize {
    let counts =
        |device: &&Device| device.is_present() && device.name.is_some() && !device.is_debug;
    app.buses().iter().flat_map(Bus::devices).filter(counts).count()
}

/// Returns true if fewer devices than expected are present, and prints that on standard error.
fn is_short_of(expected: Option<usize>, found: usize) -> bool {
    let Some(expected) = expected.filter(|expected| found < *expected) else { return false };
    let devices = counted(expected as u64, "device");
    output::warn(format_args!(
        "expected {devices}, {found} present and named; check power and wiring, or use a longer \
         --time"
    ));
    true
}

/// `--time` of a live bus, unless given.
pub const DEFAULT_TIME: Duration = Duration::from_secs(15);

/// Reads a log at once: the part that begins `from` after its first frame and lasts `time`.
/// `check` is called after each batch.
pub fn read_log(
    log: &BusSpec,
    (from, time): (Option<Duration>, Option<Duration>),
    setup: &Setup,
    check: impl Fn(&App) -> Result<(), Failure>,
) -> Result<RunOutcome, Failure> {
    let limits = Limits { time, from, stuck: EXIT_INTERRUPTED, ..Limits::default() };
    let input = RunInput::Log(log, Some(LogPace::AtOnce));
    headless::run(input, setup, AppOptions::default(), limits, |session| {
        check(&session.app)?;
        Ok(ControlFlow::Continue(()))
    })
}

/// One enumeration of live buses, until they are settled and `enough` returns true, at most for
/// `time`.
///
/// # Errors
/// A bus cannot be used, or `enough` failed.
pub fn look(
    buses: &[BusSpec],
    setup: &Setup,
    time: Duration,
    mut enough: impl FnMut(&App, Instant) -> Result<bool, Failure>,
) -> Result<RunOutcome, Failure> {
    let limits = Limits { time: Some(time), stuck: EXIT_INTERRUPTED, ..Limits::default() };
    let mut bar = Bar::new();
    let mut gate = BusGate::new(false);
    let input = RunInput::Buses(buses);
    let outcome = headless::run(input, setup, AppOptions::default(), limits, |session| {
        let is_open = gate.allows(&session.app, session.now())?;
        bar.show(&session.app, session.now(), time);
        let is_done = enough(&session.app, session.now())? && is_open && is_settled(&session.app);
        Ok(if is_done { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    })?;
    if outcome.ending != Some(StopReason::Interrupted) {
        gate.require_opened(&outcome.app)?;
    }
    Ok(outcome)
}

/// Returns true if all buses are open and every request on them has a response or failed.
pub fn is_settled(app: &App) -> bool {
    app.buses().iter().all(|bus| bus.status.link != Link::Opening && bus.progress().is_complete)
}

/// Prints on standard error why names or services are not known after [`look`].
pub fn warn_incomplete(app: &App, ending: Option<StopReason>) {
    let is_unknown = |device: &Device| device.is_present() && device.services.is_none();
    let mut reasons = Vec::new();
    for bus in app.buses() {
        let lacks_services = || bus.devices().iter().any(is_unknown);
        let why = match bus.config() {
            config if config.listen_only && lacks_services() => {
                "listen-only: no requests are sent; names come only from requests of other nodes"
            }
            config if !config.listen_only && !config.send_requests && lacks_services() => {
                "--no-scan: no requests are sent; names come only from requests of other nodes"
            }
            config if config.listen_only || !config.send_requests => continue,
            _ if ending == Some(StopReason::TimeUp) && !is_settled(app) => {
                "not all responses arrived in time; give it longer (--time, or --for)"
            }
            _ => continue,
        };
        if !reasons.contains(&why) {
            reasons.push(why);
            output::warn(why);
        }
    }
}

/// Progress line on standard error while scanning, if that is a terminal.
struct Bar {
    shown: bool,
    last: String,
}

impl Bar {
    fn new() -> Self {
        Self { shown: io::stderr().is_terminal(), last: String::new() }
    }

    fn show(&mut self, app: &App, now: Instant, limit: Duration) {
        const WIDTH: usize = 20;
        if !self.shown {
            return;
        }
        let mut sum = DiscoveryProgress::default();
        for bus in app.buses() {
            let progress = bus.progress();
            sum.present += progress.present;
            sum.named += progress.named;
            sum.with_services += progress.with_services;
        }
        // The known share of what was found; before that, the elapsed share of the time limit.
        let done = if sum.present > 0 {
            (sum.named + sum.with_services) as f64 / (2 * sum.present) as f64
        } else {
            now.as_secs_f64() / limit.as_secs_f64()
        };
        let filled = ((done * WIDTH as f64) as usize).min(WIDTH);
        let line = format!(
            "scanning [{}{}] {} devices, {} named, {} with services",
            "#".repeat(filled),
            "-".repeat(WIDTH - filled),
            sum.present,
            sum.named,
            sum.with_services
        );
        if line != self.last {
            output::show_progress(&line);
            self.last = line;
        }
    }

    fn clear(&mut self) {
        if !self.last.is_empty() {
            output::show_progress("");
            self.last.clear();
        }
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.clear();
    }
}

// --- a des.json with what was found -------------------------------------------------------

fn write_document(app: &App, path: &Path) -> Result<(), Failure> {
    let mut document = Document::empty();
    let mut count = 0;
    let mut left_out = Vec::new();
    for bus in app.buses() {
        let mut devices: Vec<&Device> = bus.devices().iter().filter(|it| !it.is_debug).collect();
        devices.sort_by_key(|device| device.address);
        for device in devices {
            let Some(mut entry) = app.new_entry(device).filter(|_| device.is_present()) else {
                let reason = if device.is_present() { "no name received" } else { "lost" };
                let several = app.buses().len() > 1;
                let bus = if several { format!("{} ", bus.name) } else { String::new() };
                left_out.push(format!("{bus}@{} ({reason})", device.address));
                continue;
            };
            // One file of all buses, also where they have their own.
            if app.buses().len() > 1 {
                entry.bus = Some(bus.name_without_rates().to_owned());
            }
            document = document
                .apply(&Operation::Add { entry })
                .map_err(|error| Diagnostic::new(error.to_string()).of(printable_path(path)))?;
            count += 1;
        }
    }
    if count > 0 {
        write_new(path, None, |file| file.write_all(document.source()))
            .map_err(|fault| fault.of(printable_path(path)))?;
    }
    let devices = if count == 1 { "device" } else { "devices" };
    let left_out = if left_out.is_empty() {
        String::new()
    } else {
        format!("; left out: {}", left_out.join(", "))
    };
    let path = printable_path(path);
    if count == 0 {
        output::say(format_args!("{path}: not written: no device with a name{left_out}"));
    } else {
        output::say(format_args!("{path}: {count} {devices} written{left_out}"));
    }
    Ok(())
}
