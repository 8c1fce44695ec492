//! The help: keys of the keymap, symbols, filter terms, and the counters of each bus. Takes the
//! place of the page, in two columns from 112 columns on.

use super::brush::{DrawContext, fit, wrap};
use super::symbols::SYMBOLS;
use crate::app::{FILTER_FIELDS, FILTER_WORDS, clock_millis, format_duration};
use crate::keymap::{ACTIONS, ActionGroup, ActionInfo};
use crate::status::size;
use crate::theme::Role;
use crate::time::Duration;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Draws the help without its first `scroll` lines.
pub fn draw(brush: &mut DrawContext, scroll: u16) {
    let whole = brush.screen.whole;
    let top = brush.screen.tabs.y;
    let bottom = brush.screen.footer.y.max(top);
    let rule = Rect { y: top, height: brush.screen.tabs.height, ..whole };
    brush.rule(rule, Role::BorderFocus);
    let title = Line::from(brush.span(Role::TabActive, " Help "));
    brush.line(Rect { x: 1, width: whole.width.saturating_sub(1), ..rule }, 0, &title);
    let area = Rect {
        x: 1,
        y: top + rule.height,
        width: whole.width.saturating_sub(2),
        height: bottom.saturating_sub(top + rule.height),
    };
    let columns = if area.width >= 110 { 2 } else { 1 };
    let width = (area.width + 2) / columns - 2;
    let mut lines = keys(brush, width);
    let mut symbols = symbols(brush, width);
    symbols.extend(capture(brush, width));
    symbols.extend(counters(brush, width));
    if columns == 1 {
        lines.push(Line::default());
        lines.extend(symbols);
        brush.lines(area, &lines, scroll);
    } else {
        brush.lines(Rect { width, ..area }, &lines, scroll);
        brush.lines(Rect { x: area.x + width + 2, width, ..area }, &symbols, scroll);
    }
}

/// Every action with its keys, by groups.
fn keys(brush: &DrawContext, width: u16) -> Vec<Line<'static>> {
    let mut lines = Vec::new();
    // The keys of a log do nothing on a live bus.
    let is_used =
        |group: &ActionGroup| *group != ActionGroup::Log || brush.app.playback().is_some();
    for group in ActionGroup::ALL.into_iter().filter(is_used) {
        if !lines.is_empty() {
            lines.push(Line::default());
        }
        lines.push(Line::from(brush.span(Role::Title, group.title())));
        for action in ACTIONS.iter().filter(|action| action.group == group) {
            lines.extend(action_lines(brush, action, width));
        }
    }
    lines
}

/// An action: its keys (`–`: none) and what it does.
fn action_lines(brush: &DrawContext, action: &ActionInfo, width: u16) -> Vec<Line<'static>> {
    const KEYS: usize = 15;
    let keys: Vec<String> =
        brush.app.keymap().keys_of(action.action).map(|key| key.to_string()).collect();
    let keys = if keys.is_empty() { "–".to_owned() } else { keys.join(" ") };
    two_columns(brush, (Role::HintKey, &keys), KEYS, action.doc, width)
}

/// Symbols and filter terms.
fn symbols(brush: &DrawContext, width: u16) -> Vec<Line<'static>> {
    let mut lines = vec![Line::from(brush.span(Role::Title, "Symbols"))];
    for (role, sign, meaning) in SYMBOLS {
        lines.extend(two_columns(brush, (role, sign), 18, meaning, width));
    }
    lines.push(Line::default());
    lines.push(Line::from(brush.span(Role::Title, "Filter")));
    let fields = FILTER_FIELDS.iter().map(|field| {
        let words: Vec<String> = field.words.iter().map(|word| format!("{word}:")).collect();
        (words.join(" "), field.doc)
    });
    let words = FILTER_WORDS.iter().map(|&(word, doc)| (word.to_owned(), doc));
    let any = ("feed".to_owned(), "rows that contain the word; several terms: all must match");
    for (term, doc) in std::iter::once(any).chain(fields).chain(words) {
        lines.extend(two_columns(brush, (Role::HintKey, &term), 18, doc, width));
    }
    lines
}

/// The captured frames: since when, and how long they are kept at the present load.
fn capture(brush: &DrawContext, width: u16) -> Vec<Line<'static>> {
    let (app, capture) = (brush.app, brush.app.capture());
    let mut lines = vec![Line::default(), Line::from(brush.span(Role::Title, "Capture"))];
    let stored = capture.end() - capture.first();
    let since = capture.get(capture.first()).map(|first| clock_millis(app, first.time));
    let since = since.map_or_else(|| "no frames yet".to_owned(), |at| format!("since {at}"));
    let rate: u32 = app.buses().iter().map(|bus| bus.meter.last().frames).sum();
    let length = match u64::from(rate) {
        0 => "–".to_owned(),
        rate => format_duration(Duration::from_secs(capture.capacity() / rate)),
    };
    let room = format!("of {} frames in {}", capture.capacity(), size(capture.room() as u64));
    for (name, value, meaning) in [
        ("frames", stored.to_string(), format!("{since}, {room}")),
        ("kept for", length, format!("at {rate} frames/s; longer with --capture SIZE")),
        ("dropped", capture.first().to_string(), "the oldest; those near evidence stay".into()),
    ] {
        let left = format!("{name:<12}{value:>11}");
        lines.extend(two_columns(brush, (Role::Text, &left), 24, &meaning, width));
    }
    lines
}

/// Approximate size of a waiting frame in the kernel's receive buffer, in bytes.
const KERNEL_BYTES_PER_FRAME: u32 = 800;

/// The counters of each bus and the size of the kernel's receive buffer. All places where frames
/// can be lost are listed, also while their counters are 0.
fn counters(brush: &DrawContext, width: u16) -> Vec<Line<'static>> {
    let mut lines = Vec::new();
    for bus in brush.app.buses() {
        let (engine, status) = (bus.counters(), &bus.status);
        lines.push(Line::default());
        let title = format!("Counters of {}", bus.name);
        lines.push(Line::from(brush.span(Role::Title, title)));
        for (name, count, meaning) in [
            ("frames", engine.frames, "received, own frames included"),
            ("sent", engine.sent, "own frames confirmed on the bus"),
            ("errors", engine.errors, "error frames"),
            ("non-platform", engine.non_platform, "11-bit and remote frames, not decoded"),
            ("non-conforming", engine.non_conforming, "unknown message type"),
            ("malformed", engine.malformed, "responses unusable or only partly usable"),
            ("aborted", engine.transfers_failed, "multi-frame responses not completed"),
            ("not stored", engine.over_limit, "rows and findings over the limit"),
            ("lost: kernel", status.kernel_drops, "kernel receive buffer full"),
            ("lost: adapter", status.controller_overruns, "controller overrun"),
            ("lost: queue", status.queue_drops, "receive queue full"),
            ("not sent", status.transmit_failures, "rejected or timed out"),
            ("unreadable", status.unreadable, "messages of the adapter or server"),
        ] {
            // Only adapters and servers send messages; a CAN interface never has any.
            if name == "unreadable" && count == 0 {
                continue;
            }
            let left = format!("{name:<14}{count:>9}");
            lines.extend(two_columns(brush, (Role::Text, &left), 24, meaning, width));
        }
        let buffer = status.receive_buffer.map(|bytes| {
            let held = bytes / KERNEL_BYTES_PER_FRAME;
            format!("receive buffer {}, about {held} frames", size(u64::from(bytes)))
        });
        for text in buffer.into_iter().chain(status.note.clone()) {
            let text = crate::text::Escaped(text.as_bytes()).to_string();
            let room = usize::from(width).saturating_sub(4);
            lines.extend(
                wrap(&text, room)
                    .into_iter()
                    .map(|part| Line::from(vec![Span::raw("  "), brush.span(Role::Muted, part)])),
            );
        }
    }
    lines
}

/// Two columns, both wrapped: `left_width` cells, and the rest of `width`.
fn two_columns(
    brush: &DrawContext,
    (role, left): (Role, &str),
    left_width: usize,
    right: &str,
    width: u16,
) -> Vec<Line<'static>> {
    let room = usize::from(width).saturating_sub(left_width + 3);
    let fits = left.width() <= left_width;
    let left = if fits { vec![left.to_owned()] } else { wrap(left, left_width) };
    let right = wrap(right, room);
    (0..left.len().max(right.len()))
        .map(|at| {
            let part = |parts: &[String]| parts.get(at).cloned().unwrap_or_default();
            let left = brush.span(role, fit(&part(&left), left_width));
            let right = brush.span(Role::Text, format!(" {}", part(&right)));
            Line::from(vec![Span::raw("  "), left, right])
        })
        .collect()
}
