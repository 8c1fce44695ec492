//! The app without a screen, on buses and on logs, until there is enough, something ends it, or
//! the log is at its end. What is done meanwhile is for the commands to say.

use super::Failure;
use super::open::{self, Setup};
use crate::app::{App, AppOptions, Bus, BusSnapshot, TxBlocked};
use crate::bus::{self, BusSpec, UdpAddress};
use crate::frame::BusIndex;
use crate::log::LogSummary;
use crate::shell::log_session::{LogPace, LogRange, LogSession, LogWake, Read};
use crate::shell::session::Session;
use crate::shell::stop::{StopReason, StopWaiter};
use crate::status::{BusState, Link, RecordingStatus};
use crate::time::Instant;
use anyhow::Context;
use std::fs::File;
use std::io::{self, Write};
use std::ops::ControlFlow;
use std::os::fd::AsFd;
use std::time::Duration;

/// How long an interface may take to be looked at, on a machine that is busy.
const OPENING: Duration = Duration::from_secs(10);

/// What ends it, beside signals.
#[derive(Clone, Copy, Debug, Default)]
pub struct Limits {
    /// After so long; where lines of a log have their own times, by these.
    pub time: Option<Duration>,
    /// Start of the part of a log that is read, after its first frame.
    pub from: Option<Duration>,
    /// When standard output is closed.
    pub while_read: bool,
    /// The exit code where a signal ends it and it cannot finish: nobody reads its output.
    pub stuck: u8,
}

/// What became of it.
pub struct RunOutcome {
    /// All state.
    pub app: App,
    /// The moment it is of.
    pub now: Instant,
    /// What ended it; none where there was enough, or the log is at its end.
    pub ending: Option<StopReason>,
}

/// On buses. `turn` is called whenever something may have changed, and breaks when there is enough.
pub fn live(
    buses: &[BusSpec],
    setup: &Setup,
    options: AppOptions,
    limits: Limits,
    mut turn: impl FnMut(&mut Session) -> Result<ControlFlow<()>, Failure>,
) -> Result<RunOutcome, Failure> {
    runtime()?.block_on(async {
        let clock = open::clock(buses, 1.0)?;
        // First: an adapter that was opened is closed again, however soon a signal comes.
        let mut endings = endings(limits, limits.time)?;
        let mut session = open::session(buses, setup, clock, options)?;
        let mut failure = RecordingFailure::default();
        let ending = loop {
            session.flush_effects();
            if turn(&mut session)?.is_break() {
                break None;
            }
            tokio::select! {
                biased;
                ending = endings.next() => break Some(ending),
                wake = session.next() => session.take(wake),
            }
            failure.tell(session.app.recording());
        };
        let now = session.now();
        open::report_recording(session.finish_recording());
        Ok(RunOutcome { app: session.app, now, ending })
    })
}

/// On one log, at this pace, or that of its kind. `turn` is called after each frame and when time
/// passed. Lines that cannot be read are told on standard error, once.
pub fn recorded(
    spec: &BusSpec,
    setup: &Setup,
    options: AppOptions,
    (pace, limits): (Option<LogPace>, Limits),
    mut turn: impl FnMut(&mut App) -> Result<(), Failure>,
) -> Result<RunOutcome, Failure> {
    let unusable = |error: io::Error| Failure::Unusable(format!("{spec} cannot be read: {error}"));
    let log = open_log(spec).map_err(unusable)?;
    // A file is all there; of anything else lines come as they are written.
    let is_file = log.metadata().is_ok_and(|it| it.is_file());
    let pace = pace.unwrap_or(if is_file { LogPace::AtOnce } else { LogPace::Live });
    runtime()?.block_on(async {
        let (real, own) =
            if pace == LogPace::Live { (limits.time, None) } else { (None, limits.time) };
        let mut endings = endings(limits, real)?;
        let range = LogRange { from: limits.from.unwrap_or_default(), time: own };
        let with = (options, setup.config.clone());
        let mut recording =
            LogSession::new(log, pace, range, with, &setup.file).context("no thread")?;
        if let Some(recorder) = setup.recorder()? {
            recording.record(recorder);
        }
        let mut failure = RecordingFailure::default();
        let ending = loop {
            let wake = tokio::select! {
                biased;
                ending = endings.next() => break Some(ending),
                wake = recording.next() => wake,
            };
            let wake = wake.map_err(unusable)?;
            if let LogWake::Read(Read::End(tally)) = &wake {
                needs_frames(spec, range, tally)?;
            }
            if recording.take(wake, &mut turn)?.is_break() {
                break None;
            }
            failure.tell(recording.take_recording_status().as_ref());
        };
        let recorded = recording.finish_recording();
        let (app, tally) = recording.finish();
        // Who makes one log of another may delete the first then.
        if let Some(status) = recorded.as_ref().filter(|status| status.failure.is_some()) {
            return Err(Failure::Unusable(format!("recorded {status}")));
        }
        open::report_recording(recorded);
        report_unreadable(spec, tally)?;
        let now = app.now();
        Ok(RunOutcome { app, now, ending })
    })
}

/// Says on standard error that recording is over before the session is, once.
#[derive(Default)]
struct RecordingFailure {
    was_told: bool,
}

impl RecordingFailure {
    fn tell(&mut self, status: Option<&RecordingStatus>) {
        let failure = status.and_then(|status| Some((&status.path, status.failure.as_ref()?)));
        if let Some((path, why)) = failure.filter(|_| !self.was_told) {
            self.was_told = true;
            let _ = writeln!(io::stderr(), "descan: recording to {path} stopped: {why}");
        }
    }
}

/// Why a bus cannot be used now, where nobody waits for it to come up.
pub fn why_unusable(bus: &Bus, now: Instant) -> Option<String> {
    let is_dead = match bus.status.link {
        Link::Up => is_off_for_good(bus) && bus.engine.counters().frames == 0,
        Link::Ended => false,
        Link::Opening => now.since(Instant::ZERO) > OPENING,
        _ => true,
    };
    is_dead.then(|| cause(bus))
}

/// Whether its controller takes no part in it, and will not by itself.
fn is_off_for_good(bus: &Bus) -> bool {
    match bus.status.state {
        BusState::BusOff => bus.status.restart_ms.unwrap_or(0) == 0,
        BusState::Stopped => true,
        _ => false,
    }
}

/// Why a bus cannot be used, where it is still not open and nobody waits any longer.
pub fn why_not_open(bus: &Bus) -> Option<String> {
    (bus.status.link == Link::Opening).then(|| cause(bus))
}

fn cause(bus: &Bus) -> String {
    if let Some(message) = &bus.status.message {
        return message.clone();
    }
    let name = &bus.name;
    match (bus.status.link, bus.status.unreadable) {
        (Link::Opening, 0) => {
            format!("{name} is not open: no response; is it connected, or is --time too short?")
        }
        (Link::Opening, _) => {
            format!("{name} is not open: unreadable data; is it the right bus type?")
        }
        _ => format!("{name} cannot be opened"),
    }
}

/// Prints on standard error why descan cannot transmit on a bus: controller off, adapter without
/// responses, no acknowledgement, no own address.
pub fn warn_tx_blocked(bus: &BusSnapshot) {
    let warn = |why: &str| {
        let _ = writeln!(io::stderr(), "descan: {}: {why}", bus.name);
    };
    if bus.status.link == Link::Up && !bus.is_up {
        let why = bus.status.message.as_deref().unwrap_or(bus.status.state.name());
        warn(why.strip_prefix(&bus.name).map_or(why, str::trim_start));
    } else if bus.status.unanswered && bus.is_up {
        warn("the adapter answered no command: is it slcan, is the baud rate right?");
    } else {
        match (bus.tx_blocked, bus.name.parse()) {
            (None, _) => {}
            (Some(TxBlocked::QueueFull), _) => warn(
                "transmit queue stuck: is another node on, at the \
                 same bit rate? Does the adapter still work? See: ip -statistics link",
            ),
            // No cable is involved.
            (_, Ok(BusSpec::Udp(UdpAddress { group, .. }))) => warn(&format!(
                "own datagrams are not received back; does a route lead to {group} (ip route get \
                 {group}), and does its interface have multicast?"
            )),
            _ => warn(
                "no ACK on the bus; is another node on, at the same bit rate, and are \
                 both ends terminated?",
            ),
        }
    }
    if let Some(why) = &bus.why_no_address {
        warn(why);
    }
}

/// The same for all buses, at the end of a run.
pub fn warn_all_tx_blocked(app: &App, now: Instant) {
    let buses = (0..=u8::MAX).map_while(|at| app.bus_snapshot(BusIndex(at), now));
    buses.for_each(|bus| warn_tx_blocked(&bus));
}

/// A log that ends before `--from` is an error, not a log without devices.
fn needs_frames(spec: &BusSpec, range: LogRange, tally: &LogSummary) -> Result<(), Failure> {
    let last = tally.last.since(Instant::ZERO);
    if range.from <= last || tally.frames == 0 {
        return Ok(());
    }
    let (last, from) = (last.as_secs_f64(), range.from.as_secs_f64());
    Err(Failure::Unusable(format!(
        "{spec}: last frame {last:.1} s after the first; use a --from below {last:.1}, not {from}"
    )))
}

/// Says which lines could not be read. Where that is all of them, it is no log.
fn report_unreadable(spec: &BusSpec, tally: Option<LogSummary>) -> Result<(), Failure> {
    let Some(tally) = tally else { return Ok(()) };
    let is_damaged = tally.unreadable > 0 || tally.damage.is_some();
    if tally.frames == 0 && is_damaged {
        return Err(Failure::Unusable(format!("{spec}: {tally}; use a candump -L log or pcapng")));
    }
    if is_damaged || tally.frames == 0 {
        let _ = writeln!(io::stderr(), "descan: {spec}: {tally}");
    }
    Ok(())
}

fn open_log(spec: &BusSpec) -> io::Result<File> {
    match spec {
        BusSpec::File(path) => bus::open_log(path),
        _ => Ok(File::from(io::stdin().as_fd().try_clone_to_owned()?)),
    }
}

fn endings(limits: Limits, time: Option<Duration>) -> Result<StopWaiter, Failure> {
    let endings = StopWaiter::new(time, limits.stuck).context("no signals")?;
    Ok(if limits.while_read { endings.or_stdout_closed() } else { endings })
}

/// The event loop.
pub fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    Ok(runtime.context("no event loop")?)
}
