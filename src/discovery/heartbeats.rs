//! What heartbeats tell: mode, UID, reboots, and who else beats with the same UID.

use super::device::{ModeChange, Query, Quirk, SILENT_PERIODS};
use super::resolution::Claim;
use super::{Engine, EventKind, Presence};
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header};
use crate::wire::node::{Heartbeat, Mode, Uid};

/// A heartbeat that is off the beat by more than this part of a period came late.
const LATE: f64 = 0.1;
/// So many late ones within a few periods are the bus's doing, not their senders'.
const LATE_TOGETHER: u32 = 3;

/// Whose heartbeats came late lately. Where several do, it is the bus that holds them up.
#[derive(Debug, Default)]
pub(super) struct BusDelayTracker {
    began: Instant,
    late: [u128; 2],
}

impl BusDelayTracker {
    /// A heartbeat of `address` came `gap` after the one before.
    fn see(&mut self, now: Instant, address: Address, gap: Duration, period: Duration) {
        if now.since(self.began) >= period * 2 {
            let old = if now.since(self.began) < period * 4 { self.late[0] } else { 0 };
            (self.began, self.late) = (now, [0, old]);
        }
        let periods = gap.as_secs_f64() / period.as_secs_f64();
        if (periods - periods.round()).abs() > LATE && periods > 1.0 {
            self.late[0] |= 1 << address.index();
        }
    }

    pub(super) fn is_bus_wide(&self) -> bool {
        (self.late[0] | self.late[1]).count_ones() >= LATE_TOGETHER
    }
}

impl Engine {
    pub(super) fn process_heartbeat(
        &mut self,
        now: Instant,
        index: usize,
        header: Header,
        frame: &Frame,
    ) {
        let profile = &self.config.profile;
        let codes = profile.modes.codes();
        let heartbeat = Heartbeat::decode(frame.data(), &profile.heartbeat, &codes);
        let period = profile.heartbeat.period();
        let previous_beat = self.device_table.get(index).heartbeat.last;
        let first = previous_beat.is_none();
        if let Some(last) = previous_beat {
            self.lateness.see(now, header.source, now.since(last), period);
        }
        let missed_in_outage = previous_beat
            .map_or(0, |last| self.outages.heartbeats_missed_in_outage(last, now, period));
        let device = self.device_table.get_mut(index);
        let expected = device.heartbeat.period();
        let jitter = device.heartbeat.jitter();
        let gap = device.heartbeat.record_heartbeat(now, period, missed_in_outage);
        if first {
            self.wake_at(now + period * 2);
        }
        let device = self.device_table.get_mut(index);
        device.is_resolving = matches!(heartbeat.mode, Some(Mode::Init | Mode::Arslv));
        device.error = heartbeat.error.or(device.error);
        if heartbeat.uid.is_none() || heartbeat.mode.is_none() {
            device.note(Quirk::ShortHeartbeat);
        }
        let was_lost = device.presence == Presence::Lost;
        let uid_before = device.uid;
        let mode_before = device.mode;
        let uid_changed = match (heartbeat.uid, device.uid) {
            (Some(new), Some(old)) => new != old,
            (Some(_), None) => true,
            _ => false,
        };
        if uid_changed {
            device.uid_before = device.uid;
            device.uid = heartbeat.uid;
        }
        let address = header.source;
        let claim = Claim { index, address, heartbeat, uid_before, mode_before, gap };
        let sender = self.note_sender(claim);
        let device = self.device_table.get_mut(index);
        device.last_heartbeat_was_other_node = sender.is_another;
        // In an early mode after a pause, or off the beat: it started anew. With another UID it is
        // rather another board.
        let paused = gap.is_some_and(|gap| gap > period.mul_f64(SILENT_PERIODS));
        let early = device.is_resolving && paused && device.mode != heartbeat.mode;
        let period = expected.unwrap_or(period);
        let same = !uid_changed && !was_lost;
        if !same {
            device.heartbeat.forget_phase();
        }
        let shifted = same && device.heartbeat.is_phase_shifted(now, previous_beat, period, jitter);
        let restarted = !was_lost
            && (first || !uid_changed || device.uid_before.is_none())
            && (early || shifted && !self.lateness.is_bus_wide());
        // Somebody else may beat from here too, or take its place. Who changes its mode may say so
        // at once.
        let off_beat = gap.is_some_and(|gap| is_off_schedule(gap, period, jitter))
            && device.mode == heartbeat.mode
            && !self.lateness.is_bus_wide();
        let claimed_by_another = sender.is_another && sender.claims;
        if (off_beat || claimed_by_another) && !self.conflicts.finding_tracker().is_open_at(address)
        {
            device.name_query.schedule(now + period);
            device.services_query.schedule(now + period * 6);
            self.wake_at(now);
        }
        let device = self.device_table.get_mut(index);
        if let Some(mode) = heartbeat.mode {
            let fits = mode.is_working().is_none_or(|working| working == device.working);
            if fits {
                self.local_node.note_heartbeat();
            } else {
                device.note(Quirk::ModeContradictsU);
            }
            // Where two beat from one address, each has a mode of its own.
            let from = sender.mode_before;
            if !sender.is_another {
                device.mode = Some(mode);
            }
            if !sender.is_another && from != Some(mode) {
                device.remember_mode(ModeChange { time: now, mode });
                // Whatever was there before, this one began just now; and not all services are
                // there in every mode. Where two of one UID beat, one in a working mode and one in
                // another, this is all that is left of the first when it goes.
                let began = matches!(from, Some(Mode::Init | Mode::Arslv));
                let works = mode.is_working();
                let other = works.is_some() && from.is_some_and(|from| from.is_working() != works);
                if (began || other) && !self.conflicts.finding_tracker().is_open_at(address) {
                    device.services_query.schedule(now);
                    device.name_query.schedule(now);
                }
                self.emit(index, EventKind::Mode { from, to: mode });
            }
        }
        if restarted {
            self.device_table.get_mut(index).heartbeat.forget_phase();
            self.note_reboot(now, index);
        }
        let device = self.device_table.get(index);
        let (mode, name) = ((device.working, device.is_resolving), device.name.clone());
        self.conflicts.note_heartbeat(now, address, heartbeat.uid, mode, name.as_ref(), frame);
        self.errors.note_heartbeat(now, address, frame);
        if self.conflicts.finding_tracker().is_suspicious() {
            self.wake_at(now);
        }
        self.emit_gave_up(address, &sender);
        if uid_changed {
            self.uid_learnt(now, index, first);
        }
        self.emit_claim(address, &sender);
        // Its own heartbeat before must have said the same: boards that swap addresses have not.
        if let (Some(uid), Some(previous), false) = (heartbeat.uid, previous_beat, uid_changed) {
            self.compare_uid(now, address, uid, previous, frame);
        }
    }

    fn note_reboot(&mut self, now: Instant, index: usize) {
        let address = self.device_table.get(index).address;
        // Two whose answers destroy each other start anew each time they are asked.
        let shared =
            self.errors.is_suspect(address) || self.conflicts.finding_tracker().is_open_at(address);
        let ask = if shared { Query::schedule } else { Query::restart };
        let device = self.device_table.get_mut(index);
        device.reboots += 1;
        device.rebooted_at = Some(now);
        // It may have new firmware.
        ask(&mut device.services_query, now);
        ask(&mut device.name_query, now);
        self.emit(index, EventKind::Rebooted);
        self.wake_at(now);
    }

    /// The node at this row has another UID than before, or one for the first time.
    fn uid_learnt(&mut self, now: Instant, index: usize, first: bool) {
        let period = self.config.profile.heartbeat.period();
        let device = self.device_table.get(index);
        // Who is known for longer had no heartbeat until now.
        let known = !first || device.name.is_some() && now.since(device.first_seen) > period * 3;
        if known && !self.conflicts.finding_tracker().is_open_at(device.address) {
            // Another board, perhaps, which may lay its answers into frames in another way: ask
            // who it is. For its services once it is clear that it is alone: two boards that
            // answer in several frames at once destroy each other's.
            let device = self.device_table.get_mut(index);
            device.framing = None;
            device.name_query.restart(now);
            device.services_query.schedule(now + period * 6);
            self.wake_at(now);
        }
        self.find_move_to(index);
    }

    /// Two addresses that keep beating with one UID.
    fn compare_uid(
        &mut self,
        now: Instant,
        address: Address,
        uid: Uid,
        previous: Instant,
        frame: &Frame,
    ) {
        let period = self.config.profile.heartbeat.period();
        if uid.is_blank() || now.since(previous) < period / 2 {
            return;
        }
        // A row that another one has replaced says nothing any more.
        let rows = self.device_table.devices().iter().enumerate();
        let mut current = rows.filter(|(at, _)| self.device_table.is_current(*at));
        let other = current.find_map(|(_, other)| {
            let last = other.heartbeat.last.filter(|last| *last > previous)?;
            let same = other.uid == Some(uid) && other.address != address;
            same.then_some((other.address, last))
        });
        if let Some((other, since)) = other {
            self.conflicts.note_same_uid(now, (address, other), since, frame);
            self.wake_at(now);
        }
    }
}

/// Whether a heartbeat of a steady sender comes too soon or too late: less sure a sign than
/// [`is_out_of_phase`], and reason enough for a question.
fn is_off_schedule(gap: Duration, period: Duration, jitter: Option<Duration>) -> bool {
    let Some(jitter) = jitter else { return false };
    let periods = gap.as_secs_f64() / period.as_secs_f64();
    let off = (periods - periods.round().max(1.0)).abs();
    off > (6.0 * jitter.as_secs_f64() / period.as_secs_f64()).max(0.05)
}
