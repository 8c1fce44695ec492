//! Address resolution as it is told: who claimed an address, who gave way, who turned up where.
//!
//! What happened is for [`claims`](super::claims) to find out; here it is told of the right
//! device, which may have no row yet.

use super::claims::{ClaimUpdate, HeartbeatInput, PAUSE};
use super::{ConflictParty, DeviceId, Engine, EventKind};
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::{Heartbeat, Mode, Uid};

/// Periods after a claim of somebody's address within which that one's leaving has to do with it.
const CONCERNS_FOR: u32 = 12;

/// A heartbeat, and what was known of the row at its address before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Claim {
    pub index: usize,
    pub address: Address,
    pub heartbeat: Heartbeat,
    pub uid_before: Option<Uid>,
    pub mode_before: Option<Mode>,
    pub gap: Option<Duration>,
}

/// Who sent a heartbeat.
#[derive(Debug)]
pub(super) struct Sender {
    /// Its UID, where that is not blank, and what is known by it.
    known: Option<(Uid, ClaimUpdate)>,
    /// Its mode before.
    pub mode_before: Option<Mode>,
    /// Whether the row at the address is somebody else's.
    pub is_another: bool,
    pub(super) claims: bool,
    holder: Option<ConflictParty>,
}

impl Engine {
    /// Finds out whose heartbeat this is, and whether it claims its address.
    pub(super) fn note_sender(&mut self, claim: Claim) -> Sender {
        let Claim { index, address, heartbeat, uid_before, mode_before, gap } = claim;
        let not_blank = |uid: Option<Uid>| uid.filter(|uid| !uid.is_blank());
        let (now, row) = (self.now, self.device_table.get(index).id);
        let arslv = heartbeat.mode == Some(Mode::Arslv) && mode_before != Some(Mode::Arslv);
        // Who claims anew was silent before: nobody claims what it holds.
        let held = gap.is_some_and(|gap| gap < self.pause());
        let over_held = arslv && held;
        let before = not_blank(uid_before);
        let Some(uid) = not_blank(heartbeat.uid) else {
            let again = heartbeat.mode == mode_before && held;
            if over_held {
                self.claims.note_claimed_over(now, address);
            }
            return Sender {
                known: None,
                mode_before,
                is_another: over_held,
                claims: heartbeat.mode == Some(Mode::Arslv) && !again,
                holder: over_held.then(|| self.party(row, before)),
            };
        };
        // It has a row of its own there, whose name it has yet to say again.
        let own = self.claims.row_of(uid).filter(|own| *own != row);
        let own = own
            .and_then(|own| self.device_table.by_id(own))
            .is_some_and(|it| it.address == address)
            && self.claims.is_shared(now, address, uid);
        let over = own || (over_held && before.is_none());
        let beat = HeartbeatInput { now, address, uid, mode: heartbeat.mode, row, over };
        let heard = self.claims.hear(beat, || self.device_table.reserve());
        let same = before.is_none() || before == Some(uid);
        Sender {
            known: Some((uid, heard)),
            mode_before: if same { mode_before } else { heard.mode_before },
            is_another: heard.is_another,
            claims: heard.claims,
            holder: (heard.is_another && self.device_table.get(index).is_present()).then(|| {
                let holder = self.claims.uid_of(row).or(before);
                self.party(row, holder)
            }),
        }
    }

    /// Tells who gave way, as far as this heartbeat shows it.
    pub(super) fn emit_gave_up(&mut self, address: Address, sender: &Sender) {
        let Some((uid, heard)) = sender.known else { return };
        let now = self.now;
        if let (Some(left), Some(then)) = (heard.left, heard.gave_way) {
            let to = self.claims.is_still_active(now, left, then, uid);
            let to = to.map(|(device, uid)| self.party(device, Some(uid)));
            let to = to.or_else(|| self.blank_party(left, then));
            // The row there may speak for the other one now.
            let here = self.row_of_sender(address, sender);
            let device = if self.row_left(left, &heard).is_some() { None } else { here };
            let device = device.unwrap_or(heard.device);
            let kind = EventKind::GaveWay { uid: Some(uid), to, inferred: false };
            self.emit_for(Some(device), left, kind);
        }
        for (device, silent) in self.claims.fallen_silent(now, address, uid) {
            let to = Some(self.party(heard.device, Some(uid)));
            let kind = EventKind::GaveWay { uid: Some(silent), to, inferred: true };
            // A row that both shared is the other one's now.
            let shared =
                self.device_table.current_device(address).is_some_and(|row| row.id == device);
            self.emit_for((!shared).then_some(device), address, kind);
        }
    }

    /// Tells that it turned up here, if it contended elsewhere before, and that it claims.
    pub(super) fn emit_claim(&mut self, address: Address, sender: &Sender) {
        if let Some((_, heard)) = sender.known
            && let (Some(left), false) = (heard.left, sender.is_another)
            && let (Some(old), Some(new)) =
                (self.row_left(left, &heard), self.device_table.active_at(address))
            && old != new
        {
            self.take_over_row(old, new);
        }
        let row = self.row_of_sender(address, sender);
        let mut device = row;
        if let Some((uid, heard)) = sender.known {
            let was =
                row.and_then(|row| self.claims.adopt(uid, row, || self.device_table.reserve()));
            if let (Some(was), Some(row)) = (was, row) {
                self.emit_for(Some(row), address, EventKind::Joined { was, before: None });
            }
            // Its row there is the other one's now, but not what was told before that one came.
            if let (Some(left), Some(row)) = (heard.left, row)
                && row != heard.device
                && self.device_table.by_id(heard.device).is_some()
                && let Some(before) = self.claims.other_sender_since(left, uid)
            {
                let kind = EventKind::Joined { was: heard.device, before: Some(before) };
                self.emit_for(Some(row), address, kind);
            }
            if let (Some(from), Some(index)) = (heard.left, self.device_table.active_at(address))
                && row.is_some()
                && self.device_table.get(index).moved_from != Some(from)
            {
                self.device_table.get_mut(index).moved_from = Some(from);
                self.emit(index, EventKind::Moved { from });
            }
            device = device.or(Some(heard.device));
        }
        if sender.claims {
            let uid = sender.known.map(|(uid, _)| uid);
            let guess = sender.is_another && uid.is_none();
            let kind = EventKind::Claimed { uid, holder: sender.holder.clone(), inferred: guess };
            self.emit_for(device, address, kind);
        }
    }

    /// A row that is known by its name alone left an address that was claimed by another.
    pub(super) fn emit_gave_up_by_name(&mut self, device: DeviceId, from: Address) {
        let period = self.config.profile.heartbeat.period();
        let since = self.claims.claimed_over(from);
        let concerns = since.is_some_and(|at| self.now.since(at) < period * CONCERNS_FOR);
        if concerns && let Some(to) = self.blank_party(from, Instant::ZERO) {
            let kind = EventKind::GaveWay { uid: None, to: Some(to), inferred: true };
            self.emit_for(Some(device), from, kind);
        }
    }

    /// The UID that a row speaks for, where it is known and not blank.
    pub(super) fn uid_of_row(&self, index: usize) -> Option<Uid> {
        let row = self.device_table.get(index);
        self.claims.uid_of(row.id).or(row.uid).filter(|uid| !uid.is_blank())
    }

    /// The row that a sender had at an address it left; none where another one speaks for it now.
    fn row_left(&self, left: Address, heard: &ClaimUpdate) -> Option<usize> {
        let index = self.device_table.index_of(heard.device)?;
        let row = self.device_table.get(index);
        let silent = self.now.since(row.last_seen) > self.pause()
            || self.claims.are_others_known(self.now, left, heard.device);
        (row.address == left && (silent || !self.device_table.is_current(index))).then_some(index)
    }

    fn row_of_sender(&self, address: Address, sender: &Sender) -> Option<DeviceId> {
        if sender.is_another {
            return None;
        }
        self.device_table.current_device(address).map(|row| row.id)
    }

    /// A gap between heartbeats in which at least one is missing.
    fn pause(&self) -> Duration {
        self.config.profile.heartbeat.period().mul_f64(PAUSE)
    }

    fn party(&self, device: DeviceId, uid: Option<Uid>) -> ConflictParty {
        let name = self.device_table.by_id(device).and_then(|row| row.name.clone());
        ConflictParty { device, name, uid }
    }

    /// Who beats from `address` without a UID, and did after `then`.
    fn blank_party(&self, address: Address, then: Instant) -> Option<ConflictParty> {
        let row = self.device_table.current_device(address)?;
        let last = row.heartbeat.last.filter(|last| *last > then)?;
        let is_blank = row.uid.is_none_or(Uid::is_blank);
        (is_blank && self.now.since(last) < self.pause()).then(|| self.party(row.id, None))
    }
}
