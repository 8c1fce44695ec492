//! The last events of all gateways.
//!
//! Input: events as they were published, of any origin. Output: one line each. Bounded: [`MAX_EVENTS`]
//! events, 200 characters of a text. Does not know devices: an event says what it is about.

use crate::fleet::{GatewayName, GatewayState};
use crate::text::{printable, shortened};
use serde::Deserialize;
use std::collections::VecDeque;

/// Number of events that are kept at most.
pub const MAX_EVENTS: usize = 1000;

/// Longest text of an event, in characters.
const MAX_TEXT: usize = 200;

/// An event of a gateway.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetEvent {
    /// The gateway.
    pub gateway: GatewayName,
    /// Time by the clock of the gateway, in Unix seconds; of a change of the gateway itself by that of
    /// this machine.
    pub time: f64,
    /// What it is about: `FEED @10`, the name of a bus, `gateway`.
    pub subject: String,
    /// What happened.
    pub text: String,
    /// How it is shown.
    pub kind: FleetEventKind,
}

/// How an event is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FleetEventKind {
    /// A device: it appeared, moved, changed.
    Device,
    /// A device is lost, silent or stale.
    Absence,
    /// A confirmed finding.
    Confirmed,
    /// A suspected finding.
    Suspected,
    /// Anything else: a bus, a file, a finding that is over.
    Other,
}

/// The members of an event that are read.
#[derive(Deserialize)]
struct EventJson {
    event: String,
    #[serde(default)]
    time: f64,
    #[serde(default)]
    bus: serde_json::Value,
    address: Option<u8>,
    name: Option<String>,
    mode: Option<String>,
    from: Option<serde_json::Value>,
    was: Option<String>,
    finding: Option<EventFindingJson>,
}

#[derive(Deserialize)]
struct EventFindingJson {
    #[serde(default)]
    confidence: String,
    #[serde(default)]
    text: String,
}

impl FleetEvent {
    /// Parses an event; `None` if the bytes are none.
    fn parse(gateway: GatewayName, payload: &[u8]) -> Option<Self> {
        let json: EventJson = serde_json::from_slice(payload).ok()?;
        let name = json.name.as_deref().unwrap_or_default();
        let bus = match &json.bus {
            serde_json::Value::String(name) => name,
            bus => bus.get("name").and_then(serde_json::Value::as_str).unwrap_or_default(),
        };
        let subject = match json.address {
            Some(address) => format!("{name} @{address}"),
            None if name.is_empty() => bus.to_owned(),
            None => name.to_owned(),
        };
        Some(Self {
            gateway,
            time: if json.time.is_finite() { json.time } else { 0.0 },
            subject: shown(subject.trim_start()),
            kind: kind_of(&json),
            text: shown(&text_of(&json)),
        })
    }
}

fn kind_of(json: &EventJson) -> FleetEventKind {
    match (&*json.event, &json.finding) {
        (_, Some(finding)) => match &*finding.confidence {
            "confirmed" => FleetEventKind::Confirmed,
            "suspected" => FleetEventKind::Suspected,
            _ => FleetEventKind::Other,
        },
        ("lost" | "silent" | "stale" | "asleep", None) => FleetEventKind::Absence,
        ("bus" | "file", None) => FleetEventKind::Other,
        _ => FleetEventKind::Device,
    }
}

/// What happened, with the value that the event is about.
fn text_of(json: &EventJson) -> String {
    if let Some(finding) = &json.finding {
        return format!("{}: {}", finding.confidence, finding.text);
    }
    let from = json.from.as_ref().map(|from| match from {
        serde_json::Value::String(text) => text.clone(),
        other => other.to_string(),
    });
    let event = &json.event;
    match (&json.mode, from.filter(|from| from != "null"), &json.was) {
        (Some(mode), Some(from), _) => format!("{event} {from} → {mode}"),
        (Some(mode), None, _) => format!("{event} {mode}"),
        (None, Some(from), _) => format!("{event} from {from}"),
        (None, None, Some(was)) => format!("{event} (was {was})"),
        (None, None, None) => match json.bus.get("state").and_then(serde_json::Value::as_str) {
            Some(state) => format!("{event} {state}"),
            None => event.clone(),
        },
    }
}

/// A text of any origin as it is shown.
fn shown(text: &str) -> String {
    shortened(&printable(text.as_bytes()), MAX_TEXT)
}

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub struct FleetEventLog {
    events: VecDeque<FleetEvent>,
}

impl FleetEventLog {
    /// Takes an event; the oldest one above the bound is dropped. Returns false for what is none.
    pub(super) fn handle_event(&mut self, gateway: GatewayName, payload: &[u8]) -> bool {
        let Some(event) = FleetEvent::parse(gateway, payload) else { return false };
        self.push(event);
        true
    }

    /// Takes a change of a gateway itself, at a Unix time by this machine.
    pub(super) fn note_state(&mut self, gateway: GatewayName, time: f64, state: GatewayState) {
        let kind = match state {
            GatewayState::Lost | GatewayState::Silent => FleetEventKind::Absence,
            GatewayState::Online => FleetEventKind::Device,
            GatewayState::Stopped | GatewayState::Unknown => FleetEventKind::Other,
        };
        self.note_change(gateway, time, state.name(), kind);
    }

    /// Takes that a gateway has no documents any more, at a Unix time by this machine.
    pub(super) fn note_removed(&mut self, gateway: GatewayName, time: f64) {
        self.note_change(gateway, time, "no documents any more", FleetEventKind::Other);
    }

    fn note_change(&mut self, gateway: GatewayName, time: f64, text: &str, kind: FleetEventKind) {
        let (subject, text) = ("gateway".to_owned(), text.to_owned());
        self.push(FleetEvent { gateway, time, subject, text, kind });
    }

    fn push(&mut self, event: FleetEvent) {
        if self.events.len() == MAX_EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }

    /// The last events, of one gateway or of all; the newest first.
    pub fn last<'a>(
        &'a self,
        gateway: Option<&'a GatewayName>,
    ) -> impl Iterator<Item = &'a FleetEvent> {
        let all = self.events.iter().rev();
        all.filter(move |event| gateway.is_none_or(|it| event.gateway == *it))
    }
}
