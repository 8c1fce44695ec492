//! The evidence of a problem on the page Traffic: its frames alone, or among all others.
//!
//! What is shown is what the findings kept when it was opened: it stays while the finding goes on
//! or is over, and when the capture has long forgotten the frames. Leaving gives the page back as
//! it was.

use super::cursor::Cursor;
use super::page::{Focus, Page};
use super::{App, EvidenceItem, ProblemKey};
use crate::discovery::FindingKind;
use crate::frame::Frame;
use crate::keymap::Action;

/// The evidence that is open.
#[derive(Debug)]
pub struct EvidenceView {
    /// Of which problem.
    pub problem: ProblemKey,
    /// What the problem is, in words.
    pub title: String,
    /// Oldest first; never empty.
    pub pieces: Vec<EvidenceItem>,
    /// How many pieces there were; the first and the last are kept.
    pub count: u64,
    /// The place of the selected piece.
    pub cursor: Cursor<usize>,
    /// All captured frames are shown, with the evidence marked among them.
    pub around: bool,
    /// What was selected in the traffic before, on which line, and what had the keys.
    before: (Option<u64>, usize, Focus),
}

impl EvidenceView {
    /// The places of the pieces.
    pub fn places(&self) -> Vec<usize> {
        (0..self.pieces.len()).collect()
    }

    /// The selected piece and its place.
    pub fn selected(&self) -> Option<(usize, &EvidenceItem)> {
        let place = *self.cursor.selected()?;
        Some((place, self.pieces.get(place)?))
    }
}

impl App {
    /// The number under which the capture still holds a frame.
    pub fn captured(&self, frame: &Frame) -> Option<u64> {
        /// Frames of several buses may be a little out of order.
        const NEAR: u64 = 64;
        let at = self.capture.at_time(frame.time);
        let near = |number: &u64| self.capture.get(*number) == Some(frame);
        (at..self.capture.end())
            .take_while(|&number| {
                number < at + NEAR
                    || self.capture.get(number).is_some_and(|it| it.time == frame.time)
            })
            .find(near)
            .or_else(|| (at.saturating_sub(NEAR)..at).find(near))
    }

    /// The evidence that is open, where only its own frames are shown.
    pub fn evidence_alone(&self) -> Option<&EvidenceView> {
        self.view.evidence.as_ref().filter(|evidence| !evidence.around)
    }

    /// The piece of the open evidence that a captured frame is.
    pub fn piece_of(&self, frame: &Frame) -> Option<&EvidenceItem> {
        let pieces = &self.view.evidence.as_ref()?.pieces;
        pieces.iter().find(|piece| piece.frame.as_ref() == Some(frame))
    }

    /// The frame that is selected on the page Traffic.
    pub fn selected_frame(&self) -> Option<&Frame> {
        match self.evidence_alone() {
            Some(evidence) => evidence.selected()?.1.frame.as_ref(),
            None => self.capture.get(self.view.traffic?),
        }
    }

    /// Goes to the frames that prove the selected problem; where it comes from des.json, to the row
    /// that it is about.
    pub(super) fn open_evidence(&mut self) {
        let Some(problem) = self.selected_problem() else { return };
        let (key, title) = (problem.key.clone(), problem.title());
        let (kind, pieces, count) = (problem.head().key.kind, problem.evidence(), problem.count());
        if pieces.is_empty() {
            if kind == FindingKind::FramesLost {
                return self.show_error("lost frames cannot be shown");
            }
            // It comes from des.json: its row is what there is to see.
            self.find_row("no frames: this concerns the file as a whole");
            return;
        }
        // What is left again is this one, whichever is the first meanwhile.
        self.view.problems.select(key.clone());
        let before = (self.view.traffic, self.view.traffic_line, self.view.focus);
        let held = |piece: &EvidenceItem| {
            piece.frame.as_ref().is_some_and(|it| self.captured(it).is_some())
        };
        let first = pieces.iter().position(held).unwrap_or(0);
        let mut cursor = Cursor::default();
        cursor.select(first);
        self.show_page(Page::Traffic);
        self.view.evidence = Some(EvidenceView {
            problem: key,
            title,
            pieces,
            count,
            cursor,
            around: false,
            before,
        });
        self.move_in_evidence(0);
    }

    /// Only the evidence, or everything around the selected piece of it.
    pub(super) fn toggle_around(&mut self) {
        let Some(evidence) = &self.view.evidence else { return };
        if evidence.around {
            // Where another piece was gone to meanwhile, that one is selected now.
            let pieces = evidence.pieces.iter().map(|piece| piece.frame.as_ref());
            let selected = self.selected_frame();
            let place =
                selected.and_then(|frame| pieces.into_iter().position(|it| it == Some(frame)));
            if let (Some(evidence), Some(place)) = (&mut self.view.evidence, place) {
                evidence.cursor.select(place);
            }
            return self.set_around(false);
        }
        let Some((_, piece)) = evidence.selected() else { return };
        let number = match &piece.frame {
            Some(frame) => self.captured(frame),
            None => Some(self.capture.at_time(piece.time))
                .filter(|&number| number > self.capture.first() && number < self.capture.end()),
        };
        let Some(number) = number else {
            return self.show_error("surrounding frames no longer in the capture");
        };
        if number >= self.traffic_end() {
            let key = self.key_of(Action::Freeze);
            return self.show_error(format!("newer than the frozen view: {key} unfreezes"));
        }
        self.view.traffic = Some(number);
        self.view.traffic_line = self.screen().list_rows() / 2;
        self.set_around(true);
    }

    fn set_around(&mut self, around: bool) {
        self.view.details_scroll = 0;
        self.view.focus = Focus::List;
        if let Some(evidence) = &mut self.view.evidence {
            evidence.around = around;
        }
    }

    /// A step back: from the frames around to the evidence, from there to the problem. Whether
    /// there was anything to leave.
    pub(super) fn leave_evidence(&mut self) -> bool {
        match &self.view.evidence {
            None => return false,
            Some(evidence) if evidence.around => self.set_around(false),
            Some(evidence) => {
                let (_, _, focus) = evidence.before;
                self.show_page(Page::Problems);
                self.focus_details(focus == Focus::Details);
            }
        }
        true
    }

    /// The page Traffic is again what it was before.
    pub(super) fn close_evidence(&mut self) {
        if let Some(evidence) = self.view.evidence.take() {
            (self.view.traffic, self.view.traffic_line, _) = evidence.before;
        }
    }

    pub(super) fn move_in_evidence(&mut self, delta: isize) {
        let height = self.screen().list_rows();
        if let Some(evidence) = &mut self.view.evidence {
            let places = evidence.places();
            evidence.cursor.move_by(&places, delta, height);
        }
    }

    pub(super) fn click_evidence(&mut self, line: usize) {
        let height = self.screen().list_rows();
        if let Some(evidence) = &mut self.view.evidence {
            let places = evidence.places();
            evidence.cursor.click(&places, line, height);
        }
    }
}
