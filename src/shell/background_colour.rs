//! The terminal's own background colour: the question (OSC 11), and its answer among the keys.
//!
//! Inputs: input events with their real time. Outputs: the events without the answer, and the colour.
//! The answer arrives when it does, or never: nothing waits for it. Keys that may be its beginning are
//! held for a short time, and are handed on in their order if they are not. Answers in another form, and
//! other operating system commands, are dropped. Bounded: the longest answer has 34 characters. Does not
//! know what the colour is used for.

use crate::time::{Duration, Instant};
use crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// Asks for the colour, with the string terminator (ECMA-48) that the answer then has, too.
pub const QUESTION: &[u8] = b"\x1b]11;?\x1b\\";

/// Begin of the answer, as characters.
const BEGIN: &str = "\x1b]11;";
/// Stands for the part of another command that was dropped.
const FOREIGN: &str = "\x1b]0;";
/// Most digits of the number of a command.
const MAX_DIGITS: usize = 4;
/// Longest answer: `rgba:` and four parts of four digits, between begin and end.
const LONGEST: usize = 34;
/// Keys that may begin an answer are held for so long after the last one: an answer is sent at once,
/// and a packet of it may be late.
const HELD: Duration = Duration::from_millis(100);
/// The same for an escape alone, which is a key that users wait for.
const ESCAPE_HELD: Duration = Duration::from_millis(30);
/// Time after the question in which an escape alone may be the first part of the answer.
const EXPECTED: Duration = Duration::from_secs(5);

/// See the documentation of the module.
#[derive(Debug, Default)]
pub struct BackgroundReply {
    asked: Option<Instant>,
    held: Vec<Event>,
    text: String,
    /// When the held events are handed on.
    until: Option<Instant>,
}

impl BackgroundReply {
    /// Notes that the question was sent.
    pub fn note_asked(&mut self, now: Instant) {
        self.asked = Some(now);
    }

    /// Returns true if an answer was asked for in the last `time`, and none came.
    pub fn is_awaited(&self, now: Instant, time: Duration) -> bool {
        self.asked.is_some_and(|asked| now.since(asked) < time)
    }

    /// Takes an event. Returns the events to handle, in their order, and the colour once the answer is
    /// complete.
    pub fn take(&mut self, now: Instant, event: Event) -> (Vec<Event>, Option<[u8; 3]>) {
        let Some(text) = text_of(&event) else {
            let mut events = self.release();
            events.push(event);
            return (events, None);
        };
        let is_first = self.text.is_empty();
        let is_escape = text == "\x1b";
        if is_first && is_escape && !self.is_awaited(now, EXPECTED) {
            return (vec![event], None);
        }
        self.text.push_str(&text);
        self.held.push(event);
        match ReplyPart::of(&self.text) {
            ReplyPart::Whole(colour) => {
                self.release();
                self.asked = None;
                (Vec::new(), colour)
            }
            ReplyPart::Foreign => {
                // Dropped up to its end, or until nothing more of it comes.
                self.held.clear();
                FOREIGN.clone_into(&mut self.text);
                self.until = Some(now + HELD);
                (Vec::new(), None)
            }
            ReplyPart::Begun => {
                let time = if is_first && is_escape { ESCAPE_HELD } else { HELD };
                self.until = Some(now + time);
                (Vec::new(), None)
            }
            // It may be the begin of the answer itself, behind a key that was not.
            ReplyPart::Other if !is_first => {
                let last = self.held.pop();
                let mut events = self.release();
                let colour = last.and_then(|event| {
                    let (more, colour) = self.take(now, event);
                    events.extend(more);
                    colour
                });
                (events, colour)
            }
            ReplyPart::Other => (self.release(), None),
        }
    }

    /// When [`Self::handle_timeout`] is due.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.until
    }

    /// Returns the events that were held for too long.
    pub fn handle_timeout(&mut self, now: Instant) -> Vec<Event> {
        if self.until.is_some_and(|until| until <= now) { self.release() } else { Vec::new() }
    }

    fn release(&mut self) -> Vec<Event> {
        self.text.clear();
        self.until = None;
        std::mem::take(&mut self.held)
    }
}

/// Returns the bytes of a key that may be part of the answer; `None` for any other event.
fn text_of(event: &Event) -> Option<String> {
    let Event::Key(KeyEvent { code, modifiers, kind, .. }) = event else { return None };
    let modifiers = modifiers.difference(KeyModifiers::SHIFT);
    if *kind == KeyEventKind::Release {
        return None;
    }
    match (code, modifiers) {
        (KeyCode::Esc, KeyModifiers::NONE) => Some("\x1b".to_owned()),
        (KeyCode::Char(c), KeyModifiers::NONE) => Some(c.to_string()),
        (KeyCode::Char(c), KeyModifiers::ALT) => Some(format!("\x1b{c}")),
        (KeyCode::Char('g'), KeyModifiers::CONTROL) => Some("\x07".to_owned()),
        _ => None,
    }
}

/// What characters are of an answer.
enum ReplyPart {
    /// No part of one.
    Other,
    /// Its begin, or that of another operating system command.
    Begun,
    /// A part of another command, or of an answer in another form.
    Foreign,
    /// All of it; `None` if its colour cannot be read.
    Whole(Option<[u8; 3]>),
}

impl ReplyPart {
    fn of(text: &str) -> Self {
        let Some(rest) = text.strip_prefix(BEGIN) else {
            return Self::of_command(text);
        };
        if let Some(colour) = rest.strip_suffix("\x1b\\").or(rest.strip_suffix('\x07')) {
            return Self::Whole(parse_colour(colour));
        }
        let value = rest.strip_suffix('\x1b').unwrap_or(rest);
        let is_value = |c: char| c.is_ascii_hexdigit() || "rgba:/#".contains(c);
        let fits = text.len() <= LONGEST && value.chars().all(is_value);
        if fits { Self::Begun } else { Self::Foreign }
    }

    /// Of an operating system command with any number.
    fn of_command(text: &str) -> Self {
        let Some(rest) = text.strip_prefix("\x1b]") else {
            return if text == "\x1b" { Self::Begun } else { Self::Other };
        };
        let digits = rest.chars().take_while(char::is_ascii_digit).count();
        match &rest[digits..] {
            "" if digits <= MAX_DIGITS => Self::Begun,
            ";" | ";\x1b" if digits > 0 => Self::Begun,
            value if digits > 0 && value.starts_with(';') => {
                let is_whole = value.ends_with("\x1b\\") || value.ends_with('\x07');
                if is_whole { Self::Whole(None) } else { Self::Foreign }
            }
            _ => Self::Other,
        }
    }
}

/// Reads `rgb:RR/GG/BB`, with one to four digits each, or `rgba:` with a fourth part.
fn parse_colour(text: &str) -> Option<[u8; 3]> {
    let parts = text.strip_prefix("rgb:").or(text.strip_prefix("rgba:"))?;
    let mut parts = parts.split('/').map(|part| {
        let value = u32::from_str_radix(part, 16).ok()?;
        let most = (1..=4).contains(&part.len()).then(|| (1_u32 << (4 * part.len())) - 1)?;
        u8::try_from((value * 255 + most / 2) / most).ok()
    });
    Some([parts.next()??, parts.next()??, parts.next()??])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    fn key(code: KeyCode, modifiers: KeyModifiers) -> Event {
        Event::Key(KeyEvent::new(code, modifiers))
    }

    fn char_key(c: char) -> Event {
        key(KeyCode::Char(c), KeyModifiers::NONE)
    }

    /// The events of bytes that arrive at once, as crossterm makes them.
    fn events(bytes: &str) -> Vec<Event> {
        let mut events = Vec::new();
        let mut chars = bytes.chars().peekable();
        while let Some(c) = chars.next() {
            events.push(match c {
                '\x1b' => match chars.next() {
                    Some(next) => key(KeyCode::Char(next), KeyModifiers::ALT),
                    None => key(KeyCode::Esc, KeyModifiers::NONE),
                },
                '\x07' => key(KeyCode::Char('g'), KeyModifiers::CONTROL),
                c => char_key(c),
            });
        }
        events
    }

    fn take_all(
        reply: &mut BackgroundReply,
        from: u64,
        events: Vec<Event>,
    ) -> (Vec<Event>, Option<[u8; 3]>) {
        let (mut rest, mut found) = (Vec::new(), None);
        for (millis, event) in (from..).zip(events) {
            let (more, colour) = reply.take(at(millis), event);
            rest.extend(more);
            found = found.or(colour);
        }
        (rest, found)
    }

    fn asked() -> BackgroundReply {
        let mut reply = BackgroundReply::default();
        reply.note_asked(at(0));
        reply
    }

    #[test]
    fn answer_is_taken_from_between_keys() {
        for (answer, colour) in [
            ("\x1b]11;rgb:1c1c/1f1f/2424\x1b\\", Some([0x1c, 0x1f, 0x24])),
            ("\x1b]11;rgb:fa/FA/f7\x07", Some([0xfa, 0xfa, 0xf7])),
            ("\x1b]11;rgba:0000/0000/0000/ffff\x1b\\", Some([0, 0, 0])),
            ("\x1b]11;rgb:f/0/8\x07", Some([255, 0, 136])),
            ("\x1b]11;#aabbcc\x07", None),
            ("\x1b]11;rgb:zz/q \x07", None),
            ("\x1b]10;rgb:1c1c/1f1f/2424\x1b\\", None),
            ("\x1b]4;0;rgb:1c1c/1f1f/2424\x1b\\", None),
            ("\x1b]11;rgb:11111111111111111111111111111111111111111111111/22\x1b\\", None),
        ] {
            let mut reply = asked();
            let (rest, found) = take_all(&mut reply, 5, events(&format!("j{answer}1k")));
            assert_eq!(rest, events("j1k"), "{answer:?}");
            assert_eq!((found, reply.poll_timeout()), (colour, None), "{answer:?}");
            assert!(!reply.is_awaited(at(50), EXPECTED));
        }
    }

    #[test]
    fn answer_in_parts_is_put_together() {
        let answer = "\x1b]11;rgb:1c1c/1f1f/2424\x1b\\";
        for cut in 1..answer.len() {
            let mut reply = asked();
            let (first, second) = answer.split_at(cut);
            let mut parts = events(first);
            // The second part begins in the middle of an escape sequence.
            parts.extend(events(second));
            let (rest, found) = take_all(&mut reply, 5, parts);
            assert_eq!((rest, found), (Vec::new(), Some([0x1c, 0x1f, 0x24])), "{cut}");
        }
    }

    #[test]
    fn keys_that_are_no_answer_are_handed_on_in_order() {
        for text in ["\x1b]", "\x1b]11", "\x1b]12q", "\x1b]\x1b]1j", "11;rgb:"] {
            let mut reply = asked();
            let typed = events(text);
            let (mut rest, found) = take_all(&mut reply, 5, typed.clone());
            rest.extend(reply.handle_timeout(at(500)));
            assert_eq!((rest, found, reply.poll_timeout()), (typed, None, None), "{text:?}");
        }
        // An endless one.
        let mut reply = asked();
        let (rest, _) = take_all(&mut reply, 5, events(&format!("\x1b]11;{}", "a".repeat(99))));
        assert!(rest.is_empty() && reply.held.len() < LONGEST, "{} are held", reply.held.len());
        // It ends with a pause.
        assert_eq!(reply.handle_timeout(at(500)), []);
        assert_eq!(take_all(&mut reply, 600, events("j")).0, events("j"));
    }

    #[test]
    fn escape_is_held_only_while_an_answer_is_expected() {
        let escape = || key(KeyCode::Esc, KeyModifiers::NONE);
        let mut reply = asked();
        assert_eq!(reply.take(at(20), escape()), (Vec::new(), None));
        assert_eq!(reply.poll_timeout(), Some(at(50)));
        assert_eq!(reply.handle_timeout(at(49)), Vec::new());
        assert_eq!(reply.handle_timeout(at(50)), vec![escape()]);
        assert_eq!(reply.take(at(6_000), escape()), (vec![escape()], None));
        let mut unasked = BackgroundReply::default();
        assert_eq!(unasked.take(at(20), escape()), (vec![escape()], None));
        let resize = || Event::Resize(80, 24);
        assert_eq!(asked().take(at(20), resize()), (vec![resize()], None));
    }
}
