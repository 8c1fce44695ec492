//! Who claims which address, and who gives way: the story of address resolution (3.2.4.2).
//!
//! A node that has chosen an address claims it by one heartbeat in ARSLV. One that hears its
//! address used by another goes back to ARSLV, is silent for 1.5 periods at least, and comes up
//! elsewhere. Heartbeats carry the UID, so both can be told apart as long as neither is blank.
//!
//! Remembers, per UID, where it beats and with whom it contends there. Does not know names, nor
//! anything of rows but which one speaks for whom.

use super::DeviceId;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::{Mode, Uid};

/// How many nodes are remembered; beyond, the one that was silent for the longest goes.
const MAX_NODES: usize = 256;
/// Periods without a heartbeat after which a node missed at least one.
pub(super) const PAUSE: f64 = 1.4;
/// Periods without a heartbeat for which a node still holds its address.
const HOLDS_FOR: f64 = 2.5;
/// Periods for which two nodes beat from one address if one of them gives way; for longer it is
/// a collision. After as many without a heartbeat, a node has left its address.
const GIVES_WAY_WITHIN: u32 = 5;

/// A heartbeat, as far as it matters here.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeartbeatInput {
    pub now: Instant,
    pub address: Address,
    /// Not blank.
    pub uid: Uid,
    pub mode: Option<Mode>,
    /// The row that speaks from the address.
    pub row: DeviceId,
    /// Whether that row is known to be another one's.
    pub over: bool,
}

/// What a heartbeat tells of its sender.
#[derive(Clone, Copy, Debug)]
pub(super) struct ClaimUpdate {
    /// Who it is: a row, or an id that no row has while only its claim is known.
    pub device: DeviceId,
    /// Whether the row at the address is somebody else's, who beats from there too.
    pub is_another: bool,
    /// Its own mode before.
    pub mode_before: Option<Mode>,
    /// Whether this is a claim of the address, and not a repetition of one.
    pub claims: bool,
    /// Where it contended before, or claimed without having a row.
    pub left: Option<Address>,
    /// Since when it was not heard there any more, if it gave way and that was not told yet.
    pub gave_way: Option<Instant>,
}

#[derive(Debug)]
struct Node {
    uid: Uid,
    device: DeviceId,
    /// No row has its id: what was told of it is told of nobody known yet.
    is_rowless: bool,
    address: Address,
    mode: Option<Mode>,
    /// Its first heartbeat from the address, and its last.
    since: Instant,
    last: Instant,
    has_claimed: bool,
    /// Since when somebody else beats from the address too.
    contended: Option<Instant>,
    told: bool,
}

impl Node {
    /// Whether it was silent before the contention became a collision.
    fn gave_way_in_time(&self, period: Duration) -> bool {
        self.contended.is_some_and(|began| self.last < began + period * GIVES_WAY_WITHIN)
    }
}

#[derive(Debug)]
pub(super) struct AddressClaims {
    period: Duration,
    nodes: Vec<Node>,
    /// When an address was claimed while somebody else beat from it.
    claimed_over: [Option<Instant>; Address::COUNT],
}

impl AddressClaims {
    pub fn new(period: Duration) -> Self {
        Self { period, nodes: Vec::new(), claimed_over: [None; Address::COUNT] }
    }

    /// Takes a heartbeat. `reserve` gives an id that no row will have.
    pub fn hear(
        &mut self,
        beat: HeartbeatInput,
        reserve: impl FnOnce() -> DeviceId,
    ) -> ClaimUpdate {
        let HeartbeatInput { now, address, uid, mode, row, over } = beat;
        let (period, pause) = (self.period, self.period.mul_f64(PAUSE));
        let patience = period * GIVES_WAY_WITHIN;
        // A board that was swapped for another one was silent for longer; one that is asleep, too.
        let is_holder = |node: &Node| {
            let holds = now.since(node.last) < period.mul_f64(HOLDS_FOR);
            let holds = holds || mode == Some(Mode::Arslv);
            node.uid != uid && node.address == address && node.device == row && holds
        };
        let is_another = over || self.nodes.iter().any(is_holder);
        let known = self.nodes.iter().position(|node| node.uid == uid);
        let at = known.unwrap_or_else(|| {
            let device = if is_another { reserve() } else { row };
            self.remember(Node {
                uid,
                device,
                is_rowless: is_another,
                address,
                mode: None,
                since: now,
                last: now,
                has_claimed: false,
                contended: None,
                told: false,
            })
        });
        let node = &mut self.nodes[at];
        let silence = now.since(node.last);
        let mut heard = ClaimUpdate {
            device: node.device,
            is_another,
            mode_before: node.mode,
            claims: mode == Some(Mode::Arslv)
                && (node.mode != mode || node.address != address || silence > pause),
            left: None,
            gave_way: None,
        };
        let is_new_here = node.address != address || silence >= patience;
        if node.address != address {
            // Who beats from both addresses has left neither.
            if silence > pause {
                let contended = node.gave_way_in_time(period);
                heard.left = (contended || node.is_rowless).then_some(node.address);
                heard.gave_way = (contended && !node.told).then_some(node.last);
            }
            node.address = address;
        }
        if is_new_here {
            node.since = now;
            (node.has_claimed, node.contended, node.told) = (false, None, false);
        }
        node.has_claimed |= heard.claims;
        node.mode = mode.or(node.mode);
        node.last = now;
        self.note_contention(at, over, now);
        if heard.claims && is_another {
            self.note_claimed_over(now, address);
        }
        heard
    }

    fn note_contention(&mut self, at: usize, over: bool, now: Instant) {
        let (uid, address) = (self.nodes[at].uid, self.nodes[at].address);
        let patience = self.period * GIVES_WAY_WITHIN;
        let recently = self.period.mul_f64(HOLDS_FOR);
        let (mut near, mut any) = (over, over);
        for other in &mut self.nodes {
            if other.uid == uid || other.address != address {
                continue;
            }
            let silence = now.since(other.last);
            any |= silence < patience;
            if silence < recently {
                near = true;
                other.contended.get_or_insert(now);
            }
        }
        let node = &mut self.nodes[at];
        if near {
            node.contended.get_or_insert(now);
        } else if !any {
            node.contended = None;
        }
    }

    fn remember(&mut self, node: Node) -> usize {
        if self.nodes.len() < MAX_NODES {
            self.nodes.push(node);
            return self.nodes.len() - 1;
        }
        let oldest = (0..self.nodes.len()).min_by_key(|&at| self.nodes[at].last).unwrap_or(0);
        self.nodes[oldest] = node;
        oldest
    }

    /// That row speaks for this UID now. Returns the id that stood for it, where it had no row.
    pub fn adopt(
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

    /// Nodes that contended with `uid` for `address` and are silent now while it beats on: each
    /// once, with its UID.
    pub fn fallen_silent(
        &mut self,
        now: Instant,
        address: Address,
        uid: Uid,
    ) -> Vec<(DeviceId, Uid)> {
        let patience = self.period * GIVES_WAY_WITHIN;
        let Some(winner) = self.nodes.iter().find(|node| node.uid == uid) else {
            return Vec::new();
        };
        let (since, has_claimed, period) = (winner.since, winner.has_claimed, self.period);
        let silent = self.nodes.iter_mut().filter(|node| {
            node.uid != uid
                && node.address == address
                && !node.told
                && now.since(node.last) >= patience
                && node.gave_way_in_time(period)
                // Another UID alone may be the same board, configured anew.
                && (since <= node.last || has_claimed)
        });
        silent
            .map(|node| {
                node.told = true;
                (node.device, node.uid)
            })
            .collect()
    }

    /// Whether somebody else than `uid` still holds `address`.
    pub fn is_shared(&self, now: Instant, address: Address, uid: Uid) -> bool {
        let holds = self.period.mul_f64(HOLDS_FOR);
        let mut others = self.nodes.iter().filter(|it| it.uid != uid && it.address == address);
        others.any(|node| now.since(node.last) < holds)
    }

    /// Whether somebody else than that row beats from `address` now, and only who has a row elsewhere.
    pub fn are_others_known(&self, now: Instant, address: Address, row: DeviceId) -> bool {
        let pause = self.period.mul_f64(PAUSE);
        let mut others = self.nodes.iter().filter(|node| {
            node.address == address && node.device != row && now.since(node.last) < pause
        });
        let mut any = false;
        others.all(|node| {
            any = true;
            !node.is_rowless
        }) && any
    }

    /// Notes that `address` was claimed while somebody else beat from it.
    pub fn note_claimed_over(&mut self, now: Instant, address: Address) {
        self.claimed_over[address.index()] = Some(now);
    }

    /// When that was last.
    pub fn claimed_over(&self, address: Address) -> Option<Instant> {
        self.claimed_over[address.index()]
    }

    /// The UID that a row speaks for. Where two contend, its heartbeats say one and the other.
    pub fn uid_of(&self, row: DeviceId) -> Option<Uid> {
        let nodes = self.nodes.iter().filter(|node| node.device == row);
        nodes.max_by_key(|node| node.last).map(|node| node.uid)
    }

    /// The row that speaks for a UID.
    pub fn row_of(&self, uid: Uid) -> Option<DeviceId> {
        let device = self.nodes.iter().find(|node| node.uid == uid)?.device;
        (self.uid_of(device) == Some(uid)).then_some(device)
    }

    /// The mode that node said last.
    pub fn mode_of(&self, uid: Uid) -> Option<Mode> {
        self.nodes.iter().find(|node| node.uid == uid)?.mode
    }

    /// Since when that node beats from `address`.
    pub fn since(&self, uid: Uid, address: Address) -> Option<Instant> {
        let node = self.nodes.iter().find(|node| node.uid == uid && node.address == address)?;
        Some(node.since)
    }

    /// When whoever beats from `address` besides that node began to.
    pub fn other_sender_since(&self, address: Address, uid: Uid) -> Option<Instant> {
        let others = self.nodes.iter().filter(|it| it.uid != uid && it.address == address);
        others.max_by_key(|node| node.last).map(|node| node.since)
    }

    /// Who beats from `address` now and went on after `then`.
    pub fn is_still_active(
        &self,
        now: Instant,
        address: Address,
        then: Instant,
        but: Uid,
    ) -> Option<(DeviceId, Uid)> {
        let pause = self.period.mul_f64(PAUSE);
        let nodes = self.nodes.iter().filter(|node| {
            node.uid != but
                && node.address == address
                && node.last > then
                && now.since(node.last) < pause
        });
        nodes.max_by_key(|node| node.last).map(|node| (node.device, node.uid))
    }
}
