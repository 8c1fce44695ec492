//! Logs that were opened on the screen, and what was found in them, in a small file of the user.
//!
//! A convenience: a full disk or a folder of another user does not concern the session. Bounded: 10 logs.

use super::state_folder::state_folder;
use crate::bus::LogDates;
use crate::regular_file::read_text;
use crate::time::Duration;
use std::collections::BTreeMap;
use std::fs::{self, File, Metadata};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Most logs that are remembered.
const MAX_LOGS: usize = 10;

/// A log that was opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecentLog {
    /// Its file.
    pub path: PathBuf,
    /// What was found up to its end, as `9 devices, 2 conflicts`; empty if that is not known.
    pub contents: String,
    /// The file that it was found in, as [`version_of`].
    version: String,
}

/// Size and time of the last change of a file: another content has another one.
fn version_of(path: &Path) -> String {
    let Ok(metadata) = fs::metadata(path) else { return String::new() };
    let changed = metadata.modified().ok();
    let changed = changed.and_then(|at| at.duration_since(SystemTime::UNIX_EPOCH).ok());
    format!("{}-{}", metadata.len(), changed.unwrap_or_default().as_nanos())
}

/// Lengths of logs, read again only where the file has changed: the list is made every second.
#[derive(Debug, Default)]
pub struct LogLengths {
    read: BTreeMap<PathBuf, (u64, Option<SystemTime>, Option<Duration>)>,
}

impl LogLengths {
    /// Time from the first frame of a log to its last; `None` if it cannot be read.
    pub fn of(&mut self, path: &Path, metadata: &Metadata) -> Option<Duration> {
        let (size, changed) = (metadata.len(), metadata.modified().ok());
        match self.read.get(path) {
            Some(&(read_size, read_at, length)) if (read_size, read_at) == (size, changed) => {
                length
            }
            _ => {
                let length = length_of(path);
                self.read.insert(path.to_owned(), (size, changed, length));
                length
            }
        }
    }
}

fn length_of(path: &Path) -> Option<Duration> {
    let log = File::open(path).ok()?;
    let (_, dates) = LogDates::read(&log).ok()?;
    dates.as_ref().and_then(LogDates::length)
}

impl RecentLog {
    /// Parses a line of the file: a path, and behind tabs the contents, and the file in which they
    /// were found.
    fn parse(line: &str) -> Self {
        let mut parts = line.rsplitn(3, '\t');
        let (version, contents, path) = (parts.next(), parts.next(), parts.next());
        let (Some(version), Some(contents), Some(path)) = (version, contents, path) else {
            let (path, version) = (line.into(), String::new());
            return Self { path, contents: String::new(), version };
        };
        let path = PathBuf::from(path);
        let is_same = version_of(&path) == version;
        let contents = if is_same { contents.to_owned() } else { String::new() };
        Self { path, contents, version: version.to_owned() }
    }
}

/// The logs opened before that are still there, the latest first.
pub fn recent_logs() -> Vec<RecentLog> {
    logs_file().map(|file| read(&file)).unwrap_or_default()
}

/// Remembers a log that is opened.
pub fn remember_log(path: &Path) {
    logs_file().inspect(|file| write(file, path, None));
}

/// Remembers what was found in a log.
pub fn remember_contents(path: &Path, contents: &str) {
    logs_file().inspect(|file| write(file, path, Some(contents)));
}

/// File with the logs that were opened, a line each, the latest first.
fn logs_file() -> Option<PathBuf> {
    Some(state_folder()?.join("recent-logs"))
}

fn read(file: &Path) -> Vec<RecentLog> {
    let text = read_text(file).ok().flatten().unwrap_or_default();
    let logs = text.lines().take(MAX_LOGS).map(RecentLog::parse);
    logs.filter(|log| log.path.is_file()).collect()
}

/// Puts a log at the first place; without new contents those before are kept.
fn write(file: &Path, path: &Path, contents: Option<&str>) {
    let Ok(path) = fs::canonicalize(path) else { return };
    if !path.is_file() || path.to_str().is_none_or(|name| name.contains('\n')) {
        return;
    }
    let (same, others): (Vec<_>, Vec<_>) = read(file).into_iter().partition(|it| it.path == path);
    let before = same.into_iter().next().map(|log| log.contents);
    let contents = contents.map(str::to_owned).or(before).unwrap_or_default();
    let version = version_of(&path);
    let log = RecentLog { path, contents, version };
    let logs = std::iter::once(log).chain(others).take(MAX_LOGS);
    let line = |log: RecentLog| {
        Some(format!("{}\t{}\t{}\n", log.path.to_str()?, log.contents, log.version))
    };
    let lines = logs.filter_map(line);
    let text: String = lines.collect();
    let Some(folder) = file.parent() else { return };
    let _ = fs::create_dir_all(folder).and_then(|()| fs::write(file, text));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latest_logs_are_kept_with_what_was_found_in_them() {
        let folder = tempfile::tempdir().unwrap();
        let folder = fs::canonicalize(folder.path()).unwrap();
        let file = folder.join("state/recent-logs");
        let log = |name: &str| {
            fs::write(folder.join(name), "(1.0) can0 123#\n(61.5) can0 123#\n").unwrap();
            folder.join(name)
        };
        let with_tab = log("a\tb.log");
        write(&file, &with_tab, None);
        write(&file, &log("one.log"), Some("9 devices"));
        for number in 0..12 {
            write(&file, &log(&format!("{number}.log")), None);
            write(&file, &folder.join("one.log"), None);
        }
        let found = read(&file);
        assert_eq!(found.len(), MAX_LOGS);
        assert_eq!(
            (found[0].path.clone(), &*found[0].contents),
            (folder.join("one.log"), "9 devices")
        );
        let mut lengths = LogLengths::default();
        let mut length = || lengths.of(&found[0].path, &fs::metadata(&found[0].path).unwrap());
        assert_eq!(length(), Some(Duration::from_millis(60_500)));
        assert_eq!(length(), Some(Duration::from_millis(60_500)));
        fs::write(&found[0].path, "(1.0) can0 123#\n(2.0) can0 123#R\n").unwrap();
        assert_eq!(length(), Some(Duration::from_secs(1)), "it has changed");
        assert_eq!(read(&file)[0].contents, "", "found in another content");
        fs::write(&found[0].path, [b"(1.0) can0 123#\n".as_slice(), &vec![0; 1 << 20]].concat())
            .unwrap();
        assert_eq!(length(), None, "its end cannot be read");
        let broken = b"(1.0) can0 123#\n(9.0) can0 123#\n\0\0\n(x) y\n";
        fs::write(&found[0].path, broken).unwrap();
        assert_eq!(length(), Some(Duration::from_secs(8)));
        write(&file, &with_tab, None);
        assert_eq!((&read(&file)[0].path, &*read(&file)[0].contents), (&with_tab, ""));
        // A list of paths alone.
        fs::write(&file, format!("{}\n", folder.join("one.log").display())).unwrap();
        assert_eq!(
            read(&file),
            [RecentLog {
                path: folder.join("one.log"),
                contents: String::new(),
                version: String::new()
            }]
        );
        fs::remove_file(folder.join("one.log")).unwrap();
        assert_eq!(read(&file), []);
    }
}
