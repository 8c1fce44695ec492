//! Public view of a simulation: handles, status of stations, true state of devices.

use super::controller::ControllerState;
use crate::wire::descriptor::AddressSetting;
use crate::wire::id::Address;
use crate::wire::node::{Mode, Uid};

/// An attached station.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SimStation(pub(super) u16);

/// A simulated device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SimDeviceId(pub(super) u16);

/// Status of an attached station's controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct StationStatus {
    /// State of fault confinement.
    pub state: ControllerState,
    /// Transmit error counter.
    pub tec: u16,
    /// Receive error counter.
    pub rec: u16,
    /// Nominal bit rate of the bus, in bit/s.
    pub bitrate: u32,
    /// Frames in the transmit queue.
    pub queued: usize,
    /// Frames rejected because the queue was full or the station off.
    pub tx_rejected: u64,
    /// Frames of other stations not received, because of the scenario's `observer_loss`.
    pub rx_lost: u64,
    /// Frames dropped because they were not polled.
    pub rx_overflow: u64,
}

/// True state of a device, for comparison with the result of an observer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DeviceState<'a> {
    /// Label in the scenario.
    pub label: &'a str,
    /// Name.
    pub name: &'a [u8],
    /// UID.
    pub uid: Uid,
    /// Mode; `None` while it is off.
    pub mode: Option<Mode>,
    /// Address; `None` before the end of address resolution.
    pub address: Option<Address>,
    /// The address that it has stored.
    pub setting: AddressSetting,
    /// Services, each a list of strings.
    pub services: &'a [Vec<Vec<u8>>],
    /// Transmit and receive error counters.
    pub counters: (u16, u16),
    /// Bit rate at which it transmits, in bit/s; `None` while it is off, silent or bus-off.
    pub active_bitrate: Option<u32>,
}
