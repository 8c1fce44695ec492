//! Texts on standard output and standard error, without a screen.
//!
//! The only writer of such texts: a character that is not printable, as in an argument, a file name
//! or a setting, is escaped here at the latest. Line ends are kept. Failures to write to standard
//! error are ignored, because a report of them could not be written either.

use super::Failure;
use crate::text::SafeLines;
use std::fmt::{Display, Write as _};
use std::io::{self, Write};

/// Prints text on standard output and flushes it.
///
/// # Errors
/// Standard output is closed, or cannot be written.
pub fn print(text: &str) -> Result<(), Failure> {
    print_own(SafeLines(text).to_string().as_bytes())
}

/// Prints JSON on standard output and flushes it. In its strings, the only place for them,
/// characters that are not printable are escaped.
///
/// # Errors
/// As [`print()`].
pub fn print_json(json: &str) -> Result<(), Failure> {
    let mut text = String::with_capacity(json.len());
    escape_json(json, &mut text);
    print_own(text.as_bytes())
}

fn escape_json(json: &str, text: &mut String) {
    if json.bytes().all(|byte| byte == b'\n' || (0x20..0x7F).contains(&byte)) {
        return text.push_str(json);
    }
    for c in json.chars() {
        if c == '\n' || crate::text::is_printable(c) {
            text.push(c);
        } else {
            for unit in c.encode_utf16(&mut [0; 2]) {
                let _ = write!(text, "\\u{unit:04X}");
            }
        }
    }
}

/// Many lines on standard output, in large writes. Escapes as [`print()`] and [`print_json()`].
#[derive(Debug, Default)]
pub struct LineOutput {
    waiting: String,
}

impl LineOutput {
    /// Bytes that are written at once.
    const ROOM: usize = 1 << 16;

    /// Prints text.
    ///
    /// # Errors
    /// As [`print()`].
    pub fn print(&mut self, text: &str) -> Result<(), Failure> {
        let is_plain = |byte: u8| byte == b'\n' || (0x20..0x7F).contains(&byte);
        let mut rest = text;
        // Most of it needs no look at each character.
        while !rest.is_empty() {
            let end = rest.bytes().position(|byte| !is_plain(byte)).unwrap_or(rest.len());
            self.waiting.push_str(&rest[..end]);
            rest = &rest[end..];
            let end = rest.bytes().position(is_plain).unwrap_or(rest.len());
            let _ = write!(self.waiting, "{}", SafeLines(&rest[..end]));
            rest = &rest[end..];
        }
        self.flush_from(Self::ROOM)
    }

    /// Prints JSON.
    ///
    /// # Errors
    /// As [`print()`].
    pub fn print_json(&mut self, json: &str) -> Result<(), Failure> {
        escape_json(json, &mut self.waiting);
        self.flush_from(Self::ROOM)
    }

    /// Writes what waits.
    ///
    /// # Errors
    /// As [`print()`].
    pub fn flush(&mut self) -> Result<(), Failure> {
        self.flush_from(1)
    }

    fn flush_from(&mut self, least: usize) -> Result<(), Failure> {
        if self.waiting.len() < least {
            return Ok(());
        }
        let printed = print_own(self.waiting.as_bytes());
        self.waiting.clear();
        printed
    }
}

/// Prints text that consists of descan's own words, and may have styles, as it is.
///
/// # Errors
/// As [`print()`].
pub fn print_own(text: &[u8]) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    let printed = out.write_all(text).and_then(|()| out.flush());
    printed.map_err(|error| match error.kind() {
        io::ErrorKind::BrokenPipe => Failure::Closed,
        _ => Failure::System(anyhow::Error::new(error).context("cannot write to standard output")),
    })
}

/// Prints a line on standard error, with the name of the program.
pub fn warn(text: impl Display) {
    say(format_args!("descan: {text}"));
}

/// Prints a line on standard error.
pub fn say(text: impl Display) {
    let line = format!("{}\n", SafeLines(&text.to_string()));
    let _ = io::stderr().write_all(line.as_bytes());
}

/// Prints a question on standard error, without a line end.
pub fn ask(text: impl Display) {
    let _ = write!(io::stderr(), "{} ", SafeLines(&text.to_string()));
}

/// Replaces the present line of the terminal at standard error.
pub fn show_progress(line: &str) {
    let _ = write!(io::stderr(), "\r\x1b[K{}", SafeLines(line));
}
