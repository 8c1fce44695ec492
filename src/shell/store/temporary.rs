//! Temporary files beside their target.

use crate::open_file::create_new;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::io;
use std::path::Path;
use tempfile::{NamedTempFile, TempPath};

/// Between the target's name and the random characters.
const MARK: &str = ".descan-";

const RANDOM_CHARACTERS: usize = 6;

const SUFFIX: &str = ".tmp";

/// Longest file name of the file systems of Linux, in bytes.
const MAX_NAME_BYTES: usize = 255;

/// Creates a file beside the target, removed when dropped. tempfile's own functions are not used,
/// because their errors contain the temporary path and have no error number.
///
/// # Errors
/// The file cannot be created.
pub(super) fn create_beside(target: &Path, folder: &Path, mode: u32) -> io::Result<NamedTempFile> {
    loop {
        let mut name = prefix(target);
        name.push((0..RANDOM_CHARACTERS).map(|_| fastrand::alphanumeric()).collect::<String>());
        name.push(SUFFIX);
        let path = folder.join(name);
        match create_new(&path, mode) {
            Ok(file) => return Ok(NamedTempFile::from_parts(file, TempPath::try_from_path(path)?)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
}

/// Removes temporary files of saves that were killed. Call only under the lock: it would remove the
/// file of a save in progress.
pub(super) fn remove_leftovers(target: &Path, folder: &Path) {
    let prefix = prefix(target);
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let rest = name.as_encoded_bytes().strip_prefix(prefix.as_encoded_bytes());
        let is_ours = rest.is_some_and(|rest| rest.ends_with(SUFFIX.as_bytes()));
        if is_ours && entry.file_type().is_ok_and(|kind| kind.is_file()) {
            // A leftover that cannot be removed is harmless.
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Returns the beginning of the names of temporary files; random characters follow. Of a target's
/// name so long that a temporary name would not fit, only the beginning is used.
fn prefix(target: &Path) -> OsString {
    let name = target.file_name().unwrap_or_default();
    let room = MAX_NAME_BYTES - ".".len() - MARK.len() - RANDOM_CHARACTERS - SUFFIX.len();
    let mut prefix = OsString::from(".");
    prefix.push(beginning(name, room));
    prefix.push(MARK);
    prefix
}

/// Returns the longest beginning of at most `max_bytes`, without a partial character: some file
/// systems accept only UTF-8.
fn beginning(name: &OsStr, max_bytes: usize) -> OsString {
    let bytes = name.as_encoded_bytes();
    let is_continuation = |at: usize| bytes.get(at).is_some_and(|byte| byte & 0xC0 == 0x80);
    let end = (0..=max_bytes.min(bytes.len())).rev().find(|&at| !is_continuation(at));
    name_of(&bytes[..end.unwrap_or(0)])
}

#[cfg(unix)]
fn name_of(bytes: &[u8]) -> OsString {
    use std::os::unix::ffi::OsStringExt as _;
    OsString::from_vec(bytes.to_vec())
}

/// Half a surrogate pair is replaced: the name only has to be the same each time.
#[cfg(windows)]
fn name_of(bytes: &[u8]) -> OsString {
    String::from_utf8_lossy(bytes).into_owned().into()
}
