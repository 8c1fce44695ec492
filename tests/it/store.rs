//! The file on disk: atomic saves and the file watch.

use crate::common::access_list;
use crate::common::sweep;
use std::fs;
use std::io::Write as _;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, symlink};
use std::path::Path;
use std::time::Duration;

use descan::shell::file_watcher::{DiskContent, FileWatcher};
use descan::shell::store::{SaveError, Saved, Store, write_new};
use tempfile::TempDir;

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let name = |entry: std::io::Result<fs::DirEntry>| entry.unwrap().file_name();
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|it| name(it).into_string().unwrap()).collect();
    names.sort();
    names
}

fn mode(path: &Path) -> u32 {
    fs::metadata(path).unwrap().permissions().mode() & 0o7777
}

fn is_root() -> bool {
    nix::unistd::geteuid().is_root()
}

// ---- new files ----

#[test]
fn new_file_is_written_or_fails_with_one_line() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    let write = |path: &Path| write_new(path, Some(folder.path()), |file| file.write_all(b"[]"));
    assert_eq!(write(&at("a.json")), Ok(()));
    assert_eq!(write(Path::new("~/b.json")), Ok(()));
    assert_eq!(names(folder.path()), ["a.json", "b.json"]);

    fs::write(at("large"), vec![b' '; (16 << 20) + 1]).unwrap();
    fs::write(at("protected"), "").unwrap();
    fs::set_permissions(at("protected"), fs::Permissions::from_mode(0o400)).unwrap();
    symlink("loop", at("loop")).unwrap();
    let long = "x".repeat(300);
    let name = folder.path().file_name().unwrap();
    for (path, text) in [
        (at("a.json"), "already exists; name another file"),
        (at("large"), "already exists; name another file"),
        (at("protected"), "already exists; name another file"),
        (folder.path().to_owned(), "is a folder; name a file in it"),
        ("~".into(), "is a folder; name a file in it"),
        ("/dev/null".into(), "not a regular file; name another one"),
        (at("no/c.json"), &*format!("no such folder; mkdir -p {}", at("no").display())),
        (at("a.json/c.json"), "parent is a file, not a folder; name another one"),
        (at(&long), "the name is too long; choose a shorter one"),
        (at("loop"), "symbolic link loop; name another file"),
        ("~nobody/c.json".into(), "~ cannot be expanded; give the full path"),
    ] {
        let why = write(&path).unwrap_err();
        assert_eq!(why.to_string(), text, "{}", path.display());
        assert!(!why.cause().contains(name.to_str().unwrap()), "{why}");
    }
    if !is_root() {
        fs::create_dir(at("closed")).unwrap();
        fs::set_permissions(at("closed"), fs::Permissions::from_mode(0o500)).unwrap();
        let why = write(&at("closed/c.json")).unwrap_err();
        assert_eq!(why.to_string(), "no permission for its folder; fix it, or save elsewhere");
    }
    let why = write_new(Path::new("~/c.json"), None, |file| file.write_all(b"[]")).unwrap_err();
    assert_eq!(why.to_string(), "~ cannot be expanded; give the full path");
    assert_eq!(fs::read(at("a.json")).unwrap(), b"[]");
}

// ---- reading ----

#[test]
fn read_gives_content_or_the_cause() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    assert!(Store::new(at("none")).read().unwrap().is_none());
    assert!(Store::new(at("no/such/folder")).read().unwrap().is_none());

    fs::write(at("des.json"), "[]").unwrap();
    symlink("des.json", at("link")).unwrap();
    assert_eq!(Store::new(at("link")).read().unwrap().unwrap(), b"[]");

    let fault = |path: &Path| Store::new(path).read().unwrap_err().to_string();
    assert_eq!(fault(folder.path()), "is a folder; name a file in it");

    // A read must not wait for a pipe without a writer.
    nix::unistd::mkfifo(&at("pipe"), nix::sys::stat::Mode::S_IRWXU).unwrap();
    assert_eq!(fault(&at("pipe")), "not a regular file; name another one");

    let large = fs::File::create(at("large")).unwrap();
    large.set_len((16 << 20) + 1).unwrap();
    assert_eq!(fault(&at("large")), "larger than 16 MiB; check the file name");
    large.set_len(16 << 20).unwrap();
    assert_eq!(Store::new(at("large")).read().unwrap().unwrap().len(), 16 << 20);

    symlink("circle", at("circle")).unwrap();
    assert_eq!(fault(&at("circle")), "symbolic link loop; name another file");
}

// ---- saving ----

#[test]
fn save_replaces_content_and_keeps_mode() {
    let folder = folder();
    let path = folder.path().join("des.json");
    let store = Store::new(&path);
    store.save(None, b"one").unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"one");
    // With the permissions of any newly created file.
    fs::write(folder.path().join("other"), "").unwrap();
    assert_eq!(mode(&path), mode(&folder.path().join("other")));

    fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
    let inode = fs::metadata(&path).unwrap().ino();
    store.save(Some(b"one"), b"two").unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"two");
    assert_eq!(mode(&path), 0o640);
    assert_ne!(fs::metadata(&path).unwrap().ino(), inode, "replaced, not written into");
    assert_eq!(names(folder.path()), ["des.json", "other"]);
}

#[test]
fn save_keeps_the_owner() {
    if !is_root() {
        eprintln!("skipped: only root can give files away");
        return;
    }
    let folder = folder();
    let path = folder.path().join("des.json");
    fs::write(&path, "one").unwrap();
    std::os::unix::fs::chown(&path, Some(1234), Some(4321)).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o660)).unwrap();
    Store::new(&path).save(Some(b"one"), b"two").unwrap();
    let metadata = fs::metadata(&path).unwrap();
    assert_eq!((metadata.uid(), metadata.gid(), mode(&path)), (1234, 4321, 0o660));
}

/// The name of the temporary file beside it may not be longer.
#[test]
fn longest_file_name_is_saved() {
    let folder = folder();
    for name in ["x".repeat(255), "ж".repeat(127)] {
        let store = Store::new(folder.path().join(&name));
        store.save(None, b"one").unwrap();
        store.save(Some(b"one"), b"two").unwrap();
        assert_eq!(store.read().unwrap().unwrap(), b"two");
        assert_eq!(names(folder.path()), [name]);
        fs::remove_file(store.path()).unwrap();
    }
}

/// A folder's default access list gives users access to new files that the replaced file denies.
#[test]
fn save_adds_no_access_list_of_the_folder() {
    let has_list =
        |path: &Path| rustix::fs::getxattr(path, access_list::ATTRIBUTE, &mut [0; 256][..]).is_ok();
    let folder = folder();
    let path = folder.path().join("des.json");
    fs::write(&path, "one").unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o660)).unwrap();
    let flags = rustix::fs::XattrFlags::empty();
    let list = access_list::access_list(7, 6);
    if let Err(error) =
        rustix::fs::setxattr(folder.path(), "system.posix_acl_default", &list, flags)
    {
        eprintln!("skipped: no access lists: {error}");
        return;
    }
    fs::write(folder.path().join("new"), "").unwrap();
    assert!(has_list(&folder.path().join("new")), "new files get the list");
    Store::new(&path).save(Some(b"one"), b"two").unwrap();
    assert!(!has_list(&path));
    assert_eq!(mode(&path), 0o660);
}

#[test]
fn save_keeps_symbolic_links() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("real/deep")).unwrap();
    fs::create_dir(at("links")).unwrap();
    symlink("../real", at("links/folder")).unwrap();
    symlink("folder/deep/des.json", at("links/des.json")).unwrap();
    symlink(at("links/des.json"), at("des.json")).unwrap();
    let store = Store::new(at("des.json"));

    // The same if the target does not exist yet.
    store.save(None, b"one").unwrap();
    assert_eq!(fs::read(at("real/deep/des.json")).unwrap(), b"one");
    store.save(Some(b"one"), b"two").unwrap();
    assert_eq!(fs::read(at("real/deep/des.json")).unwrap(), b"two");

    assert!(at("des.json").is_symlink() && at("links/des.json").is_symlink());
    assert!(!at("real/deep/des.json").is_symlink());
    assert_eq!(names(&at("real/deep")), ["des.json"]);
    assert_eq!(names(&at("links")), ["des.json", "folder"]);
    assert_eq!(names(folder.path()), ["des.json", "links", "real"]);
}

/// Tests hard links: saves are atomic, which rules out writing in place.
#[test]
fn save_reports_broken_hard_link() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("backup"), "one").unwrap();
    fs::set_permissions(at("backup"), fs::Permissions::from_mode(0o640)).unwrap();
    fs::hard_link(at("backup"), at("des.json")).unwrap();
    fs::hard_link(at("backup"), at("older")).unwrap();
    symlink("des.json", at("link")).unwrap();
    let store = Store::new(at("link"));
    assert_eq!(store.save(Some(b"one"), b"two").unwrap(), Saved { broken_links: 2 });
    for (name, content) in [("backup", "one"), ("older", "one"), ("des.json", "two")] {
        assert_eq!(fs::read_to_string(at(name)).unwrap(), content, "{name}");
        assert_eq!(mode(&at(name)), 0o640);
    }
    assert!(at("link").is_symlink());
    assert_eq!(store.save(Some(b"two"), b"three").unwrap(), Saved { broken_links: 0 });
    assert_eq!(fs::read_to_string(at("backup")).unwrap(), "one");
}

#[test]
fn save_does_not_overwrite_a_newer_file() {
    let folder = folder();
    let path = folder.path().join("des.json");
    let store = Store::new(&path);
    let changed = |result: Result<Saved, SaveError>| match result {
        Err(SaveError::Changed(content)) => content,
        other => panic!("{other:?}"),
    };
    assert_eq!(changed(store.save(Some(b"one"), b"new")), None);
    assert!(!path.exists());
    fs::write(&path, "theirs").unwrap();
    assert_eq!(changed(store.save(Some(b"one"), b"new")).unwrap(), b"theirs");
    assert_eq!(changed(store.save(None, b"new")).unwrap(), b"theirs");
    assert_eq!(fs::read(&path).unwrap(), b"theirs");
    assert_eq!(names(folder.path()), ["des.json"]);
}

#[test]
fn concurrent_saves_have_one_winner() {
    let folder = folder();
    let path = folder.path().join("des.json");
    for round in 0..20 {
        let before = fs::read(&path).ok();
        let save = |thread: u8| {
            let new = [round, thread];
            Store::new(&path).save(before.as_deref(), &new).map(|_| new)
        };
        let results: Vec<_> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8).map(|it| scope.spawn(move || save(it))).collect();
            threads.into_iter().map(|it| it.join().unwrap()).collect()
        });
        let winners: Vec<_> = results.iter().flatten().collect();
        assert_eq!(winners.len(), 1, "{results:?}");
        assert_eq!(fs::read(&path).unwrap(), winners[0]);
        let lost = |it: &&Result<_, _>| matches!(it, Err(SaveError::Changed(Some(_))));
        assert_eq!(results.iter().filter(lost).count(), 7, "{results:?}");
    }
    assert_eq!(names(folder.path()), ["des.json"]);
}

#[test]
fn failed_save_leaves_no_file_and_gives_the_cause() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    let failure = |path: &Path| Store::new(path).save(None, b"new").unwrap_err().to_string();

    // The folder to create, also for the target of a link.
    symlink("nowhere/x.json", at("link")).unwrap();
    for (path, missing) in [("no/des.json", "no"), ("link", "nowhere")] {
        let store = Store::new(at(path));
        let text = format!("no such folder; mkdir -p {}", at(missing).display());
        assert_eq!(store.missing_folder().unwrap().to_string(), text);
        assert_eq!(failure(&at(path)), text);
    }
    fs::remove_file(at("link")).unwrap();
    let missing = Store::new("../no/x.json").missing_folder().unwrap();
    assert_eq!(missing.remedy(), Some("mkdir -p ../no"));
    assert_eq!(Store::new(at("des.json")).missing_folder(), None);
    assert_eq!(Store::new("des.json").missing_folder(), None);
    fs::create_dir(at("folder")).unwrap();
    assert_eq!(failure(&at("folder")), "is a folder; name a file in it");
    // Even root cannot create files here.
    let error = failure(Path::new("/proc/des.json"));
    assert!(error.starts_with("cannot be written: "), "{error}");
    assert_eq!(failure(&at(&"x".repeat(256))), "the name is too long; choose a shorter one");
    assert_eq!(names(folder.path()), ["folder"]);

    if is_root() {
        eprintln!("skipped in part: root may write everywhere");
        return;
    }
    fs::write(at("des.json"), "[]").unwrap();
    fs::set_permissions(at("des.json"), fs::Permissions::from_mode(0o444)).unwrap();
    let error = Store::new(at("des.json")).save(Some(b"[]"), b"new").unwrap_err();
    assert_eq!(error.to_string(), "write-protected; chmod u+w, or save elsewhere");
    fs::set_permissions(at("folder"), fs::Permissions::from_mode(0o555)).unwrap();
    let error = failure(&at("folder/des.json"));
    assert!(error.starts_with("no permission for its folder"), "{error}");
}

// ---- watching ----

/// Waits for the next reading; fails the test if the watch reports none.
async fn next(watch: &FileWatcher) -> DiskContent {
    tokio::time::timeout(Duration::from_secs(20), watch.changed()).await.expect("no reading")
}

async fn next_content(watch: &FileWatcher) -> Option<String> {
    next(watch).await.unwrap().map(|content| String::from_utf8(content).unwrap())
}

/// Waits until the file is reported to contain this; half-written content may come before.
async fn until(watch: &FileWatcher, content: Option<&str>) {
    while next_content(watch).await.as_deref() != content {}
}

fn run(test: impl Future<Output = ()>) {
    tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap().block_on(test);
}

fn replace(path: &Path, content: &str) {
    let temporary = path.with_extension("new");
    fs::write(&temporary, content).unwrap();
    fs::rename(temporary, path).unwrap();
}

/// Runs all file changes that editors make, for a watch of either kind.
async fn is_noticed(path: &Path, watch: &FileWatcher) {
    for round in 0..3 {
        replace(path, &format!("renamed {round}"));
        until(watch, Some(&format!("renamed {round}"))).await;
        fs::write(path, format!("written {round}")).unwrap();
        until(watch, Some(&format!("written {round}"))).await;
        fs::remove_file(path).unwrap();
        until(watch, None).await;
        fs::write(path, format!("made anew {round}")).unwrap();
        until(watch, Some(&format!("made anew {round}"))).await;
    }
}

#[test]
fn file_changes_are_reported() {
    run(async {
        let folder = folder();
        let path = folder.path().join("des.json");
        let watch = FileWatcher::spawn(Store::new(&path), Ok(None));
        is_noticed(&path, &watch).await;
    });
}

#[test]
fn file_changes_are_reported_by_polling() {
    run(async {
        let folder = folder();
        let path = folder.path().join("des.json");
        let period = Duration::from_millis(20);
        let watch = FileWatcher::polling(Store::new(&path), Ok(None), period);
        is_noticed(&path, &watch).await;
    });
}

#[test]
fn changes_behind_links_are_reported() {
    run(async {
        let folder = folder();
        let at = |name: &str| folder.path().join(name);
        for name in ["a", "b"] {
            fs::create_dir(at(name)).unwrap();
            fs::write(at(name).join("des.json"), name).unwrap();
        }
        symlink("a", at("now")).unwrap();
        symlink("now/des.json", at("des.json")).unwrap();
        let watch = FileWatcher::spawn(Store::new(at("des.json")), Ok(Some(b"a".into())));
        is_noticed(&at("a/des.json"), &watch).await;
        // The link of the folder gets another target.
        symlink("b", at("next")).unwrap();
        fs::rename(at("next"), at("now")).unwrap();
        until(&watch, Some("b")).await;
        is_noticed(&at("b/des.json"), &watch).await;
        // The link of the file, too.
        fs::write(at("c"), "c").unwrap();
        symlink("c", at("next")).unwrap();
        fs::rename(at("next"), at("des.json")).unwrap();
        until(&watch, Some("c")).await;
    });
}

#[test]
fn folder_may_be_removed_and_created() {
    run(async {
        let folder = folder();
        let deep = folder.path().join("not/yet");
        let path = deep.join("des.json");
        let watch = FileWatcher::spawn(Store::new(&path), Ok(None));
        for round in 0..3 {
            fs::create_dir_all(&deep).unwrap();
            fs::write(&path, format!("here {round}")).unwrap();
            until(&watch, Some(&format!("here {round}"))).await;
            is_noticed(&path, &watch).await;
            fs::remove_dir_all(folder.path().join("not")).unwrap();
            until(&watch, None).await;
        }
    });
}

#[test]
fn change_before_watch_start_is_reported() {
    run(async {
        let folder = folder();
        let path = folder.path().join("des.json");
        fs::write(&path, "now").unwrap();
        let watch = FileWatcher::spawn(Store::new(&path), Ok(Some(b"then".into())));
        assert_eq!(next_content(&watch).await.as_deref(), Some("now"));
    });
}

#[test]
fn own_saves_are_not_reported() {
    run(async {
        let folder = folder();
        let path = folder.path().join("des.json");
        let store = Store::new(&path);
        store.save(None, b"0").unwrap();
        let watch = FileWatcher::spawn(store.clone(), Ok(Some(b"0".into())));
        for round in 0..10 {
            let (old, new) = (round.to_string(), (round + 1).to_string());
            store.save(Some(old.as_bytes()), new.as_bytes()).unwrap();
            watch.set_known(new.clone().into_bytes());
        }
        // Touched, but not changed; and another file in the folder.
        fs::write(folder.path().join("other"), "x").unwrap();
        replace(&path, "10");
        replace(&path, "theirs");
        assert_eq!(next_content(&watch).await.as_deref(), Some("theirs"));
        // Content saved by descan earlier is reported if another program writes it.
        replace(&path, "10");
        assert_eq!(next_content(&watch).await.as_deref(), Some("10"));
    });
}

#[test]
fn content_read_before_a_save_is_dropped() {
    run(async {
        let folder = folder();
        let path = folder.path().join("des.json");
        fs::write(&path, "theirs").unwrap();
        let store = Store::new(&path);
        let watch = FileWatcher::spawn(store.clone(), Ok(None));
        assert_eq!(next_content(&watch).await.as_deref(), Some("theirs"));
        // Theirs again, which the watch may miss; the save detects it.
        replace(&path, "theirs again");
        let Err(SaveError::Changed(_)) = store.save(Some(b"theirs"), b"ours") else { panic!() };
        store.save(Some(b"theirs again"), b"ours").unwrap();
        watch.set_known(b"ours".to_vec());
        replace(&path, "last");
        assert_eq!(next_content(&watch).await.as_deref(), Some("last"));
    });
}

/// Tests content written by another program after a save, and read by the watch before the save was
/// reported to it.
#[test]
fn content_read_after_a_save_is_kept() {
    run(async {
        let folder = folder();
        let path = folder.path().join("des.json");
        fs::write(&path, "theirs").unwrap();
        for round in 0..sweep::cases(200) {
            let known = Ok(Some(b"before".to_vec()));
            let watch = FileWatcher::polling(Store::new(&path), known, Duration::from_hours(1));
            // Some saves are reported before the watch reads, some after.
            (0..round * 500).for_each(|_| std::hint::spin_loop());
            watch.set_known(b"ours".to_vec());
            assert_eq!(next_content(&watch).await.as_deref(), Some("theirs"));
        }
    });
}

/// Tests outdated content: as after a save during which other content was reported.
#[test]
fn uncertain_content_is_always_reported() {
    run(async {
        let folder = folder();
        let path = folder.path().join("des.json");
        fs::write(&path, "one").unwrap();
        let known = Ok(Some(b"one".to_vec()));
        let watch = FileWatcher::polling(Store::new(&path), known, Duration::from_hours(1));
        for _ in 0..3 {
            watch.reread();
            assert_eq!(next_content(&watch).await.as_deref(), Some("one"));
        }
    });
}

#[test]
fn unreadable_file_is_reported_once() {
    run(async {
        let folder = folder();
        let path = folder.path().join("des.json");
        let watch = FileWatcher::polling(Store::new(&path), Ok(None), Duration::from_millis(10));
        fs::create_dir(&path).unwrap();
        let error = next(&watch).await.unwrap_err();
        assert_eq!(error.cause(), "is a folder");
        fs::remove_dir(&path).unwrap();
        assert_eq!(next(&watch).await, Ok(None));
    });
}
