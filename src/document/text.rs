//! Conversion of names and strings to and from JSON and hexadecimal.

use std::borrow::Cow;
use std::fmt::Write as _;

use crate::text::{Quoted, is_printable};

/// Returns a name for a message: [`Quoted`], at most 40 characters.
pub(super) fn brief(bytes: &[u8]) -> String {
    const CHARACTERS: usize = 40;
    let text = Quoted(bytes).to_string();
    match text.char_indices().nth(CHARACTERS) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

/// Returns a JSON string. Unprintable characters are escaped, so that a device's name puts no
/// control codes into the file.
pub(super) fn to_json(text: &str) -> String {
    let mut out = String::with_capacity(text.len() + 2);
    out.push('"');
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            c if is_printable(c) => out.push(c),
            c => {
                for unit in c.encode_utf16(&mut [0; 2]) {
                    let _ = write!(out, "\\u{unit:04x}");
                }
            }
        }
    }
    out.push('"');
    out
}

/// Returns the value of a JSON string; `None` if it is not a string or has half of a surrogate
/// pair.
pub(super) fn from_json(raw: &str) -> Option<Cow<'_, str>> {
    let inner = raw.strip_prefix('"')?.strip_suffix('"')?;
    if inner.contains('\\') {
        serde_json::from_str(raw).ok().map(Cow::Owned)
    } else {
        Some(Cow::Borrowed(inner))
    }
}

pub(super) fn to_hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(bytes.len() * 2), |mut out, byte| {
        let _ = write!(out, "{byte:02X}");
        out
    })
}

pub(super) fn from_hex(text: &str) -> Option<Vec<u8>> {
    let digit = |c: &u8| char::from(*c).to_digit(16);
    let (pairs, rest) = text.as_bytes().as_chunks::<2>();
    if !rest.is_empty() {
        return None;
    }
    pairs.iter().map(|[high, low]| Some((digit(high)? << 4 | digit(low)?) as u8)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn name_in_a_message_is_bounded() {
        assert_eq!(brief(&[b'a'; 50]), format!("{}…", "a".repeat(40)));
    }

    #[test]
    fn json_string_round_trips() {
        for text in ["", "FEED", "a\"b\\c", "\u{1b}\u{85}\u{202e}\u{f0000}", "Насос"] {
            let json = to_json(text);
            assert!(json.chars().all(is_printable), "{json}");
            assert_eq!(from_json(&json).unwrap(), text);
        }
        assert_eq!(from_json("\"\\ud800\""), None);
        assert_eq!(from_json("12"), None);
    }

    #[test]
    fn hex_round_trips() {
        assert_eq!(to_hex(b"\x00\xfeED"), "00FE4544");
        assert_eq!(from_hex("00fE4544").unwrap(), b"\x00\xfeED");
        assert_eq!(from_hex("0"), None);
        assert_eq!(from_hex("+1"), None);
        assert_eq!(from_hex("пп"), None);
    }
}
