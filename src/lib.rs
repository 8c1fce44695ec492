//! descan: a terminal instrument for CAN buses that speak DES, the devices enumeration service.
//!
//! Reading order:
//!
//! * [`time`], [`frame`]: moments and CAN frames, the two values everything is made of.
//! * [`wire`]: what bytes on the bus mean.
//! * [`bus`]: where frames come from and go.

pub mod bus;
pub mod frame;
pub mod time;
pub mod wire;
