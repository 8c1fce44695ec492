//! Rows of the Devices page: types and sort orders.

use crate::app::buses::Buses;
use crate::app::file::{Documents, EntryPlace, FileIndex};
use crate::discovery::{AddressSender, Device, DeviceId, Presence};
use crate::document::EntryKey;
use crate::frame::BusIndex;
use crate::text::Name;
use crate::wire::id::Address;
use crate::wire::node::{Mode, Uid};
use std::sync::Arc;

/// Identity of a row, stable while other rows appear and disappear.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum RowKey {
    /// Row of a device; at a shared address that of its first board.
    Device(DeviceId),
    /// Row of a further board at the address of a device.
    Board(DeviceId, Uid),
    /// Row of an entry without a device.
    Entry(FileIndex, EntryKey),
}

impl RowKey {
    /// The file that edits of the row change: that of its bus, or of its entry.
    pub(in crate::app) fn file(&self, documents: Documents) -> FileIndex {
        match self {
            Self::Device(id) | Self::Board(id, _) => documents.of_bus(id.bus),
            Self::Entry(file, _) => *file,
        }
    }
}

/// One of several boards at an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Letter: A joined first.
    pub side: char,
    /// Its heartbeats.
    pub sender: AddressSender,
}

/// A row of the Devices page.
#[derive(Clone, Debug)]
pub struct Row {
    /// Identity.
    pub key: RowKey,
    /// Bus; `None` for an entry without a bus where there are several.
    pub bus: Option<BusIndex>,
    /// Address of the device, else of the entry.
    pub address: Option<Address>,
    /// Name of the device, else of the entry.
    pub name: Option<Name>,
    /// State, for the STATE column.
    pub state: RowState,
    /// A suspected finding concerns it.
    pub suspected: bool,
    /// Another present device on its bus has the same name.
    pub twin: bool,
    /// The same device on redundant buses.
    pub redundant_ids: Vec<DeviceId>,
    /// Relation to des.json.
    pub file: FileStatus,
    /// Place of its entry in the file.
    pub entry: Option<EntryPlace>,
    /// Its entry has an invalid value or is a duplicate.
    pub has_findings: bool,
    /// The services of its entry differ from those of the device.
    pub has_other_services: bool,
    /// Number of services that differ; 0 where only their order does.
    pub differences: usize,
    /// UID in its heartbeats.
    pub uid: Option<Uid>,
    /// The board, if several are known at its address.
    pub board: Option<Board>,
    /// What is known of the board alone, as a device.
    pub board_device: Option<Arc<Device>>,
}

impl Row {
    /// The device; `None` for the row of an entry.
    pub fn device<'b>(&self, buses: &'b Buses) -> Option<&'b Device> {
        match self.key {
            RowKey::Device(id) | RowKey::Board(id, _) => buses.device(id),
            RowKey::Entry(..) => None,
        }
    }

    /// Mode of the board, else of the device; `None` if its heartbeats carry none.
    pub fn mode_of(&self, device: &Device) -> Option<Mode> {
        self.board.map_or(device.mode, |board| board.sender.mode)
    }

    /// The devices: several where buses are redundant.
    pub fn devices<'a>(&'a self, buses: &'a Buses) -> impl Iterator<Item = &'a Device> {
        let redundant = self.redundant_ids.iter().filter_map(|id| buses.device(*id));
        self.device(buses).into_iter().chain(redundant)
    }

    /// The addresses on all of its buses; may contain duplicates.
    pub fn addresses<'a>(&'a self, buses: &'a Buses) -> impl Iterator<Item = Address> + 'a {
        self.address.into_iter().chain(self.devices(buses).map(|device| device.address))
    }

    /// Returns true if it is the row of this device on one of its buses.
    pub fn has_device(&self, id: DeviceId) -> bool {
        self.key == RowKey::Device(id) || self.redundant_ids.contains(&id)
    }

    /// Returns true if it belongs to this bus, or to no bus in particular.
    pub(in crate::app) fn is_on(&self, bus: BusIndex) -> bool {
        self.bus.is_none_or(|own| own == bus) || self.redundant_ids.iter().any(|id| id.bus == bus)
    }
}

/// State of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RowState {
    /// Confirmed address conflict.
    Conflict,
    /// Listed and not on the bus.
    Missing,
    /// Presence as the engine reports it.
    Lost,
    /// Present on some, not on all of its redundant buses.
    Partial,
    /// Present when its bus went down.
    Unknown,
    /// Presence as the engine reports it.
    Stale,
    /// Presence as the engine reports it.
    Silent,
    /// Presence as the engine reports it.
    Asleep,
    /// Listed, and the search is not complete.
    Pending,
    /// Entry that repeats another one.
    Duplicate,
    /// Presence as the engine reports it.
    Online,
}

impl RowState {
    /// Text for the STATE column.
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

/// Relation of a row to des.json.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileStatus {
    /// No file, no known name, or a debug device.
    Nothing,
    /// Device that is not in the file.
    New,
    /// Listed without a static address; the listed address.
    Listed(Option<u8>),
    /// Static address, equal to that of the device.
    Agrees(u8),
    /// Static address, different from that of the device.
    Differs(u8),
    /// Static address of an entry whose device is not known yet.
    Pinned(u8),
}

/// Sort order of one list; each list keeps its own.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sort<O> {
    /// What the rows are sorted by.
    pub order: O,
    /// The order is reversed.
    pub is_reversed: bool,
}

/// Sort order of the rows: one for each column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum SortBy {
    /// By address, ascending.
    #[default]
    Address,
    /// By name.
    Name,
    /// By UID.
    Uid,
    /// By state, the most severe first.
    State,
    /// By mode.
    Mode,
    /// By heartbeat period, the shortest first.
    Period,
    /// By jitter, the largest first.
    Jitter,
    /// By missed heartbeats, the most first.
    Missed,
    /// Changed versions first.
    Versions,
    /// By the difference from the file.
    File,
    /// By the time of the first frame, newest first.
    Seen,
    /// By the number of services, the most first.
    Services,
}

impl SortBy {
    /// All orders, in the order of the columns.
    pub const ALL: [SortBy; 12] = [
        SortBy::Address,
        SortBy::Name,
        SortBy::Uid,
        SortBy::State,
        SortBy::Mode,
        SortBy::Period,
        SortBy::Jitter,
        SortBy::Missed,
        SortBy::Versions,
        SortBy::File,
        SortBy::Seen,
        SortBy::Services,
    ];

    /// Next sort order, column by column.
    #[must_use]
    pub const fn next(self) -> Self {
        Self::ALL[(self as usize + 1) % Self::ALL.len()]
    }

    /// Text for the message.
    pub const fn describe(self) -> &'static str {
        match self {
            SortBy::Address => "by address",
            SortBy::Name => "by name",
            SortBy::Uid => "by UID",
            SortBy::State => "by severity",
            SortBy::Mode => "by mode",
            SortBy::Period => "shortest heartbeat period first",
            SortBy::Jitter => "largest jitter first",
            SortBy::Missed => "most missed heartbeats first",
            SortBy::Versions => "changed versions first",
            SortBy::File => "by difference from the file",
            SortBy::Seen => "newest first",
            SortBy::Services => "most services first",
        }
    }
}

/// Number of rows and of problems, each by state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Rows of present devices.
    pub present: usize,
    /// Rows of devices whose bus went down.
    pub unknown: usize,
    /// Rows of listed devices that are not on the bus.
    pub missing: usize,
    /// Rows of lost devices.
    pub lost: usize,
    /// Confirmed problems, not muted.
    pub confirmed: usize,
    /// Suspected problems, not muted.
    pub suspected: usize,
    /// Muted problems.
    pub muted: usize,
    /// True if des.json cannot be used.
    pub is_file_broken: bool,
}
