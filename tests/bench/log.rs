//! Frames per second that the program reads from a recorded log: with all state, with statistics, and
//! printed.
//!
//! The log is two million frames of the simulator's crowd with chatter, 127 devices at 1 Mbit/s, as
//! text and binary logs of each format that is written. Each run is a process, from its start to its end; what it prints is
//! discarded. The file is in the page cache.

use descan::log::{LogEntry, LogFormat, LogTime};
use descan::sim::{Scenario, Sim};
use descan::time::{Duration, Epoch, Instant};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

const FRAMES: usize = 2_000_000;
/// Runs of each command; the fastest counts.
const RUNS: usize = 5;

fn main() {
    let folder = tempfile::tempdir().expect("a folder");
    let frames = record();
    for (file, what) in [
        ("bus.log", "candump text"),
        ("bus.pcapng", "pcapng"),
        ("bus.asc", "ASC"),
        ("bus.trc", "TRC"),
        ("bus.csv", "CSV"),
        ("bus.blf", "BLF"),
    ] {
        let log = folder.path().join(file);
        let count = write(&log, &frames);
        let log = log.display().to_string();
        let state = format!("file:{log}");
        let commands: [(&str, &[&str]); 5] = [
            ("with all state", &["watch", &state]),
            ("--stats", &["log", &log, "--stats"]),
            ("--filter id:123", &["log", &log, "--filter", "id:123"]),
            ("as text", &["log", &log]),
            ("as JSON", &["log", &log, "--json"]),
        ];
        for (how, arguments) in commands {
            let fastest = (0..RUNS).map(|_| run(arguments)).min().unwrap_or_default();
            let rate = count as f64 / fastest.as_secs_f64();
            println!("{what} {how}: {:.2} million frames/s ({count} frames)", rate / 1e6);
        }
    }
}

fn run(arguments: &[&str]) -> Duration {
    let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
    command.args(arguments).stdout(Stdio::null()).stderr(Stdio::null());
    let start = std::time::Instant::now();
    let status = command.status().expect("it starts");
    assert!(status.success(), "{arguments:?}: {status}");
    start.elapsed()
}

/// Writes the frames again and again, with shifted times, and returns their number.
fn write(path: &Path, frames: &[descan::frame::Frame]) -> usize {
    let epoch = Epoch::from_unix_micros(1_760_000_000_000_000);
    let mut encoder = LogFormat::of_written(path).expect("a log format").encoder();
    let (mut bytes, mut count, mut offset) = (Vec::new(), 0, Duration::ZERO);
    encoder.begin(&mut bytes).expect("written to memory");
    while count < FRAMES {
        for frame in frames {
            let time = LogTime::from_micros(epoch.unix_micros(frame.time + offset));
            let entry = LogEntry { time, interface: "can0", frame: *frame };
            encoder.write(entry, u64::MAX, &mut bytes).expect("written to memory");
        }
        count += frames.len();
        offset += Duration::from_secs(10);
    }
    encoder.end(&["can0".to_owned()], &[0], &mut bytes).expect("written to memory");
    fs::write(path, bytes).expect("a file");
    count
}

/// Returns ten seconds of a crowd with chatter.
fn record() -> Vec<descan::frame::Frame> {
    let mut scenario = Scenario::with_many_devices(1_000_000, 127, 5);
    for (at, device) in scenario.devices.iter_mut().enumerate() {
        let chatter =
            device.clone().periodic_message(0x100 + at as u16, Duration::from_millis(20), 8);
        *device = chatter;
    }
    let mut sim = Sim::new(&scenario, 1);
    let station = sim.attach();
    let mut frames = Vec::new();
    for second in 1..=10 {
        sim.advance(Instant::from_micros(second * 1_000_000));
        frames.extend(std::iter::from_fn(|| sim.poll_frame(station)));
    }
    frames
}
