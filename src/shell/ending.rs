//! What ends a program that has no screen: a signal, its time, a reader that has enough.

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
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::Notify;
use tokio::time::{Sleep, sleep};

/// How long the end may take after a signal.
const PATIENCE: Duration = Duration::from_secs(2);

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
    interrupted: Arc<Notify>,
    time: Option<Pin<Box<Sleep>>>,
    unread: Option<Arc<Notify>>,
}

impl Endings {
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
            () = self.interrupted.notified() => Ending::Interrupted,
            () = unread => Ending::Unread,
            () = time => Ending::TimeUp,
        }
    }
}

/// Notifies of SIGINT and SIGTERM, from a thread that waits for nothing else.
fn interrupted(stuck: u8) -> io::Result<Arc<Notify>> {
    let notify = Arc::new(Notify::new());
    let told = Arc::clone(&notify);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let (ready, is_ready) = sync_channel(1);
    thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(async {
            let signals = signal(SignalKind::interrupt())
                .and_then(|interrupt| Ok((interrupt, signal(SignalKind::terminate())?)));
            let (mut interrupt, mut terminate) = match signals {
                Ok(signals) => signals,
                Err(error) => return ready.send(Err(error)).unwrap_or_default(),
            };
            let _ = ready.send(Ok(()));
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
            told.notify_one();
            sleep(PATIENCE).await;
            std::process::exit(stuck.into());
        });
    })?;
    is_ready.recv().map_err(io::Error::other)??;
    Ok(notify)
}
