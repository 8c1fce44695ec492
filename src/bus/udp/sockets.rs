//! Sockets of a multicast group: one receives, one sends.
//!
//! The group's datagrams include those sent by descan. They are recognised by their source: the
//! sending socket has an address of this machine and a port of its own. (python-can sends from the
//! group's port.) Does not know the content of datagrams.

use nix::cmsg_space;
use nix::net::if_::if_nametoindex;
use nix::sys::socket::{
    ControlMessageOwned, MsgFlags, RecvMsg, SockaddrStorage, recvmsg, setsockopt, sockopt,
};
use nix::sys::time::TimeSpec;
use socket2::{Domain, InterfaceIndexOrAddress, Protocol, SockAddr, Socket, Type};
use std::io::{self, ErrorKind, IoSliceMut};
use std::net::{IpAddr, SocketAddr};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};

/// Requested receive buffer in bytes; without CAP_NET_ADMIN the kernel may grant less.
const RECEIVE_BUFFER: usize = 4 << 20;

/// A multicast group, its port and its interface.
#[derive(Clone, Debug)]
pub(super) struct MulticastGroup {
    pub(super) address: IpAddr,
    pub(super) port: u16,
    /// Network interface; `None`: selected by the system's routes.
    pub(super) interface: Option<String>,
}

/// A received datagram.
pub(super) struct ReceivedDatagram {
    /// Length in bytes.
    pub(super) len: usize,
    /// True if the datagram was longer than the buffer.
    pub(super) is_cut: bool,
    /// True if descan sent it.
    pub(super) ours: bool,
    /// The kernel's timestamp in Unix microseconds; `None` without one.
    pub(super) stamp_micros: Option<u64>,
}

/// The open sockets.
#[derive(Debug)]
pub(super) struct Sockets {
    rx: Socket,
    tx: Option<Socket>,
    /// Source of the datagrams sent by descan.
    own: Option<SocketAddr>,
    last_drops: u32,
    drops: u64,
}

impl MulticastGroup {
    fn index(&self) -> io::Result<u32> {
        self.interface.as_deref().map_or(Ok(0), |name| Ok(if_nametoindex(name)?))
    }

    fn domain(&self) -> Domain {
        if self.address.is_ipv4() { Domain::IPV4 } else { Domain::IPV6 }
    }

    fn socket(&self) -> io::Result<Socket> {
        let socket = Socket::new(self.domain(), Type::DGRAM, Some(Protocol::UDP))?;
        socket.set_nonblocking(true)?;
        Ok(socket)
    }

    /// Returns a socket connected to the group, so that its source address is known.
    fn tx_socket(&self) -> io::Result<Socket> {
        let socket = self.socket()?;
        let index = self.index()?;
        match self.address {
            IpAddr::V4(_) => {
                socket.set_multicast_ttl_v4(1)?;
                if let Some(name) = &self.interface {
                    socket.bind_device(Some(name.as_bytes()))?;
                }
            }
            IpAddr::V6(_) => {
                socket.set_multicast_hops_v6(1)?;
                if index > 0 {
                    socket.set_multicast_if_v6(index)?;
                }
            }
        }
        socket.connect(&SockAddr::from(SocketAddr::new(self.address, self.port)))?;
        Ok(socket)
    }

    fn rx_socket(&self) -> io::Result<Socket> {
        let socket = self.socket()?;
        // Without these, python-can or another descan cannot bind the port.
        socket.set_reuse_address(true)?;
        socket.set_reuse_port(true)?;
        setsockopt(&socket, sockopt::ReceiveTimestampns, &true)?;
        setsockopt(&socket, sockopt::RxqOvfl, &1)?;
        setsockopt(&socket, sockopt::RcvBufForce, &RECEIVE_BUFFER)
            .or_else(|_| setsockopt(&socket, sockopt::RcvBuf, &RECEIVE_BUFFER))?;
        // Bound to the group, it does not receive other datagrams to this port.
        socket.bind(&SockAddr::from(SocketAddr::new(self.address, self.port)))?;
        let index = self.index()?;
        match &self.address {
            IpAddr::V4(address) => {
                socket.set_multicast_all_v4(false)?;
                socket.join_multicast_v4_n(address, &InterfaceIndexOrAddress::Index(index))?;
            }
            IpAddr::V6(address) => socket.join_multicast_v6(address, index)?,
        }
        Ok(socket)
    }
}

impl Sockets {
    /// Joins the group; with `sends`, also opens the sending socket.
    pub(super) fn open(group: &MulticastGroup, sends: bool) -> io::Result<Self> {
        let tx = group.tx_socket()?;
        let own = tx.local_addr()?.as_socket();
        let rx = group.rx_socket()?;
        let tx = sends.then_some(tx);
        Ok(Self { rx, own: own.filter(|_| sends), tx, last_drops: 0, drops: 0 })
    }

    /// Checks that the group is reachable from the same address as before.
    ///
    /// # Errors
    ///
    /// The group is not reachable, or only from another address.
    pub(super) fn check(&self, group: &MulticastGroup) -> io::Result<()> {
        let now = group.tx_socket()?.local_addr()?.as_socket().map(|it| it.ip());
        match self.own.map(|it| it.ip()) {
            Some(own) if now != Some(own) => Err(ErrorKind::AddrNotAvailable.into()),
            _ => Ok(()),
        }
    }

    /// Sends a datagram to the group.
    pub(super) fn send(&self, datagram: &[u8]) -> io::Result<()> {
        match &self.tx {
            Some(tx) => tx.send(datagram).map(|_| ()),
            None => Err(ErrorKind::PermissionDenied.into()),
        }
    }

    /// Receives the next datagram; `None` if none is waiting.
    pub(super) fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<ReceivedDatagram>> {
        let mut control = cmsg_space!(TimeSpec, u32);
        let mut slices = [IoSliceMut::new(buffer)];
        let fd = self.rx.as_raw_fd();
        let flags = MsgFlags::MSG_DONTWAIT;
        let message = match recvmsg::<SockaddrStorage>(fd, &mut slices, Some(&mut control), flags) {
            Ok(message) => message,
            Err(error) => {
                let error = io::Error::from(error);
                return if error.kind() == ErrorKind::WouldBlock { Ok(None) } else { Err(error) };
            }
        };
        let stamp_micros = self.read_control(&message);
        let from = message.address.as_ref().and_then(address);
        Ok(Some(ReceivedDatagram {
            len: message.bytes,
            is_cut: message.flags.contains(MsgFlags::MSG_TRUNC),
            ours: from.is_some() && from == self.own.map(|own| (own.ip(), own.port())),
            stamp_micros,
        }))
    }

    /// Returns the datagrams lost in the kernel receive buffer, as last reported by the kernel.
    pub(super) fn drops(&self) -> u64 {
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

impl AsFd for Sockets {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.rx.as_fd()
    }
}

fn address(from: &SockaddrStorage) -> Option<(IpAddr, u16)> {
    if let Some(from) = from.as_sockaddr_in() {
        return Some((IpAddr::V4(from.ip()), from.port()));
    }
    from.as_sockaddr_in6().map(|from| (IpAddr::V6(from.ip()), from.port()))
}
