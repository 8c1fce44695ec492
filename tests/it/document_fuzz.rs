//! Random unusual files and random edits of them: no panic; the values match those of another JSON
//! parser; an edit changes only its own part and can be undone.
//!
//! `SECONDS=600 cargo test --test it document_fuzz -- --nocapture` runs for that time, starting at
//! `SEED` if that is set; a case that fails prints its seed.

use descan::document::{
    Document, EditError, EntryKey, ListedService, Merge, MergePreference, NewEntry, Operation,
    merge,
};
use fastrand::Rng;
use serde::de::{Deserialize, Deserializer, IgnoredAny, MapAccess, Visitor};
use serde_json::Value;
use serde_json::value::RawValue;
use std::fmt;
use std::time::{Duration, Instant};

/// Files in many shapes and styles.
const FILES: [&str; 8] = [
    r#"{
  "devices": [
    { "name": "FEED", "address": 12, "static": true,
      "services": [ { "name": "DES", "version": "1.0" }, { "name": "AUGER", "version": "2.1" } ] },
    { "name": "SENS", "address": 13 }
  ],
  "note": [1e2, -0.50, "\u0416"]
}
"#,
    r#"[{"name":"FEED","address":12,"static":true},{"name":"SENS","address":13,"services":{"DES":"1.0"}},{"name":"SENS","address":14}]"#,
    "\u{feff}[\r\n\t{\"name\":\"Насос\",\"name_hex\":\"D09D\" , \"uid\":\"X1\"},\r\n\t{\"own\":{\"a\":[[]]},\"name\":\"B\",\"bus\":\"can0\"}\r\n]\r\n",
    "{\"devices\":null}",
    "{ }",
    "",
    "[ {\"name\":\"A\",\"address\":1,\"address\":2} , 7, {\"address\":3}, {\"name\":\"A\",\"address\":2} ]",
    "{\"a\":1,\"devices\":[\n\n{\"name\":\"\\\"\\\\\",\"static\":false,\"address\":127}\n\n]}",
];

/// Fragments inserted at random.
const PIECES: [&str; 40] = [
    "{",
    "}",
    "[",
    "]",
    ",",
    ":",
    "\"",
    "\\",
    " ",
    "\n",
    "\r\n",
    "\t",
    "\u{feff}",
    "\0",
    "null",
    "true",
    "false",
    "0",
    "1",
    "12",
    "128",
    "-0",
    "1e2",
    "012",
    "1.",
    "\"name\":",
    "\"address\":",
    "\"static\":",
    "\"services\":",
    "\"name_hex\":",
    "\"devices\":",
    "\"bus\":\"can1\"",
    "\"uid\":\"\"",
    "\\ud800",
    "\\u0000",
    "Ж",
    "🔥",
    "{\"name\":\"A\"}",
    "\"version\":",
    "\"extra\":[\"x\"]",
];

#[test]
fn random_files_keep_all_edit_invariants() {
    let number = |name| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let first = number("SEED").unwrap_or(1);
    let end = number("SECONDS").map(|seconds| Instant::now() + Duration::from_secs(seconds));
    let mut tally = Tally::default();
    let mut seed = first;
    loop {
        let result = std::panic::catch_unwind(|| {
            let mut tally = Tally::default();
            Case { rng: Rng::with_seed(seed), tally: &mut tally }.run();
            tally
        });
        match result {
            Ok(one) => tally.add(&one),
            Err(panic) => {
                eprintln!("seed {seed}");
                std::panic::resume_unwind(panic);
            }
        }
        seed += 1;
        let is_over = end.map_or(seed == first + 2000, |end| Instant::now() >= end);
        if is_over {
            break;
        }
    }
    println!("seeds {first} to {}: {tally:?}", seed - 1);
    assert!(tally.edits > 0 && tally.merges > 0 && tally.broken > 0, "{tally:?}");
}

/// Counters of the cases tried.
#[derive(Debug, Default)]
struct Tally {
    files: u64,
    /// Files that are not JSON.
    broken: u64,
    edits: u64,
    /// Edits that were rejected.
    refused: u64,
    merges: u64,
    conflicts: u64,
}

impl Tally {
    fn add(&mut self, other: &Self) {
        self.files += other.files;
        self.broken += other.broken;
        self.edits += other.edits;
        self.refused += other.refused;
        self.merges += other.merges;
        self.conflicts += other.conflicts;
    }
}

struct Case<'t> {
    rng: Rng,
    tally: &'t mut Tally,
}

impl Case<'_> {
    fn run(&mut self) {
        let source = self.file();
        self.tally.files += 1;
        let Some(document) = self.read(&source) else { return };
        let (documents, ours) = self.edited(document, 4);
        let base = documents.into_iter().next().unwrap();
        let theirs = match self.rng.u8(..3) {
            0 => {
                let source = self.file();
                match Document::parse(&source) {
                    Ok(document) => document,
                    Err(_) => return,
                }
            }
            _ => self.edited(base.clone(), 3).0.pop().unwrap(),
        };
        self.merge(&base, &ours, &theirs);
    }

    // ---- files ----

    /// Returns a file after a random mutation.
    fn file(&mut self) -> Vec<u8> {
        let mut bytes = self.rng.choice(FILES).unwrap().as_bytes().to_vec();
        for _ in 0..self.rng.u32(..6) {
            let at = self.rng.usize(..=bytes.len());
            let end = bytes.len().min(at + self.rng.usize(..12));
            match self.rng.u8(..7) {
                0 if at < bytes.len() => bytes[at] = self.rng.u8(..),
                1 => drop(bytes.drain(at..end)),
                2 => {
                    let piece = bytes[at..end].to_vec();
                    let to = self.rng.usize(..=bytes.len());
                    bytes.splice(to..to, piece);
                }
                3 => {
                    let other = self.rng.choice(FILES).unwrap().as_bytes();
                    let start = self.rng.usize(..=other.len());
                    let end = other.len().min(start + self.rng.usize(..60));
                    bytes.splice(at..at, other[start..end].iter().copied());
                }
                4 => {
                    // One more element, in the list or in a list within it.
                    let opening = bytes.iter().position(|byte| *byte == b'[');
                    let piece = self.rng.choice(FILES).unwrap().trim_start_matches('\u{feff}');
                    if let (Some(opening), false) = (opening, piece.is_empty()) {
                        let piece = format!("{piece},");
                        bytes.splice(opening + 1..=opening, piece.bytes());
                    }
                }
                _ => {
                    let piece = self.rng.choice(PIECES).unwrap().bytes();
                    bytes.splice(at..at, piece);
                }
            }
        }
        bytes
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
        let rng = &mut self.rng;
        let mut name = || -> Vec<u8> {
            let names: [&[u8]; 7] =
                [b"FEED", b"A", b"\"\\", b"\xff\x1b", "Ж".as_bytes(), b"", b"\0"];
            rng.choice(names).unwrap().to_vec()
        };
        let (to, new_name) = (name(), name());
        let service = |rng: &mut Rng| ListedService {
            name: rng.choice(["DES", "AUGER", "\u{1b}"]).unwrap().to_owned(),
            version: rng.choice(["", "1.0", "\"2\""]).unwrap().to_owned(),
            extra: vec!["x".to_owned(); usize::from(rng.u8(..6) == 0)],
        };
        let services: Vec<ListedService> =
            (0..self.rng.u8(..4)).map(|_| service(&mut self.rng)).collect();
        let count = document.entries().len();
        if count == 0 || self.rng.u8(..5) == 0 {
            let address = self.rng.bool().then(|| self.rng.u8(1..=127));
            let is_static = address.is_some() && self.rng.bool();
            let bus = (self.rng.u8(..5) == 0).then(|| "can0".to_owned());
            let uid = (self.rng.u8(..5) == 0).then(|| "X1".to_owned());
            let entry = NewEntry { name: new_name, address, is_static, bus, uid, services };
            return Operation::Add { entry };
        }
        let entry = document.key(self.rng.usize(..count));
        let from = entry.address;
        match self.rng.u8(..6) {
            0 => Operation::UnpinAddress { entry, from },
            1 => Operation::Rename { entry, to },
            2 => Operation::SetServices { entry, services },
            3 => Operation::Remove { entry },
            _ => Operation::PinAddress { entry, from, to: self.rng.u8(1..=127) },
        }
    }

    /// Applies edits in sequence; returns all documents, the first one included, and the edits.
    fn edited(&mut self, first: Document, most: u8) -> (Vec<Document>, Vec<Operation>) {
        let mut documents = vec![first];
        let mut operations = Vec::new();
        for _ in 0..self.rng.u8(..=most) {
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
