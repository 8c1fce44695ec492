//! The theme picker: a list at the right of the page, which is shown in the selected theme.

use super::brush::{DrawContext, fit};
use crate::app::COLOURLESS_THEME;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::Line;

/// Width of the list, in columns.
const WIDTH: u16 = 38;

/// Draws the list; `selected` is the place of the selected theme.
pub fn draw(brush: &mut DrawContext, selected: usize) {
    let app = brush.app;
    let whole = brush.screen.whole;
    let top = brush.screen.tabs.bottom();
    let width = WIDTH.min(whole.width);
    let room = brush.screen.footer.y.saturating_sub(top);
    let themes: Vec<_> = app.themes().collect();
    let height = (themes.len() as u16 + 2).min(room);
    let area = Rect { x: whole.right() - width, y: top, width, height };
    if height < 3 {
        return;
    }
    let inside = usize::from(width).saturating_sub(2);
    let rule = |left: &str, text: &str, right: &str| {
        let rest = "─".repeat(inside.saturating_sub(text.chars().count()));
        format!("{left}{text}{rest}{right}")
    };
    let line = Line::from(brush.span(Role::BorderFocus, rule("┌", " Theme ", "┐")));
    brush.line(area, 0, &line);
    let rows = usize::from(height) - 2;
    let first = (selected + 1).saturating_sub(rows);
    for (row, (name, fault)) in themes.into_iter().skip(first).take(rows).enumerate() {
        let is_selected = row + first == selected;
        let (look, note) = match fault {
            Some(fault) => (Role::Error, format!("✗ {fault}")),
            None if name == COLOURLESS_THEME => (Role::Muted, "that of NO_COLOR".to_owned()),
            None => (Role::Muted, String::new()),
        };
        let sign = if is_selected { "▸ " } else { "  " };
        let line = Line::from(vec![
            brush.span(Role::BorderFocus, "│"),
            brush.span(Role::Text, format!("{sign}{} ", fit(name, 14))),
            brush.span(look, fit(&note, inside.saturating_sub(17))),
            brush.span(Role::BorderFocus, "│"),
        ]);
        let row = row as u16 + 1;
        brush.line(area, row, &line);
        if is_selected {
            brush.select(Rect { x: area.x + 1, width: width.saturating_sub(2), ..area }, row);
        }
    }
    let line = Line::from(brush.span(Role::BorderFocus, rule("└", "", "┘")));
    brush.line(area, height - 1, &line);
}
