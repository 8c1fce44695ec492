//! The integration tests, in one program: one module for each subject.
//!
//! `cargo test --test it slcan` runs one module. Tests share the process: none of them changes
//! the environment, the current directory or the signal handlers. Programs of their own are
//! `no_allocation` (its own allocator) and `interrupted_saves` (starts itself under strace).

mod address_plans;
mod adversarial_logs;
mod apply_command;
mod bitrate_search;
mod builtin_scenarios;
mod bus_outages;
mod candump;
mod catalogue;
mod check;
#[path = "../checks/mod.rs"]
mod checks;
mod command_line;
mod common;
mod composer;
mod conflict_evidence;
mod conflict_logs;
mod conventions;
mod deadlines;
mod device_commands;
mod device_requests;
mod diff;
mod discovery;
mod disk_errors;
mod document;
mod document_fuzz;
mod document_properties;
mod doubled_frames;
mod editing;
mod error_frames;
mod export;
mod external_editors;
mod filter;
#[cfg(feature = "fleet")]
mod fleet;
mod fleet_screen;
mod foreign_buses;
mod frame_batches;
mod guide;
mod heartbeat_periods;
mod history;
mod indexed_log;
mod kit;
mod learning;
mod log;
mod log_command;
mod log_formats;
mod malicious_input;
mod missing_reasons;
mod pcapng;
mod pictures;
mod profile;
mod project;
mod proof;
mod prove;
mod random_buses;
mod random_input;
mod readme;
mod record_filter;
mod recording;
mod replay;
mod replay_speed;
mod scenarios;
mod schema;
mod screen;
mod screen_scenarios;
mod several_files;
mod several_logs;
mod shared_services;
mod sim;
mod simulation;
mod slcan;
mod socketcan;
mod socketcand;
mod store;
mod terminal;
mod udp;
mod undo_redo;
mod vm_bitrate_search;
mod vm_end_to_end;
mod vm_kit;
mod watch;
mod wire_vectors;
