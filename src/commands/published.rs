//! The documents that a gateway publishes: parts of the report of `scan --json`, by topic.
//!
//! Scripts rely on the names, types and meanings of their members. Does not know the connection.

use super::report::{DeviceReport, FindingReport, ScanReport};
use super::watch;
use crate::app::{App, Scope};
use crate::discovery::Presence;
use crate::finding::{FindingKey, FindingState};
use crate::fleet::{FleetDocument, Publication, TopicPath};
use crate::text::hex;
use crate::time::{Duration, Instant};
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Shortest time between two documents of one topic.
pub const CHANGE_PERIOD: Duration = Duration::from_secs(1);

/// Period of the status, and of the counters of buses and findings.
const SUMMARY_PERIOD: Duration = Duration::from_secs(30);

/// Period of the counters of devices: 127 devices send less than 200 bytes per second for them.
const DEVICE_COUNTER_PERIOD: Duration = Duration::from_mins(30);

/// Members that change with every frame.
const BUS_COUNTERS: &[&str] =
    &["frames", "load", "errors", "lost", "not_sent", "unreadable", "lost_where"];
const DEVICE_COUNTERS: &[&str] = &[
    "heartbeat.count",
    "heartbeat.period_ms",
    "heartbeat.jitter_ms",
    "heartbeat.missed",
    "heartbeat.period_error_ppm",
    "heartbeat.period_uncertainty_ppm",
    "debug",
];
const FINDING_COUNTERS: &[&str] = &["last", "evidence", "text"];

/// Takes from an [`App`] what a [`Publication`] is given: events at once, documents at most once a second.
#[derive(Debug, Default)]
pub struct PublicationFeed {
    /// Time of the next documents.
    next: Instant,
    /// The last summary of the status.
    summary: Value,
    /// Time of the next status without a change.
    next_status: Instant,
}

impl PublicationFeed {
    /// Returns what there is to publish at `now`; `None` without events before the next documents are due.
    pub fn poll(&mut self, app: &mut App, now: Instant) -> Option<PublicationUpdate> {
        let events = take_events(app);
        if now < self.next {
            let update = PublicationUpdate { events, ..PublicationUpdate::default() };
            return Some(update).filter(|update| !update.events.is_empty());
        }
        self.next = now + CHANGE_PERIOD;
        let Published { documents, summary } = Published::new(app, now);
        let is_status_due = now >= self.next_status || summary != self.summary;
        if is_status_due {
            self.next_status = now + SUMMARY_PERIOD;
            self.summary.clone_from(&summary);
        }
        let status = is_status_due.then_some(summary);
        Some(PublicationUpdate { events, documents: Some(documents), status })
    }
}

/// What there is to publish of a moment.
#[derive(Debug, Default)]
pub struct PublicationUpdate {
    events: Vec<Value>,
    documents: Option<Vec<FleetDocument>>,
    /// The summary, if the status is due.
    status: Option<Value>,
}

impl PublicationUpdate {
    /// Returns the last events and documents of a gateway that stops.
    pub fn last(app: &mut App, now: Instant) -> Self {
        let events = take_events(app);
        Self { events, documents: Some(Published::new(app, now).documents), status: None }
    }

    /// Gives it to a publication, as of `now` (`unix_secs` on the wall clock).
    pub fn give_to(self, publication: &mut Publication, now: Instant, unix_secs: f64) {
        for event in self.events {
            publication.handle_event(event);
        }
        if let Some(documents) = self.documents {
            publication.handle_documents(now, unix_secs, documents);
        }
        if let Some(summary) = self.status {
            publication.handle_status(unix_secs, summary);
        }
    }
}

fn take_events(app: &mut App) -> Vec<Value> {
    let mut events = Vec::new();
    while let Some(event) = app.poll_app_event() {
        events.extend(watch::as_value(app, event).and_then(|it| serde_json::to_value(it).ok()));
    }
    events
}

/// What a gateway publishes of one moment.
struct Published {
    /// All documents but the status.
    documents: Vec<FleetDocument>,
    /// The summary for the status.
    summary: Value,
}

impl Published {
    /// Returns what there is to publish at `now`.
    fn new(app: &App, now: Instant) -> Self {
        let report = ScanReport::new(app, now, Scope::Screen);
        let is_open = |finding: &&FindingReport| finding.cleared_at.is_none();
        let open: Vec<&FindingReport> = report.findings.iter().filter(is_open).collect();
        let summary = summary(&report, &open);
        let buses = report.buses.iter().map(|bus| FleetDocument {
            path: TopicPath::Bus(bus.bus.name.clone()),
            value: value(bus),
            counters: BUS_COUNTERS,
            counter_period: SUMMARY_PERIOD,
        });
        let findings = open.iter().map(|finding| FleetDocument {
            path: TopicPath::Finding(
                finding.bus.clone().unwrap_or_else(|| "-".to_owned()),
                finding_id(&finding.key),
            ),
            value: value(finding),
            counters: FINDING_COUNTERS,
            counter_period: SUMMARY_PERIOD,
        });
        let documents = buses.chain(devices(&report.devices)).chain(findings).collect();
        Self { documents, summary }
    }
}

/// A document for each address: the device that is there, and in `others` those that were.
fn devices(devices: &[DeviceReport]) -> impl Iterator<Item = FleetDocument> {
    let mut at_address: BTreeMap<(&str, u8), Vec<&DeviceReport>> = BTreeMap::new();
    for device in devices {
        at_address.entry((&device.bus, device.address)).or_default().push(device);
    }
    at_address.into_iter().map(|((bus, address), mut devices)| {
        devices.sort_by_key(|device| device.presence == Presence::Lost.name());
        let mut values = devices.into_iter().map(value);
        let mut first = values.next().unwrap_or_default();
        let others: Vec<Value> = values.collect();
        if let Some(map) = first.as_object_mut().filter(|_| !others.is_empty()) {
            map.insert("others".to_owned(), Value::Array(others));
        }
        FleetDocument {
            path: TopicPath::Device(bus.to_owned(), address),
            value: first,
            counters: DEVICE_COUNTERS,
            counter_period: DEVICE_COUNTER_PERIOD,
        }
    })
}

/// The last level of the topic of a finding: its kind, and what tells it from others of the kind.
fn finding_id(key: &FindingKey) -> String {
    /// Longest name or fault that is written out, in bytes.
    const MOST: usize = 48;
    let mut id = key.kind.name().to_owned();
    let address = key.address.map(|address| address.number().to_string());
    let name = key.name.as_ref().map(ToString::to_string);
    let fault = key.fault.as_ref().map(ToString::to_string);
    let parts = [address, name, fault];
    let count = parts.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
    for part in parts.into_iter().take(count) {
        let part = part.unwrap_or_else(|| "-".to_owned());
        id.push('.');
        match part.char_indices().find(|(at, _)| *at >= MOST) {
            None => id.push_str(&part),
            Some((at, _)) => {
                id.push_str(&part[..at]);
                id.push('~');
                id.push_str(&hex(&check_sum(&part).to_be_bytes(), ""));
            }
        }
    }
    id
}

/// Tells two long texts with the same beginning apart (FNV-1a, 32 bits).
fn check_sum(text: &str) -> u32 {
    let step = |sum: u32, byte: u8| (sum ^ u32::from(byte)).wrapping_mul(16_777_619);
    text.bytes().fold(2_166_136_261, step)
}

fn summary(report: &ScanReport, open: &[&FindingReport]) -> Value {
    let is_present = |device: &&DeviceReport| device.presence != Presence::Lost.name();
    let present = report.devices.iter().filter(is_present).count();
    let count =
        |state: FindingState| open.iter().filter(|it| it.confidence == state.name()).count();
    let mut summary = json!({
        "descan": env!("CARGO_PKG_VERSION"),
        "period_s": SUMMARY_PERIOD.as_secs(),
        "buses": report.buses.iter().map(|bus| &bus.bus.name).collect::<Vec<_>>(),
        "devices": {"present": present, "lost": report.devices.len() - present},
        "findings": {
            "confirmed": count(FindingState::Confirmed),
            "suspected": open.len() - count(FindingState::Confirmed),
        },
        "file": value(&report.file),
    });
    if let Some(map) = summary.as_object_mut().filter(|_| !report.files.is_empty()) {
        map.insert("files".to_owned(), value(&report.files));
    }
    summary
}

/// Plain values are always JSON.
fn value(part: &impl Serialize) -> Value {
    serde_json::to_value(part).unwrap_or_default()
}
