//! The page Traffic.

use super::snapshot;
use crate::common::harness::Stage;
use descan::app::Page;
use descan::discovery::Config;
use descan::frame::{CanId, Frame};
use descan::sim::Scenario;
use descan::time::Duration;
use descan::wire::id::Header;

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

#[test]
fn many_debug_messages_leave_room_for_other_frames() {
    let text = "bitrate = 500000\n[[device]]\nname = \"LOUD\"\naddress = { fixed = 10 }\n\
        settled = true\nchatter = [{ service = 7, period_ms = 5, length = 2, debug = true }]\n\
        [[device]]\nname = \"CALM\"\naddress = { fixed = 12 }\nsettled = true\n\
        chatter = [{ service = 8, period_ms = 500, length = 2, debug = true }]\n";
    let mut stage = Stage::new(&Scenario::parse(text).unwrap(), None);
    stage.until(8.0).keys("2");
    let screen = stage.screen();
    let rows = |screen: &str, what: &str| screen.lines().filter(|it| it.contains(what)).count();
    assert!((8..14).contains(&rows(&screen, "dbg    LOUD→all")), "{screen}");
    assert!(rows(&screen, "dbg    CALM→all") >= 2, "{screen}");
    let screen = stage.size(100, 24).screen();
    let (before, _) = screen.split_once(" DEBUG hidden").unwrap();
    let hidden = before.rsplit(' ').next().unwrap();
    assert!((1000..1600).contains(&hidden.parse().unwrap()), "{screen}");
    stage.size(80, 24);
    // Who asks for them sees them all.
    stage.keys("/").text("type:dbg").keys("Enter");
    let screen = stage.screen();
    assert!(rows(&screen, "dbg    LOUD→all") >= 17, "{screen}");
    assert!(!screen.contains("DEBUG hidden"), "{screen}");
}

#[test]
fn filter_without_match_shows_no_frame_and_keeps_the_selection() {
    let mut stage = Stage::boiler();
    stage.until(20.0).keys("2 Space k k");
    let selected = stage.app.selected_frame().expect("a selected frame");
    stage.keys("/").text("src:NOBODY").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("no frame matches the filter; \\ switches it off"), "{screen}");
    assert!(!screen.contains('▸'), "{screen}");
    assert_eq!(stage.app.selected_frame(), None);
    stage.keys("k Home o Enter");
    assert_eq!(stage.app.selected_frame(), None, "{}", stage.screen());
    stage.keys("Esc \\");
    assert_eq!(stage.app.selected_frame(), Some(selected), "{}", stage.screen());
}

#[test]
fn frames_of_a_device_are_the_newest_also_behind_others() {
    let mut stage = Stage::boiler();
    stage.until(20.0).keys("3 Up Up f");
    assert!(stage.app.view().traffic.is_some(), "at the moment of the line");
    for keys in ["1 Home f", "5 Home f"] {
        stage.keys("2 Home").keys(keys);
        assert_eq!(stage.app.view().page, Page::Traffic, "{}", stage.screen());
        assert_eq!(stage.app.view().traffic, None, "{keys}\n{}", stage.screen());
    }
}

#[test]
fn views_of_traffic_say_that_nothing_matches_the_filter() {
    let mut stage = Stage::boiler();
    stage.until(20.0).keys("2 /").text("src:NOBODY").keys("Enter");
    for (key, what) in [("v", "no identifier matches"), ("v", "no call matches"), ("v", "no frame")]
    {
        let screen = stage.keys(key).screen();
        assert!(screen.contains(what), "{what}: {screen}");
    }
}

#[test]
fn key_of_the_filter_leaves_evidence_open_without_a_filter() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 f");
    assert!(stage.keys("\\").screen().contains("no filter; / types one"), "{}", stage.screen());
    assert!(stage.app.view().evidence.is_some(), "{}", stage.screen());
}

#[test]
fn filter_at_a_past_moment_does_not_select_later_frames() {
    let text = "bitrate = 125000\n[[device]]\nname = \"CALM\"\naddress = { fixed = 12 }\nsettled = true\n\
        [[device]]\nname = \"LATE\"\naddress = { fixed = 14 }\nsettled = true\npower_on = 6.0\n";
    let mut stage = Stage::new(&Scenario::parse(text).unwrap(), None);
    stage.until(4.0).keys("2 Space k k");
    let moment = stage.app.now();
    stage.until(10.0).keys("/").text("src:14").keys("Enter");
    assert_eq!(stage.app.selected_frame(), None, "{}", stage.screen());
    let screen = stage.screen();
    assert!(screen.contains("no frame matches the filter; \\ switches it off"), "{screen}");
    stage.keys("\\");
    let selected = stage.app.selected_frame().expect("a selected frame");
    assert!(selected.time < moment, "{}", stage.screen());
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
    stage.keys("Enter Home").size(100, 24);
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

// ---- views -----------------------------------------------------------------------------------

/// Tests that a transfer of several frames is one row, which opens into its frames.
#[test]
fn transfer_is_one_row_that_opens() {
    let mut stage = Stage::boiler();
    stage.until(10.0).size(130, 40).keys("2 /").text("src:10 srv:des").keys("Enter Home");
    let rows = |stage: &Stage| {
        let screen = stage.screen();
        let rows = screen.lines().filter(|line| line.contains("→own"));
        rows.map(|row| row.replace('▸', " ")).collect::<Vec<_>>()
    };
    let closed = rows(&stage);
    let row = closed.iter().find(|row| row.contains("5 services")).expect("a transfer");
    assert!(row.starts_with(" +"), "{row}");
    assert!(!closed.iter().any(|row| row.contains("consecutive")), "{closed:#?}");
    let at = closed.iter().position(|line| line == row).unwrap();
    for _ in 0..at {
        stage.keys("j");
    }
    stage.keys("o");
    let open = rows(&stage);
    let parts = open.iter().filter(|row| row.contains("consecutive")).count();
    assert!(parts >= 3, "{open:#?}");
    // The message has the bytes of all of them.
    let number = stage.app.view().traffic.unwrap();
    let transfer = stage.app.transfer(number).unwrap();
    assert_eq!(transfer.frames, 1 + parts);
    assert!(transfer.is_complete() && transfer.message.len() == transfer.length);
    // Any of its frames closes it again.
    stage.keys("j j o");
    assert_eq!(rows(&stage), closed);
    assert_eq!(stage.app.view().traffic, Some(number));
}

/// Tests that periods and latencies are those of the frames.
#[test]
fn identifiers_and_calls_are_counted() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(120, 30).keys("2 v");
    snapshot!("identifiers_120x30", stage);
    snapshot!("identifiers_80x24", stage.size(80, 24));
    // Largest jitter first.
    stage.size(120, 30).keys("s s s s");
    let rows = stage.app.identifiers_shown();
    let jitter: Vec<_> = rows.iter().map(|row| row.own_period(false).map(|it| it.jitter)).collect();
    assert!(jitter.is_sorted_by(|one, other| one >= other), "{jitter:?}");
    stage.keys("S");
    let rows = stage.app.identifiers_shown();
    let jitter: Vec<_> = rows.iter().map(|row| row.own_period(false).map(|it| it.jitter)).collect();
    assert!(jitter.is_sorted(), "{jitter:?}");
    for row in rows {
        let times: Vec<_> = stage
            .app
            .capture()
            .frames_from(0)
            .filter(|(_, frame)| descan::app::IdentifierKey::of(frame) == row.key)
            .map(|(_, frame)| frame.time)
            .collect();
        let apart: Vec<_> = times.windows(2).map(|pair| pair[1].since(pair[0])).collect();
        assert_eq!(row.count, times.len() as u64);
        let period = row.period();
        assert_eq!(period.map(|it| it.min), apart.iter().copied().min());
        assert_eq!(period.map(|it| it.max), apart.iter().copied().max());
    }
    stage.keys("S v");
    snapshot!("calls_120x30", stage);
    snapshot!("calls_80x24", stage.size(80, 24));
    let narrow = stage.size(60, 15).screen();
    assert!(narrow.contains(" UNANSW FAILED"), "{narrow}");
    // Their frames: each request with its responses.
    stage.size(120, 30).keys("Home j");
    stage.keys("f");
    assert_eq!(
        stage.app.page_filter(descan::app::Page::Traffic).text(),
        "at:0 at:10 srv:0x002 not type:data"
    );
    let screen = stage.keys("Home").screen();
    assert!(screen.contains("1 rsp") && screen.contains(" ms"), "{screen}");
}

/// Tests that the times of frames are of the day, since the row above, since the same identifier, or
/// since the start.
#[test]
fn times_of_frames_have_four_formats() {
    let mut stage = Stage::new(&Scenario::new(125_000), None);
    let now = stage.app.now();
    let frame = |id: u16, millis: u64| {
        let frame = Frame::new(CanId::Standard(id), &[1]);
        frame.with_time(now + Duration::from_millis(millis))
    };
    let frames = [frame(1, 10), frame(2, 25), frame(1, 1510)];
    let end = now + Duration::from_secs(2);
    stage.app.handle_frames(end, &frames);
    let last = |stage: &Stage| {
        let screen = stage.screen();
        screen.lines().rfind(|line| line.contains(" std ")).unwrap().to_owned()
    };
    stage.size(80, 24).keys("2");
    assert!(last(&stage).contains("12:00:01.510"), "{}", last(&stage));
    stage.keys("z");
    assert!(last(&stage).contains(" 1485.0 "), "{}", last(&stage));
    stage.keys("z");
    assert!(last(&stage).contains(" 1500.0 "), "{}", last(&stage));
    stage.keys("z");
    assert!(last(&stage).contains(" 1.500 "), "{}", last(&stage));
    stage.keys("z").size(120, 24);
    assert!(last(&stage).contains("12:00:01.510  1485.0 "), "{}", last(&stage));
}

#[test]
fn identifiers_say_what_their_statistics_are_of() {
    let mut stage = Stage::boiler();
    stage.until(20.0).keys("2 v");
    let rule = " avg: last minute · JITTER: ms, 95 % of the last 256 intervals ";
    assert!(stage.screen().contains(rule), "{}", stage.screen());
    let rule = " min, avg, max: last minute · JITTER: 95 % of the last 256 intervals ";
    assert!(stage.size(120, 30).screen().contains(rule));
    assert!(!stage.size(80, 16).screen().contains("last minute"), "it gives way");
}

#[test]
fn hidden_rows_are_counted_until_the_moment_that_is_shown() {
    let config = Config { seed: 7, ..Config::default() };
    let boiler = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with_room(&boiler, None, config, 16 << 20);
    stage.until(45.0).size(120, 40).keys("2 /").text("src:FEED").keys("Enter :");
    stage.text("12:00:20").keys("Enter");
    let moment = stage.app.past_moment().expect("a past moment").time;
    let is_hidden = |frame: &Frame| {
        frame.platform_id().is_none_or(|id| Header::decode(id).source.number() != 10)
    };
    let before = stage.app.capture().frames_from(0).take_while(|(_, frame)| frame.time <= moment);
    let hidden = before.filter(|(_, frame)| is_hidden(frame)).count();
    assert!(hidden > 500, "{hidden}");
    assert_eq!(stage.app.hidden_frames_shown(), Some(hidden as u64));
    assert!(stage.screen().contains(&format!("{hidden} hidden")), "{}", stage.screen());
}

/// A number that is cut is another one.
#[test]
fn number_of_hidden_frames_is_whole_or_left_out() {
    let mut stage = Stage::boiler();
    stage.until(150.0).keys("2 /").text("srv:AUGER").keys("Enter");
    let mut has_number = false;
    for width in 60..=120 {
        let screen = stage.size(width, 24).screen();
        let line = screen.lines().find(|line| line.contains("/srv:AUGER"));
        // On narrow screens the end of the filter is cut, too.
        let Some(line) = line else { continue };
        let behind = line.split_once("/srv:AUGER").unwrap().1.trim_start();
        let digits = behind.chars().take_while(char::is_ascii_digit).count();
        let is_time = behind[digits..].starts_with(':');
        let is_whole = behind[digits..].starts_with(" hidden ");
        assert!(digits == 0 || is_time || is_whole, "{width}: {line}");
        has_number |= is_whole;
    }
    assert!(has_number);
}
