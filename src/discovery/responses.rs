//! DES responses: single frames and transfers, names and service lists.

use super::conflicts::ResponseStart;
use super::device::{DeviceService, ProtocolDeviation, QueryFault, QueryState};
use super::recent_requests::RecentRequests;
use super::transfers::{Continued, DueFlowControl, Started, Stopped};
use super::{DeviceId, Engine, EventKind, Presence, local_node};
use crate::frame::Frame;
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::des::{self, Request, ResponseFault, ServicesResponse};
use crate::wire::framing::{Framing, classify_response, strip_raw_padding};
use crate::wire::id::{Address, Header};
use crate::wire::isotp::{FlowControl, FlowStatus, Pci, TransferFault};
use std::hash::{DefaultHasher, Hash, Hasher};

/// STmin in milliseconds where several devices may use an address, so that the first frame of
/// another one fits between two frames. Chosen: several frames at 125 kbit/s.
const SHARED_ST_MIN: u8 = 10;

impl Engine {
    /// Returns true if a response's DST repeats that of the request instead of naming the
    /// requester.
    pub(super) fn is_echoed_destination(&self, now: Instant, header: Header) -> bool {
        if !header.response || header.broadcast {
            return false;
        }
        if header.destination == header.source {
            return true;
        }
        let recent_requests = &self.tracker.recent_requests;
        if self.requester.local_node.held() == Some(header.destination)
            || self.tracker.device_table.current_row(header.destination).is_some()
            || recent_requests.is_requester(now, header.destination)
        {
            return false;
        }
        recent_requests.has_broadcast(now, header.destination)
    }

    /// Returns true if a response is for descan: sent to its address, or with a repeated DST while
    /// a request of descan is open.
    fn is_for_own_address(&self, row: DeviceId, header: Header, echoed: bool) -> bool {
        let Some(own) = self.requester.local_node.held() else { return false };
        if header.destination == own {
            return true;
        }
        if !echoed {
            return false;
        }
        let Some(device) = self.tracker.device_table.get(row) else { return false };
        // An error response in one framing may have ended the query: the response in the other
        // framing follows.
        let now = self.tracker.now;
        let recently = |sent: Instant| RecentRequests::is_recent(now, sent);
        let queries = [&device.services_query, &device.name_query];
        let is_open = queries.iter().any(|query| query.sent_at.is_some_and(recently));
        let targeted = header.destination == header.source && is_open;
        targeted || self.tracker.recent_requests.has_own_broadcast(now, header.destination)
    }

    /// Processes a response frame; `echoed`: it repeats the DST of the request.
    pub(super) fn process_response(
        &mut self,
        now: Instant,
        row: DeviceId,
        header: Header,
        frame: &Frame,
        echoed: bool,
    ) {
        let is_for_descan = self.is_for_own_address(row, header, echoed);
        self.tracker.errors.note_partial_response(header.source, self.tracker.response_window());
        let Some(device) = self.tracker.device_table.get_mut(row) else { return };
        if echoed {
            device.note_deviation(ProtocolDeviation::RspDstEcho);
        }
        if !header.no_error {
            // It is the response to another node's request, or the request in the other framing.
            let arriving = [&device.name_query, &device.services_query];
            let arriving = arriving.iter().any(|query| query.state == QueryState::Receiving);
            if arriving || (self.requester.local_node.held().is_some() && !is_for_descan) {
                return;
            }
            let request = self.open_request(row).unwrap_or(Request::Services);
            self.requester.response_failed(
                &mut self.tracker,
                row,
                request,
                QueryFault::ErrorResponse,
            );
            return;
        }
        // A device that repeats the DST of requests may respond to several requesters at once.
        if let Ok(Pci::Consecutive { .. }) = Pci::decode(frame.data(), frame.is_fd)
            && let Some(shown) = self.transfers.note_interleaved(now, header, frame)
            && !device.deviations.contains(&ProtocolDeviation::RspDstEcho)
        {
            let (address, name) = (device.address, device.name.clone());
            let name = name.as_ref();
            self.tracker.conflicts.note_interleaved_transfers(now, address, shown, name, frame);
            self.tracker.wake_at(now);
        }
        let Some(device) = self.tracker.device_table.get(row) else { return };
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
                    self.tracker.report_malformed(now, row, None, &"neither ISO-TP nor raw", frame);
                }
            }
        }
    }

    /// Returns the request to this node that waits for a response.
    fn open_request(&self, row: DeviceId) -> Option<Request> {
        let device = self.tracker.device_table.get(row)?;
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
        let Some(device) = self.tracker.device_table.get(row) else { return };
        let (address, name) = (device.address, device.name.clone());
        let is_repeated = self.tracker.conflicts.finding_tracker().is_open_at(address);
        self.requester.rounds.note_response(now, is_repeated);
        let (is_working, is_resolving) = (device.is_working, device.is_resolving);
        let response =
            ResponseStart { from: address, to, request, framing, is_working, is_resolving };
        let apart = self.tracker.conflicts.note_response(now, response, name.as_ref(), frame);
        if let Some(apart) = apart {
            self.tracker.query_all_services(address, apart);
        }
    }

    /// Notes the framing of a device's response.
    fn note_framing(&mut self, now: Instant, row: DeviceId, framing: Framing) {
        let Some(device) = self.tracker.device_table.get_mut(row) else { return };
        if device.framing.is_none_or(|known| known == framing) {
            device.framing = Some(framing);
            return;
        }
        device.note_deviation(ProtocolDeviation::BothFramings);
        // Only ISO-TP carries services that do not fit one frame.
        let was_raw = device.framing.replace(Framing::Isotp) == Some(Framing::Raw);
        if was_raw && device.name.is_some() && device.services.is_none() {
            device.services_query.schedule(now);
            self.tracker.wake_at(now);
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
                    self.tracker.report_malformed(
                        now,
                        row,
                        None,
                        &ResponseFault::NotServices,
                        frame,
                    );
                    return;
                }
                if let Some(stopped) = self.transfers.end_unfinished(now, header) {
                    self.handle_stopped_transfer(now, row, &stopped);
                }
                self.note_response_start(now, row, first_type, Framing::Isotp, to, frame);
                let block_size =
                    if is_for_descan { self.tracker.config.profile.isotp.block_size } else { 0 };
                match self.transfers.start(now, header, frame, length, data, block_size) {
                    Started::Open => {
                        if let Some(request) = request {
                            self.tracker.extend_deadline(row, request);
                        }
                        if is_for_descan {
                            let wait = self.flow_control_wait(now, header.source);
                            self.transfers.plan_flow_control(now, header, wait);
                            self.send_due_flow_control(now);
                        }
                        self.tracker.wake_at(now);
                    }
                    Started::Fault(fault) => {
                        self.tracker.counters.transfers_failed += 1;
                        if is_for_descan {
                            self.send_flow_control(header, FlowStatus::Overflow, block_size);
                        }
                        self.tracker.report_malformed(now, row, request, &fault, frame);
                        if let Some(request) = request {
                            self.requester.response_failed(
                                &mut self.tracker,
                                row,
                                request,
                                fault.into(),
                            );
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
                        let block_size = self.tracker.config.profile.isotp.block_size;
                        self.send_flow_control(header, FlowStatus::Continue, block_size);
                    }
                    Continued::Fault(fault, first) => {
                        let request = request_in_first_frame(&first);
                        self.abort_transfer(now, row, request, fault, frame);
                    }
                    Continued::More | Continued::BlockEnd => {
                        if is_for_descan {
                            self.tracker.wake_at(now);
                        }
                        if let Some(request) = self.open_request(row) {
                            self.tracker.extend_deadline(row, request);
                        }
                    }
                    Continued::Unknown => {}
                }
            }
            Ok(Pci::Flow(_)) => {}
            Err(fault) => self.tracker.report_malformed(now, row, None, &fault, frame),
        }
    }

    /// Returns how long flow control for a device at `address` waits: if the address may be shared,
    /// until a response of the other device would be received.
    fn flow_control_wait(&self, now: Instant, address: Address) -> Duration {
        let conflicts = &self.tracker.conflicts;
        if conflicts.is_shared_perhaps(now, address) || conflicts.has_no_uid(address) {
            self.tracker.flow_control_wait(address)
        } else {
            Duration::ZERO
        }
    }

    /// Sends flow control that is due.
    pub(super) fn send_due_flow_control(&mut self, now: Instant) {
        while let Some(due) = self.transfers.poll_flow_control(now) {
            let DueFlowControl { status, first, in_steps } = due;
            let Some(id) = first.platform_id() else { continue };
            let header = Header::decode(id);
            let block_size =
                if in_steps { 1 } else { self.tracker.config.profile.isotp.block_size };
            self.send_flow_control(header, status, block_size);
            if status == FlowStatus::Overflow
                && let Some(request) = request_in_first_frame(&first)
                && let Some(row) = self.tracker.device_table.current_row(header.source)
            {
                let fault = QueryFault::TwoResponses;
                self.requester.response_failed(&mut self.tracker, row, request, fault);
            }
        }
    }

    /// Sends flow control, with the responder's targeted request identifier (protocol §3.1).
    fn send_flow_control(&mut self, response: Header, status: FlowStatus, block_size: u8) {
        let Some(own) = self.requester.local_node.held().filter(|_| !self.requester.is_yielded)
        else {
            return;
        };
        let mut header =
            Header::request(own, response.source, response.from_non_working, response.service);
        header.no_error = self.tracker.config.profile.request_err;
        let isotp = &self.tracker.config.profile.isotp;
        let is_shared = self.tracker.conflicts.is_shared_perhaps(self.tracker.now, response.source);
        let st_min = if is_shared { slower(isotp.st_min) } else { isotp.st_min };
        let flow = FlowControl { status, block_size, st_min };
        self.requester.outbox.push(Frame::classic(header.encode(), &flow.encode()));
    }

    /// Aborts transfers whose next frame is overdue (N_Cr).
    pub(super) fn expire_transfers(&mut self) {
        while let Some(expired) = self.transfers.expire(self.tracker.now) {
            if let Some(row) = self.tracker.device_table.current_row(expired.header.source) {
                self.handle_stopped_transfer(self.tracker.now, row, &expired);
            }
        }
    }

    fn handle_stopped_transfer(&mut self, now: Instant, row: DeviceId, stopped: &Stopped) {
        let Stopped { header, fault, first, lacks_flow_control } = stopped;
        // The requester is why its response does not go on.
        let own = self.requester.local_node.held();
        if *lacks_flow_control && own != Some(header.destination) {
            self.tracker.counters.transfers_failed += 1;
            return;
        }
        let request = request_in_first_frame(first).or(self.open_request(row));
        self.abort_transfer(now, row, request, *fault, first);
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
        self.tracker.counters.transfers_failed += 1;
        let Some(request) = request else { return };
        let Some(device) = self.tracker.device_table.get(row) else { return };
        let again = device.query(request).fault == Some(QueryFault::Transfer(fault));
        // Repeated, late or lost frames, two responses at once, or responses to several requesters with
        // one identifier, are not a fault of the device.
        let excused = self.tracker.conflicts.has_duplicate_requests(now)
            || self.tracker.conflicts.finding_tracker().is_open_at(device.address)
            || self.tracker.lateness.is_bus_wide()
            || self.tracker.lateness.loses_frames(device.address)
            || device.deviations.contains(&ProtocolDeviation::RspDstEcho);
        if again && !excused {
            self.tracker.counters.malformed += 1;
            let (address, name) = (device.address, device.name.clone());
            self.tracker.conflicts.note_malformed_request(address, Some(request));
            self.tracker.conflicts.note_aborted_response(now, address, name.as_ref(), fault, frame);
            self.tracker.wake_at(now);
        }
        self.requester.response_failed(&mut self.tracker, row, request, fault.into());
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
            None => {
                self.tracker.report_malformed(now, row, None, &ResponseFault::NotServices, frame);
            }
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
            self.tracker.report_malformed(now, row, Some(Request::Name), &fault, frame);
        }
        let Some(name) = name.map(Name::new) else { return };
        let Some(device) = self.tracker.device_table.get(row) else { return };
        // If frames were lost, the end of another response may follow the name.
        if fault.is_some() && device.name.as_ref().is_some_and(|known| *known != name) {
            return;
        }
        let address = device.address;
        if fault.is_none() {
            self.tracker.conflicts.note_valid_response(now, address, Request::Name);
        }
        self.tracker.conflicts.note_name(now, address, &name, frame);
        self.tracker.errors.note_response(
            now,
            address,
            Request::Name,
            frame,
            self.tracker.counters.frames,
        );
        let row = self.tracker.row_of_name(now, row, &name);
        let broadcast_at = self.tracker.recent_requests.first_own_broadcast(now);
        let Some(device) = self.tracker.device_table.get_mut(row) else { return };
        let fault = fault.map(QueryFault::from);
        device.name_query.record_response(now, fault, broadcast_at);
        device.is_debug |= name.as_bytes() == local_node::NAME;
        device.last_seen = now;
        // The node that claimed the address while this device was lost is this device, with another
        // UID.
        device.last_heartbeat_was_other_node &= device.presence != Presence::Lost;
        let is_new = device.name.is_none();
        if is_new {
            device.name = Some(name);
            device.services_query.restart(now);
            self.tracker.device_table.discoveries += 1;
            self.tracker.emit(row, EventKind::NameReceived);
        }
        self.note_framing(now, row, framing);
        if is_new {
            self.tracker.find_move_to(row);
        }
        self.tracker.wake_at(now);
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
            self.tracker.report_malformed(now, row, Some(Request::Services), &fault, frame);
        }
        let Some(device) = self.tracker.device_table.get_mut(row) else { return };
        device.services_query.record_response(now, fault.map(QueryFault::from), None);
        // A device that responds to one query can be queried again for the other, which ended too
        // early.
        if device.name_query.state == QueryState::NoResponse {
            device.name_query.schedule(now);
        }
        if fault.is_some_and(|fault| fault != ResponseFault::Truncated) {
            device.services_query.state = QueryState::NoResponse;
            self.tracker.wake_at(now);
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
        self.tracker.errors.note_response(
            now,
            address,
            Request::Services,
            frame,
            self.tracker.counters.frames,
        );
        let count = services.len();
        let is_shared = self.tracker.conflicts.finding_tracker().is_shared(address);
        let news = device.store_services(services, is_shared);
        device.asks_all_services = false;
        if fault.is_none() {
            self.tracker.conflicts.note_valid_response(now, address, Request::Services);
        }
        self.tracker.conflicts.note_services(now, address, digest, name.as_ref(), frame);
        if let Some(news) = news {
            self.tracker.emit(row, EventKind::Services { count, news });
        }
        self.tracker.wake_at(now);
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

/// Returns an STmin of at least [`SHARED_ST_MIN`].
fn slower(st_min: u8) -> u8 {
    // Values above 127 are fractions of a millisecond, or reserved (ISO 15765-2, 9.6.5.4).
    if st_min > 0x7F { SHARED_ST_MIN } else { st_min.max(SHARED_ST_MIN) }
}
