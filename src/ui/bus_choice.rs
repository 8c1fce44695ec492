//! The list of buses to open, on the whole screen. Inputs: the choice and a theme. Output: cells.

use super::ascii;
use super::brush::fit;
use crate::app::{BusChoice, Signs};
use crate::theme::{Role, Theme};
use ratatui::Frame;
use ratatui::text::{Line, Span};

/// Width of the name, in columns.
const NAME: usize = 22;

/// Draws the list.
pub fn draw_choice(choice: &BusChoice, theme: &Theme, signs: Signs, frame: &mut Frame) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    buffer.set_style(area, theme.style(Role::Background));
    buffer.set_style(area, theme.style(Role::Text));
    let width = usize::from(area.width);
    let span = |role, text: String| Span::styled(text, theme.style(role));
    let mut lines = Vec::new();
    let mut selected_line = 0;
    let mut section = None;
    for (at, offer) in choice.offers().iter().enumerate() {
        if section.replace(offer.kind) != Some(offer.kind) {
            lines.push(Line::from(span(Role::Header, format!(" {}", offer.kind.title()))));
        }
        let is_selected = at == choice.selected();
        if is_selected {
            selected_line = lines.len();
        }
        let sign = if is_selected { "▸" } else { " " };
        let chosen = if choice.is_chosen(at) { "✓" } else { " " };
        let rate = choice.bit_rate(at).map(|rate| format!("{}k  ", rate / 1000));
        let (role, note) = match &offer.command {
            Some(command) => (Role::Warning, format!("DOWN   {command}")),
            None => (Role::Text, offer.facts.clone()),
        };
        let text = format!("{}{note}", rate.unwrap_or_default());
        lines.push(Line::from(vec![
            span(Role::FileOk, format!("{sign}{chosen} ")),
            span(Role::Title, format!("{} ", fit(&offer.name, NAME))),
            span(role, fit(&text, width.saturating_sub(NAME + 4)).trim_end().to_owned()),
        ]));
    }
    let title = " descan: which bus? ";
    let rest = width.saturating_sub(title.len() + choice.reason.chars().count() + 4);
    let rule = format!("─{title}{} {} ─", "─".repeat(rest), choice.reason);
    buffer.set_stringn(0, area.y, fit(&rule, width), width, theme.style(Role::BorderFocus));
    let room = usize::from(area.height).saturating_sub(3);
    let first = (selected_line + 1).saturating_sub(room);
    for (row, line) in lines.iter().skip(first).take(room).enumerate() {
        let y = area.y + 1 + row as u16;
        buffer.set_line(0, y, line, area.width);
        if row + first == selected_line && !choice.offers().is_empty() {
            let line = ratatui::layout::Rect { y, height: 1, ..area };
            buffer.set_style(line, theme.style(Role::Selected));
        }
    }
    if area.height > 2 {
        let tick = if choice.is_listen_only() { "x" } else { " " };
        let text = format!(
            " [{tick}] listen only (l)   Other: descan udp:239.74.163.2   descan socketcand://HOST/can0"
        );
        let text = fit(&text, width);
        buffer.set_stringn(0, area.bottom() - 2, text, width, theme.style(Role::Muted));
    }
    let keys = " Space choose several  Enter open  e bit rate  y copy command  q quit";
    let (style_of, text) = match choice.note() {
        Some(note) => (Role::Warning, format!(" {note}")),
        None => (Role::Muted, keys.to_owned()),
    };
    if area.height > 1 {
        let text = fit(&text, width);
        buffer.set_stringn(0, area.bottom() - 1, text, width, theme.style(style_of));
    }
    if signs == Signs::Ascii {
        ascii::replace(buffer);
    }
}
