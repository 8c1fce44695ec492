//! Evidence of collisions, from raw frames, and what it amounts to.
//!
//! Two devices at one address give themselves away in several ways: two answers to one
//! question, heartbeats at twice the rate in two phases, names, UIDs or service lists that
//! alternate. One such thing proves nothing: a reboot, a board swap or a bridge that doubles
//! frames looks the same for a moment. So a finding begins as *suspected*, is followed up by
//! questions, and is *confirmed* only by strong evidence that goes on for five periods; what
//! ends sooner because a device gave way is told as a contested address.
//!
//! Knows the frames of one bus and nothing of rows, presence, or des.json.

use super::finding::{Confidence, Evidence, Finding, FindingKey, FindingKind};
use super::memory::{Alternation, BEATS, Beat, Watch};
use super::wording;
use crate::frame::{BusIndex, Frame};
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::des::Request;
use crate::wire::framing::Framing;
use crate::wire::id::Address;
use crate::wire::node::Uid;

/// How many findings a bus may have.
const MAX_FINDINGS: usize = 512;
/// Questions that follow up a suspicion, one a second.
const MAX_FOLLOW_UPS: u32 = 6;
/// Heartbeats at twice the rate that are a suspicion: time enough for the follow-ups.
const ODD_RATE_BEATS: u32 = 16;
/// Observations that need no second device to explain them: one may be a stray frame.
const PROOFS_CONFIRM: u64 = 2;
/// Strong pieces of evidence that, lasting long enough, confirm a collision.
const STRONG_CONFIRM: u32 = 3;

/// How much a piece of evidence weighs.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Weight {
    /// An innocent cause is well possible.
    Weak,
    /// Only a second device explains it, if it goes on.
    Strong,
    /// An observation: what is seen is so, if it is seen again.
    Proof,
}

#[derive(Debug)]
struct Case {
    began: Instant,
    strong: u32,
    strong_at: Option<Instant>,
    follow_ups: u32,
    next_check: Option<Instant>,
}

#[derive(Debug)]
pub(super) struct Collisions {
    bus: BusIndex,
    period: Duration,
    passive: bool,
    watches: Vec<Watch>,
    findings: Vec<Finding>,
    cases: Vec<Case>,
    changed: Vec<(FindingKey, Confidence)>,
    doubled_until: Instant,
    doubled_address: Option<Address>,
    pub refused: u64,
}

impl Collisions {
    pub fn new(bus: BusIndex, period: Duration, passive: bool) -> Self {
        Self {
            bus,
            period,
            passive,
            watches: (0..Address::COUNT).map(|_| Watch::default()).collect(),
            findings: Vec::new(),
            cases: Vec::new(),
            changed: Vec::new(),
            doubled_until: Instant::ZERO,
            doubled_address: None,
            refused: 0,
        }
    }

    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// A finding whose confidence changed since the last call.
    pub fn poll_changed(&mut self) -> Option<(FindingKey, Confidence)> {
        if self.changed.is_empty() { None } else { Some(self.changed.remove(0)) }
    }

    /// Whether any suspicion of a collision is open.
    pub fn is_suspicious(&self) -> bool {
        self.findings
            .iter()
            .any(|f| f.confidence == Confidence::Suspected && f.key.kind.is_collision())
    }

    /// Whether a collision at `address` is suspected or confirmed.
    pub fn is_open_at(&self, address: Address) -> bool {
        self.findings.iter().any(|finding| {
            finding.key.address == Some(address)
                && finding.key.kind.is_collision()
                && finding.confidence != Confidence::Cleared
        })
    }

    // --- what was seen -------------------------------------------------------------------

    /// A question that reaches `address` passed by.
    pub fn see_question(
        &mut self,
        now: Instant,
        address: Address,
        request: Request,
        framing: Framing,
        targeted: bool,
    ) {
        self.watches[address.index()].tally(request, framing).ask(now, targeted);
    }

    /// An answer from `address` begins.
    pub fn see_answer(
        &mut self,
        now: Instant,
        address: Address,
        request: Request,
        framing: Framing,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let extra = self.watches[address.index()].tally(request, framing).answer(now, frame);
        let Some((first, targeted)) = extra else { return };
        // Answers that differ tell of two names or two lists, which is another finding.
        if self.is_doubled(now, address) || !first.same_on_wire(frame) {
            return;
        }
        let weight = if targeted { Weight::Strong } else { Weight::Weak };
        let kind = FindingKind::SameNameSameAddress;
        self.report(now, kind, address, name, &first, "first answer to one request", Weight::Weak);
        self.report(now, kind, address, name, frame, "second answer to one request", weight);
    }

    /// A whole name answer came from `address`.
    pub fn see_name(&mut self, now: Instant, address: Address, name: &Name, frame: &Frame) {
        let memory = self.memory();
        let watch = &mut self.watches[address.index()];
        let before = watch.names.now.clone();
        let returned = watch.names.see(now, name, memory);
        let Some(before) = before.filter(|before| before != name) else { return };
        let kind = FindingKind::OneAddressTwoNames;
        let weight = if returned.is_some() { Weight::Strong } else { Weight::Weak };
        let what = if returned.is_some() { "the first name again" } else { "another name" };
        self.report(now, kind, address, Some(name), frame, what, weight);
        self.concern(kind, address, &before);
    }

    /// A whole services answer came from `address`.
    pub fn see_services(
        &mut self,
        now: Instant,
        address: Address,
        digest: u64,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let memory = self.memory();
        let returned = self.watches[address.index()].services.see(now, &digest, memory);
        if returned.is_some() {
            let kind = FindingKind::SameNameSameAddress;
            self.report(now, kind, address, name, frame, "service lists alternate", Weight::Strong);
        }
    }

    /// A heartbeat came from `address`.
    pub fn see_heartbeat(
        &mut self,
        now: Instant,
        address: Address,
        uid: Option<Uid>,
        working: bool,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let (memory, period) = (self.memory(), self.period);
        let watch = &mut self.watches[address.index()];
        if let Some(last) = watch.beats.back()
            && last.frame.same_on_wire(frame)
            && now.since(last.time) < period / 2
        {
            // RND7 and all: a bridge sent it twice.
            watch.doubled_until = now + period * 3;
            if self.doubled_address.is_some_and(|other| other != address) {
                self.doubled_until = now + period * 3;
            }
            self.doubled_address = Some(address);
            return;
        }
        if watch.beats.len() == BEATS {
            watch.beats.pop_front();
        }
        watch.beats.push_back(Beat { time: now, frame: *frame });
        let uid = uid.filter(|uid| !uid.is_blank());
        let uid_returned = uid.and_then(|uid| watch.uids.see(now, &uid, memory));
        let mode_returned = watch.working.see(now, &working, period * 2);
        let (twice, phases) = watch.rhythm(period);
        watch.twice_for = if twice { watch.twice_for + 1 } else { 0 };
        // A device that keeps to another period is looked into, and then left in peace.
        let odd_rate = twice && watch.twice_for <= ODD_RATE_BEATS;
        let previous = watch.beats.iter().rev().nth(1).map(|beat| beat.frame);

        let identity = if address == Address::DEBUG {
            FindingKind::TwoDebugDevices
        } else {
            FindingKind::OneAddressTwoIdentities
        };
        let alternation = match (uid_returned, mode_returned) {
            (Some(_), _) => Some(("the first UID again", "another UID")),
            (None, Some(returns)) if returns >= 2 && twice => {
                Some(("the first U bit again", "another U bit"))
            }
            _ => None,
        };
        if let Some((again, other)) = alternation {
            if let Some(previous) = previous {
                self.report(now, identity, address, name, &previous, other, Weight::Weak);
            }
            self.report(now, identity, address, name, frame, again, Weight::Strong);
        } else if phases && !self.is_open(identity, address) {
            let kind = FindingKind::SameNameSameAddress;
            let since = self.watches[address.index()].beats.front().map(|beat| beat.time);
            if let Some(previous) = previous {
                let what = "heartbeat in one phase";
                self.report(now, kind, address, name, &previous, what, Weight::Weak);
            }
            let what = "heartbeat in another phase, within one period";
            let at = self.report(now, kind, address, name, frame, what, Weight::Strong);
            if let (Some(at), Some(since)) = (at, since) {
                self.cases[at].began = self.cases[at].began.min(since);
            }
        } else if odd_rate && !self.is_open(identity, address) {
            let kind = FindingKind::SameNameSameAddress;
            self.report(
                now,
                kind,
                address,
                name,
                frame,
                "heartbeats at twice the rate",
                Weight::Weak,
            );
        }
    }

    /// A frame of ours came back that the bus had already confirmed: something doubles frames.
    pub fn see_own_echo(&mut self, now: Instant) {
        self.doubled_until = now + self.period * 3;
    }

    /// Two addresses beat with one UID, each since the other's last heartbeat.
    pub fn see_same_uid(&mut self, now: Instant, address: Address, other: Address, frame: &Frame) {
        let (low, high) = (address.min(other), address.max(other));
        let kind = FindingKind::OneUidTwoAddresses;
        let what = "heartbeat with the UID of another address";
        if let Some(at) = self.report(now, kind, low, None, frame, what, Weight::Strong) {
            let finding = &mut self.findings[at];
            if !finding.addresses.contains(&high) {
                finding.addresses.push(high);
                finding.addresses.sort_unstable();
            }
        }
    }

    /// Somebody else sent from the address we hold.
    pub fn see_rival(&mut self, now: Instant, address: Address, frame: &Frame) {
        if address == Address::DEBUG {
            let kind = FindingKind::TwoDebugDevices;
            self.report(now, kind, address, None, frame, wording::NOT_OURS, Weight::Strong);
        }
    }

    /// An answer could not be used, or only in part.
    pub fn see_malformed(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        fault: &dyn std::fmt::Display,
        frame: &Frame,
    ) {
        let kind = FindingKind::MalformedAnswer;
        let what = "the answer, or its last frame";
        if let Some(at) = self.report(now, kind, address, name, frame, what, Weight::Proof) {
            self.findings[at].text = format!(
                "{} answers with something that is no DES answer: {fault}.",
                wording::who(address, &self.findings[at].names)
            );
        }
    }

    /// A whole answer came: what was malformed before is past.
    pub fn see_sound_answer(&mut self, now: Instant, address: Address) {
        self.clear(now, FindingKind::MalformedAnswer, address);
    }

    /// An identifier that is none of the nine types.
    pub fn see_non_conforming(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let what = "an identifier that is none of the nine types";
        let kind = FindingKind::NonConforming;
        self.report(now, kind, address, name, frame, what, Weight::Proof);
    }

    /// What [`super::errors`] judged of the errors on the bus, or of those that follow one
    /// address. The finding comes back where there is one: evidence and words are its affair.
    pub fn judge_errors(
        &mut self,
        now: Instant,
        address: Option<Address>,
        confidence: Confidence,
    ) -> Option<&mut Finding> {
        let kind = FindingKind::BusErrors;
        let key = FindingKey { kind, bus: Some(self.bus), address, name: None };
        let at = if confidence == Confidence::Cleared {
            self.findings.iter().position(|finding| finding.key == key)?
        } else {
            self.open(now, key)?
        };
        self.set(now, at, confidence);
        self.findings.get_mut(at)
    }

    /// The last heartbeat of `address` that is remembered.
    pub fn last_heartbeat(&self, address: Address) -> Option<Frame> {
        self.watches[address.index()].beats.back().map(|beat| beat.frame)
    }

    /// Frames were lost before they reached us: what is missing may have been there.
    pub fn see_loss(&mut self, now: Instant, lost: u64) {
        let key = FindingKey {
            kind: FindingKind::FramesLost,
            bus: Some(self.bus),
            address: None,
            name: None,
        };
        if let Some(at) = self.open(now, key) {
            self.findings[at].count += lost;
            self.findings[at].last = now;
            self.describe(at);
            self.set(now, at, Confidence::Confirmed);
        }
    }

    // --- time ----------------------------------------------------------------------------

    /// Clears what no evidence was seen of for long enough. Addresses that are due to be asked
    /// who is there, to follow up a suspicion, come back through `ask`.
    pub fn handle_timeout(&mut self, now: Instant, mut ask: impl FnMut(Address)) {
        for at in 0..self.findings.len() {
            let finding = &self.findings[at];
            if finding.confidence == Confidence::Cleared {
                continue;
            }
            if now >= finding.last + self.memory() && passes(finding) {
                self.end(now, at);
                continue;
            }
            if !self.passive && self.cases[at].next_check.is_some_and(|due| now >= due) {
                let confirmed = finding.confidence == Confidence::Confirmed;
                if let Some(address) = finding.key.address {
                    ask(address);
                }
                let case = &mut self.cases[at];
                case.follow_ups += 1;
                case.next_check = if confirmed {
                    Some(now + Duration::from_secs(3))
                } else {
                    (case.follow_ups < MAX_FOLLOW_UPS).then(|| now + Duration::from_secs(1))
                };
            }
        }
    }

    pub fn poll_timeout(&self) -> Option<Instant> {
        self.findings
            .iter()
            .zip(&self.cases)
            .filter(|(finding, _)| finding.confidence != Confidence::Cleared)
            .filter(|(finding, _)| passes(finding))
            .flat_map(|(finding, case)| {
                let check = if self.passive { None } else { case.next_check };
                [Some(finding.last + self.memory()), check]
            })
            .flatten()
            .min()
    }

    /// Everything at `address` is past: its node is lost.
    pub fn forget(&mut self, now: Instant, address: Address) {
        self.watches[address.index()] = Watch::default();
        for at in 0..self.findings.len() {
            let finding = &self.findings[at];
            let concerned = finding.addresses.contains(&address);
            if concerned
                && finding.key.kind.is_collision()
                && finding.confidence != Confidence::Cleared
            {
                self.end(now, at);
            }
        }
    }

    /// The device at `address` was found elsewhere: what answers there now is no rival of it.
    pub fn note_left(&mut self, address: Address) {
        let watch = &mut self.watches[address.index()];
        watch.names = Alternation::default();
        watch.uids = Alternation::default();
        watch.services = Alternation::default();
    }

    /// Whether there is a change that [`poll_changed`](Self::poll_changed) will tell.
    pub fn has_changed(&self) -> bool {
        !self.changed.is_empty()
    }

    // --- findings ------------------------------------------------------------------------

    /// Evidence older than this is past: the cause is gone.
    fn memory(&self) -> Duration {
        if self.passive { self.period * 9 } else { self.period * 6 }
    }

    fn is_doubled(&self, now: Instant, address: Address) -> bool {
        now < self.doubled_until || now < self.watches[address.index()].doubled_until
    }

    fn find(&self, kind: FindingKind, address: Address) -> Option<usize> {
        self.findings.iter().position(|f| f.key.kind == kind && f.key.address == Some(address))
    }

    fn is_open(&self, kind: FindingKind, address: Address) -> bool {
        self.find(kind, address)
            .is_some_and(|at| self.findings[at].confidence != Confidence::Cleared)
    }

    /// The finding with that key, opened (again) where it is not open.
    fn open(&mut self, now: Instant, key: FindingKey) -> Option<usize> {
        let case = Case {
            began: now,
            strong: 0,
            strong_at: None,
            follow_ups: 0,
            next_check: key.kind.is_collision().then(|| now + Duration::from_secs(1)),
        };
        if let Some(at) = self.findings.iter().position(|finding| finding.key == key) {
            if self.findings[at].confidence == Confidence::Cleared {
                self.cases[at] = case;
                self.findings[at].evidence.clear();
                self.set(now, at, Confidence::Suspected);
            }
            return Some(at);
        }
        if self.findings.len() == MAX_FINDINGS {
            self.refused += 1;
            return None;
        }
        self.changed.push((key.clone(), Confidence::Suspected));
        self.findings.push(Finding::new(key, now));
        self.cases.push(case);
        Some(self.findings.len() - 1)
    }

    #[allow(clippy::too_many_arguments)]
    fn report(
        &mut self,
        now: Instant,
        kind: FindingKind,
        address: Address,
        name: Option<&Name>,
        frame: &Frame,
        what: &'static str,
        weight: Weight,
    ) -> Option<usize> {
        let key = FindingKey { kind, bus: Some(self.bus), address: Some(address), name: None };
        let at = self.open(now, key)?;
        if let Some(name) = name {
            self.findings[at].concern(name);
        }
        self.findings[at].add(Evidence { time: frame.time, what, frame: Some(*frame) });
        self.findings[at].last = now;
        let case = &mut self.cases[at];
        // Strong evidence counts once in half a period: it must go on, not come in a burst.
        let apart = case.strong_at.is_none_or(|last| now.since(last) >= self.period / 2);
        if weight == Weight::Strong && apart {
            case.strong += 1;
            case.strong_at = Some(now);
        }
        let lasting = now.since(case.began) >= self.period * 5;
        self.describe(at);
        if (weight == Weight::Proof && self.findings[at].count >= PROOFS_CONFIRM)
            || (self.cases[at].strong >= STRONG_CONFIRM && lasting)
        {
            self.set(now, at, Confidence::Confirmed);
        }
        Some(at)
    }

    fn concern(&mut self, kind: FindingKind, address: Address, name: &Name) {
        if let Some(at) = self.find(kind, address) {
            self.findings[at].concern(name);
            self.describe(at);
        }
    }

    fn clear(&mut self, now: Instant, kind: FindingKind, address: Address) {
        if let Some(at) = self.find(kind, address) {
            self.set(now, at, Confidence::Cleared);
        }
    }

    /// The evidence of a finding stopped.
    fn end(&mut self, now: Instant, at: usize) {
        let was_suspected = self.findings[at].confidence == Confidence::Suspected;
        let gave_way = was_suspected && self.cases[at].strong > 0;
        self.set(now, at, Confidence::Cleared);
        let (kind, address) = (self.findings[at].key.kind, self.findings[at].key.address);
        let (true, true, Some(address)) = (gave_way, kind.is_collision(), address) else { return };
        let key = FindingKey {
            kind: FindingKind::AddressContested,
            bus: Some(self.bus),
            address: Some(address),
            name: None,
        };
        let (names, evidence) =
            (self.findings[at].names.clone(), self.findings[at].evidence.clone());
        if let Some(contested) = self.open(now, key) {
            for name in &names {
                self.findings[contested].concern(name);
            }
            for piece in evidence {
                self.findings[contested].add(piece);
            }
            self.findings[contested].last = now;
            self.describe(contested);
        }
    }

    fn set(&mut self, now: Instant, at: usize, confidence: Confidence) {
        let finding = &mut self.findings[at];
        if finding.confidence == confidence {
            return;
        }
        finding.confidence = confidence;
        finding.changed = now;
        self.changed.push((finding.key.clone(), confidence));
        if confidence == Confidence::Confirmed {
            self.cases[at].next_check =
                finding.key.kind.is_collision().then(|| now + Duration::from_secs(3));
        }
    }

    fn describe(&mut self, at: usize) {
        wording::describe(&mut self.findings[at]);
    }
}

/// Whether a finding is over when no more evidence comes. Malformed answers are not: only a
/// sound one ends them, and a device is not asked often. Of errors, [`super::errors`] judges.
fn passes(finding: &Finding) -> bool {
    match finding.key.kind {
        FindingKind::BusErrors => false,
        FindingKind::MalformedAnswer => finding.confidence != Confidence::Confirmed,
        _ => true,
    }
}
