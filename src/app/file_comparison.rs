//! When des.json is compared with the buses: at the events of the buses and when a bus was listened to
//! long enough, whatever the pace of a log and however rarely the screen is drawn.
//!
//! Input: the moments of events. Output: the moments of comparisons. Does not know what is compared.

use super::App;
use super::buses::Bus;
use crate::time::{Duration, Instant};

/// Least time between two comparisons of des.json with the buses. Chosen: not noticed, and events that
/// belong together are compared once.
const COMPARISON_INTERVAL: Duration = Duration::from_millis(200);

/// When des.json is compared with the buses.
#[derive(Debug, Default)]
pub(super) struct FileComparison {
    /// After an event.
    due: Option<Instant>,
    /// The last one that was due.
    last: Option<Instant>,
    /// The end of listening was looked for until then.
    listened_until: Instant,
    /// Enumeration rounds that were over at the last look: after two of them devices may be missing.
    rounds: u64,
}

impl FileComparison {
    /// Takes an event: the comparison is due at once, or some time after the last one.
    fn request(&mut self, now: Instant) {
        let earliest = self.last.map_or(now, |last| last + COMPARISON_INTERVAL);
        self.due.get_or_insert(earliest.max(now));
    }

    /// Notes a comparison, whatever the reason for it was.
    pub fn note_comparison(&mut self, now: Instant) {
        self.listened_until = self.listened_until.max(now);
    }

    /// Returns true if a comparison waits for its time.
    fn waits(&self, now: Instant) -> bool {
        self.due.is_some_and(|due| due > now)
    }
}

impl App {
    /// Requests a comparison after an event of a bus.
    pub(super) fn compare_file_soon(&mut self) {
        if self.view.has_screen && self.files.are_any_there() {
            self.file_comparison.request(self.clock.now());
        }
    }

    /// Requests a comparison if an enumeration round ended: the engine emits no event then.
    pub(super) fn compare_file_after_round(&mut self) {
        let rounds = self.buses.iter().map(|bus| u64::from(bus.finished_rounds())).sum();
        if std::mem::replace(&mut self.file_comparison.rounds, rounds) != rounds {
            self.compare_file_soon();
            if !self.view.has_screen {
                self.refresh_before_draw();
            }
        }
    }

    /// When des.json is compared with the buses: after an event, or when listening ends and devices may
    /// be missing.
    pub(super) fn file_comparison_due(&self) -> Option<Instant> {
        let listened = self.buses.iter().filter_map(Bus::listened_at);
        let ends = listened.filter(|at| *at > self.file_comparison.listened_until).min();
        let ends = ends.filter(|_| self.files.are_any_there());
        self.file_comparison.due.into_iter().chain(ends).min()
    }

    /// Compares des.json with the buses at each moment until `now` at which that is due, as far as the
    /// timers of the buses before it have run.
    pub(super) fn compare_file_until(&mut self, now: Instant) {
        while let Some(due) = self.file_comparison_due().filter(|due| *due <= now)
            && self.buses.poll_timeout().is_none_or(|timer| timer >= due)
        {
            let at = self.clock.set(due);
            self.file_comparison.due = None;
            self.file_comparison.last = Some(at);
            self.refresh_problems();
            self.notices.redraw.set_stale();
            self.request_redraw();
        }
    }

    /// Compares des.json with the buses before a draw, unless that is due at a later time: what a log
    /// shows does not depend on the moments at which it was drawn. At its end nothing is waited for.
    pub(super) fn compare_file_for_draw(&mut self) {
        let goes_on = self.clock.playback().is_some_and(|it| !it.is_ended);
        if goes_on && self.file_comparison.waits(self.clock.now()) {
            self.problems.assign(&self.buses, self.files.documents());
        } else {
            self.refresh_problems();
        }
    }
}
