//! A device on a CAN interface of Linux, with the node in Rust as in firmware.
//!
//! ```sh
//! cargo run --example socketcan_node -- can0 [SETTINGS-FILE] [--name NAME] [--configure]
//! ```
//!
//! It has INIT with silent listening, address resolution, the heartbeat, DES, the descriptor and the
//! commands of des_config.rs. Settings are 9 bytes in a file, as firmware has them in flash. `--name`
//! gives it another name and services. With `--configure` (as root) it sets the bit rate and listen-only
//! mode of a real interface with the program ip; without it the interface is left as it is, and silent
//! means that nothing is sent. Linux has no single shot for one frame: a claim is repeated until it is
//! acknowledged.

mod des_config;

use anyhow::{Context, bail};
use des_config::{CONFIG, DEVICE};
use descan::node::{Node, NodeAction, NodeDevice, NodeFrame, NodeSettings, Slot};
use descan::time::Instant;
use descan::wire::descriptor::{AddressSetting, BitrateSetting};
use descan::wire::node::Uid;
use nix::libc::{MSG_DONTWAIT, MSG_PEEK};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use socketcan::{
    CanAnyFrame, CanDataFrame, CanFdFrame, CanFdSocket, EmbeddedFrame, ExtendedId, Frame, Socket,
    SocketOptions,
};
use std::io::{self, ErrorKind};
use std::os::fd::AsFd;
use std::process::Command;

/// Bits of the identifier of an error frame (linux/can/error.h).
mod error_class {
    /// The error counters may have changed.
    pub const CONTROLLER: u32 = 0x004;
    pub const PROTOCOL: u32 = 0x008;
    pub const BUS_OFF: u32 = 0x040;
    pub const BUS_ERROR: u32 = 0x080;
    /// Bytes 6 and 7 are the error counters.
    pub const COUNTERS: u32 = 0x200;
}

/// What the arguments say.
#[derive(Debug, Default)]
struct Arguments {
    interface: String,
    settings: Option<String>,
    name: Option<String>,
    is_configured: bool,
}

/// The interface as the controller of the device, and the file as its memory.
#[derive(Debug)]
struct Board {
    arguments: Arguments,
    socket: CanFdSocket,
    start: std::time::Instant,
    /// Greater error counter, and whether an error was reported since it was read.
    errors: (u16, bool),
    /// The transmit buffers.
    frames: [Option<NodeFrame>; 2],
}

/// A frame of the socket.
enum Received {
    Data(NodeFrame),
    /// The frame of this buffer was sent.
    Sent(Slot),
    Nothing,
}

impl Board {
    fn open(arguments: Arguments) -> anyhow::Result<Self> {
        let interface = &arguments.interface;
        let socket = CanFdSocket::open(interface).with_context(|| interface.clone())?;
        socket.set_nonblocking(true)?;
        // Own frames come back when they were sent.
        socket.set_recv_own_msgs(true)?;
        socket.set_error_filter_accept_all()?;
        let start = std::time::Instant::now();
        Ok(Self { arguments, socket, start, errors: (0, false), frames: [None; 2] })
    }

    fn now(&self) -> Instant {
        Instant::from_micros(self.start.elapsed().as_micros() as u64)
    }

    fn settings(&self) -> Option<NodeSettings> {
        let bytes = std::fs::read(self.arguments.settings.as_ref()?).ok()?;
        let bytes: [u8; 9] = bytes.try_into().ok()?;
        let [u0, u1, u2, u3, u4, u5, address, bitrate, autostart] = bytes;
        Some(NodeSettings {
            uid: Uid([u0, u1, u2, u3, u4, u5]),
            address: AddressSetting::from_code(address)?,
            bitrate: BitrateSetting::from_code(bitrate)?,
            autostart: autostart != 0,
        })
    }

    fn store(&self, settings: &NodeSettings) -> bool {
        let Some(path) = &self.arguments.settings else { return false };
        let Some(bitrate) = settings.bitrate.code() else { return false };
        let rest = [settings.address.code(), bitrate, u8::from(settings.autostart)];
        std::fs::write(path, [&settings.uid.0[..], &rest].concat()).is_ok()
    }

    fn set_up(&mut self, bitrate: u32, is_silent: bool) {
        (self.errors, self.frames) = ((0, false), [None; 2]);
        println!("bus: {bitrate} bit/s{}", if is_silent { ", silent" } else { "" });
        if !self.arguments.is_configured {
            return;
        }
        let (interface, listen_only) =
            (&self.arguments.interface, if is_silent { "on" } else { "off" });
        let command = format!(
            "ip link set {interface} down; ip link set {interface} type can bitrate {bitrate} \
             listen-only {listen_only} berr-reporting on; ip link set {interface} up"
        );
        let status = Command::new("sh").args(["-c", &command]).status();
        if !status.is_ok_and(|status| status.success()) {
            eprintln!("failed: {command}");
        }
    }

    /// Puts a frame into a transmit buffer. One that the kernel does not take is given up.
    fn transmit(&mut self, slot: Slot, frame: &NodeFrame) -> bool {
        let Some(id) = ExtendedId::new(frame.id()) else { return false };
        let sent = if frame.is_fd() {
            CanFdFrame::new(id, frame.data()).map(|mut frame| {
                frame.set_brs(true);
                self.socket.write_frame(&frame)
            })
        } else {
            CanDataFrame::new(id, frame.data()).map(|frame| self.socket.write_frame(&frame))
        };
        let is_sent = sent.is_some_and(|sent| sent.is_ok());
        self.frames[slot as usize] = is_sent.then_some(*frame);
        is_sent
    }

    /// Reads a frame.
    ///
    /// # Errors
    /// There is none, or the interface is down.
    fn receive(&mut self) -> io::Result<Received> {
        // The flag of an own frame is passed on by this call only.
        let (_, flags) = self
            .socket
            .as_raw_socket()
            .recv_vectored_with_flags(&mut [], MSG_PEEK | MSG_DONTWAIT)?;
        let frame = match self.socket.read_frame()? {
            CanAnyFrame::Normal(frame) => NodeFrame::from_can(&frame),
            CanAnyFrame::Fd(frame) if frame.is_extended() => {
                NodeFrame::fd(frame.raw_id(), frame.data())
            }
            CanAnyFrame::Error(frame) => {
                self.note_error(frame.error_bits(), frame.data());
                None
            }
            CanAnyFrame::Fd(_) | CanAnyFrame::Remote(_) => None,
        };
        let Some(frame) = frame else { return Ok(Received::Nothing) };
        if !flags.is_confirm() {
            return Ok(Received::Data(frame));
        }
        let slot = Slot::ALL.into_iter().find(|slot| {
            self.frames[*slot as usize].is_some_and(|pending| pending.id() == frame.id())
        });
        Ok(slot.map_or(Received::Nothing, Received::Sent))
    }

    fn note_error(&mut self, class: u32, data: &[u8]) {
        use error_class::{BUS_ERROR, BUS_OFF, CONTROLLER, COUNTERS, PROTOCOL};
        if class & BUS_OFF != 0 {
            self.errors.0 = 256;
        } else if let [.., tec, rec] = *data
            && class & (CONTROLLER | COUNTERS) != 0
        {
            self.errors.0 = u16::from(tec.max(rec));
        }
        self.errors.1 |= class & (PROTOCOL | BUS_ERROR) != 0;
    }

    /// Waits for a frame, at most until a moment.
    fn wait(&self, until: Option<Instant>) {
        let wait = until.map_or(u64::MAX, |until| until.since(self.now()).as_micros() as u64);
        let millis = u16::try_from(wait.div_ceil(1000)).unwrap_or(u16::MAX);
        let mut input = [PollFd::new(self.socket.as_fd(), PollFlags::POLLIN)];
        // An error is seen when it reads.
        let _ = poll(&mut input, PollTimeout::from(millis));
    }
}

/// One turn of the main loop.
fn step(node: &mut Node, board: &mut Board) -> io::Result<()> {
    loop {
        match board.receive() {
            Ok(Received::Data(frame)) => {
                let is_for_application = node.handle_frame(board.now(), &frame);
                if is_for_application && !frame.header().response {
                    println!("for the application: {frame:?}");
                }
            }
            Ok(Received::Sent(slot)) => {
                board.frames[slot as usize] = None;
                node.handle_transmitted(board.now(), slot, true);
            }
            Ok(Received::Nothing) => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => break,
            // An interface that is configured is down for a moment.
            Err(_) if board.arguments.is_configured => break,
            Err(error) => return Err(error),
        }
    }
    let now = board.now();
    let has_error = std::mem::take(&mut board.errors.1);
    node.handle_errors(board.errors.0, has_error);
    node.handle_timeout(now);
    while let Some(action) = node.poll_action() {
        match action {
            NodeAction::SetUp { bitrate, is_silent } => board.set_up(bitrate, is_silent),
            NodeAction::Store(settings) => {
                let is_stored = board.store(&settings);
                node.handle_stored(is_stored);
            }
            NodeAction::ModeChanged(mode) => println!("mode {mode}"),
            NodeAction::Identify => println!("identify"),
            NodeAction::Reboot => println!("reboot"),
        }
    }
    for slot in Slot::ALL {
        if board.frames[slot as usize].is_none()
            && let Some(frame) = node.poll_transmit(slot)
            && !board.transmit(slot, &frame)
        {
            node.handle_transmitted(now, slot, false);
        }
    }
    board.wait(node.poll_timeout());
    Ok(())
}

fn arguments() -> anyhow::Result<Arguments> {
    let mut arguments = Arguments::default();
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match &*word {
            "--configure" => arguments.is_configured = true,
            "--name" => arguments.name = words.next(),
            _ if arguments.interface.is_empty() => arguments.interface = word,
            _ => arguments.settings = Some(word),
        }
    }
    if arguments.interface.is_empty() {
        bail!("usage: socketcan_node INTERFACE [SETTINGS-FILE] [--name NAME] [--configure]");
    }
    Ok(arguments)
}

fn main() -> anyhow::Result<()> {
    let mut board = Board::open(arguments()?)?;
    let name = board.arguments.name.clone().unwrap_or(DEVICE.name.to_owned());
    let data = format!("{name}-DATA");
    let services: [&[&str]; 3] = [&["DES", "1.0"], &[&data, "2.1"], &["LOG", "0.3"]];
    let device = NodeDevice { name: &name, services: &services, ..DEVICE };
    let settings = board.settings().unwrap_or(NodeSettings::BLANK);
    let mut node: Node = Node::new(&CONFIG, &device, settings, fastrand::u32(..));
    loop {
        step(&mut node, &mut board).with_context(|| board.arguments.interface.clone())?;
    }
}
