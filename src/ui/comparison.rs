//! What changed between two moments: a row for each difference, and the whole of the selected one
//! below. Takes the place of the page.
//!
//! ```text
//! ─ What changed: ▸A 12:00:20.000 (mark a) → B 12:00:45.000 (shown), 25.0 s ──────
//!    ADDR NAME      WHAT           A                      B
//! ▸~   10 FEED      version        AUGER 2.1, JAM 1.0     AUGER 2.2, JAM 1.1
//!  +   16 DIN       presence       –                      online
//!  =       can0     load, errors   6.2 %, 0               7.0 %, 0
//! ─ FEED @10: version ────────────────────────────────────────────────────────────
//!  A        AUGER 2.1, JAM 1.0
//!  B        AUGER 2.2, JAM 1.1
//!  between  12:00:31 rebooted +1
//! ```
//!
//! From 110 columns the rows have the last event between the moments, too.

use super::brush::{DrawContext, fit, fit_right, labelled, short_name};
use crate::app::{
    ComparedMoment, ComparisonNote, ComparisonRow, MomentComparison, clock_millis,
    format_time_of_day,
};
use crate::discovery::Presence;
use crate::finding::FindingState;
use crate::inventory::{DifferenceKind, DifferenceSide, DifferenceValue};
use crate::keymap::Action;
use crate::theme::Role;
use crate::time::Instant;
use ratatui::layout::Rect;
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Least width with the column EVENTS BETWEEN.
const WITH_EVENTS: u16 = 110;
/// Least height with the selected row below.
const WITH_DETAILS: u16 = 12;
/// Least cells of a value.
const LEAST_VALUE: usize = 10;
/// Lines of the selected row, with their rule.
const DETAILS: u16 = 5;

/// Widths of the columns.
#[derive(Clone, Copy)]
struct ComparisonColumns {
    bus: usize,
    name: usize,
    what: usize,
    before: usize,
    after: usize,
    events: usize,
}

impl ComparisonColumns {
    /// Columns as wide as what stands in them, as far as there is room.
    fn new(width: u16, has_buses: bool, comparison: &MomentComparison) -> Self {
        let has_events = width >= WITH_EVENTS;
        let bus = if has_buses { 8 } else { 0 };
        let (name, what, most) = match width {
            160.. => (13, 28, 32),
            WITH_EVENTS.. => (11, 15, 30),
            60.. => (10, 15, 28),
            _ => (8, 10, 10),
        };
        let rows = comparison.rows().unwrap_or_default().iter().map(|row| &row.difference);
        let longest = rows.clone().map(|it| it.what().width() + 1).max().unwrap_or(0);
        let what = longest.clamp(what, most);
        let left = usize::from(width).saturating_sub(8 + bus + name + what);
        let events = if has_events { left * 2 / 5 } else { 0 };
        let values = left - events;
        let cells = |value: &DifferenceValue| value.to_string().width() + 1;
        let before = rows.clone().map(|it| cells(&it.before)).max().unwrap_or(0);
        let after = rows.map(|it| cells(&it.after)).max().unwrap_or(0);
        let half = values / 2;
        let before = match (before <= half, after <= half) {
            (false, true) => before.min(values - after),
            (true, false) => before.max(LEAST_VALUE),
            _ => half,
        };
        let after = values.saturating_sub(before);
        Self { bus, name, what, before, after, events }
    }
}

/// Draws the comparison; nothing if none is open.
pub fn draw(brush: &mut DrawContext) {
    let app = brush.app;
    let Some(comparison) = app.comparison() else { return };
    let title = title(brush, comparison);
    let mut area = brush.panel(&title);
    let has_buses = app.buses().len() > 1;
    let columns = ComparisonColumns::new(area.width, has_buses, comparison);
    let header = brush.span(Role::Header, header(columns));
    brush.line(area, 0, &Line::from(header));
    area = Rect { y: area.y + 1, height: area.height.saturating_sub(1), ..area };
    let Some(rows) = comparison.rows() else {
        let text = "   comparing: a past state is being replayed";
        let line = Line::from(brush.span(Role::Muted, text));
        return brush.line(area, 1, &line);
    };
    if area.height >= WITH_DETAILS && comparison.selected().is_some() {
        area.height -= DETAILS;
        let below = Rect { y: area.bottom(), height: DETAILS, ..area };
        draw_selected(brush, comparison, below);
    }
    let notes = note_lines(brush, comparison, columns);
    let room = usize::from(area.height);
    let shown = if rows.is_empty() { 1 } else { rows.len() };
    let height = room.saturating_sub(notes.len().min(room / 3)).min(shown);
    if rows.is_empty() {
        let line = Line::from(brush.span(Role::Text, "   no difference"));
        brush.line(area, 0, &line);
    }
    let (selected, top) = comparison.position(height);
    for (at, row) in rows.iter().enumerate().skip(top).take(height) {
        let is_selected = selected == Some(at);
        let line = row_line(brush, (row, sign(row, rows)), columns, is_selected);
        let at = (at - top) as u16;
        brush.line(area, at, &line);
        if is_selected {
            brush.select(area, at);
        }
    }
    if top + height < rows.len() {
        let more = format!(" ↓ {} more ", rows.len() - top - height);
        let x = area.right().saturating_sub(more.chars().count() as u16 + 1);
        let at = Rect { x, width: area.right().saturating_sub(x), ..area };
        let line = Line::from(brush.span(Role::Muted, more));
        brush.line(at, height.saturating_sub(1) as u16, &line);
    }
    for (at, line) in notes.iter().enumerate() {
        brush.line(area, (height + at) as u16, line);
    }
}

/// Returns the title: both moments, the chosen one marked, and their distance.
fn title(brush: &DrawContext, comparison: &MomentComparison) -> String {
    let app = brush.app;
    let width = brush.screen.whole.width;
    let [before, after] = comparison.sides();
    let time = |at: Instant| match width {
        70.. => clock_millis(app, at),
        _ => format_time_of_day(app, at),
    };
    let side = |letter: &str, side: &ComparedMoment, is_chosen: bool| {
        let pointer = if is_chosen { "▸" } else { "" };
        let at = time(side.moment.time);
        match width {
            60.. => format!("{pointer}{letter} {at} ({})", side.label),
            _ => format!("{pointer}{letter} {at}"),
        }
    };
    let is_after = comparison.is_after_chosen();
    let (from, to) = (before.moment.time, after.moment.time);
    let (sign, apart) = if from <= to { ("", to.since(from)) } else { ("−", from.since(to)) };
    let begin = match width {
        100.. => "What changed: ",
        60.. => "Changed: ",
        _ => "",
    };
    let (before, after) = (side("A", before, !is_after), side("B", after, is_after));
    format!(" {begin}{before} → {after}, {sign}{:.1} s ", apart.as_secs_f64())
}

fn header(columns: ComparisonColumns) -> String {
    let bus = fit(if columns.bus > 0 { "BUS" } else { "" }, columns.bus);
    let events = if columns.events > 0 { "EVENTS BETWEEN" } else { "" };
    format!(
        "   {bus}ADDR {}{}{}{}{events}",
        fit("NAME", columns.name),
        fit("WHAT", columns.what),
        fit("A", columns.before),
        fit("B", columns.after),
    )
}

/// Returns text in exactly `width` cells, the last one blank.
fn cell(text: &str, width: usize) -> String {
    fit(text, width.saturating_sub(1)) + if width > 0 { " " } else { "" }
}

fn row_line(
    brush: &DrawContext,
    (row, (sign, role)): (&ComparisonRow, (&str, Role)),
    columns: ComparisonColumns,
    is_selected: bool,
) -> Line<'static> {
    let difference = &row.difference;
    let subject = difference.subject().cloned().unwrap_or_default();
    let address = subject.address.map(|address| address.to_string()).unwrap_or_default();
    let unknown = if subject.address.is_some() { "?" } else { "" };
    let bus = subject.bus.unwrap_or_default();
    Line::from(vec![
        brush.span(Role::Text, if is_selected { "▸" } else { " " }),
        brush.span(role, format!("{sign} ")),
        brush.span(Role::Muted, cell(&short_name(&bus, columns.bus.max(1) - 1), columns.bus)),
        brush.span(Role::Text, format!("{} ", fit_right(&address, 4))),
        brush.span(Role::Text, cell(subject.name.as_deref().unwrap_or(unknown), columns.name)),
        brush.span(Role::Text, cell(&difference.what(), columns.what)),
        brush.span(Role::Muted, cell(&difference.before.to_string(), columns.before)),
        brush.span(Role::Text, cell(&difference.after.to_string(), columns.after)),
        brush.span(Role::Muted, fit(&row.events, columns.events)),
    ])
}

/// Returns the sign of a row of `rows`, and its role.
fn sign(row: &ComparisonRow, rows: &[ComparisonRow]) -> (&'static str, Role) {
    let difference = &row.difference;
    let is = |value: &DifferenceValue, word: &str| *value == DifferenceValue::Word(word.to_owned());
    let is_gone =
        difference.after == DifferenceValue::Absent || is(&difference.after, Presence::Lost.name());
    match difference.kind {
        DifferenceKind::Presence if is_gone => ("○", Role::Lost),
        DifferenceKind::Presence if difference.before == DifferenceValue::Absent => {
            ("+", Role::New)
        }
        DifferenceKind::Finding if is(&difference.after, FindingState::Confirmed.name()) => {
            ("⚠", Role::Confirmed)
        }
        DifferenceKind::Finding if is(&difference.after, FindingState::Suspected.name()) => {
            ("?", Role::Suspected)
        }
        DifferenceKind::Finding => ("✓", Role::FileOk),
        // Several boards are a conflict, as sure as its findings are.
        DifferenceKind::Boards if has_several(&difference.after) => {
            let is_suspected = rows.iter().any(|other| {
                let is_here = other.difference.subject().map(|it| (&it.bus, it.address))
                    == difference.subject().map(|it| (&it.bus, it.address));
                is_here && is(&other.difference.after, FindingState::Suspected.name())
            });
            if is_suspected { ("?", Role::Suspected) } else { ("⚠", Role::Confirmed) }
        }
        _ => ("~", Role::Text),
    }
}

fn has_several(value: &DifferenceValue) -> bool {
    matches!(value, DifferenceValue::Words(words) if words.len() > 1)
}

/// Returns why all devices are new, what buses without a difference did, and what was not compared.
fn note_lines(
    brush: &DrawContext,
    comparison: &MomentComparison,
    columns: ComparisonColumns,
) -> Vec<Line<'static>> {
    let note = |note: &ComparisonNote| {
        let text = format!(
            " = {}     {}{}{}{}{}",
            cell(&short_name(&note.bus, columns.bus.max(1) - 1), columns.bus),
            cell("bus", columns.name),
            cell("load, errors", columns.what),
            cell(&note.before, columns.before),
            cell(&note.after, columns.after),
            fit(&note.events, columns.events),
        );
        Line::from(brush.span(Role::Muted, text))
    };
    let unknown = comparison.unknown().iter().map(|unknown| {
        let side = match unknown.side {
            DifferenceSide::Before => "A",
            DifferenceSide::After => "B",
        };
        Line::from(brush.span(Role::Muted, format!("   {}", unknown.text(side))))
    });
    let is_empty = comparison.is_before_devices().then(|| {
        let app = brush.app;
        let (side, later) = (app.key_of(Action::CompareSide), app.key_of(Action::CompareLater));
        let first = if comparison.is_after_chosen() { format!("{side} {later}") } else { later };
        let text = format!("   A is before the first device: all are new; {first} moves it on");
        Line::from(brush.span(Role::Muted, text))
    });
    is_empty.into_iter().chain(comparison.notes().iter().map(note)).chain(unknown).collect()
}

/// Draws the whole of the selected row.
fn draw_selected(brush: &mut DrawContext, comparison: &MomentComparison, area: Rect) {
    let Some(row) = comparison.selected() else { return };
    let difference = &row.difference;
    let subject = difference.subject().cloned().unwrap_or_default();
    let what = difference.what();
    let title = match (subject.address, subject.name) {
        (Some(address), Some(name)) => format!(" {name} @{address}: {what} "),
        (Some(address), None) => format!(" ? @{address}: {what} "),
        (None, _) => format!(" {}: {what} ", subject.bus.unwrap_or_default()),
    };
    brush.rule(Rect { height: 1, ..area }, Role::Border);
    let title = Line::from(brush.span(Role::Title, title));
    let inside = Rect { x: area.x + 1, width: area.width.saturating_sub(2), ..area };
    brush.line(inside, 0, &title);
    let mut lines = Vec::new();
    let (before, after) = (difference.before.to_string(), difference.after.to_string());
    for (label, text) in [("A        ", &before), ("B        ", &after), ("between  ", &row.events)]
    {
        let mut part = labelled(brush, label, Role::Text, text, inside.width);
        // The values before the rest of a long one.
        part.truncate(2);
        lines.extend(part);
    }
    let below = Rect { y: inside.y + 1, height: inside.height.saturating_sub(1), ..inside };
    for (at, line) in lines.iter().enumerate() {
        brush.line(below, at as u16, line);
    }
}
