//! Edits as values: what is to be changed, in whose entry, and how to take it back.

use std::fmt;

use super::entry::{Entry, ListedService, Member};
use super::layout::Members;
use super::text::brief;
use super::{Document, EditError};
use crate::text::printable;

/// One edit, as a person would name it.
///
/// It refers to entries by [`EntryKey`], not by place, so that it can be applied to newer content
/// of the file too; see [`merge`](super::merge). `Display` names it for the timeline and for undo,
/// safe on a terminal: "address of the entry FEED: 12 → 16".
///
/// Source: product, "Inline editing of des.json".
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Operation {
    /// Pins the address: writes `address`, and `static` true.
    SetAddress {
        /// Whose.
        entry: EntryKey,
        /// The address before.
        from: Option<u8>,
        /// 1 to 127.
        to: u8,
    },
    /// Unpins the address: `static` false. The address stays, as the last main address.
    ClearAddress {
        /// Whose.
        entry: EntryKey,
        /// The address before.
        from: Option<u8>,
    },
    /// A new entry at the end of the list, in the file's own style.
    Add {
        /// What it says.
        entry: NewEntry,
    },
    /// Takes the entry out.
    Remove {
        /// Which.
        entry: EntryKey,
    },
    /// Gives the entry another name.
    Rename {
        /// Which.
        entry: EntryKey,
        /// The new name's bytes.
        to: Vec<u8>,
    },
    /// Lists these services and no others, in the shape the entry or the file has for them.
    SetServices {
        /// Whose.
        entry: EntryKey,
        /// In the order in which they are to be listed.
        services: Vec<ListedService>,
    },
    /// Takes back an edit of members; made by [`Operation::inverse`].
    Restore {
        /// Whose.
        entry: EntryKey,
        /// What the members said before.
        former: FormerMembers,
    },
    /// Takes back a removal; made by [`Operation::inverse`].
    PutBack {
        /// What was taken out.
        removed: RemovedEntry,
    },
    /// Takes the first entry back; made by [`Operation::inverse`]. Where nothing was changed since,
    /// what stood in the place of the list comes back to the byte.
    TakeOutFirst {
        /// Which.
        entry: EntryKey,
        /// What was there before.
        former: FormerContent,
    },
}

/// How an entry is found again, wherever it has moved to in the list. See [`Document::key`].
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct EntryKey {
    /// As in [`Entry`].
    pub bus: Option<String>,
    /// As in [`Entry`].
    pub name: Vec<u8>,
    /// The address before the edit.
    pub address: Option<u8>,
    /// As in [`Entry`].
    pub uid: Option<String>,
    /// Which one, from 0, of several entries that are equal in all of the above.
    pub occurrence: usize,
}

impl EntryKey {
    /// The key of an entry that is the only one of its kind.
    pub fn of(entry: &Entry) -> Self {
        Self {
            bus: entry.bus.clone(),
            name: entry.name.clone(),
            address: entry.address,
            uid: entry.uid.clone(),
            occurrence: 0,
        }
    }

    /// Is this an entry that the key may mean, `occurrence` aside?
    pub(super) fn fits(&self, entry: &Entry) -> bool {
        // What is compared fastest comes first: it is asked for each pair of entries.
        self.address == entry.address
            && self.name == entry.name
            && self.bus == entry.bus
            && self.uid == entry.uid
    }

    /// The key of an entry, given those before it.
    pub(super) fn among(entry: &Entry, earlier: &[Entry]) -> Self {
        let mut key = Self::of(entry);
        key.occurrence = earlier.iter().filter(|other| key.fits(other)).count();
        key
    }
}

/// The name, and which one of equal entries it is; `{:#}` with the address, which tells twins apart:
/// "SENS at 13".
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

/// An entry that is to be added.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NewEntry {
    /// The name's bytes. A name that is not UTF-8 is written as printable text, and exactly in
    /// `name_hex`.
    pub name: Vec<u8>,
    /// 1 to 127.
    pub address: Option<u8>,
    /// Whether the address is pinned. False is written only where the file's other entries do.
    pub is_static: bool,
    /// Written when given.
    pub bus: Option<String>,
    /// Written when given.
    pub uid: Option<String>,
    /// Written when there are any.
    pub services: Vec<ListedService>,
}

impl NewEntry {
    /// What the file will say, at a place that is not known yet.
    pub(super) fn meant(&self) -> Entry {
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
            index: 0,
            element: 0,
            present: super::entry::Present::default(),
        }
    }
}

/// What an entry's members said before an edit, to the byte.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FormerMembers {
    pub(super) members: Vec<(Member, Option<String>)>,
    pub(super) entry: Box<Entry>,
}

/// An entry that was taken out, with its text and the blanks around it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemovedEntry {
    pub(super) entry: Box<Entry>,
    pub(super) text: String,
    /// Between the element before, or the bracket, and the entry.
    pub(super) before: String,
    /// Between the entry and the element behind, or the bracket.
    pub(super) after: String,
}

/// The content of a file without devices, and what brought the first one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FormerContent {
    pub(super) document: Document,
    pub(super) by: Box<Operation>,
}

impl Operation {
    /// The operation that takes this one back, as a new edit, given the document that this one is
    /// to be applied to.
    ///
    /// It holds for the document that this operation makes; to take the edit back later, when the
    /// file has been changed further, [`merge`](super::merge) it from there.
    ///
    /// Taking back restores what the file said, and the exact text where it is still known. The
    /// inverse of an inverse does the edit again.
    ///
    /// # Errors
    /// [`EditError::NotFound`] when `before` has no such entry.
    pub fn inverse(&self, before: &Document) -> Result<Self, EditError> {
        let entries = before.entries();
        let key = match self {
            Self::Add { entry } => {
                return Ok(self.removal(EntryKey::among(&entry.meant(), entries), before));
            }
            Self::PutBack { removed } => {
                let earlier = &entries[..before.entries_before(removed.entry.element)];
                return Ok(self.removal(EntryKey::among(&removed.entry, earlier), before));
            }
            Self::TakeOutFirst { former, .. } if former.before(before).is_some() => {
                return Ok((*former.by).clone());
            }
            Self::Remove { entry }
            | Self::TakeOutFirst { entry, .. }
            | Self::SetAddress { entry, .. }
            | Self::ClearAddress { entry, .. }
            | Self::Rename { entry, .. }
            | Self::SetServices { entry, .. }
            | Self::Restore { entry, .. } => entry,
        };
        let index = before.require(key)?;
        if self.is_removal() {
            return Ok(Self::PutBack { removed: before.removed(index) });
        }
        let former = before.former(index, &self.members());
        let mut meant = entries[index].clone();
        self.change(&mut meant);
        Ok(Self::Restore { entry: EntryKey::among(&meant, &entries[..index]), former })
    }

    /// The entry concerned, unless the operation brings it.
    pub fn entry(&self) -> Option<&EntryKey> {
        match self {
            Self::Add { .. } | Self::PutBack { .. } => None,
            Self::SetAddress { entry, .. }
            | Self::ClearAddress { entry, .. }
            | Self::Remove { entry }
            | Self::TakeOutFirst { entry, .. }
            | Self::Rename { entry, .. }
            | Self::SetServices { entry, .. }
            | Self::Restore { entry, .. } => Some(entry),
        }
    }

    /// The same, but that a list stays where the first entry is taken out.
    #[must_use]
    pub fn leaving_list(self) -> Self {
        match self {
            Self::TakeOutFirst { entry, .. } => Self::Remove { entry },
            other => other,
        }
    }

    /// What takes back an entry that this brings to `before`.
    fn removal(&self, entry: EntryKey, before: &Document) -> Self {
        if before.elements().is_empty() {
            let by = Box::new(self.clone());
            Self::TakeOutFirst { entry, former: FormerContent { document: before.clone(), by } }
        } else {
            Self::Remove { entry }
        }
    }

    /// Does it take an entry out?
    pub(super) fn is_removal(&self) -> bool {
        matches!(self, Self::Remove { .. } | Self::TakeOutFirst { .. })
    }

    /// The entry concerned, told from its twins: "SENS at 13". Safe on a terminal.
    pub fn subject(&self) -> String {
        let brought = || self.brought().map(|entry| EntryKey::of(&entry));
        let key = self.entry().cloned().or_else(brought);
        key.map(|key| format!("{key:#}")).unwrap_or_default()
    }

    /// The same for another entry, or for the same one under its newer key.
    pub(super) fn with_key(&self, key: EntryKey) -> Self {
        let mut operation = self.clone();
        match &mut operation {
            Self::Add { .. } | Self::PutBack { .. } => {}
            Self::SetAddress { entry, .. }
            | Self::ClearAddress { entry, .. }
            | Self::Remove { entry }
            | Self::TakeOutFirst { entry, .. }
            | Self::Rename { entry, .. }
            | Self::SetServices { entry, .. }
            | Self::Restore { entry, .. } => *entry = key,
        }
        operation
    }

    /// The same where the address was another one before.
    pub(super) fn with_former_address(mut self, address: Option<u8>) -> Self {
        if let Self::SetAddress { from, .. } | Self::ClearAddress { from, .. } = &mut self {
            *from = address;
        }
        self
    }

    /// The entry that this brings, if it brings one.
    pub(super) fn brought(&self) -> Option<Entry> {
        match self {
            Self::Add { entry } => Some(entry.meant()),
            Self::PutBack { removed } => Some((*removed.entry).clone()),
            _ => None,
        }
    }

    /// The members whose values this changes, in an entry that stays.
    pub(super) fn members(&self) -> Vec<Member> {
        match self {
            Self::SetAddress { .. } | Self::ClearAddress { .. } => {
                vec![Member::Address, Member::Static]
            }
            Self::Rename { .. } => vec![Member::Name, Member::NameHex],
            Self::SetServices { .. } => vec![Member::Services],
            Self::Restore { former, .. } => {
                former.members.iter().map(|(member, _)| *member).collect()
            }
            Self::Add { .. }
            | Self::PutBack { .. }
            | Self::Remove { .. }
            | Self::TakeOutFirst { .. } => Vec::new(),
        }
    }

    /// Does to an entry's meaning what the edit does to its text.
    pub(super) fn change(&self, entry: &mut Entry) {
        match self {
            Self::SetAddress { to, .. } => {
                entry.address = Some(*to);
                entry.is_static = true;
            }
            Self::ClearAddress { .. } => entry.is_static = false,
            Self::Rename { to, .. } => entry.name.clone_from(to),
            Self::SetServices { services, .. } => entry.services = Some(services.clone()),
            Self::Restore { former, .. } => {
                for (member, _) in &former.members {
                    former.copy(*member, entry);
                }
            }
            Self::Add { .. }
            | Self::PutBack { .. }
            | Self::Remove { .. }
            | Self::TakeOutFirst { .. } => {}
        }
    }
}

impl FormerContent {
    /// What was there before, if since then nothing was done but what brought the first entry.
    pub(super) fn before(&self, after: &Document) -> Option<&Document> {
        let begun = self.document.apply(&self.by);
        begun.is_ok_and(|begun| begun == *after).then_some(&self.document)
    }
}

impl FormerMembers {
    /// The address as the file had it: one that is none, too.
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
    /// The place of the entry, or why there is none.
    pub(super) fn require(&self, key: &EntryKey) -> Result<usize, EditError> {
        self.find(key).ok_or_else(|| EditError::NotFound { entry: format!("{key:#}") })
    }

    /// How many entries come before a place in the file's list.
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
            Self::SetAddress { entry, from: Some(from), to } if from == to => {
                write!(f, "address of the entry {entry} pinned: {to}")
            }
            Self::SetAddress { entry, from: Some(from), to } => {
                write!(f, "address of the entry {entry}: {from} → {to}")
            }
            // There was none, or something else that is none.
            Self::SetAddress { entry, from: None, to } => {
                write!(f, "address of the entry {entry} set to {to}")
            }
            Self::ClearAddress { entry, from: Some(from) } => {
                write!(f, "static address {from} of {entry} cleared")
            }
            Self::ClearAddress { entry, from: None } => {
                write!(f, "static address of {entry} cleared")
            }
            Self::Add { entry: NewEntry { name, address: Some(address), .. } } => {
                write!(f, "new entry {} at {address}", brief(name))
            }
            Self::Add { entry } => write!(f, "new entry {}", brief(&entry.name)),
            Self::Remove { entry } | Self::TakeOutFirst { entry, .. } => {
                write!(f, "entry {entry:#} removed")
            }
            Self::Rename { entry, to } => write!(f, "entry {entry:#} renamed to {}", brief(to)),
            Self::SetServices { entry, services } if services.len() == 1 => {
                write!(f, "services of the entry {entry:#}: 1 listed")
            }
            Self::SetServices { entry, services } => {
                write!(f, "services of the entry {entry:#}: {} listed", services.len())
            }
            Self::Restore { entry, former } => match former.members.first() {
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
            Self::PutBack { removed } => {
                write!(f, "entry {:#} restored", EntryKey::of(&removed.entry))
            }
        }
    }
}
