//! The time bar: the whole capture or log in cells, or at a zoom the part around the shown moment, and
//! moving along them.
//!
//! Inputs: the lines of the timeline, the marks, the kept moments. Output: a sign for each cell.
//! Computed once a second and when the shown moment changes; bounded by the width of the screen.
//! Does not know how the bar is drawn.

use super::marks::Mark;
use super::notices::TimelineEntry;
use super::time_axis::TimeAxis;
use super::timeline_kind::TimelineKind;
use super::{App, Mouse, format_step};
use crate::finding::{FindingKind, Grouping};
use crate::time::{Duration, Instant};

/// Columns in front of the cells: the first time and the end of the bar.
pub const BAR_LEFT: u16 = 11;
/// Columns behind the cells: the end of the bar, the last time, what is shown.
pub const BAR_RIGHT: u16 = 20;
/// Most halvings of the time in the bar: then a day has cells of 10 ms.
const MAX_ZOOM: u32 = 16;
/// Shortest cell of a zoomed bar.
const MIN_CELL: Duration = Duration::from_millis(10);
/// Cells of a long step.
const FAR: i64 = 10;
/// Most findings that are open at once, for the cells of conflicts.
const MAX_OPEN: usize = 256;

/// What a cell of the time bar has; of several the last one in this order is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum BarSign {
    /// Nothing.
    #[default]
    Quiet,
    /// Events.
    Event,
    /// Error frames, or bus errors in the counters.
    Errors,
    /// Frames were lost on their way to the capture.
    Lost,
    /// A finding was suspected.
    Suspected,
    /// An address conflict was confirmed and open.
    Conflict,
    /// A mark, with its letter.
    Mark(char),
}

/// The time bar.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TimeBar {
    /// First moment that can be shown.
    pub begin: Instant,
    /// The present, or the end of a log.
    pub end: Instant,
    /// The present: a log was read until then.
    pub read: Instant,
    /// True if earlier frames were dropped.
    pub has_dropped: bool,
    /// The part that the cells are of: all, or at a zoom less.
    pub part: (Instant, Instant),
    /// The cells, from the beginning to the end.
    pub cells: Vec<BarSign>,
}

impl TimeBar {
    /// The axis of the cells.
    pub fn axis(&self) -> TimeAxis {
        TimeAxis::new(self.part.0, self.part.1.since(self.part.0), self.cells.len())
    }

    /// Selects the part of a zoom, in halvings, that a moment is in. Parts begin at quarters of them, so
    /// that the cells stay where they are while the moment moves a little.
    fn zoom_to(&mut self, zoom: u32, shown: Instant) {
        let whole = self.end.since(self.begin);
        self.part = (self.begin, self.end);
        if zoom == 0 || whole.is_zero() {
            return;
        }
        let quarter = (whole / 2_u32.pow(zoom.min(MAX_ZOOM)) / 4).max(Duration::from_micros(1));
        let at = shown.since(self.begin).as_micros() / quarter.as_micros();
        let first = u32::try_from(at.saturating_sub(1)).unwrap_or(u32::MAX);
        let last = self.begin + whole.saturating_sub(quarter * 4);
        let start = (self.begin + quarter.saturating_mul(first)).min(last);
        self.part = (start, (start + quarter * 4).min(self.end));
    }

    /// Duration of a cell.
    pub fn cell_duration(&self) -> Duration {
        self.axis().step()
    }

    /// The cell of a moment.
    pub fn cell(&self, at: Instant) -> usize {
        self.axis().cell(at)
    }

    /// The moment in the middle of a cell.
    pub fn moment(&self, cell: usize) -> Instant {
        self.axis().middle(cell).min(self.end)
    }

    fn put(&mut self, from: Instant, to: Instant, sign: BarSign) {
        if self.cells.is_empty() || to < self.part.0 || from > self.part.1 {
            return;
        }
        let (from, to) = (self.cell(from), self.cell(to));
        for cell in &mut self.cells[from..=to.max(from)] {
            *cell = (*cell).max(sign);
        }
    }

    fn put_lines<'a>(&mut self, lines: impl Iterator<Item = &'a TimelineEntry>) {
        let mut open: Vec<(_, Instant, BarSign)> = Vec::new();
        for line in lines {
            let key = (line.finding, line.bus, line.address);
            let sign = match line.kind {
                TimelineKind::Mark(_) => continue,
                TimelineKind::Suspected => match sign_of(line.finding) {
                    Some(sign @ (BarSign::Errors | BarSign::Lost)) => sign,
                    _ => BarSign::Suspected,
                },
                TimelineKind::Confirmed => {
                    let sign = sign_of(line.finding);
                    let is_known = open.iter().any(|(known, ..)| *known == key);
                    if let Some(sign) = sign.filter(|_| !is_known && open.len() < MAX_OPEN) {
                        open.push((key, line.time, sign));
                    }
                    sign.unwrap_or(BarSign::Event)
                }
                TimelineKind::Cleared => {
                    if let Some(at) = open.iter().position(|(known, ..)| *known == key) {
                        let (_, since, sign) = open.swap_remove(at);
                        self.put(since, line.time, sign);
                    }
                    BarSign::Event
                }
                _ => BarSign::Event,
            };
            self.put(line.time, line.time, sign);
            self.put(line.last, line.last, sign);
        }
        for (_, since, sign) in open {
            self.put(since, self.read, sign);
        }
    }

    fn put_mark(&mut self, mark: &Mark) {
        let at = mark.moment.time;
        self.put(at, at, BarSign::Mark(mark.letter));
    }
}

/// Returns the sign of a confirmed finding while it is open; `None` for one that has only a beginning.
/// Suspected conflicts have a sign of their own.
fn sign_of(kind: Option<FindingKind>) -> Option<BarSign> {
    match kind? {
        FindingKind::BusErrors => Some(BarSign::Errors),
        FindingKind::FramesLost => Some(BarSign::Lost),
        kind => (kind.facts().grouping == Grouping::Address).then_some(BarSign::Conflict),
    }
}

impl App {
    /// The time bar as of the last second.
    pub fn time_bar(&self) -> &TimeBar {
        &self.time_bar
    }

    /// Computes the time bar again.
    pub(super) fn renew_time_bar(&mut self) {
        let area = self.screen().time_bar;
        let mut bar = std::mem::take(&mut self.time_bar);
        bar.cells.clear();
        (bar.read, bar.end) = (self.clock.now(), self.last_moment());
        bar.begin = self.buses.begin(&self.traffic.capture).min(bar.read);
        bar.zoom_to(self.view.bar_zoom, self.shown_time());
        if area.height > 0 {
            let cells = area.width.saturating_sub(BAR_LEFT + BAR_RIGHT);
            bar.cells.resize(usize::from(cells), BarSign::Quiet);
            let first = self.timeline().entries().next();
            bar.has_dropped =
                self.traffic.capture.first() > 0 || first.is_some_and(|line| line.time < bar.begin);
            bar.put_lines(self.timeline().entries());
            for mark in self.marks.by_letter() {
                bar.put_mark(mark);
            }
        }
        self.time_bar = bar;
    }

    /// Shows half of the time in the bar, or with 1 twice as much.
    pub(super) fn zoom_time_bar(&mut self, by: isize) {
        let is_shown = !self.time_bar.cells.is_empty();
        let zoom = self.view.bar_zoom.saturating_add_signed(-by as i32);
        let is_finer = zoom > self.view.bar_zoom;
        let is_finest = zoom > MAX_ZOOM || self.time_bar.cell_duration() < MIN_CELL * 2;
        if !is_shown || zoom == self.view.bar_zoom || is_finer && is_finest {
            return self.show_error("no other scale");
        }
        self.view.bar_zoom = zoom;
        self.renew_time_bar();
        let cell = format_step(self.time_bar.cell_duration());
        self.show_info(format!("time bar: {cell} a cell"));
    }

    /// Shows or hides the time bar on a screen where it is not always shown.
    pub(super) fn toggle_time_bar(&mut self) {
        self.view.has_time_bar = !self.view.has_time_bar;
        self.renew_time_bar();
        let state = match (self.screen().time_bar.height, self.view.has_time_bar) {
            (0, true) => "time bar: the screen is too small",
            (0, false) => "time bar hidden",
            (_, true) => "time bar shown",
            (_, false) => "time bar: always shown on this screen, or while frozen",
        };
        self.show_info(state);
    }

    /// Moves the shown moment by cells of the time bar, or of the lanes where they are shown.
    pub(super) fn scrub(&mut self, cells: i64) {
        let from = self.moment_range().shown;
        let begin = self.time_bar.begin;
        let step = self.lane_step().unwrap_or(self.time_bar.axis().step());
        let by = step.saturating_mul(u32::try_from(cells.unsigned_abs()).unwrap_or(u32::MAX));
        let to = if cells < 0 {
            begin + from.since(begin).saturating_sub(by)
        } else {
            (from + by).min(self.last_moment())
        };
        self.go_to_time(to);
    }

    /// Moves by ten cells to `direction`; only while a past moment is shown.
    pub(super) fn scrub_far(&mut self, direction: i64) {
        if self.past.is_some() {
            return self.scrub(direction * FAR);
        }
        let key = self.key_of(crate::keymap::Action::Freeze);
        self.show_error(format!("scrubbing: the present is shown; {key} freezes it first"));
    }

    /// Goes to the moment of the cell at a place of the screen; returns false beside the bar.
    pub(super) fn click_time_bar(&mut self, mouse: Mouse) -> bool {
        let area = self.screen().time_bar;
        if area.height == 0 || mouse.row != area.y {
            return false;
        }
        let cell = usize::from(mouse.column.saturating_sub(area.x + BAR_LEFT));
        if mouse.column >= area.x + BAR_LEFT && cell < self.time_bar.cells.len() {
            self.go_to_time(self.time_bar.moment(cell));
        }
        true
    }
}
