//! `descan diff`, from outside: differences of logs and of documents of `scan --json`, output and
//! exit codes.

use crate::common::inspection::log;
use descan::inventory::{
    Difference, DifferenceKind, Inventory, InventoryComparison, InventoryDevice, InventoryEntry,
    InventoryFinding, InventoryService, compare,
};
use descan::sim::{DeviceAction, DeviceSpec, Scenario};
use descan::time::Duration;
use serde_json::{Value, json};
use std::io::Write;
use std::process::{Command, Output, Stdio};

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) -> &Self {
        std::fs::write(self.0.path().join(name), content).unwrap();
        self
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
        command.args(arguments).current_dir(self.0.path());
        command.env("XDG_CONFIG_HOME", self.0.path().join("config")).stdin(Stdio::null());
        command
    }

    fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("the program starts")
    }

    /// Returns exit code, standard output and standard error of `descan diff`.
    fn diff(&self, arguments: &[&str]) -> (i32, String, String) {
        let output = self.run(&[&["diff"], arguments].concat());
        (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
    }

    /// Returns kind, address, before and after of each difference of two files.
    fn rows(&self, before: &str, after: &str) -> Vec<Value> {
        let (code, out, error) = self.diff(&[before, after, "--json"]);
        assert_eq!(error, "");
        let report: Value = serde_json::from_str(&out).unwrap();
        let differences = report["differences"].as_array().unwrap();
        assert_eq!(code, i32::from(!differences.is_empty()), "{out}");
        let row = |it: &Value| json!([it["kind"], it["address"], it["before"], it["after"]]);
        differences.iter().map(row).collect()
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("output is UTF-8")
}

fn device(name: &str, address: u8) -> DeviceSpec {
    DeviceSpec::new(name).fixed(address).skips_address_resolution()
}

/// A device with that UID.
fn board(uid: &str, name: &str, address: u8) -> DeviceSpec {
    device(uid, address).name(name.as_bytes())
}

fn bus(devices: impl IntoIterator<Item = DeviceSpec>) -> String {
    let scenario = devices.into_iter().fold(Scenario::new(125_000), Scenario::with);
    log(&scenario, 12)
}

#[test]
fn logs_of_a_changed_bus_yield_a_row_each() {
    let folder = Folder::new();
    let before = [
        device("FEED", 10).service("AUGER", "2.1").service("JAM", "1.0"),
        device("SENS", 12).service("TEMP", "1.7"),
        board("BOARD1", "ACT", 14),
        device("FAN", 17),
    ];
    let after = [
        device("FEED", 10).service("AUGER", "2.2").service("MOTOR", "1.4"),
        device("SENS", 13).service("TEMP", "1.7"),
        board("BOARD2", "ACT", 14),
        device("PUMP", 44),
    ];
    folder.write("good.log", bus(before)).write("now.log", bus(after));
    assert_eq!(
        folder.rows("good.log", "now.log"),
        [
            json!(["services", 10, ["JAM 1.0"], ["MOTOR 1.4"]]),
            json!(["version", 10, ["AUGER 2.1"], ["AUGER 2.2"]]),
            json!(["address", 13, 12, 13]),
            json!(["boards", 14, ["BOARD1"], ["BOARD2"]]),
            json!(["presence", 17, "online", null]),
            json!(["presence", 44, null, "online"]),
        ]
    );
    let (code, table, _) = folder.diff(&["good.log", "file:now.log"]);
    insta::with_settings!({ prepend_module_to_snapshot => false }, {
        insta::assert_snapshot!("diff_of_two_logs", table);
    });
    assert_eq!(code, 1);
    assert_eq!(folder.rows("now.log", "now.log"), Vec::<Value>::new());
    let (code, table, _) = folder.diff(&["now.log", "now.log"]);
    assert!(code == 0 && table.ends_with("\nno difference\n"), "{table}");
}

#[test]
fn lost_device_and_other_mode_are_differences() {
    let folder = Folder::new();
    let scenario = |action: DeviceAction| {
        let devices = [device("FEED", 10), device("SENS", 12)];
        let scenario = devices.into_iter().fold(Scenario::new(125_000), Scenario::with);
        log(&scenario.at(Duration::from_secs(6), "FEED", action), 20)
    };
    let idle = DeviceAction::Mode(descan::wire::node::Mode::Cfg);
    folder.write("good.log", scenario(idle)).write("now.log", scenario(DeviceAction::PowerOff));
    let rows = folder.rows("good.log", "now.log");
    assert!(rows.contains(&json!(["presence", 10, "online", "lost"])), "{rows:?}");
    assert!(rows.contains(&json!(["mode", 10, "CFG", "WORK"])), "{rows:?}");
}

#[test]
fn log_equals_its_document_and_its_standard_input() {
    let folder = Folder::new();
    let two_boards = [board("BOARD1", "ACT", 14), board("BOARD2", "ACT", 14)];
    let lines = bus([device("FEED", 10).service("AUGER", "2.1")].into_iter().chain(two_boards));
    folder.write("now.log", &lines);
    let scan = folder.run(&["scan", "now.log", "--json"]).stdout;
    folder.write("now.json", &scan).write("marked.json", [b"\xEF\xBB\xBF", &scan[..]].concat());
    assert_eq!(folder.rows("now.log", "now.json"), Vec::<Value>::new());
    assert_eq!(folder.rows("marked.json", "now.log"), Vec::<Value>::new());
    for input in [&scan[..], lines.as_bytes(), &[b"\xEF\xBB\xBF", &scan[..]].concat()] {
        let mut child = folder.command(&["diff", "now.log", "-"]);
        let mut child = child.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        child.stdin.take().unwrap().write_all(input).unwrap();
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stdout));
    }
    let (code, _, error) = folder.diff(&["-", "-"]);
    assert!(code == 2 && error.contains("(-) can be read only once"), "{error}");
}

#[test]
fn only_buses_are_compared_whatever_their_names() {
    let folder = Folder::new();
    let lines = bus([device("FEED", 10)]);
    folder.write("one.log", &lines).write("other.log", lines.replace(" can0 ", " can1 "));
    let (code, table, _) = folder.diff(&["one.log", "other.log"]);
    assert_eq!(code, 0, "{table}");
    assert!(table.contains("can0 in BEFORE is compared with can1 in AFTER\n"), "{table}");
    // With two on one side, buses are paired by name.
    let mut both: Vec<String> = lines.lines().map(str::to_owned).collect();
    both.extend(lines.lines().map(|line| line.replace(" can0 ", " can2 ")));
    both.sort_by_key(|line| line.split(' ').next().map(str::to_owned));
    folder.write("both.log", both.join("\n") + "\n");
    let rows = folder.rows("one.log", "both.log");
    assert_eq!(rows, [json!(["presence", 10, null, "online"]), json!(["bus", null, null, "can2"])]);
}

#[test]
fn services_never_requested_are_not_a_difference() {
    let folder = Folder::new();
    let lines = bus([device("FEED", 10).service("AUGER", "2.1")]);
    // Without descan's requests and their responses: only heartbeats.
    let heard = lines.lines().filter(|line| line.contains(" 07"));
    folder.write("asked.log", &lines).write("heard.log", heard.collect::<Vec<_>>().join("\n"));
    let (code, table, _) = folder.diff(&["heard.log", "asked.log"]);
    assert_eq!(code, 0, "{table}");
    assert!(table.contains("\nservices of 1 device not known in BEFORE\n"), "{table}");
    assert!(table.contains("\nname of 1 device not known in BEFORE\n"), "{table}");
    let (code, table, _) = folder.diff(&["asked.log", "heard.log"]);
    assert!(code == 0 && table.contains("\nservices of 1 device not known in AFTER\n"), "{table}");
}

#[test]
fn unusable_files_are_named_with_cause_and_way_out() {
    let folder = Folder::new();
    folder.write("now.log", bus([device("FEED", 10)])).write("empty.log", "");
    folder.write("des.json", r#"{"devices":[{"name":"FEED","address":12}]}"#);
    folder.write("cut.json", "{\n \"descan\": \"0.1.0\", \"devices\": [ {\"address\": 12},");
    folder.write("wrong.json", "{\n \"descan\": \"0\",\n \"devices\": [{\"address\": \"x\"}]}");
    folder.write("deep.json", "[".repeat(100_000)).write("words.txt", "hello\nworld\n");
    for (name, said) in [
        ("none.log", "descan: none.log: file not found; name a log, or a document of"),
        (".", "cannot be read"),
        ("empty.log", "no frames in it; check the file name"),
        ("words.txt", "use candump, pcapng, ASC, BLF, TRC, CSV, SQLite or MF4"),
        ("des.json", "not a document of descan scan --json (no member \"descan\"); make one:"),
        ("cut.json", "cut.json: line 2, column"),
        ("wrong.json", "wrong.json: line 3, column"),
        ("deep.json", "deep.json: line 1, column"),
    ] {
        for sides in [[name, "now.log"], ["now.log", name]] {
            let (code, out, error) = folder.diff(&sides);
            assert_eq!((code, &*out), (3, ""), "{name}: {error}");
            assert!(error.contains(said), "{name}: {error}");
        }
    }
    let (code, _, error) = folder.diff(&["now.log"]);
    assert!(code == 2 && error.contains("<AFTER>"), "{error}");
}

#[test]
fn hostile_document_prints_no_control_codes() {
    let folder = Folder::new();
    let hostile = "\u{1b}[2J\u{202e}\n\u{7}\u{0}";
    let document = json!({ "descan": hostile, "devices": [
        { "bus": hostile, "address": 255, "name": hostile, "uid": hostile, "presence": hostile,
          "mode": hostile, "services": [ { "name": hostile, "version": hostile } ] },
        { "address": 3 }, { "address": 3 }, { "address": 3 },
    ], "findings": [ { "kind": hostile, "confidence": hostile, "address": 9 } ], "buses": null });
    folder.write("a.json", document.to_string());
    folder.write("b.json", r#"{"descan":1,"devices":[]}"#);
    for arguments in [&["a.json", "b.json"][..], &["b.json", "a.json", "--json"]] {
        let (code, out, error) = folder.diff(arguments);
        assert_eq!((code, &*error), (1, ""));
        assert!(!out.chars().any(|c| c != '\n' && !descan::text::is_printable(c)), "{out:?}");
        assert!(out.contains("[2J"), "{out}");
    }
    let same = folder.rows("a.json", "a.json");
    assert_eq!(same, Vec::<Value>::new());
    let many =
        format!(r#"{{"descan":1,"devices":[{}]}}"#, vec![r#"{"address":1}"#; 70_000].join(","));
    folder.write("many.json", many);
    let (code, _, error) = folder.diff(&["many.json", "b.json"]);
    assert!(code == 3 && error.contains("more than 65536 entries"), "{error}");
    folder.write("huge.json", [&b"{"[..], &vec![b' '; 17 << 20]].concat());
    let (code, _, error) = folder.diff(&["b.json", "huge.json"]);
    assert!(code == 3 && error.contains("larger than 16 MiB"), "{error}");
}

#[test]
fn damaged_documents_are_read_or_refused() {
    let folder = Folder::new();
    let lines = bus([device("FEED", 10).service("AUGER", "2.1"), device("SENS", 12)]);
    folder.write("now.log", &lines);
    let scan = folder.run(&["scan", "now.log", "--json"]).stdout;
    let whole = Inventory::parse(&scan).unwrap();
    assert_eq!(whole.devices.len(), 2);
    let mut read = 0;
    for seed in 0..4000 {
        let mut rng = fastrand::Rng::with_seed(seed);
        let mut bytes = scan.clone();
        for _ in 0..rng.usize(1..4) {
            let at = rng.usize(..bytes.len());
            match rng.u8(0..4) {
                0 => bytes[at] = rng.u8(..),
                1 => bytes.truncate(at.max(1)),
                2 => bytes[at] = b"\"[]{},:0-9e\\"[rng.usize(..12)],
                _ => drop(bytes.remove(at)),
            }
        }
        match Inventory::parse(&bytes) {
            Ok(damaged) => {
                read += 1;
                compare(&whole, &damaged);
                assert!(compare(&damaged, &damaged).differences.is_empty(), "seed {seed}");
            }
            Err(error) => {
                let error = error.to_string();
                assert!(error.chars().all(descan::text::is_printable), "seed {seed}: {error:?}");
            }
        }
    }
    assert!(read > 100, "{read}");
}

#[test]
fn document_of_an_older_version_is_read() {
    let folder = Folder::new();
    folder
        .write("old.json", r#"{"descan":"0","devices":[{"bus":"can0","address":12,"name":"A"}]}"#);
    let new = json!({ "descan": "9", "new": 1, "buses": [ { "name": "can0", "frames": 5 } ],
        "devices": [ { "bus": "can0", "address": 12, "name": "A", "presence": "online",
            "services_known": true, "services": [], "also": [], "more": {} } ],
        "file": { "ok": true } });
    folder.write("new.json", new.to_string());
    let (code, table, error) = folder.diff(&["old.json", "new.json"]);
    assert_eq!((code, &*error), (0, ""), "{table}");
    assert!(table.contains("\nservices of 1 device not known in BEFORE\n"), "{table}");
    assert!(table.contains("\ndes.json not known in BEFORE\n"), "{table}");
}

// ---- the comparison itself -----------------------------------------------------------------

/// A device of which everything is known.
fn known(name: &str, address: u8, uid: &str) -> InventoryDevice {
    InventoryDevice {
        bus: "can0".to_owned(),
        address,
        name: Some(name.to_owned()),
        uid: Some(uid.to_owned()),
        presence: Some("online".to_owned()),
        mode: Some("WORK".to_owned()),
        services: Some(vec![service("DES", "1.0")]),
        period_ms: Some(1000.0),
        entry: None,
    }
}

fn service(name: &str, version: &str) -> InventoryService {
    InventoryService { name: name.to_owned(), version: version.to_owned() }
}

fn inventory(devices: impl IntoIterator<Item = InventoryDevice>) -> Inventory {
    let devices = devices.into_iter().collect();
    Inventory { devices, is_file_known: true, ..Inventory::default() }.normalized()
}

fn lines(before: &Inventory, after: &Inventory) -> Vec<String> {
    let line = |it: &Difference| {
        let address = it.subject().and_then(|subject| subject.address);
        let address = address.map_or_else(String::new, |address| format!("{address} "));
        format!("{address}{}: {} → {}", it.what(), it.before, it.after)
    };
    compare(before, after).differences.iter().map(line).collect()
}

#[test]
fn each_value_of_a_device_is_compared() {
    let same = || known("FEED", 10, "B1");
    let entry = |address, is_static| Some(InventoryEntry { address, is_static });
    let changed: [(InventoryDevice, &str); 9] = [
        (
            InventoryDevice { presence: Some("stale".into()), ..same() },
            "10 presence: online → stale",
        ),
        (InventoryDevice { name: Some("PUMP".into()), ..same() }, "10 name: FEED → PUMP"),
        (InventoryDevice { uid: Some(String::new()), ..same() }, "10 UID: B1 → blank"),
        (InventoryDevice { uid: Some("B2".into()), ..same() }, "10 boards: B1 → B2"),
        (InventoryDevice { mode: Some("CFG".into()), ..same() }, "10 mode: WORK → CFG"),
        (InventoryDevice { services: Some(vec![]), ..same() }, "10 services: DES 1.0 → –"),
        (
            InventoryDevice { services: Some(vec![service("DES", "1.1")]), ..same() },
            "10 version: DES 1.0 → DES 1.1",
        ),
        (InventoryDevice { period_ms: Some(1201.0), ..same() }, "10 heartbeat: 1.00 s → 1.20 s"),
        (InventoryDevice { entry: entry(Some(10), true), ..same() }, "10 des.json: – → pinned 10"),
    ];
    for (device, expected) in changed {
        assert_eq!(lines(&inventory([same()]), &inventory([device])), [expected]);
    }
    let nearly = InventoryDevice { period_ms: Some(1200.0), ..same() };
    assert!(lines(&inventory([same()]), &inventory([nearly])).is_empty(), "a fifth is not more");
}

#[test]
fn moved_devices_are_followed_by_uid() {
    let before =
        inventory([known("SENS", 12, "X"), known("SENS", 13, "Y"), known("SENS", 14, "Z")]);
    let after = inventory([known("SENS", 13, "X"), known("SENS", 14, "Y"), known("SENS", 12, "Z")]);
    assert_eq!(
        lines(&before, &after),
        ["12 address: 14 → 12", "13 address: 12 → 13", "14 address: 13 → 14"]
    );
    // Without UIDs only a single one of a name can have moved.
    let blank = |address| known("SENS", address, "");
    let moved = lines(&inventory([12, 13].map(blank)), &inventory([12, 15].map(blank)));
    assert_eq!(moved, ["15 address: 13 → 15"]);
    let two = lines(&inventory([12, 13].map(blank)), &inventory([15, 16].map(blank)));
    assert_eq!(two.len(), 4, "{two:?}");
    // Known UIDs that differ are different boards.
    let other = lines(&inventory([known("SENS", 12, "X")]), &inventory([known("SENS", 15, "Y")]));
    assert_eq!(other, ["12 presence: online → –", "15 presence: – → online"]);
}

#[test]
fn three_devices_that_share_everything_are_paired() {
    let three = || vec![known("A", 12, "X"), known("A", 12, "X"), known("A", 12, "X")];
    assert!(lines(&inventory(three()), &inventory(three())).is_empty());
    let mut four = three();
    four.insert(1, known("A", 12, "X"));
    assert_eq!(lines(&inventory(three()), &inventory(four)), ["12 presence: – → online"]);
    let mut changed = three();
    changed[1].mode = Some("CFG".to_owned());
    assert_eq!(lines(&inventory(three()), &inventory(changed)), ["12 mode: WORK → CFG"]);
}

#[test]
fn conflict_lists_all_boards_of_the_address() {
    let conflict = |uids: &[&str]| InventoryFinding {
        kind: "same-name-same-address".to_owned(),
        confidence: "confirmed".to_owned(),
        bus: Some("can0".to_owned()),
        address: Some(14),
        addresses: vec![14],
        names: vec!["ACT".to_owned()],
        uids: uids.iter().map(|uid| (*uid).to_owned()).collect(),
        ..InventoryFinding::default()
    };
    let with = |uid: &str, finding: Option<InventoryFinding>| Inventory {
        findings: finding.into_iter().collect(),
        ..inventory([known("ACT", 14, uid)])
    };
    let (alone, both) = (with("X", None), with("Y", Some(conflict(&["X", "Y", "Z"]))));
    assert_eq!(
        lines(&alone, &both),
        ["14 boards: X → X, Y, Z", "14 same-name-same-address: – → confirmed"]
    );
    // Which board was heard last does not matter.
    assert!(lines(&both, &with("Z", Some(conflict(&["Z", "Y", "X"])))).is_empty());
    let over = InventoryFinding { confidence: "cleared".to_owned(), ..conflict(&["X", "Y"]) };
    assert!(lines(&alone, &with("X", Some(over.clone()))).is_empty(), "cleared is not there");
    let ended = lines(&both, &with("X", Some(over)));
    assert_eq!(ended[1], "14 same-name-same-address: confirmed → cleared");
}

#[test]
fn finding_about_the_file_needs_the_file_on_both_sides() {
    let missing = |name: &str| InventoryFinding {
        kind: "missing".to_owned(),
        confidence: "confirmed".to_owned(),
        bus: Some("can0".to_owned()),
        names: vec![name.to_owned()],
        ..InventoryFinding::default()
    };
    let with = |findings: Vec<InventoryFinding>, is_file_known| Inventory {
        findings,
        is_file_known,
        ..inventory([known("FEED", 10, "X")])
    };
    let (pump, fan) = (with(vec![missing("PUMP")], true), with(vec![missing("FAN")], true));
    assert_eq!(lines(&pump, &fan).len(), 2, "another device is missing");
    assert!(lines(&pump, &with(Vec::new(), false)).is_empty());
    let unknown = compare(&pump, &with(Vec::new(), false)).unknown;
    assert_eq!(unknown[0].text("AFTER"), "des.json not known in AFTER");
}

#[test]
fn values_of_a_bus_are_compared() {
    let with = |load: f64, errors: u64, frames: u64| {
        let text = json!({ "descan": "0", "devices": [], "buses": [ { "name": "can0", "load": load,
            "errors": errors, "lost": 0, "frames": frames, "bitrate": 125_000, "state": "unknown" } ] });
        Inventory::parse(text.to_string().as_bytes()).unwrap()
    };
    assert!(lines(&with(0.060, 0, 5), &with(0.069, 0, 99)).is_empty());
    assert_eq!(
        lines(&with(0.06, 0, 5), &with(0.08, 3, 0)),
        ["bus errors: 0 → 3", "bus frames: 5 → 0", "bus load: 6.0 % → 8.0 %",]
    );
}

/// An inventory with few different values, so that devices share names, addresses and UIDs.
fn random_inventory(rng: &mut fastrand::Rng) -> Inventory {
    let word = |rng: &mut fastrand::Rng, words: &[&str]| {
        let word = words[rng.usize(..words.len())];
        (word != "?").then(|| word.to_owned())
    };
    let devices = (0..rng.usize(..12)).map(|_| InventoryDevice {
        bus: word(rng, &["can0", "can1"]).unwrap(),
        address: rng.u8(1..5),
        name: word(rng, &["A", "B", "C", "?"]),
        uid: word(rng, &["X", "Y", "Z", "", "?"]),
        presence: word(rng, &["online", "lost", "stale"]),
        mode: word(rng, &["WORK", "CFG", "?"]),
        services: rng.bool().then(|| {
            (0..rng.usize(..3)).map(|_| service(["S", "T"][rng.usize(..2)], "1.0")).collect()
        }),
        period_ms: rng.bool().then(|| [1000.0, 1100.0, 1500.0][rng.usize(..3)]),
        entry: rng.bool().then(|| InventoryEntry { address: Some(2), is_static: rng.bool() }),
    });
    let devices: Vec<_> = devices.collect();
    let findings = (0..rng.usize(..6)).map(|_| {
        let address = Some(rng.u8(1..4)).filter(|address| *address > 1);
        InventoryFinding {
            kind: word(rng, &["same-name-same-address", "missing", "new-kind"]).unwrap(),
            confidence: word(rng, &["confirmed", "suspected", "cleared"]).unwrap(),
            bus: word(rng, &["can0", "can1", "?"]),
            address,
            addresses: address.into_iter().collect(),
            names: word(rng, &["A", "B", "?"]).into_iter().collect(),
            uids: vec!["X".to_owned(), "Y".to_owned()],
            ..InventoryFinding::default()
        }
    });
    let findings = findings.collect();
    Inventory { devices, findings, is_file_known: rng.bool(), ..Inventory::default() }.normalized()
}

#[test]
fn comparison_with_itself_is_empty_and_mirrors() {
    for seed in 0..3000 {
        let mut rng = fastrand::Rng::with_seed(seed);
        let (one, other) = (random_inventory(&mut rng), random_inventory(&mut rng));
        let same = compare(&one, &one);
        assert!(same.differences.is_empty() && same.unknown.is_empty(), "seed {seed}: {same:#?}");
        let mut shuffled = one.clone();
        rng.shuffle(&mut shuffled.devices);
        rng.shuffle(&mut shuffled.findings);
        let same = compare(&one, &shuffled);
        assert!(same.differences.is_empty(), "seed {seed}, another order: {same:#?}");
        let InventoryComparison { differences, .. } = compare(&one, &other);
        assert_eq!(differences, compare(&shuffled, &other).differences, "seed {seed}");
        let row = |it: &Difference| format!("{it:?}");
        let mirrored = compare(&other, &one).differences.into_iter().map(|it| Difference {
            subject_before: it.subject_after,
            subject_after: it.subject_before,
            before: it.after,
            after: it.before,
            ..it
        });
        let mut rows: Vec<String> = differences.iter().map(row).collect();
        let mut mirrored: Vec<String> = mirrored.map(|it| row(&it)).collect();
        rows.sort();
        mirrored.sort();
        assert_eq!(rows, mirrored, "seed {seed}");
    }
}

#[test]
fn kinds_have_different_names() {
    let mut names = DifferenceKind::ALL.map(DifferenceKind::name).to_vec();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), DifferenceKind::ALL.len());
    let guide = include_str!("../../src/guide/scripting.md");
    for name in names {
        assert!(guide.contains(&format!("`{name}`")), "{name}");
    }
}
