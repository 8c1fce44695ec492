//! The list of the open page: gateways, versions, findings, or the devices of the opened gateway.

use super::table::{FleetColumn, FleetTable};
use super::{FleetBrush, age_text, of_state};
use crate::app::{
    BrokerLink, FleetDevice, FleetPage, FleetProblem, FleetRow, FleetSort, GatewayRow, VersionRow,
};
use crate::cell_text::wrap;
use crate::fleet::GatewayState;
use crate::inventory::{InventoryBus, InventoryDevice};
use crate::theme::Role;
use crate::time::Duration;
use crate::ui::brush::{set_hidden_rows, set_selected};
use crate::ui::chart::grouped;
use crate::ui::devices::period_text;
use crate::ui::status::rate;
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Parts of the text of each column.
type RowCells = Vec<Vec<(Role, String)>>;

/// Draws the headings and the rows that fit.
pub fn draw(brush: &mut FleetBrush) {
    let (header, list) = (brush.regions.header, brush.regions.list);
    if header.height == 0 {
        return;
    }
    let screen = brush.screen;
    let columns = columns(brush);
    let table = FleetTable::new(&columns, usize::from(list.width));
    let headings = table.header(brush.theme, screen.sort());
    brush.line(header, 0, &headings);
    if screen.rows().is_empty() {
        return draw_nothing(brush);
    }
    let (selected, top) = (screen.selected(), screen.top());
    draw_hidden_rows(brush, top);
    let visible = screen.rows().iter().enumerate().skip(top).take(usize::from(list.height));
    for (line, (at, row)) in visible.enumerate() {
        let is_selected = selected == Some(at);
        let (sign, cells) = cells(brush, row);
        let text = table.row(brush.theme, is_selected, sign, &cells);
        brush.line(list, line as u16, &text);
        if is_selected {
            set_selected(brush.buffer, brush.theme, list, line as u16);
        }
    }
}

/// Draws the number of rows above and below the screen at the right end of the headings.
fn draw_hidden_rows(brush: &mut FleetBrush, above: usize) {
    let (header, height) = (brush.regions.header, usize::from(brush.regions.list.height));
    let below = brush.screen.rows().len().saturating_sub(above + height);
    set_hidden_rows(brush.buffer, brush.theme, header, (above, below));
}

/// Draws why the list is empty.
fn draw_nothing(brush: &mut FleetBrush) {
    let screen = brush.screen;
    let page = screen.page();
    let text = if screen.filter().is_on && screen.row_total() > 0 {
        // While it is entered, Esc goes back to the one before.
        let key = if screen.prompt().is_some() { "" } else { "; Esc switches it off" };
        format!("no {} match the filter{key}", screen.row_kind(page).plural())
    } else {
        match (page, screen.opened(), screen.link()) {
            (_, Some(name), _) if screen.gateway(name).is_none() => {
                format!("the broker has no documents of {name} any more; Esc goes back")
            }
            (FleetPage::Main, Some(_), _) => "this gateway has published no devices".to_owned(),
            (_, _, BrokerLink::Connecting) => "connecting to the broker".to_owned(),
            (_, _, BrokerLink::Failed { .. }) if screen.is_unread() => {
                "not connected to the broker yet: nothing is known".to_owned()
            }
            (FleetPage::Main, None, BrokerLink::Reading) => "reading documents".to_owned(),
            (FleetPage::Main, None, _) => "no gateway found: none has published at this broker, or the \
                 user may not read descan/v1/#; on a gateway run: descan publish can0 --broker ADDRESS, \
                 the broker's address as seen from there"
                .to_owned(),
            (FleetPage::Versions, ..) => "no services are known".to_owned(),
            (FleetPage::Problems, ..) => "no problems".to_owned(),
        }
    };
    let list = brush.regions.list;
    let width = usize::from(list.width).saturating_sub(4);
    for (row, part) in wrap(&text, width).into_iter().enumerate() {
        let line = Line::from(brush.span(Role::Muted, format!("   {part}")));
        brush.line(list, row as u16 + 1, &line);
    }
}

/// The columns of the open page.
fn columns(brush: &FleetBrush) -> Vec<FleetColumn> {
    let screen = brush.screen;
    let is_narrow = brush.regions.whole.width < 60;
    let most = if is_narrow { 14 } else { 24 };
    let column = FleetColumn::new;
    match screen.page() {
        FleetPage::Main if screen.opened().is_some() => {
            let has_buses = has_several_buses(brush);
            let mut all = vec![
                column("ADDR", 4, 0).of_number().sorted_by(FleetSort::Address),
                column("NAME", widest(brush, 6, most), 0).sorted_by(FleetSort::Name),
                column("UID", 8, 5),
                column("STATE", 8, 0).sorted_by(FleetSort::Severity),
                column("MODE", 5, 3),
                column("HEARTBEAT", 9, 4).of_number(),
                column("SERVICES", 8, 2).with_rest(),
            ];
            if has_buses {
                all.push(column("BUS", widest_bus(brush, most), 1));
            }
            all
        }
        FleetPage::Main => vec![
            column("GATEWAY", widest(brush, 7, most), 0).sorted_by(FleetSort::Name),
            column("STATE", 7, 0).sorted_by(FleetSort::Severity),
            column("FOR", 7, 4),
            column("BUSES", 12, 3).with_rest(),
            column("DEV", 5, 0).of_number().sorted_by(FleetSort::Devices),
            column("LOST", 5, 2).of_number().sorted_by(FleetSort::Lost),
            column("PROBLEMS", 9, 1).sorted_by(FleetSort::Problems),
            column("DESCAN", 7, 5).sorted_by(FleetSort::Version),
        ],
        FleetPage::Versions => {
            let mut all = vec![
                column("SERVICE", widest(brush, 8, most), 0).sorted_by(FleetSort::Severity),
                column("VERSION", 12, 0),
                column("DEVICES", 8, 0).of_number().sorted_by(FleetSort::Devices),
            ];
            if screen.opened().is_none() {
                all.push(column("GATEWAYS", 9, 1).of_number().sorted_by(FleetSort::Gateways));
            }
            all.push(column("", 0, 2).with_rest());
            all
        }
        FleetPage::Problems => {
            let gateway = if screen.opened().is_some() { 0 } else { widest(brush, 7, most) };
            let mut all = vec![
                column("AT", 7, 1),
                column("PROBLEM", if is_narrow { 16 } else { 32 }, 0)
                    .sorted_by(FleetSort::Severity),
                column("TEXT", 12, 2).with_rest(),
            ];
            if gateway > 0 {
                all.insert(0, column("GATEWAY", gateway, 0).sorted_by(FleetSort::Name));
            }
            all
        }
    }
}

/// Cells for the first text of all rows, within bounds.
fn widest(brush: &FleetBrush, least: usize, most: usize) -> usize {
    let of_row = |row: &FleetRow| match row {
        FleetRow::Gateway(row) => row.name.as_str().len(),
        FleetRow::Version(row) => row.service.width(),
        FleetRow::Problem(problem) => problem.gateway.as_str().len(),
        FleetRow::Device(row) => row.device.name.as_deref().map_or(1, UnicodeWidthStr::width),
    };
    brush.screen.rows().iter().map(of_row).max().unwrap_or_default().clamp(least, most)
}

/// Cells for the bus of all devices, within bounds.
fn widest_bus(brush: &FleetBrush, most: usize) -> usize {
    let of_row = |row: &FleetRow| match row {
        FleetRow::Device(row) => row.device.bus.width(),
        _ => 0,
    };
    brush.screen.rows().iter().map(of_row).max().unwrap_or_default().clamp(3, most)
}

fn has_several_buses(brush: &FleetBrush) -> bool {
    let mut buses = brush.screen.rows().iter().filter_map(|row| match row {
        FleetRow::Device(row) => Some(&row.device.bus),
        _ => None,
    });
    let first = buses.next();
    buses.any(|bus| Some(bus) != first)
}

/// Sign and texts of a row.
fn cells(brush: &FleetBrush, row: &FleetRow) -> ((&'static str, Role), RowCells) {
    let (sign, cells) = match row {
        FleetRow::Gateway(row) => gateway_cells(brush, row),
        FleetRow::Version(row) => version_cells(brush, row),
        FleetRow::Problem(problem) => problem_cells(brush, problem),
        FleetRow::Device(row) => device_cells(row),
    };
    if !brush.screen.is_old() && !is_of_absent_gateway(brush, row) {
        return (sign, cells);
    }
    // What may have changed since has no colour.
    let muted = |parts: Vec<(Role, String)>| {
        parts.into_iter().map(|(_, text)| (Role::Muted, text)).collect()
    };
    ((sign.0, Role::Muted), cells.into_iter().map(muted).collect())
}

/// Returns true for a device of a gateway that is not online.
fn is_of_absent_gateway(brush: &FleetBrush, row: &FleetRow) -> bool {
    let gateway = || brush.screen.gateway_row(brush.screen.opened()?);
    matches!(row, FleetRow::Device(_))
        && gateway().is_some_and(|it| it.state != GatewayState::Online)
}

fn one(role: Role, text: impl Into<String>) -> Vec<(Role, String)> {
    vec![(role, text.into())]
}

/// A number; none of a kind is blank.
fn count_text(count: usize) -> String {
    if count == 0 { String::new() } else { grouped(count as u64) }
}

fn gateway_cells(brush: &FleetBrush, row: &GatewayRow) -> ((&'static str, Role), RowCells) {
    let facts = &row.facts;
    let (sign, role) = of_state(row.state);
    let mut problems = Vec::new();
    if facts.has_file_error() {
        problems.push((Role::Error, "✗ ".to_owned()));
    }
    if facts.confirmed > 0 {
        problems.push((Role::Confirmed, format!("⚠ {} ", facts.confirmed)));
    }
    if facts.suspected > 0 {
        problems.push((Role::Suspected, format!("? {}", facts.suspected)));
    }
    let buses = facts.buses.iter().map(bus_text).collect::<Vec<_>>().join(", ");
    let descan = if facts.descan.is_empty() { "–" } else { &facts.descan };
    // What is as it was last known has no colour.
    let current = |role| if row.state == GatewayState::Online { role } else { Role::Muted };
    let cells = vec![
        one(Role::Text, row.name.as_str()),
        one(role, row.state.name()),
        one(Role::Muted, age_text(brush.screen, row)),
        one(current(Role::Text), buses),
        one(current(Role::Text), grouped(facts.present as u64)),
        one(current(Role::Lost), count_text(facts.lost)),
        problems,
        one(Role::Muted, descan),
    ];
    let sign = if facts.conflicts > 0 { ("⚠", Role::Confirmed) } else { (sign, role) };
    (sign, cells)
}

/// A bus in a few words: `can0 125k active 7%`.
fn bus_text(bus: &InventoryBus) -> String {
    let mut text = bus.name.clone();
    if let Some(bits) = bus.bitrate.and_then(|bits| u32::try_from(bits).ok()) {
        text = format!("{text} {}", rate(bits));
    }
    if let Some(state) = &bus.state {
        text = format!("{text} {}", state.strip_prefix("error-").unwrap_or(state));
    }
    match bus.load.filter(|load| load.is_finite()) {
        Some(load) => format!("{text} {:.0}%", load * 100.0),
        None => text,
    }
}

fn version_cells(brush: &FleetBrush, row: &VersionRow) -> ((&'static str, Role), RowCells) {
    let role = if row.has_others { Role::Changed } else { Role::Text };
    let version = if row.version.is_empty() { "–" } else { &row.version };
    let mut cells = vec![
        one(Role::Text, row.service.as_str()),
        one(role, version),
        one(Role::Text, grouped(row.devices as u64)),
    ];
    if brush.screen.opened().is_none() {
        cells.push(one(Role::Text, grouped(row.gateways as u64)));
    }
    let sign = if row.has_others { ("≠", Role::Changed) } else { (" ", Role::Text) };
    (sign, cells)
}

/// Sign and role of a finding.
pub fn of_problem(problem: &FleetProblem) -> (&'static str, Role) {
    if problem.is_confirmed() { ("⚠", Role::Confirmed) } else { ("?", Role::Suspected) }
}

/// Addresses of a finding: `14`, `12,14`; `–` without one.
pub fn addresses_text(problem: &FleetProblem) -> String {
    let all: Vec<String> = problem.addresses().map(|it| it.number().to_string()).collect();
    if all.is_empty() { "–".to_owned() } else { all.join(",") }
}

fn problem_cells(brush: &FleetBrush, problem: &FleetProblem) -> ((&'static str, Role), RowCells) {
    let (sign, role) = of_problem(problem);
    let mut cells = vec![
        one(Role::Text, addresses_text(problem)),
        one(role, problem.headline()),
        one(Role::Muted, problem.finding.text.as_str()),
    ];
    if brush.screen.opened().is_none() {
        cells.insert(0, one(Role::Text, problem.gateway.as_str()));
    }
    ((sign, role), cells)
}

/// Sign, role and word of the presence of a device.
pub fn of_presence(row: &FleetDevice) -> (&'static str, Role, &str) {
    if row.is_in_conflict {
        return ("⚠", Role::Confirmed, "CONFLICT");
    }
    match row.device.presence.as_deref() {
        Some("online") => ("●", Role::Online, "online"),
        Some("stale") => ("◐", Role::Stale, "stale"),
        Some("silent") => ("◌", Role::Silent, "silent"),
        Some("asleep") => ("◒", Role::Asleep, "asleep"),
        Some("lost") => ("○", Role::Lost, "lost"),
        Some(other) => ("·", Role::Muted, other),
        None => ("·", Role::Muted, "–"),
    }
}

/// Name of a device; `–` while it is not known.
pub fn name_text(device: &InventoryDevice) -> &str {
    device.name.as_deref().unwrap_or("–")
}

/// Its UID; `–` while it is not known.
pub fn uid_text(device: &InventoryDevice) -> &str {
    match device.uid.as_deref() {
        None => "–",
        Some(uid) if uid.trim().is_empty() => "blank",
        Some(uid) => uid,
    }
}

/// Its heartbeat period; `–` while it is not known.
pub fn heartbeat_text(device: &InventoryDevice) -> String {
    let period = device.period_ms.and_then(|it| Duration::try_from_secs_f64(it / 1000.0).ok());
    period.map_or("–".to_owned(), period_text)
}

/// Its services with their versions; `–` while they are not known.
pub fn services_text(device: &InventoryDevice) -> String {
    let Some(services) = &device.services else { return "–".to_owned() };
    let all = services.iter().map(|it| format!("{} {}", it.name, it.version).trim_end().to_owned());
    all.collect::<Vec<_>>().join(", ")
}

fn device_cells(row: &FleetDevice) -> ((&'static str, Role), RowCells) {
    let device = &row.device;
    let (sign, role, word) = of_presence(row);
    let cells = vec![
        one(Role::Text, device.address.to_string()),
        one(Role::Text, name_text(device)),
        one(Role::Muted, uid_text(device)),
        one(role, word),
        one(Role::Text, device.mode.as_deref().unwrap_or("–")),
        one(Role::Muted, heartbeat_text(device)),
        one(Role::Text, services_text(device)),
        one(Role::Muted, device.bus.as_str()),
    ];
    let sign =
        if row.is_suspected && !row.is_in_conflict { ("?", Role::Suspected) } else { (sign, role) };
    (sign, cells)
}
