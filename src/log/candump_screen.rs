//! What candump prints without `-L`: `  can0  02015402   [5]  04 44 45 53 01`.
//!
//! Also with times (`-t a`, `d`, `z`, `A`), directions and FD flags (`-x`), ASCII (`-a`), swapped bytes
//! (`-S`), raw DLCs (`-8`), and in colours (`-c`). Input: a line without its time. Does not know times.

use super::candump::LineFault;
use super::candump_time::without_colours;
use super::fields::{first_word, hex_byte, hex_value, number, words};
use crate::frame::socketcan::{BIT_RATE_SWITCH, ERROR_FLAG, ERROR_STATE, with_fd_flags};
use crate::frame::{CanId, Frame};
use crate::text::is_printable;

/// Reads a line without its time; returns the interface's name and the frame.
///
/// # Errors
///
/// The line is not what candump prints.
pub(super) fn parse(line: &[u8]) -> Result<(&str, Frame), LineFault> {
    let (interface, rest) = first_word(without_colours(line));
    let interface = std::str::from_utf8(plain(interface)).map_err(|_| LineFault::Interface)?;
    if interface.is_empty() || !interface.chars().all(is_printable) {
        return Err(LineFault::Interface);
    }
    let (info, rest) = extra_info(rest);
    let (id, rest) = first_word(rest);
    let (length, rest) = first_word(rest);
    let (id, is_error) = parse_id(plain(id))?;
    let (len, is_fd) = parse_length(plain(length))?;
    let frame = if is_remote(rest) {
        Frame::remote(id, len)
    } else {
        let mut data = [0; Frame::MAX_DATA];
        let data = &mut data[..len];
        parse_data(rest, data)?;
        match (is_error, is_fd) {
            (true, _) => Frame::error(class_of(id), data),
            (false, true) => with_fd_flags(id, data, info.fd_flags),
            (false, false) => Frame::new(id, data),
        }
    };
    Ok((interface, if info.is_tx { frame.with_tx() } else { frame }))
}

/// What `-x` prints.
#[derive(Clone, Copy, Debug, Default)]
struct ExtraInfo {
    is_tx: bool,
    fd_flags: u8,
}

/// Reads `RX B E` behind the interface, if it is there.
fn extra_info(line: &[u8]) -> (ExtraInfo, &[u8]) {
    let (direction, rest) = first_word(line);
    let is_tx = plain(direction) == b"TX";
    if !is_tx && plain(direction) != b"RX" {
        return (ExtraInfo::default(), line);
    }
    let (switch, rest) = first_word(rest);
    let (state, rest) = first_word(rest);
    let flag = |is_set, flag| if is_set { flag } else { 0 };
    let fd_flags =
        flag(plain(switch) == b"B", BIT_RATE_SWITCH) | flag(plain(state) == b"E", ERROR_STATE);
    (ExtraInfo { is_tx, fd_flags }, rest)
}

/// Returns a word without the colours around it.
fn plain(word: &[u8]) -> &[u8] {
    let word = without_colours(word);
    let end = word.iter().position(|&byte| byte == 0x1B).unwrap_or(word.len());
    &word[..end]
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

/// Reads `[8]`, of FD frames `[08]`, of raw DLCs `{F}`, of CAN XL `[0008]`; returns the length, and true for
/// FD.
fn parse_length(word: &[u8]) -> Result<(usize, bool), LineFault> {
    if let [b'{', digit, b'}'] = word {
        let dlc = hex_value(*digit).ok_or(LineFault::Length)?;
        return Ok((usize::from(dlc).min(Frame::MAX_CLASSIC_DATA), false));
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

fn is_remote(rest: &[u8]) -> bool {
    let mut words = words(rest).map(plain);
    words.next() == Some(b"remote") && words.next() == Some(b"request")
}

/// Reads as many bytes as `data` has. What follows them is not read.
fn parse_data(line: &[u8], data: &mut [u8]) -> Result<(), LineFault> {
    let byte = |word: &[u8]| match word {
        [high, low] => hex_byte([*high, *low]),
        _ => None,
    };
    // Swapped bytes: the last one first, with marks between them.
    if let Some(first) = words(line).next().map(plain).filter(|word| word.contains(&b'`')) {
        let mut bytes = first.split(|&mark| mark == b'`');
        for place in data.iter_mut().rev() {
            *place = bytes.next().and_then(byte).ok_or(LineFault::Data)?;
        }
        return Ok(());
    }
    let mut words = words(line).map(plain);
    for place in data {
        *place = words.next().and_then(byte).ok_or(LineFault::Data)?;
    }
    Ok(())
}
