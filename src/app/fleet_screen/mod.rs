//! The screen of `descan fleet`: all gateways of a broker, their versions and findings, and one gateway
//! with its devices.
//!
//! Inputs: what the connection brings, keys, time. Output: rows of the shown page, texts of the
//! connection, and what is to be done outside ([`FleetScreen::poll_effect`]). A state machine without I/O;
//! nothing is ever sent to a gateway. Counts of a gateway are taken once for each change of it; the rows
//! of the shown page are made once for all changes until the next draw. Does not know how it is drawn.

mod events;
mod facts;
mod keys;
mod regions;
mod rows;
mod scope;

pub use events::{FleetEvent, FleetEventKind, FleetEventLog, MAX_EVENTS};
pub use facts::{
    FleetDevice, FleetProblem, GatewayFacts, GatewayRow, MAX_GATEWAY_VERSIONS, VersionRow,
};
pub use keys::{FLEET_KEYS, FleetPrompt};
pub use regions::FleetRegions;
pub use rows::{FleetRow, FleetRowKey, MAX_FLEET_PROBLEMS};
pub use scope::{FleetFilter, FleetPage, FleetSort};

use crate::app::Signs;
use crate::app::filter::RowKind;
use crate::app::wall_clock::{DAY, WallClock};
use crate::cell_text::wrap;
use crate::fleet::{
    Fleet, FleetGateway, FleetRejects, FleetTopic, GatewayName, GatewayState, TopicPath,
};
use crate::keymap::Keymap;
use crate::text::{counted, shortened};
use crate::time::{Duration, Epoch, Instant};
use jiff::tz::TimeZone;
use regions::HIGH;
use rows::GatewayEntry;
use scope::FleetScope;
use std::collections::{BTreeMap, VecDeque};

/// Time without a kept document after which the broker has sent all.
const QUIET: Duration = Duration::from_secs(2);
/// Time for which a message is shown, unless a key ends it.
const MESSAGE_TIME: Duration = Duration::from_secs(6);
/// Most lines of a banner, on a high screen.
const BANNER_LINES: usize = 2;
/// Most characters of a topic in a banner: its cause has room beside it.
const MAX_BANNER_TOPIC: usize = 48;
/// A deadline that is missed by more was missed as the program was stopped.
const STALL: Duration = Duration::from_secs(1);

/// What the screen is started with.
#[derive(Clone, Debug, Default)]
pub struct FleetScreenOptions {
    /// The address of the broker.
    pub broker: String,
    /// Unix time of [`Instant::ZERO`], in seconds.
    pub unix_start: f64,
    /// Time zone of the wall clock; `None`: UTC.
    pub time_zone: Option<TimeZone>,
    /// The keys.
    pub keymap: Keymap,
    /// Characters for signs.
    pub signs: Signs,
    /// What was wrong with the settings; the first is shown.
    pub warnings: Vec<String>,
}

/// What is to be done outside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FleetEffect {
    /// End the screen.
    Quit,
    /// Stop the program, as Ctrl-Z does.
    Suspend,
    /// Write the whole screen again.
    Redraw,
    /// Put a text into the clipboard.
    Copy(String),
    /// Connect to the broker without waiting longer.
    Reconnect,
    /// Switch to the next theme.
    NextTheme,
}

/// The connection to the broker.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BrokerLink {
    /// The first attempt.
    Connecting,
    /// Connected; documents that the broker kept are still coming.
    Reading,
    /// Connected; all documents are there.
    Connected,
    /// It failed.
    Failed {
        /// Why, and what helps.
        cause: String,
        /// When it was lost, or first failed.
        since: Instant,
        /// When it is tried again.
        retry: Instant,
    },
}

/// Counts of all gateways.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FleetSums {
    /// Gateways that are online, silent, stopped, lost, and without a status.
    pub states: [usize; 5],
    /// Devices of online gateways that are not lost.
    pub present: usize,
    /// Lost devices of online gateways.
    pub lost: usize,
    /// Devices of other gateways, as they were last known.
    pub last_known: usize,
    /// Confirmed problems.
    pub confirmed: usize,
    /// Suspected problems.
    pub suspected: usize,
}

impl FleetSums {
    /// The states, in their order here.
    pub const STATES: [GatewayState; 5] = [
        GatewayState::Online,
        GatewayState::Silent,
        GatewayState::Stopped,
        GatewayState::Lost,
        GatewayState::Unknown,
    ];

    fn add(&mut self, row: &GatewayEntry) {
        let at = Self::STATES.iter().position(|state| *state == row.state).unwrap_or_default();
        self.states[at] += 1;
        if row.state == GatewayState::Online {
            self.present += row.facts.present;
            self.lost += row.facts.lost;
        } else {
            self.last_known += row.facts.present + row.facts.lost;
        }
        self.confirmed += row.facts.confirmed;
        self.suspected += row.facts.suspected;
    }
}

/// What is shown over the pages.
#[derive(Clone, Debug, Default)]
enum FleetOverlay {
    #[default]
    None,
    /// The keys, without the first lines.
    Help(u16),
    Prompt(Box<FleetPrompt>),
}

/// See the module's documentation.
#[derive(Debug)]
pub struct FleetScreen {
    options: FleetScreenOptions,
    fleet: Fleet,
    events: FleetEventLog,
    link: BrokerLink,
    /// Topic filters that the broker refused.
    refused: usize,
    /// When all kept documents are there, unless one comes before.
    complete_at: Option<Instant>,
    /// All documents were there once.
    is_first_reading_over: bool,
    now: Instant,
    size: (u16, u16),
    /// The gateways as they were last looked at.
    entries: BTreeMap<GatewayName, GatewayEntry>,
    sums: FleetSums,
    /// All gateways, and the opened one.
    all: FleetScope,
    opened: Option<(GatewayName, FleetScope)>,
    /// Rows of the shown page, and how many there are without the filter.
    rows: Vec<FleetRow>,
    row_total: usize,
    /// The rows are not those of the fleet.
    is_stale: bool,
    is_dirty: bool,
    overlay: FleetOverlay,
    /// Shown until the next key; true for a warning about the settings.
    message: Option<(String, bool)>,
    /// When it ends without a key; `None` for such a warning.
    message_until: Option<Instant>,
    effects: VecDeque<FleetEffect>,
}

impl FleetScreen {
    /// Returns the screen before the connection.
    pub fn new(options: FleetScreenOptions) -> Self {
        let message = options.warnings.first().map(|warning| (warning.clone(), true));
        Self {
            options,
            fleet: Fleet::default(),
            events: FleetEventLog::default(),
            link: BrokerLink::Connecting,
            refused: 0,
            complete_at: None,
            is_first_reading_over: false,
            now: Instant::ZERO,
            size: (80, 24),
            entries: BTreeMap::new(),
            sums: FleetSums::default(),
            all: FleetScope::default(),
            opened: None,
            rows: Vec::new(),
            row_total: 0,
            is_stale: true,
            is_dirty: true,
            overlay: FleetOverlay::None,
            message,
            message_until: None,
            effects: VecDeque::new(),
        }
    }

    // ---- the connection ------------------------------------------------------------------------

    /// The broker is connected; all documents that it has follow.
    pub fn handle_connected(&mut self, now: Instant) {
        self.set_now(now);
        self.fleet.handle_connected();
        self.link = BrokerLink::Reading;
        self.complete_at = None;
        self.is_dirty = true;
    }

    /// The topics are subscribed; the broker refused so many topic filters.
    pub fn handle_subscribed(&mut self, now: Instant, refused: usize) {
        self.set_now(now);
        self.refused = refused;
        self.complete_at = Some(now + QUIET);
        self.is_dirty = true;
    }

    /// The connection failed, and is tried again after `wait`.
    pub fn handle_failed(&mut self, now: Instant, cause: String, wait: Duration) {
        self.set_now(now);
        let since = match self.link {
            BrokerLink::Failed { since, .. } => since,
            _ => now,
        };
        self.fleet.handle_disconnected(now);
        self.link = BrokerLink::Failed { cause, since, retry: now + wait };
        self.complete_at = None;
        self.set_stale();
    }

    /// Takes a message; `is_kept` if the broker had it from before.
    pub fn handle_message(&mut self, now: Instant, topic: &[u8], payload: &[u8], is_kept: bool) {
        self.set_now(now);
        if is_kept {
            self.complete_at = self.complete_at.map(|_| now + QUIET);
        }
        match FleetTopic::parse(topic) {
            Some(FleetTopic { gateway, path: TopicPath::Event }) if !payload.is_empty() => {
                let is_usable = self.events.handle_event(gateway, payload);
                self.fleet.note_event(topic, is_usable);
            }
            _ => self.fleet.handle_message(now, topic, payload, is_kept),
        }
        self.set_stale();
    }

    // ---- time and size -------------------------------------------------------------------------

    fn set_now(&mut self, now: Instant) {
        self.now = self.now.max(now);
    }

    fn set_stale(&mut self) {
        self.is_stale = true;
        self.is_dirty = true;
    }

    /// Takes the size of the terminal.
    pub fn handle_resize(&mut self, columns: u16, rows: u16) {
        self.size = (columns, rows);
        self.is_dirty = true;
    }

    /// When [`Self::handle_timeout`] is to be called: the next whole second, where ages change; the
    /// moment at which all documents are there. `None` while nothing is known.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let has_ages = !self.entries.is_empty() || matches!(self.link, BrokerLink::Failed { .. });
        let second = Instant::from_micros((self.now.as_micros() / 1_000_000 + 1) * 1_000_000);
        let second = has_ages.then_some(second);
        let message = self.message_until.filter(|_| self.message.is_some());
        [second, self.complete_at, message].into_iter().flatten().min()
    }

    /// The time of [`Self::poll_timeout`] is there.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.set_now(now);
        if self.message_until.is_some_and(|until| until <= now) {
            (self.message, self.message_until) = (None, None);
        }
        if let Some(due) = self.complete_at.filter(|due| *due <= now) {
            // What came meanwhile is not read yet.
            let was_stopped = now.since(due) > STALL;
            self.complete_at = was_stopped.then_some(now + QUIET);
            if !was_stopped {
                self.fleet.handle_complete();
                self.fleet.handle_old_statuses(self.unix_now());
                self.look_at_gateways();
                self.is_first_reading_over = true;
                self.link = BrokerLink::Connected;
            }
        }
        self.set_stale();
    }

    /// Takes the result of a switch of the theme.
    pub fn handle_theme(&mut self, name: Option<&str>) {
        let text = name.map_or("no other theme can be used".to_owned(), |it| format!("theme {it}"));
        self.show(text);
        self.is_dirty = true;
    }

    fn show(&mut self, text: impl Into<String>) {
        self.message = Some((text.into(), false));
        self.message_until = Some(self.now + MESSAGE_TIME);
    }

    // ---- drawing -------------------------------------------------------------------------------

    /// Brings the rows up to date. Called before a draw.
    pub fn prepare(&mut self) {
        if self.is_stale {
            self.refresh();
        }
        self.is_dirty = false;
    }

    /// Returns true if the screen is out of date.
    pub fn is_dirty(&self) -> bool {
        self.is_dirty
    }

    /// What is to be done outside.
    pub fn poll_effect(&mut self) -> Option<FleetEffect> {
        self.effects.pop_front()
    }

    /// Regions of the screen.
    pub fn regions(&self) -> FleetRegions {
        let (columns, rows) = self.size;
        let banners = self.banners().len() as u16;
        FleetRegions::new(columns, rows, banners, self.scope().has_details_alone)
    }

    /// The settings.
    pub fn options(&self) -> &FleetScreenOptions {
        &self.options
    }

    /// The present.
    pub fn now(&self) -> Instant {
        self.now
    }

    /// The connection.
    pub fn link(&self) -> &BrokerLink {
        &self.link
    }

    /// Returns true if what is shown may have changed since: the connection was lost.
    pub fn is_old(&self) -> bool {
        matches!(self.link, BrokerLink::Failed { .. }) && !self.is_unread()
    }

    /// Returns true before anything was read.
    pub fn is_unread(&self) -> bool {
        !self.is_first_reading_over && self.entries.is_empty()
    }

    /// Counts of all gateways.
    pub fn sums(&self) -> &FleetSums {
        &self.sums
    }

    /// What was not used.
    pub fn rejects(&self) -> &FleetRejects {
        self.fleet.rejects()
    }

    /// The last events.
    pub fn events(&self) -> &FleetEventLog {
        &self.events
    }

    /// The opened gateway; `None` while all are shown.
    pub fn opened(&self) -> Option<&GatewayName> {
        self.opened.as_ref().map(|(name, _)| name)
    }

    /// What is known of a gateway.
    pub fn gateway(&self, name: &GatewayName) -> Option<&FleetGateway> {
        self.fleet.gateway(name)
    }

    /// Counts and texts of a gateway, as a row.
    pub fn gateway_row(&self, name: &GatewayName) -> Option<GatewayRow> {
        self.entries.get(name).map(|entry| entry.row(name))
    }

    fn unix_now(&self) -> f64 {
        self.options.unix_start + self.now.as_micros() as f64 / 1e6
    }

    /// How long a gateway has been in its state, by its clock where that is online or was stopped; true
    /// if it may be longer.
    pub fn state_age(&self, row: &GatewayRow) -> Option<(Duration, bool)> {
        let unix_now = self.unix_now();
        let since_unix =
            |at: f64| Duration::try_from_secs_f64((unix_now - at).max(0.0)).unwrap_or_default();
        let since_received = self.now.since(row.received);
        match row.state {
            GatewayState::Online if row.facts.started > 0.0 => {
                Some((since_unix(row.facts.started), false))
            }
            GatewayState::Stopped => match row.facts.status_time {
                Some(at) => Some((since_unix(at), false)),
                None => Some((since_received, true)),
            },
            GatewayState::Lost => Some((since_received, row.is_received_late)),
            GatewayState::Silent => {
                let status = row.facts.status_time.filter(|_| row.is_received_late);
                let age = status.map_or(since_received, |at| since_unix(at).max(since_received));
                Some((age, false))
            }
            GatewayState::Online | GatewayState::Unknown => None,
        }
    }

    /// A moment on the wall clock, given in Unix seconds: `12:03:11`; `–` before 1970 and after 2100.
    pub fn wall_clock(&self, unix: f64) -> String {
        if !(1.0..4.2e9).contains(&unix) {
            return "–".to_owned();
        }
        let zone = self.options.time_zone.clone().unwrap_or(TimeZone::UTC);
        let clock = WallClock::new(Epoch::default(), zone);
        let local = clock.local(Instant::from_micros((unix * 1e6) as u64));
        let seconds = local.rem_euclid(DAY) / 1_000_000;
        format!("{:02}:{:02}:{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60)
    }

    /// A moment of the program on the wall clock.
    pub fn wall_clock_at(&self, at: Instant) -> String {
        self.wall_clock(self.options.unix_start + at.as_micros() as f64 / 1e6)
    }

    /// What is wrong with the connection and the documents, on one line each, or two of a high screen; true
    /// for an error.
    pub fn banners(&self) -> Vec<(String, bool)> {
        const SIGN: &str = " ! ";
        let most = if self.size.1 < HIGH { 1 } else { BANNER_LINES };
        let width = usize::from(self.size.0).saturating_sub(SIGN.len());
        let mut lines = Vec::new();
        for (text, is_error) in self.banner_texts() {
            let mut parts = wrap(&text, width);
            if parts.len() > most {
                parts.truncate(most);
                parts[most - 1].push('…');
            }
            for (at, part) in parts.into_iter().enumerate() {
                let begin = if at == 0 { SIGN } else { "   " };
                lines.push((format!("{begin}{part}"), is_error));
            }
        }
        lines
    }

    fn banner_texts(&self) -> Vec<(String, bool)> {
        let mut lines = Vec::new();
        if let BrokerLink::Failed { cause, retry, .. } = &self.link {
            let wait = match retry.since(self.now).as_secs_f64().ceil() {
                0.0 => "now".to_owned(),
                seconds => format!("in {seconds} s"),
            };
            // The address is in the line above.
            let cause = cause.strip_prefix(&format!("{}: ", self.options.broker)).unwrap_or(cause);
            let (what, remedy) = cause.split_once("; ").unwrap_or((cause, ""));
            let text = format!("{what}; next attempt {wait}; {remedy}");
            lines.push((text.trim_end_matches("; ").to_owned(), true));
        }
        if self.refused > 0 {
            let filters = counted(self.refused as u64, "topic filter");
            let broker = &self.options.broker;
            lines.push((format!("{broker}: no right to read {filters} of descan/v1/#"), true));
        }
        let opened = self.opened().and_then(|name| self.entries.get(name));
        if let Some(error) = opened.and_then(|entry| entry.facts.file_errors.first()) {
            lines.push((format!("not used there: {error}"), true));
        }
        let rejects = self.fleet.rejects();
        if let Some((topic, cause)) = rejects.last_parts() {
            let documents = counted(rejects.open_count(), "document");
            let topic = shortened(topic, MAX_BANNER_TOPIC);
            lines.push((format!("{documents} not used; the last is {topic}: {cause}"), false));
        }
        lines
    }

    /// The open page.
    pub fn page(&self) -> FleetPage {
        self.scope().page
    }

    /// What the rows of a page are.
    pub fn row_kind(&self, page: FleetPage) -> RowKind {
        page.row_kind(self.opened.is_some())
    }

    /// Number of confirmed findings of the shown gateways.
    pub fn confirmed_shown(&self) -> usize {
        match self.opened() {
            Some(name) => self.entries.get(name).map_or(0, |entry| entry.facts.confirmed),
            None => self.sums.confirmed,
        }
    }

    /// Rows of the page.
    pub fn rows(&self) -> &[FleetRow] {
        &self.rows
    }

    /// Number of rows without the filter.
    pub fn row_total(&self) -> usize {
        self.row_total
    }

    /// Place of the selected row.
    pub fn selected(&self) -> Option<usize> {
        (!self.rows.is_empty()).then(|| self.scope().list().at.min(self.rows.len() - 1))
    }

    /// The selected row.
    pub fn selected_row(&self) -> Option<&FleetRow> {
        self.rows.get(self.selected()?)
    }

    /// The first row on the screen.
    pub fn top(&self) -> usize {
        let height = usize::from(self.regions().list.height);
        self.scope().list().top(self.rows.len(), height)
    }

    /// The filter of the page.
    pub fn filter(&self) -> &FleetFilter {
        &self.scope().list().filter
    }

    /// Order of the rows, and whether it is reversed.
    pub fn sort(&self) -> (FleetSort, bool) {
        let list = self.scope().list();
        (list.sort, list.is_reversed)
    }

    /// The prompt of the filter, while it is open.
    pub fn prompt(&self) -> Option<&FleetPrompt> {
        match &self.overlay {
            FleetOverlay::Prompt(prompt) => Some(prompt),
            _ => None,
        }
    }

    /// Lines by which the help is scrolled; `None` while it is closed.
    pub fn help(&self) -> Option<u16> {
        match self.overlay {
            FleetOverlay::Help(scroll) => Some(scroll),
            _ => None,
        }
    }

    /// Lines by which the details in place of the list are scrolled; `None` while they are not.
    pub fn details_alone(&self) -> Option<u16> {
        let scope = self.scope();
        scope.has_details_alone.then_some(scope.details_scroll)
    }

    /// The message, and whether it is an error.
    pub fn message(&self) -> Option<(&str, bool)> {
        self.message.as_ref().map(|(text, is_error)| (text.as_str(), *is_error))
    }

    /// The command that opens a shell on a gateway; `None` where its name is not one of a machine.
    pub fn shell_command(name: &GatewayName) -> Option<String> {
        (!name.as_str().starts_with(['-', '.'])).then(|| format!("ssh {name}"))
    }

    /// The command that shows a bus of a gateway live, from a socketcand that runs there; `None` for a bus
    /// that is not a CAN interface.
    pub fn live_command(name: &GatewayName, bus: &str) -> Option<String> {
        let interface = crate::text::without_bit_rates(bus);
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
        let is_interface = !interface.is_empty() && interface.chars().all(is_plain);
        let is_host = Self::shell_command(name).is_some();
        (is_interface && is_host && !interface.starts_with('-'))
            .then(|| format!("descan socketcand://{name}:29536/{interface}"))
    }

    fn scope(&self) -> &FleetScope {
        self.opened.as_ref().map_or(&self.all, |(_, scope)| scope)
    }

    fn scope_mut(&mut self) -> &mut FleetScope {
        self.opened.as_mut().map_or(&mut self.all, |(_, scope)| scope)
    }
}
