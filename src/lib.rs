//! descan finds the devices on a CAN bus that implement DES and reports address conflicts between
//! them. The CAN platform defines 29-bit identifiers, heartbeats and addresses for the nodes of a
//! bus; DES, the devices enumeration service on top of it, lets a tool request the name and the
//! services of each device. This crate is the terminal program and the library it is made of.
//!
//! # Features
//!
//! | feature | adds | modules |
//! |---|---|---|
//! | none | decoding and encoding, without `std` or an allocator | [`time`], [`frame`], [`wire`] |
//! | `node` | the node for firmware, without them too | [`node`] |
//! | `embedded-can` | its frames from and to those of `embedded-can` | |
//! | `std` | the library: engine, des.json, simulated bus | and those up to `bitrate` below |
//! | `program` (default) | the program `descan` | all |
//!
//! # Modules in reading order
//!
//! * [`time`]: moments and durations, in microseconds. [`frame`]: CAN frames and their length on
//!   the wire.
//! * [`wire`]: meaning of the bytes: identifiers, DES messages, ISO-TP, heartbeats, the profile.
//! * [`error_report`]: error frames of a controller. [`text`]: display of untrusted bytes.
//!   [`diagnostic`]: cause and remedy of an error.
//! * [`finding`]: what is wrong, with its evidence; one table of all kinds.
//! * [`discovery`]: the engine of one bus: frames and time in; devices, findings and requests out.
//! * [`catalogue`]: types of devices, as files describe them. [`toml_error`]: mistakes in such files.
//! * [`dbc`]: messages and signals of DBC files.
//! * [`composer`]: frames by fields with names, and the answers to them.
//! * [`learning`]: values of the profile, from the frames of a bus.
//! * [`prove`]: the rules of the documents, and whether a device keeps them.
//! * [`address_plan`]: plans that give devices other addresses, and their execution.
//! * [`document`]: des.json: parse, edit in place, merge.
//! * [`inventory`]: buses and devices of one moment; differences between two.
//! * [`fleet`]: the inventories of many gateways, as they are published over MQTT.
//! * [`log`]: log formats, candump and pcapng.
//! * [`kit`]: the responder for firmware, in C, and its header with the numbers of a profile.
//! * [`node`]: the same node in Rust.
//! * [`export`]: the profile and the catalogue for Wireshark, and as a DBC file.
//! * [`sim`]: a bit-timed simulated bus with devices.
//! * [`bitrate`]: the bit rate search.
//! * [`status`]: state of a bus, in plain values.
//! * [`app`]: all state of the program, without I/O; [`keymap`]: its actions and keys.
//! * [`theme`], [`ui`]: colours; drawing.
//! * [`regular_file`]: bounded reading of files.
//! * [`project`]: the project file.
//! * [`bus`]: frames from and to interfaces, adapters, servers, logs and simulations.
//! * [`shell`]: event loop, terminal, files, signals.
//! * [`guide`]: what a user looks up: `descan help`, `descan man`.
//! * [`cli`], [`commands`]: the command line and what it runs.
//!
//! The engine and [`app`] are state machines without I/O and with the same methods: `handle_*`
//! takes an input with its time, `poll_*` returns what to do outside, `poll_timeout` when to call
//! `handle_timeout` next.
#![doc = ""]
#![doc = include_str!("glossary.md")]
// Print macros panic if standard output or error is closed: use `writeln!`, ignore its error.
#![deny(clippy::print_stdout, clippy::print_stderr)]
#![cfg_attr(not(any(feature = "std", test)), no_std)]

pub mod frame;
pub mod time;
pub mod wire;

#[cfg(feature = "node")]
pub mod node;

#[cfg(feature = "std")]
pub mod address_plan;
#[cfg(feature = "std")]
pub mod bitrate;
#[cfg(feature = "std")]
pub mod catalogue;
#[cfg(feature = "std")]
pub mod composer;
#[cfg(feature = "std")]
pub mod dbc;
#[cfg(feature = "std")]
pub mod diagnostic;
#[cfg(feature = "std")]
pub mod discovery;
#[cfg(feature = "std")]
pub mod document;
#[cfg(feature = "std")]
pub mod error_report;
#[cfg(feature = "std")]
pub mod export;
#[cfg(feature = "std")]
pub mod finding;
#[cfg(feature = "std")]
pub mod fleet;
#[cfg(feature = "std")]
pub mod inventory;
#[cfg(feature = "std")]
pub mod kit;
#[cfg(feature = "std")]
pub mod learning;
#[cfg(feature = "std")]
pub mod log;
#[cfg(feature = "std")]
pub mod positioned_read;
#[cfg(feature = "std")]
pub mod prove;
#[cfg(feature = "std")]
pub mod sim;
#[cfg(feature = "std")]
pub mod text;
#[cfg(feature = "std")]
pub mod toml_error;

#[cfg(feature = "program")]
pub mod app;
#[cfg(feature = "program")]
pub mod bus;
#[cfg(feature = "program")]
pub mod cell_text;
#[cfg(feature = "program")]
pub mod cli;
#[cfg(feature = "program")]
pub mod commands;
#[cfg(feature = "program")]
pub mod guide;
#[cfg(feature = "program")]
pub mod keymap;
#[cfg(feature = "program")]
pub mod open_file;
#[cfg(feature = "program")]
pub mod project;
#[cfg(feature = "program")]
pub mod regular_file;
#[cfg(feature = "program")]
pub mod shell;
#[cfg(feature = "program")]
pub mod status;
#[cfg(feature = "program")]
pub mod system_error;
#[cfg(feature = "program")]
pub mod theme;
#[cfg(feature = "program")]
pub mod ui;
