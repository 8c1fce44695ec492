//! The latest lines of the timeline below Devices: an event per line, newest at the bottom.

use super::brush::{DrawContext, bus_cell, bus_label, cut, fit};
use crate::app::{TimelineEntry, TimelineKind, format_time_of_day};
use crate::theme::Role;
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Draws the latest lines, at most those before the view was frozen.
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
    let app = brush.app;
    let end = app.view().frozen.map_or(u64::MAX, |frozen| frozen.lines);
    let latest = app.timeline().entries().rev().filter(|entry| entry.number < end);
    let latest: Vec<&TimelineEntry> = latest.take(usize::from(area.height)).collect();
    for (row, entry) in latest.into_iter().rev().enumerate() {
        let line = entry_line(brush, entry, if area.width >= 60 { 12 } else { 8 });
        brush.line(area, row as u16, &line);
    }
}

/// Returns a line: time, sign, bus if there are several, source in `source_width` cells, event.
pub fn entry_line(
    brush: &DrawContext,
    entry: &TimelineEntry,
    source_width: usize,
) -> Line<'static> {
    let letter = match entry.kind {
        TimelineKind::Mark(letter) => letter.to_string(),
        _ => String::new(),
    };
    let (sign, role) = match entry.kind {
        TimelineKind::Improved => ("+", Role::Online),
        TimelineKind::Change => ("~", Role::Text),
        TimelineKind::Overdue => ("◐", Role::Stale),
        TimelineKind::Lost => ("○", Role::Lost),
        TimelineKind::Suspected => ("?", Role::Suspected),
        TimelineKind::Confirmed => ("⚠", Role::Confirmed),
        TimelineKind::Cleared => ("✓", Role::FileOk),
        TimelineKind::Bus | TimelineKind::File => ("·", Role::Text),
        TimelineKind::Error => ("!", Role::Error),
        TimelineKind::Mark(_) => (&*letter, Role::Match),
    };
    // Only problems, losses and the bus have coloured text.
    let is_plain = matches!(
        entry.kind,
        TimelineKind::Improved
            | TimelineKind::Change
            | TimelineKind::Overdue
            | TimelineKind::Cleared
    );
    let text_role = if is_plain { Role::Text } else { role };
    let source = source(brush, entry, source_width);
    let times = if entry.times > 1 { format!(" ×{}", entry.times) } else { String::new() };
    let mut spans = vec![
        brush.span(Role::Muted, format!(" {} ", format_time_of_day(brush.app, entry.last))),
        brush.span(role, format!("{sign} ")),
    ];
    if shows_bus(brush) {
        // An event of the bus itself has the bus as its source.
        let bus = entry.bus.filter(|_| entry.address.is_some());
        spans.push(brush.span(Role::Muted, bus_cell(brush.app, bus)));
    }
    spans.extend([
        brush.span(Role::Text, format!("{} ", fit(&source, source_width))),
        brush.span(text_role, entry.text.clone()),
        brush.span(Role::Muted, times),
    ]);
    Line::from(spans)
}

/// Returns true if the column BUS is shown.
pub fn shows_bus(brush: &DrawContext) -> bool {
    brush.app.buses().len() > 1 && brush.screen.whole.width >= 60
}

/// Returns the column SOURCE: name and address of the device, else the bus, else the file.
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
            None => app.file().name(),
        },
    }
}
