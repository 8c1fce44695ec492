//! Transmit loop of a bus thread: takes frames from the port, offers them to the bus, and repeats a
//! frame for which the bus has no room.
//!
//! Does not know how a bus sends, nor when to offer again: the bus does.

use super::port::PortShared;
use crate::frame::Frame;
use std::sync::Arc;
use std::time::{Duration, Instant as Monotonic};

/// The frames that a bus has yet to send, oldest first.
#[derive(Debug)]
pub(super) struct TxQueue {
    shared: Arc<PortShared>,
    /// How long a frame may wait for room.
    timeout: Duration,
    /// A frame for which there was no room, and since when it waits.
    waiting: Option<(Frame, Monotonic)>,
}

/// What came of offering a frame to the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TxAttempt {
    Sent,
    /// To be offered again.
    NoRoom,
    /// Not sent; the next frame may be.
    Rejected,
    /// Not sent; offer no more.
    Failed,
}

/// What came of offering all frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct TxReport {
    /// Frames given up.
    pub failures: u64,
    /// Whether the last frame that was sent or given up had waited too long for room; `None` if
    /// there was no such frame.
    pub is_full: Option<bool>,
}

impl TxQueue {
    /// The frames of a port.
    pub fn new(shared: Arc<PortShared>, timeout: Duration) -> Self {
        Self { shared, timeout, waiting: None }
    }

    /// Offers frames until none is left, or one has to wait.
    pub fn transmit(&mut self, mut offer: impl FnMut(&Frame) -> TxAttempt) -> TxReport {
        let mut report = TxReport::default();
        while let Some((frame, since)) = self.next() {
            let attempt = offer(&frame);
            if attempt == TxAttempt::NoRoom && since.elapsed() < self.timeout {
                self.waiting = Some((frame, since));
                break;
            }
            report.failures += u64::from(attempt != TxAttempt::Sent);
            report.is_full = Some(attempt == TxAttempt::NoRoom);
            if attempt == TxAttempt::Failed {
                break;
            }
        }
        report
    }

    /// Gives up all frames, for example because the bus is down; returns how many.
    pub fn clear(&mut self) -> u64 {
        std::iter::from_fn(|| self.next()).count() as u64
    }

    /// How long the waiting frame may still wait; `None` if no frame waits.
    pub fn time_left(&self) -> Option<Duration> {
        self.waiting.map(|(_, since)| self.timeout.saturating_sub(since.elapsed()))
    }

    fn next(&mut self) -> Option<(Frame, Monotonic)> {
        self.waiting.take().or_else(|| Some((self.shared.pop_tx()?, Monotonic::now())))
    }
}

#[cfg(test)]
mod tests {
    use super::super::port::Port;
    use super::*;

    fn queue(timeout: Duration) -> (Port, TxQueue) {
        let shared = Arc::new(PortShared::new().unwrap());
        let port = Port::new("test", Arc::clone(&shared), false);
        for id in 1..=3 {
            port.transmit(&Frame::classic(id, &[])).unwrap();
        }
        (port, TxQueue::new(shared, timeout))
    }

    #[test]
    fn frame_without_room_is_offered_again_first() {
        let (_port, mut queue) = queue(Duration::from_hours(1));
        let report = queue.transmit(|_| TxAttempt::NoRoom);
        assert_eq!(report, TxReport::default());
        assert!(queue.time_left().is_some());
        let mut sent = Vec::new();
        let report = queue.transmit(|frame| {
            sent.push(*frame);
            TxAttempt::Sent
        });
        assert_eq!(sent, [1, 2, 3].map(|id| Frame::classic(id, &[])));
        assert_eq!(report, TxReport { failures: 0, is_full: Some(false) });
        assert_eq!(queue.time_left(), None);
    }

    #[test]
    fn frame_that_waited_too_long_is_given_up() {
        let (_port, mut queue) = queue(Duration::ZERO);
        let report = queue.transmit(|_| TxAttempt::NoRoom);
        assert_eq!(report, TxReport { failures: 3, is_full: Some(true) });
    }

    #[test]
    fn failure_ends_the_loop_and_clear_counts_the_rest() {
        let (_port, mut queue) = queue(Duration::ZERO);
        assert_eq!(queue.transmit(|_| TxAttempt::Failed).failures, 1);
        assert_eq!((queue.clear(), queue.clear()), (2, 0));
    }
}
