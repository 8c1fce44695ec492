//! The list of page 1, Devices: a row per device and per entry of des.json, and for each board of a
//! shared address. Views: the columns, the versions of all services, the heartbeats.

mod columns;
mod history;
mod matrix;
mod strip;

use super::brush::{DrawContext, bus_label, end_of, fit, fit_right, set_hidden_rows};
use crate::app::{
    App, BeatStats, DeviceView, FileStatus, PromptKind, Row, RowKey, RowState, ServiceTable,
    SortBy, VersionNote, format_duration, format_time_of_day,
};
use crate::discovery::Device;
use crate::text::Escaped;
use crate::theme::Role;
use crate::wire::node::Uid;
use columns::{Column, Columns, SIGNS, Widest};
use ratatui::layout::{Position, Rect};
use ratatui::style::Modifier;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

pub(super) use history::draw as draw_history;
pub(super) use strip::{count_text, jitter_text, period_text, spans as strip_spans};

use Column as C;

/// Heartbeats from which period and jitter of a board are computed.
pub(super) const STATS_BEATS: usize = 60;
/// Most services of a device that VERSIONS lists; the others are counted.
const MAX_NOTES: usize = 16;

/// Draws the column headings and the rows that fit; on the row being edited the address prompt.
pub fn draw(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let app = brush.app;
    if app.rows().is_empty() {
        let columns = Columns::new(usize::from(list.width), Widest::default());
        draw_header(brush, header, &columns);
        return draw_nothing(brush, list);
    }
    match app.view().devices_page.view {
        DeviceView::List => draw_list(brush),
        DeviceView::Services => matrix::draw(brush),
        DeviceView::Heartbeats => draw_heartbeats(brush),
    }
    // The view of services has the number of hidden services there.
    if app.view().devices_page.view != DeviceView::Services {
        draw_hidden_rows(brush);
    }
}

/// Draws the number of rows above and below the screen at the right end of the headings.
fn draw_hidden_rows(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let (app, height) = (brush.app, usize::from(list.height));
    let count = app.rows().len();
    let above = app.view().devices.top(app.selected_row_index(), count, height);
    let below = count.saturating_sub(above + height);
    set_hidden_rows(brush.buffer, brush.theme, header, (above, below));
}

/// Cells of the list that have columns: a blank is in front of details beside it.
fn list_width(brush: &DrawContext) -> usize {
    let blank = u16::from(brush.screen.divider.height > 0);
    usize::from(brush.screen.list.width.saturating_sub(blank))
}

/// Rows on the screen: the line, the place in the list, the row.
fn visible_rows(app: &App, height: u16) -> Vec<(u16, bool, &Row)> {
    let (rows, height) = (app.rows(), usize::from(height));
    let selected = app.selected_row_index();
    let top = app.view().devices.top(selected, rows.len(), height);
    let visible = rows.iter().enumerate().skip(top).take(height);
    visible.map(|(at, row)| ((at - top) as u16, Some(at) == selected, row)).collect()
}

fn draw_list(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let app = brush.app;
    let columns = Columns::new(list_width(brush), widest(app, list.width));
    draw_header(brush, header, &columns);
    let table = columns.has(C::Versions).then(|| ServiceTable::new(app));
    for (line, is_selected, row) in visible_rows(app, list.height) {
        let cells = Cells { brush, row, columns: &columns, table: table.as_ref() };
        let text = cells.line(is_selected);
        brush.line(list, line, &text);
        if is_selected {
            brush.select(list, line);
        }
        draw_editor(brush, list, line, row, columns.start(C::File));
    }
}

/// Returns the widest texts of the rows.
fn widest(app: &App, list_width: u16) -> Widest {
    let rows = app.rows();
    // Names of buses can be long (slcan:/dev/ttyACM0); a narrow list keeps their ends.
    let most = if list_width < 60 { 6 } else { 14 };
    let bus = |row| if app.buses().len() > 1 { buses(app, row, most).width() } else { 0 };
    let name = |row: &Row| {
        let own = row.name.as_ref().map_or(1, |name| name.quoted().to_string().width());
        own + usize::from(row.twin)
    };
    Widest {
        bus: rows.iter().map(bus).max().unwrap_or(0),
        address: rows.iter().map(|row| addresses(app, row).width()).max().unwrap_or(0),
        name: rows.iter().map(name).max().unwrap_or(0),
    }
}

fn draw_header(brush: &mut DrawContext, area: Rect, columns: &Columns) {
    let view = brush.app.view();
    let mut line = Line::from(" ".repeat(SIGNS));
    for &(column, width) in &columns.shown {
        let mut title = column.title().to_owned();
        let is_sorted = column.sorted_by() == Some(view.device_sort.order)
            && (view.device_sort.order != SortBy::Address || view.device_sort.is_reversed);
        if is_sorted && title.len() < width {
            title.push(if view.device_sort.is_reversed { '↑' } else { '↓' });
        }
        let role = if is_sorted { Role::Title } else { Role::Header };
        let title = if column.is_number() { fit_right(&title, width) } else { fit(&title, width) };
        line.push_span(brush.span(role, title));
        line.push_span(" ");
    }
    line.spans.pop();
    brush.line(area, 0, &line);
}

/// Draws the heartbeats of each device over the whole width.
fn draw_heartbeats(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let app = brush.app;
    let mut columns = Columns::new(list_width(brush), widest(app, list.width));
    let is_kept = |column: Column| match column {
        C::Bus | C::Address | C::Name => true,
        C::State => list.width >= 60,
        C::Uid => list.width >= 80,
        _ => false,
    };
    columns.shown.retain(|(column, _)| is_kept(*column));
    let start = SIGNS + columns.shown.iter().map(|(_, width)| width + 1).sum::<usize>();
    let width = list_width(brush).saturating_sub(start);
    draw_header(brush, header, &columns);
    let at = Rect { x: header.x + start as u16, width: width as u16, ..header };
    let title =
        Line::from(brush.span(Role::Header, fit("HEARTBEATS, a cell is one period", width)));
    brush.line(at, 0, &title);
    for (line, is_selected, row) in visible_rows(app, list.height) {
        let cells = Cells { brush, row, columns: &columns, table: None };
        let mut text = cells.line(is_selected);
        text.push_span(" ");
        if app.device_of(row).is_some() {
            text.spans.extend(strip::spans(brush, &app.beats_of(row, width), width));
        }
        brush.line(list, line, &text);
        if is_selected {
            brush.select(list, line);
        }
    }
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

/// The cells of a row.
struct Cells<'b, 'a> {
    brush: &'b DrawContext<'a>,
    row: &'b Row,
    columns: &'b Columns,
    table: Option<&'b ServiceTable<'b>>,
}

impl Cells<'_, '_> {
    fn line(&self, selected: bool) -> Line<'static> {
        let (sign, role) = sign(self.row);
        let pointer = if selected { "▸" } else { " " };
        let brush = self.brush;
        let mut spans =
            vec![brush.span(Role::Text, pointer), brush.span(role, sign), Span::raw(" ")];
        for &(column, width) in &self.columns.shown {
            spans.extend(self.cell(column, width));
            spans.push(Span::raw(" "));
        }
        spans.pop();
        Line::from(spans)
    }

    /// Returns the spans of a cell, in exactly `width` cells of the terminal.
    fn cell(&self, column: Column, width: usize) -> Vec<Span<'static>> {
        match column {
            C::Strip => self.strip(width),
            C::Versions => self.versions(width),
            _ => {
                let (role, text) = self.text(column, width);
                let text =
                    if column.is_number() { fit_right(&text, width) } else { fit(&text, width) };
                vec![self.brush.span(role, text)]
            }
        }
    }

    fn text(&self, column: Column, width: usize) -> (Role, String) {
        let (app, row) = (self.brush.app, self.row);
        let device = app.device_of(row);
        let plain = if is_absent(row) { Role::Muted } else { Role::Text };
        match column {
            C::Bus => (Role::Muted, buses(app, row, width)),
            C::Address => (side_role(row).unwrap_or(plain), addresses(app, row)),
            // On a narrow screen the UID tells the boards of an address from each other.
            C::Name if row.board.is_some() && !self.columns.has(C::Uid) => self.uid(plain),
            C::Name => match &row.name {
                Some(name) if row.twin => (plain, twin_name(&name.quoted().to_string(), width)),
                Some(name) => (plain, name.quoted().to_string()),
                None => (Role::Muted, "?".to_owned()),
            },
            C::Uid => self.uid(plain),
            C::State => (state_role(row.state), row.state.word().to_owned()),
            C::Mode => self.mode(plain),
            C::Period | C::Jitter | C::Missed => self.statistic(column, plain),
            C::File => file_word(row, self.columns.has_file_text()),
            C::Seen => self.seen(plain),
            C::Services => {
                let services = device.and_then(|device| device.services.as_deref());
                let mut names = services.unwrap_or_default().iter();
                // As many as could fit: a list has up to 256.
                let names: Vec<String> =
                    names.by_ref().take(width).map(|it| it.name.to_string()).collect();
                (Role::Muted, names.join(" "))
            }
            C::Strip | C::Versions => (plain, String::new()),
        }
    }

    fn uid(&self, plain: Role) -> (Role, String) {
        let (app, row) = (self.brush.app, self.row);
        let Some(device) = app.device_of(row) else { return (Role::Muted, "–".to_owned()) };
        if row.board.is_none() && app.uids_of(device).len() > 1 {
            return (Role::Confirmed, "two".to_owned());
        }
        match row.uid {
            Some(uid) if uid.is_blank() => (Role::Muted, "blank".to_owned()),
            Some(uid) => (side_role(row).unwrap_or(plain), uid_text(app, device, uid)),
            None => (Role::Muted, "–".to_owned()),
        }
    }

    fn mode(&self, plain: Role) -> (Role, String) {
        let (app, row) = (self.brush.app, self.row);
        let device = app.device_of(row);
        match device.and_then(|device| row.mode_of(device)) {
            Some(mode) => (plain, mode.to_string()),
            None if device.is_some_and(|device| !device.is_working) => (plain, "!WORK".to_owned()),
            None => (Role::Muted, if device.is_some() { "?" } else { "" }.to_owned()),
        }
    }

    fn strip(&self, width: usize) -> Vec<Span<'static>> {
        if self.brush.app.device_of(self.row).is_none() {
            return vec![Span::raw(" ".repeat(width))];
        }
        let beats = self.brush.app.beats_of(self.row, width);
        strip::spans(self.brush, &beats, width)
    }

    /// Period, jitter or misses. The device's own change seldom; those of a board are computed from
    /// its heartbeats.
    fn statistic(&self, column: Column, plain: Role) -> (Role, String) {
        let (app, row) = (self.brush.app, self.row);
        let Some(device) = app.device_of(row) else {
            let text = if column == C::Missed { "–" } else { "" };
            return (Role::Muted, text.to_owned());
        };
        let beats = &device.heartbeat;
        let unknown = (Role::Muted, "–".to_owned());
        let (period, jitter, missed) = if row.board.is_some() {
            let stats = BeatStats::of(&app.beats_of(row, STATS_BEATS));
            (stats.period, stats.jitter, Some(stats.missed as u64))
        } else if app.has_confirmed_conflict(device) || beats.count == 0 {
            // Statistics of two senders mixed describe neither of them.
            (None, None, None)
        } else {
            // Those of a lost device are counted when it returns.
            let missed = Some(beats.missed).filter(|_| device.is_present());
            (beats.steady_period(), beats.steady_jitter(), missed)
        };
        match column {
            C::Period => period.map_or(unknown, |it| (plain, period_text(it))),
            C::Jitter => jitter.map_or(unknown, |it| (plain, jitter_text(it))),
            _ => match missed {
                None => unknown,
                Some(0) => (Role::Muted, "0".to_owned()),
                Some(missed) => (plain, count_text(missed)),
            },
        }
    }

    /// Since when it is there, its reboot and when, or how long it is gone.
    fn seen(&self, plain: Role) -> (Role, String) {
        let (app, row) = (self.brush.app, self.row);
        let Some(device) = app.device_of(row) else {
            return (Role::Muted, if row.state == RowState::Missing { "never" } else { "" }.into());
        };
        if let Some(board) = row.board {
            return (plain, format_time_of_day(app, board.sender.since));
        }
        if !device.is_present() {
            let ago = app.display_time().since(device.last_seen);
            return (plain, format!("{} ago", format_duration(ago)));
        }
        match device.rebooted_at {
            Some(at) => (plain, format!("reboot {}", format_time_of_day(app, at))),
            None => (plain, format_time_of_day(app, device.first_seen)),
        }
    }

    /// What changed since the device was first heard, then the services that not all devices have,
    /// as many as fit, and the number of further ones.
    fn versions(&self, width: usize) -> Vec<Span<'static>> {
        let device = self.brush.app.device_of(self.row);
        let (Some(device), Some(table)) = (device, self.table) else {
            return vec![Span::raw(" ".repeat(width))];
        };
        let (notes, more) = table.notes(device, MAX_NOTES);
        let plain = if is_absent(self.row) { Role::Muted } else { Role::Text };
        let (shown, more) = fitting_notes(&notes, more, width);
        let mut spans: Vec<Span<'static>> = Vec::new();
        let mut left = width;
        for note in shown {
            let text = if spans.is_empty() { note.text.clone() } else { format!(" {}", note.text) };
            let text = if text.width() > left { fit(&text, left) } else { text };
            left -= text.width();
            let role = if note.is_changed { Role::Changed } else { plain };
            spans.push(self.brush.span(role, text));
        }
        if more > 0 {
            let text = format!(" +{more}");
            if text.width() <= left {
                left -= text.width();
                spans.push(self.brush.span(Role::Muted, text));
            }
        }
        spans.push(Span::raw(" ".repeat(left)));
        spans
    }
}

/// Returns the first notes that fit `width` cells together with the number of the others; the first
/// one always.
fn fitting_notes(notes: &[VersionNote], more: usize, width: usize) -> (&[VersionNote], usize) {
    let mut used = 0;
    let mut count = 0;
    for (at, note) in notes.iter().enumerate() {
        let own = note.text.width() + usize::from(at > 0);
        let others = notes.len() - at - 1 + more;
        let rest = if others > 0 { format!(" +{others}").width() } else { 0 };
        if used + own + rest > width && at > 0 {
            break;
        }
        used += own;
        count = at + 1;
    }
    (&notes[..count], notes.len() - count + more)
}

/// Returns true if the device of a row is not on the bus.
fn is_absent(row: &Row) -> bool {
    matches!(
        row.state,
        RowState::Lost
            | RowState::Unknown
            | RowState::Missing
            | RowState::Pending
            | RowState::Duplicate
    )
}

/// Returns the role of one of several boards at an address.
pub(super) fn side_role(row: &Row) -> Option<Role> {
    row.board.map(|board| if board.side == 'A' { Role::SideA } else { Role::SideB })
}

/// Returns the text of a UID, in the alphabet of the profile.
pub(super) fn uid_text(app: &App, device: &Device, uid: Uid) -> String {
    if uid.is_blank() {
        return "blank".to_owned();
    }
    let profile = app.profile(device.id.bus);
    Escaped(uid.text(&profile.uid).to_string().trim().as_bytes()).to_string()
}

/// Returns the verdict of the FILE column, the worst one, and its role; without `has_text` only sign
/// and address.
pub(super) fn file_word(row: &Row, has_text: bool) -> (Role, String) {
    let with = |role, sign: &str, text: String| {
        let is_short = !has_text && !text.chars().all(|c| c.is_ascii_digit());
        (role, if is_short || text.is_empty() { sign.to_owned() } else { format!("{sign} {text}") })
    };
    let of = |address: Option<u8>| address.map_or("–".to_owned(), |address| address.to_string());
    if row.state == RowState::Missing {
        return with(Role::FileDiffers, "✗", "absent".to_owned());
    }
    match row.file {
        FileStatus::Nothing => (Role::Muted, String::new()),
        FileStatus::Differs(address) => with(Role::FileDiffers, "✗", address.to_string()),
        _ if row.has_findings => with(Role::Warning, "!", "entry".to_owned()),
        FileStatus::New => with(Role::New, "+", "new".to_owned()),
        FileStatus::Pinned(address) => with(Role::Muted, "…", address.to_string()),
        _ if row.has_other_services && row.differences == 0 => {
            with(Role::FileDiffers, "≠", "order".to_owned())
        }
        _ if row.has_other_services => {
            with(Role::FileDiffers, "≠", format!("{} svc", row.differences))
        }
        FileStatus::Listed(address) => with(Role::Muted, "·", of(address)),
        FileStatus::Agrees(address) => with(Role::FileOk, "✓", address.to_string()),
    }
}

/// Returns the address of a row, with the letter of a board; on redundant buses all of them
/// (`12/13`); `–` if it has none.
fn addresses(app: &App, row: &Row) -> String {
    let mut all: Vec<String> =
        app.devices_of(row).map(|device| device.address.to_string()).collect();
    all.dedup();
    if all.is_empty() {
        return row.address.map_or("–".to_owned(), |address| address.to_string());
    }
    let side = row.board.map(|board| board.side.to_string()).unwrap_or_default();
    all.join("/") + &side
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
        // Of a bus with the same name its number: `can0+#2`.
        let number = other.strip_prefix(first.as_str()).filter(|rest| rest.starts_with('#'));
        let short = number.or(other.strip_prefix(stem)).filter(|rest| !rest.is_empty());
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

/// Draws the address prompt into the FILE column of the row being edited.
fn draw_editor(brush: &mut DrawContext, list: Rect, line: u16, row: &Row, start: usize) {
    let Some(prompt) = brush.app.prompt() else { return };
    let is_here = |key: &RowKey| match key {
        RowKey::Device(id) => row.has_device(*id),
        RowKey::Entry(..) | RowKey::Board(..) => *key == row.key,
    };
    if !matches!(&prompt.kind, PromptKind::Address(it) if is_here(&it.key)) {
        return;
    }
    let start = start as u16;
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
    if start > 0 {
        // Something else may end there.
        brush.buffer[(at.x - 1, at.y)].set_symbol(" ");
    }
    brush.buffer.set_string(at.x, at.y, fit("", usize::from(width)), under);
    brush.buffer.set_style(at, ratatui::style::Style::reset().patch(under));
    brush.buffer.set_stringn(at.x, at.y, text, usize::from(width), style);
    let cursor = prompt.input.visual_cursor().saturating_sub(scroll) as u16;
    brush.cursor = Some(Position::new(at.x + cursor.min(width - 1), at.y));
}
