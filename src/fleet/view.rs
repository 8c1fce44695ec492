//! What a viewer knows of all gateways, from their documents.
//!
//! Input: messages of any origin, by topic. Output: the gateways with their inventories, and counters of
//! what was not used. Bounded: [`MAX_GATEWAYS`], [`MAX_GATEWAY_DOCUMENTS`] for each,
//! [`MAX_DOCUMENT_BYTES`] for one document, [`MAX_GATEWAY_BYTES`] of memory for those of a gateway and
//! [`MAX_FLEET_BYTES`] for all. Does not know the connection or the screen.

use super::rejects::{FleetRejects, RejectReason};
use super::topic::{FleetTopic, GatewayName, TopicPath};
use crate::finding::FindingState;
use crate::inventory::{Inventory, InventoryBus, InventoryDevice, InventoryFinding};
use crate::text::{on_one_line, printable, shortened};
use crate::time::{Duration, Instant};
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Deserializer};
use std::collections::{BTreeMap, BTreeSet};

/// Number of gateways at most; documents of further ones are counted and not used.
pub const MAX_GATEWAYS: usize = 10_000;

/// Longest document that is read, in bytes.
pub const MAX_DOCUMENT_BYTES: usize = 64 << 10;

/// Number of buses, devices and findings of a gateway at most; further ones are counted and not used.
pub const MAX_GATEWAY_DOCUMENTS: usize = 4096;

/// Number of devices of one address that are used at most: boards that were there one after the other.
const MAX_ADDRESS_DEVICES: usize = 64;

/// Memory of all documents together, and of those of one gateway, at most, in bytes, as
/// [`memory_of`] counts it.
const MAX_FLEET_BYTES: usize = 192 << 20;
const MAX_GATEWAY_BYTES: usize = 16 << 20;

/// Longest path of a des.json, and longest error of one, in characters.
const MAX_FILE_TEXT: usize = 200;

/// Time without a status after which a gateway that is connected is silent: two and a half of its
/// periods of 30 s.
const SILENCE: Duration = Duration::from_secs(75);

/// How far the clock of a gateway may be ahead of the viewer's. The age of a status from a clock that is
/// further ahead is not known.
const MAX_CLOCK_LEAD: Duration = Duration::from_secs(10);

/// Time in which a broker that ends publishes the last wills of its gateways and closes the connections.
/// Chosen: mosquitto does so at once, with 200 gateways in some milliseconds.
const END_OF_BROKER: Duration = Duration::from_secs(2);

/// Whether a gateway publishes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum GatewayState {
    /// The broker published its last will: the connection was lost.
    Lost,
    /// It has documents, but no status.
    Unknown,
    /// It is connected, and sent no status for more than two periods.
    Silent,
    /// It was stopped.
    Stopped,
    /// It is connected.
    Online,
}

impl GatewayState {
    /// The word for it, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Lost => "lost",
            Self::Unknown => "unknown",
            Self::Silent => "silent",
            Self::Stopped => "stopped",
            Self::Online => "online",
        }
    }
}

/// The status of a gateway, as it was published.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct GatewayStatus {
    /// It is connected.
    pub online: bool,
    /// Why it is not: `lost`, `stopped`.
    #[serde(default)]
    pub reason: String,
    /// Start of the program, in Unix milliseconds.
    #[serde(default)]
    pub started_ms: u64,
    /// Time of the status by the clock of the gateway, in Unix seconds.
    #[serde(default)]
    pub time: Option<f64>,
    /// Version of the program.
    #[serde(default)]
    pub descan: String,
    /// What was observed of its events; `None` after a lost connection.
    #[serde(default)]
    pub events: Option<EventCounts>,
    /// Its des.json.
    #[serde(default, deserialize_with = "or_default")]
    file: Option<GatewayFile>,
    /// Its des.json files, if its buses have several.
    #[serde(default, deserialize_with = "or_default")]
    files: Vec<GatewayFile>,
}

/// Reads a value that only informs; one of another type is none.
fn or_default<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: DeserializeOwned + Default,
{
    let value = serde_json::Value::deserialize(deserializer)?;
    Ok(serde_json::from_value(value).unwrap_or_default())
}

impl GatewayStatus {
    /// Its des.json files that cannot be used, each with the error.
    pub fn file_errors(&self) -> impl Iterator<Item = (&str, &str)> {
        let one = self.file.iter().filter(|_| self.files.is_empty());
        let all = one.chain(&self.files);
        all.filter_map(|file| Some((file.path.as_str(), file.error.as_deref()?)))
    }

    /// The status without what could control a terminal.
    fn printable(self) -> Self {
        let shown = |text: &str| shortened(&printable(text.as_bytes()), MAX_FILE_TEXT);
        let of_file = |file: GatewayFile| GatewayFile {
            path: shown(&file.path),
            error: file.error.as_deref().map(shown),
        };
        Self {
            descan: printable(self.descan.as_bytes()),
            file: self.file.map(of_file),
            files: self.files.into_iter().map(of_file).collect(),
            ..self
        }
    }
}

/// A des.json of a gateway.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
struct GatewayFile {
    /// Its path there.
    path: String,
    /// Why it cannot be used.
    error: Option<String>,
}

/// When a document was made.
#[derive(Deserialize)]
struct DocumentTime {
    /// By the clock of the gateway, in Unix seconds.
    #[serde(default)]
    time: Option<f64>,
}

/// Counts of events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
pub struct EventCounts {
    /// Number of the last event.
    pub last: u64,
    /// Events that were dropped while the broker was away.
    pub dropped: u64,
}

/// Memory of a device at an address beside the first one there, in members of a list.
const OTHER_DEVICE_MEMBERS: usize = 6;

/// Bytes of memory that a document takes: texts as they were published, its topic, what it has without a
/// text, and what each member of its lists has.
fn memory_of(topic: &[u8], payload: &[u8], list_members: usize) -> usize {
    const DOCUMENT: usize = 256;
    const LIST_MEMBER: usize = 64;
    topic.len() + payload.len() + DOCUMENT + LIST_MEMBER * list_members
}

/// A document, and the memory that it takes.
#[derive(Clone, Debug, PartialEq)]
struct StoredDocument<T> {
    content: T,
    /// When it was made, by the clock of the gateway, in Unix seconds; `None` but for a bus.
    time: Option<f64>,
    bytes: usize,
    /// The connection by which it was last received.
    connection: u32,
}

/// The status of a gateway before its last will.
#[derive(Clone, Debug, PartialEq)]
struct StatusBeforeWill {
    /// When the last will was received.
    will_at: Instant,
    content: GatewayStatus,
    received: Instant,
    is_received_late: bool,
    is_silent: bool,
}

/// A gateway, and what it published.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FleetGateway {
    status: Option<StoredDocument<GatewayStatus>>,
    /// Time at which the status was received; of a gateway that is not connected, for the first time.
    received: Instant,
    /// The broker had it from before, and it may be older.
    is_received_late: bool,
    /// It was old, and no other one was received in time.
    is_silent: bool,
    /// The one before, if it is a last will that the broker published while this program was connected.
    before_will: Option<StatusBeforeWill>,
    /// Changes with every document.
    revision: u64,
    /// Memory of all documents.
    bytes: usize,
    buses: BTreeMap<String, StoredDocument<InventoryBus>>,
    /// By bus and address: the device that is there, then those that were.
    devices: BTreeMap<(String, u8), StoredDocument<Vec<InventoryDevice>>>,
    findings: BTreeMap<(String, String), StoredDocument<InventoryFinding>>,
}

impl FleetGateway {
    /// Its last status.
    pub fn status(&self) -> Option<&GatewayStatus> {
        self.status.as_ref().map(|status| &status.content)
    }

    /// Time at which its last status was received; of a gateway that is not connected, for the first time.
    pub fn status_received(&self) -> Instant {
        self.received
    }

    /// Returns true if that status may be older: the broker had it from before.
    pub fn is_status_received_late(&self) -> bool {
        self.is_received_late
    }

    /// Time of its last status by its clock, in Unix seconds; after a lost connection, and without a
    /// status, that of its newest document of a bus.
    pub fn last_time(&self) -> Option<f64> {
        let buses = || self.buses.values().filter_map(|bus| bus.time).reduce(f64::max);
        self.status().and_then(|status| status.time).or_else(buses)
    }

    /// A number that no other state of the gateway has or had.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Whether it publishes, at `now`.
    pub fn state(&self, now: Instant) -> GatewayState {
        match self.status() {
            None => GatewayState::Unknown,
            Some(status) if status.online => {
                let is_silent = self.is_silent || now.since(self.received) > SILENCE;
                if is_silent { GatewayState::Silent } else { GatewayState::Online }
            }
            Some(status) if status.reason == "stopped" => GatewayState::Stopped,
            Some(_) => GatewayState::Lost,
        }
    }

    /// Returns true if it is connected by a status that the broker had from before, and that was published
    /// so long ago, at `unix_time` in Unix seconds, that another one is overdue, or in the future. Clocks
    /// may differ: only a further status, or none, shows whether it is.
    fn is_status_old(&self, unix_time: f64) -> bool {
        let Some(status) = self.status().filter(|it| it.online && self.is_received_late) else {
            return false;
        };
        let is_plausible =
            |age: f64| (-MAX_CLOCK_LEAD.as_secs_f64()..=SILENCE.as_secs_f64()).contains(&age);
        !self.is_silent && status.time.is_some_and(|at| !is_plausible(unix_time - at))
    }

    /// Its buses.
    pub fn buses(&self) -> impl Iterator<Item = &InventoryBus> {
        self.buses.values().map(|bus| &bus.content)
    }

    /// Its devices, by bus and address, debug devices included.
    pub fn devices(&self) -> impl Iterator<Item = &InventoryDevice> {
        self.devices.values().flat_map(|devices| &devices.content)
    }

    /// Its open findings, each with the bus of its topic and its identifier there.
    pub fn findings_by_id(&self) -> impl Iterator<Item = (&str, &str, &InventoryFinding)> {
        self.findings.iter().map(|((bus, id), it)| (bus.as_str(), id.as_str(), &it.content))
    }

    /// Its open findings.
    pub fn findings(&self) -> impl Iterator<Item = &InventoryFinding> {
        self.findings.values().map(|finding| &finding.content)
    }

    /// What is known of its buses and devices.
    pub fn inventory(&self) -> Inventory {
        Inventory {
            buses: self.buses().cloned().collect(),
            devices: self.devices().cloned().collect(),
            findings: self.findings().cloned().collect(),
            is_file_known: self.devices().any(|device| device.entry.is_some()),
        }
        .normalized()
    }

    /// Returns true without any document.
    fn is_empty(&self) -> bool {
        self.status.is_none() && self.count() == 0
    }

    /// Number of documents besides the status; each device of an address counts.
    fn count(&self) -> usize {
        let devices: usize = self.devices.values().map(|it| it.content.len()).sum();
        self.buses.len() + devices + self.findings.len()
    }

    /// Adds up the memory of all documents.
    fn sum_of_bytes(&self) -> usize {
        let parts = self.buses.values().map(|it| it.bytes);
        let parts = parts.chain(self.devices.values().map(|it| it.bytes));
        let parts = parts.chain(self.findings.values().map(|it| it.bytes));
        parts.chain(self.status.iter().map(|it| it.bytes)).sum()
    }

    fn bytes_at(&self, path: &TopicPath) -> usize {
        let bytes = match path {
            TopicPath::Status => self.status.as_ref().map(|it| it.bytes),
            TopicPath::Bus(bus) => self.buses.get(bus).map(|it| it.bytes),
            TopicPath::Device(bus, address) => {
                self.devices.get(&(bus.clone(), *address)).map(|it| it.bytes)
            }
            TopicPath::Finding(bus, id) => {
                self.findings.get(&(bus.clone(), id.clone())).map(|it| it.bytes)
            }
            TopicPath::Event => None,
        };
        bytes.unwrap_or_default()
    }

    fn remove(&mut self, path: TopicPath) {
        match path {
            TopicPath::Status => self.status = None,
            TopicPath::Bus(bus) => drop(self.buses.remove(&bus)),
            TopicPath::Device(bus, address) => drop(self.devices.remove(&(bus, address))),
            TopicPath::Finding(bus, id) => drop(self.findings.remove(&(bus, id))),
            TopicPath::Event => {}
        }
    }

    /// The broker ended: if it published the last will at its end, the gateway is as it was before.
    fn handle_disconnected(&mut self, now: Instant) {
        let before = self.before_will.take();
        let Some(before) = before.filter(|it| now.since(it.will_at) <= END_OF_BROKER) else {
            return;
        };
        let Some(status) = &mut self.status else { return };
        status.content = before.content;
        (self.received, self.is_received_late) = (before.received, before.is_received_late);
        self.is_silent = before.is_silent;
    }

    /// Takes a document; returns the memory that it takes.
    ///
    /// # Errors
    /// It is not what its topic says, with the cause.
    fn insert(
        &mut self,
        (now, connection, is_kept): (Instant, u32, bool),
        topic: &[u8],
        path: TopicPath,
        payload: &[u8],
    ) -> Result<usize, String> {
        let mut bytes = memory_of(topic, payload, 0);
        match path {
            TopicPath::Status => {
                let content: GatewayStatus = serde_json::from_slice(payload)
                    .map_err(|error| on_one_line(&error.to_string()))?;
                bytes = memory_of(topic, payload, content.files.len());
                let content = content.printable();
                let is_will = !is_kept && !content.online && content.reason == "lost";
                let before = self.status.as_ref().filter(|it| is_will && it.content.online);
                self.before_will = before.map(|before| {
                    // Both are there for a while.
                    bytes += before.bytes;
                    StatusBeforeWill {
                        will_at: now,
                        content: before.content.clone(),
                        received: self.received,
                        is_received_late: self.is_received_late,
                        is_silent: self.is_silent,
                    }
                });
                // After another connection the broker sends it again.
                let is_again = (is_kept || !content.online) && self.status() == Some(&content);
                if !is_again {
                    (self.received, self.is_received_late) = (now, is_kept);
                    self.is_silent = false;
                }
                self.status = Some(StoredDocument { content, time: None, bytes, connection });
            }
            TopicPath::Bus(bus) => {
                let mut content = InventoryBus::parse(payload).map_err(|it| it.to_string())?;
                if content.name.is_empty() {
                    return Err("no bus".to_owned());
                }
                content.name.clone_from(&bus);
                let time = serde_json::from_slice(payload).map_or(None, |it: DocumentTime| it.time);
                self.buses.insert(bus, StoredDocument { content, time, bytes, connection });
            }
            TopicPath::Device(bus, address) => {
                let mut content =
                    InventoryDevice::parse_all(payload).map_err(|it| it.to_string())?;
                content.truncate(MAX_ADDRESS_DEVICES);
                let mut members = OTHER_DEVICE_MEMBERS * content.len().saturating_sub(1);
                for device in &mut content {
                    (device.bus, device.address) = (bus.clone(), address);
                    members += device.services.as_ref().map_or(0, Vec::len);
                }
                bytes = memory_of(topic, payload, members);
                self.devices.insert(
                    (bus, address),
                    StoredDocument { content, time: None, bytes, connection },
                );
            }
            TopicPath::Finding(bus, id) => {
                let content = InventoryFinding::parse(payload).map_err(|it| it.to_string())?;
                let open = [FindingState::Suspected, FindingState::Confirmed];
                let is_open = open.iter().any(|state| state.name() == content.confidence);
                if content.kind.is_empty() || !is_open {
                    return Err("no open finding".to_owned());
                }
                let members = content.addresses.len() + content.names.len() + content.uids.len();
                bytes = memory_of(topic, payload, members);
                self.findings
                    .insert((bus, id), StoredDocument { content, time: None, bytes, connection });
            }
            TopicPath::Event => {}
        }
        Ok(bytes)
    }
}

/// A version of a service, and where it is in use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceVersion {
    /// Name of the service.
    pub service: String,
    /// Version; empty without one.
    pub version: String,
    /// Gateways with such a device.
    pub gateways: BTreeSet<GatewayName>,
    /// Number of devices.
    pub devices: usize,
}

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub struct Fleet {
    gateways: BTreeMap<GatewayName, FleetGateway>,
    bytes: usize,
    rejects: FleetRejects,
    /// Number of the connection.
    connection: u32,
    /// Number of the last change.
    revision: u64,
}

impl Fleet {
    /// The gateways by name.
    pub fn gateways(&self) -> impl ExactSizeIterator<Item = (&GatewayName, &FleetGateway)> {
        self.gateways.iter()
    }

    /// A gateway.
    pub fn gateway(&self, name: &GatewayName) -> Option<&FleetGateway> {
        self.gateways.get(name)
    }

    /// What was not used.
    pub fn rejects(&self) -> &FleetRejects {
        &self.rejects
    }

    /// The broker is connected again: documents that were cleared meanwhile are those that it does not send
    /// again until [`Self::handle_complete`].
    pub fn handle_connected(&mut self) {
        self.connection += 1;
        self.rejects.begin_reading();
    }

    /// The connection is lost. A broker that ends publishes the last wills of its gateways before: those that
    /// it published just now say nothing of them.
    pub fn handle_disconnected(&mut self, now: Instant) {
        for gateway in self.gateways.values_mut().filter(|it| it.before_will.is_some()) {
            self.revision += 1;
            gateway.revision = self.revision;
            gateway.handle_disconnected(now);
        }
    }

    /// All documents that the broker has were received since [`Self::handle_connected`].
    pub fn handle_complete(&mut self) {
        let now = self.connection;
        for gateway in self.gateways.values_mut() {
            self.revision += 1;
            gateway.revision = self.revision;
            gateway.status = gateway.status.take().filter(|it| it.connection == now);
            gateway.buses.retain(|_, it| it.connection == now);
            gateway.devices.retain(|_, it| it.connection == now);
            gateway.findings.retain(|_, it| it.connection == now);
        }
        self.gateways.retain(|_, gateway| !gateway.is_empty());
        self.bytes = 0;
        for gateway in self.gateways.values_mut() {
            gateway.bytes = gateway.sum_of_bytes();
            self.bytes += gateway.bytes;
        }
        self.rejects.retain(now);
    }

    /// Returns the gateways that are connected only by a status that is old at `unix_time`, in Unix seconds.
    pub fn with_old_status(&self, unix_time: f64) -> impl Iterator<Item = &GatewayName> {
        let is_old = move |(_, gateway): &(_, &FleetGateway)| gateway.is_status_old(unix_time);
        self.gateways.iter().filter(is_old).map(|(name, _)| name)
    }

    /// No further status was received for a period of them: those gateways are silent.
    pub fn handle_old_statuses(&mut self, unix_time: f64) {
        for gateway in self.gateways.values_mut().filter(|it| it.is_status_old(unix_time)) {
            self.revision += 1;
            (gateway.is_silent, gateway.revision) = (true, self.revision);
        }
    }

    /// Takes a message; `is_kept` if the broker had it from before. An empty one clears the document. Events
    /// are not used.
    pub fn handle_message(&mut self, now: Instant, topic: &[u8], payload: &[u8], is_kept: bool) {
        let parsed = FleetTopic::parse(topic);
        if payload.is_empty() {
            self.rejects.remove(topic);
            return parsed.into_iter().for_each(|it| self.clear(&it.gateway, it.path));
        }
        let Some(FleetTopic { gateway, path }) = parsed else {
            return self.reject(topic, RejectReason::Foreign, "no topic of a gateway");
        };
        if path == TopicPath::Event {
            return;
        }
        let known = self.gateways.get(&gateway);
        let before = known.map_or(0, |it| it.bytes_at(&path));
        let is_new = before == 0 && path != TopicPath::Status;
        let own = known.map_or(0, |it| it.bytes);
        // What its lists take is known when it is read.
        let least = memory_of(topic, payload, 0);
        let is_object = payload.trim_ascii_start().first() == Some(&b'{');
        let excess = if known.is_none() && self.gateways.len() >= MAX_GATEWAYS {
            Some("too many gateways")
        } else if is_new && known.is_some_and(|it| it.count() >= MAX_GATEWAY_DOCUMENTS) {
            Some("too many documents")
        } else if payload.len() > MAX_DOCUMENT_BYTES {
            Some("too long")
        } else if own - before + least > MAX_GATEWAY_BYTES {
            Some("too much of one gateway")
        } else if self.bytes - before + least > MAX_FLEET_BYTES {
            Some("too much of all gateways")
        } else {
            None
        };
        if let Some(why) = excess {
            return self.reject(topic, RejectReason::Oversized, why);
        }
        // A list would be taken for the members in their order.
        if !is_object {
            return self.reject(topic, RejectReason::Malformed, "no JSON object");
        }
        let name = gateway.clone();
        let as_of = (now, self.connection, is_kept);
        let stored = self.gateways.entry(gateway).or_default();
        match stored.insert(as_of, topic, path, payload) {
            Ok(bytes) => {
                self.bytes = self.bytes - before + bytes;
                stored.bytes = stored.bytes - before + bytes;
                self.revision += 1;
                stored.revision = self.revision;
                self.rejects.remove(topic);
            }
            Err(why) => {
                let is_json = serde_json::from_slice::<IgnoredAny>(payload).is_ok();
                let what = if is_json { "" } else { "wrong JSON: " };
                self.reject(topic, RejectReason::Malformed, &format!("{what}{why}"));
                self.forget_if_empty(&name);
            }
        }
    }

    /// Notes whether an event could be read.
    pub fn note_event(&mut self, topic: &[u8], is_usable: bool) {
        if is_usable {
            self.rejects.remove(topic);
        } else {
            self.reject(topic, RejectReason::Malformed, "no event");
        }
    }

    fn reject(&mut self, topic: &[u8], reason: RejectReason, cause: &str) {
        self.rejects.add(self.connection, topic, reason, cause);
    }

    fn clear(&mut self, name: &GatewayName, path: TopicPath) {
        if let Some(gateway) = self.gateways.get_mut(name) {
            let bytes = gateway.bytes_at(&path);
            gateway.remove(path);
            gateway.bytes -= bytes;
            self.bytes -= bytes;
            self.revision += 1;
            gateway.revision = self.revision;
            self.forget_if_empty(name);
        }
    }

    /// A gateway without documents is none.
    fn forget_if_empty(&mut self, name: &GatewayName) {
        if self.gateways.get(name).is_some_and(FleetGateway::is_empty) {
            self.gateways.remove(name);
        }
    }

    /// The versions in use, by service and version, of devices that are not lost.
    pub fn versions(&self) -> Vec<ServiceVersion> {
        let mut found: BTreeMap<(&str, &str), (BTreeSet<&GatewayName>, usize)> = BTreeMap::new();
        for (name, gateway) in &self.gateways {
            for device in gateway.devices().filter(|device| device.is_present()) {
                for service in device.services.iter().flatten() {
                    let of = found.entry((&service.name, &service.version)).or_default();
                    of.0.insert(name);
                    of.1 += 1;
                }
            }
        }
        let version =
            |((service, version), (gateways, devices)): ((&str, &str), (BTreeSet<_>, _))| {
                let gateways = gateways.into_iter().cloned().collect();
                let (service, version) = (service.to_owned(), version.to_owned());
                ServiceVersion { service, version, gateways, devices }
            };
        found.into_iter().map(version).collect()
    }
}
