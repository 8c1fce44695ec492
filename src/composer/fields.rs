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

/// Splits a field at white space; what stands in `"` is one token, in which `\"` and `\\` are a quote
/// and a backslash. Other backslashes are themselves, as in the printed form of a name.
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
                Some((_, '\\')) => {
                    let escaped = chars.next_if(|(_, c)| matches!(c, '"' | '\\'));
                    text.push(escaped.map_or('\\', |(_, c)| c));
                }
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

/// Reads the receiver, and the words that belong to it, in any order.
pub(super) fn target(text: &str) -> Result<TypedReceiver, Mistake> {
    let field = CompositionField::To;
    let wrong = |token: &FieldToken, text: String| Mistake::new(field, token.column, text);
    let all = field_tokens(field, text)?;
    let (mut who, mut is_all, mut works, mut rnd) = (None, false, None, None);
    let mut rest = all.iter();
    while let Some(token) = rest.next() {
        if let Some(mode) = works_of(token) {
            set_once(&mut works, mode, token, field)?;
        } else if token.is("rnd") && rnd.is_none() {
            let number = rest.next().and_then(|it| number(&it.text)).filter(|it| *it < 128);
            let number = number.ok_or_else(|| wrong(token, "rnd needs a number, 0 to 127".into()));
            rnd = Some((token, number? as u8));
        } else if token.is("all") && who.is_none() && !is_all {
            is_all = true;
        } else if who.is_none() && !is_all && !token.is("rnd") {
            who = Some((one(token)?, token.column));
        } else {
            return Err(not_after_receiver(token, who.is_some()));
        }
    }
    match (who, rnd, all.first()) {
        (Some(_), Some((rnd, _)), _) => {
            Err(wrong(rnd, "rnd is the DST of a broadcast: to all rnd 85".to_owned()))
        }
        (Some((who, column)), None, _) => Ok(TypedReceiver::One { who, works, column }),
        (None, _, None) => Ok(TypedReceiver::None),
        (None, None, Some(first)) if !is_all => {
            let word = first.shown();
            let text = format!("{word} needs a receiver: FEED {word}, or all {word}");
            Err(wrong(first, text))
        }
        (None, rnd, _) => Ok(TypedReceiver::All { works, rnd7: rnd.map(|(_, number)| number) }),
    }
}

/// The mistake of a word that belongs to no receiver.
fn not_after_receiver(token: &FieldToken, is_one: bool) -> Mistake {
    let words: &[&str] =
        if is_one { &["working", "not-working"] } else { &["working", "not-working", "rnd"] };
    let may_be = if is_one { "working or not-working" } else { "working, not-working or rnd" };
    let text = format!(
        "{} is not understood after the receiver: {may_be}; data there begins with data",
        token.shown()
    );
    let text = with_near(text, &token.text, words.iter().copied());
    Mistake::new(CompositionField::To, token.column, text)
}

/// The mode that a word names: working, or not.
fn works_of(token: &FieldToken) -> Option<bool> {
    if token.is("not-working") || token.is("non-working") {
        return Some(false);
    }
    token.is("working").then_some(true)
}

/// Notes a mode; a second one is a mistake.
fn set_once(
    mode: &mut Option<bool>,
    new: bool,
    token: &FieldToken,
    field: CompositionField,
) -> Result<(), Mistake> {
    if mode.replace(new).is_some() {
        let text = "one of working and not-working, once".to_owned();
        return Err(Mistake::new(field, token.column, text));
    }
    Ok(())
}

/// The column of a word that makes the receiver one that does not work.
pub(super) fn not_working_column(text: &str) -> Option<usize> {
    let all = tokens(text).ok()?;
    all.iter().find(|token| works_of(token) == Some(false)).map(|token| token.column)
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
    let (mut from, mut works) = (None, None);
    for token in &field_tokens(field, text)? {
        let digits = token.text.strip_prefix('@').unwrap_or(&token.text);
        let address = number(digits).and_then(|it| u8::try_from(it).ok()).and_then(Address::new);
        if let Some(mode) = works_of(token) {
            set_once(&mut works, mode, token, field)?;
        } else if let Some(address) = address.filter(|_| from.is_none()) {
            from = Some(address);
        } else {
            let text =
                format!("{} is not a sender: an address 0 to 127, not-working", token.shown());
            let text = with_near(text, &token.text, ["not-working", "working"].into_iter());
            return Err(Mistake::new(field, token.column, text));
        }
    }
    Ok(TypedSender { address: from, not_working: works == Some(false) })
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
