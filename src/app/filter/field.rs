//! The fields of a filter, and which rows have them.
//!
//! Does not know how a value is compared.

use super::FilterError;
use crate::app::view::Page;
use crate::diagnostic::nearest_word;
use std::ops::Range;

/// What a filter selects from. All have the same language; some fields are of some rows only.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RowKind {
    /// Rows of the Devices page.
    #[default]
    Device,
    /// Frames.
    Frame,
    /// Lines of the timeline; events of `watch`.
    Event,
    /// Problems.
    Problem,
    /// Gateways of a fleet.
    Gateway,
    /// Versions of services in a fleet.
    Version,
    /// Findings as a gateway published them.
    Finding,
}

impl RowKind {
    /// What the rows of a page are.
    pub const fn of(page: Page) -> Self {
        match page {
            // Bus has no rows.
            Page::Devices | Page::Bus => Self::Device,
            Page::Traffic => Self::Frame,
            Page::Timeline => Self::Event,
            Page::Problems => Self::Problem,
        }
    }

    /// Word for them in a message.
    pub const fn plural(self) -> &'static str {
        match self {
            Self::Device => "devices",
            Self::Frame => "frames",
            Self::Event => "events",
            Self::Problem => "problems",
            Self::Gateway => "gateways",
            Self::Version => "versions",
            Self::Finding => "findings",
        }
    }

    /// Words of `is:` for them.
    pub const fn states(self) -> &'static [&'static str] {
        match self {
            Self::Device => &[
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
            ],
            Self::Frame => &["error", "failed", "tx"],
            Self::Event => &[
                "suspected",
                "confirmed",
                "cleared",
                "error",
                "stale",
                "silent",
                "asleep",
                "lost",
                "returned",
                "tx",
            ],
            Self::Problem => &["suspected", "confirmed", "cleared", "muted"],
            Self::Gateway => {
                &["online", "silent", "stopped", "lost", "unknown", "conflict", "suspected"]
            }
            Self::Version => &[],
            Self::Finding => &["suspected", "confirmed"],
        }
    }

    /// Terms that these rows have, in one line, for the prompt.
    pub const fn syntax(self) -> &'static str {
        match self {
            Self::Device => "words; at: name: srv: mode: uid: is:lost  err  or not ( )",
            Self::Frame => "words; src: dst: srv: type: id: data: len:>4 dt:>50ms  or not ( )",
            Self::Event => "words; at: name: kind: text: is: since:13:51  or not ( )",
            Self::Problem => "words; kind: at: name: uid: is:suspected text:  or not ( )",
            Self::Gateway => "words; srv:AUGER@2.1 name: uid: at: bus: is:lost  err  or not ( )",
            Self::Version => "words; srv:AUGER@2.1  or not ( )",
            Self::Finding => "words; kind: at: name: uid: bus: is:suspected text:  or not ( )",
        }
    }
}

/// What a field is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Field {
    Address,
    Name,
    Source,
    Destination,
    Device,
    Service,
    Type,
    Mode,
    Uid,
    Id,
    Length,
    Data,
    Interval,
    State,
    Bus,
    Since,
    Until,
    Text,
}

impl Field {
    /// Returns true if the rows have the field.
    pub const fn is_of(self, rows: RowKind) -> bool {
        use RowKind as R;
        match self {
            Self::Address | Self::Name | Self::Device | Self::Bus | Self::State | Self::Uid => {
                !matches!(rows, R::Version)
            }
            Self::Source
            | Self::Destination
            | Self::Id
            | Self::Length
            | Self::Data
            | Self::Interval => matches!(rows, R::Frame),
            Self::Service => matches!(rows, R::Frame | R::Device | R::Gateway | R::Version),
            Self::Mode => matches!(rows, R::Frame | R::Device | R::Event | R::Gateway),
            Self::Type | Self::Text => {
                matches!(rows, R::Frame | R::Event | R::Problem | R::Finding)
            }
            Self::Since | Self::Until => matches!(rows, R::Frame | R::Event | R::Problem),
        }
    }

    /// Returns a term with the field.
    pub const fn example(self, rows: RowKind) -> &'static str {
        match (self, rows) {
            (Self::Address, _) => "at:12",
            (Self::Name, _) => "name:FEED",
            (Self::Source, _) => "src:FEED",
            (Self::Destination, _) => "dst:FEED",
            (Self::Device, _) => "dev:FEED",
            (Self::Service, RowKind::Gateway | RowKind::Version) => "srv:AUGER@2.1",
            (Self::Service, _) => "srv:des",
            (Self::Type, RowKind::Frame) => "type:rsp",
            (Self::Type, _) => "kind:uid",
            (Self::Mode, _) => "mode:work",
            (Self::Uid, _) => "uid:BOILER01",
            (Self::Id, _) => "id:0201",
            (Self::Length, _) => "len:>4",
            (Self::Data, _) => "data:\"01 ?? 0F\"",
            (Self::Interval, _) => "dt:>50ms",
            (Self::State, RowKind::Device | RowKind::Gateway) => "is:lost",
            (Self::State, RowKind::Frame) => "is:error",
            (Self::State, _) => "is:suspected",
            (Self::Bus, _) => "bus:can1",
            (Self::Since, _) => "since:13:51",
            (Self::Until, _) => "until:13:51:20",
            (Self::Text, _) => "text:lost",
        }
    }

    /// Returns the usual name of the field.
    pub fn word(self) -> &'static str {
        let field = FILTER_FIELDS.iter().find(|it| it.field == self);
        field.and_then(|it| it.words.first()).copied().unwrap_or_default()
    }

    /// Finds the field with this name, in lower case, that the rows have; `term` is what was typed.
    ///
    /// # Errors
    /// The name is not that of a field, or the rows do not have it.
    pub fn find(
        name: &str,
        term: &str,
        rows: RowKind,
        range: Range<usize>,
    ) -> Result<Self, FilterError> {
        let found = FILTER_FIELDS.iter().find(|field| field.words.contains(&name));
        match found.map(|found| found.field) {
            Some(field) if field.is_of(rows) => Ok(field),
            Some(_) => {
                let (all, known) = (rows.plural(), fields_of(rows));
                let text = format!("{term}: {all} have no field {name}; use {known}");
                Err(FilterError::new(text, range))
            }
            None => {
                let fields = FILTER_FIELDS.iter().filter(|it| it.field.is_of(rows));
                let words = fields.flat_map(|it| it.words).copied();
                let way_out = match nearest_word(name, words) {
                    Some(near) => format!("{near}:"),
                    None => fields_of(rows),
                };
                let text = format!(
                    "{term}: unknown field {name}; use {way_out}; quote a word with a colon: \"{term}\""
                );
                Err(FilterError::new(text, range))
            }
        }
    }
}

/// Returns the names of the fields that the rows have.
fn fields_of(rows: RowKind) -> String {
    let words =
        FILTER_FIELDS.iter().filter(|it| it.field.is_of(rows)).filter_map(|it| it.words.first());
    words.map(|word| format!("{word}:")).collect::<Vec<_>>().join(" ")
}

/// A field of the filter line.
#[derive(Debug)]
pub struct FilterField {
    /// Names, the usual one first.
    pub words: &'static [&'static str],
    /// Values that it matches, for the help.
    pub doc: &'static str,
    pub(super) field: Field,
}

impl FilterField {
    /// Returns true if the rows have the field.
    pub const fn is_of(&self, rows: RowKind) -> bool {
        self.field.is_of(rows)
    }

    /// Returns true for that of [`RowKind::states`].
    pub fn is_state(&self) -> bool {
        self.field == Field::State
    }
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
    ["at"] Address "address of either side of a frame, of a device, of a problem: at:12,14, at:10..20";
    ["name"] Name "part of a name of either side, of a device, of a problem";
    ["src" "from"] Source "sender of a frame, by address or part of its name";
    ["dst" "to"] Destination "receiver of a frame, by address or part of its name; dst:all for broadcasts";
    ["dev"] Device "sender or receiver of a frame; device of an event";
    ["srv"] Service "service, by part of its name or by number: srv:des, srv:2, srv:0x100..0x1FF";
    ["type" "kind"] Type "frame: req, rsp, data, dbg, err, std, rtr, or the beginning of a message type: type:rsp_cu; problem, event: part of the kind: kind:uid";
    ["mode"] Mode "mode of a device, in a heartbeat, in an event, by its beginning: mode:ufunc";
    ["uid"] Uid "part of a UID: of a device, in a heartbeat, of a problem";
    ["id"] Id "digits in the identifier, ? is any: id:0201, id:071?0001; id:=123 all of them; id:0x100..0x1FF";
    ["len"] Length "bytes of data: len:8, len:>4, len:0..3";
    ["data"] Data "bytes in the data or in the transfer, ? is any digit, ^ the beginning, $ the end: data:\"01 ?? 0F\"";
    ["dt"] Interval "time since the frame before with the same identifier: dt:>50ms, dt:10ms..20ms";
    ["is" "state"] State "state by its beginning: online, stale, lost, new, twin; suspected, confirmed, cleared, muted; error, failed, tx";
    ["bus"] Bus "part of the name of the bus";
    ["since"] Since "at or after a time: since:13:51:20, since:-2m, since:2026-11-24T13:51";
    ["until"] Until "before or at a time";
    ["text"] Text "words of a sentence: of an event, of a problem, of the meaning of a frame";
}

/// Words with a special meaning, for the help.
pub const FILTER_WORDS: &[(&str, &str)] = &[
    ("err", "error frames, failed and malformed responses; devices and problems in conflict"),
    ("tx", "frames sent by descan; in the timeline what concerns des.json"),
    ("a b", "both; also a and b"),
    ("a or b", "one of them; binds weaker than and: a b or c is (a b) or c"),
    ("not a", "everything that the term does not match; also !a"),
    ("( )", "group: src:FEED (type:req or type:rsp)"),
    ("a,b", "one of several values: name:FEED,ACT"),
    ("=", "the whole text: name:=FEED"),
    ("\"a:b\"", "a word with a colon or a blank; as a value: bus:\"a b\""),
];
