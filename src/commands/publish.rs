//! `descan publish`: what is found on buses, to an MQTT broker.

use super::fleet::unix_secs;
use super::gate::BusGate;
use super::headless::{self, Limits, RunInput};
use super::open::{self, Setup};
use super::published::{CHANGE_PERIOD, PublicationFeed, PublicationUpdate};
use super::{EXIT_OK, Failure, output, report};
use crate::app::{App, AppOptions};
use crate::cli::PublishArgs;
use crate::diagnostic::Diagnostic;
use crate::fleet::{GatewayName, Publication};
use crate::shell::broker::{BrokerPublisher, BrokerSettings, PublisherNotice};
use crate::shell::stop::StopReason;
use crate::time::{Duration, Instant};
use anyhow::Context;
use jiff::tz::TimeZone;
use std::ops::ControlFlow;

/// Longest wait for the broker at the end: less than a signal leaves.
const FAREWELL: Duration = Duration::from_millis(500);

/// The same where no signal came, and the broker is connected. Chosen.
const LAST_DELIVERY: Duration = Duration::from_secs(5);

/// Shortest time between two reports of one des.json: another program may write it again and again.
const WARNING_PERIOD: Duration = Duration::from_secs(10);

/// Runs it.
pub fn run(args: &PublishArgs) -> Result<u8, Failure> {
    let access = args.files.access(&args.broker).map_err(Failure::Usage)?;
    let buses = open::buses(&args.session)?;
    if let Some(log) = open::log(&buses, "publish", None)? {
        return Err(Failure::Usage(format!("{log} is a log; publish needs live buses")));
    }
    let setup = Setup::for_buses(&args.session.common, &buses)?;
    let gateway = gateway(args)?;
    let settings = BrokerSettings::read(&access)?;
    settings.warnings.iter().for_each(output::warn);
    let publication = Publication::new(gateway.clone(), (unix_secs() * 1000.0) as u64)
        .with_instance(fastrand::u64(..1 << 53));
    let publisher = BrokerPublisher::spawn(&settings, publication).context("no thread")?;
    let options = AppOptions {
        time_zone: Some(TimeZone::system()),
        emit_events: true,
        ..AppOptions::default()
    };
    let limits = Limits {
        time: args.time,
        turn_period: Some(CHANGE_PERIOD),
        stuck: EXIT_OK,
        ..Limits::default()
    };
    let mut gate = BusGate::new(true);
    let documents = PublicationFeed::default();
    let mut feed =
        Feed { publisher, gateway, settings, documents, unreachable: None, was_connected: false };
    let (mut foreign, mut file_warnings) = (Vec::new(), FileWarnings::default());
    let outcome = headless::run(RunInput::Buses(&buses), &setup, options, limits, |session| {
        feed.print_notices()?;
        file_warnings.print(&session.app, session.now());
        if gate.allows(&session.app, session.now())? {
            let now = session.now();
            feed.publish(&mut session.app, now);
            headless::warn_foreign(&session.app, &mut foreign);
        }
        Ok(ControlFlow::Continue(()))
    })?;
    let mut app = outcome.app;
    feed.print_notices()?;
    let is_interrupted = outcome.ending == Some(StopReason::Interrupted);
    let is_timed = args.time.is_some() && !is_interrupted;
    match feed.stop(&mut app, outcome.now, is_timed) {
        // A run of a given time has published, or has not.
        Err(failure) if is_timed => return Err(failure),
        Err(failure) => output::warn(failure),
        Ok(()) => {}
    }
    if !is_interrupted {
        gate.require_opened(&app)?;
    }
    Ok(EXIT_OK)
}

/// What was printed about each des.json that cannot be used.
#[derive(Debug, Default)]
struct FileWarnings {
    /// By file: what was wrong when it was last looked at, and when that is next done.
    files: Vec<(Option<String>, Instant)>,
}

impl FileWarnings {
    /// Prints on standard error why a des.json cannot be used, again when that changes.
    fn print(&mut self, app: &App, now: Instant) {
        for (index, _) in app.files() {
            let at = usize::from(index.0);
            if self.files.len() <= at {
                self.files.resize(at + 1, (None, Instant::ZERO));
            }
            let (known, next) = &mut self.files[at];
            if now < *next {
                continue;
            }
            let problem = report::of_file(&app.file_snapshot(index)).problem;
            if let Some(problem) = problem.as_ref().filter(|it| known.as_ref() != Some(it)) {
                output::warn(problem);
                *next = now + WARNING_PERIOD;
            }
            *known = problem;
        }
    }
}

/// The name of the gateway: the host's, unless it is given.
fn gateway(args: &PublishArgs) -> Result<GatewayName, Failure> {
    if let Some(name) = &args.gateway {
        return Ok(name.clone());
    }
    let host = host_name();
    host.parse()
        .map_err(|why| Failure::Usage(format!("host name {host:?}: {why}; give --gateway NAME")))
}

#[cfg(unix)]
fn host_name() -> String {
    nix::unistd::gethostname().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(windows)]
fn host_name() -> String {
    std::env::var("COMPUTERNAME").unwrap_or_default()
}

/// The publisher, and what it is given.
struct Feed {
    publisher: BrokerPublisher,
    gateway: GatewayName,
    settings: BrokerSettings,
    documents: PublicationFeed,
    /// Why the broker was never connected.
    unreachable: Option<Diagnostic>,
    was_connected: bool,
}

impl Feed {
    fn publish(&mut self, app: &mut App, now: Instant) {
        if let Some(update) = self.documents.poll(app, now) {
            self.publisher.update(|publication| update.give_to(publication, now, unix_secs()));
        }
    }

    /// Says on standard error what happens to the connection.
    ///
    /// # Errors
    /// The connection failed, and is not tried again.
    fn print_notices(&mut self) -> Result<(), Failure> {
        while let Some(notice) = self.publisher.poll_notice() {
            match notice {
                PublisherNotice::Connected => {
                    (self.unreachable, self.was_connected) = (None, true);
                    let (gateway, address) = (&self.gateway, &self.settings.address);
                    output::say(format_args!("publishing to {address} as {gateway}"));
                }
                PublisherNotice::Failed(failure, None) if failure.is_name_taken => {
                    return Err(Failure::Usage(failure.diagnostic.to_string()));
                }
                PublisherNotice::Failed(failure, None) => return Err(failure.diagnostic.into()),
                PublisherNotice::Failed(failure, Some(wait)) => {
                    let (why, wait) = (failure.diagnostic, wait.as_secs_f64());
                    output::warn(format_args!("{why}; next attempt in {wait:.0} s"));
                    self.unreachable = Some(why).filter(|_| !self.was_connected);
                }
                PublisherNotice::Refused(topic, why) => output::warn(format_args!(
                    "the broker refuses {topic}: {why}; give this user the right to write \
                     descan/v1/{}/#",
                    self.gateway
                )),
            }
        }
        Ok(())
    }

    /// Publishes the last events and documents, and that it stops.
    ///
    /// # Errors
    /// What the broker does not have; of a run of a given time, with the cause.
    fn stop(mut self, app: &mut App, now: Instant, is_timed: bool) -> Result<(), Failure> {
        let update = PublicationUpdate::last(app, now);
        self.publisher.update(|publication| {
            update.give_to(publication, now, unix_secs());
            publication.handle_stop(unix_secs());
        });
        let dropped = self.publisher.update(|publication| publication.dropped_events());
        if dropped > 0 {
            output::warn(format_args!("{dropped} events were dropped while the broker was away"));
        }
        let wait = if is_timed && self.was_connected { LAST_DELIVERY } else { FAREWELL };
        let finished = self.publisher.finish(wait);
        self.print_notices()?;
        let Err(mut why) = finished else { return Ok(()) };
        if is_timed && !self.was_connected {
            if let Some(unreachable) = self.unreachable {
                return Err(unreachable.into());
            }
            why = "no response";
        }
        Err(Failure::Unusable(format!("{}: {why}", self.settings.address)))
    }
}
