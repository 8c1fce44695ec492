//! A row per client, server and service: calls, latency, unanswered and failed ones.

use super::super::brush::{DrawContext, bus_cell, fit, fit_right, short_name};
use super::cells::millis;
use super::draw_uncounted;
use crate::app::{App, Bus, CallKey, CallStats, Page, clock_millis};
use crate::theme::Role;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use ratatui::text::{Line, Span};
use std::fmt::Write;

/// Cells of a name with its address, and on a narrow screen.
const END: usize = 12;
const SHORT_END: usize = 8;
/// Width from which names have all their cells, without the bus.
const WITH_LONG_ENDS: u16 = 68;
/// Cells of the bus.
const BUS: u16 = 7;

/// Columns that give way on a narrow screen.
#[derive(Clone, Copy)]
struct CallColumns {
    /// Cells of the client, and of the server.
    end: usize,
    has_bus: bool,
    has_rate: bool,
    has_median: bool,
    has_max: bool,
    has_last: bool,
}

impl CallColumns {
    fn new(brush: &DrawContext, width: u16) -> Self {
        let has_bus = brush.app.buses().len() > 1 && width >= WITH_LONG_ENDS;
        let is_wide = width >= WITH_LONG_ENDS + if has_bus { BUS } else { 0 };
        Self {
            end: if is_wide { END } else { SHORT_END },
            has_bus,
            has_rate: width >= 86,
            has_median: width >= 72,
            has_max: width >= 96,
            has_last: width >= 110,
        }
    }

    /// `since`: counts are those since a moment.
    fn title(self, since: bool) -> String {
        let mut title = String::from("  ");
        if self.has_bus {
            title += "BUS    ";
        }
        let _ = write!(
            title,
            "{}→{} SERVICE   ",
            fit_right("CLIENT", self.end),
            fit("SERVER", self.end)
        );
        title += if since { " +CALLS " } else { "  CALLS " };
        if self.has_rate {
            title += "   /s ";
        }
        if self.has_median {
            title += " p50 ms ";
        }
        title += " p99 ms ";
        if self.has_max {
            title += " max ms ";
        }
        title += "UNANSW FAILED";
        if self.has_last {
            title += "  LAST";
        }
        title
    }
}

/// Draws the list.
pub fn draw(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let columns = CallColumns::new(brush, list.width);
    let line = Line::from(
        brush.span(Role::Header, columns.title(brush.app.view().counts_base().is_some())),
    );
    brush.line(header, 0, &line);
    let app = brush.app;
    let rows = app.calls_shown();
    if rows.is_empty() {
        if app.page_filter(Page::Traffic).is_on() {
            return brush.draw_no_match(list, "no call matches the filter");
        }
        let all_foreign = !app.buses().is_empty() && app.buses().iter().all(Bus::is_foreign);
        let text = if all_foreign {
            "   no calls: the bus speaks another protocol"
        } else {
            "   no requests received yet"
        };
        let line = Line::from(brush.span(Role::Muted, text));
        return brush.line(list, 1, &line);
    }
    let selected = app.view().calls.index(rows.iter().map(|row| &row.key));
    let height = usize::from(list.height);
    let top = app.view().calls.top(selected, rows.len(), height);
    for (line, row) in rows.iter().skip(top).take(height).enumerate() {
        let is_selected = selected == Some(top + line);
        let text = call_line(brush, row, columns, is_selected);
        brush.line(list, line as u16, &text);
        if is_selected {
            brush.select(list, line as u16);
        }
    }
    let refused = app.calls().refused();
    if refused > 0 && list.height > 0 {
        let text = format!(" {refused} requests not shown: table of calls full ");
        let line = Line::from(brush.span(Role::Warning, text));
        brush.line(list, list.height - 1, &line);
    }
    draw_uncounted(brush, list);
}

/// Client and server by name and address, as of a moment.
pub fn ends_of_call(app: &App, key: CallKey, time: Instant) -> (String, String) {
    let end = |address: Address| {
        let name = short_name(&app.name_at(key.bus, address, time), END - 4);
        let number = address.to_string();
        if name == number { number } else { format!("{name}@{number}") }
    };
    (end(key.client), key.server.map_or_else(|| "all".to_owned(), end))
}

fn call_line(
    brush: &DrawContext,
    row: &CallStats,
    columns: CallColumns,
    is_selected: bool,
) -> Line<'static> {
    let (app, key) = (brush.app, row.key);
    let (client, server) = ends_of_call(app, key, row.last);
    let is_new = app.view().counts_base().is_some_and(|base| base.is_new_call(row));
    let counts = app.view().call_counts(row);
    let mut spans: Vec<Span> = vec![
        brush.span(Role::Text, if is_selected { "▸" } else { " " }),
        brush.span(Role::New, if is_new { "+" } else { " " }),
    ];
    if columns.has_bus {
        spans.push(brush.span(Role::Muted, bus_cell(app, Some(key.bus))));
    }
    let service = app.service_name(key.bus, key.service, key.server);
    spans.extend([
        brush.span(Role::Text, fit_right(&client, columns.end)),
        brush.span(Role::Muted, "→"),
        brush.span(Role::Text, format!("{} ", fit(&server, columns.end))),
        brush.span(Role::Text, format!("{} ", fit(&service, 9))),
        brush.span(Role::Text, format!("{:>7} ", counts.calls)),
    ]);
    if columns.has_rate {
        spans.push(brush.span(Role::Muted, format!("{:>5} ", row.rate)));
    }
    let latency = row.latency_of_last(counts.responses);
    // Of some calls it is not certain which request a response is to.
    let about = if row.ambiguous > 0 { "≈" } else { "" };
    let cell = |time: Option<Duration>| {
        let text = time.map_or_else(|| "–".to_owned(), |time| format!("{about}{}", millis(time)));
        format!("{} ", fit_right(&text, 7))
    };
    if columns.has_median {
        spans.push(brush.span(Role::Response, cell(latency.map(|it| it.p50))));
    }
    spans.push(brush.span(Role::Response, cell(latency.map(|it| it.p99))));
    if columns.has_max {
        spans.push(brush.span(Role::Response, cell(latency.map(|it| it.max))));
    }
    let count = |count: u64, role: Role| {
        let role = if count == 0 { Role::Muted } else { role };
        brush.span(role, format!("{count:>6} "))
    };
    spans.push(count(counts.unanswered, Role::Warning));
    spans.push(count(counts.failed, Role::Error));
    if columns.has_last {
        spans.push(brush.span(Role::Muted, format!(" {}", clock_millis(app, row.last))));
    }
    Line::from(spans)
}
