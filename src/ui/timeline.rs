//! The latest stories below Devices and on the Bus page: a line each, the one that changed last at the
//! bottom.

use super::brush::{DrawContext, bus_cell, bus_label, fit, short_file_name};
use super::stories::sign_of;
use crate::app::{Story, TimelineEntry, format_time_of_day};
use crate::cell_text::cut;
use crate::theme::Role;
use crate::time::Instant;
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Draws the latest stories as of the moment that is shown.
pub fn draw_latest(brush: &mut DrawContext) {
    let (rule, area) = (brush.screen.lower_rule, brush.screen.latest);
    if area.height == 0 {
        return;
    }
    brush.rule(rule, Role::Border);
    if brush.screen.divider.height > 0 {
        brush.buffer[(brush.screen.divider.x, rule.y)].set_symbol("┴");
    }
    let title = Line::from(brush.span(Role::Muted, " latest "));
    let at = ratatui::layout::Rect { x: rule.x + 1, width: rule.width.saturating_sub(2), ..rule };
    brush.line(at, 0, &title);
    let stories = brush.app.latest_stories(usize::from(area.height), |_| true);
    for (row, (story, time)) in stories.into_iter().enumerate() {
        let line = latest_line(brush, story, time, if area.width >= 60 { 12 } else { 8 });
        brush.line(area, row as u16, &line);
    }
}

/// Returns a story in a line: time of its last change, sign, bus if there are several, source in
/// `source_width` cells, what happened as on the Timeline page.
pub fn latest_line(
    brush: &DrawContext,
    story: &Story,
    time: Instant,
    source_width: usize,
) -> Line<'static> {
    let app = brush.app;
    let Some(line) = app.story_line(story) else { return Line::default() };
    let (entry, _) = app.story_subject(story);
    let (sign, role, is_plain) = sign_of(line.sign);
    let text_role = if is_plain { Role::Text } else { role };
    let source = source(brush, entry, source_width);
    let mut spans = vec![
        brush.span(Role::Muted, format!(" {} ", format_time_of_day(app, time))),
        brush.span(role, format!("{sign} ")),
    ];
    if shows_bus(brush) {
        // An event of the bus itself has the bus as its source.
        let bus = entry.bus.filter(|_| entry.address.is_some());
        spans.push(brush.span(Role::Muted, bus_cell(app, bus)));
    }
    spans.extend([
        brush.span(Role::Text, format!("{} ", fit(&source, source_width))),
        brush.span(text_role, line.what),
    ]);
    Line::from(spans)
}

/// Returns true if the column BUS is shown.
pub fn shows_bus(brush: &DrawContext) -> bool {
    brush.app.buses().len() > 1 && brush.screen.whole.width >= 60
}

/// Returns the column WHO: name and address of the device, else the bus, else the file.
fn source(brush: &DrawContext, entry: &TimelineEntry, width: usize) -> String {
    let app = brush.app;
    match (app.name_on_line(entry), entry.address) {
        (Some(name), Some(address)) => {
            let address = format!(" @{address}");
            let name = name.quoted().to_string();
            let room = width.saturating_sub(address.width());
            let short = if name.width() > room {
                format!("{}…", cut(&name, room.saturating_sub(1)))
            } else {
                name
            };
            short + &address
        }
        (None, Some(address)) => format!("? @{address}"),
        (Some(name), None) if entry.bus.is_none() => name.quoted().to_string(),
        _ => match entry.bus {
            Some(bus) => bus_label(app, bus, width),
            None => short_file_name(&app.file_at(entry.file).name(), width),
        },
    }
}
