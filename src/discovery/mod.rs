//! Discovery engine of one bus: finds devices, queries their names and services, tracks their
//! presence, collects evidence of conflicts, and holds descan's own address. Protocol: chapters 4
//! to 6 of the guide's `protocol` topic.
//!
//! A state machine without I/O and without a clock:
//!
//! * `handle_frame`, `handle_timeout` and the other `handle_*`, which together with the commands
//!   are the only methods that change its state;
//! * commands (`rescan`, …): requests of the user;
//! * `poll_transmit`, `poll_event`: frames to send, events that occurred;
//! * `poll_timeout`: the latest time of the next call.
//!
//! After each call that changes the state, drain the polls.
//!
//! Does not know des.json, the screen, or where frames come from. Its modules:
//!
//! ```text
//! bus_protocol       whether the bus speaks DES
//! receive            frames in: requests and responses
//! heartbeats         mode, UID, reboots
//! device_table       the device rows
//! identity           replaced boards, moved devices
//! claims             address claims and addresses given up
//! resolution         events about them
//! periods            heartbeat period of each address
//! presence           online, stale, lost
//! transfers          multi-frame responses
//! rounds             enumeration rounds
//! idle_gaps          requests wait for heartbeats
//! query_scheduler    which request is sent when
//! local_node         own address, own responses
//! recorded_node      frames that a log marks as sent
//! outbox             transmit budget, acknowledgement
//! conflicts          history of each address, evidence of conflicts in it
//! finding_tracker    state of the findings
//! finding_text       their text
//! errors             bus errors
//! device, event, config: data that other modules read
//! ```

mod bus_protocol;
mod claims;
mod config;
mod conflicts;
mod device;
mod device_table;
mod errors;
mod event;
mod finding_text;
mod finding_tracker;
mod heartbeats;
mod identity;
mod idle_gaps;
mod local_node;
mod outbox;
mod periods;
mod presence;
mod query_scheduler;
mod receive;
mod recorded_node;
mod resolution;
mod rounds;
mod transfers;

pub use bus_protocol::{BusTraffic, BusVerdict};
pub use config::Config;
pub use device::{
    Device, DeviceId, DeviceService, HeartbeatStats, ModeChange, Presence, ProtocolDeviation,
    Query, QueryFault, QueryState,
};
pub use event::{Event, EventKind, OtherDevice};

use crate::finding::{Finding, FindingKind, FindingState};
use crate::frame::{Frame, FrameKind};
use crate::time::{Duration, Instant, debug_assert_later};
use crate::wire::id::{Address, Header};
use crate::wire::node::Mode;
use bus_protocol::ProtocolDetector;
use claims::AddressClaims;
use conflicts::ConflictDetector;
use device_table::DeviceTable;
use errors::BusErrorTracker;
use heartbeats::BusDelayTracker;
use idle_gaps::IdleTracker;
use local_node::{AddressChange, LocalNode};
use outbox::{AckChange, Outbox};
use presence::{Outages, PresenceInput};
use recorded_node::RecordedNodes;
use rounds::Rounds;
use std::collections::VecDeque;
use transfers::Transfers;

/// Maximum number of events waiting to be polled; beyond that the oldest is dropped.
const MAX_EVENTS: usize = 4096;
/// What is done can make more due at once: a finished round the next one, a cleared finding a query.
/// Each does so once at the same time.
const MAX_PASSES: u32 = 4;

/// State of descan's own address on a bus (protocol §6.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OwnAddress {
    /// None: listen-only.
    None,
    /// Listening for used addresses; nothing is sent yet.
    Listening,
    /// About to claim this address.
    Claiming(Address),
    /// No address: the configured one, or with `None` every one, is used by another node. Listening
    /// continues, and an address is taken as soon as it is free.
    Blocked(Option<Address>),
    /// Held: requests are sent from this address.
    Held(Address),
}

/// Progress of discovery on a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct DiscoveryProgress {
    /// Number of finished enumeration rounds.
    pub rounds: u32,
    /// Number of present devices with a known name.
    pub named: usize,
    /// Number of present devices.
    pub present: usize,
    /// Number of present devices with known services.
    pub with_services: usize,
    /// Number of queries without a response that are sent or due.
    pub open_queries: usize,
    /// True if the last rounds found nothing new, no query is open, and no finding is suspected.
    pub is_complete: bool,
}

/// Counters of one bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Counters {
    /// Data, remote and error frames received, including those sent by descan.
    pub frames: u64,
    /// Frames sent by descan and confirmed.
    pub sent: u64,
    /// Error frames.
    pub errors: u64,
    /// Frames with an 11-bit identifier and remote frames, which are not decoded.
    pub non_platform: u64,
    /// Frames whose identifier is none of the nine message types.
    pub non_conforming: u64,
    /// Malformed responses.
    pub malformed: u64,
    /// Multi-frame transfers aborted.
    pub transfers_failed: u64,
    /// Device rows and findings not stored because there are too many.
    pub over_limit: u64,
}

impl Counters {
    /// Counts a frame by its kind; returns its identifier if it belongs to the platform.
    fn count(&mut self, frame: &Frame) -> Option<Header> {
        self.frames += 1;
        if frame.kind == FrameKind::Error {
            self.errors += 1;
            return None;
        }
        let header = frame.platform_id().map(Header::decode);
        match header {
            None => self.non_platform += 1,
            Some(_) if frame.is_tx => self.sent += 1,
            Some(header) if !header.is_conforming() => self.non_conforming += 1,
            Some(_) => {}
        }
        header
    }
}

/// Discovery engine of one bus; see the [module](self).
///
/// A bus with one node, FEED at address 12, simulated by hand:
///
/// ```
/// use descan::discovery::{Config, Engine, EventKind};
/// use descan::frame::Frame;
/// use descan::time::{Duration, Instant};
/// use descan::wire::des::TYPE_NAME;
/// use descan::wire::id::{Address, Header};
///
/// // Frames that the engine sends are not received back.
/// let config = Config { has_loopback: false, ..Config::default() };
/// let mut engine = Engine::new(Instant::ZERO, config);
/// let end = Instant::ZERO + Duration::from_secs(10);
/// let node = Address::new(12).expect("0 to 127");
/// let mut names = Vec::new();
///
/// while let Some(now) = engine.poll_timeout().filter(|now| *now < end) {
///     engine.handle_timeout(now);
///     while let Some(request) = engine.poll_transmit(now) {
///         let header = Header::decode(request.platform_id().expect("a 29-bit identifier"));
///         // "DES" and the type behind the length byte of ISO-TP; D = 0: to working nodes.
///         let is_name_request = request.data() == [4, b'D', b'E', b'S', TYPE_NAME];
///         if is_name_request && !header.to_non_working {
///             let id = header.response(node, false).encode();
///             let response = Frame::classic(id, b"\x06\x01FEED\0");
///             engine.handle_frame(&response.with_time(now));
///         }
///     }
///     while let Some(event) = engine.poll_event() {
///         if let (EventKind::NameReceived, Some(name)) = (event.kind, event.name) {
///             names.push((event.address, name.to_string()));
///         }
///     }
/// }
///
/// assert_eq!(names, [(Some(node), "FEED".to_owned())]);
/// assert!(engine.findings().is_empty());
/// ```
#[derive(Debug)]
pub struct Engine {
    config: Config,
    rng: fastrand::Rng,
    now: Instant,
    device_table: DeviceTable,
    rounds: Rounds,
    transfers: Transfers,
    protocol: ProtocolDetector,
    /// True if the user asked for rounds on a bus that speaks another protocol.
    is_foreign_scanned: bool,
    claims: AddressClaims,
    conflicts: ConflictDetector,
    errors: BusErrorTracker,
    local_node: LocalNode,
    recorded_nodes: RecordedNodes,
    idle: IdleTracker,
    outbox: Outbox,
    lateness: BusDelayTracker,
    outages: Outages,
    broadcasts: VecDeque<PendingBroadcast>,
    /// Time of the last request from each address.
    last_request_at: [Option<Instant>; Address::COUNT],
    events: VecDeque<Event>,
    counters: Counters,
    /// Number of queries that await a response, updated before requests are sent.
    waiting: usize,
    wake: Instant,
}

/// A broadcast name request that may still get responses.
#[derive(Clone, Copy, Debug)]
struct PendingBroadcast {
    time: Instant,
    rnd7: Address,
    is_own: bool,
}

impl Engine {
    /// Creates an engine that starts at `now`.
    pub fn new(now: Instant, config: Config) -> Self {
        let mut rng = fastrand::Rng::with_seed(config.seed);
        Self {
            local_node: LocalNode::new(now, &config, &mut rng),
            outbox: Outbox::new(now, config.has_loopback),
            conflicts: ConflictDetector::new(
                config.bus,
                &config.profile,
                config.listen_only,
                config.seed,
            ),
            errors: BusErrorTracker::default(),
            recorded_nodes: RecordedNodes::new(),
            idle: IdleTracker::new(),
            device_table: DeviceTable::new(config.bus),
            rounds: Rounds::new(),
            transfers: Transfers::new(),
            lateness: BusDelayTracker::default(),
            protocol: ProtocolDetector::default(),
            is_foreign_scanned: false,
            claims: AddressClaims::new(),
            outages: Outages::default(),
            broadcasts: VecDeque::new(),
            last_request_at: [None; Address::COUNT],
            events: VecDeque::new(),
            counters: Counters::default(),
            waiting: 0,
            wake: now,
            now,
            rng,
            config,
        }
    }

    /// Processes a frame at its own time. A time before the last known one counts as that one.
    pub fn handle_frame(&mut self, frame: &Frame) {
        self.advance(frame.time);
        self.process_frame(frame);
        self.emit_bus_errors();
        if self.conflicts.finding_tracker().has_changed() {
            self.emit_finding_changes();
        }
    }

    /// Updates the counters only. For frames that waited during a stall, whose time may be wrong:
    /// devices, presence and findings do not change.
    pub fn count_frame_only(&mut self, frame: &Frame) {
        self.counters.count(frame);
    }

    /// Notes that `count` frames were lost before descan could read them.
    pub fn handle_lost_frames(&mut self, now: Instant, count: u64) {
        self.advance(now);
        self.conflicts.finding_tracker_mut().note_lost_frames(self.now, count);
        self.errors.note_lost_frames();
        self.emit_finding_changes();
        self.wake_at(self.now);
    }

    /// Processes everything that is due at `now`.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.advance(now);
        if self.now < self.wake {
            return;
        }
        for _ in 0..MAX_PASSES {
            self.do_due();
            self.wake = self.next_wake();
            if self.wake > self.now {
                break;
            }
        }
        debug_assert_later(self.poll_timeout(), self.now);
    }

    fn do_due(&mut self) {
        let now = self.now;
        self.idle.handle_timeout(now, &self.config);
        let change = self.outbox.handle_timeout(now);
        self.handle_ack_change(change);
        let change = self.local_node.handle_timeout(
            now,
            &self.config.profile,
            &mut self.rng,
            &mut self.outbox,
        );
        self.handle_address_change(change);
        self.expire_transfers();
        self.update_presence();
        self.check_suspicions();
        self.check_errors();
        self.send_due_queries();
        self.emit_finding_changes();
    }

    /// Returns the latest time of the next call of [`handle_timeout`](Self::handle_timeout); `None`
    /// if nothing is due.
    pub fn poll_timeout(&self) -> Option<Instant> {
        (self.wake != NO_TIMEOUT).then_some(self.wake)
    }

    /// Returns the next frame to send, if any. The frame counts as sent. `now` never decreases from
    /// call to call.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let frame = self.outbox.pop(now)?;
        if !self.config.has_loopback {
            self.counters.sent += 1;
            self.note_own_request(now, &frame);
        }
        self.wake_at(now);
        Some(frame.with_bus(self.config.bus))
    }

    /// Handles a bus that cannot be used at present: discards frames not sent or not confirmed, and
    /// releases the own address, which is claimed again after listening.
    pub fn handle_bus_unavailable(&mut self, now: Instant) {
        self.outbox.clear();
        if !self.config.listen_only {
            self.local_node.listen(now);
        }
    }

    /// Returns the next event, oldest first.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Command: starts enumeration rounds again and queries all services.
    pub fn rescan(&mut self, now: Instant) {
        self.advance(now);
        let now = self.now;
        self.is_foreign_scanned = true;
        if self.local_node.held().is_some() && self.config.send_requests {
            self.rounds.restart(now);
        }
        for address in Address::all() {
            // A row that was replaced at its address cannot be queried.
            if let Some(device) = self.device_table.current_device_mut(address)
                && device.is_present()
                && self.config.send_requests
            {
                device.services_query.schedule(now);
            }
        }
        self.wake_at(now);
    }

    /// Command: removes the lost devices.
    pub fn remove_lost_devices(&mut self) {
        self.device_table.remove_lost();
    }

    /// Notes that the bus is down: presence does not change until [`restart`](Self::restart), or
    /// until a frame is received.
    pub fn suspend(&mut self, now: Instant) {
        self.advance(now);
        self.outages.begin(self.now);
    }

    /// Returns true while the engine is suspended by [`suspend`](Self::suspend).
    pub fn is_suspended(&self) -> bool {
        self.outages.is_on()
    }

    /// Command: claims an address and starts enumeration rounds again, as after bus-off or when the
    /// interface came up. Devices and findings stay.
    pub fn restart(&mut self, now: Instant) {
        self.advance(now);
        // The outage may end before `suspend` was called.
        self.outages.begin(self.now);
        self.end_outage();
        self.outbox.clear();
        self.transfers.clear();
        self.errors.restart();
        self.rounds.stop();
        if !self.config.listen_only {
            self.local_node.listen(self.now);
        }
        self.wake_at(self.now);
    }

    /// Notes that delayed requests were sent all at once: a device that responds to several of
    /// them, now or a little later, is not in conflict.
    pub fn handle_delayed_requests(&mut self, now: Instant) {
        self.advance(now);
        self.conflicts.ignore_surplus_responses(self.now);
    }

    fn end_outage(&mut self) {
        if self.outages.end(self.now) {
            self.device_table.devices_mut().iter_mut().for_each(|device| device.rounds_missed = 0);
            self.wake_at(self.now);
        }
    }

    /// Sets the bit rate in bit/s; `None` if unknown.
    pub fn set_bitrate(&mut self, bitrate: Option<u32>) {
        self.config.bitrate = bitrate;
    }

    /// Returns all device rows, in the order of appearance.
    pub fn devices(&self) -> &[Device] {
        self.device_table.devices()
    }

    /// Returns the row with that id.
    pub fn device(&self, id: DeviceId) -> Option<&Device> {
        self.device_table.get(id)
    }

    /// Returns the current row at `address`: that of the device which responds there now.
    pub fn device_at(&self, address: Address) -> Option<&Device> {
        self.device_table.current_device(address)
    }

    /// Returns all findings in the order of their first evidence, including cleared ones.
    pub fn findings(&self) -> &[Finding] {
        self.conflicts.finding_tracker().findings()
    }

    /// Returns a counter that grows when a finding is opened or has another state.
    pub fn findings_revision(&self) -> u64 {
        self.conflicts.finding_tracker().revision()
    }

    /// Returns the state of descan's own address.
    pub fn own_address(&self) -> OwnAddress {
        self.local_node.own_address()
    }

    /// Returns true while sending is paused because no node acknowledges descan's frames.
    pub fn has_no_ack(&self) -> bool {
        self.outbox.has_no_ack()
    }

    /// Returns the progress of discovery.
    pub fn progress(&self) -> DiscoveryProgress {
        let present = self.devices().iter().filter(|device| device.is_present());
        let mut progress =
            DiscoveryProgress { rounds: self.rounds.finished, ..DiscoveryProgress::default() };
        for device in present {
            progress.present += 1;
            progress.named += usize::from(device.name.is_some());
            progress.with_services += usize::from(device.services.is_some());
            progress.open_queries += usize::from(is_open(&device.name_query))
                + usize::from(is_open(&device.services_query));
        }
        let is_settled = !self.rounds.is_starting()
            && !self.rounds.is_collecting()
            && progress.open_queries == 0
            && !self.conflicts.finding_tracker().is_suspicious()
            && !self.errors.has_pending_suspect();
        progress.is_complete =
            self.local_node.held().is_some() && (is_settled || self.is_left_alone());
        progress
    }

    /// Returns what the frames of other nodes show about the protocol of the bus.
    pub fn traffic(&self) -> BusTraffic {
        self.protocol.traffic()
    }

    /// Returns true if nothing is sent because the bus speaks another protocol, until
    /// [`rescan`](Self::rescan).
    fn is_left_alone(&self) -> bool {
        self.traffic().verdict() == BusVerdict::Foreign && !self.is_foreign_scanned
    }

    /// Returns the counters.
    pub fn counters(&self) -> Counters {
        Counters {
            over_limit: self.counters.over_limit + self.conflicts.finding_tracker().over_limit,
            ..self.counters
        }
    }

    /// Returns the settings.
    pub fn config(&self) -> &Config {
        &self.config
    }

    // --- private --------------------------------------------------------------------------

    fn advance(&mut self, now: Instant) {
        self.now = self.now.max(now);
    }

    fn wake_at(&mut self, at: Instant) {
        self.wake = self.wake.min(at);
    }

    /// Returns the heartbeat period of `address`.
    fn period_of(&self, address: Address) -> Duration {
        self.conflicts.periods().of(address)
    }

    fn presence_input(&self) -> PresenceInput<'_> {
        PresenceInput {
            outages: &self.outages,
            periods: self.conflicts.periods(),
            rounds: (self.recorded_nodes.has_inspector()
                || !self.config.listen_only && self.config.send_requests)
                && !self.config.round_period.is_zero(),
        }
    }

    /// Emits an event of the device of `row`.
    fn emit(&mut self, row: DeviceId, kind: EventKind) {
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
    fn emit_for(&mut self, device: Option<DeviceId>, address: Address, kind: EventKind) {
        let name = device.and_then(|row| self.device_table.get(row)?.name.clone());
        self.push_event(Event { time: self.now, device, address: Some(address), name, kind });
    }

    fn emit_bus_event(&mut self, kind: EventKind) {
        self.push_event(Event { time: self.now, device: None, address: None, name: None, kind });
    }

    fn push_event(&mut self, event: Event) {
        if self.events.len() == MAX_EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }

    /// Emits changed findings; after a cleared conflict the remaining device is queried again.
    fn emit_finding_changes(&mut self) {
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

    /// Queries the device that remains at `address` after a conflict: known data may be that of the
    /// other one.
    fn requery(&mut self, address: Address) {
        let now = self.now;
        if let Some(device) = self.device_table.current_device_mut(address)
            && device.is_present()
        {
            device.name_query.restart(now);
            device.services_query.restart(now);
            self.wake_at(now);
        }
    }

    fn handle_ack_change(&mut self, change: Option<AckChange>) {
        match change {
            Some(AckChange::NoAck) => {
                self.emit_bus_event(EventKind::NoAck);
                // No node received the request: repeat it with the next attempt.
                if self.local_node.held().is_some() && self.config.send_requests {
                    self.rounds.restart(self.now);
                }
            }
            Some(AckChange::Restored) => {
                self.emit_bus_event(EventKind::Acknowledged);
                if self.local_node.held().is_some() && self.config.send_requests {
                    self.rounds.restart(self.now);
                }
                self.wake_at(self.now);
            }
            None => {}
        }
    }

    fn handle_address_change(&mut self, change: Option<AddressChange>) {
        match change {
            Some(AddressChange::Taken(address)) => {
                self.emit_bus_event(EventKind::OwnAddress(address));
                if self.config.send_requests {
                    self.rounds.restart(self.now);
                }
            }
            Some(AddressChange::Blocked(wanted)) => {
                self.emit_bus_event(EventKind::NoAddress(wanted));
            }
            Some(AddressChange::Lost(address)) => {
                self.emit_bus_event(EventKind::OwnAddressLost(address));
                self.rounds.stop();
                self.outbox.clear();
            }
            None => {}
        }
    }

    fn check_suspicions(&mut self) {
        let now = self.now;
        let device_table = &mut self.device_table;
        self.conflicts.finding_tracker_mut().handle_timeout(now, |address| {
            if let Some(device) = device_table.current_device_mut(address)
                && device.is_present()
            {
                device.name_query.schedule(now);
            }
        });
    }

    /// Updates the presence of every row and emits the changes.
    fn update_presence(&mut self) {
        if self.outages.is_on() {
            return;
        }
        // A device that turns out to have moved has two rows, which are merged.
        for row in self.device_table.rows() {
            self.update_device_presence(row);
        }
    }

    fn update_device_presence(&mut self, row: DeviceId) {
        let measure = self.presence_input();
        let Some(device) = self.device_table.get(row) else { return };
        let is_current = self.device_table.is_current(device);
        let presence = if is_current {
            measure.evaluate(device, self.now).0
        } else {
            self.replaced_row_presence(device)
        };
        let was = device.presence;
        // Heartbeats of another node neither return this device nor make it silent.
        let was_other_node = device.last_heartbeat_was_other_node && is_current;
        let was_gone = matches!(was, Presence::Lost | Presence::Asleep);
        let may_be_other_node =
            presence == Presence::Online || presence == Presence::Stale && was_gone;
        let Some(device) = self.device_table.get_mut(row) else { return };
        if presence == Presence::Lost {
            device.last_heartbeat_was_other_node = false;
        }
        if presence == was || (may_be_other_node && was_other_node) {
            return;
        }
        let address = device.address;
        device.presence = presence;
        device.presence_since = self.now;
        // Its mode is unknown while no heartbeats arrive.
        device.is_resolving &= presence == Presence::Online;
        if presence == Presence::Online {
            // It may have been offline for a firmware update.
            if self.errors.is_suspect(address) {
                device.services_query.schedule(self.now);
            } else {
                device.services_query.restart(self.now);
            }
            self.wake_at(self.now);
            self.emit(row, EventKind::Returned { was });
        } else {
            self.emit(row, EventKind::Presence(presence));
        }
        if presence == Presence::Lost {
            if is_current {
                self.conflicts.forget(self.now, address);
                self.errors.forget(address);
            }
            self.find_move_of_lost(row);
        }
    }

    /// Returns the presence of a row that was replaced at its address: present while it still
    /// responds.
    fn replaced_row_presence(&self, device: &Device) -> Presence {
        match (self.replaced_row_leaves(device), device.mode) {
            (Some(leaves), Some(Mode::Idle)) if leaves <= self.now => Presence::Asleep,
            (Some(leaves), _) if leaves <= self.now => Presence::Lost,
            _ => device.presence,
        }
    }

    /// Returns when a replaced row leaves without another response; `None` if it has left.
    fn replaced_row_leaves(&self, device: &Device) -> Option<Instant> {
        if matches!(device.presence, Presence::Lost | Presence::Asleep) {
            return None;
        }
        let periods =
            if self.conflicts.finding_tracker().is_open_at(device.address) { 8 } else { 4 };
        let responded = device.name_query.responded_at.max(device.replaced_at);
        let responded = responded.unwrap_or(device.last_seen);
        Some(responded + self.period_of(device.address) * periods)
    }

    fn next_wake(&self) -> Instant {
        let measure = self.presence_input();
        let mut wake = NO_TIMEOUT;
        let mut at = |due: Option<Instant>| wake = wake.min(due.unwrap_or(NO_TIMEOUT));
        let judged = if self.outages.is_on() { &[] } else { self.device_table.devices() };
        for device in judged {
            if self.device_table.is_current(device) {
                at(measure.evaluate(device, self.now).1);
            } else {
                at(self.replaced_row_leaves(device));
            }
        }
        at(self.query_timeout());
        at(self.local_node.poll_timeout());
        at(self.transfers.poll_timeout());
        at(self.conflicts.finding_tracker().poll_timeout());
        at(self.errors_timeout());
        at(self.outbox.poll_timeout());
        wake
    }
}

/// Stands for no timeout.
const NO_TIMEOUT: Instant = Instant::from_micros(u64::MAX);

/// Returns true if a response is awaited, or the query is due and did not fail before.
fn is_open(query: &Query) -> bool {
    query.is_waiting() || (query.due.is_some() && query.state != QueryState::NoResponse)
}
