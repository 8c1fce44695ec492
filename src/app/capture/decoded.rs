//! The text of a frame: sender, receiver, service, DES message.
//!
//! Input: a frame and the devices of its bus. A frame is decoded when it is shown, not when it is
//! received. Text from devices is escaped ([`Escaped`]).

use super::configuration_text::configuration_text;
use crate::app::buses::{Buses, FrameTypes};
use crate::error_report::ErrorReport;
use crate::frame::{CanId, Frame, FrameKind};
use crate::text::Escaped;
use crate::wire::des::{
    ReceivedRequest, Request, ServicesResponse, TYPE_NAME, TYPE_SERVICES, decode_name,
};
use crate::wire::framing::{Framing, classify_request, classify_response, strip_raw_padding};
use crate::wire::id::{Header, MessageType};
use crate::wire::isotp::{FlowStatus, Pci};
use crate::wire::node::Uid;
use crate::wire::profile::Profile;
use std::fmt::Write;
use unicode_width::UnicodeWidthStr;

/// What a frame is, as the KIND column shows it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum FrameRole {
    /// Request.
    Request,
    /// Response to a request.
    Response,
    /// Response with ERR = 0: an error.
    FailedResponse,
    /// Response that no request asked for: unsolicited data.
    Unsolicited,
    /// Debug message.
    Debug,
    /// Platform frame of none of the nine message types.
    NonConforming,
    /// Error frame of the controller.
    Error,
    /// Data frame with an 11-bit identifier.
    #[default]
    Standard,
    /// Remote frame.
    Remote,
    /// Data frame of a bus that speaks another protocol.
    Foreign,
}

impl FrameRole {
    /// All roles.
    pub const ALL: [Self; 10] = [
        Self::Request,
        Self::Response,
        Self::FailedResponse,
        Self::Unsolicited,
        Self::Debug,
        Self::NonConforming,
        Self::Error,
        Self::Standard,
        Self::Remote,
        Self::Foreign,
    ];

    /// Returns the role of a frame; `is_foreign`: its bus speaks another protocol.
    pub const fn of(frame: &Frame, is_foreign: bool) -> Self {
        match (frame.kind, frame.id) {
            (FrameKind::Error, _) => Self::Error,
            (FrameKind::Remote, _) => Self::Remote,
            (FrameKind::Data, CanId::Standard(_)) => Self::Standard,
            (FrameKind::Data, CanId::Extended(_)) if is_foreign => Self::Foreign,
            (FrameKind::Data, CanId::Extended(id)) => Self::of_header(Header::decode(id)),
        }
    }

    const fn of_header(header: Header) -> Self {
        use MessageType as T;
        match header.message_type() {
            T::ReqCcTgt | T::ReqCcBcst | T::ReqCuTgt | T::ReqCuBcst => Self::Request,
            T::RspCcTgt | T::RspCuTgt if header.no_error => Self::Response,
            T::RspCcTgt | T::RspCuTgt => Self::FailedResponse,
            T::RspCcUnsc | T::RspCuUnsc => Self::Unsolicited,
            T::Debug => Self::Debug,
            T::NonConforming => Self::NonConforming,
        }
    }

    /// Word in the KIND column.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Request => "req",
            Self::Response => "rsp",
            Self::FailedResponse => "rsp✗",
            Self::Unsolicited => "data",
            Self::Debug => "dbg",
            Self::NonConforming => "odd",
            Self::Error => "ERR",
            Self::Standard => "std",
            Self::Remote => "rtr",
            Self::Foreign => "29b",
        }
    }

    /// Word of `type:` in a filter.
    pub const fn type_word(self) -> &'static str {
        match self {
            Self::FailedResponse => "failed",
            Self::Error => "err",
            Self::Foreign => "foreign",
            _ => self.word(),
        }
    }

    /// Words of a filter, of which the beginning is enough.
    pub const fn words(self) -> &'static [&'static str] {
        match self {
            Self::Request => &["req", "request"],
            Self::Response => &["rsp", "response"],
            Self::FailedResponse => &["failed", "rsp✗", "response"],
            Self::Unsolicited => &["data", "unsolicited"],
            Self::Debug => &["dbg", "debug"],
            Self::NonConforming => &["odd", "nonconforming", "non-conforming"],
            Self::Error => &["err", "error"],
            Self::Standard => &["std", "standard"],
            Self::Remote => &["rtr", "remote"],
            Self::Foreign => &["foreign"],
        }
    }
}

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
    /// What the frame is.
    pub role: FrameRole,
    /// Message type, `error`, `remote`, `standard`, or `foreign` for a frame of a bus that speaks
    /// another protocol.
    pub kind: &'static str,
    /// Content of the data field.
    pub text: String,
    /// An error response, a malformed or non-conforming message, or an error frame.
    pub is_error: bool,
    /// Name of the message of a DBC file, of a non-platform frame; empty without one.
    pub message: String,
}

/// What a frame means, without the names of its sender and its receiver.
#[derive(Clone, Debug)]
pub struct FrameMeaning {
    /// Fields of the identifier (CAN platform §4.1); `None` for a non-platform frame.
    pub header: Option<Header>,
    /// What the frame is.
    pub role: FrameRole,
    /// Content of the data field; empty if it has no known one.
    pub text: String,
    /// An error response, a malformed or non-conforming message, or an error frame.
    pub is_error: bool,
}

impl FrameMeaning {
    /// Decodes a frame with the profile of its bus.
    pub(in crate::app) fn new(buses: &Buses, frame: &Frame) -> Self {
        let role = FrameRole::of(frame, buses.is_foreign(frame.bus));
        let header = match (role, frame.id) {
            (
                FrameRole::Error | FrameRole::Remote | FrameRole::Standard | FrameRole::Foreign,
                _,
            )
            | (_, CanId::Standard(_)) => {
                let text = meaning_of(frame, role, None, buses.frame_types(None, frame));
                return Self { header: None, role, text, is_error: role == FrameRole::Error };
            }
            (_, CanId::Extended(id)) => Header::decode(id),
        };
        let types = buses.frame_types(Some(header), frame);
        if let Some(message) = types.message() {
            let text = message.in_words(frame.data());
            return Self { header: Some(header), role, text, is_error: false };
        }
        let (text, bad) = match buses.get(frame.bus) {
            Some(bus) => describe_message(&bus.config().profile, types, header, frame),
            None => describe_message(&Profile::default(), types, header, frame),
        };
        let is_error = is_failed(header) || bad || !header.is_conforming();
        Self { header: Some(header), role, text, is_error }
    }
}

impl Decoded {
    /// Decodes a frame; names and profile are those of its bus, names as of its time.
    pub fn new(buses: &Buses, frame: &Frame) -> Self {
        let FrameMeaning { header, role, text, is_error } = FrameMeaning::new(buses, frame);
        let Some(header) = header else {
            let kind = match role {
                FrameRole::Error => "error",
                FrameRole::Remote => "remote",
                FrameRole::Foreign => "foreign",
                _ => "standard",
            };
            let message = buses.frame_types(None, frame).message();
            let message = message.map_or(String::new(), |it| it.name().to_owned());
            return Self { role, kind, text, is_error, message, ..Self::default() };
        };
        let kind = header.message_type();
        let name = |address| buses.name_at(frame.bus, address, frame.time);
        let server = if header.response { header.source } else { header.destination };
        let server = (header.response || !header.broadcast).then_some((server, frame.time));
        let service = match buses.service_name(frame.bus, header.service, server) {
            Some(name) if kind != MessageType::Debug => Escaped(name.as_bytes()).to_string(),
            _ => header.service.to_string(),
        };
        Self {
            source: name(header.source),
            destination: if header.broadcast { "*".to_owned() } else { name(header.destination) },
            service,
            kind: kind.name(),
            text,
            is_error,
            header: Some(header),
            role,
            message: String::new(),
        }
    }

    /// Returns the text without the name of the message, which is shown before it if it fits `width` cells.
    pub fn text_after_name(&self, width: usize) -> &str {
        if self.message.is_empty() || self.message.width() > width {
            return &self.text;
        }
        let rest = self.text.strip_prefix(&self.message);
        rest.map_or(&self.text, |rest| rest.strip_prefix(": ").unwrap_or(rest))
    }

    /// Returns service and content as text, or the message type where there is no content.
    pub fn meaning(&self) -> String {
        let content = if self.text.is_empty() { self.kind } else { &self.text };
        match self.header {
            Some(_) => format!("{} {content}", self.service),
            None => content.to_owned(),
        }
    }
}

/// Returns true if a frame is an error response.
fn is_failed(header: Header) -> bool {
    header.response && !header.no_error && header.is_conforming()
}

/// The meaning of a frame in words; empty if there is none. `profile` is that of its bus, `types` what
/// the catalogue says about it.
pub(in crate::app) fn meaning_of(
    frame: &Frame,
    role: FrameRole,
    profile: Option<&Profile>,
    types: FrameTypes<'_>,
) -> String {
    if let Some(message) = types.message() {
        return message.in_words(frame.data());
    }
    match (role, frame.id, profile) {
        (FrameRole::Error, ..) => {
            ErrorReport::of(frame).map_or(String::new(), |report| report.to_string())
        }
        (FrameRole::Foreign, ..) => "another protocol".to_owned(),
        (FrameRole::Remote, ..) => "remote frame".to_owned(),
        (FrameRole::Standard, ..) => "11-bit ID".to_owned(),
        (_, CanId::Extended(id), Some(profile)) => {
            describe_message(profile, types, Header::decode(id), frame).0
        }
        _ => String::new(),
    }
}

/// The meaning of a platform frame, and true if it is malformed.
pub(in crate::app) fn describe_message(
    profile: &Profile,
    types: FrameTypes<'_>,
    header: Header,
    frame: &Frame,
) -> (String, bool) {
    let (mut text, bad) = describe_data(profile, types, header, frame);
    if is_failed(header) {
        text.insert_str(0, if text.is_empty() { "error" } else { "error: " });
    }
    (text, bad)
}

/// Text of a UID, escaped.
pub(in crate::app) fn uid_text(profile: &Profile, uid: Uid) -> String {
    Escaped(uid.text(&profile.uid).to_string().as_bytes()).to_string()
}

/// Text of the data of a platform frame, and true if they are malformed.
pub(in crate::app) fn describe_data(
    profile: &Profile,
    types: FrameTypes<'_>,
    header: Header,
    frame: &Frame,
) -> (String, bool) {
    let data = frame.data();
    let kind = header.message_type();
    if kind == MessageType::Debug {
        let text = types.debug_text(profile, header.service, data);
        return (format!("debug message {text}"), false);
    }
    if header.service == profile.heartbeat_service() && header.response {
        return (describe_heartbeat(profile, data), false);
    }
    if header.service != profile.des_service() {
        // The data of an error response are its code.
        let is_described = !is_failed(header) && header.is_conforming();
        let words = if is_described { types.data_in_words(header, data) } else { None };
        let configuration = || configuration_text(profile, header, data).filter(|_| is_described);
        return (words.or_else(configuration).unwrap_or_default(), false);
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

/// Meaning of a DES response in a few words: of services their number.
pub fn summary_of(message: &[u8]) -> String {
    match message.first() {
        Some(&TYPE_SERVICES) => match ServicesResponse::decode(message).services().count() {
            1 => "1 service".to_owned(),
            count => format!("{count} services"),
        },
        _ => describe_response(message).0,
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
    let beat = profile.heartbeat_of(data);
    let mut text = "heartbeat".to_owned();
    if let Some(mode) = beat.mode {
        let _ = write!(text, " {mode}");
    }
    if let Some(uid) = beat.uid.filter(|uid| !uid.is_blank()) {
        let _ = write!(text, " {}", uid_text(profile, uid));
    }
    if let Some(error) = beat.error.filter(|error| *error != 0) {
        let _ = write!(text, " error {error}");
    }
    text
}
