//! The program in a folder of its own, without a terminal.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

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

/// Runs the program in `folder` with this standard input, which it need not read.
pub fn run_with_input(arguments: &[&str], folder: &Path, input: &[u8]) -> Output {
    let mut child = command(arguments, folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let _ = child.stdin.take().unwrap().write_all(input);
    child.wait_with_output().unwrap()
}

/// What it printed.
#[track_caller]
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("output is UTF-8")
}
