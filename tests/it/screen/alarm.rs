//! The line of a confirmed conflict, on all pages and in dialogs.

use super::comparison::boiler;
use super::{one_line, snapshot, styles_of};
use crate::common::harness::Stage;
use descan::app::Page;

/// The boiler after its conflict at address 14 is confirmed.
fn with_conflict() -> Stage {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    assert!(stage.app.alarm().is_some());
    stage
}

/// The line with the alarm; empty without one.
fn alarm_line(stage: &Stage) -> String {
    let row = usize::from(stage.app.screen().alarm.y);
    if stage.app.screen().alarm.height == 0 {
        return String::new();
    }
    stage.screen().lines().nth(row).unwrap_or_default().to_owned()
}

/// True if the whole line of the alarm has the background of its role.
fn is_filled(stage: &Stage) -> bool {
    let (buffer, area) = (stage.buffer("dark"), stage.app.screen().alarm);
    let cells = (area.left()..area.right()).map(|x| buffer[(x, area.y)].bg);
    let mut colours: Vec<_> = cells.collect();
    colours.dedup();
    colours == [ratatui::style::Color::Rgb(0xf0, 0x71, 0x78)]
}

#[test]
fn confirmed_conflict_is_announced_on_all_pages_and_dialogs() {
    let mut stage = with_conflict();
    for (columns, rows) in [(80, 24), (120, 36), (200, 45)] {
        stage.size(columns, rows);
        for keys in ["1", "2", "3", "4", "5", "?", "Esc d", "Esc M Enter '", "Esc 1 e", "Esc F"] {
            let line = alarm_line(stage.keys(keys));
            let text = "⚠ Address 14: SPARE01 joined 12:00:26, conflicts with BOILER03";
            assert!(line.starts_with(&format!(" {text}")), "{keys} {columns}: {line}");
            assert!(is_filled(&stage), "{keys}");
        }
        stage.keys("Esc Esc Esc");
    }
    snapshot!("alarm_80x24", stage.size(80, 24).keys("1"));
    snapshot!("alarm_40x10", stage.size(40, 10));
}

#[test]
fn short_alarm_is_shown_on_narrow_and_low_screens() {
    let mut stage = with_conflict();
    let line = alarm_line(stage.size(40, 10));
    assert_eq!(line, " ⚠ 14: SPARE01 / BOILER03");
    assert!(stage.screen().starts_with(" can0 "), "{}", stage.screen());
    // In the place of the status, with its counts.
    assert_eq!(alarm_line(stage.size(40, 8)), " ⚠ 14: SPARE01 / BOILER03     ●10 ○1 ⚠4");
    stage.keys("Space");
    assert!(stage.screen().contains("FROZEN 12:00:45"), "{}", stage.screen());
    assert!(alarm_line(&stage).starts_with(" ⚠ 14: SPARE01 / BOILER03"), "{}", stage.screen());
}

#[test]
fn suspected_conflict_is_no_alarm() {
    let mut stage = Stage::boiler();
    let mut seconds = 20.0;
    while stage.app.counts().suspected == 0 || stage.app.alarm().is_some() {
        seconds += 0.1;
        assert!(seconds < 60.0 && stage.until(seconds).app.alarm().is_none());
    }
    assert_eq!(alarm_line(&stage), "");
    assert!(!stage.app.terminal_title().contains('⚠'));
}

#[test]
fn mute_key_of_any_page_ends_the_alarm() {
    for page in ["1", "2", "3", "5"] {
        let mut stage = with_conflict();
        stage.keys(page).keys("m");
        assert_eq!(alarm_line(&stage), "", "{page}");
        assert!(one_line(&stage.screen()).contains("muted until descan quits"), "{page}");
        stage.keys("m");
        assert!(one_line(&stage.screen()).contains("no alarm"), "{}", stage.screen());
        // On Problems the same key brings it back.
        stage.keys("4 G m");
        assert!(!alarm_line(&stage).is_empty(), "{}", stage.screen());
    }
}

#[test]
fn alarm_whose_problem_was_opened_stays_unfilled() {
    let mut stage = with_conflict();
    assert!(is_filled(&stage));
    // The first row has no problem of its own: the key goes to that of the alarm.
    stage.keys("G p");
    assert_eq!(stage.app.view().page, Page::Problems);
    let problem = stage.app.alarm().map(|alarm| alarm.problem.clone());
    assert_eq!(stage.app.selected_problem().map(|it| it.key), problem);
    let (line, is_still_filled) = (alarm_line(&stage), is_filled(&stage));
    assert!(line.contains("SPARE01") && !is_still_filled, "{line}");
    stage.until(50.0).keys("1");
    assert!(!is_filled(&stage) && !alarm_line(&stage).is_empty());
}

#[test]
fn past_moment_has_its_own_alarm_and_names_the_present_one() {
    let mut stage = boiler();
    stage.size(120, 36).until(45.0).keys(":").text("12:00:20").keys("Enter").until(45.5);
    assert_eq!(alarm_line(&stage), "");
    let screen = stage.screen();
    let first = screen.lines().next().unwrap();
    assert!(first.contains("now ⚠ 14: SPARE01 / BOILER03"), "{first}");
    stage.keys(":").text("12:00:44").keys("Enter").until(46.0);
    assert!(alarm_line(&stage).contains("SPARE01"));
    assert!(!stage.screen().lines().next().unwrap().contains("now ⚠"));
}

#[test]
fn conflict_confirmed_while_frozen_is_announced() {
    let mut stage = Stage::boiler();
    stage.until(20.0).keys("Space");
    let mut seconds = 20.0;
    while stage.app.present_alarm().is_none() {
        seconds += 0.5;
        assert!(seconds < 60.0);
        stage.until(seconds);
    }
    let message = stage.app.message().map(|it| it.text.clone()).unwrap_or_default();
    assert_eq!(message, "conflict now: 14: SPARE01 / BOILER03; Space shows the present");
    assert_eq!(alarm_line(&stage), "", "the past has none");
    assert_eq!(stage.app.terminal_title(), "⚠ 14: SPARE01 / BOILER03 – descan can0");
}

#[test]
fn alarm_is_readable_without_colour() {
    let mut stage = with_conflict();
    let text = styles_of(&stage.size(80, 24).buffer("mono"));
    let row = text.lines().position(|line| line.contains("⚠ Address 14")).unwrap();
    let styles = text.lines().nth(row + 1).unwrap();
    assert!(styles.contains("BOLD | REVERSED"), "{styles}");
}
