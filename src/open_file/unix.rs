//! Opening by open(2); identity by device and inode.

use nix::fcntl::OFlag;
use nix::libc::O_NONBLOCK;
use std::fs::{File, Metadata};
use std::io::{self, PipeReader};
#[cfg(target_os = "linux")]
use std::os::fd::AsRawFd as _;
use std::os::fd::{AsFd as _, OwnedFd};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

/// Opens a path for reading, whatever it is, without waiting.
///
/// # Errors
///
/// Those of the file system.
pub fn open_without_wait(path: &Path) -> io::Result<File> {
    // Without O_NONBLOCK, opening a pipe for reading blocks until it has a writer; without
    // O_NOCTTY, a terminal may become the controlling one.
    let flags = OFlag::O_NONBLOCK | OFlag::O_NOCTTY;
    File::options().read(true).custom_flags(flags.bits()).open(path)
}

/// Opens a path for reading. A pipe opens before a writer does.
///
/// # Errors
///
/// Those of the file system.
pub fn open_pipe_at_once(path: &Path) -> io::Result<File> {
    let is_pipe = std::fs::metadata(path).is_ok_and(|it| it.file_type().is_fifo());
    let flags = if is_pipe { O_NONBLOCK } else { 0 };
    File::options().read(true).custom_flags(flags).open(path)
}

/// Opens a path for reading. A pipe opens when a writer does.
///
/// # Errors
///
/// Those of the file system.
pub fn open_waiting(path: &Path) -> io::Result<File> {
    File::open(path)
}

/// Creates a file for reading and writing that must not exist, with this mode, less the umask.
///
/// # Errors
///
/// Those of the file system.
pub fn create_new(path: &Path, mode: u32) -> io::Result<File> {
    File::options().read(true).write(true).create_new(true).mode(mode).open(path)
}

/// Opens a folder, to sync it.
///
/// # Errors
///
/// Those of the file system.
pub fn open_folder(folder: &Path) -> io::Result<File> {
    File::open(folder)
}

/// Makes the names in a folder durable. Some file systems cannot.
///
/// # Errors
///
/// Those of the disk.
pub fn sync_folder(folder: &File) -> io::Result<()> {
    match folder.sync_all() {
        Err(error) if error.raw_os_error() == Some(nix::libc::EINVAL) => Ok(()),
        synced => synced,
    }
}

/// Standard input as a file.
///
/// # Errors
///
/// The system has no file left.
pub fn stdin_file() -> io::Result<File> {
    Ok(File::from(io::stdin().as_fd().try_clone_to_owned()?))
}

/// A pipe as a file.
pub fn pipe_file(pipe: PipeReader) -> File {
    File::from(OwnedFd::from(pipe))
}

/// Returns true if the path leads to the open file.
///
/// # Errors
///
/// The path leads to none.
pub fn is_at(file: &File, path: &Path) -> io::Result<bool> {
    let (own, there) = (file.metadata()?, std::fs::metadata(path)?);
    Ok((own.dev(), own.ino()) == (there.dev(), there.ino()))
}

/// Returns a path of an open file, if the system knows one.
#[cfg(target_os = "linux")]
pub fn path_of(file: &File) -> Option<PathBuf> {
    std::fs::read_link(format!("/proc/self/fd/{}", file.as_raw_fd())).ok()
}

/// Returns a path of an open file, if the system knows one.
#[cfg(target_os = "macos")]
pub fn path_of(file: &File) -> Option<PathBuf> {
    let mut path = PathBuf::new();
    nix::fcntl::fcntl(file, nix::fcntl::FcntlArg::F_GETPATH(&mut path)).ok()?;
    Some(path)
}

/// Returns no path: this system has no call for it.
#[cfg(not(any(target_os = "linux", target_os = "macos")))]
pub fn path_of(_: &File) -> Option<PathBuf> {
    None
}

/// Number of names of a file (hard links).
pub fn link_count(metadata: &Metadata) -> u64 {
    metadata.nlink()
}

/// The folder for large temporary files.
pub fn temporary_folder() -> PathBuf {
    std::env::var_os("TMPDIR").map_or_else(|| "/var/tmp".into(), PathBuf::from)
}
