//! Whether another device uses the address of a device, so that what is sent there may reach both.

use super::Bus;
use crate::address_plan::DeviceIdentity;
use crate::discovery::Device;
use crate::finding::{Finding, FindingKind, FindingState};
use crate::time::Instant;
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
pub fn identity_of(device: &Device) -> DeviceIdentity {
    DeviceIdentity { uid: device.uid, name: device.name.clone() }
}

/// Returns true if a finding tells of two devices at one address, now.
pub fn is_shared_address(finding: &Finding) -> bool {
    SHARED_ADDRESS.contains(&finding.key.kind) && finding.state != FindingState::Cleared
}

/// Returns when another device was heard last at the address of this one, and nowhere else since: a
/// write may reach that one. `None` if that was more than some heartbeat periods ago.
pub fn other_heard(bus: &Bus, device: &Device, now: Instant) -> Option<Instant> {
    let address = device.address;
    let has_left = |uid: Uid, last: Instant| {
        let elsewhere = |it: &Device| it.address != address && it.last_seen > last;
        let known = uid.not_blank().is_some();
        known && bus.devices().iter().any(|it| it.uid == Some(uid) && elsewhere(it))
    };
    let senders = bus.senders_at(address).into_iter();
    let mut senders: Vec<_> = senders.filter(|it| !has_left(it.uid, it.last)).collect();
    // One of them is the device: the one with its UID, else the last one.
    senders.sort_by_key(|it| (Some(it.uid) == device.uid, it.last));
    senders.pop();
    let recently = bus.config().profile.heartbeat.period() * SHARED_PERIODS;
    let identity = identity_of(device);
    let rows = bus.devices().iter().filter(|other| {
        other.id != device.id
            && other.address == address
            && now.since(other.last_seen) <= recently
            && identity.is_other(&identity_of(other))
            && !other.uid.is_some_and(|uid| has_left(uid, other.last_seen))
    });
    senders.iter().map(|it| it.last).chain(rows.map(|other| other.last_seen)).max()
}

/// Returns true if another device was heard at the address of this one, or a conflict there is at least
/// suspected.
pub fn is_shared(bus: &Bus, device: &Device, now: Instant) -> bool {
    other_heard(bus, device, now).is_some() || has_conflict(bus, device)
}

/// Returns true if a conflict is at least suspected at the address of a device.
pub fn has_conflict(bus: &Bus, device: &Device) -> bool {
    let mut conflicts = bus.findings().iter().filter(|finding| is_shared_address(finding));
    conflicts.any(|finding| finding.addresses.contains(&device.address))
}
