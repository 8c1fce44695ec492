//! A row per frame, newest last: time, identifier, kind, route, data, meaning.

use super::super::brush::{DrawContext, bus_cell, fit, fit_right};
use super::super::problems::boards::side_role;
use super::cells::{BYTES, IN_CAPTURE, bytes, ends, millis, role_of, width_of_ends};
use crate::app::{
    CallPart, Decoded, FrameRole, Page, TimeFormat, clock_millis, side_letter, summary_of,
};
use crate::frame::{Frame, FrameKind};
use crate::theme::Role;
use crate::time::Duration;
use ratatui::text::{Line, Span};
use std::fmt::Write;
use unicode_width::UnicodeWidthStr;

const MEANING: &str = "MEANING";

/// Columns that give way on a narrow screen.
#[derive(Clone, Copy)]
struct FrameColumns {
    /// TIME has milliseconds.
    has_millis: bool,
    has_bus: bool,
    has_interval: bool,
    has_id: bool,
    has_addresses: bool,
    has_service: bool,
    has_length: bool,
    /// Cells of DATA; 0 without the column.
    data: usize,
}

impl FrameColumns {
    fn new(brush: &DrawContext, width: u16) -> Self {
        Self {
            has_millis: width >= 48,
            has_bus: brush.app.buses().len() > 1 && width >= 60,
            has_interval: width >= 112,
            has_id: width >= 60,
            has_addresses: width >= 116,
            has_service: width >= 100,
            has_length: width >= 104,
            data: match width {
                0..56 => 0,
                56..76 => 12,
                _ => BYTES,
            },
        }
    }

    fn title(self, format: TimeFormat) -> String {
        let mut title = String::from("  ");
        let time = match format {
            TimeFormat::SinceStart => "SINCE START",
            TimeFormat::SinceAbove if !self.has_interval => "Δt ms, ABOVE",
            TimeFormat::SinceSameId if !self.has_interval => "Δt ms, ID",
            _ => "TIME",
        };
        let width = if self.has_millis { 12 } else { 8 };
        let _ = write!(title, "{} ", fit(time, width));
        if self.has_bus {
            title += "BUS    ";
        }
        if self.has_interval {
            let of_id = format == TimeFormat::SinceSameId;
            let _ = write!(title, "{:>7} ", if of_id { "Δt id" } else { "Δt ms" });
        }
        if self.has_id {
            title += "ID       ";
        }
        title += "KIND ";
        let ends = width_of_ends(self.has_addresses);
        let _ = write!(title, "{}→{} ", fit_right("FROM", ends / 2), fit("TO", ends / 2));
        if self.has_service {
            title += "SERVICE   ";
        }
        if self.has_length {
            title += "LEN ";
        }
        if self.data > 0 {
            let _ = write!(title, "{} ", fit("DATA", self.data));
        }
        title + MEANING
    }
}

/// Draws the list.
pub fn draw(brush: &mut DrawContext) {
    let (header, area) = (brush.screen.header, brush.screen.list);
    let columns = FrameColumns::new(brush, area.width);
    let view = brush.app.view();
    let mut title = columns.title(view.time_format);
    let (shown, selected) = brush.app.frames_shown(usize::from(area.height));
    if view.traffic.is_none() && view.frozen.is_none() {
        let left_out = shown.first().map_or(0, |&first| brush.app.left_out(first));
        let room = |title: &str| usize::from(area.width).saturating_sub(title.width());
        let texts = following(left_out);
        if texts.iter().all(|text| text.len() > room(&title)) {
            title.truncate(title.len() - MEANING.len());
        }
        title += texts.iter().find(|text| text.len() <= room(&title)).map_or("", String::as_str);
    }
    let line = Line::from(brush.span(Role::Header, title));
    brush.line(header, 0, &line);
    if shown.is_empty() {
        if brush.app.page_filter(Page::Traffic).is_on() {
            return brush.draw_no_match(area, "no frame matches the filter");
        }
        let line = Line::from(brush.span(Role::Muted, "   no frames received yet"));
        return brush.line(area, 1, &line);
    }
    let parts = brush.app.call_parts(&shown);
    let frames: Vec<Frame> =
        shown.iter().filter_map(|number| brush.app.capture().get(*number)).collect();
    let sides = brush.app.frame_sides(&frames);
    let mut above = None;
    let first = shown.first().and_then(|&first| brush.app.capture().numbers_before(first).next());
    let mut number_above = first.filter(|_| !brush.app.page_filter(Page::Traffic).is_on());
    for (row, &number) in shown.iter().enumerate() {
        let Some(frame) = brush.app.capture().get(number) else { continue };
        let is_selected = selected == Some(number);
        let shown_frame = ShownFrame {
            number,
            frame: &frame,
            above,
            missing: number_above
                .map_or(0, |above| brush.app.capture().missing_between(above, number)),
            part: parts.get(&number).copied(),
            side: sides.side_of(brush.app, &frame),
        };
        let line = frame_line(brush, &shown_frame, columns, usize::from(area.width), is_selected);
        brush.line(area, row as u16, &line);
        if is_selected {
            brush.select(area, row as u16);
        }
        (above, number_above) = (Some(frame.time), Some(number));
    }
}

/// Texts behind the title while the newest frames are shown, and so many between them and those before:
/// the longest first.
fn following(left_out: u64) -> Vec<String> {
    match left_out {
        0 => vec!["  following".to_owned()],
        count => vec![format!("  following, {count} skipped"), format!("  {count} skipped")],
    }
}

struct ShownFrame<'a> {
    number: u64,
    frame: &'a Frame,
    /// Time of the row above.
    above: Option<crate::time::Instant>,
    /// Number of frames before it that are no longer kept, although those above are.
    missing: u64,
    part: Option<CallPart>,
    /// The board that sent it, of several at its address.
    side: Option<usize>,
}

fn frame_line(
    brush: &DrawContext,
    shown: &ShownFrame,
    columns: FrameColumns,
    width: usize,
    is_selected: bool,
) -> Line<'static> {
    let (app, frame) = (brush.app, shown.frame);
    let decoded = Decoded::of(app, frame);
    let is_evidence = app.piece_of(frame).is_some();
    let plain = if frame.is_tx { Role::Muted } else { Role::Text };
    let transfer = app.transfer(shown.number).filter(|_| app.view().evidence.is_none());
    let is_open = app.is_transfer_open(shown.number);
    let (sign, sign_role) = match &transfer {
        _ if is_evidence => (IN_CAPTURE, Role::Match),
        Some(_) if is_open => ("−", Role::HintKey),
        Some(_) => ("+", Role::HintKey),
        None => (" ", Role::Text),
    };
    let mut spans: Vec<Span> = vec![
        brush.span(Role::Text, if is_selected { "▸" } else { " " }),
        brush.span(sign_role, sign),
    ];
    // Closed, it is one row.
    let transfer = transfer.filter(|_| !is_open);
    let capture = app.capture();
    let previous = if app.shown_buses().has_fixed_id(frame) {
        capture.previous_with_all_bits(shown.number)
    } else {
        capture.previous(shown.number)
    };
    let previous = previous.and_then(|it| capture.get(it));
    let since_same = previous.as_ref().map(|it| frame.time.since(it.time));
    let since_above = shown.above.map(|above| frame.time.since(above));
    let format = app.view().time_format;
    let interval = |time: Option<Duration>| time.map_or_else(|| "–".to_owned(), millis);
    let cells = if columns.has_millis { 12 } else { 8 };
    let time = match format {
        TimeFormat::SinceStart => since_start(brush, frame),
        TimeFormat::SinceAbove if !columns.has_interval => interval(since_above),
        TimeFormat::SinceSameId if !columns.has_interval => interval(since_same),
        _ => clock_millis(app, frame.time).chars().take(cells).collect(),
    };
    let is_clock =
        format == TimeFormat::Clock || columns.has_interval && format != TimeFormat::SinceStart;
    let time = if is_clock { fit(&time, cells) } else { fit_right(&time, cells) };
    spans.push(brush.span(Role::Muted, format!("{time} ")));
    if columns.has_bus {
        spans.push(brush.span(Role::Muted, bus_cell(app, Some(frame.bus))));
    }
    if columns.has_interval {
        let time = if format == TimeFormat::SinceSameId { since_same } else { since_above };
        let text = if time.is_none() && format != TimeFormat::SinceSameId {
            String::new()
        } else {
            interval(time)
        };
        spans.push(brush.span(Role::Muted, format!("{} ", fit_right(&text, 7))));
    }
    if columns.has_id {
        let id = match frame.kind {
            FrameKind::Error => String::new(),
            _ => frame.id.to_string(),
        };
        spans.push(brush.span(plain, format!("{} ", fit_right(&id, 8))));
    }
    let kind = role_of(decoded.role);
    spans.push(brush.span(kind, format!("{} ", fit(decoded.role.word(), 4))));
    spans.extend(ends(brush, &decoded, columns.has_addresses, plain));
    spans.push(brush.span(plain, " "));
    if columns.has_service {
        spans.push(brush.span(plain, format!("{} ", fit(&decoded.service, 9))));
    }
    if columns.has_length {
        let length = transfer.as_ref().map_or(frame.len(), |transfer| transfer.length);
        spans.push(brush.span(Role::Muted, format!("{length:>3} ")));
    }
    if columns.data > 0 {
        let is_data = frame.kind == FrameKind::Data && transfer.is_none();
        let before = previous.as_ref().filter(|_| is_data);
        let role = |at: usize| match before {
            Some(before) if before.data().get(at) != frame.data().get(at) => Role::Changed,
            _ => Role::Muted,
        };
        let data = transfer.as_ref().map_or(frame.data(), |transfer| &transfer.message);
        spans.extend(bytes(brush, data, columns.data, role));
        spans.push(brush.span(Role::Text, " "));
    }
    let role = if decoded.is_error { Role::Error } else { plain };
    let mut text = decoded.text_after_name(width_of_ends(columns.has_addresses)).to_owned();
    if let Some(transfer) = &transfer {
        let state = if transfer.is_complete() { "" } else { "incomplete: " };
        text = format!("{state}{}", summary_of(&transfer.message));
    }
    if columns.data == 0 && text.is_empty() {
        text = crate::text::hex(&frame.data()[..frame.len().min(8)], "");
    }
    if let Some(side) = shown.side {
        // The UID is what matters; the service has a column, or is known by the letter.
        if let Some(rest) = text.strip_prefix("heartbeat ") {
            text = String::from(rest);
        }
        spans.push(brush.span(side_role(side), format!("{} ", side_letter(side))));
    }
    if shown.missing > 0 {
        spans.push(brush.span(Role::Warning, format!("{} not kept before  ", shown.missing)));
    }
    let (note, note_role) = call_note(shown.part, decoded.role);
    let used: usize = spans.iter().map(Span::width).sum();
    let room = width.saturating_sub(used);
    // By the name of the service, the mode has room.
    if let Some(rest) = text.strip_prefix("heartbeat ").filter(|_| text.width() > room) {
        text = format!("HR {rest}");
    }
    let behind = note.width() + 2;
    if let Some(transfer) = &transfer {
        let frames = format!(", {} frames", transfer.frames);
        if text.width() + frames.width() + behind <= room {
            text += &frames;
        }
    }
    // The note yields to the meaning, unless most of that is shown.
    if note.is_empty() || text.width() + behind > room && room < behind + 12 {
        spans.push(brush.span(role, text));
    } else {
        spans.push(brush.span(role, fit(&text, text.width().min(room - behind))));
        spans.push(brush.span(note_role, format!("  {note}")));
    }
    Line::from(spans)
}

/// What is known of the call that a frame is part of.
fn call_note(part: Option<CallPart>, role: FrameRole) -> (String, Role) {
    match part {
        Some(CallPart::Request { is_unanswered: true, .. }) => {
            ("unanswered".to_owned(), Role::Warning)
        }
        Some(CallPart::Request { responses: 0, .. }) | None => (String::new(), Role::Muted),
        Some(CallPart::Request { responses: 1, .. }) => ("1 rsp".to_owned(), Role::Muted),
        Some(CallPart::Request { responses, .. }) => (format!("{responses} rsp"), Role::Muted),
        Some(CallPart::Response { latency, is_ambiguous, .. }) => {
            let sign = if is_ambiguous { "≈ " } else { "" };
            (format!("{sign}{} ms", millis(latency)), role_of(role))
        }
    }
}

/// Time since the first frame that is kept.
fn since_start(brush: &DrawContext, frame: &Frame) -> String {
    let capture = brush.app.capture();
    let start = capture.time_of(capture.oldest()).unwrap_or(frame.time);
    format!("{:.3}", frame.time.since(start).as_secs_f64())
}
