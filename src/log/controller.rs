//! States of a CAN controller that logs report, as error frames of SocketCAN (`linux/can/error.h`).
//!
//! A log may name the state, the error counters, or both. Does not know formats: they pass what
//! their lines and objects say.

use super::bus_errors::is_on_bus;
use crate::error_report::{ErrorReport, ReportedState};
use crate::frame::Frame;
use crate::frame::error_bits::{
    ACTIVE, BUS_OFF, CONTROLLER, COUNTERS, RECEIVE_PASSIVE, RECEIVE_WARNING, TRANSMIT_PASSIVE,
    TRANSMIT_WARNING,
};

/// For sending and receiving, the bit of byte 1 that says that its error counter is at the limit.
const WARNING: [u8; 2] = [TRANSMIT_WARNING, RECEIVE_WARNING];
const PASSIVE: [u8; 2] = [TRANSMIT_PASSIVE, RECEIVE_PASSIVE];
/// Counters from which on a controller is error-warning, and error-passive (ISO 11898-1).
const WARNING_LIMIT: u8 = 96;
const PASSIVE_LIMIT: u8 = 128;

/// What a log says of a controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct ControllerReport {
    /// `None` where only the counters are known.
    pub state: Option<ReportedState>,
    /// Transmit and receive error counters (TEC, REC); `None` where they are not known.
    pub counters: Option<[u8; 2]>,
}

impl ControllerReport {
    /// Returns the report that an error frame is, which may say more; `None` if it says nothing of the
    /// controller, or that a frame was destroyed.
    pub fn of(frame: &Frame) -> Option<Self> {
        let report = ErrorReport::of(frame).filter(|_| !is_on_bus(frame))?;
        let state = report.state();
        let counters = report.counters().map(|(sent, received)| [sent, received]);
        (state.is_some() || counters.is_some()).then_some(Self { state, counters })
    }

    /// Returns true if the error frame says no more than this.
    pub fn is_all_of(self, frame: &Frame) -> bool {
        !frame.is_tx && self.frame().is_some_and(|it| it.same_on_wire(frame))
    }

    /// Returns the error frame; `None` if neither state nor counters are known.
    pub fn frame(self) -> Option<Frame> {
        let counters = self.counters.unwrap_or_default();
        let reached = |limit, bits: [u8; 2]| {
            let bit = |at: usize| if counters[at] >= limit { bits[at] } else { 0 };
            // Which counter it was is not known.
            Some(bit(0) | bit(1)).filter(|it| *it != 0).unwrap_or(bits[0] | bits[1])
        };
        let (class, details) = match self.state {
            Some(ReportedState::ErrorActive) => (CONTROLLER, ACTIVE),
            Some(ReportedState::ErrorWarning) => (CONTROLLER, reached(WARNING_LIMIT, WARNING)),
            Some(ReportedState::ErrorPassive) => (CONTROLLER, reached(PASSIVE_LIMIT, PASSIVE)),
            Some(ReportedState::BusOff) => (BUS_OFF, 0),
            None => (0, 0),
        };
        let class = class | if self.counters.is_some() { COUNTERS } else { 0 };
        let data = [0, details, 0, 0, 0, 0, counters[0], counters[1]];
        (class != 0).then(|| Frame::error(class, &data))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::error_bits::{BUS_ERROR, RESTARTED};

    #[test]
    fn each_report_is_found_in_its_frame() {
        for state in ReportedState::ALL.map(Some).into_iter().chain([None]) {
            for counters in [None, Some([0, 0]), Some([96, 0]), Some([0, 127]), Some([255, 255])] {
                let report = ControllerReport { state, counters };
                let Some(frame) = report.frame() else {
                    assert_eq!(report, ControllerReport::default());
                    continue;
                };
                assert_eq!(ControllerReport::of(&frame), Some(report), "{frame}");
                assert!(report.is_all_of(&frame), "{frame}");
            }
        }
    }

    #[test]
    fn counter_that_reached_the_limit_is_named() {
        let text = |counters| {
            let state = Some(ReportedState::ErrorPassive);
            ControllerReport { state, counters }.frame().unwrap().to_string()
        };
        assert_eq!(text(Some([132, 0])), "20000204#0020000000008400");
        assert_eq!(text(Some([0, 128])), "20000204#0010000000000080");
        assert_eq!(text(None), "20000004#0030000000000000");
    }

    #[test]
    fn frame_that_says_more_is_not_all_of_its_report() {
        use ReportedState as S;
        for (class, details, state) in [
            (BUS_OFF, &[0; 4][..], S::BusOff),
            (BUS_OFF, &[0, 0, 0, 0, 0, 0, 0xF8, 0], S::BusOff),
            (CONTROLLER | BUS_OFF, &[0; 8], S::BusOff),
            (CONTROLLER, &[0, TRANSMIT_WARNING, 0, 0, 0, 0, 0, 0], S::ErrorWarning),
            (CONTROLLER, &[0, RECEIVE_WARNING | TRANSMIT_PASSIVE], S::ErrorPassive),
            (RESTARTED, &[0; 8], S::ErrorActive),
        ] {
            let frame = Frame::error(class, details);
            let report = ControllerReport::of(&frame).unwrap_or_else(|| panic!("{frame}"));
            assert_eq!(report.state, Some(state), "{frame}");
            assert!(!report.is_all_of(&frame), "{frame}");
        }
    }

    #[test]
    fn other_frames_are_no_reports() {
        let other = [
            Frame::error(CONTROLLER, &[0, 1, 0, 0, 0, 0, 0, 0]),
            Frame::error(CONTROLLER | BUS_ERROR, &[0, ACTIVE]),
            Frame::classic(BUS_OFF, &[0; 8]),
        ];
        for frame in other {
            assert_eq!(ControllerReport::of(&frame), None, "{frame}");
        }
    }
}
