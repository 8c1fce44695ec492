//! `descan scan`: one enumeration, printed. On a live bus it ends when everything is known; a
//! log is read to its end as fast as it can be, by its own clock.

use super::open::{self, Setup, is_log};
use super::report::Report;
use super::{FINDINGS, FINE, Failure, INTERRUPTED};
use crate::app::{App, AppOptions};
use crate::bus::log::{LogReader, Tally};
use crate::bus::{self, BusSpec};
use crate::cli::Scan;
use crate::discovery::{Config, OwnAddress, Progress};
use crate::document::{Document, Operation};
use crate::frame::BusIndex;
use crate::shell::session::Session;
use crate::shell::store::Store;
use crate::status::Link;
use crate::time::Instant;
use anyhow::Context;
use std::io::{self, BufRead, BufReader, IsTerminal, Write};
use std::path::Path;
use tokio::signal::unix::{SignalKind, signal};

/// How long an interface may take to be looked at.
const OPENING: std::time::Duration = std::time::Duration::from_secs(2);

/// Runs it.
pub fn run(scan: &Scan) -> Result<u8, Failure> {
    if let Some(path) = &scan.write
        && path.symlink_metadata().is_ok()
    {
        return Err(Failure::Unusable(format!(
            "{} is there already and is not touched; name another file, or edit it in: descan",
            path.display()
        )));
    }
    let buses = open::buses(&scan.session)?;
    let setup = Setup::new(&scan.session.common)?;
    let (app, now, tally) = match &buses[..] {
        [log] if is_log(log) => read_log(log, &setup)?,
        _ if buses.iter().any(is_log) => {
            let message = "a log is scanned alone: descan scan file:LOG";
            return Err(Failure::Usage(message.to_owned()));
        }
        _ => match scan_live(&buses, &setup, scan)? {
            Some((app, now)) => (app, now, None),
            None => return Ok(INTERRUPTED),
        },
    };
    if let Some(tally) = tally
        && (tally.unreadable > 0 || tally.frames == 0)
    {
        let _ = writeln!(io::stderr(), "descan: {}: {tally}", buses[0]);
    }
    for bus in app.buses().iter().filter(|bus| bus.engine.is_unacknowledged()) {
        let _ = writeln!(
            io::stderr(),
            "descan: {}: nobody acknowledges our frames; is another node on, at the same bit rate, and are both \
             ends terminated?",
            bus.name
        );
    }
    for (index, bus) in app.buses().iter().enumerate() {
        if let OwnAddress::Blocked(wanted) = bus.engine.own_address()
            && let Some(why) = app.why_no_address(BusIndex(index as u8), wanted)
        {
            let _ = writeln!(io::stderr(), "descan: {}: {why}", bus.name);
        }
    }
    let report = Report::new(&app, now);
    let text = if scan.json { report.json() } else { report.tables() };
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes())?;
    out.flush()?;
    if let Some(path) = &scan.write {
        write_document(&app, path)?;
    }
    Ok(if report.has_findings() { FINDINGS } else { FINE })
}

// --- a log --------------------------------------------------------------------------------

fn read_log(spec: &BusSpec, setup: &Setup) -> Result<(App, Instant, Option<Tally>), Failure> {
    let unusable = |error: io::Error| Failure::Unusable(format!("{spec} cannot be read: {error}"));
    let source: Box<dyn BufRead> = match spec {
        BusSpec::File(path) => {
            let log = bus::open_log(path).map_err(unusable)?;
            Box::new(BufReader::with_capacity(1 << 16, log))
        }
        _ => Box::new(io::stdin().lock()),
    };
    let mut reader = LogReader::new(source);
    let mut frame = reader.next_frame().map_err(unusable)?;
    let epoch = reader.tally().epoch.unwrap_or_default();
    let config = Config { listen_only: true, ..setup.config.clone() };
    let options =
        AppOptions { epoch, file_path: Some(setup.file.clone()), ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    let reading = Store::new(&setup.file).read().map_err(|error| error.to_string());
    app.handle_file(Instant::ZERO, reading.into());
    let mut named = 0;
    let mut now = Instant::ZERO;
    while let Some(next) = frame {
        for name in &reader.tally().interfaces[named..] {
            app.add_bus(next.time, name.clone(), config.clone());
            named += 1;
        }
        now = next.time;
        pass_time(&mut app, now);
        // Who wrote the log is one of those who are watched.
        let mut heard = next;
        heard.ours = false;
        app.handle_frames(now, &[heard]);
        frame = reader.next_frame().map_err(unusable)?;
    }
    pass_time(&mut app, now);
    let tally = reader.tally().clone();
    Ok((app, now, Some(tally)))
}

/// Lets everything happen that is due until `now`, each at its time.
fn pass_time(app: &mut App, now: Instant) {
    // The buses' deadlines only: nobody watches the seconds pass, and there may be years of them
    // where the clock was set while the log was written.
    let next = |app: &App| app.buses().iter().filter_map(|bus| bus.engine.poll_timeout()).min();
    while let Some(due) = next(app).filter(|due| *due <= now) {
        app.handle_timeout(due.max(app.now()));
        while app.poll_effect().is_some() {}
    }
    if app.poll_timeout().is_some_and(|due| due <= now) {
        app.handle_timeout(now);
    }
}

// --- a live bus ---------------------------------------------------------------------------

/// `None`: interrupted.
fn scan_live(
    buses: &[BusSpec],
    setup: &Setup,
    scan: &Scan,
) -> Result<Option<(App, Instant)>, Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("no event loop")?;
    runtime.block_on(async {
        let clock = open::clock(buses, 1.0)?;
        let mut session = open::session(buses, setup, clock, AppOptions::default())?;
        let mut interrupt = signal(SignalKind::interrupt()).context("no signals")?;
        let mut terminate = signal(SignalKind::terminate()).context("no signals")?;
        let mut bar = Bar::new();
        let end = tokio::time::sleep(scan.time);
        tokio::pin!(end);
        loop {
            session.settle();
            check_links(&session)?;
            bar.show(&session.app, session.now(), scan.time);
            if is_settled(&session.app) {
                break;
            }
            tokio::select! {
                biased;
                _ = interrupt.recv() => return Ok(None),
                _ = terminate.recv() => return Ok(None),
                () = &mut end => break,
                wake = session.next() => session.take(wake),
            }
        }
        bar.clear();
        let now = session.now();
        Ok(Some((session.app, now)))
    })
}

fn is_settled(app: &App) -> bool {
    app.buses().iter().all(|bus| bus.engine.progress().settled)
}

/// Without a screen nobody waits for an interface to come up.
fn check_links(session: &Session) -> Result<(), Failure> {
    for bus in session.app.buses() {
        let status = &bus.status;
        let dead = match status.link {
            Link::Up | Link::Ended => false,
            Link::Opening => session.now().since(Instant::ZERO) > OPENING,
            _ => true,
        };
        if dead {
            let why = status.message.clone();
            return Err(Failure::Unusable(
                why.unwrap_or_else(|| format!("{} cannot be opened", bus.name)),
            ));
        }
    }
    Ok(())
}

/// A line on standard error while scanning, where that is a terminal.
struct Bar {
    shown: bool,
    last: String,
}

impl Bar {
    fn new() -> Self {
        Self { shown: io::stderr().is_terminal(), last: String::new() }
    }

    fn show(&mut self, app: &App, now: Instant, limit: std::time::Duration) {
        const WIDTH: usize = 20;
        if !self.shown {
            return;
        }
        let mut sum = Progress::default();
        for bus in app.buses() {
            let progress = bus.engine.progress();
            sum.here += progress.here;
            sum.named += progress.named;
            sum.with_services += progress.with_services;
        }
        // Full when all that was found is known; before anything is found, the time that is up.
        let done = if sum.here > 0 {
            (sum.named + sum.with_services) as f64 / (2 * sum.here) as f64
        } else {
            now.as_secs_f64() / limit.as_secs_f64()
        };
        let filled = ((done * WIDTH as f64) as usize).min(WIDTH);
        let line = format!(
            "scanning [{}{}] {} devices, {} named, {} with services",
            "#".repeat(filled),
            "-".repeat(WIDTH - filled),
            sum.here,
            sum.named,
            sum.with_services
        );
        if line != self.last {
            let _ = write!(io::stderr(), "\r\x1b[K{line}");
            self.last = line;
        }
    }

    fn clear(&mut self) {
        if !self.last.is_empty() {
            let _ = write!(io::stderr(), "\r\x1b[K");
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
    let unusable = |why: String| Failure::Unusable(format!("{}: {why}", path.display()));
    let mut document = Document::empty();
    let mut count = 0;
    for bus in app.buses() {
        let mut devices: Vec<_> = bus
            .engine
            .devices()
            .iter()
            .filter(|device| device.is_here() && !device.is_debug)
            .collect();
        devices.sort_by_key(|device| device.address);
        for device in devices {
            let Some(entry) = app.new_entry(device) else { continue };
            document = document
                .apply(&Operation::Add { entry })
                .map_err(|error| unusable(error.to_string()))?;
            count += 1;
        }
    }
    let saved = Store::new(path).save(None, document.source());
    // The error names the path.
    saved.map_err(|error| Failure::Unusable(error.to_string()))?;
    let devices = if count == 1 { "device" } else { "devices" };
    let _ = writeln!(io::stderr(), "{}: {count} {devices} written", path.display());
    Ok(())
}
