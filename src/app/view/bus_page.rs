//! The page Bus: the time that its charts show, the key of a bar, and the regions of the page, for
//! drawing and for the mouse.
//!
//! ```text
//!  can0  125 kbit/s  error-active  TEC 0 …      facts
//! ─ load, % ──────────────┬─ load by device ─   load, senders
//!   8 ┤ ⣤⣴⣦⣤⣀⣄           │ SENS @13  ██████
//! ─ error frames, /s ─────┤ ACT @14   ███       errors
//! ─ frames, /s ───────────┤                     frames
//!     └╷13:50:53          ├─ load by service     axis, services
//! ─ error kinds ──────────┤ HR        █████      kinds
//! ─ what happened to the bus ┴──────────────    events
//! ```
//!
//! On narrow screens the bars are below the charts, and the errors are one line. Knows sizes only,
//! not the content of the regions.

use crate::frame::BusIndex;
use crate::wire::id::{Address, Service};
use ratatui::layout::Rect;

/// Time that the charts and the bars show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum ChartSpan {
    /// At least the last 2 minutes; a sample a second.
    #[default]
    TwoMinutes,
    /// At least the last 10 minutes.
    TenMinutes,
    /// At least the last hour.
    OneHour,
    /// All time since the start.
    All,
}

impl ChartSpan {
    /// All spans, in the order of the key.
    pub const ALL: [ChartSpan; 4] = [Self::TwoMinutes, Self::TenMinutes, Self::OneHour, Self::All];

    /// Text on the screen.
    pub const fn title(self) -> &'static str {
        match self {
            Self::TwoMinutes => "2 min",
            Self::TenMinutes => "10 min",
            Self::OneHour => "1 h",
            Self::All => "all",
        }
    }

    /// The next span.
    #[must_use]
    pub const fn next(self) -> Self {
        match self {
            Self::TwoMinutes => Self::TenMinutes,
            Self::TenMinutes => Self::OneHour,
            Self::OneHour => Self::All,
            Self::All => Self::TwoMinutes,
        }
    }

    /// Length in seconds; `None` for all time.
    pub const fn seconds(self) -> Option<u64> {
        match self {
            Self::TwoMinutes => Some(120),
            Self::TenMinutes => Some(600),
            Self::OneHour => Some(3600),
            Self::All => None,
        }
    }

    /// The span with more time, or with -1 less; `None` behind the last one.
    pub fn zoomed(self, by: isize) -> Option<Self> {
        let at = Self::ALL.iter().position(|span| *span == self)?;
        Self::ALL.get(at.checked_add_signed(by)?).copied()
    }

    /// Seconds of each of `samples` samples, where `seconds` are stored.
    pub fn seconds_per_sample(self, samples: u64, seconds: u64) -> u64 {
        let samples = samples.max(1);
        match self {
            Self::TwoMinutes => 1,
            Self::TenMinutes => 600_u64.div_ceil(samples),
            // Powers of two, as those in which all time is stored: the samples stay for long.
            Self::OneHour => 3600_u64.div_ceil(samples).next_power_of_two(),
            Self::All => seconds.div_ceil(samples).max(1).next_power_of_two(),
        }
    }
}

/// Key of a bar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BarKey {
    /// Frames that an address sent.
    Sender(BusIndex, Address),
    /// Frames of a service.
    Service(BusIndex, Service),
}

impl BarKey {
    /// The bus.
    pub const fn bus(self) -> BusIndex {
        match self {
            Self::Sender(bus, _) | Self::Service(bus, _) => bus,
        }
    }
}

/// Regions of a bus; a region that is not shown is empty. Charts and bars begin with a heading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusRegions {
    /// State and counters.
    pub facts: Rect,
    /// Chart of the load.
    pub load: Rect,
    /// Chart of the error frames.
    pub errors: Rect,
    /// Chart of the frame rate.
    pub frames: Rect,
    /// Errors in one line.
    pub kinds: Rect,
    /// Bars by sender.
    pub senders: Rect,
    /// Bars by service.
    pub services: Rect,
}

/// Regions of the page.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BusPageLayout {
    /// The buses that are shown, the first one being that of number `first`.
    pub buses: Vec<BusRegions>,
    /// Number of the first bus that is shown.
    pub first: usize,
    /// Axis of all charts.
    pub axis: Rect,
    /// Line between charts and bars.
    pub divider: Rect,
    /// Heading of the error kinds.
    pub kinds_heading: Rect,
    /// What happened to the buses, with a heading.
    pub events: Rect,
}

/// Least width with bars beside the charts, in columns.
const BESIDE: u16 = 100;
/// Least width with two lists of bars beside the charts.
const BOTH_BESIDE: u16 = 160;
/// Least width with two lists of bars beside each other below the charts.
const TWO_LISTS: u16 = 60;
/// Least width in which all facts of a bus fit on one line.
const ONE_LINE: u16 = 240;
/// Least lines of a bus: heading, two lines of a chart.
const LEAST_CHART: u16 = 3;

impl BusPageLayout {
    /// Returns the regions in an area, for so many buses; that of the number `selected` is shown.
    pub fn new(area: Rect, buses: usize, selected: usize) -> Self {
        if area.width >= BESIDE {
            wide(area, buses, selected)
        } else {
            narrow(area, buses, selected)
        }
    }
}

/// Takes lines from the top of an area.
fn take(area: &mut Rect, lines: u16) -> Rect {
    let lines = lines.min(area.height);
    let taken = Rect { height: lines, ..*area };
    area.y += lines;
    area.height -= lines;
    taken
}

/// Returns the numbers of the buses shown where `most` fit.
fn visible(buses: usize, selected: usize, most: u16) -> std::ops::Range<usize> {
    let count = buses.min(usize::from(most.max(1)));
    let first = selected.min(buses.saturating_sub(1)).min(buses - count);
    first..first + count
}

/// Lines of each of `parts` parts of `lines` lines, and those left over.
fn share(lines: u16, parts: u16) -> (u16, u16) {
    (lines / parts.max(1), lines % parts.max(1))
}

fn narrow(area: Rect, buses: usize, selected: usize) -> BusPageLayout {
    let height = area.height;
    let most = if height < 12 { 1 } else { height / 8 };
    let shown = visible(buses, selected, most);
    let count = shown.len() as u16;
    let mut left = area;
    let mut page = BusPageLayout { first: shown.start, ..BusPageLayout::default() };
    page.buses = vec![BusRegions::default(); shown.len()];
    let facts = match height {
        0..12 => 0,
        12..16 => 1,
        _ if count == 1 => 2,
        _ => 1,
    };
    for bus in &mut page.buses {
        bus.facts = take(&mut left, facts);
    }
    let events = match height {
        0..18 => 0,
        ..24 if count > 1 => 0,
        _ => ((height - 18) / 6 + 2).min(7),
    };
    let kinds = u16::from(height >= 12 && count == 1);
    let axis = u16::from(height >= 10);
    let rest = left.height.saturating_sub(events + kinds + axis);
    let (each, _) = share(rest, count);
    let chart = (each / 3).clamp(LEAST_CHART, 9).min(each.max(1));
    // The chart of the errors yields to the bars.
    let errors = if each >= 24 { 4 } else { 0 };
    for bus in &mut page.buses {
        bus.load = take(&mut left, chart);
        bus.errors = take(&mut left, errors);
    }
    page.axis = take(&mut left, axis);
    if let Some(bus) = page.buses.first_mut() {
        bus.kinds = take(&mut left, kinds);
    }
    let mut lists = Rect { height: left.height.saturating_sub(events), ..left };
    page.events = Rect { y: lists.bottom(), height: left.height - lists.height, ..left };
    let (each, mut more) = share(lists.height, count);
    for bus in &mut page.buses {
        let mut list = take(&mut lists, each + u16::from(more > 0));
        more = more.saturating_sub(1);
        if area.width >= TWO_LISTS {
            bus.services =
                Rect { x: list.x + list.width.div_ceil(2), width: list.width / 2, ..list };
            list.width = list.width.div_ceil(2);
        }
        bus.senders = list;
    }
    page
}

fn wide(area: Rect, buses: usize, selected: usize) -> BusPageLayout {
    let height = area.height;
    let events = if height < 10 { 0 } else { (height / 4).clamp(2, 12) };
    let shown = visible(buses, selected, height.saturating_sub(events + 1) / (LEAST_CHART + 1));
    let count = shown.len() as u16;
    let mut page = BusPageLayout { first: shown.start, ..BusPageLayout::default() };
    page.buses = vec![BusRegions::default(); shown.len()];
    let mut left = area;
    let facts = match height {
        0..8 => 0,
        _ if count == 1 && area.width < ONE_LINE => 2,
        _ => 1,
    };
    for bus in &mut page.buses {
        bus.facts = take(&mut left, facts);
    }
    let mut beside = Rect { height: left.height.saturating_sub(events), ..left };
    page.events = Rect { y: beside.bottom(), height: left.height - beside.height, ..left };
    let both = area.width >= BOTH_BESIDE;
    let bars = if both { (area.width * 2 / 5).min(90) } else { (area.width / 3).max(38) };
    let mut lists = Rect { x: beside.right() - bars, width: bars, ..beside };
    beside.width -= bars + 1;
    page.divider = Rect { x: beside.right(), width: 1, ..beside };

    let kinds = if beside.height >= 10 + 2 * count { count + 1 } else { 0 };
    let charts = beside.height.saturating_sub(kinds + 1);
    let (each, mut more) = share(charts, count);
    for bus in &mut page.buses {
        let mut own = take(&mut beside, each + u16::from(more > 0));
        more = more.saturating_sub(1);
        let (errors, frames) = match own.height {
            0..7 => (0, 0),
            7..16 => (((own.height - 2) / 3 + 1).min(4), 0),
            lines => ((lines - 3) / 6 + 1, (lines - 3) / 4 + 1),
        };
        bus.load = take(&mut own, each.saturating_sub(errors + frames).max(1));
        bus.errors = take(&mut own, errors);
        // What is left over.
        bus.frames = if frames > 0 { own } else { take(&mut own, 0) };
        if frames == 0 {
            bus.errors.height += own.height * u16::from(errors > 0);
            bus.load.height += own.height * u16::from(errors == 0);
        }
    }
    page.axis = take(&mut beside, 1);
    page.kinds_heading = take(&mut beside, kinds.min(1));
    for bus in &mut page.buses {
        bus.kinds = take(&mut beside, kinds.min(1));
    }

    let (each, mut more) = share(lists.height, count);
    for bus in &mut page.buses {
        let mut list = take(&mut lists, each + u16::from(more > 0));
        more = more.saturating_sub(1);
        if both {
            bus.services =
                Rect { x: list.x + list.width.div_ceil(2), width: list.width / 2, ..list };
            list.width = list.width.div_ceil(2);
        } else if list.height >= 14 {
            let lines = list.height - list.height * 2 / 5;
            let senders = take(&mut list, lines);
            bus.services = list;
            list = senders;
        }
        bus.senders = list;
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_lie_in_the_area_and_never_overlap() {
        for width in [0, 1, 20, 40, 59, 60, 80, 99, 100, 120, 160, 200, 250] {
            for height in [0, 1, 3, 6, 7, 9, 12, 17, 20, 25, 36, 46, 60] {
                for buses in 1..=7 {
                    let area = Rect::new(0, 3, width, height);
                    let page = BusPageLayout::new(area, buses, buses - 1);
                    let mut taken = vec![0_u8; usize::from(width) * usize::from(height)];
                    let parts = [page.axis, page.divider, page.kinds_heading, page.events];
                    let of_buses = page.buses.iter().flat_map(|bus| {
                        let charts = [bus.facts, bus.load, bus.errors, bus.frames, bus.kinds];
                        charts.into_iter().chain([bus.senders, bus.services])
                    });
                    for part in parts.into_iter().chain(of_buses) {
                        for place in part.positions() {
                            assert!(area.contains(place), "{width}×{height} {buses}: {page:?}");
                            let (x, y) = (usize::from(place.x), usize::from(place.y - 3));
                            taken[y * usize::from(width) + x] += 1;
                        }
                    }
                    assert!(taken.iter().all(|it| *it < 2), "{width}×{height} {buses}: {page:?}");
                    let last = page.first + page.buses.len();
                    assert!((page.first..last).contains(&(buses - 1)), "{page:?}");
                    assert!(height < 3 || width == 0 || page.buses[0].load.height > 1, "{page:?}");
                }
            }
        }
    }

    #[test]
    fn all_time_fills_at_least_half_of_the_chart() {
        for seconds in [1, 200, 201, 7200, 1_000_000] {
            let each = ChartSpan::All.seconds_per_sample(200, seconds);
            assert!(each * 200 >= seconds && (each == 1 || each * 100 < seconds), "{seconds}");
        }
    }
}
