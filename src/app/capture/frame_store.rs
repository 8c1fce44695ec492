//! Frames in the order of their arrival, each with a number, in a bounded number of bytes.
//!
//! A classic frame takes 24 bytes. Frames are stored in blocks; when there is no more room, the
//! oldest block is dropped. Those of its frames that the caller pins are kept longer, in a quarter
//! of the room. Does not know what frames mean, nor why some are pinned.

use crate::frame::socketcan::{self, FD_FORMAT};
use crate::frame::{BusIndex, CanId, Frame};
use crate::time::Instant;
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

/// Most frames in a block: with 24 bytes a frame, 96 KiB.
const BLOCK_FRAMES: usize = 4096;
/// Fewest blocks that share the room: the part of it that is dropped at once.
const MIN_BLOCKS: usize = 16;
/// Part of the room that pinned frames may take.
const PINNED_PART: usize = 4;
/// Flag of a record: sent by descan.
const SENT: u8 = 0x80;

/// Bytes that a classic frame takes.
pub const BYTES_PER_FRAME: usize = size_of::<Record>();

/// A frame in a block. Its data is here, or from a place in the block on if it is longer.
#[derive(Clone, Copy, Debug)]
struct Record {
    /// Microseconds since the block's time.
    offset: i32,
    /// How many frames before it the one with the same identifier is; 0 if that is not known.
    back: u32,
    /// Identifier word of SocketCAN.
    word: u32,
    data: [u8; Frame::MAX_CLASSIC_DATA],
    bus: BusIndex,
    /// FD flags of SocketCAN, and [`SENT`].
    flags: u8,
    len: u8,
}

/// Frames with consecutive numbers.
#[derive(Clone, Debug)]
struct FrameBlock {
    /// Number of the first frame.
    first: u64,
    /// Time that the offsets are relative to: that of the first frame.
    time: Instant,
    records: Vec<Record>,
    /// Data of the frames with more than eight bytes.
    long_data: Vec<u8>,
}

impl FrameBlock {
    fn new(first: u64, time: Instant, capacity: usize) -> Self {
        Self { first, time, records: Vec::with_capacity(capacity), long_data: Vec::new() }
    }

    fn end(&self) -> u64 {
        self.first + self.records.len() as u64
    }

    /// Bytes of memory.
    fn size(&self) -> usize {
        size_of::<Self>()
            + self.records.capacity() * size_of::<Record>()
            + self.long_data.capacity()
    }

    /// Returns the offset of a time; `None` if it is too far from the block's time.
    fn offset(&self, time: Instant) -> Option<i32> {
        let offset = i128::from(time.as_micros()) - i128::from(self.time.as_micros());
        i32::try_from(offset).ok()
    }

    /// Appends a frame; the one with the same identifier is `back` frames before it. Returns false if
    /// the block is full, or the time too far from its own.
    fn push(&mut self, frame: &Frame, back: u32) -> bool {
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
        let word = socketcan::id_word(frame);
        let len = frame.len() as u8;
        let record = Record { offset, back, word, data, bus: frame.bus, flags: fd | sent, len };
        self.records.push(record);
        true
    }

    fn record(&self, number: u64) -> Option<&Record> {
        let at = usize::try_from(number.checked_sub(self.first)?).ok()?;
        self.records.get(at)
    }

    fn decode(&self, record: &Record) -> Frame {
        let len = usize::from(record.len);
        let data = if len <= record.data.len() {
            &record.data[..]
        } else {
            let at = u64::from_ne_bytes(record.data) as usize;
            self.long_data.get(at..at + len).unwrap_or_default()
        };
        let fd = (record.flags & FD_FORMAT != 0).then_some(record.flags);
        let frame = socketcan::decode(record.word, len, fd, data);
        let mut frame = frame.unwrap_or_else(|| Frame::new(CanId::Extended(0), &[]));
        frame.time = self.time_of(record);
        frame.bus = record.bus;
        frame.is_tx = record.flags & SENT != 0;
        frame
    }

    fn time_of(&self, record: &Record) -> Instant {
        let micros = self.time.as_micros().saturating_add_signed(i64::from(record.offset));
        Instant::from_micros(micros)
    }

    /// Returns the time of the last frame.
    fn last_time(&self) -> Option<Instant> {
        self.records.last().map(|record| self.time_of(record))
    }
}

/// A bounded number of frames, of which the newest have consecutive numbers.
#[derive(Debug)]
pub struct FrameStore {
    /// Pinned frames of blocks that were dropped, oldest first, with gaps between the blocks.
    pinned: VecDeque<Arc<FrameBlock>>,
    /// The newest frames, oldest first.
    recent: VecDeque<Arc<FrameBlock>>,
    /// Number of the next frame.
    end: u64,
    room: usize,
    block_frames: usize,
    pinned_size: usize,
    recent_size: usize,
    /// Changes when a block is dropped.
    generation: u64,
}

impl FrameStore {
    /// Smallest room in bytes.
    pub const MIN_ROOM: usize = 1_000_000;

    /// Returns an empty store of at most `room` bytes, or [`Self::MIN_ROOM`] if that is more.
    pub fn new(room: usize) -> Self {
        let room = room.max(Self::MIN_ROOM);
        let block_frames = (room / MIN_BLOCKS / size_of::<Record>()).clamp(1, BLOCK_FRAMES);
        Self {
            pinned: VecDeque::new(),
            recent: VecDeque::new(),
            end: 0,
            room,
            block_frames,
            pinned_size: 0,
            recent_size: 0,
            generation: 0,
        }
    }

    /// Bytes of memory that frames may take.
    pub fn room(&self) -> usize {
        self.room
    }

    /// Number of classic frames that fit into the room.
    pub fn capacity(&self) -> u64 {
        (self.room / BYTES_PER_FRAME) as u64
    }

    /// Number of the oldest frame from which on all are stored.
    pub fn first(&self) -> u64 {
        self.recent.front().map_or(self.end, |block| block.first)
    }

    /// Number of the oldest frame that is stored.
    pub fn oldest(&self) -> u64 {
        self.pinned.front().map_or(self.first(), |block| block.first)
    }

    /// Number of the next frame: the count of all frames.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// Returns a number that changes when frames are dropped.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Appends a frame; `previous` is the number of the last one with the same identifier. If a block
    /// must be dropped, its frames from `pins` are kept; the argument of `pins` is the time of the
    /// block.
    pub fn push(
        &mut self,
        frame: &Frame,
        previous: Option<u64>,
        pins: impl FnOnce(Range<Instant>) -> Vec<Range<Instant>>,
    ) {
        let back = previous.and_then(|previous| self.end.checked_sub(previous));
        let back = back.and_then(|back| u32::try_from(back).ok()).unwrap_or(0);
        let is_pushed = self.recent.back_mut().is_some_and(|block| {
            let before = block.size();
            // A copy of a shared block has no room for more frames.
            let block = Arc::make_mut(block);
            let is_pushed = block.push(frame, back);
            self.recent_size += block.size();
            self.recent_size -= before;
            is_pushed
        });
        if !is_pushed {
            let mut block = self.new_block(frame.time, pins);
            // Nothing else has a new block.
            if let Some(block) = Arc::get_mut(&mut block) {
                block.push(frame, back);
            }
            self.recent_size += block.size();
            self.recent.push_back(block);
        }
        self.end += 1;
    }

    /// Returns an empty block, after the oldest one was dropped if there is no room for it.
    fn new_block(
        &mut self,
        time: Instant,
        pins: impl FnOnce(Range<Instant>) -> Vec<Range<Instant>>,
    ) -> Arc<FrameBlock> {
        let size = self.block_frames * size_of::<Record>();
        let mut spare = None;
        let mut pins = Some(pins);
        while self.recent_size + self.pinned_size + size > self.room {
            let Some(dropped) = self.recent.pop_front() else { break };
            self.recent_size -= dropped.size();
            self.generation += 1;
            if let Some(pins) = pins.take() {
                let until = dropped.last_time().unwrap_or(dropped.time);
                self.pin(&dropped, &pins(dropped.time..until));
            }
            spare = Some(dropped);
        }
        let mut spare = spare.filter(|it| it.records.capacity() == self.block_frames);
        if let Some(block) = spare.as_mut().and_then(Arc::get_mut) {
            block.first = self.end;
            block.time = time;
            block.records.clear();
            block.long_data = Vec::new();
        } else {
            spare = None;
        }
        spare.unwrap_or_else(|| Arc::new(FrameBlock::new(self.end, time, self.block_frames)))
    }

    /// Keeps the frames of a dropped block that are in one of the ranges.
    fn pin(&mut self, block: &FrameBlock, ranges: &[Range<Instant>]) {
        let is_pinned = |time: Instant| ranges.iter().any(|range| range.contains(&time));
        let mut kept: Option<FrameBlock> = None;
        for (number, record) in (block.first..).zip(&block.records) {
            if !is_pinned(block.time_of(record)) {
                self.keep(kept.take());
                continue;
            }
            let frame = block.decode(record);
            let kept = kept.get_or_insert_with(|| FrameBlock::new(number, frame.time, 0));
            kept.records.reserve(1);
            kept.push(&frame, record.back);
        }
        self.keep(kept);
        while self.pinned_size > self.room / PINNED_PART {
            let Some(dropped) = self.pinned.pop_front() else { break };
            self.pinned_size -= dropped.size();
        }
    }

    fn keep(&mut self, block: Option<FrameBlock>) {
        let Some(mut block) = block else { return };
        block.records.shrink_to_fit();
        block.long_data.shrink_to_fit();
        self.pinned_size += block.size();
        self.pinned.push_back(Arc::new(block));
    }

    fn blocks(&self) -> impl DoubleEndedIterator<Item = &FrameBlock> {
        self.pinned.iter().chain(&self.recent).map(|block| &**block)
    }

    /// Returns the block in which the frame `number` is, or would be.
    fn block_of(&self, number: u64) -> Option<&FrameBlock> {
        let blocks = if number < self.first() { &self.pinned } else { &self.recent };
        let after = blocks.partition_point(|block| block.first <= number);
        let block = blocks.get(after.checked_sub(1)?)?;
        (number < block.end()).then_some(block)
    }

    /// The frame with this number; `None` if it is not stored.
    pub fn get(&self, number: u64) -> Option<Frame> {
        let block = self.block_of(number)?;
        block.record(number).map(|record| block.decode(record))
    }

    /// Number of the last frame before this one with the same identifier; `None` if it is not known. It
    /// may be stored no more.
    pub fn previous(&self, number: u64) -> Option<u64> {
        let back = self.block_of(number)?.record(number)?.back;
        number.checked_sub(u64::from(back)).filter(|_| back > 0)
    }

    /// Time of a frame; `None` if it is not stored.
    pub fn time_of(&self, number: u64) -> Option<Instant> {
        let block = self.block_of(number)?;
        block.record(number).map(|record| block.time_of(record))
    }

    /// Ranges of consecutive numbers that are stored, oldest first.
    pub fn ranges(&self) -> impl DoubleEndedIterator<Item = Range<u64>> {
        self.blocks().map(|block| block.first..block.end())
    }

    /// Frames from `from` on with their numbers, oldest first.
    pub fn frames_from(&self, from: u64) -> impl Iterator<Item = (u64, Frame)> {
        let skipped =
            |blocks: &VecDeque<Arc<FrameBlock>>| blocks.partition_point(|it| it.end() <= from);
        let pinned = self.pinned.range(skipped(&self.pinned)..);
        let recent = self.recent.range(skipped(&self.recent)..);
        pinned.chain(recent).flat_map(move |block| {
            let first = from.max(block.first);
            let records = block.records[(first - block.first) as usize..].iter();
            (first..).zip(records.map(|record| block.decode(record)))
        })
    }

    /// Returns the frames that are stored now; more frames do not change it.
    pub fn snapshot(&self) -> StoredFrames {
        StoredFrames { blocks: self.pinned.iter().chain(&self.recent).map(Arc::clone).collect() }
    }

    /// Numbers of the stored frames from `from` on, oldest first.
    pub fn numbers_from(&self, from: u64) -> impl Iterator<Item = u64> {
        self.ranges().flat_map(move |range| range.start.max(from)..range.end)
    }

    /// Numbers of the stored frames before `until`, newest first.
    pub fn numbers_before(&self, until: u64) -> impl Iterator<Item = u64> {
        self.ranges().rev().flat_map(move |range| (range.start..range.end.min(until)).rev())
    }

    /// Number of the first stored frame that is not older than `time`.
    pub fn at_time(&self, time: Instant) -> u64 {
        let is_older = |block: &Arc<FrameBlock>| block.last_time().is_some_and(|last| last < time);
        let in_blocks = |blocks: &VecDeque<Arc<FrameBlock>>| {
            let block = blocks.get(blocks.partition_point(is_older))?;
            let at = block.records.partition_point(|record| block.time_of(record) < time);
            Some(block.first + at as u64)
        };
        in_blocks(&self.pinned).or_else(|| in_blocks(&self.recent)).unwrap_or(self.end)
    }
}

/// Frames that were stored at some time. They share their memory with the store.
#[derive(Clone, Debug)]
pub struct StoredFrames {
    blocks: Vec<Arc<FrameBlock>>,
}

impl StoredFrames {
    /// Returns true if both share the same memory.
    pub fn is_same(&self, other: &Self) -> bool {
        let (ours, theirs) = (&self.blocks, &other.blocks);
        ours.len() == theirs.len() && ours.iter().zip(theirs).all(|(one, it)| Arc::ptr_eq(one, it))
    }

    /// The frames, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = Frame> {
        self.blocks.iter().flat_map(|block| block.records.iter().map(|it| block.decode(it)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Duration;

    fn at(micros: u64) -> Instant {
        Instant::from_micros(micros)
    }

    fn filled(frames: u64) -> FrameStore {
        let mut store = FrameStore::new(FrameStore::MIN_ROOM);
        for number in 0..frames {
            let frame = Frame::classic(number as u32, &number.to_be_bytes());
            store.push(&frame.with_time(at(number * 1000)), None, |_| Vec::new());
        }
        store
    }

    #[test]
    fn classic_frame_takes_at_most_24_bytes() {
        assert!(size_of::<Record>() <= 24, "{}", size_of::<Record>());
        let store = filled(200_000);
        let stored = store.end() - store.first();
        let used = store.recent.iter().map(|it| it.size()).sum::<usize>();
        assert!(used <= FrameStore::MIN_ROOM, "{used}");
        assert!(stored * 24 >= FrameStore::MIN_ROOM as u64 * 9 / 10, "{stored}");
    }

    #[test]
    fn frames_are_read_as_they_were() {
        let mut store = FrameStore::new(0);
        let data: Vec<u8> = (0..64).collect();
        let frames = [
            Frame::classic(0x1FFF_FFFF, &data[..8]),
            Frame::new(CanId::Standard(0x7FF), &data[..3]).with_bus(BusIndex(255)),
            Frame::fd(5, &data[..64], 0).with_tx(),
            Frame::fd(6, &data[..12], 0xCC),
            Frame::remote(CanId::Extended(7), 8),
            Frame::error(0x20, &data[..8]),
            Frame::classic(8, &[]).with_time(at(u64::from(u32::MAX) * 3)),
            // Frames of several buses may be slightly out of order.
            Frame::classic(9, &[1]).with_time(at(u64::from(u32::MAX) * 3 - 100)),
        ];
        for frame in &frames {
            store.push(frame, None, |_| Vec::new());
        }
        let read: Vec<Frame> = store.frames_from(0).map(|(_, frame)| frame).collect();
        assert_eq!(read, frames);
        assert_eq!(store.get(6), Some(frames[6]));
    }

    #[test]
    fn oldest_frames_make_room() {
        let store = filled(200_000);
        assert_eq!(store.end(), 200_000);
        assert!(store.get(store.first() - 1).is_none());
        assert_eq!(store.get(store.first()).unwrap().time, at(store.first() * 1000));
        assert_eq!(store.at_time(at(199_000_500)), 199_001);
        assert_eq!(store.at_time(at(0)), store.first());
        assert_eq!(store.at_time(at(u64::MAX)), store.end());
        assert_eq!(store.numbers_before(199_000).next(), Some(198_999));
        assert_eq!(store.frames_from(199_998).count(), 2);
    }

    #[test]
    fn pinned_frames_are_kept_longer() {
        let mut store = FrameStore::new(FrameStore::MIN_ROOM);
        let pin = at(50_000)..at(60_000);
        for number in 0..200_000 {
            let frame = Frame::classic(number, &[]).with_time(at(u64::from(number) * 1000));
            store.push(&frame, None, |block| {
                let is_near = pin.start < block.end && block.start < pin.end;
                if is_near { vec![pin.clone()] } else { Vec::new() }
            });
        }
        assert!(store.first() > 100_000);
        assert_eq!(store.oldest(), 50);
        assert_eq!(store.ranges().next(), Some(50..60));
        assert_eq!(store.get(55).map(|frame| frame.time), Some(at(55_000)));
        assert!(store.get(49).is_none() && store.get(60).is_none());
        assert_eq!(store.numbers_from(58).take(3).collect::<Vec<_>>(), [58, 59, store.first()]);
        let before: Vec<u64> = store.numbers_before(store.first()).take(2).collect();
        assert_eq!(before, [59, 58]);
        assert_eq!(store.at_time(at(55_000)), 55);
        assert_eq!(store.at_time(at(60_000)), store.first());
    }

    #[test]
    fn pinned_frames_are_bounded() {
        let mut store = FrameStore::new(FrameStore::MIN_ROOM);
        for number in 0..500_000 {
            let frame = Frame::classic(number, &[]).with_time(at(u64::from(number) * 1000));
            store.push(&frame, None, |block| vec![block.start..block.end + Duration::from_secs(1)]);
        }
        let size: usize = store.blocks().map(FrameBlock::size).sum();
        assert!(size <= FrameStore::MIN_ROOM, "{size}");
        let pinned = store.ranges().map(|range| range.end - range.start).sum::<u64>();
        assert!(pinned * 24 > FrameStore::MIN_ROOM as u64 * 8 / 10, "{pinned}");
    }
}
