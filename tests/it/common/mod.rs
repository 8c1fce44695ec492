//! Helpers shared by several test modules. The benches include single files of it.

pub mod access_list;
pub mod busy;
pub mod can;
pub mod frames;
pub mod harness;
pub mod hostile;
pub mod inspection;
pub mod mosquitto;
pub mod open_bus;
pub mod paced;
pub mod processor_time;
pub mod program;
pub mod pty;
pub mod python;
pub mod read_log;
pub mod scenario_files;
pub mod serial;
#[cfg(feature = "fleet")]
pub mod sites;
pub mod sweep;
pub mod watch_process;
