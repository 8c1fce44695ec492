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

/// Why the file cannot be read. `Display` names the cause and the next step.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The path is a folder.
    #[error("{path} is a folder: name the file in it, {path}/des.json")]
    Folder {
        /// The path, safe on a terminal; in all variants.
        path: String,
    },
    /// The path is a device, a pipe or a socket.
    #[error("{path} is not a regular file: name another one with --file")]
    NotAFile {
        /// The path.
        path: String,
    },
    /// The file is larger than [`MAX_BYTES`].
    #[error("{path} is larger than 16 MiB: is it the right file?")]
    TooLarge {
        /// The path.
        path: String,
    },
    /// The system reports an error.
    #[error("{path} cannot be read: {cause}{}", remedy_clause(.cause))]
    Read {
        /// The path.
        path: String,
        /// The system's error.
        cause: io::Error,
    },
}

/// Result of a save.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Saved {
    /// Number of the file's other names (hard links), which keep the old content.
    pub broken_links: u64,
}

/// Why the file was not saved; it is unchanged. `Display` names the cause and the next step.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// The content on disk is not the expected one, but this; `None` if the file was deleted.
    #[error("changed by another program: not saved")]
    Changed(Option<Vec<u8>>),
    /// The content on disk cannot be read, so it cannot be compared.
    #[error(transparent)]
    Unreadable(#[from] StoreError),
    /// The file is write-protected; replacing it would bypass the protection.
    #[error("{path} is write-protected: chmod u+w {path}, or save a copy elsewhere")]
    Protected {
        /// The path.
        path: String,
    },
    /// The file is write-protected and belongs to another user.
    #[error("{path} belongs to another user and is write-protected: save a copy elsewhere")]
    Foreign {
        /// The path.
        path: String,
    },
    /// The folder of the file does not exist.
    #[error("{path} cannot be saved: no such folder: mkdir -p {folder}, then save again")]
    NoFolder {
        /// The path.
        path: String,
        /// The folder.
        folder: String,
    },
    /// Another instance of descan held the lock for 2 s.
    #[error("{folder} is locked by another descan: close it, then save again")]
    Locked {
        /// The folder of the file.
        folder: String,
    },
    /// The system reports an error.
    #[error("{path} cannot be saved: {cause}{}", remedy_clause(.cause))]
    Write {
        /// The path.
        path: String,
        /// The system's error.
        cause: io::Error,
    },
}

impl StoreError {
    /// Returns cause and next step in short, for a message that already names the file.
    pub fn in_short(&self) -> String {
        match self {
            Self::Folder { .. } => "it is a folder: name the file in it".to_owned(),
            Self::NotAFile { .. } => "not a regular file: name another one".to_owned(),
            Self::TooLarge { .. } => "it is larger than 16 MiB: is it the right file?".to_owned(),
            Self::Read { cause, .. } if cause.kind() == io::ErrorKind::PermissionDenied => {
                "no read permission: fix it, or name another file".to_owned()
            }
            Self::Read { cause, .. } => match cause.raw_os_error().map(Errno::from_raw) {
                Some(Errno::ELOOP | Errno::EMFILE | Errno::ENFILE) => {
                    remedy(cause).map_or_else(|| plain(cause), |(_, in_short)| in_short.to_owned())
                }
                _ => format!("cannot be read: {}", plain(cause)),
            },
        }
    }
}

impl SaveError {
    /// Returns cause and next step in short, for a message that already names the file and states
    /// that it is not saved.
    pub fn in_short(&self) -> String {
        match self {
            Self::Protected { .. } => {
                "it is write-protected: chmod u+w, or save a copy elsewhere".to_owned()
            }
            Self::Foreign { .. } => "belongs to another user: save a copy elsewhere".to_owned(),
            Self::Unreadable(error) => error.in_short(),
            Self::NoFolder { folder, .. } => format!("no such folder: mkdir -p {folder}"),
            Self::Write { cause, .. } => {
                remedy(cause).map_or_else(|| plain(cause), |(_, in_short)| in_short.to_owned())
            }
            other => other.to_string(),
        }
    }
}

/// Writes a new file at a path that the user entered; a leading `~/` is replaced by `home`.
///
/// # Errors
/// The cause and the next step, in one line without the path, if the file cannot be written or
/// already exists.
pub fn write_new(path: &Path, home: Option<&Path>, bytes: &[u8]) -> Result<(), String> {
    let at_home = home.and_then(|home| Some(home.join(path.strip_prefix("~").ok()?)));
    let target = at_home.as_deref().unwrap_or(path);
    let saved = Store::new(target).save(None, bytes).map_err(|error| match error {
        SaveError::Changed(_)
        | SaveError::Protected { .. }
        | SaveError::Foreign { .. }
        | SaveError::Unreadable(StoreError::TooLarge { .. }) => {
            "file already exists: choose another name".to_owned()
        }
        SaveError::Unreadable(StoreError::Folder { .. }) => {
            "that is a folder: name a file in it".to_owned()
        }
        SaveError::Unreadable(StoreError::NotAFile { .. }) => {
            "that is not a regular file: choose another".to_owned()
        }
        SaveError::NoFolder { .. } if path.as_os_str().as_bytes().starts_with(b"~") => {
            "~ cannot be expanded: give the full path".to_owned()
        }
        SaveError::NoFolder { .. } => {
            "no such folder: create it (mkdir -p), or choose another".to_owned()
        }
        SaveError::Locked { .. } => "another descan is saving there: try again".to_owned(),
        SaveError::Unreadable(StoreError::Read { cause, .. }) | SaveError::Write { cause, .. } => {
            remedy_of_new(target, &cause).map_or_else(|| plain(&cause), str::to_owned)
        }
    });
    saved.map(drop)
}

/// Returns cause and next step for a new file that cannot be written; `None` for other causes.
fn remedy_of_new(path: &Path, cause: &io::Error) -> Option<&'static str> {
    Some(match Errno::from_raw(cause.raw_os_error()?) {
        Errno::ENOENT | Errno::ENOTDIR if path.as_os_str().as_bytes().starts_with(b"~") => {
            "~ cannot be expanded: give the full path"
        }
        Errno::ENOENT => "no such folder: create it (mkdir -p), or choose another",
        Errno::ENOTDIR => "parent is a file, not a folder: choose another",
        Errno::EACCES | Errno::EPERM => "no permission for that folder: choose another",
        Errno::EROFS => "that is mounted read-only: choose another folder",
        Errno::ENOSPC | Errno::EDQUOT => "the disk is full: make room, or choose another",
        Errno::ENAMETOOLONG => "the name is too long: choose a shorter one",
        _ => return remedy(cause).map(|(_, in_short)| in_short),
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
    /// [`StoreError`] if the path is not a readable file of up to [`MAX_BYTES`].
    pub fn read(&self) -> Result<Option<Vec<u8>>, StoreError> {
        let path = || shown(&self.path);
        // Without O_NONBLOCK, opening a pipe for reading blocks until it has a writer.
        let mut options = File::options();
        options.read(true).custom_flags(OFlag::O_NONBLOCK.bits());
        let file = match options.open(&self.path) {
            Ok(file) => file,
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(cause) => return Err(StoreError::Read { path: path(), cause }),
        };
        let read = |cause| StoreError::Read { path: path(), cause };
        let metadata = file.metadata().map_err(read)?;
        if metadata.is_dir() {
            return Err(StoreError::Folder { path: path() });
        }
        if !metadata.is_file() {
            return Err(StoreError::NotAFile { path: path() });
        }
        let mut content = Vec::new();
        if metadata.len() <= MAX_BYTES {
            // The file may grow while it is read.
            file.take(MAX_BYTES + 1).read_to_end(&mut content).map_err(read)?;
        }
        if metadata.len().max(content.len() as u64) > MAX_BYTES {
            return Err(StoreError::TooLarge { path: path() });
        }
        Ok(Some(content))
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
        let places = Places::of(&self.path).map_err(|cause| self.write_error(cause))?;
        let (folder, target) = (&places.folder, &places.target);
        let open = File::open(folder).map_err(|cause| match cause.kind() {
            io::ErrorKind::NotFound => SaveError::NoFolder {
                path: shown(&self.path),
                folder: shown(&self.folder_as_named(folder)),
            },
            _ => self.write_error(cause),
        })?;
        let lock = lock(folder)?;
        let old = fs::metadata(target).ok();
        if old.is_some() && access(target, AccessFlags::W_OK) == Err(Errno::EACCES) {
            let path = shown(target);
            let is_ours = old.as_ref().is_some_and(|old| old.uid() == Uid::effective().as_raw());
            return Err(if is_ours {
                SaveError::Protected { path }
            } else {
                SaveError::Foreign { path }
            });
        }
        if lock.is_some() {
            remove_leftovers(target, folder);
        }
        let temporary = write_beside(target, folder, old.as_ref(), new);
        let temporary = temporary.map_err(|cause| self.write_error(cause))?;

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
            return Err(self.write_error(error.error));
        }
        drop(lock);
        let parted_from = old.map_or(0, |old| old.nlink().saturating_sub(1));
        match open.sync_all() {
            // Some file systems cannot sync a folder.
            Err(cause) if cause.raw_os_error() != Some(Errno::EINVAL as i32) => {
                Err(self.write_error(cause))
            }
            _ => Ok(Saved { broken_links: parted_from }),
        }
    }

    /// Returns the folder of the file if that does not exist.
    pub fn missing_folder(&self) -> Option<String> {
        let folder = Places::of(&self.path).ok()?.folder;
        let is_missing = || matches!(fs::metadata(&folder), Err(error) if error.kind() == io::ErrorKind::NotFound);
        is_missing().then(|| shown(&self.folder_as_named(&folder)))
    }

    /// Returns the file's folder as entered by the user, unless a link leads to another one.
    fn folder_as_named(&self, folder: &Path) -> PathBuf {
        let named = self.path.parent().filter(|named| !named.as_os_str().is_empty());
        let is_it = |named: &&Path| Places::of(named).is_ok_and(|places| places.target == folder);
        named.filter(is_it).unwrap_or(folder).to_owned()
    }

    fn write_error(&self, cause: io::Error) -> SaveError {
        SaveError::Write { path: shown(&self.path), cause }
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
fn lock(folder: &Path) -> Result<Option<File>, SaveError> {
    let deadline = Instant::now() + LOCK_PATIENCE;
    let Ok(open) = File::open(folder) else { return Ok(None) };
    loop {
        match open.try_lock() {
            Ok(()) => return Ok(Some(open)),
            Err(TryLockError::WouldBlock) if Instant::now() < deadline => {}
            Err(TryLockError::WouldBlock) => {
                return Err(SaveError::Locked { folder: shown(folder) });
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

/// Returns the next step for the user, as the end of a sentence.
fn remedy_clause(cause: &io::Error) -> &'static str {
    remedy(cause).map_or("", |(way_out, _)| way_out)
}

/// Returns the next step for the user: as the end of a sentence that names the cause, and in short
/// with the cause, for a file that cannot be saved.
fn remedy(cause: &io::Error) -> Option<(&'static str, &'static str)> {
    Some(match Errno::from_raw(cause.raw_os_error()?) {
        Errno::EACCES | Errno::EPERM => (
            ": get permission (ls -ld shows the owner), or name another file with --file",
            "no permission for its folder: fix it, or save a copy",
        ),
        Errno::EROFS => (
            ": the file system is mounted read-only; remount it, or use --file",
            "mounted read-only: remount it, or save a copy elsewhere",
        ),
        Errno::ENOSPC | Errno::EDQUOT => {
            (": make room, then save again", "the disk is full: make room")
        }
        Errno::EBUSY => (
            ": it is a bind mount; mount its folder instead",
            "a bind mount: mount its folder, or save a copy elsewhere",
        ),
        Errno::ENOENT => {
            (": create its folder (mkdir -p), then save again", "no such folder: create it")
        }
        Errno::ENOTDIR => (
            ": parent is a file, not a folder",
            "parent is a file, not a folder: save a copy elsewhere",
        ),
        Errno::ELOOP => (": symbolic link loop", "symbolic link loop"),
        Errno::EMFILE | Errno::ENFILE => (
            ": close other programs, or raise ulimit -n",
            "too many files are open: close other programs",
        ),
        _ => return None,
    })
}

/// Returns the system's error text without the error number.
fn plain(cause: &io::Error) -> String {
    let text = cause.to_string();
    text.split(" (os error").next().unwrap_or(&text).to_owned()
}

fn shown(path: &Path) -> String {
    printable(path.as_os_str().as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks the texts directly: some of these errors need mounted file systems.
    #[test]
    fn errors_name_the_way_out() {
        for (cause, way) in [
            (Errno::ENOSPC, ": make room, then save again"),
            (Errno::EDQUOT, ": make room, then save again"),
            (Errno::EROFS, ": the file system is mounted read-only; remount it, or use --file"),
            (Errno::EBUSY, ": it is a bind mount; mount its folder instead"),
            (
                Errno::EACCES,
                ": get permission (ls -ld shows the owner), or name another file with --file",
            ),
            (Errno::EIO, ""),
        ] {
            let message = format!("a cannot be saved: {}{way}", io::Error::from(cause));
            assert_eq!(Store::new("a").write_error(cause.into()).to_string(), message);
        }
    }
}
