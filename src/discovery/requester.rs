//! Requester: descan's own node on one bus and the requests it sends. Which requests are due is
//! decided in [`query_scheduler`](super::query_scheduler).

use super::device_requests::{DeviceRequests, RequestObstacle};
use super::device_tracker::DeviceTracker;
use super::frame_sequence::FrameSequences;
use super::idle_gaps::IdleTracker;
use super::local_node::{AddressChange, LocalNode};
use super::outbox::{AckChange, Outbox};
use super::query_scheduler::WaitingQueries;
use super::rounds::Rounds;
use super::{BusVerdict, Config, EventKind};
use crate::time::Instant;

/// descan's own node on one bus, and the state of what it sends.
#[derive(Clone, Debug)]
pub(super) struct Requester {
    pub rng: fastrand::Rng,
    pub local_node: LocalNode,
    pub outbox: Outbox,
    pub rounds: Rounds,
    pub idle: IdleTracker,
    pub device_requests: DeviceRequests,
    pub sequences: FrameSequences,
    /// Number of queries that await a response, updated before requests are sent.
    pub waiting: WaitingQueries,
    /// True if the user asked for rounds on a bus that speaks another protocol.
    pub is_foreign_scanned: bool,
    /// True if requests and flow control are those of another requester in this program.
    pub is_yielded: bool,
}

impl Requester {
    pub fn new(now: Instant, config: &Config) -> Self {
        let mut rng = fastrand::Rng::with_seed(config.seed);
        Self {
            local_node: LocalNode::new(now, config, &mut rng),
            outbox: Outbox::new(now, config.has_loopback),
            rounds: Rounds::new(),
            idle: IdleTracker::new(),
            device_requests: DeviceRequests::default(),
            sequences: FrameSequences::default(),
            waiting: WaitingQueries::default(),
            is_foreign_scanned: false,
            is_yielded: false,
            rng,
        }
    }

    /// Claims an address, sends heartbeats and responses when due.
    pub fn handle_timeout(&mut self, tracker: &mut DeviceTracker) {
        let now = tracker.now;
        self.idle.handle_timeout(now, &tracker.config);
        let change = self.outbox.handle_timeout(now);
        self.handle_ack_change(tracker, change);
        let change = self.local_node.handle_timeout(
            now,
            &tracker.config.profile,
            !self.is_left_alone(tracker),
            &mut self.rng,
            &mut self.outbox,
        );
        self.handle_address_change(tracker, change);
    }

    /// Returns when the node or one of the requests is due.
    pub fn poll_timeout(&self, tracker: &DeviceTracker) -> Option<Instant> {
        let due = [
            self.query_timeout(tracker),
            self.device_request_timeout(tracker),
            self.sequence_timeout(),
            self.local_node.poll_timeout(),
            self.outbox.poll_timeout(),
        ];
        due.into_iter().flatten().min()
    }

    /// Returns true if requests may be sent: an address is held, and requests are wanted.
    pub fn may_send_requests(&self, tracker: &DeviceTracker) -> bool {
        self.local_node.held().is_some() && tracker.config.send_requests && !self.is_yielded
    }

    /// Returns true if nothing is sent because the bus speaks another protocol, until the user asks
    /// for a scan.
    pub fn is_left_alone(&self, tracker: &DeviceTracker) -> bool {
        tracker.protocol.traffic().verdict() == BusVerdict::Foreign && !self.is_foreign_scanned
    }

    /// Starts enumeration rounds again, if requests may be sent.
    pub fn restart_rounds(&mut self, tracker: &DeviceTracker) {
        if self.may_send_requests(tracker) {
            self.rounds.restart(tracker.now);
        }
    }

    pub fn handle_ack_change(&mut self, tracker: &mut DeviceTracker, change: Option<AckChange>) {
        match change {
            Some(AckChange::NoAck) => {
                tracker.emit_bus_event(EventKind::NoAck);
                // No node received the request: repeat it with the next attempt.
                self.restart_rounds(tracker);
            }
            Some(AckChange::Restored) => {
                tracker.emit_bus_event(EventKind::Acknowledged);
                self.restart_rounds(tracker);
                tracker.wake_at(tracker.now);
            }
            None => {}
        }
    }

    pub fn handle_address_change(
        &mut self,
        tracker: &mut DeviceTracker,
        change: Option<AddressChange>,
    ) {
        match change {
            Some(AddressChange::Taken(address)) => {
                tracker.emit_bus_event(EventKind::OwnAddress(address));
                self.restart_rounds(tracker);
            }
            Some(AddressChange::Blocked(wanted)) => {
                tracker.emit_bus_event(EventKind::NoAddress(wanted));
            }
            Some(AddressChange::Lost(address)) => {
                tracker.emit_bus_event(EventKind::OwnAddressLost(address));
                self.rounds.stop();
                self.outbox.clear();
                self.device_requests.end_all(RequestObstacle::NoAddress);
            }
            None => {}
        }
    }
}
