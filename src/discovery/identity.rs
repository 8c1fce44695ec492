//! Identity of devices: another board at a known address, or a known device at another address
//! (protocol §4.7).

use super::device::{MISSED_HEARTBEAT_PERIODS, QueryState};
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
        match &current.name {
            None => return self.row_before(row, name).unwrap_or(row),
            Some(own) if own == name => return row,
            Some(_) => {}
        }
        let mut live = current.clone();
        let (address, working) = (live.address, live.is_working);
        let period = self.period_of(address);
        let is_alone = |uid: &Uid| {
            let is_heard =
                self.claims.last_of(*uid, address).is_some_and(|last| now.since(last) < period * 2);
            is_heard && !self.claims.is_shared(now, address, period, *uid)
        };
        let alone = live.uid.filter(|uid| !uid.is_blank()).filter(is_alone);
        let known = self.find_row(|it| it.address == address && it.name.as_ref() == Some(name));
        self.replace_row(row);
        // A UID seen here before the last response with the old name belongs to the old board.
        let name_received_at = live.name_query.responded_at;
        let own = live.uid.filter(|uid| self.claims.row_of(*uid) == Some(row));
        let since = own.and_then(|uid| self.claims.since(uid, address));
        if since
            .zip(name_received_at)
            .is_some_and(|(since, name_received_at)| since <= name_received_at)
        {
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
        if known.is_none() {
            if let Some(uid) = live.uid.filter(|uid| !uid.is_blank()) {
                self.claims.assign_row(uid, named, || self.device_table.reserve());
            }
            self.emit(named, EventKind::FirstFrame);
        } else {
            if device.presence == Presence::Lost {
                device.services_query.restart(now);
            }
            // The only sender of heartbeats has this name.
            if let Some(uid) = alone {
                self.claims.assign_row(uid, named, || self.device_table.reserve());
            }
        }
        self.find_move_of_replaced(row);
        named
    }

    /// Makes the row of a UID the current one at its address again: it was replaced by that of another
    /// device, which sends no heartbeats any more.
    pub(super) fn restore_row(&mut self, address: Address, uid: Option<Uid>) {
        let Some(uid) = uid.filter(|uid| !uid.is_blank()) else { return };
        let Some(current) = self.device_table.current_row(address) else { return };
        let Some(own) = self.claims.row_of(uid).filter(|own| *own != current) else { return };
        let is_here = self.device_table.get(own).is_some_and(|it| it.address == address);
        let is_of_another = self.claims.uid_of(current).is_some_and(|other| other != uid);
        let is_shared = || self.claims.is_shared(self.now, address, self.period_of(address), uid);
        if !is_here || !is_of_another || is_shared() {
            return;
        }
        let Some(mut live) = self.device_table.get(current).cloned() else { return };
        self.replace_row(current);
        self.device_table.make_current(own);
        live.uid = Some(uid);
        live.mode = self.claims.mode_of(uid).or(live.mode);
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
        let first_seen = device.first_seen;
        // A device without heartbeats is silent between rounds, and has left only when it is lost.
        let gone = |other: &Device| {
            let missed = periods.of(other.address).mul_f64(MISSED_HEARTBEAT_PERIODS);
            other.address != address
                && other.last_seen <= first_seen
                && now.since(other.last_seen) > missed
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
        let Some(device) = self.device_table.get_mut(old) else { return };
        device.copy_state_from(&live);
        device.name_query.schedule(now);
        device.services_query.schedule(now);
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
        self.emit(old, EventKind::IdsMerged { previous: new, before: None });
        if !is_known_by_uid {
            self.emit_gave_up_by_name(old, from);
        }
        self.conflicts.note_left(from);
        let now = self.now;
        if let Some(device) = self.device_table.get_mut(old) {
            device.services_query.schedule(now);
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
    let known = |uid: Uid| (!uid.is_blank()).then_some(uid);
    one.zip(other).is_some_and(|(one, other)| known(one) != known(other))
}
