//! What can be opened on this machine: CAN interfaces, serial devices, logs opened before, simulations.
//!
//! Reads folders, the list of logs and the ends of these; opens no bus and sends nothing. Bounded: 10 logs, 16 serial
//! devices. Does not know how the list is shown.

use super::recent_logs::{LogLengths, RecentLog, recent_logs};
use crate::app::{BusOffer, OfferKind};
use crate::bus::{self, CanInterface};
use crate::status::{BusState, length_text};
use crate::text::{printable, printable_path};
use jiff::Zoned;
use std::fs;
use std::path::{Path, PathBuf};

/// Most serial devices that are listed.
const MAX_ADAPTERS: usize = 16;

/// Words in the name of a serial device that is a CAN adapter.
const ADAPTER_WORDS: [&str; 5] = ["can", "slcan", "lawicel", "usbtin", "zubax"];

/// Returns everything that can be opened; times are in the time zone of this machine.
pub fn offers() -> Vec<BusOffer> {
    let interfaces = bus::interfaces();
    let interfaces = interfaces.iter().map(|interface| of_interface(interface, ""));
    interfaces.chain(others(&mut LogLengths::default())).collect()
}

/// Returns everything that can be opened but CAN interfaces.
pub fn others(lengths: &mut LogLengths) -> Vec<BusOffer> {
    let mut offers = adapters(Path::new("/dev/serial/by-id"), bus::serial_ports());
    offers.extend(recent_logs().iter().map(|log| of_log(log, lengths)));
    for (argument, facts) in
        [("sim:boiler", "125k, 10 devices, a conflict after 28 s"), ("sim:drone", "1M, 12 devices")]
    {
        offers.push(BusOffer {
            kind: OfferKind::Simulated,
            name: argument.to_owned(),
            facts: facts.to_owned(),
            argument: argument.to_owned(),
            command: None,
            is_unknown: false,
        });
    }
    offers
}

/// Returns the line of an interface; `heard` is what was received on it.
pub fn of_interface(interface: &CanInterface, heard: &str) -> BusOffer {
    let name = printable(interface.name.as_bytes());
    let rate = interface.bitrate.map_or_else(|| "–".to_owned(), |rate| format!("{}k", rate / 1000));
    let state = match (interface.up, interface.is_virtual, interface.state) {
        (false, ..) => "DOWN",
        (true, true, _) => "up (virtual)",
        (true, false, BusState::ErrorActive) => "active",
        (true, false, BusState::Unknown) => "up",
        (true, false, state) => state.name(),
    };
    let command = match (interface.up, interface.is_virtual) {
        (true, _) => None,
        (false, true) => Some(format!("sudo ip link set {name} up")),
        (false, false) => {
            let rate = interface.bitrate.unwrap_or(125_000);
            Some(format!("sudo ip link set {name} up type can bitrate {rate}"))
        }
    };
    BusOffer {
        kind: OfferKind::Interface,
        facts: format!("{rate:<6} {state:<12} {heard}").trim_end().to_owned(),
        argument: interface.name.clone(),
        name,
        command,
        is_unknown: false,
    }
}

/// The serial ports: those first that have a link with their identity in a folder, which only Linux has.
fn adapters(identities: &Path, ports: Vec<PathBuf>) -> Vec<BusOffer> {
    let mut offers: Vec<BusOffer> = Vec::new();
    let mut known = Vec::new();
    let mut by_id = entries(identities);
    by_id.sort();
    for path in by_id {
        let Ok(target) = fs::canonicalize(&path) else { continue };
        let identity = path.file_name().unwrap_or_default().as_encoded_bytes();
        let identity = printable(identity);
        let lower = identity.to_lowercase();
        let is_known = ADAPTER_WORDS.iter().any(|word| lower.contains(word));
        offers.push(of_adapter(&target, &identity, is_known));
        known.push(target);
    }
    let mut others = ports;
    others.retain(|path| !known.contains(path));
    offers.extend(others.iter().map(|path| of_adapter(path, "", false)));
    offers.truncate(MAX_ADAPTERS);
    offers
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    entries.filter_map(|entry| Some(entry.ok()?.path())).collect()
}

fn of_adapter(path: &Path, identity: &str, is_known: bool) -> BusOffer {
    let what = if is_known { "slcan" } else { "unknown adapter, Enter asks" };
    BusOffer {
        kind: OfferKind::Adapter,
        name: printable_path(path),
        facts: [what, identity].join("  ").trim_end().to_owned(),
        argument: format!("slcan:{}", path.display()),
        command: None,
        is_unknown: !is_known,
    }
}

fn of_log(log: &RecentLog, lengths: &mut LogLengths) -> BusOffer {
    BusOffer {
        kind: OfferKind::Log,
        name: printable(log.path.file_name().unwrap_or_default().as_encoded_bytes()),
        facts: facts_of_log(log, lengths),
        argument: format!("file:{}", log.path.display()),
        command: None,
        is_unknown: false,
    }
}

/// Length, what was found, time of the last change and folder of a log.
fn facts_of_log(log: &RecentLog, lengths: &mut LogLengths) -> String {
    let folder = log.path.parent().map(printable_path).unwrap_or_default();
    let Ok(metadata) = fs::metadata(&log.path) else { return folder };
    let changed = metadata.modified().ok().and_then(|at| Zoned::try_from(at).ok()).map(|at| {
        let (date, time) = (at.date(), at.time());
        format!("{date} {:02}:{:02}", time.hour(), time.minute())
    });
    let length = lengths.of(&log.path, &metadata).map_or_else(|| "–".to_owned(), length_text);
    let contents = printable(log.contents.as_bytes());
    let changed = changed.unwrap_or_default();
    format!("{length:<8} {contents:<23} {changed}  {folder}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn serial_devices_are_listed_once_with_their_identity() {
        let dev = tempfile::tempdir().unwrap();
        let dev = fs::canonicalize(dev.path()).unwrap();
        fs::create_dir_all(dev.join("serial/by-id")).unwrap();
        for name in ["ttyACM0", "ttyUSB0", "ttyUSB1"] {
            fs::write(dev.join(name), "").unwrap();
        }
        let link = |name: &str, to: &str| {
            std::os::unix::fs::symlink(dev.join(to), dev.join("serial/by-id").join(name)).unwrap();
        };
        link("usb-CANable_1234", "ttyACM0");
        link("usb-FTDI_5678", "ttyUSB1");
        let ports = ["ttyACM0", "ttyUSB0", "ttyUSB1"].map(|name| dev.join(name));
        let found: Vec<_> = adapters(&dev.join("serial/by-id"), ports.to_vec())
            .into_iter()
            .map(|offer| (offer.name.rsplit('/').next().unwrap().to_owned(), offer.is_unknown))
            .collect();
        let expected = [("ttyACM0", false), ("ttyUSB1", true), ("ttyUSB0", true)];
        assert_eq!(found, expected.map(|(name, is_unknown)| (name.to_owned(), is_unknown)));
    }

    #[test]
    fn interface_that_is_down_has_its_command() {
        let mut interface = CanInterface {
            name: "can1".to_owned(),
            up: false,
            is_virtual: false,
            bitrate: Some(250_000),
            state: crate::status::BusState::Unknown,
        };
        let command = |interface: &CanInterface| of_interface(interface, "").command;
        let expected = "sudo ip link set can1 up type can bitrate 250000";
        assert_eq!(command(&interface).as_deref(), Some(expected));
        interface.up = true;
        assert_eq!(command(&interface), None);
    }
}
