//! One form of a path, whatever it was written as.
//!
//! Asks the file system for links and the working folder. Does not know what is in the file.

use std::path::{Component, Path, PathBuf};

/// Returns the path without links, `.` and `..`, from the root. Links are followed only if the file
/// exists.
pub(super) fn absolute(path: &Path) -> PathBuf {
    if let Ok(path) = std::fs::canonicalize(path) {
        return path;
    }
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let mut short = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir => {
                short.pop();
            }
            part => short.push(part),
        }
    }
    short
}
