//! Fields of text logs: words, numbers and times in ASCII, and the bytes of written ones.
//!
//! Pure. Does not know formats.

use super::candump::MAX_LINE;
use crate::frame::socketcan::with_fd_flags;
use crate::frame::{CanId, Frame};
use crate::text::hex;
use std::io::{self, Write};

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
    /// The date of an entry cannot be read.
    #[error("the date cannot be read")]
    Date,
    /// The date from which times count cannot be read.
    #[error("the date cannot be read; times count from the date before it, or from 1970")]
    StartDate,
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
    /// A request to send a frame, which is counted: it was not on the bus.
    #[error("a transmit request, which was not on the bus")]
    TransmitRequest,
    /// A type of entry that the format does not have.
    #[error("unknown type of entry")]
    Kind,
}

/// Writes bytes as hexadecimal digits, with a blank before each.
pub(super) fn write_bytes(out: &mut Vec<u8>, data: &[u8]) -> io::Result<()> {
    if data.is_empty() { Ok(()) } else { write!(out, " {}", hex(data, " ")) }
}

/// Words of a line, separated by blanks.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> + Clone {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// The first word of a line and what follows it; both empty at the end.
#[inline]
pub(super) fn first_word(line: &[u8]) -> (&[u8], &[u8]) {
    // Most bytes are above the blanks.
    let is_blank = |byte: &u8| *byte <= b' ' && byte.is_ascii_whitespace();
    let start = line.iter().position(|byte| !is_blank(byte)).unwrap_or(line.len());
    let line = &line[start..];
    line.split_at(line.iter().position(is_blank).unwrap_or(line.len()))
}

/// Value of a character that is not a hexadecimal digit.
pub(super) const NO_DIGIT: u8 = 0xF0;

/// Values of the hexadecimal digits; [`NO_DIGIT`] of any other character.
pub(super) static HEX_VALUES: [u8; 256] = {
    let mut values = [NO_DIGIT; 256];
    let mut digit = 0;
    while digit < 16 {
        values[b"0123456789ABCDEF"[digit] as usize] = digit as u8;
        values[b"0123456789abcdef"[digit] as usize] = digit as u8;
        digit += 1;
    }
    values
};

/// The value of a hexadecimal digit.
#[inline]
pub(super) fn hex_value(digit: u8) -> Option<u8> {
    Some(HEX_VALUES[usize::from(digit)]).filter(|value| *value != NO_DIGIT)
}

/// The value of two hexadecimal digits.
#[inline]
pub(super) fn hex_byte(word: [u8; 2]) -> Option<u8> {
    let (high, low) = (HEX_VALUES[usize::from(word[0])], HEX_VALUES[usize::from(word[1])]);
    ((high | low) & NO_DIGIT == 0).then_some(high << 4 | low)
}

/// Returns the number of eight decimal digits, all of them at once: pairs, then fours, then eight.
#[inline]
pub(super) fn eight_digits(text: [u8; 8]) -> Option<u64> {
    let digits = u64::from_le_bytes(text) ^ 0x3030_3030_3030_3030;
    // Of a digit above 9, or any other character, the upper half is not 0.
    if (digits | digits.wrapping_add(0x0606_0606_0606_0606)) & 0xF0F0_F0F0_F0F0_F0F0 != 0 {
        return None;
    }
    let pairs = (digits * 10 + (digits >> 8)) & 0x00FF_00FF_00FF_00FF;
    let fours = (pairs * 100 + (pairs >> 16)) & 0x0000_FFFF_0000_FFFF;
    Some((fours * 10_000 + (fours >> 32)) & 0xFFFF_FFFF)
}

/// Returns the bytes of eight hexadecimal digits, all of them at once.
#[inline]
pub(super) fn four_bytes(text: [u8; 8]) -> Option<[u8; 4]> {
    const ALL: u64 = 0x0101_0101_0101_0101;
    let digits = u64::from_le_bytes(text);
    let is_letter = digits >> 6 & ALL;
    // Bits of the upper half; set for a character that is not a decimal digit, or not a letter from A to F.
    let decimal = digits ^ (ALL * 0x30);
    let no_decimal = (decimal | decimal.wrapping_add(ALL * 6)) & (ALL * 0xF0);
    let letter = digits & (ALL * 0xDF) ^ (ALL * 0x40);
    let above = (letter | letter.wrapping_add(ALL * 9)) & (ALL * 0xF0);
    let is_zero = !letter.wrapping_add(ALL * 0x0F) & (ALL * 0x10);
    let letters = is_letter * 0xFF;
    if no_decimal & !letters | (above | is_zero) & letters != 0 {
        return None;
    }
    let halves = (digits & (ALL * 0x0F)) + is_letter * 9;
    let bytes = (halves << 4 | halves >> 8) & 0x00FF_00FF_00FF_00FF;
    let pairs = (bytes | bytes >> 8) & 0x0000_FFFF_0000_FFFF;
    Some(((pairs | pairs >> 16) as u32).to_le_bytes())
}

/// Returns the number of these digits in base 10 or 16; `None` without digits, or above 2³² − 1.
pub(super) fn number(digits: &[u8], base: u32) -> Option<u32> {
    if base == 16
        && let Ok(digits) = digits.try_into()
    {
        return four_bytes(digits).map(u32::from_be_bytes);
    }
    if digits.is_empty() {
        return None;
    }
    digits.iter().try_fold(0_u32, |number, &digit| {
        let value = u32::from(HEX_VALUES[usize::from(digit)]);
        if value >= base { None } else { number.checked_mul(base)?.checked_add(value) }
    })
}

/// Returns the decimal number of these digits; `None` without digits, or above 2⁶⁴ − 1.
pub(super) fn decimal(digits: &[u8]) -> Option<u64> {
    if digits.is_empty() {
        return None;
    }
    let (eights, rest) = digits.as_chunks();
    let eights = eights.iter().try_fold(0_u64, |number, eight| {
        number.checked_mul(100_000_000)?.checked_add(eight_digits(*eight)?)
    })?;
    rest.iter().try_fold(eights, |number, digit| {
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
    let digit = |place| fraction.get(place).map_or(0, |digit| u64::from(digit - b'0'));
    let fraction = (0..P).fold(0, |number, place| number * 10 + digit(place));
    decimal(whole)?.checked_mul(const { 10_u64.pow(P as u32) })?.checked_add(fraction)
}

/// Reads `len` bytes of words in base 10 or 16 into `data`; returns what follows them.
pub(super) fn bytes<'a>(
    mut line: &'a [u8],
    base: u32,
    data: &mut [u8],
) -> Result<&'a [u8], FieldFault> {
    let mut usual = 0;
    if base == 16 {
        (usual, line) = usual_bytes(line.trim_ascii_start(), b' ', data);
    }
    for byte in &mut data[usual..] {
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

/// Reads bytes of two hexadecimal digits with one separator between them, up to text of another form; returns
/// their number, and what follows them.
#[inline]
pub(super) fn usual_bytes<'a>(line: &'a [u8], separator: u8, data: &mut [u8]) -> (usize, &'a [u8]) {
    let (mut count, mut rest) = (0, line);
    for byte in data {
        let [high, low, after @ ..] = rest else { break };
        let after = match after {
            [] => after,
            [byte, after @ ..] if *byte == separator => after,
            _ => break,
        };
        let Some(value) = hex_byte([*high, *low]) else { break };
        *byte = value;
        (count, rest) = (count + 1, after);
    }
    (count, rest)
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

/// Returns the frame with a DLC of the log, which matters where it is a raw one above 8.
pub(super) fn with_dlc(frame: Frame, dlc: u32) -> Frame {
    frame.with_raw_dlc(u8::try_from(dlc).unwrap_or(0))
}

/// Checks the length of a line.
pub(super) fn check_line(line: &[u8]) -> Result<(), FieldFault> {
    if line.len() > MAX_LINE { Err(FieldFault::TooLong) } else { Ok(()) }
}

/// Returns true if `text` begins with `start`, in capitals or not.
pub(super) fn starts_with_ignoring_case(text: &[u8], start: &[u8]) -> bool {
    text.get(..start.len()).is_some_and(|head| head.eq_ignore_ascii_case(start))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_bytes_are_those_of_eight_digits() {
        for byte in 0..=u8::MAX {
            for at in 0..8 {
                let mut text = *b"0aB9fF71";
                text[at] = byte;
                let expected = std::str::from_utf8(&text).ok().filter(|it| !it.contains('+'));
                let expected = expected.and_then(|it| u32::from_str_radix(it, 16).ok());
                assert_eq!(four_bytes(text), expected.map(u32::to_be_bytes), "{byte:#x} at {at}");
            }
        }
    }

    #[test]
    fn numbers_are_those_of_the_standard_library() {
        let mut rng = fastrand::Rng::with_seed(3);
        for round in 0..100_000 {
            let len = rng.usize(0..=24);
            let mut text: Vec<u8> = (0..len).map(|_| rng.u8(b'0'..=b'9')).collect();
            if len > 0 && round % 3 == 0 {
                text[rng.usize(0..len)] = rng.u8(0x20..=0x7E);
            }
            let known = str::from_utf8(&text).unwrap();
            let known = (!known.contains('+')).then_some(known);
            assert_eq!(decimal(&text), known.and_then(|it| it.parse().ok()), "{known:?}");
            let hex = known.and_then(|it| u32::from_str_radix(it, 16).ok());
            assert_eq!(number(&text, 16), hex, "{known:?}");
            assert_eq!(number(&text, 10), known.and_then(|it| it.parse().ok()), "{known:?}");
        }
    }
}
