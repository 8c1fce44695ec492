//! Texts on standard output and standard error, without a screen.
//!
//! The only writer of such texts: a character that is not printable, as in an argument, a file name
//! or a setting, is escaped here at the latest. Line ends are kept. Failures to write to standard
//! error are ignored, because a report of them could not be written either.

use super::Failure;
use crate::shell::console::discard_typed;
use crate::text::SafeLines;
use std::fmt::{Display, Write as _};
use std::io::{self, BufRead, IsTerminal, Write};
use std::sync::mpsc::{Receiver, channel};
use std::thread;

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
    let mut rest = json;
    while !rest.is_empty() {
        let plain = plain_len(rest.as_bytes());
        text.push_str(&rest[..plain]);
        rest = &rest[plain..];
        let Some(c) = rest.chars().next() else { break };
        rest = &rest[c.len_utf8()..];
        if crate::text::is_printable(c) {
            text.push(c);
        } else {
            for unit in c.encode_utf16(&mut [0; 2]) {
                let _ = write!(text, "\\u{unit:04X}");
            }
        }
    }
}

/// Printable ASCII, and line ends.
fn is_plain(byte: u8) -> bool {
    byte == b'\n' || byte.wrapping_sub(0x20) < 0x7F - 0x20
}

/// Number of plain bytes that a text begins with.
fn plain_len(text: &[u8]) -> usize {
    /// Bytes that are tested at once.
    const PART: usize = 32;
    let is_plain_part = |part: &&[u8]| part.iter().fold(true, |all, &byte| all & is_plain(byte));
    let parts = text.chunks_exact(PART).take_while(is_plain_part).count();
    let rest = &text[parts * PART..];
    parts * PART + rest.iter().position(|&byte| !is_plain(byte)).unwrap_or(rest.len())
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
        /// In the lines of frames.
        const SIGNS: [&str; 2] = ["→", "✗"];
        let mut rest = text;
        // Most of it needs no look at each character.
        while !rest.is_empty() {
            let end = plain_len(rest.as_bytes());
            self.waiting.push_str(&rest[..end]);
            rest = &rest[end..];
            let end = rest.bytes().position(is_plain).unwrap_or(rest.len());
            let (other, after) = rest.split_at(end);
            if SIGNS.contains(&other) {
                self.waiting.push_str(other);
            } else {
                let _ = write!(self.waiting, "{}", SafeLines(other));
            }
            rest = after;
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

/// Prints a question on standard error, without a line end. What was typed before it is no answer.
pub fn ask(text: impl Display) {
    discard_typed();
    let _ = write!(io::stderr(), "{} ", SafeLines(&text.to_string()));
}

/// Returns true if a question can be asked: on a terminal.
pub fn may_ask() -> bool {
    io::stdin().is_terminal() && io::stderr().is_terminal()
}

/// Reads the answer to a question from standard input, while the program goes on: true for yes.
pub fn answer() -> Receiver<bool> {
    let (sender, answer) = channel();
    thread::spawn(move || {
        let mut line = String::new();
        let is_read = io::stdin().lock().read_line(&mut line).is_ok();
        let is_yes = ["y", "yes"].contains(&line.trim().to_lowercase().as_str());
        // The program may be about to end.
        let _ = sender.send(is_read && is_yes);
    });
    answer
}

/// Replaces the present line of the terminal at standard error.
pub fn show_progress(line: &str) {
    let _ = write!(io::stderr(), "\r\x1b[K{}", SafeLines(line));
}
