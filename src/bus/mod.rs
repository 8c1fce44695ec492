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
mod udp;
mod waker;

pub use clock::{Clock, RxTimestamps};
pub use port::{Port, TransmitError};
pub use queue::Queue;
pub use socketcan::{CanInterface, interfaces};
pub use spec::{BusSpec, SpecError};
pub use tuner::{BitRateSetter, TuneError};

use crate::frame::{BusIndex, IdPattern};
use crate::sim::Scenario;
use crate::text::on_one_line;
use std::fs::File;
use std::io;
use std::os::fd::AsFd;
use std::path::Path;

/// Why a bus cannot be opened. An interface that is down or not there yet is no reason: that
/// is a status.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The log cannot be opened.
    #[error("cannot read {path}: {cause}")]
    Log {
        /// The log.
        path: String,
        /// Why.
        cause: io::Error,
    },
    /// The scenario of a simulated bus cannot be used.
    #[error("{0}")]
    Scenario(String),
    /// No thread or no pipe.
    #[error("cannot open {name}: {cause}")]
    Resources {
        /// The bus.
        name: String,
        /// What the system said.
        cause: io::Error,
    },
}

/// How to open a bus.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Send nothing. (Whether the controller acknowledges is its own setting.)
    pub listen_only: bool,
    /// Only frames of these identifiers, and error reports, are of interest: a bus that can leave
    /// the others out at no cost does so, and its status says it. Empty: all are.
    pub only: Vec<IdPattern>,
}

/// Opens a bus whose frames are to be of bus `index`. A log of several interfaces takes the
/// indices after it too: see [`Queue::names`].
pub fn open(
    spec: &BusSpec,
    index: BusIndex,
    clock: Clock,
    options: Options,
) -> Result<Port, OpenError> {
    let name = spec.to_string();
    let port = match spec {
        BusSpec::SocketCan(interface) => socketcan::open(interface, index, clock, options),
        BusSpec::File(path) => {
            let log =
                open_log(path).map_err(|cause| OpenError::Log { path: name.clone(), cause })?;
            replay::open(&name, log, Some(path), index, clock)
        }
        BusSpec::Stdin => io::stdin()
            .as_fd()
            .try_clone_to_owned()
            .and_then(|log| replay::open(&name, File::from(log), None, index, clock)),
        BusSpec::Sim(system) => {
            let scenario = scenario(system)?;
            sim::open(&name, &scenario, index, clock, options.listen_only)
        }
        BusSpec::Slcan { device, bitrate, data_bitrate } => {
            slcan::open(&name, device, (*bitrate, *data_bitrate), (index, clock, options))
        }
        BusSpec::Socketcand { host, port, interface } => {
            socketcand::open(&name, (host, *port), interface, (index, clock, options))
        }
        BusSpec::Udp { group, interface, port } => {
            let group = (*group, interface.as_deref(), *port);
            udp::open(&name, group, (index, clock, options))
        }
    };
    port.map_err(|cause| OpenError::Resources { name, cause })
}

/// The scenario of that name: a built-in one, or a file.
pub fn scenario(name: &str) -> Result<Scenario, OpenError> {
    if Scenario::builtin_text(name).is_some() {
        return Scenario::builtin(name).map_err(|error| OpenError::Scenario(error.to_string()));
    }
    let text = std::fs::read_to_string(name).map_err(|cause| {
        OpenError::Scenario(format!("{name}: {cause}; use boiler, drone or a TOML file"))
    })?;
    Scenario::parse(&text).map_err(|error| {
        OpenError::Scenario(format!("{name}: {}", on_one_line(&error.to_string())))
    })
}

/// Opens a candump log.
pub fn open_log(path: &Path) -> io::Result<File> {
    let log = File::open(path)?;
    if log.metadata()?.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    Ok(log)
}
