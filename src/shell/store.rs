//! `des.json` on disk: read whole, and replaced whole or not at all.
//!
//! A save goes to a temporary file beside the target, with its mode and owner, is synced, and is
//! renamed over it, so that neither a crash nor a full disk leaves half a file, and no reader sees
//! one. That is worth more than hard links, which it parts: the file's other names keep the old
//! content, as a backup made of hard links wants it, and the caller is told. Right before the rename, under a lock that other instances of descan respect, what is on
//! disk is compared with what the new content was made from.
//!
//! What it deliberately does not know: what is in the file.

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

/// How long a save waits for another instance that is saving. It is done in milliseconds.
const LOCK_PATIENCE: Duration = Duration::from_secs(2);

/// As many symbolic links as the kernel follows.
const MAX_LINKS: usize = 40;

/// A file by its path, which may be a symbolic link, and need not exist.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Store {
    path: PathBuf,
}

/// The file cannot be read. `Display` names the cause and the way out.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// There is a folder of that name.
    #[error("{path} is a folder: name the file in it, {path}/des.json")]
    Folder {
        /// Safe on a terminal, as are all of these.
        path: String,
    },
    /// There is a device, a pipe or a socket of that name.
    #[error("{path} is not a regular file: name another one with --file")]
    NotAFile {
        /// Which.
        path: String,
    },
    /// It has more than [`MAX_BYTES`].
    #[error("{path} is larger than 16 MiB: is it the right file?")]
    TooLarge {
        /// Which.
        path: String,
    },
    /// The system refuses.
    #[error("{path} cannot be read: {cause}{}", remedy_clause(.cause))]
    Read {
        /// Which.
        path: String,
        /// Why.
        cause: io::Error,
    },
}

/// The file was saved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Saved {
    /// How many other names the file had (hard links): they keep what it said before.
    pub broken_links: u64,
}

/// The file was not saved; it is as it was. `Display` names the cause and the way out.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// What is on disk is not what the new content was made from, but this; none: the file is gone.
    #[error("changed by another program: not saved")]
    Changed(Option<Vec<u8>>),
    /// What is on disk cannot be read, hence not compared.
    #[error(transparent)]
    Unreadable(#[from] StoreError),
    /// The file is write-protected. Replacing it would go around that.
    #[error("{path} is write-protected: chmod u+w {path}, or save a copy elsewhere")]
    Protected {
        /// Which.
        path: String,
    },
    /// The same, and it is not ours to change that.
    #[error("{path} belongs to another user and is write-protected: save a copy elsewhere")]
    Foreign {
        /// Which.
        path: String,
    },
    /// The folder it is to be in does not exist.
    #[error("{path} cannot be saved: no such folder: mkdir -p {folder}, then save again")]
    NoFolder {
        /// Which file.
        path: String,
        /// Which folder.
        folder: String,
    },
    /// Another instance of descan has been saving for seconds.
    #[error("{folder} is locked by another descan: close it, then save again")]
    Locked {
        /// The folder of the file.
        folder: String,
    },
    /// The system refuses.
    #[error("{path} cannot be saved: {cause}{}", remedy_clause(.cause))]
    Write {
        /// Which.
        path: String,
        /// Why.
        cause: io::Error,
    },
}

impl StoreError {
    /// The cause and the way out in few words, for a place that says already which file it is about.
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
    /// The cause and the way out in few words, for a place that says already which file it is about
    /// and that it is not saved.
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

/// Writes a new file where the user names one while the program runs; `~/` is `home`. Otherwise says
/// why not, and the way out, in few words that do not repeat the path: there is one line for it.
///
/// # Errors
/// Where it cannot be written, and where there is a file of that name already.
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

/// What the user can do about it, with the cause, where a new file cannot be written.
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
    /// The file at `path`, as the user names it.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// The path as the user names it.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The whole content; none when there is no file.
    ///
    /// # Errors
    /// [`StoreError`] when something is there that is no readable file of up to [`MAX_BYTES`].
    pub fn read(&self) -> Result<Option<Vec<u8>>, StoreError> {
        let path = || shown(&self.path);
        // Opening a pipe for reading would wait for a writer.
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
            // It may grow while it is read.
            file.take(MAX_BYTES + 1).read_to_end(&mut content).map_err(read)?;
        }
        if metadata.len().max(content.len() as u64) > MAX_BYTES {
            return Err(StoreError::TooLarge { path: path() });
        }
        Ok(Some(content))
    }

    /// Replaces the content, if what is on disk is still `expected`: the content that `new` was
    /// made from, or none where there was no file.
    ///
    /// When this returns `Ok`, `new` has reached the disk. Symbolic links stay, and the target's
    /// mode, owner and group, the latter two as far as the system allows; hard links are parted. Takes as long as the disk
    /// needs, so not to be called where the screen waits.
    ///
    /// # Errors
    /// [`SaveError`]; the file is then as it was, and nothing is left beside it. The one exception:
    /// when the disk fails in confirming the rename, the new content may or may not survive a power
    /// cut, and the next save finds either one on disk.
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
            // Whoever creates the file at this very moment is not overwritten.
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
            // Not all file systems can sync a folder.
            Err(cause) if cause.raw_os_error() != Some(Errno::EINVAL as i32) => {
                Err(self.write_error(cause))
            }
            _ => Ok(Saved { broken_links: parted_from }),
        }
    }

    /// The folder that the file is to be in, where it does not exist.
    pub fn missing_folder(&self) -> Option<String> {
        let folder = Places::of(&self.path).ok()?.folder;
        let is_missing = || matches!(fs::metadata(&folder), Err(error) if error.kind() == io::ErrorKind::NotFound);
        is_missing().then(|| shown(&self.folder_as_named(&folder)))
    }

    /// The file's folder as the user names it, where no link leads to another one.
    fn folder_as_named(&self, folder: &Path) -> PathBuf {
        let named = self.path.parent().filter(|named| !named.as_os_str().is_empty());
        let is_it = |named: &&Path| Places::of(named).is_ok_and(|places| places.target == folder);
        named.filter(is_it).unwrap_or(folder).to_owned()
    }

    fn write_error(&self, cause: io::Error) -> SaveError {
        SaveError::Write { path: shown(&self.path), cause }
    }
}

/// Where a path leads, link by link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Places {
    /// The folders and the names in them on which it depends what the path stands for: those of
    /// links, of the file, and of the first folder that is missing.
    pub watched: Vec<(PathBuf, OsString)>,
    /// The file itself, whether or not it exists.
    pub target: PathBuf,
    /// The folder it is in.
    pub folder: PathBuf,
}

impl Places {
    /// # Errors
    /// When links go in circles, or there is no current folder.
    pub fn of(path: &Path) -> io::Result<Self> {
        let mut watched = Vec::new();
        let mut here = PathBuf::from("/");
        // The components still to be walked, last first.
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

/// The names in a path, last first.
fn components(path: &Path) -> Vec<OsString> {
    let name = |component| match component {
        Component::Normal(name) => Some(name),
        Component::ParentDir => Some(OsStr::new("..")),
        _ => None,
    };
    path.components().rev().filter_map(name).map(OsStr::to_owned).collect()
}

/// A lock on the folder, which leaves no file behind, and is given back when dropped; none where
/// the file system has no locks.
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

/// What the name of a file beside the target begins with; characters that no other has follow.
fn temporary_prefix(target: &Path) -> OsString {
    let mut prefix = OsString::from(".");
    prefix.push(target.file_name().unwrap_or_default());
    prefix.push(".descan-");
    prefix
}

const TEMPORARY_SUFFIX: &str = ".tmp";

/// Removes what saves that were killed left beside the target. Only to be called under the lock:
/// whoever else saves would lose its file.
fn remove_leftovers(target: &Path, folder: &Path) {
    let prefix = temporary_prefix(target);
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let rest = name.as_bytes().strip_prefix(prefix.as_bytes());
        let is_ours = rest.is_some_and(|rest| rest.ends_with(TEMPORARY_SUFFIX.as_bytes()));
        if is_ours && entry.file_type().is_ok_and(|kind| kind.is_file()) {
            // Where it cannot be removed it does no harm.
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// The new content in a file beside the target, on the disk, and removed when dropped.
fn write_beside(
    target: &Path,
    folder: &Path,
    old: Option<&fs::Metadata>,
    new: &[u8],
) -> io::Result<NamedTempFile> {
    // A new file's mode is the user's own choice, by umask.
    let mode = if old.is_some() { 0o600 } else { 0o666 };
    let mut temporary = create_beside(target, folder, mode)?;
    temporary.as_file_mut().write_all(new)?;
    if let Some(old) = old {
        keep_owner(temporary.as_file(), old)?;
    }
    temporary.as_file().sync_all()?;
    Ok(temporary)
}

/// A new file beside the target. Not by tempfile's own means: they wrap the system's errors into
/// such as name the temporary path, and know no cause.
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

/// Gives the file the owner, group and mode of the old one. Only root can give files away, and
/// only to their own groups can others: where the group cannot be kept, its members get no more
/// than everybody does.
fn keep_owner(file: &File, old: &fs::Metadata) -> io::Result<()> {
    let (user, group) = (Uid::from_raw(old.uid()), Gid::from_raw(old.gid()));
    let new = file.metadata()?;
    let mut mode = old.permissions().mode() & 0o777;
    if new.uid() != old.uid() {
        // Where it cannot be kept, the file is ours from now on, as with editors.
        let _ = fchown(file, Some(user), None);
    }
    if new.gid() != old.gid() && fchown(file, None, Some(group)).is_err() {
        mode = mode & 0o707 | (mode & 0o007) << 3;
    }
    file.set_permissions(Permissions::from_mode(mode))
}

/// What the user can do about it, as the end of a sentence.
fn remedy_clause(cause: &io::Error) -> &'static str {
    remedy(cause).map_or("", |(way_out, _)| way_out)
}

/// What the user can do about it: as the end of a sentence that names the cause; and with the cause,
/// in few words, of a file that cannot be saved.
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

/// What the system says, without its number.
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

    /// Some of these cannot be brought about without mounting file systems.
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
