//! descan: a terminal instrument for CAN buses that speak DES, the devices enumeration service.
//!
//! Reading order:
//!
//! * [`time`], [`frame`]: moments and CAN frames, the two values everything is made of.
//! * [`error_report`]: what a controller says of errors.
//! * [`text`]: how bytes from outside are shown.
//! * [`wire`]: what bytes on the bus mean.
//! * [`finding`]: what is wrong, with its evidence; one table of all kinds.
//! * [`discovery`]: the engine that finds devices and collisions on one bus.
//! * [`log`]: log formats, candump and pcapng.
//! * [`sim`]: a simulated bus, timed to the bit, with devices on it.
//! * [`status`]: how a bus is, in plain values; [`speed`]: the search for its bit rate.
//! * [`document`]: des.json, read, edited in place and merged.
//! * [`app`]: all state of the program; [`keymap`]: its actions and their keys.
//! * [`theme`], [`ui`]: how it is drawn.
//! * [`bus`]: where frames come from and go.
//! * [`shell`]: files, watching, the terminal, the event loop.
//! * [`guide`]: the topics of `descan help` and the manual pages.
//! * [`cli`], [`commands`]: what the command line asks for, done with a screen or without.

// Print macros panic if standard output or error is closed: use `writeln!`, ignore its error.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod app;
pub mod bitrate;
pub mod bus;
pub mod cli;
pub mod commands;
pub mod discovery;
pub mod document;
pub mod error_report;
pub mod finding;
pub mod frame;
pub mod guide;
pub mod keymap;
pub mod log;
pub mod shell;
pub mod sim;
pub mod status;
pub mod text;
pub mod theme;
pub mod time;
pub mod ui;
pub mod wire;
