//! Signals of Unix.

use super::ScreenSignal;
use futures_util::future::select_all;
use nix::sys::signal::Signal as Number;
use std::io;
use tokio::signal::unix::{Signal, SignalKind, signal};

/// SIGINT, SIGTERM, and SIGHUP unless it is ignored, as under nohup. From now on these do not end the
/// program by themselves.
pub struct StopSignals(Vec<Signal>);

impl StopSignals {
    /// Receives them. Call in a runtime.
    ///
    /// # Errors
    /// No signal handler could be set up.
    pub fn new() -> io::Result<Self> {
        let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
        let wanted = if ignores_hangup() { &kinds[..2] } else { &kinds[..] };
        wanted.iter().map(|kind| signal(*kind)).collect::<io::Result<_>>().map(Self)
    }

    /// The same without SIGHUP.
    ///
    /// # Errors
    /// No signal handler could be set up.
    pub fn without_hangup() -> io::Result<Self> {
        Ok(Self(vec![signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?]))
    }

    /// Waits for the first one.
    pub async fn next(&mut self) {
        select_all(self.0.iter_mut().map(|signal| Box::pin(signal.recv()))).await;
    }
}

/// Returns true if SIGHUP is ignored, as under nohup. Known on Linux only.
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    ignored.unwrap_or(0) & 1 << (nix::libc::SIGHUP - 1) != 0
}

/// The signals while the screen is shown.
pub(in crate::shell) struct ScreenSignals {
    terminate: Signal,
    interrupt: Signal,
    hangup: Signal,
    stop: Signal,
}

impl ScreenSignals {
    /// Receives them. Call in a runtime.
    pub(in crate::shell) fn new() -> io::Result<Self> {
        Ok(Self {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
            hangup: signal(SignalKind::hangup())?,
            stop: signal(SignalKind::from_raw(nix::libc::SIGTSTP))?,
        })
    }

    /// Waits for the next one.
    pub(in crate::shell) async fn next(&mut self) -> ScreenSignal {
        tokio::select! {
            _ = self.terminate.recv() => ScreenSignal::Terminate,
            _ = self.interrupt.recv() => ScreenSignal::Terminate,
            _ = self.hangup.recv() => ScreenSignal::Hangup,
            _ = self.stop.recv() => ScreenSignal::Stop,
        }
    }
}

/// Makes a write beyond the file size limit fail, instead of ending the process. Call in a runtime.
///
/// # Errors
/// No signal handler could be set up.
pub fn let_writes_fail() -> io::Result<()> {
    signal(SignalKind::from_raw(Number::SIGXFSZ as i32)).map(drop)
}

/// Stops this process, as Ctrl-Z does, until it is continued.
///
/// # Errors
/// Those of the system.
pub fn stop_process() -> io::Result<()> {
    Ok(nix::sys::signal::raise(Number::SIGSTOP)?)
}
