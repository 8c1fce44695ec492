//! Receive queue: bounded, between a bus's thread and the session.
//!
//! The thread never waits for the session: frames that do not fit are dropped and counted. Does not
//! know where frames come from.

use crate::diagnostic::Diagnostic;
use crate::frame::Frame;
use crate::status::{BusStatus, Link};
use crate::time::Instant;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Received frames that were not taken yet, and the latest status. For one consumer.
#[derive(Debug)]
pub struct Queue {
    capacity: usize,
    contents: Mutex<Contents>,
    news: Notify,
}

#[derive(Debug, Default)]
struct Contents {
    frames: VecDeque<Frame>,
    names: Vec<String>,
    status: BusStatus,
    status_is_new: bool,
    /// Moment up to which all frames were read, while the thread collects later ones; `None` while it
    /// takes each frame as it arrives.
    complete_until: Option<Instant>,
    /// The frames became complete without a further one.
    is_newly_complete: bool,
}

impl Queue {
    /// Two seconds of a full 1 Mbit/s bus.
    pub const CAPACITY: usize = 16_384;

    /// Empty; holds at most `capacity` frames.
    pub fn new(capacity: usize) -> Self {
        Self { capacity, contents: Mutex::default(), news: Notify::new() }
    }

    /// Waits until there are frames, the status differs from the one taken last, or there is no
    /// [incomplete part](Self::complete_until) any more. Cancel safe.
    pub async fn ready(&self) {
        while !self.contents().has_news() {
            self.news.notified().await;
        }
    }

    /// Appends at most `max` frames to `frames`, oldest first. Returns how many.
    pub fn drain(&self, frames: &mut Vec<Frame>, max: usize) -> usize {
        self.drain_until(frames, max, Instant::LATEST)
    }

    /// Time of the oldest frame to take.
    pub fn first_time(&self) -> Option<Instant> {
        self.contents().frames.front().map(|frame| frame.time)
    }

    /// Appends at most `max` frames to `frames`, oldest first, up to the first one that is later than
    /// `until`. Returns how many.
    pub fn drain_until(&self, frames: &mut Vec<Frame>, max: usize, until: Instant) -> usize {
        let mut contents = self.contents();
        let is_in_time = |frame: &&Frame| frame.time <= until;
        let count = contents.frames.iter().take(max).take_while(is_in_time).count();
        frames.extend(contents.frames.drain(..count));
        count
    }

    /// Moment up to which all frames of the bus were taken from here: a later one waits here, or may
    /// wait where the thread collects them. `None`: up to the present.
    pub fn complete_until(&self) -> Option<Instant> {
        let contents = self.contents();
        contents.frames.front().map(|frame| frame.time).or(contents.complete_until)
    }

    /// The status; `None` if it has not changed since it was last taken. A final link state is
    /// reported only after the last frame was taken.
    pub fn take_status(&self) -> Option<BusStatus> {
        self.contents().take_status()
    }

    /// As [`take_status`](Self::take_status); `None` also while frames wait to be taken.
    pub fn take_status_without_frames(&self) -> Option<BusStatus> {
        let mut contents = self.contents();
        if !contents.frames.is_empty() {
            return None;
        }
        contents.take_status()
    }

    /// The present status, whether it was taken or not.
    pub fn status(&self) -> BusStatus {
        self.contents().status.clone()
    }

    /// Returns true if the link is final and every frame was taken.
    pub fn is_finished(&self) -> bool {
        let contents = self.contents();
        contents.status.link.is_final() && contents.frames.is_empty()
    }

    /// The bus names from a bus number on, counted from the port's own. A log of several interfaces has
    /// more than one.
    pub fn names_from(&self, first: usize) -> Vec<String> {
        self.contents().names.get(first..).unwrap_or_default().to_vec()
    }

    /// Appends frames. Those that do not fit are dropped and counted in
    /// [`BusStatus::queue_drops`].
    pub fn push(&self, frames: &[Frame]) {
        self.push_until(frames, None);
    }

    /// Changes the status and appends the first frames for which that is true: the consumer never finds
    /// one without the other.
    pub fn push_first(&self, frames: &[Frame], change: impl FnOnce(&mut BusStatus)) {
        let mut contents = self.contents();
        change(&mut contents.status);
        contents.status_is_new = true;
        contents.append(frames, self.capacity);
        drop(contents);
        self.news.notify_one();
    }

    /// As [`push`](Self::push), of a thread that now collects frames: those later than
    /// `complete_until` are not read before it pushes again, or [says](Self::set_complete) that there
    /// are none.
    pub fn push_until(&self, frames: &[Frame], complete_until: Option<Instant>) {
        let mut contents = self.contents();
        contents.complete_until = complete_until;
        contents.append(frames, self.capacity);
        drop(contents);
        self.news.notify_one();
    }

    /// The thread takes each frame as it arrives from now on.
    pub fn set_complete(&self) {
        let mut contents = self.contents();
        if contents.complete_until.take().is_some() {
            contents.is_newly_complete = true;
            drop(contents);
            self.news.notify_one();
        }
    }

    /// Returns true if the status has changed since it was last taken.
    pub fn has_new_status(&self) -> bool {
        self.contents().status_is_new
    }

    /// Returns true if there are frames to take.
    pub fn has_frames(&self) -> bool {
        !self.contents().frames.is_empty()
    }

    /// How many frames still fit: for sources that can wait.
    pub fn room(&self) -> usize {
        self.capacity - self.contents().frames.len()
    }

    /// Changes the status; wakes the consumer only if it differs afterwards.
    pub fn update_status(&self, change: impl FnOnce(&mut BusStatus)) {
        let mut contents = self.contents();
        let before = contents.status.clone();
        change(&mut contents.status);
        if contents.status == before {
            return;
        }
        contents.status_is_new = true;
        drop(contents);
        self.news.notify_one();
    }

    /// Gives the status again, though it is the same, and wakes the consumer.
    pub fn repeat_status(&self) {
        self.contents().status_is_new = true;
        self.news.notify_one();
    }

    /// Adds the name of the next bus of this port.
    pub fn add_name(&self, name: &str) {
        self.contents().names.push(name.to_owned());
    }

    /// Sets a final link state and its cause, unless the link is final already.
    pub fn finish(&self, link: Link, fault: Diagnostic) {
        self.set_complete();
        self.update_status(|status| {
            if !status.link.is_final() {
                status.link = link;
                status.fault = Some(fault);
            }
        });
    }

    // A panic of the other side leaves nothing half-done in here, so its poison is ignored.
    fn contents(&self) -> MutexGuard<'_, Contents> {
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Contents {
    /// Appends the frames that fit and counts the others.
    fn append(&mut self, frames: &[Frame], capacity: usize) {
        let room = capacity - self.frames.len();
        let (fitting, lost) = frames.split_at(room.min(frames.len()));
        self.frames.extend(fitting);
        if !lost.is_empty() {
            self.status.queue_drops += lost.len() as u64;
            self.status_is_new = true;
        }
    }

    fn take_status(&mut self) -> Option<BusStatus> {
        self.is_newly_complete = false;
        if self.status.link.is_final() && !self.frames.is_empty() {
            let status = BusStatus { link: Link::Up, fault: None, ..self.status.clone() };
            return self.status_is_new.then_some(status);
        }
        std::mem::take(&mut self.status_is_new).then(|| self.status.clone())
    }

    fn has_news(&self) -> bool {
        !self.frames.is_empty() || self.status_is_new || self.is_newly_complete
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::future::Future;
    use std::pin::pin;
    use std::sync::Arc;
    use std::task::{Context, Poll, Waker};

    fn frames(ids: std::ops::Range<u32>) -> Vec<Frame> {
        ids.map(|id| Frame::classic(id, &[])).collect()
    }

    fn is_ready(queue: &Queue) -> bool {
        let mut context = Context::from_waker(Waker::noop());
        pin!(queue.ready()).poll(&mut context) == Poll::Ready(())
    }

    #[test]
    fn drain_returns_frames_in_order_and_in_batches() {
        let queue = Queue::new(10);
        queue.push(&frames(0..5));
        let mut taken = Vec::new();
        assert_eq!(queue.drain(&mut taken, 3), 3);
        assert_eq!(queue.drain(&mut taken, 3), 2);
        assert_eq!(taken, frames(0..5));
    }

    #[test]
    fn full_queue_drops_the_newest_and_counts_them() {
        let queue = Queue::new(3);
        queue.push(&frames(0..5));
        queue.push(&frames(5..6));
        assert_eq!(queue.take_status().map(|status| status.queue_drops), Some(3));
        let mut taken = Vec::new();
        queue.drain(&mut taken, 100);
        assert_eq!(taken, frames(0..3));
        assert_eq!(queue.room(), 3);
    }

    #[test]
    fn queue_is_ready_for_frames_and_changed_status_only() {
        let queue = Queue::new(3);
        assert!(!is_ready(&queue));
        queue.update_status(|status| status.link = Link::Up);
        assert!(is_ready(&queue));
        assert_eq!(queue.take_status().map(|status| status.link), Some(Link::Up));
        queue.update_status(|status| status.link = Link::Up);
        assert!(!is_ready(&queue));
        assert_eq!(queue.take_status(), None);
        queue.push(&frames(0..1));
        assert!(is_ready(&queue));
    }

    #[test]
    fn final_link_is_reported_after_the_last_frame() {
        let queue = Queue::new(3);
        queue.push(&frames(0..1));
        queue.finish(Link::Ended, Diagnostic::new("end of log"));
        queue.finish(Link::Failed, Diagnostic::new("a later one does not count"));
        assert!(!queue.is_finished());
        let status = queue.take_status().expect("news");
        assert_eq!((status.link, status.fault), (Link::Up, None), "while there are frames to take");
        queue.drain(&mut Vec::new(), 9);
        assert!(queue.is_finished());
        let status = queue.take_status().expect("the last word");
        assert_eq!((status.link, status.fault), (Link::Ended, Some(Diagnostic::new("end of log"))));
    }

    #[test]
    fn status_of_first_frames_is_never_found_without_them() {
        for _ in 0..20_000 {
            let queue = Queue::new(3);
            let begun = std::sync::Barrier::new(2);
            std::thread::scope(|threads| {
                threads.spawn(|| {
                    begun.wait();
                    queue.push_first(&frames(0..1), |status| status.link = Link::Up);
                });
                begun.wait();
                while !queue.has_frames() {
                    assert_eq!(queue.take_status_without_frames(), None);
                }
                assert_eq!(queue.take_status().map(|status| status.link), Some(Link::Up));
            });
        }
    }

    #[test]
    fn push_wakes_a_consumer_in_another_thread() {
        let queue = Arc::new(Queue::new(3));
        let producer = Arc::clone(&queue);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        runtime.block_on(async {
            let thread = std::thread::spawn(move || producer.push(&frames(0..1)));
            let waited = tokio::time::timeout(crate::time::Duration::from_secs(10), queue.ready());
            waited.await.expect("woken");
            thread.join().unwrap();
        });
    }
}
