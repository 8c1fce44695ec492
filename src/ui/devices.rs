//! The table of page 1, Devices: a row per device and per entry of des.json. Columns are dropped on
//! narrow screens in the order SVC, AGE, MODE, BUS.

use super::brush::{DrawContext, bus_label, end_of, fit, fit_right};
use crate::app::{App, FileStatus, PromptKind, Row, RowKey, RowState, SortBy};
use crate::discovery::{Device, QueryState};
use crate::theme::Role;
use crate::time::Duration;
use ratatui::layout::{Position, Rect};
use ratatui::style::Modifier;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// A column of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Column {
    Bus,
    Address,
    Name,
    State,
    Mode,
    Services,
    Age,
    File,
}

use Column as C;

impl Column {
    const ALL: [Column; 8] =
        [C::Bus, C::Address, C::Name, C::State, C::Mode, C::Services, C::Age, C::File];
    /// Columns that a narrow list drops, first dropped first.
    const DROP_ORDER: [Column; 4] = [C::Services, C::Age, C::Mode, C::Bus];
    /// Cells of NAME: as many as are left, within this range. Other columns are dropped first.
    const NAME_WIDTH: std::ops::RangeInclusive<usize> = 8..=20;

    const fn title(self) -> &'static str {
        match self {
            C::Bus => "BUS",
            C::Address => "ADDR",
            C::Name => "NAME",
            C::State => "STATE",
            C::Mode => "MODE",
            C::Services => "SVC",
            C::Age => "AGE",
            C::File => "FILE",
        }
    }

    /// Cells of the column. For BUS and ADDR the least width; for NAME see [`Self::NAME_WIDTH`].
    const fn width(self) -> usize {
        match self {
            C::Bus | C::File => 6,
            C::Name | C::Services => 3,
            C::Address | C::Age => 4,
            C::State => 8,
            C::Mode => 5,
        }
    }

    /// Returns true if the column is aligned to the right.
    const fn is_number(self) -> bool {
        matches!(self, C::Address | C::Services | C::Age)
    }

    /// The sort order that marks this column; `None`: rows cannot be sorted by it.
    const fn sorted_by(self) -> Option<SortBy> {
        match self {
            C::Address => Some(SortBy::Address),
            C::Name => Some(SortBy::Name),
            C::State => Some(SortBy::State),
            C::Mode => Some(SortBy::Mode),
            C::Age => Some(SortBy::Seen),
            C::File => Some(SortBy::File),
            C::Bus | C::Services => None,
        }
    }
}

/// The columns that fit, their widths, and the blanks between them.
struct Columns {
    shown: Vec<(Column, usize)>,
    gap: usize,
}

/// Cells in front of the first column: selection, state sign, blank.
const SIGNS: usize = 3;

impl Columns {
    /// Fits the columns into `width` cells. BUS needs at least two buses; `bus` and `address` are
    /// the widest texts in these columns.
    fn new(width: usize, buses: usize, (bus, address): (usize, usize)) -> Self {
        let own = |column: Column| match column {
            C::Bus => column.width().max(bus),
            C::Address => column.width().max(address),
            other => other.width(),
        };
        let mut shown = Column::ALL.to_vec();
        shown.retain(|&column| column != C::Bus || buses > 1);
        let least = |shown: &[Column], gap: usize| {
            let columns: usize = shown.iter().map(|&column| own(column)).sum();
            SIGNS + columns - C::Name.width()
                + Column::NAME_WIDTH.start()
                + gap * shown.len().saturating_sub(1)
        };
        let mut gap = 2;
        for column in Column::DROP_ORDER {
            if least(&shown, 2) > width {
                gap = 1;
            }
            if least(&shown, 1) > width {
                shown.retain(|other| *other != column);
                gap = 2;
            }
        }
        if least(&shown, gap) > width {
            gap = 1;
        }
        let others = least(&shown, gap) - Column::NAME_WIDTH.start();
        let name = width.saturating_sub(others).clamp(5, *Column::NAME_WIDTH.end());
        let width = |column: Column| if column == C::Name { name } else { own(column) };
        let shown = shown.into_iter().map(|column| (column, width(column))).collect();
        Self { shown, gap }
    }

    /// First cell of a column, counted from the left of the list.
    fn start(&self, column: Column) -> usize {
        let before = self.shown.iter().take_while(|(other, _)| *other != column);
        SIGNS + before.map(|(_, width)| width + self.gap).sum::<usize>()
    }
}

/// Draws the column headings and the rows that fit; on the row being edited the address prompt.
pub fn draw(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let app = brush.app;
    let rows = app.rows();
    let address = rows.iter().map(|row| addresses(app, row).width()).max().unwrap_or(0);
    // Names of buses can be long (slcan:/dev/ttyACM0); a narrow list keeps their ends.
    let most = if list.width < 60 { 6 } else { 14 };
    let bus = rows.iter().map(|row| buses(app, row, most).width()).max().unwrap_or(0);
    let columns = Columns::new(usize::from(list.width), app.buses().len(), (bus, address));
    draw_header(brush, header, &columns);
    if rows.is_empty() {
        return draw_nothing(brush, list);
    }
    let selected = app.selected_row_index();
    let top = app.view().devices.top(selected, rows.len(), usize::from(list.height));
    for (line, row) in rows.iter().skip(top).take(usize::from(list.height)).enumerate() {
        let is_selected = Some(top + line) == selected;
        let text = row_line(brush, row, &columns, is_selected);
        brush.line(list, line as u16, &text);
        if is_selected {
            brush.select(list, line as u16);
        }
        draw_editor(brush, list, line as u16, row, &columns);
    }
}

fn draw_header(brush: &mut DrawContext, area: Rect, columns: &Columns) {
    let sorted = brush.app.view().sort;
    let mut line = Line::from(" ".repeat(SIGNS));
    for &(column, width) in &columns.shown {
        let mut title = column.title().to_owned();
        let is_sorted = column.sorted_by() == Some(sorted) && sorted != SortBy::Address;
        if is_sorted && title.len() < width {
            title.push('↓');
        }
        let role = if is_sorted { Role::Title } else { Role::Header };
        let title = if column.is_number() { fit_right(&title, width) } else { fit(&title, width) };
        line.push_span(brush.span(role, title));
        line.push_span(" ".repeat(columns.gap));
    }
    line.spans.pop();
    brush.line(area, 0, &line);
}

/// Draws why there is no row.
fn draw_nothing(brush: &mut DrawContext, list: Rect) {
    let app = brush.app;
    if app.page_filter(crate::app::Page::Devices).is_on() {
        return brush.draw_no_match(list, "no device matches the filter");
    }
    let is_over = !app.buses().is_empty() && app.buses().iter().all(|bus| bus.ended.is_some());
    if let Some(reason) = app.foreign_reason() {
        return brush.draw_empty_list(list, &reason);
    }
    let is_listening = app.buses().iter().any(crate::app::Bus::is_up);
    brush.draw_empty_list(
        list,
        match (is_over, is_listening) {
            (true, _) => "no devices in the log",
            (_, true) => "no devices found yet",
            _ => "no device: no bus is up",
        },
    );
}

fn row_line(brush: &DrawContext, row: &Row, columns: &Columns, selected: bool) -> Line<'static> {
    let device = brush.app.device_of(row);
    let (sign, role) = sign(row);
    let pointer = if selected { "▸" } else { " " };
    let mut spans = vec![brush.span(Role::Text, pointer), brush.span(role, sign), Span::raw(" ")];
    for &(column, width) in &columns.shown {
        spans.push(cell(brush, row, device, column, width));
        spans.push(Span::raw(" ".repeat(columns.gap)));
    }
    spans.pop();
    Line::from(spans)
}

/// Returns the text of a cell in exactly `width` cells.
fn cell(
    brush: &DrawContext,
    row: &Row,
    device: Option<&Device>,
    column: Column,
    width: usize,
) -> Span<'static> {
    let is_absent = matches!(
        row.state,
        RowState::Lost
            | RowState::Unknown
            | RowState::Missing
            | RowState::Pending
            | RowState::Duplicate
    );
    let plain = if is_absent { Role::Muted } else { Role::Text };
    let (role, text) = match column {
        C::Bus => (Role::Muted, buses(brush.app, row, width)),
        C::Address => (plain, addresses(brush.app, row)),
        C::Name => match &row.name {
            Some(name) if row.twin => (plain, twin_name(&name.quoted().to_string(), width)),
            Some(name) => (plain, name.quoted().to_string()),
            None => (Role::Muted, "?".to_owned()),
        },
        C::State => (state_role(row.state), row.state.word().to_owned()),
        C::Mode => match device.and_then(|device| device.mode) {
            Some(mode) => (plain, mode.to_string()),
            None if device.is_some_and(|device| !device.is_working) => (plain, "!WORK".to_owned()),
            None => (Role::Muted, if device.is_some() { "?" } else { "" }.to_owned()),
        },
        C::Services => match device {
            None => (Role::Muted, String::new()),
            Some(device) => match (&device.services, device.services_query.state) {
                (Some(services), _) if row.has_other_services => {
                    (Role::FileDiffers, format!("{}≠", services.len()))
                }
                (Some(services), _) => (plain, services.len().to_string()),
                (None, QueryState::Sent | QueryState::Receiving) => (Role::Muted, "…".to_owned()),
                (None, QueryState::NotSent) => (Role::Muted, "–".to_owned()),
                (None, _) => (Role::Warning, "?".to_owned()),
            },
        },
        C::Age => match device {
            None => (Role::Muted, String::new()),
            Some(device) => (plain, age(brush.app.display_time().since(device.last_seen))),
        },
        C::File if row.has_findings => (Role::Warning, file_word(row).1 + "!"),
        C::File => file_word(row),
    };
    let text = if column.is_number() { fit_right(&text, width) } else { fit(&text, width) };
    brush.span(role, text)
}

/// Returns the text of the FILE column and its role.
fn file_word(row: &Row) -> (Role, String) {
    match row.file {
        FileStatus::Nothing => (Role::Muted, String::new()),
        FileStatus::New => (Role::New, "+ new".to_owned()),
        FileStatus::Listed(None) => (Role::Muted, "  –".to_owned()),
        FileStatus::Listed(Some(address)) => (Role::Muted, format!("  {address}")),
        FileStatus::Pinned(address) => (Role::Muted, format!("… {address}")),
        FileStatus::Agrees(address) if row.has_other_services => {
            (Role::FileDiffers, format!("≠ {address}"))
        }
        FileStatus::Agrees(address) if row.has_findings => (Role::Warning, format!("  {address}")),
        FileStatus::Agrees(address) => (Role::FileOk, format!("✓ {address}")),
        FileStatus::Differs(address) => (Role::FileDiffers, format!("✗ {address}")),
    }
}

/// Returns the address of a row; on redundant buses all of them (`12/13`); `–` if it has none.
fn addresses(app: &App, row: &Row) -> String {
    let mut all: Vec<String> =
        app.devices_of(row).map(|device| device.address.to_string()).collect();
    all.dedup();
    if all.is_empty() {
        return row.address.map_or("–".to_owned(), |address| address.to_string());
    }
    all.join("/")
}

/// Returns the bus of a row; for a redundant device all its buses.
fn buses(app: &App, row: &Row, width: usize) -> String {
    let all = row.bus.into_iter().chain(row.redundant_ids.iter().map(|id| id.bus));
    let names: Vec<String> = all.map(|bus| bus_label(app, bus, width)).collect();
    bus_range(&names, width)
}

/// Returns the names of redundant buses, shortened: `can0+1`, `3 bus`; `any` for an entry without
/// a bus.
fn bus_range(names: &[String], width: usize) -> String {
    let Some((first, others)) = names.split_first() else { return "any".to_owned() };
    let stem = first.trim_end_matches(|c: char| c.is_ascii_digit());
    let mut text = first.clone();
    for other in others {
        let short = other.strip_prefix(stem).filter(|rest| !rest.is_empty());
        text = format!("{text}+{}", short.unwrap_or(other));
    }
    if text.width() > width && !others.is_empty() {
        text = format!("{} bus", names.len());
    }
    // Long names of buses differ at their end.
    end_of(&text, width)
}

/// Returns a name followed by `²`, the sign of a twin, in at most `width` cells.
fn twin_name(name: &str, width: usize) -> String {
    let name = fit(name, width.saturating_sub(1));
    let trimmed = name.trim_end();
    format!("{trimmed}²")
}

/// Returns the sign in front of a row and its role.
fn sign(row: &Row) -> (&'static str, Role) {
    match row.state {
        RowState::Conflict => ("⚠", Role::Confirmed),
        _ if row.suspected => ("?", Role::Suspected),
        RowState::Missing => ("○", Role::Missing),
        RowState::Lost => ("○", Role::Lost),
        RowState::Partial => ("◑", Role::Stale),
        RowState::Pending | RowState::Duplicate | RowState::Unknown => ("·", Role::Muted),
        RowState::Stale => ("◐", Role::Stale),
        RowState::Silent => ("◌", Role::Silent),
        RowState::Asleep => ("◒", Role::Asleep),
        RowState::Online => ("●", Role::Online),
    }
}

/// Returns the role of the STATE column.
pub(super) fn state_role(state: RowState) -> Role {
    match state {
        RowState::Conflict => Role::Confirmed,
        RowState::Missing => Role::Missing,
        RowState::Lost => Role::Lost,
        RowState::Partial | RowState::Stale => Role::Stale,
        RowState::Silent => Role::Silent,
        RowState::Asleep => Role::Asleep,
        RowState::Pending | RowState::Duplicate | RowState::Unknown => Role::Muted,
        RowState::Online => Role::Online,
    }
}

/// Returns a duration in one unit, at most 3 digits below 1000 days: `12s`, `5m`, `7h`, `2d`.
fn age(duration: Duration) -> String {
    match duration.as_secs() {
        seconds @ 0..=99 => format!("{seconds}s"),
        seconds @ 100..=5999 => format!("{}m", seconds / 60),
        seconds @ 6000..=172_799 => format!("{}h", seconds / 3600),
        seconds => format!("{}d", seconds / 86_400),
    }
}

/// Draws the address prompt into the FILE column of the row being edited.
fn draw_editor(brush: &mut DrawContext, list: Rect, line: u16, row: &Row, columns: &Columns) {
    let Some(prompt) = brush.app.prompt() else { return };
    let is_here = |key: &RowKey| match key {
        RowKey::Device(id) => row.has_device(*id),
        RowKey::Entry(_) | RowKey::Board(..) => *key == row.key,
    };
    if !matches!(&prompt.kind, PromptKind::Address(it) if is_here(&it.key)) {
        return;
    }
    let start = columns.start(C::File) as u16;
    let width = list.width.saturating_sub(start);
    if width < 2 {
        return;
    }
    let at = Rect { x: list.x + start, y: list.y + line, width, height: 1 };
    let scroll = prompt.input.visual_scroll(usize::from(width - 1));
    let text: String = prompt.input.value().chars().skip(scroll).collect();
    let under = brush.style(Role::Input);
    let untouched = if prompt.replaces_on_typing { Modifier::REVERSED } else { Modifier::empty() };
    let style = under.add_modifier(untouched);
    brush.buffer.set_string(at.x, at.y, fit("", usize::from(width)), under);
    brush.buffer.set_style(at, ratatui::style::Style::reset().patch(under));
    brush.buffer.set_stringn(at.x, at.y, text, usize::from(width), style);
    let cursor = prompt.input.visual_cursor().saturating_sub(scroll) as u16;
    brush.cursor = Some(Position::new(at.x + cursor.min(width - 1), at.y));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn narrow_list_drops_columns_in_order() {
        let titles = |width: usize| -> Vec<&str> {
            let columns = Columns::new(width, 1, (6, 3));
            let end = columns.start(C::File) + 6;
            assert!(end <= width || width < 31, "{width}: {end}");
            columns.shown.iter().map(|(column, _)| column.title()).collect()
        };
        assert_eq!(titles(51).len(), 7);
        assert_eq!(titles(47).len(), 7);
        assert_eq!(titles(40), ["ADDR", "NAME", "STATE", "MODE", "FILE"]);
        assert_eq!(titles(31), ["ADDR", "NAME", "STATE", "FILE"]);
    }

    #[test]
    fn age_has_one_unit() {
        for (seconds, text) in [(0, "0s"), (99, "99s"), (100, "1m"), (7200, "2h"), (200_000, "2d")]
        {
            assert_eq!(age(Duration::from_secs(seconds)), text);
        }
    }
}
