//! `udp:GROUP`: python-can's `udp_multicast` bus, one datagram to a multicast group per frame.
//!
//! `address` is the BUS argument, `message` the syntax of datagrams, `sockets` and `receiver` their
//! transport. If the group is not reachable, the status shows it, and the group is tried again.

mod address;
mod message;
mod receiver;
mod sockets;

pub use address::UdpAddress;
pub(super) use address::{KIND, normalised, parse, text};
pub use message::{decode as decode_datagram, encode as encode_datagram};

use super::clock::{Clock, RxTimestamps};
use super::faults::{cannot_open, in_use};
use super::kind::OpenRequest;
use super::port::{Port, PortShared};
use super::remote::{Backoff, Delivery};
use super::tx_queue::{TxAttempt, TxQueue};
use crate::diagnostic::Diagnostic;
use crate::frame::Frame;
use crate::status::{BusStatus, Link, RateSearch};
use receiver::{INTERFACES_COMMAND, has_no_room, is_missing_interface, route_remedy};
use sockets::{MulticastGroup, ReceivedDatagram, Sockets};
use std::io::{self, ErrorKind};
use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, Instant as Monotonic};

/// UDP port of python-can.
pub(super) const DEFAULT_PORT: u16 = 43_113;

/// Pause before the first retry to reach the group, and the longest pause.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
const MAX_PAUSE: Duration = Duration::from_secs(4);
/// Interval of checks that the group is reachable: the loss of a network is not reported.
const CHECK_PERIOD: Duration = Duration::from_secs(2);
/// Datagrams read per turn, before frames are sent.
const BATCH: usize = 256;

/// Opens the bus; its status is set at once.
pub(super) fn open(address: &UdpAddress, request: OpenRequest) -> Result<Port, Diagnostic> {
    let name = request.name.clone();
    start(address, request).map_err(|error| cannot_open(name, &error))
}

fn start(address: &UdpAddress, request: OpenRequest) -> io::Result<Port> {
    let OpenRequest { name, index, clock, options } = request;
    let shared = Arc::new(PortShared::new()?);
    shared.queue.add_name(&name);
    let group = MulticastGroup {
        address: address.group,
        port: address.port.unwrap_or(DEFAULT_PORT),
        interface: address.interface.clone(),
    };
    let mut bus = Multicast {
        group,
        sends: !options.listen_only,
        delivery: Delivery::new(Arc::clone(&shared), index),
        // A wait for room would delay reception.
        tx: TxQueue::new(Arc::clone(&shared), Duration::ZERO),
        shared: Arc::clone(&shared),
        timestamps: RxTimestamps::new(clock.clone()),
        clock,
        status: BusStatus { fd: true, rate_search: RateSearch::NoRate, ..BusStatus::default() },
        drops_before: 0,
        was_up: false,
    };
    let opened = bus.open();
    let mut port = Port::new(&name, shared, options.listen_only);
    port.serve(move |shared| {
        if let Err(error) = bus.run(opened) {
            shared.queue.finish(Link::Failed, Diagnostic::unreadable(name, &error));
        }
    })?;
    Ok(port)
}

struct Multicast {
    group: MulticastGroup,
    sends: bool,
    shared: Arc<PortShared>,
    delivery: Delivery,
    tx: TxQueue,
    timestamps: RxTimestamps,
    clock: Clock,
    status: BusStatus,
    /// Kernel drops of sockets closed so far.
    drops_before: u64,
    was_up: bool,
}

impl Multicast {
    fn run(&mut self, mut opened: Option<Sockets>) -> io::Result<()> {
        let mut backoff = Backoff::new(FIRST_PAUSE, MAX_PAUSE);
        while !self.shared.is_stopped() {
            if let Some(sockets) = opened.take().or_else(|| self.open()) {
                let since = Monotonic::now();
                self.serve(sockets)?;
                backoff.lasted(since.elapsed());
            }
            let until = Monotonic::now() + backoff.pause();
            while !self.shared.is_stopped() && Monotonic::now() < until {
                self.drop_pending();
                self.shared.wait(None, Some(until.saturating_duration_since(Monotonic::now())))?;
            }
        }
        Ok(())
    }

    /// Joins the group if it is reachable; otherwise sets the status.
    fn open(&mut self) -> Option<Sockets> {
        let opened = Sockets::open(&self.group, self.sends);
        match opened {
            Ok(sockets) => {
                self.was_up = true;
                (self.status.link, self.status.fault) = (Link::Up, None);
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
        let fault = match (error.kind(), interface) {
            // Without an error of the system.
            _ if error.raw_os_error().is_none() && !is_missing_interface(error) => {
                cannot_open(address, error)
            }
            (_, Some(name)) if is_missing_interface(error) => {
                Diagnostic::new(format!("{name} not found or without multicast"))
                    .with_remedy(format!("list interfaces: {INTERFACES_COMMAND}"))
            }
            (
                ErrorKind::NetworkUnreachable
                | ErrorKind::HostUnreachable
                | ErrorKind::AddrNotAvailable
                | ErrorKind::NetworkDown,
                _,
            ) => no_route(*address, interface.as_deref()),
            _ if is_missing_interface(error) => no_route(*address, interface.as_deref()),
            (ErrorKind::AddrInUse, _) => in_use(format_args!("port {}", self.group.port)),
            (ErrorKind::InvalidInput, None) if address.is_ipv6() => {
                Diagnostic::new(format!("{address} needs an interface"))
                    .with_remedy(format!("use udp:{address}%eth0"))
            }
            (ErrorKind::PermissionDenied, _) => {
                Diagnostic::new(format!("{address} is not permitted"))
                    .with_remedy("check the firewall")
            }
            _ => cannot_open(address, error),
        };
        self.status.link = if self.was_up { Link::Unplugged } else { Link::Down };
        self.status.fault = Some(fault);
        self.delivery.deliver_status(&self.status);
    }

    /// Transfers frames until the group is not reachable or the port is dropped.
    fn serve(&mut self, mut sockets: Sockets) -> io::Result<()> {
        let mut frames = Vec::new();
        let mut checked = Monotonic::now();
        let failure = loop {
            if self.shared.is_stopped() {
                break None;
            }
            if let Err(error) = self.send_pending(&sockets) {
                break Some(error);
            }
            let has_more = self.receive(&mut sockets, &mut frames)?;
            self.status.kernel_drops = self.drops_before + sockets.drops();
            self.delivery.deliver(&mut frames, &mut self.status);
            if checked.elapsed() >= CHECK_PERIOD {
                checked = Monotonic::now();
                if let Err(error) = sockets.check(&self.group) {
                    break Some(error);
                }
            }
            if !has_more {
                self.shared.wait(Some(sockets.wait_source()), Some(CHECK_PERIOD))?;
            }
        };
        self.drops_before += sockets.drops();
        if let Some(error) = failure {
            self.report_unavailable(&error);
        }
        Ok(())
    }

    /// Reads at most one batch. Returns true if there may be more.
    fn receive(&mut self, sockets: &mut Sockets, frames: &mut Vec<Frame>) -> io::Result<bool> {
        let mut buffer = [0; message::MAX_DATAGRAM];
        self.timestamps.read_clocks();
        for _ in 0..BATCH {
            let Some(received) = sockets.receive(&mut buffer)? else { return Ok(false) };
            let ours = sockets.is_own(&received);
            let ReceivedDatagram { len, is_cut, stamp_micros, .. } = received;
            let frame = buffer.get(..len).filter(|_| !is_cut).and_then(message::decode);
            let Some(mut frame) = frame else {
                self.status.unreadable += 1;
                self.status.note = Some("received datagrams that are not python-can frames".into());
                continue;
            };
            frame.is_tx = ours;
            frames.push(frame.with_time(self.timestamps.date(stamp_micros)));
        }
        Ok(true)
    }

    /// Sends all queued frames.
    ///
    /// # Errors
    ///
    /// The group is not reachable.
    fn send_pending(&mut self, sockets: &Sockets) -> io::Result<()> {
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

    fn drop_pending(&mut self) {
        let refused = self.tx.clear();
        if refused > 0 {
            self.status.transmit_failures += refused;
            self.delivery.deliver_status(&self.status);
        }
    }
}

fn no_route(group: IpAddr, interface: Option<&str>) -> Diagnostic {
    Diagnostic::new(format!("no route to {group}")).with_remedy(route_remedy(group, interface))
}
