//! Plans that give the devices of a bus other addresses, and their execution step by step.
//!
//! Input: what is known of the devices ([`PlanBus`]) and the addresses that they are to have. Output:
//! ordered steps with reasons ([`AddressPlan`]), and a state machine that demands one request after
//! the other and judges each step by what is heard ([`PlanRun`]). At every moment, live addresses are
//! unique and so are stored ones: a step goes only to an address that no other device uses or has
//! stored. Does not send, know a clock, or read files: see [`PlanRecord`] for their content.

mod known_bus;
mod planner;
mod reason;
mod record;
mod run;

pub use known_bus::{AddressSet, DeviceIdentity, KnownDevice, PlanBus};
pub use planner::{AddressGoal, AddressPlan, LeftOut, PlanOptions, PlanStep, StepEffect};
pub use reason::{LeftOutReason, StepReason};
pub use record::{
    MAX_RECORD_BYTES, PlanRecord, RecordedDevice, RecordedPlace, RecordedStep, UnsettledDevice,
};
pub use run::{PlanNews, PlanRequest, PlanRun, PlanTiming, RequestEnd, RunState, StepState};
