//! The node for firmware: an input is frames, time, errors and results of sending.

use super::Target;
use super::choices::Choices;
use descan::node::{
    ModeLimit, Node, NodeAction, NodeConfig, NodeDevice, NodeFrame, NodeSettings, Slot,
};
use descan::time::{Duration, Instant};
use descan::wire::descriptor::{AddressSetting, BitrateSetting};
use descan::wire::id::{Address, Header, Service};
use descan::wire::node::{Mode, Uid};
use descan::wire::profile::WriteEffect;

/// An input of target `node` begins with the settings, then whether the node has its address already.
pub const NODE: Target = Target {
    name: "node",
    check: |input| {
        let mut choices = Choices::new(input);
        let config = config(&mut choices);
        let device = device(&mut choices);
        let mut run = NodeRun::new(&config, &device, &mut choices);
        while !choices.is_over() {
            run.step(&mut choices);
        }
    },
    words: &[
        b"\x04DES\x01",
        b"\x04DES\x02",
        b"\x00\x04DES\x02",
        b"DES\x01",
        b"DES\x02",
        b"\x30\0\0",
        b"\x30\x03\xF3",
        b"\x31\0\0",
        b"\x32\0\0",
        UID,
    ],
};

const UID: &[u8; 6] = b"BOARD1";
/// Requesters that the node serves: few, so that some are dropped.
const REQUESTERS: usize = 2;
/// Frames, actions and turns at one moment.
const MAX_AT_ONCE: u32 = 8;
/// Microseconds that the steps of an input choose from.
const PAUSES: [u64; 10] =
    [0, 1, 900, 2_000, 20_000, 300_000, 1_000_000, 1_600_000, 5_000_000, 86_400_000_000];

/// A name of several frames, and services of more.
const LONG_NAME: &str = "A NAME THAT IS LONGER THAN ONE FRAME, AND THAN A SINGLE FRAME OF CAN FD";
const SERVICES: &[&[&str]] =
    &[&["DES", "1.0"], &["AUGER", "2.1"], &["A SERVICE", "WITH A LONG VERSION", "AND MORE"]];

/// All service numbers, as in the `des_config.h` of the kit in C.
pub const ALL_SERVICES: NodeConfig = NodeConfig {
    identify: Some(Service::from_bits(0x018)),
    mode: Some(Service::from_bits(0x019)),
    reboot: Some(Service::from_bits(0x01A)),
    write_uid: Some(Service::from_bits(0x011)),
    write_address: Some(Service::from_bits(0x016)),
    write_bitrate: Some(Service::from_bits(0x015)),
    ..NodeConfig::DEFAULT
};

fn config(choices: &mut Choices<'_>) -> NodeConfig {
    let flags = choices.byte();
    let all = ALL_SERVICES;
    match flags % 8 {
        0..=3 => all,
        4 => NodeConfig { write_effect: WriteEffect::Restart, has_raw_framing: false, ..all },
        5 => NodeConfig { uid_offset: None, mode_offset: Some(0), error_offset: None, ..all },
        6 => NodeConfig { heartbeat_ms: choices.u32(), max_errors: 1, ..all },
        _ => NodeConfig { heartbeat: all.des, mode_codes: [9; 7], uid_offset: Some(200), ..all },
    }
}

fn device(choices: &mut Choices<'_>) -> NodeDevice<'static> {
    match choices.below(3) {
        0 => NodeDevice { services: SERVICES, ..NodeDevice::named("FEED") },
        1 => NodeDevice { services: SERVICES, ..NodeDevice::named(LONG_NAME) },
        _ => NodeDevice::named(""),
    }
}

fn settings(choices: &mut Choices<'_>) -> NodeSettings {
    let uid = if choices.flag() { Uid(*UID) } else { Uid::BLANK };
    NodeSettings {
        uid,
        address: AddressSetting::from_code(choices.byte()).unwrap_or(AddressSetting::None),
        bitrate: BitrateSetting::from_code(choices.byte()).unwrap_or(NodeSettings::BLANK.bitrate),
        autostart: choices.flag(),
    }
}

/// A node with its board, which checks what the node asks of it.
struct NodeRun<'a> {
    config: &'a NodeConfig,
    device: &'a NodeDevice<'a>,
    node: Node<'a, REQUESTERS>,
    stored: NodeSettings,
    /// The end of storing is an input of its own.
    stores_later: bool,
    now: Instant,
    /// Set up, and not silent.
    is_active: bool,
    /// Transmit buffers with a frame.
    has_frame: [bool; 2],
    /// Address of the frames since the node was in ARSLV.
    address: Option<Address>,
}

impl<'a> NodeRun<'a> {
    fn new(
        config: &'a NodeConfig,
        device: &'a NodeDevice<'a>,
        choices: &mut Choices<'_>,
    ) -> NodeRun<'a> {
        let stored = settings(choices);
        let mut run = NodeRun {
            config,
            device,
            node: Node::new(config, device, stored, choices.u32()),
            stored,
            stores_later: choices.flag(),
            now: Instant::ZERO,
            is_active: false,
            has_frame: [false; 2],
            address: None,
        };
        if choices.flag() {
            run.resolve();
        }
        run
    }

    /// Lets the node take an address, as far as it can.
    fn resolve(&mut self) {
        for _ in 0..20 {
            self.turn([true; 2]);
            self.end_frames([true; 2]);
            self.turn([true; 2]);
            let due = self.node.poll_timeout();
            if self.node.address().is_some() {
                return;
            }
            self.now = due.unwrap_or(self.now);
        }
    }

    fn step(&mut self, choices: &mut Choices<'_>) {
        let kind = choices.byte();
        match kind % 16 {
            0..=6 => {
                let frame = self.platform_frame(choices);
                self.node.handle_frame(self.now, &frame);
            }
            7 => {
                if let Some(frame) = any_frame(choices) {
                    self.node.handle_frame(self.now, &frame);
                }
            }
            8 | 9 => self.pass(PAUSES[usize::from(kind / 16) % PAUSES.len()]),
            10 => self.end_frames([kind & 16 != 0, kind & 32 != 0]),
            11 => {
                let counter = u16::from(kind / 16) * 20;
                self.node.handle_errors(counter, choices.below(16) == 1);
            }
            12 => self.command(choices),
            13 => self.node.handle_stored(kind & 16 != 0),
            _ => {}
        }
        self.turn([kind < 0xC0, kind & 0x30 != 0]);
        if kind < 0xA0 {
            self.end_frames([true; 2]);
            self.turn([true; 2]);
        }
    }

    fn command(&mut self, choices: &mut Choices<'_>) {
        let value = choices.byte();
        match value % 8 {
            0 => self.node.set_mode(Mode::ALL[usize::from(value / 8) % Mode::ALL.len()]),
            1 => self.node.set_limit(
                [ModeLimit::Boot, ModeLimit::Cfg, ModeLimit::Work][usize::from(value / 8) % 3],
            ),
            2 => self.node.set_error(value / 128),
            3 => self.node.add_entropy(choices.u32()),
            4 => self.check_headers(),
            5 => {
                let (config, device) = (self.config, self.device);
                self.node = Node::new(config, device, self.stored, choices.u32());
                (self.is_active, self.has_frame, self.address) = (false, [false; 2], None);
            }
            _ => self.check_filters(choices),
        }
    }

    /// Lets time pass: each deadline is handled, unless there are too many.
    fn pass(&mut self, micros: u64) {
        let end = self.now + Duration::from_micros(micros);
        for _ in 0..30 {
            let Some(due) = self.node.poll_timeout().filter(|due| *due <= end) else { break };
            self.now = self.now.max(due);
            self.turn([true; 2]);
        }
        self.now = end;
    }

    /// Ends the transmission of the frames in the buffers; `is_sent`: or gives them up.
    fn end_frames(&mut self, is_sent: [bool; 2]) {
        for slot in Slot::ALL {
            if std::mem::take(&mut self.has_frame[slot as usize]) {
                self.node.handle_transmitted(self.now, slot, is_sent[slot as usize]);
                if self.node.address().is_none() && !is_sent[slot as usize] {
                    self.address = None; // The claim failed: it may choose another one.
                }
            }
        }
    }

    /// Handles deadlines and takes what the node has; `takes`: frames of which slots.
    fn turn(&mut self, takes: [bool; 2]) {
        self.node.handle_timeout(self.now);
        let mut count = 0;
        while let Some(action) = self.node.poll_action() {
            count += 1;
            assert!(count <= MAX_AT_ONCE, "actions without end");
            self.act(action);
        }
        for slot in Slot::ALL.into_iter().filter(|slot| takes[*slot as usize]) {
            if let Some(frame) = self.node.poll_transmit(slot) {
                self.check_frame(slot, &frame);
                self.has_frame[slot as usize] = true;
            }
            assert_eq!(self.node.poll_transmit(slot), None, "two frames for one buffer");
        }
        self.check_timeout();
    }

    fn act(&mut self, action: NodeAction) {
        match action {
            NodeAction::SetUp { bitrate, is_silent } => {
                assert!(BitrateSetting::RATES.contains(&bitrate), "{bitrate} bit/s");
                (self.is_active, self.has_frame) = (!is_silent, [false; 2]);
                if is_silent {
                    self.address = None; // It listens again: another node uses the address.
                }
            }
            NodeAction::Store(settings) => {
                self.stored = settings;
                if !self.stores_later {
                    self.node.handle_stored(true);
                    assert_eq!(*self.node.settings(), settings);
                }
            }
            NodeAction::ModeChanged(mode) => {
                assert_eq!(mode, self.node.mode());
                let has_address = !matches!(mode, Mode::Init | Mode::Arslv);
                assert_eq!(self.node.address().is_some(), has_address);
                assert!(!self.node.is_working() || !self.node.settings().uid.is_blank());
                if !has_address {
                    self.address = None;
                }
            }
            NodeAction::Identify | NodeAction::Reboot => {}
        }
    }

    /// Checks a frame that the node sends.
    fn check_frame(&mut self, slot: Slot, frame: &NodeFrame) {
        assert!(self.is_active, "sends while silent: {frame:?}");
        assert!(!self.has_frame[slot as usize], "the buffer has a frame: {frame:?}");
        let has_dlc = NodeFrame::fd(frame.id(), frame.data()).is_some();
        assert!(frame.data().len() <= 8 || (frame.is_fd() && has_dlc), "{frame:?}");
        let header = frame.header();
        assert!(header.is_conforming() && header.response, "{frame:?}");
        assert_eq!(header.from_non_working, !self.node.is_working(), "{frame:?}");
        assert_ne!(header.source, Address::DEBUG, "{frame:?}");
        assert_eq!(header.broadcast, slot == Slot::Heartbeat, "{frame:?}");
        assert_eq!(*self.address.get_or_insert(header.source), header.source, "{frame:?}");
        assert!(self.node.address().is_none_or(|own| own == header.source), "{frame:?}");
        assert_eq!(frame.is_single_shot(), self.node.address().is_none(), "only claims");
    }

    /// The next deadline is later, and not later than a node listens.
    fn check_timeout(&self) {
        let now = self.now;
        let Some(due) = self.node.poll_timeout() else {
            assert_eq!(self.node.address(), None, "nothing is due");
            return;
        };
        assert!(due > now, "due at {due}, handled until {now}");
        let period = u64::from(self.config.heartbeat_ms.clamp(10, 60_000)) * 1000;
        let most = Duration::from_micros(period * 3 / 2);
        assert!(due.since(now) <= most, "due at {due}, handled until {now}");
    }

    fn check_headers(&mut self) {
        let (is_working, service) = (self.node.is_working(), Service::from_bits(0x155));
        let header = self.node.request_header(Address::from_bits(7), service);
        assert_eq!(header.is_some(), is_working, "only working nodes send requests");
        let header = self.node.unsolicited_header(service);
        assert!(header.is_conforming() && header.from_non_working != is_working);
    }

    /// The filters pass what the node answers.
    fn check_filters(&mut self, choices: &mut Choices<'_>) {
        let Some(filters) = self.node.filters() else {
            assert_eq!(self.node.address(), None);
            return;
        };
        let frame = self.platform_frame(choices);
        let header = frame.header();
        let is_own = !header.broadcast && Some(header.destination) == self.node.address();
        let is_des = header.service == self.config.des && !header.response && header.broadcast;
        if header.is_conforming() && (is_own || is_des) {
            assert!(filters.iter().any(|filter| filter.matches(frame.id())), "{frame:?}");
        }
    }

    /// Returns a frame near to those that the node takes.
    fn platform_frame(&self, choices: &mut Choices<'_>) -> NodeFrame {
        let (flags, parties, shape) = (choices.byte(), choices.byte(), choices.byte());
        let own = self.node.address().unwrap_or(Address::from_bits(12));
        let is_own = parties & 0xF8 == 0xF8;
        let header = Header {
            from_non_working: flags & 1 != 0 && is_own,
            to_non_working: flags & 2 != 0,
            response: flags & 0x0C == 0x0C,
            broadcast: flags & 0x30 == 0x30,
            no_error: flags & 0x0C == 0x0C,
            source: if is_own { own } else { Address::from_bits(parties % 6) },
            destination: if parties & 0x60 == 0 { Address::from_bits(parties) } else { own },
            service: Service::from_bits(
                [2, 2, 2, 2, 2, 1, 0x10, 0x11, 0x12, 0x14, 0x15, 0x16, 0x17, 0x18, 0x19, 0x1A]
                    [usize::from(shape % 16)],
            ),
        };
        let len = [5, 4, 6, 3, 8, 1, 0, 7][usize::from(shape / 16) % 8];
        let data = choices.bytes(len);
        let id = header.encode();
        let new = if flags & 0xC0 == 0xC0 { NodeFrame::fd } else { NodeFrame::classic };
        let frame = new(id, data).or_else(|| NodeFrame::classic(id, &[]));
        frame.expect("the identifier has 29 bits")
    }
}

fn any_frame(choices: &mut Choices<'_>) -> Option<NodeFrame> {
    let (id, shape) = (choices.u32() & 0x1FFF_FFFF, choices.byte());
    if shape & 1 == 0 {
        return NodeFrame::classic(id, choices.bytes(usize::from(shape / 2) % 9));
    }
    let lengths = [0, 8, 12, 16, 20, 24, 32, 48, 64];
    NodeFrame::fd(id, choices.bytes(lengths[usize::from(shape / 2) % lengths.len()]))
}
