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
//! observation        a received frame, decoded once
//! receive            passes frames to what reads them
//! responses          DES responses
//! recent_requests    requests to which responses are matched
//! bus_protocol       whether the bus speaks DES
//!
//! device_tracker     what the frames show: rows, findings, events
//! device_table       the device rows
//! heartbeats         mode, UID, reboots
//! identity           replaced boards, moved devices
//! sender_names       which name is that of which UID
//! claims             address claims and addresses given up
//! resolution         events about them
//! periods            heartbeat period of each address
//! presence           online, stale, lost
//! transfers          multi-frame responses
//! descriptors        what devices are and how they are configured
//! recorded_node      frames that a log marks as sent
//! conflicts          history of each address, evidence of conflicts in it
//! finding_tracker    state of the findings
//! finding_text       their text
//! errors             bus errors
//!
//! requester          own node, and what it sends
//! local_node         own address, own responses
//! rounds             enumeration rounds
//! query_scheduler    which request is sent when
//! device_requests    requests to one device: descriptors, commands
//! frame_sequence     frames that the user sends as they are
//! idle_gaps          requests wait for heartbeats
//! outbox             transmit budget, acknowledgement
//!
//! device, event, config: data that other modules read
//! ```

mod address_table;
mod bus_protocol;
mod claims;
mod config;
mod conflicts;
mod debug_messages;
mod descriptors;
mod device;
mod device_requests;
mod device_table;
mod device_tracker;
mod errors;
mod event;
mod finding_text;
mod finding_tracker;
mod frame_sequence;
mod heartbeats;
mod identity;
mod idle_gaps;
mod local_node;
mod observation;
mod outages;
mod outbox;
mod period_error;
mod periods;
mod presence;
mod query_scheduler;
mod receive;
mod recent_requests;
mod recorded_node;
mod requester;
mod resolution;
mod responses;
mod rounds;
mod sender_names;
mod transfers;

pub use bus_protocol::{BusTraffic, BusVerdict};
pub use claims::{AddressSender, HeardUid};
pub use config::Config;
pub use conflicts::TimeDoubt;
pub use debug_messages::{DebugCount, DebugCounts};
pub use descriptors::{DeviceDescriptor, FieldContent, FieldReading, given_fields};
pub use device::{
    Device, DeviceId, DeviceService, HeartbeatStats, ModeChange, Presence, ProtocolDeviation,
    Query, QueryFault, QueryState,
};
pub use device_requests::{DeviceRequest, RequestId, RequestObstacle, RequestOutcome};
pub use event::{Event, EventKind, OtherDevice, ServicesNews};
pub use frame_sequence::{FrameSequence, SequenceEnd, SequenceId};
pub use period_error::PeriodError;

use crate::finding::Finding;
use crate::frame::Frame;
use crate::time::{Duration, Instant, debug_assert_later};
use crate::wire::id::Address;
use crate::wire::profile::Profile;
use device_tracker::DeviceTracker;
use observation::{Observation, ObservationKind};
use requester::Requester;
use std::sync::Arc;
use transfers::Transfers;

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
    /// Number of queries and other requests without a response that are sent or due.
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
    /// Counts a frame by its kind.
    fn count(&mut self, observation: &Observation<'_>) {
        self.frames += 1;
        match observation.kind {
            ObservationKind::Error => self.errors += 1,
            ObservationKind::NonPlatform => self.non_platform += 1,
            ObservationKind::Platform(..) if observation.frame.is_tx => self.sent += 1,
            ObservationKind::Platform(header, _) if !header.is_conforming() => {
                self.non_conforming += 1;
            }
            ObservationKind::Platform(..) => {}
        }
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
#[derive(Clone, Debug)]
pub struct Engine {
    tracker: DeviceTracker,
    requester: Requester,
    transfers: Transfers,
}

impl Engine {
    /// Creates an engine that starts at `now`.
    pub fn new(now: Instant, config: Config) -> Self {
        Self {
            requester: Requester::new(now, &config),
            tracker: DeviceTracker::new(now, config),
            transfers: Transfers::new(),
        }
    }

    /// Processes a frame at its own time. A time before the last known one counts as that one.
    pub fn handle_frame(&mut self, frame: &Frame) {
        self.tracker.advance(frame.time);
        self.process_frame(frame);
        self.tracker.emit_bus_errors();
        if self.tracker.conflicts.finding_tracker().has_changed() {
            self.tracker.emit_finding_changes();
        }
    }

    /// Updates the counters only. For frames that waited during a stall, whose time may be wrong:
    /// devices, presence and findings do not change.
    pub fn count_frame_only(&mut self, frame: &Frame) {
        let observation = Observation::new(self.tracker.now, frame, &self.tracker.config);
        self.tracker.counters.count(&observation);
    }

    /// Notes that `count` frames were lost before descan could read them.
    pub fn handle_lost_frames(&mut self, now: Instant, count: u64) {
        self.tracker.advance(now);
        self.tracker.conflicts.finding_tracker_mut().note_lost_frames(self.tracker.now, count);
        self.tracker.errors.note_lost_frames();
        self.tracker.repeat_failed_queries();
        self.tracker.emit_finding_changes();
        self.tracker.wake_at(self.tracker.now);
    }

    /// Processes everything that is due at `now`.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.tracker.advance(now);
        if self.tracker.now < self.tracker.wake {
            return;
        }
        for _ in 0..MAX_PASSES {
            self.do_due();
            self.tracker.wake = self.next_wake();
            if self.tracker.wake > self.tracker.now {
                break;
            }
        }
        debug_assert_later(self.poll_timeout(), self.tracker.now);
    }

    fn do_due(&mut self) {
        self.requester.handle_timeout(&mut self.tracker);
        self.expire_transfers();
        self.send_due_flow_control(self.tracker.now);
        self.tracker.update_presence();
        self.tracker.check_suspicions();
        self.tracker.check_errors(self.requester.may_send_requests(&self.tracker));
        self.requester.send_due_queries(&mut self.tracker, self.transfers.open_sources());
        self.step_device_requests();
        self.requester.send_sequence(&mut self.tracker);
        self.tracker.emit_finding_changes();
    }

    /// Returns the latest time of the next call of [`handle_timeout`](Self::handle_timeout); `None`
    /// if nothing is due.
    pub fn poll_timeout(&self) -> Option<Instant> {
        (self.tracker.wake != NO_TIMEOUT).then_some(self.tracker.wake)
    }

    /// Returns the next frame to send, if any. The frame counts as sent. `now` never decreases from
    /// call to call.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let frame = self.requester.outbox.pop(now)?;
        if !self.tracker.config.has_loopback {
            self.tracker.counters.sent += 1;
            let sent = Observation::new(now, &frame, &self.tracker.config);
            self.note_own_request(&sent);
            self.note_own_device_request(&sent);
            self.requester.note_sequence_frame(&mut self.tracker, &frame);
        }
        self.tracker.wake_at(now);
        Some(frame.with_bus(self.tracker.config.bus))
    }

    /// Returns true if [`poll_transmit`](Self::poll_transmit) returns a frame.
    pub fn has_frames_to_send(&self) -> bool {
        !self.requester.outbox.is_empty()
    }

    /// Handles a bus that cannot be used at present: discards frames not sent or not confirmed, and
    /// releases the own address, which is claimed again after listening.
    pub fn handle_bus_unavailable(&mut self, now: Instant) {
        self.requester.outbox.clear();
        self.requester.device_requests.end_all(RequestObstacle::BusUnavailable);
        self.end_sequence_of_lost_bus();
        if !self.tracker.config.listen_only {
            self.requester.local_node.listen(now);
        }
    }

    /// Returns true if [`poll_event`](Self::poll_event) returns an event.
    pub fn has_events(&self) -> bool {
        self.tracker.has_events()
    }

    /// Returns the next event, oldest first.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.tracker.poll_event()
    }

    /// Command: starts enumeration rounds again and queries all services.
    pub fn rescan(&mut self, now: Instant) {
        self.tracker.advance(now);
        let now = self.tracker.now;
        self.requester.is_foreign_scanned = true;
        self.requester.restart_rounds(&self.tracker);
        for address in Address::all() {
            // A row that was replaced at its address cannot be queried.
            if let Some(device) = self.tracker.device_table.current_device_mut(address)
                && device.is_present()
                && self.tracker.config.send_requests
            {
                device.has_asked_all_services = false;
                device.services_query.schedule(now);
                device.descriptor.is_read = false;
            }
        }
        self.tracker.wake_at(now);
    }

    /// Command: from now on sends no requests and no flow control, only its heartbeat, its responses and
    /// what [`send`](Self::send) is given: another requester in this program uses its address.
    pub fn yield_requests(&mut self, now: Instant) {
        self.tracker.advance(now);
        self.requester.is_yielded = true;
        self.tracker.wake_at(self.tracker.now);
    }

    /// Command: removes the lost devices, and forgets what has changed in the services of the others.
    pub fn remove_lost_devices(&mut self) {
        let tracker = &mut self.tracker;
        let (now, periods) = (tracker.now, Address::all().map(|it| tracker.sender_period(it)));
        let periods: Vec<Duration> = periods.collect();
        tracker.claims.forget_absent(now, |address| periods[address.index()]);
        self.tracker.device_table.remove_lost();
        self.tracker.device_table.devices_mut().iter_mut().for_each(Device::confirm_services);
    }

    /// Notes that the bus is down: presence does not change until [`restart`](Self::restart), or
    /// until a frame is received.
    pub fn suspend(&mut self, now: Instant) {
        self.tracker.advance(now);
        self.tracker.outages.begin(self.tracker.now);
    }

    /// Returns true while the engine is suspended by [`suspend`](Self::suspend).
    pub fn is_suspended(&self) -> bool {
        self.tracker.outages.is_on()
    }

    /// Returns for how long the bus was down since `then`, up to `now`.
    pub fn time_down_between(&self, then: Instant, now: Instant) -> Duration {
        self.tracker.outages.time_down_between(then, now)
    }

    /// Command: claims an address and starts enumeration rounds again, as after bus-off or when the
    /// interface came up. Devices and findings stay.
    pub fn restart(&mut self, now: Instant) {
        self.tracker.advance(now);
        // The outage may end before `suspend` was called.
        self.tracker.outages.begin(self.tracker.now);
        self.tracker.end_outage();
        self.requester.outbox.clear();
        self.requester.device_requests.end_all(RequestObstacle::BusUnavailable);
        self.end_sequence_of_lost_bus();
        self.transfers.clear();
        self.tracker.errors.restart();
        self.requester.rounds.stop();
        if !self.tracker.config.listen_only {
            self.requester.local_node.listen(self.tracker.now);
        }
        self.tracker.wake_at(self.tracker.now);
    }

    /// Command: starts without devices and findings, for frames of another recording. The counters go
    /// on, and ids are not used again.
    pub fn begin_another_recording(&mut self, now: Instant) {
        self.tracker.advance(now);
        let before = &self.tracker;
        let mut next = Self::new(before.now, before.config.clone());
        next.tracker.counters = before.counters;
        next.tracker.device_table.number_after(&before.device_table);
        let findings = before.conflicts.finding_tracker();
        next.tracker.conflicts.finding_tracker_mut().count_after(findings);
        next.requester.device_requests = std::mem::take(&mut self.requester.device_requests);
        next.requester.device_requests.end_all(RequestObstacle::DeviceLeft);
        next.requester.sequences = std::mem::take(&mut self.requester.sequences);
        next.requester.end_sequence(&mut next.tracker, SequenceEnd::Stopped);
        *self = next;
    }

    /// Command: reads frames by another profile from now on. Returns true if devices and findings depend
    /// on what changed: they start over.
    pub fn set_profile(&mut self, now: Instant, profile: Arc<Profile>) -> bool {
        let before = std::mem::replace(&mut self.tracker.config.profile, profile);
        let starts_over = self.tracker.config.profile.reads_otherwise(&before);
        if starts_over {
            let is_suspended = self.is_suspended();
            let mut local_node = self.requester.local_node.clone();
            let rng = self.requester.rng.clone();
            self.begin_another_recording(now);
            // descan stays on the bus, at its address.
            local_node.set_profile(&self.tracker.config.profile);
            (self.requester.local_node, self.requester.rng) = (local_node, rng);
            if is_suspended {
                self.suspend(now);
            } else {
                self.requester.restart_rounds(&self.tracker);
            }
        }
        starts_over
    }

    /// Notes that delayed requests were sent all at once: a device that responds to several of
    /// them, now or a little later, is not in conflict.
    pub fn handle_delayed_requests(&mut self, now: Instant) {
        self.tracker.advance(now);
        self.tracker.conflicts.ignore_surplus_responses(self.tracker.now);
    }

    /// Sets the bit rate in bit/s; `None` if unknown.
    pub fn set_bitrate(&mut self, bitrate: Option<u32>) {
        self.tracker.config.bitrate = bitrate;
    }

    /// Returns all device rows, in the order of appearance.
    pub fn devices(&self) -> &[Device] {
        self.tracker.device_table.devices()
    }

    /// Returns the row with that id.
    pub fn device(&self, id: DeviceId) -> Option<&Device> {
        self.tracker.device_table.get(id)
    }

    /// Returns the current row at `address`: that of the device which responds there now.
    pub fn device_at(&self, address: Address) -> Option<&Device> {
        self.tracker.device_table.current_device(address)
    }

    /// Returns the nodes that send heartbeats from `address` or did so until at most 5 periods ago, in
    /// the order of joining; several while they are in conflict.
    pub fn senders_at(&self, address: Address) -> Vec<AddressSender> {
        let (now, period) = (self.tracker.now, self.tracker.sender_period(address));
        let mut senders = self.tracker.claims.senders(now, address, period);
        let current = self.tracker.device_table.current_row(address);
        let names = &self.tracker.sender_names;
        // Alone it is the device of the row.
        let blank = names.blank_sender(now, address, period, current);
        senders.extend(blank.filter(|_| !senders.is_empty()));
        senders.sort_by_key(|sender| (sender.first, sender.uid));
        senders
    }

    /// Returns where each UID was heard last, that of devices without a row, too.
    pub fn heard_uids(&self) -> impl Iterator<Item = HeardUid> {
        self.tracker.claims.heard_uids()
    }

    /// Returns the heartbeat period of an address: measured, else that of the profile.
    pub fn heartbeat_period(&self, address: Address) -> Duration {
        self.tracker.period_of(address)
    }

    /// Returns all findings in the order of their first evidence, including cleared ones.
    pub fn findings(&self) -> &[Finding] {
        self.tracker.conflicts.finding_tracker().findings()
    }

    /// Returns a counter that grows when a finding is opened or has another state.
    pub fn findings_revision(&self) -> u64 {
        self.tracker.conflicts.finding_tracker().revision()
    }

    /// Returns the state of descan's own address.
    pub fn own_address(&self) -> OwnAddress {
        self.requester.local_node.own_address()
    }

    /// Returns true while sending is paused because no node acknowledges descan's frames.
    pub fn has_no_ack(&self) -> bool {
        self.requester.outbox.has_no_ack()
    }

    /// Returns the progress of discovery.
    pub fn progress(&self) -> DiscoveryProgress {
        let present = self.devices().iter().filter(|device| device.is_present());
        let mut progress = DiscoveryProgress {
            rounds: self.requester.rounds.finished,
            ..DiscoveryProgress::default()
        };
        for device in present {
            progress.present += 1;
            progress.named += usize::from(device.name.is_some());
            progress.with_services += usize::from(device.services.is_some());
            progress.open_queries += usize::from(is_open(&device.name_query))
                + usize::from(is_open(&device.services_query));
        }
        progress.open_queries += self.requester.device_requests.count();
        let is_settled = !self.requester.rounds.is_starting()
            && !self.requester.rounds.is_collecting()
            && progress.open_queries == 0
            && !self.tracker.conflicts.finding_tracker().is_suspicious()
            && !self.tracker.errors.has_pending_suspect();
        progress.is_complete = self.requester.local_node.held().is_some()
            && (is_settled || self.requester.is_left_alone(&self.tracker));
        progress
    }

    /// Number of enumeration rounds that are over, also of those that a log holds.
    pub fn finished_rounds(&self) -> u32 {
        self.requester.rounds.finished
    }

    /// Returns why the times of its frames do not show some conflicts.
    pub fn time_doubt(&self) -> Option<TimeDoubt> {
        self.tracker.conflicts.time_doubt()
    }

    /// Returns what the frames of other nodes show about the protocol of the bus.
    pub fn traffic(&self) -> BusTraffic {
        self.tracker.protocol.traffic()
    }

    /// Returns the counters.
    pub fn counters(&self) -> Counters {
        Counters {
            over_limit: self.tracker.counters.over_limit
                + self.tracker.conflicts.finding_tracker().over_limit,
            ..self.tracker.counters
        }
    }

    /// Returns the settings.
    pub fn config(&self) -> &Config {
        &self.tracker.config
    }

    // --- private --------------------------------------------------------------------------

    fn end_sequence_of_lost_bus(&mut self) {
        let why = SequenceEnd::Obstacle(RequestObstacle::BusUnavailable);
        self.requester.end_sequence(&mut self.tracker, why);
    }

    fn next_wake(&self) -> Instant {
        let mut wake = NO_TIMEOUT;
        let mut at = |due: Option<Instant>| wake = wake.min(due.unwrap_or(NO_TIMEOUT));
        at(self.tracker.presence_timeout());
        at(self.requester.poll_timeout(&self.tracker));
        at(self.transfers.poll_timeout());
        at(self.tracker.conflicts.finding_tracker().poll_timeout(&self.tracker.outages));
        at(self.tracker.errors_timeout());
        wake
    }
}

/// Stands for no timeout.
const NO_TIMEOUT: Instant = Instant::from_micros(u64::MAX);

/// Returns true if a response is awaited, or the query is due and did not fail before.
fn is_open(query: &Query) -> bool {
    query.is_waiting() || (query.due.is_some() && query.state != QueryState::NoResponse)
}
