//! Reception: updates devices, queries and evidence from each received frame.

use super::conflicts::{Repetition, RequestOrigin, ResponseStart};
use super::device::{DeviceService, ProtocolDeviation, QueryFault, QueryState};
use super::transfers::{Continued, Started};
use super::{BusVerdict, Device, DeviceId, Engine, EventKind, Presence, local_node};
use crate::frame::{Frame, FrameKind};
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::des::{self, ReceivedRequest, Request, ResponseFault, ServicesResponse};
use crate::wire::framing::{Framing, classify_request, classify_response, strip_raw_padding};
use crate::wire::id::{Address, Header, MessageType};
use crate::wire::isotp::{FlowControl, FlowStatus, Pci, TransferFault};
use std::hash::{DefaultHasher, Hash, Hasher};

/// Time after a request in which responses that repeat its DST are matched to it.
const BROADCAST_RESPONSE_WINDOW: Duration = Duration::from_secs(3);
/// Time after a request in which its address still counts as a requester: a device aborts each of
/// several responses that wait for flow control only after 1 s.
const REQUESTER_WINDOW: Duration = Duration::from_secs(10);

impl Engine {
    /// Processes a frame at `self.now`.
    pub(super) fn process_frame(&mut self, frame: &Frame) {
        let now = self.now;
        if self.errors.note_frame(now, self.counters.frames) {
            self.wake_at(now);
        }
        let header = self.counters.count(frame);
        self.idle.note_frame(now, header, frame, &self.config);
        if frame.kind == FrameKind::Error {
            self.process_error_frame(frame);
            return;
        }
        let is_own = frame.is_tx && self.is_own(header, frame);
        if !is_own && self.outages.is_contradicted_by(frame.time) {
            self.end_outage();
        }
        if !is_own {
            self.note_traffic(now, header, frame);
        }
        let Some(header) = header else { return };
        if is_own {
            let back = self.outbox.note_sent(now, frame);
            self.handle_ack_change(back);
            self.note_own_request(now, frame);
            return;
        }
        let back = self.outbox.note_other_frame(now);
        self.handle_ack_change(back);
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
        let is_heartbeat = header.service == self.config.profile.heartbeat_service()
            && header.message_type() != MessageType::Debug;
        let repetition = self.conflicts.note_frame(now, header.source, is_heartbeat, frame);
        if repetition != Repetition::Ignored {
            self.process_platform_frame(now, header, frame, repetition);
        }
    }

    /// Returns true if a frame that was sent from this machine is one of descan, or of the inspector
    /// that recorded the log.
    fn is_own(&mut self, header: Option<Header>, frame: &Frame) -> bool {
        if !self.config.listen_only {
            return true;
        }
        let Some(header) = header else { return false };
        let had_inspector = self.recorded_nodes.has_inspector();
        let is_own = self.recorded_nodes.is_from_inspector(header, frame, &self.config.profile);
        if !had_inspector && self.recorded_nodes.has_inspector() {
            self.conflicts.expect_requests();
        }
        is_own
    }

    /// Notes a frame of another node as a sign of the bus's protocol.
    fn note_traffic(&mut self, now: Instant, header: Option<Header>, frame: &Frame) {
        let before = self.traffic().verdict();
        self.protocol.note_frame(header, frame, &self.config.profile);
        let verdict = self.traffic().verdict();
        if verdict == before || !self.config.send_requests || self.local_node.held().is_none() {
            return;
        }
        match verdict {
            BusVerdict::Foreign if self.is_left_alone() => self.rounds.stop(),
            BusVerdict::Des if before == BusVerdict::Foreign => self.rounds.restart(now),
            _ => return,
        }
        self.wake_at(now);
    }

    fn process_non_conforming(&mut self, now: Instant, header: Header, frame: &Frame) {
        let Some(device) = self.device_table.current_device_mut(header.source) else { return };
        device.note_deviation(ProtocolDeviation::NonConforming);
        let name = device.name.clone();
        self.conflicts.note_non_conforming(now, header.source, name.as_ref(), frame);
        self.wake_at(now);
    }

    fn process_platform_frame(
        &mut self,
        now: Instant,
        header: Header,
        frame: &Frame,
        repetition: Repetition,
    ) {
        let echoed = self.is_echoed_destination(now, header);
        let destination_is_node = !header.broadcast && !echoed;
        self.local_node.note_used(now, header, destination_is_node);
        if !self.traffic().has_des {
            // The identifier may conform by chance.
            return;
        }
        self.handle_own_address_used(now, header.source, frame);
        if header.message_type() == MessageType::Debug {
            let data = frame.data().to_vec();
            let code = header.service.number();
            if let Some(row) = self.device_for_source(now, header) {
                self.emit(row, EventKind::DebugMessage { code, data });
            }
            return;
        }
        let Some(row) = self.device_for_source(now, header) else {
            self.counters.over_limit += 1;
            return;
        };
        if header.service == self.config.profile.heartbeat_service() {
            self.process_heartbeat(now, row, header, frame, repetition);
        } else if header.service == self.config.profile.des_service() {
            if header.response {
                self.process_response(now, row, header, frame, echoed);
            } else {
                self.process_request(now, header, frame);
            }
        }
        // The frame may have made another row the current one.
        if let Some(device) = self.device_table.current_device(header.source)
            && device.presence != Presence::Online
        {
            self.update_device_presence(device.id);
        }
    }

    /// Gives up the own address if another node uses it; a conflict if descan has sent from it.
    fn handle_own_address_used(&mut self, now: Instant, source: Address, frame: &Frame) {
        let held = self.local_node.held().or(self.recorded_nodes.address());
        let change = self.local_node.handle_address_conflict(now, source);
        if held == Some(source) {
            self.recorded_nodes.forget_address();
            self.conflicts.note_own_address_used(now, source, frame);
            let tracker = self.conflicts.finding_tracker_mut();
            tracker.note_claim(now, source, None, true);
            tracker.note_gave_up(now, source);
            self.wake_at(now);
        }
        self.handle_address_change(change);
    }

    /// Returns true if a response's DST repeats that of the request instead of naming the
    /// requester.
    fn is_echoed_destination(&self, now: Instant, header: Header) -> bool {
        if !header.response || header.broadcast {
            return false;
        }
        if header.destination == header.source {
            return true;
        }
        let last_request = self.last_request_at[header.destination.index()];
        if self.local_node.held() == Some(header.destination)
            || self.device_table.current_row(header.destination).is_some()
            || last_request.is_some_and(|at| now.since(at) < REQUESTER_WINDOW)
        {
            return false;
        }
        self.broadcasts.iter().any(|broadcast| {
            broadcast.rnd7 == header.destination
                && now.since(broadcast.time) < BROADCAST_RESPONSE_WINDOW
        })
    }

    /// Returns true if a response is for descan: sent to its address, or with a repeated DST while
    /// a request of descan is open.
    fn is_for_own_address(&self, row: DeviceId, header: Header, echoed: bool) -> bool {
        let Some(own) = self.local_node.held() else { return false };
        if header.destination == own {
            return true;
        }
        if !echoed {
            return false;
        }
        let Some(device) = self.device_table.get(row) else { return false };
        // An error response in one framing may have ended the query: the response in the other
        // framing follows.
        let now = self.now;
        let recently = |sent: Instant| now.since(sent) < BROADCAST_RESPONSE_WINDOW;
        let queries = [&device.services_query, &device.name_query];
        let is_open = queries.iter().any(|query| query.sent_at.is_some_and(recently));
        let targeted = header.destination == header.source && is_open;
        targeted
            || self.broadcasts.iter().any(|broadcast| {
                broadcast.is_own
                    && broadcast.rnd7 == header.destination
                    && self.now.since(broadcast.time) < BROADCAST_RESPONSE_WINDOW
            })
    }

    /// Returns the row of a frame's sender; creates it for an unknown address. `None` if there are
    /// too many rows.
    fn device_for_source(&mut self, now: Instant, header: Header) -> Option<DeviceId> {
        // In a DEBUG message the U bit does not give the sender's mode.
        let has_mode_bit = header.message_type() != MessageType::Debug;
        let working = !(header.from_non_working && has_mode_bit);
        let Some(row) = self.device_table.current_row(header.source) else {
            let row = self.device_table.insert(now, header.source, working)?;
            let device = self.device_table.get_mut(row)?;
            device.frame_count = 1;
            device.name_query.schedule(now);
            self.emit(row, EventKind::FirstFrame);
            self.wake_at(now);
            return Some(row);
        };
        let period = self.period_of(header.source);
        let device = self.device_table.get_mut(row)?;
        let mut is_query_due = device.retry_after_silence(now, period);
        device.last_seen = now;
        device.frame_count += 1;
        device.rounds_missed = 0;
        // Without heartbeats only the U bit shows another mode, which may have other services, or
        // another board.
        if has_mode_bit && device.is_working != working {
            device.is_working = working;
            let has_heartbeats =
                device.heartbeat.last.is_some_and(|last| now.since(last) < period * 3);
            if !has_heartbeats && device.services.is_some() {
                device.services_query.schedule(now);
            }
        }
        if device.presence == Presence::Lost {
            // A returned device may be another board or have new firmware.
            device.name_query.restart(now);
            device.services_query.restart(now);
            is_query_due = true;
        }
        if is_query_due {
            self.wake_at(now);
        }
        Some(row)
    }

    // --- requests --------------------------------------------------------------------------

    fn process_request(&mut self, now: Instant, header: Header, frame: &Frame) {
        self.note_request(now, header, frame, false);
        self.wake_at(now);
        let profile = &self.config.profile;
        if !self.config.listen_only {
            self.local_node.handle_request(now, header, frame, profile, &mut self.outbox);
        }
    }

    /// Notes a request of descan that is on the bus, so that responses are matched to it.
    pub(super) fn note_own_request(&mut self, now: Instant, frame: &Frame) {
        if let Some(id) = frame.platform_id() {
            let header = Header::decode(id);
            if !header.response && header.service == self.config.profile.des_service() {
                self.note_request(now, header, frame, true);
                if header.broadcast {
                    if self.config.listen_only {
                        self.rounds.note_recorded(now);
                    } else {
                        self.rounds.note_sent(now);
                    }
                    self.wake_at(now);
                }
            }
        }
    }

    fn note_request(&mut self, now: Instant, header: Header, frame: &Frame, is_own: bool) {
        let Some((framing, message)) = classify_request(frame.data(), frame.is_fd) else { return };
        let Some(ReceivedRequest::Known(request)) = Request::decode(message) else { return };
        let parties = RequestOrigin { requester: header.source, is_targeted: !header.broadcast };
        self.last_request_at[header.source.index()] = Some(now);
        if !header.broadcast {
            let destination = header.destination;
            let known = self.device_table.current_device(destination);
            // A working node does not respond to requests for non-working ones.
            if !(header.to_non_working && known.is_some_and(|device| device.is_working)) {
                self.conflicts.note_request(now, destination, request, framing, parties);
            }
            if known.is_some_and(|device| device.framing.is_none_or(|it| it == framing)) {
                let ends = self.response_window();
                self.errors.note_request(destination, request, ends, frame);
                self.wake_at(ends);
            }
            return;
        }
        let ends = self.response_window();
        if !is_own || self.config.listen_only {
            self.note_broadcast(header.destination, is_own);
        }
        self.conflicts.note_broadcast(now);
        let mut awaited = 0;
        for address in Address::all() {
            // The request is sent to working and to non-working nodes; a node responds to one of
            // them.
            let known = self.device_table.current_device(address);
            let may_respond = known.is_some_and(|device| {
                address != header.source
                    && device.is_working != header.to_non_working
                    && device.is_present()
                    && device.name_query.state != QueryState::NoResponse
                    && device.framing.is_none_or(|it| it == framing)
            });
            awaited |= u128::from(may_respond) << address.index();
            let fits =
                |device: &Device| device.is_working != header.to_non_working || device.is_resolving;
            if known.is_none_or(fits) {
                self.conflicts.note_request(now, address, request, framing, parties);
            }
        }
        if let Request::Name = request {
            self.errors.note_broadcast(now, ends, awaited, frame);
        }
    }

    // --- responses --------------------------------------------------------------------------

    /// Processes a response frame; `echoed`: it repeats the DST of the request.
    fn process_response(
        &mut self,
        now: Instant,
        row: DeviceId,
        header: Header,
        frame: &Frame,
        echoed: bool,
    ) {
        let is_for_descan = self.is_for_own_address(row, header, echoed);
        self.errors.note_partial_response(header.source, self.response_window());
        let Some(device) = self.device_table.get_mut(row) else { return };
        if echoed {
            device.note_deviation(ProtocolDeviation::RspDstEcho);
        }
        if !header.no_error {
            // It is the response to another node's request, or the request in the other framing.
            let arriving = [&device.name_query, &device.services_query];
            let arriving = arriving.iter().any(|query| query.state == QueryState::Receiving);
            if arriving || (self.local_node.held().is_some() && !is_for_descan) {
                return;
            }
            let request = self.open_request(row).unwrap_or(Request::Services);
            self.response_failed(row, request, QueryFault::ErrorResponse);
            return;
        }
        if let Ok(Pci::Consecutive { sequence, .. }) = Pci::decode(frame.data(), frame.is_fd)
            && self.transfers.is_interleaved(now, header, sequence)
        {
            let (address, name) = (device.address, device.name.clone());
            self.conflicts.note_interleaved_transfers(now, address, name.as_ref(), frame);
            self.wake_at(now);
        }
        let Some(device) = self.device_table.get(row) else { return };
        let open = self.transfers.is_open(header);
        // A repeated DST may by chance be the address of another requester.
        let repeats = device.deviations.contains(&ProtocolDeviation::RspDstEcho);
        let to = (!repeats).then_some(header.destination);
        match classify_response(frame.data(), frame.is_fd, open) {
            Some(Framing::Raw) => {
                let message = strip_raw_padding(frame.data());
                let request = request_of(message);
                self.note_response_start(now, row, request, Framing::Raw, to, frame);
                self.process_message(now, row, Framing::Raw, message, frame);
            }
            Some(Framing::Isotp) => {
                self.process_isotp_frame(now, row, header, frame, is_for_descan, to);
            }
            None => {
                // Frames of a late or incomplete transfer are not malformed.
                let stray = matches!(frame.data().first(), Some(0x20..=0x3F));
                if !stray {
                    self.report_malformed(now, row, &"neither ISO-TP nor raw", frame);
                }
            }
        }
    }

    /// Returns the request to this node that waits for a response.
    fn open_request(&self, row: DeviceId) -> Option<Request> {
        let device = self.device_table.get(row)?;
        if device.services_query.is_waiting() {
            Some(Request::Services)
        } else {
            device.name_query.is_waiting().then_some(Request::Name)
        }
    }

    fn note_response_start(
        &mut self,
        now: Instant,
        row: DeviceId,
        request: Option<Request>,
        framing: Framing,
        to: Option<Address>,
        frame: &Frame,
    ) {
        let Some(request) = request else { return };
        self.rounds.note_response(now);
        let Some(device) = self.device_table.get(row) else { return };
        let (address, name) = (device.address, device.name.clone());
        let (is_working, is_resolving) = (device.is_working, device.is_resolving);
        let response =
            ResponseStart { from: address, to, request, framing, is_working, is_resolving };
        self.conflicts.note_response(now, response, name.as_ref(), frame);
    }

    /// Notes the framing of a device's response.
    fn note_framing(&mut self, now: Instant, row: DeviceId, framing: Framing) {
        let Some(device) = self.device_table.get_mut(row) else { return };
        if device.framing.is_none_or(|known| known == framing) {
            device.framing = Some(framing);
            return;
        }
        device.note_deviation(ProtocolDeviation::BothFramings);
        // Only ISO-TP carries services that do not fit one frame.
        let was_raw = device.framing.replace(Framing::Isotp) == Some(Framing::Raw);
        if was_raw && device.name.is_some() && device.services.is_none() {
            device.services_query.schedule(now);
            self.wake_at(now);
        }
    }

    fn process_isotp_frame(
        &mut self,
        now: Instant,
        row: DeviceId,
        header: Header,
        frame: &Frame,
        is_for_descan: bool,
        to: Option<Address>,
    ) {
        match Pci::decode(frame.data(), frame.is_fd) {
            Ok(Pci::Single(message)) => {
                let request = request_of(message);
                self.note_response_start(now, row, request, Framing::Isotp, to, frame);
                self.process_message(now, row, Framing::Isotp, message, frame);
            }
            Ok(Pci::First { length, data }) => {
                let first_type = request_of(data);
                // With an invalid length there may be no type byte: assume the type requested.
                let oversized = length as usize > des::MAX_MESSAGE;
                let requested = if oversized { self.open_request(row) } else { None };
                let request = first_type.or(requested);
                if request.is_none() {
                    self.report_malformed(now, row, &ResponseFault::NotServices, frame);
                    return;
                }
                self.note_response_start(now, row, first_type, Framing::Isotp, to, frame);
                let block_size =
                    if is_for_descan { self.config.profile.isotp.block_size } else { 0 };
                match self.transfers.start(now, header, frame, length, data, block_size) {
                    Started::Open => {
                        if let Some(request) = request {
                            self.extend_deadline(row, request);
                        }
                        if is_for_descan {
                            self.send_flow_control(header, FlowStatus::Continue);
                        }
                        self.wake_at(now);
                    }
                    Started::Fault(fault) => {
                        self.counters.transfers_failed += 1;
                        if is_for_descan {
                            self.send_flow_control(header, FlowStatus::Overflow);
                        }
                        self.report_malformed(now, row, &fault, frame);
                        if let Some(request) = request {
                            self.response_failed(row, request, fault.into());
                        }
                    }
                }
            }
            Ok(Pci::Consecutive { sequence, data }) => {
                match self.transfers.push_consecutive(now, header, sequence, data) {
                    Continued::Done(message) => {
                        self.process_message(now, row, Framing::Isotp, &message, frame);
                    }
                    Continued::BlockEnd if is_for_descan => {
                        self.send_flow_control(header, FlowStatus::Continue);
                    }
                    Continued::Fault(fault, first) => {
                        let request = request_in_first_frame(&first);
                        self.abort_transfer(now, row, request, fault, frame);
                    }
                    Continued::More | Continued::BlockEnd => {
                        if let Some(request) = self.open_request(row) {
                            self.extend_deadline(row, request);
                        }
                    }
                    Continued::Unknown => {}
                }
            }
            Ok(Pci::Flow(_)) => {}
            Err(fault) => self.report_malformed(now, row, &fault, frame),
        }
    }

    /// Sends flow control, with the responder's targeted request identifier (protocol §3.1).
    fn send_flow_control(&mut self, response: Header, status: FlowStatus) {
        let Some(own) = self.local_node.held() else { return };
        let mut header =
            Header::request(own, response.source, response.from_non_working, response.service);
        header.no_error = self.config.profile.request_err;
        let isotp = &self.config.profile.isotp;
        let flow = FlowControl { status, block_size: isotp.block_size, st_min: isotp.st_min };
        self.outbox.push(Frame::classic(header.encode(), &flow.encode()));
    }

    /// Aborts transfers whose next frame is overdue (N_Cr).
    pub(super) fn expire_transfers(&mut self) {
        while let Some(expired) = self.transfers.expire(self.now) {
            let Some(row) = self.device_table.current_row(expired.header.source) else {
                continue;
            };
            let request = request_in_first_frame(&expired.first).or(self.open_request(row));
            self.abort_transfer(self.now, row, request, expired.fault, &expired.first);
        }
    }

    /// Handles an aborted multi-frame response. Aborted once, or at different places, frames were
    /// lost; aborted repeatedly at the same place, it is a fault of the device and a finding.
    fn abort_transfer(
        &mut self,
        now: Instant,
        row: DeviceId,
        request: Option<Request>,
        fault: TransferFault,
        frame: &Frame,
    ) {
        self.counters.transfers_failed += 1;
        let Some(request) = request else { return };
        let Some(device) = self.device_table.get(row) else { return };
        let again = device.query(request).fault == Some(QueryFault::Transfer(fault));
        // Repeated or late frames, two responses at once, or responses to several requesters with
        // one identifier, are not a fault of the device.
        let excused = self.conflicts.has_duplicate_requests(now)
            || self.conflicts.finding_tracker().is_open_at(device.address)
            || self.lateness.is_bus_wide()
            || device.deviations.contains(&ProtocolDeviation::RspDstEcho);
        if again && !excused {
            self.counters.malformed += 1;
            let (address, name) = (device.address, device.name.clone());
            self.conflicts.note_aborted_response(now, address, name.as_ref(), fault, frame);
            self.wake_at(now);
        }
        self.response_failed(row, request, fault.into());
    }

    /// Processes a complete message of the device.
    fn process_message(
        &mut self,
        now: Instant,
        row: DeviceId,
        framing: Framing,
        message: &[u8],
        frame: &Frame,
    ) {
        match request_of(message) {
            Some(Request::Name) => self.process_name_response(now, row, framing, message, frame),
            Some(Request::Services) => {
                self.note_framing(now, row, framing);
                self.process_services_response(now, row, message, frame);
            }
            None => self.report_malformed(now, row, &ResponseFault::NotServices, frame),
        }
    }

    fn process_name_response(
        &mut self,
        now: Instant,
        row: DeviceId,
        framing: Framing,
        message: &[u8],
        frame: &Frame,
    ) {
        let (name, fault) = des::decode_name(message);
        if let Some(fault) = fault {
            self.report_malformed(now, row, &fault, frame);
        }
        let Some(name) = name.map(Name::new) else { return };
        let Some(device) = self.device_table.get(row) else { return };
        // If frames were lost, the end of another response may follow the name.
        if fault.is_some() && device.name.as_ref().is_some_and(|known| *known != name) {
            return;
        }
        let address = device.address;
        self.conflicts.note_name(now, address, &name, frame);
        self.errors.note_response(now, address, Request::Name, frame, self.counters.frames);
        let row = self.row_of_name(now, row, &name);
        let broadcast = self
            .broadcasts
            .iter()
            .map(|it| (it.is_own, it.time))
            .find(|(is_own, at)| *is_own && now.since(*at) < BROADCAST_RESPONSE_WINDOW);
        let Some(device) = self.device_table.get_mut(row) else { return };
        let fault = fault.map(QueryFault::from);
        device.name_query.record_response(now, fault, broadcast.map(|(_, at)| at));
        device.is_debug |= name.as_bytes() == local_node::NAME;
        device.last_seen = now;
        // The node that claimed the address while this device was lost is this device, with another
        // UID.
        device.last_heartbeat_was_other_node &= device.presence != Presence::Lost;
        let is_new = device.name.is_none();
        if is_new {
            device.name = Some(name);
            device.services_query.restart(now);
            self.device_table.discoveries += 1;
            self.emit(row, EventKind::NameReceived);
        }
        self.note_framing(now, row, framing);
        if is_new {
            self.find_move_to(row);
        }
        self.wake_at(now);
    }

    fn process_services_response(
        &mut self,
        now: Instant,
        row: DeviceId,
        message: &[u8],
        frame: &Frame,
    ) {
        let response = ServicesResponse::decode(message);
        let fault = response.fault();
        if let Some(fault) = fault {
            self.report_malformed(now, row, &fault, frame);
        }
        let Some(device) = self.device_table.get_mut(row) else { return };
        device.services_query.record_response(now, fault.map(QueryFault::from), None);
        // A device that responds to one query can be queried again for the other, which ended too
        // early.
        if device.name_query.state == QueryState::NoResponse {
            device.name_query.schedule(now);
        }
        if fault.is_some_and(|fault| fault != ResponseFault::Truncated) {
            device.services_query.state = QueryState::NoResponse;
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
        let is_new = changed || device.services.is_none();
        let before = device.services.replace(services);
        if changed {
            device.previous_services = before;
        }
        if fault.is_none() {
            self.conflicts.note_valid_response(now, address);
        }
        self.conflicts.note_services(now, address, digest, name.as_ref(), frame);
        if is_new {
            self.emit(row, EventKind::Services { count, changed });
        }
        self.wake_at(now);
    }

    /// Counts a malformed response and reports it as evidence.
    fn report_malformed(
        &mut self,
        now: Instant,
        row: DeviceId,
        fault: &dyn std::fmt::Display,
        frame: &Frame,
    ) {
        self.counters.malformed += 1;
        let Some(device) = self.device_table.get(row) else { return };
        let (address, name) = (device.address, device.name.clone());
        self.conflicts.note_malformed(now, address, name.as_ref(), fault, frame);
        self.wake_at(now);
    }
}

/// Returns the type of a response by its first byte; `None` for a reserved type.
fn request_of(message: &[u8]) -> Option<Request> {
    match message.first() {
        Some(&des::TYPE_NAME) => Some(Request::Name),
        Some(&des::TYPE_SERVICES) => Some(Request::Services),
        _ => None,
    }
}

/// Returns the request that a multi-frame response in classic CAN responds to, by its first frame.
fn request_in_first_frame(first: &Frame) -> Option<Request> {
    first.data().get(2).and_then(|&kind| request_of(&[kind]))
}
