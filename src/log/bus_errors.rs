//! Error frames of logs, as SocketCAN has them: which bits say what was wrong.

use crate::frame::{CanId, Frame, FrameKind};

/// Class bits of a SocketCAN error frame (`linux/can/error.h`).
const PROTOCOL: u32 = 0x08;
const BUS_ERROR: u32 = 0x80;
/// Bits of its third byte.
const BIT_ERROR: u8 = 0x01;
const FORM_ERROR: u8 = 0x02;
const STUFF_ERROR: u8 = 0x04;
const OVERLOAD: u8 = 0x20;
const TRANSMISSION: u8 = 0x80;

/// Returns true for an error frame of SocketCAN that stands for one on the bus, and for any other frame. The
/// others report states of the controller.
pub(super) fn is_on_bus(frame: &Frame) -> bool {
    match frame.id {
        CanId::Extended(class) if frame.kind == FrameKind::Error => {
            class & (PROTOCOL | BUS_ERROR) != 0
        }
        _ => true,
    }
}

/// An error frame on the bus of which nothing more is known.
pub(super) fn bus_error() -> Frame {
    Frame::error(BUS_ERROR, &[0; 8])
}

/// An overload frame on the bus.
pub(super) fn overload() -> Frame {
    Frame::error(PROTOCOL, &[0, 0, OVERLOAD, 0, 0, 0, 0, 0])
}

/// An error frame with the error code capture register of the SJA1000: type of the error, direction, and
/// the place in the frame, which SocketCAN has in the same code.
pub(super) fn captured(code: u8) -> Frame {
    let kind = match code >> 6 {
        0 => BIT_ERROR,
        1 => FORM_ERROR,
        2 => STUFF_ERROR,
        _ => 0,
    };
    let is_reception = code & 0x20 != 0;
    let kind = kind | if is_reception { 0 } else { TRANSMISSION };
    Frame::error(PROTOCOL | BUS_ERROR, &[0, 0, kind, code & 0x1F, 0, 0, 0, 0])
}

/// Returns the error code capture register that [`captured`] has read; 0 without one.
pub(super) fn capture_of(data: &[u8]) -> u8 {
    let [_, _, kind, place, ..] = *data else { return 0 };
    let kind_bits = match kind & (BIT_ERROR | FORM_ERROR | STUFF_ERROR) {
        BIT_ERROR => 0,
        FORM_ERROR => 1,
        STUFF_ERROR => 2,
        _ => 3,
    };
    let direction = if kind & TRANSMISSION == 0 { 0x20 } else { 0 };
    kind_bits << 6 | direction | place & 0x1F
}
