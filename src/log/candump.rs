//! candump's log text (can-utils): `(1436509052.249713) can0 02015402#0444455301`.
//!
//! Reads the output of can-utils, python-can and SavvyCAN. A malformed line is a [`LineFault`];
//! a line that is passed as a whole is read without allocation. Does not know moments or bus
//! numbers: [`super::LogSummary`] assigns them.

use super::{
    Damage, DecodeStep, ForeignFormat, FormatMatch, LogDecoder, LogEncoder, LogEntry, LogFormat,
    LogSummary, MAX_WITHOUT_FRAME, plain_line,
};
use crate::frame::socketcan::{ERROR_FLAG, with_fd_flags};
use crate::frame::{CanId, Frame};
use crate::text::is_printable;
use crate::time::Epoch;
use std::fmt;
use std::io::{self, Write};

pub(super) const FORMAT: LogFormat = LogFormat {
    description: "candump text",
    extensions: &["log", "txt", "candump"],
    unit: "line",
    // Text has no magic number: it is the format if no other matches.
    detect: |_| FormatMatch::No,
    decoder: || Box::<LineDecoder>::default(),
    encoder: || Box::new(LineEncoder),
};

/// Byte order mark, with which some editors begin a file.
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

/// Longest line in bytes; longer ones are not read. A line with an FD frame has at most some 250.
pub const MAX_LINE: usize = 512;

/// Why a line cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum LineFault {
    /// Longer than [`MAX_LINE`].
    #[error("the line is too long")]
    TooLong,
    /// No time in parentheses at the start.
    #[error("it does not begin with (SECONDS.FRACTION)")]
    Time,
    /// No printable interface name after the time.
    #[error("no interface name after the time")]
    Interface,
    /// No `ID#…` after the interface.
    #[error("no frame (ID#DATA) after the interface")]
    Frame,
    /// Not 3 or 8 hexadecimal digits, or too large.
    #[error("the identifier is not 3 or 8 hexadecimal digits in range")]
    Id,
    /// An invalid digit, half a byte, or text after the data.
    #[error("the data is not whole hexadecimal bytes")]
    Data,
    /// More bytes than the format allows.
    #[error("more data than the frame can carry")]
    TooMuchData,
    /// The length of a remote frame or a raw DLC is out of range.
    #[error("invalid length or DLC")]
    Length,
    /// A CAN XL frame.
    #[error("a CAN XL frame")]
    Xl,
    /// Text after the frame other than R or T.
    #[error("text after the frame (only R or T allowed)")]
    Trailing,
}

/// Reads one line, with or without its line end; `None` for a blank line.
///
/// # Errors
///
/// The line is not candump's log text.
pub fn parse_line(line: &[u8]) -> Result<Option<LogEntry<'_>>, LineFault> {
    if line.len() > MAX_LINE {
        return Err(LineFault::TooLong);
    }
    let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
    let Some(time) = words.next() else { return Ok(None) };
    let unix_micros = parse_time(time).ok_or(LineFault::Time)?;
    let interface = words.next().ok_or(LineFault::Interface)?;
    let interface = std::str::from_utf8(interface).map_err(|_| LineFault::Interface)?;
    // The name is displayed: it must not contain control sequences.
    if !interface.chars().all(is_printable) {
        return Err(LineFault::Interface);
    }
    let mut frame = parse_frame(words.next().ok_or(LineFault::Frame)?)?;
    match words.next() {
        None | Some(b"R") => {}
        Some(b"T") => frame.is_tx = true,
        Some(_) => return Err(LineFault::Trailing),
    }
    if words.next().is_some() {
        return Err(LineFault::Trailing);
    }
    Ok(Some(LogEntry { unix_micros, interface, frame }))
}

/// Writes one line, dated by `epoch` and the frame's time. The line of a frame sent by descan ends
/// in ` T`.
///
/// # Errors
///
/// Those of `out`.
pub fn write_line(
    out: &mut impl Write,
    epoch: Epoch,
    interface: &str,
    frame: &Frame,
) -> io::Result<()> {
    let unix_micros = epoch.unix_micros(frame.time);
    writeln!(out, "{}", LogEntry { unix_micros, interface, frame: *frame })
}

/// Formats a line of candump's log text. White space and control characters in the interface's name
/// become `_`; without a name the line has `bus` and the bus number.
impl fmt::Display for LogEntry<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (seconds, fraction) = (self.unix_micros / 1_000_000, self.unix_micros % 1_000_000);
        write!(f, "({seconds:010}.{fraction:06}) ")?;
        let is_odd = |c: char| c.is_whitespace() || !is_printable(c);
        match self.interface {
            "" => write!(f, "bus{}", self.frame.bus.0)?,
            name if name.contains(is_odd) => f.write_str(&name.replace(is_odd, "_"))?,
            name => f.write_str(name)?,
        }
        write!(f, " {}{}", self.frame, if self.frame.is_tx { " T" } else { "" })
    }
}

/// Splits text into lines and reads them.
#[derive(Clone, Debug, Default)]
struct LineDecoder {
    /// A line cut by the end of a piece; at most one byte longer than [`MAX_LINE`].
    partial: Vec<u8>,
    /// Bytes of a line that is too long and counted as unreadable; 0 in any other line.
    skipped: u64,
    /// Bytes before the first frame.
    before_frame: u64,
}

impl LineDecoder {
    /// Appends a piece to a cut line, at most up to one byte more than [`MAX_LINE`].
    fn keep(&mut self, piece: &[u8]) {
        let room = (MAX_LINE + 1).saturating_sub(self.partial.len());
        self.partial.extend_from_slice(&piece[..piece.len().min(room)]);
    }

    /// Appends a piece without a line end; a line that is too long counts at once, as it may not end.
    fn keep_cut(&mut self, piece: &[u8], summary: &mut LogSummary) {
        self.keep(piece);
        if self.skipped == 0 && self.partial.len() > MAX_LINE {
            take_line(&self.partial, summary);
            self.skipped = MAX_LINE as u64;
        }
        if self.skipped > 0 {
            self.skipped += piece.len() as u64;
        }
    }

    /// Notes damage if what was read is too much for a log.
    fn check_damage(&mut self, used: usize, summary: &mut LogSummary) {
        if summary.own_frames() == 0 {
            self.before_frame += used as u64;
        }
        let is_inside_line = self.skipped > 0;
        if is_inside_line && self.skipped + used as u64 >= MAX_WITHOUT_FRAME {
            summary.damage = Some(Damage::NoLineEnd);
        } else if !is_inside_line
            && summary.own_frames() == 0
            && self.before_frame >= MAX_WITHOUT_FRAME
        {
            summary.damage = Some(Damage::NoFrame);
        }
    }
}

impl LogDecoder for LineDecoder {
    fn decode(&mut self, bytes: &[u8], summary: &mut LogSummary) -> (usize, DecodeStep) {
        if summary.damage.is_some() {
            return (bytes.len(), DecodeStep::End);
        }
        let end = memchr::memchr(b'\n', bytes);
        self.check_damage(end.map_or(bytes.len(), |end| end + 1), summary);
        if summary.damage.is_some() {
            self.partial.clear();
            self.skipped = 0;
            return (bytes.len(), DecodeStep::End);
        }
        let Some(end) = end else {
            self.keep_cut(bytes, summary);
            let is_over = summary.foreign.is_some();
            return (bytes.len(), if is_over { DecodeStep::End } else { DecodeStep::Nothing });
        };
        let frame = if self.partial.is_empty() {
            take_line(&bytes[..end], summary)
        } else if std::mem::take(&mut self.skipped) > 0 {
            self.partial.clear();
            None
        } else {
            self.keep(&bytes[..end]);
            let frame = take_line(&self.partial, summary);
            self.partial.clear();
            frame
        };
        let step = match frame {
            Some(frame) => DecodeStep::Frame(frame),
            None if summary.foreign.is_some() => DecodeStep::End,
            None => DecodeStep::Nothing,
        };
        (end + 1, step)
    }

    fn decode_frames(
        &mut self,
        bytes: &[u8],
        summary: &mut LogSummary,
        frames: &mut Vec<Frame>,
        most: usize,
    ) -> usize {
        let mut used = 0;
        if !self.partial.is_empty() {
            return used;
        }
        while frames.len() < most
            && let Some(line) = plain_line::parse(&bytes[used..])
            && let Some(frame) = summary.take_plain(line.unix_micros, line.interface, &line.frame)
        {
            frames.push(frame);
            used += line.len;
        }
        used
    }

    fn has_partial_entry(&self) -> bool {
        !self.partial.is_empty()
    }

    fn entry_start(&self, tail: &[u8]) -> Option<usize> {
        memchr::memchr(b'\n', tail).map(|end| end + 1)
    }

    fn copy(&self) -> Box<dyn LogDecoder> {
        Box::new(self.clone())
    }

    fn read_partial_entry(&mut self, summary: &mut LogSummary) -> Option<Frame> {
        if self.partial.is_empty() {
            return None;
        }
        let is_counted = std::mem::take(&mut self.skipped) > 0;
        let frame = if is_counted { None } else { take_line(&self.partial, summary) };
        self.partial.clear();
        frame
    }

    fn can_decode(&self, bytes: &[u8]) -> bool {
        bytes.contains(&b'\n')
    }
}

fn take_line(line: &[u8], summary: &mut LogSummary) -> Option<Frame> {
    let line = line.strip_prefix(BYTE_ORDER_MARK).filter(|_| summary.entries == 0).unwrap_or(line);
    let entry = parse_line(line);
    if entry.is_err() && summary.own_frames() == 0 {
        summary.foreign = ForeignFormat::of_line(line);
    }
    summary.take(entry)
}

#[derive(Debug)]
struct LineEncoder;

impl LogEncoder for LineEncoder {
    fn begin(&mut self, _: &mut Vec<u8>) -> io::Result<()> {
        Ok(())
    }

    fn write(&mut self, entry: LogEntry<'_>, max_len: u64, out: &mut Vec<u8>) -> io::Result<bool> {
        let before = out.len();
        writeln!(out, "{entry}")?;
        let fits = (out.len() - before) as u64 <= max_len;
        if !fits {
            out.truncate(before);
        }
        Ok(fits)
    }

    fn end(&mut self, _: &[String], _: &[u64], _: &mut Vec<u8>) -> io::Result<()> {
        Ok(())
    }
}

/// Reads a frame in the syntax of candump and cansend: `02015402#0444455301`, `123#R4`,
/// `123##1AABB`, `20000004#…`.
///
/// # Errors
///
/// The text does not have this syntax.
pub fn parse_frame(text: &[u8]) -> Result<Frame, LineFault> {
    let hash = text.iter().position(|&byte| byte == b'#').ok_or(LineFault::Frame)?;
    let (id_text, body) = (&text[..hash], &text[hash + 1..]);
    let head = parse_head(id_text)?;
    match (head, body) {
        (Head::Id(id), [b'#', body @ ..]) => parse_fd(id, body),
        (Head::Id(id), [b'R' | b'r', body @ ..]) => parse_remote(id, body),
        _ => {
            let mut data = [0; Frame::MAX_CLASSIC_DATA];
            let (len, rest) = parse_bytes(body, &mut data)?;
            parse_raw_dlc(rest, len)?;
            Ok(match head {
                Head::Id(id) => Frame::new(id, &data[..len]),
                Head::ErrorClass(class) => Frame::error(class, &data[..len]),
            })
        }
    }
}

/// Meaning of the digits before the `#`.
#[derive(Clone, Copy)]
enum Head {
    Id(CanId),
    /// Class bits of an error frame.
    ErrorClass(u32),
}

fn parse_head(text: &[u8]) -> Result<Head, LineFault> {
    if !matches!(text.len(), 3 | 8) {
        return Err(LineFault::Id);
    }
    let number = text.iter().try_fold(0_u32, |number, &digit| {
        hex_value(digit).map(|value| number << 4 | u32::from(value)).ok_or(LineFault::Id)
    })?;
    let head = match text.len() {
        3 => CanId::standard(number).map(Head::Id),
        _ if number & !CanId::MAX_EXTENDED == ERROR_FLAG => {
            Some(Head::ErrorClass(number & CanId::MAX_EXTENDED))
        }
        _ => CanId::extended(number).map(Head::Id),
    };
    head.ok_or(LineFault::Id)
}

/// Reads the body of an FD frame. A length without a DLC is padded with zeros to the next one that
/// has a DLC, as cansend does.
fn parse_fd(id: CanId, body: &[u8]) -> Result<Frame, LineFault> {
    let (&flags, body) = body.split_first().ok_or(LineFault::Data)?;
    let flags = hex_value(flags).ok_or(LineFault::Data)?;
    let mut data = [0; Frame::MAX_DATA];
    let (len, rest) = parse_bytes(body, &mut data)?;
    if !rest.is_empty() {
        return Err(LineFault::Data);
    }
    Ok(with_fd_flags(id, &data[..len], flags))
}

fn parse_remote(id: CanId, body: &[u8]) -> Result<Frame, LineFault> {
    let (len, rest) = match body {
        [digit @ b'0'..=b'8', rest @ ..] => (usize::from(digit - b'0'), rest),
        _ => (0, body),
    };
    parse_raw_dlc(rest, len)?;
    Ok(Frame::remote(id, len))
}

/// Reads a raw DLC: `_9` to `_F` after eight bytes, which also mean a length of 8.
fn parse_raw_dlc(rest: &[u8], len: usize) -> Result<(), LineFault> {
    match rest {
        [] => Ok(()),
        [b'_', digit] if len == Frame::MAX_CLASSIC_DATA => {
            hex_value(*digit).filter(|dlc| *dlc > 8).map(|_| ()).ok_or(LineFault::Length)
        }
        [b'_', ..] => Err(LineFault::Length),
        _ => Err(LineFault::Data),
    }
}

/// Reads hexadecimal bytes, with or without dots between them, up to the end or a `_`. Returns
/// their number and the rest.
fn parse_bytes<'a>(text: &'a [u8], data: &mut [u8]) -> Result<(usize, &'a [u8]), LineFault> {
    let mut rest = text;
    let mut len = 0;
    loop {
        if let [b'.', after @ ..] = rest
            && len > 0
        {
            rest = after;
        }
        let [high, low, after @ ..] = rest else { break };
        if *high == b'_' {
            break;
        }
        let (Some(high), Some(low)) = (hex_value(*high), hex_value(*low)) else {
            return Err(if text.contains(&b':') { LineFault::Xl } else { LineFault::Data });
        };
        *data.get_mut(len).ok_or(LineFault::TooMuchData)? = high << 4 | low;
        len += 1;
        rest = after;
    }
    Ok((len, rest))
}

/// Reads `(SECONDS.FRACTION)` as microseconds; further digits of the fraction are truncated.
fn parse_time(text: &[u8]) -> Option<u64> {
    let text = text.strip_prefix(b"(")?.strip_suffix(b")")?;
    let dot = text.iter().position(|&byte| byte == b'.').unwrap_or(text.len());
    let (seconds, fraction) = (&text[..dot], text.get(dot + 1..).unwrap_or_default());
    if seconds.is_empty() {
        return None;
    }
    let seconds = decimal(seconds)?;
    let mut micros = decimal(&fraction[..fraction.len().min(6)])?;
    if !fraction.iter().all(u8::is_ascii_digit) {
        return None;
    }
    for _ in fraction.len()..6 {
        micros *= 10;
    }
    seconds.checked_mul(1_000_000)?.checked_add(micros)
}

/// Parses decimal digits; without digits, 0.
fn decimal(digits: &[u8]) -> Option<u64> {
    digits.iter().try_fold(0_u64, |number, digit| {
        let value = digit.wrapping_sub(b'0');
        if value > 9 { None } else { number.checked_mul(10)?.checked_add(u64::from(value)) }
    })
}

const fn hex_value(digit: u8) -> Option<u8> {
    match digit {
        b'0'..=b'9' => Some(digit - b'0'),
        b'A'..=b'F' => Some(digit - b'A' + 10),
        b'a'..=b'f' => Some(digit - b'a' + 10),
        _ => None,
    }
}
