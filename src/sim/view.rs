//! What can be seen of a simulation from outside: handles, the state of stations, and how
//! devices really are.

use super::controller::ControllerState;
use crate::wire::id::Address;
use crate::wire::node::{Mode, Uid};

/// A station attached from outside: the inspector, or another tester.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SimStation(pub(super) u16);

/// A simulated device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SimDeviceId(pub(super) u16);

/// What an attached station's controller says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct StationStatus {
    /// Where it stands in fault confinement.
    pub state: ControllerState,
    /// Transmit error counter.
    pub tec: u16,
    /// Receive error counter.
    pub rec: u16,
    /// The bus's nominal bit rate in bit/s.
    pub bitrate: u32,
    /// Frames waiting to be sent.
    pub queued: usize,
    /// Frames refused because the queue was full or the station off.
    pub refused: u64,
    /// Frames of others that it missed, as the scenario's `observer_loss` has it.
    pub missed: u64,
    /// Frames dropped because nobody polled them.
    pub overflowed: u64,
}

/// How a device really is: what a test compares with what an inspector found out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DeviceState<'a> {
    /// Its label in the scenario.
    pub label: &'a str,
    /// The name it gives itself.
    pub name: &'a [u8],
    /// Its DEV_CFG_UID.
    pub uid: Uid,
    /// Its mode; `None` while it is off.
    pub mode: Option<Mode>,
    /// The address it holds.
    pub address: Option<Address>,
    /// Its services.
    pub services: &'a [Vec<Vec<u8>>],
    /// Transmit and receive error counters.
    pub counters: (u16, u16),
}
