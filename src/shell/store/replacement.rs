//! The step in which a temporary file takes the place of the target.
//!
//! The two files are exchanged where the system can (`RENAME_EXCHANGE`; `ReplaceFile` of Windows keeps
//! the old file under another name). What came out of the exchange is then compared with what was
//! expected, and put back if it is something else: so a change made between a comparison and the
//! exchange is not lost. A program that had the old file open may still write to it: descan looks at it
//! for 0.1 s and, if it changed, puts it back as well. Elsewhere (NFS, FUSE, FAT) the content is compared right before a rename.
//!
//! What remains: a write to the old file after that time; any write to it where files cannot be
//! exchanged, and a change in the few microseconds between comparison and rename there; a write to
//! the old file by one program after another program has replaced the new one; and a change made
//! right before the exchange if descan is killed before it is put back.

use super::attributes::is_same_access;
use super::exchange::{ExchangeError, exchange, put_in_place, rename_to_free};
use super::fault::not_written;
use super::{MAX_BYTES, SaveError, Store};
use crate::diagnostic::{Diagnostic, without_number};
use crate::open_file::link_count;
use crate::regular_file::RegularFile;
use crate::text::printable;
use std::fs::{self, Metadata};
use std::path::Path;
use std::thread;
use std::time::Duration;
use tempfile::{NamedTempFile, TempPath};

/// Looks at a replaced file, for writes of programs that had it open, and the time before each. A
/// program that reads, changes and writes a file of this size takes milliseconds, and soon expects
/// to read what it wrote.
const LOOKS: [(u32, Duration); 2] =
    [(10, Duration::from_millis(1)), (9, Duration::from_millis(10))];

/// The new file in the place of the old one.
pub(super) struct Replaced<'a> {
    target: &'a Path,
    expected: &'a [u8],
    new: &'a [u8],
    /// The old file and its temporary name, removed when dropped; `None` if the old file has no
    /// name any more.
    old: Option<(RegularFile, TempPath)>,
}

/// Replaces `target` by `temporary`, which contains `new`, if the content of `target` is
/// `expected` and its access that of `metadata`.
///
/// # Errors
/// [`SaveError`]; the target is then not replaced.
pub(super) fn replace<'a>(
    temporary: NamedTempFile,
    target: &'a Path,
    expected: &'a [u8],
    new: &'a [u8],
    metadata: &Metadata,
) -> Result<Replaced<'a>, SaveError> {
    require_content(target, expected)?;
    let beside = temporary.into_temp_path();
    match exchange(&beside, target) {
        Ok(()) => {}
        Err(ExchangeError::Missing) => return Err(SaveError::Changed(None)),
        Err(ExchangeError::NotSupported) => {
            // The content may have changed during the failed attempt.
            require_content(target, expected)?;
            put_in_place(beside, target).map_err(|error| not_written(&error))?;
            return Ok(Replaced { target, expected, new, old: None });
        }
        Err(ExchangeError::System(error)) => return Err(not_written(&error).into()),
    }
    let old = RegularFile::open(&beside).ok().flatten();
    let old =
        old.filter(|old| is_same_access(old.metadata(), metadata) && has_content(old, expected));
    let Some(old) = old else {
        put_back(beside, target, new)?;
        return Err(SaveError::Changed(Store::new(target).read()?));
    };
    Ok(Replaced { target, expected, new, old: Some((old, beside)) })
}

impl Replaced<'_> {
    /// Number of other names (hard links) of the old file; `None` if it is not at hand.
    pub fn other_names(&self) -> Option<u64> {
        self.old.as_ref().map(|(old, _)| link_count(old.metadata()).saturating_sub(1))
    }

    /// Watches the old file for 0.1 s, then removes it.
    ///
    /// # Errors
    /// Another program wrote to it: it is back in its place.
    pub fn finish(self) -> Result<(), SaveError> {
        let Some((old, beside)) = self.old else { return Ok(()) };
        if !is_written_late(&old, self.expected) {
            return Ok(());
        }
        put_back(beside, self.target, self.new)?;
        Err(SaveError::Changed(Store::new(self.target).read()?))
    }
}

/// Returns [`SaveError::Changed`] unless this is the content.
fn require_content(target: &Path, expected: &[u8]) -> Result<(), SaveError> {
    let present = Store::new(target).read()?;
    if present.as_deref() == Some(expected) { Ok(()) } else { Err(SaveError::Changed(present)) }
}

fn has_content(file: &RegularFile, expected: &[u8]) -> bool {
    file.read(MAX_BYTES).is_ok_and(|content| content == expected)
}

/// Returns true if the content differs from `expected` at one of the [`LOOKS`].
fn is_written_late(old: &RegularFile, expected: &[u8]) -> bool {
    let stamp = |metadata: Metadata| (metadata.len(), metadata.modified().ok());
    let first = stamp(old.metadata().clone());
    for period in LOOKS.iter().flat_map(|&(count, period)| (0..count).map(move |_| period)) {
        thread::sleep(period);
        let is_touched = old.file().metadata().is_ok_and(|metadata| stamp(metadata) != first);
        if is_touched && !has_content(old, expected) {
            return true;
        }
    }
    // A write within the resolution of the time stamp.
    !has_content(old, expected)
}

/// Puts the old file back, from its temporary name, which then is that of the new file. If another
/// program has changed the new file meanwhile, that file stays: it is the newest.
///
/// # Errors
/// The old file could not be put back; it keeps its temporary name.
fn put_back(beside: TempPath, target: &Path, new: &[u8]) -> Result<(), SaveError> {
    match exchange(&beside, target) {
        Ok(()) => {
            let ours = RegularFile::open(&beside).ok().flatten();
            if !ours.is_some_and(|ours| has_content(&ours, new)) {
                // If that fails, the older change of another program stays.
                let _ = exchange(&beside, target);
            }
            Ok(())
        }
        // The new file was deleted, as by a program that renames it first.
        Err(ExchangeError::Missing) => renamed_back(beside, target, true),
        Err(_) => renamed_back(beside, target, false),
    }
}

/// Gives the old file its name back; `is_free`: only if no file has it.
fn renamed_back(beside: TempPath, target: &Path, is_free: bool) -> Result<(), SaveError> {
    let renamed =
        if is_free { rename_to_free(&beside, target) } else { fs::rename(&beside, target) };
    let Err(error) = renamed else { return Ok(()) };
    let name = beside.file_name().unwrap_or_default().as_encoded_bytes().to_vec();
    // Not removed: it has the change of the other program.
    let _ = beside.keep();
    let cause = format!("change of another program not put back: {}", without_number(&error));
    let remedy = format!("it is in {}", printable(&name));
    Err(Diagnostic::new(cause).with_remedy(remedy).into())
}
