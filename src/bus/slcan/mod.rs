//! `slcan:DEVICE`: a CAN adapter at a serial port, with Lawicel's ASCII protocol.
//!
//! `address` is the BUS argument, this file the serial port, `protocol` the state machine, `line` the
//! syntax. A port that does not exist, is in use, or is unplugged is a status, and is waited for.

mod address;
mod line;
mod protocol;

pub use address::SlcanAddress;
pub(super) use address::{KIND, normalised, parse, text};
pub(super) use line::rate_code;
pub use protocol::{Slcan, SlcanSettings};

use super::faults::{cannot_open, in_use, not_found, unplugged};
use super::kind::OpenRequest;
use super::port::Port;
use super::remote::Backoff;
use super::remote::stream::{self, Endpoint, Unavailable};
use crate::diagnostic::Diagnostic;
use crate::status::{BusStatus, Link, RateSearch};
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg, OFlag};
use nix::sys::termios::{
    BaudRate, ControlFlags, FlushArg, SetArg, cfgetospeed, cfmakeraw, cfsetspeed, tcflush,
    tcgetattr, tcsetattr,
};
use nix::unistd::{Gid, Group};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How often to try to open a port that is not available.
const RETRY_PERIOD: Duration = Duration::from_secs(1);
/// Baud rate of most adapters with a UART, as in python-can. USB adapters ignore it.
const BAUD_RATE: BaudRate = BaudRate::B115200;

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

/// A serial port, locked against other programs.
struct LockedPort(Flock<File>);

impl Endpoint for SerialPort {
    type Stream = LockedPort;

    fn open(&self) -> Result<LockedPort, Unavailable> {
        let port = OpenOptions::new()
            .read(true)
            .write(true)
            // No wait for a carrier; not the controlling terminal.
            .custom_flags((OFlag::O_NONBLOCK | OFlag::O_NOCTTY | OFlag::O_CLOEXEC).bits())
            .open(&self.device)
            .map_err(|error| self.unavailable(&error))?;
        let mut settings = tcgetattr(&port).map_err(|_| self.unavailable(&Errno::ENOTTY.into()))?;
        let port = Flock::lock(port, FlockArg::LockExclusiveNonblock)
            .map_err(|_| self.unavailable(&Errno::EBUSY.into()))?;
        let failed = |error: Errno| self.unavailable(&error.into());
        let port = LockedPort(port);
        // For programs that ignore the lock.
        rustix::termios::ioctl_tiocexcl(&port)
            .map_err(|error| failed(Errno::from_raw(error.raw_os_error())))?;
        cfmakeraw(&mut settings);
        // No modem lines, no flow control, one stop bit.
        settings.control_flags |= ControlFlags::CLOCAL | ControlFlags::CREAD;
        settings.control_flags &= !(ControlFlags::CRTSCTS | ControlFlags::CSTOPB);
        // 9600 is the kernel's default. Another speed was set on purpose, for example by stty.
        if cfgetospeed(&settings) == BaudRate::B9600 {
            cfsetspeed(&mut settings, BAUD_RATE).map_err(failed)?;
        }
        tcsetattr(&port, SetArg::TCSANOW, &settings).map_err(failed)?;
        // Received before the port was opened: may begin inside a line.
        tcflush(&port, FlushArg::TCIFLUSH).map_err(failed)?;
        Ok(port)
    }

    fn broken_off(&self) -> Unavailable {
        Unavailable { link: Link::Unplugged, fault: unplugged(self.device.display()) }
    }

    fn close(&self, stream: LockedPort, stuck: bool) {
        if stuck {
            // Otherwise close(2) waits up to 30 s for the adapter to accept it.
            let _ = tcflush(&stream, FlushArg::TCOFLUSH);
        }
    }
}

impl SerialPort {
    fn unavailable(&self, error: &io::Error) -> Unavailable {
        let name = self.device.display();
        let errno = error.raw_os_error().map_or(Errno::UnknownErrno, Errno::from_raw);
        let (link, fault) = match errno {
            Errno::ENOENT | Errno::ENODEV | Errno::ENXIO | Errno::ENOTDIR => {
                (Link::Missing, not_found(name, &serial_ports()))
            }
            Errno::EACCES | Errno::EPERM => (Link::Down, not_permitted(&self.device)),
            Errno::EBUSY => (Link::Down, in_use(name)),
            Errno::EISDIR | Errno::ENOTTY => {
                (Link::NotCan, Diagnostic::new(format!("{name} is not a serial port")))
            }
            // The other end of a pty is closed.
            Errno::EIO => (Link::Missing, Diagnostic::new(format!("{name}: no device connected"))),
            _ => (Link::Down, cannot_open(name, error)),
        };
        Unavailable { link, fault }
    }
}

fn not_permitted(device: &Path) -> Diagnostic {
    let name = device.display();
    let group = fs::metadata(device).ok().map(|it| Gid::from_raw(it.gid()));
    let group = group.filter(|gid| gid.as_raw() != 0).and_then(|gid| Group::from_gid(gid).ok()?);
    Diagnostic::new(format!("no permission for {name}")).with_remedy(match group {
        Some(group) => format!("sudo usermod -aG {} \"$USER\", then log in again", group.name),
        None => format!("sudo chmod a+rw {name}"),
    })
}

/// The serial ports of this machine that are usually adapters.
fn serial_ports() -> Vec<String> {
    let names = fs::read_dir("/dev").into_iter().flatten();
    let names = names.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut ports: Vec<String> = names
        .filter(|name| name.starts_with("ttyACM") || name.starts_with("ttyUSB"))
        .map(|name| format!("/dev/{name}"))
        .collect();
    ports.sort();
    ports
}

/// Ends the exclusive mode, which a pty would keep while its other end is open.
impl Drop for LockedPort {
    fn drop(&mut self) {
        let _ = rustix::termios::ioctl_tiocnxcl(&*self.0);
    }
}

impl AsFd for LockedPort {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

impl Read for LockedPort {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        (&*self.0).read(buffer)
    }
}

impl Write for LockedPort {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        (&*self.0).write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
