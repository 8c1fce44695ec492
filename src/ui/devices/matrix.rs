//! The view of services: devices by services, a cell is the version. A version that has changed or
//! is not the most common one is marked, and one that differs from des.json has `≠`.

use super::columns::SIGNS;
use super::{
    addresses, buses, draw_editor, is_absent, side_role, sign, twin_name, uid_text, visible_rows,
};
use crate::app::{PromptKind, Row, ServiceTable, VersionCell, matrix_start};
use crate::cell_text::cut;
use crate::theme::Role;
use crate::ui::brush::{DrawContext, fit, fit_right};
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Columns of the address prompt, over the last services.
const EDITOR_WIDTH: usize = 9;

/// Draws the headings and the rows that fit.
pub fn draw(brush: &mut DrawContext) {
    let list = brush.screen.list;
    let app = brush.app;
    let table = ServiceTable::new(app);
    let width = usize::from(list.width);
    let first = app.view().devices_page.first_service.min(table.names.len().saturating_sub(1));
    let widths = table.widths(app, width, first);
    let services = || table.names.iter().skip(first).zip(&widths);
    let mut heading = Line::from(" ".repeat(SIGNS));
    if app.buses().len() > 1 {
        heading.push_span(brush.span(Role::Header, fit("BUS", 7)));
    }
    heading.push_span(brush.span(Role::Header, "ADDR NAME      "));
    if matrix_start(app, width) > matrix_start(app, 0) {
        heading.push_span(brush.span(Role::Header, fit("UID", 9)));
    }
    let hidden = table.names.len().saturating_sub(first + widths.len());
    let hidden = hidden_text(hidden, first);
    let end = width.saturating_sub(hidden.width());
    for (service, width) in services() {
        let room = end.saturating_sub(heading.width()).min(*width);
        let name = fit(&service.to_string(), room);
        heading.push_span(brush.span(Role::Header, fit(&name, width + 1)));
    }
    if table.names.is_empty() {
        heading.push_span(brush.span(Role::Muted, "no services are known yet"));
    }
    draw_heading(brush, &heading, hidden);
    draw_editor_heading(brush, width);
    for (line, is_selected, row) in visible_rows(app, list.height) {
        let mut text = start(brush, row, is_selected, width);
        let listed = app.entry_of(row).and_then(|entry| entry.services.as_deref());
        for (service, width) in services() {
            let cell = table.cell(app.device_of(row), service, listed);
            text.spans.extend(cell_spans(brush, row, &cell, *width));
            text.push_span(" ");
        }
        text.spans.pop();
        brush.line(list, line, &text);
        if is_selected {
            brush.select(list, line);
        }
        draw_editor(brush, list, line, row, width.saturating_sub(EDITOR_WIDTH));
    }
}

/// Draws the heading of the address prompt, which covers the last services.
fn draw_editor_heading(brush: &mut DrawContext, width: usize) {
    let prompt = brush.app.prompt().map(|prompt| &prompt.kind);
    if matches!(prompt, Some(PromptKind::Address(_))) && width > EDITOR_WIDTH {
        let header = brush.screen.header;
        let x = header.x + (width - EDITOR_WIDTH - 1) as u16;
        let at = Rect { x, width: EDITOR_WIDTH as u16 + 1, ..header };
        let text = Line::from(brush.span(Role::Header, fit(" FILE", EDITOR_WIDTH + 1)));
        brush.line(at, 0, &text);
    }
}

/// The numbers of services that do not fit, before the shown ones and behind them.
fn hidden_text(hidden: usize, first: usize) -> String {
    match (first, hidden) {
        (0, 0) => String::new(),
        (first, 0) => format!(" ← {first}"),
        (0, hidden) => format!(" → {hidden}"),
        (first, hidden) => format!(" ← {first} → {hidden}"),
    }
}

/// Draws the headings; at the right end the numbers of services that do not fit.
fn draw_heading(brush: &mut DrawContext, heading: &Line, hidden: String) {
    let header = brush.screen.header;
    brush.line(header, 0, heading);
    let width = (hidden.width() as u16).min(header.width);
    let at = Rect { x: header.right() - width, width, ..header };
    let line = Line::from(brush.span(Role::Title, hidden));
    brush.line(at, 0, &line);
}

/// Returns signs, bus, address, name and UID of a row.
fn start(brush: &DrawContext, row: &Row, is_selected: bool, width: usize) -> Line<'static> {
    let app = brush.app;
    let (sign, role) = sign(row);
    let plain = if is_absent(row) { Role::Muted } else { Role::Text };
    let pointer = if is_selected { "▸" } else { " " };
    let mut line =
        Line::from(vec![brush.span(Role::Text, pointer), brush.span(role, sign), Span::raw(" ")]);
    if app.buses().len() > 1 {
        line.push_span(brush.span(Role::Muted, fit(&buses(app, row, 6), 7)));
    }
    let side = side_role(row).unwrap_or(plain);
    line.push_span(brush.span(side, fit_right(&addresses(app, row), 4)));
    let name = row.name.as_ref().map_or("?".to_owned(), |name| name.quoted().to_string());
    let name = if row.twin { twin_name(&name, 9) } else { name };
    line.push_span(brush.span(plain, format!(" {} ", fit(&name, 9))));
    if matrix_start(app, width) > matrix_start(app, 0) {
        let uid = row.uid.zip(app.device_of(row)).map(|(uid, device)| uid_text(app, device, uid));
        let uid = uid.unwrap_or_else(|| "–".to_owned());
        line.push_span(brush.span(side, fit(&uid, 8)));
        line.push_span(" ");
    }
    line
}

fn cell_spans(
    brush: &DrawContext,
    row: &Row,
    cell: &VersionCell,
    width: usize,
) -> Vec<Span<'static>> {
    let role = match cell.text.as_str() {
        "·" => Role::Muted,
        _ if is_absent(row) => Role::Muted,
        _ if cell.is_changed => Role::Changed,
        _ => Role::Text,
    };
    let sign = if cell.differs_from_file { "≠" } else { "" };
    let room = width - sign.width();
    let text = if cell.text.width() > room {
        fit(&cell.text, room)
    } else {
        cut(&cell.text, room).to_owned()
    };
    let blank = " ".repeat(width.saturating_sub(text.width() + sign.width()));
    vec![brush.span(role, text), brush.span(Role::FileDiffers, sign), Span::raw(blank)]
}
