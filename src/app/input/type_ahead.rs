//! Guard against keys typed ahead.
//!
//! A user who types `e16` without looking means the prompt that `e` opens. If the prompt was
//! refused, or an edit conflict came up, those characters must not execute actions.

use crate::keymap::{Action, Key, KeyCode};
use crate::time::{Duration, Instant};

/// Least time to read a refusal; keys with smaller gaps were typed in one go.
const TYPING_GAP: Duration = Duration::from_millis(300);
/// Least time to compare the two values of an edit conflict.
const CONFLICT_READ_TIME: Duration = Duration::from_secs(1);

/// Which keys are ignored, and until when.
#[derive(Clone, Copy, Debug)]
pub(super) struct TypeAheadGuard {
    /// Only digits and `x` were to be typed.
    is_number: bool,
    /// A text key before this moment was typed ahead.
    until: Instant,
    /// Text was typed ahead already, or before: Enter and Backspace belong to it.
    has_text: bool,
}

impl TypeAheadGuard {
    /// Returns the guard after an action whose prompt was refused.
    pub fn for_refused_prompt(now: Instant, action: Action) -> Self {
        let is_number = action == Action::EditAddress;
        Self { is_number, until: now + TYPING_GAP, has_text: false }
    }

    /// Returns the guard after an edit conflict came up.
    pub fn for_conflict(now: Instant) -> Self {
        Self { is_number: false, until: now + CONFLICT_READ_TIME, has_text: true }
    }

    /// Returns true if the key is to be ignored; the guard lasts longer then.
    pub fn ignores(&mut self, now: Instant, key: Key) -> bool {
        let is_text = match key.code {
            KeyCode::Char(_) if key.ctrl || key.alt => false,
            KeyCode::Char(c) => !self.is_number || c.is_ascii_digit() || c == 'x',
            KeyCode::Enter | KeyCode::Backspace => self.has_text,
            _ => false,
        };
        if !is_text || now >= self.until {
            return false;
        }
        (self.until, self.has_text) = (self.until.max(now + TYPING_GAP), true);
        true
    }
}
