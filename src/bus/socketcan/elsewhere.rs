//! A system without SocketCAN: it has no CAN interfaces, and opens none.

use super::CanInterface;
use crate::bus::faults::TuneError;
use crate::bus::kind::OpenRequest;
use crate::bus::port::Port;
use crate::diagnostic::Diagnostic;

/// The CAN interfaces of this machine: none.
pub fn interfaces() -> Vec<CanInterface> {
    Vec::new()
}

/// Returns true if a word names an interface: none is a CAN interface here.
pub fn interface_exists(_: &str) -> bool {
    false
}

/// Names what to use instead.
pub(in crate::bus) fn open(interface: &str, _: OpenRequest) -> Result<Port, Diagnostic> {
    Err(without_socketcan(interface))
}

/// A controller; there is none.
#[derive(Debug)]
pub(in crate::bus) enum CanController {}

impl CanController {
    pub(in crate::bus) fn of(name: &str) -> Result<Self, TuneError> {
        Err(TuneError::Failed(without_socketcan(name)))
    }

    pub(in crate::bus) fn name(&self) -> &str {
        match *self {}
    }

    pub(in crate::bus) fn bitrate(&self) -> Option<u32> {
        match *self {}
    }

    pub(in crate::bus) fn listened_only(&self) -> bool {
        match *self {}
    }

    pub(in crate::bus) fn set(&mut self, _: u32, _: bool) -> Result<(), TuneError> {
        match *self {}
    }

    pub(in crate::bus) fn keep(&mut self) {
        match *self {}
    }

    pub(in crate::bus) fn restore(&mut self) -> Result<(), TuneError> {
        match *self {}
    }
}

fn without_socketcan(interface: &str) -> Diagnostic {
    Diagnostic::new(format!("{interface}: SocketCAN needs Linux"))
        .with_remedy("use slcan:PORT, socketcand://HOST/BUS or udp:GROUP")
}
