//! Error frames by kind, since the start.
//!
//! Input: the error frames of one bus. Does not know which node sent a frame with an error.

use crate::error_report::{BusErrorType, ErrorReport};

/// Number of error frames of each kind; the sum is that of all error frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorKinds {
    /// Stuff errors.
    pub stuff: u64,
    /// Form errors.
    pub form: u64,
    /// Bit errors.
    pub bit: u64,
    /// CRC errors, where the driver reports them.
    pub crc: u64,
    /// Frames of this controller without an ACK.
    pub no_ack: u64,
    /// Other error frames: changes of the controller's state, bus errors without a kind.
    pub other: u64,
}

impl ErrorKinds {
    /// Counts an error frame; `None` for one that cannot be read.
    pub fn add(&mut self, report: Option<ErrorReport>) {
        let report = report.filter(|it| it.is_no_ack() || it.is_bus_error());
        let count = match report.map(|it| (it.is_no_ack(), it.bus_error_type())) {
            Some((true, _)) => &mut self.no_ack,
            Some((_, Some(BusErrorType::Stuff))) => &mut self.stuff,
            Some((_, Some(BusErrorType::Form))) => &mut self.form,
            Some((_, Some(BusErrorType::Bit))) => &mut self.bit,
            Some((_, None)) if report.is_some_and(|it| it.is_crc_error()) => &mut self.crc,
            _ => &mut self.other,
        };
        *count += 1;
    }

    /// Each kind with its word, in the order of the screen.
    pub fn words(&self) -> [(&'static str, u64); 6] {
        [
            ("stuff", self.stuff),
            ("CRC", self.crc),
            ("form", self.form),
            ("bit", self.bit),
            ("no ACK", self.no_ack),
            ("other", self.other),
        ]
    }
}
