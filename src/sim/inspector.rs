//! Receive side of an attached station: frames, error frames and changes of its controller's state,
//! encoded as in Linux `can/error.h`.
//!
//! Does not know devices or the meaning of frames.

use super::bus::{BusErrorCause, StationIndex};
use super::controller::ControllerState;
use crate::frame::Frame;
use crate::time::Instant;
use std::collections::VecDeque;

/// Most frames that wait to be polled; further ones are dropped and counted.
const MAX_INBOX: usize = 1 << 17;

// Error classes, in the identifier.
const CAN_ERR_CRTL: u32 = 0x04;
const CAN_ERR_PROT: u32 = 0x08;
const CAN_ERR_ACK: u32 = 0x20;
const CAN_ERR_BUSOFF: u32 = 0x40;
const CAN_ERR_BUSERROR: u32 = 0x80;
const CAN_ERR_RESTARTED: u32 = 0x100;
const CAN_ERR_CNT: u32 = 0x200;
// Controller states, in byte 1.
const CAN_ERR_CRTL_RX_WARNING: u8 = 0x04;
const CAN_ERR_CRTL_TX_WARNING: u8 = 0x08;
const CAN_ERR_CRTL_RX_PASSIVE: u8 = 0x10;
const CAN_ERR_CRTL_TX_PASSIVE: u8 = 0x20;
const CAN_ERR_CRTL_ACTIVE: u8 = 0x40;
// Types of bus errors, in byte 2, and their place, in byte 3.
const CAN_ERR_PROT_BIT: u8 = 0x01;
const CAN_ERR_PROT_STUFF: u8 = 0x04;
const CAN_ERR_PROT_TX: u8 = 0x80;
const CAN_ERR_PROT_LOC_DATA: u8 = 0x0A;
const CAN_ERR_PROT_LOC_ACK: u8 = 0x19;

/// Receive side of an attached station.
pub(super) struct Inspector {
    /// Its station on the bus.
    pub station: StationIndex,
    inbox: VecDeque<Frame>,
    state: ControllerState,
    /// Frames dropped because the inbox was full.
    pub rx_overflow: u64,
    /// Frames of other stations not received, because of the scenario's `observer_loss`.
    pub rx_lost: u64,
}

impl Inspector {
    pub fn new(station: StationIndex) -> Self {
        Self {
            station,
            inbox: VecDeque::new(),
            state: ControllerState::ErrorActive,
            rx_overflow: 0,
            rx_lost: 0,
        }
    }

    pub fn poll(&mut self) -> Option<Frame> {
        self.inbox.pop_front()
    }

    pub fn push(&mut self, frame: Frame) {
        if self.inbox.len() < MAX_INBOX {
            self.inbox.push_back(frame);
        } else {
            self.rx_overflow += 1;
        }
    }

    /// Adds an error frame for a bus error, as reported to its sender (`sent`) or to a receiver.
    pub fn push_error(
        &mut self,
        at: Instant,
        error: BusErrorCause,
        sent: bool,
        counters: (u16, u16),
    ) {
        if self.state == ControllerState::BusOff {
            return;
        }
        let (tec, rec) = in_bytes(counters);
        let (class, kind, place) = match (error, sent) {
            (BusErrorCause::NoAck, true) => (CAN_ERR_ACK, 0, CAN_ERR_PROT_LOC_ACK),
            (_, true) => (CAN_ERR_PROT, CAN_ERR_PROT_TX | CAN_ERR_PROT_BIT, CAN_ERR_PROT_LOC_DATA),
            (_, false) => (CAN_ERR_PROT, CAN_ERR_PROT_STUFF, 0),
        };
        let details = [0, 0, kind, place, 0, 0, tec, rec];
        self.push(Frame::error(class | CAN_ERR_BUSERROR | CAN_ERR_CNT, &details).with_time(at));
    }

    /// Adds an error frame if the controller's state has changed.
    pub fn push_state(&mut self, at: Instant, state: ControllerState, counters: (u16, u16)) {
        let before = std::mem::replace(&mut self.state, state);
        if before == state {
            return;
        }
        let (tec, rec) = in_bytes(counters);
        let from_send = tec >= rec;
        let (class, how) = match state {
            ControllerState::Down => return,
            ControllerState::BusOff => (CAN_ERR_BUSOFF, 0),
            ControllerState::ErrorActive if before >= ControllerState::BusOff => {
                (CAN_ERR_RESTARTED, 0)
            }
            ControllerState::ErrorActive => (CAN_ERR_CRTL, CAN_ERR_CRTL_ACTIVE),
            ControllerState::ErrorWarning if from_send => (CAN_ERR_CRTL, CAN_ERR_CRTL_TX_WARNING),
            ControllerState::ErrorWarning => (CAN_ERR_CRTL, CAN_ERR_CRTL_RX_WARNING),
            ControllerState::ErrorPassive if from_send => (CAN_ERR_CRTL, CAN_ERR_CRTL_TX_PASSIVE),
            ControllerState::ErrorPassive => (CAN_ERR_CRTL, CAN_ERR_CRTL_RX_PASSIVE),
        };
        let details = [0, how, 0, 0, 0, 0, tec, rec];
        self.push(Frame::error(class | CAN_ERR_CNT, &details).with_time(at));
    }
}

fn in_bytes((tec, rec): (u16, u16)) -> (u8, u8) {
    (tec.min(255) as u8, rec.min(255) as u8)
}
