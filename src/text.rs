//! How strings of bytes that come from devices and files are shown: nothing of them can steer a
//! terminal.
//!
//! Does not know where the text goes or how wide it may be.

use std::fmt;
use std::sync::Arc;
use unicode_general_category::{GeneralCategory, get_general_category};

/// Whether a character may be shown as it is: all but Unicode's Cc, Cf, Zl, Zp, Co and Cn.
pub fn is_printable(c: char) -> bool {
    if c.is_ascii() {
        return !c.is_ascii_control();
    }
    !matches!(
        get_general_category(c),
        GeneralCategory::Control
            | GeneralCategory::Format
            | GeneralCategory::LineSeparator
            | GeneralCategory::ParagraphSeparator
            | GeneralCategory::PrivateUse
            | GeneralCategory::Unassigned
            | GeneralCategory::Surrogate
    )
}

/// Bytes shown as text: UTF-8 where it is valid and printable, `\xNN` for every other byte,
/// `\\` for a backslash. Reversible.
#[derive(Clone, Copy)]
pub struct Escaped<'a>(pub &'a [u8]);

impl fmt::Display for Escaped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        use fmt::Write;
        for chunk in self.0.utf8_chunks() {
            for c in chunk.valid().chars() {
                if c == '\\' {
                    f.write_str("\\\\")?;
                } else if is_printable(c) {
                    f.write_char(c)?;
                } else {
                    let mut buffer = [0; 4];
                    hex_escapes(f, c.encode_utf8(&mut buffer).as_bytes())?;
                }
            }
            hex_escapes(f, chunk.invalid())?;
        }
        Ok(())
    }
}

/// A name in a sentence: [`Escaped`], in quotes where nothing of it would be seen.
#[derive(Clone, Copy)]
pub struct Quoted<'a>(pub &'a [u8]);

impl fmt::Display for Quoted<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let is_blank = self.0.utf8_chunks().all(|chunk| {
            chunk.invalid().is_empty() && chunk.valid().chars().all(char::is_whitespace)
        });
        if is_blank { write!(f, "\"{}\"", Escaped(self.0)) } else { Escaped(self.0).fmt(f) }
    }
}

/// [`Escaped`], as a string.
pub fn printable(bytes: &[u8]) -> String {
    Escaped(bytes).to_string()
}

/// A message on one line: TOML's errors draw the place on several, of which the first says where and
/// the last says what.
pub fn on_one_line(message: &str) -> String {
    let lines: Vec<&str> = message.lines().filter(|line| !line.trim().is_empty()).collect();
    match lines[..] {
        [] => "cannot be parsed".to_owned(),
        [only] => printable(only.as_bytes()),
        [first, .., last] => printable(format!("{first}: {last}").as_bytes()),
    }
}

fn hex_escapes(f: &mut fmt::Formatter<'_>, bytes: &[u8]) -> fmt::Result {
    bytes.iter().try_for_each(|byte| write!(f, "\\x{byte:02X}"))
}

/// The name a device gave itself: any bytes but 0. Cheap to clone; equal when the bytes are.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name(Arc<[u8]>);

impl Name {
    /// The name with these bytes.
    pub fn new(bytes: &[u8]) -> Self {
        Self(bytes.into())
    }

    /// Its bytes.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// The name in a sentence, or in a place of its own.
    pub fn quoted(&self) -> Quoted<'_> {
        Quoted(&self.0)
    }

    /// Its bytes as hexadecimal digits, exact.
    pub fn hex(&self) -> String {
        use fmt::Write;
        self.0.iter().fold(String::new(), |mut hex, byte| {
            let _ = write!(hex, "{byte:02X}");
            hex
        })
    }
}

impl From<&str> for Name {
    fn from(text: &str) -> Self {
        Self::new(text.as_bytes())
    }
}

/// Escaped as [`Escaped`] says: safe for a terminal.
impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if f.width().is_none() && f.precision().is_none() {
            Escaped(&self.0).fmt(f)
        } else {
            f.pad(&Escaped(&self.0).to_string())
        }
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{self}\"")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_steers_a_terminal_passes() {
        let shown = |bytes: &[u8]| Escaped(bytes).to_string();
        assert_eq!(shown("Котёл".as_bytes()), "Котёл");
        assert_eq!(shown(b"\x1b]0;x\x07"), "\\x1B]0;x\\x07");
        assert_eq!(shown(b"a\\b\xff"), "a\\\\b\\xFF");
        assert_eq!(shown("\u{9b}2J".as_bytes()), "\\xC2\\x9B2J");
        assert_eq!(shown("a\u{202e}b\u{2028}".as_bytes()), "a\\xE2\\x80\\xAEb\\xE2\\x80\\xA8");
    }

    #[test]
    fn a_name_of_which_nothing_is_seen_is_quoted() {
        let called = |name: &[u8]| Quoted(name).to_string();
        assert_eq!(called(b""), "\"\"");
        assert_eq!(called("  \u{3000}".as_bytes()), "\"  \u{3000}\"");
        assert_eq!(called(b"\t"), "\"\\x09\"");
        assert_eq!(called(b"A B"), "A B");
        assert_eq!(called(b"\xff"), "\\xFF");
    }
}
