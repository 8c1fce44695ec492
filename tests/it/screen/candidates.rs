//! Numbers beside the candidates of a filter that is typed.

use super::{one_line, snapshot};
use crate::common::harness::Stage;
use descan::app::FrameRole;
use descan::frame::{CanId, Frame};
use descan::sim::Scenario;
use descan::time::Duration;

/// Waits until a candidate has a number; returns the parts that were needed.
fn wait_for(stage: &mut Stage, candidate: &str) -> usize {
    for parts in 0..1000 {
        if stage.app.candidate_count(candidate).is_some() {
            return parts;
        }
        let due = stage.app.poll_timeout().expect("it goes on");
        stage.pass(due);
    }
    panic!("{candidate} is not counted");
}

#[test]
fn values_of_frames_have_their_numbers() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(120, 30).keys("2 /").text("src:FEED type:");
    assert_eq!(stage.app.candidate_count("rsp"), None, "the page is painted first");
    wait_for(&mut stage, "rsp");
    let of_role = |stage: &Stage, role: FrameRole| {
        let frames = stage.app.capture().frames_from(0);
        frames.filter(|(_, frame)| FrameRole::of(frame, false) == role).count() as u64
    };
    for role in [FrameRole::Request, FrameRole::Response, FrameRole::Unsolicited] {
        let count = stage.app.candidate_count(role.type_word());
        // Frames are counted until a moment ago.
        assert_eq!(count, Some(of_role(&stage, role)), "{role:?}");
    }
    let responses = of_role(&stage, FrameRole::Response);
    let screen = one_line(&stage.screen());
    assert!(screen.contains(&format!("rsp {responses}")), "{}", stage.screen());
    snapshot!("candidates_120x30", stage);
    snapshot!("candidates_80x24", stage.size(80, 24));
    // Fewer candidates keep their numbers.
    stage.text("r");
    assert_eq!(stage.app.candidate_count("rsp"), Some(responses));
    stage.keys("Esc");
    assert_eq!(stage.app.candidate_count("rsp"), None);
}

#[test]
fn values_of_other_rows_have_their_numbers() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(120, 30).keys("1 /").text("mode:");
    wait_for(&mut stage, "work");
    let working = stage.app.candidate_count("work").unwrap();
    stage.text("work").keys("Enter");
    assert_eq!(working, stage.app.rows().len() as u64);
    assert!(working > 5);
    stage.keys("3 /").text("at:");
    wait_for(&mut stage, "14");
    let of_address = stage.app.candidate_count("14").unwrap();
    stage.text("14").keys("Enter");
    assert_eq!(of_address, stage.app.lines_shown().len() as u64);
    stage.keys("2 v /").text("src:");
    wait_for(&mut stage, "FEED");
    let of_feed = stage.app.candidate_count("FEED").unwrap();
    stage.text("FEED").keys("Enter");
    assert_eq!(of_feed, stage.app.identifiers_shown().len() as u64);
}

/// Tests that a large capture is counted in parts between which keys are handled, and frames that are
/// received meanwhile, too.
#[test]
fn large_capture_is_counted_in_parts() {
    let mut stage = Stage::new(&Scenario::new(125_000), None);
    let now = stage.app.now();
    let frames: Vec<Frame> = (0..30_000)
        .map(|at| {
            let id = if at % 3 == 0 { CanId::Extended(0x0714_0001) } else { CanId::Standard(7) };
            Frame::new(id, &[1]).with_time(now + Duration::from_micros(at * 100))
        })
        .collect();
    let end = now + Duration::from_secs(4);
    stage.app.handle_frames(end, &frames);
    stage.app.handle_timeout(end);
    stage.size(100, 24).keys("2 /").text("type:");
    let parts = wait_for(&mut stage, "std");
    assert!(parts > 3, "{parts}");
    assert_eq!(stage.app.candidate_count("std"), Some(20_000));
    assert_eq!(stage.app.candidate_count("foreign"), Some(10_000));
    let later = stage.app.now() + Duration::from_secs(1);
    stage.app.handle_frames(later, &[Frame::new(CanId::Standard(7), &[]).with_time(later)]);
    for _ in 0..50 {
        let due = stage.app.poll_timeout().unwrap();
        stage.pass(due);
    }
    assert_eq!(stage.app.candidate_count("std"), Some(20_001));
}
