//! Opening files, and what the system knows of an open one: its identity and its names.
//!
//! Does not know what is in a file.

#[cfg(unix)]
mod unix;
#[cfg(windows)]
mod windows;

#[cfg(unix)]
pub use unix::*;
#[cfg(windows)]
pub use windows::*;
