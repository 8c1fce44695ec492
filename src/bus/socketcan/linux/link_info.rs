//! State of the machine's CAN interfaces, by netlink and sysfs: names, up or down, bit rates,
//! controller state; and faults.
//!
//! Reads only; needs no privileges.

use crate::bus::faults::{bus_off, not_found, restart_command};
use crate::bus::socketcan::CanInterface;
use crate::diagnostic::Diagnostic;
use crate::status::BusState;
use nix::net::if_::if_nametoindex;
use socketcan::CanCtrlMode;
use socketcan::nl::{CanState, Mtu};
use std::fs;
use std::io;

/// `/sys/class/net/*/type` of a CAN interface (ARPHRD_CAN).
const CAN_TYPE: &str = "280";

/// The CAN interfaces of this machine, sorted by name.
pub fn interfaces() -> Vec<CanInterface> {
    let mut names: Vec<String> = fs::read_dir("/sys/class/net")
        .into_iter()
        .flatten()
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| is_can(name))
        .collect();
    names.sort_by_key(|name| {
        (name.trim_end_matches(|c: char| c.is_ascii_digit()).len(), name.clone())
    });
    let describe = |name: String| {
        let facts = LinkInfo::of(if_nametoindex(name.as_str()).ok()?).ok()?;
        let is_virtual = !has_device(&name);
        let LinkInfo { up, bitrate, state, .. } = facts;
        Some(CanInterface { name, up, is_virtual, bitrate, state })
    };
    names.into_iter().filter_map(describe).collect()
}

/// Returns true if this machine has a network interface of this name, of any type.
pub fn interface_exists(name: &str) -> bool {
    if_nametoindex(name).is_ok()
}

/// Returns true if an interface of this name exists and is a CAN interface.
pub(super) fn is_can(name: &str) -> bool {
    fs::read_to_string(format!("/sys/class/net/{name}/type"))
        .is_ok_and(|kind| kind.trim() == CAN_TYPE)
}

/// State of one interface, by netlink.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct LinkInfo {
    /// Its present name.
    pub(super) name: Option<String>,
    pub(super) up: bool,
    pub(super) fd: bool,
    pub(super) state: BusState,
    pub(super) bitrate: Option<u32>,
    /// It has no controller.
    pub(super) is_virtual: bool,
    pub(super) data_bitrate: Option<u32>,
    pub(super) tec: Option<u16>,
    pub(super) rec: Option<u16>,
    pub(super) restart_ms: Option<u32>,
    pub(super) listen_only: bool,
    /// The controller supports reports of bus errors, and they are switched off.
    pub(super) hides_errors: bool,
}

impl LinkInfo {
    /// Reads it: one round trip.
    ///
    /// # Errors
    ///
    /// Those of netlink.
    pub(super) fn of(ifindex: u32) -> io::Result<Self> {
        let details =
            socketcan::CanInterface::open_iface(ifindex).details().map_err(io::Error::other)?;
        let can = details.can;
        let rate = |bitrate: u32| (bitrate > 0).then_some(bitrate);
        let state = match can.state {
            _ if !details.is_up => BusState::Down,
            Some(CanState::ErrorActive) => BusState::ErrorActive,
            Some(CanState::ErrorWarning) => BusState::ErrorWarning,
            Some(CanState::ErrorPassive) => BusState::ErrorPassive,
            Some(CanState::BusOff) => BusState::BusOff,
            Some(CanState::Stopped | CanState::Sleeping) => BusState::Stopped,
            None => BusState::Unknown,
        };
        let has = |mode| can.ctrl_mode.is_some_and(|modes| modes.has_mode(mode));
        let can_report = can
            .ctrl_mode_supported
            .is_some_and(|modes| modes & CanCtrlMode::BerrReporting.mask() != 0);
        Ok(Self {
            name: details.name,
            up: details.is_up,
            fd: details.mtu == Some(Mtu::Fd),
            state,
            is_virtual: can.state.is_none(),
            bitrate: can.bit_timing.and_then(|timing| rate(timing.bitrate)),
            data_bitrate: can.data_bit_timing.and_then(|timing| rate(timing.bitrate)),
            tec: can.berr_counter.map(|counter| counter.txerr),
            rec: can.berr_counter.map(|counter| counter.rxerr),
            restart_ms: can.restart_ms,
            listen_only: has(CanCtrlMode::ListenOnly),
            hides_errors: can_report && !has(CanCtrlMode::BerrReporting),
        })
    }

    /// Information on `name` that is not a fault.
    pub(super) fn note(&self, name: &str) -> Option<String> {
        self.hides_errors.then(|| {
            format!(
                "{name} does not report bus errors; enable them: sudo ip link \
                 set {name} down && sudo ip link set {name} up type can berr-reporting on"
            )
        })
    }

    /// What is wrong with `name`; `None` without a fault.
    pub(super) fn fault(&self, name: &str) -> Option<Diagnostic> {
        let fault = |state: &str| Diagnostic::new(format!("{name} is {state}"));
        Some(match self.state {
            _ if !self.up && self.bitrate.is_none() && has_device(name) => fault("down")
                .with_remedy(format!("sudo ip link set {name} up type can bitrate 125000")),
            _ if !self.up => fault("down").with_remedy(format!("sudo ip link set {name} up")),
            BusState::BusOff => match self.restart_ms {
                Some(0) | None => {
                    bus_off(name, format!("check wiring, then {}", restart_command(name)))
                }
                Some(millis) => bus_off(
                    name,
                    format!("check wiring and bit rate; it restarts every {millis} ms"),
                ),
            },
            BusState::ErrorPassive if self.tec.is_some_and(|tec| tec >= 128) => {
                let rate = self.bitrate.map(|rate| format!("{rate} bit/s"));
                fault("error-passive (no ACK)").with_remedy(format!(
                    "check that another node is on, wired, terminated and at {}",
                    rate.as_deref().unwrap_or("the same bit rate")
                ))
            }
            BusState::ErrorPassive => fault("error-passive (receive errors)")
                .with_remedy("check bit rate, wiring and termination"),
            BusState::Stopped => {
                fault("stopped").with_remedy(format!("sudo ip link set {name} down, then up"))
            }
            _ => return None,
        })
    }
}

/// Returns true if the interface is not a virtual one.
fn has_device(name: &str) -> bool {
    fs::exists(format!("/sys/class/net/{name}/device")).unwrap_or(false)
}

/// An interface does not exist.
pub(super) fn missing(name: &str) -> Diagnostic {
    let names: Vec<_> = interfaces().into_iter().map(|interface| interface.name).collect();
    let fault = not_found(name, &names);
    if name.starts_with("vcan") {
        return fault.with_remedy(format!(
            "sudo ip link add {name} type vcan && sudo ip link set {name} up"
        ));
    }
    fault
}

#[cfg(test)]
mod tests {
    use super::*;

    fn up(state: BusState) -> LinkInfo {
        LinkInfo { up: true, state, ..LinkInfo::default() }
    }

    #[test]
    fn healthy_bus_has_no_fault() {
        assert_eq!(up(BusState::ErrorActive).fault("can0"), None);
        assert_eq!(up(BusState::Unknown).fault("vcan0"), None);
    }

    #[test]
    fn note_has_the_command_for_bus_error_reports() {
        assert_eq!(up(BusState::ErrorActive).note("can0"), None);
        let hides = LinkInfo { hides_errors: true, ..up(BusState::ErrorActive) };
        let note = hides.note("can0").unwrap();
        assert!(note.ends_with("ip link set can0 up type can berr-reporting on"), "{note}");
        assert_eq!(hides.fault("can0"), None);
    }

    #[test]
    fn fault_names_the_cause_and_the_way_out() {
        let down = LinkInfo { bitrate: Some(500_000), ..LinkInfo::default() };
        let text = |info: &LinkInfo, name| info.fault(name).unwrap().to_string();
        assert_eq!(text(&down, "nocan9"), "nocan9 is down; sudo ip link set nocan9 up");
        let off = text(&up(BusState::BusOff), "can0");
        assert!(off.contains("bus-off;") && off.contains("type can restart"), "{off}");
        let alone =
            LinkInfo { tec: Some(128), bitrate: Some(125_000), ..up(BusState::ErrorPassive) };
        let alone = text(&alone, "can0");
        assert!(alone.contains("no ACK") && alone.contains("125000 bit/s"), "{alone}");
        let deaf = LinkInfo { rec: Some(128), tec: Some(0), ..up(BusState::ErrorPassive) };
        assert!(text(&deaf, "can0").contains("receive errors"));
        assert!(missing("vcan77").to_string().contains("ip link add vcan77 type vcan"));
    }
}
