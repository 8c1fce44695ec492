//! A line of text that the user types: filter, address, name, new entry, path.
//!
//! Inputs: keys and pasted text. The line is validated with every change ([`InputCheck`]); Enter
//! commits it ([`PromptOutcome`]), Esc drops it. Does not know how the line is drawn and executes
//! nothing.

use super::filter_prompt::FilterPrompt;
use super::prompt_kinds::{
    AddressPrompt, CapturePathPrompt, CommandPrompt, CopyPathPrompt, MarkPrompt, MomentPrompt,
    NewEntryPrompt, ProfilePathPrompt, ProofPathPrompt, RenamePrompt,
};
use super::prompt_logic::{EditTarget, InputCheck, PromptContext, PromptLogic, PromptOutcome};
use crate::app::file::{Documents, FileIndex};
use crate::keymap::{Key, KeyCode};
use crate::text::is_printable;
use tui_input::{Input as LineInput, InputRequest};

/// Longest line, in bytes.
const MAX_LENGTH: usize = 1000;

/// An open prompt.
#[derive(Clone, Debug)]
pub struct Prompt {
    /// Purpose of the line.
    pub kind: PromptKind,
    /// Text and cursor.
    pub input: LineInput,
    /// The text is the present value: the first typed character replaces it.
    pub replaces_on_typing: bool,
}

/// Purpose of a prompt, with its own state.
#[derive(Clone, Debug)]
pub enum PromptKind {
    /// Filter of a page.
    Filter(FilterPrompt),
    /// Static address of a device or an entry, edited in its row.
    Address(AddressPrompt),
    /// New name of an entry.
    Rename(RenamePrompt),
    /// Name and address of a new entry.
    NewEntry(NewEntryPrompt),
    /// Path of a log of the captured frames.
    CapturePath(CapturePathPrompt),
    /// Path of a copy of des.json.
    CopyPath(CopyPathPrompt),
    /// Path of the proof of a problem.
    ProofPath(ProofPathPrompt),
    /// Path of a profile with learnt values.
    ProfilePath(ProfilePathPrompt),
    /// Command to a device.
    Command(CommandPrompt),
    /// Moment to go to.
    Moment(MomentPrompt),
    /// Text of a mark.
    Mark(MarkPrompt),
}

/// Effect of a key in a prompt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::app) enum PromptResult {
    /// The line changed, or the key has no meaning.
    Typed,
    /// Enter: commit the line.
    Commit,
    /// Esc: drop the line.
    Cancel,
    /// Tab: edit the address on the next redundant bus.
    NextBus,
    /// Tab in a filter: the next candidate.
    Complete,
    /// Ctrl-s in a filter: save it.
    SaveFilter,
    /// An older line of the history, or with 1 a newer one.
    Recall(isize),
}

impl PromptKind {
    fn logic(&self) -> &dyn PromptLogic {
        match self {
            PromptKind::Filter(prompt) => prompt,
            PromptKind::Address(prompt) => prompt,
            PromptKind::Rename(prompt) => prompt,
            PromptKind::NewEntry(prompt) => prompt,
            PromptKind::CapturePath(prompt) => prompt,
            PromptKind::CopyPath(prompt) => prompt,
            PromptKind::ProofPath(prompt) => prompt,
            PromptKind::ProfilePath(prompt) => prompt,
            PromptKind::Command(prompt) => prompt,
            PromptKind::Moment(prompt) => prompt,
            PromptKind::Mark(prompt) => prompt,
        }
    }

    /// Text before the line.
    pub fn label(&self) -> &'static str {
        self.logic().label()
    }

    /// Text before the line on a narrow screen.
    pub fn short_label(&self) -> &'static str {
        self.logic().short_label()
    }

    /// The des.json that the prompt is about; `None` if it is about none.
    pub(in crate::app) fn file(&self, documents: Documents) -> Option<FileIndex> {
        self.logic().file(documents)
    }

    /// Returns true if the prompt edits des.json.
    pub const fn is_edit(&self) -> bool {
        matches!(self, PromptKind::Address(_) | PromptKind::Rename(_) | PromptKind::NewEntry(_))
    }
}

impl Prompt {
    /// Returns a prompt that begins with this text.
    pub(in crate::app) fn new(kind: PromptKind, text: String) -> Self {
        let untouched = matches!(kind, PromptKind::Address(_)) && !text.is_empty();
        Self { kind, input: LineInput::new(text), replaces_on_typing: untouched }
    }

    /// The line without blanks at its ends.
    pub(super) fn text(&self) -> &str {
        self.input.value().trim()
    }

    /// Validates the line.
    pub(in crate::app) fn validate(&self, context: PromptContext) -> InputCheck {
        let logic = self.kind.logic();
        let checked = match logic.edit_target(context) {
            EditTarget::None => Ok(()),
            EditTarget::New => context.file.check_edit(None),
            EditTarget::Entry(index) => context.file.check_edit(Some(index)),
        };
        if let Err(refusal) = checked {
            return InputCheck::Rejected(refusal.to_string());
        }
        logic.validate(self.text(), context)
    }

    /// Returns the outcome of Enter.
    pub(in crate::app) fn commit(&self, context: PromptContext) -> PromptOutcome {
        self.kind.logic().commit(self.text(), context)
    }

    /// Handles a key.
    pub(in crate::app) fn handle_key(&mut self, key: Key) -> PromptResult {
        if let PromptKind::Filter(prompt) = &mut self.kind {
            match key.code {
                KeyCode::Tab => return PromptResult::Complete,
                KeyCode::Char('s') if key.ctrl => return PromptResult::SaveFilter,
                KeyCode::Up => return PromptResult::Recall(-1),
                KeyCode::Down => return PromptResult::Recall(1),
                _ => prompt.end_choice(),
            }
        }
        match key.code {
            KeyCode::Enter => return PromptResult::Commit,
            KeyCode::Esc => return PromptResult::Cancel,
            // Tab moves from the name to the address of a new entry, as a space does.
            KeyCode::Tab if self.is_in_name() => self.change(&[InputRequest::InsertChar(' ')]),
            KeyCode::Tab => return PromptResult::NextBus,
            _ => {
                if let Some(request) = line_request(key) {
                    self.change(&[request]);
                }
            }
        }
        PromptResult::Typed
    }

    /// Returns true if the name of a new entry is being typed.
    fn is_in_name(&self) -> bool {
        let text = self.input.value();
        matches!(self.kind, PromptKind::NewEntry(_)) && !text.is_empty() && !text.ends_with(' ')
    }

    /// Inserts the first line of pasted text.
    pub(in crate::app) fn paste(&mut self, text: &str) {
        let line = text.trim().lines().next().unwrap_or_default();
        let printable = line.chars().filter(|&c| is_printable(c));
        let requests: Vec<InputRequest> = printable.map(InputRequest::InsertChar).collect();
        self.change(&requests);
    }

    fn change(&mut self, requests: &[InputRequest]) {
        for &request in requests {
            let grows = matches!(request, InputRequest::InsertChar(_));
            if std::mem::take(&mut self.replaces_on_typing) && grows {
                self.input.reset();
            }
            if !grows || self.input.value().len() < MAX_LENGTH {
                self.input.handle(request);
            }
        }
    }
}

/// The change of the line that a key requests; `None` for a key without one.
pub(in crate::app) fn line_request(key: Key) -> Option<InputRequest> {
    use InputRequest as R;
    Some(match (key.code, key.ctrl, key.alt) {
        (KeyCode::Char(c), false, false) if is_printable(c) => R::InsertChar(c),
        (KeyCode::Backspace, false, false) | (KeyCode::Char('h'), true, _) => R::DeletePrevChar,
        (KeyCode::Delete, ..) => R::DeleteNextChar,
        (KeyCode::Left, true, _) => R::GoToPrevWord,
        (KeyCode::Right, true, _) => R::GoToNextWord,
        (KeyCode::Left, ..) => R::GoToPrevChar,
        (KeyCode::Right, ..) => R::GoToNextChar,
        (KeyCode::Home, ..) | (KeyCode::Char('a'), true, _) => R::GoToStart,
        (KeyCode::End, ..) | (KeyCode::Char('e'), true, _) => R::GoToEnd,
        (KeyCode::Char('u'), true, _) => R::DeleteLine,
        (KeyCode::Char('k'), true, _) => R::DeleteTillEnd,
        (KeyCode::Char('w'), true, _) | (KeyCode::Backspace, ..) => R::DeletePrevWord,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn typed(prompt: &mut Prompt, keys: &str) {
        for c in keys.chars() {
            assert_eq!(prompt.handle_key(Key::char(c)), PromptResult::Typed);
        }
    }

    #[test]
    fn tab_in_new_entry_separates_name_and_address() {
        let mut prompt =
            Prompt::new(PromptKind::NewEntry(NewEntryPrompt::default()), String::new());
        typed(&mut prompt, "PUMP");
        assert_eq!(prompt.handle_key(Key::new(KeyCode::Tab)), PromptResult::Typed);
        typed(&mut prompt, "12");
        assert_eq!(prompt.input.value(), "PUMP 12");
        assert_eq!(prompt.handle_key(Key::new(KeyCode::Enter)), PromptResult::Commit);
    }

    #[test]
    fn pasted_text_is_cut_to_its_first_line() {
        let mut prompt =
            Prompt::new(PromptKind::CopyPath(CopyPathPrompt::default()), String::new());
        prompt.paste(" a\u{7}b.json\nsecond");
        assert_eq!(prompt.input.value(), "ab.json");
        prompt.paste(&"x".repeat(2 * MAX_LENGTH));
        assert_eq!(prompt.input.value().len(), MAX_LENGTH);
    }
}
