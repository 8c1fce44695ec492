//! `descan prove` on devices that keep the rules: nothing is broken, and what can be seen is kept.

use super::{KitDevice, NodeLanguage, PATIENCE, Vcan, descan, folder};
use crate::common::pty::Pty;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// What a working device does not show, though all tests are made: vcan has no arbitration and no
/// errors, but no rule needs them.
const UNSEEN_OF_WORKING: [(&str, &str); 1] = [(
    "no-requests-unless-working",
    "it is observed while it works; while it is in CFG by command, descan moves it",
)];

/// What a device in CFG does not show to the tests that do not disturb it.
const UNSEEN_OF_CONFIGURING: [(&str, &str); 9] = [
    ("uid-set-in-work", "it does not work"),
    ("gives-way-configuring", "--disrupt-device"),
    ("gives-way-working", "--disrupt-device"),
    ("keeps-address-working", "--disrupt-device"),
    ("resolves-anew", "--disrupt-device"),
    ("mode-changes", "--disrupt-device"),
    ("answers-under-load", "--load"),
    ("heartbeat-under-load", "--load"),
    ("stable-over-reboot", "--reboot"),
];

/// Waits until descan has found a device in a mode.
fn wait_for_mode(folder: &Path, bus: &str, mode: &str) {
    let start = Instant::now();
    loop {
        let output = descan(folder, &["scan", bus, "--json", "--time", "10"]);
        let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        let devices = report["devices"].as_array().cloned().unwrap_or_default();
        if devices.iter().any(|it| it["name"] == "FEED" && it["mode"] == mode) {
            return;
        }
        assert!(start.elapsed() < 2 * PATIENCE, "{report:#}");
    }
}

/// Asserts that all rules are kept but these, which are not seen.
fn check(verdicts: &BTreeMap<String, String>, unseen: &[(&str, &str)]) {
    assert_eq!(verdicts.len(), descan::prove::ConformanceRule::ALL.len(), "{verdicts:#?}");
    for (rule, verdict) in verdicts {
        let is_listed = unseen.iter().any(|(id, _)| id == rule);
        let wanted = if is_listed { "not seen" } else { "kept" };
        assert!(verdict.starts_with(wanted), "{rule}: {verdicts:#?}");
    }
}

/// The verdict and its text of each rule in JSON.
fn verdicts_of(json: &Value) -> BTreeMap<String, String> {
    let rules = json["devices"][0]["rules"].as_array().unwrap();
    let verdict = |rule: &Value| {
        let word = rule["verdict"].as_str().unwrap().replace('-', " ");
        (rule["rule"].as_str().unwrap().to_owned(), format!("{word} {}", rule["text"]))
    };
    rules.iter().map(verdict).collect()
}

fn device_in_cfg_keeps_the_rules(language: NodeLanguage, bus: &str) {
    let Some(vcan) = Vcan::new(bus) else { return };
    let folder = folder();
    let _feed = KitDevice::new(language, folder.path(), "FEED", false).start(vcan.name(), &[]);
    wait_for_mode(folder.path(), vcan.name(), "CFG");
    let output = descan(folder.path(), &["prove", vcan.name(), "FEED", "--json"]);
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{error}");
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    check(&verdicts_of(&json), &UNSEEN_OF_CONFIGURING);
}

/// Waits for a text on the terminal, for as long as something happens there.
fn wait_long(terminal: &mut Pty, text: &str) {
    while !terminal.screen().contains(text) {
        let before = terminal.screen();
        terminal.wait_until("change", |screen| screen.contents() != before);
    }
}

/// The verdict and its text of each rule on a terminal.
fn verdicts_on(screen: &str) -> BTreeMap<String, String> {
    let verdict = |line: &str| {
        let (word, rest) = line.split_at_checked(12)?;
        let word = word.trim();
        let (rule, text) = rest.split_once(' ')?;
        let is_verdict = ["kept", "broken", "not seen"].contains(&word);
        is_verdict.then(|| (rule.to_owned(), format!("{word} {}", text.trim())))
    };
    screen.lines().filter_map(verdict).collect()
}

/// All tests, with the power switch: the process is ended and started again.
fn working_device_keeps_all_rules(language: NodeLanguage, bus: &str) {
    let Some(vcan) = Vcan::new(bus) else { return };
    let folder = folder();
    let device = KitDevice::new(language, folder.path(), "FEED", true);
    let feed = device.start(vcan.name(), &[]);
    wait_for_mode(folder.path(), vcan.name(), "WORK");
    let switches = ["--disrupt-device", "--load", "--reboot", "--yes"];
    let words = [&["prove", vcan.name(), "FEED", "--profile", "profile.toml"], &switches[..]];
    let mut terminal = Pty::start(&words.concat(), folder.path(), (200, 100));
    wait_long(&mut terminal, "switch the device");
    drop(feed);
    wait_long(&mut terminal, "on again");
    let _feed = device.start(vcan.name(), &[]);
    let code = terminal.wait();
    let screen = terminal.screen();
    assert_eq!(code, 0, "{screen}");
    check(&verdicts_on(&screen), &UNSEEN_OF_WORKING);
}

#[test]
fn proved_kit_device_in_cfg_keeps_the_rules() {
    device_in_cfg_keeps_the_rules(NodeLanguage::C, "dsp-kit-cfg");
}

#[test]
fn proved_node_in_cfg_keeps_the_rules() {
    device_in_cfg_keeps_the_rules(NodeLanguage::Rust, "dsp-node-cfg");
}

#[test]
fn proved_kit_device_keeps_all_rules() {
    working_device_keeps_all_rules(NodeLanguage::C, "dsp-kit-work");
}

#[test]
fn proved_node_keeps_all_rules() {
    working_device_keeps_all_rules(NodeLanguage::Rust, "dsp-node-work");
}
