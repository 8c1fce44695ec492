//! Who had an address when: the names of the devices at each address of a bus.
//!
//! Input: the events of the engine. Output: the name at a moment. A name that became known later
//! holds from the device's first frame at the address on. Bounded: 16 names for each address, the
//! newest ones.

use crate::discovery::{DeviceId, Event, EventKind};
use crate::text::Name;
use crate::time::Instant;
use crate::wire::id::Address;

/// Most names that are kept for an address.
const NAMES_PER_ADDRESS: usize = 16;

/// A device at an address, from a moment on.
#[derive(Clone, Debug)]
pub struct AddressHolder {
    /// First frame from there; the first holder that is kept holds all times before, too.
    pub since: Instant,
    /// `None` if no device is known there: another log began.
    device: Option<DeviceId>,
    /// `None` while it is not known.
    pub name: Option<Name>,
    /// The UID changed since the name was received: another board may have another name.
    is_outdated: bool,
}

impl AddressHolder {
    /// The device; `None` if none is known there: another log began.
    pub fn device(&self) -> Option<DeviceId> {
        self.device
    }
}

/// Names by address and time.
#[derive(Clone, Debug, Default)]
pub struct AddressNames {
    /// By address; empty until a device is heard.
    holders: Vec<Vec<AddressHolder>>,
    revision: u64,
}

impl AddressNames {
    /// Takes what an event says about an address.
    pub(super) fn handle_event(&mut self, event: &Event) {
        let (Some(device), Some(address)) = (event.device, event.address) else { return };
        match event.kind {
            EventKind::IdsMerged { previous, .. } => {
                let all = self.holders.iter_mut().flatten();
                let merged = all.filter(|holder| holder.device == Some(previous));
                for holder in merged {
                    holder.device = Some(device);
                    if holder.name.is_none() {
                        holder.name.clone_from(&event.name);
                    }
                    self.revision += 1;
                }
                self.note(event.time, device, address, event.name.as_ref());
            }
            EventKind::UidChanged { .. } => {
                self.note(event.time, device, address, event.name.as_ref());
                self.mark_outdated(event.time, device, address);
            }
            EventKind::FirstFrame
            | EventKind::NameReceived
            | EventKind::Services { .. }
            | EventKind::Mode { .. }
            | EventKind::Claimed { holder: None, .. }
            | EventKind::Moved { .. }
            | EventKind::Rebooted
            | EventKind::Returned { .. } => {
                self.note(event.time, device, address, event.name.as_ref());
            }
            // Of the others, another device may have the address.
            _ => {}
        }
    }

    fn note(&mut self, time: Instant, device: DeviceId, address: Address, name: Option<&Name>) {
        let at = usize::from(address.number());
        if self.holders.len() <= at {
            self.holders.resize_with(at + 1, Vec::new);
        }
        let Some(holders) = self.holders.get_mut(at) else { return };
        match holders.last_mut() {
            Some(last) if last.device == Some(device) => {
                if name.is_none() || last.name.as_ref() == name {
                    return;
                }
                if last.name.is_none() || last.is_outdated {
                    last.name = name.cloned();
                    last.is_outdated = false;
                    self.revision += 1;
                    return;
                }
            }
            // The board that came with another UID.
            Some(last) if last.is_outdated => {
                (last.device, last.name, last.is_outdated) = (Some(device), name.cloned(), false);
                self.revision += 1;
                return;
            }
            _ => {}
        }
        let (device, name) = (Some(device), name.cloned());
        self.push(address, AddressHolder { since: time, device, name, is_outdated: false });
    }

    /// Notes that from now on no device is known at any address: another log begins.
    pub(super) fn vacate(&mut self, since: Instant) {
        let held =
            |address: &Address| self.holders(*address).last().is_some_and(|it| it.device.is_some());
        let held: Vec<Address> = Address::all().filter(held).collect();
        for address in held {
            let nobody = AddressHolder { since, device: None, name: None, is_outdated: false };
            self.push(address, nobody);
        }
    }

    fn push(&mut self, address: Address, holder: AddressHolder) {
        let Some(holders) = self.holders.get_mut(usize::from(address.number())) else { return };
        if holders.len() == NAMES_PER_ADDRESS {
            holders.remove(0);
        }
        holders.push(holder);
        self.revision += 1;
    }

    /// From now on, the name may be that of another board.
    fn mark_outdated(&mut self, since: Instant, device: DeviceId, address: Address) {
        let last = self.holders(address).last().filter(|last| last.device == Some(device));
        if let Some(last) = last.filter(|last| !last.is_outdated) {
            let (device, name) = (Some(device), last.name.clone());
            self.push(address, AddressHolder { since, device, name, is_outdated: true });
        }
    }

    /// Returns a number that changes with every name.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Who had an address, oldest first.
    pub fn holders(&self, address: Address) -> &[AddressHolder] {
        self.holders.get(usize::from(address.number())).map_or(&[], Vec::as_slice)
    }

    /// The name of the device that had an address at a moment.
    pub fn at(&self, address: Address, time: Instant) -> Option<&Name> {
        self.holder_at(address, time)?.name.as_ref()
    }

    /// Who had an address at a moment.
    pub fn holder_at(&self, address: Address, time: Instant) -> Option<&AddressHolder> {
        let holders = self.holders(address);
        let later = holders.partition_point(|holder| holder.since <= time);
        holders.get(later.saturating_sub(1))
    }

    /// Bytes of memory.
    pub(super) fn size(&self) -> usize {
        let holders = self.holders.iter().map(|it| it.capacity() * size_of::<AddressHolder>());
        self.holders.capacity() * size_of::<Vec<AddressHolder>>() + holders.sum::<usize>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::BusIndex;

    fn event(second: u64, device: u32, address: u8, name: &str, kind: EventKind) -> Event {
        Event {
            time: Instant::from_micros(second * 1_000_000),
            device: Some(DeviceId { bus: BusIndex(0), number: device }),
            address: Some(Address::from_bits(address)),
            name: (!name.is_empty()).then(|| Name::new(name.as_bytes())),
            kind,
        }
    }

    #[test]
    fn name_holds_from_the_first_frame_of_its_device() {
        let mut names = AddressNames::default();
        let mut at = |second, device, address, name: &str| {
            names.handle_event(&event(second, device, address, name, EventKind::FirstFrame));
        };
        at(1, 0, 12, "");
        at(3, 0, 12, "FEED");
        at(5, 1, 12, "");
        at(7, 1, 12, "ACT");
        at(7, 0, 13, "FEED");
        at(9, 1, 12, "ACT");
        at(10, 1, 12, "VALVE");
        let name = |second: u64, address| {
            let time = Instant::from_micros(second * 1_000_000);
            names.at(Address::from_bits(address), time).map(ToString::to_string)
        };
        let by_second: Vec<_> = (0..12).map(|second| name(second, 12).unwrap()).collect();
        assert_eq!(by_second[..5], ["FEED"; 5]);
        assert_eq!(by_second[5..10], ["ACT"; 5]);
        assert_eq!(by_second[10..], ["VALVE"; 2]);
        assert_eq!(name(0, 13).as_deref(), Some("FEED"));
        assert_eq!(name(0, 14), None);
        assert_eq!(name(0, 127), None);
    }

    #[test]
    fn names_are_bounded() {
        let mut names = AddressNames::default();
        for number in 0..10_000 {
            let kind = EventKind::FirstFrame;
            names.handle_event(&event(number, number as u32 % 2, 12, "x", kind));
        }
        assert_eq!(names.holders(Address::from_bits(12)).len(), NAMES_PER_ADDRESS);
    }
}
