//! Guard against keys typed ahead.
//!
//! The keys `e16`, typed without looking at the screen, are meant for the prompt that `e` opens. If
//! the prompt was refused, or an edit conflict appeared, they must not execute other actions.

use crate::keymap::{Action, Key, KeyCode};
use crate::time::{Duration, Instant};

/// Time to read a refusal; keys with smaller gaps belong to one sequence.
const TYPING_GAP: Duration = Duration::from_millis(300);
/// Time to compare the two values of an edit conflict.
const CONFLICT_READ_TIME: Duration = Duration::from_secs(1);

/// Kind of the keys that are ignored, and the end of the guard.
#[derive(Clone, Copy, Debug)]
pub(super) struct TypeAheadGuard {
    /// The refused prompt accepts only digits and `x`.
    is_number: bool,
    /// End of the guard: a text key before it was typed ahead.
    until: Instant,
    /// Text was typed before: Enter and Backspace belong to it and are ignored too.
    has_text: bool,
}

impl TypeAheadGuard {
    /// Returns the guard for an action whose prompt was refused.
    pub fn for_refused_prompt(now: Instant, action: Action) -> Self {
        let is_number = action == Action::EditAddress;
        Self { is_number, until: now + TYPING_GAP, has_text: false }
    }

    /// Returns the guard for an edit conflict that appeared.
    pub fn for_conflict(now: Instant) -> Self {
        Self { is_number: false, until: now + CONFLICT_READ_TIME, has_text: true }
    }

    /// Returns true if the key must be ignored; this extends the guard.
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
