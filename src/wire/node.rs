//! What a node says of itself: its mode, its heartbeat (MSG_SRV_HR) and its DEV_CFG_UID.
//!
//! Source: the CAN platform, 3.2 (descriptor fields) and 3.2.4 (modes). The layout of the
//! heartbeat is not given there; it comes from the [`super::profile::Profile`].

use super::profile::{HeartbeatProfile, UidProfile};
use std::fmt;

/// The modes of 3.2.4, without `DEV_MODE_`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Mode {
    /// Just powered, or cut off from the bus.
    Init,
    /// Resolving its address.
    Arslv,
    /// To be configured.
    Cfg,
    /// To be configured, its firmware missing or damaged.
    Boot,
    /// Working.
    Work,
    /// Working, with an error that keeps it from its task.
    Ufunc,
    /// Asleep as far as it can be.
    Idle,
}

impl Mode {
    /// All modes, in the order of 3.2.4.
    pub const ALL: [Mode; 7] =
        [Mode::Init, Mode::Arslv, Mode::Cfg, Mode::Boot, Mode::Work, Mode::Ufunc, Mode::Idle];

    /// The name as the description has it.
    pub const fn name(self) -> &'static str {
        match self {
            Mode::Init => "INIT",
            Mode::Arslv => "ARSLV",
            Mode::Cfg => "CFG",
            Mode::Boot => "BOOT",
            Mode::Work => "WORK",
            Mode::Ufunc => "UFUNC",
            Mode::Idle => "IDLE",
        }
    }

    /// The mode of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.name() == name)
    }

    /// Whether U = 0 in this mode; `None` for IDLE, where the description leaves it open.
    pub const fn is_working(self) -> Option<bool> {
        match self {
            Mode::Work | Mode::Ufunc => Some(true),
            Mode::Idle => None,
            _ => Some(false),
        }
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// DEV_CFG_UID: six bytes that hold eight characters of six bits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Uid(pub [u8; 6]);

impl Uid {
    /// All zeros or all ones: a board that was never given one. Evidence of nothing.
    pub fn is_blank(self) -> bool {
        self.0 == [0; 6] || self.0 == [0xFF; 6]
    }

    /// The eight six-bit values, first character first.
    pub fn sextets(self) -> [u8; 8] {
        let bits = self.0.iter().fold(0u64, |bits, &byte| bits << 8 | u64::from(byte));
        std::array::from_fn(|at| (bits >> (42 - 6 * at) & 0x3F) as u8)
    }

    /// The UID of eight six-bit values.
    pub fn from_sextets(sextets: [u8; 8]) -> Self {
        let bits = sextets.iter().fold(0u64, |bits, &six| bits << 6 | u64::from(six & 0x3F));
        Self(std::array::from_fn(|at| (bits >> (40 - 8 * at)) as u8))
    }

    /// As text in the profile's alphabet, without trailing spaces; empty when blank.
    pub fn text(self, alphabet: &UidProfile) -> String {
        if self.is_blank() {
            return String::new();
        }
        let text: String = self.sextets().iter().map(|&six| alphabet.character(six)).collect();
        text.trim_end_matches(' ').to_owned()
    }

    /// The UID whose text is `text`, if it has at most eight characters, all in the alphabet.
    pub fn parse(text: &str, alphabet: &UidProfile) -> Option<Self> {
        let mut sextets = [alphabet.value(' ').unwrap_or(0); 8];
        for (at, character) in text.chars().enumerate() {
            *sextets.get_mut(at)? = alphabet.value(character)?;
        }
        Some(Self::from_sextets(sextets))
    }
}

impl fmt::Debug for Uid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// What a heartbeat says; what it is too short for is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Heartbeat {
    /// DEV_CFG_UID.
    pub uid: Option<Uid>,
    /// The mode, where its code is one.
    pub mode: Option<Mode>,
    /// The error code.
    pub error: Option<u8>,
}

impl Heartbeat {
    /// Reads a heartbeat's data. Shorter ones than the layout are legal.
    pub fn decode(data: &[u8], layout: &HeartbeatProfile, modes: &[u8; 7]) -> Self {
        let byte = |offset: Option<u8>| data.get(usize::from(offset?)).copied();
        let uid = layout.uid_offset.and_then(|offset| {
            data.get(usize::from(offset)..)?.first_chunk().map(|bytes| Uid(*bytes))
        });
        let mode = byte(layout.mode_offset)
            .and_then(|code| modes.iter().position(|&known| known == code).map(|at| Mode::ALL[at]));
        Self { uid, mode, error: byte(layout.error_offset) }
    }

    /// The heartbeat's data (at most eight bytes), and how many of them count.
    pub fn encode(&self, layout: &HeartbeatProfile, modes: &[u8; 7]) -> ([u8; 8], usize) {
        let mut data = [0; 8];
        let mut len = 0;
        let mut put = |offset: Option<u8>, bytes: &[u8]| {
            if let Some(at) = offset.map(usize::from)
                && let Some(place) = data.get_mut(at..at + bytes.len())
            {
                place.copy_from_slice(bytes);
                len = len.max(at + bytes.len());
            }
        };
        if let Some(uid) = self.uid {
            put(layout.uid_offset, &uid.0);
        }
        if let Some(mode) = self.mode {
            put(layout.mode_offset, &[modes[mode as usize]]);
        }
        if let Some(error) = self.error {
            put(layout.error_offset, &[error]);
        }
        (data, len)
    }
}
