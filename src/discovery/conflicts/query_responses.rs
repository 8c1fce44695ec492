//! Responses of one address, matched to the requests that it received. A response beyond the number
//! of requests shows a second responder (protocol §5.2).

use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header};
use std::collections::VecDeque;

/// Longest delay of a response that is matched to a request. As the longest collection time of a
/// round.
const RESPONSE_WINDOW: Duration = Duration::from_secs(2);

/// Requester and kind of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub(in crate::discovery) struct RequestOrigin {
    pub requester: Address,
    /// True if one node was addressed (B bit 0).
    pub is_targeted: bool,
}

/// Matches responses to requests, for one kind of request in one framing, separately for each
/// requester.
#[derive(Clone, Debug, Default)]
pub(super) struct QueryResponseMatcher {
    /// At most [`REQUESTERS`].
    open_queries: Vec<OpenQueries>,
}

/// Maximum number of requesters to one node that are distinguished. Chosen: more inspectors are
/// rarely on one bus.
const REQUESTERS: usize = 4;
/// Maximum number of requests without a response of one requester. Bounds the memory: attempts of
/// both queries in both framings.
const MAX_OPEN_REQUESTS: usize = 16;

/// Longest interval of polling. Chosen: half of that of follow-up requests.
const POLLING: Duration = Duration::from_millis(500);
/// Shortest interval of requests of which the second one is not the first one again with the other D
/// bit. Chosen: several frames at 125 kbit/s.
const MIN_INTERVAL: Duration = Duration::from_millis(5);
/// Number of requests in a row that show polling: then a response to a request that was lost follows
/// the one before by an interval. Chosen: twice the attempts of one query.
const MIN_POLLED: u8 = 8;

/// Requests of one requester that may still get responses.
#[derive(Clone, Debug)]
struct OpenQueries {
    by: Address,
    /// True if none of them was a broadcast.
    is_targeted: bool,
    /// Times of the requests without a response.
    without_response: VecDeque<Instant>,
    sent_at: Instant,
    /// Usual time between requests, and the number of requests in a row that came within
    /// [`POLLING`] of the one before.
    interval: Duration,
    polled: u8,
    /// True if the last interval was longer than the usual one: a request was lost, or they come
    /// less often now.
    was_longer: bool,
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
    fn new(now: Instant, by: Address) -> Self {
        Self {
            by,
            is_targeted: true,
            without_response: VecDeque::new(),
            sent_at: now,
            interval: Duration::ZERO,
            polled: 0,
            was_longer: false,
            first_response: None,
        }
    }

    /// Returns how long after the first response another one belongs to the same request.
    fn window(&self, window: Duration) -> Duration {
        if self.polled >= MIN_POLLED { window.min(self.interval / 2) } else { window }
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
        let interval = now.since(self.sent_at);
        if interval > POLLING {
            self.polled = 0;
        } else if interval >= MIN_INTERVAL {
            self.polled = self.polled.saturating_add(1);
            // That of a lost request is twice as long.
            let is_longer = self.polled > 1 && interval >= self.interval * 3 / 2;
            if !is_longer || self.was_longer {
                self.interval = interval;
            }
            self.was_longer = is_longer;
        }
        self.sent_at = now;
        self.first_response = None;
    }
}

impl QueryResponseMatcher {
    /// Notes a request.
    pub fn note_request(&mut self, now: Instant, parties: RequestOrigin) {
        let open_queries = &mut self.open_queries;
        let by = |open: &OpenQueries| open.by == parties.requester;
        let at = open_queries.iter().position(by).unwrap_or_else(|| {
            let open = OpenQueries::new(now, parties.requester);
            if open_queries.len() < REQUESTERS {
                open_queries.push(open);
                return open_queries.len() - 1;
            }
            // Replace the requester with the oldest request.
            let oldest = (0..REQUESTERS).min_by_key(|at| open_queries[*at].sent_at).unwrap_or(0);
            open_queries[oldest] = open;
            oldest
        });
        open_queries[at].add(now, parties.is_targeted);
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
        let mut open = self.open_queries.iter_mut().filter(fresh);
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
        if !more || apart >= open.window(window) {
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
