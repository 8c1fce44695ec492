//! What happened on a bus, as it happened: the timeline's and `watch`'s raw material.

use super::device::{DeviceId, Presence};
use crate::finding::{Confidence, FindingKey};
use crate::text::Name;
use crate::time::Instant;
use crate::wire::id::Address;
use crate::wire::node::{Mode, Uid};

/// Something that happened to a device or on the bus.
#[derive(Clone, Debug)]
pub struct Event {
    /// When.
    pub time: Instant,
    /// To which device, where it is about one.
    pub device: Option<DeviceId>,
    /// Its address then.
    pub address: Option<Address>,
    /// Its name then.
    pub name: Option<Name>,
    /// What.
    pub kind: EventKind,
}

/// The other one of two that want the same address, as far as it is known then.
#[derive(Clone, Debug)]
pub struct ConflictParty {
    /// Its id.
    pub device: DeviceId,
    /// Its name.
    pub name: Option<Name>,
    /// Its UID, where that is not blank.
    pub uid: Option<Uid>,
}

/// What happened.
#[derive(Clone, Debug)]
pub enum EventKind {
    /// A frame of a node not known before.
    Appeared,
    /// Its name is known now.
    Named,
    /// Its services are known now, or are others than before.
    Services {
        /// How many.
        count: usize,
        /// Whether they differ from what was known before.
        changed: bool,
    },
    /// It changed its mode.
    Mode {
        /// The mode before, where it was known.
        from: Option<Mode>,
        /// The mode now.
        to: Mode,
    },
    /// It claims the address: a heartbeat in ARSLV.
    Claimed {
        /// The UID it claims with, where that is not blank.
        uid: Option<Uid>,
        /// Who beats from the address already, where somebody does.
        holder: Option<ConflictParty>,
        /// Whether it is only likely that it is another device than the holder: neither has a
        /// UID that tells.
        inferred: bool,
    },
    /// It used the address, and fell silent there when another one used it.
    GaveWay {
        /// Its UID, where that is not blank.
        uid: Option<Uid>,
        /// Who beats from the address now.
        to: Option<ConflictParty>,
        /// Whether it is only likely: it was not heard elsewhere since, or is known by its name
        /// alone.
        inferred: bool,
    },
    /// It is at another address than before.
    Moved {
        /// The address before.
        from: Address,
    },
    /// What was told of another id before was told of this device.
    Joined {
        /// That id: of a row that is gone, or of nobody known then.
        was: DeviceId,
        /// Only what was told before: since then the row speaks for another device.
        before: Option<Instant>,
    },
    /// It started anew.
    Rebooted,
    /// Its presence changed to stale, silent, asleep or lost.
    Presence(Presence),
    /// It is back after it was stale, silent, asleep or lost.
    Returned {
        /// What it was before.
        was: Presence,
    },
    /// A finding appeared or its confidence changed.
    Finding {
        /// Which.
        key: FindingKey,
        /// How sure it is now.
        confidence: Confidence,
    },
    /// We took an address of our own.
    OwnAddress(Address),
    /// We gave our address up: somebody else uses it.
    OwnAddressLost(Address),
    /// We find no address: the fixed one is used by somebody else, or, without one, all are used.
    NoAddress(Option<Address>),
    /// Nobody acknowledges our frames: nothing more is sent until somebody does.
    NobodyAcknowledges,
    /// Our frames are acknowledged (again).
    Acknowledged,
    /// A DEBUG message.
    Debug {
        /// Its message code.
        code: u16,
        /// Its parameters.
        data: Vec<u8>,
    },
}
