//! Configuration of a CAN controller by netlink: bit rate, listen-only, down and up. Needs
//! CAP_NET_ADMIN. Does not know its purpose.

use super::link_info::{is_can, missing};
use crate::bitrate::RATES;
use crate::bus::faults::TuneError;
use crate::bus::socketcan::not_can;
use crate::diagnostic::{Diagnostic, without_number};
use nix::net::if_::if_nametoindex;
use nix::unistd::geteuid;
use socketcan::nl::{CanBitTiming, CanCtrlModes, InterfaceCanParams};
use socketcan::{CanCtrlMode, CanInterface, Error};
use std::io::{self, ErrorKind};

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
    pub(in crate::bus) fn of(name: &str) -> Result<Self, TuneError> {
        let ifindex = if_nametoindex(name).map_err(|_| missing(name))?;
        if !is_can(name) {
            return Err(not_can(name).into());
        }
        let interface = CanInterface::open_iface(ifindex);
        let details =
            interface.details().map_err(|error| Diagnostic::unreadable(name, &io_error(error)))?;
        // Every controller reports its clock frequency; virtual interfaces have none.
        if details.can.clock.is_none() {
            return Err(TuneError::no_rate(name));
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
    pub(in crate::bus) fn set(&mut self, bitrate: u32, listen_only: bool) -> Result<(), TuneError> {
        self.touched = true;
        let failed = |error: io::Error| TuneError::Failed(self.fault(bitrate, &error));
        self.down().map_err(failed)?;
        let timing = CanBitTiming { bitrate, ..CanBitTiming::default() };
        // One at a time, to know which of both is rejected.
        self.change(Some(timing), None).map_err(|error| match error.kind() {
            ErrorKind::PermissionDenied => failed(error),
            _ => TuneError::not_this_rate(&self.name, bitrate),
        })?;
        self.change(None, Some(listen_only)).map_err(|error| match error.kind() {
            ErrorKind::PermissionDenied => failed(error),
            _ if listen_only => TuneError::Failed(self.without_listen_only()),
            _ => failed(error),
        })?;
        self.up().map_err(failed)
    }

    /// Keeps the present configuration when dropped.
    pub(in crate::bus) fn keep(&mut self) {
        self.touched = false;
    }

    /// Restores the previous configuration. If it had no bit rate, the present one stays.
    pub(in crate::bus) fn restore(&mut self) -> Result<(), TuneError> {
        let is_touched = std::mem::take(&mut self.touched);
        let done = if is_touched { self.put_back() } else { Ok(()) };
        let bitrate = self.bitrate().unwrap_or(RATES[0]);
        done.map_err(|error| TuneError::Failed(self.fault(bitrate, &error)))
    }

    fn put_back(&self) -> io::Result<()> {
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

    fn down(&self) -> io::Result<()> {
        self.interface.bring_down().map_err(rejection)
    }

    fn up(&self) -> io::Result<()> {
        self.interface.bring_up().map_err(rejection)
    }

    fn change(
        &self,
        bit_timing: Option<CanBitTiming>,
        listen_only: Option<bool>,
    ) -> io::Result<()> {
        let ctrl_mode = listen_only.map(|on| CanCtrlModes::from_mode(CanCtrlMode::ListenOnly, on));
        let parameters =
            InterfaceCanParams { bit_timing, ctrl_mode, ..InterfaceCanParams::default() };
        self.interface.set_can_params(&parameters).map_err(rejection)
    }

    fn fault(&self, bitrate: u32, error: &io::Error) -> Diagnostic {
        let name = &self.name;
        match error.kind() {
            ErrorKind::PermissionDenied => Diagnostic::new(format!("setting {name} needs root"))
                .with_remedy(format!(
                    "sudo descan speed {name}, or try a rate by hand: sudo ip link set {name} \
                     down && sudo ip link set {name} up type can bitrate {bitrate} listen-only on, \
                     then descan watch {name} --listen-only"
                )),
            _ => Diagnostic::new(format!("cannot configure {name}: {}", without_number(error))),
        }
    }

    fn without_listen_only(&self) -> Diagnostic {
        let name = &self.name;
        Diagnostic::new(format!("{name} has no listen-only mode")).with_remedy(format!(
            "descan speed {name} --active tries actively and destroys frames at wrong rates"
        ))
    }
}

impl Drop for CanController {
    fn drop(&mut self) {
        // The caller that needs the error calls `restore` itself.
        let _ = self.restore();
    }
}

/// The system's error of a change. A missing privilege is not always reported as such.
fn rejection(error: Error) -> io::Error {
    if geteuid().is_root() { io_error(error) } else { ErrorKind::PermissionDenied.into() }
}

fn io_error(error: Error) -> io::Error {
    match error {
        Error::Io(cause) => cause,
        Error::Nl(error) => match error.errno() {
            Some(errno) => io::Error::from_raw_os_error(errno),
            None => io::Error::other(error),
        },
        other @ Error::Can(_) => io::Error::other(other),
    }
}
