//! The table of services in the details: each with its version now, when the device was first
//! heard, and in des.json.

use super::DeviceDetails;
use crate::app::{
    RowState, ServiceInFile, missing_services, printable, removed_services, version_before,
    whose_other_services, whose_services,
};
use crate::cell_text::wrap;
use crate::discovery::{Device, DeviceService, QueryFault, QueryState};
use crate::document::ListedService;
use crate::theme::Role;
use crate::ui::brush::fit;
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Cells of the index of a service and the blank behind it.
const INDEX: usize = 4;
/// Least and most cells of a version.
const VERSION: [usize; 2] = [4, 10];

/// Widths of the table.
struct Table {
    name: usize,
    version: usize,
    /// There is a column of the versions when the device was first heard.
    has_before: bool,
    /// There is a column of des.json.
    has_file: bool,
}

impl DeviceDetails<'_, '_> {
    /// Services with their versions, compared with those before and with the entry.
    pub(super) fn services(&mut self, device: &Device) {
        self.blank();
        let Some(services) = &device.services else {
            if self.row.board.is_some() {
                return self.unread_services(device);
            }
            let state = match device.services_query.state {
                _ if device.services_query.fault == Some(QueryFault::TwoResponses) => {
                    "two devices respond at once"
                }
                QueryState::NotSent => "not requested",
                QueryState::Sent => "requested …",
                QueryState::Receiving => "receiving …",
                QueryState::Responded => "malformed",
                QueryState::NoResponse => "no response",
            };
            return self.add("services", Role::Muted, state);
        };
        let listed = self.app().entry_of(self.row).and_then(|entry| entry.services.as_deref());
        let listed = listed.filter(|listed| !listed.is_empty());
        let removed: Vec<&DeviceService> = removed_services(device).collect();
        if services.is_empty() && removed.is_empty() && listed.is_none() {
            return self.add("services", Role::Text, "none");
        }
        let is_board = self.row.board.is_some();
        let is_in_conflict = self.row.state == RowState::Conflict && !is_board;
        let lacks_other = is_in_conflict && device.other_services.is_empty();
        let is_of_one = device.services_are_shared || lacks_other;
        let whose = is_of_one.then(|| whose_services(device));
        let table = self.table(device, listed);
        self.services_heading(services.len(), whose, &table);
        for service in services {
            self.service(device, service, listed, &table);
        }
        for service in removed {
            let before = printable_version(&service.version.to_string());
            self.absent_service(&service.name.to_string(), Some(before), None, &table);
        }
        for service in missing_services(listed, services) {
            let version = printable_version(&printable(&service.version));
            self.absent_service(&printable(&service.name), None, Some(version), &table);
        }
        for other in &device.other_services {
            self.other_services(device, other);
        }
        if lacks_other && device.has_colliding_services() {
            self.why_unread();
        }
    }

    /// Services of a board that sent no list of its own.
    fn unread_services(&mut self, device: &Device) {
        if device.has_colliding_services() {
            self.add("services", Role::Muted, "not read");
            self.why_unread();
        } else {
            self.add("services", Role::Muted, "no other list received");
        }
    }

    fn why_unread(&mut self) {
        let text =
            "Two responses at once would destroy each other, so the other list is not requested.";
        for line in wrap(text, usize::from(self.width)) {
            self.lines.push(Line::from(self.brush.span(Role::Muted, line)));
        }
    }

    fn table(&self, device: &Device, listed: Option<&[ListedService]>) -> Table {
        let services = device.services.iter().chain(&device.first_services).flatten();
        let (mut name, mut version) = (0, 0);
        for service in services {
            name = name.max(service.name.to_string().width());
            version = version.max(service.version.to_string().width());
        }
        for service in listed.unwrap_or_default() {
            name = name.max(printable(&service.name).width());
            version = version.max(printable(&service.version).width());
        }
        let has_before = device.has_changed_services();
        let columns = 1 + usize::from(has_before) + usize::from(listed.is_some());
        let version = version.clamp(VERSION[0], VERSION[1]);
        // The heading `services 12` stands above index and name; `≠` behind the last column.
        let room = usize::from(self.width).saturating_sub(INDEX + columns * (version + 1) + 2);
        let name = name.clamp(7, 16).min(room.max(4));
        Table { name, version, has_before, has_file: listed.is_some() }
    }

    fn services_heading(&mut self, count: usize, whose: Option<&str>, table: &Table) {
        if let Some(whose) = whose {
            self.services_title(count, Some(whose));
        }
        let title = if whose.is_some() { String::new() } else { format!("services {count}") };
        if whose.is_some() && !table.has_before && !table.has_file {
            return;
        }
        let mut line = Line::from(self.brush.span(Role::Title, fit(&title, INDEX + table.name)));
        let heads = [("now", true), ("was", table.has_before), ("file", table.has_file)];
        for (head, _) in heads.into_iter().filter(|(_, is_shown)| *is_shown) {
            let text = format!(" {}", fit(head, table.version));
            line.push_span(self.brush.span(Role::Header, text));
        }
        self.lines.push(line);
    }

    fn services_title(&mut self, count: usize, whose: Option<&str>) {
        let title = format!("services {count}");
        let mut line = Line::from(self.brush.span(Role::Title, title));
        if let Some(whose) = whose {
            line.push_span(self.brush.span(Role::Warning, format!(" of {whose}")));
        }
        self.lines.push(line);
    }

    /// A row of the table, and a line of the further strings of the service.
    fn service(
        &mut self,
        device: &Device,
        service: &DeviceService,
        listed: Option<&[ListedService]>,
        table: &Table,
    ) {
        let before = version_before(device, service);
        let file = ServiceInFile::of(listed, service);
        let role = if before.is_some() { Role::Changed } else { Role::Text };
        let version = |text: &str| format!(" {}", fit(text, table.version));
        let brush = self.brush;
        let now = printable_version(&service.version.to_string());
        let mut line = Line::from(vec![
            brush.span(Role::Muted, format!("{:>3} ", service.index)),
            brush.span(Role::Text, fit(&service.name.to_string(), table.name)),
            brush.span(role, version(&now)),
        ]);
        if table.has_before {
            let text = match &before {
                None => now.clone(),
                Some(Some(before)) => printable_version(before),
                Some(None) => "–".to_owned(),
            };
            line.push_span(brush.span(Role::Muted, version(&text)));
        }
        match file {
            _ if !table.has_file => {}
            ServiceInFile::Same => line.push_span(brush.span(Role::Muted, version(&now))),
            ServiceInFile::New => {
                line.push_span(brush.span(Role::FileDiffers, version("–") + " ≠"));
            }
            ServiceInFile::Other(listed) => {
                line.push_span(brush.span(Role::FileDiffers, version(&listed) + " ≠"));
            }
        }
        self.lines.push(line);
        self.extra(service);
    }

    fn extra(&mut self, service: &DeviceService) {
        if service.extra.is_empty() {
            return;
        }
        let extra: Vec<String> = service.extra.iter().map(ToString::to_string).collect();
        let text = format!("{}{}", " ".repeat(INDEX + 1), extra.join(" "));
        self.lines.push(Line::from(self.brush.span(Role::Muted, text)));
    }

    /// A service that the device had before, or that des.json lists, and that is not there.
    fn absent_service(
        &mut self,
        name: &str,
        before: Option<String>,
        listed: Option<String>,
        table: &Table,
    ) {
        let version = |text: &str| format!(" {}", fit(text, table.version));
        let brush = self.brush;
        let role = if listed.is_some() { Role::FileDiffers } else { Role::Changed };
        let mut line = Line::from(vec![
            brush.span(Role::Muted, "  – "),
            brush.span(role, fit(name, table.name)),
            brush.span(role, version("–")),
        ]);
        if table.has_before {
            let before = before.unwrap_or_else(|| "–".to_owned());
            line.push_span(brush.span(Role::Muted, version(&before)));
        }
        if let Some(listed) = listed {
            line.push_span(brush.span(Role::FileDiffers, version(&listed) + " ≠"));
        }
        self.lines.push(line);
    }

    /// Another service list of an address that several devices use.
    fn other_services(&mut self, device: &Device, services: &[DeviceService]) {
        self.blank();
        self.services_title(services.len(), Some(whose_other_services(device)));
        for service in services {
            let text = format!("{} {}", service.name, service.version);
            self.lines.push(Line::from(vec![
                self.brush.span(Role::Muted, format!("{:>3} ", service.index)),
                self.brush.span(Role::Text, text),
            ]));
            self.extra(service);
        }
    }
}

/// Returns a version; `–` for an empty one.
fn printable_version(version: &str) -> String {
    if version.is_empty() { "–".to_owned() } else { version.to_owned() }
}
