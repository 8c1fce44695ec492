//! The last line: the prompt of the filter, a message, or keys.

use super::FleetBrush;
use crate::app::{FleetPage, FleetPrompt};
use crate::cell_text::{cut, wrap};
use crate::keymap::Action;
use crate::theme::Role;
use crate::ui::brush::fit;
use ratatui::layout::{Position, Rect};
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Most lines of a message.
const MESSAGE_LINES: usize = 3;

/// Draws the footer.
pub fn draw(brush: &mut FleetBrush) {
    let area = brush.regions.footer;
    let screen = brush.screen;
    match (screen.message(), screen.prompt()) {
        (Some((text, is_error)), _) => {
            let role = if is_error { Role::Error } else { Role::Text };
            draw_above(brush, area.bottom(), role, text);
        }
        (None, Some(prompt)) => draw_prompt(brush, prompt),
        (None, None) => {
            let line = hints(brush);
            brush.line(area, 0, &line);
        }
    }
}

/// Draws a message on up to three lines, the last of which is above `bottom`.
fn draw_above(brush: &mut FleetBrush, bottom: u16, role: Role, text: &str) {
    let area = brush.regions.footer;
    let width = usize::from(area.width);
    let mut lines = wrap(text, width.saturating_sub(2));
    if lines.len() > MESSAGE_LINES {
        lines[MESSAGE_LINES - 1].push('…');
        lines.truncate(MESSAGE_LINES);
    }
    let height = (lines.len() as u16).min(bottom);
    let area = Rect { y: bottom - height, height, ..area };
    for (row, text) in lines.iter().enumerate() {
        let line = Line::from(brush.span(role, fit(&format!(" {text}"), width)));
        brush.line(area, row as u16, &line);
    }
}

/// Draws the line that is typed, and how many rows match, or the mistake in it.
fn draw_prompt(brush: &mut FleetBrush, prompt: &FleetPrompt) {
    let area = brush.regions.footer;
    let screen = brush.screen;
    let rows = screen.row_kind(screen.page());
    let text = prompt.input.value();
    let (role, note) = match &prompt.error {
        Some((error, column)) => (Role::Error, format!("✗ {error}, column {column}")),
        None if text.trim().is_empty() => (Role::Muted, rows.syntax().to_owned()),
        None => {
            let (hits, all) = (screen.rows().len(), screen.row_total());
            (Role::Muted, format!("{hits} of {all} {} match", rows.plural()))
        }
    };
    let width = usize::from(area.width);
    let label = if width < 60 { " / " } else { " filter: " };
    let room = width.saturating_sub(label.len() + 2);
    // The end of a long line is what is typed.
    let before = text.chars().take(prompt.input.cursor()).collect::<String>();
    let hidden = before.width().saturating_sub(room * 2 / 3);
    let skipped = cut(text, hidden).len();
    let shown = &text[skipped..];
    let at = label.len() + before.width().saturating_sub(cut(text, hidden).width());
    let note_width = width.saturating_sub(label.len() + shown.width() + 3);
    let mut spans = vec![brush.span(Role::Title, label), brush.span(Role::Input, shown)];
    if prompt.error.is_some() && note.width() > note_width {
        draw_above(brush, area.y, role, &note);
    } else if note_width > 8 {
        spans.push(brush.span(role, format!("  {}", fit(&note, note_width))));
    }
    brush.line(area, 0, &Line::from(spans));
    let x = area.x + (at as u16).min(area.width.saturating_sub(1));
    brush.cursor = Some(Position::new(x, area.y));
}

/// The keys of the page, as far as they fit.
fn hints(brush: &FleetBrush) -> Line<'static> {
    let screen = brush.screen;
    let is_help = screen.help().is_some();
    let is_opened = screen.opened().is_some();
    let is_alone = screen.details_alone().is_some();
    let open = match screen.page() {
        FleetPage::Main if !is_opened => "open",
        FleetPage::Versions => "which have it",
        _ if is_alone => "list",
        _ => "details",
    };
    let copy = screen.command_of_row().map(|_| "copy command");
    let keys = [
        (Action::Help, Some("help")),
        (Action::Details, Some(open)),
        (Action::Cancel, (is_opened || is_alone).then_some("back")),
        (Action::Rescan, screen.is_old().then_some("connect now")),
        (Action::Filter, Some("filter")),
        (Action::Quit, Some("quit")),
        (Action::Sort, Some("sort")),
        (Action::Copy, copy),
        (Action::NextPage, Some("next page")),
        (Action::Theme, Some("theme")),
    ];
    let of_help = [(Action::HelpDown, Some("scroll")), (Action::HelpClose, Some("close"))];
    let shown = if is_help { &of_help[..] } else { &keys[..] };
    let mut line = Line::default();
    for (action, word) in shown {
        let key = screen.options().keymap.keys_of(*action).next();
        let Some((key, word)) = key.zip(*word) else { continue };
        let (key, word) = (format!(" {key}"), format!(" {word} "));
        if line.width() + key.width() + word.width() > usize::from(brush.regions.footer.width) {
            break;
        }
        line.push_span(brush.span(Role::HintKey, key));
        line.push_span(brush.span(Role::Muted, word));
    }
    line
}
