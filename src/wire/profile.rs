//! Everything the two descriptions leave open, as values that can be given: the profile.
//!
//! The built-in values are assumed; the program says so until a profile is given. A profile is
//! TOML and may name any part of it; what it leaves out stays as built in.

use super::des::Request;
use super::framing::Framing;
use super::id::Service;
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;

/// The assumed values, in one place.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Profile {
    /// Service numbers of the platform's own services.
    pub services: ServicesProfile,
    /// Service numbers of the descriptor fields; an empty request reads one.
    pub descriptor: DescriptorProfile,
    /// Service numbers of commands.
    pub commands: CommandsProfile,
    /// The heartbeat's layout, period, and whether we send one.
    pub heartbeat: HeartbeatProfile,
    /// How DES messages are laid into frames.
    pub framing: FramingChoice,
    /// ISO 15765-2 parameters.
    pub isotp: IsotpProfile,
    /// The ERR bit of our requests, 0 or 1.
    #[serde(deserialize_with = "bit")]
    pub request_err: bool,
    /// The codes of the modes.
    pub modes: ModesProfile,
    /// The six-bit alphabet of DEV_CFG_UID.
    pub uid: UidProfile,
    /// Names of services for the traffic view, by number.
    #[serde(deserialize_with = "service_names")]
    pub service_names: BTreeMap<u16, String>,
    /// Whether the values come from a file rather than being assumed.
    #[serde(skip)]
    pub given: bool,
}

impl Default for Profile {
    fn default() -> Self {
        Self {
            services: ServicesProfile::default(),
            descriptor: DescriptorProfile::default(),
            commands: CommandsProfile::default(),
            heartbeat: HeartbeatProfile::default(),
            framing: FramingChoice::Auto,
            isotp: IsotpProfile::default(),
            request_err: false,
            modes: ModesProfile::default(),
            uid: UidProfile::default(),
            service_names: BTreeMap::new(),
            given: false,
        }
    }
}

/// Why a profile cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ProfileError {
    /// Not TOML, or not a profile.
    #[error("{0}")]
    Syntax(#[from] toml::de::Error),
    /// A value outside its range.
    #[error("{key}: {value} is not {expected}")]
    Range {
        /// Which value.
        key: &'static str,
        /// What it is.
        value: String,
        /// What it may be.
        expected: &'static str,
    },
}

impl Profile {
    /// Reads a profile.
    pub fn parse(text: &str) -> Result<Self, ProfileError> {
        let mut profile: Self = toml::from_str(text)?;
        profile.given = true;
        profile.check()?;
        Ok(profile)
    }

    fn check(&self) -> Result<(), ProfileError> {
        let range =
            |key, value: String, expected| Err(ProfileError::Range { key, value, expected });
        let services = [
            ("services.heartbeat", self.services.heartbeat),
            ("services.des", self.services.des),
            ("services.config", self.services.config),
            ("services.config_mask", self.services.config_mask),
            ("descriptor.gid", self.descriptor.gid),
            ("descriptor.uid", self.descriptor.uid),
            ("descriptor.sn", self.descriptor.sn),
            ("descriptor.fw", self.descriptor.fw),
            ("descriptor.caps", self.descriptor.caps),
            ("descriptor.bspd", self.descriptor.bspd),
            ("descriptor.addr", self.descriptor.addr),
            ("descriptor.autostart", self.descriptor.autostart),
            ("commands.identify", self.commands.identify),
            ("commands.mode", self.commands.mode),
        ];
        for (key, number) in services {
            if number > 0x3FF {
                return range(key, number.to_string(), "a service number, 0 to 0x3FF");
            }
        }
        if self.services.heartbeat == self.services.des {
            let value = self.services.des.to_string();
            return range("services.des", value, "another number than services.heartbeat");
        }
        if !(10..=60_000).contains(&self.heartbeat.period_ms) {
            let value = self.heartbeat.period_ms.to_string();
            return range("heartbeat.period_ms", value, "10 to 60000 milliseconds");
        }
        let mut codes = self.modes.codes();
        codes.sort_unstable();
        if codes.windows(2).any(|pair| pair[0] == pair[1]) {
            return range("modes", format!("{:?}", self.modes.codes()), "seven different codes");
        }
        Ok(())
    }

    /// MSG_SRV_HR.
    pub fn heartbeat_service(&self) -> Service {
        Service::from_bits(self.services.heartbeat)
    }

    /// DES.
    pub fn des_service(&self) -> Service {
        Service::from_bits(self.services.des)
    }

    /// The name of a service for people: the platform's own, or one from `service_names`.
    pub fn service_name(&self, service: Service) -> Option<&str> {
        let number = service.number();
        if number == self.services.heartbeat {
            Some("HR")
        } else if number == self.services.des {
            Some("DES")
        } else {
            self.service_names.get(&number).map(String::as_str)
        }
    }

    /// In which framings a device is asked: the known one, else as the profile chooses.
    pub fn framings(&self, known: Option<Framing>) -> &'static [Framing] {
        const BOTH: [Framing; 2] = [Framing::Isotp, Framing::Raw];
        match (known, self.framing) {
            (Some(Framing::Isotp), _) | (None, FramingChoice::Isotp) => &BOTH[..1],
            (Some(Framing::Raw), _) | (None, FramingChoice::Raw) => &BOTH[1..],
            (None, FramingChoice::Auto) => &BOTH,
        }
    }

    /// The bytes of a request in one frame of that framing.
    pub fn request_bytes(request: Request, framing: Framing) -> ([u8; 5], usize) {
        let [d, e, s, kind] = request.encode();
        match framing {
            Framing::Isotp => ([4, d, e, s, kind], 5),
            Framing::Raw => ([d, e, s, kind, 0], 4),
        }
    }
}

/// Service numbers, 0–0x3FF.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ServicesProfile {
    /// MSG_SRV_HR. Assumed 0x001.
    pub heartbeat: u16,
    /// DES. Assumed 0x002.
    pub des: u16,
    /// Common configuration commands. Assumed 0x010.
    pub config: u16,
    /// MSG_SRV_CFG_MASK. Assumed 0x3F0.
    pub config_mask: u16,
}

impl Default for ServicesProfile {
    fn default() -> Self {
        Self { heartbeat: 0x001, des: 0x002, config: 0x010, config_mask: 0x3F0 }
    }
}

/// Service numbers of the descriptor fields (3.2), all assumed.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(missing_docs)]
pub struct DescriptorProfile {
    pub gid: u16,
    pub uid: u16,
    pub sn: u16,
    pub fw: u16,
    pub caps: u16,
    pub bspd: u16,
    pub addr: u16,
    pub autostart: u16,
}

impl Default for DescriptorProfile {
    fn default() -> Self {
        Self {
            gid: 0x010,
            uid: 0x011,
            sn: 0x012,
            fw: 0x013,
            caps: 0x014,
            bspd: 0x015,
            addr: 0x016,
            autostart: 0x017,
        }
    }
}

/// Service numbers of commands, assumed.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CommandsProfile {
    /// The platform's TEST: the device blinks or beeps (3.2).
    pub identify: u16,
    /// Change of mode; one byte, the mode's code.
    pub mode: u16,
}

impl Default for CommandsProfile {
    fn default() -> Self {
        Self { identify: 0x018, mode: 0x019 }
    }
}

/// The heartbeat's layout and period; offsets in bytes, absent: the heartbeat does not carry it.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HeartbeatProfile {
    /// Where the six bytes of DEV_CFG_UID begin. Assumed 0.
    #[serde(deserialize_with = "offset")]
    pub uid_offset: Option<u8>,
    /// Where the mode's code is. Assumed 6.
    #[serde(deserialize_with = "offset")]
    pub mode_offset: Option<u8>,
    /// Where the error code is. Assumed 7.
    #[serde(deserialize_with = "offset")]
    pub error_offset: Option<u8>,
    /// BUS_CFG_HR_TIME in milliseconds: 1,000 (3.1.7).
    pub period_ms: u32,
    /// Whether we send a heartbeat of our own.
    pub announce: Announce,
}

impl Default for HeartbeatProfile {
    fn default() -> Self {
        Self {
            uid_offset: Some(0),
            mode_offset: Some(6),
            error_offset: Some(7),
            period_ms: 1000,
            announce: Announce::Auto,
        }
    }
}

impl HeartbeatProfile {
    /// BUS_CFG_HR_TIME.
    pub fn period(&self) -> std::time::Duration {
        std::time::Duration::from_millis(u64::from(self.period_ms))
    }
}

/// Whether we send heartbeats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Announce {
    /// Only once a heartbeat that fits the profile was heard, or when a profile was given: the
    /// built-in number is assumed and might command a foreign device.
    #[default]
    Auto,
    /// Yes.
    Always,
    /// No.
    Never,
}

impl<'de> Deserialize<'de> for Announce {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Written {
            Truth(bool),
            Word(String),
        }
        match Written::deserialize(deserializer)? {
            Written::Truth(true) => Ok(Self::Always),
            Written::Truth(false) => Ok(Self::Never),
            Written::Word(word) if word == "auto" => Ok(Self::Auto),
            Written::Word(word) => Err(serde::de::Error::custom(format!(
                "announce is true, false or \"auto\", not \"{word}\""
            ))),
        }
    }
}

/// Which framings are read and sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FramingChoice {
    /// Both, told apart by what devices answer.
    #[default]
    Auto,
    /// ISO 15765-2 only.
    Isotp,
    /// Messages as they stand.
    Raw,
}

/// ISO 15765-2 parameters.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IsotpProfile {
    /// The byte FD frames are padded with. 0xCC.
    pub fd_padding: u8,
    /// BS of our flow control; 0 = everything at once.
    pub block_size: u8,
    /// STmin of our flow control, as coded.
    pub st_min: u8,
}

impl Default for IsotpProfile {
    fn default() -> Self {
        Self { fd_padding: 0xCC, block_size: 0, st_min: 0 }
    }
}

/// The codes of the modes, assumed 0–6 in the order of 3.2.4.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "UPPERCASE")]
#[allow(missing_docs)]
pub struct ModesProfile {
    pub init: u8,
    pub arslv: u8,
    pub cfg: u8,
    pub boot: u8,
    pub work: u8,
    pub ufunc: u8,
    pub idle: u8,
}

impl Default for ModesProfile {
    fn default() -> Self {
        Self { init: 0, arslv: 1, cfg: 2, boot: 3, work: 4, ufunc: 5, idle: 6 }
    }
}

impl ModesProfile {
    /// The codes in the order of [`super::node::Mode::ALL`].
    pub fn codes(&self) -> [u8; 7] {
        [self.init, self.arslv, self.cfg, self.boot, self.work, self.ufunc, self.idle]
    }
}

/// The 64 characters of DEV_CFG_UID; assumed: the value + 0x20, space to underscore.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UidProfile {
    #[serde(deserialize_with = "alphabet")]
    alphabet: [char; 64],
}

impl Default for UidProfile {
    fn default() -> Self {
        Self { alphabet: std::array::from_fn(|value| char::from(value as u8 + 0x20)) }
    }
}

impl UidProfile {
    /// The character of a six-bit value.
    pub fn character(&self, value: u8) -> char {
        self.alphabet[usize::from(value & 0x3F)]
    }

    /// The six-bit value of a character.
    pub fn value(&self, character: char) -> Option<u8> {
        self.alphabet.iter().position(|&known| known == character).map(|at| at as u8)
    }
}

fn bit<'de, D: Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    match u8::deserialize(deserializer)? {
        0 => Ok(false),
        1 => Ok(true),
        other => Err(serde::de::Error::custom(format!("a bit is 0 or 1, not {other}"))),
    }
}

/// An offset, or `false` where the heartbeat does not carry the field.
fn offset<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u8>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Written {
        Offset(u8),
        Truth(bool),
    }
    match Written::deserialize(deserializer)? {
        Written::Offset(at) if at < 64 => Ok(Some(at)),
        Written::Truth(false) => Ok(None),
        _ => Err(serde::de::Error::custom("an offset is 0 to 63, or false for none")),
    }
}

fn alphabet<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[char; 64], D::Error> {
    let text = String::deserialize(deserializer)?;
    let characters: Vec<char> = text.chars().collect();
    let count = characters.len();
    if let Some(odd) = characters.iter().find(|&&c| !crate::text::is_printable(c)) {
        return Err(serde::de::Error::custom(format!("{odd:?} is not printable")));
    }
    characters.try_into().map_err(|_| {
        serde::de::Error::custom(format!("an alphabet has 64 characters, not {count}"))
    })
}

fn service_names<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<BTreeMap<u16, String>, D::Error> {
    let written = BTreeMap::<String, String>::deserialize(deserializer)?;
    written
        .into_iter()
        .map(|(key, name)| {
            let number = key
                .strip_prefix("0x")
                .map_or_else(|| key.parse().ok(), |hex| u16::from_str_radix(hex, 16).ok())
                .filter(|number| *number < 1024);
            let number = number.ok_or_else(|| {
                serde::de::Error::custom(format!(
                    "\"{key}\" is not a service number (0 to 1023, or \"0x…\" up to 3FF)"
                ))
            })?;
            Ok((number, name))
        })
        .collect()
}
