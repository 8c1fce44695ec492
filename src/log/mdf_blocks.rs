//! Blocks of ASAM MDF 4, and the data that lie in one block or in a list of them, compressed or not.
//!
//! Source: ASAM MDF 4.1, as asammdf and CANedge write it. The memory is bounded: see [`MAX_UNPACKED`];
//! no block of data is read twice, so that lists in a loop end. Does not know records.

use super::Damage;
use super::random_access::{RandomAccess, read_full_at};
use flate2::{Decompress, FlushDecompress, Status};
use std::collections::HashSet;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Bytes of the head of a block.
const BLOCK_HEAD: u64 = 24;
/// Most links of a block that are read.
const MAX_LINKS: u64 = 1 << 16;
/// Most blocks of a list of data that wait to be read.
const MAX_PENDING: usize = 2 * MAX_LINKS as usize;
/// Most bytes of a compressed block, unpacked and packed: writers keep to 4 MB.
const MAX_PACKED: u64 = 8 << 20;
/// Bytes of other blocks that are read at once.
const PIECE: u64 = 1 << 16;
/// Most unpacked bytes in memory, of all groups of a file: 64 with the largest blocks that writers write.
const MAX_UNPACKED: usize = 256 << 20;

/// Number of unpacked bytes of a file that are in memory.
pub(super) type UnpackedBytes = Arc<AtomicUsize>;

/// Why a part of a file is not read.
pub(super) enum MdfFault {
    /// The block that begins at this byte is damaged.
    Block(u64),
    /// The file is not one that is read, or not all of it.
    Log(Damage),
    File(io::Error),
}

impl From<io::Error> for MdfFault {
    fn from(error: io::Error) -> Self {
        Self::File(error)
    }
}

/// A block: its type, its links and where its data are.
#[derive(Debug)]
pub(super) struct MdfBlock {
    pub address: u64,
    /// As in `CN`.
    pub kind: [u8; 2],
    /// Addresses of other blocks; 0 for none.
    pub links: Vec<u64>,
    /// Where its data begin, and how many bytes they are.
    pub data_at: u64,
    pub data_len: u64,
}

impl MdfBlock {
    /// Reads the head and the links of a block.
    pub fn read(bytes: &dyn RandomAccess, address: u64) -> Result<Self, MdfFault> {
        let damage = || MdfFault::Block(address);
        let mut head = [0; BLOCK_HEAD as usize];
        if read_full_at(bytes, &mut head, address)? < head.len() {
            return Err(damage());
        }
        let [b'#', b'#', first, second, ..] = head else { return Err(damage()) };
        let (length, count) = (u64_at(&head, 8), u64_at(&head, 16));
        if count > MAX_LINKS {
            let is_list = [first, second] == *b"DL" && count <= length / 8;
            return Err(if is_list { MdfFault::Log(Damage::UnreadBlock) } else { damage() });
        }
        let data_start = BLOCK_HEAD + 8 * count;
        // The length of the last block of an unfinished file may not be written yet.
        let data_len = length.saturating_sub(data_start);
        let data_at = address.checked_add(data_start).ok_or_else(damage)?;
        let mut links = vec![0; 8 * count as usize];
        if read_full_at(bytes, &mut links, address + BLOCK_HEAD)? < links.len() {
            return Err(damage());
        }
        let links = links.chunks_exact(8).map(|link| u64_at(link, 0)).collect();
        Ok(Self { address, kind: [first, second], links, data_at, data_len })
    }

    /// Reads a block of a type.
    pub fn of_kind(
        bytes: &dyn RandomAccess,
        address: u64,
        kind: [u8; 2],
    ) -> Result<Self, MdfFault> {
        let block = Self::read(bytes, address)?;
        if block.kind == kind { Ok(block) } else { Err(block.damage()) }
    }

    /// Returns a link; 0 if the block has fewer.
    pub fn link(&self, at: usize) -> u64 {
        self.links.get(at).copied().unwrap_or(0)
    }

    pub fn damage(&self) -> MdfFault {
        MdfFault::Block(self.address)
    }

    /// Reads the first `N` bytes of its data.
    pub fn data<const N: usize>(&self, bytes: &dyn RandomAccess) -> Result<[u8; N], MdfFault> {
        let mut data = [0; N];
        if self.data_len < N as u64 || read_full_at(bytes, &mut data, self.data_at)? < N {
            return Err(self.damage());
        }
        Ok(data)
    }
}

/// Returns the little-endian number at a place; 0 outside the bytes.
pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let number = bytes.get(at..).and_then(<[u8]>::first_chunk);
    number.map_or(0, |number| u64::from_le_bytes(*number))
}

/// Returns the little-endian number at a place; 0 outside the bytes.
pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    let number = bytes.get(at..).and_then(<[u8]>::first_chunk);
    number.map_or(0, |number| u32::from_le_bytes(*number))
}

/// Bytes that lie in one block of data or in several, read from the start to the end.
#[derive(Debug)]
pub(super) struct DataChain {
    /// Blocks that are next, the last one first.
    next: Vec<u64>,
    visited: HashSet<u64>,
    /// The block that is being read, and what is left of it: the place in the file and the bytes.
    block: u64,
    left: (u64, u64),
    /// The end of the file is the end of the data.
    is_unfinished: bool,
    buffer: Vec<u8>,
    /// Bytes of the buffer that were taken.
    taken: usize,
    /// Place of the buffer in the data.
    offset: u64,
    unpacked: UnpackedBytes,
    /// Its part of them.
    own_unpacked: usize,
}

impl DataChain {
    /// Begins with the block at `address`; without data at 0.
    pub fn new(address: u64, is_unfinished: bool, unpacked: &UnpackedBytes) -> Self {
        Self {
            next: if address == 0 { Vec::new() } else { vec![address] },
            visited: HashSet::new(),
            block: address,
            left: (0, 0),
            is_unfinished,
            buffer: Vec::new(),
            taken: 0,
            offset: 0,
            unpacked: Arc::clone(unpacked),
            own_unpacked: 0,
        }
    }

    /// The damage of the block that was read last.
    pub fn damage(&self) -> MdfFault {
        MdfFault::Block(self.block)
    }

    /// Returns true if bytes were read and not taken.
    pub fn has_rest(&self) -> bool {
        self.taken < self.buffer.len()
    }

    /// Returns the next `len` bytes, and passes over them; `None` at the end of the data.
    pub fn take(
        &mut self,
        bytes: &dyn RandomAccess,
        len: usize,
    ) -> Result<Option<&[u8]>, MdfFault> {
        while self.buffer.len() - self.taken < len {
            if !self.read_on(bytes)? {
                let is_cut = self.has_rest() && !self.is_unfinished;
                return if is_cut { Err(self.damage()) } else { Ok(None) };
            }
        }
        self.taken += len;
        Ok(Some(&self.buffer[self.taken - len..self.taken]))
    }

    /// Passes over bytes up to a place in the data; returns false if it is behind, or after the end.
    pub fn skip_to(&mut self, bytes: &dyn RandomAccess, place: u64) -> Result<bool, MdfFault> {
        loop {
            let Some(at) = place.checked_sub(self.offset) else { return Ok(false) };
            if at <= self.buffer.len() as u64 {
                self.taken = at as usize;
                return Ok(true);
            }
            self.taken = self.buffer.len();
            if !self.read_on(bytes)? {
                return Ok(false);
            }
        }
    }

    /// Reads the next bytes into the buffer; returns false at the end.
    fn read_on(&mut self, bytes: &dyn RandomAccess) -> Result<bool, MdfFault> {
        self.buffer.drain(..self.taken);
        self.offset += self.taken as u64;
        self.taken = 0;
        // What is left of a record may lie in two blocks.
        let held = self.buffer.len().min(self.own_unpacked);
        if held < self.own_unpacked {
            self.unpacked.fetch_sub(self.own_unpacked - held, Ordering::Relaxed);
            self.own_unpacked = held;
            self.buffer.shrink_to(PIECE as usize);
        }
        while self.left.1 == 0 {
            let Some(address) = self.next.pop() else { return Ok(false) };
            let before = self.buffer.len();
            self.begin_block(bytes, address)?;
            if self.buffer.len() > before {
                return Ok(true);
            }
        }
        let (at, left) = self.left;
        let wanted = left.min(PIECE) as usize;
        let before = self.buffer.len();
        self.buffer.resize(before + wanted, 0);
        let count = read_full_at(bytes, &mut self.buffer[before..], at)?;
        self.buffer.truncate(before + count);
        self.left = (at + count as u64, left - count as u64);
        if count < wanted {
            self.next.clear();
            if self.is_unfinished || count == 0 {
                self.left = (0, 0);
            }
            // What is missing of a block with a length is said when all that is there was read.
            if !self.is_unfinished && count == 0 {
                return Err(self.damage());
            }
        }
        Ok(count > 0)
    }

    /// Begins to read a block of data, or puts the blocks of a list in its place.
    fn begin_block(&mut self, bytes: &dyn RandomAccess, address: u64) -> Result<(), MdfFault> {
        self.block = address;
        if !self.visited.insert(address) {
            return Err(self.damage());
        }
        let block = MdfBlock::read(bytes, address)?;
        match &block.kind {
            b"HL" => self.next.extend(block.links.first().filter(|link| **link != 0)),
            b"DL" => {
                let (next, data) = block.links.split_first().ok_or_else(|| block.damage())?;
                let all = std::iter::once(next).chain(data.iter().rev());
                self.next.extend(all.filter(|link| **link != 0));
                // A list that has lists in it is none; each could have as many links.
                if self.next.len() > MAX_PENDING {
                    return Err(block.damage());
                }
            }
            b"DT" | b"SD" => {
                let has_length = block.data_len > 0 || !self.is_unfinished;
                let left = if has_length { block.data_len } else { u64::MAX - block.data_at };
                self.left = (block.data_at, left);
            }
            b"DZ" => self.unpack(bytes, &block)?,
            b"DV" | b"LD" => return Err(MdfFault::Log(Damage::UnreadBlock)),
            _ => return Err(block.damage()),
        }
        Ok(())
    }

    /// Appends the data of a compressed block.
    fn unpack(&mut self, bytes: &dyn RandomAccess, block: &MdfBlock) -> Result<(), MdfFault> {
        const HEAD: usize = 24;
        const TRANSPOSED: u8 = 1;
        let head: [u8; HEAD] = block.data(bytes)?;
        let (zip, width) = (head[2], u32_at(&head, 4) as usize);
        let (len, packed_len) = (u64_at(&head, 8), u64_at(&head, 16));
        if packed_len > block.data_len - HEAD as u64 {
            return Err(block.damage());
        }
        if len > MAX_PACKED || packed_len > MAX_PACKED || zip > TRANSPOSED {
            return Err(MdfFault::Log(Damage::UnreadBlock));
        }
        let in_memory = self.unpacked.fetch_add(len as usize, Ordering::Relaxed) + len as usize;
        self.own_unpacked += len as usize;
        if in_memory > MAX_UNPACKED {
            return Err(block.damage());
        }
        let mut packed = vec![0; packed_len as usize];
        if read_full_at(bytes, &mut packed, block.data_at + HEAD as u64)? < packed.len() {
            return Err(block.damage());
        }
        // With room for a byte more, the end of the stream is reached, where its check sum is compared.
        let mut data = vec![0; len as usize + 1];
        let mut inflate = Decompress::new(true);
        let result = inflate.decompress(&packed, &mut data, FlushDecompress::Finish);
        if !matches!(result, Ok(Status::StreamEnd)) || inflate.total_out() != len {
            return Err(block.damage());
        }
        data.truncate(len as usize);
        if zip == TRANSPOSED {
            append_transposed(&data, width, &mut self.buffer);
        } else {
            self.buffer.extend_from_slice(&data);
        }
        Ok(())
    }
}

/// Appends rows of `width` bytes that are written column by column; a rest behind them is as it was.
fn append_transposed(data: &[u8], width: usize, to: &mut Vec<u8>) {
    let rows = data.len().checked_div(width).unwrap_or(0);
    for row in 0..rows {
        to.extend((0..width).map(|column| data[column * rows + row]));
    }
    to.extend_from_slice(&data[rows * width..]);
}
