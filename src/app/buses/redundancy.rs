//! Devices that are on several buses, recognised by name and UID.
//!
//! Input: the devices of all buses. Output: for each device the same device on other buses. Equal
//! services make two buses redundant, different services make them separate networks. A device
//! without a UID is not recognised: a twin has the same name.

use super::bus::Bus;
use crate::discovery::{Device, DeviceId};
use crate::text::Name;
use crate::wire::node::Uid;
use std::collections::{BTreeMap, HashMap};

/// The relation of two buses that have a device in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Redundancy {
    /// Equal services on both.
    Redundant,
    /// Different services on each.
    TwoNetworks,
    /// The services are not known on both.
    Undetermined,
}

impl Redundancy {
    /// Description for the user.
    pub const fn words(self) -> &'static str {
        match self {
            Redundancy::Redundant => "same services: redundant",
            Redundancy::TwoNetworks => "different services: separate networks",
            Redundancy::Undetermined => "services not known on both",
        }
    }
}

/// The same device on another bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RedundantDevice {
    /// The device on the other bus.
    pub id: DeviceId,
    /// Relation of the two buses.
    pub relation: Redundancy,
}

/// The devices that are on several buses.
#[derive(Clone, Debug, Default)]
pub(super) struct RedundantDevices {
    of: HashMap<DeviceId, Vec<RedundantDevice>>,
    known: BTreeMap<(DeviceId, DeviceId), Redundancy>,
}

impl RedundantDevices {
    /// Compares the devices of all buses again; returns the pairs whose relation changed, in the
    /// order of their buses.
    pub fn refresh(&mut self, buses: &[Bus]) -> Vec<(DeviceId, DeviceId, Redundancy)> {
        self.of.clear();
        if buses.len() < 2 {
            return Vec::new();
        }
        let mut groups: HashMap<(Name, Uid), Vec<&Device>> = HashMap::new();
        for bus in buses {
            for device in bus.devices().iter().filter(|device| !device.is_debug) {
                let uid = device.uid.filter(|uid| !uid.is_blank());
                let (Some(name), Some(uid)) = (&device.name, uid) else { continue };
                let group = groups.entry((name.clone(), uid)).or_default();
                // Of several on one bus: a present one, else the last seen.
                match group.last_mut().filter(|other| other.id.bus == device.id.bus) {
                    Some(other) => {
                        let weight = |it: &Device| (it.is_present(), it.last_seen);
                        if weight(device) > weight(other) {
                            *other = device;
                        }
                    }
                    None => group.push(device),
                }
            }
        }
        let mut changed = Vec::new();
        for group in groups.values().filter(|group| group.len() > 1) {
            for (at, one) in group.iter().enumerate() {
                for other in &group[at + 1..] {
                    let kinship = relation(one, other);
                    self.of
                        .entry(one.id)
                        .or_default()
                        .push(RedundantDevice { id: other.id, relation: kinship });
                    self.of
                        .entry(other.id)
                        .or_default()
                        .push(RedundantDevice { id: one.id, relation: kinship });
                    if self.known.insert((one.id, other.id), kinship) != Some(kinship) {
                        changed.push((one.id, other.id, kinship));
                    }
                }
            }
        }
        self.known.retain(|(one, other), _| {
            self.of.get(one).is_some_and(|all| all.iter().any(|it| it.id == *other))
        });
        changed.sort_by_key(|(one, other, _)| (*one, *other));
        changed
    }

    /// The same device on other buses.
    pub fn of(&self, id: DeviceId) -> &[RedundantDevice] {
        self.of.get(&id).map_or(&[], Vec::as_slice)
    }

    /// The same device on other buses, where these are redundant.
    pub fn redundant(&self, id: DeviceId) -> impl Iterator<Item = DeviceId> {
        let redundant = self.of(id).iter().filter(|it| it.relation == Redundancy::Redundant);
        redundant.map(|it| it.id)
    }
}

fn relation(one: &Device, other: &Device) -> Redundancy {
    match (&one.services, &other.services) {
        (Some(here), Some(there)) if here == there => Redundancy::Redundant,
        (Some(_), Some(_)) => Redundancy::TwoNetworks,
        _ => Redundancy::Undetermined,
    }
}
