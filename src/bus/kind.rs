//! Kinds of bus: one row each, of which parsing, opening, help, completion and errors are made.
//!
//! Does not know what a kind's arguments mean: its module does.

use super::Options;
use super::clock::Clock;
use crate::diagnostic::Diagnostic;
use crate::frame::BusIndex;

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

impl BusKind {
    /// The fault of an argument of which a part is missing.
    pub(super) fn incomplete(&self) -> Diagnostic {
        let fault = Diagnostic::new(format!("{}: incomplete", self.scheme));
        fault.with_remedy(format!("use {}", self.example))
    }
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
