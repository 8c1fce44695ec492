//! The dialog in which a frame is composed; takes the place of the page. Fields, the frame that they make
//! with its meaning, what was sent with its answers.

use super::brush::{DrawContext, fit};
use crate::app::{
    ComposerDialog, DialogField, SendingResult, SentFrames, clock_millis, format_millis,
};
use crate::cell_text::{cut, wrap};
use crate::composer::{Composed, CompositionField, MessageKind, Mistake};
use crate::frame::bits::FrameBits;
use crate::text::printable;
use crate::theme::Role;
use crate::time::Duration;
use crate::wire::framing::Framing;
use ratatui::layout::{Position, Rect};
use ratatui::style::Modifier;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Columns of the names of fields.
const LABEL: usize = 11;
/// Columns of a text that is typed, at least.
const FIELD: usize = 24;
/// Columns of a number that is typed.
const NUMBER: usize = 6;
/// Rows of fields.
const ROWS: [&[DialogField]; 8] = [
    &[DialogField::Kind],
    &[DialogField::To],
    &[DialogField::Service],
    &[DialogField::Data],
    &[DialogField::Framing],
    &[DialogField::From],
    &[DialogField::Fd, DialogField::Error],
    &[DialogField::Copies, DialogField::Every],
];
/// Least lines below the fields.
const BELOW: u16 = 4;

/// Draws the dialog.
pub fn draw(brush: &mut DrawContext) {
    let Some(dialog) = brush.app.composer_dialog() else { return };
    let bus = brush.app.bus(dialog.bus).map_or("", |bus| &bus.name);
    let bus = printable(bus.as_bytes());
    let area = brush.panel(&format!(" Compose a frame for {bus} "));
    let area = Rect { height: area.height.saturating_sub(brush.screen.time_bar.height), ..area };
    let composed = brush.app.dialog_frames(dialog);
    let has = |row: &&&[DialogField]| row.iter().any(|field| dialog.has(*field));
    let rows: Vec<&[DialogField]> = ROWS.iter().filter(has).copied().collect();
    let room = usize::from(area.height.saturating_sub(BELOW)).clamp(1, rows.len());
    let focused = rows.iter().position(|row| row.contains(&dialog.focus)).unwrap_or(0);
    let first = (focused + 1).saturating_sub(room);
    let is_asked = brush.app.question().is_some();
    let mut y = area.y;
    for row in rows.iter().skip(first).take(room) {
        let line = Rect { y, height: 1, ..area };
        if y < area.bottom() {
            draw_row(brush, line, dialog, row, composed.as_ref().err(), !is_asked);
        }
        y += 1;
    }
    let lines = below(brush, dialog, &composed, usize::from(area.width));
    let left = Rect { y, height: area.bottom().saturating_sub(y), ..area };
    for (row, line) in lines.iter().take(usize::from(left.height)).enumerate() {
        brush.line(left, row as u16, line);
    }
}

/// Draws a row of fields.
fn draw_row(
    brush: &mut DrawContext,
    area: Rect,
    dialog: &ComposerDialog,
    row: &[DialogField],
    mistake: Option<&Mistake>,
    has_cursor: bool,
) {
    let is_focused = row.contains(&dialog.focus);
    let name = label(row, dialog.kind);
    let sign = if is_focused { "▸" } else { " " };
    let role = if is_focused { Role::Title } else { Role::Muted };
    let room = usize::from(area.width).saturating_sub(LABEL);
    let mut spans = vec![brush.span(role, fit(&format!("{sign} {name}"), LABEL))];
    match row {
        [DialogField::Kind] => {
            let choices = MessageKind::ALL.map(|kind| (kind.word(), kind == dialog.kind));
            spans.extend(choice_spans(brush, &choices, is_focused, room));
        }
        [DialogField::Framing] => {
            let choices = [
                ("as the receiver", dialog.framing.is_none()),
                ("isotp", dialog.framing == Some(Framing::Isotp)),
                ("raw", dialog.framing == Some(Framing::Raw)),
            ];
            spans.extend(choice_spans(brush, &choices, is_focused, room));
        }
        [DialogField::Fd, DialogField::Error] => {
            for (field, word, is_on) in [
                (DialogField::Fd, "CAN FD", dialog.is_fd),
                (DialogField::Error, "error (ERR = 0)", dialog.is_error),
            ] {
                if dialog.has(field) {
                    let role = if dialog.focus == field { Role::Input } else { Role::Text };
                    let tick = if is_on { "[x]" } else { "[ ]" };
                    spans.push(brush.span(role, format!("{tick} {word}")));
                    spans.push(brush.span(Role::Text, "   "));
                }
            }
        }
        [DialogField::Copies, DialogField::Every] => {
            brush.line(area, 0, &Line::from(spans));
            let x = area.x + LABEL as u16;
            let number = Rect { x, width: NUMBER as u16, ..area }.intersection(area);
            draw_text(brush, number, dialog, DialogField::Copies, None, has_cursor);
            let between = Rect { x: number.right() + 1, width: 8, ..area }.intersection(area);
            let line = Line::from(brush.span(Role::Muted, "× every"));
            brush.line(between, 0, &line);
            let number = Rect { x: between.right(), width: NUMBER as u16, ..area };
            let number = number.intersection(area);
            draw_text(brush, number, dialog, DialogField::Every, None, has_cursor);
            let rest = Rect {
                x: number.right() + 1,
                width: area.right().saturating_sub(number.right() + 1),
                ..area
            };
            let line = Line::from(brush.span(Role::Muted, "ms, at most 1000 ×"));
            return brush.line(rest, 0, &line);
        }
        [field] => {
            brush.line(area, 0, &Line::from(spans));
            let of = field.of_composition();
            let mistake = mistake.filter(|mistake| of == Some(mistake.field));
            let hint = hint(*field, dialog.kind);
            let text = dialog.line(*field).map_or(0, |line| line.value().width() + 1);
            let width = text.max(FIELD).min(room);
            let at = Rect { x: area.x + LABEL as u16, width: width as u16, ..area };
            let at = at.intersection(area);
            draw_text(brush, at, dialog, *field, mistake, has_cursor);
            let rest =
                Rect { x: at.right(), width: area.right().saturating_sub(at.right()), ..area };
            if hint.width() + 2 <= usize::from(rest.width) {
                let line = Line::from(brush.span(Role::Muted, format!("  {hint}")));
                brush.line(rest, 0, &line);
            }
            return;
        }
        _ => {}
    }
    brush.line(area, 0, &Line::from(spans));
}

/// The name of a row.
const fn label(row: &[DialogField], kind: MessageKind) -> &'static str {
    match (row, kind) {
        ([DialogField::Kind], _) => "kind",
        ([DialogField::To], _) => "to",
        ([DialogField::Service], MessageKind::Debug) => "code",
        ([DialogField::Service], _) => "service",
        ([DialogField::Data], MessageKind::Raw) => "frame",
        ([DialogField::Data], _) => "data",
        ([DialogField::Framing], _) => "framing",
        ([DialogField::From], _) => "from",
        ([DialogField::Fd, ..], _) => "flags",
        _ => "repeat",
    }
}

/// What can be typed.
const fn hint(field: DialogField, kind: MessageKind) -> &'static str {
    match (field, kind) {
        (DialogField::To, MessageKind::Request) => "name, UID, @12, all, all working",
        (DialogField::To, MessageKind::Response) => "name, UID or @12",
        (DialogField::To, _) => "empty, or rnd 85",
        (DialogField::Service, MessageKind::Debug) => "0x005, or a name",
        (DialogField::Service, _) => "des, 0x123",
        (DialogField::Data, MessageKind::Raw) => "ID#DATA",
        (DialogField::Data, _) => "01 FF, \"text\", of des: name, services",
        (DialogField::From, _) => "empty: descan",
        _ => "",
    }
}

/// All choices, or the chosen one with its place where `room` cells do not hold all.
fn choice_spans(
    brush: &DrawContext,
    choices: &[(&str, bool)],
    is_focused: bool,
    room: usize,
) -> Vec<Span<'static>> {
    let chosen = choices.iter().position(|(_, is_chosen)| *is_chosen);
    let needed: usize = choices.iter().map(|(word, _)| word.width() + 6).sum();
    if let Some(chosen) = chosen.filter(|_| needed.saturating_sub(2) > room) {
        let role = if is_focused { Role::Input } else { Role::Text };
        let place = format!("  {} of {}", chosen + 1, choices.len());
        let word = brush.span(role, format!("(•) {}", choices[chosen].0));
        return vec![word, brush.span(Role::Muted, place)];
    }
    let spans = choices.iter().map(|(word, is_chosen)| {
        let role = match (is_chosen, is_focused) {
            (true, true) => Role::Input,
            (true, false) => Role::Text,
            _ => Role::Muted,
        };
        let tick = if *is_chosen { "(•)" } else { "( )" };
        brush.span(role, format!("{tick} {word}  "))
    });
    spans.collect()
}

/// Draws a text that is typed, with its mistake underlined.
fn draw_text(
    brush: &mut DrawContext,
    at: Rect,
    dialog: &ComposerDialog,
    field: DialogField,
    mistake: Option<&Mistake>,
    has_cursor: bool,
) {
    let Some(line) = dialog.line(field) else { return };
    let width = usize::from(at.width);
    if width == 0 || at.height == 0 {
        return;
    }
    let scroll = line.visual_scroll(width.saturating_sub(1));
    let text: String = line.value().chars().skip(scroll).collect();
    let style = brush.style(Role::Input);
    brush.buffer.set_string(at.x, at.y, " ".repeat(width), style);
    brush.buffer.set_string(at.x, at.y, cut(&text, width), style);
    if let Some(mistake) = mistake {
        let word: String = line.value().chars().skip(mistake.column).collect();
        let word = word.split_whitespace().next().unwrap_or_default();
        let before: String = line.value().chars().take(mistake.column).collect();
        let from = before.width().saturating_sub(scroll).min(width);
        let to = (from + word.width()).min(width);
        let wrong = Rect { x: at.x + from as u16, width: (to - from) as u16, ..at };
        brush.buffer.set_style(wrong, brush.style(Role::Error));
        brush.buffer.set_style(wrong, Modifier::UNDERLINED);
    }
    if dialog.focus == field && has_cursor {
        let cursor = line.visual_cursor().saturating_sub(scroll).min(width - 1);
        brush.cursor = Some(Position::new(at.x + cursor as u16, at.y));
    }
}

/// The frame, its meaning, what was sent.
fn below(
    brush: &DrawContext,
    dialog: &ComposerDialog,
    composed: &Result<Composed, Mistake>,
    width: usize,
) -> Vec<Line<'static>> {
    let room = width.saturating_sub(LABEL + 1);
    let mut lines = Vec::new();
    let mut add = |label: &str, role: Role, text: &str| {
        for (at, part) in wrap(text, room).into_iter().enumerate() {
            let label = if at == 0 { label } else { "" };
            lines.push(Line::from(vec![
                brush.span(Role::Muted, fit(label, LABEL)),
                brush.span(role, part),
            ]));
        }
    };
    match composed {
        Ok(composed) => {
            let time = bus_time(brush, dialog, composed);
            add("  =", Role::Title, &format!("{}  {time}", composed.frame_text()));
            if let Some(change) = &composed.change {
                add("  !", Role::Warning, &format!("it {change}"));
            }
            if !composed.source_warning.is_empty() {
                add("  !", Role::Warning, &composed.source_warning);
            }
            add("", Role::Text, &composed.meaning);
            for warning in &composed.warnings {
                add("  !", Role::Warning, warning);
            }
        }
        Err(mistake) => {
            let label = match (mistake.field, dialog.kind) {
                (CompositionField::Data, MessageKind::Raw) => "frame",
                (field, _) => field.label(),
            };
            let text = format!("{label}: {mistake}");
            add("  ✗", Role::Error, &text);
        }
    }
    if let Err(why) = dialog.repeat() {
        add("  ✗", Role::Error, &why);
    }
    if let Some(why) = brush.app.dialog_obstacle(dialog) {
        add("  only", Role::Warning, &format!("shown, not sent: {why}"));
    }
    let sent: Vec<&SentFrames> = brush.app.sent_frames().rev().collect();
    if !sent.is_empty() {
        let rule = "─".repeat(width.saturating_sub(8));
        lines.push(Line::from(vec![
            brush.span(Role::TabActive, "─ sent "),
            brush.span(Role::Border, rule),
        ]));
    }
    for sending in sent {
        lines.extend(sent_lines(brush, sending));
    }
    lines
}

fn bus_time(brush: &DrawContext, dialog: &ComposerDialog, composed: &Composed) -> String {
    let Some(bus) = brush.app.bus(dialog.bus) else { return String::new() };
    if bus.lacks_bit_rate() {
        return String::new();
    }
    let rate = bus.bits_per_second();
    let data_rate = bus.status.data_bitrate.unwrap_or(rate);
    let nanos = composed.frames.iter().map(|frame| FrameBits::of(frame).nanos(rate, data_rate));
    let time = format_millis(Duration::from_nanos(nanos.sum()));
    format!("{time} of bus time at {}", crate::bitrate::kbit(rate))
}

/// What was sent, and its answers.
fn sent_lines(brush: &DrawContext, sending: &SentFrames) -> Vec<Line<'static>> {
    let (role, text) = match sending.result {
        Some(SendingResult::Done) => (Role::Text, sending.outcome_text()),
        Some(_) => (Role::Error, sending.outcome_text()),
        None if sending.end.is_some() => (Role::Muted, "waits for answers".to_owned()),
        None if sending.repeat.copies > 1 => {
            let key = brush.app.key_of(crate::keymap::Action::ComposeClose);
            let (sent, all) = (sending.copies, sending.repeat.copies);
            (Role::Title, format!("{sent} of {all} sent; {key} stops"))
        }
        None => (Role::Muted, "is being sent".to_owned()),
    };
    let time = clock_millis(brush.app, sending.asked);
    let frame = sending.composed.frame_text();
    let mut lines = vec![Line::from(vec![
        brush.span(Role::Muted, format!(" {time} ")),
        brush.span(Role::Request, format!("{frame} ")),
        brush.span(Role::Muted, format!("to {}: ", sending.composed.receiver)),
        brush.span(role, text),
    ])];
    let is_one = sending.repeat.copies == 1 && sending.answer_count == 1;
    let answers = sending.answers.iter().rev().filter(|_| !is_one);
    lines.extend(answers.map(|answer| {
        let role = if answer.answer.is_error { Role::Error } else { Role::Response };
        let latency = format_millis(answer.answer.latency);
        Line::from(vec![
            brush.span(Role::Muted, fit("", LABEL)),
            brush.span(role, format!("{} {latency}  {}", fit(&answer.who, 14), answer.text)),
        ])
    }));
    lines
}
