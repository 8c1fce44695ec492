//! Local node: descan's own address (CAN platform §3.2.4.2), its heartbeat, and its responses to
//! DES requests (protocol §6.1, §6.2).
//!
//! Does not know which requests descan sends; only whether it may send, and from which address.

use super::config::Config;
use super::outbox::Outbox;
use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::des::{self, Request};
use crate::wire::framing::Framing;
use crate::wire::id::{Address, Header};
use crate::wire::isotp::{FlowControl, Pci, Segmenter};
use crate::wire::node::{Heartbeat, Mode, Uid};
use crate::wire::profile::{Announce, Profile, ProfileKey, UidProfile};
use std::collections::VecDeque;

/// Name in descan's name response.
pub(super) const NAME: &[u8] = b"DSCAN";
/// Begin of the text of its UID.
const UID_PREFIX: &str = "DSCAN";
/// Maximum number of own responses that wait for flow control. Bounds the memory; a scan has one
/// inspector, rarely two.
const MAX_RESPONSES: usize = 4;
/// A request received again within this time was repeated on its way: two responses would look like
/// two devices. An inspector repeats a request after 200 ms at the earliest (protocol §4.3).
const REQUEST_COPY_WINDOW: Duration = Duration::from_millis(200);
/// Maximum number of requests stored to detect repeated ones. Bounds the memory: four requests, in
/// both framings, of two inspectors.
const MAX_REQUESTS: usize = 16;
/// Periods since its last use in which an address counts as used. After that a
/// device is lost (protocol §4.6).
const USED_FOR_PERIODS: u32 = 5;

/// State of the own address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum AddressState {
    None,
    Listening { until: Instant },
    Claiming { address: Address, since: Instant, until: Instant },
    Held { address: Address },
}

/// Change of descan's own address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum AddressChange {
    Taken(Address),
    Lost(Address),
    /// The configured address is used by another node, or, with `None`, all are used.
    Blocked(Option<Address>),
}

/// Own multi-frame response that is being sent.
#[derive(Clone, Debug)]
struct OutgoingResponse {
    id: u32,
    flow_id: u32,
    segmenter: Segmenter<Vec<u8>>,
}

/// descan's node on one bus.
#[derive(Clone, Debug)]
pub(super) struct LocalNode {
    state: AddressState,
    wanted: Option<Address>,
    /// True after another node used the own address: it is then claimed after a random delay, so
    /// that two nodes do not claim it at the same time repeatedly.
    contested: bool,
    /// True if the last search found no free address.
    blocked: bool,
    last_use: [Option<Instant>; Address::COUNT],
    period: Duration,
    uid: Uid,
    heartbeat_known: bool,
    next_heartbeat: Option<Instant>,
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
        // An alphabet without these letters gets other random characters.
        let uid = Uid::parse(&format!("{UID_PREFIX}{random}"), &config.profile.uid)
            .unwrap_or_else(|| Uid::from_sextets(std::array::from_fn(|_| rng.u8(1..63))));
        let mut local_node = Self {
            state: AddressState::None,
            wanted: config.address,
            contested: false,
            blocked: false,
            last_use: [None; Address::COUNT],
            period,
            uid,
            heartbeat_known: false,
            next_heartbeat: None,
            responses: Vec::new(),
            requests: VecDeque::new(),
        };
        if !config.listen_only {
            local_node.listen(now);
        }
        local_node
    }

    /// Takes another profile, by which no heartbeat was received yet. Drops the frames to be sent.
    pub fn set_profile(&mut self, profile: &Profile) {
        self.period = profile.heartbeat.period();
        self.heartbeat_known = false;
        self.responses.clear();
        self.requests.clear();
    }

    /// Releases the address and listens for used addresses for 1.5 × BUS_CFG_HR_TIME.
    pub fn listen(&mut self, now: Instant) {
        self.state = AddressState::Listening { until: now + self.period.mul_f64(1.5) };
        self.next_heartbeat = None;
        self.responses.clear();
    }

    /// Returns the own address while it is held.
    pub fn held(&self) -> Option<Address> {
        match self.state {
            AddressState::Held { address } => Some(address),
            _ => None,
        }
    }

    /// Returns the state of the own address for display.
    pub fn own_address(&self) -> super::OwnAddress {
        match self.state {
            AddressState::None => super::OwnAddress::None,
            AddressState::Listening { .. } if self.blocked => {
                super::OwnAddress::Blocked(self.wanted)
            }
            AddressState::Listening { .. } => super::OwnAddress::Listening,
            AddressState::Claiming { address, .. } => super::OwnAddress::Claiming(address),
            AddressState::Held { address } => super::OwnAddress::Held(address),
        }
    }

    /// Notes the addresses in a conforming frame of another node. `destination_counts` is false for
    /// a broadcast and for a repeated DST.
    pub fn note_used(&mut self, now: Instant, header: Header, destination_counts: bool) {
        self.last_use[header.source.index()] = Some(now);
        // A frame sent to descan does not show another node at its address.
        if destination_counts && self.held() != Some(header.destination) {
            self.last_use[header.destination.index()] = Some(now);
        }
    }

    /// Notes a heartbeat that fits the profile: other nodes can decode descan's heartbeat.
    pub fn note_heartbeat(&mut self) {
        self.heartbeat_known = true;
    }

    /// Forgets that a heartbeat fitted the profile: the bus uses another protocol.
    pub fn forget_heartbeat(&mut self) {
        self.heartbeat_known = false;
    }

    /// Handles a frame of another node from the address held or claimed.
    pub fn handle_address_conflict(
        &mut self,
        now: Instant,
        source: Address,
    ) -> Option<AddressChange> {
        match self.state {
            AddressState::Held { address } if address == source => {
                self.contested = true;
                self.listen(now);
                Some(AddressChange::Lost(address))
            }
            AddressState::Claiming { address, .. } if address == source => {
                self.contested = true;
                self.listen(now);
                None
            }
            _ => None,
        }
    }

    /// Returns true if another node used `address` recently.
    fn is_used(&self, now: Instant, address: Address) -> bool {
        let window = self.period * USED_FOR_PERIODS;
        self.last_use[address.index()].is_some_and(|used| now.since(used) < window)
    }

    /// Returns a free address: the configured one, or address 0, or a random one; `None` if there
    /// is none.
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

    /// Claims an address when due, and sends responses and, if `announces`, heartbeats that are due.
    pub fn handle_timeout(
        &mut self,
        now: Instant,
        profile: &Profile,
        announces: bool,
        rng: &mut fastrand::Rng,
        outbox: &mut Outbox,
    ) -> Option<AddressChange> {
        let change = match self.state {
            AddressState::Listening { until } if now >= until => {
                match self.pick_address(now, rng) {
                    None => {
                        self.listen(now);
                        let news = !std::mem::replace(&mut self.blocked, true);
                        news.then_some(AddressChange::Blocked(self.wanted))
                    }
                    // Address 0 belongs to the debug device unless another node uses it.
                    Some(Address::DEBUG) if !self.contested => {
                        Some(self.hold_address(now, Address::DEBUG))
                    }
                    Some(address) => {
                        self.blocked = false;
                        let wait = Duration::from_micros(rng.u64(..self.period.as_micros() as u64));
                        self.state =
                            AddressState::Claiming { address, since: now, until: now + wait };
                        None
                    }
                }
            }
            AddressState::Claiming { address, since, until } if now >= until => {
                let used = self.last_use[address.index()].is_some_and(|used| used >= since);
                if used {
                    self.listen(now);
                    None
                } else {
                    Some(self.hold_address(now, address))
                }
            }
            _ => None,
        };
        if self.is_heartbeat_due(now) && announces && self.sends_heartbeats(profile) {
            self.send_heartbeat(profile, rng, outbox);
        }
        self.send_responses(now, outbox);
        change
    }

    fn hold_address(&mut self, now: Instant, address: Address) -> AddressChange {
        self.responses.clear();
        self.blocked = false;
        self.state = AddressState::Held { address };
        self.next_heartbeat = Some(now);
        AddressChange::Taken(address)
    }

    /// Returns true if descan sends heartbeats, by the profile's `announce`.
    fn sends_heartbeats(&self, profile: &Profile) -> bool {
        match profile.heartbeat.announce {
            Announce::Always => true,
            Announce::Never => false,
            Announce::Auto => profile.is_given(ProfileKey::Heartbeat) || self.heartbeat_known,
        }
    }

    /// Returns true if a heartbeat is due, and plans the next.
    fn is_heartbeat_due(&mut self, now: Instant) -> bool {
        let is_due = self.next_heartbeat.is_some_and(|due| due <= now);
        if is_due {
            self.next_heartbeat = Some(now + self.period);
        }
        is_due
    }

    fn send_heartbeat(&self, profile: &Profile, rng: &mut fastrand::Rng, outbox: &mut Outbox) {
        let Some(address) = self.held() else { return };
        if outbox.is_paused() {
            return;
        }
        let heartbeat = Heartbeat { uid: Some(self.uid), mode: Some(Mode::Work), error: Some(0) };
        let (data, len) = heartbeat.encode(&profile.heartbeat, &profile.modes.codes());
        let rnd7 = rng.u8(..128);
        let header = Header::unsolicited(address, rnd7, false, profile.heartbeat_service());
        outbox.push(Frame::classic(header.encode(), &data[..len]));
    }

    /// Responds to a DES request of another node, and processes its flow control.
    pub fn handle_request(
        &mut self,
        now: Instant,
        header: Header,
        request: Option<(Framing, Request)>,
        frame: &Frame,
        profile: &Profile,
        outbox: &mut Outbox,
    ) {
        let Some(address) = self.held() else { return };
        if header.to_non_working || (!header.broadcast && header.destination != address) {
            return;
        }
        if let Some((framing, request)) = request {
            if self.is_repeated(now, frame) {
                return;
            }
            let message = match request {
                Request::Name => des::encode_name(NAME).collect(),
                Request::Services => des::encode_services(&[["DES", "1.0"]]).collect(),
            };
            self.start_response(header, address, framing, message, outbox);
            self.send_responses(now, outbox);
        } else if let Ok(Pci::Flow(flow)) = Pci::decode(frame.data(), frame.is_fd) {
            let flow_id = Header::request(header.source, address, false, profile.des_service());
            self.handle_flow(now, flow_id.encode(), flow);
            self.send_responses(now, outbox);
        }
    }

    /// Returns true if the same request was received a moment ago.
    fn is_repeated(&mut self, now: Instant, request: &Frame) -> bool {
        self.requests.retain(|other| now.since(other.time) < REQUEST_COPY_WINDOW);
        if self.requests.iter().any(|other| other.same_on_wire(request)) {
            return true;
        }
        if self.requests.len() == MAX_REQUESTS {
            self.requests.pop_front();
        }
        self.requests.push_back(request.with_time(now));
        false
    }

    /// Responds to a request. Raw responses that do not fit one frame are not sent.
    fn start_response(
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
        let state = match self.state {
            AddressState::None => None,
            AddressState::Listening { until } | AddressState::Claiming { until, .. } => Some(until),
            AddressState::Held { .. } => self.next_heartbeat,
        };
        let responses =
            self.responses.iter().filter_map(|response| response.segmenter.poll_timeout());
        state.into_iter().chain(responses).min()
    }
}

/// Returns true if this is the UID of an inspector.
pub(super) fn is_inspector_uid(uid: Uid, alphabet: &UidProfile) -> bool {
    uid.text(alphabet).starts_with(UID_PREFIX)
}
