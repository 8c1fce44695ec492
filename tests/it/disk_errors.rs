//! The real binary on disks that reject writes: the edit is kept, the cause is named, and the edit
//! is saved as soon as possible.
//!
//! Disks are created in separate mount namespaces. Where only root may do that, the tests print the
//! reason and pass; in CI they must run.

use crate::common::pty;
use crate::common::pty::Pty;
use nix::sys::signal::Signal;
use std::fs::{self, Permissions};
use std::io::Write;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};
use tempfile::TempDir;

const BEFORE: &str = "[\n  {\"name\": \"FEED\", \"address\": 9}\n]\n";
const AFTER: &str = "[\n  {\"name\": \"FEED\", \"address\": 47, \"static\": true}\n]\n";

fn may_mount() -> bool {
    let probe = Command::new("unshare").args(["--mount", "true"]).output();
    let why = match probe {
        Ok(output) if output.status.success() => return true,
        Ok(output) => String::from_utf8_lossy(&output.stderr).trim().to_owned(),
        Err(error) => format!("unshare: {error}"),
    };
    assert!(!std::env::var("CI").is_ok_and(|ci| ci == "true"), "cannot run: {why}");
    // Not by println: the test harness would capture it.
    let _ = writeln!(std::io::stderr(), "skipped: {why}");
    false
}

/// The program with a file on its own disk.
struct Disk {
    folder: TempDir,
    pty: Pty,
}

impl Disk {
    /// Starts the program after `mounts`, shell commands run in the folder of the file.
    fn new(mounts: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        // Users other than root start the program too.
        fs::set_permissions(folder.path(), Permissions::from_mode(0o755)).unwrap();
        let program = folder.path().join("descan");
        fs::copy(env!("CARGO_BIN_EXE_descan"), &program).unwrap();
        let disk = folder.path().join("disk");
        fs::create_dir(&disk).unwrap();
        fs::write(disk.join("des.json"), BEFORE).unwrap();
        let script = format!(
            "as='' && cd disk && {mounts} && cd .. && exec $as ./descan sim:boiler --file disk/des.json"
        );
        let arguments = ["--mount", "sh", "-ec", &script];
        let mut pty = Pty::run("unshare", &arguments, folder.path(), (200, 30));
        pty.wait_for("SENS");
        Self { folder, pty }
    }

    /// Returns the path as the program sees it.
    fn seen(&self, path: &str) -> PathBuf {
        let inside = self.folder.path().join(path);
        Path::new(&format!("/proc/{}/root", self.pty.pid())).join(inside.strip_prefix("/").unwrap())
    }

    fn content(&self) -> Option<String> {
        fs::read_to_string(self.seen("disk/des.json")).ok()
    }

    /// Runs a command in the program's mount namespace.
    fn among_its_mounts(&self, command: &[&str]) {
        let pid = self.pty.pid().to_string();
        let status = Command::new("nsenter").args(["-t", &pid, "-m", "--"]).args(command).status();
        assert!(status.unwrap().success(), "{command:?}");
    }

    /// Pins FEED to 47, and asserts that the save fails with this cause, that a quit attempt keeps
    /// the edit, and that a recovery copy is written elsewhere.
    fn is_kept(&mut self, cause: &str) {
        self.pty.send("gge\x1547\r");
        self.pty.wait_for("✗ not saved");
        self.pty.wait_for(cause);
        assert_eq!(self.content().as_deref(), Some(BEFORE));
        self.pty.send("q");
        self.pty.wait_for("1 edit is not saved. Quit anyway?");
        self.pty.send("n");
        self.pty.wait_for("Ctrl-s save again  W save a copy");
        let copy = self.folder.path().join("copy.json");
        self.pty.send(&format!("W\x15{}\r", copy.display()));
        self.pty.wait_for("a copy with all edits: ");
        assert_eq!(fs::read_to_string(&copy).unwrap(), AFTER);
        self.pty.send("q");
        self.pty.wait_for("1 edit is saved only in ");
        self.pty.send("n");
        assert_eq!(self.content().as_deref(), Some(BEFORE));
    }

    /// Chooses a side on the edit conflict page, as soon as the page accepts keys.
    fn choose(&mut self, key: &str) {
        let deadline = Instant::now() + pty::PATIENCE;
        while self.pty.screen().contains("Edit conflict") {
            assert!(Instant::now() < deadline, "{}", self.pty.screen());
            self.pty.send(key);
            self.pty.count_for(Duration::from_millis(400));
        }
    }

    /// Asserts that the edit is saved without a key once the cause is removed.
    fn is_saved_at_last(&mut self) {
        let deadline = Instant::now() + pty::PATIENCE;
        while self.content().as_deref() != Some(AFTER) {
            assert!(Instant::now() < deadline, "{:?}\n{}", self.content(), self.pty.screen());
            self.pty.count_for(Duration::from_millis(20));
        }
        self.pty.wait_until("the file saved", |screen| !screen.contents().contains("not saved"));
        let beside = fs::read_dir(self.seen("disk")).unwrap().map(|it| it.unwrap().file_name());
        let left: Vec<_> = beside.filter(|it| it.to_string_lossy().contains("descan-")).collect();
        assert!(left.is_empty(), "{left:?}");
        self.pty.send("q");
        assert_eq!(self.pty.wait(), 0);
        self.pty.assert_given_back();
    }
}

#[test]
fn full_disk_keeps_edits_until_space_is_free() {
    if !may_mount() {
        return;
    }
    let mut disk = Disk::new(
        "cp des.json .. && mount -t tmpfs -o size=64k tmpfs . && cd ../disk && cp ../des.json . \
         && { head -c 1M /dev/zero >filling 2>/dev/null || true; }",
    );
    disk.is_kept("the disk is full; make room");
    fs::remove_file(disk.seen("disk/filling")).unwrap();
    disk.is_saved_at_last();
}

#[test]
fn read_only_disk_keeps_edits_unsaved() {
    if !may_mount() {
        return;
    }
    let mut disk = Disk::new("mount --bind . . && mount -o remount,ro,bind \"$PWD\"");
    disk.is_kept("mounted read-only; remount it");
    let folder = disk.folder.path().join("disk");
    disk.among_its_mounts(&["mount", "-o", "remount,rw,bind", folder.to_str().unwrap()]);
    disk.is_saved_at_last();
}

#[test]
fn file_that_is_a_mount_point_is_not_replaced() {
    if !may_mount() {
        return;
    }
    let mut disk = Disk::new("cp des.json ../real.json && mount --bind ../real.json des.json");
    disk.is_kept("a bind mount; mount its folder");
    let file = disk.folder.path().join("disk/des.json");
    disk.among_its_mounts(&["umount", file.to_str().unwrap()]);
    disk.is_saved_at_last();
}

/// Tests a disk like a network file system that responds late, or never.
#[test]
fn hanging_disk_does_not_block_the_screen() {
    if !may_mount() {
        return;
    }
    let never = || {
        Disk::new(
            "printf '#include <unistd.h>\nint fsync(int file) { for (;;) pause(); }\n' >../never.c \
         && cc -shared -fPIC -o ../never.so ../never.c && as=\"env LD_PRELOAD=$PWD/../never.so\"",
        )
    };
    let mut disk = never();
    disk.pty.send("gge\x1547\r");
    disk.pty.wait_for("… saving 1");
    // Editing continues meanwhile.
    disk.pty.send("R\x15PUMP\r");
    disk.pty.wait_for("… saving 2");
    disk.pty.send("3");
    disk.pty.wait_for("entry FEED at 47 renamed to PUMP");
    // A change by another program is shown all the same, together with ours.
    let theirs = BEFORE.replace("9}", "9},\n  {\"name\": \"VALVE\", \"address\": 77}");
    fs::write(disk.seen("disk/des.json"), &theirs).unwrap();
    disk.pty.send("1");
    disk.pty.wait_for("VALVE");
    disk.pty.wait_for("PUMP");
    disk.pty.wait_for("… saving 2");
    disk.pty.send("q");
    disk.pty.wait_for("2 edits are still being saved. Quit without waiting?");
    disk.pty.send("y");
    assert_eq!(disk.pty.wait(), 0);
    disk.pty.assert_given_back();
    let content = |disk: &Disk| fs::read_to_string(disk.folder.path().join("disk/des.json"));
    assert_eq!(content(&disk).unwrap(), theirs);

    // Nor does it delay a shutdown of the machine.
    let mut disk = never();
    disk.pty.send("gge\x1547\r");
    disk.pty.wait_for("… saving 1");
    disk.pty.signal(Signal::SIGTERM);
    let signalled = Instant::now();
    assert_eq!(disk.pty.wait(), 130);
    // Within a second, and time for a busy machine.
    assert!(signalled.elapsed() < Duration::from_secs(3), "{:?}", signalled.elapsed());
    disk.pty.assert_given_back();
    assert_eq!(content(&disk).unwrap(), BEFORE);
    assert!(disk.pty.screen().contains("a copy with all edits is"), "{}", disk.pty.screen());
}

/// Tests that a save under way is waited for: what is on the disk is not reported as lost.
#[test]
fn signal_during_a_slow_save_waits_for_it() {
    if !may_mount() {
        return;
    }
    for signal in [Signal::SIGTERM, Signal::SIGHUP, Signal::SIGINT] {
        let mut disk = Disk::new(
            "printf '#include <unistd.h>\nint fsync(int file) { usleep(100000); return fdatasync(file); }\n' \
             >../late.c && cc -shared -fPIC -o ../late.so ../late.c \
             && as=\"env LD_PRELOAD=$PWD/../late.so\"",
        );
        disk.pty.send("gge\x1547\r");
        disk.pty.wait_for("… saving 1");
        disk.pty.signal(signal);
        assert_eq!(disk.pty.wait(), 130, "{signal}");
        disk.pty.assert_given_back();
        let file = disk.folder.path().join("disk/des.json");
        assert_eq!(fs::read_to_string(file).unwrap(), AFTER, "{signal}");
        assert!(!disk.pty.screen().contains("not saved"), "{}", disk.pty.screen());
        assert!(!disk.folder.path().join("state/descan").exists(), "{signal}: a recovery copy");
    }
}

/// Tests that a file size limit is an error of the save, not the end of the program.
#[test]
fn file_size_limit_keeps_edits() {
    let folder = tempfile::tempdir().unwrap();
    let filling = "x".repeat(20_000);
    let text = format!("[{{\"name\": \"FEED\", \"address\": 9, \"note\": \"{filling}\"}}]");
    fs::write(folder.path().join("des.json"), &text).unwrap();
    let script =
        format!("ulimit -f 20; exec {} sim:boiler --file des.json", env!("CARGO_BIN_EXE_descan"));
    let mut pty = Pty::run("sh", &["-c", &script], folder.path(), (120, 30));
    pty.wait_for("SENS");
    pty.send("gge\x1547\r");
    pty.wait_for("✗ not saved");
    pty.wait_for("file size limit reached");
    assert_eq!(fs::read_to_string(folder.path().join("des.json")).unwrap(), text);
    pty.send("qy");
    pty.wait();
    pty.assert_given_back();
    let left = fs::read_dir(folder.path()).unwrap().map(|it| it.unwrap().file_name());
    let left: Vec<_> = left.filter(|it| it.to_string_lossy().contains("descan-")).collect();
    assert!(left.is_empty(), "{left:?}");
}

/// Tests a disk that takes the new content, but fails to make its name durable.
#[test]
fn unconfirmed_save_is_shown_until_it_is_confirmed() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("des.json"), BEFORE).unwrap();
    fs::write(at("failing"), "").unwrap();
    let script = format!(
        "printf '#include <errno.h>\n#include <sys/stat.h>\n#include <unistd.h>\n\
         int fsync(int file) {{ struct stat it; fstat(file, &it); \
         if (S_ISDIR(it.st_mode) && !access(\"failing\", F_OK)) {{ errno = EIO; return -1; }} \
         return fdatasync(file); }}\n' >fails.c && cc -shared -fPIC -o fails.so fails.c \
         && exec env LD_PRELOAD=$PWD/fails.so {} sim:boiler --file des.json",
        env!("CARGO_BIN_EXE_descan")
    );
    let mut pty = Pty::run("sh", &["-ec", &script], folder.path(), (120, 30));
    pty.wait_for("SENS");
    pty.send("gge\x1547\r");
    pty.wait_for("✗ not confirmed by the disk");
    assert_eq!(fs::read_to_string(at("des.json")).unwrap(), AFTER);
    // What descan wrote is not reported as a change by another program, nor as saved.
    pty.send("3");
    pty.wait_for("address of the entry FEED: 9 → 47");
    assert!(!pty.screen().contains("changed on disk"), "{}", pty.screen());
    assert!(!pty.screen().contains("✓ 1 entry"), "{}", pty.screen());
    fs::remove_file(at("failing")).unwrap();
    pty.send("\x13");
    pty.wait_for("saved after retry");
    pty.wait_for("✓ 1 entry");
    assert!(!pty.screen().contains("changed on disk"), "{}", pty.screen());
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    assert_eq!(fs::read_to_string(at("des.json")).unwrap(), AFTER);
}

#[test]
fn folder_owned_by_another_user_keeps_edits() {
    if !may_mount() {
        return;
    }
    let nobody = "as='setpriv --reuid 65534 --regid 65534 --clear-groups'";
    let mut disk = Disk::new(&format!("chmod 666 des.json && chmod 777 .. && {nobody}"));
    disk.is_kept("no permission for its folder");
    fs::set_permissions(disk.folder.path().join("disk"), Permissions::from_mode(0o777)).unwrap();
    disk.is_saved_at_last();

    // A write-protected file in a writable folder, too.
    let mut disk = Disk::new(&format!("chmod 444 des.json && chmod 777 . .. && {nobody}"));
    disk.is_kept("belongs to another user; save elsewhere");
    fs::set_permissions(disk.seen("disk/des.json"), Permissions::from_mode(0o666)).unwrap();
    disk.is_saved_at_last();
}

#[test]
fn folder_moved_away_keeps_edits() {
    if !may_mount() {
        return;
    }
    let mut disk = Disk::new("true");
    let (here, away) = (disk.folder.path().join("disk"), disk.folder.path().join("away"));
    // While the user types in an input line.
    disk.pty.send("gge\x154");
    fs::rename(&here, &away).unwrap();
    disk.pty.wait_for("deleted: the next edit creates a new file");
    disk.pty.send("7\r");
    disk.pty.wait_for("✗ not saved");
    disk.pty.wait_for("no such folder; mkdir -p");
    assert_eq!(fs::read_to_string(away.join("des.json")).unwrap(), BEFORE);
    fs::rename(&away, &here).unwrap();
    // The entry in the new file is the same one as in the folder that was moved away.
    disk.pty.wait_for("Edit conflict");
    disk.pty.wait_for("new entry FEED at 47");
    disk.pty.wait_for("address 9, not static");
    assert_eq!(disk.content().as_deref(), Some(BEFORE));
    disk.choose("o");
    disk.is_saved_at_last();
}

#[test]
fn edit_conflict_after_failed_save_needs_a_choice() {
    if !may_mount() {
        return;
    }
    let theirs = BEFORE.replace('9', "11");
    for key in ["t", "o"] {
        let mut disk = Disk::new("cp des.json ../real.json && mount --bind ../real.json des.json");
        disk.pty.send("gge\x1547\r");
        disk.pty.wait_for("✗ not saved");
        fs::write(disk.seen("disk/des.json"), &theirs).unwrap();
        disk.pty.wait_for("Edit conflict");
        disk.pty.wait_for("address of the entry FEED: 9 → 47");
        disk.choose(key);
        if key == "t" {
            disk.pty.wait_for("✓");
        } else {
            // The mount is moved aside, and theirs takes its place.
            disk.pty.wait_for("✗ not saved");
            let file = disk.folder.path().join("disk/des.json");
            fs::write(&file, &theirs).unwrap();
            disk.among_its_mounts(&["umount", file.to_str().unwrap()]);
            disk.is_saved_at_last();
            continue;
        }
        assert_eq!(disk.content().as_ref(), Some(&theirs));
        disk.pty.send("q");
        assert_eq!(disk.pty.wait(), 0);
    }
}
