//! What every kind of prompt does: validate a line and commit it.

use super::moment_text::{MomentRange, MomentTarget};
use crate::app::buses::Buses;
use crate::app::device_command::DeviceCommand;
use crate::app::file::{Documents, FileIndex, FileState};
use crate::app::history::Moment;
use crate::app::problems::{Matching, ProblemKey};
use crate::app::view::Page;
use crate::discovery::DeviceId;
use crate::document::{NewEntry, Operation};
use crate::frame::BusIndex;
use std::path::PathBuf;

/// Result of the validation of a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum InputCheck {
    /// Enter works. Text: the effect of Enter, or the syntax of the line.
    Accepted(String),
    /// Enter works. Text: a reason for caution.
    Warning(String),
    /// Enter does nothing. Text: the cause.
    Rejected(String),
}

/// Which captured frames a log is to have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::app) enum SavedFrames {
    /// All.
    All,
    /// Those that match the filter; their number is not known yet.
    Matching,
    /// So many that match the filter.
    Counted(u64),
}

/// State that prompts are validated against.
#[derive(Clone, Copy)]
pub(in crate::app) struct PromptContext<'a> {
    /// The file that the prompt is about, and its state.
    pub index: FileIndex,
    pub file: &'a FileState,
    pub documents: Documents<'a>,
    pub matching: &'a Matching,
    pub buses: &'a Buses,
    /// Bus of the selected row, for a new entry.
    pub selected_bus: Option<BusIndex>,
    /// Number of captured frames.
    pub frames: u64,
    /// Which of them would be saved.
    pub saved_frames: SavedFrames,
    /// Moments that can be shown.
    pub moments: MomentRange<'a>,
    /// Number of rows of the page that match its filter, and of all.
    pub matches: Option<(u64, u64)>,
    /// What these rows are: `frames`.
    pub row_noun: &'static str,
}

/// Action that a committed prompt requests.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::app) enum PromptOutcome {
    /// No action.
    Nothing,
    /// Set the filter of a page.
    SetFilter(Page, String),
    /// Edit des.json.
    Edit(Vec<Operation>),
    /// Add an entry to des.json and select it.
    AddEntry(NewEntry),
    /// Show a message about the content of des.json.
    FileInfo(String),
    /// Write the captured frames to this path.
    SaveCapture(PathBuf),
    /// Write a copy of des.json to this path.
    SaveCopy(PathBuf),
    /// Write the proof of a problem: the path of its report.
    WriteProof(ProblemKey, PathBuf),
    /// Use the learnt values of the profile, and write them to this path, if there is one.
    UseLearnt(Option<PathBuf>),
    /// Ask whether to send a command to a device.
    Command(DeviceId, DeviceCommand),
    /// Show a moment.
    GoTo(MomentTarget),
    /// Mark a moment, with a text.
    SetMark(Moment, String),
}

impl PromptOutcome {
    /// Returns true if a file is written to the typed path.
    pub fn is_write(&self) -> bool {
        matches!(
            self,
            Self::SaveCapture(_)
                | Self::SaveCopy(_)
                | Self::WriteProof(..)
                | Self::UseLearnt(Some(_))
        )
    }
}

/// What committing a prompt edits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EditTarget {
    /// Not des.json.
    None,
    /// No present entry: a new one, or one that was deleted on disk.
    New,
    /// The entry with this index.
    Entry(usize),
}

/// Behaviour of one kind of prompt.
pub(super) trait PromptLogic {
    /// Text before the line.
    fn label(&self) -> &'static str;

    /// Text before the line on a narrow screen.
    fn short_label(&self) -> &'static str {
        self.label()
    }

    /// The des.json that the prompt is about; `None` if it is about none.
    fn file(&self, _documents: Documents) -> Option<FileIndex> {
        None
    }

    /// Returns what committing edits.
    fn edit_target(&self, _context: PromptContext) -> EditTarget {
        EditTarget::None
    }

    /// Validates the line, which has no blanks at its ends.
    fn validate(&self, text: &str, context: PromptContext) -> InputCheck;

    /// Returns the outcome of Enter for a line that is not rejected.
    fn commit(&self, text: &str, context: PromptContext) -> PromptOutcome;
}
