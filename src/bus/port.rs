//! Port: the two ends of one open bus. The session holds a [`Port`], the bus's threads hold the
//! [`PortShared`] behind it. Does not know kinds of bus.

use super::queue::Queue;
use super::waker::{WaitSource, Waker};
use crate::diagnostic::Diagnostic;
use crate::frame::Frame;
use crate::log::FrameSource;
use crate::status::Link;
use std::collections::VecDeque;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Frames that may wait to be sent: more than discovery has under way at a time.
const OUTBOX_CAPACITY: usize = 256;

/// Why a frame was not taken for sending.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TransmitError {
    /// 256 frames wait already: the bus does not accept them fast enough.
    #[error("send queue full")]
    Full,
    /// The bus was opened listen-only, or is a log.
    #[error("bus is listen-only")]
    ListenOnly,
}

/// An open bus. Dropping it stops its threads and waits for them.
#[derive(Debug)]
pub struct Port {
    name: String,
    shared: Arc<PortShared>,
    listen_only: bool,
    threads: Vec<JoinHandle<()>>,
    frames: Option<Box<dyn FrameSource>>,
}

impl Port {
    /// A port without threads.
    pub(super) fn new(name: &str, shared: Arc<PortShared>, listen_only: bool) -> Self {
        let name = name.to_owned();
        Self { name, shared, listen_only, threads: Vec::new(), frames: None }
    }

    /// A port whose frames a test pushes into its queue.
    #[cfg(test)]
    pub(crate) fn for_test(name: &str) -> Self {
        Self::new(name, Arc::new(PortShared::new().expect("a pipe")), true)
    }

    /// Starts a thread of the bus. If it panics, the link becomes [`Link::Failed`].
    ///
    /// # Errors
    ///
    /// The system has no thread left.
    pub(super) fn serve(
        &mut self,
        work: impl FnOnce(&Arc<PortShared>) + Send + 'static,
    ) -> io::Result<()> {
        let watch = PanicReporter { shared: Arc::clone(&self.shared), name: self.name.clone() };
        let name = format!("bus {}", self.name);
        self.threads.push(thread::Builder::new().name(name).spawn(move || work(&watch.shared))?);
        Ok(())
    }

    /// Sets the log from which its frames can be read again.
    pub(super) fn set_frame_source(&mut self, frames: Box<dyn FrameSource>) {
        self.frames = Some(frames);
    }

    /// Returns the log from which its frames can be read again, once.
    pub fn take_frame_source(&mut self) -> Option<Box<dyn FrameSource>> {
        self.frames.take()
    }

    /// The BUS argument it was opened with.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The receive queue, with frames and status.
    pub fn queue(&self) -> &Queue {
        &self.shared.queue
    }

    /// Ends the wait of its threads, after the clock was paused, resumed or changed its speed.
    pub fn wake(&self) {
        self.shared.waker.wake();
    }

    /// Allows the threads to collect frames for longer while no response is awaited: what is due must
    /// then wait for [`Queue::complete_until`].
    pub fn allow_collecting(&self) {
        self.shared.may_collect.store(true, Ordering::Release);
    }

    /// Makes the threads deliver frames promptly for a while: a response is awaited, on this bus or
    /// another.
    pub fn expect_response(&self) {
        self.shared.expect_response();
    }

    /// Queues a frame to be sent; never blocks. A frame that is rejected later is counted in
    /// [`BusStatus::transmit_failures`](crate::status::BusStatus::transmit_failures); one that was
    /// on the bus is received back with `is_tx`.
    ///
    /// # Errors
    ///
    /// The queue is full, or the port is listen-only.
    pub fn transmit(&self, frame: &Frame) -> Result<(), TransmitError> {
        if self.listen_only {
            return Err(TransmitError::ListenOnly);
        }
        self.shared.push_tx(*frame)
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        self.shared.stop();
        for thread in self.threads.drain(..) {
            // Its panic is in the status.
            let _ = thread.join();
        }
    }
}

/// The threads' end of a port.
#[derive(Debug)]
pub(super) struct PortShared {
    pub(super) queue: Queue,
    outbox: Mutex<VecDeque<Frame>>,
    stopped: AtomicBool,
    /// See [`Port::allow_collecting`].
    may_collect: AtomicBool,
    /// A response is awaited since the thread last asked.
    expects_response: AtomicBool,
    waker: Waker,
}

impl PortShared {
    pub(super) fn new() -> io::Result<Self> {
        Ok(Self {
            queue: Queue::new(Queue::CAPACITY),
            outbox: Mutex::default(),
            stopped: AtomicBool::new(false),
            may_collect: AtomicBool::new(false),
            expects_response: AtomicBool::new(false),
            waker: Waker::new()?,
        })
    }

    /// Returns true if the port was dropped: the thread must return.
    pub(super) fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
    }

    /// Returns true if frames may be collected for longer while no response is awaited.
    #[cfg_attr(not(target_os = "linux"), expect(dead_code, reason = "only SocketCAN collects"))]
    pub(super) fn may_collect(&self) -> bool {
        self.may_collect.load(Ordering::Acquire)
    }

    /// Returns true once after a frame was queued, or a response is awaited of another bus.
    #[cfg_attr(not(target_os = "linux"), expect(dead_code, reason = "only SocketCAN collects"))]
    pub(super) fn take_expects_response(&self) -> bool {
        self.expects_response.swap(false, Ordering::AcqRel)
    }

    fn expect_response(&self) {
        self.expects_response.store(true, Ordering::Release);
        self.waker.wake();
    }

    /// Takes the next frame to send.
    pub(super) fn pop_tx(&self) -> Option<Frame> {
        self.outbox.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }

    /// Waits for input, a frame to send, or the end of the port, at most `timeout`. Returns true if
    /// there is input.
    pub(super) fn wait(
        &self,
        input: Option<WaitSource<'_>>,
        timeout: Option<Duration>,
    ) -> io::Result<bool> {
        self.waker.wait(input, timeout)
    }

    /// The same for a stream; waits for room to write as well, if `to_write`.
    pub(super) fn wait_for_stream(
        &self,
        stream: WaitSource<'_>,
        to_write: bool,
        timeout: Option<Duration>,
    ) -> io::Result<bool> {
        self.waker.wait_for_stream(stream, to_write, timeout)
    }

    /// Ends the wait that is under way, or the next one.
    pub(super) fn wake(&self) {
        self.waker.wake();
    }

    fn push_tx(&self, frame: Frame) -> Result<(), TransmitError> {
        let mut outbox = self.outbox.lock().unwrap_or_else(PoisonError::into_inner);
        if outbox.len() == OUTBOX_CAPACITY {
            return Err(TransmitError::Full);
        }
        outbox.push_back(frame);
        drop(outbox);
        self.expect_response();
        Ok(())
    }

    fn stop(&self) {
        self.stopped.store(true, Ordering::Release);
        self.waker.wake();
    }
}

/// Reports a panic of a thread in the status. Without it, a bus without its thread looks like a
/// quiet one.
struct PanicReporter {
    shared: Arc<PortShared>,
    name: String,
}

impl Drop for PanicReporter {
    fn drop(&mut self) {
        if thread::panicking() {
            let cause = format!("reader of {} stopped: this is a bug in descan", self.name);
            self.shared.queue.finish(Link::Failed, Diagnostic::new(cause));
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
    fn outbox_is_bounded_and_in_order() {
        let port = port(false);
        for id in 0..OUTBOX_CAPACITY as u32 {
            port.transmit(&Frame::classic(id, &[])).unwrap();
        }
        assert_eq!(port.transmit(&Frame::classic(0, &[])), Err(TransmitError::Full));
        let sent: Vec<_> = std::iter::from_fn(|| port.shared.pop_tx()).collect();
        assert_eq!(sent.len(), OUTBOX_CAPACITY);
        assert_eq!(sent.last(), Some(&Frame::classic(OUTBOX_CAPACITY as u32 - 1, &[])));
    }

    #[test]
    fn listen_only_port_sends_nothing() {
        let port = port(true);
        assert_eq!(port.transmit(&Frame::classic(1, &[])), Err(TransmitError::ListenOnly));
        assert_eq!(port.shared.pop_tx(), None);
    }

    #[test]
    fn dropped_port_ends_the_wait_of_its_thread() {
        let mut port = port(false);
        port.serve(|shared| {
            while !shared.is_stopped() {
                shared.wait(None, None).unwrap();
            }
        })
        .unwrap();
        drop(port);
    }

    #[test]
    fn panic_of_a_thread_is_reported_in_the_status() {
        let mut port = port(false);
        port.serve(|_| std::panic::resume_unwind(Box::new(()))).unwrap();
        for thread in port.threads.drain(..) {
            thread.join().unwrap_err();
        }
        assert_eq!(port.queue().status().link, Link::Failed);
    }
}
