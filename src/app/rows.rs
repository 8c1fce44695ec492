//! What a row of the Devices page is, and what belongs to it.
//!
//! How rows are built from devices and entries is in `devices`.

use super::App;
use super::buses::Bus;
use super::redundancy::RedundantDevice;
use crate::discovery::{Device, DeviceId, Presence};
use crate::document::{Entry, EntryKey};
use crate::frame::BusIndex;
use crate::text::Name;
use crate::wire::id::Address;

/// Which row: the selection holds on to this while others come and go.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RowKey {
    /// A device.
    Device(DeviceId),
    /// An entry that no device matches.
    Entry(EntryKey),
}

/// A row.
#[derive(Clone, Debug)]
pub struct Row {
    /// Which.
    pub key: RowKey,
    /// Its bus; `None` for an entry that names none while there are several.
    pub bus: Option<BusIndex>,
    /// The device's address, else the entry's.
    pub address: Option<Address>,
    /// The device's name, else the entry's.
    pub name: Option<Name>,
    /// Whether it is there.
    pub state: RowState,
    /// A suspicion is open about it.
    pub suspected: bool,
    /// Another device of this name is there.
    pub twin: bool,
    /// The same device on other buses that are redundant to this one.
    pub also: Vec<DeviceId>,
    /// What the file says of it.
    pub file: FileStatus,
    /// The place of its entry.
    pub entry: Option<usize>,
    /// Something is wrong with its entry: a value that cannot be used, or another entry that says
    /// the same.
    pub is_flawed: bool,
    /// Whether the file lists other services than it has.
    pub has_other_services: bool,
}

impl Row {
    /// Whether it is the row of that device, or one of several.
    pub fn has(&self, id: DeviceId) -> bool {
        self.key == RowKey::Device(id) || self.also.contains(&id)
    }

    /// Whether it is of that bus, or of any.
    pub(super) fn is_on(&self, bus: BusIndex) -> bool {
        self.bus.is_none_or(|own| own == bus) || self.also.iter().any(|id| id.bus == bus)
    }
}

/// The word in the STATE column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RowState {
    /// A confirmed collision at its address.
    Conflict,
    /// Listed, and not there.
    Missing,
    /// As the engine judges.
    Lost,
    /// On several redundant buses, and not there, or not to be seen, on all of them.
    Partial,
    /// It was there when its bus went down: nobody knows whether it still is.
    Unknown,
    /// As the engine judges.
    Stale,
    /// As the engine judges.
    Silent,
    /// As the engine judges.
    Asleep,
    /// Listed, and it is too early to say.
    Pending,
    /// Listed once more than it is there.
    Duplicate,
    /// As the engine judges.
    Online,
}

impl RowState {
    /// The word.
    pub const fn word(self) -> &'static str {
        match self {
            RowState::Conflict => "CONFLICT",
            RowState::Missing => "missing",
            RowState::Lost => "lost",
            RowState::Partial => "partial",
            RowState::Unknown => "unknown",
            RowState::Stale => "stale",
            RowState::Silent => "silent",
            RowState::Asleep => "asleep",
            RowState::Pending => "pending",
            RowState::Duplicate => "dup",
            RowState::Online => "online",
        }
    }
}

impl From<Presence> for RowState {
    fn from(presence: Presence) -> Self {
        match presence {
            Presence::Online => RowState::Online,
            Presence::Stale => RowState::Stale,
            Presence::Silent => RowState::Silent,
            Presence::Asleep => RowState::Asleep,
            Presence::Lost => RowState::Lost,
        }
    }
}

/// What the file says of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileStatus {
    /// There is no file, or the row is a debug device: nothing to say.
    Nothing,
    /// The device is not listed.
    New,
    /// Listed, its address not static; the last main address.
    Listed(Option<u8>),
    /// Static, and the device is there.
    Agrees(u8),
    /// Static, and the device is not there.
    Differs(u8),
    /// Static, and it is too early to say where the device is.
    Pinned(u8),
}

/// By what the rows are sorted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[allow(missing_docs)]
pub enum SortBy {
    #[default]
    Address,
    Name,
    State,
    Mode,
    Seen,
    File,
}

impl SortBy {
    /// The next one, column by column.
    #[must_use]
    pub const fn next(self) -> Self {
        match self {
            SortBy::Address => SortBy::Name,
            SortBy::Name => SortBy::State,
            SortBy::State => SortBy::Mode,
            SortBy::Mode => SortBy::Seen,
            SortBy::Seen => SortBy::File,
            SortBy::File => SortBy::Address,
        }
    }

    /// What it is, in words.
    pub const fn describe(self) -> &'static str {
        match self {
            SortBy::Address => "by address",
            SortBy::Name => "by name",
            SortBy::State => "by severity",
            SortBy::Mode => "by mode",
            SortBy::Seen => "newest first",
            SortBy::File => "by difference from the file",
        }
    }
}

/// How many devices are in which state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct Counts {
    pub here: usize,
    pub unseen: usize,
    pub missing: usize,
    pub lost: usize,
    pub confirmed: usize,
    pub suspected: usize,
    pub muted: usize,
}

impl App {
    /// The device of that identity.
    pub fn device(&self, id: DeviceId) -> Option<&Device> {
        self.buses.get(usize::from(id.bus.0))?.engine.device(id)
    }

    /// The bus of that index.
    pub fn bus(&self, index: BusIndex) -> Option<&Bus> {
        self.buses.get(usize::from(index.0))
    }

    /// The device of a row.
    pub fn device_of(&self, row: &Row) -> Option<&Device> {
        match row.key {
            RowKey::Device(id) => self.device(id),
            RowKey::Entry(_) => None,
        }
    }

    /// The devices of a row: more than one where several buses are redundant.
    pub fn devices_of<'a>(&'a self, row: &'a Row) -> impl Iterator<Item = &'a Device> {
        let also = row.also.iter().filter_map(|id| self.device(*id));
        self.device_of(row).into_iter().chain(also)
    }

    /// The same device on other buses.
    pub fn siblings(&self, id: DeviceId) -> &[RedundantDevice] {
        self.siblings.of(id)
    }

    /// The addresses of a row, on one of its buses or another; one may come twice.
    pub(super) fn addresses_of<'a>(&'a self, row: &'a Row) -> impl Iterator<Item = Address> + 'a {
        row.address.into_iter().chain(self.devices_of(row).map(|device| device.address))
    }

    /// The entry of a row.
    pub fn entry_of(&self, row: &Row) -> Option<&Entry> {
        self.file.document().entries().get(row.entry?)
    }

    /// The rows as sorted and filtered.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// The selected row.
    pub fn selected_row(&self) -> Option<&Row> {
        self.rows.get(self.selected_row_index()?)
    }

    /// The place of the selected row.
    pub fn selected_row_index(&self) -> Option<usize> {
        self.view.devices.index(self.rows.iter().map(|row| &row.key))
    }

    /// How many devices are in which state, whatever the filter shows.
    pub fn counts(&self) -> Counts {
        self.counts
    }
}
