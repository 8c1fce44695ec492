//! Undo and redo of edits of des.json while other programs empty, change or block the file; and the
//! choice of the right entry among several of one name.

use crate::common::harness::{BOILER, Stage};
use descan::app::{Effect, FileReading, FileState, SaveOutcome, Saving};
use descan::document::{Document, Operation};
use descan::sim::{DeviceSpec, Scenario};
use descan::status::Playback;
use descan::time::{Duration, Instant};
use proptest::prelude::*;

/// A disk that rejects writes until it is repaired.
fn refusing() -> Stage {
    let mut stage = Stage::boiler();
    stage.refusal = Some("no space left on the disk".to_owned());
    stage.until(24.0);
    stage
}

fn mend(stage: &mut Stage) -> &mut Stage {
    stage.refusal = None;
    stage
}

/// Selects the row of an entry.
fn select<'s>(stage: &'s mut Stage, name: &str) -> &'s mut Stage {
    stage.keys("Home");
    for _ in 0..20 {
        let row = stage.app.selected_row().unwrap();
        let entry =
            row.entry.map(|at| stage.app.file().document().entries()[at.index].name_text.clone());
        if entry.is_some_and(|entry| entry == name) {
            return stage;
        }
        stage.keys("j");
    }
    panic!("{name} has no row\n{}", stage.screen());
}

// ---- a file that is empty while it is being written ----------------------------------------

#[test]
fn file_being_written_is_not_taken_as_empty() {
    let theirs = BOILER.replace("12", "13");
    for empty in ["", "\n", " \r\n\t", "\u{feff}"] {
        // An edit of an entry that no longer exists, which would be an edit conflict; and a new
        // entry, which would create a file.
        for (keys, text, ours) in [
            ("e", "70", theirs.replace("10", "70")),
            ("n", "NEW 64", theirs.replace("44, \"static\": true }", "44, \"static\": true },\n    { \"name\": \"NEW\", \"address\": 64, \"static\": true }")),
        ] {
            let mut stage = refusing();
            stage.keys(keys).text(text).keys("Enter");
            let screen = mend(&mut stage).write(empty).until(24.9).keys("Ctrl-s").screen();
            assert_eq!(stage.file(), empty, "nothing is written");
            assert!(!screen.contains("Edit conflict"), "{screen}");
            assert!(screen.contains("SENS"), "{screen}");
            assert_eq!(stage.app.file().unsaved(), 1);
            stage.write(&theirs);
            assert_eq!(stage.file(), ours);
            assert!(!stage.screen().contains("Edit conflict"), "{}", stage.screen());
            assert!(stage.until(30.0).screen().contains("✓"), "{}", stage.screen());
        }
    }
}

#[test]
fn edit_waits_while_the_file_is_written() {
    for theirs in [BOILER.to_owned(), BOILER.replace("12", "13")] {
        let mut stage = Stage::boiler();
        stage.until(24.0).write("");
        let screen = stage.screen();
        assert!(screen.contains("des.json empty (being written?)"), "{screen}");
        assert!(screen.contains("≠ 3 svc"), "{screen}");
        let screen = stage.keys("e").text("70").keys("Enter").screen();
        assert!(screen.contains("… saving 1  empty (being written?)"), "{screen}");
        assert!(stage.keys("q").screen().contains("Quit"));
        assert!(!stage.effects.contains(&Effect::Quit));
        assert_eq!(stage.file(), "");
        stage.write(&theirs);
        assert_eq!(stage.file(), theirs.replace("10", "70"));
        assert!(stage.effects.contains(&Effect::Quit), "it quits once all is saved");
    }
}

#[test]
fn save_to_emptied_file_is_delayed() {
    let theirs = BOILER.replace("12", "13");
    for keys in ["e", "n"] {
        let mut stage = Stage::boiler();
        stage.until(24.0);
        // The change has not been reported yet.
        stage.file = Some(Vec::new());
        let text = if keys == "e" { "70" } else { "NEW 64" };
        stage.keys(keys).text(text).keys("Enter").until(24.5);
        assert_eq!(stage.file(), "");
        let screen = stage.screen();
        assert!(screen.contains("… saving 1"), "{screen}");
        assert!(!screen.contains("Edit conflict"), "{screen}");
        stage.write(&theirs);
        assert!(stage.file().contains(if keys == "e" { "70" } else { "NEW" }));
        assert!(stage.file().contains("13"));
    }
    // The same for a save that was to create the file.
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), None);
    stage.until(24.0);
    stage.file = Some(Vec::new());
    stage.keys("n").text("NEW 64").keys("Enter").until(24.5);
    assert_eq!(stage.file(), "");
    stage.write("[]").until(24.6);
    assert!(stage.file().starts_with("[\n  {"), "{}", stage.file());
}

#[test]
fn file_that_stays_empty_gets_the_first_entry() {
    let mut stage = refusing();
    stage.keys("n").text("NEW 64").keys("Enter");
    mend(&mut stage).write("").until(24.6);
    // Still being written: a second report does not extend the wait.
    stage.write(" ").until(24.9);
    assert_eq!(stage.file(), " ");
    stage.until(25.1);
    assert!(stage.file().starts_with("{\n  \"devices\": [\n"), "{}", stage.file());
    assert!(stage.file().contains("NEW"));

    // An edit of an entry that no longer exists is left to the user.
    let mut stage = refusing();
    stage.keys("e").text("70").keys("Enter");
    mend(&mut stage).write("").until(25.1);
    assert!(stage.screen().contains("theirs     deleted"), "{}", stage.screen());

    // Without an unsaved edit, the empty file is reported.
    let mut stage = Stage::boiler();
    let screen = stage.until(24.0).write("").until(25.1).screen();
    assert!(screen.contains("✓ 0 entries"), "{screen}");
    assert!(stage.app.timeline().entries().any(|it| it.text == "changed on disk: 0 entries"));
}

#[test]
fn every_emptying_of_the_file_is_waited_for() {
    let mut stage = refusing();
    stage.keys("e").text("70").keys("Enter");
    stage.write("").until(24.8).write(BOILER).write("").until(25.6);
    assert!(!stage.screen().contains("Edit conflict"), "{}", stage.screen());
    // Invalid JSON, a missing file and an unreadable file are handled as usual.
    stage.write("{").until(26.0);
    assert!(stage.screen().contains("✗"), "{}", stage.screen());
    stage.write("").until(26.9);
    assert!(!stage.screen().contains("Edit conflict"), "{}", stage.screen());
    mend(&mut stage).write(BOILER);
    assert_eq!(stage.file(), BOILER.replace("10", "70"));
}

/// Tests the end of a log, where no deadline passes any more.
#[test]
fn empty_file_is_waited_for_in_real_time_at_any_pace_of_a_log() {
    for (speed, is_paused, is_ended) in
        [(1.0, true, false), (1000.0, false, false), (1.0, false, true)]
    {
        let mut stage = Stage::boiler();
        stage.until(24.0);
        let real = Instant::ZERO + Duration::from_secs(7);
        stage.app.set_real_time(real);
        stage.app.handle_playback(
            stage.app.now(),
            Playback { speed, is_paused, is_ended, ..Playback::default() },
        );
        stage.write("");
        let much_later = stage.app.now() + Duration::from_secs(1000);
        stage.app.handle_timeout(much_later);
        assert!(stage.screen().contains("empty (being written?)"), "{}", stage.screen());
        let due = stage.app.poll_real_timeout().expect("a deadline in real time");
        assert_eq!(due, real + Duration::from_secs(1));
        stage.app.handle_real_timeout(due);
        // The file is read again.
        stage.drain(stage.app.now());
        assert!(stage.screen().contains("✓ 0 entries"), "{}", stage.screen());
        assert_eq!(stage.app.poll_real_timeout(), None);
    }
}

#[test]
fn failed_save_is_repeated_in_real_time_at_any_pace_of_a_log() {
    let mut stage = refusing();
    stage.app.set_real_time(Instant::ZERO);
    stage.app.handle_playback(
        stage.app.now(),
        Playback { speed: 1000.0, is_paused: false, is_ended: false, ..Playback::default() },
    );
    stage.keys("n").text("NEW 64").keys("Enter");
    let due = stage.app.poll_real_timeout().expect("a deadline in real time");
    assert_eq!(due, Instant::ZERO + Duration::from_secs(10));
    assert!(stage.app.file().unsaved() > 0);
    mend(&mut stage);
    stage.app.handle_timeout(stage.app.now() + Duration::from_secs(1000));
    assert!(stage.app.file().unsaved() > 0, "not in the time of the log");
    stage.app.handle_real_timeout(due);
    stage.drain(stage.app.now());
    assert_eq!(stage.app.file().unsaved(), 0, "{}", stage.screen());
}

// ---- the first entry -----------------------------------------------------------------------

#[test]
fn undo_of_first_entry_restores_file_without_devices() {
    let boiler = Scenario::builtin("boiler").unwrap();
    for before in ["", "\n\n", "{}", "{ \"devices\": null }", "[ ]", "{\"x\":{}}\n"] {
        let mut stage = Stage::new(&boiler, Some(before));
        stage.until(24.0).keys("n").text("NEW 64").keys("Enter");
        let with_one = stage.file().to_owned();
        assert!(with_one.contains("NEW"), "{with_one}");
        // Several undone at once, too.
        assert_eq!(stage.keys("u A u").file(), before);
        stage.keys("n").text("A 1").keys("Enter n").text("B 2").keys("Enter R").text("C");
        assert_eq!(stage.keys("Enter u u u").file(), before);
        stage.keys("n").text("NEW 64").keys("Enter");
        assert_eq!(stage.file(), with_one);
        // Not if another program added an entry.
        let theirs = with_one.replace("\"NEW\"", "\"FEED\" },\n    { \"name\": \"NEW\"");
        stage.write(&theirs).keys("u");
        assert!(stage.file().contains("FEED") && !stage.file().contains("NEW"), "{}", stage.file());
    }
}

#[test]
fn undone_edit_creates_no_file() {
    let boiler = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::new(&boiler, None);
    stage.refusal = Some("its folder is gone".to_owned());
    stage.until(24.0).keys("n").text("NEW 64").keys("Enter").until(30.0);
    assert_eq!(stage.app.file().unsaved(), 1);
    assert!(stage.keys("u").screen().contains("not found"), "{}", stage.screen());
    mend(&mut stage).keys("Ctrl-s").until(60.0);
    assert_eq!((stage.app.file().unsaved(), stage.file.as_deref()), (0, None));
    stage.keys("Ctrl-r");
    assert!(stage.file().contains("NEW"));
    // Content that exists by now is not deleted; the result is a file without devices.
    stage.keys("u");
    assert_eq!(stage.file(), "{\n  \"devices\": []\n}\n");
    assert_eq!(stage.keys("Ctrl-r u").file(), "{\n  \"devices\": []\n}\n");

    // During a save that then fails.
    let mut stage = Stage::new(&boiler, None);
    stage.slow_disk().until(24.0).keys("n").text("NEW 64").keys("Enter u");
    stage.file = None;
    stage.refuse_saves();
    assert_eq!((stage.app.file().unsaved(), stage.file.as_deref()), (0, None));
    assert!(stage.until(60.0).unfinished.as_ref().unwrap().is_empty());
}

// ---- ours, in an edit conflict -------------------------------------------------------------

#[test]
fn undo_of_kept_value_restores_theirs() {
    let theirs = BOILER.replace("10", "11").replace("12", "13");
    let ours = theirs.replace("11", "70");
    let mut stage = refusing();
    stage.keys("e").text("70").keys("Enter");
    mend(&mut stage).write(&theirs).keys("o");
    assert_eq!(stage.file(), ours);
    stage.keys("u");
    assert_eq!(stage.file(), theirs);
    let told = "undone: address of the entry FEED: 11 → 70";
    assert!(stage.app.timeline().entries().any(|it| it.text == told), "{}", stage.screen());
    assert_eq!(stage.keys("Ctrl-r").file(), ours);
    assert_eq!(stage.keys("u").file(), theirs);
    // Undo does not restore the content before theirs.
    let screen = stage.keys("u").screen();
    assert!(screen.contains("not undone: "), "{screen}");
    assert_eq!(stage.file(), theirs);

    // Undone before it is saved: no unsaved edit remains.
    let mut stage = refusing();
    stage.keys("e").text("70").keys("Enter").write(&theirs).keys("o u");
    assert_eq!(stage.app.file().unsaved(), 0);
    assert!(mend(&mut stage).until(60.0).effects.iter().all(|it| !matches!(it, Effect::Quit)));
    assert_eq!(stage.file(), theirs);

    // Later edits are undone first, and remain if they are not.
    let mut stage = refusing();
    stage.keys("e").text("70").keys("Enter R").text("X").keys("Enter");
    mend(&mut stage).write(&theirs).keys("o");
    select(&mut stage, "ACT").keys("e").text("33").keys("Enter");
    let all = ours.replace("FEED", "FEEDX").replace("16", "33");
    assert_eq!(stage.file(), all);
    assert_eq!(stage.keys("u").file(), all.replace("33", "16"));
    assert_eq!(stage.keys("u").file(), all.replace("33", "16").replace("70", "11"));
    assert_eq!(stage.keys("Ctrl-r Ctrl-r").file(), all);
}

#[test]
fn each_kept_value_is_undone_alone() {
    let theirs = BOILER.replace("10", "11").replace("12", "13").replace("16,", "17,");
    for (choices, file) in [
        ("o o o", ["14, 15, 18", "14, 15, 17", "14, 13, 17", "11, 13, 17"]),
        ("o t o", ["14, 13, 18", "14, 13, 17", "11, 13, 17", "11, 13, 17"]),
    ] {
        let addresses = |stage: &Stage| {
            let entries = stage.app.file().document().entries();
            let addresses = entries[..3].iter().map(|it| it.address.unwrap().to_string());
            addresses.collect::<Vec<_>>().join(", ")
        };
        let mut stage = refusing();
        for (name, address) in [("FEED", "14"), ("SENS", "15"), ("ACT", "18")] {
            select(&mut stage, name).keys("e").text(address).keys("Enter");
        }
        stage.write(&theirs);
        mend(&mut stage).keys(choices);
        assert_eq!(addresses(&stage), file[0]);
        for after in &file[1..] {
            stage.keys("u");
            assert_eq!(addresses(&stage), *after);
        }
        stage.keys("Ctrl-r Ctrl-r Ctrl-r");
        assert_eq!(addresses(&stage), file[0]);
    }
}

#[test]
fn undo_of_kept_entry_restores_their_delete_or_add() {
    // Theirs deleted the entry that ours edits.
    let theirs =
        BOILER.replace("    { \"name\": \"SENS\", \"address\": 12, \"static\": true },\n", "");
    let mut stage = refusing();
    select(&mut stage, "SENS").keys("e").text("70").keys("Enter");
    mend(&mut stage).write(&theirs).keys("o");
    assert!(stage.file().contains("\"SENS\", \"address\": 70"), "{}", stage.file());
    assert_eq!(stage.keys("u").file(), theirs);
    assert!(stage.keys("Ctrl-r").file().contains("\"SENS\", \"address\": 70"));

    // Theirs added the entry that ours adds.
    let theirs = BOILER.replace(
        "\"PUMP\"",
        "\"NEW\", \"address\": 63, \"static\": true },\n    { \"name\": \"PUMP\"",
    );
    let mut stage = refusing();
    stage.keys("n").text("NEW 64").keys("Enter");
    mend(&mut stage).write(&theirs).keys("o");
    assert_eq!(stage.file(), theirs.replace("63", "64"));
    assert_eq!(stage.keys("u").file(), theirs);
    assert_eq!(stage.keys("Ctrl-r").file(), theirs.replace("63", "64"));
}

// ---- many entries at once ------------------------------------------------------------------

#[test]
fn undo_of_many_skips_values_changed_on_disk() {
    let names = |stage: &Stage| {
        let entries = stage.app.file().document().entries();
        entries.iter().map(|entry| entry.name_text.clone()).collect::<Vec<_>>().join(" ")
    };
    let told = |stage: &Stage, text: &str| {
        let mut lines = stage.app.timeline().entries();
        assert!(lines.any(|line| line.text == text), "{}", stage.screen());
    };
    let mut stage = Stage::new(&Scenario::with_many_devices(500_000, 4, 2), Some("[]"));
    stage.until(5.0).keys("A");
    let all = stage.file().to_owned();
    assert_eq!(names(&stage), "N001 N002 N003 N004");

    // Another program changes one entry.
    let address = stage.app.file().document().entries()[1].address.unwrap();
    let changed =
        |text: &str| text.replace(&format!("\"address\": {address},"), "\"address\": 99,");
    stage.write(&changed(&all)).keys("u");
    assert_eq!(names(&stage), "N002");
    let but = format!("except N002 at {address} (changed on disk)");
    told(&stage, &format!("undone: 4 new entries, {but}"));
    // The result is the same for redo.
    stage.keys("Ctrl-r");
    assert_eq!(names(&stage), "N001 N002 N003 N004");
    assert!(stage.file().contains("99"));
    told(&stage, "redone: 4 new entries, all but 1");
    stage.keys("u");
    told(&stage, "undone: 4 new entries, all but 1");
    assert_eq!(names(&stage), "N002");
    // Another program adds one of these entries.
    let third = Document::parse(all.as_bytes()).unwrap().entries()[2].address.unwrap();
    let brought = format!(r#"[ {{ "name": "N003", "address": {third}, "static": true }},"#);
    let theirs = stage.file().replacen('[', &brought, 1);
    stage.write(&theirs).keys("Ctrl-r");
    assert_eq!(names(&stage), "N001 N003 N002 N004");
    assert!(stage.file().contains(brought.trim_start_matches("[ ")), "{}", stage.file());
    let but = format!("except N003 at {third} (changed on disk)");
    told(&stage, &format!("redone: 4 new entries, all but 1, {but}"));
    stage.keys("u");
    assert_eq!(names(&stage), "N003 N002");
    told(&stage, "undone: 4 new entries, all but 2");

    // Another program changes all entries but one, or all.
    let mut stage = Stage::new(&Scenario::with_many_devices(500_000, 4, 2), Some("[]"));
    stage.until(5.0).keys("A");
    let noted = |text: &str, count: usize| {
        text.replacen("\"name\": \"N0", "\"note\": 1, \"name\": \"N0", count)
    };
    let all = stage.file().to_owned();
    stage.write(&noted(&all, 3)).keys("u");
    assert_eq!(names(&stage), "N001 N002 N003");
    let but = format!("except N003 at {third} and 2 more (changed on disk)");
    told(&stage, &format!("undone: 4 new entries, {but}"));
    let mut stage = Stage::new(&Scenario::with_many_devices(500_000, 4, 2), Some("[]"));
    stage.until(5.0).keys("A").write(&noted(&all, 4)).keys("u");
    assert_eq!(stage.file(), noted(&all, 4));
    let screen = stage.screen();
    assert!(screen.contains("not undone: "), "{screen}");
}

// ---- a slow save ---------------------------------------------------------------------------

/// Returns a harness in which an edit of FEED to 70 is being saved.
fn saving() -> Stage {
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("70").keys("Enter");
    stage
}

/// Returns the result of a save that found this content.
fn found(text: &str) -> SaveOutcome {
    SaveOutcome::Changed(FileReading::Content(Some(text.as_bytes().to_vec())))
}

#[test]
fn change_on_disk_is_seen_while_a_save_hangs() {
    let with = |name: &str| BOILER.replace("\"DISP\"", &format!("\"{name}\""));
    let mut stage = saving();
    // Before ours is on disk.
    stage.write(&with("SHOW"));
    for name in ["SHOW", "SHOWN"] {
        let screen = stage.write(&with(name)).screen();
        assert!(screen.contains(name) && screen.contains("70"), "{screen}");
        assert!(screen.contains("… saving 1"), "{screen}");
    }
    assert_eq!(stage.file(), with("SHOWN"));
    // The save finishes and reports the content that it found first.
    stage.unfinished = Some(vec![found(&with("SHOW"))]);
    stage.finish_saves().finish_saves();
    assert_eq!(stage.file(), with("SHOWN").replace("10", "70"));
    assert!(stage.screen().contains("✓ 5 entries"), "{}", stage.screen());

    // After ours is on disk, before the save is reported.
    let mut stage = saving();
    let ours = stage.file().to_owned();
    stage.notice();
    assert!(stage.screen().contains("… saving 1"), "it may not stay there: {}", stage.screen());
    stage.write(&ours.replace("70", "71")).finish_saves().finish_saves();
    assert_eq!(stage.file(), ours.replace("70", "71"), "it is not overwritten in turn");
    assert!(stage.screen().contains("✓ 5 entries"), "{}", stage.screen());
}

#[test]
fn edit_conflict_is_resolved_while_a_save_hangs() {
    for (key, address) in [("o", "70"), ("t", "11")] {
        let mut stage = saving();
        stage.write(&BOILER.replace("10", "11"));
        assert!(stage.screen().contains("Edit conflict"), "{}", stage.screen());
        stage.keys(key);
        assert!(!stage.screen().contains("Edit conflict"), "{}", stage.screen());
        stage.unfinished = Some(vec![found(stage.file())]);
        stage.finish_saves().finish_saves();
        assert_eq!(stage.file(), BOILER.replace("10", address));
        assert_eq!(stage.app.file().unsaved(), 0);
    }
}

#[test]
fn edit_conflict_ends_if_the_save_was_made_before_it() {
    let mut stage = saving();
    let theirs = BOILER.replace("10", "11");
    stage.write(&theirs);
    assert!(stage.screen().contains("Edit conflict"), "{}", stage.screen());
    stage.unfinished = Some(vec![SaveOutcome::Saved]);
    stage.finish_saves();
    // The session reads it again.
    stage.write(&theirs).finish_saves();
    let screen = stage.screen();
    assert!(!screen.contains("Edit conflict") && screen.contains("✗ 11"), "{screen}");
    // The edit was saved, and then overwritten.
    assert!(!stage.app.timeline().entries().any(|it| it.text.contains("conflict resolved")));
    assert_eq!((stage.file(), stage.app.file().unsaved()), (&*theirs, 0));
}

#[test]
fn failed_hanging_save_reports_the_file_error_first() {
    let mut stage = saving();
    stage.write("{ broken");
    assert!(stage.screen().contains("✗ line 1"), "{}", stage.screen());
    stage.refuse_saves();
    assert!(stage.screen().contains("✗ line 1"), "{}", stage.screen());
    stage.write(BOILER).finish_saves();
    assert_eq!(stage.file(), BOILER.replace("10", "70"));

    // A save that finds the file emptied meanwhile waits, too.
    let mut stage = saving();
    stage.write("");
    stage.unfinished = Some(vec![found("")]);
    stage.finish_saves().until(24.5);
    assert_eq!(stage.file(), "");
    stage.write(BOILER).finish_saves();
    assert_eq!(stage.file(), BOILER.replace("10", "70"));
}

// ---- hard links ----------------------------------------------------------------------------

#[test]
fn save_that_broke_hard_links_is_reported() {
    for (names, told) in [
        (1, "saved; the other hard link keeps the old content"),
        (2, "saved; 2 other hard links keep the old content"),
    ] {
        let mut stage = saving();
        stage.unfinished = Some(vec![SaveOutcome::LinksBroken(names)]);
        let screen = stage.finish_saves().screen();
        assert!(screen.contains(told), "{screen}");
        assert!(stage.app.message().is_some_and(|it| it.is_error));
        assert!(stage.app.timeline().entries().any(|it| it.text == told));
        assert_eq!(stage.app.file().unsaved(), 0);
        assert!(stage.until(40.0).screen().contains("✓ 5 entries"), "{}", stage.screen());
    }
}

// ---- several entries of one name -----------------------------------------------------------

/// Goes from each problem whose text contains this to the entry that it opens.
fn leads_to(stage: &mut Stage, problem: &str) -> usize {
    stage.keys("4 Home");
    for _ in 0..30 {
        let selected = stage.app.selected_problem().unwrap();
        if selected.findings.iter().any(|finding| finding.text.contains(problem)) {
            stage.keys("Enter");
            assert_eq!(stage.app.view().page, descan::app::Page::Devices, "{}", stage.screen());
            return stage.app.selected_row().unwrap().entry.unwrap().index;
        }
        stage.keys("j");
    }
    panic!("no {problem}\n{}", stage.screen());
}

#[test]
fn problem_selects_its_own_entry_among_twins() {
    let entries = [
        r#"{ "name": "TWIN", "address": 40 }"#,
        r#"{ "name": "TWIN", "address": "x" }"#,
        r#"{ "name": "TWIN", "address": 41, "static": 1 }"#,
        r#"{ "name": "SAME", "address": 50, "static": 2 }"#,
        r#"{ "name": "SAME", "address": 50, "uid": 3 }"#,
    ];
    for turn in 0..entries.len() {
        let mut turned = entries.to_vec();
        turned.rotate_left(turn);
        let at = |entry: usize| (entry + entries.len() - turn) % entries.len();
        let file = format!("[{}]", turned.join(",\n"));
        let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(&file));
        stage.until(24.0);
        for (problem, entry) in [
            ("TWIN (at 40) is listed but not on the bus", 0),
            ("TWIN is listed but not on the bus", 1),
            ("TWIN (at 41) is listed but not on the bus", 2),
            ("`address` is a string", 1),
            (&format!("`static` is a number; it must be true or false (line {},", at(2) + 1), 2),
            (&format!("`static` is a number; it must be true or false (line {},", at(3) + 1), 3),
            ("`uid` is a number", 4),
        ] {
            assert_eq!(leads_to(&mut stage, problem), at(entry), "{problem}\n{file}");
        }
        // An edit from either page changes the selected entry.
        leads_to(&mut stage, "`address` is a string");
        stage.keys("4 e Ctrl-u").text("99").keys("Enter");
        let wanted = file.replace("\"x\"", "99, \"static\": true");
        assert_eq!(stage.file(), wanted);
    }
}

#[test]
fn used_address_selects_the_twin_pinned_to_it() {
    let scenario = Scenario::new(125_000)
        .with(DeviceSpec::new("FEED").fixed(20).skips_address_resolution())
        .with(DeviceSpec::new("FEED").fixed(30).skips_address_resolution())
        .with(DeviceSpec::new("SENS").fixed(12).skips_address_resolution());
    for [first, second] in [[12, 30], [30, 12]] {
        let entry =
            |address| format!(r#"{{ "name": "FEED", "address": {address}, "static": true }}"#);
        let file = format!("[{}, {}]", entry(first), entry(second));
        let mut stage = Stage::new(&scenario, Some(&file));
        stage.until(12.0);
        let problem = "Static address 12 of FEED";
        assert_eq!(leads_to(&mut stage, problem), usize::from(second == 12), "{file}");
    }
}

// ---- no edit is lost -----------------------------------------------------------------------

/// A step, in random order, on a file that descan and another program edit.
#[derive(Clone, Copy, Debug)]
enum Step {
    /// descan edits one of its three entries.
    Edit(usize),
    Undo,
    /// The other program edits one of its own entries, in one write.
    Write(usize),
    /// The other program empties the file, and writes it in its next step.
    Empty(usize),
    /// The content is reported to descan if it is new.
    Look,
    /// A save begins, compares and renames, and its result is reported.
    Begin,
    Rename,
    Tell,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        3 => (0..3_usize).prop_map(Step::Edit),
        1 => Just(Step::Undo),
        2 => (3..6_usize).prop_map(Step::Write),
        2 => (3..6_usize).prop_map(Step::Empty),
        4 => Just(Step::Look),
        4 => Just(Step::Begin),
        4 => Just(Step::Rename),
        4 => Just(Step::Tell),
    ]
}

/// The file, descan, and both in between: a slow disk and a file watch.
struct Desk {
    file: FileState,
    disk: Vec<u8>,
    /// The content that the watch read last; `None`: uncertain.
    known: Option<Vec<u8>>,
    /// The content being saved, and the result once the rename succeeded or failed.
    save: Option<(Saving, Option<SaveOutcome>)>,
    /// The content that the other program will write into the file it has emptied.
    in_their_hands: Option<Vec<u8>>,
    /// The expected final address of each entry.
    wanted: [u8; 6],
    /// The edits of descan: the entry, and its address before.
    edits: Vec<(usize, u8)>,
    next: u8,
}

impl Desk {
    fn new() -> Self {
        let wanted = [101, 102, 103, 104, 105, 106];
        let disk = content(wanted);
        let mut file = FileState::new(Some("des.json".into()));
        file.read(Instant::ZERO, FileReading::Content(Some(disk.clone())));
        let known = Some(disk.clone());
        let (save, in_their_hands, edits) = (None, None, Vec::new());
        Self { file, disk, known, save, in_their_hands, wanted, edits, next: 1 }
    }

    fn take(&mut self, step: Step) {
        match step {
            Step::Edit(at) => {
                let to = self.next();
                let entry = self.file.document().key(at);
                let from = entry.address;
                self.file.edit(&[Operation::PinAddress { entry, from, to }]).unwrap();
                self.edits.push((at, self.wanted[at]));
                self.wanted[at] = to;
            }
            Step::Undo => {
                if let Some((at, before)) = self.edits.pop() {
                    self.file.undo().unwrap();
                    self.wanted[at] = before;
                }
            }
            Step::Write(at) | Step::Empty(at) => {
                if let Some(content) = self.in_their_hands.take() {
                    self.disk = content;
                    return;
                }
                let to = self.next();
                let on = Document::parse(&self.disk).unwrap();
                let entry = on.key(at);
                let operation = Operation::PinAddress { from: entry.address, entry, to };
                let content = on.apply(&operation).unwrap().source().to_vec();
                self.wanted[at] = to;
                if let Step::Write(_) = step {
                    self.disk = content;
                } else {
                    self.in_their_hands = Some(content);
                    self.disk = Vec::new();
                }
            }
            Step::Look => {
                if self.known.as_ref() != Some(&self.disk) {
                    self.known = Some(self.disk.clone());
                    let reading = FileReading::Content(self.known.clone());
                    self.file.read(Instant::ZERO, reading);
                }
            }
            Step::Begin => {
                let saving = self.file.start_saving();
                assert!(saving.is_none() || self.save.is_none(), "one at a time");
                if let Some(saving) = saving {
                    self.save = Some((saving, None));
                }
            }
            Step::Rename => {
                let Some((saving, outcome @ None)) = &mut self.save else { return };
                if saving.expected.as_ref().map(Document::source) == Some(&self.disk) {
                    assert!(self.in_their_hands.is_none(), "over what is being written");
                    self.disk = saving.content.source().to_vec();
                    *outcome = Some(SaveOutcome::Saved);
                } else {
                    let found = FileReading::Content(Some(self.disk.clone()));
                    *outcome = Some(SaveOutcome::Changed(found));
                }
            }
            Step::Tell => {
                let Some((saving, Some(outcome))) = self.save.take_if(|(_, it)| it.is_some())
                else {
                    return;
                };
                if self.file.is_base_changed() {
                    self.known = None;
                } else if outcome.is_on_disk() {
                    self.known = Some(saving.content.source().to_vec());
                }
                self.file.handle_saved(Instant::ZERO, outcome);
            }
        }
        assert_eq!((self.file.conflict(), self.file.problem()), (None, None));
    }

    fn next(&mut self) -> u8 {
        self.next = self.next % 100 + 1;
        self.next
    }
}

fn content(addresses: [u8; 6]) -> Vec<u8> {
    let entry = |(at, address): (usize, u8)| {
        format!("  {{ \"name\": \"N{at}\", \"address\": {address}, \"static\": true }}")
    };
    let entries: Vec<String> = addresses.into_iter().enumerate().map(entry).collect();
    format!("[\n{}\n]\n", entries.join(",\n")).into_bytes()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn two_editors_of_one_file_lose_nothing(steps in prop::collection::vec(step(), 1..80)) {
        let mut desk = Desk::new();
        for step in steps {
            desk.take(step);
        }
        if desk.in_their_hands.is_some() {
            desk.take(Step::Write(3));
        }
        for _ in 0..4 {
            for step in [Step::Look, Step::Begin, Step::Rename, Step::Tell, Step::Look] {
                desk.take(step);
            }
        }
        prop_assert_eq!(desk.file.unsaved(), 0);
        prop_assert_eq!(String::from_utf8(desk.disk).unwrap(), String::from_utf8(content(desk.wanted)).unwrap());
        prop_assert_eq!(desk.file.document().source(), content(desk.wanted));
    }
}
