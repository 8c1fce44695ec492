//! descan: a terminal instrument for CAN buses that speak DES, the devices enumeration service.
//!
//! Reading order:
//!
//! * [`time`], [`frame`]: moments and CAN frames, the two values everything is made of.
//! * [`wire`]: what bytes on the bus mean.
//! * [`sim`]: a bit-timed bus and simulated devices, in virtual time.

pub mod frame;
pub mod sim;
pub mod time;
pub mod wire;
