//! A node of the CAN platform that answers DES requests, for firmware: the counterpart of the kit
//! in C (`descan kit`), with the same behaviour.
//!
//! It takes an address, sends the heartbeat, answers DES requests, reads and writes of the
//! descriptor and commands. Sources: CAN platform §3.2.4 (modes, address resolution) and §4
//! (identifiers), the DES service document, ISO 15765-2 (transfers, sender's side).
//!
//! Input: received frames, ends of transmissions, error counters, time. Output: frames for two
//! transmit buffers, and actions such as the setup of the controller. Without I/O, `std` and an
//! allocator. Does not know the CAN controller, flash memory or the clock.
//!
//! ```toml
//! descan = { version = "0.1", default-features = false, features = ["node"] }
//! ```
//!
//! # Use
//!
//! After each input, and when [`Node::poll_timeout`] is over, call [`Node::handle_timeout`], then
//! do what [`Node::poll_action`] and [`Node::poll_transmit`] return:
//!
//! ```
//! use descan::node::{Node, NodeAction, NodeConfig, NodeDevice, NodeFrame, NodeSettings, Slot};
//! use descan::time::Instant;
//! use descan::wire::descriptor::AddressSetting;
//! use descan::wire::id::Address;
//!
//! const PUMP: NodeDevice = NodeDevice {
//!     services: &[&["DES", "1.0"], &["FLOW", "2.1"]],
//!     ..NodeDevice::named("PUMP")
//! };
//!
//! trait Board {
//!     fn now(&mut self) -> Instant;
//!     fn receive(&mut self) -> Option<NodeFrame>;
//!     fn errors(&mut self) -> (u16, bool);
//!     fn set_up_can(&mut self, bitrate: u32, is_silent: bool);
//!     fn is_empty(&mut self, slot: Slot) -> bool;
//!     fn transmit(&mut self, slot: Slot, frame: &NodeFrame);
//!     fn transmitted(&mut self, slot: Slot) -> Option<bool>;
//!     fn store(&mut self, settings: &NodeSettings) -> bool;
//! }
//!
//! fn step(node: &mut Node, board: &mut impl Board) {
//!     let now = board.now();
//!     for slot in Slot::ALL {
//!         if let Some(is_sent) = board.transmitted(slot) {
//!             node.handle_transmitted(now, slot, is_sent);
//!         }
//!     }
//!     while let Some(frame) = board.receive() {
//!         if node.handle_frame(now, &frame) {
//!             // For the application.
//!         }
//!     }
//!     let (counter, has_error) = board.errors();
//!     node.handle_errors(counter, has_error);
//!     node.handle_timeout(now);
//!     while let Some(action) = node.poll_action() {
//!         match action {
//!             NodeAction::SetUp { bitrate, is_silent } => board.set_up_can(bitrate, is_silent),
//!             NodeAction::Store(settings) => {
//!                 let is_stored = board.store(&settings);
//!                 node.handle_stored(is_stored);
//!             }
//!             NodeAction::ModeChanged(_) | NodeAction::Identify | NodeAction::Reboot => {}
//!         }
//!     }
//!     for slot in Slot::ALL {
//!         if board.is_empty(slot)
//!             && let Some(frame) = node.poll_transmit(slot)
//!         {
//!             board.transmit(slot, &frame);
//!         }
//!     }
//! }
//!
//! let address = AddressSetting::Preferred(Address::new(12).unwrap());
//! let settings = NodeSettings { address, ..NodeSettings::BLANK };
//! let node: Node = Node::new(&NodeConfig::DEFAULT, &PUMP, settings, 0x1234_5678);
//! assert_eq!(node.address(), None);
//! ```

mod clock;
mod config;
mod frame;
mod requester;
mod requests;
mod responses;

pub use clock::ExtendedClock;
pub use config::{NodeConfig, NodeDevice, NodeSettings};
pub use frame::NodeFrame;

use crate::frame::IdFilter;
use crate::time::Instant;
use crate::wire::descriptor::{AddressSetting, BitrateSetting};
use crate::wire::id::{Address, Header, Service};
use crate::wire::node::{Heartbeat, Mode};
use requester::{CommandEffect, ServedRequester};

/// Heartbeats for which a working node with the same UID is remembered.
const UID_MEMORY: u8 = 5;

/// A transmit buffer. The node has at most one frame in each, so frames of one identifier never
/// pass each other, and a heartbeat that waits for the bus keeps no response from being sent. Give
/// each a transmit mailbox of its own, or a queue that is sorted by identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// Heartbeats and the address claim.
    Heartbeat,
    /// All responses.
    Response,
}

impl Slot {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Heartbeat, Self::Response];
}

/// What the firmware is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NodeAction {
    /// Set up the controller: empty both transmit buffers, reset the error counters, bus-off and the
    /// memory of errors, and set no acceptance filter.
    SetUp {
        /// Bit rate in bit/s, one of [`BitrateSetting::RATES`].
        bitrate: u32,
        /// The controller only receives, without acknowledging or sending (bxCAN: SILM).
        is_silent: bool,
    },
    /// Store the settings, then call [`Node::handle_stored`].
    Store(NodeSettings),
    /// The mode is another one. After ARSLV the node has an address, perhaps another one. In IDLE
    /// switch off what can be switched off, in BOOT start the boot loader.
    ModeChanged(Mode),
    /// Blink or beep, so that a person finds the device.
    Identify,
    /// Restart the processor; otherwise the node begins again in INIT.
    Reboot,
}

/// Limits which modes a node enters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum ModeLimit {
    /// No firmware: BOOT instead of CFG, WORK and UFUNC.
    Boot,
    /// CFG instead of WORK and UFUNC: supply voltage for configuration only, failed self-test.
    Cfg,
    /// No limit.
    #[default]
    Work,
}

/// Steps until a node has an address (CAN platform §3.2.4.1 and §3.2.4.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum NodeStage {
    /// INIT: listens for any frame, to find the bit rate.
    Init,
    /// ARSLV: listens for addresses in use.
    Listen,
    /// ARSLV: has chosen an address and waits a random time.
    Wait,
    /// ARSLV: its claim is in the transmit buffer.
    Claim,
    /// Has an address.
    Run,
}

/// What a node enters with the next [`Node::handle_timeout`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ModeWish {
    Enter(Mode),
    /// ARSLV, for another node uses its address.
    Move,
}

/// Settings that are being stored.
#[derive(Clone, Copy, Debug)]
struct StorePending {
    settings: NodeSettings,
    /// Whom to answer, an index; `None`: the request was given up.
    requester: Option<usize>,
    /// What the write does after its response.
    effect: CommandEffect,
    /// True once [`NodeAction::Store`] was returned.
    is_reported: bool,
}

/// Returns the moment `micros` microseconds after another one.
fn after(at: Instant, micros: u64) -> Instant {
    Instant::from_micros(at.as_micros().saturating_add(micros))
}

/// Addresses, one bit each.
#[derive(Clone, Copy, Debug, Default)]
struct UsedAddresses([u32; 4]);

impl UsedAddresses {
    fn insert(&mut self, address: Address) {
        self.0[address.index() / 32] |= 1 << (address.index() % 32);
    }

    fn contains(&self, address: Address) -> bool {
        self.0[address.index() / 32] >> (address.index() % 32) & 1 != 0
    }
}

/// A node. `REQUESTERS`: how many are served at the same time, at least 1; the requests of further
/// ones are dropped, see [`Node::dropped`].
#[derive(Clone, Debug)]
pub struct Node<'a, const REQUESTERS: usize = 3> {
    config: &'a NodeConfig,
    device: &'a NodeDevice<'a>,
    settings: NodeSettings,
    stage: NodeStage,
    /// End of the stage; in [`NodeStage::Run`] when the next heartbeat is due.
    until: Instant,
    mode: Mode,
    wish: ModeWish,
    limit: ModeLimit,
    error: u8,
    /// Its address from [`NodeStage::Wait`] on.
    own: Address,
    in_use: UsedAddresses,
    /// Heartbeats until a working node with the same UID is forgotten.
    uid_memory: u8,
    /// Bit rate in bit/s.
    rate: u32,
    is_silent: bool,
    /// Transmit buffers with a frame, in the order of [`Slot::ALL`].
    has_frame: [bool; 2],
    is_heartbeat_due: bool,
    requesters: [ServedRequester; REQUESTERS],
    /// Requester whose frame was sent last, an index.
    turn: usize,
    storing: Option<StorePending>,
    dropped: u32,
    entropy: u32,
    random: u32,
    has_setup: bool,
    has_mode_change: bool,
    has_identify: bool,
    has_reboot: bool,
}

impl<'a, const REQUESTERS: usize> Node<'a, REQUESTERS> {
    /// Returns a node that begins in INIT with the first [`Self::handle_timeout`]: after power-on,
    /// once.
    ///
    /// `settings`: as stored, or [`NodeSettings::BLANK`]. `entropy`: bits that differ from board to
    /// board: the chip's unique number, the noise of an ADC. Two new boards with the same bits meet
    /// at one address until their bits differ, see [`Self::add_entropy`].
    pub fn new(
        config: &'a NodeConfig,
        device: &'a NodeDevice<'a>,
        settings: NodeSettings,
        entropy: u32,
    ) -> Self {
        const { assert!(REQUESTERS > 0, "a node serves at least one requester") };
        Self {
            config,
            device,
            settings,
            stage: NodeStage::Listen,
            until: Instant::ZERO,
            mode: Mode::Init,
            wish: ModeWish::Enter(Mode::Init),
            limit: ModeLimit::Work,
            error: 0,
            own: Address::DEBUG,
            in_use: UsedAddresses::default(),
            uid_memory: 0,
            rate: settings.bitrate.rate,
            is_silent: false,
            has_frame: [false; 2],
            is_heartbeat_due: false,
            requesters: [ServedRequester::FREE; REQUESTERS],
            turn: 0,
            storing: None,
            dropped: 0,
            entropy,
            random: 0,
            has_setup: false,
            has_mode_change: false,
            has_identify: false,
            has_reboot: false,
        }
    }

    /// Takes a received frame, in the order of reception. Not those that the controller itself
    /// sent.
    ///
    /// Returns true if the frame is for the application: a request to this node, in its mode, of a
    /// service that the node does not serve; or a response or unsolicited data of another node. The
    /// application answers a targeted request in any case, with ERR = 0 if it cannot: see
    /// [`Self::response_header`].
    pub fn handle_frame(&mut self, now: Instant, frame: &NodeFrame) -> bool {
        let header = frame.header();
        if self.stage == NodeStage::Init {
            self.wish = ModeWish::Enter(Mode::Arslv); // A frame: the bit rate is right.
        }
        if !header.is_conforming() {
            return false;
        }
        self.check_uid(header, frame.data());
        if self.must_move(header) {
            self.wish = ModeWish::Move;
            return false;
        }
        if self.stage != NodeStage::Run {
            self.in_use.insert(header.source);
            if !header.broadcast {
                self.in_use.insert(header.destination);
            }
            return false;
        }
        if !header.broadcast && header.destination != self.own {
            return false;
        }
        header.response || self.handle_request(now, header, frame)
    }

    /// Remembers the heartbeat of a working node with this node's UID, which then must not work (CAN
    /// platform §3.2.4.4).
    fn check_uid(&mut self, header: Header, data: &[u8]) {
        let is_working = header.response && !header.from_non_working;
        if is_working
            && header.service == self.config.heartbeat
            && self.config.uid_of(data) == Some(self.settings.uid)
        {
            self.uid_memory = UID_MEMORY;
        }
    }

    /// Returns true if another user of its address moves the node: not in IDLE (CAN platform
    /// §3.2.4.5), nor a claim a working node (§3.2.4.4).
    fn must_move(&self, header: Header) -> bool {
        self.stage >= NodeStage::Wait
            && header.source == self.own
            && self.mode != Mode::Idle
            && !(header.from_non_working && self.is_working())
    }

    /// Takes what became of the frame in a transmit buffer: sent and acknowledged, or given up.
    /// Call it before the frames that were received after it are taken.
    pub fn handle_transmitted(&mut self, now: Instant, slot: Slot, is_sent: bool) {
        if !core::mem::take(&mut self.has_frame[slot as usize]) {
            return;
        }
        match slot {
            Slot::Response => self.handle_response_sent(now, is_sent),
            Slot::Heartbeat if self.stage != NodeStage::Claim => {}
            Slot::Heartbeat if is_sent => self.run(now),
            Slot::Heartbeat => {
                // Chooses again. The controller stays active: two nodes on an empty bus need each
                // other's acknowledgement.
                self.stage = NodeStage::Listen;
                self.until = now;
            }
        }
    }

    /// Enters the configured mode, at the address that was claimed.
    fn run(&mut self, now: Instant) {
        self.stage = NodeStage::Run;
        self.until = after(now, self.config.period_micros());
        if self.settings.autostart && self.wish == ModeWish::Enter(Mode::Cfg) {
            self.wish = ModeWish::Enter(Mode::Work);
        }
    }

    /// Takes the state of the controller: the greater of its two error counters, 256 in bus-off;
    /// and whether it has detected an error on the bus since the last call (bxCAN: LEC in ESR is
    /// neither 0 nor 7; write 7). Call it at each error interrupt, or before each
    /// [`Self::handle_timeout`] and then at least once a millisecond in INIT.
    pub fn handle_errors(&mut self, counter: u16, has_error: bool) {
        let is_over = if self.stage == NodeStage::Init {
            has_error && self.wish != ModeWish::Enter(Mode::Arslv)
        } else {
            counter >= self.config.max_errors
        };
        if is_over {
            self.wish = ModeWish::Enter(Mode::Init);
        }
    }

    /// Takes the result of [`NodeAction::Store`]. False: the settings could not be or must not be
    /// changed; the request is refused.
    pub fn handle_stored(&mut self, is_stored: bool) {
        let Some(storing) = self.storing.take() else { return };
        if is_stored {
            self.settings = storing.settings;
        }
        let requester = storing.requester.and_then(|at| self.requesters.get_mut(at));
        if let Some(requester) = requester {
            requester.command.effect = is_stored.then_some(storing.effect);
            requester.command.is_storing = false;
        }
    }

    /// Handles deadlines that are over, and changes the mode.
    pub fn handle_timeout(&mut self, now: Instant) {
        for requester in &mut self.requesters {
            requester.handle_timeout(now);
        }
        loop {
            self.change_mode(now);
            if self.until > now {
                return;
            }
            match self.stage {
                // No node is there yet.
                NodeStage::Init => self.wish = ModeWish::Enter(Mode::Arslv),
                NodeStage::Listen => {
                    if !self.choose(now) {
                        self.wish = ModeWish::Enter(Mode::Arslv); // No address is free.
                    }
                }
                NodeStage::Wait => {
                    self.set_silent(false);
                    self.is_heartbeat_due = true;
                    return;
                }
                NodeStage::Claim => return,
                NodeStage::Run => self.beat(now),
            }
        }
    }

    /// A heartbeat is due. One whose predecessor still waits is left out.
    fn beat(&mut self, now: Instant) {
        let period = self.config.period_micros();
        self.is_heartbeat_due |= !self.has_frame[Slot::Heartbeat as usize];
        self.uid_memory = self.uid_memory.saturating_sub(1);
        self.until = after(self.until, period);
        if self.until <= now {
            self.until = after(now, period);
        }
    }

    /// Returns the mode that the node enters for `mode`, as far as it may.
    fn permitted(&self, mode: Mode) -> Mode {
        let mut mode = mode;
        if matches!(mode, Mode::Work | Mode::Ufunc) {
            let may_work = self.limit == ModeLimit::Work
                && self.settings.address != AddressSetting::None
                && self.uid_memory == 0
                && !self.settings.uid.is_blank();
            mode = match (may_work, self.error) {
                (false, _) => Mode::Cfg,
                (true, 0) => Mode::Work,
                (true, _) => Mode::Ufunc,
            };
        }
        if mode == Mode::Cfg && self.limit == ModeLimit::Boot { Mode::Boot } else { mode }
    }

    /// Enters the mode that is wished, as far as it is permitted.
    fn change_mode(&mut self, now: Instant) {
        let mode = match self.wish {
            ModeWish::Enter(mode) => self.permitted(mode),
            ModeWish::Move => Mode::Arslv,
        };
        match mode {
            Mode::Init => self.begin(now),
            Mode::Arslv => self.listen(NodeStage::Listen, now),
            _ if self.stage == NodeStage::Run => self.wish = ModeWish::Enter(mode),
            _ => return,
        }
        if self.mode != mode {
            if mode == Mode::Idle {
                self.until = now; // The others learn of it before it sleeps.
            }
            self.mode = mode;
            self.has_mode_change = true;
        }
    }

    /// Begins INIT, at the bit rate of the settings; after bus errors there at the next one, unless
    /// it is fixed.
    fn begin(&mut self, now: Instant) {
        let BitrateSetting { rate, is_fixed } = self.settings.bitrate;
        if self.stage != NodeStage::Init {
            self.rate = rate;
        } else if !is_fixed {
            let rates = BitrateSetting::RATES;
            let next = rates.into_iter().skip_while(|rate| *rate != self.rate).nth(1);
            self.rate = next.unwrap_or(rates[0]);
        }
        self.is_silent = false; // The controller is set up anew in any case.
        self.listen(NodeStage::Init, now);
    }

    /// Begins to listen for 1.5 * BUS_CFG_HR_TIME.
    fn listen(&mut self, stage: NodeStage, now: Instant) {
        self.stage = stage;
        self.until = after(now, self.config.period_micros() * 3 / 2);
        self.in_use = UsedAddresses::default();
        if self.wish == ModeWish::Move {
            self.in_use.insert(self.own);
        }
        self.requesters = [ServedRequester::FREE; REQUESTERS];
        if let Some(storing) = &mut self.storing {
            storing.requester = None;
        }
        self.is_heartbeat_due = false;
        self.wish = ModeWish::Enter(Mode::Cfg);
        self.set_silent(true);
    }

    /// Sets up the controller, if it is not silent or active as it is to be.
    fn set_silent(&mut self, is_silent: bool) {
        if self.is_silent != is_silent {
            self.is_silent = is_silent;
            self.has_frame = [false; 2];
            self.has_setup = true;
        }
    }

    /// ARSLV: chooses an address, to be claimed after a random part of BUS_CFG_HR_TIME. Returns
    /// false if it finds none that is free.
    fn choose(&mut self, now: Instant) -> bool {
        let setting = self.settings.address;
        let mut choice = setting.address().unwrap_or(Address::DEBUG);
        for _ in 0..Address::COUNT {
            if choice != Address::DEBUG && !self.in_use.contains(choice) {
                self.own = choice;
                self.stage = NodeStage::Wait;
                let part = u64::from(self.random() >> 16);
                self.until = after(now, (self.config.period_micros() * part) >> 16);
                return true;
            }
            if matches!(setting, AddressSetting::Fixed(_)) {
                return false;
            }
            choice = Address::from_bits((self.random() >> 25) as u8);
        }
        false
    }

    /// Returns when to call [`Self::handle_timeout`] if nothing happens before; `None`: the node
    /// waits for [`Self::poll_transmit`] or the end of a transmission.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let is_waiting = self.stage == NodeStage::Claim
            || (self.stage == NodeStage::Wait && self.is_heartbeat_due);
        let stage = (!is_waiting).then_some(self.until);
        self.requesters.iter().filter_map(ServedRequester::deadline).chain(stage).min()
    }

    /// Returns what to do next; `None` if there is nothing.
    pub fn poll_action(&mut self) -> Option<NodeAction> {
        if let Some(storing) = self.storing.as_mut().filter(|storing| !storing.is_reported) {
            storing.is_reported = true;
            return Some(NodeAction::Store(storing.settings));
        }
        if core::mem::take(&mut self.has_identify) {
            return Some(NodeAction::Identify);
        }
        if core::mem::take(&mut self.has_reboot) {
            return Some(NodeAction::Reboot);
        }
        if core::mem::take(&mut self.has_setup) {
            return Some(NodeAction::SetUp { bitrate: self.rate, is_silent: self.is_silent });
        }
        core::mem::take(&mut self.has_mode_change).then_some(NodeAction::ModeChanged(self.mode))
    }

    /// Returns the next frame for a transmit buffer, which must be empty; `None` if there is none,
    /// the last one has not ended, or [`Self::poll_action`] has a setup of the controller first.
    pub fn poll_transmit(&mut self, slot: Slot) -> Option<NodeFrame> {
        if self.has_setup || self.has_frame[slot as usize] {
            return None;
        }
        let frame = match slot {
            Slot::Heartbeat => self.next_heartbeat()?,
            Slot::Response => self.next_response()?,
        };
        self.has_frame[slot as usize] = true;
        Some(frame)
    }

    fn next_heartbeat(&mut self) -> Option<NodeFrame> {
        if !core::mem::take(&mut self.is_heartbeat_due) {
            return None;
        }
        let header = self.unsolicited_header(self.config.heartbeat);
        let heartbeat = Heartbeat {
            uid: Some(self.settings.uid),
            mode: Some(self.mode),
            error: Some(self.error),
        };
        let mut frame = self.config.heartbeat_frame(header, &heartbeat);
        if self.stage == NodeStage::Wait {
            frame.set_single_shot(true);
            self.stage = NodeStage::Claim;
        }
        Some(frame)
    }

    /// Changes the mode with the next [`Self::handle_timeout`], as a command from the bus does:
    /// INIT begins again, ARSLV resolves the address anew; the others need an address, and WORK and
    /// UFUNC also a configured address, a UID that is neither blank nor used by a working node, and
    /// the limit to permit them. INIT that is pending (of a new node, after bus errors) comes first,
    /// and so does another user of the address: then nothing is changed.
    pub fn set_mode(&mut self, mode: Mode) {
        let is_pending = matches!(self.wish, ModeWish::Enter(Mode::Init) | ModeWish::Move);
        if !is_pending || mode == Mode::Init {
            self.wish = ModeWish::Enter(mode);
        }
    }

    /// Limits the modes. A node beyond the limit changes its mode with the next
    /// [`Self::handle_timeout`].
    pub fn set_limit(&mut self, limit: ModeLimit) {
        self.limit = limit;
    }

    /// Sets the error code of the heartbeat; 0: none. A working node is in UFUNC while it is not 0,
    /// in WORK otherwise, from the next [`Self::handle_timeout`].
    pub fn set_error(&mut self, error: u8) {
        self.error = error;
    }

    /// Adds bits to the random numbers: the noise of an ADC, the time of a received frame.
    pub fn add_entropy(&mut self, bits: u32) {
        self.entropy = self.entropy.rotate_left(7) ^ bits;
    }

    /// Returns a random number, for RND7 and delays of the application; its high bits are the random
    /// ones.
    pub fn random(&mut self) -> u32 {
        self.random = self
            .random
            .wrapping_add(self.entropy)
            .wrapping_mul(0x9E37_79B1)
            .wrapping_add(0x3C6E_F35F);
        self.random
    }

    /// Returns the mode.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Returns true in WORK and UFUNC: the node may send requests.
    pub fn is_working(&self) -> bool {
        matches!(self.mode, Mode::Work | Mode::Ufunc)
    }

    /// Returns the node's address; `None` in INIT and ARSLV, when it has none and must not send.
    pub fn address(&self) -> Option<Address> {
        (!matches!(self.mode, Mode::Init | Mode::Arslv)).then_some(self.own)
    }

    /// Returns the settings, with all that was written and stored.
    pub fn settings(&self) -> &NodeSettings {
        &self.settings
    }

    /// Returns how many requests were dropped: of more than `REQUESTERS` requesters, or a command
    /// before that before was answered.
    pub fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Returns the identifier of the response to a request; `is_ok` false: with ERR = 0.
    pub fn response_header(&self, request: Header, is_ok: bool) -> Header {
        Header { no_error: is_ok, ..request.response(self.own, !self.is_working()) }
    }

    /// Returns the identifier of unsolicited data to all, with a new random DST.
    pub fn unsolicited_header(&mut self, service: Service) -> Header {
        let rnd7 = (self.random() >> 25) as u8;
        Header::unsolicited(self.own, rnd7, !self.is_working(), service)
    }

    /// Returns the identifier of a request to one working node; `None` unless this node works, for
    /// only working nodes send requests (CAN platform §4.3).
    pub fn request_header(&self, to: Address, service: Service) -> Option<Header> {
        self.is_working().then(|| Header::request(self.own, to, false, service))
    }

    /// Returns acceptance filters that together pass all that the node needs; `None` in INIT and
    /// ARSLV, when it needs all frames. To be set at each [`NodeAction::ModeChanged`].
    pub fn filters(&self) -> Option<[IdFilter; 5]> {
        const RESPONSE: u32 = 1 << 26;
        const BROADCAST: u32 = 1 << 25;
        const SERVICE: u32 = Service::MAX as u32;
        const DESTINATION: u32 = 0x7F << 10;
        let own = u32::from(self.address()?.number());
        let des = u32::from(self.config.des.number());
        let heartbeat = u32::from(self.config.heartbeat.number());
        let targeted = RESPONSE | BROADCAST | DESTINATION;
        Some([
            // From its own address: a conflict.
            IdFilter { id: own << 17, mask: 0x7F << 17 },
            // Requests to it, and responses to its requests.
            IdFilter { id: own << 10, mask: targeted },
            IdFilter { id: RESPONSE | own << 10, mask: targeted },
            // DES requests to all.
            IdFilter { id: BROADCAST | des, mask: RESPONSE | BROADCAST | SERVICE },
            // Heartbeats: UIDs.
            IdFilter { id: RESPONSE | heartbeat, mask: RESPONSE | SERVICE },
        ])
    }
}
