//! Frames, by the thousand: each is handled at its own time, with what was due before it.
//!
//! Input: frames in the order of their times. Output: the state that handling them one by one leads to.
//! What is due between two frames is looked up again only after something that may have changed it.
//! Does not know where frames come from.

use super::{App, Page};
use crate::frame::Frame;
use crate::time::Instant;

impl App {
    /// Takes frames, each at its own time, with what is due between two of them. `now` is the present;
    /// an earlier one than that of the last frame is ignored.
    pub fn handle_frames(&mut self, now: Instant, frames: &[Frame]) {
        self.handle_each(frames);
        self.advance_to(now);
        let now = self.clock.set(now);
        self.complete_bus_events(now);
        self.buses.keep_history(now, &self.traffic.capture);
    }

    fn handle_each(&mut self, frames: &[Frame]) {
        let mut timers = None;
        // Events may be as late as this, or of this moment: frames of the same time count in them.
        let (events_until, mut events_at) = (self.clock.now(), None);
        for frame in frames {
            let now = frame.time;
            // It was idle if nothing changes with time; a frame may end that.
            let due = match timers {
                Some(due) if !self.was_idle => due,
                _ => *timers.insert(self.poll_timeout().unwrap_or(Instant::LATEST)),
            };
            if due <= now || self.buses.poll_timeout().is_some_and(|due| due <= now) {
                self.advance_to(now);
                (timers, events_at) = (None, Some(now));
            }
            self.clock.set(now);
            if self.buses.receive(frame) {
                self.learners.handle_frame(frame);
                self.note_for_search(frame);
                self.note_for_prover(frame);
                self.capture_frame(frame);
                if self.buses.has_events() {
                    self.take_events();
                    (timers, events_at) = (None, Some(now));
                }
                if let Some(before) = self.buses.poll_state_change(frame.bus) {
                    self.controller_changed(frame.bus, before);
                }
                self.note_frame_for_sending(frame);
            }
            if self.view.page == Page::Traffic && self.view.frozen.is_none() {
                self.request_redraw();
                timers = None;
            }
            if now <= events_until || events_at == Some(now) {
                self.complete_bus_events(now);
            }
            self.buses.keep_history(now, &self.traffic.capture);
        }
    }
}
