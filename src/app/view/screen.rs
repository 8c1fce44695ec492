//! Layout of the screen, for drawing and for the mouse.
//!
//! ```text
//!  can0 125k active  load   7% ⣶⣾⣿⣿ 5–8%  err 0  lost 0  own 0        status, one line per bus
//!  des.json ✓ 12 entries         ● 14 present  ○ 1 missing  ⚠ 2  ? 1  (and one for the file)
//! ─ 1 Devices ─ 2 Traffic ─ 3 Timeline ─ 4 Problems 2 ┬─ FEED @12 ──   tabs
//!    ADDR  NAME   STATE   MODE    SVC   AGE   FILE    │ online 3m12s   header
//! ▸  12   FEED   online  WORK      4    0s   ✓ 12     │ …              list, details
//!    13   SENS   online  WORK      3    0s   + new    │
//! ─ latest ───────────────────────────────────────────┴─────────────   latest
//!  12:03:11  ACT @14  address conflict confirmed: …
//!  e edit address  a add to file  u undo  r rescan  …        ? help    footer
//! ```
//!
//! Knows sizes only, not the content of the regions.

use super::View;
use super::page::{Focus, Page};
use super::rows::Counts;
use ratatui::layout::Rect;
use std::fmt::Write;

/// Regions of the screen; a region that is not shown is empty.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Screen {
    /// The whole screen.
    pub whole: Rect,
    /// State of the buses and of the file.
    pub status: Rect,
    /// Rule with the titles of the pages, then of the details.
    pub tabs: Rect,
    /// Lanes of the Timeline page.
    pub lanes: Rect,
    /// Rule above the lines of the Timeline page, with their number and kinds.
    pub kinds: Rect,
    /// Column headings.
    pub header: Rect,
    /// Rows.
    pub list: Rect,
    /// Line between list and details.
    pub divider: Rect,
    /// Details of the selected row.
    pub details: Rect,
    /// Rule below the list, above the latest lines of the timeline or the details of a frame.
    pub lower_rule: Rect,
    /// Latest lines of the timeline.
    pub latest: Rect,
    /// The whole capture as a line of cells.
    pub time_bar: Rect,
    /// Hints, messages, questions and the line being typed.
    pub footer: Rect,
}

/// Least width with details beside the list, in columns.
pub const SPLIT_WIDTH: u16 = 76;

/// Width from which all tabs have their titles, in columns.
const NARROW: u16 = 60;

/// Least width with the time bar, in columns.
const BAR_COLUMNS: u16 = 60;

/// Least height with the details of a frame below the list of frames, in lines.
const SPLIT_HEIGHT: u16 = 18;

/// Least height with the rule of the kinds on the Timeline page, in lines.
const KINDS_HEIGHT: u16 = 16;

impl Screen {
    /// Returns the layout for a view and this number of buses.
    pub fn new(view: &View, buses: usize) -> Self {
        let (columns, rows) = view.size;
        let whole = Rect::new(0, 0, columns, rows);
        let mut left = whole;
        let status = take_top(&mut left, Self::status_lines(columns, rows, buses));
        let tabs = take_top(&mut left, 1);
        let footer = take_bottom(&mut left, 1);
        let mut screen = Self { whole, status, tabs, footer, ..Self::default() };
        let is_large = columns >= 120 && rows >= 30;
        let is_wanted = is_large || (view.frozen.is_some() || view.has_time_bar) && rows >= 16;
        if is_wanted && columns >= BAR_COLUMNS {
            screen.time_bar = take_bottom(&mut left, 1);
        }
        let latest = match rows {
            _ if view.page != Page::Devices => 0,
            0..=17 => 0,
            18..=23 => 2,
            24..=35 => 3,
            36..=49 => 6,
            _ => 10,
        };
        if latest > 0 {
            screen.latest = take_bottom(&mut left, latest);
            screen.lower_rule = take_bottom(&mut left, 1);
        }
        let has_details = view.has_details();
        if has_details && view.page == Page::Traffic && rows >= SPLIT_HEIGHT {
            screen.details = take_bottom(&mut left, (rows / 3).clamp(7, 14));
            screen.lower_rule = take_bottom(&mut left, 1);
        } else if has_details && view.page != Page::Traffic && columns >= SPLIT_WIDTH {
            let width = match view.page {
                Page::Devices => (columns * 3 / 8).clamp(29, 60),
                _ => (columns * 9 / 20).clamp(34, 72),
            };
            screen.details = Rect::new(columns - width, left.y, width, left.height);
            left.width -= width + 1;
            screen.divider = Rect::new(left.width, left.y, 1, left.height);
        } else if has_details && view.focus == Focus::Details {
            screen.details = std::mem::take(&mut left);
        }
        if view.page == Page::Timeline {
            let lanes = view.lane_lines(left.height);
            screen.lanes = take_top(&mut left, lanes);
            screen.kinds = take_top(&mut left, u16::from(rows >= KINDS_HEIGHT));
        }
        screen.header = take_top(&mut left, 1);
        screen.list = left;
        screen
    }

    /// Height of the status region: one line per bus, as many as fit, and one for the file; on
    /// small screens one line for all.
    fn status_lines(columns: u16, rows: u16, buses: usize) -> u16 {
        let buses = u16::try_from(buses.max(1)).unwrap_or(u16::MAX);
        match rows {
            0..=4 => 0,
            5..=15 => 1,
            _ if columns >= 140 && buses == 1 => 1,
            16..=30 => buses.min(2) + 1,
            _ => buses.min(6) + 1,
        }
    }

    /// Number of rows that fit into the list.
    pub fn list_rows(&self) -> usize {
        usize::from(self.list.height)
    }

    /// Returns the tabs; beside the title of details in the place of the list only the open page
    /// has its own.
    pub fn tabs(&self, open: Page, counts: Counts) -> Vec<(Page, u16, String)> {
        let columns = self.whole.width;
        tabs(if self.details_alone() { columns.min(NARROW - 1) } else { columns }, open, counts)
    }

    /// Returns true if the details take the place of the list.
    pub fn details_alone(&self) -> bool {
        self.list.height == 0 && self.details.height > 0
    }
}

fn take_top(area: &mut Rect, lines: u16) -> Rect {
    let lines = lines.min(area.height);
    let taken = Rect { height: lines, ..*area };
    area.y += lines;
    area.height -= lines;
    taken
}

fn take_bottom(area: &mut Rect, lines: u16) -> Rect {
    let lines = lines.min(area.height);
    area.height -= lines;
    Rect { y: area.y + area.height, height: lines, ..*area }
}

/// Returns page, first column and text of each tab. On a narrow screen only the open page has its
/// title, the others their number, and confirmed and suspected problems are counted separately. A file that cannot be used is marked.
fn tabs(columns: u16, open: Page, counts: Counts) -> Vec<(Page, u16, String)> {
    let (narrow, wide) = (columns < NARROW, columns >= 100);
    let mut at = u16::from(wide);
    Page::ALL
        .into_iter()
        .map(|page| {
            let mut text = format!(" {} ", page.number());
            if !narrow || page == open {
                text.push_str(page.title());
                text.push(' ');
            }
            let all = counts.confirmed + counts.suspected;
            if page == Page::Problems && narrow {
                for (sign, count) in [("⚠", counts.confirmed), ("?", counts.suspected)] {
                    if count > 0 {
                        let _ = write!(text, "{sign}{count} ");
                    }
                }
            } else if page == Page::Problems && all > 0 {
                let _ = write!(text, "{all} ");
            }
            if page == Page::Problems && counts.is_file_broken {
                text.push_str("✗ ");
            }
            let start = at;
            at += text.chars().count() as u16 + u16::from(wide);
            (page, start, text)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_fill_every_screen_and_never_overlap() {
        for columns in [0, 1, 20, 40, 75, 76, 80, 120, 250] {
            for rows in [0, 1, 3, 5, 10, 16, 18, 24, 40, 60] {
                for page in Page::ALL {
                    for focus in [Focus::List, Focus::Details] {
                        let size = (columns, rows);
                        let view = View { page, focus, size, ..View::default() };
                        let screen = Screen::new(&view, 2);
                        let parts = [
                            screen.status,
                            screen.tabs,
                            screen.lanes,
                            screen.kinds,
                            screen.header,
                            screen.list,
                            screen.divider,
                            screen.details,
                            screen.lower_rule,
                            screen.latest,
                            screen.time_bar,
                            screen.footer,
                        ];
                        let area: u32 = parts.iter().map(|part| part.area()).sum();
                        assert_eq!(area, whole_area(columns, rows), "{columns}×{rows} {screen:?}");
                    }
                }
            }
        }
    }

    fn whole_area(columns: u16, rows: u16) -> u32 {
        u32::from(columns) * u32::from(rows)
    }

    #[test]
    fn small_screen_still_shows_devices() {
        let view = View { size: (40, 10), ..View::default() };
        assert!(Screen::new(&view, 1).list_rows() >= 6);
    }
}
