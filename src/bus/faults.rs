//! Faults that several kinds of bus have.

use crate::diagnostic::{Diagnostic, without_number};
use std::fmt::Display;
use std::io;

/// An interface or a device does not exist; these others do.
pub(super) fn not_found(name: impl Display, others: &[String]) -> Diagnostic {
    let fault = Diagnostic::new(format!("{name} not found"));
    match others {
        [] => fault.with_remedy("connect the adapter"),
        others => fault.with_remedy(format!("available: {}", others.join(", "))),
    }
}

/// An interface or a device existed and disappeared.
pub(super) fn unplugged(name: impl Display) -> Diagnostic {
    Diagnostic::new(format!("{name} unplugged")).with_remedy("connect it again")
}

/// A device or a port is opened exclusively elsewhere.
pub(super) fn in_use(name: impl Display) -> Diagnostic {
    Diagnostic::new(format!("{name} is in use by another program")).with_remedy("quit that program")
}

/// A node of the way to the bus is silent.
pub(super) fn no_response(name: impl Display) -> Diagnostic {
    Diagnostic::new(format!("no response from {name}"))
}

/// The command that ends bus-off.
pub(super) fn restart_command(interface: &str) -> String {
    format!("sudo ip link set {interface} type can restart")
}

/// A controller takes no part in the bus.
pub(super) fn bus_off(name: impl Display, remedy: impl Into<String>) -> Diagnostic {
    Diagnostic::new(format!("{name} is bus-off")).with_remedy(remedy)
}

/// The system does not open a bus.
pub(super) fn cannot_open(name: impl Display, error: &io::Error) -> Diagnostic {
    Diagnostic::new(format!("cannot open {name}: {}", without_number(error)))
}

/// Why a bus cannot be set to a bit rate.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TuneError {
    /// The bus has no bit rate of its own, or another machine sets it.
    #[error("{0}")]
    NoRate(Diagnostic),
    /// The controller does not support this rate.
    #[error("{0}")]
    NotThisRate(Diagnostic),
    /// Anything else.
    #[error("{0}")]
    Failed(#[from] Diagnostic),
}

impl TuneError {
    pub(super) fn no_rate(name: impl Display) -> Self {
        let fault = Diagnostic::new(format!("{name}: bit rate cannot be set"));
        Self::NoRate(fault.with_remedy("use a controller's interface, such as can0"))
    }

    pub(super) fn not_this_rate(name: impl Display, bitrate: u32) -> Self {
        Self::NotThisRate(Diagnostic::new(format!("{name} does not support {bitrate} bit/s")))
    }
}
