//! Bus behind a byte stream: a serial adapter, a server.
//!
//! One thread opens the [`Endpoint`], moves bytes between it and a [`Protocol`], and delivers the
//! frames. An endpoint that does not exist, disconnects or does not respond is a status, and is
//! opened again after a pause. Output is bounded; frames that find no room in time are counted. Does
//! not know what the bytes mean.

use super::{Backoff, Delivery};
use crate::bus::clock::Clock;
use crate::bus::faults::cannot_open;
use crate::bus::kind::OpenRequest;
use crate::bus::port::{Port, PortShared};
use crate::bus::tx_queue::{TxAttempt, TxQueue};
use crate::bus::waker::Waitable;
use crate::diagnostic::Diagnostic;
use crate::frame::Frame;
use crate::status::{BusState, BusStatus, Link};
use crate::time::{Instant, debug_assert_later};
use std::io::{self, ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::mpsc::{TryRecvError, channel};
use std::thread;
use std::time::{Duration, Instant as Monotonic};

/// Bytes that may wait to be written, about 20 frames; with more, no frames are taken.
const OUTPUT_LIMIT: usize = 512;
/// How long a frame may wait while nothing can be written.
const SEND_TIMEOUT: Duration = Duration::from_millis(500);
/// How long writing the rest may take when the port is dropped.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(200);
/// Pause between two reads of a busy stream: wake-ups cost more than bytes.
const BATCH_DELAY: Duration = Duration::from_millis(2);
/// A stream is busy if input follows earlier input within this time.
const BUSY_GAP: Duration = Duration::from_millis(4);
/// Bytes per read.
const READ_SIZE: usize = 1 << 14;

/// Why the bus cannot be reached now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unavailable {
    /// State of the link.
    pub link: Link,
    /// Cause and remedy.
    pub fault: Diagnostic,
}

/// Opens and closes the stream.
pub(in crate::bus) trait Endpoint: Send + Sync + 'static {
    type Stream: Read + Write + Waitable + Send + 'static;

    /// Opens the stream in non-blocking mode. May take long: called on a thread of its own.
    fn open(&self) -> Result<Self::Stream, Unavailable>;

    /// The status after a disconnection.
    fn broken_off(&self) -> Unavailable;

    /// Closes the stream. `stuck`: some output was not accepted.
    fn close(&self, stream: Self::Stream, stuck: bool);
}

/// Protocol of a byte stream: a state machine without I/O or clock. Frames, status and output are in
/// the [`ProtocolIo`].
pub trait Protocol: Send + 'static {
    /// Starts on a new stream; the status is that of before.
    fn begin(&mut self, now: Instant, exchange: &mut ProtocolIo);

    /// Handles received bytes, in pieces of any size.
    fn handle_input(&mut self, now: Instant, bytes: &[u8], exchange: &mut ProtocolIo);

    /// Notes that the first `total` bytes of this stream were written.
    fn handle_written(&mut self, now: Instant, total: u64, exchange: &mut ProtocolIo);

    /// Does what is due at `now`. Afterwards the next deadline is later than `now`, or there is none,
    /// unless the stream is to be closed: otherwise the thread would never wait.
    fn handle_timeout(&mut self, now: Instant, exchange: &mut ProtocolIo);

    /// The next deadline; `None` if there is none.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Returns true if another frame may be sent.
    fn has_room(&self) -> bool;

    /// Sends a frame, or counts it in the status as not sent.
    fn send(&mut self, now: Instant, frame: &Frame, exchange: &mut ProtocolIo);

    /// Writes what the protocol requires before the stream is closed.
    fn end(&mut self, exchange: &mut ProtocolIo);

    /// Ends without a stream. Returns the number of frames in flight.
    fn break_off(&mut self) -> u64;
}

/// Input and output of a [`Protocol`].
#[derive(Debug, Default)]
pub struct ProtocolIo {
    /// Received frames and loopback of sent frames, with times.
    pub frames: Vec<Frame>,
    /// The status of the bus. Frames are sent only while the link is up.
    pub status: BusStatus,
    /// Set to close the stream and open it again.
    pub broken: Option<Unavailable>,
    output: Vec<u8>,
    written: u64,
}

impl ProtocolIo {
    /// Queues bytes to be written. Returns the position of their end in this stream.
    pub fn write(&mut self, bytes: &[u8]) -> u64 {
        self.output.extend_from_slice(bytes);
        self.written + self.output.len() as u64
    }

    /// Closes the stream, for this reason; the first reason counts.
    pub fn disconnect(&mut self, link: Link, fault: Diagnostic) {
        self.broken.get_or_insert(Unavailable { link, fault });
    }

    /// Removes and returns the bytes to be written: they count as written.
    pub fn take_output(&mut self) -> Vec<u8> {
        self.written += self.output.len() as u64;
        std::mem::take(&mut self.output)
    }
}

/// Opens the bus; the status is delivered later.
pub(in crate::bus) fn open<E: Endpoint, D: Protocol>(
    request: OpenRequest,
    ends: (E, D),
    start: (BusStatus, Backoff),
) -> Result<Port, Diagnostic> {
    let name = request.name.clone();
    start_worker(request, ends, start).map_err(|error| cannot_open(name, &error))
}

fn start_worker<E: Endpoint, D: Protocol>(
    request: OpenRequest,
    (endpoint, protocol): (E, D),
    (status, backoff): (BusStatus, Backoff),
) -> io::Result<Port> {
    let OpenRequest { name, index, clock, options } = request;
    let shared = Arc::new(PortShared::new()?);
    shared.queue.add_name(&name);
    shared.queue.update_status(|current| *current = status.clone());
    let mut port = Port::new(&name, Arc::clone(&shared), options.listen_only);
    let mut worker = StreamWorker {
        delivery: Delivery::new(Arc::clone(&shared), index),
        tx: TxQueue::new(Arc::clone(&shared), SEND_TIMEOUT),
        shared,
        endpoint: Arc::new(endpoint),
        protocol,
        exchange: ProtocolIo { status, ..ProtocolIo::default() },
        clock,
        was_open: false,
    };
    port.serve(move |shared| {
        if let Err(error) = worker.run(backoff) {
            shared.queue.finish(Link::Failed, Diagnostic::unreadable(name, &error));
        }
    })?;
    Ok(port)
}

/// State of the thread.
struct StreamWorker<E, D> {
    shared: Arc<PortShared>,
    endpoint: Arc<E>,
    protocol: D,
    exchange: ProtocolIo,
    delivery: Delivery,
    clock: Clock,
    /// Frames to send.
    tx: TxQueue,
    /// Whether it was ever open: then a missing endpoint was unplugged.
    was_open: bool,
}

impl<E: Endpoint, D: Protocol> StreamWorker<E, D> {
    /// Serves the port until it is dropped.
    fn run(&mut self, mut backoff: Backoff) -> io::Result<()> {
        while let Some(opened) = self.open()? {
            let unavailable = match opened {
                Ok(stream) => {
                    let start = Monotonic::now();
                    let Some(unavailable) = self.serve(stream)? else { return Ok(()) };
                    backoff.lasted(start.elapsed());
                    unavailable
                }
                Err(unavailable) if self.was_open && unavailable.link == Link::Missing => {
                    self.endpoint.broken_off()
                }
                Err(unavailable) => unavailable,
            };
            self.report_unavailable(unavailable);
            let until = Monotonic::now() + backoff.pause();
            while !self.shared.is_stopped() {
                self.drop_pending();
                let left = until.saturating_duration_since(Monotonic::now());
                if left.is_zero() {
                    break;
                }
                self.shared.wait(None, Some(left))?;
            }
        }
        Ok(())
    }

    /// Opens the endpoint on a thread of its own, because it may take long; `None` if the port was
    /// dropped meanwhile.
    fn open(&mut self) -> io::Result<Option<Result<E::Stream, Unavailable>>> {
        let (sender, receiver) = channel();
        let (shared, endpoint) = (Arc::clone(&self.shared), Arc::clone(&self.endpoint));
        thread::Builder::new().name("bus opening".into()).spawn(move || {
            let _wake = WakeOnDrop(shared);
            // Without a receiver the stream is closed again.
            let _ = sender.send(endpoint.open());
        })?;
        while !self.shared.is_stopped() {
            match receiver.try_recv() {
                Ok(opened) => return Ok(Some(opened)),
                Err(TryRecvError::Disconnected) => {
                    return Err(io::Error::other(
                        "opening thread stopped: this is a bug in descan",
                    ));
                }
                Err(TryRecvError::Empty) => {}
            }
            if self.exchange.status.link != Link::Opening {
                self.drop_pending();
            }
            // The sender may be dropped just after the wake: look again now and then.
            self.shared.wait(None, Some(Duration::from_secs(1)))?;
        }
        Ok(None)
    }

    /// Moves bytes until the stream ends; returns why, or `None` if the port was dropped.
    fn serve(&mut self, mut stream: E::Stream) -> io::Result<Option<Unavailable>> {
        let mut buffer = vec![0; READ_SIZE];
        let mut last_input: Option<Monotonic> = None;
        let mut last_written = Monotonic::now();
        self.exchange.output.clear();
        self.exchange.written = 0;
        self.protocol.begin(self.clock.now(), &mut self.exchange);
        loop {
            if self.shared.is_stopped() {
                self.close(stream)?;
                return Ok(None);
            }
            let before = self.exchange.written;
            let moved = self.send(&mut stream).and_then(|()| stream.read_some(&mut buffer));
            let now = self.clock.now();
            let count = match moved {
                Ok(Some(count @ 1..)) => count,
                Ok(None) => 0,
                Ok(Some(_)) | Err(_) => {
                    self.deliver();
                    return Ok(Some(self.endpoint.broken_off()));
                }
            };
            if self.exchange.written > before {
                let total = self.exchange.written;
                self.protocol.handle_written(now, total, &mut self.exchange);
            }
            if self.exchange.written > before || self.exchange.output.is_empty() {
                last_written = Monotonic::now();
            }
            if count > 0 {
                self.protocol.handle_input(now, &buffer[..count], &mut self.exchange);
            }
            if self.protocol.poll_timeout().is_some_and(|due| due <= now) {
                self.protocol.handle_timeout(now, &mut self.exchange);
            }
            self.send_pending(last_written);
            self.was_open |= self.exchange.status.link == Link::Up;
            self.deliver();
            if let Some(unavailable) = self.exchange.broken.take() {
                self.endpoint.close(stream, !self.exchange.output.is_empty());
                return Ok(Some(unavailable));
            }
            let is_busy = count > 0 && last_input.is_some_and(|last| last.elapsed() < BUSY_GAP);
            last_input = if count > 0 { Some(Monotonic::now()) } else { last_input };
            if is_busy && self.exchange.output.is_empty() {
                self.shared.wait(None, Some(BATCH_DELAY))?;
            } else {
                let has_output = !self.exchange.output.is_empty();
                self.shared.wait_for_stream(
                    stream.wait_source(),
                    has_output,
                    self.max_wait(now),
                )?;
            }
        }
    }

    /// Returns the longest wait of the thread, after everything due until `now` is handled.
    fn max_wait(&self, now: Instant) -> Option<Duration> {
        let due = self.protocol.poll_timeout();
        debug_assert_later(due, now);
        let due = due.map(|due| self.clock.until(due));
        [due, self.tx.time_left()].into_iter().flatten().min()
    }

    /// Writes what the stream accepts.
    fn send(&mut self, stream: &mut E::Stream) -> io::Result<()> {
        while !self.exchange.output.is_empty() {
            let Some(count) = stream.write_some(&self.exchange.output)? else { break };
            self.exchange.output.drain(..count);
            self.exchange.written += count as u64;
        }
        Ok(())
    }

    /// Sends pending frames as far as there is room; none before the bus is open.
    fn send_pending(&mut self, last_written: Monotonic) {
        if self.exchange.status.link != Link::Up {
            if self.exchange.status.link != Link::Opening {
                self.drop_pending();
            }
            return;
        }
        let report = self.tx.transmit(|frame| {
            if self.exchange.output.len() >= OUTPUT_LIMIT || !self.protocol.has_room() {
                return TxAttempt::NoRoom;
            }
            self.protocol.send(self.clock.now(), frame, &mut self.exchange);
            TxAttempt::Sent
        });
        self.exchange.status.transmit_failures += report.failures;
        if report.failures > 0 && last_written.elapsed() >= SEND_TIMEOUT {
            self.drop_pending();
        }
    }

    fn drop_pending(&mut self) {
        self.exchange.status.transmit_failures += self.tx.clear();
        self.delivery.deliver_status(&self.exchange.status);
    }

    fn deliver(&mut self) {
        self.delivery.deliver(&mut self.exchange.frames, &mut self.exchange.status);
    }

    fn report_unavailable(&mut self, unavailable: Unavailable) {
        let lost = self.protocol.break_off();
        let status = &mut self.exchange.status;
        status.transmit_failures += lost;
        status.unconfirmed = 0;
        status.link = unavailable.link;
        status.state = BusState::Down;
        (status.tec, status.rec) = (None, None);
        status.fault = Some(unavailable.fault);
        status.note = None;
        self.drop_pending();
    }

    fn close(&mut self, mut stream: E::Stream) -> io::Result<()> {
        self.protocol.end(&mut self.exchange);
        let until = Monotonic::now() + CLOSE_TIMEOUT;
        while self.send(&mut stream).is_ok() && !self.exchange.output.is_empty() {
            let left = until.saturating_duration_since(Monotonic::now());
            if left.is_zero() {
                break;
            }
            self.shared.wait_for_stream(stream.wait_source(), true, Some(left))?;
        }
        self.endpoint.close(stream, !self.exchange.output.is_empty());
        Ok(())
    }
}

struct WakeOnDrop(Arc<PortShared>);

impl Drop for WakeOnDrop {
    fn drop(&mut self) {
        self.0.wake();
    }
}

/// Reading and writing without blocking: `None` if it would block.
trait NonBlocking {
    fn read_some(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>>;
    fn write_some(&mut self, bytes: &[u8]) -> io::Result<Option<usize>>;
}

impl<S: Read + Write> NonBlocking for S {
    fn read_some(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        non_blocking(self.read(buffer))
    }

    fn write_some(&mut self, bytes: &[u8]) -> io::Result<Option<usize>> {
        non_blocking(self.write(bytes).map(|count| if count == 0 { None } else { Some(count) }))
            .map(Option::flatten)
    }
}

fn non_blocking<T>(outcome: io::Result<T>) -> io::Result<Option<T>> {
    match outcome {
        Ok(done) => Ok(Some(done)),
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// Runs a [`Protocol`] without a stream, for its tests.
#[cfg(test)]
pub(in crate::bus) mod bench {
    use super::{Protocol, ProtocolIo};
    use crate::time::Instant;

    /// Handles all deadlines up to `until`; after each, the next one is later, or the stream is to
    /// be closed.
    pub fn pass(protocol: &mut impl Protocol, exchange: &mut ProtocolIo, until: Instant) {
        while exchange.broken.is_none()
            && let Some(due) = protocol.poll_timeout().filter(|due| *due <= until)
        {
            protocol.handle_timeout(due, exchange);
            let next = protocol.poll_timeout();
            let is_later = next.is_none_or(|next| next > due);
            assert!(is_later || exchange.broken.is_some(), "{next:?} after {due:?}");
        }
    }
}
