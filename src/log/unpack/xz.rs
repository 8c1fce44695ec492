//! xz: streams, their blocks and the checks of those.

use super::{MAX_WINDOW, Packing};
use lzma_rust2::Lzma2Reader;
use std::io::{self, BufRead, BufReader, Read};

/// The blocks of an xz file.
///
/// Source: "The .xz File Format", version 1.2.1. A block is compared with its CRC32 or CRC64; SHA-256 is
/// not computed.
pub(super) struct XzReader<R: Read> {
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
    pub fn new(source: R) -> Self {
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
