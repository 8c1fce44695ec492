//! udp: the bus of python-can's `udp_multicast`: every frame is a datagram to a multicast group.
//!
//! A group that cannot be reached is a status, and is waited for. `message` is what datagrams say,
//! `sockets` how they come and go.

mod address;
mod message;
mod sockets;

pub use address::UdpAddress;
pub(super) use address::{KIND, parse, text};

use super::clock::{Clock, RxTimestamps};
use super::kind::{OpenError, OpenRequest};
use super::port::{Port, PortShared};
use super::remote::{Backoff, Delivery};
use super::tx_queue::{TxAttempt, TxQueue};
use crate::frame::Frame;
use crate::status::{BusStatus, Link, RateSearch};
use nix::errno::Errno;
use sockets::{MulticastGroup, ReceivedDatagram, Sockets};
use std::io::{self, ErrorKind};
use std::os::fd::AsFd;
use std::sync::Arc;
use std::time::{Duration, Instant as Monotonic};

/// The port that python-can has.
pub(super) const USUAL_PORT: u16 = 43_113;

/// The pause before the first new attempt to reach the group, and the longest.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
const LONGEST_PAUSE: Duration = Duration::from_secs(4);
/// How often to look whether the group is still reached: a network that goes away says nothing.
const LOOK_EVERY: Duration = Duration::from_secs(2);
/// Datagrams that are taken before what is to be sent has its turn.
const BATCH: usize = 256;

/// Opens the bus; its status is known at once.
pub(super) fn open(address: &UdpAddress, request: OpenRequest) -> Result<Port, OpenError> {
    let name = request.name.clone();
    start(address, request).map_err(|cause| OpenError::Resources { name, cause })
}

fn start(address: &UdpAddress, request: OpenRequest) -> io::Result<Port> {
    let OpenRequest { name, index, clock, options } = request;
    let line = Arc::new(PortShared::new()?);
    line.queue.add_name(&name);
    let group = MulticastGroup {
        address: address.group,
        port: address.port.unwrap_or(USUAL_PORT),
        interface: address.interface.clone(),
    };
    let mut bus = Multicast {
        group,
        speaks: !options.listen_only,
        delivery: Delivery::new(Arc::clone(&line), index),
        // Waiting for room would delay receiving.
        tx: TxQueue::new(Arc::clone(&line), Duration::ZERO),
        line: Arc::clone(&line),
        dating: RxTimestamps::new(clock.clone()),
        clock,
        status: BusStatus { fd: true, rate_search: RateSearch::NoRate, ..BusStatus::default() },
        drops_before: 0,
        was_there: false,
    };
    let opened = bus.open();
    let mut port = Port::new(&name, line, options.listen_only);
    port.serve(move |line| {
        if let Err(error) = bus.run(opened) {
            line.queue.finish(Link::Failed, format!("cannot receive from the group: {error}"));
        }
    })?;
    Ok(port)
}

struct Multicast {
    group: MulticastGroup,
    speaks: bool,
    line: Arc<PortShared>,
    delivery: Delivery,
    tx: TxQueue,
    dating: RxTimestamps,
    clock: Clock,
    status: BusStatus,
    /// Kernel drops of sockets that were closed since.
    drops_before: u64,
    was_there: bool,
}

impl Multicast {
    fn run(&mut self, mut opened: Option<Sockets>) -> io::Result<()> {
        let mut backoff = Backoff::new(FIRST_PAUSE, LONGEST_PAUSE);
        while !self.line.is_stopped() {
            if let Some(sockets) = opened.take().or_else(|| self.open()) {
                let since = Monotonic::now();
                self.serve(sockets)?;
                backoff.lasted(since.elapsed());
            }
            let until = Monotonic::now() + backoff.pause();
            while !self.line.is_stopped() && Monotonic::now() < until {
                self.refuse_posted();
                self.line.wait(None, Some(until.saturating_duration_since(Monotonic::now())))?;
            }
        }
        Ok(())
    }

    /// Joins the group if it is to be reached; says in the status if it is not.
    fn open(&mut self) -> Option<Sockets> {
        let opened = Sockets::open(&self.group, self.speaks);
        match opened {
            Ok(sockets) => {
                self.was_there = true;
                (self.status.link, self.status.message) = (Link::Up, None);
                self.delivery.deliver_status(&self.status);
                Some(sockets)
            }
            Err(error) => {
                self.report_unavailable(&error);
                None
            }
        }
    }

    fn report_unavailable(&mut self, error: &io::Error) {
        let MulticastGroup { address, interface, .. } = &self.group;
        let errno = error.raw_os_error().map_or(Errno::UnknownErrno, Errno::from_raw);
        let message = match (errno, interface) {
            (Errno::ENODEV | Errno::ENXIO, Some(name)) => {
                format!("{name} not found or without multicast; list interfaces: ip -br link")
            }
            (
                Errno::ENETUNREACH
                | Errno::EHOSTUNREACH
                | Errno::EADDRNOTAVAIL
                | Errno::ENETDOWN
                | Errno::ENODEV,
                _,
            ) => {
                let name = interface.as_deref().unwrap_or("eth0");
                format!(
                    "no route to {address}: sudo ip route add {address} dev {name}, or \
                     name an interface: udp:{address}%{name}"
                )
            }
            (Errno::EADDRINUSE, _) => {
                format!("port {} is in use by another program", self.group.port)
            }
            (Errno::EINVAL, None) if address.is_ipv6() => {
                format!("{address} needs an interface: udp:{address}%eth0")
            }
            (Errno::EPERM | Errno::EACCES, _) => {
                format!("{address} is not permitted: {error} (firewall?)")
            }
            _ => format!("cannot join {address}: {error}"),
        };
        self.status.link = if self.was_there { Link::Unplugged } else { Link::Down };
        self.status.message = Some(message);
        self.delivery.deliver_status(&self.status);
    }

    /// Moves frames until the group is not reached any more or the port is dropped.
    fn serve(&mut self, mut sockets: Sockets) -> io::Result<()> {
        let mut frames = Vec::new();
        let mut looked = Monotonic::now();
        let away = loop {
            if self.line.is_stopped() {
                break None;
            }
            if let Err(error) = self.send_posted(&sockets) {
                break Some(error);
            }
            let has_more = self.receive(&mut sockets, &mut frames)?;
            self.status.kernel_drops = self.drops_before + sockets.drops();
            self.delivery.deliver(&mut frames, &mut self.status);
            if looked.elapsed() >= LOOK_EVERY {
                looked = Monotonic::now();
                if let Err(error) = sockets.check(&self.group) {
                    break Some(error);
                }
            }
            if !has_more {
                self.line.wait(Some(sockets.as_fd()), Some(LOOK_EVERY))?;
            }
        };
        self.drops_before += sockets.drops();
        if let Some(error) = away {
            self.report_unavailable(&error);
        }
        Ok(())
    }

    /// Takes what is here, as far as one batch takes it; says whether there is more.
    fn receive(&mut self, sockets: &mut Sockets, frames: &mut Vec<Frame>) -> io::Result<bool> {
        let mut buffer = [0; message::MAX_DATAGRAM];
        self.dating.read_clocks();
        for _ in 0..BATCH {
            let Some(received) = sockets.receive(&mut buffer)? else { return Ok(false) };
            let ReceivedDatagram { len, is_cut, ours, stamp_micros } = received;
            let frame = buffer.get(..len).filter(|_| !is_cut).and_then(message::decode);
            let Some(mut frame) = frame else {
                self.status.unreadable += 1;
                self.status.note = Some("received datagrams that are not python-can frames".into());
                continue;
            };
            frame.is_tx = ours;
            frames.push(frame.with_time(self.dating.date(stamp_micros)));
        }
        Ok(true)
    }

    /// Sends what waits.
    ///
    /// # Errors
    ///
    /// The group cannot be reached.
    fn send_posted(&mut self, sockets: &Sockets) -> io::Result<()> {
        let mut failure = None;
        let report = self.tx.transmit(|frame| {
            let time = self.clock.epoch().unix_secs(self.clock.now());
            let Some(datagram) = message::encode(frame, time) else { return TxAttempt::Rejected };
            match sockets.send(&datagram) {
                Ok(()) => TxAttempt::Sent,
                Err(error) if has_no_room(&error) => TxAttempt::NoRoom,
                Err(error) => {
                    failure = Some(error);
                    TxAttempt::Failed
                }
            }
        });
        self.status.transmit_failures += report.failures;
        failure.map_or(Ok(()), Err)
    }

    fn refuse_posted(&mut self) {
        let refused = self.tx.clear();
        if refused > 0 {
            self.status.transmit_failures += refused;
            self.delivery.deliver_status(&self.status);
        }
    }
}

fn has_no_room(error: &io::Error) -> bool {
    error.kind() == ErrorKind::WouldBlock || error.raw_os_error() == Some(nix::libc::ENOBUFS)
}
