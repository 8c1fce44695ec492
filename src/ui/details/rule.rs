//! The rule above the details below the list: their title, and the keys from the device to its
//! frames, events, heartbeats and problem.

use super::title;
use crate::app::Focus;
use crate::keymap::Action;
use crate::theme::Role;
use crate::ui::brush::DrawContext;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

/// Draws the rule; `has_history`: the heartbeat history is below it.
pub fn draw(brush: &mut DrawContext, has_history: bool) {
    let area = brush.screen.details_rule;
    let app = brush.app;
    let is_focused = app.view().focus == Focus::Details;
    brush.rule(area, if is_focused { Role::BorderFocus } else { Role::Border });
    let Some(row) = app.selected_row() else { return };
    let mut title = title(app, row);
    if has_history {
        title.push_str(" · heartbeats, a cell is one period, 60 a line");
    }
    let line = Line::from(brush.span(Role::Title, format!(" {title} ")));
    let name = Rect { x: area.x + 1, width: area.width.saturating_sub(2), ..area };
    brush.line(name, 0, &line);
    let end = name.x + (line.width() as u16).min(name.width);
    let mut hints = vec![(Action::Frames, "frames"), (Action::Events, "events")];
    if has_history {
        hints = vec![(Action::Heartbeats, "closes")];
    } else {
        hints.push((Action::Heartbeats, "heartbeats"));
        if row.suspected || row.state == crate::app::RowState::Conflict {
            hints.push((Action::Problem, "problem"));
        }
    }
    let mut spans: Vec<Span> = Vec::new();
    for (at, (action, word)) in hints.into_iter().enumerate() {
        if at > 0 {
            spans.push(brush.span(Role::Border, "─"));
        }
        spans.push(brush.span(Role::HintKey, format!(" {}", app.key_of(action))));
        spans.push(brush.span(Role::Muted, format!(" {word} ")));
    }
    let line = Line::from(spans);
    let width = line.width() as u16;
    if end + width + 2 <= area.right() {
        brush.line(Rect { x: area.right() - width - 1, width, ..area }, 0, &line);
    }
}
