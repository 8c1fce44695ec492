//! A simulated CAN bus, timed to the bit, with simulated devices of the platform on it, in
//! virtual time.
//!
//! * [`scenario`]: which devices there are and what happens when; TOML, built in or in code.
//! * [`Sim`]: all of it, running: attach a station, send, advance, poll.
//!
//! One deterministic state machine: the same scenario, seed and inputs give the same run to the
//! byte. No I/O, no clock, no threads. It does not know the program that looks at it: that one
//! attaches like any other station and sees frames only.
//!
//! Inside, times are nanoseconds, because a bit is 200 of them at 5 Mbit/s; outside, they are
//! [`Instant`]s of whole microseconds.

mod bus;
mod controller;
mod device;
mod format;
mod inspector;
mod reply;
pub mod scenario;
mod view;
mod world;

pub use bus::{FrameFault, Statistics};
pub use controller::ControllerState;
pub use scenario::{
    AddressChoice, Chatter, Descriptor, DeviceAction, DeviceFraming, DeviceSpec, Fault, Faults,
    Scenario, ScenarioError, TimetableEvent,
};
pub use view::{DeviceState, SimDeviceId, SimStation, StationStatus};
pub use world::Sim;

use crate::time::Instant;

/// The whole microseconds of a time in nanoseconds.
const fn instant(nanos: u64) -> Instant {
    Instant::from_micros(nanos / 1000)
}

/// A time in nanoseconds.
const fn nanos(at: Instant) -> u64 {
    at.as_micros().saturating_mul(1000)
}
