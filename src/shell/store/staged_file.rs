//! A file that is written part by part beside its target, and takes its place at the end.

use super::exchange::{ExchangeError, exchange, put_in_place};
use super::fault::not_written;
use super::places::Places;
use super::{already_exists, create_with_attributes};
use crate::diagnostic::Diagnostic;
use crate::regular_file::RegularFile;
use std::io::{self, ErrorKind, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// A file beside its target; removed when dropped.
#[derive(Debug)]
pub struct StagedFile {
    file: NamedTempFile,
    target: PathBuf,
    may_replace: bool,
}

impl StagedFile {
    /// Creates a file that is to have the name `path`, which may be a symbolic link. It keeps of a file
    /// that it replaces what a save keeps. Whether there is a file that it may not replace is found by
    /// [`Self::finish`].
    ///
    /// # Errors
    /// The fault, without the path, if the file cannot be created, or cannot have the access of the one
    /// that it replaces.
    pub fn create(path: &Path, may_replace: bool) -> Result<Self, Diagnostic> {
        let places = Places::of(path).map_err(|error| not_written(&error))?;
        if let Some(missing) = places.missing_folder(path) {
            return Err(missing);
        }
        let Places { target, folder, .. } = places;
        let old = if may_replace { RegularFile::open(&target)? } else { None };
        let file = create_with_attributes(&target, &folder, old.as_ref())?;
        Ok(Self { file, target, may_replace })
    }

    /// Returns the path of the temporary file.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Writes behind what was written.
    ///
    /// # Errors
    /// The fault, without the path.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), Diagnostic> {
        self.file.as_file_mut().write_all(bytes).map_err(|error| not_written(&error))
    }

    /// Replaces the first bytes of what was written; nothing is appended after that.
    ///
    /// # Errors
    /// The fault, without the path.
    pub fn replace_start(&mut self, bytes: &[u8]) -> Result<(), Diagnostic> {
        let file = self.file.as_file_mut();
        let written = file.seek(SeekFrom::Start(0)).and_then(|_| file.write_all(bytes));
        written.map_err(|error| not_written(&error))
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// The fault, without the path: a file may not be replaced, or the system does not do it. The old
    /// file stays as it was, on Windows perhaps under another name, which the fault says.
    pub fn finish(self) -> Result<(), Diagnostic> {
        let Self { file, target, may_replace } = self;
        let moved = if may_replace {
            // Without it, a power failure could leave neither the old content nor the new one.
            file.as_file().sync_all().and_then(|()| replace(file, &target))
        } else {
            file.persist_noclobber(&target).map(|_| ()).map_err(|error| error.error)
        };
        moved.map_err(|error| match error.kind() {
            ErrorKind::AlreadyExists => already_exists(),
            _ => not_written(&error),
        })
    }
}

fn replace(file: NamedTempFile, target: &Path) -> io::Result<()> {
    let file = file.into_temp_path();
    if cfg!(windows) {
        // The exchange keeps the access list, which a new file does not have there.
        match exchange(&file, target) {
            Ok(()) => return Ok(()),
            Err(ExchangeError::System(error)) => return Err(error),
            Err(ExchangeError::Missing | ExchangeError::NotSupported) => {}
        }
    }
    put_in_place(file, target)
}
