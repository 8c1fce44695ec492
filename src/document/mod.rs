//! `des.json`: read, checked, edited in place, and merged with what others wrote meanwhile.
//!
//! The file is the user's, so an edit is an [`Operation`] that changes the bytes of its own values
//! and no others: [`Document::apply`] splices them into the source, reads the result again and
//! compares it with what was meant before it hands it out. Operations find their entry by
//! [`EntryKey`], hence can be made again on newer content ([`merge`]) and taken back
//! ([`Operation::inverse`]).
//!
//! What it deliberately does not know: files, time, the bus, the devices on it, and the rest of the
//! program. Bytes in, bytes out.
//!
//! ```text
//! mod        Document: what the file says
//! syntax     is it JSON? ParseError
//! scan       byte spans of containers and their items
//! position   lines and columns
//! entry      reading entries
//! finding    what is wrong with them
//! duplicates entries that cannot both be right
//! operation  edits as values, their keys, names and inverses
//! edit       edits carried out
//! layout     the file's own style
//! merge      edits on newer content
//! text       names: JSON, hexadecimal
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
mod syntax;
mod text;

use std::collections::HashMap;
use std::fmt;
use std::sync::Arc;

pub use changes::changes;
pub use edit::EditError;
pub use entry::{Entry, ListedService};
pub use finding::{DocumentFinding, DocumentFindingKind};
pub use merge::{Choices, EditConflict, Merge, MergePreference, merge, merge_chosen};
pub use operation::{EntryKey, FormerContent, FormerMembers, NewEntry, Operation, RemovedEntry};
pub use position::Position;
pub use syntax::ParseError;

use finding::Findings;
use position::Positions;
use scan::Span;
use syntax::{BOM, JsonKind};

/// Most elements in the list of devices. A bus has 127 addresses.
pub const MAX_ENTRIES: usize = 20_000;

/// Longest file, in bytes: [`MAX_ENTRIES`] entries of some 800 bytes. Callers that read a file check
/// it before they parse the content.
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
/// let pin = Operation::SetAddress { from: entry.address, entry, to: 16 };
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
    /// Of each entry, how many before it have its key.
    occurrences: Vec<usize>,
    findings: Vec<DocumentFinding>,
    /// Of each entry, whether there is a finding about it.
    is_flawed: Vec<bool>,
}

/// What the file's one value is, in spans of the body: the source without a byte order mark.
#[derive(Debug)]
enum Root {
    /// Nothing but blanks.
    Blank,
    /// A bare list of devices.
    List(Span),
    /// An object, the value of `devices`, unless that is null, and where `devices` is for the
    /// second time.
    Object { span: Span, devices: Option<Span>, again: Option<usize> },
    /// Something else.
    Other(Span),
}

impl Root {
    /// What stands in the place of the list of devices.
    fn list(&self) -> Option<&Span> {
        match self {
            Self::List(span) | Self::Object { devices: Some(span), .. } => Some(span),
            Self::Blank | Self::Object { devices: None, .. } | Self::Other(_) => None,
        }
    }
}

impl Document {
    /// Reads the content of a file. Blank content is an empty document; JSON of another shape is
    /// one with findings.
    ///
    /// # Errors
    /// [`ParseError`] when it is not JSON in UTF-8, or nests deeper than 128 levels.
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
        let (found, more) = (findings.found, findings.more);
        Ok(Self::of(source, root, elements, entries, found, more))
    }

    /// Of what was read, with the findings about single elements, and the number of those that are
    /// too many.
    fn of(
        source: String,
        root: Root,
        elements: Vec<Span>,
        entries: Vec<Entry>,
        mut findings: Vec<DocumentFinding>,
        more: usize,
    ) -> Self {
        findings.extend(duplicates::collisions(&entries));
        finding::keep_first(&mut findings, more);
        let occurrences = occurrences(&entries);
        let mut is_flawed = vec![false; entries.len()];
        for &index in findings.iter().flat_map(|finding| &finding.entries) {
            is_flawed[index] = true;
        }
        let inner = Inner { source, root, elements, entries, occurrences, findings, is_flawed };
        Self { inner: Arc::new(inner) }
    }

    /// The document of a file that is missing or empty.
    pub fn empty() -> Self {
        Self::of(String::new(), Root::Blank, Vec::new(), Vec::new(), Vec::new(), 0)
    }

    /// The bytes of the file.
    pub fn source(&self) -> &[u8] {
        self.inner.source.as_bytes()
    }

    /// Whether there is nothing in it but blanks.
    pub fn is_blank(&self) -> bool {
        matches!(self.root(), Root::Blank)
    }

    /// What the file says about devices, in its order.
    pub fn entries(&self) -> &[Entry] {
        &self.inner.entries
    }

    /// What is wrong in it, in the order of the file; of very many things the first, and then how
    /// many more there are.
    pub fn findings(&self) -> &[DocumentFinding] {
        &self.inner.findings
    }

    /// How the entry at this place is found again in other content.
    ///
    /// # Panics
    /// When `index` is not one of [`Document::entries`].
    pub fn key(&self, index: usize) -> EntryKey {
        EntryKey {
            occurrence: self.inner.occurrences[index],
            ..EntryKey::of(&self.entries()[index])
        }
    }

    /// The place in [`Document::entries`] of the entry that has exactly this key.
    pub fn find(&self, key: &EntryKey) -> Option<usize> {
        let mut fitting = self.entries().iter().filter(|entry| key.fits(entry));
        fitting.nth(key.occurrence).map(|entry| entry.index)
    }

    /// A static address of several entries, which it was not yet in the document before.
    pub fn new_clash(&self, before: &Document) -> Option<&DocumentFinding> {
        let address = |document: &Document, finding: &DocumentFinding| {
            let first = finding.entries.first().and_then(|&index| document.entries().get(index));
            first.and_then(|entry| entry.address)
        };
        let is_clash =
            |finding: &&DocumentFinding| finding.kind == DocumentFindingKind::DuplicateAddress;
        self.findings().iter().filter(is_clash).find(|clash| {
            let mut known = before.findings().iter().filter(is_clash);
            known.all(|known| address(before, known) != address(self, clash))
        })
    }

    /// What is wrong with the entry at this place.
    pub fn findings_of(&self, index: usize) -> impl Iterator<Item = &DocumentFinding> {
        let findings = if self.is_flawed(index) { self.findings() } else { &[] };
        findings.iter().filter(move |finding| finding.entries.contains(&index))
    }

    /// Is there a finding about the entry at this place?
    pub fn is_flawed(&self, index: usize) -> bool {
        self.inner.is_flawed.get(index) == Some(&true)
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

    /// The entry at this place as it stands in the file, to the byte.
    ///
    /// # Panics
    /// When `index` is not one of [`Document::entries`].
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
    let mut again = None;
    for item in scan::container(body, &span).into_iter().flat_map(|object| object.items) {
        if text::from_json(&body[item.key.clone()]).as_deref() != Some("devices") {
            continue;
        }
        if devices.replace(item.value).is_some() {
            again = again.or(Some(item.key.start));
            findings.duplicate("devices", item.key.start, None);
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

/// Of each entry, how many before it have its key.
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
