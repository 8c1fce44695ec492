//! Address claims: which node holds which address, and which node gave one up (CAN platform
//! §3.2.4.2, protocol §7.5). Input: heartbeats with a UID; output: [`ClaimUpdate`].
//!
//! A node that has chosen an address claims it by one heartbeat in ARSLV. A node that receives a
//! frame from its own address returns to ARSLV, is silent for at least 1.5 periods, and comes up at
//! another address. Heartbeats carry the UID, so both can be told apart unless one of them is
//! blank.
//!
//! Stores, for each UID, its address and its conflicts there. Does not know names; of rows only
//! which one stands for which UID.

use super::DeviceId;
use super::device::MISSED_HEARTBEAT_PERIODS;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::{Mode, Uid};

/// Maximum number of nodes stored; beyond that the one silent for the longest time is dropped.
/// Bounds the memory: two nodes of each address.
const MAX_NODES: usize = 256;
/// Periods without a heartbeat for which a node still holds its address. After that it is
/// stale (protocol §4.6).
const HOLD_PERIODS: f64 = 2.5;
/// Periods in which one of two nodes at an address gives it up; after that it is a conflict. A node
/// without a heartbeat for as long has left its address. Protocol §5.3: one lost heartbeat, 1.5
/// periods of silence and a random delay up to one period (CAN platform §3.2.4.2).
const RESOLUTION_PERIODS: u32 = 5;

/// The part of a heartbeat that matters for claims.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeartbeatInput {
    pub now: Instant,
    pub address: Address,
    /// Heartbeat period of the address.
    pub period: Duration,
    /// UID, not blank.
    pub uid: Uid,
    pub mode: Option<Mode>,
    /// Active row at the address.
    pub row: DeviceId,
    /// True if that row is known to belong to another node.
    pub holder_present: bool,
}

/// What a heartbeat shows about its sender.
#[derive(Clone, Copy, Debug)]
pub(super) struct ClaimUpdate {
    /// Row of the sender, or an id without a row while only its claim is known.
    pub device: DeviceId,
    /// True if the row at the address belongs to another node, which sends heartbeats from there
    /// too.
    pub is_other_node: bool,
    /// Previous mode of the sender; `None` if unknown.
    pub mode_before: Option<Mode>,
    /// Its first heartbeat from the address, before any absence.
    pub first: Instant,
    /// True if this is a new claim of the address, not a repeated one.
    pub claims: bool,
    /// Address that it left, where it was in conflict or had no row.
    pub left: Option<Address>,
    /// Time of its last heartbeat there, if it gave the address up and that was not reported yet.
    pub gave_up: Option<Instant>,
}

/// A node that sends heartbeats from an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct AddressSender {
    /// UID; blank for heartbeats without one, of which several nodes look like one.
    pub uid: Uid,
    /// Its row; that of no device where only its heartbeats are known.
    pub device: DeviceId,
    /// Last mode; `None` if its heartbeats carry none.
    pub mode: Option<Mode>,
    /// First heartbeat from the address, after its last absence of more than five periods.
    pub since: Instant,
    /// First heartbeat from the address, before any absence.
    pub first: Instant,
    /// Last heartbeat from the address.
    pub last: Instant,
}

impl AddressSender {
    /// Returns true if a heartbeat with this UID is one of its.
    pub fn has_uid(&self, uid: Option<Uid>) -> bool {
        uid.and_then(Uid::not_blank) == self.uid.not_blank()
    }
}

/// Where a UID was heard last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeardUid {
    /// The UID, not blank.
    pub uid: Uid,
    /// The address.
    pub address: Address,
    /// Its last heartbeat.
    pub last: Instant,
}

/// Node known by its UID.
#[derive(Clone, Debug)]
struct UidNode {
    uid: Uid,
    device: DeviceId,
    /// True if no row has its id: earlier events are about an unknown node.
    is_rowless: bool,
    address: Address,
    mode: Option<Mode>,
    /// First and last heartbeat from the address, without those before it was absent.
    since: Instant,
    last: Instant,
    /// First heartbeat from the address, before it was absent.
    first: Instant,
    has_claimed: bool,
    /// Time since when another node sends heartbeats from the address too.
    contested_since: Option<Instant>,
    is_reported: bool,
}

impl UidNode {
    /// Returns true if it stopped before the contention became a conflict.
    fn gave_up_before_conflict(&self, period: Duration) -> bool {
        self.contested_since.is_some_and(|began| self.last < began + period * RESOLUTION_PERIODS)
    }
}

/// Nodes of one bus by their UID.
#[derive(Clone, Debug)]
pub(super) struct AddressClaims {
    nodes: Vec<UidNode>,
    /// Time of the last claim of each address while another node sent heartbeats from it.
    claimed_while_held: [Option<Instant>; Address::COUNT],
}

impl AddressClaims {
    pub fn new() -> Self {
        Self { nodes: Vec::new(), claimed_while_held: [None; Address::COUNT] }
    }

    /// Processes a heartbeat. `reserve` returns an id that no row will have.
    pub fn update(
        &mut self,
        heartbeat: HeartbeatInput,
        reserve: impl FnOnce() -> DeviceId,
    ) -> ClaimUpdate {
        let HeartbeatInput { now, address, period, uid, mode, row, holder_present } = heartbeat;
        let over_holder = holder_present;
        let gap = period.mul_f64(MISSED_HEARTBEAT_PERIODS);
        let resolution_time = period * RESOLUTION_PERIODS;
        // A replaced board was silent for longer; so is one that is asleep.
        let is_holder = |node: &UidNode| {
            let holds = || now.since(node.last) < period.mul_f64(HOLD_PERIODS);
            node.address == address
                && node.uid != uid
                && node.device == row
                && (mode == Some(Mode::Arslv) || holds())
        };
        let is_other_node = over_holder || self.nodes.iter().any(is_holder);
        let known = self.nodes.iter().position(|node| node.uid == uid);
        let at = known.unwrap_or_else(|| {
            let device = if is_other_node { reserve() } else { row };
            self.remember(UidNode {
                uid,
                device,
                is_rowless: is_other_node,
                address,
                mode: None,
                since: now,
                last: now,
                first: now,
                has_claimed: false,
                contested_since: None,
                is_reported: false,
            })
        });
        let left = self.nodes[at].address;
        let others_claimed = self
            .nodes
            .iter()
            .any(|node| node.address == left && node.has_claimed && node.uid != uid);
        let node = &mut self.nodes[at];
        let silence = now.since(node.last);
        let mut update = ClaimUpdate {
            device: node.device,
            is_other_node,
            mode_before: node.mode,
            first: if node.address == address { node.first } else { now },
            claims: mode == Some(Mode::Arslv)
                && (node.mode != mode || node.address != address || silence > gap),
            left: None,
            gave_up: None,
        };
        let is_new_here = node.address != address || silence >= resolution_time;
        if node.address != address {
            // A node that sends heartbeats from both addresses has left neither.
            if silence > gap {
                // Without a heartbeat beside the other node, and without a claim, a board was
                // replaced and is used elsewhere.
                let was_there = node.contested_since.is_some_and(|began| node.last >= began);
                let gave_up = was_there || update.claims || others_claimed;
                let contested = node.gave_up_before_conflict(period);
                update.left = (contested || node.is_rowless).then_some(node.address);
                update.gave_up = (contested && gave_up && !node.is_reported).then_some(node.last);
            }
            node.address = address;
        }
        node.first = update.first;
        if is_new_here {
            node.since = now;
            (node.has_claimed, node.contested_since, node.is_reported) = (false, None, false);
        }
        node.has_claimed |= update.claims;
        node.mode = mode.or(node.mode);
        node.last = now;
        self.note_contention(at, over_holder, period, now);
        if update.claims && is_other_node {
            self.note_claimed_while_held(now, address);
        }
        update
    }

    /// Updates since when the node at index `at` and the others at its address are in conflict.
    fn note_contention(&mut self, at: usize, over_holder: bool, period: Duration, now: Instant) {
        let (uid, address) = (self.nodes[at].uid, self.nodes[at].address);
        let resolution_time = period * RESOLUTION_PERIODS;
        let recently = period.mul_f64(HOLD_PERIODS);
        let (mut near, mut any) = (over_holder, over_holder);
        for other in &mut self.nodes {
            if other.address != address || other.uid == uid {
                continue;
            }
            let silence = now.since(other.last);
            any |= silence < resolution_time;
            if silence < recently {
                near = true;
                other.contested_since.get_or_insert(now);
            }
        }
        let node = &mut self.nodes[at];
        if near {
            node.contested_since.get_or_insert(now);
        } else if !any {
            node.contested_since = None;
        }
    }

    /// Returns the nodes that send heartbeats from `address`, the one that was there first at the
    /// start, although it may have been absent since.
    pub fn senders(&self, now: Instant, address: Address, period: Duration) -> Vec<AddressSender> {
        let resolution_time = period * RESOLUTION_PERIODS;
        let here = self
            .nodes
            .iter()
            .filter(|node| node.address == address && now.since(node.last) < resolution_time);
        let mut all: Vec<AddressSender> = here
            .map(|node| AddressSender {
                uid: node.uid,
                device: node.device,
                mode: node.mode,
                since: node.since,
                last: node.last,
                first: node.first,
            })
            .collect();
        all.sort_by_key(|sender| (sender.first, sender.uid));
        all
    }

    /// Returns where each UID was heard last.
    pub fn heard_uids(&self) -> impl Iterator<Item = HeardUid> {
        self.nodes.iter().map(|node| HeardUid {
            uid: node.uid,
            address: node.address,
            last: node.last,
        })
    }

    /// Forgets the nodes that are not heard any more. `period`: of the heartbeats of an address.
    pub fn forget_absent(&mut self, now: Instant, period: impl Fn(Address) -> Duration) {
        let is_there =
            |node: &UidNode| now.since(node.last) < period(node.address) * RESOLUTION_PERIODS;
        self.nodes.retain(is_there);
    }

    /// Stores a node and returns its index; replaces the one silent for the longest time if full.
    fn remember(&mut self, node: UidNode) -> usize {
        if self.nodes.len() < MAX_NODES {
            self.nodes.push(node);
            return self.nodes.len() - 1;
        }
        let oldest = (0..self.nodes.len()).min_by_key(|&at| self.nodes[at].last).unwrap_or(0);
        self.nodes[oldest] = node;
        oldest
    }

    /// Assigns a row to a UID. Returns the id used for it before, if it had no row.
    pub fn assign_row(
        &mut self,
        uid: Uid,
        row: DeviceId,
        mut reserve: impl FnMut() -> DeviceId,
    ) -> Option<DeviceId> {
        for other in self.nodes.iter_mut().filter(|it| it.device == row && it.uid != uid) {
            (other.device, other.is_rowless) = (reserve(), true);
        }
        let node = self.nodes.iter_mut().find(|node| node.uid == uid)?;
        let was = std::mem::replace(&mut node.device, row);
        std::mem::take(&mut node.is_rowless).then_some(was)
    }

    /// Returns the nodes that were in conflict with `uid` about `address` and stopped while it
    /// continues: each once, with its UID.
    pub fn nodes_that_stopped(
        &mut self,
        now: Instant,
        address: Address,
        period: Duration,
        uid: Uid,
    ) -> Vec<(DeviceId, Uid)> {
        let resolution_time = period * RESOLUTION_PERIODS;
        let Some(winner) = self.nodes.iter().find(|node| node.uid == uid) else {
            return Vec::new();
        };
        let (since, has_claimed) = (winner.since, winner.has_claimed);
        let silent = self.nodes.iter_mut().filter(|node| {
            node.address == address
                && node.uid != uid
                && !node.is_reported
                && now.since(node.last) >= resolution_time
                && node.gave_up_before_conflict(period)
                // Another UID alone may be the same board, reconfigured.
                && (since <= node.last || has_claimed)
        });
        silent
            .map(|node| {
                node.is_reported = true;
                (node.device, node.uid)
            })
            .collect()
    }

    /// Returns true if other nodes than that row send heartbeats from `address` now, and all of
    /// them have rows.
    pub fn are_others_known(
        &self,
        now: Instant,
        address: Address,
        period: Duration,
        row: DeviceId,
    ) -> bool {
        let gap = period.mul_f64(MISSED_HEARTBEAT_PERIODS);
        let mut others = self.nodes.iter().filter(|node| {
            node.address == address && node.device != row && now.since(node.last) < gap
        });
        let mut any = false;
        others.all(|node| {
            any = true;
            !node.is_rowless
        }) && any
    }

    /// Notes that `address` was claimed while another node sent heartbeats from it.
    pub fn note_claimed_while_held(&mut self, now: Instant, address: Address) {
        self.claimed_while_held[address.index()] = Some(now);
    }

    /// Returns the time of the last such claim.
    pub fn claimed_while_held(&self, address: Address) -> Option<Instant> {
        self.claimed_while_held[address.index()]
    }

    /// Returns the UID of a row. While two nodes are in conflict, its heartbeats carry both.
    pub fn uid_of(&self, row: DeviceId) -> Option<Uid> {
        let nodes = self.nodes.iter().filter(|node| node.device == row);
        nodes.max_by_key(|node| node.last).map(|node| node.uid)
    }

    /// Returns the row of a UID.
    pub fn row_of(&self, uid: Uid) -> Option<DeviceId> {
        let device = self.nodes.iter().find(|node| node.uid == uid)?.device;
        (self.uid_of(device) == Some(uid)).then_some(device)
    }

    /// Returns the last heartbeat from `address` of the node of a row.
    pub fn last_of_row(&self, row: DeviceId, address: Address) -> Option<Instant> {
        let node = self.nodes.iter().find(|node| node.device == row && node.address == address)?;
        Some(node.last)
    }

    fn node_at(&self, uid: Uid, address: Address) -> Option<&UidNode> {
        self.nodes.iter().find(|node| node.uid == uid && node.address == address)
    }

    /// Returns the last mode of the node with this UID.
    pub fn mode_of(&self, uid: Uid) -> Option<Mode> {
        self.nodes.iter().find(|node| node.uid == uid)?.mode
    }

    /// Returns since when that node sends heartbeats from `address`.
    pub fn since(&self, uid: Uid, address: Address) -> Option<Instant> {
        Some(self.node_at(uid, address)?.since)
    }

    /// Returns since when another node than `uid` sends heartbeats from `address`.
    pub fn other_sender_since(&self, address: Address, uid: Uid) -> Option<Instant> {
        let others = self.nodes.iter().filter(|it| it.address == address && it.uid != uid);
        others.max_by_key(|node| node.last).map(|node| node.since)
    }

    /// Returns the node other than `but` that sends heartbeats from `address` now and did so after
    /// `then`.
    pub fn is_still_active(
        &self,
        now: Instant,
        address: Address,
        period: Duration,
        then: Instant,
        but: Uid,
    ) -> Option<(DeviceId, Uid)> {
        let gap = period.mul_f64(MISSED_HEARTBEAT_PERIODS);
        let nodes = self.nodes.iter().filter(|node| {
            node.uid != but
                && node.address == address
                && node.last > then
                && now.since(node.last) < gap
        });
        nodes.max_by_key(|node| node.last).map(|node| (node.device, node.uid))
    }
}
