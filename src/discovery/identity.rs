//! Identity of devices: another board at a known address, or a known device at another address
//! (protocol §4.7).

use super::device::{MISSED_HEARTBEAT_PERIODS, QueryState};
use super::{Device, Engine, EventKind, Presence};
use crate::text::Name;
use crate::time::Instant;
use crate::wire::node::Uid;

impl Engine {
    /// Returns the row of the device with that name at this address, creating it if needed. A row
    /// other than the current one means another board at the address.
    pub(super) fn row_of_name(&mut self, now: Instant, index: usize, name: &Name) -> usize {
        let current = self.device_table.get(index);
        if current.name.as_ref().is_none_or(|own| own == name) {
            return index;
        }
        let (address, working) = (current.address, current.is_working);
        let known = self
            .device_table
            .devices()
            .iter()
            .position(|device| device.address == address && device.name.as_ref() == Some(name));
        let mut live = self.device_table.get(index).clone();
        self.replace_row(index);
        // A UID seen here before the last response with the old name belongs to the old board.
        let name_received_at = live.name_query.responded_at;
        let own = live.uid.filter(|uid| self.claims.row_of(*uid) == Some(live.id));
        let since = own.and_then(|uid| self.claims.since(uid, address));
        if since
            .zip(name_received_at)
            .is_some_and(|(since, name_received_at)| since <= name_received_at)
        {
            live.uid = None;
        }
        let row = match known {
            Some(row) => row,
            None => match self.device_table.insert(now, address, working) {
                Some(row) => row,
                None => return index,
            },
        };
        self.device_table.make_current(row);
        // Use its own mode: the last heartbeat may have come from the other board.
        let mode = live.uid.and_then(|uid| self.claims.mode_of(uid)).or(live.mode);
        let device = self.device_table.get_mut(row);
        device.copy_state_from(&live);
        device.mode = mode;
        device.last_seen = now;
        let id = device.id;
        if let Some(uid) = live.uid.filter(|uid| !uid.is_blank() && known.is_none()) {
            self.claims.assign_row(uid, id, || self.device_table.reserve());
        }
        let device = self.device_table.get_mut(row);
        if known.is_none() {
            self.emit(row, EventKind::FirstFrame);
        } else if device.presence == Presence::Lost {
            device.services_query.restart(now);
        }
        self.find_move_of_replaced(index);
        self.device_table.index_of(id).unwrap_or(row)
    }

    /// Looks for the device of a replaced row at another address, where it may have been found
    /// already.
    fn find_move_of_replaced(&mut self, index: usize) {
        let (uid, from) = (self.uid_of_row(index), self.device_table.get(index).address);
        let went = self.device_table.devices().iter().position(|other| {
            uid.is_some()
                && other.uid == uid
                && other.moved_from == Some(from)
                && other.is_present()
        });
        if let Some(went) = went.filter(|went| *went != index) {
            self.move_row(index, went);
        }
    }

    /// Detects that a row is a known device at a new address: the same UID, or else the only device
    /// of its name, whose old address is silent.
    pub(super) fn find_move_to(&mut self, index: usize) {
        let period = self.config.profile.heartbeat.period();
        let device = self.device_table.get(index);
        let now = self.now;
        let (uid, name, address) =
            (device.uid.filter(|uid| !uid.is_blank()), device.name.clone(), device.address);
        let first_seen = device.first_seen;
        // A device without heartbeats is silent between rounds, and has left only when it is lost.
        let gone = |other: &Device| {
            other.address != address
                && other.last_seen <= first_seen
                && now.since(other.last_seen) > period.mul_f64(MISSED_HEARTBEAT_PERIODS)
                && (other.heartbeat.period().is_some() || !other.is_present())
        };
        let by_uid = uid.and_then(|uid| {
            let row_of_uid = self.claims.row_of(uid);
            self.device_table.devices().iter().position(|other| {
                let is_it = row_of_uid == Some(other.id)
                    || (other.uid == Some(uid) && self.claims.uid_of(other.id).is_none());
                is_it && gone(other)
            })
        });
        let old = by_uid.or_else(|| self.only_other_of_name(index, name.as_ref()?, gone));
        if let Some(old) = old {
            self.take_over_row(old, index);
        }
    }

    /// Moves the device of row `old` to the address of row `index`. If it is known by its UID, that
    /// row may belong to another device that it replaced.
    pub(super) fn take_over_row(&mut self, old: usize, index: usize) {
        let name = |at: usize| self.device_table.get(at).name.as_ref();
        if name(old).zip(name(index)).is_some_and(|(old, here)| old != here) {
            self.move_onto(old, index);
        } else {
            self.move_row(old, index);
        }
    }

    /// Moves the device of row `old` to the address of another device, whose row stays.
    fn move_onto(&mut self, old: usize, other: usize) {
        let (now, from) = (self.now, self.device_table.get(old).address);
        let live = self.device_table.get(other).clone();
        self.replace_row(other);
        self.device_table.move_to_address(old, live.address);
        let device = self.device_table.get_mut(old);
        device.copy_state_from(&live);
        device.name_query.schedule(now);
        device.services_query.schedule(now);
        self.conflicts.note_left(from);
        self.conflicts.note_left(live.address);
        self.emit(old, EventKind::Moved { from });
        self.wake_at(now);
    }

    /// Makes a row inactive, because another one is active at its address.
    fn replace_row(&mut self, index: usize) {
        let now = self.now;
        let old = self.device_table.get_mut(index);
        for query in [&mut old.name_query, &mut old.services_query] {
            query.due = None;
            query.deadline = None;
            if query.is_waiting() {
                query.state = QueryState::NotSent;
            }
        }
        old.replaced_at = Some(now);
        // Heartbeats since the other board is there do not belong to this row.
        old.uid = old.uid_before.take().or(old.uid);
    }

    /// Returns the only other row with that name, if it can be the same device.
    fn only_other_of_name(
        &self,
        index: usize,
        name: &Name,
        gone: impl Fn(&Device) -> bool,
    ) -> Option<usize> {
        let own_uid = self.device_table.get(index).uid;
        let mut others = self
            .device_table
            .devices()
            .iter()
            .enumerate()
            .filter(|(at, other)| *at != index && other.name.as_ref() == Some(name));
        let (at, other) = others.next()?;
        let fits = !is_different_sender(own_uid, other.uid) && gone(other);
        (others.next().is_none() && fits).then_some(at)
    }

    /// Detects that a lost device was found at another address before it was lost.
    pub(super) fn find_move_of_lost(&mut self, index: usize) {
        let device = self.device_table.get(index);
        let (id, address, last_seen, name) =
            (device.id, device.address, device.last_seen, device.name.clone());
        let (uid, own_uid) = (self.uid_of_row(index), device.uid);
        let candidate = self.device_table.devices().iter().position(|other| {
            other.id != id
                && other.address != address
                && other.is_present()
                && other.first_seen >= last_seen
                && uid.is_some()
                && other.uid == uid
        });
        let candidate = candidate.or_else(|| {
            let name = name.as_ref()?;
            let mut same = self
                .device_table
                .devices()
                .iter()
                .enumerate()
                .filter(|(_, other)| other.id != id && other.name.as_ref() == Some(name))
                .filter(|(_, other)| other.address != address);
            let (at, other) = same.next()?;
            let contradicts = is_different_sender(uid.or(own_uid), other.uid);
            let fits = other.is_present() && other.first_seen >= last_seen && !contradicts;
            (same.next().is_none() && fits).then_some(at)
        });
        if let Some(new) = candidate {
            self.move_row(index, new);
        }
    }

    /// Merges row `new` into row `old`, for one device that moved, and emits the events.
    pub(super) fn move_row(&mut self, old: usize, new: usize) {
        let from = self.device_table.get(old).address;
        let (id, was) = (self.device_table.get(old).id, self.device_table.get(new).id);
        let is_known_by_uid = self.uid_of_row(old).is_some() && self.uid_of_row(new).is_some();
        let is_reported = self.device_table.get(new).moved_from == Some(from);
        let index = self.device_table.merge_rows(old, new);
        self.emit(index, EventKind::IdsMerged { previous: was, before: None });
        if !is_known_by_uid {
            self.emit_gave_up_by_name(id, from);
        }
        self.conflicts.note_left(from);
        let now = self.now;
        let device = self.device_table.get_mut(index);
        device.services_query.schedule(now);
        if !is_reported {
            self.emit(index, EventKind::Moved { from });
        }
        self.wake_at(now);
    }
}

/// Returns true if two heartbeats come from different devices: a device sends its UID each time, or
/// never.
fn is_different_sender(one: Option<Uid>, other: Option<Uid>) -> bool {
    let known = |uid: Uid| (!uid.is_blank()).then_some(uid);
    one.zip(other).is_some_and(|(one, other)| known(one) != known(other))
}
