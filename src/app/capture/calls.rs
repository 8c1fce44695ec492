//! Requests and the responses to them: who calls whom, how long it takes.
//!
//! Input: frames with their numbers. Output: statistics by client, server and service, and what each
//! frame is in its call. A response is to the oldest open request from its receiver to its sender, of
//! its service; if there is none, to the oldest open broadcast that its sender has not responded to,
//! unless a request that was responded to is later. A node that does not work responds to requests to
//! such nodes only. Of DES, a name response is to a name request, and a request that is sent in both
//! framings is one. A request that is open longer than the timeout is unanswered. Bounded: 1024 rows, 64
//! open requests in each, latencies of the last 1024 calls, the last 128 calls one by one. A frame of a
//! known row allocates nothing, but for the first 128 calls. Does not know how calls are shown.

use super::decoded::FrameRole;
use crate::frame::{BusIndex, CanId, Frame};
use crate::time::{Duration, Instant};
use crate::wire::des::{ReceivedRequest, Request};
use crate::wire::framing::{Framing, classify_request, classify_response};
use crate::wire::id::{Address, Header, Service};
use crate::wire::isotp::Pci;
use crate::wire::profile::Profile;
use foldhash::fast::RandomState;
use std::collections::{HashMap, VecDeque};

/// Largest number of rows.
const MAX_ROWS: usize = 1024;
/// Most requests of a row that are open.
const MAX_OPEN: usize = 64;
/// Longest time between a request and the same in the other framing.
const BOTH_FRAMINGS: Duration = Duration::from_millis(50);
/// Latencies that percentiles are of.
const LATENCIES: usize = 1024;
/// Calls of a row that are kept one by one.
const KEPT_CALLS: usize = 128;

/// Who calls whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CallKey {
    /// Bus.
    pub bus: BusIndex,
    /// Sender of the requests.
    pub client: Address,
    /// Receiver of the requests; `None` for broadcasts.
    pub server: Option<Address>,
    /// Service.
    pub service: Service,
}

/// A request that waits for a response.
#[derive(Clone, Copy, Debug)]
struct OpenCall {
    number: u64,
    time: Instant,
    /// Only nodes that do not work respond, with U = 1.
    to_non_working: bool,
    message: Option<DesMessage>,
    /// Addresses that responded to a broadcast, a bit for each.
    responders: u128,
}

impl OpenCall {
    /// Returns true if a response with this header and message may be to the request.
    fn is_request_of(&self, header: Header, message: Option<DesMessage>) -> bool {
        let is_to_message = match (self.message, message) {
            (Some(request), Some(response)) => request.kind == response.kind,
            _ => true,
        };
        is_to_message && self.to_non_working == header.from_non_working
    }
}

/// Type and framing of a DES message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct DesMessage {
    kind: u8,
    is_raw: bool,
}

impl DesMessage {
    fn of_request(frame: &Frame) -> Option<Self> {
        let (framing, message) = classify_request(frame.data(), frame.is_fd)?;
        let kind = match Request::decode(message)? {
            ReceivedRequest::Known(request) => request.type_byte(),
            ReceivedRequest::Reserved(kind) => kind,
        };
        Some(Self { kind, is_raw: framing == Framing::Raw })
    }

    fn of_response(frame: &Frame) -> Option<Self> {
        let data = frame.data();
        let framing = classify_response(data, frame.is_fd, true)?;
        let message = match Pci::decode(data, frame.is_fd) {
            _ if framing == Framing::Raw => data,
            Ok(Pci::Single(message) | Pci::First { data: message, .. }) => message,
            _ => return None,
        };
        Some(Self { kind: *message.first()?, is_raw: framing == Framing::Raw })
    }
}

/// What became of a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CallResult {
    /// No response yet, and the timeout is not over.
    Open,
    /// A response came.
    Answered,
    /// A response with ERR = 0 came.
    Failed,
    /// No response came before the timeout.
    Unanswered,
}

/// A request and the response to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Call {
    /// Number of the request in the capture.
    pub request: u64,
    /// Time of the request.
    pub time: Instant,
    /// Number of the response in the capture and time since the request; of several to a broadcast the
    /// last one.
    pub response: Option<(u64, Duration)>,
    /// Number of responses, with further ones of other boards at the address.
    pub responses: u32,
    /// What became of it.
    pub result: CallResult,
    /// Several equal requests were open: which of them the response is to is not certain.
    pub is_ambiguous: bool,
}

/// Statistics of the calls of one service from one node to another.
#[derive(Clone, Debug)]
pub struct CallStats {
    /// Who calls whom.
    pub key: CallKey,
    /// Number of requests.
    pub calls: u64,
    /// Number of requests in the last whole second.
    pub rate: u32,
    /// Number of responses.
    pub responses: u64,
    /// Number of responses with ERR = 0.
    pub failed: u64,
    /// Number of requests that no response came to in time.
    pub unanswered: u64,
    /// Number of responses that several equal requests were open for: which of them they are to is not
    /// certain.
    pub ambiguous: u64,
    /// Time of the last request.
    pub last: Instant,
    /// Its number in the capture.
    pub last_number: u64,
    current: u32,
    /// The last request that was responded to.
    answered: Option<OpenCall>,
    /// The last requests.
    recent: [Option<OpenCall>; 4],
    open: VecDeque<OpenCall>,
    /// In microseconds, of the last calls.
    latencies: VecDeque<u32>,
    /// The last calls, oldest first.
    kept: VecDeque<Call>,
}

/// Latencies of the last calls of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Latency {
    /// Half of the calls took at most so long.
    pub p50: Duration,
    /// 99 % of them.
    pub p99: Duration,
    /// The longest.
    pub max: Duration,
}

impl Latency {
    /// Returns the latencies of calls, given in microseconds; `None` without one.
    fn of(mut sorted: Vec<u32>) -> Option<Self> {
        sorted.sort_unstable();
        // The nearest rank.
        let rank = |percent: usize| (sorted.len() * percent).div_ceil(100).max(1) - 1;
        let at = |rank: usize| sorted.get(rank).map(|&it| Duration::from_micros(u64::from(it)));
        Some(Self { p50: at(rank(50))?, p99: at(rank(99))?, max: at(sorted.len() - 1)? })
    }
}

impl CallStats {
    fn new(key: CallKey) -> Self {
        Self {
            key,
            calls: 0,
            rate: 0,
            responses: 0,
            failed: 0,
            unanswered: 0,
            ambiguous: 0,
            last: Instant::ZERO,
            last_number: 0,
            current: 0,
            answered: None,
            recent: [None; 4],
            open: VecDeque::with_capacity(MAX_OPEN),
            latencies: VecDeque::with_capacity(LATENCIES),
            kept: VecDeque::new(),
        }
    }

    /// The last 128 calls, oldest first.
    pub fn kept_calls(&self) -> impl DoubleEndedIterator<Item = &Call> + ExactSizeIterator {
        self.kept.iter()
    }

    /// The kept call with this request.
    fn kept_mut(&mut self, request: u64) -> Option<&mut Call> {
        let at = self.kept.binary_search_by_key(&request, |call| call.request).ok()?;
        self.kept.get_mut(at)
    }

    /// Latencies of the last 1024 responses; `None` without one.
    pub fn latency(&self) -> Option<Latency> {
        self.latency_of_last(LATENCIES as u64)
    }

    /// Latencies of the last `responses`, at most 1024; `None` without one.
    pub fn latency_of_last(&self, responses: u64) -> Option<Latency> {
        let count = usize::try_from(responses).unwrap_or(usize::MAX);
        Latency::of(self.latencies.iter().rev().take(count).copied().collect())
    }

    /// Takes a request. Returns false if it is one before in the other framing.
    fn open(&mut self, call: OpenCall) -> bool {
        let OpenCall { number, time, .. } = call;
        let is_repeated = |before: &OpenCall| {
            let (Some(one), Some(other)) = (before.message, call.message) else { return false };
            one.kind == other.kind
                && one.is_raw != other.is_raw
                && before.to_non_working == call.to_non_working
                && time.since(before.time) <= BOTH_FRAMINGS
        };
        if self.recent.iter().flatten().any(is_repeated) {
            return false;
        }
        self.recent.rotate_right(1);
        self.recent[0] = Some(call);
        self.calls += 1;
        self.current += 1;
        (self.last, self.last_number) = (time, number);
        if self.open.len() == MAX_OPEN {
            self.close_oldest();
        }
        self.open.push_back(call);
        if self.kept.len() == KEPT_CALLS {
            self.kept.pop_front();
        }
        self.kept.push_back(Call {
            request: number,
            time,
            response: None,
            responses: 0,
            result: CallResult::Open,
            is_ambiguous: false,
        });
        true
    }

    fn close_oldest(&mut self) {
        let Some(call) = self.open.pop_front() else { return };
        if call.responders == 0 {
            self.unanswered += 1;
            if let Some(kept) = self.kept_mut(call.number) {
                kept.result = CallResult::Unanswered;
            }
        }
    }

    /// Ends the requests that are open for longer than the timeout.
    fn expire(&mut self, now: Instant, timeout: Duration) {
        while self.open.front().is_some_and(|call| now.since(call.time) > timeout) {
            self.close_oldest();
        }
    }

    /// Takes a response with this number; `None` if no request is open.
    fn respond(
        &mut self,
        (number, time): (u64, Instant),
        header: Header,
        message: Option<DesMessage>,
    ) -> Option<CallPart> {
        let sender = 1 << header.source.number();
        let is_to =
            |call: &OpenCall| call.is_request_of(header, message) && call.responders & sender == 0;
        let mut candidates = self.open.iter().enumerate().filter(|(_, call)| is_to(call));
        let (first, is_ambiguous) = (candidates.next()?.0, candidates.next().is_some());
        let call = if self.key.server.is_some() {
            self.open.remove(first)?
        } else {
            let call = self.open.get_mut(first)?;
            call.responders |= sender;
            *call
        };
        self.answered = Some(call);
        let latency = time.since(call.time);
        self.responses += 1;
        self.failed += u64::from(!header.no_error);
        self.ambiguous += u64::from(is_ambiguous);
        if self.latencies.len() == LATENCIES {
            self.latencies.pop_front();
        }
        self.latencies.push_back(u32::try_from(latency.as_micros()).unwrap_or(u32::MAX));
        if let Some(kept) = self.kept_mut(call.number) {
            kept.response = Some((number, latency));
            kept.responses += 1;
            kept.is_ambiguous |= is_ambiguous;
            // One failed response to a broadcast is enough.
            if kept.result != CallResult::Failed {
                kept.result =
                    if header.no_error { CallResult::Answered } else { CallResult::Failed };
            }
        }
        Some(CallPart::Response { request: call.number, latency, is_ambiguous })
    }

    /// Time of the last open request that a response may be to.
    fn last_open(&self, header: Header, message: Option<DesMessage>) -> Option<Instant> {
        let call = self.open.iter().rev().find(|call| call.is_request_of(header, message))?;
        Some(call.time)
    }

    /// Time of the last request that was responded to, if a response may be to it.
    fn last_answered(&self, header: Header, message: Option<DesMessage>) -> Option<Instant> {
        self.answered.filter(|call| call.is_request_of(header, message)).map(|call| call.time)
    }

    /// Takes a further response to the last request that was responded to, as of a second board at the
    /// address; it does not count. `None` for another one, or after the timeout.
    fn respond_again(
        &mut self,
        time: Instant,
        header: Header,
        message: Option<DesMessage>,
        timeout: Duration,
    ) -> Option<CallPart> {
        let call = self.answered.filter(|call| call.is_request_of(header, message))?;
        let latency = time.since(call.time);
        if latency <= timeout
            && let Some(kept) = self.kept_mut(call.number)
        {
            kept.responses += 1;
        }
        (latency <= timeout).then_some(CallPart::Response {
            request: call.number,
            latency,
            is_ambiguous: false,
        })
    }
}

/// What a frame is in a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CallPart {
    /// A request.
    Request {
        /// Number of responses.
        responses: u32,
        /// None came before the timeout.
        is_unanswered: bool,
    },
    /// A response.
    Response {
        /// Number of its request in the capture.
        request: u64,
        /// Time since the request.
        latency: Duration,
        /// Several equal requests were open.
        is_ambiguous: bool,
    },
}

/// Table of calls.
#[derive(Clone, Debug, Default)]
pub struct Calls {
    rows: Vec<CallStats>,
    index: HashMap<CallKey, u32, RandomState>,
    refused: u64,
}

/// Returns true for a request or a response to one, as far as the identifier says.
pub(super) fn is_call(frame: &Frame) -> bool {
    let CanId::Extended(id) = frame.id else { return false };
    let header = Header::decode(id);
    // Most frames are unsolicited.
    !(header.response && header.broadcast)
        && matches!(
            FrameRole::of(frame, false),
            FrameRole::Request | FrameRole::Response | FrameRole::FailedResponse
        )
}

impl Calls {
    /// Counts a frame of a bus that speaks DES with this profile. Returns the part of a call that it is,
    /// as far as that is known by now.
    pub fn add(&mut self, frame: &Frame, number: u64, profile: &Profile) -> Option<CallPart> {
        let CanId::Extended(id) = frame.id else { return None };
        let header = Header::decode(id);
        if !is_call(frame) {
            return None;
        }
        let is_des = header.service == profile.des_service();
        if is_des && is_continuation(frame) {
            return None;
        }
        let (client, server) = if header.response {
            (header.destination, header.source)
        } else {
            (header.source, header.destination)
        };
        let (bus, service) = (frame.bus, header.service);
        let timeout = profile.calls.timeout();
        let targeted = CallKey { bus, client, server: Some(server), service };
        let to_all = CallKey { server: None, ..targeted };
        if !header.response {
            let row = self.row(if header.broadcast { to_all } else { targeted })?;
            row.expire(frame.time, timeout);
            let message = is_des.then(|| DesMessage::of_request(frame)).flatten();
            let (time, to_non_working) = (frame.time, header.to_non_working);
            let is_new =
                row.open(OpenCall { number, time, to_non_working, message, responders: 0 });
            return is_new.then_some(CallPart::Request { responses: 0, is_unanswered: false });
        }
        let message = is_des.then(|| DesMessage::of_response(frame)).flatten();
        // A further response is to the later one of a targeted request and a broadcast.
        let is_further = self.get(&targeted).is_some_and(|one| {
            let all = self.get(&to_all).and_then(|all| all.last_open(header, message));
            one.last_answered(header, message) > all
        });
        let keys = if is_further { &[targeted][..] } else { &[targeted, to_all][..] };
        let answered = keys.iter().find_map(|key| {
            let row = self.rows.get_mut(*self.index.get(key)? as usize)?;
            row.expire(frame.time, timeout);
            row.respond((number, frame.time), header, message)
        });
        answered.or_else(|| {
            keys.iter().rev().find_map(|key| {
                let row = self.rows.get_mut(*self.index.get(key)? as usize)?;
                row.respond_again(frame.time, header, message, timeout)
            })
        })
    }

    /// The row with this key, a new one if there is none; `None` if the table is full.
    fn row(&mut self, key: CallKey) -> Option<&mut CallStats> {
        let at = match self.index.get(&key) {
            Some(&at) => at as usize,
            None if self.rows.len() == MAX_ROWS => {
                self.refused += 1;
                return None;
            }
            None => {
                self.index.insert(key, self.rows.len() as u32);
                self.rows.push(CallStats::new(key));
                self.rows.len() - 1
            }
        };
        self.rows.get_mut(at)
    }

    /// Ends a second for the rates, and the requests that are open for too long; `timeout` is that of a
    /// bus.
    pub fn tick(&mut self, now: Instant, timeout: impl Fn(BusIndex) -> Duration) {
        for row in &mut self.rows {
            row.rate = std::mem::take(&mut row.current);
            row.expire(now, timeout(row.key.bus));
        }
    }

    /// Bytes of memory, as of a copy.
    pub(super) fn size(&self) -> usize {
        let in_row = |row: &CallStats| {
            size_of::<(CallStats, CallKey, u32)>()
                + row.open.len() * size_of::<OpenCall>()
                + row.latencies.len() * size_of::<u32>()
                + row.kept.len() * size_of::<Call>()
        };
        self.rows.iter().map(in_row).sum()
    }

    /// Rows, in the order of their first requests.
    pub fn rows(&self) -> &[CallStats] {
        &self.rows
    }

    /// The row with this key; `None` without one.
    pub fn get(&self, key: &CallKey) -> Option<&CallStats> {
        self.rows.get(*self.index.get(key)? as usize)
    }

    /// Latencies on a bus: of the last 64 responses of each row; `None` without one.
    pub fn latency_on(&self, bus: BusIndex) -> Option<Latency> {
        let rows = self.rows.iter().filter(|row| row.key.bus == bus);
        Latency::of(rows.flat_map(|row| row.latencies.iter().rev().take(64)).copied().collect())
    }

    /// Number of requests without a row, because the table was full.
    pub fn refused(&self) -> u64 {
        self.refused
    }
}

/// Returns true for frames of a transfer behind the first one, and for flow control.
fn is_continuation(frame: &Frame) -> bool {
    let pci = Pci::decode(frame.data(), frame.is_fd);
    matches!(pci, Ok(Pci::Consecutive { .. } | Pci::Flow(_)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(millis: u64, response: bool, from: u8, to: u8, no_error: bool) -> Frame {
        let header = Header {
            from_non_working: false,
            to_non_working: false,
            response,
            broadcast: to == 127,
            no_error,
            source: Address::from_bits(from),
            destination: Address::from_bits(to),
            service: Service::from_bits(0x20),
        };
        Frame::classic(header.encode(), &[1]).with_time(Instant::from_micros(millis * 1000))
    }

    fn response(request: u64, millis: u64, is_ambiguous: bool) -> CallPart {
        let latency = Duration::from_millis(millis);
        CallPart::Response { request, latency, is_ambiguous }
    }

    #[test]
    fn responses_belong_to_the_oldest_open_request() {
        let (mut calls, profile) = (Calls::default(), Profile::default());
        let mut add = |number, frame| calls.add(&frame, number, &profile);
        add(0, frame(0, false, 1, 9, true));
        add(1, frame(10, false, 1, 9, true));
        assert_eq!(add(2, frame(12, true, 9, 1, true)), Some(response(0, 12, true)));
        assert_eq!(add(3, frame(15, true, 9, 1, false)), Some(response(1, 5, false)));
        let again = add(4, frame(16, true, 9, 1, true));
        assert_eq!(again, Some(response(1, 6, false)), "a second response, which does not count");
        // Of another client, and too late.
        add(5, frame(20, false, 1, 9, true));
        assert_eq!(add(6, frame(30, true, 9, 2, true)), None);
        assert_eq!(add(7, frame(1021, true, 9, 1, true)), None);
        // To all: each node responds once.
        add(8, frame(2000, false, 1, 127, true));
        assert_eq!(add(9, frame(2001, true, 8, 1, true)), Some(response(8, 1, false)));
        assert_eq!(add(10, frame(2003, true, 9, 1, true)), Some(response(8, 3, false)));
        calls.tick(Instant::from_micros(9_000_000), |_| Duration::from_secs(1));
        let [one, all] = calls.rows() else { panic!("two rows") };
        assert_eq!((one.calls, one.responses, one.failed, one.unanswered), (3, 2, 1, 1));
        assert_eq!((all.calls, all.responses, all.unanswered, all.ambiguous), (1, 2, 0, 0));
        let millis = Duration::from_millis;
        let latency = Latency { p50: millis(5), p99: millis(12), max: millis(12) };
        assert_eq!(one.latency(), Some(latency));
    }

    #[test]
    fn second_response_to_a_request_is_not_to_an_earlier_broadcast() {
        let (mut calls, profile) = (Calls::default(), Profile::default());
        let mut add = |number, frame| calls.add(&frame, number, &profile);
        let response = |request, millis| response(request, millis, false);
        add(0, frame(0, false, 1, 127, true));
        assert_eq!(add(1, frame(2, true, 9, 1, true)), Some(response(0, 2)));
        add(2, frame(500, false, 1, 9, true));
        assert_eq!(add(3, frame(503, true, 9, 1, true)), Some(response(2, 3)));
        assert_eq!(add(4, frame(504, true, 9, 1, true)), Some(response(2, 4)), "of a second board");
        add(5, frame(1600, false, 1, 127, true));
        assert_eq!(
            add(6, frame(1605, true, 9, 1, true)),
            Some(response(5, 5)),
            "the later request"
        );
    }

    #[test]
    fn responses_to_equal_broadcasts_are_to_the_oldest_not_answered() {
        let (mut calls, profile) = (Calls::default(), Profile::default());
        let mut add = |number, frame| calls.add(&frame, number, &profile);
        add(0, frame(0, false, 1, 127, true));
        add(1, frame(300, false, 1, 127, true));
        assert_eq!(add(2, frame(350, true, 10, 1, true)), Some(response(0, 350, true)));
        assert_eq!(add(3, frame(351, true, 11, 1, true)), Some(response(0, 351, true)));
        assert_eq!(add(4, frame(352, true, 10, 1, true)), Some(response(1, 52, false)));
        assert_eq!(add(5, frame(353, true, 10, 1, true)), Some(response(1, 53, false)), "again");
        calls.tick(Instant::from_micros(9_000_000), |_| Duration::from_secs(1));
        let all = &calls.rows()[0];
        assert_eq!((all.calls, all.responses, all.unanswered, all.ambiguous), (2, 3, 0, 2));
    }

    #[test]
    fn table_and_open_requests_are_bounded() {
        let (mut calls, profile) = (Calls::default(), Profile::default());
        for number in 0..200_000u64 {
            let mut request = frame(number, false, (number % 101) as u8, 9, true);
            let id = request.platform_id().unwrap() & !0x3FF | ((number % 900) as u32 + 3);
            request = Frame::classic(id, &[]).with_time(request.time);
            calls.add(&request, number, &profile);
        }
        assert_eq!(calls.rows().len(), MAX_ROWS);
        assert!(calls.rows().iter().all(|row| row.open.len() <= MAX_OPEN));
        assert!(calls.rows().iter().all(|row| row.kept.len() <= KEPT_CALLS));
    }
}
