//! Interrupted saves: killed at any system call, with any system call failing, or with another
//! program that changes the file right before the new one takes its place.
//!
//! This program starts itself under strace, which kills it or makes a system call fail at a chosen
//! call. strace counts calls per thread, so a save must run on the first thread, and the test
//! harness would start others. Where strace may not trace, a message is printed and the tests pass;
//! in CI they must run.

#[path = "it/common/access_list.rs"]
mod access_list;

use descan::shell::store::{SaveError, Store};
use nix::libc;
use nix::unistd::gettid;
use rustix::fs::{XattrFlags, getxattr, setxattr};
use std::collections::HashMap;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::Write as _;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, chown};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
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

/// Extended attributes of the file.
const ATTRIBUTES: [(&str, &[u8]); 2] =
    [(access_list::ATTRIBUTE, &access_list::access_list(6, 4)), ("user.note", b"of the user")];

fn main() {
    if let Some(path) = std::env::var_os("SAVE") {
        return one_save(Path::new(&path));
    }
    let Some(bench) = Bench::new() else { return };
    for has_file in [true, false] {
        is_killed_at_every_call(&bench, has_file);
        is_refused_at_every_call(&bench, has_file);
    }
    keeps_changes_right_before_the_exchange(&bench);
    keeps_writes_to_the_replaced_file(&bench);
    saves_where_files_cannot_be_exchanged(&bench);
}

/// Runs under strace.
fn one_save(path: &Path) {
    let (store, new) = (Store::new(path), new());
    let expected = path.exists().then_some(OLD);
    let is_over = Arc::new(AtomicBool::new(false));
    let edit = std::env::var("EDIT").ok();
    let editor = edit.map(|edit| edit_during_the_save(path, edit, is_over.clone()));
    let _ = fs::metadata(BEFORE);
    let saved = store.save(expected, &new);
    let _ = fs::metadata(AFTER);
    is_over.store(true, Ordering::SeqCst);
    if let Some(editor) = editor {
        editor.join().unwrap();
    }
    let outcome = match saved {
        Ok(_) => "saved".to_owned(),
        Err(SaveError::Changed(content)) => {
            assert_eq!(content, fs::read(path).ok());
            "changed".to_owned()
        }
        Err(SaveError::Unconfirmed(_)) => "unconfirmed".to_owned(),
        Err(error) => format!("not saved: {error}"),
    };
    fs::write(path.with_extension("outcome"), outcome).unwrap();
}

/// Edits the file as soon as the calling thread is in the system call that replaces it; late edits
/// when it waits after that; not at all if the save is over before. strace does not trace the thread
/// of the edit.
fn edit_during_the_save(
    path: &Path,
    edit: String,
    is_over: Arc<AtomicBool>,
) -> thread::JoinHandle<()> {
    let (path, saver) = (path.to_owned(), gettid());
    let old = File::options().write(true).open(&path).unwrap();
    let is_late = edit.starts_with("late");
    let call = if is_late { libc::SYS_clock_nanosleep } else { libc::SYS_renameat2 };
    thread::spawn(move || {
        let present = format!("/proc/self/task/{saver}/syscall");
        let call = format!("{call} ");
        while !fs::read_to_string(&present).is_ok_and(|present| present.starts_with(&call)) {
            if is_over.load(Ordering::SeqCst) {
                return;
            }
            thread::yield_now();
        }
        edit_file(&path, &old, &edit);
    })
}

/// The content that another program writes, as long as the old one.
const THEIRS: &[u8] = b"{ \"devices\": [ { \"name\": \"FEED\", \"address\": 13 } ] }\n";

/// `old`: the file as opened before the save.
fn edit_file(path: &Path, mut old: &File, edit: &str) {
    match edit {
        "write" => fs::write(path, THEIRS).unwrap(),
        "replace" => {
            fs::write(path.with_extension("new"), THEIRS).unwrap();
            fs::rename(path.with_extension("new"), path).unwrap();
        }
        "protect" => fs::set_permissions(path, fs::Permissions::from_mode(0o600)).unwrap(),
        "delete" => fs::remove_file(path).unwrap(),
        "late" => old.write_all(THEIRS).unwrap(),
        "late, deleted" => {
            fs::remove_file(path).unwrap();
            old.write_all(THEIRS).unwrap();
        }
        other => panic!("{other}"),
    }
}

/// Owner, group, mode and the extended attributes of a file.
#[derive(Debug, PartialEq, Eq)]
struct Attributes {
    owner: (u32, u32),
    mode: u32,
    extended: Vec<(&'static str, Option<Vec<u8>>)>,
}

impl Attributes {
    fn of(path: &Path) -> Option<Self> {
        let metadata = fs::metadata(path).ok()?;
        let value = |name: &str| {
            let mut value = vec![0; 1024];
            let size = getxattr(path, name, &mut value[..]).ok()?;
            Some(value[..size].to_vec())
        };
        let extended = ATTRIBUTES.iter().map(|(name, _)| (*name, value(name))).collect();
        let owner = (metadata.uid(), metadata.gid());
        Some(Self { owner, mode: metadata.mode() & 0o7777, extended })
    }
}

/// Creates the file, with attributes as far as the file system and the user's rights allow.
fn create_old(path: &Path) {
    fs::write(path, OLD).unwrap();
    fs::set_permissions(path, fs::Permissions::from_mode(0o640)).unwrap();
    for (name, value) in ATTRIBUTES {
        if let Err(error) = setxattr(path, name, value, XattrFlags::empty()) {
            println!("left out: {name}: {error}");
        }
    }
    if nix::unistd::geteuid().is_root() {
        chown(path, Some(1234), Some(4321)).unwrap();
    }
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
    /// Those of the file, before and after.
    attributes: [Option<Attributes>; 2],
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
        let inject =
            |(what, call): (&str, &Call)| format!("{}:{what}:when={}", call.name, call.count);
        self.run(has_file, injection.map(inject).as_deref(), None)
    }

    /// Saves, with this injection and an edit by another program.
    fn run(&self, has_file: bool, injection: Option<&str>, edit: Option<&str>) -> Saved {
        let (path, log) = (self.path(), self.folder.path().join("log"));
        let folder = path.parent().unwrap();
        let _ = fs::remove_dir_all(folder);
        fs::create_dir(folder).unwrap();
        if has_file {
            create_old(&path);
        }
        let before = Attributes::of(&path);
        let mut command = Command::new("strace");
        command.args(["-qq", "-s", "64", "-o"]).arg(&log);
        if let Some(injection) = injection {
            command.args(["-e", &format!("inject={injection}")]);
        }
        if let Some(edit) = edit {
            command.env("EDIT", edit);
        }
        command.arg(std::env::current_exe().unwrap()).env("SAVE", &path);
        command.output().expect("strace runs");
        let outcome = fs::read_to_string(path.with_extension("outcome")).ok();
        let _ = fs::remove_file(path.with_extension("outcome"));
        let (calls, is_over) = calls(&fs::read_to_string(log).unwrap());
        let attributes = [before, Attributes::of(&path)];
        let content = fs::read(&path).ok();
        Saved { calls, is_over, outcome, content, attributes, beside: self.beside() }
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
    for needed in ["flock", "write", "fsync", "renameat2"] {
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
        assert_same_attributes(&killed, has_file, &what);
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

/// The file has the same owner, mode and attributes as before, whichever content it has.
fn assert_same_attributes(saved: &Saved, has_file: bool, what: &str) {
    let [before, after] = &saved.attributes;
    assert!(!has_file || before == after, "{what}: {before:?}, then {after:?}");
}

/// Makes each system call fail: the error is reported, the file is intact, and no other file
/// remains.
fn is_refused_at_every_call(bench: &Bench, has_file: bool) {
    /// Calls that a disk, a folder or its permissions can make fail.
    const REFUSED: [&str; 18] = [
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
        "lseek",
        "flistxattr",
        "fgetxattr",
        "fsetxattr",
        "fremovexattr",
        "flock",
    ];
    /// Calls without which no content is saved.
    const NEEDED: [&str; 6] = ["write", "renameat2", "fchown", "fchmod", "fsetxattr", "flistxattr"];
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
                .clone()
                .unwrap_or_else(|| panic!("{error} of {}: it does not end", call.text));
            let what = format!("{error} of {}: {outcome}", call.text);
            refusals += 1;
            assert_same_attributes(&refused, has_file, &what);
            if outcome == "saved" {
                assert_eq!(refused.content, Some(new()), "{what}");
                assert!(!NEEDED.contains(&call.name.as_str()), "{what}");
            } else if Some(at) == last {
                // The folder could not be synced: the new content is there, but may be lost in a
                // power failure.
                assert_eq!((&*outcome, refused.content), ("unconfirmed", Some(new())), "{what}");
            } else {
                assert_eq!(refused.content, old_content, "{what}");
            }
            assert_eq!(refused.beside, 0, "{what}");
        }
    }
    println!("{refusals} refused system calls: nothing is torn or left behind");
}

/// Another program changes the file after the last comparison, before the new file takes its place:
/// its change stays, with the attributes it has then, and is what the save reports.
fn keeps_changes_right_before_the_exchange(bench: &Bench) {
    for (edit, content) in [
        ("write", Some(THEIRS)),
        ("replace", Some(THEIRS)),
        ("protect", Some(OLD)),
        ("delete", None),
    ] {
        let saved = bench.run(true, Some("renameat2:delay_enter=500000:when=1"), Some(edit));
        assert_eq!(saved.outcome.as_deref(), Some("changed"), "{edit}");
        assert_eq!(saved.content.as_deref(), content, "{edit}");
        let mode = saved.attributes[1].as_ref().map(|attributes| attributes.mode);
        assert!(edit != "protect" || mode == Some(0o600), "{mode:?}");
        assert_eq!(saved.beside, 0, "{edit}");
    }
}

/// Another program writes to the file that it had open before the new one took its place: the file
/// is put back, even if the two files cannot be exchanged again.
fn keeps_writes_to_the_replaced_file(bench: &Bench) {
    for edit in ["late", "late, deleted"] {
        for injection in [None, Some("renameat2:error=EIO:when=2")] {
            if edit == "late, deleted" && injection.is_some() {
                continue;
            }
            let saved = bench.run(true, injection, Some(edit));
            let what = format!("{edit}, {injection:?}");
            assert_eq!(saved.outcome.as_deref(), Some("changed"), "{what}");
            assert_eq!(saved.content.as_deref(), Some(THEIRS), "{what}");
            assert_same_attributes(&saved, true, &what);
            assert_eq!(saved.beside, 0, "{what}");
        }
    }
}

/// Some file systems and old kernels refuse the exchange.
fn saves_where_files_cannot_be_exchanged(bench: &Bench) {
    for error in ["EINVAL", "ENOSYS", "EOPNOTSUPP"] {
        let saved = bench.run(true, Some(&format!("renameat2:error={error}")), None);
        assert_eq!(saved.outcome.as_deref(), Some("saved"), "{error}");
        assert_eq!(saved.content, Some(new()), "{error}");
        assert_same_attributes(&saved, true, error);
        assert_eq!(saved.beside, 0, "{error}");
    }
}
