//! What is wrong in a file that is JSON: values of the wrong shape, and entries that collide.

use std::fmt;

use super::position::{Position, Positions};
use super::syntax::JsonKind;

/// Something in the file that a person should look at. The rest of the file stays in force.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DocumentFinding {
    /// What it is.
    pub kind: DocumentFindingKind,
    /// Where: the value concerned, in collisions that of the second entry.
    pub position: Position,
    /// What is wrong, in one sentence, safe on a terminal.
    pub message: String,
    /// The entries concerned, as indexes into [`Document::entries`](super::Document::entries);
    /// empty when it is about the file as a whole or about an element that is no entry.
    pub entries: Vec<usize>,
}

/// Kinds of findings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum DocumentFindingKind {
    /// Neither an object nor a list of devices, or `devices` is no list.
    NotDevices,
    /// An element of the list is no object.
    NotAnEntry,
    /// An entry without a name.
    MissingName,
    /// A member has a value of another type than it should.
    WrongType,
    /// An address that is not a whole number from 1 to 127.
    AddressRange,
    /// `name_hex` says another name than `name`.
    NamesDiffer,
    /// A member is there twice, and readers disagree which one counts. Here it is the last.
    DuplicateMember,
    /// Two entries have one static address on one bus.
    DuplicateAddress,
    /// Two entries have one name and one address on one bus.
    DuplicateEntry,
}

impl DocumentFindingKind {
    /// The name that scripts rely on (interfaces, `kind`).
    pub fn name(self) -> &'static str {
        match self {
            Self::DuplicateAddress => "file-duplicate-address",
            Self::DuplicateEntry => "file-duplicate-entry",
            _ => "file-shape",
        }
    }
}

impl DocumentFinding {
    /// What is wrong, without how it should be.
    pub fn brief(&self) -> &str {
        self.message.split(';').next().unwrap_or_default()
    }
}

impl fmt::Display for DocumentFinding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.position, self.message)
    }
}

/// How many findings are kept: a wrong file of megabytes may have as many as it has bytes.
const MOST: usize = 1000;

/// Keeps the first findings of many, in the order of the file; of `more` others only the number is
/// known.
pub(super) fn keep_first(findings: &mut Vec<DocumentFinding>, more: usize) {
    findings.sort_by(|a, b| (a.position, &a.message).cmp(&(b.position, &b.message)));
    let more = more + findings.len().saturating_sub(MOST);
    findings.truncate(MOST);
    if let Some(last) = findings.last().filter(|_| more > 0) {
        let (kind, position) = (last.kind, last.position);
        let message = format!("{more} more errors after this one");
        findings.push(DocumentFinding { kind, position, message, entries: Vec::new() });
    }
}

/// Collects findings while the file is read.
pub(super) struct Findings<'a> {
    positions: &'a Positions<'a>,
    /// The first ones.
    pub found: Vec<DocumentFinding>,
    /// How many others there are.
    pub more: usize,
}

impl<'a> Findings<'a> {
    pub fn new(positions: &'a Positions<'a>) -> Self {
        Self { positions, found: Vec::new(), more: 0 }
    }

    pub fn position(&self, at: usize) -> Position {
        self.positions.at(at)
    }

    pub fn add(
        &mut self,
        kind: DocumentFindingKind,
        at: usize,
        message: String,
        entry: Option<usize>,
    ) {
        if self.found.len() == MOST {
            self.more += 1;
            return;
        }
        self.found.push(DocumentFinding {
            kind,
            position: self.positions.at(at),
            message,
            entries: entry.into_iter().collect(),
        });
    }

    pub fn duplicate(&mut self, key: &str, at: usize, entry: Option<usize>) {
        let message = format!("duplicate `{key}`; the last one is used");
        self.add(DocumentFindingKind::DuplicateMember, at, message, entry);
    }

    /// `what` is no `expected`: a member, or something in one.
    pub fn wrong_type(
        &mut self,
        what: &str,
        at: usize,
        found: &JsonKind,
        expected: &str,
        entry: Option<usize>,
    ) {
        let message = format!("{what} is {found}; it must be {expected}");
        self.add(DocumentFindingKind::WrongType, at, message, entry);
    }
}
