//! Page 2, Traffic: frames, identifiers, calls, single calls, or the evidence of a problem. Below the frames the
//! details of the selected one.

mod call_list;
mod calls;
mod cells;
mod evidence;
mod frames;
mod identifiers;

use super::brush::{DrawContext, fit, inner, labelled};
use super::chart::grouped;
use crate::app::{App, Decoded, Focus, Page, clock_millis};
use crate::frame::{Frame, FrameKind};
use crate::text::hex;
use crate::theme::Role;
use crate::wire::id::{Header, MessageType};
use ratatui::layout::Rect;
use ratatui::text::Line;

/// Returns what the list is of, for the page rule: single calls, counts since a moment; `None` for all.
pub(super) fn title(app: &App) -> Option<String> {
    let view = app.view();
    let base = view.counts_base().filter(|_| view.shows_identifiers() || view.shows_calls());
    call_list::title(app).or_else(|| {
        let base = base.filter(|_| !app.page_filter(Page::Traffic).is_on())?;
        Some(format!(" counts since {} ", clock_millis(app, base.time)))
    })
}

/// Draws the list and the details.
pub fn draw(brush: &mut DrawContext) {
    if brush.app.evidence_alone().is_some() {
        evidence::draw(brush);
        draw_details(brush);
    } else if brush.app.view().shows_identifiers() {
        identifiers::draw(brush);
    } else if brush.app.view().call_list().is_some() {
        call_list::draw(brush);
    } else if brush.app.view().shows_calls() {
        calls::draw(brush);
    } else {
        frames::draw(brush);
        draw_details(brush);
    }
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

/// Draws how many frames the statistics lack, while they are counted.
fn draw_uncounted(brush: &mut DrawContext, list: Rect) {
    let frames = brush.app.uncounted_frames();
    if frames > 0 && list.height > 0 {
        let text = format!(" counting: {} frames left ", grouped(frames));
        let line = Line::from(brush.span(Role::Warning, text));
        brush.line(list, list.height - 1, &line);
    }
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
        add("flags", Role::Text, &describe_flags(header));
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
    let message = app.shown_buses().frame_types(decoded.header, &frame).message();
    if let Some(message) = message {
        add("message", Role::Text, message.name());
        for (at, signal) in message.values(frame.data()).iter().enumerate() {
            add(if at == 0 { "signals" } else { "" }, Role::Text, &signal.to_string());
        }
    } else if !decoded.text.is_empty() {
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

/// Returns the flags of the identifier in words.
fn describe_flags(header: Header) -> String {
    if header.message_type() == MessageType::NonConforming {
        let bit = |name: &str, set: bool| format!("{name}{}", u8::from(set));
        let bits = [
            bit("U", header.from_non_working),
            bit("D", header.to_non_working),
            bit("R", header.response),
            bit("B", header.broadcast),
            bit("ERR", header.no_error),
        ];
        return format!("{}: no message type has them", bits.join(" "));
    }
    let mode = |is_non_working| if is_non_working { "non-working" } else { "working" };
    let (from, to) = (mode(header.from_non_working), mode(header.to_non_working));
    let what = match (header.message_type(), header.response, header.broadcast) {
        (MessageType::Debug, ..) => return format!("{from} → {to}, debug message"),
        (_, true, true) => "response, unsolicited",
        (_, true, false) => "response, targeted",
        (_, false, true) => "request, broadcast",
        (_, false, false) => "request, targeted",
    };
    // ERR of a request says nothing.
    let result = match (header.response, header.no_error) {
        (true, true) => ", ok",
        (true, false) => ", failed",
        (false, _) => "",
    };
    format!("{from} → {to}, {what}{result}")
}

/// Returns the identifier, the message type, and `FD`, `BRS` for FD frames.
fn describe_id(frame: &Frame, decoded: &Decoded) -> String {
    let mut text = format!("{}  {}", frame.id, decoded.kind);
    match (frame.is_fd, frame.bit_rate_switch) {
        (true, true) => text.push_str("  FD, BRS"),
        (true, false) => text.push_str("  FD"),
        (false, _) => {}
    }
    text
}
