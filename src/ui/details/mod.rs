//! The details of the selected row of Devices: presence, findings, reasons for a missing device,
//! heartbeat, entry of des.json; services; other devices, times, and state of the requests. Beside
//! the list one below the other, below it in three columns.

mod descriptor;
mod device_type;
mod others;
mod rule;
mod services;

use super::brush::{DrawContext, fit, labelled};
use super::devices::{self, state_role};
use super::symbols;
use crate::app::{
    App, BeatStats, FileStatus, Row, RowState, concerns, format_time_of_day, printable,
};
use crate::cell_text::wrap;
use crate::discovery::{Device, Query};
use crate::finding::{Finding, FindingKind, FindingState};
use crate::keymap::Action;
use crate::theme::Role;
use crate::time::Instant;
use crate::wire::node::Mode;
use ratatui::layout::Rect;
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Cells of a label.
const LABEL: usize = 10;
/// Cells of the heartbeat strip.
const STRIP: usize = 10;
/// Width from which the list has the strip itself.
const STRIP_FROM: u16 = 70;

/// Draws the details at the right of the list, below it, or in its place; or the heartbeat history.
pub fn draw(brush: &mut DrawContext) {
    let screen = brush.screen;
    let area = screen.details;
    if area.height == 0 {
        return;
    }
    let shows_history = brush.app.view().devices_page.shows_history;
    if screen.details_rule.height > 0 {
        rule::draw(brush, shows_history);
    }
    if shows_history {
        return devices::draw_history(brush, area);
    }
    let Some(row) = brush.app.selected_row() else {
        let line = Line::from(brush.span(Role::Muted, " nothing is selected"));
        return brush.line(area, 0, &line);
    };
    let scroll = brush.app.view().details_scroll;
    if screen.details_rule.height > 0 {
        let columns = columns_of(area);
        let sections = [Section::State, Section::Services, Section::Identity];
        let lines: Vec<Vec<Line>> = columns
            .iter()
            .zip(sections)
            .map(|(column, section)| DeviceDetails::new(brush, row, column.width).section(section))
            .collect();
        for (column, lines) in columns.iter().zip(lines) {
            brush.lines(*column, &lines, scroll);
            if column.x > area.x + 1 {
                let style = brush.style(Role::Border);
                for y in area.top()..area.bottom() {
                    brush.buffer[(column.x - 2, y)].set_symbol("│").set_style(style);
                }
            }
        }
        return;
    }
    // The divider is at the left; in the place of the list there is none.
    let right = if screen.divider.height > 0 { 1 } else { 2 };
    let inner = Rect { x: area.x + 1, width: area.width.saturating_sub(right), ..area };
    let lines = DeviceDetails::new(brush, row, inner.width).all();
    brush.lines(inner, &lines, scroll);
}

/// Returns the areas of the three columns below the list.
fn columns_of(area: Rect) -> [Rect; 3] {
    let third = area.width / 3;
    [0, third, 2 * third].map(|x| {
        let end = if x == 2 * third { area.width } else { x + third };
        let width = end.saturating_sub(x + 2);
        Rect { x: area.x + x + 1, width, ..area }
    })
}

/// A column of the details below the list.
#[derive(Clone, Copy)]
enum Section {
    /// Presence, other buses and boards, problems, heartbeat.
    State,
    /// Services.
    Services,
    /// Entry of des.json, devices with the same name, framing, times, requests.
    Identity,
}

/// The lines of the details, collected top to bottom.
struct DeviceDetails<'b, 'a> {
    brush: &'b DrawContext<'a>,
    row: &'a Row,
    width: u16,
    lines: Vec<Line<'static>>,
}

impl<'b, 'a> DeviceDetails<'b, 'a> {
    fn new(brush: &'b DrawContext<'a>, row: &'a Row, width: u16) -> Self {
        Self { brush, row, width, lines: Vec::new() }
    }

    /// All lines; a section without content has none.
    fn all(mut self) -> Vec<Line<'static>> {
        if self.brush.screen.divider.height > 0 {
            let title = title(self.brush.app, self.row);
            self.lines.push(Line::from(self.brush.span(Role::Title, title)));
        }
        let device = self.app().device_of(self.row);
        self.fill_state(device);
        self.file(device);
        match device {
            Some(device) => {
                self.twins(device);
                self.services(device);
                self.fill_identity(device);
            }
            None => self.listed_services(),
        }
        self.lines
    }

    fn section(mut self, section: Section) -> Vec<Line<'static>> {
        let device = self.app().device_of(self.row);
        match (section, device) {
            (Section::State, device) => self.fill_state(device),
            (Section::Services, Some(device)) => self.services(device),
            (Section::Services, None) => self.listed_services(),
            (Section::Identity, device) => {
                self.file(device);
                if let Some(device) = device {
                    self.twins(device);
                    self.fill_identity(device);
                }
            }
        }
        self.lines
    }

    fn fill_state(&mut self, device: Option<&Device>) {
        self.state(device);
        if let Some(device) = device {
            self.other_buses(device);
            self.tasks(device);
            self.boards(device);
        }
        self.findings(device);
        self.why(device);
        if let Some(device) = device {
            self.heartbeat(device);
        }
    }

    fn fill_identity(&mut self, device: &Device) {
        self.blank();
        self.identity(device);
        self.device_type(device);
        self.descriptor(device);
        self.history(device);
        self.requests(device);
        self.debug_messages(device);
        self.quirks(device);
    }

    fn app(&self) -> &'a App {
        self.brush.app
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

    /// State word, since when, bus if there are several, last frame.
    fn state(&mut self, device: Option<&Device>) {
        let row = self.row;
        let app = self.app();
        // Times of day, not ages: an age would redraw the line each second.
        let since = device.map_or(String::new(), |device| {
            format!(" since {}", format_time_of_day(app, device.presence_since))
        });
        let word = match (row.state, device) {
            (RowState::Conflict | RowState::Unknown, Some(device)) => {
                format!("{} · {}", row.state.word(), device.presence)
            }
            _ => row.state.word().to_owned(),
        };
        let bus = match row.bus {
            Some(bus) if app.buses().len() > 1 && row.redundant_ids.is_empty() => {
                format!(" on {}", app.shown_buses().unique_name(bus))
            }
            _ => String::new(),
        };
        let text = format!("{word}{since}{bus}");
        let mut lines = wrap(&text, usize::from(self.width)).into_iter();
        let first = lines.next().unwrap_or_default();
        let rest = first.strip_prefix(&word).unwrap_or_default().to_owned();
        let line = if rest.is_empty() && first != word {
            Line::from(self.brush.span(state_role(row.state), first))
        } else {
            Line::from(vec![
                self.brush.span(state_role(row.state), word),
                self.brush.span(Role::Text, rest),
            ])
        };
        self.lines.push(line);
        for line in lines {
            self.lines.push(Line::from(self.brush.span(Role::Text, line)));
        }
        let unseen = row.state == RowState::Unknown;
        if let Some(device) = device.filter(|device| unseen || !device.is_present()) {
            let text = format!("last seen {}", format_time_of_day(app, device.last_seen));
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
        let problems = self.app().problems_with(about);
        if problems.is_empty() {
            return;
        }
        // The key first: the texts may not fit.
        let key = self.app().key_of(Action::Problem);
        let page = crate::app::Page::Problems;
        let text = format!("→ {} {} ({key})", page.number(), page.title());
        self.lines.push(Line::from(self.brush.span(Role::Muted, text)));
        for problem in problems {
            for finding in problem.findings.iter().filter(|finding| about(finding)) {
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
    }

    /// Why the device is missing, or why its name or services are not known, likeliest cause first.
    fn why(&mut self, device: Option<&Device>) {
        let app = self.app();
        let file = app.file_of_row(self.row);
        let reasons = match (device, app.entry_of(self.row)) {
            (Some(device), Some(entry)) if !device.is_present() => app.missing_reasons(file, entry),
            (Some(device), _) => app.incomplete_reasons(device),
            (None, Some(_)) if self.row.state == RowState::Duplicate => Vec::new(),
            (None, Some(entry)) => app.missing_reasons(file, entry),
            (None, None) => Vec::new(),
        };
        for reason in reasons {
            self.lines.extend(labelled(self.brush, "→ ", Role::Warning, &reason, self.width));
        }
    }

    /// Heartbeat strip where the list has none, period and jitter, missed heartbeats, mode, error
    /// code, the last six modes.
    fn heartbeat(&mut self, device: &Device) {
        let beats = &device.heartbeat;
        let app = self.app();
        let is_shared = app.has_confirmed_conflict(device);
        self.blank();
        let stats = BeatStats::of(&if self.row.board.is_some() {
            app.beats_of(self.row, devices::STATS_BEATS)
        } else {
            Vec::new()
        });
        let (period, jitter) = match self.row.board {
            Some(_) => (stats.period, stats.jitter),
            None => (beats.steady_period(), beats.steady_jitter()),
        };
        // Period and jitter of two senders mixed describe neither of them.
        let is_mixed = is_shared && self.row.board.is_none();
        let missed = match beats.missed {
            _ if self.row.board.is_some() => stats.missed as u64,
            _ if is_mixed => 0,
            missed => missed,
        };
        let missed = (missed > 0).then(|| format!("{missed} missed"));
        let (first, rest) = match (period, jitter) {
            _ if beats.count == 0 => ("none received".to_owned(), None),
            _ if is_mixed => ("mixed: two senders".to_owned(), None),
            (Some(period), jitter) => {
                (devices::period_text(period), jitter.map(devices::jitter_text))
            }
            (None, _) => ("one received".to_owned(), None),
        };
        let rest = rest.into_iter().chain(missed).collect::<Vec<String>>().join(", ");
        if beats.count > 0 && self.brush.screen.list.width < STRIP_FROM {
            let mut line = Line::from(self.brush.span(Role::Muted, fit("heartbeat", LABEL)));
            let cells = app.beats_of(self.row, STRIP);
            line.spans.extend(devices::strip_spans(self.brush, &cells, STRIP));
            let text = format!(" {first}");
            let fits = LABEL + STRIP + text.width() <= usize::from(self.width);
            if fits {
                line.push_span(self.brush.span(Role::Text, text));
            }
            self.lines.push(line);
            if !fits {
                self.add(" ", Role::Text, &first);
            }
            self.add(" ", Role::Text, &rest);
        } else {
            let blank = if rest.is_empty() { "" } else { " " };
            self.add("heartbeat", Role::Text, &format!("{first}{blank}{rest}"));
        }
        self.clock(device, true);
        let modes: Vec<(Instant, Mode)> = match self.row.board {
            Some(_) => app.board_modes(self.row),
            None => device.mode_history.iter().map(|it| (it.time, it.mode)).collect(),
        };
        let since =
            modes.last().map(|(time, _)| format!(" since {}", format_time_of_day(app, *time)));
        let modes: Vec<String> = modes.iter().map(|(_, mode)| mode.to_string()).collect();
        let mode = match self.row.mode_of(device) {
            Some(mode) => mode.to_string(),
            None if device.is_working => "working (U bit)".to_owned(),
            None => "not working (U bit)".to_owned(),
        };
        let error = device.error_code.filter(|code| *code != 0);
        let error = error.map(|code| format!(", error {code}")).unwrap_or_default();
        let whole = format!("{mode}{}{error}", since.unwrap_or_default());
        let fits = LABEL + whole.width() <= usize::from(self.width);
        self.add("mode", Role::Text, &if fits { whole } else { mode + &error });
        if modes.len() > 1 {
            let last = modes.len().saturating_sub(6);
            self.add("modes", Role::Muted, &modes[last..].join(" → "));
        }
    }

    /// Error of the heartbeat period: among the first lines only if the clock is not like those of the
    /// other devices.
    fn clock(&mut self, device: &Device, is_outlier: bool) {
        let app = self.app();
        let error = device.heartbeat.period_error().filter(|_| !app.has_confirmed_conflict(device));
        let Some(error) = error else { return };
        // Of the other devices, by the same clock of descan.
        let others = app.usual_period_error(device.id).filter(|others| error.is_outlier(*others));
        if others.is_some() != is_outlier {
            return;
        }
        let role = if is_outlier { Role::Warning } else { Role::Text };
        let others = others.map(|others| format!(", others {others:+.0}")).unwrap_or_default();
        self.add("clock", role, &format!("{}{others}", error.text()));
    }

    /// Framing, clock, debug device; the UID is in the title.
    fn identity(&mut self, device: &Device) {
        if let Some(framing) = device.framing {
            self.add("framing", Role::Text, &framing.to_string());
        }
        self.clock(device, false);
        if device.is_debug {
            self.add("", Role::Text, "debug device");
        }
    }

    /// The entry of des.json: its address against the device's, its position, invalid values.
    fn file(&mut self, device: Option<&Device>) {
        let app = self.app();
        self.blank();
        let index = app.file_of_row(self.row);
        let name = app.file_at(index).name();
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
            let place = match app.files().count() {
                1 => entry.position.to_string(),
                _ => format!("{} of {}", entry.position, app.file_at(index).name()),
            };
            self.add(" ", Role::Muted, &place);
            let document = app.document_at(index);
            for finding in document.iter().flat_map(|it| it.findings_of(entry.index)) {
                let text = format!("! {} ({})", finding.message, finding.position);
                self.add(" ", Role::Warning, &text);
            }
            if let Some(mistake) = app.uid_mistake(index, entry) {
                self.add(" ", Role::Warning, &format!("! {mistake}"));
            }
        }
    }

    /// Services of an entry without a device.
    fn listed_services(&mut self) {
        let entry = self.app().entry_of(self.row);
        for service in entry.and_then(|entry| entry.services.as_ref()).into_iter().flatten() {
            let (name, version) = (printable(&service.name), printable(&service.version));
            let text = format!("    {name} {version}");
            self.lines.push(Line::from(self.brush.span(Role::Muted, text)));
        }
    }

    /// First frame, reboots, the address before a move.
    fn history(&mut self, device: &Device) {
        let app = self.app();
        self.blank();
        let first = format_time_of_day(app, device.first_seen);
        self.add("seen", Role::Text, &format!("since {first}"));
        if let Some(at) = device.rebooted_at {
            let at = format_time_of_day(app, at);
            let times = match device.reboots {
                1 => "1 reboot,".to_owned(),
                count => format!("{count} reboots, the last"),
            };
            self.add(" ", Role::Text, &format!("{times} {at}"));
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

/// Returns the title of the details: name, address and UID, of a shared address all UIDs.
pub fn title(app: &App, row: &Row) -> String {
    let name = row.name.as_ref().map_or("?".to_owned(), |it| it.quoted().to_string());
    let Some((device, address)) = app.device_of(row).zip(row.address) else { return name };
    let bus = row.bus.and_then(|bus| app.bus(bus));
    let senders = bus.map_or_else(Vec::new, |bus| bus.senders_at(address));
    let known = match row.board {
        Some(board) => vec![board.sender.uid],
        // Before it is sure that there are several, too.
        None if senders.len() > 1 => senders.iter().map(|sender| sender.uid).collect(),
        None => app.uids_of(device),
    };
    let mut uids: Vec<String> =
        known.iter().map(|uid| devices::uid_text(app, device, *uid)).collect();
    // Sorted: the order of reception changes with each heartbeat.
    uids.sort();
    let side = row.board.map(|board| board.side.to_string()).unwrap_or_default();
    let uids = if uids.is_empty() { String::new() } else { format!(" · {}", uids.join(" and ")) };
    format!("{name} @{address}{side}{uids}")
}
