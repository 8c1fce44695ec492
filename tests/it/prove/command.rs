//! The command `descan prove`: JSON, reports, exit codes, and what it refuses.

use descan::prove::ConformanceRule;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// Heartbeats ten times as fast as the document says: the tests are over sooner.
const PROFILE: &str = "[services]\nheartbeat = 0x001\ndes = 0x002\n[heartbeat]\nperiod_ms = 100\n\
    uid_offset = 0\nmode_offset = 6\n";

const BUS: &str = r#"
bitrate = 1000000
[profile.heartbeat]
period_ms = 100
[[device]]
name = "FEED"
uid = "BOILER01"
address = { fixed = 10 }
settled = true
services = []
[[device]]
name = "ACT"
address = { fixed = 14 }
settled = true
services = []
faults = ["answers-twice"]
"#;

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bus.toml"), BUS).unwrap();
    std::fs::write(folder.path().join("profile.toml"), PROFILE).unwrap();
    folder
}

/// Runs it on the bus without a terminal.
fn prove(folder: &Path, rest: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(["prove", "sim:bus.toml", "--profile", "profile.toml"])
        .args(rest)
        .current_dir(folder)
        .env("XDG_CONFIG_HOME", folder.join("config"))
        .stdin(Stdio::null())
        .output()
        .expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// The members of an object that the guide describes in a table of its topic.
fn members(value: &Value) -> Vec<String> {
    value.as_object().unwrap().keys().cloned().collect()
}

#[test]
fn json_has_the_members_and_rules_of_the_guide() {
    let folder = folder();
    let output = prove(folder.path(), &["FEED", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let device = &json["devices"][0];
    assert_eq!((&json["bus"], &device["address"]), (&"sim:bus.toml".into(), &10.into()));
    assert_eq!((&device["name"], &device["uid"]), (&"FEED".into(), &"BOILER01".into()));
    let rules = device["rules"].as_array().unwrap();
    let ids: Vec<&str> = rules.iter().map(|it| it["rule"].as_str().unwrap()).collect();
    let all: Vec<&str> = ConformanceRule::ALL.iter().map(|rule| rule.id()).collect();
    assert_eq!(ids, all);
    assert!(json["kept"].as_u64() >= Some(18), "{}", json["kept"]);
    let guide = descan::guide::topic("conformance").unwrap().markdown();
    for value in [&json, device, &rules[0]] {
        for member in members(value) {
            assert!(guide.contains(&format!("`{member}`")), "{member} is not in the guide");
        }
    }
}

#[test]
fn broken_rule_exits_1_and_is_proved() {
    let folder = folder();
    let args = ["@14", "--report", "junit", "--proof", "act.md"];
    let output = prove(folder.path(), &args);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let xml = text(&output.stdout);
    assert!(xml.starts_with("<?xml") && xml.contains("failures=\"1\""), "{xml}");
    assert!(xml.contains("<testcase name=\"one-answer\" classname=\"ACT at 14\">"), "{xml}");
    let report = std::fs::read_to_string(folder.path().join("act.md")).unwrap();
    assert!(report.contains("### one-answer: broken"), "{report}");
    let frames = std::fs::read(folder.path().join("act.pcapng")).unwrap();
    let comment = b"broken: one-answer";
    assert!(frames.windows(comment.len()).any(|part| part == comment));
}

#[test]
fn unusable_calls_are_refused() {
    let folder = folder();
    let cases: [(&[&str], i32, &str); 6] = [
        (&["NOPE", "--time", "4"], 3, "NOPE was not found; there are FEED at 10, ACT at 14"),
        (&["FEED", "--listen-only"], 2, "listen-only"),
        (&["FEED", "--disrupt-device"], 2, "give --yes"),
        (&["FEED", "--load", "--yes"], 3, "1 other device on the bus"),
        (&["FEED", "--all"], 2, "--all"),
        (&[], 2, "<DEVICE>"),
    ];
    for (args, code, why) in cases {
        let output = prove(folder.path(), args);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains(why), "{args:?}: {}", text(&output.stderr));
    }
}

#[test]
fn check_prints_reports_of_tests() {
    let folder = folder();
    let entries = r#"{"devices":[{"name":"FEED","address":10},{"name":"GONE","address":99}]}"#;
    std::fs::write(folder.path().join("des.json"), entries).unwrap();
    let check = |format: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_descan"))
            .args(["check", "sim:bus.toml", "--profile", "profile.toml", "--time", "4"])
            .args(["--report", format])
            .current_dir(folder.path())
            .env("XDG_CONFIG_HOME", folder.path().join("config"))
            .stdin(Stdio::null())
            .output()
            .expect("the program starts");
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let tap = check("tap");
    assert!(tap.starts_with("TAP version 13\n1.."), "{tap}");
    assert!(tap.contains("- des.json: missing\n  ---\n  message: \"1 missing\""), "{tap}");
    assert_eq!(tap.matches("\nnot ok ").count(), 2, "{tap}");
    let github = check("github");
    assert!(github.contains("::error title=des.json%3A missing::1 missing%0AGONE"), "{github}");
    assert!(github.ends_with("2 failed, 0 skipped\n"), "{github}");
}
