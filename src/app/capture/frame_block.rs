//! A block of captured frames: 24 bytes a classic frame. Does not know other blocks.

use super::identifiers::IdentifierKey;
use super::row_set::RowSet;
use crate::app::varint::{read_varint, write_varint};
use crate::frame::socketcan::{self, FD_FORMAT};
use crate::frame::{BusIndex, CanId, Frame};
use crate::time::Instant;
use foldhash::fast::{FixedState, RandomState};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::hash::{BuildHasher, Hasher};
use std::sync::OnceLock;

/// Link of the first frame of an identifier.
const NO_LINK: u32 = 0;
/// Link of an identifier without a row in the table of identifiers: none of its frames is linked.
const NEVER_LINKED: u32 = 1;
/// Flag of a record: sent by descan.
const SENT: u8 = 0x80;
/// Flag of a frame from a log without times.
const TIMELESS: u8 = 0x40;

/// Bytes that a classic frame takes.
pub const BYTES_PER_FRAME: usize = size_of::<Record>();

/// A frame in a block. Its data is here, or from a place in the block on if it is longer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Record {
    /// Microseconds since the block's time.
    offset: i32,
    /// How many frames before it the one with the same identifier is; 0 if that is not known.
    back: u32,
    /// Identifier word of SocketCAN.
    word: u32,
    data: [u8; Frame::MAX_CLASSIC_DATA],
    bus: BusIndex,
    /// FD flags of SocketCAN, [`SENT`] and [`TIMELESS`].
    flags: u8,
    /// Length, or a raw DLC above 8 of a classic frame.
    len: u8,
}

/// Frames with consecutive numbers.
#[derive(Clone, Debug)]
pub(super) struct FrameBlock {
    /// Number of the first frame.
    pub first: u64,
    /// Time that the offsets are relative to: that of the first frame.
    pub time: Instant,
    pub records: Vec<Record>,
    /// Data of the frames with more than eight bytes.
    long_data: Vec<u8>,
    /// Rows of their identifiers. Of a block that was read again it is empty.
    pub rows: RowSet,
    /// Of a block that was read again: the links to frames before it, and those of all its frames once
    /// they are wanted.
    links_before: Option<Box<[u8]>>,
    links: OnceLock<Box<[u32]>>,
}

impl FrameBlock {
    /// Returns an empty block with room for `capacity` frames.
    pub fn new(first: u64, time: Instant, capacity: usize) -> Self {
        let records = Vec::with_capacity(capacity);
        Self {
            first,
            time,
            records,
            long_data: Vec::new(),
            rows: RowSet::default(),
            links_before: None,
            links: OnceLock::new(),
        }
    }

    /// Number behind the last frame.
    pub fn end(&self) -> u64 {
        self.first + self.records.len() as u64
    }

    /// Bytes of memory.
    pub fn size(&self) -> usize {
        size_of::<Self>()
            + self.records.capacity() * size_of::<Record>()
            + self.long_data.capacity()
            + self.rows.size()
            + self
                .links_before
                .as_ref()
                .map_or(0, |it| it.len() + self.records.len() * size_of::<u32>())
    }

    /// Returns the offset of a time; `None` if it is too far from the block's time.
    fn offset(&self, time: Instant) -> Option<i32> {
        let offset = i128::from(time.as_micros()) - i128::from(self.time.as_micros());
        i32::try_from(offset).ok()
    }

    /// Returns true if a frame of this time can be appended.
    pub fn has_room(&self, time: Instant) -> bool {
        self.records.len() < self.records.capacity() && self.offset(time).is_some()
    }

    /// Appends a frame; the one with the same identifier is `back` frames before it. Returns false if
    /// the block is full, or the time too far from its own.
    pub fn push(&mut self, frame: &Frame, back: u32) -> bool {
        if self.records.len() == self.records.capacity() {
            return false;
        }
        let Some(offset) = self.offset(frame.time) else { return false };
        let (mut data, bytes) = ([0; Frame::MAX_CLASSIC_DATA], frame.data());
        if let Some(short) = data.get_mut(..bytes.len()) {
            short.copy_from_slice(bytes);
        } else {
            let at = self.long_data.len() as u64;
            data = at.to_ne_bytes();
            self.long_data.extend_from_slice(bytes);
        }
        let fd = if frame.is_fd { FD_FORMAT | socketcan::fd_flags(frame) } else { 0 };
        let sent = if frame.is_tx { SENT } else { 0 };
        let timeless = if frame.is_timeless { TIMELESS } else { 0 };
        let word = socketcan::id_word(frame);
        let len = frame.raw_dlc().unwrap_or(frame.len() as u8);
        let record =
            Record { offset, back, word, data, bus: frame.bus, flags: fd | sent | timeless, len };
        self.records.push(record);
        true
    }

    /// The frame with this number; `None` if it is not in the block.
    pub fn record(&self, number: u64) -> Option<&Record> {
        let at = usize::try_from(number.checked_sub(self.first)?).ok()?;
        self.records.get(at)
    }

    /// Number of the last frame before `before` with an identifier.
    pub fn last_before(&self, before: u64, key: &IdentifierKey) -> Option<u64> {
        let count = usize::try_from(before.saturating_sub(self.first)).unwrap_or(usize::MAX);
        let records = &self.records[..self.records.len().min(count)];
        let at = records.iter().rposition(|it| IdentifierKey::of(&self.decode(it)) == *key)?;
        Some(self.first + at as u64)
    }

    /// Returns the frame of a record.
    pub fn decode(&self, record: &Record) -> Frame {
        let fd = (record.flags & FD_FORMAT != 0).then_some(record.flags);
        let most = if fd.is_some() { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA };
        let len = usize::from(record.len).min(most);
        let data = if len <= record.data.len() {
            &record.data[..]
        } else {
            let at = u64::from_ne_bytes(record.data) as usize;
            self.long_data.get(at..at + len).unwrap_or_default()
        };
        let frame = socketcan::decode(record.word, len, fd, data);
        let mut frame = frame.unwrap_or_else(|| Frame::new(CanId::Extended(0), &[]));
        frame = frame.with_raw_dlc(record.len);
        frame.time = self.time_of(record);
        frame.bus = record.bus;
        frame.is_tx = record.flags & SENT != 0;
        frame.is_timeless = record.flags & TIMELESS != 0;
        frame
    }

    /// Time of a record.
    pub fn time_of(&self, record: &Record) -> Instant {
        let micros = self.time.as_micros().saturating_add_signed(i64::from(record.offset));
        Instant::from_micros(micros)
    }

    /// Returns the time of the last frame.
    pub fn last_time(&self) -> Option<Instant> {
        self.records.last().map(|record| self.time_of(record))
    }

    /// Empties the block for frames from this number and time on. Keeps its memory.
    pub fn reset(&mut self, first: u64, time: Instant) {
        (self.first, self.time) = (first, time);
        self.records.clear();
        self.long_data = Vec::new();
        self.rows.clear();
    }

    /// Releases the memory that is not used.
    pub fn shrink(&mut self) {
        self.records.shrink_to_fit();
        self.long_data.shrink_to_fit();
    }

    /// A number that differs, as good as always, where the frames or their times do.
    pub fn digest(&self) -> u64 {
        let mut hasher = FixedState::default().build_hasher();
        for record in &self.records {
            hasher.write_u32(record.offset.cast_unsigned());
            hasher.write_u32(record.word);
            hasher.write(&[record.bus.0, record.flags, record.len]);
            hasher.write_u64(u64::from_ne_bytes(record.data));
        }
        hasher.write(&self.long_data);
        hasher.finish()
    }

    /// Returns the links to frames before the block, which [`Self::set_links`] takes, as bytes.
    pub fn links(&self) -> Box<[u8]> {
        let mut links: Vec<u32> = Vec::new();
        let mut known: HashMap<IdentifierKey, usize, RandomState> = HashMap::default();
        for record in &self.records {
            match known.entry(IdentifierKey::of(&self.decode(record))) {
                Entry::Vacant(entry) => {
                    entry.insert(links.len());
                    links.push(if record.back == 0 { NO_LINK } else { record.back + 1 });
                }
                Entry::Occupied(entry) if record.back == 0 => {
                    if let Some(link) = links.get_mut(*entry.get()) {
                        *link = NEVER_LINKED;
                    }
                }
                Entry::Occupied(_) => {}
            }
        }
        let mut bytes = Vec::with_capacity(links.len() * 2);
        for link in links {
            write_varint(&mut bytes, u64::from(link));
        }
        bytes.into()
    }

    /// How many frames before a frame of the block the one with the same identifier is; 0 if that is
    /// not known.
    pub fn back(&self, number: u64) -> u32 {
        let Some(record) = self.record(number) else { return 0 };
        let Some(before) = &self.links_before else { return record.back };
        let links = self.links.get_or_init(|| self.links_after(before));
        links.get((number - self.first) as usize).copied().unwrap_or(0)
    }

    /// Sets the links of all frames, of which those to frames before the block are given. They are made
    /// when they are wanted.
    pub fn set_links(&mut self, before: &[u8]) {
        self.links_before = Some(before.into());
    }

    fn links_after(&self, before: &[u8]) -> Box<[u32]> {
        let mut before = before.iter().copied();
        // Place of the last frame of each identifier; `None` if its frames are not linked.
        let mut known: HashMap<IdentifierKey, Option<u32>, RandomState> = HashMap::default();
        let back = |(place, record): (u32, &Record)| match known
            .entry(IdentifierKey::of(&self.decode(record)))
        {
            Entry::Occupied(mut entry) => match entry.get_mut() {
                Some(last) => place - std::mem::replace(last, place),
                None => 0,
            },
            Entry::Vacant(entry) => {
                let link = read_varint(&mut before).unwrap_or(u64::from(NEVER_LINKED)) as u32;
                entry.insert((link != NEVER_LINKED).then_some(place));
                if matches!(link, NO_LINK | NEVER_LINKED) { 0 } else { link - 1 }
            }
        };
        (0..).zip(&self.records).map(back).collect()
    }
}
