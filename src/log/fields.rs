//! Fields of text logs: words, numbers and times in ASCII.
//!
//! Pure. Does not know formats.

use super::candump::MAX_LINE;
use crate::frame::socketcan::with_fd_flags;
use crate::frame::{CanId, Frame};

/// Why a line of a text log that is not candump's cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum FieldFault {
    /// The line is longer than [`MAX_LINE`].
    #[error("the line is too long")]
    TooLong,
    /// The line is neither a comment nor an event with a time.
    #[error("it does not begin with a time")]
    Time,
    /// The time is before 1970, or above 2⁶⁴ − 1 µs since then.
    #[error("the time is before 1970, or too large")]
    TimeRange,
    /// The date of the beginning cannot be read.
    #[error("the date cannot be read")]
    Date,
    /// No number of a channel from 0 to 255.
    #[error("no channel number from 0 to 255")]
    Channel,
    /// No identifier, or one that is too large.
    #[error("the identifier is not a number in range")]
    Id,
    /// No length, or one that a frame cannot have.
    #[error("the length is not that of a frame")]
    Length,
    /// Fewer bytes than the length says, or text that is not a byte.
    #[error("the data is not as many bytes as the length says")]
    Data,
    /// A value is missing, or another one than the column allows.
    #[error("a column is missing or has another value than the format allows")]
    Column,
    /// A type of entry that the format does not have.
    #[error("unknown type of entry")]
    Kind,
}

/// Words of a line, separated by blanks.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> + Clone {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// The first word of a line and what follows it; both empty at the end.
pub(super) fn first_word(line: &[u8]) -> (&[u8], &[u8]) {
    let line = line.trim_ascii_start();
    let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
    line.split_at(end)
}

/// The value of a hexadecimal digit.
pub(super) const fn hex_value(digit: u8) -> Option<u8> {
    match digit {
        b'0'..=b'9' => Some(digit - b'0'),
        b'A'..=b'F' => Some(digit - b'A' + 10),
        b'a'..=b'f' => Some(digit - b'a' + 10),
        _ => None,
    }
}

/// The value of two hexadecimal digits.
pub(super) fn hex_byte(word: [u8; 2]) -> Option<u8> {
    let [high, low] = word;
    Some(hex_value(high)? << 4 | hex_value(low)?)
}

/// Returns the number of these digits in base 10 or 16; `None` without digits, or above 2³² − 1.
pub(super) fn number(digits: &[u8], base: u32) -> Option<u32> {
    if digits.is_empty() {
        return None;
    }
    digits.iter().try_fold(0_u32, |number, &digit| {
        let value = u32::from(hex_value(digit)?);
        if value >= base { None } else { number.checked_mul(base)?.checked_add(value) }
    })
}

/// Returns the decimal number of these digits; `None` without digits, or above 2⁶⁴ − 1.
pub(super) fn decimal(digits: &[u8]) -> Option<u64> {
    if digits.is_empty() {
        return None;
    }
    digits.iter().try_fold(0_u64, |number, digit| {
        let value = digit.wrapping_sub(b'0');
        if value > 9 { None } else { number.checked_mul(10)?.checked_add(u64::from(value)) }
    })
}

/// Returns a decimal fraction, such as `2.5`, in units of 10⁻ᴾ; further digits are cut off. `None` if the
/// text is not a number, or too large. The point may be a comma.
pub(super) fn fixed_point<const P: usize>(text: &[u8]) -> Option<u64> {
    let point = text.iter().position(|byte| matches!(byte, b'.' | b','));
    let (whole, fraction) = match point {
        Some(point) => (&text[..point], &text[point + 1..]),
        None => (text, &[][..]),
    };
    if !fraction.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let mut value = decimal(whole)?;
    for place in 0..P {
        let digit = fraction.get(place).map_or(0, |digit| digit - b'0');
        value = value.checked_mul(10)?.checked_add(u64::from(digit))?;
    }
    Some(value)
}

/// Reads `len` bytes of words in base 10 or 16 into `data`; returns what follows them.
pub(super) fn bytes<'a>(
    mut line: &'a [u8],
    base: u32,
    data: &mut [u8],
) -> Result<&'a [u8], FieldFault> {
    for byte in data {
        // The usual form.
        if let [high, low, b' ', rest @ ..] = line.trim_ascii_start()
            && base == 16
            && let Some(value) = hex_byte([*high, *low])
        {
            *byte = value;
            line = rest;
            continue;
        }
        let (word, rest) = first_word(line);
        let value = match (base, word) {
            (16, [high, low]) => hex_byte([*high, *low]),
            _ => number(word, base).and_then(|value| u8::try_from(value).ok()),
        };
        *byte = value.ok_or(FieldFault::Data)?;
        line = rest;
    }
    Ok(line)
}

/// Returns the number of a channel, 0 to 255.
pub(super) fn channel(word: &[u8]) -> Result<u8, FieldFault> {
    decimal(word).and_then(|number| u8::try_from(number).ok()).ok_or(FieldFault::Channel)
}

/// Returns an identifier in range.
pub(super) fn can_id(number: Option<u32>, is_extended: bool) -> Result<CanId, FieldFault> {
    let number = number.ok_or(FieldFault::Id)?;
    let id = if is_extended { CanId::extended(number) } else { CanId::standard(number) };
    id.ok_or(FieldFault::Id)
}

/// Returns a data frame, in FD format with `fd_flags`.
pub(super) fn data_frame(
    id: CanId,
    data: &[u8],
    fd_flags: Option<u8>,
) -> Result<Frame, FieldFault> {
    match fd_flags {
        Some(flags) if data.len() <= Frame::MAX_DATA => Ok(with_fd_flags(id, data, flags)),
        None if data.len() <= Frame::MAX_CLASSIC_DATA => Ok(Frame::new(id, data)),
        _ => Err(FieldFault::Length),
    }
}

/// Returns the number of data bytes of a DLC; 8 of the DLCs above 8 in a classic frame.
pub(super) fn len_of_dlc(dlc: u32, is_fd: bool) -> Result<usize, FieldFault> {
    const FD: [usize; 7] = [12, 16, 20, 24, 32, 48, 64];
    match dlc {
        0..=8 => Ok(dlc as usize),
        9..=15 if is_fd => Ok(FD[dlc as usize - 9]),
        9..=15 => Ok(Frame::MAX_CLASSIC_DATA),
        _ => Err(FieldFault::Length),
    }
}

/// Checks the length of a line.
pub(super) fn check_line(line: &[u8]) -> Result<(), FieldFault> {
    if line.len() > MAX_LINE { Err(FieldFault::TooLong) } else { Ok(()) }
}

/// Returns true if `text` begins with `start`, in capitals or not.
pub(super) fn starts_with_ignoring_case(text: &[u8], start: &[u8]) -> bool {
    text.get(..start.len()).is_some_and(|head| head.eq_ignore_ascii_case(start))
}
