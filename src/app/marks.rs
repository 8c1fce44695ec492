//! Moments that the user marked, each with a letter and a text; their list.
//!
//! Bounded: one for each letter, [`MAX_MARKS`]. A mark is a line of the timeline, too. Does not know
//! how marks are drawn.

use super::history::Moment;
use super::input::{MarkPrompt, Overlay, PromptKind, mark_bit};
use super::notices::TimelineEntry;
use super::timeline_kind::TimelineKind;
use super::{App, clock_millis};
use crate::keymap::{Action, Key, KeyCode};

/// Largest number of marks: the letters from a to z.
pub const MAX_MARKS: usize = 26;

/// A moment that the user marked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mark {
    /// Letter, from a to z.
    pub letter: char,
    /// The moment.
    pub moment: Moment,
    /// Text of the user; may be empty.
    pub text: String,
}

/// The marks, in the order in which they were set.
#[derive(Clone, Debug, Default)]
pub struct Marks(Vec<Mark>);

impl Marks {
    /// The marks by letter.
    pub fn by_letter(&self) -> Vec<&Mark> {
        let mut marks: Vec<&Mark> = self.0.iter().collect();
        marks.sort_by_key(|mark| mark.letter);
        marks
    }

    /// The mark with this letter.
    pub fn get(&self, letter: char) -> Option<&Mark> {
        self.0.iter().find(|mark| mark.letter == letter)
    }

    /// The mark at this moment.
    pub fn at(&self, moment: Moment) -> Option<&Mark> {
        self.0.iter().rfind(|mark| mark.moment == moment)
    }

    /// The mark that was set last of those before a moment.
    pub fn last_before(&self, moment: Moment) -> Option<&Mark> {
        let is_before = |mark: &&Mark| {
            let at = mark.moment;
            (at.time, at.frames) < (moment.time, moment.frames)
        };
        self.0.iter().rev().find(is_before)
    }

    /// The first letter without a mark; `None` if all have one.
    fn next_letter(&self) -> Option<char> {
        ('a'..='z').find(|letter| self.get(*letter).is_none())
    }

    /// The letters of the marks, a bit for each.
    pub(super) fn bits(&self) -> u32 {
        self.0.iter().fold(0, |bits, mark| bits | mark_bit(mark.letter))
    }
}

impl App {
    /// The marks.
    pub fn marks(&self) -> &Marks {
        &self.marks
    }

    /// Opens the prompt for the text of the next mark, at the moment that is shown.
    pub(super) fn ask_mark(&mut self) {
        let Some(letter) = self.marks.next_letter() else {
            let key = self.key_of(Action::Marks);
            return self.show_error(format!("all {MAX_MARKS} marks are set; remove one: {key}"));
        };
        let present = || self.buses.present(self.clock.now());
        let moment = self.past_moment().unwrap_or_else(present);
        self.open_prompt(PromptKind::Mark(MarkPrompt { letter, moment }), String::new());
    }

    /// Sets the next mark.
    pub(super) fn set_mark(&mut self, moment: Moment, text: &str) {
        let Some(letter) = self.marks.next_letter() else { return };
        let shown = if text.is_empty() { "moment marked" } else { text };
        let mut line = TimelineEntry::new(moment.time, TimelineKind::Mark(letter), shown);
        line.name = Some("mark".into());
        self.notices.insert_line(line);
        self.marks.0.push(Mark { letter, moment, text: text.to_owned() });
        self.renew_time_bar();
        let at = clock_millis(self, moment.time);
        let (list, compare) = (self.key_of(Action::Marks), self.key_of(Action::Compare));
        self.show_info(format!("mark {letter} at {at}; {list} lists, {compare} compares with it"));
    }

    /// Opens the list of marks, with the last one selected.
    pub(super) fn list_marks(&mut self) {
        if let Some(mark) = self.marks.0.last() {
            self.input.open(Overlay::Marks(mark.letter));
        } else {
            let key = self.key_of(Action::Mark);
            self.show_error(format!("no marks yet; {key} marks the moment that is shown"));
        }
    }

    /// Selects the mark whose letter was typed into the list of marks; returns false for another key.
    pub(super) fn select_mark_of(&mut self, key: Key) -> bool {
        if self.input.selected_mark().is_none() || key.ctrl || key.alt {
            return false;
        }
        let letter = |key: Key| match key.code {
            KeyCode::Char(c) => Some(c).filter(|&c| self.marks.get(c).is_some()),
            _ => None,
        };
        let Some(letter) = letter(key).or_else(|| letter(key.on_latin_keyboard()?)) else {
            return false;
        };
        self.input.open(Overlay::Marks(letter));
        true
    }

    /// Selects the mark before or after the selected one in the list.
    pub(super) fn move_in_marks(&mut self, by: isize) {
        let Some(selected) = self.input.selected_mark() else { return };
        let marks = self.marks.by_letter();
        let at = marks.iter().position(|mark| mark.letter == selected).unwrap_or_default();
        let at = at.saturating_add_signed(by).min(marks.len().saturating_sub(1));
        if let Some(letter) = marks.get(at).map(|mark| mark.letter) {
            self.input.open(Overlay::Marks(letter));
        }
    }

    /// Shows the moment of the selected mark.
    pub(super) fn go_to_selected_mark(&mut self) {
        let mark = self.input.selected_mark().and_then(|letter| self.marks.get(letter));
        let moment = mark.map(|mark| mark.moment);
        self.input.close();
        if let Some(moment) = moment {
            self.go_to(moment);
        }
    }

    /// Removes the selected mark and its line of the timeline.
    pub(super) fn remove_selected_mark(&mut self) {
        let Some(letter) = self.input.selected_mark() else { return };
        self.marks.0.retain(|mark| mark.letter != letter);
        self.notices.remove_mark(letter);
        self.renew_time_bar();
        let marks = self.marks.by_letter();
        let next = marks.iter().find(|mark| mark.letter > letter).or(marks.last());
        match next.map(|mark| mark.letter) {
            Some(next) => self.input.open(Overlay::Marks(next)),
            None => {
                self.input.close();
            }
        }
        self.show_info(format!("mark {letter} removed"));
    }
}
