//! Device rows of one bus, and the current row of each address.

use super::device::{Device, DeviceId, Presence};
use crate::frame::BusIndex;
use crate::time::Instant;
use crate::wire::id::Address;

/// Maximum number of rows: 127 nodes, earlier devices at their addresses, and a margin. Bounds the
/// memory for a device that changes its name each time.
pub(super) const MAX_DEVICES: usize = 512;

/// Device rows in the order of appearance, with the current row of each address.
#[derive(Debug)]
pub(super) struct DeviceTable {
    bus: BusIndex,
    devices: Vec<Device>,
    current: [Option<u16>; Address::COUNT],
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

    pub fn devices(&self) -> &[Device] {
        &self.devices
    }

    pub fn devices_mut(&mut self) -> &mut [Device] {
        &mut self.devices
    }

    pub fn get(&self, index: usize) -> &Device {
        &self.devices[index]
    }

    pub fn get_mut(&mut self, index: usize) -> &mut Device {
        &mut self.devices[index]
    }

    pub fn by_id(&self, id: DeviceId) -> Option<&Device> {
        self.index_of(id).map(|at| &self.devices[at])
    }

    /// Returns the index of a row; rows are sorted by the number of their id.
    pub fn index_of(&self, id: DeviceId) -> Option<usize> {
        let at = self.devices.binary_search_by_key(&id.number, |device| device.id.number);
        at.ok().filter(|&at| self.devices[at].id == id)
    }

    /// Returns the index of the current row at `address`.
    pub fn current_index_at(&self, address: Address) -> Option<usize> {
        self.current[address.index()].map(usize::from)
    }

    /// Returns the current row at `address`.
    pub fn current_device(&self, address: Address) -> Option<&Device> {
        self.current_index_at(address).map(|index| &self.devices[index])
    }

    pub fn current_device_mut(&mut self, address: Address) -> Option<&mut Device> {
        self.current_index_at(address).map(|index| &mut self.devices[index])
    }

    /// Returns true if the row is the current one at its address.
    pub fn is_current(&self, index: usize) -> bool {
        self.current_index_at(self.devices[index].address) == Some(index)
    }

    /// Makes a row the current one at its address.
    pub fn make_current(&mut self, index: usize) {
        self.current[self.devices[index].address.index()] = Some(index as u16);
    }

    /// Adds a current row at `address`. If the table is full, it replaces the lost row that was
    /// silent for the longest time; `None` if no row is lost.
    pub fn insert(&mut self, now: Instant, address: Address, working: bool) -> Option<usize> {
        if self.devices.len() >= MAX_DEVICES {
            let oldest = (0..self.devices.len())
                .filter(|&at| self.devices[at].presence == Presence::Lost)
                .min_by_key(|&at| self.devices[at].last_seen)?;
            self.remove(oldest);
        }
        let id = self.reserve();
        self.discoveries += 1;
        self.devices.push(Device::new(id, now, address, working));
        self.current[address.index()] = Some((self.devices.len() - 1) as u16);
        Some(self.devices.len() - 1)
    }

    /// Returns a new id that no row will have.
    pub fn reserve(&mut self) -> DeviceId {
        let id = DeviceId { bus: self.bus, number: self.next_number };
        self.next_number += 1;
        id
    }

    /// Removes a row.
    pub fn remove(&mut self, index: usize) -> Device {
        let device = self.devices.remove(index);
        for current in &mut self.current {
            *current = match *current {
                Some(at) if usize::from(at) == index => None,
                Some(at) if usize::from(at) > index => Some(at - 1),
                other => other,
            };
        }
        device
    }

    /// Merges row `new` into row `old`, for one device that moved, and keeps the id of `old` and
    /// the address of `new`. Returns the index of the merged row.
    pub fn merge_rows(&mut self, old: usize, new: usize) -> usize {
        let was_current = self.is_current(old);
        let fresh = self.remove(new);
        let old = if new < old { old - 1 } else { old };
        let address = fresh.address;
        let device = &mut self.devices[old];
        let before = device.address;
        device.moved_from = Some(before);
        device.address = address;
        device.name = fresh.name.or(device.name.take());
        device.presence = fresh.presence;
        device.presence_since = fresh.presence_since;
        device.is_working = fresh.is_working;
        device.mode = fresh.mode.or(device.mode);
        device.error_code = fresh.error_code;
        device.uid = fresh.uid.or(device.uid);
        device.framing = fresh.framing.or(device.framing);
        device.services = fresh.services.or(device.services.take());
        device.heartbeat = fresh.heartbeat;
        device.last_heartbeat_was_other_node = fresh.last_heartbeat_was_other_node;
        device.name_query = fresh.name_query;
        device.services_query = fresh.services_query;
        device.last_seen = fresh.last_seen;
        device.frame_count += fresh.frame_count;
        device.rounds_missed = 0;
        device.is_debug |= fresh.is_debug;
        fresh.deviations.into_iter().for_each(|deviation| device.note_deviation(deviation));
        fresh.mode_history.into_iter().for_each(|change| device.remember_mode(change));
        if was_current {
            self.current[before.index()] = None;
        }
        self.current[address.index()] = Some(old as u16);
        old
    }

    /// Moves a row to another address and makes it the current one there.
    pub fn move_to_address(&mut self, index: usize, address: Address) {
        let was_current = self.is_current(index);
        let device = &mut self.devices[index];
        let before = std::mem::replace(&mut device.address, address);
        device.moved_from = Some(before);
        device.rounds_missed = 0;
        if was_current {
            self.current[before.index()] = None;
        }
        self.current[address.index()] = Some(index as u16);
    }

    /// Removes the lost rows.
    pub fn remove_lost(&mut self) {
        for at in (0..self.devices.len()).rev() {
            if self.devices[at].presence == Presence::Lost {
                self.remove(at);
            }
        }
    }
}
