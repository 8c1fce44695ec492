//! Filter line: words and fields, all of which must match.
//!
//! ```text
//! feed            a row with "feed" in a field; of an event: name, event, state, kind of finding
//! text:feed       a row with "feed" in its sentence, whose wording is not fixed
//! "sim:boiler"    a word with a colon or a blank; also as a value: bus:"my bus"
//! src:feed        sender, by name or address; dst: receiver; dev: either, or the device
//! srv:des         service, by name or number (srv:2, srv:0x002)
//! at:12           address of either side, of the device or of the problem; at:12,14 any of them
//! name:feed       the same, by part of the name
//! type:rsp        beginning of the message type; id:0201 digits of the identifier
//! kind:uid        part of the kind of a problem, short or long form
//! is:confirmed    state: suspected, cleared, muted; of a device: online, stale, new, twin; of a
//!                 frame: error, tx
//! bus:can1        bus
//! err  tx         error frames, failed and malformed responses; frames sent by descan
//! !word           not matching
//! ```
//!
//! Case is ignored.

use super::buses::Buses;
use super::capture::decoded::Decoded;
use super::notices::timeline::TimelineEntry;
use super::problems::Problem;
use super::timeline_kind::TimelineKind;
use super::view::{Page, Row, RowState};
use crate::finding::{FindingKind, FindingState};
use crate::frame::{Frame, FrameKind};
use crate::wire::id::{Address, MessageType};

/// A parsed filter line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Filter {
    terms: Vec<Term>,
    /// True if a quote is open at the end of the line.
    is_quote_open: bool,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Term {
    not: bool,
    what: TermTest,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum TermTest {
    Word(String),
    /// A word with a colon that begins with no field; it matches nothing.
    UnknownField(String),
    Field(Field, String),
    Error,
    /// A frame sent, or an edit made, by descan.
    ByDescan,
}

impl TermTest {
    /// Parses a term in lower case, without its negation.
    fn parse(word: &str) -> Self {
        match word {
            "err" => return Self::Error,
            "tx" | "ours" => return Self::ByDescan,
            _ => {}
        }
        let is_quoted = word.starts_with('"');
        let Some((name, value)) = word.split_once(':').filter(|_| !is_quoted) else {
            return Self::Word(unquoted(word));
        };
        let field = FILTER_FIELDS.iter().find(|field| field.words.contains(&name));
        let is_name = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphabetic());
        match field {
            Some(field) => Self::Field(field.field, unquoted(value)),
            None if is_name => Self::UnknownField(word.to_owned()),
            None => Self::Word(word.to_owned()),
        }
    }
}

/// Splits a line at blanks outside of quotes; the quotes stay.
fn split_quoted(text: &str) -> impl Iterator<Item = String> {
    let mut is_quoted = false;
    let words = text.split(move |c: char| {
        is_quoted ^= c == '"';
        c.is_whitespace() && !is_quoted
    });
    words.filter(|word| !word.is_empty()).map(str::to_owned)
}

fn unquoted(word: &str) -> String {
    word.replace('"', "")
}

/// What a field is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Field {
    Source,
    Destination,
    Device,
    Address,
    Name,
    Service,
    Type,
    Id,
    Bus,
    State,
    Text,
}

impl Field {
    /// Returns true if the rows of a page have the field.
    const fn is_on(self, page: Page) -> bool {
        match self {
            Self::Address | Self::Name | Self::Device | Self::Bus | Self::State => true,
            Self::Source | Self::Destination | Self::Id => matches!(page, Page::Traffic),
            Self::Service => matches!(page, Page::Traffic | Page::Devices),
            Self::Type | Self::Text => !matches!(page, Page::Devices),
        }
    }

    /// Returns a term with the field, for a page.
    const fn example(self, page: Page) -> &'static str {
        match self {
            Self::Address => "at:12",
            Self::Name => "name:FEED",
            Self::Bus => "bus:can1",
            Self::State if matches!(page, Page::Devices) => "is:lost",
            Self::State if matches!(page, Page::Traffic) => "is:error",
            Self::State => "is:suspected",
            Self::Source => "src:FEED",
            Self::Destination => "dst:FEED",
            Self::Device => "dev:FEED",
            Self::Service => "srv:des",
            Self::Type if matches!(page, Page::Traffic) => "type:rsp",
            Self::Type => "kind:uid",
            Self::Id => "id:0201",
            Self::Text => "text:lost",
        }
    }

    /// Returns the usual name of the field.
    fn word(self) -> &'static str {
        let field = FILTER_FIELDS.iter().find(|it| it.field == self);
        field.and_then(|it| it.words.first()).copied().unwrap_or_default()
    }
}

/// Returns the names of the fields that the rows of a page have.
fn known_fields(page: Page) -> String {
    let fields = FILTER_FIELDS.iter().filter(|it| it.field.is_on(page));
    let words = fields.flat_map(|it| it.words).map(|word| format!("{word}:"));
    words.collect::<Vec<_>>().join(" ")
}

/// Returns what the rows of a page are.
const fn rows_of(page: Page) -> &'static str {
    match page {
        Page::Devices => "devices",
        Page::Traffic => "frames",
        Page::Timeline => "events",
        Page::Problems => "problems",
        Page::Bus => "bars",
    }
}

/// A field of the filter line.
#[derive(Debug)]
pub struct FilterField {
    /// Names, the usual one first.
    pub words: &'static [&'static str],
    /// Values that it matches, for the help.
    pub doc: &'static str,
    field: Field,
}

macro_rules! fields {
    ($([$($word:literal)*] $field:ident $doc:literal;)*) => {
        /// All fields, for the help.
        pub const FILTER_FIELDS: &[FilterField] = &[$(FilterField {
            words: &[$($word),*],
            doc: $doc,
            field: Field::$field,
        }),*];
    };
}

fields! {
    ["at"] Address "address of either side of a frame, of a device, of a problem; at:12,14 either of them";
    ["name"] Name "part of a name of either side, of a device, of a problem";
    ["src" "from"] Source "sender of a frame, by address or part of its name";
    ["dst" "to"] Destination "receiver of a frame, by address or part of its name";
    ["dev"] Device "sender or receiver of a frame; device of an event";
    ["srv"] Service "service, by part of its name or by number: srv:des, srv:2, srv:0x002";
    ["type" "kind"] Type "message type by its beginning: type:rsp; kind of a problem by any part: kind:uid";
    ["id"] Id "digits in the identifier: id:0201";
    ["bus"] Bus "part of the name of the bus";
    ["text"] Text "words of a sentence: of an event, of a problem, of the meaning of a frame";
    ["is" "state"] State "state by its beginning: online, stale, lost, new, twin; suspected, confirmed, cleared, muted; error, tx";
}

/// Words with a special meaning, for the help.
pub const FILTER_WORDS: &[(&str, &str)] = &[
    ("err", "error frames, failed and malformed responses; devices and problems in conflict"),
    ("tx", "frames sent by descan; in the timeline what concerns des.json"),
    ("!term", "everything that the term does not match"),
    ("\"a:b\"", "a word with a colon or a blank; as a value: bus:\"a b\""),
];

impl Filter {
    /// Parses a filter line; every text has a meaning, though [`Self::error`] may refuse it.
    pub fn parse(text: &str) -> Self {
        let term = |word: String| {
            let (not, word) = match word.strip_prefix('!') {
                Some(rest) if !rest.is_empty() => (true, rest),
                _ => (false, word.as_str()),
            };
            Term { not, what: TermTest::parse(&word.to_lowercase()) }
        };
        let is_quote_open = text.matches('"').count() % 2 == 1;
        Self { terms: split_quoted(text).map(term).collect(), is_quote_open }
    }

    /// Error message for a term that looks like a field and is none, or cannot match a row of
    /// `page`; `None` without one.
    pub fn error(&self, page: Page) -> Option<String> {
        if self.is_quote_open {
            return Some("a quote is not closed: add \"".to_owned());
        }
        self.terms.iter().find_map(|term| match &term.what {
            TermTest::Field(field, value) if !field.is_on(page) => {
                let (word, rows) = (field.word(), rows_of(page));
                let known = known_fields(page);
                Some(format!("{word}:{value}: {rows} have no field {word}; use {known}"))
            }
            TermTest::Field(field, value) if value.is_empty() => {
                let word = field.word();
                Some(format!("{word}: needs a value, for example {}", field.example(page)))
            }
            TermTest::Field(Field::State, value) if !is_state(value) => Some(format!(
                "is:{value}: \"{value}\" is not a state; use {}",
                STATE_WORDS.join(", ")
            )),
            TermTest::Field(Field::Type, value) if page == Page::Traffic => {
                let is_wrong = !is_message_type(value);
                is_wrong.then(|| format!("type:{value}: no message type; for example type:rsp"))
            }
            TermTest::Field(Field::Type, value) => {
                let is_wrong = !FindingKind::ALL.iter().any(|kind| is_kind(*kind, value));
                is_wrong.then(|| format!("kind:{value}: no kind of problem; for example kind:uid"))
            }
            TermTest::Field(Field::Address, list) => {
                let is_none = |one: &&str| !Address::all().any(|address| is_one_of(address, one));
                let wrong = list.split(',').find(is_none)?;
                Some(format!(
                    "at:{list}: \"{wrong}\" is not an address; use 0 to 127, for example at:12,14"
                ))
            }
            TermTest::UnknownField(word) => {
                let field = word.split(':').next().unwrap_or_default();
                let known = known_fields(page);
                Some(format!(
                    "{word}: unknown field {field}; use {known}; quote a word with a colon: \
                     \"{word}\""
                ))
            }
            TermTest::Word(_) | TermTest::Field(..) | TermTest::Error | TermTest::ByDescan => None,
        })
    }

    /// Fields that apply to a page, in one line: the syntax is common, the fields differ.
    pub const fn syntax_hint(page: Page) -> &'static str {
        match page {
            Page::Devices => "words; at: name: srv: bus: is:lost  err  !not",
            Page::Traffic => "words; src: dst: srv: type: at: id: bus:  err  tx  !not",
            Page::Timeline => "words; at: name: bus: kind: text: is:suspected  err  !not",
            Page::Problems => "words; kind: is:suspected at: name: bus: text:  !not",
            Page::Bus => "",
        }
    }

    /// Addresses that a match must have; `None` if the filter does not restrict them.
    pub fn addresses(&self) -> Option<Vec<Address>> {
        self.terms.iter().find_map(|term| match &term.what {
            TermTest::Field(Field::Address, value) if !term.not => {
                Some(Address::all().filter(|it| is_one_of(*it, value)).collect())
            }
            _ => None,
        })
    }

    /// Returns true if the filter is empty and matches everything.
    pub fn is_empty(&self) -> bool {
        self.terms.is_empty()
    }

    fn all(&self, fits: impl Fn(&TermTest) -> bool) -> bool {
        self.terms.iter().all(|term| fits(&term.what) != term.not)
    }

    /// Returns true if a row of the Devices page matches.
    pub fn matches_row(&self, buses: &Buses, row: &Row) -> bool {
        if self.is_empty() {
            return true;
        }
        let name = row.name.as_ref().map(ToString::to_string).unwrap_or_default().to_lowercase();
        let has_address = |word: &str| row.addresses(buses).any(|address| is_one_of(address, word));
        let own = row.bus.into_iter().chain(row.redundant_ids.iter().map(|id| id.bus));
        let own = own.filter_map(|bus| Some(buses.get(bus)?.name.to_lowercase()));
        let own: Vec<String> = own.collect();
        let device = row.device(buses);
        let mode = device.and_then(|device| device.mode).map_or("", |mode| mode.name());
        let services = device.and_then(|device| device.services.as_deref()).unwrap_or_default();
        let service = |word: &str| {
            let is_it = |name: &crate::text::Name| contains_word(&name.to_string(), word);
            services.iter().any(|service| is_it(&service.name))
        };
        self.all(|what| match what {
            TermTest::Word(word) => {
                name.contains(word)
                    || has_address(word)
                    || has_state(row.state, |own| own.eq_ignore_ascii_case(word))
                    || mode.eq_ignore_ascii_case(word)
                    || own.contains(word)
                    || service(word)
                    || (word == "new" && row.file == super::FileStatus::New)
                    || (word == "twin" && row.twin)
            }
            TermTest::Field(Field::Source | Field::Destination | Field::Device, value) => {
                name.contains(value) || has_address(value)
            }
            TermTest::Field(Field::Address, value) => has_address(value),
            TermTest::Field(Field::Name, value) => name.contains(value),
            TermTest::Field(Field::Service, value) => service(value),
            TermTest::Field(Field::Bus, value) => own.iter().any(|bus| bus.contains(value)),
            TermTest::Field(Field::State, value) => {
                has_state(row.state, |own| contains_word(own, value))
                    || (row.suspected && starts("suspected", value))
                    || (row.file == super::FileStatus::New && starts("new", value))
                    || (row.twin && starts("twin", value))
            }
            TermTest::Field(Field::Type | Field::Id | Field::Text, _)
            | TermTest::UnknownField(_)
            | TermTest::ByDescan => false,
            TermTest::Error => row.state == super::RowState::Conflict || row.suspected,
        })
    }

    /// Returns true if a line of the timeline matches.
    pub fn matches_entry(&self, buses: &Buses, entry: &TimelineEntry) -> bool {
        self.matches_entry_of(buses, entry, &[])
    }

    /// Returns true if a line of the timeline matches that concerns the addresses `others` too.
    pub(super) fn matches_entry_of(
        &self,
        buses: &Buses,
        entry: &TimelineEntry,
        others: &[Address],
    ) -> bool {
        let name = || entry.device_name(buses).map(ToString::to_string).unwrap_or_default();
        let address = || entry.address.map(|address| address.to_string()).unwrap_or_default();
        let bus = || entry.bus.and_then(|bus| buses.get(bus)).map_or("", |bus| &bus.name);
        self.all(|what| match what {
            TermTest::Word(word) => {
                contains_word(&name(), word)
                    || entry.other_names.iter().any(|it| contains_word(&it.to_string(), word))
                    || address() == *word
                    || entry.events.iter().any(|event| event.starts_with(word.as_str()))
                    || entry.kind.state_word().is_some_and(|state| state == word)
                    || entry.finding.is_some_and(|kind| contains_word(kind.name(), word))
            }
            TermTest::Field(Field::Text, value) => contains_word(&entry.text, value),
            TermTest::Field(Field::Type, value) => {
                entry.finding.is_some_and(|kind| is_kind(kind, value))
            }
            TermTest::Field(Field::Bus, value) => contains_word(bus(), value),
            TermTest::Field(Field::Address, value) => {
                others.iter().chain(&entry.address).any(|it| is_one_of(*it, value))
            }
            TermTest::Field(Field::Name, value) => contains_word(&name(), value),
            TermTest::Field(Field::State, value) => {
                entry.kind.state_word().is_some_and(|state| starts(state, value))
            }
            TermTest::Field(_, value) => contains_word(&name(), value) || address() == *value,
            TermTest::UnknownField(_) => false,
            TermTest::Error => matches!(entry.kind, TimelineKind::Confirmed | TimelineKind::Error),
            TermTest::ByDescan => entry.kind == TimelineKind::File,
        })
    }

    /// Returns true if a problem matches.
    pub fn matches_problem(&self, buses: &Buses, problem: &Problem) -> bool {
        if self.is_empty() {
            return true;
        }
        let bus = || problem.bus().and_then(|bus| buses.get(bus)).map_or("", |bus| &bus.name);
        let state = problem.state();
        let at = |word: &str| problem.addresses().iter().any(|it| is_one_of(*it, word));
        let named =
            |word: &str| problem.names().iter().any(|it| contains_word(&it.to_string(), word));
        let kind = |word: &str| {
            contains_word(&problem.headline(), word)
                || problem.findings.iter().any(|finding| is_kind(finding.key.kind, word))
        };
        self.all(|what| match what {
            TermTest::Word(word) => {
                kind(word)
                    || contains_word(state.name(), word)
                    || (problem.is_muted && word == "muted")
                    || named(word)
                    || at(word)
            }
            TermTest::Field(Field::Address, value) => at(value),
            TermTest::Field(Field::Name, value) => named(value),
            TermTest::Field(Field::Type, value) => kind(value),
            TermTest::Field(Field::Text, value) => {
                problem.findings.iter().any(|finding| contains_word(&finding.text, value))
            }
            TermTest::Field(Field::State, value) => {
                starts(state.name(), value) || (problem.is_muted && starts("muted", value))
            }
            TermTest::Field(Field::Bus, value) => contains_word(bus(), value),
            TermTest::Field(_, value) => named(value) || at(value),
            TermTest::Error => state == FindingState::Confirmed,
            TermTest::UnknownField(_) | TermTest::ByDescan => false,
        })
    }

    /// Returns true if a frame matches.
    pub fn matches_frame(&self, buses: &Buses, frame: &Frame) -> bool {
        if self.is_empty() {
            return true;
        }
        let decoded = Decoded::new(buses, frame);
        self.all(|what| match what {
            TermTest::Word(word) => {
                contains_word(&decoded.text, word)
                    || contains_word(&decoded.source, word)
                    || contains_word(&decoded.destination, word)
                    || contains_word(&decoded.service, word)
                    || contains_word(decoded.kind, word)
            }
            TermTest::Field(Field::Source, value) => decoded.is_source(value),
            TermTest::Field(Field::Destination, value) => decoded.is_destination(value),
            TermTest::Field(Field::Device, value) => {
                decoded.is_source(value) || decoded.is_destination(value)
            }
            TermTest::Field(Field::Service, value) => decoded.is_service(value),
            TermTest::Field(Field::Type, value) => starts(decoded.kind, value),
            TermTest::Field(Field::Text, value) => contains_word(&decoded.text, value),
            TermTest::UnknownField(_) => false,
            TermTest::Field(Field::Id, value) => contains_word(&frame.id.to_string(), value),
            TermTest::Field(Field::Bus, value) => {
                buses.get(frame.bus).is_some_and(|bus| contains_word(&bus.name, value))
            }
            TermTest::Field(Field::Address, value) => decoded.header.is_some_and(|header| {
                let is_it = |address: Address| is_one_of(address, value);
                is_it(header.source) || (!header.broadcast && is_it(header.destination))
            }),
            TermTest::Field(Field::Name, value) => {
                contains_word(&decoded.source, value) || contains_word(&decoded.destination, value)
            }
            TermTest::Field(Field::State, value) => {
                let is_error = decoded.is_error || frame.kind == FrameKind::Error;
                let is_tx = starts("tx", value) || starts("ours", value);
                (is_error && starts("error", value)) || (frame.is_tx && is_tx)
            }
            TermTest::Error => decoded.is_error || frame.kind == FrameKind::Error,
            TermTest::ByDescan => frame.is_tx,
        })
    }
}

/// Returns true if `address` is in `list`: `12`, `12,14`.
fn is_one_of(address: Address, list: &str) -> bool {
    list.split(',').any(|one| one.parse() == Ok(address.number()))
}

/// Returns true if `text` contains `word`, which is in lower case.
fn contains_word(text: &str, word: &str) -> bool {
    text.to_lowercase().contains(word)
}

fn starts(text: &str, word: &str) -> bool {
    text.to_lowercase().starts_with(word)
}

/// Words of all states, those that descan shows first.
const STATE_WORDS: &[&str] = &[
    "online",
    "stale",
    "silent",
    "asleep",
    "lost",
    "missing",
    "pending",
    "partial",
    "unknown",
    "conflict",
    "dup",
    "new",
    "twin",
    "suspected",
    "confirmed",
    "cleared",
    "muted",
    "error",
    "tx",
];

/// Returns true if something may be in this state.
fn is_state(value: &str) -> bool {
    let aliases = ["ours", "clash", "partly", "unseen", "awaited", "again"];
    STATE_WORDS.iter().chain(&aliases).any(|word| word.contains(value))
}

/// Returns true if `word` is part of the name or of the headline of a kind of problem.
fn is_kind(kind: FindingKind, word: &str) -> bool {
    contains_word(kind.name(), word) || contains_word(kind.headline(), word)
}

/// Returns true if there is such a message type, or another kind of frame.
fn is_message_type(value: &str) -> bool {
    MessageType::ALL.iter().any(|it| starts(it.name(), value))
        || ["error", "remote", "standard", "foreign"].iter().any(|kind| kind.starts_with(value))
}

/// Returns true if `fits` accepts the shown word of a row's state or its alias.
fn has_state(state: RowState, fits: impl Fn(&str) -> bool) -> bool {
    let alias = match state {
        RowState::Conflict => "clash",
        RowState::Partial => "partly",
        RowState::Unknown => "unseen",
        RowState::Pending => "awaited",
        RowState::Duplicate => "again",
        _ => return fits(state.word()),
    };
    fits(state.word()) || fits(alias)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_is_a_filter() {
        let terms = |text| Filter::parse(text).terms;
        assert!(Filter::parse("  ").is_empty());
        assert_eq!(
            terms("src:FEED !err x:y !\"X: y\" bus:\"sim:a b\" bus:sim:a"),
            [
                Term { not: false, what: TermTest::Field(Field::Source, "feed".to_owned()) },
                Term { not: true, what: TermTest::Error },
                Term { not: false, what: TermTest::UnknownField("x:y".to_owned()) },
                Term { not: true, what: TermTest::Word("x: y".to_owned()) },
                Term { not: false, what: TermTest::Field(Field::Bus, "sim:a b".to_owned()) },
                Term { not: false, what: TermTest::Field(Field::Bus, "sim:a".to_owned()) },
            ]
        );
        assert_eq!(terms("!")[0].what, TermTest::Word("!".to_owned()));
    }
}
