//! A difference between two inventories, as values and as text.
//!
//! [`DifferenceKind::facts`] is the only place that lists the names of the kinds. Does not know how
//! differences are found.

use serde::{Serialize, Serializer};
use std::fmt;

/// What differs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DifferenceKind {
    /// Presence of a device; not there at all, or another word for it.
    Presence,
    /// Address of a device.
    Address,
    /// Name of a device.
    Name,
    /// Boards at an address: a replaced one, or a conflict.
    Boards,
    /// UID of a device that had none, or has none any more.
    Uid,
    /// Mode of a device.
    Mode,
    /// Services that a device has on one side only.
    Services,
    /// Versions of services that a device has on both sides.
    Version,
    /// Heartbeat period of a device, by more than a fifth.
    Heartbeat,
    /// Entry of des.json for a device.
    File,
    /// Confidence of a finding.
    Finding,
    /// A value of a bus.
    Bus,
}

impl DifferenceKind {
    /// All kinds, in the order of the rows of a device.
    pub const ALL: [Self; 12] = [
        Self::Presence,
        Self::Address,
        Self::Name,
        Self::Boards,
        Self::Uid,
        Self::Mode,
        Self::Services,
        Self::Version,
        Self::Heartbeat,
        Self::File,
        Self::Finding,
        Self::Bus,
    ];

    /// Name in JSON, text in the column WHAT, and what it is in a sentence.
    const fn facts(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::Presence => ("presence", "presence", "presence"),
            Self::Address => ("address", "address", "address"),
            Self::Name => ("name", "name", "name"),
            Self::Boards => ("boards", "boards", "boards"),
            Self::Uid => ("uid", "UID", "UID"),
            Self::Mode => ("mode", "mode", "mode"),
            Self::Services => ("services", "services", "services"),
            Self::Version => ("version", "version", "versions"),
            Self::Heartbeat => ("heartbeat", "heartbeat", "heartbeat period"),
            Self::File => ("file", "des.json", "des.json"),
            Self::Finding => ("finding", "finding", "findings"),
            Self::Bus => ("bus", "bus", "bus"),
        }
    }

    /// Name in JSON; stable.
    pub const fn name(self) -> &'static str {
        self.facts().0
    }

    /// Text in the column WHAT.
    pub const fn title(self) -> &'static str {
        self.facts().1
    }

    /// What it is, in a sentence.
    const fn words(self) -> &'static str {
        self.facts().2
    }
}

/// A value on one side of a difference.
#[derive(Clone, Debug, PartialEq)]
pub enum DifferenceValue {
    /// Not there.
    Absent,
    /// A word.
    Word(String),
    /// Words, such as services or UIDs.
    Words(Vec<String>),
    /// A count, an address, or a bit rate in bit/s.
    Count(u64),
    /// A time in milliseconds.
    Millis(f64),
    /// A share, 0 to 1.
    Share(f64),
    /// An entry of des.json.
    Entry {
        /// Address in the file.
        address: Option<u8>,
        /// True if the address is pinned.
        is_static: bool,
    },
}

impl DifferenceValue {
    /// Returns the value of a word that may be missing.
    pub(super) fn of_word(word: Option<&str>) -> Self {
        word.map_or(Self::Absent, |word| Self::Word(word.to_owned()))
    }
}

/// Writes the value for people: `–` if it is not there.
impl fmt::Display for DifferenceValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absent => f.write_str("–"),
            Self::Word(word) if word.is_empty() => f.write_str("blank"),
            Self::Word(word) => f.write_str(word),
            Self::Words(words) if words.is_empty() => f.write_str("–"),
            Self::Words(words) => f.write_str(&words.join(", ")),
            Self::Count(count) => write!(f, "{count}"),
            Self::Millis(millis) if *millis < 1000.0 => write!(f, "{millis:.0} ms"),
            Self::Millis(millis) => write!(f, "{:.2} s", millis / 1000.0),
            Self::Share(share) => write!(f, "{:.1} %", share * 100.0),
            Self::Entry { address: None, .. } => f.write_str("listed"),
            Self::Entry { address: Some(address), is_static: true } => {
                write!(f, "pinned {address}")
            }
            Self::Entry { address: Some(address), .. } => write!(f, "listed {address}"),
        }
    }
}

/// Writes the value as JSON: null if it is not there.
impl Serialize for DifferenceValue {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        /// An entry as JSON.
        #[derive(Serialize)]
        struct EntryValueJson {
            address: Option<u8>,
            #[serde(rename = "static")]
            is_static: bool,
        }
        match self {
            Self::Absent => to.serialize_none(),
            Self::Word(word) => to.serialize_str(word),
            Self::Words(words) => words.serialize(to),
            Self::Count(count) => to.serialize_u64(*count),
            Self::Millis(value) | Self::Share(value) => to.serialize_f64(*value),
            Self::Entry { address, is_static } => {
                EntryValueJson { address: *address, is_static: *is_static }.serialize(to)
            }
        }
    }
}

/// What a difference is about, on one side.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct DifferenceSubject {
    /// Name of the bus; `None` for des.json alone.
    pub bus: Option<String>,
    /// Address; `None` for a bus.
    pub address: Option<u8>,
    /// Name of the device; `None` if it is not known, and for a bus.
    pub name: Option<String>,
    /// UID of the device as text, empty if blank; `None` if it is not known, and for a bus.
    pub uid: Option<String>,
}

/// A difference between two inventories. The subject is missing on a side without the device, the
/// finding or the bus.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// What differs.
    pub kind: DifferenceKind,
    /// Kind of the finding, or name of the value of the bus; empty for the other kinds.
    pub detail: String,
    /// What it is about, before.
    pub subject_before: Option<DifferenceSubject>,
    /// The same after.
    pub subject_after: Option<DifferenceSubject>,
    /// Value before.
    pub before: DifferenceValue,
    /// Value after.
    pub after: DifferenceValue,
}

impl Difference {
    /// What it is about: after, or before where it is no longer there.
    pub fn subject(&self) -> Option<&DifferenceSubject> {
        self.subject_after.as_ref().or(self.subject_before.as_ref())
    }

    /// Text in the column WHAT: `version`, `finding`, `bus load`.
    pub fn what(&self) -> String {
        match self.kind {
            DifferenceKind::Bus => format!("bus {}", self.detail),
            DifferenceKind::Finding => self.detail.clone(),
            kind => kind.title().to_owned(),
        }
    }

    /// What rows are ordered by: a device with its findings, then the bus, at last des.json.
    pub(super) fn rank(&self) -> impl Ord + use<> {
        let subject = self.subject().cloned().unwrap_or_default();
        let is_of_bus = subject.address.is_none();
        let DifferenceSubject { bus, address, name, uid } = subject;
        let is_of_finding = self.kind == DifferenceKind::Finding;
        let place = (bus.is_none(), bus, is_of_bus, address, is_of_finding, name, uid);
        let values = (self.before.to_string(), self.after.to_string());
        (place, self.kind, self.detail.clone(), self.subject_before.clone(), values)
    }
}

/// Side of a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum DifferenceSide {
    /// The first inventory.
    Before,
    /// The second inventory.
    After,
}

impl DifferenceSide {
    /// Name in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Before => "before",
            Self::After => "after",
        }
    }
}

/// What was not compared, because one side does not know it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct UnknownPart {
    /// What is not known.
    pub kind: DifferenceKind,
    /// Side that does not know it.
    pub side: DifferenceSide,
    /// Number of devices for which the other side knows it.
    pub devices: usize,
}

impl UnknownPart {
    /// Returns a sentence; `side` is what the side is named there: `services of 3 devices not known
    /// in BEFORE`.
    pub fn text(&self, side: &str) -> String {
        let words = self.kind.words();
        match (self.kind, self.devices) {
            (DifferenceKind::File, _) => format!("{words} not known in {side}"),
            (_, 1) => format!("{words} of 1 device not known in {side}"),
            (_, devices) => format!("{words} of {devices} devices not known in {side}"),
        }
    }
}
