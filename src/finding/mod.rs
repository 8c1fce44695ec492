//! Findings: what is wrong on a bus or in des.json, how certain that is, and the frames that prove
//! it. [`FindingKind`] lists every kind with its properties in one table.
//!
//! Plain values. Does not know how evidence is collected (`discovery`) nor how des.json is compared
//! with the bus (`app`).

mod kind;

pub use kind::{CheckSection, ExitCodeScope, FindingKind, FindingKindInfo, Grouping, Wording};

use crate::frame::{BusIndex, Frame};
use crate::text::{Escaped, Name};
use crate::time::Instant;
use crate::wire::id::{Address, Header};
use crate::wire::node::{Uid, UidText};
use std::borrow::Cow;
use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;

/// State of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FindingState {
    /// The cause is gone, or no more evidence was seen.
    Cleared,
    /// There is evidence, but a harmless cause is possible.
    Suspected,
    /// There is evidence that a harmless cause does not explain.
    Confirmed,
}

impl FindingState {
    /// Returns the name in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cleared => "cleared",
            Self::Suspected => "suspected",
            Self::Confirmed => "confirmed",
        }
    }
}

impl fmt::Display for FindingState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// One observation that supports a finding.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Evidence {
    /// Time of the observation.
    pub time: Instant,
    /// Description, for the screen and for JSON.
    pub description: Cow<'static, str>,
    /// Frame observed; `None` where there is none, as for lost frames.
    pub frame: Option<Frame>,
}

impl Evidence {
    /// Returns true if both show the same of the same sender.
    fn shows_same(&self, other: &Self) -> bool {
        let sender = |evidence: &Self| {
            let id = evidence.frame.as_ref().and_then(Frame::platform_id);
            id.map(|id| Header::decode(id).source)
        };
        self.description == other.description && sender(self) == sender(other)
    }
}

/// A UID in the heartbeats that a finding is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct SeenUid {
    /// The UID, not blank.
    pub uid: Uid,
    /// Its text in the alphabet of the bus.
    pub text: UidText,
    /// Time of its first heartbeat from the address, after its last absence of more than five periods.
    pub since: Instant,
    /// Time of its first heartbeat from the address, before any absence; `since` if it had none.
    pub first: Instant,
}

impl SeenUid {
    /// Returns true if it was at the address before, then absent, and came back.
    pub fn has_returned(&self) -> bool {
        self.first < self.since
    }

    /// Returns the text with all characters printable.
    pub fn label(&self) -> String {
        Escaped(self.text.to_string().as_bytes()).to_string()
    }
}

/// Identity of a finding: one of a kind for one address (or pair of addresses) on one bus.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub struct FindingKey {
    /// Kind of the finding.
    pub kind: FindingKind,
    /// Bus concerned; `None` where the finding is about des.json alone.
    pub bus: Option<BusIndex>,
    /// Address concerned, the lowest of several; `None` where no address is known.
    pub address: Option<Address>,
    /// Name concerned, where several names can have a finding of this kind at one address.
    pub name: Option<Name>,
    /// Fault in des.json in few words, where one entry can have several.
    pub fault: Option<Arc<str>>,
}

impl FindingKey {
    /// Creates the key of a finding that is the only one of its kind at an address, or on a bus
    /// where `address` is `None`.
    pub const fn at(kind: FindingKind, bus: BusIndex, address: Option<Address>) -> Self {
        Self { kind, bus: Some(bus), address, name: None, fault: None }
    }

    /// Returns the texts for this kind, with or without an address.
    pub const fn wording(&self) -> &'static Wording {
        let facts = self.kind.facts();
        match (self.address, &facts.at_address) {
            (Some(_), Some(wording)) => wording,
            _ => &facts.wording,
        }
    }
}

/// A fault with its evidence, open or cleared.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Finding {
    /// Identity.
    pub key: FindingKey,
    /// State.
    pub state: FindingState,
    /// All addresses concerned, in ascending order.
    pub addresses: Vec<Address>,
    /// Names concerned, each once, at most 8.
    pub names: Vec<Name>,
    /// UIDs in the heartbeats of the addresses concerned, each once, at most 8, the first one
    /// first.
    pub uids: Vec<SeenUid>,
    /// Time of the first evidence.
    pub first: Instant,
    /// Time since when the evidence shows two senders, which may be later than the first frame of it;
    /// `None` where none is that strong.
    pub began: Option<Instant>,
    /// Time of the last evidence.
    pub last: Instant,
    /// Time of the last change of `state`.
    pub changed: Instant,
    /// Number of observations, including those that [`Self::evidence`] no longer stores; of lost
    /// frames, their number.
    pub count: u64,
    /// Evidence stored, oldest first: the first and the last observations, at least one of each
    /// sender and at most [`Finding::MAX_EVIDENCE`].
    pub evidence: VecDeque<Evidence>,
    /// True if it was confirmed since it began, and so is not only suspected, or was.
    pub was_confirmed: bool,
    /// Kind of the finding that explains the evidence of this one, which was cleared for it.
    pub superseded_by: Option<FindingKind>,
    /// True if one device that sends its frames twice does not explain the evidence.
    pub excludes_one_device: bool,
    /// Line and column in des.json, from 1; `None` where the finding is not about a place in it.
    pub position: Option<(usize, usize)>,
    /// What is wrong, as one sentence.
    pub text: String,
    /// What to do, likeliest cause first; may be empty.
    pub remedy: String,
}

impl Finding {
    /// Maximum number of observations stored.
    pub const MAX_EVIDENCE: usize = 8;

    /// Creates a suspected finding without evidence.
    pub fn new(key: FindingKey, now: Instant) -> Self {
        Self {
            addresses: key.address.into_iter().collect(),
            names: key.name.iter().cloned().collect(),
            key,
            state: FindingState::Suspected,
            uids: Vec::new(),
            was_confirmed: false,
            superseded_by: None,
            excludes_one_device: false,
            first: now,
            began: None,
            last: now,
            changed: now,
            count: 0,
            evidence: VecDeque::new(),
            position: None,
            text: String::new(),
            remedy: String::new(),
        }
    }

    /// Forgets what was observed before it was cleared: the fault is there again, from `now` on.
    pub(crate) fn begin_again(&mut self, now: Instant) {
        let Self { state, changed, position, .. } = *self;
        let (text, remedy) = (std::mem::take(&mut self.text), std::mem::take(&mut self.remedy));
        let new = Self::new(self.key.clone(), now);
        *self = Self { state, changed, position, text, remedy, ..new };
    }

    /// Adds an observation. When the store is full, the oldest of its second half is dropped that
    /// shows what another one shows, so the first observations stay and one of each sender.
    pub fn add_evidence(&mut self, evidence: Evidence) {
        // Evidence may be older than the finding: a frame that counts only with a later one.
        self.first = self.first.min(evidence.time);
        self.last = self.last.max(evidence.time);
        self.count += 1;
        if self.evidence.len() == Self::MAX_EVIDENCE {
            let half = Self::MAX_EVIDENCE / 2;
            let is_shown_elsewhere = |at: &usize| {
                let others = self.evidence.iter().enumerate().filter(|(other, _)| other != at);
                let mut others = others.map(|(_, other)| other).chain([&evidence]);
                others.any(|other| other.shows_same(&self.evidence[*at]))
            };
            let dropped = (half..Self::MAX_EVIDENCE).find(is_shown_elsewhere);
            self.evidence.remove(dropped.unwrap_or(half));
        }
        let later = self.evidence.iter().rev().take_while(|stored| stored.time > evidence.time);
        self.evidence.insert(self.evidence.len() - later.count(), evidence);
    }

    /// Adds a frame and its copy. When the store is full, the oldest pair of its second half is dropped.
    pub(crate) fn add_copied(&mut self, pair: [Evidence; 2]) {
        if self.evidence.len() + pair.len() > Self::MAX_EVIDENCE {
            let mut originals: Vec<Frame> = Vec::new();
            for frame in self.evidence.iter().filter_map(|stored| stored.frame) {
                if !originals.iter().any(|known| known.same_on_wire(&frame)) {
                    originals.push(frame);
                }
            }
            if let Some(dropped) = originals.get(originals.len() / 2) {
                let is_of_pair = |frame: &Frame| frame.same_on_wire(dropped);
                self.evidence.retain(|stored| !stored.frame.as_ref().is_some_and(is_of_pair));
            }
        }
        for evidence in pair {
            self.add_evidence(evidence);
        }
    }

    /// Time at which the finding was cleared; `None` if it is open.
    pub fn cleared_at(&self) -> Option<Instant> {
        (self.state == FindingState::Cleared).then_some(self.changed)
    }

    /// Returns true if this frame is stored as evidence.
    pub(crate) fn has_frame(&self, frame: &Frame) -> bool {
        let mut frames = self.evidence.iter().filter_map(|stored| stored.frame.as_ref());
        frames.any(|stored| stored == frame)
    }

    /// Returns true if evidence of the same sender that shows the same is stored.
    pub(crate) fn has_similar(&self, evidence: &Evidence) -> bool {
        self.evidence.iter().any(|stored| stored.shows_same(evidence))
    }

    /// Adds a name concerned, unless it is listed already or 8 names are.
    pub fn add_name(&mut self, name: &Name) {
        if !self.names.contains(name) && self.names.len() < 8 {
            self.names.push(name.clone());
        }
    }
}
