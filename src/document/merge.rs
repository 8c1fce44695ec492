//! Three-way merge of unsaved edits with changes on disk.
//!
//! Input: the base, from which both sides started; operations on it (ours); the content on disk
//! (theirs). A value that one side changed comes from that side, byte for byte. A value that both
//! changed differently is an [`EditConflict`], for which the user chooses.

use std::collections::HashMap;
use std::hash::Hash;
use std::ops::Range;

use super::entry::{Entry, ListedService, Member};
use super::operation::{EntryKey, Operation};
use super::text::brief;
use super::{Document, EditError};

/// Description of an entry that one side deleted.
const DELETED: &str = "deleted";
/// Description of an entry that may be another one of this name in theirs.
const AMBIGUOUS: &str = "deleted, or another entry of this name";

/// Result of a merge.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Merge {
    /// The operations were applied to theirs.
    Rebased {
        /// Theirs with the operations applied.
        document: Document,
        /// Operations as applied to theirs, in order; without those that theirs already contains.
        operations: Vec<Operation>,
        /// For each conflict in which ours was chosen, in order: the range of `operations` that
        /// overwrites theirs.
        overwriting: Vec<Range<usize>>,
    },
    /// The user has to choose.
    Conflict(EditConflict),
}

/// Both sides changed the same value, or one changed an entry that the other deleted.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct EditConflict {
    /// Operation of ours.
    pub operation: Operation,
    /// Value after the operation: "address 16, static". Safe on a terminal.
    pub ours: String,
    /// Value in theirs: "address 13, static", "deleted", or that it is not known. Safe on a terminal.
    pub theirs: String,
    /// Number among the conflicts of the merge, from 1.
    pub index: usize,
    /// Number of conflicts of the merge.
    pub total: usize,
}

/// Which value to use if both sides changed it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MergePreference {
    /// Neither: the merge returns the first conflict.
    Neither,
    /// Ours; an entry that theirs deleted is restored.
    Ours,
    /// Theirs; the operation is left out.
    Theirs,
}

/// Choices of the user. Each is for one conflict, so that no value is overwritten or dropped that
/// was not shown.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ConflictChoices {
    /// Choice for each of the first conflicts, in order.
    pub chosen: Vec<MergePreference>,
    /// True if the file was deleted while a choice was open: whether to create it again with a new
    /// entry of ours is then a conflict too.
    pub file_was_deleted: bool,
}

/// Applies operations made on `base`, in their order, to `theirs`.
///
/// Equal changes on both sides, changes of different members of one entry, and a different order of
/// entries are not conflicts.
///
/// # Errors
/// [`EditError`] if an operation does not apply to `base`, or theirs cannot be edited.
pub fn merge(
    base: &Document,
    ours: &[Operation],
    theirs: &Document,
    prefer: MergePreference,
) -> Result<Merge, EditError> {
    merge_with_choices(base, ours, theirs, &ConflictChoices::default(), prefer)
}

/// As [`merge`], with the user's choices for the first conflicts; `rest` is for the others.
///
/// # Errors
/// As in [`merge`].
pub fn merge_with_choices(
    base: &Document,
    ours: &[Operation],
    theirs: &Document,
    choices: &ConflictChoices,
    rest: MergePreference,
) -> Result<Merge, EditError> {
    let mut base = base.clone();
    let mut document = theirs.clone();
    let mut operations = Vec::new();
    let mut overruling = Vec::new();
    let mut dropped = DroppedValues::default();
    let mut conflicts = 0;
    // First conflict without a choice; all further conflicts are only counted.
    let mut open: Option<EditConflict> = None;
    for (at, operation) in ours.iter().enumerate() {
        let next = base.apply(operation)?;
        let mut step = merge_operation(operation, &base, &next, &document, &ours[at + 1..]);
        if let (MergeStep::Apply(operation), true) = (&step, choices.file_was_deleted)
            && let Some(entry) = operation.added()
        {
            let (ours, theirs) = (describe_all(&entry), DELETED.to_owned());
            step = MergeStep::Conflict { ours, theirs, overwrite_with: vec![operation.clone()] };
        }
        let steps = match step {
            MergeStep::Done => Vec::new(),
            MergeStep::Apply(operation) => vec![operation],
            MergeStep::Conflict { .. } if dropped.has(operation) => Vec::new(),
            MergeStep::Conflict { ours, theirs, overwrite_with: insist } => {
                let choice = choices.chosen.get(conflicts).copied().unwrap_or(rest);
                conflicts += 1;
                if choice == MergePreference::Neither && open.is_none() {
                    let (operation, number) = (operation.clone(), conflicts);
                    open = Some(EditConflict {
                        operation,
                        ours,
                        theirs,
                        index: number,
                        total: number,
                    });
                }
                if choice == MergePreference::Ours {
                    overruling.push(operations.len()..operations.len() + insist.len());
                    insist
                } else {
                    let is_deleted = matches!(insist[..], [Operation::RestoreEntry { .. }]);
                    dropped.add(operation, is_deleted);
                    Vec::new()
                }
            }
        };
        for step in steps {
            document = document.apply(&step)?;
            operations.push(step);
        }
        dropped.follow(operation, &base, &next);
        base = next;
    }
    Ok(match open {
        Some(conflict) => Merge::Conflict(EditConflict { total: conflicts, ..conflict }),
        None => Merge::Rebased { document, operations, overwriting: overruling },
    })
}

/// Values for which theirs is used, with the keys of their entries as operations of ours name them.
/// A later operation on such a value is left out too: one value, one choice.
#[derive(Default)]
struct DroppedValues {
    values: Vec<(EntryKey, Vec<Member>)>,
}

impl DroppedValues {
    fn add(&mut self, operation: &Operation, is_deleted: bool) {
        if let Some(key) = operation.entry() {
            // A deleted entry has no values.
            let members = if is_deleted { Member::ALL.to_vec() } else { operation.members() };
            self.values.push((key.clone(), members));
        }
    }

    fn has(&self, operation: &Operation) -> bool {
        let members = operation.members();
        !members.is_empty()
            && self.values.iter().any(|(key, dropped)| {
                Some(key) == operation.entry() && members.iter().all(|it| dropped.contains(it))
            })
    }

    /// Updates the keys after an operation that may change one.
    fn follow(&mut self, operation: &Operation, base: &Document, next: &Document) {
        if operation.members().is_empty() {
            return;
        }
        let Some((key, index)) = operation.entry().and_then(|key| Some((key, base.find(key)?)))
        else {
            return;
        };
        for (dropped, _) in &mut self.values {
            if dropped == key {
                *dropped = next.key(index);
            }
        }
    }
}

/// Result for one operation.
enum MergeStep {
    /// Theirs already contains it.
    Done,
    /// Apply this operation to theirs.
    Apply(Operation),
    /// Conflict; `insist` overwrites theirs.
    Conflict { ours: String, theirs: String, overwrite_with: Vec<Operation> },
}

/// Merges one operation. `next`: `base` with the operation applied; `later`: the operations after
/// it.
fn merge_operation(
    operation: &Operation,
    base: &Document,
    next: &Document,
    theirs: &Document,
    later: &[Operation],
) -> MergeStep {
    let Some(index) = operation.entry().and_then(|key| base.find(key)) else {
        return merge_added(operation, base, theirs);
    };
    let before = &base.entries()[index];
    let counterparts = counterparts(base, theirs);
    let counterpart = counterparts[index];
    let operation = match counterpart {
        Some(counterpart) => operation.with_key(theirs.key(counterpart)),
        None => operation.clone(),
    };
    let is_removal = operation.is_removal();
    let Some(counterpart) = counterpart else {
        if is_removal {
            return MergeStep::Done;
        }
        let changed = next.removed(index);
        let may_be = |entry: &&Entry| {
            (&entry.bus, &entry.name) == (&before.bus, &before.name)
                && !counterparts.contains(&Some(entry.index))
        };
        let is_ambiguous = theirs.entries().iter().any(|entry| may_be(&entry));
        return MergeStep::Conflict {
            ours: describe(&operation.members(), &changed.entry),
            theirs: if is_ambiguous { AMBIGUOUS } else { DELETED }.to_owned(),
            overwrite_with: vec![Operation::RestoreEntry { removed: changed }],
        };
    };
    let found = &theirs.entries()[counterpart];
    if is_removal {
        if same_value(base.entry_text(index), theirs.entry_text(counterpart)) {
            return MergeStep::Apply(operation);
        }
        let theirs = differences(before, found);
        return MergeStep::Conflict {
            ours: DELETED.to_owned(),
            theirs,
            overwrite_with: vec![operation],
        };
    }
    let members = operation.members();
    let mut wanted = found.clone();
    operation.change(&mut wanted);
    let agree = |a: &Entry, b: &Entry| members.iter().all(|member| member.agrees(a, b));
    if agree(found, &wanted) {
        MergeStep::Done
    } else if agree(found, before) {
        MergeStep::Apply(operation)
    } else if final_entry(next, index, later).is_some_and(|ours| agree(found, &ours)) {
        // Theirs already has the value that later operations set.
        MergeStep::Done
    } else {
        let (ours, theirs) = (describe(&members, &wanted), describe(&members, found));
        MergeStep::Conflict {
            ours,
            theirs,
            overwrite_with: vec![operation.with_former_address(found.address)],
        }
    }
}

/// Returns an entry after further operations; `None` if one of them removes it.
fn final_entry(document: &Document, index: usize, operations: &[Operation]) -> Option<Entry> {
    let (mut document, mut index) = (document.clone(), index);
    for operation in operations {
        let mut key = document.key(index);
        document = document.apply(operation).ok()?;
        if operation.entry() == Some(&key) {
            if operation.is_removal() {
                return None;
            }
            key = document.key(index);
        }
        index = document.find(&key)?;
    }
    Some(document.entries()[index].clone())
}

/// Merges an operation that adds an entry, which theirs may have added too.
fn merge_added(operation: &Operation, base: &Document, theirs: &Document) -> MergeStep {
    let Some(entry) = operation.added() else { return MergeStep::Apply(operation.clone()) };
    let is_same = |other: &&Entry| {
        (&other.bus, &other.name, other.address) == (&entry.bus, &entry.name, entry.address)
    };
    let known = base.entries().iter().filter(is_same).count();
    let same = theirs.entries().iter().filter(is_same).nth(known);
    let Some(found) = same.or_else(|| twin(&entry, base, theirs)) else {
        return MergeStep::Apply(operation.clone());
    };
    if found.content() == entry.content() {
        return MergeStep::Done;
    }
    let is_new = matches!(operation, Operation::Add { .. });
    if (is_new || same.is_none())
        && let Some(step) = merge_added_twice(&entry, found, theirs)
    {
        return step;
    }
    let removal = Operation::Remove { entry: theirs.key(found.index) };
    MergeStep::Conflict {
        ours: differences(found, &entry),
        theirs: differences(&entry, found),
        overwrite_with: vec![removal, operation.clone()],
    }
}

/// Returns the entry that theirs added for the same device: each side added exactly one of its
/// name. `None` if that cannot be decided.
fn twin<'d>(entry: &Entry, base: &Document, theirs: &'d Document) -> Option<&'d Entry> {
    let is_twin = |other: &&Entry| (&other.bus, &other.name) == (&entry.bus, &entry.name);
    if base.entries().iter().any(|other| is_twin(&other)) {
        return None;
    }
    let mut found = theirs.entries().iter().filter(is_twin);
    let only = found.next().filter(|_| found.next().is_none())?;
    let is_other = only.uid.is_some() && entry.uid.is_some() && only.uid != entry.uid;
    (!is_other).then_some(only)
}

/// Merges a new entry whose device theirs lists too: sets the values of ours in theirs, and keeps
/// all others. `None` if that is not sufficient.
fn merge_added_twice(entry: &Entry, found: &Entry, theirs: &Document) -> Option<MergeStep> {
    if found.uid.is_some() && entry.uid.is_some() && found.uid != entry.uid {
        return None;
    }
    let mut members = Vec::new();
    let mut insist = Vec::new();
    let key = theirs.key(found.index);
    // An address that is not static is only the one last seen.
    if entry.is_static && (entry.address, true) != (found.address, found.is_static) {
        members.extend([Member::Address, Member::Static]);
        insist.push(Operation::PinAddress { entry: key, from: found.address, to: entry.address? });
    }
    // An entry without services stays without.
    let lists_others = found.services.as_ref().is_some_and(|it| !it.is_empty())
        && entry.services != found.services;
    if let Some(services) = entry.services.clone().filter(|_| lists_others) {
        members.push(Member::Services);
        let entry = theirs.key(found.index);
        // Before the address: it is part of the key.
        insist.insert(0, Operation::SetServices { entry, services });
    }
    if members.is_empty() {
        return Some(MergeStep::Done);
    }
    let (ours, theirs) = (describe(&members, entry), describe(&members, found));
    Some(MergeStep::Conflict { ours, theirs, overwrite_with: insist })
}

impl Document {
    /// Returns the index in newer content of the entry at `index`, even if it moved or its address
    /// or name changed; `None` if it was deleted or is ambiguous.
    ///
    /// # Panics
    /// If `index` is not an index of [`Document::entries`].
    pub fn counterpart(&self, index: usize, newer: &Self) -> Option<usize> {
        newer.find(&self.key(index)).or_else(|| counterparts(self, newer)[index])
    }
}

/// Returns, for each entry of the base, the index of the corresponding entry of theirs.
///
/// Entries that are equal in bus, name, address and UID correspond, in their order. Of the rest,
/// those do that are the only ones with their UID, with their name, or with all members but the
/// name. `None`: deleted or ambiguous, which are the same for an edit.
pub(super) fn counterparts(base: &Document, theirs: &Document) -> Vec<Option<usize>> {
    let mut exact: HashMap<EntryKey, Vec<usize>> = HashMap::new();
    for entry in theirs.entries().iter().rev() {
        exact.entry(EntryKey::of(entry)).or_default().push(entry.index);
    }
    let mut pairs = Pairs {
        base: base.entries(),
        theirs: theirs.entries(),
        of_base: vec![None; base.entries().len()],
        taken: vec![false; theirs.entries().len()],
    };
    for entry in base.entries() {
        if let Some(found) = exact.get_mut(&EntryKey::of(entry)).and_then(Vec::pop) {
            pairs.add(entry.index, found);
        }
    }
    pairs.add_unique(|entry| {
        let uid = entry.uid.as_ref().filter(|uid| !uid.trim().is_empty())?;
        Some((&entry.bus, uid))
    });
    pairs.add_unique(|entry| Some((&entry.bus, &entry.name)));
    pairs.add_unique(|entry| {
        let Entry { bus, address, is_static, uid, services, .. } = entry;
        (address.is_some() || uid.is_some()).then_some((bus, address, is_static, uid, services))
    });
    pairs.of_base
}

/// Corresponding entries of the base and of theirs, as far as found.
struct Pairs<'d> {
    base: &'d [Entry],
    theirs: &'d [Entry],
    of_base: Vec<Option<usize>>,
    taken: Vec<bool>,
}

impl<'d> Pairs<'d> {
    fn add(&mut self, base: usize, theirs: usize) {
        self.of_base[base] = Some(theirs);
        self.taken[theirs] = true;
    }

    /// Pairs the entries without a counterpart that are the only ones with their key on each side.
    fn add_unique<K: Eq + Hash>(&mut self, key: impl Fn(&'d Entry) -> Option<K>) {
        let alone = |entry: &&Entry| self.of_base[entry.index].is_none();
        let ours = unique(self.base.iter().filter(alone), &key);
        let alone = |entry: &&Entry| !self.taken[entry.index];
        let theirs = unique(self.theirs.iter().filter(alone), &key);
        for (key, base) in ours {
            if let (Some(base), Some(Some(theirs))) = (base, theirs.get(&key)) {
                self.add(base, *theirs);
            }
        }
    }
}

/// Returns the index of the entry with each key; `None` for a key with several entries.
fn unique<'d, K: Eq + Hash>(
    entries: impl Iterator<Item = &'d Entry>,
    key: impl Fn(&'d Entry) -> Option<K>,
) -> HashMap<K, Option<usize>> {
    let mut found = HashMap::new();
    for entry in entries {
        if let Some(key) = key(entry) {
            found.entry(key).and_modify(|index| *index = None).or_insert(Some(entry.index));
        }
    }
    found
}

/// Returns true if two texts are the same JSON value, regardless of layout.
fn same_value(a: &str, b: &str) -> bool {
    let value = |text| serde_json::from_str::<serde_json::Value>(text).ok();
    a == b || value(a).is_some_and(|a| value(b) == Some(a))
}

/// Describes the members in which `entry` differs from `other`.
fn differences(other: &Entry, entry: &Entry) -> String {
    let members: Vec<Member> =
        Member::ALL.into_iter().filter(|member| !member.agrees(other, entry)).collect();
    if members.is_empty() { "other members changed".to_owned() } else { describe(&members, entry) }
}

/// Describes an entry without its name.
fn describe_all(entry: &Entry) -> String {
    let mut members = vec![Member::Address, Member::Static];
    members.extend(entry.services.is_some().then_some(Member::Services));
    describe(&members, entry)
}

/// Describes these members of an entry.
fn describe(members: &[Member], entry: &Entry) -> String {
    let text = |text: &Option<String>| {
        text.as_ref().map_or_else(|| "none".to_owned(), |text| brief(text.as_bytes()))
    };
    let part = |member: &Member| match member {
        Member::Name => Some(brief(&entry.name)),
        Member::Address => Some(match entry.address {
            Some(address) => format!("address {address}"),
            None => "no address".to_owned(),
        }),
        Member::Static => Some(if entry.is_static { "static" } else { "not static" }.to_owned()),
        Member::Services => Some(format!("services {}", listed(entry.services.as_deref()))),
        Member::Bus => Some(format!("bus {}", text(&entry.bus))),
        Member::Uid => Some(format!("UID {}", text(&entry.uid))),
        Member::NameHex => None,
    };
    let parts: Vec<String> = members.iter().filter_map(part).collect();
    parts.join(", ")
}

fn listed(services: Option<&[ListedService]>) -> String {
    const SHOWN: usize = 8;
    let Some(services) = services.filter(|services| !services.is_empty()) else {
        return "none".to_owned();
    };
    let name = |service: &ListedService| {
        let mut text = service.name.clone();
        for part in std::iter::once(&service.version).chain(&service.extra) {
            text = text + " " + part;
        }
        brief(text.as_bytes())
    };
    let mut parts: Vec<String> = services.iter().take(SHOWN).map(name).collect();
    if services.len() > SHOWN {
        parts.push(format!("{} more", services.len() - SHOWN));
    }
    parts.join(", ")
}
