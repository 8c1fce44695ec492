//! States of a CAN controller that logs report, as error frames of SocketCAN (`linux/can/error.h`).
//!
//! A log may name the state, the error counters, or both. Does not know formats: they pass what
//! their lines and objects say.

use crate::frame::error_bits::{
    ACTIVE, BUS_OFF, CONTROLLER, COUNTERS, RECEIVE_PASSIVE, RECEIVE_WARNING, TRANSMIT_PASSIVE,
    TRANSMIT_WARNING,
};
use crate::frame::{CanId, Frame, FrameKind};

/// For sending and receiving, the bit of byte 1 that says that its error counter is at the limit.
const WARNING: [u8; 2] = [TRANSMIT_WARNING, RECEIVE_WARNING];
const PASSIVE: [u8; 2] = [TRANSMIT_PASSIVE, RECEIVE_PASSIVE];
/// Counters from which on a controller is error-warning, and error-passive (ISO 11898-1).
const WARNING_LIMIT: u8 = 96;
const PASSIVE_LIMIT: u8 = 128;

/// State of a CAN controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ReportedState {
    ErrorActive,
    ErrorWarning,
    ErrorPassive,
    BusOff,
}

impl ReportedState {
    pub const ALL: [Self; 4] =
        [Self::ErrorActive, Self::ErrorWarning, Self::ErrorPassive, Self::BusOff];
}

/// What a log says of a controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct ControllerReport {
    /// `None` where only the counters are known.
    pub state: Option<ReportedState>,
    /// Transmit error counter (TEC); 0 also where it is not known.
    pub sent: u8,
    /// Receive error counter (REC).
    pub received: u8,
}

impl ControllerReport {
    /// Returns the report that an error frame is, if it says nothing else.
    pub fn of(frame: &Frame) -> Option<Self> {
        let CanId::Extended(class) = frame.id else { return None };
        let &[_, details, _, _, _, _, sent, received] = frame.data() else { return None };
        if frame.kind != FrameKind::Error || frame.is_tx {
            return None;
        }
        let state = match (class & !COUNTERS, details) {
            (CONTROLLER, ACTIVE) => Some(ReportedState::ErrorActive),
            (CONTROLLER, bits) if bits & (WARNING[0] | WARNING[1]) != 0 => {
                Some(ReportedState::ErrorWarning)
            }
            (CONTROLLER, _) => Some(ReportedState::ErrorPassive),
            (BUS_OFF, _) => Some(ReportedState::BusOff),
            _ => None,
        };
        let report = Self { state, sent, received };
        // A frame that says more than the report holds is another one.
        report.frame().is_some_and(|it| it.same_on_wire(frame)).then_some(report)
    }

    /// Returns the error frame; `None` if neither state nor counters are known.
    pub fn frame(self) -> Option<Frame> {
        let counters = [self.sent, self.received];
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
        let class = class | if counters == [0, 0] { 0 } else { COUNTERS };
        let data = [0, details, 0, 0, 0, 0, self.sent, self.received];
        (class != 0).then(|| Frame::error(class, &data))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_report_is_found_in_its_frame() {
        for state in ReportedState::ALL.map(Some).into_iter().chain([None]) {
            for (sent, received) in [(0, 0), (96, 0), (0, 127), (128, 96), (255, 255)] {
                let report = ControllerReport { state, sent, received };
                let Some(frame) = report.frame() else {
                    assert_eq!(report, ControllerReport::default());
                    continue;
                };
                assert_eq!(ControllerReport::of(&frame), Some(report), "{frame}");
            }
        }
    }

    #[test]
    fn counter_that_reached_the_limit_is_named() {
        let report = |sent, received| ControllerReport {
            state: Some(ReportedState::ErrorPassive),
            sent,
            received,
        };
        let text = |report: ControllerReport| report.frame().unwrap().to_string();
        assert_eq!(text(report(132, 0)), "20000204#0020000000008400");
        assert_eq!(text(report(0, 128)), "20000204#0010000000000080");
        assert_eq!(text(report(0, 0)), "20000004#0030000000000000");
    }

    #[test]
    fn other_frames_are_no_reports() {
        let other = [
            Frame::error(CONTROLLER | BUS_OFF, &[0; 8]),
            Frame::error(CONTROLLER, &[0, 1, 0, 0, 0, 0, 0, 0]),
            Frame::error(BUS_OFF, &[0; 4]),
            Frame::classic(BUS_OFF, &[0; 8]),
        ];
        for frame in other {
            assert_eq!(ControllerReport::of(&frame), None, "{frame}");
        }
    }
}
