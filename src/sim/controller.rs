//! CAN controller of a station: transmit queue by priority, error counters, and the states of fault
//! confinement (ISO 11898-1).
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
/// TEC or REC from which a controller is in error-warning.
const WARNING_FROM: u16 = 96;
/// Increment of TEC for a failed transmission.
const TEC_STEP: u16 = 8;

/// State of a controller in fault confinement (ISO 11898-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ControllerState {
    /// Both counters are below 96.
    ErrorActive,
    /// A counter is 96 or above; otherwise as error-active.
    ErrorWarning,
    /// A counter is above 127: no active error flags, and a pause before each repetition.
    ErrorPassive,
    /// TEC was above 255: neither sends nor acknowledges until a restart.
    BusOff,
    /// The link is down.
    Down,
}

impl ControllerState {
    /// Returns the name in JSON output: `error-active`, `error-warning`, `error-passive`,
    /// `bus-off`, `down`.
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

/// A queued frame.
#[derive(Clone, Copy)]
struct Waiting {
    key: u32,
    order: u64,
    one_shot: bool,
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

/// Orders by transmit priority; the greatest is sent first: lowest identifier, then oldest.
impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> Ordering {
        (other.key, other.order).cmp(&(self.key, self.order))
    }
}

/// Controller of one station.
pub(super) struct Controller {
    queue: BinaryHeap<Waiting>,
    /// Frame on the wire, which won arbitration.
    on_wire: Option<Waiting>,
    capacity: usize,
    order: u64,
    /// Frames rejected because the queue was full.
    pub dropped: u64,
    /// Switched on and connected.
    pub attached: bool,
    /// Listen-only.
    pub listen_only: bool,
    /// Bit rate in bit/s. It receives frames with this rate, and destroys others.
    pub bitrate: u32,
    /// End of suspend transmission, in nanoseconds.
    pub suspended_until: u64,
    tec: u16,
    rec: u16,
    bus_off: bool,
}

impl Controller {
    /// Creates a controller that is off, with a queue of `capacity` frames.
    pub fn new(capacity: usize, bitrate: u32) -> Self {
        Self {
            queue: BinaryHeap::new(),
            on_wire: None,
            capacity,
            order: 0,
            dropped: 0,
            attached: false,
            listen_only: false,
            bitrate,
            suspended_until: 0,
            tec: 0,
            rec: 0,
            bus_off: false,
        }
    }

    /// Resets to the state after power-on: queue empty, counters 0.
    pub fn reset(&mut self) {
        self.queue.clear();
        self.on_wire = None;
        self.suspended_until = 0;
        self.tec = 0;
        self.rec = 0;
        self.bus_off = false;
    }

    /// Queues a frame; `one_shot`: without repetition after an error. Returns false if it is
    /// rejected.
    pub fn enqueue(&mut self, frame: Frame, once: bool) -> bool {
        if self.queue.len() >= self.capacity || self.bus_off || !self.attached {
            self.dropped += 1;
            return false;
        }
        self.order += 1;
        self.queue.push(Waiting {
            key: arbitration_field(&frame),
            order: self.order,
            one_shot: once,
            frame,
        });
        true
    }

    /// Returns true if it takes part in arbitration once suspend transmission is over.
    pub fn wants_bus(&self) -> bool {
        self.is_active() && !self.queue.is_empty()
    }

    /// Returns the number of queued frames, including the one on the wire.
    pub fn queued(&self) -> usize {
        self.queue.len() + usize::from(self.on_wire.is_some())
    }

    /// Returns the arbitration field of its next frame; `None` if the queue is empty.
    pub fn key(&self) -> Option<u32> {
        self.queue.peek().map(|waiting| waiting.key)
    }

    /// Moves its next frame to the wire.
    pub fn begin(&mut self) {
        self.on_wire = self.queue.pop();
    }

    /// Returns its frame on the wire.
    pub fn on_wire(&self) -> Option<&Frame> {
        self.on_wire.as_ref().map(|waiting| &waiting.frame)
    }

    /// Returns true if it sends, acknowledges and counts errors.
    pub fn is_active(&self) -> bool {
        self.attached && !self.listen_only && !self.bus_off
    }

    /// Returns true if it receives frames.
    pub fn is_receiving(&self) -> bool {
        self.attached && !self.bus_off
    }

    /// Returns true if it acknowledges frames of other stations with this bit rate.
    pub fn acknowledges(&self, bitrate: u32) -> bool {
        self.is_active() && self.bitrate == bitrate
    }

    /// Returns true if its error flags destroy frames.
    pub fn is_destructive(&self) -> bool {
        self.is_active() && !self.is_passive()
    }

    /// Returns true if a counter is above 127.
    pub fn is_passive(&self) -> bool {
        self.tec > PASSIVE_ABOVE || self.rec > PASSIVE_ABOVE
    }

    /// Returns TEC and REC.
    pub fn counters(&self) -> (u16, u16) {
        (self.tec, self.rec)
    }

    /// Returns its state.
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

    /// Counts an acknowledged transmission.
    pub fn count_sent(&mut self) {
        self.on_wire = None;
        self.tec = self.tec.saturating_sub(1);
    }

    /// Takes its next frame from the queue if it is one that is not repeated: it lost arbitration.
    pub fn give_up_once(&mut self) -> Option<Frame> {
        let is_once = self.queue.peek().is_some_and(|waiting| waiting.one_shot);
        if is_once { self.queue.pop().map(|waiting| waiting.frame) } else { None }
    }

    /// Counts a transmit error and queues the frame again. Returns the frame if it is dropped.
    ///
    /// An error-passive transmitter does not count a missing acknowledgement, so a station alone on
    /// a bus never becomes bus-off (ISO 11898-1).
    pub fn count_send_error(&mut self, acknowledge: bool) -> Option<Frame> {
        if !(acknowledge && self.is_passive()) {
            self.tec += TEC_STEP;
        }
        let broken = self.on_wire.take()?;
        if self.tec > BUS_OFF_ABOVE {
            self.bus_off = true;
            self.queue.clear();
        } else if !broken.one_shot {
            self.queue.push(broken);
            return None;
        }
        Some(broken.frame)
    }

    /// Queues the frame on the wire again, after an error-passive transmitter stopped sending it.
    pub fn restore(&mut self) {
        self.queue.extend(self.on_wire.take());
    }

    /// Counts a frame received without errors.
    pub fn count_received(&mut self) {
        // ISO 11898-1: a counter above 127 is set to a value from 119 to 127; here 126.
        self.rec = self.rec.saturating_sub(1).min(PASSIVE_ABOVE - 1);
    }

    /// Counts a receive error.
    pub fn count_receive_error(&mut self) {
        self.rec = (self.rec + 1).min(BUS_OFF_ABOVE);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn controller() -> Controller {
        let mut controller = Controller::new(3, 125_000);
        controller.attached = true;
        controller
    }

    #[test]
    fn queue_sends_lowest_identifier_first_then_oldest() {
        let mut controller = controller();
        for (id, byte) in [(9, 0), (5, 1), (5, 2), (1, 3)] {
            controller.enqueue(Frame::classic(id, &[byte]), false);
        }
        assert_eq!(controller.dropped, 1, "the fourth exceeds the capacity");
        let mut sent = Vec::new();
        while controller.wants_bus() {
            controller.begin();
            sent.extend_from_slice(controller.on_wire().unwrap().data());
            controller.count_sent();
        }
        assert_eq!(sent, [1, 2, 0]);
    }

    #[test]
    fn repeated_errors_cause_bus_off_until_reset() {
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
    fn missing_ack_stops_counting_at_error_passive() {
        let mut controller = controller();
        controller.enqueue(Frame::classic(1, &[]), false);
        for _ in 0..1000 {
            controller.begin();
            assert!(controller.count_send_error(true).is_none());
        }
        assert_eq!(controller.counters(), (128, 0));
    }
}
