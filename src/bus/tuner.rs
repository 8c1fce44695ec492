//! Sets the bit rate of a bus during a bit rate search: an interface by netlink, an adapter by how it
//! is opened. Restores the previous setting, unless [`BitRateSetter::keep`] is called.
//!
//! Does not know which rate is right.

use super::BusSpec;
use super::faults::TuneError;
use super::slcan::{SlcanAddress, rate_code};
use super::socketcan::CanController;
use crate::bitrate::ListenMode;
use std::path::PathBuf;

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
            BusSpec::SocketCan(name) => {
                CanController::of(name).map(|controller| Self(SetterTarget::Interface(controller)))
            }
            BusSpec::Slcan(SlcanAddress { device, bitrate, .. }) => {
                Ok(Self(SetterTarget::Adapter { device: device.clone(), bitrate: *bitrate }))
            }
            other => Err(TuneError::no_rate(other)),
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
                controller.set(bitrate, manner == ListenMode::ListenOnly)?;
                Ok(BusSpec::SocketCan(controller.name().to_owned()))
            }
            // The adapter would keep its present rate.
            SetterTarget::Adapter { device, .. } if rate_code(bitrate).is_none() => {
                Err(TuneError::not_this_rate(device.display(), bitrate))
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
            controller.set(bitrate, controller.listened_only())?;
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
            SetterTarget::Interface(controller) => controller.restore(),
            SetterTarget::Adapter { .. } => Ok(()),
        }
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
            Err(TuneError::NotThisRate(_))
        ));
        let there = tuner.set(250_000, ListenMode::ListenOnly).unwrap();
        assert_eq!(there.to_string(), "slcan:/dev/ttyACM0@250000");
    }
}
