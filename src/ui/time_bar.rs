//! The time bar above the footer: the whole capture or log, and the shown moment in it.

use super::brush::DrawContext;
use super::moment;
use crate::app::{BAR_LEFT, BarSign, format_time_of_day};
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

/// Draws the bar.
pub fn draw(brush: &mut DrawContext) {
    let area = brush.screen.time_bar;
    let bar = brush.app.time_bar();
    if area.height == 0 || bar.cells.is_empty() {
        return;
    }
    let app = brush.app;
    let frozen = app.past_moment().map(|moment| moment.time);
    let (shown, read) = (bar.cell(frozen.unwrap_or(bar.read)), bar.cell(bar.read));
    let is_all_read = bar.read >= bar.part.1;
    let (begin, end) = bar.part;
    let left = if bar.has_dropped || begin > bar.begin { "├…" } else { " ├" };
    let right = if end < bar.end { "…┤" } else { "┤ " };
    let mut spans = vec![
        brush.span(Role::Muted, format!(" {}", format_time_of_day(app, begin))),
        brush.span(Role::Border, left),
    ];
    for (at, sign) in bar.cells.iter().enumerate() {
        let (text, role) = sign_of(*sign);
        spans.push(match at {
            _ if at == shown => brush.span(Role::Title, "▼"),
            // Not read yet.
            _ if at > read && !is_all_read => brush.span(Role::Muted, " "),
            // What came later than the shown moment.
            _ if at > shown => Span::styled(text, brush.style(Role::Muted).dim()),
            _ => brush.span(role, text),
        });
    }
    spans.push(brush.span(Role::Border, right));
    spans.push(brush.span(Role::Muted, format!("{}  ", format_time_of_day(app, end))));
    spans.push(moment::word(brush));
    debug_assert_eq!(usize::from(BAR_LEFT), spans[0].width() + spans[1].width());
    let line = Line::from(spans);
    brush.line(Rect { height: 1, ..area }, 0, &line);
    if frozen.is_some() {
        brush.fill(area, Role::Frozen);
    }
}

fn sign_of(sign: BarSign) -> (String, Role) {
    match sign {
        BarSign::Quiet => ("·".into(), Role::Muted),
        BarSign::Event => ("╷".into(), Role::Text),
        BarSign::Errors => ("!".into(), Role::Warning),
        BarSign::Lost => ("×".into(), Role::Warning),
        BarSign::Suspected => ("?".into(), Role::Suspected),
        BarSign::Conflict => ("▒".into(), Role::Confirmed),
        BarSign::Mark(letter) => (letter.to_string(), Role::Mark),
    }
}
