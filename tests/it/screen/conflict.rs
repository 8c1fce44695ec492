//! The page of an edit conflict.

use super::snapshot;
use super::with_two_unsaved_edits;
use crate::common::harness::{BOILER, Stage};
use descan::app::Effect;
use descan::keymap::Key;

#[test]
fn edit_conflict_shows_both_values_and_a_choice() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    // Another program writes just before descan saves.
    let theirs = BOILER.replace("10", "11");
    stage.file = Some(theirs.clone().into_bytes());
    stage.keys("e").text("47").keys("Enter");
    snapshot!("conflict", stage);
    assert_eq!(stage.file(), theirs, "nothing is written before the choice");
    stage.keys("Esc j");
    assert!(stage.screen().contains("✗ edit conflict  Ctrl-s resolves it"), "{}", stage.screen());
    // A page opened by the user accepts a choice at once.
    stage.keys("Ctrl-s o");
    assert_eq!(stage.file(), BOILER.replace("10", "47"));
}

#[test]
fn each_of_two_edit_conflicts_is_decided_alone() {
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
fn choice_is_requested_again_after_file_change() {
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
fn choice_stays_open_when_the_file_is_deleted() {
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
        assert!(screen.contains("edit       new entry NEW at 64"), "{screen}");
        assert!(screen.contains("ours       address 64, static"), "{screen}");
        assert!(screen.contains("theirs     deleted"), "{screen}");
        stage.keys(key);
        assert_eq!(stage.file.is_some(), after.is_some());
        assert!(stage.file().contains(after.unwrap_or_default()), "{}", stage.file());
        assert!(!stage.screen().contains("Edit conflict"), "{}", stage.screen());
    }
}

#[test]
fn conflict_page_closes_with_the_conflict() {
    let theirs = BOILER.replace("10", "100");
    // Another program reverts its change, or the file stays empty for longer than descan waits for
    // it to be written.
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
fn broken_file_blocks_the_choice() {
    let mut stage = with_two_unsaved_edits();
    stage.write(&BOILER.replace("10", "100")).write("{ broken").keys("o");
    let screen = stage.screen();
    assert!(screen.contains("Edit conflict"), "{screen}");
    assert!(screen.contains("The file cannot be read now; choose later."), "{screen}");
    stage.write(&BOILER.replace("10", "100")).keys("t");
    assert_eq!(stage.file(), BOILER.replace("10", "100").replace("12", "71"));
}

#[test]
fn prompt_resumes_after_an_edit_conflict() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    // Not drained: another program writes while the save is running.
    for key in ["e", "4", "7", "Enter", "j", "e", "5"] {
        stage.app.handle_key(stage.app.now(), Key::parse(key).unwrap());
    }
    stage.write(&BOILER.replace("10", "11"));
    assert!(stage.screen().contains("Edit conflict"), "{}", stage.screen());
    stage.keys("t").text("0").keys("Enter");
    assert_eq!(stage.file(), BOILER.replace("10", "11").replace("12", "50"));
}

#[test]
fn small_dialog_explains_before_it_offers_a_choice() {
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("47").keys("Enter").size(40, 10);
    stage.file = Some(BOILER.as_bytes().to_vec());
    stage.refuse_saves().write(&BOILER.replace("10", "99"));
    let screen = stage.screen();
    let place = |text: &str| screen.find(text).unwrap_or_else(|| panic!("{text}\n{screen}"));
    assert!(place("✗ edit conflict") < place("You and another"), "{screen}");
    assert!(place("You and another") < place("ours"), "{screen}");
    assert!(place("theirs") < place("o keep ours  t keep theirs"), "{screen}");
    // A key without a meaning here is not ignored silently.
    stage.keys("Esc Ctrl-s").effects.clear();
    stage.keys("q");
    assert_eq!(stage.effects, [Effect::Bell]);
}
