//! What the engine of a bus knows of its devices, as a plan needs it; with what a plan's file tells of
//! those that are not heard.

use super::PlanTask;
use super::goals::place_in;
use crate::address_plan::{AddressSet, DeviceIdentity, KnownDevice, PlanBus, PlanRecord};
use crate::app::{App, Bus};
use crate::discovery::{Device, OwnAddress};
use crate::finding::{Finding, FindingKind, FindingState};
use crate::frame::BusIndex;
use crate::wire::descriptor::{AddressSetting, DescriptorField, DescriptorValue};

/// Conflicts of several devices at one address.
const SHARED_ADDRESS: [FindingKind; 3] = [
    FindingKind::SameNameSameAddress,
    FindingKind::OneAddressTwoNames,
    FindingKind::OneAddressTwoIdentities,
];

/// Returns by what a device is recognised.
pub(super) fn identity_of(device: &Device) -> DeviceIdentity {
    let uid = device.uid.filter(|uid| !uid.is_blank());
    DeviceIdentity { uid, name: device.name.clone() }
}

fn known_device(bus: &Bus, device: &Device) -> KnownDevice {
    let is_open = |finding: &&Finding| {
        SHARED_ADDRESS.contains(&finding.key.kind) && finding.state != FindingState::Cleared
    };
    let mut shared = bus.findings().iter().filter(is_open);
    let setting = match device.descriptor.value(DescriptorField::Address) {
        Some(DescriptorValue::Address(setting)) => Some(setting),
        _ => None,
    };
    let current = bus.device_at(device.address);
    KnownDevice {
        identity: identity_of(device),
        address: device.address,
        setting,
        is_present: device.is_present() && current.is_some_and(|it| it.id == device.id),
        is_shared: shared.any(|finding| finding.addresses.contains(&device.address)),
        is_debug: device.is_debug,
        last_heard: device.last_seen,
    }
}

impl App {
    /// What is known of the devices of a bus now.
    pub(super) fn known_devices(&self, index: BusIndex, task: &PlanTask) -> PlanBus {
        let Some(bus) = self.buses.get(index) else { return PlanBus::default() };
        let own = match bus.own_address() {
            OwnAddress::Held(own) => Some(own),
            _ => None,
        };
        // descan's own frames make no row; a device with its address would be shared.
        let mut devices: Vec<KnownDevice> =
            bus.devices().iter().map(|device| known_device(bus, device)).collect();
        let is_confirmed = |finding: &&Finding| {
            finding.key.kind.is_conflict() && finding.state == FindingState::Confirmed
        };
        let conflicts = bus.findings().iter().filter(is_confirmed);
        let conflicts: AddressSet =
            conflicts.flat_map(|finding| finding.addresses.iter().copied()).collect();
        if let PlanTask::Resume(record, _) | PlanTask::TakeBack(record, _) = task {
            add_recorded(&mut devices, record);
        }
        PlanBus { devices, own, conflicts }
    }
}

/// Adds what a file tells: settings that were stored and not read, and the addresses at which devices
/// that are not heard may come back.
fn add_recorded(devices: &mut Vec<KnownDevice>, record: &PlanRecord) {
    let mut heard = vec![false; record.devices.len()];
    for device in devices.iter_mut().filter(|device| device.is_present) {
        let Some(place) = place_in(record, &device.identity, device.address) else { continue };
        heard[place] = true;
        if device.setting.is_some() {
            continue;
        }
        let steps = record.steps.iter().filter(|step| step.device == place);
        let last = steps.filter(|step| step.state != "pending").next_back();
        let stored = last.filter(|step| step.state == "stored" || step.state == "responded");
        let code = stored.and_then(|step| step.setting);
        device.setting = code.and_then(AddressSetting::from_code);
    }
    for (place, recorded) in record.devices.iter().enumerate() {
        let steps = record.steps.iter().filter(|step| step.device == place);
        let is_unclear = steps.clone().any(|step| step.state == "sent" || step.state == "failed");
        if heard[place] && !is_unclear {
            continue;
        }
        let identity = recorded.identity();
        let last_heard = crate::time::Instant::ZERO;
        devices.extend(record.possible_addresses(place).into_iter().map(|address| KnownDevice {
            identity: identity.clone(),
            address,
            setting: Some(AddressSetting::Fixed(address)),
            is_present: false,
            is_shared: false,
            is_debug: false,
            last_heard,
        }));
    }
}
