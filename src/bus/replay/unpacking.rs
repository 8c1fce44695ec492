//! Packed logs on disk: the files in which they lie unpacked, and what is beside a database.

use crate::log::{LogSpool, RandomAccess, Unpacked, UnreadChanges};
use crate::open_file::{path_of, temporary_folder};
use crate::positioned_read::{read_at, read_exact_at};
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Returns the bytes of a log, unpacked: `source` reads `file` from its start, or is a pipe.
///
/// # Errors
///
/// Those of the file system.
pub fn unpacked_log<'a>(
    source: impl Read + Send + 'a,
    file: &Arc<File>,
) -> io::Result<Unpacked<'a>> {
    let is_file = file.metadata()?.is_file();
    let pages = is_file.then(|| Arc::clone(file));
    Ok(unpacked_with(source, pages, file))
}

/// Returns the bytes of a log, unpacked; `pages` reads `file` in any order, unless it is a pipe.
pub(super) fn unpacked_with<'a>(
    source: impl Read + Send + 'a,
    pages: Option<impl RandomAccess + 'a>,
    file: &File,
) -> Unpacked<'a> {
    let unpacked = Unpacked::new(source).with_spool(spool);
    match pages {
        Some(pages) => unpacked.with_file(pages, unread_changes(file)),
        None => unpacked,
    }
}

/// Returns the changes of a database that are in a file beside it. Of the two kinds of such files the
/// other one was left by another database that had the same name.
fn unread_changes(file: &File) -> Option<UnreadChanges> {
    /// Version of a database with a write-ahead log, and where it is.
    const WITH_WAL: u8 = 2;
    const VERSION_AT: u64 = 19;
    /// Bytes of the head of a write-ahead log, without frames behind it: section 4.1.
    const WAL_HEAD: u64 = 32;
    let path = path_of(file)?.into_os_string();
    let beside = |ending: &str| {
        let mut path = path.clone();
        path.push(ending);
        let metadata = fs::metadata(&path).ok()?;
        metadata.is_file().then(|| (PathBuf::from(path), metadata.len()))
    };
    let mut version = [0];
    read_exact_at(file, &mut version, VERSION_AT).ok()?;
    if version == [WITH_WAL] {
        let (_, len) = beside("-wal")?;
        (len > WAL_HEAD).then_some(UnreadChanges::WriteAheadLog)
    } else {
        let (journal, len) = beside("-journal")?;
        // One that may not be read is as good as one with pages.
        let has_pages = File::open(journal).map_or(len > 0, |journal| journal_has_pages(&journal));
        has_pages.then_some(UnreadChanges::RollbackJournal)
    }
}

/// Returns true if a rollback journal has pages that its database is to get back. A transaction that has
/// ended leaves zeros in place of the head, or no file.
///
/// Source: "Database File Format" of SQLite, section 3.
fn journal_has_pages(journal: &File) -> bool {
    const MAGIC: [u8; 8] = [0xD9, 0xD5, 0x05, 0xF9, 0x20, 0xA1, 0x63, 0xD7];
    let mut head = [0; 28];
    if read_exact_at(journal, &mut head, 0).is_err() {
        return false;
    }
    let field =
        |at: usize| u32::from_be_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    let (pages, head_len) = (field(8), field(20));
    let is_longer = journal.metadata().is_ok_and(|it| it.len() > u64::from(head_len));
    head.starts_with(&MAGIC) && pages != 0 && is_longer
}

fn spool() -> io::Result<Box<dyn LogSpool>> {
    Ok(Box::new(UnpackedFile::new()?))
}

/// A file without a name for what a packed log contains.
pub(super) struct UnpackedFile {
    file: File,
    folder: PathBuf,
}

impl UnpackedFile {
    /// Makes a file.
    ///
    /// # Errors
    ///
    /// Those of the file system, with the folder and the way to name another one.
    pub fn new() -> io::Result<Self> {
        let folder = temporary_folder();
        match tempfile::tempfile_in(&folder) {
            Ok(file) => Ok(Self { file, folder }),
            Err(error) => Err(cannot_unpack(&folder, &error)),
        }
    }

    /// Returns another handle of the file.
    ///
    /// # Errors
    ///
    /// Those of the system.
    pub fn reader(&self) -> io::Result<File> {
        self.file.try_clone()
    }
}

impl Write for UnpackedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes).map_err(|error| cannot_unpack(&self.folder, &error))
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl RandomAccess for UnpackedFile {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
        read_at(&self.file, buffer, offset)
    }
}

impl LogSpool for UnpackedFile {
    fn into_bytes(self: Box<Self>) -> Box<dyn RandomAccess> {
        self
    }
}

fn cannot_unpack(folder: &Path, error: &io::Error) -> io::Error {
    let folder = folder.display();
    io::Error::other(format!("cannot unpack it in {folder}: {error}; name another with TMPDIR"))
}
