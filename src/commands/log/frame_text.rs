//! A frame of a log as a line of text: time, bus, identifier, kind, route, bytes, meaning, latency.
//!
//! Does not know which frames are printed.

use crate::app::{App, CallPart, Decoded, clock_millis};
use crate::frame::{Frame, FrameKind};
use crate::text::push_hex;
use crate::wire::id::Address;
use std::fmt::Write;
use unicode_width::UnicodeWidthStr;

/// Cells of a name with its address.
const END: usize = 12;
/// Cells of a service.
const SERVICE: usize = 9;
/// Cells of eight bytes with blanks between them.
const BYTES: usize = 23;

/// Writes frames as lines in columns.
#[derive(Debug, Default)]
pub struct FrameText {
    /// Cells of the longest name of a bus so far.
    bus_width: usize,
}

impl FrameText {
    /// Appends the line of a frame, with its end.
    pub fn write(&mut self, line: &mut String, app: &App, frame: &Frame, part: Option<CallPart>) {
        let decoded = Decoded::of(app, frame);
        let _ = write!(line, "{} ", clock_millis(app, frame.time));
        if app.buses().len() > 1 {
            let name = app.bus(frame.bus).map_or("?", |bus| bus.name_without_rates());
            self.bus_width = self.bus_width.max(name.width());
            left(line, name, self.bus_width);
            line.push(' ');
        }
        let id = match frame.kind {
            FrameKind::Error => String::new(),
            _ => frame.id.to_string(),
        };
        let _ = write!(line, "{id:>8} ");
        left(line, decoded.role.word(), 4);
        line.push(' ');
        let (from, to) = match decoded.header {
            None => (String::new(), String::new()),
            Some(header) => {
                let to = if header.broadcast {
                    "all".to_owned()
                } else {
                    with_address(&decoded.destination, header.destination)
                };
                (with_address(&decoded.source, header.source), to)
            }
        };
        right(line, &from, END);
        line.push_str(if decoded.header.is_some() { "→" } else { " " });
        left(line, &to, END);
        line.push(' ');
        left(line, &decoded.service, SERVICE);
        let _ = write!(line, " {:>2} ", frame.len());
        push_hex(line, frame.data(), " ");
        let used = (3 * frame.data().len()).saturating_sub(1);
        line.extend(std::iter::repeat_n(' ', BYTES.saturating_sub(used)));
        let _ = write!(line, "  {}", decoded.text);
        if let Some(CallPart::Response { latency, is_ambiguous, .. }) = part {
            let sign = if is_ambiguous { "≈ " } else { "" };
            let space = if decoded.text.is_empty() { "" } else { "  " };
            let _ = write!(line, "{space}{sign}{:.1} ms", latency.as_secs_f64() * 1e3);
        }
        line.truncate(line.trim_end().len());
        line.push('\n');
    }
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
