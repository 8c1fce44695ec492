//! Conflict detector: finds evidence of address and UID conflicts in the frames of one bus. Input:
//! requests, responses and heartbeats with their frames; output: evidence for the finding tracker.
//!
//! Two devices at one address cause two responses to one request, heartbeats at twice the rate or
//! in two phases, and names, UIDs or service lists that alternate (protocol §5.2). One such
//! observation proves nothing: a reboot, a board swap or a bridge that repeats frames looks the
//! same for a moment. [`super::finding_tracker`] decides when a finding is confirmed.
//!
//! Does not know device rows, presence, or des.json.

mod grid;
mod history;
mod prompted_heartbeats;
mod query_responses;
mod recent_values;
pub(in crate::discovery) mod repeated_frames;
mod rhythm;
mod time_resolution;

use super::address_table::AddressTable;
use super::finding_text;
use super::finding_tracker::{CLAIM_PERIODS, EvidenceStrength, FindingTracker, NewEvidence};
use super::periods::{HeartbeatPeriods, PeriodChange};
use super::transfers::Interleaving;
use crate::finding::{FindingKind, SeenUid};
use crate::frame::{BusIndex, Frame};
use crate::text::{Escaped, Name};
use crate::time::{Duration, Instant};
use crate::wire::des::Request;
use crate::wire::framing::{Framing, strip_raw_padding};
use crate::wire::id::{Address, Header};
use crate::wire::isotp::{Pci, TransferFault};
use crate::wire::node::Uid;
use crate::wire::profile::{Profile, ProfileKey, UidProfile};
use grid::WINDOW_PERIODS;
use history::{AddressHistory, LONGEST_DELAY, MAX_DOUBLE_RATE_HEARTBEATS};
pub(super) use query_responses::RequestOrigin;
use query_responses::SurplusResponse;
use recent_values::ObservedValue;
use repeated_frames::{COPIES_OF_ONE, RepeatedFrameDetector};
use rhythm::HeartbeatPattern;
use std::borrow::Cow;
pub use time_resolution::TimeDoubt;
use time_resolution::TimeResolution;

/// Two responses to one request are less than this apart. Less than the 200 ms after which a
/// request is repeated (protocol §4.3).
const PAIR_WINDOW: Duration = Duration::from_millis(125);

/// Periods for which a UID is remembered at its address: some heartbeats may be lost. As
/// `IDENTITY_GAP_PERIODS`.
const UID_MEMORY_PERIODS: u32 = 5;
/// Longest time between two heartbeats of a sender, in periods, if another one sends meanwhile: one
/// of them may be lost. Boards that take turns are plugged in and start for longer.
const INTERLEAVED_PERIODS: f64 = 2.6;
/// Factor by which the period of a sender exceeds that of its address if another sender there is
/// faster. Chosen: far above any jitter.
const SLOWER_FACTOR: f64 = 1.5;

/// Periods without a change of the name after which equal responses come from devices of one name:
/// ten requests about a suspected finding, one per second, or one round of another inspector.
const NAME_GAP_PERIODS: u32 = 12;
/// Periods after a change of the name in which heartbeats and services may be those of the device
/// with the other name: three rounds (protocol §4.4).
const NAME_MEMORY_PERIODS: u32 = 30;
/// Successive responses with one name after which the device with the other name is not there. With
/// 30 % of the frames lost, six of its responses in a row are lost once in 1,400 times.
const NAMES_WITHOUT_OTHER: u32 = 6;

/// Responses after the first one that lost the same frame by chance, in a row.
const ABORTED_BY_CHANCE: u32 = 1;
/// The same of a device that sent a whole response before. With 3 % of the frames lost, four in a
/// row are seen once in 1,000,000 transfers.
const ABORTED_BY_CHANCE_AFTER_RESPONSE: u32 = 4;

/// Periods after a heartbeat from an address with several senders in which the next one is due.
/// Chosen: one period and its jitter.
const KEPT_PERIODS: f64 = 1.1;

/// Change of the distance between the heartbeats of two boards from one period to the next, in periods, up to
/// which their clocks explain it. Chosen: as for a period that is another one than the expected.
const MAX_DRIFT_PERIODS: f64 = 0.02;

/// Description of a heartbeat in the second phase.
const SECOND_PHASE: &str = "heartbeat, phase 2 of a period";
/// Difference between the delays of the copies of heartbeats and of responses up to which one gateway makes
/// both, beside a quarter of the delay. Chosen: a frame at 500 kbit/s.
const BOTH_AS_LATE: Duration = Duration::from_micros(300);
/// Description of a heartbeat in the second phase that may be a copy.
const EQUAL_SECOND_PHASE: &str = "equal heartbeat soon after each";
/// Description of a heartbeat at twice the rate.
const TWICE_THE_RATE: &str = "heartbeats at twice the rate";
/// Description of a heartbeat in one of two phases of another period than the expected one.
const TWICE_PER_PERIOD: &str = "heartbeats at short and long intervals in turns";

/// Periods after delayed requests in which surplus responses are ignored. Chosen: a device aborts a
/// response that waits for flow control after 1 s, and others may wait behind it.
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

/// What is known about the sender of a heartbeat besides its UID: its mode, as far as the U bit and
/// address resolution show it, and whether it is alone.
#[derive(Clone, Copy, Debug)]
pub(super) struct SenderState {
    /// True in a working mode, by the U bit.
    pub is_working: bool,
    /// True in INIT or ARSLV: the node is about to change its mode.
    pub is_resolving: bool,
    /// True if two senders are at the address whose names are known and differ.
    pub are_two_named: bool,
    /// Longest heartbeat period of the senders at the address, if known.
    pub longest_period: Option<Duration>,
}

/// Whether a frame repeats an earlier one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Repetition {
    /// It does not.
    None,
    /// It is equal to the previous heartbeat, which it follows too soon to be another one.
    Heartbeat,
    /// It is a copy, to be ignored: all frames are repeated.
    Ignored,
}

/// Other findings about an address, which explain some of the evidence there.
#[derive(Clone, Copy, Debug)]
struct AddressFindings {
    /// Two names alternate there: other evidence is then not about devices of one name.
    has_two_names: bool,
    /// Heartbeats there have two phases or two UIDs, or two devices are known by other evidence.
    has_second_sender: bool,
    /// Another name responded there recently: further evidence then more likely concerns that device
    /// than two devices of the present name.
    had_other_name: bool,
    /// Too few heartbeats arrived to show whether frames from there are repeated.
    may_be_repeated: bool,
}

impl AddressFindings {
    /// Returns what responses show that two devices sent.
    fn kind_of_two_devices(self) -> (FindingKind, EvidenceStrength) {
        if self.has_two_names {
            (FindingKind::OneAddressTwoNames, EvidenceStrength::Strong)
        } else if self.had_other_name {
            (FindingKind::OneAddressTwoNames, EvidenceStrength::Weak)
        } else {
            (FindingKind::SameNameSameAddress, EvidenceStrength::Strong)
        }
    }
}

/// Histories of all addresses of one bus, with the findings made from them.
#[derive(Clone, Debug)]
pub(super) struct ConflictDetector {
    periods: HeartbeatPeriods,
    /// True if no inspector sends requests on purpose: devices respond now and then only.
    are_requests_rare: bool,
    /// Alphabet of UIDs, for the text of evidence.
    alphabet: UidProfile,
    histories: AddressTable<AddressHistory>,
    repeated_frames: RepeatedFrameDetector,
    finding_tracker: FindingTracker,
    time_resolution: TimeResolution,
    /// Surplus responses before this time may belong to delayed requests.
    ignore_surplus_until: Instant,
}

impl ConflictDetector {
    pub fn new(bus: BusIndex, profile: &Profile, listen_only: bool, seed: u64) -> Self {
        let period = profile.heartbeat.period();
        Self {
            periods: HeartbeatPeriods::new(period, profile.is_given(ProfileKey::PeriodMs)),
            are_requests_rare: listen_only,
            alphabet: profile.uid.clone(),
            histories: AddressTable::new(),
            repeated_frames: RepeatedFrameDetector::new(period),
            finding_tracker: FindingTracker::new(bus, profile, listen_only, seed),
            time_resolution: TimeResolution::new(),
            ignore_surplus_until: Instant::ZERO,
        }
    }

    /// Notes that the inspector which recorded the log sends requests.
    pub fn expect_requests(&mut self) {
        self.are_requests_rare = false;
        self.finding_tracker.expect_requests();
    }

    /// Heartbeat periods of the addresses.
    pub fn periods(&self) -> &HeartbeatPeriods {
        &self.periods
    }

    /// What is doubtful of the times of the frames so far.
    pub fn time_doubt(&self) -> Option<TimeDoubt> {
        self.time_resolution.doubt()
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
        let recent = self.periods.of(address) * 12;
        let recently = |seen: &Option<Instant>| seen.is_some_and(|at| now.since(at) < recent);
        let open = self.finding_tracker.is_open_at(address);
        let differ = self.finding_tracker.is_open(FindingKind::OneAddressTwoNames, address);
        let history = &mut self.histories[address];
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
        self.histories[address].matcher(request, framing).note_request(now, parties);
    }

    /// Notes a broadcast request, to which the addresses respond for which `may_respond` returns true.
    pub fn note_broadcast(
        &mut self,
        now: Instant,
        request: Request,
        framing: Framing,
        parties: RequestOrigin,
        may_respond: impl Fn(Address) -> bool,
    ) {
        self.repeated_frames.note_broadcast(now);
        for address in Address::all().filter(|address| may_respond(*address)) {
            self.finding_tracker.note_request(now, address);
        }
        self.histories.change_where(may_respond, |history| {
            history.matcher(request, framing).note_request(now, parties);
        });
    }

    /// Notes the first frame of a response. If it is one more than the requests, returns
    /// how long after the one before it was received.
    pub fn note_response(
        &mut self,
        now: Instant,
        response: ResponseStart,
        name: Option<&Name>,
        frame: &Frame,
    ) -> Option<Duration> {
        let ResponseStart { from: address, to, request, framing, is_working, is_resolving } =
            response;
        let window = PAIR_WINDOW.min(self.periods.of(address) / 8);
        let history = &mut self.histories[address];
        if !is_resolving {
            history.seen[usize::from(is_working)] = Some(now);
        }
        let matcher = history.matcher(request, framing);
        let (to_all, surplus) = matcher.match_response(now, to, window, frame);
        if to_all {
            self.repeated_frames.note_response(address, surplus.is_some());
        }
        let ignored =
            now < self.ignore_surplus_until || self.repeated_frames.has_duplicate_requests(now);
        // Coarser times do not show that it came soon.
        let is_timed = self.time_resolution.of_last_frame().is_some_and(|it| it <= PAIR_WINDOW);
        let surplus = surplus.filter(|_| !ignored && is_timed)?;
        let apart = surplus.apart;
        if surplus.first.same_on_wire(frame) {
            self.repeated_frames.note_duplicate(now, address, surplus.apart);
            // A gateway repeats both as late.
            let delay = self.delay_of_likely_copies(now, address);
            let is_as_late = |delay: Duration| apart.abs_diff(delay) <= delay / 4 + BOTH_AS_LATE;
            if delay.is_some_and(is_as_late) {
                return None;
            }
        }
        let others = self.findings_at(now, address);
        let evidence = surplus_response(response, surplus, others, name, frame);
        self.report(now, evidence);
        Some(apart)
    }

    /// Notes a consecutive frame of a second transfer that is under way with the same identifier:
    /// one device sends its responses one after the other.
    pub fn note_interleaved_transfers(
        &mut self,
        now: Instant,
        address: Address,
        shown: Interleaving,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        if now < self.ignore_surplus_until || self.repeated_frames.has_duplicate_requests(now) {
            return;
        }
        let others = self.findings_at(now, address);
        let excludes_one_device = shown == Interleaving::Differs;
        let (kind, strength) = match others.kind_of_two_devices() {
            // One device that responds twice, or a gateway that repeats its frames.
            (FindingKind::SameNameSameAddress, strength)
                if !excludes_one_device && !others.has_second_sender =>
            {
                (FindingKind::AnswersDoubled, strength)
            }
            two_devices => two_devices,
        };
        let what = "part of a second response before the end of the first";
        let evidence = NewEvidence {
            name,
            is_response: true,
            is_preliminary: others.may_be_repeated && kind == FindingKind::AnswersDoubled,
            excludes_one_device,
            ..NewEvidence::new(kind, address, frame, strength, what)
        };
        self.report(now, evidence);
    }

    /// Ignores surplus responses for some periods: requests that were delayed have been sent
    /// together, and devices may respond to each of them.
    pub fn ignore_surplus_responses(&mut self, now: Instant) {
        let period = self.periods.typical();
        self.ignore_surplus_until = now + period * DELAYED_RESPONSE_PERIODS;
    }

    /// Notes a complete name response.
    pub fn note_name(&mut self, now: Instant, address: Address, name: &Name, frame: &Frame) {
        let timeout = self.alternation_timeout(address);
        let period = self.periods.of(address);
        let history = &mut self.histories[address];
        let before = history.names.current().cloned();
        history.note_name_response(now, before.as_ref() == Some(name), period);
        let before_at = history.name_at.replace(now);
        let returned = history.names.observe(now, name, timeout).return_count;
        // Boards that are swapped to and fro do not send heartbeats in turns.
        let is_swapped = before_at.is_some_and(|at| history.is_swapped(now, at, period));
        let since = history.names.second_since(now, timeout);
        let before_frame = history.name_frame.replace(*frame);
        let Some(before) = before.filter(|before| before != name) else { return };
        let kind = FindingKind::OneAddressTwoNames;
        // One of two devices left: the name of the other one is what is expected.
        let cleared_at = self.finding_tracker.cleared_at(kind, address);
        if returned.is_none() && cleared_at > before_at {
            return;
        }
        let (strength, since) = match returned {
            Some(_) if !is_swapped => (EvidenceStrength::Strong, Some(since)),
            _ => (EvidenceStrength::Weak, None),
        };
        let evidence = NewEvidence {
            name: Some(&before),
            since,
            is_response: true,
            contradicts: before_frame
                .map(|frame| (format!("name {}", before.quoted()).into(), frame)),
            ..NewEvidence::new(kind, address, frame, strength, format!("name {}", name.quoted()))
        };
        self.report(now, evidence);
        self.finding_tracker.add_name(kind, address, name);
        if returned.is_some() && !is_swapped {
            self.finding_tracker.supersede(
                now,
                now,
                FindingKind::SameNameSameAddress,
                kind,
                address,
            );
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
        let timeout = self.alternation_timeout(address);
        let history = &mut self.histories[address];
        let before = history.services.current().copied();
        let returned = history.services.observe(now, &digest, timeout).return_count;
        let since = history.services.second_since(now, timeout);
        let before_frame = history.services_frame.replace(*frame);
        let others = self.findings_at(now, address);
        if returned.is_none() || others.has_two_names {
            return;
        }
        let (kind, strength) = others.kind_of_two_devices();
        let evidence = NewEvidence {
            name,
            since: Some(since),
            is_response: true,
            excludes_one_device: true,
            contradicts: before_frame.zip(before).map(|(frame, list)| (service_list(list), frame)),
            ..NewEvidence::new(kind, address, frame, strength, service_list(digest))
        };
        self.report(now, evidence);
    }

    /// Notes a heartbeat that does not repeat the previous one. Returns what it changed in the
    /// periods. `sender`: its UID, not blank, and when it first sent a heartbeat from the address.
    pub fn note_heartbeat(
        &mut self,
        now: Instant,
        address: Address,
        sender: Option<(Uid, Instant)>,
        state: SenderState,
        name: Option<&Name>,
        frame: &Frame,
    ) -> PeriodChange {
        self.set_longest_period(address, state.longest_period);
        let period = self.periods.of(address);
        let turn_period = self.turn_period(address);
        let history = &mut self.histories[address];
        if state.is_resolving {
            history.resolving_at = Some(now);
            history.resolving_since.get_or_insert(now);
        } else {
            history.resolving_since = None;
            history.note_settled(now);
            history.seen[usize::from(state.is_working)] = Some(now);
        }
        if let Some((uid, first)) = sender {
            history.note_first(uid, first);
        }
        let uid = sender.map(|(uid, _)| uid);
        history.note_sender(now, uid, period);
        let observed = if let Some(uid) = uid {
            history.uids.observe(now, &uid, turn_period * UID_MEMORY_PERIODS)
        } else {
            let last = history.last_without_uid.replace(now);
            ObservedValue { interval: last.map(|last| now.since(last)), return_count: None }
        };
        // Boards that are swapped to and fro do not send heartbeats in turns.
        let interleaves =
            observed.interval.is_none_or(|it| it <= turn_period.mul_f64(INTERLEAVED_PERIODS));
        let uid_returned = observed.return_count.filter(|_| interleaves);
        // Two devices alternate with every heartbeat; one device keeps a changed U bit for longer.
        let mode_returned =
            history.working.observe(now, &state.is_working, period.mul_f64(1.05)).return_count;
        let resolution = self.time_resolution.of_last_frame();
        // Rounded times do not show the number of senders by that of their heartbeats.
        let is_exact = resolution.is_some_and(|it| !time_resolution::is_coarse(it, period));
        let reboots =
            history.resolving_at.is_some_and(|at| now.since(at) < period * WINDOW_PERIODS);
        let alternates = !reboots && resolution.is_some() && history.note_turns(now, period);
        let times = history.heartbeats.times();
        let counted = if reboots { &history.settled } else { times };
        let mut pattern = resolution.map_or_else(HeartbeatPattern::default, |resolution| {
            let counted = Some(counted).filter(|_| is_exact && !state.is_resolving);
            rhythm::pattern_with_number(times, counted, period, resolution)
        });
        pattern.alternates = alternates;
        let mut is_crowded = is_exact && rhythm::has_several_senders(times, period);
        if let Some(resolution) = resolution.filter(|_| pattern.double_rate || pattern.two_phases) {
            let others = history.heartbeats.prompted.others(counted);
            if others.is_some_and(|it| rhythm::is_of_one_sender(&it, counted, period)) {
                (pattern, is_crowded) = (HeartbeatPattern::default(), false);
            } else if pattern.repeats {
                let repeated = rhythm::repeated_period(counted, period);
                let recurring = rhythm::recurring(counted, repeated);
                let number = Some(&recurring).filter(|_| is_exact);
                let of_recurring =
                    rhythm::pattern_with_number(&recurring, number, period, resolution);
                pattern.repeats = of_recurring.two_phases;
            }
        }
        if is_crowded {
            let until = now + period.mul_f64(KEPT_PERIODS);
            self.finding_tracker.note_several_senders(now, until, address);
        }
        let is_confirmed = self.finding_tracker.has_confirmed_conflict(address);
        let in_other_phase = is_confirmed
            .then(|| {
                let times = history.heartbeats.times();
                rhythm::last_in_other_phase(times, rhythm::repeated_period(times, period))
            })
            .flatten();
        for last in history.uids.second_last_seen().into_iter().chain(in_other_phase) {
            // Some of its heartbeats may be lost.
            let until = last + turn_period * UID_MEMORY_PERIODS;
            self.finding_tracker.note_several_senders(now, until, address);
        }
        history.note_rate(pattern.double_rate, period);
        if is_crowded {
            history.crowded_at = Some(now);
        }
        if pattern.double_rate || pattern.two_phases || uid_returned.is_some() {
            history.second_sender_at = Some(now);
        }

        let identity = identity_kind(address);
        let history = &self.histories[address];
        let confirmed = self.finding_tracker.is_confirmed(identity, address);
        let alternation = match (uid_returned, mode_returned) {
            (Some(_), _) => Some(self.alternating_uids(now, turn_period, history)),
            (None, Some(returns)) if returns >= 2 && (pattern.double_rate || confirmed) => {
                Some(Alternation {
                    again: "U bit changed back".into(),
                    other: "U bit changed".into(),
                    since: history.working.second_since(now, period * UID_MEMORY_PERIODS),
                })
            }
            _ => None,
        };
        let is_open = self.finding_tracker.is_open(identity, address);
        let evidence = match alternation {
            Some(Alternation { again, other, since }) => {
                let previous = history.heartbeats.previous();
                // A device that is claiming the address may still give it up, for a while.
                let may_give_up = |since| now.since(since) < period * CLAIM_PERIODS;
                let follows_claim =
                    previous.is_some_and(|it| history.resolving_at == Some(it.time));
                let (strength, since) = if history.resolving_since.is_some_and(may_give_up) {
                    (EvidenceStrength::Weak, None)
                } else {
                    (EvidenceStrength::Strong, Some(since))
                };
                Some(NewEvidence {
                    name,
                    since,
                    follows_claim,
                    contradicts: previous.map(|previous| (other, *previous)),
                    ..NewEvidence::new(identity, address, frame, strength, again)
                })
            }
            None if is_open => None,
            None => self.rhythm_evidence(now, address, pattern, state.are_two_named, name, frame),
        };
        if let Some(evidence) = evidence {
            let (kind, until) = (evidence.kind, evidence.until.unwrap_or(now));
            self.report(now, evidence);
            if kind == FindingKind::OneAddressTwoNames && state.are_two_named {
                let same = FindingKind::SameNameSameAddress;
                self.finding_tracker.supersede(now, until, same, kind, address);
            }
        }
        // Devices that claim an address in turns send these heartbeats unscheduled.
        let history = &self.histories[address];
        let takes_turns = |interval: Duration| {
            history.sender_changed_at.is_some_and(|at| now.since(at) < interval)
        };
        // A claim comes after a restart.
        let may_be_scheduled = |(before, _): &_| *before == uid && !state.is_resolving;
        let before_loss = history.before_loss.filter(may_be_scheduled);
        let interval = observed.interval.or(before_loss.map(|(_, at)| now.since(at)));
        let scheduled = interval.filter(|it| !(state.is_resolving && takes_turns(*it)));
        self.histories[address].before_loss = None;
        let Some(interval) = scheduled else { return PeriodChange::None };
        let change = self.periods.note_interval(address, interval);
        if change == PeriodChange::Expected {
            self.apply_periods();
        }
        change
    }

    /// Sets the longest period of the senders at `address`, if some are slower than the others.
    fn set_longest_period(&mut self, address: Address, longest: Option<Duration>) {
        let several = self.periods.of(address).mul_f64(SLOWER_FACTOR);
        let longest = longest.filter(|longest| *longest > several);
        let known = &mut self.histories[address].longest_period;
        if std::mem::replace(known, longest) != longest {
            self.apply_periods();
        }
    }

    /// Returns the heartbeat period of the slowest sender at `address`: what two senders show in turns
    /// comes as often.
    pub fn longest_period(&self, address: Address) -> Duration {
        self.periods.of(address).max(self.slower_period(address))
    }

    /// Returns the period in which two senders at `address` send heartbeats in turns: before that of a
    /// second one is known, it may be the profile's.
    fn turn_period(&self, address: Address) -> Duration {
        self.longest_period(address).max(self.finding_tracker.default_period())
    }

    /// Returns the period by which the presence of `address` is judged.
    pub fn presence_period(&self, address: Address) -> Duration {
        self.periods.of_presence(address).max(self.slower_period(address))
    }

    /// Returns the period of a sender that is slower than another one; zero if there is none.
    fn slower_period(&self, address: Address) -> Duration {
        self.histories[address].longest_period.unwrap_or_default()
    }

    fn apply_periods(&mut self) {
        let mut periods = *self.periods.all();
        for (period, address) in periods.iter_mut().zip(Address::all()) {
            *period = self.longest_period(address);
        }
        self.finding_tracker.set_periods(&periods);
        self.repeated_frames.set_period(self.periods.typical());
    }

    fn alternating_uids(
        &self,
        now: Instant,
        period: Duration,
        history: &AddressHistory,
    ) -> Alternation {
        Alternation {
            again: self.uid_text(history.uids.current()),
            other: self.uid_text(history.uids.previous()),
            since: history.uids.second_since(now, period * UID_MEMORY_PERIODS),
        }
    }

    /// Returns the delay between heartbeats of `address` that may be copies and their originals.
    fn delay_of_likely_copies(&self, now: Instant, address: Address) -> Option<Duration> {
        let delay = self.repeated_frames.longest_delay_of_others(now, address);
        let heartbeats = &self.histories[address].heartbeats;
        heartbeats.delay_of_likely_copies(self.periods.of(address), delay)
    }

    /// Returns what the timing of heartbeats shows whose content does not differ.
    fn rhythm_evidence<'a>(
        &mut self,
        now: Instant,
        address: Address,
        pattern: HeartbeatPattern,
        are_two_named: bool,
        name: Option<&'a Name>,
        frame: &'a Frame,
    ) -> Option<NewEvidence<'a>> {
        // A copy whose original was lost is in another phase.
        let times = self.histories[address].heartbeats.times();
        let period = self.periods.of(address);
        if self.repeated_frames.explains_timing(now, address, times, period) {
            return None;
        }
        let same = FindingKind::SameNameSameAddress;
        let others = self.findings_at(now, address);
        let history = &self.histories[address];
        // A single device with another period is followed up and then ignored; a conflict confirmed
        // by other means stays confirmed while the rate is double.
        let is_supported =
            pattern.double_rate && self.finding_tracker.note_double_rate(now, same, address);
        let double_rate = pattern.double_rate
            && (history.double_rate_count <= MAX_DOUBLE_RATE_HEARTBEATS
                || is_supported
                || self.finding_tracker.is_confirmed(same, address));
        // Requests show whether there are two.
        let alternates =
            pattern.alternates && (self.are_requests_rare || !history.are_turns_followed_up(now));
        let (kind, strength, description) = match pattern.two_phases {
            _ if !double_rate && !pattern.two_phases => {
                // Their names show more.
                if !alternates || are_two_named || others.has_two_names {
                    return None;
                }
                let is_new_name = others.had_other_name;
                let kind = if is_new_name { FindingKind::OneAddressTwoNames } else { same };
                (kind, EvidenceStrength::Weak, TWICE_PER_PERIOD)
            }
            true if are_two_named || others.has_two_names => {
                (FindingKind::OneAddressTwoNames, EvidenceStrength::Strong, SECOND_PHASE)
            }
            // A gateway that repeats the frames of one device does the same.
            true if self.delay_of_likely_copies(now, address).is_some() => {
                (same, EvidenceStrength::Weak, EQUAL_SECOND_PHASE)
            }
            true if rhythm::may_restart_often(history.heartbeats.times(), period) => {
                (same, EvidenceStrength::Weak, SECOND_PHASE)
            }
            // One sender with much jitter has two phases by chance.
            true if !pattern.repeats => (same, EvidenceStrength::Weak, SECOND_PHASE),
            // One change of the name does not show that both are there.
            true => (same, EvidenceStrength::Strong, SECOND_PHASE),
            _ if others.had_other_name => {
                (FindingKind::OneAddressTwoNames, EvidenceStrength::Weak, TWICE_THE_RATE)
            }
            _ => (same, EvidenceStrength::Weak, TWICE_THE_RATE),
        };
        let phase_1 = history.heartbeats.previous().filter(|_| pattern.two_phases);
        Some(NewEvidence {
            name,
            since: pattern.since,
            until: rhythm::last_early(history.heartbeats.times(), self.periods.of(address)),
            contradicts: phase_1
                .map(|previous| ("heartbeat, phase 1 of a period".into(), *previous)),
            ..NewEvidence::new(kind, address, frame, strength, description)
        })
    }

    /// Notes a frame sent by descan that was received again after its confirmation: frames are
    /// repeated.
    pub fn note_own_echo(&mut self, now: Instant) {
        self.repeated_frames.note_own_echo(now);
    }

    /// Records a frame from `source` and returns whether it repeats an earlier one.
    pub fn note_frame(
        &mut self,
        now: Instant,
        header: Header,
        is_heartbeat: bool,
        frame: &Frame,
    ) -> Repetition {
        let source = header.source;
        self.time_resolution.note(now, frame);
        if header.response && !header.broadcast {
            self.histories[source].heartbeats.prompted.note_response(now);
        }
        let mut is_new = true;
        if is_heartbeat {
            is_new = self.record_heartbeat(now, source, frame);
        }
        let was_repeated = self.repeated_frames.is_repeated(now, source);
        let is_copy = self.repeated_frames.is_copy(now, source, is_heartbeat, frame);
        if was_repeated
            && !self.repeated_frames.is_repeated(now, source)
            && let Some(since) = self.repeated_frames.two_devices_since(source)
        {
            self.finding_tracker.clear(now, FindingKind::FramesRepeated, source);
            let kind = FindingKind::SameNameSameAddress;
            let what = "second response, much sooner than the second heartbeat";
            let evidence = NewEvidence {
                since: Some(since),
                is_response: true,
                ..NewEvidence::new(kind, source, frame, EvidenceStrength::Strong, what)
            };
            self.report(now, evidence);
        }
        if is_copy {
            Repetition::Ignored
        } else if is_new {
            Repetition::None
        } else {
            Repetition::Heartbeat
        }
    }

    /// Records a heartbeat in the history of its source. Returns true if it does not repeat the
    /// previous one.
    fn record_heartbeat(&mut self, now: Instant, source: Address, frame: &Frame) -> bool {
        let period = self.periods.of(source);
        let resolution = self.time_resolution.of_last_frame();
        let history = &mut self.histories[source];
        let recorded = history.heartbeats.record(now, frame, period, resolution);
        let was_repeated = self.repeated_frames.is_repeated(now, source);
        self.repeated_frames.note_heartbeat(now, source, recorded);
        let is_bus_wide = self.repeated_frames.is_bus_repeated(now);
        let same = FindingKind::SameNameSameAddress;
        // Hardly a gateway repeats frames that late, or responses contradict it, or the delay drifts as that
        // of two clocks: the two devices that were found are still there.
        let drifts = |delay: Duration| {
            let before = self.histories[source].delay_of_two;
            before.is_some_and(|before| delay.abs_diff(before) <= period.mul_f64(MAX_DRIFT_PERIODS))
        };
        let shows_two = |delay: &Duration| {
            !is_bus_wide
                && (*delay > LONGEST_DELAY
                    || self.repeated_frames.two_devices_since(source).is_some()
                    || drifts(*delay))
                && self.finding_tracker.is_confirmed(same, source)
        };
        let delay_of_two = recorded.copy_delay.filter(shows_two);
        if recorded.copy_delay.is_some() {
            self.histories[source].delay_of_two = delay_of_two;
        }
        if delay_of_two.is_some() {
            self.finding_tracker.renew(now, same, source);
            return recorded.is_new;
        }
        if !self.repeated_frames.is_repeated(now, source) {
            return recorded.is_new;
        }
        let address = Some(source).filter(|_| !is_bus_wide);
        if !was_repeated {
            for kind in [FindingKind::SameNameSameAddress, FindingKind::AnswersDoubled] {
                self.finding_tracker.reset_suspicion(kind, address);
            }
        }
        let original = self.histories[source].heartbeats.last();
        if recorded.copy_delay.is_some()
            && let Some(original) = original.copied()
        {
            let repeated = self.repeated_frames.repeated_frames(now, address);
            self.finding_tracker.note_repeated(now, address, &repeated, [original, *frame]);
        }
        recorded.is_new
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
        let before = self.last_heartbeat(other);
        let evidence = NewEvidence {
            since: Some(since),
            contradicts: before.map(|before| (what.into(), before)),
            ..NewEvidence::new(kind, low, frame, EvidenceStrength::Strong, what)
        };
        if let Some(at) = self.report(now, evidence) {
            self.finding_tracker.add_address(at, high);
        }
    }

    /// Notes a frame of another node from descan's own address.
    pub fn note_own_address_used(&mut self, now: Instant, address: Address, frame: &Frame) {
        if address == Address::DEBUG {
            let kind = FindingKind::TwoDebugDevices;
            let what = finding_text::NOT_SENT_BY_DESCAN;
            let evidence = NewEvidence::new(kind, address, frame, EvidenceStrength::Strong, what);
            self.report(now, evidence);
        }
    }

    /// Notes what the malformed response noted next is for, if that is known.
    pub fn note_malformed_request(&mut self, address: Address, request: Option<Request>) {
        self.histories[address].malformed = request;
    }

    /// Notes a malformed response.
    pub fn note_malformed(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        fault: &dyn std::fmt::Display,
        frame: &Frame,
        strength: EvidenceStrength,
    ) {
        let kind = FindingKind::MalformedAnswer;
        let what = "response, or its last frame";
        let evidence =
            NewEvidence { name, ..NewEvidence::new(kind, address, frame, strength, what) };
        if let Some(at) = self.report(now, evidence) {
            self.finding_tracker
                .set_text(at, |device| format!("{device} sends malformed DES responses: {fault}."));
        }
    }

    /// Notes a multi-frame response that was aborted at the same place as before. Call after
    /// [`note_malformed_request`](Self::note_malformed_request). Some times in a row it may be
    /// chance; after that it is the device.
    pub fn note_aborted_response(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        fault: TransferFault,
        frame: &Frame,
    ) {
        let kind = FindingKind::MalformedAnswer;
        let is_open = self.finding_tracker.is_open(kind, address);
        let history = &mut self.histories[address];
        history.aborted = if is_open { history.aborted.saturating_add(1) } else { 1 };
        let request = history.malformed.unwrap_or(Request::Services);
        let by_chance = if history.responded[request as usize] {
            ABORTED_BY_CHANCE_AFTER_RESPONSE
        } else {
            ABORTED_BY_CHANCE
        };
        let strength = if history.aborted > by_chance {
            EvidenceStrength::Proof
        } else {
            EvidenceStrength::Weak
        };
        let what = "last frame of an aborted response";
        let evidence =
            NewEvidence { name, ..NewEvidence::new(kind, address, frame, strength, what) };
        if let Some(at) = self.report(now, evidence) {
            self.finding_tracker.set_text(at, |device| {
                format!("{device} aborts every multi-frame response: {fault}.")
            });
        }
    }

    /// Returns true if there are signs that several devices use `address`: a conflict is suspected
    /// there, or the UID changed.
    pub fn is_shared_perhaps(&self, now: Instant, address: Address) -> bool {
        let remembered = self.turn_period(address) * UID_MEMORY_PERIODS;
        self.finding_tracker.is_open_at(address)
            || self.histories[address].uids.changed_within(now, remembered)
    }

    /// Returns true if the heartbeats from `address` carry no UID, by which devices differ.
    pub fn has_no_uid(&self, address: Address) -> bool {
        self.histories[address].last_without_uid.is_some()
    }

    /// Returns true if devices seem to receive requests twice, or descan receives all frames twice.
    pub fn has_duplicate_requests(&self, now: Instant) -> bool {
        self.repeated_frames.has_duplicate_requests(now)
    }

    /// Notes a valid response, which clears malformed-answer of the same request.
    pub fn note_valid_response(&mut self, now: Instant, address: Address, request: Request) {
        let history = &mut self.histories[address];
        history.responded[request as usize] = true;
        if history.malformed.unwrap_or(Request::Services) == request {
            history.aborted = 0;
            self.finding_tracker.clear(now, FindingKind::MalformedAnswer, address);
        }
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
        let evidence = NewEvidence {
            name,
            ..NewEvidence::new(kind, address, frame, EvidenceStrength::Proof, what)
        };
        self.report(now, evidence);
    }

    /// Notes a request of a device in CFG or BOOT.
    pub fn note_request_in_cfg(
        &mut self,
        now: Instant,
        address: Address,
        name: Option<&Name>,
        frame: &Frame,
    ) {
        let what = "request between two heartbeats in CFG or BOOT";
        let kind = FindingKind::CfgSendsRequests;
        let header = frame.platform_id().map(Header::decode);
        // With U = 0 it says that it works: it may have done so between the heartbeats.
        let strength = if header.is_some_and(|header| header.from_non_working) {
            EvidenceStrength::Proof
        } else {
            EvidenceStrength::Weak
        };
        let evidence =
            NewEvidence { name, ..NewEvidence::new(kind, address, frame, strength, what) };
        self.report(now, evidence);
    }

    /// Returns the last heartbeat frame of `address`.
    pub fn last_heartbeat(&self, address: Address) -> Option<Frame> {
        self.histories[address].heartbeats.last().copied()
    }

    /// Forgets the history of `address` and clears its conflicts: its device is lost.
    pub fn forget(&mut self, now: Instant, address: Address) {
        self.histories[address].forget(self.periods.is_measured(address));
        self.periods.forget(address);
        self.apply_periods();
        self.finding_tracker.forget(now, address);
    }

    /// Forgets all addresses: no device uses them.
    pub fn remove_devices(&mut self) {
        self.periods.clear();
        self.histories = AddressTable::new();
        self.repeated_frames = RepeatedFrameDetector::new(self.periods.typical());
        self.finding_tracker.remove_findings_of_devices();
        self.apply_periods();
    }

    /// Forgets the values of `address` that could alternate: its device moved away, so the next one
    /// there is not in conflict with it.
    pub fn note_left(&mut self, address: Address) {
        self.histories[address].forget_values();
    }

    // --- state --------------------------------------------------------------------------

    /// Reports evidence, with the UIDs in the heartbeats of its address.
    fn report(&mut self, now: Instant, evidence: NewEvidence<'_>) -> Option<usize> {
        let address = evidence.address;
        let at = self.finding_tracker.report(now, evidence)?;
        let remembered = self.turn_period(address) * UID_MEMORY_PERIODS;
        let history = &self.histories[address];
        let uids = history.uids.recent(now, remembered).into_iter().map(|(uid, since)| {
            // An absence is longer than the memory.
            let was_absent = |first: &Instant| since.since(*first) > remembered;
            let first = history.first_of(*uid).filter(was_absent).unwrap_or(since);
            SeenUid { uid: *uid, text: uid.text(&self.alphabet), since, first }
        });
        let mut uids: Vec<SeenUid> = uids.collect();
        uids.sort_by_key(|seen| (seen.first, seen.since));
        self.finding_tracker.set_uids(at, uids);
        Some(at)
    }

    /// Returns the text of evidence that shows a heartbeat with this UID.
    fn uid_text(&self, uid: Option<&Uid>) -> Cow<'static, str> {
        let text = uid.map_or(String::new(), |uid| uid.text(&self.alphabet).to_string());
        format!("UID {}", Escaped(text.as_bytes())).into()
    }

    /// Time within which an alternating response must return to its previous value.
    fn alternation_timeout(&self, address: Address) -> Duration {
        let period = self.periods.of(address);
        if self.are_requests_rare {
            self.finding_tracker.max_evidence_lifetime(period)
        } else {
            period * 3
        }
    }

    /// Returns the findings about `address` that explain other evidence there.
    fn findings_at(&self, now: Instant, address: Address) -> AddressFindings {
        let two_names = FindingKind::OneAddressTwoNames;
        let history = &self.histories[address];
        let AddressHistory { names, heartbeats, second_sender_at, .. } = history;
        let period = self.periods.of(address);
        let recent = period.mul_f64(INTERLEAVED_PERIODS);
        let changed_within = |periods: u32| {
            names.changed_within(now, period * periods)
                && history.name_repeats < NAMES_WITHOUT_OTHER
        };
        AddressFindings {
            has_second_sender: second_sender_at.is_some_and(|at| now.since(at) < recent)
                || self.repeated_frames.two_devices_since(address).is_some()
                || self.finding_tracker.has_strong(FindingKind::SameNameSameAddress, address),
            has_two_names: self.finding_tracker.has_strong(two_names, address)
                && changed_within(NAME_GAP_PERIODS),
            had_other_name: changed_within(NAME_MEMORY_PERIODS),
            may_be_repeated: (1..=COPIES_OF_ONE as usize).contains(&heartbeats.times().len()),
        }
    }
}

/// Two identities in the heartbeats of one address.
struct Alternation {
    /// What the last heartbeat shows.
    again: Cow<'static, str>,
    /// What the one before it shows.
    other: Cow<'static, str>,
    /// Since when both are present.
    since: Instant,
}

/// Returns the description of evidence in a services response, by the hash of its list.
fn service_list(digest: u64) -> Cow<'static, str> {
    format!("service list {:04X}, in turns with another", digest & 0xFFFF).into()
}

/// Returns the kind of finding for heartbeats of two identities at `address`.
fn identity_kind(address: Address) -> FindingKind {
    if address == Address::DEBUG {
        FindingKind::TwoDebugDevices
    } else {
        FindingKind::OneAddressTwoIdentities
    }
}

/// Returns what a response beyond the number of requests shows.
fn surplus_response<'a>(
    response: ResponseStart,
    surplus: SurplusResponse,
    others: AddressFindings,
    name: Option<&'a Name>,
    frame: &'a Frame,
) -> NewEvidence<'a> {
    let ResponseStart { from: address, request, framing, is_working, .. } = response;
    // A non-working node may respond both to the request for working nodes and to that for
    // non-working ones.
    let strength = if surplus.is_targeted || is_working {
        EvidenceStrength::Strong
    } else {
        EvidenceStrength::Weak
    };
    let differ = message(&surplus.first, framing) != message(frame, framing);
    let (kind, strength) = match request {
        Request::Name if differ => (FindingKind::OneAddressTwoNames, strength),
        _ if others.has_two_names => (FindingKind::OneAddressTwoNames, strength),
        Request::Services if others.had_other_name => {
            (FindingKind::OneAddressTwoNames, EvidenceStrength::Weak)
        }
        _ if others.has_second_sender => (FindingKind::SameNameSameAddress, strength),
        _ => (FindingKind::AnswersDoubled, strength),
    };
    NewEvidence {
        name,
        is_response: true,
        is_preliminary: others.may_be_repeated && kind == FindingKind::AnswersDoubled,
        contradicts: Some(("first response to one request".into(), surplus.first)),
        ..NewEvidence::new(kind, address, frame, strength, "second response to one request")
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
