//! The views of the Problems page: which problems it lists, the selected piece of evidence, and the
//! time axis of the conflict panel.

use crate::app::problems::{Problem, ProblemKey};
use crate::finding::FindingState;

/// Cells of the axis that a step moves it by.
const AXIS_STEP: i64 = 5;

/// Room that the list wants above the details.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProblemRoom {
    /// Rows.
    pub rows: u16,
    /// Lines below them.
    pub below: u16,
    /// The details of a conflict need most of the page.
    pub has_conflict: bool,
}

/// Which problems the page lists.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ProblemsView {
    /// All: open ones first, then those that are over, then muted ones.
    #[default]
    All,
    /// Those that count.
    Open,
    /// Those that are cleared.
    Over,
    /// Those that the user muted.
    Muted,
}

impl ProblemsView {
    /// All views.
    pub const ALL: [Self; 4] = [Self::All, Self::Open, Self::Over, Self::Muted];

    /// Name in the page rule.
    pub const fn title(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Open => "open",
            Self::Over => "over",
            Self::Muted => "muted",
        }
    }

    /// The next view.
    #[must_use]
    pub const fn next(self) -> Self {
        match self {
            Self::All => Self::Open,
            Self::Open => Self::Over,
            Self::Over => Self::Muted,
            Self::Muted => Self::All,
        }
    }

    /// Returns true if the view lists this problem.
    pub fn lists(self, problem: &Problem) -> bool {
        match self {
            Self::All => true,
            Self::Open => problem.is_open(),
            Self::Over => !problem.is_muted && problem.state() == FindingState::Cleared,
            Self::Muted => problem.is_muted,
        }
    }
}

/// Time axis of the conflict panel: scale, and how far it was moved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConflictAxis {
    zoom: usize,
    /// The problem for which it was moved, and the cells by which it was.
    moved: Option<(ProblemKey, i64)>,
}

impl Default for ConflictAxis {
    fn default() -> Self {
        Self { zoom: Self::USUAL, moved: None }
    }
}

impl ConflictAxis {
    /// Time of a cell in milliseconds, from the closest scale to the widest. Wider ones would show the
    /// heartbeats of a second in one cell.
    const CELL_MILLIS: [u32; 4] = [20, 50, 100, 200];
    /// Place of the scale that is used first.
    const USUAL: usize = 2;

    /// Time of a cell, in milliseconds.
    pub fn cell_millis(&self) -> u32 {
        Self::CELL_MILLIS[self.zoom]
    }

    /// Cells by which the axis of a problem is moved, later ones positive.
    pub fn shift(&self, problem: &ProblemKey) -> i64 {
        self.moved.as_ref().filter(|(moved, _)| moved == problem).map_or(0, |(_, shift)| *shift)
    }

    /// Moves the axis of a problem by steps.
    pub(in crate::app) fn move_by(&mut self, problem: &ProblemKey, steps: i64) {
        let shift = self.shift(problem).saturating_add(steps * AXIS_STEP);
        self.moved = Some((problem.clone(), shift));
    }

    /// Shows more of the time, or with 1 more detail. Returns false at the last scale.
    pub(in crate::app) fn zoom(&mut self, problem: &ProblemKey, by: isize) -> bool {
        let zoom = self.zoom.saturating_add_signed(-by);
        if zoom >= Self::CELL_MILLIS.len() || zoom == self.zoom {
            return false;
        }
        let (old, new) = (Self::CELL_MILLIS[self.zoom], Self::CELL_MILLIS[zoom]);
        let shift = self.shift(problem) * i64::from(old) / i64::from(new);
        (self.zoom, self.moved) = (zoom, Some((problem.clone(), shift)));
        true
    }
}
