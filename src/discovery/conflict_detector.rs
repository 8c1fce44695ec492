//! Evidence of collisions, from raw frames.
//!
//! Two devices at one address give themselves away in several ways: two answers to one
//! question, heartbeats at twice the rate in two phases, names, UIDs or service lists that
//! alternate. One such thing proves nothing: a reboot, a board swap or a bridge that doubles
//! frames looks the same for a moment. What it all amounts to is for [`super::finding_tracker`] to say.
//!
//! Knows the frames of one bus and nothing of rows, presence, or des.json.

use super::address_history::{
    AddressHistory, Alternation, HeartbeatPattern, PAIR_WINDOW, QueryParties,
};
use super::duplicate_frames::DuplicateFrameDetector;
use super::finding_text;
use super::finding_tracker::{EvidenceStrength, FindingTracker};
use crate::finding::FindingKind;
use crate::frame::{BusIndex, Frame};
use crate::text::{Escaped, Name};
use crate::time::{Duration, Instant};
use crate::wire::des::Request;
use crate::wire::framing::{Framing, strip_raw_padding};
use crate::wire::id::Address;
use crate::wire::isotp::{Pci, TransferFault};
use crate::wire::node::Uid;
use crate::wire::profile::UidProfile;
use std::borrow::Cow;

/// Heartbeats at twice the rate that are a suspicion: time enough for the follow-ups.
const DOUBLE_RATE_BEATS: u32 = 16;

/// For how many periods answers to questions that went out late may come.
const EXCUSED_PERIODS: u32 = 5;

/// An answer that begins.
#[derive(Clone, Copy, Debug)]
pub(super) struct ResponseStart {
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

#[derive(Debug)]
pub(super) struct ConflictDetector {
    period: Duration,
    passive: bool,
    /// The characters of UIDs, for the texts of evidence.
    alphabet: UidProfile,
    watches: Vec<AddressHistory>,
    duplicate_frames: DuplicateFrameDetector,
    finding_tracker: FindingTracker,
    /// Until then, an answer too many may be to a question that went out late.
    excused_until: Instant,
}

impl ConflictDetector {
    pub fn new(
        bus: BusIndex,
        period: Duration,
        passive: bool,
        alphabet: UidProfile,
        seed: u64,
    ) -> Self {
        Self {
            period,
            passive,
            alphabet,
            watches: (0..Address::COUNT).map(|_| AddressHistory::default()).collect(),
            duplicate_frames: DuplicateFrameDetector::new(period),
            finding_tracker: FindingTracker::new(bus, period, passive, seed),
            excused_until: Instant::ZERO,
        }
    }

    /// What has been found, and how sure it is.
    pub fn finding_tracker(&self) -> &FindingTracker {
        &self.finding_tracker
    }

    pub fn cases_mut(&mut self) -> &mut FindingTracker {
        &mut self.finding_tracker
    }

    /// Whether the question that goes to `address` now is to go to both kinds of nodes, because one
    /// in a working mode and one in another seem to share it. Not each time where their answers may
    /// be equal: those to the first question would wait behind the second one, and merge.
    pub fn needs_both_d_bits(&mut self, now: Instant, address: Address) -> bool {
        let lately =
            |seen: &Option<Instant>| seen.is_some_and(|at| now.since(at) < self.period * 12);
        let open = self.finding_tracker.is_open_at(address);
        let differ = self.finding_tracker.is_open(FindingKind::OneAddressTwoNames, address);
        let watch = &mut self.watches[address.index()];
        let both = open && watch.seen.iter().all(lately) && (differ || !watch.asked_both);
        watch.asked_both = both;
        both
    }

    // --- what was seen -------------------------------------------------------------------

    /// A question that reaches `address` passed by.
    pub fn note_request(
        &mut self,
        now: Instant,
        address: Address,
        request: Request,
        framing: Framing,
        asking: QueryParties,
    ) {
        self.finding_tracker.note_request(now, address);
        self.watches[address.index()].tally(request, framing).ask(now, asking);
    }

    /// A question to all passed by.
    pub fn note_broadcast(&mut self, now: Instant) {
        self.duplicate_frames.note_broadcast(now);
    }

    /// An answer begins.
    pub fn note_response(
        &mut self,
        now: Instant,
        response: ResponseStart,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let ResponseStart { from: address, to, request, framing, working, resolving } = response;
        let together = PAIR_WINDOW.min(self.period / 8);
        let watch = &mut self.watches[address.index()];
        if !resolving {
            watch.seen[usize::from(working)] = Some(now);
        }
        let tally = watch.tally(request, framing);
        let (to_all, extra) = tally.response(now, to, together, frame);
        if to_all {
            self.duplicate_frames.note_response(address, extra.is_some());
        }
        let excused = now < self.excused_until || self.duplicate_frames.asks_twice(now);
        let Some(extra) = extra.filter(|_| !excused) else { return };
        let first = extra.first;
        if first.same_on_wire(frame) {
            self.duplicate_frames.note_duplicate(now, extra.apart);
        }
        // Who is in no working mode may answer the question to the one kind of nodes and that to
        // the other.
        let weight = if extra.targeted || working {
            EvidenceStrength::Strong
        } else {
            EvidenceStrength::Weak
        };
        let differ = message(&first, framing) != message(frame, framing);
        let (kind, weight) = match request {
            Request::Name if differ => (FindingKind::OneAddressTwoNames, weight),
            _ if self.has_two_names(address) => (FindingKind::OneAddressTwoNames, weight),
            Request::Services if self.had_other_name(now, address) => {
                (FindingKind::OneAddressTwoNames, EvidenceStrength::Weak)
            }
            _ => (FindingKind::SameNameSameAddress, weight),
        };
        self.finding_tracker.report(
            now,
            kind,
            address,
            name,
            &first,
            "first response to one request",
            EvidenceStrength::Weak,
        );
        let at = self.finding_tracker.report(
            now,
            kind,
            address,
            name,
            frame,
            "second response to one request",
            weight,
        );
        self.finding_tracker.mark_response_based(at, address);
    }

    /// Questions that had waited for long went out all at once; devices may answer them one by one.
    pub fn ignore_extra_responses(&mut self, now: Instant) {
        self.excused_until = now + self.period * EXCUSED_PERIODS;
    }

    /// A whole name answer came from `address`.
    pub fn note_name(&mut self, now: Instant, address: Address, name: &Name, frame: &Frame) {
        let turn = self.alternation_timeout();
        let watch = &mut self.watches[address.index()];
        let before = watch.names.now.clone();
        let returned = watch.names.see(now, name, turn);
        let since = watch.names.since;
        let Some(before) = before.filter(|before| before != name) else { return };
        let kind = FindingKind::OneAddressTwoNames;
        let weight =
            if returned.is_some() { EvidenceStrength::Strong } else { EvidenceStrength::Weak };
        let what = format!("name {}", name.quoted());
        let at =
            self.finding_tracker.report(now, kind, address, Some(&before), frame, what, weight);
        self.finding_tracker.mark_response_based(at, address);
        self.finding_tracker.add_name(kind, address, name);
        if returned.is_some() {
            self.finding_tracker.backdate(now, at, since);
            self.finding_tracker.supersede(now, FindingKind::SameNameSameAddress, kind, address);
        }
    }

    /// A whole services answer came from `address`.
    pub fn note_services(
        &mut self,
        now: Instant,
        address: Address,
        digest: u64,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let turn = self.alternation_timeout();
        let services = &mut self.watches[address.index()].services;
        let returned = services.see(now, &digest, turn);
        let since = services.since;
        if returned.is_none() || self.has_two_names(address) {
            return;
        }
        let (kind, weight) = if self.had_other_name(now, address) {
            (FindingKind::OneAddressTwoNames, EvidenceStrength::Weak)
        } else {
            (FindingKind::SameNameSameAddress, EvidenceStrength::Strong)
        };
        let at = self.finding_tracker.report(
            now,
            kind,
            address,
            name,
            frame,
            "service lists alternate",
            weight,
        );
        self.finding_tracker.mark_response_based(at, address);
        self.finding_tracker.backdate(now, at, since);
    }

    /// A heartbeat came from `address`.
    pub fn note_heartbeat(
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
        let confirmed = self.finding_tracker.is_confirmed(identity, address);
        let alternation = match (uid_returned, mode_returned) {
            (Some(_), _) => {
                let uids = &self.watches[address.index()].uids;
                Some((self.uid_words(uids.now), self.uid_words(uids.before), uids_since))
            }
            (None, Some(returns)) if returns >= 2 && (rhythm.twice || confirmed) => {
                Some(("U bit changed back".into(), "U bit changed".into(), modes_since))
            }
            _ => None,
        };
        if let Some((again, other, since)) = alternation {
            // Later, the one before is the one that was told before.
            if let Some(previous) =
                previous.filter(|_| !self.finding_tracker.is_open(identity, address))
            {
                self.finding_tracker.report(
                    now,
                    identity,
                    address,
                    name,
                    &previous,
                    other,
                    EvidenceStrength::Weak,
                );
            }
            // Who only claims the address may yet give way.
            let weight = if resolving { EvidenceStrength::Weak } else { EvidenceStrength::Strong };
            let at =
                self.finding_tracker.report(now, identity, address, name, frame, again, weight);
            if !resolving {
                self.finding_tracker.backdate(now, at, since);
            }
        } else if !self.finding_tracker.is_open(identity, address) {
            self.note_heartbeat_pattern(now, address, name, frame, previous.as_ref(), rhythm);
        }
    }

    /// Heartbeats that nothing but their rhythm tells apart.
    fn note_heartbeat_pattern(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        frame: &Frame,
        previous: Option<&Frame>,
        rhythm: HeartbeatPattern,
    ) {
        let same = FindingKind::SameNameSameAddress;
        // A device that keeps to another period is looked into, and then left in peace; what is
        // confirmed by other means goes on as long as they come too often.
        let confirmed = self.finding_tracker.is_confirmed(same, address);
        let twice_for = self.watches[address.index()].twice_for;
        let odd_rate = rhythm.twice && (twice_for <= DOUBLE_RATE_BEATS || confirmed);
        let too_often = "heartbeats at twice the rate";
        let at = if (rhythm.phases || odd_rate) && self.had_other_name(now, address) {
            let two_names = FindingKind::OneAddressTwoNames;
            self.finding_tracker.report(
                now,
                two_names,
                address,
                name,
                frame,
                too_often,
                EvidenceStrength::Weak,
            )
        } else if rhythm.phases {
            if let Some(previous) = previous {
                let what = "heartbeat, phase 1";
                self.finding_tracker.report(
                    now,
                    same,
                    address,
                    name,
                    previous,
                    what,
                    EvidenceStrength::Weak,
                );
            }
            let what = "heartbeat, phase 2 of the same period";
            self.finding_tracker.report(
                now,
                same,
                address,
                name,
                frame,
                what,
                EvidenceStrength::Strong,
            )
        } else if odd_rate {
            self.finding_tracker.report(
                now,
                same,
                address,
                name,
                frame,
                too_often,
                EvidenceStrength::Weak,
            )
        } else {
            None
        };
        if let Some(since) = rhythm.since {
            self.finding_tracker.backdate(now, at, since);
        }
    }

    /// A frame of ours came back that the bus had already confirmed: something doubles frames.
    pub fn note_own_echo(&mut self, now: Instant) {
        self.duplicate_frames.note_own_echo(now);
    }

    /// Whether a frame from `source` only repeats one that was heard already, because something
    /// sends everything twice.
    pub fn is_copy(&mut self, now: Instant, source: Address, beat: bool, frame: &Frame) -> bool {
        if beat {
            let was_on = self.duplicate_frames.is_active(now);
            self.duplicate_frames.note_heartbeat(now, source, frame);
            if !was_on && self.duplicate_frames.is_active(now) {
                self.finding_tracker.reset_suspicion(FindingKind::SameNameSameAddress);
            }
        }
        self.duplicate_frames.is_copy(now, beat, frame)
    }

    /// Two addresses beat with one UID, each since the other's last heartbeat; both since `since`.
    pub fn note_same_uid(
        &mut self,
        now: Instant,
        (address, other): (Address, Address),
        since: Instant,
        frame: &Frame,
    ) {
        let (low, high) = (address.min(other), address.max(other));
        let kind = FindingKind::OneUidTwoAddresses;
        let what = "heartbeat with a UID in use at another address";
        let Some(at) = self.finding_tracker.report(
            now,
            kind,
            low,
            None,
            frame,
            what,
            EvidenceStrength::Strong,
        ) else {
            return;
        };
        self.finding_tracker.add_address(at, high);
        self.finding_tracker.backdate(now, Some(at), since);
    }

    /// Somebody else sent from the address we hold.
    pub fn note_own_address_used(&mut self, now: Instant, address: Address, frame: &Frame) {
        if address == Address::DEBUG {
            let kind = FindingKind::TwoDebugDevices;
            self.finding_tracker.report(
                now,
                kind,
                address,
                None,
                frame,
                finding_text::NOT_SENT_BY_DESCAN,
                EvidenceStrength::Strong,
            );
        }
    }

    /// An answer could not be used, or only in part.
    pub fn note_malformed(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        fault: &dyn std::fmt::Display,
        frame: &Frame,
    ) {
        let kind = FindingKind::MalformedAnswer;
        let what = "response, or its last frame";
        if let Some(at) = self.finding_tracker.report(
            now,
            kind,
            address,
            name,
            frame,
            what,
            EvidenceStrength::Proof,
        ) {
            self.finding_tracker
                .set_text(at, |who| format!("{who} sends malformed DES responses: {fault}."));
        }
    }

    /// An answer in several frames broke off where it did before. Three times in a row it may
    /// still be bad luck; then it is the device.
    pub fn note_aborted_response(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        fault: TransferFault,
        frame: &Frame,
    ) {
        let kind = FindingKind::MalformedAnswer;
        let weight = if self.finding_tracker.is_open(kind, address) {
            EvidenceStrength::Proof
        } else {
            EvidenceStrength::Weak
        };
        let what = "last frame of an aborted response";
        if let Some(at) = self.finding_tracker.report(now, kind, address, name, frame, what, weight)
        {
            self.finding_tracker
                .set_text(at, |who| format!("{who} aborts every multi-frame response: {fault}."));
        }
    }

    /// Whether questions seem to reach devices twice, or all frames us.
    pub fn has_duplicate_requests(&self, now: Instant) -> bool {
        self.duplicate_frames.asks_twice(now)
    }

    /// A whole answer came: what was malformed before is past.
    pub fn note_valid_response(&mut self, now: Instant, address: Address) {
        self.finding_tracker.clear(now, FindingKind::MalformedAnswer, address);
    }

    /// An identifier that is none of the nine types.
    pub fn note_non_conforming(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let what = "identifier with unknown message type";
        let kind = FindingKind::NonConforming;
        self.finding_tracker.report(now, kind, address, name, frame, what, EvidenceStrength::Proof);
    }

    /// The last heartbeat of `address` that is remembered.
    pub fn last_heartbeat(&self, address: Address) -> Option<Frame> {
        self.watches[address.index()].beats.back().map(|beat| beat.frame)
    }

    /// Everything at `address` is past: its node is lost.
    pub fn forget(&mut self, now: Instant, address: Address) {
        self.watches[address.index()] = AddressHistory::default();
        self.finding_tracker.forget(now, address);
    }

    /// The device at `address` was found elsewhere: what answers there now is no rival of it.
    pub fn note_left(&mut self, address: Address) {
        let watch = &mut self.watches[address.index()];
        watch.names = Alternation::default();
        watch.uids = Alternation::default();
        watch.services = Alternation::default();
    }

    // --- what is made of it ---------------------------------------------------------------

    /// The text of evidence that shows a heartbeat with this UID.
    fn uid_words(&self, uid: Option<Uid>) -> Cow<'static, str> {
        let text = uid.map_or(String::new(), |uid| uid.text(&self.alphabet).to_string());
        format!("UID {}", Escaped(text.as_bytes())).into()
    }

    /// Within which answers that take turns must be back.
    fn alternation_timeout(&self) -> Duration {
        if self.passive { self.finding_tracker.longest_memory() } else { self.period * 3 }
    }

    /// Whether two names take turns at `address`: whatever else its devices have in common, they
    /// are not of one name.
    fn has_two_names(&self, address: Address) -> bool {
        self.finding_tracker.has_strong(FindingKind::OneAddressTwoNames, address)
    }

    /// Whether another name answered from `address` not long ago: what tells of two devices there
    /// more likely tells of that one again than of two that share the present name.
    fn had_other_name(&self, now: Instant, address: Address) -> bool {
        let names = &self.watches[address.index()].names;
        let lately = names.before.is_some() && now.since(names.changed) < self.period * 30;
        lately || self.finding_tracker.is_open(FindingKind::OneAddressTwoNames, address)
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
