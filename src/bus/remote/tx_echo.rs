//! Loopback of sent frames for adapters and servers, which may or may not confirm them.
//!
//! SocketCAN returns a sent frame once it was on the bus, and discovery relies on it. Here a frame is
//! returned when the adapter or server confirms it, or, without confirmations, as soon as it is
//! written. The first frame shows which applies.

use crate::frame::Frame;
use crate::time::{Duration, Instant, debug_assert_later};
use std::collections::VecDeque;

/// Largest number of frames in flight.
const CAPACITY: usize = 32;
/// How long a frame may stay unconfirmed, where frames are confirmed, before it counts as not sent.
const CONFIRM_TIMEOUT: Duration = Duration::from_secs(5);

/// Whether the adapter or server confirms sent frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::bus) enum Confirmation {
    /// Not known before the first frame.
    Unknown,
    /// It confirms them.
    Given,
    /// It does not confirm them.
    Never,
}

/// Frames in flight, oldest first.
#[derive(Debug)]
pub(in crate::bus) struct TxEchoTracker {
    confirmation: Confirmation,
    /// How long to wait for the confirmation of the first frame.
    first_timeout: Duration,
    unwritten: VecDeque<(Frame, u64)>,
    written: VecDeque<(Frame, Instant)>,
}

impl TxEchoTracker {
    /// Without frames. Discovery counts a frame as not sent after 0.5 s, so `first_timeout` must be
    /// well below that.
    pub fn new(confirmation: Confirmation, first_timeout: Duration) -> Self {
        let (unwritten, written) = (VecDeque::new(), VecDeque::new());
        Self { confirmation, first_timeout, unwritten, written }
    }

    /// Whether frames are confirmed, as far as known.
    pub fn confirmation(&self) -> Confirmation {
        self.confirmation
    }

    /// Sets what is known from another source.
    pub fn set_confirmation(&mut self, confirmation: Confirmation) {
        self.confirmation = confirmation;
    }

    /// Returns true if another frame may be sent.
    pub fn has_room(&self) -> bool {
        self.unwritten.len() + self.written.len() < CAPACITY
    }

    /// Number of frames in flight.
    pub fn in_flight(&self) -> u64 {
        (self.unwritten.len() + self.written.len()) as u64
    }

    /// When the oldest unconfirmed frame was written; `None` if there is none.
    pub fn oldest_written(&self) -> Option<Instant> {
        self.written.front().map(|(_, since)| *since)
    }

    /// Adds a frame whose last byte is the `end`th of the stream.
    pub fn push(&mut self, frame: &Frame, end: u64) {
        self.unwritten.push_back((*frame, end));
    }

    /// Notes that the first `total` bytes of the stream are written. Appends returned frames to
    /// `back`.
    pub fn written(&mut self, now: Instant, total: u64, back: &mut Vec<Frame>) {
        while let Some((frame, _)) = self.unwritten.pop_front_if(|(_, end)| *end <= total) {
            if self.confirmation == Confirmation::Never {
                back.push(frame.with_tx().with_time(now));
            } else {
                self.written.push_back((frame, now));
            }
        }
    }

    /// Confirms the oldest frame and returns it.
    pub fn confirm_oldest(&mut self, now: Instant) -> Option<Frame> {
        self.confirmation = Confirmation::Given;
        let (frame, _) = self.written.pop_front()?;
        Some(frame.with_tx().with_time(now))
    }

    /// Confirms the oldest frame that is equal to a received one. Returns true if there is one.
    pub fn confirm_equal(&mut self, received: &Frame) -> bool {
        let position = self.written.iter().position(|(own, _)| own.same_on_wire(received));
        if let Some(position) = position {
            self.confirmation = Confirmation::Given;
            self.written.remove(position);
        }
        position.is_some()
    }

    /// Removes the oldest frame, which was rejected. Returns true if there is one.
    pub fn refuse_oldest(&mut self) -> bool {
        if self.confirmation == Confirmation::Unknown {
            self.confirmation = Confirmation::Given;
        }
        self.written.pop_front().is_some()
    }

    /// Handles timeouts. If the first frame stayed unconfirmed, frames are not confirmed: those
    /// written are appended to `back`. Returns the number of frames given up because a confirmation
    /// is missing.
    pub fn handle_timeout(&mut self, now: Instant, back: &mut Vec<Frame>) -> u64 {
        let Some(oldest) = self.oldest_written() else { return 0 };
        let waited = now.since(oldest);
        if self.confirmation == Confirmation::Unknown && waited >= self.first_timeout {
            self.confirmation = Confirmation::Never;
        }
        if self.confirmation == Confirmation::Never {
            back.extend(self.written.drain(..).map(|(frame, _)| frame.with_tx().with_time(now)));
            return 0;
        }
        let before = self.written.len();
        self.written.retain(|(_, since)| now.since(*since) < CONFIRM_TIMEOUT);
        debug_assert_later(self.poll_timeout(), now);
        (before - self.written.len()) as u64
    }

    /// When to call [`handle_timeout`](Self::handle_timeout); `None` if no frame waits.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let wait = match self.confirmation {
            Confirmation::Unknown => self.first_timeout,
            Confirmation::Given => CONFIRM_TIMEOUT,
            Confirmation::Never => Duration::ZERO,
        };
        self.oldest_written().map(|since| since + wait)
    }

    /// Removes all frames. Returns how many were in flight.
    pub fn clear(&mut self) -> u64 {
        let count = self.in_flight();
        self.unwritten.clear();
        self.written.clear();
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIRST_TIMEOUT: Duration = Duration::from_millis(250);

    fn frame(id: u32) -> Frame {
        Frame::classic(id, &[1, 2])
    }

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    fn three_written() -> TxEchoTracker {
        let mut own = TxEchoTracker::new(Confirmation::Unknown, FIRST_TIMEOUT);
        for id in 1..=3 {
            own.push(&frame(id), u64::from(id) * 10);
        }
        let mut back = Vec::new();
        own.written(at(0), 30, &mut back);
        assert_eq!(back, []);
        own
    }

    #[test]
    fn unwritten_frame_is_not_looped_back() {
        let mut own = TxEchoTracker::new(Confirmation::Never, FIRST_TIMEOUT);
        own.push(&frame(1), 10);
        own.push(&frame(2), 20);
        let mut back = Vec::new();
        own.written(at(1), 19, &mut back);
        assert_eq!(back, [frame(1).with_tx().with_time(at(1))]);
        assert_eq!(own.in_flight(), 1);
        assert_eq!(own.clear(), 1);
    }

    #[test]
    fn confirmed_frame_is_looped_back() {
        let mut own = three_written();
        assert_eq!(own.confirm_oldest(at(5)), Some(frame(1).with_tx().with_time(at(5))));
        assert_eq!(own.confirm_oldest(at(7)), Some(frame(2).with_tx().with_time(at(7))));
        assert!(own.refuse_oldest());
        assert_eq!(own.confirm_oldest(at(7)), None);
    }

    #[test]
    fn returned_frame_is_confirmed() {
        let mut own = three_written();
        assert!(!own.confirm_equal(&frame(4)));
        assert!(own.confirm_equal(&frame(2)));
        assert!(!own.confirm_equal(&frame(2)));
        assert_eq!((own.in_flight(), own.confirmation()), (2, Confirmation::Given));
    }

    #[test]
    fn unconfirmed_first_frame_disables_confirmation() {
        let mut own = three_written();
        assert_eq!(own.poll_timeout(), Some(at(250)));
        let mut back = Vec::new();
        assert_eq!(own.handle_timeout(at(249), &mut back), 0);
        assert_eq!(back, []);
        assert_eq!(own.handle_timeout(at(250), &mut back), 0);
        assert_eq!(back.len(), 3);
        own.push(&frame(4), 40);
        own.written(at(300), 40, &mut back);
        assert_eq!(back.last(), Some(&frame(4).with_tx().with_time(at(300))));
    }

    #[test]
    fn missing_confirmation_after_others_means_not_sent() {
        let mut own = three_written();
        own.confirm_oldest(at(1));
        let mut back = Vec::new();
        assert_eq!(own.handle_timeout(at(4_999), &mut back), 0);
        assert_eq!(own.handle_timeout(at(5_000), &mut back), 2);
        assert_eq!((back, own.in_flight()), (vec![], 0));
    }

    #[test]
    fn frames_in_flight_are_limited() {
        let mut own = TxEchoTracker::new(Confirmation::Given, FIRST_TIMEOUT);
        for id in 0..CAPACITY {
            assert!(own.has_room());
            own.push(&frame(id as u32), 1);
        }
        assert!(!own.has_room());
    }
}
