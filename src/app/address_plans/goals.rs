//! Which device is to have which address: from des.json, or from a plan's file.

use super::known_devices::PlanKnowledge;
use super::{PlanSession, PlanTask};
use crate::address_plan::{
    AddressGoal, AddressSet, DeviceIdentity, LeftOutReason, PlanBus, PlanRecord, RecordedDevice,
};
use crate::app::file::{EntryPlace, FileIndex};
use crate::app::problems::Matching;
use crate::app::shared_address::is_shared_address;
use crate::app::{App, Bus};
use crate::discovery::Device;
use crate::document::{Entry, Operation};
use crate::finding::Finding;
use crate::frame::BusIndex;
use crate::text::Name;
use crate::wire::descriptor::AddressSetting;
use crate::wire::id::Address;
use crate::wire::node::Uid;
use std::collections::BTreeSet;

/// A goal, in any order of goals.
pub(super) type GoalKey = (DeviceIdentity, Address);

/// Returns the place of a device in a file; of several that look the same, of that which may be at this
/// address.
pub(super) fn place_in(
    record: &PlanRecord,
    identity: &DeviceIdentity,
    address: Address,
) -> Option<usize> {
    let same = |place: &usize| record.devices[*place].identity().is_same(identity);
    let places: Vec<usize> = (0..record.devices.len()).filter(same).collect();
    let at_address = |place: &&usize| record.possible_addresses(**place).contains(&address);
    match &places[..] {
        [only] => Some(*only),
        several => several.iter().find(at_address).copied(),
    }
}

/// An entry of des.json, and its device on a bus.
struct ListedDevice<'a> {
    entry: &'a Entry,
    /// Place of the device on the bus; `None` if it was not found.
    place: Option<usize>,
    /// Why the device may be another one.
    doubt: Option<LeftOutReason>,
}

/// Returns the address that the user pinned in an entry.
fn pinned(entry: &Entry) -> Option<Address> {
    let address = entry.address.filter(|_| entry.is_static).and_then(Address::new);
    address.filter(|address| *address != Address::DEBUG)
}

impl App {
    /// The goals of a plan, in the order that the user chose, else by the present address.
    pub(super) fn address_goals(&self, session: &PlanSession, bus: &PlanBus) -> Vec<AddressGoal> {
        let mut goals = match &session.task {
            PlanTask::ToFile => self.goals_of_file(session.bus, bus),
            PlanTask::Resume(record, _) => goals_of_record(record, bus, |it| {
                (Address::from_bits(it.to), it.setting.and_then(AddressSetting::from_code))
            }),
            PlanTask::TakeBack(record, _) => goals_of_record(record, bus, |it| {
                let (address, setting) = it.place();
                // A setting that leads elsewhere cannot be confirmed.
                let setting =
                    setting.filter(|setting| *setting == AddressSetting::Preferred(address));
                (address, setting)
            }),
        };
        let key = |goal: &AddressGoal| (goal.identity.clone(), goal.to);
        for goal in &mut goals {
            goal.is_left_out = session.left_out.contains(&key(goal));
        }
        goals.sort_by_cached_key(|goal| {
            let place = session.order.iter().position(|it| *it == key(goal));
            let at = goal.device.map(|device| bus.devices[device].address);
            (place.unwrap_or(usize::MAX), at.is_none(), at, goal.to)
        });
        goals
    }

    /// The entries of des.json that are about a bus, each with its device.
    fn listed_devices<'a>(&'a self, index: BusIndex, bus: &'a Bus) -> Vec<ListedDevice<'a>> {
        let documents = self.files.documents();
        let matching = Matching::new(documents, &self.buses);
        let file = documents.of_bus(index);
        let place = |entry: &Entry| EntryPlace { file, index: entry.index };
        let mistakes = self.file_mistakes(file);
        let wrong: BTreeSet<usize> = mistakes.iter().flat_map(|it| it.entries.clone()).collect();
        let entries = documents.entries(file).iter();
        let entries = entries.filter(|entry| entry.is_for_bus(&bus.name));
        let names = EntryNames {
            entries: entries.clone().collect(),
            matching: &matching,
            bus,
            index,
            file,
        };
        let listed = entries.filter_map(|entry| {
            let devices = matching.devices_of(place(entry));
            let own = devices.iter().find(|id| id.bus == index);
            // The device is on another bus, or another entry is about it.
            if own.is_none() && (!devices.is_empty() || matching.is_duplicate(place(entry))) {
                return None;
            }
            let place = own.and_then(|id| bus.devices().iter().position(|it| it.id == *id));
            let doubt = match place {
                _ if wrong.contains(&entry.index) => Some(LeftOutReason::WrongEntry),
                _ if names.is_ambiguous(entry) => Some(LeftOutReason::SeveralNamed),
                Some(at) => doubt_of(entry, &bus.devices()[at], bus),
                None => shared_address(entry, bus).map(LeftOutReason::Shared),
            };
            Some(ListedDevice { entry, place, doubt })
        });
        listed.collect()
    }

    fn goals_of_file(&self, index: BusIndex, known: &PlanBus) -> Vec<AddressGoal> {
        let Some(bus) = self.buses.get(index) else { return Vec::new() };
        let listed = self.listed_devices(index, bus).into_iter();
        let goals = listed.filter_map(|ListedDevice { entry, place: device, doubt }| {
            let to = pinned(entry)?;
            let identity = match device {
                Some(place) => known.devices[place].identity.clone(),
                None => identity_of_entry(entry, bus),
            };
            let (setting, is_left_out) = (None, false);
            Some(AddressGoal { device, identity, to, setting, doubt, is_left_out })
        });
        goals.collect()
    }

    /// The addresses that entries pin on a bus.
    pub(super) fn reserved_addresses(&self, index: BusIndex) -> AddressSet {
        let Some(bus) = self.buses.get(index) else { return AddressSet::default() };
        let documents = self.files.documents();
        let entries = documents.entries(documents.of_bus(index)).iter();
        entries.filter(|entry| entry.is_for_bus(&bus.name)).filter_map(pinned).collect()
    }

    /// The edits that give the entries of a bus the addresses of their devices, pinned; and the entries
    /// that get none, each with the reason.
    pub fn pins_of_bus(&self, index: BusIndex) -> (Vec<Operation>, Vec<(String, LeftOutReason)>) {
        let (mut edits, mut left_out) = (Vec::new(), Vec::new());
        let Some(bus) = self.buses.get(index) else { return (edits, left_out) };
        let known = self.known_devices(index, PlanKnowledge::default());
        let document = self.files.get(self.files.of_bus(index)).file.document();
        for ListedDevice { entry, place, doubt } in self.listed_devices(index, bus) {
            let device = place.map(|at| &known.devices[at]);
            let same_uid = || device?.same_uid_at.map(LeftOutReason::SameUid);
            let reason = match (doubt, device) {
                (Some(LeftOutReason::WrongEntry), _) => Some(LeftOutReason::WrongEntry),
                (doubt, Some(device)) => device.obstacle().or_else(same_uid).or(doubt),
                (doubt, None) => Some(doubt.unwrap_or(LeftOutReason::NotPresent)),
            };
            match (reason, device) {
                (None, Some(device)) => {
                    let to = device.address.number();
                    if entry.address != Some(to) || !entry.is_static {
                        let (entry, from) = (document.key(entry.index), entry.address);
                        edits.push(Operation::PinAddress { entry, from, to });
                    }
                }
                (reason, _) => {
                    let name = Name::new(&entry.name).to_string();
                    left_out.push((name, reason.unwrap_or(LeftOutReason::NotPresent)));
                }
            }
        }
        (edits, left_out)
    }

    /// Applies the edits of [`App::pins_of_bus`] as one.
    pub fn pin_bus(&mut self, index: BusIndex, pins: &[Operation]) {
        self.edit(self.files.of_bus(index), pins);
    }
}

fn identity_of_entry(entry: &Entry, bus: &Bus) -> DeviceIdentity {
    let alphabet = &bus.config().profile.uid;
    let uid = entry.trimmed_uid().and_then(|text| Uid::parse(text, alphabet));
    DeviceIdentity { uid: uid.and_then(Uid::not_blank), name: Some(Name::new(&entry.name)) }
}

/// Why the device of an entry may be another one than the listed one.
fn doubt_of(entry: &Entry, device: &Device, bus: &Bus) -> Option<LeftOutReason> {
    let listed = identity_of_entry(entry, bus).uid;
    let is_other_uid = listed.zip(device.uid).is_some_and(|(listed, uid)| listed != uid);
    if is_other_uid || device.name.is_some() && !device.is_named(&entry.name) {
        return Some(LeftOutReason::Another(device.address));
    }
    (listed.is_some() && device.uid.is_none()).then_some(LeftOutReason::UidNotHeard)
}

/// Which names of entries tell their devices apart.
struct EntryNames<'a> {
    /// The entries that are about the bus.
    entries: Vec<&'a Entry>,
    matching: &'a Matching,
    bus: &'a Bus,
    index: BusIndex,
    /// The file of the bus.
    file: FileIndex,
}

impl EntryNames<'_> {
    /// Returns true if several devices or several entries have the name of an entry, and neither UID nor
    /// address says which belong together.
    fn is_ambiguous(&self, entry: &Entry) -> bool {
        let is_open = |entry: &Entry| entry.trimmed_uid().is_none();
        if !is_open(entry) || self.is_at_its_place(entry) {
            return false;
        }
        let alike = self
            .entries
            .iter()
            .filter(|it| it.name == entry.name && is_open(it) && !self.is_at_its_place(it));
        let by_name = |device: &&Device| {
            let owner = self.matching.entry_of(device.id);
            let owner = owner.and_then(|of| self.entries.iter().find(|it| it.index == of.index));
            device.is_present()
                && device.is_named(&entry.name)
                && owner.is_none_or(|owner| is_open(owner) && !self.is_at_its_place(owner))
        };
        match self.bus.devices().iter().filter(by_name).count() {
            0 => false,
            1 => alike.count() > 1,
            _ => true,
        }
    }

    /// Returns true if the device of an entry is at the address of the entry.
    fn is_at_its_place(&self, entry: &Entry) -> bool {
        let place = EntryPlace { file: self.file, index: entry.index };
        let devices = self.matching.devices_of(place).iter();
        let device = devices.filter(|id| id.bus == self.index).find_map(|id| self.bus.device(*id));
        device.is_some_and(|device| entry.address == Some(device.address.number()))
    }
}

/// Returns the address at which the device of an entry is in conflict with another one.
fn shared_address(entry: &Entry, bus: &Bus) -> Option<Address> {
    let uid = identity_of_entry(entry, bus).own_uid();
    let mut conflicts = bus.findings().iter().filter(|finding| is_shared_address(finding));
    let is_it = |finding: &&Finding| {
        finding.names.contains(&Name::new(&entry.name))
            || uid.is_some() && finding.uids.iter().any(|seen| Some(seen.uid) == uid)
    };
    conflicts.find(is_it)?.addresses.first().copied()
}

/// Returns the goals of the devices of a file.
fn goals_of_record(
    record: &PlanRecord,
    bus: &PlanBus,
    goal: impl Fn(&RecordedDevice) -> (Address, Option<AddressSetting>),
) -> Vec<AddressGoal> {
    let goals = record.devices.iter().enumerate().map(|(place, recorded)| {
        let is_it = |device: &crate::address_plan::KnownDevice| {
            device.is_present && place_in(record, &device.identity, device.address) == Some(place)
        };
        let device = bus.devices.iter().position(is_it);
        let identity = match device {
            Some(device) => bus.devices[device].identity.clone(),
            None => recorded.identity(),
        };
        let (to, setting) = goal(recorded);
        AddressGoal { device, identity, to, setting, doubt: None, is_left_out: false }
    });
    goals.collect()
}
