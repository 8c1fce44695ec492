//! Device tracker: what the frames of one bus show about its devices, and the findings and events
//! about them. Sends nothing.

use super::bus_protocol::ProtocolDetector;
use super::claims::AddressClaims;
use super::conflicts::ConflictDetector;
use super::descriptors::FieldAccesses;
use super::device_table::DeviceTable;
use super::errors::BusErrorTracker;
use super::finding_tracker::EvidenceStrength;
use super::heartbeats::BusDelayTracker;
use super::observation::{Observation, ObservationKind, PlatformContent};
use super::outages::Outages;
use super::recent_requests::RecentRequests;
use super::recorded_node::RecordedNodes;
use super::rounds::FRAME_BITS;
use super::sender_names::SenderNames;
use super::{Config, Counters, DeviceId, Event, EventKind, Presence, ProtocolDeviation};
use crate::finding::{FindingKind, FindingState};
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::des::Request;
use crate::wire::id::{Address, Header};
use crate::wire::node::{Heartbeat, Mode};
use std::collections::VecDeque;

/// Maximum number of events waiting to be polled; beyond that the oldest is dropped. Bounds the
/// memory: eight of each possible row between two polls.
const MAX_EVENTS: usize = 4096;

/// Time that a device needs for the first frame of a response (protocol §4.3).
pub(super) const RESPONSE_TIME: Duration = Duration::from_millis(200);
/// Bits for which a response waits on a busy bus, besides that: responses of 127 devices, and some
/// heartbeats.
pub(super) const RESPONSE_WAIT_BITS: u64 = 180 * FRAME_BITS;
/// Time from the responses of two devices to the query of the services of both. Chosen: longer than
/// the rest of a multi-frame name takes.
const ALL_SERVICES_DELAY: Duration = Duration::from_millis(100);

/// Time from a frame on the bus to descan's next one. Chosen: what a kernel and a task switch take on
/// a small board.
const REACTION_TIME: Duration = Duration::from_micros(500);
/// Time in which the response of a second device at an address is received, until it is known.
/// Chosen: as the response times of two equal devices differ.
const FIRST_FLOW_CONTROL_WAIT: Duration = Duration::from_millis(25);
/// Factor by which two responses may be further apart than before. Chosen; tested with devices whose
/// response time varies threefold.
const MAX_DELAY_VARIATION: f64 = 1.5;

/// Devices of one bus, with the findings and events about them.
#[derive(Clone, Debug)]
pub(super) struct DeviceTracker {
    pub config: Config,
    pub now: Instant,
    /// Latest time of the next call of `handle_timeout`.
    pub wake: Instant,
    pub counters: Counters,
    pub protocol: ProtocolDetector,
    pub recorded_nodes: RecordedNodes,
    pub recent_requests: RecentRequests,
    pub device_table: DeviceTable,
    pub claims: AddressClaims,
    pub sender_names: SenderNames,
    pub conflicts: ConflictDetector,
    pub errors: BusErrorTracker,
    pub lateness: BusDelayTracker,
    pub outages: Outages,
    pub field_accesses: FieldAccesses,
    events: VecDeque<Event>,
}

impl DeviceTracker {
    pub fn new(now: Instant, config: Config) -> Self {
        Self {
            conflicts: ConflictDetector::new(
                config.bus,
                &config.profile,
                config.listen_only,
                config.seed,
            ),
            errors: BusErrorTracker::default(),
            recorded_nodes: RecordedNodes::new(),
            recent_requests: RecentRequests::new(),
            device_table: DeviceTable::new(config.bus),
            lateness: BusDelayTracker::default(),
            protocol: ProtocolDetector::new(&config.profile.heartbeat),
            claims: AddressClaims::new(),
            sender_names: SenderNames::default(),
            outages: Outages::default(),
            field_accesses: FieldAccesses::default(),
            events: VecDeque::new(),
            counters: Counters::default(),
            wake: now,
            now,
            config,
        }
    }

    pub fn advance(&mut self, now: Instant) {
        self.now = self.now.max(now);
    }

    pub fn wake_at(&mut self, at: Instant) {
        self.wake = self.wake.min(at);
    }

    /// Returns the heartbeat period of `address`.
    pub fn period_of(&self, address: Address) -> Duration {
        self.conflicts.periods().of(address)
    }

    /// Returns the heartbeat period of the slowest sender at `address`: by it a sender is absent.
    pub fn sender_period(&self, address: Address) -> Duration {
        self.conflicts.longest_period(address)
    }

    /// Returns when the window of a request sent now closes: the response time on a busy and slow
    /// bus.
    pub fn response_window(&self) -> Instant {
        self.now + RESPONSE_TIME + self.config.duration_of_bits(RESPONSE_WAIT_BITS)
    }

    // --- events ---------------------------------------------------------------------------

    /// Returns true if an event waits.
    pub fn has_events(&self) -> bool {
        !self.events.is_empty()
    }

    /// Returns the next event, oldest first.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Emits an event of the device of `row`.
    pub fn emit(&mut self, row: DeviceId, kind: EventKind) {
        let Some(device) = self.device_table.get(row) else { return };
        let (address, name) = (device.address, device.name.clone());
        self.push_event(Event {
            time: self.now,
            device: Some(row),
            address: Some(address),
            name,
            kind,
        });
    }

    /// Emits an event of a device that may have no row, at an address that another row may use.
    pub fn emit_for(&mut self, device: Option<DeviceId>, address: Address, kind: EventKind) {
        let name = device.and_then(|row| self.device_table.get(row)?.name.clone());
        self.push_event(Event { time: self.now, device, address: Some(address), name, kind });
    }

    pub fn emit_bus_event(&mut self, kind: EventKind) {
        self.push_event(Event { time: self.now, device: None, address: None, name: None, kind });
    }

    pub fn push_event(&mut self, event: Event) {
        if self.events.len() == MAX_EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }

    /// Emits changed findings; after a cleared conflict the remaining device is queried again.
    pub fn emit_finding_changes(&mut self) {
        while let Some((key, state)) = self.conflicts.finding_tracker_mut().poll_changed() {
            let shared = key.kind.is_conflict() || key.kind == FindingKind::BusErrors;
            if let (true, FindingState::Cleared, Some(address)) = (shared, state, key.address) {
                self.requery(address);
            }
            let row = key.address.and_then(|address| self.device_table.current_row(address));
            match row {
                Some(row) => self.emit(row, EventKind::Finding { key, state }),
                None => self.emit_bus_event(EventKind::Finding { key, state }),
            }
        }
    }

    /// Queries, once in a conflict, the services of all devices that use `address`, two of which
    /// responded to one request `apart` from each other. Only if flow control for the first one is
    /// sent before the other one responds: else their frames destroy each other until both devices
    /// are bus-off.
    pub fn query_all_services(&mut self, address: Address, apart: Duration) {
        let now = self.now;
        let is_shared = self.conflicts.finding_tracker().is_shared(address);
        let Some(device) = self.device_table.current_device_mut(address) else { return };
        let (shortest, longest) = device.responses_apart.unwrap_or((apart, apart));
        device.responses_apart = Some((shortest.min(apart), longest.max(apart)));
        let is_asked = device.has_asked_all_services || !device.is_present();
        if is_shared && !is_asked && self.flow_control_wait(address).is_zero() {
            let Some(device) = self.device_table.current_device_mut(address) else { return };
            device.has_asked_all_services = true;
            device.asks_all_services = true;
            // The responses under way come first.
            device.services_query.restart(now + ALL_SERVICES_DELAY);
            self.wake_at(now);
        }
    }

    /// Returns how long flow control for a response from `address`, which several devices may use,
    /// waits for the response of another one: zero if they are known to respond so long after each
    /// other that a first frame and its flow control fit between.
    pub fn flow_control_wait(&self, address: Address) -> Duration {
        let between = self.config.duration_of_bits(2 * FRAME_BITS) + REACTION_TIME;
        let device = self.device_table.current_device(address);
        match device.and_then(|device| device.responses_apart) {
            Some((shortest, _)) if shortest >= between => Duration::ZERO,
            Some((_, longest)) => longest.mul_f64(MAX_DELAY_VARIATION).max(between),
            None => FIRST_FLOW_CONTROL_WAIT,
        }
    }

    /// Queries the device that remains at `address` after a conflict: known data may be that of the
    /// other one.
    pub fn requery(&mut self, address: Address) {
        let now = self.now;
        if let Some(device) = self.device_table.current_device_mut(address)
            && device.is_present()
        {
            device.has_asked_all_services = false;
            device.responses_apart = None;
            device.name_query.restart(now);
            device.services_query.restart(now);
            self.wake_at(now);
        }
    }

    pub fn check_suspicions(&mut self) {
        let now = self.now;
        let device_table = &mut self.device_table;
        self.conflicts.finding_tracker_mut().handle_timeout(now, &self.outages, |address| {
            if let Some(device) = device_table.current_device_mut(address)
                && device.is_present()
            {
                device.name_query.schedule(now);
            }
        });
    }

    pub fn end_outage(&mut self) {
        if self.outages.end(self.now) {
            self.device_table.devices_mut().iter_mut().for_each(|device| device.rounds_missed = 0);
            self.wake_at(self.now);
        }
    }

    // --- frames ---------------------------------------------------------------------------

    /// Removes all rows and what was found about them: the bus speaks another protocol.
    pub fn remove_devices(&mut self) {
        for row in self.device_table.rows() {
            self.emit(row, EventKind::Removed);
        }
        self.device_table.clear();
        self.claims = AddressClaims::new();
        self.sender_names = SenderNames::default();
        self.lateness = BusDelayTracker::default();
        self.conflicts.remove_devices();
        for address in Address::all() {
            self.errors.forget(address);
        }
    }

    /// Notes an identifier that is not one of the message types.
    pub fn process_non_conforming(&mut self, source: Address, frame: &Frame) {
        // It may be of another protocol, as all frames are.
        if !self.protocol.is_confirmed() {
            return;
        }
        let now = self.now;
        let Some(device) = self.device_table.current_device_mut(source) else { return };
        device.note_deviation(ProtocolDeviation::NonConforming);
        let name = device.name.clone();
        self.conflicts.note_non_conforming(now, source, name.as_ref(), frame);
        self.wake_at(now);
    }

    /// Notes a request of a node: in CFG and BOOT it may not send any. Its next heartbeat decides, since it
    /// may have left the mode meanwhile.
    pub fn note_request_of(&mut self, now: Instant, row: DeviceId, frame: &Frame) {
        let Some(device) = self.device_table.get_mut(row).filter(|device| !device.is_debug) else {
            return;
        };
        // A mode that contradicts U is read by a wrong code.
        let is_configured = matches!(device.mode, Some(Mode::Cfg | Mode::Boot))
            && !device.deviations.contains(&ProtocolDeviation::ModeContradictsU);
        let address = device.address;
        let last = device.heartbeat.last;
        let is_recent =
            |last: Instant| now.since(last) < self.conflicts.periods().of(address).mul_f64(1.5);
        if is_configured
            && last.is_some_and(is_recent)
            && !self.conflicts.is_shared_perhaps(now, address)
        {
            device.request_in_cfg = Some(Box::new(*frame));
        }
    }

    /// Notes a heartbeat with this mode: a request since the one before was sent in that mode, if the mode
    /// is still the same.
    pub fn check_request_in_cfg(&mut self, now: Instant, row: DeviceId, heartbeat: &Heartbeat) {
        let Some(device) = self.device_table.get_mut(row) else { return };
        // Its name or UID may have been received since.
        let Some(request) = device.request_in_cfg.take().filter(|_| !device.is_debug) else {
            return;
        };
        let period = self.conflicts.periods().of(device.address);
        let is_next =
            device.heartbeat.last.is_some_and(|last| now.since(last) < period.mul_f64(1.5));
        let is_same = heartbeat.mode.is_some()
            && heartbeat.mode == device.mode
            && heartbeat.uid == device.heartbeat_uid;
        let is_shared = self.conflicts.is_shared_perhaps(now, device.address);
        if is_next && is_same && !is_shared {
            let (address, name) = (device.address, device.name.clone());
            self.conflicts.note_request_in_cfg(now, address, name.as_ref(), &request);
            self.wake_at(now);
        }
    }

    /// Returns the row of a frame's sender; creates it for an unknown address. `None` if there are
    /// too many rows.
    pub fn device_for_source(
        &mut self,
        observation: &Observation<'_>,
        header: Header,
    ) -> Option<DeviceId> {
        // In a DEBUG message the U bit does not give the sender's mode.
        let now = observation.at;
        let has_mode_bit =
            !matches!(observation.kind, ObservationKind::Platform(_, PlatformContent::Debug));
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
            device.descriptor.is_read = false;
            is_query_due = true;
        }
        if is_query_due {
            self.wake_at(now);
        }
        Some(row)
    }

    /// Counts a malformed response to `request`, if that is known, and reports it as evidence: weak
    /// where frames are lost, because what is left of two responses may look like one.
    pub fn report_malformed(
        &mut self,
        now: Instant,
        row: DeviceId,
        request: Option<Request>,
        fault: &dyn std::fmt::Display,
        frame: &Frame,
    ) {
        self.counters.malformed += 1;
        let Some(device) = self.device_table.get(row) else { return };
        let (address, name) = (device.address, device.name.clone());
        let strength = if self.lateness.loses_frames(address) {
            EvidenceStrength::Weak
        } else {
            EvidenceStrength::Proof
        };
        let name = name.as_ref();
        self.conflicts.note_malformed_request(address, request);
        self.conflicts.note_malformed(now, address, name, fault, frame, strength);
        self.wake_at(now);
    }
}
