//! What the user looks at: the page, the selection and scroll of each list, filters, freezing.

use super::capture::IdentifierKey;
use super::cursor::Cursor;
use super::evidence::EvidenceView;
use super::page::{Focus, Frozen, Page};
use super::problem_groups::ProblemKey;
use super::rows::{RowKey, SortBy};

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
