//! The page Traffic.

use super::snapshot;
use crate::common::harness::Stage;

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
