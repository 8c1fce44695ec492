//! The commands that only look: pages, rows, details, freezing, the mouse.

use super::capture::{IdentifierKey, IdentifierStats};
use super::page::{Focus, Frozen, Page};
use super::prompt::PromptKind;
use super::{App, Decoded, Effect, Filter, Overlay, Problem, Row, RowKey, tabs};
use crate::frame::BusIndex;
use crate::status::PlaybackCommand;
use crate::text::Name;
use crate::time::Instant;
use crate::wire::id::Address;
use ratatui::layout::{Position, Rect};

/// What the mouse did, and where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mouse {
    /// What.
    pub kind: MouseKind,
    /// From 0.
    pub column: u16,
    /// From 0.
    pub row: u16,
}

/// What the mouse did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MouseKind {
    /// The first button was pressed.
    Press,
    /// The wheel was turned, up.
    WheelUp,
    /// The wheel was turned, down.
    WheelDown,
}

impl Mouse {
    fn is_in(self, area: Rect) -> bool {
        area.contains(Position::new(self.column, self.row))
    }
}

/// How many rows a notch of the wheel is.
const NOTCH: isize = 3;

impl App {
    /// Takes what the mouse did.
    pub fn handle_mouse(&mut self, now: Instant, mouse: Mouse) {
        self.now = self.now.max(now);
        let delta = match mouse.kind {
            MouseKind::Press => return self.press(mouse),
            MouseKind::WheelUp => -NOTCH,
            MouseKind::WheelDown => NOTCH,
        };
        self.dirty = true;
        match self.overlay {
            Overlay::None if mouse.is_in(self.screen().details) => self.scroll_details(delta),
            Overlay::None => self.move_list(delta),
            Overlay::Help(_) => self.scroll_help(delta as i16),
            _ => {}
        }
    }

    fn press(&mut self, mouse: Mouse) {
        if !matches!(self.overlay, Overlay::None) {
            return;
        }
        self.dirty = true;
        let screen = self.screen();
        if mouse.row == screen.tabs.y && screen.tabs.height > 0 {
            let tabs = tabs(screen.whole.width, self.view.page, self.counts);
            let hit = tabs.into_iter().find(|(_, start, text)| {
                (*start..start + text.chars().count() as u16).contains(&mouse.column)
            });
            if let Some((page, ..)) = hit {
                self.show_page(page);
            }
        } else if mouse.is_in(screen.list) {
            self.view.focus = Focus::List;
            self.click_row(usize::from(mouse.row - screen.list.y));
        } else if mouse.is_in(screen.details) {
            self.view.focus = Focus::Details;
        } else if mouse.is_in(screen.latest) {
            self.show_page(Page::Timeline);
        }
    }

    fn click_row(&mut self, line: usize) {
        let height = self.screen().list_rows();
        self.view.details_scroll = 0;
        match self.view.page {
            Page::Devices => {
                let keys = self.row_keys();
                self.view.devices.click(&keys, line, height);
            }
            Page::Problems => {
                let keys = self.problem_keys();
                self.view.problems.click(&keys, line, height);
            }
            Page::Timeline => {
                let keys = self.lines_shown();
                self.hold_timeline(&keys, height);
                self.view.timeline.click(&keys, line, height);
            }
            Page::Traffic if self.evidence_alone().is_some() => self.click_evidence(line),
            Page::Traffic if self.view.shows_identifiers() => {
                let keys = self.identifier_keys();
                self.view.identifiers.click(&keys, line, height);
            }
            Page::Traffic => {
                let (shown, _) = self.frames_shown(height);
                if let Some(&number) = shown.get(line) {
                    (self.view.traffic, self.view.traffic_line) = (Some(number), line);
                }
            }
        }
    }

    /// Command: stops a log, lets it go on, or changes its pace.
    pub(super) fn control_playback(&mut self, command: PlaybackCommand) {
        if self.playback.is_some() {
            self.effects.push_back(Effect::Playback(command));
        } else {
            self.show_error("only a log can be paused");
        }
    }

    /// Command: up or down by rows.
    pub(super) fn move_by(&mut self, delta: isize) {
        if self.view.focus == Focus::Details && self.screen().details.height > 0 {
            self.scroll_details(delta);
        } else {
            self.move_list(delta);
        }
    }

    /// Command: up or down by screenfuls.
    pub(super) fn move_pages(&mut self, pages: isize) {
        let screen = self.screen();
        let height = screen.list_rows().max(usize::from(screen.details.height));
        self.move_by(pages * height.saturating_sub(1).max(1).cast_signed());
    }

    /// Command: to the first or to the last row.
    pub(super) fn move_to_end(&mut self, last: bool) {
        let by_rows = self.evidence_alone().is_some() || self.view.shows_identifiers();
        if last && self.view.focus == Focus::List {
            match self.view.page {
                Page::Timeline => return self.view.timeline.release(),
                Page::Traffic if !by_rows => {
                    self.view.traffic = None;
                    return;
                }
                _ => {}
            }
        }
        if !last && self.view.page == Page::Traffic && !by_rows {
            let first = self.frames_from(0).next();
            self.view.traffic = first;
            self.view.traffic_line = 0;
            return;
        }
        self.move_by(if last { isize::MAX / 2 } else { isize::MIN / 2 });
    }

    fn scroll_details(&mut self, delta: isize) {
        let scroll = usize::from(self.view.details_scroll).saturating_add_signed(delta);
        // Where the text ends is only known when it is drawn, and told back then.
        self.view.details_scroll = u16::try_from(scroll).unwrap_or(u16::MAX);
    }

    /// Takes how far the text that scrolls was scrolled as it was drawn: not past its end.
    pub fn handle_drawn(&mut self, scrolled: Option<u16>) {
        let Some(scrolled) = scrolled else { return };
        match &mut self.overlay {
            Overlay::Help(at) => *at = scrolled,
            _ => self.view.details_scroll = scrolled,
        }
    }

    fn move_list(&mut self, delta: isize) {
        let height = self.screen().list_rows();
        self.view.details_scroll = 0;
        match self.view.page {
            Page::Devices => {
                let keys = self.row_keys();
                self.view.devices.move_by(&keys, delta, height);
            }
            Page::Problems => {
                let keys = self.problem_keys();
                self.view.problems.move_by(&keys, delta, height);
            }
            Page::Timeline => {
                let keys = self.lines_shown();
                self.hold_timeline(&keys, height);
                self.view.timeline.move_by(&keys, delta, height);
                if delta > 0 && self.view.timeline.selected() == keys.last() {
                    self.view.timeline.release();
                }
            }
            Page::Traffic if self.evidence_alone().is_some() => self.move_in_evidence(delta),
            Page::Traffic if self.view.shows_identifiers() => {
                let keys = self.identifier_keys();
                self.view.identifiers.settle(&keys, height);
                self.view.identifiers.move_by(&keys, delta, height);
            }
            Page::Traffic => self.move_in_traffic(delta, height),
        }
    }

    /// The timeline follows until something is selected: that begins at its newest line.
    fn hold_timeline(&mut self, keys: &[u64], height: usize) {
        if self.view.timeline.selected().is_none() {
            self.view.timeline.move_to(keys, keys.len(), height);
            let line = keys.len().min(height).saturating_sub(1);
            self.view.timeline.click(keys, line, height);
        }
    }

    fn move_in_traffic(&mut self, delta: isize, height: usize) {
        let bottom = height.saturating_sub(1);
        let (shown, selected) = self.frames_shown(height);
        let (from, line) = match selected {
            Some(selected) => {
                (selected, shown.iter().position(|&number| number == selected).unwrap_or(0))
            }
            None => match shown.last() {
                Some(&newest) => (newest, shown.len() - 1),
                None => return,
            },
        };
        let steps = delta.unsigned_abs();
        let to = if delta > 0 {
            self.frames_from(from + 1).take(steps).last()
        } else {
            self.frames_before(from).take(steps).last()
        };
        let Some(to) = to else {
            self.view.traffic = (delta < 0).then_some(from);
            return;
        };
        self.view.traffic = Some(to);
        self.view.traffic_line = line.saturating_add_signed(delta).min(bottom);
    }

    /// Command: another page.
    pub(super) fn show_page(&mut self, page: Page) {
        self.close_evidence();
        self.view.from_timeline = false;
        self.view.page = page;
        self.filter_frames();
        self.view.focus = Focus::List;
        self.view.details_scroll = 0;
        self.dirty = true;
    }

    /// Command: the next page or the one before.
    pub(super) fn turn_page(&mut self, by: isize) {
        let count = Page::ALL.len();
        let at = (self.view.page as usize + count).saturating_add_signed(by) % count;
        self.show_page(Page::ALL[at]);
    }

    /// Command: opens the details; in the timeline, goes to the frames of that moment, and from a
    /// problem whose details are in view to the frames that prove it.
    pub(super) fn open_details(&mut self) {
        match self.view.page {
            Page::Timeline => self.go_to_frames(),
            Page::Problems if self.screen().details.height > 0 => self.open_evidence(),
            Page::Traffic if self.view.evidence.is_some() => self.toggle_around(),
            Page::Traffic if self.view.shows_identifiers() => {}
            Page::Traffic => {
                self.view.frame_details = !self.view.frame_details;
                self.view.focus = Focus::List;
                if self.view.frame_details && self.screen().details.height == 0 {
                    self.view.focus = Focus::Details;
                }
                if self.view.traffic.is_none() {
                    let newest = self.frames_before(self.traffic_end()).next();
                    self.view.traffic = newest;
                    self.view.traffic_line = usize::MAX / 2;
                }
            }
            Page::Devices | Page::Problems => {
                let open = self.view.focus == Focus::List;
                self.focus_details(open);
            }
        }
    }

    /// Command: the keys to the details, or back to the list.
    pub(super) fn focus_details(&mut self, details: bool) {
        let has = self.view.has_details();
        if !details && self.view.page == Page::Traffic {
            self.view.frame_details = false;
        }
        self.view.focus = if details && has { Focus::Details } else { Focus::List };
        self.view.details_scroll = 0;
    }

    fn go_to_frames(&mut self) {
        let lines = self.lines_shown();
        let selected = self.view.timeline.selected().or(lines.last());
        let Some(line) = selected.and_then(|&number| self.timeline.get(number)) else { return };
        let time = line.time;
        let number = self.capture.at_time(time);
        if self.capture.get(number).is_none()
            || self.capture.get(self.capture.first()).is_some_and(|first| first.time > time)
        {
            return self.show_error("frames no longer in the capture");
        }
        self.show_page(Page::Traffic);
        self.view.by_identifier = false;
        self.view.set_filter(Page::Traffic, String::new());
        self.view.traffic = Some(number);
        self.view.traffic_line = self.screen().list_rows() / 2;
        self.view.from_timeline = true;
    }

    /// Command: sorts the rows by the next column.
    pub(super) fn sort_by_next(&mut self) {
        match self.view.page {
            Page::Devices => {
                self.view.sort = self.view.sort.next();
                // Rows that are held are in the wanted order all the same.
                self.rows.clear();
                self.refresh_rows();
                self.show_info(format!("sorted {}", self.view.sort.describe()));
            }
            _ => self.show_error("sort works on the Devices page"),
        }
    }

    /// Command: holds the page still, or lets it go on.
    pub(super) fn toggle_freeze(&mut self) {
        self.view.frozen = match self.view.frozen {
            Some(_) => None,
            None => Some(Frozen { frames: self.capture.end(), lines: self.timeline.end() }),
        };
        self.timeline.pin_lines(self.view.frozen.is_some());
        self.refresh_rows();
        self.show_info(match self.view.frozen {
            Some(_) => "frozen; capture continues",
            None => "unfrozen",
        });
    }

    /// Command: traffic as frames, or as a row per identifier.
    pub(super) fn toggle_identifiers(&mut self) {
        if self.view.page == Page::Traffic {
            self.close_evidence();
            self.view.by_identifier = !self.view.by_identifier;
            let (keys, height) = (self.identifier_keys(), self.screen().list_rows());
            self.view.identifiers.settle(&keys, height);
        } else {
            self.show_error("identifier view works on the Traffic page");
        }
    }

    /// Command: asks for the filter of this page.
    pub(super) fn ask_filter(&mut self) {
        self.close_evidence();
        let page = self.view.page;
        let before = self.view.filter(page).to_owned();
        self.open_prompt(PromptKind::Filter(page, before.clone()), before);
    }

    /// Command: leaves what is open; else the details; else takes the filter away.
    pub(super) fn cancel(&mut self) {
        let page = self.view.page;
        if !matches!(self.overlay, Overlay::None) {
            self.overlay = Overlay::None;
        } else if self.view.focus == Focus::Details {
            self.focus_details(false);
        } else if self.leave_evidence() {
        } else if page == Page::Traffic && self.view.frame_details {
            self.view.frame_details = false;
        } else if !self.view.filter(page).is_empty() {
            self.view.set_filter(page, String::new());
            self.refresh();
        } else if self.view.from_timeline {
            self.show_page(Page::Timeline);
            self.view.traffic = None;
        } else {
            self.view.traffic = None;
            self.view.timeline.release();
        }
    }

    /// Command: the help.
    pub(super) fn show_help(&mut self) {
        self.overlay = Overlay::Help(0);
    }

    /// Command: scrolls the help by lines.
    pub(super) fn scroll_help(&mut self, by: i16) {
        if let Overlay::Help(at) = &mut self.overlay {
            *at = at.saturating_add_signed(by);
        }
    }

    /// Command: scrolls the help by screenfuls.
    pub(super) fn page_help(&mut self, pages: i16) {
        let screen = self.screen();
        let height = screen.footer.y.saturating_sub(screen.tabs.bottom()).max(3) - 2;
        self.scroll_help(pages.saturating_mul(height.cast_signed()));
    }

    /// Command: the next theme.
    pub(super) fn next_theme(&mut self) {
        let at = self.themes.iter().position(|name| *name == self.theme).map_or(0, |at| at + 1);
        let Some(name) = self.themes.get(at).or(self.themes.first()).cloned() else { return };
        self.theme.clone_from(&name);
        self.show_info(format!("theme {name}"));
        self.effects.push_back(Effect::UseTheme(name));
    }

    /// Command: draw everything anew.
    pub(super) fn redraw(&mut self) {
        self.effects.push_back(Effect::Redraw);
    }

    /// Command: stop until the shell continues us.
    pub(super) fn suspend(&mut self) {
        self.effects.push_back(Effect::Suspend);
    }

    /// Command: puts the selected row into the clipboard.
    pub(super) fn copy_row(&mut self) {
        let text = match self.view.page {
            Page::Devices => self.selected_row().map(|row| {
                let name = row.name.as_ref().map_or("?".to_owned(), ToString::to_string);
                let address = row.address.map_or("?".to_owned(), |address| address.to_string());
                format!("{name} @{address} {}", row.state.word())
            }),
            Page::Problems => {
                let problem = self.selected_problem();
                problem.map(|it| format!("{}: {}", it.title(), it.head().text))
            }
            Page::Timeline => {
                let number = self.view.timeline.selected().copied();
                let line = number.and_then(|number| self.timeline.get(number));
                line.map(|line| format!("{} {}", super::clock(self, line.time), line.text))
            }
            Page::Traffic => self.selected_frame().map(ToString::to_string),
        };
        match text {
            Some(text) => {
                self.show_info(format!("copied: {text}"));
                self.effects.push_back(Effect::Copy(text));
            }
            None => self.show_error("no row is selected"),
        }
    }

    /// What the selection is about: bus, address, name, as far as it says.
    fn subject(&self) -> (Option<BusIndex>, Option<Address>, Option<Name>) {
        match self.view.page {
            Page::Devices => self
                .selected_row()
                .map_or((None, None, None), |row| (row.bus, row.address, row.name.clone())),
            Page::Problems => self.selected_problem().map_or((None, None, None), |problem| {
                let key = &problem.head().key;
                (key.bus, key.address, key.name.clone())
            }),
            Page::Timeline => {
                let number = self.view.timeline.selected();
                let line = number.and_then(|&number| self.timeline.get(number));
                line.map_or((None, None, None), |line| (line.bus, line.address, line.name.clone()))
            }
            Page::Traffic => {
                let frame = self.selected_frame();
                let source = frame.and_then(|frame| Decoded::of(self, frame).header);
                (frame.map(|frame| frame.bus), source.map(|header| header.source), None)
            }
        }
    }

    /// Edits are made on the page Devices: from another page, goes to the row that its selection is
    /// about. Whether there is one.
    pub(super) fn go_to_row(&mut self) -> bool {
        self.view.page == Page::Devices || self.find_row("select a device first")
    }

    /// Goes to the row that the selection is about; where there is none, says so with `otherwise`.
    pub(super) fn find_row(&mut self, otherwise: &str) -> bool {
        let (bus, address, name) = self.subject();
        let problem = self.selected_problem().filter(|_| self.view.page == Page::Problems);
        let entry = problem.and_then(|problem| self.entry_of_finding(&problem.head().key));
        let on_bus = |row: &&Row| bus.is_none_or(|bus| row.is_on(bus));
        let fits = |app: &Self, row: &Row| {
            let named = name.is_some() && row.name == name;
            let there =
                address.is_some_and(|address| app.addresses_of(row).any(|it| it == address));
            let its_own = entry.is_some() && row.entry == entry;
            (its_own, named && there, named, there && name.is_none())
        };
        let best = |app: &Self| {
            let best = app.rows.iter().filter(on_bus).max_by_key(|row| fits(app, row));
            best.filter(|row| fits(app, row) > (false, false, false, false))
                .map(|row| row.key.clone())
        };
        let mut found = best(self);
        if found.is_none() && !self.view.filter(Page::Devices).is_empty() {
            // It may be there, and not fit the filter.
            let filter = self.view.filter(Page::Devices).to_owned();
            self.view.set_filter(Page::Devices, String::new());
            self.refresh_rows();
            found = best(self);
            if found.is_none() {
                self.view.set_filter(Page::Devices, filter);
                self.refresh_rows();
            }
        }
        let Some(key) = found else {
            self.show_error(otherwise);
            return false;
        };
        self.view.devices.select(key);
        self.show_page(Page::Devices);
        true
    }

    /// Command: from a device to the problem it is in, from a problem to its device.
    pub(super) fn go_to_problem(&mut self) {
        if self.view.page == Page::Problems {
            self.find_row("no device for this problem");
            return;
        }
        let (bus, address, name) = self.subject();
        let problems = self.problems();
        let about = |problem: &&Problem| problem.is_about(bus, address, name.as_ref());
        let Some(key) = problems.iter().find(about).map(|problem| problem.key.clone()) else {
            return self.show_error("no problem for this device");
        };
        drop(problems);
        if !self.problem_keys().contains(&key) {
            self.view.set_filter(Page::Problems, String::new());
        }
        self.view.problems.select(key);
        self.show_page(Page::Problems);
        self.refresh();
    }

    // ---- what is on the lists --------------------------------------------------------------

    fn row_keys(&self) -> Vec<RowKey> {
        self.rows.iter().map(|row| row.key.clone()).collect()
    }

    /// The numbers of the timeline's lines that the filter lets through, oldest first.
    pub fn lines_shown(&self) -> Vec<u64> {
        let filter = Filter::parse(self.view.filter(Page::Timeline));
        let end = self.view.frozen.map_or(u64::MAX, |frozen| frozen.lines);
        let entries = self.timeline.entries().filter(|entry| entry.number < end);
        entries
            .filter(|entry| filter.is_empty() || filter.matches_entry(self, entry))
            .map(|entry| entry.number)
            .collect()
    }

    /// The rows of the view by identifier that the filter lets through, in order.
    pub fn identifiers_shown(&self) -> Vec<&IdentifierStats> {
        let filter = Filter::parse(self.view.filter(Page::Traffic));
        let rows = self.capture.identifiers().rows().iter();
        let mut shown: Vec<&IdentifierStats> =
            rows.filter(|row| filter.matches_frame(self, &row.last)).collect();
        shown.sort_by_key(|row| row.key);
        shown
    }

    fn identifier_keys(&self) -> Vec<IdentifierKey> {
        self.identifiers_shown().iter().map(|row| row.key).collect()
    }
}
