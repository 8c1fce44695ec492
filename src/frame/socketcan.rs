//! SocketCAN's frame fields (`linux/can.h`): the identifier word and the FD flags, which the
//! kernel, pcapng and candump's log text share.
//!
//! Pure. Does not know the byte order of a layout: the caller reads and writes the bytes.

use super::{CanId, Frame, FrameKind, fd_length};

/// Identifier word: a 29-bit identifier.
pub const EXTENDED_FLAG: u32 = 0x8000_0000;
/// Identifier word: a remote frame.
pub const REMOTE_FLAG: u32 = 0x4000_0000;
/// Identifier word: an error frame.
pub const ERROR_FLAG: u32 = 0x2000_0000;

/// FD flags: the data phase ran at the data bit rate (BRS).
pub const BIT_RATE_SWITCH: u8 = 0x01;
/// FD flags: the sender was error-passive (ESI).
pub const ERROR_STATE: u8 = 0x02;
/// FD flags: the frame is in FD format (FDF).
pub const FD_FORMAT: u8 = 0x04;

/// The identifier word of a frame.
pub fn id_word(frame: &Frame) -> u32 {
    let id = match frame.id {
        CanId::Standard(id) => u32::from(id),
        CanId::Extended(id) => id | EXTENDED_FLAG,
    };
    match frame.kind {
        FrameKind::Data => id,
        FrameKind::Remote => id | REMOTE_FLAG,
        // The class bits stand in the place of the identifier.
        FrameKind::Error => id & CanId::MAX_EXTENDED | ERROR_FLAG,
    }
}

/// BRS and ESI of a frame; 0 unless it is an FD frame.
pub fn fd_flags(frame: &Frame) -> u8 {
    let flag = |is_set, flag| if frame.is_fd && is_set { flag } else { 0 };
    flag(frame.bit_rate_switch, BIT_RATE_SWITCH) | flag(frame.error_state, ERROR_STATE)
}

/// The frame of an identifier word, a length, the FD flags (`None`: a classic frame) and the data,
/// which may be followed by padding. Bits of a standard identifier beyond the eleventh are ignored.
/// `None` if the length exceeds the format's limit or the data.
#[inline]
pub fn decode(word: u32, len: usize, fd_flags: Option<u8>, data: &[u8]) -> Option<Frame> {
    let limit = if fd_flags.is_some() { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA };
    if len > limit {
        return None;
    }
    let id = if word & EXTENDED_FLAG != 0 {
        CanId::Extended(word & CanId::MAX_EXTENDED)
    } else {
        CanId::Standard(word as u16 & CanId::MAX_STANDARD)
    };
    if word & (ERROR_FLAG | REMOTE_FLAG) == REMOTE_FLAG {
        return Some(Frame::remote(id, len));
    }
    let data = data.get(..len)?;
    if word & ERROR_FLAG != 0 {
        return Some(Frame::error(word & CanId::MAX_EXTENDED, data));
    }
    Some(match fd_flags {
        None => Frame::new(id, data),
        Some(flags) => with_fd_flags(id, data, flags),
    })
}

/// An FD data frame with BRS and ESI from `flags`, padded with zeros to a length that a DLC has: marked as
/// changed then.
pub fn with_fd_flags(id: CanId, data: &[u8], flags: u8) -> Frame {
    let mut frame = Frame::new(id, data);
    // Bytes after the data are zero.
    frame.len = fd_length(data.len()) as u8;
    frame.is_fd = true;
    frame.bit_rate_switch = flags & BIT_RATE_SWITCH != 0;
    frame.error_state = flags & ERROR_STATE != 0;
    #[cfg(feature = "std")]
    if frame.len() != data.len() {
        return frame.as_changed();
    }
    frame
}
