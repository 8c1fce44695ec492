//! descan: a terminal instrument for CAN buses that speak DES, the devices enumeration service.
//!
//! Reading order:
//!
//! * [`time`], [`frame`]: moments and CAN frames, the two values everything is made of.
//! * [`wire`]: what bytes on the bus mean.
//! * [`discovery`]: the engine that finds devices and collisions on one bus.

pub mod discovery;
pub mod frame;
pub mod time;
pub mod wire;
