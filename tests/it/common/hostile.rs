//! A full bus of nodes that keep no rule: every address is used by boards with different UIDs and
//! names, responses are malformed, identifiers are random.

use descan::frame::{CanId, Frame};
use descan::log::{LogEntry, LogTime};
use descan::time::Instant;
use nix::sys::stat::Mode;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;
use std::thread::{self, JoinHandle};

/// Frames per second of a full bus at 1 Mbit/s.
pub const RATE: u64 = 8_000;

const HEARTBEAT: u32 = 0x001;
const DES: u32 = 0x002;
const RESPONSE: u32 = 0x0500_0000;
const UNSOLICITED: u32 = 0x0700_0000;
const NON_WORKING: u32 = 0x1000_0000;

/// Yields the frames of such a bus without end, [`RATE`] of them per second.
pub fn frames(seed: u64) -> impl Iterator<Item = Frame> {
    let mut random = fastrand::Rng::with_seed(seed);
    (0..).map(move |number: u64| {
        let time = Instant::from_micros(number * 1_000_000 / RATE);
        frame(&mut random).with_time(time)
    })
}

/// Writes such a bus as candump text to a new pipe until nothing reads it: at its pace, or as fast
/// as it is read.
pub fn feed(pipe: &Path, is_paced: bool) -> JoinHandle<()> {
    nix::unistd::mkfifo(pipe, Mode::S_IRWXU).expect("a pipe");
    let pipe = pipe.to_owned();
    thread::spawn(move || {
        let mut pipe = OpenOptions::new().write(true).open(&pipe).expect("the pipe");
        let start = std::time::Instant::now();
        for frame in frames(1) {
            if is_paced {
                let due = frame.time.since(Instant::ZERO);
                thread::sleep(due.saturating_sub(start.elapsed()));
            }
            if writeln!(pipe, "{}", line_of(frame)).is_err() {
                return;
            }
        }
    })
}

/// The line of a frame in a log from 2026-11-23 00:00 UTC.
fn line_of(frame: Frame) -> String {
    let time = LogTime::from_micros(1_795_392_000_000_000 + frame.time.as_micros());
    LogEntry { time, interface: "can0", frame }.to_string()
}

fn frame(random: &mut fastrand::Rng) -> Frame {
    let address = random.u32(0..128);
    let source = address << 17;
    let to = random.u32(0..128) << 10;
    match random.u8(0..100) {
        // Heartbeats of three boards at each address, in any mode.
        0..30 => {
            let board = random.u8(0..3);
            let mode = random.u8(0..8);
            let unusual = if random.bool() { NON_WORKING } else { 0 };
            let data = [address as u8, board, 0x5A, board, address as u8, 1, mode, 0];
            extended(UNSOLICITED | unusual | source | to | HEARTBEAT, &data)
        }
        // Name responses with several names for an address.
        30..45 => {
            let name = [b'A' + random.u8(0..4), b'A' + (address % 26) as u8];
            extended(RESPONSE | source | DES, &[4, 1, name[0], name[1], 0])
        }
        // Services responses without a correct length, and first frames without an end.
        45..55 => {
            let data: [u8; 8] = random.u64(..).to_le_bytes();
            extended(RESPONSE | source | DES, &[&[0x10, 0x40, 2], &data[..5]].concat())
        }
        55..70 => {
            let length = random.usize(0..=8);
            let data = random.u64(..).to_le_bytes();
            extended(RESPONSE | source | to | DES, &data[..length])
        }
        70..75 => Frame::new(CanId::Standard(random.u16(0..0x800)), &[1, 2, 3]),
        _ => {
            let length = random.usize(0..=8);
            let data = random.u64(..).to_le_bytes();
            extended(random.u32(0..0x2000_0000), &data[..length])
        }
    }
}

fn extended(id: u32, data: &[u8]) -> Frame {
    Frame::new(CanId::Extended(id), data)
}
