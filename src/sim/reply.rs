//! A device's DES answers on their way: the delay before them, their framing, the transfers
//! under flow control, and what a faulty device does to them.
//!
//! Does not know what was asked or who the device is.

use super::scenario::{Fault, Faults};
use crate::frame::Frame;
use crate::time::Duration;
use crate::wire::framing::Framing;
use crate::wire::isotp::{FlowControl, FlowStatus, Segmenter, single_frame};

/// The most answers that wait or are under way; what is asked beyond that is not answered.
const MAX_REPLIES: usize = 16;
/// How long a device that never ends pauses between two frames, in nanoseconds.
const ENDLESS_PACE: u64 = 1_000_000;

/// How the frames of an answer are made.
#[derive(Clone, Copy)]
pub(super) struct Form {
    /// The identifier they travel on.
    pub id: u32,
    /// The identifier without the bit ERR, on which a message too long for its framing is
    /// refused.
    pub refusal_id: u32,
    pub framing: Framing,
    pub fd: bool,
    pub padding: u8,
    /// Whose flow control counts, 0–127.
    pub peer: u8,
}

/// The answers of one device.
#[derive(Default)]
pub(super) struct Replies(Vec<Reply>);

struct Reply {
    form: Form,
    /// Not to be continued before, in nanoseconds.
    not_before: u64,
    /// A frame of it is queued: go on when it is out.
    in_flight: bool,
    /// Least time between two frames, as flow control says.
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
    /// When an endless one goes on, in nanoseconds.
    resume: u64,
}

impl Replies {
    /// Answers `message` not before `at`.
    pub fn push(&mut self, at: u64, form: Form, message: Vec<u8>, faults: Faults) {
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
        self.0.push(Reply { form, not_before: at, in_flight: false, separation, body });
    }

    /// Forgets all of them.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// When [`Replies::poll`] is to be called next, in nanoseconds.
    pub fn next(&self) -> Option<u64> {
        self.ready().map(|(_, reply)| reply.due()).min()
    }

    /// The next frame to be queued, if one is due.
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

    /// Takes note that a frame with this identifier is out.
    pub fn handle_sent(&mut self, now: u64, id: u32) {
        let sent =
            |reply: &Reply| reply.in_flight && (reply.form.id == id || reply.form.refusal_id == id);
        let Some(at) = self.0.iter().position(sent) else { return };
        let reply = &mut self.0[at];
        reply.in_flight = false;
        reply.not_before = now + reply.separation.as_nanos() as u64;
        if reply.is_over(now) {
            self.0.remove(at);
        }
    }

    /// Takes flow control from `peer`.
    pub fn handle_flow(&mut self, now: u64, peer: u8, flow: FlowControl) {
        let position = self.ready().find_map(|(at, reply)| {
            (reply.form.peer == peer && matches!(reply.body, Body::Transfer(_))).then_some(at)
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

    /// Those that may go on: of several on one identifier the first.
    fn ready(&self) -> impl Iterator<Item = (usize, &Reply)> {
        let all = &self.0;
        all.iter().enumerate().filter(move |(at, reply)| {
            !reply.in_flight && all[..*at].iter().all(|earlier| earlier.form.id != reply.form.id)
        })
    }
}

impl Reply {
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
            Body::Transfer(transfer) => transfer.next(now, &self.form),
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

    /// Whether it goes on although all is sent; a message of one frame ends all the same.
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

    fn next(&mut self, now: u64, form: &Form) -> Option<Frame> {
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

impl Form {
    fn frame(&self, id: u32, data: &[u8]) -> Frame {
        if self.fd { Frame::fd(id, data, self.padding) } else { Frame::classic(id, data) }
    }

    fn capacity(&self) -> usize {
        if self.fd { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA }
    }

    /// The whole message in a frame; where it does not fit, the platform's "could not".
    pub fn raw(&self, message: &[u8]) -> Frame {
        if message.len() <= self.capacity() {
            self.frame(self.id, message)
        } else {
            self.frame(self.refusal_id, &[])
        }
    }

    /// A first frame that announces more than anybody takes.
    fn oversized(&self) -> Frame {
        let mut data = [0; Frame::MAX_DATA];
        data[..6].copy_from_slice(&[0x10, 0x00, 0xFF, 0xFF, 0xFF, 0xFF]);
        self.frame(self.id, &data[..self.capacity()])
    }
}
