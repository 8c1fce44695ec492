//! Frames of a log that are not in memory: where they are, and the last ones that were read again.
//!
//! A block that the capture drops leaves an entry with its numbers, its time, and a digest of its
//! frames. A block that is read again must have that digest: of a log that was changed meanwhile, the
//! frames before are no longer there. Bounded: entries and blocks have a room in bytes. Does not know
//! files: the frames come from a [`FrameSource`].

use super::frame_block::FrameBlock;
use super::row_set::RowSet;
use crate::log::FrameSource;
use crate::time::Instant;
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// A block of frames that is not in memory.
#[derive(Debug)]
pub(super) struct IndexedBlock {
    /// Number of the first frame.
    pub first: u64,
    count: u32,
    /// Time of the first and of the last frame.
    pub time: Instant,
    pub last: Instant,
    digest: u64,
    links: Box<[u8]>,
    /// Rows of the identifiers of the frames.
    pub rows: RowSet,
}

impl IndexedBlock {
    fn of(block: &FrameBlock) -> Self {
        Self {
            first: block.first,
            count: block.records.len() as u32,
            time: block.time,
            last: block.last_time().unwrap_or(block.time),
            digest: block.digest(),
            links: block.links(),
            rows: block.rows.clone(),
        }
    }

    /// Number behind the last frame.
    pub fn end(&self) -> u64 {
        self.first + u64::from(self.count)
    }

    fn size(&self) -> usize {
        size_of::<Self>() + size_of::<Arc<Self>>() + self.links.len() + self.rows.size()
    }

    fn read(&self, source: &mut dyn FrameSource) -> Option<FrameBlock> {
        let mut block = FrameBlock::new(self.first, self.time, self.count as usize);
        let mut start = None;
        let read = source.read(self.first..self.end(), &mut |frame| {
            let start = *start.get_or_insert(frame.time);
            // Frames of several buses may be slightly out of order.
            let time = (self.time + frame.time.since(start)) - start.since(frame.time);
            block.push(&frame.with_time(time), 0);
        });
        if read.is_err() || block.digest() != self.digest {
            return None;
        }
        block.set_links(&self.links);
        Some(block)
    }
}

/// Reads blocks again, and keeps the last ones.
#[derive(Debug)]
struct BlockReader {
    source: Box<dyn FrameSource>,
    /// The last one read at the end.
    blocks: VecDeque<Arc<FrameBlock>>,
    size: usize,
    room: usize,
}

impl BlockReader {
    fn block(&mut self, wanted: &IndexedBlock) -> Option<Arc<FrameBlock>> {
        let is_wanted = |block: &Arc<FrameBlock>| block.first == wanted.first;
        if let Some(at) = self.blocks.iter().rposition(is_wanted) {
            let block = self.blocks.remove(at)?;
            self.blocks.push_back(Arc::clone(&block));
            return Some(block);
        }
        let block = Arc::new(wanted.read(self.source.as_mut())?);
        self.size += block.size();
        self.blocks.push_back(Arc::clone(&block));
        while self.size > self.room && self.blocks.len() > 1 {
            let Some(dropped) = self.blocks.pop_front() else { break };
            self.size -= dropped.size();
        }
        Some(block)
    }
}

/// Access to the blocks of a log, shared with what writes them elsewhere.
#[derive(Clone, Debug)]
pub(super) struct IndexedSource {
    reader: Arc<Mutex<BlockReader>>,
    /// Frames with lower numbers cannot be read any more.
    unreadable: Arc<AtomicU64>,
}

impl IndexedSource {
    /// Reads a block; `None` if the log was changed since it was indexed.
    pub fn block(&self, wanted: &IndexedBlock) -> Option<Arc<FrameBlock>> {
        if wanted.first < self.unreadable.load(Ordering::Relaxed) {
            return None;
        }
        // A panic of another thread leaves nothing half-done in here, so its poison is ignored.
        let mut reader = self.reader.lock().unwrap_or_else(PoisonError::into_inner);
        let block = reader.block(wanted);
        if block.is_none() {
            self.unreadable.fetch_max(wanted.end(), Ordering::Relaxed);
        }
        block
    }
}

/// The blocks of a log that are not in memory.
#[derive(Debug)]
pub(super) struct IndexedFrames {
    source: IndexedSource,
    /// Oldest first, with consecutive numbers.
    blocks: VecDeque<Arc<IndexedBlock>>,
    size: usize,
    room: usize,
}

impl IndexedFrames {
    /// Returns an empty index; entries and blocks take at most `room` bytes each.
    pub fn new(source: Box<dyn FrameSource>, room: usize) -> Self {
        let reader = BlockReader { source, blocks: VecDeque::new(), size: 0, room };
        let reader = Arc::new(Mutex::new(reader));
        let source = IndexedSource { reader, unreadable: Arc::default() };
        Self { source, blocks: VecDeque::new(), size: 0, room }
    }

    /// Adds a block that is dropped from memory. Returns false if it cannot be read again: then there
    /// is nothing before it either.
    pub fn add(&mut self, block: &FrameBlock) -> bool {
        let numbers = self.readable();
        let is_next = self.blocks.back().is_none_or(|last| last.end() == block.first);
        if !is_next || block.first < numbers.start || block.end() > numbers.end {
            self.blocks.clear();
            self.size = 0;
            return false;
        }
        let block = IndexedBlock::of(block);
        self.size += block.size();
        self.blocks.push_back(Arc::new(block));
        let first = numbers.start.max(self.source.unreadable.load(Ordering::Relaxed));
        let is_gone = |block: &Arc<IndexedBlock>| block.first < first;
        while self.size > self.room || self.blocks.front().is_some_and(is_gone) {
            let Some(dropped) = self.blocks.pop_front() else { break };
            self.size -= dropped.size();
        }
        true
    }

    fn readable(&self) -> Range<u64> {
        let reader = self.source.reader.lock().unwrap_or_else(PoisonError::into_inner);
        reader.source.numbers()
    }

    /// The blocks that can be read, as far as is known, oldest first.
    pub fn blocks(
        &self,
    ) -> impl DoubleEndedIterator<Item = &Arc<IndexedBlock>> + ExactSizeIterator {
        let unreadable = self.source.unreadable.load(Ordering::Relaxed);
        self.blocks.range(self.blocks.partition_point(|block| block.first < unreadable)..)
    }

    /// The block in which the frame `number` is; `None` if there is none.
    pub fn block_of(&self, number: u64) -> Option<Arc<FrameBlock>> {
        let after = self.blocks.partition_point(|block| block.first <= number);
        let block = self.blocks.get(after.checked_sub(1)?)?;
        if number < block.end() { self.source.block(block) } else { None }
    }

    /// The first block with a frame that is not older than `time`; `None` if all are older.
    pub fn block_at(&self, time: Instant) -> Option<Arc<FrameBlock>> {
        let blocks = self.blocks().skip_while(|block| block.last < time);
        blocks.into_iter().find_map(|block| self.source.block(block))
    }

    /// Bytes of the entries.
    #[cfg(test)]
    pub fn size(&self) -> usize {
        self.size
    }

    /// Access to the blocks.
    pub fn source(&self) -> &IndexedSource {
        &self.source
    }
}
