//! Delivery of a bus's frames and status into its receive queue: frames get the bus number and
//! times that do not run backwards; error frames are counted in the status.

use crate::bus::port::PortShared;
use crate::error_report::ErrorReport;
use crate::frame::{BusIndex, Frame};
use crate::status::BusStatus;
use crate::time::Instant;
use std::sync::Arc;

/// The producer's side of a receive queue.
#[derive(Debug)]
pub(in crate::bus) struct Delivery {
    shared: Arc<PortShared>,
    bus: BusIndex,
    /// The time of the last frame; the next is not earlier.
    last: Instant,
}

impl Delivery {
    /// For the frames of bus `bus`.
    pub fn new(shared: Arc<PortShared>, bus: BusIndex) -> Self {
        Self { shared, bus, last: Instant::ZERO }
    }

    /// Delivers and empties `frames`; counts missing ACKs and controller overruns of error frames
    /// in `status`. The status goes first: the consumer never sees frames newer than it.
    pub fn deliver(&mut self, frames: &mut Vec<Frame>, status: &mut BusStatus) {
        for frame in frames.iter_mut() {
            self.last = self.last.max(frame.time);
            frame.time = self.last;
            frame.bus = self.bus;
            if let Some(report) = ErrorReport::of(frame) {
                status.missing_acks += u64::from(report.is_no_ack());
                status.controller_overruns += u64::from(report.is_receive_overflow());
            }
        }
        self.deliver_status(status);
        if !frames.is_empty() {
            self.shared.queue.push(frames);
            frames.clear();
        }
    }

    /// Delivers the status, except for `queue_drops`, which the queue counts.
    pub fn deliver_status(&self, status: &BusStatus) {
        self.shared.queue.update_status(|current| {
            let queue_drops = current.queue_drops;
            current.clone_from(status);
            current.queue_drops = queue_drops;
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_get_bus_number_and_ordered_times() {
        let shared = Arc::new(PortShared::new().unwrap());
        let mut delivery = Delivery::new(Arc::clone(&shared), BusIndex(2));
        let at = |micros| Frame::classic(1, &[]).with_time(Instant::from_micros(micros));
        let mut status = BusStatus::default();
        let mut frames = vec![at(5), at(3), Frame::error(0x20, &[])];
        delivery.deliver(&mut frames, &mut status);
        delivery.deliver(&mut vec![at(4), at(9)], &mut status);
        assert_eq!((frames.len(), status.missing_acks), (0, 1));
        let mut seen = Vec::new();
        shared.queue.drain(&mut seen, 10);
        let times: Vec<_> = seen.iter().map(|frame| frame.time.as_micros()).collect();
        assert_eq!(times, [5, 5, 5, 5, 9]);
        assert!(seen.iter().all(|frame| frame.bus == BusIndex(2)));
        assert_eq!(shared.queue.status().missing_acks, 1);
    }

    #[test]
    fn queue_drops_survive_a_status_update() {
        let shared = Arc::new(PortShared::new().unwrap());
        shared.queue.update_status(|status| status.queue_drops = 7);
        Delivery::new(Arc::clone(&shared), BusIndex(0)).deliver_status(&BusStatus::default());
        assert_eq!(shared.queue.status().queue_drops, 7);
    }
}
