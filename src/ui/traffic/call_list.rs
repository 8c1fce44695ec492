//! The calls of one client, server and service: a row per request, with its response.

use super::super::brush::{DrawContext, fit, fit_right};
use super::calls::ends_of_call;
use super::cells::{BYTES, bytes, millis};
use crate::app::{App, Call, CallResult, Decoded, Page, clock_millis};
use crate::text::hex;
use crate::theme::Role;
use ratatui::text::{Line, Span};
use std::fmt::Write;
use unicode_width::UnicodeWidthStr;

/// Cells of RESULT.
const RESULT: usize = 13;
/// Width from which the bytes of both frames have columns.
const WITH_DATA: u16 = 110;

/// Returns the title of the page rule: who calls whom; `None` without an open list.
pub fn title(app: &App) -> Option<String> {
    let key = app.view().call_list()?.key;
    let last = app.calls().get(&key)?.last;
    let (client, server) = ends_of_call(app, key, last);
    Some(format!(" {client}→{server} {} ", app.service_name(key.bus, key.service, key.server)))
}

/// Draws the list.
pub fn draw(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let app = brush.app;
    let Some(open) = app.view().call_list() else { return };
    let calls = app.calls_listed();
    let has_data = list.width >= WITH_DATA;
    let mut title = format!("  {:12} LATENCY ms {} ", "TIME", fit("RESULT", RESULT));
    if has_data {
        let _ = write!(title, "{} {} ", fit("REQUEST", BYTES), fit("RESPONSE", BYTES));
    }
    // On a narrow screen the page rule has no room for whose calls they are.
    title += self::title(app).as_deref().map_or("REQUEST → RESPONSE", str::trim);
    let mut line = Line::from(brush.span(Role::Header, title));
    let all = app.calls().get(&open.key).map_or(0, |row| row.calls);
    if all > calls.len() as u64 {
        line.push_span(brush.span(Role::Muted, format!("   {} of {all}", calls.len())));
    }
    brush.line(header, 0, &line);
    if calls.is_empty() {
        if app.page_filter(Page::Traffic).is_on() {
            return brush.draw_no_match(list, "no call matches the filter");
        }
        let line = Line::from(brush.span(Role::Muted, "   no such call until this moment"));
        return brush.line(list, 1, &line);
    }
    // Until it is moved, the selection is the first row.
    let selected = open.cursor.index(calls.iter().map(|it| &it.request)).unwrap_or(0);
    let height = usize::from(list.height);
    let top = open.cursor.top(Some(selected), calls.len(), height);
    for (line, call) in calls.iter().skip(top).take(height).enumerate() {
        let is_selected = selected == top + line;
        let text = call_line(brush, call, has_data, is_selected);
        brush.line(list, line as u16, &text);
        if is_selected {
            brush.select(list, line as u16);
        }
    }
}

fn call_line(brush: &DrawContext, call: &Call, has_data: bool, is_selected: bool) -> Line<'static> {
    let app = brush.app;
    let time = clock_millis(app, call.time);
    let mut spans: Vec<Span> = vec![
        brush.span(Role::Text, if is_selected { "▸ " } else { "  " }),
        brush.span(Role::Muted, format!("{time} ")),
    ];
    let about = if call.is_ambiguous { "≈" } else { "" };
    let latency = call.response.map(|(_, latency)| format!("{about}{}", millis(latency)));
    let latency = latency.unwrap_or_else(|| "–".to_owned());
    spans.push(brush.span(Role::Response, format!("{} ", fit_right(&latency, 10))));
    let is_to_one = app.view().call_list().is_some_and(|list| list.key.server.is_some());
    let (result, role) = match (call.result, call.responses) {
        (CallResult::Open, _) => ("waits".to_owned(), Role::Muted),
        (CallResult::Unanswered, _) => ("○ unanswered".to_owned(), Role::Warning),
        (CallResult::Failed, _) => ("✗ failed".to_owned(), Role::Error),
        (CallResult::Answered, 1) => ("answered".to_owned(), Role::Muted),
        // Two boards have the address.
        (CallResult::Answered, count) if is_to_one => {
            (format!("⚠ {count} responses"), Role::Warning)
        }
        (CallResult::Answered, count) => (format!("{count} responses"), Role::Muted),
    };
    spans.push(brush.span(role, format!("{} ", fit(&result, RESULT))));
    let request = app.capture().get(call.request);
    let response = call.response.and_then(|(number, _)| app.capture().get(number));
    if has_data {
        for frame in [&request, &response] {
            let data = frame.as_ref().map_or(&[][..], |frame| frame.data());
            spans.extend(bytes(brush, data, BYTES, |_| Role::Muted));
            spans.push(brush.span(Role::Text, " "));
        }
    }
    let is_dropped = request.is_none();
    let meaning = |frame: Option<crate::frame::Frame>| {
        let frame = frame?;
        let text = Decoded::of(app, &frame).text;
        Some(if text.is_empty() && !has_data { hex(frame.data(), " ") } else { text })
    };
    let response_text = match call.response {
        // The code of the error is in its bytes.
        Some(_) if call.result == CallResult::Failed && !has_data => {
            response.map(|frame| hex(frame.data(), " "))
        }
        Some((number, _)) => app.transfer_text(number).or_else(|| meaning(response)),
        None => None,
    };
    let text = match (meaning(request), response_text) {
        _ if is_dropped => "no longer in the capture".to_owned(),
        (Some(request), Some(response)) if request.is_empty() => response,
        (Some(request), Some(response)) if !response.is_empty() => {
            format!("{request} → {response}")
        }
        (request, _) => request.unwrap_or_default(),
    };
    let used: usize = spans.iter().map(Span::width).sum();
    let room = usize::from(brush.screen.list.width).saturating_sub(used);
    let role = if is_dropped { Role::Muted } else { Role::Text };
    spans.push(brush.span(role, fit(&text, text.width().min(room))));
    Line::from(spans)
}
