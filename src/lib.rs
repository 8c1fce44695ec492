//! descan: a terminal instrument for CAN buses that speak DES, the devices enumeration service.
//!
//! Reading order:
//!
//! * [`time`], [`frame`]: moments and CAN frames, the two values everything is made of.
//! * [`text`]: how bytes from outside are shown.
//! * [`wire`]: what bytes on the bus mean.
//! * [`discovery`]: the engine that finds devices and collisions on one bus.
//! * [`document`]: des.json, read, edited in place and merged.
//! * [`shell`]: files, watching, and the user's settings.

pub mod discovery;
pub mod document;
pub mod frame;
pub mod shell;
pub mod text;
pub mod time;
pub mod wire;
