//! A key with modifiers, its notation in `keys.toml`, and the Latin key at the place of a Cyrillic
//! one.
//!
//! Does not know terminals: the shell converts terminal events.

use crate::text::is_printable;
use std::fmt;

/// A key with its modifiers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Key {
    /// The key without modifiers.
    pub code: KeyCode,
    /// Ctrl is pressed.
    pub ctrl: bool,
    /// Alt is pressed.
    pub alt: bool,
    /// Shift is pressed. Never set for a character: it arrives as the shifted character.
    pub shift: bool,
}

/// A key without its modifiers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum KeyCode {
    /// Key of a character.
    Char(char),
    /// Enter.
    Enter,
    /// Escape.
    Esc,
    /// Tab.
    Tab,
    /// Backspace.
    Backspace,
    /// Delete.
    Delete,
    /// Insert.
    Insert,
    /// Arrow up.
    Up,
    /// Arrow down.
    Down,
    /// Arrow left.
    Left,
    /// Arrow right.
    Right,
    /// Home.
    Home,
    /// End.
    End,
    /// Page up.
    PageUp,
    /// Page down.
    PageDown,
    /// Function key, F1 is 1.
    F(u8),
}

/// Named keys, as `keys.toml` and the help write them.
const NAMED: [(KeyCode, &str); 16] = [
    (KeyCode::Enter, "Enter"),
    (KeyCode::Esc, "Esc"),
    (KeyCode::Tab, "Tab"),
    (KeyCode::Backspace, "Backspace"),
    (KeyCode::Delete, "Delete"),
    (KeyCode::Insert, "Insert"),
    (KeyCode::Up, "Up"),
    (KeyCode::Down, "Down"),
    (KeyCode::Left, "Left"),
    (KeyCode::Right, "Right"),
    (KeyCode::Home, "Home"),
    (KeyCode::End, "End"),
    (KeyCode::PageUp, "PgUp"),
    (KeyCode::PageDown, "PgDn"),
    (KeyCode::Char(' '), "Space"),
    (KeyCode::Char('-'), "Minus"),
];

impl Key {
    /// Returns a key without modifiers.
    pub const fn new(code: KeyCode) -> Self {
        Self { code, ctrl: false, alt: false, shift: false }
    }

    /// Returns a character key.
    pub const fn char(c: char) -> Self {
        Self::new(KeyCode::Char(c))
    }

    /// Returns a character key with Ctrl.
    pub const fn ctrl(c: char) -> Self {
        Self { ctrl: true, ..Self::char(c) }
    }

    /// Returns the form that the keymap stores: a character without Shift, a Ctrl letter in lower
    /// case.
    #[must_use]
    pub fn normal(mut self) -> Self {
        if let KeyCode::Char(c) = self.code {
            self.shift = false;
            if self.ctrl {
                self.code = KeyCode::Char(c.to_lowercase().next().unwrap_or(c));
            }
        }
        self
    }

    /// Returns the key at the same place of a QWERTY keyboard; `None` for a character that is not
    /// on the Russian layout (ЙЦУКЕН).
    pub fn on_latin_keyboard(self) -> Option<Self> {
        let KeyCode::Char(c) = self.code else { return None };
        let at = RUSSIAN.chars().position(|russian| russian == c)?;
        let code = KeyCode::Char(LATIN.chars().nth(at)?);
        Some(Self { code, ..self })
    }

    /// Parses the notation of `keys.toml`: `r`, `G`, `Space`, `Ctrl-r`, `Shift-Tab`, `F5`. `None`
    /// for any other text, also for a character that is not printable: the help shows the keys.
    pub fn parse(text: &str) -> Option<Self> {
        let mut key = Key::char('\0');
        let mut rest = text;
        while let Some((modifier, behind)) = rest.split_once('-') {
            match modifier {
                _ if behind.is_empty() => break,
                "Ctrl" | "C" => key.ctrl = true,
                "Alt" | "A" => key.alt = true,
                "Shift" | "S" => key.shift = true,
                _ => return None,
            }
            rest = behind;
        }
        let named = NAMED.iter().find(|(_, name)| name.eq_ignore_ascii_case(rest));
        let mut characters = rest.chars();
        key.code = match (named, characters.next(), characters.next()) {
            (Some(&(code, _)), ..) => code,
            (None, Some(c), None) if is_printable(c) => KeyCode::Char(c),
            _ => KeyCode::F(rest.strip_prefix('F')?.parse().ok().filter(|n| (1..=24).contains(n))?),
        };
        Some(key.normal())
    }
}

/// Writes the notation of [`Key::parse`].
impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = String::new();
        for (held, name) in [(self.ctrl, "Ctrl-"), (self.alt, "Alt-"), (self.shift, "Shift-")] {
            text.push_str(if held { name } else { "" });
        }
        match (NAMED.iter().find(|(code, _)| *code == self.code), self.code) {
            // Alone it needs no name, which separates it from a modifier.
            (Some(_), KeyCode::Char('-')) if text.is_empty() => text.push('-'),
            (Some((_, name)), _) => text.push_str(name),
            (None, KeyCode::Char(c)) => text.push(c),
            (None, KeyCode::F(number)) => text.extend(["F", number.to_string().as_str()]),
            (None, _) => {}
        }
        f.pad(&text)
    }
}

// Keys of both layouts, with the punctuation of the last row, since `/` and `?` are actions.
const RUSSIAN: &str = "йцукенгшщзхъфывапролджэячсмитьбю.ЙЦУКЕНГШЩЗХЪФЫВАПРОЛДЖЭЯЧСМИТЬБЮ,";
const LATIN: &str = "qwertyuiop[]asdfghjkl;'zxcvbnm,./QWERTYUIOP{}ASDFGHJKL:\"ZXCVBNM<>?";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_notation_round_trips() {
        for text in [
            "r",
            "G",
            "?",
            "-",
            "Ctrl-Minus",
            "Space",
            "Ctrl-r",
            "Shift-Tab",
            "F12",
            "PgDn",
            "Alt-Enter",
        ] {
            let key = Key::parse(text).unwrap_or_else(|| panic!("{text}"));
            assert_eq!(key.to_string(), text);
        }
        assert_eq!(Key::parse("Minus"), Some(Key::char('-')));
        for wrong in ["", "rr", "Hyper-r", "F0", "F99", "Ctrl-", "\u{1b}", "\u{202e}"] {
            assert_eq!(Key::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn cyrillic_key_maps_to_latin_place() {
        assert_eq!(RUSSIAN.chars().count(), LATIN.chars().count());
        let latin = |c| Key::char(c).on_latin_keyboard().map(|key| key.code);
        assert_eq!(latin('к'), Some(KeyCode::Char('r')));
        assert_eq!(latin('П'), Some(KeyCode::Char('G')));
        assert_eq!(latin('.'), Some(KeyCode::Char('/')));
        assert_eq!(latin('r'), None);
    }
}
