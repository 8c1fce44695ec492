//! What a frame says, in words: who to whom, which service, which DES message.
//!
//! A frame is decoded when it is looked at, never when it arrives. Everything that devices say
//! comes out through [`Escaped`]. Does not know how it is drawn.

use super::{App, Filter, Page};
use crate::discovery::Device;
use crate::error_report::ErrorReport;
use crate::frame::{BusIndex, CanId, Frame, FrameKind};
use crate::text::Escaped;
use crate::time::Instant;
use crate::wire::des::{
    ReceivedRequest, Request, ServicesResponse, TYPE_NAME, TYPE_SERVICES, decode_name,
};
use crate::wire::framing::{Framing, classify_request, classify_response, strip_raw_padding};
use crate::wire::id::{Address, Header, MessageType};
use crate::wire::isotp::{FlowStatus, Pci};
use crate::wire::node::Heartbeat;
use crate::wire::profile::Profile;
use std::collections::VecDeque;
use std::fmt::Write;

/// A frame in words.
#[derive(Clone, Debug, Default)]
pub struct Decoded {
    /// The identifier's fields, where the frame has any.
    pub header: Option<Header>,
    /// Who sent it: the name, else the address; empty for foreign frames.
    pub source: String,
    /// To whom: the name, else the address; `*` for all.
    pub destination: String,
    /// The service: its name, else its number.
    pub service: String,
    /// The message type, or what else it is.
    pub kind: &'static str,
    /// What its data say.
    pub text: String,
    /// A failed answer, a malformed message or an error frame.
    pub is_error: bool,
}

impl Decoded {
    /// Reads a frame.
    pub fn of(app: &App, frame: &Frame) -> Self {
        match (frame.kind, frame.id) {
            (FrameKind::Error, _) => Self {
                kind: "error",
                text: ErrorReport::of(frame).map_or(String::new(), |report| report.to_string()),
                is_error: true,
                ..Self::default()
            },
            (FrameKind::Data, CanId::Extended(id)) => Self::decode_platform(app, frame, id),
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

    fn decode_platform(app: &App, frame: &Frame, id: u32) -> Self {
        let header = Header::decode(id);
        let kind = header.message_type();
        let profile = app.profile(frame.bus);
        let name = |address| app.name_at(frame.bus, address);
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

    pub(super) fn is_source(&self, value: &str) -> bool {
        let Some(header) = self.header else { return false };
        is_endpoint(&self.source, header.source, value)
    }

    pub(super) fn is_destination(&self, value: &str) -> bool {
        let Some(header) = self.header else { return false };
        if header.broadcast {
            return value == "*";
        }
        is_endpoint(&self.destination, header.destination, value)
    }

    pub(super) fn is_service(&self, value: &str) -> bool {
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

/// The captured frames that the filter line lets through: found once per frame, not per draw.
#[derive(Debug, Default)]
pub(super) struct FilteredFrames {
    line: String,
    numbers: VecDeque<u64>,
    /// Frames before this number were looked at.
    seen: u64,
}

impl App {
    /// The profile that a bus runs on.
    pub fn profile(&self, bus: BusIndex) -> std::sync::Arc<Profile> {
        self.bus(bus).map_or_else(Default::default, |bus| bus.engine.config().profile.clone())
    }

    /// Whoever holds an address now: its name, else the number.
    pub fn name_at(&self, bus: BusIndex, address: Address) -> String {
        let here = |device: &&Device| device.address == address && device.is_present();
        let devices = self.bus(bus).map_or(&[][..], |bus| bus.engine.devices());
        let named = devices.iter().filter(here).find_map(|device| device.name.as_ref());
        match named {
            Some(name) => name.to_string(),
            None if self.is_own_address(bus, address) => "own".to_owned(),
            None => address.to_string(),
        }
    }

    /// The whole ISO 15765-2 message that a frame is part of, in words, where the capture still
    /// has it.
    pub fn message_of(&self, number: u64) -> Option<String> {
        let frame = self.capture.get(number)?;
        let id = frame.platform_id()?;
        if Header::decode(id).service != self.profile(frame.bus).des_service() {
            return None;
        }
        let same = |other: &&Frame| other.bus == frame.bus && other.platform_id() == Some(id);
        let is_first =
            |other: &&Frame| matches!(Pci::decode(other.data(), other.fd), Ok(Pci::First { .. }));
        if !matches!(
            Pci::decode(frame.data(), frame.fd),
            Ok(Pci::First { .. } | Pci::Consecutive { .. })
        ) {
            return None;
        }
        let (start, first) = (self.capture.first()..=number)
            .rev()
            .take(4096)
            .filter_map(|at| Some((at, self.capture.get(at)?)))
            .filter(|(_, other)| same(other))
            .find(|(_, other)| is_first(other))?;
        let message = reassemble(
            first,
            (start + 1..self.capture.end())
                .take(4096)
                .filter_map(|at| self.capture.get(at))
                .filter(same),
        )?;
        Some(describe_response(&message).0)
    }

    /// The numbers of the frames that the filter lets through, from `number` on, oldest first.
    pub fn frames_from(&self, number: u64) -> Box<dyn Iterator<Item = u64> + '_> {
        let (first, end) = (number.max(self.capture.first()), self.traffic_end());
        if !self.is_filtered() {
            return Box::new(first..end);
        }
        let numbers = &self.matches.numbers;
        let start = numbers.partition_point(|&other| other < first);
        Box::new(numbers.range(start..).copied().take_while(move |&number| number < end))
    }

    /// The same before `number`, newest first.
    pub fn frames_before(&self, number: u64) -> Box<dyn Iterator<Item = u64> + '_> {
        let (first, end) = (self.capture.first(), number.min(self.traffic_end()));
        if !self.is_filtered() {
            return Box::new((first..end).rev());
        }
        let numbers = &self.matches.numbers;
        let stop = numbers.partition_point(|&other| other < end);
        Box::new(numbers.range(..stop).rev().copied().take_while(move |&number| number >= first))
    }

    /// Whether the filter line chooses frames: around evidence all are shown.
    fn is_filtered(&self) -> bool {
        !self.view.filter(Page::Traffic).is_empty() && self.view.evidence.is_none()
    }

    /// Filters the frames that came since it was done last, where that is to be seen.
    pub(super) fn filter_frames(&mut self) {
        let line = self.view.filter(Page::Traffic);
        if self.view.page != Page::Traffic || line.is_empty() {
            return;
        }
        let mut matches = std::mem::take(&mut self.matches);
        if matches.line != line {
            matches = FilteredFrames { line: line.to_owned(), ..FilteredFrames::default() };
        }
        let (first, end) = (self.capture.first(), self.capture.end());
        while matches.numbers.front().is_some_and(|&number| number < first) {
            matches.numbers.pop_front();
        }
        let filter = Filter::parse(line);
        for number in matches.seen.max(first)..end {
            let frame = self.capture.get(number);
            if frame.is_some_and(|frame| filter.matches_frame(self, frame)) {
                matches.numbers.push_back(number);
            }
        }
        matches.seen = end;
        self.matches = matches;
    }

    /// Behind the last frame that is shown: a held page stays where it is.
    pub fn traffic_end(&self) -> u64 {
        self.view.frozen.map_or(self.capture.end(), |frozen| frozen.frames)
    }

    /// The frames on the screen, oldest first, and which of them is selected.
    pub fn frames_shown(&self, height: usize) -> (Vec<u64>, Option<u64>) {
        let end = self.traffic_end();
        let kept = |number: &u64| *number >= self.capture.first() && *number < end;
        let Some(selected) = self.view.traffic.filter(kept) else {
            let mut shown: Vec<u64> = self.frames_before(end).take(height).collect();
            shown.reverse();
            return (shown, None);
        };
        let above = self.view.traffic_line.min(height.saturating_sub(1));
        let mut shown: Vec<u64> = self.frames_before(selected).take(above).collect();
        shown.reverse();
        shown.push(selected);
        let below = height.saturating_sub(shown.len());
        shown.extend(self.frames_from(selected + 1).take(below));
        if shown.len() < height {
            let missing = height - shown.len();
            let mut older: Vec<u64> = self.frames_before(shown[0]).take(missing).collect();
            older.reverse();
            older.append(&mut shown);
            shown = older;
        }
        (shown, Some(selected))
    }
}

fn reassemble<'f>(first: &Frame, rest: impl Iterator<Item = &'f Frame>) -> Option<Vec<u8>> {
    let Ok(Pci::First { length, data }) = Pci::decode(first.data(), first.fd) else { return None };
    let wanted = (length as usize).min(crate::wire::des::MAX_MESSAGE);
    let mut message = data.to_vec();
    let mut next = 1;
    for frame in rest {
        if message.len() >= wanted {
            break;
        }
        match Pci::decode(frame.data(), frame.fd) {
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

/// What the data of a platform frame say, and whether something is wrong with them.
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
        return match classify_request(data, frame.fd) {
            Some((_, message)) => (describe_request(message), false),
            None => match Pci::decode(data, frame.fd) {
                Ok(Pci::Flow(flow)) => (describe_flow(flow.status).to_owned(), false),
                _ => ("not a DES request".to_owned(), true),
            },
        };
    }
    match classify_response(data, frame.fd, true) {
        Some(Framing::Raw) => describe_response(strip_raw_padding(data)),
        Some(Framing::Isotp) => match Pci::decode(data, frame.fd) {
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

fn describe_response(message: &[u8]) -> (String, bool) {
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

/// Bytes in hexadecimal, with something between them.
pub fn hex(data: &[u8], between: &str) -> String {
    let mut text = String::with_capacity(data.len() * (2 + between.len()));
    for (at, byte) in data.iter().enumerate() {
        let between = if at == 0 { "" } else { between };
        let _ = write!(text, "{between}{byte:02X}");
    }
    text
}

/// A moment as the wall clock shows it: `12:03:11`.
pub fn clock(app: &App, at: Instant) -> String {
    let seconds = app.wall_seconds(at);
    format!("{:02}:{:02}:{:02}", seconds / 3600 % 24, seconds / 60 % 60, seconds % 60)
}

/// The same with milliseconds: `12:03:11.204`.
pub fn clock_millis(app: &App, at: Instant) -> String {
    let millis = app.epoch().unix_micros(at) / 1000 % 1000;
    format!("{}.{millis:03}", clock(app, at))
}
