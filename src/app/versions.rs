//! Versions of services: what changed on a device, what differs from des.json, and a table of the
//! services of all devices.
//!
//! Inputs: devices and entries. Output: texts, with unprintable bytes escaped. Bounded by the
//! services of the devices. Does not know how they are drawn.

use super::listing::as_listed;
use super::{App, Bus};
use crate::discovery::{Device, DeviceService};
use crate::document::ListedService;
use crate::frame::BusIndex;
use crate::text::Name;
use std::collections::{BTreeSet, HashMap};
use unicode_width::UnicodeWidthStr;

/// A service of a device in the VERSIONS column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VersionNote {
    /// Text: `AUGER 2.1→2.2`, `+JAM 1.0` for a new service, `−JAM` for one that is gone, `TEMP 1.7`.
    pub text: String,
    /// True if it has changed since the device was first heard.
    pub is_changed: bool,
}

/// A service compared with the entry of des.json.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ServiceInFile {
    /// Same version, or none listed to compare with.
    Same,
    /// Not listed.
    New,
    /// Listed with this version.
    Other(String),
}

impl ServiceInFile {
    /// Compares a service with those listed in the entry; an entry without services matches all.
    pub fn of(listed: Option<&[ListedService]>, service: &DeviceService) -> Self {
        let Some(listed) = listed.filter(|listed| !listed.is_empty()) else { return Self::Same };
        let name = as_listed(&service.name);
        match listed.iter().find(|listed| listed.name == name) {
            None => Self::New,
            Some(listed) if listed.version.is_empty() => Self::Same,
            Some(listed) if listed.version == as_listed(&service.version) => Self::Same,
            Some(listed) => Self::Other(printable(&listed.version)),
        }
    }
}

/// Returns the listed services that a device does not have.
pub fn missing_services<'a>(
    listed: Option<&'a [ListedService]>,
    services: &'a [DeviceService],
) -> impl Iterator<Item = &'a ListedService> {
    let is_missing =
        |listed: &&ListedService| !services.iter().any(|own| as_listed(&own.name) == listed.name);
    listed.unwrap_or_default().iter().filter(is_missing)
}

/// Returns the number of services that differ between an entry and a device.
pub fn count_differences(listed: Option<&[ListedService]>, services: &[DeviceService]) -> usize {
    let others =
        services.iter().filter(|own| ServiceInFile::of(listed, own) != ServiceInFile::Same);
    others.count() + missing_services(listed, services).count()
}

/// Returns the version of a service when the device was first heard, or `None` where it has not
/// changed; `Some(None)`: the service was not there.
pub fn version_before(device: &Device, service: &DeviceService) -> Option<Option<String>> {
    let first = device.first_services.as_ref()?;
    match first.iter().find(|before| before.name == service.name) {
        Some(before) if before.version == service.version => None,
        Some(before) => Some(Some(before.version.to_string())),
        None => Some(None),
    }
}

/// Returns the services that were there when the device was first heard, and are no more.
pub fn removed_services(device: &Device) -> impl Iterator<Item = &DeviceService> {
    let services = device.services.as_deref();
    let first = device.first_services.iter().flatten().filter(move |_| services.is_some());
    first.filter(move |before| {
        !services.unwrap_or_default().iter().any(|now| now.name == before.name)
    })
}

/// Share of the devices of a bus from which a service is common: DES and CFG are, though one device
/// may have its services not read, or none.
const COMMON: f64 = 0.75;

/// Cells of a service in the view of services: `1.0` to `10.12→10.13≠`.
const CELL_WIDTH: std::ops::RangeInclusive<usize> = 3..=12;
/// Width of a list with the UID in the view of services.
const UID_FROM: usize = 60;

/// Returns the first cell of the services in the view of services: behind signs, address, name, and
/// where there is room the UID; with several buses behind the bus, too.
pub fn matrix_start(app: &App, width: usize) -> usize {
    let bus = if app.buses().len() > 1 { 7 } else { 0 };
    let uid = if width >= UID_FROM { 9 } else { 0 };
    3 + bus + 5 + 10 + uid
}

/// A cell of the table of services.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct VersionCell {
    /// Version, with the one before if it has changed: `2.1→2.2`; `·` for a service that the
    /// device does not have.
    pub text: String,
    /// True if it has changed, or differs from the most common version.
    pub is_changed: bool,
    /// True if it differs from des.json.
    pub differs_from_file: bool,
}

/// Services of the devices of one bus.
#[derive(Debug, Default)]
struct BusServices<'a> {
    /// Number of present devices with a list of services.
    devices: usize,
    /// Number of these that have a service.
    having: HashMap<&'a Name, usize>,
}

/// The services of all devices, in the order of their first appearance by bus and address.
#[derive(Debug, Default)]
pub struct ServiceTable<'a> {
    /// Names of the services.
    pub names: Vec<&'a Name>,
    /// Number of devices with each version of a service.
    versions: HashMap<&'a Name, HashMap<&'a Name, usize>>,
    buses: HashMap<BusIndex, BusServices<'a>>,
}

impl<'a> ServiceTable<'a> {
    /// Returns the table of the devices of the moment that is shown.
    pub fn new(app: &'a App) -> Self {
        let mut devices: Vec<&Device> = app.buses().iter().flat_map(Bus::devices).collect();
        devices.sort_by_key(|device| (device.id.bus, device.address, device.id));
        let mut table = Self::default();
        let mut known = BTreeSet::new();
        for device in devices {
            let Some(services) = &device.services else { continue };
            let own: BTreeSet<&Name> = services.iter().map(|service| &service.name).collect();
            for service in services.iter().filter(|service| own.contains(&service.name)) {
                if known.insert(&service.name) {
                    table.names.push(&service.name);
                }
                let versions = table.versions.entry(&service.name).or_default();
                *versions.entry(&service.version).or_default() += 1;
            }
            if device.is_present() {
                let bus = table.buses.entry(device.id.bus).or_default();
                bus.devices += 1;
                for name in own {
                    *bus.having.entry(name).or_default() += 1;
                }
            }
        }
        table
    }

    /// The version of a service that most devices have; `None` where no version is more common than
    /// all others.
    fn usual(&self, service: &Name) -> Option<&Name> {
        let versions = self.versions.get(service)?;
        let most = versions.values().max()?;
        let mut usual = versions.iter().filter(|(_, count)| *count == most);
        usual.next().filter(|_| usual.next().is_none()).map(|(version, _)| *version)
    }

    /// The cell of a device and a service; `listed`: services of its entry in des.json.
    pub fn cell(
        &self,
        device: Option<&Device>,
        service: &Name,
        listed: Option<&[ListedService]>,
    ) -> VersionCell {
        let services = device.and_then(|device| device.services.as_deref());
        let own = services.and_then(|all| all.iter().find(|own| own.name == *service));
        let name = as_listed(service);
        let is_listed = || listed.unwrap_or_default().iter().any(|listed| listed.name == name);
        let (Some(device), Some(own)) = (device, own) else {
            let is_missing = services.is_some() && is_listed();
            let text = if services.is_none() { "" } else { "·" };
            return VersionCell {
                text: text.to_owned(),
                is_changed: false,
                differs_from_file: is_missing,
            };
        };
        let version = if own.version.as_bytes().is_empty() {
            "–".to_owned()
        } else {
            own.version.to_string()
        };
        let before = version_before(device, own);
        let text = match &before {
            Some(Some(before)) => format!("{before}→{version}"),
            Some(None) => format!("+{version}"),
            None => version,
        };
        VersionCell {
            text,
            is_changed: before.is_some() || self.usual(service) != Some(&own.version),
            differs_from_file: ServiceInFile::of(listed, own) != ServiceInFile::Same,
        }
    }

    /// Widths of the columns of services from the number `first` on that fit a list of `width` cells
    /// behind [`matrix_start`]: each followed by a blank.
    pub fn widths(&self, app: &App, width: usize, first: usize) -> Vec<usize> {
        let mut left = width.saturating_sub(matrix_start(app, width));
        let mut widths = Vec::new();
        for service in self.names.iter().skip(first) {
            let cells = app.rows().iter().map(|row| {
                let listed = app.entry_of(row).and_then(|entry| entry.services.as_deref());
                let cell = self.cell(app.device_of(row), service, listed);
                cell.text.width() + usize::from(cell.differs_from_file)
            });
            let widest = cells.max().unwrap_or(0).max(service.to_string().width());
            let own = widest.clamp(*CELL_WIDTH.start(), *CELL_WIDTH.end());
            if own > left {
                break;
            }
            left = left.saturating_sub(own + 1);
            widths.push(own);
        }
        widths
    }

    /// Number of services from the number `first` on that fit a list of `width` cells.
    pub fn fitting(&self, app: &App, width: usize, first: usize) -> usize {
        self.widths(app, width, first).len()
    }

    /// What the VERSIONS column says of a device: first what has changed, then the services that are
    /// not common on its bus; at most `most`, and the number of further ones.
    pub fn notes(&self, device: &Device, most: usize) -> (Vec<VersionNote>, usize) {
        let mut notes = Vec::new();
        let mut count = 0;
        let mut add = |text: &dyn Fn() -> String, is_changed| {
            count += 1;
            if notes.len() < most {
                notes.push(VersionNote { text: text(), is_changed });
            }
        };
        let services = device.services.as_deref().unwrap_or_default();
        for service in services {
            let (name, version) = (&service.name, &service.version);
            match version_before(device, service) {
                None => {}
                Some(Some(before)) => add(&|| format!("{name} {before}→{version}"), true),
                Some(None) => add(&|| format!("+{name} {version}"), true),
            }
        }
        for service in removed_services(device) {
            add(&|| format!("−{}", service.name), true);
        }
        let bus = self.buses.get(&device.id.bus);
        let is_common = |name: &Name| {
            bus.is_some_and(|bus| {
                let having = bus.having.get(name).copied().unwrap_or(0);
                bus.devices > 1 && having as f64 >= COMMON * bus.devices as f64
            })
        };
        for service in services {
            if version_before(device, service).is_none() && !is_common(&service.name) {
                add(
                    &|| format!("{} {}", service.name, service.version).trim_end().to_owned(),
                    false,
                );
            }
        }
        let shown = notes.len();
        (notes, count - shown)
    }
}

/// What differs between two devices with the same name: `UID`, services and versions.
pub fn twin_differences(one: &Device, other: &Device) -> Vec<String> {
    let mut all = Vec::new();
    let (Some(own), Some(others)) = (&one.services, &other.services) else { return all };
    for service in own {
        match others.iter().find(|it| it.name == service.name) {
            None => all.push(format!("{} only here", service.name)),
            Some(it) if it.version != service.version => {
                all.push(format!("{} {}, not {}", service.name, service.version, it.version));
            }
            Some(_) => {}
        }
    }
    let only_there = others.iter().filter(|it| !own.iter().any(|own| own.name == it.name));
    all.extend(only_there.map(|it| format!("{} only there", it.name)));
    all
}

/// Returns text of des.json with unprintable characters escaped.
pub fn printable(text: &str) -> String {
    crate::text::Escaped(text.as_bytes()).to_string()
}
