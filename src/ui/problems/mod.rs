//! Page 4, Problems: a row per problem, and below the list the details of the selected one: the boards
//! of a conflict side by side, the evidence, finding texts, remedy, addresses and names. Why des.json
//! cannot be used stands below the list.

pub(super) mod boards;
mod details;
mod evidence;

use super::brush::{DrawContext, bus_label, fit, fit_right, labelled, set_hidden_rows};
use super::symbols;
use crate::app::{Page, Problem, ProblemsView, clock_millis, growing_length_text, length_text};
use crate::finding::FindingState;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Draws the list and the details.
pub fn draw(brush: &mut DrawContext) {
    draw_list(brush);
    details::draw(brush);
}

/// Returns the sign of a problem, the role of the sign, and that of the text.
fn roles(problem: &Problem) -> (&'static str, Role, Role) {
    let (sign, role) = symbols::of_finding_state(problem.state());
    match problem.state() {
        _ if problem.is_muted => (sign, Role::Muted, Role::Muted),
        FindingState::Cleared => (sign, role, Role::Muted),
        _ => (sign, role, Role::Text),
    }
}

/// Columns from which the list has the columns SINCE and LENGTH.
const WITH_TIME: u16 = 56;
/// Columns from which it has the columns SURE and EVIDENCE, and headlines with times.
const WIDE: u16 = 120;
/// Cells of a time of day with milliseconds, and a blank.
const SINCE: usize = 13;
/// Cells of the columns at the right end.
const LENGTH: usize = 8;
const SURE: usize = 11;
const EVIDENCE: usize = 9;

/// Cells of the column PROBLEM.
fn headline_width(brush: &DrawContext) -> usize {
    let width = brush.screen.list.width;
    let signs = 3;
    let mut taken = signs + bus_width(brush) + ADDRESS + 1;
    if width >= WITH_TIME {
        taken += SINCE + LENGTH + 1;
    }
    if width >= WIDE {
        taken += SURE + EVIDENCE;
    }
    usize::from(width).saturating_sub(taken)
}

fn draw_list(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let place = fit("WHERE", bus_width(brush) + ADDRESS);
    let title = if list.width < WITH_TIME {
        format!("   {place} PROBLEM")
    } else {
        let problem = fit("PROBLEM", headline_width(brush));
        let mut title =
            format!("   {place} {}{problem}{}", fit("SINCE", SINCE), fit_right("LENGTH", LENGTH));
        if list.width >= WIDE {
            title += "  ";
            title += &fit("SURE", SURE - 2);
            title += &fit_right("EVIDENCE", EVIDENCE);
        }
        title
    };
    let line = Line::from(brush.span(Role::Header, title));
    brush.line(header, 0, &line);
    let list = draw_file_problem(brush, list);
    let app = brush.app;
    let problems = app.problems_shown();
    if problems.is_empty() {
        if app.counts().is_file_broken && app.problems().is_empty() {
            return;
        }
        if app.page_filter(Page::Problems).is_on() {
            return brush.draw_no_match(list, "no problem matches the filter");
        }
        let view = app.view().problems_view;
        if view != ProblemsView::All && !app.problems().is_empty() {
            let text = match view {
                ProblemsView::Over => "no problem is over",
                ProblemsView::Muted => "no problem is muted",
                _ => "no open problem",
            };
            return brush.draw_empty_list(list, text);
        }
        if let Some(reason) = app.foreign_reason() {
            return brush.draw_empty_list(list, &reason);
        }
        // A bus that is not up may have problems that were not received.
        let text = if brush.cannot_receive() { "no problems so far" } else { "no problems found" };
        return brush.draw_empty_list(list, text);
    }
    let selected = app.view().problems.index(problems.keys());
    let height = usize::from(list.height);
    let top = app.view().problems.top(selected, problems.len(), height);
    let below = problems.len().saturating_sub(top + height);
    set_hidden_rows(brush.buffer, brush.theme, header, (top, below));
    for row in 0..height {
        let Some(problem) = problems.get(top + row) else { break };
        let is_selected = selected == Some(top + row);
        let line = problem_line(brush, &problem, list, is_selected);
        brush.line(list, row as u16, &line);
        if is_selected {
            brush.select(list, row as u16);
        }
    }
}

/// Draws why des.json files cannot be used, with the lines of the mistakes, at the bottom of the list.
/// Returns the area that is left for the problems.
fn draw_file_problem(brush: &mut DrawContext, list: Rect) -> Rect {
    let mut lines = Vec::new();
    for (_, file) in brush.app.files() {
        let Some(problem) = file.problem() else { continue };
        lines.push(Line::default());
        let text = problem.of_file(&file.name());
        lines.extend(labelled(brush, "  ✗ ", Role::Error, &text, list.width));
        for text in problem.excerpt().into_iter().flatten() {
            lines.push(Line::from(brush.span(Role::Text, format!("  {text}"))));
        }
    }
    let height = list.height.min(lines.len() as u16);
    let left = Rect { height: list.height - height, ..list };
    brush.lines(Rect { y: left.bottom(), height, ..list }, &lines, 0);
    left
}

fn problem_line(
    brush: &DrawContext,
    problem: &Problem,
    list: Rect,
    selected: bool,
) -> Line<'static> {
    let (sign, sign_role, plain) = roles(problem);
    let mut spans = vec![
        brush.span(Role::Text, if selected { "▸" } else { " " }),
        brush.span(sign_role, format!("{sign} ")),
        brush.span(plain, format!("{} ", place(brush, problem))),
    ];
    let headline = brush.app.headline(problem);
    let mut text = if list.width >= WIDE { headline.long } else { headline.short };
    if problem.is_muted {
        text.insert_str(0, "muted · ");
    }
    if list.width < WITH_TIME {
        spans.push(brush.span(plain, text));
        return Line::from(spans);
    }
    let since = format!("{} ", clock_millis(brush.app, problem.began()));
    spans.push(brush.span(Role::Muted, fit(&since, SINCE)));
    spans.push(brush.span(plain, fit(&text, headline_width(brush))));
    spans.push(brush.span(Role::Muted, fit_right(&length_of(brush, problem), LENGTH)));
    if list.width >= WIDE {
        spans.push(brush.span(plain, format!("  {}", fit(state_word(problem), SURE - 2))));
        let count = problem.count().max(problem.evidence().len() as u64);
        let count = if count == 0 { "–".to_owned() } else { count.to_string() };
        spans.push(brush.span(Role::Muted, fit_right(&count, EVIDENCE)));
    }
    Line::from(spans)
}

fn state_word(problem: &Problem) -> &'static str {
    match problem.state() {
        FindingState::Cleared => "over",
        state => state.name(),
    }
}

/// How long a problem is there, in whole seconds while it is, so that it changes once a second.
fn length_of(brush: &DrawContext, problem: &Problem) -> String {
    let began = problem.began();
    match problem.ended() {
        Some(ended) => length_text(ended.since(began)),
        None => growing_length_text(brush.app.display_time().since(began)),
    }
}

/// Cells of an address with its `@`.
const ADDRESS: usize = 5;

/// Cells of the bus in front of the address, with its blank; 0 for a single bus.
fn bus_width(brush: &DrawContext) -> usize {
    let buses = brush.app.buses();
    let longest = buses.iter().map(|bus| bus.name.width()).max().unwrap_or(0);
    let most = if brush.screen.list.width >= WITH_TIME { 12 } else { 6 };
    if buses.len() > 1 { longest.min(most) + 1 } else { 0 }
}

/// Returns the column WHERE: the bus if there are several, then the address, `bus` or `file`.
fn place(brush: &DrawContext, problem: &Problem) -> String {
    let width = bus_width(brush).saturating_sub(1);
    let name = problem.bus().map(|bus| bus_label(brush.app, bus, width));
    let (bus, address) = match (problem.head().key.address, name) {
        (Some(address), name) => (name.unwrap_or("file".to_owned()), format!("@{address}")),
        // An entry without an address.
        (None, Some(name)) if problem.head().key.name.is_some() => (name, "–".to_owned()),
        (None, Some(name)) => (name, if width > 0 { "" } else { "bus" }.to_owned()),
        (None, None) => ("file".to_owned(), if width > 0 { "" } else { "file" }.to_owned()),
    };
    match width {
        0 => fit(&address, ADDRESS),
        _ => format!("{} {}", fit(&bus, width), fit(&address, ADDRESS)),
    }
}
