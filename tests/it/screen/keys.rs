//! Answers to keys name their cause, and columns, details and messages agree with each other.

use super::{one_line, problems};
use crate::common::harness::{BOILER, Stage};
use descan::app::{Effect, Overlay, Page, RowState};
use descan::diagnostic::Diagnostic;
use descan::discovery::Config;
use descan::frame::BusIndex;
use descan::sim::{DeviceSpec, Scenario};
use descan::status::{BusStatus, Link, Playback};
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
    Scenario::new(125_000).with(DeviceSpec::new("PSU").fixed(30).skips_address_resolution()).with(
        DeviceSpec::new("LOW").fixed(5).skips_address_resolution().power_on(Duration::from_secs(8)),
    )
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
    let words = one_line(&screen);
    let heading = words.find("now was file").expect(&screen);
    for row in ["AUGER 2.2 2.1 2.1 ≠", "JAM 1.1 1.0 – ≠"] {
        assert!(words[heading..].contains(row), "{row}\n{screen}");
    }
}

#[test]
fn response_time_counts_from_the_request_that_was_answered() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    for device in stage.app.buses()[0].devices() {
        // Request and response take 1.5 ms on the bus.
        let took = device.name_query.response_time.map(|took| took.as_micros());
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
    assert_eq!(
        rescan(Config { send_requests: false, ..none() }),
        "--no-scan: no requests are sent"
    );
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
        ("P", "plan: needs a profile with writes.address: no number is known for sure"),
        (">", "only a log can be stepped"),
        (")", "live: Space freezes; then a moment can be played"),
    ] {
        assert_eq!(message(stage.keys(key)), answer);
    }
    let config = Config { seed: 7, listen_only: true, ..Config::default() };
    let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), None, config);
    stage.until(8.0);
    let playback =
        Playback { speed: 1.0, is_paused: false, is_ended: false, ..Playback::default() };
    stage.app.handle_playback(stage.app.now(), playback);
    for key in ["r", "i"] {
        assert_eq!(message(stage.keys(key)), "a log: nothing is sent", "{key}");
    }
}

#[test]
fn key_without_use_names_the_help() {
    let mut stage = Stage::boiler();
    stage.until(3.0);
    for page in ["1", "2", "3", "4", "5"] {
        stage.keys(page).keys("Q");
        assert_eq!(message(&stage), "Q has no use here; ? lists the keys");
    }
    stage.keys("1 M Q");
    assert_ne!(message(&stage), "Q has no use here; ? lists the keys", "it is a letter of a mark");
}

#[test]
fn filter_is_named_on_a_narrow_screen() {
    let mut stage = Stage::boiler();
    stage.until(3.0).size(40, 10).keys("/").text("name:psu").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("/name:psu") && screen.contains("LIVE"), "{screen}");
}

#[test]
fn frames_of_an_identifier_lead_back_to_it() {
    let mut stage = Stage::boiler();
    stage.until(10.0).keys("2 v Right Backspace");
    assert!(stage.app.view().shows_identifiers(), "{}", stage.screen());
    stage.keys("/").text("name:psu").keys("Enter J K");
    assert!(stage.app.view().shows_identifiers(), "{}", stage.screen());
}

#[test]
fn steps_of_the_lowest_line_come_into_view() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(80, 24).keys("3 End");
    let steps = |screen: String| screen.lines().filter(|line| line.contains('│')).count();
    let before = steps(stage.screen());
    assert!(steps(stage.keys("o").screen()) > before, "{}", stage.screen());
}

#[test]
fn timeline_line_without_frames_says_so() {
    let mut stage = Stage::new(&Scenario::new(125_000), Some(BOILER));
    stage.link(Link::Missing).wait_until(5.0).keys("3 Home f");
    assert_eq!(message(&stage), "no frames captured yet");
    let mut stage = Stage::boiler();
    stage.until(8.0).keys("3 Home f");
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
    for (second, key) in
        ["e", "a", "A", "n", "R", "D", "u", "Ctrl-r", "r", "i", "c", "b"].iter().enumerate()
    {
        stage.until(26.0 + 2.0 * second as f64).keys(key);
        assert_eq!(message(&stage), "frozen: Space shows the present first", "{key}");
        assert!(matches!(stage.app.overlay(), Overlay::None), "{key}");
    }
    assert_eq!(stage.file(), BOILER);
    stage.keys("Space e");
    assert!(stage.app.prompt().is_some());
    assert_eq!(stage.app.view().page, Page::Devices);
}

#[test]
fn captured_frames_are_saved_in_the_format_of_the_ending() {
    let saved = |name: &str| {
        let mut stage = Stage::boiler();
        stage.until(8.0).keys("w Ctrl-u").text(name).keys("Enter");
        let bytes = stage.effects.into_iter().find_map(|effect| match effect {
            Effect::WriteLog { log, .. } => {
                let mut bytes = Vec::new();
                log.write_to(&mut bytes).unwrap();
                Some(bytes)
            }
            _ => None,
        });
        bytes.unwrap_or_default()
    };
    assert!(saved("x.log").starts_with(b"("));
    assert!(saved("x.pcapng").starts_with(&[0x0A, 0x0D, 0x0D, 0x0A]));
    assert!(saved("x.zip").is_empty());
}

#[test]
fn broken_log_is_explained_where_its_devices_would_be() {
    let mut stage = Stage::new(&Scenario::new(125_000), None);
    let why = "0 frames; 10 lines cannot be read, the first is line 1: not a line of candump -L";
    let status =
        BusStatus { link: Link::Ended, fault: Some(Diagnostic::new(why)), ..BusStatus::default() };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    for (columns, rows) in [(80, 24), (40, 16)] {
        for page in ["1", "4"] {
            let screen = stage.size(columns, rows).keys(page).screen();
            let list = screen.lines().skip(3).map(|line| line.split('│').next().unwrap());
            let list = one_line(&list.collect::<Vec<_>>().join(" "));
            assert!(list.contains(why), "{screen}");
        }
    }
}

#[test]
fn tick_never_stands_beside_a_difference() {
    let file = r#"[
  { "name": "FEED", "address": 10, "static": true, "services": [ { "name": "DES" } ] },
  { "name": "SENS", "address": 12, "static": true, "bus": 7 },
  { "name": "PUMP", "address": 200, "static": true }
]"#;
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(file));
    stage.until(24.0);
    let screen = stage.screen();
    for line in screen.lines().filter(|line| line.contains(['≠', '!'])) {
        assert!(!line.contains('✓'), "{screen}");
    }
    assert!(screen.contains("≠ 4 svc"), "{screen}");
    let screen = stage.size(120, 40).keys("Home j").screen();
    assert!(!screen.contains("matches") && screen.contains("services differ"), "{screen}");
}

#[test]
fn invalid_value_is_named_once_in_the_details() {
    let file = r#"[ { "name": "PSU", "address": 31 }, { "name": "PSU", "address": 130 } ]"#;
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(file));
    stage.until(24.0).size(120, 40).keys("G");
    for _ in 0..12 {
        let screen = one_line(&stage.screen());
        assert!(screen.matches("is 130").count() <= 1, "{screen}");
        stage.keys("k");
    }
}

#[test]
fn failed_save_names_the_file_and_the_key_of_a_copy() {
    let mut stage = Stage::boiler();
    stage.refusal = Some("belongs to another user".to_owned());
    stage.until(24.0).keys("e").text("70").keys("Enter");
    let expected = "des.json not saved: belongs to another user; save a copy with W";
    assert_eq!(message(&stage), expected);
    let lines: Vec<_> = stage.app.timeline().entries().map(|line| line.text.clone()).collect();
    assert!(lines.iter().any(|line| line.starts_with("not saved: belongs to")), "{lines:?}");
}

#[test]
fn edits_are_named_with_the_words_of_their_keys() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    assert_eq!(message(stage.keys("e Ctrl-u Enter")), "entry FEED unpinned (was 10)");
    assert_eq!(message(stage.keys("u")), "undone: entry FEED unpinned (was 10)");
    assert_eq!(message(stage.keys("Ctrl-r")), "redone: entry FEED unpinned (was 10)");
    assert_eq!(message(stage.keys("D y")), "entry FEED at 10 deleted");
    assert!(stage.size(120, 40).screen().contains("own 0"), "{}", stage.screen());
    let mut stage = Stage::new(&Scenario::new(125_000), Some(r#"[ { "name": "PUMP" } ]"#));
    stage.until(8.0).keys("4");
    let screen = stage.screen();
    assert!(
        !screen.lines().any(|line| line.contains("bus") && line.contains("missing")),
        "{screen}"
    );
}

#[test]
fn cleared_problem_is_told_in_the_past() {
    let mut stage = Stage::boiler();
    stage.until(130.0).keys("4 G").size(130, 60);
    let screen = stage.screen();
    let row = screen.lines().find(|line| line.starts_with("▸✓")).expect(&screen);
    assert!(row.contains(" 12:00:26."), "{row}");
    assert!(screen.contains("✓ cleared 12:00:55, 1m14s ago"), "{screen}");
    assert!(screen.contains(" was: Two devices answer as ACT"), "{screen}");
}

#[test]
fn requests_in_both_framings_and_slow_rates_are_told_apart() {
    let mut slow = DeviceSpec::new("SLOW").fixed(30).skips_address_resolution();
    slow.heartbeat = Some(Duration::from_secs(4));
    let mut stage = Stage::new(&Scenario::new(125_000).with(slow), None);
    stage.until(30.0).size(120, 40).keys("2");
    let screen = stage.keys("Home").screen();
    let requests: Vec<_> = screen.lines().filter(|line| line.contains("name request")).collect();
    let is_raw =
        |line: &&&str| line.contains("name request, raw") && line.contains(" 44 45 53 01 ");
    assert!(requests.iter().any(|line| line.contains("04 44 45 53 01") && !line.contains("raw")));
    assert!(requests.iter().any(|line| is_raw(&line)), "{screen}");
    let screen = stage.keys("v").screen();
    let row = screen.lines().find(|line| line.contains("SLOW→all")).expect(&screen);
    assert!(one_line(row).contains(" 0.2 ") || one_line(row).contains(" 0.3 "), "{screen}");
}

#[test]
fn ctrl_c_quits_at_once_from_every_overlay() {
    let conflict = |stage: &mut Stage| {
        stage.file = Some(BOILER.replace("10", "11").into_bytes());
        stage.keys("e").text("47").keys("Enter");
        stage.until(40.0);
        assert!(matches!(stage.app.overlay(), Overlay::Conflict));
    };
    let help = |stage: &mut Stage| {
        stage.keys("?");
        assert!(matches!(stage.app.overlay(), Overlay::Help(_)));
    };
    let question = |stage: &mut Stage| {
        stage.keys("D");
        assert!(matches!(stage.app.overlay(), Overlay::Question(_)));
    };
    for open in [&conflict as &dyn Fn(&mut Stage), &help, &question] {
        let mut stage = Stage::boiler();
        open(stage.until(24.0));
        stage.keys("Ctrl-c");
        assert!(stage.effects.contains(&Effect::Quit), "{}", stage.screen());
    }
}
