//! Packed logs: compressed with gzip, zstd or xz, the containers of BLF, and databases of SQLite. The bytes
//! of the file in, those of the log out.
//!
//! Known by their first bytes. A log may be packed twice, such as a BLF log in gzip. The memory does not
//! depend on lengths in the file. Does not know formats but BLF's containers and those that are read in any
//! order. Each way to pack has a reader in a file here.

mod containers;
mod gzip;
mod xz;
mod zstd;

use super::blf;
use super::entry_stream::{RECORDS_MAGIC, ROWS_MAGIC};
use super::mdf::{self, MdfLog};
use super::random_access::{EntryStream, MakeSpool, RandomAccess, store};
use super::sqlite::{self, SqliteTable};
use super::summary::UnreadChanges;
use containers::ContainerReader;
use gzip::GzipReader;
use std::io::{self, Read, Write};
use xz::XzReader;
use zstd::ZstdReader;

/// How often a log may be packed.
const MAX_LAYERS: usize = 3;
/// Most memory of a decompressor, in bytes: the largest dictionary of `xz -9` is half of it.
const MAX_WINDOW: u32 = 128 << 20;

/// How a log is packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// Compressed with gzip.
    Gzip,
    /// Compressed with zstd.
    Zstd,
    /// Compressed with xz.
    Xz,
    /// The containers of a BLF log.
    Blf,
    /// The pages of a database of SQLite.
    Sqlite,
    /// The blocks of ASAM MDF 4.
    Mdf,
}

impl Packing {
    /// First bytes of a log that are needed.
    pub const HEAD: usize = 16;

    const ALL: [(Self, &[u8]); 7] = [
        (Self::Gzip, &[0x1F, 0x8B]),
        (Self::Zstd, &[0x28, 0xB5, 0x2F, 0xFD]),
        (Self::Xz, &[0xFD, b'7', b'z', b'X', b'Z', 0]),
        (Self::Blf, blf::MAGIC),
        (Self::Sqlite, sqlite::MAGIC),
        (Self::Mdf, mdf::MAGIC),
        (Self::Mdf, mdf::UNFINISHED_MAGIC),
    ];

    /// Returns how a log with these first bytes is packed; `None` if it is not.
    pub fn of_head(head: &[u8]) -> Option<Self> {
        let found = Self::ALL.iter().find(|(_, magic)| head.starts_with(magic));
        let skippable = || skippable_zstd(head).filter(|is_whole| *is_whole);
        found.map(|(packing, _)| *packing).or_else(|| skippable().map(|_| Self::Zstd))
    }

    /// Returns true if more bytes are needed to know.
    fn is_undecided(head: &[u8]) -> bool {
        Self::ALL.iter().any(|(_, magic)| head.len() < magic.len() && magic.starts_with(head))
            || skippable_zstd(head) == Some(false)
    }
}

/// Returns whether these first bytes are all four of a skippable frame of zstd, with which pzstd begins a
/// file (RFC 8878, 3.1.2); `None` for those of something else.
fn skippable_zstd(head: &[u8]) -> Option<bool> {
    const MAGIC: [u8; 4] = [0x50, 0x2A, 0x4D, 0x18];
    let (first, rest) = head.split_first()?;
    let is_begun = first & 0xF0 == MAGIC[0] && rest.iter().zip(&MAGIC[1..]).all(|(a, b)| a == b);
    is_begun.then_some(head.len() >= MAGIC.len())
}

/// A log that is unpacked while it is read, or read as it is.
///
/// Errors of the file are passed on. The kind [`io::ErrorKind::UnexpectedEof`] says that the packed log is
/// cut off, [`io::ErrorKind::InvalidData`] that it is damaged, [`io::ErrorKind::OutOfMemory`] that its
/// decompression needs too much memory, [`io::ErrorKind::Unsupported`] that it is compressed in a way that is
/// not read.
pub struct Unpacked<'a> {
    source: UnpackedSource<'a>,
    access: LogAccess<'a>,
    /// Where the unpacked bytes are written, too.
    copy: Option<Box<dyn Write + Send + 'a>>,
    /// Why the rest of a packed log cannot be read.
    failure: Option<io::ErrorKind>,
    /// Bytes of the log that were read.
    count: u64,
}

/// How formats are read that are read in any order.
#[derive(Default)]
struct LogAccess<'a> {
    /// The file that the source reads.
    file: Option<Box<dyn RandomAccess + 'a>>,
    /// Makes a file for other sources.
    spool: Option<MakeSpool>,
    /// Changes of a database that are in a file beside it.
    unread: Option<UnreadChanges>,
}

enum UnpackedSource<'a> {
    /// Nothing was read.
    Start(Option<Box<dyn Read + Send + 'a>>),
    Plain(Box<dyn Read + Send + 'a>),
    Packed(Box<dyn Read + Send + 'a>),
}

impl<'a> Unpacked<'a> {
    /// Begins with the first byte of `source`.
    pub fn new(source: impl Read + Send + 'a) -> Self {
        let source = UnpackedSource::Start(Some(Box::new(source)));
        Self { source, access: LogAccess::default(), copy: None, failure: None, count: 0 }
    }

    /// Reads formats that are read in any order in the file that the source reads; `unread` says what is
    /// beside it.
    #[must_use]
    pub fn with_file(
        mut self,
        file: impl RandomAccess + 'a,
        unread: Option<UnreadChanges>,
    ) -> Self {
        self.access.file = Some(Box::new(file));
        self.access.unread = unread;
        self
    }

    /// Writes logs of such formats that are not read in a file to one that `spool` makes; they are held in
    /// memory, up to 16 MB, without it.
    #[must_use]
    pub fn with_spool(mut self, spool: MakeSpool) -> Self {
        self.access.spool = Some(spool);
        self
    }

    /// Also writes the bytes of a packed log to `copy`.
    #[must_use]
    pub fn with_copy(mut self, copy: impl Write + Send + 'a) -> Self {
        self.copy = Some(Box::new(copy));
        self
    }

    /// Returns the number of bytes of the log that were read, unpacked.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Reads the first bytes and opens the layers of the log.
    fn open(
        source: Box<dyn Read + Send + 'a>,
        access: LogAccess<'a>,
    ) -> io::Result<UnpackedSource<'a>> {
        let mut source: Box<dyn Read + Send + 'a> = Box::new(Uninterrupted(source));
        let (mut is_packed, mut file) = (false, access.file);
        for _ in 0..MAX_LAYERS {
            let head = read_head(&mut source)?;
            let packing = Packing::of_head(&head);
            let whole = Box::new(io::Cursor::new(head).chain(source));
            let Some(packing) = packing else {
                source = whole;
                break;
            };
            is_packed = true;
            source = match packing {
                Packing::Gzip => Box::new(GzipReader::new(whole)),
                Packing::Zstd => Box::new(ZstdReader::new(whole)),
                Packing::Xz => Box::new(XzReader::new(whole)),
                // The objects begin with the same bytes.
                Packing::Blf => {
                    source = Box::new(ContainerReader::new(whole));
                    break;
                }
                Packing::Sqlite | Packing::Mdf => {
                    let stored = match file.take() {
                        Some(file) => (file, None),
                        None => store(whole, access.spool)?,
                    };
                    source = if packing == Packing::Sqlite {
                        let table = SqliteTable::new(access.unread);
                        Box::new(EntryStream::new(stored, table, ROWS_MAGIC))
                    } else {
                        Box::new(EntryStream::new(stored, MdfLog::new(), RECORDS_MAGIC))
                    };
                    break;
                }
            };
            // The file has the compressed bytes.
            file = None;
        }
        Ok(if is_packed { UnpackedSource::Packed(source) } else { UnpackedSource::Plain(source) })
    }
}

/// Reads as many bytes as are needed to know how a log is packed.
fn read_head(source: &mut (impl Read + ?Sized)) -> io::Result<Vec<u8>> {
    let mut head = Vec::with_capacity(Packing::HEAD);
    while Packing::of_head(&head).is_none() && Packing::is_undecided(&head) {
        let mut byte = [0];
        match source.read(&mut byte) {
            Ok(0) => break,
            Ok(_) => head.extend(byte),
            Err(error) => return Err(classified(error)),
        }
    }
    Ok(head)
}

impl Read for Unpacked<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if let UnpackedSource::Start(source) = &mut self.source {
            let source = source.take().ok_or(io::ErrorKind::UnexpectedEof)?;
            self.source = Self::open(source, std::mem::take(&mut self.access))?;
        }
        if let Some(failure) = self.failure {
            return Err(failure.into());
        }
        let count = match &mut self.source {
            UnpackedSource::Start(_) => 0,
            UnpackedSource::Plain(source) => source.read(buffer)?,
            UnpackedSource::Packed(source) => {
                let read = source.read(buffer).map_err(classified);
                self.failure = read.as_ref().err().map(io::Error::kind);
                let count = read?;
                if let Some(copy) = &mut self.copy {
                    copy.write_all(&buffer[..count])?;
                }
                count
            }
        };
        self.count += count as u64;
        Ok(count)
    }
}

/// Returns an error of a decompressor as it is passed on: one of the file unchanged.
fn classified(error: io::Error) -> io::Error {
    let is_of_file = error.raw_os_error().is_some();
    match error.kind() {
        io::ErrorKind::UnexpectedEof => error,
        _ if is_of_file => error,
        // Decompression needs too much memory, or a filter that is not supported.
        io::ErrorKind::OutOfMemory | io::ErrorKind::Unsupported => error,
        _ => io::Error::new(io::ErrorKind::InvalidData, error),
    }
}

/// A source that is read again after an interruption, in the middle of which a decompressor would lose
/// its place.
struct Uninterrupted<R>(R);

impl<R: Read> Read for Uninterrupted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            match self.0.read(buffer) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                read => return read,
            }
        }
    }
}
