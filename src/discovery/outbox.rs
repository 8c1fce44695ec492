//! Transmit queue with its budget and the supervision of acknowledgement.
//!
//! Requests wait for the budget; flow control, responses and heartbeats are sent at once and
//! charged to it (protocol §4.4).

use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::id::Header;
use std::collections::VecDeque;

/// Time without a confirmed frame after which sending is paused. Chosen: 400 frames at 125 kbit/s
/// may go before.
const ACK_TIMEOUT: Duration = Duration::from_millis(500);
/// Interval between attempts while sending is paused. Chosen: a lone controller repeats a frame
/// that is not acknowledged, which fills the bus.
const ACK_RETRY_DELAY: Duration = Duration::from_secs(5);
/// Number of sent frames stored, to recognise repeated ones. Chosen: at 30 % of 125 kbit/s, what is
/// sent in 0.8 s.
const SENT_HISTORY: usize = 256;
/// Age at which a stored frame is no longer compared. Chosen: more than a bridge delays frames.
const SENT_HISTORY_AGE: Duration = Duration::from_secs(1);

/// Change of the acknowledgement of descan's frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum AckChange {
    NoAck,
    Restored,
}

/// Transmit queue of one bus.
#[derive(Clone, Debug)]
pub(super) struct Outbox {
    queue: VecDeque<Frame>,
    sent: VecDeque<Frame>,
    /// Addresses that descan sent from, one bit each.
    senders: u128,
    tokens: f64,
    refilled: Instant,
    has_loopback: bool,
    unconfirmed: u32,
    unconfirmed_since: Instant,
    paused_until: Option<Instant>,
    has_no_ack: bool,
}

impl Outbox {
    pub fn new(now: Instant, echo: bool) -> Self {
        Self {
            queue: VecDeque::new(),
            sent: VecDeque::new(),
            senders: 0,
            tokens: 0.0,
            refilled: now,
            has_loopback: echo,
            unconfirmed: 0,
            unconfirmed_since: now,
            paused_until: None,
            has_no_ack: false,
        }
    }

    /// Increases the budget to `now` at `rate` bits per second, up to `burst` bits.
    pub fn refill(&mut self, now: Instant, rate: f64, burst: f64) {
        let passed = now.since(self.refilled).as_secs_f64();
        self.refilled = self.refilled.max(now);
        self.tokens = (self.tokens + passed * rate).min(burst);
    }

    /// Returns true if the budget allows a request.
    pub fn has_budget(&self) -> bool {
        self.tokens > 0.0
    }

    /// Returns when the budget allows a request.
    pub fn budget_at(&self, rate: f64) -> Instant {
        let missing = (-self.tokens).max(0.0) + 1.0;
        self.refilled + Duration::from_micros((missing / rate.max(1.0) * 1e6) as u64)
    }

    /// Appends a frame and charges it to the budget, which may become negative.
    pub fn push(&mut self, frame: Frame) {
        self.tokens -= nominal_bits(&frame);
        self.queue.push_back(frame);
    }

    /// Returns true if there is no frame to send.
    pub fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// Removes the next frame and stores it as sent.
    pub fn pop(&mut self, now: Instant) -> Option<Frame> {
        let frame = self.queue.pop_front()?;
        if self.sent.len() == SENT_HISTORY {
            self.sent.pop_front();
        }
        self.sent.push_back(frame.with_time(now));
        self.senders |= sender_bit(&frame);
        if self.has_loopback {
            if self.unconfirmed == 0 {
                self.unconfirmed_since = now;
            }
            self.unconfirmed += 1;
        }
        Some(frame)
    }

    /// Returns true if descan sent exactly this frame within the last second, so that it was
    /// repeated.
    pub fn is_own_echo(&self, now: Instant, frame: &Frame) -> bool {
        // Called for every frame; the bit mask excludes almost all of them.
        self.senders & sender_bit(frame) != 0
            && self
                .sent
                .iter()
                .any(|own| own.same_on_wire(frame) && now.since(own.time) < SENT_HISTORY_AGE)
    }

    /// Notes that a frame of descan is on the bus.
    pub fn note_sent(&mut self, now: Instant, frame: &Frame) -> Option<AckChange> {
        // The frame may have waited for long; copies of it follow this moment.
        if let Some(own) = self.sent.iter_mut().find(|own| own.same_on_wire(frame)) {
            own.time = now;
        }
        self.unconfirmed = self.unconfirmed.saturating_sub(1);
        self.unconfirmed_since = now;
        self.resume()
    }

    /// Notes a frame of another node, which can acknowledge descan's frames. A frame that is still
    /// not confirmed waits behind frames of higher priority.
    pub fn note_other_frame(&mut self, now: Instant) -> Option<AckChange> {
        self.unconfirmed_since = now;
        if !self.has_no_ack {
            return None;
        }
        self.unconfirmed = 0;
        self.resume()
    }

    fn resume(&mut self) -> Option<AckChange> {
        self.paused_until = None;
        std::mem::take(&mut self.has_no_ack).then_some(AckChange::Restored)
    }

    /// Returns true while sending is paused for lack of acknowledgement.
    pub fn is_paused(&self) -> bool {
        self.paused_until.is_some()
    }

    /// Returns true if frames are not acknowledged.
    pub fn has_no_ack(&self) -> bool {
        self.has_no_ack
    }

    /// Pauses sending without acknowledgement, and ends the pause for another attempt.
    pub fn handle_timeout(&mut self, now: Instant) -> Option<AckChange> {
        match self.paused_until {
            Some(until) if now >= until => {
                // The driver may have dropped the frame that waited: try another one.
                self.paused_until = None;
                self.unconfirmed = 0;
                None
            }
            None if self.unconfirmed > 0 && now.since(self.unconfirmed_since) >= ACK_TIMEOUT => {
                self.paused_until = Some(now + ACK_RETRY_DELAY);
                self.queue.clear();
                let is_new = !std::mem::replace(&mut self.has_no_ack, true);
                is_new.then_some(AckChange::NoAck)
            }
            _ => None,
        }
    }

    pub fn poll_timeout(&self) -> Option<Instant> {
        match self.paused_until {
            Some(until) => Some(until),
            None => (self.unconfirmed > 0).then(|| self.unconfirmed_since + ACK_TIMEOUT),
        }
    }

    /// Discards all frames and ends the pause.
    pub fn clear(&mut self) {
        self.queue.clear();
        self.unconfirmed = 0;
        self.paused_until = None;
        self.has_no_ack = false;
    }
}

/// Returns the SRC address of a frame as a bit.
fn sender_bit(frame: &Frame) -> u128 {
    frame.platform_id().map_or(0, |id| 1 << Header::decode(id).source.index())
}

/// Returns the approximate length of a frame in bits with stuff bits.
pub(super) fn nominal_bits(frame: &Frame) -> f64 {
    (67 + 8 * frame.len()) as f64 * 1.1
}
