//! One exchange: frames to a device, and its answers until they are complete or overdue.
//!
//! Plays the receiver of ISO-TP by a script: when flow control is sent, with which values. Notes what the
//! device does otherwise. Does not know which rules that is about.

use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::des::{MAX_MESSAGE, TYPE_NAME, TYPE_SERVICES};
use crate::wire::framing::{Framing, classify_response, strip_raw_padding};
use crate::wire::id::{Address, Header};
use crate::wire::isotp::{
    FlowControl, FlowStatus, Pci, Reassembly, ReassemblyProgress, TIMEOUT, TransferFault,
};
use std::collections::VecDeque;

/// Time after an answer in which another one, or frames behind its last, are awaited.
const LINGER: Duration = Duration::from_millis(60);
/// The same after a transfer that broke: the device sends on.
const FAULT_LINGER: Duration = Duration::from_millis(300);
/// Time in which a request must be on the bus.
const CONFIRMATION_TIMEOUT: Duration = Duration::from_secs(3);
/// Time after OVERFLOW, and after a late flow control, in which no frame may follow.
const AFTERWARDS: Duration = Duration::from_millis(300);
/// Most frames that are kept of an exchange.
const MAX_FRAMES: usize = 24;
/// Consecutive frames behind the last one after which they do not end.
const ENDLESS: u32 = 16;
/// Most answers to one request.
const MAX_ANSWERS: usize = 8;

/// How descan takes a segmented answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FlowScript {
    /// Time from the first frame to the first flow control.
    pub hold: Duration,
    /// Number of WAITs before CONTINUE.
    pub waits: u8,
    /// OVERFLOW instead of CONTINUE.
    pub overflow: bool,
    /// Block size; 0: no further flow control.
    pub block_size: u8,
    /// STmin, as coded.
    pub st_min: u8,
    /// Time from the end of a block to its flow control.
    pub block_hold: Duration,
}

impl FlowScript {
    /// At once, without limits.
    pub const PLAIN: Self = Self {
        hold: Duration::ZERO,
        waits: 0,
        overflow: false,
        block_size: 0,
        st_min: 0,
        block_hold: Duration::ZERO,
    };
}

/// What a device did with flow control; counts of consecutive frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct FlowFacts {
    /// Segmented answers.
    pub first_frames: u32,
    /// Segmented answers that came whole.
    pub completed: u32,
    /// Before the first flow control.
    pub early: u32,
    /// Between WAIT and CONTINUE.
    pub during_wait: u32,
    /// Behind the block size, before the next flow control.
    pub beyond_block: u32,
    /// Blocks that ended as they should.
    pub whole_blocks: u32,
    /// After OVERFLOW.
    pub after_overflow: u32,
    /// Time from the first to the last frame of blocks, and the number of intervals in it.
    pub block_time: Duration,
    /// See `block_time`.
    pub block_intervals: u32,
    /// Behind the last one.
    pub surplus: u32,
    /// After CONTINUE.
    pub continued: u32,
    /// Flow control that was sent.
    pub flows: u32,
}

/// An answer of the device.
#[derive(Clone, Debug)]
pub(super) struct ReceivedAnswer {
    pub header: Header,
    pub first_at: Instant,
    pub frame: Frame,
    /// Neither `None`: ISO-TP or raw.
    pub framing: Option<Framing>,
    /// The message; `None` while it is not complete.
    pub message: Option<Vec<u8>>,
    pub fault: Option<TransferFault>,
}

impl ReceivedAnswer {
    /// Type byte of the message, or of the first frame.
    pub fn kind(&self) -> Option<u8> {
        match &self.message {
            Some(message) => message.first().copied(),
            None => match Pci::decode(self.frame.data(), self.frame.is_fd) {
                Ok(Pci::First { data, .. }) => data.first().copied(),
                _ => None,
            },
        }
    }

    /// Returns true for an answer with ERR = 0 that is no name or services response.
    pub fn is_refusal(&self) -> bool {
        !self.header.no_error && !self.is_response()
    }

    /// Returns true for a name or services response.
    pub fn is_response(&self) -> bool {
        // With ERR = 0 a byte alone is an error code (CAN platform 4.1).
        let is_code = !self.header.no_error && self.message.as_ref().is_some_and(|it| it.len() < 2);
        let is_type = matches!(self.kind(), Some(TYPE_NAME | TYPE_SERVICES));
        is_type && !is_code && self.framing.is_some()
    }
}

/// What is due in a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FlowPhase {
    /// Flow control is due then.
    Holding(Instant),
    /// The device sends.
    Running,
    /// OVERFLOW was sent.
    Overflown,
}

/// A segmented answer that is being received.
#[derive(Clone, Debug)]
struct RunningTransfer {
    answer: usize,
    reassembly: Reassembly<Vec<u8>>,
    phase: FlowPhase,
    waits_left: u8,
    is_first_block: bool,
    block_left: u8,
    /// A frame of the present block was received.
    is_in_block: bool,
    last: Instant,
    deadline: Instant,
}

/// An exchange with a device.
#[derive(Clone, Debug)]
pub(super) struct Exchange {
    own: Address,
    device: Address,
    service: crate::wire::id::Service,
    request_err: bool,
    script: FlowScript,
    queue: VecDeque<Frame>,
    awaited: Vec<Frame>,
    pub asked_at: Instant,
    /// When the last frame of the request was on the bus.
    pub sent_at: Option<Instant>,
    wait: Duration,
    pub answers: Vec<ReceivedAnswer>,
    pub facts: FlowFacts,
    /// Frames of the request and of the device, in order.
    pub frames: Vec<Frame>,
    transfer: Option<RunningTransfer>,
    quiet_from: Instant,
    /// Another requester asked the device.
    pub is_disturbed: bool,
    /// Answers with a DST that is neither descan's nor an echo.
    pub strange_destination: bool,
    destinations: Vec<Address>,
    /// Bits of the frames of the exchange on the bus.
    pub bits: f64,
}

impl Exchange {
    /// Creates an exchange that sends `frames` at `now` and awaits an answer for `wait`.
    pub fn new(
        now: Instant,
        (own, device): (Address, Address),
        request_err: bool,
        frames: Vec<Frame>,
        wait: Duration,
        script: FlowScript,
    ) -> Self {
        let headers = frames.iter().filter_map(Frame::platform_id).map(Header::decode);
        let headers: Vec<Header> = headers.collect();
        let destinations = headers.iter().map(|it| it.destination).collect();
        let service = headers.first().map_or_else(Default::default, |it| it.service);
        Self {
            own,
            device,
            service,
            request_err,
            script,
            awaited: frames.clone(),
            queue: frames.into(),
            asked_at: now,
            sent_at: None,
            wait,
            answers: Vec::new(),
            facts: FlowFacts::default(),
            frames: Vec::new(),
            transfer: None,
            quiet_from: now,
            is_disturbed: false,
            strange_destination: false,
            destinations,
            bits: 0.0,
        }
    }

    /// Returns the next frame to send.
    pub fn poll_transmit(&mut self) -> Option<Frame> {
        self.queue.pop_front()
    }

    /// Returns true if there is a frame to send.
    pub fn has_frame(&self) -> bool {
        !self.queue.is_empty()
    }

    /// Returns true if the bus did not take the request.
    pub fn is_unsent(&self) -> bool {
        self.sent_at.is_none()
    }

    /// Returns true once it is over.
    pub fn is_over(&self, now: Instant) -> bool {
        now >= self.due()
    }

    /// When something is due, or when it is over.
    pub fn due(&self) -> Instant {
        let Some(sent) = self.sent_at else { return self.asked_at + CONFIRMATION_TIMEOUT };
        match &self.transfer {
            Some(transfer) => match transfer.phase {
                FlowPhase::Holding(at) => at,
                FlowPhase::Running | FlowPhase::Overflown => transfer.deadline,
            },
            None if self.answers.is_empty() => sent + self.wait,
            None if self.is_endless() => self.quiet_from,
            None if self.answers.iter().any(|it| it.fault.is_some()) => {
                self.quiet_from + FAULT_LINGER
            }
            None => self.quiet_from + LINGER,
        }
    }

    /// Returns true if consecutive frames do not end.
    pub fn is_endless(&self) -> bool {
        self.facts.surplus >= ENDLESS
    }

    /// Awaits an answer for longer.
    pub fn extend(&mut self, by: Duration) {
        self.wait += by;
    }

    /// Sends flow control that is due; ends a transfer that is overdue. Returns true if the exchange is
    /// not over.
    pub fn handle_timeout(&mut self, now: Instant) -> bool {
        let Some(transfer) = self.transfer.as_mut() else { return !self.is_over(now) };
        match transfer.phase {
            FlowPhase::Holding(at) if now >= at => self.send_flow(now),
            FlowPhase::Running if now >= transfer.deadline => {
                let after = transfer.reassembly.message().len();
                let answer = transfer.answer;
                self.answers[answer].fault = Some(TransferFault::TimeoutCr { after });
                self.transfer = None;
            }
            FlowPhase::Overflown if now >= transfer.deadline => self.transfer = None,
            _ => {}
        }
        self.transfer.is_some() || !self.is_over(now)
    }

    fn send_flow(&mut self, now: Instant) {
        let script = self.script;
        let Some(transfer) = &mut self.transfer else { return };
        let status = if transfer.is_first_block && script.overflow {
            transfer.phase = FlowPhase::Overflown;
            transfer.deadline = now + AFTERWARDS;
            FlowStatus::Overflow
        } else if transfer.waits_left > 0 {
            transfer.waits_left -= 1;
            transfer.phase = FlowPhase::Holding(now + AFTERWARDS);
            FlowStatus::Wait
        } else {
            transfer.phase = FlowPhase::Running;
            transfer.is_first_block = false;
            transfer.block_left = script.block_size;
            transfer.is_in_block = false;
            transfer.deadline = now + TIMEOUT + TIMEOUT / 2;
            FlowStatus::Continue
        };
        let response = self.answers[transfer.answer].header;
        let mut header =
            Header::request(self.own, self.device, response.from_non_working, self.service);
        header.no_error = self.request_err;
        let FlowScript { block_size, st_min, .. } = script;
        let flow = FlowControl { status, block_size, st_min };
        self.facts.flows += 1;
        self.queue.push_back(Frame::classic(header.encode(), &flow.encode()));
    }

    /// Takes a frame of the bus.
    pub fn handle_frame(&mut self, frame: &Frame) {
        let Some(header) = frame.platform_id().map(Header::decode) else { return };
        if header.service != self.service {
            return;
        }
        if frame.is_tx {
            self.note_own(frame);
        } else if header.source == self.device && header.response {
            self.note_response(frame, header);
        } else if !header.response && (header.broadcast || header.destination == self.device) {
            self.is_disturbed |= header.source != self.own;
        } else if header.response && header.destination == self.own {
            self.bits += super::nominal_bits(frame);
        }
    }

    fn note_own(&mut self, frame: &Frame) {
        self.keep(frame);
        if let Some(at) = self.awaited.iter().position(|it| it.same_on_wire(frame)) {
            self.awaited.swap_remove(at);
            if self.awaited.is_empty() {
                self.sent_at = Some(frame.time);
            }
        }
    }

    fn keep(&mut self, frame: &Frame) {
        self.bits += super::nominal_bits(frame);
        if self.frames.len() < MAX_FRAMES {
            self.frames.push(*frame);
        }
    }

    fn note_response(&mut self, frame: &Frame, header: Header) {
        let is_echo = self.destinations.contains(&header.destination);
        let is_for_us = header.destination == self.own || is_echo;
        if !is_for_us && (self.is_disturbed || header.broadcast) && self.sent_at.is_none() {
            return;
        }
        // Answers to another requester, and what is sent before the request is on the bus.
        if self.is_disturbed && !is_for_us || self.sent_at.is_none() {
            return;
        }
        self.keep(frame);
        self.quiet_from = frame.time;
        match Pci::decode(frame.data(), frame.is_fd) {
            Ok(Pci::Consecutive { sequence, data }) => {
                self.note_consecutive(frame.time, sequence, data);
            }
            Ok(Pci::Flow(_)) => {}
            _ if self.answers.len() >= MAX_ANSWERS => {}
            decoded => {
                self.strange_destination |= !is_for_us;
                let framing = classify_response(frame.data(), frame.is_fd, false);
                let message = match (decoded, framing) {
                    (Ok(Pci::First { .. }), _) => None,
                    (_, Some(Framing::Raw)) => Some(strip_raw_padding(frame.data()).to_vec()),
                    (Ok(Pci::Single(message)), _) => Some(message.to_vec()),
                    _ => Some(frame.data().to_vec()),
                };
                self.answers.push(ReceivedAnswer {
                    header,
                    first_at: frame.time,
                    frame: *frame,
                    framing,
                    message,
                    fault: None,
                });
                if let Ok(Pci::First { length, data }) = decoded {
                    self.start_transfer(frame, length, data);
                }
            }
        }
    }

    fn start_transfer(&mut self, frame: &Frame, length: u32, data: &[u8]) {
        let (now, answer) = (frame.time, self.answers.len() - 1);
        self.facts.first_frames += 1;
        let buffer = vec![0; MAX_MESSAGE];
        match Reassembly::start(now, length, data, frame.len(), 0, buffer) {
            Ok(reassembly) => {
                self.transfer = Some(RunningTransfer {
                    answer,
                    reassembly,
                    phase: FlowPhase::Holding(now + self.script.hold),
                    waits_left: self.script.waits,
                    is_first_block: true,
                    block_left: 0,
                    is_in_block: false,
                    last: now,
                    deadline: now + TIMEOUT,
                });
            }
            Err(fault) => self.answers[answer].fault = Some(fault),
        }
    }

    fn note_consecutive(&mut self, now: Instant, sequence: u8, data: &[u8]) {
        let script = self.script;
        let Some(transfer) = &mut self.transfer else {
            // Before, they belong to an earlier transfer.
            self.facts.surplus += u32::from(self.facts.completed > 0);
            return;
        };
        match transfer.phase {
            FlowPhase::Overflown => {
                self.facts.after_overflow += 1;
                return;
            }
            FlowPhase::Holding(_) if !transfer.is_first_block => {
                self.facts.beyond_block += 1;
            }
            FlowPhase::Holding(_) if transfer.waits_left < script.waits => {
                self.facts.during_wait += 1;
            }
            FlowPhase::Holding(_) => self.facts.early += 1,
            FlowPhase::Running => self.facts.continued += 1,
        }
        if transfer.phase == FlowPhase::Running
            && std::mem::replace(&mut transfer.is_in_block, true)
        {
            self.facts.block_time += now.since(transfer.last);
            self.facts.block_intervals += 1;
        }
        transfer.last = now;
        transfer.deadline = now + TIMEOUT + TIMEOUT / 2;
        match transfer.reassembly.push(now, sequence, data) {
            Ok(ReassemblyProgress::Done) => {
                let answer = transfer.answer;
                self.answers[answer].message = Some(transfer.reassembly.message().to_vec());
                self.facts.completed += 1;
                self.transfer = None;
            }
            Ok(_) => {
                if transfer.phase == FlowPhase::Running && transfer.block_left > 0 {
                    transfer.block_left -= 1;
                    if transfer.block_left == 0 {
                        self.facts.whole_blocks += 1;
                        transfer.phase = FlowPhase::Holding(now + script.block_hold);
                    }
                }
            }
            Err(fault) => {
                let answer = transfer.answer;
                self.answers[answer].fault = Some(fault);
                self.transfer = None;
            }
        }
    }
}
