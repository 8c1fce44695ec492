//! The list of marks: letter, moment, text. Takes the place of the page.

use super::brush::{DrawContext, fit};
use crate::app::{TimelineKind, clock_millis, format_duration};
use crate::keymap::Action;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::Line;

/// Draws the list; `selected` is the letter of the selected mark.
pub fn draw(brush: &mut DrawContext, selected: char) {
    let app = brush.app;
    let area = brush.panel(" Marks ");
    let header = Line::from(brush.span(Role::Header, "    TIME          AGO      EVENTS  TEXT"));
    brush.line(area, 0, &header);
    let list = Rect { y: area.y + 1, height: area.height.saturating_sub(1), ..area };
    let marks = app.marks().by_letter();
    let at = marks.iter().position(|mark| mark.letter == selected).unwrap_or_default();
    let height = usize::from(list.height).max(1);
    let top = (at + 1).saturating_sub(height);
    for (row, mark) in marks.iter().enumerate().skip(top).take(height) {
        let is_selected = row == at;
        let (time, now) = (mark.moment.time, app.now());
        let ago = format!("{} ago", format_duration(now.since(time)));
        let is_event = |kind: TimelineKind| !matches!(kind, TimelineKind::Mark(_));
        let lines = app.timeline().entries();
        let events = lines.filter(|line| line.last > time && is_event(line.kind)).count();
        let line = Line::from(vec![
            brush.span(Role::Text, if is_selected { "▸ " } else { "  " }),
            brush.span(Role::Mark, format!("{} ", mark.letter)),
            brush.span(Role::Text, format!("{}  ", clock_millis(app, time))),
            brush.span(Role::Muted, fit(&ago, 11)),
            brush.span(Role::Muted, format!("{events:>4}  ")),
            brush.span(Role::Text, mark.text.clone()),
        ]);
        let row = (row - top) as u16;
        brush.line(list, row, &line);
        if is_selected {
            brush.select(list, row);
        }
    }
    let used = marks.len().saturating_sub(top).min(height) as u16;
    let below = Rect { y: list.y + used, height: list.height.saturating_sub(used), ..list };
    let key = app.key_of(Action::GoTo);
    let text =
        format!("  A letter chooses its mark. On every page, {key} and a letter show its moment.");
    let note = Line::from(brush.span(Role::Muted, text));
    brush.line(below, 1, &note);
}
