//! Sockets of a multicast group: one receives, one sends.
//!
//! The group's datagrams include those sent by descan. They are recognised by their source: the
//! sending socket has an address of this machine and a port of its own. (python-can sends from the
//! group's port.) Does not know the content of datagrams.

use super::receiver::{Receiver, interface_index, send_through};
use crate::bus::waker::{WaitSource, Waitable};
use socket2::{Domain, Protocol, SockAddr, Socket, Type};
use std::io::{self, ErrorKind};
use std::net::{IpAddr, SocketAddr};

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
    /// Its source; `None` if it is not known.
    pub(super) from: Option<(IpAddr, u16)>,
    /// The kernel's timestamp in Unix microseconds; `None` without one.
    pub(super) stamp_micros: Option<u64>,
}

/// The open sockets.
#[derive(Debug)]
pub(super) struct Sockets {
    rx: Receiver,
    tx: Option<Socket>,
    /// Source of the datagrams sent by descan.
    own: Option<SocketAddr>,
}

impl MulticastGroup {
    fn index(&self) -> io::Result<u32> {
        self.interface.as_deref().map_or(Ok(0), interface_index)
    }

    fn domain(&self) -> Domain {
        if self.address.is_ipv4() { Domain::IPV4 } else { Domain::IPV6 }
    }

    /// Returns a socket of the group's family, in non-blocking mode.
    pub(super) fn socket(&self) -> io::Result<Socket> {
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
                    send_through(&socket, name, index)?;
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
}

impl Sockets {
    /// Joins the group; with `sends`, also opens the sending socket.
    pub(super) fn open(group: &MulticastGroup, sends: bool) -> io::Result<Self> {
        let tx = group.tx_socket()?;
        let own = tx.local_addr()?.as_socket();
        let rx = Receiver::open(group, group.index()?)?;
        let tx = sends.then_some(tx);
        Ok(Self { rx, own: own.filter(|_| sends), tx })
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
        self.rx.receive(buffer)
    }

    /// Returns true if descan sent the datagram.
    pub(super) fn is_own(&self, datagram: &ReceivedDatagram) -> bool {
        datagram.from.is_some() && datagram.from == self.own.map(|own| (own.ip(), own.port()))
    }

    /// Returns the datagrams lost in the system's receive buffer, as last reported.
    pub(super) fn drops(&self) -> u64 {
        self.rx.drops()
    }

    /// What a thread waits for.
    pub(super) fn wait_source(&self) -> WaitSource<'_> {
        self.rx.wait_source()
    }
}
