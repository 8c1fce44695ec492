//! Commands of the Devices page: its views, and the heartbeats of a device.
//!
//! Inputs: keys, the selected row, the capture. Does not know how they are drawn.

use super::beat_strip::{Beat, BeatKind, beat_cells};
use super::capture::CapturedHeartbeat;
use super::view::{DeviceView, Page, Row, RowKey, RowState};
use super::{App, TrafficView};
use crate::time::{Duration, Instant};

/// Cells on a line of the heartbeat history: with the default period of 1 s, a line is a minute.
pub const BEATS_PER_LINE: usize = 60;
/// Most cells of the history: two hours of the default period. Bounds the work of a draw.
const MAX_BEATS: usize = 7200;

/// Joins two walks through heartbeats, both newest first.
fn newest_first(
    one: impl Iterator<Item = CapturedHeartbeat>,
    other: impl Iterator<Item = CapturedHeartbeat>,
) -> impl Iterator<Item = CapturedHeartbeat> {
    let (mut one, mut other) = (one.peekable(), other.peekable());
    std::iter::from_fn(move || {
        let is_other = match (one.peek(), other.peek()) {
            (Some(one), Some(other)) => other.number > one.number,
            (one, _) => one.is_none(),
        };
        if is_other { other.next() } else { one.next() }
    })
}

impl App {
    /// Heartbeats of a row until the moment that is shown, a cell for each period, oldest first, at
    /// most `most`; none for an entry without a device.
    pub fn beats_of(&self, row: &Row, most: usize) -> Vec<Beat> {
        let Some(device) = self.device_of(row) else { return Vec::new() };
        let Some(bus) = self.bus(device.id.bus) else { return Vec::new() };
        let current = bus.device_at(device.address).map(|it| it.id);
        let board = row.board.map(|board| board.sender);
        // Heartbeats at the address after another device took it are not of this one, except those with
        // the UID of its board.
        let is_replaced = current != Some(device.id) && board.is_none();
        let last = device.heartbeat.last.filter(|_| is_replaced);
        if is_replaced && last.is_none() {
            return Vec::new();
        }
        let moved = device.uid.filter(|uid| device.moved_from.is_some() && !uid.is_blank());
        let is_own = |beat: &CapturedHeartbeat| {
            last.is_none_or(|last| beat.time <= last)
                && board.is_none_or(|board| board.has_uid(beat.uid))
                && moved.is_none_or(|uid| board.is_some() || beat.uid == Some(uid))
        };
        let period = bus.heartbeat_period(device.address);
        let beats = self.heartbeats(device.id.bus, device.address);
        let here = beats.take(MAX_BEATS * 4).filter(is_own);
        // Between its stays at this address it was at the other one.
        let before = moved.and(device.moved_from).filter(|_| board.is_none());
        let before = before.map(|address| self.heartbeats(device.id.bus, address));
        let there = before.into_iter().flatten().take(MAX_BEATS * 4).filter(is_own);
        let beats = newest_first(here, there);
        // Earlier ones are of another device at the address.
        let begin = match board {
            Some(board) => board.since,
            None if device.moved_from.is_some() => Instant::ZERO,
            None => device.first_seen,
        };
        let beats = beats.take_while(|beat| beat.time >= begin);
        let end = bus.ended.unwrap_or(self.shown_time());
        let after = match row.state {
            RowState::Unknown | RowState::Asleep => BeatKind::Unknown,
            _ => BeatKind::Missed,
        };
        let mut cells = beat_cells(beats, period, end, after, most);
        // While the bus was down no heartbeat could be heard.
        let history = &bus.meter.history;
        for cell in cells.iter_mut().filter(|cell| cell.kind == BeatKind::Missed) {
            if history.is_unknown_near(cell.time.as_micros() / 1_000_000) {
                cell.kind = BeatKind::Unknown;
            }
        }
        cells
    }

    /// Heartbeat period of the device of a row: measured, else that of the profile.
    pub fn heartbeat_period(&self, row: &Row) -> Option<Duration> {
        let device = self.device_of(row)?;
        Some(self.bus(device.id.bus)?.heartbeat_period(device.address))
    }

    /// Cells of the heartbeat history of the selected device, oldest first. They begin with a whole
    /// line.
    pub fn beat_history(&self) -> Vec<Beat> {
        let Some(row) = self.selected_row() else { return Vec::new() };
        let Some(period) = self.heartbeat_period(row) else { return Vec::new() };
        let mut beats = self.beats_of(row, MAX_BEATS);
        // The first cells are dropped a line at a time: a line keeps its cells while time passes.
        if beats.len() == MAX_BEATS {
            let line = (period.as_micros() as u64).max(1) * BEATS_PER_LINE as u64;
            let first = beats[0].time.as_micros() / line;
            beats.retain(|beat| beat.time.as_micros() / line > first);
        }
        beats
    }

    /// Index of the chosen cell among those of the history; `None` while none is chosen.
    pub fn chosen_beat(&self, beats: &[Beat]) -> Option<usize> {
        let time = self.view.devices_page.beat?;
        let at = beats.partition_point(|beat| beat.time < time);
        let before = at.checked_sub(1);
        let near = [before, Some(at)].into_iter().flatten().filter(|at| *at < beats.len());
        near.min_by_key(|&at| beats[at].time.as_micros().abs_diff(time.as_micros()))
    }

    /// Shows the next view of the Devices page.
    pub(super) fn next_device_view(&mut self) {
        let page = &mut self.view.devices_page;
        page.view = page.view.next();
    }

    /// Opens or closes the heartbeat history of the selected device; from another page, goes to the
    /// device first.
    pub(super) fn toggle_beat_history(&mut self) {
        if self.view.page == Page::Devices && self.view.devices_page.shows_history {
            return self.close_beat_history();
        }
        if !self.go_to_row() {
            return;
        }
        if self.selected_device().is_none() {
            return self.show_error("no heartbeats: not on the bus");
        }
        self.view.focus_details(false);
        self.view.devices_page.shows_history = true;
        self.view.devices_page.beat = None;
    }

    /// Closes the heartbeat history.
    pub(super) fn close_beat_history(&mut self) {
        self.view.devices_page.shows_history = false;
        self.view.details_scroll = 0;
    }

    /// Returns true if the heartbeat history is open.
    pub fn shows_beat_history(&self) -> bool {
        self.view.page == Page::Devices && self.view.devices_page.shows_history
    }

    /// Chooses a heartbeat of the history by cells from the chosen one, at first the newest.
    pub(super) fn choose_beat(&mut self, by: isize) {
        let beats = self.beat_history();
        let Some(newest) = beats.len().checked_sub(1) else { return };
        let at = match self.chosen_beat(&beats) {
            Some(at) => at.saturating_add_signed(by).min(newest),
            None if by.unsigned_abs() > 1 => newest.saturating_add_signed(by).min(newest),
            None => newest,
        };
        self.view.devices_page.beat = Some(beats[at].time);
    }

    /// Moves along the page with Left and Right: through the heartbeats of the history, or through
    /// the services. Returns false if nothing there moves.
    pub(super) fn move_along_devices(&mut self, by: isize) -> bool {
        if self.view.page != Page::Devices {
            return false;
        }
        if self.view.devices_page.shows_history {
            self.choose_beat(by);
            return true;
        }
        let page = &self.view.devices_page;
        if page.view != DeviceView::Services {
            return false;
        }
        let table = super::ServiceTable::new(self);
        let width = usize::from(self.screen().list.width);
        let fitting = table.fitting(self, width, page.first_service);
        let last = table.names.len().saturating_sub(1);
        if page.first_service == 0 && fitting >= table.names.len() {
            return false;
        }
        let first = page.first_service.min(last).saturating_add_signed(by).min(last);
        let shows_end = page.first_service + fitting >= table.names.len();
        if by < 0 || !shows_end {
            self.view.devices_page.first_service = first;
        }
        true
    }

    /// Shows the frames around the chosen heartbeat, else around the newest.
    pub(super) fn go_to_beat(&mut self) {
        let beats = self.beat_history();
        let at = self.chosen_beat(&beats).or(beats.len().checked_sub(1));
        let Some(beat) = at.and_then(|at| beats.get(at)) else {
            return self.show_error("no heartbeats captured");
        };
        let number = beat.number.unwrap_or_else(|| self.traffic.capture.at_time(beat.time));
        let end = self.traffic.end(&self.view);
        let number = number.min(end.saturating_sub(1));
        if self.traffic.capture.get(number).is_none() {
            return self.show_error("frames no longer in the capture");
        }
        self.go_from_here(|app| {
            app.show_page(Page::Traffic);
            app.view.traffic_view = TrafficView::Frames;
            app.filters.clear(Page::Traffic);
            app.filter_changed();
            let height = app.list_height();
            app.view.select_frame(number, height);
        });
    }

    /// Shows the frames of the selected device.
    pub(super) fn go_to_frames_of_device(&mut self) {
        let Some(row) = self.selected_row() else {
            return self.show_error("no row is selected");
        };
        if row.address.is_none() {
            return self.show_error("no frames: not on the bus");
        }
        let mut addresses: Vec<_> = row.addresses(self.shown_buses()).collect();
        addresses.sort_unstable();
        addresses.dedup();
        let all: Vec<String> = addresses.iter().map(ToString::to_string).collect();
        let is_of_all = !row.redundant_ids.is_empty();
        let term = self.bus_term(row.bus.filter(|_| !is_of_all));
        self.show_frames_matching(&format!("at:{}{term}", all.join(",")));
    }

    /// The reason why the entry of the selected row is not edited: it belongs to another board at
    /// the address; `None` if it may be.
    pub(super) fn board_refusal(&self) -> Option<String> {
        let row = self.selected_row()?;
        let (RowKey::Board(..), Some(address)) = (&row.key, row.address) else { return None };
        Some(format!("{address} is shared: edit the row {address}A"))
    }
}
