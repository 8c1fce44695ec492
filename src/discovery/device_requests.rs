//! Requests to single devices, other than those of DES: reads of the descriptor, commands, writes.
//!
//! Each is sent once and ends with its response, or with the reason why there is none; none is
//! repeated. A request from address 0 has priority over nearly all other frames, so these are sent
//! within the steady share of the bus, also during the rounds at start. Does not know what a
//! request does to the device.

use super::device_tracker::DeviceTracker;
use super::event::EventKind;
use super::observation::{Observation, ObservationKind};
use super::outbox::nominal_bits;
use super::requester::Requester;
use super::{DeviceId, Engine, Event};
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::descriptor::DescriptorField;
use crate::wire::id::{Header, Service};
use std::collections::VecDeque;

/// Maximum number of requests that wait to be sent. Bounds the memory: all fields of 127 devices, and
/// as many commands.
const MAX_QUEUED: usize = 2048;
/// Maximum number of requests that wait for a response, each to another device. As many as queries.
const MAX_OPEN: usize = 12;

/// A request to one device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceRequest {
    /// The device. If it has left its address when the request is due, it is not sent.
    pub device: DeviceId,
    /// The service.
    pub service: Service,
    /// The data, at most 8 bytes; more are not sent.
    pub data: Vec<u8>,
}

/// Identity of a request on its bus; never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId(u64);

/// How a request ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RequestOutcome {
    /// The device responded with this data.
    Responded(Vec<u8>),
    /// The device responded with ERR = 0 and this data: it reports an error.
    Refused(Vec<u8>),
    /// Nothing within the time of `calls.timeout_ms`.
    NoResponse,
    /// Not sent, or not known to be.
    NotSent(RequestObstacle),
}

/// Why a request was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RequestObstacle {
    /// The device is no longer at an address of the bus.
    #[error("the device has left the bus")]
    DeviceLeft,
    /// No node acknowledges descan's frames.
    #[error("no node acknowledges descan's frames")]
    NoAck,
    /// descan has no address, or lost it.
    #[error("descan has no address on this bus")]
    NoAddress,
    /// The bus is down, or its adapter is gone.
    #[error("the bus is not available")]
    BusUnavailable,
    /// The bus speaks another protocol.
    #[error("the bus speaks another protocol")]
    ForeignBus,
}

/// A request that waits to be sent.
#[derive(Clone, Debug)]
struct QueuedRequest {
    id: RequestId,
    request: DeviceRequest,
    field: Option<DescriptorField>,
    /// No user demands it: a read after the name.
    is_automatic: bool,
}

/// A request that waits for its response.
#[derive(Clone, Debug)]
struct AwaitedRequest {
    id: RequestId,
    device: DeviceId,
    field: Option<DescriptorField>,
    frame: Frame,
    header: Header,
    deadline: Instant,
}

/// A request that ended and is not reported yet.
#[derive(Clone, Debug)]
struct EndedRequest {
    id: RequestId,
    device: DeviceId,
    field: Option<DescriptorField>,
    /// The request; `None` if it was not sent.
    frame: Option<Frame>,
    outcome: RequestOutcome,
}

impl AwaitedRequest {
    fn end(self, outcome: RequestOutcome) -> EndedRequest {
        let Self { id, device, field, frame, .. } = self;
        EndedRequest { id, device, field, frame: Some(frame), outcome }
    }
}

impl QueuedRequest {
    fn end(self, why: RequestObstacle) -> EndedRequest {
        let Self { id, request, field, .. } = self;
        let (device, outcome) = (request.device, RequestOutcome::NotSent(why));
        EndedRequest { id, device, field, frame: None, outcome }
    }
}

/// Requests of one bus to single devices.
#[derive(Clone, Debug, Default)]
pub(super) struct DeviceRequests {
    queued: VecDeque<QueuedRequest>,
    open: Vec<AwaitedRequest>,
    ended: VecDeque<EndedRequest>,
    next_id: u64,
    /// When the share of the bus allows the next one.
    free_at: Instant,
}

impl DeviceRequests {
    /// Queues a request; returns `None` if too many wait. `field`: what it reads; `is_automatic`: no
    /// user demands it.
    pub fn push(
        &mut self,
        request: DeviceRequest,
        field: Option<DescriptorField>,
        is_automatic: bool,
    ) -> Option<RequestId> {
        let is_long = request.data.len() > Frame::MAX_CLASSIC_DATA;
        if self.queued.len() == MAX_QUEUED || is_long {
            return None;
        }
        let id = RequestId(self.next_id);
        self.next_id += 1;
        // What the user demands goes first.
        let automatic = self.queued.iter().position(|queued| queued.is_automatic);
        let at = automatic.filter(|_| !is_automatic).unwrap_or(self.queued.len());
        self.queued.insert(at, QueuedRequest { id, request, field, is_automatic });
        Some(id)
    }

    /// Number of requests without an end.
    pub fn count(&self) -> usize {
        self.queued.len() + self.open.len()
    }

    /// Number of fields of a device's descriptor that are still to be read.
    pub fn reads_of(&self, device: DeviceId) -> usize {
        let open = self.open.iter().filter(|it| it.device == device && it.field.is_some());
        let is_read = |it: &&QueuedRequest| it.request.device == device && it.field.is_some();
        let ended = self.ended.iter().filter(|it| it.device == device && it.field.is_some());
        open.count() + self.queued.iter().filter(is_read).count() + ended.count()
    }

    /// Ends all requests, none of which gets a response any more.
    pub fn end_all(&mut self, why: RequestObstacle) {
        let open = self.open.drain(..).map(|open| open.end(RequestOutcome::NotSent(why)));
        self.ended.extend(open);
        self.ended.extend(self.queued.drain(..).map(|queued| queued.end(why)));
    }

    /// Notes a frame of descan that is on the bus: the wait for its response begins.
    fn note_sent(&mut self, now: Instant, frame: &Frame, timeout: Duration) {
        if let Some(open) = self.open.iter_mut().find(|open| open.frame.same_on_wire(frame)) {
            open.deadline = now + timeout;
        }
    }

    /// Ends the request that a response answers. `is_echo`: the DST of the response is that of the
    /// request.
    fn take_response(&mut self, header: Header, is_echo: bool, data: &[u8]) {
        let at = self.open.iter().position(|open| {
            let asked = open.header;
            asked.destination == header.source
                && asked.service == header.service
                && (is_echo || asked.source == header.destination)
        });
        let Some(at) = at else { return };
        let open = self.open.swap_remove(at);
        let data = data.to_vec();
        let outcome = if header.no_error {
            RequestOutcome::Responded(data)
        } else {
            RequestOutcome::Refused(data)
        };
        self.ended.push_back(open.end(outcome));
    }

    /// Ends the requests whose response is overdue.
    fn expire(&mut self, now: Instant) {
        for at in (0..self.open.len()).rev() {
            if self.open[at].deadline <= now {
                let open = self.open.swap_remove(at);
                self.ended.push_back(open.end(RequestOutcome::NoResponse));
            }
        }
    }

    fn poll_timeout(&self, may_send: bool) -> Option<Instant> {
        let is_busy = |device| self.open.iter().any(|open| open.device == device);
        let is_due = may_send
            && self.open.len() < MAX_OPEN
            && self.queued.iter().any(|queued| !is_busy(queued.request.device));
        let next = is_due.then_some(self.free_at);
        self.open.iter().map(|open| open.deadline).chain(next).min()
    }
}

impl Requester {
    /// Why no request can be sent at present; `None` if one can, or can soon.
    pub(super) fn request_obstacle(&self, tracker: &DeviceTracker) -> Option<RequestObstacle> {
        if self.outbox.has_no_ack() {
            Some(RequestObstacle::NoAck)
        } else if tracker.config.listen_only {
            Some(RequestObstacle::NoAddress)
        } else if tracker.outages.is_on() {
            Some(RequestObstacle::BusUnavailable)
        } else if self.is_left_alone(tracker) {
            Some(RequestObstacle::ForeignBus)
        } else {
            None
        }
    }

    /// Sends the requests that are due and ends those without a response.
    pub(super) fn send_device_requests(&mut self, tracker: &DeviceTracker) {
        let now = tracker.now;
        self.device_requests.expire(now);
        if self.device_requests.count() == 0 {
            return;
        }
        if let Some(why) = self.request_obstacle(tracker) {
            return self.device_requests.end_all(why);
        }
        let Some(own) = self.local_node.held() else { return };
        let timeout = tracker.config.profile.calls.timeout();
        let rate = tracker.config.steady_budget * f64::from(tracker.config.bits_per_second());
        let requests = &mut self.device_requests;
        let mut at = 0;
        while at < requests.queued.len()
            && requests.open.len() < MAX_OPEN
            && requests.free_at <= now
        {
            let device = requests.queued[at].request.device;
            // A device gets its requests one after the other, in their order.
            let is_busy = requests.open.iter().any(|open| open.device == device);
            if is_busy {
                at += 1;
                continue;
            }
            let Some(queued) = requests.queued.remove(at) else { return };
            let row = tracker.device_table.get(device);
            let row = row.filter(|row| row.is_present() && tracker.device_table.is_current(row));
            let Some(row) = row.filter(|row| row.address != own) else {
                requests.ended.push_back(queued.end(RequestObstacle::DeviceLeft));
                continue;
            };
            let QueuedRequest { id, request, field, .. } = queued;
            let mut header = Header::request(own, row.address, !row.is_working, request.service);
            header.no_error = tracker.config.profile.request_err;
            let frame = Frame::classic(header.encode(), &request.data);
            // The response takes its part of the share, too.
            let bits = 2.0 * nominal_bits(&frame);
            requests.free_at = now + Duration::from_micros((bits / rate.max(1.0) * 1e6) as u64);
            let deadline = now + timeout;
            requests.open.push(AwaitedRequest { id, device, field, frame, header, deadline });
            self.outbox.push(frame);
        }
    }

    /// Returns when a request or the end of one is due.
    pub(super) fn device_request_timeout(&self, tracker: &DeviceTracker) -> Option<Instant> {
        let may_send = self.local_node.held().is_some() && self.request_obstacle(tracker).is_none();
        self.device_requests.poll_timeout(may_send)
    }
}

impl Engine {
    /// Command: sends a frame as it stands, once, unless nothing can be sent at present. Its share of
    /// the bus is the caller's care.
    pub fn send(&mut self, now: Instant, frame: Frame) {
        self.tracker.advance(now);
        if self.requester.request_obstacle(&self.tracker).is_none() {
            self.requester.outbox.push(frame);
            self.tracker.wake_at(self.tracker.now);
        }
    }

    /// Command: sends a request to one device, once. Its end is an [`EventKind::RequestEnded`].
    /// Returns `None` if the data are longer than 8 bytes, or too many requests wait.
    pub fn request(&mut self, now: Instant, request: DeviceRequest) -> Option<RequestId> {
        self.tracker.advance(now);
        let id = self.requester.device_requests.push(request, None, false);
        self.tracker.wake_at(self.tracker.now);
        id
    }

    /// Sends the requests to devices that are due, and reports those that ended.
    pub(super) fn step_device_requests(&mut self) {
        self.queue_due_reads();
        self.requester.send_device_requests(&self.tracker);
        self.report_ended_requests();
    }

    fn report_ended_requests(&mut self) {
        while let Some(ended) = self.requester.device_requests.ended.pop_front() {
            let EndedRequest { id, device, field, frame, outcome } = ended;
            if let Some(field) = field {
                self.end_read(device, field, &outcome);
                continue;
            }
            // Its row may be gone.
            let row = self.tracker.device_table.get(device);
            let event = Event {
                time: self.tracker.now,
                device: Some(device),
                address: row.map(|row| row.address),
                name: row.and_then(|row| row.name.clone()),
                kind: EventKind::RequestEnded { request: id, frame, outcome },
            };
            self.tracker.push_event(event);
        }
    }

    /// Notes a frame of descan, or of the inspector that recorded a log, to one device.
    pub(super) fn note_own_device_request(&mut self, observation: &Observation<'_>) {
        let Observation { at: now, frame, kind } = *observation;
        let ObservationKind::Platform(header, _) = kind else { return };
        let timeout = self.tracker.config.profile.calls.timeout();
        self.requester.device_requests.note_sent(now, frame, timeout);
        self.note_device_request(now, header, frame);
    }

    /// Notes a request of another node.
    pub(super) fn note_device_request(&mut self, now: Instant, header: Header, frame: &Frame) {
        if header.is_conforming() && !header.response && !header.broadcast {
            let profile = self.tracker.config.profile.clone();
            let reads = &mut self.tracker.field_accesses;
            reads.note_request(now, header, frame.data(), &profile);
        }
    }

    /// Notes a frame of another service than DES.
    pub(super) fn process_other_service(
        &mut self,
        now: Instant,
        row: DeviceId,
        header: Header,
        frame: &Frame,
    ) {
        if !header.response {
            return self.note_device_request(now, header, frame);
        }
        if header.broadcast {
            return;
        }
        let is_echo = header.destination == header.source;
        let requests = &mut self.requester.device_requests;
        requests.take_response(header, is_echo, frame.data());
        self.note_field_response(row, header, is_echo, frame);
        self.report_ended_requests();
        self.tracker.wake_at(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn queue_of_requests_is_bounded() {
        let mut requests = DeviceRequests::default();
        let device = DeviceId { bus: crate::frame::BusIndex(0), number: 1 };
        let service = Service::from_bits(0x123);
        let request = |len| DeviceRequest { device, service, data: vec![0; len] };
        assert!(requests.push(request(9), None, false).is_none(), "longer than a frame");
        for _ in 0..MAX_QUEUED {
            assert!(requests.push(request(8), None, false).is_some());
        }
        assert!(requests.push(request(8), None, false).is_none());
        requests.end_all(RequestObstacle::NoAck);
        assert_eq!((requests.count(), requests.ended.len()), (0, MAX_QUEUED));
    }
}
