//! Reception: passes each received frame to what reads it. DES responses:
//! [`responses`](super::responses).

use super::conflicts::{Repetition, RequestOrigin};
use super::device::QueryState;
use super::observation::{Observation, ObservationKind, PlatformContent};
use super::requester::Requester;
use super::{BusVerdict, Device, Engine, EventKind, Presence};
use crate::frame::Frame;
use crate::time::Instant;
use crate::wire::des::Request;
use crate::wire::framing::Framing;
use crate::wire::id::{Address, Header};
use crate::wire::isotp::Pci;
use crate::wire::node::Mode;

impl Engine {
    /// Processes a frame that is received now.
    pub(super) fn process_frame(&mut self, frame: &Frame) {
        let now = self.tracker.now;
        if self.tracker.errors.note_frame(now, self.tracker.counters.frames) {
            self.tracker.wake_at(now);
        }
        let observation = Observation::new(now, frame, &self.tracker.config);
        self.tracker.counters.count(&observation);
        self.requester.idle.note_frame(&observation, &self.tracker.config);
        if let ObservationKind::Error = observation.kind {
            self.tracker.process_error_frame(frame);
            return;
        }
        let is_own = frame.is_tx && self.is_own(&observation);
        if !is_own && self.tracker.outages.is_contradicted_by(frame.time) {
            self.tracker.end_outage();
        }
        if !is_own {
            self.note_traffic(&observation);
        }
        if is_own {
            self.requester.note_sequence_frame(&mut self.tracker, frame);
        }
        let ObservationKind::Platform(header, content) = observation.kind else {
            // It is acknowledged, whatever its identifier is.
            if is_own {
                let back = self.requester.outbox.note_sent(now, frame);
                self.requester.handle_ack_change(&mut self.tracker, back);
            }
            return;
        };
        if is_own {
            let back = self.requester.outbox.note_sent(now, frame);
            self.requester.handle_ack_change(&mut self.tracker, back);
            self.note_own_request(&observation);
            self.note_own_device_request(&observation);
            return;
        }
        let back = self.requester.outbox.note_other_frame(now);
        self.requester.handle_ack_change(&mut self.tracker, back);
        if !header.is_conforming() {
            self.tracker.process_non_conforming(header.source, frame);
            if !header.response
                && header.from_non_working
                && let Some(row) = self.tracker.device_table.current_row(header.source)
            {
                self.tracker.note_request_of(now, row, frame);
            }
            if let PlatformContent::NonConforming = content {
                return;
            }
        }
        if self.requester.outbox.is_own_echo(now, frame) {
            self.tracker.conflicts.note_own_echo(now);
            return;
        }
        // In a request the content may be that of another protocol.
        let is_heartbeat = header.response && matches!(content, PlatformContent::Heartbeat(_));
        let repetition = if self.traffic().has_des {
            self.tracker.conflicts.note_frame(now, header, is_heartbeat, frame)
        } else {
            Repetition::None
        };
        if repetition != Repetition::Ignored {
            self.process_platform_frame(&observation, header, content, repetition);
        }
    }

    /// Returns true if a frame that was sent from this machine is one of descan, or of the inspector
    /// that recorded the log.
    fn is_own(&mut self, observation: &Observation<'_>) -> bool {
        if !self.tracker.config.listen_only {
            return true;
        }
        let had_inspector = self.tracker.recorded_nodes.has_inspector();
        let profile = &self.tracker.config.profile;
        let is_own = self.tracker.recorded_nodes.is_from_inspector(observation, profile);
        if !had_inspector && self.tracker.recorded_nodes.has_inspector() {
            self.tracker.conflicts.expect_requests();
        }
        is_own
    }

    /// Notes a frame of another node as a sign of the bus's protocol.
    fn note_traffic(&mut self, observation: &Observation<'_>) {
        let before = self.traffic().verdict();
        self.tracker.protocol.note_frame(observation);
        let verdict = self.traffic().verdict();
        if before == BusVerdict::Des && verdict != before {
            self.tracker.remove_devices();
            self.requester.local_node.forget_heartbeat();
            self.transfers.clear();
        }
        if verdict == before || !self.requester.may_send_requests(&self.tracker) {
            return;
        }
        let now = observation.at;
        match verdict {
            BusVerdict::Foreign if self.requester.is_left_alone(&self.tracker) => {
                self.requester.rounds.stop();
            }
            BusVerdict::Des if before == BusVerdict::Foreign => self.requester.rounds.restart(now),
            _ => return,
        }
        self.tracker.wake_at(now);
    }

    fn process_platform_frame(
        &mut self,
        observation: &Observation<'_>,
        header: Header,
        content: PlatformContent,
        repetition: Repetition,
    ) {
        let Observation { at: now, frame, .. } = *observation;
        let echoed = self.is_echoed_destination(now, header);
        let destination_is_node = !header.broadcast && !echoed;
        self.requester.local_node.note_used(now, header, destination_is_node);
        if !self.traffic().has_des {
            // The identifier may conform by chance.
            return;
        }
        self.handle_own_address_used(now, header.source, frame);
        if let PlatformContent::Heartbeat(heartbeat) = content {
            self.tracker.restore_row(header.source, heartbeat.uid);
        }
        let Some(row) = self.tracker.device_for_source(observation, header) else {
            self.tracker.counters.over_limit += 1;
            return;
        };
        if !header.response && !matches!(content, PlatformContent::Heartbeat(_)) {
            self.tracker.note_request_of(now, row, frame);
        }
        match content {
            PlatformContent::Debug => {
                if let Some(device) = self.tracker.device_table.get_mut(row) {
                    device.debug_messages.note(now, header.service);
                }
                let (code, data) = (header.service.number(), frame.data().to_vec());
                self.tracker.emit(row, EventKind::DebugMessage { code, data });
                return;
            }
            PlatformContent::Heartbeat(heartbeat) => {
                self.tracker.process_heartbeat(row, header, heartbeat, frame, repetition);
                let works = heartbeat.mode.map(Mode::is_working);
                if works.is_some_and(|works| works.is_none_or(|it| it != header.from_non_working)) {
                    self.requester.local_node.note_heartbeat();
                }
                let period = self.tracker.period_of(header.source);
                self.requester.idle.note_heartbeat(now, header.source, period);
            }
            PlatformContent::Response => self.process_response(now, row, header, frame, echoed),
            PlatformContent::Request(request) => self.process_request(now, header, request, frame),
            PlatformContent::OtherService => self.process_other_service(now, row, header, frame),
            PlatformContent::NonConforming => {}
        }
        // The frame may have made another row the current one.
        if let Some(device) = self.tracker.device_table.current_device(header.source)
            && device.presence != Presence::Online
        {
            self.tracker.update_device_presence(device.id);
        }
    }

    /// Gives up the own address if another node uses it; a conflict if descan has sent from it.
    fn handle_own_address_used(&mut self, now: Instant, source: Address, frame: &Frame) {
        let held = self.requester.local_node.held().or(self.tracker.recorded_nodes.address());
        let change = self.requester.local_node.handle_address_conflict(now, source);
        if held == Some(source) {
            self.tracker.recorded_nodes.forget_address();
            self.tracker.conflicts.note_own_address_used(now, source, frame);
            let tracker = self.tracker.conflicts.finding_tracker_mut();
            tracker.note_claim(now, source, None, true);
            tracker.note_gave_up(now, source);
            self.tracker.wake_at(now);
        }
        self.requester.handle_address_change(&mut self.tracker, change);
    }

    // --- requests --------------------------------------------------------------------------

    fn process_request(
        &mut self,
        now: Instant,
        header: Header,
        request: Option<(Framing, Request)>,
        frame: &Frame,
    ) {
        if let Some(request) = request {
            self.note_request(now, header, request, frame, false);
        } else {
            self.note_flow_control(header, frame);
        }
        self.tracker.wake_at(now);
        let config = &self.tracker.config;
        if !config.listen_only {
            let Requester { local_node, outbox, .. } = &mut self.requester;
            local_node.handle_request(now, header, request, frame, &config.profile, outbox);
        }
    }

    /// Notes a request of descan that is on the bus, so that responses are matched to it.
    pub(super) fn note_own_request(&mut self, observation: &Observation<'_>) {
        let Observation { at: now, frame, kind } = *observation;
        let ObservationKind::Platform(header, PlatformContent::Request(request)) = kind else {
            return;
        };
        if let Some(request) = request {
            self.note_request(now, header, request, frame, true);
        } else {
            self.note_flow_control(header, frame);
        }
        if header.broadcast {
            if self.tracker.config.listen_only {
                self.requester.rounds.note_recorded(now);
            } else {
                self.requester.rounds.note_sent(now);
            }
            self.tracker.wake_at(now);
        }
    }

    fn note_flow_control(&mut self, header: Header, frame: &Frame) {
        if let Ok(Pci::Flow(flow)) = Pci::decode(frame.data(), frame.is_fd) {
            self.transfers.note_flow_control(header, flow);
        }
    }

    fn note_request(
        &mut self,
        now: Instant,
        header: Header,
        (framing, request): (Framing, Request),
        frame: &Frame,
        is_own: bool,
    ) {
        let parties = RequestOrigin { requester: header.source, is_targeted: !header.broadcast };
        self.tracker.recent_requests.note_request(now, header.source);
        if !header.broadcast {
            let destination = header.destination;
            let known = self.tracker.device_table.current_device(destination);
            // A working node does not respond to requests for non-working ones.
            if !(header.to_non_working && known.is_some_and(|device| device.is_working)) {
                self.tracker.conflicts.note_request(now, destination, request, framing, parties);
            }
            if known.is_some_and(|device| device.framing.is_none_or(|it| it == framing)) {
                let ends = self.tracker.response_window();
                self.tracker.errors.note_request(destination, request, ends, frame);
                self.tracker.wake_at(ends);
            }
            return;
        }
        let ends = self.tracker.response_window();
        if !is_own || self.tracker.config.listen_only {
            let sent_at = self.tracker.now;
            self.tracker.recent_requests.note_broadcast(sent_at, header.destination, is_own);
        }
        let table = &self.tracker.device_table;
        let mut awaited = 0;
        for address in Address::all() {
            // The request is sent to working and to non-working nodes; a node responds to one of
            // them.
            let may_respond = table.current_device(address).is_some_and(|device| {
                address != header.source
                    && device.is_working != header.to_non_working
                    && device.is_present()
                    && device.name_query.state != QueryState::NoResponse
                    && device.framing.is_none_or(|it| it == framing)
            });
            awaited |= u128::from(may_respond) << address.index();
        }
        let fits =
            |device: &Device| device.is_working != header.to_non_working || device.is_resolving;
        self.tracker.conflicts.note_broadcast(now, request, framing, parties, |address| {
            table.current_device(address).is_none_or(fits)
        });
        if let Request::Name = request {
            self.tracker.errors.note_broadcast(now, ends, awaited, frame);
        }
    }
}
