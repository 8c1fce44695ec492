//! Frames in the order of their arrival, each with a number, in a bounded number of bytes.
//!
//! A classic frame takes 24 bytes. Frames are stored in blocks; when there is no more room, the
//! oldest block is dropped. Those of its frames that the caller pins are kept longer, in a quarter
//! of the room. With a [`FrameSource`] the frames of a dropped block are read again when they are
//! wanted. Does not know what frames mean, nor why some are pinned.

use super::frame_block::{BYTES_PER_FRAME, FrameBlock, Record};
use super::identifiers::{IdentifierKey, IdentifierLink};
use super::indexed_frames::{IndexedBlock, IndexedFrames, IndexedSource};
use crate::frame::Frame;
use crate::log::FrameSource;
use crate::time::Instant;
use std::collections::VecDeque;
use std::ops::{Deref, Range};
use std::sync::Arc;

/// Most frames in a block: with 24 bytes a frame, 96 KiB.
const BLOCK_FRAMES: usize = 4096;
/// Fewest blocks that share the room: the part of it that is dropped at once.
const MIN_BLOCKS: usize = 16;
/// Most frames that are looked at for the last one with the same bits: RND7 has 128 values.
const MAX_LOOKED_AT: usize = 1024;
/// Part of the room that pinned frames may take.
const PINNED_PART: usize = 4;
/// Part of the room that the newest frames of a log take, its index, and the frames that were read
/// again, each.
const LOG_PART: usize = 8;

/// A block of the store: in memory, or read for the moment.
#[derive(Debug)]
enum BlockRef<'a> {
    Stored(&'a FrameBlock),
    Read(Arc<FrameBlock>),
}

impl Deref for BlockRef<'_> {
    type Target = FrameBlock;

    fn deref(&self) -> &FrameBlock {
        match self {
            Self::Stored(block) => block,
            Self::Read(block) => block,
        }
    }
}

/// A bounded number of frames, of which the newest have consecutive numbers.
#[derive(Debug)]
pub struct FrameStore {
    /// Pinned frames of blocks that were dropped, oldest first, with gaps between the blocks.
    pinned: VecDeque<Arc<FrameBlock>>,
    /// The newest frames, oldest first.
    recent: VecDeque<Arc<FrameBlock>>,
    /// Blocks before them that can be read again.
    indexed: Option<IndexedFrames>,
    /// Number of the next frame.
    end: u64,
    room: usize,
    block_frames: usize,
    pinned_size: usize,
    recent_size: usize,
    /// The block that was dropped last, whose memory the next one takes.
    spare: Option<Arc<FrameBlock>>,
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
            indexed: None,
            end: 0,
            room,
            block_frames,
            pinned_size: 0,
            recent_size: 0,
            spare: None,
            generation: 0,
        }
    }

    /// Sets the log from which frames that are dropped from memory can be read again. Returns how many
    /// bytes less of the room frames take from now on.
    pub fn set_source(&mut self, source: Box<dyn FrameSource>) -> usize {
        self.indexed = Some(IndexedFrames::new(source, self.room / LOG_PART));
        self.room - 3 * (self.room / LOG_PART)
    }

    /// Returns true if frames that are dropped from memory can be read again.
    pub fn has_source(&self) -> bool {
        self.indexed.is_some()
    }

    /// Bytes of memory that frames may take.
    pub fn room(&self) -> usize {
        self.room
    }

    /// Number of classic frames that fit into the room.
    pub fn capacity(&self) -> u64 {
        (self.room / BYTES_PER_FRAME) as u64
    }

    /// Number of the oldest frame from which on all are stored, or can be read again.
    pub fn first(&self) -> u64 {
        let indexed = self.indexed.iter().flat_map(IndexedFrames::blocks).next();
        indexed.map_or(self.first_in_memory(), |block| block.first)
    }

    fn first_in_memory(&self) -> u64 {
        self.recent.front().map_or(self.end, |block| block.first)
    }

    /// Number of the oldest frame that is stored.
    pub fn oldest(&self) -> u64 {
        self.pinned.front().map_or_else(|| self.first(), |block| block.first)
    }

    /// Number of the next frame: the count of all frames.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// Returns a number that changes when frames are dropped.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Appends a frame; `link` is its row in the table of identifiers. Drops the oldest blocks if there
    /// is no room for it; see [`about_to_drop`](Self::about_to_drop).
    pub fn push(&mut self, frame: &Frame, link: Option<IdentifierLink>) {
        let previous = link.and_then(|link| link.previous);
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
            let mut block = self.new_block(frame.time);
            // Nothing else has a new block.
            if let Some(block) = Arc::get_mut(&mut block) {
                block.push(frame, back);
            }
            self.recent_size += block.size();
            self.recent.push_back(block);
        }
        if let Some(link) = link
            && let Some(block) = self.recent.back_mut()
            && !block.rows.contains(link.row)
        {
            let block = Arc::make_mut(block);
            self.recent_size -= block.rows.size();
            block.rows.insert(link.row);
            self.recent_size += block.rows.size();
        }
        self.end += 1;
    }

    /// Numbers and times of the oldest frames that are dropped when a frame of this time is pushed;
    /// `None` if none are, and of a log that can be read again. With
    /// [`drop_oldest`](Self::drop_oldest) some of them are kept.
    pub fn about_to_drop(&self, next: Instant) -> Option<(Range<u64>, Range<Instant>)> {
        if self.has_source() || self.recent.back()?.has_room(next) || !self.needs_room() {
            return None;
        }
        let oldest = self.recent.front()?;
        let until = oldest.last_time().unwrap_or(oldest.time);
        Some((oldest.first..oldest.end(), oldest.time..until))
    }

    /// Returns true if there is no room for another block.
    fn needs_room(&self) -> bool {
        let size = self.block_frames * size_of::<Record>();
        let room = if self.has_source() { self.room / LOG_PART } else { self.room };
        !self.recent.is_empty() && self.recent_size + self.pinned_size + size > room
    }

    /// Drops the oldest block; its frames with times in `pins` are kept longer.
    pub fn drop_oldest(&mut self, pins: &[Range<Instant>]) {
        let Some(dropped) = self.recent.pop_front() else { return };
        self.recent_size -= dropped.size();
        self.generation += 1;
        if !self.indexed.as_mut().is_some_and(|indexed| indexed.add(&dropped)) && !pins.is_empty() {
            self.pin(&dropped, pins);
        }
        self.spare = Some(dropped).filter(|it| it.records.capacity() == self.block_frames);
    }

    /// Returns an empty block, after the oldest ones were dropped if there is no room for it.
    fn new_block(&mut self, time: Instant) -> Arc<FrameBlock> {
        while self.needs_room() {
            self.drop_oldest(&[]);
        }
        if let Some(mut spare) = self.spare.take()
            && let Some(block) = Arc::get_mut(&mut spare)
        {
            block.reset(self.end, time);
            return spare;
        }
        Arc::new(FrameBlock::new(self.end, time, self.block_frames))
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
            let kept = kept.get_or_insert_with(|| {
                let mut kept = FrameBlock::new(number, frame.time, 0);
                kept.rows = block.rows.clone();
                kept
            });
            kept.records.reserve(1);
            kept.push(&frame, block.back(number));
        }
        self.keep(kept);
        while self.pinned_size > self.room / PINNED_PART {
            let Some(dropped) = self.pinned.pop_front() else { break };
            self.pinned_size -= dropped.size();
        }
    }

    fn keep(&mut self, block: Option<FrameBlock>) {
        let Some(mut block) = block else { return };
        block.shrink();
        self.pinned_size += block.size();
        self.pinned.push_back(Arc::new(block));
    }

    /// Returns the block in which the frame `number` is; `None` if there is none.
    fn block_of(&self, number: u64) -> Option<BlockRef<'_>> {
        let blocks = if number >= self.first_in_memory() {
            &self.recent
        } else if let Some(block) = self.indexed.as_ref().and_then(|it| it.block_of(number)) {
            return Some(BlockRef::Read(block));
        } else {
            &self.pinned
        };
        let after = blocks.partition_point(|block| block.first <= number);
        let block = blocks.get(after.checked_sub(1)?)?;
        (number < block.end()).then_some(BlockRef::Stored(block))
    }

    /// The frame with this number; `None` if it is not stored.
    pub fn get(&self, number: u64) -> Option<Frame> {
        let block = self.block_of(number)?;
        block.record(number).map(|record| block.decode(record))
    }

    /// Number of the last frame before this one with the same identifier; `None` if it is not known. It
    /// may be stored no more.
    pub fn previous(&self, number: u64) -> Option<u64> {
        let back = self.block_of(number)?.back(number);
        number.checked_sub(u64::from(back)).filter(|_| back > 0)
    }

    /// Number of the last frame before this one with the same identifier in all bits, also RND7; `None` if
    /// it is not known, and not stored or not among the 1024 before it.
    pub fn previous_with_all_bits(&self, number: u64) -> Option<u64> {
        let id = self.get(number)?.id;
        let before = std::iter::successors(self.previous(number), |before| self.previous(*before));
        let mut looked_at = before.take(MAX_LOOKED_AT);
        looked_at.find(|before| self.get(*before).is_some_and(|frame| frame.id == id))
    }

    /// Number of the last stored frame with an identifier, which has this row, among `numbers`; `None`
    /// without one. Blocks without a frame of the row are not looked into.
    pub fn last_within(&self, numbers: Range<u64>, row: usize, key: &IdentifierKey) -> Option<u64> {
        let Range { start, end } = numbers;
        let in_memory = |blocks: &VecDeque<Arc<FrameBlock>>| {
            let candidates = blocks.iter().rev().skip_while(|block| block.first >= end);
            candidates
                .take_while(|block| block.end() > start)
                .filter(|block| block.rows.contains(row))
                .find_map(|block| block.last_before(end, key))
        };
        let indexed = || {
            let indexed = self.indexed.as_ref()?;
            let candidates = indexed.blocks().rev().skip_while(|block| block.first >= end);
            candidates
                .take_while(|block| block.end() > start)
                .filter(|block| block.rows.contains(row))
                .find_map(|block| indexed.source().block(block)?.last_before(end, key))
        };
        let found = in_memory(&self.recent).or_else(indexed).or_else(|| in_memory(&self.pinned));
        found.filter(|number| *number >= start)
    }

    /// Time of a frame; `None` if it is not stored.
    pub fn time_of(&self, number: u64) -> Option<Instant> {
        let block = self.block_of(number)?;
        block.record(number).map(|record| block.time_of(record))
    }

    /// Ranges of consecutive numbers that are stored, oldest first.
    pub fn ranges(&self) -> impl DoubleEndedIterator<Item = Range<u64>> {
        let stored = |block: &Arc<FrameBlock>| block.first..block.end();
        let indexed = self.indexed.iter().flat_map(IndexedFrames::blocks);
        let indexed = indexed.map(|block| block.first..block.end());
        self.pinned.iter().map(stored).chain(indexed).chain(self.recent.iter().map(stored))
    }

    /// Number of frames behind one and before another that are not stored.
    pub fn missing_between(&self, after: u64, before: u64) -> u64 {
        let between = after + 1..before;
        if between.is_empty() || after >= self.first() {
            return 0;
        }
        let overlap =
            |it: Range<u64>| it.end.min(between.end).saturating_sub(it.start.max(between.start));
        let from = self.ranges().skip_while(|range| range.end <= between.start);
        let stored: u64 = from.take_while(|range| range.start < between.end).map(overlap).sum();
        between.end - between.start - stored
    }

    /// Frames from `from` on with their numbers, oldest first.
    pub fn frames_from(&self, from: u64) -> impl Iterator<Item = (u64, Frame)> {
        let ranges = self.ranges().skip_while(move |range| range.end <= from);
        ranges.flat_map(move |range| {
            let number = range.start.max(from);
            FramesOfBlock { block: self.block_of(number), number }
        })
    }

    /// Returns the frames that are stored now; more frames do not change it.
    pub fn snapshot(&self) -> StoredFrames {
        let stored = |block: &Arc<FrameBlock>| StoredBlock::Memory(Arc::clone(block));
        let indexed = self.indexed.iter().flat_map(|indexed| {
            let source = indexed.source();
            indexed.blocks().map(|block| StoredBlock::Log(Arc::clone(block), source.clone()))
        });
        let blocks = self.pinned.iter().map(stored).chain(indexed);
        StoredFrames { blocks: blocks.chain(self.recent.iter().map(stored)).collect() }
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
        let in_block = |block: &FrameBlock| {
            let at = block.records.partition_point(|record| block.time_of(record) < time);
            block.first + at as u64
        };
        let in_blocks = |blocks: &VecDeque<Arc<FrameBlock>>| {
            blocks.get(blocks.partition_point(is_older)).map(|block| in_block(block))
        };
        let indexed = || Some(in_block(&*self.indexed.as_ref()?.block_at(time)?));
        let found = in_blocks(&self.pinned).or_else(indexed).or_else(|| in_blocks(&self.recent));
        found.unwrap_or(self.end)
    }
}

/// The frames of a block from a number on.
struct FramesOfBlock<'a> {
    block: Option<BlockRef<'a>>,
    number: u64,
}

impl Iterator for FramesOfBlock<'_> {
    type Item = (u64, Frame);

    fn next(&mut self) -> Option<(u64, Frame)> {
        let block = self.block.as_ref()?;
        let frame = block.decode(block.record(self.number)?);
        self.number += 1;
        Some((self.number - 1, frame))
    }
}

/// A block that was stored at some time.
#[derive(Clone, Debug)]
enum StoredBlock {
    Memory(Arc<FrameBlock>),
    Log(Arc<IndexedBlock>, IndexedSource),
}

impl StoredBlock {
    fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Memory(block), Self::Memory(other)) => Arc::ptr_eq(block, other),
            (Self::Log(block, _), Self::Log(other, _)) => Arc::ptr_eq(block, other),
            _ => false,
        }
    }
}

/// Frames that were stored at some time. They share their memory with the store.
#[derive(Clone, Debug)]
pub struct StoredFrames {
    blocks: Vec<StoredBlock>,
}

impl StoredFrames {
    /// Returns true if both share the same memory.
    pub fn is_same(&self, other: &Self) -> bool {
        let (ours, theirs) = (&self.blocks, &other.blocks);
        ours.len() == theirs.len() && ours.iter().zip(theirs).all(|(one, it)| one.is_same(it))
    }

    /// The frames, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = Frame> {
        self.blocks.iter().flat_map(|stored| {
            let block = match stored {
                StoredBlock::Memory(block) => Some(BlockRef::Stored(block)),
                StoredBlock::Log(block, source) => source.block(block).map(BlockRef::Read),
            };
            let number = block.as_ref().map_or(0, |block| block.first);
            FramesOfBlock { block, number }.map(|(_, frame)| frame)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::capture::identifiers::Identifiers;
    use crate::frame::{BusIndex, CanId};
    use crate::time::Duration;
    use std::io;
    use std::sync::Mutex;

    fn at(micros: u64) -> Instant {
        Instant::from_micros(micros)
    }

    fn filled(frames: u64) -> FrameStore {
        let mut store = FrameStore::new(FrameStore::MIN_ROOM);
        for number in 0..frames {
            let frame = Frame::classic(number as u32, &number.to_be_bytes());
            store.push(&frame.with_time(at(number * 1000)), None);
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
            store.push(frame, None);
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
            while store.about_to_drop(frame.time).is_some() {
                store.drop_oldest(std::slice::from_ref(&pin));
            }
            store.push(&frame, None);
        }
        assert_eq!(store.missing_between(55, 59), 0);
        assert_eq!(store.missing_between(59, store.first()), store.first() - 60);
        assert_eq!(store.missing_between(59, store.end()), store.first() - 60);
        assert_eq!(store.missing_between(store.first(), store.end()), 0);
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

    /// After a pause too long for one block, the oldest one is dropped before the last one is full.
    #[test]
    fn pinned_frames_outlive_a_long_pause() {
        let mut store = FrameStore::new(FrameStore::MIN_ROOM);
        let pin = at(1_000)..at(2_000);
        let mut time = at(0);
        for number in 0..2_000 {
            // An hour between two frames: each is in a block of its own.
            time += Duration::from_hours(u64::from(number >= 10)) + Duration::from_micros(500);
            while store.about_to_drop(time).is_some() {
                store.drop_oldest(std::slice::from_ref(&pin));
            }
            store.push(&Frame::classic(number, &[]).with_time(time), None);
        }
        assert_eq!(store.ranges().next(), Some(1..3));
    }

    #[test]
    fn pinned_frames_are_bounded() {
        let mut store = FrameStore::new(FrameStore::MIN_ROOM);
        for number in 0..500_000 {
            let frame = Frame::classic(number, &[]).with_time(at(u64::from(number) * 1000));
            while let Some((_, times)) = store.about_to_drop(frame.time) {
                store.drop_oldest(&[times.start..times.end + Duration::from_secs(1)]);
            }
            store.push(&frame, None);
        }
        let size = store.pinned_size + store.recent_size;
        assert!(size <= FrameStore::MIN_ROOM, "{size}");
        let pinned = store.ranges().map(|range| range.end - range.start).sum::<u64>();
        assert!(pinned * 24 > FrameStore::MIN_ROOM as u64 * 8 / 10, "{pinned}");
        let all: Vec<_> = store.ranges().collect();
        assert!(all.windows(2).all(|two| two[0].end == two[1].start), "without gaps: {all:?}");
    }

    /// A log whose frames are these, until they are changed.
    #[derive(Debug)]
    struct Log(Arc<Mutex<Vec<Frame>>>);

    impl FrameSource for Log {
        fn numbers(&self) -> Range<u64> {
            0..self.0.lock().unwrap().len() as u64
        }

        fn read(&mut self, numbers: Range<u64>, take: &mut dyn FnMut(Frame)) -> io::Result<()> {
            let log = self.0.lock().unwrap();
            let from = (numbers.start as usize).min(log.len());
            log[from..(numbers.end as usize).min(log.len())].iter().for_each(|frame| take(*frame));
            Ok(())
        }
    }

    /// Frames of several identifiers, lengths and gaps.
    fn mixed(number: u64) -> Frame {
        let data: Vec<u8> = (0..64).map(|byte: u8| byte ^ number as u8).collect();
        let frame = match number % 7 {
            0 => Frame::fd(number as u32 % 13, &data[..48], 0),
            1 => Frame::remote(CanId::Standard(number as u16 % 5), 3),
            it => Frame::classic((it as u32) << 17, &data[..8]).with_bus(BusIndex(it as u8 % 2)),
        };
        frame.with_time(at(number * 700 + number / 50_000 * 10_000_000_000))
    }

    fn store_of_log(frames: u64, room: usize) -> (FrameStore, Arc<Mutex<Vec<Frame>>>) {
        let log = Arc::new(Mutex::new(Vec::new()));
        let mut store = FrameStore::new(room);
        store.set_source(Box::new(Log(Arc::clone(&log))));
        let mut identifiers = Identifiers::new();
        for number in 0..frames {
            let frame = mixed(number);
            log.lock().unwrap().push(frame.with_time(frame.time + Duration::from_secs(9)));
            let link = identifiers.add(&frame, number);
            store.push(&frame, link);
        }
        (store, log)
    }

    #[test]
    fn frames_of_log_that_left_memory_are_read_again() {
        let (store, _) = store_of_log(150_000, FrameStore::MIN_ROOM);
        // Too much room for anything to be dropped.
        let mut all = FrameStore::new(1 << 30);
        let mut identifiers = Identifiers::new();
        for number in 0..150_000 {
            let frame = mixed(number);
            all.push(&frame, identifiers.add(&frame, number));
        }
        assert!(store.first_in_memory() > 120_000, "{}", store.first_in_memory());
        assert_eq!((store.first(), store.oldest(), store.end()), (0, 0, 150_000));
        for number in (0..150_000).step_by(977).chain([0, 4095, 4096, 149_999]) {
            assert_eq!(store.get(number), all.get(number), "{number}");
            assert_eq!(store.previous(number), all.previous(number), "{number}");
            let time = all.time_of(number).unwrap();
            assert_eq!(store.at_time(time), all.at_time(time), "{number}");
        }
        let frames: Vec<_> = store.frames_from(3_000).take(20_000).collect();
        assert!(frames.iter().copied().eq(all.frames_from(3_000).take(20_000)));
        assert!(store.snapshot().iter().eq(all.snapshot().iter()));
    }

    #[test]
    fn last_frame_of_an_identifier_before_a_number_is_found() {
        let (log, _) = store_of_log(60_000, FrameStore::MIN_ROOM);
        let mut memory = FrameStore::new(FrameStore::MIN_ROOM);
        let mut identifiers = Identifiers::new();
        for number in 0..60_000 {
            let frame = mixed(number);
            let link = identifiers.add(&frame, number);
            while memory.about_to_drop(frame.time).is_some() {
                // The first 100 frames are pinned.
                memory.drop_oldest(&[at(0)..at(70_000)]);
            }
            memory.push(&frame, link);
        }
        let keys: Vec<_> = identifiers.rows().iter().map(|row| row.key).collect();
        for end in [0, 1, 90, 101, 5_000, 31_000, 59_999, 60_000] {
            for (row, key) in keys.iter().enumerate().step_by(3) {
                for first in [0, 30_500] {
                    let is_last =
                        |number: &u64| IdentifierKey::of(&mixed(*number)) == *key && *number < end;
                    let expected = (first..end).rev().find(is_last);
                    let found = log.last_within(first..end, row, key);
                    assert_eq!(found, expected, "{key:?} before {end}");
                    let expected = (memory.first().max(first)..end).rev().find(is_last);
                    let pinned = || (first..end.min(100)).rev().find(is_last);
                    let found = memory.last_within(first..end, row, key);
                    assert_eq!(found, expected.or_else(pinned), "{key:?} before {end}");
                }
            }
        }
    }

    #[test]
    fn changed_log_has_no_frames_before_the_change() {
        let (store, log) = store_of_log(150_000, FrameStore::MIN_ROOM);
        log.lock().unwrap()[50_000] = Frame::classic(1, b"other");
        assert_eq!(store.get(10_000).map(|frame| frame.id), Some(mixed(10_000).id));
        assert_eq!(store.get(50_000), None);
        let first = store.first();
        assert!((50_001..60_000).contains(&first), "{first}");
        assert_eq!((store.get(first - 1), store.get(first)), (None, Some(mixed(first))));
        assert_eq!(store.frames_from(0).next().map(|(number, _)| number), Some(first));
    }

    #[test]
    fn index_of_log_is_bounded() {
        let (store, _) = store_of_log(400_000, FrameStore::MIN_ROOM);
        let indexed = store.indexed.as_ref().unwrap().size();
        assert!(indexed <= FrameStore::MIN_ROOM / LOG_PART, "{indexed}");
        assert!(store.recent_size <= FrameStore::MIN_ROOM / LOG_PART);
    }
}
