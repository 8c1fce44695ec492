//! `file:LOG`: a recorded log as a bus.

use super::super::kind::{BusKind, OpenError, OpenRequest, SpecError};
use super::super::port::Port;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

pub(in crate::bus) const KIND: BusKind = BusKind {
    scheme: "file",
    forms: &["file:LOG"],
    example: "file:session.log",
    note: None,
    can_send: false,
};

pub(in crate::bus) fn parse(text: &str) -> Result<PathBuf, SpecError> {
    if text.is_empty() { Err(SpecError::incomplete(&KIND)) } else { Ok(text.into()) }
}

pub(in crate::bus) fn text(path: &Path) -> String {
    path.display().to_string()
}

pub(in crate::bus) fn open(path: &Path, request: OpenRequest) -> Result<Port, OpenError> {
    let log =
        open_log(path).map_err(|cause| OpenError::Log { path: request.name.clone(), cause })?;
    super::open(log, Some(path), request)
}

/// Opens a log.
///
/// # Errors
///
/// Those of the file system; a folder is not a log.
pub fn open_log(path: &Path) -> io::Result<File> {
    let log = File::open(path)?;
    if log.metadata()?.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    Ok(log)
}
