//! `des.json`: accepted content, rejected content, and the bytes that an edit changes.

use descan::document::{
    ConflictChoices, Document, DocumentFindingKind, EditError, EntryKey, ListedService, MAX_BYTES,
    Merge, MergePreference, NewEntry, Operation, SCHEMA, merge, merge_with_choices,
};
use descan::finding::FindingKind;

fn parsed(source: &str) -> Document {
    Document::parse(source.as_bytes()).unwrap_or_else(|error| panic!("{error}\n{source}"))
}

fn text(document: &Document) -> &str {
    str::from_utf8(document.source()).unwrap()
}

/// Returns the key of the first entry of this name.
fn key(document: &Document, name: &str) -> EntryKey {
    let found = document.entries().iter().find(|entry| entry.name == name.as_bytes());
    document.key(found.unwrap_or_else(|| panic!("no {name}")).index)
}

fn set(document: &Document, name: &str, to: u8) -> Operation {
    let entry = key(document, name);
    Operation::PinAddress { from: entry.address, entry, to }
}

fn clear(document: &Document, name: &str) -> Operation {
    let entry = key(document, name);
    Operation::UnpinAddress { from: entry.address, entry }
}

fn remove(document: &Document, name: &str) -> Operation {
    Operation::Remove { entry: key(document, name) }
}

fn rename(document: &Document, name: &str, to: &[u8]) -> Operation {
    Operation::Rename { entry: key(document, name), to: to.to_vec() }
}

fn services(document: &Document, name: &str, services: &[(&str, &str)]) -> Operation {
    Operation::SetServices { entry: key(document, name), services: listed(services) }
}

fn listed(services: &[(&str, &str)]) -> Vec<ListedService> {
    let service = |&(name, version): &(&str, &str)| ListedService {
        name: name.to_owned(),
        version: version.to_owned(),
        extra: Vec::new(),
    };
    services.iter().map(service).collect()
}

fn device(name: &str, address: u8) -> NewEntry {
    let name = name.as_bytes().to_vec();
    NewEntry { name, address: Some(address), is_static: true, ..NewEntry::default() }
}

fn add(name: &str, address: u8) -> Operation {
    Operation::Add { entry: device(name, address) }
}

/// Applies the edit, expects exactly these bytes, and undoes it.
fn edits(before: &str, operation: impl Fn(&Document) -> Operation, after: &str) -> Document {
    let document = parsed(before);
    let operation = operation(&document);
    let edited = document.apply(&operation).unwrap_or_else(|error| panic!("{operation}: {error}"));
    assert_eq!(text(&edited), after, "{operation}");
    let inverse = operation.inverse(&document).unwrap();
    let undone = edited.apply(&inverse).unwrap_or_else(|error| panic!("{inverse}: {error}"));
    says_the_same(&undone, &document);
    let redone = undone.apply(&inverse.inverse(&edited).unwrap()).unwrap();
    says_the_same(&redone, &edited);
    undone
}

/// Like `edits`, and expects that the undo restores every byte.
fn edits_and_back(before: &str, operation: impl Fn(&Document) -> Operation, after: &str) {
    let undone = edits(before, operation, after);
    assert_eq!(text(&undone), before);
}

fn says_the_same(a: &Document, b: &Document) {
    assert_eq!(meaning(a), meaning(b));
}

/// Returns all values of a document, without positions.
fn meaning(document: &Document) -> Vec<impl PartialEq + std::fmt::Debug + use<>> {
    let entries = document.entries().iter().cloned();
    entries.map(|it| (it.name, it.address, it.is_static, it.bus, it.uid, it.services)).collect()
}

fn findings(source: &str) -> Vec<(DocumentFindingKind, String, Vec<usize>)> {
    let document = parsed(source);
    let findings = document.findings().iter();
    findings.map(|it| (it.kind, it.to_string(), it.entries.clone())).collect()
}

// ---- reading ----

#[test]
fn every_entry_member_is_read() {
    let document = parsed(
        r#"{"devices": [ { "name": "FEED", "address": 12, "static": true, "bus": "can0",
           "uid": "BOILER01", "services": [ { "name": "DES", "version": "1.0" },
           { "version": "2.1", "name": "AUGER", "extra": ["a", "b"], "note": 1 }, {"name":"X"} ] },
           {"n\u0061me": "\u041d\ud83d\udd25", "address": null, "static": null, "services": {"DES": "1.0", "B": null}} ] }"#,
    );
    assert_eq!(document.findings(), []);
    let [feed, fire] = document.entries() else { panic!("{document:?}") };
    assert_eq!(feed.name, b"FEED");
    assert_eq!(feed.address, Some(12));
    assert!(feed.is_static);
    assert_eq!(feed.bus.as_deref(), Some("can0"));
    assert_eq!(feed.uid.as_deref(), Some("BOILER01"));
    let mut expected = listed(&[("DES", "1.0"), ("AUGER", "2.1"), ("X", "")]);
    expected[1].extra = vec!["a".into(), "b".into()];
    assert_eq!(feed.services.as_ref(), Some(&expected));
    assert_eq!(feed.position.to_string(), "line 1, column 15");
    assert_eq!(feed.address_position.unwrap().to_string(), "line 1, column 44");
    assert_eq!((feed.index, fire.index), (0, 1));

    assert_eq!(fire.name_text, "Н🔥");
    assert_eq!((fire.address, fire.is_static), (None, false));
    assert_eq!(fire.services.as_ref(), Some(&listed(&[("DES", "1.0"), ("B", "")])));
    assert_eq!(fire.position.to_string(), "line 4, column 12");
}

#[test]
fn name_hex_holds_the_exact_bytes() {
    let document = parsed(
        r#"[{"name": "A\\xFFB", "name_hex": "41fF42"}, {"name": "ok", "name_hex": "6F6B"}]"#,
    );
    assert_eq!(document.findings(), []);
    assert_eq!(document.entries()[0].name, b"A\xffB");
    assert_eq!(document.entries()[0].name_text, "A\\xFFB");
    assert_eq!(document.entries()[1].name, b"ok");
}

#[test]
fn missing_content_is_an_empty_document() {
    for source in ["", " \r\n\t", "\u{feff}", "{}", "[]", "{\"devices\":[]}", "{\"devices\":null}"]
    {
        let document = parsed(source);
        assert_eq!(document.entries(), [], "{source:?}");
        assert_eq!(document.findings(), [], "{source:?}");
    }
    assert_eq!(parsed(""), Document::empty());
}

#[test]
fn invalid_json_is_rejected_with_its_position() {
    let deep = "[".repeat(200) + &"]".repeat(200);
    for (source, message, line_text, caret) in [
        (
            &b"{\n  \"devices\": [\n    { \"name\": \"A\" \"address\": 1 }\n  ]\n}"[..],
            "line 3, column 19: expected `,` or `}`",
            "    { \"name\": \"A\" \"address\": 1 }",
            18,
        ),
        (b"[1 , ]", "line 1, column 6: trailing comma", "[1 , ]", 5),
        (
            b"[tru]",
            "line 1, column 5: not a value: true, false and null are the only words",
            "[tru]",
            4,
        ),
        (b"{\"a\":1,}", "line 1, column 8: trailing comma", "{\"a\":1,}", 7),
        (b"[1", "line 1, column 3: the file ends inside a list", "[1", 2),
        (b"{\"a\n\n", "line 1, column 4: unterminated string", "{\"a", 3),
        (
            b"\xef\xbb\xbf[\n\"\xd0\x96\xd0\x96\" x]",
            "line 2, column 6: expected `,` or `]`",
            "\"ЖЖ\" x]",
            5,
        ),
        (b"[]\n[]", "line 2, column 1: text after the end", "[]", 0),
        (b"[\"a\xffb\"]", "line 1, column 4: 0xFF is not UTF-8: save it as UTF-8", "[\"a", 3),
        (b"\xff\xfe[\0]\0", "line 1, column 1: the file is UTF-16: save it as UTF-8", "", 0),
        (b"{// who\n}", "line 1, column 2: JSON has no comments", "{// who", 1),
        (b"[1, /* two */ 2]", "line 1, column 5: JSON has no comments", "[1, /* two */ 2]", 4),
        (b"[1 # one\n]", "line 1, column 4: JSON has no comments", "[1 # one", 3),
        (b"[]\n// end", "line 2, column 1: JSON has no comments", "// end", 0),
        (b"# des\n[]", "line 1, column 1: JSON has no comments", "# des", 0),
        (b"[1 / 2]", "line 1, column 4: expected `,` or `]`", "[1 / 2]", 3),
        (b"{'a': 1}", "line 1, column 2: JSON has double quotes only", "{'a': 1}", 1),
        (b"{\"a\": 'b'}", "line 1, column 7: JSON has double quotes only", "{\"a\": 'b'}", 6),
        (b"{a: 1}", "line 1, column 2: key must be a string", "{a: 1}", 1),
        (b"// no\n[]", "line 1, column 1: JSON has no comments", "// no", 0),
        (
            b"[\t\"\x1b[2J\"]",
            "line 1, column 4: a control character: in a string it is written \\u001B",
            "[ \"\\x1B[2J\"]",
            3,
        ),
        (
            deep.as_bytes(),
            "line 1, column 129: nested deeper than 128 levels",
            &format!("…{}…", "[".repeat(72)),
            37,
        ),
    ] {
        let error = Document::parse(source).unwrap_err();
        assert_eq!(error.to_string(), message);
        assert_eq!((error.line_text.as_str(), error.caret), (line_text, caret), "{message}");
    }
}

#[test]
fn error_caret_points_at_the_position() {
    for (source, line, caret) in [
        ("[1 , ]", "[1 , ]", "     ^"),
        ("[\"Ж漢\" x", "[\"Ж漢\" x", "       ^"),
        ("[\n\t1 2]", " 1 2]", "   ^"),
    ] {
        let error = Document::parse(source.as_bytes()).unwrap_err();
        assert_eq!(error.excerpt(), Some([line.to_owned(), caret.to_owned()]));
    }
    let long = format!("[\"{}\" x \"{}\"]", "a".repeat(1000), "b".repeat(1000));
    let [line, caret] = Document::parse(long.as_bytes()).unwrap_err().excerpt().unwrap();
    assert_eq!((line.chars().count(), caret.len()), (74, 38));
    assert!(line.starts_with("…aa") && line.ends_with("bb…"), "{line}");
    assert_eq!(line.chars().skip(35).take(5).collect::<String>(), "\" x \"");
    // This content cannot be displayed.
    assert_eq!(Document::parse(b"\xff\xfe[\0").unwrap_err().excerpt(), None);
}

#[test]
fn finding_list_keeps_the_first_entries() {
    let bad = |count: usize| format!("[{}{{\"name\":\"A\"}}]", "1,".repeat(count));
    assert_eq!(parsed(&bad(1000)).findings().len(), 1000);
    let document = parsed(&bad(15_000));
    assert_eq!(document.findings().len(), 1001);
    let last = document.findings().last().unwrap();
    assert_eq!(last.message, "14000 more errors after this one");
    assert_eq!(last.position.column, 2000);
    // It can be edited like any other.
    let edited = document.apply(&set(&document, "A", 5)).unwrap();
    assert_eq!(
        text(&edited).len(),
        30_002 + "{\"name\":\"A\",\"address\":5,\"static\":true}".len()
    );
    assert_eq!(edited.findings(), document.findings());
}

#[test]
fn deep_nesting_does_not_overflow_the_stack() {
    let deep = "[".repeat(1_000_000);
    assert!(Document::parse(deep.as_bytes()).is_err());
    let allowed = "[".repeat(128) + &"]".repeat(128);
    assert!(Document::parse(allowed.as_bytes()).is_ok());
}

#[test]
fn wrong_member_types_are_findings() {
    use DocumentFindingKind::{
        AddressRange, DuplicateMember, MissingName, MisspelledMember, NamesDiffer, NotAnEntry,
        NotDevices, StaticWithoutAddress, WrongType,
    };
    for (source, kind, message, entries) in [
        (
            "12",
            NotDevices,
            "line 1, column 1: the file is a number, not an object with `devices`",
            vec![],
        ),
        (
            r#" {"foo": 1}"#,
            NotDevices,
            "line 1, column 2: the object has no `devices`; it must have a list of them",
            vec![],
        ),
        (
            r#"{"devices": {}}"#,
            NotDevices,
            "line 1, column 13: `devices` is an object; it must be a list",
            vec![],
        ),
        (
            r#"{"devices": [], "devices": []}"#,
            DuplicateMember,
            "line 1, column 17: duplicate `devices`; the last one is used",
            vec![],
        ),
        ("[\n 7]", NotAnEntry, "line 2, column 2: element 1 is a number, not a device", vec![]),
        ("[{}]", MissingName, "line 1, column 2: device 1 has no `name`", vec![]),
        (
            r#"[{"name_hex": "41"}]"#,
            MissingName,
            "line 1, column 2: device 1 has no `name`",
            vec![0],
        ),
        (
            r#"[{"name": "A", "name_hex": "42"}]"#,
            NamesDiffer,
            "line 1, column 28: `name_hex` is B, but `name` is A; `name_hex` is used",
            vec![0],
        ),
        (
            r#"[{"name": "A", "name_hex": "4"}]"#,
            WrongType,
            "line 1, column 28: `name_hex` is not hexadecimal; it must be the name's bytes in hexadecimal, as \"46454544\"",
            vec![0],
        ),
        (
            r#"[{"name": "A", "address": 0}]"#,
            AddressRange,
            "line 1, column 27: `address` is 0; it must be a whole number from 1 to 127",
            vec![0],
        ),
        (
            r#"[{"name": "A", "address": 128}]"#,
            AddressRange,
            "line 1, column 27: `address` is 128; it must be a whole number from 1 to 127",
            vec![0],
        ),
        (
            r#"[{"name": "A", "address": 1e2}]"#,
            AddressRange,
            "line 1, column 27: `address` is 1e2; write it in plain digits: 100",
            vec![0],
        ),
        (
            r#"[{"name": "A", "address": 12.0}]"#,
            AddressRange,
            "line 1, column 27: `address` is 12.0; write it in plain digits: 12",
            vec![0],
        ),
        (
            r#"[{"name": "A", "address": 12.5}]"#,
            AddressRange,
            "line 1, column 27: `address` is 12.5; it must be a whole number from 1 to 127",
            vec![0],
        ),
        (
            r#"[{"name": "A", "address": 1e3}]"#,
            AddressRange,
            "line 1, column 27: `address` is 1e3; it must be a whole number from 1 to 127",
            vec![0],
        ),
        (
            r#"[{"name": "A", "address": -1}]"#,
            AddressRange,
            "line 1, column 27: `address` is -1; it must be a whole number from 1 to 127",
            vec![0],
        ),
        (
            r#"[{"name": "A", "address": "12"}]"#,
            WrongType,
            "line 1, column 27: `address` is a string; it must be a whole number from 1 to 127",
            vec![0],
        ),
        (
            r#"[{"name": "A", "static": 1}]"#,
            WrongType,
            "line 1, column 26: `static` is a number; it must be true or false",
            vec![0],
        ),
        (
            r#"[{"name": "A", "bus": []}]"#,
            WrongType,
            "line 1, column 23: `bus` is a list; it must be a string",
            vec![0],
        ),
        (
            r#"[{"name": "A", "uid": "\ud800"}]"#,
            WrongType,
            "line 1, column 23: `uid` is not valid Unicode",
            vec![0],
        ),
        (
            r#"[{"name": "A", "services": "DES"}]"#,
            WrongType,
            "line 1, column 28: `services` is a string; it must be a list, or an object of names and versions",
            vec![0],
        ),
        (
            r#"[{"name": "A", "services": ["DES"]}]"#,
            WrongType,
            "line 1, column 29: `services` item 1 is a string; it must be an object of `name`, `version` and `extra`, all strings",
            vec![0],
        ),
        (
            r#"[{"name": "A", "services": [{"name": "DES", "version": 1.0}]}]"#,
            WrongType,
            "line 1, column 56: `version` in `services` item 1 is a number; it must be a string",
            vec![0],
        ),
        (
            r#"[{"name": "A", "services": {"DES": 1.0}}]"#,
            WrongType,
            "line 1, column 36: `services` item 1 is a number; it must be a version, as a string",
            vec![0],
        ),
        (
            r#"[{"name": "A", "services": {"DES": "1", "B": "1", "D\u0045S": "2"}}]"#,
            DuplicateMember,
            "line 1, column 51: duplicate `DES`; the last one is used",
            vec![0],
        ),
        (
            r#"[{"name": "A", "services": [{"name": "B"}, {"name": "C", "name": "D"}]}]"#,
            DuplicateMember,
            "line 1, column 58: duplicate `name`; the last one is used",
            vec![0],
        ),
        (
            r#"[{"name": "A", "address": 1, "address": 2}]"#,
            DuplicateMember,
            "line 1, column 30: duplicate `address`; the last one is used",
            vec![0],
        ),
        (
            r#"{"Devices": []}"#,
            MisspelledMember,
            "line 1, column 2: `Devices` is not read; is `devices` meant?",
            vec![],
        ),
        (
            r#"[{"name": "A", "adress": 1, "n\u0061mes": "B", "bsu": "can0", "address_old": 2}]"#,
            MisspelledMember,
            "line 1, column 16: `adress` is not read; is `address` meant?",
            vec![0],
        ),
        (
            r#"[{"name": "A", "services": [{"name": "B", "verison": "1.0"}]}]"#,
            MisspelledMember,
            "line 1, column 43: `verison` is not read; is `version` meant?",
            vec![0],
        ),
        (
            r#"[{"name": "A", "address": null, "static": true}]"#,
            StaticWithoutAddress,
            "line 1, column 43: `static` without an `address`; nothing is pinned",
            vec![0],
        ),
    ] {
        assert_eq!(findings(source), [(kind, message.to_owned(), entries)]);
        assert_eq!(FindingKind::from(kind), FindingKind::FileShape);
    }
    // The last member counts.
    let twice = parsed(r#"[{"name":"A","services":{"B":"1","C":"1","B":"2"}}]"#);
    assert_eq!(twice.entries()[0].services, Some(listed(&[("B", "2"), ("C", "1")])));
    // A name that is not a string yields two findings and no entry.
    assert_eq!(findings(r#"[{"name": 7, "address": 300}]"#).len(), 2);
    assert_eq!(parsed(r#"[1, {"name": 7}, {"name": "A"}]"#).entries().len(), 1);
}

#[test]
fn contradictory_entries_are_findings() {
    use DocumentFindingKind::{DuplicateAddress, DuplicateEntry, DuplicateUid, UnusableUid};
    let entry = |name: &str, rest: &str| format!("{{\"name\": \"{name}\", {rest}}}");
    let pinned = |name: &str| entry(name, "\"address\": 12, \"static\": true");
    let on = |name: &str, bus: &str| {
        entry(name, &format!("\"address\": 12, \"static\": true, \"bus\": \"{bus}\""))
    };
    let kinds = |entries: &[String]| -> Vec<(DocumentFindingKind, Vec<usize>)> {
        let found = findings(&format!("[\n{}\n]", entries.join(",\n")));
        found.into_iter().map(|(kind, _, entries)| (kind, entries)).collect()
    };
    let address = |entries| vec![(DocumentFindingKind::DuplicateAddress, entries)];
    assert_eq!(kinds(&[pinned("A"), pinned("B")]), address(vec![0, 1]));
    assert_eq!(kinds(&[pinned("A"), pinned("B"), pinned("C")]), address(vec![0, 1, 2]));
    assert_eq!(kinds(&[on("A", "can0"), on("B", "can1")]), []);
    assert_eq!(kinds(&[on("A", "can0"), on("B", "can1"), on("C", "can1")]), address(vec![1, 2]));
    assert_eq!(kinds(&[on("A", "can0"), pinned("B")]), address(vec![0, 1]), "no bus is every bus");
    assert_eq!(kinds(&[pinned("A"), entry("B", "\"address\": 12")]), [], "not static");
    assert_eq!(
        kinds(&[entry("A", "\"address\": 12"), pinned("A")]),
        [(DocumentFindingKind::DuplicateEntry, vec![0, 1])]
    );
    assert_eq!(
        kinds(&[pinned("A"), pinned("A")]),
        [(DocumentFindingKind::DuplicateEntry, vec![0, 1])]
    );
    assert_eq!(kinds(&[entry("A", "\"address\": 1"), entry("A", "\"address\": 2")]), [], "twins");

    let with_uid = |name: &str, uid: &str, rest: &str| {
        entry(name, &format!("\"uid\": \"{uid}\", \"bus\": \"can0\"{rest}"))
    };
    let uid = |entries| vec![(DocumentFindingKind::DuplicateUid, entries)];
    assert_eq!(kinds(&[with_uid("A", "U1", ""), with_uid("B", "U1 ", "")]), uid(vec![0, 1]));
    assert_eq!(kinds(&[with_uid("A", "U1", ""), with_uid("B", "U2", "")]), []);
    assert_eq!(kinds(&[with_uid("A", "", ""), with_uid("B", "", "")]), [], "no UID");
    assert_eq!(
        kinds(&[with_uid("A", "U1", ""), entry("B", "\"uid\": \"U1\", \"bus\": \"can1\"")]),
        []
    );
    let twice = [with_uid("A", "U1", ", \"address\": 5"), with_uid("A", "U1", ", \"address\": 5")];
    assert_eq!(kinds(&twice), [(DocumentFindingKind::DuplicateEntry, vec![0, 1])]);
    let messages =
        findings(&format!("[\n{},\n{}\n]", with_uid("A", "U1", ""), with_uid("B", "U1", "")));
    assert_eq!(
        messages[0].1,
        "line 3, column 22: U1 is the `uid` of 2 entries: A (line 2) and B (line 3)"
    );

    let messages = findings(&format!("[\n{},\n{}, {}\n]", pinned("A"), pinned("B"), pinned("B")));
    let messages: Vec<&str> = messages.iter().map(|(_, message, _)| message.as_str()).collect();
    assert_eq!(
        messages,
        [
            "line 3, column 26: 12 is the static address of 3 entries: A (line 2), B (line 3) and B (line 3)",
            "line 3, column 72: B at address 12 is listed 2 times: line 3 and line 3",
        ]
    );
    let names = [DuplicateAddress, DuplicateEntry, DuplicateUid, UnusableUid]
        .map(|kind| FindingKind::from(kind).name());
    assert_eq!(
        names,
        ["file-duplicate-address", "file-duplicate-entry", "file-shape", "file-shape"]
    );
}

// ---- editing: exact bytes ----

#[test]
fn address_edit_changes_no_other_byte() {
    for (before, after) in [
        (
            r#"{"devices":[{"name":"FEED","address":12,"static":true}]}"#,
            r#"{"devices":[{"name":"FEED","address":16,"static":true}]}"#,
        ),
        (
            "\u{feff}{\r\n\t\"x\" : 1e3,\r\n\t\"devices\" : [\r\n\t\t{ \"static\" : false , \"addr\\u0065ss\":12 ,\"name\":\"FEED\", \"w\": 1.50E+2 }\r\n\t]\r\n}",
            "\u{feff}{\r\n\t\"x\" : 1e3,\r\n\t\"devices\" : [\r\n\t\t{ \"static\" : true , \"addr\\u0065ss\":16 ,\"name\":\"FEED\", \"w\": 1.50E+2 }\r\n\t]\r\n}",
        ),
        (
            " [ 7, {\"name\":\"FEED\",\"deep\":{\"address\":12},\"address\":\"twelve\",\"static\":true} ] \n\n",
            " [ 7, {\"name\":\"FEED\",\"deep\":{\"address\":12},\"address\":16,\"static\":true} ] \n\n",
        ),
        // Missing members go where the file has them elsewhere, or to the default place.
        (r#"[{"name":"FEED"}]"#, r#"[{"name":"FEED","address":16,"static":true}]"#),
        (r#"[{"name": "FEED"}]"#, r#"[{"name": "FEED", "address": 16, "static": true}]"#),
        (
            "[\n  {\n    \"name\": \"FEED\"\n  }\n]",
            "[\n  {\n    \"name\": \"FEED\",\n    \"address\": 16,\n    \"static\": true\n  }\n]",
        ),
        (
            "[\n  {\n    \"name\": \"FEED\",\n    \"services\": []\n  }\n]",
            "[\n  {\n    \"name\": \"FEED\",\n    \"address\": 16,\n    \"static\": true,\n    \"services\": []\n  }\n]",
        ),
        (
            r#"[{"name":"FEED","note":1}, {"static":true,"address":3,"name":"SENS"}]"#,
            r#"[{"static":true,"address":16,"name":"FEED","note":1}, {"static":true,"address":3,"name":"SENS"}]"#,
        ),
        (
            "[\n  { \"name\": \"FEED\"\n  , \"note\": 1\n  }\n]",
            "[\n  { \"name\": \"FEED\"\n  , \"address\": 16\n  , \"static\": true\n  , \"note\": 1\n  }\n]",
        ),
    ] {
        edits_and_back(before, |document| set(document, "FEED", 16), after);
    }
}

#[test]
fn clearing_static_keeps_the_address() {
    edits_and_back(
        r#"[{"name":"FEED","address":12,"static": true}]"#,
        |document| clear(document, "FEED"),
        r#"[{"name":"FEED","address":12,"static": false}]"#,
    );
    let not_static = r#"[{"name":"FEED","address":12}]"#;
    edits_and_back(not_static, |document| clear(document, "FEED"), not_static);
}

#[test]
fn first_entry_in_empty_file_makes_an_object() {
    let begun = "{\n  \"devices\": [\n    { \"name\": \"FEED\", \"address\": 12, \"static\": true }\n  ]\n}\n";
    edits("", |_| add("FEED", 12), begun);
    edits("  \n", |_| add("FEED", 12), begun);
    edits("\u{feff}", |_| add("FEED", 12), &format!("\u{feff}{begun}"));
    edits("\r\n", |_| add("FEED", 12), &begun.replace('\n', "\r\n"));
    edits("{}\n", |_| add("FEED", 12), begun);

    let with_services = Operation::Add {
        entry: NewEntry {
            services: listed(&[("DES", "1.0"), ("AUGER", "2.1")]),
            ..device("FEED", 12)
        },
    };
    edits(
        "",
        |_| with_services.clone(),
        r#"{
  "devices": [
    { "name": "FEED", "address": 12, "static": true,
      "services": [ { "name": "DES", "version": "1.0" }, { "name": "AUGER", "version": "2.1" } ] }
  ]
}
"#,
    );
}

#[test]
fn undo_of_first_entry_restores_every_byte() {
    let shapes = [
        "",
        " \n\t",
        "\u{feff}",
        "{}",
        "{ }\n",
        "{\"devices\":null}",
        "{\"x\":1,\"devices\" : null }",
        "{\"x\": [1]}",
        "[]",
        "[\n\n]",
        "{\"devices\": [ ] }",
        "\u{feff}{\r\n}\r\n",
    ];
    for before in shapes {
        let document = parsed(before);
        let first = add("FEED", 12);
        let begun = document.apply(&first).unwrap();
        let back = first.inverse(&document).unwrap();
        let undone = begun.apply(&back).unwrap();
        assert_eq!(text(&undone), before);
        assert_eq!(undone.apply(&back.inverse(&begun).unwrap()).unwrap(), begun, "made again");

        // The same after other edits were made and undone in between.
        let second = add("SENS", 13);
        let both = begun.apply(&second).unwrap();
        let one = both.apply(&second.inverse(&begun).unwrap()).unwrap();
        assert_eq!(text(&one.apply(&back).unwrap()), before);

        // A change by another program meanwhile stays.
        let newer =
            merge(&begun, std::slice::from_ref(&back), &both, MergePreference::Neither).unwrap();
        let Merge::Rebased { document, .. } = newer else { panic!("{newer:?}") };
        assert_eq!(document.entries().len(), 1, "{before}");
        let newer = parsed(&(text(&begun).to_owned() + "\n\n"));
        let merged =
            merge(&begun, std::slice::from_ref(&back), &newer, MergePreference::Neither).unwrap();
        let Merge::Rebased { document, .. } = merged else { panic!("{merged:?}") };
        assert!(document.entries().is_empty() && text(&document).ends_with("\n\n"), "{before}");
        // A redo restores what the undo removed.
        let redone = document.apply(&back.inverse(&newer).unwrap()).unwrap();
        says_the_same(&redone, &newer);
    }
}

#[test]
fn first_entry_in_empty_list_is_placed_inside() {
    for (before, after) in [
        ("[]", "[\n  { \"name\": \"FEED\", \"address\": 12, \"static\": true }\n]"),
        (
            "{\r\n\t\"devices\": [\r\n\t],\r\n\t\"x\": 1\r\n}",
            "{\r\n\t\"devices\": [\r\n\t\t{ \"name\": \"FEED\", \"address\": 12, \"static\": true }\r\n\t],\r\n\t\"x\": 1\r\n}",
        ),
        (
            "{\n    \"x\": 1\n}",
            "{\n    \"x\": 1,\n    \"devices\": [\n        { \"name\": \"FEED\", \"address\": 12, \"static\": true }\n    ]\n}",
        ),
        (
            "{\n  \"devices\": null\n}",
            "{\n  \"devices\": [\n    { \"name\": \"FEED\", \"address\": 12, \"static\": true }\n  ]\n}",
        ),
    ] {
        edits(before, |_| add("FEED", 12), after);
    }
}

#[test]
fn new_entry_follows_the_layout_of_its_neighbours() {
    let mut sens = device("SENS", 13);
    sens.services = listed(&[("DES", "1.0"), ("TEMP", "1.2")]);
    for (before, after) in [
        // Compact.
        (
            r#"{"devices":[{"name":"FEED","address":12,"static":true}]}"#,
            r#"{"devices":[{"name":"FEED","address":12,"static":true},{"name":"SENS","address":13,"static":true,"services":[{"name":"DES","version":"1.0"},{"name":"TEMP","version":"1.2"}]}]}"#,
        ),
        // In the style of `jq .`.
        (
            "[\n  {\n    \"name\": \"FEED\",\n    \"address\": 12\n  }\n]\n",
            "[\n  {\n    \"name\": \"FEED\",\n    \"address\": 12\n  },\n  {\n    \"name\": \"SENS\",\n    \"address\": 13,\n    \"static\": true,\n    \"services\": [\n      { \"name\": \"DES\", \"version\": \"1.0\" },\n      { \"name\": \"TEMP\", \"version\": \"1.2\" }\n    ]\n  }\n]\n",
        ),
        // Order, tabs, CRLF, services as an object, members unknown to descan.
        (
            "[\r\n\t{\r\n\t\t\"address\":12,\r\n\t\t\"services\":{\r\n\t\t\t\"DES\":\"1.0\",\r\n\t\t\t\"AUGER\":\"2.1\"\r\n\t\t},\r\n\t\t\"note\":1,\r\n\t\t\"name\":\"FEED\"\r\n\t}\r\n]",
            "[\r\n\t{\r\n\t\t\"address\":12,\r\n\t\t\"services\":{\r\n\t\t\t\"DES\":\"1.0\",\r\n\t\t\t\"AUGER\":\"2.1\"\r\n\t\t},\r\n\t\t\"note\":1,\r\n\t\t\"name\":\"FEED\"\r\n\t},\r\n\t{\r\n\t\t\"address\":13,\r\n\t\t\"static\":true,\r\n\t\t\"services\":{\r\n\t\t\t\"DES\":\"1.0\",\r\n\t\t\t\"TEMP\":\"1.2\"\r\n\t\t},\r\n\t\t\"name\":\"SENS\"\r\n\t}\r\n]",
        ),
        // The name follows the address; another entry shows the place of `static`.
        (
            r#"[{"address":12,"name":"FEED","static":true},{"address":14,"name":"ACT"}]"#,
            r#"[{"address":12,"name":"FEED","static":true},{"address":14,"name":"ACT"},{"address":13,"name":"SENS","static":true,"services":[{"name":"DES","version":"1.0"},{"name":"TEMP","version":"1.2"}]}]"#,
        ),
        // One service does not define the separator between two.
        (
            r#"[{"name":"FEED","address":12,"services":[{"name":"DES","version":"1.0"}]}]"#,
            r#"[{"name":"FEED","address":12,"services":[{"name":"DES","version":"1.0"}]},{"name":"SENS","address":13,"static":true,"services":[{"name":"DES","version":"1.0"},{"name":"TEMP","version":"1.2"}]}]"#,
        ),
        // The manufacturer's example; a leading comma; the last entry without services.
        (
            "[ { \"name\": \"FEED\", \"address\": 12,\n      \"services\": [ { \"name\": \"DES\", \"version\": \"1.0\" } ] }\n, { \"name\": \"ACT\" }\n]",
            "[ { \"name\": \"FEED\", \"address\": 12,\n      \"services\": [ { \"name\": \"DES\", \"version\": \"1.0\" } ] }\n, { \"name\": \"ACT\" }\n, { \"name\": \"SENS\", \"address\": 13, \"static\": true,\n      \"services\": [ { \"name\": \"DES\", \"version\": \"1.0\" }, { \"name\": \"TEMP\", \"version\": \"1.2\" } ] }\n]",
        ),
    ] {
        edits_and_back(before, |_| Operation::Add { entry: sens.clone() }, after);
    }
}

#[test]
fn new_entry_holds_all_known_members() {
    let entry = NewEntry {
        name: b"P\xff\x1b".to_vec(),
        address: Some(9),
        is_static: false,
        bus: Some("can0".into()),
        uid: Some("BOILER01".into()),
        services: vec![ListedService {
            name: "DES".into(),
            version: "1.0".into(),
            extra: vec!["a\"".into(), "b".into()],
        }],
    };
    edits_and_back(
        r#"[{"name":"A"}]"#,
        |_| Operation::Add { entry: entry.clone() },
        r#"[{"name":"A"},{"name":"P\\xFF\\x1B","name_hex":"50FF1B","address":9,"services":[{"name":"DES","version":"1.0","extra":["a\"", "b"]}],"bus":"can0","uid":"BOILER01"}]"#,
    );
    // Services in object form cannot hold strings after the version, so a list is written.
    edits(
        r#"[{"name":"A","services":{"DES":"1.0"}}]"#,
        |_| Operation::Add { entry: NewEntry { name: b"B".to_vec(), ..entry.clone() } },
        r#"[{"name":"A","services":{"DES":"1.0"}},{"name":"B","address":9,"services":[{"name":"DES","version":"1.0","extra":["a\"", "b"]}],"bus":"can0","uid":"BOILER01"}]"#,
    );
    // `static` false is written if the file does so.
    edits(
        r#"[{"name":"A","static":true}]"#,
        |_| Operation::Add { entry: NewEntry { name: b"B".to_vec(), ..NewEntry::default() } },
        r#"[{"name":"A","static":true},{"name":"B","static":false}]"#,
    );
}

#[test]
fn removed_entry_removes_its_comma() {
    let all = "[\n  {\"name\":\"A\", \"x\":1e1},\n\n  {\"name\":\"B\"} , {\"name\":\"C\"}\n]";
    for (name, after) in [
        ("A", "[\n  {\"name\":\"B\"} , {\"name\":\"C\"}\n]"),
        ("B", "[\n  {\"name\":\"A\", \"x\":1e1} , {\"name\":\"C\"}\n]"),
        ("C", "[\n  {\"name\":\"A\", \"x\":1e1},\n\n  {\"name\":\"B\"}\n]"),
    ] {
        edits_and_back(all, |document| remove(document, name), after);
    }
    edits_and_back("[ {\"name\":\"A\"}\n]", |document| remove(document, "A"), "[]");
    edits_and_back("[1, {\"name\":\"A\"}]", |document| remove(document, "A"), "[1]");
    edits_and_back("[{\"name\":\"A\"}, 1]", |document| remove(document, "A"), "[1]");
}

#[test]
fn edit_of_equal_entries_changes_only_one() {
    let before = r#"[{"name":"A","n":1},{"name":"A","n":2},{"name":"A","n":3}]"#;
    let second =
        |document: &Document| Operation::PinAddress { entry: document.key(1), from: None, to: 5 };
    edits_and_back(
        before,
        second,
        r#"[{"name":"A","n":1},{"name":"A","address":5,"static":true,"n":2},{"name":"A","n":3}]"#,
    );
}

#[test]
fn new_name_is_written_readably() {
    edits_and_back(
        r#"[{"name":"A","address":1}]"#,
        |document| rename(document, "A", "Н\"\u{85}".as_bytes()),
        r#"[{"name":"Н\"\u0085","address":1}]"#,
    );
    edits_and_back(
        r#"[{"name":"A","address":1}]"#,
        |document| rename(document, "A", b"\\\xfe"),
        r#"[{"name":"\\\\\\xFE","name_hex":"5CFE","address":1}]"#,
    );
    edits_and_back(
        r#"[{"name_hex":"41","name":"A"}]"#,
        |document| rename(document, "A", b"B"),
        r#"[{"name_hex":"42","name":"B"}]"#,
    );
}

#[test]
fn setting_services_keeps_foreign_elements() {
    for (value, at, found) in [
        (r#"[{"name":"DES"},"note"]"#, 41, "a string"),
        (r#"[{"version":"1"}]"#, 26, "an object"),
        (r#"[{"name":"DES","version":2.1}]"#, 26, "an object"),
        (r#"{"DES":"1","TEMP":{"version":"1.7","min":3}}"#, 43, "an object"),
    ] {
        let document = parsed(&format!(r#"[{{"name":"A","services":{value}}}]"#));
        let error = document.apply(&services(&document, "A", &[("DES", "1")])).unwrap_err();
        let said = format!("line 1, column {at}: expected a service, found {found}: fix it first");
        assert_eq!(error.to_string(), said, "{value}");
    }
}

#[test]
fn services_keep_their_form_when_edited() {
    // Only a version.
    edits_and_back(
        r#"[{"name":"A","services":[ {"name":"DES","version":"1.0","x":1} ,{"version":"1","name":"B"}]}]"#,
        |document| services(document, "A", &[("DES", "1.1"), ("B", "1")]),
        r#"[{"name":"A","services":[ {"name":"DES","version":"1.1","x":1} ,{"version":"1","name":"B"}]}]"#,
    );
    edits_and_back(
        r#"[{"name":"A","services":{"DES" : "1.0" , "B":"1"}}]"#,
        |document| services(document, "A", &[("DES", "1.0"), ("B", "2")]),
        r#"[{"name":"A","services":{"DES" : "1.0" , "B":"2"}}]"#,
    );
    // Other services; those that stay keep their members.
    edits_and_back(
        r#"[{"name":"A","services":[ {"name":"DES","version":"1.0","x":1} ,{"name":"B"}]}]"#,
        |document| services(document, "A", &[("C", "3"), ("DES", "1.1")]),
        r#"[{"name":"A","services":[ {"name":"C","version":"3"} ,{"name":"DES","version":"1.1","x":1}]}]"#,
    );
    edits_and_back(
        r#"[{"name":"A","services":{"DES":"1.0"}}]"#,
        |document| services(document, "A", &[("C", "3"), ("DES", "1.1")]),
        r#"[{"name":"A","services":{"C":"3","DES":"1.1"}}]"#,
    );
    // The text between services that stay is kept; a comma goes with the one before it.
    let spread = "[{\"name\":\"A\",\"services\":{\"A\":\"1\" ,\n\n\"B\" : \"2\",   \"C\":\"3\" }}]";
    for (listed, after) in [
        (&[("A", "1"), ("C", "4")][..], "{\"A\":\"1\",   \"C\":\"4\" }"),
        (&[("B", "2"), ("C", "3")], "{\"B\" : \"2\",   \"C\":\"3\" }"),
        (&[("A", "1"), ("B", "2")], "{\"A\":\"1\" ,\n\n\"B\" : \"2\" }"),
        (
            &[("A", "1"), ("B", "2"), ("N", "9"), ("C", "3")],
            "{\"A\":\"1\" ,\n\n\"B\" : \"2\" ,\n\n\"N\":\"9\",   \"C\":\"3\" }",
        ),
        (
            &[("C", "3"), ("A", "1"), ("B", "2")],
            "{\"C\":\"3\" ,\n\n\"A\":\"1\" ,\n\n\"B\" : \"2\" }",
        ),
    ] {
        let after = format!("[{{\"name\":\"A\",\"services\":{after}}}]");
        edits_and_back(spread, |document| services(document, "A", listed), &after);
    }
    // None before; none after; the wrong one before.
    edits_and_back(
        r#"[{"name": "A"}]"#,
        |document| services(document, "A", &[("C", "3")]),
        r#"[{"name": "A", "services": [{"name": "C", "version": "3"}]}]"#,
    );
    edits_and_back(
        r#"[{"name":"A"},{"name":"B","services":{"DES":"1"}}]"#,
        |document| services(document, "A", &[("C", "3")]),
        r#"[{"name":"A","services":{"C":"3"}},{"name":"B","services":{"DES":"1"}}]"#,
    );
    edits_and_back(
        "[{\"name\":\"A\",\"services\":[\n{\"name\":\"C\"}\n]}]",
        |document| services(document, "A", &[]),
        "[{\"name\":\"A\",\"services\":[]}]",
    );
    edits_and_back(
        r#"[{"name":"A","services":7}]"#,
        |document| services(document, "A", &[("C", "3")]),
        r#"[{"name":"A","services":[{"name":"C","version":"3"}]}]"#,
    );
    // A version that the file omits stays omitted.
    edits_and_back(
        r#"[{"name":"A","services":{"DES":null,"B":"1"}}]"#,
        |document| services(document, "A", &[("DES", ""), ("B", "2")]),
        r#"[{"name":"A","services":{"DES":null,"B":"2"}}]"#,
    );
    edits_and_back(
        r#"[{"name":"A","services":{"C":"2"}}]"#,
        |document| services(document, "A", &[("C", "3"), ("C", "4")]),
        r#"[{"name":"A","services":[{"name":"C","version":"3"},{"name":"C","version":"4"}]}]"#,
    );
    // Strings after the version are added, changed and removed.
    let extra = |strings: &'static [&'static str]| {
        move |document: &Document| Operation::SetServices {
            entry: key(document, "A"),
            services: vec![ListedService {
                name: "C".into(),
                version: "3".into(),
                extra: strings.iter().map(|&text| text.into()).collect(),
            }],
        }
    };
    edits_and_back(
        r#"[{"name":"A","services":[{"name":"C","version":"3","x":0}]}]"#,
        extra(&["a", "b"]),
        r#"[{"name":"A","services":[{"name":"C","version":"3","extra":["a", "b"],"x":0}]}]"#,
    );
    edits_and_back(
        r#"[{"name":"A","services":[{"name":"C","version":"3","extra":[ "a" ],"x":0}]}]"#,
        extra(&[]),
        r#"[{"name":"A","services":[{"name":"C","version":"3","x":0}]}]"#,
    );
}

#[test]
fn ambiguous_entry_rejects_edits() {
    for (source, expected) in [
        (
            r#"{"devices":[{"name":"A"}],"devices":[{"name":"A"}]}"#,
            "line 1, column 27: duplicate `devices`: remove one of them first",
        ),
        (
            r#"[{"name":"A","address":1,"addr\u0065ss":2}]"#,
            "line 1, column 26: duplicate `address`: remove one of them first",
        ),
        (
            r#"[{"name":"A","static":true,"static":true}]"#,
            "line 1, column 28: duplicate `static`: remove one of them first",
        ),
    ] {
        let document = parsed(source);
        let error = document.apply(&set(&document, "A", 9)).unwrap_err();
        assert!(matches!(error, EditError::DuplicateMember { .. }));
        assert_eq!(error.to_string(), expected);
    }
    // Elsewhere duplicate members are left alone.
    edits_and_back(
        r#"{"//":1,"//":2,"devices":[{"name":"A","//":1,"//":2,"services":{"B":"1","B":"2"}}]}"#,
        |document| set(document, "A", 9),
        r#"{"//":1,"//":2,"devices":[{"name":"A","address":9,"static":true,"//":1,"//":2,"services":{"B":"1","B":"2"}}]}"#,
    );
    let document = parsed(r#"[{"name":"A","services":{"B":"1","B":"2"}}]"#);
    let error = document.apply(&services(&document, "A", &[("B", "3")])).unwrap_err();
    assert_eq!(error.to_string(), "line 1, column 34: duplicate `B`: remove one of them first");
}

#[test]
fn file_without_place_for_entries_rejects_edits() {
    for (source, expected) in [
        ("\n 12", "line 2, column 2: expected a list of devices, found a number"),
        (r#"{"devices": {}}"#, "line 1, column 13: expected a list of devices, found an object"),
    ] {
        assert_eq!(parsed(source).apply(&add("A", 1)).unwrap_err().to_string(), expected);
    }
    let document = parsed(r#"[{"name":"A"}]"#);
    let gone = set(&parsed(r#"[{"name":"A","address":3}]"#), "A", 9);
    let error = document.apply(&gone).unwrap_err();
    assert_eq!(error.to_string(), "entry no longer in the file: A at 3");
    assert_eq!(gone.inverse(&document).unwrap_err(), error);
    for address in [0, 128, 255] {
        let range = EditError::AddressRange { address };
        assert_eq!(document.apply(&set(&document, "A", address)).unwrap_err(), range);
        assert_eq!(document.apply(&add("B", address)).unwrap_err(), range);
    }
}

#[test]
fn operations_have_display_names() {
    let document = parsed(r#"[{"name":"FE\u001bED","address":12,"static":true,"services":[]}]"#);
    let name = "FE\u{1b}ED";
    let named = |operation: &Operation| operation.to_string();
    let change = set(&document, name, 16);
    assert_eq!(named(&change), "address of the entry FE\\x1BED: 12 → 16");
    assert_eq!(
        named(&change.inverse(&document).unwrap()),
        "address of the entry FE\\x1BED restored to 12"
    );
    assert_eq!(named(&clear(&document, name)), "entry FE\\x1BED unpinned (was 12)");
    assert_eq!(named(&add("SENS", 13)), "new entry SENS at 13");
    assert_eq!(named(&remove(&document, name)), "entry FE\\x1BED at 12 deleted");
    let back = remove(&document, name).inverse(&document).unwrap();
    assert_eq!(named(&back), "entry FE\\x1BED at 12 restored");
    let renamed = rename(&document, name, b"\xff");
    assert_eq!(named(&renamed), "entry FE\\x1BED at 12 renamed to \\xFF");
    assert_eq!(
        named(&renamed.inverse(&document).unwrap()),
        "entry \\xFF at 12 renamed back to FE\\x1BED"
    );
    let listed = services(&document, name, &[("A", "1"), ("B", "1")]);
    assert_eq!(named(&listed), "services of the entry FE\\x1BED at 12: 2 listed");
    let long = named(&rename(&document, name, &[b'x'; 1000]));
    assert!(long.chars().count() < 100, "{long}");
}

// ---- merging ----

const BASE: &str = r#"[
  {"name":"FEED","address":12,"static":true},
  {"name":"SENS","address":13,"static":true,"services":[{"name":"DES","version":"1.0"}]},
  {"name":"ACT","address":14}
]"#;

/// Merges ours (operations) with theirs (content); formats an edit conflict as "ours | theirs".
fn merged(ours: &[Operation], theirs: &str, prefer: MergePreference) -> Result<String, String> {
    match merge(&parsed(BASE), ours, &parsed(theirs), prefer).unwrap() {
        Merge::Rebased { document, .. } => Ok(text(&document).to_owned()),
        Merge::Conflict(it) => Err(format!("{} | {}", it.ours, it.theirs)),
    }
}

#[test]
fn merge_keeps_both_sides() {
    let base = parsed(BASE);
    for (operation, theirs, after) in [
        // Another entry, another order, other white space.
        (
            set(&base, "FEED", 16),
            r#"[ {"name":"NEW"}, {"name":"SENS","address":99}, {"name":"FEED","address":12,"static":true} ]"#,
            r#"[ {"name":"NEW"}, {"name":"SENS","address":99}, {"name":"FEED","address":16,"static":true} ]"#,
        ),
        // Another member of the entry.
        (
            services(&base, "FEED", &[("DES", "1")]),
            r#"[{"name":"FEED","address":20,"static":true}]"#,
            r#"[{"name":"FEED","address":20,"static":true,"services":[{"name":"DES","version":"1"}]}]"#,
        ),
        (
            rename(&base, "FEED", b"PUMP"),
            r#"[{"name":"FEED","address":20,"static":true}]"#,
            r#"[{"name":"PUMP","address":20,"static":true}]"#,
        ),
        // Theirs renamed it.
        (
            set(&base, "FEED", 16),
            r#"[{"name":"PUMP","address":12,"static":true}]"#,
            r#"[{"name":"PUMP","address":16,"static":true}]"#,
        ),
        // Theirs made the same change.
        (
            set(&base, "FEED", 16),
            r#"[{"name":"FEED","static":true,"address":16}]"#,
            r#"[{"name":"FEED","static":true,"address":16}]"#,
        ),
        (remove(&base, "FEED"), r#"[{"name":"ACT"}]"#, r#"[{"name":"ACT"}]"#),
        (
            add("NEW", 9),
            r#"[{"name":"NEW","address":9,"static":true}]"#,
            r#"[{"name":"NEW","address":9,"static":true}]"#,
        ),
        // A removal, with only the white space changed.
        (remove(&base, "FEED"), r#"[{ "static":true, "name":"FEED","address":12}]"#, "[]"),
        // Theirs emptied the file.
        (
            add("NEW", 9),
            "",
            "{\n  \"devices\": [\n    { \"name\": \"NEW\", \"address\": 9, \"static\": true }\n  ]\n}\n",
        ),
    ] {
        assert_eq!(merged(&[operation], theirs, MergePreference::Neither).as_deref(), Ok(after));
    }
}

#[test]
fn same_value_changed_twice_is_an_edit_conflict() {
    let base = parsed(BASE);
    let services_of_new =
        vec![ListedService { name: "DES".into(), version: "2".into(), ..ListedService::default() }];
    let with_services =
        Operation::Add { entry: NewEntry { services: services_of_new, ..device("NEW", 9) } };
    for (operation, theirs, conflict, with_ours) in [
        (
            set(&base, "FEED", 16),
            r#"[{"name":"FEED","address":20,"static":true}]"#,
            "address 16, static | address 20, static",
            r#"[{"name":"FEED","address":16,"static":true}]"#,
        ),
        (
            set(&base, "FEED", 16),
            r#"[{"name":"ACT","address":14}]"#,
            "address 16, static | deleted",
            "[{\"name\":\"FEED\",\"address\":16,\"static\":true},\n  {\"name\":\"ACT\",\"address\":14}]",
        ),
        (
            remove(&base, "FEED"),
            r#"[{"name":"FEED","address":20,"static":true}]"#,
            "deleted | address 20",
            "[]",
        ),
        (
            remove(&base, "FEED"),
            r#"[{"name":"FEED","address":12,"static":true,"note":"mine"}]"#,
            "deleted | other members changed",
            "[]",
        ),
        (
            rename(&base, "ACT", b"VALVE"),
            r#"[{"name":"MOTOR","address":14}]"#,
            "VALVE | MOTOR",
            r#"[{"name":"VALVE","address":14}]"#,
        ),
        (
            services(&base, "SENS", &[("DES", "1.1")]),
            r#"[{"name":"SENS","address":13,"static":true,"services":[{"name":"DES","version":"1.2"}]}]"#,
            "services DES 1.1 | services DES 1.2",
            r#"[{"name":"SENS","address":13,"static":true,"services":[{"name":"DES","version":"1.1"}]}]"#,
        ),
        (
            add("NEW", 9),
            r#"[{"name":"NEW","address":9,"uid":"X"}]"#,
            "address 9, static | address 9, not static",
            r#"[{"name":"NEW","address":9,"static":true,"uid":"X"}]"#,
        ),
        // Theirs added the device too, at another address: as if a missing folder is restored.
        (
            add("NEW", 9),
            r#"[{"name":"NEW","address":11,"note":"mine","services":{"DES":"1"}}]"#,
            "address 9, static | address 11, not static",
            r#"[{"name":"NEW","address":9,"static":true,"note":"mine","services":{"DES":"1"}}]"#,
        ),
        (
            with_services.clone(),
            r#"[{"name":"NEW","address":11,"services":{"DES":"1"}}]"#,
            "address 9, static, services DES 2 | address 11, not static, services DES 1",
            r#"[{"name":"NEW","address":9,"static":true,"services":{"DES":"2"}}]"#,
        ),
    ] {
        let operations = [operation];
        assert_eq!(merged(&operations, theirs, MergePreference::Neither).unwrap_err(), conflict);
        assert_eq!(merged(&operations, theirs, MergePreference::Theirs).as_deref(), Ok(theirs));
        assert_eq!(merged(&operations, theirs, MergePreference::Ours).as_deref(), Ok(with_ours));
    }
}

#[test]
fn each_changed_value_is_one_edit_conflict() {
    let base = parsed(BASE);
    let mut document = base.clone();
    let mut ours = Vec::new();
    for next in [
        |document: &Document| set(document, "FEED", 70),
        |document: &Document| set(document, "SENS", 71),
        |document: &Document| set(document, "FEED", 72),
        |document: &Document| rename(document, "ACT", b"VALVE"),
        |document: &Document| set(document, "VALVE", 73),
    ] {
        let operation = next(&document);
        document = document.apply(&operation).unwrap();
        ours.push(operation);
    }
    // ACT was removed: one conflict covers its name and its address.
    let theirs = r#"[{"name":"FEED","address":100,"static":true},{"name":"SENS","address":101,"static":true}]"#;
    let theirs = parsed(theirs);
    let mut chosen = Vec::new();
    for (number, asked) in [(1, "address 100, static"), (2, "address 101, static"), (3, "deleted")]
    {
        let choices = ConflictChoices { chosen: chosen.clone(), ..ConflictChoices::default() };
        let merge =
            merge_with_choices(&base, &ours, &theirs, &choices, MergePreference::Neither).unwrap();
        let Merge::Conflict(conflict) = merge else { panic!("{merge:?}") };
        assert_eq!((conflict.index, conflict.total, &*conflict.theirs), (number, 3, asked));
        chosen.push(if number == 2 { MergePreference::Ours } else { MergePreference::Theirs });
    }
    let choices = ConflictChoices { chosen, ..ConflictChoices::default() };
    let merge =
        merge_with_choices(&base, &ours, &theirs, &choices, MergePreference::Neither).unwrap();
    let Merge::Rebased { document, .. } = merge else { panic!("{merge:?}") };
    assert_eq!(text(&document), text(&theirs).replace("101", "71"));
}

#[test]
fn merge_keeps_one_copy_of_equal_entries() {
    let seen = |entry: NewEntry| Operation::Add { entry: NewEntry { is_static: false, ..entry } };
    let uid = |uid: &str| NewEntry { uid: Some(uid.into()), ..device("NEW", 9) };
    for (operation, theirs, entries) in [
        // The observed address does not contradict the address in theirs.
        (seen(device("NEW", 9)), r#"[{"name":"NEW","address":11,"static":true}]"#, 1),
        (seen(device("NEW", 9)), r#"[{"name":"NEW"}]"#, 1),
        (seen(uid("X")), r#"[{"name":"NEW","address":11,"uid":"X"}]"#, 1),
        (seen(uid("X")), r#"[{"name":"NEW","address":11,"uid":"Y"}]"#, 2),
        (seen(device("NEW", 9)), r#"[{"name":"NEW","address":11,"bus":"can1"}]"#, 2),
        // It is ambiguous which of them is meant.
        (add("NEW", 9), r#"[{"name":"NEW","address":11},{"name":"NEW","address":12}]"#, 3),
        // Theirs left unchanged the entry that ours adds a second time.
        (add("FEED", 9), r#"[{"name":"FEED","address":12,"static":true}]"#, 2),
    ] {
        let merged = merged(&[operation], theirs, MergePreference::Neither).unwrap();
        assert_eq!(parsed(&merged).entries().len(), entries, "{merged}");
    }
}

#[test]
fn twin_is_not_taken_for_the_deleted_entry() {
    let base = parsed(r#"[{"name":"FEED","address":12},{"name":"FEED","address":13}]"#);
    let theirs = parsed(r#"[{"name":"FEED","address":13}]"#);
    let operation = set(&base, "FEED", 16);
    let merge = merge(&base, &[operation], &theirs, MergePreference::Neither).unwrap();
    assert!(matches!(merge, Merge::Conflict(conflict) if conflict.theirs == "deleted"));
}

#[test]
fn restored_entry_that_came_back_is_not_added_twice() {
    let base = parsed(r#"[{"name":"FEED","address":12,"static":true},{"name":"SENS"}]"#);
    let deleted = parsed(r#"[{"name":"SENS"}]"#);
    let operation = set(&base, "FEED", 16);
    let merge_ours = merge(&base, &[operation], &deleted, MergePreference::Ours).unwrap();
    let Merge::Rebased { operations, .. } = merge_ours else { panic!("{merge_ours:?}") };
    assert!(matches!(operations[..], [Operation::RestoreEntry { .. }]), "{operations:?}");
    // Meanwhile the other program has put the entry back.
    let merge_again = merge(&deleted, &operations, &base, MergePreference::Ours).unwrap();
    let Merge::Rebased { document, .. } = merge_again else { panic!("{merge_again:?}") };
    assert_eq!(document.entries().len(), 2, "{}", text(&document));
    let feed = document.entries().iter().find(|entry| entry.name == b"FEED").unwrap();
    assert_eq!(feed.address, Some(16));
}

#[test]
fn dependent_operations_are_merged_in_order() {
    let base = parsed(BASE);
    let mut ours = vec![set(&base, "FEED", 16)];
    let mut document = base.apply(&ours[0]).unwrap();
    for next in [
        |document: &Document| set(document, "FEED", 17),
        |document: &Document| rename(document, "FEED", b"PUMP"),
        |_: &Document| add("NEW", 9),
        |document: &Document| remove(document, "NEW"),
        |document: &Document| services(document, "PUMP", &[("DES", "1")]),
    ] {
        let operation = next(&document);
        document = document.apply(&operation).unwrap();
        ours.push(operation);
    }
    assert_eq!(
        merged(
            &ours,
            r#"[{"name":"SENS"},{"name":"FEED","address":12,"static":true,"x":1}]"#,
            MergePreference::Neither
        )
        .as_deref(),
        Ok(
            r#"[{"name":"SENS"},{"name":"PUMP","address":17,"static":true,"services":[{"name":"DES","version":"1"}],"x":1}]"#
        )
    );
}

/// Tests that of several edits of one value only the last one counts.
#[test]
fn equal_final_value_is_no_edit_conflict() {
    let base = parsed(r#"[{"name":"A","address":1},{"name":"B","address":2}]"#);
    let mut ours = Vec::new();
    let mut document = base.clone();
    for to in [3, 4, 5] {
        let operation = Operation::PinAddress { entry: document.key(0), from: Some(1), to };
        document = document.apply(&operation).unwrap();
        ours.extend([operation, add("C", 10 + to)]);
        document = document.apply(ours.last().unwrap()).unwrap();
    }
    let theirs = parsed(r#"[{"name":"A","address":5,"static":true},{"name":"B","address":7}]"#);
    let merged = merge(&base, &ours, &theirs, MergePreference::Neither).unwrap();
    let Merge::Rebased { document, operations, .. } = merged else { panic!("{merged:?}") };
    assert_eq!((document.entries()[0].address, document.entries()[1].address), (Some(5), Some(7)));
    assert_eq!(operations.len(), 3, "the new entries");
    // Intermediate values of ours do not hide an edit conflict.
    let theirs = parsed(r#"[{"name":"A","address":4,"static":true},{"name":"B","address":7}]"#);
    let merged = merge(&base, &ours, &theirs, MergePreference::Neither).unwrap();
    assert!(matches!(merged, Merge::Conflict(_)), "{merged:?}");
}

#[test]
fn changed_entry_is_found_in_newer_content() {
    let base = parsed(
        r#"[{"name":"A","address":1},{"name":"A","address":1},{"name":"B","address":2},{"name":"C"}]"#,
    );
    let became = |index, newer: &str| base.counterpart(index, &parsed(newer));
    // Moved; equal ones keep their order.
    let moved = r#"[{"name":"C"},{"name":"B","address":2},{"name":"A","address":1},{"name":"A","address":1}]"#;
    assert_eq!([0, 1, 2, 3].map(|index| became(index, moved)), [2, 3, 1, 0].map(Some));
    // At another address, or with another name.
    assert_eq!(became(2, r#"[{"name":"B","address":3}]"#), Some(0));
    assert_eq!(became(2, r#"[{"name":"X"},{"name":"D","address":2}]"#), Some(1));
    // Deleted, or ambiguous.
    assert_eq!(became(2, r#"[{"name":"A","address":1}]"#), None);
    assert_eq!(became(2, r#"[{"name":"D","address":2},{"name":"E","address":2}]"#), None);
    assert_eq!(became(1, r#"[{"name":"A","address":1}]"#), None);
    assert_eq!(became(0, ""), None);
}

#[test]
fn undo_applies_to_newer_content() {
    let base = parsed(BASE);
    let operation = set(&base, "FEED", 16);
    let edited = base.apply(&operation).unwrap();
    let inverse = operation.inverse(&base).unwrap();
    let newer = parsed(r#"[{"name":"SENS"},{"name":"FEED","address":16,"static":true,"x":1}]"#);
    let Ok(Merge::Rebased { document, operations, .. }) =
        merge(&edited, &[inverse], &newer, MergePreference::Neither)
    else {
        panic!()
    };
    assert_eq!(
        text(&document),
        r#"[{"name":"SENS"},{"name":"FEED","address":12,"static":true,"x":1}]"#
    );
    let mut again = newer;
    for operation in &operations {
        again = again.apply(operation).unwrap();
    }
    assert_eq!(again, document);
}

// ---- the rest ----

#[test]
fn schema_is_json_and_lists_every_member() {
    let schema: serde_json::Value = serde_json::from_str(SCHEMA).unwrap();
    assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema");
    let members = schema["$defs"]["device"]["properties"].as_object().unwrap();
    for member in ["name", "name_hex", "address", "static", "services", "bus", "uid"] {
        assert!(members.contains_key(member), "{member}");
    }
}

/// Tests the length limit: a bus has 127 addresses, so a longer list is another program's file.
#[test]
fn more_than_20_000_entries_are_refused() {
    let entry = r#"{"name":"N"}"#;
    let full = format!("[{}]", vec![entry; 20_000].join(","));
    let document = parsed(&full);
    assert_eq!(document.entries().len(), 20_000);
    let entry = NewEntry { name: b"M".to_vec(), ..NewEntry::default() };
    let error = document.apply(&Operation::Add { entry }).unwrap_err();
    assert_eq!(error, EditError::Full);
    assert_eq!(
        error.to_string(),
        "no room for another entry: the file has 20000; delete one first"
    );
    let error = Document::parse(full.replacen('[', "[\n1,", 1).as_bytes()).unwrap_err();
    assert_eq!((error.line, error.column), (2, 3 + 13 * 19_999));
    assert_eq!(error.message, "more than 20000 entries; name the right file with --file");
}

#[test]
fn more_than_256_services_of_an_entry_are_refused() {
    for (open, service, close) in [('[', r#"{"name":"S"}"#, ']'), ('{', r#""S#":"1""#, '}')] {
        let file = |count| {
            let services: Vec<String> =
                (0..count).map(|at| service.replace('#', &at.to_string())).collect();
            format!(r#"[ {{"name":"A","services":{open}{}{close}}} ]"#, services.join(","))
        };
        let full = parsed(&file(256));
        assert_eq!(full.entries()[0].services.as_ref().unwrap().len(), 256);
        for count in [257, 100_000] {
            let error = Document::parse(file(count).as_bytes()).unwrap_err();
            assert_eq!((error.line, error.column), (1, 3));
            assert_eq!(error.message, "an entry with more than 256 services; remove some");
        }
    }
}

/// A file that descan writes can be read again.
#[test]
fn edit_beyond_16_mib_is_refused() {
    let mut source = br#"[{"name": "A", "address": 99, "static": true, "note": ""#.to_vec();
    source.resize(MAX_BYTES - 3, b'x');
    source.extend(b"\"}]");
    let full = Document::parse(&source).unwrap();
    let pin = |to| {
        let entry = full.key(0);
        full.apply(&Operation::PinAddress { entry, from: full.entries()[0].address, to })
    };
    assert_eq!(pin(100).unwrap_err(), EditError::TooLong);
    assert_eq!(pin(12).unwrap().source().len(), MAX_BYTES);
    assert_eq!(pin(1).unwrap().source().len(), MAX_BYTES - 1);
}
