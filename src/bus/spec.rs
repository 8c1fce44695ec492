//! The BUS argument of the command line: parsing and display.
//!
//! Opens nothing: whether an interface or a file exists shows when it is opened. Paths are compared as
//! the file system resolves them. The row of a kind is in its module; this file has the list of kinds.

use super::kind::{BusKind, OpenRequest};
use super::port::Port;
use super::replay::{file, stdin};
use super::slcan::{self, SlcanAddress};
use super::socketcan::is_like_an_interface;
use super::socketcand::{self, SocketcandAddress};
use super::udp::{self, UdpAddress};
use super::{sim, socketcan};
use crate::diagnostic::Diagnostic;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// One row per kind: its variant, and its module with `KIND`, `parse`, `normalised`, `text` and `open`.
macro_rules! bus_kinds {
    ($($(#[$doc:meta])* $variant:ident($address:ty) in $module:ident;)*) => {
        /// One BUS argument.
        #[derive(Clone, Debug, PartialEq, Eq)]
        pub enum BusSpec {
            $($(#[$doc])* $variant($address),)*
            /// `-`: a log from standard input.
            Stdin,
        }

        /// All kinds of bus, in the order of help.
        pub static KINDS: &[&BusKind] = &[$(&$module::KIND,)* &stdin::KIND];

        impl BusSpec {
            /// The kind of bus.
            pub fn kind(&self) -> &'static BusKind {
                match self {
                    $(BusSpec::$variant(_) => &$module::KIND,)*
                    BusSpec::Stdin => &stdin::KIND,
                }
            }

            /// `None` if no kind has this scheme.
            fn parse(scheme: &str, text: &str) -> Option<Result<Self, Diagnostic>> {
                $(if scheme == $module::KIND.scheme {
                    return Some($module::parse(text).map(BusSpec::$variant));
                })*
                (scheme == stdin::KIND.scheme && text.is_empty()).then_some(Ok(BusSpec::Stdin))
            }

            /// Returns true if both name one bus, however they are written: an slcan adapter at any
            /// bit rate, a file by any path, a server with or without its usual port.
            pub fn is_same_bus(&self, other: &BusSpec) -> bool {
                self.normalised() == other.normalised()
            }

            /// A text that all spellings of one bus share.
            pub fn key(&self) -> String {
                self.normalised().to_string()
            }

            /// The form that all spellings of one bus share.
            fn normalised(&self) -> BusSpec {
                match self {
                    $(BusSpec::$variant(address) => {
                        BusSpec::$variant($module::normalised(address))
                    })*
                    BusSpec::Stdin => BusSpec::Stdin,
                }
            }

            /// What follows the scheme.
            fn text(&self) -> String {
                match self {
                    $(BusSpec::$variant(address) => $module::text(address),)*
                    BusSpec::Stdin => String::new(),
                }
            }

            /// Opens the bus.
            pub(super) fn open(&self, request: OpenRequest) -> Result<Port, Diagnostic> {
                match self {
                    $(BusSpec::$variant(address) => $module::open(address, request),)*
                    BusSpec::Stdin => stdin::open(request),
                }
            }
        }
    };
}

bus_kinds! {
    /// `can0`: a SocketCAN interface, by its name.
    SocketCan(String) in socketcan;
    /// `slcan:/dev/ttyACM0@500000`: an slcan adapter at a serial port.
    Slcan(SlcanAddress) in slcan;
    /// `socketcand://host:29536/can0`: a bus of another machine.
    Socketcand(SocketcandAddress) in socketcand;
    /// `udp:239.74.163.2%eth0@43113`: the multicast bus of python-can.
    Udp(UdpAddress) in udp;
    /// `file:session.log`: a recorded log.
    File(PathBuf) in file;
    /// `sim:boiler`: a simulated bus, by the name or the file of its scenario.
    Sim(String) in sim;
}

impl FromStr for BusSpec {
    type Err = Diagnostic;

    fn from_str(text: &str) -> Result<Self, Diagnostic> {
        let (scheme, rest) = match text.split_once(':') {
            // Its colon is that of a drive, on Windows.
            Some(_) if file::has_drive(text) => (file::KIND.scheme, text),
            Some(parts) => parts,
            None if text == stdin::KIND.scheme => (text, ""),
            None if file::is_path(text) => (file::KIND.scheme, text),
            None => ("", text),
        };
        if let Some(spec) = BusSpec::parse(scheme, rest).filter(|_| !text.starts_with(':')) {
            return spec;
        }
        if scheme.contains('/') {
            return file::parse(text).map(BusSpec::File);
        }
        if let Some(rate) = crate::bitrate::parse(rest)
            && crate::bitrate::CLASSIC_RATES.contains(&rate)
            && let Ok(BusSpec::SocketCan(interface)) = scheme.parse()
            && is_like_an_interface(&interface)
            && cfg!(target_os = "linux")
        {
            let cause = format!("{text}: the name of an interface has no bit rate");
            let set = format!("sudo ip link set {interface} up type can bitrate {rate}");
            return Err(Diagnostic::new(cause).with_remedy(set));
        }
        let fault = Diagnostic::new(format!("{scheme}: unknown bus type"));
        Err(fault.with_remedy(format!("use {}", examples())))
    }
}

/// An example of each kind.
fn examples() -> String {
    let rows: Vec<String> = KINDS
        .iter()
        .map(|kind| match kind.note {
            Some(note) => format!("{} ({note})", kind.example),
            None => kind.example.to_owned(),
        })
        .collect();
    match &rows[..] {
        [others @ .., last] => format!("{} or {last}", others.join(", ")),
        [] => String::new(),
    }
}

/// The forms of the kinds that `fits` selects, for help: `can0 | slcan:DEVICE@RATE`.
pub fn forms(fits: fn(&BusKind) -> bool) -> String {
    let kinds = KINDS.iter().filter(|kind| fits(kind));
    kinds.flat_map(|kind| kind.forms).copied().collect::<Vec<_>>().join(" | ")
}

/// As it is written on the command line.
impl fmt::Display for BusSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind().scheme {
            scheme @ ("" | "-") => write!(f, "{scheme}{}", self.text()),
            scheme => write!(f, "{scheme}:{}", self.text()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn reads_every_kind_and_writes_it_back() {
        for text in [
            "can0",
            "vcan-test_1",
            "file:session.log",
            "file:/a b/c:d.log",
            "file:recorded",
            "-",
            "sim:boiler",
            "slcan:/dev/ttyACM0",
            "slcan:/dev/ttyACM0@500000",
            "slcan:/dev/ttyACM0@500000/2000000",
            "udp:239.74.163.2",
            "udp:ff15:7079:7468:6f6e:6465:6d6f:6d63:6173",
            "udp:239.74.163.2%lo@4000",
            "udp:ff15::1%eth0",
            "socketcand://host:29536/can0",
            "socketcand://192.168.1.7/vcan0",
            "socketcand://[::1]/can0",
            "socketcand://[fe80::1%eth0]:5000/can0",
        ] {
            let spec: BusSpec = text.parse().unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!(spec.to_string(), text);
        }
        assert_eq!("can0".parse(), Ok(BusSpec::SocketCan("can0".into())));
        let below_dev = ["/dev/stdin", "/dev/fd/63", "/dev/shm/session"];
        for log in ["session.log", "./a:b", "/a b/c", "drone.pcapng", "trace.ASC"]
            .into_iter()
            .chain(below_dev)
        {
            assert_eq!(log.parse(), Ok(BusSpec::File(log.into())), "{log}");
        }
    }

    #[test]
    fn errors_name_the_correct_form_on_one_line() {
        for (text, hint) in [
            ("", "use can0"),
            ("file:", "file:session.log"),
            ("sim:", "sim:boiler"),
            ("slcan:/dev/ttyACM0@fast", "slcan:/dev/ttyACM0@500000"),
            ("socketcand:host/can0", "socketcand://host"),
            ("socketcand://host", "socketcand://host:29536/can0"),
            ("socketcand://host:0/can0", "is not HOST/BUS"),
            ("socketcand://host:port/can0", "is not HOST/BUS"),
            ("socketcand://::1/can0", "is not HOST/BUS"),
            ("socketcand://[::1/can0", "is not HOST/BUS"),
            ("socketcand://host/can0 >< send", "is not HOST/BUS"),
            ("socketcand://host/can0>", "is not HOST/BUS"),
            ("/dev/ttyACM0", "slcan:/dev/ttyACM0@500000"),
            ("slcan:/dev/ttyACM0@300000", "100000, 125000, 250000"),
            ("slcan:/dev/ttyACM0@500000/1", "2000000, 5000000"),
            ("pcan:1", "SocketCAN"),
            ("udp:192.168.1.1", "not a multicast group"),
            ("udp:239.74.163.2@0", "not a multicast group"),
            ("udp:239.74.163.2%a/b", "not a multicast group"),
            ("udp:nonsense", "udp:239.74.163.2"),
            ("can0:125k", "sudo ip link set can0 up type can bitrate 125000"),
            ("vcan-test:125k", "sudo ip link set vcan-test up type can bitrate 125000"),
            ("candump:125k", "unknown bus type"),
            ("can0:0", "unknown bus type"),
            ("gateway1:29536", "socketcand://"),
            ("can0123456789abc", "15 bytes"),
            ("can 0", "not an interface name"),
        ] {
            let message = text.parse::<BusSpec>().expect_err(text).to_string();
            assert!(message.contains(hint), "{text}: {message}");
            assert!(!message.contains('\n'));
        }
    }

    #[test]
    fn every_kind_has_a_scheme_and_an_example_of_its_own() {
        let schemes: BTreeSet<_> = KINDS.iter().map(|kind| kind.scheme).collect();
        assert_eq!(schemes.len(), KINDS.len());
        for kind in KINDS {
            let spec: BusSpec = kind.example.parse().unwrap();
            assert_eq!((spec.kind(), spec.to_string().as_str()), (*kind, kind.example));
        }
    }

    #[test]
    fn unknown_kind_lists_every_example() {
        assert_eq!(
            "pcan:1".parse::<BusSpec>().unwrap_err().to_string(),
            "pcan: unknown bus type; use can0 (SocketCAN), slcan:/dev/ttyACM0@500000, \
             socketcand://host:29536/can0, udp:239.74.163.2, file:session.log, sim:boiler or - (a \
             log from standard input)"
        );
    }
}
