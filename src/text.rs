//! Display of untrusted bytes from devices and files without control characters (protocol §2.4).
//!
//! Does not know where the text goes or how wide it may be.

use std::fmt;
use std::path::Path;
use std::sync::Arc;
use unicode_general_category::{GeneralCategory, get_general_category};
use unicode_width::UnicodeWidthChar;

/// Returns true if a character is shown unchanged: all but the Unicode categories Cc, Cf, Zl, Zp,
/// Co and Cn.
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

/// Returns the first `most` characters of a text; `…` follows where there are more.
pub fn shortened(text: &str, most: usize) -> String {
    match text.char_indices().nth(most) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// Joins the first `max` parts of a text; the number of the others follows.
pub fn join_first(mut parts: Vec<String>, max: usize, separator: &str) -> String {
    let more = parts.len().saturating_sub(max);
    parts.truncate(max);
    if more > 0 {
        parts.push(format!("and {more} more"));
    }
    parts.join(separator)
}

/// Bytes displayed as text: valid, printable UTF-8 unchanged, `\xNN` for any other byte, `\\` for a
/// backslash. Reversible.
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

/// A name in a sentence: [`Escaped`], in quotes if it has no visible character.
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

/// Most characters without a width, as combining marks, that are shown on one character: the limit
/// of the Stream-Safe Text Format (UAX #15).
pub const MAX_MARKS: usize = 30;

/// Lines that may contain foreign text: characters that are not printable as in [`Escaped`], `…`
/// for more than [`MAX_MARKS`] combining marks. Line ends are unchanged, and backslashes too, as
/// part of the text may be escaped already.
#[derive(Clone, Copy)]
pub struct SafeLines<'a>(pub &'a str);

impl fmt::Display for SafeLines<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        use fmt::Write;
        let mut marks = 0;
        self.0.chars().try_for_each(|c| {
            marks = if c.width() == Some(0) { marks + 1 } else { 0 };
            match c {
                '\n' => f.write_char(c),
                c if !is_printable(c) => hex_escapes(f, c.encode_utf8(&mut [0; 4]).as_bytes()),
                c if marks <= MAX_MARKS => f.write_char(c),
                _ if marks == MAX_MARKS + 1 => f.write_char('…'),
                _ => Ok(()),
            }
        })
    }
}

/// Returns the beginning of a character with its combining marks, with at most [`MAX_MARKS`] of
/// them.
pub fn with_few_marks(character: &str) -> &str {
    let end = character.char_indices().nth(MAX_MARKS + 1).map_or(character.len(), |(at, _)| at);
    &character[..end]
}

/// Returns the bytes as [`Escaped`] text.
pub fn printable(bytes: &[u8]) -> String {
    Escaped(bytes).to_string()
}

/// Returns a path as printable text. Only a Windows path has backslashes that are not escaped: they separate
/// its parts; a prefix that the system puts before them (`\\?\C:\logs`) is left out.
pub fn printable_path(path: &Path) -> String {
    let bytes = path.as_os_str().as_encoded_bytes();
    if cfg!(windows) { printable_windows_path(bytes) } else { printable(bytes) }
}

fn printable_windows_path(path: &[u8]) -> String {
    let (start, path) = match path.strip_prefix(br"\\?\") {
        Some(rest) => match rest.strip_prefix(br"UNC\") {
            Some(share) => (r"\\", share),
            None => ("", rest),
        },
        None => ("", path),
    };
    format!("{start}{}", printable_with_backslashes(path))
}

/// Returns the bytes as printable text whose backslashes stay single.
pub fn printable_with_backslashes(bytes: &[u8]) -> String {
    let parts: Vec<_> = bytes.split(|byte| *byte == b'\\').map(printable).collect();
    parts.join(r"\")
}

/// Returns a message on one line, printable. Of several lines, as in the errors of TOML, the first
/// (the position) and the last (the cause) are kept.
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

/// A device's name: any bytes but 0. Cheap to clone.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name(Arc<[u8]>);

impl Name {
    /// Creates a name from its bytes.
    pub fn new(bytes: &[u8]) -> Self {
        Self(bytes.into())
    }

    /// Returns the bytes.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// Returns the name for display, in quotes if it has no visible character.
    pub fn quoted(&self) -> Quoted<'_> {
        Quoted(&self.0)
    }

    /// Returns the bytes as hexadecimal digits.
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

/// As [`Escaped`]: safe on a terminal.
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

/// Bytes in hexadecimal with a separator.
pub fn hex(data: &[u8], between: &str) -> String {
    let mut text = String::with_capacity(data.len() * (2 + between.len()));
    push_hex(&mut text, data, between);
    text
}

/// Appends the same to a text.
pub fn push_hex(text: &mut String, data: &[u8], between: &str) {
    /// Bytes whose digits are appended at once.
    const PART: usize = 8;
    static DIGITS: &[u8; 16] = b"0123456789ABCDEF";
    // Faster than formatting, for logs of millions of frames.
    for (number, part) in data.chunks(PART).enumerate() {
        if number > 0 {
            text.push_str(between);
        }
        let mut digits = [[b' '; 3]; PART];
        for (place, byte) in digits.iter_mut().zip(part) {
            place[0] = DIGITS[usize::from(byte >> 4)];
            place[1] = DIGITS[usize::from(byte & 0x0F)];
        }
        match between {
            "" => {
                let mut joined = [0; 2 * PART];
                for (place, [high, low, _]) in joined.chunks_exact_mut(2).zip(digits) {
                    place.copy_from_slice(&[high, low]);
                }
                let joined = &joined[..2 * part.len()];
                text.push_str(std::str::from_utf8(joined).unwrap_or_default());
            }
            " " => {
                let digits = &digits.as_flattened()[..3 * part.len() - 1];
                text.push_str(std::str::from_utf8(digits).unwrap_or_default());
            }
            _ => {
                for (at, [high, low, _]) in digits[..part.len()].iter().enumerate() {
                    text.push_str(if at == 0 { "" } else { between });
                    text.push(char::from(*high));
                    text.push(char::from(*low));
                }
            }
        }
    }
}

/// Returns a count with its unit: `1 frame`, `2 frames`, `2 addresses`.
pub fn counted(count: u64, what: &str) -> String {
    let plural = if what.ends_with('s') { "es" } else { "s" };
    format!("{count} {what}{}", if count == 1 { "" } else { plural })
}

/// Returns the name of a bus without the bit rates at which an slcan adapter is opened:
/// `slcan:/dev/ttyACM0` for `slcan:/dev/ttyACM0@500000`.
pub fn without_bit_rates(bus: &str) -> &str {
    let is_rates = |text: &str| text.chars().all(|c| c.is_ascii_digit() || c == '/');
    let parts = bus.rsplit_once('@').filter(|_| bus.starts_with("slcan:"));
    parts.filter(|(_, rates)| is_rates(rates)).map_or(bus, |(name, _)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backslashes_of_windows_paths_are_separators() {
        for (path, expected) in [
            (&br"\\?\C:\logs\a.log"[..], r"C:\logs\a.log"),
            (br"\\?\UNC\server\share\a.log", r"\\server\share\a.log"),
            (br"\\server\share", r"\\server\share"),
            (br"sub\des.json", r"sub\des.json"),
            (b"sub\\\x1b[2J", r"sub\\x1B[2J"),
            (b"", ""),
        ] {
            assert_eq!(printable_windows_path(path), expected);
        }
    }

    #[test]
    fn control_characters_are_escaped() {
        let shown = |bytes: &[u8]| Escaped(bytes).to_string();
        assert_eq!(shown("Котёл".as_bytes()), "Котёл");
        assert_eq!(shown(b"\x1b]0;x\x07"), "\\x1B]0;x\\x07");
        assert_eq!(shown(b"a\\b\xff"), "a\\\\b\\xFF");
        assert_eq!(shown("\u{9b}2J".as_bytes()), "\\xC2\\x9B2J");
        assert_eq!(shown("a\u{202e}b\u{2028}".as_bytes()), "a\\xE2\\x80\\xAEb\\xE2\\x80\\xA8");
    }

    #[test]
    fn safe_lines_keep_line_ends_and_escapes() {
        let shown = SafeLines("a\x1b[2J\u{9b}\\x1B\n\tb\r\n\u{202e}").to_string();
        assert_eq!(shown, "a\\x1B[2J\\xC2\\x9B\\x1B\n\\x09b\\x0D\n\\xE2\\x80\\xAE");
    }

    #[test]
    fn hex_has_its_separator_between_all_bytes() {
        let data: Vec<u8> = (0..20).map(|byte| byte * 13).collect();
        for (len, between) in (0..=20).flat_map(|len| ["", " ", ", "].map(|it| (len, it))) {
            let digits: Vec<_> = data[..len].iter().map(|byte| format!("{byte:02X}")).collect();
            assert_eq!(hex(&data[..len], between), digits.join(between));
        }
    }

    #[test]
    fn many_combining_marks_are_cut() {
        let marks = |count| format!("A{}B", "\u{301}".repeat(count));
        assert_eq!(SafeLines(&marks(30)).to_string(), marks(30));
        let cut = marks(30).replace('B', "…B");
        assert_eq!(SafeLines(&marks(2000)).to_string(), cut);
        assert_eq!(with_few_marks(&marks(2000)), &marks(30)[..61]);
        assert_eq!(with_few_marks("é"), "é");
    }

    #[test]
    fn name_without_visible_character_is_quoted() {
        let quoted = |name: &[u8]| Quoted(name).to_string();
        assert_eq!(quoted(b""), "\"\"");
        assert_eq!(quoted("  \u{3000}".as_bytes()), "\"  \u{3000}\"");
        assert_eq!(quoted(b"\t"), "\"\\x09\"");
        assert_eq!(quoted(b"A B"), "A B");
        assert_eq!(quoted(b"\xff"), "\\xFF");
    }
}
