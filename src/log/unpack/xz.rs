//! xz: streams, their blocks and the checks of those.

use super::{MAX_WINDOW, Packing};
use lzma_rust2::Lzma2Reader;
use std::io::{self, BufRead, BufReader, Read};

/// The blocks of an xz file.
///
/// Source: "The .xz File Format", version 1.2.1. A block is compared with its CRC32 or CRC64; SHA-256 is
/// not computed. The index is compared with the sums of the sizes of the blocks.
pub(super) struct XzReader<R: Read> {
    state: XzState<R>,
    /// Flags of the stream, which its foot repeats.
    flags: [u8; 2],
    /// Bytes of the check behind a block.
    check_len: usize,
    /// The check of what was read of the block; `None` if it is not computed.
    check: Option<XzCheck>,
    /// Blocks of the stream, up to the current one.
    blocks: BlockSizes,
}

/// Sizes of the blocks of a stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct BlockSizes {
    /// Number of blocks.
    count: u64,
    /// Sum of their bytes in the file, without padding.
    packed: u64,
    /// Sum of their bytes, unpacked.
    unpacked: u64,
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
    const fn crc32() -> Self {
        let start = u32::MAX as u64;
        Self { table: &CRC32, start, value: start }
    }

    /// Returns true if the CRC32 of the bytes is this one.
    fn is_crc32(bytes: &[u8], written: &[u8]) -> bool {
        let mut check = Self::crc32();
        check.add(bytes);
        check.is(written)
    }

    /// Returns the check of this type in the head of a stream; `None` if it is not computed.
    fn of_type(kind: u8) -> Option<Self> {
        match kind {
            1 => Some(Self::crc32()),
            4 => Some(Self { table: &CRC64, start: u64::MAX, value: u64::MAX }),
            _ => None,
        }
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
    pub fn new(source: R) -> Self {
        let source = Counted { source: BufReader::new(source), count: 0 };
        let blocks = BlockSizes::default();
        Self { state: XzState::Start(source), flags: [0; 2], check_len: 0, check: None, blocks }
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
        let is_head = Packing::of_head(&head) == Some(Packing::Xz);
        if !is_head || !XzCheck::is_crc32(&head[6..8], &head[8..]) {
            return Err(io::ErrorKind::InvalidData.into());
        }
        self.flags = [head[6], head[7]];
        self.blocks = BlockSizes::default();
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
    fn begin_block(&mut self, mut source: Counted<R>) -> io::Result<XzState<R>> {
        source.count = 0;
        let mut size = [0];
        source.read_exact(&mut size)?;
        // The index follows the last block.
        if size == [0] {
            let is_same = read_index(&mut source)? == self.blocks;
            let is_foot = read_foot(&mut source)? == self.flags;
            if !is_same || !is_foot {
                return Err(io::ErrorKind::InvalidData.into());
            }
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

    /// Reads the padding behind a block, which is zeros, and compares its check.
    fn end_block(&mut self, source: &mut Counted<R>) -> io::Result<()> {
        self.blocks.count += 1;
        self.blocks.packed += source.count + self.check_len as u64;
        let padding = (4 - source.count % 4) % 4;
        let mut rest = [0; 3 + 64];
        let rest = &mut rest[..padding as usize + self.check_len];
        source.read_exact(rest)?;
        let (padding, written) = rest.split_at(padding as usize);
        let is_same = self.check.as_mut().is_none_or(|check| check.is(written));
        if is_same && padding.iter().all(|byte| *byte == 0) {
            Ok(())
        } else {
            Err(io::ErrorKind::InvalidData.into())
        }
    }
}

/// Reads the index of a stream behind its first byte; returns the sums of its sizes.
///
/// # Errors
///
/// [`io::ErrorKind::InvalidData`] if its check is another one, and those of reading.
fn read_index<R: Read>(source: &mut Counted<R>) -> io::Result<BlockSizes> {
    let mut check = XzCheck::crc32();
    check.add(&[0]);
    let mut number = || -> io::Result<u64> {
        let mut value = 0;
        for shift in (0..63).step_by(7) {
            let mut byte = [0];
            source.read_exact(&mut byte)?;
            check.add(&byte);
            value |= u64::from(byte[0] & 0x7F) << shift;
            if byte[0] & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(io::ErrorKind::InvalidData.into())
    };
    let mut sizes = BlockSizes { count: number()?, ..BlockSizes::default() };
    for _ in 0..sizes.count {
        sizes.packed = sizes.packed.wrapping_add(number()?);
        sizes.unpacked = sizes.unpacked.wrapping_add(number()?);
    }
    let padding = (4 - source.count % 4) % 4;
    let mut rest = [0; 3 + 4];
    let rest = &mut rest[..padding as usize + 4];
    source.read_exact(rest)?;
    let (padding, written) = rest.split_at(padding as usize);
    check.add(padding);
    if check.is(written) { Ok(sizes) } else { Err(io::ErrorKind::InvalidData.into()) }
}

/// Reads the foot of a stream behind its index; returns the flags of the stream.
///
/// # Errors
///
/// [`io::ErrorKind::InvalidData`] if it is none of this index, and those of reading.
fn read_foot<R: Read>(source: &mut Counted<R>) -> io::Result<[u8; 2]> {
    let index_len = source.count;
    let mut foot = [0; 12];
    source.read_exact(&mut foot)?;
    let [c0, c1, c2, c3, size @ .., f0, f1, b'Y', b'Z'] = foot else {
        return Err(io::ErrorKind::InvalidData.into());
    };
    let is_size = (u64::from(u32::from_le_bytes(size)) + 1) * 4 == index_len;
    if !is_size || !XzCheck::is_crc32(&foot[4..10], &[c0, c1, c2, c3]) {
        return Err(io::ErrorKind::InvalidData.into());
    }
    Ok([f0, f1])
}

/// Returns the size of the dictionary of a block with this head, whose first byte is `size`.
///
/// # Errors
///
/// [`io::ErrorKind::Unsupported`] for another filter than LZMA2 alone, and [`io::ErrorKind::InvalidData`].
fn xz_dictionary(size: u8, head: &[u8]) -> Result<u32, io::ErrorKind> {
    let mut check = XzCheck::crc32();
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
                XzState::Stream(source) => self.state = self.begin_block(source)?,
                XzState::Block(mut block) => {
                    let count = block.read(buffer)?;
                    if let Some(check) = &mut self.check {
                        check.add(&buffer[..count]);
                    }
                    self.blocks.unpacked += count as u64;
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
