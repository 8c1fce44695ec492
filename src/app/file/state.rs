//! State of des.json: content on disk, unsaved edits, undo and redo.
//!
//! Edits are operations on the content that was read last. If the file changes on disk, they are
//! applied again to the newer content; if both sides changed the same value, the user chooses.
//! Inputs: [`FileReading`], [`SaveOutcome`] and edits. Outputs: [`FileChange`] and [`Saving`]. Does
//! not read or write the file and does not know the bus.

use super::change::{EditRefusal, FileChange, FileError, FileReading, SaveOutcome};
use super::undo_stack::{UndoStack, UndoStep, apply_all, name_of};
use crate::diagnostic::Diagnostic;
use crate::document::{
    ConflictChoices, Document, EditConflict, EditError, Merge, MergePreference, Operation, changes,
    merge, merge_with_choices,
};
use crate::time::Instant;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// A save in progress.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Saving {
    /// Content that must be on disk for the save to be made; `None`: no file.
    pub expected: Option<Document>,
    /// Content to write.
    pub content: Document,
    /// Number of pending edits in the content.
    operations: usize,
    /// The content was read back from disk; the outcome of the save is not known yet.
    seen_on_disk: bool,
    /// Other content was read from disk since: the file must be read again after the save.
    disk_changed: bool,
    /// The pending edits were applied to that other content: the outcome of the save does not
    /// apply to their base.
    base_changed: bool,
    /// The content that the pending edits apply to, and with it perhaps their number, was replaced since.
    is_rebased: bool,
}

/// An edit conflict. Nothing is written until the user has decided all conflicts.
#[derive(Clone, Debug)]
struct PendingConflict {
    /// The conflict to decide next.
    conflict: EditConflict,
    /// Content on disk.
    theirs: Document,
    /// Choices made for this content; dropped if the file changes again.
    choices: ConflictChoices,
}

/// An empty file, just found. Many programs empty a file before they write it: the previous
/// content stays valid until the file has content again or has stayed empty for a while.
#[derive(Debug)]
struct Emptied {
    since: Instant,
    /// True if the file is read again, to see whether it is still empty.
    is_read_again: bool,
}

/// State of des.json.
#[derive(Debug)]
pub struct FileState {
    path: Option<PathBuf>,
    /// The end of the path that tells it from the other files; empty for its name alone.
    shown_path: PathBuf,
    /// Orders its edits among those of all files.
    turn: u64,
    /// Last valid content on disk; `None` before the first reading.
    disk: Option<Document>,
    is_on_disk: bool,
    /// Content before the last change on disk by another program.
    previous_disk: Option<Document>,
    /// Number of entries that were deleted with the file; 0 while it is there.
    deleted_entries: usize,
    /// Last valid content with the unsaved edits.
    document: Document,
    pending: Vec<Operation>,
    saving: Option<Saving>,
    emptied: Option<Emptied>,
    problem: Option<FileError>,
    pending_conflict: Option<PendingConflict>,
    undo: UndoStack,
    redo: UndoStack,
    /// Edits that reached the disk, until they are taken.
    saved: Vec<SavedEdits>,
}

/// Edits that reached the disk.
#[derive(Clone, Debug)]
pub(super) struct SavedEdits {
    /// Content on disk without them.
    pub before: Document,
    /// The same with them.
    pub after: Document,
    /// Addresses that the user set in them; those that an undone edit brings back are none.
    pub chosen: Vec<u8>,
}

/// Returns the addresses that these edits set.
fn chosen_addresses(operations: &[Operation]) -> Vec<u8> {
    let chosen = |operation: &Operation| match operation {
        Operation::PinAddress { to, .. } => Some(*to),
        Operation::Add { entry } => entry.address,
        _ => None,
    };
    operations.iter().filter_map(chosen).collect()
}

/// The last valid content of the file at some moment, with the unsaved edits.
#[derive(Clone, Debug)]
pub(in crate::app) struct FileContent {
    /// The content; empty before the first reading.
    pub document: Document,
    /// True if there is a file, or edits that make one.
    pub is_there: bool,
    /// Why it could not be read or saved.
    pub problem: Option<FileError>,
}

impl FileContent {
    /// Returns true if both are the same content in memory.
    pub fn is_same(&self, other: &Self) -> bool {
        self.is_there == other.is_there
            && self.document.is_same(&other.document)
            && self.problem == other.problem
    }
}

impl FileState {
    /// The content at this moment.
    pub(in crate::app) fn content(&self) -> FileContent {
        let (document, problem) = (self.document.clone(), self.problem.clone());
        FileContent { document, is_there: self.is_there(), problem }
    }

    /// Returns the state of the file at this path, not read yet.
    pub fn new(path: Option<PathBuf>) -> Self {
        Self {
            path,
            shown_path: PathBuf::new(),
            turn: 0,
            disk: None,
            is_on_disk: false,
            previous_disk: None,
            deleted_entries: 0,
            document: Document::empty(),
            pending: Vec::new(),
            saving: None,
            emptied: None,
            problem: None,
            pending_conflict: None,
            undo: UndoStack::default(),
            redo: UndoStack::default(),
            saved: Vec::new(),
        }
    }

    /// Path of the file; `None` without a file.
    pub fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    /// File name for the screen: without folders, unless another file has the same name.
    pub fn name(&self) -> String {
        let name = self.path.as_deref().and_then(Path::file_name).unwrap_or_default();
        let shown = self.shown_path.as_os_str();
        let name = if shown.is_empty() { name } else { shown };
        crate::text::printable_path(Path::new(name))
    }

    /// Sets the end of its path that tells it from the other files.
    pub(super) fn set_shown_path(&mut self, path: PathBuf) {
        self.shown_path = path;
    }

    /// Sets the number that orders the edits made from now on among those of all files.
    pub(super) fn set_turn(&mut self, turn: u64) {
        self.turn = turn;
    }

    /// When the edit that is undone next was made; `None` without one.
    pub(super) fn undo_turn(&self) -> Option<u64> {
        self.undo.turn()
    }

    /// When the edit that is redone next was undone; `None` without one.
    pub(super) fn redo_turn(&self) -> Option<u64> {
        self.redo.turn()
    }

    /// Forgets the edits that were undone: another file was edited since.
    pub(super) fn forget_undone(&mut self) {
        self.redo.clear();
    }

    /// Last valid content with the unsaved edits.
    pub fn document(&self) -> &Document {
        &self.document
    }

    /// Last valid content on disk; `None` before the first reading.
    pub fn on_disk(&self) -> Option<&Document> {
        self.disk.as_ref()
    }

    /// Last change on disk by another program, one text per entry; empty for many entries.
    pub fn changed_by_others(&self) -> Vec<String> {
        /// Largest number of changed entries that are listed.
        const FEW: usize = 3;
        match (&self.previous_disk, &self.disk) {
            (Some(former), Some(disk)) => changes(former, disk, FEW),
            _ => Vec::new(),
        }
    }

    /// Content with all edits. During edit conflicts it has the choices made so far, and ours for
    /// the others.
    pub fn with_all_edits(&self) -> Document {
        let merged = self.pending_conflict.as_ref().and_then(
            |PendingConflict { theirs, choices, .. }| {
                let base = self.disk.clone().unwrap_or_else(Document::empty);
                merge_with_choices(&base, &self.pending, theirs, choices, MergePreference::Ours)
                    .ok()
            },
        );
        match merged {
            Some(Merge::Rebased { document, .. }) => document,
            _ => self.document.clone(),
        }
    }

    /// Returns true if the file exists or will be created by a pending edit.
    pub fn is_there(&self) -> bool {
        self.is_on_disk || !self.pending.is_empty()
    }

    /// Number of entries that were deleted with the file, by another program; 0 while there is one, or
    /// edits that will create it.
    pub fn deleted_entries(&self) -> usize {
        if self.is_there() { 0 } else { self.deleted_entries }
    }

    /// Returns true if the file was read, with or without errors.
    pub fn is_read(&self) -> bool {
        self.disk.is_some() || self.problem.is_some()
    }

    /// Returns true if the file was valid once; its last valid content is kept.
    pub fn has_valid_content(&self) -> bool {
        self.disk.is_some()
    }

    /// Returns true if an edit can be undone.
    pub fn can_undo(&self) -> bool {
        !self.undo.is_empty()
    }

    /// Problem that prevents reading or saving; `None` for a usable file.
    pub fn problem(&self) -> Option<&FileError> {
        self.problem.as_ref()
    }

    /// The edit conflict to decide next.
    pub fn conflict(&self) -> Option<&EditConflict> {
        self.pending_conflict.as_ref().map(|dispute| &dispute.conflict)
    }

    /// Number of unsaved edits.
    pub fn unsaved(&self) -> usize {
        self.pending.len()
    }

    /// Returns true if there is nothing to save: no unsaved edit, and no save that the disk did not
    /// confirm.
    pub fn is_settled(&self) -> bool {
        self.pending.is_empty() && !matches!(self.problem, Some(FileError::Unconfirmed(_)))
    }

    /// Returns the edits that reached the disk since the last call.
    pub(super) fn take_saved(&mut self) -> Vec<SavedEdits> {
        std::mem::take(&mut self.saved)
    }

    /// Returns true if a save is in progress.
    pub fn is_saving(&self) -> bool {
        self.saving.is_some()
    }

    /// Time since when the file is empty and perhaps being written. Until it has content, or is
    /// still empty at the reading after [`Self::settle_empty`], the previous content stays valid and
    /// nothing is saved.
    pub fn emptied_since(&self) -> Option<Instant> {
        self.emptied.as_ref().map(|emptied| emptied.since)
    }

    /// The same until the file is read again for that.
    pub fn empty_unsettled_since(&self) -> Option<Instant> {
        self.emptied.as_ref().filter(|it| !it.is_read_again).map(|emptied| emptied.since)
    }

    /// Returns true if other content was read from disk since the save began: the file must then be
    /// read again after the save, whatever its outcome.
    pub fn is_base_changed(&self) -> bool {
        self.saving.as_ref().is_some_and(|saving| saving.disk_changed)
    }

    /// Handles content read from disk. Changes by other programs are also handled during a save,
    /// which may take long on a slow disk.
    pub fn read(&mut self, now: Instant, reading: FileReading) -> FileChange {
        let found = reading.found();
        if self.waits_for_outcome(&found) {
            return FileChange::None;
        }
        let found = match found {
            Ok(found) => found,
            Err(problem) => {
                self.emptied = None;
                let change = if self.problem.as_ref() == Some(&problem) {
                    FileChange::None
                } else {
                    FileChange::Unusable
                };
                self.problem = Some(problem);
                return change;
            }
        };
        let is_there = found.is_some();
        let theirs = found.unwrap_or_else(Document::empty);
        // Content compared with last. During a conflict the file may get its previous content back,
        // which ends the conflict.
        let known = self.pending_conflict.as_ref().map(|it| &it.theirs).or(self.disk.as_ref());
        let was_empty =
            known.is_none_or(|known| self.is_on_disk && known.is_blank()) || !theirs.is_blank();
        if is_there && !was_empty {
            let emptied = self.emptied.get_or_insert(Emptied { since: now, is_read_again: false });
            if !emptied.is_read_again {
                return FileChange::None;
            }
        }
        self.emptied = None;
        self.supersede_save(&theirs);
        let known = self.pending_conflict.as_ref().map(|it| &it.theirs).or(self.disk.as_ref());
        if known == Some(&theirs) && self.is_on_disk == is_there {
            let was_broken =
                matches!(self.problem, Some(FileError::Syntax(_) | FileError::Unreadable(_)));
            if was_broken {
                self.problem = None;
                self.previous_disk = None;
            }
            return if was_broken { FileChange::Content } else { FileChange::None };
        }
        self.load(theirs, is_there)
    }

    /// Makes the next reading decide whether the file is empty. Returns true if it is to be read
    /// again.
    pub fn settle_empty(&mut self) -> bool {
        let Some(emptied) = &mut self.emptied else { return false };
        !std::mem::replace(&mut emptied.is_read_again, true)
    }

    /// Stores content that differs from the known one.
    fn load(&mut self, theirs: Document, is_there: bool) -> FileChange {
        let is_first = self.disk.is_none();
        self.previous_disk = self.disk.clone().filter(|_| self.is_on_disk && is_there);
        if is_there || self.is_on_disk {
            let before = self.disk.as_ref().filter(|_| !is_there);
            self.deleted_entries = before.map_or(0, |it| it.entries().len());
        }
        self.is_on_disk = is_there;
        self.problem = None;
        if self.pending.is_empty() {
            self.document = theirs.clone();
            self.disk = Some(theirs);
            self.note_rebase();
            return if is_first { FileChange::FirstRead } else { FileChange::Content };
        }
        let file_was_deleted = self.pending_conflict.take().is_some() && !is_there;
        self.rebase(theirs, ConflictChoices { file_was_deleted, ..ConflictChoices::default() })
    }

    /// Returns true if the content read during a save is the content being written, or was read
    /// after that: only the outcome tells whether the save was overwritten or put back. Any content
    /// but that of the save and the expected one marks the save as overtaken.
    fn waits_for_outcome(&mut self, found: &Result<Option<Document>, FileError>) -> bool {
        let Some(saving) = &mut self.saving else { return false };
        if found.as_ref().is_ok_and(|found| found.as_ref() == Some(&saving.content)) {
            saving.seen_on_disk = true;
            self.emptied = None;
            return true;
        }
        if saving.base_changed {
            return false;
        }
        let is_as_before = found.as_ref().is_ok_and(|found| *found == saving.expected);
        saving.disk_changed |= !is_as_before || saving.seen_on_disk;
        saving.seen_on_disk
    }

    /// Marks a running save as superseded if another program wrote `theirs` during it. If the edits
    /// of the save were on disk before that, they count as saved.
    fn supersede_save(&mut self, theirs: &Document) {
        let Some(saving) = self.saving.as_mut().filter(|saving| !saving.base_changed) else {
            return;
        };
        if saving.expected.as_ref() == Some(theirs) {
            return;
        }
        saving.base_changed = true;
        let ours = &self.pending[..saving.operations.min(self.pending.len())];
        let base = self.disk.clone().unwrap_or_else(Document::empty);
        // Theirs has all edits of the save: they were on disk, although not read back.
        let has_ours = || match merge(&base, ours, theirs, MergePreference::Neither) {
            Ok(Merge::Rebased { document, .. }) => document == *theirs,
            _ => false,
        };
        if has_ours() {
            let (content, count) = (saving.content.clone(), ours.len());
            self.note_saved(content, count);
            self.note_rebase();
        }
    }

    /// Notes that the first `count` pending edits are on disk, in this content.
    fn note_saved(&mut self, content: Document, count: usize) {
        let chosen = chosen_addresses(&self.pending[..count]);
        self.pending.drain(..count);
        let before = self.disk.replace(content.clone()).unwrap_or_else(Document::empty);
        self.is_on_disk = true;
        self.saved.push(SavedEdits { before, after: content, chosen });
    }

    /// Notes in a running save that the pending edits apply to other content.
    fn note_rebase(&mut self) {
        if let Some(saving) = &mut self.saving {
            saving.is_rebased = true;
        }
    }

    /// Applies the pending edits to newer content.
    fn rebase(&mut self, theirs: Document, choices: ConflictChoices) -> FileChange {
        let base = self.disk.clone().unwrap_or_else(Document::empty);
        match merge_with_choices(&base, &self.pending, &theirs, &choices, MergePreference::Neither)
        {
            Ok(Merge::Rebased { document, operations, overwriting: overruling }) => {
                if let Err(error) = self.add_steps_to_theirs(&theirs, &operations, &overruling) {
                    self.problem = Some(FileError::NotSaved(Diagnostic::new(error.to_string())));
                    return FileChange::Unusable;
                }
                self.disk = Some(theirs);
                self.document = document;
                self.pending = operations;
                self.note_rebase();
                FileChange::Rebased
            }
            Ok(Merge::Conflict(conflict)) => {
                self.pending_conflict = Some(PendingConflict { conflict, theirs, choices });
                FileChange::Conflict
            }
            Err(error) => {
                self.problem = Some(FileError::NotSaved(Diagnostic::new(error.to_string())));
                FileChange::Unusable
            }
        }
    }

    /// Adds an undo step, back to theirs, for each edit that overrules theirs.
    fn add_steps_to_theirs(
        &mut self,
        theirs: &Document,
        operations: &[Operation],
        overruling: &[Range<usize>],
    ) -> Result<(), EditError> {
        let mut made = 0;
        let mut document = theirs.clone();
        for range in overruling {
            for operation in &operations[made..range.start] {
                document = document.apply(operation)?;
            }
            made = range.end;
            let ours = &operations[range.clone()];
            let name = ours.last().map(ToString::to_string).unwrap_or_default();
            let (after, inverses) = apply_all(&document, ours)?;
            let step = UndoStep::new(after.clone(), inverses, name, self.is_on_disk);
            let step = step.at(self.turn);
            self.undo.push(step, &document);
            self.redo.clear();
            document = after;
        }
        Ok(())
    }

    /// Decides the edit conflict; returns [`FileChange::Conflict`] if another one is left to
    /// decide.
    pub fn resolve(&mut self, ours: bool) -> FileChange {
        let Some(PendingConflict { theirs, mut choices, .. }) = self.pending_conflict.take() else {
            return FileChange::None;
        };
        choices.chosen.push(if ours { MergePreference::Ours } else { MergePreference::Theirs });
        self.rebase(theirs, choices)
    }

    /// Numbers of conflicts decided so far for ours and for theirs.
    pub fn chosen(&self) -> (usize, usize) {
        let chosen = self.pending_conflict.iter().flat_map(|dispute| &dispute.choices.chosen);
        let ours = chosen.clone().filter(|it| **it == MergePreference::Ours).count();
        (ours, chosen.count() - ours)
    }

    /// Checks whether the file can be edited.
    ///
    /// # Errors
    ///
    /// The reason why it cannot.
    pub fn check(&self) -> Result<(), EditRefusal> {
        if self.path.is_none() {
            return Err(EditRefusal::NoFile);
        }
        match &self.problem {
            Some(problem @ (FileError::Syntax(_) | FileError::Unreadable(_))) => {
                Err(EditRefusal::Unusable(problem.to_string()))
            }
            _ if self.disk.is_none() => Err(EditRefusal::NotRead),
            _ if self.pending_conflict.is_some() => Err(EditRefusal::Conflict),
            _ => Ok(()),
        }
    }

    /// Checks, before the user types, whether entries can be added and whether the entry at this
    /// place, if given, can be edited.
    ///
    /// # Errors
    ///
    /// The reason why not.
    pub fn check_edit(&self, entry: Option<usize>) -> Result<(), EditRefusal> {
        self.check()?;
        Ok(self.document.check_edit(entry)?)
    }

    /// Checks whether the present content permits this edit.
    ///
    /// # Errors
    ///
    /// The reason why not.
    pub fn check_operation(&self, operation: &Operation) -> Result<(), EditRefusal> {
        self.check()?;
        Ok(self.document.check_operation(operation)?)
    }

    /// Makes an edit and returns its name.
    ///
    /// # Errors
    ///
    /// The file cannot be edited, or an operation does not apply to it.
    pub fn edit(&mut self, operations: &[Operation]) -> Result<String, EditRefusal> {
        self.check()?;
        let name = match operations {
            [only] => only.to_string(),
            many => name_of(many),
        };
        let before = self.document.clone();
        let undo = self.apply_operations(operations, name.clone())?;
        self.undo.push(undo, &before);
        self.redo.clear();
        Ok(name)
    }

    /// Undoes the last edit and returns its name. Values that changed on disk since are kept, and
    /// the name mentions them. A refused step is dropped: the next call undoes the edit before it.
    ///
    /// # Errors
    ///
    /// The file cannot be edited, nothing is left to undo, or the step has no effect.
    pub fn undo(&mut self) -> Result<String, EditRefusal> {
        self.check()?;
        let step = self.undo.pop().ok_or(EditRefusal::NothingToUndo)?;
        let before = self.document.clone();
        let (redo, name) = self.apply_step(step, "undone")?;
        self.redo.push(redo, &before);
        Ok(name)
    }

    /// Redoes the edit that was undone last and returns its name, with the rules and errors of
    /// [`Self::undo`].
    pub fn redo(&mut self) -> Result<String, EditRefusal> {
        self.check()?;
        let step = self.redo.pop().ok_or(EditRefusal::NothingToRedo)?;
        let before = self.document.clone();
        let (undo, name) = self.apply_step(step, "redone")?;
        self.undo.push(undo, &before);
        Ok(name)
    }

    /// Applies the operations of a step to the present content; returns the step that reverts it,
    /// and its name. A value that changed on disk since is kept: undo never overwrites it.
    fn apply_step(
        &mut self,
        mut step: UndoStep,
        done: &'static str,
    ) -> Result<(UndoStep, String), EditRefusal> {
        let mut shown_name = step.shown();
        if self.is_on_disk && !step.had_file {
            // The file is not deleted, and an empty file is not JSON: keep an empty list.
            let operations = step.operations.into_iter();
            step.operations = operations.map(Operation::keeping_empty_list).collect();
        }
        if let Some(on) = step.base.filter(|on| *on != self.document) {
            let again = |prefer| merge(&on, &step.operations, &self.document, prefer);
            let conflict = match again(MergePreference::Neither)? {
                Merge::Conflict(conflict) => Some(conflict),
                Merge::Rebased { .. } => None,
            };
            let operations = match again(MergePreference::Theirs)? {
                Merge::Rebased { operations, .. } => operations,
                Merge::Conflict(_) => Vec::new(),
            };
            match conflict {
                _ if operations.is_empty() && !self.is_on_disk && step.had_file => {
                    return Err(EditRefusal::Deleted { done, name: shown_name });
                }
                Some(EditConflict { theirs, .. }) if operations.is_empty() => {
                    return Err(EditRefusal::ChangedSince { done, name: shown_name, theirs });
                }
                None if operations.is_empty() => {
                    return Err(EditRefusal::AlreadyDone { done, name: shown_name });
                }
                Some(EditConflict { operation, total: of, .. }) => {
                    let first = operation.subject();
                    let more = if of > 1 { format!(" and {} more", of - 1) } else { String::new() };
                    shown_name = format!("{shown_name}, except {first}{more} (changed on disk)");
                }
                None => {}
            }
            step.operations = operations;
        }
        let made = self.apply_operations(&step.operations, step.name)?;
        self.drop_what_cancels_out(2 * step.operations.len());
        Ok((UndoStep { whole: step.whole, ..made }, shown_name))
    }

    /// Applies operations to the present content; returns the step that reverts them.
    fn apply_operations(
        &mut self,
        operations: &[Operation],
        name: String,
    ) -> Result<UndoStep, EditRefusal> {
        let (document, inverses) = apply_all(&self.document, operations)?;
        self.pending.extend_from_slice(operations);
        self.document = document.clone();
        self.drop_what_is_on_disk();
        Ok(UndoStep::new(document, inverses, name, self.is_on_disk).at(self.turn))
    }

    /// Drops the last `count` pending operations if the content is the same without them, as for an
    /// edit that was undone before its save began.
    fn drop_what_cancels_out(&mut self, count: usize) {
        let (from, being_saved) = match &self.saving {
            Some(saving) if !saving.base_changed => (Some(&saving.content), saving.operations),
            _ => (self.disk.as_ref(), 0),
        };
        let (Some(from), Some(keep)) = (from, self.pending.len().checked_sub(count)) else {
            return;
        };
        let Some(kept) = self.pending.get(being_saved..keep) else { return };
        let without = kept.iter().try_fold(from.clone(), |on, operation| on.apply(operation));
        if without.is_ok_and(|without| without == self.document) {
            self.pending.truncate(keep);
        }
    }

    /// Keeps an empty list where undo removes the first entry of a file that the save has just
    /// created: an empty file is not JSON.
    fn leave_list(&mut self) {
        let Some(disk) = &self.disk else { return };
        let operations: Vec<_> =
            self.pending.iter().cloned().map(Operation::keeping_empty_list).collect();
        if let Ok((document, _)) = apply_all(disk, &operations) {
            self.document = document;
            self.pending = operations;
        }
    }

    /// Drops the pending edits if the content equals the content on disk.
    fn drop_what_is_on_disk(&mut self) {
        if self.saving.is_none() && self.disk.as_ref() == Some(&self.document) {
            self.pending.clear();
        }
        if self.pending.is_empty() && matches!(self.problem, Some(FileError::NotSaved(_))) {
            self.problem = None;
        }
    }

    /// Starts a save and returns it; `None` if nothing can or need be saved now.
    pub fn start_saving(&mut self) -> Option<Saving> {
        let waits =
            self.saving.is_some() || self.pending_conflict.is_some() || self.emptied.is_some();
        if waits || self.is_settled() || self.check().is_err() {
            return None;
        }
        let expected = self.disk.as_ref().filter(|_| self.is_on_disk);
        let saving = Saving {
            expected: expected.cloned(),
            content: self.document.clone(),
            operations: self.pending.len(),
            seen_on_disk: false,
            disk_changed: false,
            base_changed: false,
            is_rebased: false,
        };
        self.saving = Some(saving.clone());
        Some(saving)
    }

    /// Handles the outcome of a save. Edits made during the save stay pending for the next one.
    pub fn handle_saved(&mut self, now: Instant, outcome: SaveOutcome) -> FileChange {
        let Some(saving) = self.saving.take() else { return FileChange::None };
        match outcome {
            SaveOutcome::Saved | SaveOutcome::LinksBroken(_) => {
                self.settle(saving);
                if self.problem.as_ref().is_some_and(FileError::is_not_saved) {
                    self.problem = None;
                }
                self.drop_what_is_on_disk();
                FileChange::Saved
            }
            // The content read since is newer, or the file will be read again.
            SaveOutcome::Changed(_) if saving.disk_changed => {
                self.drop_what_is_on_disk();
                FileChange::None
            }
            SaveOutcome::Changed(found) => self.read(now, found),
            SaveOutcome::Unconfirmed(why) => {
                self.settle(saving);
                if self.check().is_err() {
                    return FileChange::None;
                }
                self.problem = Some(FileError::Unconfirmed(why));
                FileChange::Unusable
            }
            SaveOutcome::Failed(why) => {
                let is_told = self.check().is_err();
                if !is_told {
                    self.problem = Some(FileError::NotSaved(why));
                }
                // The edits of the save may have been undone during it.
                self.drop_what_is_on_disk();
                if is_told || self.pending.is_empty() {
                    FileChange::None
                } else {
                    FileChange::Unusable
                }
            }
        }
    }

    /// Returns true if the undecided conflict is none since the save was made: it replaced what the
    /// edits began with, so another program changed what the save wrote. The file is read again.
    fn has_conflict_after(&self, saving: &Saving) -> bool {
        let is_undecided =
            self.pending_conflict.as_ref().is_some_and(|it| it.choices.chosen.is_empty());
        is_undecided && saving.base_changed && !saving.is_rebased
    }

    /// Takes the content of a save as the content on disk, unless another program's is known.
    fn settle(&mut self, saving: Saving) {
        if self.has_conflict_after(&saving) {
            self.pending_conflict = None;
        } else if saving.base_changed {
            return;
        }
        self.note_saved(saving.content, saving.operations.min(self.pending.len()));
        if saving.expected.is_none() {
            self.leave_list();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::EntryKey;

    const NOW: Instant = Instant::ZERO;
    const FILE: &str = r#"{"devices":[{"name":"FEED","address":12,"static":true}]}"#;

    fn content(text: &str) -> FileReading {
        FileReading::Content(Some(text.as_bytes().to_vec()))
    }

    fn opened() -> FileState {
        let mut file = FileState::new(Some("des.json".into()));
        assert_eq!(file.read(NOW, content(FILE)), FileChange::FirstRead);
        file
    }

    fn set_address(file: &FileState, to: u8) -> Operation {
        let entry: EntryKey = file.document().key(0);
        let from = entry.address;
        Operation::PinAddress { entry, from, to }
    }

    fn source(file: &FileState) -> &str {
        std::str::from_utf8(file.document().source()).unwrap()
    }

    #[test]
    fn edit_is_saved_and_undone() {
        let mut file = opened();
        let name = file.edit(&[set_address(&file, 16)]).unwrap();
        assert_eq!(name, "address of the entry FEED: 12 → 16");
        let saving = file.start_saving().unwrap();
        assert_eq!(saving.expected.unwrap().source(), FILE.as_bytes());
        assert_eq!(saving.content.source(), FILE.replace("12", "16").as_bytes());
        assert_eq!(file.handle_saved(NOW, SaveOutcome::Saved), FileChange::Saved);
        assert_eq!((file.unsaved(), file.start_saving()), (0, None));
        file.undo().unwrap();
        assert_eq!(source(&file), FILE);
        assert_eq!(file.unsaved(), 1);
        file.redo().unwrap();
        assert_eq!(source(&file), FILE.replace("12", "16"));
        assert_eq!(file.redo(), Err(EditRefusal::NothingToRedo));
    }

    #[test]
    fn save_never_overwrites_other_writers() {
        let mut file = opened();
        file.edit(&[set_address(&file, 16)]).unwrap();
        file.start_saving().unwrap();
        let theirs = FILE.replace("FEED", "FEEDX").replace("true", "true, \"note\":1");
        let outcome = SaveOutcome::Changed(content(&theirs));
        assert_eq!(file.handle_saved(NOW, outcome), FileChange::Rebased);
        let saving = file.start_saving().unwrap();
        assert_eq!(saving.expected.unwrap().source(), theirs.as_bytes());
        assert_eq!(saving.content.source(), theirs.replace("12", "16").as_bytes());
    }

    #[test]
    fn undo_across_disk_changes_stores_few_documents() {
        let mut file = opened();
        let kept = |file: &FileState| file.undo.kept();
        let saved = |file: &mut FileState| {
            file.start_saving().unwrap();
            file.handle_saved(NOW, SaveOutcome::Saved);
        };
        for to in 13..=20 {
            file.edit(&[set_address(&file, to)]).unwrap();
            saved(&mut file);
        }
        assert_eq!(kept(&file), 1);
        let noted = |address: &str| FILE.replace("12", address).replace("true", "true, \"x\":1");
        assert_eq!(file.read(NOW, content(&noted("20"))), FileChange::Content);
        for to in 21..=25 {
            file.edit(&[set_address(&file, to)]).unwrap();
        }
        assert_eq!(kept(&file), 2);
        while file.undo().is_ok() {}
        assert_eq!(source(&file), noted("12"));
        while file.redo().is_ok() {}
        assert_eq!(source(&file), noted("25"));
        assert!(kept(&file) <= 2);
        (0..9).for_each(|_| drop(file.undo().unwrap()));
        assert_eq!(source(&file), noted("16"));
    }

    /// A slow disk: what the save takes out is put back long after its own content is read.
    #[test]
    fn edit_of_a_save_that_is_put_back_late_stays() {
        let mut file = opened();
        file.edit(&[set_address(&file, 16)]).unwrap();
        let saving = file.start_saving().unwrap();
        let theirs = FILE.replace("true", "true, \"note\":1");
        assert_eq!(file.read(NOW, content(&theirs)), FileChange::Rebased);
        let ours = std::str::from_utf8(saving.content.source()).unwrap();
        assert_eq!(file.read(NOW, content(ours)), FileChange::None);
        assert_eq!(file.read(NOW, content(&theirs)), FileChange::None);
        assert!(file.is_base_changed());
        let outcome = SaveOutcome::Changed(content(&theirs));
        assert_eq!(file.handle_saved(NOW, outcome), FileChange::None);
        assert_eq!(file.read(NOW, content(&theirs)), FileChange::None);
        let again = file.start_saving().unwrap();
        assert_eq!(again.expected.unwrap().source(), theirs.as_bytes());
        assert_eq!(again.content.source(), theirs.replace("12", "16").as_bytes());
    }

    /// A slow disk: the new content is read long before the save ends.
    #[test]
    fn content_found_during_save_is_loaded_at_once() {
        let ours = FILE.replace("12", "16");
        for (found, change) in [
            (ours.clone(), FileChange::None),
            (ours.replace("true", "true, \"note\":1"), FileChange::Rebased),
            (FILE.replace("true", "true, \"note\":1"), FileChange::Rebased),
        ] {
            let mut file = opened();
            file.edit(&[set_address(&file, 16)]).unwrap();
            file.start_saving().unwrap();
            file.edit(&[set_address(&file, 17)]).unwrap();
            assert_eq!(file.read(NOW, content(&found)), change);
            let both = found.replace("12", "16").replace("16", "17");
            assert_eq!(source(&file), both);
            assert_eq!(file.start_saving(), None);
            assert_eq!(file.is_base_changed(), found != ours);
            assert_eq!(file.handle_saved(NOW, SaveOutcome::Saved), FileChange::Saved);
            let saving = file.start_saving().unwrap();
            assert_eq!(saving.expected.unwrap().source(), found.as_bytes());
            assert_eq!(saving.content.source(), both.as_bytes());
            // The disk fails: the edit stays unsaved.
            file.handle_saved(NOW, SaveOutcome::Failed(Diagnostic::new("no room")));
            assert!(file.unsaved() > 0);
        }
    }

    /// Content read after the content of a save: another program overwrote the save, or the save
    /// was put back because that program had written before it.
    #[test]
    fn content_after_a_save_waits_for_its_outcome() {
        let theirs = FILE.replace("true", "true, \"note\":1");
        for outcome in [SaveOutcome::Saved, SaveOutcome::Changed(content(&theirs))] {
            let is_saved = outcome.is_on_disk();
            let mut file = opened();
            file.edit(&[set_address(&file, 16)]).unwrap();
            file.start_saving().unwrap();
            assert_eq!(file.read(NOW, content(&FILE.replace("12", "16"))), FileChange::None);
            assert_eq!(file.unsaved(), 1, "that it stays there is not known");
            assert_eq!(file.read(NOW, content(&theirs)), FileChange::None);
            assert!(file.is_base_changed(), "the file is read again");
            file.handle_saved(NOW, outcome);
            let change = file.read(NOW, content(&theirs));
            if is_saved {
                // Not overwritten in turn.
                assert_eq!((change, file.unsaved()), (FileChange::Content, 0));
                assert_eq!(source(&file), theirs);
            } else {
                assert_eq!((change, file.unsaved()), (FileChange::Rebased, 1));
                assert_eq!(source(&file), theirs.replace("12", "16"));
            }
        }
    }

    /// The content of the save itself was not read: another program set another address just after
    /// it, or just before it.
    #[test]
    fn conflict_found_during_a_save_ends_if_the_save_was_before_it() {
        let theirs = FILE.replace("12", "13");
        for outcome in [
            SaveOutcome::Saved,
            SaveOutcome::Changed(content(&theirs)),
            SaveOutcome::Failed(Diagnostic::new("no room")),
        ] {
            let is_saved = outcome.is_on_disk();
            let mut file = opened();
            file.edit(&[set_address(&file, 16)]).unwrap();
            file.start_saving().unwrap();
            assert_eq!(file.read(NOW, content(&theirs)), FileChange::Conflict);
            assert!(file.is_base_changed(), "the file is read again");
            file.handle_saved(NOW, outcome);
            assert_eq!(file.conflict().is_some(), !is_saved);
            let change = file.read(NOW, content(&theirs));
            if is_saved {
                assert_eq!((change, file.unsaved()), (FileChange::Content, 0));
                assert_eq!(source(&file), theirs);
            } else {
                assert_eq!((change, file.unsaved()), (FileChange::None, 1));
            }
        }
    }

    /// While a slow save runs, other programs write the edit of the save, the content before it, and another
    /// address for a later edit.
    #[test]
    fn later_edit_is_asked_about_although_the_save_was_made() {
        let two = r#"{"devices":[{"name":"FEED","address":12,"static":true},
            {"name":"PUMP","address":40,"static":true}]}"#;
        let mut file = FileState::new(Some("des.json".into()));
        file.read(NOW, content(two));
        file.edit(&[set_address(&file, 16)]).unwrap();
        file.start_saving().unwrap();
        let entry = file.document().key(1);
        file.edit(&[Operation::PinAddress { from: entry.address, entry, to: 41 }]).unwrap();
        let theirs = two.replace("40", "42");
        for theirs in [&format!("{} ", two.replace("12", "16")), two, &theirs] {
            file.read(NOW, content(theirs));
        }
        assert!(file.conflict().is_some(), "{}", source(&file));
        file.handle_saved(NOW, SaveOutcome::Saved);
        file.read(NOW, content(&theirs));
        assert!(file.conflict().is_some(), "{}", source(&file));
        assert_eq!(file.unsaved(), 1);
    }

    #[test]
    fn unconfirmed_save_is_repeated_until_confirmed() {
        let mut file = opened();
        file.edit(&[set_address(&file, 16)]).unwrap();
        let saved = file.start_saving().unwrap().content;
        let failed = || SaveOutcome::Unconfirmed(Diagnostic::new("Input/output error"));
        assert_eq!(file.handle_saved(NOW, failed()), FileChange::Unusable);
        // The file has this content already, so reading it is not a change by another program.
        assert_eq!((file.unsaved(), file.on_disk()), (0, Some(&saved)));
        assert_eq!(file.read(NOW, content(&FILE.replace("12", "16"))), FileChange::None);
        let problem = file.problem().unwrap().to_string();
        assert_eq!(problem, "not confirmed by the disk: Input/output error");
        let again = file.start_saving().unwrap();
        assert_eq!((again.expected, again.content), (Some(saved.clone()), saved));
        assert_eq!(file.handle_saved(NOW, SaveOutcome::Saved), FileChange::Saved);
        assert_eq!(file.start_saving(), None);
        assert_eq!(file.problem(), None);
    }

    #[test]
    fn save_result_older_than_later_reading_is_ignored() {
        let mut file = opened();
        file.edit(&[set_address(&file, 16)]).unwrap();
        file.start_saving().unwrap();
        let newest = FILE.replace("true", "true, \"note\":2");
        assert_eq!(file.read(NOW, content(&newest)), FileChange::Rebased);
        let older = FILE.replace("true", "true, \"note\":1");
        file.handle_saved(NOW, SaveOutcome::Changed(content(&older)));
        let saving = file.start_saving().unwrap();
        assert_eq!(saving.expected.unwrap().source(), newest.as_bytes());
        assert_eq!(saving.content.source(), newest.replace("12", "16").as_bytes());
    }

    #[test]
    fn same_value_changed_twice_is_a_conflict() {
        for (ours, address) in [(true, "16"), (false, "13")] {
            let mut file = opened();
            file.edit(&[set_address(&file, 16)]).unwrap();
            assert_eq!(file.read(NOW, content(&FILE.replace("12", "13"))), FileChange::Conflict);
            assert_eq!(file.start_saving(), None);
            assert_eq!(file.edit(&[]), Err(EditRefusal::Conflict));
            assert_eq!(file.resolve(ours), FileChange::Rebased);
            assert_eq!(source(&file), FILE.replace("12", address));
            assert_eq!(file.unsaved(), usize::from(ours));
        }
    }

    #[test]
    fn invalid_file_is_never_written_and_keeps_last_content() {
        let mut file = opened();
        assert_eq!(file.read(NOW, content("{\"devices\": [")), FileChange::Unusable);
        assert_eq!(source(&file), FILE);
        assert!(matches!(file.edit(&[set_address(&file, 16)]), Err(EditRefusal::Unusable(_))));
        assert_eq!(file.start_saving(), None);
        assert_eq!(file.read(NOW, content(FILE)), FileChange::Content);
        assert!(file.problem().is_none());
    }

    #[test]
    fn first_edit_creates_missing_file() {
        let mut file = FileState::new(Some("des.json".into()));
        assert_eq!(file.read(NOW, FileReading::Content(None)), FileChange::FirstRead);
        let entry = crate::document::NewEntry {
            name: b"FEED".to_vec(),
            address: Some(12),
            is_static: true,
            ..Default::default()
        };
        file.edit(&[Operation::Add { entry }]).unwrap();
        assert_eq!(file.start_saving().unwrap().expected, None);
        assert!(file.is_there());
    }
}
