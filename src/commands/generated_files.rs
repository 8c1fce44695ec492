//! Files that descan makes of a profile, for other programs.

use super::{Failure, output};
use crate::diagnostic::Diagnostic;
use crate::regular_file;
use crate::text::printable_path;
use std::path::Path;

/// Writes files to a folder. One that is there with other content is replaced with `force` only,
/// and then no file is written.
pub fn write_generated(folder: &Path, files: &[(&str, &str)], force: bool) -> Result<(), Failure> {
    let mut missing = Vec::new();
    for (name, text) in files {
        let path = folder.join(name);
        match regular_file::read_text(&path)? {
            Some(content) if content == *text => {}
            Some(_) if !force => {
                let fault = Diagnostic::new("already exists, with other content");
                return Err(fault
                    .with_remedy("--force replaces it")
                    .of(printable_path(&path))
                    .into());
            }
            _ => missing.push((path, text)),
        }
    }
    std::fs::create_dir_all(folder).map_err(|error| {
        regular_file::of_system(&error, "not created").of(printable_path(folder))
    })?;
    for (path, text) in missing {
        std::fs::write(&path, text).map_err(|error| {
            regular_file::of_system(&error, "not written").of(printable_path(&path))
        })?;
        output::warn(format_args!("wrote {}", printable_path(&path)));
    }
    Ok(())
}
