//! Identity of devices: another board at a known address, or a known device at another address
//! (protocol §4.7).

use super::device::{MISSED_HEARTBEAT_PERIODS, ModeChange, QueryState};
use super::device_tracker::DeviceTracker;
use super::{Device, DeviceId, EventKind, Presence};
use crate::text::Name;
use crate::time::Instant;
use crate::wire::id::Address;
use crate::wire::node::Uid;

impl DeviceTracker {
    /// Returns the row of the device with that name at the address of `row`, creating it if needed.
    /// A row other than the current one means another board at the address.
    pub(super) fn row_of_name(&mut self, now: Instant, row: DeviceId, name: &Name) -> DeviceId {
        let Some(current) = self.device_table.get(row) else { return row };
        let (address, is_own) = (current.address, current.name.as_ref() == Some(name));
        let period = self.sender_period(address);
        let known = if is_own {
            Some(row)
        } else {
            self.find_row(|it| it.address == address && it.name.as_ref() == Some(name))
        };
        let sender = self.sender_names.sender_of_name(now, address, period, known);
        let named = match &current.name {
            None => self.row_before(row, name).unwrap_or(row),
            Some(_) if is_own => row,
            Some(_) => self.replace_by_named(row, known, sender),
        };
        self.sender_names.note_name(now, address, period, named, sender);
        named
    }

    /// Makes another row than `row` the current one, because another name was received from its
    /// address: `known`, or a new one. `sender`: the UID that belongs to the name, blank for a device
    /// without one. Returns the current row.
    fn replace_by_named(
        &mut self,
        row: DeviceId,
        known: Option<DeviceId>,
        sender: Option<Uid>,
    ) -> DeviceId {
        let now = self.now;
        let Some(mut live) = self.device_table.get(row).cloned() else { return row };
        let (address, working) = (live.address, live.is_working);
        let period = self.sender_period(address);
        // A UID seen here before the last response with the old name belongs to the old board.
        let name_received_at = live.name_query.responded_at;
        live.uid = live.heartbeat_uid;
        let own = live.uid.filter(|uid| self.claims.row_of(*uid) == Some(row));
        let since = own.and_then(|uid| self.claims.since(uid, address));
        let is_of_old_board = since
            .zip(name_received_at)
            .is_some_and(|(since, name_received_at)| since <= name_received_at);
        self.replace_row(row);
        if let Some(uid) = sender {
            live.uid = Some(uid);
        } else if is_of_old_board {
            (live.uid, live.heartbeat_uid) = (None, None);
        }
        let uid = if known.is_none() { live.uid } else { sender };
        if sender.is_none() && self.sender_names.is_shared(now, address, period, live.uid) {
            // It may be that of another board.
            live.uid = None;
        }
        let named = known.or_else(|| self.device_table.insert(now, address, working));
        let Some(named) = named else { return row };
        self.device_table.make_current(named);
        // Use its own mode: the last heartbeat may have come from the other board.
        let mode = live.uid.and_then(|uid| self.claims.mode_of(uid)).or(live.mode);
        let Some(device) = self.device_table.get_mut(named) else { return row };
        device.copy_state_from(&live);
        device.mode = mode;
        device.last_seen = now;
        if known.is_some() && device.presence == Presence::Lost {
            device.services_query.restart(now);
        }
        if let Some(uid) = uid.and_then(Uid::not_blank) {
            self.claims.assign_row(uid, named, || self.device_table.reserve());
        }
        if known.is_none() {
            self.emit(named, EventKind::FirstFrame);
        }
        self.find_move_of_replaced(row);
        named
    }

    /// Returns the row of another name at `address` that is known to be that of the sender with this
    /// UID.
    pub(super) fn other_row_of_sender(
        &self,
        address: Address,
        uid: Option<Uid>,
    ) -> Option<DeviceId> {
        let current = self.device_table.current_row(address)?;
        let of_claims = || self.claims.row_of(uid?.not_blank()?);
        let own = self.sender_names.row_of(address, uid).or_else(of_claims)?;
        let is_here = self.device_table.get(own).is_some_and(|it| it.address == address);
        (own != current && is_here).then_some(own)
    }

    /// Makes the row of a sender of heartbeats the current one at its address again: it was replaced
    /// by that of another device, which sends none any more.
    pub(super) fn restore_row(&mut self, address: Address, uid: Option<Uid>) {
        let Some(current) = self.device_table.current_row(address) else { return };
        let Some(own) = self.other_row_of_sender(address, uid) else { return };
        let of_current = self.sender_names.uid_of(current, address);
        let is_of_another = of_current
            .or_else(|| self.claims.uid_of(current))
            .is_some_and(|other| is_different_sender(Some(other), uid.or(Some(Uid::BLANK))));
        let period = self.sender_period(address);
        if !is_of_another || self.sender_names.is_shared(self.now, address, period, uid) {
            return;
        }
        let Some(mut live) = self.device_table.get(current).cloned() else { return };
        self.replace_row(current);
        self.device_table.make_current(own);
        live.uid = uid;
        live.mode = uid.and_then(|uid| self.claims.mode_of(uid)).or(live.mode);
        let Some(device) = self.device_table.get_mut(own) else { return };
        device.copy_state_from(&live);
        device.replaced_at = None;
        // Which of the names is that of the UID may have been a guess.
        device.name_query.restart(self.now);
        self.wake_at(self.now);
    }

    /// Merges a row without a name into an earlier one of this name at its address, unless their UIDs
    /// differ: the device has come back after another one was there. Returns the earlier row.
    fn row_before(&mut self, row: DeviceId, name: &Name) -> Option<DeviceId> {
        let address = self.device_table.get(row)?.address;
        let uid = self.uid_of_row(row);
        let before = self.find_row(|other| {
            other.id != row
                && other.address == address
                && other.name.as_ref() == Some(name)
                && !is_different_sender(uid, self.uid_of_row(other.id))
        })?;
        let was = self.device_table.get(before)?.presence;
        self.device_table.merge_rows(before, row);
        self.sender_names.merge_rows(before, row);
        let device = self.device_table.get_mut(before)?;
        device.replaced_at = None;
        device.services_query.restart(self.now);
        if let Some(uid) = uid {
            self.claims.assign_row(uid, before, || self.device_table.reserve());
        }
        self.emit(before, EventKind::IdsMerged { previous: row, before: None });
        if was != Presence::Online {
            self.emit(before, EventKind::Returned { was });
        }
        Some(before)
    }

    /// Returns the first row whose device meets the condition.
    fn find_row(&self, condition: impl Fn(&Device) -> bool) -> Option<DeviceId> {
        self.device_table.devices().iter().find(|it| condition(it)).map(|device| device.id)
    }

    /// Looks for the device of a replaced row at another address, where it may have been found
    /// already.
    fn find_move_of_replaced(&mut self, row: DeviceId) {
        let Some(from) = self.device_table.get(row).map(|device| device.address) else { return };
        let Some(uid) = self.uid_of_row(row) else { return };
        let went = self.find_row(|other| {
            other.uid == Some(uid) && other.moved_from == Some(from) && other.is_present()
        });
        if let Some(went) = went.filter(|went| *went != row) {
            self.move_row(row, went);
        }
    }

    /// Detects that a row is a known device at a new address: the same UID, or else the only device
    /// of its name, whose old address is silent.
    pub(super) fn find_move_to(&mut self, row: DeviceId) {
        let Some(device) = self.device_table.get(row) else { return };
        let (now, periods) = (self.now, self.conflicts.periods());
        let (uid, name, address) =
            (device.uid.filter(|uid| !uid.is_blank()), device.name.clone(), device.address);
        // Since when it is here; another device may have had the row before.
        let since = uid.and_then(|uid| self.claims.since(uid, address));
        let since = since.unwrap_or(device.first_seen).max(device.first_seen);
        // A device without heartbeats is silent between rounds, and has left only when it is lost.
        let gone = |other: &Device| {
            let missed = periods.of(other.address).mul_f64(MISSED_HEARTBEAT_PERIODS);
            // Another device may have its row now.
            let last = self.sender_names.last_of(other.id, other.address);
            let last = last.unwrap_or(other.last_seen);
            other.address != address
                && last <= since
                && now.since(self.outages.shifted(last)) > missed
                && (other.heartbeat.period_of_all().is_some() || !other.is_present())
        };
        let by_uid = uid.and_then(|uid| {
            let row_of_uid = self.claims.row_of(uid);
            self.find_row(|other| {
                let is_it = row_of_uid == Some(other.id)
                    || (other.uid == Some(uid) && self.claims.uid_of(other.id).is_none());
                is_it && gone(other)
            })
        });
        let old = by_uid.or_else(|| self.only_other_of_name(row, name.as_ref()?, gone));
        if let Some(old) = old {
            self.take_over_row(old, row);
        }
    }

    /// Moves the device of row `old` to the address of row `here`. If it is known by its UID, that
    /// row may belong to another device that it replaced.
    pub(super) fn take_over_row(&mut self, old: DeviceId, here: DeviceId) {
        let name = |row| self.device_table.get(row)?.name.as_ref();
        if name(old).zip(name(here)).is_some_and(|(old, here)| old != here) {
            self.move_onto(old, here);
        } else {
            self.move_row(old, here);
        }
    }

    /// Moves the device of row `old` to the address of another device, whose row stays.
    fn move_onto(&mut self, old: DeviceId, other: DeviceId) {
        let now = self.now;
        let Some(from) = self.device_table.get(old).map(|device| device.address) else { return };
        let Some(live) = self.device_table.get(other).cloned() else { return };
        self.replace_row(other);
        self.device_table.move_to_address(old, live.address);
        // Its own mode: that of the row was the other device's until now.
        let mode = self.uid_of_row(old).and_then(|uid| self.claims.mode_of(uid));
        let Some(device) = self.device_table.get_mut(old) else { return };
        device.copy_state_from(&live);
        if let Some(mode) = mode {
            device.mode = Some(mode);
            if device.mode_history.back().is_none_or(|last| last.mode != mode) {
                device.remember_mode(ModeChange { time: now, mode });
            }
        }
        device.name_query.schedule(now);
        device.services_query.schedule(now);
        device.descriptor.is_read = false;
        self.conflicts.note_left(from);
        self.conflicts.note_left(live.address);
        self.emit(old, EventKind::Moved { from });
        self.wake_at(now);
    }

    /// Makes a row inactive, because another one is active at its address.
    fn replace_row(&mut self, row: DeviceId) {
        let now = self.now;
        let Some(old) = self.device_table.get_mut(row) else { return };
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
        let Some(uid) = self.sender_names.uid_of(row, old.address) else { return };
        old.uid = Some(uid);
        old.mode = self.sender_names.mode_of(row, old.address).or(old.mode);
        if let Some(uid) = uid.not_blank() {
            self.claims.assign_row(uid, row, || self.device_table.reserve());
        }
    }

    /// Returns the only other row with that name, if it can be the same device.
    fn only_other_of_name(
        &self,
        row: DeviceId,
        name: &Name,
        gone: impl Fn(&Device) -> bool,
    ) -> Option<DeviceId> {
        let own_uid = self.device_table.get(row)?.uid;
        let devices = self.device_table.devices().iter();
        let mut others = devices.filter(|it| it.id != row && it.name.as_ref() == Some(name));
        let other = others.next()?;
        let fits = !is_different_sender(own_uid, other.uid) && gone(other);
        (others.next().is_none() && fits).then_some(other.id)
    }

    /// Detects that a lost device was found at another address before it was lost.
    pub(super) fn find_move_of_lost(&mut self, row: DeviceId) {
        let Some(device) = self.device_table.get(row) else { return };
        let (address, last_seen, name) = (device.address, device.last_seen, device.name.clone());
        let (uid, own_uid) = (self.uid_of_row(row), device.uid);
        let candidate = self.find_row(|other| {
            other.id != row
                && other.address != address
                && other.is_present()
                && other.first_seen >= last_seen
                && uid.is_some()
                && other.uid == uid
        });
        let candidate = candidate.or_else(|| {
            let name = name.as_ref()?;
            let devices = self.device_table.devices().iter();
            let others = devices.filter(|it| it.id != row && it.address != address);
            let mut same = others.filter(|other| other.name.as_ref() == Some(name));
            let other = same.next()?;
            let contradicts = is_different_sender(uid.or(own_uid), other.uid);
            let fits = other.is_present() && other.first_seen >= last_seen && !contradicts;
            (same.next().is_none() && fits).then_some(other.id)
        });
        if let Some(new) = candidate {
            self.move_row(row, new);
        }
    }

    /// Merges row `new` into row `old`, for one device that moved, and emits the events.
    pub(super) fn move_row(&mut self, old: DeviceId, new: DeviceId) {
        let table = &self.device_table;
        let (Some(before), Some(fresh)) = (table.get(old), table.get(new)) else { return };
        let from = before.address;
        let is_reported = fresh.moved_from == Some(from);
        let is_known_by_uid = self.uid_of_row(old).is_some() && self.uid_of_row(new).is_some();
        self.device_table.merge_rows(old, new);
        self.sender_names.merge_rows(old, new);
        self.emit(old, EventKind::IdsMerged { previous: new, before: None });
        if !is_known_by_uid {
            self.emit_gave_up_by_name(old, from);
        }
        self.conflicts.note_left(from);
        let now = self.now;
        if let Some(device) = self.device_table.get_mut(old) {
            device.services_query.schedule(now);
            device.descriptor.is_read = false;
        }
        if !is_reported {
            self.emit(old, EventKind::Moved { from });
        }
        self.wake_at(now);
    }
}

/// Returns true if two heartbeats come from different devices: a device sends its UID each time, or
/// never.
fn is_different_sender(one: Option<Uid>, other: Option<Uid>) -> bool {
    one.zip(other).is_some_and(|(one, other)| one.not_blank() != other.not_blank())
}
