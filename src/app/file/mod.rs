//! des.json in the program: content and edits, retries of saving, copies, and quitting with
//! unsaved edits; one file, or several in a project.
//!
//! Inputs: readings of the file, edits, results of writing. Outputs: documents to write and texts
//! for the user. Does not read or write files and does not know the bus.

mod change;
mod editors;
mod own_pins;
mod state;
mod undo_stack;

pub use change::{EditRefusal, FileChange, FileError, FileReading, SaveOutcome};
pub(crate) use editors::Documents;
pub(super) use editors::FileEditors;
pub use editors::{EntryPlace, FileIndex};
pub(super) use state::FileContent;
pub use state::{FileState, Saving};

use crate::document::{Document, Entry, Operation};
use crate::time::{Duration, Instant};
use own_pins::OwnPins;
use std::path::{Path, PathBuf};

/// Time between a failed save and the next attempt.
const SAVE_RETRY_AFTER: Duration = Duration::from_secs(10);
/// Time after which a file that has become empty is no longer assumed to be in writing.
const EMPTY_SETTLES_AFTER: Duration = Duration::from_secs(1);

/// The file, with the work around saving it.
#[derive(Debug)]
pub(super) struct FileEditor {
    /// Content and edits.
    pub file: FileState,
    /// Static addresses that the user set.
    own_pins: OwnPins,
    /// When a failed save is repeated.
    retry_at: Option<Instant>,
    /// The save in progress is such a repetition.
    is_retry: bool,
    /// The copy with all edits that is being written.
    copy_pending: Option<(PathBuf, Document)>,
    /// The last copy that was written.
    copy_saved: Option<(PathBuf, Document)>,
    /// The user quits without saving the edits.
    edits_discarded: bool,
}

/// The result of a save, for the user.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct SaveReport {
    /// What changed.
    pub change: FileChange,
    /// Text for the timeline and the footer; true for a warning.
    pub text: Option<(String, bool)>,
    /// The problem was reported before.
    pub is_known: bool,
    /// A repeated save failed as before: there is nothing to report.
    pub is_silent: bool,
}

impl FileEditor {
    /// Returns the file at this path, not read yet.
    pub fn new(path: Option<PathBuf>) -> Self {
        Self {
            file: FileState::new(path),
            own_pins: OwnPins::default(),
            retry_at: None,
            is_retry: false,
            copy_pending: None,
            copy_saved: None,
            edits_discarded: false,
        }
    }

    /// Returns true, once, when a failed save is due to be repeated.
    pub fn start_retry(&mut self, now: Instant) -> bool {
        let is_due = self.retry_at.take_if(|at| *at <= now).is_some();
        self.is_retry |= is_due;
        is_due
    }

    /// Takes a reading of the file.
    pub fn read(&mut self, now: Instant, reading: FileReading) -> FileChange {
        let change = self.file.read(now, reading);
        self.note_own_pins();
        change
    }

    /// Decides the edit conflict.
    pub fn resolve(&mut self, ours: bool) -> FileChange {
        let change = self.file.resolve(ours);
        if let (false, Some(disk)) = (ours, self.file.on_disk()) {
            self.own_pins.accept(disk);
        }
        change
    }

    /// Returns true, once, when a file that was found empty [`EMPTY_SETTLES_AFTER`] ago is to be
    /// read again: it may have content that was not read yet.
    pub fn settle_empty(&mut self, now: Instant) -> bool {
        self.empty_settles_at().is_some_and(|at| at <= now) && self.file.settle_empty()
    }

    /// Takes the edits that reached the disk, also while another program wrote.
    fn note_own_pins(&mut self) {
        for edits in self.file.take_saved() {
            self.own_pins.note_saved(&edits);
        }
    }

    /// The moment at which a failed save is repeated, or an empty file accepted.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.retry_at.into_iter().chain(self.empty_settles_at()).min()
    }

    fn empty_settles_at(&self) -> Option<Instant> {
        self.file.empty_unsettled_since().map(|since| since + EMPTY_SETTLES_AFTER)
    }

    /// Takes the result of a save.
    pub fn handle_saved(&mut self, now: Instant, outcome: SaveOutcome) -> SaveReport {
        let unsaved = |file: &FileState| file.problem().filter(|it| it.is_not_saved()).cloned();
        let before = unsaved(&self.file);
        let is_retry = std::mem::take(&mut self.is_retry);
        let on_disk = self.file.on_disk().cloned();
        let parted = match &outcome {
            SaveOutcome::LinksBroken(1) => {
                Some("; the other hard link keeps the old content".to_owned())
            }
            SaveOutcome::LinksBroken(names) => {
                Some(format!("; {names} other hard links keep the old content"))
            }
            _ => None,
        };
        let change = self.file.handle_saved(now, outcome);
        self.note_own_pins();
        // An edit that pins a used address is refused, but the file may have changed since.
        let clash = on_disk.filter(|_| change == FileChange::Saved);
        let clash = clash.and_then(|before| address_clash(self.file.on_disk()?, &before));
        let warning: String = clash.into_iter().chain(parted).collect();
        let after = unsaved(&self.file);
        self.retry_at = after.as_ref().map(|_| now + SAVE_RETRY_AFTER);
        let is_known = before.is_some() && before == after;
        let is_news = change == FileChange::Saved && (before.is_some() || !warning.is_empty());
        let saved = if before.is_some() { "saved after retry" } else { "saved" };
        SaveReport {
            change,
            text: is_news.then(|| (format!("{saved}{warning}"), !warning.is_empty())),
            is_known,
            is_silent: is_retry && is_known,
        }
    }

    /// Edits that restore the static addresses set by the user that another program has overwritten;
    /// empty while edits wait to be saved.
    pub fn restoring(&self) -> Vec<Operation> {
        let is_settled = self.file.unsaved() == 0 && self.file.check().is_ok();
        if is_settled { self.own_pins.restoring(self.file.document()) } else { Vec::new() }
    }

    /// Begins a copy with all edits at this path; returns the bytes to write.
    pub fn start_copy(&mut self, path: PathBuf) -> Vec<u8> {
        let document = self.file.with_all_edits();
        let bytes = document.source().to_vec();
        self.copy_pending = Some((path, document));
        bytes
    }

    /// Takes the result of writing a file; returns true if it was the copy and succeeded.
    pub fn handle_written(&mut self, path: &Path, is_written: bool) -> bool {
        let copy = self.copy_pending.take_if(|copy| copy.0 == path).filter(|_| is_written);
        let is_copy = copy.is_some();
        self.copy_saved = copy.or(self.copy_saved.take());
        is_copy
    }

    /// Path of a copy that contains all edits.
    pub fn copy_of_edits(&self) -> Option<&Path> {
        let copy = self.copy_saved.as_ref().filter(|(_, copy)| *copy == self.file.with_all_edits());
        copy.map(|(path, _)| path.as_path())
    }

    /// Accepts that unsaved edits are lost.
    pub fn discard_edits(&mut self) {
        self.edits_discarded = true;
    }

    /// Number of edits that would be lost if the program ended now, and the file with them; `None`
    /// if they are saved, also in a copy, or discarded by the user.
    pub fn edits_at_risk(&self) -> Option<(usize, Document)> {
        let count = self.file.unsaved();
        let is_at_risk = count > 0 && self.copy_of_edits().is_none() && !self.edits_discarded;
        is_at_risk.then(|| (count, self.file.with_all_edits()))
    }

    /// The question whether to quit with unsaved edits.
    pub fn quit_question(&self) -> String {
        let edits = match self.file.unsaved() {
            1 => "1 edit is".to_owned(),
            many => format!("{many} edits are"),
        };
        if let Some(path) = self.copy_of_edits() {
            let path = crate::text::printable_path(path);
            format!("{edits} saved only in {path}. Quit anyway?")
        } else if self.file.is_saving() {
            format!("{edits} still being saved. Quit without waiting?")
        } else {
            format!("{edits} not saved. Quit anyway?")
        }
    }
}

/// Warning about entries that share an address since this save.
fn address_clash(now: &Document, before: &Document) -> Option<String> {
    let entries = now.entries();
    let clash = now.new_duplicate_address(before)?;
    let clash: Vec<&Entry> = clash.entries.iter().filter_map(|&at| entries.get(at)).collect();
    let address = clash.first()?.address?;
    let names: Vec<&str> = clash.iter().map(|entry| &*entry.name_text).collect();
    let (count, names) = (names.len(), names.join(", "));
    Some(format!("; warning: {count} entries share address {address}: {names}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::Diagnostic;
    use crate::document::Operation;

    const NOW: Instant = Instant::ZERO;
    const FILE: &str = r#"{"devices":[{"name":"FEED","address":12,"static":true}]}"#;

    /// A file with one edit that is being saved.
    fn saving() -> FileEditor {
        let mut editor = FileEditor::new(Some("des.json".into()));
        editor.file.read(NOW, FileReading::Content(Some(FILE.into())));
        let (entry, from) = (editor.file.document().key(0), Some(12));
        editor.file.edit(&[Operation::PinAddress { entry, from, to: 16 }]).unwrap();
        editor.file.start_saving().unwrap();
        editor
    }

    #[test]
    fn failed_save_is_repeated_and_reported_once() {
        let mut editor = saving();
        let failed = || SaveOutcome::Failed(Diagnostic::new("no space left"));
        let report = editor.handle_saved(NOW, failed());
        assert!(report.change == FileChange::Unusable && !report.is_known && !report.is_silent);
        assert_eq!(editor.poll_timeout(), Some(NOW + SAVE_RETRY_AFTER));
        assert!(!editor.start_retry(NOW));
        let later = NOW + SAVE_RETRY_AFTER;
        assert!(editor.start_retry(later));
        editor.file.start_saving().unwrap();
        assert!(editor.handle_saved(later, failed()).is_silent);
        assert!(editor.start_retry(later + SAVE_RETRY_AFTER));
        editor.file.start_saving().unwrap();
        let report = editor.handle_saved(later, SaveOutcome::Saved);
        assert_eq!(report.text, Some(("saved after retry".to_owned(), false)));
        assert_eq!(editor.poll_timeout(), None);
    }

    #[test]
    fn copied_or_discarded_edits_are_not_at_risk() {
        let mut editor = saving();
        assert_eq!(editor.edits_at_risk().map(|(count, _)| count), Some(1));
        let path = Path::new("copy.json");
        let bytes = editor.start_copy(path.into());
        assert!(String::from_utf8(bytes).unwrap().contains("16"));
        assert!(!editor.handle_written(path, false), "it failed");
        assert!(editor.edits_at_risk().is_some());
        editor.start_copy(path.into());
        assert!(editor.handle_written(path, true));
        assert_eq!((editor.copy_of_edits(), editor.edits_at_risk()), (Some(path), None));
        let mut editor = saving();
        editor.discard_edits();
        assert_eq!(editor.edits_at_risk(), None);
    }
}
