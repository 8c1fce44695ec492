//! The command `descan`: parse, run, exit code.

#![deny(clippy::print_stdout, clippy::print_stderr)]

use descan::cli::{self, CliExit};
use descan::commands::{self, output};
use std::process::ExitCode;

fn main() -> ExitCode {
    match cli::parse(std::env::args_os()) {
        Ok(cli) => commands::run(cli),
        Err(CliExit::Text(text)) => {
            // Standard output may be closed.
            let _ = output::print_own(text.as_bytes());
            ExitCode::SUCCESS
        }
        Err(CliExit::Usage(line)) => {
            output::warn(line);
            ExitCode::from(commands::EXIT_USAGE)
        }
    }
}
