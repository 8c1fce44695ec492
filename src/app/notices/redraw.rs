//! When the screen is to be drawn, and when devices and file are to be compared again.
//!
//! A key is drawn at once; what the bus changes at most every 250 ms.

use crate::time::{Duration, Instant};

/// Least time between two redraws that only the bus caused.
pub(in crate::app) const BUS_REDRAW_INTERVAL: Duration = Duration::from_millis(250);

/// Redraw state.
#[derive(Debug)]
pub(in crate::app) struct Redraw {
    /// The screen is out of date.
    dirty: bool,
    /// The moment from which the screen counts as out of date.
    due: Option<Instant>,
    last_drawn: Instant,
    /// An engine reported something since rows and problems were made.
    stale: bool,
}

impl Redraw {
    /// Returns a state in which nothing was drawn yet.
    pub fn new(now: Instant) -> Self {
        Self { dirty: true, due: None, last_drawn: now, stale: false }
    }

    /// Returns true if the screen is out of date.
    pub fn is_dirty(&self) -> bool {
        self.dirty
    }

    /// Marks the screen as out of date.
    pub fn set_dirty(&mut self) {
        self.dirty = true;
    }

    /// Returns true if the screen is out of date, and counts it as drawn.
    pub fn take_dirty(&mut self, now: Instant) -> bool {
        let dirty = std::mem::take(&mut self.dirty);
        if dirty {
            self.due = None;
            self.last_drawn = now;
        }
        dirty
    }

    /// Requests a redraw `interval` after the last one at the earliest.
    pub fn request(&mut self, now: Instant, interval: Duration) {
        if self.due.is_none() {
            self.due = Some((self.last_drawn + interval).max(now));
        }
    }

    /// Marks the screen as out of date once a requested redraw is due.
    pub fn check_due(&mut self, now: Instant) {
        self.dirty |= self.due.is_some_and(|at| at <= now);
    }

    /// Marks rows and problems as out of date.
    pub fn set_stale(&mut self) {
        self.stale = true;
    }

    /// Returns true if rows and problems are out of date, and counts them as renewed.
    pub fn take_stale(&mut self) -> bool {
        std::mem::take(&mut self.stale)
    }

    /// The moment at which a requested redraw is due.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.due.filter(|_| !self.dirty)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bus_redraws_keep_their_interval() {
        let at = |millis| Instant::ZERO + Duration::from_millis(millis);
        let mut redraw = Redraw::new(at(0));
        assert!(redraw.take_dirty(at(0)) && !redraw.take_dirty(at(0)));
        redraw.request(at(10), BUS_REDRAW_INTERVAL);
        redraw.request(at(20), Duration::ZERO);
        assert_eq!(redraw.poll_timeout(), Some(at(250)));
        redraw.check_due(at(249));
        assert!(!redraw.is_dirty());
        redraw.check_due(at(250));
        assert!(redraw.take_dirty(at(250)));
        redraw.request(at(900), BUS_REDRAW_INTERVAL);
        assert_eq!(redraw.poll_timeout(), Some(at(900)));
    }
}
