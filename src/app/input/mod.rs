//! Input state: the keymap, the overlay over the page, prompts, and the guard against keys typed
//! ahead.
//!
//! Inputs: keys and pasted text. Outputs: the action of a key, the outcome of a prompt. Does not
//! execute actions and does not know how overlays are drawn.

mod filter_prompt;
mod moment_text;
mod prompt;
mod prompt_kinds;
mod prompt_logic;
mod type_ahead;

pub use filter_prompt::FilterPrompt;
pub(super) use moment_text::{MomentRange, MomentTarget, mark_bit};
pub use prompt::{Prompt, PromptKind};
pub(super) use prompt::{PromptResult, line_request};
pub use prompt_kinds::parse_address;
pub(super) use prompt_kinds::{
    AddressPrompt, CapturePathPrompt, CommandPrompt, CopyPathPrompt, MarkPrompt, MomentPrompt,
    NewEntryPrompt, ProfilePathPrompt, ProofPathPrompt, RenamePrompt,
};
pub use prompt_logic::InputCheck;
pub(super) use prompt_logic::{PromptContext, PromptOutcome, SavedFrames};

use super::device_command::DeviceCommand;
use crate::app::file::FileIndex;
use crate::discovery::DeviceId;
use crate::document::EntryKey;
use crate::frame::BusIndex;
use crate::keymap::{Action, Key, KeyMode, Keymap};
use crate::time::Instant;
use std::path::Path;
use type_ahead::TypeAheadGuard;

/// A question with the answers yes and no.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Question {
    /// Quitting with unsaved edits.
    Quit,
    /// Deletion of this entry, as long as the file has it with this text.
    Delete(FileIndex, EntryKey, String),
    /// Sending a command to this device.
    Command(DeviceId, DeviceCommand),
    /// Reading the descriptor of this device.
    Descriptor(DeviceId),
    /// Sending what is composed; or, after that, that its source is not descan's own address.
    SendFrames {
        /// The second question.
        is_about_source: bool,
    },
    /// Bit rate search on this bus.
    FindBitrate(BusIndex),
    /// Start of the plan of addresses.
    Plan,
}

/// Overlay over the page.
#[derive(Clone, Debug, Default)]
pub enum Overlay {
    /// No overlay.
    #[default]
    None,
    /// The help, scrolled by this many lines.
    Help(u16),
    /// A question.
    Question(Question),
    /// A prompt.
    Prompt(Prompt),
    /// The two values of an edit conflict.
    Conflict,
    /// The list of marks, with the letter of the selected one.
    Marks(char),
    /// The list of the saved filters of the page, with the place of the selected one.
    Filters(usize),
    /// The comparison of two moments.
    Comparison,
    /// The kinds of stories, with the place of the selected one.
    Kinds(usize),
    /// The values of the profile.
    Profile,
    /// The plan of addresses.
    Plan,
    /// The themes, with the place of the selected one.
    Themes(usize),
    /// The dialog in which a frame is composed.
    Compose,
}

/// Keymap, overlay and type-ahead guard.
#[derive(Debug)]
pub(super) struct Input {
    keymap: Keymap,
    overlay: Overlay,
    /// The prompt that was open when an edit conflict appeared; it opens again afterwards.
    suspended_prompt: Option<Prompt>,
    /// The last prompt whose path is being written; it opens again if that fails.
    written_prompt: Option<Prompt>,
    /// Why the path of the open prompt was not written; until the line changes.
    failure: Option<String>,
    guard: Option<TypeAheadGuard>,
}

impl Input {
    /// Returns an input without an overlay.
    pub fn new(keymap: Keymap) -> Self {
        Self {
            keymap,
            overlay: Overlay::None,
            suspended_prompt: None,
            written_prompt: None,
            failure: None,
            guard: None,
        }
    }

    /// The keymap.
    pub fn keymap(&self) -> &Keymap {
        &self.keymap
    }

    /// The overlay.
    pub fn overlay(&self) -> &Overlay {
        &self.overlay
    }

    /// Returns true if an overlay is open.
    pub fn has_overlay(&self) -> bool {
        !matches!(self.overlay, Overlay::None)
    }

    /// Mode in which keys are looked up; an open prompt takes keys before that.
    pub fn mode(&self) -> KeyMode {
        match self.overlay {
            Overlay::None | Overlay::Prompt(_) => KeyMode::Browse,
            Overlay::Help(_) => KeyMode::Help,
            Overlay::Question(_) => KeyMode::Confirm,
            Overlay::Conflict => KeyMode::Conflict,
            Overlay::Marks(_) => KeyMode::Marks,
            Overlay::Filters(_) => KeyMode::Filters,
            Overlay::Comparison => KeyMode::Compare,
            Overlay::Kinds(_) => KeyMode::Kinds,
            Overlay::Profile => KeyMode::Profile,
            Overlay::Plan => KeyMode::Plan,
            Overlay::Themes(_) => KeyMode::Themes,
            Overlay::Compose => KeyMode::Compose,
        }
    }

    /// The action of a key in the present mode, or a global one.
    pub fn lookup(&self, key: Key) -> Option<Action> {
        self.keymap.lookup(self.mode(), key).or_else(|| self.lookup_global(key))
    }

    /// The action of a key that applies in every mode, also while a prompt is open.
    pub fn lookup_global(&self, key: Key) -> Option<Action> {
        self.keymap.lookup(KeyMode::Browse, key).filter(|action| action.is_global())
    }

    /// Returns true if a frame is being composed.
    pub fn is_composing(&self) -> bool {
        matches!(self.overlay, Overlay::Compose)
    }

    /// The open prompt.
    pub fn prompt(&self) -> Option<&Prompt> {
        match &self.overlay {
            Overlay::Prompt(prompt) => Some(prompt),
            _ => None,
        }
    }

    /// The open prompt, for changes.
    pub fn prompt_mut(&mut self) -> Option<&mut Prompt> {
        match &mut self.overlay {
            Overlay::Prompt(prompt) => Some(prompt),
            _ => None,
        }
    }

    /// The open question.
    pub fn question(&self) -> Option<&Question> {
        match &self.overlay {
            Overlay::Question(question) => Some(question),
            _ => None,
        }
    }

    /// Opens an overlay in place of the present one.
    pub fn open(&mut self, overlay: Overlay) {
        self.failure = None;
        self.overlay = overlay;
    }

    /// Opens a question.
    pub fn ask(&mut self, question: Question) {
        self.overlay = Overlay::Question(question);
    }

    /// Closes the overlay and returns it.
    pub fn close(&mut self) -> Overlay {
        self.failure = None;
        std::mem::take(&mut self.overlay)
    }

    /// Closes the prompt and returns it; another overlay stays open.
    pub fn close_prompt(&mut self) -> Option<Prompt> {
        match self.close() {
            Overlay::Prompt(prompt) => Some(prompt),
            other => {
                self.overlay = other;
                None
            }
        }
    }

    /// Remembers the prompt of a path that is being written.
    pub fn note_written(&mut self, prompt: Prompt) {
        self.written_prompt = Some(prompt);
    }

    /// Opens the prompt of a path again that was not written, with the cause; returns false if it is
    /// another one, or something else is open meanwhile.
    pub fn reopen_prompt(&mut self, path: &Path, cause: &str) -> bool {
        let is_it = |prompt: &mut Prompt| Path::new(prompt.text()) == path;
        let Some(prompt) = self.written_prompt.take_if(is_it) else { return false };
        if self.has_overlay() {
            return false;
        }
        self.open(Overlay::Prompt(prompt));
        self.failure = Some(cause.to_owned());
        true
    }

    /// Why the path of the open prompt was not written.
    pub fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// Takes that the line of the open prompt changed.
    pub fn forget_failure(&mut self) {
        self.failure = None;
    }

    /// Closes the question and returns it; another overlay stays open.
    pub fn close_question(&mut self) -> Option<Question> {
        match self.close() {
            Overlay::Question(question) => Some(question),
            other => {
                self.overlay = other;
                None
            }
        }
    }

    /// Scrolls the help by lines; drawing limits the position to the end of the text.
    pub fn scroll_help(&mut self, by: i16) {
        if let Overlay::Help(at) = &mut self.overlay {
            *at = at.saturating_add_signed(by);
        }
    }

    /// Sets the first line of the help, as it was drawn; returns false if the help is not open.
    pub fn set_help_scroll(&mut self, line: u16) -> bool {
        let Overlay::Help(at) = &mut self.overlay else { return false };
        *at = line;
        true
    }

    /// Letter of the selected mark; `None` unless the list of marks is open.
    pub fn selected_mark(&self) -> Option<char> {
        match self.overlay {
            Overlay::Marks(letter) => Some(letter),
            _ => None,
        }
    }

    // ---- edit conflicts --------------------------------------------------------------------

    /// Returns true if an edit conflict is open.
    pub fn shows_conflict(&self) -> bool {
        matches!(self.overlay, Overlay::Conflict)
    }

    /// Opens the edit conflict; an open prompt is suspended.
    pub fn show_conflict(&mut self, now: Instant) {
        if !self.shows_conflict() {
            self.guard = Some(TypeAheadGuard::for_conflict(now));
        }
        if let Overlay::Prompt(prompt) = std::mem::replace(&mut self.overlay, Overlay::Conflict) {
            self.suspended_prompt = Some(prompt);
        }
    }

    /// Closes the edit conflict and opens a suspended prompt again.
    pub fn leave_conflict(&mut self) {
        self.guard = None;
        self.overlay = self.suspended_prompt.take().map_or(Overlay::None, Overlay::Prompt);
    }

    // ---- keys typed ahead ------------------------------------------------------------------

    /// Starts the guard if the prompt of an executed action was refused: text typed for that prompt
    /// is ignored.
    pub fn note_executed(&mut self, now: Instant, action: Action) {
        if action.is_line_edit() && !self.has_overlay() {
            self.guard = Some(TypeAheadGuard::for_refused_prompt(now, action));
        }
    }

    /// Stops the guard: the user opened the present overlay on purpose.
    pub fn accept_keys(&mut self) {
        self.guard = None;
    }

    /// Returns true if a key was typed ahead and must be ignored.
    pub fn is_typed_ahead(&mut self, now: Instant, key: Key) -> bool {
        let Some(mut guard) = self.guard.take() else { return false };
        let is_ignored = guard.ignores(now, key);
        self.guard = Some(guard).filter(|_| is_ignored);
        is_ignored
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Duration;

    const NOW: Instant = Instant::ZERO;

    #[test]
    fn conflict_suspends_and_restores_prompt() {
        let mut input = Input::new(Keymap::default());
        let prompt =
            Prompt::new(PromptKind::CopyPath(CopyPathPrompt::default()), "a.json".to_owned());
        input.open(Overlay::Prompt(prompt));
        input.show_conflict(NOW);
        assert_eq!(input.lookup(Key::char('o')), Some(Action::Ours));
        assert!(input.prompt().is_none() && input.close_prompt().is_none());
        input.leave_conflict();
        assert_eq!(input.prompt().map(|it| it.input.value()), Some("a.json"));
    }

    #[test]
    fn letters_typed_into_refused_prompt_are_ignored() {
        let mut input = Input::new(Keymap::default());
        let later = |millis| NOW + Duration::from_millis(millis);
        input.note_executed(NOW, Action::EditAddress);
        assert!(input.is_typed_ahead(later(100), Key::char('1')));
        assert!(input.is_typed_ahead(later(200), Key::char('6')));
        assert!(!input.is_typed_ahead(later(900), Key::char('1')), "that is a new key");
        input.note_executed(NOW, Action::EditAddress);
        assert!(!input.is_typed_ahead(later(100), Key::char('q')), "not a digit");
    }

    #[test]
    fn help_scrolls_only_while_open() {
        let mut input = Input::new(Keymap::default());
        assert!(!input.set_help_scroll(3));
        input.open(Overlay::Help(0));
        input.scroll_help(5);
        input.scroll_help(-9);
        assert!(matches!(input.overlay(), Overlay::Help(0)));
        assert!(input.set_help_scroll(3) && matches!(input.close(), Overlay::Help(3)));
    }
}
