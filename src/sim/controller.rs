//! A station's CAN controller: its transmit queue in order of priority, its error counters and
//! the states that follow from them (ISO 11898-1, fault confinement).
//!
//! Does not know the bus, time or other stations.

use crate::frame::Frame;
use crate::frame::bits::arbitration_field;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// TEC or REC above which a controller is error-passive.
const PASSIVE_ABOVE: u16 = 127;
/// TEC above which a controller is bus-off.
const BUS_OFF_ABOVE: u16 = 255;
/// TEC or REC from which a controller warns.
const WARNING_FROM: u16 = 96;
/// What a failed transmission adds to TEC.
const FAILURE: u16 = 8;

/// Where a controller stands in fault confinement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ControllerState {
    /// Takes part fully.
    ErrorActive,
    /// Takes part fully; a counter has reached 96.
    ErrorWarning,
    /// A counter is above 127: destroys nobody's frames and waits before it repeats its own.
    ErrorPassive,
    /// TEC was above 255: sends and acknowledges nothing until restarted.
    BusOff,
    /// Its link is down.
    Down,
}

impl ControllerState {
    /// As scripts read it: `error-active`, `error-warning`, `error-passive`, `bus-off`, `down`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ErrorActive => "error-active",
            Self::ErrorWarning => "error-warning",
            Self::ErrorPassive => "error-passive",
            Self::BusOff => "bus-off",
            Self::Down => "down",
        }
    }
}

/// A frame that waits for the bus.
#[derive(Clone, Copy)]
struct Waiting {
    key: u32,
    order: u64,
    once: bool,
    frame: Frame,
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Waiting {}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// The greatest is the one to be sent first: lowest identifier, then first come.
impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> Ordering {
        (other.key, other.order).cmp(&(self.key, self.order))
    }
}

/// One station's controller.
pub(super) struct Controller {
    queue: BinaryHeap<Waiting>,
    /// The frame that won arbitration and is on the wire.
    on_wire: Option<Waiting>,
    capacity: usize,
    order: u64,
    /// Frames refused because the queue was full.
    pub dropped: u64,
    /// Switched on and connected.
    pub attached: bool,
    /// Receives only: sends, acknowledges and destroys nothing.
    pub silent: bool,
    /// Set to another bit rate than the bus: understands nothing and spoils everything.
    pub wrong_rate: bool,
    /// A passive transmitter may not start before this, in nanoseconds.
    pub suspended_until: u64,
    tec: u16,
    rec: u16,
    bus_off: bool,
}

impl Controller {
    /// A controller that is off, with room for `capacity` waiting frames.
    pub fn new(capacity: usize) -> Self {
        Self {
            queue: BinaryHeap::new(),
            on_wire: None,
            capacity,
            order: 0,
            dropped: 0,
            attached: false,
            silent: false,
            wrong_rate: false,
            suspended_until: 0,
            tec: 0,
            rec: 0,
            bus_off: false,
        }
    }

    /// As after power-on: nothing queued, no errors.
    pub fn reset(&mut self) {
        self.queue.clear();
        self.on_wire = None;
        self.suspended_until = 0;
        self.tec = 0;
        self.rec = 0;
        self.bus_off = false;
    }

    /// Queues a frame; `once`: it is not repeated after an error. False when there is no room.
    pub fn enqueue(&mut self, frame: Frame, once: bool) -> bool {
        if self.queue.len() >= self.capacity || self.bus_off || !self.attached {
            self.dropped += 1;
            return false;
        }
        self.order += 1;
        self.queue.push(Waiting { key: arbitration_field(&frame), order: self.order, once, frame });
        true
    }

    /// Whether it takes part in arbitration as soon as its suspension is over.
    pub fn wants_bus(&self) -> bool {
        self.is_active() && !self.queue.is_empty()
    }

    /// How many frames wait, the one on the wire included.
    pub fn queued(&self) -> usize {
        self.queue.len() + usize::from(self.on_wire.is_some())
    }

    /// The arbitration field of the frame it would send now.
    pub fn key(&self) -> Option<u32> {
        self.queue.peek().map(|waiting| waiting.key)
    }

    /// Puts its first frame on the wire.
    pub fn begin(&mut self) {
        self.on_wire = self.queue.pop();
    }

    /// The frame it has on the wire.
    pub fn on_wire(&self) -> Option<&Frame> {
        self.on_wire.as_ref().map(|waiting| &waiting.frame)
    }

    /// Whether it sends, acknowledges, and counts errors.
    pub fn is_active(&self) -> bool {
        self.attached && !self.silent && !self.bus_off
    }

    /// Whether it sees what is on the bus.
    pub fn hears(&self) -> bool {
        self.attached && !self.bus_off
    }

    /// Whether it would acknowledge somebody's frame.
    pub fn acknowledges(&self) -> bool {
        self.is_active() && !self.wrong_rate
    }

    /// Whether its error flags destroy frames.
    pub fn is_destructive(&self) -> bool {
        self.is_active() && !self.is_passive()
    }

    /// Whether a counter is above 127.
    pub fn is_passive(&self) -> bool {
        self.tec > PASSIVE_ABOVE || self.rec > PASSIVE_ABOVE
    }

    /// Transmit and receive error counters.
    pub fn counters(&self) -> (u16, u16) {
        (self.tec, self.rec)
    }

    /// The state the counters put it in.
    pub fn state(&self) -> ControllerState {
        let worst = self.tec.max(self.rec);
        if !self.attached {
            ControllerState::Down
        } else if self.bus_off {
            ControllerState::BusOff
        } else if worst > PASSIVE_ABOVE {
            ControllerState::ErrorPassive
        } else if worst >= WARNING_FROM {
            ControllerState::ErrorWarning
        } else {
            ControllerState::ErrorActive
        }
    }

    /// Its frame went out and was acknowledged.
    pub fn count_sent(&mut self) {
        self.on_wire = None;
        self.tec = self.tec.saturating_sub(1);
    }

    /// Its frame was destroyed and waits again. Returns true when it is given up instead.
    ///
    /// An error-passive transmitter that misses only the acknowledge does not count it, so a
    /// station alone on a bus never becomes bus-off.
    pub fn count_send_error(&mut self, acknowledge: bool) -> bool {
        if !(acknowledge && self.is_passive()) {
            self.tec += FAILURE;
        }
        let broken = self.on_wire.take();
        if self.tec > BUS_OFF_ABOVE {
            self.bus_off = true;
            self.queue.clear();
            return true;
        }
        match broken {
            Some(waiting) if !waiting.once => {
                self.queue.push(waiting);
                false
            }
            _ => true,
        }
    }

    /// Its frame was destroyed after it had withdrawn to listening: it waits again.
    pub fn restore(&mut self) {
        self.queue.extend(self.on_wire.take());
    }

    /// It received a frame without errors.
    pub fn count_received(&mut self) {
        // From the passive range the counter falls back to 127 at most.
        self.rec = self.rec.saturating_sub(1).min(PASSIVE_ABOVE - 1);
    }

    /// It saw a frame break.
    pub fn count_receive_error(&mut self) {
        self.rec = (self.rec + 1).min(BUS_OFF_ABOVE);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn controller() -> Controller {
        let mut controller = Controller::new(3);
        controller.attached = true;
        controller
    }

    #[test]
    fn lowest_identifier_first_equal_ones_in_order() {
        let mut controller = controller();
        for (id, byte) in [(9, 0), (5, 1), (5, 2), (1, 3)] {
            controller.enqueue(Frame::classic(id, &[byte]), false);
        }
        assert_eq!(controller.dropped, 1, "the fourth finds no room");
        let mut sent = Vec::new();
        while controller.wants_bus() {
            controller.begin();
            sent.extend_from_slice(controller.on_wire().unwrap().data());
            controller.count_sent();
        }
        assert_eq!(sent, [1, 2, 0]);
    }

    #[test]
    fn counters_lead_to_bus_off_and_back_only_by_restart() {
        let mut controller = controller();
        controller.enqueue(Frame::classic(1, &[]), false);
        let states: Vec<_> = (0..32)
            .map(|_| {
                controller.begin();
                controller.count_send_error(false);
                controller.state()
            })
            .collect();
        assert_eq!(states[10], ControllerState::ErrorActive);
        assert_eq!(states[11], ControllerState::ErrorWarning);
        assert_eq!(states[15], ControllerState::ErrorPassive);
        assert_eq!(states[30], ControllerState::ErrorPassive);
        assert_eq!(states[31], ControllerState::BusOff);
        assert!(!controller.wants_bus());
        controller.reset();
        assert_eq!(controller.state(), ControllerState::ErrorActive);
    }

    #[test]
    fn a_missing_acknowledge_stops_counting_at_passive() {
        let mut controller = controller();
        controller.enqueue(Frame::classic(1, &[]), false);
        for _ in 0..1000 {
            controller.begin();
            assert!(!controller.count_send_error(true));
        }
        assert_eq!(controller.counters(), (128, 0));
    }
}
