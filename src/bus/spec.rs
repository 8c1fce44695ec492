//! What a BUS on the command line means.
//!
//! Opens nothing and looks at nothing: whether the interface or the file exists is learnt when
//! it is opened.

use super::slcan;
use std::fmt;
use std::net::{IpAddr, Ipv6Addr};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The longest name Linux gives an interface, in bytes.
const MAX_INTERFACE_NAME: usize = 15;

/// The longest name that socketcand takes.
const MAX_REMOTE_NAME: usize = 16;

/// The group that python-can has where none is named.
const DEFAULT_GROUP: IpAddr =
    IpAddr::V6(Ipv6Addr::new(0xFF15, 0x7079, 0x7468, 0x6F6E, 0x6465, 0x6D6F, 0x6D63, 0x6173));

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
    /// `slcan:/dev/ttyACM0@500000`: a serial adapter; the bit rate, where given, and for FD that
    /// of the data phase (`@500000/2000000`).
    Slcan {
        /// The serial device.
        device: PathBuf,
        /// Bit/s.
        bitrate: Option<u32>,
        /// Bit/s of the FD data phase.
        data_bitrate: Option<u32>,
    },
    /// `udp:239.74.163.2%eth0@43113`: python-can's multicast bus.
    Udp {
        /// The multicast group.
        group: IpAddr,
        /// The interface, where one is named.
        interface: Option<String>,
        /// The port, where it is not the usual one.
        port: Option<u16>,
    },
    /// `socketcand://host:29536/can0`: a bus of another machine.
    Socketcand {
        /// Its name or address; IPv6 without brackets.
        host: String,
        /// The port, where it is not the usual one.
        port: Option<u16>,
        /// What the bus is called there.
        interface: String,
    },
}

/// Why a BUS argument means nothing.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    /// Nothing at all.
    #[error("empty bus name; use can0 or file:LOG")]
    Empty,
    /// A kind, and nothing after the colon.
    #[error("{kind}: incomplete; use {example}")]
    Incomplete {
        /// What stood before the colon.
        kind: &'static str,
        /// A complete one.
        example: &'static str,
    },
    /// Not a kind of bus we know.
    #[error(
        "{0}: unknown bus type; use can0 (SocketCAN), slcan:/dev/ttyACM0@500000, \
         socketcand://host/can0, udp:239.74.163.2, file:LOG, sim:boiler or - (a log from standard input)"
    )]
    UnknownKind(String),
    /// A path, most likely of a log.
    #[error("{0} is not an interface name; for a log use file:{0}")]
    LooksLikePath(String),
    /// A device file, most likely of a serial adapter.
    #[error("{0} is not a CAN interface; for an slcan adapter use slcan:{0}@500000")]
    DeviceFile(String),
    /// Longer than interface names can be.
    #[error("{0} is too long for an interface name (15 bytes)")]
    NameTooLong(String),
    /// White space or control characters.
    #[error("{0:?} is not an interface name")]
    BadName(String),
    /// What follows the @ is no bit rate.
    #[error("{0} is not a bit rate; use slcan:/dev/ttyACM0@500000")]
    BadBitrate(String),
    /// No server and bus as socketcand has them.
    #[error(
        "{0} is not HOST/BUS; use socketcand://host:29536/can0 or \
             socketcand://[fe80::1%eth0]/can0"
    )]
    BadServer(String),
    /// No multicast group.
    #[error(
        "{0} is not a multicast group; use udp:239.74.163.2, udp:ff15::1%eth0@43113, or udp: for \
         python-can's default"
    )]
    BadGroup(String),
    /// A bit rate that slcan has no code for.
    #[error("slcan does not support {0} bit/s; use {rates}", rates = slcan::rates())]
    NoSuchBitrate(u32),
    /// The same for the data phase.
    #[error("slcan does not support {0} bit/s in the data phase; use {rates}", rates = slcan::data_rates())]
    NoSuchDataBitrate(u32),
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
            "slcan" => serial_adapter(wanted("slcan", "slcan:/dev/ttyACM0@500000")?),
            "udp" => multicast_group(rest),
            "socketcand" => {
                let incomplete = SpecError::Incomplete {
                    kind: "socketcand",
                    example: "socketcand://host:29536/can0",
                };
                let rest = rest.strip_prefix("//").and_then(|rest| rest.split_once('/'));
                match rest.filter(|(server, bus)| !server.is_empty() && !bus.is_empty()) {
                    Some((server, bus)) => other_machine(text, server, bus),
                    None => Err(incomplete),
                }
            }
            _ if kind.contains('/') => Err(SpecError::LooksLikePath(text.to_owned())),
            _ => Err(SpecError::UnknownKind(kind.to_owned())),
        }
    }
}

fn serial_adapter(text: &str) -> Result<BusSpec, SpecError> {
    let Some((device, rates)) = text.rsplit_once('@') else {
        return Ok(BusSpec::Slcan { device: text.into(), bitrate: None, data_bitrate: None });
    };
    let rate = |text: &str| {
        text.parse::<u32>().ok().ok_or_else(|| SpecError::BadBitrate(rates.to_owned()))
    };
    let (bitrate, data_bitrate) = match rates.split_once('/') {
        Some((bitrate, data)) => (rate(bitrate)?, Some(rate(data)?)),
        None => (rate(rates)?, None),
    };
    if slcan::rate_code(bitrate).is_none() {
        return Err(SpecError::NoSuchBitrate(bitrate));
    }
    if let Some(data) = data_bitrate.filter(|data| slcan::data_rate_code(*data).is_none()) {
        return Err(SpecError::NoSuchDataBitrate(data));
    }
    Ok(BusSpec::Slcan { device: device.into(), bitrate: Some(bitrate), data_bitrate })
}

fn multicast_group(text: &str) -> Result<BusSpec, SpecError> {
    let bad = || SpecError::BadGroup(text.to_owned());
    let (place, port) = match text.rsplit_once('@') {
        Some((place, port)) => {
            let port = port.parse().ok().filter(|port| *port > 0).ok_or_else(bad)?;
            (place, Some(port))
        }
        None => (text, None),
    };
    let (group, interface) = match place.split_once('%') {
        Some((group, interface)) => (group, Some(interface_name(interface).map_err(|_| bad())?)),
        None => (place, None),
    };
    let group = if group.is_empty() { DEFAULT_GROUP } else { group.parse().map_err(|_| bad())? };
    if !group.is_multicast() {
        return Err(bad());
    }
    Ok(BusSpec::Udp { group, interface, port })
}

fn other_machine(text: &str, server: &str, interface: &str) -> Result<BusSpec, SpecError> {
    let bad = || SpecError::BadServer(text.to_owned());
    let (host, port) = match server.strip_prefix('[') {
        Some(rest) => {
            let (host, rest) = rest.split_once(']').ok_or_else(bad)?;
            let port =
                if rest.is_empty() { None } else { Some(rest.strip_prefix(':').ok_or_else(bad)?) };
            (host, port)
        }
        None => match server.rsplit_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (server, None),
        },
    };
    let port = port.map(|port| port.parse().ok().filter(|port| *port > 0).ok_or_else(bad));
    let port = port.transpose()?;
    let is_ipv6 = server.starts_with('[');
    let is_odd = |c: char| c.is_whitespace() || c.is_control() || c == '<' || c == '>' || c == '/';
    // It stands between the brackets of a message.
    let is_name = interface.len() <= MAX_REMOTE_NAME && !interface.contains(is_odd);
    if host.is_empty() || host.contains(is_odd) || host.contains(':') && !is_ipv6 || !is_name {
        return Err(bad());
    }
    Ok(BusSpec::Socketcand { host: host.to_owned(), port, interface: interface.to_owned() })
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
            BusSpec::Slcan { device, bitrate, data_bitrate } => {
                write!(f, "slcan:{}", device.display())?;
                bitrate.map_or(Ok(()), |rate| write!(f, "@{rate}"))?;
                data_bitrate.map_or(Ok(()), |rate| write!(f, "/{rate}"))
            }
            BusSpec::Udp { group, interface, port } => {
                write!(f, "udp:{group}")?;
                if let Some(interface) = interface {
                    write!(f, "%{interface}")?;
                }
                port.map_or(Ok(()), |port| write!(f, "@{port}"))
            }
            BusSpec::Socketcand { host, port, interface } => {
                let is_ipv6 = host.contains(':');
                let (open, close) = if is_ipv6 { ("[", "]") } else { ("", "") };
                write!(f, "socketcand://{open}{host}{close}")?;
                port.map_or(Ok(()), |port| write!(f, ":{port}"))?;
                write!(f, "/{interface}")
            }
        }
    }
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
    }

    #[test]
    fn errors_say_on_one_line_what_would_be_right() {
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
            ("session.log", "file:session.log"),
            ("/dev/ttyACM0", "slcan:/dev/ttyACM0@500000"),
            ("slcan:/dev/ttyACM0@300000", "100000, 125000, 250000"),
            ("slcan:/dev/ttyACM0@500000/1", "2000000, 5000000"),
            ("./a:b", "file:./a:b"),
            ("pcan:1", "SocketCAN"),
            ("udp:192.168.1.1", "not a multicast group"),
            ("udp:239.74.163.2@0", "not a multicast group"),
            ("udp:239.74.163.2%a/b", "not a multicast group"),
            ("udp:nonsense", "udp:239.74.163.2"),
            ("can0123456789abc", "15 bytes"),
            ("can 0", "not an interface name"),
        ] {
            let message = text.parse::<BusSpec>().expect_err(text).to_string();
            assert!(message.contains(hint), "{text}: {message}");
            assert!(!message.contains('\n'));
        }
    }
}
