//! The commands of the command line: the same app, with a screen or without.
//!
//! Each returns the exit code that scripts rely on, or a [`Failure`] whose text names the cause and
//! the remedy. Does not parse arguments.

mod apply;
mod catalogue;
mod check;
mod convert;
mod device;
mod diff;
mod export;
#[cfg(feature = "fleet")]
mod fleet;
#[cfg(feature = "fleet")]
mod fleet_check;
#[cfg(feature = "fleet")]
mod fleet_screen;
mod gate;
mod generated_files;
mod guide;
mod headless;
mod init;
mod kit;
mod learn;
mod log;
mod one_bus;
mod open;
pub mod output;
mod profile;
mod project;
mod proof_progress;
mod proof_report;
mod prove;
#[cfg(feature = "fleet")]
mod publish;
#[cfg(feature = "fleet")]
pub mod published;
mod report;
mod scan;
mod send;
mod simulate;
mod speed;
mod test_report;
mod tui;
mod watch;

use crate::app::DeviceCommand;
use crate::cli::{self, Cli, Command};
use crate::diagnostic::Diagnostic;
use device::DeviceTask;
use output::print_own;
#[cfg(feature = "fleet")]
use std::io::IsTerminal as _;
use std::process::ExitCode;

/// Success: no findings that count.
pub const EXIT_OK: u8 = 0;
/// Findings that count.
pub const EXIT_FINDINGS: u8 = 1;
/// Wrong arguments.
pub const EXIT_USAGE: u8 = 2;
/// A bus or a file cannot be used.
pub const EXIT_UNUSABLE: u8 = 3;
/// Stopped by SIGINT or SIGTERM.
pub const EXIT_INTERRUPTED: u8 = 130;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Wrong arguments.
    #[error("{0}")]
    Usage(String),
    /// A bus or a file cannot be used.
    #[error("{0}")]
    Unusable(String),
    /// Standard output is closed, as by `head`: not an error.
    #[error("standard output is closed")]
    Closed,
    /// The terminal or the system failed.
    #[error("{0:#}")]
    System(#[from] anyhow::Error),
}

impl From<Diagnostic> for Failure {
    fn from(fault: Diagnostic) -> Self {
        Failure::Unusable(fault.to_string())
    }
}

/// Runs a command. Prints an error on standard error in one line, followed by the wrong line of an
/// invalid file.
pub fn run(cli: Cli) -> ExitCode {
    let result = match cli.command {
        None => tui::ui(&cli.session, cli.speed, &cli.screen),
        Some(Command::Demo { system, session, screen }) => tui::demo(&system, &session, &screen),
        Some(Command::Scan(scan)) => scan::run(&scan),
        Some(Command::Check(check)) => check::run(&check),
        Some(Command::Watch(watch)) => watch::run(&watch),
        #[cfg(feature = "fleet")]
        Some(Command::Publish(args)) => publish::run(&args),
        #[cfg(feature = "fleet")]
        Some(Command::Fleet(args)) if !args.json && std::io::stdout().is_terminal() => {
            fleet_screen::run(&args)
        }
        #[cfg(feature = "fleet")]
        Some(Command::Fleet(args)) => fleet::run(&args),
        Some(Command::Diff(diff)) => diff::run(&diff),
        Some(Command::Log(log)) => log::run(&log),
        Some(Command::Convert(args)) => convert::run(&args),
        Some(Command::Sim(args)) => simulate::run(&args),
        Some(Command::Identify(args)) => {
            device::run(&args, DeviceTask::Send(DeviceCommand::Identify))
        }
        Some(Command::Mode { device, mode }) => {
            device::run(&device, DeviceTask::Send(DeviceCommand::Mode(mode)))
        }
        Some(Command::Restart(args)) => {
            device::run(&args, DeviceTask::Send(DeviceCommand::Restart))
        }
        Some(Command::Address { device, setting }) => device::set_address(&device, &setting),
        Some(Command::Bitrate { device, setting }) => device::set_bitrate(&device, &setting),
        Some(Command::Apply(args)) => apply::run(&args),
        Some(Command::Descriptor(args)) => device::run(&args, DeviceTask::Read(None)),
        Some(Command::Send(args)) => send::run(&args),
        Some(Command::Prove(args)) => prove::run(&args),
        Some(Command::Speed(speed)) => speed::run(&speed),
        Some(Command::Completions { shell }) => {
            print_own(&cli::completions(shell)).map(|()| EXIT_OK)
        }
        Some(Command::Man { name }) => guide::man(name.as_deref()),
        Some(Command::Help { name }) => guide::help(name.as_deref()),
        Some(Command::Profile { command }) => profile::run(command.as_ref()),
        Some(Command::Init(args)) => init::run(&args),
        Some(Command::Catalogue(args)) => catalogue::run(&args),
        Some(Command::Kit(args)) => kit::run(&args),
        Some(Command::Schema) => print_own(crate::document::SCHEMA.as_bytes()).map(|()| EXIT_OK),
    };
    ExitCode::from(match result {
        Ok(code) => code,
        Err(Failure::Closed) => EXIT_OK,
        Err(failure) => {
            output::warn(&failure);
            match failure {
                Failure::Usage(_) => EXIT_USAGE,
                _ => EXIT_UNUSABLE,
            }
        }
    })
}
