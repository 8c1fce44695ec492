//! The filter of each page, whether it is on, and the lines that were typed before.
//!
//! Bounded: 100 lines of history. Does not know the rows.

use super::filter::{Filter, FilterError, RowKind};
use super::view::Page;
use super::wall_clock::WallClock;
use crate::time::Instant;

/// Most lines of history.
const MAX_HISTORY: usize = 100;

/// Filter of a page.
#[derive(Clone, Debug, Default)]
pub struct PageFilter {
    text: String,
    filter: Filter,
    is_off: bool,
}

impl PageFilter {
    /// The line, on or off; empty without a filter.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The filter, on or off.
    pub fn filter(&self) -> &Filter {
        &self.filter
    }

    /// Returns true if rows that do not match are hidden.
    pub fn is_on(&self) -> bool {
        !self.filter.is_empty() && !self.is_off
    }

    /// The filter, if rows that do not match are hidden.
    pub fn active(&self) -> Option<&Filter> {
        self.is_on().then_some(&self.filter)
    }
}

/// Filters of all pages.
#[derive(Debug, Default)]
pub(super) struct PageFilters {
    pages: [PageFilter; Page::ALL.len()],
    /// Oldest first.
    history: Vec<String>,
}

impl PageFilters {
    /// The filter of a page.
    pub fn of(&self, page: Page) -> &PageFilter {
        &self.pages[page as usize]
    }

    /// Sets the filter of a page and switches it on.
    ///
    /// # Errors
    /// The line has a mistake; the filter stays as it was.
    pub fn set(
        &mut self,
        page: Page,
        text: &str,
        clock: &WallClock,
        now: Instant,
    ) -> Result<(), FilterError> {
        let mut filter = Filter::parse(text, RowKind::of(page))?;
        filter.resolve(clock, Some(now));
        self.pages[page as usize] = PageFilter { text: text.to_owned(), filter, is_off: false };
        Ok(())
    }

    /// Replaces the filter of a page by one that it had.
    pub fn restore(&mut self, page: Page, filter: PageFilter) {
        self.pages[page as usize] = filter;
    }

    /// Clears the filter of a page.
    pub fn clear(&mut self, page: Page) {
        self.restore(page, PageFilter::default());
    }

    /// Switches the filter of a page on or off.
    pub fn set_on(&mut self, page: Page, is_on: bool) {
        self.pages[page as usize].is_off = !is_on;
    }

    /// Appends a line to the history; a line that is in it moves to its end.
    pub fn remember(&mut self, text: &str) {
        let text = text.trim();
        if text.is_empty() {
            return;
        }
        self.history.retain(|line| line != text);
        self.history.push(text.to_owned());
        if self.history.len() > MAX_HISTORY {
            self.history.remove(0);
        }
    }

    /// The lines that were typed before, oldest first.
    pub fn history(&self) -> &[String] {
        &self.history
    }
}
