//! The usual lines of candump's log text, `(1436509052.249713) can0 02015402#0444455301` and
//! `(1436509052.249713) can0 123##1AABB`, in one pass.
//!
//! Input: text that begins with a line. Output: the line's frame and length; nothing for any other
//! line, which [`super::candump::parse_line`] reads. What both read, they read alike.
//! Does not know moments or bus numbers.

use super::LogTime;
use super::candump::MAX_LINE;
use super::fields::{HEX_VALUES, NO_DIGIT, eight_digits, four_bytes, hex_byte, hex_value};
use crate::frame::socketcan::with_fd_flags;
use crate::frame::{CanId, Frame};

/// Bytes of a time with ten digits of seconds and six of the fraction, without the parenthesis behind it.
const TIME: usize = 18;

/// A data frame on a line, with its interface.
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
    let (mut frame, rest) = if let [b'#', flags, rest @ ..] = rest {
        fd_frame(id, *flags, rest)?
    } else {
        let (data, len, rest) = data(rest)?;
        (Frame::of_eight_bytes(id, data, len), rest)
    };
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
pub(super) fn time(text: &[u8]) -> Option<(LogTime, &[u8])> {
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

/// Reads an identifier and the `#` behind it.
#[inline]
fn id(text: &[u8]) -> Option<(CanId, &[u8])> {
    if let Some((digits, [b'#', rest @ ..])) = text.split_first_chunk() {
        return Some((CanId::extended(u32::from_be_bytes(four_bytes(*digits)?))?, rest));
    }
    let (digits, rest) = text.split_first_chunk::<3>()?;
    let [a, b, c] = digits.map(|digit| HEX_VALUES[usize::from(digit)]);
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
        let (high, low) = (HEX_VALUES[usize::from(*high)], HEX_VALUES[usize::from(*low)]);
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

/// Reads the hexadecimal bytes of an FD frame, at most 64.
fn fd_frame(id: CanId, flags: u8, mut rest: &[u8]) -> Option<(Frame, &[u8])> {
    let (mut data, mut len) = ([0; Frame::MAX_DATA], 0);
    while let Some((digits, after)) = rest.split_first_chunk()
        && let Some(bytes) = four_bytes(*digits)
    {
        *data[len..].first_chunk_mut()? = bytes;
        (len, rest) = (len + bytes.len(), after);
    }
    while let [high, low, after @ ..] = rest
        && let Some(byte) = hex_byte([*high, *low])
    {
        *data.get_mut(len)? = byte;
        (len, rest) = (len + 1, after);
    }
    Some((with_fd_flags(id, &data[..len], hex_value(flags)?), rest))
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

    /// A line of an FD frame with `len` bytes.
    fn fd(len: usize) -> String {
        format!("(1436509052.249713) can0 123##0{}\n", "5A".repeat(len))
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
            "(1436509052.249713) can0 123##1AB\n",
            "(1436509052.249713) can0 123##5\r\n",
            "(1436509052.249713) can0 02015402##F00112233445566778899AABBCCDDEE T\n",
            &fd(64),
        ] {
            assert!(agree(line.as_bytes()), "{line}");
        }
    }

    #[test]
    fn other_lines_are_left() {
        let long = format!("(1436509052.249713) {} 123#\n", "x".repeat(MAX_LINE));
        for line in [
            "(1436509052.249713) can0 123#AB",
            "(1436509052.249713) can0 123#A\n",
            "(1436509052.249713) can0 123##GAB\n",
            "(1436509052.249713) can0 123##\n",
            "(1436509052.249713) can0 123##1ABC\n",
            "(1436509052.249713) can0 123##100112233445566778\n",
            "(1436509052.249713) can0 123##1AB_9\n",
            "(1436509052.249713) can0 123##1AB.CD\n",
            &fd(65),
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
            let hashes = if round % 2 == 0 { "#" } else { "##4" };
            let line = format!("(1436509052.249713) can0 02015402{hashes}0444455301 T\r\n");
            let mut line = line.into_bytes();
            for _ in 0..=(round % 3) {
                let at = rng.usize(0..line.len());
                line[at] = alphabet[rng.usize(0..alphabet.len())];
            }
            read += u32::from(agree(&line));
        }
        assert!(read > 10_000, "{read}");
    }
}
