//! Reading of a DBC file.
//!
//! Read are messages and signals (`BO_`, `SG_`), names of values (`VAL_`), types of floating-point signals
//! (`SIG_VALTYPE_`) and multiplexors that are multiplexed (`SG_MUL_VAL_`). Other statements are passed over,
//! known or not. Text that is not UTF-8 is taken for Latin-1. The time and the memory are bounded by the
//! size of the file.

use super::signal::{MessageSignal, Multiplexed, SignalKind};
use super::tokens::{DbcToken, DbcTokenKind, DbcTokens};
use super::{EXTENDED, NamedMessage};
use crate::frame::CanId;
use crate::text::Escaped;
use crate::wire::descriptor::ByteOrder;
use std::borrow::Cow;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, HashMap};
use std::ops::RangeInclusive;

/// Largest file, in bytes.
pub const MAX_FILE: u64 = 16 << 20;
/// Most messages of a file.
pub const MAX_MESSAGES: usize = 1 << 16;
/// Most signals of a message.
const MAX_SIGNALS: usize = 1024;
/// Longest name, and longest unit or name of a value, in characters.
const MAX_NAME: usize = 128;
const MAX_TEXT: usize = 256;
/// Bits of the data of the longest frame.
const MAX_BITS: u32 = 512;
/// Message without an identifier, for signals that are in none.
const NO_MESSAGE: &str = "VECTOR__INDEPENDENT_SIG_MSG";

/// A mistake in a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {cause}")]
pub struct DbcError {
    /// Line, counted from 1.
    pub line: usize,
    /// What is wrong there, printable.
    pub cause: String,
}

impl DbcError {
    pub(super) fn new(line: usize, cause: impl Into<String>) -> Self {
        Self { line, cause: cause.into() }
    }
}

/// Reads the messages of a file, by their identifiers.
pub(super) fn read(bytes: &[u8]) -> Result<BTreeMap<u32, NamedMessage>, DbcError> {
    let text = match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => Cow::Owned(bytes.iter().copied().map(char::from).collect()),
    };
    let text = text.strip_prefix('\u{FEFF}').unwrap_or(&text);
    let mut reader = FileReader::new(text)?;
    reader.read_statements()?;
    reader.end()
}

/// A message while its file is read.
#[derive(Debug, Default)]
struct MessageDraft {
    message: NamedMessage,
    /// Places of signals by their names.
    places: HashMap<String, usize>,
    /// What each signal says of its multiplexor.
    switches: Vec<SwitchDraft>,
}

/// What a signal says of its multiplexor.
#[derive(Debug)]
struct SwitchDraft {
    line: usize,
    /// It is a multiplexor.
    is_switch: bool,
    /// Its value of `m3`.
    value: Option<u64>,
    /// The multiplexor and its values of `SG_MUL_VAL_`.
    extended: Option<(usize, Vec<RangeInclusive<u64>>)>,
}

struct FileReader<'t> {
    tokens: DbcTokens<'t>,
    /// The token that is next.
    next: Option<DbcToken<'t>>,
    messages: BTreeMap<u32, MessageDraft>,
    /// The message whose signals follow; `None` if they are passed over.
    current: Option<u32>,
}

impl<'t> FileReader<'t> {
    fn new(text: &'t str) -> Result<Self, DbcError> {
        let mut tokens = DbcTokens::new(text);
        let next = tokens.next()?;
        Ok(Self { tokens, next, messages: BTreeMap::new(), current: None })
    }

    fn read_statements(&mut self) -> Result<(), DbcError> {
        while let Some(token) = self.advance()? {
            match token.kind {
                _ if !token.is_first => {}
                DbcTokenKind::Word("NS_") => self.skip_new_symbols()?,
                DbcTokenKind::Word("BO_") => self.read_message()?,
                DbcTokenKind::Word("SG_") => self.read_signal(token.line)?,
                DbcTokenKind::Word("VAL_") => self.read_values()?,
                DbcTokenKind::Word("SIG_VALTYPE_") => self.read_type()?,
                DbcTokenKind::Word("SG_MUL_VAL_") => self.read_switch()?,
                _ => {}
            }
        }
        Ok(())
    }

    /// Passes over a list of keywords, which are indented.
    fn skip_new_symbols(&mut self) -> Result<(), DbcError> {
        while self.next.is_some_and(|token| !token.is_flush) {
            self.advance()?;
        }
        Ok(())
    }

    fn read_message(&mut self) -> Result<(), DbcError> {
        let line = self.line();
        let id = self.integer("an identifier")?;
        let name = self.name("the name of a message")?;
        self.sign(':')?;
        self.current = None;
        if name == NO_MESSAGE {
            return Ok(());
        }
        let key = u32::try_from(id).ok().filter(|id| is_id(*id));
        let key = key.ok_or_else(|| {
            DbcError::new(line, format!("{name}: no identifier of 11 or 29 bits: {id}"))
        })?;
        if self.messages.len() == MAX_MESSAGES {
            return Err(DbcError::new(line, format!("more than {MAX_MESSAGES} messages")));
        }
        if let Entry::Vacant(place) = self.messages.entry(key) {
            let message = NamedMessage { name, signals: Vec::new() };
            place.insert(MessageDraft { message, ..MessageDraft::default() });
            self.current = Some(key);
        }
        Ok(())
    }

    /// Reads `SG_ Name m1 : 0|8@1+ (1,0) [0|0] "unit" …`.
    fn read_signal(&mut self, line: usize) -> Result<(), DbcError> {
        let name = self.name("the name of a signal")?;
        let (mut is_switch, mut value) = (false, None);
        if let Some(DbcToken { kind: DbcTokenKind::Word(word), line, .. }) = self.next {
            self.advance()?;
            let digits = word.strip_prefix('m').map(|rest| rest.strip_suffix('M').unwrap_or(rest));
            value = digits.and_then(|digits| digits.parse().ok());
            is_switch = word == "M" || digits.is_some() && word.ends_with('M');
            if value.is_none() && word != "M" {
                let word = Escaped(word.as_bytes());
                return Err(DbcError::new(line, format!("{name}: no multiplexor: {word}")));
            }
        }
        self.sign(':')?;
        let start = self.integer("the first bit")?;
        self.sign('|')?;
        let size = self.integer("a number of bits")?;
        self.sign('@')?;
        let (order, kind) = match self.word("the byte order and the sign")? {
            "1+" => (ByteOrder::Little, SignalKind::Unsigned),
            "1-" => (ByteOrder::Little, SignalKind::Signed),
            "0+" => (ByteOrder::Big, SignalKind::Unsigned),
            "0-" => (ByteOrder::Big, SignalKind::Signed),
            _ => return Err(self.expected("0+, 0-, 1+ or 1- behind @")),
        };
        self.sign('(')?;
        let factor = self.number("the factor")?;
        self.sign(',')?;
        let offset = self.number("the offset")?;
        self.sign(')')?;
        // The range of values is not used.
        if matches!(self.next, Some(DbcToken { kind: DbcTokenKind::Sign('['), .. })) {
            while !matches!(
                self.advance()?,
                None | Some(DbcToken { kind: DbcTokenKind::Sign(']'), .. })
            ) {}
        }
        let unit = self.quoted("the unit in quotes")?;
        let error = |cause: &str| DbcError::new(line, format!("{name}: {cause}"));
        let place = |number: u64, most: u32| u32::try_from(number).ok().filter(|it| *it <= most);
        let start = place(start, MAX_BITS - 1).ok_or_else(|| error("the first bit is 0 to 511"))?;
        let size = place(size, 64).filter(|size| *size > 0);
        let size = size.ok_or_else(|| error("the number of bits is 1 to 64"))?;
        if !factor.is_finite() || !offset.is_finite() {
            return Err(error("the factor and the offset are numbers"));
        }
        let Some(draft) = self.current.and_then(|id| self.messages.get_mut(&id)) else {
            return Ok(());
        };
        let at = draft.message.signals.len();
        if at == MAX_SIGNALS {
            return Err(error("more than 1024 signals in one message"));
        }
        if draft.places.insert(name.clone(), at).is_some() {
            return Err(error("two signals have this name"));
        }
        draft.switches.push(SwitchDraft { line, is_switch, value, extended: None });
        draft.message.signals.push(MessageSignal {
            name,
            unit,
            kind,
            order,
            start,
            size,
            factor,
            offset,
            values: BTreeMap::new(),
            multiplexed: None,
        });
        Ok(())
    }

    /// Reads `VAL_ 100 Signal 1 "on" 0 "off" ;`; one of an environment variable has no identifier.
    fn read_values(&mut self) -> Result<(), DbcError> {
        let Some((id, place)) = self.signal_place()? else { return Ok(()) };
        let mut values = BTreeMap::new();
        while let Some(DbcToken { kind: DbcTokenKind::Word(_), .. }) = self.next {
            let number = self.number("a value")?;
            let text = self.quoted("the name of the value in quotes")?;
            // Numbers that no signal has are left out.
            if number.fract() == 0.0 && number.abs() < 9.2e18 {
                values.insert(number as i64, text);
            }
        }
        self.sign(';')?;
        if let Some(signal) = self.signal_mut(id, place) {
            signal.values = values;
        }
        Ok(())
    }

    /// Reads `SIG_VALTYPE_ 100 Signal : 1;`.
    fn read_type(&mut self) -> Result<(), DbcError> {
        let line = self.line();
        let Some((id, place)) = self.signal_place()? else { return Ok(()) };
        if matches!(self.next, Some(DbcToken { kind: DbcTokenKind::Sign(':'), .. })) {
            self.advance()?;
        }
        let kind = self.integer("a type")?;
        let Some(signal) = self.signal_mut(id, place) else { return Ok(()) };
        let (kind, size) = match kind {
            0 => return Ok(()),
            1 => (SignalKind::Float, 32),
            2 => (SignalKind::Double, 64),
            _ => return Err(DbcError::new(line, format!("{}: a type is 0, 1 or 2", signal.name))),
        };
        if signal.size != size {
            let cause = format!("{}: a number of this type has {size} bits", signal.name);
            return Err(DbcError::new(line, cause));
        }
        signal.kind = kind;
        Ok(())
    }

    /// Reads `SG_MUL_VAL_ 100 Signal Multiplexor 0-3, 7-7;`.
    fn read_switch(&mut self) -> Result<(), DbcError> {
        let Some((id, place)) = self.signal_place()? else { return Ok(()) };
        let line = self.line();
        let switch = self.name("the name of a multiplexor")?;
        let mut ranges = Vec::new();
        while let Some(DbcToken { kind: DbcTokenKind::Word(word), line, .. }) = self.next {
            self.advance()?;
            let ends = word.split_once('-').map(|(least, most)| (least.parse(), most.parse()));
            let Some((Ok(least), Ok(most))) = ends else {
                let word = Escaped(word.as_bytes());
                return Err(DbcError::new(line, format!("no range of values such as 0-3: {word}")));
            };
            ranges.push(least..=most);
            if matches!(self.next, Some(DbcToken { kind: DbcTokenKind::Sign(','), .. })) {
                self.advance()?;
            }
        }
        let Some(draft) = self.messages.get_mut(&id) else { return Ok(()) };
        let by = draft.places.get(&switch).copied();
        let by = by.ok_or_else(|| {
            DbcError::new(line, format!("{}: no signal {switch}", draft.message.name))
        })?;
        if let Some(own) = draft.switches.get_mut(place) {
            own.extended = Some((by, ranges));
        }
        Ok(())
    }

    /// Reads an identifier and the name of a signal; returns where that is. `None` if there is no such
    /// message or signal.
    fn signal_place(&mut self) -> Result<Option<(u32, usize)>, DbcError> {
        let Some(DbcToken { kind: DbcTokenKind::Word(word), .. }) = self.next else {
            return Ok(None);
        };
        let Ok(id) = word.parse::<u32>() else { return Ok(None) };
        self.advance()?;
        let name = self.name("the name of a signal")?;
        let place = self.messages.get(&id).and_then(|draft| draft.places.get(&name));
        Ok(place.map(|place| (id, *place)))
    }

    fn signal_mut(&mut self, id: u32, place: usize) -> Option<&mut MessageSignal> {
        self.messages.get_mut(&id)?.message.signals.get_mut(place)
    }

    /// Connects signals with their multiplexors; returns the messages.
    fn end(self) -> Result<BTreeMap<u32, NamedMessage>, DbcError> {
        if self.messages.is_empty() {
            return Err(DbcError::new(self.tokens.line(), "no message (BO_) in the file"));
        }
        self.messages.into_iter().map(|(id, draft)| Ok((id, draft.end()?))).collect()
    }

    // ---- tokens ----------------------------------------------------------------------------

    fn line(&self) -> usize {
        self.next.map_or(self.tokens.line(), |token| token.line)
    }

    fn advance(&mut self) -> Result<Option<DbcToken<'t>>, DbcError> {
        let next = self.tokens.next()?;
        Ok(std::mem::replace(&mut self.next, next))
    }

    fn expected(&self, what: &str) -> DbcError {
        DbcError::new(self.line(), format!("expected {what}"))
    }

    fn word(&mut self, what: &str) -> Result<&'t str, DbcError> {
        match self.next {
            Some(DbcToken { kind: DbcTokenKind::Word(word), .. }) => {
                self.advance()?;
                Ok(word)
            }
            _ => Err(self.expected(what)),
        }
    }

    fn name(&mut self, what: &str) -> Result<String, DbcError> {
        let error = self.expected(what);
        let word = self.word(what)?;
        let is_name = word.len() <= MAX_NAME
            && word.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
        if is_name { Ok(word.to_owned()) } else { Err(error) }
    }

    fn integer(&mut self, what: &str) -> Result<u64, DbcError> {
        let error = self.expected(what);
        self.word(what)?.parse().map_err(|_| error)
    }

    fn number(&mut self, what: &str) -> Result<f64, DbcError> {
        let error = self.expected(what);
        self.word(what)?.parse().map_err(|_| error)
    }

    fn quoted(&mut self, what: &str) -> Result<String, DbcError> {
        match self.next {
            Some(DbcToken { kind: DbcTokenKind::Quoted(text), .. }) => {
                self.advance()?;
                let start: String = text.chars().take(MAX_TEXT).collect();
                Ok(Escaped(start.as_bytes()).to_string())
            }
            _ => Err(self.expected(what)),
        }
    }

    fn sign(&mut self, sign: char) -> Result<(), DbcError> {
        match self.next {
            Some(DbcToken { kind: DbcTokenKind::Sign(found), .. }) if found == sign => {
                self.advance()?;
                Ok(())
            }
            _ => Err(self.expected(&format!("\"{sign}\""))),
        }
    }
}

impl MessageDraft {
    /// Connects signals with their multiplexors.
    fn end(self) -> Result<NamedMessage, DbcError> {
        let mut message = self.message;
        // Without SG_MUL_VAL_ there is one multiplexor.
        let only = self.switches.iter().position(|switch| switch.is_switch);
        for (signal, switch) in message.signals.iter_mut().zip(self.switches) {
            signal.multiplexed = match (switch.extended, switch.value, only) {
                (Some((by, values)), ..) => Some(Multiplexed { by, values }),
                (None, None, _) => None,
                (None, Some(value), Some(by)) => {
                    Some(Multiplexed { by, values: vec![value..=value] })
                }
                (None, Some(_), None) => {
                    let cause = format!("{}: the message has no multiplexor (M)", signal.name);
                    return Err(DbcError::new(switch.line, cause));
                }
            };
        }
        Ok(message)
    }
}

/// Returns true for an identifier of 11 bits, and for one of 29 bits with [`EXTENDED`].
fn is_id(id: u32) -> bool {
    match id & EXTENDED {
        0 => id <= u32::from(CanId::MAX_STANDARD),
        _ => id & !EXTENDED <= CanId::MAX_EXTENDED,
    }
}
