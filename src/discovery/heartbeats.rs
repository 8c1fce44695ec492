//! Heartbeats: updates mode, UID and statistics of a device, detects reboots and duplicate UIDs.

use super::conflicts::{Repetition, SenderState};
use super::device::{MISSED_HEARTBEAT_PERIODS, ModeChange, ProtocolDeviation, Query};
use super::device_tracker::DeviceTracker;
use super::local_node::is_inspector_uid;
use super::periods::PeriodChange;
use super::resolution::HeartbeatContext;
use super::{DeviceId, EventKind, Presence};
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header};
use crate::wire::node::{Heartbeat, Mode, Uid};

/// Deviation from the schedule, in periods, from which a heartbeat is late. Chosen: arbitration
/// delays a heartbeat by some milliseconds unless the bus is full.
const LATE_FRACTION: f64 = 0.1;
/// Number of devices with late or missing heartbeats within a few periods from which the bus is the
/// cause. Two may have rebooted together.
const BUS_WIDE: u32 = 3;
/// Periods in which heartbeats are late together. Chosen: a burst of traffic lasts seconds.
const LATE_PERIODS: u32 = 2;
/// Periods in which a missing heartbeat shows that frames of a device are lost. With 30 % of the
/// frames lost, as many heartbeats in a row arrive in 3 % of the cases.
const LOST_PERIODS: u32 = 10;

/// A set of addresses that is forgotten after one to two spans.
#[derive(Clone, Debug, Default)]
struct RecentAddresses {
    began: Instant,
    current: u128,
    previous: u128,
}

impl RecentAddresses {
    fn advance(&mut self, now: Instant, span: Duration) {
        let elapsed = now.since(self.began);
        if elapsed >= span {
            self.previous = if elapsed < span * 2 { self.current } else { 0 };
            (self.began, self.current) = (now, 0);
        }
    }

    fn insert(&mut self, address: Address) {
        self.current |= 1 << address.index();
    }

    fn remove(&mut self, address: Address) {
        self.current &= !(1 << address.index());
        self.previous &= !(1 << address.index());
    }

    fn all(&self) -> u128 {
        self.current | self.previous
    }
}

/// Devices whose heartbeats were recently late or missing. If there are several, the bus delays or
/// loses frames.
#[derive(Clone, Debug, Default)]
pub(super) struct BusDelayTracker {
    late: RecentAddresses,
    missing: RecentAddresses,
}

impl BusDelayTracker {
    /// Notes a heartbeat of `address` that arrived `gap` after the previous one.
    fn note_heartbeat(&mut self, now: Instant, address: Address, gap: Duration, period: Duration) {
        self.late.advance(now, period * LATE_PERIODS);
        self.missing.advance(now, period * LOST_PERIODS);
        let periods = gap.as_secs_f64() / period.as_secs_f64();
        if (periods - periods.round()).abs() > LATE_FRACTION {
            if periods > 1.0 {
                self.late.insert(address);
            }
        } else if periods > 1.5 {
            self.missing.insert(address);
        }
    }

    /// Notes that the period of `address` is another one than assumed: no heartbeat was missing.
    fn note_period(&mut self, address: Address) {
        self.missing.remove(address);
    }

    /// Returns true if the bus delays heartbeats of several devices.
    pub(super) fn is_bus_wide(&self) -> bool {
        self.late.all().count_ones() >= BUS_WIDE
    }

    /// Returns true if frames of `address`, or of several devices, are lost on their way.
    pub(super) fn loses_frames(&self, address: Address) -> bool {
        let missing = self.missing.all();
        missing & 1 << address.index() != 0 || missing.count_ones() >= BUS_WIDE
    }
}

impl DeviceTracker {
    /// Processes a heartbeat of the device of `row`.
    pub(super) fn process_heartbeat(
        &mut self,
        row: DeviceId,
        header: Header,
        heartbeat: Heartbeat,
        frame: &Frame,
        repetition: Repetition,
    ) {
        let now = self.now;
        self.check_request_in_cfg(now, row, &heartbeat);
        let period = self.conflicts.periods().of(header.source);
        let Some(device) = self.device_table.get(row) else { return };
        let previous_heartbeat = device.heartbeat.last;
        let first = previous_heartbeat.is_none();
        if let Some(last) = previous_heartbeat {
            self.lateness.note_heartbeat(now, header.source, now.since(last), period);
        }
        let missed_in_outage =
            previous_heartbeat.map_or(0, |last| self.outages.heartbeats_missed(last, now, period));
        let Some(device) = self.device_table.get_mut(row) else { return };
        let expected = device.heartbeat.period_of_all();
        let jitter = device.heartbeat.jitter_of_all();
        let expects = self.conflicts.periods().is_reliable(header.source);
        let expected_in_outage = expects.then_some(missed_in_outage);
        let gap = device.heartbeat.record_heartbeat(now, heartbeat.uid, period, expected_in_outage);
        // The second one shows when the third is due.
        if device.heartbeat.count <= 2 {
            self.wake_at(now + period * 2);
        }
        let other_row = self.other_row_of_sender(header.source, heartbeat.uid);
        let may_be_other_board =
            self.may_be_other_board(row, other_row, header.source, heartbeat.uid);
        let Some(device) = self.device_table.get_mut(row) else { return };
        device.is_resolving = matches!(heartbeat.mode, Some(Mode::Init | Mode::Arslv));
        device.error_code = heartbeat.error.or(device.error_code);
        let alphabet = &self.config.profile.uid;
        device.is_debug |= heartbeat.uid.is_some_and(|uid| is_inspector_uid(uid, alphabet));
        if heartbeat.uid.is_none() || heartbeat.mode.is_none() {
            device.note_deviation(ProtocolDeviation::ShortHeartbeat);
        }
        let was_lost = device.presence == Presence::Lost;
        let uid_before = device.heartbeat_uid;
        let mode_before = device.mode;
        let uid_changed = match (heartbeat.uid, uid_before) {
            (Some(new), Some(old)) => new != old,
            (Some(_), None) => true,
            _ => false,
        };
        if uid_changed {
            device.uid_before = uid_before;
            device.heartbeat_uid = heartbeat.uid;
        }
        if heartbeat.uid.is_some() && !may_be_other_board {
            device.uid = heartbeat.uid;
        }
        let address = header.source;
        let has_other_row = other_row.is_some();
        let claim = HeartbeatContext {
            row,
            has_other_row,
            address,
            heartbeat,
            uid_before,
            mode_before,
            gap,
        };
        let sender_period = self.sender_period(address);
        self.sender_names.note_heartbeat(now, address, sender_period, heartbeat);
        let sender = self.note_sender(claim);
        let Some(device) = self.device_table.get_mut(row) else { return };
        device.last_heartbeat_was_other_node = sender.is_other_node;
        // An early mode after a gap, or a new phase, is a reboot. With another UID it is more
        // likely another board.
        let paused = gap.is_some_and(|gap| gap > period.mul_f64(MISSED_HEARTBEAT_PERIODS));
        let early = device.is_resolving && paused && device.mode != heartbeat.mode;
        let period = expected.unwrap_or(period);
        let same = !uid_changed && !was_lost;
        if !same {
            device.heartbeat.forget_phase();
        }
        let shifted =
            same && device.heartbeat.is_phase_shifted(now, previous_heartbeat, period, jitter);
        let restarted = !was_lost
            && (first || !uid_changed || device.uid_before.is_none())
            && (early || shifted && !self.lateness.is_bus_wide());
        // Another device may send heartbeats from this address too, or have replaced this one. A
        // device that changes its mode may send a heartbeat at once.
        let off_schedule = gap.is_some_and(|gap| is_off_schedule(gap, period, jitter))
            && device.mode == heartbeat.mode
            && !self.lateness.is_bus_wide();
        let claimed_by_another = sender.is_other_node && sender.claims;
        if (off_schedule || claimed_by_another)
            && !self.conflicts.finding_tracker().is_open_at(address)
        {
            device.name_query.schedule(now + period);
            device.services_query.schedule(now + period * 6);
            self.wake_at(now);
        }
        let Some(device) = self.device_table.get_mut(row) else { return };
        if let Some(mode) = heartbeat.mode {
            let fits = mode.is_working().is_none_or(|working| working == device.is_working);
            if !fits {
                device.note_deviation(ProtocolDeviation::ModeContradictsU);
            }
            // Two devices at one address each have their own mode.
            let from = sender.mode_before;
            if !sender.is_other_node {
                device.mode = Some(mode);
            }
            if !sender.is_other_node && from != Some(mode) {
                device.remember_mode(ModeChange { time: now, mode });
                // The device has just started, or changed between working and non-working, and may
                // have other services. If two devices with one UID send heartbeats, one working and
                // one not, this is the only trace when one of them leaves.
                let began = matches!(from, Some(Mode::Init | Mode::Arslv));
                let works = mode.is_working();
                let other = works.is_some() && from.is_some_and(|from| from.is_working() != works);
                if (began || other) && !self.conflicts.finding_tracker().is_open_at(address) {
                    device.services_query.schedule(now);
                    device.name_query.schedule(now);
                }
                self.emit(row, EventKind::Mode { from, to: mode });
            }
        }
        if let Some(other) = other_row {
            self.update_device_presence(other);
            if let Some(mode) = heartbeat.mode.filter(|_| sender.is_other_node) {
                self.set_mode_of_replaced(other, mode);
            }
        }
        if restarted {
            self.note_reboot(now, row);
        }
        let Some(device) = self.device_table.get(row) else { return };
        let state = SenderState {
            is_working: device.is_working,
            is_resolving: device.is_resolving,
            are_two_named: self.sender_names.are_two_named(now, address, sender_period),
            longest_period: self.sender_names.longest_period(now, address),
        };
        let name = device.name.clone();
        if repetition == Repetition::None && header.response {
            let uid = sender.uid_and_first();
            let change =
                self.conflicts.note_heartbeat(now, address, uid, state, name.as_ref(), frame);
            if change == PeriodChange::Expected {
                self.lateness.note_period(address);
            }
            if change != PeriodChange::None {
                self.wake_at(now);
            }
        }
        self.errors.note_heartbeat(now, address, frame);
        if self.conflicts.finding_tracker().is_suspicious() {
            self.wake_at(now);
        }
        self.emit_gave_up(address, &sender);
        if uid_changed {
            self.handle_uid_change(now, row, first, claimed_by_another);
        }
        self.emit_claim(address, &sender);
        // Compare only if its previous heartbeat had the same UID: boards that swap addresses have
        // not.
        if let (Some(uid), Some(previous), false) = (heartbeat.uid, previous_heartbeat, uid_changed)
        {
            self.compare_uid(now, address, uid, previous, frame);
        }
    }

    /// Returns true if a heartbeat with this UID may not be of the device of `row`: several send
    /// heartbeats from the address, and its name is not known to be that of the row.
    fn may_be_other_board(
        &self,
        row: DeviceId,
        other_row: Option<DeviceId>,
        address: Address,
        uid: Option<Uid>,
    ) -> bool {
        let period = self.sender_period(address);
        let own = self.sender_names.row_of(address, uid);
        own != Some(row)
            && (other_row.is_some() || self.sender_names.is_shared(self.now, address, period, uid))
    }

    /// Sets the mode of a device whose row is not the current one at its address.
    fn set_mode_of_replaced(&mut self, row: DeviceId, mode: Mode) {
        let now = self.now;
        let Some(device) = self.device_table.get_mut(row) else { return };
        let from = device.mode.replace(mode);
        if from != Some(mode) {
            device.remember_mode(ModeChange { time: now, mode });
            self.emit(row, EventKind::Mode { from, to: mode });
        }
    }

    /// Records a reboot and queries the device again.
    fn note_reboot(&mut self, now: Instant, row: DeviceId) {
        let Some(address) = self.device_table.get(row).map(|device| device.address) else { return };
        // Two devices that destroy each other's responses may reboot with each request.
        let shared =
            self.errors.is_suspect(address) || self.conflicts.finding_tracker().is_open_at(address);
        let schedule = if shared { Query::schedule } else { Query::restart };
        let Some(device) = self.device_table.get_mut(row) else { return };
        device.heartbeat.forget_phase();
        device.reboots += 1;
        device.rebooted_at = Some(now);
        // It may have new firmware.
        schedule(&mut device.services_query, now);
        schedule(&mut device.name_query, now);
        device.descriptor.is_read = false;
        self.emit(row, EventKind::Rebooted);
        self.wake_at(now);
    }

    /// Handles a new UID in the heartbeats of a row; `is_claim`: another device claims the address,
    /// which is an event of its own.
    fn handle_uid_change(&mut self, now: Instant, row: DeviceId, first: bool, is_claim: bool) {
        let Some(device) = self.device_table.get(row) else { return };
        let period = self.period_of(device.address);
        // A device known for longer sent no heartbeats before.
        let known = !first || device.name.is_some() && now.since(device.first_seen) > period * 3;
        let uids = device.uid_before.zip(device.heartbeat_uid);
        let uids = uids.filter(|(from, to)| !from.is_blank() && !to.is_blank());
        let is_shared = self.conflicts.finding_tracker().is_known_shared(device.address);
        let is_known = self.sender_names.row_of(device.address, device.heartbeat_uid).is_some()
            || self.other_row_of_sender(device.address, device.heartbeat_uid).is_some();
        if let Some((from, to)) = uids.filter(|_| !is_claim && !is_shared && !is_known) {
            self.emit(row, EventKind::UidChanged { from, to });
        }
        let Some(device) = self.device_table.get(row) else { return };
        if known && !self.conflicts.finding_tracker().is_open_at(device.address) {
            // It may be another board with another framing: query its name, and its services once
            // it is clear that it is alone, because two multi-frame responses at once destroy each
            // other.
            let Some(device) = self.device_table.get_mut(row) else { return };
            device.framing = None;
            device.name_query.restart(now);
            device.services_query.schedule(now + period * 6);
            self.wake_at(now);
        }
        self.find_move_to(row);
    }

    /// Reports two addresses that keep sending heartbeats with one UID.
    fn compare_uid(
        &mut self,
        now: Instant,
        address: Address,
        uid: Uid,
        previous: Instant,
        frame: &Frame,
    ) {
        let period = self.period_of(address);
        if uid.is_blank() || now.since(previous) < period / 2 {
            return;
        }
        // A replaced row does not send anything any more.
        let devices = self.device_table.devices().iter();
        let mut same = devices.filter(|it| it.heartbeat_uid == Some(uid) && it.address != address);
        let other = same.find_map(|other| {
            let last = other.heartbeat.last.filter(|last| *last > previous)?;
            self.device_table.is_current(other).then_some((other.address, last))
        });
        if let Some((other, since)) = other {
            self.conflicts.note_same_uid(now, (address, other), since, frame);
            self.wake_at(now);
        }
    }
}

/// Returns true if a heartbeat of a regular sender is early or late: a weaker sign than
/// [`is_phase_shifted`](super::device::HeartbeatStats::is_phase_shifted), enough for a name
/// request.
fn is_off_schedule(gap: Duration, period: Duration, jitter: Option<Duration>) -> bool {
    let Some(jitter) = jitter else { return false };
    let periods = gap.as_secs_f64() / period.as_secs_f64();
    let off = (periods - periods.round().max(1.0)).abs();
    off > (6.0 * jitter.as_secs_f64() / period.as_secs_f64()).max(0.05)
}
