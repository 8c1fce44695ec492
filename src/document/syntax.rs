//! JSON syntax: whether the file is JSON and, if not, where and why not.

use std::fmt;

use serde::de::IgnoredAny;
use unicode_width::UnicodeWidthChar;

use super::position::Positions;
use super::{MAX_ENTRIES, MAX_SERVICES, scan};

/// Deepest nesting of brackets; the limit of serde_json.
const DEPTH: usize = 128;

/// Byte order mark, which some editors write at the start of a file.
pub(super) const BOM: &str = "\u{feff}";

/// Why a file cannot be parsed. `Display`: "line 7, column 12: expected `,` or `}`".
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: {message}")]
#[non_exhaustive]
pub struct ParseError {
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// What is wrong, in a few words.
    pub message: String,
    /// The line; if it is long, the part around the error. Safe on a terminal.
    pub line_text: String,
    /// Index of the error in the characters of `line_text`; may be just behind the last one.
    pub caret: usize,
}

impl ParseError {
    /// Returns the line, and a second one with a caret below the error; `None` if it is blank.
    pub fn excerpt(&self) -> Option<[String; 2]> {
        let before = self.line_text.chars().take(self.caret);
        let cells: usize = before.filter_map(UnicodeWidthChar::width).sum();
        let is_visible = !self.line_text.trim().is_empty();
        is_visible.then(|| [self.line_text.clone(), format!("{}^", " ".repeat(cells))])
    }
}

/// Returns the source as text if it is JSON or blank.
///
/// # Errors
/// [`ParseError`] if it is neither, or not UTF-8.
pub(super) fn check(source: &[u8]) -> Result<&str, ParseError> {
    let text = str::from_utf8(source).map_err(|error| {
        let (good, bad) = source.split_at(error.valid_up_to());
        let good = str::from_utf8(good).unwrap_or_default();
        let message = match bad {
            [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..] if good.is_empty() => {
                "the file is UTF-16: save it as UTF-8".to_owned()
            }
            _ => format!("0x{:02X} is not UTF-8: save it as UTF-8", bad[0]),
        };
        error_at(good, good.len(), message)
    })?;
    let body = text.strip_prefix(BOM).unwrap_or(text);
    if scan::root(body).is_none() {
        return Ok(text);
    }
    serde_json::from_str::<IgnoredAny>(body).map_err(|error| syntax_error(body, &error))?;
    match scan::deeper_than(body, DEPTH) {
        Some(at) => Err(error_at(body, at, format!("nested deeper than {DEPTH} levels"))),
        None => Ok(text),
    }
}

/// The error of a list with more than [`MAX_ENTRIES`] elements, at the first that is too many.
pub(super) fn too_many_entries(body: &str, at: usize) -> ParseError {
    let message = format!("more than {MAX_ENTRIES} entries; name the right file with --file");
    error_at(body, at, message)
}

/// The error of an entry with more than [`MAX_SERVICES`] services, at its start.
pub(super) fn too_many_services(body: &str, at: usize) -> ParseError {
    let message = format!("an entry with more than {MAX_SERVICES} services; remove some");
    error_at(body, at, message)
}

/// Converts an error of serde_json, which counts in bytes, points at the last byte read, and has
/// line and column in its text.
fn syntax_error(body: &str, error: &serde_json::Error) -> ParseError {
    let text = error.to_string();
    let message = text.rsplit_once(" at line ").map_or(text.as_str(), |(message, _)| message);
    if error.is_eof() {
        let message = message.replacen("EOF while parsing", "the file ends inside", 1);
        return error_at(body, body.trim_end_matches(scan::BLANKS).len(), message);
    }
    let line: usize = body.split_inclusive('\n').take(error.line() - 1).map(str::len).sum();
    let at = body.floor_char_boundary((line + error.column()).saturating_sub(1));
    if message.starts_with("control character") {
        // serde_json points at the character before.
        let at = at + body[at..].find(char::is_control).unwrap_or_default();
        let message = match body[at..].chars().next() {
            Some(control) if !['\n', '\r'].contains(&control) => {
                format!("a control character: in a string it is written \\u{:04X}", control as u32)
            }
            _ => "unterminated string".to_owned(),
        };
        return error_at(body, at, message);
    }
    let is_closing = body[at..].starts_with([']', '}']);
    let after_comma = body[..at].trim_end_matches(scan::BLANKS).ends_with(',');
    let is_padded =
        body[..at].ends_with('0') && body[at..].starts_with(|c: char| c.is_ascii_digit());
    let is_comment = ["//", "/*", "#"].iter().any(|it| body[at..].starts_with(it));
    let message = match message {
        _ if is_comment => "JSON has no comments",
        _ if is_closing && after_comma => "trailing comma",
        _ if body[at..].starts_with('\'') => "JSON has double quotes only",
        "trailing characters" => "text after the end",
        "expected ident" => "not a value: true, false and null are the only words",
        "invalid number" if is_padded => "a number must not begin with 0",
        message => message,
    };
    error_at(body, at, message.to_owned())
}

fn error_at(text: &str, at: usize, message: String) -> ParseError {
    /// Characters of the line shown on each side of the error.
    const CHARACTERS: usize = 36;
    let text_before =
        text.strip_prefix(BOM).map_or(&text[..at], |body| &body[..at.saturating_sub(BOM.len())]);
    let position = Positions::new(text_before).at(text_before.len());

    let line_start = text_before.rfind('\n').map_or(0, |newline| newline + 1);
    let before = &text_before[line_start..];
    let cut = before.char_indices().rev().nth(CHARACTERS - 1).map_or(0, |(start, _)| start);
    let mark = if cut > 0 { "…" } else { "" };
    let before = format!("{mark}{}", shown(&before[cut..]));
    let after = text[at..].split(['\n', '\r']).next().unwrap_or_default();
    let end = after.char_indices().nth(CHARACTERS).map_or(after.len(), |(end, _)| end);
    let mark = if end < after.len() { "…" } else { "" };
    let after = format!("{}{mark}", shown(&after[..end]));
    ParseError {
        line: position.line,
        column: position.column,
        message,
        caret: before.chars().count(),
        line_text: before + &after,
    }
}

/// Makes text printable. Tabs become spaces, so that the caret stays in place; backslashes are
/// JSON's own and stay.
fn shown(text: &str) -> String {
    text.chars().fold(String::new(), |mut out, c| {
        match c {
            '\t' => out.push(' '),
            c if crate::text::is_printable(c) => out.push(c),
            c => out.push_str(&crate::text::printable(c.encode_utf8(&mut [0; 4]).as_bytes())),
        }
        out
    })
}

/// Kind of a JSON value, with its article, for messages.
pub(super) struct JsonKind<'a>(pub &'a str);

impl fmt::Display for JsonKind<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0.as_bytes()[0] {
            b'{' => "an object",
            b'[' => "a list",
            b'"' => "a string",
            b't' | b'f' => "true or false",
            b'n' => "null",
            _ => "a number",
        })
    }
}
