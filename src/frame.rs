//! CAN frames, received or to be sent; [`bits`]: their length on the bus; [`socketcan`]: their
//! fields in Linux's layouts. Does not know what the bytes mean: [`crate::wire`] does.

pub mod bits;
#[cfg(feature = "std")]
pub(crate) mod error_bits;
pub mod socketcan;

use crate::time::Instant;
use core::fmt;

/// Number of a bus: its place on the command line, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct BusIndex(pub u8);

/// A CAN identifier in one of its two formats (ISO 11898-1).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CanId {
    /// 11 bits. Not of the CAN platform: shown, not decoded.
    Standard(u16),
    /// 29 bits.
    Extended(u32),
}

impl CanId {
    /// The largest 11-bit identifier.
    pub const MAX_STANDARD: u16 = 0x7FF;
    /// The largest 29-bit identifier.
    pub const MAX_EXTENDED: u32 = 0x1FFF_FFFF;

    /// An 11-bit identifier; `None` if `id` is larger than [`Self::MAX_STANDARD`].
    pub fn standard(id: u32) -> Option<Self> {
        let id = u16::try_from(id).ok().filter(|id| *id <= Self::MAX_STANDARD);
        id.map(CanId::Standard)
    }

    /// A 29-bit identifier; `None` if `id` is larger than [`Self::MAX_EXTENDED`].
    pub fn extended(id: u32) -> Option<Self> {
        (id <= Self::MAX_EXTENDED).then_some(CanId::Extended(id))
    }
}

impl fmt::Debug for CanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

/// Hexadecimal as candump prints it: 3 digits standard, 8 digits extended.
impl fmt::Display for CanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            CanId::Standard(id) => write!(f, "{id:03X}"),
            CanId::Extended(id) => write!(f, "{id:08X}"),
        }
    }
}

/// A set of 29-bit identifiers: those equal to `id` in the bits of `mask`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IdFilter {
    /// The values of the bits that count.
    pub id: u32,
    /// Which bits count.
    pub mask: u32,
}

impl IdFilter {
    /// Returns true if a 29-bit identifier is in the set.
    pub const fn matches(self, id: u32) -> bool {
        (id ^ self.id) & self.mask == 0
    }
}

/// Kind of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum FrameKind {
    /// Data, classic or FD.
    #[default]
    Data,
    /// Remote frame; its length is the requested one.
    Remote,
    /// Error frame, a report of the controller: the identifier holds the error class bits, the
    /// data the details (`linux/can/error.h`).
    Error,
}

/// One frame with its time of arrival.
#[derive(Clone, Copy, Eq)]
pub struct Frame {
    /// When its end was received.
    pub time: Instant,
    /// The identifier.
    pub id: CanId,
    /// The bus it was received on or is to be sent on.
    pub bus: BusIndex,
    /// Data, remote or error.
    pub kind: FrameKind,
    /// CAN FD format.
    pub is_fd: bool,
    /// FD: the data phase ran at the data bit rate (BRS).
    pub bit_rate_switch: bool,
    /// FD: the sender was error-passive (ESI).
    pub error_state: bool,
    /// Sent by descan, and acknowledged on the bus.
    pub is_tx: bool,
    /// From a log without times: the time is that of its arrival, or of the beginning of the log.
    pub is_timeless: bool,
    /// Length in bytes, with [`Frame::CHANGED`].
    len: u8,
    /// The data. Behind those of a classic frame of eight bytes stands its raw DLC, if it is above 8.
    data: [u8; Frame::MAX_DATA],
}

/// The mark of a changed frame does not count.
impl PartialEq for Frame {
    fn eq(&self, other: &Self) -> bool {
        let flags = |frame: &Self| {
            let fd = [frame.is_fd, frame.bit_rate_switch, frame.error_state];
            (fd, frame.is_tx, frame.is_timeless)
        };
        (self.time, self.id, self.bus, self.kind) == (other.time, other.id, other.bus, other.kind)
            && flags(self) == flags(other)
            && (self.len(), self.data) == (other.len(), other.data)
    }
}

impl Frame {
    /// The most bytes an FD frame carries.
    pub const MAX_DATA: usize = 64;
    /// The most bytes a classic frame carries.
    pub const MAX_CLASSIC_DATA: usize = 8;
    /// Flag of the length: what the frame was read from holds something else.
    const CHANGED: u8 = 0x80;

    /// A classic data frame with an extended identifier; bytes after the eighth are dropped.
    pub fn classic(id: u32, data: &[u8]) -> Self {
        Self::new(CanId::Extended(id), &data[..data.len().min(Self::MAX_CLASSIC_DATA)])
    }

    /// An FD data frame with an extended identifier, padded with `padding` to the next length that
    /// has a DLC; bytes after the 64th are dropped.
    pub fn fd(id: u32, data: &[u8], padding: u8) -> Self {
        let data = &data[..data.len().min(Self::MAX_DATA)];
        let mut frame = Self::new(CanId::Extended(id), data);
        let padded = fd_length(data.len());
        frame.data[data.len()..padded].fill(padding);
        frame.len = padded as u8;
        frame.is_fd = true;
        frame.bit_rate_switch = true;
        frame
    }

    /// A data frame with any identifier, not in FD format; bytes after the 64th are dropped.
    #[inline]
    pub fn new(id: CanId, data: &[u8]) -> Self {
        let len = data.len().min(Self::MAX_DATA);
        let mut bytes = [0; Self::MAX_DATA];
        bytes[..len].copy_from_slice(&data[..len]);
        Self {
            time: Instant::ZERO,
            id,
            bus: BusIndex(0),
            kind: FrameKind::Data,
            is_fd: false,
            bit_rate_switch: false,
            error_state: false,
            is_tx: false,
            is_timeless: false,
            len: len as u8,
            data: bytes,
        }
    }

    /// A classic data frame with the first `len` of eight bytes, at most 8; the others are 0. Copies no slice.
    #[inline]
    #[cfg(feature = "std")]
    pub(crate) fn of_eight_bytes(
        id: CanId,
        data: [u8; Self::MAX_CLASSIC_DATA],
        len: usize,
    ) -> Self {
        debug_assert!(data.iter().skip(len).all(|byte| *byte == 0));
        let mut frame = Self::new(id, &[]);
        if let Some(first) = frame.data.first_chunk_mut() {
            *first = data;
        }
        frame.len = len.min(Self::MAX_CLASSIC_DATA) as u8;
        frame
    }

    /// A remote frame that requests `len` bytes, at most 8.
    pub fn remote(id: CanId, len: usize) -> Self {
        let mut frame = Self::new(id, &[]);
        frame.kind = FrameKind::Remote;
        frame.len = len.min(Self::MAX_CLASSIC_DATA) as u8;
        frame
    }

    /// An error frame: class bits and details as in `linux/can/error.h`.
    pub fn error(class: u32, details: &[u8]) -> Self {
        let mut frame = Self::classic(class & CanId::MAX_EXTENDED, details);
        frame.kind = FrameKind::Error;
        frame
    }

    /// The same frame with another time.
    #[must_use]
    pub fn with_time(mut self, time: Instant) -> Self {
        self.time = time;
        self
    }

    /// The same frame on another bus.
    #[must_use]
    pub fn with_bus(mut self, bus: BusIndex) -> Self {
        self.bus = bus;
        self
    }

    /// The same frame, marked as sent by descan.
    #[must_use]
    pub fn with_tx(mut self) -> Self {
        self.is_tx = true;
        self
    }

    /// The same frame with a DLC of 9 to 15 on the bus, which means eight bytes in a classic frame, as 8 does
    /// (ISO 11898-1). Without effect for any other DLC, and on a frame that is not a classic one of eight bytes.
    #[must_use]
    pub fn with_raw_dlc(mut self, dlc: u8) -> Self {
        if self.has_eight_bytes() && matches!(dlc, 9..=15) {
            self.data[Self::MAX_CLASSIC_DATA] = dlc;
        }
        self
    }

    /// The DLC on the bus, if it is one of 9 to 15 that a classic frame of eight bytes has in place of 8.
    #[inline]
    pub fn raw_dlc(&self) -> Option<u8> {
        let dlc = self.data[Self::MAX_CLASSIC_DATA];
        (dlc != 0 && self.has_eight_bytes()).then_some(dlc)
    }

    /// Its data length code on the bus.
    #[inline]
    pub fn dlc(&self) -> u8 {
        self.raw_dlc().unwrap_or_else(|| dlc(self.len()))
    }

    /// Returns true for a classic frame of eight bytes; a remote frame may request them.
    #[inline]
    fn has_eight_bytes(&self) -> bool {
        !self.is_fd && self.kind != FrameKind::Error && self.len() == Self::MAX_CLASSIC_DATA
    }

    /// The same frame, marked as not all that it was read from, or as more.
    #[must_use]
    #[cfg(feature = "std")]
    pub(crate) fn as_changed(mut self) -> Self {
        self.len |= Self::CHANGED;
        self
    }

    /// Returns true with the mark of [`Self::as_changed`].
    #[inline]
    #[cfg(feature = "std")]
    pub(crate) fn is_changed(&self) -> bool {
        self.len & Self::CHANGED != 0
    }

    /// Removes the mark of [`Self::as_changed`]; returns true if it was there.
    #[inline]
    #[cfg(feature = "std")]
    pub(crate) fn take_changed(&mut self) -> bool {
        let is_changed = self.is_changed();
        self.len &= !Self::CHANGED;
        is_changed
    }

    /// Its data; empty for a remote frame.
    #[inline]
    pub fn data(&self) -> &[u8] {
        if self.kind == FrameKind::Remote { &[] } else { &self.data[..self.len()] }
    }

    /// The first eight bytes of its data; those behind its length mean nothing.
    #[inline]
    fn first_eight_bytes(&self) -> [u8; Self::MAX_CLASSIC_DATA] {
        self.data.first_chunk().copied().unwrap_or_default()
    }

    /// Its length in bytes; for a remote frame the requested one.
    #[inline]
    pub fn len(&self) -> usize {
        usize::from(self.len & !Self::CHANGED)
    }

    /// Returns true if its length is 0.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The identifier of a data frame with 29 bits: the only frames of the CAN platform. `None` for
    /// all others.
    pub fn platform_id(&self) -> Option<u32> {
        match (self.kind, self.id) {
            (FrameKind::Data, CanId::Extended(id)) => Some(id),
            _ => None,
        }
    }

    /// Returns true if both frames are equal on the bus; times and senders do not count.
    pub fn same_on_wire(&self, other: &Frame) -> bool {
        self.id == other.id
            && self.kind == other.kind
            && self.is_fd == other.is_fd
            && self.len() == other.len()
            && self.data() == other.data()
            && self.raw_dlc() == other.raw_dlc()
    }
}

/// As candump writes it, without time and bus: `02015402#0444455301`, FD as `ID##FDATA` with
/// the flags digit, remote as `ID#R4`, error frames with bit 29 of the identifier set, a raw DLC as `_F`.
impl fmt::Display for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.kind, self.id) {
            (FrameKind::Error, _) => write!(f, "{:08X}#", socketcan::id_word(self))?,
            (FrameKind::Remote, id) => {
                write!(f, "{id}#R")?;
                if !self.is_empty() {
                    write!(f, "{}", self.len())?;
                }
            }
            (FrameKind::Data, id) if self.is_fd => {
                write!(f, "{id}##{:X}", socketcan::fd_flags(self))?;
            }
            (FrameKind::Data, id) => write!(f, "{id}#")?,
        }
        self.data().iter().try_for_each(|byte| write!(f, "{byte:02X}"))?;
        self.raw_dlc().map_or(Ok(()), |dlc| write!(f, "_{dlc:X}"))
    }
}

impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}) {} {self}", self.time, self.bus.0)?;
        if self.is_tx { f.write_str(" T") } else { Ok(()) }
    }
}

/// The data length code of `len` bytes, at most 64.
pub const fn dlc(len: usize) -> u8 {
    match len {
        0..=8 => len as u8,
        9..=12 => 9,
        13..=16 => 10,
        17..=20 => 11,
        21..=24 => 12,
        25..=32 => 13,
        33..=48 => 14,
        _ => 15,
    }
}

/// The shortest length with a DLC of its own that holds `len` bytes (ISO 11898-1: 0–8, 12, 16,
/// 20, 24, 32, 48, 64).
pub const fn fd_length(len: usize) -> usize {
    match len {
        0..=8 => len,
        9..=12 => 12,
        13..=16 => 16,
        17..=20 => 20,
        21..=24 => 24,
        25..=32 => 32,
        33..=48 => 48,
        _ => 64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn display_is_that_of_candump() {
        let request = Frame::classic(0x0201_5402, &[4, 0x44, 0x45, 0x53, 1]);
        assert_eq!(request.to_string(), "02015402#0444455301");
        assert_eq!(Frame::remote(CanId::Standard(0x12), 4).to_string(), "012#R4");
        assert_eq!(Frame::error(4, &[0, 1]).to_string(), "20000004#0001");
        let eight = Frame::classic(1, &[0; 8]).with_raw_dlc(15);
        assert_eq!(eight.to_string(), "00000001#0000000000000000_F");
        assert_eq!(Frame::remote(CanId::Standard(1), 8).with_raw_dlc(9).to_string(), "001#R8_9");
        assert_eq!(Frame::classic(1, &[0; 7]).with_raw_dlc(15).raw_dlc(), None);
        assert_eq!(Frame::classic(1, &[0; 8]).with_raw_dlc(8).raw_dlc(), None);
        assert_eq!(
            Frame::fd(1, &[0; 9], 0xCC).to_string(),
            format!("00000001##1{}CCCCCC", "00".repeat(9))
        );
    }
}
