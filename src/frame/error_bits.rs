//! Bits of SocketCAN's error frames (`linux/can/error.h`): classes in the identifier, details in the data.
//!
//! Only values. What they mean together, and which a format has, is decided elsewhere.

// Error classes, in the identifier.
pub const TRANSMISSION_TIMEOUT: u32 = 0x001;
pub const LOST_ARBITRATION: u32 = 0x002;
pub const CONTROLLER: u32 = 0x004;
pub const PROTOCOL: u32 = 0x008;
pub const TRANSCEIVER: u32 = 0x010;
pub const NO_ACKNOWLEDGE: u32 = 0x020;
pub const BUS_OFF: u32 = 0x040;
pub const BUS_ERROR: u32 = 0x080;
pub const RESTARTED: u32 = 0x100;
/// Bytes 6 and 7 are the error counters TEC and REC.
pub const COUNTERS: u32 = 0x200;

// State of the controller, in byte 1.
pub const RECEIVE_OVERFLOW: u8 = 0x01;
pub const TRANSMIT_OVERFLOW: u8 = 0x02;
pub const RECEIVE_WARNING: u8 = 0x04;
pub const TRANSMIT_WARNING: u8 = 0x08;
pub const RECEIVE_PASSIVE: u8 = 0x10;
pub const TRANSMIT_PASSIVE: u8 = 0x20;
/// Back to error-active.
pub const ACTIVE: u8 = 0x40;

// Type of the bus error, in byte 2.
pub const BIT: u8 = 0x01;
pub const FORM: u8 = 0x02;
pub const STUFF: u8 = 0x04;
/// A dominant bit was sent and a recessive one read.
pub const BIT_0: u8 = 0x08;
/// A recessive bit was sent and a dominant one read.
pub const BIT_1: u8 = 0x10;
pub const OVERLOAD: u8 = 0x20;
pub const WHILE_SENDING: u8 = 0x80;

// Place of the bus error in the frame, in byte 3.
pub const CRC_SEQUENCE: u8 = 0x08;
pub const ACKNOWLEDGE_SLOT: u8 = 0x19;
pub const ACKNOWLEDGE_DELIMITER: u8 = 0x1B;
