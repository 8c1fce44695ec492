//! The last line of the screen, in this order of precedence: a prompt, a confirmation, a message,
//! the keys of the open page. A message or a rejected input that needs more room takes up to three
//! lines.

use super::brush::{DrawContext, cut, fit, wrap};
use crate::app::{FileError, Focus, InputCheck, Page, PromptKind};
use crate::keymap::{Action, Key, KeyMode};
use crate::theme::Role;
use ratatui::layout::{Position, Rect};
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Draws the footer.
pub fn draw(brush: &mut DrawContext) {
    let area = brush.screen.footer;
    if area.height == 0 {
        return;
    }
    if brush.app.prompt().is_some() {
        return draw_prompt(brush, area);
    }
    if let (Some(long), Some(short)) = (brush.app.question(), brush.app.question_in_short()) {
        // The keys are never cut; the confirmation is.
        let keys = Line::from(hints(brush, &[Action::Yes, Action::No], usize::MAX));
        let room = area.width.saturating_sub(keys.width() as u16 + 1);
        let own = |text: &str| text.width() as u16 + 3;
        let text = if own(&long) > room { short } else { long };
        let width = own(&text).min(room);
        let text = fit(&format!(" {text}"), usize::from(width.saturating_sub(2))) + "  ";
        let mut line = Line::from(brush.span(Role::Warning, text));
        line.spans.extend(keys.spans);
        return brush.line(area, 0, &line);
    }
    let mode = brush.app.mode();
    if let Some(message) = brush.app.message().filter(|_| mode == KeyMode::Browse) {
        let role = if message.is_error { Role::Error } else { Role::Text };
        return draw_wrapped(brush, area, role, &message.text);
    }
    let line = Line::from(hint_line(brush, mode, usize::from(area.width)));
    brush.line(area, 0, &line);
}

/// Draws the prompt: its label, the text typed so far, and the check of that text. On Devices the
/// address is typed in the row (`brush.cursor` is set), and the footer has only the check.
fn draw_prompt(brush: &mut DrawContext, area: Rect) {
    let app = brush.app;
    let (Some(prompt), Some(check)) = (app.prompt(), app.prompt_check()) else { return };
    let (sign, role, note) = match &check {
        InputCheck::Accepted(text) => ("", Role::Muted, text),
        InputCheck::Warning(text) => ("! ", Role::Warning, text),
        InputCheck::Rejected(text) => ("✗ ", Role::Error, text),
    };
    let in_row = brush.cursor.is_some();
    let narrow = area.width < 60 && !in_row;
    let label = app.prompt_label().filter(|_| !narrow);
    let label = format!(" {}: ", label.unwrap_or_else(|| prompt.kind.short_label().to_owned()));
    let label_width = label.width() as u16;
    let mut line = Line::from(brush.span(Role::Title, label));
    if in_row {
        if line.width() + sign.width() + note.width() > usize::from(area.width) {
            line = Line::from(" ");
        }
        line.push_span(brush.span(role, format!("{sign}{note}")));
        return brush.line(area, 0, &line);
    }
    let left = area.width.saturating_sub(label_width);
    let note_width = (sign.width() + note.width()) as u16 + 2;
    let text_width = prompt.input.value().width() as u16;
    // Two cells more than the text: the cursor stands behind it without scrolling.
    let wanted = (text_width + 2).max(24);
    let least = match prompt.kind {
        PromptKind::Address(_) => 6,
        // The path matters more than the note on it (the number of entries).
        _ if prompt.kind.is_path() && matches!(check, InputCheck::Accepted(_)) => wanted,
        _ => 12,
    };
    let width = wanted.min(left.saturating_sub(note_width).max(least)).min(left);
    brush.line(area, 0, &line);
    let at = Rect { x: area.x + label_width, width, ..area };
    let scroll = prompt.input.visual_scroll(usize::from(width.saturating_sub(1)));
    let text: String = prompt.input.value().chars().skip(scroll).collect();
    let style = brush.style(Role::Input);
    brush.buffer.set_string(at.x, at.y, " ".repeat(usize::from(width)), style);
    brush.buffer.set_string(at.x, at.y, cut(&text, usize::from(width)), style);
    let cursor = prompt.input.visual_cursor().saturating_sub(scroll) as u16;
    brush.cursor = Some(Position::new(at.x + cursor.min(width.saturating_sub(1)), at.y));
    let behind = Rect { x: at.right(), width: left.saturating_sub(width), ..area };
    let is_fine = matches!(check, InputCheck::Accepted(_));
    if note_width > behind.width && !is_fine && area.y > 0 {
        // A warning or a rejection is never cut: it goes above the line.
        let above = Rect { y: area.y - 1, ..area };
        return draw_wrapped(brush, above, role, &format!("{sign}{note}"));
    }
    let line = Line::from(brush.span(role, format!("  {sign}{note}")));
    brush.line(behind, 0, &line);
}

/// Draws a text that ends in the line `last` and takes up to two lines above it.
fn draw_wrapped(brush: &mut DrawContext, last: Rect, role: Role, text: &str) {
    /// Most lines of a text; the rest is cut with `…`.
    const LINES: usize = 3;
    let width = usize::from(last.width);
    let parts = wrap(text, width.saturating_sub(1));
    let shown = parts.len().min(LINES).min(usize::from(last.y) + 1);
    for (above, part) in parts[..shown].iter().rev().enumerate() {
        let dots = if above == 0 && parts.len() > shown { " …" } else { "" };
        let line = Line::from(brush.span(role, fit(&format!(" {part}{dots}"), width)));
        brush.line(Rect { y: last.y - above as u16, ..last }, 0, &line);
    }
}

/// Returns the keys of the open page, most important first, as many as fit `width` cells.
fn hint_line(brush: &DrawContext, mode: KeyMode, width: usize) -> Vec<Span<'static>> {
    use Action as A;
    let app = brush.app;
    let view = app.view();
    let actions: &[Action] = match (mode, view.page, view.focus) {
        (KeyMode::Help, ..) => &[A::HelpClose, A::HelpDown],
        (KeyMode::Confirm, ..) => &[A::Yes, A::No],
        (KeyMode::Conflict, ..) => &[A::Ours, A::Theirs, A::Later],
        (KeyMode::Browse, Page::Devices, Focus::List) => &[
            A::Help,
            A::Quit,
            A::EditAddress,
            A::Add,
            A::Rescan,
            A::Filter,
            A::Undo,
            A::Details,
            A::Freeze,
            A::Sort,
            A::Problem,
            A::ClearLost,
            A::Identify,
        ],
        (KeyMode::Browse, Page::Traffic, _) if view.evidence.is_some() => {
            &[A::Help, A::Quit, A::Details, A::Cancel, A::Freeze, A::SaveCapture]
        }
        (KeyMode::Browse, Page::Traffic, _) if view.from_timeline => {
            &[A::Help, A::Quit, A::Details, A::Cancel, A::Filter, A::Freeze, A::SaveCapture]
        }
        (KeyMode::Browse, Page::Traffic, _) => &[
            A::Help,
            A::Quit,
            A::Details,
            A::Filter,
            A::Freeze,
            A::Identifiers,
            A::SaveCapture,
            A::Rescan,
        ],
        (KeyMode::Browse, Page::Timeline, _) => {
            &[A::Help, A::Quit, A::Details, A::Filter, A::Freeze, A::Problem, A::SaveCapture]
        }
        (KeyMode::Browse, Page::Devices, Focus::Details) => {
            &[A::Help, A::Quit, A::Cancel, A::EditAddress, A::Add, A::Problem, A::Rescan]
        }
        (KeyMode::Browse, Page::Problems, _) => &[
            A::Help,
            A::Quit,
            A::Details,
            A::Mute,
            A::Filter,
            A::Problem,
            A::EditAddress,
            A::Rescan,
        ],
    };
    let is_not_saved = app.file().problem().is_some_and(FileError::is_not_saved);
    let first: &[Action] =
        if is_not_saved && mode == KeyMode::Browse { &[A::Save, A::SaveCopy] } else { &[] };
    let actions = &[first, actions].concat();
    let mut spans = vec![Span::raw(" ")];
    spans.extend(hints(brush, actions, width.saturating_sub(1)));
    spans
}

/// Returns the first key of an action and what it does on the open page; `None` if it has no key.
fn hint(brush: &DrawContext, action: Action) -> Option<(Key, &'static str)> {
    use Action as A;
    let (key, word) = brush.app.keymap().hint(action)?;
    let view = brush.app.view();
    let here = match (action, view.page, &view.evidence) {
        (A::Details, Page::Timeline, _) => "frames",
        (A::Details, Page::Problems, _) if brush.screen.details.height > 0 => {
            let is_seen = brush.app.selected_problem().is_none_or(|problem| problem.has_evidence());
            if is_seen { "frames" } else { "go to row" }
        }
        (A::Details, Page::Traffic, Some(evidence)) if evidence.shows_context => "only evidence",
        (A::Details, Page::Traffic, Some(_)) => "all frames",
        (A::Problem, Page::Problems, _) => "go to device",
        (A::Cancel, ..) => "back",
        (A::Mute, ..) if brush.app.selected_problem().is_some_and(|it| it.is_muted) => "unmute",
        _ => word,
    };
    Some((key, here))
}

/// Returns keys with their hints, without those that do not fit `width` cells.
fn hints(brush: &DrawContext, actions: &[Action], width: usize) -> Vec<Span<'static>> {
    let mut spans = Vec::new();
    let mut used = 0;
    for (key, hint) in actions.iter().filter_map(|action| hint(brush, *action)) {
        let key = key.to_string();
        let gap = if used == 0 { "" } else { "  " };
        let own = gap.len() + key.width() + 1 + hint.width();
        if used + own > width {
            continue;
        }
        used += own;
        spans.push(Span::raw(gap));
        spans.push(brush.span(Role::HintKey, key));
        spans.push(brush.span(Role::Muted, format!(" {hint}")));
    }
    spans
}
