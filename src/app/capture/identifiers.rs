//! Statistics of the frames of each identifier.
//!
//! Broadcasts with one identifier but for RND7 share a row. While a bus is not known to speak DES, its
//! broadcasts have rows with their identifiers as they are, too: in another protocol no bits are random.
//! For the same reason messages of DBC files have rows of their own, on a bus that speaks both.
//!
//! Bounded: three times 4096 identifiers; the last 256 intervals of each, and those of the last minute as
//! sums. A
//! frame with a known identifier allocates nothing. Does not know how frames are shown.

use super::decoded::FrameRole;
use crate::frame::{BusIndex, CanId, Frame, FrameKind};
use crate::time::{Duration, Instant};
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
    /// It is of all broadcasts that have this identifier but for RND7, which is cleared.
    pub is_masked: bool,
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
        let (kind, id, is_masked) = match (frame.kind, frame.id) {
            (FrameKind::Error, _) => (IdentifierKind::Error, CanId::Extended(0), false),
            (FrameKind::Remote, id) => (IdentifierKind::Remote, id, false),
            (FrameKind::Data, CanId::Extended(id)) if Header::decode(id).broadcast => {
                (IdentifierKind::Data, CanId::Extended(id & !(0x7F << 10)), true)
            }
            (FrameKind::Data, id) => (IdentifierKind::Data, id, false),
        };
        Self { bus: frame.bus, id, kind, fd: frame.is_fd, is_masked }
    }

    /// Returns the key of a broadcast with its identifier as it is; `self` is its key.
    fn unmasked(self, frame: &Frame) -> Self {
        Self { id: frame.id, is_masked: false, ..self }
    }

    /// The key in one number, which is hashed at once.
    fn packed(self) -> u64 {
        let id = match self.id {
            CanId::Standard(id) => u64::from(id),
            CanId::Extended(id) => u64::from(id) | 1 << 32,
        };
        let flags = u64::from(self.fd) | (self.kind as u64) << 1 | u64::from(self.is_masked) << 3;
        id | flags << 33 | u64::from(self.bus.0) << 40
    }
}

/// Intervals that the jitter is of.
const INTERVALS: usize = 256;
/// Fewest intervals of which one in twenty does not make the jitter.
const MIN_REGULAR: usize = 20;
/// Parts of the time in which least, mean and greatest interval are: together a minute.
const PARTS: usize = 6;
const PART: Duration = Duration::from_secs(10);
/// Bytes whose changes are noted.
pub const NOTED_BYTES: usize = Frame::MAX_CLASSIC_DATA;

/// Intervals between the frames of an identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FramePeriod {
    /// Least, mean and greatest interval of the last minute.
    pub min: Duration,
    /// Mean interval.
    pub mean: Duration,
    /// Greatest interval.
    pub max: Duration,
    /// 95 % of the last 256 intervals are at most so far from their median, so that one absence does
    /// not count.
    pub jitter: Duration,
    /// There are enough intervals for the jitter to be one.
    pub is_regular: bool,
}

/// Intervals of a part of the time, in microseconds.
#[derive(Clone, Copy, Debug, Default)]
struct IntervalSum {
    /// Number of the part since the start.
    part: u64,
    count: u32,
    min: u64,
    max: u64,
    sum: u64,
}

/// Statistics of the frames of one identifier.
#[derive(Clone, Debug)]
pub struct IdentifierStats {
    /// Identifier.
    pub key: IdentifierKey,
    /// Number of frames.
    pub count: u64,
    /// Number of frames in the last whole second.
    pub rate: u32,
    /// Number of the first frame in the capture.
    pub first_number: u64,
    /// Last frame.
    pub last: Frame,
    /// Its number in the capture.
    pub number: u64,
    /// Time between the last two frames; `None` after the first one.
    pub interval: Option<Duration>,
    current: u32,
    sums: [IntervalSum; PARTS],
    /// In microseconds, in a ring: the next one replaces that at `next`.
    intervals: Vec<u32>,
    next: usize,
    /// When each of the first bytes changed last; `None` since the first frame.
    changed: [Option<Instant>; NOTED_BYTES],
    least_len: u8,
    most_len: u8,
}

impl IdentifierStats {
    fn new(key: IdentifierKey, frame: &Frame, number: u64) -> Self {
        let len = frame.len() as u8;
        Self {
            key,
            count: 1,
            rate: 0,
            first_number: number,
            last: *frame,
            number,
            interval: None,
            current: 1,
            sums: [IntervalSum::default(); PARTS],
            intervals: Vec::with_capacity(INTERVALS),
            next: 0,
            changed: [None; NOTED_BYTES],
            least_len: len,
            most_len: len,
        }
    }

    fn add(&mut self, frame: &Frame, number: u64) {
        let interval = frame.time.since(self.last.time);
        self.interval = Some(interval);
        self.add_interval(frame.time, u64::try_from(interval.as_micros()).unwrap_or(u64::MAX));
        let (before, now) = (self.last.data(), frame.data());
        for (at, changed) in self.changed.iter_mut().enumerate() {
            if before.get(at) != now.get(at) {
                *changed = Some(frame.time);
            }
        }
        let len = frame.len() as u8;
        (self.least_len, self.most_len) = (self.least_len.min(len), self.most_len.max(len));
        self.count += 1;
        self.current += 1;
        self.last = *frame;
        self.number = number;
    }

    fn add_interval(&mut self, time: Instant, micros: u64) {
        let part = part_of(time);
        let sum = &mut self.sums[(part % PARTS as u64) as usize];
        if sum.part != part || sum.count == 0 {
            *sum = IntervalSum { part, count: 0, min: u64::MAX, max: 0, sum: 0 };
        }
        sum.count += 1;
        sum.min = sum.min.min(micros);
        sum.max = sum.max.max(micros);
        sum.sum = sum.sum.saturating_add(micros);
        let short = u32::try_from(micros).unwrap_or(u32::MAX);
        match self.intervals.get_mut(self.next) {
            Some(oldest) => *oldest = short,
            None => self.intervals.push(short),
        }
        self.next = (self.next + 1) % INTERVALS;
    }

    /// Intervals in the minute before the last frame; `None` before the second frame.
    pub fn period(&self) -> Option<FramePeriod> {
        let now = part_of(self.last.time);
        let sums = self.sums.iter().filter(|it| it.count > 0 && it.part + PARTS as u64 > now);
        let all = sums.copied().reduce(|one, other| IntervalSum {
            part: one.part,
            count: one.count + other.count,
            min: one.min.min(other.min),
            max: one.max.max(other.max),
            sum: one.sum.saturating_add(other.sum),
        })?;
        let mut apart: Vec<u64> = self.intervals.iter().map(|&it| u64::from(it)).collect();
        let middle = apart.len() / 2;
        let (_, &mut median, _) = apart.select_nth_unstable(middle);
        for it in &mut apart {
            *it = it.abs_diff(median);
        }
        let rank = (apart.len() * 95).div_ceil(100).max(1) - 1;
        let (_, &mut jitter, _) = apart.select_nth_unstable(rank);
        Some(FramePeriod {
            min: Duration::from_micros(all.min),
            mean: Duration::from_micros(all.sum / u64::from(all.count)),
            max: Duration::from_micros(all.max),
            jitter: Duration::from_micros(jitter),
            is_regular: apart.len() >= MIN_REGULAR,
        })
    }

    /// Returns true for requests, responses and error frames, which have no period; `is_foreign`: the bus
    /// speaks another protocol.
    pub fn has_no_period(&self, is_foreign: bool) -> bool {
        self.key.kind == IdentifierKind::Error
            || matches!(self.last.id, CanId::Extended(_))
                && matches!(
                    FrameRole::of(&self.last, is_foreign),
                    FrameRole::Request | FrameRole::Response | FrameRole::FailedResponse
                )
    }

    /// The period; `None` for requests, responses and error frames, too.
    pub fn own_period(&self, is_foreign: bool) -> Option<FramePeriod> {
        if self.has_no_period(is_foreign) { None } else { self.period() }
    }

    /// When a byte changed last; `None` if it is as in the first frame, and for later ones than the
    /// first eight.
    pub fn changed(&self, byte: usize) -> Option<Instant> {
        self.changed.get(byte).copied().flatten()
    }

    /// Least and greatest number of bytes.
    pub fn lengths(&self) -> (u8, u8) {
        (self.least_len, self.most_len)
    }
}

fn part_of(time: Instant) -> u64 {
    time.as_micros() / PART.as_micros() as u64
}

/// The row of a frame, and the frame before it in that row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IdentifierLink {
    /// Place of the row.
    pub row: usize,
    /// Number of the frame before; `None` for the first one.
    pub previous: Option<u64>,
}

/// Rows by their keys.
#[derive(Clone, Debug, Default)]
struct IdentifierTable {
    rows: Vec<IdentifierStats>,
    /// By the packed key.
    index: HashMap<u64, u32, RandomState>,
    refused: u64,
}

/// Tables of identifiers.
#[derive(Clone, Debug, Default)]
pub struct Identifiers {
    table: IdentifierTable,
    /// Broadcasts with their identifiers as they are, of buses that may speak another protocol.
    unmasked: IdentifierTable,
    /// Broadcasts where DBC files have messages: those with their identifiers as they are, the others
    /// as in the first table.
    described: IdentifierTable,
}

impl IdentifierTable {
    fn add(&mut self, key: IdentifierKey, frame: &Frame, number: u64) -> Option<IdentifierLink> {
        let packed = key.packed();
        if let Some(&at) = self.index.get(&packed) {
            let row = &mut self.rows[at as usize];
            let previous = Some(row.number);
            row.add(frame, number);
            return Some(IdentifierLink { row: at as usize, previous });
        } else if self.rows.len() < Identifiers::MAX {
            let at = self.rows.len();
            self.index.insert(packed, at as u32);
            self.rows.push(IdentifierStats::new(key, frame, number));
            return Some(IdentifierLink { row: at, previous: None });
        }
        self.refused += 1;
        None
    }

    fn tick(&mut self) {
        for row in &mut self.rows {
            row.rate = std::mem::take(&mut row.current);
        }
    }

    fn size(&self) -> usize {
        let in_row = |row: &IdentifierStats| {
            size_of::<(IdentifierStats, u64, u32)>() + row.intervals.len() * size_of::<u32>()
        };
        self.rows.iter().map(in_row).sum()
    }

    fn place_of(&self, key: &IdentifierKey) -> Option<usize> {
        self.index.get(&key.packed()).map(|at| *at as usize)
    }
}

impl Identifiers {
    /// Largest number of identifiers in a table.
    pub const MAX: usize = 4096;

    /// Returns empty tables.
    pub fn new() -> Self {
        Self::default()
    }

    /// Counts a frame, which has this number in the capture. Returns its row; `None` without one.
    pub fn add(&mut self, frame: &Frame, number: u64) -> Option<IdentifierLink> {
        self.table.add(IdentifierKey::of(frame), frame, number)
    }

    /// Counts a frame of a bus that may speak another protocol, which was [added](Self::add), with its
    /// identifier as it is, if that differs. Returns the place of its row; `None` without one.
    pub fn add_unmasked(&mut self, frame: &Frame, number: u64) -> Option<usize> {
        let key = IdentifierKey::of(frame);
        let link = key.is_masked.then(|| self.unmasked.add(key.unmasked(frame), frame, number))?;
        link.map(|link| link.row)
    }

    /// Counts a frame that was [added](Self::add), if it is a broadcast; call for all of them where DBC
    /// files have messages. `has_message`: one of them is of this frame. Returns the place of its row;
    /// `None` without one.
    pub fn add_described(
        &mut self,
        frame: &Frame,
        number: u64,
        has_message: impl FnOnce() -> bool,
    ) -> Option<usize> {
        let key = IdentifierKey::of(frame);
        if !key.is_masked {
            return None;
        }
        let key = if has_message() { key.unmasked(frame) } else { key };
        self.described.add(key, frame, number).map(|link| link.row)
    }

    /// Ends a second for the frame rates.
    pub fn tick(&mut self) {
        self.table.tick();
        self.unmasked.tick();
        self.described.tick();
    }

    /// Bytes of memory, as of a copy.
    pub(super) fn size(&self) -> usize {
        self.table.size() + self.unmasked.size() + self.described.size()
    }

    /// Rows, in the order in which their identifiers were first received.
    pub fn rows(&self) -> &[IdentifierStats] {
        &self.table.rows
    }

    /// Rows with the identifiers as they are on the buses that speak another protocol, and of messages of
    /// DBC files.
    pub fn rows_of(
        &self,
        is_foreign: impl Fn(BusIndex) -> bool + Copy,
    ) -> impl Iterator<Item = &IdentifierStats> {
        let is_described = !self.described.rows.is_empty();
        let is_replaced = move |row: &&IdentifierStats| {
            row.key.is_masked && (is_described || is_foreign(row.key.bus))
        };
        let of_foreign = self.unmasked.rows.iter().filter(move |row| is_foreign(row.key.bus));
        let described = self.described.rows.iter().filter(move |row| !is_foreign(row.key.bus));
        let rows = self.table.rows.iter().filter(move |row| !is_replaced(row));
        rows.chain(of_foreign).chain(described)
    }

    /// The place of the row of an identifier; `None` without one.
    pub fn place_of(&self, key: &IdentifierKey) -> Option<usize> {
        self.table.place_of(key)
    }

    /// The place of the row of an identifier as it is; `None` without one.
    pub fn unmasked_place_of(&self, key: &IdentifierKey) -> Option<usize> {
        self.unmasked.place_of(key)
    }

    /// The place of the row of a broadcast where DBC files have messages; `None` without one.
    pub fn described_place_of(&self, key: &IdentifierKey) -> Option<usize> {
        self.described.place_of(key)
    }

    /// Number of frames without a row, because a table was full.
    pub fn refused(&self) -> u64 {
        let tables = [&self.table, &self.unmasked, &self.described];
        tables.iter().map(|table| table.refused).max().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broadcasts_of_another_protocol_have_their_own_identifiers() {
        let mut identifiers = Identifiers::new();
        let broadcast = 1 << 25;
        for (number, id) in [broadcast | 0x0400, broadcast | 0x0800, 0x0400].into_iter().enumerate()
        {
            let frame = Frame::classic(id, &[]);
            identifiers.add(&frame, number as u64);
            identifiers.add_unmasked(&frame, number as u64);
        }
        let ids = |is_foreign: bool| {
            let ids = identifiers.rows_of(move |_| is_foreign).map(|row| row.key.id);
            let mut ids: Vec<CanId> = ids.collect();
            ids.sort_unstable();
            ids
        };
        let extended = |ids: &[u32]| ids.iter().map(|id| CanId::Extended(*id)).collect::<Vec<_>>();
        assert_eq!(ids(false), extended(&[0x0400, broadcast]));
        assert_eq!(ids(true), extended(&[0x0400, broadcast | 0x0400, broadcast | 0x0800]));
    }

    #[test]
    fn messages_of_dbc_files_do_not_share_a_row_on_a_bus_of_des() {
        let mut identifiers = Identifiers::new();
        let masked = 0x07FE_0010;
        for (number, rnd7) in [0, 5, 5, 9, 0].into_iter().enumerate() {
            let frame = Frame::classic(masked | rnd7 << 10, &[]);
            identifiers.add(&frame, number as u64);
            identifiers.add_described(&frame, number as u64, || matches!(rnd7, 0 | 5));
        }
        let rows =
            identifiers.rows_of(|_| false).map(|row| (row.key.id, row.key.is_masked, row.count));
        let id = |rnd7: u32| CanId::Extended(masked | rnd7 << 10);
        assert_eq!(
            rows.collect::<Vec<_>>(),
            [(id(0), false, 2), (id(5), false, 2), (id(0), true, 1)]
        );
        let count = |is_foreign: bool| identifiers.rows_of(move |_| is_foreign).count();
        assert_eq!((count(false), count(true)), (3, 0), "of another protocol nothing was added");
    }

    #[test]
    fn period_is_that_of_the_last_minute() {
        let mut identifiers = Identifiers::new();
        let mut add = |millis: u64, byte: u8| {
            let frame = Frame::classic(1, &[7, byte]);
            identifiers.add(&frame.with_time(Instant::from_micros(millis * 1000)), millis);
        };
        // Long ago, a long interval.
        add(0, 0);
        add(5_000, 0);
        for beat in 0..1000 {
            add(100_000 + beat * 100 + if beat % 50 == 0 { 10 } else { 0 }, u8::from(beat > 400));
        }
        let row = &identifiers.rows()[0];
        let period = row.period().unwrap();
        let millis = Duration::from_millis;
        assert!(period.is_regular);
        assert_eq!((period.min, period.max), (millis(90), millis(110)));
        assert!(period.mean.abs_diff(millis(100)) < Duration::from_micros(50), "{period:?}");
        assert!(period.jitter <= Duration::from_micros(20), "95 % are on time: {period:?}");
        assert_eq!((row.changed(0), row.changed(5)), (None, None));
        assert_eq!(row.changed(1), Some(Instant::from_micros(140_100_000)));
        assert_eq!((row.lengths(), row.number), ((2, 2), 199_900));
    }

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
