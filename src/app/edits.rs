//! Commands that edit des.json or transmit.
//!
//! An edit is an [`Operation`] on the document; the shell writes the file. Nothing is transmitted
//! beyond discovery without a confirmation.

use super::input::{AddressPrompt, CopyPathPrompt, MomentPrompt, NewEntryPrompt, RenamePrompt};
use super::listing::{addition_refusal, update_operation};
use super::problems::bus_obstacle;
use super::timeline_kind::TimelineKind;
use super::view::Page;
use super::{
    App, Bus, EditRefusal, Effect, Overlay, Prompt, PromptContext, PromptKind, PromptOutcome,
    PromptResult, Question, RowKey, inputs,
};
use crate::discovery::{Device, DeviceId, OwnAddress};
use crate::document::{EntryKey, Operation};
use crate::frame::BusIndex;
use crate::keymap::{Action, Key};

impl App {
    // ---- des.json --------------------------------------------------------------------------

    /// Opens the prompt for the static address of the selected row.
    pub(super) fn edit_address(&mut self) {
        if !self.ensure_editable() || !self.go_to_row() {
            return;
        }
        if let Some(refusal) = self.board_refusal() {
            return self.show_error(refusal);
        }
        let Some(row) = self.selected_row() else { return self.show_error("no row is selected") };
        let key = row.key.clone();
        if let Some(refusal) = self.device_of(row).and_then(addition_refusal) {
            return self.show_error(refusal);
        }
        let entry = self.entry_of(row).map(|entry| entry.index);
        if self.may_edit_entry(entry) {
            self.open_address_prompt(key);
        }
    }

    fn open_address_prompt(&mut self, key: RowKey) {
        let (prompt, text) = AddressPrompt::new(key, self.prompt_context());
        self.open_prompt(PromptKind::Address(prompt), text);
    }

    /// Adds the selected device to the file with its services and its unpinned address. The entry
    /// of a listed device gets the services.
    pub(super) fn add_device(&mut self) {
        if !self.ensure_editable() || !self.go_to_row() {
            return;
        }
        if let Some(refusal) = self.board_refusal() {
            return self.show_error(refusal);
        }
        let Some(row) = self.selected_row().filter(|row| self.device_of(row).is_some()) else {
            return self.show_error("no device in this row to add");
        };
        let refusal = self.devices_of(row).find_map(addition_refusal);
        if let Some(refusal) = refusal {
            return self.show_error(refusal);
        }
        let devices = self.devices_of(row);
        let operations: Vec<Operation> =
            devices.filter_map(|device| update_operation(inputs!(self), device)).collect();
        match operations.len() {
            0 => self.file_info("file already matches this device"),
            _ => self.edit(&operations),
        }
    }

    /// Adds all present devices with a known name to the file, and updates services that differ.
    /// Reports entries that cannot be edited.
    pub(super) fn add_all(&mut self) {
        if !self.ensure_editable() {
            return;
        }
        let known = self
            .buses
            .devices()
            .filter(|device| device.is_present() && addition_refusal(device).is_none());
        // An entry without services leaves them out by intention of the user.
        let (mut wanted, left): (Vec<&Device>, Vec<&Device>) = known.partition(|device| {
            let entry = self.matching().entry_of(device.id);
            let entry = entry.map(|at| &self.editor.file.document().entries()[at]);
            entry.is_none_or(|entry| entry.listed_services().is_some())
        });
        if wanted.is_empty() && left.is_empty() {
            return self.file_info("no present device with a known name to add");
        }
        wanted.sort_by_key(|device| (device.id.bus, device.address));
        let (mut operations, mut refused) = (Vec::new(), Vec::new());
        for device in wanted {
            let Some(operation) = update_operation(inputs!(self), device) else { continue };
            match self.editor.file.check_operation(&operation) {
                Ok(()) => operations.push(operation),
                Err(refusal) => refused.push(refusal.to_string()),
            }
        }
        match operations.len() {
            0 if !refused.is_empty() => {}
            0 if left.is_empty() => self.file_info("all named devices are already in the file"),
            0 => {
                let (left, key) = (left.len(), self.key_of(Action::Add));
                self.file_info(format!(
                    "all named devices are in the file; {left} without services ({key} adds them)"
                ));
            }
            _ => self.edit(&operations),
        }
        if let Some(refusal) = refused.first() {
            self.file_error(format!("{} not added: {refusal}", refused.len()));
        }
    }

    /// Opens the prompt for a new entry.
    pub(super) fn ask_new_entry(&mut self) {
        if self.ensure_editable() {
            let prompt = NewEntryPrompt::new(self.editor.file.document().clone());
            self.open_prompt(PromptKind::NewEntry(prompt), String::new());
        }
    }

    /// Opens the prompt for the name of the selected entry.
    pub(super) fn ask_rename(&mut self) {
        if !self.ensure_editable() || !self.go_to_row() {
            return;
        }
        if let Some(refusal) = self.board_refusal() {
            return self.show_error(refusal);
        }
        let Some(at) = self.selected_entry() else { return };
        if self.may_edit_entry(Some(at)) {
            let document = self.editor.file.document();
            let (key, name) = (document.key(at), document.entries()[at].name_text.clone());
            let prompt = RenamePrompt::new(key, self.prompt_context());
            self.open_prompt(PromptKind::Rename(prompt), name);
        }
    }

    /// Opens the question for deleting the selected entry.
    pub(super) fn ask_delete(&mut self) {
        if !self.ensure_editable() || !self.go_to_row() {
            return;
        }
        if let Some(refusal) = self.board_refusal() {
            return self.show_error(refusal);
        }
        let Some(at) = self.selected_entry() else { return };
        let document = self.editor.file.document();
        let (key, text) = (document.key(at), document.entry_text(at).to_owned());
        self.input.ask(Question::Delete(key, text));
    }

    /// Undoes the last edit.
    pub(super) fn undo(&mut self) {
        match self.editor.file.undo() {
            Ok(name) => self.edited(&format!("undone: {name}")),
            Err(refusal) => self.file_error(refusal.to_string()),
        }
    }

    /// Redoes the edit that was undone last.
    pub(super) fn redo(&mut self) {
        match self.editor.file.redo() {
            Ok(name) => self.edited(&format!("redone: {name}")),
            Err(refusal) => self.file_error(refusal.to_string()),
        }
    }

    /// Repeats a failed save, or opens the edit conflict that prevents it.
    pub(super) fn save(&mut self) {
        if self.editor.file.conflict().is_some() {
            self.show_conflict();
            self.input.accept_keys();
        } else if self.editor.file.is_settled() {
            self.restore_pins();
        } else if let Err(EditRefusal::Unusable(why)) = self.editor.file.check() {
            self.file_error(format!("not saved; fix it first: {why}"));
        } else {
            self.save_pending();
        }
    }

    /// Pins the addresses again that another program has overwritten.
    fn restore_pins(&mut self) {
        let operations = self.editor.restoring();
        if operations.is_empty() {
            self.file_info("no unsaved changes");
        } else if self.ensure_editable() {
            self.edit(&operations);
        }
    }

    /// Opens the prompt for the path of a copy of the file with all edits.
    pub(super) fn ask_copy_path(&mut self) {
        if !self.editor.file.is_there() {
            return self.show_error("nothing to save");
        }
        let path = format!("des-{}.json", self.clock.stamp());
        self.open_prompt(PromptKind::CopyPath(CopyPathPrompt), path);
    }

    /// Decides the open edit conflict and opens the next one, if any.
    pub(super) fn resolve(&mut self, ours: bool) {
        // A file with errors has no known value to choose.
        if let Err(EditRefusal::Unusable(_)) = self.editor.file.check() {
            return self.effects.push_back(Effect::Bell);
        }
        self.input.leave_conflict();
        let (mut kept, mut given_up) = self.editor.file.chosen();
        *(if ours { &mut kept } else { &mut given_up }) += 1;
        let change = self.editor.resolve(ours);
        self.file_changed(change);
        // The user has seen the first conflict; the next one takes keys at once.
        self.input.accept_keys();
        if self.editor.file.conflict().is_none() {
            let whose = match (kept, given_up) {
                (1, 0) => "kept your value".to_owned(),
                (0, 1) => "kept the file's value".to_owned(),
                (ours, 0) => format!("kept your {ours} values"),
                (0, theirs) => format!("kept the file's {theirs} values"),
                (ours, theirs) => format!("kept {ours} of your values, {theirs} of the file's"),
            };
            self.add_line(TimelineKind::File, format!("edit conflict: {whose}"));
            self.file_info(whose);
        }
    }

    /// Closes the edit conflict; the edit stays unsaved.
    pub(super) fn resolve_later(&mut self) {
        self.input.leave_conflict();
        let key = self.key_of(Action::Save);
        self.show_info(format!("edit not saved; {key} reopens the conflict"));
    }

    pub(super) fn edit(&mut self, operations: &[Operation]) {
        match self.editor.file.edit(operations) {
            Ok(name) => self.edited(&name),
            Err(refusal) => self.file_error(refusal.to_string()),
        }
    }

    /// Reports an edit and begins to save it.
    fn edited(&mut self, what: &str) {
        self.add_line(TimelineKind::File, what);
        self.file_info(what);
        self.save_pending();
        self.refresh();
    }

    /// Returns true if the file can be edited; else reports why, or opens the edit conflict.
    fn ensure_editable(&mut self) -> bool {
        match self.editor.file.check_edit(None) {
            Err(EditRefusal::Conflict) => {
                self.show_conflict();
                false
            }
            _ => self.may_edit_entry(None),
        }
    }

    /// Returns true if the entry at this place can be edited; else reports why.
    fn may_edit_entry(&mut self, place: Option<usize>) -> bool {
        let checked = self.editor.file.check_edit(place);
        if let Err(refusal) = &checked {
            self.file_error(refusal.to_string());
        }
        checked.is_ok()
    }

    /// Place of the entry of the selected row; shows an error for a row without one.
    fn selected_entry(&mut self) -> Option<usize> {
        let entry = self.selected_row().and_then(|row| self.entry_of(row));
        let place = entry.map(|entry| entry.index);
        if place.is_none() {
            let can_add =
                self.selected_device().is_some_and(|device| addition_refusal(device).is_none());
            let key = self.key_of(Action::Add);
            self.show_error(if can_add {
                format!("not in file; {key} adds the device")
            } else {
                "not in file".to_owned()
            });
        }
        place
    }

    // ---- prompts ---------------------------------------------------------------------------

    /// Opens the prompt for the moment to go to.
    pub(super) fn ask_moment(&mut self) {
        self.open_prompt(PromptKind::Moment(MomentPrompt), String::new());
    }

    /// State that prompts are validated against.
    pub(super) fn prompt_context(&self) -> PromptContext<'_> {
        PromptContext {
            file: &self.editor.file,
            matching: self.problems.matching(),
            buses: &self.buses,
            selected_bus: self.selected_row().and_then(|row| row.bus),
            frames: self.traffic.capture.ranges().map(|range| range.end - range.start).sum(),
            moments: self.moment_range(),
            matches: self.filter_matches(),
            row_noun: self.row_noun(),
            saved_frames: self.saved_frames(),
        }
    }

    pub(super) fn open_prompt(&mut self, kind: PromptKind, text: String) {
        self.input.open(Overlay::Prompt(Prompt::new(kind, text)));
        self.notices.redraw.set_dirty();
    }

    /// Handles a key while a prompt is open.
    pub(super) fn handle_prompt_key(&mut self, key: Key) {
        if let Some(action) = self.input.lookup_global(key).filter(|_| key.ctrl) {
            return self.run(action);
        }
        if self.is_first_row_typed(key) {
            self.input.close_prompt();
            return self.move_to_end(false);
        }
        let Some(prompt) = self.input.prompt_mut() else { return };
        match prompt.handle_key(key) {
            PromptResult::Typed => self.prompt_changed(),
            PromptResult::Commit => self.commit_prompt(),
            PromptResult::Cancel => self.cancel_prompt(),
            PromptResult::NextBus => self.edit_on_next_bus(),
            PromptResult::Complete => self.complete_filter(),
            PromptResult::SaveFilter => self.save_typed_filter(),
            PromptResult::Recall(by) => self.recall_filter(by),
        }
    }

    /// Handles a change of the line: a filter applies while it is typed; while it is wrong, the one
    /// before applies.
    pub(super) fn prompt_changed(&mut self) {
        self.input.forget_failure();
        self.notices.redraw.set_dirty();
        self.filter_typed();
    }

    fn cancel_prompt(&mut self) {
        if let Some(Prompt { kind: PromptKind::Filter(filter), .. }) = self.input.close_prompt() {
            self.restore_filter(filter);
        }
    }

    fn commit_prompt(&mut self) {
        let check = self.prompt().map(|prompt| prompt.validate(self.prompt_context()));
        if let Some(super::InputCheck::Rejected(_)) = check {
            self.effects.push_back(Effect::Bell);
            let is_edit = self.input.prompt().is_some_and(|prompt| prompt.kind.is_edit());
            if is_edit && self.editor.file.conflict().is_some() {
                self.show_conflict();
            }
            return;
        }
        let Some(prompt) = self.input.close_prompt() else { return };
        let outcome = prompt.commit(self.prompt_context());
        if outcome.is_write() {
            self.input.note_written(prompt);
        }
        match outcome {
            PromptOutcome::Nothing => {}
            PromptOutcome::SetFilter(page, text) => self.commit_filter(page, &text),
            PromptOutcome::Edit(operations) => self.edit(&operations),
            PromptOutcome::AddEntry(entry) => {
                let (name, address) = (entry.name.clone(), entry.address);
                self.edit(&[Operation::Add { entry }]);
                self.select_entry(&name, address);
            }
            PromptOutcome::FileInfo(text) => self.file_info(text),
            PromptOutcome::SaveCapture(path) => self.save_capture(path),
            PromptOutcome::WriteProof(problem, path) => self.write_proof(&problem, path),
            PromptOutcome::Command(device, command) => self.ask_to_send(device, command),
            PromptOutcome::UseLearnt(path) => self.use_learnt_profile(path),
            PromptOutcome::GoTo(target) => self.go_to_target(target),
            PromptOutcome::SetMark(moment, text) => self.set_mark(moment, &text),
            PromptOutcome::SaveCopy(path) => {
                let bytes = self.editor.start_copy(path.clone());
                self.effects.push_back(Effect::WriteFile { path, bytes });
            }
        }
    }

    /// Edits the address on the next redundant bus of the device; the typed text is dropped.
    fn edit_on_next_bus(&mut self) {
        let Some(PromptKind::Address(AddressPrompt { key: RowKey::Device(now), .. })) =
            self.prompt().map(|it| &it.kind)
        else {
            return;
        };
        let row = self.rows().iter().find(|row| row.has_device(*now));
        let all: Vec<DeviceId> =
            row.map(|row| self.devices_of(row).map(|it| it.id).collect()).unwrap_or_default();
        let at = all.iter().position(|id| id == now).map_or(0, |at| at + 1);
        let next = all.get(at).or(all.first()).copied().filter(|next| next != now);
        if let Some(next) = next {
            self.open_address_prompt(RowKey::Device(next));
        }
    }

    /// Selects the row of an entry, if the filter shows it.
    fn select_entry(&mut self, name: &[u8], address: Option<u8>) {
        let entries = self.editor.file.document().entries();
        let place = entries.iter().rposition(|it| it.name == name && it.address == address);
        let row = self.rows().iter().find(|row| place.is_some() && row.entry == place);
        if let Some(key) = row.map(|row| row.key.clone()) {
            self.view.devices.select(key);
            self.refresh_rows();
        }
    }

    // ---- the bus ---------------------------------------------------------------------------

    /// Restarts the enumeration.
    pub(super) fn rescan(&mut self) {
        let (mut able, mut obstacles) = (Vec::new(), Vec::new());
        for (at, bus) in self.buses.iter().enumerate() {
            let no_scan =
                || (!bus.config().send_requests).then(|| "--no-scan: no requests are sent".into());
            match self.tx_obstacle(BusIndex(at as u8), bus).or_else(no_scan) {
                Some(obstacle) => obstacles.push(obstacle),
                None => able.push(bus.name.as_str()),
            }
        }
        let able = able.join(" and ");
        self.buses.rescan(self.clock.now());
        self.take_events();
        match obstacles.into_iter().next() {
            None => self.show_info("enumeration restarted"),
            Some(obstacle) if able.is_empty() => self.show_error(obstacle),
            Some(obstacle) => {
                self.show_info(format!("enumeration restarted on {able}; {obstacle}"));
            }
        }
    }

    /// The reason why descan cannot send requests on a bus; `None` if it can.
    pub(super) fn tx_obstacle(&self, index: BusIndex, bus: &Bus) -> Option<String> {
        let config = bus.config();
        if self.clock.playback().is_some() || bus.ended.is_some() {
            return Some("a log: nothing is sent".to_owned());
        }
        if config.listen_only {
            return Some("listen-only: no requests are sent".to_owned());
        }
        bus_obstacle(bus).or_else(|| match bus.own_address() {
            OwnAddress::Blocked(wanted) => self.buses.no_address_reason(index, wanted),
            _ => None,
        })
    }

    /// Removes the lost devices.
    pub(super) fn remove_lost_devices(&mut self) {
        if self.view.page != Page::Devices {
            return self.show_error("lost devices are removed on the Devices page");
        }
        let lost = self.counts().lost;
        let changed =
            self.buses.devices().filter(|it| it.is_present() && it.has_changed_services());
        let changed = changed.count();
        self.buses.remove_lost_devices(self.clock.now());
        self.forget_absent_devices();
        self.take_events();
        self.refresh();
        let lost = match lost {
            0 => "no lost devices".to_owned(),
            1 => "1 lost device removed".to_owned(),
            lost => format!("{lost} lost devices removed"),
        };
        self.show_info(match changed {
            0 => lost,
            1 => format!("{lost}; changes of 1 device confirmed"),
            _ => format!("{lost}; changes of {changed} devices confirmed"),
        });
    }

    // ---- questions -------------------------------------------------------------------------

    /// Text of the open question.
    pub fn question(&self) -> Option<String> {
        Some(match self.input.question()? {
            Question::Quit => self.editor.quit_question(),
            Question::Delete(key, _) => {
                format!("Delete the entry {key:#} from {}?", self.editor.file.name())
            }
            Question::Command(id, command) => {
                let (sent, effect) = self.command_sentences(*id, *command);
                format!("{sent}? {effect}")
            }
            Question::Descriptor(id) => self.descriptor_question(*id),
            Question::Plan => self.plan_question()?,
            Question::SendFrames { is_about_source } => self.frames_question(*is_about_source),
            Question::FindBitrate(bus) => {
                let name = self.bus(*bus).map_or("the bus", |bus| bus.name.as_str());
                format!("Search {name}'s bit rate, listen-only? The interface restarts.")
            }
        })
    }

    /// Closes the question and executes its action, after `yes`.
    pub(super) fn confirm(&mut self, yes: bool) {
        let question = self.input.close_question();
        if question == Some(Question::Plan) {
            return self.plan_answered(yes);
        }
        if let Some(Question::SendFrames { is_about_source }) = question {
            return self.confirm_frames(is_about_source, yes);
        }
        let Some(question) = question.filter(|_| yes) else { return };
        match question {
            Question::Quit => {
                self.editor.discard_edits();
                self.quit();
            }
            Question::FindBitrate(bus) => self.find_bitrate(bus),
            Question::Delete(key, text) => self.delete(key, &text),
            Question::Command(id, command) => self.send_confirmed(id, command),
            Question::Descriptor(id) => self.read_confirmed(id),
            Question::Plan | Question::SendFrames { .. } => {}
        }
    }

    /// Deletes an entry, unless it changed on disk since the question was opened.
    fn delete(&mut self, entry: EntryKey, confirmed: &str) {
        let document = self.editor.file.document();
        match document.find(&entry) {
            Some(at) if document.entry_text(at) != confirmed => {
                let key = self.key_of(Action::DeleteEntry);
                let text = format!("not deleted: {entry:#} changed on disk; press {key} again");
                self.file_error(text);
            }
            _ => self.edit(&[Operation::Remove { entry }]),
        }
    }

    /// Quits; with unsaved edits opens a question instead, and descan quits as soon as they are
    /// saved.
    pub(super) fn ask_quit(&mut self) {
        if self.plan.as_ref().is_some_and(|session| session.is_running()) {
            let (plan, stop) = (self.key_of(Action::Plan), self.key_of(Action::PlanStop));
            let now = self.key_of(Action::QuitNow);
            let text = format!("a plan runs: {plan} {stop} stops it after this step; {now} quits");
            return self.show_error(text);
        }
        if self.editor.file.unsaved() > 0 {
            self.input.ask(Question::Quit);
        } else {
            self.quit();
        }
    }

    /// Quits.
    pub(super) fn quit(&mut self) {
        self.effects.push_back(Effect::Quit);
    }
}
