//! Frames that a log marks as sent: by an inspector that recorded it, or by a device on the same
//! machine.
//!
//! An inspector sends DES requests and the heartbeat of descan; any other unsolicited frame, or a
//! heartbeat with another UID, shows a device, whose frames count as received. The frames of an
//! inspector count as descan's own, so that a replay shows what the inspector showed.

use super::local_node::is_inspector_uid;
use super::observation::{Observation, ObservationKind, PlatformContent};
use crate::wire::id::Address;
use crate::wire::profile::Profile;

/// Sender of the frames that a log marks as sent, by their address.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Sender {
    #[default]
    Unknown,
    Inspector,
    Device,
}

/// Senders of the frames that a log marks as sent.
#[derive(Clone, Debug)]
pub(super) struct RecordedNodes {
    senders: [Sender; Address::COUNT],
    /// True if one of them is an inspector.
    has_inspector: bool,
    /// Address of the last frame of an inspector, unless another node used it since.
    address: Option<Address>,
}

impl RecordedNodes {
    pub fn new() -> Self {
        Self { senders: [Sender::Unknown; Address::COUNT], has_inspector: false, address: None }
    }

    /// Returns true if the log has frames of the inspector that recorded it.
    pub fn has_inspector(&self) -> bool {
        self.has_inspector
    }

    /// Returns the address of the inspector.
    pub fn address(&self) -> Option<Address> {
        self.address
    }

    /// Notes that another node used the address of the inspector, which gives it up.
    pub fn forget_address(&mut self) {
        self.address = None;
    }

    /// Returns true if a frame that the log marks as sent is one of an inspector.
    pub fn is_from_inspector(&mut self, observation: &Observation<'_>, profile: &Profile) -> bool {
        let ObservationKind::Platform(header, content) = observation.kind else { return false };
        let sender = &mut self.senders[header.source.index()];
        *sender = match (content, *sender) {
            (PlatformContent::Heartbeat(heartbeat), _) if header.response => {
                let is_inspector =
                    heartbeat.uid.is_some_and(|uid| is_inspector_uid(uid, &profile.uid));
                if is_inspector { Sender::Inspector } else { Sender::Device }
            }
            (PlatformContent::Request(_), Sender::Unknown) => Sender::Inspector,
            (_, Sender::Unknown) => Sender::Device,
            (_, known) => known,
        };
        let is_inspector = *sender == Sender::Inspector;
        if is_inspector {
            (self.has_inspector, self.address) = (true, Some(header.source));
        }
        is_inspector
    }
}
