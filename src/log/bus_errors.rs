//! Error frames of logs, as SocketCAN has them: which bits say what was wrong.

use crate::frame::error_bits::{
    ACKNOWLEDGE_DELIMITER, BIT, BIT_0, BIT_1, BUS_ERROR, COUNTERS, CRC_SEQUENCE, FORM,
    NO_ACKNOWLEDGE, OVERLOAD, PROTOCOL, STUFF, WHILE_SENDING,
};
use crate::frame::{CanId, Frame, FrameKind};

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
    captured_with_counters(code, 0, 0)
}

/// The same with the error counters of the controller, if one is not 0.
pub(super) fn captured_with_counters(code: u8, sent: u8, received: u8) -> Frame {
    let kind = match code >> 6 {
        0 => BIT,
        1 => FORM,
        2 => STUFF,
        _ => 0,
    };
    let is_reception = code & 0x20 != 0;
    let kind = kind | if is_reception { 0 } else { WHILE_SENDING };
    let counters = if (sent, received) == (0, 0) { 0 } else { COUNTERS };
    let details = [0, 0, kind, code & 0x1F, 0, 0, sent, received];
    Frame::error(PROTOCOL | BUS_ERROR | counters, &details)
}

/// An error frame of a receiver that found another CRC.
pub(super) fn wrong_crc() -> Frame {
    of_can_core(4 << 6)
}

/// An error frame of a sender whose frame nothing acknowledged.
pub(super) fn no_ack() -> Frame {
    of_can_core(7 << 6 | 0x1000)
}

/// An error frame with the extended error flags of Vector's CAN core: in bits 6 to 11 what is wrong, in bits
/// 12 and 13 whether it was sent. Their source: `CanErrorFrameExt` of the BLF format.
pub(super) fn of_can_core(flags: u16) -> Frame {
    let (class, kind, place) = match flags >> 6 & 0x3F {
        0 => (0, BIT, 0),
        1 => (0, FORM, 0),
        2 => (0, STUFF, 0),
        4 => (0, 0, CRC_SEQUENCE),
        5 => (0, FORM, ACKNOWLEDGE_DELIMITER),
        7 => (NO_ACKNOWLEDGE, 0, 0),
        _ => (0, 0, 0),
    };
    let kind = kind | if flags & 0x1000 != 0 { WHILE_SENDING } else { 0 };
    Frame::error(PROTOCOL | BUS_ERROR | class, &[0, 0, kind, place, 0, 0, 0, 0])
}

/// Bits of the flags that say which fields of an error frame of Vector's formats are valid: the error code
/// capture, and those of the CAN core.
const HAS_CODE: u32 = 1;
const HAS_CORE: u32 = 2;

/// Reads an error frame of Vector's formats, given which fields are valid, the error code capture and the
/// extended error flags. The others, such as the place in the frame, are left out, and more if `has_more`.
pub(super) fn of_vector(valid: u32, code: u8, extended: u16, has_more: bool) -> Frame {
    let frame = if valid & HAS_CODE != 0 {
        captured(code)
    } else if valid & HAS_CORE != 0 {
        of_can_core(extended)
    } else {
        bus_error()
    };
    if valid & !HAS_CODE != 0 || has_more { frame.as_changed() } else { frame }
}

/// Returns the error code capture register that [`captured`] has read; 0 without one.
pub(super) fn capture_of(data: &[u8]) -> u8 {
    let [_, _, kind, place, ..] = *data else { return 0 };
    let kind_bits = match kind & (BIT | FORM | STUFF) {
        BIT => 0,
        0 if kind & (BIT_0 | BIT_1) != 0 => 0,
        FORM => 1,
        STUFF => 2,
        _ => 3,
    };
    let direction = if kind & WHILE_SENDING == 0 { 0x20 } else { 0 };
    kind_bits << 6 | direction | place & 0x1F
}
