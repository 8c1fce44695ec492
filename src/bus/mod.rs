//! Where frames come from and go: every kind of bus behind one [`Port`].
//!
//! Each port has threads of its own, so reading the bus never waits for the screen: frames and
//! status arrive in a bounded [`Queue`], and whatever is lost on the way is counted. Does not
//! know what frames mean.
//!
//! Reading order: [`BusSpec`] (what the user typed), [`open`], [`Port`], [`Queue`],
//! [`BusStatus`](crate::status::BusStatus), [`Clock`]; then the kinds:
//! `socketcan`, `slcan`, `socketcand` and `udp` (what they share is in `remote`), `replay`, `sim`.

mod clock;
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

pub use clock::{Clock, RxTimestamps};
pub use kind::{BusKind, OpenError, SpecError};
pub use port::{Port, TransmitError};
pub use queue::Queue;
pub use replay::file::open_log;
pub use sim::scenario;
pub use slcan::SlcanAddress;
pub use socketcan::{CanInterface, interfaces};
pub use socketcand::SocketcandAddress;
pub use spec::{BusSpec, KINDS, forms};
pub use tuner::{BitRateSetter, TuneError};
pub use udp::UdpAddress;

use crate::frame::{BusIndex, IdPattern};
use kind::OpenRequest;

/// How to open a bus.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Send nothing. (Whether the controller acknowledges is its own setting.)
    pub listen_only: bool,
    /// Only frames of these identifiers, and error reports, are of interest: a bus that can leave
    /// the others out at no cost does so, and its status says it. Empty: all are.
    pub only: Vec<IdPattern>,
}

/// Opens a bus. Its frames get the number `index`; a log of several interfaces also takes the
/// numbers after it: see [`Queue::names`].
///
/// # Errors
///
/// A log or scenario that cannot be read, or a system without threads or pipes left.
pub fn open(
    spec: &BusSpec,
    index: BusIndex,
    clock: Clock,
    options: Options,
) -> Result<Port, OpenError> {
    spec.open(OpenRequest { name: spec.to_string(), index, clock, options })
}
