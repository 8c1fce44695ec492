//! The page Traffic.

use super::snapshot;
use crate::common::harness::Stage;
use descan::frame::{CanId, Frame};
use descan::sim::Scenario;
use descan::time::Duration;

#[test]
fn traffic_page_and_details_match_snapshot() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("2");
    snapshot!("traffic_80x24", stage);
    snapshot!("traffic_120x40", stage.size(120, 40));
    snapshot!("traffic_details", stage.size(80, 24).keys("Space k k k Enter"));
    snapshot!("traffic_details_40x10", stage.size(40, 10).keys("Esc Enter"));
    snapshot!("identifiers", stage.size(80, 24).keys("Esc Esc v"));
}

#[test]
fn frozen_view_keeps_capturing() {
    let mut stage = Stage::boiler();
    stage.until(20.0).keys("2 Space");
    let held = stage.screen();
    let body = |screen: &str| screen.lines().skip(3).take(18).collect::<Vec<_>>().join("\n");
    stage.until(22.0);
    assert_eq!(body(&stage.screen()), body(&held));
    assert!(stage.screen().contains("FROZEN"));
    stage.keys("Space");
    assert!(stage.screen().contains("12:00:21.9"));
}

/// Tests that the newest frames are filtered at once, and the others in parts between which keys are
/// handled.
#[test]
fn large_capture_is_filtered_in_parts() {
    let mut stage = Stage::new(&Scenario::new(125_000), None);
    let now = stage.app.now();
    // Every tenth frame has another identifier.
    let frames: Vec<Frame> = (0..30_000)
        .map(|at| {
            let id = if at % 10 == 0 { 0x123 } else { 0x456 };
            let time = now + Duration::from_micros(at * 100);
            Frame::new(CanId::Standard(id), &at.to_be_bytes()).with_time(time)
        })
        .collect();
    let end = now + Duration::from_secs(4);
    stage.app.handle_frames(end, &frames);
    stage.app.handle_timeout(end);
    stage.size(100, 24).keys("2 /").text("id:123");
    let screen = stage.screen();
    assert!(screen.matches(" 123 ").count() > 15, "the newest are shown\n{screen}");
    assert_eq!(stage.app.hidden_frames(), None, "older ones are not tested");
    let mut parts = 0;
    while stage.app.hidden_frames().is_none() {
        let due = stage.app.poll_timeout().unwrap();
        stage.app.handle_timeout(due);
        parts += 1;
        assert!(parts < 100, "there is an end");
    }
    assert!(parts > 1, "{parts}");
    assert_eq!(stage.app.hidden_frames(), Some(27_000));
    stage.keys("Enter g").size(100, 24);
    let screen = stage.screen();
    assert!(
        screen.contains("27000 hidden") && screen.contains(" 00 00 00 00 00 00 00 00 "),
        "{screen}"
    );
    // Frames that arrive later are tested, too.
    let late = frames[9].with_time(end);
    stage.app.handle_frames(end, &[late, frames[10].with_time(end)]);
    stage.app.take_dirty();
    assert_eq!(stage.app.hidden_frames(), Some(27_001));
}
