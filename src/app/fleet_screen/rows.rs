//! The rows of the shown page: made once for all changes until the next draw.
//!
//! Input: the fleet, the filter and the order of the page. Output: rows, the place of the selected one.
//! Does not know keys.

use super::facts::{FleetDevice, FleetProblem, GatewayFacts, GatewayRow, VersionRow, is_debug};
use super::{FleetPage, FleetScreen, FleetSort, FleetSums};
use crate::app::filter::Filter;
use crate::fleet::{FleetGateway, GatewayName, GatewayState};
use crate::time::Instant;
use std::cmp::Ordering;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Number of findings that the page Problems lists at most; the worst are listed.
pub const MAX_FLEET_PROBLEMS: usize = 5000;

/// What makes a row the same after a change.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FleetRowKey {
    /// A gateway.
    Gateway(GatewayName),
    /// A version of a service.
    Version(String, String),
    /// A finding: gateway, bus, identifier.
    Problem(GatewayName, String, String),
    /// A device of the opened gateway: bus, address, place among those of the address.
    Device(String, u8, usize),
}

/// A row of a page.
#[derive(Clone, Debug)]
pub enum FleetRow {
    /// A gateway.
    Gateway(GatewayRow),
    /// A version of a service.
    Version(VersionRow),
    /// A finding.
    Problem(Arc<FleetProblem>),
    /// A device of the opened gateway.
    Device(Box<FleetDevice>),
}

impl FleetRow {
    /// What makes it the same after a change.
    pub fn key(&self) -> FleetRowKey {
        match self {
            Self::Gateway(row) => FleetRowKey::Gateway(row.name.clone()),
            Self::Version(row) => FleetRowKey::Version(row.service.clone(), row.version.clone()),
            Self::Problem(it) => {
                FleetRowKey::Problem(it.gateway.clone(), it.bus.clone(), it.id.clone())
            }
            Self::Device(row) => {
                FleetRowKey::Device(row.device.bus.clone(), row.device.address, row.place)
            }
        }
    }

    /// Returns true if it has the key.
    fn is(&self, key: &FleetRowKey) -> bool {
        match (self, key) {
            (Self::Gateway(row), FleetRowKey::Gateway(name)) => row.name == *name,
            (Self::Version(row), FleetRowKey::Version(service, version)) => {
                row.service == *service && row.version == *version
            }
            (Self::Problem(it), FleetRowKey::Problem(gateway, bus, id)) => {
                it.gateway == *gateway && it.bus == *bus && it.id == *id
            }
            (Self::Device(row), FleetRowKey::Device(bus, address, place)) => {
                row.device.bus == *bus && row.device.address == *address && row.place == *place
            }
            _ => false,
        }
    }
}

/// A gateway as it was last looked at.
#[derive(Clone, Debug)]
pub(super) struct GatewayEntry {
    revision: u64,
    pub state: GatewayState,
    received: Instant,
    is_received_late: bool,
    pub facts: Arc<GatewayFacts>,
    /// Revision of the filter that the next value is of; `None` after a change.
    filter_revision: Option<u64>,
    is_match: bool,
}

impl GatewayEntry {
    fn new(name: &GatewayName, gateway: &FleetGateway, now: Instant) -> Self {
        Self {
            revision: gateway.revision(),
            state: gateway.state(now),
            received: gateway.status_received(),
            is_received_late: gateway.is_status_received_late(),
            facts: Arc::new(GatewayFacts::new(name, gateway)),
            filter_revision: None,
            is_match: true,
        }
    }

    pub fn row(&self, name: &GatewayName) -> GatewayRow {
        let &Self { state, received, is_received_late, .. } = self;
        let facts = Arc::clone(&self.facts);
        GatewayRow { name: name.clone(), state, received, is_received_late, facts }
    }

    /// Returns true if it passes the filter; that is found once for each change of one of them.
    fn passes(&mut self, name: &GatewayName, filter: Option<&Filter>, revision: u64) -> bool {
        if self.filter_revision != Some(revision) {
            let passes = |filter: &Filter| filter.matches_gateway(name, self.state, &self.facts);
            self.is_match = filter.is_none_or(passes);
            self.filter_revision = Some(revision);
        }
        self.is_match
    }
}

impl FleetScreen {
    /// Looks at what changed of the gateways, and makes the rows of the page.
    pub(super) fn refresh(&mut self) {
        self.is_stale = false;
        self.look_at_gateways();
        let (rows, total) = match (self.page(), &self.opened) {
            (FleetPage::Main, None) => self.gateway_rows(),
            (FleetPage::Main, Some((name, _))) => self.device_rows(&name.clone()),
            (FleetPage::Versions, _) => self.version_rows(),
            (FleetPage::Problems, _) => self.problem_rows(),
        };
        self.row_total = total;
        self.rows = rows;
        self.reselect();
    }

    /// Takes the states and facts of the gateways.
    pub(super) fn look_at_gateways(&mut self) {
        let (fleet, now) = (&self.fleet, self.now);
        let mut removed = Vec::new();
        self.entries.retain(|name, _| {
            let is_known = fleet.gateway(name).is_some();
            if !is_known {
                removed.push(name.clone());
            }
            is_known
        });
        let mut sums = FleetSums::default();
        let mut changes = Vec::new();
        for (name, gateway) in fleet.gateways() {
            let known = self.entries.get_mut(name);
            let (before, state) = (known.as_ref().map(|entry| entry.state), gateway.state(now));
            if is_event(before, state) {
                changes.push((name.clone(), state));
            }
            if let Some(entry) = known.filter(|entry| entry.revision == gateway.revision()) {
                if entry.state != state {
                    (entry.state, entry.filter_revision) = (state, None);
                }
                sums.add(entry);
            } else {
                let entry = GatewayEntry::new(name, gateway, now);
                sums.add(&entry);
                self.entries.insert(name.clone(), entry);
            }
        }
        self.sums = sums;
        // What the first reading brings did not happen now, nor what the end of the connection takes back.
        if self.is_first_reading_over && !self.is_old() {
            let time = self.options.unix_start + now.as_micros() as f64 / 1e6;
            for (name, state) in changes {
                self.events.note_state(name, time, state);
            }
            for name in removed {
                self.events.note_removed(name, time);
            }
        }
    }

    fn gateway_rows(&mut self) -> (Vec<FleetRow>, usize) {
        let list = self.all.list();
        let (filter, sort) = (&list.filter, list.sort);
        let mut rows = Vec::with_capacity(self.entries.len());
        for (name, entry) in &mut self.entries {
            if entry.passes(name, filter.active(), filter.revision) {
                rows.push(entry.row(name));
            }
        }
        // A stable sort of rows by name.
        rows.sort_by(|one, other| by_gateway(one, other, sort));
        if list.is_reversed {
            rows.reverse();
        }
        (rows.into_iter().map(FleetRow::Gateway).collect(), self.entries.len())
    }

    fn version_rows(&self) -> (Vec<FleetRow>, usize) {
        let mut found: BTreeMap<(&str, &str), (usize, usize)> = BTreeMap::new();
        for entry in self.entries_shown() {
            for (service, version, devices) in entry.facts.services() {
                let counts = found.entry((service, version)).or_default();
                counts.0 += devices;
                counts.1 += 1;
            }
        }
        let mut services: BTreeMap<&str, usize> = BTreeMap::new();
        for (service, _) in found.keys() {
            *services.entry(service).or_default() += 1;
        }
        let all = found.iter().map(|((service, version), (devices, gateways))| VersionRow {
            has_others: services.get(service).is_some_and(|count| *count > 1),
            service: (*service).to_owned(),
            version: (*version).to_owned(),
            devices: *devices,
            gateways: *gateways,
        });
        let list = self.scope().list();
        let passes = |row: &VersionRow| {
            list.filter.active().is_none_or(|filter| filter.matches_version(row))
        };
        let mut rows: Vec<VersionRow> = all.filter(passes).collect();
        rows.sort_by(|one, other| match list.sort {
            FleetSort::Devices => other.devices.cmp(&one.devices),
            FleetSort::Gateways => one.gateways.cmp(&other.gateways),
            _ => (one.service.cmp(&other.service))
                .then_with(|| by_numbers(&one.version, &other.version)),
        });
        if list.is_reversed {
            rows.reverse();
        }
        (rows.into_iter().map(FleetRow::Version).collect(), found.len())
    }

    fn problem_rows(&self) -> (Vec<FleetRow>, usize) {
        let list = self.scope().list();
        let filter = list.filter.active();
        let all = self.entries_shown().flat_map(|entry| &entry.facts.problems);
        let total = all.clone().count();
        let passes =
            |it: &&Arc<FleetProblem>| filter.is_none_or(|filter| filter.matches_finding(it));
        let mut rows: Vec<Arc<FleetProblem>> = all.filter(passes).cloned().collect();
        // A stable sort of rows by gateway.
        rows.sort_by_key(|it| match list.sort {
            FleetSort::Name => (false, Reverse(0)),
            _ => (!it.is_confirmed(), Reverse(it.severity())),
        });
        rows.truncate(MAX_FLEET_PROBLEMS);
        if list.is_reversed {
            rows.reverse();
        }
        (rows.into_iter().map(FleetRow::Problem).collect(), total)
    }

    fn device_rows(&self, name: &GatewayName) -> (Vec<FleetRow>, usize) {
        let Some((gateway, entry)) = self.fleet.gateway(name).zip(self.entries.get(name)) else {
            return (Vec::new(), 0);
        };
        let list = self.scope().list();
        let devices = gateway.devices().filter(|device| !is_debug(device));
        let mut all: Vec<FleetDevice> = Vec::new();
        for device in devices {
            let before = all
                .last()
                .filter(|it| it.device.address == device.address && it.device.bus == device.bus);
            let place = before.map_or(0, |before| before.place + 1);
            all.push(FleetDevice::new(device, place, &entry.facts.problems));
        }
        let total = all.len();
        let passes = |row: &FleetDevice| {
            list.filter.active().is_none_or(|filter| filter.matches_published_device(row))
        };
        let mut rows: Vec<FleetDevice> = all.into_iter().filter(passes).collect();
        // A stable sort of rows by bus and address.
        match list.sort {
            FleetSort::Address => {}
            FleetSort::Name => rows.sort_by(|one, other| one.device.name.cmp(&other.device.name)),
            _ => rows.sort_by_key(device_rank),
        }
        if list.is_reversed {
            rows.reverse();
        }
        let rows = rows.into_iter().map(|row| FleetRow::Device(Box::new(row)));
        (rows.collect(), total)
    }

    /// Names of the shown gateways that have a version of a service, at most `most`.
    pub fn gateways_with(&self, row: &VersionRow, most: usize) -> Vec<&str> {
        let opened = self.opened();
        let shown = self.entries.iter().filter(|(name, entry)| {
            opened.is_none_or(|it| it == *name)
                && entry.facts.has_service(&row.service, &row.version)
        });
        shown.map(|(name, _)| name.as_str()).take(most).collect()
    }

    /// The opened gateway, or all.
    fn entries_shown(&self) -> impl Iterator<Item = &GatewayEntry> + Clone {
        let opened = self.opened();
        let one = opened.and_then(|name| self.entries.get(name));
        let all = self.entries.values().filter(move |_| opened.is_none());
        one.into_iter().chain(all)
    }

    /// Keeps the selection on its row; where that is gone, on its place.
    fn reselect(&mut self) {
        let height = usize::from(self.regions().list.height);
        let key = self.scope().list().key.clone();
        let found = key.and_then(|key| self.rows.iter().position(|row| row.is(&key)));
        let count = self.rows.len();
        let before = self.scope().list().at;
        let at = found.unwrap_or(before).min(count.saturating_sub(1));
        let new_key = self.rows.get(at).map(FleetRow::key);
        let list = self.scope_mut().list_mut();
        list.at = at;
        // An empty list, as while a filter is typed, does not forget the row.
        if new_key.is_some() {
            list.key = new_key;
        }
        list.first = list.top(count, height);
    }
}

/// Returns true if the change of a gateway is an event. Silence is none: the connection of this program
/// may be the cause.
fn is_event(before: Option<GatewayState>, state: GatewayState) -> bool {
    use GatewayState as S;
    match state {
        S::Lost | S::Stopped => before != Some(state),
        S::Online => matches!(before, None | Some(S::Lost | S::Stopped | S::Unknown)),
        S::Silent | S::Unknown => false,
    }
}

fn by_gateway(one: &GatewayRow, other: &GatewayRow, sort: FleetSort) -> Ordering {
    let (a, b) = (&one.facts, &other.facts);
    match sort {
        FleetSort::Severity => one.rank().cmp(&other.rank()),
        FleetSort::Devices => b.present.cmp(&a.present),
        FleetSort::Lost => b.lost.cmp(&a.lost),
        FleetSort::Problems => (b.confirmed, b.suspected).cmp(&(a.confirmed, a.suspected)),
        FleetSort::Version => by_numbers(&a.descan, &b.descan),
        FleetSort::Name | FleetSort::Address | FleetSort::Gateways => Ordering::Equal,
    }
}

/// Devices in a conflict, suspected ones, lost ones, then the others.
fn device_rank(row: &FleetDevice) -> u8 {
    match row.device.is_present() {
        _ if row.is_in_conflict => 0,
        _ if row.is_suspected => 1,
        false => 2,
        true => 3,
    }
}

/// Compares two versions by the numbers in them: 2.9 is before 2.10.
fn by_numbers(one: &str, other: &str) -> Ordering {
    let numbers = |text: &str| -> Vec<u64> {
        let parts = text.split(|c: char| !c.is_ascii_digit());
        parts.filter_map(|part| part.parse().ok()).collect()
    };
    numbers(one).cmp(&numbers(other)).then_with(|| one.cmp(other))
}
