//! Index of a log: places from which its frames can be read again by their numbers.
//!
//! Made while the log is read, one place every 4096 frames, and fewer of a log of more than 30
//! million. Of a log that was truncated or replaced only the new frames can be read. Does not know
//! what frames are read for.

use crate::frame::{BusIndex, Frame};
use crate::log::{FrameSource, LogPosition, LogReader};
use crate::positioned_read::read_at;
use crate::time::Instant;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Frames between two places at first.
const SPACING: u64 = 4096;
/// Most places: together about 4 MB.
const MAX_PLACES: usize = 8192;
/// Most frames that are decoded together.
const AT_ONCE: usize = 256;
/// Bytes that are read at once.
const PART: usize = 1 << 16;

/// A position in a log, and its place in the file.
#[derive(Debug)]
struct IndexedPlace {
    position: LogPosition,
    offset: u64,
}

/// What is known of a log so far.
#[derive(Debug)]
struct IndexedLog {
    log: Arc<File>,
    /// By position.
    places: Vec<IndexedPlace>,
    spacing: u64,
    /// Number of frames that were read.
    end: u64,
}

/// Index of a log; clones share it.
#[derive(Clone, Debug)]
pub(super) struct LogIndex {
    /// Bus of the first interface of the log.
    bus: BusIndex,
    places: Arc<Mutex<IndexedLog>>,
}

impl LogIndex {
    /// Returns the index of a log of which nothing was read.
    pub fn new(log: File, bus: BusIndex, start: LogPosition) -> Self {
        let start = IndexedPlace { position: start, offset: 0 };
        let (log, places) = (Arc::new(log), vec![start]);
        let places = IndexedLog { log, places, spacing: SPACING, end: 0 };
        Self { bus, places: Arc::new(Mutex::new(places)) }
    }

    /// Notes that a frame was read; the reader is at `position` now, which is at `offset` in the file.
    pub fn note_frame(&self, frames: u64, position: impl FnOnce() -> (LogPosition, u64)) {
        let mut places = self.places();
        places.end = frames;
        if !frames.is_multiple_of(places.spacing) {
            return;
        }
        let (position, offset) = position();
        places.places.push(IndexedPlace { position, offset });
        if places.places.len() > MAX_PLACES {
            places.thin_out();
        }
    }

    /// Begins anew: another log follows, or this one from its start.
    pub fn restart(&self, log: File, position: LogPosition) {
        let mut places = self.places();
        places.end = position.frames();
        places.log = Arc::new(log);
        places.places = vec![IndexedPlace { position, offset: 0 }];
    }

    /// Time of the last frame in the file, counted from the start of the log; `None` if the end of the
    /// file does not show it. Call when the first frame was read.
    pub fn last_time(&self, position: &LogPosition) -> Option<Instant> {
        let log = Arc::clone(&self.places().log);
        position.last_time_of(&log).ok()?
    }

    // A panic of another thread leaves nothing half-done in here, so its poison is ignored.
    fn places(&self) -> MutexGuard<'_, IndexedLog> {
        self.places.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl IndexedLog {
    fn first(&self) -> u64 {
        self.places.first().map_or(self.end, |first| first.position.frames())
    }

    /// Drops every other place, but not the first one.
    fn thin_out(&mut self) {
        self.spacing *= 2;
        let (first, spacing) = (self.first(), self.spacing);
        self.places.retain(|place| {
            let frames = place.position.frames();
            frames == first || frames.is_multiple_of(spacing)
        });
    }

    /// Returns a reader of the last place that is not behind a frame, and the number of its frame.
    fn reader_for(&self, number: u64) -> Option<(LogReader<BufReader<FilePart>>, u64)> {
        let after = self.places.partition_point(|place| place.position.frames() <= number);
        let place = self.places.get(after.checked_sub(1)?)?;
        let part = FilePart { file: Arc::clone(&self.log), offset: place.offset };
        let source = BufReader::with_capacity(PART, part);
        Some((LogReader::at(source, &place.position), place.position.frames()))
    }
}

impl FrameSource for LogIndex {
    fn numbers(&self) -> Range<u64> {
        let places = self.places();
        places.first()..places.end
    }

    fn read(&mut self, numbers: Range<u64>, take: &mut dyn FnMut(Frame)) -> io::Result<()> {
        let Some((mut reader, first)) = self.places().reader_for(numbers.start) else {
            return Ok(());
        };
        let (mut number, mut frames) = (first, Vec::with_capacity(AT_ONCE));
        while number < numbers.end {
            // The last line of a file may have no end.
            let Some(frame) = reader.next_frame()? else { return Ok(()) };
            frames.push(frame);
            let left = usize::try_from(numbers.end - number).unwrap_or(AT_ONCE);
            reader.take_buffered(&mut frames, left.min(AT_ONCE));
            for frame in frames.drain(..) {
                if number >= numbers.start {
                    take(frame.with_bus(BusIndex(self.bus.0.saturating_add(frame.bus.0))));
                }
                number += 1;
            }
        }
        Ok(())
    }
}

/// A file from an offset on, whose own position stays.
#[derive(Debug)]
pub(super) struct FilePart {
    file: Arc<File>,
    offset: u64,
}

impl FilePart {
    /// Returns a whole file.
    pub fn new(file: Arc<File>) -> Self {
        Self { file, offset: 0 }
    }

    /// The file.
    pub fn file(&self) -> Arc<File> {
        Arc::clone(&self.file)
    }
}

impl Read for FilePart {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = read_at(&self.file, buffer, self.offset)?;
        self.offset += read as u64;
        Ok(read)
    }
}
