//! Recent requests of all nodes, to which responses are matched.

use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use std::collections::VecDeque;

/// Maximum number of broadcasts stored to match late responses. Bounds the memory: two rounds in
/// both framings of two inspectors.
const MAX_BROADCASTS: usize = 16;
/// Time after a request in which responses that repeat its DST are matched to it. The longest
/// timeout of a query.
const BROADCAST_RESPONSE_WINDOW: Duration = Duration::from_secs(3);
/// Time after a request in which its address still counts as a requester: a device aborts each of
/// several responses that wait for flow control only after 1 s.
const REQUESTER_WINDOW: Duration = Duration::from_secs(10);

/// A broadcast name request that may still get responses.
#[derive(Clone, Copy, Debug)]
struct PendingBroadcast {
    time: Instant,
    rnd7: Address,
    is_own: bool,
}

/// Recent requests on one bus.
#[derive(Clone, Debug)]
pub(super) struct RecentRequests {
    broadcasts: VecDeque<PendingBroadcast>,
    /// Time of the last request from each address.
    last_request_at: [Option<Instant>; Address::COUNT],
}

impl RecentRequests {
    pub fn new() -> Self {
        Self { broadcasts: VecDeque::new(), last_request_at: [None; Address::COUNT] }
    }

    /// Notes a request from `source`.
    pub fn note_request(&mut self, now: Instant, source: Address) {
        self.last_request_at[source.index()] = Some(now);
    }

    /// Notes a broadcast request; `is_own`: sent by descan.
    pub fn note_broadcast(&mut self, now: Instant, rnd7: Address, is_own: bool) {
        if self.broadcasts.len() == MAX_BROADCASTS {
            self.broadcasts.pop_front();
        }
        self.broadcasts.push_back(PendingBroadcast { time: now, rnd7, is_own });
    }

    /// Returns true if that address sent a request recently.
    pub fn is_requester(&self, now: Instant, address: Address) -> bool {
        self.last_request_at[address.index()].is_some_and(|at| now.since(at) < REQUESTER_WINDOW)
    }

    /// Returns true if a request sent at that time may still get responses that repeat its DST.
    pub fn is_recent(now: Instant, sent: Instant) -> bool {
        now.since(sent) < BROADCAST_RESPONSE_WINDOW
    }

    /// Returns true if a recent broadcast had that RND7.
    pub fn has_broadcast(&self, now: Instant, rnd7: Address) -> bool {
        let mut recent = self.recent_broadcasts(now);
        recent.any(|broadcast| broadcast.rnd7 == rnd7)
    }

    /// Returns true if a recent broadcast of descan had that RND7.
    pub fn has_own_broadcast(&self, now: Instant, rnd7: Address) -> bool {
        let mut recent = self.recent_broadcasts(now);
        recent.any(|broadcast| broadcast.is_own && broadcast.rnd7 == rnd7)
    }

    /// Returns the time of the first recent broadcast of descan.
    pub fn first_own_broadcast(&self, now: Instant) -> Option<Instant> {
        self.recent_broadcasts(now).find(|broadcast| broadcast.is_own).map(|it| it.time)
    }

    fn recent_broadcasts(&self, now: Instant) -> impl Iterator<Item = &PendingBroadcast> {
        self.broadcasts.iter().filter(move |broadcast| Self::is_recent(now, broadcast.time))
    }
}
