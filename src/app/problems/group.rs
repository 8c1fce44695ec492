//! Problems: findings grouped to the rows of page 4.
//!
//! An address conflict causes several findings, which are one problem. A muted problem stays in
//! the list and does not count.

use crate::finding::{Finding, FindingKey, FindingKind, FindingState, Grouping, SeenUid};
use crate::frame::{BusIndex, Frame};
use crate::text::{Name, join_first};
use crate::time::Instant;
use crate::wire::id::Address;
use std::borrow::Cow;
use std::cmp::Reverse;

/// Number of UIDs in a headline; the others are counted.
const HEADLINE_UIDS: usize = 3;

/// Identity of a problem, stable while its findings change.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ProblemKey {
    /// All findings that an address conflict causes at one address of a bus.
    Address(BusIndex, Address),
    /// Any other finding is a problem by itself.
    Finding(FindingKey),
}

impl ProblemKey {
    /// Identity of the problem that a finding belongs to.
    pub fn of(key: &FindingKey) -> Self {
        let shared = key.kind.facts().grouping == Grouping::Address;
        match (key.bus, key.address) {
            (Some(bus), Some(address)) if shared => Self::Address(bus, address),
            _ => Self::Finding(key.clone()),
        }
    }
}

/// One or more findings with a common cause.
#[derive(Clone, Debug)]
pub struct Problem<'a> {
    /// Identity.
    pub key: ProblemKey,
    /// Its findings, at least one: by state, then by severity.
    pub findings: Vec<&'a Finding>,
    /// Muted by the user.
    pub is_muted: bool,
}

/// One piece of evidence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EvidenceItem {
    /// Time of its frame or event.
    pub time: Instant,
    /// Text, for the user.
    pub what: String,
    /// The frame; `None` for an event without one.
    pub frame: Option<Frame>,
}

/// Returns true if a finding concerns this address of this bus, or this name where no address is
/// known.
pub fn is_about(
    finding: &Finding,
    bus: Option<BusIndex>,
    address: Option<Address>,
    name: Option<&Name>,
) -> bool {
    let on_bus = finding.key.bus.is_none() || bus.is_none() || finding.key.bus == bus;
    let there = address.is_some_and(|it| finding.addresses.contains(&it));
    let named = name.is_none_or(|it| finding.names.is_empty() || finding.names.contains(it));
    let nowhere = finding.addresses.is_empty() || address.is_none();
    let so_named = name.is_some_and(|it| finding.names.contains(it));
    on_bus && (there && named || nowhere && so_named)
}

impl<'a> Problem<'a> {
    /// The first finding: most certain, most severe.
    pub fn head(&self) -> &'a Finding {
        self.findings[0]
    }

    /// State of the problem: that of the first finding.
    pub fn state(&self) -> FindingState {
        self.head().state
    }

    /// Time of the last change of the state.
    pub fn since(&self) -> Instant {
        let state = self.state();
        let moments = self.findings.iter().filter(|it| it.state == state);
        let moments = moments.map(|finding| finding.changed);
        // The problem is cleared when its last finding is cleared.
        let since = if state == FindingState::Cleared { moments.max() } else { moments.min() };
        since.unwrap_or(self.head().changed)
    }

    /// Returns true if the problem counts: neither cleared nor muted.
    pub fn is_open(&self) -> bool {
        !self.is_muted && self.state() != FindingState::Cleared
    }

    /// Bus; `None` for a problem of des.json alone.
    pub fn bus(&self) -> Option<BusIndex> {
        self.head().key.bus
    }

    /// Addresses, ascending, without duplicates.
    pub fn addresses(&self) -> Vec<Address> {
        let all = self.findings.iter().flat_map(|finding| &finding.addresses);
        let mut addresses: Vec<Address> = all.copied().collect();
        addresses.sort_unstable();
        addresses.dedup();
        addresses
    }

    /// Returns true if it is a conflict that is over and was never confirmed.
    pub fn was_only_suspected(&self) -> bool {
        self.state() == FindingState::Cleared
            && self.is_address_conflict()
            && !self.findings.iter().any(|finding| finding.was_confirmed)
    }

    /// Names, without duplicates.
    pub fn names(&self) -> Vec<&'a Name> {
        let mut names = Vec::new();
        for name in self.findings.iter().flat_map(|finding| &finding.names) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }

    /// Returns true if one of its findings [is about](is_about) this.
    pub fn is_about(
        &self,
        bus: Option<BusIndex>,
        address: Option<Address>,
        name: Option<&Name>,
    ) -> bool {
        self.findings.iter().any(|finding| is_about(finding, bus, address, name))
    }

    /// Time of the first evidence.
    pub fn first(&self) -> Instant {
        self.findings.iter().map(|it| it.first).min().unwrap_or(Instant::ZERO)
    }

    /// Time of the last evidence.
    pub fn last(&self) -> Instant {
        self.findings.iter().map(|it| it.last).max().unwrap_or(Instant::ZERO)
    }

    /// Returns true if the problem has evidence; a difference from the file has none.
    pub fn has_evidence(&self) -> bool {
        self.findings.iter().any(|finding| !finding.evidence.is_empty())
    }

    /// Number of pieces of evidence. [`Self::evidence`] returns only the first and the last ones of
    /// each finding.
    pub fn count(&self) -> u64 {
        self.findings.iter().map(|finding| finding.count).sum()
    }

    /// Stored evidence, oldest first; a frame that is evidence of two findings appears once.
    pub fn evidence(&self) -> Vec<EvidenceItem> {
        let mut pieces: Vec<EvidenceItem> = Vec::new();
        for evidence in self.findings.iter().flat_map(|finding| &finding.evidence) {
            let same = pieces.iter_mut().find(|piece| {
                piece.frame.is_some()
                    && piece.frame == evidence.frame
                    && piece.time == evidence.time
            });
            match same {
                Some(piece) if piece.what.contains(&*evidence.description) => {}
                Some(piece) => piece.what = format!("{}; {}", piece.what, evidence.description),
                None => pieces.push(EvidenceItem {
                    time: evidence.time,
                    what: evidence.description.to_string(),
                    frame: evidence.frame,
                }),
            }
        }
        pieces.sort_by_key(|piece| piece.time);
        pieces
    }

    /// Short text without addresses and names.
    pub fn headline(&self) -> Cow<'static, str> {
        let head = self.head();
        if let (Some((line, _)), Some(part)) = (head.position, &head.key.fault) {
            return format!("line {line}: {part}").into();
        }
        if head.key.kind == FindingKind::OneAddressTwoIdentities && head.uids.len() > 1 {
            let uids = head.uids.iter().map(SeenUid::label).collect();
            return format!("address conflict (UIDs {})", join_first(uids, HEADLINE_UIDS, ", "))
                .into();
        }
        head.key.wording().headline.into()
    }

    /// Short text with the addresses.
    pub fn title(&self) -> String {
        let words = std::iter::once(self.headline().into_owned());
        let places = self.addresses().into_iter().map(|address| format!("@{address}"));
        words.chain(places).collect::<Vec<String>>().join(" ")
    }

    /// Condition that confirms a suspected problem; `None` for any other, or without such a rule.
    pub fn confirmation_hint(&self) -> Option<&'static str> {
        let is_suspected = self.state() == FindingState::Suspected;
        self.head().key.wording().confirmation.filter(|_| is_suspected)
    }

    /// Text that stands for the remedy where there is none: empty once the problem is over; before an
    /// address conflict is confirmed, no board is to be unplugged.
    pub fn instead_of_remedy(&self) -> Option<&'static str> {
        const NOT_CONFIRMED: &str = "Not confirmed yet: unplug no board before it is";
        let is_suspected = self.state() == FindingState::Suspected;
        match self.ended() {
            Some(_) => Some(""),
            None => Some(NOT_CONFIRMED).filter(|_| is_suspected && self.is_address_conflict()),
        }
    }

    /// Sort key: confirmed, suspected, cleared, muted; by severity within each.
    pub(super) fn rank(&self) -> impl Ord + use<> {
        let head = self.head();
        let severity = Reverse(head.key.kind.severity());
        (self.is_muted, Reverse(head.state), severity, head.position, head.key.clone())
    }
}
