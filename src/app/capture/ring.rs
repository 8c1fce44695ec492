//! Ring of the captured frames, and statistics per identifier.
//!
//! Bounded: 32768 frames, 4096 identifiers. A frame with a known identifier allocates nothing. Does
//! not know how frames are shown.

use crate::frame::{BusIndex, CanId, Frame, FrameKind};
use crate::time::{Duration, Instant};
use crate::wire::id::Header;
use foldhash::fast::RandomState;
use std::collections::{HashMap, VecDeque};

/// The captured frames.
#[derive(Debug)]
pub struct Capture {
    frames: VecDeque<Frame>,
    /// Number of the oldest frame in the ring: the count of frames that left it.
    first: u64,
    identifiers: Identifiers,
}

impl Capture {
    /// Largest number of frames in the ring.
    pub const FRAMES: usize = 32_768;

    /// Returns an empty ring.
    pub fn new() -> Self {
        let frames = VecDeque::with_capacity(Self::FRAMES);
        Self { frames, first: 0, identifiers: Identifiers::new() }
    }

    /// Adds a frame; the oldest one leaves a full ring.
    pub fn push(&mut self, frame: &Frame) {
        if self.frames.len() == Self::FRAMES {
            self.frames.pop_front();
            self.first += 1;
        }
        self.frames.push_back(*frame);
        self.identifiers.add(frame);
    }

    /// Number of the oldest frame in the ring.
    pub fn first(&self) -> u64 {
        self.first
    }

    /// Number of the next frame.
    pub fn end(&self) -> u64 {
        self.first + self.frames.len() as u64
    }

    /// The frame with this number; `None` if it is not in the ring.
    pub fn get(&self, number: u64) -> Option<&Frame> {
        self.frames.get(usize::try_from(number.checked_sub(self.first)?).ok()?)
    }

    /// Frames with their numbers, oldest first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = (u64, &Frame)> {
        self.frames.iter().enumerate().map(|(at, frame)| (self.first + at as u64, frame))
    }

    /// Number of the first frame that is not older than `time`.
    pub fn at_time(&self, time: Instant) -> u64 {
        self.first + self.frames.partition_point(|frame| frame.time < time) as u64
    }

    /// Statistics per identifier.
    pub fn identifiers(&self) -> &Identifiers {
        &self.identifiers
    }

    /// Ends a second for the frame rates.
    pub fn tick(&mut self) {
        self.identifiers.tick();
    }
}

impl Default for Capture {
    fn default() -> Self {
        Self::new()
    }
}

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

    fn new() -> Self {
        let index = HashMap::with_capacity_and_hasher(256, RandomState::default());
        Self { rows: Vec::new(), index, refused: 0 }
    }

    fn add(&mut self, frame: &Frame) {
        let key = IdentifierKey::of(frame);
        if let Some(&at) = self.index.get(&key) {
            let row = &mut self.rows[at as usize];
            row.interval = Some(frame.time.since(row.last.time));
            row.count += 1;
            row.current += 1;
            row.last = *frame;
        } else if self.rows.len() < Self::MAX {
            self.index.insert(key, self.rows.len() as u32);
            let (last, interval) = (*frame, None);
            self.rows.push(IdentifierStats { key, count: 1, rate: 0, last, interval, current: 1 });
        } else {
            self.refused += 1;
        }
    }

    fn tick(&mut self) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ring_keeps_newest_frames() {
        let mut capture = Capture::new();
        for at in 0..Capture::FRAMES as u64 + 10 {
            capture.push(&Frame::classic(1, &[]).with_time(Instant::from_micros(at)));
        }
        assert_eq!((capture.first(), capture.end()), (10, Capture::FRAMES as u64 + 10));
        assert!(capture.get(9).is_none());
        assert_eq!(capture.get(10).unwrap().time, Instant::from_micros(10));
        assert_eq!(capture.at_time(Instant::from_micros(100)), 100);
    }

    #[test]
    fn broadcast_rnd7_destination_adds_no_identifier_rows() {
        let mut capture = Capture::new();
        let service = crate::wire::id::Service::from_bits(1);
        let from = crate::wire::id::Address::from_bits(12);
        for rnd7 in 0..100 {
            let header = Header::unsolicited(from, rnd7, false, service);
            capture.push(&Frame::classic(header.encode(), &[]));
        }
        capture.tick();
        let [row] = capture.identifiers().rows() else { panic!("one row") };
        assert_eq!((row.count, row.rate), (100, 100));
    }
}
