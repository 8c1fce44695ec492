//! Binary logs: entries cut out of pieces of any size.
//!
//! A format says how long an entry is and reads it when it is whole. The memory is bounded by the longest
//! entry that it wants. Does not know formats.

use super::{Damage, DecodeStep, LogDecoder, LogSummary};
use crate::frame::Frame;
use std::fmt;

/// A binary format.
pub(super) trait BinaryFormat: Clone + fmt::Debug + Default + Send + 'static {
    /// Reads to the end of an entry, or of what is known of it.
    ///
    /// # Errors
    ///
    /// The rest of the log cannot be read.
    fn read(
        &mut self,
        entry: &mut EntryInput<'_>,
        summary: &mut LogSummary,
    ) -> Result<Option<Frame>, Damage>;

    /// Reads the frame of a known interface that `bytes` begin with; also returns the bytes of its entry.
    /// `None`, without an effect, if something else is there.
    fn read_frame(&mut self, bytes: &[u8], summary: &mut LogSummary) -> Option<(usize, Frame)>;

    /// Returns where an entry begins in the last bytes of a log; `None` if that is not known.
    fn entry_start(&self, _: &[u8]) -> Option<usize> {
        None
    }
}

/// The entry that is being read.
#[derive(Clone, Debug, Default)]
struct EntryBuffer {
    /// Its beginning.
    bytes: Vec<u8>,
    /// Bytes left to skip of one that is not read.
    skip: u64,
}

/// The entry that is being read, and the piece that may complete it.
pub(super) struct EntryInput<'i> {
    buffer: &'i mut EntryBuffer,
    piece: &'i [u8],
    used: usize,
}

impl EntryInput<'_> {
    /// Takes bytes of the piece until the entry has `wanted`; returns false if there are not as many.
    pub fn fill(&mut self, wanted: usize) -> bool {
        let (buffer, rest) = (&mut self.buffer.bytes, &self.piece[self.used..]);
        let count = rest.len().min(wanted.saturating_sub(buffer.len()));
        buffer.extend_from_slice(&rest[..count]);
        self.used += count;
        buffer.len() >= wanted
    }

    /// The bytes of the entry so far.
    pub fn bytes(&self) -> &[u8] {
        &self.buffer.bytes
    }

    /// Drops the first bytes, which belong to no entry.
    pub fn discard(&mut self, count: usize) {
        self.buffer.bytes.drain(..count);
    }

    /// Ends the entry.
    pub fn end(&mut self) {
        self.buffer.bytes.clear();
    }

    /// Ends the entry, which is `len` bytes long, without reading it.
    pub fn skip(&mut self, len: u64) {
        self.buffer.skip = len.saturating_sub(self.buffer.bytes.len() as u64);
        self.end();
    }
}

/// Reads one log of a binary format.
#[derive(Clone, Debug, Default)]
pub(super) struct EntryDecoder<F> {
    format: F,
    buffer: EntryBuffer,
}

impl<F: BinaryFormat> LogDecoder for EntryDecoder<F> {
    fn decode(&mut self, bytes: &[u8], summary: &mut LogSummary) -> (usize, DecodeStep) {
        if summary.damage.is_some_and(|damage| !damage.is_truncated()) {
            return (0, DecodeStep::End);
        }
        // The file has grown since its end was reached.
        summary.damage = None;
        let skip = &mut self.buffer.skip;
        if *skip > 0 {
            let skipped = bytes.len().min(usize::try_from(*skip).unwrap_or(usize::MAX));
            *skip -= skipped as u64;
            return (skipped, DecodeStep::Nothing);
        }
        let mut entry = EntryInput { buffer: &mut self.buffer, piece: bytes, used: 0 };
        let step = match self.format.read(&mut entry, summary) {
            Ok(frame) => frame.map_or(DecodeStep::Nothing, DecodeStep::Frame),
            Err(damage) => {
                summary.damage = Some(damage);
                DecodeStep::End
            }
        };
        (entry.used, step)
    }

    fn decode_frames(
        &mut self,
        bytes: &[u8],
        summary: &mut LogSummary,
        frames: &mut Vec<Frame>,
        most: usize,
    ) -> usize {
        let mut used = 0;
        if summary.damage.is_some() || self.buffer.skip > 0 || self.has_partial_entry() {
            return used;
        }
        while frames.len() < most
            && let Some((len, frame)) = self.format.read_frame(&bytes[used..], summary)
        {
            frames.push(frame);
            used += len;
        }
        used
    }

    fn handle_end(&mut self, summary: &mut LogSummary) {
        if summary.damage.is_none_or(Damage::is_truncated) {
            // Zeros may be padding.
            let is_cut = self.buffer.skip > 0 || self.buffer.bytes.iter().any(|&byte| byte != 0);
            summary.damage = is_cut.then_some(Damage::Truncated);
        }
    }

    fn has_partial_entry(&self) -> bool {
        !self.buffer.bytes.is_empty()
    }

    fn entry_start(&self, tail: &[u8]) -> Option<usize> {
        self.format.entry_start(tail)
    }

    fn copy(&self) -> Box<dyn LogDecoder> {
        Box::new(self.clone())
    }
}
