//! The simulated bus: arbitration, acknowledgement, collisions and error flags, timed to the bit
//! (ISO 11898-1).
//!
//! Deterministic and driven by the caller: [`SimBus::next_event`] returns when to call
//! [`SimBus::step`]. Times in nanoseconds since the start. Not simulated: propagation delay,
//! overload frames, bit errors seen by a single station. Does not know devices or the meaning of
//! frames.

use super::controller::Controller;
use crate::frame::Frame;
use crate::frame::bits::{FrameBits, INTERMISSION, bit_nanos, first_difference};

/// Length of superposed error flags in bits, 6 to 12 on a real bus.
const ERROR_FLAGS: u32 = 8;
/// Length of the error delimiter, in bits.
const ERROR_DELIMITER: u32 = 8;
/// Suspend transmission of an error-passive transmitter, in bits.
const SUSPENSION: u32 = 8;
/// Bits until a station at another bit rate destroys a frame.
const UNREADABLE_AFTER: u32 = 12;

/// Index of a station, from 0 in the order of attachment.
pub(super) type StationIndex = u16;

/// Cause of a bus error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BusErrorCause {
    /// Several stations sent different data with the same identifier.
    Collision,
    /// No station acknowledged.
    NoAck,
    /// A disturbance, or a station at another bit rate.
    Disturbance,
}

/// Result of a step.
pub(super) enum BusOutcome {
    /// All stations received a frame of [`SimBus::senders`].
    Frame(Frame),
    /// A frame of [`SimBus::senders`] was destroyed.
    BusError(BusErrorCause),
    /// A frame of error-passive [`SimBus::senders`] was not acknowledged: valid to listen-only
    /// stations, since a passive error flag changes nothing on the wire.
    Unacknowledged(Frame),
    /// Error-passive stations ([`SimBus::passive_error_stations`]) had an error that no other
    /// station noticed.
    PassiveError,
}

/// Totals since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Statistics {
    /// Frames received by all stations.
    pub frames: u64,
    /// Frames that were destroyed.
    pub errors: u64,
    /// Time in which the bus was not idle, in nanoseconds, including intermission.
    pub busy_nanos: u64,
    /// Bits of the received frames, including stuff bits and intermission.
    pub bits: u64,
}

#[derive(Clone, Copy)]
enum BusPhase {
    Idle,
    /// First bit of a frame, in which stations may join arbitration.
    Start {
        at: u64,
    },
    /// A frame that will be received.
    Frame {
        frame: Frame,
        ends: u64,
        free: u64,
    },
    /// A frame that will be destroyed.
    BusError {
        error: BusErrorCause,
        ends: u64,
        free: u64,
    },
    /// A frame of error-passive senders that nobody acknowledges.
    Unacknowledged {
        frame: Frame,
        ends: u64,
        free: u64,
    },
    /// Intermission.
    Intermission {
        free: u64,
    },
}

pub(super) struct SimBus {
    bitrate: u32,
    data_bitrate: u32,
    /// Share of frames destroyed by a disturbance, 0 to 1.
    pub frame_error_probability: f64,
    controllers: Vec<Controller>,
    /// Stations that may have frames to send, each once.
    waiting: Vec<StationIndex>,
    /// Stations with a receive error counter above 0, each once.
    with_receive_errors: Vec<StationIndex>,
    /// Stations at another bit rate than [`SimBus::bitrate`].
    off_rate: Vec<StationIndex>,
    /// Bit rate of the frame on the wire: that of its sender.
    frame_bitrate: u32,
    senders: Vec<StationIndex>,
    passive_error_stations: Vec<StationIndex>,
    abandoned: Vec<(StationIndex, Frame)>,
    phase: BusPhase,
    rng: fastrand::Rng,
    statistics: Statistics,
}

impl SimBus {
    pub fn new(bitrate: u32, data_bitrate: u32, error_rate: f64, rng: fastrand::Rng) -> Self {
        Self {
            bitrate,
            data_bitrate,
            frame_error_probability: error_rate,
            controllers: Vec::new(),
            waiting: Vec::new(),
            with_receive_errors: Vec::new(),
            off_rate: Vec::new(),
            frame_bitrate: bitrate,
            senders: Vec::new(),
            passive_error_stations: Vec::new(),
            abandoned: Vec::new(),
            phase: BusPhase::Idle,
            rng,
            statistics: Statistics::default(),
        }
    }

    pub fn bitrate(&self) -> u32 {
        self.bitrate
    }

    /// Returns the bit rate of the last frame, in bit/s.
    pub fn frame_bitrate(&self) -> u32 {
        self.frame_bitrate
    }

    pub fn data_bitrate(&self) -> u32 {
        self.data_bitrate
    }

    pub fn statistics(&self) -> Statistics {
        self.statistics
    }

    /// Adds a station that is off, with a transmit queue of `capacity` frames.
    pub fn add(&mut self, capacity: usize) -> StationIndex {
        self.controllers.push(Controller::new(capacity, self.bitrate));
        (self.controllers.len() - 1) as StationIndex
    }

    pub fn controller(&self, station: StationIndex) -> &Controller {
        &self.controllers[usize::from(station)]
    }

    /// Returns a controller to change its settings; send frames with [`SimBus::transmit`].
    pub fn controller_mut(&mut self, station: StationIndex) -> &mut Controller {
        &mut self.controllers[usize::from(station)]
    }

    /// Connects or disconnects a station and resets it. A frame that only it was sending is
    /// destroyed.
    pub fn set_attached(&mut self, station: StationIndex, attached: bool) {
        let controller = self.controller_mut(station);
        controller.reset();
        controller.attached = attached;
        self.withdraw(station);
    }

    /// Sets a station's bit rate, in bit/s.
    pub fn set_bitrate(&mut self, station: StationIndex, bitrate: u32) {
        self.controller_mut(station).bitrate = bitrate;
        self.off_rate.retain(|&other| other != station);
        if bitrate != self.bitrate {
            self.off_rate.push(station);
        }
    }

    /// Removes a station's frames, including the one on the wire.
    fn withdraw(&mut self, station: StationIndex) {
        let was_sending = self.senders.contains(&station);
        self.senders.retain(|&sender| sender != station);
        self.abandoned.retain(|(owner, _)| *owner != station);
        if was_sending
            && self.senders.is_empty()
            && let BusPhase::Frame { ends, free, .. }
            | BusPhase::BusError { ends, free, .. }
            | BusPhase::Unacknowledged { ends, free, .. } = self.phase
        {
            self.phase = BusPhase::BusError { error: BusErrorCause::Disturbance, ends, free };
        }
    }

    /// Queues a frame; `one_shot`: without repetition after an error. Returns false if it is
    /// rejected: queue full, or the station off.
    pub fn transmit(&mut self, now: u64, station: StationIndex, frame: Frame, once: bool) -> bool {
        if !self.controller_mut(station).enqueue(frame, once) {
            return false;
        }
        self.wake(now, station);
        true
    }

    /// Lets a station with queued frames take part in the next arbitration.
    pub fn wake(&mut self, now: u64, station: StationIndex) {
        if !self.controller(station).wants_bus() {
            return;
        }
        if !self.waiting.contains(&station) {
            self.waiting.push(station);
        }
        let at = now.max(self.controller(station).suspended_until);
        match self.phase {
            BusPhase::Idle => self.phase = BusPhase::Start { at },
            BusPhase::Start { at: planned } if at < planned => self.phase = BusPhase::Start { at },
            _ => {}
        }
    }

    /// Returns when to call [`SimBus::step`] next; `None` while the bus is idle.
    pub fn next_event(&self) -> Option<u64> {
        match self.phase {
            BusPhase::Idle => None,
            BusPhase::Start { at } => Some(at + bit_nanos(1, self.bitrate)),
            BusPhase::Frame { ends, .. }
            | BusPhase::BusError { ends, .. }
            | BusPhase::Unacknowledged { ends, .. } => Some(ends),
            BusPhase::Intermission { free } => Some(free),
        }
    }

    /// Processes the event that is due at [`SimBus::next_event`].
    pub fn step(&mut self) -> Option<BusOutcome> {
        match self.phase {
            BusPhase::Idle => None,
            BusPhase::Start { at } => self.arbitrate(at),
            BusPhase::Frame { frame, ends, free } => {
                self.phase = BusPhase::Intermission { free };
                self.statistics.frames += 1;
                self.finish_frame(free);
                Some(BusOutcome::Frame(frame.with_time(super::instant(ends))))
            }
            BusPhase::BusError { error, free, .. } => {
                self.phase = BusPhase::Intermission { free };
                self.statistics.errors += 1;
                self.finish_broken(error, free);
                Some(BusOutcome::BusError(error))
            }
            BusPhase::Unacknowledged { frame, ends, free } => {
                self.phase = BusPhase::Intermission { free };
                self.statistics.errors += 1;
                self.finish_broken(BusErrorCause::NoAck, free);
                Some(BusOutcome::Unacknowledged(frame.with_time(super::instant(ends))))
            }
            BusPhase::Intermission { free } => {
                self.rest_over(free);
                None
            }
        }
    }

    /// Returns the senders of the last frame; several if equal frames merged.
    pub fn senders(&self) -> &[StationIndex] {
        &self.senders
    }

    /// Returns the stations of the last [`BusOutcome::PassiveError`].
    pub fn passive_error_stations(&self) -> &[StationIndex] {
        &self.passive_error_stations
    }

    /// Returns the frames that were dropped, with their stations.
    pub fn take_abandoned(&mut self) -> Vec<(StationIndex, Frame)> {
        std::mem::take(&mut self.abandoned)
    }

    /// Starts the next arbitration after intermission, or leaves the bus idle.
    fn rest_over(&mut self, free: u64) {
        self.senders.clear();
        let controllers = &self.controllers;
        self.waiting.retain(|&station| controllers[usize::from(station)].wants_bus());
        let first = self
            .waiting
            .iter()
            .map(|&station| free.max(controllers[usize::from(station)].suspended_until))
            .min();
        self.phase = first.map_or(BusPhase::Idle, |at| BusPhase::Start { at });
    }

    fn arbitrate(&mut self, start: u64) -> Option<BusOutcome> {
        self.senders.clear();
        self.passive_error_stations.clear();
        let mut lowest = u32::MAX;
        for &station in &self.waiting {
            let controller = &self.controllers[usize::from(station)];
            if !controller.wants_bus() || controller.suspended_until > start {
                continue;
            }
            let Some(key) = controller.key() else { continue };
            if key < lowest {
                lowest = key;
                self.senders.clear();
            }
            if key == lowest {
                self.senders.push(station);
            }
        }
        if self.senders.is_empty() {
            // The waiting stations were disconnected in the meantime.
            self.rest_over(start);
            return None;
        }
        self.drop_losers(start);
        self.frame_bitrate = self.controller(self.senders[0]).bitrate;
        for &sender in &self.senders {
            self.controllers[usize::from(sender)].begin();
        }
        let broken_at = self.resolve_collision();
        let frame = *self.controller(self.senders[0]).on_wire()?;
        let bits = FrameBits::of(&frame);
        let broken = if let Some(bits) = broken_at {
            Some((BusErrorCause::Collision, self.early_nanos(&frame, bits)))
        } else if self.is_destroyed_by_rate() {
            Some((BusErrorCause::Disturbance, bit_nanos(UNREADABLE_AFTER, self.frame_bitrate)))
        } else if self.frame_error_probability > 0.0
            && self.rng.f64() < self.frame_error_probability
        {
            let at = self.rng.u32(1..bits.until_ack().total());
            Some((BusErrorCause::Disturbance, self.early_nanos(&frame, at)))
        } else if !self.is_acknowledged() {
            let sent = bits.until_ack().nanos(self.frame_bitrate, self.data_bitrate);
            Some((BusErrorCause::NoAck, sent))
        } else {
            None
        };
        self.phase = if let Some((error, sent)) = broken {
            let ends = start + sent + bit_nanos(ERROR_FLAGS, self.frame_bitrate);
            let free = ends + bit_nanos(ERROR_DELIMITER + INTERMISSION, self.frame_bitrate);
            self.statistics.busy_nanos += free - start;
            let is_passive =
                self.senders.iter().all(|&sender| self.controller(sender).is_passive());
            if error == BusErrorCause::NoAck && is_passive {
                BusPhase::Unacknowledged { frame, ends, free }
            } else {
                BusPhase::BusError { error, ends, free }
            }
        } else {
            let free = start + bits.nanos(self.frame_bitrate, self.data_bitrate);
            let ends = free - bit_nanos(INTERMISSION, self.frame_bitrate);
            self.statistics.busy_nanos += free - start;
            self.statistics.bits += u64::from(bits.total());
            BusPhase::Frame { frame, ends, free }
        };
        (!self.passive_error_stations.is_empty()).then_some(BusOutcome::PassiveError)
    }

    /// Drops the frames that are not repeated and lost arbitration.
    fn drop_losers(&mut self, start: u64) {
        for &station in &self.waiting {
            let controller = &mut self.controllers[usize::from(station)];
            let is_in = controller.wants_bus() && controller.suspended_until <= start;
            if is_in
                && !self.senders.contains(&station)
                && let Some(frame) = controller.give_up_once()
            {
                self.abandoned.push((station, frame));
            }
        }
    }

    /// Resolves a collision: several senders of one identifier with different data. A station that
    /// sends recessive and reads dominant has a bit error: if error-active, it destroys the frame
    /// at the returned bit; if error-passive, it stops and the dominant frame continues.
    fn resolve_collision(&mut self) -> Option<u32> {
        let mut destroyed: Option<u32> = None;
        let mut at = 1;
        while at < self.senders.len() {
            let (first, second) = (self.senders[0], self.senders[at]);
            let (Some(one), Some(two)) =
                (self.controller(first).on_wire(), self.controller(second).on_wire())
            else {
                break;
            };
            let Some(parting) = first_difference(one, two) else {
                at += 1;
                continue;
            };
            let notices = if parting.first_is_recessive { first } else { second };
            if self.controller(notices).is_passive() {
                let dropped = self.controllers[usize::from(notices)].count_send_error(false);
                self.abandoned.extend(dropped.map(|frame| (notices, frame)));
                self.passive_error_stations.push(notices);
                if parting.first_is_recessive {
                    self.senders.swap_remove(0);
                    at = 1;
                } else {
                    self.senders.swap_remove(at);
                }
            } else {
                let bits = destroyed.map_or(parting.bits, |bits| bits.min(parting.bits));
                destroyed = Some(bits);
                at += 1;
            }
        }
        self.senders.sort_unstable();
        destroyed
    }

    /// Returns the time of the first `bits` bits of a frame, in nanoseconds.
    fn early_nanos(&self, frame: &Frame, bits: u32) -> u64 {
        let all = FrameBits::of(frame);
        let tail = all.nominal - all.until_ack().nominal + 2;
        let slow = if all.data == 0 { bits } else { bits.min(all.nominal - tail) };
        FrameBits { nominal: slow, data: bits - slow }.nanos(self.frame_bitrate, self.data_bitrate)
    }

    /// Returns true if a station at another bit rate destroys the frame.
    fn is_destroyed_by_rate(&self) -> bool {
        let is_other = |controller: &Controller| controller.bitrate != self.frame_bitrate;
        let destroys = |it: &Controller| it.is_destructive() && is_other(it);
        if self.senders.iter().any(|&sender| is_other(self.controller(sender))) {
            true
        } else if self.frame_bitrate == self.bitrate {
            self.off_rate.iter().any(|&station| destroys(self.controller(station)))
        } else {
            self.controllers.iter().any(destroys)
        }
    }

    fn is_acknowledged(&self) -> bool {
        self.controllers.iter().enumerate().any(|(station, controller)| {
            controller.acknowledges(self.frame_bitrate)
                && !self.senders.contains(&(station as StationIndex))
        })
    }

    fn finish_frame(&mut self, free: u64) {
        for &sender in &self.senders {
            let controller = &mut self.controllers[usize::from(sender)];
            controller.count_sent();
            if controller.is_passive() {
                controller.suspended_until = free + bit_nanos(SUSPENSION, self.bitrate);
            }
        }
        let (controllers, senders) = (&mut self.controllers, &self.senders);
        let bitrate = self.frame_bitrate;
        self.with_receive_errors.retain(|&station| {
            let controller = &mut controllers[usize::from(station)];
            if !senders.contains(&station) && controller.acknowledges(bitrate) {
                controller.count_received();
            }
            controller.counters().1 > 0
        });
    }

    fn finish_broken(&mut self, error: BusErrorCause, free: u64) {
        let suspended_until = free + bit_nanos(SUSPENSION, self.bitrate);
        self.with_receive_errors.clear();
        for (station, controller) in self.controllers.iter_mut().enumerate() {
            let station = station as StationIndex;
            if !controller.is_active() {
                controller.restore();
                continue;
            }
            if self.senders.contains(&station) {
                let dropped = controller.count_send_error(error == BusErrorCause::NoAck);
                self.abandoned.extend(dropped.map(|frame| (station, frame)));
                if controller.is_passive() {
                    controller.suspended_until = suspended_until;
                }
            } else if error != BusErrorCause::NoAck {
                controller.count_receive_error();
            }
            if controller.counters().1 > 0 {
                self.with_receive_errors.push(station);
            }
        }
    }
}
