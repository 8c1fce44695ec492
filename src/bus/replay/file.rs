//! `file:LOG`: a recorded log as a bus.

use super::super::absolute_path::absolute;
use super::super::kind::{BusKind, OpenRequest};
use super::super::port::Port;
use crate::diagnostic::Diagnostic;
use crate::log::LogFormat;
use crate::regular_file::shown;
use std::fs::File;
use std::io;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

pub(in crate::bus) const KIND: BusKind = BusKind {
    scheme: "file",
    forms: &["file:LOG"],
    example: "file:session.log",
    note: None,
    can_send: false,
};

pub(in crate::bus) fn parse(text: &str) -> Result<PathBuf, Diagnostic> {
    if text.is_empty() { Err(KIND.incomplete()) } else { Ok(text.into()) }
}

/// Returns true if a BUS argument without a type is the path of a log: it has a folder, or the
/// ending of a log format. A device is none.
pub(in crate::bus) fn is_path(text: &str) -> bool {
    let is_log = || LogFormat::has_log_ending(Path::new(text));
    !text.starts_with("/dev/") && (text.contains('/') || is_log())
}

/// The path that all spellings of one log share.
pub(in crate::bus) fn normalised(path: &Path) -> PathBuf {
    absolute(path)
}

pub(in crate::bus) fn text(path: &Path) -> String {
    path.display().to_string()
}

pub(in crate::bus) fn open(path: &Path, request: OpenRequest) -> Result<Port, Diagnostic> {
    let is_pipe = std::fs::metadata(path).is_ok_and(|it| it.file_type().is_fifo());
    // A pipe opens before a writer does: its frames are waited for where other buses are not held up.
    let flags = if is_pipe { nix::libc::O_NONBLOCK } else { 0 };
    super::open(open_with(path, flags)?, Some(path), request)
}

/// Opens a log.
///
/// # Errors
///
/// Those of the file system; a folder is not a log.
pub fn open_log(path: &Path) -> Result<File, Diagnostic> {
    open_with(path, 0)
}

fn open_with(path: &Path, flags: i32) -> Result<File, Diagnostic> {
    let opened = File::options().read(true).custom_flags(flags).open(path).and_then(|log| {
        let is_folder = log.metadata()?.is_dir();
        if is_folder { Err(io::ErrorKind::IsADirectory.into()) } else { Ok(log) }
    });
    opened.map_err(|error| {
        let fault = Diagnostic::unreadable(format_args!("file:{}", shown(path)), &error);
        match error.kind() {
            io::ErrorKind::NotFound => fault.with_remedy("check the name"),
            io::ErrorKind::IsADirectory => fault.with_remedy("name a log in it"),
            io::ErrorKind::PermissionDenied => {
                fault.with_remedy(format!("allow it: sudo chmod a+r {}", shown(path)))
            }
            _ => fault,
        }
    })
}
