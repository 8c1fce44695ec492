//! Files that are read in any order: their bytes, and the stream of entries in their place.
//!
//! A log on disk is read where it is. One that is compressed, or comes from a pipe, is first written to a
//! file that the caller makes, or to bounded memory. Does not know formats.

use super::entry_stream::EntryWriter;
use crate::positioned_read;
use std::fs::File;
use std::io::{self, Read, Write};
use std::sync::Arc;

/// Most memory of a log for which the caller makes no file, in bytes.
const MAX_IN_MEMORY: u64 = 16 << 20;

/// The bytes of a log in any order.
pub trait RandomAccess: Send {
    /// Reads bytes from `offset` on. Fewer than `buffer` has room for may be read; none at the end.
    ///
    /// # Errors
    ///
    /// Those of the file.
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<usize>;
}

impl RandomAccess for Arc<File> {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
        positioned_read::read_at(self, buffer, offset)
    }
}

impl RandomAccess for Vec<u8> {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
        let start = usize::try_from(offset).unwrap_or(usize::MAX).min(self.len());
        (&self[start..]).read(buffer)
    }
}

/// A file for a log that is read in any order.
pub trait LogSpool: Write + RandomAccess {
    /// Ends writing.
    fn into_bytes(self: Box<Self>) -> Box<dyn RandomAccess>;
}

/// Makes a file for a log.
pub type MakeSpool = fn() -> io::Result<Box<dyn LogSpool>>;

/// Reads bytes from `offset` on until `buffer` is full, or to the end; returns how many.
///
/// # Errors
///
/// Those of the file.
pub(super) fn read_full_at(
    bytes: &dyn RandomAccess,
    buffer: &mut [u8],
    offset: u64,
) -> io::Result<usize> {
    let mut count = 0;
    while count < buffer.len() {
        // No file has bytes there; a system refuses to read them.
        let at = offset.checked_add(count as u64).filter(|at| i64::try_from(*at).is_ok());
        let Some(at) = at else { break };
        match bytes.read_at(&mut buffer[count..], at) {
            Ok(0) => break,
            Ok(read) => count += read,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(count)
}

/// A format whose files are read in any order.
pub(super) trait RandomFormat: Send {
    /// Appends the next entries to `out`. Returns false at the end, or behind damage.
    ///
    /// # Errors
    ///
    /// Those of the file.
    fn read_on(&mut self, bytes: &dyn RandomAccess, out: &mut EntryWriter) -> io::Result<bool>;
}

/// A log that is stored to be read in any order, and why not all of it could be.
pub(super) type StoredLog<'a> = (Box<dyn RandomAccess + 'a>, Option<io::Error>);

/// Stores a log: in the file that `spool` makes, or in memory.
///
/// # Errors
///
/// Those of writing the file.
pub(super) fn store<'a>(
    mut source: impl Read,
    spool: Option<MakeSpool>,
) -> io::Result<StoredLog<'a>> {
    let mut part = vec![0; 1 << 16];
    let mut failure = None;
    let mut next = |part: &mut [u8]| {
        let count = source.read(part).unwrap_or_else(|error| {
            failure = Some(error);
            0
        });
        (count > 0).then_some(count)
    };
    if let Some(spool) = spool {
        let mut file = spool()?;
        while let Some(count) = next(&mut part) {
            file.write_all(&part[..count])?;
        }
        return Ok((file.into_bytes(), failure));
    }
    let mut bytes = Vec::new();
    while let Some(count) = next(&mut part) {
        bytes.extend_from_slice(&part[..count]);
        if bytes.len() as u64 > MAX_IN_MEMORY {
            failure = Some(io::ErrorKind::OutOfMemory.into());
            break;
        }
    }
    Ok((Box::new(bytes), failure))
}

/// The stream of entries of a file that is read in any order.
pub(super) struct EntryStream<'a, F> {
    bytes: Box<dyn RandomAccess + 'a>,
    format: F,
    entries: EntryWriter,
    /// Bytes of the entries that were given.
    given: usize,
    is_over: bool,
    /// Why not all of the file is there, for the end of the stream.
    failure: Option<io::Error>,
}

impl<'a, F: RandomFormat> EntryStream<'a, F> {
    /// Begins a stream with these first bytes.
    pub fn new((bytes, failure): StoredLog<'a>, format: F, magic: &[u8]) -> Self {
        let entries = EntryWriter::new(magic);
        Self { bytes, format, entries, given: 0, is_over: false, failure }
    }
}

impl<F: RandomFormat> Read for EntryStream<'_, F> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.given == self.entries.bytes().len() {
            if self.is_over {
                return self.failure.take().map_or(Ok(0), Err);
            }
            self.entries.clear();
            self.given = 0;
            self.is_over = !self.format.read_on(self.bytes.as_ref(), &mut self.entries)?;
        }
        let count = (&self.entries.bytes()[self.given..]).read(buffer)?;
        self.given += count;
        Ok(count)
    }
}
