//! Statistics of the frames of each identifier.
//!
//! Bounded: 4096 identifiers. A frame with a known identifier allocates nothing. Does not know how
//! frames are shown.

use crate::frame::{BusIndex, CanId, Frame, FrameKind};
use crate::time::Duration;
use crate::wire::id::Header;
use foldhash::fast::RandomState;
use std::collections::HashMap;

/// Key of a row of statistics. The random DST of a broadcast is cleared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct IdentifierKey {
    /// Bus.
    pub bus: BusIndex,
    /// Identifier; standard identifiers sort before extended ones.
    pub id: CanId,
    /// Kind of frame: remote frames have rows of their own; error frames share one row.
    pub kind: IdentifierKind,
    /// CAN FD: FD frames have rows of their own.
    pub fd: bool,
}

/// [`FrameKind`] with an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum IdentifierKind {
    /// Data frame.
    Data,
    /// Remote frame.
    Remote,
    /// Error frame.
    Error,
}

impl IdentifierKey {
    /// Returns the key of a frame.
    pub fn of(frame: &Frame) -> Self {
        let (kind, id) = match (frame.kind, frame.id) {
            (FrameKind::Error, _) => (IdentifierKind::Error, CanId::Extended(0)),
            (FrameKind::Remote, id) => (IdentifierKind::Remote, id),
            (FrameKind::Data, CanId::Extended(id)) if Header::decode(id).broadcast => {
                (IdentifierKind::Data, CanId::Extended(id & !(0x7F << 10)))
            }
            (FrameKind::Data, id) => (IdentifierKind::Data, id),
        };
        Self { bus: frame.bus, id, kind, fd: frame.is_fd }
    }
}

/// Statistics of the frames of one identifier.
#[derive(Clone, Copy, Debug)]
pub struct IdentifierStats {
    /// Identifier.
    pub key: IdentifierKey,
    /// Number of frames.
    pub count: u64,
    /// Number of frames in the last whole second.
    pub rate: u32,
    /// Last frame.
    pub last: Frame,
    /// Its number in the capture.
    pub number: u64,
    /// Time between the last two frames; `None` after the first one.
    pub interval: Option<Duration>,
    current: u32,
}

/// Table of identifiers.
#[derive(Debug)]
pub struct Identifiers {
    rows: Vec<IdentifierStats>,
    index: HashMap<IdentifierKey, u32, RandomState>,
    refused: u64,
}

impl Identifiers {
    /// Largest number of identifiers in the table.
    pub const MAX: usize = 4096;

    /// Returns an empty table.
    pub fn new() -> Self {
        let index = HashMap::with_capacity_and_hasher(256, RandomState::default());
        Self { rows: Vec::new(), index, refused: 0 }
    }

    /// Counts a frame, which has this number in the capture. Returns the number of the last one with
    /// the same identifier.
    pub fn add(&mut self, frame: &Frame, number: u64) -> Option<u64> {
        let key = IdentifierKey::of(frame);
        if let Some(&at) = self.index.get(&key) {
            let row = &mut self.rows[at as usize];
            row.interval = Some(frame.time.since(row.last.time));
            row.count += 1;
            row.current += 1;
            row.last = *frame;
            return Some(std::mem::replace(&mut row.number, number));
        } else if self.rows.len() < Self::MAX {
            self.index.insert(key, self.rows.len() as u32);
            let (last, interval) = (*frame, None);
            let (count, rate, current) = (1, 0, 1);
            self.rows.push(IdentifierStats { key, count, rate, last, number, interval, current });
        } else {
            self.refused += 1;
        }
        None
    }

    /// Ends a second for the frame rates.
    pub fn tick(&mut self) {
        for row in &mut self.rows {
            row.rate = std::mem::take(&mut row.current);
        }
    }

    /// Rows, in the order in which their identifiers were first received.
    pub fn rows(&self) -> &[IdentifierStats] {
        &self.rows
    }

    /// Number of frames without a row, because the table was full.
    pub fn refused(&self) -> u64 {
        self.refused
    }
}

impl Default for Identifiers {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broadcast_rnd7_destination_adds_no_identifier_rows() {
        let mut identifiers = Identifiers::new();
        let service = crate::wire::id::Service::from_bits(1);
        let from = crate::wire::id::Address::from_bits(12);
        for rnd7 in 0..100 {
            let header = Header::unsolicited(from, rnd7, false, service);
            identifiers.add(&Frame::classic(header.encode(), &[]), u64::from(rnd7));
        }
        identifiers.tick();
        let [row] = identifiers.rows() else { panic!("one row") };
        assert_eq!((row.count, row.rate), (100, 100));
    }
}
