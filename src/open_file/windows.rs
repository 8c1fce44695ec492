//! Opening by the standard library; identity by the crate `same-file`.

use same_file::Handle;
use std::fs::{File, Metadata};
use std::io::{self, ErrorKind, PipeReader};
use std::os::windows::fs::OpenOptionsExt as _;
use std::os::windows::io::{AsHandle as _, OwnedHandle};
use std::path::{Path, PathBuf};

/// FILE_FLAG_BACKUP_SEMANTICS: a folder can be opened.
const FOLDER_TOO: u32 = 0x0200_0000;

/// Opens a path for reading, whatever it is; a folder as well.
///
/// # Errors
///
/// Those of the file system.
pub fn open_without_wait(path: &Path) -> io::Result<File> {
    File::options().read(true).custom_flags(FOLDER_TOO).open(path)
}

/// Opens a path for reading; a folder as well.
///
/// # Errors
///
/// Those of the file system.
pub fn open_pipe_at_once(path: &Path) -> io::Result<File> {
    open_without_wait(path)
}

/// Opens a path for reading; a folder as well.
///
/// # Errors
///
/// Those of the file system.
pub fn open_waiting(path: &Path) -> io::Result<File> {
    open_without_wait(path)
}

/// Creates a file for reading and writing that must not exist. It has the access of its folder.
///
/// # Errors
///
/// Those of the file system.
pub fn create_new(path: &Path, _mode: u32) -> io::Result<File> {
    File::options().read(true).write(true).create_new(true).open(path)
}

/// Opens a folder.
///
/// # Errors
///
/// Those of the file system.
pub fn open_folder(folder: &Path) -> io::Result<File> {
    let open = open_without_wait(folder)?;
    if open.metadata()?.is_dir() { Ok(open) } else { Err(ErrorKind::NotADirectory.into()) }
}

/// Does nothing: Windows syncs no folders, and NTFS has a journal of names.
///
/// # Errors
///
/// None.
pub fn sync_folder(_: &File) -> io::Result<()> {
    Ok(())
}

/// Standard input as a file.
///
/// # Errors
///
/// The system has no file left.
pub fn stdin_file() -> io::Result<File> {
    Ok(File::from(io::stdin().as_handle().try_clone_to_owned()?))
}

/// A pipe as a file.
pub fn pipe_file(pipe: PipeReader) -> File {
    File::from(OwnedHandle::from(pipe))
}

/// Returns true if the path leads to the open file.
///
/// # Errors
///
/// The path leads to none.
pub fn is_at(file: &File, path: &Path) -> io::Result<bool> {
    Ok(Handle::from_file(file.try_clone()?)? == Handle::from_path(path)?)
}

/// Returns no path: the standard library has no call for it.
pub fn path_of(_: &File) -> Option<PathBuf> {
    None
}

/// Number of names of a file: not known, so one.
pub fn link_count(_: &Metadata) -> u64 {
    1
}

/// The folder for large temporary files.
pub fn temporary_folder() -> PathBuf {
    std::env::temp_dir()
}
