//! Whether a device is there, judged by the age of its heartbeats and of its other frames.
//!
//! With a heartbeat: online while they come, stale after 2.5 periods, lost after 5; silent
//! instead while other frames arrive after the next one was due, asleep instead of lost when its
//! last mode was IDLE.
//! Without one, or with none but the one that claimed its address: by rounds, unless frames arrive
//! between them, or, where none are made, stale 30 s after the last frame. Time in which no frame
//! could reach us, because the bus was down, does not count.

use super::device::{Device, Presence, STALE_PERIODS};
use crate::time::{Duration, Instant};
use crate::wire::node::Mode;
use std::collections::VecDeque;

/// Rounds without an answer until a device without heartbeats is lost.
const LOST_AFTER_ROUNDS: u32 = 3;
/// Age of the last frame at which a device without heartbeats is stale, where no rounds are
/// made.
const STALE_WITHOUT_ROUNDS: Duration = Duration::from_secs(30);

/// Whether a device's only heartbeat was the one that claimed its address, and it was heard long
/// after that: it has no heartbeat.
pub(super) fn is_claim_only(device: &Device, period: Duration) -> bool {
    let claim = device.heartbeat.last.filter(|_| device.heartbeat.count == 1);
    claim.is_some_and(|claim| device.last_seen.since(claim) >= period * 5)
}

/// Age of the last heartbeat in periods at which the next one did not come.
const OVERDUE_PERIODS: f64 = 1.5;

/// How many outages are remembered: older ones matter to nobody who is still here.
const MAX_OUTAGES: usize = 8;

/// How far off the moments may be at which an outage was told.
const OUTAGE_TOLERANCE: Duration = Duration::from_millis(200);

/// When no frame could reach us.
#[derive(Debug, Default)]
pub(super) struct Outages {
    since: Option<Instant>,
    past: VecDeque<(Instant, Instant)>,
}

impl Outages {
    pub fn begin(&mut self, now: Instant) {
        self.since.get_or_insert(now);
    }

    /// Whether there was one until now.
    pub fn end(&mut self, now: Instant) -> bool {
        let Some(since) = self.since.take() else { return false };
        if self.past.len() == MAX_OUTAGES {
            self.past.pop_front();
        }
        self.past.push_back((since, now));
        true
    }

    pub fn is_on(&self) -> bool {
        self.since.is_some()
    }

    /// Whether a frame that was heard then shows that it is over, whatever its adapter says.
    pub fn is_contradicted_by(&self, heard: Instant) -> bool {
        self.since.is_some_and(|since| heard > since)
    }

    /// How much of the time since then it was impossible to hear anything.
    pub fn since(&self, then: Instant) -> Duration {
        self.past.iter().map(|(from, until)| until.since(then.max(*from))).sum()
    }

    /// How many of the moments between `last` and `now`, in steps of `period`, lie in outages.
    pub fn heartbeats_missed_in_outage(
        &self,
        last: Instant,
        now: Instant,
        period: Duration,
    ) -> u64 {
        let steps = |until: Instant| until.since(last).as_nanos() / period.as_nanos().max(1);
        let most = steps(now + period / 2).saturating_sub(1);
        let mut counted = 0;
        let swallowed = self.past.iter().map(|(from, until)| {
            // Where two are close, none is counted twice.
            let before = steps(*from - OUTAGE_TOLERANCE).max(counted);
            counted = steps(*until + OUTAGE_TOLERANCE).min(most).max(before);
            counted - before
        });
        u64::try_from(swallowed.sum::<u128>()).unwrap_or(u64::MAX)
    }
}

/// What a device's presence is judged by.
#[derive(Clone, Copy, Debug)]
pub(super) struct PresenceInput<'a> {
    /// BUS_CFG_HR_TIME.
    pub period: Duration,
    /// Whether we make rounds.
    pub rounds: bool,
    pub outages: &'a Outages,
}

impl PresenceInput<'_> {
    /// That moment, later by all the time since in which nothing could be heard.
    fn shifted_by_outages(&self, at: Instant) -> Instant {
        at + self.outages.since(at)
    }

    /// The device's presence at `now`, and when it may change if nothing more is heard.
    pub fn judge(&self, device: &Device, now: Instant) -> (Presence, Option<Instant>) {
        let stale_after = self.period.mul_f64(STALE_PERIODS);
        let lost_after = self.period * 5;
        let Some(last_beat) = device.heartbeat.last.filter(|_| !is_claim_only(device, self.period))
        else {
            return self.judge_without_heartbeat(device, now);
        };
        let last_beat = self.shifted_by_outages(last_beat);
        let last_seen = self.shifted_by_outages(device.last_seen);
        let age = now.since(last_beat);
        if age < stale_after {
            return (Presence::Online, Some(last_beat + stale_after));
        }
        // Frames that came while the heartbeat was still due say nothing of it.
        let is_heard = last_seen > last_beat + self.period.mul_f64(OVERDUE_PERIODS);
        if is_heard && now.since(last_seen) < lost_after {
            return (Presence::Silent, Some(last_seen + lost_after));
        }
        if age < lost_after {
            return (Presence::Stale, Some(last_beat + lost_after));
        }
        let asleep = device.mode == Some(Mode::Idle);
        (if asleep { Presence::Asleep } else { Presence::Lost }, None)
    }

    fn judge_without_heartbeat(
        &self,
        device: &Device,
        now: Instant,
    ) -> (Presence, Option<Instant>) {
        if self.rounds {
            if device.rounds_missed < LOST_AFTER_ROUNDS {
                return (Presence::Online, None);
            }
            // The rounds at start follow each other fast.
            let lost_at = self.shifted_by_outages(device.last_seen) + self.period * 5;
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
