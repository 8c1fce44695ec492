//! A row per identifier: count, rate, period, jitter, the last bytes with those that changed.

use super::super::brush::{DrawContext, bus_cell, fit, fit_right};
use super::cells::{BYTES, bytes, ends, millis, width_of_ends};
use super::draw_uncounted;
use crate::app::{Bus, Decoded, IdentifierKind, IdentifierStats, Page};
use crate::theme::Role;
use crate::time::Duration;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use std::fmt::Write;
use unicode_width::UnicodeWidthStr;

/// A byte that changed is marked for so long, and is bright for so long.
const MARKED: Duration = Duration::from_millis(1500);
const BRIGHT: Duration = Duration::from_secs(5);

/// Columns that give way on a narrow screen.
#[derive(Clone, Copy)]
struct IdentifierColumns {
    has_bus: bool,
    has_addresses: bool,
    /// Cells of SERVICE.
    service: usize,
    has_length: bool,
    has_rate: bool,
    has_extremes: bool,
    has_period: bool,
    /// Cells of JITTER.
    jitter: usize,
    /// Cells of LAST DATA; 0 without the column.
    data: usize,
}

/// Cells that show three bytes and `…`.
const LEAST_DATA: usize = 11;

impl IdentifierColumns {
    fn new(brush: &DrawContext, width: u16) -> Self {
        let mut columns = Self {
            has_bus: brush.app.buses().len() > 1 && width >= 60,
            has_addresses: width >= 124,
            service: if width >= 110 { 9 } else { 5 },
            has_length: width >= 112,
            has_rate: width >= 92,
            has_extremes: width >= 108,
            has_period: width >= 60,
            jitter: if width >= 92 { 9 } else { 8 },
            data: 0,
        };
        let room = usize::from(width).saturating_sub(columns.title(false).width());
        columns.data = if room < LEAST_DATA { 0 } else { room.min(BYTES) };
        columns
    }

    /// `since`: counts are those since a moment.
    fn title(self, since: bool) -> String {
        let mut title = String::from("  ");
        if self.has_bus {
            title += "BUS    ";
        }
        let ends = width_of_ends(self.has_addresses);
        let _ = write!(title, "ID       {}→{} ", fit_right("FROM", ends / 2), fit("TO", ends / 2));
        let _ = write!(
            title,
            "{} ",
            fit(if self.service > 5 { "SERVICE" } else { "SRV" }, self.service)
        );
        if self.has_length {
            title += "LEN   ";
        }
        title += if since { " +COUNT " } else { "  COUNT " };
        if self.has_rate {
            title += "   /s ";
        }
        if self.has_extremes {
            title += " min ms  avg ms  max ms ";
        } else if self.has_period {
            title += " avg ms ";
        }
        if self.has_period {
            let name = if self.jitter > 8 { "JITTER ms" } else { "JITTER" };
            let _ = write!(title, "{} ", fit_right(name, self.jitter));
        }
        if self.data > 0 {
            title += "LAST DATA";
        }
        title
    }
}

/// Draws the list.
pub fn draw(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let columns = IdentifierColumns::new(brush, list.width);
    let line = Line::from(
        brush.span(Role::Header, columns.title(brush.app.view().counts_base().is_some())),
    );
    brush.line(header, 0, &line);
    draw_span(brush, columns);
    let app = brush.app;
    let rows = app.identifiers_shown();
    if rows.is_empty() && app.page_filter(Page::Traffic).is_on() {
        return brush.draw_no_match(list, "no identifier matches the filter");
    }
    let selected = app.view().identifiers.index(rows.iter().map(|row| &row.key));
    let height = usize::from(list.height);
    let top = app.view().identifiers.top(selected, rows.len(), height);
    for (line, row) in rows.iter().skip(top).take(height).enumerate() {
        let is_selected = selected == Some(top + line);
        let text = identifier_line(brush, row, columns, is_selected);
        brush.line(list, line as u16, &text);
        if is_selected {
            brush.select(list, line as u16);
        }
    }
    let refused = app.identifiers().refused();
    if refused > 0 && list.height > 0 {
        let text = format!(" {refused} frames not shown: identifier table full ");
        let line = Line::from(brush.span(Role::Warning, text));
        brush.line(list, list.height - 1, &line);
    }
    draw_uncounted(brush, list);
}

/// Draws what the statistics are of into the rule below the list.
fn draw_span(brush: &mut DrawContext, columns: IdentifierColumns) {
    let rule = brush.screen.lower_rule;
    if rule.height == 0 || !columns.has_period {
        return;
    }
    brush.rule(rule, Role::Border);
    let means = if columns.has_extremes { "min, avg, max" } else { "avg" };
    let unit = if columns.jitter > 8 { "" } else { "ms, " };
    let text = format!(" {means}: last minute · JITTER: {unit}95 % of the last 256 intervals ");
    let line = Line::from(brush.span(Role::Muted, text));
    let area = Rect { x: rule.x + 1, width: rule.width.saturating_sub(2), ..rule };
    brush.line(area, 0, &line);
}

fn identifier_line(
    brush: &DrawContext,
    row: &IdentifierStats,
    columns: IdentifierColumns,
    is_selected: bool,
) -> Line<'static> {
    let decoded = Decoded::of(brush.app, &row.last);
    let id = match row.key.kind {
        IdentifierKind::Error => "error".to_owned(),
        IdentifierKind::Remote => format!("{} R", row.key.id),
        IdentifierKind::Data => row.key.id.to_string(),
    };
    let slow = row.interval.map(|it| it.as_secs_f64()).filter(|seconds| *seconds > 1.5);
    let now = brush.app.display_time();
    let age = now.since(row.last.time).as_secs_f64();
    let rate = match slow.filter(|seconds| age < 2.0 * seconds) {
        Some(seconds) => format!("{:.1}", 1.0 / seconds),
        None => row.rate.to_string(),
    };
    let plain = if row.rate == 0 && slow.is_none() { Role::Muted } else { Role::Text };
    let view = brush.app.view();
    let is_new = view.counts_base().is_some_and(|base| base.is_new_identifier(row));
    let mut spans: Vec<Span> = vec![
        brush.span(Role::Text, if is_selected { "▸" } else { " " }),
        brush.span(Role::New, if is_new { "+" } else { " " }),
    ];
    if columns.has_bus {
        spans.push(brush.span(Role::Muted, bus_cell(brush.app, Some(row.key.bus))));
    }
    spans.push(brush.span(Role::Text, format!("{} ", fit_right(&id, 8))));
    spans.extend(ends(brush, &decoded, columns.has_addresses, plain));
    let service = fit(&decoded.service, columns.service);
    spans.push(brush.span(plain, format!(" {service} ")));
    if columns.has_length {
        let (least, most) = row.lengths();
        let text = if least == most { most.to_string() } else { format!("{least}–{most}") };
        spans.push(brush.span(Role::Muted, format!("{} ", fit(&text, 5))));
    }
    spans.push(brush.span(Role::Muted, format!("{:>7} ", view.frame_count(row))));
    if columns.has_rate {
        spans.push(brush.span(plain, format!("{rate:>5} ")));
    }
    let is_foreign = brush.app.bus(row.key.bus).is_some_and(Bus::is_foreign);
    let period = row.own_period(is_foreign);
    let cell = |time: Option<Duration>| {
        format!("{} ", fit_right(&time.map_or_else(|| "–".to_owned(), millis), 7))
    };
    if columns.has_extremes {
        spans.push(brush.span(Role::Muted, cell(period.map(|it| it.min))));
    }
    if columns.has_period {
        spans.push(brush.span(plain, cell(period.map(|it| it.mean))));
    }
    if columns.has_extremes {
        spans.push(brush.span(Role::Muted, cell(period.map(|it| it.max))));
    }
    if columns.has_period {
        let jitter = period.map_or_else(|| "–".to_owned(), |it| format!("±{}", millis(it.jitter)));
        spans.push(brush.span(plain, format!("{} ", fit_right(&jitter, columns.jitter))));
    }
    if columns.data > 0 {
        let role = |at: usize| match row.changed(at).map(|changed| now.since(changed)) {
            Some(age) if age < MARKED => Role::Changed,
            Some(age) if age < BRIGHT => Role::Text,
            _ => Role::Muted,
        };
        spans.extend(bytes(brush, row.last.data(), columns.data, role));
    }
    let used: usize = spans.iter().map(Span::width).sum();
    let text = decoded.text_after_name(width_of_ends(columns.has_addresses));
    if !text.is_empty() && used + 14 <= usize::from(brush.screen.list.width) {
        let role = if decoded.is_error { Role::Error } else { Role::Muted };
        spans.push(brush.span(role, format!(" {text}")));
    }
    Line::from(spans)
}
