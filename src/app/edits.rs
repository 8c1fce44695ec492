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
    App, Bus, EditRefusal, Effect, EntryPlace, FileIndex, Overlay, Prompt, PromptContext,
    PromptKind, PromptOutcome, PromptResult, Question, Row, RowKey, inputs,
};
use crate::discovery::{Device, DeviceId, OwnAddress};
use crate::document::{EntryKey, Operation};
use crate::frame::BusIndex;
use crate::keymap::{Action, Key};
use crate::text::join_first;
use std::collections::BTreeMap;

/// Files that the question whether to quit names; the others are counted.
const NAMED_FILES: usize = 2;

impl App {
    // ---- des.json --------------------------------------------------------------------------

    /// Opens the prompt for the static address of the selected row.
    pub(super) fn edit_address(&mut self) {
        if !self.go_to_editable_row() {
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
        let entry = row.entry;
        if self.may_edit(self.file_of_row(row), entry) {
            self.open_address_prompt(key);
        }
    }

    fn open_address_prompt(&mut self, key: RowKey) {
        let file = key.file(self.files.documents());
        let (prompt, text) = AddressPrompt::new(key, self.prompt_context(file));
        self.open_prompt(PromptKind::Address(prompt), text);
    }

    /// Adds the selected device to the file with its services and its unpinned address. The entry
    /// of a listed device gets the services.
    pub(super) fn add_device(&mut self) {
        if !self.go_to_editable_row() {
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
        let operations: Vec<(FileIndex, Operation)> =
            devices.filter_map(|device| update_operation(inputs!(self), device)).collect();
        match operations.len() {
            0 => self.file_info("file already matches this device"),
            _ => {
                self.edit_files(operations);
            }
        }
    }

    /// Adds all present devices with a known name to the file, and updates services that differ.
    /// Reports entries that cannot be edited.
    pub(super) fn add_all(&mut self) {
        // Of several files, one that cannot be edited does not prevent edits of the others.
        if !self.files.documents().are_several() && !self.ensure_editable() {
            return;
        }
        let known = self
            .buses
            .devices()
            .filter(|device| device.is_present() && addition_refusal(device).is_none());
        // An entry without services leaves them out by intention of the user.
        let (mut wanted, left): (Vec<&Device>, Vec<&Device>) = known.partition(|device| {
            let entry = inputs!(self).entry_of(device.id);
            entry.is_none_or(|entry| entry.listed_services().is_some())
        });
        if wanted.is_empty() && left.is_empty() {
            return self.file_info("no present device with a known name to add");
        }
        wanted.sort_by_key(|device| (device.id.bus, device.address));
        let mut operations = Vec::new();
        let mut refused: BTreeMap<FileIndex, Vec<String>> = BTreeMap::new();
        for device in wanted {
            let Some((file, operation)) = update_operation(inputs!(self), device) else { continue };
            match self.files.get(file).file.check_operation(&operation) {
                Ok(()) => operations.push((file, operation)),
                Err(refusal) => refused.entry(file).or_default().push(refusal.to_string()),
            }
        }
        let mut done = None;
        match operations.len() {
            0 if !refused.is_empty() => {}
            0 if left.is_empty() => self.file_info("all named devices are already in the file"),
            0 => {
                let (left, key) = (left.len(), self.key_of(Action::Add));
                self.file_info(format!(
                    "all named devices are in the file; {left} without services ({key} adds them)"
                ));
            }
            _ => done = self.edit_files(operations),
        }
        if refused.is_empty() {
            return;
        }
        let not_added = refused.iter().filter_map(|(file, refusals)| {
            let (of_file, count) = (self.of_file(*file), refusals.len());
            Some(format!("{of_file}{count} not added: {}", refusals.first()?))
        });
        let texts: Vec<String> = not_added.chain(done).collect();
        self.file_error(texts.join("; "));
    }

    /// Opens the prompt for a new entry.
    pub(super) fn ask_new_entry(&mut self) {
        let file = self.file_of_selection();
        if self.ensure_editable() {
            let prompt = NewEntryPrompt::new(file, self.files.get(file).file.document().clone());
            self.open_prompt(PromptKind::NewEntry(prompt), String::new());
        }
    }

    /// Opens the prompt for the name of the selected entry.
    pub(super) fn ask_rename(&mut self) {
        if !self.go_to_editable_row() {
            return;
        }
        if let Some(refusal) = self.board_refusal() {
            return self.show_error(refusal);
        }
        let Some(place) = self.selected_entry() else { return };
        if self.may_edit(place.file, Some(place)) {
            let document = self.files.get(place.file).file.document();
            let Some(entry) = document.entries().get(place.index) else { return };
            let (key, name) = (document.key(place.index), entry.name_text.clone());
            let prompt = RenamePrompt::new(place.file, key, self.prompt_context(place.file));
            self.open_prompt(PromptKind::Rename(prompt), name);
        }
    }

    /// Opens the question for deleting the selected entry.
    pub(super) fn ask_delete(&mut self) {
        if !self.go_to_editable_row() {
            return;
        }
        if let Some(refusal) = self.board_refusal() {
            return self.show_error(refusal);
        }
        let Some(EntryPlace { file, index }) = self.selected_entry() else { return };
        let document = self.files.get(file).file.document();
        if document.entries().len() > index {
            let (key, text) = (document.key(index), document.entry_text(index).to_owned());
            self.input.ask(Question::Delete(file, key, text));
        }
    }

    /// Undoes the last edit, in whichever file it was made.
    pub(super) fn undo(&mut self) {
        let file = self.files.last_edited();
        match self.files.get_mut(file).file.undo() {
            Ok(name) => {
                self.edited(&[(file, format!("undone: {name}"))]);
            }
            Err(refusal) => self.report_refusal(file, &refusal),
        }
    }

    /// Redoes the edit that was undone last.
    pub(super) fn redo(&mut self) {
        let file = self.files.last_undone();
        match self.files.get_mut(file).file.redo() {
            Ok(name) => {
                self.edited(&[(file, format!("redone: {name}"))]);
            }
            Err(refusal) => self.report_refusal(file, &refusal),
        }
    }

    /// Repeats failed saves, or opens the edit conflict that prevents one.
    pub(super) fn save(&mut self) {
        if self.conflicting_file().is_some() {
            self.show_conflict();
            return self.input.accept_keys();
        }
        if self.files.states().all(|(_, file)| file.is_settled()) {
            return self.restore_pins();
        }
        for file in self.files.indices() {
            let state = &self.files.get(file).file;
            if state.is_settled() {
                continue;
            }
            if let Err(EditRefusal::Unusable(why)) = state.check() {
                let of_file = self.of_file(file);
                self.file_error(format!("{of_file}not saved; fix it first: {why}"));
            } else {
                self.save_pending(file);
            }
        }
    }

    /// Pins the addresses again that another program has overwritten.
    fn restore_pins(&mut self) {
        let restoring = self.files.indices().flat_map(|file| {
            let operations = self.files.get(file).restoring();
            operations.into_iter().map(move |operation| (file, operation))
        });
        let operations: Vec<(FileIndex, Operation)> = restoring.collect();
        if operations.is_empty() {
            self.file_info("no unsaved changes");
        } else {
            self.edit_files(operations);
        }
    }

    /// Opens the prompt for the path of a copy of the file with all edits.
    pub(super) fn ask_copy_path(&mut self) {
        let selected = self.file_of_selection();
        let is_at_risk = |file: &FileIndex| self.files.get(*file).edits_at_risk().is_some();
        let mut wanted = std::iter::once(selected).chain(self.files.indices());
        let file = wanted.find(is_at_risk).unwrap_or(selected);
        if !self.files.get(file).file.is_there() {
            return self.show_error("nothing to save");
        }
        let path = format!("des-{}.json", self.clock.stamp());
        self.open_prompt(PromptKind::CopyPath(CopyPathPrompt { file }), path);
    }

    /// Decides the open edit conflict and opens the next one, if any.
    pub(super) fn resolve(&mut self, ours: bool) {
        let Some(file) = self.conflicting_file() else { return self.input.leave_conflict() };
        // A file with errors has no known value to choose.
        if let Err(EditRefusal::Unusable(_)) = self.files.get(file).file.check() {
            return self.effects.push_back(Effect::Bell);
        }
        self.input.leave_conflict();
        let (mut kept, mut given_up) = self.files.get(file).file.chosen();
        *(if ours { &mut kept } else { &mut given_up }) += 1;
        let change = self.files.get_mut(file).resolve(ours);
        self.file_changed(file, change);
        // The user has seen the first conflict; the next one takes keys at once.
        self.input.accept_keys();
        if self.files.get(file).file.conflict().is_none() {
            let whose = match (kept, given_up) {
                (1, 0) => "kept your value".to_owned(),
                (0, 1) => "kept the file's value".to_owned(),
                (ours, 0) => format!("kept your {ours} values"),
                (0, theirs) => format!("kept the file's {theirs} values"),
                (ours, theirs) => format!("kept {ours} of your values, {theirs} of the file's"),
            };
            self.add_file_line(file, TimelineKind::File, format!("edit conflict: {whose}"));
            let of_file = self.of_file(file);
            self.file_info(format!("{of_file}{whose}"));
            if self.conflicting_file().is_some() {
                self.show_conflict();
            }
        }
    }

    /// The file whose edit conflict is shown.
    pub fn conflicting_file(&self) -> Option<FileIndex> {
        self.files.find(|file| file.conflict().is_some())
    }

    /// Closes the edit conflict; the edit stays unsaved.
    pub(super) fn resolve_later(&mut self) {
        self.input.leave_conflict();
        let key = self.key_of(Action::Save);
        let of_file = self.conflicting_file().map(|file| self.of_file(file)).unwrap_or_default();
        self.show_info(format!("{of_file}edit not saved; {key} reopens the conflict"));
    }

    /// Edits a file.
    pub(super) fn edit(&mut self, file: FileIndex, operations: &[Operation]) {
        self.edit_files(operations.iter().map(|operation| (file, operation.clone())));
    }

    /// Edits several files, each in one step. Returns what was done, as shown; `None` if nothing was.
    fn edit_files(
        &mut self,
        operations: impl IntoIterator<Item = (FileIndex, Operation)>,
    ) -> Option<String> {
        let mut by_file: BTreeMap<FileIndex, Vec<Operation>> = BTreeMap::new();
        for (file, operation) in operations {
            by_file.entry(file).or_default().push(operation);
        }
        let mut done = Vec::new();
        for (file, operations) in by_file {
            match self.files.get_mut(file).file.edit(&operations) {
                Ok(name) => done.push((file, name)),
                Err(refusal) => self.report_refusal(file, &refusal),
            }
        }
        let (last, _) = done.last()?;
        self.files.forget_undone_but(*last);
        Some(self.edited(&done))
    }

    /// Reports edits and begins to save them; returns the text that is shown.
    fn edited(&mut self, done: &[(FileIndex, String)]) -> String {
        let mut texts = Vec::new();
        for (file, what) in done {
            self.add_file_line(*file, TimelineKind::File, what);
            texts.push(self.of_file(*file) + what);
        }
        let text = texts.join("; ");
        self.file_info(text.as_str());
        for (file, _) in done {
            self.save_pending(*file);
        }
        self.refresh();
        text
    }

    fn report_refusal(&mut self, file: FileIndex, refusal: &EditRefusal) {
        let is_of_all = matches!(refusal, EditRefusal::NothingToUndo | EditRefusal::NothingToRedo);
        let of_file = if is_of_all { String::new() } else { self.of_file(file) };
        self.file_error(format!("{of_file}{refusal}"));
    }

    /// Where there are several files, the name of one, for the beginning of a message.
    pub(super) fn of_file(&self, file: FileIndex) -> String {
        if self.files.documents().are_several() {
            format!("{}: ", self.files.get(file).file.name())
        } else {
            String::new()
        }
    }

    /// The file of the selected row: that of its bus, or of its entry; else the first one.
    pub(super) fn file_of_selection(&self) -> FileIndex {
        self.selected_row().map(|row| self.file_of_row(row)).unwrap_or_default()
    }

    /// The file of a row: that of its bus, or of its entry.
    pub fn file_of_row(&self, row: &Row) -> FileIndex {
        row.key.file(self.files.documents())
    }

    /// From another page, goes to the row of the selection. Returns true if there is one and its file can
    /// be edited; else reports why not.
    fn go_to_editable_row(&mut self) -> bool {
        // A single file is checked before the page changes.
        let is_known = !self.files.documents().are_several();
        (!is_known || self.ensure_editable()) && self.go_to_row() && self.ensure_editable()
    }

    /// Returns true if the file of the selected row can be edited; else reports why, or opens the edit
    /// conflict.
    fn ensure_editable(&mut self) -> bool {
        let file = self.file_of_selection();
        match self.files.get(file).file.check_edit(None) {
            Err(EditRefusal::Conflict) => {
                self.show_conflict();
                false
            }
            _ => self.may_edit(file, None),
        }
    }

    /// Returns true if a file, and the entry at this place, can be edited; else reports why.
    fn may_edit(&mut self, file: FileIndex, place: Option<EntryPlace>) -> bool {
        let checked = self.files.get(file).file.check_edit(place.map(|place| place.index));
        if let Err(refusal) = &checked {
            self.report_refusal(file, refusal);
        }
        checked.is_ok()
    }

    /// Place of the entry of the selected row; shows an error for a row without one.
    fn selected_entry(&mut self) -> Option<EntryPlace> {
        let place = self.selected_row().and_then(|row| row.entry);
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

    /// State that the open prompt is validated against.
    pub(super) fn open_prompt_context(&self) -> PromptContext<'_> {
        self.prompt_context(self.file_of_prompt())
    }

    /// The file that the open prompt is about.
    fn file_of_prompt(&self) -> FileIndex {
        let documents = self.files.documents();
        self.prompt().and_then(|prompt| prompt.kind.file(documents)).unwrap_or_default()
    }

    /// State that prompts about a file are validated against.
    pub(super) fn prompt_context(&self, file: FileIndex) -> PromptContext<'_> {
        PromptContext {
            index: file,
            file: &self.files.get(file).file,
            documents: self.files.documents(),
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
        let file = self.file_of_prompt();
        let check = self.prompt().map(|prompt| prompt.validate(self.prompt_context(file)));
        if let Some(super::InputCheck::Rejected(_)) = check {
            self.effects.push_back(Effect::Bell);
            let is_edit = self.input.prompt().is_some_and(|prompt| prompt.kind.is_edit());
            if is_edit && self.files.get(file).file.conflict().is_some() {
                self.show_conflict();
            }
            return;
        }
        let Some(prompt) = self.input.close_prompt() else { return };
        let outcome = prompt.commit(self.prompt_context(file));
        if outcome.is_write() {
            self.input.note_written(prompt);
        }
        match outcome {
            PromptOutcome::Nothing => {}
            PromptOutcome::SetFilter(page, text) => self.commit_filter(page, &text),
            PromptOutcome::Edit(operations) => {
                self.edit(file, &operations);
                if let [Operation::Rename { entry, to }] = &operations[..] {
                    self.select_entry(file, to, entry.address);
                }
            }
            PromptOutcome::AddEntry(entry) => {
                let (name, address) = (entry.name.clone(), entry.address);
                self.edit(file, &[Operation::Add { entry }]);
                self.select_entry(file, &name, address);
            }
            PromptOutcome::FileInfo(text) => self.file_info(text),
            PromptOutcome::SaveCapture(path) => self.save_capture(path),
            PromptOutcome::WriteProof(problem, path) => self.write_proof(&problem, path),
            PromptOutcome::Command(device, command) => self.ask_to_send(device, command),
            PromptOutcome::UseLearnt(path) => self.use_learnt_profile(path),
            PromptOutcome::GoTo(target) => self.go_to_target(target),
            PromptOutcome::SetMark(moment, text) => self.set_mark(moment, &text),
            PromptOutcome::SaveCopy(path) => {
                let bytes = self.files.get_mut(file).start_copy(path.clone());
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
    fn select_entry(&mut self, file: FileIndex, name: &[u8], address: Option<u8>) {
        let entries = self.files.get(file).file.document().entries();
        let index = entries.iter().rposition(|it| it.name == name && it.address == address);
        let place = index.map(|index| EntryPlace { file, index });
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
            Question::Quit => self.quit_question(),
            Question::Delete(file, key, _) => {
                format!("Delete the entry {key:#} from {}?", self.file_at(*file).name())
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

    /// The question whether to quit with unsaved edits. Of several files with any it names those whose
    /// edits have no copy.
    fn quit_question(&self) -> String {
        let unsaved = self.files.indices().filter(|it| self.files.get(*it).file.unsaved() > 0);
        let unsaved: Vec<FileIndex> = unsaved.collect();
        let [_, _, ..] = unsaved[..] else {
            let only = unsaved.first().copied().unwrap_or_default();
            return self.of_file(only) + &self.files.get(only).quit_question();
        };
        let at_risk = unsaved.iter().filter(|it| self.files.get(**it).edits_at_risk().is_some());
        let names: Vec<String> = at_risk.map(|it| self.files.get(*it).file.name()).collect();
        if names.is_empty() {
            let files = unsaved.len();
            return format!("edits of {files} files are saved only in copies. Quit anyway?");
        }
        let names = join_first(names, NAMED_FILES, ", ");
        format!("edits are not saved: {names}. Quit anyway?")
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
                self.files.indices().for_each(|file| self.files.get_mut(file).discard_edits());
                self.quit();
            }
            Question::FindBitrate(bus) => self.find_bitrate(bus),
            Question::Delete(file, key, text) => self.delete(file, key, &text),
            Question::Command(id, command) => self.send_confirmed(id, command),
            Question::Descriptor(id) => self.read_confirmed(id),
            Question::Plan | Question::SendFrames { .. } => {}
        }
    }

    /// Deletes an entry, unless it changed on disk since the question was opened.
    fn delete(&mut self, file: FileIndex, entry: EntryKey, confirmed: &str) {
        let document = self.files.get(file).file.document();
        match document.find(&entry) {
            Some(at) if document.entry_text(at) != confirmed => {
                let key = self.key_of(Action::DeleteEntry);
                let text = format!("not deleted: {entry:#} changed on disk; press {key} again");
                self.file_error(text);
            }
            _ => self.edit(file, &[Operation::Remove { entry }]),
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
        if self.files.unsaved() > 0 {
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
