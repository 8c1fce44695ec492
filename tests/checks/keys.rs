//! `keys.toml`: an input is its text.

use super::{Target, assert_line, assert_printable};
use descan::keymap::{ACTIONS, Key, Keymap};

/// Target `keys`.
pub const KEYS: Target = Target {
    name: "keys",
    check: |input| {
        let Ok(text) = str::from_utf8(input) else { return };
        let keymap = match Keymap::parse(text) {
            Ok(keymap) => keymap,
            Err(error) => return assert_line(text, error.line),
        };
        for info in ACTIONS {
            for key in keymap.keys_of(info.action) {
                let printed = key.to_string();
                assert_printable(&printed);
                assert_eq!(Key::parse(&printed), Some(key), "{printed}");
                assert_eq!(keymap.lookup(info.mode, key), Some(info.action), "{printed}");
            }
            assert_printable(&keymap.key_text(info.action));
        }
    },
    words: &[
        b"rescan = \"F5\"\n",
        b"freeze = [\"Space\", \"f\"]\n",
        b"quit-now = []\n",
        b"Ctrl-",
        b"Shift-",
        b"Alt-",
        b"C-",
        b"Minus",
        b"\"-\"",
        b"PgUp",
        b"F24",
        b"F0",
        b"\"\\u001b\"",
        b"\"\\u202e\"",
        "к".as_bytes(),
        "İ".as_bytes(),
        "ẞ".as_bytes(),
        b"redo = \"x\"\n",
        b"undo = ",
        b"[",
        b"]",
    ],
};
