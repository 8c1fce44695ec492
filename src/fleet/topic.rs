//! Topics of the documents of a gateway: `descan/v1/GATEWAY/device/can0/12`.
//!
//! Input: parts, or the topic of a message of any origin. Output: the topic, or its parts. A `/`, `+`,
//! `#`, `%` and what is not printable ASCII in the name of a bus or finding is written as `%` and two
//! hexadecimal digits for each byte of its UTF-8.

use crate::text::printable;
use crate::wire::id::Address;
use std::fmt::{self, Write as _};
use std::str::FromStr;
use std::sync::Arc;

/// First levels of all topics: the program and the version of the documents.
pub(super) const ROOT: &str = "descan/v1";

/// Longest topic that is read, in bytes.
const MAX_TOPIC_BYTES: usize = 1024;

/// The name of a gateway: 1 to 64 letters, digits, `.`, `_` and `-`, but not `.` or `..`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GatewayName(Arc<str>);

/// A text that is not the name of a gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the name of a gateway has 1 to 64 letters (A-Z, a-z), digits, '.', '_' or '-'")]
pub struct GatewayNameError;

impl GatewayName {
    /// Longest name, in characters.
    pub const MAX: usize = 64;

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The topic filter of all that this gateway publishes.
    pub fn filter(&self) -> String {
        self.topic("#")
    }

    /// Returns the topic with these levels after the name.
    pub fn topic(&self, levels: &str) -> String {
        format!("{ROOT}/{self}/{levels}")
    }
}

impl FromStr for GatewayName {
    type Err = GatewayNameError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let is_allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
        let is_folder = matches!(text, "." | "..");
        let has_length = (1..=Self::MAX).contains(&text.len()) && !is_folder;
        let fits = has_length && text.bytes().all(is_allowed);
        if fits { Ok(Self(text.into())) } else { Err(GatewayNameError) }
    }
}

impl fmt::Display for GatewayName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// What a topic of a gateway is about: the levels after its name.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum TopicPath {
    /// `status`: the gateway is connected or not; a summary.
    Status,
    /// `bus/BUS`
    Bus(String),
    /// `device/BUS/ADDRESS`
    Device(String, u8),
    /// `finding/BUS/ID`; the bus is `-` for a finding about des.json alone.
    Finding(String, String),
    /// `event`
    Event,
}

impl TopicPath {
    /// Returns the topic of a gateway.
    pub fn of(&self, gateway: &GatewayName) -> String {
        gateway.topic(&self.to_string())
    }

    /// Parses the levels after the name of a gateway.
    fn parse(text: &str) -> Option<Self> {
        let levels: Vec<&str> = text.split('/').collect();
        Some(match levels[..] {
            ["status"] => Self::Status,
            ["event"] => Self::Event,
            ["bus", bus] => Self::Bus(decoded(bus)?),
            ["device", bus, address] => Self::Device(decoded(bus)?, number(address)?),
            ["finding", bus, id] => Self::Finding(decoded(bus)?, decoded(id)?),
            _ => return None,
        })
    }
}

impl fmt::Display for TopicPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Status => f.write_str("status"),
            Self::Event => f.write_str("event"),
            Self::Bus(bus) => write!(f, "bus/{}", Level(bus)),
            Self::Device(bus, address) => write!(f, "device/{}/{address}", Level(bus)),
            Self::Finding(bus, id) => write!(f, "finding/{}/{}", Level(bus), Level(id)),
        }
    }
}

/// A topic of a gateway.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FleetTopic {
    /// The gateway.
    pub gateway: GatewayName,
    /// What it is about.
    pub path: TopicPath,
}

impl FleetTopic {
    /// The topic filter of all documents of all gateways, without events.
    pub const DOCUMENTS: [&str; 4] = [
        "descan/v1/+/status",
        "descan/v1/+/bus/+",
        "descan/v1/+/device/+/+",
        "descan/v1/+/finding/+/+",
    ];

    /// The topic filter of all events.
    pub const EVENTS: &str = "descan/v1/+/event";

    /// Parses the topic of a message; `None` for one that no gateway has.
    pub fn parse(topic: &[u8]) -> Option<Self> {
        let text = std::str::from_utf8(topic).ok().filter(|it| it.len() <= MAX_TOPIC_BYTES)?;
        let (gateway, path) = text.strip_prefix(ROOT)?.strip_prefix('/')?.split_once('/')?;
        Some(Self { gateway: gateway.parse().ok()?, path: TopicPath::parse(path)? })
    }
}

/// Parses an address as it is written: without sign and leading zeros.
fn number(text: &str) -> Option<u8> {
    let address = Address::new(text.parse().ok()?)?;
    Some(address.number()).filter(|number| number.to_string() == text)
}

/// A level of a topic, encoded.
struct Level<'a>(&'a str);

impl fmt::Display for Level<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for byte in self.0.bytes() {
            if byte.is_ascii_graphic() && !b"/+#%".contains(&byte) {
                f.write_char(char::from(byte))?;
            } else {
                write!(f, "%{byte:02X}")?;
            }
        }
        Ok(())
    }
}

/// Decodes a level; what is not printable is escaped. `None` for a level that nothing encodes to.
fn decoded(level: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(level.len());
    let mut rest = level.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        if first == b'%' {
            let digits = std::str::from_utf8(after.get(..2)?).ok()?;
            bytes.push(u8::from_str_radix(digits, 16).ok()?);
            rest = &after[2..];
        } else {
            bytes.push(first);
            rest = after;
        }
    }
    (!bytes.is_empty()).then(|| printable(&bytes))
}
