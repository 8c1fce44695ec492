//! The evidence of a problem on the Traffic page: its frames alone, or among all captured ones.
//!
//! Holds the evidence as of the moment when it was opened: it stays while the finding changes and
//! after the capture dropped its frames.

use super::cursor::Selection;
use super::page::Focus;
use crate::app::history::Moment;
use crate::app::problems::{EvidenceItem, ProblemKey};

/// Open evidence.
#[derive(Debug)]
pub struct EvidenceView {
    /// Its problem.
    pub problem: ProblemKey,
    /// Short text of the problem.
    pub title: String,
    /// Stored pieces, oldest first; never empty.
    pub pieces: Vec<EvidenceItem>,
    /// Number of pieces; the first and the last are stored.
    pub count: u64,
    /// Place of the selected piece.
    pub cursor: Selection<usize>,
    /// All captured frames are shown, with the evidence marked.
    pub shows_context: bool,
    /// Selected frame, its line and the focus before.
    pub(super) before: (Option<u64>, usize, Focus),
    /// The moment that a piece has led to, and the one that was shown before; `None`: the present.
    pub(in crate::app) led_to: Option<(Moment, Option<Moment>)>,
}

impl EvidenceView {
    /// Places of the pieces.
    pub fn places(&self) -> Vec<usize> {
        (0..self.pieces.len()).collect()
    }

    /// The selected piece and its place.
    pub fn selected(&self) -> Option<(usize, &EvidenceItem)> {
        let place = *self.cursor.selected()?;
        Some((place, self.pieces.get(place)?))
    }

    /// Returns true if the details had the focus when the evidence was opened.
    pub(in crate::app) fn was_opened_in_details(&self) -> bool {
        self.before.2 == Focus::Details
    }
}
