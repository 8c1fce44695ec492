//! A serial port: opened for descan alone, read and written without blocking.
//!
//! Input: the path of a device. Output: bytes, or an error with its [`PortFault`]. Does not know the
//! protocol of the adapter.

#[cfg(unix)]
mod unix;
#[cfg(windows)]
mod windows;

#[cfg(unix)]
use unix as system;
#[cfg(windows)]
use windows as system;

pub use system::serial_ports;
pub(super) use system::{LockedPort, fault_of, permission_remedy};

/// Why a port cannot be opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PortFault {
    /// There is no such device.
    Missing,
    /// The user may not open it.
    NotPermitted,
    /// Another program has it open.
    InUse,
    /// It is something else.
    NotSerial,
    /// It is there, but nothing is connected to it.
    Unconnected,
    /// Anything else.
    Other,
}
