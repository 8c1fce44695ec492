//! Buses: every kind behind one [`Port`].
//!
//! Each port has threads of its own, so reading a bus never waits for the screen: frames and status
//! arrive in a bounded [`Queue`], and lost frames are counted. Does not know what frames mean.
//!
//! A new kind of bus is a module with `KIND`, `parse`, `normalised`, `text` and `open`,
//! and a row in `spec.rs`.
//!
//! Reading order: [`BusSpec`] (the BUS argument), [`open`], [`Port`], [`Queue`],
//! [`BusStatus`](crate::status::BusStatus), [`Clock`]; then the kinds:
//! `socketcan`, `slcan`, `socketcand` and `udp` (what they share is in `remote`), `replay`, `sim`.

mod absolute_path;
mod clock;
mod faults;
mod kind;
mod port;
mod queue;
mod remote;
mod replay;
mod sim;
mod slcan;
mod socketcan;
mod socketcand;
mod spec;
mod tuner;
mod tx_queue;
mod udp;
mod waker;

pub(crate) use clock::wall_micros;
pub use clock::{Clock, RxTimestamps};
pub use faults::TuneError;
pub use kind::BusKind;
pub use port::{Port, TransmitError};
pub use queue::Queue;
pub use remote::stream::{Protocol, ProtocolIo, Unavailable};
pub use replay::dates::LogDates;
pub use replay::file::open_log;
pub(crate) use replay::unpacking::unpacked_log;
pub use sim::scenario;
pub use slcan::{Slcan, SlcanAddress, SlcanSettings, serial_ports};
pub use socketcan::{CanInterface, interface_exists, interfaces, is_like_an_interface};
pub use socketcand::{Socketcand, SocketcandAddress};
pub use spec::{BusSpec, KINDS, forms};
pub use tuner::BitRateSetter;
pub use udp::{UdpAddress, decode_datagram, encode_datagram};

use crate::diagnostic::Diagnostic;
use crate::frame::{BusIndex, IdFilter};
use kind::OpenRequest;

/// How to open a bus.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Send no frames. (Whether the controller sends ACKs is its own setting.)
    pub listen_only: bool,
    /// Listen until a valid frame is received before sending, where the bus needs a bit rate that was
    /// not named by the user: a wrong one destroys the frames of others.
    pub listens_first: bool,
    /// Receive only frames with these identifiers, and error frames, if the bus can filter at no
    /// cost: then [`BusStatus::filtered`](crate::status::BusStatus::filtered) is set. Empty: all.
    pub only: Vec<IdFilter>,
}

/// Opens a bus. Its frames get the number `index`; a log of several interfaces also takes the
/// numbers after it: see [`Queue::names_from`].
///
/// # Errors
///
/// A log or scenario that cannot be read, or a system without threads or pipes left.
pub fn open(
    spec: &BusSpec,
    index: BusIndex,
    clock: Clock,
    options: Options,
) -> Result<Port, Diagnostic> {
    spec.open(OpenRequest { name: spec.to_string(), index, clock, options })
}
