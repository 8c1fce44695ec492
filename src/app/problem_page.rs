//! Commands of the Problems page: its views, the evidence in the details, the axis of a conflict.
//!
//! Input: actions. Output: changes of the view; the frame of a piece of evidence on Traffic, at its
//! moment. Does not know how the page is drawn.

use super::App;
use super::file::FileError;
use super::problems::{EvidenceItem, Problem, ProblemKey};
use super::view::{Focus, Page, ProblemRoom, ProblemsView};

impl App {
    /// Takes the number of problems that are listed: the list has as many rows, if there is room.
    pub(super) fn note_problem_rows(&mut self, count: usize) {
        /// Lines of the cause why des.json cannot be used, with the one above it.
        const CAUSE: usize = 3;
        let problems = self.files.states().filter_map(|(_, file)| file.problem());
        let lines_of =
            |problem: &FileError| CAUSE + problem.excerpt().into_iter().flatten().count();
        let file: usize = problems.map(lines_of).sum();
        let lines = |count: usize| u16::try_from(count).unwrap_or(u16::MAX);
        let has_conflict =
            self.problems_shown().keys().any(|key| matches!(key, ProblemKey::Address(..)));
        let below = lines(file);
        self.view.problem_room = ProblemRoom { rows: lines(count), below, has_conflict };
        if count == 0 && self.view.page == Page::Problems {
            self.view.focus = Focus::List;
        }
    }

    /// Shows the next view: all problems, open ones, those that are over, muted ones.
    pub(super) fn next_problems_view(&mut self) {
        self.show_problems_as(self.view.problems_view.next());
    }

    fn show_problems_as(&mut self, view: ProblemsView) {
        self.view.problems_view = view;
        self.view.focus_details(false);
        self.settle_problems();
    }

    /// Makes sure that the page lists this problem: the filter is switched off, all are shown.
    pub(super) fn show_in_problems(&mut self, key: &ProblemKey) {
        if !self.problem_keys().contains(key) {
            self.view.problems_view = ProblemsView::All;
        }
        if !self.problem_keys().contains(key) {
            self.filters.set_on(Page::Problems, false);
        }
    }

    // ---- evidence --------------------------------------------------------------------------

    /// Goes from the list to the evidence below it, from there to the frame of the selected piece; of a
    /// problem without evidence to its row on Devices.
    pub(super) fn open_problem(&mut self) {
        let Some(problem) = self.selected_problem() else { return };
        let pieces = problem.evidence();
        match self.view.focus {
            _ if pieces.is_empty() => self.open_evidence(),
            Focus::List => {
                self.view.focus_details(true);
                let is_captured = |piece: &EvidenceItem| {
                    piece.frame.as_ref().is_some_and(|it| self.captured(it).is_some())
                };
                self.view.piece = pieces.iter().position(is_captured).unwrap_or(0);
            }
            Focus::Details => self.open_piece(&pieces),
        }
    }

    /// Shows the frame of the selected piece of evidence among all frames, at its moment. One that has
    /// left the capture is shown with the evidence alone.
    fn open_piece(&mut self, pieces: &[EvidenceItem]) {
        let place = self.view.piece.min(pieces.len() - 1);
        let shown = self.past_moment();
        let frame = pieces[place].frame.and_then(|frame| self.captured(&frame));
        let moment =
            frame.and_then(|number| self.buses.moment_after(&self.traffic.capture, number));
        self.open_evidence();
        let Some(evidence) = &mut self.view.evidence else { return };
        evidence.led_to = moment.map(|moment| (moment, shown));
        let Some(number) = frame else {
            return self.show_error("frame no longer in the capture: its stored copy");
        };
        self.view.select_frame(number, self.list_height());
        self.view.set_around(true);
        match moment {
            Some(moment) => self.go_to(moment),
            None => self.show_error("moment no longer kept"),
        }
    }

    /// Selects another piece of evidence; behind the last one the details scroll.
    pub(super) fn move_in_evidence_table(&mut self, delta: isize) {
        let count = self.selected_problem().map_or(0, |problem| problem.evidence().len());
        let last = count.saturating_sub(1);
        if delta > 0 && self.view.piece < last {
            self.view.piece = self.view.piece.saturating_add_signed(delta).min(last);
        } else if delta < 0 && self.view.details_scroll == 0 {
            self.view.piece = self.view.piece.min(last).saturating_add_signed(delta);
        } else {
            self.view.scroll_details(delta);
        }
    }

    // ---- the axis --------------------------------------------------------------------------

    /// Returns true if Left and Right move the axis: the details of a conflict have the focus.
    pub(super) fn moves_conflict_axis(&self) -> bool {
        self.view.page == Page::Problems
            && self.view.focus == Focus::Details
            && self.screen().details.height > 0
            && self.selected_problem().is_some_and(|problem| problem.is_address_conflict())
    }

    /// Moves the axis of the selected conflict by steps.
    pub(super) fn move_conflict_axis(&mut self, steps: i64) {
        if let Some(key) = self.selected_problem().map(|problem| problem.key) {
            self.view.conflict_axis.move_by(&key, steps);
        }
    }

    /// Shows more of the time on the axis of the selected conflict, or with 1 more detail.
    pub(super) fn zoom_conflict_axis(&mut self, by: isize) {
        let problem = self.selected_problem().filter(|_| self.view.page == Page::Problems);
        let Some(key) = problem.filter(Problem::is_address_conflict).map(|it| it.key) else {
            return self.zoom_time_bar(-by);
        };
        if self.view.conflict_axis.zoom(&key, by) {
            self.show_info(format!("{} ms a cell", self.view.conflict_axis.cell_millis()));
        } else {
            self.show_error("no other scale");
        }
    }
}
