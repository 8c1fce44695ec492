//! The rule below the status lines: names of the pages, the filter or the title of the evidence, the
//! views of the page, the shown moment; the divider in front of the details, and their title.

use super::brush::{DrawContext, fit};
use super::{moment, traffic};
use crate::app::{DeviceView, Focus, Page, PageFilter, TimelineView, TrafficView};
use crate::keymap::Action;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Least cells in which a filter is shown.
const LEAST: usize = 8;

/// Draws the rule, the divider and the title of the details.
pub fn draw(brush: &mut DrawContext) {
    draw_divider(brush);
    let area = brush.screen.tabs;
    if area.height == 0 {
        return;
    }
    brush.rule(area, Role::Border);
    if brush.screen.divider.height > 0 {
        brush.buffer[(brush.screen.divider.x, area.y)].set_symbol("┬");
    }
    let open = brush.app.view().page;
    let mut end = 0;
    let mut active = Rect::default();
    for (page, start, text) in brush.screen.tabs(open, brush.app.counts()) {
        let role = if page == open { Role::TabActive } else { Role::Tab };
        let width = text.width() as u16;
        end = start + width;
        let at = Rect { x: area.x + start, width: area.width.saturating_sub(start), ..area };
        if page == open {
            active = Rect { width: width.min(at.width), ..at };
        }
        let line = Line::from(brush.span(role, text));
        brush.line(at, 0, &line);
    }
    let shown = match &brush.app.view().evidence {
        Some(evidence) => Some(format!(" ◆ {} ", evidence.title)),
        None => traffic::title(brush.app)
            .filter(|_| open == Page::Traffic)
            .or_else(|| chip(brush.app.page_filter(open), brush.app.hidden_frames())),
    };
    let room = moment::start(brush).saturating_sub(end + 1);
    if let Some(text) = shown {
        // On narrow screens the end of the filter gives way.
        let width = usize::from(room);
        if width >= text.width().min(LEAST) {
            let text = if text.width() > width { fit(&text, width) } else { text };
            let line = Line::from(brush.span(Role::Match, text));
            brush.line(Rect { x: end + 1, width: room, ..area }, 0, &line);
        }
    } else if open == Page::Traffic {
        let view = brush.app.view().traffic_view.title();
        draw_views(brush, &TrafficView::ALL.map(TrafficView::title), view, view, end);
    } else if open == Page::Devices {
        let view = brush.app.view().devices_page.view.title();
        draw_views(brush, &DeviceView::ALL.map(DeviceView::title), view, view, end);
    } else if open == Page::Timeline {
        let views = TimelineView::all(area.width).iter().map(|view| view.title());
        let view = brush.app.view().timeline_shown().title();
        draw_views(brush, &views.collect::<Vec<_>>(), view, view, end);
    }
    if brush.app.past_moment().is_some() {
        brush.fill(area, Role::Frozen);
        brush.fill(active, Role::TabActive);
    }
}

/// Draws the line in front of the details, and their title.
fn draw_divider(brush: &mut DrawContext) {
    let (divider, at) = (brush.screen.divider, brush.screen.details_title);
    let is_focused = brush.app.view().focus == Focus::Details;
    let style = brush.style(if is_focused { Role::BorderFocus } else { Role::Border });
    for y in divider.top()..divider.bottom() {
        brush.buffer[(divider.x, y)].set_symbol("│").set_style(style);
    }
    if let Some(title) = title(brush).filter(|_| at.height > 0) {
        let line = Line::from(brush.span(Role::Title, format!(" {title} ")));
        brush.line(at, 0, &line);
    }
}

/// Returns the title of the details; `None` on the Timeline and without a selection.
fn title(brush: &DrawContext) -> Option<String> {
    let app = brush.app;
    match app.view().page {
        // Beside the list, the details begin with their title.
        Page::Devices if brush.screen.list.height > 0 => None,
        Page::Devices => {
            let title = super::details::title(app, app.selected_row()?);
            let is_history = app.view().devices_page.shows_history;
            Some(if is_history { format!("{title} · heartbeats") } else { title })
        }
        Page::Problems => app.selected_problem().map(|problem| app.headline(&problem).label),
        Page::Traffic => Some("Frame".to_owned()),
        Page::Timeline | Page::Bus => None,
    }
}

/// Draws the views of the page and their key at the right end of the rule, behind the column `end`; with
/// less room the open one as `alone`, without the key, or none.
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
    let right = moment::start(brush);
    let room = usize::from(right.saturating_sub(end + 2));
    let short = vec![brush.span(Role::Title, format!(" {open} "))];
    let fits = |spans: &&Vec<Span>| spans.iter().map(Span::width).sum::<usize>() <= room;
    if let Some(spans) = [&all, &one, &short].into_iter().find(fits) {
        let line = Line::from(spans.clone());
        let width = line.width() as u16;
        brush.line(Rect { x: right - width - 1, width, ..area }, 0, &line);
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
