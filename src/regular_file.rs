//! Regular files, opened without blocking and read as a whole up to a limit.
//!
//! Folders, pipes, sockets and devices are refused: reading them may block or never end. Does not
//! know what is in a file.

use crate::diagnostic::{Diagnostic, without_number};
use crate::open_file::open_without_wait;
use crate::system_error::FileFault;
use crate::text::printable_path;
use std::fs::{File, Metadata};
use std::io::{self, ErrorKind, Read as _, Seek as _};
use std::path::Path;

/// Longest text file that is read, in bytes: settings, keys, themes, profiles, scenarios.
pub const MAX_TEXT_BYTES: u64 = 1 << 20;

/// An open regular file.
#[derive(Debug)]
pub struct RegularFile {
    file: File,
    metadata: Metadata,
}

impl RegularFile {
    /// Opens a file for reading; `None` if it does not exist.
    ///
    /// # Errors
    /// The fault, without the path, if it cannot be opened or is not a regular file.
    pub fn open(path: &Path) -> Result<Option<Self>, Diagnostic> {
        let file = match open_without_wait(path) {
            Ok(file) => file,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(not_read(&error)),
        };
        let metadata = file.metadata().map_err(|error| not_read(&error))?;
        check_kind(&metadata)?;
        Ok(Some(Self { file, metadata }))
    }

    /// Returns the open file.
    pub fn file(&self) -> &File {
        &self.file
    }

    /// Returns the metadata as of opening.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// Returns the whole content, from its start.
    ///
    /// # Errors
    /// The fault, without the path, if it cannot be read or is longer than `max_bytes`.
    pub fn read(&self, max_bytes: u64) -> Result<Vec<u8>, Diagnostic> {
        let size = self.metadata.len();
        let mut content = Vec::new();
        if size <= max_bytes {
            // The size is known: no buffer is copied while another program may write.
            content.reserve_exact(size as usize + 1);
            let mut file = &self.file;
            // The file may grow while it is read.
            let read =
                file.rewind().and_then(|()| file.take(max_bytes + 1).read_to_end(&mut content));
            read.map_err(|error| not_read(&error))?;
        }
        if size.max(content.len() as u64) > max_bytes {
            let limit = format!("larger than {} MiB", max_bytes >> 20);
            return Err(Diagnostic::new(limit).with_remedy("check the file name"));
        }
        Ok(content)
    }
}

/// Returns the whole content of a regular file; `None` if it does not exist.
///
/// # Errors
/// The fault, without the path, if it is not a readable regular file of up to `max_bytes`.
pub fn read(path: &Path, max_bytes: u64) -> Result<Option<Vec<u8>>, Diagnostic> {
    RegularFile::open(path)?.map(|file| file.read(max_bytes)).transpose()
}

/// Returns the text of a regular file; `None` if it does not exist.
///
/// # Errors
/// The fault, with the path, if it is not a readable text in UTF-8 of up to [`MAX_TEXT_BYTES`].
pub fn read_text(path: &Path) -> Result<Option<String>, Diagnostic> {
    let text = read(path, MAX_TEXT_BYTES).and_then(|content| content.map(text_of).transpose());
    text.map_err(|fault| fault.of(printable_path(path)))
}

/// Returns the text of a file that must be there.
///
/// # Errors
/// As [`read_text`], or it does not exist.
pub fn required_text(path: &Path) -> Result<String, Diagnostic> {
    let missing = || Diagnostic::new("file not found").of(printable_path(path));
    read_text(path)?.ok_or_else(missing)
}

/// Returns the content as text.
///
/// # Errors
/// It is not UTF-8.
pub fn text_of(content: Vec<u8>) -> Result<String, Diagnostic> {
    String::from_utf8(content)
        .map_err(|_| Diagnostic::new("not UTF-8").with_remedy("save it as UTF-8"))
}

/// Returns the fault if this is not a regular file.
///
/// # Errors
/// The fault, without the path.
pub fn check_kind(metadata: &Metadata) -> Result<(), Diagnostic> {
    match metadata.file_type() {
        kind if kind.is_dir() => {
            Err(Diagnostic::new("is a folder").with_remedy("name a file in it"))
        }
        kind if kind.is_file() => Ok(()),
        _ => Err(Diagnostic::new("not a regular file").with_remedy("name another one")),
    }
}

/// Returns the fault of a file that the system does not read.
pub fn not_read(error: &io::Error) -> Diagnostic {
    if error.kind() == ErrorKind::PermissionDenied {
        return Diagnostic::new("no read permission").with_remedy("fix it, or name another file");
    }
    path_fault(error).unwrap_or_else(|| of_system(error, "cannot be read"))
}

/// Returns the fault of a path that the system does not resolve or open; `None` for other errors.
pub fn path_fault(error: &io::Error) -> Option<Diagnostic> {
    let (cause, remedy) = match FileFault::of(error)? {
        FileFault::ParentIsFile => ("parent is a file, not a folder", "name another one"),
        FileFault::NameTooLong => ("the name is too long", "choose a shorter one"),
        FileFault::LinkLoop => ("symbolic link loop", "name another file"),
        FileFault::TooManyFiles => {
            ("too many files are open", "close other programs, or raise ulimit -n")
        }
        _ => return None,
    };
    Some(Diagnostic::new(cause).with_remedy(remedy))
}

/// Returns a fault without a known remedy: `WHAT: CAUSE`.
pub fn of_system(error: &io::Error, what: &str) -> Diagnostic {
    Diagnostic::new(format!("{what}: {}", without_number(error)))
}
