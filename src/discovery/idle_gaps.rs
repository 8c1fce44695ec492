//! Idle gaps for heartbeats: requests and their responses have a higher priority than heartbeats,
//! and would keep them off a slow bus for seconds. So requests wait while heartbeats are overdue
//! that no idle bus has let through (protocol §4.4).

use super::device_tracker::DeviceTracker;
use super::observation::Observation;
use super::outbox::nominal_bits;
use super::requester::Requester;
use super::rounds::FRAME_BITS;
use super::{Config, Device, Presence};
use crate::time::{Duration, Instant};
use crate::wire::id::Address;

/// Bits without a frame after which no frame waits: three frames. A waiting frame follows after 3
/// bits (ISO 11898-1); the rest is chosen.
const IDLE_BITS: u64 = 3 * FRAME_BITS;
/// Part of the period by which a heartbeat is late when requests begin to wait: what was requested
/// before, and then the heartbeats of 127 devices, take 0.1 s each at 125 kbit/s.
const OVERDUE_PERIODS: f64 = 0.04;
/// Number of periods after which an overdue heartbeat is no longer expected. Less than a device is
/// lost after (protocol §4.6).
const MAX_WAIT_PERIODS: u32 = 4;
/// Longest time that the responses to open requests take on the bus, so that heartbeats wait for no
/// longer. Tuned with `cargo bench --bench discovery`.
const OPEN_RESPONSES_TIME: Duration = Duration::from_millis(60);
/// Bits of a services request with its response: first frame, flow control, eight frames.
const SERVICES_BITS: f64 = 11.0 * 130.0;
/// Open requests that keep the bus busy: one responds, the next one is there.
const MIN_OPEN: usize = 2;
/// Length of the windows in which the load is measured. Chosen: half a default period.
const LOAD_WINDOW: Duration = Duration::from_millis(500);

/// Tracks when the bus was idle, and its load without DES messages.
#[derive(Clone, Debug)]
pub(super) struct IdleTracker {
    last_frame_at: Instant,
    /// Last time at which no frame waited.
    idle_at: Instant,
    window_began: Instant,
    /// Bits of frames other than DES messages in the present window.
    other_bits: f64,
    /// Load by them in the last complete window, 0 to 1.
    other_load: f64,
    /// When the next heartbeat of each address is due; `Instant::ZERO` before the first one.
    next_heartbeats: [Instant; Address::COUNT],
}

impl IdleTracker {
    pub fn new() -> Self {
        Self {
            last_frame_at: Instant::ZERO,
            idle_at: Instant::ZERO,
            window_began: Instant::ZERO,
            other_bits: 0.0,
            other_load: 0.0,
            next_heartbeats: [Instant::ZERO; Address::COUNT],
        }
    }

    /// Notes a frame.
    pub fn note_frame(&mut self, observation: &Observation<'_>, config: &Config) {
        let now = observation.at;
        self.handle_timeout(now, config);
        self.last_frame_at = now;
        let passed = now.since(self.window_began);
        if passed >= LOAD_WINDOW {
            let capacity = passed.as_secs_f64() * f64::from(config.bits_per_second());
            self.other_load = (self.other_bits / capacity).min(1.0);
            (self.window_began, self.other_bits) = (now, 0.0);
        }
        let des = config.profile.des_service();
        if observation.header().is_none_or(|header| header.service != des) {
            self.other_bits += nominal_bits(observation.frame);
        }
    }

    /// Returns the time that `bits` take beside the other frames on the bus.
    pub fn duration_of_bits(&self, bits: u64, config: &Config) -> Duration {
        /// Part of the capacity that a bus always has left for them, in the calculation.
        const MIN_SPARE: f64 = 0.1;
        config.duration_of_bits(bits).mul_f64(1.0 / (1.0 - self.other_load).max(MIN_SPARE))
    }

    /// Returns how many requests may wait for their responses, at most `most`.
    pub fn max_open(&self, most: usize, config: &Config) -> usize {
        let spare = f64::from(config.bits_per_second()) * (1.0 - self.other_load);
        let open = spare * OPEN_RESPONSES_TIME.as_secs_f64() / SERVICES_BITS;
        (open as usize).clamp(MIN_OPEN, most)
    }

    /// Notes that no frame was received until `now`.
    pub fn handle_timeout(&mut self, now: Instant, config: &Config) {
        if now >= self.becomes_idle_at(config) {
            self.idle_at = now;
        }
    }

    /// Notes a heartbeat. One that waited for the bus does not change the time of the next one.
    pub fn note_heartbeat(&mut self, now: Instant, address: Address, period: Duration) {
        let due = &mut self.next_heartbeats[address.index()];
        let has_waited = *due > self.idle_at && now > *due && now < *due + period;
        *due = if has_waited { *due + period } else { now + period };
    }

    /// Returns true if a heartbeat of `address` is overdue and may wait for the bus.
    fn waits(&self, now: Instant, address: Address, period: Duration) -> bool {
        let due = self.next_heartbeats[address.index()];
        due > self.idle_at
            && now >= due + period.mul_f64(OVERDUE_PERIODS)
            && now < due + period * MAX_WAIT_PERIODS
    }

    /// Returns when the bus is idle if no more frames are received.
    pub fn becomes_idle_at(&self, config: &Config) -> Instant {
        self.last_frame_at + config.duration_of_bits(IDLE_BITS)
    }
}

impl Requester {
    /// Returns until when requests wait because heartbeats wait for an idle bus, unless these are
    /// received before; `None` if none waits.
    pub(super) fn heartbeats_wait_until(&self, tracker: &DeviceTracker) -> Option<Instant> {
        let idle_at = self.idle.becomes_idle_at(&tracker.config);
        let waits = |device: &Device| {
            !matches!(device.presence, Presence::Lost | Presence::Asleep)
                && self.idle.waits(tracker.now, device.address, tracker.period_of(device.address))
        };
        let is_busy = idle_at > tracker.now;
        let mut devices = tracker.device_table.devices().iter();
        (is_busy && devices.any(waits)).then_some(idle_at)
    }
}
