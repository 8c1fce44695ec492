//! Responses to a request that was sent, with their latency.
//!
//! Inputs: the frames of the bus, in their order. A response is of the same service, from the receiver
//! (of a broadcast from any node of the kind it is to), to the sender of the request or with its DST. A
//! targeted response is to the oldest copy without one; a second one, as of another board, counts until
//! descan sends another request of the service. Messages of several ISO-TP frames are put
//! together; flow control is the engine's care. Bounded: 64 open copies, 16 open transfers. Does not
//! know when the wait for answers is over.

use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::des::{self, Request};
use crate::wire::framing::{Framing, classify_request, classify_response, strip_raw_padding};
use crate::wire::id::{Address, Header};
use crate::wire::isotp::{Pci, Reassembly, ReassemblyProgress};
use crate::wire::profile::Profile;
use std::collections::VecDeque;

/// Most copies that wait for their response.
const MAX_OPEN: usize = 64;
/// Most transfers at the same time.
const MAX_TRANSFERS: usize = 16;

/// A response.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// Number of the copy that it answers, from 1.
    pub copy: u32,
    /// Who answers.
    pub from: Address,
    /// Time from the request to the first frame of the response.
    pub latency: Duration,
    /// ERR = 0.
    pub is_error: bool,
    /// Framing of a DES response; `None` for other services.
    pub framing: Option<Framing>,
    /// The message.
    pub message: Vec<u8>,
    /// The rest of the message did not come.
    pub is_incomplete: bool,
}

/// A copy of the request.
#[derive(Clone, Copy, Debug)]
struct SentCopy {
    number: u32,
    time: Instant,
    to_non_working: bool,
}

/// A response whose frames are arriving.
#[derive(Clone, Debug)]
struct OpenTransfer {
    header: Header,
    answer: Answer,
    parts: Reassembly<Vec<u8>>,
}

/// Finds the responses to the copies of a request.
#[derive(Clone, Debug)]
pub struct AnswerCollector {
    requests: Vec<Header>,
    is_des: bool,
    /// The type of a DES request.
    request: Option<Request>,
    timeout: Duration,
    open: VecDeque<SentCopy>,
    /// The last copy with a response.
    answered: Option<SentCopy>,
    /// descan has sent another request of the service since the last copy.
    is_mixed: bool,
    /// Addresses that responded to the last copy, a bit for each.
    responders: u128,
    transfers: Vec<OpenTransfer>,
}

impl AnswerCollector {
    /// Collects responses to these frames; `timeout`: longest time to the first frame of a response.
    pub fn new(frames: &[Frame], profile: &Profile, timeout: Duration) -> Self {
        let requests: Vec<Header> = frames
            .iter()
            .filter_map(|frame| frame.platform_id().map(Header::decode))
            .filter(|header| !header.response)
            .collect();
        let is_des = requests.iter().any(|header| header.service == profile.des_service());
        let request = frames.first().filter(|_| is_des).and_then(|frame| {
            let (_, message) = classify_request(frame.data(), frame.is_fd)?;
            [Request::Name, Request::Services].into_iter().find(|it| it.encode() == message)
        });
        Self {
            requests,
            is_des,
            request,
            timeout,
            open: VecDeque::new(),
            answered: None,
            is_mixed: false,
            responders: 0,
            transfers: Vec::new(),
        }
    }

    /// Notes that a frame of a copy is on the bus. The DST of a broadcast may be another one than in the
    /// copy before.
    pub fn note_sent(&mut self, number: u32, time: Instant, frame: &Frame) {
        let Some(header) = frame.platform_id().map(Header::decode) else { return };
        let to_non_working = header.to_non_working;
        let is_it = |it: &&mut Header| it.to_non_working == to_non_working;
        let Some(request) = self.requests.iter_mut().find(is_it) else { return };
        request.destination = header.destination;
        if self.open.back().is_none_or(|sent| sent.number != number) {
            (self.is_mixed, self.responders) = (false, 0);
        }
        if self.open.len() == MAX_OPEN {
            self.open.pop_front();
        }
        self.open.push_back(SentCopy { number, time, to_non_working });
    }

    /// Returns true while the frames of a response are arriving.
    pub fn is_receiving(&self) -> bool {
        !self.transfers.is_empty()
    }

    /// Takes a frame of another node; returns a response that is complete with it.
    pub fn handle_frame(&mut self, frame: &Frame) -> Option<Answer> {
        let header = Header::decode(frame.platform_id()?);
        if frame.is_tx {
            self.note_other_request(header, frame);
            return None;
        }
        if !self.is_response(header) {
            return None;
        }
        let data = frame.data();
        let at = self.transfers.iter().position(|it| it.header == header);
        if let (Some(at), Ok(Pci::Consecutive { sequence, data })) =
            (at, Pci::decode(data, frame.is_fd))
        {
            return self.push_part(at, frame.time, sequence, data);
        }
        let framing = classify_response(data, frame.is_fd, false).filter(|_| self.is_des);
        let message = match (framing, Pci::decode(data, frame.is_fd)) {
            (Some(Framing::Isotp), Ok(Pci::Single(message) | Pci::First { data: message, .. })) => {
                message
            }
            (Some(Framing::Raw), _) => strip_raw_padding(data),
            _ => data,
        };
        if self.is_des && header.no_error {
            // Responses to other requests are of another type.
            let is_known = |byte: &u8| matches!(*byte, des::TYPE_NAME | des::TYPE_SERVICES);
            let kind = message.first().filter(|byte| is_known(byte));
            if framing.is_none() || self.request.is_some_and(|it| kind != Some(&it.type_byte())) {
                return None;
            }
        }
        let sent = self.copy_of(header, frame.time)?;
        let answer = Answer {
            copy: sent.number,
            from: header.source,
            latency: frame.time.since(sent.time),
            is_error: !header.no_error,
            framing,
            message: message.to_vec(),
            is_incomplete: false,
        };
        if let (Some(Framing::Isotp), Ok(Pci::First { length, data })) =
            (framing, Pci::decode(frame.data(), frame.is_fd))
        {
            return self.begin(header, answer, (length, data), frame);
        }
        Some(answer)
    }

    /// Ends the transfers whose next frame is overdue; returns what came of one.
    pub fn handle_timeout(&mut self, now: Instant) -> Option<Answer> {
        let at = self.transfers.iter().position(|it| it.parts.deadline() <= now)?;
        Some(self.break_off(at))
    }

    /// Returns when [`handle_timeout`](Self::handle_timeout) is due.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.transfers.iter().map(|it| it.parts.deadline()).min()
    }

    /// Notes a request of descan that is not a copy: devices respond to it, too.
    fn note_other_request(&mut self, header: Header, frame: &Frame) {
        let is_of_service = self.requests.iter().any(|it| it.service == header.service);
        let is_flow = matches!(Pci::decode(frame.data(), frame.is_fd), Ok(Pci::Flow(_)));
        if is_of_service && !header.response && !is_flow && !self.requests.contains(&header) {
            self.is_mixed = true;
            self.answered = None;
        }
    }

    fn is_response(&self, header: Header) -> bool {
        header.response
            && !header.broadcast
            && self.requests.iter().any(|request| {
                let is_to_sender = header.destination == request.source
                    || header.destination == request.destination;
                let is_from = if request.broadcast {
                    header.from_non_working == request.to_non_working
                } else {
                    header.source == request.destination
                };
                header.service == request.service && is_to_sender && is_from
            })
    }

    /// The copy that a response is to; `None` if none can be.
    fn copy_of(&mut self, header: Header, now: Instant) -> Option<SentCopy> {
        let timeout = self.timeout;
        let is_late = |sent: SentCopy| now.since(sent.time) > timeout;
        while self.open.front().is_some_and(|sent| is_late(*sent)) {
            self.open.pop_front();
        }
        let is_targeted =
            self.requests.iter().any(|it| !it.broadcast && it.destination == header.source);
        if !is_targeted {
            let is_it = |sent: &&SentCopy| sent.to_non_working == header.from_non_working;
            let sender = 1 << header.source.number();
            let is_again = self.is_mixed && self.responders & sender != 0;
            self.responders |= sender;
            return self.open.iter().rev().find(is_it).copied().filter(|_| !is_again);
        }
        let sent = self.open.pop_front();
        let is_mixed = self.is_mixed;
        // A second board at the address answers, too.
        let again = self.answered.filter(|sent| !is_late(*sent));
        self.answered = sent.filter(|_| !is_mixed).or(self.answered);
        sent.or(again)
    }

    fn begin(
        &mut self,
        header: Header,
        mut answer: Answer,
        (length, data): (u32, &[u8]),
        frame: &Frame,
    ) -> Option<Answer> {
        let size = (length as usize).min(des::MAX_MESSAGE);
        let parts = Reassembly::start(frame.time, length, data, frame.len(), 0, vec![0; size]);
        answer.is_incomplete = true;
        let Ok(parts) = parts else { return Some(answer) };
        // The transfer before it did not end.
        if let Some(at) = self.transfers.iter().position(|it| it.header == header) {
            let broken = self.break_off(at);
            self.transfers.push(OpenTransfer { header, answer, parts });
            return Some(broken);
        }
        if self.transfers.len() == MAX_TRANSFERS {
            return Some(answer);
        }
        self.transfers.push(OpenTransfer { header, answer, parts });
        None
    }

    fn push_part(&mut self, at: usize, now: Instant, sequence: u8, data: &[u8]) -> Option<Answer> {
        match self.transfers[at].parts.push(now, sequence, data) {
            Ok(ReassemblyProgress::Done) => {
                let mut answer = self.break_off(at);
                answer.is_incomplete = false;
                Some(answer)
            }
            Ok(_) => None,
            Err(_) => Some(self.break_off(at)),
        }
    }

    /// Ends a transfer with the bytes that came.
    fn break_off(&mut self, at: usize) -> Answer {
        let OpenTransfer { mut answer, parts, .. } = self.transfers.swap_remove(at);
        answer.message = parts.message().to_vec();
        answer
    }
}
