//! Readings of des.json, outcomes of saves, and the changes that result.

use crate::diagnostic::Diagnostic;
use crate::document::{Document, EditError, ParseError};

/// Result of reading des.json.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FileReading {
    /// Content; `None` if the file does not exist.
    Content(Option<Vec<u8>>),
    /// Parsed content: parsing megabytes takes longer than the screen may wait.
    Parsed(Result<Document, ParseError>),
    /// The file cannot be read.
    Error(Diagnostic),
}

impl FileReading {
    /// Parses the content; returns other readings unchanged.
    #[must_use]
    pub fn parsed(self) -> Self {
        match self {
            FileReading::Content(Some(content)) => FileReading::Parsed(Document::parse(&content)),
            other => other,
        }
    }

    /// Returns the document; `None` if the file does not exist.
    ///
    /// # Errors
    ///
    /// The file is not JSON or cannot be read.
    pub(super) fn found(self) -> Result<Option<Document>, FileError> {
        match self {
            FileReading::Content(None) => Ok(None),
            FileReading::Content(Some(content)) => match Document::parse(&content) {
                Ok(document) => Ok(Some(document)),
                Err(error) => Err(FileError::Syntax(error)),
            },
            FileReading::Parsed(Ok(document)) => Ok(Some(document)),
            FileReading::Parsed(Err(error)) => Err(FileError::Syntax(error)),
            FileReading::Error(why) => Err(FileError::Unreadable(why)),
        }
    }
}

impl From<Result<Option<Vec<u8>>, Diagnostic>> for FileReading {
    fn from(reading: Result<Option<Vec<u8>>, Diagnostic>) -> Self {
        match reading {
            Ok(content) => FileReading::Content(content),
            Err(why) => FileReading::Error(why),
        }
    }
}

/// Outcome of a save.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SaveOutcome {
    /// The content is on disk.
    Saved,
    /// The content is on disk; this many other names of the file (hard links) keep the old content.
    LinksBroken(u64),
    /// Another program wrote the file during the save; nothing was written. Holds the present
    /// content.
    Changed(FileReading),
    /// The content is on disk, but may be lost in a power failure.
    Unconfirmed(Diagnostic),
    /// The file cannot be written.
    Failed(Diagnostic),
}

impl SaveOutcome {
    /// Returns true if the content of the save is on disk.
    pub const fn is_on_disk(&self) -> bool {
        matches!(
            self,
            SaveOutcome::Saved | SaveOutcome::LinksBroken(_) | SaveOutcome::Unconfirmed(_)
        )
    }
}

/// Problem that prevents reading or saving the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FileError {
    /// The file is not JSON.
    Syntax(ParseError),
    /// The file cannot be read.
    Unreadable(Diagnostic),
    /// The last save failed; the edits are kept.
    NotSaved(Diagnostic),
    /// The disk did not confirm the last save: the edits may be lost in a power failure.
    Unconfirmed(Diagnostic),
}

impl FileError {
    /// Returns true if the last save failed or was not confirmed; it is repeated.
    pub const fn is_not_saved(&self) -> bool {
        matches!(self, FileError::NotSaved(_) | FileError::Unconfirmed(_))
    }

    /// Message about the problem, for the file with this name.
    pub fn of_file(&self, name: &str) -> String {
        match self {
            FileError::Syntax(error) => format!("{name}: {error}"),
            FileError::Unreadable(why) => format!("{name}: {why}"),
            FileError::NotSaved(why) => format!("{name} not saved: {why}"),
            FileError::Unconfirmed(why) => {
                format!("{name} saved, but not confirmed by the disk: {why}")
            }
        }
    }

    /// The line that is not JSON, and a caret below it that marks the place.
    pub fn excerpt(&self) -> Option<[String; 2]> {
        match self {
            FileError::Syntax(error) => error.excerpt(),
            FileError::Unreadable(_) | FileError::NotSaved(_) | FileError::Unconfirmed(_) => None,
        }
    }
}

impl std::fmt::Display for FileError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            FileError::Syntax(error) => error.fmt(f),
            FileError::Unreadable(why) => why.fmt(f),
            FileError::NotSaved(why) => write!(f, "not saved: {why}"),
            FileError::Unconfirmed(why) => write!(f, "not confirmed by the disk: {why}"),
        }
    }
}

/// Effect of a reading, a save or a decided conflict on the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileChange {
    /// No change.
    None,
    /// The content changed.
    Content,
    /// The edits are on disk.
    Saved,
    /// The file was read for the first time.
    FirstRead,
    /// The unsaved edits were applied to newer content.
    Rebased,
    /// The file cannot be read or saved; the last valid content is kept.
    Unusable,
    /// An edit conflict: disk and unsaved edits changed the same value.
    Conflict,
}

/// Reason why an edit is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EditRefusal {
    /// descan runs without a file.
    #[error("no file is open: start with --file des.json")]
    NoFile,
    /// The first reading has not finished.
    #[error("the file has not been read yet")]
    NotRead,
    /// The file is invalid, for the reason given.
    #[error("file has errors, fix it first: {0}")]
    Unusable(String),
    /// An edit conflict is open.
    #[error("resolve the edit conflict first")]
    Conflict,
    /// No edit is left to undo.
    #[error("nothing to undo")]
    NothingToUndo,
    /// No undone edit is left.
    #[error("nothing to redo")]
    NothingToRedo,
    /// The value changed on disk since the edit.
    #[error("not {done}: {name}; on disk: {theirs}")]
    ChangedSince {
        /// What was attempted: `undone`, `redone`.
        done: &'static str,
        /// Description of the step.
        name: String,
        /// Value on disk.
        theirs: String,
    },
    /// The file already has the result of the step.
    #[error("already {done}: {name}")]
    AlreadyDone {
        /// What was attempted: `undone`, `redone`.
        done: &'static str,
        /// Description of the step.
        name: String,
    },
    /// Another program deleted the file since the edit.
    #[error("not {done}: {name}; the file was deleted")]
    Deleted {
        /// What was attempted: `undone`, `redone`.
        done: &'static str,
        /// Description of the step.
        name: String,
    },
    /// The edit cannot be applied to the content.
    #[error(transparent)]
    Edit(#[from] EditError),
}
