//! Two files exchange their names, where the file system can.

use std::io;
use std::path::Path;
use tempfile::TempPath;

/// Why the names were not exchanged.
#[derive(Debug)]
pub(super) enum ExchangeError {
    /// One of the files does not exist.
    Missing,
    /// The file system cannot exchange files.
    NotSupported,
    /// Anything else.
    System(io::Error),
}

/// Exchanges two files.
#[cfg(unix)]
pub(super) fn exchange(one: &Path, other: &Path) -> Result<(), ExchangeError> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    use rustix::io::Errno;
    match renameat_with(CWD, one, CWD, other, RenameFlags::EXCHANGE) {
        Ok(()) => Ok(()),
        Err(Errno::NOENT) => Err(ExchangeError::Missing),
        Err(Errno::INVAL | Errno::NOSYS | Errno::NOTSUP) => Err(ExchangeError::NotSupported),
        Err(error) => Err(ExchangeError::System(error.into())),
    }
}

/// Exchanges two files by `ReplaceFile`: the file with the name `other` then has the access list, the
/// alternate streams and the creation time of the one before, as far as the user may set them. A program
/// that has the file open for a moment, as one that looks for viruses, is waited for.
///
/// The old file has a third name for a moment, `one` with `.old` behind it.
#[cfg(windows)]
pub(super) fn exchange(one: &Path, other: &Path) -> Result<(), ExchangeError> {
    use winsafe::{ReplaceFile, co};
    let (Some(new), Some(target)) = (one.to_str(), other.to_str()) else {
        return Err(ExchangeError::NotSupported);
    };
    let old = format!("{new}.old");
    let flags = co::REPLACEFILE::IGNORE_MERGE_ERRORS | co::REPLACEFILE::IGNORE_ACL_ERRORS;
    let replaced = patiently(|| {
        ReplaceFile(target, new, Some(&old), flags)
            .map_err(|error| io::Error::from_raw_os_error(error.raw().cast_signed()))
    });
    match replaced {
        Ok(()) => patiently(|| std::fs::rename(&old, one)).map_err(|error| {
            let cause = format!("the new file is in place, the old one stays as {old}: {error}");
            ExchangeError::System(io::Error::other(cause))
        }),
        Err(error) => Err(match error.raw_os_error() {
            Some(FILE_NOT_FOUND) => ExchangeError::Missing,
            Some(REPLACEMENT_NOT_MOVED) => {
                // The old file has its third name already.
                std::fs::rename(&old, other).err().map_or(ExchangeError::System(error), |back| {
                    let cause = format!("not renamed back from {old}: {back}");
                    ExchangeError::System(io::Error::other(cause))
                })
            }
            _ if is_open_elsewhere(&error) => ExchangeError::System(error),
            _ => ExchangeError::NotSupported,
        }),
    }
}

/// ERROR_FILE_NOT_FOUND.
#[cfg(windows)]
const FILE_NOT_FOUND: i32 = 2;
/// ERROR_UNABLE_TO_MOVE_REPLACEMENT_2.
#[cfg(windows)]
const REPLACEMENT_NOT_MOVED: i32 = 1177;

/// Replaces a file by a temporary one.
#[cfg(unix)]
pub(super) fn put_in_place(new: TempPath, target: &Path) -> io::Result<()> {
    new.persist(target).map_err(|error| error.error)
}

/// Replaces a file by a temporary one, as [`exchange`] waits.
#[cfg(windows)]
#[expect(clippy::needless_pass_by_value, reason = "it is removed if it was not renamed")]
pub(super) fn put_in_place(new: TempPath, target: &Path) -> io::Result<()> {
    patiently(|| std::fs::rename(&new, target))
}

/// Repeats what fails because another program has a file open, for half a second.
#[cfg(windows)]
fn patiently(operation: impl Fn() -> io::Result<()>) -> io::Result<()> {
    use std::time::{Duration, Instant};
    const PATIENCE: Duration = Duration::from_millis(500);
    let deadline = Instant::now() + PATIENCE;
    loop {
        match operation() {
            Err(error) if is_open_elsewhere(&error) && Instant::now() < deadline => {}
            result => return result,
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[cfg(windows)]
fn is_open_elsewhere(error: &io::Error) -> bool {
    use crate::system_error::FileFault;
    matches!(FileFault::of(error), Some(FileFault::NotPermitted | FileFault::InUse))
}

/// Renames a file to a name that no file has.
#[cfg(unix)]
pub(super) fn rename_to_free(from: &Path, to: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    Ok(renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE)?)
}

/// Renames a file to a name that no file has.
#[cfg(windows)]
pub(super) fn rename_to_free(from: &Path, to: &Path) -> io::Result<()> {
    std::fs::hard_link(from, to)?;
    std::fs::remove_file(from)
}
