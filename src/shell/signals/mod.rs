//! Signals of the system: the end of the program, and Ctrl-Z.
//!
//! On Windows they are the events of the console. Does not know what the program does then.

#[cfg(unix)]
mod unix;
#[cfg(windows)]
mod windows;

#[cfg(unix)]
use unix as system;
#[cfg(windows)]
use windows as system;

pub(super) use system::ScreenSignals;
pub use system::{StopSignals, let_writes_fail, stop_process};

/// A signal while the screen is shown.
pub(super) enum ScreenSignal {
    Terminate,
    Hangup,
    #[cfg_attr(windows, expect(dead_code, reason = "Windows stops no process"))]
    Stop,
}
