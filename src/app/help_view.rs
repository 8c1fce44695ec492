//! The help that is open: the page whose keys come first, and the words that its lines must have.
//!
//! Inputs: keys. Bounded: 64 characters. Does not know the text of the help.

use super::input::Overlay;
use super::view::Page;
use super::{App, Effect};
use crate::keymap::{Key, KeyCode};

/// Most characters of the words.
const MAX_SEARCH: usize = 64;

/// State of the help.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HelpView {
    /// Page whose keys come first.
    pub page: Page,
    /// Words that each line must have; empty for all lines.
    pub search: String,
    /// The words are being typed.
    pub is_typing: bool,
}

impl App {
    /// State of the help.
    pub fn help(&self) -> &HelpView {
        &self.help
    }

    /// Opens the help of the open page.
    pub(super) fn open_help(&mut self) {
        self.help = HelpView { page: self.view.page, ..HelpView::default() };
        self.input.open(Overlay::Help(0));
    }

    /// Shows the keys of the next page first.
    pub(super) fn next_help_page(&mut self) {
        let at = (self.help.page as usize + 1) % Page::ALL.len();
        self.help.page = Page::ALL[at];
        self.input.open(Overlay::Help(0));
    }

    /// Begins to type the words.
    pub(super) fn type_help_search(&mut self) {
        self.help.is_typing = true;
        self.input.open(Overlay::Help(0));
    }

    /// Shows all lines again, or closes the help.
    pub(super) fn close_help(&mut self) {
        if self.help.search.is_empty() {
            self.input.close();
        } else {
            self.help.search.clear();
            self.input.open(Overlay::Help(0));
        }
    }

    /// Takes a key while the words are typed; returns false for all others.
    pub(super) fn type_in_help(&mut self, key: Key) -> bool {
        let is_open = matches!(self.input.overlay(), Overlay::Help(_));
        if !is_open || !self.help.is_typing || self.input.lookup_global(key).is_some() {
            return false;
        }
        let search = &mut self.help.search;
        match key.code {
            KeyCode::Enter => self.help.is_typing = false,
            KeyCode::Esc => {
                search.clear();
                self.help.is_typing = false;
            }
            KeyCode::Backspace => drop(search.pop()),
            KeyCode::Char('u') if key.ctrl => search.clear(),
            KeyCode::Char(c) if !key.ctrl && !key.alt && search.chars().count() < MAX_SEARCH => {
                search.push(c);
            }
            _ => self.effects.push_back(Effect::Bell),
        }
        self.input.open(Overlay::Help(0));
        true
    }
}
