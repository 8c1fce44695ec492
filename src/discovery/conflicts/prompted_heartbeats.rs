//! Heartbeats of one address that an event prompted: a response that was sent just before, or a change of
//! what they say. One sender may send them besides those of its period.
//!
//! Pure: what was received goes in, and the heartbeats that are left come out. Bounded.

use super::history::{MAX_TIMES, push_bounded};
use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// Time after a response in which a heartbeat may be prompted by the same request. Chosen: firmware that sends
/// both does so in one turn of its loop.
const AFTER_RESPONSE: Duration = Duration::from_millis(20);

/// Times of prompted heartbeats.
#[derive(Clone, Debug, Default)]
pub(super) struct PromptedHeartbeats {
    /// At most [`MAX_TIMES`], oldest first.
    times: VecDeque<Instant>,
    /// Time of the last response to one node, after which none was received.
    responded_at: Option<Instant>,
    /// Time of the last heartbeat, if it says something else than the one before: two devices in turns, unless
    /// the next one says the same.
    changed_at: Option<Instant>,
}

impl PromptedHeartbeats {
    /// Notes a response to one node.
    pub fn note_response(&mut self, now: Instant) {
        self.responded_at = Some(now);
    }

    /// Notes a heartbeat, received in steps of `resolution`; `is_changed`: its data are not those of the one
    /// before it.
    pub fn note(&mut self, now: Instant, is_changed: bool, resolution: Duration) {
        if let Some(at) = self.changed_at.take_if(|_| !is_changed) {
            self.push(at);
        }
        let window = AFTER_RESPONSE + resolution;
        // One request prompts one.
        let responded_at = self.responded_at.take();
        let is_after_response = responded_at.is_some_and(|at| now.since(at) <= window);
        self.changed_at = Some(now).filter(|_| is_changed && !is_after_response);
        if is_after_response {
            self.push(now);
        }
    }

    fn push(&mut self, at: Instant) {
        push_bounded(&mut self.times, at, MAX_TIMES);
    }

    /// Returns the heartbeats without the prompted ones; `None` if none of them is.
    pub fn others(&self, times: &VecDeque<Instant>) -> Option<VecDeque<Instant>> {
        let first = *times.front()?;
        let is_prompted =
            |at: &Instant| self.changed_at == Some(*at) || self.times.binary_search(at).is_ok();
        if self.times.back().is_none_or(|last| *last < first) && self.changed_at.is_none() {
            return None;
        }
        Some(times.iter().filter(|at| !is_prompted(at)).copied().collect())
    }
}
