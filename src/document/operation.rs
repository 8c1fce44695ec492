//! Edits as values: what to change in which entry, and how to undo it.

use std::fmt;

use super::entry::{Entry, ListedService, Member};
use super::layout::Members;
use super::text::brief;
use super::{Document, EditError};
use crate::text::printable;

/// One edit of the file.
///
/// Refers to an entry by [`EntryKey`], not by index, so that it can be applied to newer content of
/// the file; see [`merge`](super::merge). `Display` describes it for the timeline and for undo,
/// safe on a terminal: "address of the entry FEED: 12 → 16".
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Operation {
    /// Pins an address: sets `address`, and `static` to true.
    PinAddress {
        /// The entry concerned.
        entry: EntryKey,
        /// Address before the edit.
        from: Option<u8>,
        /// New address, 1 to 127.
        to: u8,
    },
    /// Unpins the address: sets `static` to false. `address` stays as the last one seen.
    UnpinAddress {
        /// The entry concerned.
        entry: EntryKey,
        /// Address before the edit.
        from: Option<u8>,
    },
    /// Adds an entry at the end of the list, in the file's own layout.
    Add {
        /// Content of the entry.
        entry: NewEntry,
    },
    /// Removes the entry.
    Remove {
        /// The entry concerned.
        entry: EntryKey,
    },
    /// Changes the name.
    Rename {
        /// The entry concerned.
        entry: EntryKey,
        /// Bytes of the new name.
        to: Vec<u8>,
    },
    /// Replaces the list of services, in the layout of the entry or of the file.
    SetServices {
        /// The entry concerned.
        entry: EntryKey,
        /// Services in the order in which to list them.
        services: Vec<ListedService>,
    },
    /// Undoes an edit of members; made by [`Operation::inverse`].
    RestoreMembers {
        /// The entry concerned.
        entry: EntryKey,
        /// The members before the edit.
        former: FormerMembers,
    },
    /// Undoes a removal; made by [`Operation::inverse`].
    RestoreEntry {
        /// The removed entry.
        removed: RemovedEntry,
    },
    /// Undoes the addition of the first entry; made by [`Operation::inverse`]. If nothing was
    /// changed since, restores the exact bytes of the file.
    RemoveFirstEntry {
        /// The entry concerned.
        entry: EntryKey,
        /// The file before the addition.
        former: FormerContent,
    },
}

/// Key of an entry, independent of its place in the list. See [`Document::key`].
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct EntryKey {
    /// Bus, as in [`Entry`].
    pub bus: Option<String>,
    /// Bytes of the name, as in [`Entry`].
    pub name: Vec<u8>,
    /// Address before the edit.
    pub address: Option<u8>,
    /// UID, as in [`Entry`].
    pub uid: Option<String>,
    /// Number, from 0, among the entries that are equal in all of the above.
    pub occurrence: usize,
}

impl EntryKey {
    /// Returns the key of an entry that is unique in bus, name, address and UID. This is not checked:
    /// of several equal entries, the key finds the first; [`Document::key`] tells them apart.
    pub fn of(entry: &Entry) -> Self {
        Self {
            bus: entry.bus.clone(),
            name: entry.name.clone(),
            address: entry.address,
            uid: entry.uid.clone(),
            occurrence: 0,
        }
    }

    /// Returns true if the entry has this key, apart from `occurrence`.
    pub(super) fn fits(&self, entry: &Entry) -> bool {
        // Fastest comparison first: called for each pair of entries.
        self.address == entry.address
            && self.name == entry.name
            && self.bus == entry.bus
            && self.uid == entry.uid
    }

    /// Returns the key of an entry, given the entries before it.
    pub(super) fn among(entry: &Entry, earlier: &[Entry]) -> Self {
        let mut key = Self::of(entry);
        key.occurrence = earlier.iter().filter(|other| key.fits(other)).count();
        key
    }
}

/// The name, and the number among equal entries; `{:#}` adds the address, which distinguishes
/// twins: "SENS at 13".
impl fmt::Display for EntryKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&brief(&self.name))?;
        if let Some(address) = self.address.filter(|_| f.alternate()) {
            write!(f, " at {address}")?;
        }
        match self.occurrence {
            0 => Ok(()),
            earlier => write!(f, " (no. {})", earlier + 1),
        }
    }
}

/// Content of an entry to add.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NewEntry {
    /// Bytes of the name. If they are not UTF-8, `name` is written as printable text and `name_hex`
    /// has the bytes.
    pub name: Vec<u8>,
    /// Address, 1 to 127; `None`: not written.
    pub address: Option<u8>,
    /// The address is static. False is written only if the file's other entries have `static`.
    pub is_static: bool,
    /// Name of the bus; `None`: not written.
    pub bus: Option<String>,
    /// UID; `None`: not written.
    pub uid: Option<String>,
    /// Services; not written if empty.
    pub services: Vec<ListedService>,
}

impl NewEntry {
    /// Returns the entry that the file will have, at an unknown position.
    pub(super) fn expected(&self) -> Entry {
        Entry {
            name: self.name.clone(),
            name_text: printable(&self.name),
            address: self.address,
            is_static: self.is_static,
            bus: self.bus.clone(),
            uid: self.uid.clone(),
            services: (!self.services.is_empty()).then(|| self.services.clone()),
            has_ordered_services: true,
            position: super::Position::START,
            address_position: None,
            uid_position: None,
            index: 0,
            element: 0,
            present: super::entry::Present::default(),
        }
    }
}

/// Exact text of an entry's members before an edit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FormerMembers {
    pub(super) members: Vec<(Member, Option<String>)>,
    pub(super) entry: Box<Entry>,
}

/// A removed entry, with its text and the white space around it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemovedEntry {
    pub(super) entry: Box<Entry>,
    pub(super) text: String,
    /// Text between the previous element, or the bracket, and the entry.
    pub(super) before: String,
    /// Text between the entry and the next element, or the bracket.
    pub(super) after: String,
}

/// Content of a file without devices, and the operation that added the first one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FormerContent {
    pub(super) document: Document,
    pub(super) by: Box<Operation>,
}

impl Operation {
    /// Returns the operation that undoes this one. `before`: the document to which this one is
    /// applied.
    ///
    /// The inverse applies to the document that this operation makes. To undo the edit after later
    /// changes of the file, [`merge`](super::merge) the inverse from there. It restores the content
    /// and, if it is still known, the exact text. The inverse of an inverse redoes the edit.
    ///
    /// # Errors
    /// [`EditError::NotFound`] if `before` does not have the entry.
    pub fn inverse(&self, before: &Document) -> Result<Self, EditError> {
        let entries = before.entries();
        let key = match self {
            Self::Add { entry } => {
                return Ok(self.removal(EntryKey::among(&entry.expected(), entries), before));
            }
            Self::RestoreEntry { removed } => {
                let earlier = &entries[..before.entries_before(removed.entry.element)];
                return Ok(self.removal(EntryKey::among(&removed.entry, earlier), before));
            }
            Self::RemoveFirstEntry { former, .. } if former.before(before).is_some() => {
                return Ok((*former.by).clone());
            }
            Self::Remove { entry }
            | Self::RemoveFirstEntry { entry, .. }
            | Self::PinAddress { entry, .. }
            | Self::UnpinAddress { entry, .. }
            | Self::Rename { entry, .. }
            | Self::SetServices { entry, .. }
            | Self::RestoreMembers { entry, .. } => entry,
        };
        let index = before.require(key)?;
        if self.is_removal() {
            return Ok(Self::RestoreEntry { removed: before.removed(index) });
        }
        let former = before.former(index, &self.members());
        let mut meant = entries[index].clone();
        self.change(&mut meant);
        Ok(Self::RestoreMembers { entry: EntryKey::among(&meant, &entries[..index]), former })
    }

    /// Returns the entry concerned; `None` if the operation adds it.
    pub fn entry(&self) -> Option<&EntryKey> {
        match self {
            Self::Add { .. } | Self::RestoreEntry { .. } => None,
            Self::PinAddress { entry, .. }
            | Self::UnpinAddress { entry, .. }
            | Self::Remove { entry }
            | Self::RemoveFirstEntry { entry, .. }
            | Self::Rename { entry, .. }
            | Self::SetServices { entry, .. }
            | Self::RestoreMembers { entry, .. } => Some(entry),
        }
    }

    /// Returns the same operation, except that removing the first entry leaves an empty list.
    #[must_use]
    pub fn keeping_empty_list(self) -> Self {
        match self {
            Self::RemoveFirstEntry { entry, .. } => Self::Remove { entry },
            other => other,
        }
    }

    /// Returns the operation that removes the entry that this one adds to `before`.
    fn removal(&self, entry: EntryKey, before: &Document) -> Self {
        if before.elements().is_empty() {
            let by = Box::new(self.clone());
            Self::RemoveFirstEntry { entry, former: FormerContent { document: before.clone(), by } }
        } else {
            Self::Remove { entry }
        }
    }

    /// Returns true if it removes an entry.
    pub(super) fn is_removal(&self) -> bool {
        matches!(self, Self::Remove { .. } | Self::RemoveFirstEntry { .. })
    }

    /// Returns the entry concerned with its address: "SENS at 13". Safe on a terminal.
    pub fn subject(&self) -> String {
        let added = || self.added().map(|entry| EntryKey::of(&entry));
        let key = self.entry().cloned().or_else(added);
        key.map(|key| format!("{key:#}")).unwrap_or_default()
    }

    /// Returns the same operation for another entry, or for the same one under its newer key.
    pub(super) fn with_key(&self, key: EntryKey) -> Self {
        let mut operation = self.clone();
        match &mut operation {
            Self::Add { .. } | Self::RestoreEntry { .. } => {}
            Self::PinAddress { entry, .. }
            | Self::UnpinAddress { entry, .. }
            | Self::Remove { entry }
            | Self::RemoveFirstEntry { entry, .. }
            | Self::Rename { entry, .. }
            | Self::SetServices { entry, .. }
            | Self::RestoreMembers { entry, .. } => *entry = key,
        }
        operation
    }

    /// Returns the same operation with another address before the edit.
    pub(super) fn with_former_address(mut self, address: Option<u8>) -> Self {
        if let Self::PinAddress { from, .. } | Self::UnpinAddress { from, .. } = &mut self {
            *from = address;
        }
        self
    }

    /// Returns the entry that this adds; `None` if it adds none.
    pub(super) fn added(&self) -> Option<Entry> {
        match self {
            Self::Add { entry } => Some(entry.expected()),
            Self::RestoreEntry { removed } => Some((*removed.entry).clone()),
            _ => None,
        }
    }

    /// Returns the members that this changes in an entry; empty if it adds or removes one.
    pub(super) fn members(&self) -> Vec<Member> {
        match self {
            Self::PinAddress { .. } | Self::UnpinAddress { .. } => {
                vec![Member::Address, Member::Static]
            }
            Self::Rename { .. } => vec![Member::Name, Member::NameHex],
            Self::SetServices { .. } => vec![Member::Services],
            Self::RestoreMembers { former, .. } => {
                former.members.iter().map(|(member, _)| *member).collect()
            }
            Self::Add { .. }
            | Self::RestoreEntry { .. }
            | Self::Remove { .. }
            | Self::RemoveFirstEntry { .. } => Vec::new(),
        }
    }

    /// Applies the edit to the content of an entry.
    pub(super) fn change(&self, entry: &mut Entry) {
        match self {
            Self::PinAddress { to, .. } => {
                entry.address = Some(*to);
                entry.is_static = true;
            }
            Self::UnpinAddress { .. } => entry.is_static = false,
            Self::Rename { to, .. } => entry.name.clone_from(to),
            Self::SetServices { services, .. } => entry.services = Some(services.clone()),
            Self::RestoreMembers { former, .. } => {
                for (member, _) in &former.members {
                    former.copy(*member, entry);
                }
            }
            Self::Add { .. }
            | Self::RestoreEntry { .. }
            | Self::Remove { .. }
            | Self::RemoveFirstEntry { .. } => {}
        }
    }
}

impl FormerContent {
    /// Returns the document before the addition; `None` if anything else was changed since.
    pub(super) fn before(&self, after: &Document) -> Option<&Document> {
        let begun = self.document.apply(&self.by);
        begun.is_ok_and(|begun| begun == *after).then_some(&self.document)
    }
}

impl FormerMembers {
    /// Returns the address as the file had it, valid or not.
    fn address(&self) -> String {
        let written = || {
            let is_address = |(member, _): &&(Member, _)| *member == Member::Address;
            let (_, text) = self.members.iter().find(is_address)?;
            text.as_ref().map(|text| brief(text.as_bytes()))
        };
        let address = self.entry.address.map(|address| address.to_string());
        address.or_else(written).unwrap_or_else(|| "none".to_owned())
    }

    fn copy(&self, member: Member, to: &mut Entry) {
        let from = &self.entry;
        match member {
            Member::Name | Member::NameHex => to.name.clone_from(&from.name),
            Member::Address => to.address = from.address,
            Member::Static => to.is_static = from.is_static,
            Member::Services => to.services.clone_from(&from.services),
            Member::Bus => to.bus.clone_from(&from.bus),
            Member::Uid => to.uid.clone_from(&from.uid),
        }
    }
}

impl Document {
    /// Returns the index of the entry.
    ///
    /// # Errors
    /// [`EditError::NotFound`].
    pub(super) fn require(&self, key: &EntryKey) -> Result<usize, EditError> {
        self.find(key).ok_or_else(|| EditError::NotFound { entry: format!("{key:#}") })
    }

    /// Returns the number of entries before an index of the file's list.
    pub(super) fn entries_before(&self, element: usize) -> usize {
        self.entries().partition_point(|entry| entry.element < element)
    }

    fn former(&self, index: usize, members: &[Member]) -> FormerMembers {
        let present = Members::of(self.entry_text(index));
        let value = |member: &Member| present.as_ref()?.value(member.key()).map(str::to_owned);
        FormerMembers {
            members: members.iter().map(|member| (*member, value(member))).collect(),
            entry: Box::new(self.entries()[index].clone()),
        }
    }
}

impl fmt::Display for Operation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PinAddress { entry, from: Some(from), to } if from == to => {
                write!(f, "address of the entry {entry} pinned: {to}")
            }
            Self::PinAddress { entry, from: Some(from), to } => {
                write!(f, "address of the entry {entry}: {from} → {to}")
            }
            // No address before, or an invalid one.
            Self::PinAddress { entry, from: None, to } => {
                write!(f, "address of the entry {entry} set to {to}")
            }
            Self::UnpinAddress { entry, from: Some(from) } => {
                write!(f, "entry {entry} unpinned (was {from})")
            }
            Self::UnpinAddress { entry, from: None } => {
                write!(f, "entry {entry} unpinned")
            }
            Self::Add { entry: NewEntry { name, address: Some(address), .. } } => {
                write!(f, "new entry {} at {address}", brief(name))
            }
            Self::Add { entry } => write!(f, "new entry {}", brief(&entry.name)),
            Self::Remove { entry } | Self::RemoveFirstEntry { entry, .. } => {
                write!(f, "entry {entry:#} deleted")
            }
            Self::Rename { entry, to } => write!(f, "entry {entry:#} renamed to {}", brief(to)),
            Self::SetServices { entry, services } if services.len() == 1 => {
                write!(f, "services of the entry {entry:#}: 1 listed")
            }
            Self::SetServices { entry, services } => {
                write!(f, "services of the entry {entry:#}: {} listed", services.len())
            }
            Self::RestoreMembers { entry, former } => match former.members.first() {
                Some((Member::Address | Member::Static, _)) => write!(
                    f,
                    "address of the entry {entry} restored to {}{}",
                    former.address(),
                    if former.entry.is_static { "" } else { ", not static" }
                ),
                Some((Member::Name | Member::NameHex, _)) => {
                    write!(f, "entry {entry:#} renamed back to {}", brief(&former.entry.name))
                }
                _ => write!(f, "services of the entry {entry:#} restored"),
            },
            Self::RestoreEntry { removed } => {
                write!(f, "entry {:#} restored", EntryKey::of(&removed.entry))
            }
        }
    }
}
