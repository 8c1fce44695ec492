//! What the engine of a bus knows of its devices, as a plan needs it; with what a plan's file tells of
//! those that are not heard.

use crate::address_plan::{
    AddressSet, DeviceIdentity, KnownDevice, PlanBus, PlanRecord, StepEffect, UnsettledDevice,
};
use crate::app::shared_address::{has_conflict, identity_of, other_heard};
use crate::app::{App, Bus};
use crate::discovery::{Device, HeardUid, OwnAddress};
use crate::finding::{Finding, FindingKind, FindingState};
use crate::frame::BusIndex;
use crate::time::Instant;
use crate::wire::descriptor::{DescriptorField, DescriptorValue};
use crate::wire::id::Address;
use crate::wire::node::Uid;

/// Most devices of earlier plans in the file of a plan.
const MAX_UNSETTLED: usize = 512;
/// Heartbeat periods after which each device was heard, even if two of its heartbeats are lost. Chosen.
const OBSERVED_PERIODS: u32 = 3;

/// What earlier plans of a bus tell of its devices.
#[derive(Clone, Copy, Default)]
pub(super) struct PlanKnowledge<'a> {
    /// The file of the run, or that of the task.
    pub record: Option<&'a PlanRecord>,
    /// The last plan of the bus, if it is another one.
    pub earlier: Option<&'a PlanRecord>,
    /// Nothing is known of devices that are not heard: their addresses are free.
    pub forgets_absent: bool,
}

/// Returns the other address at which a board with the UID of this one is, too.
fn same_uid_at(bus: &Bus, device: &Device) -> Option<Address> {
    let is_it = |finding: &&Finding| {
        finding.key.kind == FindingKind::OneUidTwoAddresses
            && finding.state != FindingState::Cleared
            && finding.uids.iter().any(|seen| Some(seen.uid) == device.uid)
    };
    let finding = bus.findings().iter().find(is_it)?;
    finding.addresses.iter().copied().find(|address| *address != device.address)
}

fn known_device(bus: &Bus, device: &Device, now: Instant) -> KnownDevice {
    let setting = match device.descriptor.value(DescriptorField::Address) {
        Some(DescriptorValue::Address(setting)) => Some(setting),
        _ => None,
    };
    let current = bus.device_at(device.address);
    // Its heartbeats may come from elsewhere already.
    let is_here =
        |heard: HeardUid| Some(heard.uid) != device.uid || heard.address == device.address;
    let same_uid_at = same_uid_at(bus, device);
    let is_here = same_uid_at.is_some()
        || device.uid.is_none_or(Uid::is_blank)
        || bus.heard_uids().all(is_here);
    let other_heard = other_heard(bus, device, now);
    KnownDevice {
        identity: identity_of(device),
        address: device.address,
        setting,
        possible: AddressSet::default(),
        is_present: device.is_present() && is_here && current.is_some_and(|it| it.id == device.id),
        is_shared: other_heard.is_some() || has_conflict(bus, device),
        other_heard,
        same_uid_at,
        is_debug: device.is_debug,
        first_heard: device.first_seen,
        last_heard: device.last_seen,
    }
}

/// Returns a device that is not heard.
fn absent_device(identity: DeviceIdentity, address: Address, last: Instant) -> KnownDevice {
    KnownDevice {
        identity,
        address,
        setting: None,
        possible: AddressSet::default(),
        is_present: false,
        is_shared: false,
        other_heard: None,
        same_uid_at: None,
        is_debug: false,
        first_heard: last,
        last_heard: last,
    }
}

/// Boards that were heard, and have no row any more: another one is at their address.
fn boards_without_row(bus: &Bus) -> impl Iterator<Item = KnownDevice> {
    let has_no_row = |heard: &HeardUid| bus.devices().iter().all(|it| it.uid != Some(heard.uid));
    bus.heard_uids().filter(has_no_row).map(|heard| {
        let identity = DeviceIdentity { uid: Some(heard.uid), name: None };
        absent_device(identity, heard.address, heard.last)
    })
}

impl App {
    /// What is known of the devices of a bus now.
    pub(super) fn known_devices(&self, index: BusIndex, knowledge: PlanKnowledge) -> PlanBus {
        let Some(bus) = self.buses.get(index) else { return PlanBus::default() };
        let own = match bus.own_address() {
            OwnAddress::Held(own) => Some(own),
            _ => None,
        };
        // descan's own frames make no row; a device with its address would be shared.
        let now = self.clock.now();
        let known = bus.devices().iter().map(|device| known_device(bus, device, now));
        let mut devices: Vec<KnownDevice> = known.chain(boards_without_row(bus)).collect();
        let is_confirmed = |finding: &&Finding| {
            finding.key.kind.is_conflict() && finding.state == FindingState::Confirmed
        };
        let conflicts = bus.findings().iter().filter(is_confirmed);
        let conflicts: AddressSet =
            conflicts.flat_map(|finding| finding.addresses.iter().copied()).collect();
        knowledge.add_to(&mut devices);
        PlanBus { devices, own, conflicts, is_observed: self.is_observed(bus) }
    }

    /// Returns true if the bus was heard for so long that each device sent several heartbeats.
    pub fn is_observed(&self, bus: &Bus) -> bool {
        let time = bus.config().profile.heartbeat.period() * OBSERVED_PERIODS;
        bus.is_up_for(self.clock.now(), time)
    }
}

/// A device as a file tells of it.
struct RecordedState {
    device: UnsettledDevice,
    /// Its last write is not known to have arrived, or its setting is only stored.
    is_open: bool,
    /// No other device of the file looks the same.
    is_only: bool,
    /// Writes act at once: where the device is, there its setting is.
    acts_at_once: bool,
}

impl RecordedState {
    /// Returns the place of the device, if it is present; of several that look the same in a file, of
    /// that which may be at this address.
    fn place_in(&self, devices: &[KnownDevice]) -> Option<usize> {
        let (identity, possible) = (self.device.identity(), self.device.possible());
        devices.iter().position(|device| {
            device.is_present
                && identity.is_same(&device.identity)
                && (self.is_only || possible.has(device.address))
        })
    }
}

impl PlanKnowledge<'_> {
    /// What the files tell.
    fn recorded_states(self) -> Vec<RecordedState> {
        let mut all = Vec::new();
        for record in self.record.into_iter().chain(self.earlier) {
            let open = record.unsettled_devices().into_iter().map(|device| (device, true));
            let settled = record.settled_devices().into_iter().map(|device| (device, false));
            let both: Vec<_> = open.chain(settled).collect();
            let identities: Vec<_> = both.iter().map(|(device, _)| device.identity()).collect();
            let acts_at_once = record.effect == StepEffect::AtOnce.word();
            all.extend(both.into_iter().map(|(device, is_open)| {
                let identity = device.identity();
                let is_only = identities.iter().filter(|it| it.is_same(&identity)).count() == 1;
                RecordedState { device, is_open, is_only, acts_at_once }
            }));
        }
        all
    }

    /// Adds what files tell: settings that were stored and not read, and the addresses at which devices
    /// may come back that are not heard, or whose last write is not known to have arrived.
    fn add_to(self, devices: &mut Vec<KnownDevice>) {
        for state in self.recorded_states() {
            match state.place_in(devices) {
                Some(place) if state.is_open && !state.acts_at_once => {
                    add_stored(&mut devices[place], &state.device);
                }
                Some(_) => {}
                None if self.forgets_absent => {}
                None => devices.extend(absent_of(&state.device)),
            }
        }
    }

    /// The devices of which it is still not known what they have stored, for the file of a new run.
    pub fn unsettled_after(self, bus: &PlanBus, new: &PlanRecord) -> Vec<UnsettledDevice> {
        let mut all: Vec<UnsettledDevice> = new.unsettled.clone();
        for state in self.recorded_states() {
            let is_open = match state.place_in(&bus.devices) {
                Some(_) => state.is_open && !state.acts_at_once,
                None => !self.forgets_absent,
            };
            let identity = state.device.identity();
            let is_known = all.iter().any(|known| known.identity() == identity)
                || new.devices.iter().any(|own| own.identity() == identity);
            if is_open && !is_known && all.len() < MAX_UNSETTLED {
                all.push(state.device);
            }
        }
        all
    }
}

/// Adds what was written to a device, unless its setting was read.
fn add_stored(device: &mut KnownDevice, unsettled: &UnsettledDevice) {
    if device.setting.is_none() {
        match unsettled.setting() {
            Some(setting) => device.setting = Some(setting),
            None => device.possible = unsettled.possible(),
        }
    }
}

/// Returns a device that is not heard.
fn absent_of(unsettled: &UnsettledDevice) -> Option<KnownDevice> {
    let address = Address::from_bits(*unsettled.addresses.first()?);
    let possible = unsettled.possible();
    Some(KnownDevice { possible, ..absent_device(unsettled.identity(), address, Instant::ZERO) })
}
