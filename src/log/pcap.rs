//! Classic pcap, as tcpdump and older Wireshark write it: reads it.
//!
//! Source: draft-ietf-opsawg-pcap. Either byte order, times in microseconds or nanoseconds. Allocation does
//! not depend on lengths in the file. Does not know moments or bus numbers.

use super::packet::{self, FileOrder};
use super::pcapng::{MAX_BLOCK, PacketFault};
use super::{Damage, DecodeStep, FormatMatch, LogDecoder, LogEntry, LogSummary};
use crate::frame::Frame;

/// Bytes of the head of a file, and of a packet.
const FILE_HEAD: usize = 24;
const PACKET_HEAD: usize = 16;
/// Times in microseconds, and in nanoseconds.
const MICROS: u32 = 0xA1B2_C3D4;
const NANOS: u32 = 0xA1B2_3C4D;
/// First four bytes of a file.
const MAGICS: [[u8; 4]; 4] =
    [MICROS.to_be_bytes(), MICROS.to_le_bytes(), NANOS.to_be_bytes(), NANOS.to_le_bytes()];

/// Matches the first bytes of a log.
pub(super) fn detect(head: &[u8]) -> FormatMatch {
    let matches = MAGICS.map(|magic| FormatMatch::of_magic(&magic, head));
    let is = |wanted| matches.contains(&wanted);
    if is(FormatMatch::Yes) {
        FormatMatch::Yes
    } else if is(FormatMatch::Undecided) {
        FormatMatch::Undecided
    } else {
        FormatMatch::No
    }
}

/// What the head of a file says.
#[derive(Clone, Copy, Debug)]
struct FileHead {
    order: FileOrder,
    has_nanos: bool,
    link_type: u16,
}

/// Splits a file into packets and reads them.
#[derive(Clone, Debug, Default)]
pub(super) struct PacketDecoder {
    head: Option<FileHead>,
    /// Beginning of an incomplete packet; less than [`MAX_BLOCK`] bytes.
    partial: Vec<u8>,
    /// Bytes left to skip of a packet that is too long.
    skip: u64,
    /// Name of the last interface with a number, and the number.
    interface: Option<(u32, String)>,
}

impl FileHead {
    /// Reads the head of a file, [`FILE_HEAD`] bytes.
    fn new(bytes: &[u8]) -> Option<Self> {
        let order = match *bytes.first_chunk()? {
            magic if magic == MICROS.to_be_bytes() || magic == NANOS.to_be_bytes() => {
                FileOrder::Big
            }
            magic if magic == MICROS.to_le_bytes() || magic == NANOS.to_le_bytes() => {
                FileOrder::Little
            }
            _ => return None,
        };
        let mut head = Self { order, has_nanos: false, link_type: 0 };
        head.has_nanos = head.u32(bytes, 0)? == NANOS;
        // The upper bits say how long the check sequences of the packets are.
        head.link_type = head.u32(bytes, 20)? as u16;
        Some(head)
    }

    fn u32(self, bytes: &[u8], at: usize) -> Option<u32> {
        let bytes = *bytes.get(at..)?.first_chunk()?;
        Some(match self.order {
            FileOrder::Big => u32::from_be_bytes(bytes),
            FileOrder::Little => u32::from_le_bytes(bytes),
        })
    }

    /// Returns the number of bytes of a packet with this head.
    fn packet_len(self, head: &[u8]) -> Option<u32> {
        self.u32(head, 8)
    }

    /// Returns the time of a packet with this head, in microseconds since 1970.
    fn unix_micros(self, head: &[u8]) -> Option<u64> {
        let (seconds, fraction) = (self.u32(head, 0)?, self.u32(head, 4)?);
        let micros = if self.has_nanos { fraction / 1000 } else { fraction };
        Some(u64::from(seconds) * 1_000_000 + u64::from(micros))
    }
}

impl PacketDecoder {
    /// Appends bytes to the packet up to `wanted`; returns their number, and true if it is complete.
    fn fill(&mut self, bytes: &[u8], wanted: usize) -> (usize, bool) {
        let count = bytes.len().min(wanted.saturating_sub(self.partial.len()));
        self.partial.extend_from_slice(&bytes[..count]);
        (count, self.partial.len() >= wanted)
    }

    /// Reads to the end of a packet or of `bytes`; adds the bytes read to `used`.
    fn read(
        &mut self,
        bytes: &[u8],
        used: &mut usize,
        summary: &mut LogSummary,
    ) -> Result<Option<Frame>, Damage> {
        let Some(head) = self.head else {
            let (count, is_whole) = self.fill(bytes, FILE_HEAD);
            *used += count;
            if is_whole {
                self.head = Some(FileHead::new(&self.partial).ok_or(Damage::ByteOrder)?);
                self.partial.clear();
            }
            return Ok(None);
        };
        let (count, has_head) = self.fill(bytes, PACKET_HEAD);
        *used += count;
        let Some(len) = head.packet_len(&self.partial).filter(|_| has_head) else {
            return Ok(None);
        };
        if len as usize > MAX_BLOCK {
            self.skip = u64::from(len);
            self.partial.clear();
            // No writer has such packets: the length is not one.
            if len > MAX_PACKET {
                self.skip = 0;
                return Err(Damage::Length(len));
            }
            return Ok(summary.take(Err::<Option<LogEntry<'_>>, _>(PacketFault::Long)));
        }
        let (count, is_whole) = self.fill(&bytes[*used..], PACKET_HEAD + len as usize);
        *used += count;
        if !is_whole {
            return Ok(None);
        }
        let packet = std::mem::take(&mut self.partial);
        let frame = summary.take(self.entry(head, &packet));
        self.partial = packet;
        self.partial.clear();
        Ok(frame)
    }

    /// Reads a whole packet; `None` for one of another protocol.
    fn entry(
        &mut self,
        head: FileHead,
        packet: &[u8],
    ) -> Result<Option<LogEntry<'_>>, PacketFault> {
        let unix_micros = head.unix_micros(packet).ok_or(PacketFault::Short)?;
        let data = packet.get(PACKET_HEAD..).ok_or(PacketFault::Short)?;
        let Some(packet) = packet::decode(head.link_type, data, head.order)? else {
            return Ok(None);
        };
        let number = packet.interface.unwrap_or(0);
        if self.interface.as_ref().is_none_or(|(last, _)| *last != number) {
            self.interface = Some((number, format!("if{number}")));
        }
        let interface = self.interface.as_ref().map_or("", |(_, name)| name);
        Ok(Some(LogEntry { unix_micros, interface, frame: packet.frame }))
    }
}

/// Longest packet of which the rest of the file is read, in bytes. Chosen: the snapshot length of tcpdump.
const MAX_PACKET: u32 = 262_144;

impl LogDecoder for PacketDecoder {
    fn decode(&mut self, bytes: &[u8], summary: &mut LogSummary) -> (usize, DecodeStep) {
        if summary.damage.is_some_and(|damage| !damage.is_truncated()) {
            return (0, DecodeStep::End);
        }
        // The file has grown since its end was reached.
        summary.damage = None;
        if self.skip > 0 {
            let skipped = bytes.len().min(usize::try_from(self.skip).unwrap_or(usize::MAX));
            self.skip -= skipped as u64;
            return (skipped, DecodeStep::Nothing);
        }
        let mut used = 0;
        match self.read(bytes, &mut used, summary) {
            Ok(frame) => (used, frame.map_or(DecodeStep::Nothing, DecodeStep::Frame)),
            Err(damage) => {
                summary.damage = Some(damage);
                (used, DecodeStep::End)
            }
        }
    }

    fn decode_frames(
        &mut self,
        bytes: &[u8],
        summary: &mut LogSummary,
        frames: &mut Vec<Frame>,
        most: usize,
    ) -> usize {
        let mut used = 0;
        let Some(head) = self.head else { return 0 };
        if summary.damage.is_some() || self.skip > 0 || !self.partial.is_empty() {
            return 0;
        }
        while frames.len() < most
            && let Some(len) = head.packet_len(&bytes[used..]).map(|len| len as usize)
            && len <= MAX_BLOCK
            && let Some(packet) = bytes[used..].get(..PACKET_HEAD + len)
            && let Ok(Some(entry)) = self.entry(head, packet)
            && let Some(frame) =
                summary.take_plain(entry.unix_micros, entry.interface.as_bytes(), &entry.frame)
        {
            frames.push(frame);
            used += packet.len();
        }
        used
    }

    fn handle_end(&mut self, summary: &mut LogSummary) {
        if summary.damage.is_none_or(Damage::is_truncated) {
            summary.damage =
                (self.skip > 0 || self.has_partial_entry()).then_some(Damage::Truncated);
        }
    }

    fn has_partial_entry(&self) -> bool {
        !self.partial.is_empty()
    }

    /// Packets have no mark by which one is found.
    fn entry_start(&self, _: &[u8]) -> Option<usize> {
        None
    }

    fn copy(&self) -> Box<dyn LogDecoder> {
        Box::new(self.clone())
    }
}
