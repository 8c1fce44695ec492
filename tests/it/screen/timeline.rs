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
    stage.keys("Enter");
    assert_eq!(stage.app.view().page, Page::Traffic);
    assert!(stage.screen().contains("Esc back"), "{}", stage.screen());
    stage.keys("Enter").keys("/").text("HR").keys("Enter Esc");
    assert_eq!(stage.app.view().page, Page::Traffic, "the details and the filter are left first");
    stage.keys("Esc Esc");
    assert_eq!(stage.screen(), timeline);
    // After a change of page, Esc does not return to the first one.
    stage.keys("Enter 1 2 Esc");
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
    stage.until(45.0).keys("3 k k Enter");
    assert_eq!(stage.app.view().page, Page::Traffic);
    let number = stage.app.view().traffic.unwrap();
    let frame = stage.app.capture().get(number).unwrap();
    assert!(frame.time > Instant::ZERO + Duration::from_secs(26), "{}", frame.time);
}
