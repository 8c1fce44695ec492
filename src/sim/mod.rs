//! A simulated CAN bus with devices of the platform, timed to the bit, in virtual time.
//!
//! * [`scenario`]: devices and a timetable; from TOML, built in, or built in code.
//! * [`Sim`]: the running simulation: attach a station, transmit, advance, poll.
//! * [`DeviceProgram`]: a device of the caller on this bus, firmware under test for example.
//!
//! Deterministic: the same scenario, seed and inputs give the same frames. No I/O, no clock, no
//! threads. Does not know descan: it attaches like any other station.
//!
//! Internal times are in nanoseconds, because a bit takes 200 ns at 5 Mbit/s; public ones are
//! [`Instant`]s in microseconds.

mod bus;
mod controller;
mod device;
mod format;
mod inspector;
mod reply;
pub mod scenario;
mod view;
mod world;

pub use bus::{BusErrorCause, Statistics};
pub use controller::ControllerState;
pub use device::program::{DeviceController, DeviceProgram};
pub use scenario::{
    Descriptor, DeviceAction, DeviceFraming, DeviceSpec, Fault, Faults, PeriodicMessage, Scenario,
    ScenarioError, TimetableEvent,
};
pub use view::{DeviceState, SimDeviceId, SimStation, StationStatus};
pub use world::Sim;

use crate::time::Instant;

/// Converts nanoseconds to an instant, rounded down to microseconds.
const fn instant(nanos: u64) -> Instant {
    Instant::from_micros(nanos / 1000)
}

/// Converts an instant to nanoseconds.
const fn nanos(at: Instant) -> u64 {
    at.as_micros().saturating_mul(1000)
}
