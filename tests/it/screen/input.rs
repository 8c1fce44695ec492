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
    assert_eq!(stage.app.rows().len(), 11);
}

#[test]
fn filter_error_names_the_cause() {
    let mut stage = Stage::boiler();
    stage.until(10.0).size(160, 24).keys("/").text("at:abc").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("\"abc\" is not an address; use 0 to 127"), "{screen}");
    stage.text(" nmae:feed").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("\"abc\" is not"), "the first mistake is told first\n{screen}");
    stage.keys("Esc /").text("nmae:feed").keys("Enter");
    let screen = stage.screen();
    assert!(stage.app.prompt().is_some(), "it is refused\n{screen}");
    assert!(screen.contains("nmae:feed: unknown field nmae;"), "{screen}");
    assert!(!stage.app.rows().is_empty(), "rows stay while it is wrong\n{screen}");
    stage.keys("Esc /").text("\"sim:boiler\"").keys("Enter");
    assert!(stage.app.prompt().is_none() && stage.app.rows().is_empty(), "{}", stage.screen());
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
    assert_eq!(rows("1", "at:14"), 2);
    assert_eq!(rows("1", "name:sens"), 2);
    assert_eq!(rows("1", "is:conflict"), 2);
    assert_eq!(rows("1", "is:clash"), 2);
    assert_eq!(rows("1", "is:missing"), 1);
    // A conflict is one line, which matches by each of its steps.
    assert_eq!(rows("3", "is:suspected"), 1);
    assert_eq!(rows("3", "is:confirmed text:spare01"), 1);
    assert!(rows("3", "is:confirmed") >= 3, "with the differences from des.json");
    assert_eq!(rows("3", "is:suspected at:14 name:act"), 1);
    assert_eq!(rows("3", "at:14 text:spare01"), 1);
    assert!(rows("3", "at:14") >= 2, "it joined, too");
    rows("2", "at:14 name:act is:ours");
}

#[test]
fn single_key_sends_only_discovery_frames() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("i");
    assert!(stage.screen().contains("identify needs a profile with"), "{}", stage.screen());
    let profile = descan::wire::profile::Profile::parse("commands.identify = 0x018").unwrap();
    let config = Config { profile: profile.into(), seed: 7, ..Config::default() };
    let scenario = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with(&scenario, Some(BOILER), config);
    stage.until(24.0);
    let sent = |stage: &Stage| {
        let ours = stage.app.capture().frames_from(0).filter(|(_, frame)| frame.is_tx);
        ours.filter(|(_, frame)| frame.platform_id().is_some_and(|id| id & 0x3FF == 0x18)).count()
    };
    stage.keys("i");
    assert!(stage.screen().contains("Send identify (service 0x018) to FEED at 10?"));
    stage.keys("n").until(25.0);
    assert_eq!(sent(&stage), 0);
    stage.keys("i y").until(26.0);
    assert_eq!(sent(&stage), 1);
}

#[test]
fn confirmation_and_path_fit_a_narrow_screen() {
    let mut stage = Stage::boiler();
    stage.until(9.0).size(40, 10).keys("D");
    let words = one_line(&stage.screen());
    let asked = "Delete the entry FEED at 10 from des.json? y yes n no";
    assert!(words.ends_with(asked), "{}", stage.screen());
    stage.keys("n W");
    let screen = stage.screen();
    assert!(screen.contains("copy as: des-20261121-120009.json"), "{screen}");
    stage.keys("Esc w");
    let screen = stage.screen();
    assert!(screen.contains("frames to: descan-20261121-120009.log"), "{screen}");
}

/// Returns the last line of the screen.
fn footer(stage: &Stage) -> String {
    stage.screen().lines().last().unwrap_or_default().to_owned()
}

#[test]
fn question_keeps_its_target_at_every_width() {
    let mut stage = Stage::boiler();
    stage.until(9.0).keys("D");
    for columns in [31, 40, 50, 60, 80, 120] {
        let words = one_line(&stage.size(columns, 10).screen());
        let asked = "Delete the entry FEED at 10 from des.json? y yes n no";
        assert!(words.ends_with(asked), "{columns}: {}", stage.screen());
    }
    stage.keys("n").file = Some(b"{".to_vec());
    stage.keys("e").text("47").keys("Enter q").size(40, 10);
    let words = one_line(&stage.screen());
    assert!(words.ends_with("1 edit is not saved. Quit anyway? y yes n no"), "{}", stage.screen());
}

#[test]
fn prompt_hint_yields_to_the_line() {
    let mut stage = Stage::boiler();
    stage.until(24.0).size(40, 10).keys("R");
    assert!(footer(&stage).ends_with("Enter renames the entry"), "{}", stage.screen());
    stage.keys("Esc /").text("is:online name:FEED");
    assert_eq!(footer(&stage).trim_end(), " filter: is:online name:FEED");
    stage.text(" and more than fits");
    let footer = footer(&stage);
    assert!(footer.starts_with(" filter: …") && footer.ends_with("than fits"), "{footer}");
    // A warning of the address in the row is not cut either.
    stage.keys("Esc Home e").text("30");
    let screen = stage.screen();
    assert!(one_line(&screen).ends_with("! 30 is used by PSU; Enter pins it anyway"), "{screen}");
}

#[test]
fn footer_offers_only_keys_that_act() {
    let mut stage = Stage::boiler();
    stage.until(24.0).size(120, 40);
    let offers = |stage: &Stage, word: &str| footer(stage).contains(word);
    assert!(!offers(&stage, "u undo") && offers(&stage, "/ filter"), "{}", footer(&stage));
    stage.keys("Enter");
    assert!(offers(&stage, "Esc back") && !offers(&stage, "Enter details"), "{}", footer(&stage));
    stage.keys("Esc e").text("47").keys("Enter").until(31.0);
    assert!(offers(&stage, "u undo"), "{}", footer(&stage));
    stage.keys("2 v");
    assert!(offers(&stage, "v calls") && offers(&stage, "Enter frames"), "{}", footer(&stage));
    let config = Config { listen_only: true, seed: 7, ..Config::default() };
    let mut empty = Stage::with(&Scenario::new(125_000), None, config);
    empty.until(9.0).size(120, 40).keys("4");
    for word in ["Enter", "m mute", "p go to", "e edit"] {
        assert!(!offers(&empty, word), "{}", footer(&empty));
    }
    assert!(!offers(empty.keys("1"), "e edit address"), "{}", footer(&empty));
}

#[test]
fn right_and_left_lead_into_and_out_of_details() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("3 Right");
    assert_eq!(stage.app.view().page, Page::Traffic);
    stage.keys("Right");
    assert!(stage.app.view().frame_details);
    stage.keys("Left");
    assert!(!stage.app.view().frame_details);
    stage.keys("Left");
    assert_eq!(stage.app.view().page, Page::Timeline);
}

#[test]
fn broken_file_without_problems_opens_no_empty_details() {
    let config = Config { listen_only: true, seed: 7, ..Config::default() };
    let mut stage = Stage::with(&Scenario::new(125_000), Some("[{]"), config);
    let before = stage.until(9.0).size(40, 10).keys("4").screen();
    assert!(before.contains(" 4 Problems ✗ "), "{before}");
    assert_eq!(stage.keys("Enter").screen(), before);
}

/// Copies the selected row and returns its text.
fn copied(stage: &mut Stage) -> String {
    stage.keys("y");
    let copied = stage.effects.iter().rev().find_map(|effect| match effect {
        Effect::Copy(text) => Some(text.clone()),
        _ => None,
    });
    copied.expect("a text is copied")
}

#[test]
fn row_of_identifiers_is_copied_and_leads_to_its_device() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("2 v /").text("id:071c0001").keys("Enter j");
    let frame = copied(&mut stage);
    assert!(frame.starts_with("071"), "{frame}");
    stage.keys("p");
    let problem = stage.app.selected_problem().map(|it| it.title());
    assert!(problem.as_ref().is_some_and(|title| title.contains("@14")), "{problem:?}");
}

#[test]
fn problem_of_no_selection_is_refused_with_the_reason() {
    let mut stage = Stage::boiler();
    stage.until(10.0).keys("3 Esc p");
    assert!(stage.screen().contains("no row is selected"), "{}", stage.screen());
}

#[test]
fn copied_problem_and_evidence_have_time_and_identity() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 Home");
    let conflict = stage.app.problems().iter().find(|it| it.title().contains("@14")).unwrap().key;
    while stage.app.selected_problem().unwrap().key != conflict {
        stage.keys("j");
    }
    let problem = copied(&mut stage);
    assert!(problem.starts_with("12:00:") && problem.contains(" – now ("), "{problem}");
    assert!(problem.contains("s) confirmed: ") && problem.contains("@14"), "{problem}");
    assert!(problem.contains("; UIDs ") && problem.contains("BOILER03"), "{problem}");
    assert!(!problem.contains(".;"), "{problem}");
    let evidence = copied(stage.keys("Right"));
    assert!(evidence.starts_with("12:00:") && evidence.contains('#'), "{evidence}");
}

#[test]
fn unpinned_device_is_offered_its_bus_address() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    while stage.app.selected_device().and_then(|it| it.name.clone()) != Some("DISP".into()) {
        stage.keys("j");
    }
    stage.keys("e");
    assert_eq!(stage.app.prompt().map(|prompt| prompt.input.value().to_owned()), Some("20".into()));
    stage.keys("Enter");
    assert!(stage.file().contains(r#""DISP", "address": 20, "static": true"#), "{}", stage.file());
}
