//! Page 3, Timeline: a line for each story, and for each step of those that are open, newest at the
//! bottom.
//!
//! StoryColumns that give way, in this order: TO, LENGTH (it stands in front of WHAT then), the
//! milliseconds of FROM. Does not know what belongs to a story.

use super::brush::{DrawContext, bus_cell, bus_label, fit, fit_right, short_file_name};
use super::timeline::shows_bus;
use super::{lanes, story_kinds};
use crate::app::{
    LineKey, Page, Story, StoryLine, StorySign, StoryStep, TimelineEntry, clock_millis,
    format_time_of_day,
};
use crate::discovery::Presence;
use crate::finding::FindingState;
use crate::theme::Role;
use crate::time::Instant;
use ratatui::text::{Line, Span};

/// Least widths with the columns TO, LENGTH and with milliseconds.
const TO_COLUMNS: u16 = 96;
const LENGTH_COLUMNS: u16 = 88;
const MILLIS_COLUMNS: u16 = 56;
/// Cells of a time with milliseconds, and without.
const TIME_WIDTH: usize = 12;
const SHORT_TIME_WIDTH: usize = 8;
/// Cells of LENGTH: `59m59s`, `59.9 s`.
const LENGTH_WIDTH: usize = 7;

/// The columns of the page.
struct StoryColumns {
    has_to: bool,
    has_length: bool,
    has_millis: bool,
    has_bus: bool,
    who: usize,
}

impl StoryColumns {
    fn of(brush: &DrawContext) -> Self {
        let width = brush.screen.list.width;
        Self {
            has_to: width >= TO_COLUMNS,
            has_length: width >= LENGTH_COLUMNS,
            has_millis: width >= MILLIS_COLUMNS,
            has_bus: shows_bus(brush),
            who: match width {
                0..MILLIS_COLUMNS => 8,
                MILLIS_COLUMNS..TO_COLUMNS => 13,
                _ => 16,
            },
        }
    }

    fn time_width(&self) -> usize {
        if self.has_millis { TIME_WIDTH } else { SHORT_TIME_WIDTH }
    }

    fn time(&self, brush: &DrawContext, at: Instant) -> String {
        if self.has_millis {
            clock_millis(brush.app, at)
        } else {
            format_time_of_day(brush.app, at)
        }
    }
}

/// Draws the page.
pub fn draw(brush: &mut DrawContext) {
    lanes::draw(brush);
    let keys = brush.app.lines_shown();
    story_kinds::draw_rule(brush, keys.iter().filter(|key| key.step == 0).count());
    let (header, list) = (brush.screen.header, brush.screen.list);
    if list.height == 0 {
        return;
    }
    let columns = StoryColumns::of(brush);
    let mut title = format!("   {} ", fit("FROM", columns.time_width()));
    if columns.has_to {
        title += &fit("TO", TIME_WIDTH + 1);
    }
    if columns.has_length {
        title += &fit_right("LENGTH", LENGTH_WIDTH);
        title += "  ";
    }
    if columns.has_bus {
        title += "BUS    ";
    }
    title += &fit("WHO", columns.who + 1);
    title += if columns.has_length { "WHAT" } else { "LENGTH, WHAT" };
    let line = Line::from(brush.span(Role::Header, title));
    brush.line(header, 0, &line);
    let app = brush.app;
    if keys.is_empty() {
        if app.page_filter(Page::Timeline).is_on() {
            return brush.draw_no_match(list, "no event matches the filter");
        }
        let text = if app.hidden_kinds().is_empty() { "no events yet" } else { "all are hidden" };
        let line = Line::from(brush.span(Role::Muted, format!("   {text}")));
        return brush.line(list, 1, &line);
    }
    let height = usize::from(list.height);
    let selected = app.view().timeline.index(keys.iter());
    let top = match selected {
        Some(_) => app.view().timeline.top(selected, keys.len(), height),
        None => keys.len().saturating_sub(height),
    };
    for (row, key) in keys.iter().skip(top).take(height).enumerate() {
        let is_selected = selected == Some(top + row);
        let pointer = if is_selected { "▸" } else { " " };
        let mut line = Line::from(brush.span(Role::Text, pointer));
        line.spans.extend(line_of(brush, &columns, *key));
        brush.line(list, row as u16, &line);
        if is_selected {
            brush.select(list, row as u16);
        }
    }
}

fn line_of(brush: &DrawContext, columns: &StoryColumns, key: LineKey) -> Vec<Span<'static>> {
    let Some(story) = brush.app.story(key) else { return Vec::new() };
    if let Some(step) = story.step(key.step) {
        return step_spans(brush, columns, step);
    }
    let line = brush.app.story_line(story);
    line.map_or_else(Vec::new, |line| story_spans(brush, columns, story, &line))
}

fn story_spans(
    brush: &DrawContext,
    columns: &StoryColumns,
    story: &Story,
    line: &StoryLine,
) -> Vec<Span<'static>> {
    let app = brush.app;
    let (sign, role, is_plain) = sign_of(line.sign);
    let text_role = if is_plain { Role::Text } else { role };
    let mut spans = vec![
        brush.span(role, format!("{sign} ")),
        brush.span(Role::Muted, format!("{} ", columns.time(brush, line.from))),
    ];
    let length = app.story_length(line);
    if columns.has_to {
        let to = match line.to {
            Some(_) if length.is_none() => String::new(),
            Some(to) => columns.time(brush, to),
            None => "…".to_owned(),
        };
        spans.push(brush.span(Role::Muted, format!("{} ", fit(&to, TIME_WIDTH))));
    }
    if columns.has_length {
        let length = fit_right(length.as_deref().unwrap_or_default(), LENGTH_WIDTH);
        spans.push(brush.span(Role::Text, format!("{length}  ")));
    }
    let (entry, _) = app.story_subject(story);
    spans.extend(bus_and_who(brush, columns, entry, Role::Text));
    if let Some(length) = length.filter(|_| !columns.has_length) {
        let open = if line.to.is_none() { "…" } else { "" };
        spans.push(brush.span(Role::Muted, format!("{length}{open} ")));
    }
    spans.push(brush.span(text_role, line.what.clone()));
    spans
}

fn step_spans(brush: &DrawContext, columns: &StoryColumns, step: &StoryStep) -> Vec<Span<'static>> {
    let (times, last) = brush.app.step_times(step);
    let mut spans = vec![
        brush.span(Role::Border, "│ "),
        brush.span(Role::Muted, format!("{} ", columns.time(brush, step.entry.time))),
    ];
    if columns.has_to {
        let to = if times > 1 { columns.time(brush, last) } else { String::new() };
        spans.push(brush.span(Role::Muted, format!("{} ", fit(&to, TIME_WIDTH))));
    }
    if columns.has_length {
        spans.push(Span::raw(" ".repeat(LENGTH_WIDTH + 2)));
    }
    spans.extend(bus_and_who(brush, columns, &step.entry, Role::Muted));
    let times = if times > 1 { format!(" ×{times}") } else { String::new() };
    spans.push(brush.span(Role::Muted, format!("{}{times}", step.entry.text)));
    spans
}

fn bus_and_who(
    brush: &DrawContext,
    columns: &StoryColumns,
    entry: &TimelineEntry,
    role: Role,
) -> Vec<Span<'static>> {
    let mut spans = Vec::new();
    if columns.has_bus {
        // An event of the bus itself has the bus as its subject.
        let bus = entry.bus.filter(|_| entry.address.is_some());
        spans.push(brush.span(Role::Muted, bus_cell(brush.app, bus)));
    }
    let who = fit(&who(brush, entry, columns.who), columns.who);
    spans.push(brush.span(role, format!("{who} ")));
    spans
}

/// Returns the column WHO: address and name of the device, else the bus, else the file.
fn who(brush: &DrawContext, entry: &TimelineEntry, width: usize) -> String {
    let app = brush.app;
    let name = app.name_on_line(entry).map(|name| name.quoted().to_string());
    match (name, entry.address) {
        (name, Some(address)) => {
            format!("{:>3} {}", address.number(), name.as_deref().unwrap_or("?"))
        }
        (Some(name), None) if entry.bus.is_none() => name,
        _ => match entry.bus {
            Some(bus) => bus_label(app, bus, width),
            None => short_file_name(&app.file_at(entry.file).name(), width),
        },
    }
}

/// Sign and role of a story; true if its text has the colour of other text.
pub fn sign_of(sign: StorySign) -> (String, Role, bool) {
    let (text, role, is_plain) = match sign {
        StorySign::Improved => ("+", Role::Online, true),
        StorySign::Change => ("~", Role::Text, true),
        StorySign::Absent(Presence::Stale | Presence::Online) => ("◐", Role::Stale, true),
        StorySign::Absent(Presence::Silent) => ("◌", Role::Silent, true),
        StorySign::Absent(Presence::Asleep) => ("◒", Role::Asleep, true),
        StorySign::Absent(Presence::Lost) => ("○", Role::Lost, false),
        StorySign::Returned => ("●", Role::Online, true),
        StorySign::Finding(FindingState::Suspected) => ("?", Role::Suspected, false),
        StorySign::Finding(FindingState::Confirmed) => ("⚠", Role::Confirmed, false),
        StorySign::Finding(FindingState::Cleared) => ("✓", Role::FileOk, true),
        StorySign::Plain => ("·", Role::Text, true),
        StorySign::Error => ("!", Role::Error, false),
        StorySign::Mark(letter) => return (letter.to_string(), Role::Match, false),
    };
    (text.to_owned(), role, is_plain)
}
