//! Sets a bus to one bit rate after the other, while it is looked for: an interface by netlink, an
//! adapter by how it is opened. What was found is put back, unless it is told to keep what is set.
//!
//! Does not know which rate is the right one.

use super::BusSpec;
use super::slcan::{SlcanAddress, rate_code};
use super::socketcan::controller::{CanController, ConfigError};
use crate::bitrate::ListenMode;
use std::io;
use std::path::PathBuf;

/// Why a bus cannot be set to a bit rate.
#[derive(Debug, thiserror::Error)]
pub enum TuneError {
    /// A kind of bus that has no bit rate of its own, or whose rate others set.
    #[error("{0}: bit rate cannot be set; use a controller's interface, such as can0")]
    NoRate(String),
    /// Only root may.
    #[error(
        "setting {name} needs root: sudo descan speed {name}; or try a rate by hand: sudo ip link \
         set {name} down && sudo ip link set {name} up type can bitrate {bitrate} listen-only on, then \
         descan watch {name} --listen-only"
    )]
    NotPermitted {
        /// The interface.
        name: String,
        /// The rate that was to be set, in bit/s.
        bitrate: u32,
    },
    /// The controller cannot only listen.
    #[error(
        "{0} has no listen-only mode; \
         descan speed {0} --active tries actively and destroys frames at wrong rates"
    )]
    NoListening(String),
    /// The controller cannot have this rate; others may do.
    #[error("{name} does not support {bitrate} bit/s")]
    NotThisRate {
        /// The interface.
        name: String,
        /// In bit/s.
        bitrate: u32,
    },
    /// There is no such interface, or it is none of a controller.
    #[error("{0}")]
    NotThere(String),
    /// The system did not do as it should.
    #[error("cannot configure {name}: {cause}")]
    Failed {
        /// The interface.
        name: String,
        /// What the system said.
        cause: io::Error,
    },
}

/// A bus whose bit rate can be set. When it is dropped, what was found is put back.
#[derive(Debug)]
pub struct BitRateSetter(SetterTarget);

#[derive(Debug)]
enum SetterTarget {
    Interface(CanController),
    Adapter { device: PathBuf, bitrate: Option<u32> },
}

impl BitRateSetter {
    /// The bus as it is. Changes nothing yet.
    pub fn of(bus: &BusSpec) -> Result<Self, TuneError> {
        match bus {
            BusSpec::SocketCan(name) => match CanController::of(name) {
                Ok(controller) => Ok(Self(SetterTarget::Interface(controller))),
                Err(refusal) => Err(explain(refusal, name, 0)),
            },
            BusSpec::Slcan(SlcanAddress { device, bitrate, .. }) => {
                Ok(Self(SetterTarget::Adapter { device: device.clone(), bitrate: *bitrate }))
            }
            other => Err(TuneError::NoRate(other.to_string())),
        }
    }

    /// The rate it had, in bit/s, where that is known.
    pub fn found_at(&self) -> Option<u32> {
        match &self.0 {
            SetterTarget::Interface(controller) => controller.bitrate(),
            SetterTarget::Adapter { bitrate, .. } => *bitrate,
        }
    }

    /// Sets it to `bitrate`. Comes back with the bus to be opened.
    pub fn set(&mut self, bitrate: u32, manner: ListenMode) -> Result<BusSpec, TuneError> {
        match &mut self.0 {
            SetterTarget::Interface(controller) => {
                let done = controller.set(bitrate, manner == ListenMode::Listening);
                let name = controller.name().to_owned();
                done.map_err(|refusal| explain(refusal, &name, bitrate))?;
                Ok(BusSpec::SocketCan(name))
            }
            // It would stay at the rate that it had.
            SetterTarget::Adapter { device, .. } if rate_code(bitrate).is_none() => {
                Err(TuneError::NotThisRate { name: device.display().to_string(), bitrate })
            }
            SetterTarget::Adapter { device, .. } => Ok(BusSpec::Slcan(SlcanAddress {
                device: device.clone(),
                bitrate: Some(bitrate),
                data_bitrate: None,
            })),
        }
    }

    /// Leaves it at `bitrate`; whether it takes part is as it was.
    pub fn keep(mut self, bitrate: u32) -> Result<(), TuneError> {
        if let SetterTarget::Interface(controller) = &mut self.0 {
            let done = controller.set(bitrate, controller.listened_only());
            done.map_err(|refusal| explain(refusal, controller.name(), bitrate))?;
            controller.keep();
        }
        Ok(())
    }

    /// Puts back what was found. Dropping it does the same, and says nothing where that fails.
    pub fn restore(mut self) -> Result<(), TuneError> {
        match &mut self.0 {
            SetterTarget::Interface(controller) => {
                let done = controller.restore();
                done.map_err(|refusal| explain(refusal, controller.name(), 0))
            }
            SetterTarget::Adapter { .. } => Ok(()),
        }
    }
}

fn explain(refusal: ConfigError, name: &str, bitrate: u32) -> TuneError {
    let name = name.to_owned();
    match refusal {
        ConfigError::NotThere(why) => TuneError::NotThere(why),
        ConfigError::NoController => TuneError::NoRate(name),
        ConfigError::NotPermitted => TuneError::NotPermitted { name, bitrate },
        ConfigError::NoListening => TuneError::NoListening(name),
        ConfigError::NotThisRate => TuneError::NotThisRate { name, bitrate },
        ConfigError::Failed(cause) => TuneError::Failed { name, cause },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_adapter_is_not_opened_at_a_rate_that_it_has_no_code_for() {
        let bus = "slcan:/dev/ttyACM0".parse().unwrap();
        let mut tuner = BitRateSetter::of(&bus).unwrap();
        assert!(matches!(
            tuner.set(300_000, ListenMode::Listening),
            Err(TuneError::NotThisRate { bitrate: 300_000, .. })
        ));
        let there = tuner.set(250_000, ListenMode::Listening).unwrap();
        assert_eq!(there.to_string(), "slcan:/dev/ttyACM0@250000");
    }
}
