//! The kinds of stories: the rule above the lines of the Timeline page, and the list in which they are
//! switched on and off.

use super::brush::{DrawContext, fit};
use crate::app::StoryKind;
use crate::keymap::Action;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Cells of the list of kinds.
const LIST_WIDTH: u16 = 58;

/// Draws the rule with the number of the stories that are shown and hidden, and the kinds.
pub fn draw_rule(brush: &mut DrawContext, shown: usize) {
    let area = brush.screen.kinds;
    if area.height == 0 {
        return;
    }
    brush.rule(area, Role::Border);
    let app = brush.app;
    let hidden = app.hidden_kinds();
    let counts = app.kind_counts();
    let count: usize = StoryKind::ALL
        .iter()
        .filter(|kind| hidden.contains(**kind))
        .map(|kind| counts[*kind as usize])
        .sum();
    let plural = if shown == 1 { "" } else { "s" };
    let mut text = format!(" {shown} line{plural} ");
    if count > 0 {
        text = format!(" {shown} line{plural}, {count} hidden ");
    }
    let role = if count > 0 { Role::Match } else { Role::Muted };
    let title = Line::from(brush.span(role, text));
    let end = area.x + 1 + title.width() as u16;
    brush.line(Rect { x: area.x + 1, width: area.width.saturating_sub(1), ..area }, 0, &title);
    let room = usize::from(area.right().saturating_sub(end + 2));
    let all = [kinds(brush, Some(" ")), kinds(brush, Some("")), kinds(brush, None)];
    let fits = |spans: &&Vec<Span>| spans.iter().map(Span::width).sum::<usize>() <= room;
    if let Some(spans) = all.iter().find(fits) {
        let line = Line::from(spans.clone());
        let width = line.width() as u16;
        brush.line(Rect { x: area.right() - width - 1, width, ..area }, 0, &line);
    }
}

/// The kinds with a tick for those that are shown, behind `gap`; without it only the hidden ones.
fn kinds(brush: &DrawContext, gap: Option<&str>) -> Vec<Span<'static>> {
    let hidden = brush.app.hidden_kinds();
    let key = brush.app.key_of(Action::Kinds);
    let mut spans = vec![brush.span(Role::Muted, format!(" kinds ({key}):"))];
    if let Some(gap) = gap {
        for kind in StoryKind::ALL {
            let (sign, role) =
                if hidden.contains(kind) { ("·", Role::Muted) } else { ("✓", Role::Text) };
            spans.push(brush.span(role, format!(" {}{gap}{sign}", kind.word())));
        }
    } else {
        let words = StoryKind::ALL.into_iter().filter(|kind| hidden.contains(*kind));
        let words: Vec<&str> = words.map(StoryKind::word).collect();
        let text = match words.len() {
            0 => " all".to_owned(),
            1..=3 => format!(" without {}", words.join(", ")),
            count => format!(" {} of {}", StoryKind::ALL.len() - count, StoryKind::ALL.len()),
        };
        spans.push(brush.span(Role::Text, text));
    }
    spans.push(brush.span(Role::Muted, " "));
    spans
}

/// Draws the list of kinds over the right end of the page; `selected` is the place of the selected one.
pub fn draw(brush: &mut DrawContext, selected: usize) {
    let whole = brush.screen.whole;
    let top = brush.screen.tabs.bottom();
    let width = whole.width.min(LIST_WIDTH);
    let room = brush.screen.footer.y.saturating_sub(top);
    let height = (StoryKind::ALL.len() as u16 + 1).min(room);
    let area = Rect { x: whole.right() - width, y: top, width, height };
    if height < 2 {
        return;
    }
    let (counts, hidden) = (brush.app.kind_counts(), brush.app.hidden_kinds());
    let top = Rect { height: 1, ..area };
    brush.rule(top, Role::BorderFocus);
    let title = Line::from(brush.span(Role::TabActive, " Kinds of lines "));
    brush.line(Rect { x: top.x + 1, width: width.saturating_sub(1), ..top }, 0, &title);
    let list = Rect { y: area.y + 1, height: height - 1, ..area };
    let lines = usize::from(list.height);
    let top_place = (selected + 1).saturating_sub(lines);
    for (place, kind) in StoryKind::ALL.into_iter().enumerate().skip(top_place).take(lines) {
        let is_selected = place == selected;
        let (tick, role) =
            if hidden.contains(kind) { ("·", Role::Muted) } else { ("✓", Role::Text) };
        let lines_of_kind = counts[kind as usize];
        let text = format!("{tick} {:9} {lines_of_kind:>5}  {}", kind.word(), kind.meaning());
        let pointer = if is_selected { " ▸ " } else { "   " };
        let room = usize::from(width).saturating_sub(pointer.width());
        let line =
            Line::from(vec![brush.span(Role::Text, pointer), brush.span(role, fit(&text, room))]);
        let row = (place - top_place) as u16;
        brush.line(list, row, &line);
        if is_selected {
            brush.select(list, row);
        }
    }
}
