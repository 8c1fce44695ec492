//! The text of a frame: sender, receiver, service, DES message.
//!
//! Input: a frame and the devices of its bus. A frame is decoded when it is shown, not when it is
//! received. Text from devices is escaped ([`Escaped`]).

use crate::app::buses::Buses;
use crate::error_report::ErrorReport;
use crate::frame::{CanId, Frame, FrameKind};
use crate::text::Escaped;
use crate::wire::des::{
    ReceivedRequest, Request, ServicesResponse, TYPE_NAME, TYPE_SERVICES, decode_name,
};
use crate::wire::framing::{Framing, classify_request, classify_response, strip_raw_padding};
use crate::wire::id::{Address, Header, MessageType};
use crate::wire::isotp::{FlowStatus, Pci};
use crate::wire::node::Heartbeat;
use crate::wire::profile::Profile;
use std::fmt::Write;

/// A frame as text.
#[derive(Clone, Debug, Default)]
pub struct Decoded {
    /// Fields of the identifier (CAN platform §4.1); `None` for a non-platform frame.
    pub header: Option<Header>,
    /// Sender: name, else address; empty for a non-platform frame.
    pub source: String,
    /// Receiver: name, else address; `*` for a broadcast.
    pub destination: String,
    /// Service: name, else number.
    pub service: String,
    /// Message type, `error`, `remote`, `standard`, or `foreign` for a frame of a bus that speaks
    /// another protocol.
    pub kind: &'static str,
    /// Content of the data field.
    pub text: String,
    /// An error response, a malformed or non-conforming message, or an error frame.
    pub is_error: bool,
}

impl Decoded {
    /// Decodes a frame; names and profile are those of its bus.
    pub fn new(buses: &Buses, frame: &Frame) -> Self {
        match (frame.kind, frame.id) {
            (FrameKind::Error, _) => Self {
                kind: "error",
                text: ErrorReport::of(frame).map_or(String::new(), |report| report.to_string()),
                is_error: true,
                ..Self::default()
            },
            (FrameKind::Data, CanId::Extended(_)) if buses.is_foreign(frame.bus) => {
                Self { kind: "foreign", text: "another protocol".to_owned(), ..Self::default() }
            }
            (FrameKind::Data, CanId::Extended(id)) => Self::decode_platform(buses, frame, id),
            (FrameKind::Remote, _) => {
                let text = "remote frame (non-platform)".to_owned();
                Self { kind: "remote", text, ..Self::default() }
            }
            _ => {
                let text = "11-bit ID (non-platform)".to_owned();
                Self { kind: "standard", text, ..Self::default() }
            }
        }
    }

    fn decode_platform(buses: &Buses, frame: &Frame, id: u32) -> Self {
        let header = Header::decode(id);
        let kind = header.message_type();
        let profile = buses.profile(frame.bus);
        let name = |address| buses.name_at(frame.bus, address);
        let service = match (kind, profile.service_name(header.service)) {
            (MessageType::Debug, _) => format!("{:03X}", header.service.number()),
            (_, Some(name)) => Escaped(name.as_bytes()).to_string(),
            (_, None) => header.service.to_string(),
        };
        let failed = header.response && !header.no_error && header.is_conforming();
        let (mut text, bad) = describe_data(&profile, header, frame);
        if failed {
            text.insert_str(0, if text.is_empty() { "error" } else { "error: " });
        }
        Self {
            source: name(header.source),
            destination: if header.broadcast { "*".to_owned() } else { name(header.destination) },
            service,
            kind: kind.name(),
            text,
            is_error: failed || bad || !header.is_conforming(),
            header: Some(header),
        }
    }

    /// Returns service and content as text, or the message type where there is no content.
    pub fn meaning(&self) -> String {
        let content = if self.text.is_empty() { self.kind } else { &self.text };
        match self.header {
            Some(_) => format!("{} {content}", self.service),
            None => content.to_owned(),
        }
    }

    pub(in crate::app) fn is_source(&self, value: &str) -> bool {
        let Some(header) = self.header else { return false };
        is_endpoint(&self.source, header.source, value)
    }

    pub(in crate::app) fn is_destination(&self, value: &str) -> bool {
        let Some(header) = self.header else { return false };
        if header.broadcast {
            return value == "*";
        }
        is_endpoint(&self.destination, header.destination, value)
    }

    pub(in crate::app) fn is_service(&self, value: &str) -> bool {
        let Some(header) = self.header else { return false };
        let number = match value.strip_prefix("0x") {
            Some(hex) => u16::from_str_radix(hex, 16).ok(),
            None => value.parse().ok(),
        };
        self.service.to_lowercase() == value || number == Some(header.service.number())
    }
}

fn is_endpoint(name: &str, address: Address, value: &str) -> bool {
    name.to_lowercase() == value || address.to_string() == value
}

pub(super) fn reassemble(first: &Frame, rest: impl Iterator<Item = Frame>) -> Option<Vec<u8>> {
    let Ok(Pci::First { length, data }) = Pci::decode(first.data(), first.is_fd) else {
        return None;
    };
    let wanted = (length as usize).min(crate::wire::des::MAX_MESSAGE);
    let mut message = data.to_vec();
    let mut next = 1;
    for frame in rest {
        if message.len() >= wanted {
            break;
        }
        match Pci::decode(frame.data(), frame.is_fd) {
            Ok(Pci::Consecutive { sequence, data }) if sequence == next => {
                message.extend_from_slice(data);
                next = (next + 1) & 0x0F;
            }
            Ok(Pci::First { .. }) => break,
            _ => {}
        }
    }
    message.truncate(wanted);
    Some(message)
}

/// Text of the data of a platform frame, and true if they are malformed.
fn describe_data(profile: &Profile, header: Header, frame: &Frame) -> (String, bool) {
    let data = frame.data();
    let kind = header.message_type();
    if kind == MessageType::Debug {
        return (format!("debug message {:03X}", header.service.number()), false);
    }
    if header.service == profile.heartbeat_service() && header.response {
        return (describe_heartbeat(profile, data), false);
    }
    if header.service != profile.des_service() {
        return (String::new(), false);
    }
    if !header.response {
        return match classify_request(data, frame.is_fd) {
            Some((Framing::Raw, message)) => (describe_request(message) + ", raw", false),
            Some((_, message)) => (describe_request(message), false),
            None => match Pci::decode(data, frame.is_fd) {
                Ok(Pci::Flow(flow)) => (describe_flow(flow.status).to_owned(), false),
                _ => ("not a DES request".to_owned(), true),
            },
        };
    }
    match classify_response(data, frame.is_fd, true) {
        Some(Framing::Raw) => describe_response(strip_raw_padding(data)),
        Some(Framing::Isotp) => match Pci::decode(data, frame.is_fd) {
            Ok(Pci::Single(message)) => describe_response(message),
            Ok(Pci::First { length, data }) => {
                let what = match data.first() {
                    Some(&TYPE_NAME) => "name",
                    Some(&TYPE_SERVICES) => "services",
                    _ => "message",
                };
                (format!("first frame: {what}, {length} bytes"), false)
            }
            Ok(Pci::Consecutive { sequence, .. }) => {
                (format!("consecutive frame {sequence:X}"), false)
            }
            Ok(Pci::Flow(flow)) => (describe_flow(flow.status).to_owned(), false),
            Err(fault) => (fault.to_string(), true),
        },
        None => ("neither ISO-TP nor raw".to_owned(), true),
    }
}

fn describe_flow(status: FlowStatus) -> &'static str {
    match status {
        FlowStatus::Continue => "flow control: continue",
        FlowStatus::Wait => "flow control: wait",
        FlowStatus::Overflow => "flow control: overflow",
    }
}

fn describe_request(message: &[u8]) -> String {
    match Request::decode(message) {
        Some(ReceivedRequest::Known(Request::Name)) => "name request".to_owned(),
        Some(ReceivedRequest::Known(Request::Services)) => "services request".to_owned(),
        Some(ReceivedRequest::Reserved(kind)) => format!("reserved DES request {kind:02X}"),
        None => "not a DES request".to_owned(),
    }
}

pub(super) fn describe_response(message: &[u8]) -> (String, bool) {
    match message.first() {
        Some(&TYPE_NAME) => {
            let (name, fault) = decode_name(message);
            let mut text = format!("name {}", Escaped(name.unwrap_or_default()));
            if let Some(fault) = fault {
                let _ = write!(text, " ({fault})");
            }
            (text, fault.is_some())
        }
        Some(&TYPE_SERVICES) => {
            let answer = ServicesResponse::decode(message);
            let mut text = "services".to_owned();
            let mut count = 0;
            for service in answer.services() {
                let separator = if count == 0 { ": " } else { ", " };
                count += 1;
                let (name, version) = (Escaped(service.name()), Escaped(service.version()));
                let _ = write!(text, "{separator}{name} {version}");
            }
            if count == 0 {
                text.push_str(": none");
            }
            if let Some(fault) = answer.fault() {
                let _ = write!(text, " ({fault})");
            }
            (text, answer.fault().is_some())
        }
        _ => ("not a DES response".to_owned(), true),
    }
}

fn describe_heartbeat(profile: &Profile, data: &[u8]) -> String {
    let beat = Heartbeat::decode(data, &profile.heartbeat, &profile.modes.codes());
    let mut text = "heartbeat".to_owned();
    if let Some(mode) = beat.mode {
        let _ = write!(text, " {mode}");
    }
    if let Some(uid) = beat.uid.filter(|uid| !uid.is_blank()) {
        let _ = write!(text, " {}", Escaped(uid.text(&profile.uid).to_string().as_bytes()));
    }
    if let Some(error) = beat.error.filter(|error| *error != 0) {
        let _ = write!(text, " error {error}");
    }
    text
}
