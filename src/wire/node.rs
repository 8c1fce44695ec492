//! A node's mode, UID (DEV_CFG_UID) and heartbeat (MSG_SRV_HR).
//!
//! Source: protocol §7 (CAN platform §3.2 and §3.2.4). The layout of the heartbeat and the alphabet
//! of the UID are not specified there; they are fields of [`super::profile::Profile`].

use super::profile::{HeartbeatProfile, UidProfile};
use core::fmt::{self, Write as _};

/// Modes of a node (protocol §7.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Mode {
    /// Just powered up, or disconnected from the bus.
    Init,
    /// Resolving its address.
    Arslv,
    /// Waits for configuration.
    Cfg,
    /// Waits for configuration; the firmware is missing or damaged.
    Boot,
    /// Working.
    Work,
    /// Working, with an error that prevents its task.
    Ufunc,
    /// Asleep, as far as the hardware allows.
    Idle,
}

impl Mode {
    /// All modes, in the order of CAN platform §3.2.4.
    pub const ALL: [Mode; 7] =
        [Mode::Init, Mode::Arslv, Mode::Cfg, Mode::Boot, Mode::Work, Mode::Ufunc, Mode::Idle];

    /// Returns the name in CAN platform §3.2.4 without `DEV_MODE_`.
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

    /// Returns the mode with that name, in capitals.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.name() == name)
    }

    /// Returns the mode with a code; `None` if none has it. `codes`: those of [`Mode::ALL`], in that order.
    pub fn from_code(code: u8, codes: &[u8; 7]) -> Option<Self> {
        codes.iter().position(|known| *known == code).map(|at| Self::ALL[at])
    }

    /// Returns true if the U bit is 0 in this mode; `None` for IDLE, where it may be either
    /// (protocol §1.3).
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

/// DEV_CFG_UID: six bytes that hold eight characters of six bits (protocol §7.3).
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Uid(pub [u8; 6]);

impl Uid {
    /// Bytes of a UID.
    pub const LEN: usize = 6;
    /// UID of all 00.
    pub const BLANK: Self = Self([0; 6]);

    /// Returns the UID, unless it is blank.
    pub fn not_blank(self) -> Option<Self> {
        (!self.is_blank()).then_some(self)
    }

    /// Returns true if all bits are 0 or all are 1: no UID was ever assigned. Blank UIDs identify
    /// no device.
    pub fn is_blank(self) -> bool {
        self.0 == [0; 6] || self.0 == [0xFF; 6]
    }

    /// Returns the eight six-bit values, first character first.
    pub fn sextets(self) -> [u8; 8] {
        let bits = self.0.iter().fold(0u64, |bits, &byte| bits << 8 | u64::from(byte));
        core::array::from_fn(|at| (bits >> (42 - 6 * at) & 0x3F) as u8)
    }

    /// Returns the UID of eight six-bit values, first character first; higher bits are ignored.
    pub fn from_sextets(sextets: [u8; 8]) -> Self {
        let bits = sextets.iter().fold(0u64, |bits, &six| bits << 6 | u64::from(six & 0x3F));
        Self(core::array::from_fn(|at| (bits >> (40 - 8 * at)) as u8))
    }

    /// Returns the text in the profile's alphabet, without trailing spaces; empty if blank.
    pub fn text(self, alphabet: &UidProfile) -> UidText {
        let characters = self.sextets().map(|six| alphabet.character(six));
        let last = characters.iter().rposition(|&character| character != ' ');
        let len = if self.is_blank() { 0 } else { last.map_or(0, |at| at + 1) };
        UidText { characters, len }
    }

    /// Returns the UID of `text`; `None` if it has more than eight characters or one that is not in
    /// the alphabet.
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

/// The text of a [`Uid`]: at most eight characters, printable if the alphabet is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UidText {
    characters: [char; 8],
    len: usize,
}

impl UidText {
    /// Returns true if the text begins with `prefix`.
    pub fn starts_with(&self, prefix: &str) -> bool {
        let mut characters = self.characters[..self.len].iter();
        prefix.chars().all(|character| characters.next() == Some(&character))
    }
}

impl fmt::Display for UidText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.characters[..self.len].iter().try_for_each(|&character| f.write_char(character))
    }
}

/// Content of a heartbeat (protocol §7.2). A field is `None` if the heartbeat is too short for it
/// or does not carry it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Heartbeat {
    /// UID.
    pub uid: Option<Uid>,
    /// Mode; also `None` if its code is unknown.
    pub mode: Option<Mode>,
    /// Error code; 0 = no error.
    pub error: Option<u8>,
}

impl Heartbeat {
    /// Reads a heartbeat's data, which may be shorter than the layout. `modes`: the codes of
    /// [`Mode::ALL`], in that order.
    pub fn decode(data: &[u8], layout: &HeartbeatProfile, modes: &[u8; 7]) -> Self {
        let byte = |offset: Option<u8>| data.get(usize::from(offset?)).copied();
        let uid = layout.uid_offset.and_then(|offset| {
            data.get(usize::from(offset)..)?.first_chunk().map(|bytes| Uid(*bytes))
        });
        let mode = byte(layout.mode_offset).and_then(|code| Mode::from_code(code, modes));
        Self { uid, mode, error: byte(layout.error_offset) }
    }

    /// Returns the heartbeat's data, and how many of the bytes to send. Fields beyond the eighth
    /// byte are left out.
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
