//! Whether a device is there, judged by the age of its heartbeats and of its other frames.
//!
//! With a heartbeat: online while they come, stale after 2.5 periods, lost after 5; silent
//! instead while other frames arrive, asleep instead of lost when its last mode was IDLE.
//! Without one, or with none but the one that claimed its address: by rounds, unless frames arrive
//! between them, or, where none are made, stale 30 s after the last frame.

use super::device::{Device, Presence};
use crate::time::{Duration, Instant};
use crate::wire::node::Mode;

/// Rounds without an answer until a device without heartbeats is lost.
const LOST_AFTER_ROUNDS: u32 = 3;
/// Age of the last frame at which a device without heartbeats is stale, where no rounds are
/// made.
const STALE_WITHOUT_ROUNDS: Duration = Duration::from_secs(30);

/// Whether a device's only heartbeat was the one that claimed its address, and it was heard long
/// after that: it has no heartbeat.
pub(super) fn beats_no_more(device: &Device, period: Duration) -> bool {
    let claim = device.heartbeat.last.filter(|_| device.heartbeat.count == 1);
    claim.is_some_and(|claim| device.last_seen.since(claim) >= period * 5)
}

/// What a device's presence is judged by.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measure {
    /// BUS_CFG_HR_TIME.
    pub period: Duration,
    /// Whether we make rounds.
    pub rounds: bool,
}

impl Measure {
    /// The device's presence at `now`, and when it may change if nothing more is heard.
    pub fn judge(&self, device: &Device, now: Instant) -> (Presence, Option<Instant>) {
        let stale_after = self.period.mul_f64(2.5);
        let lost_after = self.period * 5;
        let Some(last_beat) = device.heartbeat.last.filter(|_| !beats_no_more(device, self.period))
        else {
            return self.judge_without_heartbeat(device, now);
        };
        let age = now.since(last_beat);
        if age < stale_after {
            return (Presence::Online, Some(last_beat + stale_after));
        }
        if device.last_seen > last_beat && now.since(device.last_seen) < lost_after {
            return (Presence::Silent, Some(device.last_seen + lost_after));
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
            let lost_at = device.last_seen + self.period * 5;
            return if now < lost_at {
                (Presence::Online, Some(lost_at))
            } else {
                (Presence::Lost, None)
            };
        }
        let stale_at = device.last_seen + STALE_WITHOUT_ROUNDS;
        if now < stale_at { (Presence::Online, Some(stale_at)) } else { (Presence::Stale, None) }
    }
}
