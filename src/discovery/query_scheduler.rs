//! Query scheduler: decides which request is sent to which device when. Enumeration rounds, names
//! of nodes found between rounds, services; with timeouts, limited attempts, back-off, and within
//! the transmit budget (protocol §4).

use super::device::{QueryFault, QueryState};
use super::device_tracker::{DeviceTracker, RESPONSE_TIME, RESPONSE_WAIT_BITS};
use super::presence::is_claim_only;
use super::requester::Requester;
use super::rounds::RoundStep;
use super::{Device, DeviceId, NO_TIMEOUT, Presence, Query};
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::des::Request;
use crate::wire::framing::Framing;
use crate::wire::id::{Address, Header};
use crate::wire::isotp;
use crate::wire::profile::Profile;

/// Maximum number of queries that wait for a response: enough to keep a fast bus busy. Tuned with
/// the simulation.
const MAX_WAITING: usize = 12;
/// Attempts to query services before a pause. Chosen: with back-off they take 3 s.
const SERVICES_ATTEMPTS: u32 = 4;
/// Attempts to query a name before an enumeration round. Chosen: the round asks again.
const NAME_ATTEMPTS: u32 = 2;
/// Pause after the last attempt of a query. Chosen: three rounds at their default period.
const RETRY_DELAY: Duration = Duration::from_secs(30);
/// Age of the last request whose response may be among lost frames. Chosen: a driver reports a loss
/// with the next frame that it keeps, and one attempt takes up to 3 s.
const LOST_RESPONSE_TIME: Duration = Duration::from_secs(5);
/// Time after the start of a round at which nodes without a name are queried one by one. As the
/// longest collection time of a round.
const ROUND_WAIT_LIMIT: Duration = Duration::from_secs(2);

/// Time after which a query of devices in conflict is tried again while one of them responds. Some
/// frames at the STmin for shared addresses.
const TRANSFER_WAIT: Duration = Duration::from_millis(50);

/// Number of queries that wait for a response.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WaitingQueries {
    /// To devices that speak DES.
    known: usize,
    /// To other nodes.
    others: usize,
}

impl WaitingQueries {
    /// Returns true if one more query may be sent, of `most`. One slot is left to devices that speak
    /// DES: others may be many, and each takes its slot until the timeout.
    fn has_slot(self, is_known: bool, most: usize) -> bool {
        let is_free = self.known + self.others < most;
        is_free && (is_known || self.others + 1 < most.max(2))
    }

    fn add(&mut self, is_known: bool) {
        *if is_known { &mut self.known } else { &mut self.others } += 1;
    }
}

impl Requester {
    /// Sends the requests that are due and expires those without a response. `transferring`: the
    /// sources of multi-frame responses under way, one bit each.
    pub(super) fn send_due_queries(&mut self, tracker: &mut DeviceTracker, transferring: u128) {
        self.expire_queries(tracker);
        if tracker.config.listen_only
            && let Some(began) = self.rounds.end_recorded(tracker.now, &tracker.config)
        {
            tracker.finish_round(began);
        }
        let Some(own) = self.local_node.held() else { return };
        if !tracker.config.send_requests
            || self.is_yielded
            || self.outbox.is_paused()
            || self.is_left_alone(tracker)
        {
            return;
        }
        self.refill(tracker);
        self.step_round(tracker, own);
        self.send_device_queries(tracker, own, transferring);
    }

    /// Returns the share of the bus for requests, in bit/s.
    fn share(&self, tracker: &DeviceTracker) -> f64 {
        let busy = self.rounds.is_starting();
        let share = if busy { tracker.config.startup_budget } else { tracker.config.steady_budget };
        share * f64::from(tracker.config.bits_per_second())
    }

    fn refill(&mut self, tracker: &DeviceTracker) {
        // The budget holds at most 0.1 s of the share, and at least one round.
        let rate = self.share(tracker);
        self.outbox.refill(tracker.now, rate, (rate / 10.0).max(800.0));
    }

    /// Starts or finishes an enumeration round when due.
    fn step_round(&mut self, tracker: &mut DeviceTracker, own: Address) {
        let now = tracker.now;
        let known = tracker.device_table.discoveries;
        let open = self.open_queries(tracker);
        match self.rounds.step(now, &tracker.config, open, known) {
            RoundStep::None => {}
            RoundStep::Send if let Some(until) = self.heartbeats_wait_until(tracker) => {
                self.rounds.postpone(until);
            }
            RoundStep::Send if !self.outbox.has_budget() => {
                self.rounds.postpone(self.outbox.budget_at(self.share(tracker)));
            }
            RoundStep::Send => {
                tracker.defer_to_round();
                let framings = tracker.config.profile.framings(None);
                for to_not_working in [true, false] {
                    for &framing in framings {
                        self.send_broadcast(tracker, own, to_not_working, framing);
                    }
                }
                let count = if tracker.config.has_loopback { 2 * framings.len() as u32 } else { 0 };
                self.rounds.note_requests(count);
            }
            RoundStep::Over { began } => tracker.finish_round(began),
        }
    }

    /// Returns the number of services queries that a round at start waits for.
    fn open_queries(&self, tracker: &DeviceTracker) -> usize {
        if !self.rounds.is_starting() {
            return 0;
        }
        let present = tracker.device_table.devices().iter().filter(|device| device.is_present());
        present.filter(|device| super::is_open(&device.services_query)).count()
    }

    fn send_broadcast(
        &mut self,
        tracker: &mut DeviceTracker,
        own: Address,
        to_not_working: bool,
        framing: Framing,
    ) {
        let mut rnd7 = Address::from_bits(self.rng.u8(..128));
        if rnd7 == own {
            rnd7 = Address::from_bits(own.number() ^ 0x40);
        }
        let service = tracker.config.profile.des_service();
        let header = Header::broadcast(own, rnd7.number(), to_not_working, service);
        tracker.recent_requests.note_broadcast(tracker.now, rnd7, true);
        self.send_request(tracker, header, Request::Name, framing);
    }

    fn send_request(
        &mut self,
        tracker: &DeviceTracker,
        mut header: Header,
        request: Request,
        framing: Framing,
    ) {
        header.no_error = tracker.config.profile.request_err;
        let (data, len) = Profile::request_bytes(request, framing);
        self.outbox.push(Frame::classic(header.encode(), &data[..len]));
    }

    /// Sends the targeted requests that are due.
    fn send_device_queries(
        &mut self,
        tracker: &mut DeviceTracker,
        own: Address,
        transferring: u128,
    ) {
        let now = tracker.now;
        if self.rounds.priority_until(now).is_some()
            || self.heartbeats_wait_until(tracker).is_some()
        {
            return;
        }
        let window = tracker.response_window();
        let max_waiting = self.idle.max_open(MAX_WAITING, &tracker.config);
        let on_the_bus = self.idle.duration_of_bits(RESPONSE_WAIT_BITS, &tracker.config);
        let requests = [Request::Name, Request::Services];
        let turns = [true, false].map(|is_known| requests.map(|request| (is_known, request)));
        for (is_known, request) in turns.into_iter().flatten() {
            // In the order of addresses: responses of lower ones have priority on the bus, so
            // responses arrive in the order of the requests and none waits behind later ones.
            for address in Address::all() {
                if !self.outbox.has_budget() {
                    return;
                }
                if !self.waiting.has_slot(is_known, max_waiting) {
                    break;
                }
                let in_conflict = tracker.conflicts.finding_tracker().is_open_at(address)
                    && !tracker.errors.is_suspect(address);
                let shared = in_conflict && request == Request::Services;
                let Some(device) = tracker.device_table.current_device_mut(address) else {
                    continue;
                };
                if speaks_des(device) != is_known {
                    continue;
                }
                // Two multi-frame responses at once destroy each other: keep the known services
                // until one device has left, unless that effect itself is under test.
                if shared && device.services.is_some() && !device.asks_all_services {
                    device.services_query.due = None;
                    continue;
                }
                let (working, framing) = (device.is_working, device.framing);
                // During address resolution its next mode is unknown.
                let undecided = device.is_resolving && !working;
                // Another node may have claimed the address of a lost device.
                let is_there =
                    device.presence != Presence::Lost || device.last_heartbeat_was_other_node;
                let usable = is_there && address != own;
                let query = device.query_mut(request);
                if query.is_waiting() || query.due.is_none_or(|due| due > now) {
                    continue;
                }
                if !usable {
                    query.due = None;
                    continue;
                }
                // Flow control would release any other response of the other device too.
                let other = device.query(other_request(request));
                let wait = if other.is_waiting() { RESPONSE_TIME } else { TRANSFER_WAIT };
                let is_responding = transferring & (1 << address.number()) != 0;
                if in_conflict && (is_responding || other.is_sent_within(now, wait)) {
                    device.query_mut(request).due = Some(now + TRANSFER_WAIT);
                    continue;
                }
                let query = device.query_mut(request);
                if let Some(later) = tracker.errors.postpone_recheck(now, address, window) {
                    query.due = Some(later);
                    continue;
                }
                let query = device.query_mut(request);
                query.state = QueryState::Sent;
                query.attempts += 1;
                query.sent_at = Some(now);
                query.due = None;
                query.deadline = Some(now + response_timeout(on_the_bus, query.attempts));
                self.waiting.add(is_known);
                let is_last = query.attempts >= max_attempts(request);
                // A device that no longer responds in its framing may be another board.
                let framing = framing.filter(|_| !is_last);
                device.asks_all_services =
                    device.asks_all_services && (request == Request::Name || !is_last);
                let service = tracker.config.profile.des_service();
                let both = undecided
                    || request == Request::Name
                        && tracker.conflicts.needs_both_d_bits(now, address);
                for to_not_working in [false, true] {
                    if to_not_working == working && !both {
                        continue;
                    }
                    let header = Header::request(own, address, to_not_working, service);
                    for &framing in tracker.config.profile.framings(framing) {
                        self.send_request(tracker, header, request, framing);
                    }
                }
            }
        }
    }

    /// Records queries whose response is overdue as failed.
    fn expire_queries(&mut self, tracker: &mut DeviceTracker) {
        let now = tracker.now;
        let mut waiting = WaitingQueries::default();
        let mut needs_round = false;
        for device in tracker.device_table.devices_mut() {
            let (named, is_known) = (device.name.is_some(), speaks_des(device));
            for (request, query) in [
                (Request::Name, &mut device.name_query),
                (Request::Services, &mut device.services_query),
            ] {
                let deadline = query.deadline.filter(|_| query.is_waiting());
                match deadline {
                    None => {}
                    Some(deadline) if deadline > now => waiting.add(is_known),
                    Some(_) => {
                        let fault = query.fault;
                        needs_round |= record_failure(query, request, named, now, fault);
                    }
                }
            }
        }
        self.waiting = waiting;
        if needs_round {
            self.rounds.request_round(now);
        }
    }

    /// Handles an aborted or failed response: repeats the request while attempts are left.
    pub(super) fn response_failed(
        &mut self,
        tracker: &mut DeviceTracker,
        row: DeviceId,
        request: Request,
        fault: QueryFault,
    ) {
        let now = tracker.now;
        let Some(device) = tracker.device_table.get_mut(row) else { return };
        let named = device.name.is_some();
        let query = device.query_mut(request);
        let before = query.fault.replace(fault);
        if query.is_waiting() {
            // A single error response may be due to the framing of the request.
            if fault == QueryFault::ErrorResponse && before == Some(fault) {
                query.attempts = query.attempts.max(max_attempts(request));
            }
            if record_failure(query, request, named, now, Some(fault)) {
                self.rounds.request_round(now);
            }
        }
        tracker.wake_at(now);
    }

    /// Returns when the next request or timeout is due.
    pub(super) fn query_timeout(&self, tracker: &DeviceTracker) -> Option<Instant> {
        let mut due = NO_TIMEOUT;
        let sending = self.local_node.held().is_some()
            && tracker.config.send_requests
            && !self.is_yielded
            && !self.outbox.is_paused()
            && !self.is_left_alone(tracker);
        let max_waiting = self.idle.max_open(MAX_WAITING, &tracker.config);
        for device in tracker.device_table.devices() {
            let sending = sending && tracker.device_table.is_current(device);
            let has_slot = self.waiting.has_slot(speaks_des(device), max_waiting);
            for query in [&device.name_query, &device.services_query] {
                if let Some(deadline) = query.deadline.filter(|_| query.is_waiting()) {
                    due = due.min(deadline);
                } else if sending && has_slot {
                    due = due.min(query.due.unwrap_or(NO_TIMEOUT));
                }
            }
        }
        if sending {
            let round = self.rounds.poll_timeout(&tracker.config, self.open_queries(tracker));
            due = due.min(round.unwrap_or(NO_TIMEOUT));
            if let Some(until) = self.rounds.priority_until(tracker.now) {
                due = due.max(until).min(tracker.next_deadline());
            }
            if due <= tracker.now
                && let Some(until) = self.heartbeats_wait_until(tracker)
            {
                due = due.max(until).min(tracker.next_deadline());
            }
            if !self.outbox.has_budget() && due != NO_TIMEOUT {
                due = due
                    .max(self.outbox.budget_at(self.share(tracker)))
                    .min(tracker.next_deadline());
            }
        }
        if tracker.config.listen_only {
            let round = self.rounds.poll_timeout(&tracker.config, 0);
            due = due.min(round.unwrap_or(NO_TIMEOUT));
        }
        (due != NO_TIMEOUT).then_some(due)
    }
}

impl DeviceTracker {
    /// Repeats the queries without a response until now: frames were lost, and the responses may have
    /// been among them.
    pub(super) fn repeat_failed_queries(&mut self) {
        let now = self.now;
        for device in self.device_table.devices_mut().iter_mut().filter(|it| it.is_present()) {
            for query in [&mut device.name_query, &mut device.services_query] {
                let is_recent = query.sent_at.is_some_and(|at| now.since(at) < LOST_RESPONSE_TIME);
                if is_recent && (query.is_waiting() || query.state == QueryState::NoResponse) {
                    query.restart(now);
                }
            }
        }
    }

    /// Delays single name queries, because the round that begins now includes them.
    fn defer_to_round(&mut self) {
        let after = self.now + ROUND_WAIT_LIMIT;
        for device in self.device_table.devices_mut() {
            if device.name.is_none() && device.name_query.due.is_some() {
                device.name_query.due = Some(after);
            }
        }
    }

    /// Updates presence and queries after an enumeration round that began at `began`.
    fn finish_round(&mut self, began: Instant) {
        let periods = self.conflicts.periods();
        for device in self.device_table.devices_mut() {
            let period = periods.of(device.address);
            let has_heartbeats = device.heartbeat.last.is_some() && !is_claim_only(device, period);
            let is_present = has_heartbeats || device.last_seen >= began;
            device.rounds_missed = if is_present { 0 } else { device.rounds_missed + 1 };
        }
        self.update_presence();
        let now = self.now;
        for device in self.device_table.devices_mut() {
            let query = &mut device.name_query;
            if device.name.is_none() && query.state == QueryState::NotSent && query.due.is_some() {
                query.due = Some(now);
            }
            // A node without a response to single requests did not respond to this round either:
            // pause its query.
            let waits_for_round = query.state == QueryState::Sent && query.deadline.is_none();
            if device.name.is_none() && waits_for_round && query.sent_at <= Some(began) {
                query.give_up(now + RETRY_DELAY);
            }
        }
    }

    /// Returns the next timeout of a query that waits for a response.
    fn next_deadline(&self) -> Instant {
        let queries =
            self.device_table.devices().iter().flat_map(|d| [&d.name_query, &d.services_query]);
        queries.filter(|q| q.is_waiting()).filter_map(|q| q.deadline).min().unwrap_or(NO_TIMEOUT)
    }

    /// Extends the timeout of a query while its response arrives.
    pub(super) fn extend_deadline(&mut self, row: DeviceId, request: Request) {
        let now = self.now;
        let Some(device) = self.device_table.get_mut(row) else { return };
        let query = device.query_mut(request);
        if query.is_waiting() {
            query.state = QueryState::Receiving;
            query.deadline = Some(now + isotp::TIMEOUT + Duration::from_millis(100));
        }
    }
}

/// Returns the other kind of request.
const fn other_request(request: Request) -> Request {
    match request {
        Request::Name => Request::Services,
        Request::Services => Request::Name,
    }
}

/// Returns true if the device sent a heartbeat or a DES response. Others may be nodes of another
/// protocol that do not respond.
fn speaks_des(device: &Device) -> bool {
    device.heartbeat.last.is_some() || device.name.is_some() || device.services.is_some()
}

/// Returns the timeout of the first frame of a response: what devices need, plus `on_the_bus`, what
/// a slow and busy bus adds; doubled with every attempt, at most 3 s.
fn response_timeout(on_the_bus: Duration, attempts: u32) -> Duration {
    let base = RESPONSE_TIME + on_the_bus;
    (base * 2u32.saturating_pow(attempts.saturating_sub(1))).min(Duration::from_secs(3))
}

/// Returns the attempts of a query before its pause.
const fn max_attempts(request: Request) -> u32 {
    match request {
        Request::Name => NAME_ATTEMPTS,
        Request::Services => SERVICES_ATTEMPTS,
    }
}

/// Records a failed attempt and plans the next one. Returns true if an enumeration round is needed
/// instead.
fn record_failure(
    query: &mut Query,
    request: Request,
    named: bool,
    now: Instant,
    fault: Option<QueryFault>,
) -> bool {
    query.deadline = None;
    query.fault = fault;
    let limit = max_attempts(request);
    if query.attempts < limit {
        query.state = QueryState::NotSent;
        let back_off = Duration::from_millis(100 << query.attempts.min(6));
        query.due = Some(now + back_off);
        return false;
    }
    let needs_round_query = request == Request::Name && !named && query.state == QueryState::Sent;
    if needs_round_query && query.attempts == limit {
        // Stays open until the enumeration round is over.
        query.attempts += 1;
        query.sent_at = Some(now);
        query.due = None;
        return true;
    }
    query.give_up(now + RETRY_DELAY);
    false
}
