//! Finding tracker: opens, confirms and clears findings. Input: evidence with its strength,
//! requests seen, time. Output: [`Finding`]s, changes of their state, and addresses to query again.
//!
//! One observation proves nothing: a finding begins as *suspected*, is followed up by name
//! requests, and is *confirmed* by strong evidence over five heartbeat periods. One that ends
//! sooner because a device gave up the address becomes `address-contested` (protocol §5.3).
//!
//! Does not know what counts as evidence: [`super::conflicts`] does.

use super::address_table::AddressTable;
use super::conflicts::repeated_frames::RepeatedFrames;
use super::finding_text;
use super::outages::Outages;
use crate::finding::{Evidence, Finding, FindingKey, FindingKind, FindingState, SeenUid};
use crate::frame::{BusIndex, Frame};
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::Uid;
use crate::wire::profile::Profile;
use std::borrow::Cow;

/// Maximum number of findings of one bus; more are refused and counted. Bounds the memory: as many
/// as device rows.
const MAX_FINDINGS: usize = 512;
/// Delay of the first follow-up request to a suspected finding, and between further ones. Protocol
/// §5.3.
const FOLLOW_UP_DELAY: Duration = Duration::from_secs(1);
/// Maximum number of follow-up requests to one suspected finding, unless heartbeats at twice the rate
/// or their responses support it. Protocol §5.3.
const MAX_FOLLOW_UPS: u32 = 6;
/// Periods without a follow-up request after which new evidence starts a new series of them.
/// Chosen: longer than the follow-up delay and a response together.
const FOLLOW_UP_RESTART_PERIODS: u32 = 3;
/// Interval of the requests that check a confirmed conflict: short enough that it is not cleared
/// because two equal responses merged once. Two of them fit into the time after which a finding
/// without evidence is cleared.
const CONFIRMED_FOLLOW_UP_DELAY: Duration = Duration::from_secs(2);
/// Longest gap between heartbeat evidence that belongs together, in periods. Two periods and the
/// jitter: one heartbeat may be lost.
const HEARTBEAT_GAP_PERIODS: f64 = 2.6;
/// The same for heartbeats of two UIDs, or of one UID at two addresses, in turns, which prove more
/// and of which some may be lost: as long as the finding stays open without evidence. With 30 % of
/// the heartbeats lost, four in a row are lost once in 120 times.
const IDENTITY_GAP_PERIODS: f64 = 5.0;
/// Longest gap between response evidence that belongs together, in periods since a request was
/// seen: two requests. Tuned with the simulation.
const RESPONSE_GAP_PERIODS: f64 = 1.75;
/// The same for two names: the requests of two periods and a half may go to devices that do not
/// respond while they claim the address.
const NAMES_GAP_PERIODS: f64 = 2.6;
/// Periods after other evidence in which heartbeats at twice the rate support it: six follow-up
/// requests, one per second, and some responses that merged.
const SUPPORT_PERIODS: u32 = 10;
/// Periods after a malformed response in which the next one belongs to it: three rounds (protocol
/// §4.4). A valid response ends that sooner.
const MALFORMED_MEMORY_PERIODS: u32 = 30;
/// Number of [`EvidenceStrength::Proof`] observations that confirm a finding; a single one may be a
/// stray frame.
const CONFIRM_AFTER_PROOFS: u32 = 2;
/// Number of strong observations that confirm a conflict, if they last long enough. Tuned with the
/// simulation: two names or UIDs that return once each are two (protocol §5.2).
const CONFIRM_AFTER_STRONG: u32 = 3;

/// Periods before the first evidence in which a claim of the address belongs to it. A node gives up
/// an address within as many (protocol §5.3).
pub(super) const CLAIM_PERIODS: u32 = 5;
/// Periods for which two nodes share an address before one gives it up, if neither claimed it: a
/// replaced board may send two more heartbeats.
const CONTEST_PERIODS: u32 = 3;

/// Strength of an observation.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum EvidenceStrength {
    /// A harmless cause is likely enough.
    Weak,
    /// Only a second device explains it, if it is seen again.
    Strong,
    /// Sufficient by itself when seen again, without a second device.
    Proof,
}

/// An observation that supports a finding about one address.
#[derive(Clone)]
pub(super) struct NewEvidence<'a> {
    pub kind: FindingKind,
    pub address: Address,
    /// Name of the device, if known.
    pub name: Option<&'a Name>,
    pub strength: EvidenceStrength,
    /// What the frame shows.
    pub description: Cow<'static, str>,
    pub frame: &'a Frame,
    /// Earlier frame that this one contradicts, with what it shows.
    pub contradicts: Option<(Cow<'static, str>, Frame)>,
    /// Since when two devices are present, if the evidence shows that.
    pub since: Option<Instant>,
    /// Until when they are present, if not until its frame.
    pub until: Option<Instant>,
    /// True if a single device that sends its frames twice does not explain it.
    pub excludes_one_device: bool,
    /// True if it is a response: more evidence is expected only after a request.
    pub is_response: bool,
    /// True if it counts but cannot confirm the finding yet.
    pub is_preliminary: bool,
    /// True if the heartbeat before it was a claim, after which its sender gives up the address or
    /// keeps it.
    pub follows_claim: bool,
}

impl<'a> NewEvidence<'a> {
    /// Creates evidence in a frame that is not a response, from a device without a known name.
    pub fn new(
        kind: FindingKind,
        address: Address,
        frame: &'a Frame,
        strength: EvidenceStrength,
        description: impl Into<Cow<'static, str>>,
    ) -> Self {
        Self {
            kind,
            address,
            name: None,
            strength,
            description: description.into(),
            frame,
            contradicts: None,
            since: None,
            until: None,
            excludes_one_device: false,
            is_response: false,
            is_preliminary: false,
            follows_claim: false,
        }
    }
}

/// Evidence of one finding since it was opened.
#[derive(Clone, Debug)]
struct EvidenceState {
    /// Time since when two devices are present, by evidence stronger than
    /// [`EvidenceStrength::Weak`].
    began: Option<Instant>,
    strong: u32,
    strong_at: Option<Instant>,
    /// True if responses are part of the evidence, not heartbeats alone.
    is_response_based: bool,
    /// True if a single device that sends its frames twice does not explain the evidence.
    excludes_one_device: bool,
    /// Time of the last heartbeat at twice the rate: responses that merged meanwhile, so that only
    /// one was received, do not interrupt the evidence.
    doubled_at: Option<Instant>,
    follow_up_count: u32,
    next_follow_up: Option<Instant>,
    /// Time of the last follow-up request.
    last_follow_up: Instant,
}

impl EvidenceState {
    /// Returns true if heartbeats arrive at twice the rate.
    fn is_rate_doubled(&self, now: Instant, period: Duration) -> bool {
        self.doubled_at.is_some_and(|at| now.since(at) < period * 2)
    }
}

/// The heartbeats of an address show several nodes, as noted then, until that moment.
#[derive(Clone, Copy, Debug)]
struct SeveralSenders {
    noted: Instant,
    until: Instant,
}

/// Findings of one bus with the state that decides about them.
#[derive(Clone, Debug)]
pub(super) struct FindingTracker {
    bus: BusIndex,
    /// Heartbeat period of each address.
    periods: [Duration; Address::COUNT],
    /// Heartbeat period of the profile, for findings without an address.
    default_period: Duration,
    listen_only: bool,
    /// True if no inspector sends requests on purpose, so that evidence comes rarely.
    are_requests_rare: bool,
    findings: Vec<Finding>,
    evidence_states: Vec<EvidenceState>,
    changed: Vec<(FindingKey, FindingState)>,
    /// Number of changes noted in `changed` so far.
    revision: u64,
    /// Time of the first request to each address since its last response evidence.
    requested_at: [Option<Instant>; Address::COUNT],
    /// Number of conflicts at each address that are suspected or confirmed.
    open_conflicts: [u8; Address::COUNT],
    /// Number of confirmed address conflicts at each address.
    confirmed_conflicts: [u8; Address::COUNT],
    /// What the heartbeats of each address last showed.
    several_senders: [Option<SeveralSenders>; Address::COUNT],
    /// Claims of each address, and nodes that gave it up.
    contests: AddressTable<Contest>,
    seed: u64,
    pub over_limit: u64,
}

/// Recent claims of one address, and the last time a node gave it up.
#[derive(Clone, Copy, Debug, Default)]
struct Contest {
    /// Last node that claimed the address, and the last one before it with another UID.
    claims: [Option<(Uid, Instant)>; 2],
    /// Time of the last claim while another node held the address.
    claimed_while_held: Option<Instant>,
    /// Time at which a node was found elsewhere that had shared the address.
    gave_up: Option<Instant>,
}

impl Contest {
    /// Returns true if two nodes contended for the address since `then`: both claimed it, or one
    /// gave it up after the other claimed it or after they shared it for `shared`, longer than a
    /// board that is replaced.
    fn is_real(&self, then: Instant, shared: Duration, period: Duration) -> bool {
        let after = |time: Option<Instant>| time.is_some_and(|time| time >= then);
        self.claims.iter().all(|claim| after(claim.map(|(_, at)| at)))
            || after(self.gave_up)
                && (after(self.claimed_while_held) || shared >= period * CONTEST_PERIODS)
    }
}

impl FindingTracker {
    pub fn new(bus: BusIndex, profile: &Profile, listen_only: bool, seed: u64) -> Self {
        let period = profile.heartbeat.period();
        Self {
            bus,
            periods: [period; Address::COUNT],
            default_period: period,
            listen_only,
            are_requests_rare: listen_only,
            findings: Vec::new(),
            evidence_states: Vec::new(),
            changed: Vec::new(),
            revision: 0,
            requested_at: [None; Address::COUNT],
            open_conflicts: [0; Address::COUNT],
            confirmed_conflicts: [0; Address::COUNT],
            several_senders: [None; Address::COUNT],
            contests: AddressTable::new(),
            seed,
            over_limit: 0,
        }
    }

    /// Notes that the inspector which recorded the log sends requests.
    pub fn expect_requests(&mut self) {
        self.are_requests_rare = false;
    }

    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// Returns the number of changes of states so far.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Counts the changes from those of `before` on, and one more: its findings are gone.
    pub fn count_after(&mut self, before: &Self) {
        self.revision += before.revision + 1;
    }

    /// Returns the next finding whose state changed, with its new state.
    pub fn poll_changed(&mut self) -> Option<(FindingKey, FindingState)> {
        if self.changed.is_empty() { None } else { Some(self.changed.remove(0)) }
    }

    /// Returns true if a conflict is suspected at any address.
    pub fn is_suspicious(&self) -> bool {
        self.findings.iter().any(|f| f.state == FindingState::Suspected && f.key.kind.is_conflict())
    }

    /// Returns true if a conflict at `address` is suspected or confirmed.
    pub fn is_open_at(&self, address: Address) -> bool {
        self.open_conflicts[address.index()] > 0
    }

    /// Returns true if two UIDs alternate at `address`, or a conflict there is confirmed.
    pub fn is_known_shared(&self, address: Address) -> bool {
        let two_uids = [FindingKind::OneAddressTwoIdentities, FindingKind::TwoDebugDevices];
        self.has_confirmed_conflict(address)
            || two_uids.into_iter().any(|kind| self.is_open(kind, address))
    }

    /// Returns true if a conflict at `address` is confirmed.
    pub fn has_confirmed_conflict(&self, address: Address) -> bool {
        self.confirmed_conflicts[address.index()] > 0
    }

    /// Returns the kind of a confirmed conflict of two devices at the address of a finding, other than
    /// that finding.
    fn other_confirmed_conflict(&self, of: &Finding) -> Option<FindingKind> {
        let is_it = |finding: &&Finding| {
            of.key.address.is_some()
                && finding.key.address == of.key.address
                && finding.key.kind != of.key.kind
                && finding.state == FindingState::Confirmed
                && is_address_conflict(&finding.key)
        };
        self.findings.iter().find(is_it).map(|finding| finding.key.kind)
    }

    /// Returns true if several devices seem to use `address`.
    pub fn is_shared(&self, address: Address) -> bool {
        self.findings.iter().any(|finding| {
            finding.key.address == Some(address)
                && matches!(
                    finding.key.kind,
                    FindingKind::SameNameSameAddress
                        | FindingKind::OneAddressTwoNames
                        | FindingKind::OneAddressTwoIdentities
                        | FindingKind::TwoDebugDevices
                )
                && finding.state != FindingState::Cleared
        })
    }

    /// Returns true if [`poll_changed`](Self::poll_changed) has a change to return.
    pub fn has_changed(&self) -> bool {
        !self.changed.is_empty()
    }

    // --- input --------------------------------------------------------------------------

    /// Notes a request that `address` receives.
    pub fn note_request(&mut self, now: Instant, address: Address) {
        self.requested_at[address.index()].get_or_insert(now);
    }

    /// Sets the state of the bus-errors finding of an address, or of the bus where `address` is
    /// `None`. Returns the finding, so that [`super::errors`] adds evidence and text; `None` where
    /// there is none to clear, or too many findings.
    pub fn set_bus_errors_state(
        &mut self,
        now: Instant,
        address: Option<Address>,
        state: FindingState,
    ) -> Option<&mut Finding> {
        let kind = FindingKind::BusErrors;
        let key = FindingKey::at(kind, self.bus, address);
        let at = if state == FindingState::Cleared {
            self.findings.iter().position(|finding| finding.key == key)?
        } else {
            self.open(now, key)?
        };
        self.set(now, at, state);
        self.findings.get_mut(at)
    }

    /// Adds `lost` frames to the frames-lost finding and confirms it.
    pub fn note_lost_frames(&mut self, now: Instant, lost: u64) {
        let key = FindingKey::at(FindingKind::FramesLost, self.bus, None);
        if let Some(at) = self.open(now, key) {
            self.findings[at].count += lost;
            self.findings[at].last = now;
            self.describe(at);
            self.set(now, at, FindingState::Confirmed);
        }
    }

    /// Notes a repeated heartbeat and its two frames. `address` is `None` if those of several
    /// addresses are repeated.
    pub fn note_repeated(
        &mut self,
        now: Instant,
        address: Option<Address>,
        repeated: &RepeatedFrames,
        frames: [Frame; 2],
    ) {
        let key = FindingKey::at(FindingKind::FramesRepeated, self.bus, address);
        let Some(at) = self.open(now, key) else { return };
        let finding = &mut self.findings[at];
        let of = |frame: Frame, description: &'static str| Evidence {
            time: frame.time,
            description: description.into(),
            frame: Some(frame),
        };
        let [original, copy] = frames;
        finding.add_copied([of(original, "heartbeat"), of(copy, "the same frame again")]);
        finding.last = now;
        finding.addresses.clone_from(&repeated.addresses);
        finding.text = finding_text::repeated(repeated);
        self.resume_follow_ups(now, at, false);
    }

    // --- time ----------------------------------------------------------------------------

    /// Clears findings whose evidence is too old, and calls `query` for addresses that are due for
    /// a follow-up request. Nothing changes while the bus is down.
    pub fn handle_timeout(
        &mut self,
        now: Instant,
        outages: &Outages,
        mut query: impl FnMut(Address),
    ) {
        if outages.is_on() {
            return;
        }
        for at in 0..self.findings.len() {
            let finding = &self.findings[at];
            if finding.state == FindingState::Cleared {
                continue;
            }
            if now >= self.expires_at(at, outages) && expires_without_evidence(finding) {
                self.end(now, at);
                continue;
            }
            if !self.listen_only
                && self.evidence_states[at].next_follow_up.is_some_and(|due| now >= due)
            {
                let confirmed = self.findings[at].state == FindingState::Confirmed;
                if let Some(address) = finding.key.address {
                    query(address);
                }
                let delay = if confirmed { CONFIRMED_FOLLOW_UP_DELAY } else { FOLLOW_UP_DELAY };
                let next = self.with_jitter(at, now, delay);
                let period = self.period_of(at);
                let state = &mut self.evidence_states[at];
                state.follow_up_count += 1;
                state.last_follow_up = now;
                let goes_on = confirmed
                    || state.is_rate_doubled(now, period) && state.strong > 0
                    || state.follow_up_count < MAX_FOLLOW_UPS;
                state.next_follow_up = goes_on.then_some(next);
            }
        }
    }

    pub fn poll_timeout(&self, outages: &Outages) -> Option<Instant> {
        if outages.is_on() {
            return None;
        }
        self.findings
            .iter()
            .zip(&self.evidence_states)
            .enumerate()
            .filter(|(_, (finding, _))| finding.state != FindingState::Cleared)
            .filter(|(_, (finding, _))| expires_without_evidence(finding))
            .flat_map(|(at, (_, state))| {
                let check = if self.listen_only { None } else { state.next_follow_up };
                [Some(self.expires_at(at, outages)), check]
            })
            .flatten()
            .min()
    }

    /// Notes a heartbeat at twice the rate. Returns true if a suspected finding recently had stronger
    /// evidence besides.
    pub fn note_double_rate(&mut self, now: Instant, kind: FindingKind, address: Address) -> bool {
        let Some(at) = self.find(kind, address) else { return false };
        let recent = self.period_of(at) * SUPPORT_PERIODS;
        let state = &mut self.evidence_states[at];
        state.doubled_at = Some(now);
        self.findings[at].state == FindingState::Suspected
            && state.strong > 0
            && state.strong_at.is_some_and(|at| now.since(at) < recent)
    }

    /// Notes that the heartbeats of `address` show several nodes: until then, the only confirmed
    /// conflict there is not cleared.
    pub fn note_several_senders(&mut self, noted: Instant, until: Instant, address: Address) {
        let known = &mut self.several_senders[address.index()];
        if known.is_none_or(|known| known.until <= until) {
            *known = Some(SeveralSenders { noted, until });
        }
    }

    /// Notes that heartbeats show a confirmed finding still.
    pub fn renew(&mut self, now: Instant, kind: FindingKind, address: Address) {
        if let Some(at) = self.find(kind, address) {
            self.findings[at].last = now;
        }
    }

    /// Notes a claim of `address`; `is_held`: another node sends heartbeats there.
    pub fn note_claim(&mut self, now: Instant, address: Address, uid: Option<Uid>, is_held: bool) {
        let contest = &mut self.contests[address];
        if is_held {
            contest.claimed_while_held = Some(now);
        }
        let Some(uid) = uid else { return };
        if contest.claims[0].is_some_and(|(last, _)| last != uid) {
            contest.claims[1] = contest.claims[0];
        }
        contest.claims[0] = Some((uid, now));
    }

    /// Notes that a node that shared `address` was found elsewhere.
    pub fn note_gave_up(&mut self, now: Instant, address: Address) {
        self.contests[address].gave_up = Some(now);
    }

    /// Returns until when a finding is kept because several nodes send heartbeats; `None` if they
    /// do not, or if another confirmed conflict reports it.
    fn kept_until(&self, finding: &Finding, outages: &Outages) -> Option<Instant> {
        let address = finding.key.address?;
        let SeveralSenders { noted, until } = self.several_senders[address.index()]?;
        let until = until + outages.time_down_since(noted);
        let is_confirmed =
            finding.state == FindingState::Confirmed && is_address_conflict(&finding.key);
        let is_only = self.confirmed_conflicts[address.index()] == 1;
        (is_confirmed && is_only).then_some(until)
    }

    /// Clears the conflicts at `address`, whose device is lost.
    pub fn forget(&mut self, now: Instant, address: Address) {
        self.requested_at[address.index()] = None;
        self.several_senders[address.index()] = None;
        for at in 0..self.findings.len() {
            let finding = &self.findings[at];
            let concerned = finding.addresses.contains(&address);
            if concerned && finding.key.kind.is_conflict() && finding.state != FindingState::Cleared
            {
                self.end(now, at);
            }
        }
    }

    /// Removes the findings about devices; those about the bus stay.
    pub fn remove_findings_of_devices(&mut self) {
        let states = std::mem::take(&mut self.evidence_states);
        let all = std::mem::take(&mut self.findings).into_iter().zip(states);
        let of_bus = all.filter(|(finding, _)| finding.key.address.is_none());
        (self.findings, self.evidence_states) = of_bus.unzip();
        self.changed.retain(|(key, _)| key.address.is_none());
        self.revision += 1;
        self.requested_at = [None; Address::COUNT];
        self.open_conflicts = [0; Address::COUNT];
        self.confirmed_conflicts = [0; Address::COUNT];
        self.several_senders = [None; Address::COUNT];
        self.contests = AddressTable::new();
    }

    // --- findings ------------------------------------------------------------------------

    /// Sets the heartbeat period of each address.
    pub fn set_periods(&mut self, periods: &[Duration; Address::COUNT]) {
        self.periods = *periods;
    }

    /// Returns the heartbeat period of the profile.
    pub fn default_period(&self) -> Duration {
        self.default_period
    }

    /// Returns the heartbeat period of the address that a finding concerns.
    fn period_of(&self, at: usize) -> Duration {
        let key = &self.findings[at].key;
        let Some(address) = key.address else { return self.default_period };
        let period = self.periods[address.index()];
        match key.kind {
            // The second sender may be slower than the first.
            FindingKind::OneAddressTwoIdentities | FindingKind::TwoDebugDevices => {
                period.max(self.default_period)
            }
            _ => period,
        }
    }

    /// Age at which evidence no longer supports a finding.
    fn evidence_lifetime(&self, period: Duration) -> Duration {
        if self.are_requests_rare { period.mul_f64(7.5) } else { period * 5 }
    }

    /// Age at which response evidence no longer supports a finding while no request was seen. In
    /// listen-only mode other nodes may send requests only every ten periods.
    pub fn max_evidence_lifetime(&self, period: Duration) -> Duration {
        if self.are_requests_rare { period * 12 } else { self.evidence_lifetime(period) }
    }

    /// Returns when a finding is cleared if no more evidence is seen.
    fn expires_at(&self, at: usize, outages: &Outages) -> Instant {
        let finding = &self.findings[at];
        let expires = self.evidence_expires_at(at, outages);
        self.kept_until(finding, outages).map_or(expires, |kept| expires.max(kept))
    }

    fn evidence_expires_at(&self, at: usize, outages: &Outages) -> Instant {
        let finding = &self.findings[at];
        let last = outages.shifted(finding.last);
        let requested = finding.key.address.map(|address| self.requested_at[address.index()]);
        let mut period = self.period_of(at);
        if self.evidence_states[at].is_response_based {
            // Requests are not sent more often where heartbeats are.
            period = period.max(self.default_period);
        }
        if finding.key.kind == FindingKind::MalformedAnswer {
            return last + period.max(self.default_period) * MALFORMED_MEMORY_PERIODS;
        }
        let usual = last + self.evidence_lifetime(period);
        match requested {
            Some(None) if self.evidence_states[at].is_response_based => {
                last + self.max_evidence_lifetime(period)
            }
            // The device needs time to respond.
            Some(Some(requested)) if self.evidence_states[at].is_response_based => {
                usual.max(outages.shifted(requested) + period)
            }
            _ => usual,
        }
    }

    /// Returns true if the frames of `address`, or of all, are repeated.
    fn are_frames_repeated(&self, address: Address) -> bool {
        self.findings.iter().any(|finding| {
            finding.key.kind == FindingKind::FramesRepeated
                && finding.state != FindingState::Cleared
                && finding.key.address.is_none_or(|it| it == address)
        })
    }

    fn find(&self, kind: FindingKind, address: Address) -> Option<usize> {
        self.findings.iter().position(|f| f.key.kind == kind && f.key.address == Some(address))
    }

    /// Returns when a finding was cleared; `None` if it is open, or never was.
    pub fn cleared_at(&self, kind: FindingKind, address: Address) -> Option<Instant> {
        self.findings[self.find(kind, address)?].cleared_at()
    }

    /// Returns true if the finding is suspected or confirmed.
    pub fn is_open(&self, kind: FindingKind, address: Address) -> bool {
        if kind.is_conflict() && !self.is_open_at(address) {
            return false;
        }
        self.find(kind, address).is_some_and(|at| self.findings[at].state != FindingState::Cleared)
    }

    /// Returns true if the finding is confirmed.
    pub fn is_confirmed(&self, kind: FindingKind, address: Address) -> bool {
        if kind.is_conflict() && !self.is_open_at(address) {
            return false;
        }
        self.find(kind, address)
            .is_some_and(|at| self.findings[at].state == FindingState::Confirmed)
    }

    /// Returns the index of the finding with that key; creates it, or opens it again if it was
    /// cleared. `None` if there are too many.
    fn open(&mut self, now: Instant, key: FindingKey) -> Option<usize> {
        let check = with_jitter(self.seed, key.address, now, FOLLOW_UP_DELAY);
        let state = EvidenceState {
            began: None,
            strong: 0,
            strong_at: None,
            is_response_based: false,
            excludes_one_device: false,
            doubled_at: None,
            follow_up_count: 0,
            last_follow_up: now,
            next_follow_up: is_followed_up(&key).then_some(check),
        };
        if let Some(at) = self.findings.iter().position(|finding| finding.key == key) {
            if self.findings[at].state == FindingState::Cleared {
                self.evidence_states[at] = state;
                self.findings[at].begin_again(now);
                self.set(now, at, FindingState::Suspected);
            }
            return Some(at);
        }
        if self.findings.len() == MAX_FINDINGS {
            self.over_limit += 1;
            return None;
        }
        self.note_change(key.clone(), FindingState::Suspected);
        self.count_open_conflict(&key, true);
        self.findings.push(Finding::new(key, now));
        self.evidence_states.push(state);
        Some(self.findings.len() - 1)
    }

    /// Adds an observation to a finding, opens it if needed, and confirms it if the evidence
    /// suffices. Returns the index of the finding; `None` if there are too many.
    pub fn report(&mut self, now: Instant, mut evidence: NewEvidence<'_>) -> Option<usize> {
        let NewEvidence { kind, address, strength, .. } = evidence;
        let at = self.open(now, FindingKey::at(kind, self.bus, Some(address)))?;
        let finding = &mut self.findings[at];
        if let Some(name) = evidence.name {
            finding.add_name(name);
        }
        let last = finding.last;
        let of = |(description, frame): (Cow<'static, str>, Frame)| Evidence {
            time: frame.time,
            description,
            frame: Some(frame),
        };
        // Both responses to a request belong together; the heartbeats of two senders come in turns,
        // and each is reported itself.
        if let Some(other) =
            evidence.contradicts.take().filter(|(_, other)| !finding.has_frame(other))
        {
            let other = of(other);
            if evidence.is_response || !finding.has_similar(&other) {
                finding.add_evidence(other);
            }
        }
        finding.add_evidence(of((std::mem::take(&mut evidence.description), *evidence.frame)));
        finding.last = now;
        self.count_strength(now, at, last, &evidence);
        let responds = evidence.is_response && strength != EvidenceStrength::Weak;
        self.resume_follow_ups(now, at, responds);
        if let Some(since) = evidence.since {
            let began = &mut self.evidence_states[at].began;
            *began = Some(began.map_or(since, |began| began.min(since)));
        }
        if evidence.is_response {
            self.evidence_states[at].is_response_based = true;
            self.requested_at[address.index()] = None;
        }
        self.evidence_states[at].excludes_one_device |= evidence.excludes_one_device;
        self.note_began(at);
        self.describe(at);
        if strength != EvidenceStrength::Weak && explains_doubled_answers(kind) {
            let until = evidence.until.unwrap_or(now);
            self.supersede(now, until, FindingKind::AnswersDoubled, kind, address);
        }
        let strong = self.evidence_states[at].strong;
        if strength == EvidenceStrength::Proof && strong >= CONFIRM_AFTER_PROOFS {
            self.set(now, at, FindingState::Confirmed);
        }
        let counts = strength != EvidenceStrength::Weak || evidence.since.is_some();
        if counts && !evidence.is_preliminary {
            self.update_state(now, evidence.until.unwrap_or(now), at);
        }
        Some(at)
    }

    /// Stores since when the evidence shows two senders. Once that is confirmed, a gap in the evidence
    /// does not change it.
    fn note_began(&mut self, at: usize) {
        let began = self.evidence_states[at].began;
        let finding = &mut self.findings[at];
        let known = finding.began.filter(|_| finding.state == FindingState::Confirmed);
        finding.began = known.into_iter().chain(began).min();
    }

    /// Counts an observation whose finding had its last one at `last`.
    fn count_strength(
        &mut self,
        now: Instant,
        at: usize,
        last: Instant,
        evidence: &NewEvidence<'_>,
    ) {
        let &NewEvidence { address, strength, follows_claim, .. } = evidence;
        let period = self.period_of(at);
        let kind = self.findings[at].key.kind;
        let gap_periods = match kind {
            FindingKind::OneAddressTwoIdentities | FindingKind::OneUidTwoAddresses
                if !follows_claim =>
            {
                IDENTITY_GAP_PERIODS
            }
            _ => HEARTBEAT_GAP_PERIODS,
        };
        let state = &mut self.evidence_states[at];
        // Evidence after a gap starts a new count. For response evidence the gap counts from the
        // first request.
        let requested = self.requested_at[address.index()];
        let (expected_since, pause) = match requested {
            _ if !state.is_response_based => (Some(last), gap_periods),
            Some(requested) if kind == FindingKind::OneAddressTwoNames => {
                (Some(requested.max(last)), NAMES_GAP_PERIODS)
            }
            Some(requested) => (Some(requested.max(last)), RESPONSE_GAP_PERIODS),
            None => (None, HEARTBEAT_GAP_PERIODS),
        };
        let interrupted = !state.is_rate_doubled(now, period)
            && expected_since.is_some_and(|since| now.since(since) >= period.mul_f64(pause));
        if interrupted && strength != EvidenceStrength::Proof && state.began.is_some() {
            state.began = None;
            state.strong = 0;
        }
        if strength == EvidenceStrength::Weak {
            return;
        }
        state.began.get_or_insert(now);
        // Strong evidence counts once per half period, so a burst is not enough.
        if state.strong_at.is_none_or(|last| now.since(last) >= period / 2) {
            state.strong += 1;
            state.strong_at = Some(now);
        }
    }

    /// Starts another series of follow-up requests for new evidence some time after the last one.
    /// After strong evidence in a response, which `responds` means, one more request follows: it is
    /// about to be decided.
    fn resume_follow_ups(&mut self, now: Instant, at: usize, responds: bool) {
        let restart = self.period_of(at) * FOLLOW_UP_RESTART_PERIODS;
        let state = &self.evidence_states[at];
        if !is_followed_up(&self.findings[at].key) || state.next_follow_up.is_some() {
            return;
        }
        if now.since(state.last_follow_up) >= restart {
            let soon = self.with_jitter(at, now, FOLLOW_UP_DELAY / 4);
            let state = &mut self.evidence_states[at];
            state.follow_up_count = 0;
            state.next_follow_up = Some(soon);
        } else if responds {
            let next = self.with_jitter(at, now, FOLLOW_UP_DELAY);
            self.evidence_states[at].next_follow_up = Some(next);
        }
    }

    /// Confirms a finding with enough strong evidence over five periods before `until`.
    fn update_state(&mut self, now: Instant, until: Instant, at: usize) {
        let state = &self.evidence_states[at];
        // Five periods, less 1 % for heartbeat jitter.
        let enough = self.period_of(at).mul_f64(4.95);
        let lasts = state.began.is_some_and(|began| until.since(began) >= enough);
        if state.strong >= CONFIRM_AFTER_STRONG && lasts {
            self.set(now, at, FindingState::Confirmed);
        }
    }

    /// Sets the text of a finding; `text` receives the label of its device.
    pub fn set_text(&mut self, at: usize, text: impl FnOnce(&str) -> String) {
        let finding = &mut self.findings[at];
        if let Some(address) = finding.key.address {
            finding.text = text(&finding_text::device_label(address, &finding.names));
        }
    }

    /// Sets the UIDs in the heartbeats that a finding is about.
    pub fn set_uids(&mut self, at: usize, uids: Vec<SeenUid>) {
        self.findings[at].uids = uids;
        self.describe(at);
    }

    /// Adds an address that a finding concerns.
    pub fn add_address(&mut self, at: usize, address: Address) {
        let addresses = &mut self.findings[at].addresses;
        if !addresses.contains(&address) {
            addresses.push(address);
            addresses.sort_unstable();
            self.describe(at);
        }
    }

    /// Returns true if an open finding has evidence stronger than [`EvidenceStrength::Weak`].
    pub fn has_strong(&self, kind: FindingKind, address: Address) -> bool {
        self.find(kind, address).is_some_and(|at| {
            self.findings[at].state != FindingState::Cleared && self.evidence_states[at].strong > 0
        })
    }

    /// Adds a name that a finding concerns.
    pub fn add_name(&mut self, kind: FindingKind, address: Address, name: &Name) {
        if let Some(at) = self.find(kind, address) {
            self.findings[at].add_name(name);
            self.describe(at);
        }
    }

    /// Discards the strong evidence of the suspected findings of this kind, at `address` or at all
    /// addresses: it has another explanation.
    pub fn reset_suspicion(&mut self, kind: FindingKind, address: Option<Address>) {
        for (finding, state) in self.findings.iter().zip(&mut self.evidence_states) {
            let is_there = address.is_none() || finding.key.address == address;
            if is_there && finding.key.kind == kind && finding.state == FindingState::Suspected {
                state.began = None;
                state.strong = 0;
            }
        }
    }

    /// Replaces finding `old` by `new`, which takes over its beginning and its count of strong
    /// evidence if `old` is recent; they are present until `until`. If it is confirmed that two devices
    /// are there, it stays so.
    pub fn supersede(
        &mut self,
        now: Instant,
        until: Instant,
        old: FindingKind,
        new: FindingKind,
        address: Address,
    ) {
        let (Some(old), Some(new)) = (self.find(old, address), self.find(new, address)) else {
            return;
        };
        if self.findings[old].state != FindingState::Cleared {
            let recent = self.period_of(old).mul_f64(HEARTBEAT_GAP_PERIODS);
            let is_proven = self.findings[old].state == FindingState::Confirmed
                && self.findings[old].key.kind != FindingKind::AnswersDoubled;
            if now.since(self.findings[old].last) < recent {
                let (before, began) =
                    (self.evidence_states[old].began, self.evidence_states[new].began);
                self.evidence_states[new].began = before.into_iter().chain(began).min();
                self.evidence_states[new].strong += self.evidence_states[old].strong;
                self.note_began(new);
            }
            self.findings[old].superseded_by = Some(self.findings[new].key.kind);
            self.set(now, old, FindingState::Cleared);
            if is_proven {
                self.set(now, new, FindingState::Confirmed);
            } else {
                self.update_state(now, until, new);
            }
        }
    }

    /// Clears a finding.
    pub fn clear(&mut self, now: Instant, kind: FindingKind, address: Address) {
        if let Some(at) = self.find(kind, address) {
            self.set(now, at, FindingState::Cleared);
        }
    }

    /// Clears a finding whose evidence stopped. A suspected conflict whose devices claimed the
    /// address becomes `address-contested`.
    fn end(&mut self, now: Instant, at: usize) {
        let finding = &self.findings[at];
        let period = self.period_of(at);
        let is_contested = |address: Address| {
            let shared = finding.last.since(finding.first);
            let then = finding.first - period * CLAIM_PERIODS;
            self.contests[address].is_real(then, shared, period)
        };
        // While a conflict is confirmed at the address, it explains the evidence, and no device gave up
        // the address.
        let confirmed = self.other_confirmed_conflict(finding);
        let was_contested = finding.state == FindingState::Suspected
            && confirmed.is_none()
            && finding.key.kind != FindingKind::OneUidTwoAddresses
            && finding.key.address.is_some_and(is_contested);
        // Two devices remain two when only one kind of evidence for them goes on; or repeated frames explain it.
        if is_address_conflict(&finding.key) {
            // Copies have the same UID.
            let may_be_copies = finding.state == FindingState::Suspected
                && !was_contested
                && finding.uids.len() <= 1
                && matches!(
                    finding.key.kind,
                    FindingKind::AnswersDoubled | FindingKind::SameNameSameAddress
                );
            let repeated = finding.key.address.filter(|_| may_be_copies);
            let repeated = repeated.filter(|address| self.are_frames_repeated(*address));
            let repeated = repeated.map(|_| FindingKind::FramesRepeated);
            self.findings[at].superseded_by = confirmed.or(repeated);
        }
        self.set(now, at, FindingState::Cleared);
        let (kind, address) = (self.findings[at].key.kind, self.findings[at].key.address);
        let (true, true, Some(address)) = (was_contested, kind.is_conflict(), address) else {
            return;
        };
        let key = FindingKey::at(FindingKind::AddressContested, self.bus, Some(address));
        let Finding { names, evidence, .. } = self.findings[at].clone();
        if let Some(contested) = self.open(now, key) {
            for name in &names {
                self.findings[contested].add_name(name);
            }
            for piece in evidence {
                self.findings[contested].add_evidence(piece);
            }
            self.findings[contested].last = now;
            self.describe(contested);
        }
    }

    /// Sets the state of a finding and records the change.
    fn set(&mut self, now: Instant, at: usize, state: FindingState) {
        let finding = &mut self.findings[at];
        if finding.state == state {
            return;
        }
        let before = std::mem::replace(&mut finding.state, state);
        let was_open = before != FindingState::Cleared;
        let is_open = state != FindingState::Cleared;
        finding.changed = now;
        finding.was_confirmed |= state == FindingState::Confirmed;
        let (key, is_conflict) = (finding.key.clone(), finding.key.kind.is_conflict());
        if is_open != was_open {
            self.count_open_conflict(&key, is_open);
        }
        let was_confirmed = before == FindingState::Confirmed;
        let is_confirmed = state == FindingState::Confirmed;
        if let Some(address) = key.address.filter(|_| is_address_conflict(&key))
            && is_confirmed != was_confirmed
        {
            add_or_remove(&mut self.confirmed_conflicts[address.index()], is_confirmed);
        }
        self.note_change(key, state);
        if state == FindingState::Confirmed && is_conflict {
            self.evidence_states[at].next_follow_up =
                Some(self.with_jitter(at, now, CONFIRMED_FOLLOW_UP_DELAY));
        }
    }

    fn count_open_conflict(&mut self, key: &FindingKey, is_open: bool) {
        if let Some(address) = key.address.filter(|_| key.kind.is_conflict()) {
            add_or_remove(&mut self.open_conflicts[address.index()], is_open);
        }
    }

    fn note_change(&mut self, key: FindingKey, state: FindingState) {
        self.changed.push((key, state));
        self.revision += 1;
    }

    /// Returns the time about `wait` after `now` for a request about a finding.
    fn with_jitter(&self, at: usize, now: Instant, wait: Duration) -> Instant {
        with_jitter(self.seed, self.findings[at].key.address, now, wait)
    }

    fn describe(&mut self, at: usize) {
        let is_certain = self.evidence_states[at].excludes_one_device;
        finding_text::describe(&mut self.findings[at], is_certain);
    }
}

/// Returns the time about `wait` after `now`, varied by up to a tenth. Keeps follow-up requests out of
/// step with 1 s heartbeats, with other inspectors and with each other, because equal responses that
/// wait together merge on the wire. The variation depends on address and time alone, so that one
/// finding does not change the requests about another.
fn with_jitter(seed: u64, address: Option<Address>, now: Instant, wait: Duration) -> Instant {
    let address = address.map_or(0, |address| u64::from(address.number()) + 1);
    let mut rng = fastrand::Rng::with_seed(seed ^ now.as_micros() ^ address << 56);
    now + wait.mul_f64(0.9 + 0.2 * rng.f64())
}

/// Returns true for a conflict about one address.
fn is_address_conflict(key: &FindingKey) -> bool {
    key.kind.is_conflict() && key.kind != FindingKind::OneUidTwoAddresses
}

fn add_or_remove(count: &mut u8, is_added: bool) {
    *count = if is_added { *count + 1 } else { *count - 1 };
}

/// Returns true if requests are sent to the address of a suspected finding: their responses decide.
fn is_followed_up(key: &FindingKey) -> bool {
    key.kind.is_conflict() || key.kind == FindingKind::FramesRepeated
}

/// Returns true if two devices, which this kind shows, are why requests get two responses.
fn explains_doubled_answers(kind: FindingKind) -> bool {
    matches!(
        kind,
        FindingKind::SameNameSameAddress
            | FindingKind::OneAddressTwoNames
            | FindingKind::OneAddressTwoIdentities
    )
}

/// Returns true if a finding is cleared when no more evidence is seen. A confirmed malformed-answer
/// is cleared by a valid response only, because requests are rare; [`super::errors`] clears
/// bus-errors.
fn expires_without_evidence(finding: &Finding) -> bool {
    match finding.key.kind {
        FindingKind::BusErrors => false,
        FindingKind::MalformedAnswer => finding.state != FindingState::Confirmed,
        _ => true,
    }
}
