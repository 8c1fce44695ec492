//! Sets the bit rate of a bus during a bit rate search: an interface by netlink, an adapter by how it
//! is opened. Restores the previous setting, unless [`BitRateSetter::keep`] is called.
//!
//! Does not know which rate is right.

use super::BusSpec;
use super::slcan::{SlcanAddress, rate_code};
use super::socketcan::controller::{CanController, ConfigError};
use crate::bitrate::ListenMode;
use std::io;
use std::path::PathBuf;

/// Why a bus cannot be set to a bit rate.
#[derive(Debug, thiserror::Error)]
pub enum TuneError {
    /// The kind of bus has no bit rate of its own, or another machine sets it.
    #[error("{0}: bit rate cannot be set; use a controller's interface, such as can0")]
    NoRate(String),
    /// Setting an interface needs root.
    #[error(
        "setting {name} needs root: sudo descan speed {name}; or try a rate by hand: sudo ip link \
         set {name} down && sudo ip link set {name} up type can bitrate {bitrate} listen-only on, then \
         descan watch {name} --listen-only"
    )]
    NotPermitted {
        /// The interface.
        name: String,
        /// The rate to be set, in bit/s.
        bitrate: u32,
    },
    /// The controller has no listen-only mode.
    #[error(
        "{0} has no listen-only mode; \
         descan speed {0} --active tries actively and destroys frames at wrong rates"
    )]
    NoListening(String),
    /// The controller does not support this rate.
    #[error("{name} does not support {bitrate} bit/s")]
    NotThisRate {
        /// The interface.
        name: String,
        /// In bit/s.
        bitrate: u32,
    },
    /// The interface does not exist, or is not a CAN interface.
    #[error("{0}")]
    NotThere(String),
    /// The system failed to set it.
    #[error("cannot configure {name}: {cause}")]
    Failed {
        /// The interface.
        name: String,
        /// The error of the system.
        cause: io::Error,
    },
}

/// A bus whose bit rate can be set. Dropping it restores the previous setting.
#[derive(Debug)]
pub struct BitRateSetter(SetterTarget);

#[derive(Debug)]
enum SetterTarget {
    Interface(CanController),
    Adapter { device: PathBuf, bitrate: Option<u32> },
}

impl BitRateSetter {
    /// Reads the present setting of a bus; changes nothing.
    ///
    /// # Errors
    ///
    /// The bus does not exist, or its bit rate cannot be set.
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

    /// The previous bit rate in bit/s; `None` if it is not known.
    pub fn found_at(&self) -> Option<u32> {
        match &self.0 {
            SetterTarget::Interface(controller) => controller.bitrate(),
            SetterTarget::Adapter { bitrate, .. } => *bitrate,
        }
    }

    /// Sets the bit rate, in bit/s. Returns the bus to open at that rate.
    ///
    /// # Errors
    ///
    /// The controller does not support the rate or the mode, or root is needed.
    pub fn set(&mut self, bitrate: u32, manner: ListenMode) -> Result<BusSpec, TuneError> {
        match &mut self.0 {
            SetterTarget::Interface(controller) => {
                let done = controller.set(bitrate, manner == ListenMode::ListenOnly);
                let name = controller.name().to_owned();
                done.map_err(|refusal| explain(refusal, &name, bitrate))?;
                Ok(BusSpec::SocketCan(name))
            }
            // The adapter would keep its present rate.
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

    /// Leaves the bus at `bitrate`, active or listen-only as before.
    ///
    /// # Errors
    ///
    /// As of [`set`](Self::set).
    pub fn keep(mut self, bitrate: u32) -> Result<(), TuneError> {
        if let SetterTarget::Interface(controller) = &mut self.0 {
            let done = controller.set(bitrate, controller.listened_only());
            done.map_err(|refusal| explain(refusal, controller.name(), bitrate))?;
            controller.keep();
        }
        Ok(())
    }

    /// Restores the previous setting. Dropping does the same, without an error.
    ///
    /// # Errors
    ///
    /// As of [`set`](Self::set).
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
    fn adapter_rejects_a_rate_without_an_slcan_code() {
        let bus = "slcan:/dev/ttyACM0".parse().unwrap();
        let mut tuner = BitRateSetter::of(&bus).unwrap();
        assert!(matches!(
            tuner.set(300_000, ListenMode::ListenOnly),
            Err(TuneError::NotThisRate { bitrate: 300_000, .. })
        ));
        let there = tuner.set(250_000, ListenMode::ListenOnly).unwrap();
        assert_eq!(there.to_string(), "slcan:/dev/ttyACM0@250000");
    }
}
