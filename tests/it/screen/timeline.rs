//! The page Timeline.

use super::snapshot;
use crate::common::harness::Stage;
use descan::app::Page;
use descan::time::{Duration, Instant};

#[test]
fn escape_returns_from_frames_to_the_timeline_line() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("3 k k");
    let timeline = stage.screen();
    stage.keys("f");
    assert_eq!(stage.app.view().page, Page::Traffic);
    assert!(stage.screen().contains("Esc back"), "{}", stage.screen());
    stage.keys("Enter").keys("/").text("HR").keys("Enter Esc");
    assert_eq!(stage.app.view().page, Page::Traffic, "the details and the filter are left first");
    stage.keys("Esc Esc");
    assert_eq!(stage.screen(), timeline);
    // After a change of page, Esc does not return to the first one.
    stage.keys("f 1 2 Esc");
    assert_eq!(stage.app.view().page, Page::Traffic);
}

#[test]
fn device_filter_shows_its_whole_timeline() {
    let mut stage = Stage::boiler();
    stage.until(170.0).size(100, 24).keys("3 /").text("heat").keys("Enter");
    // It claimed 16 before it had a row, and held it under a row that is now DIN's.
    snapshot!("story_of_heat", stage);
    stage.keys("Esc /").text("dev:disp").keys("Enter");
    snapshot!("story_of_disp", stage);
}

#[test]
fn timeline_line_opens_its_frames() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("3 k k f");
    assert_eq!(stage.app.view().page, Page::Traffic);
    let number = stage.app.view().traffic.unwrap();
    let frame = stage.app.capture().get(number).unwrap();
    assert!(frame.time > Instant::ZERO + Duration::from_secs(26), "{}", frame.time);
}

#[test]
fn timeline_line_shows_its_moment() {
    let config = descan::discovery::Config { seed: 7, ..Default::default() };
    let scenario = descan::sim::Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with_room(&scenario, None, config, 16 << 20);
    stage.until(24.0).keys("3 k k");
    let lines = stage.app.lines_shown();
    let number = lines[lines.len() - 3];
    let time = stage.app.timeline().get(number).unwrap().time;
    stage.keys("Enter");
    assert_eq!(stage.app.view().page, Page::Timeline);
    assert_eq!(stage.app.past_moment().map(|moment| moment.time), Some(time));
    assert_eq!(stage.app.lines_shown().last(), Some(&number));
    stage.keys("Esc");
    assert_eq!(stage.app.past_moment(), None);
}

#[test]
fn device_leads_to_its_frames() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("1 j f");
    assert_eq!(stage.app.page_filter(Page::Traffic).text(), "at:12");
    assert!(stage.screen().contains("/at:12"), "{}", stage.screen());
}
