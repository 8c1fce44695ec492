//! The state that is shown, as an inventory to compare with another one.
//!
//! Inputs: buses, findings and des.json of one moment. Output: the values that `scan --json` has, so
//! that a log, its document and its screen compare equal. Does not know what differs.

use super::App;
use super::buses::Bus;
use super::file_inputs::Inputs;
use crate::discovery::{Device, DeviceService};
use crate::finding::{Finding, SeenUid};
use crate::inventory::{
    Inventory, InventoryBus, InventoryDevice, InventoryEntry, InventoryFinding, InventoryService,
};
use crate::status::{BusState, Link};
use crate::time::Duration;
use crate::wire::node::Mode;

impl App {
    /// The inventory of the moment that is shown.
    pub fn inventory(&self) -> Inventory {
        inventory_of(super::shown_inputs!(self), self.findings(), self.has_file_path())
    }
}

/// Returns the inventory of one moment. `has_path` is true if des.json was read then, also if there
/// was none.
pub(super) fn inventory_of<'a>(
    inputs: Inputs<'a>,
    findings: impl Iterator<Item = &'a Finding>,
    has_path: bool,
) -> Inventory {
    let names = inputs.buses.indexed().map(|(index, _)| inputs.buses.unique_name(index));
    let names: Vec<String> = names.collect();
    let name = |at: usize| names.get(at).cloned().unwrap_or_default();
    let buses = inputs.buses.iter().enumerate();
    let devices = buses.clone().flat_map(|(at, bus)| {
        let devices = bus.devices().iter();
        devices.map(move |device| (at, bus, device))
    });
    Inventory {
        devices: devices.map(|(at, bus, it)| device_of(inputs, name(at), bus, it)).collect(),
        findings: findings
            .map(|finding| {
                let bus = finding.key.bus.map(|bus| name(usize::from(bus.0)));
                finding_of(finding, bus)
            })
            .collect(),
        buses: buses.map(|(at, bus)| bus_of(inputs, name(at), bus)).collect(),
        is_file_known: has_path,
    }
    .normalized()
}

fn bus_of(inputs: Inputs, name: String, bus: &Bus) -> InventoryBus {
    let is_answered = !bus.status.unanswered;
    let bitrate = bus.status.bitrate.filter(|_| !bus.status.filtered && is_answered);
    let load = bitrate.map(|bitrate| bus.meter.mean_load(inputs.now, bitrate));
    let state = match bus.status.link {
        Link::Down | Link::Missing | Link::Unplugged | Link::NotCan | Link::NoKernel => "down",
        _ => bus.controller().state.name(),
    };
    InventoryBus {
        name,
        bitrate: bus.status.bitrate.map(u64::from),
        state: Some(state.to_owned()).filter(|state| state != BusState::Unknown.name()),
        frames: Some(if is_answered { bus.counters().frames } else { 0 }),
        errors: Some(bus.counters().errors),
        lost: Some(bus.lost()),
        load: load.map(|load| (load * 1000.0).round() / 1000.0),
    }
}

fn device_of(inputs: Inputs, name_of_bus: String, bus: &Bus, device: &Device) -> InventoryDevice {
    let millis = |duration: Duration| (duration.as_secs_f64() * 1e4).round() / 10.0;
    let alphabet = &bus.config().profile.uid;
    let printable = |text: String| crate::text::printable(text.as_bytes());
    let service = |service: &DeviceService| {
        let extra = service.extra.iter();
        let version = service.version.to_string();
        InventoryService {
            name: service.name.to_string(),
            version: extra.fold(version, |version, extra| format!("{version} {extra}")),
        }
    };
    let services = device.services.as_ref().filter(|_| !device.services_are_shared);
    let entry = inputs.entry_of(device.id);
    InventoryDevice {
        bus: name_of_bus,
        address: device.address.number(),
        name: device.name.as_ref().map(ToString::to_string),
        uid: device.uid.map(|uid| printable(uid.text(alphabet).to_string())),
        presence: Some(device.presence.name().to_owned()),
        mode: device.mode.map(|mode| Mode::name(mode).to_owned()),
        services: services.map(|list| list.iter().map(service).collect()),
        period_ms: device.heartbeat.period().map(millis),
        entry: entry
            .map(|entry| InventoryEntry { address: entry.address, is_static: entry.is_static }),
    }
}

fn finding_of(finding: &Finding, bus: Option<String>) -> InventoryFinding {
    InventoryFinding {
        kind: finding.key.kind.name().to_owned(),
        confidence: finding.state.name().to_owned(),
        bus,
        address: finding.key.address.map(crate::wire::id::Address::number),
        addresses: finding.addresses.iter().map(|address| address.number()).collect(),
        names: finding.names.iter().map(ToString::to_string).collect(),
        uids: finding.uids.iter().map(SeenUid::label).collect(),
        text: finding.text.clone(),
        remedy: finding.remedy.clone(),
    }
}
