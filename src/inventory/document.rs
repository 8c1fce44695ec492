//! Reader of the documents of `descan scan --json` and `descan check --json`.
//!
//! Input: bytes of any origin. Output: an inventory whose texts are printable, or the place of the
//! fault. Members that a document of another version lacks are not known; members that are not
//! needed are skipped. Bounded: [`MAX_ENTRIES`] entries in a list, 128 levels. Opens no files.

use super::{
    Inventory, InventoryBus, InventoryDevice, InventoryEntry, InventoryFinding, InventoryService,
};
use crate::text::{Escaped, is_printable, on_one_line, shortened};
use serde::Deserialize;
use serde::de::{Deserializer, Error as _, IgnoredAny, SeqAccess, Visitor};
use std::marker::PhantomData;
use std::{fmt, iter, mem};

/// Largest number of entries in a list.
const MAX_ENTRIES: usize = 65_536;

/// Longest cause of an error, in characters.
const MAX_CAUSE: usize = 200;

/// Why a document cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InventoryError {
    /// Not JSON, or a member of another type. Has line and column.
    #[error("{0}")]
    Json(String),
    /// JSON, but not a document of `scan --json`: this member is missing.
    #[error("not a document of descan scan --json (no member {0:?})")]
    NotAnInventory(&'static str),
}

/// Parses JSON, whose errors have line and column.
fn json<'de, T: Deserialize<'de>>(bytes: &'de [u8]) -> Result<T, InventoryError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    serde_json::from_slice(bytes).map_err(|error| {
        let text = error.to_string();
        let (cause, _) = text.rsplit_once(" at line ").unwrap_or((&text, ""));
        let cause = on_one_line(&shortened(cause, MAX_CAUSE));
        let (line, column) = (error.line(), error.column());
        InventoryError::Json(format!("line {line}, column {column}: {cause}"))
    })
}

impl InventoryBus {
    /// Parses a member of `buses`.
    ///
    /// # Errors
    /// The bytes are none.
    pub fn parse(bytes: &[u8]) -> Result<Self, InventoryError> {
        json::<BusJson>(bytes).map(Self::from)
    }
}

impl InventoryDevice {
    /// Parses a member of `devices`.
    ///
    /// # Errors
    /// The bytes are none.
    pub fn parse(bytes: &[u8]) -> Result<Self, InventoryError> {
        json::<DeviceJson>(bytes).map(Self::from)
    }

    /// Parses a document of an address: the device there, then those in its member `others`.
    ///
    /// # Errors
    /// The bytes are none.
    pub fn parse_all(bytes: &[u8]) -> Result<Vec<Self>, InventoryError> {
        let mut first: DeviceJson = json(bytes)?;
        let others = mem::take(&mut first.others).0;
        Ok(iter::once(first).chain(others).map(Self::from).collect())
    }
}

impl InventoryFinding {
    /// Parses a member of `findings`.
    ///
    /// # Errors
    /// The bytes are none.
    pub fn parse(bytes: &[u8]) -> Result<Self, InventoryError> {
        json::<FindingJson>(bytes).map(Self::from)
    }
}

impl Inventory {
    /// Parses a document.
    ///
    /// # Errors
    /// The bytes are not such a document.
    pub fn parse(bytes: &[u8]) -> Result<Self, InventoryError> {
        let document: DocumentJson = json(bytes)?;
        if document.descan.is_none() {
            return Err(InventoryError::NotAnInventory("descan"));
        }
        let Some(List(devices)) = document.devices else {
            return Err(InventoryError::NotAnInventory("devices"));
        };
        Ok(Self {
            is_file_known: document.file.is_some_and(|file| file.ok == Some(true)),
            findings: document.findings.0.into_iter().map(InventoryFinding::from).collect(),
            devices: devices.into_iter().map(InventoryDevice::from).collect(),
            buses: document.buses.0.into_iter().map(InventoryBus::from).collect(),
        }
        .normalized())
    }

    /// Returns the inventory without debug devices, and with each bus once, those that only devices
    /// or findings name included.
    #[must_use]
    pub fn normalized(mut self) -> Self {
        self.devices.retain(|device| {
            let (name, uid) = (device.name.as_deref(), device.uid.as_deref());
            !InventoryDevice::is_debug(device.address, name, uid)
        });
        let of_findings = self.findings.iter().filter_map(|finding| finding.bus.as_ref());
        let all = self.devices.iter().map(|device| &device.bus).chain(of_findings);
        let named = |name: &String| InventoryBus { name: name.clone(), ..InventoryBus::default() };
        self.buses.extend(all.map(named));
        // A stable sort: what the document says of a bus stands before what only names it.
        self.buses.sort_by(|one, other| one.name.cmp(&other.name));
        self.buses.dedup_by(|later, first| later.name == first.name);
        self
    }
}

/// Returns a text whose characters that are not printable are escaped. Backslashes stay: names in
/// documents are escaped already.
fn printable_text(text: String) -> String {
    if text.chars().all(is_printable) {
        return text;
    }
    let mut printable = String::with_capacity(text.len());
    for c in text.chars() {
        if is_printable(c) {
            printable.push(c);
        } else {
            printable.push_str(&Escaped(c.encode_utf8(&mut [0; 4]).as_bytes()).to_string());
        }
    }
    printable
}

/// A list of at most [`MAX_ENTRIES`] entries; null reads as an empty one.
#[derive(Debug)]
struct List<T>(Vec<T>);

impl<T> Default for List<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for List<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct ListVisitor<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for ListVisitor<T> {
            type Value = List<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list")
            }

            fn visit_unit<E>(self) -> Result<List<T>, E> {
                Ok(List::default())
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> Result<List<T>, A::Error> {
                let mut list = Vec::new();
                while let Some(entry) = entries.next_element()? {
                    if list.len() == MAX_ENTRIES {
                        return Err(A::Error::custom(format!("more than {MAX_ENTRIES} entries")));
                    }
                    list.push(entry);
                }
                Ok(List(list))
            }
        }
        from.deserialize_any(ListVisitor(PhantomData))
    }
}

/// The document.
#[derive(Deserialize)]
struct DocumentJson {
    descan: Option<IgnoredAny>,
    #[serde(default)]
    buses: List<BusJson>,
    devices: Option<List<DeviceJson>>,
    #[serde(default)]
    findings: List<FindingJson>,
    file: Option<FileJson>,
}

#[derive(Deserialize)]
struct BusJson {
    #[serde(default)]
    name: String,
    bitrate: Option<u64>,
    state: Option<String>,
    frames: Option<u64>,
    errors: Option<u64>,
    lost: Option<u64>,
    load: Option<f64>,
}

#[derive(Deserialize)]
struct DeviceJson {
    #[serde(default)]
    bus: String,
    address: u8,
    name: Option<String>,
    uid: Option<String>,
    presence: Option<String>,
    mode: Option<String>,
    #[serde(default)]
    services: List<ServiceJson>,
    services_known: Option<bool>,
    services_shared: Option<bool>,
    heartbeat: Option<HeartbeatJson>,
    file: Option<EntryJson>,
    /// Further devices at the address, in a document of a fleet.
    #[serde(default)]
    others: List<DeviceJson>,
}

#[derive(Deserialize)]
struct ServiceJson {
    #[serde(default)]
    name: String,
    #[serde(default)]
    version: String,
    #[serde(default)]
    extra: List<String>,
}

#[derive(Deserialize)]
struct HeartbeatJson {
    period_ms: Option<f64>,
}

#[derive(Deserialize)]
struct EntryJson {
    listed: Option<bool>,
    address: Option<u8>,
    #[serde(rename = "static")]
    is_static: Option<bool>,
}

#[derive(Deserialize)]
struct FindingJson {
    #[serde(default)]
    kind: String,
    #[serde(default)]
    confidence: String,
    bus: Option<String>,
    address: Option<u8>,
    #[serde(default)]
    addresses: List<u8>,
    #[serde(default)]
    names: List<String>,
    #[serde(default)]
    uids: List<String>,
    #[serde(default)]
    text: String,
    #[serde(default)]
    remedy: String,
}

#[derive(Deserialize)]
struct FileJson {
    ok: Option<bool>,
}

impl From<BusJson> for InventoryBus {
    fn from(bus: BusJson) -> Self {
        Self {
            name: printable_text(bus.name),
            bitrate: bus.bitrate,
            state: bus.state.filter(|state| state != "unknown").map(printable_text),
            frames: bus.frames,
            errors: bus.errors,
            lost: bus.lost,
            load: bus.load,
        }
    }
}

impl From<DeviceJson> for InventoryDevice {
    fn from(device: DeviceJson) -> Self {
        let is_own = device.services_shared != Some(true);
        let has_services = device.services_known.unwrap_or(!device.services.0.is_empty());
        let services = device.services.0.into_iter().map(InventoryService::from).collect();
        let entry = device.file.filter(|entry| entry.listed == Some(true));
        Self {
            bus: printable_text(device.bus),
            address: device.address,
            name: device.name.map(printable_text),
            uid: device.uid.map(printable_text),
            presence: device.presence.map(printable_text),
            mode: device.mode.map(printable_text),
            services: Some(services).filter(|_| has_services && is_own),
            period_ms: device.heartbeat.and_then(|heartbeat| heartbeat.period_ms),
            entry: entry.map(|entry| InventoryEntry {
                address: entry.address,
                is_static: entry.is_static.unwrap_or_default(),
            }),
        }
    }
}

impl From<ServiceJson> for InventoryService {
    fn from(service: ServiceJson) -> Self {
        let extra = service.extra.0.into_iter();
        let version = extra.fold(service.version, |version, extra| version + " " + &extra);
        Self { name: printable_text(service.name), version: printable_text(version) }
    }
}

impl From<FindingJson> for InventoryFinding {
    fn from(finding: FindingJson) -> Self {
        let texts = |list: List<String>| list.0.into_iter().map(printable_text).collect();
        Self {
            kind: printable_text(finding.kind),
            confidence: printable_text(finding.confidence),
            bus: finding.bus.map(printable_text),
            address: finding.address,
            addresses: finding.addresses.0,
            names: texts(finding.names),
            uids: texts(finding.uids),
            text: printable_text(finding.text),
            remedy: printable_text(finding.remedy),
        }
    }
}
