//! Faults of writing, with their remedies.

use crate::diagnostic::Diagnostic;
use crate::regular_file::{of_system, path_fault};
use crate::system_error::FileFault;
use std::io;

pub(in crate::shell) fn already_exists() -> Diagnostic {
    Diagnostic::new("already exists").with_remedy("name another file")
}

/// Returns the fault of a file that the system does not write.
pub(in crate::shell) fn not_written(error: &io::Error) -> Diagnostic {
    let (cause, remedy) = match FileFault::of(error) {
        Some(FileFault::NotPermitted) => {
            ("no permission for its folder", "fix it, or save elsewhere")
        }
        Some(FileFault::Protected) if cfg!(target_os = "macos") => {
            ("protected (immutable, or sticky folder)", "see ls -lO, or save elsewhere")
        }
        Some(FileFault::Protected) => {
            ("protected (immutable, or sticky folder)", "see lsattr, or save elsewhere")
        }
        Some(FileFault::ReadOnly) => ("mounted read-only", "remount it, or save elsewhere"),
        Some(FileFault::DiskFull) => ("the disk is full", "make room, or save elsewhere"),
        Some(FileFault::TooLarge) => ("file size limit reached", "raise it: ulimit -f"),
        Some(FileFault::InUse) if cfg!(windows) => ("open in another program", "close it there"),
        Some(FileFault::InUse) => ("a bind mount", "mount its folder, or save elsewhere"),
        _ => return path_fault(error).unwrap_or_else(|| of_system(error, "cannot be written")),
    };
    Diagnostic::new(cause).with_remedy(remedy)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use nix::errno::Errno;

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
            (
                Errno::EPERM,
                if cfg!(target_os = "macos") {
                    "protected (immutable, or sticky folder); see ls -lO, or save elsewhere"
                } else {
                    "protected (immutable, or sticky folder); see lsattr, or save elsewhere"
                },
            ),
            (Errno::EMFILE, "too many files are open; close other programs, or raise ulimit -n"),
            (Errno::EIO, "cannot be written: Input/output error"),
        ] {
            assert_eq!(not_written(&error.into()).to_string(), text);
        }
    }
}
