//! Kinds of bus: one row each, of which parsing, opening, help, completion and errors are made.
//!
//! Does not know what a kind's arguments mean: its module does.

use super::Options;
use super::clock::Clock;
use crate::frame::BusIndex;
use std::fmt;
use std::io;

/// A kind of bus, as far as texts need it.
#[derive(Debug, PartialEq, Eq)]
pub struct BusKind {
    /// What stands before the colon; empty for interface names, `-` for standard input.
    pub scheme: &'static str,
    /// Its forms in help: `slcan:DEVICE@RATE`.
    pub forms: &'static [&'static str],
    /// A complete argument.
    pub example: &'static str,
    /// What the example is, if the example does not show it.
    pub note: Option<&'static str>,
    /// Frames can be sent to another program or node.
    pub can_send: bool,
}

/// Why a BUS argument cannot be used: cause and remedy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpecError {
    cause: String,
    remedy: Option<String>,
}

impl SpecError {
    /// Without a remedy that would fit.
    pub(super) fn new(cause: String) -> Self {
        Self { cause, remedy: None }
    }

    /// The remedy names what to write instead.
    pub(super) fn with_use(cause: String, remedy: &str) -> Self {
        Self { cause, remedy: Some(format!("use {remedy}")) }
    }

    /// The remedy names what to write if the text means something else.
    pub(super) fn with_remedy(cause: String, remedy: String) -> Self {
        Self { cause, remedy: Some(remedy) }
    }

    /// A part of the argument is missing.
    pub(super) fn incomplete(kind: &BusKind) -> Self {
        Self::with_use(format!("{}: incomplete", kind.scheme), kind.example)
    }
}

impl std::error::Error for SpecError {}

/// `CAUSE; REMEDY`.
impl fmt::Display for SpecError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.cause)?;
        self.remedy.as_ref().map_or(Ok(()), |remedy| write!(f, "; {remedy}"))
    }
}

/// Why a bus cannot be opened. An interface that is down or does not exist yet is a status, not an
/// error.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The log cannot be opened.
    #[error("cannot read {path}: {cause}")]
    Log {
        /// The log.
        path: String,
        /// The error of the file system.
        cause: io::Error,
    },
    /// The scenario of a simulated bus cannot be used.
    #[error("{0}")]
    Scenario(String),
    /// The system has no thread or no pipe left.
    #[error("cannot open {name}: {cause}")]
    Resources {
        /// The bus.
        name: String,
        /// The error of the system.
        cause: io::Error,
    },
}

/// How a bus is to be opened, whatever its kind.
#[derive(Clone, Debug)]
pub(super) struct OpenRequest {
    /// The BUS argument.
    pub name: String,
    /// The number of its frames.
    pub index: BusIndex,
    pub clock: Clock,
    pub options: Options,
}
