//! des.json: parsing, checks, edits in place, and a three-way merge with changes on disk.
//!
//! Input and output are the bytes of the file. An edit is an [`Operation`], which changes the bytes
//! of its own values only: [`Document::apply`] splices them into the source, parses the result and
//! compares it with the intended content. An operation finds its entry by [`EntryKey`], so that it
//! can be applied to newer content ([`merge`]) and undone ([`Operation::inverse`]).
//!
//! Limits: [`MAX_ENTRIES`], [`MAX_SERVICES`], [`MAX_BYTES`], 128 levels of nesting. Does not know files, time, buses
//! or devices.
//!
//! ```text
//! mod        Document: content of the file
//! syntax     JSON syntax, ParseError
//! scan       byte spans of lists, objects and their items
//! position   lines and columns
//! entry      reading of entries
//! finding    findings about entries
//! duplicates contradictory entries
//! operation  edits as values: keys, names, inverses
//! edit       application of edits
//! layout     the file's own layout
//! merge      three-way merge
//! changes    differences between two versions, for messages
//! services   services of an entry and of its device
//! text       strings: JSON, hexadecimal
//! ```

mod changes;
mod duplicates;
mod edit;
mod entry;
mod finding;
mod layout;
mod merge;
mod operation;
mod position;
mod scan;
mod services;
mod syntax;
mod text;

use std::collections::HashMap;
use std::fmt;
use std::sync::Arc;

pub use changes::changes;
pub use edit::EditError;
pub use entry::{Entry, ListedService};
pub use finding::{DocumentFinding, DocumentFindingKind};
pub use merge::{ConflictChoices, EditConflict, Merge, MergePreference, merge, merge_with_choices};
pub use operation::{EntryKey, FormerContent, FormerMembers, NewEntry, Operation, RemovedEntry};
pub use position::Position;
pub use services::{OwnService, same_services, service_differences};
pub use syntax::ParseError;

use finding::Findings;
use position::Positions;
use scan::Span;
use syntax::{BOM, JsonKind};

/// Most elements in the list of devices. A bus has 127 addresses.
pub const MAX_ENTRIES: usize = 20_000;

/// Most services of an entry: DES numbers them with one byte.
pub const MAX_SERVICES: usize = 256;

/// Longest file, in bytes: [`MAX_ENTRIES`] entries of some 800 bytes. Checked by the caller that
/// reads the file, before it parses the content.
pub const MAX_BYTES: usize = 16 << 20;

/// The JSON Schema (2020-12) of the file.
pub const SCHEMA: &str = include_str!("des.schema.json");

/// The content of a des.json: its bytes, and the entries and findings read from them. Cheap to
/// clone. Two documents are equal if their bytes are.
///
/// ```
/// use descan::document::{Document, Operation};
///
/// let document = Document::parse(br#"[ {"name": "FEED", "address": 12, "note": 1} ]"#)?;
/// let entry = document.key(0);
/// let pin = Operation::PinAddress { from: entry.address, entry, to: 16 };
/// let edited = document.apply(&pin)?;
/// let expected = br#"[ {"name": "FEED", "address": 16, "static": true, "note": 1} ]"#;
/// assert_eq!(edited.source(), expected);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct Document {
    inner: Arc<Inner>,
}

struct Inner {
    source: String,
    root: Root,
    /// The elements of the list of devices, whether or not they are entries.
    elements: Vec<Span>,
    entries: Vec<Entry>,
    /// For each entry, the number of earlier entries with its key.
    occurrences: Vec<usize>,
    findings: Vec<DocumentFinding>,
    /// For each entry, true if a finding concerns it.
    has_findings: Vec<bool>,
}

/// The top-level value, with spans of the body: the source without its byte order mark.
#[derive(Debug)]
enum Root {
    /// Only white space.
    Blank,
    /// A bare list of devices.
    List(Span),
    /// An object; the value of `devices`, unless it is null; the offset of a second `devices`.
    Object { span: Span, devices: Option<Span>, again: Option<usize> },
    /// Any other value.
    Other(Span),
}

impl Root {
    /// Returns the span of the list of devices, or of the value in its place.
    fn list(&self) -> Option<&Span> {
        match self {
            Self::List(span) | Self::Object { devices: Some(span), .. } => Some(span),
            Self::Blank | Self::Object { devices: None, .. } | Self::Other(_) => None,
        }
    }
}

impl Document {
    /// Returns true if both are the same content in memory.
    pub fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.inner, &other.inner)
    }

    /// Parses the content of a file. Blank content is an empty document; JSON of another shape is
    /// a document with findings.
    ///
    /// # Errors
    /// [`ParseError`] if it is not JSON in UTF-8, nests deeper than 128 levels, or lists more than
    /// [`MAX_ENTRIES`] devices, or more than [`MAX_SERVICES`] services of one.
    pub fn parse(source: &[u8]) -> Result<Self, ParseError> {
        let source = syntax::check(source)?.to_owned();
        let body = source.strip_prefix(BOM).unwrap_or(&source);
        let positions = Positions::new(body);
        let mut findings = Findings::new(&positions);
        let root = read_root(body, &mut findings);
        let list = root.list().filter(|list| body[(*list).clone()].starts_with('['));
        let elements = list.into_iter().flat_map(|list| scan::elements(body, list));
        let elements: Vec<Span> = elements.take(MAX_ENTRIES + 1).collect();
        if let Some(surplus) = elements.get(MAX_ENTRIES) {
            return Err(syntax::too_many_entries(body, surplus.start));
        }
        let entries = entry::read_all(body, &elements, &mut findings);
        let has_too_many =
            |entry: &&Entry| entry.services.as_ref().is_some_and(|it| it.len() > MAX_SERVICES);
        if let Some(entry) = entries.iter().find(has_too_many) {
            return Err(syntax::too_many_services(body, elements[entry.element].start));
        }
        let (found, more) = (findings.found, findings.more);
        Ok(Self::of(source, root, elements, entries, found, more))
    }

    /// Builds a document from its parts. `findings`: those about single elements; `more`: the
    /// number of findings that were left out.
    fn of(
        source: String,
        root: Root,
        elements: Vec<Span>,
        entries: Vec<Entry>,
        mut findings: Vec<DocumentFinding>,
        more: usize,
    ) -> Self {
        findings.extend(duplicates::duplicates(&entries));
        finding::keep_first(&mut findings, more);
        let occurrences = occurrences(&entries);
        let mut is_flawed = vec![false; entries.len()];
        for &index in findings.iter().flat_map(|finding| &finding.entries) {
            is_flawed[index] = true;
        }
        let inner = Inner {
            source,
            root,
            elements,
            entries,
            occurrences,
            findings,
            has_findings: is_flawed,
        };
        Self { inner: Arc::new(inner) }
    }

    /// Returns the document of a missing or empty file.
    pub fn empty() -> Self {
        Self::of(String::new(), Root::Blank, Vec::new(), Vec::new(), Vec::new(), 0)
    }

    /// Returns the bytes of the file.
    pub fn source(&self) -> &[u8] {
        self.inner.source.as_bytes()
    }

    /// Returns true if it has only white space.
    pub fn is_blank(&self) -> bool {
        matches!(self.root(), Root::Blank)
    }

    /// Returns the entries in the order of the file.
    pub fn entries(&self) -> &[Entry] {
        &self.inner.entries
    }

    /// Returns the findings in the order of the file: at most 1,000, then one with the number of
    /// further findings.
    pub fn findings(&self) -> &[DocumentFinding] {
        &self.inner.findings
    }

    /// Returns the key of an entry, by which it is found in other content.
    ///
    /// # Panics
    /// If `index` is not an index of [`Document::entries`].
    pub fn key(&self, index: usize) -> EntryKey {
        EntryKey {
            occurrence: self.inner.occurrences[index],
            ..EntryKey::of(&self.entries()[index])
        }
    }

    /// Returns the index of the entry with exactly this key; `None` if there is none.
    pub fn find(&self, key: &EntryKey) -> Option<usize> {
        let mut fitting = self.entries().iter().filter(|entry| key.fits(entry));
        fitting.nth(key.occurrence).map(|entry| entry.index)
    }

    /// Returns the finding about a static address of several entries that `before` does not have;
    /// `None` if there is none.
    pub fn new_duplicate_address(&self, before: &Document) -> Option<&DocumentFinding> {
        let address = |document: &Document, finding: &DocumentFinding| {
            let first = finding.entries.first().and_then(|&index| document.entries().get(index));
            first.and_then(|entry| entry.address)
        };
        let is_duplicate_address =
            |finding: &&DocumentFinding| finding.kind == DocumentFindingKind::DuplicateAddress;
        self.findings().iter().filter(is_duplicate_address).find(|duplicate| {
            let mut known = before.findings().iter().filter(is_duplicate_address);
            known.all(|known| address(before, known) != address(self, duplicate))
        })
    }

    /// Returns the findings with those that only a caller can find, who knows devices and buses.
    /// `mistakes_of` says what is wrong with an entry, and its kind.
    pub fn findings_with<M>(&self, mistakes_of: impl Fn(&Entry) -> M) -> Vec<DocumentFinding>
    where
        M: IntoIterator<Item = (DocumentFindingKind, String)>,
    {
        let wrong = self.entries().iter().flat_map(|entry| {
            let mistakes = mistakes_of(entry).into_iter();
            mistakes.map(|(kind, message)| entry_finding(entry, kind, message))
        });
        finding::merged(self.findings(), wrong.collect())
    }

    /// Yields the findings about an entry.
    pub fn findings_of(&self, index: usize) -> impl Iterator<Item = &DocumentFinding> {
        let findings = if self.has_findings(index) { self.findings() } else { &[] };
        findings.iter().filter(move |finding| finding.entries.contains(&index))
    }

    /// Returns true if a finding concerns the entry.
    pub fn has_findings(&self, index: usize) -> bool {
        self.inner.has_findings.get(index) == Some(&true)
    }

    fn body(&self) -> &str {
        self.inner.source.strip_prefix(BOM).unwrap_or(&self.inner.source)
    }

    fn has_bom(&self) -> bool {
        self.inner.source.starts_with(BOM)
    }

    fn root(&self) -> &Root {
        &self.inner.root
    }

    fn elements(&self) -> &[Span] {
        &self.inner.elements
    }

    fn entry_span(&self, index: usize) -> Span {
        self.elements()[self.entries()[index].element].clone()
    }

    /// Returns the exact text of an entry in the file.
    ///
    /// # Panics
    /// If `index` is not an index of [`Document::entries`].
    pub fn entry_text(&self, index: usize) -> &str {
        &self.body()[self.entry_span(index)]
    }
}

fn read_root(body: &str, findings: &mut Findings) -> Root {
    let Some(span) = scan::root(body) else { return Root::Blank };
    let text = &body[span.clone()];
    if text.starts_with('[') {
        return Root::List(span);
    }
    if !text.starts_with('{') {
        let message = format!("the file is {}, not an object with `devices`", JsonKind(text));
        findings.add(DocumentFindingKind::NotDevices, span.start, message, None);
        return Root::Other(span);
    }
    let mut devices: Option<Span> = None;
    let (mut again, mut unknown) = (None, Vec::new());
    for item in scan::items_at(body, &span).into_iter().flatten() {
        let key = text::from_json(&body[item.key.clone()]);
        if key.as_deref() != Some("devices") {
            unknown.extend(key.map(|key| (key, item.key.start)));
            continue;
        }
        if devices.replace(item.value).is_some() {
            again = again.or(Some(item.key.start));
            findings.duplicate("devices", item.key.start, None);
        }
    }
    if devices.is_none() && !unknown.is_empty() {
        let mut is_misspelled = false;
        for (key, at) in &unknown {
            is_misspelled |= findings.misspelled(key, *at, ["devices"], None);
        }
        if !is_misspelled {
            let message = "the object has no `devices`; it must have a list of them".to_owned();
            findings.add(DocumentFindingKind::NotDevices, span.start, message, None);
        }
    }
    devices = devices.filter(|devices| &body[devices.clone()] != "null");
    if let Some(devices) = &devices
        && !body[devices.clone()].starts_with('[')
    {
        let message =
            format!("`devices` is {}; it must be a list", JsonKind(&body[devices.clone()]));
        findings.add(DocumentFindingKind::NotDevices, devices.start, message, None);
    }
    Root::Object { span, devices, again }
}

/// A finding about an entry, at the value that it is about.
fn entry_finding(entry: &Entry, kind: DocumentFindingKind, message: String) -> DocumentFinding {
    let uid = entry.uid_position.filter(|_| kind == DocumentFindingKind::UnusableUid);
    let position = uid.unwrap_or(entry.position);
    DocumentFinding { kind, position, message, entries: vec![entry.index] }
}

/// Returns, for each entry, the number of earlier entries with its key.
fn occurrences(entries: &[Entry]) -> Vec<usize> {
    let mut seen = HashMap::with_capacity(entries.len());
    let mut occurrences = Vec::with_capacity(entries.len());
    for Entry { bus, name, address, uid, .. } in entries {
        let count = seen.entry((address, name, bus, uid)).or_insert(0);
        occurrences.push(*count);
        *count += 1;
    }
    occurrences
}

impl PartialEq for Document {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.inner, &other.inner) || self.inner.source == other.inner.source
    }
}

impl Eq for Document {}

impl fmt::Debug for Document {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Document")
            .field("source", &self.inner.source)
            .field("findings", &self.inner.findings)
            .finish_non_exhaustive()
    }
}
