//! What is found: the engines' findings, and what des.json and the bus say differently.
//!
//! The comparison is pure: entries and devices in, findings out. Does not know how sure the
//! engines are or why, nor how the findings are shown.

use super::App;
use super::matching::{Matching, is_for};
use crate::discovery::Device;
use crate::document::{self, Document, DocumentFindingKind, Entry};
use crate::finding::{Confidence, Finding, FindingKey, FindingKind};
use crate::frame::BusIndex;
use crate::text::{Escaped, Name, Quoted};
use crate::time::Instant;
use crate::wire::id::Address;
use crate::wire::node::Uid;
use std::collections::HashMap;

/// How much is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// What is shown while working: not what is merely not in the file (yet).
    Screen,
    /// Every difference, as `check` reports it.
    Check,
}

impl App {
    /// Whether two devices are proven to speak from this one's address: then what is counted of
    /// its heartbeats is of both.
    pub fn is_shared(&self, device: &Device) -> bool {
        self.is_proven(device, FindingKind::SameNameSameAddress)
            || self.is_proven(device, FindingKind::OneAddressTwoNames)
            || self.is_proven(device, FindingKind::OneAddressTwoIdentities)
    }

    /// The UID that its heartbeats say; both, where two are proven to take turns.
    pub fn uids_of(&self, device: &Device) -> Vec<Uid> {
        let two = self.is_proven(device, FindingKind::OneAddressTwoIdentities);
        let other = device.uid_before().filter(|_| two);
        device.uid.into_iter().chain(other).collect()
    }

    fn is_proven(&self, device: &Device, kind: FindingKind) -> bool {
        self.bus(device.id.bus).is_some_and(|bus| {
            bus.engine.findings().iter().any(|finding| {
                finding.key.kind == kind
                    && finding.key.address == Some(device.address)
                    && finding.confidence == Confidence::Confirmed
            })
        })
    }

    /// Everything that is found: bus by bus, then what comes of the file.
    pub fn findings(&self) -> impl Iterator<Item = &Finding> {
        let engines = self.buses.iter().flat_map(|bus| bus.engine.findings());
        engines.chain(&self.file_findings)
    }

    /// How the file and the buses differ now.
    pub fn compare(&self, now: Instant, scope: Scope) -> Vec<Finding> {
        self.comparison(now, scope).found
    }

    fn comparison(&self, now: Instant, scope: Scope) -> Comparison<'_> {
        let mut comparison = Comparison { app: self, now, found: Vec::new(), entries: Vec::new() };
        if !self.file.is_there() {
            return comparison;
        }
        comparison.file_alone(self.file.document());
        for entry in self.file.document().entries() {
            comparison.entry(entry, scope);
        }
        if scope == Scope::Check {
            comparison.unlisted();
        }
        comparison
    }

    /// The place of the entry that a finding of comparing file and bus is about.
    pub(super) fn entry_of_finding(&self, key: &FindingKey) -> Option<usize> {
        let at = self.file_findings.iter().position(|finding| finding.key == *key)?;
        self.entries_of_findings[at]
    }

    /// Compares anew; what was found before keeps its time.
    pub(super) fn refresh_problems(&mut self, now: Instant) {
        self.matching = Matching::new(self.file.document().entries(), &self.buses);
        let Comparison { mut found, entries, .. } = self.comparison(now, Scope::Screen);
        self.entries_of_findings = entries;
        let known: HashMap<&FindingKey, &Finding> =
            self.file_findings.iter().map(|finding| (&finding.key, finding)).collect();
        for finding in &mut found {
            if let Some(old) = known.get(&finding.key) {
                finding.first = old.first;
                if old.confidence == finding.confidence {
                    finding.changed = old.changed;
                }
            }
        }
        let before = std::mem::replace(&mut self.file_findings, found);
        self.report_differences(&before, now);
    }
}

/// Values of the placeholders in a remedy.
type Values<'a> = &'a [(&'a str, &'a dyn std::fmt::Display)];

struct Comparison<'a> {
    app: &'a App,
    now: Instant,
    found: Vec<Finding>,
    /// The places of the entries that they are about, in the same order.
    entries: Vec<Option<usize>>,
}

impl Comparison<'_> {
    fn file_alone(&mut self, document: &Document) {
        for finding in document.findings() {
            let kind = match finding.kind {
                DocumentFindingKind::DuplicateAddress => FindingKind::FileDuplicateAddress,
                DocumentFindingKind::DuplicateEntry => FindingKind::FileDuplicateEntry,
                DocumentFindingKind::NotDevices
                | DocumentFindingKind::NotAnEntry
                | DocumentFindingKind::MissingName
                | DocumentFindingKind::WrongType
                | DocumentFindingKind::AddressRange
                | DocumentFindingKind::NamesDiffer
                | DocumentFindingKind::DuplicateMember => FindingKind::FileShape,
            };
            let entries = finding.entries.iter().filter_map(|&at| document.entries().get(at));
            let names: Vec<Name> = entries.clone().map(|entry| Name::new(&entry.name)).collect();
            let address = entries.clone().find_map(|entry| Address::new(entry.address?));
            let text = format!("{} ({})", finding.message, finding.position);
            let name = names.first().cloned();
            self.add(kind, None, address, name, text, &[]);
            if let Some(added) = self.found.last_mut() {
                if kind == FindingKind::FileShape {
                    // One entry may have several.
                    added.key.part = Some(finding.brief().into());
                    added.place = Some((finding.position.line, finding.position.column));
                }
                for name in &names {
                    added.add_name(name);
                }
            }
            self.is_about(finding.entries.first().copied());
        }
    }

    fn entry(&mut self, entry: &Entry, scope: Scope) {
        let app = self.app;
        let devices: Vec<&Device> = app
            .matching
            .devices_of(entry.index)
            .iter()
            .filter_map(|&id| app.device(id))
            .filter(|device| device.is_present())
            .collect();
        let name = Quoted(&entry.name);
        let pinned = entry.address.filter(|_| entry.is_static).and_then(Address::new);
        if app.matching.is_duplicate(entry.index) {
            // That it stands twice is told of the file.
            return;
        }
        if devices.is_empty() {
            self.missing(entry, scope);
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
                self.is_about(Some(entry.index));
            }
            self.name(entry, device);
            if scope == Scope::Check {
                self.services(entry, device);
            }
        }
        let Some(pinned) = pinned else { return };
        for (index, bus) in app.buses.iter().enumerate().filter(|(_, bus)| is_for(entry, &bus.name))
        {
            let other = bus.engine.devices().iter().find(|device| {
                let is_it = app.matching.devices_of(entry.index).contains(&device.id);
                device.address == pinned && device.is_present() && !is_it
            });
            // Whoever has not said its name yet may be the very device.
            let Some(other) =
                other.filter(|other| other.name.is_some() || other.name_query.in_vain)
            else {
                continue;
            };
            let who = other.name.as_ref().map_or("an unnamed device".to_owned(), |it| {
                format!("a device named {}", it.quoted())
            });
            let text = format!("Static address {pinned} of {name} is used by {who}.");
            let values: Values = &[("name", &name)];
            let named = Some(Name::new(&entry.name));
            let bus = Some(BusIndex(index as u8));
            self.add(FindingKind::StaticAddressTaken, bus, Some(pinned), named, text, values);
            self.is_about(Some(entry.index));
            if let (Some(found), Some(name)) = (self.found.last_mut(), &other.name) {
                found.add_name(name);
            } else if let Some(found) = self.found.last_mut() {
                found.confidence = Confidence::Suspected;
            }
        }
    }

    fn missing(&mut self, entry: &Entry, scope: Scope) {
        let app = self.app;
        let bus = app.buses.iter().position(|bus| is_for(entry, &bus.name));
        let Some(bus) = bus.map(|at| BusIndex(at as u8)) else { return };
        if scope == Scope::Screen && !app.is_missing(entry) {
            return;
        }
        let address = entry.address.and_then(Address::new);
        let at = address.map(|address| format!(" (at {address})")).unwrap_or_default();
        let why = app.why_missing(entry);
        let (first, rest) = why.split_first().map_or(("", &[][..]), |(it, rest)| (it, rest));
        let text = format!("{}{at} is listed but not on the bus: {first}.", Quoted(&entry.name));
        let values: Values = &[("further reasons", &rest.join("; "))];
        let name = Some(Name::new(&entry.name));
        self.add(FindingKind::Missing, Some(bus), address, name, text, values);
        self.is_about(Some(entry.index));
    }

    fn name(&mut self, entry: &Entry, device: &Device) {
        let Some(own) = device.name.as_ref().filter(|_| !device.is_named(&entry.name)) else {
            return;
        };
        let (listed, own, address) = (Quoted(&entry.name), own.quoted(), device.address);
        let text = format!("{listed} at {address} reports the name {own} (matched by UID).");
        let values: Values = &[("reported name", &own), ("name", &listed)];
        let named = Some(Name::new(&entry.name));
        let bus = Some(device.id.bus);
        self.add(FindingKind::NameDiffers, bus, Some(address), named, text, values);
        self.is_about(Some(entry.index));
    }

    fn services(&mut self, entry: &Entry, device: &Device) {
        let Some((listed, own)) = other_services(entry, device) else { return };
        let text = format!(
            "{} at {}: services differ from the file: {}.",
            Quoted(&entry.name),
            device.address,
            differences(listed, own)
        );
        let (bus, name) = (Some(device.id.bus), device.name.clone());
        self.add(FindingKind::ServicesDiffer, bus, Some(device.address), name, text, &[]);
    }

    fn unlisted(&mut self) {
        for bus in &self.app.buses {
            for device in bus.engine.devices() {
                let listed = self.app.matching.entry_of(device.id).is_some();
                if listed || device.is_debug || !device.is_present() {
                    continue;
                }
                // Most likely the listed one, of which is said why it is not known to be there.
                if device.name.is_none() && self.is_awaited_at(device.address) {
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

    /// Whether an entry has that address whose device was not found.
    fn is_awaited_at(&self, address: Address) -> bool {
        let entries = self.app.file.document().entries().iter();
        let mut here = entries.filter(|entry| entry.address == Some(address.number()));
        here.any(|entry| self.app.matching.devices_of(entry.index).is_empty())
    }

    /// What was added last is about this entry.
    fn is_about(&mut self, entry: Option<usize>) {
        if let Some(last) = self.entries.last_mut() {
            *last = entry;
        }
    }

    fn add(
        &mut self,
        kind: FindingKind,
        bus: Option<BusIndex>,
        address: Option<Address>,
        name: Option<Name>,
        text: String,
        values: Values,
    ) {
        let key = FindingKey { kind, bus, address, name, part: None };
        let remedy = key.wording().remedy_with(values);
        let mut finding = Finding::new(key, self.now);
        finding.confidence = Confidence::Confirmed;
        finding.text = text;
        finding.remedy = remedy;
        self.found.push(finding);
        self.entries.push(None);
    }
}

/// The services that an entry lists, and those that its device says it has, where the two differ.
pub fn other_services<'a>(
    entry: &'a Entry,
    device: &'a Device,
) -> Option<(&'a [document::ListedService], &'a [crate::discovery::DeviceService])> {
    let both = entry.listed_services().zip(device.services.as_deref());
    both.filter(|(_, own)| !same_services(entry, own))
}

/// Whether an entry lists what a device says of its services.
pub fn same_services(entry: &Entry, own: &[crate::discovery::DeviceService]) -> bool {
    let listed = entry.services.as_deref().unwrap_or_default();
    let same = |listed: &document::ListedService, own: &crate::discovery::DeviceService| {
        as_listed(&own.name) == listed.name
            && (listed.version.is_empty() || as_listed(&own.version) == listed.version)
    };
    if listed.len() != own.len() {
        return false;
    }
    if entry.has_ordered_services {
        return listed.iter().zip(own).all(|(listed, own)| same(listed, own));
    }
    // No name is there twice.
    listed.iter().all(|listed| own.iter().any(|own| same(listed, own)))
}

/// Differences that are spelt out; of more only their number.
const SPELT: usize = 4;

/// How what the file lists of services differs from what a device says, in words.
fn differences(
    listed: &[document::ListedService],
    own: &[crate::discovery::DeviceService],
) -> String {
    let show = |text: &str| Escaped(text.as_bytes()).to_string();
    let mut words = Vec::new();
    for entry in listed {
        let mut same_name = own.iter().filter(|it| as_listed(&it.name) == entry.name);
        let is_there = same_name
            .clone()
            .any(|it| entry.version.is_empty() || as_listed(&it.version) == entry.version);
        match same_name.next() {
            _ if is_there => {}
            Some(other) => words.push(format!(
                "{} is {}, not {}",
                show(&entry.name),
                show(&as_listed(&other.version)),
                show(&entry.version)
            )),
            None => words.push(format!("{} is missing", show(&entry.name))),
        }
    }
    for service in own {
        let name = as_listed(&service.name);
        if !listed.iter().any(|entry| entry.name == name) {
            let version = as_listed(&service.version);
            words.push(format!("{} is not listed", show(&format!("{name} {version}"))));
        }
    }
    if words.is_empty() {
        return "different order or duplicates".to_owned();
    }
    let more = words.len().saturating_sub(SPELT);
    words.truncate(SPELT);
    if more > 0 {
        words.push(format!("and {more} more"));
    }
    words.join("; ")
}

/// A device's string as the file lists it: the text itself where it is UTF-8.
pub fn as_listed(name: &Name) -> String {
    match std::str::from_utf8(name.as_bytes()) {
        Ok(text) => text.to_owned(),
        Err(_) => name.to_string(),
    }
}
