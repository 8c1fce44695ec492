//! pcapng with SocketCAN packets (LINKTYPE_CAN_SOCKETCAN, 227), as used by Wireshark, tshark and
//! dumpcap.
//!
//! Writes one section with an interface per bus, times in microseconds, or nanoseconds where a frame has
//! them, the direction of each
//! frame, and the number of lost frames. Reads sections of either byte order with any number of
//! interfaces; unknown blocks and link types are skipped. Allocation does not depend on lengths in
//! the file. Does not know moments or bus numbers: [`super::LogSummary`] assigns them.

pub use super::damage::Damage;

use super::binary::{BinaryFormat, EntryInput};
use super::packet::{self, CAN_HEAD, FileOrder, SOCKETCAN};
use super::{LogEncoder, LogEntry, LogLoss, LogSummary, LogTime};
use crate::frame::socketcan::{self as fields, FD_FORMAT};
use crate::frame::{BusIndex, Frame};
use std::io::{self, Write};
use std::sync::Arc;

/// The first four bytes of a file, in either byte order.
pub const MAGIC: [u8; 4] = [0x0A, 0x0D, 0x0D, 0x0A];
/// Bytes of a block that are needed to find its length.
pub const BLOCK_HEADER_LEN: usize = 12;
/// Longest block that is read, in bytes; longer ones are skipped. A frame has 116 plus options.
pub const MAX_BLOCK: usize = 1 << 16;

const SECTION: u32 = 0x0A0D_0D0A;
const INTERFACE: u32 = 1;
/// The packet block, which the enhanced packet block ([`PACKET`]) has replaced.
const OLD_PACKET: u32 = 2;
const SIMPLE_PACKET: u32 = 3;
const STATISTICS: u32 = 5;
const PACKET: u32 = 6;
const BYTE_ORDER: u32 = 0x1A2B_3C4D;

const COMMENT_OPTION: u16 = 1;
const NAME_OPTION: u16 = 2;
const RESOLUTION_OPTION: u16 = 9;
const OFFSET_OPTION: u16 = 14;
const APPLICATION_OPTION: u16 = 4;
const FLAGS_OPTION: u16 = 2;
const RECEIVED_OPTION: u16 = 4;
const DROPPED_OPTION: u16 = 5;
const INBOUND: u32 = 1;
const OUTBOUND: u32 = 2;
const DIRECTION: u32 = 3;

/// Most interfaces of a section, as many as there are bus numbers.
const MAX_INTERFACES: usize = 256;
/// Longest interface name that is stored, in bytes.
const MAX_NAME: usize = 64;

/// Why a packet cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum PacketFault {
    /// The link type is not CAN.
    #[error("link type {0}, expected 227 (SocketCAN), 113 or 276 (Linux cooked)")]
    LinkType(u16),
    /// The packet precedes the description of its interface.
    #[error("missing interface description")]
    Interface,
    /// The packet is of an interface behind the 256 that are read.
    #[error("more than 256 interfaces in one section")]
    TooManyInterfaces,
    /// The section has another major version of the format than 1: none of its packets is read.
    #[error("a section of pcapng version {0}, expected 1; convert it: editcap -F pcapng OLD NEW")]
    Version(u16),
    /// The block lacks required fields.
    #[error("the block is too short")]
    Short,
    /// The block is longer than [`MAX_BLOCK`].
    #[error("the block is too long")]
    Long,
    /// A simple packet block.
    #[error("simple packet block, which has no time; capture with times")]
    NoTime,
    /// The time is before 1970, or above 2⁶⁴ − 1 µs since then.
    #[error("the time is before 1970, or too large")]
    TimeRange,
    /// The captured bytes are not a CAN frame.
    #[error("not a valid CAN frame")]
    NoFrame,
    /// A CAN XL frame.
    #[error("a CAN XL frame")]
    Xl,
}

impl BinaryFormat for SectionState {
    fn read(
        &mut self,
        entry: &mut EntryInput<'_>,
        summary: &mut LogSummary,
    ) -> Result<Option<Frame>, Damage> {
        if !entry.fill(BLOCK_HEADER_LEN) {
            return Ok(None);
        }
        let Some(head) = entry.bytes().first_chunk().copied() else { return Ok(None) };
        let len = self.block_len(&head)? as usize;
        if len > MAX_BLOCK {
            entry.skip(len as u64);
            return Ok(summary.take(self.skip(&head).map(|()| None)));
        }
        if !entry.fill(len) {
            return Ok(None);
        }
        let taken = self.take(entry.bytes()).map(|block| summary.take(block));
        entry.end();
        taken
    }

    fn read_frame(&mut self, bytes: &[u8], summary: &mut LogSummary) -> Option<(usize, Frame)> {
        let block = self.packet_block(bytes)?;
        let entry = self.take(block).ok()?.ok()??;
        let name = entry.interface.as_bytes();
        let frame = summary.take_plain(entry.time, name, &entry.frame)?;
        Some((block.len(), frame))
    }

    fn entry_start(&self, tail: &[u8]) -> Option<usize> {
        // Each block ends with its length.
        let mut start = tail.len();
        while let Some(length) = tail[..start].last_chunk() {
            let big_endian = self.big_endian;
            let length = Fields { bytes: length as &[u8; 4], big_endian }.u32()?;
            match start.checked_sub(length as usize) {
                Some(before) if length >= 12 && length.is_multiple_of(4) => start = before,
                _ => break,
            }
        }
        (start < tail.len()).then_some(start)
    }
}

/// State that packets depend on: the byte order and the interfaces.
#[derive(Clone, Debug, Default)]
pub struct SectionState {
    big_endian: bool,
    /// Major version of the current section, if it cannot be read.
    unknown_version: Option<u16>,
    /// Shared with the positions that were kept.
    interfaces: Arc<Vec<PcapInterface>>,
}

#[derive(Clone, Debug)]
struct PcapInterface {
    link_type: u16,
    name: String,
    resolution: u8,
    offset_seconds: i64,
}

impl SectionState {
    /// Returns the length of the block that begins with these bytes, at least [`BLOCK_HEADER_LEN`].
    ///
    /// # Errors
    ///
    /// The byte order or the length is not valid: the rest of the file cannot be read.
    pub fn block_len(&self, head: &[u8; BLOCK_HEADER_LEN]) -> Result<u32, Damage> {
        let big_endian = if head[..4] == MAGIC {
            byte_order(&head[8..]).ok_or(Damage::ByteOrder)?
        } else {
            self.big_endian
        };
        let len = Fields { bytes: &head[4..], big_endian }.u32().unwrap_or(0);
        if len < 12 || !len.is_multiple_of(4) { Err(Damage::Length(len)) } else { Ok(len) }
    }

    /// Returns the packet that `bytes` begin with; `None` if another block is there, or the packet is not
    /// whole, or too long.
    fn packet_block<'b>(&self, bytes: &'b [u8]) -> Option<&'b [u8]> {
        let head = bytes.first_chunk()?;
        if (Fields { bytes: head, big_endian: self.big_endian }).u32() != Some(PACKET) {
            return None;
        }
        let len = self.block_len(head).ok()? as usize;
        bytes.get(..len).filter(|_| len <= MAX_BLOCK)
    }

    /// Checks a block that begins with these bytes and is skipped.
    ///
    /// # Errors
    ///
    /// The block is a packet, which is too long.
    pub fn skip(&self, head: &[u8; BLOCK_HEADER_LEN]) -> Result<(), PacketFault> {
        let kind = Fields { bytes: head, big_endian: self.big_endian }.u32();
        let is_packet = matches!(kind, Some(PACKET | SIMPLE_PACKET | OLD_PACKET));
        match self.unknown_version {
            _ if !is_packet => Ok(()),
            Some(version) => Err(PacketFault::Version(version)),
            None => Err(PacketFault::Long),
        }
    }

    /// Reads a whole block; returns its frame, if it is a packet.
    pub fn take(
        &mut self,
        block: &[u8],
    ) -> Result<Result<Option<LogEntry<'_>>, PacketFault>, Damage> {
        let is_section = block.starts_with(&MAGIC);
        if is_section {
            self.big_endian = block.get(8..).and_then(byte_order).ok_or(Damage::ByteOrder)?;
        }
        let mut fields = Fields { bytes: block, big_endian: self.big_endian };
        let kind = fields.u32().unwrap_or(0);
        let _len = fields.u32();
        let (body, tail) = fields.bytes.split_at(fields.bytes.len().saturating_sub(4));
        if tail != &block[4..8] {
            return Err(Damage::Lengths);
        }
        let fields = Fields { bytes: body, big_endian: self.big_endian };
        if is_section {
            self.begin(fields);
            return Ok(Ok(None));
        }
        Ok(match (kind, self.unknown_version) {
            (PACKET | SIMPLE_PACKET | OLD_PACKET, Some(version)) => {
                Err(PacketFault::Version(version))
            }
            (INTERFACE, None) => {
                self.add_interface(fields);
                Ok(None)
            }
            (PACKET | OLD_PACKET, None) => self.packet(fields, kind),
            (SIMPLE_PACKET, None) => Err(PacketFault::NoTime),
            _ => Ok(None),
        })
    }

    fn begin(&mut self, mut fields: Fields<'_>) {
        self.interfaces = Arc::default();
        let _byte_order = fields.u32();
        let version = fields.u16().unwrap_or(0);
        self.unknown_version = (version != 1).then_some(version);
    }

    fn add_interface(&mut self, mut fields: Fields<'_>) {
        if self.interfaces.len() == MAX_INTERFACES {
            return;
        }
        // An incomplete description still has a number, but no link type.
        let link_type = fields.u16().unwrap_or(u16::MAX);
        let (_reserved, _snapshot_length) = (fields.u16(), fields.u32());
        let name = format!("if{}", self.interfaces.len());
        let mut interface = PcapInterface { link_type, name, resolution: 6, offset_seconds: 0 };
        while let Some((option, value)) = fields.option() {
            match (option, value) {
                (NAME_OPTION, value) if !value.is_empty() => interface.name = shown_name(value),
                (RESOLUTION_OPTION, &[resolution]) => interface.resolution = resolution,
                (OFFSET_OPTION, value) => {
                    let offset = Fields { bytes: value, ..fields }.u64();
                    interface.offset_seconds = offset.unwrap_or(0).cast_signed();
                }
                _ => {}
            }
        }
        Arc::make_mut(&mut self.interfaces).push(interface);
    }

    /// Reads a packet of a block of this kind; `None` for one of another protocol than CAN.
    fn packet(
        &self,
        mut fields: Fields<'_>,
        kind: u32,
    ) -> Result<Option<LogEntry<'_>>, PacketFault> {
        let interface = if kind == OLD_PACKET {
            // The number of packets that were lost before it follows.
            let (interface, _drops) = (fields.u16(), fields.u16());
            interface.map(u32::from)
        } else {
            fields.u32()
        };
        let interface = interface.ok_or(PacketFault::Short)?;
        let mut field = || fields.u32().ok_or(PacketFault::Short);
        let (high, low, captured, _original) = (field()?, field()?, field()?, field()?);
        let interface =
            self.interfaces.get(interface as usize).ok_or(match self.interfaces.len() {
                MAX_INTERFACES => PacketFault::TooManyInterfaces,
                _ => PacketFault::Interface,
            })?;
        if !packet::is_known(interface.link_type) {
            return Err(PacketFault::LinkType(interface.link_type));
        }
        let data = fields.padded(captured as usize).ok_or(PacketFault::Short)?;
        let order = if self.big_endian { FileOrder::Big } else { FileOrder::Little };
        let Some(packet) = packet::decode(interface.link_type, data, order)? else {
            return Ok(None);
        };
        let mut frame = packet.frame;
        while let Some((option, value)) = fields.option() {
            if option == FLAGS_OPTION {
                let flags = Fields { bytes: value, ..fields }.u32().unwrap_or(0);
                match flags & DIRECTION {
                    0 => {}
                    direction => frame.is_tx = direction == OUTBOUND,
                }
            }
        }
        let time = interface.time(u64::from(high) << 32 | u64::from(low));
        let time = time.ok_or(PacketFault::TimeRange)?;
        Ok(Some(LogEntry { time, interface: &interface.name, frame }))
    }
}

impl PcapInterface {
    /// Converts a time in this interface's units; `None` for one before 1970, or one too large.
    fn time(&self, time: u64) -> Option<LogTime> {
        // The usual ones.
        match (self.resolution, self.offset_seconds) {
            (6, 0) => return Some(LogTime::from_micros(time)),
            (9, 0) => return Some(LogTime::from_nanos(time)),
            _ => {}
        }
        let time = u128::from(time);
        let nanos = match self.resolution {
            binary @ 0x80.. => (time * 1_000_000_000) >> (binary & 0x7F),
            decimal @ 0..9 => time * 10_u128.pow(u32::from(9 - decimal)),
            decimal => 10_u128.checked_pow(u32::from(decimal - 9)).map_or(0, |unit| time / unit),
        };
        let offset = i128::from(self.offset_seconds) * 1_000_000_000;
        let nanos = i128::try_from(nanos).ok()?.checked_add(offset)?;
        let micros = u64::try_from(nanos.div_euclid(1000)).ok()?;
        Some(LogTime { micros, nanos: nanos.rem_euclid(1000) as u16 })
    }
}

/// Returns a printable name without white space.
fn shown_name(bytes: &[u8]) -> String {
    let name = crate::text::printable(&bytes[..bytes.len().min(MAX_NAME)]);
    name.replace(char::is_whitespace, "_")
}

fn byte_order(bytes: &[u8]) -> Option<bool> {
    let bytes = *bytes.first_chunk()?;
    match BYTE_ORDER {
        order if order == u32::from_be_bytes(bytes) => Some(true),
        order if order == u32::from_le_bytes(bytes) => Some(false),
        _ => None,
    }
}

/// Reads fields in a section's byte order.
#[derive(Clone, Copy)]
struct Fields<'b> {
    bytes: &'b [u8],
    big_endian: bool,
}

impl<'b> Fields<'b> {
    fn u16(&mut self) -> Option<u16> {
        let bytes = self.take()?;
        Some(if self.big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
    }

    fn u32(&mut self) -> Option<u32> {
        let bytes = self.take()?;
        Some(if self.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    fn u64(&mut self) -> Option<u64> {
        let bytes = self.take()?;
        Some(if self.big_endian { u64::from_be_bytes(bytes) } else { u64::from_le_bytes(bytes) })
    }

    /// Returns `len` bytes and skips the padding to a multiple of four.
    fn padded(&mut self, len: usize) -> Option<&'b [u8]> {
        let value = self.bytes.get(..len)?;
        self.bytes = self.bytes.get(len.next_multiple_of(4)..).unwrap_or_default();
        Some(value)
    }

    /// Returns the next option; `None` after the last one.
    fn option(&mut self) -> Option<(u16, &'b [u8])> {
        let (option, len) = (self.u16()?, self.u16()?);
        let value = self.padded(usize::from(len))?;
        (option != 0).then_some((option, value))
    }

    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (bytes, rest) = self.bytes.split_first_chunk()?;
        self.bytes = rest;
        Some(*bytes)
    }
}

// --- writing ------------------------------------------------------------------------------

/// Writes the section header at the beginning of a file.
///
/// # Errors
///
/// Those of writing to `out`.
pub fn write_section(out: &mut impl Write) -> io::Result<()> {
    write_section_about(out, "")
}

/// Writes the section header with a comment, empty for none.
///
/// # Errors
///
/// Those of writing to `out`.
pub fn write_section_about(out: &mut impl Write, comment: &str) -> io::Result<()> {
    let mut block = Block::new(SECTION);
    block.u32(BYTE_ORDER);
    block.u16(1);
    block.u16(0);
    // Length of the section: not specified.
    block.u64(u64::MAX);
    block.comment(comment);
    block.option(APPLICATION_OPTION, concat!("descan ", env!("CARGO_PKG_VERSION")).as_bytes());
    block.end_options();
    block.write(out)
}

/// Writes the description of the next interface, counted from 0.
///
/// # Errors
///
/// Those of writing to `out`.
pub fn write_interface(out: &mut impl Write, name: &str) -> io::Result<()> {
    write_description(out, name, TimeUnit::Micros)
}

/// Unit of the times of an interface that is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TimeUnit {
    Micros,
    Nanos,
}

impl TimeUnit {
    /// Returns a time in this unit; `None` if it has finer digits, or is too large.
    fn of(self, time: LogTime) -> Option<u64> {
        match self {
            Self::Micros => Some(time.micros).filter(|_| time.nanos == 0),
            Self::Nanos => time.micros.checked_mul(1000)?.checked_add(u64::from(time.nanos)),
        }
    }
}

fn write_description(out: &mut impl Write, name: &str, unit: TimeUnit) -> io::Result<()> {
    let resolution = match unit {
        TimeUnit::Micros => 6,
        TimeUnit::Nanos => 9,
    };
    let mut block = Block::new(INTERFACE);
    block.u16(SOCKETCAN);
    block.u16(0);
    // Snapshot length: unlimited.
    block.u32(0);
    block.option(NAME_OPTION, name.as_bytes());
    block.option(RESOLUTION_OPTION, &[resolution]);
    block.end_options();
    block.write(out)
}

/// Writes a frame of an interface, at a time in its unit: microseconds since 1970 after
/// [`write_interface`].
///
/// # Errors
///
/// Those of writing to `out`.
pub fn write_frame(
    out: &mut impl Write,
    interface: u32,
    time: u64,
    frame: &Frame,
) -> io::Result<()> {
    write_frame_with(out, interface, time, frame, "")
}

/// Writes a frame with a comment, empty for none.
///
/// # Errors
///
/// Those of writing to `out`.
pub fn write_frame_with(
    out: &mut impl Write,
    interface: u32,
    time: u64,
    frame: &Frame,
    comment: &str,
) -> io::Result<()> {
    let mut block = Block::new(PACKET);
    block.u32(interface);
    block.time(time);
    let len = (CAN_HEAD + frame.data().len()) as u32;
    block.u32(len);
    block.u32(len);
    let fd = if frame.is_fd { FD_FORMAT | fields::fd_flags(frame) } else { 0 };
    let word = fields::id_word(frame);
    block.bytes(&word.to_be_bytes());
    block.bytes(&[frame.len() as u8, fd, 0, frame.raw_dlc().unwrap_or(0)]);
    block.bytes(frame.data());
    block.pad();
    block.comment(comment);
    let direction = if frame.is_tx { OUTBOUND } else { INBOUND };
    block.option(FLAGS_OPTION, &direction.to_le_bytes());
    block.end_options();
    block.write(out)
}

/// Writes the number of received and of lost frames of an interface, up to a time in its unit: microseconds
/// since 1970 after [`write_interface`].
pub fn write_statistics(
    out: &mut impl Write,
    interface: u32,
    time: u64,
    received: u64,
    dropped: u64,
) -> io::Result<()> {
    let mut block = Block::new(STATISTICS);
    block.u32(interface);
    block.time(time);
    block.option(RECEIVED_OPTION, &received.to_le_bytes());
    block.option(DROPPED_OPTION, &dropped.to_le_bytes());
    block.end_options();
    block.write(out)
}

/// Writes one section; a bus becomes an interface with its first frame.
#[derive(Debug, Default)]
pub(super) struct BlockEncoder {
    /// Interfaces by their number in the section.
    interfaces: Vec<InterfaceCount>,
    last: LogTime,
    loss: LogLoss,
}

#[derive(Debug)]
struct InterfaceCount {
    bus: BusIndex,
    unit: TimeUnit,
    frames: u64,
}

impl BlockEncoder {
    /// Returns the number of a bus with times in a unit, any with `None`; writes its description on first
    /// use.
    fn interface(
        &mut self,
        bus: BusIndex,
        unit: Option<TimeUnit>,
        name: &str,
        out: &mut Vec<u8>,
    ) -> io::Result<usize> {
        let is_it = |it: &InterfaceCount| it.bus == bus && unit.is_none_or(|unit| it.unit == unit);
        if let Some(at) = self.interfaces.iter().position(is_it) {
            return Ok(at);
        }
        let unit = unit.unwrap_or(TimeUnit::Micros);
        write_description(out, name, unit)?;
        self.interfaces.push(InterfaceCount { bus, unit, frames: 0 });
        Ok(self.interfaces.len() - 1)
    }
}

impl LogEncoder for BlockEncoder {
    fn begin(&mut self, out: &mut Vec<u8>) -> io::Result<()> {
        write_section(out)
    }

    /// A bus whose times have nanoseconds has another description from there on.
    fn write(&mut self, entry: LogEntry<'_>, max_len: u64, out: &mut Vec<u8>) -> io::Result<bool> {
        let (before, interfaces) = (out.len(), self.interfaces.len());
        let has_nanos = TimeUnit::Micros.of(entry.time).is_none();
        let bus = entry.frame.bus;
        let is_in_nanos =
            self.interfaces.iter().any(|it| it.bus == bus && it.unit == TimeUnit::Nanos);
        let nanos = TimeUnit::Nanos.of(entry.time).filter(|_| has_nanos || is_in_nanos);
        let (unit, time) = match nanos {
            Some(nanos) => (TimeUnit::Nanos, nanos),
            None => (TimeUnit::Micros, entry.time.micros),
        };
        let at = self.interface(bus, Some(unit), entry.interface, out)?;
        write_frame(out, at as u32, time, &entry.frame)?;
        if (out.len() - before) as u64 > max_len {
            out.truncate(before);
            self.interfaces.truncate(interfaces);
            return Ok(false);
        }
        self.loss.finer_times += u64::from(has_nanos && nanos.is_none());
        self.interfaces[at].frames += 1;
        self.last = entry.time;
        Ok(true)
    }

    /// Writes the statistics of each bus; a bus without frames may have lost frames.
    fn end(&mut self, names: &[String], lost: &[u64], out: &mut Vec<u8>) -> io::Result<()> {
        for (bus, name) in (0..=u8::MAX).zip(names) {
            self.interface(BusIndex(bus), None, name, out)?;
        }
        for (at, interface) in self.interfaces.iter().enumerate() {
            let is_first = self.interfaces[..at].iter().all(|it| it.bus != interface.bus);
            let lost = lost.get(usize::from(interface.bus.0)).filter(|_| is_first);
            let time = interface.unit.of(self.last).unwrap_or(self.last.micros);
            let lost = lost.copied().unwrap_or(0);
            write_statistics(out, at as u32, time, interface.frames, lost)?;
        }
        Ok(())
    }

    fn loss(&self) -> LogLoss {
        self.loss.clone()
    }
}

/// A block under construction, little-endian.
struct Block {
    bytes: Vec<u8>,
}

impl Block {
    fn new(kind: u32) -> Self {
        let mut block = Self { bytes: Vec::with_capacity(160) };
        block.u32(kind);
        // Placeholder of the length, set when it is known.
        block.u32(0);
        block
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    fn u16(&mut self, number: u16) {
        self.bytes(&number.to_le_bytes());
    }

    fn u32(&mut self, number: u32) {
        self.bytes(&number.to_le_bytes());
    }

    fn u64(&mut self, number: u64) {
        self.bytes(&number.to_le_bytes());
    }

    /// Appends a time: the upper half first, in any byte order.
    fn time(&mut self, time: u64) {
        self.u32((time >> 32) as u32);
        self.u32(time as u32);
    }

    fn pad(&mut self) {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
    }

    fn option(&mut self, option: u16, value: &[u8]) {
        let value = &value[..value.len().min(usize::from(u16::MAX))];
        self.u16(option);
        self.u16(value.len() as u16);
        self.bytes(value);
        self.pad();
    }

    fn comment(&mut self, comment: &str) {
        if !comment.is_empty() {
            self.option(COMMENT_OPTION, comment.as_bytes());
        }
    }

    fn end_options(&mut self) {
        self.u32(0);
    }

    fn write(mut self, out: &mut impl Write) -> io::Result<()> {
        let len = (self.bytes.len() + 4) as u32;
        self.bytes[4..8].copy_from_slice(&len.to_le_bytes());
        self.u32(len);
        out.write_all(&self.bytes)
    }
}
