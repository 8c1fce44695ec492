//! Lanes: presence, modes, reboots, moves and conflicts of each device on one time axis.
//!
//! Inputs: the changes of the devices, the stories of conflicts, the errors of the buses, the zoom,
//! the size of the screen. Output: an axis and the cells of the lanes that are shown, until the
//! moment that is shown. Bounded by the screen and by what is recorded. Does not know how lanes are
//! drawn.

mod board;
mod cells;
mod record;

pub use board::LaneBoard;
pub(super) use cells::ConflictSpan;
pub use cells::LaneCell;
pub(super) use record::LaneRecords;

use super::notices::TimelineEntry;
use super::time_axis::TimeAxis;
use super::timeline_kind::TimelineKind;
use super::view::TimelineView;
use super::{App, Mouse, Page};
use crate::discovery::{Device, DeviceId, Presence};
use crate::frame::BusIndex;
use crate::time::{Duration, Instant};
use cells::lane_cells;
use std::collections::BTreeMap;

/// Least width with long labels, in columns.
const LONG_LABELS: u16 = 100;
/// Columns in front of the cells: the pointer and the label.
const LEFT: [u16; 2] = [10, 18];
/// Columns behind the cells: the state at the shown moment.
const RIGHT: [u16; 2] = [13, 14];
/// Columns of the label of the bus, where there are several; on a narrow screen none.
const BUS_LABEL: [u16; 2] = [5, 7];
/// Least width with such a label.
const WITH_BUS: u16 = 60;
/// Lengths of a cell to choose from, in milliseconds.
const STEPS: [u64; 16] = [
    10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 30_000, 60_000, 120_000, 300_000,
    600_000,
];
/// Parts of the axis by which it moves on when the shown moment is behind it.
const AXIS_PARTS: u64 = 4;

/// A lane.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lane {
    /// The device.
    pub device: DeviceId,
    /// The board, where several share the address of the device.
    pub board: Option<LaneBoard>,
    /// Its cells.
    pub cells: Vec<LaneCell>,
}

/// The lanes that are shown.
#[derive(Clone, Debug)]
pub struct Lanes {
    /// The axis of all of them.
    pub axis: TimeAxis,
    /// The moment that is shown.
    pub shown: Instant,
    /// The lanes, from the top.
    pub rows: Vec<Lane>,
    /// Number of devices without a line.
    pub hidden: usize,
    /// Number of error frames of all buses in each cell.
    pub errors: Vec<u32>,
    /// Cells of the label: with the pointer, the bus and a blank.
    pub left: u16,
    /// Cells of the bus among them, with a blank; 0 without it.
    pub bus: u16,
    /// Cells of the state at the right.
    pub right: u16,
}

impl App {
    /// Returns true if lanes are shown.
    pub(super) fn shows_lanes(&self) -> bool {
        self.view.page == Page::Timeline && self.screen().lanes.height > 1
    }

    /// Adds to the lane and the stories of a device what its row shows, after the events of two rows
    /// were merged (those after the merge concern another device), or when it returned.
    pub(super) fn correct_merged(&mut self, time: Instant, id: DeviceId) {
        if self.notices.emits_events() {
            return;
        }
        let Some(device) = self.buses.device(id) else { return };
        self.lane_records.correct(time, device);
        let mut entry = TimelineEntry::new(time, TimelineKind::Change, "").on(id.bus);
        (entry.device, entry.address) = (Some(id), Some(device.address));
        entry.name.clone_from(&device.name);
        self.notices.correct_stories(&entry, device.presence, device.mode);
    }

    /// Length of a cell of the lanes; `None` where they are not shown.
    pub(super) fn lane_step(&self) -> Option<Duration> {
        self.shows_lanes().then(|| self.lane_axis().step())
    }

    fn lane_columns(&self) -> (u16, u16) {
        let width = self.screen().lanes.width;
        let at = usize::from(width >= LONG_LABELS);
        (LEFT[at] + self.lane_bus_columns(), RIGHT[at])
    }

    /// Columns of the label of the bus of a lane; 0 without one.
    fn lane_bus_columns(&self) -> u16 {
        let width = self.screen().lanes.width;
        let is_shown = self.buses().len() > 1 && width >= WITH_BUS;
        if is_shown { BUS_LABEL[usize::from(width >= LONG_LABELS)] } else { 0 }
    }

    /// The axis of the lanes: all that is kept, or at a zoom the time around the shown moment. It
    /// begins at a whole cell, so it moves by whole cells where the oldest frames are dropped.
    pub fn lane_axis(&self) -> TimeAxis {
        let (left, right) = self.lane_columns();
        let cells = u64::from(self.screen().lanes.width.saturating_sub(left + right)).max(1);
        let now = self.clock.now().as_micros();
        let kept = self.time_bar.begin.as_micros().min(now);
        let begin = |step: u64| kept / (step * 1000) * step * 1000;
        let fits = |step: u64| (now - begin(step)) / (step * 1000) < cells;
        let mut step = match self.view.lane_zoom {
            Some(at) => STEPS[at.min(STEPS.len() - 1)],
            None => STEPS.into_iter().find(|step| fits(*step)).unwrap_or(STEPS[STEPS.len() - 1]),
        };
        if self.view.lane_zoom.is_none() && !fits(step) {
            // A log of weeks: as many of the longest as needed.
            step *= (now - kept) / (step * 1000 * cells) + 2;
        }
        let mut start = begin(step);
        if !fits(step) {
            // The shown moment is in the last part: what was before it matters most.
            let part = (cells / AXIS_PARTS).max(1) * step * 1000;
            let place = self.shown_time().as_micros().saturating_sub(start) / part;
            start += place.saturating_sub(AXIS_PARTS - 1) * part;
        }
        let span = Duration::from_millis(step * cells);
        TimeAxis::new(Instant::from_micros(start), span, cells as usize)
    }

    /// Makes the cells of the lanes longer by a step, or with -1 shorter.
    pub(super) fn zoom_lanes(&mut self, by: isize) {
        if !self.shows_lanes() {
            return self.zoom_time_bar(by);
        }
        let step = self.lane_step().unwrap_or_default().as_millis() as u64;
        let at = STEPS.iter().position(|it| *it >= step).unwrap_or(STEPS.len() - 1);
        let to = at.saturating_add_signed(by).min(STEPS.len() - 1);
        self.view.lane_zoom = Some(to);
        let text = format_step(Duration::from_millis(STEPS[to]));
        self.show_info(format!("{text} a cell"));
    }

    /// The number of lanes, for the layout.
    pub(super) fn count_lanes(&mut self) {
        let further = self.further_lanes();
        self.view.lane_count = self.shown_buses().devices().count() + further;
    }

    /// The lanes that fit the screen, as of the moment that is shown.
    pub fn lanes(&self) -> Lanes {
        let (axis, shown) = (self.lane_axis(), self.shown_time());
        let (left, right) = self.lane_columns();
        let mut conflicts: BTreeMap<BusIndex, Vec<ConflictSpan>> = BTreeMap::new();
        let begun = self.stories().iter().take_while(|story| story.begin() <= shown);
        for (bus, span) in begun.flat_map(|story| story.conflict_spans(shown)) {
            conflicts.entry(bus).or_default().push(span);
        }
        // The axis, and the errors.
        let height = usize::from(self.screen().lanes.height.saturating_sub(2));
        let boards = self.boards_of_lanes();
        let further: usize = boards.values().map(|boards| boards.len() - 1).sum();
        // Boards have at most half of the lines.
        let room = height - further.min(height / 2);
        let (devices, hidden) = self.lanes_in_view(room, &axis, shown, &conflicts);
        let no_conflicts = Vec::new();
        let lanes = |device: DeviceId| {
            let spans = conflicts.get(&device.bus).unwrap_or(&no_conflicts);
            let record = self.lane_records.get(device);
            let cells = record.map(|record| lane_cells(record, spans, &axis, shown));
            let cells = cells.unwrap_or_else(|| vec![LaneCell::Blank; axis.cells]);
            match boards.get(&device) {
                None => vec![Lane { device, board: None, cells }],
                Some(boards) => boards.iter().map(|it| it.lane(device, &cells, &axis)).collect(),
            }
        };
        let mut rows: Vec<Lane> = devices.into_iter().flat_map(lanes).collect();
        rows.truncate(height);
        let errors = self.errors_in_cells(&axis);
        let bus = self.lane_bus_columns();
        Lanes { axis, shown, rows, hidden, errors, left, bus, right }
    }

    /// Devices whose lanes are shown on so many lines, and the number of the others.
    fn lanes_in_view(
        &self,
        height: usize,
        axis: &TimeAxis,
        shown: Instant,
        conflicts: &BTreeMap<BusIndex, Vec<ConflictSpan>>,
    ) -> (Vec<DeviceId>, usize) {
        let mut devices: Vec<&Device> = self.shown_buses().devices().collect();
        devices.sort_by_key(|device| (device.id.bus, device.address, device.id));
        let hidden = devices.len().saturating_sub(height);
        let selected = self.selected_lane();
        if hidden > 0 && self.view.timeline_shown() == TimelineView::Both {
            // Those with events first; of equal ones by address.
            let is_quiet = |device: &Device| {
                let spans = conflicts.get(&device.id.bus).into_iter().flatten();
                let mut at_address = spans.filter(|span| span.address == device.address);
                let record = self.lane_records.get(device.id);
                let mut changes = record.into_iter().flat_map(|record| record.changes.iter());
                // That it appeared, its first modes.
                let first = record.and_then(|record| record.changes.front());
                let since = first.map_or(axis.begin, |(time, _)| *time + FIRST_MODES);
                !changes.any(|(time, _)| *time > since && *time >= axis.begin && *time <= shown)
                    && !at_address.any(|span| span.to >= axis.begin && span.from < axis.end())
            };
            devices.sort_by_cached_key(|device| {
                (Some(device.id) != selected, is_quiet(device), device.id.bus, device.address)
            });
            devices.truncate(height);
            devices.sort_by_key(|device| (device.id.bus, device.address, device.id));
        } else if hidden > 0 {
            let at = devices.iter().position(|device| Some(device.id) == selected).unwrap_or(0);
            let top = (at + 1).saturating_sub(height);
            devices = devices.split_off(top);
            devices.truncate(height);
        }
        (devices.into_iter().map(|device| device.id).collect(), hidden)
    }

    /// The device of the selected lane: on Lanes the chosen one, else that of the selected line.
    pub fn selected_lane(&self) -> Option<DeviceId> {
        if self.view.timeline_shown() == TimelineView::Lanes {
            return self.view.lane.selected().copied();
        }
        let story = self.view.timeline.selected().and_then(|key| self.story(*key))?;
        let (entry, _) = self.story_subject(story);
        let by_id = entry.device.filter(|id| self.shown_buses().device(*id).is_some());
        by_id.or_else(|| {
            let device = self.shown_buses().get(entry.bus?)?.device_at(entry.address?)?;
            Some(device.id)
        })
    }

    /// Moves the selection over the lanes; returns false where lines are shown.
    pub(super) fn move_in_lanes(&mut self, delta: isize) -> bool {
        let is_alone = self.view.timeline_shown() == TimelineView::Lanes;
        if self.view.page != Page::Timeline || !is_alone {
            return false;
        }
        let keys = self.lane_keys();
        let height = usize::from(self.screen().lanes.height.saturating_sub(2));
        if self.view.lane.selected().is_none() {
            self.view.lane.update_keeping(&keys, height);
        } else {
            self.view.lane.move_by(&keys, delta, height);
        }
        true
    }

    /// Goes to the device of the selected lane, on Devices.
    pub(super) fn go_to_lane(&mut self) {
        self.find_row("select a lane first");
    }

    /// Shows the frames of the device of the selected lane.
    pub(super) fn go_to_frames_of_lane(&mut self) {
        let Some(address) =
            self.selected_lane().and_then(|id| self.device(id)).map(|it| it.address)
        else {
            return self.show_error("select a lane first");
        };
        self.show_frames_of_address(address);
    }

    /// Devices in the order of their lanes.
    fn lane_keys(&self) -> Vec<DeviceId> {
        let mut devices: Vec<&Device> = self.shown_buses().devices().collect();
        devices.sort_by_key(|device| (device.id.bus, device.address, device.id));
        devices.into_iter().map(|device| device.id).collect()
    }

    /// Goes to the moment of the cell at a place of the screen; returns false beside the lanes.
    pub(super) fn click_lanes(&mut self, mouse: Mouse) -> bool {
        let area = self.screen().lanes;
        if !self.shows_lanes() || !(area.top()..area.bottom()).contains(&mouse.row) {
            return false;
        }
        let (left, _) = self.lane_columns();
        let axis = self.lane_axis();
        let cell = usize::from(mouse.column.saturating_sub(area.x + left));
        if mouse.column >= area.x + left && cell < axis.cells {
            let at = axis.middle(cell);
            if at <= self.clock.now() {
                self.go_to_time(at);
            }
        }
        true
    }

    fn errors_in_cells(&self, axis: &TimeAxis) -> Vec<u32> {
        const SECOND: u64 = 1_000_000;
        let second = |cell: usize| axis.start(cell).as_micros().div_ceil(SECOND);
        let count = |cell: usize| {
            let (from, to) = (second(cell), second(cell + 1));
            let histories = self.shown_buses().iter().map(|bus| &bus.meter.history);
            let errors = histories.map(|history| {
                // Of long cells also the seconds whose samples are not stored singly.
                history.sample(from.min(history.end()), to.min(history.end())).errors
            });
            errors.sum()
        };
        (0..axis.cells).map(count).collect()
    }

    /// Word for the state of a device at the shown moment.
    pub fn lane_state(&self, device: DeviceId) -> (String, Option<Presence>) {
        let Some(device) = self.shown_buses().device(device) else { return (String::new(), None) };
        let mode = device.mode.map(|mode| format!(" {mode}")).unwrap_or_default();
        let word = match device.presence {
            Presence::Online if self.shown_buses().has_confirmed_conflict(device) => {
                "CONFLICT".to_owned()
            }
            Presence::Online => format!("online{mode}"),
            other => other.name().to_owned(),
        };
        (word, Some(device.presence))
    }
}

/// Time after its first frame in which the changes of a device are those of joining.
const FIRST_MODES: Duration = Duration::from_secs(3);

/// Length of a cell: `10 ms`, `2 s`, `5 min`.
pub fn format_step(step: Duration) -> String {
    match step.as_millis() {
        millis if millis >= 60_000 && millis.is_multiple_of(60_000) => {
            format!("{} min", millis / 60_000)
        }
        millis if millis >= 1000 => format!("{} s", millis / 1000),
        millis => format!("{millis} ms"),
    }
}
