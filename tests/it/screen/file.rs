//! des.json: edits, saves and problems of the file.

use super::text_snapshot;
use super::with_two_unsaved_edits;
use super::{one_line, snapshot};
use crate::common::harness::{BOILER, Stage};
use descan::app::{Effect, FileIndex, FileReading, Page, SaveOutcome};
use descan::diagnostic::Diagnostic;
use descan::keymap::Key;
use descan::sim::Scenario;

#[test]
fn address_is_edited_in_its_row() {
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
fn deleted_file_is_reported() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    stage.app.handle_file(stage.app.now(), FileIndex::default(), FileReading::Content(None));
    assert!(stage.screen().contains("des.json     deleted"), "{}", stage.screen());
    let entries = stage.keys("e").text("9").screen();
    let told = "des.json was deleted with its 5 entries; Enter creates a new file";
    assert!(one_line(&entries).contains(told), "{entries}");
}

#[test]
fn edit_of_a_deleted_file_is_not_undone() {
    for (key, text) in [("n", "NEW 64"), ("e", "70")] {
        let mut stage = Stage::boiler();
        stage.until(24.0).keys(key).text(text).keys("Enter");
        stage.until(26.0).remove();
        let screen = stage.keys("u").screen();
        assert!(one_line(&screen).contains("the file was deleted"), "{screen}");
        assert!(!screen.contains("already"), "{screen}");
    }
}

#[test]
fn new_entry_is_selected_and_its_address_checked() {
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
fn prompt_rejection_and_keys_are_never_cut() {
    let mut stage = Stage::boiler();
    stage.until(24.0).size(40, 10).keys("n");
    // Nothing is wrong before something is typed.
    let screen = stage.screen();
    assert!(screen.contains("name, space, address") && !screen.contains('!'), "{screen}");
    stage.keys("Space");
    assert!(stage.screen().contains("✗ name, space, address"), "{}", stage.screen());
    stage.keys("Esc e").text("128");
    assert!(stage.screen().contains("✗ not an address: 1 to 127"), "{}", stage.screen());
    stage.keys("Esc D");
    assert!(stage.screen().contains("y yes  n no"), "{}", stage.screen());
    stage.keys("n").size(80, 24).keys("n").text("PUMP 12");
    assert!(stage.screen().contains("static address of SENS (line 5)"), "{}", stage.screen());
}

#[test]
fn address_changed_on_disk_while_it_is_entered_is_told() {
    let listed = |address| format!("[{{ \"name\": \"FEED\", \"address\": {address} }}]");
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(&listed(10)));
    stage.until(24.0).keys("e Ctrl-u").text("55").write(&listed(77));
    let screen = stage.screen();
    assert!(screen.contains("address changed to 77 on disk; Enter overwrites it"), "{screen}");
    // A device uses it, too.
    let screen = stage.keys("Ctrl-u").text("30").screen();
    let both = "30 is used by PSU; address changed to 77 on disk; Enter overwrites it";
    assert!(screen.contains(both), "{screen}");
    // What is entered is what the file has now.
    let screen = stage.keys("Ctrl-u").text("77").screen();
    assert!(!screen.contains("overwrites"), "{screen}");
    // Nothing is overwritten.
    let screen = stage.keys("Ctrl-u").screen();
    assert!(screen.contains("static address: 1 to 127"), "{screen}");
    stage.keys("Enter");
    assert_eq!(stage.file(), listed(77));
}

#[test]
fn renamed_entry_stays_selected_beside_one_of_its_name() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("n").text("SENS 99").keys("Enter R").text("X").keys("Enter");
    let row = stage.app.selected_row().unwrap();
    assert_eq!(row.name.as_ref().unwrap().to_string(), "SENSX");
}

#[test]
fn undo_and_redo_skip_values_changed_on_disk() {
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
    // The edit before it can be undone.
    stage.keys("u");
    assert_eq!(stage.file(), with("101"));

    let mut stage = Stage::boiler();
    stage.until(24.0).keys("e").text("100").keys("Enter u").write(&with("11"));
    let why = "not redone: address of the entry FEED: 10 → 100; on disk: address 11, static";
    refused(&mut stage, "Ctrl-r", why);

    // Another program made the same change.
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
fn undone_unsaved_edit_leaves_nothing_to_save() {
    // While saves fail: undo of one of two edits, then of both.
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

    // While a save that then fails is running; descan quits without a prompt.
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("70").keys("Enter u q");
    stage.file = Some(BOILER.as_bytes().to_vec());
    stage.refuse_saves();
    assert_eq!(stage.app.file().unsaved(), 0);
    assert!(stage.effects.contains(&Effect::Quit), "{}", stage.screen());

    // While a save that succeeds is running: the content on disk is changed back, too.
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("70").keys("Enter u");
    stage.finish_saves();
    stage.finish_saves();
    assert_eq!((stage.file(), stage.app.file().unsaved()), (BOILER, 0));
}

#[test]
fn duplicate_address_after_merge_is_reported() {
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("71").keys("Enter");
    stage.file = Some(BOILER.as_bytes().to_vec());
    let clash = "2 entries share address 71: FEED, SENS";
    // Another program gives the address, still free in the file, to another entry.
    let theirs = BOILER.replace("12", "71");
    stage.refuse_saves().write(&theirs);
    stage.file = Some(theirs.clone().into_bytes());
    stage.refuse_saves();
    stage.keys("Ctrl-s").finish_saves();
    assert_eq!(stage.file(), theirs.replace("10", "71"));
    let told = format!("saved after retry; warning: {clash}");
    assert!(stage.screen().contains(&told), "{}", stage.screen());
    assert!(stage.app.timeline().entries().any(|line| line.text == told));

    // It is also reported if the save succeeds at once; later saves do not report it again.
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
fn failed_save_is_retried_by_key() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    for key in ["e", "4", "7", "Enter"] {
        stage.app.handle_key(stage.app.now(), Key::parse(key).unwrap());
    }
    let now = stage.app.now();
    while stage.app.poll_effect().is_some() {}
    stage.app.handle_saved(
        now,
        FileIndex::default(),
        SaveOutcome::Failed(Diagnostic::new("no space left on the disk")),
    );
    assert_eq!(stage.app.poll_effect(), None, "not again and again");
    assert!(stage.screen().contains("not saved: no space left"), "{}", stage.screen());
    // It stays visible on the smallest screen, even beside another message.
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
fn failed_save_is_retried_later_and_reported_once() {
    let mut stage = Stage::boiler();
    let refused = || SaveOutcome::Failed(Diagnostic::new("no space left on the disk"));
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
fn copy_is_saved_to_another_path() {
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("47").keys("Enter");
    stage.unfinished = Some(vec![SaveOutcome::Failed(Diagnostic::new("disk full"))]);
    stage.finish_saves().until(31.0);
    assert!(stage.screen().contains("Ctrl-s save again  W save a copy"), "{}", stage.screen());
    stage.keys("W");
    assert!(stage.screen().contains("save a copy as: des-20261121-120031.json"));
    stage.keys("Ctrl-u").text("/else/b.json").keys("Enter");
    let path = std::path::PathBuf::from("/else/b.json");
    let bytes = BOILER.replace("10", "47").into_bytes();
    assert_eq!(stage.effects.last(), Some(&Effect::WriteFile { path: path.clone(), bytes }));
    stage.app.handle_written(stage.app.now(), &path, Err(Diagnostic::new("no such folder")));
    assert!(stage.screen().contains(" not saved: no such folder"), "{}", stage.screen());
    assert!(stage.screen().contains("save a copy as: /else/b.json"), "{}", stage.screen());
    assert!(stage.keys("Esc q").screen().contains("1 edit is not saved. Quit anyway?"));
    stage.keys("n W Ctrl-u").text("/else/b.json").keys("Enter");
    stage.app.handle_written(stage.app.now(), &path, Ok(()));
    assert!(stage.screen().contains("a copy with all edits: /else/b.json"));
    assert!(
        stage.keys("q").screen().contains("1 edit is saved only in /else/b.json. Quit anyway?")
    );
    // Later edits are not in it.
    stage.keys("n R").text("X").keys("Enter");
    stage.unfinished = Some(vec![SaveOutcome::Failed(Diagnostic::new("disk full"))]);
    stage.finish_saves().keys("q");
    assert!(stage.screen().contains("2 edits are not saved. Quit anyway?"));
}

#[test]
fn broken_file_is_shown_and_never_written() {
    let mut stage = Stage::boiler();
    let broken = BOILER.replace("\"SENS\",", "\"SENS\"");
    stage.until(24.0).write(&broken).keys("j");
    snapshot!("broken_file", stage);
    stage.keys("e");
    assert!(stage.app.prompt().is_none());
    stage.keys("A");
    assert_eq!(stage.file(), broken);
    assert!(stage.screen().contains("✓ 12"), "the last good content stays in force");
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
fn file_never_valid_claims_no_last_content() {
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some("[{]"));
    let screen = stage.until(9.0).size(120, 40).screen();
    assert!(screen.contains("des.json ✗ line 1, column 3"), "{screen}");
    assert!(!screen.contains("last valid"), "{screen}");
    stage.write("[]").write("[{]");
    assert!(stage.screen().contains("using last valid: 0 entries"), "{}", stage.screen());
}

#[test]
fn invalid_value_selects_its_row() {
    let file = BOILER.replace("16, \"static\": true", "16, \"static\": 1").replace("\"PUMP\"", "7");
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(&file));
    stage.until(24.0).keys("4 /").text("invalid").keys("Enter Home");
    assert!(stage.screen().contains("`static` is a number"), "{}", stage.screen());
    assert!(stage.screen().contains("Enter go to row"), "{}", stage.screen());
    stage.keys("Enter");
    let name = stage.app.selected_row().and_then(|row| row.name.clone()).unwrap().to_string();
    assert_eq!((stage.app.view().page, name), (Page::Devices, "ACT".to_owned()));
    // The row shows it, too.
    let screen = stage.size(120, 40).screen();
    assert!(screen.contains("! entry"), "{screen}");
    assert!(screen.contains("! `static` is a number; it"), "{screen}");
    // Ambiguous content is not edited, with a message before the user types.
    let twice = BOILER.replace("\"address\": 10", "\"address\": 9, \"address\": 10");
    for key in ["e", "R"] {
        let screen = stage.write(&twice).size(80, 24).keys("1 Home").keys(key).screen();
        assert!(stage.app.prompt().is_none());
        let said = "line 3, column 37: duplicate `address`: remove one of them first";
        assert!(screen.contains(said), "{screen}");
    }
    stage.write(&file).size(120, 40).wait_until(60.0);
    // Elements that are not entries have no row.
    stage.keys("4 Home j");
    assert!(stage.screen().contains("has no `name`"), "{}", stage.screen());
    stage.keys("Enter");
    assert_eq!(stage.app.view().page, Page::Problems);
    assert!(stage.screen().contains("concerns the file as a whole"), "{}", stage.screen());
}

#[test]
fn invalid_values_are_marked_in_their_rows() {
    let file = BOILER
        .replace("16, \"static\": true", "300, \"static\": 1")
        .replace("\"address\": 20", "\"address\": 200, \"services\": [1, 2]")
        .replace("\"address\": 44", "\"address\": 44, \"address\": 45")
        .replace("]\n}", ", 7, {}, {}]\n}");
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(&file));
    let screen = stage.until(24.0).keys("4 /").text("file-shape").keys("Enter").screen();
    let rows = [
        "ACT  line 6: `address` is 300",
        "ACT  line 6: `static` is a number",
        "DISP  line 7: `address` is 200",
        "DISP  line 7: `services` item 1 is a number",
        "DISP  line 7: `services` item 2 is a number",
        "PUMP  line 8: duplicate `address`",
        "line 9: element 6 is a number, not a device",
        "line 9: device 7 has no `name`",
        "line 9: device 8 has no `name`",
    ];
    // Text too long for its row is cut off; its beginning is sufficient.
    for (row, line) in rows.iter().zip(screen.lines().skip(4)) {
        let shown: String = row.chars().take(31).collect();
        assert!(line.contains(&shown), "{row}\n{screen}");
    }
    // A muted finding is included, and stays muted when lines are inserted above.
    let muted = |stage: &Stage| {
        let screen = stage.screen();
        let mut rows = screen.lines().filter(|line| line.contains("muted · "));
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
fn devices_are_added_to_a_new_file() {
    let mut stage = Stage::new(&Scenario::with_many_devices(500_000, 3, 2), None);
    stage.until(5.0).keys("A");
    text_snapshot!("begun_file", stage.file());
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
fn conflict_adds_no_uid_to_the_file() {
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some("[]"));
    stage.until(40.0).keys("A");
    let file = stage.file();
    assert!(file.contains("ACT") && file.contains("BOILER01"), "{file}");
    assert!(!file.contains("BOILER03") && !file.contains("SPARE01"), "{file}");
}

#[test]
fn quit_confirms_unsaved_edits() {
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
fn quit_continues_once_everything_is_saved() {
    // Two edits, the second waiting for the first: quitting waits for both.
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("47").keys("Enter R").text("X").keys("Enter q");
    assert!(stage.screen().contains("2 edits are still being saved"), "{}", stage.screen());
    stage.finish_saves();
    assert!(stage.screen().contains("1 edit is still being saved"), "{}", stage.screen());
    assert!(!stage.effects.contains(&Effect::Quit));
    stage.finish_saves();
    assert!(stage.effects.contains(&Effect::Quit));
    assert!(!stage.screen().contains("Quit"), "{}", stage.screen());

    // Declining is final, whatever is saved afterwards.
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("47").keys("Enter q n");
    stage.finish_saves();
    assert!(!stage.effects.contains(&Effect::Quit));

    // A failed save opens the prompt again instead of quitting.
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("47").keys("Enter q");
    stage.unfinished = Some(vec![SaveOutcome::Failed(Diagnostic::new("disk full"))]);
    stage.finish_saves();
    assert!(!stage.effects.contains(&Effect::Quit));
    let screen = stage.screen();
    assert!(screen.contains("1 edit is not saved. Quit anyway?"), "{screen}");
    stage.keys("n");
    assert!(stage.screen().contains("disk full"), "{}", stage.screen());
}

#[test]
fn address_pinned_already_is_reported() {
    let mut stage = Stage::boiler();
    stage.until(3.0).keys("Home e");
    assert!(stage.screen().contains("already pinned to 10"), "{}", stage.screen());
    stage.keys("Backspace").text("1");
    assert!(stage.screen().contains("Enter pins it to 11"), "{}", stage.screen());
}

#[test]
fn missing_folder_is_named_at_start() {
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), None);
    let fault = Diagnostic::new("no such folder").with_remedy("mkdir -p ../nodir");
    stage.app.handle_missing_folder(stage.app.now(), FileIndex::default(), &fault);
    let screen = stage.screen();
    assert!(screen.contains(" des.json: no such folder; mkdir -p ../nodir"), "{screen}");
    assert!(screen.contains("! des.json     no such folder; mkdir -p ../nodir"), "{screen}");
}

/// Tests that, during edit conflicts too, the copy contains the edits already decided, as decided.
#[test]
fn copy_contains_all_decided_edits() {
    let mut stage = with_two_unsaved_edits();
    let theirs = BOILER.replace("10", "100").replace("12", "103").replace("44", "45");
    stage.write(&theirs).keys("t");
    assert!(stage.screen().contains("Edit conflict 2 of 2"), "{}", stage.screen());
    stage.keys("Esc W Enter");
    let Some(Effect::WriteFile { bytes, .. }) = stage.effects.last() else { panic!() };
    let copy = std::str::from_utf8(bytes).unwrap();
    assert_eq!(copy, theirs.replace("103", "71"));
}

#[test]
fn overwritten_pin_is_named_until_it_is_restored() {
    let mut stage = Stage::boiler();
    stage.until(24.0).size(120, 30).keys("e").text("70").keys("Enter");
    assert!(stage.file().contains(r#""FEED", "address": 70"#), "{}", stage.file());
    assert!(!stage.screen().contains("overwritten"), "{}", stage.screen());
    stage.write(BOILER).until(60.0);
    assert!(
        stage.screen().contains("! pin of FEED overwritten; Ctrl-s restores"),
        "{}",
        stage.screen()
    );
    stage.keys("Ctrl-s");
    assert!(stage.file().contains(r#""FEED", "address": 70"#), "{}", stage.file());
    assert!(!stage.screen().contains("overwritten"), "{}", stage.screen());
    // An address that the user changes is not restored.
    stage.write(BOILER).keys("e").text("71").keys("Enter");
    assert!(!stage.screen().contains("overwritten"), "{}", stage.screen());
}
