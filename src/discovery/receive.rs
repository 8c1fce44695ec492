//! What is learnt from a frame: who is there, what it says of itself, which answers arrive.

use super::address_history::QueryParties;
use super::conflict_detector::ResponseStart;
use super::device::{DeviceService, QueryFault, QueryState, Quirk};
use super::transfers::{Continued, Started};
use super::{Device, Engine, EventKind, Presence, local_node};
use crate::frame::{Frame, FrameKind};
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::des::{self, ReceivedRequest, Request, ResponseFault, ServicesResponse};
use crate::wire::framing::{Framing, classify_request, classify_response, strip_raw_padding};
use crate::wire::id::{Address, Header, MessageType};
use crate::wire::isotp::{FlowControl, FlowStatus, Pci, TransferFault};
use std::hash::{DefaultHasher, Hash, Hasher};

/// How long answers that repeat the DST of our question are matched with it.
const BROADCAST_OPEN: Duration = Duration::from_secs(3);
/// For how long whoever asked and left may still be sent answers: each of several that wait for
/// flow control is given up only after a second.
const ASKED_LATELY: Duration = Duration::from_secs(10);

impl Engine {
    /// Learns from a frame at `self.now`.
    pub(super) fn process_frame(&mut self, frame: &Frame) {
        let now = self.now;
        if self.errors.note_frame(now, self.counters.frames) {
            self.wake_at(now);
        }
        let header = self.counters.count(frame);
        if frame.kind == FrameKind::Error {
            self.process_error_frame(frame);
            return;
        }
        if !frame.is_tx && self.outages.is_contradicted_by(frame.time) {
            self.end_outage();
        }
        let Some(header) = header else { return };
        if frame.is_tx {
            let back = self.outbox.confirmed(now, frame);
            self.acknowledgement(back);
            self.note_own_request(now, frame);
            return;
        }
        let back = self.outbox.note_other_frame(now);
        self.acknowledgement(back);
        if !header.is_conforming() {
            self.process_non_conforming(now, header, frame);
            if header.message_type() == MessageType::NonConforming {
                return;
            }
        }
        if self.outbox.is_own_echo(now, frame) {
            self.conflicts.note_own_echo(now);
            return;
        }
        let beat = header.response && header.service == self.config.profile.heartbeat_service();
        if self.conflicts.is_copy(now, header.source, beat, frame) {
            return;
        }
        self.process_platform_frame(now, header, frame);
    }

    fn process_non_conforming(&mut self, now: Instant, header: Header, frame: &Frame) {
        let Some(device) = self.device_table.current_device_mut(header.source) else { return };
        device.note(Quirk::NonConforming);
        let name = device.name.clone();
        self.conflicts.note_non_conforming(now, header.source, name.as_ref(), frame);
        self.wake_at(now);
    }

    fn process_platform_frame(&mut self, now: Instant, header: Header, frame: &Frame) {
        let echoed = self.is_echoed_destination(now, header);
        let counts = !header.broadcast && !echoed;
        self.local_node.note_used(now, header, counts);
        if let Some(own) = self.is_own_claim()
            && own == header.source
        {
            self.conflicts.note_own_address_used(now, own, frame);
            let change = self.local_node.handle_address_conflict(now, own);
            self.address_changed(change);
            self.wake_at(now);
        }
        if header.message_type() == MessageType::Debug {
            let data = frame.data().to_vec();
            let code = header.service.number();
            if let Some(index) = self.device_for_source(now, header) {
                self.emit(index, EventKind::Debug { code, data });
            }
            return;
        }
        let Some(index) = self.device_for_source(now, header) else {
            self.counters.refused += 1;
            return;
        };
        if header.service == self.config.profile.heartbeat_service() {
            self.process_heartbeat(now, index, header, frame);
        } else if header.service == self.config.profile.des_service() {
            if header.response {
                self.process_response(now, index, header, frame, echoed);
            } else {
                self.process_request(now, header, frame);
            }
        }
        // Rows may have moved meanwhile.
        if let Some(index) = self.device_table.active_at(header.source)
            && self.device_table.get(index).presence != Presence::Online
        {
            self.judge_device(index);
        }
    }

    fn is_own_claim(&self) -> Option<Address> {
        match self.local_node.own_address() {
            super::OwnAddress::Held(address) | super::OwnAddress::Claiming(address) => {
                Some(address)
            }
            _ => None,
        }
    }

    /// Whether an answer's DST repeats the question's instead of naming the asker.
    fn is_echoed_destination(&self, now: Instant, header: Header) -> bool {
        if !header.response || header.broadcast {
            return false;
        }
        if header.destination == header.source {
            return true;
        }
        let asked = self.asked_at[header.destination.index()];
        if self.local_node.held() == Some(header.destination)
            || self.device_table.active_at(header.destination).is_some()
            || asked.is_some_and(|at| now.since(at) < ASKED_LATELY)
        {
            return false;
        }
        self.broadcasts.iter().any(|broadcast| {
            broadcast.rnd7 == header.destination && now.since(broadcast.time) < BROADCAST_OPEN
        })
    }

    /// Whether an answer is for us: to our address, or with an echoed DST while a question of
    /// ours is open.
    fn is_for_us(&self, index: usize, header: Header, echoed: bool) -> bool {
        let Some(own) = self.local_node.held() else { return false };
        if header.destination == own {
            return true;
        }
        if !echoed {
            return false;
        }
        let device = self.device_table.get(index);
        // A refusal in one framing may have ended the waiting: the answer in the other comes yet.
        let now = self.now;
        let lately = |asked: Instant| now.since(asked) < BROADCAST_OPEN;
        let asked = [&device.services_query, &device.name_query];
        let asked = asked.iter().any(|query| query.asked_at.is_some_and(lately));
        let targeted = header.destination == header.source && asked;
        targeted
            || self.broadcasts.iter().any(|broadcast| {
                broadcast.ours
                    && broadcast.rnd7 == header.destination
                    && self.now.since(broadcast.time) < BROADCAST_OPEN
            })
    }

    /// The row of a frame's source, a new one where it is not known yet.
    fn device_for_source(&mut self, now: Instant, header: Header) -> Option<usize> {
        // In a DEBUG message U says nothing of the sender's mode.
        let says_mode = header.message_type() != MessageType::Debug;
        let working = !(header.sender_not_working && says_mode);
        let Some(index) = self.device_table.active_at(header.source) else {
            let index = self.device_table.insert(now, header.source, working)?;
            self.device_table.get_mut(index).frames = 1;
            self.device_table.get_mut(index).name_query.schedule(now);
            self.emit(index, EventKind::Appeared);
            self.wake_at(now);
            return Some(index);
        };
        let period = self.config.profile.heartbeat.period();
        let device = self.device_table.get_mut(index);
        if device.retry_after_silence(now, period) {
            self.wake_at(now);
        }
        let device = self.device_table.get_mut(index);
        device.last_seen = now;
        device.frames += 1;
        device.rounds_missed = 0;
        // Without heartbeats this is all that tells of another mode, in which it may have other
        // services, or of another board.
        if says_mode && device.working != working {
            device.working = working;
            let beats = device.heartbeat.last.is_some_and(|last| now.since(last) < period * 3);
            if !beats && device.services.is_some() {
                device.services_query.schedule(now);
            }
        }
        if device.presence == Presence::Lost {
            // It may have come back as something else.
            device.name_query.restart(now);
            device.services_query.restart(now);
            self.wake_at(now);
        }
        Some(index)
    }

    // --- questions -----------------------------------------------------------------------

    fn process_request(&mut self, now: Instant, header: Header, frame: &Frame) {
        self.note_request(now, header, frame, false);
        self.wake_at(now);
        let profile = &self.config.profile;
        if !self.config.listen_only {
            self.local_node.handle_request(now, header, frame, profile, &mut self.outbox);
        }
    }

    /// A frame of ours is on the bus: answers are now set against it.
    pub(super) fn note_own_request(&mut self, now: Instant, frame: &Frame) {
        if let Some(id) = frame.platform_id() {
            let header = Header::decode(id);
            if !header.response && header.service == self.config.profile.des_service() {
                self.note_request(now, header, frame, true);
                if header.broadcast {
                    self.rounds.note_sent(now);
                    self.wake_at(now);
                }
            }
        }
    }

    fn note_request(&mut self, now: Instant, header: Header, frame: &Frame, ours: bool) {
        let Some((framing, message)) = classify_request(frame.data(), frame.fd) else { return };
        let Some(ReceivedRequest::Known(request)) = Request::decode(message) else { return };
        let asking = QueryParties { by: header.source, targeted: !header.broadcast };
        self.asked_at[header.source.index()] = Some(now);
        if !header.broadcast {
            let asked = header.destination;
            let known = self.device_table.current_device(asked);
            // Who works does not answer what is for others.
            if !(header.to_not_working && known.is_some_and(|device| device.working)) {
                self.conflicts.note_request(now, asked, request, framing, asking);
            }
            if known.is_some_and(|device| device.framing.is_none_or(|it| it == framing)) {
                let ends = self.response_window();
                self.errors.note_request(asked, request, ends, frame);
                self.wake_at(ends);
            }
            return;
        }
        let ends = self.response_window();
        if !ours {
            self.note_broadcast(header.destination, false);
        }
        self.conflicts.note_broadcast(now);
        let mut awaited = 0;
        for address in Address::all() {
            // Of the same question to both kinds of nodes a node answers one.
            let known = self.device_table.current_device(address);
            let may_respond = known.is_some_and(|device| {
                address != header.source
                    && device.working != header.to_not_working
                    && device.is_present()
                    && device.name_query.state != QueryState::Unanswered
                    && device.framing.is_none_or(|it| it == framing)
            });
            awaited |= u128::from(may_respond) << address.index();
            let fits =
                |device: &Device| device.working != header.to_not_working || device.is_resolving;
            if known.is_none_or(fits) {
                self.conflicts.note_request(now, address, request, framing, asking);
            }
        }
        if let Request::Name = request {
            self.errors.note_broadcast(now, ends, awaited, frame);
        }
    }

    // --- answers -------------------------------------------------------------------------

    fn process_response(
        &mut self,
        now: Instant,
        index: usize,
        header: Header,
        frame: &Frame,
        echoed: bool,
    ) {
        let for_us = self.is_for_us(index, header, echoed);
        self.errors.note_partial_response(header.source, self.response_window());
        if echoed {
            self.device_table.get_mut(index).note(Quirk::RspDstEcho);
        }
        if !header.no_error {
            // To somebody else's question, or to the one of two in the other framing.
            let device = self.device_table.get(index);
            let arriving = [&device.name_query, &device.services_query];
            let arriving = arriving.iter().any(|query| query.state == QueryState::Receiving);
            if arriving || (self.local_node.held().is_some() && !for_us) {
                return;
            }
            let request = self.open_request(index).unwrap_or(Request::Services);
            self.response_failed(index, request, QueryFault::Refused);
            return;
        }
        let open = self.transfers.is_open(header);
        // Who repeats the question's DST may happen to name another asker.
        let repeats = self.device_table.get(index).quirks.contains(&Quirk::RspDstEcho);
        let to = (!repeats).then_some(header.destination);
        match classify_response(frame.data(), frame.fd, open) {
            Some(Framing::Raw) => {
                let message = strip_raw_padding(frame.data());
                let request = request_of(message);
                self.response_begins(now, index, request, Framing::Raw, to, frame);
                self.process_message(now, index, Framing::Raw, message, frame);
            }
            Some(Framing::Isotp) => {
                self.process_isotp_frame(now, index, header, frame, for_us, to);
            }
            None => {
                // A late or lost transfer's frames are no fault of the device's.
                let stray = matches!(frame.data().first(), Some(0x20..=0x3F));
                if !stray {
                    self.report_malformed(now, index, &"neither ISO-TP nor raw", frame);
                }
            }
        }
    }

    /// Which question to this node waits for an answer.
    fn open_request(&self, index: usize) -> Option<Request> {
        let device = self.device_table.get(index);
        if device.services_query.is_waiting() {
            Some(Request::Services)
        } else {
            device.name_query.is_waiting().then_some(Request::Name)
        }
    }

    fn response_begins(
        &mut self,
        now: Instant,
        index: usize,
        request: Option<Request>,
        framing: Framing,
        to: Option<Address>,
        frame: &Frame,
    ) {
        let Some(request) = request else { return };
        self.rounds.note_response(now);
        let device = self.device_table.get(index);
        let (address, name) = (device.address, device.name.clone());
        let (working, resolving) = (device.working, device.is_resolving);
        let response = ResponseStart { from: address, to, request, framing, working, resolving };
        self.conflicts.note_response(now, response, name.as_ref(), frame);
    }

    /// The node at this row answered in that framing.
    fn note_framing(&mut self, now: Instant, index: usize, framing: Framing) {
        let device = self.device_table.get_mut(index);
        if device.framing.is_none_or(|known| known == framing) {
            device.framing = Some(framing);
            return;
        }
        device.note(Quirk::BothFramings);
        // Only this one can carry services that do not fit one frame.
        let was_raw = device.framing.replace(Framing::Isotp) == Some(Framing::Raw);
        if was_raw && device.name.is_some() && device.services.is_none() {
            device.services_query.schedule(now);
            self.wake_at(now);
        }
    }

    fn process_isotp_frame(
        &mut self,
        now: Instant,
        index: usize,
        header: Header,
        frame: &Frame,
        for_us: bool,
        to: Option<Address>,
    ) {
        match Pci::decode(frame.data(), frame.fd) {
            Ok(Pci::Single(message)) => {
                let request = request_of(message);
                self.response_begins(now, index, request, Framing::Isotp, to, frame);
                self.process_message(now, index, Framing::Isotp, message, frame);
            }
            Ok(Pci::First { length, data }) => {
                let told = request_of(data);
                // With an absurd length there may be no type byte: it is what was asked for.
                let absurd = length as usize > des::MAX_MESSAGE;
                let asked = if absurd { self.open_request(index) } else { None };
                let request = told.or(asked);
                if request.is_none() {
                    self.report_malformed(now, index, &ResponseFault::NotServices, frame);
                    return;
                }
                self.response_begins(now, index, told, Framing::Isotp, to, frame);
                let block_size = if for_us { self.config.profile.isotp.block_size } else { 0 };
                match self.transfers.start(now, header, frame, length, data, block_size) {
                    Started::Open => {
                        if let Some(request) = request {
                            self.response_started(index, request);
                        }
                        if for_us {
                            self.send_flow_control(header, FlowStatus::Continue);
                        }
                        self.wake_at(now);
                    }
                    Started::Fault(fault) => {
                        self.counters.transfers_failed += 1;
                        if for_us {
                            self.send_flow_control(header, FlowStatus::Overflow);
                        }
                        self.report_malformed(now, index, &fault, frame);
                        if let Some(request) = request {
                            self.response_failed(index, request, fault.into());
                        }
                    }
                }
            }
            Ok(Pci::Consecutive { sequence, data }) => {
                match self.transfers.push_consecutive(now, header, sequence, data) {
                    Continued::Done(message) => {
                        self.process_message(now, index, Framing::Isotp, &message, frame);
                    }
                    Continued::BlockEnd if for_us => {
                        self.send_flow_control(header, FlowStatus::Continue);
                    }
                    Continued::Fault(fault, first) => {
                        let request = first.data().get(2).and_then(|&kind| request_of(&[kind]));
                        self.abort_transfer(now, index, request, fault, frame);
                    }
                    Continued::More | Continued::BlockEnd => {
                        if let Some(request) = self.open_request(index) {
                            self.response_started(index, request);
                        }
                    }
                    Continued::Unknown => {}
                }
            }
            Ok(Pci::Flow(_)) => {}
            Err(fault) => self.report_malformed(now, index, &fault, frame),
        }
    }

    /// Flow control for an answer goes on the answerer's targeted request identifier.
    fn send_flow_control(&mut self, response: Header, status: FlowStatus) {
        let Some(own) = self.local_node.held() else { return };
        let mut header =
            Header::request(own, response.source, response.sender_not_working, response.service);
        header.no_error = self.config.profile.request_err;
        let isotp = &self.config.profile.isotp;
        let flow = FlowControl { status, block_size: isotp.block_size, st_min: isotp.st_min };
        self.outbox.push(Frame::classic(header.encode(), &flow.encode()));
    }

    /// Gives up transfers whose next frame is overdue.
    pub(super) fn expire_transfers(&mut self) {
        while let Some(expired) = self.transfers.expire(self.now) {
            let Some(index) = self.device_table.active_at(expired.header.source) else { continue };
            let request = self.open_request(index);
            self.abort_transfer(self.now, index, request, expired.fault, &expired.first);
        }
    }

    /// An answer in several frames broke off: once is a lost frame, and so is another time
    /// elsewhere in it; at the same place in a row it is the device's doing, and a finding.
    fn abort_transfer(
        &mut self,
        now: Instant,
        index: usize,
        request: Option<Request>,
        fault: TransferFault,
        frame: &Frame,
    ) {
        self.counters.transfers_failed += 1;
        let Some(request) = request else { return };
        let device = self.device_table.get(index);
        let again = device.query(request).fault == Some(QueryFault::Transfer(fault));
        // Where frames come twice or late, or answers to several have one identifier, it is not
        // the device that breaks them off.
        let excused = self.conflicts.has_duplicate_requests(now)
            || self.lateness.is_bus_wide()
            || device.quirks.contains(&Quirk::RspDstEcho);
        if again && !excused {
            self.counters.malformed += 1;
            let (address, name) = (device.address, device.name.clone());
            self.conflicts.note_aborted_response(now, address, name.as_ref(), fault, frame);
            self.wake_at(now);
        }
        self.response_failed(index, request, fault.into());
    }

    /// A whole message came from the node at this row.
    fn process_message(
        &mut self,
        now: Instant,
        index: usize,
        framing: Framing,
        message: &[u8],
        frame: &Frame,
    ) {
        match request_of(message) {
            Some(Request::Name) => self.process_name_response(now, index, framing, message, frame),
            Some(Request::Services) => {
                self.note_framing(now, index, framing);
                self.process_services_response(now, index, message, frame);
            }
            None => self.report_malformed(now, index, &ResponseFault::NotServices, frame),
        }
    }

    fn process_name_response(
        &mut self,
        now: Instant,
        index: usize,
        framing: Framing,
        message: &[u8],
        frame: &Frame,
    ) {
        let (name, fault) = des::decode_name(message);
        if let Some(fault) = fault {
            self.report_malformed(now, index, &fault, frame);
        }
        let Some(name) = name.map(Name::new) else { return };
        let device = self.device_table.get(index);
        // With frames lost, the rest of another answer may stand at its end.
        if fault.is_some() && device.name.as_ref().is_some_and(|known| *known != name) {
            return;
        }
        let address = device.address;
        self.conflicts.note_name(now, address, &name, frame);
        self.errors.note_response(now, address, Request::Name, frame, self.counters.frames);
        let index = self.row_of_name(now, index, &name);
        let device = self.device_table.get_mut(index);
        device.name_query.answered(now, fault.map(QueryFault::from));
        device.is_debug |= name.as_bytes() == local_node::NAME;
        device.last_seen = now;
        // What claimed its address in its absence is itself, under another UID.
        device.last_heartbeat_was_other_node &= device.presence != Presence::Lost;
        let news = device.name.is_none();
        if news {
            device.name = Some(name);
            device.services_query.restart(now);
            self.device_table.discoveries += 1;
            self.emit(index, EventKind::Named);
        }
        self.note_framing(now, index, framing);
        if news {
            self.find_move_to(index);
        }
        self.wake_at(now);
    }

    fn process_services_response(
        &mut self,
        now: Instant,
        index: usize,
        message: &[u8],
        frame: &Frame,
    ) {
        let response = ServicesResponse::decode(message);
        let fault = response.fault();
        if let Some(fault) = fault {
            self.report_malformed(now, index, &fault, frame);
        }
        let device = self.device_table.get_mut(index);
        device.services_query.answered(now, fault.map(QueryFault::from));
        // Who answers one question answers the other, which was given up too early.
        if device.name_query.state == QueryState::Unanswered {
            device.name_query.schedule(now);
        }
        if fault.is_some_and(|fault| fault != ResponseFault::Truncated) {
            device.services_query.state = QueryState::Unanswered;
            self.wake_at(now);
            return;
        }
        let services: Vec<DeviceService> = response
            .services()
            .map(|service| {
                let mut strings = service.strings().map(Name::new);
                let none = || Name::new(b"");
                DeviceService {
                    index: service.index,
                    name: strings.next().unwrap_or_else(none),
                    version: strings.next().unwrap_or_else(none),
                    extra: strings.collect(),
                }
            })
            .collect();
        let mut hasher = DefaultHasher::new();
        message.hash(&mut hasher);
        let digest = hasher.finish();
        let (address, name) = (device.address, device.name.clone());
        self.errors.note_response(now, address, Request::Services, frame, self.counters.frames);
        let count = services.len();
        let changed = device.services.as_ref().is_some_and(|known| *known != services);
        let news = changed || device.services.is_none();
        let before = device.services.replace(services);
        if changed {
            device.previous_services = before;
        }
        if fault.is_none() {
            self.conflicts.note_valid_response(now, address);
        }
        self.conflicts.note_services(now, address, digest, name.as_ref(), frame);
        if news {
            self.emit(index, EventKind::Services { count, changed });
        }
        self.wake_at(now);
    }

    fn report_malformed(
        &mut self,
        now: Instant,
        index: usize,
        fault: &dyn std::fmt::Display,
        frame: &Frame,
    ) {
        self.counters.malformed += 1;
        let device = self.device_table.get(index);
        let (address, name) = (device.address, device.name.clone());
        self.conflicts.note_malformed(now, address, name.as_ref(), fault, frame);
        self.wake_at(now);
    }
}

/// What kind of answer a message is, by its first byte.
fn request_of(message: &[u8]) -> Option<Request> {
    match message.first() {
        Some(&des::TYPE_NAME) => Some(Request::Name),
        Some(&des::TYPE_SERVICES) => Some(Request::Services),
        _ => None,
    }
}
