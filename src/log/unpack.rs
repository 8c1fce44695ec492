//! Packed logs: compressed with gzip, zstd or xz, the containers of BLF, and databases of SQLite. The bytes
//! of the file in, those of the log out.
//!
//! Known by their first bytes. A log may be packed twice, such as a BLF log in gzip. The memory does not
//! depend on lengths in the file. Does not know formats but BLF's containers and those that are read in any
//! order.

use super::blf::{self, OBJECT_HEAD, file_head_len, object_size};
use super::entry_stream::{RECORDS_MAGIC, ROWS_MAGIC};
use super::mdf::{self, MdfLog};
use super::random_access::{EntryStream, MakeSpool, RandomAccess, store};
use super::sqlite::{self, SqliteTable};
use super::summary::UnreadChanges;
use flate2::bufread::GzDecoder;
use flate2::{Decompress, FlushDecompress, Status};
use lzma_rust2::Lzma2Reader;
use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};
use std::error::Error;
use std::io::{self, BufRead, BufReader, Read, Write};

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
        // The window of the decompressor is too large, or there is no decompressor.
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

// --- gzip ---------------------------------------------------------------------------------

/// The members of a gzip file, one after the other. Zeros may stand behind them, as tapes have them.
struct GzipReader<R> {
    /// `None` at the end of the file.
    member: Option<GzDecoder<BufReader<R>>>,
}

impl<R: Read> GzipReader<R> {
    fn new(source: R) -> Self {
        Self { member: Some(GzDecoder::new(BufReader::new(source))) }
    }
}

impl<R: Read> Read for GzipReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let Some(member) = &mut self.member else { return Ok(0) };
            let count = member.read(buffer)?;
            if count > 0 || buffer.is_empty() {
                return Ok(count);
            }
            let Some(mut source) = self.member.take().map(GzDecoder::into_inner) else { continue };
            loop {
                let bytes = source.fill_buf()?;
                let zeros = bytes.iter().take_while(|&&byte| byte == 0).count();
                if bytes.is_empty() {
                    break;
                }
                if zeros < bytes.len() {
                    source.consume(zeros);
                    self.member = Some(GzDecoder::new(source));
                    break;
                }
                source.consume(zeros);
            }
        }
    }
}

// --- zstd ---------------------------------------------------------------------------------

/// The frames of a zstd file, one after the other.
struct ZstdReader<R> {
    source: BufReader<R>,
    decoder: FrameDecoder,
    is_inside: bool,
    /// Why the file ends inside a frame, of which the decoder gives the last bytes.
    end: Option<io::ErrorKind>,
}

impl<R: Read> ZstdReader<R> {
    fn new(source: R) -> Self {
        let mut decoder = FrameDecoder::new();
        decoder.set_max_window_size(u64::from(MAX_WINDOW));
        Self { source: BufReader::new(source), decoder, is_inside: false, end: None }
    }

    /// Begins the next frame; false at the end of the file.
    fn begin_frame(&mut self) -> io::Result<bool> {
        loop {
            if self.source.fill_buf()?.is_empty() {
                return Ok(false);
            }
            match self.decoder.reset(&mut self.source) {
                Ok(()) => return Ok(true),
                Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame {
                    length,
                    ..
                })) => {
                    let mut skipped = (&mut self.source).take(u64::from(length));
                    io::copy(&mut skipped, &mut io::sink())?;
                }
                Err(FrameDecoderError::WindowSizeTooBig { .. }) => {
                    return Err(io::ErrorKind::OutOfMemory.into());
                }
                Err(error) => return Err(of_zstd(&error)),
            }
        }
    }
}

/// Returns an error of the decompressor; one of the file, or of its end, if that is its cause.
fn of_zstd(error: &(dyn Error + 'static)) -> io::Error {
    let mut cause = Some(error);
    while let Some(error) = cause {
        if let Some(error) = error.downcast_ref::<io::Error>() {
            return match error.raw_os_error() {
                Some(code) => io::Error::from_raw_os_error(code),
                None => error.kind().into(),
            };
        }
        cause = error.source();
    }
    io::ErrorKind::InvalidData.into()
}

impl<R: Read> Read for ZstdReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            if !self.is_inside {
                if !self.begin_frame()? {
                    return Ok(0);
                }
                self.is_inside = true;
            }
            let count = self.decoder.read(buffer)?;
            if count > 0 {
                return Ok(count);
            }
            if let Some(end) = self.end {
                return Err(end.into());
            }
            if self.decoder.is_finished() {
                let written = self.decoder.get_checksum_from_data();
                let is_other = |sum: &u32| self.decoder.get_calculated_checksum() != Some(*sum);
                if written.as_ref().is_some_and(is_other) {
                    return Err(io::ErrorKind::InvalidData.into());
                }
                self.is_inside = false;
                continue;
            }
            let one = || BlockDecodingStrategy::UptoBlocks(1);
            if let Err(error) = self.decoder.decode_blocks(&mut self.source, one()) {
                let error = of_zstd(&error);
                if error.kind() != io::ErrorKind::UnexpectedEof || self.end.is_some() {
                    return Err(error);
                }
                // An empty last block, and a check sum: the decoder gives what it holds back.
                self.end = Some(error.kind());
                let last = [1, 0, 0, 0, 0, 0, 0];
                let ended = self.decoder.decode_blocks(&last[..], one());
                ended.map_err(|error| of_zstd(&error))?;
            }
        }
    }
}

// --- xz -----------------------------------------------------------------------------------

/// The blocks of an xz file.
///
/// Source: "The .xz File Format", version 1.2.1. A block is compared with its CRC32 or CRC64; SHA-256 is
/// not computed.
struct XzReader<R: Read> {
    state: XzState<R>,
    /// Bytes of the check behind a block.
    check_len: usize,
    /// The check of what was read of the block; `None` if it is not computed.
    check: Option<XzCheck>,
}

/// A cyclic redundancy check, bits reversed.
#[derive(Clone, Copy)]
struct XzCheck {
    table: &'static [u64; 256],
    start: u64,
    value: u64,
}

static CRC32: [u64; 256] = crc_table(0xEDB8_8320);
static CRC64: [u64; 256] = crc_table(0xC96C_5795_D787_0F42);

/// The remainders of all bytes with a polynomial, bits reversed.
const fn crc_table(polynomial: u64) -> [u64; 256] {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let (mut value, mut bit) = (byte as u64, 0);
        while bit < 8 {
            value = if value & 1 == 1 { value >> 1 ^ polynomial } else { value >> 1 };
            bit += 1;
        }
        table[byte] = value;
        byte += 1;
    }
    table
}

impl XzCheck {
    /// Returns the check of this type in the head of a stream; `None` if it is not computed.
    fn of_type(kind: u8) -> Option<Self> {
        let (table, start) = match kind {
            1 => (&CRC32, u64::from(u32::MAX)),
            4 => (&CRC64, u64::MAX),
            _ => return None,
        };
        Some(Self { table, start, value: start })
    }

    fn add(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let at = (self.value as u8 ^ byte) as usize;
            self.value = self.value >> 8 ^ self.table[at];
        }
    }

    /// Returns true if the check of the bytes is this one, little-endian; begins anew.
    fn is(&mut self, written: &[u8]) -> bool {
        let value = self.value ^ self.start;
        self.value = self.start;
        value.to_le_bytes().starts_with(written)
    }
}

enum XzState<R: Read> {
    /// Before a stream.
    Start(Counted<R>),
    /// Before a block of a stream, or its end.
    Stream(Counted<R>),
    Block(Box<Lzma2Reader<Counted<R>>>),
    End,
}

/// Counts the bytes that were read.
struct Counted<R> {
    source: BufReader<R>,
    count: u64,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.source.read(buffer)?;
        self.count += count as u64;
        Ok(count)
    }
}

impl<R: Read> XzReader<R> {
    fn new(source: R) -> Self {
        let source = Counted { source: BufReader::new(source), count: 0 };
        Self { state: XzState::Start(source), check_len: 0, check: None }
    }

    /// Reads the head of a stream; without one it is the end.
    fn begin_stream(&mut self, mut source: Counted<R>) -> io::Result<XzState<R>> {
        let mut head = [0; 12];
        // Zeros may stand between streams.
        while head[0] == 0 {
            if source.source.fill_buf()?.is_empty() {
                return Ok(XzState::End);
            }
            source.read_exact(&mut head[..1])?;
        }
        source.read_exact(&mut head[1..])?;
        if Packing::of_head(&head) != Some(Packing::Xz) {
            return Err(io::ErrorKind::InvalidData.into());
        }
        // Blocks are padded from here on.
        source.count = 0;
        self.check = XzCheck::of_type(head[7] & 0x0F);
        self.check_len = match head[7] & 0x0F {
            0 => 0,
            1..=3 => 4,
            4..=6 => 8,
            7..=9 => 16,
            10..=12 => 32,
            _ => 64,
        };
        Ok(XzState::Stream(source))
    }

    /// Reads the head of a block; without one it is the end of the stream.
    fn begin_block(mut source: Counted<R>) -> io::Result<XzState<R>> {
        let mut size = [0];
        source.read_exact(&mut size)?;
        // The index follows the last block.
        if size == [0] {
            skip_xz_index(&mut source)?;
            return Ok(XzState::Start(source));
        }
        let mut head = vec![0; usize::from(size[0]) * 4 + 3];
        source.read_exact(&mut head)?;
        let dictionary = xz_dictionary(size[0], &head)?;
        if dictionary > MAX_WINDOW {
            return Err(io::ErrorKind::OutOfMemory.into());
        }
        let reader = Lzma2Reader::new(source, dictionary, None);
        Ok(XzState::Block(Box::new(reader)))
    }

    /// Skips the padding behind a block, and compares its check.
    fn end_block(&mut self, source: &mut Counted<R>) -> io::Result<()> {
        let padding = (4 - source.count % 4) % 4;
        let mut rest = [0; 3 + 64];
        let rest = &mut rest[..padding as usize + self.check_len];
        source.read_exact(rest)?;
        let is_same = self.check.as_mut().is_none_or(|check| check.is(&rest[padding as usize..]));
        if is_same { Ok(()) } else { Err(io::ErrorKind::InvalidData.into()) }
    }
}

/// Skips the index behind its first byte, and the foot of the stream.
fn skip_xz_index<R: Read>(source: &mut Counted<R>) -> io::Result<()> {
    let mut number = || -> io::Result<u64> {
        let mut value = 0;
        for shift in (0..63).step_by(7) {
            let mut byte = [0];
            source.read_exact(&mut byte)?;
            value |= u64::from(byte[0] & 0x7F) << shift;
            if byte[0] & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(io::ErrorKind::InvalidData.into())
    };
    for _ in 0..number()? {
        let (_packed, _unpacked) = (number()?, number()?);
    }
    let padding = (4 - source.count % 4) % 4;
    let mut foot = [0; 3 + 4 + 12];
    source.read_exact(&mut foot[..padding as usize + 4 + 12])
}

/// Returns the size of the dictionary of a block with this head, whose first byte is `size`.
///
/// # Errors
///
/// [`io::ErrorKind::Unsupported`] for another filter than LZMA2 alone, and [`io::ErrorKind::InvalidData`].
fn xz_dictionary(size: u8, head: &[u8]) -> Result<u32, io::ErrorKind> {
    let mut check = XzCheck::of_type(1).ok_or(io::ErrorKind::InvalidData)?;
    let (fields, written) = head.split_last_chunk::<4>().ok_or(io::ErrorKind::InvalidData)?;
    check.add(&[size]);
    check.add(fields);
    if !check.is(written) {
        return Err(io::ErrorKind::InvalidData);
    }
    lzma2_dictionary(fields).ok_or(io::ErrorKind::Unsupported)
}

/// Returns the size of the dictionary of a block with these fields; `None` if the block has another filter
/// than LZMA2 alone.
fn lzma2_dictionary(fields: &[u8]) -> Option<u32> {
    let (&flags, mut rest) = fields.split_first()?;
    // The compressed and the uncompressed size may follow.
    for flag in [0x40, 0x80] {
        if flags & flag != 0 {
            let end = rest.iter().position(|byte| byte & 0x80 == 0)?;
            rest = &rest[end + 1..];
        }
    }
    let [0x21, 1, bits, ..] = *rest else { return None };
    if flags & 0x3F != 0 || bits > 40 {
        return None;
    }
    let mantissa = 2 | u32::from(bits & 1);
    if bits == 40 { Some(u32::MAX) } else { Some(mantissa << (bits / 2 + 11)) }
}

impl<R: Read> Read for XzReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        loop {
            match std::mem::replace(&mut self.state, XzState::End) {
                XzState::End => return Ok(0),
                XzState::Start(source) => self.state = self.begin_stream(source)?,
                XzState::Stream(source) => self.state = Self::begin_block(source)?,
                XzState::Block(mut block) => {
                    let count = block.read(buffer)?;
                    if let Some(check) = &mut self.check {
                        check.add(&buffer[..count]);
                    }
                    if count > 0 {
                        self.state = XzState::Block(block);
                        return Ok(count);
                    }
                    let mut source = block.into_inner();
                    self.end_block(&mut source)?;
                    self.state = XzState::Stream(source);
                }
            }
        }
    }
}

// --- BLF ----------------------------------------------------------------------------------

/// The objects of a BLF log, out of their containers, behind the head of the file.
struct ContainerReader<R> {
    source: BufReader<R>,
    state: ContainerState,
}

enum ContainerState {
    FileHead,
    Object,
    /// Bytes that are read as they are, before padding.
    Copy {
        head: Vec<u8>,
        at: usize,
        left: u64,
        padding: usize,
    },
    Zlib {
        inflate: Box<Decompress>,
        left: u64,
        padding: usize,
    },
}

impl<R: Read> ContainerReader<R> {
    fn new(source: R) -> Self {
        Self { source: BufReader::with_capacity(1 << 16, source), state: ContainerState::FileHead }
    }

    /// Reads the head of an object; false at the end of the file.
    fn begin_object(&mut self) -> io::Result<bool> {
        if self.source.fill_buf()?.is_empty() {
            return Ok(false);
        }
        let invalid = || io::Error::from(io::ErrorKind::InvalidData);
        let mut head = [0; OBJECT_HEAD];
        self.source.read_exact(&mut head)?;
        let (size, kind) = object_size(&head).ok_or_else(invalid)?;
        let left = u64::from(size) - OBJECT_HEAD as u64;
        let padding = size as usize % 4;
        if kind != blf::CONTAINER {
            self.state = ContainerState::Copy { head: head.to_vec(), at: 0, left, padding };
            return Ok(true);
        }
        let mut container = [0; 16];
        let left = left.checked_sub(container.len() as u64).ok_or_else(invalid)?;
        self.source.read_exact(&mut container)?;
        self.state = match u16::from_le_bytes([container[0], container[1]]) {
            0 => ContainerState::Copy { head: Vec::new(), at: 0, left, padding },
            2 => {
                let inflate = Box::new(Decompress::new(true));
                ContainerState::Zlib { inflate, left, padding }
            }
            _ => return Err(invalid()),
        };
        Ok(true)
    }

    /// Skips bytes and the padding behind an object, of which the last one of a file may lack some.
    fn end_object(&mut self, left: u64, padding: usize) -> io::Result<()> {
        let skipped = io::copy(&mut (&mut self.source).take(left), &mut io::sink())?;
        if skipped < left {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        io::copy(&mut (&mut self.source).take(padding as u64), &mut io::sink())?;
        self.state = ContainerState::Object;
        Ok(())
    }
}

impl<R: Read> Read for ContainerReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        loop {
            match &mut self.state {
                ContainerState::FileHead => {
                    let mut head = [0; 8];
                    self.source.read_exact(&mut head)?;
                    let len = file_head_len(head).ok_or(io::ErrorKind::InvalidData)? as u64;
                    let left = len - head.len() as u64;
                    self.state =
                        ContainerState::Copy { head: head.to_vec(), at: 0, left, padding: 0 };
                }
                ContainerState::Object => {
                    if !self.begin_object()? {
                        return Ok(0);
                    }
                }
                ContainerState::Copy { head, at, .. } if *at < head.len() => {
                    let count = buffer.len().min(head.len() - *at);
                    buffer[..count].copy_from_slice(&head[*at..*at + count]);
                    *at += count;
                    return Ok(count);
                }
                ContainerState::Copy { left: 0, padding, .. } => {
                    let padding = *padding;
                    self.end_object(0, padding)?;
                }
                ContainerState::Copy { left, .. } => {
                    let most = buffer.len().min(usize::try_from(*left).unwrap_or(usize::MAX));
                    let count = self.source.read(&mut buffer[..most])?;
                    if count == 0 {
                        return Err(io::ErrorKind::UnexpectedEof.into());
                    }
                    *left -= count as u64;
                    return Ok(count);
                }
                ContainerState::Zlib { inflate, left, padding } => {
                    let input = self.source.fill_buf()?;
                    if input.is_empty() && *left > 0 {
                        return Err(io::ErrorKind::UnexpectedEof.into());
                    }
                    let most = input.len().min(usize::try_from(*left).unwrap_or(usize::MAX));
                    let (read, written) = (inflate.total_in(), inflate.total_out());
                    let status =
                        inflate.decompress(&input[..most], buffer, FlushDecompress::None)?;
                    let used = inflate.total_in() - read;
                    let count = (inflate.total_out() - written) as usize;
                    self.source.consume(used as usize);
                    *left -= used;
                    if status == Status::StreamEnd {
                        let (left, padding) = (*left, *padding);
                        self.end_object(left, padding)?;
                    } else if used == 0 && count == 0 {
                        return Err(io::ErrorKind::InvalidData.into());
                    }
                    if count > 0 {
                        return Ok(count);
                    }
                }
            }
        }
    }
}
