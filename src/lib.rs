//! descan: a terminal instrument for CAN buses that speak DES, the devices enumeration service.
//!
//! Reading order:
//!
//! * [`time`], [`frame`]: moments and CAN frames, the two values everything is made of.
//! * [`wire`]: what bytes on the bus mean.
//! * [`discovery`]: the engine that finds devices and collisions on one bus.
//! * [`document`]: des.json, read, edited in place and merged.
//! * [`app`]: all state of the program; [`keymap`]: its actions and their keys.
//! * [`theme`], [`ui`]: how it is drawn.

pub mod app;
pub mod discovery;
pub mod document;
pub mod frame;
pub mod keymap;
pub mod shell;
pub mod theme;
pub mod time;
pub mod ui;
pub mod wire;
