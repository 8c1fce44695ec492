//! Frames of several buses or logs, handled in the order of their times.

use super::{BATCH, Session, SessionInput, own_bus};
use crate::bus::Port;
use crate::status::Link;
use crate::time::Instant;

impl Session {
    /// The ports whose news are waited for: all, or while frames wait for an earlier one, those of which
    /// it may be.
    pub(super) fn awaited_ports(&self) -> Vec<usize> {
        let SessionInput::Ports { ports, .. } = &self.input else { return Vec::new() };
        // In this order: a frame may arrive in between.
        let has_frames: Vec<bool> = ports.iter().map(|port| port.queue().has_frames()).collect();
        let waits = ports.len() > 1 && has_frames.contains(&true) && self.next_port().is_none();
        (0..ports.len()).filter(|at| !waits || !has_frames[*at]).collect()
    }

    /// Handles the statuses. A log that begins later is up from its first frame on.
    pub(super) fn receive_statuses(&mut self, now: Instant) {
        let SessionInput::Ports { ports, .. } = &self.input else { return };
        let take = |(at, port): (usize, &Port)| {
            let queue = port.queue();
            let status = if self.begins_later(at) {
                queue.take_status_without_frames()
            } else {
                queue.take_status()
            };
            Some((at, status?))
        };
        let statuses: Vec<_> = ports.iter().enumerate().filter_map(take).collect();
        for (at, status) in statuses {
            self.handle_status(now, at, &status);
        }
    }

    /// Handles frames of several ports in the order of their times; returns false if there are none, or
    /// if an earlier one of another port is still being read.
    pub(super) fn receive_merged(&mut self, now: Instant) -> bool {
        self.batch.clear();
        while self.batch.len() < BATCH
            && let Some((port_at, first, until)) = self.next_port()
        {
            let (begins, is_due) = (self.begins_later(port_at), self.is_status_due());
            if (begins || is_due) && !self.batch.is_empty() {
                break;
            }
            if is_due {
                // The devices of a log that ends are not awaited while the others go on.
                self.receive_statuses(self.app.now());
            }
            if begins {
                self.app.advance_to(first);
                self.receive_status(first, port_at);
            }
            self.take_frames(now, port_at, until);
        }
        self.handle_batch()
    }

    /// Returns true if the status of a log changed whose frames are all handled.
    fn is_status_due(&self) -> bool {
        let SessionInput::Ports { ports, .. } = &self.input else { return false };
        if !self.is_replay() {
            return false;
        }
        let mut queues = ports.iter().map(Port::queue);
        queues.any(|queue| queue.has_new_status() && !queue.has_frames())
    }

    /// Returns true if no frame of a port was handled, because its log begins later than others.
    fn begins_later(&self, port_at: usize) -> bool {
        let bus = own_bus(port_at).and_then(|bus| self.app.bus(bus));
        self.is_replay() && bus.is_some_and(|bus| bus.status.link == Link::Opening)
    }

    /// The port with the earliest frame that was read, the time of that frame, and the moment up to which
    /// it has no later frames than the others; `None` if another one may have an earlier one.
    fn next_port(&self) -> Option<(usize, Instant, Instant)> {
        let SessionInput::Ports { clock, ports, .. } = &self.input else { return None };
        let is_replay = self.is_replay();
        let known = ports.iter().enumerate().map(|(at, port)| {
            // In this order: a frame may arrive in between.
            let next = if is_replay {
                own_bus(at).and_then(|log| clock.next_of(log))
            } else {
                port.queue().complete_until()
            };
            (port.queue().first_time(), next)
        });
        let known: Vec<(Option<Instant>, Option<Instant>)> = known.collect();
        let firsts = known.iter().enumerate().filter_map(|(at, (first, _))| Some((at, (*first)?)));
        let (earliest, first) = firsts.min_by_key(|(_, first)| *first)?;
        let others = known.iter().enumerate().filter(|(at, _)| *at != earliest);
        let until = others.filter_map(|(_, (first, next))| first.or(*next)).min();
        let until = until.unwrap_or(Instant::LATEST);
        (first <= until).then_some((earliest, first, until))
    }
}
