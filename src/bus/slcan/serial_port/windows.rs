//! The serial port by the crate `serial2`. Windows opens a port for one program only.

use super::PortFault;
use serial2::{SerialPort, Settings};
use std::io::{self, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Baud rate of most adapters with a UART, as in python-can. USB adapters ignore it.
const BAUD_RATE: u32 = 115_200;
/// Longest wait of a read: the shortest that the system has.
const READ_TIMEOUT: Duration = Duration::from_millis(1);
/// Longest wait of a write; what the adapter did not accept is offered again.
const WRITE_TIMEOUT: Duration = Duration::from_millis(20);
/// ERROR_SEM_TIMEOUT: a port of Bluetooth whose device is away.
const DEVICE_AWAY: i32 = 121;

/// A serial port, opened for this program alone.
pub(in crate::bus::slcan) struct LockedPort(SerialPort);

impl LockedPort {
    /// Opens it raw, and discards what was received before.
    ///
    /// # Errors
    ///
    /// Those of the system.
    pub(in crate::bus::slcan) fn open(device: &Path) -> io::Result<Self> {
        let set_up = |mut settings: Settings| {
            settings.set_raw();
            settings.set_baud_rate(BAUD_RATE)?;
            Ok(settings)
        };
        let mut port = SerialPort::open(device, set_up)?;
        port.set_read_timeout(READ_TIMEOUT)?;
        port.set_write_timeout(WRITE_TIMEOUT)?;
        // Adapters send nothing before these are set; Linux sets them when it opens a port.
        port.set_dtr(true)?;
        port.set_rts(true)?;
        port.discard_input_buffer()?;
        Ok(Self(port))
    }

    /// Discards what was not sent yet.
    pub(in crate::bus::slcan) fn discard_output(&self) {
        let _ = self.0.discard_output_buffer();
    }
}

/// Returns what an error of [`LockedPort::open`] means.
pub(in crate::bus::slcan) fn fault_of(error: &io::Error) -> PortFault {
    match error.kind() {
        ErrorKind::NotFound => PortFault::Missing,
        // Windows rejects a second program so.
        ErrorKind::PermissionDenied => PortFault::InUse,
        ErrorKind::InvalidInput => PortFault::NotSerial,
        _ if error.raw_os_error() == Some(DEVICE_AWAY) => PortFault::Unconnected,
        _ => PortFault::Other,
    }
}

/// What the user can do about access.
pub(in crate::bus::slcan) fn permission_remedy(_: &Path) -> String {
    "quit the program that has it open".to_owned()
}

/// The serial ports of this machine, in the order of their numbers.
pub fn serial_ports() -> Vec<PathBuf> {
    let mut ports = SerialPort::available_ports().unwrap_or_default();
    ports.sort_by_key(|port| (port.as_os_str().len(), port.clone()));
    ports
}

impl Read for LockedPort {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read(buffer).map_err(without_timeout)
    }
}

impl Write for LockedPort {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes).map_err(without_timeout)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A wait that ended is as an operation that would block.
fn without_timeout(error: io::Error) -> io::Error {
    if error.kind() == ErrorKind::TimedOut { ErrorKind::WouldBlock.into() } else { error }
}
