//! Load of a bus by frames of descan, and how much it is.
//!
//! Input: frames and time. Output: frames to send. Does not know what is tested meanwhile.

use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header, Service};

/// Part of the capacity that all frames together shall take.
const LOAD: f64 = 0.80;
/// Part of the capacity from which the bus was loaded.
const LEAST: f64 = 0.70;
/// Time between two looks at the load.
const STEP: Duration = Duration::from_millis(2);
/// Most frames that are sent at once: 8 ms at 125 kbit/s.
const MAX_BURST: u32 = 8;

/// Frames that load the bus.
#[derive(Clone, Debug)]
pub(super) struct LoadGenerator {
    own: Address,
    began: Instant,
    next: Instant,
    bits_per_second: f64,
    /// Bits on the bus since the begin, and those of frames that are still to be on it.
    bits: f64,
    queued: f64,
    burst: u32,
    counter: u32,
}

impl LoadGenerator {
    /// Begins to load the bus.
    pub fn new(now: Instant, own: Address, bits_per_second: u32) -> Self {
        let bits_per_second = f64::from(bits_per_second);
        Self {
            own,
            began: now,
            next: now,
            bits_per_second,
            bits: 0.0,
            queued: 0.0,
            burst: 0,
            counter: 0,
        }
    }

    /// Takes a frame of the bus.
    pub fn handle_frame(&mut self, frame: &Frame) {
        let bits = super::nominal_bits(frame);
        self.bits += bits;
        if frame.is_tx {
            self.queued = (self.queued - bits).max(0.0);
        }
    }

    /// Does what is due.
    pub fn handle_timeout(&mut self, now: Instant) {
        if now >= self.next {
            self.next = now + STEP;
            self.burst = MAX_BURST;
        }
    }

    /// Returns the next frame to send. None is sent while so many wait that they are no load yet.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let wanted = now.since(self.began).as_secs_f64() * self.bits_per_second * LOAD;
        if self.burst == 0 || self.bits + self.queued >= wanted {
            return None;
        }
        self.burst -= 1;
        self.counter = self.counter.wrapping_add(1);
        let [low, high, ..] = self.counter.to_le_bytes();
        let service = Service::from_bits(Service::MAX);
        let header = Header::unsolicited(self.own, low & 0x7F, false, service);
        let frame = Frame::classic(header.encode(), &[low, high, 0x55, 0xAA, 0x55, 0xAA, 0, 0]);
        self.queued += super::nominal_bits(&frame);
        Some(frame)
    }

    /// When something is due.
    pub fn due(&self) -> Instant {
        self.next
    }

    /// Part of the capacity that was used until `now`, 0 to 1.
    pub fn load(&self, now: Instant) -> f64 {
        let capacity = now.since(self.began).as_secs_f64() * self.bits_per_second;
        self.bits / capacity.max(1.0)
    }

    /// Returns true if the bus was loaded.
    pub fn is_enough(&self, now: Instant) -> bool {
        self.load(now) >= LEAST
    }
}
