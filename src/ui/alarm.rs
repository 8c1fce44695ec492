//! The alarm line below the status: the newest confirmed conflict, filled until the user has gone to
//! it; `+1` counts the others. On a small screen the counts stand behind it.

use super::brush::{DrawContext, fit};
use super::status::short_counts;
use crate::keymap::Action;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Width from which the keys of the alarm are shown, in columns.
const KEYS_WIDTH: usize = 130;

/// Draws the line.
pub fn draw(brush: &mut DrawContext) {
    let area = brush.screen.alarm;
    let Some(alarm) = brush.app.alarm() else { return };
    if area.height == 0 {
        return;
    }
    let role = if alarm.is_seen { Role::Confirmed } else { Role::Alarm };
    let others = if alarm.others > 0 { format!(" +{}", alarm.others) } else { String::new() };
    // In the place of the status: its counts.
    let counts = if brush.screen.status.height == 0 { short_counts(brush) } else { Vec::new() };
    let behind: usize = counts.iter().map(Span::width).sum();
    let width = usize::from(area.width);
    let room = width.saturating_sub(3 + others.width() + behind + usize::from(behind > 0));
    let end = [" (since", " (detected"].into_iter().find_map(|word| alarm.text.rfind(word));
    let without_since = &alarm.text[..end.unwrap_or(alarm.text.len())];
    let texts = [&*alarm.text, without_since, &alarm.short];
    let text = texts.into_iter().find(|text| text.width() <= room).unwrap_or(&alarm.short);
    let text = if text.width() > room { fit(text, room) } else { text.to_owned() };
    let line = Line::from(brush.span(role, format!(" ⚠ {text}{others}")));
    brush.line(area, 0, &line);
    let keys = Line::from(keys(brush, role));
    let end = if behind > 0 { Line::from(counts) } else { keys };
    let end_width = end.width() as u16 + 1;
    if behind > 0 || width >= KEYS_WIDTH.max(line.width() + usize::from(end_width) + 2) {
        let x = area.right().saturating_sub(end_width);
        brush.line(Rect { x, width: area.right() - x, ..area }, 0, &end);
    }
    if !alarm.is_seen {
        brush.fill(area, Role::Alarm);
    }
}

fn keys(brush: &DrawContext, role: Role) -> Vec<Span<'static>> {
    let keymap = brush.app.keymap();
    let text =
        |action, does: &str| keymap.keys_of(action).next().map(|key| format!("{key} {does}"));
    let all = [text(Action::Problem, "shows it"), text(Action::Mute, "mutes it")];
    let all: Vec<String> = all.into_iter().flatten().collect();
    vec![brush.span(role, all.join("   "))]
}
