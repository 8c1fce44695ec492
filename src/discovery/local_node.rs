//! Ourselves on the bus: which address we hold and how we came by it (3.2.4.2), our heartbeat,
//! and our answers to the DES questions of others.
//!
//! Does not know what we ask; only whether we may ask, and from which address.

use super::config::Config;
use super::outbox::Outbox;
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::des::{self, ReceivedRequest, Request};
use crate::wire::framing::{Framing, classify_request};
use crate::wire::id::{Address, Header};
use crate::wire::isotp::{FlowControl, Pci, Segmenter};
use crate::wire::node::{Heartbeat, Mode, Uid};
use crate::wire::profile::{Announce, Profile};
use std::collections::VecDeque;

/// The name we answer with.
pub(super) const NAME: &[u8] = b"DSCAN";
/// How many of our services answers may wait for flow control at once.
const MAX_RESPONSES: usize = 4;
/// A question that comes again within this was repeated by something on its way: who answers
/// both looks like two.
const REPEATED_WITHIN: Duration = Duration::from_millis(200);
/// Questions that may still come again.
const MAX_REQUESTS: usize = 16;
/// An address heard within this many periods counts as used.
const USED_FOR_PERIODS: u32 = 5;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum AddressState {
    Off,
    Listening { until: Instant },
    Waiting { address: Address, since: Instant, until: Instant },
    Held { address: Address },
}

/// A change of our address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum AddressChange {
    Taken(Address),
    Lost(Address),
    /// The fixed one is used by somebody else, or all are used.
    Blocked(Option<Address>),
}

#[derive(Debug)]
struct OutgoingResponse {
    id: u32,
    flow_id: u32,
    segmenter: Segmenter<Vec<u8>>,
}

#[derive(Debug)]
pub(super) struct LocalNode {
    standing: AddressState,
    wanted: Option<Address>,
    /// Somebody else wanted our address: who wants it again waits at random before, so that two
    /// do not do so at the same moment time and again.
    contested: bool,
    /// When we looked last, there was no address to be had.
    blocked: bool,
    heard: [Option<Instant>; Address::COUNT],
    period: Duration,
    uid: Uid,
    heartbeat_known: bool,
    next_beat: Option<Instant>,
    responses: Vec<OutgoingResponse>,
    requests: VecDeque<Frame>,
}

impl LocalNode {
    pub fn new(now: Instant, config: &Config, rng: &mut fastrand::Rng) -> Self {
        let period = config.profile.heartbeat.period();
        let random: String =
            std::iter::repeat_with(|| rng.choice(b"23456789ABCDEFGHJKLMNPQRSTUVWXYZ"))
                .flatten()
                .take(3)
                .map(|&character| char::from(character))
                .collect();
        // An alphabet without these letters gets other characters, still at random.
        let uid = Uid::parse(&format!("DSCAN{random}"), &config.profile.uid)
            .unwrap_or_else(|| Uid::from_sextets(std::array::from_fn(|_| rng.u8(1..63))));
        let mut local_node = Self {
            standing: AddressState::Off,
            wanted: config.address,
            contested: false,
            blocked: false,
            heard: [None; Address::COUNT],
            period,
            uid,
            heartbeat_known: false,
            next_beat: None,
            responses: Vec::new(),
            requests: VecDeque::new(),
        };
        if !config.listen_only {
            local_node.listen(now);
        }
        local_node
    }

    /// Begins (again) to listen for used addresses: 1.5 × BUS_CFG_HR_TIME.
    pub fn listen(&mut self, now: Instant) {
        self.standing = AddressState::Listening { until: now + self.period.mul_f64(1.5) };
        self.next_beat = None;
        self.responses.clear();
    }

    pub fn held(&self) -> Option<Address> {
        match self.standing {
            AddressState::Held { address } => Some(address),
            _ => None,
        }
    }

    pub fn own_address(&self) -> super::OwnAddress {
        match self.standing {
            AddressState::Off => super::OwnAddress::None,
            AddressState::Listening { .. } if self.blocked => {
                super::OwnAddress::Blocked(self.wanted)
            }
            AddressState::Listening { .. } => super::OwnAddress::Listening,
            AddressState::Waiting { address, .. } => super::OwnAddress::Claiming(address),
            AddressState::Held { address } => super::OwnAddress::Held(address),
        }
    }

    /// Notes the addresses of a conforming frame of somebody else. `destination_counts` is
    /// false for a broadcast and for an echoed DST.
    pub fn note_used(&mut self, now: Instant, header: Header, destination_counts: bool) {
        self.heard[header.source.index()] = Some(now);
        // What is sent to us says nothing of anybody else at our address.
        if destination_counts && self.held() != Some(header.destination) {
            self.heard[header.destination.index()] = Some(now);
        }
    }

    /// A heartbeat that fits the profile was heard: ours will be understood.
    pub fn note_heartbeat(&mut self) {
        self.heartbeat_known = true;
    }

    /// Somebody else sends from the address we hold or want.
    pub fn handle_address_conflict(
        &mut self,
        now: Instant,
        source: Address,
    ) -> Option<AddressChange> {
        match self.standing {
            AddressState::Held { address } if address == source => {
                self.contested = true;
                self.listen(now);
                Some(AddressChange::Lost(address))
            }
            AddressState::Waiting { address, .. } if address == source => {
                self.contested = true;
                self.listen(now);
                None
            }
            _ => None,
        }
    }

    fn is_used(&self, now: Instant, address: Address) -> bool {
        let window = self.period * USED_FOR_PERIODS;
        self.heard[address.index()].is_some_and(|heard| now.since(heard) < window)
    }

    fn pick_address(&self, now: Instant, rng: &mut fastrand::Rng) -> Option<Address> {
        if let Some(wanted) = self.wanted {
            return (!self.is_used(now, wanted)).then_some(wanted);
        }
        if !self.is_used(now, Address::DEBUG) {
            return Some(Address::DEBUG);
        }
        let free: Vec<Address> =
            Address::nodes().filter(|&node| !self.is_used(now, node)).collect();
        (!free.is_empty()).then(|| free[rng.usize(..free.len())])
    }

    pub fn handle_timeout(
        &mut self,
        now: Instant,
        profile: &Profile,
        rng: &mut fastrand::Rng,
        outbox: &mut Outbox,
    ) -> Option<AddressChange> {
        let change = match self.standing {
            AddressState::Listening { until } if now >= until => {
                match self.pick_address(now, rng) {
                    None => {
                        self.listen(now);
                        let news = !std::mem::replace(&mut self.blocked, true);
                        news.then_some(AddressChange::Blocked(self.wanted))
                    }
                    // 0 is ours by right while nobody contests it.
                    Some(Address::DEBUG) if !self.contested => {
                        Some(self.hold_address(now, Address::DEBUG))
                    }
                    Some(address) => {
                        self.blocked = false;
                        let wait = Duration::from_micros(rng.u64(..self.period.as_micros() as u64));
                        self.standing =
                            AddressState::Waiting { address, since: now, until: now + wait };
                        None
                    }
                }
            }
            AddressState::Waiting { address, since, until } if now >= until => {
                let heard = self.heard[address.index()].is_some_and(|heard| heard >= since);
                if heard {
                    self.listen(now);
                    None
                } else {
                    Some(self.hold_address(now, address))
                }
            }
            _ => None,
        };
        self.send_heartbeat(now, profile, rng, outbox);
        self.send_responses(now, outbox);
        change
    }

    fn hold_address(&mut self, now: Instant, address: Address) -> AddressChange {
        self.responses.clear();
        self.blocked = false;
        self.standing = AddressState::Held { address };
        self.next_beat = Some(now);
        AddressChange::Taken(address)
    }

    fn sends_heartbeats(&self, profile: &Profile) -> bool {
        match profile.heartbeat.announce {
            Announce::Always => true,
            Announce::Never => false,
            Announce::Auto => profile.given || self.heartbeat_known,
        }
    }

    fn send_heartbeat(
        &mut self,
        now: Instant,
        profile: &Profile,
        rng: &mut fastrand::Rng,
        outbox: &mut Outbox,
    ) {
        let Some(address) = self.held() else { return };
        if self.next_beat.is_none_or(|at| now < at) {
            return;
        }
        self.next_beat = Some(now + self.period);
        if outbox.is_paused() || !self.sends_heartbeats(profile) {
            return;
        }
        let heartbeat = Heartbeat { uid: Some(self.uid), mode: Some(Mode::Work), error: Some(0) };
        let (data, len) = heartbeat.encode(&profile.heartbeat, &profile.modes.codes());
        let rnd7 = rng.u8(..128);
        let header = Header::unsolicited(address, rnd7, false, profile.heartbeat_service());
        outbox.push(Frame::classic(header.encode(), &data[..len]));
    }

    /// Answers a DES question of another debug device, and takes its flow control.
    pub fn handle_request(
        &mut self,
        now: Instant,
        header: Header,
        frame: &Frame,
        profile: &Profile,
        outbox: &mut Outbox,
    ) {
        let Some(address) = self.held() else { return };
        if header.to_not_working || (!header.broadcast && header.destination != address) {
            return;
        }
        if let Some((framing, message)) = classify_request(frame.data(), frame.fd) {
            let Some(ReceivedRequest::Known(request)) = Request::decode(message) else { return };
            if self.is_repeated(now, frame) {
                return;
            }
            let message = match request {
                Request::Name => des::encode_name(NAME).collect(),
                Request::Services => des::encode_services(&[["DES", "1.0"]]).collect(),
            };
            self.response(header, address, framing, message, outbox);
            self.send_responses(now, outbox);
        } else if let Ok(Pci::Flow(flow)) = Pci::decode(frame.data(), frame.fd) {
            let flow_id = Header::request(header.source, address, false, profile.des_service());
            self.handle_flow(now, flow_id.encode(), flow);
            self.send_responses(now, outbox);
        }
    }

    /// Whether just this question came a moment ago.
    fn is_repeated(&mut self, now: Instant, request: &Frame) -> bool {
        self.requests.retain(|other| now.since(other.time) < REPEATED_WITHIN);
        if self.requests.iter().any(|other| other.same_on_wire(request)) {
            return true;
        }
        if self.requests.len() == MAX_REQUESTS {
            self.requests.pop_front();
        }
        self.requests.push_back(request.with_time(now));
        false
    }

    fn response(
        &mut self,
        request: Header,
        from: Address,
        framing: Framing,
        message: Vec<u8>,
        outbox: &mut Outbox,
    ) {
        let id = request.response(from, false).encode();
        match framing {
            Framing::Raw if message.len() <= Frame::MAX_CLASSIC_DATA => {
                outbox.push(Frame::classic(id, &message));
            }
            Framing::Raw => {}
            Framing::Isotp => {
                let flow_header = Header::request(request.source, from, false, request.service);
                self.responses.retain(|open| open.id != id);
                if self.responses.len() == MAX_RESPONSES {
                    self.responses.remove(0);
                }
                let segmenter = Segmenter::new(message, false);
                self.responses.push(OutgoingResponse {
                    id,
                    flow_id: flow_header.encode(),
                    segmenter,
                });
            }
        }
    }

    fn handle_flow(&mut self, now: Instant, flow_id: u32, flow: FlowControl) {
        self.responses.retain_mut(|response| {
            response.flow_id != flow_id || response.segmenter.handle_flow(now, flow).is_ok()
        });
    }

    fn send_responses(&mut self, now: Instant, outbox: &mut Outbox) {
        self.responses.retain_mut(|response| {
            while let Some(segment) = response.segmenter.poll(now) {
                outbox.push(Frame::classic(response.id, segment.as_bytes()));
            }
            !response.segmenter.is_done() && response.segmenter.handle_timeout(now).is_ok()
        });
    }

    pub fn poll_timeout(&self) -> Option<Instant> {
        let standing = match self.standing {
            AddressState::Off => None,
            AddressState::Listening { until } | AddressState::Waiting { until, .. } => Some(until),
            AddressState::Held { .. } => self.next_beat,
        };
        let responses =
            self.responses.iter().filter_map(|response| response.segmenter.poll_timeout());
        standing.into_iter().chain(responses).min()
    }
}
