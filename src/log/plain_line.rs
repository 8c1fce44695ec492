//! The usual line of candump's log text, `(1436509052.249713) can0 02015402#0444455301`, in one pass.
//!
//! Input: text that begins with a line. Output: the line's frame and length; nothing for any other
//! line, which [`super::candump::parse_line`] reads. What both read, they read alike.
//! Does not know moments or bus numbers.

use super::LogTime;
use super::candump::MAX_LINE;
use crate::frame::{CanId, Frame};

/// Bytes of a time with ten digits of seconds and six of the fraction, without the parenthesis behind it.
const TIME: usize = 18;
/// Marks what is no hexadecimal digit.
const NO_DIGIT: u8 = 0xF0;

/// Values of the hexadecimal digits.
static DIGITS: [u8; 256] = {
    let mut values = [NO_DIGIT; 256];
    let mut digit = 0;
    while digit < 16 {
        values[b"0123456789ABCDEF"[digit] as usize] = digit as u8;
        values[b"0123456789abcdef"[digit] as usize] = digit as u8;
        digit += 1;
    }
    values
};

/// A classic data frame on a line, with its interface.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlainLine<'a> {
    pub time: LogTime,
    /// Printable ASCII without a blank; not empty.
    pub interface: &'a [u8],
    pub frame: Frame,
    /// Bytes of the line with its end.
    pub len: usize,
}

/// Reads the line that `text` begins with; `None` if it has another form, or no end.
#[inline]
pub(super) fn parse(text: &[u8]) -> Option<PlainLine<'_>> {
    let (time, rest) = time(text)?;
    let name = rest.iter().position(|byte| !(0x21..=0x7E).contains(byte))?;
    if name == 0 || rest[name] != b' ' {
        return None;
    }
    let (interface, rest) = (&rest[..name], &rest[name + 1..]);
    let (id, rest) = id(rest)?;
    let (data, len, rest) = data(rest)?;
    let mut frame = Frame::of_eight_bytes(id, data, len);
    let rest = match rest {
        [b' ', b'T', rest @ ..] => {
            frame.is_tx = true;
            rest
        }
        [b' ', b'R', rest @ ..] | rest => rest,
    };
    let rest = rest.strip_prefix(b"\r").unwrap_or(rest).strip_prefix(b"\n")?;
    let len = text.len() - rest.len();
    // The line end does not count.
    (len <= MAX_LINE).then_some(PlainLine { time, interface, frame, len })
}

/// Reads `(1436509052.249713) `, or a fraction of nine digits; returns what follows it, too.
#[inline]
fn time(text: &[u8]) -> Option<(LogTime, &[u8])> {
    let (time, rest) = text.split_first_chunk::<TIME>()?;
    let [b'(', s1, s2, s3, s4, s5, s6, s7, s8, s9, s10, b'.', m1, m2, m3, m4, m5, m6] = *time
    else {
        return None;
    };
    let (nanos, rest) = match *rest {
        [b')', b' ', ref rest @ ..] => (0, rest),
        [n1 @ b'0'..=b'9', n2 @ b'0'..=b'9', n3 @ b'0'..=b'9', b')', b' ', ref rest @ ..] => {
            let digit = |digit| u16::from(digit - b'0');
            (digit(n1) * 100 + digit(n2) * 10 + digit(n3), rest)
        }
        _ => return None,
    };
    let seconds = eight_digits([s1, s2, s3, s4, s5, s6, s7, s8])?;
    let (tens, ones) = (s9.wrapping_sub(b'0'), s10.wrapping_sub(b'0'));
    let micros = eight_digits([b'0', b'0', m1, m2, m3, m4, m5, m6])?;
    let is_valid = tens <= 9 && ones <= 9;
    let seconds = seconds * 100 + u64::from(tens) * 10 + u64::from(ones);
    is_valid.then_some((LogTime { micros: seconds * 1_000_000 + micros, nanos }, rest))
}

/// Returns the number of eight decimal digits, all of them at once: pairs, then fours, then eight.
#[inline]
fn eight_digits(text: [u8; 8]) -> Option<u64> {
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
fn four_bytes(text: [u8; 8]) -> Option<[u8; 4]> {
    const ALL: u64 = 0x0101_0101_0101_0101;
    let digits = u64::from_le_bytes(text);
    let is_letter = digits >> 6 & ALL;
    // Bits of the upper half that are set in what is no digit, and in what is none of A to F.
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

/// Reads an identifier and the `#` behind it.
#[inline]
fn id(text: &[u8]) -> Option<(CanId, &[u8])> {
    if let Some((digits, [b'#', rest @ ..])) = text.split_first_chunk() {
        return Some((CanId::extended(u32::from_be_bytes(four_bytes(*digits)?))?, rest));
    }
    let (digits, rest) = text.split_first_chunk::<3>()?;
    let [a, b, c] = digits.map(|digit| DIGITS[usize::from(digit)]);
    let number = u32::from(a) << 8 | u32::from(b) << 4 | u32::from(c);
    let id = CanId::standard(number).filter(|_| (a | b | c) & NO_DIGIT == 0)?;
    Some((id, rest.strip_prefix(b"#")?))
}

/// Reads hexadecimal bytes, at most eight.
#[inline]
fn data(text: &[u8]) -> Option<([u8; Frame::MAX_CLASSIC_DATA], usize, &[u8])> {
    if let Some((digits, rest)) = text.split_first_chunk::<16>()
        && let Some([a, b, c, d]) = digits.first_chunk().and_then(|half| four_bytes(*half))
        && let Some([e, f, g, h]) = digits.last_chunk().and_then(|half| four_bytes(*half))
    {
        return Some(([a, b, c, d, e, f, g, h], 8, rest));
    }
    let (mut data, mut len, mut rest) = ([0; Frame::MAX_CLASSIC_DATA], 0, text);
    while let [high, low, after @ ..] = rest {
        let (high, low) = (DIGITS[usize::from(*high)], DIGITS[usize::from(*low)]);
        if high == NO_DIGIT {
            break;
        }
        if low == NO_DIGIT {
            return None;
        }
        *data.get_mut(len)? = high << 4 | low;
        (len, rest) = (len + 1, after);
    }
    Some((data, len, rest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::candump::parse_line;

    /// What both readers make of a line with its end.
    fn agree(line: &[u8]) -> bool {
        let Some(plain) = parse(line) else { return false };
        let text = &line[..plain.len - 1];
        let entry = parse_line(text).unwrap().unwrap();
        assert_eq!((plain.time, plain.frame), (entry.time, entry.frame));
        assert_eq!(plain.interface, entry.interface.as_bytes());
        true
    }

    #[test]
    fn usual_lines_are_read_alike() {
        for line in [
            "(1436509052.249713) can0 02015402#0444455301\n",
            "(1436509052.249713) vcan0.100 1FFFFFFF#\r\nrest",
            "(9999999999.999999) can0 7FF#0011223344556677\n",
            "(0000000000.000000) can0 123#AbcD T\n",
            "(0000000001.000009) can0 123#AB R\r\n",
            "(1436509052.249713458) can0 123#AB\n",
            "(1436509052.249713000) can0 02015402#0444455301 T\n",
        ] {
            assert!(agree(line.as_bytes()), "{line}");
        }
    }

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
    fn other_lines_are_left() {
        let long = format!("(1436509052.249713) {} 123#\n", "x".repeat(MAX_LINE));
        for line in [
            "(1436509052.249713) can0 123#AB",
            "(1436509052.249713) can0 123#A\n",
            "(1436509052.249713) can0 123##1AB\n",
            "(1436509052.249713) can0 123#R4\n",
            "(1436509052.249713) can0 20000004#00\n",
            "(1436509052.249713) can0 800#00\n",
            "(1436509052.249713) can0 123#001122334455667788\n",
            "(1436509052.249713) can0 123#00.11\n",
            "(1436509052.249713) can0 123#0011223344556677_9\n",
            "(1436509052.249713) can0 123#00 X\n",
            "(1436509052.249713) can0 123#00 T \n",
            "(1436509052.249713)  can0 123#00\n",
            "(1436509052.249713) k\u{f6}ln 123#00\n",
            "(143650905x.249713) can0 123#00\n",
            "(1436509052.24971:) can0 123#00\n",
            "(12.5) can0 123#00\n",
            "(1436509052.2497134) can0 123#00\n",
            "(1436509052.24971345) can0 123#00\n",
            "(1436509052.24971345x) can0 123#00\n",
            "(1436509052.2497134589) can0 123#00\n",
            "(1436509052.249713) \n",
            &long,
            "",
        ] {
            assert!(!agree(line.as_bytes()), "{line}");
        }
    }

    #[test]
    fn changed_bytes_are_read_alike_or_left() {
        let mut rng = fastrand::Rng::with_seed(7);
        let alphabet = b"0123456789abcdefABCDEF#.() TR_\r\n:x/\x00\x7F\xC3";
        let mut read = 0;
        for round in 0..200_000 {
            let mut line = b"(1436509052.249713) can0 02015402#0444455301 T\r\n".to_vec();
            for _ in 0..=(round % 3) {
                let at = rng.usize(0..line.len());
                line[at] = alphabet[rng.usize(0..alphabet.len())];
            }
            read += u32::from(agree(&line));
        }
        assert!(read > 10_000, "{read}");
    }
}
