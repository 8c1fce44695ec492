//! History of one address, used to tell two senders apart: names, UIDs and service lists that
//! alternate, responses matched to requests, the pattern of heartbeats.
//!
//! Does not decide what an observation means: [`super::conflict_detector`] does.

use crate::frame::Frame;
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::des::Request;
use crate::wire::framing::Framing;
use crate::wire::id::{Address, Header};
use crate::wire::node::Uid;
use std::collections::VecDeque;

/// Longest delay of a response that is matched to a request.
const RESPONSE_WINDOW: Duration = Duration::from_secs(2);

/// Two responses to one request are less than this apart.
pub(super) const PAIR_WINDOW: Duration = Duration::from_millis(125);
/// A heartbeat received again within this time was repeated on its way, if it is not known whether
/// its sender generates RND7. Two devices that do not, and so send equal heartbeats, are rarely
/// this close.
pub(super) const HEARTBEAT_COPY_WINDOW: Duration = Duration::from_millis(100);

/// Most values remembered of one address: names, UIDs or service lists.
const MAX_VALUES: usize = 8;

/// Detects values that return to an address: A, B, A or A, B, C, A.
#[derive(Debug)]
pub(super) struct RecentValues<T> {
    current: Option<RecentValue<T>>,
    /// Values before the current one, the one that was current last at the end.
    earlier: VecDeque<RecentValue<T>>,
    return_count: u32,
    /// Time at which another value became current.
    changed_at: Instant,
}

/// A value, since when it is remembered, and when another one took its place.
#[derive(Debug)]
struct RecentValue<T> {
    value: T,
    since: Instant,
    left_at: Instant,
}

impl<T> Default for RecentValues<T> {
    fn default() -> Self {
        Self { current: None, earlier: VecDeque::new(), return_count: 0, changed_at: Instant::ZERO }
    }
}

impl<T: PartialEq + Clone> RecentValues<T> {
    /// Takes the current value. Returns how often in a row a value returned, if it did just now. A
    /// value that was not current for longer than `forget_after` is forgotten.
    pub fn observe(&mut self, now: Instant, value: &T, forget_after: Duration) -> Option<u32> {
        if self.current() == Some(value) {
            return None;
        }
        self.earlier.retain(|earlier| now.since(earlier.left_at) <= forget_after);
        if self.earlier.is_empty() {
            self.return_count = 0;
        }
        let known = self.earlier.iter().position(|earlier| earlier.value == *value);
        let returned = known.and_then(|at| self.earlier.remove(at));
        // More values than are remembered: it may be one of those that were forgotten.
        let is_return = returned.is_some() || self.earlier.len() == MAX_VALUES - 1;
        self.return_count = if is_return { self.return_count + 1 } else { 0 };
        let since = returned.map_or(now, |returned| returned.since);
        let next = RecentValue { value: value.clone(), since, left_at: now };
        if let Some(left) = self.current.replace(next) {
            if self.earlier.len() == MAX_VALUES - 1 {
                self.earlier.pop_front();
            }
            self.earlier.push_back(RecentValue { left_at: now, ..left });
        }
        self.changed_at = now;
        is_return.then_some(self.return_count)
    }

    /// The current value.
    pub fn current(&self) -> Option<&T> {
        self.current.as_ref().map(|current| &current.value)
    }

    /// The value before the current one.
    pub fn previous(&self) -> Option<&T> {
        self.earlier.back().map(|earlier| &earlier.value)
    }

    /// Returns true if there was another value less than `within` ago.
    pub fn changed_within(&self, now: Instant, within: Duration) -> bool {
        self.previous().is_some() && now.since(self.changed_at) < within
    }

    /// Time since when two of the values are there.
    pub fn second_since(&self) -> Instant {
        let all = self.earlier.iter().chain(&self.current).map(|value| value.since);
        let (_, second) = all.fold((None, None), |(first, second), since| match first {
            Some(first) if since >= first => {
                (Some(first), Some(second.map_or(since, |second: Instant| second.min(since))))
            }
            _ => (Some(since), first),
        });
        second.unwrap_or(self.changed_at)
    }
}

/// Requester and kind of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub(super) struct RequestOrigin {
    pub requester: Address,
    /// True if one node was addressed (B bit 0).
    pub is_targeted: bool,
}

/// Matches responses to requests, for one kind of request in one framing, separately for each
/// requester.
#[derive(Debug, Default)]
pub(super) struct QueryResponseMatcher {
    open_queries: [Option<OpenQueries>; REQUESTERS],
}

/// Maximum number of requesters to one node that are told apart.
const REQUESTERS: usize = 4;
/// Maximum number of requests without a response of one requester.
const MAX_OPEN_REQUESTS: usize = 16;

/// Requests of one requester that may still get responses.
#[derive(Debug)]
struct OpenQueries {
    by: Address,
    /// True if none of them was a broadcast.
    is_targeted: bool,
    /// Times of the requests without a response.
    without_response: VecDeque<Instant>,
    sent_at: Instant,
    /// First response since the last request, with its time.
    first_response: Option<(Instant, Frame)>,
}

/// A response beyond the number of requests.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurplusResponse {
    /// First response to the request.
    pub first: Frame,
    /// Time from the first response to this one.
    pub apart: Duration,
    /// True if only one node was addressed.
    pub is_targeted: bool,
}

impl OpenQueries {
    fn new(by: Address) -> Self {
        let sent_at = Instant::ZERO;
        Self {
            by,
            is_targeted: true,
            without_response: VecDeque::new(),
            sent_at,
            first_response: None,
        }
    }

    fn add(&mut self, now: Instant, targeted: bool) {
        // A request without a response in time, perhaps because no device was there yet, must not
        // account for a second response to a later request.
        self.without_response.retain(|sent_at| now.since(*sent_at) <= RESPONSE_WINDOW);
        self.is_targeted = targeted && (self.without_response.is_empty() || self.is_targeted);
        if self.without_response.len() == MAX_OPEN_REQUESTS {
            self.without_response.pop_front();
        }
        self.without_response.push_back(now);
        self.sent_at = now;
        self.first_response = None;
    }
}

impl QueryResponseMatcher {
    /// Notes a request.
    pub fn note_request(&mut self, now: Instant, parties: RequestOrigin) {
        let by = |open: &Option<OpenQueries>| {
            open.as_ref().is_some_and(|open| open.by == parties.requester)
        };
        let at = self.open_queries.iter().position(by).unwrap_or_else(|| {
            // Replace the requester with the oldest request.
            let sent_at = |at: &usize| self.open_queries[*at].as_ref().map(|open| open.sent_at);
            let oldest = (0..REQUESTERS).min_by_key(sent_at).unwrap_or(0);
            self.open_queries[oldest] = None;
            oldest
        });
        let open = self.open_queries[at].get_or_insert_with(|| OpenQueries::new(parties.requester));
        open.add(now, parties.is_targeted);
    }

    /// Counts a response for requester `to`, or, where that is `None`, for a requester that still
    /// waits for one. Returns whether it responds to a broadcast, and the surplus response, if it
    /// is less than `window` after the first one.
    pub fn match_response(
        &mut self,
        now: Instant,
        to: Option<Address>,
        window: Duration,
        frame: &Frame,
    ) -> (bool, Option<SurplusResponse>) {
        let fresh = |open: &&mut OpenQueries| now.since(open.sent_at) <= RESPONSE_WINDOW;
        let mut open = self.open_queries.iter_mut().flatten().filter(fresh);
        let open = match to {
            Some(to) => open.find(|open| open.by == to),
            None => open.min_by_key(|open| (open.without_response.is_empty(), open.sent_at)),
        };
        let Some(open) = open else { return (false, None) };
        // Of several requests, the newest is the most likely to get the response.
        let awaited = open.without_response.pop_back().is_some();
        let (first_at, first) = *open.first_response.get_or_insert((now, *frame));
        let apart = now.since(first_at);
        let targeted = open.is_targeted;
        // Working and non-working nodes respond to different requests. A response much later than
        // the first belongs to a request that descan did not receive.
        let more = !awaited || differ_in_mode(&first, frame);
        if !more || apart >= window {
            return (!targeted, None);
        }
        (!targeted, Some(SurplusResponse { first, apart, is_targeted: targeted }))
    }
}

/// Returns true if the two frames differ in the U bit.
fn differ_in_mode(one: &Frame, other: &Frame) -> bool {
    let not_working =
        |frame: &Frame| frame.platform_id().map(|id| Header::decode(id).from_non_working);
    not_working(one) != not_working(other)
}

/// A heartbeat with its time of reception.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeartbeatRecord {
    pub time: Instant,
    pub frame: Frame,
}

/// Timing pattern of the heartbeats from one address.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HeartbeatPattern {
    /// Heartbeats arrive at twice the rate.
    pub double_rate: bool,
    /// Heartbeats arrive in two or more distinct phases.
    pub two_phases: bool,
    /// Since when two devices are present, if either flag is set.
    pub since: Option<Instant>,
}

/// History of one address.
#[derive(Debug, Default)]
pub(super) struct AddressHistory {
    pub names: RecentValues<Name>,
    pub uids: RecentValues<Uid>,
    pub services: RecentValues<u64>,
    pub working: RecentValues<bool>,
    /// Time of the last frame of a non-working node and of a working node, indexed by `working`.
    pub seen: [Option<Instant>; 2],
    /// True if the previous request was sent with both values of the D bit.
    pub sent_both: bool,
    pub matchers: [[QueryResponseMatcher; 2]; 2],
    pub heartbeats: VecDeque<HeartbeatRecord>,
    /// Times of the last heartbeats, at most [`MAX_HEARTBEAT_TIMES`].
    heartbeat_times: VecDeque<Instant>,
    /// Number of consecutive heartbeats at twice the rate.
    pub double_rate_count: u32,
}

/// Returns true if long and short gaps alternate far more regularly than by chance: two steady
/// senders almost half a period apart.
fn has_two_phases(gaps: &[f64]) -> bool {
    let range = |from: usize| {
        let every_other = gaps.iter().skip(from).step_by(2);
        every_other.fold((f64::MAX, f64::MIN), |(low, high), &gap| (low.min(gap), high.max(gap)))
    };
    let (even, odd) = (range(0), range(1));
    let apart = (even.0 - odd.1).max(odd.0 - even.1);
    apart > 0.04 && apart > 3.0 * (even.1 - even.0).max(odd.1 - odd.0)
}

/// Returns true if gaps repeat in a cycle of `senders` gaps and differ within it: that many steady
/// senders. One sender with a shorter period has equal gaps.
fn is_cycle(gaps: &[f64], senders: usize) -> bool {
    let is_period = |cycle: &[f64]| (0.9..=1.1).contains(&cycle.iter().sum());
    let repeats = gaps.iter().zip(&gaps[senders..]).map(|(gap, next)| (gap - next).abs());
    let noise = repeats.fold(0.0, f64::max);
    let longest = gaps.iter().copied().fold(0.0, f64::max);
    let shortest = gaps.iter().copied().fold(f64::MAX, f64::min);
    let contrast = longest - shortest;
    gaps.windows(senders).all(is_period) && contrast > 0.04 && contrast > 3.0 * noise
}

/// Heartbeats stored per address: seven intervals.
const MAX_HEARTBEATS: usize = 8;
/// Maximum number of senders at one address that are distinguished by their phases.
const MAX_PHASES: usize = 8;
/// Heartbeat times stored per address: two cycles of that many senders.
const MAX_HEARTBEAT_TIMES: usize = 2 * MAX_PHASES + 1;

impl AddressHistory {
    /// Returns the matcher for this kind of request and framing.
    pub fn matcher(&mut self, request: Request, framing: Framing) -> &mut QueryResponseMatcher {
        &mut self.matchers[request as usize][framing as usize]
    }

    /// Adds a heartbeat. Returns false if it is a copy of the previous one: equal including RND7,
    /// received at once, from a sender that generates a new RND7 each time.
    pub fn note_heartbeat(&mut self, now: Instant, frame: &Frame, period: Duration) -> bool {
        if let Some(last) = self.heartbeats.back()
            && last.frame.same_on_wire(frame)
        {
            let mut older = self.heartbeats.iter().rev().skip(1);
            // Two successive heartbeats show whether the sender generates RND7.
            let next = older.find(|heartbeat| last.time.since(heartbeat.time) > period / 2);
            let within = match next.map(|heartbeat| heartbeat.frame.same_on_wire(frame)) {
                Some(true) => Duration::ZERO,
                Some(false) => period / 2,
                None => HEARTBEAT_COPY_WINDOW,
            };
            if now.since(last.time) <= within {
                return false;
            }
        }
        if self.heartbeats.len() == MAX_HEARTBEATS {
            self.heartbeats.pop_front();
        }
        self.heartbeats.push_back(HeartbeatRecord { time: now, frame: *frame });
        if self.heartbeat_times.len() == MAX_HEARTBEAT_TIMES {
            self.heartbeat_times.pop_front();
        }
        self.heartbeat_times.push_back(now);
        true
    }

    /// Returns true if more heartbeats arrived in the last three periods than one steady sender has.
    pub fn has_several_senders(&self, period: Duration) -> bool {
        let Some(last) = self.heartbeat_times.back() else { return false };
        let recent = |time: &&Instant| last.since(**time) < period * 3;
        self.heartbeat_times.iter().rev().take_while(recent).count() >= 5
    }

    /// Returns since when at least two of three or more senders are present, by their phases;
    /// `None` if the last heartbeats have no such cycle.
    fn cycle_since(&self, period: Duration) -> Option<Instant> {
        let times = &self.heartbeat_times;
        // Two cycles of three senders are the fewest: six gaps in two periods.
        let seventh = *times.iter().rev().nth(6)?;
        if times.back()?.since(seventh) > period.mul_f64(2.2) {
            return None;
        }
        let mut gaps = [0.0; MAX_HEARTBEAT_TIMES - 1];
        let pairs = times.iter().zip(times.iter().skip(1));
        for (gap, (one, next)) in gaps.iter_mut().zip(pairs) {
            *gap = next.since(*one).as_secs_f64() / period.as_secs_f64();
        }
        let gaps = &gaps[..times.len().saturating_sub(1)];
        let senders = (3..=MAX_PHASES).take_while(|senders| 2 * senders <= gaps.len());
        let first = |senders: &usize| gaps.len() - 2 * senders;
        let senders = senders.into_iter().find(|it| is_cycle(&gaps[first(it)..], *it))?;
        times.get(first(&senders) + 1).copied()
    }

    /// Returns the timing pattern of the stored heartbeats.
    pub fn heartbeat_pattern(&self, period: Duration) -> HeartbeatPattern {
        let Some(last) = self.heartbeats.back() else { return HeartbeatPattern::default() };
        let recent =
            self.heartbeats.iter().filter(|heartbeat| last.time.since(heartbeat.time) < period * 4);
        // The newest heartbeat must be early, or the double rate has already ended.
        let before = self.heartbeats.iter().rev().nth(1);
        let soon =
            before.is_some_and(|heartbeat| last.time.since(heartbeat.time) < period.mul_f64(0.85));
        let double_rate = soon && recent.count() >= 7;
        // This many heartbeats show two devices for at least a period.
        let rate =
            HeartbeatPattern { double_rate, two_phases: false, since: Some(last.time - period) };
        if self.heartbeats.len() < MAX_HEARTBEATS - 1 {
            return rate;
        }
        if let Some(since) = self.cycle_since(period) {
            return HeartbeatPattern { two_phases: true, since: Some(since), ..rate };
        }
        let period = period.as_secs_f64();
        let mut gaps = [0.0; MAX_HEARTBEATS - 1];
        let pairs = self.heartbeats.iter().zip(self.heartbeats.iter().skip(1));
        let mut count = 0;
        for (gap, (a, b)) in gaps.iter_mut().zip(pairs) {
            *gap = b.time.since(a.time).as_secs_f64() / period;
            count += 1;
        }
        let gaps = &gaps[..count];
        let full_period = gaps.windows(2).all(|two| (0.85..=1.15).contains(&(two[0] + two[1])));
        let apart = gaps.windows(2).all(|two| (two[0] - two[1]).abs() > 0.15);
        // If one of the two stopped, the newest gap is a full period.
        let continues = (gaps[count - 1] - gaps[count - 3]).abs() < 0.1;
        if full_period && continues && (apart || has_two_phases(gaps)) {
            // Both senders were present at the second heartbeat, or, if the first gap is a full
            // period, at the third.
            let short = gaps.iter().copied().fold(f64::MAX, f64::min);
            let alone = (gaps[0] - gaps[2]).abs() > short / 4.0;
            let second = self.heartbeats.get(1 + usize::from(alone));
            return HeartbeatPattern {
                two_phases: true,
                since: second.map(|heartbeat| heartbeat.time),
                ..rate
            };
        }
        rate
    }
}
