//! Conflict detector: finds evidence of address and UID conflicts in the frames of one bus. Input:
//! requests, responses and heartbeats with their frames; output: evidence for the finding tracker.
//!
//! Two devices at one address cause two responses to one request, heartbeats at twice the rate or
//! in two phases, and names, UIDs or service lists that alternate (protocol §5.2). One such
//! observation proves nothing: a reboot, a board swap or a bridge that repeats frames looks the
//! same for a moment. [`super::finding_tracker`] decides when a finding is confirmed.
//!
//! Does not know device rows, presence, or des.json.

use super::address_history::{
    AddressHistory, HeartbeatPattern, PAIR_WINDOW, RecentValues, RequestOrigin,
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

/// Consecutive heartbeats at twice the rate that count as evidence: enough time for the follow-up
/// requests.
const MAX_DOUBLE_RATE_HEARTBEATS: u32 = 16;

/// Periods after delayed requests in which surplus responses are ignored.
const DELAYED_RESPONSE_PERIODS: u32 = 5;

/// First frame of a response, decoded.
#[derive(Clone, Copy, Debug)]
pub(super) struct ResponseStart {
    pub from: Address,
    /// Requester; `None` where the response does not carry its address.
    pub to: Option<Address>,
    pub request: Request,
    pub framing: Framing,
    /// True if the sender is in a working mode (U bit).
    pub is_working: bool,
    /// True if the sender is resolving its address, that is in its mode for a moment only.
    pub is_resolving: bool,
}

/// Mode of a heartbeat's sender, as far as the U bit and address resolution show it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ModeFlags {
    /// True in a working mode, by the U bit.
    pub is_working: bool,
    /// True in INIT or ARSLV: the node is about to change its mode.
    pub is_resolving: bool,
}

/// Histories of all addresses of one bus, with the findings made from them.
#[derive(Debug)]
pub(super) struct ConflictDetector {
    period: Duration,
    listen_only: bool,
    /// Alphabet of UIDs, for the text of evidence.
    alphabet: UidProfile,
    histories: Vec<AddressHistory>,
    duplicate_frames: DuplicateFrameDetector,
    finding_tracker: FindingTracker,
    /// Surplus responses before this time may belong to delayed requests.
    ignore_surplus_until: Instant,
}

impl ConflictDetector {
    pub fn new(
        bus: BusIndex,
        period: Duration,
        listen_only: bool,
        alphabet: UidProfile,
        seed: u64,
    ) -> Self {
        Self {
            period,
            listen_only,
            alphabet,
            histories: (0..Address::COUNT).map(|_| AddressHistory::default()).collect(),
            duplicate_frames: DuplicateFrameDetector::new(period),
            finding_tracker: FindingTracker::new(bus, period, listen_only, seed),
            ignore_surplus_until: Instant::ZERO,
        }
    }

    /// Findings and their state.
    pub fn finding_tracker(&self) -> &FindingTracker {
        &self.finding_tracker
    }

    pub fn finding_tracker_mut(&mut self) -> &mut FindingTracker {
        &mut self.finding_tracker
    }

    /// Returns true if the request about to be sent to `address` is to be sent with both values of
    /// the D bit, because a working and a non-working node seem to share the address. Where their
    /// responses may be equal, only every other time: responses to the first request would wait
    /// behind the second request, and merge on the wire.
    pub fn needs_both_d_bits(&mut self, now: Instant, address: Address) -> bool {
        let recently =
            |seen: &Option<Instant>| seen.is_some_and(|at| now.since(at) < self.period * 12);
        let open = self.finding_tracker.is_open_at(address);
        let differ = self.finding_tracker.is_open(FindingKind::OneAddressTwoNames, address);
        let history = &mut self.histories[address.index()];
        let both = open && history.seen.iter().all(recently) && (differ || !history.sent_both);
        history.sent_both = both;
        both
    }

    // --- input --------------------------------------------------------------------------

    /// Notes a request that `address` receives.
    pub fn note_request(
        &mut self,
        now: Instant,
        address: Address,
        request: Request,
        framing: Framing,
        parties: RequestOrigin,
    ) {
        self.finding_tracker.note_request(now, address);
        self.histories[address.index()].matcher(request, framing).note_request(now, parties);
    }

    /// Notes a broadcast request.
    pub fn note_broadcast(&mut self, now: Instant) {
        self.duplicate_frames.note_broadcast(now);
    }

    /// Notes the first frame of a response.
    pub fn note_response(
        &mut self,
        now: Instant,
        response: ResponseStart,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let ResponseStart { from: address, to, request, framing, is_working, is_resolving } =
            response;
        let window = PAIR_WINDOW.min(self.period / 8);
        let history = &mut self.histories[address.index()];
        if !is_resolving {
            history.seen[usize::from(is_working)] = Some(now);
        }
        let matcher = history.matcher(request, framing);
        let (to_all, surplus) = matcher.match_response(now, to, window, frame);
        if to_all {
            self.duplicate_frames.note_response(address, surplus.is_some());
        }
        let ignored =
            now < self.ignore_surplus_until || self.duplicate_frames.has_duplicate_requests(now);
        let Some(surplus) = surplus.filter(|_| !ignored) else { return };
        let first = surplus.first;
        if first.same_on_wire(frame) {
            self.duplicate_frames.note_duplicate(now, surplus.apart);
        }
        // A non-working node may respond both to the request for working nodes and to that for
        // non-working ones.
        let strength = if surplus.is_targeted || is_working {
            EvidenceStrength::Strong
        } else {
            EvidenceStrength::Weak
        };
        let differ = message(&first, framing) != message(frame, framing);
        let (kind, strength) = match request {
            Request::Name if differ => (FindingKind::OneAddressTwoNames, strength),
            _ if self.has_two_names(address) => (FindingKind::OneAddressTwoNames, strength),
            Request::Services if self.had_other_name(now, address) => {
                (FindingKind::OneAddressTwoNames, EvidenceStrength::Weak)
            }
            _ => (FindingKind::SameNameSameAddress, strength),
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
            strength,
        );
        self.finding_tracker.mark_response_based(at, address);
    }

    /// Ignores surplus responses for some periods: requests that were delayed have been sent
    /// together, and devices may respond to each of them.
    pub fn ignore_surplus_responses(&mut self, now: Instant) {
        self.ignore_surplus_until = now + self.period * DELAYED_RESPONSE_PERIODS;
    }

    /// Notes a complete name response.
    pub fn note_name(&mut self, now: Instant, address: Address, name: &Name, frame: &Frame) {
        let timeout = self.alternation_timeout();
        let history = &mut self.histories[address.index()];
        let before = history.names.current().cloned();
        let returned = history.names.observe(now, name, timeout);
        let since = history.names.second_since();
        let Some(before) = before.filter(|before| before != name) else { return };
        let kind = FindingKind::OneAddressTwoNames;
        let strength =
            if returned.is_some() { EvidenceStrength::Strong } else { EvidenceStrength::Weak };
        let what = format!("name {}", name.quoted());
        let at =
            self.finding_tracker.report(now, kind, address, Some(&before), frame, what, strength);
        self.finding_tracker.mark_response_based(at, address);
        self.finding_tracker.add_name(kind, address, name);
        if returned.is_some() {
            self.finding_tracker.backdate(now, at, since);
            self.finding_tracker.supersede(now, FindingKind::SameNameSameAddress, kind, address);
        }
    }

    /// Notes a complete services response; `digest` is a hash of its message.
    pub fn note_services(
        &mut self,
        now: Instant,
        address: Address,
        digest: u64,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let timeout = self.alternation_timeout();
        let services = &mut self.histories[address.index()].services;
        let returned = services.observe(now, &digest, timeout);
        let since = services.second_since();
        if returned.is_none() || self.has_two_names(address) {
            return;
        }
        let (kind, strength) = if self.had_other_name(now, address) {
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
            strength,
        );
        self.finding_tracker.mark_response_based(at, address);
        self.finding_tracker.backdate(now, at, since);
    }

    /// Notes a heartbeat.
    pub fn note_heartbeat(
        &mut self,
        now: Instant,
        address: Address,
        uid: Option<Uid>,
        mode: ModeFlags,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let period = self.period;
        let history = &mut self.histories[address.index()];
        if !history.note_heartbeat(now, frame, period) {
            return;
        }
        if !mode.is_resolving {
            history.seen[usize::from(mode.is_working)] = Some(now);
        }
        let previous = history.heartbeats.iter().rev().nth(1).map(|heartbeat| heartbeat.frame);
        let uid = uid.filter(|uid| !uid.is_blank());
        let uid_returned = uid.and_then(|uid| history.uids.observe(now, &uid, period * 3));
        // Two devices alternate with every heartbeat; one device keeps a changed U bit for longer.
        let mode_returned = history.working.observe(now, &mode.is_working, period.mul_f64(1.05));
        let pattern = history.heartbeat_pattern(period);
        history.double_rate_count =
            if pattern.double_rate { history.double_rate_count + 1 } else { 0 };
        let (uids_since, modes_since) =
            (history.uids.second_since(), history.working.second_since());
        if history.has_several_senders(period) {
            self.finding_tracker.note_several_senders(now, address);
        }

        let identity = if address == Address::DEBUG {
            FindingKind::TwoDebugDevices
        } else {
            FindingKind::OneAddressTwoIdentities
        };
        let confirmed = self.finding_tracker.is_confirmed(identity, address);
        let alternation = match (uid_returned, mode_returned) {
            (Some(_), _) => {
                let uids = &self.histories[address.index()].uids;
                Some((self.uid_text(uids.current()), self.uid_text(uids.previous()), uids_since))
            }
            (None, Some(returns)) if returns >= 2 && (pattern.double_rate || confirmed) => {
                Some(("U bit changed back".into(), "U bit changed".into(), modes_since))
            }
            _ => None,
        };
        if let Some((again, other, since)) = alternation {
            // Once the finding is open, the previous heartbeat is already part of its evidence.
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
            // A device that is claiming the address may still give it up.
            let strength =
                if mode.is_resolving { EvidenceStrength::Weak } else { EvidenceStrength::Strong };
            let at =
                self.finding_tracker.report(now, identity, address, name, frame, again, strength);
            if !mode.is_resolving {
                self.finding_tracker.backdate(now, at, since);
            }
        } else if !self.finding_tracker.is_open(identity, address) {
            self.note_heartbeat_pattern(now, address, name, frame, previous.as_ref(), pattern);
        }
    }

    /// Notes the pattern of heartbeats whose content does not differ.
    fn note_heartbeat_pattern(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        frame: &Frame,
        previous: Option<&Frame>,
        pattern: HeartbeatPattern,
    ) {
        let same = FindingKind::SameNameSameAddress;
        // A single device with another period is followed up and then ignored; a conflict confirmed
        // by other means stays confirmed while the rate is double.
        let confirmed = self.finding_tracker.is_confirmed(same, address);
        let double_rate_count = self.histories[address.index()].double_rate_count;
        let is_supported =
            pattern.double_rate && self.finding_tracker.note_double_rate(now, same, address);
        let double_rate = pattern.double_rate
            && (double_rate_count <= MAX_DOUBLE_RATE_HEARTBEATS || confirmed || is_supported);
        let too_often = "heartbeats at twice the rate";
        let at = if (pattern.two_phases || double_rate) && self.had_other_name(now, address) {
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
        } else if pattern.two_phases {
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
        } else if double_rate {
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
        if let Some(since) = pattern.since {
            self.finding_tracker.backdate(now, at, since);
        }
    }

    /// Notes a frame sent by descan that was received again after its confirmation: frames are
    /// repeated.
    pub fn note_own_echo(&mut self, now: Instant) {
        self.duplicate_frames.note_own_echo(now);
    }

    /// Returns true if a frame from `source` is a repeated copy of an earlier one, while all frames
    /// are repeated.
    pub fn is_copy(
        &mut self,
        now: Instant,
        source: Address,
        is_heartbeat: bool,
        frame: &Frame,
    ) -> bool {
        if is_heartbeat {
            let was_active = self.duplicate_frames.is_active(now);
            self.duplicate_frames.note_heartbeat(now, source, frame);
            if !was_active && self.duplicate_frames.is_active(now) {
                self.finding_tracker.reset_suspicion(FindingKind::SameNameSameAddress);
            }
        }
        self.duplicate_frames.is_copy(now, is_heartbeat, frame)
    }

    /// Notes that two addresses send heartbeats with one UID, each after the last heartbeat of the
    /// other; both since `since`.
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

    /// Notes a frame of another node from descan's own address.
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

    /// Notes a malformed response.
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
                .set_text(at, |device| format!("{device} sends malformed DES responses: {fault}."));
        }
    }

    /// Notes a multi-frame response that was aborted at the same place as before. Three times in a
    /// row may be chance; after that it is the device.
    pub fn note_aborted_response(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        fault: TransferFault,
        frame: &Frame,
    ) {
        let kind = FindingKind::MalformedAnswer;
        let strength = if self.finding_tracker.is_open(kind, address) {
            EvidenceStrength::Proof
        } else {
            EvidenceStrength::Weak
        };
        let what = "last frame of an aborted response";
        if let Some(at) =
            self.finding_tracker.report(now, kind, address, name, frame, what, strength)
        {
            self.finding_tracker.set_text(at, |device| {
                format!("{device} aborts every multi-frame response: {fault}.")
            });
        }
    }

    /// Returns true if devices seem to receive requests twice, or descan receives all frames twice.
    pub fn has_duplicate_requests(&self, now: Instant) -> bool {
        self.duplicate_frames.has_duplicate_requests(now)
    }

    /// Notes a valid response, which clears malformed-answer.
    pub fn note_valid_response(&mut self, now: Instant, address: Address) {
        self.finding_tracker.clear(now, FindingKind::MalformedAnswer, address);
    }

    /// Notes an identifier that is none of the nine message types (protocol §1.2).
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

    /// Returns the last heartbeat frame of `address`.
    pub fn last_heartbeat(&self, address: Address) -> Option<Frame> {
        self.histories[address.index()].heartbeats.back().map(|heartbeat| heartbeat.frame)
    }

    /// Forgets the history of `address` and clears its conflicts: its device is lost.
    pub fn forget(&mut self, now: Instant, address: Address) {
        self.histories[address.index()] = AddressHistory::default();
        self.finding_tracker.forget(now, address);
    }

    /// Forgets the values of `address` that could alternate: its device moved away, so the next one
    /// there is not in conflict with it.
    pub fn note_left(&mut self, address: Address) {
        let history = &mut self.histories[address.index()];
        history.names = RecentValues::default();
        history.uids = RecentValues::default();
        history.services = RecentValues::default();
    }

    // --- state --------------------------------------------------------------------------

    /// Returns the text of evidence that shows a heartbeat with this UID.
    fn uid_text(&self, uid: Option<&Uid>) -> Cow<'static, str> {
        let text = uid.map_or(String::new(), |uid| uid.text(&self.alphabet).to_string());
        format!("UID {}", Escaped(text.as_bytes())).into()
    }

    /// Time within which an alternating response must return to its previous value.
    fn alternation_timeout(&self) -> Duration {
        if self.listen_only {
            self.finding_tracker.max_evidence_lifetime()
        } else {
            self.period * 3
        }
    }

    /// Returns true if two names alternate at `address`: other evidence there is then not about
    /// devices of one name.
    fn has_two_names(&self, address: Address) -> bool {
        self.finding_tracker.has_strong(FindingKind::OneAddressTwoNames, address)
    }

    /// Returns true if another name responded from `address` in the last 30 periods: further
    /// evidence then more likely concerns that device than two devices of the present name.
    fn had_other_name(&self, now: Instant, address: Address) -> bool {
        let names = &self.histories[address.index()].names;
        let recently = names.changed_within(now, self.period * 30);
        recently || self.finding_tracker.is_open(FindingKind::OneAddressTwoNames, address)
    }
}

/// Returns the message in the first frame of a response, without padding.
fn message(frame: &Frame, framing: Framing) -> &[u8] {
    match (framing, Pci::decode(frame.data(), frame.is_fd)) {
        (Framing::Raw, _) => strip_raw_padding(frame.data()),
        (Framing::Isotp, Ok(Pci::Single(message))) => message,
        (Framing::Isotp, _) => frame.data(),
    }
}
