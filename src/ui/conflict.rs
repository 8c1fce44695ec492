//! The dialog of an edit conflict: an unsaved edit and des.json on disk changed the same value
//! ("ours" and "theirs", as in git), and the user chooses one. Takes the place of the page.

use super::brush::{DrawContext, labelled};
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::Line;

/// Draws the dialog; nothing but its rule if no conflict is open.
pub fn draw(brush: &mut DrawContext) {
    let whole = brush.screen.whole;
    let top = brush.screen.tabs.y;
    let rule = Rect { y: top, height: brush.screen.tabs.height, ..whole };
    brush.rule(rule, Role::BorderFocus);
    let Some(file) = brush.app.conflicting_file() else { return };
    let file = brush.app.file_at(file);
    let Some(conflict) = file.conflict() else { return };
    let title = match (conflict.index, conflict.total) {
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
    let name = file.name();
    let text = format!("You and another program changed the same value in {name}.");
    let cause = labelled(brush, "", Role::Text, &text, area.width);
    let edit = conflict.operation.to_string();
    let edit = labelled(brush, "edit       ", Role::Text, &edit, area.width);
    let mut values = labelled(brush, "ours       ", Role::New, &conflict.ours, area.width);
    values.extend(labelled(brush, "theirs     ", Role::Suspected, &conflict.theirs, area.width));
    let is_broken = file.problem().is_some_and(|problem| !problem.is_not_saved());
    let text = if is_broken {
        "The file cannot be read now; choose later."
    } else {
        "Nothing is written until you choose."
    };
    let note = labelled(brush, "", Role::Muted, text, area.width);
    let lines = arranged(cause, edit, values, note, usize::from(area.height));
    brush.lines(area, &lines, 0);
}

/// Returns the sections of the dialog with an empty line before each, or, if that is more than
/// `height` lines, without empty lines, or, if they are still too many, with the two values first.
fn arranged<'l>(
    cause: Vec<Line<'l>>,
    edit: Vec<Line<'l>>,
    values: Vec<Line<'l>>,
    note: Vec<Line<'l>>,
    height: usize,
) -> Vec<Line<'l>> {
    const SECTIONS: usize = 4;
    let count = cause.len() + edit.len() + values.len() + note.len();
    if count > height {
        return [values, edit, note, cause].concat();
    }
    if count + SECTIONS > height {
        return [cause, edit, values, note].concat();
    }
    [cause, edit, values, note]
        .into_iter()
        .flat_map(|section| std::iter::once(Line::default()).chain(section))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn low_screen_has_both_values_first() {
        let section = |name: &str, count: usize| vec![Line::from(name.to_owned()); count];
        let lines = |height: usize| -> Vec<String> {
            let lines = arranged(
                section("cause", 2),
                section("edit", 2),
                section("values", 2),
                section("note", 1),
                height,
            );
            lines.iter().map(ToString::to_string).collect()
        };
        assert_eq!(lines(11)[..5], ["", "cause", "cause", "", "edit"]);
        assert_eq!(lines(10)[..3], ["cause", "cause", "edit"]);
        assert_eq!(lines(6), ["values", "values", "edit", "edit", "note", "cause", "cause"]);
    }
}
