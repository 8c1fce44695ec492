//! Layout of the screen, for drawing and for the mouse.
//!
//! ```text
//!  can0 125k active  load   7% ⣶⣾⣿⣿ 5–8%  err 0  lost 0  own 0        status, one line per bus
//!  des.json ✓ 12 entries         ● 14 present  ○ 1 missing  ⚠ 2  ? 1  (and one for the file)
//!  ⚠ Address 14: SPARE01 joined 13:50:55, conflicts with BOILER03      alarm
//! ─ 1 Devices ─ 2 Traffic ─ 3 Timeline ─ 4 Problems 2 ┬ 13:51:12 LIVE   tabs
//!    ADDR  NAME   STATE   MODE    SVC   AGE   FILE    │ FEED @12       header, details_title
//! ▸  12   FEED   online  WORK      4    0s   ✓ 12     │ online 3m12s   list, details
//!    13   SENS   online  WORK      3    0s   + new    │
//! ─ latest ───────────────────────────────────────────┴─────────────   latest
//!  12:03:11  ACT @14  address conflict confirmed: …
//!  e edit address  a add to file  u undo  r rescan  …        ? help    footer
//! ```
//!
//! Knows sizes only, not the content of the regions.

use super::View;
use super::devices_page::DetailsPlace;
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
    /// The newest confirmed conflict; on a small screen in the place of the status.
    pub alarm: Rect,
    /// Rule with the titles of the pages and the shown moment.
    pub tabs: Rect,
    /// What devices send otherwise than the profile says.
    pub banner: Rect,
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
    /// Title of details beside the list or in its place.
    pub details_title: Rect,
    /// Details of the selected row.
    pub details: Rect,
    /// Rule with the title of the details of a device below the list.
    pub details_rule: Rect,
    /// Rule below the list, above the latest lines of the timeline or the details of a frame; below the
    /// identifiers, with the time that their statistics are of.
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

/// Width from which all tabs have their titles beside the shown moment, in columns.
const NARROW: u16 = 74;

/// Least width with the time bar, in columns.
const BAR_COLUMNS: u16 = 60;

/// Least rows of the list of problems above the details.
const LEAST_PROBLEMS: u16 = 3;

/// Least height with the details of a problem or of a frame below the list of frames, in lines.
const SPLIT_HEIGHT: u16 = 18;

/// Least height with a line for the status or the alarm, in lines.
const SMALLEST: u16 = 5;

/// Least height with the status beside an alarm, in lines: a bus that is down or a recording that
/// stopped stay on the screen.
const STATUS_AND_ALARM: u16 = 9;

/// Least height with the line about the profile, in lines.
const BANNER_HEIGHT: u16 = 20;

/// Least height with a line for each bus, in lines.
const SMALL: u16 = 16;
/// Least height with the rule of the kinds on the Timeline page, in lines.
const KINDS_HEIGHT: u16 = 16;

impl Screen {
    /// Returns the layout for a view and this number of buses.
    pub fn new(view: &View, buses: usize) -> Self {
        let (columns, rows) = view.size;
        let whole = Rect::new(0, 0, columns, rows);
        let mut left = whole;
        let alarm_lines = u16::from(view.has_alarm && rows >= SMALLEST);
        let is_status = alarm_lines == 0 || rows >= STATUS_AND_ALARM || view.frozen.is_some();
        let status_lines = if is_status { Self::status_lines(columns, rows, buses) } else { 0 };
        let status = take_top(&mut left, status_lines);
        let alarm = take_top(&mut left, alarm_lines);
        let tabs = take_top(&mut left, 1);
        let has_banner = view.has_banner && rows >= BANNER_HEIGHT && columns >= SPLIT_WIDTH;
        let banner = take_top(&mut left, u16::from(has_banner));
        let footer = take_bottom(&mut left, 1);
        let mut screen = Self { whole, status, alarm, tabs, banner, footer, ..Self::default() };
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
        } else if view.page == Page::Traffic && view.shows_identifiers() && rows >= SPLIT_HEIGHT {
            // What the statistics are of.
            screen.lower_rule = take_bottom(&mut left, 1);
        } else if has_details && view.page == Page::Problems && rows >= SPLIT_HEIGHT {
            // Below the list, which has as many rows as it wants, at most a part of the page.
            let wanted = view.problem_room;
            let part = if wanted.has_conflict { 4 } else { 2 };
            let most = (left.height / part).max(LEAST_PROBLEMS);
            let list = wanted.rows.clamp(LEAST_PROBLEMS, most) + wanted.below.min(left.height / 2);
            let rule = 1;
            let details = left.height.saturating_sub(1 + list + rule);
            screen.details = take_bottom(&mut left, details);
            screen.lower_rule = take_bottom(&mut left, rule);
        } else if view.page == Page::Devices {
            screen.place_details_of_device(view, &mut left);
        } else if has_details && view.page != Page::Traffic && columns >= SPLIT_WIDTH {
            let width = (columns * 9 / 20).clamp(34, 72);
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
        // Beside the list, the details of a device begin with their title.
        let is_beside = screen.divider.height > 0 && view.page != Page::Devices;
        if is_beside || screen.list.height == 0 {
            screen.details_title = take_top(&mut screen.details, 1);
        }
        screen
    }

    /// Places the details of a device, or its heartbeat history.
    fn place_details_of_device(&mut self, view: &View, left: &mut Rect) {
        match view.devices_page.details_place(view.size) {
            DetailsPlace::Below(lines) => {
                self.details = take_bottom(left, lines);
                self.details_rule = take_bottom(left, 1);
            }
            DetailsPlace::Beside(width) => {
                self.details = Rect { x: left.right() - width, width, ..*left };
                left.width -= width + 1;
                self.divider = Rect { x: left.right(), width: 1, ..*left };
            }
            DetailsPlace::Instead => {
                if view.focus == Focus::Details || view.devices_page.shows_history {
                    self.details = std::mem::take(left);
                }
            }
        }
    }

    /// Height of the status region: one line per bus, as many as fit, and one for the file; on
    /// small screens one line for all.
    fn status_lines(columns: u16, rows: u16, buses: usize) -> u16 {
        let buses = u16::try_from(buses.max(1)).unwrap_or(u16::MAX);
        match rows {
            0..SMALLEST => 0,
            SMALLEST..SMALL => 1,
            _ if columns >= 140 && buses == 1 => 1,
            SMALL..=30 => buses.min(2) + 1,
            _ => buses.min(6) + 1,
        }
    }

    /// Number of rows that fit into the list.
    pub fn list_rows(&self) -> usize {
        usize::from(self.list.height)
    }

    /// Returns the tabs.
    pub fn tabs(&self, open: Page, counts: Counts) -> Vec<(Page, u16, String)> {
        tabs(self.whole.width, open, counts)
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
/// title, the others their number, and confirmed and suspected problems are counted separately.
/// A file that cannot be used is marked.
fn tabs(columns: u16, open: Page, counts: Counts) -> Vec<(Page, u16, String)> {
    let (narrow, wide) = (columns < NARROW, columns >= 100);
    let mut at = u16::from(wide);
    Page::ALL
        .into_iter()
        .map(|page| {
            let mut text = format!(" {}", page.number());
            if !narrow || page == open {
                let _ = write!(text, " {} ", page.title());
            }
            let all = counts.confirmed + counts.suspected;
            if page == Page::Problems && narrow {
                for (sign, count) in [("⚠", counts.confirmed), ("?", counts.suspected)] {
                    if count > 0 {
                        let gap = if text.ends_with(' ') { "" } else { " " };
                        let _ = write!(text, "{gap}{sign}{count}");
                    }
                }
            } else if page == Page::Problems && all > 0 {
                let _ = write!(text, "{all} ");
            }
            if page == Page::Problems && counts.is_file_broken {
                text.push_str(if text.ends_with(' ') { "✗ " } else { " ✗" });
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
                    for (focus, has_alarm) in
                        [(Focus::List, false), (Focus::Details, false), (Focus::List, true)]
                    {
                        let size = (columns, rows);
                        let view = View { page, focus, has_alarm, size, ..View::default() };
                        let screen = Screen::new(&view, 2);
                        let parts = [
                            screen.status,
                            screen.alarm,
                            screen.tabs,
                            screen.lanes,
                            screen.kinds,
                            screen.header,
                            screen.list,
                            screen.divider,
                            screen.details_title,
                            screen.details,
                            screen.details_rule,
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
