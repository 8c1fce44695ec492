//! `--record-filter`, from outside: which frames are in the file, the messages, mistakes.

use crate::common::program::command;
use std::fs;
use std::path::Path;
use std::process::Output;

/// Heartbeats of 14 and 20; a gap of 0.4 s in those of 20; the name of 20, FEED, at the end.
const LOG: &str = "\
(100.000000) can0 071C0001#8A
(100.100000) can0 07280001#8A
(100.200000) can0 07280001#8A
(100.300000) can0 071C0001#8B
(100.600000) can0 07280001#8A
(100.700000) can0 05280002#0601464545440000
(100.800000) can0 07280001#8A
";

fn descan(arguments: &[&str], folder: &Path) -> Output {
    command(arguments, folder).output().expect("the program starts")
}

fn words(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Records frames of [`LOG`] that match. Returns what was recorded and standard error.
fn recorded(filter: &str) -> (String, String) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.log"), LOG).unwrap();
    let arguments = ["watch", "file:a.log", "--record", "b.log", "--record-filter", filter];
    let output = descan(&arguments, folder.path());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let text = fs::read_to_string(folder.path().join("b.log")).unwrap_or_default();
    // candump writes ten digits of seconds.
    (text.replace("(0000000", "("), words(&output))
}

fn lines(wanted: impl Fn(&str) -> bool) -> String {
    LOG.lines().filter(|line| wanted(line)).flat_map(|line| [line, "\n"]).collect()
}

#[test]
fn recording_contains_only_matching_frames() {
    let (text, words) = recorded("at:14");
    assert_eq!(text, lines(|line| line.contains(" 071C")));
    assert!(words.contains("recorded b.log: 2 of 7 frames, "), "{words}");
    let (text, words) = recorded("not at:14 data:\"46 45\" or data:8B");
    assert_eq!(text, lines(|line| line.contains("4645") || line.ends_with("8B")));
    assert!(words.contains("2 of 7 frames"), "{words}");
}

#[test]
fn record_filter_compares_intervals_with_frames_left_out() {
    let (text, _) = recorded("dt:>350ms at:20");
    assert_eq!(text, lines(|line| line.contains("100.600000")));
}

#[test]
fn record_filter_without_match_writes_no_file() {
    let (text, words) = recorded("type:std");
    assert_eq!(text, "");
    assert!(words.contains("b.log: none of 7 frames matches, no file written"), "{words}");
}

#[test]
fn mistake_in_record_filter_is_reported_before_recording() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.log"), LOG).unwrap();
    for command in ["scan", "watch", "check"] {
        let arguments =
            [command, "file:a.log", "--record", "b.log", "--record-filter", "at:14 sorce:FEED"];
        let output = descan(&arguments, folder.path());
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        let words = words(&output);
        assert!(words.contains("--record-filter") && words.contains("src:"), "{words}");
        assert!(words.contains("column 7"), "{words}");
        assert!(!folder.path().join("b.log").exists());
    }
    let arguments = ["scan", "file:a.log", "--record-filter", "at:14"];
    let output = descan(&arguments, folder.path());
    assert_eq!(output.status.code(), Some(2), "only with --record: {output:?}");
}

#[test]
fn live_recording_selects_frames_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let arguments =
        ["watch", "sim:boiler", "--time", "3", "--record", "b.log", "--record-filter", "src:FEED"];
    let output = descan(&arguments, folder.path());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let text = fs::read_to_string(folder.path().join("b.log")).unwrap();
    let ids = text.lines().map(|line| {
        let frame = line.split(' ').nth(2).unwrap();
        u32::from_str_radix(frame.split_once('#').unwrap().0, 16).unwrap()
    });
    // FEED is at address 10.
    let sources: Vec<u32> = ids.map(|id| id >> 17 & 0x7F).collect();
    assert!(!sources.is_empty() && sources.iter().all(|source| *source == 10), "{text}");
    assert!(words(&output).contains(" of "), "{output:?}");
}
