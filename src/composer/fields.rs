//! What is typed in one field of a composition: tokens, receivers, senders, services, data.
//!
//! Each reader names the wrong word, what would be right, and the word that is most like it.

use super::{CompositionField, MessageKind, Mistake};
use crate::diagnostic::nearest_word;
use crate::text::printable;
use crate::wire::des::Request;
use crate::wire::descriptor::DescriptorField;
use crate::wire::id::{Address, Service};
use crate::wire::node::Mode;
use crate::wire::profile::Profile;

/// A word of a field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct FieldToken {
    /// Number of characters before it.
    pub column: usize,
    /// Without quotes and escapes.
    pub text: String,
    /// It stood in quotes.
    pub is_quoted: bool,
}

impl FieldToken {
    /// Returns true if it is this word, and not in quotes.
    pub fn is(&self, word: &str) -> bool {
        !self.is_quoted && self.text.eq_ignore_ascii_case(word)
    }

    /// As it is written, printable.
    pub fn shown(&self) -> String {
        printable(self.text.as_bytes())
    }
}

/// Splits a field at white space; what stands in `"` is one token.
///
/// # Errors
///
/// A quote without its end: the column of its begin.
pub(super) fn tokens(text: &str) -> Result<Vec<FieldToken>, usize> {
    let mut tokens = Vec::new();
    let mut chars = text.chars().enumerate().peekable();
    while let Some((column, c)) = chars.next() {
        if c.is_whitespace() {
            continue;
        }
        if c != '"' {
            let mut text = String::from(c);
            while let Some((_, c)) = chars.next_if(|(_, c)| !c.is_whitespace()) {
                text.push(c);
            }
            tokens.push(FieldToken { column, text, is_quoted: false });
            continue;
        }
        let mut text = String::new();
        loop {
            match chars.next() {
                Some((_, '"')) => break,
                Some((_, '\\')) => text.extend(chars.next().map(|(_, c)| c)),
                Some((_, c)) => text.push(c),
                None => return Err(column),
            }
        }
        tokens.push(FieldToken { column, text, is_quoted: true });
    }
    Ok(tokens)
}

/// Returns the tokens of a field.
pub(super) fn field_tokens(
    field: CompositionField,
    text: &str,
) -> Result<Vec<FieldToken>, Mistake> {
    tokens(text).map_err(|column| Mistake::new(field, column, "a quote has no end: \"text\""))
}

/// Writes a text in quotes, as [`tokens`] reads it.
pub(super) fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        if matches!(c, '"' | '\\') {
            quoted.push('\\');
        }
        quoted.push(c);
    }
    quoted.push('"');
    quoted
}

/// Reads a number: `12`, `0x0C`.
pub(super) fn number(text: &str) -> Option<u32> {
    let hex = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    let (digits, radix) = hex.map_or((text, 10), |hex| (hex, 16));
    // from_str_radix takes a sign.
    let is_plain = digits.chars().all(|c| c.is_ascii_hexdigit());
    u32::from_str_radix(digits, radix).ok().filter(|_| is_plain)
}

/// Adds the word that is most like a wrong one.
pub(super) fn with_near<'a>(
    text: String,
    word: &str,
    known: impl Iterator<Item = &'a str>,
) -> String {
    match nearest_word(&word.to_lowercase(), known) {
        Some(near) => format!("{text}; did you mean {}?", printable(near.as_bytes())),
        None => text,
    }
}

/// To whom a frame goes, as typed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum TypedReceiver {
    /// Nothing is typed.
    None,
    /// One node; `works`: as typed.
    One { who: Who, works: Option<bool>, column: usize },
    /// All nodes; `works`: only those in a working mode, or the others.
    All { works: Option<bool>, rnd7: Option<u8> },
}

/// One node, as typed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Who {
    Address(Address),
    /// Name or UID.
    Named(String),
}

/// Reads the receiver.
pub(super) fn target(text: &str) -> Result<TypedReceiver, Mistake> {
    let field = CompositionField::To;
    let all = field_tokens(field, text)?;
    let mut rest = all.iter();
    let Some(first) = rest.clone().next() else { return Ok(TypedReceiver::None) };
    let mut who = None;
    let is_all = first.is("all");
    if is_all {
        rest.next();
    } else if !first.is("rnd") {
        rest.next();
        who = Some(one(first)?);
    }
    let (mut works, mut rnd7) = (None, None);
    while let Some(token) = rest.next() {
        if token.is("working") {
            works = Some(true);
        } else if token.is("not-working") || token.is("non-working") {
            works = Some(false);
        } else if token.is("rnd") && who.is_none() {
            let number = rest.next().and_then(|it| number(&it.text)).filter(|it| *it < 128);
            let Some(number) = number else {
                return Err(Mistake::new(field, token.column, "rnd needs a number, 0 to 127"));
            };
            rnd7 = Some(number as u8);
        } else {
            let after = if who.is_some() {
                "working or not-working"
            } else {
                "working, not-working or rnd"
            };
            let text = format!("{} is not understood after the receiver: {after}", token.shown());
            let near = ["working", "not-working", "rnd"].into_iter();
            let text = with_near(text, &token.text, near);
            return Err(Mistake::new(field, token.column, text));
        }
    }
    Ok(match who {
        Some(who) => TypedReceiver::One { who, works, column: first.column },
        None => TypedReceiver::All { works, rnd7 },
    })
}

fn one(token: &FieldToken) -> Result<Who, Mistake> {
    if token.is_quoted {
        return Ok(Who::Named(token.text.clone()));
    }
    let text = token.text.strip_prefix('@').unwrap_or(&token.text);
    match number(text) {
        Some(number) => {
            let address = u8::try_from(number).ok().and_then(Address::new);
            let address = address.ok_or_else(|| {
                let text = format!("{} is not an address: 0 to 127", token.shown());
                Mistake::new(CompositionField::To, token.column, text)
            })?;
            Ok(Who::Address(address))
        }
        None if text.len() < token.text.len() => {
            let text = format!("{} is not an address: @0 to @127", token.shown());
            Err(Mistake::new(CompositionField::To, token.column, text))
        }
        None => Ok(Who::Named(token.text.clone())),
    }
}

/// Who sends, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TypedSender {
    /// `None`: descan.
    pub address: Option<Address>,
    /// U = 1.
    pub not_working: bool,
}

/// Reads the sender.
pub(super) fn sender(text: &str) -> Result<TypedSender, Mistake> {
    let field = CompositionField::From;
    let mut sender = TypedSender { address: None, not_working: false };
    for (at, token) in field_tokens(field, text)?.iter().enumerate() {
        let digits = token.text.strip_prefix('@').unwrap_or(&token.text);
        let address = number(digits).and_then(|it| u8::try_from(it).ok()).and_then(Address::new);
        if token.is("not-working") || token.is("non-working") {
            sender.not_working = true;
        } else if token.is("working") {
            sender.not_working = false;
        } else if let Some(address) = address.filter(|_| at == 0) {
            sender.address = Some(address);
        } else {
            let text =
                format!("{} is not a sender: an address 0 to 127, not-working", token.shown());
            let text = with_near(text, &token.text, ["not-working", "working"].into_iter());
            return Err(Mistake::new(field, token.column, text));
        }
    }
    Ok(sender)
}

/// A name by which a service can be typed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceWord {
    /// The word.
    pub word: String,
    /// The number.
    pub service: Service,
}

impl ServiceWord {
    /// The names of services that a profile has, those of the platform first; of debug messages their
    /// codes.
    pub fn all(profile: &Profile, kind: MessageKind) -> Vec<Self> {
        let mut all = Vec::new();
        let mut add = |word: &str, number: u16| {
            if !word.contains(char::is_whitespace) && !word.is_empty() {
                all.push(Self { word: word.to_owned(), service: Service::from_bits(number) });
            }
        };
        if kind == MessageKind::Debug {
            profile.debug_names.iter().for_each(|(code, name)| add(name, *code));
            return all;
        }
        add("des", profile.services.des);
        add("heartbeat", profile.services.heartbeat);
        add("identify", profile.commands.identify);
        add("mode", profile.commands.mode);
        if let Some(number) = profile.commands.reboot {
            add("restart", number);
        }
        for (word, number) in
            [("address", profile.writes.address), ("bitrate", profile.writes.bitrate)]
        {
            if let Some(number) = number {
                add(word, number);
            }
        }
        for field in DescriptorField::ALL {
            add(field.name(), field.service(&profile.descriptor).number());
        }
        profile.service_names.iter().for_each(|(number, name)| add(name, *number));
        all
    }
}

/// Reads a service number, or the code of a debug message.
pub(super) fn service(
    text: &str,
    profile: &Profile,
    kind: MessageKind,
) -> Result<Service, Mistake> {
    let field = CompositionField::Service;
    let what = if kind == MessageKind::Debug { "code" } else { "service" };
    let all = field_tokens(field, text)?;
    let words = ServiceWord::all(profile, kind);
    let [token] = &all[..] else {
        let column = all.get(1).map_or(0, |it| it.column);
        let example = if kind == MessageKind::Debug { "0x005" } else { "des, 0x123" };
        return Err(Mistake::new(field, column, format!("one {what} is needed: {example}")));
    };
    if let Some(number) = number(&token.text).filter(|_| !token.is_quoted) {
        let service = u16::try_from(number).ok().and_then(Service::new);
        return service.ok_or_else(|| {
            let text = format!("{} is too large: 0x000 to 0x3FF", token.shown());
            Mistake::new(field, token.column, text)
        });
    }
    let found = words.iter().find(|it| it.word.eq_ignore_ascii_case(&token.text));
    found.map(|it| it.service).ok_or_else(|| {
        let text = format!("{} is not a {what}: a number as 0x123, or a name", token.shown());
        let lower: Vec<String> = words.iter().map(|it| it.word.to_lowercase()).collect();
        let text = with_near(text, &token.text, lower.iter().map(String::as_str));
        Mistake::new(field, token.column, text)
    })
}

/// Reads the data of a message to a service.
pub(super) fn data(
    text: &str,
    service: Service,
    kind: MessageKind,
    profile: &Profile,
) -> Result<Vec<u8>, Mistake> {
    let field = CompositionField::Data;
    let is_request = kind == MessageKind::Request;
    let is_des = is_request && service == profile.des_service();
    let is_mode = is_request && service.number() == profile.commands.mode;
    let mut data = Vec::new();
    for token in field_tokens(field, text)? {
        if token.is_quoted {
            data.extend_from_slice(token.text.as_bytes());
            continue;
        }
        let mode = Mode::from_name(&token.text.to_uppercase()).filter(|_| is_mode);
        if is_des && token.is("name") {
            data.extend_from_slice(&Request::Name.encode());
        } else if is_des && token.is("services") {
            data.extend_from_slice(&Request::Services.encode());
        } else if let Some(mode) = mode {
            data.push(profile.modes.codes()[mode as usize]);
        } else {
            let words: &[&str] = match (is_des, is_mode) {
                (true, _) => &["name", "services"],
                (_, true) => &["cfg", "boot", "work", "idle"],
                _ => &[],
            };
            bytes(&token, words, &mut data)?;
        }
    }
    Ok(data)
}

/// Reads hexadecimal bytes.
fn bytes(token: &FieldToken, words: &[&str], data: &mut Vec<u8>) -> Result<(), Mistake> {
    let wrong = |at: usize, text: String| {
        Err(Mistake::new(CompositionField::Data, token.column + at, text))
    };
    let prefix = if token.text.starts_with("0x") || token.text.starts_with("0X") { 2 } else { 0 };
    let digits: Vec<char> = token.text.chars().skip(prefix).collect();
    let or_words = [&[""], words].concat().join(", ");
    if let Some(at) = digits.iter().position(|c| !c.is_ascii_hexdigit()) {
        let text = format!("{} is not data: bytes as 01 FF, \"text\"{or_words}", token.shown());
        let text = with_near(text, &token.text, words.iter().copied());
        return wrong(if words.is_empty() { prefix + at } else { 0 }, text);
    }
    if digits.is_empty() || !digits.len().is_multiple_of(2) {
        return wrong(0, format!("{}: a byte has two digits, as 01", token.shown()));
    }
    let value = |c: char| c.to_digit(16).unwrap_or_default() as u8;
    data.extend(digits.chunks_exact(2).map(|pair| value(pair[0]) << 4 | value(pair[1])));
    Ok(())
}
