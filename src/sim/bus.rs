//! The bus: arbitration, acknowledge, collisions and error frames between controllers, timed to
//! the bit.
//!
//! Deterministic and driven from outside: [`Bus::next_event`] says when, [`Bus::step`] does it.
//! Times are nanoseconds since the start. Knows nothing of devices or of what frames mean; of
//! the wire it leaves out propagation delay, overload frames and the difference between the bit
//! errors of one station and of all.

use super::controller::Controller;
use crate::frame::Frame;
use crate::frame::bits::{FrameBits, INTERMISSION, bit_nanos, divergence};

/// Superposed error flags: 6 to 12 dominant bits.
const ERROR_FLAGS: u32 = 8;
/// The error delimiter.
const ERROR_DELIMITER: u32 = 8;
/// What an error-passive transmitter waits before it sends again.
const SUSPENSION: u32 = 8;
/// Bits until a station at another rate spoils a frame.
const UNREADABLE_AFTER: u32 = 12;

/// A station on the bus, counted from 0 in the order of attachment.
pub(super) type StationIndex = u16;

/// Why a frame broke.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FrameFault {
    /// Two stations sent different bytes after the same identifier.
    Collision,
    /// Nobody acknowledged.
    NoAcknowledge,
    /// A disturbance, or a station at another bit rate.
    Disturbance,
}

/// What a step of the bus brought about.
pub(super) enum BusOutcome {
    /// A frame arrived at everybody; [`Bus::senders`] sent it.
    Frame(Frame),
    /// A frame of [`Bus::senders`] broke.
    Broken(FrameFault),
    /// A passive station ([`Bus::losers`]) saw its own frame spoilt, nobody else did.
    Spoilt,
}

/// Totals since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Statistics {
    /// Frames that arrived.
    pub frames: u64,
    /// Frames that were destroyed.
    pub errors: u64,
    /// Nanoseconds in which the bus was not idle, intermission included.
    pub busy_nanos: u64,
    /// Bits of the frames that arrived, stuff bits and intermission included.
    pub bits: u64,
}

#[derive(Clone, Copy)]
enum BusPhase {
    Idle,
    /// The first bit of a frame, in which everybody who wants may join.
    Start {
        at: u64,
    },
    /// A frame that will arrive.
    Frame {
        frame: Frame,
        ends: u64,
        free: u64,
    },
    /// A frame that will break.
    Broken {
        error: FrameFault,
        ends: u64,
        free: u64,
    },
    /// Intermission.
    Rest {
        free: u64,
    },
}

pub(super) struct SimBus {
    bitrate: u32,
    data_bitrate: u32,
    /// The share of frames that a disturbance destroys, 0–1.
    pub error_rate: f64,
    controllers: Vec<Controller>,
    /// Those that may want the bus, each once.
    waiting: Vec<StationIndex>,
    /// Those with a receive error counter above 0, each once.
    troubled: Vec<StationIndex>,
    /// Those at another bit rate.
    strangers: Vec<StationIndex>,
    senders: Vec<StationIndex>,
    losers: Vec<StationIndex>,
    abandoned: Vec<StationIndex>,
    phase: BusPhase,
    rng: fastrand::Rng,
    statistics: Statistics,
}

impl SimBus {
    pub fn new(bitrate: u32, data_bitrate: u32, error_rate: f64, rng: fastrand::Rng) -> Self {
        Self {
            bitrate,
            data_bitrate,
            error_rate,
            controllers: Vec::new(),
            waiting: Vec::new(),
            troubled: Vec::new(),
            strangers: Vec::new(),
            senders: Vec::new(),
            losers: Vec::new(),
            abandoned: Vec::new(),
            phase: BusPhase::Idle,
            rng,
            statistics: Statistics::default(),
        }
    }

    pub fn bitrate(&self) -> u32 {
        self.bitrate
    }

    pub fn data_bitrate(&self) -> u32 {
        self.data_bitrate
    }

    pub fn statistics(&self) -> Statistics {
        self.statistics
    }

    /// Adds a station that is off, with room for `capacity` waiting frames.
    pub fn add(&mut self, capacity: usize) -> StationIndex {
        self.controllers.push(Controller::new(capacity));
        (self.controllers.len() - 1) as StationIndex
    }

    pub fn controller(&self, station: StationIndex) -> &Controller {
        &self.controllers[usize::from(station)]
    }

    /// For switches; frames go through [`Bus::transmit`].
    pub fn controller_mut(&mut self, station: StationIndex) -> &mut Controller {
        &mut self.controllers[usize::from(station)]
    }

    /// Connects or cuts off a station; either way it begins afresh. A frame that only it was
    /// sending breaks.
    pub fn set_attached(&mut self, station: StationIndex, attached: bool) {
        let controller = self.controller_mut(station);
        controller.reset();
        controller.attached = attached;
        self.withdraw(station);
    }

    /// Sets a station to the bus's bit rate or to another.
    pub fn set_wrong_rate(&mut self, station: StationIndex, wrong: bool) {
        self.controller_mut(station).wrong_rate = wrong;
        self.strangers.retain(|&other| other != station);
        if wrong {
            self.strangers.push(station);
        }
    }

    /// Takes a station's frames back, the one on the wire included.
    fn withdraw(&mut self, station: StationIndex) {
        let was_sending = self.senders.contains(&station);
        self.senders.retain(|&sender| sender != station);
        if was_sending
            && self.senders.is_empty()
            && let BusPhase::Frame { ends, free, .. } | BusPhase::Broken { ends, free, .. } =
                self.phase
        {
            self.phase = BusPhase::Broken { error: FrameFault::Disturbance, ends, free };
        }
    }

    /// Queues a frame; `once`: it is not repeated after an error. False when it was refused:
    /// no room, or the station is off.
    pub fn transmit(&mut self, now: u64, station: StationIndex, frame: Frame, once: bool) -> bool {
        if !self.controller_mut(station).enqueue(frame, once) {
            return false;
        }
        self.wake(now, station);
        true
    }

    /// Lets a station that has frames waiting take part in arbitration again.
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

    /// When [`Bus::step`] is to be called next.
    pub fn next_event(&self) -> Option<u64> {
        match self.phase {
            BusPhase::Idle => None,
            BusPhase::Start { at } => Some(at + bit_nanos(1, self.bitrate)),
            BusPhase::Frame { ends, .. } | BusPhase::Broken { ends, .. } => Some(ends),
            BusPhase::Rest { free } => Some(free),
        }
    }

    /// Does what is due at [`Bus::next_event`].
    pub fn step(&mut self) -> Option<BusOutcome> {
        match self.phase {
            BusPhase::Idle => None,
            BusPhase::Start { at } => self.arbitrate(at),
            BusPhase::Frame { frame, ends, free } => {
                self.phase = BusPhase::Rest { free };
                self.statistics.frames += 1;
                self.finish_frame(free);
                Some(BusOutcome::Frame(frame.with_time(super::instant(ends))))
            }
            BusPhase::Broken { error, free, .. } => {
                self.phase = BusPhase::Rest { free };
                self.statistics.errors += 1;
                self.finish_broken(error, free);
                Some(BusOutcome::Broken(error))
            }
            BusPhase::Rest { free } => {
                self.rest_over(free);
                None
            }
        }
    }

    /// Who sent the frame of the last outcome; several where equal frames merged.
    pub fn senders(&self) -> &[StationIndex] {
        &self.senders
    }

    /// Who noticed alone that its frame was spoilt: [`Outcome::Spoilt`].
    pub fn losers(&self) -> &[StationIndex] {
        &self.losers
    }

    /// Whose frame was given up with the last outcome.
    pub fn take_abandoned(&mut self) -> Vec<StationIndex> {
        std::mem::take(&mut self.abandoned)
    }

    /// When the bus may be used again: everybody idle or the end of intermission.
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
        self.losers.clear();
        self.abandoned.clear();
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
            // Whoever wanted the bus was cut off meanwhile.
            self.rest_over(start);
            return None;
        }
        for &sender in &self.senders {
            self.controllers[usize::from(sender)].begin();
        }
        let broken_at = self.resolve_collision();
        let frame = *self.controller(self.senders[0]).on_wire()?;
        let bits = FrameBits::of(&frame);
        let broken = if let Some(bits) = broken_at {
            Some((FrameFault::Collision, self.early_nanos(&frame, bits)))
        } else if self.is_spoilt_by_rate() {
            Some((FrameFault::Disturbance, bit_nanos(UNREADABLE_AFTER, self.bitrate)))
        } else if self.error_rate > 0.0 && self.rng.f64() < self.error_rate {
            let at = self.rng.u32(1..bits.until_ack().total());
            Some((FrameFault::Disturbance, self.early_nanos(&frame, at)))
        } else if !self.is_acknowledged() {
            let sent = bits.until_ack().nanos(self.bitrate, self.data_bitrate);
            Some((FrameFault::NoAcknowledge, sent))
        } else {
            None
        };
        self.phase = if let Some((error, sent)) = broken {
            let ends = start + sent + bit_nanos(ERROR_FLAGS, self.bitrate);
            let free = ends + bit_nanos(ERROR_DELIMITER + INTERMISSION, self.bitrate);
            self.statistics.busy_nanos += free - start;
            BusPhase::Broken { error, ends, free }
        } else {
            let free = start + bits.nanos(self.bitrate, self.data_bitrate);
            let ends = free - bit_nanos(INTERMISSION, self.bitrate);
            self.statistics.busy_nanos += free - start;
            self.statistics.bits += u64::from(bits.total());
            BusPhase::Frame { frame, ends, free }
        };
        (!self.losers.is_empty()).then_some(BusOutcome::Spoilt)
    }

    /// Lets the senders of one identifier find out what they differ in. Whoever sends recessive
    /// and reads dominant notices: error-active, it destroys the frame, at the returned bit;
    /// error-passive, it drops out and the dominant frame goes on.
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
            let Some(parting) = divergence(one, two) else {
                at += 1;
                continue;
            };
            let notices = if parting.first_is_recessive { first } else { second };
            if self.controller(notices).is_passive() {
                if self.controllers[usize::from(notices)].count_send_error(false) {
                    self.abandoned.push(notices);
                }
                self.losers.push(notices);
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

    /// How long the first `bits` bits of a frame take.
    fn early_nanos(&self, frame: &Frame, bits: u32) -> u64 {
        let all = FrameBits::of(frame);
        let tail = all.nominal - all.until_ack().nominal + 2;
        let slow = if all.data == 0 { bits } else { bits.min(all.nominal - tail) };
        FrameBits { nominal: slow, data: bits - slow }.nanos(self.bitrate, self.data_bitrate)
    }

    fn is_spoilt_by_rate(&self) -> bool {
        self.senders.iter().any(|&sender| self.controller(sender).wrong_rate)
            || self.strangers.iter().any(|&other| self.controller(other).is_destructive())
    }

    fn is_acknowledged(&self) -> bool {
        self.controllers.iter().enumerate().any(|(station, controller)| {
            controller.acknowledges() && !self.senders.contains(&(station as StationIndex))
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
        self.troubled.retain(|&station| {
            let controller = &mut controllers[usize::from(station)];
            if !senders.contains(&station) && controller.is_active() && !controller.wrong_rate {
                controller.count_received();
            }
            controller.counters().1 > 0
        });
    }

    fn finish_broken(&mut self, error: FrameFault, free: u64) {
        let suspended_until = free + bit_nanos(SUSPENSION, self.bitrate);
        self.troubled.clear();
        for (station, controller) in self.controllers.iter_mut().enumerate() {
            let station = station as StationIndex;
            if !controller.is_active() {
                controller.restore();
                continue;
            }
            if self.senders.contains(&station) {
                if controller.count_send_error(error == FrameFault::NoAcknowledge) {
                    self.abandoned.push(station);
                }
                if controller.is_passive() {
                    controller.suspended_until = suspended_until;
                }
            } else if error != FrameFault::NoAcknowledge {
                controller.count_receive_error();
            }
            if controller.counters().1 > 0 {
                self.troubled.push(station);
            }
        }
    }
}
