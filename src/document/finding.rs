//! Findings about a file that is valid JSON: values of the wrong type, and contradictory entries.

use std::fmt;

use super::position::{Position, Positions};
use super::syntax::JsonKind;
use super::text;

/// A fault in the file. The rest of the file is used.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DocumentFinding {
    /// Kind of the finding.
    pub kind: DocumentFindingKind,
    /// Position of the value concerned; for contradictory entries that of the second one.
    pub position: Position,
    /// One sentence, safe on a terminal.
    pub message: String,
    /// Indexes of the entries concerned in [`Document::entries`](super::Document::entries); empty
    /// for the file as a whole and for an element that is not an entry.
    pub entries: Vec<usize>,
}

/// Kinds of findings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum DocumentFindingKind {
    /// The file is neither an object nor a list, or `devices` is missing or not a list.
    NotDevices,
    /// An element of the list is not an object.
    NotAnEntry,
    /// An entry without a name.
    MissingName,
    /// A member has a value of the wrong type.
    WrongType,
    /// An address that is not a whole number from 1 to 127.
    AddressRange,
    /// `name_hex` and `name` are different names.
    NamesDiffer,
    /// A member occurs twice; the last one is used.
    DuplicateMember,
    /// A member that descan does not read, with nearly the name of one that is missing.
    MisspelledMember,
    /// An entry with `static`, but without an address.
    StaticWithoutAddress,
    /// A `uid` that no device can have.
    UnusableUid,
    /// The bus of an entry has another des.json.
    BusOfAnotherFile,
    /// Several entries have the same UID on one bus.
    DuplicateUid,
    /// Several entries have the same static address on one bus.
    DuplicateAddress,
    /// Several entries have the same name and address on one bus.
    DuplicateEntry,
}

impl DocumentFinding {
    /// Returns the message up to its first semicolon: what is wrong, without the remedy.
    pub fn brief(&self) -> &str {
        self.message.split(';').next().unwrap_or_default()
    }
}

impl fmt::Display for DocumentFinding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.position, self.message)
    }
}

/// Fewest bytes of a name in which one wrong letter is a mistake: shorter ones differ by chance.
const MIN_MISSPELLED: usize = 4;

/// Most findings kept: a wrong file may have as many as it has bytes.
const MAX_FINDINGS: usize = 1000;

/// Sorts findings by position and keeps the first [`MAX_FINDINGS`], followed by one with the number
/// of further findings. `more`: findings that were left out before.
pub(super) fn keep_first(findings: &mut Vec<DocumentFinding>, more: usize) {
    findings.sort_by(|a, b| (a.position, &a.message).cmp(&(b.position, &b.message)));
    let more = more + findings.len().saturating_sub(MAX_FINDINGS);
    findings.truncate(MAX_FINDINGS);
    if let Some(last) = findings.last().filter(|_| more > 0) {
        let (kind, position) = (last.kind, last.position);
        let message = format!("{more} more errors after this one");
        findings.push(DocumentFinding { kind, position, message, entries: Vec::new() });
    }
}

/// Returns `findings` with those of a caller that knows more than the file, as bounded. Where findings
/// are left out already, there is no room for others.
pub(super) fn merged(
    findings: &[DocumentFinding],
    others: Vec<DocumentFinding>,
) -> Vec<DocumentFinding> {
    let mut all = findings.to_vec();
    if all.len() <= MAX_FINDINGS && !others.is_empty() {
        all.extend(others);
        keep_first(&mut all, 0);
    }
    all
}

/// Findings collected while the file is read.
pub(super) struct Findings<'a> {
    positions: &'a Positions<'a>,
    /// The first [`MAX_FINDINGS`].
    pub found: Vec<DocumentFinding>,
    /// Number of further ones.
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
        if self.found.len() == MAX_FINDINGS {
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

    /// Adds a finding if an unknown member of this name is probably one of the `missing` ones; returns
    /// true then.
    pub fn misspelled(
        &mut self,
        key: &str,
        at: usize,
        missing: impl IntoIterator<Item = &'static str>,
        entry: Option<usize>,
    ) -> bool {
        let is_meant = |known: &&str| {
            key.eq_ignore_ascii_case(known)
                || known.len().min(key.len()) >= MIN_MISSPELLED
                    && key.len() <= known.len() + 1
                    && strsim::damerau_levenshtein(key, known) == 1
        };
        let meant = missing.into_iter().find(is_meant);
        if let Some(meant) = meant {
            let key = text::brief(key.as_bytes());
            let message = format!("`{key}` is not read; is `{meant}` meant?");
            self.add(DocumentFindingKind::MisspelledMember, at, message, entry);
        }
        meant.is_some()
    }

    /// Adds a finding: `what`, a member or a part of one, is `found` instead of `expected`.
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
