//! What ends a program that has no screen: a signal, a connection that is lost, its time, a reader
//! that has enough.

use futures_util::future::select_all;
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::future::pending;
use std::io;
use std::os::fd::AsFd;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::Duration;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::Notify;
use tokio::time::{Sleep, sleep};

/// How long the end may take after a signal.
const EXIT_TIMEOUT: Duration = Duration::from_secs(2);

/// What ended it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// SIGINT or SIGTERM; SIGHUP, unless it was ignored when we began, as under nohup.
    Interrupted,
    /// Its time is up.
    TimeUp,
    /// Nobody reads what it says any more.
    Unread,
}

/// Waits for the ending. See the module's documentation.
pub struct StopWaiter {
    interrupted: Arc<Notify>,
    time: Option<Pin<Box<Sleep>>>,
    unread: Option<Arc<Notify>>,
}

impl StopWaiter {
    /// Signals, and `time` from now where it is given. From now on a signal does not end the
    /// program by itself; but where it is not over soon after one, as it writes and nobody
    /// reads, it is ended with the exit code `stuck`.
    pub fn new(time: Option<Duration>, stuck: u8) -> io::Result<Self> {
        Ok(Self {
            interrupted: interrupted(stuck)?,
            time: time.map(|time| Box::pin(sleep(time))),
            unread: None,
        })
    }

    /// Also that standard output is closed at its other end, even while nothing is written.
    #[must_use]
    pub fn or_stdout_closed(mut self) -> Self {
        self.unread = Some(output_closed());
        self
    }

    /// Waits for the first of them. May be dropped while waiting.
    pub async fn next(&mut self) -> StopReason {
        let time = async {
            match &mut self.time {
                Some(time) => time.await,
                None => pending().await,
            }
        };
        let unread = async {
            match &self.unread {
                Some(unread) => unread.notified().await,
                None => pending().await,
            }
        };
        tokio::select! {
            biased;
            () = self.interrupted.notified() => StopReason::Interrupted,
            () = unread => StopReason::Unread,
            () = time => StopReason::TimeUp,
        }
    }
}

/// Notifies once when standard output is closed at its other end.
pub(super) fn output_closed() -> Arc<Notify> {
    let unread = Arc::new(Notify::new());
    let told = Arc::clone(&unread);
    // Without a thread it is noticed at the next line.
    let _ = thread::Builder::new().name("reader".into()).spawn(move || {
        let stdout = io::stdout();
        // No events requested: poll(2) returns on errors and hang-up only.
        let mut watched = [PollFd::new(stdout.as_fd(), PollFlags::empty())];
        while poll(&mut watched, PollTimeout::NONE) == Err(Errno::EINTR) {}
        told.notify_one();
    });
    unread
}

/// Whether we were started to survive the connection, as by nohup.
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    ignored.unwrap_or(0) & 1 << (nix::libc::SIGHUP - 1) != 0
}

/// Notifies of SIGINT, SIGTERM and SIGHUP, from a thread that waits for nothing else.
fn interrupted(stuck: u8) -> io::Result<Arc<Notify>> {
    let notify = Arc::new(Notify::new());
    let told = Arc::clone(&notify);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let (ready, is_ready) = sync_channel(1);
    thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(async {
            let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
            let wanted = if ignores_hangup() { &kinds[..2] } else { &kinds[..] };
            let signals: io::Result<Vec<Signal>> =
                wanted.iter().map(|kind| signal(*kind)).collect();
            let mut signals = match signals {
                Ok(signals) => signals,
                Err(error) => return ready.send(Err(error)).unwrap_or_default(),
            };
            let _ = ready.send(Ok(()));
            select_all(signals.iter_mut().map(|signal| Box::pin(signal.recv()))).await;
            told.notify_one();
            sleep(EXIT_TIMEOUT).await;
            std::process::exit(stuck.into());
        });
    })?;
    is_ready.recv().map_err(io::Error::other)??;
    Ok(notify)
}
