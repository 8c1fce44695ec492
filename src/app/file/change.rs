//! What is found on disk, what becomes of saves, and what that changes.

use crate::document::{Document, EditError, ParseError};

/// How des.json was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FileReading {
    /// Its content; `None` where there is no such file.
    Content(Option<Vec<u8>>),
    /// The same, parsed: for megabytes that takes longer than a screen should wait.
    Parsed(Result<Document, ParseError>),
    /// It cannot be read: why.
    Error(String),
}

impl FileReading {
    /// Parses the content.
    #[must_use]
    pub fn parsed(self) -> Self {
        match self {
            FileReading::Content(Some(content)) => FileReading::Parsed(Document::parse(&content)),
            other => other,
        }
    }

    /// The document, none where there is no file; or what is wrong with it.
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

/// What became of a save.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SaveOutcome {
    /// It is on disk.
    Saved,
    /// It is on disk, but so many other names of the file (hard links) keep what it said before.
    Parted(u64),
    /// Somebody else wrote meanwhile; nothing was written. What is there now.
    Changed(FileReading),
    /// It could not be written: why.
    Failed(String),
}

impl SaveOutcome {
    /// Whether what was to be saved is on disk.
    pub const fn is_on_disk(&self) -> bool {
        matches!(self, SaveOutcome::Saved | SaveOutcome::Parted(_))
    }
}

/// Why the file cannot be used as it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FileProblem {
    /// It is not JSON.
    Syntax(ParseError),
    /// It cannot be read.
    Unreadable(String),
    /// The last save failed; the edits are kept.
    NotSaved(String),
}

impl FileProblem {
    /// The last save failed.
    pub const fn is_not_saved(&self) -> bool {
        matches!(self, FileProblem::NotSaved(_))
    }

    /// What is wrong with the file of this name.
    pub fn of_file(&self, name: &str) -> String {
        match self {
            FileProblem::Syntax(error) => format!("{name}: {error}"),
            FileProblem::Unreadable(why) => format!("{name}: {why}"),
            // To be seen while edits are made: which file is known.
            FileProblem::NotSaved(why) => why.clone(),
        }
    }

    /// The line that is not JSON, and below it a caret that points at the place.
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
            FileProblem::Unreadable(why) | FileProblem::NotSaved(why) => f.write_str(why),
        }
    }
}

/// What the reading of a file changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Nothing.
    None,
    /// Its content.
    Content,
    /// Our edits are on disk.
    Saved,
    /// It was read for the first time.
    First,
    /// Our edits were made again on newer content.
    Rebased,
    /// It cannot be used any more; the last good content stays in force.
    Broken,
    /// Both changed the same value.
    Conflict,
}

/// Why an edit is not made.
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
