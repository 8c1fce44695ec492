//! Events of the console of Windows.

use super::ScreenSignal;
use std::io;
use tokio::signal::windows::{CtrlBreak, CtrlC, CtrlClose, CtrlShutdown};
use tokio::signal::windows::{ctrl_break, ctrl_c, ctrl_close, ctrl_shutdown};

/// Ctrl-C, Ctrl-Break, the closed window, and the end of the system. From now on these do not end the
/// program by themselves, but Windows ends it some seconds after the last two.
pub struct StopSignals {
    interrupt: CtrlC,
    interrupt_hard: CtrlBreak,
    close: CtrlClose,
    shutdown: CtrlShutdown,
}

impl StopSignals {
    /// Receives them. Call in a runtime.
    ///
    /// # Errors
    /// No handler could be set up.
    pub fn new() -> io::Result<Self> {
        Ok(Self {
            interrupt: ctrl_c()?,
            interrupt_hard: ctrl_break()?,
            close: ctrl_close()?,
            shutdown: ctrl_shutdown()?,
        })
    }

    /// The same: a closed window ends every program.
    ///
    /// # Errors
    /// No handler could be set up.
    pub fn without_hangup() -> io::Result<Self> {
        Self::new()
    }

    /// Waits for the first one.
    pub async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.interrupt_hard.recv() => {}
            _ = self.close.recv() => {}
            _ = self.shutdown.recv() => {}
        }
    }
}

/// The events while the screen is shown.
pub(in crate::shell) struct ScreenSignals {
    events: StopSignals,
}

impl ScreenSignals {
    /// Receives them. Call in a runtime.
    pub(in crate::shell) fn new() -> io::Result<Self> {
        Ok(Self { events: StopSignals::new()? })
    }

    /// Waits for the next one; there is no Ctrl-Z.
    pub(in crate::shell) async fn next(&mut self) -> ScreenSignal {
        tokio::select! {
            _ = self.events.interrupt.recv() => ScreenSignal::Terminate,
            _ = self.events.interrupt_hard.recv() => ScreenSignal::Terminate,
            _ = self.events.close.recv() => ScreenSignal::Hangup,
            _ = self.events.shutdown.recv() => ScreenSignal::Hangup,
        }
    }
}

/// Does nothing: Windows has no file size limit.
///
/// # Errors
/// None.
pub fn let_writes_fail() -> io::Result<()> {
    Ok(())
}

/// Does nothing: Windows stops no process.
///
/// # Errors
/// None.
pub fn stop_process() -> io::Result<()> {
    Ok(())
}
