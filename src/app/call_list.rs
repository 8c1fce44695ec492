//! Commands of the calls of one client, server and service, one by one; counts from now on.
//!
//! Does not know how they are drawn.

use super::capture::{Call, CallKey, CallResult, CountsBase};
use super::view::{Page, TrafficView};
use super::{App, clock_millis};
use std::cmp::Reverse;

impl App {
    /// The calls of the open list that match the filter by their request or response, in its order.
    pub fn calls_listed(&self) -> Vec<Call> {
        let Some(list) = self.view.call_list() else { return Vec::new() };
        let Some(row) = self.calls().get(&list.key) else { return Vec::new() };
        let matcher = self.filters.of(Page::Traffic).active();
        let matcher = matcher.map(|filter| filter.for_frames(self.shown_buses()));
        let capture = &self.traffic.capture;
        let is_match = |number: u64| {
            let frame = capture.get(number);
            matcher.as_ref().is_none_or(|matcher| {
                frame.is_some_and(|frame| matcher.is_match(&frame, Some((capture, number))))
            })
        };
        let is_shown = |call: &&Call| {
            is_match(call.request) || call.response.is_some_and(|(number, _)| is_match(number))
        };
        let mut calls: Vec<Call> = row.kept_calls().rev().filter(is_shown).copied().collect();
        if list.is_by_latency {
            let rank = |call: &Call| match call.result {
                CallResult::Unanswered => (2, None),
                CallResult::Answered | CallResult::Failed => (1, call.response.map(|it| it.1)),
                CallResult::Open => (0, None),
            };
            calls.sort_by_key(|call| Reverse(rank(call)));
        }
        if list.is_reversed {
            calls.reverse();
        }
        calls
    }

    /// The selected call.
    pub fn selected_call(&self) -> Option<Call> {
        let calls = self.calls_listed();
        let selected = self.view.call_list()?.cursor.index(calls.iter().map(|it| &it.request));
        calls.get(selected.unwrap_or(0)).copied()
    }

    /// Shows the calls of the selected row one by one.
    pub(super) fn open_call_list(&mut self) {
        let Some(key) = self.view.calls.selected().copied() else {
            return self.show_error("no row is selected");
        };
        self.view.open_call_list(key);
        self.notices.redraw.set_dirty();
    }

    /// Returns to the rows of calls. Returns false if no list is open.
    pub(super) fn close_call_list(&mut self) -> bool {
        self.view.call_list().is_some() && self.view.call_list.take().is_some()
    }

    /// Moves the selection in the list of calls.
    pub(super) fn move_in_call_list(&mut self, delta: isize) {
        let (keys, height) = (self.listed_requests(), self.list_height());
        let Some(list) = &mut self.view.call_list else { return };
        // Until it is moved, the first row is selected.
        list.cursor.update(&keys, height);
        list.cursor.move_by(&keys, delta, height);
    }

    /// Selects the call on a line of the list.
    pub(super) fn click_call_list(&mut self, line: usize) {
        let (keys, height) = (self.listed_requests(), self.list_height());
        if let Some(list) = &mut self.view.call_list {
            list.cursor.click(&keys, line, height);
        }
    }

    fn listed_requests(&self) -> Vec<u64> {
        self.calls_listed().iter().map(|call| call.request).collect()
    }

    /// Sorts the list of calls in the other order.
    pub(super) fn sort_call_list(&mut self) {
        let Some(list) = &mut self.view.call_list else { return };
        (list.is_by_latency, list.is_reversed) = (!list.is_by_latency, false);
        let text = if list.is_by_latency { "sorted slowest first" } else { "sorted newest first" };
        self.show_info(text);
    }

    /// Shows the request of the selected call among all frames; a filter that hides it is switched off.
    pub(super) fn go_to_call(&mut self) {
        let Some(call) = self.selected_call() else {
            return self.show_error("no call is selected");
        };
        let capture = &self.traffic.capture;
        let Some(frame) = capture.get(call.request) else {
            return self.show_error("frame no longer in the capture");
        };
        let filter = self.filters.of(Page::Traffic).active();
        let is_hidden = filter.is_some_and(|filter| {
            let matcher = filter.for_frames(self.shown_buses());
            !matcher.is_match(&frame, Some((capture, call.request)))
        });
        if is_hidden {
            self.filters.set_on(Page::Traffic, false);
        }
        self.view.traffic_view = TrafficView::Frames;
        let height = self.list_height();
        self.view.select_frame(call.request, height);
        self.filter_changed();
    }

    /// Counts identifiers and calls from the shown moment on, or again from the start.
    pub(super) fn toggle_counts_base(&mut self) {
        if self.view.counts_base.take().is_some() {
            return self.show_info("counts since the start");
        }
        if self.uncounted_frames() > 0 {
            return self.show_error("frames before the moment are still counted");
        }
        let time = self.shown_time();
        let frames = self.traffic.end(&self.view);
        let is_foreign = |bus| self.shown_buses().is_foreign(bus);
        let base = CountsBase::new(time, frames, self.identifiers(), self.calls(), is_foreign);
        self.view.counts_base = Some(Box::new(base));
        let key = self.key_of(crate::keymap::Action::TimeFormat);
        self.show_info(format!("counts since {}; {key} counts all", clock_millis(self, time)));
    }

    /// Term of the filter for the frames of calls.
    pub(super) fn term_of_calls(key: CallKey) -> String {
        let (client, service) = (key.client, key.service);
        match key.server {
            Some(server) => format!("at:{client} at:{server} srv:{service} not type:data"),
            None => format!("at:{client} srv:{service} (dst:all or type:rsp) not type:data"),
        }
    }
}
