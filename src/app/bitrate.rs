//! Bit rate search in the app: question, progress and result for the user.
//!
//! Does not search: the shell executes [`Effect::FindBitrate`].

use super::notices::TimelineEntry;
use super::timeline_kind::TimelineKind;
use super::{App, Effect, Question};
use crate::bitrate::{SearchOutcome, SearchProgress, kbit};
use crate::frame::BusIndex;
use crate::status::RateSearch;

impl App {
    /// Opens the question for a bit rate search on the bus with bus errors only, else on the bus of
    /// the selected row.
    pub(super) fn ask_bitrate(&mut self) {
        if let Some(bus) = self.buses.searched().and_then(|bus| self.bus(bus)) {
            let name = bus.name.clone();
            return self.show_error(format!("bit rate search on {name} is already running"));
        }
        let broken = self.buses().iter().position(super::Bus::has_only_bus_errors);
        let broken = broken.and_then(|at| u8::try_from(at).ok()).map(BusIndex);
        let selected = self.selected_row().and_then(|row| row.bus);
        let bus = broken.or(selected).unwrap_or_default();
        let Some(there) = self.bus(bus) else {
            return self.show_error("no bus is open");
        };
        let name = &there.name;
        let refusal = match there.status.rate_search {
            RateSearch::Possible => None,
            RateSearch::NoRate => Some(format!("{name}: bit rate cannot be set from here")),
            RateSearch::WhenClosed => {
                let adapter = name.split_once('@').map_or(&**name, |(adapter, _)| adapter);
                Some(format!("quit descan, then run: descan speed {adapter}"))
            }
        };
        if let Some(refusal) = refusal {
            return self.show_error(refusal);
        }
        self.input.ask(Question::FindBitrate(bus));
        self.notices.redraw.set_dirty();
    }

    /// Starts the search.
    pub(super) fn find_bitrate(&mut self, bus: BusIndex) {
        self.buses.set_searched(self.clock.now(), Some(bus));
        self.effects.push_back(Effect::FindBitrate(bus));
    }

    /// Reports the progress of the search.
    pub(super) fn report_bitrate_search(&mut self, bus: BusIndex, progress: SearchProgress) {
        let Some(name) = self.bus(bus).map(|bus| bus.name.clone()) else { return };
        match progress {
            SearchProgress::Trying(rate) => {
                self.show_info(format!("{name}: listening at {} …", kbit(rate)));
            }
            SearchProgress::NothingValid(rate, heard) => {
                let text = match heard.bus_errors {
                    0 => format!("no frames at {}", kbit(rate)),
                    broken => format!("{broken} bus errors at {}, no valid frame", kbit(rate)),
                };
                self.report_bus(bus, TimelineKind::Bus, text);
            }
            SearchProgress::Skipped(rate) => {
                self.report_bus(
                    bus,
                    TimelineKind::Bus,
                    format!("{} not supported by the controller", kbit(rate)),
                );
            }
        }
        self.notices.redraw.set_dirty();
    }

    /// Reports the result of the search.
    pub(super) fn bitrate_found(&mut self, bus: BusIndex, result: Result<SearchOutcome, String>) {
        self.buses.set_searched(self.clock.now(), None);
        let Some(name) = self.bus(bus).map(|bus| bus.name.clone()) else { return };
        match result {
            Ok(SearchOutcome::Found(rate)) => {
                let text = format!("valid frames at {}: bit rate kept", kbit(rate));
                self.show_info(format!("{name}: {text}"));
                self.report_bus(bus, TimelineKind::Bus, text);
            }
            Ok(SearchOutcome::OnlyBusErrors | SearchOutcome::NoTraffic) => {
                let text = "no valid frame at any bit rate; previous setting restored";
                self.report_bus(bus, TimelineKind::Error, text.to_owned());
                self.show_error(format!(
                    "{name}: no valid frame; if only one device is on, run: descan speed {name}"
                ));
            }
            Err(why) => {
                self.report_bus(bus, TimelineKind::Error, why.clone());
                self.show_error(why);
            }
        }
        self.notices.redraw.set_dirty();
    }

    fn report_bus(&mut self, bus: BusIndex, kind: TimelineKind, text: String) {
        self.report_line(TimelineEntry::new(self.now(), kind, text).on(bus));
    }
}
