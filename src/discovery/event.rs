//! Events of one bus, in the order in which they occur, for the timeline and for `watch`.

use super::device::{DeviceId, Presence};
use super::device_requests::{RequestId, RequestOutcome};
use super::frame_sequence::{SequenceEnd, SequenceId};
use crate::finding::{FindingKey, FindingState};
use crate::frame::Frame;
use crate::text::Name;
use crate::time::Instant;
use crate::wire::descriptor::DescriptorField;
use crate::wire::id::Address;
use crate::wire::node::{Mode, Uid};

/// An event of a device or of the bus, with its data as of its time.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Event {
    /// Time of the event.
    pub time: Instant,
    /// Device concerned; `None` where the event is about the bus.
    pub device: Option<DeviceId>,
    /// Address of the device at that time.
    pub address: Option<Address>,
    /// Name of the device at that time; `None` if unknown.
    pub name: Option<Name>,
    /// Kind of the event.
    pub kind: EventKind,
}

/// The other device in a conflict about an address, as far as it is known at that time.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct OtherDevice {
    /// Identity of the device.
    pub device: DeviceId,
    /// Name; `None` if unknown.
    pub name: Option<Name>,
    /// UID; `None` if blank or unknown.
    pub uid: Option<Uid>,
}

/// What is new about a service list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServicesNews {
    /// It is the first one of the device.
    First,
    /// It differs from the one known before.
    Changed,
    /// It is another one of an address that several devices use: the last of
    /// [`Device::other_services`](super::Device::other_services).
    OtherDevice,
}

/// Kind of an event, with its data.
#[derive(Clone, Debug)]
pub enum EventKind {
    /// The first frame of a node was received.
    FirstFrame,
    /// The name of the device became known.
    NameReceived,
    /// A service list of the device that was not known.
    Services {
        /// Number of services.
        count: usize,
        /// What is new about it.
        news: ServicesNews,
    },
    /// A field of its descriptor has another content than before.
    DescriptorField(DescriptorField),
    /// descan has read its descriptor.
    DescriptorRead {
        /// Number of fields with a value.
        values: usize,
        /// Number of fields that were asked for.
        fields: usize,
    },
    /// A request to the device ended ([`Engine::request`](super::Engine::request)).
    RequestEnded {
        /// Identity of the request.
        request: RequestId,
        /// Its frame; `None` if it was not sent.
        frame: Option<Frame>,
        /// How it ended.
        outcome: RequestOutcome,
    },
    /// A frame of a sequence is on the bus ([`Engine::send_frames`](super::Engine::send_frames)).
    FrameSent {
        /// Identity of the sequence.
        sequence: SequenceId,
        /// Number of the copy, from 1.
        copy: u32,
        /// The frame.
        frame: Frame,
    },
    /// A sequence of frames ended.
    SequenceEnded {
        /// Identity of the sequence.
        sequence: SequenceId,
        /// Number of copies that are on the bus.
        copies: u32,
        /// Why it ended.
        why: SequenceEnd,
    },
    /// The device changed its mode.
    Mode {
        /// Previous mode; `None` if unknown.
        from: Option<Mode>,
        /// Present mode.
        to: Mode,
    },
    /// The device claimed its address: a heartbeat in ARSLV (protocol §7.5).
    Claimed {
        /// UID in the claim; `None` if blank.
        uid: Option<Uid>,
        /// Device that sends heartbeats from the address already, if any.
        holder: Option<OtherDevice>,
        /// True if it is only likely, not certain, that it is another device than the holder:
        /// neither has a UID that shows it.
        inferred: bool,
    },
    /// The device gave up the address: it sent no more frames there after another device used it.
    GaveUpAddress {
        /// Its UID, where that is not blank.
        uid: Option<Uid>,
        /// Device that sends heartbeats from the address now; `None` if unknown.
        to: Option<OtherDevice>,
        /// True if this is only likely: the device was not seen at another address since, or is
        /// known by its name alone.
        inferred: bool,
    },
    /// The device moved to another address.
    Moved {
        /// Previous address.
        from: Address,
    },
    /// Earlier events of another id concern this device.
    IdsMerged {
        /// The other id: of a removed row, or of a node without a row.
        previous: DeviceId,
        /// Only events before this time are concerned; since then the id belongs to another device.
        /// `None`: all events.
        before: Option<Instant>,
    },
    /// The device rebooted.
    Rebooted,
    /// The heartbeats have another UID, neither of them blank: another board is at the address, or
    /// the UID of the device was set. Not while several devices are known to share the address.
    UidChanged {
        /// Previous UID.
        from: Uid,
        /// Present UID.
        to: Uid,
    },
    /// The row was removed: the bus turned out to speak another protocol, by whose frames the device
    /// seemed to be there.
    Removed,
    /// The presence changed to stale, silent, asleep or lost.
    Presence(Presence),
    /// The device is online again.
    Returned {
        /// Previous presence.
        was: Presence,
    },
    /// A finding was opened, or its state changed.
    Finding {
        /// Identity of the finding.
        key: FindingKey,
        /// Present state.
        state: FindingState,
    },
    /// descan took this address.
    OwnAddress(Address),
    /// descan gave up this address: another node uses it.
    OwnAddressLost(Address),
    /// descan has no address: the configured one is used by another node, or, with `None`, all
    /// addresses are used.
    NoAddress(Option<Address>),
    /// No node acknowledges descan's frames: it pauses sending (protocol §6.3).
    NoAck,
    /// descan's frames are acknowledged again.
    Acknowledged,
    /// A DEBUG message was received.
    DebugMessage {
        /// Message code, 10 bits.
        code: u16,
        /// Payload.
        data: Vec<u8>,
    },
}
