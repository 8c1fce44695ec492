//! Bars of the page Bus: bus time by sender and by service, the longest first, and what keys do
//! with the selected one.
//!
//! Inputs: the sums of [`LoadShares`](super::LoadShares), the selection. Does not know how bars are
//! drawn.

use super::view::{BarKey, BusPageLayout, ChartSpan, Page};
use super::{App, Bus, ShareCounts};
use crate::frame::BusIndex;
use crate::text::Name;
use crate::wire::id::Address;
use ratatui::layout::{Position, Rect};
use std::ops::Range;
use std::sync::Arc;

/// A bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadBar {
    /// What it is about.
    pub key: BarKey,
    /// Its part of the bus time, 0–1; of the frames' bus time, where the bit rate is not known.
    pub share: f64,
}

impl Bus {
    /// The sums of a span of time.
    pub fn shares_of(&self, span: ChartSpan) -> Arc<ShareCounts> {
        self.meter.shares.span(span.seconds())
    }

    /// Part of the bus time of the counted seconds, 0–1; where the bit rate is not known, of the bus time
    /// of their frames. 0 before anything is counted.
    pub fn share_of(&self, bits: u64, counts: &ShareCounts) -> f64 {
        let base = if self.lacks_bit_rate() {
            counts.bits
        } else {
            counts.seconds * u64::from(self.bits_per_second())
        };
        bits as f64 / base.max(1) as f64
    }

    /// The bars by sender, the longest first.
    pub fn sender_bars(&self, bus: BusIndex, span: ChartSpan) -> Vec<LoadBar> {
        let counts = self.shares_of(span);
        let senders = counts.senders();
        self.bars(senders.map(|(address, bits)| (BarKey::Sender(bus, address), bits)), &counts)
    }

    /// The bars by service, the longest first.
    pub fn service_bars(&self, bus: BusIndex, span: ChartSpan) -> Vec<LoadBar> {
        let counts = self.shares_of(span);
        let services = counts.services();
        self.bars(services.map(|(service, bits)| (BarKey::Service(bus, service), bits)), &counts)
    }

    /// The bus time that has no bar of its own: of errors and frames of another protocol, if there
    /// are any, and the free time, if the bit rate is known.
    pub fn other_shares(&self, span: ChartSpan) -> Vec<(&'static str, f64)> {
        let counts = self.shares_of(span);
        // Of a bus of another protocol nothing has a bar of its own.
        let non_platform = if self.is_foreign() {
            counts.bits.saturating_sub(counts.errors)
        } else {
            counts.non_platform
        };
        let others = [("errors", counts.errors), ("non-platform", non_platform)];
        let mut shares: Vec<(&str, f64)> = Vec::with_capacity(3);
        let some = others.into_iter().filter(|(_, bits)| *bits > 0);
        shares.extend(some.map(|(word, bits)| (word, self.share_of(bits, &counts))));
        if !self.lacks_bit_rate() && counts.seconds > 0 {
            shares.push(("free", (1.0 - self.share_of(counts.bits, &counts)).max(0.0)));
        }
        shares
    }

    fn bars(
        &self,
        sums: impl Iterator<Item = (BarKey, u64)>,
        counts: &ShareCounts,
    ) -> Vec<LoadBar> {
        let is_foreign = self.is_foreign();
        let mut sums: Vec<(BarKey, u64)> = sums.filter(|_| !is_foreign).collect();
        // Of equal ones the lower number first: the sort is stable.
        sums.sort_by_key(|(_, bits)| std::cmp::Reverse(*bits));
        let bar = |(key, bits)| LoadBar { key, share: self.share_of(bits, counts) };
        sums.into_iter().map(bar).collect()
    }
}

/// Returns the number of lines for bars in an area with a heading, and for `others` below them, at
/// most a third: the first ones yield.
pub fn bar_lines(area: Rect, others: usize) -> (usize, usize) {
    let lines = usize::from(area.height.saturating_sub(1));
    let others = others.min(lines / 3);
    (lines - others, others)
}

impl App {
    /// Keys of all bars, in the order in which the selection goes through them.
    pub fn bar_keys(&self) -> Vec<BarKey> {
        let span = self.chart_span();
        let buses = self.buses().iter().enumerate();
        let bars = buses.flat_map(|(at, bus)| {
            let index = BusIndex(at as u8);
            [bus.sender_bars(index, span), bus.service_bars(index, span)]
        });
        bars.flatten().map(|bar| bar.key).collect()
    }

    /// The selected bar.
    pub fn selected_bar(&self) -> Option<BarKey> {
        self.view.bars.selected().copied()
    }

    /// Regions of the page Bus.
    pub fn bus_page(&self) -> BusPageLayout {
        let screen = self.screen();
        let height = screen.header.height + screen.list.height;
        let area = Rect { height, ..screen.header };
        let selected = self.selected_bar().map_or(0, |key| usize::from(key.bus().0));
        BusPageLayout::new(area, self.buses().len(), selected)
    }

    /// The time that the charts of the page Bus show.
    pub fn chart_span(&self) -> ChartSpan {
        self.view.chart_span
    }

    /// Shows the next span of time in charts and bars.
    pub(super) fn next_chart_span(&mut self) {
        self.view.chart_span = self.view.chart_span.next();
        self.settle_bars();
        self.notices.redraw.set_dirty();
    }

    /// Shows the span with more time, or with -1 less.
    pub(super) fn zoom_charts(&mut self, by: isize) {
        let Some(span) = self.view.chart_span.zoomed(by) else {
            return self.show_error("no other span of time");
        };
        self.view.chart_span = span;
        self.settle_bars();
        self.notices.redraw.set_dirty();
    }

    /// After a change of the bars: keeps the selection on its bar.
    pub(super) fn settle_bars(&mut self) {
        if self.view.page == Page::Bus {
            let keys = self.bar_keys();
            self.view.bars.update(&keys, keys.len());
        }
    }

    /// Numbers of the bars that are shown on so many lines: the longest ones, or those up to the
    /// selected one.
    pub fn bars_window(&self, bars: &[LoadBar], lines: usize) -> Range<usize> {
        let selected = self.selected_bar();
        let at = bars.iter().position(|bar| Some(bar.key) == selected).unwrap_or(0);
        let end = (at + 1).max(lines).min(bars.len());
        end.saturating_sub(lines)..end
    }

    /// Selects the bar at a place on the screen.
    pub(super) fn click_bar(&mut self, place: Position) {
        let (page, span) = (self.bus_page(), self.chart_span());
        let mut clicked = None;
        for (at, regions) in page.buses.iter().enumerate() {
            let index = BusIndex((page.first + at) as u8);
            let Some(bus) = self.bus(index) else { continue };
            for (area, bars, others) in [
                (regions.senders, bus.sender_bars(index, span), bus.other_shares(span).len()),
                (regions.services, bus.service_bars(index, span), 0),
            ] {
                let line = usize::from(place.y.saturating_sub(area.y));
                let (lines, _) = bar_lines(area, others);
                if area.contains(place) && (1..=lines).contains(&line) {
                    let window = self.bars_window(&bars, lines);
                    clicked = bars[window].get(line - 1).map(|bar| bar.key);
                }
            }
        }
        if let Some(key) = clicked {
            self.view.bars.select(key);
        }
    }

    /// Moves the selection by bars.
    pub(super) fn move_in_bars(&mut self, delta: isize) {
        let keys = self.bar_keys();
        self.view.bars.move_by(&keys, delta, keys.len());
    }

    /// Bus, address and name of the sender of the selected bar.
    pub(super) fn bar_subject(&self) -> (Option<BusIndex>, Option<Address>, Option<Name>) {
        match self.selected_bar() {
            Some(BarKey::Sender(bus, address)) => (Some(bus), Some(address), None),
            Some(BarKey::Service(bus, _)) => (Some(bus), None, None),
            None => (None, None, None),
        }
    }

    /// Goes to the device of the selected bar; of a service to its frames.
    pub(super) fn open_bar(&mut self) {
        match self.selected_bar() {
            Some(BarKey::Sender(bus, address)) => {
                let is_own = self.is_own_address(bus, address);
                let why =
                    if is_own { "address of descan: no row" } else { "no row for this address" };
                self.find_row(why);
            }
            Some(BarKey::Service(..)) => self.go_to_frames_of_bar(),
            None => self.show_error("no bar is selected"),
        }
    }

    /// Shows the frames of the selected bar.
    pub(super) fn go_to_frames_of_bar(&mut self) {
        let Some(key) = self.selected_bar() else {
            return self.show_error("no bar is selected");
        };
        let mut filter = match key {
            BarKey::Sender(_, address) => format!("src:{address}"),
            BarKey::Service(_, service) => format!("srv:{service}"),
        };
        let name = self.bus(key.bus()).map_or("", |bus| &bus.name);
        if self.buses().len() > 1 && !name.contains('"') {
            filter = format!("{filter} bus:\"={name}\"");
        }
        self.show_frames_matching(&filter);
    }

    /// The selected bar in one line, with its share.
    pub(super) fn bar_text(&self) -> Option<String> {
        let (key, span) = (self.selected_bar()?, self.chart_span());
        let bus = self.bus(key.bus())?;
        let bars = match key {
            BarKey::Sender(index, _) => bus.sender_bars(index, span),
            BarKey::Service(index, _) => bus.service_bars(index, span),
        };
        let share = bars.iter().find(|bar| bar.key == key)?.share * 100.0;
        let of = if bus.lacks_bit_rate() { "of the bus time of frames on" } else { "of" };
        let label = self.bar_label(key);
        Some(format!("{label} {share:.1} % {of} {}", bus.name))
    }

    /// Name and address of a sender, or name or number of a service.
    pub fn bar_label(&self, key: BarKey) -> String {
        match key {
            BarKey::Sender(index, address) => {
                let device = self.bus(index).and_then(|bus| bus.device_at(address));
                let name = device.and_then(|device| device.name.as_ref());
                // It may have left the address.
                let before = || self.bus(index)?.names().at(address, self.shown_time());
                match name.or_else(before) {
                    Some(name) => format!("{} @{address}", name.quoted()),
                    None if self.is_own_address(index, address) => format!("own @{address}"),
                    None => format!("? @{address}"),
                }
            }
            BarKey::Service(index, service) => self.service_name(index, service, None),
        }
    }
}
