//! A bus at the other end of a byte stream: a serial adapter, a server.
//!
//! One thread opens the [`Endpoint`], moves bytes between it and a [`Dialogue`], which knows what
//! they mean, and puts the frames into the queue. What is not there, breaks off or does not
//! answer is a status, and is tried again. Nothing here waits without a limit: what is to be
//! written has a bounded place to wait in, and frames that find no room there in time are counted.

use super::{Backoff, Delivery};
use crate::bus::clock::Clock;
use crate::bus::kind::{OpenError, OpenRequest};
use crate::bus::port::{Port, PortShared};
use crate::bus::tx_queue::{TxAttempt, TxQueue};
use crate::frame::Frame;
use crate::status::{BusState, BusStatus, Link};
use crate::time::Instant;
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::mpsc::{TryRecvError, channel};
use std::thread;
use std::time::{Duration, Instant as Monotonic};

/// Bytes that may wait to be written before no more frames are taken: about 20 frames.
const OUTPUT_LIMIT: usize = 512;
/// How long a frame may wait while nothing can be written.
const SEND_WITHIN: Duration = Duration::from_millis(500);
/// How long the last words may take.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(200);
/// The nap between two batches while much comes in: wake-ups cost more than bytes.
const NAP: Duration = Duration::from_millis(2);
/// What comes in less time after what came before is much.
const BUSY: Duration = Duration::from_millis(4);
/// Bytes per read.
const READ_SIZE: usize = 1 << 14;

/// Why there is no way to the bus now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::bus) struct Unavailable {
    pub link: Link,
    /// The cause and the way out, on one line.
    pub message: String,
}

/// Where the stream comes from.
pub(in crate::bus) trait Endpoint: Send + Sync + 'static {
    type Stream: Read + Write + AsFd + Send + 'static;

    /// Opens it, without blocking reads and writes. May take long: it has a thread of its own.
    fn open(&self) -> Result<Self::Stream, Unavailable>;

    /// In what words it is told that the stream broke off, and that it is waited for.
    fn broken_off(&self) -> Unavailable;

    /// Closes the stream; whether there are bytes it did not take.
    fn close(&self, stream: Self::Stream, stuck: bool);
}

/// What is spoken over a stream: a state machine without I/O or clock. It reads and changes what
/// is in the [`Exchange`].
pub(in crate::bus) trait Protocol: Send + 'static {
    /// A stream was opened; the status still says how it was before.
    fn begin(&mut self, now: Instant, exchange: &mut ProtocolIo);

    /// Bytes came, split and joined as it happens.
    fn handle_input(&mut self, now: Instant, bytes: &[u8], exchange: &mut ProtocolIo);

    /// The first `total` bytes of what this stream was given are written.
    fn handle_written(&mut self, now: Instant, total: u64, exchange: &mut ProtocolIo);

    /// Does what is due. Afterwards the next deadline is later than `now`, or there is none, unless
    /// the stream is to be closed: otherwise the thread would never wait.
    fn handle_timeout(&mut self, now: Instant, exchange: &mut ProtocolIo);

    /// When that is.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Whether another frame may be sent.
    fn has_room(&self) -> bool;

    /// A frame is to be sent. One that cannot be is counted in the status.
    fn send(&mut self, now: Instant, frame: &Frame, exchange: &mut ProtocolIo);

    /// The last words, where there are any.
    fn end(&mut self, exchange: &mut ProtocolIo);

    /// The stream is gone; gives the number of frames that were under way.
    fn break_off(&mut self) -> u64;
}

/// What a dialogue gives and takes.
#[derive(Debug, Default)]
pub(in crate::bus) struct ProtocolIo {
    /// Frames heard, and ours that are put back, dated.
    pub frames: Vec<Frame>,
    /// How the bus is. While the link is not up, no frames are sent.
    pub status: BusStatus,
    /// Why the stream is to be closed and opened anew.
    pub broken: Option<Unavailable>,
    output: Vec<u8>,
    written: u64,
}

impl ProtocolIo {
    /// Has bytes written; gives the position of the end of them in all that was written to
    /// this stream.
    pub fn write(&mut self, bytes: &[u8]) -> u64 {
        self.output.extend_from_slice(bytes);
        self.written + self.output.len() as u64
    }

    /// The bus cannot be used, for this reason.
    pub fn disconnect(&mut self, link: Link, message: String) {
        self.broken.get_or_insert(Unavailable { link, message });
    }

    #[cfg(test)]
    pub fn take_output(&mut self) -> Vec<u8> {
        self.written += self.output.len() as u64;
        std::mem::take(&mut self.output)
    }
}

/// Opens the bus; frames and status come when they come.
pub(in crate::bus) fn open<E: Endpoint, D: Protocol>(
    request: OpenRequest,
    ends: (E, D),
    start: (BusStatus, Backoff),
) -> Result<Port, OpenError> {
    let name = request.name.clone();
    start_worker(request, ends, start).map_err(|cause| OpenError::Resources { name, cause })
}

fn start_worker<E: Endpoint, D: Protocol>(
    request: OpenRequest,
    (endpoint, dialogue): (E, D),
    (status, backoff): (BusStatus, Backoff),
) -> io::Result<Port> {
    let OpenRequest { name, index, clock, options } = request;
    let line = Arc::new(PortShared::new()?);
    line.queue.add_name(&name);
    line.queue.update_status(|told| *told = status.clone());
    let mut port = Port::new(&name, Arc::clone(&line), options.listen_only);
    let mut carrier = StreamWorker {
        delivery: Delivery::new(Arc::clone(&line), index),
        tx: TxQueue::new(Arc::clone(&line), SEND_WITHIN),
        line,
        endpoint: Arc::new(endpoint),
        dialogue,
        exchange: ProtocolIo { status, ..ProtocolIo::default() },
        clock,
        was_open: false,
    };
    port.serve(move |line| {
        if let Err(error) = carrier.run(backoff) {
            line.queue.finish(Link::Failed, format!("stopped: {error}"));
        }
    })?;
    Ok(port)
}

/// The thread's state.
struct StreamWorker<E, D> {
    line: Arc<PortShared>,
    endpoint: Arc<E>,
    dialogue: D,
    exchange: ProtocolIo,
    delivery: Delivery,
    clock: Clock,
    /// Frames to send.
    tx: TxQueue,
    /// Whether it was ever open: then its absence means that it went away.
    was_open: bool,
}

impl<E: Endpoint, D: Protocol> StreamWorker<E, D> {
    /// Serves the line until the port is dropped.
    fn run(&mut self, mut backoff: Backoff) -> io::Result<()> {
        while let Some(opened) = self.open()? {
            let away = match opened {
                Ok(stream) => {
                    let start = Monotonic::now();
                    let Some(away) = self.serve(stream)? else { return Ok(()) };
                    backoff.lasted(start.elapsed());
                    away
                }
                Err(away) if self.was_open && away.link == Link::Missing => {
                    self.endpoint.broken_off()
                }
                Err(away) => away,
            };
            self.report_unavailable(away);
            let until = Monotonic::now() + backoff.pause();
            while !self.line.is_stopped() {
                self.refuse_posted();
                let left = until.saturating_duration_since(Monotonic::now());
                if left.is_zero() {
                    break;
                }
                self.line.wait(None, Some(left))?;
            }
        }
        Ok(())
    }

    /// Opens the endpoint on a thread of its own, for it may take long; `None` where the port was
    /// dropped meanwhile.
    fn open(&mut self) -> io::Result<Option<Result<E::Stream, Unavailable>>> {
        let (sender, receiver) = channel();
        let (line, endpoint) = (Arc::clone(&self.line), Arc::clone(&self.endpoint));
        thread::Builder::new().name("bus opening".into()).spawn(move || {
            let _wake = WakeOnDrop(line);
            // Nobody may wait for it any more; then it is closed again.
            let _ = sender.send(endpoint.open());
        })?;
        while !self.line.is_stopped() {
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
                self.refuse_posted();
            }
            // The sender may be dropped just after the wake: look again now and then.
            self.line.wait(None, Some(Duration::from_secs(1)))?;
        }
        Ok(None)
    }

    /// Moves bytes until there is no way any more, and says why; `None` when the port was dropped.
    fn serve(&mut self, mut stream: E::Stream) -> io::Result<Option<Unavailable>> {
        let mut buffer = vec![0; READ_SIZE];
        let mut last_input: Option<Monotonic> = None;
        let mut last_written = Monotonic::now();
        self.exchange.output.clear();
        self.exchange.written = 0;
        self.dialogue.begin(self.clock.now(), &mut self.exchange);
        loop {
            if self.line.is_stopped() {
                self.leave(stream)?;
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
                self.dialogue.handle_written(now, total, &mut self.exchange);
            }
            if self.exchange.written > before || self.exchange.output.is_empty() {
                last_written = Monotonic::now();
            }
            if count > 0 {
                self.dialogue.handle_input(now, &buffer[..count], &mut self.exchange);
            }
            if self.dialogue.poll_timeout().is_some_and(|due| due <= now) {
                self.dialogue.handle_timeout(now, &mut self.exchange);
            }
            self.take_posted(last_written);
            self.was_open |= self.exchange.status.link == Link::Up;
            self.deliver();
            if let Some(away) = self.exchange.broken.take() {
                self.endpoint.close(stream, !self.exchange.output.is_empty());
                return Ok(Some(away));
            }
            let is_busy = count > 0 && last_input.is_some_and(|last| last.elapsed() < BUSY);
            last_input = if count > 0 { Some(Monotonic::now()) } else { last_input };
            if is_busy && self.exchange.output.is_empty() {
                self.line.wait(None, Some(NAP))?;
            } else {
                let has_output = !self.exchange.output.is_empty();
                self.line.wait_for_stream(stream.as_fd(), has_output, self.longest_wait(now))?;
            }
        }
    }

    /// Returns the longest wait of the thread, after everything due until `now` is handled.
    fn longest_wait(&self, now: Instant) -> Option<Duration> {
        let due = self.dialogue.poll_timeout();
        debug_assert!(due.is_none_or(|due| due > now), "due at {due:?}, handled until {now:?}");
        let due = self.dialogue.poll_timeout().map(|due| self.clock.until(due));
        [due, self.tx.time_left()].into_iter().flatten().min()
    }

    /// Writes what can be written.
    fn send(&mut self, stream: &mut E::Stream) -> io::Result<()> {
        while !self.exchange.output.is_empty() {
            let Some(count) = stream.write_some(&self.exchange.output)? else { break };
            self.exchange.output.drain(..count);
            self.exchange.written += count as u64;
        }
        Ok(())
    }

    /// Takes the frames that are to be sent as far as there is room; none before the bus is open.
    fn take_posted(&mut self, last_written: Monotonic) {
        if self.exchange.status.link != Link::Up {
            if self.exchange.status.link != Link::Opening {
                self.refuse_posted();
            }
            return;
        }
        let report = self.tx.transmit(|frame| {
            if self.exchange.output.len() >= OUTPUT_LIMIT || !self.dialogue.has_room() {
                return TxAttempt::NoRoom;
            }
            self.dialogue.send(self.clock.now(), frame, &mut self.exchange);
            TxAttempt::Sent
        });
        self.exchange.status.transmit_failures += report.failures;
        if report.failures > 0 && last_written.elapsed() >= SEND_WITHIN {
            self.refuse_posted();
        }
    }

    fn refuse_posted(&mut self) {
        self.exchange.status.transmit_failures += self.tx.clear();
        self.delivery.deliver_status(&self.exchange.status);
    }

    fn deliver(&mut self) {
        self.delivery.deliver(&mut self.exchange.frames, &mut self.exchange.status);
    }

    fn report_unavailable(&mut self, away: Unavailable) {
        let lost = self.dialogue.break_off();
        let status = &mut self.exchange.status;
        status.transmit_failures += lost;
        status.unconfirmed = 0;
        status.link = away.link;
        status.state = BusState::Down;
        (status.tec, status.rec) = (None, None);
        status.message = Some(away.message);
        status.note = None;
        self.refuse_posted();
    }

    fn leave(&mut self, mut stream: E::Stream) -> io::Result<()> {
        self.dialogue.end(&mut self.exchange);
        let until = Monotonic::now() + CLOSE_TIMEOUT;
        while self.send(&mut stream).is_ok() && !self.exchange.output.is_empty() {
            let left = until.saturating_duration_since(Monotonic::now());
            if left.is_zero() {
                break;
            }
            self.line.wait_for_stream(stream.as_fd(), true, Some(left))?;
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

/// Reading and writing without waiting: `None` where one would have to wait.
trait NonBlocking {
    fn read_some(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>>;
    fn write_some(&mut self, bytes: &[u8]) -> io::Result<Option<usize>>;
}

impl<S: Read + Write> NonBlocking for S {
    fn read_some(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        unhurried(self.read(buffer))
    }

    fn write_some(&mut self, bytes: &[u8]) -> io::Result<Option<usize>> {
        unhurried(self.write(bytes).map(|count| if count == 0 { None } else { Some(count) }))
            .map(Option::flatten)
    }
}

fn unhurried<T>(outcome: io::Result<T>) -> io::Result<Option<T>> {
    match outcome {
        Ok(done) => Ok(Some(done)),
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
            Ok(None)
        }
        Err(error) => Err(error),
    }
}
