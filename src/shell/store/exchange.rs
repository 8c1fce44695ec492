//! Two files exchange their names, where the file system can.

use std::io;
use std::path::Path;
use tempfile::TempPath;

/// Why the names were not exchanged.
#[derive(Debug)]
pub(super) enum ExchangeError {
    /// One of the files does not exist.
    #[cfg_attr(windows, expect(dead_code, reason = "Windows exchanges no files"))]
    Missing,
    /// The file system cannot exchange files.
    NotSupported,
    /// Anything else.
    #[cfg_attr(windows, expect(dead_code, reason = "Windows exchanges no files"))]
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

/// Windows cannot exchange files.
#[cfg(windows)]
pub(super) fn exchange(_: &Path, _: &Path) -> Result<(), ExchangeError> {
    Err(ExchangeError::NotSupported)
}

/// Replaces a file by a temporary one.
#[cfg(unix)]
pub(super) fn put_in_place(new: TempPath, target: &Path) -> io::Result<()> {
    new.persist(target).map_err(|error| error.error)
}

/// Replaces a file by a temporary one. A program that has the file open for a moment, as one that
/// looks for viruses, is waited for.
#[cfg(windows)]
#[expect(clippy::needless_pass_by_value, reason = "it is removed if it was not renamed")]
pub(super) fn put_in_place(new: TempPath, target: &Path) -> io::Result<()> {
    use std::time::{Duration, Instant};
    const PATIENCE: Duration = Duration::from_millis(500);
    let deadline = Instant::now() + PATIENCE;
    loop {
        match std::fs::rename(&new, target) {
            Err(error) if is_open_elsewhere(&error) && Instant::now() < deadline => {}
            renamed => return renamed,
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
