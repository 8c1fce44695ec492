//! The nodes for firmware, in C99 (`src/kit`) and in Rust (`src/node`), with simulated time: each
//! test of [`c`] is one of [`rust`], too.
//!
//! [`KitProcess`] is the kit in C, compiled with the C compiler of this machine and run in a process
//! of its own, tests/kit/driver.c; [`node_bench::NodeBench`] has the same commands for the node in
//! Rust. [`SingleBoard`] is one node without a bus, [`IdealBus`] several nodes on a bus. The size test and the sanitizers need compilers of their own: where they are
//! missing they are skipped with a message; in CI all must be installed.

mod build;
mod c;
mod command;
mod equality;
mod node;
mod node_bench;
mod program;
mod rust;
mod rust_config;
mod size;

use build::compiled;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// Added to an address in DEV_CFG_ADDR: it is preferred, not fixed.
const PREFERRED: u8 = 0x80;
/// BUS_CFG_HR_TIME, in microseconds.
const PERIOD: u32 = 1_000_000;
const NAME: &[u8] = &[4, b'D', b'E', b'S', 1];
const SERVICES: &[u8] = &[4, b'D', b'E', b'S', 2];
const CONTINUE: &[u8] = &[0x30, 0, 0];

/// Codes of the modes.
mod mode {
    pub const INIT: u8 = 0;
    pub const ARSLV: u8 = 1;
    pub const CFG: u8 = 2;
    pub const BOOT: u8 = 3;
    pub const WORK: u8 = 4;
    pub const UFUNC: u8 = 5;
    pub const IDLE: u8 = 6;
}

fn hex(bytes: &[u8]) -> String {
    if bytes.is_empty() { "-".to_owned() } else { descan::text::hex(bytes, "") }
}

fn unhex(text: &str) -> Vec<u8> {
    (0..text.len() / 2)
        .map(|at| u8::from_str_radix(&text[2 * at..2 * at + 2], 16).unwrap())
        .collect()
}

/// A frame that a node sends or receives.
#[derive(Clone, Debug, PartialEq, Eq)]
struct KitFrame {
    id: u32,
    data: Vec<u8>,
    fd: bool,
    once: bool,
}

impl KitFrame {
    fn classic(id: u32, data: &[u8]) -> Self {
        Self { id, data: data.to_vec(), fd: false, once: false }
    }

    fn source(&self) -> u8 {
        (self.id >> 17 & 0x7F) as u8
    }
}

/// What a node did.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Act {
    Send { slot: usize, frame: KitFrame },
    Bus { rate: u8, silent: bool },
    Mode(u8),
    Identify,
    Reboot,
    Store { uid: Vec<u8>, address: u8, bitrate: u8 },
    Wait(u32),
    ForApplication,
    Other(String),
}

impl Act {
    fn parse(line: &str) -> Self {
        let words: Vec<&str> = line.split_whitespace().collect();
        let number = |at: usize| words[at].parse::<u32>().unwrap();
        let byte = |at: usize| u8::from_str_radix(words[at], 16).unwrap();
        match words[0] {
            "tx" => Self::Send {
                slot: number(1) as usize,
                frame: KitFrame {
                    id: u32::from_str_radix(words[2], 16).unwrap(),
                    data: unhex(words[3].trim_start_matches('-')),
                    fd: words[4] == "1",
                    once: words[5] == "1",
                },
            },
            "bus" => Self::Bus { rate: number(1) as u8, silent: words[2] == "1" },
            "event" if words[1] == "0" => Self::Mode(number(2) as u8),
            "event" if words[1] == "1" => Self::Identify,
            "event" => Self::Reboot,
            "store" => Self::Store { uid: unhex(words[1]), address: byte(2), bitrate: byte(3) },
            "wait" => Self::Wait(number(1)),
            "app" => Self::ForApplication,
            _ => Self::Other(line.to_owned()),
        }
    }
}

/// What a node is.
#[derive(Clone, Debug)]
struct BoardSpec {
    name: Vec<u8>,
    /// The services response without its type byte.
    services: Vec<u8>,
    uid: [u8; 6],
    address: u8,
    bitrate: u8,
    autostart: bool,
    entropy: u32,
}

impl BoardSpec {
    fn new(address: u8) -> Self {
        Self {
            name: b"FEED".to_vec(),
            services: b"\x00DES\x001.0\x00".to_vec(),
            uid: *b"BOARD1",
            address,
            bitrate: 0x80,
            autostart: true,
            entropy: 0x1234_5678,
        }
    }
}

/// Nodes under test, with the commands of tests/kit/driver.c.
trait Bench {
    fn start() -> Self;

    /// Runs a command; returns what the node did.
    fn run(&mut self, command: &str) -> Vec<Act>;

    fn set_up(&mut self, number: usize, spec: &BoardSpec) {
        self.run(&format!(
            "node {number} {} {} {} {:02X} {:02X} {:X} {:X}",
            hex(&spec.name),
            hex(&spec.services),
            hex(&spec.uid),
            spec.address,
            spec.bitrate,
            u8::from(spec.autostart),
            spec.entropy,
        ));
    }
}

/// The process of tests/kit/driver.c.
struct KitProcess {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl Bench for KitProcess {
    fn start() -> Self {
        let mut child = Command::new(compiled("driver"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let input = child.stdin.take().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        Self { child, input, output }
    }

    fn run(&mut self, command: &str) -> Vec<Act> {
        writeln!(self.input, "{command}").unwrap();
        let mut acts = Vec::new();
        loop {
            let mut line = String::new();
            assert!(self.output.read_line(&mut line).unwrap() > 0, "driver ended: {command}");
            match line.trim() {
                "ok" => return acts,
                line => acts.push(Act::parse(line)),
            }
        }
    }
}

impl Drop for KitProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// One node without a bus: each of its frames is sent at once, unless `holds`.
struct SingleBoard<B> {
    driver: B,
    now: u32,
    /// Leaves frames in the transmit buffers.
    holds: bool,
}

impl<B: Bench> SingleBoard<B> {
    /// Creates a node that is started.
    fn new(spec: &BoardSpec) -> Self {
        Self::starting_at(spec, 0).0
    }

    /// Creates a node that is started at a time; returns what it did, too.
    fn starting_at(spec: &BoardSpec, now: u32) -> (Self, Vec<Act>) {
        let mut board = Self { driver: B::start(), now, holds: false };
        board.driver.set_up(0, spec);
        board.driver.run(&format!("time {now}"));
        board.driver.run("init 0");
        let mut acts = board.poll();
        acts.retain(|act| !matches!(act, Act::Wait(_)));
        (board, acts)
    }

    /// Creates a node that has its address.
    fn running(spec: &BoardSpec) -> Self {
        let mut board = Self::new(spec);
        board.pass(5 * PERIOD);
        board
    }

    fn command(&mut self, command: &str) -> Vec<Act> {
        let mut acts = self.driver.run(command);
        let mut queue: VecDeque<Act> = acts.iter().cloned().collect();
        while let Some(act) = queue.pop_front() {
            if let Act::Send { slot, .. } = act
                && !self.holds
            {
                acts.extend(self.driver.run(&format!("result 0 {slot} 1")));
            }
        }
        acts
    }

    /// Calls des_poll.
    fn poll(&mut self) -> Vec<Act> {
        self.command("poll 0")
    }

    /// Lets time pass; the node is polled when it wants to be. Returns what it did, with the time.
    fn pass_timed(&mut self, micros: u32) -> Vec<(u32, Act)> {
        let mut acts = Vec::new();
        let mut left = micros;
        loop {
            let mut wait = left;
            for act in self.poll() {
                if let Act::Wait(micros) = act {
                    wait = micros.min(left);
                } else {
                    acts.push((self.now, act));
                }
            }
            if left == 0 {
                return acts;
            }
            left -= wait;
            self.now = self.now.wrapping_add(wait);
            self.driver.run(&format!("time {}", self.now));
        }
    }

    fn pass(&mut self, micros: u32) -> Vec<Act> {
        self.pass_timed(micros).into_iter().map(|(_, act)| act).collect()
    }

    /// Passes a frame to the node, without polling it.
    fn receive(&mut self, frame: &KitFrame) -> Vec<Act> {
        let command =
            format!("frame 0 {:08X} {} {}", frame.id, hex(&frame.data), u8::from(frame.fd));
        self.command(&command)
    }

    /// Passes a frame to the node, and polls it once.
    fn take(&mut self, frame: &KitFrame) -> Vec<Act> {
        let mut acts = self.receive(frame);
        acts.extend(self.poll());
        acts.retain(|act| !matches!(act, Act::Wait(_)));
        acts
    }

    /// Passes a frame and polls for 5 ms; returns the frames that the node sent.
    fn exchange(&mut self, frame: &KitFrame) -> Vec<KitFrame> {
        let mut acts = self.receive(frame);
        acts.extend(self.pass(5000));
        responses(&acts)
    }
}

/// The responses among what a node did.
fn responses(acts: &[Act]) -> Vec<KitFrame> {
    acts.iter()
        .filter_map(|act| match act {
            Act::Send { slot: 1, frame } => Some(frame.clone()),
            _ => None,
        })
        .collect()
}

/// The heartbeats and claims among what a node did.
fn heartbeats(acts: &[Act]) -> Vec<KitFrame> {
    acts.iter()
        .filter_map(|act| match act {
            Act::Send { slot: 0, frame } => Some(frame.clone()),
            _ => None,
        })
        .collect()
}

fn modes(acts: &[Act]) -> Vec<u8> {
    acts.iter()
        .filter_map(|act| if let Act::Mode(mode) = act { Some(*mode) } else { None })
        .collect()
}

fn data(frames: &[KitFrame]) -> Vec<Vec<u8>> {
    frames.iter().map(|frame| frame.data.clone()).collect()
}

/// Identifier of a request from `from` to the node at `to`; `d`: to non-working nodes.
fn request_id(from: u8, to: u8, d: bool, service: u16) -> u32 {
    u32::from(d) << 27 | u32::from(from) << 17 | u32::from(to) << 10 | u32::from(service)
}

/// A DES request of the debug device to the working node at 12.
fn des_request(data: &[u8]) -> KitFrame {
    KitFrame::classic(request_id(0, 12, false, 2), data)
}

/// A heartbeat with a UID.
fn heartbeat(from: u8, uid: [u8; 6], is_working: bool) -> KitFrame {
    let code = if is_working { mode::WORK } else { mode::CFG };
    let id = u32::from(!is_working) << 28 | 0x0700_0001 | u32::from(from) << 17 | 99 << 10;
    let mut data = uid.to_vec();
    data.extend([code, 0]);
    KitFrame::classic(id, &data)
}

/// A node on a [`IdealBus`].
#[derive(Default)]
struct BusNode {
    is_silent: bool,
    is_on: bool,
    rate: u8,
    tec: u32,
    buffers: [Option<KitFrame>; 2],
    poll_at: u64,
    mode: u8,
}

/// Several nodes on an ideal bus: frames take 250 µs, and need another active node to be
/// acknowledged. Two different frames with one identifier, or at different bit rates, destroy each
/// other.
struct IdealBus<B> {
    driver: B,
    nodes: Vec<BusNode>,
    now: u64,
    free_at: u64,
    /// Frames that were sent, with the time and the sender.
    log: Vec<(u64, usize, KitFrame)>,
}

impl<B: Bench> IdealBus<B> {
    const FRAME_MICROS: u64 = 250;

    fn new(specs: &[BoardSpec]) -> Self {
        let mut driver = B::start();
        for (number, spec) in specs.iter().enumerate() {
            driver.set_up(number, spec);
        }
        let nodes = specs.iter().map(|_| BusNode::default()).collect();
        Self { driver, nodes, now: 0, free_at: 0, log: Vec::new() }
    }

    fn switch_on(&mut self, number: usize) {
        self.driver.run(&format!("time {}", self.now as u32));
        self.nodes[number] = BusNode { is_on: true, poll_at: self.now, ..BusNode::default() };
        self.act(number, &format!("init {number}"));
    }

    fn switch_off(&mut self, number: usize) {
        self.nodes[number] = BusNode::default();
    }

    fn act(&mut self, number: usize, command: &str) {
        for act in self.driver.run(command) {
            let node = &mut self.nodes[number];
            match act {
                Act::Send { slot, frame } => {
                    assert!(!node.is_silent && node.buffers[slot].is_none());
                    node.buffers[slot] = Some(frame);
                }
                Act::Bus { rate, silent } => {
                    let (is_silent, buffers) = (silent, [None, None]);
                    *node = BusNode { rate, is_silent, buffers, tec: 0, ..std::mem::take(node) };
                }
                Act::Mode(mode) => node.mode = mode,
                Act::Wait(micros) => node.poll_at = self.now + u64::from(micros),
                _ => {}
            }
        }
    }

    /// Sends the frame with the lowest identifier.
    fn transmit(&mut self) {
        let lowest = (self.nodes.iter().filter(|node| node.is_on))
            .flat_map(|node| node.buffers.iter().flatten().map(|frame| frame.id))
            .min();
        let Some(lowest) = lowest.filter(|_| self.now >= self.free_at) else { return };
        self.free_at = self.now + Self::FRAME_MICROS;
        let mut senders = Vec::new();
        for (number, node) in self.nodes.iter().enumerate() {
            for (slot, frame) in node.buffers.iter().enumerate() {
                if let Some(frame) = frame.as_ref().filter(|frame| frame.id == lowest) {
                    senders.push((number, slot, frame.clone()));
                }
            }
        }
        let (first, _, frame) = senders[0].clone();
        let rate = self.nodes[first].rate;
        let is_active = |node: &BusNode| node.is_on && !node.is_silent;
        let is_broken = senders.iter().any(|(_, _, other)| other.data != frame.data)
            || self.nodes.iter().any(|node| is_active(node) && node.rate != rate);
        let is_acknowledged = (self.nodes.iter().enumerate()).any(|(number, node)| {
            is_active(node) && senders.iter().all(|(sender, ..)| *sender != number)
        });
        let is_sent = is_acknowledged && !is_broken;
        for (number, slot, frame) in &senders {
            let node = &mut self.nodes[*number];
            if is_sent || frame.once {
                node.buffers[*slot] = None;
                self.driver.run(&format!("result {number} {slot} {}", if is_sent { 1 } else { 2 }));
            }
            node.tec = if is_sent { node.tec.saturating_sub(1) } else { node.tec + 8 };
            node.poll_at = self.now;
            let tec = node.tec;
            self.driver.run(&format!("errors {number} {tec}"));
        }
        if !is_sent {
            return;
        }
        self.log.push((self.now, first, frame.clone()));
        for number in 0..self.nodes.len() {
            let node = &self.nodes[number];
            let is_sender = senders.iter().any(|(sender, ..)| *sender == number);
            if node.is_on && !is_sender && node.rate == rate {
                let text = format!("frame {number} {:08X} {} 0", frame.id, hex(&frame.data));
                self.act(number, &text);
                self.nodes[number].poll_at = self.now;
            } else if node.is_on && !is_sender {
                // Listening at another bit rate: DES_ERROR_SEEN.
                self.driver.run(&format!("errors {number} 512"));
            }
        }
    }

    /// Lets time pass, in steps of a quarter of a frame.
    fn pass(&mut self, micros: u64) {
        let end = self.now + micros;
        while self.now < end {
            let due = self.nodes.iter().filter(|node| node.is_on).map(|node| node.poll_at).min();
            let is_waiting = self.nodes.iter().any(|node| node.buffers.iter().any(Option::is_some));
            let next = due.unwrap_or(end).max(self.now + 1);
            let next = if is_waiting { next.min(self.free_at.max(self.now + 1)) } else { next };
            self.now = next.min(end);
            self.driver.run(&format!("time {}", self.now as u32));
            self.transmit();
            for number in 0..self.nodes.len() {
                if self.nodes[number].is_on && self.nodes[number].poll_at <= self.now {
                    self.act(number, &format!("poll {number}"));
                }
            }
        }
    }

    fn mode(&self, number: usize) -> u8 {
        self.nodes[number].mode
    }

    /// The address from which a node sent last.
    fn address(&self, number: usize) -> Option<u8> {
        let last = self.log.iter().rev().find(|(_, sender, _)| *sender == number);
        last.map(|(_, _, frame)| frame.source())
    }
}
