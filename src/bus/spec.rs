//! What a BUS on the command line means.
//!
//! Opens nothing and looks at nothing: whether the interface or the file exists is learnt when
//! it is opened.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The longest name Linux gives an interface, in bytes.
const MAX_INTERFACE_NAME: usize = 15;

/// One BUS argument.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BusSpec {
    /// `can0`: a SocketCAN interface.
    SocketCan(String),
    /// `file:session.log`: a candump log.
    File(PathBuf),
    /// `-`: a candump log from standard input.
    Stdin,
    /// `sim:boiler`: a simulated bus.
    Sim(String),
    /// `slcan:/dev/ttyACM0@500000`: a serial adapter; the bit rate, where given.
    Slcan {
        /// The serial device.
        device: PathBuf,
        /// Bit/s.
        bitrate: Option<u32>,
    },
    /// `udp:239.74.163.2`: python-can's multicast bus.
    Udp(String),
    /// `socketcand://host:29536/can0`: a bus of another machine.
    Socketcand(String),
}

/// Why a BUS argument means nothing.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    /// Nothing at all.
    #[error("an empty bus name; say can0, or file:LOG")]
    Empty,
    /// A kind, and nothing after the colon.
    #[error("{kind}: of what? Say {example}")]
    Incomplete {
        /// What stood before the colon.
        kind: &'static str,
        /// A complete one.
        example: &'static str,
    },
    /// Not a kind of bus we know.
    #[error(
        "{0}: is no kind of bus; there are can0 (SocketCAN), file:LOG, sim:boiler and - (a log from \
         standard input)"
    )]
    UnknownKind(String),
    /// A path, most likely of a log.
    #[error("{0} is no interface name; for a log say file:{0}")]
    LooksLikePath(String),
    /// A device file, most likely of a serial adapter.
    #[error("{0} is no CAN interface; make it one: {way}", way = slcand(.0))]
    DeviceFile(String),
    /// Longer than interface names can be.
    #[error("{0} is too long for an interface name (15 bytes)")]
    NameTooLong(String),
    /// White space or control characters.
    #[error("{0:?} is no interface name")]
    BadName(String),
    /// What follows the @ is no bit rate.
    #[error("{0} is no bit rate; say slcan:/dev/ttyACM0@500000")]
    BadBitrate(String),
}

impl FromStr for BusSpec {
    type Err = SpecError;

    fn from_str(text: &str) -> Result<Self, SpecError> {
        if text == "-" {
            return Ok(BusSpec::Stdin);
        }
        let Some((kind, rest)) = text.split_once(':') else {
            return interface_name(text).map(BusSpec::SocketCan);
        };
        let wanted = |kind, example| {
            if rest.is_empty() { Err(SpecError::Incomplete { kind, example }) } else { Ok(rest) }
        };
        match kind {
            "file" => Ok(BusSpec::File(wanted("file", "file:session.log")?.into())),
            "sim" => Ok(BusSpec::Sim(wanted("sim", "sim:boiler")?.to_owned())),
            "slcan" => slcan(wanted("slcan", "slcan:/dev/ttyACM0@500000")?),
            "udp" => Ok(BusSpec::Udp(wanted("udp", "udp:239.74.163.2")?.to_owned())),
            "socketcand" => {
                let incomplete = SpecError::Incomplete {
                    kind: "socketcand",
                    example: "socketcand://host:29536/can0",
                };
                match rest.strip_prefix("//").filter(|rest| !rest.is_empty()) {
                    Some(rest) => Ok(BusSpec::Socketcand(rest.to_owned())),
                    None => Err(incomplete),
                }
            }
            _ if kind.contains('/') => Err(SpecError::LooksLikePath(text.to_owned())),
            _ => Err(SpecError::UnknownKind(kind.to_owned())),
        }
    }
}

fn slcan(text: &str) -> Result<BusSpec, SpecError> {
    let Some((device, rate)) = text.rsplit_once('@') else {
        return Ok(BusSpec::Slcan { device: text.into(), bitrate: None });
    };
    let bitrate = rate.parse().ok().filter(|rate| (5_000..=1_000_000).contains(rate));
    if bitrate.is_none() {
        return Err(SpecError::BadBitrate(rate.to_owned()));
    }
    Ok(BusSpec::Slcan { device: device.into(), bitrate })
}

fn interface_name(text: &str) -> Result<String, SpecError> {
    // Interface names may have dots, but this one is more likely a forgotten `file:`.
    let looks_like_path = text.contains('/') || Path::new(text).extension() == Some("log".as_ref());
    match text {
        "" => Err(SpecError::Empty),
        "." | ".." => Err(SpecError::BadName(text.to_owned())),
        _ if text.starts_with("/dev/") => Err(SpecError::DeviceFile(text.to_owned())),
        _ if looks_like_path => Err(SpecError::LooksLikePath(text.to_owned())),
        _ if text.len() > MAX_INTERFACE_NAME => Err(SpecError::NameTooLong(text.to_owned())),
        _ if text.contains(|c: char| c.is_whitespace() || c.is_control()) => {
            Err(SpecError::BadName(text.to_owned()))
        }
        _ => Ok(text.to_owned()),
    }
}

/// As it is written on the command line.
impl fmt::Display for BusSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            BusSpec::SocketCan(name) => f.write_str(name),
            BusSpec::File(path) => write!(f, "file:{}", path.display()),
            BusSpec::Stdin => f.write_str("-"),
            BusSpec::Sim(name) => write!(f, "sim:{name}"),
            BusSpec::Slcan { device, bitrate: None } => write!(f, "slcan:{}", device.display()),
            BusSpec::Slcan { device, bitrate: Some(rate) } => {
                write!(f, "slcan:{}@{rate}", device.display())
            }
            BusSpec::Udp(group) => write!(f, "udp:{group}"),
            BusSpec::Socketcand(rest) => write!(f, "socketcand://{rest}"),
        }
    }
}

/// How a serial adapter becomes an interface.
pub(super) fn slcand(device: &str) -> String {
    format!(
        "sudo slcand -o -s4 {device} can0 (-s4: 125 kbit/s, -s6: 500 kbit/s), sudo ip link set \
         can0 up, descan can0"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_every_kind_and_writes_it_back() {
        for text in [
            "can0",
            "vcan-test_1",
            "file:session.log",
            "file:/a b/c:d.log",
            "-",
            "sim:boiler",
            "slcan:/dev/ttyACM0",
            "slcan:/dev/ttyACM0@500000",
            "udp:239.74.163.2",
            "udp:ff15:7079:7468:6f6e:6465:6d6f:6d63:6173",
            "socketcand://host:29536/can0",
        ] {
            let spec: BusSpec = text.parse().unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!(spec.to_string(), text);
        }
        assert_eq!("can0".parse(), Ok(BusSpec::SocketCan("can0".into())));
    }

    #[test]
    fn errors_say_on_one_line_what_would_be_right() {
        for (text, hint) in [
            ("", "say can0"),
            ("file:", "file:session.log"),
            ("sim:", "sim:boiler"),
            ("slcan:/dev/ttyACM0@fast", "slcan:/dev/ttyACM0@500000"),
            ("socketcand:host/can0", "socketcand://host"),
            ("session.log", "file:session.log"),
            ("/dev/ttyACM0", "slcand -o -s4 /dev/ttyACM0 can0"),
            ("./a:b", "file:./a:b"),
            ("pcan:1", "SocketCAN"),
            ("can0123456789abc", "15 bytes"),
            ("can 0", "no interface name"),
        ] {
            let message = text.parse::<BusSpec>().expect_err(text).to_string();
            assert!(message.contains(hint), "{text}: {message}");
            assert!(!message.contains('\n'));
        }
    }
}
