//! What a gateway published, compared with the des.json of its site.
//!
//! Inputs: a document with the buses it is for, and a gateway. Output: differences by section, as `check`
//! has them. What only frames show (who is at an address, why a device is missing) the gateway finds
//! itself. Does not know files.

use super::view::FleetGateway;
use crate::document::{Document, Entry};
use crate::finding::{CheckSection, FindingKind, FindingState};
use crate::inventory::{InventoryDevice, InventoryService};
use crate::text::Quoted;
use std::collections::BTreeSet;

/// A des.json, and the buses that it is for.
#[derive(Clone, Debug)]
pub struct ExpectedDevices {
    /// The entries.
    pub document: Document,
    /// Names of the buses; `None`: all of the gateway.
    pub buses: Option<Vec<String>>,
}

/// A difference between a gateway and a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FleetDifference {
    /// Its section in the output of `check`.
    pub section: CheckSection,
    /// Name of the bus; `None` where an entry is for several.
    pub bus: Option<String>,
    /// Address of the device, or of the entry.
    pub address: Option<u8>,
    /// One sentence.
    pub text: String,
}

impl FleetGateway {
    /// Compares what was published with these files, and adds the confirmed conflicts. In the order of
    /// the files.
    pub fn differences(&self, expected: &[ExpectedDevices]) -> Vec<FleetDifference> {
        let mut found: Vec<FleetDifference> = self.conflicts().collect();
        for file in expected {
            Comparer { gateway: self, file, found: &mut found }.compare();
        }
        found
    }

    /// The confirmed conflicts that the gateway found.
    fn conflicts(&self) -> impl Iterator<Item = FleetDifference> {
        let confirmed =
            self.findings().filter(|it| it.confidence == FindingState::Confirmed.name());
        confirmed.filter_map(|finding| {
            let kind = FindingKind::ALL.iter().find(|kind| kind.name() == finding.kind)?;
            kind.is_conflict().then(|| FleetDifference {
                section: CheckSection::Conflicts,
                bus: finding.bus.clone(),
                address: finding.address,
                text: finding.text.clone(),
            })
        })
    }
}

struct Comparer<'a> {
    gateway: &'a FleetGateway,
    file: &'a ExpectedDevices,
    found: &'a mut Vec<FleetDifference>,
}

impl<'a> Comparer<'a> {
    fn compare(&mut self) {
        let document = &self.file.document;
        for finding in document.findings() {
            let text = format!("{} ({})", finding.message, finding.position);
            self.add(CheckSection::FileErrors, None, None, text);
        }
        let mut listed = BTreeSet::new();
        for entry in document.entries() {
            self.entry(entry, &mut listed);
        }
        let unlisted: Vec<&InventoryDevice> = self
            .devices()
            .filter(|device| !listed.contains(&(device.bus.as_str(), device.address)))
            .collect();
        for device in unlisted {
            let who = device.name.as_deref().unwrap_or("An unnamed device");
            let text = format!("{who} at {} is not in the file.", device.address);
            self.add(CheckSection::NotInFile, Some(&device.bus), Some(device.address), text);
        }
    }

    /// The present devices on the buses of the file, without debug devices.
    fn devices(&self) -> impl Iterator<Item = &'a InventoryDevice> + use<'a> {
        let buses = self.file.buses.as_deref();
        self.gateway.devices().filter(move |device| {
            let is_debug = InventoryDevice::is_debug(
                device.address,
                device.name.as_deref(),
                device.uid.as_deref(),
            );
            let is_here = buses.is_none_or(|buses| buses.contains(&device.bus));
            device.is_present() && !is_debug && is_here
        })
    }

    fn entry(&mut self, entry: &Entry, listed: &mut BTreeSet<(&'a str, u8)>) {
        let of_bus = self.devices().filter(|device| entry.is_for_bus(&device.bus));
        let named = |device: &&InventoryDevice| device.name.as_deref() == Some(&entry.name_text);
        let with_uid = |device: &&InventoryDevice| {
            let uid = device.uid.as_deref().map(str::trim).filter(|uid| !uid.is_empty());
            uid.is_some() && uid == entry.trimmed_uid()
        };
        let all: Vec<&InventoryDevice> = of_bus.collect();
        let mut devices: Vec<&InventoryDevice> =
            all.iter().copied().filter(|device| with_uid(&device)).collect();
        if devices.is_empty() {
            devices = all.iter().copied().filter(named).collect();
        }
        let name = Quoted(&entry.name);
        if devices.is_empty() {
            let at = entry.address.map(|address| format!(" (at {address})")).unwrap_or_default();
            let text = format!("{name}{at} is listed but not on the bus.");
            self.add(CheckSection::Missing, entry.bus.as_deref(), entry.address, text);
        }
        let pinned = entry.address.filter(|_| entry.is_static);
        for device in &devices {
            listed.insert((&device.bus, device.address));
            self.device(entry, device);
        }
        let taken = all.into_iter().find(|device| {
            let is_it =
                devices.iter().any(|it| it.bus == device.bus && it.address == device.address);
            Some(device.address) == pinned && !is_it
        });
        if let Some((other, own)) = taken.and_then(|it| Some((it, it.name.as_deref()?))) {
            let address = other.address;
            let text =
                format!("Static address {address} of {name} is used by a device named {own}.");
            self.add(CheckSection::StaticAddressTaken, Some(&other.bus), Some(address), text);
        }
    }

    fn device(&mut self, entry: &Entry, device: &InventoryDevice) {
        let (name, address) = (Quoted(&entry.name), device.address);
        let pinned = entry.address.filter(|_| entry.is_static);
        if let Some(pinned) = pinned.filter(|pinned| *pinned != address) {
            let text = format!("{name} is at address {address}; the file pins it to {pinned}.");
            self.add(CheckSection::WrongAddress, Some(&device.bus), Some(address), text);
        }
        if let Some(own) = device.name.as_deref().filter(|own| *own != entry.name_text) {
            let text = format!("{name} at {address} reports the name {own} (matched by UID).");
            self.add(CheckSection::NameDiffers, Some(&device.bus), Some(address), text);
        }
        let Some((listed, own)) = entry.listed_services().zip(device.services.as_deref()) else {
            return;
        };
        let listed = listed.iter().map(|service| {
            let extra = service.extra.iter();
            let version = extra.fold(service.version.clone(), |all, one| all + " " + one);
            InventoryService { name: service.name.clone(), version }
        });
        let difference = difference(listed.collect(), own.to_vec(), entry.has_ordered_services);
        if let Some(difference) = difference {
            let text = format!("{name} at {address}: services differ from the file: {difference}.");
            self.add(CheckSection::ServicesDiffer, Some(&device.bus), Some(address), text);
        }
    }

    fn add(&mut self, section: CheckSection, bus: Option<&str>, address: Option<u8>, text: String) {
        let bus = bus.map(str::to_owned);
        self.found.push(FleetDifference { section, bus, address, text });
    }
}

/// How the services of a device differ from those of its entry, in words; `None` if they do not.
fn difference(
    mut listed: Vec<InventoryService>,
    mut own: Vec<InventoryService>,
    has_order: bool,
) -> Option<String> {
    if listed == own {
        return None;
    }
    let text = |it: &InventoryService| format!("{} {}", it.name, it.version).trim_end().to_owned();
    let only = |of: &[InventoryService], other: &[InventoryService]| -> Vec<String> {
        of.iter().filter(|it| !other.contains(it)).map(text).collect()
    };
    let missing = only(&listed, &own).into_iter().map(|it| format!("{it} is not on the device"));
    let further = only(&own, &listed).into_iter().map(|it| format!("{it} is not listed"));
    let parts: Vec<String> = missing.chain(further).collect();
    if !parts.is_empty() {
        return Some(parts.join("; "));
    }
    listed.sort();
    own.sort();
    match (listed == own, has_order) {
        (true, false) => None,
        (true, true) => Some("another order".to_owned()),
        (false, _) => Some("one is there several times".to_owned()),
    }
}
