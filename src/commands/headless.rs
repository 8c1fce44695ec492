//! Sessions without a screen, on buses or on one log, until a command has enough, a limit is
//! reached, or the log ends. Also the warnings that they share. Does not know what the commands
//! print.

use super::open::{self, Setup};
use super::{Failure, output};
use crate::app::{App, AppOptions, Bus, BusSnapshot, TxBlocked};
use crate::bus::{self, BusSpec, UdpAddress};
use crate::diagnostic::Diagnostic;
use crate::frame::{BusIndex, Frame};
use crate::log::READABLE_LOGS;
use crate::open_file::stdin_file;
use crate::shell::log_input::{LogBatch, LogBatches, LogInput, LogPace, LogRange};
use crate::shell::session::{InputEnd, Session, SessionWake};
use crate::shell::signals::let_writes_fail;
use crate::shell::stop::{StopReason, StopWaiter};
use crate::shell::store::Store;
use crate::shell::waiting::{block_on, sleep_for};
use crate::status::{BusState, Link, RecordingStatus};
use crate::time::{Epoch, Instant};
use anyhow::Context;
use std::fs::File;
use std::io;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::yield_now;

/// Time for an interface to open, on a busy machine.
const OPENING: Duration = Duration::from_secs(10);

/// What ends a run, besides signals.
#[derive(Clone, Copy, Debug, Default)]
pub struct Limits {
    /// Longest duration; in log time for a log that is not read live.
    pub time: Option<Duration>,
    /// Start of the part of a log that is read, after its first frame.
    pub from: Option<Duration>,
    /// Stop when standard output is closed.
    pub while_read: bool,
    /// The captured frames are read.
    pub needs_frames: bool,
    /// Longest time between two turns; `None` if nothing is due by itself.
    pub turn_period: Option<Duration>,
    /// Exit code if a signal stops it and it cannot finish, as its output is not read.
    pub stuck: u8,
}

/// Result of a run.
pub struct RunOutcome {
    /// All state.
    pub app: App,
    /// Time of the state.
    pub now: Instant,
    /// What stopped the run; `None` if the command had enough or the log ended.
    pub ending: Option<StopReason>,
    /// An error if a log was not recorded completely: a script may delete the log once it is
    /// recorded in another format. To be returned after the results are printed.
    pub recording: Result<(), Failure>,
}

/// Input of a run.
#[derive(Clone, Copy, Debug)]
pub enum RunInput<'a> {
    /// Buses, in real time.
    Buses(&'a [BusSpec]),
    /// One log, at this pace; `None` reads a file at once, and anything else live.
    Log(&'a BusSpec, Option<LogPace>),
    /// One log that is open, at once and without des.json.
    OpenLog(&'a BusSpec, &'a File),
}

impl<'a> RunInput<'a> {
    /// The log; `None` for buses.
    fn log(self) -> Option<&'a BusSpec> {
        match self {
            RunInput::Buses(_) => None,
            RunInput::Log(spec, _) | RunInput::OpenLog(spec, _) => Some(spec),
        }
    }
}

/// Runs a session until `turn` breaks, a limit is reached or the log ends. `turn` is called after
/// each wake-up. Prints unreadable lines of a log on standard error, once.
///
/// # Errors
/// An input or the recording cannot be used, or `turn` failed.
pub fn run(
    input: RunInput<'_>,
    setup: &Setup,
    options: AppOptions,
    limits: Limits,
    mut turn: impl FnMut(&mut Session) -> Result<ControlFlow<()>, Failure>,
) -> Result<RunOutcome, Failure> {
    run_turns(input, setup, options, limits, &mut turn)
}

/// The same, with the code once for all types of `turn`.
fn run_turns(
    input: RunInput<'_>,
    setup: &Setup,
    options: AppOptions,
    limits: Limits,
    turn: &mut dyn FnMut(&mut Session) -> Result<ControlFlow<()>, Failure>,
) -> Result<RunOutcome, Failure> {
    // No screen shows the captured frames.
    let without_capture = !limits.needs_frames;
    let options = AppOptions { capture_room: Some(0), without_capture, ..options };
    block_on(&runtime()?, async {
        let (mut stop, mut session, first) = match input {
            RunInput::Buses(buses) => {
                let clock = open::clock(buses, 1.0)?;
                // First: an opened adapter is closed again, however soon a signal arrives.
                let stop = stop_waiter(limits, limits.time)?;
                (stop, open::session(buses, setup, clock, options)?, Ok(None))
            }
            RunInput::Log(spec, pace) => {
                let file = log_file(spec)?;
                let file_path = Some(setup.file.clone());
                let options = AppOptions { file_path, ..options };
                open_log((spec, file), pace, setup, options, limits).await?
            }
            RunInput::OpenLog(spec, file) => {
                let file = file.try_clone().map_err(|it| Diagnostic::unreadable(spec, &it))?;
                open_log((spec, file), Some(LogPace::AtOnce), setup, options, limits).await?
            }
        };
        let mut failure = RecordingFailure::default();
        let ending = match first {
            Err(reason) => Some(reason),
            Ok(mut wake) => loop {
                if let Some(wake) = wake.take() {
                    session.handle_wake(wake);
                    failure.report(session.recording().as_ref());
                }
                let end = session.take_input_end();
                check_end(input, limits, end.as_ref())?;
                session.flush_effects();
                if turn(&mut session)?.is_break() {
                    break None;
                }
                if let Some(end) = end {
                    if matches!(end, InputEnd::Range) {
                        session.end_range();
                    }
                    break None;
                }
                tokio::select! {
                    biased;
                    reason = stop.next() => break Some(reason),
                    next = session.next() => wake = Some(next),
                    () = sleep_for(limits.turn_period) => {}
                }
            },
        };
        let recorded = session.finish_recording();
        let mut recording = Ok(());
        let now = if let Some(spec) = input.log() {
            match recorded {
                Some(status) if status.failure.is_some() => {
                    recording = Err(Failure::Unusable(format!("recorded {status}")));
                }
                recorded => open::report_recording(recorded),
            }
            report_unreadable(spec, &session)?;
            warn_time_doubt(spec, &session.app);
            session.app.now()
        } else {
            let now = session.now();
            open::report_recording(recorded);
            now
        };
        Ok(RunOutcome { app: session.app, now, ending, recording })
    })
}

/// What a run begins with: its session, and the first wake-up or why there is none.
type RunStart = (StopWaiter, Session, Result<Option<SessionWake>, StopReason>);

/// Reads the frames of a log file in the range of `limits`, without a session: for a log that a run has
/// read before, with its warnings. Returns what stopped it; `None` at the end or if `turn` breaks.
///
/// # Errors
/// The log cannot be read, or `turn` failed.
pub fn reread(
    spec: &BusSpec,
    limits: Limits,
    mut turn: impl FnMut(&[Frame]) -> Result<ControlFlow<()>, Failure>,
) -> Result<Option<StopReason>, Failure> {
    let start = Instant::ZERO + limits.from.unwrap_or_default();
    let end = limits.time.map_or(Instant::LATEST, |time| start + time);
    let from = limits.from.unwrap_or_default();
    block_on(&runtime()?, async {
        let mut stop = stop_waiter(limits, None)?;
        let mut batches = LogBatches::spawn(log_file(spec)?, from).context("no thread")?;
        loop {
            // A signal is delivered only to a task that waits.
            yield_now().await;
            let batch = tokio::select! {
                biased;
                reason = stop.next() => return Ok(Some(reason)),
                batch = batches.next() => batch,
            };
            let frames = match batch.map_err(|it| Diagnostic::unreadable(spec, &it))? {
                LogBatch::Frames { frames, .. } => frames,
                LogBatch::Doubtful(_) => continue,
                LogBatch::End(_) => return Ok(None),
            };
            let within = frames.partition_point(|frame| frame.time <= end);
            if turn(&frames[..within])?.is_break() || within < frames.len() {
                return Ok(None);
            }
            batches.recycle(frames);
        }
    })
}

/// Opens the file of a log, or standard input.
pub fn log_file(spec: &BusSpec) -> Result<File, Failure> {
    let unusable = |error: io::Error| Diagnostic::unreadable(spec, &error);
    Ok(match spec {
        BusSpec::File(path) => bus::open_log(path)?,
        _ => stdin_file().map_err(unusable)?,
    })
}

/// Begins to read a log. The session starts with its first frame, or `--from` later.
async fn open_log(
    (spec, file): (&BusSpec, File),
    pace: Option<LogPace>,
    setup: &Setup,
    options: AppOptions,
    limits: Limits,
) -> Result<RunStart, Failure> {
    let unusable = |error: io::Error| Diagnostic::unreadable(spec, &error);
    // All of a file is there; lines of anything else arrive as they are written.
    let is_file = file.metadata().is_ok_and(|it| it.is_file());
    let pace = pace.unwrap_or(if is_file { LogPace::AtOnce } else { LogPace::Live });
    let (real_time, log_time) =
        if pace == LogPace::Live { (limits.time, None) } else { (None, limits.time) };
    let mut stop = stop_waiter(limits, real_time)?;
    let range = LogRange { from: limits.from.unwrap_or_default(), time: log_time };
    let mut log = LogInput::spawn(file, pace, range).context("no thread")?;
    let recorder = setup.recorder()?;
    let first = tokio::select! {
        biased;
        reason = stop.next() => Err(reason),
        batch = first_batch(spec, &mut log, is_file) => Ok(batch.map_err(unusable)?),
    };
    let (epoch, start) =
        (first.as_ref().map_or_else(|_| Epoch::default(), LogBatch::epoch), log.start());
    let store = options.file_path.as_deref().map(Store::new);
    let catalogue = Arc::clone(&setup.catalogue);
    let project = setup.project_facts();
    let messages = Arc::clone(&setup.messages);
    let options = AppOptions { epoch, catalogue, messages, project, ..options };
    let mut session = Session::of_log(App::new(start, options), log, setup.config.clone(), store);
    if let Some(recorder) = recorder {
        session.record(recorder, setup.record_selector());
    }
    Ok((stop, session, first.map(|batch| Some(SessionWake::Log(Ok(batch))))))
}

/// Waits for the first frames, or the end. Prints on standard error when it is doubtful that the
/// input is a log; not of a file, which ends soon.
async fn first_batch(spec: &BusSpec, log: &mut LogInput, is_file: bool) -> io::Result<LogBatch> {
    loop {
        match log.first().await? {
            LogBatch::Doubtful(_) if is_file => {}
            LogBatch::Doubtful(entries) => {
                output::warn(format_args!("{spec}: {entries}; {READABLE_LOGS}"));
            }
            batch => return Ok(batch),
        }
    }
}

/// A log that cannot be read, or that ends before `--from`, is an error.
fn check_end(input: RunInput<'_>, limits: Limits, end: Option<&InputEnd>) -> Result<(), Failure> {
    let Some(spec) = input.log() else { return Ok(()) };
    match end {
        Some(InputEnd::Failed(error)) => Err(Diagnostic::unreadable(spec, error).into()),
        Some(InputEnd::Log(summary)) if summary.frames > 0 => {
            check_from(spec, limits.from, summary.last)
        }
        Some(InputEnd::Log(_) | InputEnd::Range) | None => Ok(()),
    }
}

/// A log whose last frame is before `--from` is an error.
pub fn check_from(spec: &BusSpec, from: Option<Duration>, last: Instant) -> Result<(), Failure> {
    let (last, from) = (last.since(Instant::ZERO), from.unwrap_or_default());
    if from <= last {
        return Ok(());
    }
    let (last, from) = (last.as_secs_f64(), from.as_secs_f64());
    let remedy = match last {
        ..0.05 => "leave --from out".to_owned(),
        _ => format!("use a --from below {last:.1}, not {from}"),
    };
    let cause = format!("{spec}: last frame {last:.1} s after the first");
    Err(Diagnostic::new(cause).with_remedy(remedy).into())
}

/// Prints on standard error, once, that recording stopped before the session did.
#[derive(Default)]
struct RecordingFailure {
    is_reported: bool,
}

impl RecordingFailure {
    fn report(&mut self, status: Option<&RecordingStatus>) {
        let failure = status.and_then(|status| Some((&status.path, status.failure.as_ref()?)));
        if let Some((path, why)) = failure.filter(|_| !self.is_reported) {
            self.is_reported = true;
            output::warn(format_args!("recording to {path} stopped: {why}"));
        }
    }
}

/// Why a bus cannot be used now, for a command that does not wait for it to come up.
pub fn why_unusable(bus: &Bus, now: Instant) -> Option<String> {
    let is_dead = match bus.status.link {
        Link::Up => is_off_for_good(bus) && bus.counters().frames == 0,
        Link::Ended => false,
        Link::Opening => now.since(Instant::ZERO) > OPENING,
        _ => true,
    };
    is_dead.then(|| cause(bus))
}

/// Returns true if its controller is off the bus and does not restart by itself.
fn is_off_for_good(bus: &Bus) -> bool {
    match bus.status.state {
        BusState::BusOff => bus.status.restart_ms.unwrap_or(0) == 0,
        BusState::Stopped => true,
        _ => false,
    }
}

/// Why a bus is still not open, at the end of a run.
pub fn why_not_open(bus: &Bus) -> Option<String> {
    matches!(bus.status.link, Link::Opening | Link::Missing).then(|| cause(bus))
}

fn cause(bus: &Bus) -> String {
    if let Some(fault) = &bus.status.fault {
        return fault.to_string();
    }
    let name = &bus.name;
    match (bus.status.link, bus.status.unreadable) {
        (Link::Opening, 0) => {
            format!("{name} is not open: no response; connect it, or give a longer --time")
        }
        (Link::Opening, _) => {
            format!("{name} is not open: unreadable data; check the bus type")
        }
        _ => format!("{name} cannot be opened"),
    }
}

/// Prints on standard error why descan cannot transmit on a bus: controller off, adapter without
/// responses, no acknowledgement, no own address.
pub fn warn_tx_blocked(bus: &BusSnapshot) {
    let warn = |why: &str| output::warn(format_args!("{}: {why}", bus.name));
    if bus.status.link == Link::Up && !bus.is_up {
        let fault = bus.status.fault.as_ref().map(Diagnostic::to_string);
        let why = fault.as_deref().unwrap_or(bus.status.state.name());
        warn(why.strip_prefix(&bus.name).map_or(why, str::trim_start));
    } else if bus.status.listens_first {
        warn(
            "no valid frame received, listen-only until then; check the bit rate; for a device \
             that is alone name it: slcan:DEVICE@RATE",
        );
    } else if bus.status.unanswered && bus.is_up {
        warn("no response from the adapter; check adapter and baud rate");
    } else {
        match (bus.tx_blocked, bus.name.parse()) {
            (None, _) => {}
            (Some(TxBlocked::QueueFull), _) => warn(
                "transmit queue stuck; check that another node is on, at the same bit rate, and \
                 the adapter: ip -statistics link",
            ),
            // No cable is involved.
            (_, Ok(BusSpec::Udp(UdpAddress { group, .. }))) => warn(&format!(
                "own datagrams are not received back; check the route (ip route get {group}) and \
                 that its interface has multicast"
            )),
            _ => warn(
                "no ACK on the bus; check that another node is on, at the same bit rate, and that \
                 both ends are terminated",
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

/// Prints on standard error which buses speak another protocol. Those in `reported` were printed
/// before; new ones are added to it.
pub fn warn_foreign(app: &App, reported: &mut Vec<BusIndex>) {
    for (at, bus) in (0..=u8::MAX).zip(app.buses()) {
        let reason = bus.traffic().foreign_reason();
        if let Some(reason) = reason.filter(|_| !reported.contains(&BusIndex(at))) {
            reported.push(BusIndex(at));
            output::warn(format_args!("{}: {reason}", bus.name));
        }
    }
}

/// Prints on standard error which lines could not be read, and what is doubtful of the times; if no line
/// could be read, it is an error.
fn report_unreadable(spec: &BusSpec, session: &Session) -> Result<(), Failure> {
    let Some(summary) = session.log_summary() else {
        // The log goes on behind the part that was read.
        let doubts = session.log_doubts().unwrap_or_default();
        if doubts.entries.count > 0 {
            output::warn(format_args!("{spec}: {}", doubts.entries));
        }
        if doubts.dates.is_any() {
            output::warn(format_args!("{spec}: {}", doubts.dates));
        }
        return Ok(());
    };
    if summary.foreign.is_some() {
        return Err(Failure::Unusable(format!("{spec}: {summary}")));
    }
    let is_damaged = summary.lost_entries() > 0;
    let is_doubtful =
        summary.clock_steps_back > 0 || summary.ends_inside_entry || summary.dates.is_any();
    if summary.frames == 0 && is_damaged {
        return Err(Failure::Unusable(format!("{spec}: {summary}; {READABLE_LOGS}")));
    }
    if summary.frames == 0 {
        let way_out = match spec {
            BusSpec::Stdin => "pipe a log into it: candump -L can0 | descan scan -",
            _ => "check that it is the right log",
        };
        output::warn(format_args!("{spec}: {summary}; {way_out}"));
    } else if is_damaged || is_doubtful {
        output::warn(format_args!("{spec}: {summary}"));
    }
    Ok(())
}

/// Prints on standard error why the times of a log do not show some conflicts: once, if that is so on
/// several buses.
fn warn_time_doubt(spec: &BusSpec, app: &App) {
    if let Some(doubt) = app.buses().iter().find_map(Bus::time_doubt) {
        output::warn(format_args!("{spec}: {doubt}"));
    }
}

fn stop_waiter(limits: Limits, time: Option<Duration>) -> Result<StopWaiter, Failure> {
    let stop = StopWaiter::new(time, limits.stuck).context("no signals")?;
    Ok(if limits.while_read { stop.or_stdout_closed() } else { stop })
}

/// The runtime of the event loop.
pub fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.context("no event loop")?;
    {
        let _entered = runtime.enter();
        // A write beyond the file size limit fails then, instead of ending the process.
        let_writes_fail().context("no signals")?;
    }
    Ok(runtime)
}
