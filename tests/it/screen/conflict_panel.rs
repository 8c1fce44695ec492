//! The boards of a conflict side by side, on the page Problems.

use super::{snapshot, text_snapshot};
use crate::common::harness::{Stage, text_of};
use descan::app::{Effect, Focus, Page, ProblemKey};
use descan::discovery::Config;
use descan::frame::{BusIndex, CanId, Frame};
use descan::sim::{DeviceAction, DeviceSpec, Fault, Scenario};
use descan::time::{Duration, Instant};
use descan::wire::descriptor::AddressSetting;
use descan::wire::id::Address;
use descan::wire::node::Uid;
use descan::wire::profile::Profile;

/// Room for captured frames with their past.
const ROOM: usize = 16 << 20;

fn uid(text: &str) -> Uid {
    Uid::parse(text, &Profile::default().uid).unwrap()
}

/// A board at address 14 that keeps it, from `seconds` on.
fn board(name: &str, label: &str, uid: Uid, seconds: f64) -> DeviceSpec {
    let mut device = DeviceSpec::new(name).label(label).fixed(14).skips_address_resolution();
    device.power_on = Some(Duration::from_secs_f64(seconds));
    device.uid(uid).service("VALVE", "1.2").fault(Fault::KeepsAddress)
}

fn scenario(boards: &[DeviceSpec]) -> Scenario {
    let start = Scenario::with_many_devices(125_000, 4, 3);
    boards.iter().fold(start, |scenario, board| scenario.with(board.clone()))
}

fn stage(scenario: &Scenario) -> Stage {
    let config = Config { seed: 7, ..Config::default() };
    Stage::with_room(scenario, None, config, ROOM)
}

/// Runs a scenario, and opens the page with the problem of address 14.
fn shown(scenario: &Scenario, seconds: f64) -> Stage {
    let mut stage = stage(scenario);
    stage.until(seconds).keys("4");
    let key = ProblemKey::Address(BusIndex(0), Address::new(14).unwrap());
    let place = stage.app.problems_shown().keys().position(|it| *it == key);
    for _ in 0..place.expect("no problem at 14") {
        stage.keys("j");
    }
    stage
}

/// Tests that the page of a past moment is that of a run until then.
fn compare_with_past(scenario: &Scenario, end: f64, moment: f64) {
    let page = |stage: &Stage| {
        let screen = stage.screen();
        let lines: Vec<&str> = screen.lines().collect();
        lines[1..lines.len() - 2].join("\n")
    };
    let mut past = stage(scenario);
    past.size(120, 40).until(end);
    past.app.go_to_time(Instant::ZERO + Duration::from_secs_f64(moment));
    past.wait_for_past();
    let mut then = stage(scenario);
    then.size(120, 40).until(moment).keys("Space");
    assert_eq!(page(past.keys("4")), page(then.keys("4")));
}

impl Stage {
    /// Waits until the moment on the way is shown.
    fn wait_for_past(&mut self) {
        for _ in 0..1000 {
            if self.app.past_moment().is_some() {
                return;
            }
            let at = self.app.poll_timeout().unwrap();
            self.pass(at);
        }
        panic!("the moment is not shown");
    }
}

/// The rows of the boards: label and columns.
fn row(stage: &Stage, label: &str) -> String {
    let screen = stage.screen();
    let start = format!(" {label} ");
    let line = screen.lines().find(|line| line.starts_with(&start));
    super::one_line(line.unwrap_or_else(|| panic!("no row {label}\n{screen}")))
}

#[test]
fn conflict_of_two_uids_matches_snapshots() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4");
    snapshot!("conflict_panel_80x24", stage);
    snapshot!("conflict_panel_120x40", stage.size(120, 40));
    snapshot!("conflict_panel_200x50", stage.size(200, 50));
    stage.size(80, 24);
    for theme in ["mono", "dark"] {
        // The letters tell the boards apart in every theme.
        assert_eq!(text_of(&stage.buffer(theme)), stage.screen());
    }
    text_snapshot!("conflict_panel_styles_mono", super::styles_of(&stage.buffer("mono")));
}

#[test]
fn row_of_a_suspected_conflict_has_the_uid_of_its_board() {
    let mut stage = Stage::boiler();
    // One after a heartbeat of each.
    for seconds in [27.9, 28.81, 28.9, 29.81] {
        stage.until(seconds).keys("1");
        let place = |row: &descan::app::Row| row.address == Address::new(14);
        let rows: Vec<_> = stage.app.rows().iter().filter(|row| place(row)).collect();
        let uids: Vec<_> = rows.iter().map(|row| row.uid).collect();
        assert_eq!(uids, [Some(uid("BOILER03"))], "at {seconds}");
    }
    while stage.app.selected_row().unwrap().address != Address::new(14) {
        stage.keys("j");
    }
    let screen = stage.size(120, 40).screen();
    assert!(screen.contains("ACT @14 · BOILER03 and SPARE01"), "{screen}");
}

#[test]
fn three_boards_have_three_columns_in_the_order_of_joining() {
    let boards = [
        board("ACT", "one", uid("ONE"), 0.0),
        board("ACT", "two", uid("TWO"), 12.3),
        board("ACT", "three", uid("THREE"), 16.7),
    ];
    let scenario = scenario(&boards);
    let mut stage = shown(&scenario, 30.0);
    snapshot!("conflict_three_boards_80x24", stage);
    snapshot!("conflict_three_boards_120x40", stage.size(120, 40));
    let screen = stage.screen();
    assert!(screen.contains("THREE joined, conflicts with ONE and TWO (since 12:00:"), "{screen}");
    assert!(row(&stage, "joined").contains("3rd"), "{screen}");
    compare_with_past(&scenario, 30.0, 21.0);
}

#[test]
fn board_from_another_address_has_a_row_in_the_conflict() {
    let boards = [board("ACT", "one", uid("ONE"), 0.0), board("ACT", "two", uid("TWO"), 0.5)];
    let mut scenario = scenario(&boards);
    let moves = |address| DeviceAction::Move(AddressSetting::Fixed(Address::new(address).unwrap()));
    scenario = scenario.at(Duration::from_secs(1), "two", moves(20));
    scenario = scenario.at(Duration::from_secs(20), "two", moves(14));
    let stage = shown(&scenario, 40.0);
    let side = |row: &descan::app::Row| row.board.map(|board| (board.side, board.sender.uid));
    let here = stage.app.rows().iter().filter(|row| row.address == Address::new(14));
    let mut sides: Vec<_> = here.filter_map(side).collect();
    sides.sort_unstable_by_key(|(side, _)| *side);
    assert_eq!(sides, [('A', uid("ONE")), ('B', uid("TWO"))], "{}", stage.screen());
}

#[test]
fn more_boards_than_columns_show_the_newest_three() {
    let boards: Vec<DeviceSpec> = (0..5)
        .map(|at| {
            let (name, seconds) = (format!("UID{at}"), 3.0 * f64::from(at) + 0.15 * f64::from(at));
            board("ACT", &name, uid(&name), seconds)
        })
        .collect();
    let mut stage = shown(&scenario(&boards), 40.0);
    let screen = stage.size(120, 40).screen();
    for (heading, is_shown) in
        [("A UID0", false), ("B UID1", false), ("C UID2", true), ("E UID4", true)]
    {
        assert_eq!(screen.contains(heading), is_shown, "{heading}\n{screen}");
    }
    assert!(screen.contains("UID4 joined"), "{screen}");
}

#[test]
fn boards_with_blank_uids_are_told_apart_by_phase() {
    let boards = [board("ACT", "one", Uid([0; 6]), 0.0), board("ACT", "two", Uid([0; 6]), 12.3)];
    let scenario = scenario(&boards);
    let mut stage = shown(&scenario, 40.0);
    snapshot!("conflict_blank_uids_80x24", stage);
    snapshot!("conflict_blank_uids_120x40", stage.size(120, 40));
    let screen = stage.screen();
    for words in ["(UIDs blank)", "distinguished by the phase", "A no UID", "B no UID"] {
        assert!(screen.contains(words), "{words}\n{screen}");
    }
    assert!(row(&stage, "joined").contains("2nd"), "{screen}");
    compare_with_past(&scenario, 40.0, 33.0);
}

#[test]
fn board_without_uid_has_its_row_beside_one_with_a_uid() {
    for (one, two) in [(Uid([1; 6]), Uid([0; 6])), (Uid([0xFF; 6]), Uid([1; 6]))] {
        let boards = [board("ACT", "one", one, 0.0), board("PUMP", "two", two, 12.3)];
        let scenario = scenario(&boards);
        let mut stage = shown(&scenario, 40.0);
        let screen = stage.size(120, 40).screen();
        for words in ["one board answers as ACT, the other as PUMP", "· ACT ", "· PUMP"] {
            assert!(screen.contains(words), "{words}\n{screen}");
        }
        assert!(!screen.contains("ACT or PUMP"), "{screen}");
        let screen = stage.keys("1").screen();
        for (row, name) in [("14A", "ACT"), ("14B", "PUMP")] {
            let line = screen.lines().find(|line| line.contains(row) && line.contains("CONFLICT"));
            let line = line.unwrap_or_else(|| panic!("no {row}\n{screen}"));
            assert!(line.contains(name) && line.contains("1.00 s"), "{line}");
            assert!(
                line.contains("blank") == (name == if one.is_blank() { "ACT" } else { "PUMP" }),
                "{line}"
            );
        }
        compare_with_past(&scenario, 40.0, 33.0);
    }
}

#[test]
fn boards_that_cannot_be_told_apart_are_marked() {
    let boards = [board("ACT", "one", Uid([0; 6]), 0.0), board("ACT", "two", Uid([0; 6]), 12.3)];
    // Heartbeats that the engine has seen, and the capture has not: too few to show their phases.
    let config = Config { seed: 7, ..Config::default() };
    let mut stage = Stage::with_room(&scenario(&boards), None, config, 0);
    stage.until(40.0).keys("4");
    let frame = Frame::new(CanId::Standard(0x123), &[]).with_time(stage.app.now());
    let count = 4 * stage.app.capture().capacity() as usize;
    stage.app.handle_frames(stage.app.now(), &vec![frame; count]);
    let screen = stage.screen();
    assert!(screen.contains("? UIDs blank or equal, heartbeat phases unclear"), "{screen}");
    assert!(!screen.contains("A no UID"), "{screen}");
}

#[test]
fn board_that_left_stays_with_its_last_heartbeat() {
    let boards = [board("ACT", "one", uid("ONE"), 0.0), board("ACT", "two", uid("TWO"), 12.3)];
    let scenario = scenario(&boards).at(Duration::from_secs(25), "two", DeviceAction::PowerOff);
    let mut stage = shown(&scenario, 90.0);
    snapshot!("conflict_over_80x24", stage);
    snapshot!("conflict_over_120x40", stage.size(120, 40));
    let screen = stage.screen();
    for words in
        ["TWO joined, conflicted with ONE (since 12:00:", "until 12:00:2", "left: last 12:00:2"]
    {
        assert!(screen.contains(words), "{words}\n{screen}");
    }
    assert!(!screen.contains("Unplug"), "{screen}");
    // The view of problems that are over, and the others.
    for (view, is_listed) in [("open", false), ("over", true), ("muted", false), ("all", true)] {
        stage.keys("v");
        let is_open = stage.screen().contains("TWO joined");
        assert_eq!(is_open, is_listed, "{view}\n{}", stage.screen());
    }
    compare_with_past(&scenario, 90.0, 60.0);
}

#[test]
fn board_whose_row_is_removed_has_no_other_name() {
    let boards = [board("ACT", "one", uid("ONE"), 0.0), board("PUMP", "two", uid("TWO"), 12.3)];
    let scenario = scenario(&boards).at(Duration::from_secs(40), "two", DeviceAction::PowerOff);
    let mut stage = shown(&scenario, 90.0);
    let titles = |stage: &Stage| {
        let screen = stage.screen();
        let title = screen.lines().find(|line| line.contains("A ONE")).map(str::to_owned);
        title.unwrap_or(screen)
    };
    let before = titles(&stage);
    assert!(before.contains("A ONE · ACT") && before.contains("B TWO · ACT or PUMP"), "{before}");
    stage.keys("1 c");
    assert!(stage.screen().contains("1 lost device removed"), "{}", stage.screen());
    stage.keys("4");
    let after = titles(&stage);
    assert!(after.contains("A ONE · ACT") && after.contains("B TWO · PUMP"), "{after}");
    let lanes = stage.size(120, 40).keys("3").screen();
    assert!(lanes.contains("14A ACT") && lanes.contains("14B PUMP"), "{lanes}");
}

#[test]
fn board_that_comes_back_was_there_before_the_other() {
    // Absent for longer than heartbeats are remembered, then until its row is lost.
    for (left, joined, back) in [(12.0, 19.0, 27.0), (12.0, 45.0, 60.0)] {
        let boards =
            [board("ACT", "one", uid("ONE"), 0.0), board("ACT", "two", uid("TWO"), joined)];
        let scenario = scenario(&boards)
            .at(Duration::from_secs_f64(left), "one", DeviceAction::PowerOff)
            .at(Duration::from_secs_f64(back), "one", DeviceAction::PowerOn);
        let mut stage = shown(&scenario, back + 20.0);
        let screen = stage.size(120, 40).screen();
        let words = "ONE returned, conflicts with TWO (since 12:00:";
        assert!(screen.contains(words), "{screen}");
        assert!(screen.contains("A ONE") && screen.contains("B TWO"), "{screen}");
        assert!(row(&stage, "joined").contains("12:00:00, back 12:0"), "{screen}");
        let remedy = "Unplug TWO (2nd: ONE was there from 12:00:00 on); a write to 14";
        assert!(super::one_line(&screen).contains(remedy), "{screen}");
        // The letters are the same on the other pages.
        let letters = |stage: &Stage| {
            let side = |row: &descan::app::Row| row.board.map(|board| board.side);
            let place = |row: &descan::app::Row| (row.uid, side(row));
            stage
                .app
                .rows()
                .iter()
                .map(place)
                .filter(|(_, side)| side.is_some())
                .collect::<Vec<_>>()
        };
        let mut all = letters(&stage);
        all.sort_by_key(|(_, side)| *side);
        assert_eq!(all, [(Some(uid("ONE")), Some('A')), (Some(uid("TWO")), Some('B'))]);
        compare_with_past(&scenario, back + 20.0, back + 12.0);
    }
}

#[test]
fn boards_with_different_names_are_named_in_the_headline() {
    let boards =
        [board("ACT", "one", Uid([0xFF; 6]), 0.0), board("PUMP", "two", Uid([0xFF; 6]), 12.3)];
    let scenario = scenario(&boards);
    let mut stage = shown(&scenario, 40.0);
    snapshot!("conflict_names_80x24", stage);
    snapshot!("conflict_names_120x40", stage.size(120, 40));
    let screen = stage.screen();
    assert!(screen.contains("one board answers as ACT, the other as PUMP"), "{screen}");
    // After bus-off both begin at other times, and are no longer distinguished.
    assert!(row(&stage, "heartbeat").contains("unclear since 12:00:3"), "{screen}");
    compare_with_past(&scenario, 40.0, 35.0);
}

#[test]
fn missing_device_has_its_reasons_and_leads_to_its_row() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 G");
    snapshot!("problem_missing_80x24", stage);
    snapshot!("problem_missing_120x40", stage.size(120, 40));
    let screen = stage.screen();
    for words in
        ["PUMP is missing: listed in des.json, never received", "is listed but not on the bus"]
    {
        assert!(screen.contains(words), "{words}\n{screen}");
    }
    stage.size(80, 24).keys("Enter");
    assert!(stage.screen().contains("▸○   44 PUMP"), "{}", stage.screen());
}

#[test]
fn evidence_leads_to_its_frame_at_its_moment() {
    let config = Config { seed: 7, ..Config::default() };
    let boiler = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with_room(&boiler, None, config, ROOM);
    stage.until(45.0).keys("4 Enter");
    assert!(stage.screen().contains("▸12:00:26.8"), "{}", stage.screen());
    let piece = stage.app.selected_problem().unwrap().evidence()[2].clone();
    stage.keys("j j Enter");
    stage.wait_for_past();
    assert_eq!(stage.app.view().page, Page::Traffic);
    assert_eq!(stage.app.selected_frame(), piece.frame);
    let moment = stage.app.past_moment().unwrap();
    assert_eq!(Some(moment.frames), stage.app.captured(&piece.frame.unwrap()).map(|at| at + 1));
    assert!(stage.screen().contains("FROZEN 12:00:26.828"), "{}", stage.screen());
    // Back to the evidence, and to the problem as it was: at the present, with this piece selected.
    stage.keys("Esc Esc");
    assert_eq!(stage.app.view().page, Page::Problems);
    assert!(stage.app.past_moment().is_none(), "{}", stage.screen());
    assert_eq!((stage.app.view().focus, stage.app.view().piece), (Focus::Details, 2));
}

#[test]
fn evidence_leads_back_to_the_moment_from_which_it_was_opened() {
    let config = Config { seed: 7, ..Config::default() };
    let boiler = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with_room(&boiler, None, config, ROOM);
    stage.until(45.0).keys("4 Space").until(50.0);
    let frozen = stage.app.past_moment().unwrap();
    let problem = stage.app.selected_problem().unwrap().key;
    stage.keys("Enter j Enter");
    stage.wait_for_past();
    assert_ne!(stage.app.past_moment().unwrap(), frozen);
    stage.keys("Backspace");
    stage.wait_for_past();
    assert_eq!(stage.app.past_moment().unwrap(), frozen, "{}", stage.screen());
    assert_eq!(stage.app.selected_problem().unwrap().key, problem);
    // A moment that was chosen meanwhile stays.
    stage.keys("Enter");
    stage.wait_for_past();
    stage.keys("<");
    stage.wait_for_past();
    let chosen = stage.app.past_moment().unwrap();
    stage.keys("Backspace");
    stage.wait_for_past();
    assert_eq!(stage.app.past_moment().unwrap(), chosen);
}

#[test]
fn frames_of_a_selected_piece_begin_at_it() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 Enter j j j");
    let piece = stage.app.selected_problem().unwrap().evidence()[3].clone();
    let evidence =
        |stage: &Stage| stage.app.view().evidence.as_ref().unwrap().selected().unwrap().1.clone();
    assert_eq!(evidence(stage.keys("f")), piece);
    stage.keys("Backspace");
    assert_eq!((stage.app.view().focus, stage.app.view().piece), (Focus::Details, 3));
}

#[test]
fn row_of_a_problem_leads_back_to_it() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("4 /").text("missing").keys("Enter");
    let key = stage.app.selected_problem().unwrap().key;
    assert_eq!(stage.keys("Enter").app.view().page, Page::Devices);
    assert_eq!(stage.keys("Backspace").app.view().page, Page::Problems);
    assert_eq!(stage.app.selected_problem().unwrap().key, key);
}

#[test]
fn selected_piece_stays_in_view_and_copies() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 Enter");
    for _ in 0..40 {
        stage.keys("j").drawn();
        let selected = stage.screen().lines().filter(|line| line.starts_with('▸')).count();
        assert!(selected >= 1, "{}", stage.screen());
    }
    // Behind the last piece the details scroll to their end.
    assert!(stage.screen().contains("one-address-two-identities"), "{}", stage.screen());
    stage.effects.clear();
    stage.keys("y");
    let copied = |effect: &Effect| matches!(effect, Effect::Copy(text) if text.contains('#'));
    assert!(stage.effects.iter().any(copied), "{:?}", stage.effects);
}

#[test]
fn axis_moves_and_zooms_in_the_focused_details() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4");
    let axis = |stage: &Stage| {
        let screen = stage.screen();
        let lines = screen.lines().skip_while(|line| !line.starts_with(" time "));
        lines.take(2).map(str::to_owned).collect::<Vec<_>>()
    };
    let before = axis(&stage);
    stage.keys("Right");
    assert_eq!(axis(&stage), before, "Right goes into the details");
    stage.keys("Right Right");
    let later = axis(&stage);
    // Ten cells of a tenth of a second.
    assert_eq!(later[1].chars().nth(12), before[1].chars().nth(22), "{before:#?}\n{later:#?}");
    stage.keys("Left Left");
    assert_eq!(axis(&stage), before);
    stage.keys("-");
    assert!(stage.screen().contains("200 ms a cell"), "{}", stage.screen());
    let beats = |lines: &[String]| lines[1].matches(['A', 'a', 'B', 'b']).count();
    assert!(beats(&axis(&stage)) > beats(&before), "{:#?}", axis(&stage));
    stage.keys("-");
    assert!(stage.screen().contains("no other scale"), "{}", stage.screen());
    stage.keys("+ + +");
    assert!(stage.screen().contains("20 ms a cell"), "{}", stage.screen());
    // The axis has the keys while frozen, too; Esc leaves the details first.
    stage.keys("- - Space Right");
    assert!(stage.app.past_moment().is_some());
    assert_ne!(axis(&stage), before);
    stage.keys("Esc");
    assert!(stage.app.past_moment().is_some());
    stage.keys("1 +");
    assert!(stage.screen().contains("time bar: "), "{}", stage.screen());
}

#[test]
fn missed_heartbeats_are_marked_on_the_axis() {
    let mut lost = board("ACT", "one", uid("ONE"), 0.0);
    lost.heartbeat = Some(Duration::from_secs(1));
    let boards = [lost, board("ACT", "two", uid("TWO"), 12.3)];
    let mut stage = stage(&scenario(&boards));
    let now = |stage: &Stage| stage.app.now();
    stage.until(14.0);
    // The bus loses the frames of a second and a half.
    let start = now(&stage);
    stage.sim.advance(start + Duration::from_millis(1500));
    while stage.sim.poll_frame(stage.station).is_some() {}
    stage.until(30.0).keys("4");
    let screen = stage.size(120, 40).screen();
    let beats = screen.lines().find(|line| line.starts_with(" beats ")).expect(&screen);
    assert!(beats.contains('×'), "{screen}");
}

#[test]
fn hostile_names_and_uids_do_not_break_the_page() {
    let names: [&[u8]; 5] =
        [b"\x1b[2J", b"a|b\n# c", b"\xff\xfe\x00", " \u{202e}x".as_bytes(), b"        "];
    let uids = ["A B", "//[]\\", "<>&\"'", "_^]", "  X"];
    for (name, text) in names.into_iter().zip(uids) {
        let one = board("ACT", "one", uid(text), 0.0).name(name);
        let two = board("ACT", "two", Uid([0; 6]), 12.3).name(name);
        let mut stage = stage(&scenario(&[one, two]));
        stage.until(30.0).keys("4");
        for size in [(40, 10), (80, 24), (120, 40), (200, 50)] {
            let screen = stage.size(size.0, size.1).screen();
            let is_safe = |c: char| c == '\n' || !c.is_control();
            assert!(screen.chars().all(is_safe), "{name:?}\n{screen}");
            assert_eq!(screen.lines().count(), usize::from(size.1), "{name:?}\n{screen}");
        }
    }
}

#[test]
fn hundred_problems_leave_room_for_the_details() {
    let entries: Vec<String> = (1..=100)
        .map(|at| format!("{{\"name\":\"D{at}\",\"address\":{at},\"static\":true}}"))
        .collect();
    let file = format!("{{\"devices\":[{}]}}", entries.join(","));
    let boards = [board("ACT", "one", uid("ONE"), 0.0), board("ACT", "two", uid("TWO"), 12.3)];
    let config = Config { seed: 7, ..Config::default() };
    let mut stage = Stage::with(&scenario(&boards), Some(&file), config);
    stage.until(60.0).keys("4");
    assert!(stage.app.problems_shown().len() >= 100);
    let screen = stage.screen();
    assert!(screen.contains("A ONE · ACT") && screen.contains(" beats "), "{screen}");
    // The last one of the list is reached, and the page stays whole.
    stage.keys("G");
    assert!(stage.screen().lines().skip(4).take(5).any(|line| line.starts_with('▸')));
}

/// The letters in front of the meanings of the heartbeats of address 14 on Traffic, oldest first.
fn letters_on_traffic(stage: &mut Stage) -> Vec<String> {
    stage.size(120, 40).keys("2 /").text("src:14 srv:1").keys("Enter");
    let screen = stage.screen();
    let header = screen.lines().find(|line| line.contains("MEANING")).unwrap();
    let column = header.split("MEANING").next().unwrap().chars().count();
    let rows = screen.lines().filter(|line| line.contains(" data "));
    rows.map(|line| line.chars().skip(column).collect::<String>().trim().to_owned()).collect()
}

#[test]
fn frames_of_a_conflict_name_their_board() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    let meanings = letters_on_traffic(&mut stage);
    let of = |uid: &str, letter: &str| {
        let mut own = meanings.iter().filter(|text| text.contains(uid)).peekable();
        assert!(own.peek().is_some(), "{uid}\n{}", stage.screen());
        assert!(own.all(|text| text.starts_with(letter)), "{uid}\n{}", stage.screen());
    };
    of("BOILER03", "A ");
    of("SPARE01", "B ");
    snapshot!("traffic_conflict_120x40", stage);
    snapshot!("traffic_conflict_80x24", stage.size(80, 24));
}

#[test]
fn frames_before_the_conflict_name_no_board() {
    let boards = [board("ACT", "one", uid("ONE"), 0.0), board("ACT", "two", uid("TWO"), 12.3)];
    let mut stage = stage(&scenario(&boards));
    stage.until(40.0);
    let now = letters_on_traffic(&mut stage);
    assert!(now.iter().any(|text| text == "A WORK ONE"), "{}", stage.screen());
    stage.app.go_to_time(Instant::ZERO + Duration::from_secs(11));
    stage.wait_for_past();
    let screen = stage.screen();
    assert!(screen.contains("heartbeat WORK ONE"), "{screen}");
    assert!(!screen.contains(" A WORK") && !screen.contains("WORK TWO"), "{screen}");
}

#[test]
fn frames_of_boards_with_blank_uids_are_told_apart_by_phase() {
    let boards = [board("ACT", "one", Uid([0; 6]), 0.0), board("ACT", "two", Uid([0; 6]), 12.3)];
    let mut stage = stage(&scenario(&boards));
    stage.until(40.0);
    let meanings = letters_on_traffic(&mut stage);
    let letters: String = meanings.iter().filter_map(|text| text.chars().next()).collect();
    let turns = letters.contains("ABAB");
    assert!(turns && letters.chars().all(|letter| "AB".contains(letter)), "{letters}");
}

#[test]
fn board_that_moved_on_keeps_its_name_and_services() {
    let config = Config { seed: 7, ..Config::default() };
    let boiler = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with_room(&boiler, None, config, 16 << 20);
    stage.until(175.0).size(160, 40).keys("4");
    while stage.app.selected_problem().unwrap().head().key.address != Address::new(16) {
        stage.keys("j");
    }
    let screen = stage.screen();
    assert!(
        screen.contains(" A BOILER06 · DIN ") && screen.contains("│ B BOILER09 · HEAT"),
        "{screen}"
    );
    let words = "BOILER06 returned, may have conflicted with BOILER09 (since 12:02:33)";
    assert!(screen.contains(words) && screen.contains("never confirmed"), "{screen}");
    let services = row(&stage, "services");
    assert!(services.contains(" IN 3 ") && services.contains("RELAY"), "{services}");
}
