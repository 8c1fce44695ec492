//! Device rows: everything known about one device, its queries, heartbeat statistics and quirks.
//!
//! A device is the pair (name, address) on a bus; a node whose name is not known yet is a row too
//! (protocol §5.1). Changed only by the [`super::Engine`].

use super::ServicesNews;
use super::debug_messages::DebugCounts;
use super::descriptors::DeviceDescriptor;
use super::period_error::{PeriodError, PeriodMeter};
use crate::frame::{BusIndex, Frame};
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::des::{Request, ResponseFault};
use crate::wire::framing::Framing;
use crate::wire::id::Address;
use crate::wire::isotp::TransferFault;
use crate::wire::node::{Mode, Uid};
use std::collections::VecDeque;
use std::fmt;

/// Identity of a device row while descan runs; stays the same when the device changes its address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DeviceId {
    /// Bus of the device.
    pub bus: BusIndex,
    /// Number on that bus, in the order of appearance; never reused.
    pub number: u32,
}

/// Presence of a device, by the age of its frames (protocol §4.6).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Presence {
    /// Heartbeats arrive.
    Online,
    /// The last heartbeat is older than 2.5 periods.
    Stale,
    /// Heartbeats are missing, other frames arrive.
    Silent,
    /// Heartbeats are missing and its last known mode was IDLE.
    Asleep,
    /// No frame for 5 periods.
    Lost,
}

impl Presence {
    /// Returns the name in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Presence::Online => "online",
            Presence::Stale => "stale",
            Presence::Silent => "silent",
            Presence::Asleep => "asleep",
            Presence::Lost => "lost",
        }
    }
}

impl fmt::Display for Presence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// One service in a services response (protocol §2.3).
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DeviceService {
    /// Index in the response, from 0.
    pub index: u8,
    /// Name of the service.
    pub name: Name,
    /// Version; empty where the response has none.
    pub version: Name,
    /// Further strings after the version.
    pub extra: Vec<Name>,
}

/// Statistics of a device's heartbeats.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct HeartbeatStats {
    /// Number of heartbeats received.
    pub count: u64,
    /// Time of the last heartbeat; `None` before the first.
    pub last: Option<Instant>,
    /// Number of heartbeats missed while the bus was up.
    pub missed: u64,
    /// Between heartbeats of whatever board.
    all: IntervalStats,
    /// Between heartbeats of one board.
    of_board: IntervalStats,
    /// Period and jitter that are shown, in microseconds.
    steady_period_us: f64,
    steady_jitter_us: f64,
    /// Last heartbeat before one that was out of phase.
    in_phase: Option<Instant>,
    /// Last heartbeats of the last two UIDs, the later one first: several boards at one address each
    /// have their own period.
    by_uid: [Option<(Uid, Instant)>; 2],
    period_meter: PeriodMeter,
}

/// Mean and variance of intervals, the last 64 of them above all.
#[derive(Clone, Copy, Debug, Default)]
struct IntervalStats {
    count: u64,
    mean_us: f64,
    variance_us2: f64,
}

impl IntervalStats {
    fn add(&mut self, interval: Duration) {
        self.count += 1;
        let weight = 1.0 / self.count.min(64) as f64;
        let micros = interval.as_micros() as f64;
        let off = micros - self.mean_us;
        self.mean_us += weight * off;
        self.variance_us2 = (1.0 - weight) * (self.variance_us2 + weight * off * off);
    }

    fn deviation_us(&self) -> f64 {
        self.variance_us2.max(0.0).sqrt()
    }

    fn mean(&self) -> Option<Duration> {
        (self.count > 0).then(|| Duration::from_micros(self.mean_us as u64))
    }

    fn deviation(&self) -> Option<Duration> {
        (self.count > 1).then(|| Duration::from_micros(self.deviation_us() as u64))
    }
}

/// Age of the last heartbeat, in periods, at which a device is stale. Protocol §4.6.
pub(super) const STALE_PERIODS: f64 = 2.5;
/// Time since the last heartbeat, in periods, above which at least one is missed. A gap that long
/// may be a reboot. Tuned with the simulation: between one period with the jitter of a busy bus,
/// and the 1.5 periods of silence of address resolution (CAN platform §3.2.4.2).
pub(super) const MISSED_HEARTBEAT_PERIODS: f64 = 1.4;

/// Changes of the period and of the jitter that the screen shows, as fractions: smaller ones would
/// redraw the row of a healthy device.
const STEADY_PERIOD: f64 = 0.005;
const STEADY_JITTER: f64 = 0.2;

impl HeartbeatStats {
    /// Returns the mean interval between heartbeats of one board, without gaps; `None` before the
    /// first interval.
    pub fn period(&self) -> Option<Duration> {
        self.of_board.mean()
    }

    /// Returns the standard deviation of the interval; `None` before the second interval.
    pub fn jitter(&self) -> Option<Duration> {
        self.of_board.deviation()
    }

    /// Returns the mean interval between heartbeats of whatever board.
    pub(super) fn period_of_all(&self) -> Option<Duration> {
        self.all.mean()
    }

    /// Returns the standard deviation of that interval.
    pub(super) fn jitter_of_all(&self) -> Option<Duration> {
        self.all.deviation()
    }

    /// Returns the period for the screen: it changes only when the mean interval has changed by half a percent.
    /// `None` before the first interval.
    pub fn steady_period(&self) -> Option<Duration> {
        (self.of_board.count > 0).then(|| Duration::from_micros(self.steady_period_us as u64))
    }

    /// Returns the jitter for the screen: it changes only when the standard deviation has changed
    /// by a fifth and by 1 ms. `None` before the second interval.
    pub fn steady_jitter(&self) -> Option<Duration> {
        (self.of_board.count > 1).then(|| Duration::from_micros(self.steady_jitter_us as u64))
    }

    /// Returns the error of the period against the nominal one; `None` before it is known, and of
    /// several boards.
    pub fn period_error(&self) -> Option<PeriodError> {
        self.period_meter.error(self.jitter()?).filter(|_| !self.has_two_uids())
    }

    /// Takes over period and jitter for the screen where they have changed enough.
    fn steady(&mut self) {
        let IntervalStats { count, mean_us, .. } = self.of_board;
        let jitter_us = self.of_board.deviation_us();
        // The screen shows milliseconds.
        let tolerance = (self.steady_jitter_us * STEADY_JITTER).max(1000.0);
        if count <= 2 || (jitter_us - self.steady_jitter_us).abs() > tolerance {
            self.steady_jitter_us = jitter_us;
        }
        let tolerance = self.steady_period_us * STEADY_PERIOD;
        if (mean_us - self.steady_period_us).abs() > tolerance {
            self.steady_period_us = mean_us;
        }
    }

    /// Counts a heartbeat and returns the time since the previous one, of whatever board. `period` is
    /// the expected interval; `missed_in_outage` is the number of heartbeats due since the previous
    /// one while the bus was down; `None`: the interval is a guess, so none is counted as missed.
    pub(super) fn record_heartbeat(
        &mut self,
        now: Instant,
        uid: Option<Uid>,
        period: Duration,
        missed_in_outage: Option<u64>,
    ) -> Option<Duration> {
        self.count += 1;
        let before = self.last.replace(now);
        let gap = before.map(|last| now.since(last));
        let own_before = match uid {
            Some(uid) => self.replace_last_of(uid, now).or(before.filter(|_| !self.has_two_uids())),
            None => before,
        };
        let is_interval = |gap: &Duration| {
            let ratio = gap.as_secs_f64() / period.as_secs_f64();
            ratio > 0.3 && ratio <= 1.5
        };
        if let Some(interval) = gap.filter(is_interval) {
            self.all.add(interval);
        }
        let own_gap = own_before.map(|last| now.since(last));
        if let Some(interval) = own_gap.filter(is_interval) {
            self.of_board.add(interval);
            self.steady();
        }
        self.period_meter.note(now, period);
        // With another board in between, it is not known whether this one was there.
        if let Some(gap) = gap.filter(|_| own_before == before) {
            let ratio = gap.as_secs_f64() / period.as_secs_f64();
            if ratio > 1.5 {
                let due = (ratio - 0.5) as u64;
                self.missed += missed_in_outage.map_or(0, |missed| due.saturating_sub(missed));
            }
        }
        gap
    }

    /// Sets the time of the last heartbeat with a UID; returns the one before.
    fn replace_last_of(&mut self, uid: Uid, now: Instant) -> Option<Instant> {
        let is_it = |it: &Option<(Uid, Instant)>| it.is_some_and(|(known, _)| known == uid);
        let at = self.by_uid.iter().position(is_it).unwrap_or(1);
        let before = self.by_uid[at].filter(|(known, _)| *known == uid);
        self.by_uid[..=at].rotate_right(1);
        self.by_uid[0] = Some((uid, now));
        before.map(|(_, time)| time)
    }

    /// Returns true if heartbeats with two UIDs were received.
    fn has_two_uids(&self) -> bool {
        self.by_uid[1].is_some()
    }

    /// Forgets the phase, because another device sends the heartbeats now.
    pub(super) fn forget_phase(&mut self) {
        self.in_phase = None;
        self.period_meter.forget();
    }

    /// Returns true if the heartbeat at `now` shows that its sender restarted: the previous
    /// heartbeat was not a whole number of periods after the one before it, and this one keeps the
    /// new phase. A heartbeat that only the bus delayed is followed by one in the old phase.
    pub(super) fn is_phase_shifted(
        &mut self,
        now: Instant,
        before: Option<Instant>,
        period: Duration,
        jitter: Option<Duration>,
    ) -> bool {
        // Without a known jitter there is no phase.
        let (Some(before), Some(jitter)) = (before, jitter) else { return false };
        let noise = jitter.as_secs_f64() / period.as_secs_f64();
        let off = |since: Instant| {
            let periods = now.since(since).as_secs_f64() / period.as_secs_f64();
            let known = (MISSED_HEARTBEAT_PERIODS..=30.0).contains(&periods);
            known && (periods - periods.round()).abs() > (4.0 * noise).max(0.15)
        };
        let follows = now.since(before) < period.mul_f64(MISSED_HEARTBEAT_PERIODS);
        let shifted = follows && self.in_phase.take().is_some_and(off);
        if !follows {
            self.in_phase = off(before).then_some(before);
        }
        shifted
    }
}

/// State of a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum QueryState {
    /// No request is sent or awaited: listen-only, the first request is not due yet, or the query
    /// was restarted.
    #[default]
    NotSent,
    /// Request sent, no response yet.
    Sent,
    /// A multi-frame response is arriving.
    Receiving,
    /// Response received.
    Responded,
    /// All attempts were used without a response; the query is repeated later.
    NoResponse,
}

/// A query, for the name or for the services, with its retries and its last result.
#[derive(Clone, Copy, Debug, Default)]
#[non_exhaustive]
pub struct Query {
    /// State of the query.
    pub state: QueryState,
    /// Attempts of the current query.
    pub attempts: u32,
    /// Time of the last request; `None` before the first.
    pub sent_at: Option<Instant>,
    /// Time of the last response; `None` before the first.
    pub responded_at: Option<Instant>,
    /// Time from the request to the end of the last response.
    pub response_time: Option<Duration>,
    /// Fault of the last response, if any.
    pub fault: Option<QueryFault>,
    /// True if all attempts since the last response were used; stays true while the query is
    /// repeated.
    pub has_failed_since_response: bool,
    /// Time of the next request, if one is planned.
    pub(super) due: Option<Instant>,
    /// Timeout of the response, or of its next frame.
    pub(super) deadline: Option<Instant>,
}

impl Query {
    /// Returns true if a response is awaited.
    pub fn is_waiting(&self) -> bool {
        matches!(self.state, QueryState::Sent | QueryState::Receiving)
    }

    /// Returns true if a request was sent less than `within` ago.
    pub(super) fn is_sent_within(&self, now: Instant, within: Duration) -> bool {
        self.sent_at.is_some_and(|at| now.since(at) < within)
    }

    /// Plans a request at `at` with all attempts available, unless a response is awaited.
    pub(super) fn schedule(&mut self, at: Instant) {
        if !self.is_waiting() {
            self.attempts = 0;
            self.due = Some(self.due.map_or(at, |due| due.min(at)));
        }
    }

    /// Like [`schedule`](Self::schedule), for a device that has changed: an attempt under way
    /// counts as the first one.
    pub(super) fn restart(&mut self, at: Instant) {
        self.attempts = self.attempts.min(1);
        self.schedule(at);
    }

    /// Ends the query without a response, until `again`.
    pub(super) fn give_up(&mut self, again: Instant) {
        self.state = QueryState::NoResponse;
        self.has_failed_since_response = true;
        self.due = Some(again);
    }

    /// Records a response, with its fault if any.
    ///
    /// `broadcast` is the time of a broadcast request of descan that may be answered by it. A
    /// device answers in the order of the requests.
    pub(super) fn record_response(
        &mut self,
        now: Instant,
        fault: Option<QueryFault>,
        broadcast: Option<Instant>,
    ) {
        let broadcast = broadcast.filter(|at| self.responded_at.is_none_or(|last| last < *at));
        let targeted = self.sent_at.filter(|_| self.is_waiting());
        if let Some(sent_at) = broadcast.into_iter().chain(targeted).min() {
            self.response_time = Some(now.since(sent_at));
        }
        self.state = QueryState::Responded;
        self.responded_at = Some(now);
        self.has_failed_since_response = false;
        self.attempts = 0;
        self.fault = fault;
        self.due = None;
        self.deadline = None;
    }
}

/// Fault of a response that could not be used, or only in part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum QueryFault {
    /// The message is malformed.
    #[error("{0}")]
    Response(#[from] ResponseFault),
    /// The multi-frame transfer was aborted.
    #[error("{0}")]
    Transfer(#[from] TransferFault),
    /// The device sent a response with ERR = 0: it reports an error.
    #[error("the device reports an error")]
    ErrorResponse,
    /// Two devices began a multi-frame response at once, and would destroy each other's frames.
    #[error("two devices respond at once")]
    TwoResponses,
}

/// Deviation of a device from the platform that descan tolerates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ProtocolDeviation {
    /// Responses carry the request's DST instead of the requester's address.
    RspDstEcho,
    /// Sends identifiers that are none of the nine message types.
    NonConforming,
    /// Responds in both framings.
    BothFramings,
    /// Heartbeats are shorter than the profile's layout.
    ShortHeartbeat,
    /// The mode in its heartbeat contradicts the U bit.
    ModeContradictsU,
}

impl ProtocolDeviation {
    /// The word for it, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            ProtocolDeviation::RspDstEcho => "rsp-dst-echo",
            ProtocolDeviation::NonConforming => "non-conforming",
            ProtocolDeviation::BothFramings => "both-framings",
            ProtocolDeviation::ShortHeartbeat => "short-heartbeat",
            ProtocolDeviation::ModeContradictsU => "mode-contradicts-u",
        }
    }

    /// Returns a description for the screen.
    pub const fn describe(self) -> &'static str {
        match self {
            ProtocolDeviation::RspDstEcho => {
                "responses carry the request's DST, not the requester's address"
            }
            ProtocolDeviation::NonConforming => "sends identifiers with an unknown message type",
            ProtocolDeviation::BothFramings => "responds in both framings",
            ProtocolDeviation::ShortHeartbeat => "heartbeats shorter than the profile's layout",
            ProtocolDeviation::ModeContradictsU => "the heartbeat's mode contradicts the U bit",
        }
    }
}

/// Maximum number of further service lists stored per device. Bounds the memory: one for each of
/// the eight values that an address remembers.
const MAX_OTHER_SERVICES: usize = 7;
/// Maximum number of mode changes stored per device. Bounds the memory: the modes of five boots.
const MAX_MODES: usize = 16;

/// Mode of a device with the time of its begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ModeChange {
    /// Time of the first heartbeat in this mode.
    pub time: Instant,
    /// The mode.
    pub mode: Mode,
}

/// Everything known about one device: a row on the screen.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Device {
    /// Identity of the row.
    pub id: DeviceId,
    /// Address: SRC of its frames.
    pub address: Address,
    /// Name; `None` while only its frames are known.
    pub name: Option<Name>,
    /// Presence.
    pub presence: Presence,
    /// Time of the last change of `presence`.
    pub presence_since: Instant,
    /// True if it is in a working mode, by the U bit of its last frame.
    pub is_working: bool,
    /// Mode in its heartbeats; `None` where they carry none.
    pub mode: Option<Mode>,
    /// Error code in its heartbeats; `None` where they carry none.
    pub error_code: Option<u8>,
    /// DEV_CFG_UID in its heartbeats; `None` where they carry none.
    pub uid: Option<Uid>,
    /// Framing of its responses; `None` before the first.
    pub framing: Option<Framing>,
    /// Services; `None` before the first services response.
    pub services: Option<Vec<DeviceService>>,
    /// Services before their last change; `None` if they never changed.
    pub previous_services: Option<Vec<DeviceService>>,
    /// Services when the device was first heard, or when the user last confirmed the changes; `None`
    /// before the first services response. The versions that changed are those beside them.
    pub first_services: Option<Vec<DeviceService>>,
    /// True if `services` was received while several devices used the address: it is the list of
    /// one of them.
    pub services_are_shared: bool,
    /// Other lists received while several devices used the address, each of one of them, at most 7.
    pub other_services: Vec<Vec<DeviceService>>,
    /// Shortest and longest time between the responses of two devices to one request, since the
    /// conflict began.
    pub(super) responses_apart: Option<(Duration, Duration)>,
    /// True if the services are requested although several devices use the address.
    pub(super) asks_all_services: bool,
    /// True if that was done since the conflict began.
    pub(super) has_asked_all_services: bool,
    /// Heartbeat statistics.
    pub heartbeat: HeartbeatStats,
    /// Query for the name.
    pub name_query: Query,
    /// Query for the services.
    pub services_query: Query,
    /// What it says of itself and of its configuration.
    pub descriptor: DeviceDescriptor,
    /// DEBUG messages from it.
    pub debug_messages: DebugCounts,
    /// Deviations from the platform, each once.
    pub deviations: Vec<ProtocolDeviation>,
    /// Mode changes, oldest first, at most 16.
    pub mode_history: VecDeque<ModeChange>,
    /// Time of the first frame.
    pub first_seen: Instant,
    /// Time of the last frame.
    pub last_seen: Instant,
    /// Number of frames received from it.
    pub frame_count: u64,
    /// Number of reboots detected.
    pub reboots: u32,
    /// Time of the last reboot; `None` if there was none.
    pub rebooted_at: Option<Instant>,
    /// Time at which another row became the current one at its address.
    pub(crate) replaced_at: Option<Instant>,
    /// UID in the last heartbeat from its address, which may be of another device.
    pub(super) heartbeat_uid: Option<Uid>,
    /// UID in its heartbeats before the present one.
    pub(super) uid_before: Option<Uid>,
    /// A request that it sent after a heartbeat in CFG or BOOT, until the next heartbeat.
    pub(super) request_in_cfg: Option<Box<Frame>>,
    /// True if the last heartbeat had mode INIT or ARSLV: the node is about to change its mode.
    pub(super) is_resolving: bool,
    /// True if the last heartbeat from its address came from another node that has no row yet.
    pub(super) last_heartbeat_was_other_node: bool,
    /// Previous address; `None` if it never moved.
    pub moved_from: Option<Address>,
    /// True if it is a debug device: at address 0, or with descan's own name.
    pub is_debug: bool,
    /// Number of successive enumeration rounds without a response.
    pub rounds_missed: u32,
}

impl Device {
    /// Creates the row of a node whose first frame was received at `now`.
    pub(super) fn new(id: DeviceId, now: Instant, address: Address, working: bool) -> Self {
        Self {
            id,
            address,
            name: None,
            presence: Presence::Online,
            presence_since: now,
            is_working: working,
            mode: None,
            error_code: None,
            uid: None,
            framing: None,
            services: None,
            previous_services: None,
            first_services: None,
            services_are_shared: false,
            other_services: Vec::new(),
            responses_apart: None,
            asks_all_services: false,
            has_asked_all_services: false,
            heartbeat: HeartbeatStats::default(),
            name_query: Query::default(),
            services_query: Query::default(),
            descriptor: DeviceDescriptor::default(),
            debug_messages: DebugCounts::default(),
            deviations: Vec::new(),
            mode_history: VecDeque::new(),
            first_seen: now,
            last_seen: now,
            frame_count: 0,
            reboots: 0,
            rebooted_at: None,
            replaced_at: None,
            heartbeat_uid: None,
            uid_before: None,
            request_in_cfg: None,
            is_resolving: false,
            last_heartbeat_was_other_node: false,
            moved_from: None,
            is_debug: address == Address::DEBUG,
            rounds_missed: 0,
        }
    }

    /// Returns true if its services differ from [`Self::first_services`].
    pub fn has_changed_services(&self) -> bool {
        self.services.is_some() && self.services != self.first_services
    }

    /// Returns true if the device's name has exactly these bytes.
    pub fn is_named(&self, name: &[u8]) -> bool {
        self.name.as_ref().is_some_and(|own| own.as_bytes() == name)
    }

    /// Returns the query of that kind.
    pub fn query(&self, request: Request) -> &Query {
        match request {
            Request::Name => &self.name_query,
            Request::Services => &self.services_query,
        }
    }

    pub(super) fn query_mut(&mut self, request: Request) -> &mut Query {
        match request {
            Request::Name => &mut self.name_query,
            Request::Services => &mut self.services_query,
        }
    }

    /// Takes over what was last received from its address under another row.
    pub(super) fn copy_state_from(&mut self, live: &Self) {
        self.heartbeat = live.heartbeat.clone();
        self.uid = live.uid;
        self.heartbeat_uid = live.heartbeat_uid;
        self.mode = live.mode;
        self.error_code = live.error_code;
        self.is_working = live.is_working;
        self.is_resolving = live.is_resolving;
        self.last_seen = live.last_seen;
    }

    /// Returns true if two devices at the address respond so soon after each other that they would
    /// destroy each other's service lists: not both are read.
    pub fn has_colliding_services(&self) -> bool {
        self.services_query.fault == Some(QueryFault::TwoResponses)
            || self.responses_apart.is_some() && !self.has_asked_all_services
    }

    /// Stores a service list. `is_shared`: several devices use the address. Returns what is new
    /// about it; `None` if it is known.
    pub(super) fn store_services(
        &mut self,
        list: Vec<DeviceService>,
        is_shared: bool,
    ) -> Option<ServicesNews> {
        let is_known = self.services.as_ref() == Some(&list);
        if is_shared && self.services.is_some() {
            let is_new = !is_known
                && !self.other_services.contains(&list)
                && self.other_services.len() < MAX_OTHER_SERVICES;
            if is_new {
                self.other_services.push(list);
            }
            return is_new.then_some(ServicesNews::OtherDevice);
        }
        self.services_are_shared = is_shared;
        self.other_services.clear();
        if is_known {
            return None;
        }
        self.first_services.get_or_insert_with(|| list.clone());
        self.previous_services = self.services.replace(list).or(self.previous_services.take());
        let has_changed = self.previous_services.is_some();
        Some(if has_changed { ServicesNews::Changed } else { ServicesNews::First })
    }

    /// Takes the present services as those from which changes are counted.
    pub(super) fn confirm_services(&mut self) {
        self.first_services.clone_from(&self.services);
        self.previous_services = None;
    }

    /// Restarts queries that failed while the device was silent. Call before `last_seen` is
    /// updated. Applies if the silence exceeds 2.5 heartbeat periods and four times the device's
    /// mean frame interval. Returns true if a query was restarted.
    pub(super) fn retry_after_silence(&mut self, now: Instant, period: Duration) -> bool {
        // A name query waits without a deadline until the current enumeration round is over.
        let waits_for_round = |it: &Query| it.state == QueryState::Sent && it.deadline.is_none();
        let has_failed = |it: &Query| it.state == QueryState::NoResponse || waits_for_round(it);
        if !has_failed(&self.name_query) && !has_failed(&self.services_query) {
            return false;
        }
        let silence = now.since(self.last_seen);
        let usual =
            self.last_seen.since(self.first_seen).mul_f64(1.0 / self.frame_count.max(1) as f64);
        if silence < period.mul_f64(STALE_PERIODS) || silence < usual * 4 {
            return false;
        }
        let mut is_scheduled = false;
        for query in [&mut self.name_query, &mut self.services_query] {
            if has_failed(query) && query.sent_at >= Some(self.last_seen) {
                if query.is_waiting() {
                    query.state = QueryState::NotSent;
                }
                query.restart(now);
                is_scheduled = true;
            }
        }
        is_scheduled
    }

    /// Appends a mode change; drops the oldest beyond 16.
    pub(super) fn remember_mode(&mut self, change: ModeChange) {
        if self.mode_history.len() == MAX_MODES {
            self.mode_history.pop_front();
        }
        self.mode_history.push_back(change);
    }

    /// Adds a deviation, unless it is known already.
    pub(super) fn note_deviation(&mut self, deviation: ProtocolDeviation) {
        if let Err(at) = self.deviations.binary_search(&deviation) {
            self.deviations.insert(at, deviation);
        }
    }

    /// Returns the UID in its heartbeats before the present one; where two devices alternate, that
    /// of the other device.
    pub fn uid_before(&self) -> Option<Uid> {
        self.uid_before
    }

    /// Returns true if the device is not lost.
    pub fn is_present(&self) -> bool {
        self.presence != Presence::Lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn period_of_a_board_is_kept_beside_another_one() {
        let mut stats = HeartbeatStats::default();
        let (one, other) = (Some(Uid([1; 6])), Some(Uid([2; 6])));
        let mut beat = |millis: u64, uid| {
            let at = Instant::from_micros(millis * 1000);
            stats.record_heartbeat(at, uid, Duration::from_secs(1), Some(0))
        };
        for second in 1..60 {
            beat(second * 1000, one);
            if (20..40).contains(&second) {
                let gap = beat(second * 1000 + 500, other);
                assert_eq!(gap, Some(Duration::from_millis(500)), "of whatever board");
            }
        }
        // It left while the other one stays.
        for second in 60..90 {
            beat(second * 1000 + 500, other);
        }
        assert_eq!(stats.period(), Some(Duration::from_secs(1)));
        assert_eq!(stats.jitter(), Some(Duration::ZERO));
        assert_eq!((stats.missed, stats.count), (0, 109));
        assert!(stats.period_of_all() < Some(Duration::from_millis(999)));
    }
}
