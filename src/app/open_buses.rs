//! The list of buses over a running session: buses are added to those that are open, or replace them.
//!
//! Inputs: keys, what the machine has. Outputs: which buses to open. While the list is shown, frames are
//! received and nothing is sent. Does not know how buses are opened.

use super::bus_choice::{BusChoice, BusOffer, BusSelection, ChoiceOutcome, OpenBuses};
use super::{App, Effect};
use crate::frame::BusIndex;
use crate::keymap::Key;
use crate::status::{BusStatus, Link};
use crate::time::Instant;

impl App {
    /// The list of buses; `None` unless it is shown.
    pub fn bus_choice(&self) -> Option<&BusChoice> {
        self.bus_choice.as_deref()
    }

    /// Shows the list of buses.
    pub(super) fn list_buses(&mut self) {
        let is_log = |status: &BusStatus| matches!(status.link, Link::Ended);
        let has_log = self.playback().is_some() || self.buses.iter().any(|it| is_log(&it.status));
        let mut arguments: Vec<String> = self.buses.iter().map(|bus| bus.name.clone()).collect();
        let reason = format!("{} open; nothing is sent meanwhile", arguments.join(", "));
        if self.is_of_logs() && !self.logs.is_empty() {
            // The names are those that their buses had.
            arguments.clear();
        }
        arguments.extend(self.logs.iter().map(|path| format!("file:{}", path.display())));
        let open = OpenBuses { arguments, has_log };
        let keymap = self.keymap().clone();
        let choice = BusChoice::new(reason, Vec::new()).with_keymap(keymap).over(open);
        self.bus_choice = Some(Box::new(choice));
        self.pause_sending(true);
        self.effects.push_back(Effect::ListBuses);
    }

    /// Handles a key while the list is shown; returns false if it is not.
    pub(super) fn type_in_bus_choice(&mut self, key: Key) -> bool {
        let has_edits = self.unsaved_edits() > 0;
        let Some(choice) = &mut self.bus_choice else { return false };
        match choice.handle_key(key) {
            None | Some(ChoiceOutcome::NextTheme) => {}
            Some(ChoiceOutcome::Copy(text)) => self.effects.push_back(Effect::Copy(text)),
            Some(ChoiceOutcome::Close) => self.close_bus_choice(),
            Some(ChoiceOutcome::Open(wanted)) if wanted.replaces && has_edits => {
                choice.show("edits are not saved; Esc, then save or undo them first");
            }
            Some(ChoiceOutcome::Open(wanted)) => self.open_chosen(wanted),
        }
        true
    }

    fn open_chosen(&mut self, wanted: BusSelection) {
        self.close_bus_choice();
        self.effects.push_back(Effect::OpenBuses(wanted));
    }

    fn close_bus_choice(&mut self) {
        self.bus_choice = None;
        self.pause_sending(false);
    }

    /// Takes what the machine has, while the list is shown.
    pub fn handle_offers(&mut self, now: Instant, offers: Vec<BusOffer>) {
        self.clock.set(now);
        if self.bus_choice.as_mut().is_some_and(|choice| choice.handle_offers(offers)) {
            self.notices.redraw.set_dirty();
        }
    }

    /// Takes the result of an [`Effect::OpenBuses`] that added buses: their names, or the cause.
    pub fn handle_opened(&mut self, now: Instant, result: Result<Vec<String>, String>) {
        self.clock.set(now);
        match result {
            Ok(names) => self.show_info(format!("opened {}", names.join(", "))),
            Err(why) => self.show_error(why),
        }
        self.notices.redraw.set_dirty();
    }

    /// Sends nothing on any bus, or again.
    fn pause_sending(&mut self, is_paused: bool) {
        for at in 0..self.buses.len() {
            let Some(bus) = self.buses.as_slice().get(at) else { continue };
            let status = BusStatus { is_sending_paused: is_paused, ..bus.status.clone() };
            self.buses.update_status(self.clock.now(), BusIndex(at as u8), status);
        }
        self.take_events();
    }
}
