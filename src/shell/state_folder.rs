//! The folder for what descan remembers between runs.

use etcetera::{BaseStrategy, choose_base_strategy};
use std::path::PathBuf;

/// Returns `$XDG_STATE_HOME/descan`, by default `~/.local/state/descan`; on Windows, which has no such
/// folder, `%APPDATA%\descan\state`. `None` without a home folder.
pub fn state_folder() -> Option<PathBuf> {
    let base = choose_base_strategy().ok()?;
    match base.state_dir() {
        Some(folder) => Some(folder.join("descan")),
        None => Some(base.data_dir().join("descan").join("state")),
    }
}
