//! The edges of the program: files, the terminal, the event loop.
pub mod store;
pub mod watch;
