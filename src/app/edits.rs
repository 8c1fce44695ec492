//! The commands that edit des.json or ask the bus for something.
//!
//! Every edit is an operation of [`crate::document`]; nothing is written here, and nothing that
//! goes beyond discovery is sent without a confirmation.

use super::buses::Bus;
use super::problems::as_listed;
use super::prompt::PromptKind;
use super::timeline::{TimelineEntry as Line, TimelineKind};
use super::{App, Change, Effect, Overlay, Question, RowKey};
use crate::discovery::{Confidence, Device, DeviceId, OwnAddress};
use crate::document::{Document, EntryKey, ListedService, NewEntry, Operation};
use crate::frame::{BusIndex, Frame};
use crate::keymap::Action;
use crate::text::Escaped;
use crate::wire::id::{Header, Service};
use std::path::Path;

impl App {
    // ---- des.json --------------------------------------------------------------------------

    /// Command: edit the static address in the selected row.
    pub(super) fn edit_address(&mut self) {
        if !self.may_edit() || !self.go_to_row() {
            return;
        }
        let Some(row) = self.selected_row() else { return self.show_error("no row is selected") };
        let key = row.key.clone();
        if let Some(device) = self.device_of(row) {
            if device.is_debug {
                return self.show_error("debug devices cannot be added to the file");
            }
            if device.name.is_none() {
                return self.show_error("name not known yet: cannot add the device");
            }
        }
        let entry = self.entry_of(row).map(|entry| entry.index);
        if !self.may_edit_entry(entry) {
            return;
        }
        let text = self.pinned_text(&key);
        self.open_prompt(PromptKind::Address(key), text);
    }

    /// Command: take the selected device into the file, with its services and its address (which
    /// is not pinned by that); where it is listed, take its services.
    pub(super) fn add_device(&mut self) {
        if !self.may_edit() || !self.go_to_row() {
            return;
        }
        let Some(row) = self.selected_row().filter(|row| self.device_of(row).is_some()) else {
            return self.show_error("no device in this row to add");
        };
        if self.devices_of(row).any(|device| device.name.is_none() || device.is_debug) {
            return self.show_error("only devices with a known name can be added");
        }
        // Where buses are redundant, on each of them.
        let operations: Vec<Operation> =
            self.devices_of(row).filter_map(|device| self.taking(device)).collect();
        match operations.len() {
            0 => self.say_of_file("file already matches this device"),
            _ => self.edit(&operations),
        }
    }

    /// Command: take all devices that are there into the file, and where it lists other services than
    /// they have, theirs. Entries that cannot be edited are left, and that is said.
    pub(super) fn add_all(&mut self) {
        if !self.may_edit() {
            return;
        }
        let devices = self.buses.iter().flat_map(|bus| bus.engine.devices());
        let known = devices
            .filter(|device| device.is_present() && !device.is_debug && device.name.is_some());
        // Where it lists none, that is how its author wants it: left out or an empty list.
        let (mut wanted, left): (Vec<&Device>, Vec<&Device>) = known.partition(|device| {
            let entry = self.matching.entry_of(device.id);
            let entry = entry.map(|at| &self.file.document().entries()[at]);
            entry.is_none_or(|entry| entry.listed_services().is_some())
        });
        wanted.sort_by_key(|device| (device.id.bus, device.address));
        let (mut operations, mut refused) = (Vec::new(), Vec::new());
        for device in wanted {
            let Some(operation) = self.taking(device) else { continue };
            match self.file.check_operation(&operation) {
                Ok(()) => operations.push(operation),
                Err(refusal) => refused.push(refusal.to_string()),
            }
        }
        match operations.len() {
            0 if !refused.is_empty() => {}
            0 if left.is_empty() => {
                self.say_of_file("all named devices are already in the file");
            }
            0 => {
                let (left, key) = (left.len(), self.key_of(Action::Add));
                self.say_of_file(format!(
                    "all named devices are in the file; {left} without services ({key} adds them)"
                ));
            }
            _ => self.edit(&operations),
        }
        if let Some(refusal) = refused.first() {
            self.complain_of_file(format!("{} not added: {refusal}", refused.len()));
        }
    }

    /// Command: ask for a new entry.
    pub(super) fn ask_new_entry(&mut self) {
        if self.may_edit() {
            self.open_prompt(PromptKind::NewEntry, String::new());
        }
    }

    /// Command: ask for the entry's new name.
    pub(super) fn ask_rename(&mut self) {
        if !self.may_edit() || !self.go_to_row() {
            return;
        }
        let Some((at, _)) = self.selected_entry() else { return };
        let document = self.file.document();
        let (key, name) = (document.key(at), document.entries()[at].name_text.clone());
        if !self.may_edit_entry(Some(at)) {
            return;
        }
        self.open_prompt(PromptKind::Rename(key), name);
    }

    /// Command: ask whether the entry is to be deleted.
    pub(super) fn ask_delete(&mut self) {
        if !self.may_edit() || !self.go_to_row() {
            return;
        }
        let Some((at, _)) = self.selected_entry() else { return };
        let document = self.file.document();
        let (key, text) = (document.key(at), document.entry_text(at).to_owned());
        self.overlay = Overlay::Question(Question::Delete(key, text));
    }

    /// Command: take the last edit back.
    pub(super) fn undo(&mut self) {
        match self.file.undo() {
            Ok(name) => self.edited(&format!("undid: {name}")),
            Err(refusal) => self.complain_of_file(refusal.to_string()),
        }
    }

    /// Command: make the edit again that was taken back last.
    pub(super) fn redo(&mut self) {
        match self.file.redo() {
            Ok(name) => self.edited(&format!("redid: {name}")),
            Err(refusal) => self.complain_of_file(refusal.to_string()),
        }
    }

    /// Command: save again what could not be saved.
    pub(super) fn save(&mut self) {
        if self.file.conflict().is_some() {
            self.show_conflict();
            // Who asks for the page means it.
            self.type_ahead = None;
        } else if self.file.unsaved() == 0 {
            self.say_of_file("no unsaved changes");
        } else if let Err(super::EditRefusal::Broken(why)) = self.file.check() {
            self.complain_of_file(format!("not saved; fix it first: {why}"));
        } else {
            self.save_pending();
        }
    }

    /// Command: ask where a copy of the file with all edits is to be written, as where the file
    /// itself cannot be.
    pub(super) fn ask_copy_path(&mut self) {
        if !self.file.is_there() {
            return self.show_error("nothing to save");
        }
        let path = format!("des-{}.json", stamp(self.wall_seconds(self.now)));
        self.open_prompt(PromptKind::CopyPath, path);
    }

    /// Shows both values; a line being typed waits until that is decided.
    pub(super) fn show_conflict(&mut self) {
        if !matches!(self.overlay, Overlay::Conflict) {
            self.note_choice();
        }
        if let Overlay::Prompt(prompt) = std::mem::replace(&mut self.overlay, Overlay::Conflict) {
            self.suspended_prompt = Some(prompt);
        }
    }

    fn leave_conflict(&mut self) {
        self.type_ahead = None;
        self.overlay = self.suspended_prompt.take().map_or(Overlay::None, Overlay::Prompt);
    }

    /// The file changed again, and there is nothing to choose any more: the page goes, and says so.
    pub(super) fn leave_conflict_that_is_over(&mut self, change: Change) {
        if !matches!(self.overlay, Overlay::Conflict) || self.file.conflict().is_some() {
            return;
        }
        self.leave_conflict();
        if change != Change::Broken {
            let text = "file changed again: conflict resolved, your edits are included";
            self.timeline.push(Line::new(self.now, TimelineKind::File, text));
            self.show_info(text);
        }
    }

    /// Command: decide the conflict; where there are several, the next one is shown.
    pub(super) fn resolve(&mut self, ours: bool) {
        // What the file says at the moment is not known: the choice would be between ours and what
        // it said before.
        if let Err(super::EditRefusal::Broken(_)) = self.file.check() {
            return self.effects.push_back(Effect::Bell);
        }
        self.leave_conflict();
        let (mut kept, mut given_up) = self.file.chosen();
        *(if ours { &mut kept } else { &mut given_up }) += 1;
        let change = self.file.resolve(ours);
        self.file_changed(change);
        // Who chooses already knows the page.
        self.type_ahead = None;
        if self.file.conflict().is_none() {
            let whose = match (kept, given_up) {
                (1, 0) => "kept your value".to_owned(),
                (0, 1) => "kept the file's value".to_owned(),
                (ours, 0) => format!("kept your {ours} values"),
                (0, theirs) => format!("kept the file's {theirs} values"),
                (ours, theirs) => format!("kept {ours} of your values, {theirs} of the file's"),
            };
            self.timeline.push(Line::new(
                self.now,
                TimelineKind::File,
                format!("edit conflict: {whose}"),
            ));
            self.say_of_file(whose);
        }
    }

    /// Command: leave the conflict for later; the edit stays unsaved.
    pub(super) fn resolve_later(&mut self) {
        self.leave_conflict();
        let key = self.key_of(Action::Save);
        self.show_info(format!("edit not saved; {key} reopens the conflict"));
    }

    pub(super) fn edit(&mut self, operations: &[Operation]) {
        match self.file.edit(operations) {
            Ok(name) => self.edited(&name),
            Err(refusal) => self.complain_of_file(refusal.to_string()),
        }
    }

    fn edited(&mut self, what: &str) {
        self.timeline.push(Line::new(self.now, TimelineKind::File, what));
        self.say_of_file(what);
        self.save_pending();
        self.refresh();
    }

    fn may_edit(&mut self) -> bool {
        match self.file.check_edit(None) {
            Ok(()) => true,
            Err(super::EditRefusal::Conflict) => {
                self.show_conflict();
                false
            }
            Err(refusal) => {
                self.complain_of_file(refusal.to_string());
                false
            }
        }
    }

    /// What cannot be edited is told before anything is typed.
    fn may_edit_entry(&mut self, place: Option<usize>) -> bool {
        let checked = self.file.check_edit(place);
        if let Err(refusal) = &checked {
            self.complain_of_file(refusal.to_string());
        }
        checked.is_ok()
    }

    /// The place and name of the selected row's entry; complains where it has none.
    fn selected_entry(&mut self) -> Option<(usize, String)> {
        let row = self.selected_row();
        let found = row.and_then(|row| self.entry_of(row));
        let found = found.map(|entry| (entry.index, entry.name_text.clone()));
        if found.is_none() {
            let key = self.key_of(Action::Add);
            self.show_error(format!("not in file; {key} adds the device"));
        }
        found
    }

    /// The operation that makes the file say of a device what it says itself.
    fn taking(&self, device: &Device) -> Option<Operation> {
        let document = self.file.document();
        let Some(at) = self.matching.entry_of(device.id) else {
            return Some(Operation::Add { entry: self.new_entry(device)? });
        };
        let own = device.services.as_ref()?;
        let entry = &document.entries()[at];
        if super::same_services(entry, own) {
            return None;
        }
        let listed = entry.services.as_deref().unwrap_or_default();
        let mut services = listed_services(device);
        leave_open(&mut services, listed);
        Some(Operation::SetServices { entry: document.key(at), services })
    }

    /// What the file is to say of a device: its address as the last main one, not pinned.
    pub fn new_entry(&self, device: &Device) -> Option<NewEntry> {
        let engine = &self.bus(device.id.bus)?.engine;
        let alphabet = &engine.config().profile.uid;
        // Where two share an address, what beat last may be the other one.
        let is_shared = engine.findings().iter().any(|finding| {
            finding.key.kind.is_conflict()
                && finding.confidence != Confidence::Cleared
                && finding.addresses.contains(&device.address)
        });
        let uid = device.uid.filter(|uid| !uid.is_blank() && !is_shared);
        let uid = uid.map(|uid| uid.text(alphabet).to_string());
        Some(NewEntry {
            name: device.name.as_ref()?.as_bytes().to_vec(),
            address: Some(device.address.number()).filter(|address| *address > 0),
            is_static: false,
            bus: self.bus_to_name(Some(device.id.bus)),
            uid: uid.filter(|uid| !uid.trim().is_empty()),
            services: listed_services(device),
        })
    }

    /// The bus that an entry is to name: none, while there is only one.
    pub(super) fn bus_to_name(&self, bus: Option<BusIndex>) -> Option<String> {
        let bus = self.bus(bus?)?;
        (self.buses.len() > 1).then(|| bus.name.clone())
    }

    // ---- the bus ---------------------------------------------------------------------------

    /// Command: ask all devices again.
    pub(super) fn rescan(&mut self) {
        let asks = |bus: &&Bus| !bus.engine.config().listen_only;
        let asking = self.buses.iter().filter(asks).count();
        let able = self.buses.iter().filter(asks).filter(|bus| bus.is_up()).count();
        for bus in &mut self.buses {
            bus.engine.rescan(self.now);
        }
        self.take_events();
        if asking == 0 {
            self.show_error("listen-only: no requests are sent");
        } else if able == 0 {
            self.show_error("no bus is up: cannot send requests");
        } else {
            self.show_info("enumeration restarted");
        }
    }

    /// Command: forget the devices that are lost.
    pub(super) fn clear_lost(&mut self) {
        let lost = self.counts.lost;
        for bus in &mut self.buses {
            bus.engine.clear_lost();
        }
        self.take_events();
        self.refresh();
        self.show_info(match lost {
            0 => "no lost devices".to_owned(),
            1 => "1 lost device removed".to_owned(),
            lost => format!("{lost} lost devices removed"),
        });
    }

    /// Command: ask whether the device is to blink or beep.
    pub(super) fn ask_identify(&mut self) {
        if !self.go_to_row() {
            return;
        }
        let Some(device) = self.selected_row().and_then(|row| self.device_of(row)) else {
            return self.show_error("no device is selected");
        };
        let id = device.id;
        match self.identify_frame(id) {
            Ok(_) => self.overlay = Overlay::Question(Question::Identify(id)),
            Err(why) => self.show_error(why),
        }
    }

    /// The frame that lets a device blink or beep, or why it is not sent.
    fn identify_frame(&self, id: DeviceId) -> Result<Frame, &'static str> {
        let (Some(device), Some(bus)) = (self.device(id), self.bus(id.bus)) else {
            return Err("device is no longer on the bus");
        };
        let config = bus.engine.config();
        if config.listen_only {
            return Err("listen-only: descan does not transmit");
        }
        if !config.profile.given {
            return Err("identify needs --profile: its service number is assumed");
        }
        if !bus.is_up() {
            return Err("the bus is not up");
        }
        let OwnAddress::Held(own) = bus.engine.own_address() else {
            return Err("descan has no address on this bus yet");
        };
        let service = Service::from_bits(config.profile.commands.identify);
        let mut header = Header::request(own, device.address, !device.working, service);
        header.no_error = config.profile.request_err;
        Ok(Frame::classic(header.encode(), &[]).with_bus(id.bus).with_time(self.now))
    }

    // ---- questions -------------------------------------------------------------------------

    /// The question that waits, in words.
    pub fn question(&self) -> Option<String> {
        let Overlay::Question(question) = &self.overlay else { return None };
        Some(match question {
            Question::Quit => {
                let edits = match self.file.unsaved() {
                    1 => "1 edit is".to_owned(),
                    many => format!("{many} edits are"),
                };
                if let Some(path) = self.copy_of_edits() {
                    let path = Escaped(path.as_os_str().as_encoded_bytes());
                    format!("{edits} saved only in {path}. Quit anyway?")
                } else if self.file.is_saving() {
                    format!("{edits} still being saved. Quit without waiting?")
                } else {
                    format!("{edits} not saved. Quit anyway?")
                }
            }
            Question::Delete(key, _) => {
                format!("Delete the entry {key:#} from {}?", self.file.name())
            }
            Question::Identify(id) => {
                let (name, address) = match self.device(*id) {
                    Some(device) => {
                        let name = device
                            .name
                            .as_ref()
                            .map_or("the device".to_owned(), ToString::to_string);
                        (name, device.address.to_string())
                    }
                    None => ("a device no longer on the bus".to_owned(), "?".to_owned()),
                };
                let service = self.profile(id.bus).commands.identify;
                format!("Send identify (service {service:03X}) to {name} at {address}?")
            }
            Question::FindBitrate(bus) => {
                let name = self.bus(*bus).map_or("the bus", |bus| bus.name.as_str());
                format!("Search {name}'s bit rate, listen-only? The interface restarts.")
            }
        })
    }

    /// The question in few words, for a narrow screen.
    pub fn question_in_short(&self) -> Option<String> {
        match &self.overlay {
            Overlay::Question(Question::Delete(key, _)) => Some(format!("Delete {key:#}?")),
            _ => self.question(),
        }
    }

    /// Command: answers the question.
    pub(super) fn answer(&mut self, yes: bool) {
        let Overlay::Question(question) = std::mem::take(&mut self.overlay) else { return };
        if !yes {
            return;
        }
        match question {
            Question::Quit => {
                self.edits_discarded = true;
                self.quit();
            }
            Question::FindBitrate(bus) => self.find_bitrate(bus),
            Question::Delete(key, text) => self.delete(key, &text),
            Question::Identify(id) => match self.identify_frame(id) {
                Ok(frame) => {
                    let mut line = Line::new(self.now, TimelineKind::Bus, "identify command sent");
                    if let Some(device) = self.device(id) {
                        line = line.on(id.bus);
                        (line.device, line.address) = (Some(id), Some(device.address));
                        line.name.clone_from(&device.name);
                    }
                    self.timeline.push(line);
                    self.outbox.push_back(frame);
                    self.show_info("identify command sent");
                }
                Err(why) => self.show_error(why),
            },
        }
    }

    /// Deletes an entry, unless somebody else changed it since it was asked about.
    fn delete(&mut self, entry: EntryKey, asked_about: &str) {
        let document = self.file.document();
        match document.find(&entry) {
            Some(at) if document.entry_text(at) != asked_about => {
                let key = self.key_of(Action::DeleteEntry);
                self.complain_of_file(format!(
                    "not deleted: {entry:#} changed on disk; press {key} again"
                ));
            }
            _ => self.edit(&[Operation::Remove { entry }]),
        }
    }

    /// Command: quit, but ask first while edits are not saved. Quitting goes on by itself once they
    /// are.
    pub(super) fn ask_quit(&mut self) {
        if self.file.unsaved() > 0 {
            self.overlay = Overlay::Question(Question::Quit);
        } else {
            self.quit();
        }
    }

    /// Where the user is being asked whether to quit all the same, and everything is saved by now,
    /// there is nothing left to ask.
    pub(super) fn quit_if_saved(&mut self) {
        if matches!(self.overlay, Overlay::Question(Question::Quit)) && self.file.unsaved() == 0 {
            self.overlay = Overlay::None;
            self.quit();
        }
    }

    /// Edits that would be lost if the program ended now, as a whole file, and how many: none where
    /// they are saved, in a copy too, or the user gave them up.
    pub fn edits_at_risk(&self) -> Option<(usize, Document)> {
        let count = self.file.unsaved();
        let is_at_risk = count > 0 && self.copy_of_edits().is_none() && !self.edits_discarded;
        is_at_risk.then(|| (count, self.file.with_all_edits()))
    }

    /// Where a copy of des.json with all edits was saved.
    fn copy_of_edits(&self) -> Option<&Path> {
        let copy = self.copy_saved.as_ref().filter(|(_, copy)| *copy == self.file.with_all_edits());
        copy.map(|(path, _)| path.as_path())
    }

    /// Command: quit.
    pub(super) fn quit(&mut self) {
        self.effects.push_back(Effect::Quit);
    }

    /// Command: ask where the captured frames are to be saved.
    pub(super) fn ask_capture_path(&mut self) {
        if self.capture.end() == 0 {
            return self.show_error("no frames captured yet");
        }
        let path = format!("descan-{}.log", stamp(self.wall_seconds(self.now)));
        self.open_prompt(PromptKind::CapturePath, path);
    }

    /// The device that the selected row is.
    pub fn selected_device(&self) -> Option<&Device> {
        match self.selected_row()?.key {
            RowKey::Device(id) => self.device(id),
            RowKey::Entry(_) => None,
        }
    }
}

fn listed_services(device: &Device) -> Vec<ListedService> {
    let services = device.services.iter().flatten();
    services
        .map(|service| ListedService {
            name: as_listed(&service.name),
            version: as_listed(&service.version),
            extra: service.extra.iter().map(as_listed).collect(),
        })
        .collect()
}

/// A version that the file leaves open stays open, and so do the strings after it: they are no
/// difference, and not to be taken over with one.
fn leave_open(services: &mut [ListedService], listed: &[ListedService]) {
    for place in 0..services.len() {
        let (earlier, later) = services.split_at_mut(place);
        let service = &mut later[0];
        let nth = earlier.iter().filter(|it| it.name == service.name).count();
        let Some(listed) = listed.iter().filter(|it| it.name == service.name).nth(nth) else {
            continue;
        };
        if listed.version.is_empty() {
            service.version.clear();
        }
        if listed.extra.is_empty() {
            service.extra.clear();
        }
    }
}

/// `20261121-060036`.
fn stamp(wall_seconds: u64) -> String {
    let (days, second) = (wall_seconds / 86_400, wall_seconds % 86_400);
    // Days since 1970 to a date of the Gregorian calendar, counted from 0000-03-01.
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    let (hours, minutes, seconds) = (second / 3600, second / 60 % 60, second % 60);
    format!("{year:04}{month:02}{day:02}-{hours:02}{minutes:02}{seconds:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_dates() {
        assert_eq!(stamp(0), "19700101-000000");
        assert_eq!(stamp(951_782_400), "20000229-000000");
        assert_eq!(stamp(1_795_240_836), "20261121-060036");
    }
}
