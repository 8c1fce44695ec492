//! Findings: what is wrong on a bus, how sure that is, and the frames that prove it.
//!
//! Does not decide what is a finding; that is the engine's (for the bus) and the app's (where
//! des.json is compared with the bus).

use crate::frame::{BusIndex, Frame};
use crate::text::Name;
use crate::time::Instant;
use crate::wire::id::Address;
use std::borrow::Cow;
use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;

/// What is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum FindingKind {
    SameNameSameAddress,
    OneAddressTwoNames,
    OneAddressTwoIdentities,
    OneUidTwoAddresses,
    StaticAddressTaken,
    WrongAddress,
    TwoDebugDevices,
    AddressContested,
    FileDuplicateAddress,
    FileDuplicateEntry,
    /// A value in des.json is not what it should be, and does not count.
    FileShape,
    Missing,
    Unlisted,
    /// An entry's device, known by its UID, has another name than the entry.
    NameDiffers,
    ServicesDiffer,
    NonConforming,
    MalformedAnswer,
    FramesLost,
    BusErrors,
}

impl FindingKind {
    /// The word for it, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SameNameSameAddress => "same-name-same-address",
            Self::OneAddressTwoNames => "one-address-two-names",
            Self::OneAddressTwoIdentities => "one-address-two-identities",
            Self::OneUidTwoAddresses => "one-uid-two-addresses",
            Self::StaticAddressTaken => "static-address-taken",
            Self::WrongAddress => "wrong-address",
            Self::TwoDebugDevices => "two-debug-devices",
            Self::AddressContested => "address-contested",
            Self::FileDuplicateAddress => "file-duplicate-address",
            Self::FileDuplicateEntry => "file-duplicate-entry",
            Self::FileShape => "file-shape",
            Self::Missing => "missing",
            Self::Unlisted => "unlisted",
            Self::NameDiffers => "name-differs",
            Self::ServicesDiffer => "services-differ",
            Self::NonConforming => "non-conforming",
            Self::MalformedAnswer => "malformed-answer",
            Self::FramesLost => "frames-lost",
            Self::BusErrors => "bus-errors",
        }
    }

    /// Whether it is a collision: two devices where one should be. Confirmed ones make `scan`
    /// exit with 1.
    pub const fn is_conflict(self) -> bool {
        matches!(
            self,
            Self::SameNameSameAddress
                | Self::OneAddressTwoNames
                | Self::OneAddressTwoIdentities
                | Self::OneUidTwoAddresses
                | Self::TwoDebugDevices
        )
    }

    /// How much it matters, highest first, for the order on the Problems page.
    pub const fn weight(self) -> u8 {
        match self {
            Self::SameNameSameAddress | Self::OneAddressTwoNames => 100,
            Self::OneAddressTwoIdentities | Self::OneUidTwoAddresses => 95,
            Self::TwoDebugDevices => 90,
            Self::BusErrors | Self::FramesLost => 85,
            Self::StaticAddressTaken => 80,
            Self::WrongAddress => 75,
            Self::AddressContested => 70,
            Self::Missing => 65,
            Self::FileDuplicateAddress | Self::FileDuplicateEntry | Self::FileShape => 60,
            Self::NameDiffers => 55,
            Self::ServicesDiffer => 50,
            Self::MalformedAnswer => 40,
            Self::NonConforming => 30,
            Self::Unlisted => 20,
        }
    }
}

impl fmt::Display for FindingKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// How sure a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Confidence {
    /// Its cause is gone.
    Cleared,
    /// There is evidence, but an innocent cause is possible.
    Suspected,
    /// Enough independent evidence.
    Confirmed,
}

impl Confidence {
    /// The word for it, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cleared => "cleared",
            Self::Suspected => "suspected",
            Self::Confirmed => "confirmed",
        }
    }
}

impl fmt::Display for Confidence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// One piece of evidence.
#[derive(Clone, Debug)]
pub struct Evidence {
    /// When it was seen.
    pub time: Instant,
    /// What it shows, in words.
    pub what: Cow<'static, str>,
    /// The frame that shows it.
    pub frame: Option<Frame>,
}

/// Which finding: one of a kind for one address (or pair of addresses) on one bus.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FindingKey {
    /// The kind.
    pub kind: FindingKind,
    /// The bus it is on; `None` where it is about des.json alone.
    pub bus: Option<BusIndex>,
    /// The address it is about, the lowest where there are several.
    pub address: Option<Address>,
    /// The device's name, where the finding is about one of several names at one address.
    pub name: Option<Name>,
    /// What it is about in des.json, in few words, where a name or a place may have several.
    pub part: Option<Arc<str>>,
}

impl FindingKey {
    /// That of the only one of its kind at an address, or on a bus.
    pub const fn at(kind: FindingKind, bus: BusIndex, address: Option<Address>) -> Self {
        Self { kind, bus: Some(bus), address, name: None, part: None }
    }
}

/// Something that is wrong, or was.
#[derive(Clone, Debug)]
pub struct Finding {
    /// Which one.
    pub key: FindingKey,
    /// How sure it is.
    pub confidence: Confidence,
    /// All addresses concerned, ascending.
    pub addresses: Vec<Address>,
    /// All names concerned.
    pub names: Vec<Name>,
    /// When its first evidence was seen.
    pub first: Instant,
    /// When its last evidence was seen.
    pub last: Instant,
    /// When its confidence changed last.
    pub changed: Instant,
    /// How many pieces of evidence there were; [`Self::evidence`] keeps the first and the last.
    pub count: u64,
    /// The evidence, oldest first: at most [`Finding::MAX_EVIDENCE`] pieces.
    pub evidence: VecDeque<Evidence>,
    /// The line and column of des.json that it is about, from 1.
    pub place: Option<(usize, usize)>,
    /// What is wrong, in a sentence.
    pub text: String,
    /// What to do about it.
    pub remedy: String,
}

impl Finding {
    /// How many pieces of evidence a finding keeps.
    pub const MAX_EVIDENCE: usize = 8;

    /// A finding without evidence yet.
    pub fn new(key: FindingKey, now: Instant) -> Self {
        Self {
            addresses: key.address.into_iter().collect(),
            names: key.name.iter().cloned().collect(),
            key,
            confidence: Confidence::Suspected,
            first: now,
            last: now,
            changed: now,
            count: 0,
            evidence: VecDeque::new(),
            place: None,
            text: String::new(),
            remedy: String::new(),
        }
    }

    /// Adds a piece of evidence; the first half of what is kept never goes.
    pub fn add(&mut self, evidence: Evidence) {
        // It may have been seen before it said anything by itself.
        self.first = self.first.min(evidence.time);
        self.last = self.last.max(evidence.time);
        self.count += 1;
        if self.evidence.len() == Self::MAX_EVIDENCE {
            self.evidence.remove(Self::MAX_EVIDENCE / 2);
        }
        self.evidence.push_back(evidence);
    }

    /// Notes names concerned, each once.
    pub fn add_name(&mut self, name: &Name) {
        if !self.names.contains(name) && self.names.len() < 8 {
            self.names.push(name.clone());
        }
    }
}
