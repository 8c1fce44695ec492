//! Lanes of the Timeline page: one for each device, on one time axis with the errors of the bus; the
//! state at the shown moment at the right.
//!
//! Does not know how cells are computed.

use super::brush::{DrawContext, bus_label, fit};
use super::problems::boards::side_role;
use crate::app::{Lane, LaneBoard, LaneCell, Lanes, clock_millis, format_step, format_time_of_day};
use crate::discovery::Presence;
use crate::theme::Role;
use crate::time::Duration;
use crate::wire::node::Mode;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Least cells between the beginnings of two times on the axis.
const TICK_CELLS: u64 = 15;
/// Distances between the times on the axis, in milliseconds.
const TICKS: [u64; 20] = [
    200, 500, 1000, 2000, 5000, 10_000, 20_000, 30_000, 60_000, 120_000, 300_000, 600_000, 900_000,
    1_800_000, 3_600_000, 7_200_000, 14_400_000, 21_600_000, 43_200_000, DAY,
];
/// A day in milliseconds. Times that far apart have a date.
const DAY: u64 = 86_400_000;

/// Draws the lanes.
pub fn draw(brush: &mut DrawContext) {
    let area = brush.screen.lanes;
    if area.height < 2 {
        return;
    }
    let lanes = brush.app.lanes();
    let axis = axis_line(brush, &lanes);
    brush.line(area, 0, &axis);
    let selected = brush.app.selected_lane();
    for (row, lane) in lanes.rows.iter().enumerate() {
        // Of the boards of a device the first one is selected.
        let is_first = lane.board.as_ref().is_none_or(|board| board.side == 0);
        let is_selected = selected == Some(lane.device) && is_first;
        let line = lane_line(brush, &lanes, lane, is_selected);
        let row = row as u16 + 1;
        brush.line(area, row, &line);
        if is_selected {
            brush.select(area, row);
        }
    }
    let row = (lanes.rows.len() as u16 + 1).min(area.height - 1);
    let errors = error_line(brush, &lanes);
    brush.line(area, row, &errors);
}

/// The length of a cell, times, the shown moment, marks.
fn axis_line(brush: &DrawContext, lanes: &Lanes) -> Line<'static> {
    let app = brush.app;
    let axis = lanes.axis;
    let step = (axis.step().as_millis() as u64).max(1);
    let tick = TICKS.iter().find(|tick| **tick >= step * TICK_CELLS);
    let tick = tick.copied().unwrap_or((step * TICK_CELLS).next_multiple_of(DAY));
    let mut cells: Vec<(String, Role)> = vec![(" ".to_owned(), Role::Muted); axis.cells];
    for mark in app.marks().by_letter() {
        if axis.contains(mark.moment.time) {
            cells[axis.cell(mark.moment.time)] = (mark.letter.to_string(), Role::Match);
        }
    }
    if axis.contains(lanes.shown) {
        let role = if app.past_moment().is_some() { Role::Warning } else { Role::Title };
        cells[axis.cell(lanes.shown)] = ("▼".to_owned(), role);
    }
    let first = app.epoch().unix_micros(axis.begin) / 1000;
    for number in first.div_ceil(tick)..=first / tick + axis.cells as u64 {
        let at = axis.begin + Duration::from_millis(number * tick - first);
        // What is behind the shown moment is blank.
        if !axis.contains(at) || at > lanes.shown {
            break;
        }
        let text = match tick {
            ..1000 => clock_millis(app, at),
            1000..DAY => format_time_of_day(app, at),
            // Without the year and the seconds: `11-21 06:00`.
            DAY.. => {
                let text = app.date_time_text(at);
                let of_year = text.split_once('-').map_or(&*text, |(_, rest)| rest);
                of_year.rsplit_once(':').map_or(of_year, |(minute, _)| minute).to_owned()
            }
        };
        put_time(&mut cells[axis.cell(at)..], &text);
    }
    let step = format_step(axis.step());
    let label = fit(&format!(" {step} a cell"), usize::from(lanes.left));
    let label = if lanes.left < 14 { fit(&format!(" {step}"), label.width()) } else { label };
    let mut spans = vec![brush.span(Role::Muted, label)];
    spans.extend(runs(brush, cells.into_iter()));
    let at = format_time_of_day(app, lanes.shown);
    spans.push(brush.span(Role::Muted, fit(&format!(" AT {at}"), usize::from(lanes.right))));
    Line::from(spans)
}

/// Puts a time into the cells from its own one on. The shown moment and marks stay; a time that would be
/// cut by them is left out, but for the sign of its cell.
fn put_time(cells: &mut [(String, Role)], text: &str) {
    let is_free = |cell: &(String, Role)| cell.0 == " ";
    let width = text.width();
    if cells.len() > width + 1 && cells[1..=width].iter().all(is_free) {
        for (cell, c) in cells[1..].iter_mut().zip(text.chars()) {
            cell.0 = c.to_string();
        }
    }
    if is_free(&cells[0]) {
        cells[0].0.replace_range(.., "╷");
    }
}

fn lane_line(brush: &DrawContext, lanes: &Lanes, lane: &Lane, is_selected: bool) -> Line<'static> {
    let app = brush.app;
    let pointer = if is_selected { "▸" } else { " " };
    let mut spans = vec![brush.span(Role::Text, pointer)];
    let (bus, width) = (usize::from(lanes.bus), usize::from(lanes.left - lanes.bus) - 2);
    if bus > 0 {
        let label = fit(&bus_label(app, lane.device.bus, bus - 1), bus - 1);
        spans.push(brush.span(Role::Muted, format!("{label} ")));
    }
    let label = app.device(lane.device).map_or_else(String::new, |device| {
        let own = device.name.as_ref().map(|name| name.quoted().to_string());
        let name = lane.board.as_ref().and_then(|board| board.name.clone()).or(own);
        let side = lane.board.as_ref().map(|board| board.letter().to_string()).unwrap_or_default();
        format!("{:>3}{side} {}", device.address.number(), name.as_deref().unwrap_or("?"))
    });
    let label_role = lane.board.as_ref().map_or(Role::Text, |board| side_role(board.side));
    spans.push(brush.span(label_role, format!("{} ", fit(&label, width))));
    spans.extend(runs(brush, lane.cells.iter().map(|cell| sign_of(*cell))));
    let (state, presence) = match lane.board {
        Some(LaneBoard { has_left: true, .. }) => {
            (Presence::Lost.name().to_owned(), Some(Presence::Lost))
        }
        _ => app.lane_state(lane.device),
    };
    let role = match presence {
        _ if state == "CONFLICT" => Role::Confirmed,
        None | Some(Presence::Online) => Role::Online,
        Some(Presence::Stale) => Role::Stale,
        Some(Presence::Silent) => Role::Silent,
        Some(Presence::Asleep) => Role::Asleep,
        Some(Presence::Lost) => Role::Lost,
    };
    spans.push(brush.span(role, fit(&format!(" {state}"), usize::from(lanes.right))));
    Line::from(spans)
}

/// Error frames, and the number of devices without a line.
fn error_line(brush: &DrawContext, lanes: &Lanes) -> Line<'static> {
    let label = fit(" errors", usize::from(lanes.left));
    let mut spans = vec![brush.span(Role::Muted, label)];
    let cells = lanes.errors.iter().map(|errors| match errors {
        0 => (" ".to_owned(), Role::Muted),
        _ => ("!".to_owned(), Role::Error),
    });
    spans.extend(runs(brush, cells));
    if lanes.hidden > 0 {
        let plural = if lanes.hidden == 1 { "" } else { "s" };
        let text = format!(" +{} lane{plural}", lanes.hidden);
        spans.push(brush.span(Role::Muted, fit(&text, usize::from(lanes.right))));
    }
    Line::from(spans)
}

/// Joins cells of one style to a span.
fn runs(brush: &DrawContext, cells: impl Iterator<Item = (String, Role)>) -> Vec<Span<'static>> {
    let mut spans: Vec<(String, Role)> = Vec::new();
    for (text, role) in cells {
        match spans.last_mut() {
            Some((last, same)) if *same == role => last.push_str(&text),
            _ => spans.push((text, role)),
        }
    }
    spans.into_iter().map(|(text, role)| brush.span(role, text)).collect()
}

fn sign_of(cell: LaneCell) -> (String, Role) {
    let (text, role) = match cell {
        LaneCell::Blank => (" ", Role::Muted),
        LaneCell::Working => ("━", Role::Online),
        LaneCell::NotWorking => ("─", Role::Text),
        LaneCell::Mode(mode) => (letter_of(mode), Role::Title),
        LaneCell::Stale => ("╌", Role::Stale),
        LaneCell::Gone => ("·", Role::Lost),
        LaneCell::Rebooted => ("↻", Role::Warning),
        LaneCell::Conflict(true) => ("▓", Role::Confirmed),
        LaneCell::Conflict(false) => ("▒", Role::Suspected),
        LaneCell::Moved(c) => return (c.to_string(), Role::Title),
    };
    (text.to_owned(), role)
}

/// Letter of a mode other than WORK. INIT is short, and shares its letter with IDLE otherwise.
fn letter_of(mode: Mode) -> &'static str {
    match mode {
        Mode::Init => "i",
        Mode::Arslv => "A",
        Mode::Cfg => "C",
        Mode::Boot => "B",
        Mode::Work => "━",
        Mode::Ufunc => "U",
        Mode::Idle => "I",
    }
}
