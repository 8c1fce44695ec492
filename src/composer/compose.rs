//! Frames of a composition, with their meaning and what to consider before they are sent.

use super::changes::change_of;
use super::fields::{
    TypedReceiver, TypedSender, Who, data, not_working_column, sender, service, target,
};
use super::{Composition, CompositionField, KnownNode, MessageKind, Mistake, Surroundings};
use crate::diagnostic::nearest_word;
use crate::frame::{Frame, FrameKind};
use crate::log::candump::{LineFault, parse_frame};
use crate::text::{counted, hex, join_first, printable};
use crate::wire::des::{ReceivedRequest, Request};
use crate::wire::descriptor::AddressSetting;
use crate::wire::framing::{Framing, classify_request};
use crate::wire::id::{Address, Header, MessageType, Service};
use crate::wire::isotp::{self, Pci};
use crate::wire::profile::{FramingChoice, Profile};

/// Devices that a mistake names.
const NAMED_DEVICES: usize = 8;
/// Most bytes of a message in one ISO-TP frame, classic and FD.
const SINGLE: [usize; 2] = [7, 62];

/// To whom the frames of a composition go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Receivers {
    /// One node: a request to it is to be answered.
    One(Address),
    /// All nodes that are of its kind.
    All,
    /// It does not say: not a frame of the platform.
    Unknown,
}

/// What a composition makes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Composed {
    /// The frames: one, or two to all nodes, working and not working.
    pub frames: Vec<Frame>,
    /// What they are, in words.
    pub meaning: String,
    /// To whom they go.
    pub receivers: Receivers,
    /// The receiver in words: `ACT @14`, `all working devices`.
    pub receiver: String,
    /// What is known of the one receiver.
    pub receiver_node: Option<KnownNode>,
    /// What they change in a device; `None`: nothing that the profile knows of.
    pub change: Option<String>,
    /// The sender, unless it is descan's own address: the device there gives the address up.
    pub foreign_source: Option<Address>,
    /// What becomes of the device at the foreign source; empty without one.
    pub source_warning: String,
    /// descan's own address when it was composed.
    pub own: Option<Address>,
    /// What to consider.
    pub warnings: Vec<String>,
}

impl Composed {
    /// The frames as candump writes them.
    pub fn frame_text(&self) -> String {
        let all: Vec<String> = self.frames.iter().map(ToString::to_string).collect();
        all.join(" and ")
    }

    /// Returns true if one node must answer.
    pub fn needs_answer(&self) -> bool {
        let is_request = |frame: &Frame| {
            frame.platform_id().is_some_and(|id| {
                let header = Header::decode(id);
                !header.response && !header.broadcast && header.is_conforming()
            })
        };
        self.frames.iter().any(is_request)
    }

    /// Returns true if nodes may answer.
    pub fn may_be_answered(&self) -> bool {
        let id = self.frames.first().and_then(Frame::platform_id);
        id.is_some_and(|id| !Header::decode(id).response)
    }

    /// Returns true if the DST of the frames is a random number, which each copy has anew.
    pub fn has_random_destination(&self, composition: &Composition) -> bool {
        let is_typed = composition.to.to_lowercase().contains("rnd");
        let id = self.frames.first().and_then(Frame::platform_id);
        composition.kind != MessageKind::Raw
            && composition.kind != MessageKind::Debug
            && !is_typed
            && id.is_some_and(|id| Header::decode(id).broadcast)
    }
}

impl Composition {
    /// Makes its frames.
    ///
    /// # Errors
    ///
    /// The first mistake, in the order of the fields.
    pub fn compose(&self, around: Surroundings<'_>) -> Result<Composed, Mistake> {
        let frames = match self.kind {
            MessageKind::Raw => vec![self.raw_frame()?],
            _ => self.frames(around)?,
        };
        Ok(composed(frames, around))
    }

    fn raw_frame(&self) -> Result<Frame, Mistake> {
        let wrong = |text: String| Err(Mistake::new(CompositionField::Data, 0, text));
        let text = self.data.trim();
        if text.is_empty() {
            return wrong("a frame is needed: 051C0002#0444455301".to_owned());
        }
        match parse_frame(text.as_bytes()) {
            Ok(frame) if frame.kind == FrameKind::Remote => {
                wrong("a remote frame: the platform has none, it is not sent".to_owned())
            }
            Ok(frame) if frame.kind == FrameKind::Error => {
                wrong("an error frame is a report of a controller: it is not sent".to_owned())
            }
            // The time, as that of a raw DLC, is not part of it.
            Ok(frame) => Ok(frame),
            Err(why) => {
                let why = match why {
                    LineFault::Frame => "a frame is ID#DATA: 051C0002#0444455301".to_owned(),
                    why => why.to_string(),
                };
                wrong(format!("{}: {why}", printable(text.as_bytes())))
            }
        }
    }

    fn frames(&self, around: Surroundings<'_>) -> Result<Vec<Frame>, Mistake> {
        let target = if self.kind.has(CompositionField::To) {
            target(&self.to)?
        } else {
            TypedReceiver::None
        };
        let service = service(&self.service, around.profile, self.kind)?;
        let message = data(&self.data, service, self.kind, around.profile)?;
        let TypedSender { address, not_working } = sender(&self.from)?;
        let source = address.or(around.own).unwrap_or(Address::DEBUG);
        let mut header = Header::request(source, Address::MAX, false, service);
        header.from_non_working = not_working;
        let (headers, node) = match self.kind {
            MessageKind::Request => {
                if not_working {
                    let text = "a request is sent by a working node: not-working is for responses \
                                and unsolicited data";
                    return Err(Mistake::new(CompositionField::From, 0, text));
                }
                header.no_error = around.profile.request_err;
                request_headers(header, &target, around)?
            }
            MessageKind::Response => {
                (header.response, header.no_error) = (true, !self.is_error);
                if let Some(column) = not_working_column(&self.to) {
                    let text = "a response has D = 0 whatever the receiver is: not-working is for \
                                requests";
                    return Err(Mistake::new(CompositionField::To, column, text));
                }
                let (destination, node, _) = receiver(&target, around)?;
                header.destination = destination;
                (vec![header], node)
            }
            MessageKind::Unsolicited => {
                let rnd7 = match target {
                    TypedReceiver::None => around.rnd7,
                    TypedReceiver::All { works: None, rnd7 } => rnd7.unwrap_or(around.rnd7),
                    TypedReceiver::All { .. } | TypedReceiver::One { .. } => {
                        let text = "unsolicited data goes to all: leave it empty, or rnd 85";
                        return Err(Mistake::new(CompositionField::To, 0, text));
                    }
                };
                (header.response, header.broadcast) = (true, true);
                header.no_error = !self.is_error;
                header.destination = Address::from_bits(rnd7);
                (vec![header], None)
            }
            MessageKind::Debug | MessageKind::Raw => {
                header.from_non_working = true;
                header.to_non_working = true;
                (header.response, header.broadcast, header.no_error) = (true, true, true);
                (vec![header], None)
            }
        };
        let framing = self.framing_for(service, node, around.profile);
        let content = self.content(&message, framing)?;
        let padding = around.profile.isotp.fd_padding;
        let frame = |header: Header| {
            if self.is_fd {
                Frame::fd(header.encode(), &content, padding)
            } else {
                Frame::classic(header.encode(), &content)
            }
        };
        Ok(headers.into_iter().map(frame).collect())
    }

    /// Of DES that of the receiver, or of the profile; of other services the bytes are the data.
    fn framing_for(
        &self,
        service: Service,
        node: Option<&KnownNode>,
        profile: &Profile,
    ) -> Framing {
        let has_framing = self.kind.has(CompositionField::Framing);
        let usual = if service != profile.des_service() || !has_framing {
            Framing::Raw
        } else {
            let known = node.and_then(|node| node.framing);
            known.unwrap_or(match profile.framing {
                FramingChoice::Raw => Framing::Raw,
                FramingChoice::Isotp | FramingChoice::Auto => Framing::Isotp,
            })
        };
        self.framing.filter(|_| has_framing).unwrap_or(usual)
    }

    /// The data of the frame.
    fn content(&self, message: &[u8], framing: Framing) -> Result<Vec<u8>, Mistake> {
        let wrong = |text: String| Err(Mistake::new(CompositionField::Data, 0, text));
        let is_fd = self.is_fd;
        let count = counted(message.len() as u64, "byte");
        if framing == Framing::Raw {
            let most = if is_fd { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA };
            return if message.len() <= most {
                Ok(message.to_vec())
            } else {
                let more = if is_fd { "" } else { "; with canfd 64" };
                wrong(format!("{count}: a frame holds {most}{more}"))
            };
        }
        if message.is_empty() {
            return wrong("no data: ISO-TP needs at least one byte".to_owned());
        }
        let most = SINGLE[usize::from(is_fd)];
        match isotp::single_frame(message, is_fd) {
            Some(segment) => Ok(segment.as_bytes().to_vec()),
            None => wrong(format!(
                "{count}: one ISO-TP frame holds {most}; transfers of several frames are not sent"
            )),
        }
    }
}

/// The headers of a request, and its receiver.
fn request_headers<'a>(
    header: Header,
    to: &TypedReceiver,
    around: Surroundings<'a>,
) -> Result<(Vec<Header>, Option<&'a KnownNode>), Mistake> {
    let TypedReceiver::All { works, rnd7 } = to else {
        let (destination, node, works) = receiver(to, around)?;
        let to_non_working = !works.or(node.map(|node| node.is_working)).unwrap_or(true);
        return Ok((vec![Header { to_non_working, destination, ..header }], node));
    };
    let destination = Address::from_bits(rnd7.unwrap_or(around.rnd7));
    let to_all =
        |works: bool| Header { broadcast: true, destination, to_non_working: !works, ..header };
    Ok((works.map_or_else(|| vec![to_all(true), to_all(false)], |works| vec![to_all(works)]), None))
}

/// The one receiver, the node if it is known, and whether it works, as typed.
fn receiver<'a>(
    to: &TypedReceiver,
    around: Surroundings<'a>,
) -> Result<(Address, Option<&'a KnownNode>, Option<bool>), Mistake> {
    let wrong = |column, text: String| Mistake::new(CompositionField::To, column, text);
    let (who, works, column) = match to {
        TypedReceiver::One { who, works, column } => (who, *works, *column),
        TypedReceiver::None => {
            return Err(wrong(0, "a receiver is needed: a name, UID or address".to_owned()));
        }
        TypedReceiver::All { .. } => {
            return Err(wrong(0, "a response goes to one node: a name, UID or address".to_owned()));
        }
    };
    let name = match who {
        Who::Address(address) => return Ok((*address, around.node(*address), works)),
        Who::Named(name) => name,
    };
    let found = around.named(name);
    match &found[..] {
        [node] => Ok((node.address, Some(node), works)),
        [] => {
            let shown = printable(name.as_bytes());
            let known: Vec<&str> =
                around.nodes.iter().filter_map(|node| node.name.as_deref()).collect();
            let all = around.nodes.iter().map(KnownNode::label).collect();
            let text = match known.len() {
                0 => format!("{shown} was not found: an address is @12"),
                _ => format!(
                    "{shown} was not found; there are {}",
                    join_first(all, NAMED_DEVICES, ", ")
                ),
            };
            let lower: Vec<String> = known.iter().map(|it| it.to_lowercase()).collect();
            let all_names = lower.iter().map(String::as_str);
            let near = nearest_word(&name.to_lowercase(), all_names);
            let near = near.and_then(|near| lower.iter().position(|it| it == near));
            let text = match near {
                Some(at) => format!("{text}; did you mean {}?", known[at]),
                None => text,
            };
            Err(Mistake { is_of_bus: true, ..wrong(column, text) })
        }
        several => {
            let places = several.iter().map(|node| format!("at {}", node.address)).collect();
            let places = join_first(places, NAMED_DEVICES, " and ");
            let text = format!(
                "several devices are {}, {places}: give the address of one, as @12",
                printable(name.as_bytes())
            );
            Err(Mistake { is_of_bus: true, ..wrong(column, text) })
        }
    }
}

/// Says what frames are and do.
fn composed(frames: Vec<Frame>, around: Surroundings<'_>) -> Composed {
    let mut composed = Composed {
        meaning: String::new(),
        receivers: Receivers::Unknown,
        receiver: "the bus".to_owned(),
        receiver_node: None,
        change: None,
        foreign_source: None,
        source_warning: String::new(),
        own: around.own,
        warnings: Vec::new(),
        frames,
    };
    let Some(first) = composed.frames.first().copied() else { return composed };
    let Some(id) = first.platform_id() else {
        composed.meaning = format!("11-bit identifier {}, data {}", first.id, shown_data(&first));
        composed.warnings.push("not of the platform: it has 29-bit identifiers only".to_owned());
        return composed;
    };
    let header = Header::decode(id);
    let meanings = composed.frames.iter().map(|frame| meaning(frame, around));
    composed.meaning = meanings.collect::<Vec<_>>().join("; and ");
    composed.foreign_source =
        Some(header.source).filter(|source| around.own.is_some_and(|own| own != *source));
    if let Some(source) = composed.foreign_source {
        composed.source_warning = source_warning(source, header.from_non_working, around);
    }
    let warnings = &mut composed.warnings;
    if !header.is_conforming() {
        let what = if header.message_type() == MessageType::Debug {
            "a debug message has DST 127"
        } else {
            "its flags are those of no message type"
        };
        warnings.push(format!("non-conforming: {what}; descan and devices may not read it"));
        return composed;
    }
    let message = message_of(&first, header, around.profile);
    if header.broadcast {
        composed.receivers = Receivers::All;
        let receiver = match (header.response, composed.frames.len(), header.to_non_working) {
            (true, ..) => "all",
            (_, 2.., _) => "all devices",
            (.., true) => "all devices that do not work",
            _ => "all working devices",
        };
        receiver.clone_into(&mut composed.receiver);
    } else {
        composed.receivers = Receivers::One(header.destination);
        warn_of_receiver(&mut composed, header, around);
    }
    composed.change = change_of(header, &message, around.profile);
    warn_of_content(&mut composed.warnings, header, &first, around);
    composed
}

/// What a frame from the address of another node does to that (CAN platform §3.2.4.4).
fn source_warning(source: Address, is_non_working: bool, around: Surroundings<'_>) -> String {
    let node = around.node(source);
    let who = node.map_or(format!("a device at {source}"), KnownNode::label);
    let doubt = if node.is_some() { "" } else { "; none is known there now" };
    match node {
        Some(node) if is_non_working && node.is_working => format!(
            "The source address is {source}, not descan's own: {who} works and keeps it, as U is 1; \
             in CFG or BOOT it would give its address up"
        ),
        _ => format!(
            "The source address is {source}, not descan's own: {who} will give its address up{doubt}"
        ),
    }
}

fn warn_of_receiver(composed: &mut Composed, header: Header, around: Surroundings<'_>) {
    let address = header.destination;
    let node = around.node(address);
    composed.receiver = node.map_or(format!("@{address}"), KnownNode::label);
    let warnings = &mut composed.warnings;
    match node {
        _ if around.own == Some(address) => {
            warnings.push(format!("{address} is descan's own address: no device is there"));
        }
        None => warnings.push(format!("no device is known at {address}")),
        Some(node) if node.boards > 1 && !header.response => {
            let boards = if node.boards == 2 { "two".to_owned() } else { node.boards.to_string() };
            warnings
                .push(format!("{boards} boards have address {address}: all of them will answer"));
        }
        Some(node) if !header.response && node.is_working == header.to_non_working => {
            let (is, to) = if node.is_working {
                ("works", "not working")
            } else {
                ("does not work", "working")
            };
            warnings.push(format!("{} {is}: it may ignore a request to {to} nodes", node.label()));
        }
        Some(_) => {}
    }
}

fn warn_of_content(
    warnings: &mut Vec<String>,
    header: Header,
    frame: &Frame,
    around: Surroundings<'_>,
) {
    let profile = around.profile;
    if header.service == profile.heartbeat_service() && header.message_type() != MessageType::Debug
    {
        let who = header.source;
        let doubt = if profile.is_given(crate::wire::profile::ProfileKey::Heartbeat) {
            ""
        } else {
            " (number assumed)"
        };
        warnings.push(format!("nodes read it as a heartbeat of {who}{doubt}"));
    }
    let is_write = profile.writes.address == Some(header.service.number()) && !header.response;
    if let (true, &[code]) = (is_write, frame.data())
        && let Some(address) = AddressSetting::from_code(code).and_then(AddressSetting::address)
    {
        if header.broadcast {
            warnings.push(format!("all devices get the address {address}: they conflict"));
        } else if address != header.destination
            && let Some(node) = around.node(address)
        {
            let other = node.label();
            warnings
                .push(format!("{other} uses {address}: the device stays mute until it is gone"));
        }
    }
    if header.service == profile.des_service() && !header.response {
        let request = classify_request(frame.data(), frame.is_fd);
        match request.map(|(framing, message)| (framing, Request::decode(message))) {
            Some((_, Some(ReceivedRequest::Reserved(kind)))) => warnings.push(format!(
                "type {kind:02X} of DES is reserved: a device need not answer, or with an error"
            )),
            Some((framing, _)) if header.broadcast && profile.framing == FramingChoice::Auto => {
                warnings.push(format!(
                    "devices that read another framing than {framing} do not answer"
                ));
            }
            Some(_) => {}
            None => warnings.push("not a request of DES: devices do not answer it".to_owned()),
        }
    }
}

/// The message in a frame: without its ISO-TP length where it has one.
fn message_of(frame: &Frame, header: Header, profile: &Profile) -> Vec<u8> {
    match Pci::decode(frame.data(), frame.is_fd) {
        Ok(Pci::Single(message)) if header.service == profile.des_service() => message.to_vec(),
        _ => frame.data().to_vec(),
    }
}

fn shown_data(frame: &Frame) -> String {
    if frame.is_empty() { "none".to_owned() } else { hex(frame.data(), " ") }
}

/// What one frame with a 29-bit identifier is.
fn meaning(frame: &Frame, around: Surroundings<'_>) -> String {
    let profile = around.profile;
    let header = Header::decode(frame.platform_id().unwrap_or_default());
    let fd = if frame.is_fd { ", CAN FD" } else { "" };
    let number = header.service;
    let kind = header.message_type();
    let source = match around.own {
        Some(own) if own == header.source => format!("own address {own}"),
        _ => format!("@{}", header.source),
    };
    if kind == MessageType::Debug {
        let name = profile.debug_names.get(&number.number());
        let name = name.map(|it| format!(" ({})", printable(it.as_bytes()))).unwrap_or_default();
        let data = shown_data(frame);
        return format!("{kind} from {source}, code {number}{name}, data {data}{fd}");
    }
    let to = if header.broadcast {
        format!("all (DST {} is random)", header.destination)
    } else {
        let node = around.node(header.destination);
        node.map_or(format!("@{}", header.destination), KnownNode::label)
    };
    let name = service_name(number, profile);
    let error = if header.response && !header.no_error { ", ERR 0: an error" } else { "" };
    format!(
        "{kind} from {source} to {to}, service {number}{name}, {}{error}{fd}",
        content(frame, header, profile)
    )
}

/// The name of a service, in parentheses.
fn service_name(service: Service, profile: &Profile) -> String {
    let given = profile.service_names.get(&service.number());
    if let Some(name) = given {
        return format!(" ({})", printable(name.as_bytes()));
    }
    let known = super::ServiceWord::all(profile, MessageKind::Request);
    let known = known.iter().find(|it| it.service == service);
    known.map(|it| format!(" ({})", it.word)).unwrap_or_default()
}

/// The data, of DES in words.
fn content(frame: &Frame, header: Header, profile: &Profile) -> String {
    if header.service == profile.des_service() && !header.response {
        let request = classify_request(frame.data(), frame.is_fd);
        if let Some((framing, message)) = request {
            let what = match Request::decode(message) {
                Some(ReceivedRequest::Known(Request::Name)) => "name request",
                Some(ReceivedRequest::Known(Request::Services)) => "services request",
                _ => "reserved request",
            };
            return format!("{what}, {framing}");
        }
    }
    if frame.is_empty() { "no data".to_owned() } else { format!("data {}", hex(frame.data(), " ")) }
}
