//! The port, its reader and its monitor, by raw sockets and netlink.
//!
//! Two threads. The reader only moves frames, so that nothing delays it. The monitor reads the state
//! of the interface by netlink, once a second and after an event; netlink can block while another
//! interface is configured. An interface that is down, missing or unplugged is a status, and is
//! waited for.

mod controller;
mod link_info;
mod socket;

pub(in crate::bus) use controller::CanController;
pub use link_info::{interface_exists, interfaces};

use super::not_can;
use crate::bus::clock::RxTimestamps;
use crate::bus::faults::{cannot_open, unplugged};
use crate::bus::kind::OpenRequest;
use crate::bus::port::{Port, PortShared};
use crate::bus::tx_queue::{TxAttempt, TxQueue};
use crate::bus::waker::Waitable;
use crate::diagnostic::Diagnostic;
use crate::error_report::ErrorReport;
use crate::frame::{BusIndex, Frame, IdFilter};
use crate::status::{BusState, BusStatus, Link, RateSearch};
use crate::time::Instant;
use link_info::{LinkInfo, is_can, missing};
use nix::errno::Errno;
use nix::net::if_::if_nametoindex;
use socket::{RawSocket, ReceivedFrame};
use std::io;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant as Monotonic};

/// Period of reading the state of the interface, and of the attempts to open a missing one.
const REFRESH_PERIOD: Duration = Duration::from_secs(1);
/// Shortest time between two reads of the state: error frames can arrive by the thousand.
const MIN_REFRESH_INTERVAL: Duration = Duration::from_millis(100);
/// Longest delay in which frames are collected while a response is awaited: wake-ups cost more than
/// system calls. Shorter than any time that matters then: responses are collected for at least 60 ms,
/// and a heartbeat counts as missed 30 ms after its time at the earliest.
const MAX_BATCH_DELAY: Duration = Duration::from_millis(20);
/// The same while no response is awaited: less than the time between two draws of the screen. What is
/// due waits for the frames then.
const MAX_QUIET_DELAY: Duration = Duration::from_millis(100);
/// How long a response is awaited after a frame was queued: longer than any timeout of a request or a
/// transfer.
const RESPONSE_TIME: Duration = Duration::from_secs(2);
/// Interval and limit of the attempts to send a frame while the kernel's transmit queue is full. A
/// full 125 kbit/s bus sends about one frame per millisecond.
const RETRY_INTERVAL: Duration = Duration::from_millis(2);
const RETRY_TIMEOUT: Duration = Duration::from_millis(500);

/// Opens the interface; its status is known at once.
pub(in crate::bus) fn open(interface: &str, request: OpenRequest) -> Result<Port, Diagnostic> {
    let name = request.name.clone();
    start(interface, request).map_err(|error| cannot_open(name, &error))
}

fn start(name: &str, request: OpenRequest) -> io::Result<Port> {
    let OpenRequest { index, clock, options, .. } = request;
    let shared = Arc::new(PortShared::new()?);
    shared.queue.add_name(name);
    shared.queue.update_status(|status| status.filtered = !options.only.is_empty());
    let monitor =
        Arc::new(InterfaceMonitor { name: name.to_owned(), ..InterfaceMonitor::default() });
    let mut reader = SocketReader {
        shared: Arc::clone(&shared),
        monitor: Arc::clone(&monitor),
        bus: index,
        timestamps: RxTimestamps::new(clock),
        drops_before: 0,
        reported: (0, 0, 0),
        was_up: false,
        only: options.only,
        tx: TxQueue::new(Arc::clone(&shared), RETRY_TIMEOUT),
        is_full: false,
        expected: None,
    };
    let socket = reader.find();
    monitor.refresh(&shared, PendingReport::default());
    let mut port = Port::new(name, shared, options.listen_only);
    port.serve(move |shared| {
        let _release = ObserverRelease(Arc::clone(&reader.monitor));
        if let Err(error) = reader.run(socket) {
            shared.queue.finish(Link::Failed, Diagnostic::unreadable(&reader.monitor.name, &error));
        }
    })?;
    port.serve(move |shared| monitor.run(shared))?;
    Ok(port)
}

/// Shared by the two threads: the present interface, and requests to read its state.
#[derive(Debug, Default)]
struct InterfaceMonitor {
    name: String,
    /// 0: it does not exist.
    ifindex: AtomicU32,
    /// The reader is to look whether its socket still has an interface.
    is_check_due: AtomicBool,
    /// Down, as last read.
    is_down: AtomicBool,
    request: Mutex<MonitorRequest>,
    requested: Condvar,
}

#[derive(Debug, Default)]
struct MonitorRequest {
    refresh: bool,
    stop: bool,
    pending: PendingReport,
}

/// Events that the reader noticed, reported with the next state of the interface: the state itself
/// may have changed again by then.
#[derive(Debug, Default)]
struct PendingReport {
    /// The interface went down, or away.
    outage: bool,
    /// How often the controller became bus-off.
    bus_offs: u64,
}

impl InterfaceMonitor {
    fn request(&self, change: impl FnOnce(&mut MonitorRequest)) {
        change(&mut self.request.lock().unwrap_or_else(PoisonError::into_inner));
        self.requested.notify_one();
    }

    /// The monitor thread.
    fn run(&self, shared: &PortShared) {
        let mut request = self.request.lock().unwrap_or_else(PoisonError::into_inner);
        while !request.stop {
            (request, _) = self
                .requested
                .wait_timeout_while(request, REFRESH_PERIOD, |request| {
                    !request.refresh && !request.stop
                })
                .unwrap_or_else(PoisonError::into_inner);
            request.refresh = false;
            drop(request);
            self.refresh_now(shared);
            self.is_check_due.store(true, Ordering::Release);
            shared.wake();
            request = self.request.lock().unwrap_or_else(PoisonError::into_inner);
            (request, _) = self
                .requested
                .wait_timeout_while(request, MIN_REFRESH_INTERVAL, |request| !request.stop)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Reads the state at once, where the monitor may take up to a second.
    fn refresh_now(&self, shared: &PortShared) {
        let mut request = self.request.lock().unwrap_or_else(PoisonError::into_inner);
        let pending = std::mem::take(&mut request.pending);
        drop(request);
        let unreported = self.refresh(shared, pending);
        let mut request = self.request.lock().unwrap_or_else(PoisonError::into_inner);
        request.pending.outage |= unreported.outage;
        request.pending.bus_offs += unreported.bus_offs;
    }

    /// Reads the state once and writes it and the pending events into the status. Returns the events
    /// that could not be reported yet.
    fn refresh(&self, shared: &PortShared, mut pending: PendingReport) -> PendingReport {
        let ifindex = self.ifindex.load(Ordering::Acquire);
        if ifindex == 0 {
            return pending;
        }
        let Ok(facts) = LinkInfo::of(ifindex) else { return pending };
        // A renamed interface is the same bus; remedies need its present name.
        let name = facts.name.as_deref().unwrap_or(&self.name);
        let (fault, note) = (facts.fault(name), facts.note(name));
        let renamed = (name != self.name).then(|| name.to_owned());
        shared.queue.update_status(|status| {
            // The reader may have lost the interface meanwhile.
            if self.ifindex.load(Ordering::Acquire) != ifindex {
                return;
            }
            if facts.up {
                let was_down = matches!(status.link, Link::Down | Link::Unplugged);
                status.outages += u64::from(was_down || pending.outage);
                pending.outage = false;
            }
            status.bus_offs += std::mem::take(&mut pending.bus_offs);
            status.link = if facts.up { Link::Up } else { Link::Down };
            self.is_down.store(!facts.up, Ordering::Release);
            status.set_facts(&facts);
            status.renamed = renamed;
            status.fault = fault;
            status.note = note;
        });
        pending
    }
}

impl BusStatus {
    fn set_facts(&mut self, facts: &LinkInfo) {
        let facts = facts.clone();
        self.state = facts.state;
        self.bitrate = facts.bitrate;
        self.rate_search = if facts.is_virtual { RateSearch::NoRate } else { RateSearch::Possible };
        self.data_bitrate = facts.data_bitrate;
        self.tec = facts.tec;
        self.rec = facts.rec;
        self.restart_ms = facts.restart_ms;
        self.fd = facts.fd;
        self.listen_only = facts.listen_only;
    }
}

/// Stops the monitor when the reader ends, also by a panic.
struct ObserverRelease(Arc<InterfaceMonitor>);

impl Drop for ObserverRelease {
    fn drop(&mut self) {
        self.0.request(|request| request.stop = true);
    }
}

/// The reader thread.
struct SocketReader {
    shared: Arc<PortShared>,
    monitor: Arc<InterfaceMonitor>,
    bus: BusIndex,
    timestamps: RxTimestamps,
    /// Kernel drops of sockets that were closed since.
    drops_before: u64,
    /// The kernel drops and the frames in flight, as in the status.
    reported: (u64, u64, u32),
    /// Whether the interface existed before: then a missing one was unplugged.
    was_up: bool,
    /// The identifiers to receive; empty: all.
    only: Vec<IdFilter>,
    /// Frames to send.
    tx: TxQueue,
    /// Whether the status has the transmit queue as full.
    is_full: bool,
    /// When a response was last expected.
    expected: Option<Monotonic>,
}

impl SocketReader {
    /// Serves the port until it is dropped.
    fn run(&mut self, mut found: Option<RawSocket>) -> io::Result<()> {
        while !self.shared.is_stopped() {
            let Some(socket) = found.take().or_else(|| self.find()) else {
                self.drop_pending();
                self.shared.wait(None, Some(REFRESH_PERIOD))?;
                continue;
            };
            self.monitor.request(|request| request.refresh = true);
            self.serve(socket)?;
        }
        Ok(())
    }

    /// Opens the interface; if it cannot, sets the status and returns `None`.
    fn find(&mut self) -> Option<RawSocket> {
        let name = &self.monitor.name;
        let opened = match if_nametoindex(name.as_str()) {
            Ok(_) if !is_can(name) => Err((Link::NotCan, not_can(name))),
            Ok(ifindex) => match RawSocket::open(ifindex, &self.only) {
                Ok(socket) => Ok((ifindex, socket)),
                Err(error) => Err(self.unavailable(&error)),
            },
            Err(_) if self.was_up => Err((Link::Unplugged, unplugged(name))),
            Err(_) => Err((Link::Missing, missing(name))),
        };
        match opened {
            Ok((ifindex, socket)) => {
                if self.was_up {
                    // It may return before its absence was reported.
                    self.monitor.request(|request| request.pending.outage = true);
                }
                self.was_up = true;
                let buffer = socket.receive_buffer();
                self.shared.queue.update_status(|status| status.receive_buffer = buffer);
                self.monitor.ifindex.store(ifindex, Ordering::Release);
                Some(socket)
            }
            Err((link, fault)) => {
                self.shared.queue.update_status(|status| {
                    status.link = link;
                    status.set_facts(&LinkInfo { state: BusState::Down, ..LinkInfo::default() });
                    status.unconfirmed = 0;
                    status.renamed = None;
                    status.fault = Some(fault);
                });
                None
            }
        }
    }

    fn unavailable(&self, error: &io::Error) -> (Link, Diagnostic) {
        let name = &self.monitor.name;
        match errno(error) {
            Errno::ENODEV | Errno::ENXIO => (Link::Missing, missing(name)),
            Errno::EAFNOSUPPORT | Errno::EPROTONOSUPPORT => (
                Link::NoKernel,
                Diagnostic::new("kernel without CAN")
                    .with_remedy("sudo modprobe can-raw, or use another kernel"),
            ),
            _ => (Link::Down, cannot_open(name, error)),
        }
    }

    /// Moves frames until the interface is gone or the port is dropped.
    fn serve(&mut self, mut socket: RawSocket) -> io::Result<()> {
        let mut batch = Vec::new();
        let mut frames = Vec::new();
        let mut last_arrival = Instant::ZERO;
        // At most a quarter of the receive buffer may fill up during the delay.
        let room = socket.capacity() / 4;
        let mut is_counting = false;
        let mut is_removed = false;
        while !self.shared.is_stopped() {
            batch.clear();
            // The error for it can be lost: recvmmsg that has read frames puts an error back, also
            // ENETDOWN over the ENODEV that came since. Another interface may have its index by now.
            let was_removed = is_removed;
            if self.monitor.is_check_due.swap(false, Ordering::AcqRel) {
                is_removed |= !socket.is_bound();
            }
            let read = socket.read(&mut batch);
            if let Err(error) = &read {
                match errno(error) {
                    Errno::ENETDOWN => {
                        socket.forget_unconfirmed();
                        self.monitor.request(|request| {
                            request.refresh = true;
                            request.pending.outage = true;
                        });
                    }
                    Errno::ENODEV | Errno::ENXIO => is_removed = true,
                    Errno::EINTR => {}
                    _ => return read,
                }
            }
            if !std::mem::replace(&mut is_counting, true) {
                socket.start_counting();
            }
            // With an empty buffer: until the loopback of a sent frame, frames are read one by one.
            if !is_removed {
                self.send_pending(&mut socket);
            }
            self.date(&batch, &mut frames);
            // The frames' times save reading the clock.
            let newest = frames.last().map_or(last_arrival, |frame| frame.time);
            let since_last = newest.since(std::mem::replace(&mut last_arrival, newest));
            let longest = self.longest_delay();
            let batch_delay = batch_delay(since_last, frames.len() as u32, room, longest);
            let is_collecting = longest > MAX_BATCH_DELAY && batch_delay.is_some();
            self.deliver(&frames, is_collecting.then_some(newest), &socket);
            if is_removed {
                // The first error comes before the frames that wait in the receive buffer.
                if batch.is_empty() && (read.is_ok() || was_removed) {
                    break;
                }
            } else if let Some(batch_delay) = batch_delay {
                let wait = self.retry_wait().map_or(batch_delay, |wait| wait.min(batch_delay));
                self.shared.wait(None, Some(wait))?;
            } else if frames.is_empty() {
                self.shared.wait(Some(socket.wait_source()), self.retry_wait())?;
            }
        }
        self.shared.queue.set_complete();
        socket.query_drops();
        self.drops_before += socket.drops();
        self.monitor.ifindex.store(0, Ordering::Release);
        Ok(())
    }

    /// Replaces `frames` by those of the batch, with their times.
    fn date(&mut self, batch: &[ReceivedFrame], frames: &mut Vec<Frame>) {
        frames.clear();
        if !batch.is_empty() {
            self.timestamps.read_clocks();
        }
        for received in batch {
            let time = self.timestamps.date(received.stamp_micros);
            frames.push(received.frame.with_time(time).with_bus(self.bus));
        }
    }

    /// How long frames may be collected.
    fn longest_delay(&mut self) -> Duration {
        if self.shared.take_expects_response() {
            self.expected = Some(Monotonic::now());
        }
        let is_awaited = |at: Monotonic| at.elapsed() < RESPONSE_TIME;
        if self.shared.may_collect() && !self.expected.is_some_and(is_awaited) {
            MAX_QUIET_DELAY
        } else {
            MAX_BATCH_DELAY
        }
    }

    /// The status goes first: the consumer never sees frames newer than it. Without frames there are
    /// none up to the present.
    fn deliver(&mut self, frames: &[Frame], complete_until: Option<Instant>, socket: &RawSocket) {
        let mut reports = ErrorFrameSummary::default();
        for frame in frames {
            reports.note(frame);
        }
        if !frames.is_empty() && self.monitor.is_down.load(Ordering::Acquire) {
            self.monitor.refresh_now(&self.shared);
        }
        let reported =
            (self.drops_before + socket.drops(), socket.unconfirmed(), socket.most_waiting());
        if reported != self.reported || reports.total > 0 {
            self.reported = reported;
            self.shared.queue.update_status(|status| {
                (status.kernel_drops, status.unconfirmed, status.most_waiting) = reported;
                status.missing_acks += reports.missing_acks;
                status.controller_overruns += reports.overruns;
            });
        }
        if frames.is_empty() {
            self.shared.queue.set_complete();
        } else {
            self.shared.queue.push_until(frames, complete_until);
        }
        if reports.total > 0 {
            self.monitor.request(|request| {
                request.refresh = true;
                request.pending.bus_offs += reports.bus_offs;
            });
        }
    }

    fn send_pending(&mut self, socket: &mut RawSocket) {
        let report = self.tx.transmit(|frame| match socket.send(frame) {
            Ok(()) => TxAttempt::Sent,
            Err(error) if matches!(errno(&error), Errno::ENOBUFS | Errno::EAGAIN) => {
                TxAttempt::NoRoom
            }
            Err(_) => TxAttempt::Rejected,
        });
        let is_full = report.is_full.unwrap_or(self.is_full);
        if std::mem::replace(&mut self.is_full, is_full) != is_full || report.failures > 0 {
            self.shared.queue.update_status(|status| {
                status.transmit_failures += report.failures;
                status.is_transmit_queue_full = is_full;
            });
        }
    }

    /// How soon to offer a frame again for which the kernel had no room.
    fn retry_wait(&self) -> Option<Duration> {
        self.tx.time_left().map(|_| RETRY_INTERVAL)
    }

    fn drop_pending(&mut self) {
        let refused = self.tx.clear();
        self.is_full = false;
        self.shared.queue.update_status(|status| {
            status.transmit_failures += refused;
            status.is_transmit_queue_full = false;
        });
    }
}

/// How long to collect frames after `count` of them, at most `longest`: `None` if the bus is quiet (the
/// next frame wakes the reader); shorter the faster they arrive, so that at most `room` do.
fn batch_delay(since_last: Duration, count: u32, room: u32, longest: Duration) -> Option<Duration> {
    let interval = since_last.checked_div(count)?;
    if interval > MAX_BATCH_DELAY {
        return None;
    }
    let batch_delay = longest.min(interval.saturating_mul(room));
    (batch_delay >= Duration::from_millis(1)).then_some(batch_delay)
}

/// Counts of the error frames of a batch.
#[derive(Default)]
struct ErrorFrameSummary {
    total: u64,
    missing_acks: u64,
    overruns: u64,
    bus_offs: u64,
}

impl ErrorFrameSummary {
    fn note(&mut self, frame: &Frame) {
        let Some(report) = ErrorReport::of(frame) else { return };
        self.total += 1;
        self.missing_acks += u64::from(report.is_no_ack());
        self.overruns += u64::from(report.is_receive_overflow());
        self.bus_offs += u64::from(report.is_bus_off());
    }
}

fn errno(error: &io::Error) -> Errno {
    error.raw_os_error().map_or(Errno::UnknownErrno, Errno::from_raw)
}
