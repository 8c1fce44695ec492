//! Going from one thing to another, and back to where the user came from.
//!
//! Bounded: 16 places. Does not know how a page shows what was gone to.

use super::page_filters::PageFilter;
use super::view::{Page, TrafficView};
use super::{App, Prompt, PromptKind};
use crate::frame::BusIndex;
use crate::keymap::{Action, Key, KeyCode};
use crate::wire::id::Address;

/// Most places that are remembered; more steps back are rare.
const MAX_PLACES: usize = 16;

/// A place that was left for another page, or another view of Traffic.
#[derive(Clone, Debug)]
pub(super) struct Place {
    page: Page,
    /// The page that was gone to, and the filter that it had.
    opened: Page,
    filter: PageFilter,
    traffic_view: TrafficView,
}

impl App {
    /// Goes to another thing; if that is on another page, or in another view of Traffic,
    /// [`Self::go_to_last_place`] leads back.
    pub(super) fn go_from_here(&mut self, go: impl FnOnce(&mut Self)) {
        let (page, traffic_view) = (self.view.page, self.view.traffic_view);
        let filters = Page::ALL.map(|page| self.filters.of(page).clone());
        go(self);
        let opened = self.view.page;
        if opened == page && self.view.traffic_view == traffic_view {
            return;
        }
        if self.places.len() == MAX_PLACES {
            self.places.remove(0);
        }
        let filter = filters[opened as usize].clone();
        self.places.push(Place { page, opened, filter, traffic_view });
    }

    /// Goes back to the last place that was left; the filter of this page is as before. From evidence, or the
    /// calls of a row, to that problem or row.
    pub(super) fn go_to_last_place(&mut self) {
        if self.view.page == Page::Traffic {
            if self.view.evidence.is_some() {
                return self.return_to_problem();
            }
            if self.close_call_list() {
                return;
            }
        }
        let (page, traffic_view) = (self.view.page, self.view.traffic_view);
        let is_shown = |place: &Place| {
            place.page == page && (page != Page::Traffic || place.traffic_view == traffic_view)
        };
        // A page key may have led there meanwhile.
        while self.places.pop_if(|place| is_shown(place)).is_some() {}
        let Some(place) = self.places.pop() else {
            return self.show_error("no page to return to");
        };
        if self.view.page == place.opened {
            self.filters.restore(place.opened, place.filter);
            self.view.traffic_view = place.traffic_view;
        }
        self.show_page(place.page);
        self.filter_changed();
    }

    /// Returns from evidence to its problem, as [`Self::go_to_last_place`] would: to the moment, too, unless
    /// another one was chosen meanwhile.
    pub(super) fn return_to_problem(&mut self) {
        let Some(evidence) = &self.view.evidence else { return };
        let (problem, in_details) = (evidence.problem.clone(), evidence.was_opened_in_details());
        let piece = evidence.selected().map(|(_, piece)| (piece.time, piece.frame));
        let left = evidence.led_to.filter(|(led_to, _)| self.shown_or_target() == *led_to);
        self.places.pop_if(|place| (place.page, place.opened) == (Page::Problems, Page::Traffic));
        self.show_page(Page::Problems);
        match left {
            Some((_, None)) => self.show_present(),
            Some((_, Some(before))) => self.go_to(before),
            None => {}
        }
        self.view.problems.select(problem);
        self.view.focus_details(in_details);
        let pieces = self.selected_problem().map(|problem| problem.evidence()).unwrap_or_default();
        let place = pieces.iter().position(|it| Some((it.time, it.frame)) == piece);
        if let Some(place) = place.filter(|_| in_details) {
            self.view.piece = place;
        }
    }

    /// Returns true if the key of `go-to`, a letter, is typed into its empty prompt: it goes to the
    /// first row.
    pub(super) fn is_first_row_typed(&self, key: Key) -> bool {
        let is_empty = |prompt: &Prompt| {
            matches!(prompt.kind, PromptKind::Moment(_)) && prompt.input.value().is_empty()
        };
        let is_letter = matches!(key.code, KeyCode::Char(c) if c.is_ascii_alphabetic());
        self.prompt().is_some_and(is_empty)
            && is_letter
            && self.keymap().keys_of(Action::GoTo).any(|own| own == key)
    }

    /// Shows the events of what is selected on the Timeline page.
    pub(super) fn go_to_events(&mut self) {
        if self.view.page == Page::Timeline {
            return self.show_error("these are the events");
        }
        let (bus, address, name) = self.subject();
        let row = self.selected_row().filter(|_| self.view.page == Page::Devices);
        let mut addresses: Vec<Address> = match row {
            Some(row) => row.addresses(self.shown_buses()).collect(),
            None => address.into_iter().collect(),
        };
        addresses.sort_unstable();
        addresses.dedup();
        // The events of a device that moved are those at its earlier address, too.
        let device = row.and_then(|row| self.device_of(row));
        addresses.extend(device.and_then(|device| device.moved_from));
        let name = name.filter(|_| addresses.is_empty()).map(|name| name.to_string());
        let term = match name {
            _ if !addresses.is_empty() => {
                let all: Vec<String> = addresses.iter().map(ToString::to_string).collect();
                format!("at:{}", all.join(","))
            }
            Some(name) => format!("name:\"={}\"", name.replace(['"', '\\'], "")),
            None => return self.show_error("no events: nothing with an address is selected"),
        };
        let is_of_all = row.is_some_and(|row| !row.redundant_ids.is_empty());
        let term = term + &self.bus_term(bus.filter(|_| !is_of_all));
        self.set_filter(Page::Timeline, &term);
        self.show_page(Page::Timeline);
    }

    /// Filter term of a bus, with a blank before it; empty with a single bus.
    pub(super) fn bus_term(&self, bus: Option<BusIndex>) -> String {
        let bus = bus.filter(|_| self.buses.len() > 1).and_then(|bus| self.buses.get(bus));
        bus.map_or_else(String::new, |bus| format!(" bus:\"={}\"", bus.name.replace('"', "")))
    }
}
