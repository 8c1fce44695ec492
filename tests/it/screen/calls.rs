//! The view of calls: single calls, and counts from a moment on.

use super::{one_line, snapshot};
use crate::common::harness::Stage;
use descan::app::{CallResult, Page, TrafficView};
use descan::frame::Frame;
use descan::sim::Scenario;
use descan::time::Duration;
use descan::wire::id::{Address, Header, Service};

/// A request of node 3 to node 9, or a response to it.
fn frame(response: bool, no_error: bool, byte: u8) -> Frame {
    let (source, destination) = if response { (9, 3) } else { (3, 9) };
    let header = Header {
        from_non_working: false,
        to_non_working: false,
        response,
        broadcast: false,
        no_error,
        source: Address::new(source).unwrap(),
        destination: Address::new(destination).unwrap(),
        service: Service::new(0x20).unwrap(),
    };
    Frame::classic(header.encode(), &[byte])
}

/// Returns the app after these frames, each with its milliseconds.
fn heard(frames: &[(u64, Frame)]) -> Stage {
    let mut stage = Stage::new(&Scenario::new(125_000), None);
    hear(&mut stage, frames);
    stage
}

fn hear(stage: &mut Stage, frames: &[(u64, Frame)]) {
    let now = stage.app.now();
    for (millis, frame) in frames {
        let frame = frame.with_time(now + Duration::from_millis(*millis));
        stage.app.handle_frames(frame.time, &[frame]);
        stage.app.handle_timeout(frame.time);
    }
}

fn rows(stage: &mut Stage) -> Vec<String> {
    let screen = stage.screen();
    let rows = screen.lines().filter(|line| line.contains(" 3→9 ") || line.contains(".0"));
    rows.map(one_line).collect()
}

#[test]
fn calls_of_a_row_are_listed_with_latency_and_result() {
    let mut stage = heard(&[
        (1000, frame(false, true, 1)),
        (1012, frame(true, true, 0xA1)),
        (2000, frame(false, true, 2)),
        (2040, frame(true, false, 0xA2)),
        (3000, frame(false, true, 3)),
        (5500, frame(false, true, 4)),
        (5501, frame(true, true, 0xA4)),
        (5503, frame(true, true, 0xA4)),
        (6000, frame(false, true, 5)),
    ]);
    stage.size(120, 30).keys("2 v v Enter");
    let results: Vec<_> = stage
        .app
        .calls_listed()
        .iter()
        .map(|call| (call.result, call.response.map(|it| it.1.as_millis()), call.responses))
        .collect();
    assert_eq!(
        results,
        [
            (CallResult::Open, None, 0),
            (CallResult::Answered, Some(1), 2),
            (CallResult::Unanswered, None, 0),
            (CallResult::Failed, Some(40), 1),
            (CallResult::Answered, Some(12), 1),
        ]
    );
    let screen = one_line(&stage.screen());
    for text in [
        "waits",
        "1.0 ⚠ 2 responses",
        "– ○ unanswered",
        "40.0 ✗ failed 02 A2",
        "12.0 answered 01 A1",
    ] {
        assert!(screen.contains(text), "{text}\n{}", stage.screen());
    }
    snapshot!("call_list_120x30", stage);
    snapshot!("call_list_80x24", stage.size(80, 24));
    // Those without a response first, then the slowest.
    let listed = |stage: &Stage| -> Vec<u8> {
        let calls = stage.app.calls_listed();
        calls.iter().map(|it| stage.app.capture().get(it.request).unwrap().data()[0]).collect()
    };
    assert_eq!(listed(stage.keys("s")), [3, 2, 1, 4, 5]);
    assert_eq!(listed(stage.keys("S")), [5, 4, 1, 2, 3], "reversed");
    stage.keys("S");
    // Only failed ones.
    stage.keys("/").text("failed");
    assert!(stage.screen().contains("1 of 5 calls match"), "{}", stage.screen());
    stage.keys("Enter");
    assert_eq!(stage.app.calls_listed().len(), 1);
    stage.keys("Enter");
    assert_eq!(stage.app.view().traffic_view, TrafficView::Frames);
    let selected = stage.app.selected_frame().unwrap();
    assert_eq!(selected.data(), [2], "the request of the failed call");
    assert!(!stage.app.page_filter(Page::Traffic).is_on(), "it would hide the request");
    stage.keys("Backspace");
    assert_eq!(stage.app.calls_listed().len(), 1, "back with the filter");
    for key in ["Esc", "Backspace"] {
        assert!(stage.app.view().call_list().is_some(), "{}", stage.screen());
        stage.keys(key);
        assert!(stage.app.view().call_list().is_none(), "{key}");
        assert!(one_line(&stage.screen()).contains("CLIENT→SERVER"), "{key}: {}", stage.screen());
        // Without the filter.
        stage.keys("Esc Home Enter");
    }
}

#[test]
fn newest_call_stays_first_until_the_selection_moves() {
    let mut stage = heard(&[(1000, frame(false, true, 1)), (1012, frame(true, true, 1))]);
    stage.size(120, 30).keys("2 v v Enter");
    hear(&mut stage, &[(500, frame(false, true, 2))]);
    assert_eq!(stage.app.selected_frame().unwrap().data(), [2]);
    stage.keys("j");
    hear(&mut stage, &[(500, frame(false, true, 3))]);
    assert_eq!(stage.app.selected_frame().unwrap().data(), [1]);
    assert_eq!(stage.app.calls_listed().len(), 3);
}

#[test]
fn calls_of_a_past_moment_are_those_until_then() {
    let mut stage = heard(&[(1000, frame(false, true, 1)), (1012, frame(true, true, 1))]);
    stage.size(120, 30).keys("2 v v Enter Space");
    hear(&mut stage, &[(500, frame(false, true, 2)), (520, frame(true, true, 2))]);
    assert_eq!(stage.app.calls_listed().len(), 1);
    stage.keys("Space");
    assert_eq!(stage.app.calls_listed().len(), 2);
}

#[test]
fn counts_begin_anew_at_a_moment() {
    let mut stage = heard(&[
        (1000, frame(false, true, 1)),
        (1012, frame(true, true, 1)),
        (1500, frame(false, true, 1)),
        (1540, frame(true, false, 1)),
    ]);
    stage.size(120, 30).keys("2 v v");
    let row = |stage: &mut Stage| rows(stage).into_iter().find(|it| it.contains("3→9")).unwrap();
    assert!(row(&mut stage).contains(" 0x020 2 "), "{}", stage.screen());
    stage.keys("z");
    assert!(row(&mut stage).contains(" 0x020 0 "), "{}", stage.screen());
    assert!(stage.screen().contains("counts since "), "{}", stage.screen());
    hear(&mut stage, &[(100, frame(false, true, 1)), (103, frame(true, true, 1))]);
    // One call, of 3 ms; none failed since.
    let since = row(&mut stage);
    assert!(since.contains(" 0x020 1 ") && since.contains(" 3.0 3.0 3.0 0 0"), "{since}");
    // A moment before it has all counts of then.
    stage.keys("<");
    stage.keys("< < <");
    assert!(!stage.screen().contains("counts since "), "{}", stage.screen());
    stage.keys("Esc v v");
    let identifiers = stage.app.identifiers_shown();
    let request = identifiers.iter().find(|it| it.last.data() == [1]).unwrap();
    assert_eq!((request.count, stage.app.view().frame_count(request)), (3, 1));
    stage.keys("z");
    assert!(stage.screen().contains("counts since the start"), "{}", stage.screen());
    let identifiers = stage.app.identifiers_shown();
    let request = identifiers.iter().find(|it| it.last.data() == [1]).unwrap();
    assert_eq!(stage.app.view().frame_count(request), 3);
}

#[test]
fn filter_of_calls_and_identifiers_counts_these() {
    let other = Frame::classic(0x0700_0001, &[]);
    let all = [(1000, frame(false, true, 1)), (1012, frame(true, true, 1)), (1500, other)];
    let mut stage = heard(&all);
    stage.size(120, 30).keys("2 v v /").text("srv:0x21");
    assert!(stage.screen().contains("0 of 1 calls match"), "{}", stage.screen());
    stage.keys("Enter");
    assert!(stage.screen().contains("/srv:0x21  1 hidden"), "{}", stage.screen());
    let mut stage = heard(&all);
    stage.size(120, 30).keys("2 v /").text("srv:0x20");
    assert!(stage.screen().contains("2 of 3 identifiers match"), "{}", stage.screen());
    stage.keys("Enter");
    assert!(stage.screen().contains("/srv:0x20  1 hidden"), "{}", stage.screen());
    // On another page there are no frames to hide.
    stage.keys("1 /").text("FEED").keys("Enter");
    assert!(!stage.screen().contains("hidden"), "{}", stage.screen());
}
