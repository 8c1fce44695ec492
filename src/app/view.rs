//! What the user looks at: the page, the selection and scroll of each list, filters, freezing.
//!
//! Selections hold on to what is selected, not to a row number, and the selected row stays on
//! its line of the screen while others come and go.

use super::capture::IdentifierKey;
use super::devices::{RowKey, SortBy};
use super::evidence::EvidenceView;
use super::groups::ProblemKey;

/// The pages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[allow(missing_docs)]
pub enum Page {
    #[default]
    Devices,
    Traffic,
    Timeline,
    Problems,
}

impl Page {
    /// In the order of their numbers.
    pub const ALL: [Page; 4] = [Page::Devices, Page::Traffic, Page::Timeline, Page::Problems];

    /// Its name.
    pub const fn title(self) -> &'static str {
        match self {
            Page::Devices => "Devices",
            Page::Traffic => "Traffic",
            Page::Timeline => "Timeline",
            Page::Problems => "Problems",
        }
    }

    /// Its number on the keyboard.
    pub const fn number(self) -> usize {
        self as usize + 1
    }
}

/// Which part of the screen has the keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Focus {
    /// The list.
    #[default]
    List,
    /// The details beside it (or in its place, on a narrow screen).
    Details,
}

/// Where a held page ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frozen {
    /// Behind the last frame.
    pub frames: u64,
    /// Behind the last line of the timeline.
    pub lines: u64,
}

/// Which row of a list is selected, and on which line of the screen it is.
#[derive(Clone, Debug)]
pub struct Cursor<K> {
    selected: Option<K>,
    line: usize,
    /// Where it was last: the place to go to when it is gone.
    last: usize,
    /// The user moved it; until then it is the first row, whichever that is.
    moved: bool,
}

impl<K> Default for Cursor<K> {
    fn default() -> Self {
        Self { selected: None, line: 0, last: 0, moved: false }
    }
}

impl<K: Clone + PartialEq> Cursor<K> {
    /// What is selected.
    pub fn selected(&self) -> Option<&K> {
        self.selected.as_ref()
    }

    /// The place of the selected row among `keys`.
    pub fn index<'k>(&self, mut keys: impl Iterator<Item = &'k K>) -> Option<usize>
    where
        K: 'k,
    {
        let selected = self.selected.as_ref()?;
        keys.position(|key| key == selected)
    }

    /// The first row on the screen, where `height` rows of `count` fit.
    pub fn top(&self, index: Option<usize>, count: usize, height: usize) -> usize {
        let line = self.line.min(height.saturating_sub(1));
        index.unwrap_or(0).saturating_sub(line).min(count.saturating_sub(height))
    }

    /// Selects nothing: the list follows its newest row.
    pub fn release(&mut self) {
        self.selected = None;
    }

    /// Selects a row, wherever it is.
    pub fn select(&mut self, key: K) {
        self.selected = Some(key);
        self.moved = true;
    }

    /// The selected row goes on under another key.
    pub fn replace(&mut self, key: K) {
        self.selected = Some(key);
    }

    /// After the rows changed: what is gone gives its place to its neighbour, and where nothing
    /// was selected the first row is.
    pub fn settle(&mut self, keys: &[K], height: usize) {
        if self.moved {
            self.keep(keys, height);
        } else {
            self.place(keys, 0, height);
        }
    }

    /// The same, but what is selected stays so, whether or not the user moved it: it is looked at.
    pub fn keep(&mut self, keys: &[K], height: usize) {
        let index = self.index(keys.iter()).unwrap_or(self.last);
        self.place(keys, index, height);
    }

    /// Moves the selection by `delta` rows.
    pub fn move_by(&mut self, keys: &[K], delta: isize, height: usize) {
        let index = self.index(keys.iter()).unwrap_or(self.last);
        let top = self.top(Some(index), keys.len(), height);
        let target = index.saturating_add_signed(delta).min(keys.len().saturating_sub(1));
        self.line = (index - top.min(index)).saturating_add_signed(delta);
        self.move_to(keys, target, height);
    }

    /// Selects the row at that place.
    pub fn move_to(&mut self, keys: &[K], index: usize, height: usize) {
        self.moved = true;
        self.place(keys, index, height);
    }

    fn place(&mut self, keys: &[K], index: usize, height: usize) {
        let index = index.min(keys.len().saturating_sub(1));
        self.selected = keys.get(index).cloned();
        self.last = index;
        self.line = self.line.min(height.saturating_sub(1)).min(index);
    }

    /// Selects the row on that line of the screen.
    pub fn click(&mut self, keys: &[K], line: usize, height: usize) {
        let top = self.top(self.index(keys.iter()), keys.len(), height);
        if top + line < keys.len() {
            self.line = line;
            self.move_to(keys, top + line, height);
        }
    }
}

/// What the user looks at.
#[derive(Debug, Default)]
pub struct View {
    /// The page that is open.
    pub page: Page,
    /// Which part has the keys.
    pub focus: Focus,
    /// Whether the details of a frame are open.
    pub frame_details: bool,
    /// Traffic was opened from a line of the timeline: that is where one goes back to.
    pub from_timeline: bool,
    /// How far the details are scrolled.
    pub details_scroll: u16,
    /// The rows of the Devices page are sorted by this.
    pub sort: SortBy,
    /// The page is held.
    pub frozen: Option<Frozen>,
    /// Traffic shows a row per identifier.
    pub by_identifier: bool,
    /// Columns and rows of the screen.
    pub size: (u16, u16),
    /// The selected device.
    pub devices: Cursor<RowKey>,
    /// The selected problem.
    pub problems: Cursor<ProblemKey>,
    /// The selected line of the timeline; none: the newest, as they come.
    pub timeline: Cursor<u64>,
    /// The selected identifier.
    pub identifiers: Cursor<IdentifierKey>,
    /// The selected frame; none: the newest, as they come.
    pub traffic: Option<u64>,
    /// On which line of the screen it is.
    pub traffic_line: usize,
    /// Traffic shows the evidence of a problem.
    pub evidence: Option<EvidenceView>,
    pub(super) filters: [String; 4],
}

impl View {
    /// Whether the page has details beside, below or behind its list.
    pub fn has_details(&self) -> bool {
        match self.page {
            Page::Devices | Page::Problems => true,
            Page::Traffic if self.evidence.is_some() => true,
            Page::Traffic => self.frame_details && !self.by_identifier,
            Page::Timeline => false,
        }
    }

    /// Whether Traffic shows a row per identifier: evidence is always frames.
    pub fn shows_identifiers(&self) -> bool {
        self.by_identifier && self.evidence.is_none()
    }

    /// The filter line of a page.
    pub fn filter(&self, page: Page) -> &str {
        &self.filters[page as usize]
    }

    /// Changes the filter line of a page.
    pub fn set_filter(&mut self, page: Page, text: String) {
        self.filters[page as usize] = text;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_selection_stays_on_its_row_and_line() {
        let mut cursor = Cursor::default();
        let mut keys: Vec<u32> = (10..30).collect();
        cursor.settle(&keys, 5);
        cursor.move_by(&keys, 8, 5);
        assert_eq!(cursor.selected(), Some(&18));
        let top = |cursor: &Cursor<u32>, keys: &[u32]| {
            cursor.top(cursor.index(keys.iter()), keys.len(), 5)
        };
        assert_eq!(top(&cursor, &keys), 4);
        keys.insert(0, 1);
        cursor.settle(&keys, 5);
        assert_eq!((cursor.selected(), top(&cursor, &keys)), (Some(&18), 5));
        keys.retain(|key| *key != 18);
        cursor.settle(&keys, 5);
        assert_eq!(cursor.selected(), Some(&19));
        cursor.move_by(&keys, -2, 5);
        assert_eq!((cursor.selected(), top(&cursor, &keys)), (Some(&16), 5));
        cursor.settle(&[], 5);
        assert_eq!(cursor.selected(), None);
    }
}
