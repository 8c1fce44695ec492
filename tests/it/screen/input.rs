//! Keys, mouse, filters and prompts.

use super::one_line;
use super::snapshot;
use crate::common::harness::{BOILER, Stage};
use descan::app::{Effect, Mouse, MouseKind, Page};
use descan::discovery::Config;
use descan::sim::Scenario;

#[test]
fn prompt_is_shown_whole_if_it_fits() {
    let mut stage = Stage::boiler();
    stage.until(3.0).keys("w");
    assert!(stage.screen().contains("save frames to: descan-20261121-"), "{}", stage.screen());
}

#[test]
fn filter_limits_the_rows() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("/").text("sens");
    snapshot!("filter_devices", stage);
    stage.keys("Enter 2 /").text("src:act srv:des").keys("Enter");
    snapshot!("filter_traffic", stage);
    stage.keys("Esc 1 Esc");
    assert_eq!(stage.app.rows().len(), 10);
}

#[test]
fn filter_error_names_the_cause() {
    let mut stage = Stage::boiler();
    stage.until(10.0).keys("/").text("at:abc").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("\"abc\" is not an address; use 0 to 127"), "{screen}");
    stage.keys("/").text(" nmae:feed").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("at:abc"), "the first mistake is told first\n{screen}");
    stage.keys("Esc /").text("nmae:feed").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("nmae:feed: unknown field nmae;"), "{screen}");
    assert!(one_line(&screen).contains(" id: is: bus:"), "to its end\n{screen}");
}

#[test]
fn russian_layout_keys_work() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("4").keys("о");
    assert_eq!(stage.app.view().page, Page::Problems);
    stage.keys("1 у").text("47").keys("Enter");
    assert!(stage.file().contains("47"), "у is e");
    stage.keys("г");
    assert_eq!(stage.file(), BOILER, "г is u");
    stage.keys("й");
    assert!(stage.effects.contains(&Effect::Quit), "й is q");
}

#[test]
fn mouse_selects_rows_and_pages() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    let mut mouse = |kind, column, row| {
        let now = stage.app.now();
        stage.app.handle_mouse(now, Mouse { kind, column, row });
        stage.app.view().page
    };
    mouse(MouseKind::Press, 10, 6);
    assert_eq!(mouse(MouseKind::Press, 14, 2), Page::Traffic);
    assert_eq!(mouse(MouseKind::WheelUp, 14, 9), Page::Traffic);
    assert_eq!(mouse(MouseKind::Press, 40, 2), Page::Problems);
    assert!(stage.app.view().traffic.is_some(), "the wheel holds the traffic");
    stage.keys("1");
    assert_eq!(stage.app.selected_row_index(), Some(2));
}

#[test]
fn filter_fields_work_on_every_page() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    let mut rows = |page: &str, filter: &str| {
        stage.keys(page).keys("/").text(filter).keys("Enter");
        let screen = stage.screen();
        let count = match page {
            "1" => stage.app.rows().len(),
            "2" => stage.app.frames_shown(500).0.len(),
            _ => stage.app.lines_shown().len(),
        };
        stage.keys("Esc");
        assert!(count > 0, "{page} {filter}\n{screen}");
        count
    };
    assert_eq!(rows("1", "at:14"), 1);
    assert_eq!(rows("1", "name:sens"), 2);
    assert_eq!(rows("1", "is:conflict"), 1);
    assert_eq!(rows("1", "is:clash"), 1);
    assert_eq!(rows("1", "is:missing"), 1);
    assert_eq!(rows("3", "is:suspected"), 2);
    assert_eq!(rows("3", "is:confirmed"), 2);
    assert_eq!(rows("3", "is:suspected at:14 name:act"), 2);
    rows("2", "at:14 name:act is:ours");
}

#[test]
fn single_key_sends_only_discovery_frames() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("i");
    assert!(stage.screen().contains("identify needs --profile"), "{}", stage.screen());
    let mut profile = descan::wire::profile::Profile::default();
    profile.given = true;
    let config = Config { profile: profile.into(), seed: 7, ..Config::default() };
    let scenario = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with(&scenario, Some(BOILER), config);
    stage.until(24.0);
    let sent = |stage: &Stage| {
        let ours = stage.app.capture().iter().filter(|(_, frame)| frame.is_tx);
        ours.filter(|(_, frame)| frame.platform_id().is_some_and(|id| id & 0x3FF == 0x18)).count()
    };
    stage.keys("i");
    assert!(stage.screen().contains("Send identify (service 018) to FEED at 10?"));
    stage.keys("n").until(25.0);
    assert_eq!(sent(&stage), 0);
    stage.keys("i y").until(26.0);
    assert_eq!(sent(&stage), 1);
}

#[test]
fn confirmation_and_path_fit_a_narrow_screen() {
    let mut stage = Stage::boiler();
    stage.until(9.0).size(40, 10).keys("D");
    assert!(stage.screen().contains("Delete FEED at 10?  y yes  n no"), "{}", stage.screen());
    stage.keys("n W");
    let screen = stage.screen();
    assert!(screen.contains("copy as: des-20261121-120009.json"), "{screen}");
    stage.keys("Esc w");
    let screen = stage.screen();
    assert!(screen.contains("frames to: descan-20261121-120009.log"), "{screen}");
}
