//! Common editors change des.json while the user types an address in the real program: theirs and
//! ours both survive. Also two instances of descan on one file.
//!
//! Editors that are not installed are skipped with a message; in CI all must be installed.

use crate::common::pty;
use crate::common::pty::Pty;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

const BEFORE: &str = "{ \"devices\": [\n  {\"name\": \"FEED\", \"address\": 9},\n\n  \
                      {\"name\": \"VALVE\", \"address\": 70} ] }\n";

/// Shell commands that change a file from `$OLD` to `$NEW`; `../new` has the complete content after
/// the change.
const WAYS: [(&str, &str); 12] = [
    ("vim", "vim -u NONE -N -Es -c \"%s/$OLD/$NEW/\" -c x des.json"),
    ("vim", "vim -u NONE -N -Es -c 'set backup backupcopy=no' -c \"%s/$OLD/$NEW/\" -c x des.json"),
    ("vim", "vim -u NONE -N -Es -c 'set backupcopy=yes' -c \"%s/$OLD/$NEW/\" -c x des.json"),
    ("nano", ""),
    ("sed", "sed -i \"s/$OLD/$NEW/\" des.json"),
    (
        "git",
        "git init -q . && git update-index --add --cacheinfo \
         100644,$(git hash-object -w ../new),des.json && git checkout -q -- des.json",
    ),
    ("sh", "cat ../new >des.json"),
    ("sh", ": >des.json && sleep 0.3 && cat ../new >>des.json"),
    ("sh", "cp ../new .des.json.swp && mv .des.json.swp des.json"),
    ("sh", "mv des.json des.json~ && cp ../new des.json"),
    ("sh", "rm des.json && cp ../new des.json"),
    ("sh", "rm des.json && sleep 0.3 && cp ../new des.json"),
];

#[test]
fn edits_of_vim_nano_and_git_are_merged() {
    let folder = tempfile::tempdir().unwrap();
    let project = folder.path().join("project");
    fs::create_dir(&project).unwrap();
    let path = project.join("des.json");
    fs::write(&path, BEFORE).unwrap();
    let mut pty = Pty::start(&["sim:boiler", "--file", "des.json"], &project, (120, 40));
    pty.wait_for("SENS");
    pty.wait_for("VALVE");
    let (mut feed, mut valve) = ("\"address\": 9}".to_owned(), 70);
    let mut content = BEFORE.to_owned();
    for (program, script) in WAYS {
        if !is_there(program) {
            continue;
        }
        pty.send("gge\x154");
        pty.wait_for("Enter pins it to 4");
        let theirs = content.replace(&valve.to_string(), &(valve + 1).to_string());
        fs::write(folder.path().join("new"), &theirs).unwrap();
        match program {
            "nano" => type_into_nano(&project, valve),
            _ => run(&project, script, valve),
        }
        assert_eq!(fs::read_to_string(&path).unwrap(), theirs, "{program}: {script}");
        valve += 1;
        // The input line is still open, and the change is shown behind it.
        let row = format!("{valve} VALVE");
        pty.wait_until(&row, |screen| screen.contents().contains(&row));
        let digit = valve % 10;
        pty.send(&format!("{digit}\r"));
        let ours = format!("\"address\": 4{digit}, \"static\": true}}");
        let both = theirs.replace(&feed, &ours);
        wait_for_content(&mut pty, &path, &both, &format!("{program}: {script}"));
        (content, feed) = (both, ours);
    }
    // Undone one after the other, across all those saves; theirs stay.
    let pinned = content.clone();
    pty.send("u");
    pty.wait_for("undone: ");
    let deadline = Instant::now() + pty::PATIENCE;
    while fs::read_to_string(&path).unwrap() == pinned {
        assert!(Instant::now() < deadline, "{}", pty.screen());
        pty.count_for(Duration::from_millis(10));
    }
    for _ in 0..WAYS.len() {
        pty.send("u");
    }
    let first = BEFORE.replace("70", &valve.to_string());
    wait_for_content(&mut pty, &path, &first, "taken back");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn two_descans_edit_one_file_without_loss() {
    const FILE: &str =
        "[ {\"name\":\"FEED\",\"address\":9},\n\t{\"name\":\"SENS\",\"address\":12} ]\n";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("des.json");
    fs::write(&path, FILE).unwrap();
    let start = || {
        let mut pty = Pty::start(&["sim:boiler"], folder.path(), (120, 40));
        // The rows of entries stay where the devices are.
        for device in ["10 FEED ", "12 SENS"] {
            pty.wait_until(device, |screen| {
                let contents = screen.contents();
                contents.lines().any(|line| line.contains(device) && line.contains("online"))
            });
        }
        pty
    };
    let (mut first, mut second) = (start(), start());
    // Both edit again and again, without waiting for each other.
    for address in 30..40 {
        first.send(&format!("gge\x15{address}\r"));
        second.send(&format!("ggje\x15{}\r", address + 50));
    }
    let ours = FILE.replace(":9}", ":39,\"static\":true}");
    let both = ours.replace(":12}", ":89,\"static\":true}");
    wait_for_content(&mut first, &path, &both, "both");
    // Each undoes its own edits only.
    first.send("uuuuuuuuuu");
    let theirs = FILE.replace(":12}", ":89,\"static\":true}");
    wait_for_content(&mut first, &path, &theirs, "the first's taken back");
    second.send("uuuuuuuuuu");
    wait_for_content(&mut second, &path, FILE, "the second's taken back");
    for pty in [&mut first, &mut second] {
        pty.wait_for("✓ 2 entries");
        pty.send("q");
        assert_eq!(pty.wait(), 0);
    }
}

/// Tests hard links as in a backup made by `cp -al`.
#[test]
fn broken_hard_link_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("backup.json"), BEFORE).unwrap();
    fs::hard_link(at("backup.json"), at("des.json")).unwrap();
    let mut pty = Pty::start(&["sim:boiler"], folder.path(), (120, 40));
    pty.wait_for("SENS");
    pty.send("gge\x1547\r");
    pty.wait_for("saved; the other hard link keeps the old content");
    let ours = BEFORE.replace("9}", "47, \"static\": true}");
    assert_eq!(fs::read_to_string(at("des.json")).unwrap(), ours);
    assert_eq!(fs::read_to_string(at("backup.json")).unwrap(), BEFORE);
    // It is watched as before.
    fs::write(at("des.json"), ours.replace("VALVE", "VALVO")).unwrap();
    pty.wait_for("VALVO");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

fn is_there(program: &str) -> bool {
    if Command::new(program).arg("--version").output().is_ok() {
        return true;
    }
    assert!(!std::env::var("CI").is_ok_and(|ci| ci == "true"), "cannot run: no {program}");
    // Not by println: the test harness would capture it.
    let _ = writeln!(std::io::stderr(), "left out: {program} is not installed");
    false
}

fn run(folder: &Path, script: &str, valve: u8) {
    let mut command = Command::new("sh");
    command.args(["-ec", script]).current_dir(folder).env("HOME", folder);
    command.env("OLD", valve.to_string()).env("NEW", (valve + 1).to_string());
    let output = command.output().unwrap();
    assert!(output.status.success(), "{script}: {output:?}");
}

fn type_into_nano(folder: &Path, valve: u8) {
    let mut nano = Pty::run("nano", &["--ignorercfiles", "des.json"], folder, (80, 24));
    nano.wait_for("GNU nano");
    nano.wait_for("VALVE");
    // Search and replace, write out, exit.
    nano.send("\x1c");
    nano.wait_for("Search (to replace)");
    nano.send(&format!("{valve}\r"));
    nano.wait_for("Replace with");
    nano.send(&format!("{}\r", valve + 1));
    nano.wait_for("Replace this instance?");
    nano.send("a");
    nano.wait_for("Replaced 1 occurrence");
    nano.send("\x0f");
    nano.wait_for("File Name to Write");
    nano.send("\r");
    nano.wait_for("Wrote ");
    nano.send("\x18");
    assert_eq!(nano.wait(), 0);
}

fn wait_for_content(pty: &mut Pty, path: &Path, wanted: &str, what: &str) {
    let deadline = Instant::now() + pty::PATIENCE;
    while fs::read_to_string(path).unwrap() != wanted {
        let content = fs::read_to_string(path).unwrap();
        assert!(Instant::now() < deadline, "{what}\n{content}\n{}", pty.screen());
        pty.count_for(Duration::from_millis(10));
    }
}
