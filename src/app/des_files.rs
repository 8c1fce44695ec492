//! The des.json files: what is read, saved and shown of them, and the lines of the timeline about them.
//!
//! Inputs: readings of the files, results of saves. Outputs: effects that read and save, messages.
//! Does not know the edits that the user makes.

use super::file::{Documents, FileChange, FileContent, FileEditor, FileError};
use super::input::Question;
use super::notices::{TimelineEntry, join_short};
use super::problems::{self, file_mistakes};
use super::timeline_kind::TimelineKind;
use super::{
    App, AppEvent, Bus, Effect, FileIndex, FileReading, FileState, SaveOutcome, inputs,
    shown_inputs,
};
use crate::diagnostic::Diagnostic;
use crate::document::{Document, DocumentFinding, Entry};
use crate::frame::BusIndex;
use crate::keymap::Action;
use crate::text::Name;
use crate::time::Instant;
use std::fmt::Write;
use std::path::PathBuf;

/// Mistakes in a file that get a line of their own when it changes.
const LISTED_FINDINGS: usize = 20;

impl App {
    /// Sets the des.json of a bus; `None` is that of [`super::AppOptions::file_path`]. Returns the file if
    /// it is a new one, which is to be read.
    pub fn set_file_of_bus(&mut self, bus: BusIndex, path: Option<PathBuf>) -> Option<FileIndex> {
        let (file, is_new) = self.files.set_file_of(bus, path);
        self.refresh_before_draw();
        self.notices.redraw.set_dirty();
        is_new.then_some(file)
    }

    /// Takes a reading of a des.json.
    pub fn handle_file(&mut self, now: Instant, file: FileIndex, reading: FileReading) {
        self.clock.set(now);
        let was_emptied = self.files.get(file).file.emptied_since().is_some();
        let change = self.files.get_mut(file).read(self.clock.real(), reading);
        self.file_changed(file, change);
        let is_emptied = self.files.get(file).file.emptied_since().is_some();
        if was_emptied || is_emptied {
            self.notices.redraw.set_dirty();
        }
        if was_emptied && !is_emptied && change == FileChange::None {
            // The former content is back: edits that waited are saved.
            self.save_pending(file);
        }
    }

    /// Takes that the folder of a new des.json does not exist.
    pub fn handle_missing_folder(&mut self, now: Instant, file: FileIndex, fault: &Diagnostic) {
        let now = self.clock.set(now);
        let text = fault.to_string();
        self.add_file_line(file, TimelineKind::Error, &text);
        let name = self.files.get(file).file.name();
        self.notices.file_error(now, format!("{name}: {text}"));
    }

    /// Takes the result of an [`Effect::Save`].
    pub fn handle_saved(&mut self, now: Instant, file: FileIndex, outcome: SaveOutcome) {
        let now = self.clock.set(now);
        let real = self.clock.real();
        let report = self.files.get_mut(file).handle_saved(real, outcome);
        self.notices.redraw.set_dirty();
        if report.is_silent {
            return;
        }
        if let Some((text, is_warning)) = report.text {
            self.add_file_line(file, TimelineKind::File, &text);
            let text = self.of_file(file) + &text;
            if is_warning {
                self.notices.file_error(now, text);
            } else {
                self.notices.file_info(now, text);
            }
        }
        // A known problem does not replace the message about the edit.
        let done = if report.is_known { self.notices.take_edit_message() } else { None };
        self.file_changed(file, report.change);
        if let Some(done) = done {
            self.notices.restore_message(done);
        }
        if self.files.get(file).file.problem().is_none() {
            // The save may have been refused because of a newer content that was read during it.
            self.save_pending(file);
        }
        // An unsaved edit may have been undone, which is not a change of the file.
        self.quit_if_saved();
    }

    pub(super) fn run_file_timers(&mut self) {
        let real = self.clock.real();
        for file in self.files.indices() {
            if self.files.get_mut(file).start_retry(real) {
                self.save_pending(file);
            }
            if self.files.get_mut(file).settle_empty(real) {
                self.effects.push_back(Effect::ReadFile(file));
            }
        }
    }

    /// The moment at which a failed save is repeated, or an empty file accepted.
    pub(super) fn files_timeout(&self) -> Option<Instant> {
        self.files.iter().filter_map(FileEditor::poll_timeout).min()
    }

    /// des.json: content and edits. Of several files the first, which buses without one of their own
    /// have.
    pub fn file(&self) -> &FileState {
        self.file_at(FileIndex::default())
    }

    /// A des.json: content and edits.
    pub fn file_at(&self, file: FileIndex) -> &FileState {
        &self.files.get(file).file
    }

    /// The des.json files: content and edits.
    pub fn files(&self) -> impl Iterator<Item = (FileIndex, &FileState)> {
        self.files.states()
    }

    /// The des.json of a bus.
    pub fn file_of_bus(&self, bus: BusIndex) -> FileIndex {
        self.files.of_bus(bus)
    }

    /// The buses that have a des.json.
    pub fn buses_of_file(&self, file: FileIndex) -> impl Iterator<Item = &Bus> {
        self.files.documents().buses_of(file, self.shown_buses()).map(|(_, bus)| bus)
    }

    /// Returns true if descan was started with a des.json, also one that does not exist.
    pub(super) fn has_file_path(&self) -> bool {
        self.files.states().any(|(_, state)| state.path().is_some())
    }

    /// Content of a des.json with the edits, at the moment that is shown; `None` if it was not open
    /// then.
    pub fn document_at(&self, file: FileIndex) -> Option<&Document> {
        self.shown_documents().get(file)
    }

    /// Why a des.json could not be read or saved at the moment that is shown, and true if there was the
    /// file. A file that cannot be saved now is that of any moment: it needs the user.
    pub fn shown_file(&self, file: FileIndex) -> (Option<&FileError>, bool) {
        let documents = self.shown_documents();
        let present = self.file_at(file).problem();
        let unsaved = present.filter(|problem| problem.is_not_saved());
        (unsaved.or(documents.problem(file)), documents.is_there(file))
    }

    /// The contents of the des.json files, at the moment that is shown.
    pub(crate) fn shown_documents(&self) -> Documents<'_> {
        match &self.past {
            Some(past) => self.files.documents_of(&past.contents),
            None => self.files.documents(),
        }
    }

    /// The mistakes in a des.json, as far as they show without devices, in the order of the file; also
    /// UIDs that the profile does not allow.
    pub fn file_mistakes(&self, file: FileIndex) -> Vec<DocumentFinding> {
        shown_inputs!(self).file(file).map(problems::file_mistakes).unwrap_or_default()
    }

    /// What is wrong with the UID of an entry of a des.json; `None` if a device can have it.
    pub fn uid_mistake(&self, file: FileIndex, entry: &Entry) -> Option<String> {
        problems::mistake_of(shown_inputs!(self).file(file)?, entry, entry.uid.as_deref()?)
    }

    /// Names of the entries whose static address, set by the user, another program has overwritten;
    /// [`Action::Save`] restores them.
    pub fn overwritten_pins(&self) -> Vec<Name> {
        let operations = self.files.iter().flat_map(FileEditor::restoring);
        let names = operations.filter_map(|it| it.entry().map(|entry| Name::new(&entry.name)));
        names.collect()
    }

    /// Edits that would be lost if the program ended now: of each des.json their number and the content
    /// with them. Without those that are saved, also in a copy, or discarded by the user.
    pub fn edits_at_risk(&self) -> Vec<(FileIndex, usize, Document)> {
        let at_risk = self.files.indices().filter_map(|file| {
            let (count, document) = self.files.get(file).edits_at_risk()?;
            Some((file, count, document))
        });
        at_risk.collect()
    }

    /// Number of unsaved edits of all des.json files.
    pub fn unsaved_edits(&self) -> usize {
        self.files.unsaved()
    }

    /// Adds a line about a des.json to the timeline only.
    pub(super) fn add_file_line(
        &mut self,
        file: FileIndex,
        kind: TimelineKind,
        text: impl Into<String>,
    ) {
        let line = self.file_line(file, kind, text);
        self.notices.push_line(line);
    }

    /// A line of the timeline about a des.json.
    pub(super) fn file_line(
        &self,
        file: FileIndex,
        kind: TimelineKind,
        text: impl Into<String>,
    ) -> TimelineEntry {
        TimelineEntry { file, ..TimelineEntry::new(self.clock.now(), kind, text) }
    }

    /// Notes the contents of the des.json files, if they changed.
    pub(super) fn note_content(&mut self) {
        let contents = self.files.contents();
        let is_same = |(one, other): (&FileContent, &FileContent)| one.is_same(other);
        let is_known = contents.len() == self.contents.len();
        if !is_known || !contents.iter().zip(&self.contents).all(is_same) {
            let before = std::mem::replace(&mut self.contents, contents);
            if self.contents_before.len() == super::MAX_CONTENTS {
                self.contents_before.pop_front();
            }
            self.contents_before.push_back((self.clock.now(), before));
        }
    }

    /// Closes the question whether to delete an entry that another program has deleted.
    fn leave_question_about_deleted(&mut self) {
        let Some(Question::Delete(file, entry, _)) = self.input.question() else { return };
        if self.files.get(*file).file.document().find(entry).is_none() {
            let text = format!("entry no longer in the file: {entry:#}");
            self.input.close_question();
            self.show_error(text);
        }
    }

    /// Takes a change of a des.json: reports it, saves what waits, renews rows and problems.
    pub(super) fn file_changed(&mut self, file: FileIndex, change: FileChange) {
        if change == FileChange::None {
            return;
        }
        if matches!(change, FileChange::Content | FileChange::Rebased | FileChange::Conflict) {
            self.notices.clear_file_message(change == FileChange::Rebased);
        }
        let lines = self.file_lines(file, change);
        if change == FileChange::Unusable {
            let state = &self.files.get(file).file;
            let (name, problem) = (state.name(), state.problem());
            let mut whole = problem.map(|it| it.of_file(&name)).unwrap_or_default();
            if problem.is_some_and(FileError::is_not_saved) {
                // The cause may advise it already.
                let advice =
                    if whole.contains("save elsewhere") { " with" } else { "; save a copy with" };
                let _ = write!(whole, "{advice} {}", self.key_of(Action::SaveCopy));
            }
            self.file_error(whole);
        }
        if change == FileChange::Conflict {
            self.show_conflict();
        }
        let now = self.clock.now();
        let mut is_of_interest = self.notices.is_unfiltered();
        for (kind, text) in lines {
            let line = self.file_line(file, kind, text);
            is_of_interest |= self.notices.passes_filter(&self.buses, &line, &[]);
            self.report_line(line);
        }
        is_of_interest &= self.notices.emits_events();
        let problem = self.files.get(file).file.problem();
        let problem = problem.filter(|_| change == FileChange::Unusable);
        let excerpt = problem.and_then(FileError::excerpt);
        // The excerpt is read as a whole: the event filter applies to the lines before it.
        for text in excerpt.into_iter().flatten() {
            let line = self.file_line(file, TimelineKind::Error, text);
            if is_of_interest {
                let event = self.line_event(&line);
                self.notices.emit(event);
            }
            self.notices.push_line(line);
        }
        if is_of_interest {
            let event = AppEvent::File(now, self.file_snapshot(file));
            self.notices.emit(event);
        }
        self.leave_conflict_that_is_over(file, change);
        if change != FileChange::Unusable {
            self.leave_question_about_deleted();
            self.save_pending(file);
        }
        self.quit_if_saved();
        self.notices.redraw.set_dirty();
        // A saved edit was in force before.
        if change != FileChange::Saved {
            self.refresh();
        }
    }

    /// The timeline lines of a change of des.json.
    fn file_lines(&self, index: FileIndex, change: FileChange) -> Vec<(TimelineKind, String)> {
        let file = &self.files.get(index).file;
        let emits = self.notices.emits_events();
        let entries = file.document().entries().len();
        let listed = format!("{entries} {}", if entries == 1 { "entry" } else { "entries" });
        let by_others = match change {
            FileChange::Content | FileChange::Rebased => file.changed_by_others(),
            _ => Vec::new(),
        };
        let line = match change {
            FileChange::None | FileChange::Saved => None,
            // Events are consumed without a screen, where there are no edits.
            FileChange::FirstRead if !file.is_there() && emits => {
                Some((TimelineKind::File, "not found: devices are not compared".to_owned()))
            }
            FileChange::FirstRead if !file.is_there() => {
                Some((TimelineKind::File, "not found: the first edit creates it".to_owned()))
            }
            FileChange::FirstRead => {
                let path = file.path().map(crate::text::printable_path).unwrap_or_default();
                let folder = if path == file.name() { String::new() } else { format!(", {path}") };
                Some((TimelineKind::File, format!("{listed}{folder}")))
            }
            FileChange::Content if !file.is_there() && emits => {
                Some((TimelineKind::File, "deleted: devices are no longer compared".to_owned()))
            }
            FileChange::Content if !file.is_there() => {
                Some((TimelineKind::File, "deleted: the next edit creates a new file".to_owned()))
            }
            FileChange::Content if !by_others.is_empty() => None,
            FileChange::Content => Some((TimelineKind::File, format!("changed on disk: {listed}"))),
            // The user decided an edit conflict for the file, or both made the same change.
            FileChange::Rebased if file.unsaved() == 0 => None,
            FileChange::Rebased => {
                Some((TimelineKind::File, "changed on disk; your edits are reapplied".to_owned()))
            }
            FileChange::Unusable => {
                let problem = file.problem().map(ToString::to_string).unwrap_or_default();
                Some((TimelineKind::Error, problem))
            }
            FileChange::Conflict => {
                Some((TimelineKind::Error, "edit conflict: same value changed on disk".to_owned()))
            }
        };
        let by_others = join_short(by_others).into_iter();
        let by_others =
            by_others.map(|text| (TimelineKind::File, format!("changed on disk, {text}")));
        let mut lines: Vec<(TimelineKind, String)> = by_others.chain(line).collect();
        // As events they are findings.
        if matches!(change, FileChange::FirstRead | FileChange::Content | FileChange::Rebased)
            && !emits
        {
            let findings = inputs!(self).file(index).map(file_mistakes).unwrap_or_default();
            let texts = findings.iter().take(LISTED_FINDINGS).map(ToString::to_string);
            let more = findings.len().saturating_sub(LISTED_FINDINGS);
            let rest = (more > 0).then(|| format!("and {more} more errors in the file"));
            lines.extend(texts.chain(rest).map(|text| (TimelineKind::File, text)));
        }
        lines
    }

    /// Begins a save, if edits wait for one.
    pub(super) fn save_pending(&mut self, file: FileIndex) {
        if let Some(saving) = self.files.get_mut(file).file.start_saving() {
            let (expected, content) = (saving.expected, saving.content);
            self.effects.push_back(Effect::Save { file, expected, content });
        }
    }

    /// Opens the edit conflict; an open prompt waits until it is resolved.
    pub(super) fn show_conflict(&mut self) {
        self.input.show_conflict(self.clock.now());
    }

    /// Closes an edit conflict that is over, with a message if a further change on disk resolved it.
    fn leave_conflict_that_is_over(&mut self, file: FileIndex, change: FileChange) {
        if !self.input.shows_conflict() || self.conflicting_file().is_some() {
            return;
        }
        self.input.leave_conflict();
        if matches!(change, FileChange::Content | FileChange::Rebased) {
            let text = "file changed again: conflict resolved, your edits are included";
            self.add_file_line(file, TimelineKind::File, text);
            self.show_info(text);
        }
    }
}
