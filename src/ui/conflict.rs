//! The dialog of an edit conflict: an unsaved edit and des.json on disk changed the same value
//! ("ours" and "theirs", as in git), and the user chooses one. Takes the place of the page.

use super::brush::{Brush, labelled};
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::Line;

/// Draws the dialog; nothing but its rule if no conflict is open.
pub fn draw(brush: &mut Brush) {
    let whole = brush.screen.whole;
    let top = brush.screen.tabs.y;
    let rule = Rect { y: top, height: brush.screen.tabs.height, ..whole };
    brush.rule(rule, Role::BorderFocus);
    let Some(conflict) = brush.app.file().conflict() else { return };
    let title = match (conflict.number, conflict.of) {
        (1, 1) => " Edit conflict ".to_owned(),
        (number, of) => format!(" Edit conflict {number} of {of} "),
    };
    let title = Line::from(brush.span(Role::TabActive, title));
    brush.line(Rect { x: 1, width: whole.width.saturating_sub(1), ..rule }, 0, &title);
    let area = Rect {
        x: 2.min(whole.width),
        y: top + rule.height,
        width: whole.width.saturating_sub(4),
        height: brush.screen.footer.y.saturating_sub(top + rule.height),
    };
    let name = brush.app.file().name();
    let mut lines = vec![Line::default()];
    let text = format!("You and another program changed the same value in {name}.");
    lines.extend(labelled(brush, "", Role::Text, &text, area.width));
    lines.push(Line::default());
    let edit = conflict.operation.to_string();
    lines.extend(labelled(brush, "your edit  ", Role::Text, &edit, area.width));
    lines.push(Line::default());
    lines.extend(labelled(brush, "ours       ", Role::New, &conflict.ours, area.width));
    lines.extend(labelled(brush, "theirs     ", Role::Suspected, &conflict.theirs, area.width));
    lines.push(Line::default());
    let is_broken = brush.app.file().problem().is_some_and(|problem| !problem.is_not_saved());
    let text = if is_broken {
        "The file cannot be read now; choose later."
    } else {
        "Nothing is written until you choose."
    };
    lines.extend(labelled(brush, "", Role::Muted, text, area.width));
    brush.lines(area, &lines, 0);
}
