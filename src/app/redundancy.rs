//! Devices that are on several buses at once, recognised by name and UID. With equal services on
//! each the buses are redundant; with different ones they are two networks.
//!
//! A device without a UID is not recognised: its name alone may be a twin's.

use super::App;
use super::buses::Bus;
use super::timeline::{TimelineEntry, TimelineKind};
use crate::discovery::{Device, DeviceId};
use crate::text::Name;
use crate::wire::node::Uid;
use std::collections::{BTreeMap, HashMap};

/// What the same device on two buses makes of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Redundancy {
    /// The same services on both: either bus will do.
    Redundant,
    /// Different services.
    TwoNetworks,
    /// Its services are not known on both.
    Open,
}

impl Redundancy {
    /// What it is, for people.
    pub const fn words(self) -> &'static str {
        match self {
            Redundancy::Redundant => "same services: redundant",
            Redundancy::TwoNetworks => "different services: separate networks",
            Redundancy::Open => "services not known on both",
        }
    }
}

/// The same device on another bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RedundantDevice {
    /// Which.
    pub id: DeviceId,
    /// What it makes of the two buses.
    pub kinship: Redundancy,
}

/// Who is the same device as whom.
#[derive(Debug, Default)]
pub(super) struct RedundantDevices {
    of: HashMap<DeviceId, Vec<RedundantDevice>>,
    told: BTreeMap<(DeviceId, DeviceId), Redundancy>,
}

impl RedundantDevices {
    /// Looks at all buses anew. Comes back with the pairs, in the order of their buses, of which
    /// something else is known than before.
    pub fn refresh(&mut self, buses: &[Bus]) -> Vec<(DeviceId, DeviceId, Redundancy)> {
        self.of.clear();
        if buses.len() < 2 {
            return Vec::new();
        }
        let mut groups: HashMap<(Name, Uid), Vec<&Device>> = HashMap::new();
        for bus in buses {
            for device in bus.engine.devices().iter().filter(|device| !device.is_debug) {
                let uid = device.uid.filter(|uid| !uid.is_blank());
                let (Some(name), Some(uid)) = (&device.name, uid) else { continue };
                let group = groups.entry((name.clone(), uid)).or_default();
                // Of several on one bus, the one that is there, or was last.
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
        let mut news = Vec::new();
        for group in groups.values().filter(|group| group.len() > 1) {
            for (at, one) in group.iter().enumerate() {
                for other in &group[at + 1..] {
                    let kinship = kinship(one, other);
                    self.of
                        .entry(one.id)
                        .or_default()
                        .push(RedundantDevice { id: other.id, kinship });
                    self.of
                        .entry(other.id)
                        .or_default()
                        .push(RedundantDevice { id: one.id, kinship });
                    if self.told.insert((one.id, other.id), kinship) != Some(kinship) {
                        news.push((one.id, other.id, kinship));
                    }
                }
            }
        }
        self.told.retain(|(one, other), _| {
            self.of.get(one).is_some_and(|all| all.iter().any(|it| it.id == *other))
        });
        news.sort_by_key(|(one, other, _)| (*one, *other));
        news
    }

    /// The same device on other buses.
    pub fn of(&self, id: DeviceId) -> &[RedundantDevice] {
        self.of.get(&id).map_or(&[], Vec::as_slice)
    }

    /// The same device on other buses, where these are redundant.
    pub fn redundant(&self, id: DeviceId) -> impl Iterator<Item = DeviceId> {
        let redundant = self.of(id).iter().filter(|it| it.kinship == Redundancy::Redundant);
        redundant.map(|it| it.id)
    }
}

impl App {
    /// Looks who is on several buses, and tells what is new.
    pub(super) fn refresh_siblings(&mut self) {
        for (one, other, kinship) in self.siblings.refresh(&self.buses) {
            let Some(text) = self.report_redundancy(one, other, kinship) else { continue };
            let mut line = TimelineEntry::new(self.now, TimelineKind::Bus, text).on(one.bus);
            if let Some(device) = self.device(one) {
                line.device = Some(one);
                line.address = Some(device.address);
                line.name.clone_from(&device.name);
            }
            self.report_line(line);
        }
    }

    fn report_redundancy(
        &self,
        one: DeviceId,
        other: DeviceId,
        kinship: Redundancy,
    ) -> Option<String> {
        let place = |id: DeviceId| {
            let (device, bus) = (self.device(id)?, self.bus(id.bus)?);
            Some(format!("{} @{}", bus.name, device.address))
        };
        let (here, there) = (place(one)?, place(other)?);
        match kinship {
            Redundancy::Redundant => {
                Some(format!("on {here} and {there}, same services: redundant"))
            }
            Redundancy::TwoNetworks => {
                Some(format!("on {here} and {there}, different services: separate networks"))
            }
            Redundancy::Open => None,
        }
    }

    /// Where the same device still is, on redundant buses.
    pub(super) fn still_on(&self, id: DeviceId) -> Vec<String> {
        let others = self.siblings.redundant(id).filter(|other| other.bus != id.bus);
        let here = others.filter(|other| self.device(*other).is_some_and(Device::is_present));
        here.filter_map(|other| Some(self.bus(other.bus)?.name.clone())).collect()
    }
}

fn kinship(one: &Device, other: &Device) -> Redundancy {
    match (&one.services, &other.services) {
        (Some(here), Some(there)) if here == there => Redundancy::Redundant,
        (Some(_), Some(_)) => Redundancy::TwoNetworks,
        _ => Redundancy::Open,
    }
}
