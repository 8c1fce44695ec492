//! What evidence of collisions amounts to: findings, how sure each of them is, when to look into it
//! again, and when it is over.
//!
//! One piece of evidence proves nothing: a finding begins as *suspected*, is followed up by
//! questions, and is *confirmed* only by strong evidence that goes on for five periods; what ends
//! sooner because a device gave way is told as a contested address.
//!
//! Does not know what is evidence: [`super::conflict_detector`] does.

use super::finding_text;
use crate::finding::{Confidence, Evidence, Finding, FindingKey, FindingKind};
use crate::frame::{BusIndex, Frame};
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use std::borrow::Cow;

/// How many findings a bus may have.
const MAX_FINDINGS: usize = 512;
/// After how long a suspicion is followed up, and again, by a question.
const CHECK: Duration = Duration::from_secs(1);
/// Questions that follow up a suspicion.
const MAX_FOLLOW_UPS: u32 = 6;
/// After how many periods without a question new evidence for a suspicion is followed up again.
const ASK_AGAIN_PERIODS: u32 = 3;
/// How often a collision that is confirmed is looked at again: often enough that it does not
/// seem to be over because two equal answers merged once.
const CHECK_AGAIN: Duration = Duration::from_secs(2);
/// For how many periods evidence of heartbeats may pause and still go on.
const PAUSE: f64 = 2.6;
/// The same of answers, since somebody asked: two questions.
const UNANSWERED_PERIODS: f64 = 1.75;
/// Observations that need no second device to explain them: one may be a stray frame.
const CONFIRM_AFTER_PROOFS: u32 = 2;
/// Strong pieces of evidence that, lasting long enough, confirm a collision.
const STRONG_CONFIRM: u32 = 3;

/// How much a piece of evidence weighs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum EvidenceStrength {
    /// An innocent cause is well possible.
    Weak,
    /// Only a second device explains it, if it goes on.
    Strong,
    /// An observation: what is seen is so, if it is seen again.
    Proof,
}

#[derive(Debug)]
struct TrackState {
    /// Since when there are two, as far as evidence that is more than a hint shows.
    began: Option<Instant>,
    strong: u32,
    strong_at: Option<Instant>,
    /// Whether answers gave it away, not heartbeats alone.
    responses: bool,
    follow_ups: u32,
    next_check: Option<Instant>,
    /// When it was followed up last.
    checked_at: Instant,
}

#[derive(Debug)]
pub(super) struct FindingTracker {
    bus: BusIndex,
    period: Duration,
    passive: bool,
    findings: Vec<Finding>,
    trackers: Vec<TrackState>,
    changed: Vec<(FindingKey, Confidence)>,
    /// When each address was asked the first time since answers told of a second device there.
    asked: [Option<Instant>; Address::COUNT],
    rng: fastrand::Rng,
    pub refused: u64,
}

impl FindingTracker {
    pub fn new(bus: BusIndex, period: Duration, passive: bool, seed: u64) -> Self {
        Self {
            bus,
            period,
            passive,
            findings: Vec::new(),
            trackers: Vec::new(),
            changed: Vec::new(),
            asked: [None; Address::COUNT],
            rng: fastrand::Rng::with_seed(!seed),
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
            .any(|f| f.confidence == Confidence::Suspected && f.key.kind.is_conflict())
    }

    /// Whether a collision at `address` is suspected or confirmed.
    pub fn is_open_at(&self, address: Address) -> bool {
        self.findings.iter().any(|finding| {
            finding.key.address == Some(address)
                && finding.key.kind.is_conflict()
                && finding.confidence != Confidence::Cleared
        })
    }

    /// Whether there is a change that [`poll_changed`](Self::poll_changed) will tell.
    pub fn has_changed(&self) -> bool {
        !self.changed.is_empty()
    }

    // --- what was seen -------------------------------------------------------------------

    /// A question that reaches `address` passed by.
    pub fn note_request(&mut self, now: Instant, address: Address) {
        self.asked[address.index()].get_or_insert(now);
    }

    /// What was reported just now of `address` is what answers tell: more is to be expected when
    /// somebody asks.
    pub fn mark_response_based(&mut self, at: Option<usize>, address: Address) {
        if let Some(at) = at {
            self.trackers[at].responses = true;
            self.asked[address.index()] = None;
        }
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
        let key = FindingKey::at(kind, self.bus, address);
        let at = if confidence == Confidence::Cleared {
            self.findings.iter().position(|finding| finding.key == key)?
        } else {
            self.open(now, key)?
        };
        self.set(now, at, confidence);
        self.findings.get_mut(at)
    }

    /// Frames were lost before they reached us: what is missing may have been there.
    pub fn note_lost_frames(&mut self, now: Instant, lost: u64) {
        let key = FindingKey::at(FindingKind::FramesLost, self.bus, None);
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
            if now >= self.expires_at(at) && expires_without_evidence(finding) {
                self.end(now, at);
                continue;
            }
            if !self.passive && self.trackers[at].next_check.is_some_and(|due| now >= due) {
                let confirmed = self.findings[at].confidence == Confidence::Confirmed;
                if let Some(address) = finding.key.address {
                    ask(address);
                }
                let next = now + self.with_jitter(if confirmed { CHECK_AGAIN } else { CHECK });
                let case = &mut self.trackers[at];
                case.follow_ups += 1;
                case.checked_at = now;
                let goes_on = confirmed || case.follow_ups < MAX_FOLLOW_UPS;
                case.next_check = goes_on.then_some(next);
            }
        }
    }

    pub fn poll_timeout(&self) -> Option<Instant> {
        self.findings
            .iter()
            .zip(&self.trackers)
            .enumerate()
            .filter(|(_, (finding, _))| finding.confidence != Confidence::Cleared)
            .filter(|(_, (finding, _))| expires_without_evidence(finding))
            .flat_map(|(at, (_, case))| {
                let check = if self.passive { None } else { case.next_check };
                [Some(self.expires_at(at)), check]
            })
            .flatten()
            .min()
    }

    /// Everything at `address` is past: its node is lost.
    pub fn forget(&mut self, now: Instant, address: Address) {
        self.asked[address.index()] = None;
        for at in 0..self.findings.len() {
            let finding = &self.findings[at];
            let concerned = finding.addresses.contains(&address);
            if concerned
                && finding.key.kind.is_conflict()
                && finding.confidence != Confidence::Cleared
            {
                self.end(now, at);
            }
        }
    }

    // --- findings ------------------------------------------------------------------------

    /// Evidence older than this is past: the cause is gone.
    fn evidence_lifetime(&self) -> Duration {
        if self.passive { self.period.mul_f64(7.5) } else { self.period * 5 }
    }

    /// The same where nobody asked since, when only answers would tell. Who only listens waits for
    /// others to ask, who may do so every ten periods.
    pub fn longest_memory(&self) -> Duration {
        if self.passive { self.period * 12 } else { self.evidence_lifetime() }
    }

    /// When a finding is over, if no more evidence comes.
    fn expires_at(&self, at: usize) -> Instant {
        let finding = &self.findings[at];
        let asked = finding.key.address.map(|address| self.asked[address.index()]);
        let usual = finding.last + self.evidence_lifetime();
        match asked {
            Some(None) if self.trackers[at].responses => finding.last + self.longest_memory(),
            // Give it time to answer.
            Some(Some(asked)) if self.trackers[at].responses => usual.max(asked + self.period),
            _ => usual,
        }
    }

    /// What was reported just now has been so since then.
    pub fn backdate(&mut self, now: Instant, at: Option<usize>, since: Instant) {
        if let Some(at) = at {
            let began = &mut self.trackers[at].began;
            *began = Some(began.map_or(since, |began| began.min(since)));
            self.update_confidence(now, at);
        }
    }

    fn find(&self, kind: FindingKind, address: Address) -> Option<usize> {
        self.findings.iter().position(|f| f.key.kind == kind && f.key.address == Some(address))
    }

    pub fn is_open(&self, kind: FindingKind, address: Address) -> bool {
        self.find(kind, address)
            .is_some_and(|at| self.findings[at].confidence != Confidence::Cleared)
    }

    pub fn is_confirmed(&self, kind: FindingKind, address: Address) -> bool {
        self.find(kind, address)
            .is_some_and(|at| self.findings[at].confidence == Confidence::Confirmed)
    }

    /// The finding with that key, opened (again) where it is not open.
    fn open(&mut self, now: Instant, key: FindingKey) -> Option<usize> {
        let check = now + self.with_jitter(CHECK);
        let case = TrackState {
            began: None,
            strong: 0,
            strong_at: None,
            responses: false,
            follow_ups: 0,
            checked_at: now,
            next_check: key.kind.is_conflict().then_some(check),
        };
        if let Some(at) = self.findings.iter().position(|finding| finding.key == key) {
            if self.findings[at].confidence == Confidence::Cleared {
                self.trackers[at] = case;
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
        self.trackers.push(case);
        Some(self.findings.len() - 1)
    }

    #[allow(clippy::too_many_arguments)]
    pub fn report(
        &mut self,
        now: Instant,
        kind: FindingKind,
        address: Address,
        name: Option<&Name>,
        frame: &Frame,
        what: impl Into<Cow<'static, str>>,
        weight: EvidenceStrength,
    ) -> Option<usize> {
        let key = FindingKey::at(kind, self.bus, Some(address));
        let at = self.open(now, key)?;
        if let Some(name) = name {
            self.findings[at].add_name(name);
        }
        let last = self.findings[at].last;
        self.findings[at].add(Evidence {
            time: frame.time,
            what: what.into(),
            frame: Some(*frame),
        });
        self.findings[at].last = now;
        let soon = now + self.with_jitter(CHECK / 4);
        let case = &mut self.trackers[at];
        // What is seen again only after it was looked for in vain begins anew.
        // Where answers tell, from when somebody asked.
        let asked = self.asked[address.index()];
        let (looked, pause) = match asked {
            _ if !case.responses => (Some(last), PAUSE),
            Some(asked) => (Some(asked.max(last)), UNANSWERED_PERIODS),
            None => (None, PAUSE),
        };
        let in_vain = looked.is_some_and(|since| now.since(since) >= self.period.mul_f64(pause));
        if in_vain && weight != EvidenceStrength::Proof && case.began.is_some() {
            case.began = None;
            case.strong = 0;
        }
        // Evidence counts once in half a period: it must go on, not come in a burst.
        let apart = case.strong_at.is_none_or(|last| now.since(last) >= self.period / 2);
        if weight != EvidenceStrength::Weak {
            case.began.get_or_insert(now);
        }
        if weight != EvidenceStrength::Weak && apart {
            case.strong += 1;
            case.strong_at = Some(now);
        }
        // Evidence that comes when the questions are used up is worth asking again.
        if kind.is_conflict()
            && case.next_check.is_none()
            && now.since(case.checked_at) >= self.period * ASK_AGAIN_PERIODS
        {
            case.follow_ups = 0;
            case.next_check = Some(soon);
        }
        self.describe(at);
        if weight == EvidenceStrength::Proof && self.trackers[at].strong >= CONFIRM_AFTER_PROOFS {
            self.set(now, at, Confidence::Confirmed);
        }
        if weight != EvidenceStrength::Weak {
            self.update_confidence(now, at);
        }
        Some(at)
    }

    /// Confirms a finding whose evidence is strong and went on for long enough.
    fn update_confidence(&mut self, now: Instant, at: usize) {
        let case = &self.trackers[at];
        // Five periods, as unsteady as heartbeats are.
        let enough = self.period.mul_f64(4.95);
        let lasts = case.began.is_some_and(|began| now.since(began) >= enough);
        if case.strong >= STRONG_CONFIRM && lasts {
            self.set(now, at, Confidence::Confirmed);
        }
    }

    /// Says what a finding is in other words, which may name who it is about.
    pub fn set_text(&mut self, at: usize, words: impl FnOnce(&str) -> String) {
        let finding = &mut self.findings[at];
        if let Some(address) = finding.key.address {
            finding.text = words(&finding_text::device_label(address, &finding.names));
        }
    }

    /// A finding is about another address too.
    pub fn add_address(&mut self, at: usize, address: Address) {
        let addresses = &mut self.findings[at].addresses;
        if !addresses.contains(&address) {
            addresses.push(address);
            addresses.sort_unstable();
            self.describe(at);
        }
    }

    /// Whether there is an open finding with evidence that is more than a hint.
    pub fn has_strong(&self, kind: FindingKind, address: Address) -> bool {
        self.find(kind, address).is_some_and(|at| {
            self.findings[at].confidence != Confidence::Cleared && self.trackers[at].strong > 0
        })
    }

    pub fn add_name(&mut self, kind: FindingKind, address: Address, name: &Name) {
        if let Some(at) = self.find(kind, address) {
            self.findings[at].add_name(name);
            self.describe(at);
        }
    }

    /// What made findings of that kind suspected has another explanation.
    pub fn reset_suspicion(&mut self, kind: FindingKind) {
        for (finding, case) in self.findings.iter().zip(&mut self.trackers) {
            if finding.key.kind == kind && finding.confidence == Confidence::Suspected {
                case.began = None;
                case.strong = 0;
            }
        }
    }

    /// What looked like `old` turns out to be `new`: it began then, and is told as that alone.
    pub fn supersede(
        &mut self,
        now: Instant,
        old: FindingKind,
        new: FindingKind,
        address: Address,
    ) {
        let (Some(old), Some(new)) = (self.find(old, address), self.find(new, address)) else {
            return;
        };
        if self.findings[old].confidence != Confidence::Cleared {
            if now.since(self.findings[old].last) < self.period.mul_f64(PAUSE) {
                let (before, began) = (self.trackers[old].began, self.trackers[new].began);
                self.trackers[new].began = before.into_iter().chain(began).min();
                self.trackers[new].strong += self.trackers[old].strong;
            }
            self.set(now, old, Confidence::Cleared);
            self.update_confidence(now, new);
        }
    }

    pub fn clear(&mut self, now: Instant, kind: FindingKind, address: Address) {
        if let Some(at) = self.find(kind, address) {
            self.set(now, at, Confidence::Cleared);
        }
    }

    /// The evidence of a finding stopped.
    fn end(&mut self, now: Instant, at: usize) {
        let was_suspected = self.findings[at].confidence == Confidence::Suspected;
        // One answer too many, or one beat in between, is no contest.
        let least = u32::from(self.findings[at].key.kind == FindingKind::SameNameSameAddress);
        let gave_way = was_suspected && self.trackers[at].strong > least;
        self.set(now, at, Confidence::Cleared);
        let (kind, address) = (self.findings[at].key.kind, self.findings[at].key.address);
        let (true, true, Some(address)) = (gave_way, kind.is_conflict(), address) else { return };
        let key = FindingKey::at(FindingKind::AddressContested, self.bus, Some(address));
        let (names, evidence) =
            (self.findings[at].names.clone(), self.findings[at].evidence.clone());
        if let Some(contested) = self.open(now, key) {
            for name in &names {
                self.findings[contested].add_name(name);
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
        if confidence == Confidence::Confirmed && finding.key.kind.is_conflict() {
            self.trackers[at].next_check = Some(now + self.with_jitter(CHECK_AGAIN));
        }
    }

    /// About as long. What beats each second would otherwise hold up the two answers each time, and
    /// so would the questions of others who inspect the bus and saw what we saw: equal answers that
    /// wait together merge.
    fn with_jitter(&mut self, wait: Duration) -> Duration {
        wait.mul_f64(0.9 + 0.2 * self.rng.f64())
    }

    fn describe(&mut self, at: usize) {
        finding_text::describe(&mut self.findings[at]);
    }
}

/// Whether a finding is over when no more evidence comes. Malformed answers are not: only a
/// sound one ends them, and a device is not asked often. Of errors, [`super::errors`] judges.
fn expires_without_evidence(finding: &Finding) -> bool {
    match finding.key.kind {
        FindingKind::BusErrors => false,
        FindingKind::MalformedAnswer => finding.confidence != Confidence::Confirmed,
        _ => true,
    }
}
