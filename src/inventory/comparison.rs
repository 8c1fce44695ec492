//! The differences between two inventories.
//!
//! What one side does not know is not a difference: it is counted in
//! [`InventoryComparison::unknown`]. Swapping the sides swaps the values of every row. Does not
//! know how rows are printed.

use super::difference::{
    Difference, DifferenceKind, DifferenceSide, DifferenceSubject, DifferenceValue, UnknownPart,
};
use super::pairing::{PairedDevices, pair_devices};
use super::{Inventory, InventoryBus, InventoryDevice, InventoryFinding, InventoryService};
use crate::finding::{ExitCodeScope, FindingKind, FindingState};
use std::collections::{BTreeMap, BTreeSet};

/// Part of a heartbeat period, or of a load, by which another one differs at least.
const FIFTH: f64 = 0.2;
/// Least difference of two loads. The load of a healthy bus varies by less.
const LOAD_STEP: f64 = 0.01;

/// Result of a comparison.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InventoryComparison {
    /// The differences: by bus, address and name; values of buses last.
    pub differences: Vec<Difference>,
    /// What was not compared.
    pub unknown: Vec<UnknownPart>,
    /// Buses that were compared.
    pub buses: Vec<PairedBus>,
}

/// A bus that both sides have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PairedBus {
    /// Name before.
    pub before: String,
    /// Name after: another one if each side has one bus.
    pub after: String,
}

/// Compares two inventories. Buses are paired by name; where each side has one bus, these.
pub fn compare(before: &Inventory, after: &Inventory) -> InventoryComparison {
    let mut comparer = Comparer::new(before, after);
    comparer.compare_buses();
    comparer.compare_devices();
    comparer.compare_findings();
    let mut differences = comparer.differences;
    differences.sort_by_cached_key(Difference::rank);
    let unknown = comparer.unknown.into_iter();
    let unknown = unknown.map(|((kind, side), devices)| UnknownPart { kind, side, devices });
    InventoryComparison { differences, unknown: unknown.collect(), buses: comparer.buses }
}

struct Comparer<'a> {
    sides: [&'a Inventory; 2],
    buses: Vec<PairedBus>,
    /// Names of the only buses of each side, if they have other names.
    renamed: Option<[&'a str; 2]>,
    differences: Vec<Difference>,
    unknown: BTreeMap<(DifferenceKind, DifferenceSide), usize>,
}

/// What a conflict shows about the boards at an address.
#[derive(Default)]
struct Boards<'a> {
    /// True if a conflict is open there: mode, UID and heartbeats are those of any of them.
    is_shared: bool,
    uids: BTreeSet<&'a str>,
}

impl<'a> Comparer<'a> {
    fn new(before: &'a Inventory, after: &'a Inventory) -> Self {
        let renamed = match (&before.buses[..], &after.buses[..]) {
            ([one], [other]) if one.name != other.name => Some([&*one.name, &*other.name]),
            _ => None,
        };
        let has = |bus: &&InventoryBus| {
            renamed.is_some() || after.buses.iter().any(|other| other.name == bus.name)
        };
        let paired = |bus: &InventoryBus| PairedBus {
            before: bus.name.clone(),
            after: renamed.map_or(&*bus.name, |names| names[1]).to_owned(),
        };
        let buses = before.buses.iter().filter(has).map(paired).collect();
        let sides = [before, after];
        Self { sides, buses, renamed, differences: Vec::new(), unknown: BTreeMap::new() }
    }

    /// Name of a bus of the first inventory in the second one.
    fn name_after(&self, bus: &'a str) -> &'a str {
        self.renamed.filter(|names| names[0] == bus).map_or(bus, |names| names[1])
    }

    fn add(
        &mut self,
        kind: DifferenceKind,
        subjects: [Option<DifferenceSubject>; 2],
        values: [DifferenceValue; 2],
    ) {
        self.add_detail(kind, "", subjects, values);
    }

    fn add_detail(
        &mut self,
        kind: DifferenceKind,
        detail: &str,
        [subject_before, subject_after]: [Option<DifferenceSubject>; 2],
        [before, after]: [DifferenceValue; 2],
    ) {
        let detail = detail.to_owned();
        let difference = Difference { kind, detail, subject_before, subject_after, before, after };
        self.differences.push(difference);
    }

    /// Returns both values if both sides know them; counts a value that one side does not know.
    fn known<T>(&mut self, kind: DifferenceKind, values: [Option<T>; 2]) -> Option<[T; 2]> {
        let side = match values {
            [Some(before), Some(after)] => return Some([before, after]),
            [None, None] => return None,
            [None, _] => DifferenceSide::Before,
            [_, None] => DifferenceSide::After,
        };
        *self.unknown.entry((kind, side)).or_default() += 1;
        None
    }

    // ---- buses -----------------------------------------------------------------------------

    fn compare_buses(&mut self) {
        let [before, after] = self.sides;
        let subject = |bus: &InventoryBus| {
            Some(DifferenceSubject { bus: Some(bus.name.clone()), ..DifferenceSubject::default() })
        };
        let name = |bus: &InventoryBus| DifferenceValue::Word(bus.name.clone());
        for bus in &before.buses {
            let other = after.buses.iter().find(|other| other.name == self.name_after(&bus.name));
            if let Some(other) = other {
                self.compare_bus(bus, other, &[subject(bus), subject(other)]);
            } else {
                let values = [name(bus), DifferenceValue::Absent];
                self.add_detail(DifferenceKind::Bus, "name", [subject(bus), None], values);
            }
        }
        let is_there = |bus: &InventoryBus| {
            before.buses.iter().any(|other| self.name_after(&other.name) == bus.name)
        };
        let new: Vec<&InventoryBus> = after.buses.iter().filter(|bus| !is_there(bus)).collect();
        for bus in new {
            let values = [DifferenceValue::Absent, name(bus)];
            self.add_detail(DifferenceKind::Bus, "name", [None, subject(bus)], values);
        }
    }

    /// Compares what does not depend on the length of the observation: of the numbers of frames only
    /// whether there are any.
    fn compare_bus(
        &mut self,
        before: &InventoryBus,
        after: &InventoryBus,
        subjects: &[Option<DifferenceSubject>; 2],
    ) {
        let count = DifferenceValue::Count;
        let mut add = |detail: &str, is_different: bool, values: [DifferenceValue; 2]| {
            if is_different {
                self.add_detail(DifferenceKind::Bus, detail, subjects.clone(), values);
            }
        };
        if let Some((a, b)) = before.load.zip(after.load) {
            let is_different = has_ratio(a, b) && (a - b).abs() >= LOAD_STEP;
            add("load", is_different, [DifferenceValue::Share(a), DifferenceValue::Share(b)]);
        }
        if let Some((a, b)) = before.errors.zip(after.errors) {
            add("errors", a != b, [count(a), count(b)]);
        }
        if let Some((a, b)) = before.lost.zip(after.lost) {
            add("lost", a != b, [count(a), count(b)]);
        }
        if let Some((a, b)) = before.frames.zip(after.frames) {
            add("frames", (a == 0) != (b == 0), [count(a), count(b)]);
        }
        if let Some((a, b)) = before.bitrate.zip(after.bitrate) {
            add("bitrate", a != b, [count(a), count(b)]);
        }
        if let Some((a, b)) = before.state.as_deref().zip(after.state.as_deref()) {
            let values = [a, b].map(|state| DifferenceValue::Word(state.to_owned()));
            add("state", a != b, values);
        }
    }

    // ---- devices ---------------------------------------------------------------------------

    fn compare_devices(&mut self) {
        let [before, after] = self.sides;
        let PairedDevices { pairs, only_before, only_after } = {
            let renamed = |device: &'a InventoryDevice| self.name_after(&device.bus);
            let own = |device: &'a InventoryDevice| &*device.bus;
            pair_devices(&before.devices, &after.devices, [&renamed, &own])
        };
        let boards = self.sides.map(conflicts_by_address);
        for pair in pairs {
            self.compare_pair(pair, &boards);
        }
        let presence = |device: &InventoryDevice| {
            DifferenceValue::Word(device.presence.clone().unwrap_or_else(|| "present".to_owned()))
        };
        for device in only_before {
            let values = [presence(device), DifferenceValue::Absent];
            self.add(DifferenceKind::Presence, [Some(subject_of(device)), None], values);
        }
        for device in only_after {
            let values = [DifferenceValue::Absent, presence(device)];
            self.add(DifferenceKind::Presence, [None, Some(subject_of(device))], values);
        }
        if before.is_file_known != after.is_file_known {
            let (side, listing) = if before.is_file_known {
                (DifferenceSide::After, before)
            } else {
                (DifferenceSide::Before, after)
            };
            let listed = listing.devices.iter().filter(|device| device.entry.is_some()).count();
            self.unknown.insert((DifferenceKind::File, side), listed);
        }
    }

    fn compare_pair(
        &mut self,
        (before, after): (&'a InventoryDevice, &'a InventoryDevice),
        boards: &[BTreeMap<(&'a str, u8), Vec<&'a InventoryFinding>>; 2],
    ) {
        use DifferenceKind as Kind;
        let pair = [before, after];
        let subjects = || pair.map(|device| Some(subject_of(device)));
        let word = |word: &str| DifferenceValue::Word(word.to_owned());
        let words = |get: fn(&InventoryDevice) -> Option<&str>| pair.map(get);
        if let Some(values) = self.known(Kind::Presence, words(|it| it.presence.as_deref()))
            && values[0] != values[1]
        {
            self.add(Kind::Presence, subjects(), values.map(word));
        }
        if before.address != after.address {
            let values = pair.map(|it| DifferenceValue::Count(it.address.into()));
            self.add(Kind::Address, subjects(), values);
        }
        if let Some(values) = self.known(Kind::Name, words(|it| it.name.as_deref()))
            && values[0] != values[1]
        {
            self.add(Kind::Name, subjects(), values.map(word));
        }
        let boards = [boards_of(before, &boards[0]), boards_of(after, &boards[1])];
        if boards.iter().all(|it| it.uids.len() <= 1) {
            if let Some(values) = self.known(Kind::Uid, words(|it| it.uid.as_deref()))
                && values[0] != values[1]
            {
                let is_blank = values.iter().any(|uid| uid.trim().is_empty());
                if is_blank {
                    self.add(Kind::Uid, subjects(), values.map(word));
                } else {
                    let values = values.map(|uid| DifferenceValue::Words(vec![uid.to_owned()]));
                    self.add(Kind::Boards, subjects(), values);
                }
            }
        } else if boards[0].uids != boards[1].uids {
            let values = boards.each_ref().map(|it| {
                DifferenceValue::Words(it.uids.iter().map(|uid| (*uid).to_owned()).collect())
            });
            self.add(Kind::Boards, subjects(), values);
        }
        // At a shared address they are those of any of the boards.
        if !boards.iter().any(|it| it.is_shared) {
            if let Some(values) = self.known(Kind::Mode, words(|it| it.mode.as_deref()))
                && values[0] != values[1]
            {
                self.add(Kind::Mode, subjects(), values.map(word));
            }
            if let Some(periods) = self.known(Kind::Heartbeat, pair.map(|it| it.period_ms))
                && has_ratio(periods[0], periods[1])
            {
                self.add(Kind::Heartbeat, subjects(), periods.map(DifferenceValue::Millis));
            }
        }
        if let Some(lists) = self.known(Kind::Services, pair.map(|it| it.services.as_deref())) {
            let (services, versions) = compare_services(lists);
            for (kind, lists) in [(Kind::Services, services), (Kind::Version, versions)] {
                if lists.iter().any(|list| !list.is_empty()) {
                    self.add(kind, subjects(), lists.map(DifferenceValue::Words));
                }
            }
        }
        if self.sides.iter().all(|side| side.is_file_known) && before.entry != after.entry {
            let values = pair.map(|device| {
                device.entry.map_or(DifferenceValue::Absent, |entry| DifferenceValue::Entry {
                    address: entry.address,
                    is_static: entry.is_static,
                })
            });
            self.add(Kind::File, subjects(), values);
        }
    }

    // ---- findings --------------------------------------------------------------------------

    /// Compares the open findings. A finding without an address, or with other names only, is
    /// another finding.
    fn compare_findings(&mut self) {
        type Groups<'a, K> = BTreeMap<K, [Vec<&'a InventoryFinding>; 2]>;
        let is_file_known = self.sides.iter().all(|side| side.is_file_known);
        let mut exact: Groups<_> = BTreeMap::new();
        for (at, side) in self.sides.into_iter().enumerate() {
            for finding in side.findings.iter().filter(|it| is_compared(it, is_file_known)) {
                let bus = finding.bus.as_deref();
                let bus = if at == 0 { bus.map(|bus| self.name_after(bus)) } else { bus };
                let place = (bus, finding.address, &*finding.kind, &finding.addresses);
                exact.entry((place, &finding.names)).or_default()[at].push(finding);
            }
        }
        let mut rest: Groups<_> = BTreeMap::new();
        for ((place, _), [mut before, mut after]) in exact {
            before.sort_by_key(|finding| confidence_rank(&finding.confidence));
            after.sort_by_key(|finding| confidence_rank(&finding.confidence));
            let pairs = before.len().min(after.len());
            for (before, after) in before.iter().zip(&after) {
                self.compare_finding(Some(before), Some(after));
            }
            let group = rest.entry(place).or_default();
            group[0].extend(&before[pairs..]);
            group[1].extend(&after[pairs..]);
        }
        for ((_, address, ..), [before, after]) in rest {
            let mut after = after.into_iter();
            for before in before {
                let other = after.next();
                let is_same = other.is_some_and(|other| {
                    let is_unnamed = before.names.is_empty() || other.names.is_empty();
                    is_unnamed || before.names.iter().any(|name| other.names.contains(name))
                });
                if address.is_some() && is_same {
                    self.compare_finding(Some(before), other);
                } else {
                    self.compare_finding(Some(before), None);
                    self.compare_finding(None, other);
                }
            }
            for other in after {
                self.compare_finding(None, Some(other));
            }
        }
    }

    fn compare_finding(
        &mut self,
        before: Option<&InventoryFinding>,
        after: Option<&InventoryFinding>,
    ) {
        let cleared = FindingState::Cleared.name();
        let open = |finding: Option<&InventoryFinding>| {
            let finding = finding.filter(|finding| finding.confidence != cleared);
            finding.map(|finding| finding.confidence.clone())
        };
        let states = [open(before), open(after)];
        let Some(any) = before.or(after).filter(|_| states[0] != states[1]) else { return };
        let subjects = [before, after].map(|finding| finding.map(subject_of_finding));
        let values = [before, after].map(|finding| {
            DifferenceValue::of_word(finding.map(|finding| finding.confidence.as_str()))
        });
        self.add_detail(DifferenceKind::Finding, &any.kind, subjects, values);
    }
}

/// Returns true if two values differ by more than a fifth of the smaller one.
fn has_ratio(one: f64, other: f64) -> bool {
    (one - other).abs() > one.abs().min(other.abs()) * FIFTH
}

fn subject_of(device: &InventoryDevice) -> DifferenceSubject {
    DifferenceSubject {
        bus: Some(device.bus.clone()),
        address: Some(device.address),
        name: device.name.clone(),
        uid: device.uid.clone(),
    }
}

fn subject_of_finding(finding: &InventoryFinding) -> DifferenceSubject {
    let name = Some(finding.names.join(" / ")).filter(|names| !names.is_empty());
    DifferenceSubject { bus: finding.bus.clone(), address: finding.address, name, uid: None }
}

/// Returns the order of states: confirmed first.
fn confidence_rank(confidence: &str) -> usize {
    let states = [FindingState::Confirmed, FindingState::Suspected, FindingState::Cleared];
    states.iter().position(|state| state.name() == confidence).unwrap_or(states.len())
}

fn kind_of(finding: &InventoryFinding) -> Option<FindingKind> {
    FindingKind::ALL.iter().copied().find(|kind| kind.name() == finding.kind)
}

/// Returns true if a finding is compared: not one that is only reported by `check`, and not one
/// about des.json unless both sides know the file.
fn is_compared(finding: &InventoryFinding, is_file_known: bool) -> bool {
    match kind_of(finding) {
        Some(FindingKind::Unlisted | FindingKind::ServicesDiffer) => false,
        Some(kind) => match kind.facts().exit_code_of {
            ExitCodeScope::Check(_) => is_file_known,
            ExitCodeScope::ScanAndCheck | ExitCodeScope::Nothing => true,
        },
        None => true,
    }
}

/// The open conflicts at each address of each bus.
fn conflicts_by_address(side: &Inventory) -> BTreeMap<(&str, u8), Vec<&InventoryFinding>> {
    let mut conflicts: BTreeMap<(&str, u8), Vec<&InventoryFinding>> = BTreeMap::new();
    let is_conflict = |finding: &&InventoryFinding| {
        finding.confidence != FindingState::Cleared.name()
            && kind_of(finding).is_some_and(FindingKind::is_conflict)
    };
    for finding in side.findings.iter().filter(is_conflict) {
        let (Some(bus), [address]) = (&finding.bus, &finding.addresses[..]) else { continue };
        conflicts.entry((bus, *address)).or_default().push(finding);
    }
    conflicts
}

/// The boards at the address of a device: those of its conflicts, else its own.
fn boards_of<'a>(
    device: &'a InventoryDevice,
    conflicts: &BTreeMap<(&str, u8), Vec<&'a InventoryFinding>>,
) -> Boards<'a> {
    let here = conflicts.get(&(&*device.bus, device.address)).map_or(&[][..], Vec::as_slice);
    let concerns = |finding: &&&InventoryFinding| {
        finding.names.is_empty()
            || device.name.as_ref().is_none_or(|name| finding.names.contains(name))
    };
    let mut boards = Boards::default();
    for finding in here.iter().filter(concerns) {
        boards.is_shared = true;
        boards.uids.extend(finding.uids.iter().map(String::as_str));
    }
    boards.uids.extend(device.known_uid());
    boards
}

/// Returns the services of one side only, and the versions that differ, each before and after.
fn compare_services(lists: [&[InventoryService]; 2]) -> ([Vec<String>; 2], [Vec<String>; 2]) {
    let mut by_name: BTreeMap<&str, [Vec<&str>; 2]> = BTreeMap::new();
    for (at, list) in lists.into_iter().enumerate() {
        for service in list {
            by_name.entry(&service.name).or_default()[at].push(&service.version);
        }
    }
    let (mut services, mut versions) =
        (<[Vec<String>; 2]>::default(), <[Vec<String>; 2]>::default());
    for (name, mut sides) in by_name {
        for side in &mut sides {
            side.sort_unstable();
        }
        if sides[0] == sides[1] {
            continue;
        }
        let is_in_both = sides[0].len() == sides[1].len();
        let to = if is_in_both { &mut versions } else { &mut services };
        for (to, side) in to.iter_mut().zip(sides) {
            let text = |version: &str| format!("{name} {version}").trim_end().to_owned();
            to.extend(side.into_iter().map(text));
        }
    }
    (services, versions)
}
