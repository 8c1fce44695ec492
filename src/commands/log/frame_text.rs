//! A frame of a log as a line of text: time, bus, identifier, kind, route, bytes, meaning, latency; a line with
//! the date before the first frame of another day.
//!
//! Written without formatting machinery where it is the same for most frames. Does not know which
//! frames are printed.

use super::known_names::KnownNames;
use crate::app::{App, CallPart, FrameMeaning, FrameRole, format_time_of_day};
use crate::frame::{CanId, Frame, FrameKind};
use crate::text::push_hex;
use crate::time::Instant;
use crate::wire::id::Address;
use std::fmt::Write;
use unicode_width::UnicodeWidthStr;

/// Cells of a name with its address.
pub const END: usize = 12;
/// Cells of a service.
pub const SERVICE: usize = 9;
/// Cells of eight bytes with blanks between them.
const BYTES: usize = 23;

/// Writes frames as lines in columns.
#[derive(Debug, Default)]
pub struct FrameText {
    /// Cells of the longest name of a bus so far.
    bus_width: usize,
    names: KnownNames,
    /// The last second, and its time of day.
    second: Option<(u64, String)>,
    /// The date of the last frame.
    date: Option<String>,
}

impl FrameText {
    /// Appends the line of a frame, with its end.
    pub fn write(&mut self, line: &mut String, app: &App, frame: &Frame, part: Option<CallPart>) {
        let FrameMeaning { header, role, text, .. } = FrameMeaning::of(app, frame);
        self.write_time(line, app, frame.time);
        if app.buses().len() > 1 {
            let name = app.bus(frame.bus).map_or("?", |bus| bus.name_without_rates());
            self.bus_width = self.bus_width.max(name.width());
            left(line, name, self.bus_width);
            line.push(' ');
        }
        match (frame.kind, frame.id) {
            (FrameKind::Error, _) => blanks(line, 8),
            (_, CanId::Extended(id)) => push_hex(line, &id.to_be_bytes(), ""),
            (_, CanId::Standard(_)) => {
                let _ = write!(line, "     {}", frame.id);
            }
        }
        line.push(' ');
        line.push_str(word_in_column(role));
        line.push(' ');
        if let Some(header) = header {
            line.push_str(&self.names.end(app, frame.bus, header.source, frame.time).sender);
            line.push('→');
            if header.broadcast {
                line.push_str("all         ");
            } else {
                let end = self.names.end(app, frame.bus, header.destination, frame.time);
                line.push_str(&end.receiver);
            }
            line.push(' ');
            line.push_str(&self.names.service(app, frame, header, role).column);
        } else {
            blanks(line, END + 1 + END + 1 + SERVICE);
        }
        let len = frame.len();
        line.push_str(if len < 10 { "  " } else { " " });
        push_number(line, len as u64, 1);
        line.push(' ');
        push_hex(line, frame.data(), " ");
        let latency = match part {
            Some(CallPart::Response { latency, is_ambiguous, .. }) => Some((latency, is_ambiguous)),
            _ => None,
        };
        if latency.is_some() || !text.is_empty() {
            let used = (3 * frame.data().len()).saturating_sub(1);
            blanks(line, BYTES.saturating_sub(used) + 2);
            line.push_str(&text);
        }
        if let Some((latency, is_ambiguous)) = latency {
            let sign = if is_ambiguous { "≈ " } else { "" };
            let space = if text.is_empty() { "" } else { "  " };
            let _ = write!(line, "{space}{sign}{:.1} ms", latency.as_secs_f64() * 1e3);
        }
        line.truncate(line.trim_end().len());
        line.push('\n');
    }

    /// Appends the time of day with milliseconds, and a blank; before it a line with both dates, `# 2026-11-23,
    /// after 2026-11-22`, if the last frame was of another day.
    fn write_time(&mut self, line: &mut String, app: &App, time: Instant) {
        let second = app.epoch().unix_micros(time) / 1_000_000;
        let text = match &mut self.second {
            Some((last, text)) if *last == second => text,
            other => {
                let date = app.date_text(time);
                if let Some(last) = self.date.replace(date.clone()).filter(|last| *last != date) {
                    let _ = writeln!(line, "# {date}, after {last}");
                }
                &mut other.insert((second, format_time_of_day(app, time))).1
            }
        };
        line.push_str(text);
        line.push('.');
        push_number(line, app.epoch().unix_micros(time) / 1000 % 1000, 3);
        line.push(' ');
    }
}

/// The word of a role, in its column of four cells.
fn word_in_column(role: FrameRole) -> &'static str {
    match role {
        FrameRole::Request => "req ",
        FrameRole::Response => "rsp ",
        FrameRole::Debug => "dbg ",
        FrameRole::NonConforming => "odd ",
        FrameRole::Error => "ERR ",
        FrameRole::Standard => "std ",
        FrameRole::Remote => "rtr ",
        FrameRole::Foreign => "29b ",
        FrameRole::FailedResponse | FrameRole::Unsolicited => role.word(),
    }
}

/// Appends a number with at least `digits` digits, at most 20.
pub fn push_number(line: &mut String, number: u64, digits: usize) {
    let (mut text, mut begin, mut rest) = ([b'0'; 20], 20, number);
    while rest > 0 || 20 - begin < digits {
        begin -= 1;
        text[begin] = b'0' + (rest % 10) as u8;
        rest /= 10;
    }
    line.push_str(std::str::from_utf8(&text[begin..]).unwrap_or_default());
}

fn blanks(line: &mut String, count: usize) {
    const BLANKS: &str = "                                        ";
    line.push_str(BLANKS.get(..count).unwrap_or(BLANKS));
}

/// Returns a name with its address; an address without a name alone.
pub fn with_address(name: &str, address: Address) -> String {
    let number = address.to_string();
    if name == number { number } else { format!("{name}@{number}") }
}

/// Appends a text, left-aligned in `width` cells.
pub fn left(line: &mut String, text: &str, width: usize) {
    line.push_str(text);
    line.extend(std::iter::repeat_n(' ', width.saturating_sub(text.width())));
}

/// Appends a text, right-aligned in `width` cells.
pub fn right(line: &mut String, text: &str, width: usize) {
    line.extend(std::iter::repeat_n(' ', width.saturating_sub(text.width())));
    line.push_str(text);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_fill_their_column() {
        for role in FrameRole::ALL {
            let mut word = String::new();
            left(&mut word, role.word(), 4);
            assert_eq!(word_in_column(role), word);
        }
    }

    #[test]
    fn numbers_are_padded_with_zeros() {
        let text = |number, digits| {
            let mut line = String::new();
            push_number(&mut line, number, digits);
            line
        };
        assert_eq!(text(7, 3), "007");
        assert_eq!(text(0, 1), "0");
        assert_eq!(text(u64::MAX, 1), u64::MAX.to_string());
    }
}
