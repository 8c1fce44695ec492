//! What candump prints without `-L`: `  can0  02015402   [5]  04 44 45 53 01`.
//!
//! Also with times (`-t a`, `d`, `z`, `A`), directions and FD flags (`-x`), ASCII (`-a`), swapped bytes
//! (`-S`), raw DLCs (`-8`), and in colours (`-c`). Input: a line without its time. Does not know times.

use super::candump::LineFault;
use super::candump_time::{ESCAPE, without_colours};
use super::fields::{first_word, hex_byte, hex_value, number, usual_bytes};
use crate::frame::socketcan::{BIT_RATE_SWITCH, ERROR_FLAG, ERROR_STATE, with_fd_flags};
use crate::frame::{CanId, Frame};
use crate::text::is_printable;

/// Reads a line without its time; returns the interface's name and the frame.
///
/// # Errors
///
/// The line is not what candump prints.
pub(super) fn parse(line: &[u8]) -> Result<(&str, Frame), LineFault> {
    let mut rest = ScreenWords::of(line);
    let interface = std::str::from_utf8(rest.take()).map_err(|_| LineFault::Interface)?;
    if interface.is_empty() || !interface.chars().all(is_printable) {
        return Err(LineFault::Interface);
    }
    let info = extra_info(&mut rest);
    let (id, is_error) = parse_id(rest.take())?;
    let (dlc, is_fd) = parse_length(rest.take())?;
    let len = if is_fd { dlc } else { dlc.min(Frame::MAX_CLASSIC_DATA) };
    let frame = if is_remote(rest) {
        Frame::remote(id, len).with_raw_dlc(dlc as u8)
    } else {
        let mut data = [0; Frame::MAX_DATA];
        let data = &mut data[..len];
        parse_data(rest, data)?;
        match (is_error, is_fd) {
            (true, _) => Frame::error(class_of(id), data),
            (false, true) => with_fd_flags(id, data, info.fd_flags),
            (false, false) => Frame::new(id, data).with_raw_dlc(dlc as u8),
        }
    };
    Ok((interface, if info.is_tx { frame.with_tx() } else { frame }))
}

/// Words that are left of a line.
#[derive(Clone, Copy)]
struct ScreenWords<'a> {
    rest: &'a [u8],
    has_colours: bool,
}

impl<'a> ScreenWords<'a> {
    fn of(line: &'a [u8]) -> Self {
        Self { rest: without_colours(line), has_colours: memchr::memchr(ESCAPE, line).is_some() }
    }

    /// Takes the next word without the colours around it; empty at the end.
    fn take(&mut self) -> &'a [u8] {
        let (word, rest) = first_word(self.rest);
        self.rest = rest;
        if !self.has_colours {
            return word;
        }
        let word = without_colours(word);
        let end = word.iter().position(|&byte| byte == ESCAPE).unwrap_or(word.len());
        &word[..end]
    }
}

/// What `-x` prints.
#[derive(Clone, Copy, Debug, Default)]
struct ExtraInfo {
    is_tx: bool,
    fd_flags: u8,
}

/// Takes `RX B E` behind the interface, if it is there.
fn extra_info(line: &mut ScreenWords<'_>) -> ExtraInfo {
    let mut rest = *line;
    let is_tx = match rest.take() {
        b"TX" => true,
        b"RX" => false,
        _ => return ExtraInfo::default(),
    };
    let flag = |is_set, flag| if is_set { flag } else { 0 };
    let switch = flag(rest.take() == b"B", BIT_RATE_SWITCH);
    let state = flag(rest.take() == b"E", ERROR_STATE);
    *line = rest;
    ExtraInfo { is_tx, fd_flags: switch | state }
}

fn class_of(id: CanId) -> u32 {
    match id {
        CanId::Standard(id) => u32::from(id),
        CanId::Extended(id) => id,
    }
}

/// Returns an identifier of 3 or 8 digits, and true if it is the class of an error frame.
fn parse_id(digits: &[u8]) -> Result<(CanId, bool), LineFault> {
    let value = number(digits, 16).filter(|_| matches!(digits.len(), 3 | 8));
    let value = value.ok_or(LineFault::Id)?;
    let is_error = digits.len() == 8 && value & !CanId::MAX_EXTENDED == ERROR_FLAG;
    let id = match digits.len() {
        3 => CanId::standard(value),
        _ if is_error => CanId::extended(value & CanId::MAX_EXTENDED),
        _ => CanId::extended(value),
    };
    Ok((id.ok_or(LineFault::Id)?, is_error))
}

/// Reads `[8]`, of FD frames `[08]`, of raw DLCs `{F}`, of CAN XL `[0008]`; returns the length or the
/// raw DLC, and true for FD.
fn parse_length(word: &[u8]) -> Result<(usize, bool), LineFault> {
    if let [b'{', digit, b'}'] = word {
        let dlc = hex_value(*digit).ok_or(LineFault::Length)?;
        return Ok((usize::from(dlc), false));
    }
    let digits = word.strip_prefix(b"[").and_then(|it| it.strip_suffix(b"]"));
    let digits = digits.ok_or(LineFault::Frame)?;
    let len = number(digits, 10).ok_or(LineFault::Length)? as usize;
    match digits.len() {
        1 if len <= Frame::MAX_CLASSIC_DATA => Ok((len, false)),
        2 if len <= Frame::MAX_DATA => Ok((len, true)),
        4 => Err(LineFault::Xl),
        _ => Err(LineFault::Length),
    }
}

fn is_remote(mut rest: ScreenWords<'_>) -> bool {
    rest.take() == b"remote" && rest.take() == b"request"
}

/// Reads as many bytes as `data` has. What follows them is not read.
fn parse_data(mut line: ScreenWords<'_>, data: &mut [u8]) -> Result<(), LineFault> {
    let byte = |word: &[u8]| match word {
        [high, low] => hex_byte([*high, *low]),
        _ => None,
    };
    let (usual, rest) = usual_bytes(line.rest.trim_ascii_start(), b' ', data);
    // Swapped bytes: the last one first, with marks between them.
    let first = line.take();
    if usual == 0 && first.contains(&b'`') {
        let mut bytes = first.split(|&mark| mark == b'`');
        for place in data.iter_mut().rev() {
            *place = bytes.next().and_then(byte).ok_or(LineFault::Data)?;
        }
        return Ok(());
    }
    line.rest = rest;
    for place in &mut data[usual..] {
        *place = byte(line.take()).ok_or(LineFault::Data)?;
    }
    Ok(())
}
