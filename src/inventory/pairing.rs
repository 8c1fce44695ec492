//! Which device of an inventory is which device of another one.
//!
//! By the UID if it is unique, then by name and address, then by the address where a name is not
//! known, then by the name if one device of that name is left on each side. Any number of devices
//! can share a UID, a name and an address: equal ones are paired in a fixed order. Does not know
//! what differs between paired devices.

use super::InventoryDevice;
use std::collections::BTreeMap;

/// Devices of two inventories, paired.
#[derive(Debug, Default)]
pub(super) struct PairedDevices<'a> {
    pub pairs: Vec<(&'a InventoryDevice, &'a InventoryDevice)>,
    pub only_before: Vec<&'a InventoryDevice>,
    pub only_after: Vec<&'a InventoryDevice>,
}

/// Pairs of a group of devices that cannot be told apart.
#[derive(Clone, Copy, PartialEq, Eq)]
enum GroupRule {
    /// One on each side, else none.
    OnlyOne,
    /// As many as both sides have, in the order of their content.
    InOrder,
}

/// Pairs devices. `bus_of` returns the bus of a device: the same text for the same bus.
pub(super) fn pair_devices<'a>(
    before: &'a [InventoryDevice],
    after: &'a [InventoryDevice],
    bus_of: [&dyn Fn(&'a InventoryDevice) -> &'a str; 2],
) -> PairedDevices<'a> {
    let side = |devices: &'a [InventoryDevice], bus_of: &dyn Fn(&'a InventoryDevice) -> &'a str| {
        let mut side: Vec<_> = devices.iter().map(|device| (bus_of(device), device)).collect();
        side.sort_by(|(bus, one), (other_bus, other)| {
            (bus, content(one)).cmp(&(other_bus, content(other)))
        });
        side
    };
    let mut pairing =
        Pairing { left: [side(before, bus_of[0]), side(after, bus_of[1])], pairs: Vec::new() };
    let uid = InventoryDevice::known_uid;
    let is_not_another = |one: &InventoryDevice, other: &InventoryDevice| {
        uid(one).zip(uid(other)).is_none_or(|(one, other)| one == other)
    };
    let any = |_: &InventoryDevice, _: &InventoryDevice| true;
    let present_uid = |it: &'a InventoryDevice| uid(it).filter(|_| it.is_present());
    pairing.pair(GroupRule::OnlyOne, present_uid, any);
    pairing.pair(GroupRule::OnlyOne, uid, any);
    let place = |it: &'a InventoryDevice| (it.name.as_deref(), it.address);
    pairing.pair(
        GroupRule::InOrder,
        |it| Some((place(it), it.uid.as_deref(), it.is_present())),
        any,
    );
    pairing.pair(GroupRule::InOrder, |it| Some((place(it), it.uid.as_deref())), any);
    pairing.pair(GroupRule::InOrder, |it| Some((place(it), it.is_present())), any);
    pairing.pair(GroupRule::InOrder, |it| Some(place(it)), any);
    let is_unnamed = |one: &InventoryDevice, other: &InventoryDevice| {
        (one.name.is_none() || other.name.is_none()) && is_not_another(one, other)
    };
    pairing.pair(GroupRule::OnlyOne, |it| Some(it.address), is_unnamed);
    let present_name = |it: &'a InventoryDevice| it.name.as_deref().filter(|_| it.is_present());
    pairing.pair(GroupRule::OnlyOne, present_name, is_not_another);
    pairing.pair(GroupRule::OnlyOne, |it| it.name.as_deref(), is_not_another);
    let [only_before, only_after] =
        pairing.left.map(|left| left.into_iter().map(|it| it.1).collect());
    PairedDevices { pairs: pairing.pairs, only_before, only_after }
}

/// What devices are ordered by.
fn content(device: &InventoryDevice) -> impl Ord {
    let period = device.period_ms.map(f64::to_bits);
    let entry = device.entry.map(|entry| (entry.address, entry.is_static));
    (
        (device.address, device.name.as_deref(), device.uid.as_deref(), device.presence.as_deref()),
        (device.mode.as_deref(), device.services.as_deref(), period, entry),
    )
}

/// A device with its bus.
type OnBus<'a> = (&'a str, &'a InventoryDevice);

/// Devices that are not paired yet, before and after, in the order of their content.
struct Pairing<'a> {
    left: [Vec<OnBus<'a>>; 2],
    pairs: Vec<(&'a InventoryDevice, &'a InventoryDevice)>,
}

impl<'a> Pairing<'a> {
    /// Pairs devices of one bus with equal keys, those that `is_pair` accepts.
    fn pair<K: Ord>(
        &mut self,
        rule: GroupRule,
        key: impl Fn(&'a InventoryDevice) -> Option<K>,
        is_pair: impl Fn(&InventoryDevice, &InventoryDevice) -> bool,
    ) {
        let mut groups: BTreeMap<(&str, K), [Vec<usize>; 2]> = BTreeMap::new();
        for (side, left) in self.left.iter().enumerate() {
            for (at, (bus, device)) in left.iter().enumerate() {
                if let Some(key) = key(device) {
                    groups.entry((bus, key)).or_default()[side].push(at);
                }
            }
        }
        let mut is_paired = self.left.each_ref().map(|left| vec![false; left.len()]);
        for [before, after] in groups.into_values() {
            if rule == GroupRule::OnlyOne && (before.len(), after.len()) != (1, 1) {
                continue;
            }
            for (before, after) in before.into_iter().zip(after) {
                let pair = (self.left[0][before].1, self.left[1][after].1);
                if is_pair(pair.0, pair.1) {
                    self.pairs.push(pair);
                    (is_paired[0][before], is_paired[1][after]) = (true, true);
                }
            }
        }
        for (left, is_paired) in self.left.iter_mut().zip(is_paired) {
            let mut is_paired = is_paired.into_iter();
            left.retain(|_| !is_paired.next().unwrap_or_default());
        }
    }
}
