//! Entries of des.json and how they are read.

use std::collections::HashMap;

use super::MAX_SERVICES;
use super::finding::{DocumentFindingKind, Findings};
use super::position::Position;
use super::scan::{self, Span};
use super::syntax::JsonKind;
use super::text;
use crate::text::without_bit_rates;

/// One device in the file. Members with a value of the wrong type count as absent and have a
/// finding.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Entry {
    /// Bytes of the name: `name_hex` if given, else the UTF-8 of `name`.
    pub name: Vec<u8>,
    /// Name as [`printable`](crate::text::printable) text.
    pub name_text: String,
    /// Address, 1 to 127: the static address, or the last one seen. See `is_static`.
    pub address: Option<u8>,
    /// The address is static (pinned).
    pub is_static: bool,
    /// Name of the bus; `None`: any bus.
    pub bus: Option<String>,
    /// UID as spelled in the file.
    pub uid: Option<String>,
    /// Start of the value of `uid`; `None` if it is missing.
    pub uid_position: Option<Position>,
    /// Services in the file's order; `None`: not listed.
    pub services: Option<Vec<ListedService>>,
    /// The services are a list, whose order counts; in an object it does not.
    pub has_ordered_services: bool,
    /// Start of the entry.
    pub position: Position,
    /// Start of the value of `address`, valid or not; `None` if it is missing.
    pub address_position: Option<Position>,
    /// Index in [`Document::entries`](super::Document::entries).
    pub index: usize,
    /// Index in the file's list, which may have elements that are not entries.
    pub(super) element: usize,
    /// Members present, of any value.
    pub(super) present: Present,
}

impl Entry {
    /// Returns true if the entry applies to the bus with this name: it names that bus, or none. An
    /// adapter is the same bus at any bit rate.
    pub fn is_for_bus(&self, bus: &str) -> bool {
        self.named_bus().is_none_or(|named| named == without_bit_rates(bus))
    }

    /// Returns the bus without bit rates; `None`: any bus.
    pub(super) fn named_bus(&self) -> Option<&str> {
        self.bus.as_deref().map(without_bit_rates)
    }

    /// Returns the UID without blanks around it; `None` without one.
    pub fn trimmed_uid(&self) -> Option<&str> {
        self.uid.as_deref().map(str::trim).filter(|uid| !uid.is_empty())
    }

    /// Returns the services; `None` if the list is missing or empty.
    pub fn listed_services(&self) -> Option<&[ListedService]> {
        self.services.as_deref().filter(|listed| !listed.is_empty())
    }

    /// Returns the content of the entry, without positions.
    pub(super) fn content(&self) -> impl PartialEq + '_ {
        (&self.name, self.address, self.is_static, &self.bus, &self.uid, &self.services)
    }
}

/// A service of a device, as the file lists it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct ListedService {
    /// Name, for example `AUGER`.
    pub name: String,
    /// Version, for example `2.1`; empty if missing.
    pub version: String,
    /// Strings after the version.
    pub extra: Vec<String>,
}

/// Members of an entry that descan reads. All others are kept unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Member {
    Name,
    NameHex,
    Address,
    Static,
    Services,
    Bus,
    Uid,
}

impl Member {
    /// All, in the order of a new entry unless the file has its own order.
    pub const ALL: [Self; 7] = [
        Self::Name,
        Self::NameHex,
        Self::Address,
        Self::Static,
        Self::Services,
        Self::Bus,
        Self::Uid,
    ];

    pub fn key(self) -> &'static str {
        match self {
            Self::Name => "name",
            Self::NameHex => "name_hex",
            Self::Address => "address",
            Self::Static => "static",
            Self::Services => "services",
            Self::Bus => "bus",
            Self::Uid => "uid",
        }
    }

    /// Returns the member of a key in the source, given with its quotes; `None` for other keys.
    pub fn of(raw_key: &str) -> Option<Self> {
        let key = text::from_json(raw_key)?;
        Self::ALL.into_iter().find(|member| member.key() == key)
    }

    /// Returns true if two entries have the same value of this member.
    pub fn agrees(self, a: &Entry, b: &Entry) -> bool {
        match self {
            Self::Name | Self::NameHex => a.name == b.name,
            Self::Address => a.address == b.address,
            Self::Static => a.is_static == b.is_static,
            Self::Services => a.services == b.services,
            Self::Bus => a.bus == b.bus,
            Self::Uid => a.uid == b.uid,
        }
    }
}

/// A set of members.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Present(u8);

impl Present {
    pub fn has(self, member: Member) -> bool {
        self.0 & 1 << member as u8 != 0
    }

    fn add(&mut self, member: Member) {
        self.0 |= 1 << member as u8;
    }
}

/// Members of a service that descan reads.
const SERVICE_MEMBERS: [&str; 3] = ["name", "version", "extra"];

/// Reads the elements of the list of devices. An element without a name is not an entry.
pub(super) fn read_all(body: &str, elements: &[Span], findings: &mut Findings) -> Vec<Entry> {
    let mut entries: Vec<Entry> = Vec::with_capacity(elements.len());
    for (element, span) in elements.iter().enumerate() {
        entries.extend(read(body, span, entries.len(), element, findings));
    }
    entries
}

/// Reads one element; `None` if it is not an entry. `index`: the entry's index if it is one.
fn read(
    body: &str,
    span: &Span,
    index: usize,
    element: usize,
    findings: &mut Findings,
) -> Option<Entry> {
    let present = Present::default();
    EntryReader { body, findings, index, element, is_entry: false, present }.read(span)
}

/// Reads an item of `services`, a list or an object; `None` if it is not a service.
pub(super) fn read_service(body: &str, item: &scan::Item) -> Option<ListedService> {
    read_service_noting(body, item, &mut ServiceFaults::default())
}

/// Members of a service that are not as descan reads them, with their offsets.
#[derive(Default)]
pub(super) struct ServiceFaults {
    /// Members that occurred before.
    pub again: Vec<(&'static str, usize)>,
    /// Names of unknown members.
    unknown: Vec<(String, usize)>,
    /// Which of [`SERVICE_MEMBERS`] occur.
    seen: [bool; SERVICE_MEMBERS.len()],
}

impl ServiceFaults {
    fn report(self, findings: &mut Findings, entry: Option<usize>) {
        for (member, at) in self.again {
            findings.duplicate(member, at, entry);
        }
        for (key, at) in self.unknown {
            let members = SERVICE_MEMBERS.into_iter().zip(self.seen);
            let missing = members.filter(|(_, is_seen)| !is_seen).map(|(member, _)| member);
            findings.misspelled(&key, at, missing, entry);
        }
    }
}

/// As [`read_service`]; notes members that are not as expected.
pub(super) fn read_service_noting(
    body: &str,
    item: &scan::Item,
    faults: &mut ServiceFaults,
) -> Option<ListedService> {
    let value = &body[item.value.clone()];
    if !item.key.is_empty() {
        let name = text::from_json(&body[item.key.clone()])?.into_owned();
        return Some(ListedService { name, version: version(value)?, extra: Vec::new() });
    }
    if !value.starts_with('{') {
        return None;
    }
    let mut name = None;
    let mut service = ListedService::default();
    for member in scan::container(body, &item.value)?.items {
        let value = &body[member.value.clone()];
        let key = text::from_json(&body[member.key.clone()]).unwrap_or_default();
        match SERVICE_MEMBERS.iter().position(|known| *known == key) {
            Some(at) if std::mem::replace(&mut faults.seen[at], true) => {
                faults.again.push((SERVICE_MEMBERS[at], member.key.start));
            }
            Some(_) => {}
            None => faults.unknown.push((key.clone().into_owned(), member.key.start)),
        }
        match &*key {
            "name" => name = Some(text::from_json(value)?.into_owned()),
            "version" => service.version = version(value)?,
            "extra" if value == "null" => service.extra.clear(),
            "extra" => service.extra = strings(body, &member.value)?,
            _ => {}
        }
    }
    Some(ListedService { name: name?, ..service })
}

pub(super) fn version(value: &str) -> Option<String> {
    if value == "null" { Some(String::new()) } else { Some(text::from_json(value)?.into_owned()) }
}

fn strings(body: &str, span: &Span) -> Option<Vec<String>> {
    if !body[span.clone()].starts_with('[') {
        return None;
    }
    let string = |item: &scan::Item| Some(text::from_json(&body[item.value.clone()])?.into_owned());
    scan::container(body, span)?.items.iter().map(string).collect()
}

/// Reads one element.
struct EntryReader<'r, 'f> {
    body: &'r str,
    findings: &'r mut Findings<'f>,
    index: usize,
    element: usize,
    /// The element has a name, so findings can refer to its entry.
    is_entry: bool,
    present: Present,
}

impl EntryReader<'_, '_> {
    fn read(mut self, span: &Span) -> Option<Entry> {
        let value = &self.body[span.clone()];
        if !value.starts_with('{') {
            let message =
                format!("element {} is {}, not a device", self.element + 1, JsonKind(value));
            self.findings.add(DocumentFindingKind::NotAnEntry, span.start, message, None);
            return None;
        }
        let members = self.members(span);
        let of = |member| members.iter().find(|(found, _)| *found == member).map(|(_, at)| at);

        let name = of(Member::Name).and_then(|at| self.string(Member::Name, at));
        let bytes = of(Member::NameHex).and_then(|at| self.hex(at));
        if name.is_none() {
            let message = format!("device {} has no `name`", self.element + 1);
            self.findings.add(DocumentFindingKind::MissingName, span.start, message, self.entry());
        }
        if let (Some(name), Some(bytes)) = (&name, &bytes) {
            self.compare_names(name, bytes, of(Member::NameHex)?);
        }
        let name = bytes.or(name.map(String::into_bytes))?;
        let address = of(Member::Address);
        let is_static = of(Member::Static).is_some_and(|at| self.flag(at));
        if let Some(at) = of(Member::Static).filter(|_| is_static && address.is_none()) {
            let message = "`static` without an `address`; nothing is pinned".to_owned();
            let kind = DocumentFindingKind::StaticWithoutAddress;
            self.findings.add(kind, at.start, message, self.entry());
        }
        Some(Entry {
            name_text: crate::text::printable(&name),
            address: address.and_then(|at| self.address(at)),
            is_static,
            bus: of(Member::Bus).and_then(|at| self.string(Member::Bus, at)),
            uid: of(Member::Uid).and_then(|at| self.string(Member::Uid, at)),
            uid_position: of(Member::Uid).map(|at| self.findings.position(at.start)),
            services: of(Member::Services).and_then(|at| self.services(at)),
            has_ordered_services: of(Member::Services)
                .is_some_and(|at| self.body[at.clone()].starts_with('[')),
            name,
            position: self.findings.position(span.start),
            address_position: address.map(|at| self.findings.position(at.start)),
            index: self.index,
            element: self.element,
            present: self.present,
        })
    }

    /// Returns the last value of each known member; null counts as absent.
    fn members(&mut self, span: &Span) -> Vec<(Member, Span)> {
        let mut found: Vec<(Member, Span)> = Vec::with_capacity(Member::ALL.len());
        let (mut duplicates, mut unknown) = (Vec::new(), Vec::new());
        for item in scan::items_at(self.body, span).into_iter().flatten() {
            let Some(member) = Member::of(&self.body[item.key.clone()]) else {
                unknown.push(item.key);
                continue;
            };
            self.present.add(member);
            match found.iter_mut().find(|(earlier, _)| *earlier == member) {
                Some(earlier) => {
                    duplicates.push((member, item.key.start));
                    earlier.1 = item.value;
                }
                None => found.push((member, item.value)),
            }
        }
        found.retain(|(_, at)| &self.body[at.clone()] != "null");
        self.is_entry = found.iter().any(|(member, at)| {
            let value = &self.body[at.clone()];
            let text = text::from_json(value);
            match member {
                Member::Name => text.is_some(),
                Member::NameHex => text.and_then(|text| text::from_hex(&text)).is_some(),
                _ => false,
            }
        });
        for (member, at) in duplicates {
            self.findings.duplicate(member.key(), at, self.entry());
        }
        for key in unknown {
            let Some(name) = text::from_json(&self.body[key.clone()]) else { continue };
            let missing = Member::ALL.into_iter().filter(|member| !self.present.has(*member));
            let missing = missing.map(Member::key);
            self.findings.misspelled(&name, key.start, missing, self.entry());
        }
        found
    }

    fn entry(&self) -> Option<usize> {
        self.is_entry.then_some(self.index)
    }

    fn wrong_type(&mut self, member: Member, at: &Span, expected: &str) {
        self.wrong_type_in(&format!("`{}`", member.key()), at, expected);
    }

    /// Reports an item of `services` with a wrong type: its first wrong member, else the item.
    fn wrong_service(&mut self, number: usize, item: &scan::Item) {
        let item_text = format!("`services` item {number}");
        if !item.key.is_empty() {
            return self.wrong_type_in(&item_text, &item.value, "a version, as a string");
        }
        let is_string = |value: &str| value.starts_with('"');
        let is_object = self.body[item.value.clone()].starts_with('{');
        let members = scan::container(self.body, &item.value).filter(|_| is_object);
        for member in members.map_or_else(Vec::new, |object| object.items) {
            let key = text::from_json(&self.body[member.key.clone()]).unwrap_or_default();
            let value = &self.body[member.value.clone()];
            let is_text = matches!(&*key, "name" | "version");
            if is_text && !is_string(value) && (key == "name" || value != "null") {
                let what = format!("`{key}` in {item_text}");
                return self.wrong_type_in(&what, &member.value, "a string");
            }
        }
        let expected = "an object of `name`, `version` and `extra`, all strings";
        self.wrong_type_in(&item_text, &item.value, expected);
    }

    fn wrong_type_in(&mut self, what: &str, at: &Span, expected: &str) {
        let found = JsonKind(&self.body[at.clone()]);
        self.findings.wrong_type(what, at.start, &found, expected, self.entry());
    }

    fn string(&mut self, member: Member, at: &Span) -> Option<String> {
        let value = &self.body[at.clone()];
        let text = text::from_json(value);
        match text {
            Some(_) => {}
            None if value.starts_with('"') => {
                let message = format!("`{}` is not valid Unicode", member.key());
                self.findings.add(DocumentFindingKind::WrongType, at.start, message, self.entry());
            }
            None => self.wrong_type(member, at, "a string"),
        }
        text.map(std::borrow::Cow::into_owned)
    }

    fn hex(&mut self, at: &Span) -> Option<Vec<u8>> {
        const EXPECTED: &str = "the name's bytes in hexadecimal, as \"46454544\"";
        let value = &self.body[at.clone()];
        let bytes = text::from_json(value).and_then(|text| text::from_hex(&text));
        if bytes.is_none() && value.starts_with('"') {
            let message = format!("`name_hex` is not hexadecimal; it must be {EXPECTED}");
            self.findings.add(DocumentFindingKind::WrongType, at.start, message, self.entry());
        } else if bytes.is_none() {
            self.wrong_type(Member::NameHex, at, EXPECTED);
        }
        bytes
    }

    fn compare_names(&mut self, name: &str, bytes: &[u8], at: &Span) {
        let printable = crate::text::printable(bytes);
        if name.as_bytes() != bytes && !name.eq_ignore_ascii_case(&printable) {
            let message = format!(
                "`name_hex` is {}, but `name` is {}; `name_hex` is used",
                text::brief(bytes),
                text::brief(name.as_bytes())
            );
            self.findings.add(DocumentFindingKind::NamesDiffer, at.start, message, self.entry());
        }
    }

    fn address(&mut self, at: &Span) -> Option<u8> {
        const EXPECTED: &str = "a whole number from 1 to 127";
        let value = &self.body[at.clone()];
        if !value.starts_with(|c: char| c == '-' || c.is_ascii_digit()) {
            self.wrong_type(Member::Address, at, EXPECTED);
            return None;
        }
        let address = value.parse().ok().filter(|address| (1..=127).contains(address));
        if address.is_none() {
            let shown = text::brief(value.as_bytes());
            // JSON has several spellings of a number: 1e1, 10.0.
            let meant = value.parse().ok().filter(|it: &f64| it.fract() == 0.0);
            let message = match meant.filter(|it| (1.0..=127.0).contains(it)) {
                Some(meant) => format!("`address` is {shown}; write it in plain digits: {meant}"),
                None => format!("`address` is {shown}; it must be {EXPECTED}"),
            };
            self.findings.add(DocumentFindingKind::AddressRange, at.start, message, self.entry());
        }
        address
    }

    fn flag(&mut self, at: &Span) -> bool {
        let value = &self.body[at.clone()];
        if !matches!(value, "true" | "false") {
            self.wrong_type(Member::Static, at, "true or false");
        }
        value == "true"
    }

    fn services(&mut self, at: &Span) -> Option<Vec<ListedService>> {
        let Some(items) = scan::items_at(self.body, at) else {
            self.wrong_type(Member::Services, at, "a list, or an object of names and versions");
            return None;
        };
        let mut places = HashMap::new();
        let mut services: Vec<ListedService> = Vec::new();
        for (number, item) in (1..).zip(items) {
            // One more than the limit: the file is refused.
            if services.len() > MAX_SERVICES {
                break;
            }
            let mut faults = ServiceFaults::default();
            let service = read_service_noting(self.body, &item, &mut faults);
            faults.report(self.findings, self.entry());
            let Some(service) = service else {
                self.wrong_service(number, &item);
                continue;
            };
            if !item.key.is_empty() {
                if let Some(&place) = places.get(&service.name) {
                    let name = text::brief(service.name.as_bytes());
                    self.findings.duplicate(&name, item.key.start, self.entry());
                    services[place] = service;
                    continue;
                }
                places.insert(service.name.clone(), services.len());
            }
            services.push(service);
        }
        Some(services)
    }
}
