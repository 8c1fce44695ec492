//! A port: the two ends of one open bus. The loop holds a [`Port`]; the bus's thread holds the
//! [`Line`] behind it.
//!
//! Knows nothing of what kind of bus it is.

use super::queue::Queue;
use super::waker::Waker;
use crate::frame::Frame;
use crate::status::Link;
use nix::poll::PollFlags;
use std::collections::VecDeque;
use std::io;
use std::os::fd::BorrowedFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Frames that may wait to be sent: far more than discovery ever has under way.
const OUTBOX_CAPACITY: usize = 256;

/// Why a frame was not taken for sending.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TransmitError {
    /// As many wait as may wait: the bus does not take them.
    #[error("send queue full")]
    Full,
    /// Opened to listen only, or a log.
    #[error("bus is listen-only")]
    ListenOnly,
}

/// An open bus. Dropping it stops its threads.
#[derive(Debug)]
pub struct Port {
    name: String,
    line: Arc<PortShared>,
    listen_only: bool,
    threads: Vec<JoinHandle<()>>,
}

impl Port {
    /// A port whose threads are yet to be started.
    pub(super) fn new(name: &str, line: Arc<PortShared>, listen_only: bool) -> Self {
        Self { name: name.to_owned(), line, listen_only, threads: Vec::new() }
    }

    /// Starts a thread that serves the line; should it panic, the status says so.
    pub(super) fn serve(
        &mut self,
        work: impl FnOnce(&Arc<PortShared>) + Send + 'static,
    ) -> io::Result<()> {
        let watch = PanicReporter { line: Arc::clone(&self.line), name: self.name.clone() };
        let name = format!("bus {}", self.name);
        self.threads.push(thread::Builder::new().name(name).spawn(move || work(&watch.line))?);
        Ok(())
    }

    /// What the user called it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Where its frames and its status arrive.
    pub fn queue(&self) -> &Queue {
        &self.line.queue
    }

    /// Ends the wait of its threads: the clock goes otherwise than they thought.
    pub fn wake(&self) {
        self.line.bell.wake();
    }

    /// Has a frame sent; never waits. What the kernel refuses later is counted in the status,
    /// and a frame that got onto the bus comes back marked as ours.
    pub fn transmit(&self, frame: &Frame) -> Result<(), TransmitError> {
        if self.listen_only {
            return Err(TransmitError::ListenOnly);
        }
        self.line.push_tx(*frame)
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        self.line.stop();
        for thread in self.threads.drain(..) {
            // Its panic has been reported in the status.
            let _ = thread.join();
        }
    }
}

/// The thread's end of a port.
#[derive(Debug)]
pub(super) struct PortShared {
    pub(super) queue: Queue,
    outbox: Mutex<VecDeque<Frame>>,
    stopped: AtomicBool,
    bell: Waker,
}

impl PortShared {
    pub(super) fn new() -> io::Result<Self> {
        Ok(Self {
            queue: Queue::new(Queue::CAPACITY),
            outbox: Mutex::default(),
            stopped: AtomicBool::new(false),
            bell: Waker::new()?,
        })
    }

    /// Whether the port was dropped: return.
    pub(super) fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
    }

    /// The next frame to send.
    pub(super) fn pop_tx(&self) -> Option<Frame> {
        self.outbox.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }

    /// Waits until there is something to read, to send or to stop for, at most `timeout`; says
    /// whether there is something to read.
    pub(super) fn wait(
        &self,
        input: Option<BorrowedFd<'_>>,
        timeout: Option<Duration>,
    ) -> io::Result<bool> {
        self.bell.wait(input, timeout)
    }

    /// The same for a stream that is also written to: waits for room as well, if `to_write`.
    pub(super) fn wait_for_stream(
        &self,
        stream: BorrowedFd<'_>,
        to_write: bool,
        timeout: Option<Duration>,
    ) -> io::Result<bool> {
        let room = if to_write { PollFlags::POLLOUT } else { PollFlags::empty() };
        self.bell.wait_for(Some((stream, PollFlags::POLLIN | room)), timeout)
    }

    /// Ends the wait that is under way, or the next one.
    pub(super) fn wake(&self) {
        self.bell.wake();
    }

    fn push_tx(&self, frame: Frame) -> Result<(), TransmitError> {
        let mut outbox = self.outbox.lock().unwrap_or_else(PoisonError::into_inner);
        if outbox.len() == OUTBOX_CAPACITY {
            return Err(TransmitError::Full);
        }
        outbox.push_back(frame);
        drop(outbox);
        self.bell.wake();
        Ok(())
    }

    fn stop(&self) {
        self.stopped.store(true, Ordering::Release);
        self.bell.wake();
    }
}

/// Says in the status that a thread panicked: frames that silently stop coming look like a
/// quiet bus.
struct PanicReporter {
    line: Arc<PortShared>,
    name: String,
}

impl Drop for PanicReporter {
    fn drop(&mut self) {
        if thread::panicking() {
            let message = format!("reader of {} stopped: this is a bug in descan", self.name);
            self.line.queue.finish(Link::Failed, message);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn port(listen_only: bool) -> Port {
        Port::new("test", Arc::new(PortShared::new().unwrap()), listen_only)
    }

    #[test]
    fn the_outbox_is_bounded_and_in_order() {
        let port = port(false);
        for id in 0..OUTBOX_CAPACITY as u32 {
            port.transmit(&Frame::classic(id, &[])).unwrap();
        }
        assert_eq!(port.transmit(&Frame::classic(0, &[])), Err(TransmitError::Full));
        let sent: Vec<_> = std::iter::from_fn(|| port.line.pop_tx()).collect();
        assert_eq!(sent.len(), OUTBOX_CAPACITY);
        assert_eq!(sent.last(), Some(&Frame::classic(OUTBOX_CAPACITY as u32 - 1, &[])));
    }

    #[test]
    fn a_listening_port_sends_nothing() {
        let port = port(true);
        assert_eq!(port.transmit(&Frame::classic(1, &[])), Err(TransmitError::ListenOnly));
        assert_eq!(port.line.pop_tx(), None);
    }

    #[test]
    fn dropping_it_ends_the_wait_of_its_thread() {
        let mut port = port(false);
        port.serve(|line| {
            while !line.is_stopped() {
                line.wait(None, None).unwrap();
            }
        })
        .unwrap();
        drop(port);
    }

    #[test]
    fn a_panic_of_its_thread_is_a_status() {
        let mut port = port(false);
        port.serve(|_| std::panic::resume_unwind(Box::new(()))).unwrap();
        for thread in port.threads.drain(..) {
            thread.join().unwrap_err();
        }
        assert_eq!(port.queue().status().link, Link::Failed);
    }
}
