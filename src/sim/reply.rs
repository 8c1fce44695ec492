//! Pending DES responses of a device: delay, framing, transfers under flow control, and the effects
//! of faults.
//!
//! Does not know the requests or the device.

use super::scenario::{Fault, Faults};
use crate::frame::Frame;
use crate::time::Duration;
use crate::wire::framing::Framing;
use crate::wire::isotp::{FlowControl, FlowStatus, Segmenter, single_frame};

/// Most pending responses; further requests are ignored.
const MAX_REPLIES: usize = 16;
/// Frame interval of an endless transfer, in nanoseconds.
const ENDLESS_PACE: u64 = 1_000_000;

/// Form of a response's frames.
#[derive(Clone, Copy)]
pub(super) struct ResponseFormat {
    /// Identifier of the response.
    pub id: u32,
    /// Identifier with ERR = 0, for a message that is too long for its framing.
    pub refusal_id: u32,
    pub framing: Framing,
    pub fd: bool,
    pub padding: u8,
    /// Address whose flow control counts, 0 to 127.
    pub requester: u8,
}

/// Pending responses of one device.
#[derive(Default)]
pub(super) struct TxResponses(Vec<TxResponse>);

struct TxResponse {
    format: ResponseFormat,
    /// Earliest time of the next frame, in nanoseconds.
    not_before: u64,
    /// True while a frame of it is queued; the next one follows after its transmission.
    in_flight: bool,
    /// Minimum time between two frames, from flow control.
    separation: Duration,
    body: Body,
}

enum Body {
    Frame(Frame),
    Transfer(TxTransfer),
    Done,
}

struct TxTransfer {
    segmenter: Segmenter<Vec<u8>>,
    faults: Faults,
    frames: u32,
    sequence: u8,
    /// Time of the next frame of an endless transfer, in nanoseconds.
    resume: u64,
}

impl TxResponses {
    /// Adds a response, to be sent at `at` (nanoseconds) or later.
    pub fn push(&mut self, at: u64, form: ResponseFormat, message: Vec<u8>, faults: Faults) {
        if self.0.len() >= MAX_REPLIES || message.is_empty() {
            return;
        }
        let body = match form.framing {
            Framing::Raw => Body::Frame(form.raw(&message)),
            Framing::Isotp
                if faults.has(Fault::HugeLength) && single_frame(&message, form.fd).is_none() =>
            {
                Body::Frame(form.oversized())
            }
            Framing::Isotp => Body::Transfer(TxTransfer::new(message, form.fd, faults)),
        };
        let separation = Duration::ZERO;
        self.0.push(TxResponse {
            format: form,
            not_before: at,
            in_flight: false,
            separation,
            body,
        });
    }

    /// Removes all responses.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Returns when to call [`Replies::poll`] next, in nanoseconds; `None` if none is pending.
    pub fn next(&self) -> Option<u64> {
        self.ready().map(|(_, reply)| reply.due()).min()
    }

    /// Returns the next frame to send; `None` if none is due.
    pub fn poll(&mut self, now: u64) -> Option<Frame> {
        let due = self.ready().find(|(_, reply)| reply.due() <= now);
        let (at, _) = due?;
        let reply = &mut self.0[at];
        let frame = reply.advance(now);
        reply.in_flight = frame.is_some();
        if frame.is_none() && reply.is_over(now) {
            self.0.remove(at);
        }
        frame
    }

    /// Handles the transmission of a frame with this identifier.
    pub fn handle_sent(&mut self, now: u64, id: u32) {
        let sent = |reply: &TxResponse| {
            reply.in_flight && (reply.format.id == id || reply.format.refusal_id == id)
        };
        let Some(at) = self.0.iter().position(sent) else { return };
        let reply = &mut self.0[at];
        reply.in_flight = false;
        reply.not_before = now + reply.separation.as_nanos() as u64;
        if reply.is_over(now) {
            self.0.remove(at);
        }
    }

    /// Handles flow control from the address `peer`.
    pub fn handle_flow(&mut self, now: u64, peer: u8, flow: FlowControl) {
        let position = self.ready().find_map(|(at, reply)| {
            (reply.format.requester == peer && matches!(reply.body, Body::Transfer(_)))
                .then_some(at)
        });
        let Some(at) = position else { return };
        let reply = &mut self.0[at];
        let Body::Transfer(transfer) = &mut reply.body else { return };
        if transfer.frames == 0 {
            return;
        }
        if flow.status == FlowStatus::Continue {
            reply.separation = flow.separation();
        }
        if transfer.segmenter.handle_flow(super::instant(now), flow).is_err() {
            self.0.remove(at);
        }
    }

    /// Yields the responses that may continue: for each identifier the first.
    fn ready(&self) -> impl Iterator<Item = (usize, &TxResponse)> {
        let all = &self.0;
        all.iter().enumerate().filter(move |(at, reply)| {
            !reply.in_flight
                && all[..*at].iter().all(|earlier| earlier.format.id != reply.format.id)
        })
    }
}

impl TxResponse {
    fn due(&self) -> u64 {
        let at = match &self.body {
            Body::Frame(_) | Body::Done => 0,
            Body::Transfer(transfer) => transfer.due(),
        };
        at.max(self.not_before)
    }

    fn advance(&mut self, now: u64) -> Option<Frame> {
        match &mut self.body {
            Body::Done => None,
            Body::Frame(frame) => {
                let frame = *frame;
                self.body = Body::Done;
                Some(frame)
            }
            Body::Transfer(transfer) => transfer.next(now, &self.format),
        }
    }

    fn is_over(&self, now: u64) -> bool {
        match &self.body {
            Body::Frame(_) => false,
            Body::Done => true,
            Body::Transfer(transfer) => transfer.is_over(now),
        }
    }
}

impl TxTransfer {
    fn new(message: Vec<u8>, fd: bool, faults: Faults) -> Self {
        let segmenter = Segmenter::new(message, fd);
        Self { segmenter, faults, frames: 0, sequence: 0, resume: 0 }
    }

    /// Returns true if it continues after its last byte; a single frame does not.
    fn is_endless(&self) -> bool {
        self.faults.has(Fault::Endless) && self.frames > 1
    }

    fn due(&self) -> u64 {
        self.segmenter.poll_timeout().map_or(self.resume, super::nanos)
    }

    fn is_over(&self, now: u64) -> bool {
        let given_up = self.segmenter.handle_timeout(super::instant(now)).is_err();
        given_up || self.segmenter.is_done() && !self.is_endless()
    }

    fn next(&mut self, now: u64, form: &ResponseFormat) -> Option<Frame> {
        if self.segmenter.is_done() && self.is_endless() {
            self.sequence = (self.sequence + 1) & 0x0F;
            self.resume = now + ENDLESS_PACE;
            let data = [0x20 | self.sequence, 0xEE, 0xEE, 0xEE, 0xEE, 0xEE, 0xEE, 0xEE];
            return Some(form.frame(form.id, &data));
        }
        let segment = self.segmenter.poll(super::instant(now))?;
        let mut bytes = [0; Frame::MAX_DATA];
        let data = &mut bytes[..segment.as_bytes().len()];
        data.copy_from_slice(segment.as_bytes());
        self.frames += 1;
        self.sequence = data[0] & 0x0F;
        if self.frames == 2 && self.faults.has(Fault::DropFrame) {
            return None;
        }
        if self.frames == 2 && self.faults.has(Fault::WrongSequence) {
            data[0] ^= 0x08;
        }
        Some(form.frame(form.id, data))
    }
}

impl ResponseFormat {
    fn frame(&self, id: u32, data: &[u8]) -> Frame {
        if self.fd { Frame::fd(id, data, self.padding) } else { Frame::classic(id, data) }
    }

    fn capacity(&self) -> usize {
        if self.fd { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA }
    }

    /// Returns the message in one frame, or a frame with ERR = 0 if it is too long.
    pub fn raw(&self, message: &[u8]) -> Frame {
        if message.len() <= self.capacity() {
            self.frame(self.id, message)
        } else {
            self.frame(self.refusal_id, &[])
        }
    }

    /// Returns a first frame with a length of 4 GiB.
    fn oversized(&self) -> Frame {
        let mut data = [0; Frame::MAX_DATA];
        data[..6].copy_from_slice(&[0x10, 0x00, 0xFF, 0xFF, 0xFF, 0xFF]);
        self.frame(self.id, &data[..self.capacity()])
    }
}
