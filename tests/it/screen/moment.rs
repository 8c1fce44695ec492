//! The shown moment: page rule, first line and time bar, live, frozen and of a log.

use super::comparison::boiler;
use super::snapshot;
use crate::common::harness::Stage;
use descan::app::Page;
use descan::discovery::Config;
use descan::sim::Scenario;
use descan::status::Playback;
use ratatui::style::Color;

/// Sizes at which the first line is tested.
const SIZES: [(u16, u16); 5] = [(40, 10), (60, 14), (80, 24), (120, 36), (200, 45)];

/// The page rule of the screen.
fn rule(stage: &Stage) -> String {
    let row = usize::from(stage.app.screen().tabs.y);
    stage.screen().lines().nth(row).unwrap_or_default().to_owned()
}

fn first_line(stage: &Stage) -> String {
    stage.screen().lines().next().unwrap_or_default().to_owned()
}

/// True if a row has the background of a past moment in all cells but those of `except`.
fn is_frozen_row(stage: &Stage, row: u16, except: usize) -> bool {
    let buffer = stage.buffer("dark");
    let other = (0..stage.size.0).filter(|&x| buffer[(x, row)].bg != Color::Rgb(0xe5, 0xc0, 0x7b));
    other.count() <= except
}

#[test]
fn page_rule_ends_with_the_moment_at_every_size_and_page() {
    let mut stage = boiler();
    stage.until(40.0);
    for (columns, rows) in SIZES {
        stage.size(columns, rows);
        for key in ["1", "2", "3", "4", "5"] {
            let rule = rule(stage.keys(key));
            let rest = rule.trim_end_matches([' ', '─']);
            assert!(rest.ends_with(" 12:00:40 LIVE"), "{columns} {key}: {rule}");
        }
        stage.keys("1 Space");
        let rule = rule(&stage);
        // At 80 the first line has the time, and the rule the view.
        let end = if columns == 80 { " list (v) ─ FROZEN" } else { " 12:00:40 FROZEN" };
        assert!(rule.trim_end_matches([' ', '─']).ends_with(end), "{rule}");
        stage.keys("Space");
    }
    snapshot!("moment_200x45", stage.size(200, 45));
}

#[test]
fn first_line_of_a_past_moment_names_it_at_every_size_and_page() {
    let mut stage = boiler();
    stage.until(40.0).keys("[ [ [").until(41.0).keys("M Enter");
    assert!(stage.app.past_moment().is_some());
    for (columns, rows) in SIZES {
        stage.size(columns, rows);
        for key in ["1", "2", "3", "4", "5", "?", "Esc d", "Esc '"] {
            let line = first_line(stage.keys(key));
            assert!(line.starts_with(" FROZEN 12:00:"), "{columns} {key}: {line}");
            assert!(line.contains(" ago"), "{columns} {key}: {line}");
            assert!(is_frozen_row(&stage, 0, 0), "{columns} {key}");
        }
        stage.keys("Esc 1");
        let screen = stage.app.screen();
        assert!(is_frozen_row(&stage, screen.tabs.y, 12), "but the name of the page");
        if screen.time_bar.height > 0 {
            assert!(is_frozen_row(&stage, screen.time_bar.y, 0), "{columns}");
        }
    }
    snapshot!("frozen_80x24", stage.size(80, 24));
    snapshot!("frozen_40x10", stage.size(40, 10));
    let line = first_line(stage.size(120, 36));
    assert!(line.contains(" · 1") && line.contains(" ago · LIVE with Space  now ⚠ 14: "), "{line}");
    stage.keys("Esc");
    assert!(stage.app.past_moment().is_none());
}

#[test]
fn past_moment_at_80_columns_names_the_view_and_the_keys() {
    let mut stage = boiler();
    stage.until(40.0).keys("[ [").size(80, 24);
    for keys in ["1", "2", "3", "4", "5"] {
        let is_frozen = stage.keys(keys).app.past_moment().is_some();
        let first = rule(&stage);
        for _ in 0..3 {
            let line = rule(stage.keys("v"));
            assert!(is_frozen && line.contains(" FROZEN"), "{line}");
            let view = line.split("5 Bus").nth(1).unwrap().replace(['─', ' '], "");
            assert!(view.ends_with("FROZEN") && view.len() > "FROZEN".len(), "{keys}: {line}");
            let footer = stage.screen().lines().last().unwrap().to_owned();
            for key in ["? help", "← → ", "[ ] event", "{ } problem", "g time"] {
                assert!(footer.contains(key), "{keys}: {footer}");
            }
            assert!(keys == "4" || footer.contains("d diff  < > frame"), "{keys}: {footer}");
            assert_eq!(footer.contains("X proof"), keys == "4", "{footer}");
            if line == first {
                break;
            }
        }
    }
    // What is chosen stands in the place of the views.
    let line = rule(stage.keys("2 v v /").text("src:feed").keys("Enter"));
    assert!(line.contains(" /src:feed ") && line.contains(" FROZEN"), "{line}");
}

#[test]
fn escape_shows_the_present_before_the_filter_goes_off() {
    let mut stage = boiler();
    stage.until(30.0).keys("/").text("feed").keys("Enter Space Esc");
    assert!(stage.app.past_moment().is_none());
    assert!(stage.app.page_filter(Page::Devices).active().is_some());
    stage.keys("Esc");
    assert!(stage.app.page_filter(Page::Devices).active().is_none());
}

#[test]
fn finding_of_the_file_is_a_moment_between_others() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    // Only the comparison with des.json finds what is missing.
    let missing = |entry: &&descan::app::StoryStep| {
        entry.entry.finding == Some(descan::finding::FindingKind::Missing)
    };
    let steps = || stage.app.stories().iter().flat_map(descan::app::Story::steps);
    let times: Vec<_> = steps().filter(missing).map(|step| step.entry.time).collect();
    assert!(!times.is_empty());
    let mut seen = Vec::new();
    for _ in 0..steps().count() {
        stage.keys("{");
        seen.extend(stage.app.past_moment().map(|moment| moment.time));
    }
    assert!(times.iter().all(|time| seen.contains(time)), "{times:?} {seen:?}");
}

#[test]
fn quiet_bus_shows_no_clock_that_stands() {
    let empty = Scenario::parse("bitrate = 125000").unwrap();
    let config = Config { send_requests: false, listen_only: true, ..Config::default() };
    let mut stage = Stage::with(&empty, None, config);
    stage.until(30.0).screen();
    assert!(rule(&stage).contains("─ LIVE"), "{}", rule(&stage));
    // Nothing is due that only moves a clock.
    stage.app.take_dirty();
    stage.until(300.0);
    assert!(!stage.app.is_dirty());
}

#[test]
fn moment_of_a_log_has_its_place_and_pace() {
    let mut stage = boiler();
    stage.until(40.0).size(120, 36);
    let play = |stage: &mut Stage, is_paused: bool, speed: f64| {
        let playback = Playback { speed, is_paused, is_ended: false, ..Playback::default() };
        stage.app.handle_playback(stage.app.now(), playback);
    };
    play(&mut stage, false, 2.0);
    assert!(rule(&stage).contains("12:00:40 PLAY ×2"), "{}", rule(&stage));
    let footer = stage.screen().lines().last().unwrap().to_owned();
    let keys = " Space pause  ? help  ( ) pace  < > frame  [ ] event  { } problem  g time";
    assert!(footer.starts_with(keys), "{footer}");
    play(&mut stage, true, 2.0);
    assert!(rule(&stage).contains("12:00:40 PAUSED"), "{}", rule(&stage));
    stage.keys(":").text("12:00:20").keys("Enter").until(41.0);
    let line = first_line(&stage);
    assert!(line.starts_with(" FROZEN 12:00:20.000 · log 0:20 of 0:41"), "{line}");
    assert!(line.contains(" · Space plays  "), "{line}");
}

#[test]
fn footer_of_a_past_moment_has_the_keys_along_time() {
    let mut stage = boiler();
    stage.until(40.0).size(120, 36).keys("Space");
    let footer = |stage: &Stage| stage.screen().lines().last().unwrap().to_owned();
    // The message about freezing stands there first.
    stage.until(50.0);
    let keys = " Space live  ? help  ← → 0.6 s  Shift 5.6 s  < > frame  [ ] event  { } problem";
    assert!(footer(&stage).starts_with(keys), "{}", footer(&stage));
    assert!(footer(&stage).contains("g time  M mark  d diff"), "{}", footer(&stage));
    stage.size(40, 10);
    assert!(footer(&stage).starts_with(" Space live  ? help  < > frame"), "{}", footer(&stage));
}
