//! Waker: ends another thread's wait for input. Does not know why it wakes.
//!
//! On Unix the wait is poll(2). Windows has no such call for sockets, serial ports and pipes together:
//! there the wait ends after a few milliseconds, and the caller looks for input.

#[cfg(unix)]
mod unix;
#[cfg(windows)]
mod windows;

#[cfg(unix)]
pub(super) use unix::{WaitSource, Waker};
#[cfg(windows)]
pub(super) use windows::{WaitSource, Waker};

/// Input that a thread can wait for.
pub(super) trait Waitable {
    /// What the wait is for.
    fn wait_source(&self) -> WaitSource<'_>;
}
