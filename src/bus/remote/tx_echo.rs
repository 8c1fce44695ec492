//! Frames of ours on their way to a bus whose adapter or server may or may not say when they
//! are there.
//!
//! SocketCAN gives our frames back once they are on the bus, and discovery relies on it. Here
//! each is put back when the other end confirms it, or, where it never confirms anything, as
//! soon as it is written. Which of the two it is shows with the first frame.

use crate::frame::Frame;
use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// Frames that may be under way at once.
const CAPACITY: usize = 32;
/// How long a frame may stay unconfirmed by one who confirms before it counts as not sent.
const CONFIRM_TIMEOUT: Duration = Duration::from_secs(5);

/// Whether the other end says that a frame got out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::bus) enum Confirmation {
    /// The first frame will show it.
    Unknown,
    /// It does.
    Given,
    /// It does not.
    Never,
}

/// Frames that were handed over and not put back yet, oldest first.
#[derive(Debug)]
pub(in crate::bus) struct TxEchoTracker {
    confirmation: Confirmation,
    /// How long the first frame is waited for.
    patience: Duration,
    unwritten: VecDeque<(Frame, u64)>,
    written: VecDeque<(Frame, Instant)>,
}

impl TxEchoTracker {
    /// None under way. Discovery takes a frame for unheard after half a second, so `patience`
    /// is to be well below that.
    pub fn new(confirmation: Confirmation, patience: Duration) -> Self {
        let (unwritten, written) = (VecDeque::new(), VecDeque::new());
        Self { confirmation, patience, unwritten, written }
    }

    /// Whether the other end confirms, as far as is known.
    pub fn confirmation(&self) -> Confirmation {
        self.confirmation
    }

    /// Says what is known from elsewhere.
    pub fn set_confirmation(&mut self, confirmation: Confirmation) {
        self.confirmation = confirmation;
    }

    /// Whether another may be handed over.
    pub fn has_room(&self) -> bool {
        self.unwritten.len() + self.written.len() < CAPACITY
    }

    /// How many are under way.
    pub fn in_flight(&self) -> u64 {
        (self.unwritten.len() + self.written.len()) as u64
    }

    /// When the oldest was written that waits to be confirmed.
    pub fn oldest_written(&self) -> Option<Instant> {
        self.written.front().map(|(_, since)| *since)
    }

    /// A frame was handed over; its last byte is the `end`th of the stream.
    pub fn push(&mut self, frame: &Frame, end: u64) {
        self.unwritten.push_back((*frame, end));
    }

    /// The first `total` bytes of the stream are written. Frames to put back go to `back`.
    pub fn written(&mut self, now: Instant, total: u64, back: &mut Vec<Frame>) {
        while let Some((frame, _)) = self.unwritten.pop_front_if(|(_, end)| *end <= total) {
            if self.confirmation == Confirmation::Never {
                back.push(frame.with_tx().with_time(now));
            } else {
                self.written.push_back((frame, now));
            }
        }
    }

    /// The oldest one is confirmed: the frame to put back.
    pub fn confirm_oldest(&mut self, now: Instant) -> Option<Frame> {
        self.confirmation = Confirmation::Given;
        let (frame, _) = self.written.pop_front()?;
        Some(frame.with_tx().with_time(now))
    }

    /// Whether a frame that was heard is the oldest of ours that is equal to it: then it is
    /// confirmed by that.
    pub fn confirm_equal(&mut self, heard: &Frame) -> bool {
        let position = self.written.iter().position(|(own, _)| own.same_on_wire(heard));
        if let Some(position) = position {
            self.confirmation = Confirmation::Given;
            self.written.remove(position);
        }
        position.is_some()
    }

    /// The oldest one was refused.
    pub fn refuse_oldest(&mut self) -> bool {
        if self.confirmation == Confirmation::Unknown {
            self.confirmation = Confirmation::Given;
        }
        self.written.pop_front().is_some()
    }

    /// Does what is due: where the first frame stayed unconfirmed, nobody confirms here, and
    /// what was written is put back. Gives the number of frames that are given up because one
    /// who confirms did not.
    pub fn handle_timeout(&mut self, now: Instant, back: &mut Vec<Frame>) -> u64 {
        let Some(oldest) = self.oldest_written() else { return 0 };
        let waited = now.since(oldest);
        if self.confirmation == Confirmation::Unknown && waited >= self.patience {
            self.confirmation = Confirmation::Never;
        }
        if self.confirmation == Confirmation::Never {
            back.extend(self.written.drain(..).map(|(frame, _)| frame.with_tx().with_time(now)));
            return 0;
        }
        let before = self.written.len();
        self.written.retain(|(_, since)| now.since(*since) < CONFIRM_TIMEOUT);
        (before - self.written.len()) as u64
    }

    /// When that is.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let wait = match self.confirmation {
            Confirmation::Unknown => self.patience,
            Confirmation::Given => CONFIRM_TIMEOUT,
            Confirmation::Never => Duration::ZERO,
        };
        self.oldest_written().map(|since| since + wait)
    }

    /// The way is gone; gives the number of frames that were under way.
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

    const PATIENCE: Duration = Duration::from_millis(250);

    fn frame(id: u32) -> Frame {
        Frame::classic(id, &[1, 2])
    }

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    fn three_written() -> TxEchoTracker {
        let mut own = TxEchoTracker::new(Confirmation::Unknown, PATIENCE);
        for id in 1..=3 {
            own.push(&frame(id), u64::from(id) * 10);
        }
        let mut back = Vec::new();
        own.written(at(0), 30, &mut back);
        assert_eq!(back, []);
        own
    }

    #[test]
    fn what_is_not_written_is_not_put_back() {
        let mut own = TxEchoTracker::new(Confirmation::Never, PATIENCE);
        own.push(&frame(1), 10);
        own.push(&frame(2), 20);
        let mut back = Vec::new();
        own.written(at(1), 19, &mut back);
        assert_eq!(back, [frame(1).with_tx().with_time(at(1))]);
        assert_eq!(own.in_flight(), 1);
        assert_eq!(own.clear(), 1);
    }

    #[test]
    fn a_confirmed_one_is_put_back_then() {
        let mut own = three_written();
        assert_eq!(own.confirm_oldest(at(5)), Some(frame(1).with_tx().with_time(at(5))));
        assert_eq!(own.confirm_oldest(at(7)), Some(frame(2).with_tx().with_time(at(7))));
        assert!(own.refuse_oldest());
        assert_eq!(own.confirm_oldest(at(7)), None);
    }

    #[test]
    fn one_that_comes_back_is_confirmed_by_that() {
        let mut own = three_written();
        assert!(!own.confirm_equal(&frame(4)));
        assert!(own.confirm_equal(&frame(2)));
        assert!(!own.confirm_equal(&frame(2)));
        assert_eq!((own.in_flight(), own.confirmation()), (2, Confirmation::Given));
    }

    #[test]
    fn who_confirms_nothing_at_first_never_does() {
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
    fn one_who_confirms_and_stops_has_not_sent() {
        let mut own = three_written();
        own.confirm_oldest(at(1));
        let mut back = Vec::new();
        assert_eq!(own.handle_timeout(at(4_999), &mut back), 0);
        assert_eq!(own.handle_timeout(at(5_000), &mut back), 2);
        assert_eq!((back, own.in_flight()), (vec![], 0));
    }

    #[test]
    fn no_more_than_some_are_under_way() {
        let mut own = TxEchoTracker::new(Confirmation::Given, PATIENCE);
        for id in 0..CAPACITY {
            assert!(own.has_room());
            own.push(&frame(id as u32), 1);
        }
        assert!(!own.has_room());
    }
}
