//! Readings of des.json, outcomes of saves, and the changes that result.

use crate::document::{Document, EditError, ParseError};

/// Result of reading des.json.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FileReading {
    /// Content; `None` if the file does not exist.
    Content(Option<Vec<u8>>),
    /// Parsed content: parsing megabytes takes longer than the screen may wait.
    Parsed(Result<Document, ParseError>),
    /// Cause of a read error.
    Error(String),
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
    pub(super) fn found(self) -> Result<Option<Document>, FileProblem> {
        match self {
            FileReading::Content(None) => Ok(None),
            FileReading::Content(Some(content)) => match Document::parse(&content) {
                Ok(document) => Ok(Some(document)),
                Err(error) => Err(FileProblem::Syntax(error)),
            },
            FileReading::Parsed(Ok(document)) => Ok(Some(document)),
            FileReading::Parsed(Err(error)) => Err(FileProblem::Syntax(error)),
            FileReading::Error(why) => Err(FileProblem::Unreadable(why)),
        }
    }
}

impl From<Result<Option<Vec<u8>>, String>> for FileReading {
    fn from(reading: Result<Option<Vec<u8>>, String>) -> Self {
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
    Parted(u64),
    /// Another program wrote the file meanwhile; nothing was written. Holds the present content.
    Changed(FileReading),
    /// Cause of a write error.
    Failed(String),
}

impl SaveOutcome {
    /// Returns true if the content of the save is on disk.
    pub const fn is_on_disk(&self) -> bool {
        matches!(self, SaveOutcome::Saved | SaveOutcome::Parted(_))
    }
}

/// Problem that prevents reading or saving the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FileProblem {
    /// The file is not JSON.
    Syntax(ParseError),
    /// The file cannot be read.
    Unreadable(String),
    /// The last save failed; the edits are kept.
    NotSaved(String),
}

impl FileProblem {
    /// Returns true if the last save failed.
    pub const fn is_not_saved(&self) -> bool {
        matches!(self, FileProblem::NotSaved(_))
    }

    /// Message about the problem, for the file with this name.
    pub fn of_file(&self, name: &str) -> String {
        match self {
            FileProblem::Syntax(error) => format!("{name}: {error}"),
            FileProblem::Unreadable(why) => format!("{name}: {why}"),
            FileProblem::NotSaved(why) => format!("{name} not saved: {why}"),
        }
    }

    /// The line that is not JSON, and a caret below it that marks the place.
    pub fn excerpt(&self) -> Option<[String; 2]> {
        match self {
            FileProblem::Syntax(error) => error.excerpt(),
            FileProblem::Unreadable(_) | FileProblem::NotSaved(_) => None,
        }
    }
}

impl std::fmt::Display for FileProblem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            FileProblem::Syntax(error) => error.fmt(f),
            FileProblem::Unreadable(why) => f.write_str(why),
            FileProblem::NotSaved(why) => write!(f, "not saved: {why}"),
        }
    }
}

/// Effect of a reading, a save or a decided conflict on the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// No change.
    None,
    /// The content changed.
    Content,
    /// The edits are on disk.
    Saved,
    /// The file was read for the first time.
    First,
    /// The unsaved edits were applied to newer content.
    Rebased,
    /// The file cannot be read or saved; the last valid content is kept.
    Broken,
    /// An edit conflict: disk and unsaved edits changed the same value.
    Conflict,
}

/// Reason why an edit is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum EditRefusal {
    #[error("no file is open: start with --file des.json")]
    NoFile,
    #[error("the file has not been read yet")]
    NotRead,
    #[error("file has errors, fix it first: {0}")]
    Broken(String),
    #[error("resolve the edit conflict first")]
    Conflict,
    #[error("nothing to undo")]
    NothingToUndo,
    #[error("nothing to redo")]
    NothingToRedo,
    #[error("not {done}: {name}; on disk: {theirs}")]
    ChangedSince { done: &'static str, name: String, theirs: String },
    #[error("already {done}: {name}")]
    SoAlready { done: &'static str, name: String },
    #[error(transparent)]
    Edit(#[from] EditError),
}
