//! The search for a bus's bit rate, as far as the user sees it: asked for, told of, ended.
//!
//! Sets and hears nothing itself.

use super::timeline::{Entry, Kind};
use super::{App, Effect, Overlay, Question};
use crate::frame::BusIndex;
use crate::speed::{Outcome, Progress, kbit};
use crate::status::RateSearch;

impl App {
    /// Command: ask whether to look for the bit rate of the selected row's bus, or of the one where
    /// frames only break.
    pub fn ask_bitrate(&mut self) {
        if let Some(bus) = self.searched.and_then(|bus| self.bus(bus)) {
            let name = bus.name.clone();
            return self.complain(format!("the bit rate of {name} is being looked for"));
        }
        let broken = self.buses.iter().position(super::Bus::hears_only_errors);
        let broken = broken.and_then(|at| u8::try_from(at).ok()).map(BusIndex);
        let selected = self.selected_row().and_then(|row| row.bus);
        let bus = broken.or(selected).unwrap_or_default();
        let Some(there) = self.bus(bus) else {
            return self.complain("there is no bus");
        };
        let name = &there.name;
        let refusal = match there.status.rate_search {
            RateSearch::Possible => None,
            RateSearch::NoRate => {
                Some(format!("{name} has no bit rate that could be set from here"))
            }
            RateSearch::WhenClosed => {
                let adapter = name.split_once('@').map_or(&**name, |(adapter, _)| adapter);
                Some(format!("end descan, then: descan speed {adapter}"))
            }
        };
        if let Some(refusal) = refusal {
            return self.complain(refusal);
        }
        self.overlay = Overlay::Question(Question::FindBitrate(bus));
        self.dirty = true;
    }

    /// Whether the bit rate of that bus is being looked for.
    pub fn searches_bitrate_of(&self, bus: BusIndex) -> bool {
        self.searched == Some(bus)
    }

    pub(super) fn find_bitrate(&mut self, bus: BusIndex) {
        self.searched = Some(bus);
        self.effects.push_back(Effect::FindBitrate(bus));
    }

    pub(super) fn tell_bitrate_search(&mut self, bus: BusIndex, progress: Progress) {
        let Some(name) = self.bus(bus).map(|bus| bus.name.clone()) else { return };
        match progress {
            Progress::Trying(rate) => self.say(format!("{name}: listening at {} …", kbit(rate))),
            Progress::Heard(rate, heard) => {
                let text = match heard.broken {
                    0 => format!("nothing is heard at {}", kbit(rate)),
                    broken => format!("{broken} frames broke at {}, none came whole", kbit(rate)),
                };
                self.tell_of_bus(bus, Kind::Bus, text);
            }
            Progress::Skipped(rate) => {
                self.tell_of_bus(bus, Kind::Bus, format!("cannot have {}", kbit(rate)));
            }
        }
        self.dirty = true;
    }

    pub(super) fn bitrate_found(&mut self, bus: BusIndex, result: Result<Outcome, String>) {
        self.searched = None;
        let Some(name) = self.bus(bus).map(|bus| bus.name.clone()) else { return };
        match result {
            Ok(Outcome::Found(rate)) => {
                let text = format!("frames arrive whole at {}: it stays there", kbit(rate));
                self.say(format!("{name}: {text}"));
                self.tell_of_bus(bus, Kind::Bus, text);
            }
            Ok(Outcome::OnlyBroken | Outcome::Silence) => {
                let text = "no frame arrived whole at any bit rate; set back as it was";
                self.tell_of_bus(bus, Kind::Error, text.to_owned());
                self.complain(format!(
                    "{name}: no whole frame at any rate; a lone device needs: descan speed {name}"
                ));
            }
            Err(why) => {
                self.tell_of_bus(bus, Kind::Error, why.clone());
                self.complain(why);
            }
        }
        self.dirty = true;
    }

    fn tell_of_bus(&mut self, bus: BusIndex, kind: Kind, text: String) {
        self.tell_line(Entry::new(self.now, kind, text).on(bus));
    }
}
