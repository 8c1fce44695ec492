//! What the command line's commands do: the same app, with a screen or without.
//!
//! Each returns the exit code that scripts rely on; what cannot be done is an error whose text
//! names the cause and the way out.

mod check;
mod guide;
mod headless;
mod open;
mod report;
mod scan;
mod simulate;
mod speed;
mod tui;
mod watch;

use crate::cli::{self, Cli, Command};
use std::io::{self, Write};
use std::process::ExitCode;

/// Nothing found, or all done.
pub const EXIT_OK: u8 = 0;
/// Findings that count.
pub const EXIT_FINDINGS: u8 = 1;
/// Wrong arguments.
pub const EXIT_USAGE: u8 = 2;
/// A bus or a file cannot be used.
pub const EXIT_UNUSABLE: u8 = 3;
/// Ended by SIGINT or SIGTERM.
pub const EXIT_INTERRUPTED: u8 = 130;

/// Why a command did not do its work.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Wrong arguments.
    #[error("{0}")]
    Usage(String),
    /// A bus or a file cannot be used.
    #[error("{0}")]
    Unusable(String),
    /// Standard output is closed: whoever read it has enough.
    #[error("standard output is closed")]
    Closed,
    /// The terminal or the system does not do as it should.
    #[error("{0:#}")]
    System(#[from] anyhow::Error),
}

/// Does what the arguments ask for. Errors go to standard error as one line; where a file is not
/// what it should be, followed by the line that is not.
pub fn run(cli: Cli) -> ExitCode {
    let result = match cli.command {
        None => tui::ui(&cli.session),
        Some(Command::Demo { system, session }) => tui::demo(&system, &session),
        Some(Command::Scan(scan)) => scan::run(&scan),
        Some(Command::Check(check)) => check::run(&check),
        Some(Command::Watch(watch)) => watch::run(&watch),
        Some(Command::Sim { bus, scenario, time }) => simulate::run(&bus, &scenario, time),
        Some(Command::Speed(speed)) => speed::run(&speed),
        Some(Command::Completions { shell }) => print(&cli::completions(shell)).map(|()| EXIT_OK),
        Some(Command::Man { name }) => guide::man(name.as_deref()),
        Some(Command::Help { name }) => guide::help(name.as_deref()),
        Some(Command::Schema) => print(crate::document::SCHEMA.as_bytes()).map(|()| EXIT_OK),
    };
    ExitCode::from(match result {
        Ok(code) => code,
        Err(Failure::Closed) => EXIT_OK,
        Err(failure) => {
            let _ = writeln!(io::stderr(), "descan: {failure}");
            match failure {
                Failure::Usage(_) => EXIT_USAGE,
                _ => EXIT_UNUSABLE,
            }
        }
    })
}

/// Writes all of it to standard output, at once.
fn print(text: &[u8]) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    let printed = out.write_all(text).and_then(|()| out.flush());
    printed.map_err(|error| match error.kind() {
        io::ErrorKind::BrokenPipe => Failure::Closed,
        _ => Failure::System(anyhow::Error::new(error).context("cannot write to standard output")),
    })
}
