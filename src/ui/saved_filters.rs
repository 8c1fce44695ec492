//! The list of the saved filters of the page. Takes the place of the page.

use super::brush::DrawContext;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::Line;

/// Draws the list; `selected` is the place of the selected filter.
pub fn draw(brush: &mut DrawContext, selected: usize) {
    let app = brush.app;
    let page = app.view().page;
    let area = brush.panel(&format!(" Filters of {} ", page.title()));
    let filters = app.saved_filters(page);
    let height = usize::from(area.height).max(1);
    let top = (selected + 1).saturating_sub(height);
    for (place, filter) in filters.iter().enumerate().skip(top).take(height) {
        let is_selected = place == selected;
        let digit = if place < 9 { (place + 1).to_string() } else { " ".to_owned() };
        let line = Line::from(vec![
            brush.span(Role::Text, if is_selected { "▸ " } else { "  " }),
            brush.span(Role::HintKey, format!("{digit} ")),
            brush.span(Role::Text, filter.line.clone()),
        ]);
        let row = (place - top) as u16;
        brush.line(area, row, &line);
        if is_selected {
            brush.select(area, row);
        }
    }
    let used = filters.len().saturating_sub(top).min(height) as u16;
    let below = Rect { y: area.y + used, height: area.height.saturating_sub(used), ..area };
    let note = "  A digit sets its filter. Ctrl-s in the prompt of a filter saves it.";
    brush.line(below, 1, &Line::from(brush.span(Role::Muted, note)));
}
