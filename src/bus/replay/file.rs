//! `file:LOG`: a recorded log as a bus.

use super::super::absolute_path::absolute;
use super::super::kind::{BusKind, OpenRequest};
use super::super::port::Port;
use crate::diagnostic::Diagnostic;
use crate::log::LogFormat;
use crate::open_file::{open_pipe_at_once, open_waiting};
use crate::text::printable_path;
use std::fs::File;
use std::io;
use std::path::{Component, Path, PathBuf};

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

/// Beginnings of paths below `/dev` that are no devices: open files, as those of a shell's `<(…)`, and files in
/// memory.
const FILES_OF_DEV: [&str; 3] = ["/dev/stdin", "/dev/fd/", "/dev/shm/"];

/// Returns true if a BUS argument without a type is the path of a log: it has a folder, or the
/// ending of a log format. A device is none.
pub(in crate::bus) fn is_path(text: &str) -> bool {
    let is_log = || LogFormat::has_log_ending(Path::new(text));
    let is_device =
        text.starts_with("/dev/") && !FILES_OF_DEV.iter().any(|files| text.starts_with(files));
    !is_device && (text.contains(std::path::is_separator) || is_log())
}

/// Returns true if a text begins with a drive, as `C:`. Only Windows has drives.
pub(in crate::bus) fn has_drive(text: &str) -> bool {
    matches!(Path::new(text).components().next(), Some(Component::Prefix(_)))
}

/// The path that all spellings of one log share.
pub(in crate::bus) fn normalised(path: &Path) -> PathBuf {
    absolute(path)
}

pub(in crate::bus) fn text(path: &Path) -> String {
    path.display().to_string()
}

pub(in crate::bus) fn open(path: &Path, request: OpenRequest) -> Result<Port, Diagnostic> {
    // The frames of a pipe are waited for where other buses are not held up.
    super::open(checked(path, open_pipe_at_once(path))?, Some(path), request)
}

/// Opens a log.
///
/// # Errors
///
/// Those of the file system; a folder is not a log.
pub fn open_log(path: &Path) -> Result<File, Diagnostic> {
    checked(path, open_waiting(path))
}

fn checked(path: &Path, opened: io::Result<File>) -> Result<File, Diagnostic> {
    let opened = opened.and_then(|log| {
        let is_folder = log.metadata()?.is_dir();
        if is_folder { Err(io::ErrorKind::IsADirectory.into()) } else { Ok(log) }
    });
    opened.map_err(|error| {
        let fault = Diagnostic::unreadable(format_args!("file:{}", printable_path(path)), &error);
        match error.kind() {
            io::ErrorKind::NotFound => fault.with_remedy("check the name"),
            io::ErrorKind::IsADirectory => fault.with_remedy("name a log in it"),
            io::ErrorKind::PermissionDenied if cfg!(unix) => {
                fault.with_remedy(format!("allow it: sudo chmod a+r {}", printable_path(path)))
            }
            _ => fault,
        }
    })
}
