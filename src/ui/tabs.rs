//! The rule below the status lines: names of the pages, the filter or the title of the evidence,
//! and the title of the details; and the divider in front of the details.

use super::brush::{DrawContext, fit};
use crate::app::{Focus, Page, PageFilter, RowKey, TimelineView, TrafficView};
use crate::keymap::Action;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Least cells in which a filter is shown.
const LEAST: usize = 8;

/// Draws the rule and the divider.
pub fn draw(brush: &mut DrawContext) {
    let area = brush.screen.tabs;
    if area.height == 0 {
        return;
    }
    brush.rule(area, Role::Border);
    let open = brush.app.view().page;
    let mut end = 0;
    for (page, start, text) in brush.screen.tabs(open, brush.app.counts()) {
        let role = if page == open { Role::TabActive } else { Role::Tab };
        end = start + text.width() as u16;
        let at = Rect { x: area.x + start, width: area.width.saturating_sub(start), ..area };
        let line = Line::from(brush.span(role, text));
        brush.line(at, 0, &line);
    }
    let screen = brush.screen;
    let focused = brush.app.view().focus == Focus::Details;
    let line_role = if focused { Role::BorderFocus } else { Role::Border };
    let details = screen.details;
    let shown = match &brush.app.view().evidence {
        Some(evidence) => Some(format!(" ◆ {} ", evidence.title)),
        None => chip(brush.app.page_filter(open), brush.app.hidden_frames()),
    };
    // Details in the place of the list are named here instead.
    let mut shown = shown.filter(|_| !screen.details_alone());
    let room = if details.height > 0 && screen.divider.height > 0 {
        screen.divider.x.saturating_sub(end)
    } else {
        area.width.saturating_sub(end)
    };
    let room_for_text = usize::from(room.saturating_sub(1));
    // On narrow screens the filter moves to the right end, in front of the details.
    let is_beside = |text: &String| room_for_text >= text.width().min(LEAST);
    if let Some(text) = shown.take_if(|text| is_beside(text)) {
        let text = if text.width() > room_for_text { fit(&text, room_for_text) } else { text };
        let line = Line::from(brush.span(Role::Match, text));
        let at = Rect { x: end + 1, width: room.saturating_sub(1), ..area };
        end += 1 + line.width() as u16;
        brush.line(at, 0, &line);
    }
    let is_free = shown.is_none() && !screen.details_alone();
    if open == Page::Traffic && is_free && brush.app.view().evidence.is_none() {
        let view = brush.app.view().traffic_view.title();
        draw_views(brush, &TrafficView::ALL.map(TrafficView::title), view, view, end);
    }
    if open == Page::Timeline && is_free {
        let views = TimelineView::all(area.width).iter().map(|view| view.title());
        let view = brush.app.view().timeline_shown().title();
        draw_views(brush, &views.collect::<Vec<_>>(), view, view, end);
    }
    if details.height == 0 || screen.lower_rule.y + 1 == details.y {
        return;
    }
    let mut at = Rect { x: details.x, width: details.width, ..area };
    if screen.divider.height > 0 {
        // On narrow screens the names of the pages reach past the divider.
        let from = end.max(details.x);
        at = Rect { x: from, width: area.right().saturating_sub(from), ..area };
        brush.rule(at, line_role);
        if end <= screen.divider.x {
            let cell = &mut brush.buffer[(screen.divider.x, area.y)];
            cell.set_symbol("┬");
        }
        let style = brush.style(line_role);
        for y in screen.divider.top()..screen.divider.bottom() {
            brush.buffer[(screen.divider.x, y)].set_symbol("│").set_style(style);
        }
    } else {
        at.x = end + 1;
        at.width = area.right().saturating_sub(at.x);
    }
    if let Some(title) = title(brush) {
        let line = Line::from(brush.span(Role::Title, format!(" {title} ")));
        let name = Rect { x: at.x + 1, width: at.width.saturating_sub(2), ..at };
        brush.line(name, 0, &line);
        let used = name.width.min(line.width() as u16) + 1;
        at = Rect { x: at.x + used, width: at.width.saturating_sub(used), ..at };
    }
    let room = usize::from(at.width.saturating_sub(2));
    if let Some(text) = shown.filter(|text| room >= text.width().min(LEAST)) {
        let text = if text.width() > room { fit(&text, room) } else { text };
        let width = text.width() as u16;
        let line = Line::from(brush.span(Role::Match, text));
        brush.line(Rect { x: at.right().saturating_sub(width + 1), width, ..at }, 0, &line);
    }
}

/// Returns the title of the details; `None` on the Timeline and without a selection.
fn title(brush: &DrawContext) -> Option<String> {
    let app = brush.app;
    match app.view().page {
        Page::Devices => {
            let row = app.selected_row()?;
            let name = row.name.as_ref().map_or("?".to_owned(), |it| it.quoted().to_string());
            Some(match (&row.key, row.address) {
                (RowKey::Device(_), Some(address)) => format!("{name} @{address}"),
                _ => name,
            })
        }
        // The addresses first: the end is cut.
        Page::Problems => app.selected_problem().map(|problem| {
            let places = problem.addresses().into_iter().map(|address| format!("@{address}"));
            places.chain([problem.headline().into_owned()]).collect::<Vec<String>>().join(" ")
        }),
        Page::Traffic => Some("Frame".to_owned()),
        Page::Timeline | Page::Bus => None,
    }
}

/// Draws the views of the page and their key at the right end of the rule, behind the column `end`; with
/// less room the open one as `alone`, or none.
pub fn draw_views(
    brush: &mut DrawContext,
    titles: &[&'static str],
    open: &str,
    alone: &str,
    end: u16,
) {
    let area = brush.screen.tabs;
    if area.height == 0 {
        return;
    }
    let key = brush.app.keymap().keys_of(Action::Identifiers).next();
    let key = key.map(|key| format!(" ({key})")).unwrap_or_default();
    let mut all = vec![brush.span(Role::Muted, " ")];
    for (at, title) in titles.iter().enumerate() {
        if at > 0 {
            all.push(brush.span(Role::Muted, " · "));
        }
        let role = if *title == open { Role::Title } else { Role::Muted };
        all.push(brush.span(role, *title));
    }
    all.push(brush.span(Role::Muted, format!("{key} ")));
    let one = vec![
        brush.span(Role::Title, format!(" {alone}")),
        brush.span(Role::Muted, format!("{key} ")),
    ];
    let room = usize::from(area.width.saturating_sub(end + 2));
    let fits = |spans: &&Vec<Span>| spans.iter().map(Span::width).sum::<usize>() <= room;
    if let Some(spans) = [&all, &one].into_iter().find(fits) {
        let line = Line::from(spans.clone());
        let width = line.width() as u16;
        brush.line(Rect { x: area.right() - width - 1, width, ..area }, 0, &line);
    }
}

/// The filter of the page and how many frames it hides.
fn chip(filter: &PageFilter, hidden: Option<u64>) -> Option<String> {
    let text = filter.text().trim();
    match (filter.is_on(), hidden) {
        _ if text.is_empty() => None,
        (false, _) => Some(format!(" off /{text} ")),
        (true, Some(hidden)) => Some(format!(" /{text}  {hidden} hidden ")),
        (true, None) => Some(format!(" /{text} ")),
    }
}
