//! What is known of buses and devices at one moment, and the differences between two moments.
//!
//! Inputs: inventories, made by the app or read from a document of `descan scan --json`
//! ([`Inventory::parse`]). Output: rows of differences in a fixed order ([`compare`]). Pure. Does
//! not know frames, logs or the screen.

mod comparison;
mod difference;
mod document;
mod pairing;

pub use comparison::{InventoryComparison, PairedBus, compare};
pub use difference::{
    Difference, DifferenceKind, DifferenceSide, DifferenceSubject, DifferenceValue, UnknownPart,
};
pub use document::InventoryError;

use crate::discovery::Presence;

/// Number of bytes of the longest document that is read.
pub const MAX_DOCUMENT_BYTES: u64 = 16 << 20;

/// What is known of all buses and devices at one moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inventory {
    /// Buses; the names are unique.
    pub buses: Vec<InventoryBus>,
    /// Devices, without debug devices.
    pub devices: Vec<InventoryDevice>,
    /// Findings, cleared ones included.
    pub findings: Vec<InventoryFinding>,
    /// True if it is known which devices des.json lists; false where the file was not read.
    pub is_file_known: bool,
}

/// A bus in an inventory. `None` for what is not known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InventoryBus {
    /// Name, printable.
    pub name: String,
    /// Bit rate, in bit/s.
    pub bitrate: Option<u64>,
    /// State of the controller, as in JSON.
    pub state: Option<String>,
    /// Number of frames received.
    pub frames: Option<u64>,
    /// Number of error frames received.
    pub errors: Option<u64>,
    /// Number of frames lost on the way to descan.
    pub lost: Option<u64>,
    /// Mean bus load, 0 to 1.
    pub load: Option<f64>,
}

/// A device in an inventory. `None` for what is not known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InventoryDevice {
    /// Name of its bus.
    pub bus: String,
    /// Address.
    pub address: u8,
    /// Name, printable.
    pub name: Option<String>,
    /// UID as text, printable; empty if blank.
    pub uid: Option<String>,
    /// Presence, as in JSON.
    pub presence: Option<String>,
    /// Mode, as in JSON.
    pub mode: Option<String>,
    /// Services; `None` also for a list that is of one of several devices at the address.
    pub services: Option<Vec<InventoryService>>,
    /// Mean heartbeat period, in milliseconds.
    pub period_ms: Option<f64>,
    /// Entry of des.json; `None` if there is none, and where the file was not read.
    pub entry: Option<InventoryEntry>,
}

/// A service in an inventory.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct InventoryService {
    /// Name, printable.
    pub name: String,
    /// Version and the strings after it, printable; empty without one.
    pub version: String,
}

/// An entry of des.json in an inventory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InventoryEntry {
    /// Address in the file.
    pub address: Option<u8>,
    /// True if the address is pinned.
    pub is_static: bool,
}

/// A finding in an inventory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InventoryFinding {
    /// Kind, as in JSON.
    pub kind: String,
    /// Confidence, as in JSON.
    pub confidence: String,
    /// Name of its bus; `None` for a finding about des.json alone.
    pub bus: Option<String>,
    /// Address that it is about.
    pub address: Option<u8>,
    /// All addresses concerned.
    pub addresses: Vec<u8>,
    /// Names concerned, printable.
    pub names: Vec<String>,
    /// UIDs concerned, printable.
    pub uids: Vec<String>,
    /// What was observed, printable.
    pub text: String,
    /// What can be done, printable.
    pub remedy: String,
}

impl Inventory {
    /// Number of devices that are not lost.
    pub fn present_devices(&self) -> usize {
        self.devices.iter().filter(|device| device.is_present()).count()
    }
}

impl InventoryDevice {
    /// Returns true if the device is not lost.
    pub fn is_present(&self) -> bool {
        self.presence.as_deref() != Some(Presence::Lost.name())
    }

    /// Returns true if this is another tool, whose coming and going is not a change of the system:
    /// the debug address, or the name or UID of descan.
    pub fn is_debug(address: u8, name: Option<&str>, uid: Option<&str>) -> bool {
        const TOOL: &str = "DSCAN";
        address == 0 || name == Some(TOOL) || uid.is_some_and(|uid| uid.starts_with(TOOL))
    }

    /// The UID; `None` if it is blank or not known.
    fn known_uid(&self) -> Option<&str> {
        self.uid.as_deref().filter(|uid| !uid.trim().is_empty())
    }
}
