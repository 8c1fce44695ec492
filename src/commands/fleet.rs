//! `descan fleet` without a screen: what gateways have published.
//!
//! Scripts rely on the names, types and meanings of the JSON members.

use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure, headless, output};
use crate::bus::wall_micros;
use crate::cli::FleetArgs;
use crate::finding::{FindingKind, FindingState};
use crate::fleet::{Fleet, FleetGateway, FleetTopic, GatewayName, GatewayStatus};
use crate::inventory::{InventoryDevice, InventoryFinding, InventoryService};
use crate::shell::broker::{BrokerReader, BrokerSettings, ReaderNotice};
use crate::shell::stop::StopWaiter;
use crate::shell::waiting::block_on;
use crate::time::{Duration, Instant};
use anyhow::Context;
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt::Write as _;
use tokio::time;

/// Time without a further document after which all are there, on a fast connection; on a slow one four times
/// that of an answer.
const QUIET: Duration = Duration::from_millis(400);

/// Number of documents that are not used and named at most, each on a line.
const MAX_WARNINGS: usize = 10;

/// Time in which documents are read, unless `--time` is given.
const DEFAULT_TIME: Duration = Duration::from_secs(10);

/// Time in which a gateway that is connected sends a further status: its period, and delays.
const STATUS_WAIT: Duration = Duration::from_secs(35);

/// The same with connections that are lost meanwhile.
const LONGEST_TIME: Duration = Duration::from_secs(90);

/// Runs it.
pub fn run(args: &FleetArgs) -> Result<u8, Failure> {
    let access = args.files.access(&args.broker).map_err(Failure::Usage)?;
    let settings = BrokerSettings::read(&access)?;
    let Some(read) = read(&settings, args.time, |_| true)? else {
        return Ok(EXIT_INTERRUPTED);
    };
    let report = FleetReport::new(&settings, &read);
    if args.json {
        let json = serde_json::to_string_pretty(&report).context("JSON")? + "\n";
        output::print_json(&json)?;
    } else {
        output::print(&report.table())?;
    }
    for gateway in &report.gateways {
        for file in gateway.file_errors.iter().take(MAX_WARNINGS) {
            output::warn(format_args!(
                "{} does not use {}: {}",
                gateway.name, file.path, file.error
            ));
        }
    }
    warn_rejects(&read.fleet);
    warn_if_empty(&read.fleet);
    Ok(if report.gateways.iter().any(|it| it.has_findings) { EXIT_FINDINGS } else { EXIT_OK })
}

/// All documents at a broker, and when they were there.
pub struct FleetReading {
    /// The gateways.
    pub fleet: Fleet,
    /// Time of the state.
    pub now: Instant,
    /// All documents are there, and no status may still be renewed.
    pub is_complete: bool,
}

/// The gateways that a reading waits for when all documents of the broker are there.
struct AwaitedGateways<F> {
    /// Whether it waits for that gateway at all.
    is_wanted: F,
    /// Those that were connected before the connection was lost. The broker may have lost their status.
    known: BTreeSet<GatewayName>,
}

impl<F: Fn(&GatewayName) -> bool> AwaitedGateways<F> {
    fn note_known(&mut self, fleet: &Fleet) {
        let is_online = |gateway: &FleetGateway| gateway.status().is_some_and(|it| it.online);
        let online = fleet.gateways().filter(|(_, gateway)| is_online(gateway));
        self.known.extend(online.map(|(name, _)| name.clone()));
    }

    /// Those with a status from long ago.
    fn old<'a>(&'a self, fleet: &'a Fleet) -> impl Iterator<Item = &'a GatewayName> {
        fleet.with_old_status(unix_secs()).filter(|name| (self.is_wanted)(name))
    }

    /// Those without a status since the connection was lost. They publish it after all other documents.
    fn gone<'a>(&'a self, fleet: &'a Fleet) -> impl Iterator<Item = &'a GatewayName> {
        let has_status =
            |name: &&GatewayName| fleet.gateway(name).is_some_and(|it| it.status().is_some());
        self.known.iter().filter(move |name| (self.is_wanted)(name) && !has_status(name))
    }
}

/// The first of these names, and how many more there are; `None` without one.
fn first_of<'a>(mut names: impl Iterator<Item = &'a GatewayName>) -> Option<String> {
    let first = names.next()?;
    Some(match names.count() {
        0 => first.to_string(),
        more => format!("{first} and {more} more"),
    })
}

/// Reads all documents at a broker, at most for that time; `None` if it was interrupted.
///
/// A status from long ago, by the clocks of gateway and reader, does not show that its gateway is connected:
/// the broker may have ended with it, and started again. Another one is waited for, if the gateway
/// `is_wanted`; so is one of which the broker has nothing after the connection was lost.
///
/// # Errors
/// The broker cannot be used, or does not let this user read.
pub fn read(
    settings: &BrokerSettings,
    limit: Option<Duration>,
    is_wanted: impl Fn(&GatewayName) -> bool,
) -> Result<Option<FleetReading>, Failure> {
    settings.warnings.iter().for_each(output::warn);
    block_on(&headless::runtime()?, async {
        let mut stop = StopWaiter::new(None, EXIT_INTERRUPTED).context("no signal handler")?;
        let mut reader =
            BrokerReader::spawn(settings, &FleetTopic::DOCUMENTS).context("no thread")?;
        let begin = std::time::Instant::now();
        let now = || Instant::ZERO + begin.elapsed();
        let mut fleet = Fleet::default();
        let mut awaited = AwaitedGateways { is_wanted, known: BTreeSet::new() };
        let mut failure = None;
        let (mut is_subscribed, mut asked, mut quiet) = (false, now(), QUIET);
        // Only retained messages extend the reading: others may be published without end.
        let mut complete_at = now();
        let mut limit_at = now() + limit.unwrap_or(DEFAULT_TIME);
        let last_limit = now() + limit.unwrap_or(LONGEST_TIME);
        // Since then all are there, and further statuses are waited for.
        let mut complete_since: Option<Instant> = None;
        loop {
            if let Some(since) = complete_since {
                if now() >= since + STATUS_WAIT {
                    fleet.handle_old_statuses(unix_secs());
                }
                let is_last = now() >= limit_at;
                let has_old = awaited.old(&fleet).next().is_some();
                let gone = first_of(awaited.gone(&fleet));
                if is_last && has_old {
                    output::warn("no other status yet: --time gives more time");
                }
                if let Some(names) = gone.as_ref().filter(|_| is_last) {
                    output::warn(format_args!(
                        "{names}: not published again since the connection was lost"
                    ));
                }
                let is_complete = !has_old && gone.is_none();
                if is_complete || is_last {
                    return Ok(Some(FleetReading { fleet, now: now(), is_complete }));
                }
            }
            tokio::select! {
                biased;
                _ = stop.next() => return Ok(None),
                () = time::sleep(limit_at.since(now())) => {
                    if complete_since.is_some() {
                        continue;
                    }
                    // Documents without end: what is there by now.
                    if is_subscribed {
                        output::warn("documents still arrive: not all are shown; --time gives more time");
                        return Ok(Some(FleetReading { fleet, now: now(), is_complete: false }));
                    }
                    let no_response = || format!("{}: no response", settings.address);
                    return Err(Failure::Unusable(failure.unwrap_or_else(no_response)));
                }
                notice = reader.next() => match notice {
                    Some(ReaderNotice::Message(topic, payload, is_kept)) => {
                        fleet.handle_message(now(), &topic, &payload, is_kept);
                        if is_kept {
                            complete_at = now() + quiet;
                        }
                    }
                    Some(ReaderNotice::Subscribed { refused }) if refused > 0 => {
                        let cause = format!("{}: no right to read descan/v1/#", settings.address);
                        return Err(Failure::Unusable(cause));
                    }
                    Some(ReaderNotice::Subscribed { .. }) => {
                        is_subscribed = true;
                        quiet = QUIET.max(now().since(asked) * 4);
                        complete_at = now() + quiet;
                    }
                    Some(ReaderNotice::Connected) => {
                        (asked, is_subscribed, complete_since) = (now(), false, None);
                        limit_at = last_limit.min(limit_at.max(now() + DEFAULT_TIME));
                        awaited.note_known(&fleet);
                        fleet.handle_connected();
                    }
                    Some(ReaderNotice::Failed(why, None)) => return Err(why.diagnostic.into()),
                    Some(ReaderNotice::Failed(why, Some(_))) => {
                        fleet.handle_disconnected(now());
                        failure = Some(why.diagnostic.to_string());
                        (is_subscribed, complete_since) = (false, None);
                    }
                    None => return Err(Failure::Unusable(format!("{} is closed", settings.address))),
                },
                () = time::sleep(complete_at.since(now())), if is_subscribed && complete_since.is_none() => {
                    fleet.handle_complete();
                    complete_since = Some(now());
                    let (old, gone) = (first_of(awaited.old(&fleet)), first_of(awaited.gone(&fleet)));
                    if let Some(names) = &old {
                        output::warn(format_args!("{names}: last status is old, or its clock is wrong; waiting for another"));
                    }
                    if let Some(names) = &gone {
                        output::warn(format_args!("{names}: the broker has no status any more; waiting for one"));
                    }
                    if old.or(gone).is_some() {
                        limit_at = last_limit.min(now() + STATUS_WAIT);
                    }
                }
            }
        }
    })
}

/// This time by the clock of this machine, in Unix seconds.
pub fn unix_secs() -> f64 {
    wall_micros() as f64 / 1e6
}

/// Says what was not used: the first [`MAX_WARNINGS`] documents, by topic, and how many more there are.
pub fn warn_rejects(fleet: &Fleet) {
    let rejects = fleet.rejects();
    let mut said = 0;
    for (topic, cause) in rejects.documents().take(MAX_WARNINGS) {
        output::warn(format_args!("not used: {topic}: {cause}"));
        said += 1;
    }
    let more = rejects.open_count().saturating_sub(said);
    if more > 0 {
        let documents = if more == 1 { "document" } else { "documents" };
        output::warn(format_args!("{more} more {documents} not used"));
    }
}

/// Says what may be the cause if no gateway was found.
pub fn warn_if_empty(fleet: &Fleet) {
    if fleet.gateways().len() == 0 {
        output::warn("no gateway found; none has published, or the user may not read descan/v1/#");
    }
}

/// The report of `fleet --json`.
#[derive(Serialize)]
struct FleetReport<'a> {
    descan: &'static str,
    broker: String,
    /// All documents that the broker has were read.
    complete: bool,
    gateways: Vec<GatewayReport<'a>>,
    versions: Vec<VersionReport>,
    /// Number of documents that could not be used.
    rejected: u64,
    /// Topic and cause of at most a thousand of them.
    rejects: Vec<RejectReport<'a>>,
}

#[derive(Serialize)]
struct RejectReport<'a> {
    /// Printable, and shortened if it is long.
    topic: &'a str,
    cause: &'a str,
}

#[derive(Serialize)]
struct GatewayReport<'a> {
    name: &'a str,
    state: &'static str,
    /// Version of its descan.
    descan: Option<&'a str>,
    /// Time of its last status by its clock, in Unix seconds.
    time: Option<f64>,
    /// `null` after a lost connection, or without a status.
    events: Option<EventReport>,
    /// The des.json files that it cannot use.
    file_errors: Vec<GatewayFileReport<'a>>,
    buses: Vec<GatewayBusReport<'a>>,
    devices: Vec<GatewayDeviceReport<'a>>,
    findings: Vec<GatewayFindingReport<'a>>,
    #[serde(skip)]
    has_findings: bool,
}

#[derive(Serialize)]
struct EventReport {
    last: u64,
    dropped: u64,
}

#[derive(Serialize)]
struct GatewayFileReport<'a> {
    path: &'a str,
    error: &'a str,
}

#[derive(Serialize)]
struct GatewayBusReport<'a> {
    name: &'a str,
    bitrate: Option<u64>,
    state: Option<&'a str>,
    frames: Option<u64>,
    errors: Option<u64>,
    lost: Option<u64>,
    load: Option<f64>,
}

#[derive(Serialize)]
struct GatewayDeviceReport<'a> {
    bus: &'a str,
    address: u8,
    name: Option<&'a str>,
    uid: Option<&'a str>,
    presence: Option<&'a str>,
    mode: Option<&'a str>,
    /// `null` if they are not known.
    services: Option<Vec<GatewayServiceReport<'a>>>,
    period_ms: Option<f64>,
}

#[derive(Serialize)]
struct GatewayServiceReport<'a> {
    name: &'a str,
    version: &'a str,
}

#[derive(Serialize)]
struct GatewayFindingReport<'a> {
    kind: &'a str,
    confidence: &'a str,
    bus: Option<&'a str>,
    address: Option<u8>,
    addresses: &'a [u8],
    names: &'a [String],
    uids: &'a [String],
    text: &'a str,
    remedy: &'a str,
}

#[derive(Serialize)]
struct VersionReport {
    service: String,
    version: String,
    devices: usize,
    gateways: Vec<String>,
}

impl<'a> FleetReport<'a> {
    fn new(settings: &BrokerSettings, read: &'a FleetReading) -> Self {
        let gateways = read.fleet.gateways();
        let versions = read.fleet.versions().into_iter().map(|it| VersionReport {
            gateways: it.gateways.iter().map(ToString::to_string).collect(),
            service: it.service,
            version: it.version,
            devices: it.devices,
        });
        let rejects = read.fleet.rejects();
        Self {
            descan: env!("CARGO_PKG_VERSION"),
            broker: settings.address.to_string(),
            complete: read.is_complete,
            gateways: gateways.map(|(name, it)| of_gateway(name, it, read.now)).collect(),
            versions: versions.collect(),
            rejected: rejects.open_count(),
            rejects: rejects
                .documents()
                .map(|(topic, cause)| RejectReport { topic, cause })
                .collect(),
        }
    }

    /// A line for each gateway.
    fn table(&self) -> String {
        let mut text = String::new();
        let width = self.gateways.iter().map(|it| it.name.len()).max().unwrap_or_default().max(7);
        let _ = writeln!(text, "{:width$}  STATE    DEVICES  LOST  FINDINGS", "GATEWAY");
        for gateway in &self.gateways {
            let lost = gateway.devices.iter().filter(|it| it.presence == Some("lost")).count();
            let present = gateway.devices.len() - lost;
            let confirmed =
                gateway.findings.iter().filter(|it| is_confirmed(it.confidence)).count();
            let suspected = gateway.findings.len() - confirmed;
            let findings = match (confirmed, suspected) {
                (0, 0) => "none".to_owned(),
                (_, 0) => format!("{confirmed} confirmed"),
                (0, _) => format!("{suspected} suspected"),
                _ => format!("{confirmed} confirmed, {suspected} suspected"),
            };
            let (name, state) = (gateway.name, gateway.state);
            let _ = writeln!(text, "{name:width$}  {state:7}  {present:7}  {lost:4}  {findings}");
        }
        text
    }
}

fn is_confirmed(confidence: &str) -> bool {
    confidence == FindingState::Confirmed.name()
}

fn of_gateway<'a>(
    name: &'a GatewayName,
    gateway: &'a FleetGateway,
    now: Instant,
) -> GatewayReport<'a> {
    let status = gateway.status();
    let events = status.and_then(|status| status.events);
    let is_device = |device: &&InventoryDevice| {
        !InventoryDevice::is_debug(device.address, device.name.as_deref(), device.uid.as_deref())
    };
    let is_conflict = |finding: &InventoryFinding| {
        let kind = FindingKind::ALL.iter().find(|kind| kind.name() == finding.kind);
        is_confirmed(&finding.confidence) && kind.is_some_and(|kind| kind.is_conflict())
    };
    GatewayReport {
        name: name.as_str(),
        state: gateway.state(now).name(),
        descan: status.map(|it| it.descan.as_str()).filter(|it| !it.is_empty()),
        time: gateway.last_time(),
        events: events.map(|it| EventReport { last: it.last, dropped: it.dropped }),
        file_errors: status
            .into_iter()
            .flat_map(GatewayStatus::file_errors)
            .map(|(path, error)| GatewayFileReport { path, error })
            .collect(),
        buses: gateway
            .buses()
            .map(|bus| GatewayBusReport {
                name: &bus.name,
                bitrate: bus.bitrate,
                state: bus.state.as_deref(),
                frames: bus.frames,
                errors: bus.errors,
                lost: bus.lost,
                load: bus.load,
            })
            .collect(),
        devices: gateway.devices().filter(is_device).map(of_device).collect(),
        findings: gateway.findings().map(of_finding).collect(),
        has_findings: gateway.findings().any(is_conflict),
    }
}

fn of_device(device: &InventoryDevice) -> GatewayDeviceReport<'_> {
    GatewayDeviceReport {
        bus: &device.bus,
        address: device.address,
        name: device.name.as_deref(),
        uid: device.uid.as_deref(),
        presence: device.presence.as_deref(),
        mode: device.mode.as_deref(),
        services: device
            .services
            .as_ref()
            .map(|services| services.iter().map(of_service).collect()),
        period_ms: device.period_ms,
    }
}

fn of_service(service: &InventoryService) -> GatewayServiceReport<'_> {
    GatewayServiceReport { name: &service.name, version: &service.version }
}

fn of_finding(finding: &InventoryFinding) -> GatewayFindingReport<'_> {
    GatewayFindingReport {
        kind: &finding.kind,
        confidence: &finding.confidence,
        bus: finding.bus.as_deref(),
        address: finding.address,
        addresses: &finding.addresses,
        names: &finding.names,
        uids: &finding.uids,
        text: &finding.text,
        remedy: &finding.remedy,
    }
}
