//! When des.json and the project are compared with the buses: after events of the buses, and when time alone
//! changes the result. The differences of a log have these times, whatever its pace and however rarely the
//! screen is drawn.
//!
//! Input: the moments of events. Output: comparisons, in the order of the timers of the buses.

use super::App;
use crate::time::{Duration, Instant};
use std::mem;

/// Least time between two comparisons after events. Chosen: not noticed, and events that belong together are
/// compared once.
const COMPARISON_INTERVAL: Duration = Duration::from_millis(200);

/// When des.json and the project are compared with the buses.
#[derive(Debug, Default)]
pub(super) struct FileComparison {
    /// After an event.
    due: Option<Instant>,
    /// The last one after an event.
    last: Option<Instant>,
    /// The last one for any reason.
    compared_at: Instant,
    /// When time alone makes the state of a device of the project certain.
    task_due: Option<Instant>,
    /// Enumeration rounds that were over at the last look, and engines that were suspended: after two rounds
    /// devices may be missing, and while an engine is suspended no time passes for them.
    rounds: u64,
    suspended: usize,
}

impl FileComparison {
    /// Takes an event of that time: the comparison is due at once, or some time after the last one.
    fn request(&mut self, at: Instant) {
        let earliest = self.last.map_or(at, |last| last + COMPARISON_INTERVAL);
        self.due.get_or_insert(earliest.max(at));
    }

    /// Notes a comparison, whatever the reason for it was; one that waits for its time stays due. `task_due`:
    /// when time alone changes the next state of a task.
    pub fn note_comparison(&mut self, at: Instant, task_due: Option<Instant>) {
        self.compared_at = self.compared_at.max(at);
        self.task_due = task_due;
    }
}

impl App {
    /// Requests a comparison after an event of a bus at that time.
    pub(super) fn compare_file_soon(&mut self, at: Instant) {
        if self.view.has_screen {
            self.file_comparison.request(at);
        }
    }

    /// Requests a comparison if an enumeration round ended or an engine resumed: they emit no event then.
    pub(super) fn compare_file_after_timers(&mut self) {
        let rounds = self.buses.iter().map(|bus| u64::from(bus.finished_rounds())).sum();
        let suspended = self.buses.iter().filter(|bus| bus.is_suspended()).count();
        let is_new_round = mem::replace(&mut self.file_comparison.rounds, rounds) != rounds;
        let were_suspended = mem::replace(&mut self.file_comparison.suspended, suspended);
        if is_new_round || suspended < were_suspended {
            self.compare_file_soon(self.clock.now());
            if !self.view.has_screen {
                self.refresh_before_draw();
            }
        }
    }

    /// When des.json is compared with the buses: after an event, when listening ends and devices may be
    /// missing, or when a device of the project has failed for long enough.
    pub(super) fn file_comparison_due(&self) -> Option<Instant> {
        let now = self.clock.now();
        let listened = self.buses.iter().filter_map(|bus| bus.listened_at(now));
        let times = listened.chain(self.file_comparison.task_due);
        let next = times.filter(|at| *at > self.file_comparison.compared_at).min();
        self.file_comparison.due.into_iter().chain(next).min()
    }

    /// Compares des.json with the buses at each moment until `now` at which that is due, as far as the
    /// timers of the buses before it have run. The clock may be ahead of a log.
    pub(super) fn compare_file_until(&mut self, now: Instant) {
        while let Some(due) = self.file_comparison_due().filter(|due| *due <= now)
            && self.buses.poll_timeout().is_none_or(|timer| timer >= due)
        {
            self.clock.set(due);
            let at = due.max(self.file_comparison.compared_at);
            self.file_comparison.due = None;
            self.file_comparison.last = Some(due);
            self.refresh_problems_at(at);
            self.notices.redraw.set_stale();
            self.request_redraw();
        }
    }

    /// Compares des.json with the buses before a draw. In a log that only renews texts, such as `5 s ago`: what
    /// it shows does not depend on the moments at which it was drawn. At its end nothing is waited for.
    pub(super) fn compare_file_for_draw(&mut self) {
        if self.clock.playback().is_some_and(|it| !it.is_ended) {
            self.problems.renew_texts(&self.buses, self.files.documents(), self.clock.now());
        } else {
            self.refresh_problems();
        }
    }
}
