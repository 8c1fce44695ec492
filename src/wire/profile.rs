//! The profile: numbers and layouts that the sources of the protocol leave open.
//!
//! Source: protocol §9. [`Profile::default`] has the assumed values; [`Profile::parse`] (feature
//! `std`) reads a TOML file, which may set any part of them; [`Profile::origin`] says of each where it
//! comes from. Does not know which values the devices on a bus really use.

#[cfg(feature = "std")]
mod file;
mod keys;
#[cfg(feature = "std")]
mod values;

#[cfg(feature = "std")]
pub(crate) use file::byte_order;
pub use keys::{ProfileKey, ValueOrigin};
#[cfg(feature = "std")]
pub use values::{ProfileValue, ValueWithOrigin};

use super::des::Request;
use super::descriptor::ByteOrder;
use super::framing::Framing;
use super::id::Service;
use super::node::{Heartbeat, Mode};
use crate::time::Duration;
use core::ops::RangeInclusive;
use keys::ValueOrigins;
#[cfg(feature = "std")]
use serde::Deserialize;
#[cfg(feature = "std")]
use std::collections::BTreeMap;

/// All values of the profile. Build one from [`Profile::default`] and change its fields.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
#[cfg_attr(feature = "std", derive(Deserialize), serde(default, deny_unknown_fields))]
pub struct Profile {
    /// Service numbers of the platform's own services.
    pub services: ServicesProfile,
    /// Service numbers of the descriptor fields; an empty request reads one.
    pub descriptor: DescriptorProfile,
    /// Service numbers of commands.
    pub commands: CommandsProfile,
    /// Service numbers that change the configuration of a device.
    pub writes: WritesProfile,
    /// Layout and period of the heartbeat, and whether descan sends one.
    pub heartbeat: HeartbeatProfile,
    /// Framings of DES messages.
    pub framing: FramingChoice,
    /// ISO 15765-2 parameters.
    pub isotp: IsotpProfile,
    /// Requests and responses.
    pub calls: CallsProfile,
    /// ERR bit of descan's requests.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::bit"))]
    pub request_err: bool,
    /// Codes of the modes.
    pub modes: ModesProfile,
    /// Alphabet of the UID.
    pub uid: UidProfile,
    /// Names of services on the Traffic page, by service number.
    #[cfg(feature = "std")]
    #[serde(deserialize_with = "file::service_names")]
    pub service_names: BTreeMap<u16, String>,
    /// Names of DEBUG messages, by their code.
    #[cfg(feature = "std")]
    #[serde(deserialize_with = "file::service_names")]
    pub debug_names: BTreeMap<u16, String>,
    /// Where each value comes from.
    #[cfg_attr(feature = "std", serde(skip))]
    origins: ValueOrigins,
}

impl Default for Profile {
    fn default() -> Self {
        Self {
            services: ServicesProfile::default(),
            descriptor: DescriptorProfile::default(),
            commands: CommandsProfile::default(),
            writes: WritesProfile::default(),
            heartbeat: HeartbeatProfile::default(),
            framing: FramingChoice::Auto,
            isotp: IsotpProfile::default(),
            calls: CallsProfile::default(),
            request_err: false,
            modes: ModesProfile::default(),
            uid: UidProfile::default(),
            #[cfg(feature = "std")]
            service_names: BTreeMap::new(),
            #[cfg(feature = "std")]
            debug_names: BTreeMap::new(),
            origins: ValueOrigins::default(),
        }
    }
}

impl Profile {
    /// Returns the service number of heartbeats, MSG_SRV_HR.
    pub fn heartbeat_service(&self) -> Service {
        Service::from_bits(self.services.heartbeat)
    }

    /// Reads a heartbeat's data, which may be shorter than the layout.
    pub fn heartbeat_of(&self, data: &[u8]) -> Heartbeat {
        Heartbeat::decode(data, &self.heartbeat, &self.modes.codes())
    }

    /// Returns the service number of DES.
    pub fn des_service(&self) -> Service {
        Service::from_bits(self.services.des)
    }

    /// Returns the framings of a request to a device: the one `known` from its responses, else
    /// those of the profile (protocol §3.3).
    pub fn framings(&self, known: Option<Framing>) -> &'static [Framing] {
        const BOTH: [Framing; 2] = [Framing::Isotp, Framing::Raw];
        match (known, self.framing) {
            (Some(Framing::Isotp), _) | (None, FramingChoice::Isotp) => &BOTH[..1],
            (Some(Framing::Raw), _) | (None, FramingChoice::Raw) => &BOTH[1..],
            (None, FramingChoice::Auto) => &BOTH,
        }
    }

    /// Returns the data of a request's frame in that framing, and how many of the bytes to send.
    pub fn request_bytes(request: Request, framing: Framing) -> ([u8; 5], usize) {
        let [d, e, s, kind] = request.encode();
        match framing {
            Framing::Isotp => ([4, d, e, s, kind], 5),
            Framing::Raw => ([d, e, s, kind, 0], 4),
        }
    }
}

/// Service numbers of the platform, 0 to 0x3FF.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "std", derive(Deserialize), serde(default, deny_unknown_fields))]
pub struct ServicesProfile {
    /// MSG_SRV_HR. Assumed 0x001.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub heartbeat: u16,
    /// DES. Assumed 0x002.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub des: u16,
    /// Common configuration commands. Assumed 0x010.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub config: u16,
    /// MSG_SRV_CFG_MASK. Assumed 0x3F0.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub config_mask: u16,
}

impl Default for ServicesProfile {
    fn default() -> Self {
        Self { heartbeat: 0x001, des: 0x002, config: 0x010, config_mask: 0x3F0 }
    }
}

/// Service numbers of the descriptor fields (protocol §7.4), and how their values are read; all assumed.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "std", derive(Deserialize), serde(default, deny_unknown_fields))]
pub struct DescriptorProfile {
    /// DEV_INFO_GID: type of the device.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub gid: u16,
    /// DEV_CFG_UID.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub uid: u16,
    /// DEV_INFO_SN: serial number.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub sn: u16,
    /// DEV_INFO_FW_MAJ and DEV_INFO_FW_MIN: firmware version.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub fw: u16,
    /// Capabilities.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub caps: u16,
    /// Bit rate.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub bspd: u16,
    /// DEV_CFG_ADDR: configured address.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub addr: u16,
    /// DEV_CFG_AUTOSTART.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub autostart: u16,
    /// Order of the bytes of numbers. Assumed: the lowest first.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::byte_order"))]
    pub byte_order: ByteOrder,
    /// True: descan reads the fields whose numbers a file sets, after it has read the name.
    pub auto: bool,
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
            byte_order: ByteOrder::Little,
            auto: false,
        }
    }
}

/// Service numbers of commands, assumed where there is one.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "std", derive(Deserialize), serde(default, deny_unknown_fields))]
pub struct CommandsProfile {
    /// The identify command, TEST in CAN platform §3.2: the device blinks or beeps.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub identify: u16,
    /// Changes the mode; one byte of data, the mode's code.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service"))]
    pub mode: u16,
    /// Restarts the device; no data. None is built in.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service_or_none"))]
    pub reboot: Option<u16>,
}

impl Default for CommandsProfile {
    fn default() -> Self {
        Self { identify: 0x018, mode: 0x019, reboot: None }
    }
}

/// Service numbers that change the configuration of a device; none is built in. The data of a request
/// are the new value.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
#[cfg_attr(feature = "std", derive(Deserialize), serde(default, deny_unknown_fields))]
pub struct WritesProfile {
    /// DEV_CFG_ADDR.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service_or_none"))]
    pub address: Option<u16>,
    /// DEV_CFG_BSPD.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::service_or_none"))]
    pub bitrate: Option<u16>,
    /// When a new value acts. Assumed: at once.
    pub effect: WriteEffect,
}

/// When a device acts by a new value of its configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[cfg_attr(feature = "std", derive(Deserialize), serde(rename_all = "lowercase"))]
pub enum WriteEffect {
    /// At once.
    #[default]
    Now,
    /// At its next restart.
    Restart,
}

impl WriteEffect {
    /// Both, in the order of a profile's comment.
    pub const ALL: [Self; 2] = [Self::Now, Self::Restart];

    /// The word in a file.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Now => "now",
            Self::Restart => "restart",
        }
    }
}

/// Layout and period of the heartbeat (protocol §7.2). Offsets in bytes; `None`: the heartbeat does
/// not carry the field.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "std", derive(Deserialize), serde(default, deny_unknown_fields))]
pub struct HeartbeatProfile {
    /// Offset of the six bytes of the UID. Assumed 0.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::offset"))]
    pub uid_offset: Option<u8>,
    /// Offset of the mode's code. Assumed 6.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::offset"))]
    pub mode_offset: Option<u8>,
    /// Offset of the error code. Assumed 7.
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::offset"))]
    pub error_offset: Option<u8>,
    /// BUS_CFG_HR_TIME in milliseconds, 10 to 60,000; 1,000 in CAN platform §3.1.7.
    pub period_ms: u32,
    /// Whether descan sends heartbeats.
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
    /// Periods that a profile may have, in milliseconds.
    pub const PERIODS: RangeInclusive<u32> = 10..=60_000;

    /// Returns the heartbeat period, BUS_CFG_HR_TIME.
    pub fn period(&self) -> Duration {
        Duration::from_millis(u64::from(self.period_ms))
    }
}

/// Whether descan sends heartbeats (protocol §6.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Announce {
    /// Only if `services.heartbeat` is given, or after a heartbeat that matches the values: an assumed
    /// service number might be a command of some device.
    #[default]
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// Framings that descan reads and sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[cfg_attr(feature = "std", derive(Deserialize), serde(rename_all = "lowercase"))]
pub enum FramingChoice {
    /// Both, detected per device from its responses (protocol §3.3).
    #[default]
    Auto,
    /// ISO-TP only.
    Isotp,
    /// Raw only.
    Raw,
}

/// ISO 15765-2 parameters.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "std", derive(Deserialize), serde(default, deny_unknown_fields))]
pub struct IsotpProfile {
    /// Padding byte of FD frames. Default 0xCC.
    pub fd_padding: u8,
    /// Block size of descan's flow control; 0 = no further flow control.
    pub block_size: u8,
    /// STmin of descan's flow control, as coded.
    pub st_min: u8,
}

impl Default for IsotpProfile {
    fn default() -> Self {
        Self { fd_padding: 0xCC, block_size: 0, st_min: 0 }
    }
}

/// Requests and the responses to them.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "std", derive(Deserialize), serde(default, deny_unknown_fields))]
pub struct CallsProfile {
    /// Time after which a request counts as unanswered, in milliseconds. Assumed: 1000.
    pub timeout_ms: u32,
}

impl Default for CallsProfile {
    fn default() -> Self {
        Self { timeout_ms: 1000 }
    }
}

impl CallsProfile {
    /// Time after which a request counts as unanswered.
    pub fn timeout(&self) -> Duration {
        Duration::from_millis(u64::from(self.timeout_ms))
    }
}

/// Codes of the modes, assumed 0 to 6 in the order of CAN platform §3.2.4.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(
    feature = "std",
    derive(Deserialize),
    serde(default, deny_unknown_fields, rename_all = "UPPERCASE")
)]
pub struct ModesProfile {
    /// Code of INIT.
    pub init: u8,
    /// Code of ARSLV.
    pub arslv: u8,
    /// Code of CFG.
    pub cfg: u8,
    /// Code of BOOT.
    pub boot: u8,
    /// Code of WORK.
    pub work: u8,
    /// Code of UFUNC.
    pub ufunc: u8,
    /// Code of IDLE.
    pub idle: u8,
}

impl Default for ModesProfile {
    fn default() -> Self {
        Self { init: 0, arslv: 1, cfg: 2, boot: 3, work: 4, ufunc: 5, idle: 6 }
    }
}

impl ModesProfile {
    /// Returns the codes in the order of [`super::node::Mode::ALL`].
    pub fn codes(&self) -> [u8; 7] {
        [self.init, self.arslv, self.cfg, self.boot, self.work, self.ufunc, self.idle]
    }

    /// Returns the mode with this code; `None` if no mode has it.
    pub fn mode(&self, code: u8) -> Option<Mode> {
        Mode::from_code(code, &self.codes())
    }
}

/// The 64 characters of a UID; assumed: value + 0x20, which is space to underscore.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "std", derive(Deserialize), serde(default, deny_unknown_fields))]
pub struct UidProfile {
    #[cfg_attr(feature = "std", serde(deserialize_with = "file::alphabet"))]
    alphabet: [char; 64],
}

impl Default for UidProfile {
    fn default() -> Self {
        Self { alphabet: core::array::from_fn(|value| char::from(value as u8 + 0x20)) }
    }
}

impl UidProfile {
    /// Returns the character of a six-bit value; higher bits are ignored.
    pub fn character(&self, value: u8) -> char {
        self.alphabet[usize::from(value & 0x3F)]
    }

    /// Returns the six-bit value of a character; `None` if it is not in the alphabet.
    pub fn value(&self, character: char) -> Option<u8> {
        self.alphabet.iter().position(|&known| known == character).map(|at| at as u8)
    }
}
