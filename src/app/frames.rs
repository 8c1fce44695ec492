//! Frames, by the thousand: each is handled at its own time, with what was due before it.
//!
//! Input: frames in the order of their times. Output: the state that handling them one by one leads to.
//! What is due between two frames is looked up again only after something that may have changed it.
//! Does not know where frames come from.

use super::buses::Bus;
use super::{App, Page};
use crate::frame::Frame;
use crate::time::{Duration, Instant};

/// Time from an event to the comparison of des.json with the buses. Chosen: not noticed, and events
/// that belong together are compared once.
const COMPARISON_DELAY: Duration = Duration::from_millis(200);

impl App {
    /// Takes frames, each at its own time, with what is due between two of them. `now` is the present;
    /// an earlier one than that of the last frame is ignored.
    pub fn handle_frames(&mut self, now: Instant, frames: &[Frame]) {
        self.handle_each(frames);
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
            self.compare_file_by(now);
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

    /// Compares the file with the buses some time after an event: a log that is read fast is not drawn
    /// between two events, and its differences have their times whatever its speed is.
    pub(super) fn compare_file_soon(&mut self) {
        if self.view.has_screen && self.is_of_logs() && self.files.are_any_there() {
            self.file_comparison_due.get_or_insert(self.clock.now() + COMPARISON_DELAY);
        }
    }

    /// Compares the file with the buses if that is due before a frame.
    fn compare_file_by(&mut self, next: Instant) {
        // From then on devices may be missing.
        let from = self.clock.now();
        let listened = self.buses.iter().filter_map(Bus::listened_at);
        if let Some(due) = listened.filter(|due| (from..=next).contains(due)).min()
            && self.view.has_screen
            && self.is_of_logs()
            && self.files.are_any_there()
        {
            let earlier = self.file_comparison_due.filter(|it| *it < due);
            self.file_comparison_due = earlier.or(Some(due));
        }
        if let Some(due) = self.file_comparison_due.take_if(|due| *due <= next) {
            self.clock.set(due);
            self.refresh_problems();
        }
    }
}
