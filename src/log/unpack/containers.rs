//! BLF: the objects in the containers of a file.

use crate::log::blf::{self, OBJECT_HEAD, file_head_len, object_size};
use flate2::{Decompress, FlushDecompress, Status};
use std::io::{self, BufRead, BufReader, Read};

/// The objects of a BLF log, out of their containers, behind the head of the file.
pub(super) struct ContainerReader<R> {
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
    /// The rest cannot be unpacked.
    Damaged,
}

impl<R: Read> ContainerReader<R> {
    pub fn new(source: R) -> Self {
        Self { source: BufReader::with_capacity(1 << 16, source), state: ContainerState::FileHead }
    }

    /// Reads the head of an object; false at the end of the file.
    fn begin_object(&mut self) -> io::Result<bool> {
        // Between two files may be more zeros.
        for _ in 0..blf::MAX_PADDING {
            if self.source.fill_buf()?.first() == Some(&0) {
                self.source.consume(1);
            }
        }
        if self.source.fill_buf()?.is_empty() {
            return Ok(false);
        }
        let invalid = || io::Error::from(io::ErrorKind::InvalidData);
        let mut head = [0; OBJECT_HEAD];
        self.source.read_exact(&mut head)?;
        if let Some(len) = head.first_chunk().copied().and_then(file_head_len) {
            // Another file.
            let left = (len - OBJECT_HEAD) as u64;
            self.state = ContainerState::Copy { head: head.to_vec(), at: 0, left, padding: 0 };
            return Ok(true);
        }
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
        // Without it, the next object begins there.
        for _ in 0..padding {
            if matches!(self.source.fill_buf()?.first(), None | Some(b'L')) {
                break;
            }
            self.source.consume(1);
        }
        self.state = ContainerState::Object;
        Ok(())
    }
}

impl<R: Read> Read for ContainerReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        let invalid = || io::Error::from(io::ErrorKind::InvalidData);
        loop {
            match &mut self.state {
                ContainerState::Damaged => return Err(invalid()),
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
                    let status = inflate.decompress(&input[..most], buffer, FlushDecompress::None);
                    let used = inflate.total_in() - read;
                    let count = (inflate.total_out() - written) as usize;
                    self.source.consume(used as usize);
                    *left -= used;
                    let Ok(status) = status else {
                        // What was unpacked before the damage.
                        self.state = ContainerState::Damaged;
                        return if count > 0 { Ok(count) } else { Err(invalid()) };
                    };
                    if status == Status::StreamEnd {
                        let (left, padding) = (*left, *padding);
                        self.end_object(left, padding)?;
                    } else if used == 0 && count == 0 {
                        return Err(invalid());
                    }
                    if count > 0 {
                        return Ok(count);
                    }
                }
            }
        }
    }
}
