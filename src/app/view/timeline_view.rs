//! The views of the Timeline page, and how many lines of it are lanes.

use super::View;

/// Least width with lanes above the lines, in columns.
const BOTH_COLUMNS: u16 = 100;
/// Least height of lanes and lines together, in lines: else only the lines are shown.
const BOTH_LINES: u16 = 12;
/// Lines of the lanes besides those of devices: the axis, and the errors of the bus.
const AXIS_LINES: usize = 2;

/// What the Timeline page shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimelineView {
    /// Lanes above the lines, on a wide screen; else the lines.
    #[default]
    Both,
    /// A line for each story.
    Lines,
    /// A lane for each device.
    Lanes,
}

impl TimelineView {
    /// Name in the page rule.
    pub const fn title(self) -> &'static str {
        match self {
            Self::Both => "lanes and lines",
            Self::Lines => "lines",
            Self::Lanes => "lanes",
        }
    }

    /// The views that there are on a screen of so many columns.
    pub const fn all(columns: u16) -> &'static [Self] {
        if columns >= BOTH_COLUMNS {
            &[Self::Both, Self::Lines, Self::Lanes]
        } else {
            &[Self::Lines, Self::Lanes]
        }
    }

    /// The view on a screen of so many columns.
    #[must_use]
    pub const fn on(self, columns: u16) -> Self {
        match self {
            Self::Both if columns < BOTH_COLUMNS => Self::Lines,
            other => other,
        }
    }

    /// The next view on a screen of so many columns.
    #[must_use]
    pub fn next(self, columns: u16) -> Self {
        let all = Self::all(columns);
        let at = all.iter().position(|it| *it == self.on(columns)).unwrap_or(0);
        all[(at + 1) % all.len()]
    }
}

impl View {
    /// The view of the Timeline page on this screen.
    pub fn timeline_shown(&self) -> TimelineView {
        self.timeline_view.on(self.size.0)
    }

    /// Number of lines that lanes take of `height`.
    pub(in crate::app) fn lane_lines(&self, height: u16) -> u16 {
        let wanted = self.lane_count + AXIS_LINES;
        match self.timeline_shown() {
            TimelineView::Lines => 0,
            TimelineView::Lanes => height,
            TimelineView::Both if height < BOTH_LINES || self.lane_count == 0 => 0,
            TimelineView::Both => u16::try_from(wanted).unwrap_or(u16::MAX).min(height / 2),
        }
    }
}
