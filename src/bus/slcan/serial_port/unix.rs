//! The serial port by termios.

use super::PortFault;
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg, OFlag};
use nix::sys::termios::{
    BaudRate, ControlFlags, FlushArg, SetArg, cfmakeraw, cfsetspeed, tcflush, tcgetattr, tcsetattr,
};
use nix::unistd::{Gid, Group};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// Baud rate of most adapters with a UART, as in python-can. USB adapters ignore it.
const BAUD_RATE: BaudRate = BaudRate::B115200;
/// The system's default.
const DEFAULT_SPEED: u32 = 9_600;

/// A serial port, locked against other programs.
pub(in crate::bus::slcan) struct LockedPort(Flock<File>);

impl LockedPort {
    /// Opens it raw, and discards what was received before.
    ///
    /// # Errors
    ///
    /// Those of the system.
    pub(in crate::bus::slcan) fn open(device: &Path) -> io::Result<Self> {
        let port = OpenOptions::new()
            .read(true)
            .write(true)
            // No wait for a carrier; not the controlling terminal.
            .custom_flags((OFlag::O_NONBLOCK | OFlag::O_NOCTTY | OFlag::O_CLOEXEC).bits())
            .open(device)?;
        let mut settings = tcgetattr(&port).map_err(|_| Errno::ENOTTY)?;
        let port = Flock::lock(port, FlockArg::LockExclusiveNonblock).map_err(|_| Errno::EBUSY)?;
        let port = LockedPort(port);
        // For programs that ignore the lock.
        rustix::termios::ioctl_tiocexcl(&port)?;
        cfmakeraw(&mut settings);
        // No modem lines, no flow control, one stop bit.
        settings.control_flags |= ControlFlags::CLOCAL | ControlFlags::CREAD;
        settings.control_flags &= !(ControlFlags::CRTSCTS | ControlFlags::CSTOPB);
        // Another speed than the default was set on purpose, for example by stty.
        if rustix::termios::tcgetattr(&port)?.output_speed() == DEFAULT_SPEED {
            cfsetspeed(&mut settings, BAUD_RATE)?;
        }
        tcsetattr(&port, SetArg::TCSANOW, &settings)?;
        // Received before the port was opened: may begin inside a line.
        tcflush(&port, FlushArg::TCIFLUSH)?;
        Ok(port)
    }

    /// Discards what was not sent yet.
    pub(in crate::bus::slcan) fn discard_output(&self) {
        let _ = tcflush(self, FlushArg::TCOFLUSH);
    }
}

/// Returns what an error of [`LockedPort::open`] means.
pub(in crate::bus::slcan) fn fault_of(error: &io::Error) -> PortFault {
    match error.raw_os_error().map_or(Errno::UnknownErrno, Errno::from_raw) {
        Errno::ENOENT | Errno::ENODEV | Errno::ENXIO | Errno::ENOTDIR => PortFault::Missing,
        Errno::EACCES | Errno::EPERM => PortFault::NotPermitted,
        Errno::EBUSY => PortFault::InUse,
        Errno::EISDIR | Errno::ENOTTY => PortFault::NotSerial,
        // The other end of a pty is closed.
        Errno::EIO => PortFault::Unconnected,
        _ => PortFault::Other,
    }
}

/// The command that gives the user access.
pub(in crate::bus::slcan) fn permission_remedy(device: &Path) -> String {
    let name = device.display();
    // Other systems have no such groups.
    let metadata = fs::metadata(device).ok().filter(|_| cfg!(target_os = "linux"));
    let group = metadata.map(|it| Gid::from_raw(it.gid()));
    let group = group.filter(|gid| gid.as_raw() != 0).and_then(|gid| Group::from_gid(gid).ok()?);
    match group {
        Some(group) => format!("sudo usermod -aG {} \"$USER\", then log in again", group.name),
        None => format!("sudo chmod a+rw {name}"),
    }
}

/// The serial ports of this machine that can be adapters, sorted by name.
pub fn serial_ports() -> Vec<PathBuf> {
    ports_in(Path::new("/dev"))
}

fn ports_in(folder: &Path) -> Vec<PathBuf> {
    let names = fs::read_dir(folder).into_iter().flatten();
    let names = names.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut ports: Vec<PathBuf> =
        names.filter(|name| is_usb_port(name)).map(|name| folder.join(name)).collect();
    ports.sort();
    ports
}

/// Returns true for the names of serial ports on USB.
#[cfg(not(target_os = "macos"))]
fn is_usb_port(name: &str) -> bool {
    name.starts_with("ttyACM") || name.starts_with("ttyUSB")
}

/// Returns true for the names of serial ports on USB. The `tty.` of the same name waits for a carrier.
#[cfg(target_os = "macos")]
fn is_usb_port(name: &str) -> bool {
    let rest = name.strip_prefix("cu.");
    rest.is_some_and(|it| ["usb", "wchusb", "SLAB_USB"].iter().any(|kind| it.starts_with(kind)))
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

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn only_ports_on_usb_are_listed_in_order() {
        let dev = tempfile::tempdir().unwrap();
        for name in ["ttyUSB1", "ttyACM0", "ttyS0", "tty0", "ttyUSB0"] {
            fs::write(dev.path().join(name), "").unwrap();
        }
        let expected = ["ttyACM0", "ttyUSB0", "ttyUSB1"].map(|name| dev.path().join(name));
        assert_eq!(ports_in(dev.path()), expected);
    }
}
