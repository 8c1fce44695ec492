//! Presence of devices, by the age of their heartbeats and other frames (protocol §4.6).
//!
//! With heartbeats: online while they arrive, stale after 2.5 periods of the device, lost after 5;
//! before any period is known, a single heartbeat does not show when the next one is due, so the
//! device is not stale between. Silent instead while other frames arrive after the next heartbeat
//! was due, asleep instead of lost if the last mode was IDLE. Without heartbeats, or with a single
//! one that claimed the address: by enumeration rounds: lost after 3 rounds without a response,
//! unless frames arrive between them; or, without rounds, stale 30 s after the last frame. Time in
//! which the bus was down does not count.

use super::device::{Device, Presence, STALE_PERIODS};
use super::periods::HeartbeatPeriods;
use crate::time::{Duration, Instant};
use crate::wire::node::Mode;
use std::collections::VecDeque;

/// Enumeration rounds without a response after which a device without heartbeats is lost.
const LOST_AFTER_ROUNDS: u32 = 3;
/// Age of the last frame at which a device without heartbeats is stale, if there are no rounds.
const STALE_WITHOUT_ROUNDS: Duration = Duration::from_secs(30);

/// Returns true if a device's only heartbeat was the claim of its address and it sent other frames
/// long after it: it does not send heartbeats.
pub(super) fn is_claim_only(device: &Device, period: Duration) -> bool {
    let claim = device.heartbeat.last.filter(|_| device.heartbeat.count == 1);
    claim.is_some_and(|claim| device.last_seen.since(claim) >= period * 5)
}

/// Age of the last heartbeat, in periods, at which the next one is overdue.
const NEXT_HEARTBEAT_DUE_PERIODS: f64 = 1.5;

/// Maximum number of outages stored; older ones do not affect any device still present.
const MAX_OUTAGES: usize = 8;

/// Tolerance of the reported begin and end of an outage.
const OUTAGE_TOLERANCE: Duration = Duration::from_millis(200);

/// Times in which the bus was down.
#[derive(Debug, Default)]
pub(super) struct Outages {
    since: Option<Instant>,
    past: VecDeque<(Instant, Instant)>,
}

impl Outages {
    /// Starts an outage, unless one is going on.
    pub fn begin(&mut self, now: Instant) {
        self.since.get_or_insert(now);
    }

    /// Ends the outage. Returns true if there was one.
    pub fn end(&mut self, now: Instant) -> bool {
        let Some(since) = self.since.take() else { return false };
        if self.past.len() == MAX_OUTAGES {
            self.past.pop_front();
        }
        self.past.push_back((since, now));
        true
    }

    /// Returns true during an outage.
    pub fn is_on(&self) -> bool {
        self.since.is_some()
    }

    /// Returns true if a frame received at that time shows that the outage is over, whatever the
    /// adapter reports.
    pub fn is_contradicted_by(&self, received: Instant) -> bool {
        self.since.is_some_and(|since| received > since)
    }

    /// Returns how long the bus was down since `then`.
    pub fn since(&self, then: Instant) -> Duration {
        self.past.iter().map(|(from, until)| until.since(then.max(*from))).sum()
    }

    /// Returns how many heartbeats, due between `last` and `now` every `period`, fell into outages.
    pub fn heartbeats_missed_in_outage(
        &self,
        last: Instant,
        now: Instant,
        period: Duration,
    ) -> u64 {
        let steps = |until: Instant| until.since(last).as_nanos() / period.as_nanos().max(1);
        let most = steps(now + period / 2).saturating_sub(1);
        let mut counted = 0;
        let missed = self.past.iter().map(|(from, until)| {
            // Two close outages do not count a heartbeat twice.
            let before = steps(*from - OUTAGE_TOLERANCE).max(counted);
            counted = steps(*until + OUTAGE_TOLERANCE).min(most).max(before);
            counted - before
        });
        u64::try_from(missed.sum::<u128>()).unwrap_or(u64::MAX)
    }
}

/// Input of the presence decision.
#[derive(Clone, Copy, Debug)]
pub(super) struct PresenceInput<'a> {
    pub periods: &'a HeartbeatPeriods,
    /// True if enumeration rounds are sent.
    pub rounds: bool,
    pub outages: &'a Outages,
}

impl PresenceInput<'_> {
    /// Returns `at` plus the time since then in which the bus was down.
    fn shifted_by_outages(&self, at: Instant) -> Instant {
        at + self.outages.since(at)
    }

    /// Returns the presence at `now`, and when it changes if no frame is received; `None`: it does
    /// not.
    pub fn evaluate(&self, device: &Device, now: Instant) -> (Presence, Option<Instant>) {
        let period = self.periods.of_presence(device.address);
        let lost_after = period * 5;
        let is_known = device.heartbeat.count > 1 || self.periods.is_reliable();
        let stale_after = if is_known { period.mul_f64(STALE_PERIODS) } else { lost_after };
        let Some(last_heartbeat) = device.heartbeat.last.filter(|_| !is_claim_only(device, period))
        else {
            return self.judge_without_heartbeat(device, period, now);
        };
        let last_heartbeat = self.shifted_by_outages(last_heartbeat);
        let last_seen = self.shifted_by_outages(device.last_seen);
        let (stale_at, lost_at) = (last_heartbeat + stale_after, last_heartbeat + lost_after);
        if now < stale_at {
            return (Presence::Online, Some(stale_at));
        }
        // Frames received before the next heartbeat was due do not show that it is missing.
        let is_received = last_seen > last_heartbeat + period.mul_f64(NEXT_HEARTBEAT_DUE_PERIODS);
        if is_received && now < last_seen + lost_after {
            return (Presence::Silent, Some(last_seen + lost_after));
        }
        if now < lost_at {
            return (Presence::Stale, Some(lost_at));
        }
        let asleep = device.mode == Some(Mode::Idle);
        (if asleep { Presence::Asleep } else { Presence::Lost }, None)
    }

    /// Returns the presence of a device without heartbeats.
    fn judge_without_heartbeat(
        &self,
        device: &Device,
        period: Duration,
        now: Instant,
    ) -> (Presence, Option<Instant>) {
        if self.rounds {
            if device.rounds_missed < LOST_AFTER_ROUNDS {
                return (Presence::Online, None);
            }
            // The rounds at start follow each other quickly.
            let lost_at = self.shifted_by_outages(device.last_seen) + period * 5;
            return if now < lost_at {
                (Presence::Online, Some(lost_at))
            } else {
                (Presence::Lost, None)
            };
        }
        let stale_at = self.shifted_by_outages(device.last_seen) + STALE_WITHOUT_ROUNDS;
        if now < stale_at { (Presence::Online, Some(stale_at)) } else { (Presence::Stale, None) }
    }
}
