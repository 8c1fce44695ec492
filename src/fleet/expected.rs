//! What a gateway published, compared with the des.json of its site.
//!
//! Inputs: a document with the buses it is for, and a gateway. Output: differences by section, as `check`
//! has them. What only frames show (who is at an address, why a device is missing) the gateway finds
//! itself. Does not know files.

use super::view::FleetGateway;
use crate::bitrate::unexpected_rate;
use crate::document::{
    Document, DocumentFindingKind, Entry, ListedService, OwnService, same_services,
    service_differences,
};
use crate::finding::{CheckSection, FindingKind, FindingState};
use crate::inventory::{InventoryDevice, InventoryFinding, InventoryService};
use crate::text::{Quoted, printable, without_bit_rates};
use std::collections::{BTreeMap, BTreeSet};

/// A des.json, and the buses that it is for.
#[derive(Clone, Debug)]
pub struct ExpectedDevices {
    /// The entries.
    pub document: Document,
    /// Names of the buses; `None`: all of the gateway.
    pub buses: Option<Vec<String>>,
}

/// What the files of a site say of its gateway.
#[derive(Clone, Debug)]
pub struct ExpectedGateway {
    /// The des.json files.
    pub files: Vec<ExpectedDevices>,
    /// Bit rate of each bus of which the project gives it, in bit/s.
    pub bitrates: BTreeMap<String, u32>,
}

impl ExpectedGateway {
    /// Returns the number of entries in all files.
    pub fn entries(&self) -> usize {
        self.files.iter().map(|file| file.document.entries().len()).sum()
    }
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
    /// Compares what was published with these files and bit rates, and adds the confirmed conflicts.
    /// Conflicts first, then bit rates, then in the order of the files.
    pub fn differences(&self, expected: &ExpectedGateway) -> Vec<FleetDifference> {
        let mut found: Vec<FleetDifference> = self.conflicts().collect();
        found.extend(self.bitrate_differences(&expected.bitrates));
        for file in &expected.files {
            FileComparer { gateway: self, file, found: &mut found }.compare();
        }
        found
    }

    fn bitrate_differences(
        &self,
        expected: &BTreeMap<String, u32>,
    ) -> impl Iterator<Item = FleetDifference> {
        self.buses().filter_map(|bus| {
            let rate = u32::try_from(bus.bitrate?).ok()?;
            let expected = *expected.get(without_bit_rates(&bus.name))?;
            (rate != expected).then(|| FleetDifference {
                section: CheckSection::SettingsDiffer,
                bus: Some(bus.name.clone()),
                address: None,
                text: unexpected_rate(&bus.name, rate, expected),
            })
        })
    }

    /// The confirmed conflicts that the gateway found.
    fn conflicts(&self) -> impl Iterator<Item = FleetDifference> {
        self.findings_of(FindingState::Confirmed, FindingKind::is_conflict).map(|finding| {
            FleetDifference {
                section: CheckSection::Conflicts,
                bus: finding.bus.clone(),
                address: finding.address,
                text: finding.text.clone(),
            }
        })
    }

    /// The conflicts that the gateway suspects, and repeated frames, behind which a second device may be.
    /// They do not count as a difference.
    pub fn suspected_conflicts(&self) -> impl Iterator<Item = &InventoryFinding> {
        self.findings_of(FindingState::Suspected, FindingKind::may_be_conflict)
    }

    fn findings_of(
        &self,
        state: FindingState,
        is_wanted: impl Fn(FindingKind) -> bool,
    ) -> impl Iterator<Item = &InventoryFinding> {
        self.findings().filter(move |finding| {
            let kind = FindingKind::ALL.iter().copied().find(|kind| kind.name() == finding.kind);
            finding.confidence == state.name() && kind.is_some_and(&is_wanted)
        })
    }
}

struct FileComparer<'a> {
    gateway: &'a FleetGateway,
    file: &'a ExpectedDevices,
    found: &'a mut Vec<FleetDifference>,
}

impl<'a> FileComparer<'a> {
    fn compare(&mut self) {
        let file = self.file;
        for finding in file.document.findings() {
            let entry = finding.entries.first().and_then(|&at| file.document.entries().get(at));
            // A message about one entry does not name it.
            let whose = entry.filter(|_| finding.entries.len() == 1);
            let whose = whose.map_or(String::new(), |entry| format!("{}: ", Quoted(&entry.name)));
            let text = format!("{whose}{} ({})", finding.message, finding.position);
            self.add(CheckSection::FileErrors, None, None, text);
        }
        let by_bus: Vec<MatchedBus<'a>> =
            self.devices_by_bus().into_values().map(|it| MatchedBus::new(file, it)).collect();
        let buses: Vec<&str> = self.buses();
        for entry in file.document.entries() {
            // Of another bus, or reported as an error of the file.
            let is_here = entry.bus.is_none() || buses.iter().any(|bus| entry.is_for_bus(bus));
            if !is_here {
                continue;
            }
            if !is_duplicate(&file.document, entry) {
                self.entry(entry, &by_bus);
            } else if !by_bus.iter().any(|bus| bus.has_device_of(entry)) {
                self.missing(entry);
            }
        }
        for device in by_bus.iter().flat_map(MatchedBus::unlisted) {
            let who = device.name.as_deref().unwrap_or("An unnamed device");
            let text = format!("{who} at {} is not in the file.", device.address);
            self.add(CheckSection::NotInFile, Some(&device.bus), Some(device.address), text);
        }
    }

    /// Returns true if the file is for a bus.
    fn is_of_file(&self, bus: &str) -> bool {
        let name = without_bit_rates(bus);
        self.file.buses.as_ref().is_none_or(|buses| buses.iter().any(|it| it == name))
    }

    /// The buses of the file that the gateway has.
    fn buses(&self) -> Vec<&'a str> {
        let of_devices = self.gateway.devices().map(|device| device.bus.as_str());
        let all = self.gateway.buses().map(|bus| bus.name.as_str()).chain(of_devices);
        let all: BTreeSet<&str> = all.collect();
        all.into_iter().filter(|bus| self.is_of_file(bus)).collect()
    }

    /// The present devices on the buses of the file, without debug devices.
    fn devices_by_bus(&self) -> BTreeMap<&'a str, Vec<&'a InventoryDevice>> {
        let mut by_bus: BTreeMap<&str, Vec<&InventoryDevice>> = BTreeMap::new();
        for device in self.gateway.devices() {
            let (name, uid) = (device.name.as_deref(), device.uid.as_deref());
            let is_debug = InventoryDevice::is_debug(device.address, name, uid);
            if device.is_present() && !is_debug && self.is_of_file(&device.bus) {
                by_bus.entry(&device.bus).or_default().push(device);
            }
        }
        by_bus
    }

    fn entry(&mut self, entry: &Entry, by_bus: &[MatchedBus<'a>]) {
        let name = Quoted(&entry.name);
        let mut is_missing = true;
        for bus in by_bus {
            let own = bus.device_of(entry);
            if let Some(device) = own {
                is_missing = false;
                self.device(entry, device);
            }
            let pinned = entry.address.filter(|_| entry.is_static && bus.is_of(entry));
            let at_address = |it: &&&InventoryDevice| {
                Some(it.address) == pinned && own.is_none_or(|own| own.address != it.address)
            };
            let other = bus.devices.iter().find(at_address);
            if let Some((other, who)) = other.and_then(|it| Some((it, it.name.as_deref()?))) {
                let address = other.address;
                let text =
                    format!("Static address {address} of {name} is used by a device named {who}.");
                let bus = Some(other.bus.as_str());
                self.add(CheckSection::StaticAddressTaken, bus, Some(address), text);
            }
        }
        if is_missing {
            self.missing(entry);
        }
    }

    fn missing(&mut self, entry: &Entry) {
        let at = entry.address.map(|address| format!(" (at {address})")).unwrap_or_default();
        let text = format!("{}{at} is listed but not on the bus.", Quoted(&entry.name));
        self.add(CheckSection::Missing, entry.bus.as_deref(), entry.address, text);
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
        if !same_services(entry, own) {
            let differences = service_differences(listed, own);
            let text =
                format!("{name} at {address}: services differ from the file: {differences}.");
            self.add(CheckSection::ServicesDiffer, Some(&device.bus), Some(address), text);
        }
    }

    fn add(&mut self, section: CheckSection, bus: Option<&str>, address: Option<u8>, text: String) {
        let bus = bus.map(str::to_owned);
        self.found.push(FleetDifference { section, bus, address, text });
    }
}

/// The devices of a bus, with the entries that they match.
struct MatchedBus<'a> {
    devices: Vec<&'a InventoryDevice>,
    /// Index of the entry of each device.
    entries: Vec<Option<usize>>,
}

impl<'a> MatchedBus<'a> {
    /// An entry matches a device by UID, then by name and address, then the only device of its name
    /// that no other entry matches.
    fn new(file: &ExpectedDevices, devices: Vec<&'a InventoryDevice>) -> Self {
        let entries = vec![None; devices.len()];
        let mut matched = Self { devices, entries };
        let listed = file.document.entries();
        let own: Vec<&Entry> = listed.iter().filter(|entry| matched.is_of(entry)).collect();
        let is_at = |entry: &Entry, device: &InventoryDevice| {
            has_name(entry, device) && entry.address == Some(device.address)
        };
        for matches in [&has_uid as &dyn Fn(&Entry, &InventoryDevice) -> bool, &is_at, &has_name] {
            for entry in &own {
                matched.match_only(entry, matches);
            }
        }
        matched
    }

    /// Gives the only free device that matches to an entry that has none.
    fn match_only(&mut self, entry: &Entry, matches: &dyn Fn(&Entry, &InventoryDevice) -> bool) {
        if self.device_of(entry).is_some() {
            return;
        }
        let places = 0..self.devices.len();
        let mut free =
            places.filter(|&at| self.entries[at].is_none() && matches(entry, self.devices[at]));
        if let (Some(only), None) = (free.next(), free.next()) {
            self.entries[only] = Some(entry.index);
        }
    }

    /// Returns true if the entry applies to this bus.
    fn is_of(&self, entry: &Entry) -> bool {
        self.devices.first().is_some_and(|device| entry.is_for_bus(&device.bus))
    }

    fn device_of(&self, entry: &Entry) -> Option<&'a InventoryDevice> {
        let at = self.entries.iter().position(|it| *it == Some(entry.index))?;
        Some(self.devices[at])
    }

    /// Returns true if a device has the UID or the name of an entry.
    fn has_device_of(&self, entry: &Entry) -> bool {
        let is_it = |device: &&InventoryDevice| has_uid(entry, device) || has_name(entry, device);
        self.is_of(entry) && self.devices.iter().any(is_it)
    }

    fn unlisted(&self) -> impl Iterator<Item = &'a InventoryDevice> {
        let both = self.devices.iter().zip(&self.entries);
        both.filter(|(_, entry)| entry.is_none()).map(|(device, _)| *device)
    }
}

fn has_uid(entry: &Entry, device: &InventoryDevice) -> bool {
    let uid = device.uid.as_deref().map(str::trim).filter(|uid| !uid.is_empty());
    uid.is_some() && uid == entry.trimmed_uid()
}

fn has_name(entry: &Entry, device: &InventoryDevice) -> bool {
    device.name.as_deref() == Some(&entry.name_text)
}

/// Returns true if another entry describes the same device.
fn is_duplicate(document: &Document, entry: &Entry) -> bool {
    let mut doubles =
        document.findings().iter().filter(|it| it.kind == DocumentFindingKind::DuplicateEntry);
    doubles.any(|it| it.entries.contains(&entry.index))
}

/// The texts are printable, and the strings after the version are part of it; they do not count.
impl OwnService for InventoryService {
    fn is_named_as(&self, listed: &ListedService) -> bool {
        self.name == printable(listed.name.as_bytes())
    }

    fn has_version_of(&self, listed: &ListedService) -> bool {
        let rest = self.version.strip_prefix(&printable(listed.version.as_bytes()));
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(' '))
    }

    fn shown_name(&self) -> String {
        self.name.clone()
    }

    fn shown_version(&self) -> String {
        self.version.clone()
    }
}
