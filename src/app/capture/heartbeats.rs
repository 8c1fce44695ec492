//! Heartbeats of an address in the capture, newest first.
//!
//! Follows the links from each frame to the one before with the same identifier, so a walk costs as
//! many steps as there are heartbeats. Heartbeats that are not broadcast, and those before a gap of
//! the capture, are not found, and of a log only those within 200,000 frames, which are soon read
//! again.

use super::Traffic;
use super::identifiers::{IdentifierKey, IdentifierKind};
use crate::frame::{BusIndex, CanId};
use crate::time::Instant;
use crate::wire::id::{Address, Header};
use crate::wire::node::{Mode, Uid};
use crate::wire::profile::Profile;
use std::ops::Range;
use std::sync::Arc;

/// Frames of a log within which heartbeats are looked for: read again in about 50 ms, and kept while
/// they are shown.
const MAX_LOG_FRAMES: u64 = 200_000;

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
    /// Where the walk ends.
    first: u64,
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
        let end = end.min(self.capture.end());
        let first = self.earliest_looked_at(end);
        let mut walk = CapturedHeartbeats { traffic: self, profile, heads: Vec::new(), first };
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
            let (kind, is_masked) = (IdentifierKind::Data, true);
            let key = IdentifierKey { bus, id, kind, fd: is_fd, is_masked };
            walk.heads.extend(self.last_within(first..end, &key));
        }
        walk
    }

    fn earliest_looked_at(&self, end: u64) -> u64 {
        if self.capture.has_source() { end.saturating_sub(MAX_LOG_FRAMES) } else { 0 }
    }

    /// Moment from which on all heartbeats before frame `end` are found; `None`: from the start.
    pub fn heartbeats_found_from(&self, end: u64) -> Option<Instant> {
        let first = self.earliest_looked_at(end).max(self.capture.first());
        (first > 0).then(|| self.capture.time_of(first).unwrap_or(Instant::LATEST))
    }

    /// Number of the last stored frame with an identifier among these.
    fn last_within(&self, numbers: Range<u64>, key: &IdentifierKey) -> Option<u64> {
        let at = self.identifiers.place_of(key)?;
        let row = &self.identifiers.rows()[at];
        let last = if row.number < numbers.end {
            Some(row.number)
        } else if row.first_number < numbers.end {
            self.capture.last_within(numbers.clone(), at, key)
        } else {
            None
        };
        last.filter(|last| *last >= numbers.start)
    }
}

impl Iterator for CapturedHeartbeats<'_> {
    type Item = CapturedHeartbeat;

    fn next(&mut self) -> Option<CapturedHeartbeat> {
        let newest = self.heads.iter_mut().max()?;
        let number = *newest;
        let previous = self.traffic.capture.previous(number).filter(|it| *it >= self.first);
        if let Some(previous) = previous {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::buses::Buses;
    use crate::discovery::Config;
    use crate::frame::Frame;

    fn address(number: u8) -> Address {
        Address::from_bits(number)
    }

    fn heartbeat(millis: u64, from: u8, mode: Mode, data: &[u8]) -> Frame {
        let service = Profile::default().heartbeat_service();
        let is_working = mode.is_working() == Some(true);
        // The destination of a heartbeat is random.
        let random = (millis * 31 % 127) as u8;
        let id = Header::unsolicited(address(from), random, !is_working, service).encode();
        let mut bytes = data.to_vec();
        if data.len() == 6 {
            bytes.extend([mode as u8, 0]);
        }
        Frame::classic(id, &bytes).with_time(Instant::from_micros(millis * 1000))
    }

    fn traffic(frames: &[Frame]) -> Traffic {
        let bus = |name: &str| (name.to_owned(), Config::default());
        let buses = Buses::new(Instant::ZERO, vec![bus("can0"), bus("can1")]);
        let mut traffic = Traffic::new(1 << 20, 0);
        for frame in frames {
            traffic.push(frame, &buses);
        }
        traffic
    }

    /// Returns times in milliseconds and modes of the heartbeats of an address before a frame.
    fn walk(traffic: &Traffic, from: u8, end: u64) -> Vec<(u64, Option<Mode>)> {
        let all = traffic.heartbeats(Arc::default(), BusIndex(0), address(from), end);
        all.map(|beat| (beat.time.as_micros() / 1000, beat.mode)).collect()
    }

    #[test]
    fn walk_is_newest_first_through_all_modes() {
        let uid = *b"UID-10";
        let frames = [
            heartbeat(1000, 10, Mode::Init, &uid),
            heartbeat(2000, 10, Mode::Arslv, &uid),
            heartbeat(2500, 11, Mode::Work, &uid),
            heartbeat(3000, 10, Mode::Work, &uid),
            Frame::classic(0x0714_5101, &[1, 2, 3]).with_time(Instant::from_micros(3_500_000)),
            heartbeat(4000, 10, Mode::Work, &uid),
            heartbeat(5000, 10, Mode::Cfg, &uid),
        ];
        let traffic = traffic(&frames);
        let expected = [
            (5000, Some(Mode::Cfg)),
            (4000, Some(Mode::Work)),
            (3000, Some(Mode::Work)),
            (2000, Some(Mode::Arslv)),
            (1000, Some(Mode::Init)),
        ];
        assert_eq!(walk(&traffic, 10, u64::MAX), expected);
        // Until a past moment: the frames before it.
        assert_eq!(walk(&traffic, 10, 4), expected[2..]);
        assert_eq!(walk(&traffic, 10, 0), []);
        assert_eq!(walk(&traffic, 11, u64::MAX), [(2500, Some(Mode::Work))]);
        assert_eq!(walk(&traffic, 12, u64::MAX), []);
    }

    #[test]
    fn heartbeats_have_number_uid_and_bus() {
        let frames = [
            heartbeat(1000, 10, Mode::Work, b"UID-10"),
            heartbeat(1001, 10, Mode::Work, b"OTHER1").with_bus(BusIndex(1)),
            heartbeat(2000, 10, Mode::Work, b"short"),
        ];
        let traffic = traffic(&frames);
        let all: Vec<_> = traffic
            .heartbeats(Arc::default(), BusIndex(0), address(10), u64::MAX)
            .map(|beat| (beat.number, beat.uid, beat.is_working))
            .collect();
        assert_eq!(all, [(2, None, true), (0, Some(Uid(*b"UID-10")), true)]);
        let other = traffic.heartbeats(Arc::default(), BusIndex(1), address(10), u64::MAX);
        let other: Vec<_> = other.map(|beat| (beat.number, beat.uid)).collect();
        assert_eq!(other, [(1, Some(Uid(*b"OTHER1")))]);
    }
}
