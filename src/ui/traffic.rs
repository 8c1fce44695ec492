//! Traffic: frames in words, newest last; or a row per identifier with its rate.

use super::brush::{Brush, fit, fit_right, labelled};
use super::details::inner;
use crate::app::{Decoded, Focus, IdentifierKind, IdentifierStats, Page, clock_millis, hex};
use crate::frame::Frame;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

pub fn draw(brush: &mut Brush) {
    if brush.app.view().by_identifier {
        draw_identifiers(brush);
    } else {
        draw_frames(brush);
        draw_details(brush);
    }
}

/// How wide names are.
const NAME: usize = 6;

/// Whether there is room for the message type and for the bytes.
struct Room {
    bus: bool,
    kind: bool,
    bytes: bool,
}

impl Room {
    fn new(brush: &Brush, width: u16) -> Self {
        let bus = brush.app.buses().len() > 1 && width >= 60;
        Self { bus, kind: width >= 96, bytes: width >= 72 }
    }
}

fn draw_frames(brush: &mut Brush) {
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
    title.push_str("WHAT");
    let mut line = Line::from(brush.span(Role::Header, title));
    if brush.app.view().traffic.is_none() && brush.app.view().frozen.is_none() {
        line.push_span(brush.span(Role::Muted, "   following"));
    }
    brush.line(header, 0, &line);
    let (shown, selected) = brush.app.frames_shown(usize::from(list.height));
    if shown.is_empty() {
        let filtered = !brush.app.view().filter(Page::Traffic).is_empty();
        let text = if filtered {
            return brush.filtered(list, "no frame fits the filter");
        } else {
            "no frame was heard yet"
        };
        let line = Line::from(brush.span(Role::Muted, format!("   {text}")));
        return brush.line(list, 1, &line);
    }
    for (row, &number) in shown.iter().enumerate() {
        let Some(frame) = brush.app.capture().get(number) else { continue };
        let is_selected = selected == Some(number);
        let line = frame_line(brush, frame, &room, list, is_selected);
        brush.line(list, row as u16, &line);
        if is_selected {
            brush.select(list, row as u16);
        }
    }
}

fn frame_line(
    brush: &Brush,
    frame: &Frame,
    room: &Room,
    list: Rect,
    selected: bool,
) -> Line<'static> {
    let decoded = Decoded::of(brush.app, frame);
    let plain = if frame.ours { Role::Muted } else { Role::Text };
    let text = |role: Role, text: String| brush.span(role, text);
    let mut spans: Vec<Span> = vec![
        text(Role::Text, if selected { "▸ " } else { "  " }.to_owned()),
        text(Role::Muted, format!("{} ", clock_millis(brush.app, frame.time))),
    ];
    if room.bus {
        let bus = brush.app.bus(frame.bus).map_or("", |bus| &bus.name);
        spans.push(text(Role::Muted, format!("{} ", fit(bus, 6))));
    }
    if decoded.header.is_some() {
        spans.push(text(plain, fit_right(&decoded.source, NAME)));
        spans.push(text(Role::Muted, "→".to_owned()));
        spans.push(text(plain, format!("{} ", fit(&decoded.destination, NAME))));
        spans.push(text(plain, format!("{} ", fit(&decoded.service, 4))));
    } else {
        spans.push(text(plain, format!("{} ", fit(&frame.id.to_string(), 2 * NAME + 6))));
    }
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

/// The first eight bytes, and whether there are more.
fn first_bytes(data: &[u8]) -> String {
    let more = if data.len() > 8 { "…" } else { "" };
    hex(&data[..data.len().min(8)], "") + more
}

fn draw_details(brush: &mut Brush) {
    let area = inner(brush.screen.details, brush.screen.details_alone());
    if area.height == 0 {
        return;
    }
    let above = brush.screen.lower_rule;
    let focused = brush.app.view().focus == Focus::Details;
    brush.rule(above, if focused { Role::BorderFocus } else { Role::Border });
    let app = brush.app;
    let Some((number, frame)) =
        app.view().traffic.and_then(|number| Some((number, app.capture().get(number)?)))
    else {
        let line = Line::from(brush.span(Role::Muted, "no frame is selected"));
        return brush.line(area, 0, &line);
    };
    let decoded = Decoded::of(app, frame);
    let mut lines = Vec::new();
    let mut add = |label: &str, role: Role, text: &str| {
        lines.extend(labelled(brush, &fit(label, 9), role, text, area.width));
    };
    let bus = app.bus(frame.bus).map_or("", |bus| &bus.name);
    let ours = if frame.ours { ", sent by us" } else { "" };
    add("frame", Role::Text, &format!("{} on {bus}{ours}", clock_millis(app, frame.time)));
    add("id", Role::Text, &describe_id(frame, &decoded));
    if let Some(header) = decoded.header {
        let who = |name: &str, address: crate::wire::id::Address| {
            if name == address.to_string() { name.to_owned() } else { format!("{name} @{address}") }
        };
        let to = if header.broadcast {
            format!("all (RND7 {})", header.destination)
        } else {
            who(&decoded.destination, header.destination)
        };
        let number = header.service;
        let service = if decoded.service == number.to_string() {
            format!("service {number}")
        } else {
            format!("service {} ({number})", decoded.service)
        };
        let from = who(&decoded.source, header.source);
        add("route", Role::Text, &format!("{from} → {to}, {service}"));
    }
    let role = if decoded.is_error { Role::Error } else { Role::Text };
    if !decoded.text.is_empty() {
        add("says", role, &decoded.text);
    }
    if let Some(message) = app.message_of(number) {
        add("message", Role::Text, &message);
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

/// The identifier, its type and its flags.
fn describe_id(frame: &Frame, decoded: &Decoded) -> String {
    let mut text = format!("{}  {}", frame.id, decoded.kind);
    if let Some(header) = decoded.header {
        let flag = |name: &str, set: bool| format!(" {name}{}", u8::from(set));
        text.push(' ');
        text += &flag("U", header.sender_not_working);
        text += &flag("D", header.to_not_working);
        text += &flag("R", header.response);
        text += &flag("B", header.broadcast);
        text += &flag("ERR", header.no_error);
    }
    match (frame.fd, frame.bit_rate_switch) {
        (true, true) => text.push_str("  FD, faster data"),
        (true, false) => text.push_str("  FD"),
        (false, _) => {}
    }
    text
}

fn draw_identifiers(brush: &mut Brush) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let title = format!("  {:8}  {:>4}  {:>7}    FROM TO     SRV  LAST", "ID", "f/s", "COUNT");
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
    let refused = app.capture().identifiers().refused();
    if refused > 0 && list.height > 0 {
        let text = format!(" {refused} frames of further identifiers are in no row ");
        let line = Line::from(brush.span(Role::Warning, text));
        brush.line(list, list.height - 1, &line);
    }
}

fn identifier_line(
    brush: &Brush,
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
    let rate = if row.rate == 0 { Role::Muted } else { Role::Text };
    let mut spans = vec![
        brush.span(Role::Text, if selected { "▸ " } else { "  " }),
        brush.span(Role::Text, fit(&id, 8)),
        brush.span(rate, format!("  {:>4}", row.rate)),
        brush.span(Role::Muted, format!("  {:>7}  ", row.count)),
    ];
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
        spans.push(brush.span(role, format!("{} ", fit(&decoded.text, left - 18))));
        spans.push(brush.span(Role::Muted, bytes));
    } else {
        spans.push(brush.span(Role::Muted, bytes));
    }
    Line::from(spans)
}
