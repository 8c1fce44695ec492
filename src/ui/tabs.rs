//! The rule below the status lines: names of the pages, the filter or the title of the evidence, the
//! views of the page, the shown moment; the divider in front of the details, and their title.

use super::brush::{DrawContext, fit};
use super::{moment, traffic};
use crate::app::{
    ChartSpan, DeviceView, Focus, Page, PageFilter, ProblemsView, TimelineView, TrafficView,
};
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
    let room = moment::start(brush).saturating_sub(end + 1);
    match PageTitle::of(brush) {
        // On narrow screens the end of the filter gives way.
        PageTitle::Text(text, shorter) if usize::from(room) >= text.width().min(LEAST) => {
            let is_wide = |text: &String| text.width() > usize::from(room);
            // A number that is cut would be another one.
            let text = if is_wide(&text) { shorter.unwrap_or(text) } else { text };
            let text = if is_wide(&text) { fit(&text, usize::from(room)) } else { text };
            let line = Line::from(brush.span(Role::Match, text));
            brush.line(Rect { x: end + 1, width: room, ..area }, 0, &line);
        }
        PageTitle::Views(views) => draw_views(brush, &views, end),
        _ => {}
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

/// The views of the open page.
struct PageViews {
    titles: Vec<&'static str>,
    open: &'static str,
    /// Text of the open one where it stands alone.
    alone: String,
}

impl PageViews {
    fn new(titles: impl IntoIterator<Item = &'static str>, open: &'static str) -> Self {
        Self { titles: titles.into_iter().collect(), open, alone: open.to_owned() }
    }

    fn of(brush: &DrawContext) -> Option<Self> {
        let (app, view) = (brush.app, brush.app.view());
        Some(match view.page {
            Page::Traffic => {
                Self::new(TrafficView::ALL.map(TrafficView::title), view.traffic_view.title())
            }
            Page::Devices => {
                let open = view.devices_page.view.title();
                Self::new(DeviceView::ALL.map(DeviceView::title), open)
            }
            Page::Timeline => {
                let all = TimelineView::all(brush.screen.tabs.width).iter();
                Self::new(all.map(|view| view.title()), view.timeline_shown().title())
            }
            // The title of details in the place of the list stands there.
            Page::Problems if brush.screen.list.height == 0 => return None,
            Page::Problems => {
                Self::new(ProblemsView::ALL.map(ProblemsView::title), view.problems_view.title())
            }
            Page::Bus => {
                let open = app.chart_span();
                let last = if open == ChartSpan::All { "" } else { "last " };
                let alone = format!("{last}{}", open.title());
                Self { alone, ..Self::new(ChartSpan::ALL.map(ChartSpan::title), open.title()) }
            }
        })
    }

    /// Returns all views and their key; the open one and the key; the open one.
    fn texts(&self, brush: &DrawContext) -> [Vec<Span<'static>>; 3] {
        let key = brush.app.keymap().keys_of(Action::Identifiers).next();
        let key = key.map(|key| format!(" ({key})")).unwrap_or_default();
        let mut all = vec![brush.span(Role::Muted, " ")];
        for (at, title) in self.titles.iter().enumerate() {
            if at > 0 {
                all.push(brush.span(Role::Muted, " · "));
            }
            let role = if *title == self.open { Role::Title } else { Role::Muted };
            all.push(brush.span(role, *title));
        }
        all.push(brush.span(Role::Muted, format!("{key} ")));
        let one = vec![
            brush.span(Role::Title, format!(" {}", self.alone)),
            brush.span(Role::Muted, format!("{key} ")),
        ];
        [all, one, vec![brush.span(Role::Title, format!(" {} ", self.open))]]
    }
}

/// What stands between the names of the pages and the moment.
enum PageTitle {
    /// The filter, the title of the evidence or of a list; and a shorter text.
    Text(String, Option<String>),
    Views(PageViews),
    None,
}

impl PageTitle {
    fn of(brush: &DrawContext) -> Self {
        let app = brush.app;
        let open = app.view().page;
        let alone = |text| (text, None);
        let text = if let Some(evidence) = &app.view().evidence {
            Some(alone(format!(" ◆ {} ", evidence.title)))
        } else {
            let title = traffic::title(app).filter(|_| open == Page::Traffic).map(alone);
            let filter = app.page_filter(open);
            let chip_of = |hidden| chip(filter, hidden);
            title
                .or_else(|| Some((chip_of(app.hidden_rows_shown())?, chip_of(None))))
                .or_else(|| debug_limit(brush).filter(|_| open == Page::Traffic).map(alone))
        };
        match text {
            Some((text, shorter)) => Self::Text(text, shorter),
            None => PageViews::of(brush).map_or(Self::None, Self::Views),
        }
    }
}

/// Returns the cells that the title of the page wants beside the moment, and those with which it is
/// shown at all. A view that is the first of its page needs no name, unless the first line has the time
/// of the moment; so does the end of a filter.
pub fn title_cells(brush: &DrawContext) -> (u16, u16) {
    let is_past = brush.app.past_moment().is_some();
    let (wanted, least) = match PageTitle::of(brush) {
        PageTitle::Text(text, _) => {
            let least = text.width().min(LEAST);
            (if is_past { text.width() } else { least }, least)
        }
        PageTitle::Views(views) if is_past || views.titles.first() != Some(&views.open) => {
            // With blanks, and the rule at one side.
            let cells = views.open.width() + 3;
            (cells, cells)
        }
        PageTitle::Views(_) | PageTitle::None => (0, 0),
    };
    (wanted as u16, least as u16)
}

/// Draws the views of the page and their key at the right end of the rule, behind the column `end`; with
/// less room the open one, without the key, or none.
fn draw_views(brush: &mut DrawContext, views: &PageViews, end: u16) {
    let area = brush.screen.tabs;
    let right = moment::start(brush);
    let room = usize::from(right.saturating_sub(end + 2));
    let fits = |spans: &Vec<Span>| spans.iter().map(Span::width).sum::<usize>() <= room;
    if let Some(spans) = views.texts(brush).into_iter().find(fits) {
        let line = Line::from(spans);
        let width = line.width() as u16;
        brush.line(Rect { x: right - width - 1, width, ..area }, 0, &line);
    }
}

/// What is shown of many DEBUG messages.
fn debug_limit(brush: &DrawContext) -> Option<String> {
    let hidden = brush.app.hidden_frames_shown().filter(|_| brush.app.is_debug_limited())?;
    Some(format!(" {hidden} DEBUG hidden "))
}

/// The filter of the page and how many rows it hides.
fn chip(filter: &PageFilter, hidden: Option<u64>) -> Option<String> {
    let text = filter.text().trim();
    match (filter.is_on(), hidden) {
        _ if text.is_empty() => None,
        (false, _) => Some(format!(" off /{text} ")),
        (true, Some(hidden)) => Some(format!(" /{text}  {hidden} hidden ")),
        (true, None) => Some(format!(" /{text} ")),
    }
}
