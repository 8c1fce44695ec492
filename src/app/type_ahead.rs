//! Keys typed ahead: whoever types without looking means the line that was to open, or the page as
//! it was. Where the line was refused, or a conflict came up, no letter of it is a command.

use super::{App, Overlay};
use crate::keymap::{Action, Key, KeyCode};
use crate::time::{Duration, Instant};

/// Nobody reads sooner that a line was refused; keys closer to one another are typed in one go.
const TYPING_GAP: Duration = Duration::from_millis(300);
/// Nobody has compared two values sooner.
const CONFLICT_READ_TIME: Duration = Duration::from_secs(1);

/// Keys that are not meant for what is on the screen.
#[derive(Clone, Copy, Debug)]
pub(super) struct TypeAheadGuard {
    /// What was to be typed: a number, or any text.
    is_number: bool,
    /// A key that comes before this was typed ahead.
    until: Instant,
    /// Whether anything was.
    has_text: bool,
}

impl App {
    /// Notes whether an action that opens a line opened none.
    pub(super) fn note_refused_line(&mut self, action: Action) {
        let is_number = action == Action::EditAddress;
        if action.is_line_edit() && matches!(self.overlay, Overlay::None) {
            let until = self.now + TYPING_GAP;
            self.type_ahead = Some(TypeAheadGuard { is_number, until, has_text: false });
        }
    }

    /// Notes that a page came up on which a letter chooses.
    pub(super) fn note_choice(&mut self) {
        let until = self.now + CONFLICT_READ_TIME;
        self.type_ahead = Some(TypeAheadGuard { is_number: false, until, has_text: true });
    }

    /// Whether the key was typed ahead; then it does nothing.
    pub(super) fn is_typed_ahead(&mut self, key: Key) -> bool {
        let Some(mut ahead) = self.type_ahead.take() else { return false };
        let is_text = match key.code {
            KeyCode::Char(_) if key.ctrl || key.alt => false,
            KeyCode::Char(c) => !ahead.is_number || c.is_ascii_digit() || c == 'x',
            KeyCode::Enter | KeyCode::Backspace => ahead.has_text,
            _ => false,
        };
        if !is_text || self.now >= ahead.until {
            return false;
        }
        (ahead.until, ahead.has_text) = (ahead.until.max(self.now + TYPING_GAP), true);
        self.type_ahead = Some(ahead);
        true
    }
}
