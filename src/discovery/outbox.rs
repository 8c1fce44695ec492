//! What is to be sent: how much of the bus it may take, and whether anybody acknowledges it.
//!
//! Questions wait for the budget; flow control, answers and heartbeats go at once and are
//! charged all the same.

use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::id::Header;
use std::collections::VecDeque;

/// How long a frame may stay without the bus having taken it before nothing more is sent.
const ACKNOWLEDGE_WITHIN: Duration = Duration::from_millis(500);
/// How often a silent bus is tried again.
const TRY_AGAIN: Duration = Duration::from_secs(5);
/// Frames that are remembered to recognise them when something sends them back to us.
const SENT_HISTORY: usize = 256;
/// For how long they are.
const REMEMBERED_FOR: Duration = Duration::from_secs(1);

/// A change in whether anybody acknowledges us.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Acknowledgement {
    Missing,
    Back,
}

#[derive(Debug)]
pub(super) struct Outbox {
    queue: VecDeque<Frame>,
    sent: VecDeque<Frame>,
    /// The addresses that we sent from, a bit each.
    senders: u128,
    tokens: f64,
    refilled: Instant,
    echo: bool,
    unconfirmed: u32,
    unconfirmed_since: Instant,
    held_until: Option<Instant>,
    missing: bool,
}

impl Outbox {
    pub fn new(now: Instant, echo: bool) -> Self {
        Self {
            queue: VecDeque::new(),
            sent: VecDeque::new(),
            senders: 0,
            tokens: 0.0,
            refilled: now,
            echo,
            unconfirmed: 0,
            unconfirmed_since: now,
            held_until: None,
            missing: false,
        }
    }

    /// Lets the budget grow to `now` at `rate` bits per second, up to `burst` bits.
    pub fn refill(&mut self, now: Instant, rate: f64, burst: f64) {
        let passed = now.since(self.refilled).as_secs_f64();
        self.refilled = self.refilled.max(now);
        self.tokens = (self.tokens + passed * rate).min(burst);
    }

    /// Whether the budget lets a question go.
    pub fn has_budget(&self) -> bool {
        self.tokens > 0.0
    }

    /// When it will.
    pub fn budget_at(&self, rate: f64) -> Instant {
        let missing = (-self.tokens).max(0.0) + 1.0;
        self.refilled + Duration::from_micros((missing / rate.max(1.0) * 1e6) as u64)
    }

    pub fn push(&mut self, frame: Frame) {
        self.tokens -= nominal_bits(&frame);
        self.queue.push_back(frame);
    }

    /// Hands out the next frame.
    pub fn pop(&mut self, now: Instant) -> Option<Frame> {
        let frame = self.queue.pop_front()?;
        if self.sent.len() == SENT_HISTORY {
            self.sent.pop_front();
        }
        self.sent.push_back(frame.with_time(now));
        self.senders |= sender_bit(&frame);
        if self.echo {
            if self.unconfirmed == 0 {
                self.unconfirmed_since = now;
            }
            self.unconfirmed += 1;
        }
        Some(frame)
    }

    /// Whether we sent just this frame within the last second: then it came back to us.
    pub fn is_own_echo(&self, now: Instant, frame: &Frame) -> bool {
        // Asked of every frame: hardly any is from our address.
        self.senders & sender_bit(frame) != 0
            && self
                .sent
                .iter()
                .any(|own| own.same_on_wire(frame) && now.since(own.time) < REMEMBERED_FOR)
    }

    /// The bus took a frame of ours.
    pub fn confirmed(&mut self, now: Instant, frame: &Frame) -> Option<Acknowledgement> {
        // It may have waited for long; what comes back of it comes after this.
        if let Some(own) = self.sent.iter_mut().find(|own| own.same_on_wire(frame)) {
            own.time = now;
        }
        self.unconfirmed = self.unconfirmed.saturating_sub(1);
        self.unconfirmed_since = now;
        self.resume()
    }

    /// Somebody else sent a frame: there is somebody to acknowledge ours. One of ours that is
    /// still not sent waits behind frames of higher priority.
    pub fn note_other_frame(&mut self, now: Instant) -> Option<Acknowledgement> {
        self.unconfirmed_since = now;
        if !self.missing {
            return None;
        }
        self.unconfirmed = 0;
        self.resume()
    }

    fn resume(&mut self) -> Option<Acknowledgement> {
        self.held_until = None;
        std::mem::take(&mut self.missing).then_some(Acknowledgement::Back)
    }

    /// Whether nothing may be sent now because nobody acknowledges.
    pub fn is_paused(&self) -> bool {
        self.held_until.is_some()
    }

    /// Whether nobody acknowledges, as far as is known.
    pub fn is_missing(&self) -> bool {
        self.missing
    }

    pub fn handle_timeout(&mut self, now: Instant) -> Option<Acknowledgement> {
        match self.held_until {
            Some(until) if now >= until => {
                // The frame that waited may have been thrown away below us: try another.
                self.held_until = None;
                self.unconfirmed = 0;
                None
            }
            None if self.unconfirmed > 0
                && now.since(self.unconfirmed_since) >= ACKNOWLEDGE_WITHIN =>
            {
                self.held_until = Some(now + TRY_AGAIN);
                self.queue.clear();
                let news = !std::mem::replace(&mut self.missing, true);
                news.then_some(Acknowledgement::Missing)
            }
            _ => None,
        }
    }

    pub fn poll_timeout(&self) -> Option<Instant> {
        match self.held_until {
            Some(until) => Some(until),
            None => (self.unconfirmed > 0).then(|| self.unconfirmed_since + ACKNOWLEDGE_WITHIN),
        }
    }

    pub fn clear(&mut self) {
        self.queue.clear();
        self.unconfirmed = 0;
        self.held_until = None;
        self.missing = false;
    }
}

/// The address that a frame says it is from, as a bit.
fn sender_bit(frame: &Frame) -> u128 {
    frame.platform_id().map_or(0, |id| 1 << Header::decode(id).source.index())
}

/// About how many bits a frame takes, with an allowance for stuffing: for the budget alone.
fn nominal_bits(frame: &Frame) -> f64 {
    (67 + 8 * frame.len()) as f64 * 1.1
}
