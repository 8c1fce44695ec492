//! What ends a program that has no screen: a signal, its time, a reader that has enough.

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::future::pending;
use std::io;
use std::os::fd::AsFd;
use std::pin::Pin;
use std::sync::Arc;
use std::thread;
use std::time::Duration;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::Notify;
use tokio::time::{Sleep, sleep};

/// What ended it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// SIGINT or SIGTERM.
    Interrupted,
    /// Its time is up.
    TimeUp,
    /// Nobody reads what it says any more.
    Unread,
}

/// Waits for the ending. See the module's documentation.
pub struct Endings {
    interrupt: Signal,
    terminate: Signal,
    time: Option<Pin<Box<Sleep>>>,
    unread: Option<Arc<Notify>>,
}

impl Endings {
    /// Signals, and `time` from now where it is given. From now on signals do not end the
    /// program by themselves.
    pub fn new(time: Option<Duration>) -> io::Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            time: time.map(|time| Box::pin(sleep(time))),
            unread: None,
        })
    }

    /// Also that standard output is closed at its other end, even while nothing is written.
    #[must_use]
    pub fn or_unread(mut self) -> Self {
        let unread = Arc::new(Notify::new());
        let told = Arc::clone(&unread);
        // Without a thread it is noticed at the next line.
        let _ = thread::Builder::new().name("reader".into()).spawn(move || {
            let stdout = io::stdout();
            // Asks for nothing: what comes are errors, and hang-ups.
            let mut watched = [PollFd::new(stdout.as_fd(), PollFlags::empty())];
            while poll(&mut watched, PollTimeout::NONE) == Err(Errno::EINTR) {}
            told.notify_one();
        });
        self.unread = Some(unread);
        self
    }

    /// Waits for the first of them. May be dropped while waiting.
    pub async fn next(&mut self) -> Ending {
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
            _ = self.interrupt.recv() => Ending::Interrupted,
            _ = self.terminate.recv() => Ending::Interrupted,
            () = unread => Ending::Unread,
            () = time => Ending::TimeUp,
        }
    }
}
