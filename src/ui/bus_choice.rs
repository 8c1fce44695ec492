//! The list of buses to open, on the whole screen. Inputs: the choice and a theme. Output: cells.

use super::ascii;
use super::brush::fit;
use crate::app::{Alarm, BIT_RATES, BusChoice, BusOffer, Signs};
use crate::keymap::Action;
use crate::text::Escaped;
use crate::theme::{Role, Theme};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Width of the name, in columns.
const NAME: usize = 20;
/// Height from which the other kinds of buses have a line.
const HIGH: u16 = 12;

/// Draws the list, below the alarm of the session if there is one.
pub fn draw_choice(
    choice: &BusChoice,
    alarm: Option<&Alarm>,
    theme: &Theme,
    signs: Signs,
    frame: &mut Frame,
) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    buffer.set_style(area, theme.style(Role::Background));
    buffer.set_style(area, theme.style(Role::Text));
    let width = usize::from(area.width);
    let title = " descan: which bus? ";
    let reason = Escaped(choice.reason.as_bytes()).to_string();
    let rest = width.saturating_sub(title.len() + reason.width() + 4);
    let rule = format!("─{title}{} {reason} ─", "─".repeat(rest));
    buffer.set_stringn(0, area.y, fit(&rule, width), width, theme.style(Role::BorderFocus));

    let mut top = area.y + 1;
    if let Some(alarm) = alarm.filter(|_| area.height >= HIGH) {
        let text = fit(&format!(" ⚠ {}", alarm.text), width);
        let look = if alarm.is_seen { Role::Confirmed } else { Role::Alarm };
        buffer.set_stringn(0, top, text, width, theme.style(look));
        top += 1;
    }
    let (lines, selected) = lines_of(choice, theme, width);
    let below = bottom_lines(choice, theme, width, area.height >= HIGH);
    let room = usize::from(area.bottom().saturating_sub(top)).saturating_sub(below.len());
    let first = (selected.unwrap_or(0) + 1).saturating_sub(room);
    for (row, line) in lines.iter().skip(first).take(room).enumerate() {
        let y = top + row as u16;
        buffer.set_line(0, y, line, area.width);
        if Some(row + first) == selected {
            let line = Rect { y, height: 1, ..area };
            buffer.set_style(line, theme.style(Role::Selected));
        }
    }
    let first = area.bottom().saturating_sub(below.len() as u16).max(top);
    for (y, line) in (first..area.bottom()).zip(&below) {
        buffer.set_line(0, y, line, area.width);
    }
    if signs == Signs::Ascii {
        ascii::replace(buffer);
    }
}

/// Returns the lines of the list, and the place of the selected one.
fn lines_of(
    choice: &BusChoice,
    theme: &Theme,
    width: usize,
) -> (Vec<Line<'static>>, Option<usize>) {
    let span = |role, text: String| Span::styled(text, theme.style(role));
    let mut lines = Vec::new();
    let mut selected_line = None;
    let mut section = None;
    for at in choice.shown() {
        let offer = &choice.offers()[at];
        if section.replace(offer.kind) != Some(offer.kind) {
            lines.push(Line::from(span(Role::Header, format!(" {}", offer.kind.title()))));
        }
        let is_selected = at == choice.selected();
        if is_selected {
            selected_line = Some(lines.len());
        }
        let sign = if is_selected { "▸" } else { " " };
        let chosen = match (choice.is_chosen(at), choice.is_open(at)) {
            (true, _) => "✓",
            (false, true) => "●",
            (false, false) => " ",
        };
        let role = if offer.command.is_some() { Role::Warning } else { Role::Text };
        let text = facts_of(choice, at, offer, is_selected);
        lines.push(Line::from(vec![
            span(Role::FileOk, format!("{sign}{chosen} ")),
            span(Role::Title, format!("{} ", fit(&offer.name, NAME))),
            span(role, fit(&text, width.saturating_sub(NAME + 4)).trim_end().to_owned()),
        ]));
    }
    if lines.is_empty() {
        let why =
            if choice.offers().is_empty() { "looking…" } else { "no line with these words" };
        lines.push(Line::from(span(Role::Muted, format!(" {why}"))));
    }
    (lines, selected_line)
}

fn facts_of(choice: &BusChoice, at: usize, offer: &BusOffer, is_selected: bool) -> String {
    if let Some(command) = &offer.command {
        // The command has the bit rate.
        return format!("DOWN  {command}");
    }
    if choice.is_open(at) {
        return "open".to_owned();
    }
    match choice.bit_rate(at) {
        None => offer.facts.clone(),
        Some(rate) if !is_selected => format!("{}k  {}", rate / 1000, offer.facts),
        Some(rate) => {
            let rates = BIT_RATES.map(|each| {
                let text = (each / 1000).to_string();
                if each == rate { format!("[{text}]") } else { text }
            });
            format!("kbit/s: {}  {}", rates.join(" "), offer.facts)
        }
    }
}

/// Actions whose keys are shown below the list, before that which closes it.
const KEYS: [Action; 6] = [
    Action::ChoiceOpen,
    Action::ChoiceToggle,
    Action::ChoiceBitrate,
    Action::ChoiceSearch,
    Action::ChoiceCopy,
    Action::ChoiceTheme,
];

/// Joins texts to lines that are no wider than `width`, if a text alone is not.
fn joined(texts: impl IntoIterator<Item = String>, gap: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for text in texts {
        match lines.last_mut() {
            Some(line) if line.width() + gap.len() + text.width() <= width => {
                *line = format!("{line}{gap}{text}");
            }
            _ => lines.push(text),
        }
    }
    lines
}

/// Returns the lines below the list: options, other kinds of buses, keys or a message.
fn bottom_lines(
    choice: &BusChoice,
    theme: &Theme,
    width: usize,
    is_high: bool,
) -> Vec<Line<'static>> {
    let room = width.saturating_sub(1);
    let line = |role, text: String| {
        let text = if text.width() > width { fit(&text, width) } else { text };
        Line::from(Span::styled(text, theme.style(role)))
    };
    let option = |is_on: bool, text: &str, action| {
        let key = choice.keymap().key_text(action);
        format!("[{}] {text} ({key})", if is_on { "x" } else { " " })
    };
    let mut options = vec![
        option(choice.is_listen_only(), "listen only", Action::ChoiceListenOnly),
        option(choice.is_without_requests(), "ask no names", Action::ChoiceNoNames),
    ];
    let records = choice.is_recorded();
    options
        .extend(records.map(|is_on| option(is_on, "record to session.log", Action::ChoiceRecord)));
    let in_place = choice.is_in_place();
    options
        .extend(in_place.map(|is_on| option(is_on, "in place of the open", Action::ChoiceInPlace)));
    let mut lines = Vec::new();
    if is_high {
        let other =
            " Other: udp:239.74.163.2   socketcand://HOST/can0   ssh HOST candump -L can0 | …";
        lines.push(line(Role::Muted, other.to_owned()));
    }
    // On a low screen the list needs the lines.
    let option_lines = if is_high { usize::MAX } else { 1 };
    let options = joined(options, "   ", room);
    lines.extend(
        options
            .into_iter()
            .take(option_lines)
            .map(|options| line(Role::Muted, format!(" {options}"))),
    );
    lines.push(match (choice.note(), choice.search()) {
        (Some(note), _) => line(Role::Warning, format!(" {note}")),
        (None, Some((words, is_typing))) => {
            let words = Escaped(words.as_bytes());
            let keys = if is_typing { "▏  Enter keep  " } else { "  " };
            line(Role::Input, format!(" / {words}{keys}Esc all lines again"))
        }
        (None, None) => {
            let is_first = choice.is_in_place().is_none();
            let shown = KEYS.iter().filter(|action| is_first || **action != Action::ChoiceTheme);
            let hint = |action: Action| {
                let (key, word) = choice.keymap().hint(action)?;
                let quits = is_first && action == Action::ChoiceClose;
                Some(format!("{key} {}", if quits { "quit" } else { word }))
            };
            // Those that fit whole beside the way out.
            let close = hint(Action::ChoiceClose).unwrap_or_default();
            let beside = room.saturating_sub(close.width() + 2);
            let hints = joined(shown.filter_map(|action| hint(*action)), "  ", beside);
            let fitting = hints.into_iter().next().filter(|it| it.width() <= beside);
            let shown: Vec<_> = fitting.into_iter().chain([close]).collect();
            line(Role::Muted, format!(" {}", shown.join("  ")))
        }
    });
    lines
}
