//! Interrupted saves: killed at any system call, or with any system call failing.
//!
//! This program starts itself under strace, which kills it or makes a system call fail at a chosen
//! call. strace counts calls per thread, so a save must run on the first thread, and the test
//! harness would start others. Where strace may not trace, a message is printed and the tests pass;
//! in CI they must run.

use descan::shell::store::{SaveError, Store};
use std::collections::HashMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

const OLD: &[u8] = b"{ \"devices\": [ { \"name\": \"FEED\", \"address\": 12 } ] }\n";

/// Content longer than one page.
fn new() -> Vec<u8> {
    let entries = (0..900).fold(String::new(), |mut text, number| {
        let _ = write!(text, "\n  {{ \"name\": \"N{number}\" }},");
        text
    });
    format!("[{entries}\n  {{}}\n]\n").into_bytes()
}

/// Path used in system calls before and after the save, as markers in the trace.
const BEFORE: &str = "/the-save-begins";
const AFTER: &str = "/the-save-is-over";

fn main() {
    if let Some(path) = std::env::var_os("SAVE") {
        return one_save(Path::new(&path));
    }
    let Some(bench) = Bench::new() else { return };
    for has_file in [true, false] {
        is_killed_at_every_call(&bench, has_file);
        is_refused_at_every_call(&bench, has_file);
    }
}

/// Runs under strace.
fn one_save(path: &Path) {
    let (store, new) = (Store::new(path), new());
    let expected = path.exists().then_some(OLD);
    let _ = fs::metadata(BEFORE);
    let saved = store.save(expected, &new);
    let _ = fs::metadata(AFTER);
    let outcome = match saved {
        Ok(_) => "saved".to_owned(),
        Err(SaveError::Changed(_)) => "changed".to_owned(),
        Err(error) => format!("not saved: {error}"),
    };
    fs::write(path.with_extension("outcome"), outcome).unwrap();
}

/// A folder for saves under strace.
struct Bench {
    folder: TempDir,
}

/// The result of a save.
struct Saved {
    /// The system calls of the save.
    calls: Vec<Call>,
    /// True if it ran to its end.
    is_over: bool,
    /// Its output.
    outcome: Option<String>,
    content: Option<Vec<u8>>,
    /// The number of files beside it.
    beside: usize,
}

/// A system call.
#[derive(Debug)]
struct Call {
    name: String,
    /// The number of calls of this name so far, including this one.
    count: usize,
    /// The line printed by strace.
    text: String,
}

impl Bench {
    fn new() -> Option<Self> {
        let probe = Command::new("strace").args(["-o", "/dev/null", "true"]).output();
        let why = match probe {
            Ok(output) if output.status.success() => {
                return Some(Self { folder: tempfile::tempdir().unwrap() });
            }
            Ok(output) => String::from_utf8_lossy(&output.stderr).trim().to_owned(),
            Err(error) => format!("strace: {error}"),
        };
        assert!(!std::env::var("CI").is_ok_and(|ci| ci == "true"), "cannot run: {why}");
        println!("skipped: {why}");
        None
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("files/des.json")
    }

    fn beside(&self) -> usize {
        let names = fs::read_dir(self.path().parent().unwrap()).unwrap();
        names.filter(|entry| entry.as_ref().unwrap().path() != self.path()).count()
    }

    /// Saves, with this fault injected by strace into this call.
    fn save(&self, has_file: bool, injection: Option<(&str, &Call)>) -> Saved {
        let (path, log) = (self.path(), self.folder.path().join("log"));
        let folder = path.parent().unwrap();
        let _ = fs::remove_dir_all(folder);
        fs::create_dir(folder).unwrap();
        if has_file {
            fs::write(&path, OLD).unwrap();
        }
        let mut command = Command::new("strace");
        command.args(["-qq", "-s", "64", "-o"]).arg(&log);
        if let Some((what, call)) = injection {
            command.args(["-e", &format!("inject={}:{what}:when={}", call.name, call.count)]);
        }
        command.arg(std::env::current_exe().unwrap()).env("SAVE", &path);
        command.output().expect("strace runs");
        let outcome = fs::read_to_string(path.with_extension("outcome")).ok();
        let _ = fs::remove_file(path.with_extension("outcome"));
        let (calls, is_over) = calls(&fs::read_to_string(log).unwrap());
        Saved { calls, is_over, outcome, content: fs::read(&path).ok(), beside: self.beside() }
    }
}

/// Returns the calls of the save with the one after it, and whether it ran to its end.
fn calls(log: &str) -> (Vec<Call>, bool) {
    let mut counts: HashMap<&str, usize> = HashMap::new();
    let mut calls = Vec::new();
    let mut has_begun = false;
    for text in log.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_lowercase())) {
        let name = text.split('(').next().unwrap_or_default();
        let count = counts.entry(name).or_default();
        *count += 1;
        if has_begun {
            calls.push(Call { name: name.to_owned(), count: *count, text: text.to_owned() });
        }
        has_begun |= text.contains(BEFORE);
        if text.contains(AFTER) {
            return (calls, true);
        }
    }
    (calls, false)
}

/// Kills the save before each system call, and after the last: the file has the old or the new
/// content, complete, and the next save works as usual.
fn is_killed_at_every_call(bench: &Bench, has_file: bool) {
    let whole = bench.save(has_file, None);
    assert_eq!(whole.outcome.as_deref(), Some("saved"));
    assert_eq!(whole.content, Some(new()));
    for needed in ["flock", "write", "fsync"] {
        assert!(whole.calls.iter().any(|call| call.name == needed), "{:?}", whole.calls);
    }
    let old_content = has_file.then(|| OLD.to_vec());
    let (mut old, mut newer, mut left) = (0, 0, 0);
    for (at, call) in whole.calls.iter().enumerate() {
        let killed = bench.save(has_file, Some(("signal=KILL", call)));
        let what = format!("killed at {}", call.text);
        assert_eq!(killed.outcome, None, "{what}: it goes on");
        assert_eq!(killed.calls.len(), at + 1, "{what}: {:?}", killed.calls);
        assert_eq!(killed.is_over, at + 1 == whole.calls.len(), "{what}");
        if killed.content == Some(new()) {
            newer += 1;
        } else {
            assert_eq!(killed.content, old_content, "{what}");
            assert_eq!(newer, 0, "{what}: the old content is back");
            old += 1;
        }
        left += killed.beside;
        let store = Store::new(bench.path());
        store.save(killed.content.as_deref(), b"[]").unwrap();
        assert_eq!(store.read().unwrap().unwrap(), b"[]", "{what}");
        assert_eq!(bench.beside(), 0, "{what}: something stays beside it");
    }
    // At different stages: before the rename, after it, and with the new file beside the old.
    assert!(old > 10 && newer > 2 && left > 2, "{old} old, {newer} new, {left} left behind");
    let before = if has_file { "the old content" } else { "no file" };
    println!(
        "killed at {} system calls: {before} {old} times, the new content {newer} times",
        old + newer
    );
}

/// Makes each system call fail: the error is reported, the file is intact, and no other file
/// remains.
fn is_refused_at_every_call(bench: &Bench, has_file: bool) {
    /// Calls that a disk, a folder or its permissions can make fail.
    const REFUSED: [&str; 13] = [
        "openat",
        "write",
        "read",
        "fsync",
        "rename",
        "renameat",
        "renameat2",
        "link",
        "linkat",
        "fchmod",
        "fchown",
        "statx",
        "flock",
    ];
    /// Calls without which no content is saved.
    const NEEDED: [&str; 5] = ["write", "fsync", "rename", "renameat", "fchmod"];
    let whole = bench.save(has_file, None);
    let old_content = has_file.then(|| OLD.to_vec());
    let last = whole.calls.iter().rposition(|call| call.name == "fsync");
    let mut refusals = 0;
    for (at, call) in whole.calls.iter().enumerate() {
        if !REFUSED.contains(&call.name.as_str()) || call.text.contains(AFTER) {
            continue;
        }
        for error in ["ENOSPC", "EIO", "EACCES"] {
            let refused = bench.save(has_file, Some((&format!("error={error}"), call)));
            let outcome = refused
                .outcome
                .unwrap_or_else(|| panic!("{error} of {}: it does not end", call.text));
            let what = format!("{error} of {}: {outcome}", call.text);
            refusals += 1;
            if outcome == "saved" {
                assert_eq!(refused.content, Some(new()), "{what}");
                assert!(!NEEDED.contains(&call.name.as_str()), "{what}");
            } else if Some(at) == last {
                // The folder could not be synced: the new content is there, but may be lost in a
                // power failure.
                assert_eq!(refused.content, Some(new()), "{what}");
            } else {
                assert_eq!(refused.content, old_content, "{what}");
            }
            assert_eq!(refused.beside, 0, "{what}");
        }
    }
    println!("{refusals} refused system calls: nothing is torn or left behind");
}
