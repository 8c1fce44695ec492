//! The program in a folder of its own, without a terminal.

use std::path::Path;
use std::process::{Command, Stdio};

/// Returns the command that runs the program in `folder`.
pub fn command(arguments: &[&str], folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
    command
        .args(arguments)
        .current_dir(folder)
        .env("XDG_CONFIG_HOME", folder.join("config"))
        .env("TZ", "UTC")
        .stdin(Stdio::null());
    command
}

/// What it printed.
#[track_caller]
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("output is UTF-8")
}
