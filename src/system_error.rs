//! Causes of failed file operations that have a remedy, from the system's error numbers.

use std::io;

/// A cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileFault {
    /// A part of the path is a file.
    ParentIsFile,
    /// A name is longer than the file system allows.
    NameTooLong,
    /// Symbolic links lead in a circle.
    LinkLoop,
    /// The program or the system has too many open files.
    TooManyFiles,
    /// The user may not.
    NotPermitted,
    /// The file is immutable, or belongs to another user and is in a sticky folder.
    Protected,
    /// The file system is mounted read-only.
    ReadOnly,
    /// No room, or the user's quota is used up.
    DiskFull,
    /// The file would be larger than allowed.
    TooLarge,
    /// In use: a mount point, on Windows a file that another program has open.
    InUse,
}

impl FileFault {
    /// Returns the cause of an error of the system; `None` if it is none of these.
    #[cfg(unix)]
    pub fn of(error: &io::Error) -> Option<Self> {
        use nix::errno::Errno;
        Some(match error.raw_os_error().map(Errno::from_raw)? {
            Errno::ENOTDIR => Self::ParentIsFile,
            Errno::ENAMETOOLONG => Self::NameTooLong,
            Errno::ELOOP => Self::LinkLoop,
            Errno::EMFILE | Errno::ENFILE => Self::TooManyFiles,
            Errno::EACCES => Self::NotPermitted,
            Errno::EPERM => Self::Protected,
            Errno::EROFS => Self::ReadOnly,
            Errno::ENOSPC | Errno::EDQUOT => Self::DiskFull,
            Errno::EFBIG => Self::TooLarge,
            Errno::EBUSY => Self::InUse,
            _ => return None,
        })
    }

    /// Returns the cause of an error of the system; `None` if it is none of these.
    #[cfg(windows)]
    pub fn of(error: &io::Error) -> Option<Self> {
        Some(match error.raw_os_error()? {
            // ERROR_DIRECTORY.
            267 => Self::ParentIsFile,
            // ERROR_FILENAME_EXCED_RANGE.
            206 => Self::NameTooLong,
            LINK_LOOP => Self::LinkLoop,
            // ERROR_TOO_MANY_OPEN_FILES.
            4 => Self::TooManyFiles,
            // ERROR_ACCESS_DENIED.
            5 => Self::NotPermitted,
            // ERROR_WRITE_PROTECT.
            19 => Self::ReadOnly,
            // ERROR_HANDLE_DISK_FULL, ERROR_DISK_FULL, ERROR_DISK_QUOTA_EXCEEDED.
            39 | 112 | 1295 => Self::DiskFull,
            // ERROR_FILE_TOO_LARGE.
            223 => Self::TooLarge,
            // ERROR_SHARING_VIOLATION, ERROR_LOCK_VIOLATION, ERROR_UNABLE_TO_REMOVE_REPLACED,
            // ERROR_UNABLE_TO_MOVE_REPLACEMENT.
            32 | 33 | 1175 | 1176 => Self::InUse,
            _ => return None,
        })
    }
}

#[cfg(unix)]
const LINK_LOOP: i32 = nix::libc::ELOOP;
/// ERROR_CANT_RESOLVE_FILENAME.
#[cfg(windows)]
const LINK_LOOP: i32 = 1921;

/// The error of symbolic links that lead in a circle.
pub fn link_loop() -> io::Error {
    io::Error::from_raw_os_error(LINK_LOOP)
}
