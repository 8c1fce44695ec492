//! Reading of a DBC file.
//!
//! Read are messages and signals (`BO_`, `SG_`), names of values (`VAL_`), types of floating-point signals
//! (`SIG_VALTYPE_`), multiplexors that are multiplexed (`SG_MUL_VAL_`), and, of the attributes (`BA_`), names of
//! over 32 characters and which messages are of J1939, in any order and wherever they stand in a line. Other statements are passed over,
//! known or not. Text is UTF-8, or UTF-16 where its first bytes say so; what is neither is taken for Latin-1.
//! The time and the memory are bounded by the size of the file.

use super::decimal::DecimalFactor;
use super::signal::{MessageSignal, Multiplexed, SignalKind};
use super::tokens::{DbcToken, DbcTokenKind, DbcTokens};
use super::{EXTENDED, NamedMessage};
use crate::frame::CanId;
use crate::text::{Escaped, printable_with_backslashes};
use crate::wire::descriptor::ByteOrder;
use std::borrow::Cow;
use std::collections::btree_map::Entry;
use std::collections::hash_map;
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
/// Bits of the longest message of several frames, of J1939.
const MAX_GROUP_BITS: u32 = 8 * 1785;
/// Place of a multiplexor that is left out: signals that depend on it are never there.
const LEFT_OUT: usize = usize::MAX;
/// Message without an identifier, for signals that are in none.
const NO_MESSAGE: &str = "VECTOR__INDEPENDENT_SIG_MSG";
/// Attributes with the whole name of a message and of a signal, of which `BO_` and `SG_` have the beginning.
const LONG_MESSAGE_NAME: &str = "SystemMessageLongSymbol";
const LONG_SIGNAL_NAME: &str = "SystemSignalLongSymbol";
/// Attribute with the kind of frame of a message, and its value for a parameter group of J1939: the word of its
/// definition, and the number of that where the file does not define it.
const FRAME_FORMAT: &str = "VFrameFormat";
const PARAMETER_GROUP: &str = "J1939PG";
const PARAMETER_GROUP_NUMBER: usize = 3;
/// Statements up to a semicolon that are passed over; they may have the keywords of others in them.
const PASSED_OVER: [&str; 23] = [
    "BA_DEF_DEF_REL_",
    "BA_DEF_REL_",
    "BA_DEF_SGTYPE_",
    "BA_REL_",
    "BA_SGTYPE_",
    "BO_TX_BU_",
    "BU_BO_REL_",
    "BU_EV_REL_",
    "BU_SG_REL_",
    "CAT_",
    "CAT_DEF_",
    "CM_",
    "ENVVAR_DATA_",
    "EV_",
    "EV_DATA_",
    "FILTER",
    "SGTYPE_",
    "SGTYPE_VAL_",
    "SIGTYPE_VALTYPE_",
    "SIG_GROUP_",
    "SIG_TYPE_REF_",
    "VAL_TABLE_",
    "NS_DESC_",
];

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
    let text = decode(bytes);
    let text = text.strip_prefix('\u{FEFF}').unwrap_or(&text);
    let mut reader = FileReader::new(text)?;
    reader.read_statements()?;
    reader.end()
}

/// Returns the text of a file.
fn decode(bytes: &[u8]) -> Cow<'_, str> {
    let in_16_bits = |unit: fn([u8; 2]) -> u16| {
        let (pairs, _) = bytes.as_chunks::<2>();
        let units = pairs.iter().map(|pair| unit(*pair));
        char::decode_utf16(units).map(|it| it.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
    };
    match bytes {
        [0xFF, 0xFE, ..] => Cow::Owned(in_16_bits(u16::from_le_bytes)),
        [0xFE, 0xFF, ..] => Cow::Owned(in_16_bits(u16::from_be_bytes)),
        _ => match std::str::from_utf8(bytes) {
            Ok(text) => Cow::Borrowed(text),
            Err(_) => Cow::Owned(bytes.iter().copied().map(char::from).collect()),
        },
    }
}

/// A message while its file is read.
#[derive(Debug, Default)]
struct MessageDraft {
    message: NamedMessage,
    /// Places of signals by their names.
    places: HashMap<String, usize>,
    /// What each signal says of its multiplexor.
    switches: Vec<SwitchDraft>,
    /// Signals that are left out; true for a multiplexor.
    left_out: HashMap<String, bool>,
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
    /// What is said of signals, which may be defined later.
    facts: Vec<SignalFact>,
    /// Long names of messages, by their identifiers.
    long_names: BTreeMap<u32, String>,
    formats: FrameFormats,
}

/// What a file says of [`FRAME_FORMAT`].
#[derive(Debug, Default)]
struct FrameFormats {
    group: FormatGroup,
    /// The value of messages without the attribute.
    default: Option<FormatValue>,
    /// The value of each message that has the attribute.
    values: BTreeMap<u32, FormatValue>,
}

/// The number of [`PARAMETER_GROUP`] among the words of [`FRAME_FORMAT`].
#[derive(Debug, Default)]
enum FormatGroup {
    /// The file does not define the words.
    #[default]
    Usual,
    Number(usize),
    /// It is not among the words.
    None,
}

/// A value of [`FRAME_FORMAT`].
#[derive(Debug)]
enum FormatValue {
    /// Its number among the words.
    Number(usize),
    /// True if the word is [`PARAMETER_GROUP`].
    IsGroup(bool),
}

impl FrameFormats {
    fn is_parameter_group(&self, id: u32) -> bool {
        let is_group = match self.values.get(&id).or(self.default.as_ref()) {
            Some(FormatValue::Number(number)) => match self.group {
                FormatGroup::Usual => *number == PARAMETER_GROUP_NUMBER,
                FormatGroup::Number(group) => *number == group,
                FormatGroup::None => false,
            },
            Some(FormatValue::IsGroup(is_group)) => *is_group,
            None => false,
        };
        is_group && id & EXTENDED != 0
    }
}

/// What a statement says of a signal.
#[derive(Debug)]
struct SignalFact {
    line: usize,
    /// Identifier of the message.
    id: u32,
    signal: String,
    kind: FactKind,
}

#[derive(Debug)]
enum FactKind {
    Values(BTreeMap<i128, String>),
    /// A type of `SIG_VALTYPE_`.
    Type(u64),
    LongName(String),
    /// A multiplexor, and the values at which the signal is there.
    Switch(String, Vec<RangeInclusive<u64>>),
}

impl<'t> FileReader<'t> {
    fn new(text: &'t str) -> Result<Self, DbcError> {
        let mut tokens = DbcTokens::new(text);
        let next = tokens.next()?;
        Ok(Self {
            tokens,
            next,
            messages: BTreeMap::new(),
            current: None,
            facts: Vec::new(),
            long_names: BTreeMap::new(),
            formats: FrameFormats::default(),
        })
    }

    fn read_statements(&mut self) -> Result<(), DbcError> {
        while let Some(token) = self.advance()? {
            match token.kind {
                DbcTokenKind::Word("NS_") => self.skip_new_symbols()?,
                DbcTokenKind::Word("BO_") => self.read_message()?,
                DbcTokenKind::Word("SG_") => self.read_signal(token.line)?,
                DbcTokenKind::Word("VAL_") => self.read_values()?,
                DbcTokenKind::Word("SIG_VALTYPE_") => self.read_type()?,
                DbcTokenKind::Word("SG_MUL_VAL_") => self.read_switch()?,
                DbcTokenKind::Word("BA_") => self.read_attribute()?,
                DbcTokenKind::Word("BA_DEF_") => self.read_attribute_words()?,
                DbcTokenKind::Word("BA_DEF_DEF_") => self.read_attribute_default()?,
                DbcTokenKind::Word(word) if PASSED_OVER.contains(&word) => self.skip_statement()?,
                // The rest of a statement, or a statement that is not known.
                _ => {}
            }
        }
        Ok(())
    }

    /// Passes over a list of keywords. It ends where BS_, BU_ or BO_ follows, and if it is indented, with
    /// the first line that is not.
    fn skip_new_symbols(&mut self) -> Result<(), DbcError> {
        let mut is_indented = false;
        while let Some(token) = self.next {
            let is_end = matches!(token.kind, DbcTokenKind::Word("BS_" | "BU_" | "BO_"));
            if is_end || token.is_flush && is_indented {
                break;
            }
            is_indented |= !token.is_flush && matches!(token.kind, DbcTokenKind::Word(_));
            self.advance()?;
        }
        Ok(())
    }

    /// Passes over a statement; without its semicolon, up to a line that begins with another one.
    fn skip_statement(&mut self) -> Result<(), DbcError> {
        self.skip_rest(true)
    }

    /// Passes over the rest of a statement; `is_first`: of all behind its keyword.
    fn skip_rest(&mut self, mut is_first: bool) -> Result<(), DbcError> {
        while let Some(token) = self.next {
            // The kind of its object, as in `CM_ BO_ 100 "text";`, may begin a line.
            if token.is_flush && !is_first && self.is_statement(token)? {
                break;
            }
            is_first = false;
            self.advance()?;
            if token.kind == DbcTokenKind::Sign(';') {
                break;
            }
        }
        Ok(())
    }

    /// Returns true for the keyword of a statement; not for `BO_` and `BU_` as kinds of objects.
    fn is_statement(&self, token: DbcToken<'t>) -> Result<bool, DbcError> {
        let DbcTokenKind::Word(word) = token.kind else { return Ok(false) };
        let words_before_colon = match word {
            "BO_" => 2,
            "BU_" => 0,
            "BA_" | "BA_DEF_" | "BA_DEF_DEF_" | "VAL_" | "SIG_VALTYPE_" | "SG_MUL_VAL_" => {
                return Ok(true);
            }
            _ => return Ok(PASSED_OVER.contains(&word)),
        };
        let mut tokens = self.tokens.clone();
        for _ in 0..words_before_colon {
            if !matches!(tokens.next()?, Some(DbcToken { kind: DbcTokenKind::Word(_), .. })) {
                return Ok(false);
            }
        }
        Ok(matches!(tokens.next()?, Some(DbcToken { kind: DbcTokenKind::Sign(':'), .. })))
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
            let message = NamedMessage { name, ..NamedMessage::default() };
            place.insert(MessageDraft { message, ..MessageDraft::default() });
            self.current = Some(key);
        }
        Ok(())
    }

    /// Reads `SG_ Name m1 : 0|8@1+ (1,0) [0|0] "unit" …`.
    fn read_signal(&mut self, line: usize) -> Result<(), DbcError> {
        let name = self.name("the name of a signal")?;
        let (mut is_switch, mut value, mut is_left_out) = (false, None, false);
        if let Some(DbcToken { kind: DbcTokenKind::Word(word), line, .. }) = self.next {
            self.advance()?;
            let digits = word.strip_prefix('m').map(|rest| rest.strip_suffix('M').unwrap_or(rest));
            value = digits.and_then(|digits| digits.parse().ok());
            is_switch = word == "M" || digits.is_some() && word.ends_with('M');
            is_left_out = word == "m";
            if value.is_none() && word != "M" && !is_left_out {
                let word = Escaped(word.as_bytes());
                return Err(DbcError::new(line, format!("{name}: no multiplexor: {word}")));
            }
        }
        self.sign(':')?;
        let start = self.integer("the first bit")?;
        self.sign('|')?;
        let size = self.integer("a number of bits")?;
        self.sign('@')?;
        let (order, kind) = self.order_and_sign()?;
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
        let start =
            place(start, MAX_GROUP_BITS - 1).ok_or_else(|| error("the first bit is 0 to 14279"))?;
        let size = place(size, MAX_GROUP_BITS).filter(|size| *size > 0);
        let size = size.ok_or_else(|| error("the number of bits is 1 to 14280"))?;
        if !factor.is_finite() || !offset.is_finite() {
            return Err(error("the factor and the offset are numbers"));
        }
        let Some(draft) = self.current.and_then(|id| self.messages.get_mut(&id)) else {
            return Ok(());
        };
        // A signal of over 64 bits has no value as a number, and is left out; so is one that is only in a
        // message of several frames, and one that is there at values that the file does not name.
        if size > 64 || start >= MAX_BITS || is_left_out {
            if draft.left_out.len() < MAX_SIGNALS {
                draft.left_out.insert(name, is_switch);
            }
            return Ok(());
        }
        let at = draft.message.signals.len();
        if at == MAX_SIGNALS {
            return Err(error("more than 1024 signals in one message"));
        }
        // Values are named by their signals: of equal names the first one stays.
        let hash_map::Entry::Vacant(place) = draft.places.entry(name.clone()) else {
            return Ok(());
        };
        place.insert(at);
        draft.switches.push(SwitchDraft { line, is_switch, value, extended: None });
        draft.message.signals.push(MessageSignal {
            name,
            unit,
            kind,
            order,
            start,
            size,
            factor: DecimalFactor::new(factor),
            offset: DecimalFactor::new(offset),
            values: BTreeMap::new(),
            multiplexed: None,
        });
        Ok(())
    }

    /// Reads `1+` and the like, also with a blank in it.
    fn order_and_sign(&mut self) -> Result<(ByteOrder, SignalKind), DbcError> {
        let word = self.word("the byte order and the sign")?;
        let (order, sign) = match word.split_at_checked(1) {
            Some((order, "")) => (order, self.word("+ or - behind the byte order")?),
            Some(both) => both,
            None => ("", ""),
        };
        let order = match order {
            "0" => Some(ByteOrder::Big),
            "1" => Some(ByteOrder::Little),
            _ => None,
        };
        let kind = match sign {
            "+" => Some(SignalKind::Unsigned),
            "-" => Some(SignalKind::Signed),
            _ => None,
        };
        order.zip(kind).ok_or_else(|| self.expected("0+, 0-, 1+ or 1- behind @"))
    }

    /// Reads `VAL_ 100 Signal 1 "on" 0 "off" ;`; one of an environment variable has no identifier.
    fn read_values(&mut self) -> Result<(), DbcError> {
        let Some((id, signal)) = self.signal_name()? else { return Ok(()) };
        let line = self.line();
        let mut values = BTreeMap::new();
        while let Some(DbcToken { kind: DbcTokenKind::Word(word), .. }) = self.next {
            let number = self.number("a value")?;
            let text = self.quoted("the name of the value in quotes")?;
            if text.trim().is_empty() {
                continue;
            }
            let whole = Some(number).filter(|it| it.fract() == 0.0 && it.abs() < 1e20);
            // Floating point has not all digits of 64 bits. Numbers that no signal has are left out.
            if let Some(number) = word.parse().ok().or(whole.map(|it| it as i128)) {
                values.insert(number, text);
            }
        }
        self.sign(';')?;
        self.facts.push(SignalFact { line, id, signal, kind: FactKind::Values(values) });
        Ok(())
    }

    /// Reads `SIG_VALTYPE_ 100 Signal : 1;`.
    fn read_type(&mut self) -> Result<(), DbcError> {
        let line = self.line();
        let Some((id, signal)) = self.signal_name()? else { return Ok(()) };
        if matches!(self.next, Some(DbcToken { kind: DbcTokenKind::Sign(':'), .. })) {
            self.advance()?;
        }
        let kind = FactKind::Type(self.integer("a type")?);
        self.facts.push(SignalFact { line, id, signal, kind });
        Ok(())
    }

    /// Reads `SG_MUL_VAL_ 100 Signal Multiplexor 0-3, 7-7;`.
    fn read_switch(&mut self) -> Result<(), DbcError> {
        let Some((id, signal)) = self.signal_name()? else { return Ok(()) };
        let line = self.line();
        let switch = self.name("the name of a multiplexor")?;
        let mut ranges = Vec::new();
        while let Some(DbcToken { kind: DbcTokenKind::Word(word), line, .. }) = self.next {
            self.advance()?;
            let ends = word.split_once('-').map(|(least, most)| (least.parse(), most.parse()));
            match ends {
                Some((Ok(least), Ok(most))) if least <= most => ranges.push(least..=most),
                _ => {
                    let cause =
                        format!("no range of values such as 0-3: {}", Escaped(word.as_bytes()));
                    return Err(DbcError::new(line, cause));
                }
            }
            if matches!(self.next, Some(DbcToken { kind: DbcTokenKind::Sign(','), .. })) {
                self.advance()?;
            }
        }
        self.facts.push(SignalFact { line, id, signal, kind: FactKind::Switch(switch, ranges) });
        Ok(())
    }

    /// Reads `BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";`; passes over
    /// other definitions.
    fn read_attribute_words(&mut self) -> Result<(), DbcError> {
        let expected = [
            DbcTokenKind::Word("BO_"),
            DbcTokenKind::Quoted(FRAME_FORMAT),
            DbcTokenKind::Word("ENUM"),
        ];
        for (at, kind) in expected.into_iter().enumerate() {
            if self.next.map(|token| token.kind) != Some(kind) {
                return self.skip_rest(at == 0);
            }
            self.advance()?;
        }
        self.formats.group = FormatGroup::None;
        let mut count = 0;
        while let Some(DbcToken { kind: DbcTokenKind::Quoted(word), .. }) = self.next {
            if word == PARAMETER_GROUP {
                self.formats.group = FormatGroup::Number(count);
            }
            count += 1;
            self.advance()?;
            if self.next.map(|token| token.kind) == Some(DbcTokenKind::Sign(',')) {
                self.advance()?;
            }
        }
        self.skip_rest(false)
    }

    /// Reads `BA_DEF_DEF_ "VFrameFormat" "J1939PG";`; passes over other defaults.
    fn read_attribute_default(&mut self) -> Result<(), DbcError> {
        if self.next.map(|token| token.kind) != Some(DbcTokenKind::Quoted(FRAME_FORMAT)) {
            return self.skip_statement();
        }
        self.advance()?;
        self.formats.default = self.format_value();
        self.skip_rest(false)
    }

    /// Reads `BA_ "SystemMessageLongSymbol" BO_ 100 "Name";`, `BA_ "SystemSignalLongSymbol" SG_ 100 Signal
    /// "Name";` and `BA_ "VFrameFormat" BO_ 2566844926 3;`; passes over other attributes.
    fn read_attribute(&mut self) -> Result<(), DbcError> {
        let attribute = self.next.map(|token| token.kind);
        let object = match attribute {
            Some(DbcTokenKind::Quoted(LONG_MESSAGE_NAME | FRAME_FORMAT)) => "BO_",
            Some(DbcTokenKind::Quoted(LONG_SIGNAL_NAME)) => "SG_",
            _ => return self.skip_statement(),
        };
        self.advance()?;
        let is_object =
            |token: &DbcToken| !token.is_flush && token.kind == DbcTokenKind::Word(object);
        if !self.next.as_ref().is_some_and(is_object) {
            return self.skip_rest(false);
        }
        self.advance()?;
        let line = self.line();
        if object == "SG_" {
            let Some((id, signal)) = self.signal_name()? else { return self.skip_statement() };
            if let Some(name) = self.long_name()? {
                self.facts.push(SignalFact { line, id, signal, kind: FactKind::LongName(name) });
            }
            return Ok(());
        }
        let Some(DbcToken { kind: DbcTokenKind::Word(word), .. }) = self.next else {
            return self.skip_statement();
        };
        let Ok(id) = word.parse() else { return self.skip_statement() };
        self.advance()?;
        if attribute == Some(DbcTokenKind::Quoted(FRAME_FORMAT)) {
            self.formats.values.extend(self.format_value().map(|value| (id, value)));
            return self.skip_rest(false);
        }
        if let Some(name) = self.long_name()? {
            self.long_names.insert(id, name);
        }
        Ok(())
    }

    /// Returns the value of [`FRAME_FORMAT`] that is next.
    fn format_value(&self) -> Option<FormatValue> {
        match self.next?.kind {
            DbcTokenKind::Word(word) => word.parse().ok().map(FormatValue::Number),
            DbcTokenKind::Quoted(word) => Some(FormatValue::IsGroup(word == PARAMETER_GROUP)),
            DbcTokenKind::Sign(_) => None,
        }
    }

    /// Reads the value of an attribute that is a name; `None` where it is none.
    fn long_name(&mut self) -> Result<Option<String>, DbcError> {
        let Some(DbcToken { kind: DbcTokenKind::Quoted(text), .. }) = self.next else {
            self.skip_statement()?;
            return Ok(None);
        };
        self.advance()?;
        if self.next.map(|token| token.kind) == Some(DbcTokenKind::Sign(';')) {
            self.advance()?;
        }
        let is_whole = (1..=MAX_NAME).contains(&text.len()) && is_name(text);
        Ok(is_whole.then(|| text.to_owned()))
    }

    /// Reads an identifier and the name of a signal; `None` where no identifier stands.
    fn signal_name(&mut self) -> Result<Option<(u32, String)>, DbcError> {
        let Some(DbcToken { kind: DbcTokenKind::Word(word), .. }) = self.next else {
            return Ok(None);
        };
        let Ok(id) = word.parse::<u32>() else { return Ok(None) };
        self.advance()?;
        Ok(Some((id, self.name("the name of a signal")?)))
    }

    /// Connects signals with their multiplexors; returns the messages.
    fn end(mut self) -> Result<BTreeMap<u32, NamedMessage>, DbcError> {
        if self.messages.is_empty() {
            return Err(DbcError::new(self.tokens.line(), "no message (BO_) in the file"));
        }
        for fact in std::mem::take(&mut self.facts) {
            // Of messages and signals that are not there nothing is needed.
            if let Some(draft) = self.messages.get_mut(&fact.id) {
                draft.add_fact(fact)?;
            }
        }
        for (id, name) in self.long_names {
            if let Some(draft) = self.messages.get_mut(&id) {
                draft.message.name = name;
            }
        }
        let formats = self.formats;
        let end = |(id, draft): (u32, MessageDraft)| {
            let message = draft.end()?;
            Ok((id, NamedMessage { is_parameter_group: formats.is_parameter_group(id), ..message }))
        };
        self.messages.into_iter().map(end).collect()
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
        let (line, error) = (self.line(), self.expected(what));
        let word = self.word(what)?;
        match word.len() {
            0..=MAX_NAME if is_name(word) => Ok(word.to_owned()),
            0..=MAX_NAME => Err(error),
            _ => Err(DbcError::new(line, format!("a name has at most {MAX_NAME} characters"))),
        }
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
                let start: String = text.replace("\\\"", "\"").chars().take(MAX_TEXT).collect();
                Ok(shown(&start))
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
    /// Adds what a statement says of a signal, if there is this one.
    fn add_fact(&mut self, fact: SignalFact) -> Result<(), DbcError> {
        let Some(place) = self.places.get(&fact.signal).copied() else { return Ok(()) };
        let error = |cause: String| DbcError::new(fact.line, cause);
        match fact.kind {
            FactKind::Values(values) => self.message.signals[place].values = values,
            FactKind::Type(number) => {
                let signal = &mut self.message.signals[place];
                let (kind, size) = match number {
                    0 => return Ok(()),
                    1 => (SignalKind::Float, 32),
                    2 => (SignalKind::Double, 64),
                    _ => return Err(error(format!("{}: a type is 0, 1 or 2", signal.name))),
                };
                if signal.size != size {
                    let cause = format!("{}: a number of this type has {size} bits", signal.name);
                    return Err(error(cause));
                }
                signal.kind = kind;
            }
            FactKind::LongName(name) => {
                // Two signals of one name would be one in JSON.
                let signals = &mut self.message.signals;
                if signals.iter().all(|signal| signal.name != name) {
                    signals[place].name = name;
                }
            }
            FactKind::Switch(switch, values) => {
                let left_out = self.left_out.contains_key(&switch).then_some(LEFT_OUT);
                let by = self.places.get(&switch).copied().or(left_out);
                let missing = || error(format!("{}: no signal {switch}", self.message.name));
                self.switches[place].extended = Some((by.ok_or_else(missing)?, values));
            }
        }
        Ok(())
    }

    /// Connects signals with their multiplexors.
    fn end(self) -> Result<NamedMessage, DbcError> {
        let mut message = self.message;
        // Without SG_MUL_VAL_ there is one multiplexor.
        let only = self.switches.iter().position(|switch| switch.is_switch);
        let left_out = self.left_out.values().any(|is_switch| *is_switch).then_some(LEFT_OUT);
        let only = only.or(left_out);
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

/// Returns a text of the file, printable. Its backslashes stay single.
fn shown(text: &str) -> String {
    printable_with_backslashes(text.as_bytes())
}

/// Returns true for the characters of a name.
fn is_name(word: &str) -> bool {
    word.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
}

/// Returns true for an identifier of 11 bits, and for one of 29 bits with [`EXTENDED`].
fn is_id(id: u32) -> bool {
    match id & EXTENDED {
        0 => id <= u32::from(CanId::MAX_STANDARD),
        _ => id & !EXTENDED <= CanId::MAX_EXTENDED,
    }
}
