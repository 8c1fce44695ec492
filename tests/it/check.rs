//! `descan check`, from outside: comparison of bus and des.json, output, and exit codes.

use crate::common::inspection::log;
use descan::sim::{DeviceAction, DeviceSpec, Fault, Scenario};
use descan::time::Duration;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// FEED at 12 and SENS at 13.
fn bus() -> Scenario {
    Scenario::new(125_000)
        .with(DeviceSpec::new("FEED").fixed(12).skips_address_resolution().service("AUGER", "2.1"))
        .with(DeviceSpec::new("SENS").fixed(13).skips_address_resolution().service("TEMP", "1.7"))
}

const AGREES: &str = r#"{ "devices": [
  { "name": "FEED", "address": 12, "static": true, "services": [
    { "name": "DES", "version": "1.0" }, { "name": "AUGER", "version": "2.1" } ] },
  { "name": "SENS", "address": 13, "static": true }
] }"#;

struct Folder(tempfile::TempDir);

impl Folder {
    fn with(scenario: &Scenario, file: Option<&str>) -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        folder.write("session.log", &log(scenario, 12));
        if let Some(file) = file {
            folder.write("des.json", file);
        }
        folder
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path().join(name), text).unwrap();
    }

    fn check(&self, arguments: &[&str]) -> Output {
        self.descan(&[&["check"], arguments].concat())
    }

    fn descan(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_descan"))
            .args(arguments)
            .current_dir(self.path())
            .env("XDG_CONFIG_HOME", self.path().join("config"))
            .stdin(Stdio::null())
            .output()
            .expect("the program starts")
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("output is UTF-8")
}

/// Returns exit code and standard output for this file against [`bus`].
fn checked(file: &str) -> (i32, String) {
    let output = Folder::with(&bus(), Some(file)).check(&["file:session.log"]);
    assert_eq!(text(&output.stderr), "");
    (output.status.code().unwrap(), text(&output.stdout))
}

/// Returns kind and address of each counted finding, as in the JSON.
fn kinds(file: &str) -> Vec<(String, Option<u64>)> {
    let output = Folder::with(&bus(), Some(file)).check(&["file:session.log", "--json"]);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let findings = report["findings"].as_array().unwrap().iter();
    let findings: Vec<_> = findings
        .map(|it| (it["kind"].as_str().unwrap().to_owned(), it["address"].as_u64()))
        .collect();
    assert_eq!(output.status.code(), Some(i32::from(!findings.is_empty())), "{report:#}");
    findings
}

#[test]
fn matching_file_is_one_line_and_exit_0() {
    let (code, said) = checked(AGREES);
    assert_eq!(said, "des.json: 2 entries, 2 devices on can0: no difference\n");
    assert_eq!(code, 0);
    assert_eq!(kinds(AGREES), []);
}

#[test]
fn each_difference_is_one_line_in_its_group() {
    let (code, said) = checked(
        r#"{ "devices": [
          { "name": "FEED", "address": 16, "static": true, "services": [
            { "name": "DES", "version": "1.0" }, { "name": "AUGER", "version": "2.0" },
            { "name": "JAM", "version": "1.0" } ] },
          { "name": "PUMP", "address": 44, "static": true },
          { "name": "FAN", "address": 13, "static": true }
        ] }"#,
    );
    assert_eq!(
        said,
        "\
missing:
  FAN (at 13) is listed but not on the bus: SENS uses its address 13.
  PUMP (at 44) is listed but not on the bus: in this log no frame received from address 44.
wrong address:
  FEED is at address 12; the file pins it to 16.
static address taken:
  Static address 13 of FAN is used by a device named SENS.
not in file:
  SENS at 13 is not in the file.
services differ:
  FEED at 12: services differ from the file: AUGER is 2.1, not 2.0; JAM is missing.
des.json: 3 entries, 2 devices on can0: 2 missing, 1 wrong address, 1 static address taken, \
1 not in file, 1 service list differs
"
    );
    assert_eq!(code, 1);
}

#[test]
fn name_other_than_listed_is_a_difference() {
    let mut feed = DeviceSpec::new("FEED").fixed(12).skips_address_resolution();
    feed.uid = descan::wire::node::Uid([0x8A, 0xFA, 0x6C, 0x97, 0x24, 0x11]);
    let scenario = Scenario::new(125_000).with(feed);
    for (name, found) in [("FEED", false), ("FEEX", true)] {
        let file = format!(r#"[{{"name":"{name}","address":12,"uid":"BOILER01"}}]"#);
        let output = Folder::with(&scenario, Some(&file)).check(&["file:session.log"]);
        let said = text(&output.stdout);
        let line = "name differs:\n  FEEX at 12 reports the name FEED (matched by UID).\n";
        assert_eq!(
            (said.contains(line), output.status.code()),
            (found, Some(found.into())),
            "{said}"
        );
    }
}

#[test]
fn log_compared_with_its_own_start_shows_what_came_later() {
    let scenario = bus().with(DeviceSpec::new("PUMP").fixed(44).power_on(Duration::from_secs(20)));
    let folder = Folder::with(&scenario, None);
    folder.write("session.log", &log(&scenario, 40));
    let scan =
        folder.descan(&["scan", "file:session.log", "--time", "12", "--write", "start.json"]);
    assert!(scan.status.success(), "{}", text(&scan.stderr));
    assert_eq!(text(&scan.stderr), "start.json: 2 devices written\n");
    let check = |options: &[&str]| {
        let arguments = [&["file:session.log", "--file", "start.json"], options].concat();
        let output = folder.check(&arguments);
        (output.status.code(), text(&output.stdout))
    };
    let (code, said) = check(&[]);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("PUMP at 44 is not in the file"), "{said}");
    let (code, said) = check(&["--time", "12"]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("no difference"), "{said}");
}

#[test]
fn devices_left_out_of_a_new_file_are_listed() {
    let scenario = bus()
        .with(DeviceSpec::new("PUMP").fixed(44))
        .with(DeviceSpec::new("MUTE").fixed(45).fault(Fault::NoDes))
        .at(Duration::from_secs(8), "PUMP", DeviceAction::PowerOff);
    let folder = Folder::with(&scenario, None);
    folder.write("session.log", &log(&scenario, 40));
    let scan = folder.descan(&["scan", "file:session.log", "--write", "new.json"]);
    assert_eq!(
        text(&scan.stderr),
        "new.json: 2 devices written; left out: @44 (lost), @45 (no name received)\n"
    );
}

/// Tests that services in object form have no order: JSON writers may sort members.
#[test]
fn service_order_counts_in_list_form_only() {
    let file = |services: &str| {
        format!(
            r#"[{{"name":"FEED","address":12,"services":{services}}},{{"name":"SENS","address":13}}]"#
        )
    };
    let none: Vec<(String, Option<u64>)> = Vec::new();
    assert_eq!(kinds(&file(r#"{"AUGER":"2.1","DES":"1.0"}"#)), none);
    assert_eq!(kinds(&file(r#"{"DES":"1.0","AUGER":null}"#)), none);
    let list = r#"[{"name":"AUGER","version":"2.1"},{"name":"DES","version":"1.0"}]"#;
    for other in [list, r#"{"AUGER":"2.1","DES":"1.1"}"#, r#"{"AUGER":"2.1"}"#] {
        assert_eq!(kinds(&file(other)), [("services-differ".to_owned(), Some(12))], "{other}");
    }
}

#[test]
fn unnamed_device_is_one_difference() {
    let mut scenario = Scenario::new(125_000);
    for (name, address) in [("FEED", 12), ("SENS", 13)] {
        let device = DeviceSpec::new(name).fixed(address).skips_address_resolution();
        scenario = scenario.with(device.fault(Fault::NoDes));
    }
    let file = r#"[{ "name": "FEED", "address": 12 }]"#;
    let output = Folder::with(&scenario, Some(file)).check(&["file:session.log"]);
    let said = text(&output.stdout);
    assert!(
        said.contains("FEED (at 12) is listed but not on the bus: a heartbeat at 12"),
        "{said}"
    );
    assert!(!said.contains("at 12 is not in the file"), "{said}");
    assert!(said.contains("An unnamed device at 13 is not in the file."), "{said}");
}

#[test]
fn finding_kinds_in_json_are_stable() {
    let kind = |kind: &str, address: u64| (kind.to_owned(), Some(address));
    let feed = r#"{ "name": "FEED", "address": 12, "static": true }"#;
    let sens = r#"{ "name": "SENS", "address": 13 }"#;
    let file = |entries: &[&str]| format!("{{ \"devices\": [ {} ] }}", entries.join(", "));
    assert_eq!(kinds(&file(&[feed])), [kind("unlisted", 13)]);
    assert_eq!(kinds(&file(&[feed, sens])), []);
    // Not static: any address is allowed.
    assert_eq!(kinds(&file(&[feed, r#"{ "name": "SENS", "address": 99 }"#])), []);
    let pump = r#"{ "name": "PUMP", "address": 44, "static": true }"#;
    assert_eq!(kinds(&file(&[feed, sens, pump])), [kind("missing", 44)]);
    let listed = r#"{ "name": "SENS", "services": [ { "name": "DES", "version": "1.0" } ] }"#;
    assert_eq!(kinds(&file(&[feed, listed])), [kind("services-differ", 13)]);
    // An empty list means the same as a missing one.
    for none in ["[]", "{}", "null"] {
        let none = format!(r#"{{ "name": "SENS", "services": {none} }}"#);
        assert_eq!(kinds(&file(&[feed, &none])), []);
    }
    // The duplicate entry is not missing, and its address is not in use by another device.
    assert_eq!(kinds(&file(&[feed, sens, sens])), [kind("file-duplicate-entry", 13)]);
    // A device listed at two addresses is at one of them.
    let other = r#"{ "name": "SENS", "address": 15, "static": true }"#;
    assert_eq!(kinds(&file(&[feed, sens, other])), [kind("missing", 15)]);
}

#[test]
fn address_conflict_is_a_difference() {
    // Slow enough not to destroy each other's responses.
    let stubborn = |name: &str, millis: u64| {
        let mut device =
            DeviceSpec::new(name).fixed(14).skips_address_resolution().fault(Fault::KeepsAddress);
        device.response_delay = (Duration::from_millis(millis), Duration::from_millis(millis));
        device
    };
    let scenario = Scenario::new(125_000).with(stubborn("ACT", 1)).with(stubborn("FAN", 9));
    let file = r#"[ { "name": "ACT", "address": 14, "static": true } ]"#;
    let folder = Folder::with(&scenario, Some(file));
    let output = folder.check(&["file:session.log"]);
    let said = text(&output.stdout);
    assert!(said.starts_with("conflicts:\n  Two devices"), "{said}");
    assert_eq!(output.status.code(), Some(1));
}

#[test]
fn unreadable_file_is_unusable() {
    let folder = Folder::with(&bus(), None);
    let missing = folder.check(&["file:session.log"]);
    assert_eq!(missing.status.code(), Some(3));
    assert!(text(&missing.stderr).contains("des.json: file not found"));
    folder.write("des.json", "{ \"devices\": [\n  { \"name\": \"FEED\" \"address\": 12 }\n] }");
    for arguments in [&["file:session.log"][..], &["file:session.log", "--json"]] {
        let broken = folder.check(arguments);
        assert_eq!(broken.status.code(), Some(3));
        let said = text(&broken.stderr);
        let (line, excerpt) = said.split_once('\n').unwrap();
        assert!(line.ends_with("des.json: line 2, column 20: expected `,` or `}`"), "{said}");
        assert_eq!(
            excerpt,
            "      { \"name\": \"FEED\" \"address\": 12 }\n                       ^\n"
        );
        assert_eq!(text(&broken.stdout), "");
    }
}

#[test]
fn line_gate_waits_for_all_listed_devices() {
    let folder = Folder::with(&bus(), Some(AGREES));
    folder.write(
        "line.toml",
        r#"
bitrate = 125000
[[device]]
name = "FEED"
settled = true
address = { fixed = 12 }
services = [["DES", "1.0"], ["AUGER", "2.1"]]
[[device]]
name = "SENS"
address = { fixed = 13 }
power_on = 7.0
"#,
    );
    let soon = folder.check(&["sim:line.toml"]);
    assert_eq!(soon.status.code(), Some(1), "{}", text(&soon.stdout));
    assert!(text(&soon.stdout).contains("SENS (at 13) is listed but not on the bus"));
    let waited = folder.check(&["sim:line.toml", "--wait-for-all", "--time", "30"]);
    assert_eq!(waited.status.code(), Some(0), "{}", text(&waited.stdout));
    // A device that never appears is missing when the time is up.
    folder.write("des.json", r#"[ { "name": "PUMP", "address": 44 } ]"#);
    let never = folder.check(&["sim:line.toml", "--wait-for-all", "--time", "4"]);
    assert_eq!(never.status.code(), Some(1), "{}", text(&never.stdout));
}

#[test]
fn invisible_name_is_quoted() {
    let (_, said) = checked(
        r#"[{"name":"","address":12,"static":true},
            {"name":" ","address":44,"static":true},{"name":"FAN","address":44,"static":true}]"#,
    );
    for line in [
        "  \"\" (at 12) is listed but not on the bus: FEED uses its address 12.",
        "  Static address 12 of \"\" is used by a device named FEED.",
        "entries: \" \" (line 2) and FAN (line 2)",
    ] {
        assert!(said.contains(line), "{line}: {said}");
    }
}

/// Tests invalid files: one message, at once, and the file stays unchanged.
#[test]
fn invalid_file_content_is_reported_with_its_line() {
    let deep = format!("{{\"devices\": {}{}}}", "[".repeat(10_000), "]".repeat(10_000));
    for (file, said) in [
        (&deep[..], "line 1, column 140: nested deeper than 128 levels"),
        ("[{\"name\":\"A\",\"address\":012}]", "line 1, column 25: a number must not begin with 0"),
        ("[{\"name\":\"A\",\"address\":1.}]", "line 1, column 26: invalid number"),
        ("[{\"name\":\"\x1b[2J\"}]", "line 1, column 11: a control character"),
        ("{\"devices\":[]}\0", "line 1, column 15: text after the end"),
    ] {
        let folder = Folder::with(&bus(), Some(file));
        let output = folder.check(&["file:session.log"]);
        assert_eq!(output.status.code(), Some(3), "{file:.80}");
        let stderr = text(&output.stderr);
        assert!(stderr.contains(said), "{stderr}");
        let is_plain = |c: char| c == '\n' || !c.is_control();
        assert!(stderr.chars().all(is_plain) && stderr.len() < 1000, "{stderr:?}");
        let now = std::fs::read_to_string(folder.path().join("des.json")).unwrap();
        assert_eq!(now, file);
    }
}

/// Tests that a file too long for des.json is rejected without reading a gigabyte.
#[test]
fn file_of_one_gigabyte_is_rejected_at_once() {
    let folder = Folder::with(&bus(), Some("["));
    let file = std::fs::File::options().write(true).open(folder.path().join("des.json")).unwrap();
    file.set_len(1 << 30).unwrap();
    let output = folder.check(&["file:session.log"]);
    assert_eq!(output.status.code(), Some(3));
    let stderr = text(&output.stderr);
    assert_eq!(stderr, "descan: des.json: larger than 16 MiB; check the file name\n");
}

#[test]
fn duplicate_member_is_reported_and_last_one_counts() {
    let file = r#"[{"name":"FEED","address":12,"static":true,"services":{"DES":"1.0","AUGER":"2.1"}},
      {"name":"SENS","address":99,"static":true,"address":13}]"#;
    let (code, said) = checked(file);
    assert_eq!(
        said,
        "file errors:\n  SENS: duplicate `address`; the last one is used (line 2, column 49)\n\
         des.json: 2 entries, 2 devices on can0: 1 file error\n"
    );
    assert_eq!(code, 1);
}

#[test]
fn invalid_value_is_a_difference_with_its_line() {
    let (code, text) = checked(r#"[{"name":"A","address":1e2}]"#);
    assert_eq!(code, 1, "{text}");
    let place = "`address` is 1e2; write it in plain digits: 100 (line 1, column 24)";
    assert!(text.contains(place), "{text}");
    let found = kinds(r#"[{"name":"A","address":1e2}]"#);
    assert!(found.iter().any(|(kind, _)| kind == "file-shape"), "{found:?}");
}

#[test]
fn unusable_uid_is_a_difference_with_what_is_right() {
    let remedy = [
        ("", "`uid` is empty; write the UID, or leave `uid` out"),
        (" ", "`uid` is empty"),
        ("boiler01", "has `b`, which is not in the UID alphabet; write it in capitals: BOILER01"),
        ("BOILER012", "`uid` has 9 characters; it must have 1 to 8"),
        ("8af2e964", "write it in capitals: 8AF2E964"),
        ("8af2e9b2c411", "`uid` is in hexadecimal; write it as text: "),
        ("A\\u001bB", "has `\\x1B`, which is not in the UID alphabet; it must be of these"),
    ];
    for (uid, said) in remedy {
        let file = format!("[{{\"name\":\"FEED\"}},\n {{\"name\":\"SENS\",\"uid\":\"{uid}\"}}]");
        let (code, text) = checked(&file);
        assert_eq!(code, 1, "{uid}: {text}");
        assert!(text.contains(said), "{uid}: {text}");
        assert!(text.contains("(line 2, column 23)"), "{uid}: {text}");
        assert_eq!(kinds(&file), [("file-shape".to_owned(), None)], "{uid}");
    }
    assert_eq!(kinds(r#"[{"name":"FEED","uid":"BOILER01"},{"name":"SENS","uid":"S 1"}]"#), []);
    // An entry of a bus that is not open cannot be judged.
    let other = r#"[{"name":"FEED"},{"name":"SENS"},{"name":"X","bus":"can7","uid":"x"}]"#;
    assert!(kinds(other).iter().all(|(kind, _)| kind != "file-shape"));
}

/// Tests that an empty log, as from a failed recorder, does not pass the check.
#[test]
fn log_without_frames_is_unusable() {
    for log in ["", "\n"] {
        let folder = Folder::with(&bus(), Some(r#"[{"name":"FEED","address":10}]"#));
        std::fs::write(folder.path().join("session.log"), log).unwrap();
        let output = folder.check(&["file:session.log"]);
        assert_eq!(output.status.code(), Some(3), "{log:?}");
        let stderr = text(&output.stderr);
        assert!(stderr.contains("file:session.log: no frames in it"), "{stderr}");
        assert_eq!(text(&output.stdout), "");
    }
}

#[test]
fn log_without_frames_of_devices_says_what_it_has() {
    let folder = Folder::with(&bus(), Some(r#"[{ "name": "FEED", "address": 12 }]"#));
    for (frame, reason) in [
        ("20000040#0000000000000000", "no frame in this log: its controller is bus-off"),
        ("20000088#0000040A00000000", "no frame but error frames in this log"),
    ] {
        folder.write("session.log", &format!("(1436509052.100000) can0 {frame}\n"));
        let output = folder.check(&["file:session.log"]);
        let said = text(&output.stdout);
        let told = format!("FEED (at 12) is listed but not on the bus: {reason}.");
        assert!(said.contains(&told), "{said}");
    }
}

#[test]
fn conflict_that_does_not_count_is_a_warning() {
    let folder = Folder::with(&bus(), Some("[]"));
    let beat = |millis: u64, number: u64, last: u8| {
        let (second, part) = (1_436_509_052 + millis / 1000, millis % 1000);
        let id = 0x0718_0001 | (number.wrapping_mul(0x9E37_79B1) >> 8 & 127) << 10;
        format!("({second}.{part:03}000) can0 {id:08X}#8AFA6C97241{last:X}0400\n")
    };
    // The second board: equal random numbers, or other ones and gone after 15 s.
    let equal = |n: u64| [beat(n * 1000, n, 1), beat(n * 1000 + 300, n, 1)].concat();
    let gone = |n: u64| {
        let other = if n < 15 { beat(n * 1000 + 300, n + 50, 2) } else { String::new() };
        beat(n * 1000, n, 1) + &other
    };
    for (log, words) in [
        (
            (0..30).map(equal).collect::<String>(),
            "suspected: Frames from address 12 arrive twice, ",
        ),
        ((0..40).map(gone).collect(), "over: Two devices "),
    ] {
        folder.write("session.log", &log);
        let output = folder.check(&["file:session.log"]);
        let stderr = text(&output.stderr);
        assert!(stderr.contains(words), "{stderr}");
        assert!(!text(&output.stdout).contains("address conflict"), "{}", text(&output.stdout));
    }
}
