//! Configuration of a CAN controller by netlink: bit rate, listen-only, down and up. Needs
//! CAP_NET_ADMIN. Does not know its purpose.

use super::link_info::{advice_missing, is_can};
use nix::net::if_::if_nametoindex;
use nix::unistd::geteuid;
use socketcan::nl::{CanBitTiming, CanCtrlModes, InterfaceCanParams};
use socketcan::{CanCtrlMode, CanInterface, Error};
use std::io::{self, ErrorKind};

/// Why a controller cannot be configured.
#[derive(Debug)]
pub(in crate::bus) enum ConfigError {
    /// The interface does not exist or is not a CAN interface; fault and remedy.
    NotThere(String),
    /// The interface has no controller, as vcan.
    NoController,
    /// It needs root.
    NotPermitted,
    /// The controller has no listen-only mode.
    NoListening,
    /// The controller does not support this bit rate.
    NotThisRate,
    /// Anything else.
    Failed(io::Error),
}

/// A controller and its previous configuration.
#[derive(Debug)]
pub(in crate::bus) struct CanController {
    name: String,
    interface: CanInterface,
    was_up: bool,
    timing: Option<CanBitTiming>,
    listened_only: bool,
    touched: bool,
}

impl CanController {
    /// Reads the configuration; changes nothing.
    pub(in crate::bus) fn of(name: &str) -> Result<Self, ConfigError> {
        let ifindex =
            if_nametoindex(name).map_err(|_| ConfigError::NotThere(advice_missing(name)))?;
        if !is_can(name) {
            return Err(ConfigError::NotThere(format!("{name} is not a CAN interface")));
        }
        let interface = CanInterface::open_iface(ifindex);
        let details = interface.details().map_err(refusal)?;
        // Every controller reports its clock frequency; virtual interfaces have none.
        if details.can.clock.is_none() {
            return Err(ConfigError::NoController);
        }
        let modes = details.can.ctrl_mode;
        Ok(Self {
            name: name.to_owned(),
            interface,
            was_up: details.is_up,
            timing: details.can.bit_timing.filter(|timing| timing.bitrate > 0),
            listened_only: modes.is_some_and(|modes| modes.has_mode(CanCtrlMode::ListenOnly)),
            touched: false,
        })
    }

    pub(in crate::bus) fn name(&self) -> &str {
        &self.name
    }

    /// The previous bit rate in bit/s; `None` if it had none.
    pub(in crate::bus) fn bitrate(&self) -> Option<u32> {
        self.timing.map(|timing| timing.bitrate)
    }

    /// Returns true if it was listen-only.
    pub(in crate::bus) fn listened_only(&self) -> bool {
        self.listened_only
    }

    /// Sets it down, configures it, and sets it up.
    pub(in crate::bus) fn set(
        &mut self,
        bitrate: u32,
        listen_only: bool,
    ) -> Result<(), ConfigError> {
        self.touched = true;
        self.down()?;
        let timing = CanBitTiming { bitrate, ..CanBitTiming::default() };
        // One at a time, to know which of both is rejected.
        self.change(Some(timing), None).map_err(|refusal| match refusal {
            ConfigError::Failed(_) => ConfigError::NotThisRate,
            other => other,
        })?;
        self.change(None, Some(listen_only)).map_err(|refusal| match refusal {
            ConfigError::Failed(_) if listen_only => ConfigError::NoListening,
            other => other,
        })?;
        self.up()
    }

    /// Keeps the present configuration when dropped.
    pub(in crate::bus) fn keep(&mut self) {
        self.touched = false;
    }

    /// Restores the previous configuration. If it had no bit rate, the present one stays.
    pub(in crate::bus) fn restore(&mut self) -> Result<(), ConfigError> {
        if !std::mem::take(&mut self.touched) {
            return Ok(());
        }
        self.down()?;
        if let Some(timing) = self.timing {
            // The segments determine the rate. Controllers with a list of rates accept only the rate.
            let segments = CanBitTiming { bitrate: 0, ..timing };
            let rate = CanBitTiming { bitrate: timing.bitrate, ..CanBitTiming::default() };
            self.change(Some(segments), None).or_else(|_| self.change(Some(rate), None))?;
        }
        self.change(None, Some(self.listened_only))?;
        if self.was_up { self.up() } else { Ok(()) }
    }

    fn down(&self) -> Result<(), ConfigError> {
        self.interface.bring_down().map_err(refusal)
    }

    fn up(&self) -> Result<(), ConfigError> {
        self.interface.bring_up().map_err(refusal)
    }

    fn change(
        &self,
        bit_timing: Option<CanBitTiming>,
        listen_only: Option<bool>,
    ) -> Result<(), ConfigError> {
        let ctrl_mode = listen_only.map(|on| CanCtrlModes::from_mode(CanCtrlMode::ListenOnly, on));
        let parameters =
            InterfaceCanParams { bit_timing, ctrl_mode, ..InterfaceCanParams::default() };
        self.interface.set_can_params(&parameters).map_err(refusal)
    }
}

impl Drop for CanController {
    fn drop(&mut self) {
        // The caller that needs the error calls `restore` itself.
        let _ = self.restore();
    }
}

fn refusal(error: Error) -> ConfigError {
    let cause = match error {
        Error::Io(cause) => cause,
        Error::Nl(error) => match error.errno() {
            Some(errno) => io::Error::from_raw_os_error(errno),
            None => io::Error::other(error),
        },
        other @ Error::Can(_) => io::Error::other(other),
    };
    // A missing privilege is not always reported as such.
    if cause.kind() == ErrorKind::PermissionDenied || !geteuid().is_root() {
        ConfigError::NotPermitted
    } else {
        ConfigError::Failed(cause)
    }
}
