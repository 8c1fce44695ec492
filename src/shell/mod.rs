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

pub mod config;
pub mod ending;
pub mod recorder;
pub mod recording;
pub mod rescue;
pub mod screen;
pub mod session;
pub mod speed;
pub mod store;
pub mod terminal;
mod waiting;
pub mod watch;
