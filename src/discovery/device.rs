//! What is known of a device: the row that the user sees.
//!
//! A device is the pair (name, address) on a bus; a node whose name is not known yet is a row
//! too. Changed only by the [`super::Engine`].

use crate::frame::BusIndex;
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::des::{Request, ResponseFault};
use crate::wire::framing::Framing;
use crate::wire::id::Address;
use crate::wire::isotp::TransferFault;
use crate::wire::node::{Mode, Uid};
use std::collections::VecDeque;
use std::fmt;

/// A device's identity in this session: stays with the row while others come and go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DeviceId {
    /// The bus it is on.
    pub bus: BusIndex,
    /// Its number on that bus, in the order of appearance; never given twice.
    pub number: u32,
}

/// Whether a device is there, judged by the age of what was heard of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Presence {
    /// Its heartbeats come.
    Online,
    /// The last heartbeat is older than 2.5 periods.
    Stale,
    /// Heartbeats are missing, but other frames of it arrive.
    Silent,
    /// Heartbeats are missing and its last known mode was IDLE.
    Asleep,
    /// Nothing for 5 periods.
    Lost,
}

impl Presence {
    /// The word for it, as in JSON.
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

/// One service of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceService {
    /// Its index in the answer.
    pub index: u8,
    /// Its name.
    pub name: Name,
    /// Its version.
    pub version: Name,
    /// The strings after the version.
    pub extra: Vec<Name>,
}

/// How regular a device's heartbeats are.
#[derive(Clone, Debug, Default)]
pub struct HeartbeatStats {
    /// How many were heard.
    pub count: u64,
    /// When the last one was heard.
    pub last: Option<Instant>,
    /// Heartbeats that should have come and did not.
    pub missed: u64,
    intervals: u64,
    mean_us: f64,
    variance_us: f64,
    /// The last heartbeat before one that was out of phase.
    in_phase: Option<Instant>,
}

/// Who was not heard for so many periods may not be there.
pub(super) const STALE_PERIODS: f64 = 2.5;
/// A gap of this many periods between heartbeats may be a reboot.
pub(super) const SILENT_PERIODS: f64 = 1.4;

impl HeartbeatStats {
    /// The mean interval between heartbeats, without gaps; `None` before there is one.
    pub fn period(&self) -> Option<Duration> {
        (self.intervals > 0).then(|| Duration::from_micros(self.mean_us as u64))
    }

    /// The standard deviation of the interval; `None` before there are two.
    pub fn jitter(&self) -> Option<Duration> {
        (self.intervals > 1).then(|| Duration::from_micros(self.variance_us.max(0.0).sqrt() as u64))
    }

    /// Counts a heartbeat; `period` is the one expected, `unheard` how many were due since the one
    /// before while none could be heard. Returns the gap since the one before.
    pub(super) fn record_heartbeat(
        &mut self,
        now: Instant,
        period: Duration,
        missed_in_outage: u64,
    ) -> Option<Duration> {
        self.count += 1;
        let gap = self.last.replace(now).map(|last| now.since(last));
        if let Some(gap) = gap {
            let ratio = gap.as_secs_f64() / period.as_secs_f64();
            if ratio > 1.5 {
                self.missed += ((ratio - 0.5) as u64).saturating_sub(missed_in_outage);
            } else if ratio > 0.3 {
                self.intervals += 1;
                let weight = 1.0 / self.intervals.min(64) as f64;
                let micros = gap.as_micros() as f64;
                let off = micros - self.mean_us;
                self.mean_us += weight * off;
                self.variance_us = (1.0 - weight) * (self.variance_us + weight * off * off);
            }
        }
        gap
    }

    /// Another sender's phase is no shift of this one's.
    pub(super) fn forget_phase(&mut self) {
        self.in_phase = None;
    }

    /// Whether the heartbeat that came at `now` shows that its sender started anew: the one before
    /// was no whole number of periods after those before it, and this one keeps to the new phase.
    /// One that the bus held up is followed by one in the old phase.
    pub(super) fn is_phase_shifted(
        &mut self,
        now: Instant,
        before: Option<Instant>,
        period: Duration,
        jitter: Option<Duration>,
    ) -> bool {
        // Who has no rhythm yet has no phase.
        let (Some(before), Some(jitter)) = (before, jitter) else { return false };
        let noise = jitter.as_secs_f64() / period.as_secs_f64();
        let off = |since: Instant| {
            let periods = now.since(since).as_secs_f64() / period.as_secs_f64();
            let known = (SILENT_PERIODS..=30.0).contains(&periods);
            known && (periods - periods.round()).abs() > (4.0 * noise).max(0.15)
        };
        let follows = now.since(before) < period.mul_f64(SILENT_PERIODS);
        let shifted = follows && self.in_phase.take().is_some_and(off);
        if !follows {
            self.in_phase = off(before).then_some(before);
        }
        shifted
    }
}

/// How far a question to a device has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum QueryState {
    /// Not asked (listen-only, or not its turn yet).
    #[default]
    NotAsked,
    /// Asked, waiting.
    Asked,
    /// Its answer is arriving in several frames.
    Receiving,
    /// Answered.
    Answered,
    /// Asked as often as is sensible, without an answer. Asked again from time to time.
    Unanswered,
}

/// One question (for the name, or for the services) and its history.
#[derive(Clone, Copy, Debug, Default)]
pub struct Query {
    /// How far it has come.
    pub state: QueryState,
    /// How often it was asked since the last answer.
    pub attempts: u32,
    /// When it was asked last.
    pub asked_at: Option<Instant>,
    /// When it was answered last.
    pub answered_at: Option<Instant>,
    /// From question to the answer's end, of the last answer.
    pub took: Option<Duration>,
    /// What was wrong with the last answer.
    pub fault: Option<QueryFault>,
    /// It was asked as often as is sensible since the last answer; still so while it is asked again.
    pub in_vain: bool,
    /// When it is to be asked (again), where it is.
    pub(super) due: Option<Instant>,
    /// Until when an answer, or its next frame, is awaited.
    pub(super) deadline: Option<Instant>,
}

impl Query {
    /// Whether an answer is awaited.
    pub fn is_waiting(&self) -> bool {
        matches!(self.state, QueryState::Asked | QueryState::Receiving)
    }

    /// Asks anew at `at`, with all attempts before it.
    pub(super) fn schedule(&mut self, at: Instant) {
        if !self.is_waiting() {
            self.attempts = 0;
            self.due = Some(self.due.map_or(at, |due| due.min(at)));
        }
    }

    /// The same where something has changed since it was asked: the attempt under way is the
    /// first, not the last before it is given up.
    pub(super) fn restart(&mut self, at: Instant) {
        self.attempts = self.attempts.min(1);
        self.schedule(at);
    }

    /// Gives up until `again`.
    pub(super) fn give_up(&mut self, again: Instant) {
        self.state = QueryState::Unanswered;
        self.in_vain = true;
        self.due = Some(again);
    }

    /// Notes an answer.
    pub(super) fn answered(&mut self, now: Instant, fault: Option<QueryFault>) {
        if let (true, Some(asked_at)) = (self.is_waiting(), self.asked_at) {
            self.took = Some(now.since(asked_at));
        }
        self.state = QueryState::Answered;
        self.answered_at = Some(now);
        self.in_vain = false;
        self.attempts = 0;
        self.fault = fault;
        self.due = None;
        self.deadline = None;
    }
}

/// Why an answer could not be used, or only in part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum QueryFault {
    /// Its message is malformed.
    #[error("{0}")]
    Answer(#[from] ResponseFault),
    /// Its transfer broke off.
    #[error("{0}")]
    Transfer(#[from] TransferFault),
    /// The device answered with the error flag.
    #[error("the device reports an error")]
    Refused,
}

/// A deviation from the platform that is understood all the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Quirk {
    /// Answers carry the request's DST instead of the asker's address.
    RspDstEcho,
    /// Sends identifiers that are none of the nine types.
    NonConforming,
    /// Answers in both framings.
    BothFramings,
    /// Heartbeats are shorter than the profile's layout.
    ShortHeartbeat,
    /// The mode in its heartbeat contradicts the U bit.
    ModeContradictsU,
}

impl Quirk {
    /// The word for it, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Quirk::RspDstEcho => "rsp-dst-echo",
            Quirk::NonConforming => "non-conforming",
            Quirk::BothFramings => "both-framings",
            Quirk::ShortHeartbeat => "short-heartbeat",
            Quirk::ModeContradictsU => "mode-contradicts-u",
        }
    }

    /// What it means, for people.
    pub const fn describe(self) -> &'static str {
        match self {
            Quirk::RspDstEcho => "responses carry the request's DST, not the requester's address",
            Quirk::NonConforming => "sends identifiers with an unknown message type",
            Quirk::BothFramings => "responds in both framings",
            Quirk::ShortHeartbeat => "heartbeats shorter than the profile's layout",
            Quirk::ModeContradictsU => "the heartbeat's mode contradicts the U bit",
        }
    }
}

/// Modes that are remembered per device.
const MAX_MODES: usize = 16;

/// A mode a device was in, and since when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModeChange {
    /// When it was first seen in it.
    pub time: Instant,
    /// The mode.
    pub mode: Mode,
}

/// A row: what is known of a device.
#[derive(Clone, Debug)]
pub struct Device {
    /// Its identity in this session.
    pub id: DeviceId,
    /// Its main address: where its name answer came from.
    pub address: Address,
    /// Its name; `None` while it is known by its frames alone.
    pub name: Option<Name>,
    /// Whether it is there.
    pub presence: Presence,
    /// Since when its presence is what it is.
    pub presence_since: Instant,
    /// Whether it is in a working mode, by the U bit of its last frame.
    pub working: bool,
    /// Its mode, where its heartbeats say it.
    pub mode: Option<Mode>,
    /// The error code in its heartbeats.
    pub error: Option<u8>,
    /// Its DEV_CFG_UID, where its heartbeats say it.
    pub uid: Option<Uid>,
    /// How it lays its answers into frames.
    pub framing: Option<Framing>,
    /// Its services; `None` while they are not known.
    pub services: Option<Vec<DeviceService>>,
    /// The services before they changed last, where they did.
    pub previous_services: Option<Vec<DeviceService>>,
    /// Its heartbeats.
    pub heartbeat: HeartbeatStats,
    /// The question for its name.
    pub name_query: Query,
    /// The question for its services.
    pub services_query: Query,
    /// Deviations noted against it.
    pub quirks: Vec<Quirk>,
    /// The last modes, oldest first, at most 16.
    pub mode_history: VecDeque<ModeChange>,
    /// When it was first heard.
    pub first_seen: Instant,
    /// When it was last heard.
    pub last_seen: Instant,
    /// How many frames of it were heard.
    pub frames: u64,
    /// How often it rebooted.
    pub reboots: u32,
    /// When it rebooted last.
    pub rebooted_at: Option<Instant>,
    /// When another row began to speak from its address.
    pub(super) replaced_at: Option<Instant>,
    /// The UID its heartbeats said before the present one.
    pub(super) uid_before: Option<Uid>,
    /// Whether the last heartbeat from its address was one of a node that is about to take another
    /// mode.
    pub(super) is_resolving: bool,
    /// Whether the last heartbeat from its address was another one's, who has no row yet.
    pub(super) last_heartbeat_was_other_node: bool,
    /// The address it moved from last.
    pub moved_from: Option<Address>,
    /// Whether it is a debug device: at address 0, or one of our kind.
    pub is_debug: bool,
    /// How many rounds in a row it did not answer.
    pub rounds_missed: u32,
}

impl Device {
    /// A node of which one frame was heard.
    pub(super) fn appear(id: DeviceId, now: Instant, address: Address, working: bool) -> Self {
        Self {
            id,
            address,
            name: None,
            presence: Presence::Online,
            presence_since: now,
            working,
            mode: None,
            error: None,
            uid: None,
            framing: None,
            services: None,
            previous_services: None,
            heartbeat: HeartbeatStats::default(),
            name_query: Query::default(),
            services_query: Query::default(),
            quirks: Vec::new(),
            mode_history: VecDeque::new(),
            first_seen: now,
            last_seen: now,
            frames: 0,
            reboots: 0,
            rebooted_at: None,
            replaced_at: None,
            uid_before: None,
            is_resolving: false,
            last_heartbeat_was_other_node: false,
            moved_from: None,
            is_debug: address == Address::DEBUG,
            rounds_missed: 0,
        }
    }

    /// Whether it is the same device as an entry with that name (bytes equal).
    pub fn is_named(&self, name: &[u8]) -> bool {
        self.name.as_ref().is_some_and(|own| own.as_bytes() == name)
    }

    /// The question of that kind.
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

    /// What was heard from its address lately, under another row, is this one's.
    pub(super) fn adopt_live_state(&mut self, live: &Self) {
        self.heartbeat = live.heartbeat.clone();
        self.uid = live.uid;
        self.mode = live.mode;
        self.error = live.error;
        self.working = live.working;
        self.is_resolving = live.is_resolving;
        self.last_seen = live.last_seen;
    }

    /// Takes note, before anything else of it is, that something is heard of it now: what it was
    /// asked in vain while it was silent for far longer than it ever was before, it is asked once
    /// more. It may not have heard us, nor we it. True where something is asked.
    pub(super) fn retry_after_silence(&mut self, now: Instant, period: Duration) -> bool {
        // Or is about to be, once a round is over.
        let waits_for_round = |it: &Query| it.state == QueryState::Asked && it.deadline.is_none();
        let in_vain = |it: &Query| it.state == QueryState::Unanswered || waits_for_round(it);
        if !in_vain(&self.name_query) && !in_vain(&self.services_query) {
            return false;
        }
        let silence = now.since(self.last_seen);
        let usual = self.last_seen.since(self.first_seen).mul_f64(1.0 / self.frames.max(1) as f64);
        if silence < period.mul_f64(STALE_PERIODS) || silence < usual * 4 {
            return false;
        }
        let mut asks = false;
        for query in [&mut self.name_query, &mut self.services_query] {
            if in_vain(query) && query.asked_at >= Some(self.last_seen) {
                if query.is_waiting() {
                    query.state = QueryState::NotAsked;
                }
                query.restart(now);
                asks = true;
            }
        }
        asks
    }

    /// Adds to the modes it was in; the oldest go.
    pub(super) fn remember_mode(&mut self, change: ModeChange) {
        if self.mode_history.len() == MAX_MODES {
            self.mode_history.pop_front();
        }
        self.mode_history.push_back(change);
    }

    /// Notes a deviation once.
    pub(super) fn note(&mut self, quirk: Quirk) {
        if let Err(at) = self.quirks.binary_search(&quirk) {
            self.quirks.insert(at, quirk);
        }
    }

    /// The UID its heartbeats said before the present one: where two take turns, the other's.
    pub fn uid_before(&self) -> Option<Uid> {
        self.uid_before
    }

    /// Whether it is on the bus as far as can be told.
    pub fn is_present(&self) -> bool {
        self.presence != Presence::Lost
    }
}
