//! What heartbeats tell: mode, UID, reboots, and who else beats with the same UID.

use super::device::{ModeChange, Quirk};
use super::resolution::Claim;
use super::{Engine, EventKind, Presence};
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header};
use crate::wire::node::{Heartbeat, Mode, Uid};

/// A gap of this many periods between heartbeats may be a reboot.
const REBOOT_GAP: f64 = 1.4;

impl Engine {
    pub(super) fn hear_heartbeat(
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
        let device = self.roster.get_mut(index);
        let expected = device.heartbeat.period();
        let jitter = device.heartbeat.jitter();
        let first = device.heartbeat.last.is_none();
        let previous_beat = device.heartbeat.last;
        let gap = device.heartbeat.beat(now, period);
        if first {
            self.wake_at(now + period * 2);
        }
        let device = self.roster.get_mut(index);
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
        let device = self.roster.get_mut(index);
        device.is_beaten_for = sender.is_another;
        // In an early mode after a pause, or off the beat: it started anew. With another UID it is
        // rather another board.
        let paused = gap.is_some_and(|gap| gap > period.mul_f64(REBOOT_GAP));
        let early = matches!(heartbeat.mode, Some(Mode::Init | Mode::Arslv));
        let early = early && paused && device.mode != heartbeat.mode;
        let restarted = !was_lost
            && (first || !uid_changed || device.uid_before.is_none())
            && (early
                || gap.is_some_and(|gap| is_out_of_phase(gap, expected.unwrap_or(period), jitter)));
        if let Some(mode) = heartbeat.mode {
            let fits = mode.is_working().is_none_or(|working| working == device.working);
            if fits {
                self.station.note_heartbeat();
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
                self.tell(index, EventKind::Mode { from, to: mode });
            }
        }
        if restarted {
            self.note_reboot(now, index);
        }
        let device = self.roster.get(index);
        let (working, name) = (device.working, device.name.clone());
        self.collisions.see_heartbeat(now, address, heartbeat.uid, working, name.as_ref(), frame);
        self.errors.see_heartbeat(now, address, frame);
        if self.collisions.is_suspicious() {
            self.wake_at(now);
        }
        self.tell_gave_way(address, &sender);
        if uid_changed {
            self.uid_learnt(now, index, first);
        }
        self.tell_claim(address, &sender);
        if let (Some(uid), Some(previous)) = (heartbeat.uid, previous_beat) {
            self.compare_uid(now, address, uid, previous, frame);
        }
    }

    fn note_reboot(&mut self, now: Instant, index: usize) {
        let device = self.roster.get_mut(index);
        device.reboots += 1;
        device.rebooted_at = Some(now);
        // It may have new firmware.
        device.services_query.renew(now);
        device.name_query.renew(now);
        self.tell(index, EventKind::Rebooted);
        self.wake_at(now);
    }

    /// The node at this row has another UID than before, or one for the first time.
    fn uid_learnt(&mut self, now: Instant, index: usize, first: bool) {
        if !first && !self.collisions.is_open_at(self.roster.get(index).address) {
            // Another board, perhaps: ask who it is. Not for its services yet: two boards that
            // answer in several frames at once destroy each other's.
            self.roster.get_mut(index).name_query.renew(now);
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
        let other = self.roster.devices().iter().find(|other| {
            other.uid == Some(uid)
                && other.address != address
                && other.heartbeat.last.is_some_and(|last| last > previous)
        });
        if let Some(other) = other.map(|other| other.address) {
            self.collisions.see_same_uid(now, address, other, frame);
            self.wake_at(now);
        }
    }
}

/// Whether a gap between heartbeats is no whole number of periods: the sender started anew.
fn is_out_of_phase(gap: Duration, period: Duration, jitter: Option<Duration>) -> bool {
    let periods = gap.as_secs_f64() / period.as_secs_f64();
    if !(REBOOT_GAP..=30.0).contains(&periods) {
        return false;
    }
    let off = (periods - periods.round()).abs();
    let noise = jitter.map_or(0.0, |jitter| jitter.as_secs_f64() / period.as_secs_f64());
    off > (4.0 * noise).max(0.15)
}
