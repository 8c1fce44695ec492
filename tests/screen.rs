//! Keys and simulated buses in, screens out.

#[path = "common/harness.rs"]
mod harness;

use descan::app::{
    App, AppOptions, Capture, Effect, EvidenceItem, FileReading, InputCheck, Mouse, MouseKind,
    Page, Problem, SaveOutcome,
};
use descan::discovery::Config;
use descan::frame::{BusIndex, CanId, Frame};
use descan::keymap::Key;
use descan::sim::{DeviceAction, Scenario, Sim, SimStation};
use descan::status::{
    BusState, BusStatus, Link, Playback, PlaybackCommand, RateSearch, RecordingStatus,
};
use descan::theme::{BUILT_IN, Role, Theme};
use descan::time::{Duration, Instant};
use descan::ui;
use descan::wire::id::Address;
use harness::{BOILER, Stage, text_of};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;

/// A snapshot of the screen as text.
macro_rules! snapshot {
    ($name:literal, $stage:expr) => {
        insta::assert_snapshot!($name, $stage.screen())
    };
}

/// The words of a screen on one line, with one blank between them.
fn one_line(screen: &str) -> String {
    screen.split_whitespace().collect::<Vec<_>>().join(" ")
}

// ---- what it looks like -------------------------------------------------------------------

#[test]
fn devices_at_three_sizes() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    snapshot!("devices_80x24", stage);
    snapshot!("devices_120x40", stage.size(120, 40));
    snapshot!("devices_40x10", stage.size(40, 10));
    snapshot!("devices_40x10_details", stage.size(40, 10).keys("j Enter"));
}

#[test]
fn the_first_second() {
    let mut stage = Stage::boiler();
    snapshot!("start_80x24", stage);
    snapshot!("first_second_80x24", stage.until(1.0));
}

#[test]
fn details_of_a_clash_and_of_what_is_missing() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(100, 30);
    snapshot!("clash", stage.keys("j j j"));
    snapshot!("missing", stage.keys("j j j j"));
}

#[test]
fn traffic_and_its_details() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("2");
    snapshot!("traffic_80x24", stage);
    snapshot!("traffic_120x40", stage.size(120, 40));
    snapshot!("traffic_details", stage.size(80, 24).keys("Space k k k Enter"));
    snapshot!("traffic_details_40x10", stage.size(40, 10).keys("Esc Enter"));
    snapshot!("identifiers", stage.size(80, 24).keys("Esc Esc v"));
}

#[test]
fn timeline_problems_and_help() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    snapshot!("timeline_80x24", stage.keys("3"));
    snapshot!("problems_80x24", stage.keys("4"));
    snapshot!("problems_40x10", stage.size(40, 10));
    snapshot!("help_80x24", stage.size(80, 24).keys("?"));
    snapshot!("help_120x40", stage.size(120, 60));
}

#[test]
fn styles_by_role() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(60, 16);
    for theme in ["terminal", "mono"] {
        insta::assert_snapshot!(format!("styles_{theme}"), styles_of(&stage.buffer(theme)));
    }
}

/// For each row its text, and below it where which style is.
fn styles_of(buffer: &Buffer) -> String {
    use std::fmt::Write;
    let mut text = String::new();
    let width = usize::from(buffer.area.width);
    for (row, line) in buffer.content().chunks(width).zip(text_of(buffer).lines()) {
        let _ = writeln!(text, "{line}");
        let mut at = 0;
        for run in row.chunk_by(|a, b| a.style() == b.style()) {
            let style = run[0].style();
            let _ = write!(text, "    {at}–{}", at + run.len());
            at += run.len();
            let colours = [("", style.fg), ("on ", style.bg)];
            for (word, colour) in colours.into_iter().filter_map(|(word, it)| Some((word, it?))) {
                if colour != ratatui::style::Color::Reset {
                    let _ = write!(text, " {word}{colour}");
                }
            }
            if !style.add_modifier.is_empty() {
                let _ = write!(text, " {:?}", style.add_modifier);
            }
        }
        text.push('\n');
    }
    text
}

#[test]
fn every_state_is_readable_without_colour() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    for (name, _) in BUILT_IN {
        assert_eq!(text_of(&stage.buffer(name)), stage.screen(), "{name}");
    }
    let screen = stage.screen();
    for words in ["● ", "⚠   14 ACT        CONFLICT", "missing", "✓ 10", "✗ 16", "+ new", "SENS²"]
    {
        assert!(screen.contains(words), "{words}\n{screen}");
    }
}

#[test]
fn every_size_is_drawn() {
    let mut stage = Stage::boiler();
    stage.until(30.0);
    for keys in ["1", "2", "v", "v Enter", "3", "4", "?"] {
        stage.keys(keys);
        for columns in [1, 2, 7, 20, 39, 60, 75, 76, 99, 200] {
            for rows in [1, 2, 3, 6, 12, 17, 18, 50] {
                stage.size(columns, rows).screen();
            }
        }
    }
}

// ---- des.json -----------------------------------------------------------------------------

#[test]
fn an_address_is_edited_in_its_row() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("j j");
    stage.keys("e").text("12");
    snapshot!("editor_blocked", stage);
    stage.keys("Enter");
    assert_eq!(stage.file(), BOILER, "a blocked address is not saved");
    stage.keys("Ctrl-u").text("0x1E");
    snapshot!("editor_warning", stage);
    stage.keys("Ctrl-u").text("13").keys("Enter");
    assert!(stage.file().contains(r#""address": 13"#), "{}", stage.file());
    assert!(stage.screen().contains("✓ 13"));
    stage.keys("u");
    assert_eq!(stage.file(), BOILER, "undo restores every byte");
    stage.keys("Ctrl-r");
    assert!(stage.file().contains(r#""address": 13"#));
}

#[test]
fn a_file_that_is_deleted_is_said_to_be_gone() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    stage.app.handle_file(stage.app.now(), FileReading::Content(None));
    assert!(stage.screen().contains("des.json     deleted"), "{}", stage.screen());
}

#[test]
fn a_new_entry_is_selected_and_a_wrong_address_in_it_is_told() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("n").text("PUMP 200");
    let screen = stage.screen();
    assert!(screen.contains("✗ 200 is not an address (1 to 127)"), "{screen}");
    stage.keys("Enter Ctrl-u").text("PUMP 2nd");
    let screen = stage.screen();
    assert!(screen.contains("! all of it is the name: 2nd is not an address"), "{screen}");
    stage.keys("Ctrl-u").text("VALVE 99").keys("Enter");
    assert_eq!(stage.app.selected_row().unwrap().name.as_ref().unwrap().to_string(), "VALVE");
}

#[test]
fn what_blocks_and_how_to_answer_are_never_cut_off() {
    let mut stage = Stage::boiler();
    stage.until(24.0).size(40, 10).keys("n");
    assert!(stage.screen().contains("✗ name, space, address"), "{}", stage.screen());
    stage.keys("Esc e").text("128");
    assert!(stage.screen().contains("✗ not an address: 1 to 127"), "{}", stage.screen());
    stage.keys("Esc D");
    assert!(stage.screen().contains("y yes  n no"), "{}", stage.screen());
    stage.keys("n").size(80, 24).keys("n").text("PUMP 12");
    assert!(stage.screen().contains("static address of SENS (line 5)"), "{}", stage.screen());
}

#[test]
fn a_conflict_shows_both_and_lets_choose() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    // Somebody else writes in the moment before our save.
    let theirs = BOILER.replace("10", "11");
    stage.file = Some(theirs.clone().into_bytes());
    stage.keys("e").text("47").keys("Enter");
    snapshot!("conflict", stage);
    assert_eq!(stage.file(), theirs, "nothing is written before the choice");
    stage.keys("Esc j");
    assert!(stage.screen().contains("✗ conflict  Ctrl-s resolves it"), "{}", stage.screen());
    // Who asks for the page chooses as soon as he likes.
    stage.keys("Ctrl-s o");
    assert_eq!(stage.file(), BOILER.replace("10", "47"));
}

/// FEED to 70 and SENS to 71, which the disk does not take.
fn with_two_unsaved_edits() -> Stage {
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("70").keys("Enter j e").text("71").keys("Enter");
    stage.file = Some(BOILER.as_bytes().to_vec());
    stage.refuse_saves();
    stage
}

#[test]
fn each_of_two_conflicts_is_decided_alone() {
    let theirs = BOILER.replace("10", "100").replace("12", "103");
    for (keys, feed, sens, told) in [
        (["o", "o"], "70", "71", "kept your 2 values"),
        (["o", "t"], "70", "103", "kept 1 of your values, 1 of the file's"),
        (["t", "o"], "100", "71", "kept 1 of your values, 1 of the file's"),
        (["t", "t"], "100", "103", "kept the file's 2 values"),
    ] {
        let mut stage = with_two_unsaved_edits();
        stage.write(&theirs);
        let screen = stage.screen();
        assert!(screen.contains("Edit conflict 1 of 2"), "{screen}");
        assert!(screen.contains("entry FEED: 10 → 70"), "{screen}");
        let screen = stage.keys(keys[0]).screen();
        assert_eq!(stage.file(), theirs, "nothing is written before the last choice");
        assert!(screen.contains("Edit conflict 2 of 2"), "{screen}");
        assert!(screen.contains("entry SENS: 12 → 71"), "{screen}");
        assert!(screen.contains("theirs     address 103, static"), "{screen}");
        let screen = stage.keys(keys[1]).screen();
        assert!(!screen.contains("Edit conflict"), "{screen}");
        assert!(screen.contains(told), "{screen}");
        stage.unfinished.as_mut().into_iter().for_each(Vec::clear);
        assert_eq!(stage.file(), BOILER.replace("10", feed).replace("12", sens));
    }
}

#[test]
fn a_choice_is_asked_for_again_where_the_file_changed_after_it() {
    let mut stage = with_two_unsaved_edits();
    stage.write(&BOILER.replace("10", "100").replace("12", "103")).keys("o");
    let theirs = BOILER.replace("10", "101").replace("12", "103");
    let screen = stage.write(&theirs).screen();
    assert!(screen.contains("Edit conflict 1 of 2"), "{screen}");
    assert!(screen.contains("theirs     address 101, static"), "{screen}");
    stage.keys("Esc").write(&theirs);
    assert!(!stage.screen().contains("Edit conflict 1"), "the same content is no news");
    stage.keys("Ctrl-s t t");
    assert_eq!(stage.file(), theirs);
}

#[test]
fn where_the_file_goes_while_a_choice_is_open_it_stays_open() {
    for (key, after) in [("t", None), ("o", Some("\"NEW\", \"address\": 64"))] {
        let mut stage = Stage::boiler();
        stage.slow_disk().until(24.0).keys("n").text("NEW 64").keys("Enter");
        stage.file = Some(BOILER.as_bytes().to_vec());
        let theirs =
            BOILER.replace("\"PUMP\"", "\"NEW\", \"address\": 63 },\n    { \"name\": \"PUMP\"");
        stage.refuse_saves().write(&theirs);
        assert!(stage.screen().contains("theirs     address 63"), "{}", stage.screen());
        let screen = stage.remove().screen();
        assert_eq!(stage.file, None, "nothing is written before the choice");
        assert!(screen.contains("your edit  new entry NEW at 64"), "{screen}");
        assert!(screen.contains("ours       address 64, static"), "{screen}");
        assert!(screen.contains("theirs     deleted"), "{screen}");
        stage.keys(key);
        assert_eq!(stage.file.is_some(), after.is_some());
        assert!(stage.file().contains(after.unwrap_or_default()), "{}", stage.file());
        assert!(!stage.screen().contains("Edit conflict"), "{}", stage.screen());
    }
}

#[test]
fn the_page_of_a_conflict_closes_with_the_conflict() {
    let theirs = BOILER.replace("10", "100");
    // The change is taken back, or the file was only empty while it was being written, for longer
    // than is waited for.
    for contents in [[&theirs, BOILER], ["", BOILER], ["", &BOILER.replace("12", "13")]] {
        let mut stage = Stage::boiler();
        stage.slow_disk().until(24.0).keys("e").text("70").keys("Enter");
        stage.file = Some(BOILER.as_bytes().to_vec());
        stage.refuse_saves().write(contents[0]).until(25.1);
        assert!(stage.screen().contains("Edit conflict"), "{}", stage.screen());
        let screen = stage.write(contents[1]).screen();
        assert!(!screen.contains("Edit conflict"), "{screen}");
        assert!(screen.contains("conflict resolved"), "{screen}");
        assert_eq!(stage.file(), contents[1].replace("10", "70"));
    }
}

#[test]
fn nothing_is_chosen_while_the_file_is_broken() {
    let mut stage = with_two_unsaved_edits();
    stage.write(&BOILER.replace("10", "100")).write("{ broken").keys("o");
    let screen = stage.screen();
    assert!(screen.contains("Edit conflict"), "{screen}");
    assert!(screen.contains("The file cannot be read now; choose later."), "{screen}");
    stage.write(&BOILER.replace("10", "100")).keys("t");
    assert_eq!(stage.file(), BOILER.replace("10", "100").replace("12", "71"));
}

#[test]
fn a_line_being_typed_goes_on_after_a_conflict() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    // Not drained: the save is on its way while somebody else writes.
    for key in ["e", "4", "7", "Enter", "j", "e", "5"] {
        stage.app.handle_key(stage.app.now(), Key::parse(key).unwrap());
    }
    stage.write(&BOILER.replace("10", "11"));
    assert!(stage.screen().contains("Edit conflict"), "{}", stage.screen());
    stage.keys("t").text("0").keys("Enter");
    assert_eq!(stage.file(), BOILER.replace("10", "11").replace("12", "50"));
}

#[test]
fn what_somebody_else_changed_since_is_neither_taken_back_nor_made_again() {
    let with = |address: &str| BOILER.replace("10", address);
    let told = |stage: &Stage, start: &str| {
        stage.app.timeline().entries().any(|line| line.text.starts_with(start))
    };
    let refused = |stage: &mut Stage, key: &str, why: &str| {
        let before = stage.file().to_owned();
        stage.keys(key);
        let screen = stage.screen();
        assert!(screen.contains(why), "{screen}");
        assert_eq!(stage.file(), before);
        assert!(!told(stage, "redid"));
    };
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("j e").text("71").keys("Enter k e").text("100").keys("Enter");
    stage.write(&with("101").replace("12", "71"));
    let why = "not undone: address of the entry FEED: 10 → 100; on disk: address 101, static";
    refused(&mut stage, "u", why);
    assert!(!told(&stage, "undid"));
    refused(&mut stage, "Ctrl-r", "nothing to redo");
    // What is below it can be.
    stage.keys("u");
    assert_eq!(stage.file(), with("101"));

    let mut stage = Stage::boiler();
    stage.until(24.0).keys("e").text("100").keys("Enter u").write(&with("11"));
    let why = "not redone: address of the entry FEED: 10 → 100; on disk: address 11, static";
    refused(&mut stage, "Ctrl-r", why);

    // They did the same.
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("e").text("100").keys("Enter").write(BOILER);
    refused(&mut stage, "u", "already undone: address of the entry");

    let mut stage = Stage::boiler();
    stage.until(24.0).keys("n").text("NEW 64").keys("Enter");
    let theirs = stage.file().replace("64", "65");
    stage.write(&theirs);
    refused(&mut stage, "u", "not undone: new entry NEW at 64; on disk: address 65");

    let mut stage = with_two_unsaved_edits();
    stage.write(&BOILER.replace("10", "100").replace("12", "103")).keys("t t");
    refused(
        &mut stage,
        "u",
        "not undone: address of the entry SENS: 12 → 71; on disk: address 103",
    );
    refused(
        &mut stage,
        "u",
        "not undone: address of the entry FEED: 10 → 70; on disk: address 100",
    );
    refused(&mut stage, "u", "nothing to undo");
}

#[test]
fn an_unsaved_edit_that_is_taken_back_leaves_nothing_to_save() {
    // While the disk refuses it, one of two, then both.
    let mut stage = with_two_unsaved_edits();
    assert_eq!(stage.app.file().unsaved(), 2);
    stage.keys("u");
    stage.file = Some(BOILER.as_bytes().to_vec());
    stage.refuse_saves();
    assert_eq!(stage.app.file().unsaved(), 1);
    stage.keys("u").effects.clear();
    let screen = stage.screen();
    assert!(screen.contains("✓ 5 entries"), "{screen}");
    stage.keys("q");
    assert!(stage.effects.contains(&Effect::Quit), "{}", stage.screen());
    stage.keys("Ctrl-r");
    assert_eq!(stage.file(), BOILER.replace("10", "70"));

    // While it is being saved, which then fails; it quits without asking.
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("70").keys("Enter u q");
    stage.file = Some(BOILER.as_bytes().to_vec());
    stage.refuse_saves();
    assert_eq!(stage.app.file().unsaved(), 0);
    assert!(stage.effects.contains(&Effect::Quit), "{}", stage.screen());

    // While it is being saved, and is: what is on disk is to be taken back too.
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("70").keys("Enter u");
    stage.finish_saves();
    stage.finish_saves();
    assert_eq!((stage.file(), stage.app.file().unsaved()), (BOILER, 0));
}

#[test]
fn a_clash_that_two_made_together_is_named_when_it_is_saved() {
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("71").keys("Enter");
    stage.file = Some(BOILER.as_bytes().to_vec());
    let clash = "2 entries share address 71: FEED, SENS";
    // They give the address, which is still free in the file, to another.
    let theirs = BOILER.replace("12", "71");
    stage.refuse_saves().write(&theirs);
    stage.file = Some(theirs.clone().into_bytes());
    stage.refuse_saves();
    stage.keys("Ctrl-s").finish_saves();
    assert_eq!(stage.file(), theirs.replace("10", "71"));
    let told = format!("saved after retry; warning: {clash}");
    assert!(stage.screen().contains(&told), "{}", stage.screen());
    assert!(stage.app.timeline().entries().any(|line| line.text == told));

    // Nor is it silent where it is saved at once; later saves do not tell it again.
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("71").keys("Enter");
    stage.file = Some(BOILER.as_bytes().to_vec());
    stage.refuse_saves().write(&theirs).finish_saves();
    assert!(stage.screen().contains(&format!("saved; warning: {clash}")), "{}", stage.screen());
    stage.keys("R").text("X").keys("Enter").finish_saves();
    assert!(stage.file().contains("\"FEEDX\""));
    assert_eq!(
        stage.app.timeline().entries().filter(|line| line.text.contains("2 entries share")).count(),
        1
    );
}

#[test]
fn a_failed_save_is_tried_again_when_asked() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    for key in ["e", "4", "7", "Enter"] {
        stage.app.handle_key(stage.app.now(), Key::parse(key).unwrap());
    }
    let now = stage.app.now();
    while stage.app.poll_effect().is_some() {}
    stage.app.handle_saved(now, SaveOutcome::Failed("no space left on the disk".to_owned()));
    assert_eq!(stage.app.poll_effect(), None, "not again and again");
    assert!(stage.screen().contains("not saved: no space left"), "{}", stage.screen());
    // Nor does it give way on the smallest screen, when something else is said.
    for (columns, rows) in [(40, 10), (60, 14)] {
        let screen = stage.keys("r").size(columns, rows).screen();
        assert!(screen.lines().next().unwrap().contains("✗ not saved"), "{screen}");
    }
    stage.size(80, 24);
    stage.keys("Ctrl-s");
    assert_eq!(stage.file(), BOILER.replace("10", "47"));
    assert!(stage.screen().contains("✓ 5 entries"));
}

#[test]
fn a_failed_save_is_tried_again_after_a_while_and_told_once() {
    let mut stage = Stage::boiler();
    let refused = || SaveOutcome::Failed("no space left on the disk".to_owned());
    stage.slow_disk().until(24.0).keys("e").text("47").keys("Enter");
    for failures in 1..=3 {
        stage.file = Some(BOILER.as_bytes().to_vec());
        stage.unfinished = Some(vec![refused()]);
        stage.finish_saves();
        let entries = stage.app.timeline().entries();
        let told = entries.filter(|entry| entry.text.contains("no space left")).count();
        assert_eq!(told, 1, "after {failures}");
        let message = stage.app.message().is_some_and(|message| message.is_error);
        assert_eq!(message, failures == 1);
        let seconds = 24.0 + 11.0 * f64::from(failures);
        stage.unfinished = Some(Vec::new());
        stage.until(seconds);
        assert_eq!(stage.unfinished.as_ref().unwrap().len(), 1, "tried once more");
        assert!(stage.screen().contains("not saved: no space left"), "{}", stage.screen());
    }
    stage.finish_saves();
    assert_eq!(stage.file(), BOILER.replace("10", "47"));
    assert!(stage.screen().contains("saved after retry"), "{}", stage.screen());
    stage.unfinished = Some(Vec::new());
    stage.until(90.0);
    assert!(stage.unfinished.unwrap().is_empty(), "and not again");
}

#[test]
fn a_copy_is_saved_elsewhere() {
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("47").keys("Enter");
    stage.unfinished = Some(vec![SaveOutcome::Failed("disk full".to_owned())]);
    stage.finish_saves().until(31.0);
    assert!(stage.screen().contains("Ctrl-s save again  W save a copy"), "{}", stage.screen());
    stage.keys("W");
    assert!(stage.screen().contains("save a copy as: des-20261121-120031.json"));
    stage.keys("Ctrl-u").text("/else/b.json").keys("Enter");
    let path = std::path::PathBuf::from("/else/b.json");
    let bytes = BOILER.replace("10", "47").into_bytes();
    assert_eq!(stage.effects.last(), Some(&Effect::WriteFile { path: path.clone(), bytes }));
    stage.app.handle_written(stage.app.now(), &path, Err("no such folder".to_owned()));
    assert!(stage.screen().contains(" not saved: no such folder"), "{}", stage.screen());
    assert!(stage.keys("q").screen().contains("1 edit is not saved. Quit anyway?"));
    stage.keys("n W Ctrl-u").text("/else/b.json").keys("Enter");
    stage.app.handle_written(stage.app.now(), &path, Ok(()));
    assert!(stage.screen().contains("a copy with all edits: /else/b.json"));
    assert!(
        stage.keys("q").screen().contains("1 edit is saved only in /else/b.json. Quit anyway?")
    );
    // What was edited since is not in it.
    stage.keys("n R").text("X").keys("Enter");
    stage.unfinished = Some(vec![SaveOutcome::Failed("disk full".to_owned())]);
    stage.finish_saves().keys("q");
    assert!(stage.screen().contains("2 edits are not saved. Quit anyway?"));
}

#[test]
fn a_broken_file_is_shown_and_never_written() {
    let mut stage = Stage::boiler();
    let broken = BOILER.replace("\"SENS\",", "\"SENS\"");
    stage.until(24.0).write(&broken).keys("j");
    snapshot!("broken_file", stage);
    stage.keys("e");
    assert!(stage.app.prompt().is_none());
    stage.keys("A");
    assert_eq!(stage.file(), broken);
    assert!(stage.screen().contains("✓ 10"), "the last good content stays in force");
    for page in ["3", "4"] {
        let screen = stage.keys(page).screen();
        let lines: Vec<&str> = screen.lines().collect();
        let at = lines
            .iter()
            .position(|line| line.contains("{ \"name\": \"SENS\" \"address\""))
            .unwrap();
        let place = |line: &str, what: &str| line.split(what).next().unwrap().chars().count();
        assert_eq!(place(lines[at], "\"address\""), place(lines[at + 1], "^"), "{screen}");
        assert!(lines[at - 2..at].concat().contains("line 5, column 22"), "{screen}");
    }
}

#[test]
fn where_no_content_was_ever_good_none_is_said_to_stay() {
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some("[{]"));
    let screen = stage.until(9.0).size(120, 40).screen();
    assert!(screen.contains("des.json ✗ line 1, column 3"), "{screen}");
    assert!(!screen.contains("last valid"), "{screen}");
    stage.write("[]").write("[{]");
    assert!(stage.screen().contains("using last valid: 0 entries"), "{}", stage.screen());
}

#[test]
fn a_wrong_value_leads_to_its_row() {
    let file = BOILER.replace("16, \"static\": true", "16, \"static\": 1").replace("\"PUMP\"", "7");
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(&file));
    stage.until(24.0).keys("4 /").text("invalid").keys("Enter g");
    assert!(stage.screen().contains("`static` is a number"), "{}", stage.screen());
    assert!(stage.screen().contains("Enter go to row"), "{}", stage.screen());
    stage.keys("Enter");
    let name = stage.app.selected_row().and_then(|row| row.name.clone()).unwrap().to_string();
    assert_eq!((stage.app.view().page, name), (Page::Devices, "ACT".to_owned()));
    // And the row says it.
    let screen = stage.size(120, 40).screen();
    assert!(screen.contains("  16!"), "{screen}");
    assert!(screen.contains("! `static` is a number; it must"), "{screen}");
    // What readers disagree about is not edited, and that is told before anything is typed.
    let twice = BOILER.replace("\"address\": 10", "\"address\": 9, \"address\": 10");
    for key in ["e", "R"] {
        let screen = stage.write(&twice).size(80, 24).keys("1 g").keys(key).screen();
        assert!(stage.app.prompt().is_none());
        let said = "line 3, column 37: duplicate `address`: remove one of them first";
        assert!(screen.contains(said), "{screen}");
    }
    stage.write(&file).size(120, 40).wait_until(60.0);
    // What is no entry has no row.
    stage.keys("4 g j");
    assert!(stage.screen().contains("has no `name`"), "{}", stage.screen());
    stage.keys("Enter");
    assert_eq!(stage.app.view().page, Page::Problems);
    assert!(stage.screen().contains("concerns the file as a whole"), "{}", stage.screen());
}

#[test]
fn wrong_values_are_told_apart_in_their_rows() {
    let file = BOILER
        .replace("16, \"static\": true", "300, \"static\": 1")
        .replace("\"address\": 20", "\"address\": 200, \"services\": [1, 2]")
        .replace("\"address\": 44", "\"address\": 44, \"address\": 45")
        .replace("]\n}", ", 7, {}, {}]\n}");
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(&file));
    let screen = stage.until(24.0).keys("4 /").text("file-shape").keys("Enter").screen();
    let rows = [
        "line 6: `address` is 300  ACT",
        "line 6: `static` is a number  ACT",
        "line 7: `address` is 200  DISP",
        "line 7: `services` item 1 is a number  DISP",
        "line 7: `services` item 2 is a number  DISP",
        "line 8: duplicate `address`  PUMP",
        "line 9: element 6 is a number, not a device",
        "line 9: device 7 has no `name`",
        "line 9: device 8 has no `name`",
    ];
    // What is too long for its row is cut off, and what it says first is enough.
    for (row, line) in rows.iter().zip(screen.lines().skip(4)) {
        let shown: String = row.chars().take(31).collect();
        assert!(line.contains(&shown), "{row}\n{screen}");
    }
    // What is muted is one of them, and stays it when lines are put in above.
    let muted = |stage: &Stage| {
        let screen = stage.screen();
        let mut rows = screen.lines().filter(|line| line.contains("muted · line"));
        (rows.next().map(str::to_owned), rows.count())
    };
    stage.keys("Ctrl-u /").keys("Ctrl-u").text("static").keys("Enter m / Ctrl-u Enter");
    assert!(muted(&stage).0.is_some_and(|row| row.contains("line 6: `static`")));
    stage.write(&file.replace("  \"devices\"", "\n  \"devices\""));
    let (row, others) = muted(&stage);
    assert!(row.is_some_and(|row| row.contains("line 7: `static`")), "{}", stage.screen());
    assert_eq!(others, 0);
}

#[test]
fn devices_are_taken_into_a_file_that_is_begun() {
    let mut stage = Stage::new(&Scenario::crowd(500_000, 3, 2), None);
    stage.until(5.0).keys("A");
    insta::assert_snapshot!("begun_file", stage.file());
    stage.keys("D");
    assert!(stage.screen().contains("Delete the entry N001 at"));
    stage.keys("n");
    assert_eq!(stage.file().matches("name").count(), 3 + 9);
    stage.keys("D y");
    assert_eq!(stage.file().matches("name").count(), 2 + 6);
    stage.keys("n").text("PUMP 44").keys("Enter");
    assert!(stage.file().contains("PUMP"));
    stage.keys("u u u");
    assert_eq!(stage.file().trim(), "{\n  \"devices\": []\n}");
}

#[test]
fn of_two_at_one_address_no_uid_is_taken_into_the_file() {
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some("[]"));
    stage.until(40.0).keys("A");
    let file = stage.file();
    assert!(file.contains("ACT") && file.contains("BOILER01"), "{file}");
    assert!(!file.contains("BOILER03") && !file.contains("SPARE01"), "{file}");
}

#[test]
fn quitting_asks_while_edits_are_not_saved() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("q");
    assert!(stage.effects.contains(&Effect::Quit));
    stage.effects.clear();
    stage.file = Some(b"{".to_vec());
    stage.keys("e").text("47").keys("Enter q");
    assert!(stage.screen().contains("1 edit is not saved. Quit anyway?"));
    stage.keys("n q y");
    assert!(stage.effects.contains(&Effect::Quit));
}

#[test]
fn quitting_goes_on_once_everything_is_saved() {
    // Two edits, of which the second waits for the first: quitting waits for both.
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("47").keys("Enter R").text("X").keys("Enter q");
    assert!(stage.screen().contains("2 edits are still being saved"), "{}", stage.screen());
    stage.finish_saves();
    assert!(stage.screen().contains("1 edit is still being saved"), "{}", stage.screen());
    assert!(!stage.effects.contains(&Effect::Quit));
    stage.finish_saves();
    assert!(stage.effects.contains(&Effect::Quit));
    assert!(!stage.screen().contains("Quit"), "{}", stage.screen());

    // No is no, whatever is saved afterwards.
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("47").keys("Enter q n");
    stage.finish_saves();
    assert!(!stage.effects.contains(&Effect::Quit));

    // A save that fails is a reason to ask, not to go.
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("47").keys("Enter q");
    stage.unfinished = Some(vec![SaveOutcome::Failed("disk full".to_owned())]);
    stage.finish_saves();
    assert!(!stage.effects.contains(&Effect::Quit));
    let screen = stage.screen();
    assert!(screen.contains("1 edit is not saved. Quit anyway?"), "{screen}");
    stage.keys("n");
    assert!(stage.screen().contains("disk full"), "{}", stage.screen());
}

// ---- buses that are not there any more, or not yet ------------------------------------------

impl Stage {
    /// Lets time pass, but no frame come, until `seconds` after the start or until nothing is due.
    fn wait_until(&mut self, seconds: f64) -> &mut Self {
        let end = Instant::ZERO + Duration::from_secs_f64(seconds);
        while let Some(at) = self.app.poll_timeout().filter(|at| *at <= end) {
            self.app.handle_timeout(at);
            self.drain(at);
        }
        self
    }

    fn link(&mut self, link: Link) -> &mut Self {
        let status = BusStatus { link, ..BusStatus::default() };
        self.app.handle_bus(self.app.now(), BusIndex(0), status);
        self
    }
}

#[test]
fn a_log_that_is_over_shows_what_was_there_at_its_end() {
    let config = Config { seed: 7, listen_only: true, ..Config::default() };
    let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), Some(BOILER), config);
    stage.until(24.0).link(Link::Ended).wait_until(24.5);
    stage.app.handle_file(stage.app.now(), FileReading::Content(stage.file.clone()));
    let before = stage.screen();
    assert!(before.contains("end of log") && before.contains("9 present"), "{before}");
    stage.wait_until(600.0).app.handle_resize(80, 24);
    assert_eq!(stage.screen(), before);
    // An edit beside it long afterwards changes no device either.
    let at = Instant::ZERO + Duration::from_secs_f64(600.0);
    stage.app.handle_file(at, FileReading::Content(Some(b"[]".to_vec())));
    let screen = stage.screen();
    assert!(screen.contains("9 present") && screen.contains("online 23s"), "{screen}");
    assert_eq!(stage.app.poll_timeout(), None, "nothing is due any more");
}

#[test]
fn that_nobody_acknowledges_is_not_said_of_a_bus_that_is_not_there() {
    for link in [Link::Missing, Link::Down, Link::NoKernel] {
        let config = Config { seed: 7, echo: true, ..Config::default() };
        let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), None, config);
        stage.link(link).wait_until(20.0).keys("3");
        let screen = stage.screen();
        assert!(!screen.contains("no ACK"), "{screen}");
        assert!(!screen.contains("using address"), "{screen}");
        stage.link(Link::Up).wait_until(40.0).keys("3");
        let screen = stage.screen();
        assert!(screen.contains("using address 0"), "{screen}");
        assert!(screen.contains("no ACK on the bus"), "{screen}");
    }
}

#[test]
fn where_a_bus_cannot_be_seen_it_is_not_said_that_nothing_is_wrong() {
    let mut stage = Stage::boiler();
    let status = BusStatus {
        link: Link::Down,
        message: Some(
            "can0 is down, and its bit rate is not set: sudo ip link set can0 up type can bitrate \
             125000"
                .to_owned(),
        ),
        ..BusStatus::default()
    };
    stage.app.handle_file(stage.app.now(), FileReading::Content(None));
    stage.app.handle_bus(Instant::ZERO, BusIndex(0), status);
    for (page, says) in [("1", "no device: no bus is up"), ("4", "no problems so far")] {
        let screen = stage.keys(page).screen();
        assert!(screen.contains(says), "{screen}");
        assert!(!screen.contains("no problems found"), "{screen}");
        // The way out, on several lines where one is too short.
        let words = screen.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>();
        assert!(words.join(" ").contains("can bitrate 125000"), "{screen}");
    }
    stage.link(Link::Up);
    let screen = stage.keys("4").screen();
    assert!(screen.contains("no problems found"), "{screen}");
}

#[test]
fn what_an_interface_is_called_now_and_where_frames_were_lost_is_shown() {
    let mut stage = Stage::boiler();
    let status = BusStatus {
        link: Link::Up,
        renamed: Some("front".to_owned()),
        kernel_drops: 9,
        queue_drops: 3,
        receive_buffer: Some(425_984),
        note: Some("there is\u{1b}more to know".to_owned()),
        ..BusStatus::default()
    };
    stage.app.handle_bus(Instant::ZERO, BusIndex(0), status);
    let screen = stage.screen();
    assert!(screen.contains("can0 (now front)") && screen.contains("lost 12"), "{screen}");
    let screen = stage.size(120, 60).screen();
    assert!(screen.contains("lost 12 (9 kernel, 3 queue)"), "{screen}");
    let screen = stage.size(120, 200).keys("?").screen();
    assert!(screen.contains("receive buffer 425 kB, about 532 frames"), "{screen}");
    assert!(screen.contains("there is\\x1Bmore to know"), "{screen}");
}

#[test]
fn what_cannot_be_read_is_a_line_of_the_timeline_once_whatever_came_with_it() {
    let mut stage = Stage::boiler();
    for unreadable in [0, 3, 4, 700] {
        let note = (unreadable > 0).then(|| "adapter: V1013".to_owned());
        let status = BusStatus { link: Link::Up, unreadable, note, ..BusStatus::default() };
        stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    }
    let screen = stage.keys("3").screen();
    assert_eq!(screen.matches("unreadable data received").count(), 1, "{screen}");
    assert_eq!(screen.matches("adapter: V1013").count(), 1, "{screen}");
}

#[test]
fn what_is_broken_takes_the_bus_too() {
    let config = Config { seed: 7, listen_only: true, ..Config::default() };
    let mut stage = Stage::with(&Scenario::new(125_000), None, config);
    stage.link(Link::Up);
    // A stuff error a millisecond, each at least 17 bits; that the state changed is no frame.
    for millis in 0..1000 {
        let at = Instant::ZERO + Duration::from_millis(millis);
        let stuff = Frame::error(0x88, &[0, 0, 4, 0, 0, 0, 0, 0]).with_time(at);
        let passive = Frame::error(0x04, &[0, 4, 0, 0, 0, 0, 0, 96]).with_time(at);
        stage.app.handle_frames(at, &[stuff, passive]);
    }
    let screen = stage.wait_until(1.5).screen();
    assert!(screen.contains("load ≈14%"), "{screen}");
    let status = BusStatus { link: Link::Up, bitrate: Some(125_000), ..BusStatus::default() };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    assert!(stage.screen().contains("load  14%"), "{}", stage.screen());
}

#[test]
fn a_device_that_never_came_is_not_said_to_be_seen() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("4 /").text("missing").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("kind missing") && !screen.contains("first 12:"), "{screen}");
}

#[test]
fn escape_leads_from_the_frames_of_a_line_back_to_it() {
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
    // Whoever went somewhere else is not led back.
    stage.keys("Enter 1 2 Esc");
    assert_eq!(stage.app.view().page, Page::Traffic);
}

#[test]
fn a_line_being_typed_is_shown_whole_where_there_is_room() {
    let mut stage = Stage::boiler();
    stage.until(3.0).keys("w");
    assert!(stage.screen().contains("save frames to: descan-20261121-"), "{}", stage.screen());
}

#[test]
fn that_an_address_is_pinned_already_is_said() {
    let mut stage = Stage::boiler();
    stage.until(3.0).keys("g e");
    assert!(stage.screen().contains("already pinned to 10"), "{}", stage.screen());
    stage.keys("Backspace").text("1");
    assert!(stage.screen().contains("Enter pins it to 11"), "{}", stage.screen());
}

// ---- looking ------------------------------------------------------------------------------

#[test]
fn the_selection_follows_its_device() {
    let mut stage = Stage::boiler();
    stage.until(3.0);
    let select = |stage: &mut Stage, name: &str| {
        for _ in 0..20 {
            let row = stage.app.selected_row().unwrap();
            if row.name.as_ref().is_some_and(|it| it.to_string() == name) {
                return;
            }
            stage.keys("j");
        }
        panic!("no {name}\n{}", stage.screen());
    };
    select(&mut stage, "PSU");
    stage.until(22.0);
    assert_eq!(stage.app.selected_row().unwrap().name.as_ref().unwrap().to_string(), "PSU");
    // A listed device that comes: from the file's row to the device's.
    let mut stage = Stage::boiler();
    stage.until(3.0);
    select(&mut stage, "ACT");
    assert!(stage.app.selected_device().is_none());
    stage.until(22.0);
    assert!(stage.app.selected_device().unwrap().is_named(b"ACT"));
}

#[test]
fn filters_show_less() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("/").text("sens");
    snapshot!("filter_devices", stage);
    stage.keys("Enter 2 /").text("src:act srv:des").keys("Enter");
    snapshot!("filter_traffic", stage);
    stage.keys("Esc 1 Esc");
    assert_eq!(stage.app.rows().len(), 10);
}

#[test]
fn a_filter_that_nothing_can_fit_is_explained() {
    let mut stage = Stage::boiler();
    stage.until(10.0).keys("/").text("at:abc").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("\"abc\" is not an address; use 0 to 127"), "{screen}");
    stage.keys("/").text(" nmae:feed").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("at:abc"), "the first mistake is told first\n{screen}");
    stage.keys("Esc /").text("nmae:feed").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("nmae:feed: unknown field nmae;"), "{screen}");
    assert!(one_line(&screen).contains(" id: is: bus:"), "to its end\n{screen}");
}

#[test]
fn a_device_has_its_whole_story_under_its_name() {
    let mut stage = Stage::boiler();
    stage.until(170.0).size(100, 24).keys("3 /").text("heat").keys("Enter");
    // It claimed 16 before it had a row, and held it under a row that is DIN's now.
    snapshot!("story_of_heat", stage);
    stage.keys("Esc /").text("dev:disp").keys("Enter");
    snapshot!("story_of_disp", stage);
}

#[test]
fn an_address_of_ours_that_another_uses_is_named_as_the_cause() {
    let address = Address::new(12);
    let config = Config { seed: 7, address, ..Config::default() };
    let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), Some(BOILER), config);
    stage.until(8.0);
    snapshot!("address_in_use_80x24", stage);
    snapshot!("address_in_use_40x10", stage.size(40, 10));
    let lines: Vec<_> = stage.app.timeline().entries().map(|line| line.text.as_str()).collect();
    let ours: Vec<_> = lines.iter().filter(|line| line.contains("uses address")).collect();
    assert_eq!(ours, [&"another node uses address 12: requests paused until it is free"]);
}

#[test]
fn a_log_is_played_by_keys_and_a_bus_is_not() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("P");
    assert!(stage.screen().contains("only a log can be paused"), "{}", stage.screen());
    let mut playback = Playback { speed: 1.0, is_paused: false, is_ended: false };
    let now = stage.app.now();
    stage.app.handle_playback(now, playback);
    stage.effects.clear();
    let asked = [
        PlaybackCommand::Pause,
        PlaybackCommand::Step,
        PlaybackCommand::Slower,
        PlaybackCommand::Faster,
    ];
    stage.keys("P > [ ]");
    assert_eq!(stage.effects, asked.map(Effect::Playback));
    (playback.speed, playback.is_paused) = (0.5, true);
    stage.app.handle_playback(now, playback);
    assert!(stage.screen().contains("PAUSED 0:24 ×1/2"), "{}", stage.screen());
    // While time stands, what a step brings is drawn at once.
    stage.app.take_dirty();
    let heartbeat = Frame::classic(0x07B4_3C01, &[0x8A, 0xFA, 0x6C, 0x97, 0x24, 0x12, 4, 0]);
    stage.app.handle_frames(now, &[heartbeat.with_time(now)]);
    stage.app.handle_timeout(now);
    assert!(stage.app.is_dirty());
}

#[test]
fn a_recording_is_seen_on_every_screen_and_so_is_its_end() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    let mut status = RecordingStatus {
        path: "session.log".to_owned(),
        files: 1,
        frames: 5_123,
        bytes: 312_456,
        ..RecordingStatus::default()
    };
    let now = stage.app.now();
    stage.app.handle_recording(now, status.clone());
    for (columns, rows) in [(80, 24), (120, 40), (160, 40), (40, 10), (60, 12)] {
        let text = stage.size(columns, rows).screen();
        assert!(text.contains("● rec 312 kB"), "{columns}×{rows}\n{text}");
    }
    assert!(stage.size(80, 24).keys("3").screen().contains("recording to session.log"));
    (status.bytes, status.lost) = (12_345_678, 34);
    stage.app.handle_recording(now, status.clone());
    assert!(stage.screen().contains("● rec 12 MB lost 34"), "{}", stage.screen());
    status.failure = Some("the disk is full".to_owned());
    stage.app.handle_recording(now, status);
    let text = stage.screen();
    assert!(text.contains("✗ rec stopped"), "{text}");
    assert_eq!(text.matches("recording to session.log stopped: the disk is full").count(), 2);
}

#[test]
fn freezing_holds_the_frames_and_loses_none() {
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
fn rows_are_sorted_by_each_column_in_turn() {
    let file = r#"{"devices": [
  {"name": "FEED", "services": [{"name": "OTHER"}]},
  {"name": "SENS", "address": 12, "static": true},
  {"name": "DISP", "address": 21, "static": true},
  {"name": "IGNITER", "address": 17, "static": true}
]}
"#;
    let mut stage =
        Stage::with(&Scenario::builtin("boiler").unwrap(), Some(file), Config::default());
    stage.until(36.0);
    let first = |stage: &Stage, count: usize| -> Vec<String> {
        let rows = stage.app.rows().iter().take(count);
        rows.map(|row| row.name.as_ref().unwrap().to_string()).collect()
    };
    for (sorted, expected) in [
        ("by name", ["ACT", "DIN", "DISP"]),
        ("by severity", ["ACT", "IGNITER", "FEED"]),
        ("by mode", ["NEW", "FEED", "SENS"]),
        ("newest first", ["NEW", "GSM-MODEM", "DIN"]),
        ("by difference from the file", ["IGNITER", "FEED", "DISP"]),
        ("by address", ["FEED", "SENS", "SENS"]),
    ] {
        let screen = stage.keys("s").screen();
        assert!(screen.contains(&format!("sorted {sorted}")), "{screen}");
        assert_eq!(first(&stage, 3), expected, "{sorted}\n{screen}");
        let header = screen.lines().nth(3).unwrap();
        assert_eq!(header.contains('↓'), sorted != "by address", "{screen}");
    }
}

#[test]
fn rows_that_are_held_are_sorted_when_asked() {
    let mut stage = Stage::boiler();
    stage.until(20.0).keys("Space").until(24.0).keys("s");
    let mut names: Vec<String> = Vec::new();
    for row in stage.app.rows() {
        names.extend(row.name.as_ref().map(ToString::to_string));
    }
    assert!(names.is_sorted(), "{names:?}");
}

#[test]
fn the_russian_layout_works() {
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
fn the_mouse_selects_and_turns_pages() {
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
fn the_timeline_leads_to_the_frames() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("3 k k Enter");
    assert_eq!(stage.app.view().page, Page::Traffic);
    let number = stage.app.view().traffic.unwrap();
    let frame = stage.app.capture().get(number).unwrap();
    assert!(frame.time > Instant::ZERO + Duration::from_secs(26), "{}", frame.time);
}

#[test]
fn every_action_is_in_the_help() {
    let mut stage = Stage::boiler();
    assert!(!stage.size(80, 200).keys("?").screen().contains("The log"), "there is none");
    let now = stage.app.now();
    let playback = Playback { speed: 1.0, is_paused: false, is_ended: false };
    stage.app.handle_playback(now, playback);
    let screen = stage.screen();
    for action in descan::keymap::ACTIONS {
        let words: Vec<&str> = action.doc.split(' ').take(3).collect();
        assert!(screen.contains(&words.join(" ")), "{}: {}", action.name, action.doc);
        assert!(screen.contains(action.keys[0]), "{}", action.name);
    }
    for role in [Role::Online, Role::Collision] {
        assert!(!role.doc().is_empty());
    }
}

// ---- problems -----------------------------------------------------------------------------

/// The problems as they stand in the list: sign, muted or not, what.
fn problems(stage: &Stage) -> Vec<String> {
    let shown = stage.app.problems_shown();
    let line = |problem: &Problem| {
        let muted = if problem.is_muted { "muted " } else { "" };
        format!("{muted}{} {}", problem.confidence(), problem.title())
    };
    shown.iter().map(line).collect()
}

fn selected(stage: &Stage) -> String {
    stage.app.selected_problem().map_or_else(String::new, |problem| problem.title())
}

/// So many foreign frames that the capture has room for no others.
fn flood(stage: &mut Stage) {
    let now = stage.app.now();
    let frame = Frame::with(CanId::Standard(0x123), &[]).with_time(now);
    stage.app.handle_frames(now, &vec![frame; Capture::FRAMES]);
}

#[test]
fn what_is_sure_comes_before_suspicions_and_these_before_what_is_over() {
    let mut stage = Stage::boiler();
    stage.until(30.5).keys("4");
    assert_eq!(
        problems(&stage),
        [
            "confirmed static address taken @16",
            "confirmed wrong address @14",
            "confirmed missing @44",
            "suspected address conflict (same name) @14",
        ]
    );
    snapshot!("problems_suspected_120x40", stage.size(120, 40).keys("G"));
    for (size, status) in [((80, 24), "○ 1 missing  ⚠ 3  ? 1"), ((40, 10), "○ 1  ⚠ 3  ? 1")]
    {
        let screen = stage.size(size.0, size.1).screen();
        assert!(screen.contains(status), "{screen}");
    }
    assert!(stage.screen().contains(" 4 Problems ⚠3 ?1 "), "{}", stage.screen());
    stage.until(45.0);
    assert_eq!(problems(&stage)[0], "confirmed address conflict (same name) @14");
    stage.until(130.0);
    let last = problems(&stage).pop().unwrap();
    assert!(last.starts_with("cleared "), "{:?}", problems(&stage));
    snapshot!("problems_over_80x24", stage.size(80, 24).keys("G"));
}

#[test]
fn a_collision_is_one_problem_whatever_shows_it() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4");
    let findings = stage.app.findings().filter(|finding| finding.key.kind.is_conflict()).count();
    let problem = stage.app.selected_problem().unwrap();
    assert_eq!((findings, problem.findings.len()), (2, 2));
    let evidence = problem.evidence();
    assert!(evidence.is_sorted_by_key(|piece| piece.time));
    for finding in &problem.findings {
        for piece in &finding.evidence {
            let is_it = |own: &&EvidenceItem| own.time == piece.time && own.frame == piece.frame;
            let kept = evidence.iter().find(is_it).unwrap();
            assert!(kept.what.contains(&*piece.what), "{kept:?} is not {piece:?}");
        }
    }
    let counts = stage.app.counts();
    assert_eq!((counts.confirmed, counts.suspected), (4, 0));
    let screen = stage.size(80, 100).screen();
    for words in [
        "Two devices answer as ACT",
        "heartbeats alternate between",
        "same-name-same-address",
        "one-address-two-identities",
        "ACT→own DES name ACT",
        "051C0002#050141435400",
    ] {
        assert!(screen.contains(words), "{words}\n{screen}");
    }
}

#[test]
fn text_that_was_scrolled_past_its_end_comes_back_at_once() {
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), None);
    stage.until(12.0).size(80, 24).keys("?");
    let top = stage.screen();
    let end = stage.keys("G").drawn().screen();
    assert_ne!(end, top);
    assert!(!end.contains("more"), "{end}");
    assert_eq!(stage.keys("Down Down PgDn").drawn().screen(), end, "there is no more");
    assert_ne!(stage.keys("Up").drawn().screen(), end);
    assert_eq!(stage.keys("g").drawn().screen(), top);
    assert!(stage.keys("PgDn PgUp").drawn().screen() == top, "a screenful down and up");
    let details = stage.keys("Esc Right").drawn().screen();
    let end = stage.keys("G Down Down").drawn().screen();
    assert_ne!(end, details);
    assert_ne!(stage.keys("Up").drawn().screen(), end);
}

#[test]
fn errors_that_follow_an_address_belong_to_its_problem() {
    use descan::sim::{DeviceSpec, Fault};
    let act = |label: &str, service: &str| {
        let mut device = DeviceSpec::new("ACT").label(label).fixed(101).settled();
        device.delay = (Duration::from_millis(2), Duration::from_millis(2));
        device.service(service, "1.0").fault(Fault::NeverGivesWay)
    };
    let scenario =
        Scenario::crowd(125_000, 10, 3).with(act("one", "PUMP")).with(act("other", "VALVE"));
    let mut stage = Stage::new(&scenario, None);
    stage.until(15.0).keys("4").size(80, 40);
    snapshot!("problems_errors", stage);
    snapshot!("evidence_errors", stage.keys("Enter").size(100, 30));
}

/// After some seconds on a bus on which there is only this, a hundred times a second.
fn hearing_only(frame: Frame) -> Stage {
    let mut stage = Stage::new(&Scenario::new(125_000), None);
    for millis in 1..4500 {
        let now = Instant::from_micros(millis * 1000);
        if millis % 10 == 0 {
            stage.app.handle_frames(now, &[frame.with_time(now)]);
        }
        stage.app.handle_timeout(now);
        stage.drain(now);
    }
    stage
}

#[test]
fn where_frames_only_break_another_bit_rate_is_offered() {
    use descan::bitrate::{RateResult, SearchOutcome, SearchProgress};
    let mut stage = hearing_only(Frame::error(0x88, &[0, 0, 4, 0, 0, 0, 0, 0]));
    snapshot!("only_broken_frames", stage);
    stage.effects.clear();
    stage.keys("b");
    let asked = "Search can0's bit rate, listen-only? The interface restarts.";
    assert!(stage.screen().contains(asked), "{}", stage.screen());
    stage.keys("n");
    assert!(!stage.effects.contains(&Effect::FindBitrate(BusIndex(0))), "asked, and refused");
    stage.keys("b y");
    assert!(stage.effects.contains(&Effect::FindBitrate(BusIndex(0))));
    stage.keys("b");
    assert!(stage.screen().contains("bit rate search on can0 is already running"), "not twice");

    let (now, can0) = (stage.app.now(), BusIndex(0));
    let mut told = |progress| stage.app.handle_bitrate_search(now, can0, progress);
    told(SearchProgress::Trying(125_000));
    told(SearchProgress::Heard(125_000, RateResult { frames: 0, broken: 64 }));
    told(SearchProgress::Heard(250_000, RateResult::default()));
    told(SearchProgress::Trying(500_000));
    assert!(stage.screen().contains("can0: listening at 500 kbit/s"), "{}", stage.screen());
    assert!(!stage.screen().contains("wrong bit rate"), "what is done is not offered");
    // Meanwhile it goes down and up, which is nothing to act on.
    stage.link(Link::Down);
    assert!(stage.screen().contains("searching bit rate"), "{}", stage.screen());
    assert!(!stage.screen().contains("DOWN") && !stage.screen().contains("can0 down"));
    stage.link(Link::Up);
    stage.app.handle_bitrate(now, can0, Ok(SearchOutcome::Found(500_000)));
    snapshot!("bit_rate_found", stage.keys("3"));
    stage.keys("b y").app.handle_bitrate(now, can0, Ok(SearchOutcome::Silence));
    assert!(
        stage.screen().contains("if only one device is on, run: descan speed can0"),
        "{}",
        stage.screen()
    );
    // A whole frame, and nothing is offered any more.
    let heartbeat = Frame::classic(0x0718_0001, &[0, 0, 0, 0, 0, 0, 4, 0]);
    stage.app.handle_frames(now, &[heartbeat.with_time(now)]);
    stage.wait_until(6.0);
    assert!(!stage.screen().contains("wrong bit rate"), "{}", stage.screen());
}

#[test]
fn where_nobody_acknowledges_no_other_bit_rate_is_offered() {
    let stage = hearing_only(Frame::error(0xA8, &[0, 0, 0x80, 0x19, 0, 0, 128, 0]));
    let screen = stage.screen();
    assert!(screen.contains("err 4"), "{screen}");
    assert!(!screen.contains("wrong bit rate"), "{screen}");
}

#[test]
fn a_bus_without_a_rate_of_its_own_is_not_asked_about() {
    let mut stage = Stage::boiler();
    stage.app.name_bus(BusIndex(0), "slcan:/dev/ttyACM0@125000".to_owned());
    for (rate_search, refusal) in [
        (RateSearch::NoRate, "ttyACM0@125000: bit rate cannot be set from here"),
        (RateSearch::WhenClosed, " quit descan, then run: descan speed slcan:/dev/ttyACM0\n"),
    ] {
        let status = BusStatus { link: Link::Up, rate_search, ..BusStatus::default() };
        stage.app.handle_bus(Instant::ZERO, BusIndex(0), status);
        let screen = stage.keys("b").screen() + "\n";
        assert!(screen.contains(refusal), "{screen}");
    }
    assert!(!stage.effects.contains(&Effect::FindBitrate(BusIndex(0))));
}

#[test]
fn who_cannot_ask_says_why() {
    let mut stage = Stage::boiler();
    stage.link(Link::Down).keys("r");
    assert!(stage.screen().contains("no bus is up: cannot send requests"), "{}", stage.screen());

    let full = BusStatus { link: Link::Up, is_transmit_queue_full: true, ..BusStatus::default() };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), full.clone());
    let screen = stage.keys("3").screen();
    assert!(screen.contains(" transmit queue full "), "{screen}");
    assert!(screen.contains("transmit queue full: frames not sent"), "{screen}");
    let room = BusStatus { is_transmit_queue_full: false, ..full };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), room);
    let screen = stage.screen();
    assert!(screen.contains("transmit queue no longer full"), "{screen}");
    assert!(!screen.contains(" transmit queue full "), "{screen}");
}

#[test]
fn a_muted_problem_does_not_count_and_stays_muted() {
    let mut stage = Stage::boiler();
    stage.until(30.5).keys("4 G m");
    assert_eq!(selected(&stage), "address conflict (same name) @14");
    assert!(stage.screen().contains("○ 1 missing  ⚠ 3  1 muted"), "{}", stage.screen());
    stage.effects.clear();
    stage.until(45.0);
    assert_eq!(problems(&stage)[3], "muted confirmed address conflict (same name) @14");
    assert_eq!(stage.app.counts().confirmed, 3);
    assert!(!stage.effects.contains(&Effect::Bell), "nobody wants to hear of it");
    snapshot!("problems_muted_80x24", stage);
    snapshot!("problems_muted_40x10", stage.size(40, 10));
    stage.size(80, 24).keys("1");
    assert!(
        stage.screen().contains("⚠   14 ACT        CONFLICT"),
        "the device says it all the same"
    );
    stage.keys("4 m");
    assert_eq!(stage.app.counts().confirmed, 4);
    assert_eq!(problems(&stage)[0], "confirmed address conflict (same name) @14");
    assert_eq!(selected(&stage), "address conflict (same name) @14");
    stage.keys("1 m");
    assert_eq!(stage.app.counts().confirmed, 4, "only on the page itself");
    // Where nothing was selected by hand, too, the key undoes what it did.
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 m");
    assert_eq!(selected(&stage), "address conflict (same name) @14");
    stage.keys("m");
    assert_eq!(stage.app.counts().confirmed, 4);
}

#[test]
fn problems_are_filtered_by_words_and_fields() {
    let mut stage = Stage::boiler();
    stage.until(30.5).keys("4");
    let mut filtered = |filter: &str| {
        stage.keys("/").text(filter).keys("Enter");
        let shown = problems(&stage).len();
        stage.keys("Esc");
        (shown, problems(&stage).len())
    };
    for (filter, shown) in [
        ("is:confirmed", 3),
        ("is:suspected", 1),
        ("is:cleared", 0),
        ("is:muted", 0),
        ("at:14", 2),
        ("at:1", 0),
        ("name:pump", 1),
        ("name:a", 3),
        ("bus:can0", 4),
        ("bus:can1", 0),
        ("kind:conflict", 1),
        ("kind:same-name", 1),
        ("kind:missing", 1),
        ("pump", 1),
        ("address", 4),
        ("!is:confirmed", 1),
        ("at:14 is:confirmed", 1),
    ] {
        assert_eq!(filtered(filter), (shown, 4), "{filter}");
    }
    stage.keys("g m /").text("is:muted").keys("Enter");
    assert_eq!(problems(&stage), ["muted confirmed static address taken @16"]);
    stage.keys("m");
    let screen = one_line(&stage.screen());
    assert!(screen.contains("no problem matches the filter; Esc │ clears it"), "{screen}");
}

#[test]
fn the_other_pages_know_the_same_fields() {
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
    assert_eq!(rows("1", "at:14"), 1);
    assert_eq!(rows("1", "name:sens"), 2);
    assert_eq!(rows("1", "is:conflict"), 1);
    assert_eq!(rows("1", "is:clash"), 1);
    assert_eq!(rows("1", "is:missing"), 1);
    assert_eq!(rows("3", "is:suspected"), 2);
    assert_eq!(rows("3", "is:confirmed"), 2);
    assert_eq!(rows("3", "is:suspected at:14 name:act"), 2);
    rows("2", "at:14 name:act is:ours");
}

#[test]
fn a_problem_leads_to_its_frames_and_back() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 Enter");
    snapshot!("evidence_80x24", stage);
    snapshot!("evidence_120x40", stage.size(120, 40));
    stage.size(80, 24).keys("j Enter");
    snapshot!("evidence_around", stage);
    let frame = *stage.app.selected_frame().unwrap();
    assert_eq!(stage.app.piece_of(&frame).unwrap().what, "first response to one request");
    // To the next one among all frames: the list of evidence goes with it.
    stage.keys("j");
    let next = *stage.app.selected_frame().unwrap();
    assert_ne!(next, frame);
    stage.keys("Enter");
    assert_eq!(stage.app.selected_frame(), Some(&next));
    assert!(stage.app.evidence_alone().is_some());
    stage.keys("Esc");
    assert_eq!(stage.app.view().page, Page::Problems);
    assert_eq!(selected(&stage), "address conflict (same name) @14");
    stage.keys("2");
    assert!(stage.screen().contains("following"), "the traffic is as it was before");
    assert!(!stage.screen().contains('◆'));
}

#[test]
fn the_evidence_is_left_as_anything_else_is() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("2 v /").text("srv:des").keys("Enter 4 Enter");
    let shown = |stage: &Stage| stage.screen().contains("EVIDENCE");
    assert!(shown(&stage), "{}", stage.screen());
    assert!(!stage.screen().contains("/srv:des"), "no filter stands before evidence");
    stage.keys("Enter Esc");
    assert!(shown(&stage), "first back to the evidence alone");
    stage.keys("Tab Shift-Tab");
    assert!(!shown(&stage) && stage.screen().contains("COUNT"), "{}", stage.screen());
    stage.keys("4 Enter v");
    assert!(!shown(&stage) && stage.screen().contains("following"), "{}", stage.screen());
    stage.keys("4 Enter /");
    assert!(!shown(&stage) && stage.screen().contains("filter: srv:des"), "{}", stage.screen());
}

#[test]
fn evidence_is_there_when_the_capture_has_forgotten_it() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4");
    flood(&mut stage);
    stage.keys("Enter");
    snapshot!("evidence_forgotten", stage);
    stage.keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("surrounding frames no longer in the capture"), "{screen}");
    // What was open before the frames went out of the capture stays, too.
    let mut stage = Stage::boiler();
    stage.until(28.0).keys("Space").until(45.0).keys("4 G Enter G Enter");
    assert!(stage.screen().contains("newer than the frozen view"), "{}", stage.screen());
    stage.keys("Space g Enter");
    flood(&mut stage);
    stage.keys("Enter");
    assert!(stage.screen().contains("▸◇12:00:"), "{}", stage.screen());
}

#[test]
fn small_screens_show_what_is_wrong_before_the_frames() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(40, 10).keys("4 Enter");
    snapshot!("problem_40x10", stage);
    snapshot!("evidence_40x10", stage.keys("Enter"));
    snapshot!("evidence_40x10_frame", stage.keys("Right"));
    stage.keys("Esc Enter");
    snapshot!("evidence_around_40x10", stage);
    stage.keys("Esc Esc");
    assert!(stage.screen().contains("Two devices answer as ACT"), "{}", stage.screen());
    stage.keys("Esc j j j Enter Enter");
    assert!(stage.screen().contains("▸○   44 PUMP"), "{}", stage.screen());
}

#[test]
fn from_a_device_to_its_problem_and_back() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("j j j");
    assert!(stage.screen().contains("→ 4 Problems (p)"), "{}", stage.screen());
    stage.keys("4 /").text("pump").keys("Enter 1 p");
    assert_eq!(stage.app.view().page, Page::Problems);
    assert_eq!(selected(&stage), "address conflict (same name) @14", "a filter does not hide it");
    stage.keys("G p");
    let name = |stage: &Stage| stage.app.selected_row().unwrap().name.clone().unwrap().to_string();
    assert_eq!((stage.app.view().page, name(&stage)), (Page::Devices, "PUMP".to_owned()));
    stage.keys("p");
    assert_eq!(selected(&stage), "missing @44", "also of what is not there");
    stage.keys("1 g p");
    assert!(stage.screen().contains("no problem for this device"), "{}", stage.screen());
    stage.keys("3 /").text("is:suspected").keys("Enter k k p");
    assert_eq!(
        selected(&stage),
        "address conflict (same name) @14",
        "from a line of the timeline, too"
    );
    stage.keys("3 Esc");
    // Rows that do not fit the filter are found all the same.
    stage.keys("1 g");
    stage.keys("/").text("feed").keys("Enter 4 g p");
    assert_eq!((stage.app.view().page, name(&stage)), (Page::Devices, "ACT".to_owned()));
}

#[test]
fn the_selection_follows_its_problem() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("4 G");
    assert_eq!(selected(&stage), "missing @44");
    stage.until(45.0);
    assert_eq!(selected(&stage), "missing @44");
    stage.keys("g").write(&BOILER.replace("44", "45"));
    assert_eq!(selected(&stage), "address conflict (same name) @14");
    // Also where it was not selected by hand: what is read is not pushed away by what comes on top.
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("4");
    let first = selected(&stage);
    stage.until(45.0);
    assert_eq!(selected(&stage), first);
    assert_ne!(problems(&stage)[0], format!("confirmed {first}"));
    stage.keys("1").until(46.0).keys("4");
    assert_eq!(
        selected(&stage),
        "address conflict (same name) @14",
        "the page opens with the first"
    );
    // While the screen is held, no row moves, and what is new comes last.
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("4 Space");
    let before = problems(&stage);
    stage.until(45.0);
    assert_eq!(problems(&stage)[..before.len()], before);
    assert_eq!(problems(&stage).last().unwrap(), "confirmed address conflict (same name) @14");
    stage.keys("Space");
    assert_eq!(problems(&stage)[0], "confirmed address conflict (same name) @14");
}

#[test]
fn problems_by_mouse_and_in_russian() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4");
    let press = |stage: &mut Stage, column, row| {
        let mouse = Mouse { kind: MouseKind::Press, column, row };
        stage.app.handle_mouse(stage.app.now(), mouse);
    };
    press(&mut stage, 10, 7);
    assert_eq!(selected(&stage), "missing @44");
    stage.keys("ь");
    assert_eq!(stage.app.counts().confirmed, 3, "ь is m");
    stage.keys("з");
    assert_eq!(stage.app.view().page, Page::Devices, "з is p");
    stage.keys("4 g Enter");
    press(&mut stage, 10, 6);
    let (place, _) = stage.app.evidence_alone().unwrap().selected().unwrap();
    assert_eq!(place, 2);
    let wheel = Mouse { kind: MouseKind::WheelDown, column: 10, row: 6 };
    stage.app.handle_mouse(stage.app.now(), wheel);
    let (place, _) = stage.app.evidence_alone().unwrap().selected().unwrap();
    assert_eq!(place, 5);
}

// ---- what the bus may do ------------------------------------------------------------------

#[test]
fn nothing_beyond_discovery_is_sent_by_one_key() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("i");
    assert!(stage.screen().contains("identify needs --profile"), "{}", stage.screen());
    let mut profile = descan::wire::profile::Profile::default();
    profile.given = true;
    let config = Config { profile: profile.into(), seed: 7, ..Config::default() };
    let scenario = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with(&scenario, Some(BOILER), config);
    stage.until(24.0);
    let sent = |stage: &Stage| {
        let ours = stage.app.capture().iter().filter(|(_, frame)| frame.is_tx);
        ours.filter(|(_, frame)| frame.platform_id().is_some_and(|id| id & 0x3FF == 0x18)).count()
    };
    stage.keys("i");
    assert!(stage.screen().contains("Send identify (service 018) to FEED at 10?"));
    stage.keys("n").until(25.0);
    assert_eq!(sent(&stage), 0);
    stage.keys("i y").until(26.0);
    assert_eq!(sent(&stage), 1);
}

#[test]
fn hostile_names_never_reach_the_terminal() {
    use descan::sim::DeviceSpec;
    let mut scenario = Scenario::new(500_000);
    let names: [&[u8]; 4] = [
        b"\x1b]0;pwned\x07",
        b"\x1b[2J\x9b31m",
        "\u{202e}\u{200b}\u{2028}\u{9b}".as_bytes(),
        b"a\r\nb\tc",
    ];
    for (at, name) in names.into_iter().enumerate() {
        let mut device = DeviceSpec::new("x").label(&format!("device {at}")).settled();
        device.name = name.to_vec();
        device = device.fixed(20 + at as u8);
        device.services = vec![vec![name.to_vec(), name.to_vec(), name.to_vec()]];
        scenario = scenario.with(device);
    }
    let mut stage = Stage::new(&scenario, None);
    stage.until(8.0).keys("A");
    for (columns, rows) in [(80, 24), (140, 50), (40, 10)] {
        stage.size(columns, rows);
        for keys in [
            "1",
            "j",
            "j",
            "j",
            "Enter",
            "Esc 2",
            "v",
            "v k k Enter",
            "Esc 3",
            "4",
            "Enter",
            "Enter",
            "Enter",
            "4 m",
            "1 R",
        ] {
            stage.keys(keys);
            let buffer = stage.buffer("terminal");
            for cell in buffer.content() {
                let odd = cell.symbol().chars().find(|&c| !descan::text::is_printable(c));
                assert_eq!(odd, None, "{keys} {:?}", cell.symbol());
            }
        }
        stage.keys("Esc");
    }
    snapshot!("hostile_names", stage.size(80, 24).keys("1"));
}

#[test]
fn a_bus_that_is_down_says_so_everywhere() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    let status = BusStatus {
        link: Link::Down,
        state: BusState::Down,
        message: Some("can0 is down: sudo ip link set can0 up type can bitrate 125000".to_owned()),
        ..BusStatus::default()
    };
    let now = stage.app.now();
    stage.app.handle_bus(now, BusIndex(0), status);
    stage.sim.set_link(stage.station, false);
    stage.until(40.0).keys("G");
    snapshot!("bus_down", stage);
}

#[test]
fn listening_only_says_what_it_does() {
    let config = Config { listen_only: true, seed: 7, ..Config::default() };
    let scenario = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with(&scenario, Some(BOILER), config);
    stage.until(24.0);
    assert!(stage.screen().contains("listen-only, acks"), "{}", stage.screen());
    snapshot!("listen_only", stage);
    assert!(!stage.app.capture().iter().any(|(_, frame)| frame.is_tx));
    stage.keys("r");
    assert!(stage.screen().contains("listen-only: no requests are sent"));
}

#[test]
fn frames_alone_do_not_make_the_devices_page_dirty() {
    let mut stage = Stage::new(&Scenario::crowd(500_000, 20, 2), None);
    stage.until(30.0);
    stage.app.take_dirty();
    let mut draws = 0;
    for step in 1..=400 {
        stage.until(30.0 + f64::from(step) * 0.025);
        draws += u32::from(stage.app.take_dirty());
    }
    assert!(draws <= 12, "{draws} draws in ten quiet seconds");
}

/// Two simulated buses under one view.
struct Pair {
    app: App,
    sims: [(Sim, SimStation); 2],
}

impl Pair {
    fn new(scenarios: [&Scenario; 2]) -> Self {
        let buses = ["can0", "can1"].map(|name| (name.to_owned(), Config::default()));
        let file_path = Some("des.json".into());
        let options = AppOptions { buses: buses.to_vec(), file_path, ..AppOptions::default() };
        let mut app = App::new(Instant::ZERO, options);
        app.handle_file(Instant::ZERO, FileReading::Content(None));
        let mut seed = 0;
        let sims = scenarios.map(|scenario| {
            let index = BusIndex(seed as u8);
            seed += 1;
            let bitrate = Some(scenario.bitrate);
            let status = BusStatus { link: Link::Up, bitrate, ..BusStatus::default() };
            app.handle_bus(Instant::ZERO, index, status);
            let mut sim = Sim::new(scenario, seed);
            let station = sim.attach();
            (sim, station)
        });
        Self { app, sims }
    }

    fn run(&mut self, seconds: std::ops::Range<u64>) -> &mut Self {
        for millis in seconds.start * 1000 + 1..=seconds.end * 1000 {
            let now = Instant::from_micros(millis * 1000);
            for (index, (sim, station)) in self.sims.iter_mut().enumerate() {
                sim.advance(now);
                while let Some(frame) = sim.poll_frame(*station) {
                    self.app.handle_frames(now, &[frame.with_bus(BusIndex(index as u8))]);
                }
            }
            self.app.handle_timeout(now);
            while let Some(frame) = self.app.poll_transmit(now) {
                let (sim, station) = &mut self.sims[usize::from(frame.bus.0)];
                sim.transmit(*station, frame);
            }
        }
        self
    }

    fn keys(&mut self, keys: &str) -> &mut Self {
        for key in keys.split(' ') {
            self.app.handle_key(self.app.now(), Key::parse(key).unwrap());
        }
        self
    }

    fn screen(&mut self, width: u16, height: u16) -> String {
        self.app.handle_resize(width, height);
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        let theme = Theme::built_in("dark").unwrap();
        terminal
            .draw(|frame| {
                ui::draw(&self.app, &theme, frame);
            })
            .unwrap();
        text_of(terminal.backend().buffer())
    }
}

#[test]
fn two_buses_are_one_view() {
    let scenarios = ["boiler", "drone"].map(|name| Scenario::builtin(name).unwrap());
    let mut pair = Pair::new([&scenarios[0], &scenarios[1]]);
    insta::assert_snapshot!("two_buses", pair.run(0..20).screen(100, 30));
    insta::assert_snapshot!("two_buses_problems", pair.run(20..36).keys("4").screen(100, 30));
}

/// Adapters at one rate differ in what stands before it.
#[test]
fn two_adapters_at_one_rate_are_told_apart() {
    let scenarios = ["boiler", "drone"].map(|name| Scenario::builtin(name).unwrap());
    let mut pair = Pair::new([&scenarios[0], &scenarios[1]]);
    for (index, name) in [(0, "slcan:/dev/ttyACM0@500000"), (1, "slcan:/dev/ttyACM1@500000")] {
        pair.app.name_bus(BusIndex(index), name.to_owned());
    }
    pair.run(0..20);
    for (page, width) in [("1", 80), ("2", 80), ("3", 80), ("3", 120)] {
        let screen = pair.keys(page).screen(width, 40);
        assert!(screen.contains("…yACM"), "{page}: {screen}");
        let rows = screen.lines().skip(3);
        assert!(rows.clone().any(|row| row.contains("CM0 ")), "{page}: {screen}");
        assert!(rows.clone().any(|row| row.contains("CM1 ")), "{page}: {screen}");
        assert!(!rows.clone().any(|row| row.contains("…00000")), "{page}: {screen}");
    }
}

#[test]
fn where_one_line_is_for_all_buses_it_is_that_of_the_one_that_is_away() {
    let scenarios = ["boiler", "drone"].map(|name| Scenario::builtin(name).unwrap());
    let mut pair = Pair::new([&scenarios[0], &scenarios[1]]);
    assert!(pair.run(0..20).screen(50, 12).lines().next().unwrap().contains("can0"));
    let message = Some("can1 unplugged: plug it in again".to_owned());
    let status = BusStatus { link: Link::Unplugged, message, ..BusStatus::default() };
    pair.app.handle_bus(pair.app.now(), BusIndex(1), status);
    let screen = pair.screen(50, 12);
    assert!(screen.lines().next().unwrap().contains("can1  UNPLUGGED"), "{screen}");
}

#[test]
fn a_device_on_two_buses_is_one_row_where_they_are_redundant() {
    use descan::sim::DeviceSpec;
    let device = |name: &str, address: u8, uid: u8, service: &str| {
        let mut device = DeviceSpec::new(name).fixed(address).settled();
        device.uid = descan::wire::node::Uid([uid, 2, 3, 4, 5, 6]);
        device.service(service, "1.0")
    };
    let one = Scenario::new(125_000)
        .with(device("FEED", 10, 1, "AUGER"))
        .with(device("SENS", 12, 2, "TEMP"))
        .with(device("PUMP", 20, 3, "FLOW"));
    // FEED has another address there, SENS other services, and PUMP is another PUMP.
    let other = Scenario::new(500_000)
        .with(device("FEED", 11, 1, "AUGER"))
        .with(device("SENS", 12, 2, "LOG"))
        .with(device("PUMP", 20, 4, "FLOW"))
        .at(Duration::from_secs(8), "FEED", DeviceAction::Leave)
        .at(Duration::from_secs(20), "FEED", DeviceAction::Join);
    let mut pair = Pair::new([&one, &other]);
    let screen = pair.run(0..6).screen(100, 24);
    insta::assert_snapshot!("redundant_100x24", screen);
    assert!(screen.contains("● 5 present"), "{screen}");
    insta::assert_snapshot!("redundant_80x24", pair.screen(80, 24));
    // The other address and the other bus find it too.
    assert!(pair.keys("/ 1 1 Enter").screen(100, 24).contains("FEED"));
    let screen = pair.keys("Esc / b u s : c a n 1 Enter").screen(100, 24);
    assert!(screen.contains("FEED"), "{screen}");
    insta::assert_snapshot!("two_networks", pair.keys("Esc j").screen(100, 24));

    // Each bus has an address of its own to pin, and is taken into the file.
    let screen = pair.keys("g e").screen(100, 24);
    assert!(screen.contains("static address on can0 (Tab: next): "), "{screen}");
    let screen = pair.keys("Tab").screen(100, 24);
    assert!(screen.contains("static address on can1 (Tab: next): "), "{screen}");
    pair.keys("Esc a");
    let entries = pair.app.file().document().entries();
    let taken: Vec<_> = entries.iter().map(|it| (it.bus.as_deref(), it.address)).collect();
    assert_eq!(taken, [(Some("can0"), Some(10)), (Some("can1"), Some(11))]);
    pair.keys("u");

    let screen = pair.run(6..16).keys("g").screen(100, 24);
    assert!(screen.contains("partial"), "{screen}");
    assert!(screen.contains("@11 lost"), "{screen}");
    assert!(screen.contains("● 5 present"), "one of two is here: {screen}");
    insta::assert_snapshot!("redundant_timeline", pair.run(16..24).keys("3").screen(100, 24));
}

/// Which of two twins an entry is about that names neither's address is not known: nobody deleted it.
#[test]
fn an_entry_whose_device_gets_a_twin_while_it_is_edited_is_not_called_deleted() {
    let file = r#"[{"name":"SENS","address":15,"static":true}]"#;
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(file));
    stage.until(6.0).keys("/").text("SENS").keys("Enter g e").text("47");
    assert_eq!(stage.app.verdict(), Some(InputCheck::Accepted("Enter pins it to 47".to_owned())));
    stage.until(30.0);
    let told = "entry may belong to another device now; Enter adds it again";
    assert_eq!(
        stage.app.verdict(),
        Some(InputCheck::Warning(told.to_owned())),
        "{}",
        stage.screen()
    );
}

/// What is not on the disk, and that it is not, is seen whatever the bus and the file are called.
#[test]
fn long_names_give_way_to_the_state_of_the_file() {
    for (bus, short) in [("sim:../bus.toml", "s.toml"), (&*"x".repeat(58), "…xxxxx")] {
        let mut stage = Stage::boiler();
        stage.app.name_bus(BusIndex(0), bus.to_owned());
        stage.until(9.0).size(40, 10);
        let first = |stage: &Stage| stage.screen().lines().next().unwrap_or_default().to_owned();
        let line = first(&stage);
        assert!(line.contains("125k") && line.contains("● 5"), "{line}");
        stage.refusal = Some("mounted read-only".to_owned());
        stage.keys("e").text("100").keys("Enter");
        let line = first(&stage);
        assert!(line.contains("des.json ✗ not saved"), "{line}");
        assert!(line.contains(&short[short.len() - 4..]), "{line}");
        stage.write(&BOILER.replace("\"address\": 10", "\"address\": 99")).keys("Esc");
        assert!(first(&stage).contains("✗ conflict"), "{}", stage.screen());
        // Where there is room, nothing is left out.
        assert!(stage.size(120, 10).screen().contains(bus));
    }
}

/// Frames lost, and what to do about a bus that is away, are seen whatever it is called.
#[test]
fn a_long_name_of_a_bus_gives_way_to_its_numbers_and_to_what_is_wrong_with_it() {
    let mut stage = Stage::boiler();
    let name = "udp:ff15:7079:7468:6f6e:6465:6d6f:6d63:6173";
    stage.app.name_bus(BusIndex(0), name.to_owned());
    let first = |stage: &Stage| stage.screen().lines().next().unwrap_or_default().to_owned();
    let line = first(stage.until(9.0));
    assert!(line.contains(":6173 "), "{line}");
    assert!(line.contains("err 0") && line.contains("lost 0"), "{line}");
    let message = Some("127.0.0.1:29536: connection refused; is socketcand running?".to_owned());
    let status = BusStatus { link: Link::Down, message, ..BusStatus::default() };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    let line = first(&stage);
    assert!(line.ends_with("is socketcand running?"), "{line}");
    assert!(stage.size(120, 24).screen().contains(name), "{}", stage.screen());

    stage.app.name_bus(BusIndex(0), "can0".to_owned());
    let way_out = "check wiring, then sudo ip link set can0 type can restart";
    let status = BusStatus {
        link: Link::Up,
        state: BusState::BusOff,
        bitrate: Some(250_000),
        message: Some(format!("can0 is bus-off: {way_out}")),
        ..BusStatus::default()
    };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    let line = first(stage.size(80, 24));
    assert!(line.ends_with(way_out) && line.contains("BUS-OFF"), "{line}");
}

/// The way out is not cut off where there are no more than 80 columns.
#[test]
fn the_way_out_is_read_to_its_end() {
    let mut stage = Stage::boiler();
    stage.until(9.0);
    for (content, way_out) in [
        (&b"\xff\xfe[\0]\0"[..], "line 1, column 1: the file is UTF-16: save it as UTF-8"),
        (b"[{ \"name\": \"\xff\" }]", "line 1, column 13: 0xFF is not UTF-8: save it as UTF-8"),
    ] {
        stage.file = Some(content.to_vec());
        stage.notice();
        let screen = stage.screen();
        // In the status, in the timeline, and below; and when one wants to edit.
        assert_eq!(screen.matches(way_out).count(), 3, "{screen}");
        let screen = stage.keys("e").screen();
        let words = screen.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains(&format!("file has errors, fix it first: {way_out}")), "{screen}");
    }
    stage.write("[{\n  \"name\": 1\n  ]");
    for columns in 80..121 {
        let screen = stage.size(columns, 24).screen();
        assert!(screen.contains("des.json ✗ line 3, column 3: expected `,` or `}`"), "{screen}");
        assert_eq!(
            screen.contains("last valid:"),
            screen.contains("last valid: 5 entries"),
            "{screen}"
        );
        assert!(columns < 118 || screen.contains("last valid: 5 "), "{screen}");
    }
}

#[test]
fn a_question_and_a_path_are_read_to_their_end_on_a_narrow_screen() {
    let mut stage = Stage::boiler();
    stage.until(9.0).size(40, 10).keys("D");
    assert!(stage.screen().contains("Delete FEED at 10?  y yes  n no"), "{}", stage.screen());
    stage.keys("n W");
    let screen = stage.screen();
    assert!(screen.contains("copy as: des-20261121-120009.json"), "{screen}");
    stage.keys("Esc w");
    let screen = stage.screen();
    assert!(screen.contains("frames to: descan-20261121-120009.log"), "{screen}");
}

#[test]
fn a_folder_that_is_to_be_made_is_named_at_the_start() {
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), None);
    stage.app.handle_missing_folder(stage.app.now(), "../nodir");
    let screen = stage.screen();
    assert!(screen.contains(" des.json: no such folder yet: mkdir -p ../nodir"), "{screen}");
    assert!(screen.contains("! des.json     no such folder yet: mkdir -p ../nodir"), "{screen}");
}

/// While there are conflicts, too: what was decided is in it as it was decided.
#[test]
fn a_copy_has_all_edits_as_they_were_decided() {
    let mut stage = with_two_unsaved_edits();
    let theirs = BOILER.replace("10", "100").replace("12", "103").replace("44", "45");
    stage.write(&theirs).keys("t");
    assert!(stage.screen().contains("Edit conflict 2 of 2"), "{}", stage.screen());
    stage.keys("Esc W Enter");
    let Some(Effect::WriteFile { bytes, .. }) = stage.effects.last() else { panic!() };
    let copy = std::str::from_utf8(bytes).unwrap();
    assert_eq!(copy, theirs.replace("103", "71"));
}
