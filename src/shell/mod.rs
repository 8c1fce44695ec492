//! The edges of the program: files, the terminal, the event loop.
//!
//! ```text
//! session   app, buses and file, and what passes between them
//! recording the same of a log, by its own clock
//! recorder  what all of them hear, into a file
//! ending    signals, time, closed pipes: what ends those without a screen
//! screen    the terminal UI's loop        terminal  taking it over, giving it back
//! store     des.json on disk              watch     noticing that others changed it
//! config    the user's settings
//! ```
//!
//! Knows tokio, threads, clocks and the file system, so that nothing above has to.

pub mod bitrate_search;
pub mod config;
pub mod file_watcher;
pub mod log_input;
pub mod recorder;
pub mod recovery;
pub mod session;
pub mod stop;
pub mod store;
pub mod terminal;
pub mod tui_loop;
mod waiting;
