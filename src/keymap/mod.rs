//! Actions and the keys that are bound to them.
//!
//! Input: the defaults in the table ([`ACTIONS`]) and the text of `keys.toml`, which rebinds
//! actions:
//!
//! ```toml
//! rescan = "F5"              # instead of r
//! freeze = ["Space", "F6"]
//! quit-now = []              # none
//! ```
//!
//! Output: the action of a key in a mode. Does not know terminals, the file system or what an
//! action does.

mod actions;
mod key;

pub use actions::{ACTIONS, Action, ActionGroup, ActionInfo, KeyMode};
pub use key::{Key, KeyCode};

use std::fmt;
use std::ops::Range;
use toml::de::{DeTable, DeValue};

/// The keys bound to each action.
#[derive(Clone)]
pub struct Keymap {
    /// In the order of [`ACTIONS`], rebound actions last.
    bindings: Vec<(Key, Action)>,
}

impl Default for Keymap {
    /// The default keys of [`ACTIONS`].
    fn default() -> Self {
        let usual = |info: &'static ActionInfo| {
            let keys = info.keys.iter().filter_map(|text| Key::parse(text));
            keys.map(move |key| (key, info.action))
        };
        Self { bindings: ACTIONS.iter().flat_map(usual).collect() }
    }
}

impl fmt::Debug for Keymap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list()
            .entries(self.bindings.iter().map(|(key, action)| format!("{key} {action}")))
            .finish()
    }
}

/// The cause and the place of an error in `keys.toml`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {message}")]
pub struct KeysError {
    /// Line number, from 1.
    pub line: usize,
    /// Cause, for the user.
    pub message: String,
}

impl Keymap {
    /// Parses the text of `keys.toml`. An action that is not named there keeps its default keys,
    /// except those that are given to another action of the same mode.
    ///
    /// # Errors
    ///
    /// The text is not TOML, names an unknown action, has a value that is not a key, or binds one
    /// key to two actions of a mode.
    pub fn parse(text: &str) -> Result<Self, KeysError> {
        let error = |span: Range<usize>, message: String| KeysError {
            line: text[..span.start].matches('\n').count() + 1,
            message,
        };
        let table = DeTable::parse(text)
            .map_err(|e| error(e.span().unwrap_or(0..0), e.message().to_owned()))?;
        let mut given: Vec<(Key, Action)> = Vec::new();
        let mut named = Vec::new();
        for (name, value) in table.get_ref() {
            let action = Action::from_name(name.get_ref()).ok_or_else(|| {
                let known: Vec<&str> = ACTIONS.iter().map(|info| info.name).collect();
                let known = known.join(", ");
                error(name.span(), format!("unknown action \"{}\"; use {known}", name.get_ref()))
            })?;
            named.push(action);
            let one = std::slice::from_ref(value);
            let keys = if let DeValue::Array(keys) = value.get_ref() { &keys[..] } else { one };
            for written in keys {
                let key = match written.get_ref() {
                    DeValue::String(text) => Key::parse(text),
                    _ => None,
                };
                let key = key.ok_or_else(|| {
                    let message = "a key is written like \"r\", \"Ctrl-r\", \"Space\" or \"F5\"";
                    error(written.span(), message.to_owned())
                })?;
                let same =
                    |(other, to): &&(Key, Action)| *other == key && to.mode() == action.mode();
                if let Some((_, other)) = given.iter().find(same) {
                    return Err(error(
                        written.span(),
                        format!("{key} is already bound to {other}"),
                    ));
                }
                given.push((key, action));
            }
        }
        let mut keymap = Self::default();
        keymap.bindings.retain(|(key, action)| {
            let taken = |(other, to): &(Key, Action)| other == key && to.mode() == action.mode();
            !named.contains(action) && !given.iter().any(taken)
        });
        keymap.bindings.extend(given);
        Ok(keymap)
    }

    /// Action bound to a key in this mode; `None` for an unbound key. A Cyrillic key that is not
    /// bound itself is looked up as the Latin key at the same place of the keyboard.
    pub fn lookup(&self, mode: KeyMode, key: Key) -> Option<Action> {
        let key = key.normal();
        let bound = |key: Key| {
            let found = self.bindings.iter().find(|(own, to)| *own == key && to.mode() == mode);
            found.map(|(_, action)| *action)
        };
        bound(key).or_else(|| bound(key.on_latin_keyboard()?.normal()))
    }

    /// Keys of an action, the one to show first; empty for an unbound action.
    pub fn keys_of(&self, action: Action) -> impl Iterator<Item = Key> {
        self.bindings.iter().filter(move |(_, to)| *to == action).map(|(key, _)| *key)
    }

    /// First key and footer word of an action; `None` for an unbound action.
    pub fn hint(&self, action: Action) -> Option<(Key, &'static str)> {
        Some((self.keys_of(action).next()?, action.info().hint))
    }

    /// First key of an action, for a message; the action's name where it is unbound.
    pub fn key_text(&self, action: Action) -> String {
        let key = self.keys_of(action).next();
        key.map_or_else(|| action.name().to_owned(), |key| key.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn action_table_has_unique_names_docs_and_free_keys() {
        for (at, info) in ACTIONS.iter().enumerate() {
            let action = info.action;
            assert_eq!(action.name(), info.name, "rows stand in the order of the variants");
            assert!(!info.doc.is_empty() && !info.keys.is_empty(), "{action:?}");
            assert!(ACTIONS[..at].iter().all(|other| other.name != info.name), "{action:?}");
            for text in info.keys {
                let key = Key::parse(text).unwrap_or_else(|| panic!("{action:?}: {text}"));
                let found = Keymap::default().lookup(info.mode, key);
                assert_eq!(found, Some(action), "{text} is bound twice");
            }
        }
    }

    #[test]
    fn keys_toml_rebinds_keys_of_other_actions() {
        let keymap = Keymap::parse("rescan = \"F5\"\nfreeze = [\"r\"]\nquit = []\n").unwrap();
        let bound = |text| keymap.lookup(KeyMode::Browse, Key::parse(text).unwrap());
        assert_eq!(bound("F5"), Some(Action::Rescan));
        assert_eq!(bound("r"), Some(Action::Freeze));
        assert_eq!(bound("q"), None);
        assert_eq!(bound("к"), Some(Action::Freeze));
        assert_eq!(bound("u"), Some(Action::Undo));
        assert_eq!(keymap.key_text(Action::Rescan), "F5");
        assert_eq!(keymap.key_text(Action::Quit), "quit");
    }

    #[test]
    fn keys_toml_errors_have_line_numbers() {
        let message = |text| Keymap::parse(text).unwrap_err().to_string();
        assert!(
            message("\nrescann = \"r\"").starts_with("line 2: unknown action \"rescann\"; use")
        );
        assert!(message("rescan = 5").starts_with("line 1: a key is written like"));
        assert_eq!(message("redo = \"x\"\nundo = \"x\""), "line 2: x is already bound to redo");
        assert!(message("rescan = ").starts_with("line 1: "));
    }
}
