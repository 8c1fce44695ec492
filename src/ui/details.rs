//! The details of the selected row of Devices: presence, findings, reasons for a missing device,
//! heartbeat, identity, services, the entry of des.json, history, and state of the requests.

use super::brush::{DrawContext, fit, inner, labelled, wrap};
use super::devices::state_role;
use super::symbols;
use crate::app::{
    App, FileStatus, Redundancy, Row, RowState, concerns, format_duration, format_time_of_day,
    whose_other_services, whose_services,
};
use crate::discovery::{Device, DeviceService, Query, QueryFault, QueryState};
use crate::finding::{Finding, FindingKind, FindingState};
use crate::keymap::Action;
use crate::theme::Role;
use crate::time::Duration;
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Draws the details at the right of the list, below it, or in its place.
pub fn draw(brush: &mut DrawContext) {
    let area = inner(brush.screen.details);
    if area.height == 0 {
        return;
    }
    let lines = match brush.app.selected_row() {
        Some(row) => DeviceDetails { brush, row, width: area.width, lines: Vec::new() }.all(),
        None => vec![Line::from(brush.span(Role::Muted, "nothing is selected"))],
    };
    let scroll = brush.app.view().details_scroll;
    brush.lines(area, &lines, scroll);
}

/// The lines of the details, collected top to bottom.
struct DeviceDetails<'b, 'a> {
    brush: &'b DrawContext<'a>,
    row: &'a Row,
    width: u16,
    lines: Vec<Line<'static>>,
}

impl<'a> DeviceDetails<'_, 'a> {
    /// All lines; a section without content has none.
    fn all(mut self) -> Vec<Line<'static>> {
        let app = self.brush.app;
        let device = app.device_of(self.row);
        self.state(device);
        self.findings(device);
        self.why(device);
        if let Some(device) = device {
            self.heartbeat(device);
            self.identity(device);
            self.services(device);
        }
        self.file(device);
        if let Some(device) = device {
            self.history(device);
            self.requests(device);
            self.quirks(device);
        }
        self.lines
    }

    fn app(&self) -> &'a App {
        self.brush.app
    }

    /// Time from `at` to the time shown on the screen.
    fn ago(&self, at: crate::time::Instant) -> Duration {
        self.app().display_time().since(at)
    }

    /// Begins a section: adds an empty line unless the last line is empty.
    fn blank(&mut self) {
        if self.lines.last().is_some_and(|line| !line.spans.is_empty()) {
            self.lines.push(Line::default());
        }
    }

    /// Adds a label of 10 columns and wrapped text; with an empty label the text has no indent.
    fn add(&mut self, label: &str, role: Role, text: &str) {
        let label = if label.is_empty() { String::new() } else { fit(label, 10) };
        self.lines.extend(labelled(self.brush, &label, role, text, self.width));
    }

    /// State word, duration, bus if there are several, last frame, redundant buses, twins.
    fn state(&mut self, device: Option<&Device>) {
        let row = self.row;
        let since = device.map_or(String::new(), |device| {
            format!(" {}", format_duration(self.ago(device.presence_since)))
        });
        let word = match (row.state, device) {
            (RowState::Conflict | RowState::Unknown, Some(device)) => {
                format!("{} · {}", row.state.word(), device.presence)
            }
            _ => row.state.word().to_owned(),
        };
        let bus = match row.bus.and_then(|bus| self.app().bus(bus)) {
            Some(bus) if self.app().buses().len() > 1 && row.redundant_ids.is_empty() => {
                format!(" on {}", bus.name)
            }
            _ => String::new(),
        };
        let mut line = Line::from(self.brush.span(state_role(row.state), word));
        line.push_span(self.brush.span(Role::Text, format!("{since}{bus}")));
        self.lines.push(line);
        let unseen = row.state == RowState::Unknown;
        if let Some(device) = device.filter(|device| unseen || !device.is_present()) {
            let text = format!("last seen {} ago", format_duration(self.ago(device.last_seen)));
            self.add("", Role::Text, &text);
        }
        self.other_buses(device);
        if row.twin
            && let Some(device) = device
        {
            let twins = self.app().buses()[usize::from(device.id.bus.0)].devices().iter();
            let twins: Vec<String> = twins
                .filter(|it| it.id != device.id && it.is_present() && it.name == device.name)
                .map(|it| it.address.to_string())
                .collect();
            self.add("", Role::Text, &format!("² same name at {} (allowed)", twins.join(", ")));
        }
    }

    /// The same device on other buses: redundant ones with their state, separate networks.
    fn other_buses(&mut self, device: Option<&Device>) {
        let Some(device) = device else { return };
        let app = self.app();
        if !self.row.redundant_ids.is_empty() {
            self.add("", Role::Text, "redundant: the same services on each bus");
            for device in app.devices_of(self.row) {
                let Some(bus) = app.bus(device.id.bus) else { continue };
                let (presence, since) =
                    (device.presence, format_duration(self.ago(device.presence_since)));
                let text = format!("@{} {presence} {since}", device.address);
                self.add(&bus.name, state_role(presence.into()), &text);
            }
        }
        for sibling in app.redundant_devices(device.id) {
            let (Some(other), Some(bus)) = (app.device(sibling.id), app.bus(sibling.id.bus)) else {
                continue;
            };
            if sibling.relation == Redundancy::Redundant {
                continue;
            }
            let what = sibling.relation.words();
            let text = format!("also on {} @{}, {what}", bus.name, other.address);
            self.add("", Role::Text, &text);
        }
    }

    /// Findings about the device that are not cleared, and the key that opens Problems.
    fn findings(&mut self, device: Option<&Device>) {
        let of_row = |finding: &Finding| {
            finding.key.name.is_some()
                && finding.key.name == self.row.name
                && finding.key.address == self.row.address
        };
        let about = |finding: &Finding| {
            finding.state != FindingState::Cleared
                && finding.key.kind != FindingKind::Missing
                && device.map_or_else(|| of_row(finding), |device| concerns(finding, device))
        };
        let mut any = false;
        for problem in self.app().problems_with(about) {
            for finding in problem.findings.iter().filter(|finding| about(finding)) {
                any = true;
                // Stands at its entry, below.
                if finding.position.is_some() {
                    continue;
                }
                let (sign, role) = symbols::of_finding_state(finding.state);
                let sure = finding.state == FindingState::Confirmed && !problem.is_muted;
                let headline = problem.headline();
                let text = if finding.text.is_empty() { &*headline } else { &finding.text };
                let text_role = if sure { Role::Text } else { Role::Muted };
                let muted = if problem.is_muted { "muted · " } else { "" };
                let text = format!("{muted}{text}");
                let mut lines =
                    labelled(self.brush, &format!("{sign} "), text_role, &text, self.width);
                if let Some(first) = lines.first_mut() {
                    first.spans[0].style = self.brush.style(role);
                }
                self.lines.extend(lines);
            }
        }
        if any {
            let key = self.app().key_of(Action::Problem);
            let page = crate::app::Page::Problems;
            let text = format!("→ {} {} ({key})", page.number(), page.title());
            self.lines.push(Line::from(self.brush.span(Role::Muted, text)));
        }
    }

    /// Why the device is missing, or why its name or services are not known, likeliest cause first.
    fn why(&mut self, device: Option<&Device>) {
        let app = self.app();
        let reasons = match (device, app.entry_of(self.row)) {
            (Some(device), Some(entry)) if !device.is_present() => app.missing_reasons(entry),
            (Some(device), _) => app.incomplete_reasons(device),
            (None, Some(_)) if self.row.state == RowState::Duplicate => Vec::new(),
            (None, Some(entry)) => app.missing_reasons(entry),
            (None, None) => Vec::new(),
        };
        for reason in reasons {
            self.lines.extend(labelled(self.brush, "→ ", Role::Warning, &reason, self.width));
        }
    }

    /// Heartbeat period and jitter, missed heartbeats, mode, error code, the last six modes.
    fn heartbeat(&mut self, device: &Device) {
        let beats = &device.heartbeat;
        let is_shared = self.app().is_shared(device);
        self.blank();
        let text = match (beats.period(), beats.jitter()) {
            _ if beats.count == 0 => "none received".to_owned(),
            // Period and jitter of two senders mixed describe neither of them.
            _ if is_shared => "mixed: two senders".to_owned(),
            (Some(period), Some(jitter)) => {
                let millis = jitter.as_micros() as f64 / 1000.0;
                format!("{:.2} s ±{millis:.0} ms", period.as_secs_f64())
            }
            (Some(period), None) => format!("{:.2} s", period.as_secs_f64()),
            (None, _) => "one received".to_owned(),
        };
        let missed = match beats.missed {
            _ if is_shared => String::new(),
            0 => String::new(),
            missed => format!("{missed} missed"),
        };
        let whole = format!("{text}, {missed}");
        if missed.is_empty() || 10 + whole.width() <= usize::from(self.width) {
            self.add("heartbeat", Role::Text, if missed.is_empty() { &text } else { &whole });
        } else {
            self.add("heartbeat", Role::Text, &text);
            self.add(" ", Role::Text, &missed);
        }
        let modes: Vec<String> = device.mode_history.iter().map(|it| it.mode.to_string()).collect();
        let mode = match device.mode {
            Some(mode) => mode.to_string(),
            None if device.is_working => "working (U bit)".to_owned(),
            None => "not working (U bit)".to_owned(),
        };
        let error = device.error_code.filter(|code| *code != 0);
        let error = error.map(|code| format!(", error {code}")).unwrap_or_default();
        self.add("mode", Role::Text, &(mode + &error));
        if modes.len() > 1 {
            let last = modes.len().saturating_sub(6);
            self.add("modes", Role::Muted, &modes[last..].join(" → "));
        }
    }

    /// UIDs in use at the address, framing, debug device.
    fn identity(&mut self, device: &Device) {
        let profile = self.app().profile(device.id.bus);
        let mut uids: Vec<String> = self
            .app()
            .uids_of(device)
            .into_iter()
            .map(|uid| {
                if uid.is_blank() {
                    return "blank".to_owned();
                }
                crate::text::Escaped(uid.text(&profile.uid).to_string().as_bytes()).to_string()
            })
            .collect();
        // Sorted: the order of reception changes with each heartbeat.
        uids.sort();
        if !uids.is_empty() {
            let is_blank = uids == ["blank"];
            let role = if is_blank { Role::Muted } else { Role::Text };
            self.add("UID", role, &uids.join(" and "));
        }
        if let Some(framing) = device.framing {
            self.add("framing", Role::Text, &framing.to_string());
        }
        if device.is_debug {
            self.add("", Role::Text, "debug device");
        }
    }

    /// Services with their versions, compared with the versions before and with the entry.
    fn services(&mut self, device: &Device) {
        self.blank();
        let Some(services) = &device.services else {
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
        if services.is_empty() {
            return self.add("services", Role::Text, "none");
        }
        let lacks_other = self.row.state == RowState::Conflict && device.other_services.is_empty();
        let is_of_one = device.services_are_shared || lacks_other;
        self.services_title(services, is_of_one.then(|| whose_services(device)));
        let names = services.iter().map(|it| it.name.to_string().width()).max().unwrap_or(0);
        let names = names.clamp(4, 16);
        let listed = self.app().entry_of(self.row).and_then(|entry| entry.services.as_deref());
        for service in services {
            let version = service.version.to_string();
            let mut line =
                Line::from(self.brush.span(Role::Muted, format!("{:>3} ", service.index)));
            let name = service.name.to_string();
            line.push_span(self.brush.span(Role::Text, format!("{} ", fit(&name, names))));
            line.push_span(self.brush.span(Role::Text, version));
            for extra in &service.extra {
                line.push_span(self.brush.span(Role::Muted, format!(" {extra}")));
            }
            match in_file(listed, service) {
                InFile::Same => {}
                InFile::New => line.push_span(self.brush.span(Role::New, "  + new")),
                InFile::Other(version) => {
                    let text = format!("  ✗ {version}");
                    line.push_span(self.brush.span(Role::FileDiffers, text));
                }
            }
            if let Some(was) = before(device, service) {
                line.push_span(self.brush.span(Role::Warning, format!(" was {was}")));
            }
            self.lines.push(line);
        }
        let missing = listed.unwrap_or_default().iter().filter(|listed| {
            !services.iter().any(|own| own.name.to_string() == printable(&listed.name))
        });
        for listed in missing {
            let text = format!("  ✗ {} listed, missing", printable(&listed.name));
            self.lines.push(Line::from(self.brush.span(Role::FileDiffers, text)));
        }
        for other in &device.other_services {
            self.other_services(device, other);
        }
        if lacks_other && device.has_colliding_services() {
            let text = "Two responses at once would destroy each other, so the other list is not requested.";
            for line in wrap(text, usize::from(self.width)) {
                self.lines.push(Line::from(self.brush.span(Role::Muted, line)));
            }
        }
    }

    fn services_title(&mut self, services: &[DeviceService], whose: Option<&str>) {
        let title = format!("services {}", services.len());
        let mut line = Line::from(self.brush.span(Role::Title, title));
        if let Some(whose) = whose {
            line.push_span(self.brush.span(Role::Warning, format!(" of {whose}")));
        }
        self.lines.push(line);
    }

    /// Another service list of an address that several devices use.
    fn other_services(&mut self, device: &Device, services: &[DeviceService]) {
        self.blank();
        self.services_title(services, Some(whose_other_services(device)));
        for service in services {
            let mut line =
                Line::from(self.brush.span(Role::Muted, format!("{:>3} ", service.index)));
            let text = format!("{} {}", service.name, service.version);
            line.push_span(self.brush.span(Role::Text, text));
            for extra in &service.extra {
                line.push_span(self.brush.span(Role::Muted, format!(" {extra}")));
            }
            self.lines.push(line);
        }
    }

    /// The entry of des.json: its address against the device's, its position, invalid values.
    fn file(&mut self, device: Option<&Device>) {
        let app = self.app();
        self.blank();
        let name = app.file().name();
        let (role, text) = match (self.row.file, device) {
            (FileStatus::Nothing, _) => return,
            (FileStatus::New, _) => {
                (Role::New, format!("not in file ({} adds it)", app.key_of(Action::Add)))
            }
            (FileStatus::Listed(None), _) => (Role::Text, "listed without address".to_owned()),
            (FileStatus::Listed(Some(address)), _) => {
                (Role::Text, format!("listed, last at {address}, not static"))
            }
            (FileStatus::Agrees(address), _) if self.row.has_other_services => {
                (Role::FileDiffers, format!("static {address}, services differ"))
            }
            (FileStatus::Agrees(address), _) => {
                (Role::FileOk, format!("static {address}, matches"))
            }
            (FileStatus::Differs(address), Some(device)) => {
                (Role::FileDiffers, format!("static {address}, device at {}", device.address))
            }
            (FileStatus::Differs(address) | FileStatus::Pinned(address), _) => {
                (Role::Text, format!("static {address}"))
            }
        };
        let label = if name.width() < 9 { name } else { "file".to_owned() };
        self.add(&label, role, &text);
        if let Some(entry) = app.entry_of(self.row) {
            self.add(" ", Role::Muted, &entry.position.to_string());
            for finding in app.document().findings_of(entry.index) {
                let text = format!("! {} ({})", finding.message, finding.position);
                self.add(" ", Role::Warning, &text);
            }
            if device.is_none() {
                for service in entry.services.iter().flatten() {
                    let (name, version) = (printable(&service.name), printable(&service.version));
                    self.lines.push(Line::from(
                        self.brush.span(Role::Muted, format!("    {name} {version}")),
                    ));
                }
            }
        }
    }

    /// First frame, reboots, the address before a move.
    fn history(&mut self, device: &Device) {
        let app = self.app();
        self.blank();
        let first = format_time_of_day(app, device.first_seen);
        self.add("seen", Role::Text, &format!("since {first}"));
        if let Some(at) = device.rebooted_at {
            let ago = format_duration(self.ago(at));
            let times = match device.reboots {
                1 => "1 reboot".to_owned(),
                count => format!("{count} reboots, the last"),
            };
            self.add(" ", Role::Text, &format!("{times} {ago} ago"));
        }
        if let Some(from) = device.moved_from {
            self.add(" ", Role::Text, &format!("moved from {from}"));
        }
    }

    /// State of the name and services requests.
    fn requests(&mut self, device: &Device) {
        let lines: Vec<String> = [("name", device.name_query), ("services", device.services_query)]
            .into_iter()
            .filter_map(|(what, query)| self.request(what, query))
            .collect();
        for (at, text) in lines.iter().enumerate() {
            self.add(if at == 0 { "requests" } else { " " }, Role::Muted, text);
        }
    }

    /// Time of the response and how long it took, or the attempts so far; `None` before the first.
    fn request(&self, what: &str, query: Query) -> Option<String> {
        // Times of day, not ages: an age would redraw the line each second.
        let at = |time| format_time_of_day(self.app(), time);
        match (query.responded_at, query.sent_at) {
            (Some(answered), _) => {
                // Number and unit first: they stay on one line.
                let took = query.response_time.map(|took| format!("{} ms at ", took.as_millis()));
                Some(format!("{what} {}{}", took.unwrap_or_default(), at(answered)))
            }
            (None, Some(asked)) => {
                Some(format!("{what} ×{}, last {}, no response", query.attempts, at(asked)))
            }
            (None, None) => None,
        }
    }

    /// Deviations from the protocol.
    fn quirks(&mut self, device: &Device) {
        for deviation in &device.deviations {
            for (at, line) in wrap(deviation.describe(), usize::from(self.width).saturating_sub(2))
                .iter()
                .enumerate()
            {
                let sign = if at == 0 { "! " } else { "  " };
                self.lines
                    .push(Line::from(self.brush.span(Role::Warning, format!("{sign}{line}"))));
            }
        }
    }
}

/// Returns text of des.json with unprintable characters escaped.
fn printable(text: &str) -> String {
    crate::text::Escaped(text.as_bytes()).to_string()
}

/// Returns the version of a service before it changed, or `missing` if it was not in the list then;
/// `None` if it did not change.
fn before(device: &Device, service: &DeviceService) -> Option<String> {
    let previous = device.previous_services.as_ref()?;
    match previous.iter().find(|before| before.name == service.name) {
        Some(before) if before.version == service.version => None,
        Some(before) => Some(before.version.to_string()),
        None => Some("missing".to_owned()),
    }
}

/// A service compared with the entry of des.json.
enum InFile {
    /// Same version, or none listed to compare with.
    Same,
    /// Not listed.
    New,
    /// Listed with this version.
    Other(String),
}

/// Compares a service with those listed in the entry; an entry without services matches all.
fn in_file(listed: Option<&[crate::document::ListedService]>, service: &DeviceService) -> InFile {
    let Some(listed) = listed.filter(|listed| !listed.is_empty()) else { return InFile::Same };
    let own = service.name.to_string();
    let version = |listed: &crate::document::ListedService| printable(&listed.version);
    match listed.iter().find(|listed| printable(&listed.name) == own) {
        None => InFile::New,
        Some(listed) if listed.version.is_empty() => InFile::Same,
        Some(listed) if version(listed) == service.version.to_string() => InFile::Same,
        Some(listed) => InFile::Other(version(listed)),
    }
}
