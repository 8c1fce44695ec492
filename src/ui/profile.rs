//! The values of the profile, with what the frames show of them; takes the place of the page. And the
//! line that says that devices send otherwise than the profile says.

use super::brush::{DrawContext, fit, set_hidden_rows};
use crate::app::{Decoded, ProfileRow, clock_millis, format_duration};
use crate::frame::Frame;
use crate::keymap::Action;
use crate::learning::Certainty;
use crate::theme::Role;
use crate::wire::profile::ValueOrigin;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Columns of the value in force and of the learnt one.
const VALUE_WIDTH: usize = 9;
/// Width from which the origins of values are words.
const WIDE: u16 = 100;
/// Lines of frames below the list.
const FRAME_LINES: u16 = 3;
/// Least height with them.
const FRAMES_HEIGHT: u16 = 14;

/// Draws the line, if there is one.
pub fn draw_banner(brush: &mut DrawContext) {
    let area = brush.screen.banner;
    let Some(difference) = brush.app.profile_difference().filter(|_| area.height > 0) else {
        return;
    };
    let key = brush.app.key_of(Action::ReviewProfile);
    let end = format!("{key} shows the profile ");
    let width = usize::from(area.width);
    let room = width.saturating_sub(end.width() + 2);
    let text = fit(&format!(" ≠ the frames show {difference}"), room);
    let gap = width.saturating_sub(text.width() + end.width());
    let line = Line::from(vec![
        brush.span(Role::Suspected, text),
        brush.span(Role::Muted, format!("{}{end}", " ".repeat(gap))),
    ]);
    brush.line(area, 0, &line);
}

/// Draws the list.
pub fn draw(brush: &mut DrawContext) {
    let review = brush.app.profile_review();
    let (frames, time) = (review.frames, format_duration(review.duration));
    let area = brush.panel(&format!(" Profile: {frames} frames in {time} "));
    let area = Rect { height: area.height.saturating_sub(brush.screen.time_bar.height), ..area };
    let origin = if is_wide(area) { "NOW                " } else { "NOW          " };
    let header = format!("      KEY                    {origin}LEARNT    SURE     EVIDENCE");
    brush.line(area, 0, &Line::from(brush.span(Role::Header, header)));
    let below = if area.height >= FRAMES_HEIGHT { FRAME_LINES + 1 } else { 0 };
    let list = Rect { y: area.y + 1, height: area.height.saturating_sub(1 + below), ..area };
    let height = usize::from(list.height).max(1);
    let top = (review.selected + 1).saturating_sub(height);
    let hidden_below = review.rows.len().saturating_sub(top + height);
    let header = Rect { height: area.height.min(1), ..area };
    set_hidden_rows(brush.buffer, brush.theme, header, (top, hidden_below));
    for (place, row) in review.rows.iter().enumerate().skip(top).take(height) {
        let line = Line::from(row_spans(brush, row, is_wide(area), place == review.selected));
        let at = (place - top) as u16;
        brush.line(list, at, &line);
        if place == review.selected {
            brush.select(list, at);
        }
    }
    if below == 0 {
        return;
    }
    let rule = Rect { y: list.bottom(), height: 1, ..area };
    brush.rule(rule, Role::Border);
    let Some(row) = review.rows.get(review.selected) else { return };
    let evidence = row.proposal.as_ref().map(|(_, proposal)| format!(": {}", proposal.evidence));
    let title = format!(" {}{} ", row.key.name(), evidence.unwrap_or_default());
    let title = fit_title(&title, usize::from(area.width).saturating_sub(3));
    let title = Line::from(brush.span(Role::TabActive, title));
    brush.line(Rect { x: 1, ..rule }, 0, &title);
    let frames_area = Rect { y: rule.bottom(), height: FRAME_LINES, ..area };
    if let Some((_, proposal)) = &row.proposal {
        for (at, frame) in proposal.frames.iter().take(usize::from(FRAME_LINES)).enumerate() {
            let line = frame_line(brush, frame);
            brush.line(frames_area, at as u16, &line);
        }
        return;
    }
    let text = match row.origin {
        _ if !row.reason.is_empty() => format!("not known: {}", row.reason),
        ValueOrigin::Assumed => "assumed: built in; frames do not show it".to_owned(),
        ValueOrigin::Given => "given in a file".to_owned(),
        ValueOrigin::Learnt => "learnt from frames".to_owned(),
    };
    brush.line(frames_area, 0, &Line::from(brush.span(Role::Muted, format!(" {text}"))));
}

/// Returns true if the origins of values are words.
fn is_wide(area: Rect) -> bool {
    area.width >= WIDE
}

/// A title, cut if it is wider than the room.
fn fit_title(title: &str, room: usize) -> String {
    if title.width() > room { fit(title, room) } else { title.to_owned() }
}

fn row_spans(
    brush: &DrawContext,
    row: &ProfileRow,
    is_wide: bool,
    is_selected: bool,
) -> Vec<Span<'static>> {
    let sign = if is_selected { "▸" } else { " " };
    let tick = match row.proposal {
        None => "   ",
        Some(_) if row.is_ticked => "[x]",
        Some(_) => "[ ]",
    };
    let now_role = match row.origin {
        ValueOrigin::Assumed => Role::Muted,
        _ => Role::Text,
    };
    let origin = match row.origin {
        origin if is_wide => origin.word(),
        ValueOrigin::Assumed => "≈",
        ValueOrigin::Given => "",
        ValueOrigin::Learnt => "✓",
    };
    let now = format!("{} {origin}", fit(&row.now.to_string(), VALUE_WIDTH));
    let mut spans = vec![
        brush.span(Role::Text, format!("{sign}{tick} {} ", fit(row.key.name(), 22))),
        brush.span(now_role, fit(&now, if is_wide { 18 } else { 12 })),
    ];
    match &row.proposal {
        Some((_, proposal)) => {
            let mark = if row.differs() { "≠" } else { " " };
            let (role, sure) = match proposal.certainty {
                Certainty::Guess => (Role::Muted, "guess"),
                Certainty::Likely => (Role::Text, "likely"),
                Certainty::Certain => (Role::Text, "certain"),
            };
            let value = fit(&proposal.value.to_string(), VALUE_WIDTH);
            let learnt_role = if row.differs() { Role::Suspected } else { Role::Text };
            spans.push(brush.span(learnt_role, format!("{mark} {value}")));
            spans.push(brush.span(role, format!(" {}", fit(sure, 8))));
            spans.push(brush.span(Role::Muted, proposal.evidence.clone()));
        }
        None if !row.reason.is_empty() => {
            let text = format!("  {} {} {}", fit("–", VALUE_WIDTH), fit("–", 8), row.reason);
            spans.push(brush.span(Role::Muted, text));
        }
        None => {}
    }
    spans
}

/// Time, identifier, data and meaning of a frame.
fn frame_line(brush: &DrawContext, frame: &Frame) -> Line<'static> {
    let app = brush.app;
    let data: Vec<String> = frame.data().iter().map(|byte| format!("{byte:02X}")).collect();
    let id = frame.platform_id().unwrap_or_default();
    let text = format!(" {} {id:08X} {}", clock_millis(app, frame.time), data.join(" "));
    let meaning = Decoded::of(app, frame).meaning();
    Line::from(vec![brush.span(Role::Text, text), brush.span(Role::Muted, format!("  {meaning}"))])
}
