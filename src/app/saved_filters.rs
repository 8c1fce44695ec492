//! Filters that the user saved, each for a page; their list.
//!
//! Bounded: 99 filters. Does not know where they are stored.

use super::filter::{Filter, RowKind};
use super::input::{Overlay, PromptKind};
use super::view::Page;
use super::{App, Effect};
use crate::keymap::{Action, Key, KeyCode};

/// Largest number of saved filters.
pub const MAX_SAVED_FILTERS: usize = 99;

/// A filter of a page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SavedFilter {
    /// The page.
    pub page: Page,
    /// The line.
    pub line: String,
}

/// A change of the saved filters, to be made where they are stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SavedFilterChange {
    /// Appends a filter, unless it is there.
    Add(SavedFilter),
    /// Removes a filter.
    Remove(SavedFilter),
}

impl SavedFilterChange {
    /// Makes the change in a list.
    pub fn apply(&self, filters: &mut Vec<SavedFilter>) {
        match self {
            Self::Add(filter) => {
                if !filters.contains(filter) && filters.len() < MAX_SAVED_FILTERS {
                    filters.push(filter.clone());
                }
            }
            Self::Remove(filter) => filters.retain(|it| it != filter),
        }
    }
}

impl App {
    /// The saved filters of a page, in the order in which they were saved.
    pub fn saved_filters(&self, page: Page) -> Vec<&SavedFilter> {
        self.saved_filters.iter().filter(|filter| filter.page == page).collect()
    }

    /// Takes the saved filters as they are stored, or why they are not.
    pub fn handle_saved_filters(&mut self, result: Result<Vec<SavedFilter>, String>) {
        match result {
            Ok(filters) => self.saved_filters = filters,
            Err(why) => self.show_error(format!("filter not saved: {why}")),
        }
        self.close_empty_filters();
        self.notices.redraw.set_dirty();
    }

    /// Saves the filter that is typed, and sets it.
    pub(super) fn save_typed_filter(&mut self) {
        let Some(prompt) = self.input.prompt() else { return };
        let PromptKind::Filter(filter) = &prompt.kind else { return };
        let (page, line) = (filter.page, prompt.input.value().trim().to_owned());
        match Filter::parse(&line, RowKind::of(page)) {
            Ok(filter) if filter.is_empty() => self.effects.push_back(Effect::Bell),
            Err(_) => self.effects.push_back(Effect::Bell),
            Ok(_) if self.saved_filters.len() >= MAX_SAVED_FILTERS => {
                self.show_error(format!("all {MAX_SAVED_FILTERS} filters are saved; remove one"));
            }
            Ok(_) => {
                self.input.close_prompt();
                self.commit_filter(page, &line);
                let key = self.key_of(Action::Filters);
                self.show_info(format!("filter saved; {key} lists the saved ones"));
                let filter = SavedFilter { page, line };
                self.effects.push_back(Effect::ChangeFilters(SavedFilterChange::Add(filter)));
            }
        }
    }

    /// Opens the list of saved filters.
    pub(super) fn list_filters(&mut self) {
        if self.saved_filters(self.view.page).is_empty() {
            let key = self.key_of(Action::Filter);
            return self.show_error(format!("no saved filter; {key}, then Ctrl-s, saves one"));
        }
        self.input.open(Overlay::Filters(0));
    }

    /// Selects the next saved filter of the list, or with -1 the one before.
    pub(super) fn move_in_filters(&mut self, by: isize) {
        let Overlay::Filters(at) = *self.input.overlay() else { return };
        let last = self.saved_filters(self.view.page).len().saturating_sub(1);
        self.input.open(Overlay::Filters(at.saturating_add_signed(by).min(last)));
    }

    fn selected_filter(&self) -> Option<SavedFilter> {
        let Overlay::Filters(at) = *self.input.overlay() else { return None };
        self.saved_filters(self.view.page).get(at).map(|&filter| filter.clone())
    }

    /// Sets the selected filter.
    pub(super) fn use_filter(&mut self) {
        if let Some(SavedFilter { page, line }) = self.selected_filter() {
            self.input.close();
            self.commit_filter(page, &line);
        }
    }

    /// Removes the selected filter from the saved ones.
    pub(super) fn remove_filter(&mut self) {
        if let Some(filter) = self.selected_filter() {
            self.effects.push_back(Effect::ChangeFilters(SavedFilterChange::Remove(filter)));
        }
    }

    fn close_empty_filters(&mut self) {
        if matches!(self.input.overlay(), Overlay::Filters(_)) {
            if self.saved_filters(self.view.page).is_empty() {
                self.input.close();
            } else {
                self.move_in_filters(0);
            }
        }
    }

    /// Handles a digit in the list of saved filters, which sets one; returns false for other keys.
    pub(super) fn use_filter_of(&mut self, key: Key) -> bool {
        let (Overlay::Filters(_), KeyCode::Char(c)) = (self.input.overlay(), key.code) else {
            return false;
        };
        let place = c.to_digit(10).and_then(|digit| (digit as usize).checked_sub(1));
        let count = self.saved_filters(self.view.page).len();
        let Some(place) = place.filter(|place| *place < count && !key.ctrl && !key.alt) else {
            return false;
        };
        self.input.open(Overlay::Filters(place));
        self.use_filter();
        true
    }
}
