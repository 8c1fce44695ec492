//! Files on disk: reads `des.json` and replaces it as a whole; writes others beside their target.
//!
//! A save writes a temporary file beside the target, gives it the target's owner, group, mode and
//! attributes, syncs it, and exchanges the two. So a crash or a full disk leaves no partial file,
//! and no reader sees one. The exchange breaks hard links: the file's other names keep the old
//! content, and [`Saved::broken_links`] counts them. The content on disk is compared with the
//! content that the edits started from, before and after the exchange, under a lock that all
//! instances of descan use.
//!
//! ```text
//! replacement  the exchange, and what came out of it    attributes  owner, mode, access list
//! temporary    files beside the target                  places      symbolic links
//! exchange     two files exchange their names           fault       errors with their remedies
//! staged_file  a log written part by part, which takes its place at the end
//! ```
//!
//! Does not know the content of the files.

mod attributes;
mod exchange;
mod fault;
mod places;
mod replacement;
mod staged_file;
mod temporary;

use std::fs::{self, File, TryLockError};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use tempfile::NamedTempFile;

use crate::diagnostic::{Diagnostic, without_number};
use crate::open_file::{self, link_count, open_folder};
use crate::regular_file::{self, RegularFile, check_kind};
use attributes::AttributeError;
use temporary::{create_beside, remove_leftovers};

pub(super) use fault::{already_exists, not_written};
pub(super) use places::Places;
pub use staged_file::StagedFile;

/// Longest file that is read, in bytes.
pub const MAX_BYTES: u64 = crate::document::MAX_BYTES as u64;

/// Longest wait for another instance that saves. A save takes milliseconds.
const LOCK_PATIENCE: Duration = Duration::from_secs(2);

/// A file by its path, which may be a symbolic link and may not exist yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Store {
    path: PathBuf,
    max_bytes: u64,
}

/// Result of a save.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Saved {
    /// Number of the file's other names (hard links), which keep the old content.
    pub broken_links: u64,
}

/// Why the file was not saved.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SaveError {
    /// The content on disk is not the expected one, but this; `None` if the file was deleted. What
    /// another program wrote is in its place.
    #[error("changed by another program")]
    Changed(Option<Vec<u8>>),
    /// The new content is in its place, but the disk did not confirm it: it may be lost in a power
    /// failure.
    #[error("not confirmed by the disk: {0}")]
    Unconfirmed(Diagnostic),
    /// The file cannot be read or written; it is unchanged.
    #[error("{0}")]
    Failed(#[from] Diagnostic),
}

/// Creates a file, with the content that `write` writes, at a path that the user entered; a leading
/// `~/` is replaced by `home`.
///
/// # Errors
/// The fault, without the path, if the file cannot be written or already exists.
pub fn write_new<T>(
    path: &Path,
    home: Option<&Path>,
    write: impl FnOnce(&mut File) -> io::Result<T>,
) -> Result<T, Diagnostic> {
    let at_home = home.and_then(|home| Some(home.join(path.strip_prefix("~").ok()?)));
    let store = Store::new(at_home.as_deref().unwrap_or(path));
    store.check_new()?;
    let is_user = at_home.is_none() && path.as_os_str().as_encoded_bytes().starts_with(b"~");
    if is_user && store.missing_folder().is_some() {
        return Err(Diagnostic::new("~ cannot be expanded").with_remedy("give the full path"));
    }
    let mut written = None;
    let write = |file: &mut File| write(file).map(|it| written = Some(it));
    store.create_with(write).map_err(|error| match error {
        SaveError::Changed(_) => already_exists(),
        SaveError::Unconfirmed(_) => Diagnostic::new(error.to_string()),
        SaveError::Failed(fault) => fault,
    })?;
    written.ok_or_else(|| Diagnostic::new("nothing was written"))
}

impl Store {
    /// Returns the file at `path`, as entered by the user.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), max_bytes: MAX_BYTES }
    }

    /// Limits the size of the file that is read, in bytes.
    #[must_use]
    pub fn with_max_bytes(self, max_bytes: u64) -> Self {
        Self { max_bytes, ..self }
    }

    /// Returns the path as entered by the user.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the whole content; `None` if the file does not exist.
    ///
    /// # Errors
    /// The fault, without the path, if it is not that of a readable file of up to [`MAX_BYTES`], or
    /// of another limit if one is set.
    pub fn read(&self) -> Result<Option<Vec<u8>>, Diagnostic> {
        regular_file::read(&self.path, self.max_bytes)
    }

    /// Returns the fault if there is a file of this name, or anything else.
    pub fn check_new(&self) -> Result<(), Diagnostic> {
        let Ok(metadata) = fs::metadata(&self.path) else { return Ok(()) };
        check_kind(&metadata)?;
        Err(already_exists())
    }

    /// Replaces the content if the content on disk is still `expected`: the content from which
    /// `new` was made, or `None` if there was no file.
    ///
    /// On `Ok`, `new` has reached the disk. Kept are symbolic links, mode, access control list and
    /// extended attributes; owner and group as far as the system allows. Access is never widened.
    /// Hard links are broken. Blocks as long as the disk does, at least 0.1 s for a file that
    /// exists: do not call it on the thread of the UI.
    ///
    /// # Errors
    /// [`SaveError`]; no temporary file is left, unless its message names one.
    pub fn save(&self, expected: Option<&[u8]>, new: &[u8]) -> Result<Saved, SaveError> {
        let places = Places::of(&self.path).map_err(|error| not_written(&error))?;
        let (folder, target) = (&places.folder, &places.target);
        let open = open_folder(folder).map_err(|error| {
            places.missing_folder(&self.path).unwrap_or_else(|| not_written(&error))
        })?;
        let lock = lock(folder)?;
        let old = RegularFile::open(target)?;
        if let Some(old) = &old {
            attributes::require_write_permission(target, old.metadata())?;
        }
        if lock.is_some() {
            remove_leftovers(target, folder);
        }
        let write = |file: &mut File| file.write_all(new);
        let temporary = write_beside(target, folder, old.as_ref(), write)?;
        let is_there = old.is_some();
        let (Some(expected), Some(old)) = (expected, old) else {
            if expected.is_some() || is_there {
                return Err(SaveError::Changed(self.read()?));
            }
            self.create(temporary, target)?;
            sync_folder(&open)?;
            return Ok(Saved::default());
        };
        let before = old.metadata().clone();
        // Windows replaces no file that is open.
        drop(old);
        let replaced = replacement::replace(temporary, target, expected, new, &before)?;
        let synced = sync_folder(&open);
        let names = replaced.other_names();
        replaced.finish()?;
        synced?;
        let broken_links = names.unwrap_or(link_count(&before).saturating_sub(1));
        Ok(Saved { broken_links })
    }

    /// Creates the file with the content that `write` writes.
    fn create_with(
        &self,
        write: impl FnOnce(&mut File) -> io::Result<()>,
    ) -> Result<(), SaveError> {
        let places = Places::of(&self.path).map_err(|error| not_written(&error))?;
        let (folder, target) = (&places.folder, &places.target);
        let open = open_folder(folder).map_err(|error| {
            places.missing_folder(&self.path).unwrap_or_else(|| not_written(&error))
        })?;
        let _lock = lock(folder)?;
        let temporary = write_beside(target, folder, None, write)?;
        self.create(temporary, target)?;
        sync_folder(&open)
    }

    /// Gives a new file its name. A file created at this moment by another program is not
    /// overwritten.
    fn create(&self, temporary: NamedTempFile, target: &Path) -> Result<(), SaveError> {
        match temporary.persist_noclobber(target) {
            Ok(_) => Ok(()),
            Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => {
                Err(SaveError::Changed(self.read()?))
            }
            Err(error) => Err(not_written(&error.error).into()),
        }
    }

    /// Returns the fault if the folder of the file does not exist.
    pub fn missing_folder(&self) -> Option<Diagnostic> {
        Places::of(&self.path).ok()?.missing_folder(&self.path)
    }
}

/// Locks the folder until the result is dropped; leaves no lock file. `None` if the folder cannot
/// be opened or its file system has no locks.
fn lock(folder: &Path) -> Result<Option<File>, Diagnostic> {
    let deadline = Instant::now() + LOCK_PATIENCE;
    let Ok(open) = attributes::open_lock(folder) else { return Ok(None) };
    loop {
        match open.try_lock() {
            Ok(()) => return Ok(Some(open)),
            Err(TryLockError::WouldBlock) if Instant::now() < deadline => {}
            Err(TryLockError::WouldBlock) => {
                return Err(
                    Diagnostic::new("locked by another descan").with_remedy("quit that one")
                );
            }
            Err(TryLockError::Error(_)) => return Ok(None),
        }
        thread::sleep(Duration::from_millis(5));
    }
}

/// Writes and syncs the new content to a temporary file beside the target, removed when dropped.
fn write_beside(
    target: &Path,
    folder: &Path,
    old: Option<&RegularFile>,
    write: impl FnOnce(&mut File) -> io::Result<()>,
) -> Result<NamedTempFile, Diagnostic> {
    let fault = |error: io::Error| not_written(&error);
    let mut temporary = create_with_attributes(target, folder, old)?;
    write(temporary.as_file_mut()).map_err(fault)?;
    temporary.as_file().sync_all().map_err(fault)?;
    Ok(temporary)
}

/// Creates a temporary file beside the target, with the attributes of the file that it replaces. A new
/// file gets the mode that the user's umask allows.
fn create_with_attributes(
    target: &Path,
    folder: &Path,
    old: Option<&RegularFile>,
) -> Result<NamedTempFile, Diagnostic> {
    let mode = if old.is_some() { 0o600 } else { 0o666 };
    let fault = |error: io::Error| not_written(&error);
    let temporary = create_beside(target, folder, mode).map_err(fault)?;
    if let Some(old) = old {
        let kept = attributes::keep(old.file(), old.metadata(), temporary.as_file());
        kept.map_err(|error| match error {
            AttributeError::NotKept(fault) => fault,
            AttributeError::Disk(error) => not_written(&error),
        })?;
    }
    Ok(temporary)
}

/// Makes the names in a folder durable.
fn sync_folder(folder: &File) -> Result<(), SaveError> {
    open_file::sync_folder(folder)
        .map_err(|cause| SaveError::Unconfirmed(Diagnostic::new(without_number(&cause))))
}
