//! The boards of a conflict side by side: a column each, and their heartbeats on one time axis.
//! Readable without colour: each board has its letter.

use super::super::brush::{DrawContext, fit, labelled};
use crate::app::{BeatCell, ConflictPanel, Problem, side_letter};
use crate::theme::Role;
use ratatui::text::{Line, Span};

/// Cells of the labels of the rows, and on a narrow screen.
const LABEL: usize = 12;
const NARROW_LABEL: usize = 7;
/// Columns below which labels are short.
const NARROW: u16 = 60;
/// Cells of the labels of the axis.
const AXIS_LABEL: usize = 9;
/// Cells of a column from which its rows have more in them.
const WIDE_COLUMN: u16 = 50;

/// The lines of a conflict, each in its own part: some give way on a low screen.
pub struct BoardLines {
    /// Columns without the services.
    pub columns: Vec<Line<'static>>,
    /// Services.
    pub services: Vec<Line<'static>>,
    /// Time axis and heartbeats.
    pub axis: Vec<Line<'static>>,
    /// Responses to one request.
    pub answers: Vec<Line<'static>>,
    /// What to do.
    pub remedy: Vec<Line<'static>>,
    /// The boards.
    pub panel: ConflictPanel,
}

/// Role of a board: of the first one, or of the others.
pub fn side_role(side: usize) -> Role {
    if side == 0 { Role::SideA } else { Role::SideB }
}

/// The letter of a board in its colour; `–` of none, `?` where it is not known.
pub fn side_span(brush: &DrawContext, side: Option<usize>, is_unknown: bool) -> Span<'static> {
    match side {
        Some(side) => brush.span(side_role(side), side_letter(side).to_string()),
        None => brush.span(Role::Muted, if is_unknown { "?" } else { "–" }),
    }
}

/// Returns the lines of a conflict; `None` for any other problem.
pub fn lines(brush: &DrawContext, problem: &Problem, width: u16) -> Option<BoardLines> {
    let labels = if width < NARROW { NARROW_LABEL } else { LABEL };
    let is_wide = width.saturating_sub(LABEL as u16) / 2 >= WIDE_COLUMN;
    let mut panel = brush.app.conflict_panel(problem, is_wide)?;
    let count = panel.titles.len().max(1);
    let room = usize::from(width).saturating_sub(labels + 1);
    let between = 2;
    let column = room.saturating_sub(between * (count - 1)) / count;
    if is_wide && column < usize::from(WIDE_COLUMN) {
        panel = brush.app.conflict_panel(problem, false)?;
    }
    let (mut columns, mut services) = (Vec::new(), Vec::new());
    if !panel.titles.is_empty() {
        let cells = panel
            .titles
            .iter()
            .enumerate()
            .map(|(at, title)| brush.span(side_role(panel.first + at), fit(title, column)));
        columns.push(row(brush, "", labels, cells.collect()));
    }
    for (label, cells) in &panel.rows {
        let cells = match &cells[..] {
            [all] if count > 1 => vec![brush.span(Role::Text, fit(all, room))],
            cells => cells.iter().map(|it| brush.span(Role::Text, fit(it, column))).collect(),
        };
        let part = if *label == "services" { &mut services } else { &mut columns };
        let label = if width < NARROW { short_label(label) } else { label };
        part.push(row(brush, label, labels, cells));
    }
    let remedy = labelled(brush, " → ", Role::New, &panel.remedy, width.saturating_sub(1));
    let (axis, answers) = axis(brush, problem, &panel, width);
    Some(BoardLines { columns, services, axis, answers, remedy, panel })
}

/// A label in at most five cells.
fn short_label(label: &str) -> &str {
    match label {
        "joined" => "since",
        "heartbeat" => "beat",
        "services" => "svc",
        "des.json" => "file",
        label => label,
    }
}

fn row(brush: &DrawContext, label: &str, width: usize, cells: Vec<Span<'static>>) -> Line<'static> {
    let mut spans = vec![brush.span(Role::Muted, format!(" {}", fit(label, width - 1)))];
    for (at, cell) in cells.into_iter().enumerate() {
        if at > 0 {
            spans.push(brush.span(Role::Border, "│ "));
        }
        spans.push(cell);
    }
    Line::from(spans)
}

/// Returns the axis with the heartbeats, and the row of responses.
fn axis(
    brush: &DrawContext,
    problem: &Problem,
    panel: &ConflictPanel,
    width: u16,
) -> (Vec<Line<'static>>, Vec<Line<'static>>) {
    /// Blank at the right end, as at the left.
    const MARGIN: usize = 1;
    let cells = usize::from(width).saturating_sub(AXIS_LABEL + MARGIN);
    let Some(axis) = brush.app.beats_on_axis(problem, &panel.sides, cells) else {
        return (Vec::new(), Vec::new());
    };
    let label = |text: &str| brush.span(Role::Muted, format!(" {}", fit(text, AXIS_LABEL - 1)));
    let mut beats = vec![label("beats")];
    beats.extend(axis.beats.iter().map(|cell| match cell {
        None => Span::raw(" "),
        Some(BeatCell { sign: '×', .. }) => brush.span(Role::Warning, "×"),
        Some(BeatCell { sign, side: Some(side) }) => brush.span(side_role(*side), sign.to_string()),
        Some(BeatCell { sign, side: None }) => brush.span(Role::Muted, sign.to_string()),
    }));
    let mut answers = vec![label("answers")];
    answers.extend(axis.answers.iter().map(|count| match count {
        None => Span::raw(" "),
        Some(count @ 2..=9) => brush.span(Role::Response, count.to_string()),
        Some(_) => brush.span(Role::Response, "+"),
    }));
    let time = Line::from(vec![label("time"), brush.span(Role::Muted, axis.ruler)]);
    (vec![time, Line::from(beats)], vec![Line::from(answers)])
}
