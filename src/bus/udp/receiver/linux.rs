//! The receiving socket with the kernel's timestamps and drop counter.

use super::super::sockets::{MulticastGroup, ReceivedDatagram};
use nix::cmsg_space;
use nix::net::if_::if_nametoindex;
use nix::sys::socket::{
    ControlMessageOwned, MsgFlags, RecvMsg, SockaddrStorage, recvmsg, setsockopt, sockopt,
};
use nix::sys::time::TimeSpec;
use socket2::{InterfaceIndexOrAddress, SockAddr, Socket};
use std::io::{self, ErrorKind, IoSliceMut};
use std::net::{IpAddr, SocketAddr};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};

/// Requested receive buffer in bytes; without CAP_NET_ADMIN the kernel may grant less.
const RECEIVE_BUFFER: usize = 4 << 20;

/// A socket that is a member of the group.
#[derive(Debug)]
pub(in crate::bus::udp) struct Receiver {
    socket: Socket,
    last_drops: u32,
    drops: u64,
}

/// The number of a network interface.
pub(in crate::bus::udp) fn interface_index(name: &str) -> io::Result<u32> {
    Ok(if_nametoindex(name)?)
}

/// Returns true if an error means that the interface does not exist, or has no multicast.
pub(in crate::bus::udp) fn is_missing_interface(error: &io::Error) -> bool {
    matches!(error.raw_os_error(), Some(nix::libc::ENODEV | nix::libc::ENXIO))
}

/// Returns true if an error means that the send buffer is full.
pub(in crate::bus::udp) fn has_no_room(error: &io::Error) -> bool {
    error.kind() == ErrorKind::WouldBlock || error.raw_os_error() == Some(nix::libc::ENOBUFS)
}

/// The command that lists the interfaces.
pub(in crate::bus::udp) const INTERFACES_COMMAND: &str = "ip -br link";

/// The way out of a group without a route.
pub(in crate::bus::udp) fn route_remedy(group: IpAddr, interface: Option<&str>) -> String {
    let name = interface.unwrap_or("eth0");
    format!("sudo ip route add {group} dev {name}, or name an interface: udp:{group}%{name}")
}

/// Makes an IPv4 socket send through an interface.
pub(in crate::bus::udp) fn send_through(socket: &Socket, name: &str, _: u32) -> io::Result<()> {
    socket.bind_device(Some(name.as_bytes()))
}

impl Receiver {
    /// Joins the group, on the interface of this number; 0: selected by the system's routes.
    pub(in crate::bus::udp) fn open(group: &MulticastGroup, index: u32) -> io::Result<Self> {
        let socket = group.socket()?;
        // Without these, python-can or another descan cannot bind the port.
        socket.set_reuse_address(true)?;
        socket.set_reuse_port(true)?;
        setsockopt(&socket, sockopt::ReceiveTimestampns, &true)?;
        setsockopt(&socket, sockopt::RxqOvfl, &1)?;
        setsockopt(&socket, sockopt::RcvBufForce, &RECEIVE_BUFFER)
            .or_else(|_| setsockopt(&socket, sockopt::RcvBuf, &RECEIVE_BUFFER))?;
        // Bound to the group, it does not receive other datagrams to this port.
        socket.bind(&SockAddr::from(SocketAddr::new(group.address, group.port)))?;
        match &group.address {
            IpAddr::V4(address) => {
                socket.set_multicast_all_v4(false)?;
                socket.join_multicast_v4_n(address, &InterfaceIndexOrAddress::Index(index))?;
            }
            IpAddr::V6(address) => socket.join_multicast_v6(address, index)?,
        }
        Ok(Self { socket, last_drops: 0, drops: 0 })
    }

    /// Receives the next datagram; `None` if none is waiting.
    pub(in crate::bus::udp) fn receive(
        &mut self,
        buffer: &mut [u8],
    ) -> io::Result<Option<ReceivedDatagram>> {
        let mut control = cmsg_space!(TimeSpec, u32);
        let mut slices = [IoSliceMut::new(buffer)];
        let fd = self.socket.as_raw_fd();
        let flags = MsgFlags::MSG_DONTWAIT;
        let message = match recvmsg::<SockaddrStorage>(fd, &mut slices, Some(&mut control), flags) {
            Ok(message) => message,
            Err(error) => {
                let error = io::Error::from(error);
                return if error.kind() == ErrorKind::WouldBlock { Ok(None) } else { Err(error) };
            }
        };
        let stamp_micros = self.read_control(&message);
        Ok(Some(ReceivedDatagram {
            len: message.bytes,
            is_cut: message.flags.contains(MsgFlags::MSG_TRUNC),
            from: message.address.as_ref().and_then(address),
            stamp_micros,
        }))
    }

    /// Returns the datagrams lost in the kernel receive buffer, as last reported by the kernel.
    pub(in crate::bus::udp) fn drops(&self) -> u64 {
        self.drops
    }

    fn read_control(&mut self, message: &RecvMsg<'_, '_, SockaddrStorage>) -> Option<u64> {
        let mut stamp = None;
        for control in message.cmsgs().into_iter().flatten() {
            match control {
                ControlMessageOwned::ScmTimestampns(time) => {
                    let micros = time.tv_sec() * 1_000_000 + time.tv_nsec() / 1_000;
                    stamp = u64::try_from(micros).ok();
                }
                ControlMessageOwned::RxqOvfl(count) => {
                    self.drops += u64::from(count.wrapping_sub(self.last_drops));
                    self.last_drops = count;
                }
                _ => {}
            }
        }
        stamp
    }
}

impl AsFd for Receiver {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

fn address(from: &SockaddrStorage) -> Option<(IpAddr, u16)> {
    if let Some(from) = from.as_sockaddr_in() {
        return Some((IpAddr::V4(from.ip()), from.port()));
    }
    from.as_sockaddr_in6().map(|from| (IpAddr::V6(from.ip()), from.port()))
}
