//! socketcand syntax: messages of words between `<` and `>`.
//!
//! Pure: bytes in, values out, and back. A message that cannot be read is `None`; nothing panics.

use crate::bus::remote::Splitter;
use crate::frame::{CanId, Frame, FrameKind};
use crate::text::printable;

/// A message from a server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum ServerMessage {
    /// The greeting.
    Hi,
    /// Positive response to the last command.
    Ok,
    /// Response to `< echo >`, used as a keep-alive.
    Echo,
    /// A frame of any kind, with the time of the server's clock in microseconds.
    Frame(Frame, Option<i64>),
    /// Negative response; the cause, printable.
    Error(String),
}

/// Decodes the text between the brackets; `None` if it is malformed.
pub(super) fn parse(content: &[u8]) -> Option<ServerMessage> {
    let text = std::str::from_utf8(content).ok();
    let words: Vec<&str> = text.map(str::split_ascii_whitespace)?.collect();
    match words[..] {
        ["hi"] => Some(ServerMessage::Hi),
        ["ok"] => Some(ServerMessage::Ok),
        ["echo"] => Some(ServerMessage::Echo),
        ["frame", id, time, ref data @ ..] => {
            let mut bytes = Vec::new();
            // Raw mode has one word, other modes separate bytes.
            for digits in data.iter().map(|word| word.as_bytes()) {
                for pair in digits.chunks(2) {
                    bytes.push(hex(pair).filter(|_| pair.len() == 2)? as u8);
                }
            }
            if bytes.len() > Frame::MAX_CLASSIC_DATA {
                return None;
            }
            Some(ServerMessage::Frame(Frame::new(identifier(id)?, &bytes), Some(micros(time)?)))
        }
        ["rtr", id, time, len] => {
            let len = len.parse().ok().filter(|len| *len <= Frame::MAX_CLASSIC_DATA)?;
            Some(ServerMessage::Frame(Frame::remote(identifier(id)?, len), Some(micros(time)?)))
        }
        ["error", class, time] if error_class(class).is_some() && micros(time).is_some() => {
            Some(ServerMessage::Frame(Frame::error(error_class(class)?, &[]), micros(time)))
        }
        ["error", class] if error_class(class).is_some() => {
            Some(ServerMessage::Frame(Frame::error(error_class(class)?, &[]), None))
        }
        ["error", ref words @ ..] => {
            Some(ServerMessage::Error(printable(words.join(" ").as_bytes())))
        }
        _ => None,
    }
}

/// Encodes a frame; `None` for FD and error frames, which socketcand cannot send.
pub(super) fn encode(frame: &Frame) -> Option<String> {
    if frame.is_fd || frame.len() > Frame::MAX_CLASSIC_DATA {
        return None;
    }
    let id = frame.id;
    match frame.kind {
        FrameKind::Error => None,
        FrameKind::Remote => Some(format!("< sendrtr {id} {} >", frame.len())),
        FrameKind::Data => {
            let bytes = frame.data().iter().map(|byte| format!("{byte:x} ")).collect::<Vec<_>>();
            Some(format!("< send {id} {} {}>", frame.len(), bytes.concat()))
        }
    }
}

/// Parses an identifier: three digits standard, eight extended.
fn identifier(text: &str) -> Option<CanId> {
    let id = hex(text.as_bytes())?;
    match text.len() {
        3 => CanId::standard(id),
        8 => CanId::extended(id),
        _ => None,
    }
}

fn error_class(text: &str) -> Option<u32> {
    let is_class = (3..=8).contains(&text.len());
    hex(text.as_bytes()).filter(|class| is_class && *class <= CanId::MAX_EXTENDED)
}

/// Parses a number of hexadecimal digits only, without a sign.
fn hex(digits: &[u8]) -> Option<u32> {
    let all_digits = !digits.is_empty() && digits.iter().all(u8::is_ascii_hexdigit);
    let text = std::str::from_utf8(digits).ok().filter(|_| all_digits)?;
    u32::from_str_radix(text, 16).ok()
}

/// Converts seconds with a fraction to microseconds.
fn micros(text: &str) -> Option<i64> {
    let (seconds, fraction) = text.split_once('.')?;
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    if !is_number(seconds) || !is_number(fraction) {
        return None;
    }
    let mut micros: i64 = 0;
    for at in 0..6 {
        micros =
            micros * 10 + fraction.as_bytes().get(at).map_or(0, |digit| i64::from(digit - b'0'));
    }
    seconds.parse::<i64>().ok()?.checked_mul(1_000_000)?.checked_add(micros)
}

/// A piece of the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MessagePiece<'a> {
    /// Text between the brackets.
    Message(&'a [u8]),
    /// Bytes outside the brackets, or a message without end or too long.
    Unreadable,
}

/// Splits a stream, in pieces of any size, into messages.
#[derive(Debug, Default)]
pub(super) struct MessageSplitter {
    splitter: Splitter,
    /// True between `<` and `>`.
    is_inside: bool,
    /// True if the bytes outside the brackets have been reported.
    is_reported: bool,
}

impl MessageSplitter {
    /// Passes every piece that `bytes` complete to `take`; bytes outside the brackets once, when they
    /// begin.
    pub fn feed(&mut self, bytes: &[u8], mut take: impl FnMut(MessagePiece<'_>)) {
        self.splitter.feed(bytes, b"<>", |text, end| {
            let was_inside = std::mem::replace(&mut self.is_inside, end == b'<');
            let was_reported = std::mem::take(&mut self.is_reported);
            match text {
                Some(text) if was_inside && end == b'>' => take(MessagePiece::Message(text)),
                Some(text) if !was_inside && end == b'<' && text.trim_ascii().is_empty() => {}
                _ if was_reported => {}
                _ => take(MessagePiece::Unreadable),
            }
        });
        let has_text = !self.splitter.partial().trim_ascii().is_empty();
        if has_text && !self.is_inside && !std::mem::replace(&mut self.is_reported, true) {
            take(MessagePiece::Unreadable);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(text: &str) -> Option<ServerMessage> {
        parse(text.as_bytes())
    }

    #[test]
    fn messages_are_read_as_the_daemon_writes_them() {
        let data = Frame::classic(0x1A22_0344, &[0x1A, 0x22]);
        let frame = |frame, micros| Some(ServerMessage::Frame(frame, Some(micros)));
        assert_eq!(read(" frame 1A220344 23.424242 1A22 "), frame(data, 23_424_242));
        assert_eq!(read(" frame 1A220344 23.424242 1A 22 "), frame(data, 23_424_242));
        let empty = Frame::new(CanId::Standard(0x123), &[]);
        assert_eq!(read(" frame 123 1436509052.249713  "), frame(empty, 1_436_509_052_249_713));
        let remote = Frame::remote(CanId::Standard(0x123), 4);
        assert_eq!(read(" rtr 123 23.5 4 "), frame(remote, 23_500_000));
        assert_eq!(read(" error 004 23.424242 "), frame(Frame::error(4, &[]), 23_424_242));
        assert_eq!(read(" hi "), Some(ServerMessage::Hi));
        assert_eq!(read("ok"), Some(ServerMessage::Ok));
        let refused = ServerMessage::Error("could not open bus".to_owned());
        assert_eq!(read(" error could not open bus "), Some(refused));
    }

    #[test]
    fn malformed_message_is_rejected() {
        for text in [
            "",
            "frame",
            "frame 123",
            "frame 123 23",
            "frame 1234 2.0 11",
            "frame 800 2.0 11",
            "frame FFFFFFFF 2.0 11",
            "frame 123 2.0 1",
            "frame 123 2.0 111",
            "frame 123 x.0 11",
            "frame 123 2.0 112233445566778899",
            "frame 123 2.0 11 22 33 44 55 66 77 88 99",
            "frame 123 2.0 GG",
            "frame +23 2.0 11",
            "frame 123 -2.0 11",
            "frame 123 2. 11",
            "frame 123 99999999999999999999.0 11",
            "rtr 123 2.0 9",
            "rtr 123 2.0 -1",
            "okay",
        ] {
            assert_eq!(read(text), None, "{text}");
        }
        assert_eq!(parse(b"ok\xFF"), None);
    }

    #[test]
    fn server_text_is_escaped_for_the_terminal() {
        let Some(ServerMessage::Error(text)) = parse(b"error \x1b[2J\x07no") else { panic!() };
        assert_eq!(text, "\\x1B[2J\\x07no");
    }

    #[test]
    fn frames_are_written_as_the_daemon_reads_them() {
        let data = Frame::new(CanId::Standard(0x123), &[1, 0xF1]);
        assert_eq!(encode(&data).unwrap(), "< send 123 2 1 f1 >");
        assert_eq!(encode(&Frame::classic(0xABC, &[])).unwrap(), "< send 00000ABC 0 >");
        let remote = Frame::remote(CanId::Extended(5), 8);
        assert_eq!(encode(&remote).unwrap(), "< sendrtr 00000005 8 >");
        assert_eq!(encode(&Frame::fd(1, &[0; 4], 0)), None);
        assert_eq!(encode(&Frame::error(4, &[])), None);
    }

    fn pieces(splitter: &mut MessageSplitter, bytes: &[u8]) -> Vec<String> {
        let mut seen = Vec::new();
        splitter.feed(bytes, |piece| seen.push(format!("{piece:?}")));
        seen
    }

    #[test]
    fn stream_is_split_independent_of_chunks() {
        let whole = b"< hi >< ok >\r\nHTTP/1.1 400<half < ok > x <>";
        let at_once = pieces(&mut MessageSplitter::default(), whole);
        assert_eq!(at_once.iter().filter(|piece| *piece == "Unreadable").count(), 3);
        assert_eq!(at_once.len(), 7, "{at_once:?}");
        let mut splitter = MessageSplitter::default();
        let one_by_one: Vec<_> = whole.iter().flat_map(|b| pieces(&mut splitter, &[*b])).collect();
        assert_eq!(one_by_one, at_once);
    }

    #[test]
    fn bytes_without_brackets_are_reported_once_and_at_once() {
        let mut splitter = MessageSplitter::default();
        assert_eq!(pieces(&mut splitter, b"\r\n"), [""; 0]);
        assert_eq!(pieces(&mut splitter, b"SSH-2.0"), ["Unreadable"]);
        assert_eq!(pieces(&mut splitter, &vec![b'x'; 100_000]), [""; 0]);
        assert_eq!(pieces(&mut splitter, b"<ok>"), ["Message([111, 107])"]);
    }

    proptest! {
        #[test]
        fn any_bytes_are_taken(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            let mut splitter = MessageSplitter::default();
            splitter.feed(&bytes, |piece| {
                if let MessagePiece::Message(content) = piece {
                    let _ = parse(content);
                }
            });
        }

        #[test]
        fn words_like_messages_are_taken(
            text in "(frame|rtr|error) [0-9A-F]{0,9} [0-9]{0,25}\\.?[0-9]{0,9} [0-9A-F ]{0,30}"
        ) {
            let _ = parse(text.as_bytes());
        }

        #[test]
        fn frames_come_back_as_they_were_written(
            id in 0..0x2000_0000_u32, data in prop::collection::vec(any::<u8>(), 0..=8)
        ) {
            let frame = Frame::classic(id, &data);
            let message = encode(&frame).unwrap();
            // The message as the server forwards it to its other clients.
            let words: Vec<&str> = message.split_whitespace().collect();
            let digits = words[4..words.len() - 1].iter().map(|byte| format!("{byte:0>2}"));
            let digits = digits.collect::<Vec<_>>().concat();
            let heard = format!("frame {} 1.0 {digits}", words[2]);
            prop_assert_eq!(read(&heard), Some(ServerMessage::Frame(frame, Some(1_000_000))));
            prop_assert_eq!(words[3].parse::<usize>().unwrap(), data.len());
        }
    }
}
