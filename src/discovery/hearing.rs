//! What is learnt from a frame: who is there, what it says of itself, which answers arrive.

use super::collisions::Answer;
use super::device::{QueryFault, QueryState, Quirk, ServiceEntry};
use super::memory::Asking;
use super::transfers::{Continued, Started};
use super::{Device, Engine, EventKind, Presence, station};
use crate::frame::{Frame, FrameKind};
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::des::{self, AnswerFault, Asked, Request, ServicesAnswer};
use crate::wire::framing::{Framing, classify_answer, classify_request, strip_raw_padding};
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
    pub(super) fn hear(&mut self, frame: &Frame) {
        let now = self.now;
        if self.errors.see_frame(now, self.counters.frames) {
            self.wake_at(now);
        }
        let header = self.counters.count(frame);
        if frame.kind == FrameKind::Error {
            self.hear_error(frame);
            return;
        }
        if !frame.ours && self.outages.is_disproved_by(frame.time) {
            self.end_outage();
        }
        let Some(header) = header else { return };
        if frame.ours {
            let back = self.outbox.confirmed(now, frame);
            self.acknowledgement(back);
            self.note_own_question(now, frame);
            return;
        }
        let back = self.outbox.heard(now);
        self.acknowledgement(back);
        if !header.is_conforming() {
            self.hear_non_conforming(now, header, frame);
            if header.message_type() == MessageType::NonConforming {
                return;
            }
        }
        if self.outbox.is_own_echo(now, frame) {
            self.collisions.see_own_echo(now);
            return;
        }
        let beat = header.response && header.service == self.config.profile.heartbeat_service();
        if self.collisions.is_copy(now, header.source, beat, frame) {
            return;
        }
        self.hear_platform(now, header, frame);
    }

    fn hear_non_conforming(&mut self, now: Instant, header: Header, frame: &Frame) {
        let Some(device) = self.roster.current_device_mut(header.source) else { return };
        device.note(Quirk::NonConforming);
        let name = device.name.clone();
        self.collisions.see_non_conforming(now, header.source, name.as_ref(), frame);
        self.wake_at(now);
    }

    fn hear_platform(&mut self, now: Instant, header: Header, frame: &Frame) {
        let echoed = self.is_echoed_destination(now, header);
        let counts = !header.broadcast && !echoed;
        self.station.note_used(now, header, counts);
        if let Some(own) = self.own_claim()
            && own == header.source
        {
            self.collisions.see_rival(now, own, frame);
            let change = self.station.handle_rival(now, own);
            self.address_changed(change);
            self.wake_at(now);
        }
        if header.message_type() == MessageType::Debug {
            let data = frame.data().to_vec();
            let code = header.service.number();
            if let Some(index) = self.touch(now, header) {
                self.tell(index, EventKind::Debug { code, data });
            }
            return;
        }
        let Some(index) = self.touch(now, header) else {
            self.counters.refused += 1;
            return;
        };
        if header.service == self.config.profile.heartbeat_service() {
            self.hear_heartbeat(now, index, header, frame);
        } else if header.service == self.config.profile.des_service() {
            if header.response {
                self.hear_answer(now, index, header, frame, echoed);
            } else {
                self.hear_question(now, header, frame);
            }
        }
        // Rows may have moved meanwhile.
        if let Some(index) = self.roster.current(header.source)
            && self.roster.get(index).presence != Presence::Online
        {
            self.judge(index);
        }
    }

    fn own_claim(&self) -> Option<Address> {
        match self.station.own_address() {
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
        if self.station.held() == Some(header.destination)
            || self.roster.current(header.destination).is_some()
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
        let Some(own) = self.station.held() else { return false };
        if header.destination == own {
            return true;
        }
        if !echoed {
            return false;
        }
        let device = self.roster.get(index);
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
    fn touch(&mut self, now: Instant, header: Header) -> Option<usize> {
        // In a DEBUG message U says nothing of the sender's mode.
        let says_mode = header.message_type() != MessageType::Debug;
        let working = !(header.sender_not_working && says_mode);
        let Some(index) = self.roster.current(header.source) else {
            let index = self.roster.appear(now, header.source, working)?;
            self.roster.get_mut(index).frames = 1;
            self.roster.get_mut(index).name_query.renew(now);
            self.tell(index, EventKind::Appeared);
            self.wake_at(now);
            return Some(index);
        };
        let period = self.config.profile.heartbeat.period();
        let device = self.roster.get_mut(index);
        if device.ask_who_was_not_heard(now, period) {
            self.wake_at(now);
        }
        let device = self.roster.get_mut(index);
        device.last_seen = now;
        device.frames += 1;
        device.rounds_missed = 0;
        // Without heartbeats this is all that tells of another mode, in which it may have other
        // services, or of another board.
        if says_mode && device.working != working {
            device.working = working;
            let beats = device.heartbeat.last.is_some_and(|last| now.since(last) < period * 3);
            if !beats && device.services.is_some() {
                device.services_query.renew(now);
            }
        }
        if device.presence == Presence::Lost {
            // It may have come back as something else.
            device.name_query.start_over(now);
            device.services_query.start_over(now);
            self.wake_at(now);
        }
        Some(index)
    }

    // --- questions -----------------------------------------------------------------------

    fn hear_question(&mut self, now: Instant, header: Header, frame: &Frame) {
        self.note_question(now, header, frame, false);
        self.wake_at(now);
        let profile = &self.config.profile;
        if !self.config.listen_only {
            self.station.handle_question(now, header, frame, profile, &mut self.outbox);
        }
    }

    /// A frame of ours is on the bus: answers are now set against it.
    pub(super) fn note_own_question(&mut self, now: Instant, frame: &Frame) {
        if let Some(id) = frame.platform_id() {
            let header = Header::decode(id);
            if !header.response && header.service == self.config.profile.des_service() {
                self.note_question(now, header, frame, true);
                if header.broadcast {
                    self.rounds.note_sent(now);
                    self.wake_at(now);
                }
            }
        }
    }

    fn note_question(&mut self, now: Instant, header: Header, frame: &Frame, ours: bool) {
        let Some((framing, message)) = classify_request(frame.data(), frame.fd) else { return };
        let Some(Asked::Known(request)) = Request::decode(message) else { return };
        let asking = Asking { by: header.source, targeted: !header.broadcast };
        self.asked_at[header.source.index()] = Some(now);
        if !header.broadcast {
            let asked = header.destination;
            let known = self.roster.current_device(asked);
            // Who works does not answer what is for others.
            if !(header.to_not_working && known.is_some_and(|device| device.working)) {
                self.collisions.see_question(now, asked, request, framing, asking);
            }
            if known.is_some_and(|device| device.framing.is_none_or(|it| it == framing)) {
                let ends = self.answer_window();
                self.errors.see_question(asked, request, ends, frame);
                self.wake_at(ends);
            }
            return;
        }
        let ends = self.answer_window();
        if !ours {
            self.note_broadcast(header.destination, false);
        }
        self.collisions.see_broadcast(now);
        let mut awaited = 0;
        for address in Address::all() {
            // Of the same question to both kinds of nodes a node answers one.
            let known = self.roster.current_device(address);
            let may_answer = known.is_some_and(|device| {
                address != header.source
                    && device.working != header.to_not_working
                    && device.is_here()
                    && device.name_query.state != QueryState::Unanswered
                    && device.framing.is_none_or(|it| it == framing)
            });
            awaited |= u128::from(may_answer) << address.index();
            let fits =
                |device: &Device| device.working != header.to_not_working || device.is_resolving;
            if known.is_none_or(fits) {
                self.collisions.see_question(now, address, request, framing, asking);
            }
        }
        if let Request::Name = request {
            self.errors.see_broadcast(now, ends, awaited, frame);
        }
    }

    // --- answers -------------------------------------------------------------------------

    fn hear_answer(
        &mut self,
        now: Instant,
        index: usize,
        header: Header,
        frame: &Frame,
        echoed: bool,
    ) {
        let for_us = self.is_for_us(index, header, echoed);
        self.errors.see_part(header.source, self.answer_window());
        if echoed {
            self.roster.get_mut(index).note(Quirk::RspDstEcho);
        }
        if !header.no_error {
            // To somebody else's question, or to the one of two in the other framing.
            let device = self.roster.get(index);
            let arriving = [&device.name_query, &device.services_query];
            let arriving = arriving.iter().any(|query| query.state == QueryState::Receiving);
            if arriving || (self.station.held().is_some() && !for_us) {
                return;
            }
            let request = self.open_request(index).unwrap_or(Request::Services);
            self.answer_failed(index, request, QueryFault::Refused);
            return;
        }
        let open = self.transfers.is_open(header);
        // Who repeats the question's DST may happen to name another asker.
        let repeats = self.roster.get(index).quirks.contains(&Quirk::RspDstEcho);
        let to = (!repeats).then_some(header.destination);
        match classify_answer(frame.data(), frame.fd, open) {
            Some(Framing::Raw) => {
                let message = strip_raw_padding(frame.data());
                let request = request_of(message);
                self.answer_begins(now, index, request, Framing::Raw, to, frame);
                self.hear_message(now, index, Framing::Raw, message, frame);
            }
            Some(Framing::Isotp) => {
                self.hear_isotp(now, index, header, frame, for_us, to);
            }
            None => {
                // A late or lost transfer's frames are no fault of the device's.
                let stray = matches!(frame.data().first(), Some(0x20..=0x3F));
                if !stray {
                    self.malformed(now, index, &"neither ISO-TP nor raw", frame);
                }
            }
        }
    }

    /// Which question to this node waits for an answer.
    fn open_request(&self, index: usize) -> Option<Request> {
        let device = self.roster.get(index);
        if device.services_query.is_waiting() {
            Some(Request::Services)
        } else {
            device.name_query.is_waiting().then_some(Request::Name)
        }
    }

    fn answer_begins(
        &mut self,
        now: Instant,
        index: usize,
        request: Option<Request>,
        framing: Framing,
        to: Option<Address>,
        frame: &Frame,
    ) {
        let Some(request) = request else { return };
        self.rounds.note_answer(now);
        let device = self.roster.get(index);
        let (address, name) = (device.address, device.name.clone());
        let (working, resolving) = (device.working, device.is_resolving);
        let answer = Answer { from: address, to, request, framing, working, resolving };
        self.collisions.see_answer(now, answer, name.as_ref(), frame);
    }

    /// The node at this row answered in that framing.
    fn note_framing(&mut self, now: Instant, index: usize, framing: Framing) {
        let device = self.roster.get_mut(index);
        if device.framing.is_none_or(|known| known == framing) {
            device.framing = Some(framing);
            return;
        }
        device.note(Quirk::BothFramings);
        // Only this one can carry services that do not fit one frame.
        let was_raw = device.framing.replace(Framing::Isotp) == Some(Framing::Raw);
        if was_raw && device.name.is_some() && device.services.is_none() {
            device.services_query.renew(now);
            self.wake_at(now);
        }
    }

    fn hear_isotp(
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
                self.answer_begins(now, index, request, Framing::Isotp, to, frame);
                self.hear_message(now, index, Framing::Isotp, message, frame);
            }
            Ok(Pci::First { length, data }) => {
                let told = request_of(data);
                // With an absurd length there may be no type byte: it is what was asked for.
                let absurd = length as usize > des::MAX_MESSAGE;
                let asked = if absurd { self.open_request(index) } else { None };
                let request = told.or(asked);
                if request.is_none() {
                    self.malformed(now, index, &AnswerFault::NotServices, frame);
                    return;
                }
                self.answer_begins(now, index, told, Framing::Isotp, to, frame);
                let block_size = if for_us { self.config.profile.isotp.block_size } else { 0 };
                match self.transfers.start(now, header, frame, length, data, block_size) {
                    Started::Open => {
                        if let Some(request) = request {
                            self.answer_arrives(index, request);
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
                        self.malformed(now, index, &fault, frame);
                        if let Some(request) = request {
                            self.answer_failed(index, request, fault.into());
                        }
                    }
                }
            }
            Ok(Pci::Consecutive { sequence, data }) => {
                match self.transfers.go_on(now, header, sequence, data) {
                    Continued::Done(message) => {
                        self.hear_message(now, index, Framing::Isotp, &message, frame);
                    }
                    Continued::BlockEnd if for_us => {
                        self.send_flow_control(header, FlowStatus::Continue);
                    }
                    Continued::Fault(fault, first) => {
                        let request = first.data().get(2).and_then(|&kind| request_of(&[kind]));
                        self.transfer_broke(now, index, request, fault, frame);
                    }
                    Continued::More | Continued::BlockEnd => {
                        if let Some(request) = self.open_request(index) {
                            self.answer_arrives(index, request);
                        }
                    }
                    Continued::Unknown => {}
                }
            }
            Ok(Pci::Flow(_)) => {}
            Err(fault) => self.malformed(now, index, &fault, frame),
        }
    }

    /// Flow control for an answer goes on the answerer's targeted request identifier.
    fn send_flow_control(&mut self, answer: Header, status: FlowStatus) {
        let Some(own) = self.station.held() else { return };
        let mut header =
            Header::request(own, answer.source, answer.sender_not_working, answer.service);
        header.no_error = self.config.profile.request_err;
        let isotp = &self.config.profile.isotp;
        let flow = FlowControl { status, block_size: isotp.block_size, st_min: isotp.st_min };
        self.outbox.push(Frame::classic(header.encode(), &flow.encode()));
    }

    /// Gives up transfers whose next frame is overdue.
    pub(super) fn expire_transfers(&mut self) {
        while let Some(expired) = self.transfers.expire(self.now) {
            let Some(index) = self.roster.current(expired.header.source) else { continue };
            let request = self.open_request(index);
            self.transfer_broke(self.now, index, request, expired.fault, &expired.first);
        }
    }

    /// An answer in several frames broke off: once is a lost frame, and so is another time
    /// elsewhere in it; at the same place in a row it is the device's doing, and a finding.
    fn transfer_broke(
        &mut self,
        now: Instant,
        index: usize,
        request: Option<Request>,
        fault: TransferFault,
        frame: &Frame,
    ) {
        self.counters.transfers_failed += 1;
        let Some(request) = request else { return };
        let device = self.roster.get(index);
        let again = device.query(request).fault == Some(QueryFault::Transfer(fault));
        // Where frames come twice or late, or answers to several have one identifier, it is not
        // the device that breaks them off.
        let excused = self.collisions.asks_twice(now)
            || self.lateness.is_common()
            || device.quirks.contains(&Quirk::RspDstEcho);
        if again && !excused {
            self.counters.malformed += 1;
            let (address, name) = (device.address, device.name.clone());
            self.collisions.see_broken_answer(now, address, name.as_ref(), fault, frame);
            self.wake_at(now);
        }
        self.answer_failed(index, request, fault.into());
    }

    /// A whole message came from the node at this row.
    fn hear_message(
        &mut self,
        now: Instant,
        index: usize,
        framing: Framing,
        message: &[u8],
        frame: &Frame,
    ) {
        match request_of(message) {
            Some(Request::Name) => self.hear_name(now, index, framing, message, frame),
            Some(Request::Services) => {
                self.note_framing(now, index, framing);
                self.hear_services(now, index, message, frame);
            }
            None => self.malformed(now, index, &AnswerFault::NotServices, frame),
        }
    }

    fn hear_name(
        &mut self,
        now: Instant,
        index: usize,
        framing: Framing,
        message: &[u8],
        frame: &Frame,
    ) {
        let (name, fault) = des::decode_name(message);
        if let Some(fault) = fault {
            self.malformed(now, index, &fault, frame);
        }
        let Some(name) = name.map(Name::new) else { return };
        let device = self.roster.get(index);
        // With frames lost, the rest of another answer may stand at its end.
        if fault.is_some() && device.name.as_ref().is_some_and(|known| *known != name) {
            return;
        }
        let address = device.address;
        self.collisions.see_name(now, address, &name, frame);
        self.errors.see_answer(now, address, Request::Name, frame, self.counters.frames);
        let index = self.row_of_name(now, index, &name);
        let device = self.roster.get_mut(index);
        device.name_query.answered(now, fault.map(QueryFault::from));
        device.is_debug |= name.as_bytes() == station::NAME;
        device.last_seen = now;
        // What claimed its address in its absence is itself, under another UID.
        device.is_beaten_for &= device.presence != Presence::Lost;
        let news = device.name.is_none();
        if news {
            device.name = Some(name);
            device.services_query.start_over(now);
            self.roster.discoveries += 1;
            self.tell(index, EventKind::Named);
        }
        self.note_framing(now, index, framing);
        if news {
            self.find_move_to(index);
        }
        self.wake_at(now);
    }

    fn hear_services(&mut self, now: Instant, index: usize, message: &[u8], frame: &Frame) {
        let answer = ServicesAnswer::decode(message);
        let fault = answer.fault();
        if let Some(fault) = fault {
            self.malformed(now, index, &fault, frame);
        }
        let device = self.roster.get_mut(index);
        device.services_query.answered(now, fault.map(QueryFault::from));
        // Who answers one question answers the other, which was given up too early.
        if device.name_query.state == QueryState::Unanswered {
            device.name_query.renew(now);
        }
        if fault.is_some_and(|fault| fault != AnswerFault::Truncated) {
            device.services_query.state = QueryState::Unanswered;
            self.wake_at(now);
            return;
        }
        let services: Vec<ServiceEntry> = answer
            .services()
            .map(|service| {
                let mut strings = service.strings().map(Name::new);
                let none = || Name::new(b"");
                ServiceEntry {
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
        self.errors.see_answer(now, address, Request::Services, frame, self.counters.frames);
        let count = services.len();
        let changed = device.services.as_ref().is_some_and(|known| *known != services);
        let news = changed || device.services.is_none();
        let before = device.services.replace(services);
        if changed {
            device.previous_services = before;
        }
        if fault.is_none() {
            self.collisions.see_sound_answer(now, address);
        }
        self.collisions.see_services(now, address, digest, name.as_ref(), frame);
        if news {
            self.tell(index, EventKind::Services { count, changed });
        }
        self.wake_at(now);
    }

    fn malformed(
        &mut self,
        now: Instant,
        index: usize,
        fault: &dyn std::fmt::Display,
        frame: &Frame,
    ) {
        self.counters.malformed += 1;
        let device = self.roster.get(index);
        let (address, name) = (device.address, device.name.clone());
        self.collisions.see_malformed(now, address, name.as_ref(), fault, frame);
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
