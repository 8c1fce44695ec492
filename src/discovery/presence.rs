//! Presence of devices, by the age of their heartbeats and other frames (protocol §4.6).
//!
//! With heartbeats: online while they arrive, stale after 2.5 periods of the device, lost after 5;
//! before any period is known, a single heartbeat does not show when the next one is due, so the
//! device is not stale between. Silent instead while other frames arrive after the next heartbeat
//! was due, asleep instead of lost if the last mode was IDLE. Without heartbeats, or with a single
//! one that claimed the address: by enumeration rounds: lost after 3 rounds without a response,
//! unless frames arrive between them; or, without rounds, stale 30 s after the last frame. Time in
//! which the bus was down does not count.

use super::conflicts::ConflictDetector;
use super::device::{Device, Presence, STALE_PERIODS};
use super::device_tracker::DeviceTracker;
use super::outages::Outages;
use super::{DeviceId, EventKind};
use crate::time::{Duration, Instant};
use crate::wire::node::Mode;

/// Age of the last heartbeat, in periods, at which a device is lost. Protocol §4.6.
const LOST_PERIODS: u32 = 5;
/// Enumeration rounds without a response after which a device without heartbeats is lost. Protocol
/// §4.6.
const LOST_AFTER_ROUNDS: u32 = 3;
/// Age of the last frame at which a device without heartbeats is stale, if there are no rounds.
/// Protocol §4.6.
const STALE_WITHOUT_ROUNDS: Duration = Duration::from_secs(30);

/// Returns true if a device's only heartbeat was the claim of its address and it sent other frames
/// long after it: it does not send heartbeats.
pub(super) fn is_claim_only(device: &Device, period: Duration) -> bool {
    let claim = device.heartbeat.last.filter(|_| device.heartbeat.count == 1);
    claim.is_some_and(|claim| device.last_seen.since(claim) >= period * 5)
}

/// Age of the last heartbeat, in periods, at which the next one is overdue. Chosen: halfway between
/// two.
const NEXT_HEARTBEAT_DUE_PERIODS: f64 = 1.5;

/// Input of the presence decision.
#[derive(Clone, Copy, Debug)]
pub(super) struct PresenceInput<'a> {
    pub conflicts: &'a ConflictDetector,
    /// True if enumeration rounds are sent.
    pub rounds: bool,
    pub outages: &'a Outages,
}

impl PresenceInput<'_> {
    /// Returns the presence at `now`, and when it changes if no frame is received; `None`: it does
    /// not.
    pub fn evaluate(&self, device: &Device, now: Instant) -> (Presence, Option<Instant>) {
        let period = self.conflicts.presence_period(device.address);
        let lost_after = period * LOST_PERIODS;
        let is_known =
            device.heartbeat.count > 1 || self.conflicts.periods().is_reliable(device.address);
        let stale_after = if is_known { period.mul_f64(STALE_PERIODS) } else { lost_after };
        let Some(last_heartbeat) = device.heartbeat.last.filter(|_| !is_claim_only(device, period))
        else {
            return self.judge_without_heartbeat(device, period, now);
        };
        let last_heartbeat = self.outages.shifted(last_heartbeat);
        let last_seen = self.outages.shifted(device.last_seen);
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
            let lost_at = self.outages.shifted(device.last_seen) + period * 5;
            return if now < lost_at {
                (Presence::Online, Some(lost_at))
            } else {
                (Presence::Lost, None)
            };
        }
        let stale_at = self.outages.shifted(device.last_seen) + STALE_WITHOUT_ROUNDS;
        if now < stale_at { (Presence::Online, Some(stale_at)) } else { (Presence::Stale, None) }
    }
}

impl DeviceTracker {
    fn presence_input(&self) -> PresenceInput<'_> {
        PresenceInput {
            outages: &self.outages,
            conflicts: &self.conflicts,
            rounds: (self.recorded_nodes.has_inspector()
                || !self.config.listen_only && self.config.send_requests)
                && !self.config.round_period.is_zero(),
        }
    }

    /// Updates the presence of every row and emits the changes.
    pub fn update_presence(&mut self) {
        if self.outages.is_on() {
            return;
        }
        // A device that turns out to have moved has two rows, which are merged.
        for row in self.device_table.rows() {
            self.update_device_presence(row);
        }
    }

    pub fn update_device_presence(&mut self, row: DeviceId) {
        let input = self.presence_input();
        let Some(device) = self.device_table.get(row) else { return };
        let is_current = self.device_table.is_current(device);
        let presence = if is_current {
            input.evaluate(device, self.now).0
        } else {
            self.replaced_row_presence(device)
        };
        let was = device.presence;
        // Heartbeats of another node neither return this device nor make it silent.
        let was_other_node = device.last_heartbeat_was_other_node && is_current;
        let was_gone = matches!(was, Presence::Lost | Presence::Asleep);
        let may_be_other_node =
            presence == Presence::Online || presence == Presence::Stale && was_gone;
        let Some(device) = self.device_table.get_mut(row) else { return };
        if presence == Presence::Lost {
            device.last_heartbeat_was_other_node = false;
        }
        if presence == was || (may_be_other_node && was_other_node) {
            return;
        }
        let address = device.address;
        device.presence = presence;
        device.presence_since = self.now;
        // Its mode is unknown while no heartbeats arrive.
        device.is_resolving &= presence == Presence::Online;
        if presence == Presence::Online {
            // It may have been offline for a firmware update.
            if is_current {
                if self.errors.is_suspect(address) {
                    device.services_query.schedule(self.now);
                } else {
                    device.services_query.restart(self.now);
                }
                self.wake_at(self.now);
            }
            self.emit(row, EventKind::Returned { was });
        } else {
            self.emit(row, EventKind::Presence(presence));
        }
        if presence == Presence::Lost {
            if is_current {
                self.conflicts.forget(self.now, address);
                self.errors.forget(address);
            }
            self.find_move_of_lost(row);
        }
    }

    /// Returns the presence of a row that was replaced at its address: present while it still
    /// responds, or sends heartbeats of its own.
    fn replaced_row_presence(&self, device: &Device) -> Presence {
        let is_gone = matches!(device.presence, Presence::Lost | Presence::Asleep);
        let period = self.sender_period(device.address);
        if is_gone
            && let Some(heard) = self.sender_names.last_of(device.id, device.address)
            && self.now.since(self.outages.shifted(heard)) < period.mul_f64(STALE_PERIODS)
        {
            return Presence::Online;
        }
        match (self.replaced_row_leaves(device), device.mode) {
            (Some(leaves), Some(Mode::Idle)) if leaves <= self.now => Presence::Asleep,
            (Some(leaves), _) if leaves <= self.now => Presence::Lost,
            _ => device.presence,
        }
    }

    /// Returns when a replaced row leaves without another response; `None` if it has left, or if that
    /// is not known.
    fn replaced_row_leaves(&self, device: &Device) -> Option<Instant> {
        if matches!(device.presence, Presence::Lost | Presence::Asleep) {
            return None;
        }
        let period = self.sender_period(device.address);
        let is_open = self.conflicts.finding_tracker().is_open_at(device.address);
        let after_response = period * if is_open { 8 } else { 4 };
        let responded = device.name_query.responded_at;
        if let Some(last) = self.sender_names.last_of(device.id, device.address) {
            let last = self.outages.shifted(last);
            let leaves = responded.map(|at| self.outages.shifted(at) + after_response);
            return Some((last + period * LOST_PERIODS).max(leaves.unwrap_or(last)));
        }
        let own = self.claims.last_of_row(device.id, device.address);
        // While a conflict is confirmed, its heartbeats are among those of the others.
        if own.is_none() && self.conflicts.finding_tracker().has_confirmed_conflict(device.address)
        {
            return None;
        }
        let heard = own.max(responded).max(device.replaced_at);
        Some(self.outages.shifted(heard.unwrap_or(device.last_seen)) + after_response)
    }

    /// Returns when the presence of a row changes if no frame is received.
    pub fn presence_timeout(&self) -> Option<Instant> {
        if self.outages.is_on() {
            return None;
        }
        let input = self.presence_input();
        let devices = self.device_table.devices().iter();
        let due = devices.filter_map(|device| {
            if self.device_table.is_current(device) {
                input.evaluate(device, self.now).1
            } else {
                self.replaced_row_leaves(device)
            }
        });
        due.min()
    }
}
