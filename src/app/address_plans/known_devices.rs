//! What the engine of a bus knows of its devices, as a plan needs it; with what a plan's file tells of
//! those that are not heard.

use super::goals::place_in;
use crate::address_plan::{
    AddressSet, DeviceIdentity, KnownDevice, PlanBus, PlanRecord, StepEffect,
};
use crate::app::{App, Bus};
use crate::discovery::{Device, OwnAddress};
use crate::finding::{Finding, FindingKind, FindingState};
use crate::frame::BusIndex;
use crate::time::Instant;
use crate::wire::descriptor::{AddressSetting, DescriptorField, DescriptorValue};
use crate::wire::node::Uid;

/// Conflicts of several devices at one address.
const SHARED_ADDRESS: [FindingKind; 3] = [
    FindingKind::SameNameSameAddress,
    FindingKind::OneAddressTwoNames,
    FindingKind::OneAddressTwoIdentities,
];

/// Heartbeat periods for which a device that is not heard any more may still be at its address.
const SHARED_PERIODS: u32 = 5;

/// Returns by what a device is recognised.
pub(super) fn identity_of(device: &Device) -> DeviceIdentity {
    let uid = device.uid.filter(|uid| !uid.is_blank());
    DeviceIdentity { uid, name: device.name.clone() }
}

/// Returns true if another device was heard at the address of this one within the last heartbeat
/// periods, and nowhere else since: a write may reach that one.
pub(super) fn is_heard_twice(bus: &Bus, device: &Device, now: Instant) -> bool {
    let address = device.address;
    let has_left = |uid: Uid, last: Instant| {
        let elsewhere = |it: &Device| it.address != address && it.last_seen > last;
        let known = uid.not_blank().is_some();
        known && bus.devices().iter().any(|it| it.uid == Some(uid) && elsewhere(it))
    };
    let senders = bus.senders_at(address).into_iter();
    if senders.filter(|it| !has_left(it.uid, it.last)).count() > 1 {
        return true;
    }
    let recently = bus.config().profile.heartbeat.period() * SHARED_PERIODS;
    let identity = identity_of(device);
    bus.devices().iter().any(|other| {
        other.id != device.id
            && other.address == address
            && now.since(other.last_seen) <= recently
            && identity.is_other(&identity_of(other))
            && !other.uid.is_some_and(|uid| has_left(uid, other.last_seen))
    })
}

fn known_device(bus: &Bus, device: &Device, now: Instant) -> KnownDevice {
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
        possible: AddressSet::default(),
        is_present: device.is_present() && current.is_some_and(|it| it.id == device.id),
        is_shared: shared.any(|finding| finding.addresses.contains(&device.address))
            || is_heard_twice(bus, device, now),
        is_debug: device.is_debug,
        last_heard: device.last_seen,
    }
}

impl App {
    /// What is known of the devices of a bus now. `record`: what a plan's file tells of them.
    pub(super) fn known_devices(&self, index: BusIndex, record: Option<&PlanRecord>) -> PlanBus {
        let Some(bus) = self.buses.get(index) else { return PlanBus::default() };
        let own = match bus.own_address() {
            OwnAddress::Held(own) => Some(own),
            _ => None,
        };
        // descan's own frames make no row; a device with its address would be shared.
        let now = self.clock.now();
        let known = bus.devices().iter().map(|device| known_device(bus, device, now));
        let mut devices: Vec<KnownDevice> = known.collect();
        let is_confirmed = |finding: &&Finding| {
            finding.key.kind.is_conflict() && finding.state == FindingState::Confirmed
        };
        let conflicts = bus.findings().iter().filter(is_confirmed);
        let conflicts: AddressSet =
            conflicts.flat_map(|finding| finding.addresses.iter().copied()).collect();
        if let Some(record) = record {
            add_recorded(&mut devices, record);
        }
        PlanBus { devices, own, conflicts }
    }
}

/// Adds what a file tells: settings that were stored and not read, and the addresses at which devices
/// may come back that are not heard, or whose last write is not known to have arrived.
fn add_recorded(devices: &mut Vec<KnownDevice>, record: &PlanRecord) {
    let possible = |place| record.possible_addresses(place).into_iter().collect::<AddressSet>();
    let mut heard = vec![false; record.devices.len()];
    for device in devices.iter_mut().filter(|device| device.is_present) {
        let Some(place) = place_in(record, &device.identity, device.address) else { continue };
        heard[place] = true;
        // Where writes act at once, a device is where its setting is.
        if device.setting.is_some() || record.effect == StepEffect::AtOnce.word() {
            continue;
        }
        let mut steps = record.all_steps().filter(|step| step.device == place);
        match steps.rfind(|step| step.is_begun()) {
            None => {}
            Some(last) if last.state == "stored" || last.state == "responded" => {
                device.setting = last.setting.and_then(AddressSetting::from_code);
            }
            Some(last) if last.state == "confirmed" => {}
            Some(_) => device.possible = possible(place),
        }
    }
    let absent = record.devices.iter().enumerate().filter(|(place, _)| !heard[*place]);
    devices.extend(absent.map(|(place, recorded)| KnownDevice {
        identity: recorded.identity(),
        address: recorded.place().0,
        setting: None,
        possible: possible(place),
        is_present: false,
        is_shared: false,
        is_debug: false,
        last_heard: Instant::ZERO,
    }));
}
