//! The heartbeat history of the selected device: sixty periods a line, each line with its time and
//! its statistics, and what is known of the chosen heartbeat.

use super::strip;
use crate::app::{BEATS_PER_LINE, Beat, BeatKind, BeatStats, clock_millis, format_time_of_day};
use crate::cell_text::wrap;
use crate::keymap::Action;
use crate::theme::Role;
use crate::ui::brush::DrawContext;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Cells in front of the heartbeats of a line: the time and blanks around it.
const TIME: usize = 10;

/// Draws the lines that fit around the chosen heartbeat, at first the newest ones.
pub fn draw(brush: &mut DrawContext, area: Rect) {
    let app = brush.app;
    let beats = app.beat_history();
    if area.height == 0 {
        return;
    }
    if beats.is_empty() {
        let line = Line::from(brush.span(Role::Muted, " no heartbeats captured"));
        return brush.line(area, 0, &line);
    }
    let chosen = app.chosen_beat(&beats);
    // The last line tells about the chosen heartbeat.
    let about = about(brush, &beats, chosen, area.width);
    let height = usize::from(area.height).saturating_sub(about.len()).max(1);
    let lines: Vec<&[Beat]> = beats.chunks(BEATS_PER_LINE).collect();
    let last = chosen.map_or(lines.len() - 1, |at| at / BEATS_PER_LINE);
    // The chosen line is not the first one on the screen, if there is one before it.
    let top = (lines.len().saturating_sub(height)).min(last.saturating_sub(height / 2));
    for (row, beats) in lines.iter().enumerate().skip(top).take(height) {
        let chosen = chosen.and_then(|at| at.checked_sub(row * BEATS_PER_LINE));
        let line = beat_line(brush, beats, chosen.filter(|at| *at < beats.len()), area.width);
        brush.line(area, (row - top) as u16, &line);
    }
    let below = (lines.len() - top).min(height) as u16;
    for (row, line) in about.iter().enumerate() {
        brush.line(area, below + row as u16, line);
    }
}

/// Returns a line: time, cells, statistics as far as they fit.
fn beat_line(
    brush: &DrawContext,
    beats: &[Beat],
    chosen: Option<usize>,
    width: u16,
) -> Line<'static> {
    let time = beats.first().map(|beat| format_time_of_day(brush.app, beat.time));
    let mut line = Line::from(brush.span(Role::Muted, format!(" {} ", time.unwrap_or_default())));
    let room = usize::from(width).saturating_sub(TIME).min(BEATS_PER_LINE);
    // A narrow screen shows the end of a line, or the part with the chosen heartbeat.
    let from = chosen.unwrap_or(beats.len()).saturating_sub(room.saturating_sub(1));
    let from = from.min(beats.len().saturating_sub(room));
    let shown = &beats[from..beats.len().min(from + room)];
    for (at, beat) in shown.iter().enumerate() {
        let (sign, role) = strip::sign(beat.kind);
        let style = brush.style(role);
        let is_chosen = chosen == Some(from + at);
        let style = if is_chosen { style.patch(brush.style(Role::Selected)) } else { style };
        line.push_span(Span::styled(sign, style));
    }
    let blank = room.saturating_sub(shown.len());
    let stats = BeatStats::of(beats);
    let range = stats.range.map_or_else(String::new, |(least, most)| {
        let millis = |it: crate::time::Duration| it.as_micros() as f64 / 1000.0;
        format!("period {:.1} … {:.1} ms", millis(least), millis(most))
    });
    let count =
        if stats.count == 1 { "1 beat".to_owned() } else { format!("{} beats", stats.count) };
    let missed = format!("missed {}", stats.missed);
    let texts = [
        format!("  {count:<9} {range:<28} {missed}"),
        format!("  {count:<9} {missed}"),
        if stats.missed > 0 { format!(" ×{}", stats.missed) } else { String::new() },
    ];
    let left = usize::from(width).saturating_sub(TIME + room);
    if let Some(text) = texts.into_iter().find(|text| text.trim_end().width() <= left) {
        let role = if stats.missed > 0 { Role::Text } else { Role::Muted };
        let text = format!("{}{}", " ".repeat(blank), text.trim_end());
        line.push_span(brush.span(role, text));
    }
    line
}

/// Returns what is known of the chosen heartbeat, and the keys.
fn about(
    brush: &DrawContext,
    beats: &[Beat],
    chosen: Option<usize>,
    width: u16,
) -> Vec<Line<'static>> {
    let app = brush.app;
    let key = app.key_of(Action::Details);
    let Some((at, beat)) = chosen.and_then(|at| Some((at, beats.get(at)?))) else {
        let (left, right) = (app.key_of(Action::Back), app.key_of(Action::Into));
        let close = app.key_of(Action::Heartbeats);
        let text = format!(
            "{left} {right} choose a heartbeat; {key} shows its frames; {close} closes this"
        );
        return indented(brush, Role::Muted, &text, " ", width);
    };
    let time = clock_millis(app, beat.time);
    let millis = beat.gap.map(|gap| gap.as_micros() as f64 / 1000.0);
    let since =
        millis.map_or_else(String::new, |millis| format!(": {millis:.1} ms after the one before"));
    let mode = beat.mode.map(|mode| format!(", {mode}")).unwrap_or_default();
    let text = match beat.kind {
        BeatKind::OnTime => format!("{time} on time{since}{mode}"),
        BeatKind::OffTime => format!("{time} early or late{since}{mode}"),
        BeatKind::Double => format!("{time} two heartbeats in one period{since}{mode}"),
        BeatKind::Unknown => format!("{time} no heartbeat was expected"),
        BeatKind::Missed => {
            let next = beats[at..].iter().find(|beat| beat.number.is_some());
            let until = next.map_or_else(
                || ", nothing received since".to_owned(),
                |next| {
                    let mode = next.mode.map(|mode| format!(" ({mode})")).unwrap_or_default();
                    format!(", nothing received until {}{mode}", clock_millis(app, next.time))
                },
            );
            format!("{time} missed: expected then{until}")
        }
    };
    indented(brush, Role::Text, &format!("{text}; {key} shows the frames around it"), "▸", width)
}

fn indented(
    brush: &DrawContext,
    role: Role,
    text: &str,
    sign: &str,
    width: u16,
) -> Vec<Line<'static>> {
    let lines = wrap(text, usize::from(width).saturating_sub(1));
    lines
        .into_iter()
        .enumerate()
        .map(|(at, line)| {
            let sign = if at == 0 { sign.to_owned() } else { " ".to_owned() };
            Line::from(vec![brush.span(Role::Text, sign), brush.span(role, line)])
        })
        .collect()
}
