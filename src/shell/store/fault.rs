//! Faults of writing, with their remedies.

use crate::diagnostic::Diagnostic;
use crate::regular_file::{of_system, path_fault};
use nix::errno::Errno;
use std::io;

pub(in crate::shell) fn already_exists() -> Diagnostic {
    Diagnostic::new("already exists").with_remedy("name another file")
}

/// Returns the fault of a file that the system does not write.
pub(in crate::shell) fn not_written(error: &io::Error) -> Diagnostic {
    let (cause, remedy) = match error.raw_os_error().map(Errno::from_raw) {
        Some(Errno::EACCES | Errno::EPERM) => {
            ("no permission for its folder", "fix it, or save elsewhere")
        }
        Some(Errno::EROFS) => ("mounted read-only", "remount it, or save elsewhere"),
        Some(Errno::ENOSPC | Errno::EDQUOT) => ("the disk is full", "make room, or save elsewhere"),
        Some(Errno::EFBIG) => ("file size limit reached", "raise it: ulimit -f"),
        Some(Errno::EBUSY) => ("a bind mount", "mount its folder, or save elsewhere"),
        _ => return path_fault(error).unwrap_or_else(|| of_system(error, "cannot be written")),
    };
    Diagnostic::new(cause).with_remedy(remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks the texts directly: some of these errors need mounted file systems.
    #[test]
    fn system_errors_name_the_way_out() {
        for (error, text) in [
            (Errno::ENOSPC, "the disk is full; make room, or save elsewhere"),
            (Errno::EDQUOT, "the disk is full; make room, or save elsewhere"),
            (Errno::EFBIG, "file size limit reached; raise it: ulimit -f"),
            (Errno::EROFS, "mounted read-only; remount it, or save elsewhere"),
            (Errno::EBUSY, "a bind mount; mount its folder, or save elsewhere"),
            (Errno::EACCES, "no permission for its folder; fix it, or save elsewhere"),
            (Errno::EMFILE, "too many files are open; close other programs, or raise ulimit -n"),
            (Errno::EIO, "cannot be written: Input/output error"),
        ] {
            assert_eq!(not_written(&error.into()).to_string(), text);
        }
    }
}
