//! `socketcand://HOST/BUS`: a bus of another machine, over TCP.
//!
//! `address` is the BUS argument, this file the connection, `protocol` the state machine, `message`
//! the syntax. If the server is not reachable, the status shows it, and the connection is retried
//! with increasing pauses.

mod address;
mod message;
mod protocol;

pub use address::SocketcandAddress;
pub(super) use address::{KIND, normalised, parse, text};
pub use protocol::Socketcand;

use super::faults::{cannot_open, no_response};
use super::kind::OpenRequest;
use super::port::Port;
use super::remote::Backoff;
use super::remote::stream::{self, Endpoint, Unavailable};
use crate::diagnostic::Diagnostic;
use crate::status::{BusStatus, Link, RateSearch};
use socket2::SockRef;
use std::io::{self, ErrorKind};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

/// TCP port of socketcand.
const DEFAULT_PORT: u16 = 29_536;
/// Timeout of a connection, for each address of the server.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// Pause before the first retry, and the longest pause.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
const MAX_PAUSE: Duration = Duration::from_secs(8);
/// Send buffer in bytes. Small, because frames in it count as sent.
const SEND_BUFFER: usize = 4_096;

/// Opens the bus; the status is delivered later.
pub(super) fn open(address: &SocketcandAddress, request: OpenRequest) -> Result<Port, Diagnostic> {
    let SocketcandAddress { host, port, interface } = address;
    let server = Server { host: host.clone(), port: port.unwrap_or(DEFAULT_PORT) };
    let protocol = Socketcand::new(&server.name(), interface);
    let backoff = Backoff::new(FIRST_PAUSE, MAX_PAUSE);
    let status = BusStatus { rate_search: RateSearch::NoRate, ..BusStatus::default() };
    stream::open(request, (server, protocol), (status, backoff))
}

struct Server {
    host: String,
    port: u16,
}

impl Server {
    fn name(&self) -> String {
        let Self { host, port } = self;
        if host.contains(':') { format!("[{host}]:{port}") } else { format!("{host}:{port}") }
    }

    fn connect(&self) -> io::Result<TcpStream> {
        let mut last = io::Error::from(ErrorKind::NotFound);
        for address in (self.host.as_str(), self.port).to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
                Ok(stream) => return Ok(stream),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn cannot_connect(&self, error: &io::Error) -> Unavailable {
        let name = self.name();
        let fault = match error.kind() {
            ErrorKind::ConnectionRefused => Diagnostic::new(format!("{name}: connection refused"))
                .with_remedy("start socketcand there"),
            ErrorKind::TimedOut => no_response(name).with_remedy("check that it is on"),
            ErrorKind::HostUnreachable | ErrorKind::NetworkUnreachable => {
                Diagnostic::new(format!("no route to {name}")).with_remedy("check the network")
            }
            // Errors of the resolver have no error number.
            _ if error.raw_os_error().is_none() => {
                let fault = Diagnostic::new(format!("unknown host {}: {error}", self.host));
                return Unavailable { link: Link::Missing, fault };
            }
            _ => cannot_open(name, error),
        };
        Unavailable { link: Link::Down, fault }
    }
}

impl Endpoint for Server {
    type Stream = TcpStream;

    fn open(&self) -> Result<TcpStream, Unavailable> {
        let stream = self.connect().map_err(|error| self.cannot_connect(&error))?;
        let set_up = stream
            .set_nonblocking(true)
            // Older daemons close the connection if a command arrives in two segments.
            .and_then(|()| stream.set_nodelay(true))
            .and_then(|()| SockRef::from(&stream).set_send_buffer_size(SEND_BUFFER));
        set_up.map_err(|error| self.cannot_connect(&error))?;
        Ok(stream)
    }

    fn broken_off(&self) -> Unavailable {
        let fault = Diagnostic::new(format!("connection to {} lost: reconnecting", self.name()));
        Unavailable { link: Link::Unplugged, fault }
    }

    fn close(&self, _: TcpStream, _: bool) {}
}
