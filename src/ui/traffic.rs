//! Page 2, Traffic: a row per frame, newest last, decoded; or a row per identifier with its frames
//! per second and count; or the evidence of a problem. Below the frames the details of the selected
//! one.

use super::brush::{DrawContext, bus_cell, fit, fit_right, inner, labelled};
use crate::app::{Decoded, Focus, IdentifierKind, IdentifierStats, Page, clock_millis};
use crate::frame::{Frame, FrameKind};
use crate::text::hex;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Draws the list and the details.
pub fn draw(brush: &mut DrawContext) {
    if brush.app.evidence_alone().is_some() {
        draw_evidence(brush);
        draw_details(brush);
    } else if brush.app.view().shows_identifiers() {
        draw_identifiers(brush);
    } else {
        draw_frames(brush);
        draw_details(brush);
    }
}

/// Cells of a name in the columns FROM and TO.
const NAME: usize = 6;

/// Optional columns of a list of frames.
struct Room {
    /// BUS, with several buses from 60 columns on.
    bus: bool,
    /// TYPE, from 96 columns on.
    kind: bool,
    /// The first bytes behind the text, from 72 columns on.
    bytes: bool,
}

impl Room {
    fn new(brush: &DrawContext, width: u16) -> Self {
        let bus = brush.app.buses().len() > 1 && width >= 60;
        Self { bus, kind: width >= 96, bytes: width >= 72 }
    }
}

fn draw_frames(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let room = Room::new(brush, list.width);
    let mut title = format!("  {:12} ", "TIME");
    if room.bus {
        title.push_str("BUS    ");
    }
    title.push_str("  FROM TO     SRV  ");
    if room.kind {
        title.push_str("TYPE        ");
    }
    title.push_str("INFO");
    let mut line = Line::from(brush.span(Role::Header, title));
    if brush.app.view().traffic.is_none() && brush.app.view().frozen.is_none() {
        line.push_span(brush.span(Role::Muted, "   following"));
    }
    brush.line(header, 0, &line);
    let (shown, selected) = brush.app.frames_shown(usize::from(list.height));
    if shown.is_empty() {
        let filtered = brush.app.page_filter(Page::Traffic).is_on();
        let text = if filtered {
            return brush.draw_no_match(list, "no frame matches the filter");
        } else {
            "no frames received yet"
        };
        let line = Line::from(brush.span(Role::Muted, format!("   {text}")));
        return brush.line(list, 1, &line);
    }
    for (row, &number) in shown.iter().enumerate() {
        let Some(frame) = brush.app.capture().get(number) else { continue };
        let is_selected = selected == Some(number);
        let line = frame_line(brush, &frame, &room, list, is_selected);
        brush.line(list, row as u16, &line);
        if is_selected {
            brush.select(list, row as u16);
        }
    }
}

fn frame_line(
    brush: &DrawContext,
    frame: &Frame,
    room: &Room,
    list: Rect,
    selected: bool,
) -> Line<'static> {
    let decoded = Decoded::of(brush.app, frame);
    let is_evidence = brush.app.piece_of(frame).is_some();
    let plain = if frame.is_tx { Role::Muted } else { Role::Text };
    let text = |role: Role, text: String| brush.span(role, text);
    let mut spans: Vec<Span> = vec![
        text(Role::Text, if selected { "▸" } else { " " }.to_owned()),
        text(Role::Match, if is_evidence { IN_CAPTURE } else { " " }.to_owned()),
        text(Role::Muted, format!("{} ", clock_millis(brush.app, frame.time))),
    ];
    if room.bus {
        spans.push(text(Role::Muted, bus_cell(brush.app, Some(frame.bus))));
    }
    spans.extend(route(brush, frame, &decoded, plain));
    if room.kind {
        spans.push(text(Role::Muted, format!("{} ", fit(decoded.kind, 11))));
    }
    let used: usize = spans.iter().map(Span::width).sum();
    let left = usize::from(list.width).saturating_sub(used);
    let bytes = first_bytes(frame.data());
    let role = if decoded.is_error { Role::Error } else { plain };
    if room.bytes && left > 17 + 12 {
        spans.push(text(role, format!("{} ", fit(&decoded.text, left - 18))));
        spans.push(text(Role::Muted, bytes));
    } else if decoded.text.is_empty() {
        spans.push(text(Role::Muted, bytes));
    } else {
        spans.push(text(role, decoded.text));
    }
    Line::from(spans)
}

/// Returns sender, receiver and service; for a frame without them the identifier.
fn route(brush: &DrawContext, frame: &Frame, decoded: &Decoded, role: Role) -> Vec<Span<'static>> {
    if decoded.header.is_none() {
        let id = match frame.kind {
            FrameKind::Error => decoded.kind.to_owned(),
            _ => frame.id.to_string(),
        };
        return vec![brush.span(role, format!("{} ", fit(&id, 2 * NAME + 6)))];
    }
    vec![
        brush.span(role, fit_right(&decoded.source, NAME)),
        brush.span(Role::Muted, "→"),
        brush.span(role, format!("{} ", fit(&decoded.destination, NAME))),
        brush.span(role, format!("{} ", fit(&decoded.service, 4))),
    ]
}

/// Returns a frame as text: sender, receiver, service, content.
pub(super) fn in_words(brush: &DrawContext, frame: &Frame) -> String {
    let decoded = Decoded::of(brush.app, frame);
    let meaning = decoded.meaning();
    match decoded.header {
        Some(_) => format!("{}→{} {meaning}", decoded.source, decoded.destination),
        None if frame.kind == FrameKind::Error => format!("error: {meaning}"),
        None => format!("{} {meaning}", frame.id),
    }
}

/// Marks evidence whose frame is in the capture.
const IN_CAPTURE: &str = "◆";
/// Marks evidence whose frame has left the capture; the finding has a copy.
const STORED_ONLY: &str = "◇";

/// Draws the evidence of a problem, an event per row: its meaning, then the content of the frame.
fn draw_evidence(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let Some(evidence) = brush.app.evidence_alone() else { return };
    let room = Room::new(brush, list.width);
    let with_route = list.width >= 60;
    let mut title = format!("  {:12} ", "TIME");
    if room.bus {
        title.push_str("BUS    ");
    }
    if with_route {
        title.push_str("  FROM TO     SRV  ");
    }
    title.push_str("EVIDENCE");
    let mut line = Line::from(brush.span(Role::Header, title));
    if evidence.count > evidence.pieces.len() as u64 {
        let text = format!("   {} of {} stored", evidence.pieces.len(), evidence.count);
        line.push_span(brush.span(Role::Muted, text));
    }
    brush.line(header, 0, &line);
    let selected = evidence.selected().map(|(place, _)| place);
    let (count, height) = (evidence.pieces.len(), usize::from(list.height));
    let top = evidence.cursor.top(selected, count, height);
    for (row, piece) in evidence.pieces.iter().skip(top).take(height).enumerate() {
        let is_selected = selected == Some(top + row);
        let sign = match &piece.frame {
            Some(frame) if brush.app.captured(frame).is_some() => IN_CAPTURE,
            Some(_) => STORED_ONLY,
            None => " ",
        };
        let mut spans = vec![
            brush.span(Role::Text, if is_selected { "▸" } else { " " }),
            brush.span(Role::Match, sign),
            brush.span(Role::Muted, format!("{} ", clock_millis(brush.app, piece.time))),
        ];
        let decoded = piece.frame.map(|frame| (frame, Decoded::of(brush.app, &frame)));
        if let Some((frame, decoded)) = &decoded {
            if room.bus {
                spans.push(brush.span(Role::Muted, bus_cell(brush.app, Some(frame.bus))));
            }
            if with_route {
                spans.extend(route(brush, frame, decoded, Role::Text));
            }
        }
        spans.push(brush.span(Role::Text, piece.what.clone()));
        if let Some((_, decoded)) =
            decoded.filter(|(_, decoded)| !decoded.text.is_empty() && decoded.text != piece.what)
        {
            spans.push(brush.span(Role::Muted, format!(": {}", decoded.text)));
        }
        brush.line(list, row as u16, &Line::from(spans));
        if is_selected {
            brush.select(list, row as u16);
        }
    }
}

/// Returns the first eight bytes in hexadecimal, `…` behind them if there are more.
fn first_bytes(data: &[u8]) -> String {
    let more = if data.len() > 8 { "…" } else { "" };
    hex(&data[..data.len().min(8)], "") + more
}

fn draw_details(brush: &mut DrawContext) {
    let area = inner(brush.screen.details);
    if area.height == 0 {
        return;
    }
    let above = brush.screen.lower_rule;
    let focused = brush.app.view().focus == Focus::Details;
    brush.rule(above, if focused { Role::BorderFocus } else { Role::Border });
    let app = brush.app;
    let alone = app.evidence_alone();
    let Some(frame) = app.selected_frame() else {
        let line = Line::from(brush.span(Role::Muted, "no frame is selected"));
        return brush.line(area, 0, &line);
    };
    let decoded = Decoded::of(app, &frame);
    let mut lines = Vec::new();
    let mut add = |label: &str, role: Role, text: &str| {
        lines.extend(labelled(brush, &fit(label, 9), role, text, area.width));
    };
    let bus = app.bus(frame.bus).map_or("", |bus| bus.name_without_rates());
    let tx = if frame.is_tx { ", sent by descan" } else { "" };
    add("frame", Role::Text, &format!("{} on {bus}{tx}", clock_millis(app, frame.time)));
    add("id", Role::Text, &describe_id(&frame, &decoded));
    if let Some(header) = decoded.header {
        let node = |name: &str, address: crate::wire::id::Address| {
            if name == address.to_string() { name.to_owned() } else { format!("{name} @{address}") }
        };
        let to = if header.broadcast {
            format!("broadcast (RND7 {})", header.destination)
        } else {
            node(&decoded.destination, header.destination)
        };
        let number = header.service;
        let service = if decoded.service == number.to_string() {
            format!("service {number}")
        } else {
            format!("service {} ({number})", decoded.service)
        };
        let from = node(&decoded.source, header.source);
        add("route", Role::Text, &format!("{from} → {to}, {service}"));
    }
    let role = if decoded.is_error { Role::Error } else { Role::Text };
    if !decoded.text.is_empty() {
        add("decoded", role, &decoded.text);
    }
    let number = match alone {
        Some(_) => app.captured(&frame),
        None => app.view().traffic,
    };
    if let Some(message) = number.and_then(|number| app.transfer_text(number)) {
        add("message", Role::Text, &message);
    }
    if let Some(piece) = app.piece_of(&frame) {
        add("evidence", Role::Text, &piece.what);
    }
    if alone.is_some() && number.is_none() {
        add("", Role::Muted, "no longer in the capture, stored as evidence");
    }
    for (at, bytes) in frame.data().chunks(8).enumerate() {
        let text: String = bytes
            .iter()
            .map(|&byte| if (0x20..0x7F).contains(&byte) { char::from(byte) } else { '·' })
            .collect();
        let label = if at == 0 { format!("data {}", frame.len()) } else { String::new() };
        let mut line = Line::from(brush.span(Role::Muted, fit(&label, 9)));
        line.push_span(brush.span(Role::Text, fit(&hex(bytes, " "), 25)));
        line.push_span(brush.span(Role::Muted, text));
        lines.push(line);
    }
    let scroll = app.view().details_scroll;
    brush.lines(area, &lines, scroll);
}

/// Returns the identifier, the message type, the flags, and `FD`, `BRS` for FD frames.
fn describe_id(frame: &Frame, decoded: &Decoded) -> String {
    let mut text = format!("{}  {}", frame.id, decoded.kind);
    if let Some(header) = decoded.header {
        let flag = |name: &str, set: bool| format!(" {name}{}", u8::from(set));
        text.push(' ');
        text += &flag("U", header.from_non_working);
        text += &flag("D", header.to_non_working);
        text += &flag("R", header.response);
        text += &flag("B", header.broadcast);
        text += &flag("ERR", header.no_error);
    }
    match (frame.is_fd, frame.bit_rate_switch) {
        (true, true) => text.push_str("  FD, BRS"),
        (true, false) => text.push_str("  FD"),
        (false, _) => {}
    }
    text
}

fn draw_identifiers(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let several = brush.app.buses().len() > 1;
    let bus = if several { "BUS    " } else { "" };
    let title = format!("  {bus}{:8}  {:>4}  {:>7}    FROM TO     SRV  LAST", "ID", "f/s", "COUNT");
    let line = Line::from(brush.span(Role::Header, title));
    brush.line(header, 0, &line);
    let app = brush.app;
    let rows = app.identifiers_shown();
    let selected = app.view().identifiers.index(rows.iter().map(|row| &row.key));
    let height = usize::from(list.height);
    let top = app.view().identifiers.top(selected, rows.len(), height);
    for (line, row) in rows.iter().skip(top).take(height).enumerate() {
        let is_selected = selected == Some(top + line);
        let text = identifier_line(brush, row, list, is_selected);
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
}

fn identifier_line(
    brush: &DrawContext,
    row: &IdentifierStats,
    list: Rect,
    selected: bool,
) -> Line<'static> {
    let decoded = Decoded::of(brush.app, &row.last);
    let id = match row.key.kind {
        IdentifierKind::Error => "error".to_owned(),
        IdentifierKind::Remote => format!("{} R", row.key.id),
        IdentifierKind::Data => row.key.id.to_string(),
    };
    let role = if row.rate == 0 { Role::Muted } else { Role::Text };
    let slow = row.interval.map(|it| it.as_secs_f64()).filter(|seconds| *seconds > 1.5);
    let age = brush.app.display_time().since(row.last.time).as_secs_f64();
    let rate = match slow.filter(|seconds| age < 2.0 * seconds) {
        Some(seconds) => format!("{:.1}", 1.0 / seconds),
        None => row.rate.to_string(),
    };
    let mut spans = vec![brush.span(Role::Text, if selected { "▸ " } else { "  " })];
    if brush.app.buses().len() > 1 {
        spans.push(brush.span(Role::Muted, bus_cell(brush.app, Some(row.key.bus))));
    }
    spans.extend([
        brush.span(Role::Text, fit(&id, 8)),
        brush.span(role, format!("  {rate:>4}")),
        brush.span(Role::Muted, format!("  {:>7}  ", row.count)),
    ]);
    if decoded.header.is_some() {
        spans.push(brush.span(Role::Text, fit_right(&decoded.source, NAME)));
        spans.push(brush.span(Role::Muted, "→"));
        spans.push(brush.span(Role::Text, format!("{} ", fit(&decoded.destination, NAME))));
        spans.push(brush.span(Role::Text, format!("{} ", fit(&decoded.service, 4))));
    } else {
        spans.push(brush.span(Role::Text, fit(decoded.kind, 2 * NAME + 7)));
    }
    let used: usize = spans.iter().map(Span::width).sum();
    let left = usize::from(list.width).saturating_sub(used);
    let bytes = first_bytes(row.last.data());
    let role = if decoded.is_error { Role::Error } else { Role::Text };
    if left > 17 + 12 {
        let width = left - bytes.width() - 1;
        spans.push(brush.span(role, format!("{} ", fit(&decoded.text, width))));
        spans.push(brush.span(Role::Muted, bytes));
    } else {
        spans.push(brush.span(Role::Muted, bytes));
    }
    Line::from(spans)
}
