//! Why a step of a plan is possible, and why a device has none, in words.

use crate::wire::descriptor::AddressSetting;
use crate::wire::id::Address;
use std::fmt;

/// Why a step can be done when it is its turn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StepReason {
    /// Its address is free from the start.
    Free(Address),
    /// Its address is free after the step with this place.
    After(usize),
    /// It makes room for a device that is in its place, while its own address is used.
    Detour {
        /// The free address.
        through: Address,
        /// Name of the device that is at its address.
        holder: String,
        /// Number of devices of the cycle.
        devices: usize,
    },
    /// It stays at its address, where it has another setting.
    Setting(AddressSetting),
    /// It stays at its address, and it is not known what it has stored.
    Unclear,
    /// It has the setting already, and has not restarted since.
    Restart,
}

impl fmt::Display for StepReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Free(address) => write!(f, "{address} is free"),
            Self::After(step) => write!(f, "after step {}", step + 1),
            Self::Detour { through, holder, devices: 2 } => {
                write!(f, "through free {through}: swaps with {holder}")
            }
            Self::Detour { through, devices, .. } => {
                write!(f, "through free {through}: cycle of {devices}")
            }
            Self::Setting(setting) => write!(f, "its setting is {setting}"),
            Self::Unclear => f.write_str("its setting is not known"),
            Self::Restart => f.write_str("stored already: it restarts"),
        }
    }
}

/// Why a device has no step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LeftOutReason {
    /// It has its address.
    AlreadyThere,
    /// Its setting is stored, and in force after its restart.
    Stored,
    /// Another device uses its address: a write would reach both.
    Shared(Address),
    /// Its name or its UID is not that of its entry: two devices may be at its address.
    Another(Address),
    /// Its UID is at another address, too.
    SameUid(Address),
    /// Its entry has a UID, and none was heard from it: it may be another device.
    UidNotHeard,
    /// Its entry in des.json has a mistake.
    WrongEntry,
    /// An earlier entry is about the same device.
    ListedTwice,
    /// Its entry has no UID, and several devices or entries have its name.
    SeveralNamed,
    /// It is not on the bus.
    NotPresent,
    /// Neither UID nor name is known: it would not be recognised.
    NoIdentity,
    /// It is a debug device.
    Debug,
    /// It is to have descan's own address.
    OwnAddress,
    /// This device is to have the same address.
    Wanted(String),
    /// A device with this name uses the address, or has it stored, and stays there.
    Held(Address, String),
    /// It is in a cycle of devices, and no address is free.
    NoFreeAddress,
    /// The user left it out.
    ByUser,
}

impl LeftOutReason {
    /// Returns true if nothing remains to be done.
    pub const fn is_done(&self) -> bool {
        matches!(self, Self::AlreadyThere)
    }

    /// The word in files and JSON.
    pub const fn word(&self) -> &'static str {
        match self {
            Self::AlreadyThere => "already-there",
            Self::Stored => "stored",
            Self::Shared(_) => "shared-address",
            Self::Another(_) => "another-device",
            Self::SameUid(_) => "same-uid",
            Self::UidNotHeard => "uid-not-heard",
            Self::WrongEntry => "entry-mistake",
            Self::ListedTwice => "listed-twice",
            Self::SeveralNamed => "ambiguous-name",
            Self::NotPresent => "not-present",
            Self::NoIdentity => "no-identity",
            Self::Debug => "debug-device",
            Self::OwnAddress => "own-address",
            Self::Wanted(_) => "wanted-twice",
            Self::Held(..) => "address-used",
            Self::NoFreeAddress => "no-free-address",
            Self::ByUser => "by-user",
        }
    }
}

impl fmt::Display for LeftOutReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AlreadyThere => f.write_str("already there"),
            Self::Stored => f.write_str("stored: in force after its restart"),
            Self::Shared(address) => write!(f, "shares {address}: unplug one"),
            Self::Another(address) => write!(f, "at {address}: not the name and UID listed"),
            Self::SameUid(address) => write!(f, "its UID is at {address}, too"),
            Self::UidNotHeard => f.write_str("its UID was not heard"),
            Self::WrongEntry => f.write_str("its entry has a mistake"),
            Self::ListedTwice => f.write_str("listed twice"),
            Self::SeveralNamed => f.write_str("several have its name: give its UID"),
            Self::NotPresent => f.write_str("not on the bus"),
            Self::NoIdentity => f.write_str("no UID and no name"),
            Self::Debug => f.write_str("a debug device"),
            Self::OwnAddress => f.write_str("descan's own address"),
            Self::Wanted(other) => write!(f, "{other} is to have it, too"),
            Self::Held(address, holder) => write!(f, "{address} is used by {holder}"),
            Self::NoFreeAddress => f.write_str("a cycle, and no address is free"),
            Self::ByUser => f.write_str("left out by you"),
        }
    }
}
