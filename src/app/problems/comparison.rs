//! Differences between des.json and the buses, as findings.
//!
//! Pure: entries and devices in, findings out.

use super::entry_mistakes::file_mistakes;
use crate::app::file::EntryPlace;
use crate::app::file_inputs::{FileInputs, Inputs};
use crate::app::listing::other_services;
use crate::discovery::Device;
use crate::document::{DocumentFindingKind, Entry, service_differences};
use crate::finding::{Finding, FindingKey, FindingKind, FindingState};
use crate::frame::BusIndex;
use crate::text::{Name, Quoted};
use crate::wire::id::Address;

/// Extent of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// For the screen: without devices that are not in the file, and without services.
    Screen,
    /// Every difference, for `check`.
    Check,
}

/// Values of the placeholders in a remedy.
pub(super) type Values<'a> = &'a [(&'a str, &'a dyn std::fmt::Display)];

/// Differences between des.json and the buses, and what the descriptors show.
pub(super) struct Comparison<'a> {
    pub(super) inputs: Inputs<'a>,
    pub found: Vec<Finding>,
    /// Places of the entries that the findings are about, in the same order.
    pub entries: Vec<Option<EntryPlace>>,
}

impl<'a> Comparison<'a> {
    /// Compares files and buses; without a file there are only those that the descriptors show.
    pub fn new(inputs: Inputs<'a>, scope: Scope) -> Self {
        let mut comparison = Self { inputs, found: Vec::new(), entries: Vec::new() };
        comparison.descriptors();
        comparison.catalogue();
        comparison.project();
        for file in inputs.files().filter(|file| file.is_there) {
            comparison.file_alone(file);
            for entry in file.document.entries() {
                comparison.entry(file, entry, scope);
            }
            if scope == Scope::Check {
                comparison.unlisted(file);
            }
        }
        comparison
    }

    fn file_alone(&mut self, file: FileInputs<'a>) {
        let document = file.document;
        let (mut bus, mut name_of_file) = (None, String::new());
        // Of several files, a finding has the first bus of its file.
        if self.inputs.documents.are_several() {
            bus = file.buses().next().map(|(index, _)| index);
            name_of_file = format!("{}, ", self.inputs.documents.name(file.file));
        }
        for finding in file_mistakes(file) {
            let kind = FindingKind::from(finding.kind);
            let entries = finding.entries.iter().filter_map(|&at| document.entries().get(at));
            let names: Vec<Name> = entries.clone().map(|entry| Name::new(&entry.name)).collect();
            let address = entries.clone().find_map(|entry| Address::new(entry.address?));
            let text = format!("{} ({name_of_file}{})", finding.message, finding.position);
            let name = names.first().cloned();
            self.add(kind, bus, address, name, text, &[]);
            if let Some(added) = self.found.last_mut() {
                if kind == FindingKind::FileShape {
                    // One entry may have several.
                    added.key.fault = Some(finding.brief().into());
                    added.position = Some((finding.position.line, finding.position.column));
                }
                for name in &names {
                    added.add_name(name);
                }
            }
            let place = |index: &usize| EntryPlace { file: file.file, index: *index };
            self.is_about(finding.entries.first().map(place));
        }
    }

    fn entry(&mut self, file: FileInputs<'a>, entry: &'a Entry, scope: Scope) {
        let (inputs, place) = (self.inputs, file.place(entry));
        let devices: Vec<&Device> = file
            .devices_of(entry)
            .iter()
            .filter_map(|&id| inputs.buses.device(id))
            .filter(|device| device.is_present())
            .collect();
        let name = Quoted(&entry.name);
        let pinned = entry.address.filter(|_| entry.is_static).and_then(Address::new);
        if inputs.matching.is_duplicate(place) {
            // Reported as a finding about the file.
            return;
        }
        if devices.is_empty() {
            self.missing(file, entry, scope);
        }
        for device in &devices {
            if let Some(pinned) = pinned.filter(|pinned| *pinned != device.address) {
                let text = format!(
                    "{name} is at address {}; the file pins it to {pinned}.",
                    device.address
                );
                let values: Values = &[("static address", &pinned), ("address", &device.address)];
                let bus = Some(device.id.bus);
                let named = device.name.clone();
                self.add(FindingKind::WrongAddress, bus, Some(device.address), named, text, values);
                self.is_about(Some(place));
            }
            self.name(file, entry, device);
            self.fixed_address(entry, device);
            if scope == Scope::Check {
                self.services(entry, device);
            }
        }
        let Some(pinned) = pinned else { return };
        for (index, bus) in file.buses_of(entry) {
            let other = bus.devices().iter().find(|device| {
                let is_it = file.devices_of(entry).contains(&device.id);
                device.address == pinned && device.is_present() && !is_it
            });
            // A device without a known name may be the listed one.
            let Some(other) = other
                .filter(|other| other.name.is_some() || other.name_query.has_failed_since_response)
            else {
                continue;
            };
            let who = other.name.as_ref().map_or("an unnamed device".to_owned(), |it| {
                format!("a device named {}", it.quoted())
            });
            let text = format!("Static address {pinned} of {name} is used by {who}.");
            let values: Values = &[("name", &name)];
            let named = Some(Name::new(&entry.name));
            let bus = Some(index);
            self.add(FindingKind::StaticAddressTaken, bus, Some(pinned), named, text, values);
            self.is_about(Some(place));
            if let (Some(found), Some(name)) = (self.found.last_mut(), &other.name) {
                found.add_name(name);
            } else if let Some(found) = self.found.last_mut() {
                found.state = FindingState::Suspected;
            }
        }
    }

    fn missing(&mut self, file: FileInputs<'a>, entry: &'a Entry, scope: Scope) {
        let Some((bus, _)) = file.buses_of(entry).next() else { return };
        if scope == Scope::Screen && !file.is_missing(entry) {
            return;
        }
        let address = entry.address.and_then(Address::new);
        let at = address.map(|address| format!(" (at {address})")).unwrap_or_default();
        let why = file.missing_reasons(entry);
        let (first, rest) = why.split_first().map_or(("", &[][..]), |(it, rest)| (it, rest));
        let end = if first.ends_with('?') { "" } else { "." };
        let name = Quoted(&entry.name);
        let text = format!("{name}{at} is listed but not on the bus: {first}{end}");
        let values: Values = &[("further reasons", &rest.join("; "))];
        let name = Some(Name::new(&entry.name));
        self.add(FindingKind::Missing, Some(bus), address, name, text, values);
        self.is_about(Some(file.place(entry)));
    }

    fn name(&mut self, file: FileInputs<'a>, entry: &Entry, device: &Device) {
        let Some(own) = device.name.as_ref().filter(|_| !device.is_named(&entry.name)) else {
            return;
        };
        let (listed, own, address) = (Quoted(&entry.name), own.quoted(), device.address);
        let text = format!("{listed} at {address} reports the name {own} (matched by UID).");
        let values: Values = &[("reported name", &own), ("name", &listed)];
        let named = Some(Name::new(&entry.name));
        let bus = Some(device.id.bus);
        self.add(FindingKind::NameDiffers, bus, Some(address), named, text, values);
        self.is_about(Some(file.place(entry)));
    }

    fn services(&mut self, entry: &Entry, device: &Device) {
        let Some((listed, own)) = other_services(entry, device) else { return };
        let text = format!(
            "{} at {}: services differ from the file: {}.",
            Quoted(&entry.name),
            device.address,
            service_differences(listed, own)
        );
        let (bus, name) = (Some(device.id.bus), device.name.clone());
        self.add(FindingKind::ServicesDiffer, bus, Some(device.address), name, text, &[]);
    }

    fn unlisted(&mut self, file: FileInputs<'a>) {
        for (_, bus) in file.buses() {
            for device in bus.devices() {
                let listed = self.inputs.matching.entry_of(device.id).is_some();
                if listed || device.is_debug || !device.is_present() {
                    continue;
                }
                // Probably the listed device: the finding about its entry has the reason why it is
                // not identified.
                if device.name.is_none() && is_awaited_at(file, device.address) {
                    continue;
                }
                let who = device
                    .name
                    .as_ref()
                    .map_or("An unnamed device".to_owned(), ToString::to_string);
                let text = format!("{who} at {} is not in the file.", device.address);
                let (bus, name) = (Some(device.id.bus), device.name.clone());
                self.add(FindingKind::Unlisted, bus, Some(device.address), name, text, &[]);
            }
        }
    }

    /// Sets the entry of the last finding.
    fn is_about(&mut self, entry: Option<EntryPlace>) {
        if let Some(last) = self.entries.last_mut() {
            *last = entry;
        }
    }

    pub(super) fn add(
        &mut self,
        kind: FindingKind,
        bus: Option<BusIndex>,
        address: Option<Address>,
        name: Option<Name>,
        text: String,
        values: Values,
    ) {
        let key = FindingKey { kind, bus, address, name, fault: None };
        let remedy = key.wording().remedy_with(values);
        let mut finding = Finding::new(key, self.inputs.now);
        finding.state = FindingState::Confirmed;
        finding.text = text;
        finding.remedy = remedy;
        self.found.push(finding);
        self.entries.push(None);
    }
}

/// Returns true if an entry without a device has this address.
fn is_awaited_at(file: FileInputs, address: Address) -> bool {
    let entries = file.document.entries().iter();
    let mut here = entries.filter(|entry| entry.address == Some(address.number()));
    here.any(|entry| file.devices_of(entry).is_empty())
}

/// The kind of the finding that reports a fault in the file.
impl From<DocumentFindingKind> for FindingKind {
    fn from(kind: DocumentFindingKind) -> Self {
        use DocumentFindingKind as Fault;
        match kind {
            Fault::DuplicateAddress => FindingKind::FileDuplicateAddress,
            Fault::DuplicateEntry => FindingKind::FileDuplicateEntry,
            Fault::NotDevices
            | Fault::NotAnEntry
            | Fault::MissingName
            | Fault::WrongType
            | Fault::AddressRange
            | Fault::NamesDiffer
            | Fault::DuplicateMember
            | Fault::MisspelledMember
            | Fault::StaticWithoutAddress
            | Fault::UnusableUid
            | Fault::BusOfAnotherFile
            | Fault::DuplicateUid => FindingKind::FileShape,
        }
    }
}
