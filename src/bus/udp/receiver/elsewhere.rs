//! The receiving socket without timestamps and without a drop counter.

use super::super::sockets::{MulticastGroup, ReceivedDatagram};
use socket2::{InterfaceIndexOrAddress, SockAddr, Socket};
use std::io::{self, ErrorKind};
use std::net::{IpAddr, SocketAddr, UdpSocket};

/// Requested receive buffer in bytes; the system may grant less.
const RECEIVE_BUFFER: usize = 4 << 20;

/// A socket that is a member of the group.
#[derive(Debug)]
pub(in crate::bus::udp) struct Receiver {
    socket: UdpSocket,
}

/// The number of a network interface.
#[cfg(unix)]
pub(in crate::bus::udp) fn interface_index(name: &str) -> io::Result<u32> {
    Ok(nix::net::if_::if_nametoindex(name)?)
}

/// The number of a network interface: its name is that number, as `netsh` lists it.
#[cfg(not(unix))]
pub(in crate::bus::udp) fn interface_index(name: &str) -> io::Result<u32> {
    name.parse().map_err(|_| ErrorKind::NotFound.into())
}

/// Returns true if an error means that the interface does not exist, or has no multicast.
#[cfg(unix)]
pub(in crate::bus::udp) fn is_missing_interface(error: &io::Error) -> bool {
    matches!(error.raw_os_error(), Some(nix::libc::ENODEV | nix::libc::ENXIO))
}

/// Returns true if an error means that the interface does not exist: it has no number.
#[cfg(not(unix))]
pub(in crate::bus::udp) fn is_missing_interface(error: &io::Error) -> bool {
    error.kind() == ErrorKind::NotFound
}

/// Returns true if an error means that the send buffer is full.
#[cfg(unix)]
pub(in crate::bus::udp) fn has_no_room(error: &io::Error) -> bool {
    error.kind() == ErrorKind::WouldBlock || error.raw_os_error() == Some(nix::libc::ENOBUFS)
}

/// Returns true if an error means that the send buffer is full (WSAENOBUFS).
#[cfg(not(unix))]
pub(in crate::bus::udp) fn has_no_room(error: &io::Error) -> bool {
    error.kind() == ErrorKind::WouldBlock || error.raw_os_error() == Some(10_055)
}

/// The command that lists the interfaces.
pub(in crate::bus::udp) const INTERFACES_COMMAND: &str =
    if cfg!(windows) { "netsh interface ipv4 show interfaces" } else { "ifconfig -l" };

/// The way out of a group without a route.
pub(in crate::bus::udp) fn route_remedy(group: IpAddr, interface: Option<&str>) -> String {
    let name = interface.unwrap_or(if cfg!(windows) { "7" } else { "en0" });
    format!("name an interface: udp:{group}%{name}; list them: {INTERFACES_COMMAND}")
}

/// Makes an IPv4 socket send through an interface.
#[cfg(unix)]
pub(in crate::bus::udp) fn send_through(socket: &Socket, _: &str, index: u32) -> io::Result<()> {
    socket.bind_device_by_index_v4(std::num::NonZeroU32::new(index))
}

/// Makes an IPv4 socket send through an interface: an address that begins with 0 is its number.
#[cfg(not(unix))]
pub(in crate::bus::udp) fn send_through(socket: &Socket, _: &str, index: u32) -> io::Result<()> {
    socket.set_multicast_if_v4(&std::net::Ipv4Addr::from(index))
}

impl Receiver {
    /// Joins the group, on the interface of this number; 0: selected by the system's routes.
    pub(in crate::bus::udp) fn open(group: &MulticastGroup, index: u32) -> io::Result<Self> {
        let socket = group.socket()?;
        // Without these, python-can or another descan cannot bind the port.
        socket.set_reuse_address(true)?;
        #[cfg(unix)]
        socket.set_reuse_port(true)?;
        // A smaller buffer is no reason to fail.
        let _ = socket.set_recv_buffer_size(RECEIVE_BUFFER);
        socket.bind(&SockAddr::from(SocketAddr::new(bound_address(group.address), group.port)))?;
        match &group.address {
            IpAddr::V4(address) => {
                socket.join_multicast_v4_n(address, &InterfaceIndexOrAddress::Index(index))?;
            }
            IpAddr::V6(address) => socket.join_multicast_v6(address, index)?,
        }
        Ok(Self { socket: socket.into() })
    }

    /// Receives the next datagram; `None` if none is waiting.
    pub(in crate::bus::udp) fn receive(
        &mut self,
        buffer: &mut [u8],
    ) -> io::Result<Option<ReceivedDatagram>> {
        let received = |len, is_cut, from: Option<SocketAddr>| {
            let from = from.map(|it| (it.ip(), it.port()));
            Ok(Some(ReceivedDatagram { len, is_cut, from, stamp_micros: None }))
        };
        match self.socket.recv_from(buffer) {
            // The buffer is longer than any frame: a full one is a cut datagram.
            Ok((len, from)) => received(len, len == buffer.len(), Some(from)),
            Err(error) if error.raw_os_error() == Some(TOO_LONG) => received(0, true, None),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Returns the datagrams lost in the system's receive buffer: they are not known.
    #[expect(clippy::unused_self, reason = "Linux counts them")]
    pub(in crate::bus::udp) fn drops(&self) -> u64 {
        0
    }
}

#[cfg(unix)]
impl std::os::fd::AsFd for Receiver {
    fn as_fd(&self) -> std::os::fd::BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

/// WSAEMSGSIZE: Windows reports a datagram that is longer than the buffer as an error. The number is
/// not one of a Unix error.
const TOO_LONG: i32 = 10_040;

/// The address that the receiving socket is bound to. Bound to the group, it does not receive other
/// datagrams to this port; Windows binds only to addresses of the machine.
fn bound_address(group: IpAddr) -> IpAddr {
    match group {
        IpAddr::V4(_) if cfg!(windows) => std::net::Ipv4Addr::UNSPECIFIED.into(),
        IpAddr::V6(_) if cfg!(windows) => std::net::Ipv6Addr::UNSPECIFIED.into(),
        group => group,
    }
}
