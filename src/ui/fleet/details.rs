//! Details of the selected row: below the list, or in its place.

use super::list::{
    addresses_text, heartbeat_text, name_text, of_presence, of_problem, services_text, uid_text,
};
use super::{FleetBrush, age_text};
use crate::app::{
    FleetDevice, FleetProblem, FleetRow, FleetScreen, GatewayRow, MAX_GATEWAY_VERSIONS, VersionRow,
};
use crate::cell_text::wrap;
use crate::fleet::GatewayState;
use crate::inventory::InventoryBus;
use crate::keymap::Action;
use crate::theme::Role;
use crate::ui::chart::grouped;
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Number of gateways that the details of a version name at most.
const MAX_NAMES: usize = 100;

/// Draws the details.
pub fn draw(brush: &mut FleetBrush) {
    let area = brush.regions.details;
    let Some(row) = brush.screen.selected_row().filter(|_| area.height > 0) else { return };
    let (title, lines) = match row {
        FleetRow::Gateway(row) => (row.name.to_string(), of_gateway(brush, row)),
        FleetRow::Version(row) => {
            (format!("{} {}", row.service, row.version), of_version(brush, row))
        }
        FleetRow::Problem(problem) => (problem.gateway.to_string(), of_finding(brush, problem)),
        FleetRow::Device(row) => {
            let (name, address) = (name_text(&row.device), row.device.address);
            (format!("{name} @{address}"), of_device(brush, row))
        }
    };
    let below = brush.titled(area, &title);
    let scroll = brush.screen.details_alone().unwrap_or_default();
    let is_alone = brush.screen.details_alone().is_some();
    let has_gateway = matches!(row, FleetRow::Problem(_)) && brush.screen.opened().is_none();
    let action = if has_gateway { Action::Details } else { Action::Into };
    let key = brush.screen.options().keymap.keys_of(action).next().filter(|_| !is_alone);
    let way = key.map_or_else(String::new, |key| format!(", {key} shows all"));
    brush.scrolled_lines(below, &lines, scroll, &way);
}

/// Lines of a label and a text, wrapped.
fn field(brush: &FleetBrush, label: &str, role: Role, text: &str) -> Vec<Line<'static>> {
    let label = format!(" {label:<9} ");
    let indent = label.width();
    let width = usize::from(brush.regions.whole.width).saturating_sub(indent + 1);
    let parts = wrap(text, width).into_iter().enumerate();
    let line = |(at, part): (usize, String)| {
        let label = if at == 0 { label.clone() } else { " ".repeat(indent) };
        Line::from(vec![brush.span(Role::Muted, label), brush.span(role, part)])
    };
    parts.map(line).collect()
}

/// Where to go for more: the commands of a shell there and of a live view.
fn commands(brush: &FleetBrush, row: &GatewayRow, bus: Option<&str>) -> Vec<Line<'static>> {
    let name = &row.name;
    let buses = row.facts.buses.iter().map(|bus| bus.name.as_str());
    let live = match bus {
        Some(bus) => FleetScreen::live_command(name, bus),
        None => buses.into_iter().find_map(|bus| FleetScreen::live_command(name, bus)),
    };
    let all: Vec<String> = FleetScreen::shell_command(name).into_iter().chain(live).collect();
    if all.is_empty() {
        return Vec::new();
    }
    field(brush, "go there", Role::New, &all.join("; live view: "))
}

fn of_gateway(brush: &FleetBrush, row: &GatewayRow) -> Vec<Line<'static>> {
    let facts = &row.facts;
    let mut lines = commands(brush, row, None);
    let descan = if facts.descan.is_empty() { "–" } else { &facts.descan };
    let mut text = format!("{} {}", row.state.name(), age_text(brush.screen, row));
    text = format!("{text}; descan {descan}");
    if let Some(events) = facts.events {
        text = format!("{text}; {} events", grouped(events.last));
        if events.dropped > 0 {
            let dropped = grouped(events.dropped);
            text = format!("{text}, {dropped} dropped while the broker was away");
        }
    }
    lines.extend(field(brush, "state", Role::Text, &text));
    for error in &facts.file_errors {
        lines.extend(field(brush, "des.json", Role::Error, error));
    }
    if facts.has_more_versions {
        let text =
            format!("more than {}: not all are listed", grouped(MAX_GATEWAY_VERSIONS as u64));
        lines.extend(field(brush, "versions", Role::Warning, &text));
    }
    for bus in &facts.buses {
        lines.extend(field(brush, &bus.name, Role::Text, &bus_facts(bus)));
    }
    lines
}

/// What is known of a bus.
fn bus_facts(bus: &InventoryBus) -> String {
    let number = |count: Option<u64>, what: &str| count.map(|it| format!("{what} {}", grouped(it)));
    let load = bus.load.filter(|load| load.is_finite());
    let parts = [
        bus.bitrate.map(|bits| format!("{} bit/s", grouped(bits))),
        bus.state.clone(),
        load.map(|load| format!("load {:.1}%", load * 100.0)),
        number(bus.frames, "frames"),
        number(bus.errors, "errors"),
        // Zero is left out: the bus has one line.
        number(bus.lost.filter(|lost| *lost > 0), "lost"),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

fn of_version(brush: &FleetBrush, row: &VersionRow) -> Vec<Line<'static>> {
    let names = brush.screen.gateways_with(row, MAX_NAMES);
    let mut text = names.join(" ");
    if row.gateways > names.len() {
        text = format!("{text} and {} more", row.gateways - names.len());
    }
    field(brush, "gateways", Role::Text, &text)
}

fn of_finding(brush: &FleetBrush, problem: &FleetProblem) -> Vec<Line<'static>> {
    let finding = &problem.finding;
    let (_, role) = of_problem(problem);
    let mut lines = Vec::new();
    for finding in problem.findings() {
        lines.extend(field(brush, "what", role, &finding.text));
    }
    lines.extend(field(brush, "remedy", Role::New, &finding.remedy));
    if let Some(row) = brush.screen.gateway_row(&problem.gateway) {
        lines.extend(commands(brush, &row, Some(&problem.bus)));
    }
    let head = format!("{}, {}", problem.headline(), finding.confidence);
    lines.extend(field(brush, "problem", Role::Text, &head));
    let place = format!("{} at {}", problem.bus, addresses_text(problem));
    lines.extend(field(brush, "where", Role::Text, &place));
    if !finding.names.is_empty() || !finding.uids.is_empty() {
        let names = finding.names.join(", ");
        let uids = match &finding.uids[..] {
            [] => String::new(),
            [only] => format!("UID {only}"),
            all => format!("UIDs {}", all.join(", ")),
        };
        let separator = if names.is_empty() || uids.is_empty() { "" } else { " · " };
        let all = format!("{names}{separator}{uids}");
        lines.extend(field(brush, "devices", Role::Text, &all));
    }
    lines
}

fn of_device(brush: &FleetBrush, row: &FleetDevice) -> Vec<Line<'static>> {
    let device = &row.device;
    let (_, role, word) = of_presence(row);
    let mut lines = field(brush, "services", Role::Text, &services_text(device));
    let mode = device.mode.as_deref().unwrap_or("–");
    let opened = brush.screen.opened().and_then(|name| brush.screen.gateway_row(name));
    let is_current = opened.as_ref().is_none_or(|it| it.state == GatewayState::Online);
    let word = if is_current { word.to_owned() } else { format!("last known {word}") };
    let role = if is_current { role } else { Role::Muted };
    let facts = format!(
        "{word}; mode {mode}; heartbeat {}; UID {}; bus {}",
        heartbeat_text(device),
        uid_text(device),
        device.bus
    );
    let state = field(brush, "state", role, &facts);
    let Some(gateway) = opened else { return [lines, state].concat() };
    for problem in &gateway.facts.problems {
        let is_here = problem.bus == device.bus
            && problem.addresses().any(|it| it.number() == device.address);
        if is_here {
            let (_, role) = of_problem(problem);
            for finding in problem.findings() {
                lines.extend(field(brush, "problem", role, &finding.text));
            }
        }
    }
    lines.extend(commands(brush, &gateway, Some(&device.bus)));
    lines.extend(state);
    if let Some(entry) = &device.entry {
        let text = match (entry.address, entry.is_static) {
            (Some(address), true) => format!("pinned to {address}"),
            (Some(address), false) => format!("listed at {address}, not pinned"),
            (None, _) => "listed".to_owned(),
        };
        lines.extend(field(brush, "des.json", Role::Text, &text));
    }
    lines
}
