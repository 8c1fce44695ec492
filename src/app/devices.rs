//! Makes the rows of the Devices page: of every device, and of every entry of des.json that has none.
//!
//! A row says which device and which entry it is, and what the two say of each other; what is
//! known of the device itself stays with its engine. Does not know how rows are drawn.

use super::App;
use super::buses::Bus;
use super::filter::Filter;
use super::matching::is_for;
use super::problem_groups::Problem;
use super::problems::other_services;
use super::rows::{Counts, FileStatus, Row, RowKey, RowState, SortBy};
use crate::discovery::{Confidence, Device, Finding};
use crate::document::Entry;
use crate::frame::BusIndex;
use crate::text::Name;
use crate::wire::id::Address;
use std::cmp::{Ordering, Reverse};

impl App {
    /// Builds the rows anew after something changed; the selection stays on its device.
    pub(super) fn refresh_rows(&mut self) {
        let mut rows = self.all_rows();
        self.counts = self.count(&rows);
        let filter = Filter::parse(self.view.filter(super::Page::Devices));
        rows.retain(|row| filter.matches_row(self, row));
        self.sort(&mut rows);
        if self.view.frozen.is_some() {
            // Rows stay where they are; what is new goes to the end.
            let old: Vec<&RowKey> = self.rows.iter().map(|row| &row.key).collect();
            rows.sort_by_cached_key(|row| {
                old.iter().position(|key| **key == row.key).unwrap_or(usize::MAX)
            });
        }
        let before = std::mem::replace(&mut self.rows, rows);
        self.follow_selection(&before);
        let height = self.screen().list_rows();
        let keys: Vec<RowKey> = self.rows.iter().map(|row| row.key.clone()).collect();
        self.view.devices.settle(&keys, height);
    }

    /// A listed device that appears, or one that is forgotten, goes on in another row: the
    /// selection goes with it.
    fn follow_selection(&mut self, before: &[Row]) {
        let Some(selected) = self.view.devices.selected() else { return };
        if self.rows.iter().any(|row| row.key == *selected) {
            return;
        }
        let Some(old) = before.iter().find(|row| row.key == *selected) else { return };
        let same = |row: &&Row| row.name == old.name && row.name.is_some();
        let nearest = self.rows.iter().filter(same).min_by_key(|row| {
            let number = |row: &Row| row.address.map_or(0, |address| i16::from(address.number()));
            (number(row) - number(old)).abs()
        });
        if let Some(key) = nearest.map(|row| row.key.clone()) {
            self.view.devices.replace(key);
        }
    }

    fn all_rows(&self) -> Vec<Row> {
        let entries = self.file.document().entries();
        let mut rows = Vec::new();
        for bus in &self.buses {
            let devices = bus.engine.devices().iter();
            // Where buses are redundant, the first has the row.
            let own =
                devices.filter(|it| self.siblings.redundant(it.id).all(|other| other > it.id));
            rows.extend(own.map(|device| self.merged_row(bus, device)));
        }
        for entry in entries {
            if self.matching.devices_of(entry.index).is_empty() {
                rows.extend(self.entry_row(entry));
            }
        }
        rows
    }

    /// The row of a device and of the same on redundant buses.
    fn merged_row(&self, bus: &Bus, device: &Device) -> Row {
        let mut row = self.device_row(bus, device);
        for id in self.siblings.redundant(device.id) {
            let (Some(bus), Some(other)) = (self.bus(id.bus), self.device(id)) else { continue };
            let other = self.device_row(bus, other);
            let here = |row: &Row| !matches!(row.state, RowState::Lost | RowState::Unknown);
            row.state = match (row.state, other.state) {
                (RowState::Conflict, _) | (_, RowState::Conflict) => RowState::Conflict,
                _ if here(&row) != here(&other) => RowState::Partial,
                (one, another) => one.min(another),
            };
            row.suspected |= other.suspected;
            row.twin |= other.twin;
            let says_more = matches!(other.file, FileStatus::Differs(_))
                || matches!(row.file, FileStatus::New | FileStatus::Nothing);
            if says_more {
                row.file = other.file;
            }
            row.entry = row.entry.or(other.entry);
            row.is_flawed |= other.is_flawed;
            row.has_other_services |= other.has_other_services;
            row.also.push(id);
        }
        row
    }

    fn device_row(&self, bus: &Bus, device: &Device) -> Row {
        let entry = self.matching.entry_of(device.id);
        let about = |finding: &&Finding| concerns(finding, device);
        let findings = || bus.engine.findings().iter().filter(about);
        let confirmed = findings()
            .any(|it| it.confidence == Confidence::Confirmed && it.key.kind.is_conflict());
        let twin = device.is_present()
            && bus.engine.devices().iter().any(|other| {
                other.id != device.id
                    && other.is_present()
                    && other.name.is_some()
                    && other.name == device.name
            });
        Row {
            key: RowKey::Device(device.id),
            bus: Some(device.id.bus),
            address: Some(device.address),
            name: device.name.clone(),
            state: match device.presence {
                presence if !device.is_present() => presence.into(),
                _ if bus.is_blind() => RowState::Unknown,
                _ if confirmed => RowState::Conflict,
                presence => presence.into(),
            },
            suspected: findings().any(|it| it.confidence == Confidence::Suspected),
            twin,
            also: Vec::new(),
            file: self.file_status(device, entry.map(|at| &self.file.document().entries()[at])),
            is_flawed: entry.is_some_and(|at| self.file.document().is_flawed(at)),
            has_other_services: entry.is_some_and(|at| {
                other_services(&self.file.document().entries()[at], device).is_some()
            }),
            entry,
        }
    }

    fn file_status(&self, device: &Device, entry: Option<&Entry>) -> FileStatus {
        match entry {
            None if device.is_debug || device.name.is_none() => FileStatus::Nothing,
            None if !self.file.is_there() => FileStatus::Nothing,
            None => FileStatus::New,
            Some(entry) => match entry.address.filter(|_| entry.is_static) {
                None => FileStatus::Listed(entry.address),
                Some(address) if address == device.address.number() => FileStatus::Agrees(address),
                Some(address) => FileStatus::Differs(address),
            },
        }
    }

    /// `None` where the entry names a bus that is not open: nothing can be said.
    fn entry_row(&self, entry: &Entry) -> Option<Row> {
        let bus = match &entry.bus {
            Some(_) => Some(self.buses.iter().position(|bus| is_for(entry, &bus.name))?),
            None if self.buses.len() == 1 => Some(0),
            None => None,
        };
        let bus = bus.map(|at| BusIndex(at as u8));
        let is_said_again = self.matching.is_duplicate(entry.index);
        let awaited = is_said_again || !self.is_missing(entry);
        Some(Row {
            key: RowKey::Entry(self.file.document().key(entry.index)),
            bus,
            address: entry.address.and_then(Address::new),
            name: Some(Name::new(&entry.name)),
            state: match awaited {
                _ if is_said_again => RowState::Duplicate,
                true => RowState::Pending,
                false => RowState::Missing,
            },
            suspected: false,
            twin: false,
            also: Vec::new(),
            file: match entry.address {
                Some(address) if entry.is_static && awaited => FileStatus::Pinned(address),
                Some(address) if entry.is_static => FileStatus::Differs(address),
                address => FileStatus::Listed(address),
            },
            is_flawed: self.file.document().is_flawed(entry.index),
            has_other_services: false,
            entry: Some(entry.index),
        })
    }

    fn count(&self, rows: &[Row]) -> Counts {
        let with =
            |state: &dyn Fn(RowState) -> bool| rows.iter().filter(|row| state(row.state)).count();
        let problems = self.problems_unsorted();
        let sure = |confidence| {
            problems.iter().filter(|it| it.counts() && it.confidence() == confidence).count()
        };
        let open = |it: &&Problem| it.is_muted && it.confidence() != Confidence::Cleared;
        Counts {
            here: with(&|state| {
                let gone = [
                    RowState::Missing,
                    RowState::Pending,
                    RowState::Duplicate,
                    RowState::Lost,
                    RowState::Unknown,
                ];
                !gone.contains(&state)
            }),
            unseen: with(&|state| state == RowState::Unknown),
            missing: with(&|state| state == RowState::Missing),
            lost: with(&|state| state == RowState::Lost),
            confirmed: sure(Confidence::Confirmed),
            suspected: sure(Confidence::Suspected),
            muted: problems.iter().filter(open).count(),
        }
    }

    fn sort(&self, rows: &mut [Row]) {
        rows.sort_by(|a, b| {
            let seen = |row: &Row| Reverse(self.device_of(row).map(|device| device.first_seen));
            let mode = |row: &Row| {
                let mode = self.device_of(row).and_then(|device| device.mode);
                (mode.is_none(), mode)
            };
            match self.view.sort {
                SortBy::Address => Ordering::Equal,
                SortBy::Name => name(a).cmp(&name(b)),
                SortBy::State => {
                    let urgency =
                        |row: &Row| (row.state != RowState::Conflict, !row.suspected, row.state);
                    urgency(a).cmp(&urgency(b))
                }
                SortBy::Mode => mode(a).cmp(&mode(b)),
                SortBy::Seen => seen(a).cmp(&seen(b)),
                SortBy::File => difference(a).cmp(&difference(b)),
            }
            .then_with(|| place(a).cmp(&place(b)))
        });
    }
}

/// By name, those without one last.
fn name(row: &Row) -> impl Ord {
    (row.name.is_none(), row.name.as_ref())
}

/// By how much the file has to do with it; what is listed and not there differs most.
fn difference(row: &Row) -> u8 {
    match row.file {
        _ if row.state == RowState::Missing => 0,
        FileStatus::Differs(_) => 1,
        _ if row.is_flawed || row.has_other_services => 1,
        FileStatus::New => 2,
        FileStatus::Pinned(_) => 3,
        FileStatus::Listed(_) => 4,
        FileStatus::Agrees(_) => 5,
        FileStatus::Nothing => 6,
    }
}

/// By where it is.
fn place(row: &Row) -> impl Ord {
    (row.bus, row.address, row.name.as_ref())
}

/// Whether a finding of its bus is about this device.
pub fn concerns(finding: &Finding, device: &Device) -> bool {
    let named = |name: &Name| finding.names.is_empty() || finding.names.contains(name);
    finding.key.bus == Some(device.id.bus)
        && finding.addresses.contains(&device.address)
        && device.name.as_ref().is_none_or(named)
}
