//! The rows of the Devices page: one per device, and one per entry of des.json without a device.
//!
//! Inputs: the buses, the file, the problems and the view. Output: rows, sorted and filtered, and
//! their counts.

use super::buses::{Bus, Buses};
use super::file::EntryPlace;
use super::file_inputs::{FileInputs, Inputs};
use super::filter::Filter;
use super::listing::other_services;
use super::problems::ProblemList;
use super::versions::count_differences;
use super::view::{Counts, FileStatus, Row, RowKey, RowState, SortBy, View};
use crate::discovery::{Device, HeartbeatStats};
use crate::document::Entry;
use crate::finding::{Finding, FindingState};
use crate::frame::BusIndex;
use crate::text::Name;
use crate::wire::id::Address;
use std::cmp::{Ordering, Reverse};
use std::collections::HashMap;

/// The rows, and what they count.
#[derive(Debug, Default)]
pub(super) struct DeviceRows {
    rows: Vec<Row>,
    /// Number of rows, whatever the filter.
    all: usize,
    counts: Counts,
}

impl DeviceRows {
    /// The rows, sorted and filtered.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Number of rows by state, whatever the filter, and of problems.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Identities of the rows.
    pub fn keys(&self) -> Vec<RowKey> {
        self.rows.iter().map(|row| row.key.clone()).collect()
    }

    /// Place of the selected row.
    pub fn selected_index(&self, view: &View) -> Option<usize> {
        view.devices.index(self.rows.iter().map(|row| &row.key))
    }

    /// Number of rows, whatever the filter.
    pub fn all(&self) -> usize {
        self.all
    }

    /// Updates the rows that match a filter; the selection stays on its device.
    pub fn refresh(
        &mut self,
        inputs: Inputs,
        problems: &ProblemList,
        filter: Option<&Filter>,
        view: &mut View,
    ) {
        let mut rows = inputs.all_rows();
        self.all = rows.len();
        self.counts = count(&rows, problems);
        rows.retain(|row| filter.is_none_or(|filter| filter.matches_row(inputs.buses, row)));
        sort(&mut rows, inputs.buses, view.device_sort.order);
        if view.device_sort.is_reversed {
            rows.reverse();
        }
        let before = std::mem::replace(&mut self.rows, rows);
        self.follow_selection(&before, inputs, view);
        let height = view.screen(inputs.buses.len()).list_rows();
        view.devices.update_keeping(&self.keys(), height);
    }

    /// Moves the selection with its device to another row of its bus and file: a listed device appears,
    /// or a lost one is removed.
    fn follow_selection(&self, before: &[Row], inputs: Inputs, view: &mut View) {
        let Some(selected) = view.devices.selected() else { return };
        if self.rows.iter().any(|row| row.key == *selected) {
            return;
        }
        let Some(old) = before.iter().find(|row| row.key == *selected) else { return };
        let file = |row: &Row| row.key.file(inputs.documents);
        let same = |row: &&Row| {
            let is_on_its_bus = old.bus.is_none_or(|bus| row.is_on(bus));
            row.name == old.name && row.name.is_some() && is_on_its_bus && file(row) == file(old)
        };
        let nearest = self.rows.iter().filter(same).min_by_key(|row| {
            let number = |row: &Row| row.address.map_or(0, |address| i16::from(address.number()));
            (number(row) - number(old)).abs()
        });
        if let Some(key) = nearest.map(|row| row.key.clone()) {
            view.devices.replace(key);
        }
    }
}

/// What the rows of a bus are made from, by address and by name: a row does not search all findings
/// and devices.
struct BusContents<'a> {
    bus: &'a Bus,
    findings: Vec<Vec<&'a Finding>>,
    /// Number of present devices.
    named: HashMap<&'a Name, usize>,
}

impl<'a> BusContents<'a> {
    fn new(bus: &'a Bus) -> Self {
        let mut findings = vec![Vec::new(); Address::all().count()];
        for finding in bus.findings() {
            for address in &finding.addresses {
                findings[address.index()].push(finding);
            }
        }
        let mut named = HashMap::new();
        for device in bus.devices().iter().filter(|device| device.is_present()) {
            if let Some(name) = &device.name {
                *named.entry(name).or_default() += 1;
            }
        }
        Self { bus, findings, named }
    }

    fn findings_about(&self, device: &Device) -> impl Iterator<Item = &'a Finding> {
        let about = |finding: &&&Finding| concerns(finding, device);
        self.findings[device.address.index()].iter().filter(about).copied()
    }

    /// Returns true if several present devices have the name of this one.
    fn has_twins(&self, device: &Device) -> bool {
        device.name.as_ref().and_then(|name| self.named.get(name)).is_some_and(|count| *count > 1)
    }
}

/// The making of rows.
impl Inputs<'_> {
    pub(super) fn all_rows(&self) -> Vec<Row> {
        let mut rows = Vec::new();
        let contents: Vec<BusContents> = self.buses.iter().map(BusContents::new).collect();
        for bus in self.buses.iter() {
            let devices = bus.devices().iter();
            // A device on redundant buses has its row on the first.
            let own = devices.filter(|it| self.buses.redundant(it.id).all(|other| other > it.id));
            rows.extend(own.flat_map(|device| {
                let row = self.merged_row(&contents, device);
                row.map(|row| self.board_rows(row, device)).unwrap_or_default()
            }));
        }
        for file in self.files() {
            for entry in file.document.entries() {
                if file.devices_of(entry).is_empty() {
                    rows.extend(file.entry_row(entry));
                }
            }
        }
        rows
    }

    /// Row of a device, merged with the same device on redundant buses.
    fn merged_row(&self, contents: &[BusContents], device: &Device) -> Option<Row> {
        let row_of = |device: &Device| {
            let bus = contents.get(usize::from(device.id.bus.0))?;
            Some(self.device_row(bus, device))
        };
        let mut row = row_of(device)?;
        for id in self.buses.redundant(device.id) {
            let Some(other) = self.buses.device(id).and_then(row_of) else { continue };
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
            row.has_findings |= other.has_findings;
            row.has_other_services |= other.has_other_services;
            row.differences = row.differences.max(other.differences);
            row.redundant_ids.push(id);
        }
        Some(row)
    }

    fn device_row(&self, contents: &BusContents, device: &Device) -> Row {
        let place = self.matching.entry_of(device.id);
        let entry = self.entry_of(device.id);
        let bus = contents.bus;
        let findings = || contents.findings_about(device);
        let confirmed =
            findings().any(|it| it.state == FindingState::Confirmed && it.key.kind.is_conflict());
        let twin = device.is_present() && contents.has_twins(device);
        let others = entry.and_then(|entry| other_services(entry, device));
        Row {
            key: RowKey::Device(device.id),
            bus: Some(device.id.bus),
            address: Some(device.address),
            name: device.name.clone(),
            state: match device.presence {
                presence if !device.is_present() => presence.into(),
                _ if bus.cannot_receive() => RowState::Unknown,
                _ if confirmed => RowState::Conflict,
                presence => presence.into(),
            },
            suspected: findings().any(|it| it.state == FindingState::Suspected),
            twin,
            redundant_ids: Vec::new(),
            file: self.file_status(device, entry),
            has_findings: place.is_some_and(|place| self.has_findings(place)),
            has_other_services: others.is_some(),
            differences: others.map_or(0, |(listed, own)| count_differences(Some(listed), own)),
            uid: device.uid,
            board: None,
            board_device: None,
            entry: place,
        }
    }

    fn file_status(&self, device: &Device, entry: Option<&Entry>) -> FileStatus {
        match entry {
            None if device.is_debug || device.name.is_none() => FileStatus::Nothing,
            None if !self.has_file(device.id.bus) => FileStatus::Nothing,
            None => FileStatus::New,
            Some(entry) => match entry.address.filter(|_| entry.is_static) {
                None => FileStatus::Listed(entry.address),
                Some(address) if address == device.address.number() => FileStatus::Agrees(address),
                Some(address) => FileStatus::Differs(address),
            },
        }
    }

    fn has_findings(&self, place: EntryPlace) -> bool {
        self.documents.get(place.file).is_some_and(|document| document.has_findings(place.index))
    }

    /// Returns true if the file of a bus exists.
    pub(super) fn has_file(&self, bus: BusIndex) -> bool {
        self.documents.is_there(self.documents.of_bus(bus))
    }
}

impl FileInputs<'_> {
    /// Row of an entry without a device; `None` where its bus is not open.
    fn entry_row(&self, entry: &Entry) -> Option<Row> {
        let mut buses = self.buses_of(entry);
        let bus = match (buses.next(), buses.next()) {
            (None, _) => return None,
            (Some((only, _)), None) => Some(only),
            (Some(_), Some(_)) => None,
        };
        let place = self.place(entry);
        let is_duplicate = self.all.matching.is_duplicate(place);
        let pending = is_duplicate || !self.is_missing(entry);
        Some(Row {
            key: RowKey::Entry(self.file, self.document.key(entry.index)),
            bus,
            address: entry.address.and_then(Address::new),
            name: Some(Name::new(&entry.name)),
            state: match pending {
                _ if is_duplicate => RowState::Duplicate,
                true => RowState::Pending,
                false => RowState::Missing,
            },
            suspected: false,
            twin: false,
            redundant_ids: Vec::new(),
            file: match entry.address {
                Some(address) if entry.is_static && pending => FileStatus::Pinned(address),
                Some(address) if entry.is_static => FileStatus::Differs(address),
                address => FileStatus::Listed(address),
            },
            has_findings: self.document.has_findings(entry.index),
            has_other_services: false,
            differences: 0,
            uid: None,
            board: None,
            board_device: None,
            entry: Some(place),
        })
    }
}

/// Counts rows and problems.
fn count(rows: &[Row], problems: &ProblemList) -> Counts {
    let with =
        |state: &dyn Fn(RowState) -> bool| rows.iter().filter(|row| state(row.state)).count();
    let problems = |state, is_muted| problems.count(state, is_muted);
    Counts {
        present: with(&|state| {
            let gone = [
                RowState::Missing,
                RowState::Pending,
                RowState::Duplicate,
                RowState::Lost,
                RowState::Unknown,
            ];
            !gone.contains(&state)
        }),
        unknown: with(&|state| state == RowState::Unknown),
        missing: with(&|state| state == RowState::Missing),
        lost: with(&|state| state == RowState::Lost),
        confirmed: problems(FindingState::Confirmed, false),
        suspected: problems(FindingState::Suspected, false),
        muted: problems(FindingState::Confirmed, true) + problems(FindingState::Suspected, true),
        ..Counts::default()
    }
}

/// Sorts rows; equal ones by bus, address and name.
fn sort(rows: &mut [Row], buses: &Buses, by: SortBy) {
    /// Sort key that puts rows without a value last.
    fn known<T: Ord>(value: Option<T>) -> impl Ord {
        (value.is_none(), value)
    }
    rows.sort_by(|a, b| {
        let seen = |row: &Row| Reverse(row.device(buses).map(|device| device.first_seen));
        let mode = |row: &Row| known(row.device(buses).and_then(|device| row.mode_of(device)));
        // Statistics of two senders mixed describe neither of them.
        let heartbeat = |row: &Row| {
            let device = row.device(buses).filter(|device| !buses.has_confirmed_conflict(device));
            device.map(|device| &device.heartbeat)
        };
        let missed = |row: &Row| known(heartbeat(row).map(|beats| Reverse(beats.missed)));
        // As shown: smaller differences would change the order for no visible reason.
        let jitter = |row: &Row| {
            let jitter = heartbeat(row).and_then(HeartbeatStats::steady_jitter);
            known(jitter.map(|jitter| Reverse((jitter.as_micros() + 500) / 1000)))
        };
        let period = |row: &Row| {
            let period = heartbeat(row).and_then(HeartbeatStats::steady_period);
            known(period.map(|period| (period.as_micros() + 5000) / 10_000))
        };
        let services = |row: &Row| row.device(buses).and_then(|device| device.services.as_ref());
        match by {
            SortBy::Address => Ordering::Equal,
            SortBy::Name => name(a).cmp(&name(b)),
            SortBy::Uid => known(a.uid).cmp(&known(b.uid)),
            SortBy::State => {
                let urgency =
                    |row: &Row| (row.state != RowState::Conflict, !row.suspected, row.state);
                urgency(a).cmp(&urgency(b))
            }
            SortBy::Mode => mode(a).cmp(&mode(b)),
            SortBy::Period => period(a).cmp(&period(b)),
            SortBy::Jitter => jitter(a).cmp(&jitter(b)),
            SortBy::Missed => missed(a).cmp(&missed(b)),
            SortBy::Versions => {
                let is_same =
                    |row: &Row| !row.device(buses).is_some_and(Device::has_changed_services);
                is_same(a).cmp(&is_same(b))
            }
            SortBy::Seen => seen(a).cmp(&seen(b)),
            SortBy::File => difference(a).cmp(&difference(b)),
            SortBy::Services => {
                let count = |row: &Row| known(services(row).map(|all| Reverse(all.len())));
                count(a).cmp(&count(b))
            }
        }
        .then_with(|| place(a).cmp(&place(b)))
    });
}

/// Sort key: name, rows without one last.
fn name(row: &Row) -> impl Ord {
    (row.name.is_none(), row.name.as_ref())
}

/// Sort key: difference from the file, missing devices first.
fn difference(row: &Row) -> u8 {
    match row.file {
        _ if row.state == RowState::Missing => 0,
        FileStatus::Differs(_) => 1,
        _ if row.has_findings || row.has_other_services => 1,
        FileStatus::New => 2,
        FileStatus::Pinned(_) => 3,
        FileStatus::Listed(_) => 4,
        FileStatus::Agrees(_) => 5,
        FileStatus::Nothing => 6,
    }
}

/// Sort key: bus, address, board, name.
fn place(row: &Row) -> impl Ord {
    (row.bus, row.address, row.board.map(|board| board.side), row.name.as_ref())
}

/// Returns true if a finding of its bus concerns this device.
pub fn concerns(finding: &Finding, device: &Device) -> bool {
    let named = |name: &Name| finding.names.is_empty() || finding.names.contains(name);
    // A board of a conflict may have a row with another name.
    let has_uid = device.uid.is_some_and(|uid| finding.uids.iter().any(|seen| seen.uid == uid));
    finding.key.bus == Some(device.id.bus)
        && finding.addresses.contains(&device.address)
        && (has_uid || device.name.as_ref().is_none_or(named))
}
