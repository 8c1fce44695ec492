//! Keys and other input of the terminal, read by a thread of its own.
//!
//! When a terminal is closed while crossterm reads it, crossterm reads end of file in an endless
//! loop. In a thread that does not keep the program from ending.

use super::terminal::is_lost;
use super::waiting::block_on;
use crossterm::event::{Event, EventStream};
use futures_util::StreamExt;
use std::future::poll_fn;
use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver as Ended, Sender as End, channel as end_channel};
use std::task::Poll;
use std::thread;
use std::time::Duration;
use tokio::sync::Notify;
use tokio::sync::mpsc::{Receiver, Sender, channel};

/// Most events that wait; the rest waits in the terminal. Bounds the memory for a pasted text.
const MAX_EVENTS: usize = 64;
/// Longest wait for the thread to end. It ends at once, unless the terminal was closed.
const END_WAIT: Duration = Duration::from_secs(1);

/// Input of the terminal. Its thread ends with it, so that something else can read the terminal.
#[derive(Debug)]
pub(super) struct TerminalInput {
    events: Receiver<io::Result<Event>>,
    stop: Arc<Notify>,
    ended: Ended<()>,
}

impl TerminalInput {
    /// Starts to read.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub(super) fn start() -> io::Result<Self> {
        let (sender, events) = channel(MAX_EVENTS);
        let (end, ended) = end_channel();
        let stop = Arc::new(Notify::new());
        let stopped = Arc::clone(&stop);
        let runtime = tokio::runtime::Builder::new_current_thread().build()?;
        let read = move || read_until_stopped(&runtime, &sender, &stopped, end);
        thread::Builder::new().name("keys".into()).spawn(read)?;
        Ok(Self { events, stop, ended })
    }

    /// Returns the next event; `None` once the terminal is closed.
    pub(super) async fn next(&mut self) -> Option<io::Result<Event>> {
        self.events.recv().await
    }
}

impl Drop for TerminalInput {
    fn drop(&mut self) {
        self.stop.notify_one();
        if !is_lost() {
            // An error means that the thread has ended.
            let _ = self.ended.recv_timeout(END_WAIT);
        }
    }
}

/// Sends the events until it is stopped, or the terminal is closed. `_end` is dropped at the end.
fn read_until_stopped(
    runtime: &tokio::runtime::Runtime,
    sender: &Sender<io::Result<Event>>,
    stop: &Notify,
    _end: End<()>,
) {
    block_on(runtime, async {
        let mut stream = EventStream::new();
        loop {
            tokio::select! {
                biased;
                () = stop.notified() => return,
                sent = send_next(&mut stream, sender) => if !sent {
                    return;
                },
            }
        }
    });
}

/// Sends the next event. Returns false once the terminal is closed, or [`TerminalInput`] is dropped.
async fn send_next(stream: &mut EventStream, sender: &Sender<io::Result<Event>>) -> bool {
    // An event that was taken is not lost when this is stopped.
    let Ok(permit) = sender.reserve().await else { return false };
    let event =
        poll_fn(
            |context| {
                if is_lost() { Poll::Ready(None) } else { stream.poll_next_unpin(context) }
            },
        );
    match event.await {
        Some(event) => {
            permit.send(event);
            true
        }
        None => false,
    }
}
