//! What the keys do: one table of actions, and the keys bound to them.
//!
//! The usual keys stand in the table ([`ACTIONS`]); `keys.toml` gives an action other ones:
//!
//! ```toml
//! rescan = "F5"              # instead of r
//! freeze = ["Space", "f"]
//! quit-now = []              # none
//! ```
//!
//! Does not know terminals, and does not run anything itself: [`crate::app::App`] looks a key up
//! and runs the action.

mod actions;
mod key;

pub use actions::{ACTIONS, Action, ActionGroup, KeyMode, action};
pub use key::{Key, KeyCode};

use std::fmt;
use std::ops::Range;
use toml::de::{DeTable, DeValue};

/// Which key does what.
#[derive(Clone)]
pub struct Keymap {
    /// In the order of the table of actions.
    bindings: Vec<(Key, &'static Action)>,
}

impl Default for Keymap {
    /// The usual keys.
    fn default() -> Self {
        let usual = |action: &'static Action| {
            let keys = action.keys.iter().filter_map(|text| Key::parse(text));
            keys.map(move |key| (key, action))
        };
        Self { bindings: ACTIONS.iter().flat_map(usual).collect() }
    }
}

impl fmt::Debug for Keymap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list()
            .entries(self.bindings.iter().map(|(key, action)| format!("{key} {}", action.name)))
            .finish()
    }
}

/// Why a `keys.toml` cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {message}")]
pub struct KeysError {
    /// From 1.
    pub line: usize,
    /// What is wrong there.
    pub message: String,
}

impl Keymap {
    /// Reads a `keys.toml`. Actions it does not name keep their usual keys, except those that
    /// it gives to others.
    pub fn parse(text: &str) -> Result<Self, KeysError> {
        let error = |span: Range<usize>, message: String| KeysError {
            line: text[..span.start].matches('\n').count() + 1,
            message,
        };
        let table = DeTable::parse(text)
            .map_err(|e| error(e.span().unwrap_or(0..0), e.message().to_owned()))?;
        let mut given: Vec<(Key, &'static Action)> = Vec::new();
        let mut named = Vec::new();
        for (name, value) in table.get_ref() {
            let action = action(name.get_ref()).ok_or_else(|| {
                let known: Vec<&str> = ACTIONS.iter().map(|action| action.name).collect();
                let known = known.join(", ");
                error(name.span(), format!("unknown action \"{}\"; use {known}", name.get_ref()))
            })?;
            named.push(action.name);
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
                let same = |(other, to): &&(Key, &Action)| *other == key && to.mode == action.mode;
                if let Some((_, other)) = given.iter().find(same) {
                    return Err(error(
                        written.span(),
                        format!("{key} is already bound to {}", other.name),
                    ));
                }
                given.push((key, action));
            }
        }
        let mut keymap = Self::default();
        keymap.bindings.retain(|(key, action)| {
            let taken = |(other, to): &(Key, &Action)| other == key && to.mode == action.mode;
            !named.contains(&action.name) && !given.iter().any(taken)
        });
        keymap.bindings.extend(given);
        Ok(keymap)
    }

    /// What a key does in this mode. A key of the Russian layout does what the key at its place
    /// does, unless it is bound itself.
    pub fn lookup(&self, mode: KeyMode, key: Key) -> Option<&'static Action> {
        let key = key.normal();
        let bound = |key: Key| {
            let found = self.bindings.iter().find(|(own, to)| *own == key && to.mode == mode);
            found.map(|(_, action)| *action)
        };
        bound(key).or_else(|| bound(key.on_latin_keyboard()?.normal()))
    }

    /// The keys of an action.
    pub fn keys_of(&self, action: &Action) -> impl Iterator<Item = Key> {
        self.bindings.iter().filter(|(_, to)| to.name == action.name).map(|(key, _)| *key)
    }

    /// The first key of the action of that name and its hint, where it has both.
    pub fn hint(&self, name: &str) -> Option<(Key, &'static str)> {
        let action = action(name)?;
        Some((self.keys_of(action).next()?, action.hint))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_action_has_a_name_of_its_own_a_doc_and_good_keys() {
        for (at, action) in ACTIONS.iter().enumerate() {
            assert!(!action.doc.is_empty() && !action.keys.is_empty(), "{action:?}");
            assert!(ACTIONS[..at].iter().all(|other| other.name != action.name), "{action:?}");
            for text in action.keys {
                let key = Key::parse(text).unwrap_or_else(|| panic!("{action:?}: {text}"));
                let found = Keymap::default().lookup(action.mode, key).map(|found| found.name);
                assert_eq!(found, Some(action.name), "{text} is bound twice");
            }
        }
    }

    #[test]
    fn keys_can_be_given_to_other_actions() {
        let keymap = Keymap::parse("rescan = \"F5\"\nfreeze = [\"r\"]\nquit = []\n").unwrap();
        let name = |text| {
            let key = Key::parse(text).unwrap();
            keymap.lookup(KeyMode::Browse, key).map(|action| action.name)
        };
        assert_eq!(name("F5"), Some("rescan"));
        assert_eq!(name("r"), Some("freeze"));
        assert_eq!(name("q"), None);
        assert_eq!(name("к"), Some("freeze"));
        assert_eq!(name("u"), Some("undo"));
    }

    #[test]
    fn errors_say_where() {
        let message = |text| Keymap::parse(text).unwrap_err().to_string();
        assert!(
            message("\nrescann = \"r\"").starts_with("line 2: unknown action \"rescann\"; use")
        );
        assert!(message("rescan = 5").starts_with("line 1: a key is written like"));
        assert_eq!(message("redo = \"x\"\nundo = \"x\""), "line 2: x is already bound to redo");
        assert!(message("rescan = ").starts_with("line 1: "));
    }
}
