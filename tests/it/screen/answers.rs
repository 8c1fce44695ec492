//! Answers to keys name their cause, and columns, details and messages agree with each other.

use super::{one_line, problems};
use crate::common::harness::{BOILER, Stage};
use descan::app::{Overlay, Page, RowState};
use descan::discovery::Config;
use descan::sim::{DeviceSpec, Scenario};
use descan::status::{Link, Playback};
use descan::time::Duration;
use descan::wire::id::Address;

fn selected(stage: &Stage) -> String {
    let row = stage.app.selected_row().expect("a row is selected");
    row.name.as_ref().map_or("?".to_owned(), ToString::to_string)
}

fn message(stage: &Stage) -> String {
    stage.app.message().map(|message| message.text.clone()).unwrap_or_default()
}

/// PSU at 30, and LOW at 5 from second 8 on.
fn late_low() -> Scenario {
    Scenario::new(125_000)
        .with(DeviceSpec::new("PSU").fixed(30).settled())
        .with(DeviceSpec::new("LOW").fixed(5).settled().power_on(Duration::from_secs(8)))
}

#[test]
fn selection_that_was_shown_stays_on_its_device() {
    let mut stage = Stage::new(&late_low(), Some("[]"));
    stage.until(6.0);
    assert_eq!(selected(&stage), "PSU");
    assert_eq!(selected(stage.until(12.0)), "PSU", "{}", stage.screen());
    assert_eq!(stage.app.rows().len(), 2);
    stage.keys("e").text("31").keys("Enter");
    assert!(stage.file().contains("PSU") && !stage.file().contains("LOW"), "{}", stage.file());
}

#[test]
fn entries_on_a_bus_that_was_never_up_stay_pending() {
    let mut stage = Stage::new(&Scenario::new(125_000), Some(BOILER));
    stage.link(Link::Missing).wait_until(30.0).keys("n").text("VALVE 99").keys("Enter");
    stage.wait_until(60.0);
    assert_eq!(stage.app.rows().len(), 6);
    let is_pending = |state| state == RowState::Pending;
    assert!(stage.app.rows().iter().all(|row| is_pending(row.state)), "{}", stage.screen());
    assert_eq!(problems(&stage), [""; 0]);
    let row = one_line(stage.screen().lines().find(|line| line.contains("PUMP")).unwrap());
    assert!(row.contains("… 44"), "a pinned entry is distinguished from others: {row}");
}

#[test]
fn pending_entries_become_missing_without_an_input() {
    let config = Config { seed: 7, listen_only: true, ..Config::default() };
    let mut stage = Stage::with(&Scenario::new(125_000), Some(BOILER), config);
    stage.wait_until(10.0);
    assert_eq!(stage.app.counts().missing, 5, "{}", stage.screen());
}

#[test]
fn reboot_with_new_services_keeps_the_difference_from_the_file() {
    let mut stage = Stage::boiler();
    stage.until(75.0).size(120, 40);
    let screen = stage.screen();
    let line = |name: &str| {
        let has = |line: &&str| line.contains(name) && line.contains("was");
        one_line(screen.lines().find(has).unwrap_or_else(|| panic!("{screen}")))
    };
    assert!(line("AUGER").contains("AUGER 2.2 ✗ 2.1 was 2.1"), "{screen}");
    assert!(line("JAM").contains("JAM 1.1 + new was 1.0"), "{screen}");
}

#[test]
fn response_time_counts_from_the_request_that_was_answered() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    for device in stage.app.buses()[0].devices() {
        // Request and response take 1.5 ms on the bus.
        let took = device.name_query.took.map(|took| took.as_micros());
        let is_possible = took.is_some_and(|took| (1500..200_000).contains(&took));
        assert!(is_possible, "{} {took:?}", device.name.as_ref().unwrap());
    }
    let screen = stage.keys("j j j j j j j j Enter G").screen();
    assert!(!screen.lines().any(|line| line.trim_end().ends_with("ms") && line.len() < 60));
}

#[test]
fn added_device_never_duplicates_an_entry_of_another_bus() {
    let file = r#"{ "devices": [ { "name": "DIN", "address": 16, "bus": "can7" } ] }"#;
    for key in ["a", "A"] {
        let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(file));
        stage.until(20.0).keys("/").text("DIN").keys("Enter").keys(key);
        let document = stage.app.file().document();
        let buses: Vec<_> = document
            .entries()
            .iter()
            .filter(|entry| entry.name == b"DIN")
            .map(|entry| entry.bus.as_deref())
            .collect();
        assert_eq!(buses, [Some("can7"), Some("can0")]);
        assert_eq!(document.findings().len(), 0, "{}", stage.file());
    }
}

#[test]
fn rescan_names_what_prevents_requests() {
    let boiler = Scenario::builtin("boiler").unwrap();
    let rescan = |config: Config| {
        let mut stage = Stage::with(&boiler, None, Config { seed: 7, ..config });
        message(stage.until(8.0).keys("r"))
    };
    let none = Config::default;
    assert_eq!(rescan(none()), "enumeration restarted");
    assert_eq!(
        rescan(Config { address: Address::new(12), ..none() }),
        "another node uses address 12: requests paused until it is free"
    );
    assert_eq!(rescan(Config { scan: false, ..none() }), "--no-scan: no requests are sent");
    assert_eq!(rescan(Config { listen_only: true, ..none() }), "listen-only: no requests are sent");
    let mut stage = Stage::boiler();
    stage.until(8.0).link(Link::Down).keys("r");
    assert_eq!(message(&stage), "can0 is down");
}

#[test]
fn keys_of_a_log_and_of_a_live_bus_name_the_other() {
    let mut stage = Stage::boiler();
    stage.until(8.0);
    for (key, answer) in [
        ("P", "only a log can be paused"),
        (">", "only a log can be stepped"),
        ("[", "only a log has a speed"),
        ("]", "only a log has a speed"),
    ] {
        assert_eq!(message(stage.keys(key)), answer);
    }
    let config = Config { seed: 7, listen_only: true, ..Config::default() };
    let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), None, config);
    stage.until(8.0);
    let playback = Playback { speed: 1.0, is_paused: false, is_ended: false };
    stage.app.handle_playback(stage.app.now(), playback);
    for key in ["r", "i"] {
        assert_eq!(message(stage.keys(key)), "a log: nothing is sent", "{key}");
    }
}

#[test]
fn timeline_line_without_frames_says_so() {
    let mut stage = Stage::new(&Scenario::new(125_000), Some(BOILER));
    stage.link(Link::Missing).wait_until(5.0).keys("3 g Enter");
    assert_eq!(message(&stage), "no frames captured yet");
    let mut stage = Stage::boiler();
    stage.until(8.0).keys("3 g Enter");
    assert_eq!(message(&stage), "no frames captured before this line");
}

#[test]
fn conflict_resolved_for_the_file_does_not_report_edits() {
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("70").keys("Enter");
    stage.file = Some(BOILER.replace("10", "11").into_bytes());
    stage.refuse_saves().notice().keys("t");
    let lines: Vec<_> = stage.app.timeline().entries().map(|line| line.text.clone()).collect();
    assert!(lines.iter().any(|line| line.contains("kept the file's value")), "{lines:?}");
    assert!(!lines.iter().any(|line| line.contains("reapplied")), "{lines:?}");
}

#[test]
fn frozen_view_neither_edits_nor_sends() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("D n Space");
    for (second, key) in ["e", "a", "A", "n", "R", "D", "u", "Ctrl-r", "r", "i"].iter().enumerate()
    {
        stage.until(26.0 + 2.0 * second as f64).keys(key);
        assert_eq!(message(&stage), "frozen; Space unfreezes", "{key}");
        assert!(matches!(stage.app.overlay(), Overlay::None), "{key}");
    }
    assert_eq!(stage.file(), BOILER);
    stage.keys("Space e");
    assert!(stage.app.prompt().is_some());
    assert_eq!(stage.app.view().page, Page::Devices);
}
