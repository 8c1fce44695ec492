//! des.json: an input is a file; behind a zero byte, choices of edits; behind another one, the file
//! as another program wrote it meanwhile.
//!
//! The values match those of another JSON parser; an edit changes only its own part and can be
//! undone; a merge keeps the edits of both sides.

use super::Target;
use super::choices::Choices;
use descan::document::{
    Document, EditError, EntryKey, ListedService, Merge, MergePreference, NewEntry, Operation,
    merge,
};
use serde::de::{Deserialize, Deserializer, IgnoredAny, MapAccess, Visitor};
use serde_json::Value;
use serde_json::value::RawValue;
use std::fmt;
use std::ops::AddAssign;

/// Target `document`.
pub const DOCUMENT: Target = Target {
    name: "document",
    check: |input| {
        let mut parts = input.splitn(3, |byte| *byte == 0);
        let mut part = || parts.next().unwrap_or_default();
        check_file(part(), part(), part());
    },
    words: &[
        b"{",
        b"}",
        b"[",
        b"]",
        b",",
        b":",
        b"\"",
        b"\\",
        b" ",
        b"\n",
        b"\r\n",
        b"\t",
        b"\xEF\xBB\xBF",
        b"\0",
        b"null",
        b"true",
        b"false",
        b"0",
        b"1",
        b"12",
        b"128",
        b"-0",
        b"1e2",
        b"012",
        b"1.",
        b"\"name\":",
        b"\"address\":",
        b"\"static\":",
        b"\"services\":",
        b"\"name_hex\":",
        b"\"devices\":",
        b"\"bus\":\"can1\"",
        b"\"uid\":\"\"",
        b"\\ud800",
        b"\\u0000",
        b"\xD0\x96",
        b"\xF0\x9F\x94\xA5",
        b"{\"name\":\"A\"}",
        b"\"version\":",
        b"\"extra\":[\"x\"]",
    ],
};

/// Counters of what was tried.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// Files.
    pub files: u64,
    /// Files that are not JSON.
    pub broken: u64,
    /// Edits.
    pub edits: u64,
    /// Edits that were rejected.
    pub refused: u64,
    /// Merges.
    pub merges: u64,
    /// Merges that are conflicts.
    pub conflicts: u64,
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.files += other.files;
        self.broken += other.broken;
        self.edits += other.edits;
        self.refused += other.refused;
        self.merges += other.merges;
        self.conflicts += other.conflicts;
    }
}

/// Reads a file, edits it as `choices` say, and merges the edits with other edits of it, or with the
/// file `theirs`.
///
/// # Panics
///
/// If a rule of the document is broken.
pub fn check_file(source: &[u8], choices: &[u8], theirs: &[u8]) -> Tally {
    let mut case = Case { choices: Choices::new(choices), tally: Tally::default() };
    case.run(source, theirs);
    case.tally
}

struct Case<'i> {
    choices: Choices<'i>,
    tally: Tally,
}

impl Case<'_> {
    fn run(&mut self, source: &[u8], theirs: &[u8]) {
        self.tally.files += 1;
        let Some(document) = self.read(source) else { return };
        let (documents, ours) = self.edited(document, 4);
        let base = documents.into_iter().next().unwrap();
        let theirs = if self.choices.below(3) == 0 {
            let Some(document) = self.read(theirs) else { return };
            document
        } else {
            self.edited(base.clone(), 3).0.pop().unwrap()
        };
        self.merge(&base, &ours, &theirs);
    }

    /// Parses a file with descan and with another JSON parser, and compares the results.
    fn read(&mut self, source: &[u8]) -> Option<Document> {
        let body = source.strip_prefix("\u{feff}".as_bytes()).unwrap_or(source);
        let other = serde_json::from_slice::<Value>(body);
        let document = match Document::parse(source) {
            Ok(document) => document,
            Err(error) => {
                self.tally.broken += 1;
                let lines = source.split(|byte| *byte == b'\n').count();
                assert!((1..=lines).contains(&error.line) && error.column >= 1, "{error}");
                assert!(error.line_text.chars().count() < 1000, "{error:?}");
                let shown =
                    error.to_string() + &error.excerpt().into_iter().flatten().collect::<String>();
                assert!(!shown.contains(char::is_control), "{shown:?}");
                assert!(other.is_err(), "{error}: {:?}", String::from_utf8_lossy(source));
                return None;
            }
        };
        assert_eq!(document.source(), source);
        for finding in document.findings() {
            assert!(!finding.message.contains(char::is_control), "{finding}");
        }
        // The other parser rejects half a surrogate pair in any string.
        if let Ok(other) = other {
            let list = if other.is_object() { other.get("devices").cloned() } else { Some(other) };
            let list = list.as_ref().and_then(Value::as_array).cloned().unwrap_or_default();
            let read: Vec<_> = list.iter().filter_map(as_read_elsewhere).collect();
            let entries = document.entries().iter();
            let own: Vec<_> =
                entries.map(|it| (it.name.clone(), it.address, it.is_static)).collect();
            assert_eq!(own, read, "{}", text(&document));
        }
        Some(document)
    }

    // ---- edits ----

    fn operation(&mut self, document: &Document) -> Operation {
        const NAMES: [&[u8]; 7] = [b"FEED", b"A", b"\"\\", b"\xff\x1b", "Ж".as_bytes(), b"", b"\0"];
        let choices = &mut self.choices;
        let count = document.entries().len();
        let kind = choices.below(8);
        if count == 0 || kind == 0 {
            let entry = NewEntry {
                name: choices.one_of(&NAMES).to_vec(),
                address: choices.flag().then(|| address(choices)),
                is_static: false,
                bus: (choices.below(5) == 4).then(|| "can0".to_owned()),
                uid: (choices.below(5) == 4).then(|| "X1".to_owned()),
                services: services(choices),
            };
            let is_static = entry.address.is_some() && choices.flag();
            return Operation::Add { entry: NewEntry { is_static, ..entry } };
        }
        let entry = document.key(choices.below(count.min(256)));
        let from = entry.address;
        match kind {
            1 => Operation::UnpinAddress { entry, from },
            2 => Operation::Rename { entry, to: choices.one_of(&NAMES).to_vec() },
            3 | 4 => Operation::SetServices { entry, services: services(choices) },
            5 => Operation::Remove { entry },
            _ => Operation::PinAddress { entry, from, to: address(choices) },
        }
    }

    /// Applies edits in sequence; returns all documents, the first one included, and the edits.
    fn edited(&mut self, first: Document, most: usize) -> (Vec<Document>, Vec<Operation>) {
        let mut documents = vec![first];
        let mut operations = Vec::new();
        for _ in 0..self.choices.below(most + 1) {
            let before = documents.last().unwrap().clone();
            let operation = self.operation(&before);
            self.tally.edits += 1;
            match before.apply(&operation) {
                Ok(after) => {
                    check_edit(&before, &operation, &after);
                    documents.push(after);
                    operations.push(operation);
                }
                Err(
                    EditError::DuplicateMember { .. }
                    | EditError::NotService { .. }
                    | EditError::NotDevices { .. },
                ) => {
                    assert_ne!(before.findings(), [], "{operation}");
                    self.tally.refused += 1;
                }
                Err(error) => panic!("{operation}: {error}\n{}", text(&before)),
            }
        }
        (documents, operations)
    }

    // ---- merging ----

    fn merge(&mut self, base: &Document, ours: &[Operation], theirs: &Document) {
        for prefer in [MergePreference::Neither, MergePreference::Ours, MergePreference::Theirs] {
            self.tally.merges += 1;
            match merge(base, ours, theirs, prefer) {
                Ok(Merge::Rebased { document, operations, .. }) => {
                    check_reading(&document);
                    let mut again = theirs.clone();
                    for operation in &operations {
                        again = again.apply(operation).unwrap();
                    }
                    assert_eq!(text(&again), text(&document));
                }
                Ok(Merge::Conflict(conflict)) => {
                    self.tally.conflicts += 1;
                    assert_eq!(prefer, MergePreference::Neither);
                    let shown =
                        format!("{}{}{}", conflict.operation, conflict.ours, conflict.theirs);
                    assert!(!shown.contains(char::is_control), "{shown:?}");
                }
                Err(
                    EditError::DuplicateMember { .. }
                    | EditError::NotService { .. }
                    | EditError::NotDevices { .. },
                ) => {}
                Err(error) => panic!("{error}\n{}\n{}\n{ours:?}", text(base), text(theirs)),
            }
        }
    }
}

/// Returns an address from 1 to 127.
fn address(choices: &mut Choices<'_>) -> u8 {
    1 + choices.below(127) as u8
}

fn services(choices: &mut Choices<'_>) -> Vec<ListedService> {
    let count = choices.below(4);
    let service = |_| ListedService {
        name: choices.one_of(&["DES", "AUGER", "\u{1b}"]).to_owned(),
        version: choices.one_of(&["", "1.0", "\"2\""]).to_owned(),
        extra: vec!["x".to_owned(); usize::from(choices.below(6) == 5)],
    };
    (0..count).map(service).collect()
}

fn text(document: &Document) -> &str {
    str::from_utf8(document.source()).unwrap()
}

/// Returns name, address and the static flag as a plain JSON parser reads them.
fn as_read_elsewhere(element: &Value) -> Option<(Vec<u8>, Option<u8>, bool)> {
    let entry = element.as_object()?;
    let hex = entry.get("name_hex").and_then(Value::as_str).filter(|hex| {
        hex.len().is_multiple_of(2) && hex.bytes().all(|digit| digit.is_ascii_hexdigit())
    });
    let bytes = |hex: &str| -> Vec<u8> {
        let pairs = hex.as_bytes().chunks(2).map(|pair| str::from_utf8(pair).unwrap());
        pairs.map(|pair| u8::from_str_radix(pair, 16).unwrap()).collect()
    };
    let name = entry.get("name").and_then(Value::as_str).map(|name| name.as_bytes().to_vec());
    let address = entry.get("address").and_then(Value::as_u64);
    let address = address.filter(|it| (1..=127).contains(it)).map(|it| it as u8);
    let is_static = entry.get("static") == Some(&Value::Bool(true));
    Some((hex.map(bytes).or(name)?, address, is_static))
}

/// Asserts that parsing the bytes again gives the same values.
fn check_reading(document: &Document) {
    let read = Document::parse(document.source()).unwrap();
    let keys = |document: &Document| -> Vec<EntryKey> {
        (0..document.entries().len()).map(|index| document.key(index)).collect()
    };
    assert_eq!(read.entries(), document.entries(), "{}", text(document));
    assert_eq!(read.findings(), document.findings(), "{}", text(document));
    assert_eq!(keys(&read), keys(document));
}

fn check_edit(before: &Document, operation: &Operation, after: &Document) {
    check_reading(after);
    let (old, new) = (before.source(), after.source());
    let start = old.iter().zip(new).take_while(|(a, b)| a == b).count();
    let end = old[start..].iter().rev().zip(new[start..].iter().rev());
    let end = end.take_while(|(a, b)| a == b).count();
    match operation.entry().and_then(|key| before.find(key)) {
        // An existing list keeps all its elements.
        None if old.contains(&b'[') && !before.entries().is_empty() => {
            assert_eq!(start + end, old.len(), "{operation}\n{}\n{}", text(before), text(after));
        }
        None => {}
        Some(_) if matches!(operation, Operation::Remove { .. }) => {
            assert_eq!(start + end, new.len(), "{operation}\n{}\n{}", text(before), text(after));
        }
        Some(index) => {
            let (old, new) = (entry_text(before, index), entry_text(after, index));
            assert_eq!(
                text(before).len() - old.len(),
                text(after).len() - new.len(),
                "{operation}\n{}\n{}",
                text(before),
                text(after)
            );
            let own = |member: &&(String, Box<RawValue>)| !is_changed_by(operation, &member.0);
            // `None` if a key has half a surrogate pair.
            let others = |text| -> Option<Vec<(String, String)>> {
                let members = serde_json::from_str::<Members>(text).ok()?.0;
                let others = members.iter().filter(own);
                Some(others.map(|(key, value)| (key.clone(), value.get().to_owned())).collect())
            };
            assert_eq!(others(old), others(new), "{operation}");
        }
    }
    let inverse = operation.inverse(before).unwrap();
    let back = after.apply(&inverse).unwrap_or_else(|error| panic!("{inverse}: {error}"));
    check_reading(&back);
    assert_eq!(text(&back), text(before), "{operation} taken back");
}

fn is_changed_by(operation: &Operation, member: &str) -> bool {
    match operation {
        Operation::PinAddress { .. } | Operation::UnpinAddress { .. } => {
            matches!(member, "address" | "static")
        }
        Operation::Rename { .. } => matches!(member, "name" | "name_hex"),
        Operation::SetServices { .. } => member == "services",
        _ => false,
    }
}

/// Returns the text of an entry, located by its position.
fn entry_text(document: &Document, index: usize) -> &str {
    let position = document.entries()[index].position;
    let body = text(document).trim_start_matches('\u{feff}');
    let line: usize = body.split_inclusive('\n').take(position.line - 1).map(str::len).sum();
    let column = body[line..].char_indices().nth(position.column - 1).unwrap().0;
    let rest = &body[line + column..];
    let mut values = serde_json::Deserializer::from_str(rest).into_iter::<IgnoredAny>();
    values.next().unwrap().unwrap();
    &rest[..values.byte_offset()]
}

/// The members of an object, in order.
struct Members(Vec<(String, Box<RawValue>)>);

impl<'de> Deserialize<'de> for Members {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Found;
        impl<'de> Visitor<'de> for Found {
            type Value = Members;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Members, A::Error> {
                let mut members = Vec::new();
                while let Some(member) = map.next_entry()? {
                    members.push(member);
                }
                Ok(Members(members))
            }
        }
        deserializer.deserialize_map(Found)
    }
}
