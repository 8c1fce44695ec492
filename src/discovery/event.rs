//! What happened on a bus, as it happened: the timeline's and `watch`'s raw material.

use super::device::{DeviceId, Presence};
use super::finding::{Confidence, FindingKey};
use crate::text::Name;
use crate::time::Instant;
use crate::wire::id::Address;
use crate::wire::node::Mode;

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
    /// It is at another address than before.
    Moved {
        /// The address before.
        from: Address,
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
