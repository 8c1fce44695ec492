//! Windows: a new file has the access of its folder. As it takes the place of the old one, `ReplaceFile`
//! gives it the access control list, the alternate streams and the creation time of that.

use super::AttributeError;
use crate::diagnostic::Diagnostic;
use std::fs::{File, Metadata};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::io;
use std::path::Path;

/// Keeps nothing: the new file has the access of its folder already.
#[expect(clippy::unnecessary_wraps, reason = "attributes of other systems can be lost")]
pub(in crate::shell::store) fn keep(
    _: &File,
    _: &Metadata,
    _: &File,
) -> Result<(), AttributeError> {
    Ok(())
}

/// Returns true if two files are both read-only, or neither is.
pub(in crate::shell::store) fn is_same_access(one: &Metadata, other: &Metadata) -> bool {
    one.permissions().readonly() == other.permissions().readonly()
}

/// Returns the fault of a file that is read-only. A save does not write to the file itself.
pub(in crate::shell::store) fn require_write_permission(
    target: &Path,
    metadata: &Metadata,
) -> Result<(), Diagnostic> {
    if metadata.permissions().readonly() {
        let remedy = format!("attrib -r {}, or save elsewhere", target.display());
        return Err(Diagnostic::new("write-protected").with_remedy(remedy));
    }
    Ok(())
}

/// Opens what the saves to a folder are locked by: a file of the user's folder for temporary files,
/// because a folder itself cannot be locked.
pub(in crate::shell::store) fn open_lock(folder: &Path) -> io::Result<File> {
    let mut hasher = DefaultHasher::new();
    folder.hash(&mut hasher);
    let name = format!("descan-{:016x}.lock", hasher.finish());
    File::options().create(true).append(true).open(std::env::temp_dir().join(name))
}
