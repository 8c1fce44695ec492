//! candump's log text (can-utils): `(1436509052.249713) can0 02015402#0444455301`.
//!
//! Reads the output of can-utils, python-can and SavvyCAN. A malformed line is a [`LineFault`].
//! Does not know moments or bus numbers: [`super::LogSummary`] assigns them.

use super::candump_time::{self, CandumpTimes, PrintedTime};
use super::dates::{IsoDates, LocalDate};
use super::fields::{hex_value, words};
use super::local_clock::LocalClock;
use super::text::BYTE_ORDER_MARK;
use super::{LogEncoder, LogEntry, LogLoss, LogTime, candump_screen};
use crate::frame::socketcan::{ERROR_FLAG, with_fd_flags};
use crate::frame::{CanId, Frame};
use crate::text::is_printable;
use crate::time::Epoch;
use std::fmt;
use std::io::{self, Write};

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
    /// A date and a time of day that do not exist, or are before 1970 or after 9999.
    #[error("the date does not exist, or is before 1970")]
    Date,
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

/// Reads one line of the log text, with or without its line end; `None` for a blank line.
///
/// # Errors
///
/// The line is not candump's log text.
pub fn parse_line(line: &[u8]) -> Result<Option<LogEntry<'_>>, LineFault> {
    if line.len() > MAX_LINE {
        return Err(LineFault::TooLong);
    }
    if line.trim_ascii().is_empty() {
        return Ok(None);
    }
    let fault = || if candump_time::has_date(line) { LineFault::Date } else { LineFault::Time };
    let (time, rest) = candump_time::split(line, &mut IsoDates::default()).ok_or_else(fault)?;
    let (PrintedTime::Unix(time)
    | PrintedTime::Short(time)
    | PrintedTime::Local(LocalDate { first: time, .. })) = time;
    Ok(Some(LogEntry { time, ..parse_rest(rest)? }))
}

/// Reads what follows the time of a line of the log text.
fn parse_rest(line: &[u8]) -> Result<LogEntry<'_>, LineFault> {
    if line.len() > MAX_LINE {
        return Err(LineFault::TooLong);
    }
    let mut words = words(line);
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
    Ok(LogEntry { time: LogTime::default(), interface, frame })
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
    let time = LogTime::from_micros(epoch.unix_micros(frame.time));
    writeln!(out, "{}", LogEntry { time, interface, frame: *frame })
}

/// Formats a line of candump's log text. White space and control characters in the interface's name
/// become `_`; without a name the line has `bus` and the bus number.
impl fmt::Display for LogEntry<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (seconds, fraction) = (self.time.micros / 1_000_000, self.time.micros % 1_000_000);
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

/// What the lines so far say about those that follow.
#[derive(Clone, Copy, Debug)]
pub(super) struct CandumpLines {
    times: CandumpTimes,
    dates: IsoDates,
    /// A line before was of what candump prints without `-L`.
    is_screen: bool,
}

impl CandumpLines {
    /// Returns what the first bytes of a log say.
    pub fn of_head(head: &[u8]) -> Self {
        Self {
            times: CandumpTimes::of(lines_of_head(head).filter_map(time_of_line)),
            dates: IsoDates::default(),
            is_screen: false,
        }
    }

    /// Returns true if the lines are the usual ones of the log text.
    pub fn is_usual(&self) -> bool {
        self.times.is_fixed() && !self.is_screen
    }

    /// Returns true if the times do not count from lines before.
    pub fn has_fixed_times(&self) -> bool {
        self.times.is_fixed()
    }

    /// What the lines say about local dates.
    pub fn clock(&self) -> &LocalClock {
        self.times.clock()
    }

    /// Returns true if the lines have no times.
    pub fn is_timeless(&self) -> bool {
        self.is_screen && self.times.is_empty()
    }

    /// Reads a line of the log text, or of what candump prints without `-L`; `None` for one without a
    /// frame.
    pub fn read<'a>(&mut self, line: &'a [u8]) -> Result<Option<LogEntry<'a>>, LineFault> {
        if line.len() > MAX_LINE {
            return Err(LineFault::TooLong);
        }
        // The words of an error frame are below it.
        if line.trim_ascii().is_empty() || line.starts_with(b"\t") && self.is_screen {
            return Ok(None);
        }
        let (time, rest) = match candump_time::split(line, &mut self.dates) {
            Some((time, rest)) => (Some(time), rest),
            None if candump_time::has_date(line) => return Err(LineFault::Date),
            None if self.times.is_empty() => (None, line),
            None => return Err(LineFault::Time),
        };
        let entry = match candump_screen::parse(rest) {
            Ok((interface, frame)) => {
                self.is_screen = true;
                LogEntry { time: LogTime::default(), interface, frame }
            }
            Err(fault) if self.is_screen => return Err(fault),
            Err(_) if time.is_none() => return Err(LineFault::Time),
            Err(_) => parse_rest(rest)?,
        };
        let time = time.map_or(LogTime::default(), |time| self.times.since_origin(time));
        Ok(Some(LogEntry { time, ..entry }))
    }
}

/// Returns the whole lines of the first bytes of a log, without blank lines and the words of an error frame.
fn lines_of_head(head: &[u8]) -> impl Iterator<Item = &[u8]> {
    let head = head.strip_prefix(BYTE_ORDER_MARK).unwrap_or(head);
    let whole = head.split_inclusive(|&byte| byte == b'\n').filter(|line| line.ends_with(b"\n"));
    whole.filter(|line| !line.trim_ascii().is_empty() && !line.starts_with(b"\t"))
}

/// Returns the time of a line; `None` of one without.
fn time_of_line(line: &[u8]) -> Option<PrintedTime> {
    candump_time::split(line, &mut IsoDates::default()).map(|(time, _)| time)
}

/// Beginnings of lines that may be before the first frame: of a comment, of `script`, and of candump where
/// frames were lost.
const PREFACES: [&[u8]; 3] = [b"#", b"Script started", b"DROPCOUNT"];

/// Returns true for a line that is none of a frame, and may be before the first one.
fn is_preface(line: &[u8]) -> bool {
    let is_command = || memchr::memmem::find(line, b"candump ").is_some();
    line.trim_ascii().is_empty()
        || PREFACES.iter().any(|preface| line.starts_with(preface))
        || time_of_line(line).is_none() && is_command()
}

/// Returns what follows the whole lines without a frame with which a log may begin.
fn behind_preface(mut head: &[u8]) -> &[u8] {
    while let Some(end) = memchr::memchr(b'\n', head).filter(|end| is_preface(&head[..*end])) {
        head = &head[end + 1..];
    }
    head
}

/// Returns true if a log that begins with `head` has short times, and more lines are needed to know from
/// where they count.
pub(super) fn has_undecided_times(head: &[u8]) -> bool {
    /// Bytes in which the lines are looked for.
    const MAX_HEAD: usize = 4096;
    let is_short = |(at, byte): (usize, &u8)| match at {
        0 => *byte == b'(',
        1 => *byte == b'0',
        2 | 3 => byte.is_ascii_digit(),
        _ => *byte == b'.',
    };
    if BYTE_ORDER_MARK.starts_with(head) {
        return true;
    }
    if head.len() >= MAX_HEAD {
        return false;
    }
    let head = behind_preface(head.strip_prefix(BYTE_ORDER_MARK).unwrap_or(head));
    let first = candump_time::without_colours(head);
    // A line without a time may be one that is passed over: that is seen when it is whole.
    let is_cut = !first.starts_with(b"(") && !head.contains(&b'\n');
    if first.is_empty() || is_cut {
        return true;
    }
    if !first.iter().take(5).enumerate().all(is_short) {
        return false;
    }
    // It is looked at again with each line.
    if !head.ends_with(b"\n") {
        return true;
    }
    let is_read = |line: &[u8]| time_of_line(line).is_some() || is_preface(line);
    let times = lines_of_head(head).filter_map(time_of_line);
    lines_of_head(head).all(is_read) && CandumpTimes::of_lines(times).is_undecided()
}

/// Writes the log text, with the six digits of a fraction that canplayer reads.
#[derive(Debug, Default)]
pub(super) struct LineEncoder {
    loss: LogLoss,
}

impl LogEncoder for LineEncoder {
    fn begin(&mut self, _: &mut Vec<u8>) -> io::Result<()> {
        Ok(())
    }

    fn write(&mut self, entry: LogEntry<'_>, max_len: u64, out: &mut Vec<u8>) -> io::Result<bool> {
        let before = out.len();
        writeln!(out, "{entry}")?;
        self.loss.finer_times += u64::from(entry.time.nanos > 0);
        let fits = (out.len() - before) as u64 <= max_len;
        if !fits {
            out.truncate(before);
        }
        Ok(fits)
    }

    fn end(&mut self, _: &[String], _: &[u64], _: &mut Vec<u8>) -> io::Result<()> {
        Ok(())
    }

    fn loss(&self) -> LogLoss {
        self.loss.clone()
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
            let raw_dlc = parse_raw_dlc(rest, len)?;
            Ok(match head {
                Head::Id(id) => Frame::new(id, &data[..len]).with_raw_dlc(raw_dlc),
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
    Ok(Frame::remote(id, len).with_raw_dlc(parse_raw_dlc(rest, len)?))
}

/// Reads a raw DLC: `_9` to `_F` after eight bytes, which also mean a length of 8; 0 without one.
fn parse_raw_dlc(rest: &[u8], len: usize) -> Result<u8, LineFault> {
    match rest {
        [] => Ok(0),
        [b'_', digit] if len == Frame::MAX_CLASSIC_DATA => {
            hex_value(*digit).filter(|dlc| *dlc > 8).ok_or(LineFault::Length)
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
