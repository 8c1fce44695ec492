//! What is kept of a file that is replaced, besides its name: owner, group, mode, access control
//! list, extended attributes.

#[cfg(unix)]
mod unix;
#[cfg(windows)]
mod windows;

#[cfg(unix)]
pub(super) use unix::{is_same_access, keep, open_lock, require_write_permission};
#[cfg(windows)]
pub(super) use windows::{is_same_access, keep, open_lock, require_write_permission};

use crate::diagnostic::Diagnostic;
use std::io;

/// Why the attributes of a file cannot be given to another one.
#[derive(Debug, thiserror::Error)]
pub(super) enum AttributeError {
    /// An attribute would be lost.
    #[error("{0}")]
    #[cfg_attr(windows, expect(dead_code, reason = "Windows keeps none"))]
    NotKept(Diagnostic),
    /// The disk fails.
    #[error("{0}")]
    Disk(#[from] io::Error),
}
