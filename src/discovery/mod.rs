//! The discovery engine of one bus: finds devices, asks them for names and services, judges
//! their presence, collects evidence of collisions, and holds our own address.
//!
//! A state machine without I/O and without a clock:
//!
//! * `handle_frame`, `handle_timeout`: the only things, with the commands, that change it;
//! * commands (`rescan`, …): what the user wants;
//! * `poll_transmit`, `poll_event`: what is to be sent, what happened;
//! * `poll_timeout`: when to be called again at the latest.
//!
//! ```text
//! hearing     what a frame tells; questions and answers    heartbeats   mode, UID, reboots
//! roster      the rows                                     identity     boards swapped, devices moved
//! claims      who claims an address, who gives way         resolution   telling so
//! presence    who is there                                 transfers    answers in several frames
//! rounds      when everybody is asked                      asking       who is asked what, and when
//! station     our own address, and our answers             outbox       our share; who acknowledges
//! collisions  evidence, from raw frames                    cases        what it amounts to
//! memory      of an address: what takes turns              doubling     what repeats everything
//! errors      errors of the bus, and of one address        wording      findings in words
//! device, event, finding: what others read
//! ```
//!
//! Call one that changes it, then drain the polls. It does not know des.json, the screen, or
//! where frames come from.

mod address_history;
mod claims;
mod config;
mod conflict_detector;
mod device;
mod device_table;
mod duplicate_frames;
mod errors;
mod event;
mod finding_text;
mod finding_tracker;
mod heartbeats;
mod identity;
mod local_node;
mod outbox;
mod presence;
mod query_scheduler;
mod receive;
mod resolution;
mod rounds;
mod transfers;

pub use crate::finding::{Confidence, Evidence, Finding, FindingKey, FindingKind};
pub use config::Config;
pub use device::{
    Device, DeviceId, DeviceService, HeartbeatStats, ModeChange, Presence, Query, QueryFault,
    QueryState, Quirk,
};
pub use event::{ConflictParty, Event, EventKind};

use crate::frame::{Frame, FrameKind};
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header};
use crate::wire::node::Mode;
use claims::AddressClaims;
use conflict_detector::ConflictDetector;
use device_table::DeviceTable;
use errors::BusErrorTracker;
use heartbeats::BusDelayTracker;
use local_node::{AddressChange, LocalNode};
use outbox::{Acknowledgement, Outbox};
use presence::{Outages, PresenceInput};
use rounds::Rounds;
use std::collections::VecDeque;
use transfers::Transfers;

/// Events that wait to be polled; more are dropped, oldest first.
const MAX_EVENTS: usize = 4096;

/// What we are on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OwnAddress {
    /// Nothing: we only listen.
    None,
    /// Listening for used addresses before the first word.
    Listening,
    /// About to claim this one.
    Claiming(Address),
    /// Not to be had: somebody else uses the one we are told to have, or, without one, all are
    /// used. We go on listening, and take one as soon as it is free.
    Blocked(Option<Address>),
    /// Ours.
    Held(Address),
}

/// Where discovery stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct DiscoveryProgress {
    /// Rounds finished.
    pub rounds: u32,
    /// Devices here whose name is known.
    pub named: usize,
    /// Devices here.
    pub here: usize,
    /// Devices here whose services are known.
    pub with_services: usize,
    /// Questions that still wait for an answer or for their turn.
    pub open_requests: usize,
    /// A round brought nothing new, every question is answered or given up, and no suspicion
    /// is open.
    pub settled: bool,
}

/// The named counters of one bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Counters {
    /// Data, remote and error frames heard, ours included.
    pub frames: u64,
    /// Frames we sent and the bus took.
    pub sent: u64,
    /// Error frames.
    pub errors: u64,
    /// Standard and remote frames: foreign, never interpreted.
    pub non_platform: u64,
    /// Identifiers that are none of the nine types.
    pub non_conforming: u64,
    /// Answers that could not be used, or only in part.
    pub malformed: u64,
    /// Transfers given up.
    pub transfers_failed: u64,
    /// Device rows, findings or transfers refused because there were too many.
    pub refused: u64,
}

impl Counters {
    /// Counts a frame by what it is; comes back with its header, where it is the platform's.
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

/// The engine of one bus. See the module's documentation.
#[derive(Debug)]
pub struct Engine {
    config: Config,
    rng: fastrand::Rng,
    now: Instant,
    device_table: DeviceTable,
    rounds: Rounds,
    transfers: Transfers,
    claims: AddressClaims,
    conflicts: ConflictDetector,
    errors: BusErrorTracker,
    local_node: LocalNode,
    outbox: Outbox,
    lateness: BusDelayTracker,
    outages: Outages,
    broadcasts: VecDeque<PendingBroadcast>,
    /// When each address asked something last.
    asked_at: [Option<Instant>; Address::COUNT],
    events: VecDeque<Event>,
    counters: Counters,
    /// Questions that await an answer, counted anew whenever anybody is to be asked.
    waiting: usize,
    wake: Instant,
}

/// A who-is-there to all that answers may still come to.
#[derive(Clone, Copy, Debug)]
struct PendingBroadcast {
    time: Instant,
    rnd7: Address,
    ours: bool,
}

impl Engine {
    /// An engine that starts at `now`.
    pub fn new(now: Instant, config: Config) -> Self {
        let mut rng = fastrand::Rng::with_seed(config.seed);
        let period = config.profile.heartbeat.period();
        Self {
            local_node: LocalNode::new(now, &config, &mut rng),
            outbox: Outbox::new(now, config.echo),
            conflicts: ConflictDetector::new(
                config.bus,
                period,
                config.listen_only,
                config.profile.uid.clone(),
                config.seed,
            ),
            errors: BusErrorTracker::default(),
            device_table: DeviceTable::new(config.bus),
            rounds: Rounds::new(),
            transfers: Transfers::new(),
            lateness: BusDelayTracker::default(),
            claims: AddressClaims::new(period),
            outages: Outages::default(),
            broadcasts: VecDeque::new(),
            asked_at: [None; Address::COUNT],
            events: VecDeque::new(),
            counters: Counters::default(),
            waiting: 0,
            wake: now,
            now,
            rng,
            config,
        }
    }

    /// Takes a frame, dated by its own time. Time never goes back: a frame dated before the
    /// last moment known counts as of that moment.
    pub fn handle_frame(&mut self, frame: &Frame) {
        self.advance(frame.time);
        self.process_frame(frame);
        self.emit_bus_errors();
        if self.conflicts.finding_tracker().has_changed() {
            self.emit_finding_changes();
        }
    }

    /// Counts a frame that may be older than it says: nothing is learnt from it.
    pub fn count_only(&mut self, frame: &Frame) {
        self.counters.count(frame);
    }

    /// Takes note that `count` frames were lost before they could be read.
    pub fn handle_lost(&mut self, now: Instant, count: u64) {
        self.advance(now);
        self.conflicts.cases_mut().note_lost_frames(self.now, count);
        self.errors.note_lost_frames();
        self.emit_finding_changes();
        self.wake_at(self.now);
    }

    /// Does what is due at `now`.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.advance(now);
        if self.now < self.wake {
            return;
        }
        let now = self.now;
        let change = self.outbox.handle_timeout(now);
        self.acknowledgement(change);
        let change = self.local_node.handle_timeout(
            now,
            &self.config.profile,
            &mut self.rng,
            &mut self.outbox,
        );
        self.address_changed(change);
        self.expire_transfers();
        self.judge_presence();
        self.check_suspicions();
        self.check_errors();
        self.send_due_queries();
        self.emit_finding_changes();
        self.wake = self.next_wake();
    }

    /// When [`handle_timeout`](Self::handle_timeout) is to be called at the latest.
    pub fn poll_timeout(&self) -> Option<Instant> {
        (self.wake != NO_TIMEOUT).then_some(self.wake)
    }

    /// The next frame to send.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let frame = self.outbox.pop(now)?;
        if !self.config.echo {
            self.counters.sent += 1;
            self.note_own_request(now, &frame);
        }
        self.wake_at(now);
        Some(frame.with_bus(self.config.bus))
    }

    /// There is no bus at the moment: forgets what was to be sent, and what was sent and not
    /// taken yet, and takes no address before it has listened again.
    pub fn wait_for_bus(&mut self, now: Instant) {
        self.outbox.clear();
        if !self.config.listen_only {
            self.local_node.listen(now);
        }
    }

    /// The next thing that happened.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Command: ask everybody again now, services included.
    pub fn rescan(&mut self, now: Instant) {
        self.advance(now);
        let now = self.now;
        if self.local_node.held().is_some() && self.config.scan {
            self.rounds.restart(now);
        }
        for address in Address::all() {
            // A row at whose address another one speaks cannot be asked.
            if let Some(device) = self.device_table.current_device_mut(address)
                && device.is_present()
                && self.config.scan
            {
                device.services_query.schedule(now);
            }
        }
        self.wake_at(now);
    }

    /// Command: forget the devices that are lost.
    pub fn clear_lost(&mut self) {
        self.device_table.clear_lost();
    }

    /// No frame can reach us from now on, because the bus is down: who is there cannot be judged
    /// until [`restart`](Self::restart), or until somebody is heard.
    pub fn suspend(&mut self, now: Instant) {
        self.advance(now);
        self.outages.begin(self.now);
    }

    /// Whether [`suspend`](Self::suspend) still holds.
    pub fn is_suspended(&self) -> bool {
        self.outages.is_on()
    }

    /// Command: begin anew with our address and rounds, as after bus-off or when the interface
    /// came back. What is known stays.
    pub fn restart(&mut self, now: Instant) {
        self.advance(now);
        // It may be over before it was told.
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

    /// Questions of ours that had waited for long went out all at once: who answers more than one of
    /// them, now or a little later, is not two.
    pub fn handle_delayed_requests(&mut self, now: Instant) {
        self.advance(now);
        self.conflicts.ignore_extra_responses(self.now);
    }

    fn end_outage(&mut self) {
        if self.outages.end(self.now) {
            self.device_table.devices_mut().iter_mut().for_each(|device| device.rounds_missed = 0);
            self.wake_at(self.now);
        }
    }

    /// Tells the bit rate, once it is known.
    pub fn set_bitrate(&mut self, bitrate: Option<u32>) {
        self.config.bitrate = bitrate;
    }

    /// All rows, in the order of appearance.
    pub fn devices(&self) -> &[Device] {
        self.device_table.devices()
    }

    /// One row.
    pub fn device(&self, id: DeviceId) -> Option<&Device> {
        self.device_table.by_id(id)
    }

    /// The row that speaks from `address` now.
    pub fn device_at(&self, address: Address) -> Option<&Device> {
        self.device_table.current_device(address)
    }

    /// All findings, by the time of their first evidence, cleared ones included.
    pub fn findings(&self) -> &[Finding] {
        self.conflicts.finding_tracker().findings()
    }

    /// What we are on the bus.
    pub fn own_address(&self) -> OwnAddress {
        self.local_node.own_address()
    }

    /// Whether we keep silent because nobody acknowledges our frames.
    pub fn is_unacknowledged(&self) -> bool {
        self.outbox.is_missing()
    }

    /// Where discovery stands.
    pub fn progress(&self) -> DiscoveryProgress {
        let here = self.devices().iter().filter(|device| device.is_present());
        let mut progress =
            DiscoveryProgress { rounds: self.rounds.finished, ..DiscoveryProgress::default() };
        for device in here {
            progress.here += 1;
            progress.named += usize::from(device.name.is_some());
            progress.with_services += usize::from(device.services.is_some());
            progress.open_requests += usize::from(is_open(&device.name_query))
                + usize::from(is_open(&device.services_query));
        }
        progress.settled = self.local_node.held().is_some()
            && !self.rounds.is_starting()
            && !self.rounds.is_collecting()
            && progress.open_requests == 0
            && !self.conflicts.finding_tracker().is_suspicious()
            && !self.errors.has_pending_suspect();
        progress
    }

    /// The named counters.
    pub fn counters(&self) -> Counters {
        Counters {
            refused: self.counters.refused + self.conflicts.finding_tracker().refused,
            ..self.counters
        }
    }

    /// The settings it runs with.
    pub fn config(&self) -> &Config {
        &self.config
    }

    // --- inside --------------------------------------------------------------------------

    fn advance(&mut self, now: Instant) {
        self.now = self.now.max(now);
    }

    fn wake_at(&mut self, at: Instant) {
        self.wake = self.wake.min(at);
    }

    fn measure(&self) -> PresenceInput<'_> {
        PresenceInput {
            outages: &self.outages,
            period: self.config.profile.heartbeat.period(),
            rounds: !self.config.listen_only
                && self.config.scan
                && !self.config.round_period.is_zero(),
        }
    }

    fn emit(&mut self, index: usize, kind: EventKind) {
        let device = self.device_table.get(index);
        let (id, address, name) = (device.id, device.address, device.name.clone());
        self.push_event(Event {
            time: self.now,
            device: Some(id),
            address: Some(address),
            name,
            kind,
        });
    }

    /// Tells something of a device that may have no row, at an address that may be another's.
    fn emit_for(&mut self, device: Option<DeviceId>, address: Address, kind: EventKind) {
        let name = device.and_then(|id| self.device_table.by_id(id)?.name.clone());
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

    fn emit_finding_changes(&mut self) {
        while let Some((key, confidence)) = self.conflicts.cases_mut().poll_changed() {
            let shared = key.kind.is_conflict() || key.kind == FindingKind::BusErrors;
            if let (true, Confidence::Cleared, Some(address)) = (shared, confidence, key.address) {
                self.requery(address);
            }
            let at = key.address.and_then(|address| self.device_table.active_at(address));
            match at {
                Some(index) => self.emit(index, EventKind::Finding { key, confidence }),
                None => self.emit_bus_event(EventKind::Finding { key, confidence }),
            }
        }
    }

    /// Whoever is left at `address` after a collision: what is known may be the other's.
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

    fn acknowledgement(&mut self, change: Option<Acknowledgement>) {
        match change {
            Some(Acknowledgement::Missing) => {
                self.emit_bus_event(EventKind::NobodyAcknowledges);
                // Nobody heard the question: it is asked again when we try again.
                if self.local_node.held().is_some() && self.config.scan {
                    self.rounds.restart(self.now);
                }
            }
            Some(Acknowledgement::Back) => {
                self.emit_bus_event(EventKind::Acknowledged);
                if self.local_node.held().is_some() && self.config.scan {
                    self.rounds.restart(self.now);
                }
                self.wake_at(self.now);
            }
            None => {}
        }
    }

    fn address_changed(&mut self, change: Option<AddressChange>) {
        match change {
            Some(AddressChange::Taken(address)) => {
                self.emit_bus_event(EventKind::OwnAddress(address));
                if self.config.scan {
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
        self.conflicts.cases_mut().handle_timeout(now, |address| {
            if let Some(device) = device_table.current_device_mut(address)
                && device.is_present()
            {
                device.name_query.schedule(now);
            }
        });
    }

    /// Sets the presence of every row, and tells what changed.
    fn judge_presence(&mut self) {
        if self.outages.is_on() {
            return;
        }
        // A row that turns out to have moved takes another one's place: the number changes.
        let mut index = 0;
        while index < self.device_table.devices().len() {
            self.judge_device(index);
            index += 1;
        }
    }

    fn judge_device(&mut self, index: usize) {
        let measure = self.measure();
        let device = self.device_table.get(index);
        let presence = if self.device_table.is_current(index) {
            measure.judge(device, self.now).0
        } else {
            self.judge_replaced(device)
        };
        let was = device.presence;
        // What another one beats does not bring it back, nor is it this one that is silent then.
        let beaten_for =
            device.last_heartbeat_was_other_node && self.device_table.is_current(index);
        let gone = matches!(was, Presence::Lost | Presence::Asleep);
        let anothers = presence == Presence::Online || presence == Presence::Stale && gone;
        if presence == Presence::Lost {
            self.device_table.get_mut(index).last_heartbeat_was_other_node = false;
        }
        if presence == was || (anothers && beaten_for) {
            return;
        }
        let address = self.device_table.get(index).address;
        let device = self.device_table.get_mut(index);
        device.presence = presence;
        device.presence_since = self.now;
        // Whether it still does, nobody knows.
        device.is_resolving &= presence == Presence::Online;
        if presence == Presence::Online {
            // It may have been away for new firmware.
            let suspect = self.errors.is_suspect(address);
            let query = &mut self.device_table.get_mut(index).services_query;
            if suspect {
                query.schedule(self.now);
            } else {
                query.restart(self.now);
            }
            self.wake_at(self.now);
            self.emit(index, EventKind::Returned { was });
        } else {
            self.emit(index, EventKind::Presence(presence));
        }
        if presence == Presence::Lost {
            if self.device_table.is_current(index) {
                self.conflicts.forget(self.now, address);
                self.errors.forget(address);
            }
            self.find_move_of_lost(index);
        }
    }

    /// A row at whose address another one speaks: there while it still answers for itself.
    fn judge_replaced(&self, device: &Device) -> Presence {
        if matches!(device.presence, Presence::Lost | Presence::Asleep) {
            return device.presence;
        }
        let patience =
            if self.conflicts.finding_tracker().is_open_at(device.address) { 8 } else { 4 };
        let answered = device.name_query.answered_at.max(device.replaced_at);
        let answered = answered.unwrap_or(device.last_seen);
        let period = self.config.profile.heartbeat.period();
        match device.mode {
            _ if self.now.since(answered) < period * patience => device.presence,
            Some(Mode::Idle) => Presence::Asleep,
            _ => Presence::Lost,
        }
    }

    fn next_wake(&self) -> Instant {
        let measure = self.measure();
        let mut wake = NO_TIMEOUT;
        let mut at = |due: Option<Instant>| wake = wake.min(due.unwrap_or(NO_TIMEOUT));
        let judged = if self.outages.is_on() { &[] } else { self.device_table.devices() };
        for (index, device) in judged.iter().enumerate() {
            if self.device_table.is_current(index) {
                at(measure.judge(device, self.now).1);
            } else if !matches!(device.presence, Presence::Lost | Presence::Asleep) {
                at(Some(self.now + Duration::from_secs(1)));
            }
        }
        at(self.asking_timeout());
        at(self.local_node.poll_timeout());
        at(self.transfers.poll_timeout());
        at(self.conflicts.finding_tracker().poll_timeout());
        at(self.errors_timeout());
        at(self.outbox.poll_timeout());
        wake
    }
}

const NO_TIMEOUT: Instant = Instant::from_micros(u64::MAX);

/// Whether an answer is awaited or the question is still to be asked the first times.
fn is_open(query: &Query) -> bool {
    query.is_waiting() || (query.due.is_some() && query.state != QueryState::Unanswered)
}
