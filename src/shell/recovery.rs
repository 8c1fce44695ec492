//! Recovery copy of unsaved des.json edits, written when descan ends without a prompt (SIGHUP,
//! SIGTERM, lost terminal).

use super::state_folder::state_folder;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Writes `content` to a new file in `$XDG_STATE_HOME/descan` (default `~/.local/state/descan`) or,
/// if that fails, in the folder for temporary files. Returns its path.
///
/// # Errors
/// Neither folder can be written to.
pub fn save_recovery_copy(content: &[u8]) -> io::Result<PathBuf> {
    let copy = state_folder().and_then(|folder| {
        std::fs::create_dir_all(&folder).ok()?;
        write_copy(&folder, content).ok()
    });
    copy.map_or_else(|| write_copy(&std::env::temp_dir(), content), Ok)
}

fn write_copy(folder: &Path, content: &[u8]) -> io::Result<PathBuf> {
    let mut file =
        tempfile::Builder::new().prefix("unsaved-").suffix(".json").tempfile_in(folder)?;
    // No fsync: it may block, and the program is to end.
    file.write_all(content)?;
    Ok(file.into_temp_path().keep()?)
}
