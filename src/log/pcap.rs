//! Classic pcap, as tcpdump and older Wireshark write it: reads it.
//!
//! Source: draft-ietf-opsawg-pcap. Either byte order, times in microseconds or nanoseconds. Allocation does
//! not depend on lengths in the file. Does not know moments or bus numbers.

use super::binary::{BinaryFormat, EntryInput};
use super::packet::{self, FileOrder};
use super::pcapng::{MAX_BLOCK, PacketFault};
use super::{Damage, FormatMatch, LogEntry, LogSummary, LogTime};
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

/// State that packets depend on.
#[derive(Clone, Debug, Default)]
pub(super) struct CaptureState {
    head: Option<FileHead>,
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

    /// Returns the time of a packet with this head.
    fn time(self, head: &[u8]) -> Option<LogTime> {
        let (seconds, fraction) = (self.u32(head, 0)?, self.u32(head, 4)?);
        let fraction = u64::from(fraction);
        let fraction = if self.has_nanos {
            LogTime::from_nanos(fraction)
        } else {
            LogTime::from_micros(fraction)
        };
        LogTime::from_micros(u64::from(seconds) * 1_000_000).checked_add(fraction)
    }
}

impl CaptureState {
    /// Reads a whole packet; `None` for one of another protocol.
    fn entry(
        &mut self,
        head: FileHead,
        packet: &[u8],
    ) -> Result<Option<LogEntry<'_>>, PacketFault> {
        let time = head.time(packet).ok_or(PacketFault::Short)?;
        let data = packet.get(PACKET_HEAD..).ok_or(PacketFault::Short)?;
        let Some(packet) = packet::decode(head.link_type, data, head.order)? else {
            return Ok(None);
        };
        let number = packet.interface.unwrap_or(0);
        if self.interface.as_ref().is_none_or(|(last, _)| *last != number) {
            self.interface = Some((number, format!("if{number}")));
        }
        let interface = self.interface.as_ref().map_or("", |(_, name)| name);
        Ok(Some(LogEntry { time, interface, frame: packet.frame }))
    }
}

/// Longest packet of which the rest of the file is read, in bytes. Chosen: the snapshot length of tcpdump.
const MAX_PACKET: u32 = 262_144;

impl BinaryFormat for CaptureState {
    fn read(
        &mut self,
        entry: &mut EntryInput<'_>,
        summary: &mut LogSummary,
    ) -> Result<Option<Frame>, Damage> {
        let Some(head) = self.head else {
            if entry.fill(FILE_HEAD) {
                self.head = Some(FileHead::new(entry.bytes()).ok_or(Damage::ByteOrder)?);
                entry.end();
            }
            return Ok(None);
        };
        if !entry.fill(PACKET_HEAD) {
            return Ok(None);
        }
        let Some(len) = head.packet_len(entry.bytes()) else { return Ok(None) };
        // No writer has such packets: the length is not one.
        if len > MAX_PACKET {
            return Err(Damage::Length(len));
        }
        if len as usize > MAX_BLOCK {
            entry.skip(PACKET_HEAD as u64 + u64::from(len));
            return Ok(summary.take(Err::<Option<LogEntry<'_>>, _>(PacketFault::Long)));
        }
        if !entry.fill(PACKET_HEAD + len as usize) {
            return Ok(None);
        }
        let frame = summary.take(self.entry(head, entry.bytes()));
        entry.end();
        Ok(frame)
    }

    fn read_frame(&mut self, bytes: &[u8], summary: &mut LogSummary) -> Option<(usize, Frame)> {
        let head = self.head?;
        let len = PACKET_HEAD + head.packet_len(bytes)? as usize;
        let packet = bytes.get(..len).filter(|_| len <= PACKET_HEAD + MAX_BLOCK)?;
        let entry = self.entry(head, packet).ok()??;
        let name = entry.interface.as_bytes();
        let frame = summary.take_plain(entry.time, name, &entry.frame)?;
        Some((len, frame))
    }
}
