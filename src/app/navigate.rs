//! Commands that change the view: pages, rows, details, evidence, freezing, the mouse.

use super::capture::{CallKey, Decoded, IdentifierKey, IdentifierKind};
use super::input::Overlay;
use super::view::{EvidenceView, Focus, Page, Row, TrafficView};
use super::{
    AROUND_EVIDENCE, App, Effect, EvidenceItem, Problem, clock_millis, growing_length_text,
    length_text,
};
use crate::finding::{FindingKind, SeenUid};
use crate::frame::BusIndex;
use crate::keymap::Action;
use crate::status::PlaybackCommand;
use crate::text::{Escaped, Name};
use crate::time::Instant;
use crate::wire::id::Address;
use crate::wire::node::Uid;
use ratatui::layout::{Position, Rect};

/// Rows per step of the mouse wheel.
const WHEEL_ROWS: isize = 3;

/// A mouse event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mouse {
    /// Kind.
    pub kind: MouseKind,
    /// Column, from 0.
    pub column: u16,
    /// Row, from 0.
    pub row: u16,
}

/// Kind of a mouse event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MouseKind {
    /// The first button was pressed.
    Press,
    /// The left button is held and the pointer moved.
    Drag,
    /// The wheel was turned up.
    WheelUp,
    /// The wheel was turned down.
    WheelDown,
}

impl Mouse {
    fn is_in(self, area: Rect) -> bool {
        area.contains(Position::new(self.column, self.row))
    }
}

impl App {
    // ---- the mouse -------------------------------------------------------------------------

    /// Takes a mouse event.
    pub fn handle_mouse(&mut self, now: Instant, mouse: Mouse) {
        self.clock.set(now);
        let delta = match mouse.kind {
            MouseKind::Press => return self.press(mouse),
            MouseKind::Drag => {
                if !self.input.has_overlay() && !self.click_time_bar(mouse) {
                    self.click_lanes(mouse);
                }
                return;
            }
            MouseKind::WheelUp => -WHEEL_ROWS,
            MouseKind::WheelDown => WHEEL_ROWS,
        };
        self.notices.redraw.set_dirty();
        match self.overlay() {
            Overlay::None if mouse.is_in(self.screen().details) => self.view.scroll_details(delta),
            Overlay::None => self.move_list(delta),
            Overlay::Marks(_) => self.move_in_marks(delta.signum()),
            Overlay::Filters(_) => self.move_in_filters(delta.signum()),
            Overlay::Kinds(_) => self.move_in_kinds(delta.signum()),
            Overlay::Themes(_) => self.move_in_themes(delta.signum()),
            Overlay::Profile => self.move_in_profile(delta.signum()),
            Overlay::Plan => self.move_in_plan(delta.signum()),
            Overlay::Comparison => self.move_in_comparison(delta),
            _ => self.input.scroll_help(delta as i16),
        }
    }

    fn press(&mut self, mouse: Mouse) {
        if self.input.has_overlay() {
            return;
        }
        self.notices.redraw.set_dirty();
        if self.click_time_bar(mouse) || self.click_lanes(mouse) {
            return;
        }
        let screen = self.screen();
        if mouse.row == screen.tabs.y && screen.tabs.height > 0 {
            let tabs = screen.tabs(self.view.page, self.counts());
            let hit = tabs.into_iter().find(|(_, start, text)| {
                (*start..start + text.chars().count() as u16).contains(&mouse.column)
            });
            if let Some((page, ..)) = hit {
                self.show_page(page);
            }
        } else if mouse.is_in(screen.banner) {
            let has_plan = self.plan_banner().is_some();
            if has_plan { self.open_plan() } else { self.review_profile() }
        } else if self.view.page == Page::Bus {
            self.click_bar(Position::new(mouse.column, mouse.row));
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
        let height = self.list_height();
        self.view.details_scroll = 0;
        match self.view.page {
            Page::Devices => self.view.devices.click(&self.devices.keys(), line, height),
            Page::Problems => {
                let keys = self.problem_keys();
                self.view.problems.click(&keys, line, height);
            }
            Page::Timeline => {
                let keys = self.lines_shown();
                self.view.hold_timeline(&keys, height);
                self.view.timeline.click(&keys, line, height);
            }
            Page::Bus => {}
            Page::Traffic if self.view.evidence_alone().is_some() => {
                self.view.click_evidence(line, height);
            }
            Page::Traffic if self.view.shows_identifiers() => {
                let keys = self.identifier_keys();
                self.view.identifiers.click(&keys, line, height);
            }
            Page::Traffic if self.view.call_list().is_some() => self.click_call_list(line),
            Page::Traffic if self.view.shows_calls() => {
                let keys = self.call_keys();
                self.view.calls.click(&keys, line, height);
            }
            Page::Traffic => {
                let (shown, _) = self.frames_shown(height);
                if let Some(&number) = shown.get(line) {
                    (self.view.traffic, self.view.traffic_line) = (Some(number), line);
                }
            }
        }
    }

    // ---- rows ------------------------------------------------------------------------------

    /// Moves the selection, or scrolls the details that have the focus, by rows.
    pub(super) fn move_by(&mut self, delta: isize) {
        if self.view.focus == Focus::Details && self.screen().details.height > 0 {
            if self.view.page == Page::Problems {
                return self.move_in_evidence_table(delta);
            }
            self.view.scroll_details(delta);
        } else {
            self.move_list(delta);
        }
    }

    /// Moves by screenfuls.
    pub(super) fn move_pages(&mut self, pages: isize) {
        let screen = self.screen();
        let height = screen.list_rows().max(usize::from(screen.details.height));
        self.move_by(pages * height.saturating_sub(1).max(1).cast_signed());
    }

    /// Moves to the first or the last row; behind the last row Timeline and Traffic follow.
    pub(super) fn move_to_end(&mut self, last: bool) {
        let is_empty = self.view.page == Page::Traffic && self.traffic.has_no_match(&self.view);
        let by_rows = self.view.evidence_alone().is_some()
            || self.view.shows_identifiers()
            || self.view.shows_calls();
        if is_empty && !by_rows && self.view.focus == Focus::List {
            return;
        }
        if last && self.view.focus == Focus::List {
            match self.view.page {
                Page::Timeline => return self.view.timeline.follow_newest(),
                Page::Traffic if !by_rows => {
                    self.view.traffic = None;
                    return;
                }
                _ => {}
            }
        }
        if !last && self.view.page == Page::Traffic && !by_rows {
            let first = self.traffic.from(&self.view, 0).next();
            self.view.traffic = first;
            self.view.traffic_line = 0;
            return;
        }
        self.move_by(if last { isize::MAX / 2 } else { isize::MIN / 2 });
    }

    fn move_list(&mut self, delta: isize) {
        if self.move_in_lanes(delta) {
            return;
        }
        let height = self.list_height();
        self.view.details_scroll = 0;
        match self.view.page {
            Page::Devices => self.view.devices.move_by(&self.devices.keys(), delta, height),
            Page::Problems => {
                let keys = self.problem_keys();
                self.view.problems.move_by(&keys, delta, height);
            }
            Page::Timeline => {
                let keys = self.lines_shown();
                self.view.hold_timeline(&keys, height);
                self.view.timeline.move_by(&keys, delta, height);
                if delta > 0 && self.view.timeline.selected() == keys.last() {
                    self.view.timeline.follow_newest();
                }
            }
            Page::Bus => self.move_in_bars(delta),
            Page::Traffic if self.view.evidence_alone().is_some() => {
                self.view.move_in_evidence(delta, height);
            }
            Page::Traffic if self.view.shows_identifiers() => {
                let keys = self.identifier_keys();
                self.view.identifiers.move_by(&keys, delta, height);
            }
            Page::Traffic if self.view.call_list().is_some() => self.move_in_call_list(delta),
            Page::Traffic if self.view.shows_calls() => {
                let keys = self.call_keys();
                self.view.calls.move_by(&keys, delta, height);
            }
            Page::Traffic => {
                let before = self.view.traffic;
                self.traffic.move_by(&mut self.view, delta, height);
                if delta < 0 && before.is_some() && self.view.traffic == before {
                    self.say_first_frame();
                }
            }
        }
    }

    /// Says since when frames are kept, if there were earlier ones.
    fn say_first_frame(&mut self) {
        let capture = &self.traffic.capture;
        let oldest = capture.time_of(capture.oldest());
        let Some(oldest) = oldest.filter(|_| capture.oldest() > 0) else { return };
        let (count, since) = (capture.oldest(), super::clock_millis(self, oldest));
        self.show_info(format!("{count} frames before {since} are no longer kept"));
    }

    fn identifier_keys(&self) -> Vec<IdentifierKey> {
        self.identifiers_shown().iter().map(|row| row.key).collect()
    }

    fn call_keys(&self) -> Vec<CallKey> {
        self.calls_shown().iter().map(|row| row.key).collect()
    }

    // ---- pages and details -----------------------------------------------------------------

    /// Opens a page.
    pub(super) fn show_page(&mut self, page: Page) {
        self.view.open_page(page);
        self.filter_frames();
        self.settle_bars();
        self.count_lanes();
        self.notices.redraw.set_dirty();
    }

    /// Opens the next page, or with -1 the previous one.
    pub(super) fn turn_page(&mut self, by: isize) {
        let count = Page::ALL.len();
        let at = (self.view.page as usize + count).saturating_add_signed(by) % count;
        self.show_page(Page::ALL[at]);
    }

    /// Opens the details. On Timeline: shows the moment of the line; on Problems, with details in
    /// view: the evidence; on evidence: all frames around it.
    pub(super) fn open_details(&mut self) {
        match self.view.page {
            Page::Timeline if self.screen().list.height == 0 => self.go_to_lane(),
            Page::Timeline => self.go_to_line(),
            Page::Bus => self.open_bar(),
            Page::Problems if self.screen().details.height > 0 => self.open_problem(),
            Page::Traffic if self.view.evidence.is_some() => self.toggle_around(),
            Page::Traffic if self.view.shows_identifiers() => self.show_frames_of_identifier(),
            Page::Traffic if self.view.call_list().is_some() => self.go_to_call(),
            Page::Traffic if self.view.shows_calls() => self.open_call_list(),
            Page::Traffic => {
                self.view.frame_details = !self.view.frame_details;
                self.view.focus = Focus::List;
                if self.view.frame_details && self.screen().details.height == 0 {
                    self.view.focus = Focus::Details;
                }
                if self.view.traffic.is_none() {
                    let end = self.traffic.end(&self.view);
                    let newest = self.traffic.before(&self.view, end).next();
                    self.view.traffic = newest;
                    self.view.traffic_line = usize::MAX / 2;
                }
            }
            Page::Devices | Page::Problems => self.focus_details(self.view.focus == Focus::List),
        }
    }

    /// Goes into the details of the selection; from a line of Timeline to its frames.
    pub(super) fn go_into(&mut self) {
        let view = &self.view;
        match view.page {
            Page::Timeline => self.go_from_here(Self::go_to_frames),
            Page::Traffic if view.evidence.is_none() && !view.frame_details => {
                self.go_from_here(Self::open_details);
            }
            _ => self.focus_details(true),
        }
    }

    /// Leaves the details; on Traffic also the evidence and the frames of a line of Timeline.
    pub(super) fn go_back(&mut self) {
        let view = &self.view;
        let came_from = view.evidence.is_some()
            || view.call_list().is_some()
            || view.from_timeline && !view.frame_details;
        if view.page == Page::Traffic && view.focus == Focus::List && came_from {
            self.cancel();
        } else {
            self.focus_details(false);
        }
    }

    /// Focuses the details of the selection, if there is one, or the list.
    fn focus_details(&mut self, details: bool) {
        let is_empty = self.view.page == Page::Problems && self.selected_problem().is_none();
        self.view.focus_details(details && !is_empty);
    }

    /// Shows the frames of what is selected: of the device, of the problem, at the timeline line.
    pub(super) fn go_to_frames_of_selection(&mut self) {
        match self.view.page {
            Page::Devices => self.go_to_frames_of_device(),
            Page::Timeline if self.screen().list.height == 0 => self.go_to_frames_of_lane(),
            Page::Timeline => self.go_to_frames(),
            Page::Problems => self.go_to_frames_of_problem(),
            Page::Bus => self.go_to_frames_of_bar(),
            Page::Traffic if self.view.shows_identifiers() => self.show_frames_of_identifier(),
            Page::Traffic if self.view.shows_calls() => self.show_frames_of_call(),
            Page::Traffic => self.show_error("these are the frames"),
        }
    }

    /// Shows the evidence of the selected problem; without any, the frames of the device at its address.
    fn go_to_frames_of_problem(&mut self) {
        // At the address of an entry that is missing there may be another device.
        let is_of_device = self.selected_problem().is_some_and(|problem| {
            problem.head().key.kind != FindingKind::Missing && problem.evidence().is_empty()
        });
        let is_there = |bus: BusIndex, address| {
            self.shown_buses().get(bus).is_some_and(|bus| bus.device_at(address).is_some())
        };
        match self.subject() {
            (Some(bus), Some(address), _) if is_of_device && is_there(bus, address) => {
                let term = self.bus_term(Some(bus));
                self.show_frames_matching(&format!("at:{address}{term}"));
            }
            _ => self.open_evidence(),
        }
    }

    /// Shows the frames from and to an address.
    pub(super) fn show_frames_of_address(&mut self, address: Address) {
        self.show_frames_matching(&format!("at:{address}"));
    }

    /// Shows the frames that match a filter, the newest ones.
    pub(super) fn show_frames_matching(&mut self, filter: &str) {
        self.view.traffic_view = TrafficView::Frames;
        self.view.traffic = None;
        self.set_filter(Page::Traffic, filter);
        self.show_page(Page::Traffic);
    }

    /// Shows the frames at the time of the selected timeline line.
    fn go_to_frames(&mut self) {
        let Some((_, time)) = self.selected_line_time() else { return };
        let capture = &self.traffic.capture;
        let number = capture.at_time(time);
        let first = capture.get(capture.first()).map(|first| first.time);
        let next = capture.get(number).map(|frame| frame.time);
        // Frames around evidence are kept longer than those before and after them.
        let is_near = next.is_some_and(|next| next.since(time) <= AROUND_EVIDENCE);
        let refusal = match first {
            None => Some("no frames captured yet"),
            Some(first) if first > time && capture.first() == 0 => {
                Some("no frames captured before this line")
            }
            Some(first) if first > time && !is_near => Some("frames no longer in the capture"),
            Some(_) if next.is_none() => Some("no frames captured since this line"),
            Some(_) => None,
        };
        if let Some(refusal) = refusal {
            return self.show_error(refusal);
        }
        self.show_page(Page::Traffic);
        self.view.traffic_view = TrafficView::Frames;
        self.filters.clear(Page::Traffic);
        self.view.select_frame(number, self.list_height());
        self.view.from_timeline = true;
    }

    /// Shows only the frames of the selected identifier.
    fn show_frames_of_identifier(&mut self) {
        let Some(key) = self.view.identifiers.selected().copied() else {
            return self.show_error("no row is selected");
        };
        let term = match key.kind {
            IdentifierKind::Error => "type:err".to_owned(),
            IdentifierKind::Remote => format!("id:={} type:rtr", key.id),
            IdentifierKind::Data => format!("id:={}", key.id),
        };
        self.show_frames_with(key.bus, &term);
    }

    /// Shows only the frames of the selected calls.
    fn show_frames_of_call(&mut self) {
        let Some(key) = self.view.calls.selected().copied() else {
            return self.show_error("no row is selected");
        };
        self.show_frames_with(key.bus, &Self::term_of_calls(key));
    }

    pub(super) fn show_frames_with(&mut self, bus: BusIndex, term: &str) {
        let line = term.to_owned() + &self.bus_term(Some(bus));
        self.view.traffic_view = TrafficView::Frames;
        self.view.traffic = None;
        self.commit_filter(Page::Traffic, &line);
    }

    /// Sorts the rows of the page by the next column.
    pub(super) fn sort_by_next(&mut self) {
        match self.view.page {
            Page::Traffic if self.view.shows_identifiers() => {
                let order = self.view.identifier_sort.order.next();
                self.view.identifier_sort.order = order;
                self.move_to_end(false);
                self.show_sorted(order.describe(), self.view.identifier_sort.is_reversed);
            }
            Page::Traffic if self.view.call_list().is_some() => self.sort_call_list(),
            Page::Traffic if self.view.shows_calls() => {
                let order = self.view.call_sort.order.next();
                self.view.call_sort.order = order;
                self.move_to_end(false);
                self.show_sorted(order.describe(), self.view.call_sort.is_reversed);
            }
            Page::Devices => {
                let order = self.view.device_sort.order.next();
                self.view.device_sort.order = order;
                self.refresh_rows();
                self.show_sorted(order.describe(), self.view.device_sort.is_reversed);
            }
            _ => self.show_error("sort works on Devices, identifiers and calls"),
        }
    }

    /// Says what the rows of the page are sorted by.
    fn show_sorted(&mut self, order: &str, is_reversed: bool) {
        let reversed = if is_reversed { ", reversed" } else { "" };
        self.show_info(format!("sorted {order}{reversed}"));
    }

    /// Opens or closes the selected transfer or story.
    pub(super) fn toggle_transfer(&mut self) {
        if self.view.page == Page::Timeline {
            return self.toggle_story();
        }
        let is_of_frames =
            self.view.page == Page::Traffic && self.view.traffic_view == TrafficView::Frames;
        if !is_of_frames {
            self.show_error("steps are on Timeline, transfers on Traffic");
        } else if !self.traffic.toggle_transfer(&mut self.view) {
            self.show_error("no transfer is selected");
        }
    }

    /// Shows other times of frames; in the views of identifiers and calls, counts from now on.
    pub(super) fn next_time_format(&mut self) {
        let view = &self.view;
        if view.page == Page::Traffic && (view.shows_identifiers() || view.shows_calls()) {
            return self.toggle_counts_base();
        }
        if view.page != Page::Traffic {
            return self.show_error("times of frames are chosen on Traffic");
        }
        self.view.time_format = self.view.time_format.next();
        self.show_info(self.view.time_format.describe());
    }

    /// Reverses the order of the rows of the list that is shown.
    pub(super) fn reverse_order(&mut self) {
        let view = &mut self.view;
        let is_reversed = match view.page {
            Page::Devices => &mut view.device_sort.is_reversed,
            Page::Traffic if view.shows_identifiers() => &mut view.identifier_sort.is_reversed,
            Page::Traffic if view.shows_calls() => match &mut view.call_list {
                Some(list) => &mut list.is_reversed,
                None => &mut view.call_sort.is_reversed,
            },
            _ => return self.show_error("sort works on Devices, identifiers and calls"),
        };
        *is_reversed = !*is_reversed;
        let text = if *is_reversed { "order reversed" } else { "order as before" };
        self.refresh_rows();
        self.show_info(text);
    }

    /// Shows the next view of the page, or another time of the charts of Bus.
    pub(super) fn next_view(&mut self) {
        if self.view.page == Page::Devices {
            self.next_device_view();
        } else if self.view.page == Page::Bus {
            self.next_chart_span();
        } else if self.view.page == Page::Problems {
            self.next_problems_view();
        } else if self.view.page == Page::Timeline {
            self.view.timeline_view = self.view.timeline_view.next(self.view.size.0);
        } else {
            self.view.close_evidence();
            self.show_traffic_as(self.view.traffic_view.next());
        }
    }

    /// Shows a view of Traffic.
    pub(super) fn show_traffic_as(&mut self, view: TrafficView) {
        self.view.traffic_view = view;
        self.filter_frames();
        self.select_among_shown();
    }

    /// Selects a row of the identifiers or calls that is shown, where the selected one is not.
    pub(super) fn select_among_shown(&mut self) {
        let height = self.list_height();
        match self.view.traffic_view {
            TrafficView::Frames => {}
            TrafficView::Identifiers => {
                let keys = self.identifier_keys();
                self.view.identifiers.update(&keys, height);
            }
            TrafficView::Calls => {
                let keys = self.call_keys();
                self.view.calls.update(&keys, height);
            }
        }
    }

    /// Closes the overlay, else leaves the details, the evidence or the frame details, else shows the
    /// present, else switches the filter off, else returns to the timeline or follows the newest rows.
    pub(super) fn cancel(&mut self) {
        let page = self.view.page;
        if self.input.has_overlay() {
            self.input.close();
        } else if self.shows_beat_history() {
            self.close_beat_history();
        } else if self.view.focus == Focus::Details {
            self.view.focus_details(false);
        } else if self.leave_evidence() || page == Page::Traffic && self.close_call_list() {
        } else if page == Page::Traffic && self.view.frame_details {
            self.view.frame_details = false;
        } else if self.past.is_some() && !self.view.from_timeline {
            self.show_present();
        } else if self.switch_filter_off() {
        } else if self.view.from_timeline {
            self.show_page(Page::Timeline);
            self.view.traffic = None;
        } else if self.view.traffic.is_some() && page == Page::Traffic {
            self.view.traffic = None;
        } else if self.stop_reading() {
        } else if self.past.is_some() {
            self.show_present();
        } else {
            self.view.traffic = None;
            self.view.timeline.follow_newest();
        }
    }

    /// Scrolls the help by screenfuls.
    pub(super) fn page_help(&mut self, pages: i16) {
        let screen = self.screen();
        let height = screen.footer.y.saturating_sub(screen.tabs.bottom()).max(3) - 2;
        self.input.scroll_help(pages.saturating_mul(height.cast_signed()));
    }

    /// Controls the playback of a log.
    pub(super) fn control_playback(&mut self, command: PlaybackCommand) {
        let playback = self.clock.playback();
        let is_ended = playback.is_some_and(|playback| playback.is_ended);
        if is_ended && matches!(command, PlaybackCommand::Pause | PlaybackCommand::Step) {
            let back = self.key_of(Action::PreviousFrame);
            self.show_info(format!("end of the log: nothing follows; {back} steps back"));
        } else if playback.is_some() {
            self.effects.push_back(Effect::Playback(command));
        } else {
            self.show_error(match command {
                PlaybackCommand::Pause | PlaybackCommand::SetPaused(_) => {
                    "only a log can be paused"
                }
                PlaybackCommand::Step => "only a log can be stepped",
                PlaybackCommand::Slower | PlaybackCommand::Faster => "only a log has a speed",
                PlaybackCommand::ReadTo(_) => "only a log can be read ahead",
            });
        }
    }

    /// Copies the selected row to the clipboard.
    pub(super) fn copy_row(&mut self) {
        let text = match self.view.page {
            Page::Devices => self.selected_row().map(|row| {
                let name = row.name.as_ref().map_or("?".to_owned(), ToString::to_string);
                let address = row.address.map_or("?".to_owned(), |address| address.to_string());
                format!("{name} @{address} {}", row.state.word())
            }),
            Page::Problems => self.selected_problem().map(|problem| {
                let piece = problem.evidence().into_iter().nth(self.view.piece);
                match piece.filter(|_| self.view.focus == Focus::Details) {
                    Some(piece) => self.evidence_text(&piece),
                    None => self.problem_text(&problem),
                }
            }),
            Page::Timeline => self.line_text(),
            Page::Bus => self.bar_text(),
            Page::Traffic => match self.view.evidence_alone().and_then(EvidenceView::selected) {
                Some((_, piece)) => Some(self.evidence_text(piece)),
                None => self.selected_frame().map(|frame| frame.to_string()),
            },
        };
        match text {
            Some(text) => {
                self.show_info(format!("copied: {text}"));
                self.effects.push_back(Effect::Copy(text));
            }
            None => self.show_error("no row is selected"),
        }
    }

    /// A problem in one line: times, length, state, title, text, UIDs.
    fn problem_text(&self, problem: &Problem) -> String {
        let (first, ended) = (problem.began(), problem.ended());
        let until = ended.map_or_else(|| "now".to_owned(), |ended| clock_millis(self, ended));
        let times = format!("{} – {until}", clock_millis(self, first));
        let length = match ended {
            Some(ended) => length_text(ended.since(first)),
            None => growing_length_text(self.display_time().since(first)),
        };
        let (state, title, text) = (problem.state(), problem.title(), &problem.head().text);
        let uids = self.uids_in(problem);
        let uids = if uids.is_empty() { uids } else { format!("; UIDs {uids}") };
        let text = text.strip_suffix('.').unwrap_or(text);
        format!("{times} ({length}) {state}: {title}: {text}{uids}")
    }

    /// UIDs of the boards of a problem, else of the devices at its addresses, in the alphabet of the
    /// profile; blank ones are left out.
    fn uids_in(&self, problem: &Problem) -> String {
        let boards = problem.boards();
        if boards.len() > 1 {
            return boards.iter().map(SeenUid::label).collect::<Vec<String>>().join(", ");
        }
        let addresses = problem.addresses();
        let bus = problem.bus().and_then(|bus| self.bus(bus));
        let Some(bus) = bus else { return String::new() };
        let devices = bus.devices().iter().filter(|it| addresses.contains(&it.address));
        let known = devices.flat_map(|device| self.uids_of(device)).filter(|uid| !uid.is_blank());
        let alphabet = &bus.config().profile.uid;
        let text = |uid: Uid| Escaped(uid.text(alphabet).to_string().as_bytes()).to_string();
        let mut uids: Vec<String> = known.map(text).collect();
        uids.sort_unstable();
        uids.dedup();
        uids.join(", ")
    }

    /// A piece of evidence in one line: time, what it shows, frame.
    fn evidence_text(&self, piece: &EvidenceItem) -> String {
        let frame = piece.frame.map_or_else(String::new, |frame| format!(" {frame}"));
        format!("{} {}{frame}", clock_millis(self, piece.time), piece.what)
    }

    // ---- from page to page -----------------------------------------------------------------

    /// Bus, address and name of the selected row, as far as known.
    pub(super) fn subject(&self) -> (Option<BusIndex>, Option<Address>, Option<Name>) {
        match self.view.page {
            Page::Devices => self
                .selected_row()
                .map_or((None, None, None), |row| (row.bus, row.address, row.name.clone())),
            Page::Problems => self.selected_problem().map_or((None, None, None), |problem| {
                let key = &problem.head().key;
                (key.bus, key.address, key.name.clone())
            }),
            Page::Timeline if self.screen().list.height == 0 => {
                let device = self.selected_lane().and_then(|id| self.device(id));
                device.map_or((None, None, None), |device| {
                    (Some(device.id.bus), Some(device.address), device.name.clone())
                })
            }
            Page::Timeline => {
                let story = self.view.timeline.selected().and_then(|&key| self.story(key));
                let entry = story.map(|story| self.story_subject(story).0);
                entry.map_or((None, None, None), |it| (it.bus, it.address, it.name.clone()))
            }
            Page::Bus => self.bar_subject(),
            Page::Traffic => {
                let frame = self.selected_frame();
                let source = frame.and_then(|frame| Decoded::of(self, &frame).header);
                (frame.map(|frame| frame.bus), source.map(|header| header.source), None)
            }
        }
    }

    /// From another page, goes to the row of the selection on Devices, where edits are made.
    /// Returns true if there is one.
    pub(super) fn go_to_row(&mut self) -> bool {
        self.view.page == Page::Devices || self.find_row("select a device first")
    }

    /// Goes to the row of the selection on Devices; returns true if there is one, else shows the
    /// error `otherwise`.
    pub(super) fn find_row(&mut self, otherwise: &str) -> bool {
        let (bus, address, name) = self.subject();
        let problem = self.selected_problem().filter(|_| self.view.page == Page::Problems);
        let entry = problem.and_then(|problem| self.shown_problems().entry_of(&problem.head().key));
        let on_bus = |row: &&Row| bus.is_none_or(|bus| row.is_on(bus));
        let fits = |app: &Self, row: &Row| {
            let named = name.is_some() && row.name == name;
            let there =
                address.is_some_and(|address| row.addresses(&app.buses).any(|it| it == address));
            let its_own = entry.is_some() && row.entry == entry;
            let is_first_board = row.board.is_none_or(|board| board.side == 'A');
            (its_own, named && there, named, there && name.is_none(), is_first_board)
        };
        let best = |app: &Self| {
            let best = app.rows().iter().filter(on_bus).max_by_key(|row| fits(app, row));
            best.filter(|row| fits(app, row) > (false, false, false, false, true))
                .map(|row| row.key.clone())
        };
        let mut found = best(self);
        if found.is_none() && self.filters.of(Page::Devices).is_on() {
            // The filter may hide it.
            self.filters.set_on(Page::Devices, false);
            self.refresh_rows();
            found = best(self);
            if found.is_none() {
                self.filters.set_on(Page::Devices, true);
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

    /// Goes from a device to its problem, or to that of the alarm; from a problem to its device.
    pub(super) fn go_to_problem(&mut self) {
        if self.view.page == Page::Problems {
            if let Some(key) = self.selected_problem().map(|problem| problem.key) {
                self.note_alarm_seen(&key);
            }
            self.find_row("no device for this problem");
            return;
        }
        let (bus, address, name) = self.subject();
        let is_nothing = bus.is_none() && address.is_none() && name.is_none();
        let about = |problem: &Problem| problem.is_about(bus, address, name.as_ref());
        let own = self.problems().iter().find(about).filter(|_| !is_nothing);
        let Some(key) = own.map(|problem| problem.key).or_else(|| self.alarm_problem()) else {
            return self.show_error(if is_nothing {
                "no row is selected"
            } else {
                "no problem for this device"
            });
        };
        self.note_alarm_seen(&key);
        self.show_in_problems(&key);
        self.view.problems.select(key);
        self.show_page(Page::Problems);
        self.refresh_for_draw();
    }

    // ---- evidence --------------------------------------------------------------------------

    /// Opens the evidence of the selected problem; for a difference from the file, goes to its row.
    pub(super) fn open_evidence(&mut self) {
        let Some(problem) = self.selected_problem() else { return };
        let (key, title) = (problem.key.clone(), self.headline(&problem).label);
        let (kind, pieces, count) = (problem.head().key.kind, problem.evidence(), problem.count());
        if pieces.is_empty() {
            if kind == FindingKind::FramesLost {
                return self.show_error("lost frames cannot be shown");
            }
            self.find_row("no frames: this concerns the file as a whole");
            return;
        }
        // Esc returns to this problem, even if another one is first by then.
        self.view.problems.select(key.clone());
        let is_captured = |piece: &EvidenceItem| {
            piece.frame.as_ref().is_some_and(|it| self.captured(it).is_some())
        };
        let first = match self.view.focus {
            // The piece that is selected.
            Focus::Details => self.view.piece.min(pieces.len() - 1),
            Focus::List => pieces.iter().position(is_captured).unwrap_or(0),
        };
        self.view.open_evidence(key, title, pieces, count, first);
        self.filter_frames();
        self.notices.redraw.set_dirty();
        self.view.move_in_evidence(0, self.list_height());
    }

    /// Shows all frames around the selected piece of evidence, or only the evidence again.
    fn toggle_around(&mut self) {
        let Some(evidence) = &self.view.evidence else { return };
        if evidence.shows_context {
            // The selection may have moved to another piece.
            let mut pieces = evidence.pieces.iter();
            let selected = self.selected_frame();
            let place = selected.and_then(|frame| pieces.position(|it| it.frame == Some(frame)));
            if let (Some(evidence), Some(place)) = (&mut self.view.evidence, place) {
                evidence.cursor.select(place);
            }
            return self.view.set_around(false);
        }
        let Some((_, piece)) = evidence.selected() else { return };
        let capture = &self.traffic.capture;
        let number = match &piece.frame {
            Some(frame) => self.captured(frame),
            None => Some(capture.at_time(piece.time))
                .filter(|&number| number > capture.first() && number < capture.end()),
        };
        let Some(number) = number else {
            return self.show_error("surrounding frames no longer in the capture");
        };
        if number >= self.traffic.end(&self.view) {
            let key = self.key_of_present();
            return self.show_error(format!("newer than this moment: {key} shows the present"));
        }
        self.view.select_frame(number, self.list_height());
        self.view.set_around(true);
    }

    /// Returns from the frames around the evidence to the evidence, from there to the problem.
    /// Returns false if there is no evidence to leave.
    fn leave_evidence(&mut self) -> bool {
        match self.view.evidence.as_ref().map(|it| it.shows_context) {
            None => return false,
            Some(true) => self.view.set_around(false),
            Some(false) => self.return_to_problem(),
        }
        true
    }
}
