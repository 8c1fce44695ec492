//! One bus: its discovery engine, its bus status and its load.
//!
//! Inputs: frames, bus statuses, time. Does not know how frames are received.

use super::address_names::AddressNames;
use super::controller_status::ControllerStatus;
use super::load_meter::LoadMeter;
use super::status_changes::{StatusChange, status_changes};
use crate::discovery::{
    AddressSender, BusTraffic, BusVerdict, Config, Counters, Device, DeviceId, DeviceRequest,
    DiscoveryProgress, Engine, Event, FrameSequence, HeardUid, OwnAddress, RequestId, SequenceEnd,
    SequenceId, TimeDoubt,
};
use crate::finding::Finding;
use crate::frame::Frame;
use crate::status::{BusState, BusStatus, Link, RateSearch};
use crate::text::without_bit_rates;
use crate::time::{Duration, Instant, debug_assert_later};
use crate::wire::descriptor::DescriptorField;
use crate::wire::id::Address;
use crate::wire::profile::Profile;
use std::sync::Arc;

/// Listening time after which a listed device counts as missing where no requests are sent.
const LISTEN_TIME: Duration = Duration::from_secs(5);
/// A transmit queue that was full for this long contains outdated requests.
const QUEUE_STALE_AFTER: Duration = Duration::from_millis(1500);
/// Bus errors in 3 s, without a valid frame, that indicate a wrong bit rate.
const ONLY_ERRORS_MIN: u32 = 64;

/// Memory of the engine, and more for each device and each finding, in bytes. Measured: the
/// resident memory of 200 copies of buses with 1 to 100 devices.
const BYTES_OF_A_BUS: usize = 40_000;
const BYTES_OF_A_DEVICE: usize = 4_500;
const BYTES_OF_A_FINDING: usize = 3_000;

/// Time between two calls that discard frames to be sent where there are none. Chosen: a small part of
/// the time that the engine listens.
const DISCARD_INTERVAL: Duration = Duration::from_millis(200);
/// Calls of the engine at one moment at most: what it handles may make more due at once.
const ENGINE_PASSES: usize = 8;

/// One bus.
#[derive(Clone, Debug)]
pub struct Bus {
    /// Name, for example `can0`.
    pub name: String,
    /// Adapter status, as last reported.
    pub status: BusStatus,
    /// Frame rate and load.
    pub meter: LoadMeter,
    /// End of its log; `None` while frames can arrive. No time passes on an ended bus.
    pub ended: Option<Instant>,
    controller: ControllerStatus,
    /// State of the controller before the last frame, if that reported another one.
    state_before: Option<BusState>,
    engine: Engine,
    names: AddressNames,
    /// The moment since which frames could be received; kept once it was long enough.
    up_since: Option<Instant>,
    /// Start of the period in which the transmit queue is full.
    full_since: Option<Instant>,
    /// Time when frames to be sent were last discarded, since the bus cannot send.
    discarded_at: Option<Instant>,
    /// The port reported that frames can no longer be received, and not yet that they can.
    is_port_away: bool,
    /// End of the quarantine after a stall: until then frames may be late and are only counted.
    quarantined_until: Option<Instant>,
}

impl Bus {
    /// Returns a bus that starts at `now`.
    pub fn new(now: Instant, name: String, config: Config) -> Self {
        let status = BusStatus { bitrate: config.bitrate, ..BusStatus::default() };
        let (engine, meter) = (Engine::new(now, config), LoadMeter::new(now));
        Self {
            name,
            status,
            meter,
            ended: None,
            controller: ControllerStatus::default(),
            state_before: None,
            engine,
            names: AddressNames::default(),
            up_since: None,
            full_since: None,
            discarded_at: None,
            is_port_away: false,
            quarantined_until: None,
        }
    }

    /// The name without the bit rates at which an slcan adapter is opened: `slcan:/dev/ttyACM0`
    /// for `slcan:/dev/ttyACM0@500000`.
    pub fn name_without_rates(&self) -> &str {
        without_bit_rates(&self.name)
    }

    /// Approximate size in bytes, as of a copy.
    pub fn size(&self) -> usize {
        size_of::<Self>()
            + BYTES_OF_A_BUS
            + self.meter.size()
            + self.devices().len() * BYTES_OF_A_DEVICE
            + self.findings().len() * BYTES_OF_A_FINDING
            + self.names.size()
    }

    // ---- the engine's results --------------------------------------------------------------

    /// Devices of the bus, lost ones included.
    pub fn devices(&self) -> &[Device] {
        self.engine.devices()
    }

    /// The device with this identity; `None` after its removal.
    pub fn device(&self, id: DeviceId) -> Option<&Device> {
        self.engine.device(id)
    }

    /// The present device at an address.
    pub fn device_at(&self, address: Address) -> Option<&Device> {
        self.engine.device_at(address)
    }

    /// Nodes that send heartbeats with a UID from an address, in the order of joining.
    pub fn senders_at(&self, address: Address) -> Vec<AddressSender> {
        self.engine.senders_at(address)
    }

    /// Where each UID was heard last.
    pub fn heard_uids(&self) -> impl Iterator<Item = HeardUid> {
        self.engine.heard_uids()
    }

    /// Heartbeat period of an address: measured, else that of the profile.
    pub fn heartbeat_period(&self, address: Address) -> Duration {
        self.engine.heartbeat_period(address)
    }

    /// Names of the devices at each address, by time.
    pub fn names(&self) -> &AddressNames {
        &self.names
    }

    /// Findings of the engine.
    pub fn findings(&self) -> &[Finding] {
        self.engine.findings()
    }

    /// Counter that changes when a finding is opened or has another state.
    pub(super) fn findings_revision(&self) -> u64 {
        self.engine.findings_revision()
    }

    /// Frame and error counters of the engine.
    pub fn counters(&self) -> Counters {
        self.engine.counters()
    }

    /// Why the times of its frames do not show some conflicts.
    pub fn time_doubt(&self) -> Option<TimeDoubt> {
        self.engine.time_doubt()
    }

    /// What its frames show about its protocol.
    pub fn traffic(&self) -> BusTraffic {
        self.engine.traffic()
    }

    /// Returns true if it speaks another protocol than DES.
    pub fn is_foreign(&self) -> bool {
        self.traffic().verdict() == BusVerdict::Foreign
    }

    /// Progress of the enumeration.
    pub fn progress(&self) -> DiscoveryProgress {
        self.engine.progress()
    }

    /// Number of enumeration rounds that are over.
    pub(in crate::app) fn finished_rounds(&self) -> u32 {
        self.engine.finished_rounds()
    }

    /// Returns true while the engine is suspended: the bus is down, or frames may be late.
    pub(in crate::app) fn is_suspended(&self) -> bool {
        self.engine.is_suspended()
    }

    /// State of descan's own address.
    pub fn own_address(&self) -> OwnAddress {
        self.engine.own_address()
    }

    /// Settings of the engine.
    pub fn config(&self) -> &Config {
        self.engine.config()
    }

    // ---- the bus itself --------------------------------------------------------------------

    /// Nominal bit rate in bit/s: the adapter's, else the configured or assumed one.
    pub fn bits_per_second(&self) -> u32 {
        self.status.bitrate.unwrap_or_else(|| self.config().bits_per_second())
    }

    /// Returns true if its load means nothing: the bit rate is neither known nor assumed for a
    /// controller, as in a log or on a virtual bus.
    pub fn lacks_bit_rate(&self) -> bool {
        self.status.bitrate.is_none() && self.status.rate_search == RateSearch::NoRate
    }

    /// Returns true if frames can be received and transmitted.
    pub fn is_up(&self) -> bool {
        is_up(&self.status)
    }

    /// Returns true if no frames can be received, and not because the log ended or the bus is
    /// still being opened.
    pub fn cannot_receive(&self) -> bool {
        !self.is_up() && self.ended.is_none() && self.status.link != Link::Opening
    }

    /// Returns true if the bus was up long enough to receive something of each device.
    pub(super) fn has_listened(&self, now: Instant) -> bool {
        self.is_up_for(now, LISTEN_TIME)
    }

    /// Returns the moment from which on [`Self::has_listened`]; `None` while the bus is down or bus-off.
    pub(in crate::app) fn listened_at(&self, now: Instant) -> Option<Instant> {
        self.end_of_listening(now, LISTEN_TIME)
    }

    /// Returns the moment from which on [`Self::is_up_for`] that time; `None` while the bus is down or bus-off.
    pub(in crate::app) fn end_of_listening(&self, now: Instant, time: Duration) -> Option<Instant> {
        let since = self.up_since.filter(|_| !self.engine.is_suspended())?;
        Some(since + time + self.engine.time_down_between(since, now))
    }

    /// Returns true if the bus has been up for this long, without the time in which its controller was
    /// bus-off.
    pub(in crate::app) fn is_up_for(&self, now: Instant, time: Duration) -> bool {
        let up_for =
            |since| now.since(since).saturating_sub(self.engine.time_down_between(since, now));
        self.up_since.is_some_and(|since| up_for(since) >= time)
    }

    /// Returns true if at least 64 bus errors and no valid frame were received in the last 3 s: the
    /// bit rate is probably wrong. A missing acknowledgement does not count as a bus error.
    pub fn has_only_bus_errors(&self) -> bool {
        let recent = || self.meter.seconds().rev().take(3);
        self.is_up()
            && recent().all(|second| second.frames == second.errors)
            && recent().map(|second| second.bus_errors).sum::<u32>() >= ONLY_ERRORS_MIN
    }

    /// Why frames of descan do not reach the bus; `None` if they do, or the bus is down.
    pub fn tx_blocked(&self) -> Option<TxBlocked> {
        if !self.is_up() {
            None
        } else if self.status.is_transmit_queue_full {
            Some(TxBlocked::QueueFull)
        } else {
            self.engine.has_no_ack().then_some(TxBlocked::NoAck)
        }
    }

    /// Number of received frames that were lost in controller, kernel or receive queue.
    pub fn lost(&self) -> u64 {
        lost(&self.status)
    }

    /// Returns true if nothing can be transmitted: down, bus-off or stopped.
    pub(super) fn is_unreachable(&self) -> bool {
        !matches!(self.status.link, Link::Opening | Link::Up)
            || matches!(self.status.state, BusState::BusOff | BusState::Stopped)
    }

    /// Returns true if nothing can or may be transmitted at present.
    fn cannot_send(&self) -> bool {
        self.is_unreachable() || self.status.listens_first || self.status.is_sending_paused
    }

    /// State of its controller: as the port knows it, else as error frames report it.
    pub fn controller(&self) -> ControllerStatus {
        self.controller.of_status_or(&self.status)
    }

    // ---- changes ---------------------------------------------------------------------------

    /// Passes a frame to the engine and the load meter.
    pub(super) fn receive(&mut self, frame: &Frame) {
        let before = self.controller;
        self.controller.note(frame);
        if self.controller.state != before.state {
            let before = before.of_status_or(&self.status).state;
            self.state_before = Some(before).filter(|before| *before != self.controller().state);
        }
        if self.is_quarantined(frame.time) {
            self.engine.count_frame_only(frame);
        } else {
            self.engine.handle_frame(frame);
        }
        // The end of a log may be reported before its last frames are received.
        self.ended = self.ended.map(|ended| ended.max(frame.time));
        let (bitrate, data_bitrate) = (self.bits_per_second(), self.status.data_bitrate);
        self.meter.add(frame, bitrate, data_bitrate);
    }

    /// State of the controller before the last frame, if that reported another one.
    pub(super) fn poll_state_change(&mut self) -> Option<BusState> {
        self.state_before.take()
    }

    /// The moment at which [`Self::handle_timeout`] is due.
    pub(super) fn poll_timeout(&self) -> Option<Instant> {
        let due = self.quarantined_until.or_else(|| self.engine.poll_timeout());
        due.filter(|_| self.ended.is_none())
    }

    /// Runs the timers of the engine, unless the bus is quarantined.
    pub(super) fn handle_timeout(&mut self, now: Instant) {
        if self.is_quarantined(now) {
            return;
        }
        self.discard_frames(now);
        for _ in 0..ENGINE_PASSES {
            self.engine.handle_timeout(now);
            if self.engine.poll_timeout().is_none_or(|due| due > now) {
                break;
            }
        }
        debug_assert_later(self.poll_timeout(), now);
    }

    /// The next frame to transmit.
    pub(super) fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.discard_frames(now);
        self.engine.poll_transmit(now)
    }

    /// Returns true if frames to be sent must be discarded: the bus cannot send. Without frames it is
    /// repeated now and then, so that the engine goes on listening.
    pub(in crate::app) fn must_discard_frames(&self, now: Instant) -> bool {
        let is_due = || self.discarded_at.is_none_or(|at| now.since(at) >= DISCARD_INTERVAL);
        self.cannot_send() && (self.engine.has_frames_to_send() || is_due())
    }

    /// A frame queued now would be late, and its missing ACK would prove nothing.
    fn discard_frames(&mut self, now: Instant) {
        if self.must_discard_frames(now) {
            self.discarded_at = Some(now);
            self.engine.handle_bus_unavailable(now);
        }
    }

    /// Returns true if the engine has an event.
    pub(super) fn has_events(&self) -> bool {
        self.engine.has_events()
    }

    /// The next engine event.
    pub(super) fn poll_event(&mut self) -> Option<Event> {
        let event = self.engine.poll_event()?;
        self.names.handle_event(&event);
        Some(event)
    }

    /// Restarts the enumeration.
    pub(super) fn rescan(&mut self, now: Instant) {
        self.engine.rescan(now);
    }

    /// Sends a frame as it stands.
    pub(super) fn send(&mut self, now: Instant, frame: Frame) {
        self.engine.send(now, frame);
    }

    /// Sends frames as they are; returns `None` if others are being sent.
    pub(super) fn send_frames(
        &mut self,
        now: Instant,
        sequence: FrameSequence,
    ) -> Option<SequenceId> {
        self.engine.send_frames(now, sequence)
    }

    /// Sends no further frame of its sequence.
    pub(super) fn stop_frames(&mut self, now: Instant, why: SequenceEnd) {
        self.engine.stop_frames(now, why);
    }

    /// Sends no more requests and flow control by itself.
    pub(super) fn yield_requests(&mut self, now: Instant) {
        self.engine.yield_requests(now);
    }

    /// Returns true while a sequence of frames is being sent.
    pub fn is_sending_frames(&self) -> bool {
        self.engine.is_sending_frames()
    }

    /// Sends a request to a device, once; returns `None` if it cannot be sent.
    pub(super) fn request(&mut self, now: Instant, request: DeviceRequest) -> Option<RequestId> {
        self.engine.request(now, request)
    }

    /// Reads a field of the descriptor of a device, or all; returns the number of fields.
    pub(super) fn read_descriptor(
        &mut self,
        now: Instant,
        device: DeviceId,
        field: Option<DescriptorField>,
    ) -> usize {
        self.engine.read_descriptor(now, device, field)
    }

    /// Returns true while fields of a device's descriptor are still to be read.
    pub fn is_reading_descriptor(&self, device: DeviceId) -> bool {
        self.engine.is_reading_descriptor(device)
    }

    /// Removes the lost devices.
    pub(super) fn remove_lost_devices(&mut self) {
        self.engine.remove_lost_devices();
    }

    /// Suspends the engine from `since` on; frames received before `until` are only counted, since
    /// their time may be that of their late reception.
    pub(super) fn quarantine(&mut self, since: Instant, until: Instant) {
        self.engine.suspend(since);
        self.quarantined_until = Some(until);
    }

    /// Returns true if the bus is quarantined at `now`; ends a quarantine that is over.
    fn is_quarantined(&mut self, now: Instant) -> bool {
        let Some(until) = self.quarantined_until else { return false };
        if now < until {
            return true;
        }
        self.quarantined_until = None;
        self.engine.restart(until);
        false
    }

    /// Handles a new bus status; returns what changed, or `None` for an unchanged one.
    pub(super) fn update_status(
        &mut self,
        now: Instant,
        status: BusStatus,
    ) -> Option<StatusChange> {
        if self.status == status {
            return None;
        }
        let state_before = self.controller().state;
        let old = std::mem::replace(&mut self.status, status);
        if old.log_changes < self.status.log_changes {
            self.begin_another_log(now);
        }
        let new = &self.status;
        let lines = status_changes(&old, new, state_before);
        let has_listened = self.has_listened(now);
        let kept = self.up_since.filter(|_| is_up(new) || has_listened);
        self.up_since = kept.or(is_up(new).then_some(now));
        // While others went on, the devices of a log at its end were not heard.
        let stood_since = self.ended.filter(|ended| is_up(new) && *ended < now);
        let was_open = !matches!(old.link, Link::Opening | Link::Ended);
        // The counters show an outage that began and ended between two statuses.
        let was_away = !is_up(&old) || old.outages < new.outages || old.bus_offs < new.bus_offs;
        // An error frame that reports bus-off suspends the engine, too, and ends without the port.
        let was_away_before =
            self.is_port_away && self.quarantined_until.is_none() && self.engine.is_suspended();
        let came_back = is_up(new) && (was_away && was_open || was_away_before);
        let is_down = !is_up(new) && new.link != Link::Ended;
        // The bus may have come up and gone down again between two statuses.
        let goes_down = is_down
            && (is_up(&old) || old.bus_offs < new.bus_offs || old.state != new.state && was_open);
        self.is_port_away = goes_down || self.is_port_away && !is_up(new);
        let newly_lost = lost(new).saturating_sub(lost(&old));
        if old.bitrate != new.bitrate {
            self.engine.set_bitrate(new.bitrate);
        }
        match new.link {
            Link::Ended => {
                self.ended.get_or_insert(now);
            }
            _ => self.ended = None,
        }
        self.note_queue(now);
        if goes_down {
            self.engine.suspend(now);
            self.quarantined_until = None;
        }
        if let Some(since) = stood_since {
            self.engine.suspend(since);
            self.meter.advance(since, true);
            self.meter.advance(now, false);
        }
        if came_back {
            self.controller.restart();
        }
        if came_back || stood_since.is_some() {
            self.engine.restart(now);
        }
        if old.state != self.status.state
            && matches!(self.status.state, BusState::ErrorPassive | BusState::BusOff)
        {
            self.engine.stop_frames(now, SequenceEnd::ControllerErrors);
        }
        if newly_lost > 0 {
            self.engine.handle_lost_frames(now, newly_lost);
        }
        Some(StatusChange { lines, has_other_state: self.controller().state != state_before })
    }

    /// Reads frames by another profile from now on. Returns true if the devices start over.
    pub(super) fn set_profile(&mut self, now: Instant, profile: &Arc<Profile>) -> bool {
        let starts_over = self.engine.set_profile(now, profile.clone());
        if starts_over {
            self.names.vacate(now);
        }
        starts_over
    }

    /// Forgets the devices of the log before; who was where remains known for its frames.
    fn begin_another_log(&mut self, now: Instant) {
        self.engine.begin_another_recording(now);
        self.names.vacate(now);
        self.controller = ControllerStatus::default();
        self.up_since = None;
        self.is_port_away = false;
        self.quarantined_until = None;
    }

    /// Tells the engine that requests were delayed, once a queue that was full for a long time is
    /// not full any more.
    fn note_queue(&mut self, now: Instant) {
        if self.status.is_transmit_queue_full {
            self.full_since.get_or_insert(now);
        } else if self.full_since.take().is_some_and(|since| now.since(since) >= QUEUE_STALE_AFTER)
        {
            self.engine.handle_delayed_requests(now);
        }
    }
}

/// The reason why frames of descan do not reach a bus that is up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TxBlocked {
    /// The transmit queue is full: earlier frames are not transmitted either.
    QueueFull,
    /// Frames are not acknowledged, or do not return as loopback.
    NoAck,
}

/// Returns true if frames can be received and transmitted in this status.
fn is_up(status: &BusStatus) -> bool {
    let off = matches!(status.state, BusState::BusOff | BusState::Stopped | BusState::Down);
    status.link == Link::Up && !off
}

/// Number of received frames that were lost in controller, kernel or receive queue.
fn lost(status: &BusStatus) -> u64 {
    status.kernel_drops + status.queue_drops + status.controller_overruns
}
