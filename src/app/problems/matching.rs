//! The assignment of entries of des.json to devices.
//!
//! An entry is assigned by UID, then by name and address, then to the only unassigned device with
//! its name; present devices come before lost ones. An entry without a bus may have a device on
//! every bus that has its file. Does not compare the values of entry and device.

use crate::app::buses::Buses;
use crate::app::file::{Documents, EntryPlace, FileIndex};
use crate::discovery::{Device, DeviceId};
use crate::document::Entry;
use crate::frame::BusIndex;
use crate::wire::node::Uid;
use std::collections::BTreeMap;

/// Entries and their devices.
#[derive(Debug, Default)]
pub struct Matching {
    entry_of: BTreeMap<DeviceId, EntryPlace>,
    /// By file and entry.
    devices_of: Vec<Vec<Vec<DeviceId>>>,
    /// By file and entry: it repeats another entry that has a device.
    duplicates: Vec<Vec<bool>>,
}

impl Matching {
    /// Assigns the entries of each file to the devices of its buses.
    pub(in crate::app) fn new(documents: Documents, buses: &Buses) -> Self {
        let of_file = |file| vec![Vec::new(); documents.entries(file).len()];
        let mut matching = Self {
            entry_of: BTreeMap::new(),
            devices_of: documents.files().map(of_file).collect(),
            duplicates: Vec::new(),
        };
        for (index, bus) in buses.indexed() {
            let file = documents.of_bus(index);
            let entries = documents.entries(file).iter();
            let entries: Vec<&Entry> =
                entries.filter(|entry| entry.is_for_bus(&bus.name)).collect();
            let mut open = Unmatched { entries, matching: &mut matching, file, bus: index };
            for here in [true, false] {
                let devices = || bus.devices().iter().filter(|it| it.is_present() == here);
                let alphabet = &bus.config().profile.uid;
                // `None` if one of them has none.
                let is_same_uid = |entry: &Entry, device: &Device| {
                    let own = device.uid.and_then(Uid::not_blank);
                    let both = entry.trimmed_uid().zip(own);
                    both.map(|(listed, uid)| uid.text(alphabet).to_string() == listed)
                };
                let same_uid =
                    |entry: &Entry, device: &Device| is_same_uid(entry, device) == Some(true);
                let same_place = |entry: &Entry, device: &Device| {
                    device.is_named(&entry.name) && entry.address == Some(device.address.number())
                };
                // Devices with equal UIDs, as in a UID conflict, keep their own entries.
                open.pair(devices, |entry, device| {
                    same_uid(entry, device) && same_place(entry, device)
                });
                open.pair(devices, same_uid);
                open.pair(devices, same_place);
                // Another board than the listed one comes last.
                open.pair_unique(devices, |entry, device| {
                    is_same_uid(entry, device) != Some(false)
                });
                open.pair_unique(devices, |_, _| true);
            }
        }
        matching.duplicates = documents
            .files()
            .map(|file| matching.find_duplicates(file, documents.entries(file)))
            .collect();
        matching
    }

    fn find_duplicates(&self, file: FileIndex, entries: &[Entry]) -> Vec<bool> {
        let content = |entry: &Entry| (entry.address, entry.name.clone());
        let matched =
            |entry: &&Entry| !self.devices_of(EntryPlace { file, index: entry.index }).is_empty();
        let mut buses_of: BTreeMap<_, Vec<Option<&str>>> = BTreeMap::new();
        for entry in entries.iter().filter(|entry| entry.address.is_some()).filter(matched) {
            buses_of.entry(content(entry)).or_default().push(entry.bus.as_deref());
        }
        let is_again = |entry: &Entry| {
            let own = entry.bus.as_deref();
            let on_it = |other: Option<&str>| other.is_none() || own.is_none() || other == own;
            !matched(&entry)
                && !buses_of.is_empty()
                && buses_of.get(&content(entry)).is_some_and(|it| it.iter().copied().any(on_it))
        };
        entries.iter().map(is_again).collect()
    }

    /// Returns true if the entry at this place repeats name and address of another entry that has a
    /// device.
    pub fn is_duplicate(&self, entry: EntryPlace) -> bool {
        let of_file = self.duplicates.get(usize::from(entry.file.0));
        of_file.and_then(|of_file| of_file.get(entry.index)) == Some(&true)
    }

    /// Place of the entry of a device; `None` for a device that is not in the file of its bus.
    pub fn entry_of(&self, device: DeviceId) -> Option<EntryPlace> {
        self.entry_of.get(&device).copied()
    }

    /// Devices of the entry at this place, at most one per bus.
    pub fn devices_of(&self, entry: EntryPlace) -> &[DeviceId] {
        let of_file = self.devices_of.get(usize::from(entry.file.0));
        of_file.and_then(|of_file| of_file.get(entry.index)).map_or(&[], Vec::as_slice)
    }
}

/// Entries of one bus without a device.
struct Unmatched<'e, 'm> {
    entries: Vec<&'e Entry>,
    matching: &'m mut Matching,
    file: FileIndex,
    bus: BusIndex,
}

impl Unmatched<'_, '_> {
    fn pair<'d, D: Iterator<Item = &'d Device>>(
        &mut self,
        devices: impl Fn() -> D,
        same: impl Fn(&Entry, &Device) -> bool,
    ) {
        for entry in std::mem::take(&mut self.entries) {
            let mut open = devices().filter(|device| self.is_open(device));
            match open.find(|device| same(entry, device)) {
                Some(device) => self.add(entry.index, device.id),
                None => self.entries.push(entry),
            }
        }
    }

    fn pair_unique<'d, D: Iterator<Item = &'d Device>>(
        &mut self,
        devices: impl Fn() -> D,
        fits: impl Fn(&Entry, &Device) -> bool,
    ) {
        for entry in std::mem::take(&mut self.entries) {
            let named = |device: &&Device| device.is_named(&entry.name) && fits(entry, device);
            let mut open = devices()
                .filter(|device| self.is_open(device) && named(device))
                .map(|device| device.id);
            match (open.next(), open.next()) {
                (Some(only), None) => self.add(entry.index, only),
                _ => self.entries.push(entry),
            }
        }
    }

    fn is_open(&self, device: &Device) -> bool {
        device.id.bus == self.bus && !self.matching.entry_of.contains_key(&device.id)
    }

    fn add(&mut self, entry: usize, device: DeviceId) {
        let place = EntryPlace { file: self.file, index: entry };
        self.matching.entry_of.insert(device, place);
        let of_file = self.matching.devices_of.get_mut(usize::from(self.file.0));
        if let Some(devices) = of_file.and_then(|of_file| of_file.get_mut(entry)) {
            devices.push(device);
        }
    }
}
