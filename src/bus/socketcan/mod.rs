//! `can0`: a SocketCAN interface of this machine as a port.
//!
//! SocketCAN is a part of Linux. On other systems the argument is read as well, so that a command
//! line means the same everywhere; opening it is an error that names the buses to use instead.
//!
//! ```text
//! name       the BUS argument
//! linux      the port, the interfaces and their controllers
//! elsewhere  the same functions without any interface
//! ```

#[cfg(not(target_os = "linux"))]
mod elsewhere;
#[cfg(target_os = "linux")]
mod linux;
mod name;

#[cfg(not(target_os = "linux"))]
use elsewhere as system;
#[cfg(target_os = "linux")]
use linux as system;

pub use name::is_like_an_interface;
pub(super) use name::{KIND, interface_name, interface_name as parse, normalised, text};
pub(super) use system::{CanController, open};
pub use system::{interface_exists, interfaces};

use crate::diagnostic::Diagnostic;
use crate::status::BusState;

/// A CAN interface of this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CanInterface {
    /// Its name.
    pub name: String,
    /// Up.
    pub up: bool,
    /// Without a controller, as vcan and vxcan.
    pub is_virtual: bool,
    /// Bit/s; `None` if not configured.
    pub bitrate: Option<u32>,
    /// The controller's state.
    pub state: BusState,
}

/// An interface, or something else, is used as a CAN interface.
fn not_can(name: &str) -> Diagnostic {
    Diagnostic::new(format!("{name} is not a CAN interface"))
}
