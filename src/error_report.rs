//! What a controller reports of errors, read from an error frame as Linux `can/error.h` lays it
//! out: class bits in the identifier, details in eight bytes.
//!
//! Knows nothing of who sent the frames that broke: a report does not say it.

use crate::frame::{CanId, Frame, FrameKind};
use std::fmt;

// Classes, in the identifier.
const TRANSMISSION_TIMEOUT: u32 = 0x001;
const LOST_ARBITRATION: u32 = 0x002;
const CONTROLLER: u32 = 0x004;
const PROTOCOL: u32 = 0x008;
const TRANSCEIVER: u32 = 0x010;
const NO_ACKNOWLEDGE: u32 = 0x020;
const BUS_OFF: u32 = 0x040;
const BUS_ERROR: u32 = 0x080;
const RESTARTED: u32 = 0x100;
const COUNTERS: u32 = 0x200;

// The controller's state, in byte 1.
const RECEIVE_OVERFLOW: u8 = 0x01;
const TRANSMIT_OVERFLOW: u8 = 0x02;
const RECEIVE_WARNING: u8 = 0x04;
const TRANSMIT_WARNING: u8 = 0x08;
const RECEIVE_PASSIVE: u8 = 0x10;
const TRANSMIT_PASSIVE: u8 = 0x20;
const ACTIVE: u8 = 0x40;

// The violation, in byte 2.
const BIT: u8 = 0x01;
const FORM: u8 = 0x02;
const STUFF: u8 = 0x04;
const BIT_0: u8 = 0x08;
const BIT_1: u8 = 0x10;
const OVERLOAD: u8 = 0x20;
const WHILE_SENDING: u8 = 0x80;

/// The acknowledge slot, as a place in the frame, in byte 3.
const ACKNOWLEDGE_SLOT: u8 = 0x19;
/// Places in the frame, in byte 3, in the order in which they are sent.
const PLACES: [(u8, &str); 19] = [
    (0x03, "start of frame"),
    (0x02, "identifier bits 28-21"),
    (0x06, "identifier bits 20-18"),
    (0x04, "SRTR bit"),
    (0x05, "IDE bit"),
    (0x07, "identifier bits 17-13"),
    (0x0F, "identifier bits 12-5"),
    (0x0E, "identifier bits 4-0"),
    (0x0C, "RTR bit"),
    (0x0D, "reserved bit 1"),
    (0x09, "reserved bit 0"),
    (0x0B, "length code"),
    (0x0A, "data"),
    (0x08, "CRC"),
    (0x18, "CRC delimiter"),
    (ACKNOWLEDGE_SLOT, "acknowledge slot"),
    (0x1B, "acknowledge delimiter"),
    (0x1A, "end of frame"),
    (0x12, "intermission"),
];

/// Faults of the wires, in byte 4: CANH in the low digit, CANL in the high one.
const WIRES: [(u8, u8, &str); 9] = [
    (0x0F, 0x04, "CANH not connected"),
    (0x0F, 0x05, "CANH shorted to the battery"),
    (0x0F, 0x06, "CANH shorted to VCC"),
    (0x0F, 0x07, "CANH shorted to ground"),
    (0xF0, 0x40, "CANL not connected"),
    (0xF0, 0x50, "CANL shorted to the battery"),
    (0xF0, 0x60, "CANL shorted to VCC"),
    (0xF0, 0x70, "CANL shorted to ground"),
    (0xF0, 0x80, "CANL shorted to CANH"),
];

/// An error frame, read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorReport {
    class: u32,
    details: [u8; 8],
}

/// Which rule of the protocol a frame broke.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Violation {
    /// A bit was read back otherwise than it was sent: somebody else sent at the same time, or
    /// the line is disturbed.
    Bit,
    /// More than five equal bits in a row: an error flag, another bit rate, or a disturbance.
    Stuff,
    /// A bit that is fixed had the other value.
    Form,
}

impl ErrorReport {
    /// Reads an error frame; `None` for all others.
    pub fn of(frame: &Frame) -> Option<Self> {
        let (FrameKind::Error, CanId::Extended(class)) = (frame.kind, frame.id) else {
            return None;
        };
        let details = std::array::from_fn(|at| frame.data().get(at).copied().unwrap_or(0));
        Some(Self { class, details })
    }

    /// Whether a frame broke on the wire, ours or another's. Missing acknowledges, arbitration
    /// lost, overload and mere changes of the controller's state are no broken frames.
    pub fn is_broken_frame(&self) -> bool {
        let overload = self.is(PROTOCOL) && self.details[2] & !WHILE_SENDING == OVERLOAD;
        (self.is(PROTOCOL) || self.is(BUS_ERROR)) && !self.is_missing_acknowledge() && !overload
    }

    /// Whether the frame that broke was ours. Not every driver says so.
    pub fn is_while_sending(&self) -> bool {
        self.is(PROTOCOL) && self.details[2] & WHILE_SENDING != 0
    }

    /// Whether nobody acknowledged a frame of ours.
    pub fn is_missing_acknowledge(&self) -> bool {
        self.is(NO_ACKNOWLEDGE) || self.is(PROTOCOL) && self.details[3] == ACKNOWLEDGE_SLOT
    }

    /// Which rule a broken frame broke, where the driver says it.
    pub fn violation(&self) -> Option<Violation> {
        if !self.is(PROTOCOL) {
            None
        } else if self.details[2] & (BIT | BIT_0 | BIT_1) != 0 {
            Some(Violation::Bit)
        } else if self.details[2] & STUFF != 0 {
            Some(Violation::Stuff)
        } else {
            (self.details[2] & FORM != 0).then_some(Violation::Form)
        }
    }

    /// Whether the controller has left the bus.
    pub fn is_bus_off(&self) -> bool {
        self.is(BUS_OFF)
    }

    /// Whether the controller takes part again, after bus-off or an error state.
    pub fn is_recovery(&self) -> bool {
        !self.is_bus_off()
            && (self.is(RESTARTED) || self.is(CONTROLLER) && self.details[1] & ACTIVE != 0)
    }

    /// Whether an error counter of the controller reached 96 (warning) or 128 (error-passive).
    pub fn is_error_state(&self) -> bool {
        let states = RECEIVE_WARNING | TRANSMIT_WARNING | RECEIVE_PASSIVE | TRANSMIT_PASSIVE;
        self.is(CONTROLLER) && self.details[1] & states != 0
    }

    /// Whether the controller itself lost received frames.
    pub fn is_receive_overflow(&self) -> bool {
        self.is(CONTROLLER) && self.details[1] & RECEIVE_OVERFLOW != 0
    }

    /// Where in the frame it broke, where the driver says it.
    pub fn place(&self) -> Option<&'static str> {
        let place = PLACES.iter().find(|(code, _)| self.is(PROTOCOL) && *code == self.details[3]);
        place.map(|(_, name)| *name)
    }

    /// At which bit of the arbitration we lost to another sender, where the driver says it.
    pub fn arbitration_bit(&self) -> Option<u8> {
        (self.is(LOST_ARBITRATION) && self.details[0] > 0).then_some(self.details[0])
    }

    /// What the transceiver says of the wires.
    pub fn wires(&self) -> impl Iterator<Item = &'static str> {
        let wires = self.details[4];
        let said = self.is(TRANSCEIVER);
        let fits = move |&&(mask, code, _): &&(u8, u8, &str)| said && wires & mask == code;
        WIRES.iter().filter(fits).map(|(_, _, fault)| *fault)
    }

    /// Whether the transceiver reports a fault of the wires.
    pub fn is_transceiver_fault(&self) -> bool {
        self.is(TRANSCEIVER)
    }

    /// The controller's transmit and receive error counters, 0–255, where the report has them.
    pub fn counters(&self) -> Option<(u8, u8)> {
        // Kernels before 6.0 fill them in with the state, and have no class bit for it.
        let counters = (self.details[6], self.details[7]);
        let there = self.is(COUNTERS) || self.is(CONTROLLER) && counters != (0, 0);
        there.then_some(counters)
    }

    fn is(&self, class: u32) -> bool {
        self.class & class != 0
    }
}

/// All that it says, in words.
impl fmt::Display for ErrorReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const CLASSES: [(u32, &str); 9] = [
            (TRANSMISSION_TIMEOUT, "transmission timed out"),
            (LOST_ARBITRATION, "arbitration lost"),
            (CONTROLLER, "controller"),
            (PROTOCOL, "protocol violation"),
            (TRANSCEIVER, "transceiver"),
            (NO_ACKNOWLEDGE, "no ACK"),
            (BUS_OFF, "bus-off"),
            (BUS_ERROR, "bus error"),
            (RESTARTED, "controller restarted"),
        ];
        const STATES: [(u8, &str); 7] = [
            (RECEIVE_OVERFLOW, "receive overflow"),
            (TRANSMIT_OVERFLOW, "transmit overflow"),
            (RECEIVE_WARNING, "receive warning"),
            (TRANSMIT_WARNING, "transmit warning"),
            (RECEIVE_PASSIVE, "receive passive"),
            (TRANSMIT_PASSIVE, "transmit passive"),
            (ACTIVE, "active again"),
        ];
        const VIOLATIONS: [(u8, &str); 7] = [
            (BIT, "bit"),
            (FORM, "form"),
            (STUFF, "stuff"),
            (BIT_0, "bit 0"),
            (BIT_1, "bit 1"),
            (OVERLOAD, "overload"),
            (WHILE_SENDING, "while transmitting"),
        ];
        let classes = CLASSES.iter().filter(|(bit, _)| self.is(*bit)).map(|(_, word)| *word);
        let states =
            STATES.iter().filter(|(bit, _)| self.is(CONTROLLER) && self.details[1] & bit != 0);
        let violations =
            VIOLATIONS.iter().filter(|(bit, _)| self.is(PROTOCOL) && self.details[2] & bit != 0);
        let details = states.chain(violations).map(|(_, word)| *word);
        let mut between = "";
        for word in classes.chain(details).chain(self.wires()) {
            write!(f, "{between}{word}")?;
            between = ", ";
        }
        if let Some(place) = self.place() {
            write!(f, "{between}in the {place}")?;
            between = ", ";
        }
        if let Some(bit) = self.arbitration_bit() {
            write!(f, "{between}at bit {bit}")?;
            between = ", ";
        }
        if let Some((transmit, receive)) = self.counters() {
            write!(f, "{between}error counters tx {transmit}, rx {receive}")?;
            between = ", ";
        }
        if between.is_empty() { f.write_str("error frame") } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(class: u32, details: [u8; 8]) -> ErrorReport {
        ErrorReport::of(&Frame::error(class, &details)).unwrap()
    }

    #[test]
    fn broken_frames_are_told_from_what_only_looks_like_them() {
        let broken = |class, details| report(class, details).is_broken_frame();
        assert!(broken(PROTOCOL | BUS_ERROR, [0, 0, STUFF, 0, 0, 0, 0, 0]));
        assert!(broken(BUS_ERROR, [0; 8]));
        assert!(!broken(NO_ACKNOWLEDGE | BUS_ERROR, [0, 0, 0, ACKNOWLEDGE_SLOT, 0, 0, 0, 0]));
        assert!(!broken(PROTOCOL, [0, 0, BIT, ACKNOWLEDGE_SLOT, 0, 0, 0, 0]));
        assert!(!broken(PROTOCOL | BUS_ERROR, [0, 0, OVERLOAD, 0, 0, 0, 0, 0]));
        assert!(!broken(LOST_ARBITRATION, [5, 0, 0, 0, 0, 0, 0, 0]));
        assert!(!broken(CONTROLLER, [0, RECEIVE_WARNING, 0, 0, 0, 0, 0, 96]));
    }

    #[test]
    fn all_that_a_report_says_is_in_its_words() {
        for (class, details, words) in [
            (
                PROTOCOL | BUS_ERROR | COUNTERS,
                [0, 0, STUFF | WHILE_SENDING, 0x0A, 0, 0, 8, 0],
                "protocol violation, bus error, stuff, while transmitting, in the data, error \
                 counters tx 8, rx 0",
            ),
            (LOST_ARBITRATION, [12, 0, 0, 0, 0, 0, 0, 0], "arbitration lost, at bit 12"),
            (LOST_ARBITRATION, [0; 8], "arbitration lost"),
            (
                TRANSCEIVER,
                [0, 0, 0, 0, 0x74, 0, 0, 0],
                "transceiver, CANH not connected, CANL shorted to ground",
            ),
            (
                BUS_OFF | COUNTERS,
                [0, 0, 0, 0, 0, 0, 255, 3],
                "bus-off, error counters tx 255, rx 3",
            ),
            (RESTARTED, [0; 8], "controller restarted"),
            (NO_ACKNOWLEDGE | BUS_ERROR, [0; 8], "no ACK, bus error"),
            (0, [0; 8], "error frame"),
        ] {
            assert_eq!(report(class, details).to_string(), words);
        }
    }

    #[test]
    fn counters_are_read_where_they_are() {
        assert_eq!(report(PROTOCOL, [0, 0, 0, 0, 0, 0, 1, 2]).counters(), None);
        assert_eq!(report(PROTOCOL | COUNTERS, [0; 8]).counters(), Some((0, 0)));
        assert_eq!(report(CONTROLLER, [0, 4, 0, 0, 0, 0, 0, 96]).counters(), Some((0, 96)));
        assert_eq!(ErrorReport::of(&Frame::error(COUNTERS, &[])).unwrap().counters(), Some((0, 0)));
    }
}
