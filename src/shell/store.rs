//! `des.json` on disk: reads it, and replaces it as a whole.
//!
//! A save writes a temporary file beside the target, with the target's mode and owner, syncs it,
//! and renames it over the target. So a crash or a full disk leaves no partial file, and no reader
//! sees one. The rename breaks hard links: the file's other names keep the old content, and
//! [`Saved::broken_links`] counts them. Right before the rename, the content on disk is compared
//! with the content that the edits started from, under a lock that all instances of descan use.
//!
//! Does not know the content of the file.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, Permissions, TryLockError};
use std::io::{self, Read as _, Write as _};
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Component, Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::fcntl::OFlag;
use nix::unistd::{AccessFlags, Gid, Uid, access, fchown};
use tempfile::{NamedTempFile, TempPath};

use crate::diagnostic::{Diagnostic, without_number};
use crate::text::printable;

/// Longest file that is read, in bytes.
pub const MAX_BYTES: u64 = crate::document::MAX_BYTES as u64;

/// Longest wait for another instance that saves. A save takes milliseconds.
const LOCK_PATIENCE: Duration = Duration::from_secs(2);

/// Most symbolic links that are followed, as in the kernel.
const MAX_LINKS: usize = 40;

/// A file by its path, which may be a symbolic link and may not exist yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Store {
    path: PathBuf,
}

/// Result of a save.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Saved {
    /// Number of the file's other names (hard links), which keep the old content.
    pub broken_links: u64,
}

/// Why the file was not saved; it is unchanged.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SaveError {
    /// The content on disk is not the expected one, but this; `None` if the file was deleted.
    #[error("changed by another program")]
    Changed(Option<Vec<u8>>),
    /// The file cannot be read or written.
    #[error("{0}")]
    Failed(#[from] Diagnostic),
}

/// Writes a new file at a path that the user entered; a leading `~/` is replaced by `home`.
///
/// # Errors
/// The fault, without the path, if the file cannot be written or already exists.
pub fn write_new(path: &Path, home: Option<&Path>, bytes: &[u8]) -> Result<(), Diagnostic> {
    let at_home = home.and_then(|home| Some(home.join(path.strip_prefix("~").ok()?)));
    let store = Store::new(at_home.as_deref().unwrap_or(path));
    store.check_new()?;
    let is_user = at_home.is_none() && path.as_os_str().as_bytes().starts_with(b"~");
    if is_user && store.missing_folder().is_some() {
        return Err(Diagnostic::new("~ cannot be expanded").with_remedy("give the full path"));
    }
    store.save(None, bytes).map(drop).map_err(|error| match error {
        SaveError::Changed(_) => already_exists(),
        SaveError::Failed(fault) => fault,
    })
}

impl Store {
    /// Returns the file at `path`, as entered by the user.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// Returns the path as entered by the user.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the whole content; `None` if the file does not exist.
    ///
    /// # Errors
    /// The fault, without the path, if it is not that of a readable file of up to [`MAX_BYTES`].
    pub fn read(&self) -> Result<Option<Vec<u8>>, Diagnostic> {
        // Without O_NONBLOCK, opening a pipe for reading blocks until it has a writer.
        let mut options = File::options();
        options.read(true).custom_flags(OFlag::O_NONBLOCK.bits());
        let file = match options.open(&self.path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(not_read(&error)),
        };
        let metadata = file.metadata().map_err(|error| not_read(&error))?;
        check_kind(&metadata)?;
        let mut content = Vec::new();
        if metadata.len() <= MAX_BYTES {
            // The file may grow while it is read.
            let read = file.take(MAX_BYTES + 1).read_to_end(&mut content);
            read.map_err(|error| not_read(&error))?;
        }
        if metadata.len().max(content.len() as u64) > MAX_BYTES {
            return Err(Diagnostic::new("larger than 16 MiB").with_remedy("check the file name"));
        }
        Ok(Some(content))
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
    /// On `Ok`, `new` has reached the disk. Symbolic links are kept, and the target's mode; its
    /// owner and group as far as the system allows; hard links are broken. Blocks as long as the
    /// disk does: do not call it on the thread of the UI.
    ///
    /// # Errors
    /// [`SaveError`]; the file is then unchanged, and no temporary file is left. One exception: if
    /// the disk fails to confirm the rename, the new content may or may not survive a power
    /// failure, and the next save finds either content on disk.
    pub fn save(&self, expected: Option<&[u8]>, new: &[u8]) -> Result<Saved, SaveError> {
        let places = Places::of(&self.path).map_err(|error| not_written(&error))?;
        let (folder, target) = (&places.folder, &places.target);
        let open = File::open(folder)
            .map_err(|error| self.missing_folder().unwrap_or_else(|| not_written(&error)))?;
        let lock = lock(folder)?;
        let old = fs::metadata(target).ok();
        if let Some(old) = &old
            && access(target, AccessFlags::W_OK) == Err(Errno::EACCES)
        {
            let is_ours = old.uid() == Uid::effective().as_raw();
            let cause = if is_ours { "write-protected" } else { "belongs to another user" };
            let remedy = if is_ours { "chmod u+w, or save elsewhere" } else { "save elsewhere" };
            return Err(Diagnostic::new(cause).with_remedy(remedy).into());
        }
        if lock.is_some() {
            remove_leftovers(target, folder);
        }
        let temporary = write_beside(target, folder, old.as_ref(), new);
        let temporary = temporary.map_err(|error| not_written(&error))?;

        let present = Self::new(target).read()?;
        if present.as_deref() != expected {
            return Err(SaveError::Changed(present));
        }
        let renamed = match expected {
            Some(_) => temporary.persist(target),
            // A file created at this moment by another program is not overwritten.
            None => temporary.persist_noclobber(target),
        };
        if let Err(error) = renamed {
            if expected.is_none() && error.error.kind() == io::ErrorKind::AlreadyExists {
                return Err(SaveError::Changed(self.read()?));
            }
            return Err(not_written(&error.error).into());
        }
        drop(lock);
        let parted_from = old.map_or(0, |old| old.nlink().saturating_sub(1));
        match open.sync_all() {
            // Some file systems cannot sync a folder.
            Err(cause) if cause.raw_os_error() != Some(Errno::EINVAL as i32) => {
                Err(not_written(&cause).into())
            }
            _ => Ok(Saved { broken_links: parted_from }),
        }
    }

    /// Returns the fault if the folder of the file does not exist.
    pub fn missing_folder(&self) -> Option<Diagnostic> {
        let folder = Places::of(&self.path).ok()?.folder;
        let is_missing =
            matches!(fs::metadata(&folder), Err(error) if error.kind() == io::ErrorKind::NotFound);
        let remedy = || format!("mkdir -p {}", shown(&self.folder_as_named(&folder)));
        is_missing.then(|| Diagnostic::new("no such folder").with_remedy(remedy()))
    }

    /// Returns the file's folder as entered by the user, unless a link leads to another one.
    fn folder_as_named(&self, folder: &Path) -> PathBuf {
        let named = self.path.parent().filter(|named| !named.as_os_str().is_empty());
        let is_it = |named: &&Path| Places::of(named).is_ok_and(|places| places.target == folder);
        named.filter(is_it).unwrap_or(folder).to_owned()
    }
}

/// Path of a file with all symbolic links resolved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Places {
    /// Folders and names in them that decide which file the path leads to: links, the file itself,
    /// and the first missing folder.
    pub watched: Vec<(PathBuf, OsString)>,
    /// The file itself; it may not exist.
    pub target: PathBuf,
    /// The folder of the file.
    pub folder: PathBuf,
}

impl Places {
    /// Resolves `path`.
    ///
    /// # Errors
    /// The links form a loop, or there is no current folder.
    pub fn of(path: &Path) -> io::Result<Self> {
        let mut watched = Vec::new();
        let mut here = PathBuf::from("/");
        // Components not resolved yet, last first.
        let mut ahead = components(&std::path::absolute(path)?);
        let mut links = 0;
        while let Some(name) = ahead.pop() {
            if name == ".." {
                here.pop();
                continue;
            }
            let next = here.join(&name);
            match fs::symlink_metadata(&next) {
                Ok(metadata) if metadata.is_symlink() => {
                    links += 1;
                    if links > MAX_LINKS {
                        return Err(Errno::ELOOP.into());
                    }
                    let link = fs::read_link(&next)?;
                    if link.is_absolute() {
                        watched.push((std::mem::replace(&mut here, "/".into()), name));
                    } else {
                        watched.push((here.clone(), name));
                    }
                    ahead.extend(components(&link));
                }
                Ok(_) if !ahead.is_empty() => here = next,
                Ok(_) => watched.push((here.clone(), name)),
                Err(_) => {
                    watched.push((here.clone(), name));
                    let target = ahead.iter().rev().fold(next, |path, name| path.join(name));
                    let folder = target.parent().unwrap_or(&here).to_owned();
                    return Ok(Self { watched, target, folder });
                }
            }
        }
        let target = watched.last().map_or(here.clone(), |(folder, name)| folder.join(name));
        Ok(Self { watched, folder: target.parent().unwrap_or(&here).to_owned(), target })
    }
}

/// Returns the names in a path, last first.
fn components(path: &Path) -> Vec<OsString> {
    let name = |component| match component {
        Component::Normal(name) => Some(name),
        Component::ParentDir => Some(OsStr::new("..")),
        _ => None,
    };
    path.components().rev().filter_map(name).map(OsStr::to_owned).collect()
}

/// Locks the folder until the result is dropped; leaves no lock file. `None` if the folder cannot
/// be opened or its file system has no locks.
fn lock(folder: &Path) -> Result<Option<File>, Diagnostic> {
    let deadline = Instant::now() + LOCK_PATIENCE;
    let Ok(open) = File::open(folder) else { return Ok(None) };
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

/// Returns the beginning of the names of temporary files; random characters follow.
fn temporary_prefix(target: &Path) -> OsString {
    let mut prefix = OsString::from(".");
    prefix.push(target.file_name().unwrap_or_default());
    prefix.push(".descan-");
    prefix
}

const TEMPORARY_SUFFIX: &str = ".tmp";

/// Removes temporary files of saves that were killed. Call only under the lock: it would remove the
/// file of a save in progress.
fn remove_leftovers(target: &Path, folder: &Path) {
    let prefix = temporary_prefix(target);
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let rest = name.as_bytes().strip_prefix(prefix.as_bytes());
        let is_ours = rest.is_some_and(|rest| rest.ends_with(TEMPORARY_SUFFIX.as_bytes()));
        if is_ours && entry.file_type().is_ok_and(|kind| kind.is_file()) {
            // A leftover that cannot be removed is harmless.
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Writes and syncs the new content to a temporary file beside the target, removed when dropped.
fn write_beside(
    target: &Path,
    folder: &Path,
    old: Option<&fs::Metadata>,
    new: &[u8],
) -> io::Result<NamedTempFile> {
    // A new file gets the mode that the user's umask allows.
    let mode = if old.is_some() { 0o600 } else { 0o666 };
    let mut temporary = create_beside(target, folder, mode)?;
    temporary.as_file_mut().write_all(new)?;
    if let Some(old) = old {
        keep_owner(temporary.as_file(), old)?;
    }
    temporary.as_file().sync_all()?;
    Ok(temporary)
}

/// Creates a file beside the target. tempfile's own functions are not used, because their errors
/// contain the temporary path and have no error number.
fn create_beside(target: &Path, folder: &Path, mode: u32) -> io::Result<NamedTempFile> {
    loop {
        let mut name = temporary_prefix(target);
        name.push((0..6).map(|_| fastrand::alphanumeric()).collect::<String>());
        name.push(TEMPORARY_SUFFIX);
        let path = folder.join(name);
        match File::options().read(true).write(true).create_new(true).mode(mode).open(&path) {
            Ok(file) => return Ok(NamedTempFile::from_parts(file, TempPath::try_from_path(path)?)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
}

/// Sets the owner, group and mode of the old file. Only root may change the owner; other users may
/// set only groups of their own. If the group cannot be kept, its members get only the permissions
/// of all other users.
fn keep_owner(file: &File, old: &fs::Metadata) -> io::Result<()> {
    let (user, group) = (Uid::from_raw(old.uid()), Gid::from_raw(old.gid()));
    let new = file.metadata()?;
    let mut mode = old.permissions().mode() & 0o777;
    if new.uid() != old.uid() {
        // If the owner cannot be kept, the file belongs to the user of descan, as with editors.
        let _ = fchown(file, Some(user), None);
    }
    if new.gid() != old.gid() && fchown(file, None, Some(group)).is_err() {
        mode = mode & 0o707 | (mode & 0o007) << 3;
    }
    file.set_permissions(Permissions::from_mode(mode))
}

/// Returns the fault if this is not a file.
fn check_kind(metadata: &fs::Metadata) -> Result<(), Diagnostic> {
    match metadata.file_type() {
        kind if kind.is_dir() => {
            Err(Diagnostic::new("is a folder").with_remedy("name a file in it"))
        }
        kind if kind.is_file() => Ok(()),
        _ => Err(Diagnostic::new("not a regular file").with_remedy("name another one")),
    }
}

pub(super) fn already_exists() -> Diagnostic {
    Diagnostic::new("already exists").with_remedy("name another file")
}

/// Returns the fault of a file that the system does not read.
fn not_read(error: &io::Error) -> Diagnostic {
    match error.kind() {
        io::ErrorKind::PermissionDenied => {
            Diagnostic::new("no read permission").with_remedy("fix it, or name another file")
        }
        _ => of_system(error, "cannot be read"),
    }
}

/// Returns the fault of a file that the system does not write.
pub(super) fn not_written(error: &io::Error) -> Diagnostic {
    of_system(error, "cannot be written")
}

fn of_system(error: &io::Error, what: &str) -> Diagnostic {
    let (cause, remedy) = match error.raw_os_error().map(Errno::from_raw) {
        Some(Errno::EACCES | Errno::EPERM) => {
            ("no permission for its folder", "fix it, or save elsewhere")
        }
        Some(Errno::EROFS) => ("mounted read-only", "remount it, or save elsewhere"),
        Some(Errno::ENOSPC | Errno::EDQUOT) => ("the disk is full", "make room, or save elsewhere"),
        Some(Errno::EFBIG) => ("file size limit reached", "raise it: ulimit -f"),
        Some(Errno::EBUSY) => ("a bind mount", "mount its folder, or save elsewhere"),
        Some(Errno::ENOTDIR) => ("parent is a file, not a folder", "name another one"),
        Some(Errno::ENAMETOOLONG) => ("the name is too long", "choose a shorter one"),
        Some(Errno::ELOOP) => ("symbolic link loop", "name another file"),
        Some(Errno::EMFILE | Errno::ENFILE) => {
            ("too many files are open", "close other programs, or raise ulimit -n")
        }
        _ => return Diagnostic::new(format!("{what}: {}", without_number(error))),
    };
    Diagnostic::new(cause).with_remedy(remedy)
}

fn shown(path: &Path) -> String {
    printable(path.as_os_str().as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks the texts directly: some of these errors need mounted file systems.
    #[test]
    fn system_errors_name_the_way_out() {
        for (error, text) in [
            (Errno::ENOSPC, "the disk is full; make room, or save elsewhere"),
            (Errno::EDQUOT, "the disk is full; make room, or save elsewhere"),
            (Errno::EFBIG, "file size limit reached; raise it: ulimit -f"),
            (Errno::EROFS, "mounted read-only; remount it, or save elsewhere"),
            (Errno::EBUSY, "a bind mount; mount its folder, or save elsewhere"),
            (Errno::EACCES, "no permission for its folder; fix it, or save elsewhere"),
            (Errno::EMFILE, "too many files are open; close other programs, or raise ulimit -n"),
            (Errno::EIO, "cannot be written: Input/output error"),
        ] {
            assert_eq!(not_written(&error.into()).to_string(), text);
        }
    }
}
