//! Error reports of a controller, decoded from error frames (`linux/can/error.h`): class bits in
//! the identifier, details in eight bytes. Does not know which node sent the frame with the error:
//! a report does not contain it.

use crate::frame::error_bits::{
    ACKNOWLEDGE_DELIMITER, ACKNOWLEDGE_SLOT, ACTIVE, BIT, BIT_0, BIT_1, BUS_ERROR, BUS_OFF,
    CONTROLLER, COUNTERS, CRC_SEQUENCE, FORM, LOST_ARBITRATION, NO_ACKNOWLEDGE, OVERLOAD, PROTOCOL,
    RECEIVE_OVERFLOW, RECEIVE_PASSIVE, RECEIVE_WARNING, RESTARTED, STUFF, TRANSCEIVER,
    TRANSMISSION_TIMEOUT, TRANSMIT_OVERFLOW, TRANSMIT_PASSIVE, TRANSMIT_WARNING, WHILE_SENDING,
};
use crate::frame::{CanId, Frame, FrameKind};
use std::fmt;

/// Places in the frame, in byte 3, in order of transmission.
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
    (CRC_SEQUENCE, "CRC"),
    (0x18, "CRC delimiter"),
    (ACKNOWLEDGE_SLOT, "acknowledge slot"),
    (ACKNOWLEDGE_DELIMITER, "acknowledge delimiter"),
    (0x1A, "end of frame"),
    (0x12, "intermission"),
];

/// Wiring faults, in byte 4: CANH in the low digit, CANL in the high one.
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

/// A decoded error frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorReport {
    class: u32,
    details: [u8; 8],
    /// It has all eight bytes: socketcand passes none on.
    has_details: bool,
}

/// Type of a bus error (ISO 11898-1). Linux does not report CRC errors; ACK errors are counted
/// separately ([`ErrorReport::is_no_ack`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BusErrorType {
    /// Bit error: a bit read back differs from the bit sent. Another node sent at the same time, or
    /// the bus is disturbed.
    Bit,
    /// Stuff error: more than five equal bits. An error flag, another bit rate, or a disturbance.
    Stuff,
    /// Form error: a fixed bit has the wrong value.
    Form,
}

/// State of a controller (ISO 11898-1), as a report says it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReportedState {
    /// TEC and REC below 96.
    ErrorActive,
    /// TEC or REC 96 or more.
    ErrorWarning,
    /// TEC or REC 128 or more.
    ErrorPassive,
    /// TEC above 255: it neither sends nor receives.
    BusOff,
}

impl ReportedState {
    /// All states, the worst last.
    pub const ALL: [Self; 4] =
        [Self::ErrorActive, Self::ErrorWarning, Self::ErrorPassive, Self::BusOff];
}

impl ErrorReport {
    /// Decodes an error frame; `None` for other frames.
    pub fn of(frame: &Frame) -> Option<Self> {
        let (FrameKind::Error, CanId::Extended(class)) = (frame.kind, frame.id) else {
            return None;
        };
        let details = std::array::from_fn(|at| frame.data().get(at).copied().unwrap_or(0));
        Some(Self { class, details, has_details: frame.data().len() == 8 })
    }

    /// Returns true for a bus error in a frame of any node; false for a missing ACK, lost
    /// arbitration, an overload, or a change of the controller's state.
    pub fn is_bus_error(&self) -> bool {
        let overload = self.is(PROTOCOL) && self.details[2] & !WHILE_SENDING == OVERLOAD;
        (self.is(PROTOCOL) || self.is(BUS_ERROR)) && !self.is_no_ack() && !overload
    }

    /// Returns true if the bus error was in a frame that this controller sent. Not every driver
    /// reports it.
    pub fn is_while_sending(&self) -> bool {
        self.is(PROTOCOL) && self.details[2] & WHILE_SENDING != 0
    }

    /// Returns true if a frame that this controller sent got no ACK.
    pub fn is_no_ack(&self) -> bool {
        self.is(NO_ACKNOWLEDGE) || self.is(PROTOCOL) && self.details[3] == ACKNOWLEDGE_SLOT
    }

    /// Returns the type of a bus error; `None` if the driver does not report it.
    pub fn bus_error_type(&self) -> Option<BusErrorType> {
        if !self.is(PROTOCOL) {
            None
        } else if self.details[2] & (BIT | BIT_0 | BIT_1) != 0 {
            Some(BusErrorType::Bit)
        } else if self.details[2] & STUFF != 0 {
            Some(BusErrorType::Stuff)
        } else {
            (self.details[2] & FORM != 0).then_some(BusErrorType::Form)
        }
    }

    /// Returns true for a bus error in the CRC that has no other type: the CRC is wrong.
    pub fn is_crc_error(&self) -> bool {
        self.is(PROTOCOL) && self.details[3] == CRC_SEQUENCE && self.bus_error_type().is_none()
    }

    /// Returns true if the controller is bus-off.
    pub fn is_bus_off(&self) -> bool {
        self.is(BUS_OFF)
    }

    /// Returns true if the controller restarted after bus-off, or is error-active again.
    pub fn is_recovery(&self) -> bool {
        !self.is_bus_off()
            && (self.is(RESTARTED) || self.is(CONTROLLER) && self.details[1] & ACTIVE != 0)
    }

    /// Returns true if the controller is on the bus: it takes part in a frame, or has another state than
    /// bus-off.
    pub fn is_from_bus(&self) -> bool {
        let part = PROTOCOL | BUS_ERROR | NO_ACKNOWLEDGE | LOST_ARBITRATION;
        !self.is_bus_off() && (self.is(part) || self.state().is_some())
    }

    /// Returns the state of the controller that it reports, if any.
    pub fn state(&self) -> Option<ReportedState> {
        let has = |bits: u8| self.is(CONTROLLER) && self.details[1] & bits != 0;
        if self.is_bus_off() {
            Some(ReportedState::BusOff)
        } else if has(RECEIVE_PASSIVE | TRANSMIT_PASSIVE) {
            Some(ReportedState::ErrorPassive)
        } else if has(RECEIVE_WARNING | TRANSMIT_WARNING) {
            Some(ReportedState::ErrorWarning)
        } else {
            self.is_recovery().then_some(ReportedState::ErrorActive)
        }
    }

    /// Returns true if an error counter reached 96 (error-warning) or 128 (error-passive).
    pub fn is_error_state(&self) -> bool {
        let states = RECEIVE_WARNING | TRANSMIT_WARNING | RECEIVE_PASSIVE | TRANSMIT_PASSIVE;
        self.is(CONTROLLER) && self.details[1] & states != 0
    }

    /// Returns true if received frames were lost in the controller.
    pub fn is_receive_overflow(&self) -> bool {
        self.is(CONTROLLER) && self.details[1] & RECEIVE_OVERFLOW != 0
    }

    /// Returns the place of a bus error in the frame; `None` if the driver does not report it.
    pub fn location(&self) -> Option<&'static str> {
        let place = PLACES.iter().find(|(code, _)| self.is(PROTOCOL) && *code == self.details[3]);
        place.map(|(_, name)| *name)
    }

    /// Returns the bit at which arbitration was lost; `None` if the driver does not report it.
    pub fn arbitration_bit(&self) -> Option<u8> {
        (self.is(LOST_ARBITRATION) && self.details[0] > 0).then_some(self.details[0])
    }

    /// Yields the wiring faults that the transceiver reports.
    pub fn wires(&self) -> impl Iterator<Item = &'static str> {
        let wires = self.details[4];
        let is_reported = self.is(TRANSCEIVER);
        let fits = move |&&(mask, code, _): &&(u8, u8, &str)| is_reported && wires & mask == code;
        WIRES.iter().filter(fits).map(|(_, _, fault)| *fault)
    }

    /// Returns true if the transceiver reports a wiring fault.
    pub fn is_transceiver_fault(&self) -> bool {
        self.is(TRANSCEIVER)
    }

    /// Returns the error counters TEC and REC, 0 to 255; `None` if the report has none.
    pub fn counters(&self) -> Option<(u8, u8)> {
        // Kernels before 6.0 set them together with the state, without a class bit.
        let counters = (self.details[6], self.details[7]);
        let there = self.is(COUNTERS) || self.is(CONTROLLER) && counters != (0, 0);
        (there && self.has_details).then_some(counters)
    }

    fn is(&self, class: u32) -> bool {
        self.class & class != 0
    }
}

/// Formats all fields as text, separated by commas.
impl fmt::Display for ErrorReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const CLASSES: [(u32, &str); 9] = [
            (TRANSMISSION_TIMEOUT, "transmission timed out"),
            (LOST_ARBITRATION, "arbitration lost"),
            (CONTROLLER, "controller"),
            (PROTOCOL, "bus error"),
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
            (BIT, "bit error"),
            (FORM, "form error"),
            (STUFF, "stuff error"),
            (BIT_0, "bit error (0)"),
            (BIT_1, "bit error (1)"),
            (OVERLOAD, "overload"),
            (WHILE_SENDING, "while transmitting"),
        ];
        // The type of a bus error instead of its class.
        let has_type = self.is(PROTOCOL) && self.details[2] & !WHILE_SENDING != 0;
        let is_told = |bit: u32| match bit {
            PROTOCOL => !has_type && !self.is(BUS_ERROR),
            BUS_ERROR => !has_type,
            _ => true,
        };
        let classes = CLASSES.iter().filter(|(bit, _)| self.is(*bit) && is_told(*bit));
        let classes = classes.map(|(_, word)| *word);
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
        if let Some(place) = self.location() {
            write!(f, "{between}in the {place}")?;
            between = ", ";
        }
        if let Some(bit) = self.arbitration_bit() {
            write!(f, "{between}at bit {bit}")?;
            between = ", ";
        }
        if let Some((transmit, receive)) = self.counters() {
            write!(f, "{between}TEC {transmit}, REC {receive}")?;
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
    fn bus_errors_exclude_missing_ack_and_overload() {
        let broken = |class, details| report(class, details).is_bus_error();
        assert!(broken(PROTOCOL | BUS_ERROR, [0, 0, STUFF, 0, 0, 0, 0, 0]));
        assert!(broken(BUS_ERROR, [0; 8]));
        assert!(!broken(NO_ACKNOWLEDGE | BUS_ERROR, [0, 0, 0, ACKNOWLEDGE_SLOT, 0, 0, 0, 0]));
        assert!(!broken(PROTOCOL, [0, 0, BIT, ACKNOWLEDGE_SLOT, 0, 0, 0, 0]));
        assert!(!broken(PROTOCOL | BUS_ERROR, [0, 0, OVERLOAD, 0, 0, 0, 0, 0]));
        assert!(!broken(LOST_ARBITRATION, [5, 0, 0, 0, 0, 0, 0, 0]));
        assert!(!broken(CONTROLLER, [0, RECEIVE_WARNING, 0, 0, 0, 0, 0, 96]));
    }

    #[test]
    fn display_contains_all_fields() {
        for (class, details, words) in [
            (
                PROTOCOL | BUS_ERROR | COUNTERS,
                [0, 0, STUFF | WHILE_SENDING, 0x0A, 0, 0, 8, 0],
                "stuff error, while transmitting, in the data, TEC 8, REC 0",
            ),
            (LOST_ARBITRATION, [12, 0, 0, 0, 0, 0, 0, 0], "arbitration lost, at bit 12"),
            (LOST_ARBITRATION, [0; 8], "arbitration lost"),
            (
                TRANSCEIVER,
                [0, 0, 0, 0, 0x74, 0, 0, 0],
                "transceiver, CANH not connected, CANL shorted to ground",
            ),
            (BUS_OFF | COUNTERS, [0, 0, 0, 0, 0, 0, 255, 3], "bus-off, TEC 255, REC 3"),
            (RESTARTED, [0; 8], "controller restarted"),
            (NO_ACKNOWLEDGE | BUS_ERROR, [0; 8], "no ACK, bus error"),
            (0, [0; 8], "error frame"),
        ] {
            assert_eq!(report(class, details).to_string(), words);
        }
    }

    #[test]
    fn counters_are_read_from_every_layout() {
        assert_eq!(report(PROTOCOL, [0, 0, 0, 0, 0, 0, 1, 2]).counters(), None);
        assert_eq!(report(PROTOCOL | COUNTERS, [0; 8]).counters(), Some((0, 0)));
        assert_eq!(report(CONTROLLER, [0, 4, 0, 0, 0, 0, 0, 96]).counters(), Some((0, 96)));
        assert_eq!(ErrorReport::of(&Frame::error(COUNTERS, &[])).unwrap().counters(), None);
    }
}
