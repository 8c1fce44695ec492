//! A copy of what could not be saved, for when the program ends without having asked: the line to
//! the board dropped, or somebody ended it.

use etcetera::{BaseStrategy, choose_base_strategy};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Writes a copy into a new file in `$XDG_STATE_HOME/descan` (by default `~/.local/state/descan`),
/// or, where that cannot be, in the folder for temporary files. Comes back with where it is.
pub fn save_recovery_copy(content: &[u8]) -> io::Result<PathBuf> {
    let base = choose_base_strategy().ok();
    let state = base.and_then(|base| base.state_dir()).map(|folder| folder.join("descan"));
    let kept = state.and_then(|folder| {
        std::fs::create_dir_all(&folder).ok()?;
        keep_in(&folder, content).ok()
    });
    kept.map_or_else(|| keep_in(&std::env::temp_dir(), content), Ok)
}

fn keep_in(folder: &Path, content: &[u8]) -> io::Result<PathBuf> {
    let mut file =
        tempfile::Builder::new().prefix("unsaved-").suffix(".json").tempfile_in(folder)?;
    // Not synchronized with the disk: that could take for ever, and the program is to end.
    file.write_all(content)?;
    Ok(file.into_temp_path().keep()?)
}
