//! What the screen of a fleet shows of a gateway, a version, a finding and a device.
//!
//! Input: a gateway of [`crate::fleet::Fleet`]. Output: counts and texts, taken once for each change of
//! the gateway. Does not know pages, filters or the selection.

use crate::finding::{FindingKind, FindingState, Grouping};
use crate::fleet::{EventCounts, FleetGateway, GatewayName, GatewayState};
use crate::inventory::{InventoryBus, InventoryDevice, InventoryFinding};
use crate::status::BusState;
use crate::time::Instant;
use crate::wire::id::Address;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Number of versions of services that are listed of a gateway at most: 127 devices have a dozen each, and most
/// share them. Each is a row of the page Versions.
pub const MAX_GATEWAY_VERSIONS: usize = 1500;

/// Counts and texts of a gateway.
#[derive(Clone, Debug, Default)]
pub struct GatewayFacts {
    /// Devices that are not lost, without debug devices.
    pub present: usize,
    /// Lost devices.
    pub lost: usize,
    /// Confirmed problems.
    pub confirmed: usize,
    /// Confirmed conflicts among them.
    pub conflicts: usize,
    /// Suspected problems.
    pub suspected: usize,
    /// Its buses.
    pub buses: Vec<InventoryBus>,
    /// Version of its descan; empty where it is not known.
    pub descan: String,
    /// Start of its program, in Unix seconds; 0 where it is not known.
    pub started: f64,
    /// Time of its last status by its own clock, in Unix seconds.
    pub status_time: Option<f64>,
    /// Its events; `None` where they are not known.
    pub events: Option<EventCounts>,
    /// Names of its devices, lost ones included.
    pub names: BTreeSet<String>,
    /// Their UIDs.
    pub uids: BTreeSet<String>,
    /// Their modes.
    pub modes: BTreeSet<String>,
    /// Its problems.
    pub problems: Vec<Arc<FleetProblem>>,
    /// Its des.json files that cannot be used, each with the error: `des.json: line 3, …`.
    pub file_errors: Vec<String>,
    /// It has more versions of services than are listed.
    pub has_more_versions: bool,
    /// Number of present devices, by name and version of a service; at most [`MAX_GATEWAY_VERSIONS`].
    services: BTreeMap<String, BTreeMap<String, usize>>,
    version_count: usize,
    /// Addresses of its devices, a bit for each.
    address_bits: u128,
}

impl GatewayFacts {
    /// Takes the facts of a gateway.
    pub fn new(name: &GatewayName, gateway: &FleetGateway) -> Self {
        let mut facts = Self { buses: gateway.buses().cloned().collect(), ..Self::default() };
        if let Some(status) = gateway.status() {
            facts.descan.clone_from(&status.descan);
            facts.started = status.started_ms as f64 / 1000.0;
            facts.status_time = status.time;
            facts.events = status.events;
            let errors = status.file_errors();
            facts.file_errors = errors.map(|(path, error)| format!("{path}: {error}")).collect();
        }
        gateway.devices().filter(|device| !is_debug(device)).for_each(|it| facts.add_device(it));
        for problem in problems_of(name, gateway) {
            facts.add_problem(problem);
        }
        facts
    }

    fn add_device(&mut self, device: &InventoryDevice) {
        if let Some(address) = Address::new(device.address) {
            self.address_bits |= 1 << address.number();
        }
        let texts = [
            (&device.name, &mut self.names),
            (&device.uid, &mut self.uids),
            (&device.mode, &mut self.modes),
        ];
        for (text, all) in texts {
            if let Some(text) = text.as_ref().filter(|it| !it.is_empty() && !all.contains(*it)) {
                all.insert(text.clone());
            }
        }
        if !device.is_present() {
            self.lost += 1;
            return;
        }
        self.present += 1;
        for service in device.services.iter().flatten() {
            if self.version_count == MAX_GATEWAY_VERSIONS
                && !self.has_service(&service.name, &service.version)
            {
                self.has_more_versions = true;
                continue;
            }
            let count = &mut self.version_count;
            change_value(&mut self.services, &service.name, |versions| {
                change_value(versions, &service.version, |devices| {
                    *count += usize::from(*devices == 0);
                    *devices += 1;
                });
            });
        }
    }

    fn add_problem(&mut self, problem: FleetProblem) {
        if problem.is_confirmed() {
            self.confirmed += 1;
            self.conflicts += usize::from(problem.is_conflict());
        } else {
            self.suspected += 1;
        }
        self.problems.push(Arc::new(problem));
    }

    /// Services of its present devices: name, version, number of devices.
    pub fn services(&self) -> impl Iterator<Item = (&str, &str, usize)> {
        self.services.iter().flat_map(|(name, versions)| {
            versions.iter().map(|(version, devices)| (name.as_str(), version.as_str(), *devices))
        })
    }

    /// Returns true if a present device has this version of a service.
    pub fn has_service(&self, name: &str, version: &str) -> bool {
        self.services.get(name).is_some_and(|versions| versions.contains_key(version))
    }

    /// Returns true if a bus of it can neither send nor receive.
    pub fn has_bus_down(&self) -> bool {
        let is_down = |state: &str| {
            [BusState::BusOff, BusState::Stopped, BusState::Down]
                .iter()
                .any(|it| it.name() == state)
        };
        self.buses.iter().any(|bus| bus.state.as_deref().is_some_and(is_down))
    }

    /// Returns true if a des.json of it cannot be used.
    pub fn has_file_error(&self) -> bool {
        !self.file_errors.is_empty()
    }

    /// Addresses of its devices.
    pub fn addresses(&self) -> impl Iterator<Item = Address> {
        let bits = self.address_bits;
        Address::all().filter(move |address| bits >> address.number() & 1 != 0)
    }
}

/// Changes the value of a key; the text is copied for a new one only.
fn change_value<V: Default>(all: &mut BTreeMap<String, V>, key: &str, change: impl FnOnce(&mut V)) {
    if let Some(value) = all.get_mut(key) {
        change(value);
    } else {
        let mut value = V::default();
        change(&mut value);
        all.insert(key.to_owned(), value);
    }
}

/// Returns true for another tool, which is not a device of the system.
pub(super) fn is_debug(device: &InventoryDevice) -> bool {
    InventoryDevice::is_debug(device.address, device.name.as_deref(), device.uid.as_deref())
}

/// Returns the problems of a gateway: its findings, of which those that an address conflict causes at one
/// address are one problem, as on its own screen.
fn problems_of(name: &GatewayName, gateway: &FleetGateway) -> Vec<FleetProblem> {
    let mut problems = Vec::new();
    let mut of_address = BTreeMap::<(String, u8), Vec<FleetProblem>>::new();
    for (bus, id, finding) in gateway.findings_by_id() {
        let problem = FleetProblem::new(name, bus, id, finding);
        match finding.address.filter(|_| problem.is_of_address()) {
            Some(address) => of_address.entry((bus.to_owned(), address)).or_default().push(problem),
            None => problems.push(problem),
        }
    }
    for mut all in of_address.into_values() {
        all.sort_by_key(|it| (!it.is_confirmed(), Reverse(it.severity())));
        let mut all = all.into_iter();
        if let Some(head) = all.next() {
            problems.push(FleetProblem { others: all.collect(), ..head });
        }
    }
    problems
}

/// A problem of a gateway: a finding, and others with the same cause.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetProblem {
    /// The gateway.
    pub gateway: GatewayName,
    /// Bus of its topic; `-` for one about des.json.
    pub bus: String,
    /// Identifier in its topic.
    pub id: String,
    /// What was published.
    pub finding: InventoryFinding,
    kind: Option<FindingKind>,
    /// Less certain or severe findings with the same cause, without others of their own.
    others: Vec<FleetProblem>,
}

impl FleetProblem {
    fn new(gateway: &GatewayName, bus: &str, id: &str, finding: &InventoryFinding) -> Self {
        let kind = FindingKind::ALL.iter().find(|kind| kind.name() == finding.kind).copied();
        let (bus, id) = (bus.to_owned(), id.to_owned());
        let (gateway, finding) = (gateway.clone(), finding.clone());
        Self { gateway, bus, id, finding, kind, others: Vec::new() }
    }

    /// Returns true if it is one problem with others about its address.
    fn is_of_address(&self) -> bool {
        self.kind.is_some_and(|kind| kind.facts().grouping == Grouping::Address)
    }

    /// Its findings, the most certain and severe one first.
    pub fn findings(&self) -> impl Iterator<Item = &InventoryFinding> {
        self.all().map(|it| &it.finding)
    }

    fn all(&self) -> impl Iterator<Item = &Self> {
        std::iter::once(self).chain(&self.others)
    }

    /// The headlines of its findings.
    pub fn headlines(&self) -> impl Iterator<Item = &str> {
        self.all().map(Self::headline)
    }

    /// Returns true if the gateway is sure of it.
    pub fn is_confirmed(&self) -> bool {
        self.finding.confidence == FindingState::Confirmed.name()
    }

    /// Returns true for two devices where one should be.
    pub fn is_conflict(&self) -> bool {
        self.kind.is_some_and(FindingKind::is_conflict)
    }

    /// What is wrong, in a few words; the name of a kind that this version of descan does not know.
    pub fn headline(&self) -> &str {
        match self.kind {
            Some(kind) => {
                let at_address = kind.facts().at_address.filter(|_| self.finding.address.is_some());
                at_address.unwrap_or(kind.facts().wording).headline
            }
            None => &self.finding.kind,
        }
    }

    /// From 0 to 100: the highest comes first.
    pub fn severity(&self) -> u8 {
        self.kind.map_or(0, FindingKind::severity)
    }

    /// Addresses that it is about.
    pub fn addresses(&self) -> impl Iterator<Item = Address> {
        let of_finding = |it: &InventoryFinding| {
            let all = it.address.iter().chain(&it.addresses).copied();
            all.filter_map(Address::new).fold(0_u128, |bits, at| bits | 1 << at.number())
        };
        let bits = self.findings().fold(0, |bits, finding| bits | of_finding(finding));
        Address::all().filter(move |address| bits >> address.number() & 1 != 0)
    }
}

/// A row of the page Gateways.
#[derive(Clone, Debug)]
pub struct GatewayRow {
    /// The gateway.
    pub name: GatewayName,
    /// Whether it publishes.
    pub state: GatewayState,
    /// Time at which its last status was received.
    pub received: Instant,
    /// The broker had it from before.
    pub is_received_late: bool,
    /// Its counts and texts.
    pub facts: Arc<GatewayFacts>,
}

impl GatewayRow {
    /// Place in the order of severity: the worst is 0.
    pub fn rank(&self) -> u8 {
        let facts = &self.facts;
        match self.state {
            GatewayState::Lost => 0,
            GatewayState::Silent => 1,
            _ if facts.conflicts > 0 => 2,
            _ if facts.confirmed > 0 || facts.has_bus_down() || facts.has_file_error() => 3,
            _ if facts.suspected > 0 || facts.lost > 0 => 4,
            GatewayState::Unknown => 5,
            GatewayState::Stopped => 6,
            GatewayState::Online => 7,
        }
    }
}

/// A row of the page Versions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VersionRow {
    /// Name of the service.
    pub service: String,
    /// Its version; empty without one.
    pub version: String,
    /// Number of present devices.
    pub devices: usize,
    /// Number of gateways with such a device.
    pub gateways: usize,
    /// Other versions of the service are in use, too.
    pub has_others: bool,
}

/// A device of the opened gateway.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetDevice {
    /// What was published.
    pub device: InventoryDevice,
    /// Its place among the devices of its address.
    pub place: usize,
    /// A confirmed conflict is about its address.
    pub is_in_conflict: bool,
    /// Another finding is about it.
    pub is_suspected: bool,
}

impl FleetDevice {
    /// Takes a device, and what the findings of its gateway say of it.
    pub(super) fn new(
        device: &InventoryDevice,
        place: usize,
        problems: &[Arc<FleetProblem>],
    ) -> Self {
        let at = |problem: &FleetProblem| {
            let is_here = problem.bus == device.bus;
            is_here && problem.addresses().any(|it| it.number() == device.address)
        };
        let of = |is_wanted: fn(&FleetProblem) -> bool| {
            problems.iter().any(|problem| is_wanted(problem) && at(problem))
        };
        // One that left before is not part of it.
        let is_part = place == 0 || device.is_present();
        Self {
            device: device.clone(),
            place,
            is_in_conflict: is_part && of(|it| it.is_confirmed() && it.is_conflict()),
            is_suspected: is_part && of(|it| !it.is_confirmed() && it.is_conflict()),
        }
    }
}
