//! Device rows of one bus, and the current row of each address.

use super::device::{Device, DeviceId, Presence};
use crate::frame::BusIndex;
use crate::time::Instant;
use crate::wire::id::Address;

/// Maximum number of rows: 127 nodes, earlier devices at their addresses, and a margin. Bounds the
/// memory for a device that changes its name each time.
pub(super) const MAX_DEVICES: usize = 512;

/// Device rows in the order of appearance, with the current row of each address.
///
/// A row is known by its [`DeviceId`], which stays valid while other rows are added, merged or
/// removed. A row that was removed, or merged into another one, is not found any more.
#[derive(Clone, Debug)]
pub(super) struct DeviceTable {
    bus: BusIndex,
    /// In the order of their numbers.
    devices: Vec<Device>,
    current: [Option<DeviceId>; Address::COUNT],
    next_number: u32,
    /// Number of rows and names found so far, to tell whether a round found something new.
    pub discoveries: u64,
}

impl DeviceTable {
    pub fn new(bus: BusIndex) -> Self {
        Self {
            bus,
            devices: Vec::new(),
            current: [None; Address::COUNT],
            next_number: 0,
            discoveries: 0,
        }
    }

    /// Gives new rows ids that no row of `before` had.
    pub fn number_after(&mut self, before: &Self) {
        self.next_number = self.next_number.max(before.next_number);
    }

    pub fn devices(&self) -> &[Device] {
        &self.devices
    }

    pub fn devices_mut(&mut self) -> &mut [Device] {
        &mut self.devices
    }

    /// Returns the ids of all rows, for a loop that merges or removes rows.
    pub fn rows(&self) -> Vec<DeviceId> {
        self.devices.iter().map(|device| device.id).collect()
    }

    pub fn get(&self, row: DeviceId) -> Option<&Device> {
        self.index_of(row).map(|at| &self.devices[at])
    }

    pub fn get_mut(&mut self, row: DeviceId) -> Option<&mut Device> {
        self.index_of(row).map(|at| &mut self.devices[at])
    }

    /// Returns the current row at `address`.
    pub fn current_row(&self, address: Address) -> Option<DeviceId> {
        self.current[address.index()]
    }

    /// Returns the device of the current row at `address`.
    pub fn current_device(&self, address: Address) -> Option<&Device> {
        self.get(self.current_row(address)?)
    }

    pub fn current_device_mut(&mut self, address: Address) -> Option<&mut Device> {
        self.get_mut(self.current_row(address)?)
    }

    /// Returns true if the device's row is the current one at its address.
    pub fn is_current(&self, device: &Device) -> bool {
        self.current_row(device.address) == Some(device.id)
    }

    /// Makes a row the current one at its address.
    pub fn make_current(&mut self, row: DeviceId) {
        if let Some(address) = self.get(row).map(|device| device.address) {
            self.current[address.index()] = Some(row);
        }
    }

    /// Adds a current row at `address`. If the table is full, it replaces the lost row that was
    /// silent for the longest time; `None` if no row is lost.
    pub fn insert(&mut self, now: Instant, address: Address, working: bool) -> Option<DeviceId> {
        if self.devices.len() >= MAX_DEVICES {
            let lost = self.devices.iter().filter(|device| device.presence == Presence::Lost);
            let oldest = lost.min_by_key(|device| device.last_seen)?.id;
            self.remove(oldest);
        }
        let row = self.reserve();
        self.discoveries += 1;
        self.devices.push(Device::new(row, now, address, working));
        self.current[address.index()] = Some(row);
        Some(row)
    }

    /// Returns a new id that no row will have.
    pub fn reserve(&mut self) -> DeviceId {
        let id = DeviceId { bus: self.bus, number: self.next_number };
        self.next_number += 1;
        id
    }

    /// Merges row `new` into row `old`, for one device that moved, and keeps the id of `old` and
    /// the address of `new`.
    pub fn merge_rows(&mut self, old: DeviceId, new: DeviceId) {
        if old == new || self.get(old).is_none() {
            return;
        }
        let Some(fresh) = self.remove(new) else { return };
        self.move_to_address(old, fresh.address);
        let Some(device) = self.get_mut(old) else { return };
        device.name = fresh.name.or(device.name.take());
        device.presence = fresh.presence;
        device.presence_since = fresh.presence_since;
        device.is_working = fresh.is_working;
        device.mode = fresh.mode.or(device.mode);
        device.error_code = fresh.error_code;
        device.uid = fresh.uid.or(device.uid);
        device.heartbeat_uid = fresh.heartbeat_uid.or(device.heartbeat_uid);
        device.framing = fresh.framing.or(device.framing);
        device.services = fresh.services.or(device.services.take());
        device.first_services = device.first_services.take().or(fresh.first_services);
        device.heartbeat = fresh.heartbeat;
        device.last_heartbeat_was_other_node = fresh.last_heartbeat_was_other_node;
        device.name_query = fresh.name_query;
        device.services_query = fresh.services_query;
        device.descriptor.take_over(fresh.descriptor);
        device.last_seen = fresh.last_seen;
        device.frame_count += fresh.frame_count;
        device.is_debug |= fresh.is_debug;
        fresh.deviations.into_iter().for_each(|deviation| device.note_deviation(deviation));
        fresh.mode_history.into_iter().for_each(|change| device.remember_mode(change));
    }

    /// Moves a row to another address and makes it the current one there.
    pub fn move_to_address(&mut self, row: DeviceId, address: Address) {
        let Some(device) = self.get_mut(row) else { return };
        let before = std::mem::replace(&mut device.address, address);
        device.moved_from = if before == address { device.moved_from } else { Some(before) };
        device.rounds_missed = 0;
        self.vacate(before, row);
        self.current[address.index()] = Some(row);
    }

    /// Removes the lost rows.
    pub fn remove_lost(&mut self) {
        for row in self.rows() {
            if self.get(row).is_some_and(|device| !device.is_present()) {
                self.remove(row);
            }
        }
    }

    /// Removes all rows.
    pub fn clear(&mut self) {
        self.devices.clear();
        self.current = [None; Address::COUNT];
    }

    fn remove(&mut self, row: DeviceId) -> Option<Device> {
        let at = self.index_of(row)?;
        let device = self.devices.remove(at);
        self.vacate(device.address, row);
        Some(device)
    }

    /// Leaves `address` without a current row, if that is `row`.
    fn vacate(&mut self, address: Address, row: DeviceId) {
        let current = &mut self.current[address.index()];
        *current = current.filter(|current| *current != row);
    }

    /// Returns the index of a row in `devices`. The numbers ascend, so that the distance to the
    /// first one is the index, unless numbers are missing.
    fn index_of(&self, row: DeviceId) -> Option<usize> {
        let from_first = row.number.checked_sub(self.devices.first()?.id.number)? as usize;
        let is_there = self.devices.get(from_first).is_some_and(|device| device.id == row);
        if is_there { Some(from_first) } else { self.search(row, from_first) }
    }

    /// Returns the index of a row before `end`, at the distance to the last number or after it.
    fn search(&self, row: DeviceId, end: usize) -> Option<usize> {
        let from_last = self.devices.last()?.id.number.checked_sub(row.number)? as usize;
        let start = self.devices.len().saturating_sub(from_last + 1);
        let candidates = self.devices.get(start..end.min(self.devices.len()))?;
        let at = candidates.binary_search_by_key(&row.number, |device| device.id.number).ok()?;
        (candidates[at].id == row).then_some(start + at)
    }
}
