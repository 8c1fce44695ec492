//! Reasons to stop a program without a screen: a signal, a lost connection, its time limit, a
//! closed standard output.

use super::console::wait_until_output_closed;
use super::signals::{StopSignals, let_writes_fail};
use super::waiting::block_on;
use std::future::pending;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::Duration;
use tokio::sync::Notify;
use tokio::task::spawn_blocking;
use tokio::time::{Sleep, sleep, timeout};

/// Longest time from a signal to the exit; with [`RESTORE_TIMEOUT`] less than 1 s.
const EXIT_TIMEOUT: Duration = Duration::from_millis(900);

/// Longest wait for the terminal to be restored.
const RESTORE_TIMEOUT: Duration = Duration::from_millis(50);

/// Why a program stops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// SIGINT or SIGTERM; SIGHUP, unless it was ignored at the start, as under nohup.
    Interrupted,
    /// The time limit is reached.
    TimeUp,
    /// Standard output is closed.
    OutputClosed,
}

/// Waits for the first reason to stop. See the module's documentation.
pub struct StopWaiter {
    interrupted: Arc<Notify>,
    time: Option<Pin<Box<Sleep>>>,
    closed: Option<Arc<Notify>>,
}

impl StopWaiter {
    /// Stops on signals, and after `time`; `None` sets no limit. From now on a signal does not end
    /// the program by itself; if it has not ended 0.9 s after one, as when its output is blocked, it
    /// exits with the code `stuck`.
    ///
    /// # Errors
    /// No signal handler or thread could be set up.
    pub fn new(time: Option<Duration>, stuck: u8) -> io::Result<Self> {
        Ok(Self {
            interrupted: interrupted(stuck)?,
            time: time.map(|time| Box::pin(sleep(time))),
            closed: None,
        })
    }

    /// Stops, too, when the other end of standard output is closed, even while nothing is written.
    #[must_use]
    pub fn or_stdout_closed(mut self) -> Self {
        self.closed = Some(output_closed());
        self
    }

    /// Waits for the first reason. May be dropped while waiting.
    pub async fn next(&mut self) -> StopReason {
        let time = async {
            match &mut self.time {
                Some(time) => time.await,
                None => pending().await,
            }
        };
        let closed = async {
            match &self.closed {
                Some(closed) => closed.notified().await,
                None => pending().await,
            }
        };
        tokio::select! {
            biased;
            () = self.interrupted.notified() => StopReason::Interrupted,
            () = closed => StopReason::OutputClosed,
            () = time => StopReason::TimeUp,
        }
    }
}

/// Notifies once when the other end of standard output is closed.
pub(super) fn output_closed() -> Arc<Notify> {
    let closed = Arc::new(Notify::new());
    let notifier = Arc::clone(&closed);
    // Without a thread the next write notices it.
    let _ = thread::Builder::new().name("output".into()).spawn(move || {
        wait_until_output_closed();
        notifier.notify_one();
    });
    closed
}

/// Notifies of SIGINT, SIGTERM and SIGHUP, from a separate thread.
fn interrupted(stuck: u8) -> io::Result<Arc<Notify>> {
    let notify = Arc::new(Notify::new());
    let notifier = Arc::clone(&notify);
    on_signal(stuck, move || notifier.notify_one(), || {})?;
    Ok(notify)
}

/// Makes the program exit with the code `stuck` if it has not ended 0.9 s after a signal, as when
/// the terminal is not read. `restore` is called before that, on a separate thread, and not waited
/// for if it blocks. The signals themselves are handled elsewhere.
///
/// # Errors
/// No signal handler or thread could be set up.
pub fn exit_if_stuck(stuck: u8, restore: impl FnOnce() + Send + 'static) -> io::Result<()> {
    on_signal(stuck, || {}, restore)
}

/// Calls `notify` on the first signal, on a separate thread. If the program has not ended 0.9 s later,
/// calls `restore` and exits with the code `stuck`.
///
/// # Errors
/// No signal handler or thread could be set up.
pub fn on_signal(
    stuck: u8,
    notify: impl FnOnce() + Send + 'static,
    restore: impl FnOnce() + Send + 'static,
) -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let (ready, is_ready) = sync_channel(1);
    thread::Builder::new().name("signals".into()).spawn(move || {
        block_on(&runtime, async {
            // A write beyond the file size limit fails, instead of ending the program at once.
            let signals = let_writes_fail().and_then(|()| StopSignals::new());
            let mut signals = match signals {
                Ok(signals) => signals,
                Err(error) => return ready.send(Err(error)).unwrap_or_default(),
            };
            let _ = ready.send(Ok(()));
            signals.next().await;
            notify();
            sleep(EXIT_TIMEOUT).await;
            let restored = spawn_blocking(restore);
            let _ = timeout(RESTORE_TIMEOUT, restored).await;
            std::process::exit(stuck.into());
        });
    })?;
    is_ready.recv().map_err(io::Error::other)?
}
