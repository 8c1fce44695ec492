//! Random documents and random edits: untouched text stays unchanged to the byte, the intended
//! values are written, undo works, and both sides of a merge are kept.

use descan::document::{
    Document, DocumentFindingKind, Entry, EntryKey, ListedService, Merge, MergePreference,
    NewEntry, Operation, merge,
};
use proptest::collection::vec;
use proptest::option::of as maybe;
use proptest::prelude::*;
use proptest::sample::{Index, select};

/// The text of a file, in pieces that tests can reassemble.
#[derive(Clone, Debug)]
struct Source {
    head: String,
    entries: Vec<EntrySource>,
    tail: String,
}

#[derive(Clone, Debug)]
struct EntrySource {
    /// The comma and blanks before the entry.
    lead: String,
    members: Vec<MemberSource>,
    /// Blanks before the closing brace.
    tail: String,
}

#[derive(Clone, Debug)]
struct MemberSource {
    /// The comma and blanks before the key.
    lead: String,
    key: &'static str,
    /// The key as written, and the colon.
    spelling: String,
    value: String,
}

impl Source {
    fn text(&self) -> String {
        let entries: String =
            self.entries.iter().map(|entry| entry.lead.clone() + &entry.text()).collect();
        format!("{}{entries}{}", self.head, self.tail)
    }

    fn parse(&self) -> Document {
        Document::parse(self.text().as_bytes()).unwrap()
    }
}

impl EntrySource {
    fn text(&self) -> String {
        let pieces = |it: &MemberSource| [&*it.lead, &it.spelling, &it.value].concat();
        let members: String = self.members.iter().map(pieces).collect();
        format!("{{{members}{}}}", self.tail)
    }

    fn member(&mut self, key: &str) -> Option<&mut MemberSource> {
        self.members.iter_mut().find(|member| member.key == key)
    }
}

fn blank() -> impl Strategy<Value = String> {
    select(vec!["", "", " ", "  ", "\t", "\n", "\n    ", "\r\n\t", "\r\n\r\n  "])
        .prop_map(str::to_owned)
}

fn comma() -> impl Strategy<Value = String> {
    (blank(), blank()).prop_map(|(before, after)| before + "," + &after)
}

fn string() -> impl Strategy<Value = String> {
    let piece = select(vec![
        "",
        "A",
        "Насос",
        "\\\"",
        "\\\\",
        "{",
        "]",
        ",",
        "\\u0041",
        "\\ud83d\\ude00",
        "\\/",
        "🔥",
        ":",
    ]);
    vec(piece, 0..4).prop_map(|pieces| format!("\"{}\"", pieces.concat()))
}

/// A value unknown to descan.
fn anything() -> impl Strategy<Value = String> {
    let scalar = prop_oneof![
        string(),
        select(vec!["null", "true", "-0", "1e400", "1.50E+02", "123456789012345678901234567890"])
            .prop_map(str::to_owned),
    ];
    scalar.prop_recursive(3, 12, 3, |inner| {
        let items = vec((comma(), inner.clone()), 0..3);
        let members = vec((comma(), string(), inner), 0..3);
        prop_oneof![
            items.prop_map(|items| {
                let items: String = items.into_iter().map(|(comma, it)| comma + &it).collect();
                format!("[{}]", items.replacen(',', "", 1))
            }),
            members.prop_map(|members| {
                let pieces =
                    |(comma, key, it): (String, String, String)| comma + &key + " : " + &it;
                let members: String = members.into_iter().map(pieces).collect();
                format!("{{{}}}", members.replacen(',', "", 1))
            }),
        ]
    })
}

fn services() -> impl Strategy<Value = Vec<ListedService>> {
    let name = select(vec!["DES", "AUGER", "T\"", "Ж", ""]);
    let version = select(vec!["1.0", "2.1", ""]);
    let extra = vec(select(vec!["x".to_owned(), "\u{1b}".to_owned()]), 0..2);
    let service = (name, version, extra).prop_map(|(name, version, extra)| ListedService {
        name: name.to_owned(),
        version: version.to_owned(),
        extra,
    });
    vec(service, 0..4)
}

/// Services in the file, in one of the allowed forms.
fn services_text() -> impl Strategy<Value = String> {
    let list = (services(), blank(), comma(), blank()).prop_map(|(services, open, comma, close)| {
        let items: Vec<String> = services
            .iter()
            .map(|it| {
                let [name, version, extra] = [
                    serde_json::to_string(&it.name).unwrap(),
                    serde_json::to_string(&it.version).unwrap(),
                    serde_json::to_string(&it.extra).unwrap(),
                ];
                format!("{{\"version\" :{version}, \"own\": [1e1],\"extra\":{extra} , \"name\":{name}}}")
            })
            .collect();
        format!("[{open}{}{close}]", items.join(&comma))
    });
    let object = (blank(), comma(), 0..4_usize).prop_map(|(open, comma, count)| {
        let items = ["\"DES\":\"1.0\"", "\"B\" : \"2\"", "\"\\u0043\":null"];
        format!("{{{open}{}}}", items[..count.min(3)].join(&comma))
    });
    prop_oneof![list, object, Just("7".to_owned()), Just("null".to_owned())]
}

/// An entry whose name is made unique by its number.
fn entry(number: usize) -> impl Strategy<Value = EntrySource> {
    let address = select(vec!["1", "12", "127", "0", "128", "1e1", "12.0", "-1", "null", "\"12\""]);
    let is_static = select(vec!["true", "false", "null", "1"]);
    (
        string(),
        maybe(address),
        maybe(is_static),
        maybe(services_text()),
        maybe(select(vec!["\"can0\"", "\"can1\"", "null"])),
        vec(anything(), 0..3),
        any::<u64>(),
        vec((comma(), blank(), blank()), 10),
        (comma(), blank()),
    )
        .prop_map(
            move |(name, address, is_static, services, bus, own, order, blanks, around)| {
                let name = format!("\"{number}{}", &name[1..]);
                let own = own.into_iter().zip(["own", "addr", "\\\"static\\\""]);
                let mut members: Vec<(&str, String)> = vec![("name", name)];
                members.extend(address.map(|it| ("address", it.to_owned())));
                members.extend(is_static.map(|it| ("static", it.to_owned())));
                members.extend(services.map(|it| ("services", it)));
                members.extend(bus.map(|it| ("bus", it.to_owned())));
                members.extend(own.map(|(value, key)| (key, value)));
                fastrand::Rng::with_seed(order).shuffle(&mut members);
                let members = members.into_iter().zip(blanks).enumerate();
                EntrySource {
                    lead: around.0,
                    members: members
                        .map(|(index, ((key, value), (comma, before, after)))| MemberSource {
                            lead: if index == 0 { comma.replace(',', "") } else { comma },
                            key,
                            spelling: match (key, order % 3) {
                                ("address", 0) => format!("\"\\u0061ddress\"{before}:{after}"),
                                _ => format!("\"{key}\"{before}:{after}"),
                            },
                            value,
                        })
                        .collect(),
                    tail: around.1,
                }
            },
        )
}

fn source(entries: std::ops::Range<usize>) -> impl Strategy<Value = Source> {
    let entries = entries.prop_flat_map(|count| (0..count).map(entry).collect::<Vec<_>>());
    let blanks = [blank(), blank(), blank(), blank(), blank()];
    (entries, any::<bool>(), any::<bool>(), anything(), blanks).prop_map(
        |(mut entries, is_object, has_bom, own, [a, b, c, d, e])| {
            if let Some(first) = entries.first_mut() {
                first.lead = first.lead.replace(',', "");
            }
            let bom = if has_bom { "\u{feff}" } else { "" };
            let (head, tail) = if is_object {
                (
                    format!("{bom}{a}{{{b}\"own\":{own},\"devices\"{c}:{d}["),
                    format!("{e}]{b},\"more\":1e3{c}}}{d}"),
                )
            } else {
                (format!("{bom}{a}["), format!("{e}]{b}"))
            };
            Source { head, entries, tail }
        },
    )
}

/// An edit of an entry.
#[derive(Clone, Debug)]
enum Edit {
    Set(u8),
    Clear,
    Rename(Vec<u8>),
    Services(Vec<ListedService>),
    Remove,
    Add(NewEntry),
}

fn edit() -> impl Strategy<Value = Edit> {
    let name = || vec(select(vec![b'A', b'"', b'\\', 0x1b, 0xff, 0xd0, b' ']), 1..6);
    let new = (name(), maybe(1..=127_u8), any::<bool>(), services()).prop_map(
        |(name, address, is_static, services)| NewEntry {
            name,
            address,
            is_static,
            services,
            ..NewEntry::default()
        },
    );
    prop_oneof![
        (1..=127_u8).prop_map(Edit::Set),
        Just(Edit::Clear),
        name().prop_map(Edit::Rename),
        services().prop_map(Edit::Services),
        Just(Edit::Remove),
        new.prop_map(Edit::Add),
    ]
}

impl Edit {
    fn operation(&self, document: &Document, index: usize) -> Operation {
        let entry = document.key(index);
        let from = entry.address;
        match self.clone() {
            Self::Set(to) => Operation::PinAddress { entry, from, to },
            Self::Clear => Operation::UnpinAddress { entry, from },
            Self::Rename(to) => Operation::Rename { entry, to },
            Self::Services(services) => Operation::SetServices { entry, services },
            Self::Remove => Operation::Remove { entry },
            Self::Add(entry) => Operation::Add { entry },
        }
    }

    /// Returns the edit with a name unused by the other side: one name is one value, not two.
    fn named(mut self, side: u8) -> Self {
        if let Self::Rename(name) | Self::Add(NewEntry { name, .. }) = &mut self {
            name.insert(0, side);
        }
        self
    }

    /// Returns the expected values of the entries, computed by the test.
    fn meant(&self, before: &[Meaning], index: usize) -> Vec<Meaning> {
        let mut meant = before.to_vec();
        match self.clone() {
            Self::Set(to) => (meant[index].1, meant[index].2) = (Some(to), true),
            Self::Clear => meant[index].2 = false,
            Self::Rename(to) => meant[index].0 = to,
            Self::Services(services) => meant[index].4 = Some(services),
            Self::Remove => drop(meant.remove(index)),
            Self::Add(it) => {
                let services = (!it.services.is_empty()).then_some(it.services);
                meant.push((it.name, it.address, it.is_static, it.bus, services));
            }
        }
        meant
    }

    /// Returns the members that may change or be added.
    fn keys(&self) -> &'static [&'static str] {
        match self {
            Self::Set(_) => &["address", "static"],
            Self::Clear => &["static"],
            Self::Rename(_) => &["name", "name_hex"],
            Self::Services(_) => &["services"],
            Self::Remove | Self::Add(_) => &[],
        }
    }
}

type Meaning = (Vec<u8>, Option<u8>, bool, Option<String>, Option<Vec<ListedService>>);

fn meaning(document: &Document) -> Vec<Meaning> {
    let of = |it: &Entry| {
        (it.name.clone(), it.address, it.is_static, it.bus.clone(), it.services.clone())
    };
    document.entries().iter().map(of).collect()
}

fn text(document: &Document) -> &str {
    str::from_utf8(document.source()).unwrap()
}

/// Returns true if the text consists of all these pieces in this order, with or without text in
/// between.
fn has_in_order<'p>(mut text: &str, pieces: impl Iterator<Item = &'p str>) -> bool {
    for piece in pieces {
        match text.find(piece) {
            Some(at) => text = &text[at + piece.len()..],
            None => return false,
        }
    }
    true
}

/// Returns true if a document equals one parsed again from its bytes.
fn is_as_read(document: &Document) -> bool {
    let read = Document::parse(document.source()).unwrap();
    let keys = |document: &Document| -> Vec<EntryKey> {
        (0..document.entries().len()).map(|index| document.key(index)).collect()
    };
    read.entries() == document.entries()
        && read.findings() == document.findings()
        && keys(&read) == keys(document)
}

/// Returns true if an edit may be rejected: duplicate services in an object are read only.
fn may_be_refused(document: &Document) -> bool {
    document.findings().iter().any(|finding| finding.kind == DocumentFindingKind::DuplicateMember)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn edit_keeps_all_other_bytes(source in source(1..5), edit in edit(), index in any::<Index>()) {
        let index = index.index(source.entries.len());
        let before = source.parse();
        prop_assert_eq!(before.entries().len(), source.entries.len());
        prop_assume!(!may_be_refused(&before));
        let after = before.apply(&edit.operation(&before, index)).unwrap();
        prop_assert_eq!(meaning(&after), edit.meant(&meaning(&before), index));
        prop_assert!(is_as_read(&after));

        let mut expected = source.clone();
        match &edit {
            Edit::Add(_) => {
                let whole = source.text();
                let end = whole.len() - source.tail.len();
                prop_assert!(text(&after).starts_with(&whole[..end]));
                prop_assert!(text(&after).ends_with(&source.tail));
            }
            Edit::Remove => {
                let removed = expected.entries.remove(index);
                if let (0, Some(first)) = (index, expected.entries.first_mut()) {
                    first.lead = removed.lead;
                }
                if expected.entries.is_empty() {
                    let blanks = expected.tail.find(']').unwrap();
                    expected.tail.replace_range(..blanks, "");
                }
                prop_assert_eq!(text(&after), expected.text());
            }
            Edit::Set(_) | Edit::Clear | Edit::Rename(_) | Edit::Services(_) => {
                let whole = source.text();
                let earlier: usize = source.head.len()
                    + source.entries[..index].iter().map(|it| it.lead.len() + it.text().len()).sum::<usize>()
                    + source.entries[index].lead.len();
                let later = whole.len() - earlier - source.entries[index].text().len();
                prop_assert_eq!(&text(&after)[..earlier], &whole[..earlier]);
                prop_assert_eq!(&text(&after)[text(&after).len() - later..], &whole[whole.len() - later..]);
                let changed = &text(&after)[earlier..text(&after).len() - later];
                let kept: Vec<String> = source.entries[index]
                    .members
                    .iter()
                    .map(|it| {
                        let may_change = edit.keys().contains(&it.key);
                        it.spelling.clone() + if may_change { "" } else { &it.value }
                    })
                    .collect();
                prop_assert!(has_in_order(changed, kept.iter().map(String::as_str)), "{changed}");
            }
        }
        // To the byte, if both members existed.
        if let Edit::Set(to) = edit {
            let entry = &mut expected.entries[index];
            if entry.member("address").is_some() && entry.member("static").is_some() {
                entry.member("address").unwrap().value = to.to_string();
                entry.member("static").unwrap().value = "true".to_owned();
                prop_assert_eq!(text(&after), expected.text());
            }
        }
    }

    #[test]
    fn undo_restores_every_byte(source in source(0..4), edits in vec((edit(), any::<Index>()), 1..5)) {
        let first = source.parse();
        prop_assume!(!may_be_refused(&first));
        let mut documents = vec![first];
        let mut inverses = Vec::new();
        for (edit, index) in edits {
            let before = documents.last().unwrap();
            let operation = match (edit, before.entries().len()) {
                (Edit::Add(entry), 0) => Operation::Add { entry },
                (_, 0) => continue,
                (edit, count) => edit.operation(before, index.index(count)),
            };
            inverses.push(operation.inverse(before).unwrap());
            let after = before.apply(&operation).unwrap();
            prop_assert!(is_as_read(&after));
            documents.push(after);
        }
        let mut document = documents.pop().unwrap();
        while let (Some(inverse), Some(before)) = (inverses.pop(), documents.pop()) {
            let redo = inverse.inverse(&document).unwrap();
            let undone = document.apply(&inverse).unwrap();
            prop_assert_eq!(text(&undone), text(&before));
            prop_assert!(is_as_read(&undone));
            prop_assert_eq!(meaning(&undone.apply(&redo).unwrap()), meaning(&document));
            document = before;
        }
    }

    #[test]
    fn merge_of_random_edits_keeps_both_sides(
        source in source(2..5), ours in edit(), theirs in edit(), index in any::<Index>(), by in any::<Index>(),
    ) {
        let count = source.entries.len();
        let index = index.index(count);
        let other = (index + 1 + by.index(count - 1)) % count;
        let base = source.parse();
        prop_assume!(!may_be_refused(&base));
        let our_operation = ours.named(b'o').operation(&base, index);
        let their_operation = theirs.named(b't').operation(&base, other);
        let disk = base.apply(&their_operation).unwrap();
        let mine = base.apply(&our_operation).unwrap();
        let merged = merge(&base, std::slice::from_ref(&our_operation), &disk, MergePreference::Neither).unwrap();
        let Merge::Rebased { document, .. } = merged else { panic!("{merged:?}") };
        let mut found = meaning(&document);
        let mut expected = meaning(&mine.apply(&their_operation).unwrap());
        found.sort_by(|a, b| format!("{a:?}").cmp(&format!("{b:?}")));
        expected.sort_by(|a, b| format!("{a:?}").cmp(&format!("{b:?}")));
        prop_assert_eq!(found, expected);
    }

    #[test]
    fn arbitrary_bytes_do_not_panic(source in source(0..3), cuts in vec((any::<Index>(), any::<u8>()), 0..4)) {
        let mut bytes = source.text().into_bytes();
        for (at, byte) in cuts {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        match Document::parse(&bytes) {
            Ok(document) => prop_assert_eq!(document.source(), bytes),
            Err(error) => {
                prop_assert!(error.line >= 1 && error.column >= 1);
                prop_assert!(!error.line_text.chars().any(char::is_control));
                prop_assert!(error.caret <= error.line_text.chars().count());
                prop_assert!(error.line_text.len() < 1000);
            }
        }
    }
}
