//! Values of the profile that the frames of a bus show (protocol §9).
//!
//! Input: the frames of a bus, in the order of their times. Output: proposals, each with its
//! evidence: the service of heartbeats and their period, the bytes of UID, mode and error code in them,
//! the service of DES and its framing, the byte order of descriptors. Bounded memory. Of the values in
//! force it knows the services of the descriptor that a file sets, and it changes none: see [`Profile::learn`](crate::wire::profile::Profile::learn).
//!
//! A value is proposed only if exactly one service, or one byte, fits its meaning.

mod byte_order;
mod enumeration;
mod heartbeat;
mod layout;
mod period;
mod search;
mod unsolicited;

pub use search::{DesSearch, SearchEnd, SearchStop};

use crate::frame::{Frame, FrameKind};
use crate::time::{Duration, Instant};
use crate::wire::framing::classify_request;
use crate::wire::id::{Address, Header, MessageType, Service};
use crate::wire::profile::{Profile, ProfileKey, ProfileValue};
use byte_order::FieldResponses;
use enumeration::DesServices;
use heartbeat::Heartbeats;
use unsolicited::UnsolicitedFrames;

/// Impossible identifiers that show another protocol, with [`MAX_IMPOSSIBLE`].
const MIN_IMPOSSIBLE: u64 = 10;
/// Largest part of the frames with impossible identifiers: in logs of other protocols with 29-bit
/// identifiers it is more than a quarter.
const MAX_IMPOSSIBLE: f64 = 0.2;

/// How sure a proposal is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Certainty {
    /// All that was received fits, but what comes later may not.
    Guess,
    /// The only value that fits, but frames of other meaning might fit too.
    Likely,
    /// No other value fits, and devices differ or changed as only this meaning explains.
    Certain,
}

impl Certainty {
    /// The word for it, on the screen and in JSON.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Guess => "guess",
            Self::Likely => "likely",
            Self::Certain => "certain",
        }
    }
}

/// A value of the profile that was learnt from frames.
#[derive(Clone, Debug, PartialEq)]
pub struct ProfileProposal {
    /// What it is the value of.
    pub key: ProfileKey,
    /// The value.
    pub value: ProfileValue,
    /// How sure it is.
    pub certainty: Certainty,
    /// What shows it, in a few words: `9 nodes, 1.00 s`.
    pub evidence: String,
    /// Some of the frames that show it, in the order of their times.
    pub frames: Vec<Frame>,
}

/// The keys whose values can be learnt.
pub const LEARNT_KEYS: [ProfileKey; 8] = [
    ProfileKey::Heartbeat,
    ProfileKey::PeriodMs,
    ProfileKey::UidOffset,
    ProfileKey::ModeOffset,
    ProfileKey::ErrorOffset,
    ProfileKey::Des,
    ProfileKey::Framing,
    ProfileKey::ByteOrder,
];

/// Frames of evidence of a proposal, at most.
const MAX_FRAMES: usize = 6;

/// Learns the profile of a bus from its frames.
#[derive(Clone, Debug, Default)]
pub struct ProfileLearner {
    frames: u64,
    impossible: u64,
    /// Addresses of nodes that sent a frame, and of those whose last one had U = 1; one bit each.
    heard: u128,
    not_working: u128,
    first: Option<Instant>,
    last: Instant,
    unsolicited: UnsolicitedFrames,
    des: DesServices,
    fields: FieldResponses,
}

impl ProfileLearner {
    /// Takes the values in force: with the services of the descriptor that a file sets, responses to reads
    /// of it show its byte order.
    pub fn set_profile(&mut self, profile: &Profile) {
        self.fields.set_profile(profile);
    }

    /// Takes a frame of the bus. Frames that descan sent are not taken for those of a device.
    pub fn handle_frame(&mut self, frame: &Frame) {
        if frame.kind == FrameKind::Error {
            return;
        }
        self.frames += 1;
        self.first.get_or_insert(frame.time);
        self.last = self.last.max(frame.time);
        let header = frame.platform_id().map(Header::decode);
        let Some(header) = header.filter(|header| header.is_conforming()) else {
            self.impossible += 1;
            return;
        };
        if !frame.is_tx && header.message_type() != MessageType::Debug {
            let node = 1 << header.source.index();
            self.heard |= node;
            self.not_working =
                self.not_working & !node | if header.from_non_working { node } else { 0 };
        }
        self.des.handle_frame(frame, header);
        self.fields.handle_frame(frame, header);
        // In a debug message SRV is the message code; a DES request is not a heartbeat.
        let is_other = header.message_type() == MessageType::Debug
            || header.response && !header.no_error
            || !header.response
                && (!header.broadcast || classify_request(frame.data(), frame.is_fd).is_some());
        if !frame.is_tx && !is_other && header.source != Address::DEBUG {
            self.unsolicited.handle_frame(frame, header);
        }
    }

    /// Number of data and remote frames that it has taken.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Time from the first to the last frame.
    pub fn duration(&self) -> Duration {
        self.first.map_or(Duration::ZERO, |first| self.last.since(first))
    }

    /// Number of frames that are not of the CAN platform.
    pub fn other_frames(&self) -> u64 {
        self.impossible
    }

    /// Returns true if the last frame of the node at an address had U = 0; `None` without a frame of it.
    pub fn is_working(&self, address: Address) -> Option<bool> {
        let node = 1u128 << address.index();
        (self.heard & node != 0).then_some(self.not_working & node == 0)
    }

    /// Returns true if nodes send frames of this service unsolicited.
    pub fn is_unsolicited_service(&self, service: Service) -> bool {
        self.unsolicited.has_service(service)
    }

    /// Returns true if the bus speaks another protocol: nothing is learnt from it.
    pub fn is_foreign(&self) -> bool {
        let share = self.impossible as f64 / self.frames.max(1) as f64;
        self.impossible >= MIN_IMPOSSIBLE && share >= MAX_IMPOSSIBLE
    }

    /// Why a value is not known, in a few words.
    pub fn why_unknown(&self, key: ProfileKey) -> String {
        let heartbeats = Heartbeats::find(&self.unsolicited, self.duration());
        let why = match key {
            _ if self.frames == 0 => "no frame was received",
            _ if self.is_foreign() => "the bus speaks another protocol",
            ProfileKey::Des => "no name request and a response with a text as name",
            ProfileKey::ByteOrder => {
                "no read of a descriptor with a given number, or plausible in both orders"
            }
            ProfileKey::Framing => "not all nodes sent a name, or not in one framing",
            ProfileKey::Heartbeat | ProfileKey::PeriodMs if heartbeats.is_none() => {
                return heartbeat::why_unknown(&self.unsolicited, self.duration());
            }
            ProfileKey::PeriodMs if heartbeats.is_some() => "heartbeats are too irregular",
            _ if heartbeats.is_none() => "heartbeats are not known",
            ProfileKey::UidOffset => "fewer than three UIDs, or several bytes may be theirs",
            ProfileKey::ModeOffset => {
                "no node began or ceased to work (U), or several bytes follow it"
            }
            ProfileKey::ErrorOffset => "no node was in UFUNC and in WORK",
            _ => "it cannot be learnt",
        };
        why.to_owned()
    }

    /// The values that the frames show, in the order of the keys' importance.
    pub fn proposals(&self) -> Vec<ProfileProposal> {
        if self.is_foreign() {
            return Vec::new();
        }
        let heartbeats = Heartbeats::find(&self.unsolicited, self.duration());
        let mut proposals = Vec::new();
        if let Some(heartbeats) = &heartbeats {
            proposals.extend(heartbeats.proposals());
            proposals.extend(layout::proposals(heartbeats));
        }
        let nodes = self.unsolicited.sources().map(|(source, ..)| source).collect::<Vec<_>>();
        proposals.extend(self.des.proposals(&nodes, heartbeats.is_some()));
        proposals.extend(self.fields.proposal());
        proposals
    }
}
