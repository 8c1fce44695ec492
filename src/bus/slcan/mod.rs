//! `slcan:DEVICE`: a CAN adapter at a serial port, with Lawicel's ASCII protocol.
//!
//! `address` is the BUS argument, `serial_port` the port of each system, `protocol` the state machine,
//! `line` the syntax. A port that does not exist, is in use, or is unplugged is a status, and is waited for.

mod address;
mod line;
mod protocol;
mod serial_port;

pub use address::SlcanAddress;
pub(super) use address::{KIND, normalised, parse, text};
pub(super) use line::rate_code;
pub use protocol::{Slcan, SlcanSettings};
pub use serial_port::serial_ports;

use super::faults::{cannot_open, in_use, not_found, unplugged};
use super::kind::OpenRequest;
use super::port::Port;
use super::remote::Backoff;
use super::remote::stream::{self, Endpoint, Unavailable};
use crate::diagnostic::Diagnostic;
use crate::status::{BusStatus, Link, RateSearch};
use serial_port::{LockedPort, PortFault, fault_of, permission_remedy};
use std::io;
use std::path::PathBuf;
use std::time::Duration;

/// How often to try to open a port that is not available.
const RETRY_PERIOD: Duration = Duration::from_secs(1);

/// Opens the adapter; the status is delivered later.
pub(super) fn open(address: &SlcanAddress, request: OpenRequest) -> Result<Port, Diagnostic> {
    let SlcanAddress { device, bitrate, data_bitrate } = address.clone();
    let listen_only = request.options.listen_only;
    let listens_first = request.options.listens_first;
    let settings = SlcanSettings { bitrate, data_bitrate, listen_only, listens_first };
    let protocol = Slcan::new(&device.to_string_lossy(), settings);
    let status = BusStatus {
        bitrate,
        rate_search: RateSearch::WhenClosed,
        listen_only,
        ..BusStatus::default()
    };
    let backoff = Backoff::new(RETRY_PERIOD, RETRY_PERIOD);
    stream::open(request, (SerialPort { device }, protocol), (status, backoff))
}

struct SerialPort {
    device: PathBuf,
}

impl Endpoint for SerialPort {
    type Stream = LockedPort;

    fn open(&self) -> Result<LockedPort, Unavailable> {
        LockedPort::open(&self.device).map_err(|error| self.unavailable(&error))
    }

    fn broken_off(&self) -> Unavailable {
        Unavailable { link: Link::Unplugged, fault: unplugged(self.device.display()) }
    }

    fn close(&self, stream: LockedPort, stuck: bool) {
        if stuck {
            // Otherwise close(2) waits up to 30 s for the adapter to accept it.
            stream.discard_output();
        }
    }
}

impl SerialPort {
    fn unavailable(&self, error: &io::Error) -> Unavailable {
        let name = self.device.display();
        let (link, fault) = match fault_of(error) {
            PortFault::Missing => {
                let ports = serial_ports().into_iter();
                let ports: Vec<_> = ports.map(|port| port.display().to_string()).collect();
                (Link::Missing, not_found(name, &ports))
            }
            PortFault::NotPermitted => (
                Link::Down,
                Diagnostic::new(format!("no permission for {name}"))
                    .with_remedy(permission_remedy(&self.device)),
            ),
            PortFault::InUse => (Link::Down, in_use(name)),
            PortFault::NotSerial => {
                (Link::NotCan, Diagnostic::new(format!("{name} is not a serial port")))
            }
            PortFault::Unconnected => {
                (Link::Missing, Diagnostic::new(format!("{name}: no device connected")))
            }
            PortFault::Other => (Link::Down, cannot_open(name, error)),
        };
        Unavailable { link, fault }
    }
}
