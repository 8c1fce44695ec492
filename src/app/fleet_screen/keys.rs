//! What keys and the mouse do on the screen of a fleet.
//!
//! Input: a key, pasted text or a mouse event. Output: changes of the screen, and what is to be done
//! outside. Does not know how the screen is drawn.

use super::scope::FleetScope;
use super::{BrokerLink, FleetEffect, FleetOverlay, FleetPage, FleetRow, FleetScreen};
use crate::app::filter::{Completion, CompletionSource};
use crate::app::input::line_request;
use crate::app::{Mouse, MouseKind};
use crate::fleet::GatewayName;
use crate::keymap::{Action, Key, KeyCode, KeyMode};
use crate::text::is_printable;
use crate::time::Instant;
use crate::wire::id::Address;
use ratatui::layout::Position;
use std::collections::BTreeSet;
use tui_input::{Input as LineInput, InputRequest};

/// Rows of a turn of the wheel.
const WHEEL_ROWS: isize = 3;
/// Longest filter, in bytes.
const MAX_FILTER: usize = 1000;
/// Number of names, services and UIDs each that complete a filter at most.
const MAX_WORDS: usize = 2000;

/// Actions whose keys the screen has, in the order of its help, each with what it does here; an empty text
/// stands for that of the action.
pub const FLEET_KEYS: &[(Action, &str)] = &[
    (Action::Up, ""),
    (Action::Down, ""),
    (Action::PageUp, ""),
    (Action::PageDown, ""),
    (Action::First, ""),
    (Action::Last, "Last row"),
    (Action::Details, "Open the gateway; gateways with the version; details"),
    (Action::Into, "Details in place of the list; the gateway of a problem"),
    (Action::Back, "Back to all gateways"),
    (Action::NextPage, ""),
    (Action::PreviousPage, ""),
    (Action::Devices, "Page 1: gateways, or devices of the gateway"),
    (Action::Traffic, "Page 2: versions in use"),
    (Action::Timeline, "Page 3: problems"),
    (Action::Filter, ""),
    (Action::FilterToggle, ""),
    (Action::Sort, "Next order of the rows"),
    (Action::SortReverse, ""),
    (Action::Copy, "Copy the command that goes there: ssh, live view"),
    (Action::Rescan, "Connect to the broker at once, without the wait"),
    (Action::Cancel, "Close details, filter off, leave the gateway"),
    (Action::Help, "These keys"),
    (Action::Theme, "Next theme"),
    (Action::Redraw, ""),
    (Action::Suspend, ""),
    (Action::Quit, "Quit"),
    (Action::QuitNow, ""),
];

/// The prompt of the filter.
#[derive(Clone, Debug, Default)]
pub struct FleetPrompt {
    /// Text and cursor.
    pub input: LineInput,
    /// The mistake in it, and its column from 1.
    pub error: Option<(String, usize)>,
    /// The filter before, for Esc, and whether it was on.
    before: (String, bool),
    /// Candidates that Tab goes through, and the one in the line.
    cycle: Option<(Completion, usize)>,
}

impl FleetScreen {
    /// Takes a key.
    pub fn handle_key(&mut self, now: Instant, key: Key) {
        self.set_now(now);
        self.is_dirty = true;
        self.message = None;
        let global = self.options.keymap.lookup(KeyMode::Browse, key);
        match &mut self.overlay {
            _ if global.is_some_and(Action::is_global) => self.run(global, key),
            FleetOverlay::Prompt(_) => self.type_filter(key),
            FleetOverlay::Help(_) => self.help_key(key),
            FleetOverlay::None => self.run(global, key),
        }
        if self.is_stale {
            self.refresh();
        }
    }

    /// Takes pasted text, for the open prompt.
    pub fn handle_paste(&mut self, now: Instant, text: &str) {
        self.set_now(now);
        self.is_dirty = true;
        if let FleetOverlay::Prompt(prompt) = &mut self.overlay {
            let line = text.trim().lines().next().unwrap_or_default();
            for c in line.chars().filter(|&c| is_printable(c)) {
                prompt.insert(InputRequest::InsertChar(c));
            }
            self.use_typed_filter();
        }
    }

    /// Takes a mouse event: a press selects a row or a page, the wheel moves.
    pub fn handle_mouse(&mut self, now: Instant, mouse: Mouse) {
        self.set_now(now);
        // What is typed stays where it is.
        if matches!(mouse.kind, MouseKind::Drag) || self.prompt().is_some() {
            return;
        }
        self.is_dirty = true;
        match mouse.kind {
            MouseKind::WheelUp => self.move_by(-WHEEL_ROWS),
            MouseKind::WheelDown => self.move_by(WHEEL_ROWS),
            MouseKind::Press | MouseKind::Drag => self.press(mouse),
        }
        if self.is_stale {
            self.refresh();
        }
    }

    fn press(&mut self, mouse: Mouse) {
        let regions = self.regions();
        let at = Position::new(mouse.column, mouse.row);
        if self.help().is_some() {
            self.overlay = FleetOverlay::None;
        } else if regions.list.contains(at) {
            let row = self.top() + usize::from(mouse.row - regions.list.y);
            if row < self.rows.len() {
                self.select(row);
            }
        } else if regions.tabs.contains(at)
            && let Some((page, ..)) = self.tabs().into_iter().find(|(_, start, text)| {
                (*start..start + text.len() as u16).contains(&mouse.column)
            })
        {
            self.go_to_page(page);
        }
    }

    /// The names of the pages on the rule: page, first column, text.
    pub fn tabs(&self) -> Vec<(FleetPage, u16, String)> {
        let is_narrow = self.size.0 < 60;
        let mut start = 1;
        let tab = |(number, page): (usize, FleetPage)| {
            let title = page.title(self.opened.is_some());
            let text = match page {
                _ if is_narrow && page != self.page() => format!("{} ", number + 1),
                FleetPage::Problems if self.confirmed_shown() > 0 => {
                    format!("{} {title} {}  ", number + 1, self.confirmed_shown())
                }
                _ => format!("{} {title}  ", number + 1),
            };
            let at = start;
            start += text.len() as u16;
            (page, at, text)
        };
        FleetPage::ALL.into_iter().enumerate().map(tab).collect()
    }

    fn run(&mut self, action: Option<Action>, key: Key) {
        use Action as A;
        let page = isize::from(self.regions().list.height.cast_signed()).max(2) - 1;
        match action {
            Some(A::Up) => self.move_by(-1),
            Some(A::Down) => self.move_by(1),
            Some(A::PageUp) => self.move_by(-page),
            Some(A::PageDown) => self.move_by(page),
            Some(A::First) => self.move_by(isize::MIN),
            Some(A::Last) => self.move_by(isize::MAX),
            Some(A::Details) => self.open(),
            Some(A::Into) => self.go_into(),
            Some(A::Back | A::Return) => {
                self.close();
            }
            Some(A::Cancel) => self.cancel(),
            Some(A::NextPage) => self.turn_page(1),
            Some(A::PreviousPage) => self.turn_page(-1),
            Some(A::Devices) => self.go_to_page(FleetPage::Main),
            Some(A::Traffic) => self.go_to_page(FleetPage::Versions),
            Some(A::Timeline) => self.go_to_page(FleetPage::Problems),
            Some(A::Filter) => self.ask_filter(),
            Some(A::FilterToggle) => self.toggle_filter(),
            Some(A::Sort) => self.next_sort(),
            Some(A::SortReverse) => self.reverse(),
            Some(A::Copy) => self.copy(),
            Some(A::Rescan) => self.reconnect(),
            Some(A::Help) => self.overlay = FleetOverlay::Help(0),
            Some(A::Theme) => self.effects.push_back(FleetEffect::NextTheme),
            Some(A::Redraw) => self.effects.push_back(FleetEffect::Redraw),
            Some(A::Suspend) => self.effects.push_back(FleetEffect::Suspend),
            Some(A::Quit | A::QuitNow) => self.effects.push_back(FleetEffect::Quit),
            _ => {
                self.show(format!("{key} has no use here; ? lists the keys"));
            }
        }
    }

    // ---- the selection -------------------------------------------------------------------------

    fn move_by(&mut self, by: isize) {
        if let FleetOverlay::Help(scroll) = &mut self.overlay {
            return *scroll = scrolled(*scroll, by);
        }
        if self.scope().has_details_alone {
            let scope = self.scope_mut();
            scope.details_scroll = scrolled(scope.details_scroll, by);
            return;
        }
        let at = self.scope().list().at.saturating_add_signed(by);
        self.select(at.min(self.rows.len().saturating_sub(1)));
    }

    fn select(&mut self, at: usize) {
        let key = self.rows.get(at).map(FleetRow::key);
        let (count, height) = (self.rows.len(), usize::from(self.regions().list.height));
        let list = self.scope_mut().list_mut();
        (list.at, list.key) = (at, key);
        list.first = list.top(count, height);
    }

    /// Takes how far the help or the details could be scrolled.
    pub fn handle_drawn(&mut self, scrolled: Option<u16>) {
        let Some(scrolled) = scrolled else { return };
        match &mut self.overlay {
            FleetOverlay::Help(scroll) => *scroll = scrolled,
            _ => self.scope_mut().details_scroll = scrolled,
        }
    }

    // ---- pages ---------------------------------------------------------------------------------

    fn go_to_page(&mut self, page: FleetPage) {
        let scope = self.scope_mut();
        (scope.page, scope.has_details_alone) = (page, false);
        self.set_stale();
    }

    fn turn_page(&mut self, by: isize) {
        let at = (self.page() as usize).cast_signed() + by;
        let count = FleetPage::ALL.len().cast_signed();
        self.go_to_page(FleetPage::ALL[at.rem_euclid(count).cast_unsigned()]);
    }

    /// Enter: opens the selected gateway, shows the gateways with the version, or the details alone.
    fn open(&mut self) {
        match self.selected_row().cloned() {
            None => self.show("no row is selected"),
            Some(FleetRow::Gateway(row)) => self.open_gateway(row.name),
            Some(FleetRow::Version(row)) => self.show_version(&row.service, &row.version),
            Some(FleetRow::Problem(_) | FleetRow::Device(_)) => self.toggle_details(),
        }
    }

    /// Shows the details in place of the list, or the list again.
    fn toggle_details(&mut self) {
        let scope = self.scope_mut();
        scope.has_details_alone = !scope.has_details_alone;
        scope.details_scroll = 0;
    }

    fn open_gateway(&mut self, name: GatewayName) {
        self.opened = Some((name, FleetScope::default()));
        self.set_stale();
    }

    /// Right: shows the details, which may be longer than their place below the list; of a finding it opens
    /// the gateway, with the finding selected.
    fn go_into(&mut self) {
        match self.selected_row().cloned() {
            Some(FleetRow::Problem(problem)) if self.opened.is_none() => {
                self.open_gateway(problem.gateway.clone());
                let scope = self.scope_mut();
                scope.page = FleetPage::Problems;
                scope.list_mut().key = Some(FleetRow::Problem(problem).key());
            }
            None => self.show("no row is selected"),
            Some(_) => self.toggle_details(),
        }
    }

    /// Shows the gateways, or the devices of the opened one, that have a version of a service.
    fn show_version(&mut self, service: &str, version: &str) {
        let value = if version.is_empty() {
            format!("={service}")
        } else {
            format!("={service}@{version}")
        };
        let line = format!("srv:\"{}\"", value.replace('"', ""));
        let rows = self.row_kind(FleetPage::Main);
        let list = self.scope_mut().list_of_mut(FleetPage::Main);
        if let Err(error) = list.filter.set(&line, rows) {
            return self.show(error.to_string());
        }
        self.go_to_page(FleetPage::Main);
    }

    /// Closes the details or the opened gateway; returns false if none is open.
    fn close(&mut self) -> bool {
        let scope = self.scope_mut();
        if scope.has_details_alone {
            scope.has_details_alone = false;
        } else if self.opened.take().is_none() {
            return false;
        }
        self.set_stale();
        true
    }

    /// Esc: closes the details, else switches the filter off, else leaves the gateway.
    fn cancel(&mut self) {
        if self.filter().is_on && self.row_total > 0 && !self.scope().has_details_alone {
            self.toggle_filter();
        } else {
            self.close();
        }
    }

    // ---- orders --------------------------------------------------------------------------------

    fn next_sort(&mut self) {
        let (page, sorts) = (self.page(), self.page().sorts(self.opened.is_some()));
        let list = self.scope_mut().list_mut();
        let at = sorts.iter().position(|sort| *sort == list.sort).unwrap_or_default();
        list.sort = sorts[(at + 1) % sorts.len()];
        list.is_reversed = false;
        let words = list.sort.words(page);
        self.show(format!("sorted {words}"));
        self.set_stale();
    }

    fn reverse(&mut self) {
        let page = self.page();
        let list = self.scope_mut().list_mut();
        list.is_reversed = !list.is_reversed;
        let words = list.sort.words(page);
        let order = if list.is_reversed { ", reversed" } else { "" };
        self.show(format!("sorted {words}{order}"));
        self.set_stale();
    }

    // ---- the command of a row ------------------------------------------------------------------

    /// The command that leads to the selected row: a shell on the gateway; of a device the live view of
    /// its bus.
    pub fn command_of_row(&self) -> Option<String> {
        match self.selected_row()? {
            FleetRow::Gateway(row) => Self::shell_command(&row.name),
            FleetRow::Problem(problem) => Self::live_command(&problem.gateway, &problem.bus)
                .or_else(|| Self::shell_command(&problem.gateway)),
            FleetRow::Device(row) => {
                let name = self.opened()?;
                Self::live_command(name, &row.device.bus).or_else(|| Self::shell_command(name))
            }
            FleetRow::Version(_) => None,
        }
    }

    fn copy(&mut self) {
        match self.command_of_row() {
            Some(command) => {
                self.show(format!("copied: {command}"));
                self.effects.push_back(FleetEffect::Copy(command));
            }
            None => self.show("no command for this row"),
        }
    }

    // ---- the connection ------------------------------------------------------------------------

    fn reconnect(&mut self) {
        match &mut self.link {
            BrokerLink::Failed { retry, .. } => {
                *retry = self.now;
                self.effects.push_back(FleetEffect::Reconnect);
            }
            BrokerLink::Connecting => self.show("connecting already"),
            BrokerLink::Reading | BrokerLink::Connected => self.show("connected already"),
        }
    }

    // ---- the help ------------------------------------------------------------------------------

    fn help_key(&mut self, key: Key) {
        let page = isize::from(self.size.1.cast_signed()).max(6) - 5;
        match self.options.keymap.lookup(KeyMode::Help, key) {
            Some(Action::HelpUp) => self.move_by(-1),
            Some(Action::HelpDown) => self.move_by(1),
            Some(Action::HelpPageUp) => self.move_by(-page),
            Some(Action::HelpPageDown) => self.move_by(page),
            Some(Action::HelpFirst) => self.move_by(isize::MIN),
            Some(Action::HelpLast) => self.move_by(isize::MAX),
            Some(Action::HelpClose) => self.overlay = FleetOverlay::None,
            _ => {}
        }
    }

    // ---- the filter ----------------------------------------------------------------------------

    fn ask_filter(&mut self) {
        let (text, is_on) = (self.filter().text.clone(), self.filter().is_on);
        self.scope_mut().has_details_alone = false;
        // One that is switched off is not typed on.
        let input = LineInput::new(if is_on { text.clone() } else { String::new() });
        let prompt = FleetPrompt { input, before: (text, is_on), ..Default::default() };
        self.overlay = FleetOverlay::Prompt(Box::new(prompt));
        self.use_typed_filter();
    }

    fn toggle_filter(&mut self) {
        let filter = &mut self.scope_mut().list_mut().filter;
        let text = match filter.toggle() {
            false => "no filter; / sets one".to_owned(),
            true if filter.is_on => format!("filter on: {}", filter.text),
            true => format!("filter off: {}", filter.text),
        };
        self.show(text);
        self.set_stale();
    }

    fn type_filter(&mut self, key: Key) {
        let source = (key.code == KeyCode::Tab).then(|| self.completion_source());
        let rows = self.row_kind(self.page());
        let FleetOverlay::Prompt(prompt) = &mut self.overlay else { return };
        match key.code {
            KeyCode::Enter => {
                // A mistake is shown with the prompt.
                if prompt.error.is_none() {
                    self.overlay = FleetOverlay::None;
                }
                return;
            }
            KeyCode::Esc => {
                let (before, was_on) = prompt.before.clone();
                self.overlay = FleetOverlay::None;
                let filter = &mut self.scope_mut().list_mut().filter;
                // It was valid before.
                let _ = filter.set(&before, rows);
                if filter.is_on && !was_on {
                    filter.toggle();
                }
                return self.set_stale();
            }
            KeyCode::Tab => prompt.complete(source.as_ref(), rows),
            _ => {
                prompt.cycle = None;
                match line_request(key) {
                    Some(request) => prompt.insert(request),
                    None => return,
                }
            }
        }
        self.use_typed_filter();
    }

    /// Uses the line of the prompt as far as it has no mistake.
    fn use_typed_filter(&mut self) {
        let rows = self.row_kind(self.page());
        let FleetOverlay::Prompt(prompt) = &mut self.overlay else { return };
        let text = prompt.input.value().trim().to_owned();
        let scope = self.opened.as_mut().map_or(&mut self.all, |(_, scope)| scope);
        let result = scope.list_mut().filter.set(&text, rows);
        prompt.error = result.err().map(|error| (error.to_string(), error.column(&text)));
        self.set_stale();
    }

    /// Words that complete a filter.
    fn completion_source(&self) -> CompletionSource {
        let mut names = BTreeSet::new();
        let mut services = BTreeSet::new();
        let mut uids = BTreeSet::new();
        let mut buses = BTreeSet::new();
        let mut addresses = BTreeSet::new();
        let opened = self.opened();
        let shown = self.entries.iter().filter(|(name, _)| opened.is_none_or(|it| it == *name));
        for (_, entry) in shown {
            let facts = &entry.facts;
            add_some(&mut names, facts.names.iter().cloned());
            add_some(&mut uids, facts.uids.iter().cloned());
            add_some(&mut buses, facts.buses.iter().map(|bus| bus.name.clone()));
            let with_version = |(name, version, _): (&str, &str, usize)| match version {
                "" => name.to_owned(),
                version => format!("{name}@{version}"),
            };
            add_some(&mut services, facts.services().map(with_version));
            addresses.extend(facts.addresses().map(Address::number));
        }
        CompletionSource {
            names: names.into_iter().collect(),
            services: services.into_iter().collect(),
            uids: uids.into_iter().collect(),
            buses: buses.into_iter().collect(),
            addresses: addresses.into_iter().collect(),
        }
    }
}

/// Adds texts up to [`MAX_WORDS`].
fn add_some(all: &mut BTreeSet<String>, texts: impl Iterator<Item = String>) {
    let room = MAX_WORDS.saturating_sub(all.len());
    all.extend(texts.take(room));
}

fn scrolled(scroll: u16, by: isize) -> u16 {
    let at = usize::from(scroll).saturating_add_signed(by);
    u16::try_from(at).unwrap_or(u16::MAX)
}

impl FleetPrompt {
    fn insert(&mut self, request: InputRequest) {
        let grows = matches!(request, InputRequest::InsertChar(_));
        if !grows || self.input.value().len() < MAX_FILTER {
            self.input.handle(request);
        }
    }

    /// Puts the first candidate, or the next one, into the line.
    fn complete(&mut self, source: Option<&CompletionSource>, rows: crate::app::RowKind) {
        let Some(source) = source else { return };
        let text = self.input.value().to_owned();
        let cursor = self.input.cursor();
        let end = text.char_indices().nth(cursor).map_or(text.len(), |(at, _)| at);
        let (completion, next) = match self.cycle.take() {
            Some((completion, at)) => {
                let count = completion.candidates.len().max(1);
                (completion, (at + 1) % count)
            }
            None => (Completion::of(&text[..end], rows, source), 0),
        };
        let Some(candidate) = completion.candidates.get(next) else { return };
        let head = format!("{}{candidate}", &text[..completion.range.start.min(end)]);
        let at = head.chars().count();
        self.input = LineInput::new(format!("{head}{}", &text[end..])).with_cursor(at);
        if completion.candidates.len() > 1 {
            self.cycle = Some((completion, next));
        }
    }
}
