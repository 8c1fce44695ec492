//! One test of a filter: what a term means.
//!
//! Input: a term. Output: a test with its values read, or the mistake in the term. Does not know the
//! rows that are tested.

use super::FilterError;
use super::expression::Term;
use super::field::{Field, RowKind};
use super::value::{BytePattern, IdPattern, NumberRange, TimeBound, list};
use crate::app::capture::decoded::FrameRole;
use crate::app::wall_clock::WallClock;
use crate::finding::FindingKind;
use crate::time::Instant;
use crate::wire::id::{Address, MessageType};
use crate::wire::node::Mode;
use std::ops::Range;

/// A test that a row passes or not.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Test {
    /// A word without a field.
    Word(TextValue),
    /// A field whose values are texts.
    Text(Field, Vec<TextValue>),
    Address(Addresses),
    Id(Vec<IdPattern>),
    Length(Vec<NumberRange>),
    /// In microseconds.
    Interval(Vec<NumberRange>),
    Data(Vec<BytePattern>),
    Since(TimeBound),
    Until(TimeBound),
    Error,
    /// A frame sent, or an edit made, by descan.
    ByDescan,
}

/// A set of addresses, a bit for each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Addresses(pub u128);

impl Addresses {
    pub fn contains(self, address: Address) -> bool {
        self.0 >> address.number() & 1 != 0
    }

    pub fn insert(&mut self, address: Address) {
        self.0 |= 1 << address.number();
    }

    pub fn iter(self) -> impl Iterator<Item = Address> {
        Address::all().filter(move |address| self.contains(*address))
    }
}

/// A text to search for, in lower case.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TextValue {
    pub text: String,
    /// `=`: nothing else is beside it.
    is_whole: bool,
    /// The text as a number or a range of numbers.
    pub number: Option<NumberRange>,
}

impl TextValue {
    fn new(text: &str) -> Self {
        let (is_whole, text) = match text.strip_prefix('=') {
            Some(rest) if !rest.is_empty() => (true, rest),
            _ => (false, text),
        };
        let text = text.to_lowercase();
        Self { number: NumberRange::parse(&text), text, is_whole }
    }

    /// Returns true if the text is part of another one, or with `=` if it is that.
    pub fn is_in(&self, text: &str) -> bool {
        // Most texts are short and ASCII: no copy is made of them.
        if text.is_ascii() && self.text.is_ascii() {
            let (text, own) = (text.as_bytes(), self.text.as_bytes());
            if self.is_whole {
                return text.eq_ignore_ascii_case(own);
            }
            return own.is_empty()
                || text.windows(own.len()).any(|at| at.eq_ignore_ascii_case(own));
        }
        let text = text.to_lowercase();
        if self.is_whole { text == self.text } else { text.contains(&self.text) }
    }

    /// Returns true if another text begins with it, or with `=` if it is that.
    pub fn begins(&self, text: &str) -> bool {
        let text = text.to_lowercase();
        if self.is_whole { text == self.text } else { text.starts_with(&self.text) }
    }

    /// Returns true if it is part of the name of a service, or of the name and the version as in
    /// `AUGER@2.1`.
    pub fn is_service(&self, name: &str, version: &str) -> bool {
        self.is_in(name) || (self.text.contains('@') && self.is_in(&format!("{name}@{version}")))
    }

    /// Returns true if it is the number of an address.
    pub fn is_address(&self, address: Address) -> bool {
        self.number.is_some_and(|range| range.contains(u64::from(address.number())))
    }

    /// Returns true if it is part of the name or of the headline of a kind of finding.
    pub fn is_kind(&self, kind: FindingKind) -> bool {
        self.is_in(kind.name()) || self.is_in(kind.headline())
    }

    /// Returns true if it is a role, or the beginning of a message type.
    pub fn is_role(&self, role: FrameRole, kind: Option<MessageType>) -> bool {
        let is_type = |kind: MessageType| self.text.contains('_') && self.begins(kind.name());
        role.words().iter().any(|word| self.begins(word)) || kind.is_some_and(is_type)
    }
}

/// Returns true if one of the values passes.
pub(super) fn any_of(values: &[TextValue], is_it: impl Fn(&TextValue) -> bool) -> bool {
    values.iter().any(is_it)
}

impl Test {
    /// Parses a term.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(term: &Term, rows: RowKind) -> Result<Self, FilterError> {
        let text = &term.text;
        match &*text.to_lowercase() {
            "err" => return Ok(Self::Error),
            "tx" | "own" | "ours" if matches!(rows, RowKind::Frame | RowKind::Event) => {
                return Ok(Self::ByDescan);
            }
            _ => {}
        }
        let word = || Ok(Self::Word(TextValue::new(&text.replace('"', ""))));
        let Some((name, value)) = text.split_once(':').filter(|_| !text.starts_with('"')) else {
            return word();
        };
        if name.is_empty() || !name.chars().all(|c| c.is_ascii_alphabetic()) {
            return word();
        }
        let field = Field::find(&name.to_lowercase(), text, rows, term.range.clone())?;
        FieldValue { field, value, term, start: term.range.start + name.len() + 1, rows }.parse()
    }

    /// Finds the moments that the test compares with.
    pub fn resolve(&mut self, clock: &WallClock, now: Option<Instant>) {
        if let Self::Since(bound) | Self::Until(bound) = self {
            bound.resolve(clock, now);
        }
    }
}

/// The value of a field, as it was typed.
struct FieldValue<'a> {
    field: Field,
    value: &'a str,
    term: &'a Term,
    /// Its place in the line.
    start: usize,
    rows: RowKind,
}

impl FieldValue<'_> {
    fn parse(&self) -> Result<Test, FilterError> {
        let field = self.field;
        if self.value.replace('"', "").trim().is_empty() {
            let (word, example) = (field.word(), field.example(self.rows));
            let text = format!("{word}: needs a value, for example {example}");
            return Err(FilterError::new(text, self.place(0..self.value.len())));
        }
        Ok(match field {
            Field::Address => {
                let ranges = self.each(NumberRange::parse, "an address; use 0 to 127")?;
                let mut set = Addresses::default();
                for (range, place) in ranges.iter().zip(list(self.value)) {
                    let own = Address::all().filter(|it| range.contains(u64::from(it.number())));
                    let before = set;
                    own.for_each(|address| set.insert(address));
                    let lacks = !Address::all().any(|it| range.contains(u64::from(it.number())));
                    if set == before && lacks {
                        return Err(self.wrong(&place, "an address; use 0 to 127"));
                    }
                }
                Test::Address(set)
            }
            Field::Id => Test::Id(self.each(IdPattern::parse, "digits of an identifier")?),
            Field::Length => Test::Length(self.each(NumberRange::parse, "a number of bytes")?),
            Field::Interval => {
                Test::Interval(self.each(NumberRange::parse_interval, "an interval")?)
            }
            Field::Data => Test::Data(self.each(BytePattern::parse, "bytes in hexadecimal")?),
            Field::Since => Test::Since(self.bound()?),
            Field::Until => Test::Until(self.bound()?),
            Field::State => self.texts(
                |value| self.is_state(value),
                || format!("a state; use {}", self.rows.states().join(", ")),
            )?,
            Field::Mode => self.texts(
                |value| Mode::ALL.iter().any(|mode| value.begins(mode.name())),
                || format!("a mode; use {}", Mode::ALL.map(Mode::name).join(", ").to_lowercase()),
            )?,
            Field::Type if self.rows == RowKind::Frame => self.texts(
                |value| {
                    let kinds = MessageType::ALL.map(Some);
                    FrameRole::ALL.iter().any(|role| {
                        kinds.iter().chain(&[None]).any(|kind| value.is_role(*role, *kind))
                    })
                },
                || format!("a type; use {}", FrameRole::ALL.map(FrameRole::type_word).join(", ")),
            )?,
            Field::Type => self.texts(
                |value| FindingKind::ALL.iter().any(|kind| value.is_kind(*kind)),
                || match self.rows {
                    RowKind::Event => {
                        let example = self.field.example(self.rows);
                        format!("a kind of problem, for example {example}; the word of an event stands alone: moved")
                    }
                    _ => "a kind of problem".to_owned(),
                },
            )?,
            // Digits may be part of a name.
            Field::Service => self.texts(
                |value| {
                    value.number.is_none_or(NumberRange::has_service)
                        || value.text.chars().all(|c| c.is_ascii_digit())
                },
                || "a service; use a name or 0 to 0x3FF".to_owned(),
            )?,
            Field::Name
            | Field::Source
            | Field::Destination
            | Field::Device
            | Field::Uid
            | Field::Bus
            | Field::Text => self.texts(|_| true, String::new)?,
        })
    }

    fn is_state(&self, value: &TextValue) -> bool {
        let aliases: &[&str] = match self.rows {
            RowKind::Device => &["clash", "partly", "unseen", "awaited", "again"],
            RowKind::Frame | RowKind::Event => &["ours", "own"],
            RowKind::Problem | RowKind::Gateway | RowKind::Version | RowKind::Finding => &[],
        };
        let mut words = self.rows.states().iter().chain(aliases);
        match self.rows {
            RowKind::Device => words.any(|word| value.is_in(word)),
            _ => words.any(|word| value.begins(word)),
        }
    }

    fn place(&self, range: Range<usize>) -> Range<usize> {
        self.start + range.start..self.start + range.end
    }

    /// The mistake of a part of the list that is not `what`.
    fn wrong(&self, (text, range): &(String, Range<usize>), what: &str) -> FilterError {
        let (term, example) = (&self.term.text, self.field.example(self.rows));
        let hint =
            if what.contains(';') { String::new() } else { format!("; for example {example}") };
        let text = format!("{term}: \"{text}\" is not {what}{hint}");
        FilterError::new(text, self.place(range.clone()))
    }

    /// Reads each part of the list.
    fn each<T>(
        &self,
        parse: impl Fn(&str) -> Option<T>,
        what: &str,
    ) -> Result<Vec<T>, FilterError> {
        let read = |part: (String, Range<usize>)| {
            let text = part.0.to_lowercase();
            parse(text.trim()).ok_or_else(|| {
                let swap = |(low, high): (&str, &str)| format!("{}..{}", high.trim(), low.trim());
                let swapped = text.split_once("..").map(swap);
                match swapped.filter(|swapped| parse(swapped).is_some()) {
                    Some(swapped) => self.wrong(&part, &format!("a range; use {swapped}")),
                    None => self.wrong(&part, what),
                }
            })
        };
        list(self.value).into_iter().map(read).collect()
    }

    fn bound(&self) -> Result<TimeBound, FilterError> {
        let text = self.value.replace('"', "");
        let part = (text.clone(), 0..self.value.len());
        TimeBound::parse(text.trim()).ok_or_else(|| self.wrong(&part, "a time"))
    }

    /// Reads each part as a text that `is_known`; `what` are those that are.
    fn texts(
        &self,
        is_known: impl Fn(&TextValue) -> bool,
        what: impl Fn() -> String,
    ) -> Result<Test, FilterError> {
        let read = |part: (String, Range<usize>)| {
            let value = TextValue::new(part.0.trim());
            if matches!(&*value.text, "" | "=") || !is_known(&value) {
                let what = what();
                let what = if what.is_empty() { "a text" } else { &what };
                return Err(self.wrong(&part, what));
            }
            Ok(value)
        };
        let values = list(self.value).into_iter().map(read).collect::<Result<_, _>>()?;
        Ok(Test::Text(self.field, values))
    }
}
