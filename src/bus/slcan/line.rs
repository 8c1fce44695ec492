//! slcan syntax: Lawicel's ASCII protocol as present adapters use it.
//!
//! Pure: bytes in, values out, and back. A line that cannot be read is `None`; nothing panics. Does
//! not know the order of commands: `protocol` does.

use crate::bus::remote::Splitter;
use crate::frame::error_bits::{
    ACKNOWLEDGE_SLOT, BIT, BIT_0, BIT_1, BUS_ERROR, CONTROLLER, CRC_SEQUENCE, FORM, NO_ACKNOWLEDGE,
    PROTOCOL, RECEIVE_OVERFLOW, STUFF, TRANSMIT_OVERFLOW,
};
use crate::frame::{CanId, Frame, FrameKind, fd_length};
use crate::status::BusState;

/// Codes of the command `S` and their bit rates in bit/s. Code 7 is 800 kbit/s in Lawicel's adapters
/// and 750 kbit/s in others.
const BITRATES: [(u8, u32); 10] = [
    (0, 10_000),
    (1, 20_000),
    (2, 50_000),
    (3, 100_000),
    (4, 125_000),
    (5, 250_000),
    (6, 500_000),
    (7, 750_000),
    (7, 800_000),
    (8, 1_000_000),
];

/// Bit rates of the data phase, in bit/s: `Y2`, `Y5`.
const DATA_BITRATES: [u32; 2] = [2_000_000, 5_000_000];

/// The digit of `S` for a bit rate in bit/s; `None` if it has none.
pub(in crate::bus) fn rate_code(bitrate: u32) -> Option<u8> {
    BITRATES.iter().find(|(_, rate)| *rate == bitrate).map(|(code, _)| *code)
}

/// The digit of `Y` for a data bit rate in bit/s; `None` if it has none.
pub(in crate::bus) fn data_rate_code(bitrate: u32) -> Option<u8> {
    DATA_BITRATES.contains(&bitrate).then_some((bitrate / 1_000_000) as u8)
}

/// All bit rates with a code, for an error text.
pub(in crate::bus) fn rates() -> String {
    BITRATES.map(|(_, rate)| rate.to_string()).join(", ")
}

/// The same for the data phase.
pub(in crate::bus) fn data_rates() -> String {
    DATA_BITRATES.map(|rate| rate.to_string()).join(", ")
}

/// A line from an adapter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum AdapterReply {
    /// A frame, with its timestamp in milliseconds if it has one.
    Frame(Frame, Option<u16>),
    /// Positive response to a command or a frame.
    Ack,
    /// The status flags.
    Flags(Flags),
    /// State and error counters of the controller.
    State { state: BusState, tec: u16, rec: u16 },
    /// Version or serial number, with the letter of the command.
    Name(String),
    /// A command. Adapters send none; a program at the other end does.
    Command,
}

/// The status flags (`F`).
///
/// Bit 7 is not used: with an SJA1000 it means a bus error since the last request, with an MCP2515
/// bus-off. Both set the error-passive flag before bus-off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub(super) struct Flags(pub u8);

impl Flags {
    pub fn state(self) -> BusState {
        match self.0 {
            bits if bits & 0x20 != 0 => BusState::ErrorPassive,
            bits if bits & 0x04 != 0 => BusState::ErrorWarning,
            _ => BusState::ErrorActive,
        }
    }

    /// Returns true if the adapter lost frames: receive queue full, or controller overrun.
    pub fn is_overrun(self) -> bool {
        self.0 & 0x09 != 0
    }
}

/// Decodes a line without its end; `None` if it is malformed.
pub(super) fn parse(line: &[u8]) -> Option<AdapterReply> {
    let Some((&kind, rest)) = line.split_first() else { return Some(AdapterReply::Ack) };
    match kind {
        b't' | b'T' | b'r' | b'R' | b'd' | b'D' | b'b' | b'B' => frame(kind, rest),
        b'z' | b'Z' if rest.is_empty() => Some(AdapterReply::Ack),
        b'F' if rest.len() == 2 => Some(AdapterReply::Flags(Flags(number(rest, 16)? as u8))),
        b's' if rest.len() == 7 => state(rest),
        b'e' => errors(rest),
        b'V' | b'N' | b'v' if !rest.is_empty() => name(line).map(AdapterReply::Name),
        b'C' | b'O' | b'L' | b'V' | b'N' | b'F' if rest.is_empty() => Some(AdapterReply::Command),
        b'S' | b'Y' | b'Z' if rest.len() == 1 && rest[0].is_ascii_digit() => {
            Some(AdapterReply::Command)
        }
        _ => None,
    }
}

/// The printable text of a line; `None` if there is none.
pub(super) fn name(line: &[u8]) -> Option<String> {
    let text = std::str::from_utf8(line).ok()?;
    let is_text = text.chars().all(|c| c == ' ' || c.is_ascii_graphic());
    (is_text && !text.trim().is_empty()).then(|| text.trim().to_owned())
}

fn frame(kind: u8, rest: &[u8]) -> Option<AdapterReply> {
    let is_extended = kind.is_ascii_uppercase();
    let (id, rest) = rest.split_at_checked(if is_extended { 8 } else { 3 })?;
    let id = number(id, 16)?;
    let id = if is_extended { CanId::extended(id)? } else { CanId::standard(id)? };
    let (code, rest) = rest.split_at_checked(1)?;
    let code = number(code, 16)? as usize;
    let kind = kind.to_ascii_lowercase();
    let is_fd = matches!(kind, b'd' | b'b');
    let len = match code {
        0..=8 => code,
        _ if is_fd => data_length(code),
        _ => return None,
    };
    let digits = if kind == b'r' { 0 } else { 2 * len };
    let (data, stamp) = rest.split_at_checked(digits)?;
    let mut bytes = [0; Frame::MAX_DATA];
    for (byte, digits) in bytes.iter_mut().zip(data.chunks(2)) {
        *byte = number(digits, 16)? as u8;
    }
    let stamp = match stamp.len() {
        0 => None,
        4 => Some(number(stamp, 16)? as u16),
        _ => return None,
    };
    let mut frame = match kind {
        b'r' => Frame::remote(id, len),
        _ => Frame::new(id, &bytes[..len]),
    };
    frame.is_fd = is_fd;
    frame.bit_rate_switch = kind == b'b';
    Some(AdapterReply::Frame(frame, stamp))
}

/// `sa057033`: state, receive and transmit error counter.
fn state(rest: &[u8]) -> Option<AdapterReply> {
    let state = match rest[0] {
        b'a' => BusState::ErrorActive,
        b'w' => BusState::ErrorWarning,
        b'p' => BusState::ErrorPassive,
        b'b' => BusState::BusOff,
        _ => return None,
    };
    let rec = number(&rest[1..4], 10)? as u16;
    let tec = number(&rest[4..7], 10)? as u16;
    Some(AdapterReply::State { state, tec, rec })
}

/// `e1a`, `e3bcO`: number and types of errors, as the error frame that Linux makes of them.
fn errors(rest: &[u8]) -> Option<AdapterReply> {
    let (count, letters) = rest.split_first()?;
    if !count.is_ascii_digit() || letters.len() != usize::from(count - b'0') {
        return None;
    }
    let mut class = PROTOCOL | BUS_ERROR;
    let mut details = [0; 8];
    for letter in letters {
        match letter {
            b'a' => {
                class |= NO_ACKNOWLEDGE;
                details[3] = ACKNOWLEDGE_SLOT;
            }
            b'b' => details[2] |= BIT_0,
            b'B' => details[2] |= BIT_1,
            b'c' => {
                details[2] |= BIT;
                details[3] = CRC_SEQUENCE;
            }
            b'f' => details[2] |= FORM,
            b's' => details[2] |= STUFF,
            b'o' => {
                class |= CONTROLLER;
                details[1] |= RECEIVE_OVERFLOW;
            }
            b'O' => {
                class |= CONTROLLER;
                details[1] |= TRANSMIT_OVERFLOW;
            }
            _ => return None,
        }
    }
    if letters.iter().all(|letter| matches!(letter, b'o' | b'O')) {
        // An overrun is not a bus error.
        class = CONTROLLER;
    }
    Some(AdapterReply::Frame(Frame::error(class, &details), None))
}

/// Encodes a frame with its line end; `None` for error frames and impossible lengths.
pub(super) fn encode(frame: &Frame) -> Option<Vec<u8>> {
    let (kind, digits) = match (frame.kind, frame.is_fd, frame.bit_rate_switch) {
        (FrameKind::Error, ..) => return None,
        (FrameKind::Remote, ..) => ('r', frame.len()),
        (FrameKind::Data, false, _) => ('t', frame.len()),
        (FrameKind::Data, true, false) => ('d', length_code(frame.len())?),
        (FrameKind::Data, true, true) => ('b', length_code(frame.len())?),
    };
    if digits > 8 && !frame.is_fd {
        return None;
    }
    let mut line = match frame.id {
        CanId::Standard(id) => format!("{kind}{id:03X}{digits:X}"),
        CanId::Extended(id) => format!("{}{id:08X}{digits:X}", kind.to_ascii_uppercase()),
    };
    line.extend(frame.data().iter().map(|byte| format!("{byte:02X}")));
    line.push('\r');
    Some(line.into_bytes())
}

/// The length of an FD frame in bytes, by its DLC 9 to 15.
fn data_length(code: usize) -> usize {
    const LENGTHS: [usize; 7] = [12, 16, 20, 24, 32, 48, 64];
    LENGTHS[(code - 9).min(6)]
}

fn length_code(len: usize) -> Option<usize> {
    if len <= 8 {
        return Some(len);
    }
    (9..=15).find(|code| data_length(*code) == len && fd_length(len) == len)
}

/// A number of digits only: no sign, no white space.
fn number(digits: &[u8], radix: u32) -> Option<u32> {
    let all_digits = digits.iter().all(|digit| char::from(*digit).is_digit(radix));
    let text = std::str::from_utf8(digits).ok().filter(|_| all_digits)?;
    u32::from_str_radix(text, radix).ok()
}

/// A piece of the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LinePiece<'a> {
    /// A line without its end.
    Line(&'a [u8]),
    /// `\a`: negative response to a command or a frame.
    Nack,
    /// A line that is too long, or cut off by a `\a`.
    Unreadable,
}

/// Splits a stream, in pieces of any size, into lines and negative responses.
#[derive(Debug, Default)]
pub(super) struct LineSplitter(Splitter);

impl LineSplitter {
    /// Passes every piece that `bytes` complete to `take`.
    pub fn feed(&mut self, bytes: &[u8], mut take: impl FnMut(LinePiece<'_>)) {
        self.0.feed(bytes, b"\r\x07", |line, end| {
            // Some adapters end lines with \r\n.
            match (line.map(|line| line.strip_prefix(b"\n").unwrap_or(line)), end) {
                (Some(line), b'\r') => take(LinePiece::Line(line)),
                (None, b'\r') => take(LinePiece::Unreadable),
                (Some([]), _) => take(LinePiece::Nack),
                _ => {
                    take(LinePiece::Unreadable);
                    take(LinePiece::Nack);
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(text: &str) -> Option<AdapterReply> {
        parse(text.as_bytes())
    }

    fn frame_of(text: &str) -> Frame {
        match read(text) {
            Some(AdapterReply::Frame(frame, _)) => frame,
            other => panic!("{text}: {other:?}"),
        }
    }

    #[test]
    fn frames_are_read_as_adapters_write_them() {
        assert_eq!(frame_of("t1230"), Frame::new(CanId::Standard(0x123), &[]));
        assert_eq!(frame_of("t4563112233"), Frame::new(CanId::Standard(0x456), &[17, 34, 51]));
        assert_eq!(frame_of("T12abcdef2aa55"), Frame::classic(0x12AB_CDEF, &[0xAA, 0x55]));
        assert_eq!(frame_of("r1234"), Frame::remote(CanId::Standard(0x123), 4));
        assert_eq!(frame_of("R000001230"), Frame::remote(CanId::Extended(0x123), 0));
        let fd = frame_of(&format!("D000001239{}", "5A".repeat(12)));
        assert_eq!((fd.len(), fd.is_fd, fd.bit_rate_switch), (12, true, false));
        assert_eq!(
            read("T1111222281122334455667788EA5F"),
            Some(AdapterReply::Frame(
                Frame::classic(0x1111_2222, &[0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88]),
                Some(0xEA5F)
            ))
        );
    }

    #[test]
    fn malformed_frame_is_rejected() {
        for text in [
            "t",
            "t12",
            "t123",
            "t8000",
            "t1239",
            "t12311",
            "t123111223",
            "t123+",
            "t+120",
            "T",
            "T200000000",
            "T123456780 ",
            "t1230ABC",
            "t12301",
            "t1230ABCDE",
            "d123",
            "d1239AA",
            "r12341",
            "x1230",
            "Hello",
            "t123é",
            "F1",
            "F123",
            "sx000000",
            "s",
            "e",
            "e2a",
            "e1x",
            "z1",
            "S",
            "S66",
        ] {
            assert_eq!(read(text), None, "{text}");
        }
    }

    #[test]
    fn other_adapter_replies_are_recognised() {
        assert_eq!(read(""), Some(AdapterReply::Ack));
        assert_eq!(read("z"), Some(AdapterReply::Ack));
        assert_eq!(read("Z"), Some(AdapterReply::Ack));
        assert_eq!(read("V1013"), Some(AdapterReply::Name("V1013".into())));
        assert_eq!(read("S6"), Some(AdapterReply::Command));
        assert_eq!(read("V"), Some(AdapterReply::Command));
        let off = AdapterReply::State { state: BusState::BusOff, tec: 256, rec: 0 };
        assert_eq!(read("sb000256"), Some(off));
        let flags = |text| match read(text) {
            Some(AdapterReply::Flags(flags)) => (flags.state(), flags.is_overrun()),
            other => panic!("{other:?}"),
        };
        assert_eq!(flags("F00"), (BusState::ErrorActive, false));
        assert_eq!(flags("F04"), (BusState::ErrorWarning, false));
        assert_eq!(flags("FA4"), (BusState::ErrorPassive, false));
        assert_eq!(flags("F08"), (BusState::ErrorActive, true));
    }

    #[test]
    fn errors_become_error_frames() {
        let report = |text| crate::error_report::ErrorReport::of(&frame_of(text)).unwrap();
        assert!(report("e1a").is_no_ack());
        assert!(report("e2bf").is_bus_error());
        assert!(report("e1o").is_receive_overflow());
        assert!(!report("e1o").is_bus_error());
    }

    #[test]
    fn every_rate_has_its_code() {
        assert_eq!(rate_code(500_000), Some(6));
        assert_eq!((rate_code(750_000), rate_code(800_000)), (Some(7), Some(7)));
        assert_eq!((rate_code(300_000), data_rate_code(3_000_000)), (None, None));
        assert_eq!(data_rate_code(5_000_000), Some(5));
    }

    fn pieces(splitter: &mut LineSplitter, bytes: &[u8]) -> Vec<String> {
        let mut seen = Vec::new();
        splitter.feed(bytes, |piece| seen.push(format!("{piece:?}")));
        seen
    }

    #[test]
    fn stream_is_split_independent_of_chunks() {
        let whole = b"t1230\r\rz\r\n\x07half\x07V1013\r";
        let at_once = pieces(&mut LineSplitter::default(), whole);
        assert_eq!(at_once.len(), 7, "{at_once:?}");
        let mut splitter = LineSplitter::default();
        let mut one_by_one = Vec::new();
        for byte in whole {
            one_by_one.extend(pieces(&mut splitter, &[*byte]));
        }
        assert_eq!(one_by_one, at_once);
    }

    fn any_frame() -> impl Strategy<Value = Frame> {
        let id = prop_oneof![
            (0..0x800_u16).prop_map(CanId::Standard),
            (0..0x2000_0000_u32).prop_map(CanId::Extended),
        ];
        (id, 0..16_usize, any::<[u8; 64]>(), 0..4).prop_map(|(id, code, data, kind)| {
            let classic = code.min(8);
            let len = if code > 8 { data_length(code) } else { code };
            match kind {
                0 => Frame::remote(id, classic),
                1 => Frame::new(id, &data[..classic]),
                _ => {
                    let mut frame = Frame::new(id, &data[..len]);
                    frame.is_fd = true;
                    frame.bit_rate_switch = kind == 3;
                    frame
                }
            }
        })
    }

    proptest! {
        #[test]
        fn frames_come_back_as_they_were_written(frame in any_frame()) {
            let line = encode(&frame).unwrap();
            let (end, line) = line.split_last().unwrap();
            prop_assert_eq!(*end, b'\r');
            prop_assert_eq!(parse(line), Some(AdapterReply::Frame(frame, None)));
        }

        #[test]
        fn any_bytes_are_taken(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            let mut splitter = LineSplitter::default();
            splitter.feed(&bytes, |piece| {
                if let LinePiece::Line(line) = piece
                    && let Some(AdapterReply::Frame(frame, _)) = parse(line)
                {
                    assert!(frame.len() <= Frame::MAX_DATA);
                }
            });
        }

        #[test]
        fn lines_like_frames_are_taken(text in "[tTrRdDbBseFVz][0-9A-Fa-f]{0,150}") {
            let _ = parse(text.as_bytes());
        }
    }
}
