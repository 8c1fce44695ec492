//! `descan speed` on the controllers of the virtual machine: it finds a bit rate and keeps it, and
//! restores the previous setting in all other cases.

use crate::common::can::{controllers, run};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::process::{Command, Output, Stdio};

fn speed(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
    command.arg("speed").args(arguments).stdin(Stdio::null()).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Returns the settings of can0, without values that change by themselves.
fn settings() -> Vec<String> {
    let shown = run("ip", &["-details", "link", "show", "can0"]);
    let words = shown.split_whitespace();
    let keep = words.filter(|word| !word.is_empty()).map(str::to_owned).collect::<Vec<_>>();
    let from = keep.iter().position(|word| word == "can").unwrap();
    // Whether it is up, modes, state, timing to the last segment.
    let up = keep[2].contains("UP");
    let mut kept = vec![format!("up: {up}")];
    kept.extend(keep[from..].iter().take(22).cloned());
    kept
}

fn set(arguments: &[&str]) {
    run("ip", &["link", "set", "can0", "down"]);
    run("ip", &[&["link", "set", "can0"], arguments].concat());
}

/// Restores the settings made by the virtual machine.
fn as_before() {
    set(&["up", "type", "can", "bitrate", "125000", "listen-only", "off"]);
}

/// Searches for the bit rate from `first` on while can1 sends.
fn found(first: &str) -> (Output, String) {
    let mut chatter = Command::new("cangen").args(["can1", "-g", "50"]).spawn().unwrap();
    let done = speed(&["can0", "--first", first, "--json"]);
    chatter.kill().unwrap();
    chatter.wait().unwrap();
    (done, settings().join(" "))
}

#[test]
fn rate_with_valid_frames_is_kept() {
    let Some(_taken) = controllers() else { return };
    as_before();
    let (done, after) = found("500000");
    let told: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!((told["bus"].as_str(), told["bitrate"].as_u64()), (Some("can0"), Some(500_000)));
    assert_eq!(done.status.code(), Some(0), "{}", text(&done.stderr));
    assert!(after.contains("bitrate 500000") && after.contains("up: true"), "{after}");
    assert!(!after.contains("LISTEN-ONLY"), "it takes part again: {after}");
    // A listen-only interface stays listen-only.
    set(&["up", "type", "can", "bitrate", "250000", "listen-only", "on"]);
    let (done, after) = found("1000000");
    assert_eq!(done.status.code(), Some(0), "{}", text(&done.stderr));
    assert!(after.contains("bitrate 1000000") && after.contains("LISTEN-ONLY"), "{after}");
    as_before();
}

#[test]
fn failed_search_restores_every_setting() {
    let Some(_taken) = controllers() else { return };
    let odd = ["type", "can", "bitrate", "250000", "sample-point", "0.750", "listen-only", "on"];
    for up in [true, false] {
        set(&odd);
        if up {
            run("ip", &["link", "set", "can0", "up"]);
        }
        let before = settings();
        let done = speed(&["can0"]);
        assert_eq!(done.status.code(), Some(1), "{}", text(&done.stderr));
        assert!(text(&done.stderr).contains("descan speed can0 --active"));
        assert_eq!(text(&done.stdout), "");
        assert_eq!(settings(), before);
    }
    as_before();
}

#[test]
fn interrupted_search_restores_the_settings() {
    let Some(_taken) = controllers() else { return };
    as_before();
    let before = settings();
    let mut search = Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(["speed", "can0", "--first", "500000"])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(search.stderr.take().unwrap()).lines();
    assert!(said.next().unwrap().unwrap().contains("500 kbit/s: listen-only"));
    run("kill", &["-INT", &search.id().to_string()]);
    assert_eq!(search.wait().unwrap().code(), Some(130));
    assert_eq!(settings(), before);
}

#[test]
fn search_without_root_names_the_command() {
    let Some(_taken) = controllers() else { return };
    let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
    let done = command.args(["speed", "can0"]).uid(65534).gid(65534).output().unwrap();
    let said = text(&done.stderr);
    assert_eq!(done.status.code(), Some(3), "{said}");
    assert!(said.contains("sudo descan speed can0"), "{said}");
    assert!(said.contains("sudo ip link set can0 up type can bitrate 125000 listen-only on"));
    assert_eq!(said.lines().count(), 1, "{said}");
}
