//! Events of address resolution: claims, addresses given up, moves.
//!
//! [`claims`](super::claims) determines what happened; this module assigns it to a device, which
//! may have no row yet.

use super::claims::{ClaimUpdate, HeartbeatInput};
use super::device::MISSED_HEARTBEAT_PERIODS;
use super::device_tracker::DeviceTracker;
use super::{Device, DeviceId, EventKind, OtherDevice};
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::{Heartbeat, Mode, Uid};

/// Periods after a claim of an address in which its previous holder is taken to have left because
/// of it. The device without heartbeats is found again by the next round, 10 s later by default.
const CLAIM_RELEVANT_PERIODS: u32 = 12;

/// A heartbeat, with the state of the row at its address before it.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeartbeatContext {
    pub row: DeviceId,
    /// True if its sender is known to have another row at the address.
    pub has_other_row: bool,
    pub address: Address,
    pub heartbeat: Heartbeat,
    pub uid_before: Option<Uid>,
    pub mode_before: Option<Mode>,
    pub gap: Option<Duration>,
}

/// Sender of a heartbeat.
#[derive(Clone, Debug)]
pub(super) struct HeartbeatSender {
    /// UID and what claims know about it; `None` if the UID is blank.
    known: Option<(Uid, ClaimUpdate)>,
    /// Previous mode; `None` if unknown.
    pub mode_before: Option<Mode>,
    /// True if the row at the address belongs to another node.
    pub is_other_node: bool,
    pub(super) claims: bool,
    holder: Option<OtherDevice>,
}

impl HeartbeatSender {
    /// Its UID and its first heartbeat from the address, before any absence; `None` if the UID is
    /// blank.
    pub(super) fn uid_and_first(&self) -> Option<(Uid, Instant)> {
        self.known.map(|(uid, update)| (uid, update.first))
    }
}

impl DeviceTracker {
    /// Determines the sender of a heartbeat, and whether it claims its address.
    pub(super) fn note_sender(&mut self, claim: HeartbeatContext) -> HeartbeatSender {
        let HeartbeatContext {
            row,
            has_other_row,
            address,
            heartbeat,
            uid_before,
            mode_before,
            gap,
        } = claim;
        let not_blank = |uid: Option<Uid>| uid.and_then(Uid::not_blank);
        let now = self.now;
        let arslv = heartbeat.mode == Some(Mode::Arslv) && mode_before != Some(Mode::Arslv);
        // A node that claims its address again was silent before; a holder does not claim.
        let held = gap.is_some_and(|gap| gap < self.gap_limit(address));
        let over_holder = arslv && held;
        let before = not_blank(uid_before);
        // The sender has its own row at this address, and has not sent its name again yet.
        let has_other_row = has_other_row
            && self.sender_names.is_shared(
                now,
                address,
                self.sender_period(address),
                heartbeat.uid,
            );
        let Some(uid) = not_blank(heartbeat.uid) else {
            let again = heartbeat.mode == mode_before && held;
            if over_holder {
                self.claims.note_claimed_while_held(now, address);
            }
            return HeartbeatSender {
                known: None,
                mode_before,
                is_other_node: over_holder || has_other_row,
                claims: heartbeat.mode == Some(Mode::Arslv) && !again,
                holder: over_holder.then(|| self.party(row, before)),
            };
        };
        let over_holder = has_other_row || (over_holder && before.is_none());
        let heartbeat_input = HeartbeatInput {
            now,
            address,
            period: self.sender_period(address),
            uid,
            mode: heartbeat.mode,
            row,
            holder_present: over_holder,
        };
        let update = self.claims.update(heartbeat_input, || self.device_table.reserve());
        let same = before.is_none() || before == Some(uid);
        let is_present = self.device_table.get(row).is_some_and(Device::is_present);
        HeartbeatSender {
            known: Some((uid, update)),
            mode_before: if same { mode_before } else { update.mode_before },
            is_other_node: update.is_other_node,
            claims: update.claims,
            holder: (update.is_other_node && is_present).then(|| {
                let holder = self.claims.uid_of(row).or(before);
                self.party(row, holder)
            }),
        }
    }

    /// Emits which node gave up an address, as far as this heartbeat shows it.
    pub(super) fn emit_gave_up(&mut self, address: Address, sender: &HeartbeatSender) {
        let Some((uid, update)) = sender.known else { return };
        let now = self.now;
        if let (Some(left), Some(then)) = (update.left, update.gave_up) {
            let to = self.claims.is_still_active(now, left, self.sender_period(left), then, uid);
            let to = to.map(|(device, uid)| self.party(device, Some(uid)));
            let to = to.or_else(|| self.blank_party(left, then));
            // The row there may stand for the other node now.
            let here = self.row_of_sender(address, sender);
            let device = if self.row_left(left, &update).is_some() { None } else { here };
            let device = device.unwrap_or(update.device);
            let kind = EventKind::GaveUpAddress { uid: Some(uid), to, inferred: false };
            self.emit_for(Some(device), left, kind);
            self.conflicts.finding_tracker_mut().note_gave_up(now, left);
        }
        let period = self.sender_period(address);
        for (device, silent) in self.claims.nodes_that_stopped(now, address, period, uid) {
            let to = Some(self.party(update.device, Some(uid)));
            let kind = EventKind::GaveUpAddress { uid: Some(silent), to, inferred: true };
            // A row that both shared now belongs to the other node.
            let shared = self.device_table.current_row(address) == Some(device);
            self.emit_for((!shared).then_some(device), address, kind);
        }
    }

    /// Emits that the sender moved here after a conflict elsewhere, and its claim.
    pub(super) fn emit_claim(&mut self, address: Address, sender: &HeartbeatSender) {
        if let Some((_, update)) = sender.known
            && let (Some(left), false) = (update.left, sender.is_other_node)
            && let (Some(old), Some(new)) =
                (self.row_left(left, &update), self.device_table.current_row(address))
            && old != new
        {
            self.take_over_row(old, new);
        }
        let row = self.row_of_sender(address, sender);
        let mut device = row;
        if let Some((uid, update)) = sender.known {
            let was = row
                .and_then(|row| self.claims.assign_row(uid, row, || self.device_table.reserve()));
            if let (Some(was), Some(row)) = (was, row) {
                self.emit_for(
                    Some(row),
                    address,
                    EventKind::IdsMerged { previous: was, before: None },
                );
            }
            // Its row there now belongs to the other node, but events before that node came concern
            // this one.
            if let (Some(left), Some(row)) = (update.left, row)
                && row != update.device
                && self.device_table.get(update.device).is_some()
                && let Some(before) = self.claims.other_sender_since(left, uid)
            {
                let kind = EventKind::IdsMerged { previous: update.device, before: Some(before) };
                self.emit_for(Some(row), address, kind);
            }
            if let (Some(from), Some(row)) = (update.left, row)
                && let Some(here) = self.device_table.get_mut(row)
                && here.moved_from != Some(from)
            {
                here.moved_from = Some(from);
                self.emit(row, EventKind::Moved { from });
            }
            device = device.or(Some(update.device));
        }
        if sender.claims {
            let uid = sender.known.map(|(uid, _)| uid);
            let inferred = sender.is_other_node && uid.is_none();
            let (now, is_held) = (self.now, sender.holder.is_some());
            self.conflicts.finding_tracker_mut().note_claim(now, address, uid, is_held);
            let kind = EventKind::Claimed { uid, holder: sender.holder.clone(), inferred };
            self.emit_for(device, address, kind);
        }
    }

    /// Emits that a device known by its name alone left an address that another node claimed.
    pub(super) fn emit_gave_up_by_name(&mut self, device: DeviceId, from: Address) {
        let period = self.sender_period(from);
        let since = self.claims.claimed_while_held(from);
        let concerns = since.is_some_and(|at| self.now.since(at) < period * CLAIM_RELEVANT_PERIODS);
        if concerns && let Some(to) = self.blank_party(from, Instant::ZERO) {
            let kind = EventKind::GaveUpAddress { uid: None, to: Some(to), inferred: true };
            self.emit_for(Some(device), from, kind);
        }
    }

    /// Returns the UID of a row, if known and not blank.
    pub(super) fn uid_of_row(&self, row: DeviceId) -> Option<Uid> {
        let device = self.device_table.get(row)?;
        self.claims.uid_of(row).or(device.uid).filter(|uid| !uid.is_blank())
    }

    /// Returns the row of a sender at an address it left; `None` if the row stands for another node
    /// now.
    fn row_left(&self, left: Address, update: &ClaimUpdate) -> Option<DeviceId> {
        let device = self.device_table.get(update.device)?;
        let silent = self.now.since(device.last_seen) > self.gap_limit(left)
            || self.claims.are_others_known(
                self.now,
                left,
                self.sender_period(left),
                update.device,
            );
        let has_left = silent || !self.device_table.is_current(device);
        (device.address == left && has_left).then_some(update.device)
    }

    fn row_of_sender(&self, address: Address, sender: &HeartbeatSender) -> Option<DeviceId> {
        if sender.is_other_node {
            return None;
        }
        self.device_table.current_row(address)
    }

    /// Returns the gap between heartbeats from which at least one is missing.
    fn gap_limit(&self, address: Address) -> Duration {
        self.sender_period(address).mul_f64(MISSED_HEARTBEAT_PERIODS)
    }

    fn party(&self, device: DeviceId, uid: Option<Uid>) -> OtherDevice {
        let name = self.device_table.get(device).and_then(|it| it.name.clone());
        OtherDevice { device, name, uid }
    }

    /// Returns the node that sends heartbeats without a UID from `address`, and did so after
    /// `then`.
    fn blank_party(&self, address: Address, then: Instant) -> Option<OtherDevice> {
        let device = self.device_table.current_device(address)?;
        let last = device.heartbeat.last.filter(|last| *last > then)?;
        let is_blank = device.heartbeat_uid.is_none_or(Uid::is_blank);
        (is_blank && self.now.since(last) < self.gap_limit(address))
            .then(|| self.party(device.id, None))
    }
}
