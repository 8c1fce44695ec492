//! State of the controller of a bus, as its error frames report it: of a log, and of a bus whose port
//! does not know the state.

use crate::error_report::{ErrorReport, ReportedState};
use crate::frame::{Frame, FrameKind};
use crate::status::{BusState, BusStatus};

/// State and error counters of a controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ControllerStatus {
    /// State.
    pub state: BusState,
    /// Transmit error counter (TEC); `None` if not reported.
    pub tec: Option<u16>,
    /// Receive error counter (REC); `None` if not reported.
    pub rec: Option<u16>,
    /// How often it became bus-off.
    pub bus_offs: u64,
}

impl ControllerStatus {
    /// Notes a received frame.
    pub(super) fn note(&mut self, frame: &Frame) {
        if frame.kind != FrameKind::Error {
            // Bus-off, it receives nothing.
            if self.state == BusState::BusOff {
                self.state = BusState::Unknown;
            }
            return;
        }
        let Some(report) = ErrorReport::of(frame) else { return };
        if let Some((tec, rec)) = report.counters() {
            (self.tec, self.rec) = (Some(tec.into()), Some(rec.into()));
        }
        if self.state == BusState::BusOff && report.is_from_bus() {
            self.state = BusState::Unknown;
        }
        if let Some(state) = report.state() {
            let is_new = state == ReportedState::BusOff && self.state != BusState::BusOff;
            self.bus_offs += u64::from(is_new);
            self.state = match state {
                ReportedState::ErrorActive => BusState::ErrorActive,
                ReportedState::ErrorWarning => BusState::ErrorWarning,
                ReportedState::ErrorPassive => BusState::ErrorPassive,
                ReportedState::BusOff => BusState::BusOff,
            };
        }
    }

    /// The bus came back: state and counters are not known.
    pub(super) fn restart(&mut self) {
        *self = Self { bus_offs: self.bus_offs, ..Self::default() };
    }

    /// Returns what the port of the bus knows of the controller; else what was reported.
    pub(super) fn of_status_or(self, status: &BusStatus) -> Self {
        if status.state == BusState::Unknown && status.tec.is_none() {
            return self;
        }
        let bus_offs = status.bus_offs.max(self.bus_offs);
        Self { state: status.state, tec: status.tec, rec: status.rec, bus_offs }
    }
}
