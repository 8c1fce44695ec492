//! The node in Rust behind the commands of tests/kit/driver.c, in this process.

use super::{Act, Bench, unhex};
use crate::checks::node::ALL_SERVICES;
use descan::node::{
    ExtendedClock, ModeLimit, Node, NodeAction, NodeDevice, NodeFrame, NodeSettings, Slot,
};
use descan::time::Instant;
use descan::wire::des::ServicesResponse;
use descan::wire::descriptor::{
    AddressSetting, BitrateSetting, Capabilities, FirmwareVersion, Gid,
};
use descan::wire::id::Header;
use descan::wire::node::{Mode, Uid};
use std::collections::BTreeMap;

/// Bit of the value of the command `errors`: an error was detected.
const ERROR_SEEN: u32 = 0x200;
/// Time until the next look at the transmit buffers, in microseconds.
const LOOK_AFTER: u32 = 1000;

/// A board with a node: its controller and its memory of settings.
struct NodeBoard {
    node: Node<'static>,
    device: &'static NodeDevice<'static>,
    settings: NodeSettings,
    entropy: u32,
    errors: u32,
    /// What became of the frame in each transmit buffer, until the node has taken it.
    results: [Option<bool>; 2],
    has_frame: [bool; 2],
    refuses: bool,
    is_locked: bool,
}

fn leak<T: ?Sized>(value: Box<T>) -> &'static T {
    Box::leak(value)
}

fn text(bytes: Vec<u8>) -> &'static str {
    leak(String::from_utf8(bytes).unwrap().into_boxed_str())
}

/// The strings of a services response without its type byte.
fn services(body: &[u8]) -> &'static [&'static [&'static str]] {
    let message = [&[2], body].concat();
    let services = ServicesResponse::decode(&message);
    let strings = services.services().map(|service| {
        let strings: Vec<&'static str> =
            service.strings().map(|string| text(string.to_vec())).collect();
        leak(strings.into_boxed_slice())
    });
    leak(strings.collect::<Vec<_>>().into_boxed_slice())
}

impl NodeBoard {
    fn new(words: &[&str]) -> Self {
        let bytes = |at: usize| unhex(words[at].trim_start_matches('-'));
        let byte = |at: usize| u8::from_str_radix(words[at], 16).unwrap();
        let device = leak(Box::new(NodeDevice {
            name: text(bytes(0)),
            services: services(&bytes(1)),
            gid: Gid([1, 2, 3, 4, 5, 6]),
            serial: 0x1122_3344,
            firmware: FirmwareVersion { major: 0x0102, minor: 0x0304 },
            capabilities: Capabilities {
                is_programmable: true,
                has_fpu: true,
                cpu: 1,
                cpu_flags: 0x8002,
            },
        }));
        let settings = NodeSettings {
            uid: Uid(bytes(2).try_into().unwrap()),
            address: AddressSetting::from_code(byte(3)).unwrap(),
            bitrate: BitrateSetting::from_code(byte(4)).unwrap(),
            autostart: byte(5) != 0,
        };
        let entropy = u32::from_str_radix(words[6], 16).unwrap();
        Self {
            node: Node::new(&ALL_SERVICES, device, settings, entropy),
            device,
            settings,
            entropy,
            errors: 0,
            results: [None; 2],
            has_frame: [false; 2],
            refuses: false,
            is_locked: false,
        }
    }

    fn restart(&mut self) {
        self.node = Node::new(&ALL_SERVICES, self.device, self.settings, self.entropy);
    }

    /// Passes the ends of transmissions to the node.
    fn collect(&mut self, now: Instant) {
        for slot in Slot::ALL {
            if let Some(is_sent) = self.results[slot as usize].take() {
                self.has_frame[slot as usize] = false;
                self.node.handle_transmitted(now, slot, is_sent);
            }
        }
    }

    fn receive(&mut self, now: Instant, words: &[&str]) -> Vec<Act> {
        self.collect(now);
        let id = u32::from_str_radix(words[0], 16).unwrap();
        let data = unhex(words[1].trim_start_matches('-'));
        let new = if words[2] == "1" { NodeFrame::fd } else { NodeFrame::classic };
        let is_for_application = self.node.handle_frame(now, &new(id, &data).unwrap());
        let mut acts = Vec::new();
        if let Some(NodeAction::Store(settings)) = self.node.poll_action() {
            self.store(settings, &mut acts);
        }
        acts.extend(is_for_application.then_some(Act::ForApplication));
        acts
    }

    /// One turn of a main loop.
    fn step(&mut self, clock: &mut ExtendedClock, now: &mut Instant, words: &[&str]) -> Vec<Act> {
        let number = |at: usize| words[at].parse::<u32>().unwrap();
        *now = clock.extend(number(0));
        self.errors = number(1);
        for slot in Slot::ALL {
            let result = number(2 + slot as usize);
            self.results[slot as usize] = [None, Some(true), Some(false)][result as usize];
        }
        let mut acts = Vec::new();
        if words.len() > 4 {
            acts.extend(self.receive(*now, &words[4..]));
        }
        acts.extend(self.poll(*now));
        acts
    }

    fn store(&mut self, settings: NodeSettings, acts: &mut Vec<Act>) {
        if !self.is_locked {
            self.settings = settings;
            let (address, bitrate) = (settings.address.code(), settings.bitrate.code().unwrap());
            acts.push(Act::Store { uid: settings.uid.0.to_vec(), address, bitrate });
        }
        self.node.handle_stored(!self.is_locked);
    }

    fn poll(&mut self, now: Instant) -> Vec<Act> {
        let mut acts = Vec::new();
        self.collect(now);
        self.node.handle_errors((self.errors & 0x1FF) as u16, self.errors & ERROR_SEEN != 0);
        self.errors &= !ERROR_SEEN;
        self.node.handle_timeout(now);
        while let Some(action) = self.node.poll_action() {
            match action {
                NodeAction::SetUp { bitrate, is_silent: silent } => {
                    (self.errors, self.results, self.has_frame) = (0, [None; 2], [false; 2]);
                    let rate = BitrateSetting::RATES.iter().position(|it| *it == bitrate);
                    acts.push(Act::Bus { rate: rate.unwrap() as u8, silent });
                }
                NodeAction::Store(settings) => self.store(settings, &mut acts),
                NodeAction::ModeChanged(mode) => {
                    acts.push(Act::Mode(ALL_SERVICES.mode_codes[mode as usize]));
                }
                NodeAction::Identify => acts.push(Act::Identify),
                NodeAction::Reboot => acts.push(Act::Reboot),
            }
        }
        for slot in Slot::ALL.into_iter().filter(|_| !self.refuses) {
            if let Some(frame) = self.node.poll_transmit(slot) {
                self.has_frame[slot as usize] = true;
                let (fd, once) = (frame.is_fd(), frame.is_single_shot());
                let data = frame.data().to_vec();
                let frame = super::KitFrame { id: frame.id(), data, fd, once };
                acts.push(Act::Send { slot: slot as usize, frame });
            }
        }
        acts.push(Act::Wait(self.wait(now)));
        acts
    }

    /// Returns the time until the next poll. The transmit buffers have no interrupts.
    fn wait(&self, now: Instant) -> u32 {
        let due = self.node.poll_timeout();
        assert!(due.is_none_or(|due| due > now), "due at {due:?}, handled until {now}");
        let wait = due.map_or(u32::MAX, |due| due.since(now).as_micros() as u32);
        if self.has_frame.contains(&true) || self.refuses { wait.min(LOOK_AFTER) } else { wait }
    }
}

/// The boards of a test, and their time.
#[derive(Default)]
pub struct NodeBench {
    boards: BTreeMap<usize, NodeBoard>,
    clock: ExtendedClock,
    now: Instant,
}

impl Bench for NodeBench {
    fn start() -> Self {
        Self::default()
    }

    fn run(&mut self, command: &str) -> Vec<Act> {
        let words: Vec<&str> = command.split_whitespace().collect();
        if words[0] == "id" {
            return vec![identifier(words[1])];
        }
        let number: usize = words[1].parse().unwrap();
        let value = words.get(2).and_then(|word| word.parse::<u32>().ok()).unwrap_or_default();
        let now = self.now;
        match words[0] {
            "time" => {
                self.now = self.clock.extend(number as u32);
                return Vec::new();
            }
            "node" => {
                self.boards.insert(number, NodeBoard::new(&words[2..]));
                return Vec::new();
            }
            _ => {}
        }
        let board = self.boards.get_mut(&number).unwrap();
        match words[0] {
            "init" => board.restart(),
            "frame" => return board.receive(now, &words[2..]),
            "poll" => return board.poll(now),
            "result" => {
                let is_sent = [None, Some(true), Some(false)][words[3].parse::<usize>().unwrap()];
                board.results[value as usize] = is_sent;
            }
            "errors" => board.errors = value,
            "refuse" => board.refuses = value != 0,
            "locked" => board.is_locked = value != 0,
            "mode" => board.node.set_mode(Mode::ALL[value as usize]),
            "limit" => board.node.set_limit(match value {
                2 => ModeLimit::Cfg,
                3 => ModeLimit::Boot,
                _ => ModeLimit::Work,
            }),
            "fault" => board.node.set_error(value as u8),
            "step" => return board.step(&mut self.clock, &mut self.now, &words[2..]),
            "dropped" => return vec![Act::Other(format!("dropped {}", board.node.dropped()))],
            "filters" => {
                let id = u32::from_str_radix(words[2], 16).unwrap();
                let filters = board.node.filters().unwrap();
                let passes = filters.iter().any(|filter| filter.matches(id));
                return passes.then(|| Act::Other("passes".to_owned())).into_iter().collect();
            }
            _ => panic!("unknown command: {command}"),
        }
        Vec::new()
    }
}

/// What the command `id` prints.
fn identifier(id: &str) -> Act {
    let header = Header::decode(u32::from_str_radix(id, 16).unwrap());
    let (source, destination) = (header.source.number(), header.destination.number());
    let (service, conforms) = (header.service.number(), u8::from(header.is_conforming()));
    Act::Other(format!("{source} {destination} {service} {conforms}"))
}
