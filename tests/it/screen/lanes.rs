//! The lanes of the Timeline page: what they show, their axis, moving along it.

use super::{one_line, snapshot, styles_of, text_snapshot};
use crate::common::harness::Stage;
use descan::app::{LaneCell, Mouse, MouseKind, Page};
use descan::discovery::Config;
use descan::frame::{CanId, Frame};
use descan::sim::Scenario;
use descan::time::{Duration, Instant};

/// The boiler with room for its whole past, on the Timeline page.
fn boiler(columns: u16, rows: u16, seconds: f64) -> Stage {
    let scenario = Scenario::builtin("boiler").unwrap();
    let config = Config { seed: 7, ..Config::default() };
    let mut stage = Stage::with_room(&scenario, None, config, 16 << 20);
    stage.size(columns, rows).until(seconds).keys("3");
    stage
}

/// Lines of the screen that begin with these words.
fn lane(stage: &Stage, label: &str) -> String {
    let screen = stage.screen();
    let is_it = |line: &&str| line.trim_start_matches(['▸', ' ']).starts_with(label);
    screen.lines().find(is_it).unwrap_or_else(|| panic!("{label}\n{screen}")).to_owned()
}

#[test]
fn lanes_and_lines_match_snapshots() {
    let mut stage = boiler(120, 40, 175.0);
    snapshot!("timeline_120x40", stage);
    stage.keys("k k k");
    text_snapshot!("timeline_styles_mono", styles_of(&stage.size(100, 24).buffer("mono")));
    snapshot!("timeline_200x50", stage.size(200, 50));
    stage.size(80, 24).keys("v");
    snapshot!("lanes_80x24", stage);
}

#[test]
fn lanes_show_moves_reboots_absences_and_conflicts() {
    let stage = boiler(120, 40, 175.0);
    for (label, signs) in [
        ("10 FEED", &["↻"][..]),
        ("14A ACT", &["▓▓▓▓", "━━━"]),
        ("14B ACT", &["▓▓▓▓", "···"]),
        ("16 DIN", &["━I"]),
        ("20 DISP", &["→40━", "→20━"]),
        ("30 PSU", &["U─"]),
        ("50 GSM-MODEM", &["╌·", "·━"]),
        ("107 NEW", &["C──"]),
        ("errors", &["!"]),
    ] {
        let line = lane(&stage, label);
        for sign in signs {
            assert!(line.contains(sign), "{label} {sign}: {line}");
        }
    }
    assert!(lane(&stage, "10 FEED").ends_with("online WORK"), "{}", lane(&stage, "10 FEED"));
}

#[test]
fn times_days_apart_have_their_date() {
    let scenario = Scenario::new(500_000);
    let config = Config { listen_only: true, ..Config::default() };
    let mut stage = Stage::with_room(&scenario, None, config, 64 << 20);
    let heartbeat = Frame::new(CanId::Extended(0x073D_D401), &[0, 0, 0, 0, 0, 0, 4, 0]);
    for day in 0..12 {
        let at = Instant::ZERO + Duration::from_secs(86_400 * day);
        stage.app.advance_to(at);
        stage.app.handle_frames(at, &[heartbeat.with_time(at)]);
    }
    let screen = stage.size(120, 24).keys("3").screen();
    let axis = screen.lines().find(|line| line.contains("a cell")).unwrap_or(&screen);
    assert!(axis.contains("╷11-24 00:00") && axis.contains("╷11-27 00:00"), "{axis}");
}

#[test]
fn boards_of_a_conflict_have_lanes_of_their_own() {
    let cells = |stage: &Stage, label: &str| {
        let line = lane(stage, label);
        line.chars().filter(|c| "━─▓▒·A".contains(*c)).collect::<String>()
    };
    // SPARE01 joins at 27 s, and leaves at 50 s.
    let stage = boiler(120, 40, 26.0);
    assert!(lane(&stage, "14 ACT").contains("━━━"), "{}", stage.screen());
    let stage = boiler(120, 40, 45.0);
    let (first, second) = (lane(&stage, "14A ACT"), lane(&stage, "14B ACT"));
    assert!(first.contains("━▓▓▓") && first.ends_with("CONFLICT"), "{first}");
    assert!(second.contains("▓▓▓") && second.ends_with("CONFLICT"), "{second}");
    let place = |line: &str, sign: char| line.chars().position(|c| c == sign).unwrap();
    assert_eq!(place(&first, '▓'), place(&second, '▓'), "both from the joining on");
    assert!(!second.contains('━'), "nothing before it: {second}");
    let mut stage = boiler(120, 40, 75.0);
    let second = lane(&stage, "14B ACT");
    assert!(second.contains("▓·") && second.ends_with("lost"), "{second}");
    assert!(lane(&stage, "14A ACT").ends_with("online WORK"));
    assert!(!cells(&stage, "14A ACT").contains('·'));
    // As it was then.
    stage.keys(":").text("12:00:45").keys("Enter");
    assert!(lane(&stage, "14B ACT").ends_with("CONFLICT"), "{}", stage.screen());
    assert!(!cells(&stage, "14B ACT").contains('·'));
    // A board that moved on has its lane as a device.
    let stage = boiler(120, 40, 175.0);
    assert!(!stage.screen().contains("16A"), "{}", stage.screen());
}

#[test]
fn axis_of_lanes_and_bar_agree() {
    let mut stage = boiler(120, 40, 20.0);
    let mut marked = Vec::new();
    for seconds in [20.0, 47.3, 61.2, 90.0, 133.7] {
        stage.until(seconds).keys("M Enter");
        marked.push(stage.app.now());
    }
    stage.until(150.0);
    let (axis, bar) = (stage.app.lane_axis(), stage.app.time_bar().axis());
    let screen = stage.screen();
    let bar_row = usize::from(stage.app.screen().time_bar.y);
    let rows =
        [usize::from(stage.app.screen().lanes.y), bar_row].map(|row| screen.lines().nth(row));
    for (letter, time) in ["a", "b", "c", "d", "e"].into_iter().zip(marked) {
        for (row, (axis, left)) in rows.iter().zip([(axis, 18), (bar, 11)]) {
            let cells: Vec<char> = row.unwrap().chars().skip(left).collect();
            let cell = cells.iter().position(|cell| cell.to_string() == letter);
            let cell = cell.unwrap_or_else(|| panic!("{letter}: {row:?}"));
            assert!(axis.start(cell) <= time && time < axis.start(cell + 1), "{letter} {row:?}");
        }
    }
    // All events of the timeline are on the axis.
    for line in stage.app.timeline().entries() {
        assert!(axis.contains(line.time), "{line:?}");
    }
}

#[test]
fn later_cells_of_a_past_moment_are_empty() {
    let mut stage = boiler(120, 40, 70.0);
    stage.keys(":").text("12:00:40").keys("Enter");
    let lanes = stage.app.lanes();
    let shown = lanes.axis.cell(stage.app.past_moment().unwrap().time);
    assert!(shown + 10 < lanes.axis.cell(stage.app.now()), "the axis is that of the whole");
    for lane in &lanes.rows {
        assert!(lane.cells[shown + 1..].iter().all(|cell| *cell == LaneCell::Blank), "{lane:?}");
        assert_ne!(lane.cells[shown], LaneCell::Blank, "{lane:?}");
    }
    let axis = stage.screen().lines().find(|line| line.contains(" a cell ")).unwrap().to_owned();
    assert_eq!(axis.chars().nth(18 + shown), Some('▼'), "{axis}");
}

#[test]
fn zoom_and_arrows_move_along_the_lanes() {
    let mut stage = boiler(120, 40, 60.0);
    stage.keys("1 +");
    assert!(stage.screen().contains("time bar: "), "{}", stage.screen());
    let step = |stage: &Stage| stage.app.lane_axis().step();
    stage.keys("3");
    assert_eq!(step(&stage), Duration::from_secs(1));
    stage.keys("+ + +");
    assert_eq!(step(&stage), Duration::from_millis(100));
    assert!(one_line(&stage.screen()).contains(" 100 ms a cell "), "{}", stage.screen());
    stage.keys("Left");
    let at = |stage: &Stage| stage.app.past_moment().unwrap().time;
    assert_eq!(stage.app.now().since(at(&stage)), Duration::from_millis(100));
    stage.keys("Shift-Left Left");
    assert_eq!(stage.app.now().since(at(&stage)), Duration::from_millis(1200));
    stage.keys("Right");
    assert_eq!(stage.app.now().since(at(&stage)), Duration::from_millis(1100));
    let axis = stage.app.lane_axis();
    assert!(axis.contains(at(&stage)) && axis.begin > Instant::ZERO, "{axis:?}");
    // The bounds of the zoom.
    stage.keys("+ + + + + + + + + + + + +");
    assert_eq!(step(&stage), Duration::from_millis(10));
    assert!(stage.app.lane_axis().contains(at(&stage)));
    for _ in 0..20 {
        stage.keys("-");
    }
    assert_eq!(step(&stage), Duration::from_mins(10));
}

#[test]
fn mouse_on_a_lane_goes_to_the_moment_of_its_cell() {
    let mut stage = boiler(120, 40, 60.0);
    let (now, row) = (stage.app.now(), stage.app.screen().lanes.y + 2);
    let mouse = Mouse { kind: MouseKind::Press, column: 18 + 30, row };
    stage.app.handle_mouse(now, mouse);
    stage.until(60.5);
    let shown = stage.app.past_moment().unwrap().time;
    assert_eq!(stage.app.lane_axis().cell(shown), 30);
}

#[test]
fn views_of_timeline_are_switched_by_key() {
    let mut stage = boiler(120, 40, 45.0);
    let parts = |stage: &Stage| {
        let screen = stage.app.screen();
        (screen.lanes.height > 0, screen.list.height > 0)
    };
    assert_eq!(parts(&stage), (true, true));
    assert_eq!(parts(stage.keys("v")), (false, true));
    assert_eq!(parts(stage.keys("v")), (true, false));
    stage.keys("j j j j");
    let lane = stage.app.selected_lane();
    let address = lane.and_then(|id| stage.app.device(id)).map(|device| device.address.number());
    assert_eq!(address, Some(14), "the first key selects the first lane");
    stage.keys("Enter");
    assert_eq!(stage.app.view().page, Page::Devices);
    assert_eq!(stage.app.selected_device().map(|device| device.address.number()), Some(14));
    stage.keys("3 f");
    assert_eq!(stage.app.page_filter(Page::Traffic).text(), "at:14");
    stage.keys("3 v");
    assert_eq!(parts(&stage), (true, true));
    assert_eq!(parts(stage.size(80, 24)), (false, true), "too narrow for both");
}

#[test]
fn lane_of_the_selected_line_is_marked_on_a_small_screen_too() {
    let mut stage = boiler(120, 30, 170.0);
    stage.keys("/").text("name:gsm").keys("Enter k");
    assert!(lane(&stage, "50 GSM-MODEM").starts_with('▸'), "{}", stage.screen());
    // Devices with events come first where not all fit.
    let screen = stage.size(120, 20).screen();
    assert!(screen.contains(" +"), "{screen}");
    assert!(lane(&stage, "50 GSM-MODEM").starts_with('▸'), "{}", stage.screen());
}
