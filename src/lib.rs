//! descan: a terminal instrument for CAN buses that speak DES, the devices enumeration service.
//!
//! Reading order:
//!
//! * [`time`], [`frame`]: moments and CAN frames, the two values everything is made of.
//! * [`wire`]: what bytes on the bus mean.

pub mod frame;
pub mod time;
pub mod wire;
