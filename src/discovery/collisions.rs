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

use super::doubling::Doubling;
use super::finding::{Confidence, Evidence, Finding, FindingKey, FindingKind};
use super::memory::{Alternation, Asking, Rhythm, TOGETHER, Watch};
use super::wording;
use crate::frame::{BusIndex, Frame};
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::des::Request;
use crate::wire::framing::{Framing, strip_raw_padding};
use crate::wire::id::Address;
use crate::wire::isotp::{Pci, TransferFault};
use crate::wire::node::Uid;

/// How many findings a bus may have.
const MAX_FINDINGS: usize = 512;
/// After how long a suspicion is followed up, and again, by a question.
const CHECK: Duration = Duration::from_secs(1);
/// Questions that follow up a suspicion.
const MAX_FOLLOW_UPS: u32 = 8;
/// After how many periods without a question new evidence for a suspicion is followed up again.
const ASK_AGAIN_PERIODS: u32 = 3;
/// How often a collision that is confirmed is looked at again: often enough that it does not
/// seem to be over because two equal answers merged once.
const CHECK_AGAIN: Duration = Duration::from_secs(2);
/// Heartbeats at twice the rate that are a suspicion: time enough for the follow-ups.
const ODD_RATE_BEATS: u32 = 16;
/// For how many periods evidence of heartbeats may pause and still go on.
const PAUSE: f64 = 2.6;
/// The same of answers, since somebody asked: two questions.
const ASKED_IN_VAIN: f64 = 1.75;
/// Observations that need no second device to explain them: one may be a stray frame.
const PROOFS_CONFIRM: u32 = 2;
/// Strong pieces of evidence that, lasting long enough, confirm a collision.
const STRONG_CONFIRM: u32 = 3;

/// An answer that begins.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answer {
    pub from: Address,
    /// Who asked, where the answer says it.
    pub to: Option<Address>,
    pub request: Request,
    pub framing: Framing,
    /// Whether a node in a working mode sends it.
    pub working: bool,
    /// Whether one that resolves its address does: in another mode for a moment only.
    pub resolving: bool,
}

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
    /// Since when there are two, as far as evidence that is more than a hint shows.
    began: Option<Instant>,
    strong: u32,
    strong_at: Option<Instant>,
    /// Whether answers gave it away, not heartbeats alone.
    answers: bool,
    follow_ups: u32,
    next_check: Option<Instant>,
    /// When it was followed up last.
    checked_at: Instant,
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
    doubling: Doubling,
    rng: fastrand::Rng,
    pub refused: u64,
}

impl Collisions {
    pub fn new(bus: BusIndex, period: Duration, passive: bool, seed: u64) -> Self {
        Self {
            rng: fastrand::Rng::with_seed(!seed),
            bus,
            period,
            passive,
            watches: (0..Address::COUNT).map(|_| Watch::default()).collect(),
            findings: Vec::new(),
            cases: Vec::new(),
            changed: Vec::new(),
            doubling: Doubling::new(period),
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

    /// Whether the question that goes to `address` now is to go to both kinds of nodes, because one
    /// in a working mode and one in another seem to share it. Not each time where their answers may
    /// be equal: those to the first question would wait behind the second one, and merge.
    pub fn asks_both_kinds(&mut self, now: Instant, address: Address) -> bool {
        let lately =
            |seen: &Option<Instant>| seen.is_some_and(|at| now.since(at) < self.period * 12);
        let open = self.is_open_at(address);
        let differ = self.is_open(FindingKind::OneAddressTwoNames, address);
        let watch = &mut self.watches[address.index()];
        let both = open && watch.seen.iter().all(lately) && (differ || !watch.asked_both);
        watch.asked_both = both;
        both
    }

    // --- what was seen -------------------------------------------------------------------

    /// A question that reaches `address` passed by.
    pub fn see_question(
        &mut self,
        now: Instant,
        address: Address,
        request: Request,
        framing: Framing,
        asking: Asking,
    ) {
        let watch = &mut self.watches[address.index()];
        watch.asked.get_or_insert(now);
        watch.tally(request, framing).ask(now, asking);
    }

    /// A question to all passed by.
    pub fn see_broadcast(&mut self, now: Instant) {
        self.doubling.see_broadcast(now);
    }

    /// An answer begins.
    pub fn see_answer(&mut self, now: Instant, answer: Answer, name: Option<&Name>, frame: &Frame) {
        let Answer { from: address, to, request, framing, working, resolving } = answer;
        let together = TOGETHER.min(self.period / 8);
        let watch = &mut self.watches[address.index()];
        if !resolving {
            watch.seen[usize::from(working)] = Some(now);
        }
        let tally = watch.tally(request, framing);
        let (to_all, extra) = tally.answer(now, to, together, frame);
        if to_all {
            self.doubling.see_answer(address, extra.is_some());
        }
        let Some(extra) = extra.filter(|_| !self.doubling.asks_twice(now)) else { return };
        let first = extra.first;
        // Who is in no working mode may answer the question to the one kind of nodes and that to
        // the other.
        let weight = if extra.targeted || working { Weight::Strong } else { Weight::Weak };
        let differ = message(&first, framing) != message(frame, framing);
        let (kind, weight) = match request {
            Request::Name if differ => (FindingKind::OneAddressTwoNames, weight),
            _ if self.has_two_names(address) => (FindingKind::OneAddressTwoNames, weight),
            Request::Services if self.had_another_name(now, address) => {
                (FindingKind::OneAddressTwoNames, Weight::Weak)
            }
            _ => (FindingKind::SameNameSameAddress, weight),
        };
        self.report(now, kind, address, name, &first, "first answer to one request", Weight::Weak);
        let at =
            self.report(now, kind, address, name, frame, "second answer to one request", weight);
        self.told_by_answers(at, address);
    }

    /// A whole name answer came from `address`.
    pub fn see_name(&mut self, now: Instant, address: Address, name: &Name, frame: &Frame) {
        let turn = self.turn();
        let watch = &mut self.watches[address.index()];
        let before = watch.names.now.clone();
        let returned = watch.names.see(now, name, turn);
        let since = watch.names.since;
        let Some(before) = before.filter(|before| before != name) else { return };
        let kind = FindingKind::OneAddressTwoNames;
        let weight = if returned.is_some() { Weight::Strong } else { Weight::Weak };
        let what = if returned.is_some() { "the other name again" } else { "another name" };
        let at = self.report(now, kind, address, Some(&before), frame, what, weight);
        self.told_by_answers(at, address);
        self.concern(kind, address, name);
        if returned.is_some() {
            self.began(now, at, since);
            self.supersede(now, FindingKind::SameNameSameAddress, kind, address);
        }
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
        let turn = self.turn();
        let services = &mut self.watches[address.index()].services;
        let returned = services.see(now, &digest, turn);
        let since = services.since;
        if returned.is_none() || self.has_two_names(address) {
            return;
        }
        let (kind, weight) = if self.had_another_name(now, address) {
            (FindingKind::OneAddressTwoNames, Weight::Weak)
        } else {
            (FindingKind::SameNameSameAddress, Weight::Strong)
        };
        let at = self.report(now, kind, address, name, frame, "service lists alternate", weight);
        self.told_by_answers(at, address);
        self.began(now, at, since);
    }

    /// A heartbeat came from `address`.
    pub fn see_heartbeat(
        &mut self,
        now: Instant,
        address: Address,
        uid: Option<Uid>,
        (working, resolving): (bool, bool),
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let period = self.period;
        let watch = &mut self.watches[address.index()];
        if !watch.beat(now, frame, period) {
            return;
        }
        if !resolving {
            watch.seen[usize::from(working)] = Some(now);
        }
        let previous = watch.beats.iter().rev().nth(1).map(|beat| beat.frame);
        let uid = uid.filter(|uid| !uid.is_blank());
        let uid_returned = uid.and_then(|uid| watch.uids.see(now, &uid, period * 3));
        // Two take turns with every heartbeat; a change that stays for longer is one's own.
        let mode_returned = watch.working.see(now, &working, period.mul_f64(1.05));
        let rhythm = watch.rhythm(period);
        watch.twice_for = if rhythm.twice { watch.twice_for + 1 } else { 0 };
        let (uids_since, modes_since) = (watch.uids.since, watch.working.since);

        let identity = if address == Address::DEBUG {
            FindingKind::TwoDebugDevices
        } else {
            FindingKind::OneAddressTwoIdentities
        };
        let confirmed = self.is_confirmed(identity, address);
        let alternation = match (uid_returned, mode_returned) {
            (Some(_), _) => Some(("the other UID again", "another UID", uids_since)),
            (None, Some(returns)) if returns >= 2 && (rhythm.twice || confirmed) => {
                Some(("the other U bit again", "another U bit", modes_since))
            }
            _ => None,
        };
        if let Some((again, other, since)) = alternation {
            // Later, the one before is the one that was told before.
            if let Some(previous) = previous.filter(|_| !self.is_open(identity, address)) {
                self.report(now, identity, address, name, &previous, other, Weight::Weak);
            }
            // Who only claims the address may yet give way.
            let weight = if resolving { Weight::Weak } else { Weight::Strong };
            let at = self.report(now, identity, address, name, frame, again, weight);
            if !resolving {
                self.began(now, at, since);
            }
        } else if !self.is_open(identity, address) {
            self.see_rhythm(now, address, name, frame, previous.as_ref(), rhythm);
        }
    }

    /// Heartbeats that nothing but their rhythm tells apart.
    fn see_rhythm(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        frame: &Frame,
        previous: Option<&Frame>,
        rhythm: Rhythm,
    ) {
        let same = FindingKind::SameNameSameAddress;
        // A device that keeps to another period is looked into, and then left in peace; what is
        // confirmed by other means goes on as long as they come too often.
        let confirmed = self.is_confirmed(same, address);
        let twice_for = self.watches[address.index()].twice_for;
        let odd_rate = rhythm.twice && (twice_for <= ODD_RATE_BEATS || confirmed);
        let too_often = "heartbeats at twice the rate";
        let at = if (rhythm.phases || odd_rate) && self.had_another_name(now, address) {
            let two_names = FindingKind::OneAddressTwoNames;
            self.report(now, two_names, address, name, frame, too_often, Weight::Weak)
        } else if rhythm.phases {
            if let Some(previous) = previous {
                let what = "heartbeat in one phase";
                self.report(now, same, address, name, previous, what, Weight::Weak);
            }
            let what = "heartbeat in another phase, within one period";
            self.report(now, same, address, name, frame, what, Weight::Strong)
        } else if odd_rate {
            self.report(now, same, address, name, frame, too_often, Weight::Weak)
        } else {
            None
        };
        if let Some(since) = rhythm.since {
            self.began(now, at, since);
        }
    }

    /// A frame of ours came back that the bus had already confirmed: something doubles frames.
    pub fn see_own_echo(&mut self, now: Instant) {
        self.doubling.see_own_echo(now);
    }

    /// Whether a frame from `source` only repeats one that was heard already, because something
    /// sends everything twice.
    pub fn is_copy(&mut self, now: Instant, source: Address, beat: bool, frame: &Frame) -> bool {
        if beat {
            self.doubling.see_heartbeat(now, source, frame);
        }
        self.doubling.is_copy(now, frame)
    }

    /// Two addresses beat with one UID, each since the other's last heartbeat; both since `since`.
    pub fn see_same_uid(
        &mut self,
        now: Instant,
        (address, other): (Address, Address),
        since: Instant,
        frame: &Frame,
    ) {
        let (low, high) = (address.min(other), address.max(other));
        let kind = FindingKind::OneUidTwoAddresses;
        let what = "heartbeat with the UID of another address";
        let Some(at) = self.report(now, kind, low, None, frame, what, Weight::Strong) else {
            return;
        };
        let addresses = &mut self.findings[at].addresses;
        if !addresses.contains(&high) {
            addresses.push(high);
            addresses.sort_unstable();
            self.describe(at);
        }
        self.began(now, Some(at), since);
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

    /// An answer in several frames broke off where it did before. Three times in a row it may
    /// still be bad luck; then it is the device.
    pub fn see_broken_answer(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        fault: TransferFault,
        frame: &Frame,
    ) {
        let kind = FindingKind::MalformedAnswer;
        let weight = if self.is_open(kind, address) { Weight::Proof } else { Weight::Weak };
        let what = "the last frame of an answer that broke off";
        if let Some(at) = self.report(now, kind, address, name, frame, what, weight) {
            self.findings[at].text = format!(
                "{} breaks its answer off each time: {fault}.",
                wording::who(address, &self.findings[at].names)
            );
        }
    }

    /// Whether questions seem to reach devices twice, or all frames us.
    pub fn asks_twice(&self, now: Instant) -> bool {
        self.doubling.asks_twice(now)
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
            if now >= self.fades(at) && passes(finding) {
                self.end(now, at);
                continue;
            }
            if !self.passive && self.cases[at].next_check.is_some_and(|due| now >= due) {
                let confirmed = self.findings[at].confidence == Confidence::Confirmed;
                if let Some(address) = finding.key.address {
                    ask(address);
                }
                let next = now + self.uneven(if confirmed { CHECK_AGAIN } else { CHECK });
                let case = &mut self.cases[at];
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
            .zip(&self.cases)
            .enumerate()
            .filter(|(_, (finding, _))| finding.confidence != Confidence::Cleared)
            .filter(|(_, (finding, _))| passes(finding))
            .flat_map(|(at, (_, case))| {
                let check = if self.passive { None } else { case.next_check };
                [Some(self.fades(at)), check]
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
        if self.passive { self.period.mul_f64(7.5) } else { self.period * 5 }
    }

    /// The same where nobody asked since, when only answers would tell. Who only listens waits for
    /// others to ask, who may do so every ten periods.
    fn longest_memory(&self) -> Duration {
        if self.passive { self.period * 12 } else { self.memory() }
    }

    /// Within which answers that take turns must be back.
    fn turn(&self) -> Duration {
        if self.passive { self.longest_memory() } else { self.period * 3 }
    }

    /// When a finding is over, if no more evidence comes.
    fn fades(&self, at: usize) -> Instant {
        let finding = &self.findings[at];
        let asked = finding.key.address.map(|address| self.watches[address.index()].asked);
        let usual = finding.last + self.memory();
        match asked {
            Some(None) if self.cases[at].answers => finding.last + self.longest_memory(),
            // Give it time to answer.
            Some(Some(asked)) if self.cases[at].answers => usual.max(asked + self.period),
            _ => usual,
        }
    }

    /// What was reported just now of `address` is what answers tell: more is to be expected when
    /// somebody asks.
    fn told_by_answers(&mut self, at: Option<usize>, address: Address) {
        if let Some(at) = at {
            self.cases[at].answers = true;
            self.watches[address.index()].asked = None;
        }
    }

    /// What was reported just now has been so since then.
    fn began(&mut self, now: Instant, at: Option<usize>, since: Instant) {
        if let Some(at) = at {
            let began = &mut self.cases[at].began;
            *began = Some(began.map_or(since, |began| began.min(since)));
            self.weigh(now, at);
        }
    }

    fn find(&self, kind: FindingKind, address: Address) -> Option<usize> {
        self.findings.iter().position(|f| f.key.kind == kind && f.key.address == Some(address))
    }

    fn is_open(&self, kind: FindingKind, address: Address) -> bool {
        self.find(kind, address)
            .is_some_and(|at| self.findings[at].confidence != Confidence::Cleared)
    }

    fn is_confirmed(&self, kind: FindingKind, address: Address) -> bool {
        self.find(kind, address)
            .is_some_and(|at| self.findings[at].confidence == Confidence::Confirmed)
    }

    /// The finding with that key, opened (again) where it is not open.
    fn open(&mut self, now: Instant, key: FindingKey) -> Option<usize> {
        let check = now + self.uneven(CHECK);
        let case = Case {
            began: None,
            strong: 0,
            strong_at: None,
            answers: false,
            follow_ups: 0,
            checked_at: now,
            next_check: key.kind.is_collision().then_some(check),
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
        let last = self.findings[at].last;
        self.findings[at].add(Evidence { time: frame.time, what, frame: Some(*frame) });
        self.findings[at].last = now;
        let soon = now + self.uneven(CHECK / 4);
        let case = &mut self.cases[at];
        // What is seen again only after it was looked for in vain begins anew.
        // Where answers tell, from when somebody asked.
        let asked = self.watches[address.index()].asked;
        let (looked, pause) = match asked {
            _ if !case.answers => (Some(last), PAUSE),
            Some(asked) => (Some(asked.max(last)), ASKED_IN_VAIN),
            None => (None, PAUSE),
        };
        let in_vain = looked.is_some_and(|since| now.since(since) >= self.period.mul_f64(pause));
        if in_vain && weight != Weight::Proof && case.began.is_some() {
            case.began = None;
            case.strong = 0;
        }
        // Evidence counts once in half a period: it must go on, not come in a burst.
        let apart = case.strong_at.is_none_or(|last| now.since(last) >= self.period / 2);
        if weight != Weight::Weak {
            case.began.get_or_insert(now);
        }
        if weight != Weight::Weak && apart {
            case.strong += 1;
            case.strong_at = Some(now);
        }
        // Evidence that comes when the questions are used up is worth asking again.
        if kind.is_collision()
            && case.next_check.is_none()
            && now.since(case.checked_at) >= self.period * ASK_AGAIN_PERIODS
        {
            case.follow_ups = 0;
            case.next_check = Some(soon);
        }
        self.describe(at);
        if weight == Weight::Proof && self.cases[at].strong >= PROOFS_CONFIRM {
            self.set(now, at, Confidence::Confirmed);
        }
        if weight != Weight::Weak {
            self.weigh(now, at);
        }
        Some(at)
    }

    /// Confirms a finding whose evidence is strong and went on for long enough.
    fn weigh(&mut self, now: Instant, at: usize) {
        let case = &self.cases[at];
        // Five periods, as unsteady as heartbeats are.
        let enough = self.period.mul_f64(4.95);
        let lasts = case.began.is_some_and(|began| now.since(began) >= enough);
        if case.strong >= STRONG_CONFIRM && lasts {
            self.set(now, at, Confidence::Confirmed);
        }
    }

    fn concern(&mut self, kind: FindingKind, address: Address, name: &Name) {
        if let Some(at) = self.find(kind, address) {
            self.findings[at].concern(name);
            self.describe(at);
        }
    }

    /// Whether two names take turns at `address`: whatever else its devices have in common, they
    /// are not of one name.
    fn has_two_names(&self, address: Address) -> bool {
        self.find(FindingKind::OneAddressTwoNames, address).is_some_and(|at| {
            self.findings[at].confidence != Confidence::Cleared && self.cases[at].strong > 0
        })
    }

    /// Whether another name answered from `address` not long ago: what tells of two devices there
    /// more likely tells of that one again than of two that share the present name.
    fn had_another_name(&self, now: Instant, address: Address) -> bool {
        let names = &self.watches[address.index()].names;
        let lately = names.before.is_some() && now.since(names.changed) < self.period * 30;
        lately || self.is_open(FindingKind::OneAddressTwoNames, address)
    }

    /// What looked like `old` turns out to be `new`: it began then, and is told as that alone.
    fn supersede(&mut self, now: Instant, old: FindingKind, new: FindingKind, address: Address) {
        let (Some(old), Some(new)) = (self.find(old, address), self.find(new, address)) else {
            return;
        };
        if self.findings[old].confidence != Confidence::Cleared {
            if now.since(self.findings[old].last) < self.period.mul_f64(PAUSE) {
                let (before, began) = (self.cases[old].began, self.cases[new].began);
                self.cases[new].began = before.into_iter().chain(began).min();
                self.cases[new].strong += self.cases[old].strong;
            }
            self.set(now, old, Confidence::Cleared);
            self.weigh(now, new);
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
        // One answer too many, or one beat in between, is no contest.
        let least = u32::from(self.findings[at].key.kind == FindingKind::SameNameSameAddress);
        let gave_way = was_suspected && self.cases[at].strong > least;
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
        if confidence == Confidence::Confirmed && finding.key.kind.is_collision() {
            self.cases[at].next_check = Some(now + self.uneven(CHECK_AGAIN));
        }
    }

    /// About as long. What beats each second would otherwise hold up the two answers each time, and
    /// so would the questions of others who inspect the bus and saw what we saw: equal answers that
    /// wait together merge.
    fn uneven(&mut self, wait: Duration) -> Duration {
        wait.mul_f64(0.9 + 0.2 * self.rng.f64())
    }

    fn describe(&mut self, at: usize) {
        wording::describe(&mut self.findings[at]);
    }
}

/// What the frame with which an answer begins says, without its padding.
fn message(frame: &Frame, framing: Framing) -> &[u8] {
    match (framing, Pci::decode(frame.data(), frame.fd)) {
        (Framing::Raw, _) => strip_raw_padding(frame.data()),
        (Framing::Isotp, Ok(Pci::Single(message))) => message,
        (Framing::Isotp, _) => frame.data(),
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
