//! Heartbeats of an address in the capture, newest first.
//!
//! Follows the links from each frame to the one before with the same identifier, so a walk costs as
//! many steps as there are heartbeats. Heartbeats that are not broadcast, and those before a gap of
//! the capture, are not found.

use super::Traffic;
use super::identifiers::{IdentifierKey, IdentifierKind};
use crate::frame::{BusIndex, CanId};
use crate::time::Instant;
use crate::wire::id::{Address, Header};
use crate::wire::node::{Mode, Uid};
use crate::wire::profile::Profile;
use std::sync::Arc;

/// A heartbeat in the capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CapturedHeartbeat {
    /// Number of its frame in the capture.
    pub number: u64,
    /// Time of its frame.
    pub time: Instant,
    /// UID; `None` if the heartbeat is too short for it.
    pub uid: Option<Uid>,
    /// Mode; `None` if the heartbeat is too short for it, and if its code is unknown.
    pub mode: Option<Mode>,
    /// True if the sender is in a working mode (U = 0).
    pub is_working: bool,
}

/// The walk through the heartbeats of an address, newest first.
#[derive(Debug)]
pub struct CapturedHeartbeats<'a> {
    traffic: &'a Traffic,
    profile: Arc<Profile>,
    /// The next frame of each identifier.
    heads: Vec<u64>,
}

impl Traffic {
    /// Heartbeats of an address with frame numbers before `end`, newest first.
    pub fn heartbeats(
        &self,
        profile: Arc<Profile>,
        bus: BusIndex,
        address: Address,
        end: u64,
    ) -> CapturedHeartbeats<'_> {
        let service = profile.heartbeat_service();
        let mut walk = CapturedHeartbeats { traffic: self, profile, heads: Vec::new() };
        for flags in 0..32_u8 {
            let header = Header {
                from_non_working: flags & 1 != 0,
                to_non_working: flags & 2 != 0,
                response: flags & 4 != 0,
                broadcast: true,
                no_error: flags & 8 != 0,
                source: address,
                destination: Address::from_bits(0),
                service,
            };
            let id = CanId::Extended(header.encode());
            let is_fd = flags & 16 != 0;
            let key = IdentifierKey { bus, id, kind: IdentifierKind::Data, fd: is_fd };
            let mut number = self.identifiers.get(&key).map(|row| row.number);
            while number.is_some_and(|number| number >= end) {
                number = number.and_then(|number| self.capture.previous(number));
            }
            walk.heads.extend(number);
        }
        walk
    }
}

impl Iterator for CapturedHeartbeats<'_> {
    type Item = CapturedHeartbeat;

    fn next(&mut self) -> Option<CapturedHeartbeat> {
        let newest = self.heads.iter_mut().max()?;
        let number = *newest;
        if let Some(previous) = self.traffic.capture.previous(number) {
            *newest = previous;
        } else {
            self.heads.retain(|&head| head != number);
        }
        let Some(frame) = self.traffic.capture.get(number) else {
            return self.next();
        };
        let CanId::Extended(id) = frame.id else { return self.next() };
        let heartbeat = self.profile.heartbeat_of(frame.data());
        Some(CapturedHeartbeat {
            number,
            time: frame.time,
            uid: heartbeat.uid,
            mode: heartbeat.mode,
            is_working: !Header::decode(id).from_non_working,
        })
    }
}
