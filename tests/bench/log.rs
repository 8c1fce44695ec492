//! Frames per second that the program reads from a recorded log: with all state, with statistics, and
//! printed.
//!
//! The log is two million frames of the simulator's crowd with chatter, 127 devices at 1 Mbit/s, as
//! text and binary logs of each format that is written, and in the spellings that are only read. Each run is
//! a process, from its start to its end; what it prints is discarded. The file is in the page cache.

use descan::frame::Frame;
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
            report(&format!("{what} {how}"), arguments, count);
        }
    }
    for (what, header, spelling) in SPELLINGS {
        let log = folder.path().join("spelled.log");
        let count = spell(&log, header, &frames, spelling);
        report(
            &format!("{what} with all state"),
            &["watch", &format!("file:{}", log.display())],
            count,
        );
    }
}

fn report(what: &str, arguments: &[&str], count: usize) {
    let fastest = (0..RUNS).map(|_| run(arguments)).min().unwrap_or_default();
    let rate = count as f64 / fastest.as_secs_f64();
    println!("{what}: {:.2} million frames/s ({count} frames)", rate / 1e6);
}

/// Returns the line of a data frame, given the microseconds since 1970, and the same since the start.
type Spelling = fn(&Frame, u64, u64) -> String;

const CSV_HEADER: &str = "timestamp,arbitration_id,extended,remote,error,dlc,data\n";

/// Text logs that are read, not written, with their headers.
const SPELLINGS: [(&str, &str, Spelling); 7] = [
    ("candump's screen", "", |frame, _, _| format!("  can0  {}\n", columns(frame))),
    ("candump -t a", "", |frame, micros, _| {
        format!(" ({})  can0  {}\n", seconds(micros), columns(frame))
    }),
    ("candump -t z", "", |frame, _, since| {
        let (seconds, micros) = (since / 1_000_000, since % 1_000_000);
        format!(" ({seconds:03}.{micros:06})  can0  {}\n", columns(frame))
    }),
    ("candump -t A", "", |frame, micros, _| {
        let at = jiff::Timestamp::from_microsecond(micros.cast_signed()).expect("a time");
        format!(" ({})  can0  {}\n", at.strftime("%Y-%m-%d %H:%M:%S%.6f"), columns(frame))
    }),
    ("candump -t a -x", "", |frame, micros, _| {
        format!(" ({})  can0  RX - -  {}\n", seconds(micros), columns(frame))
    }),
    ("candump text of FD frames", "", |frame, micros, _| {
        let text = frame.to_string().replace('#', "##1");
        format!("({}) can0 {text}\n", seconds(micros))
    }),
    ("python-can's CSV", CSV_HEADER, |frame, micros, _| {
        let text = frame.to_string();
        let (id, len) = (text.split('#').next().unwrap_or_default(), frame.len());
        let is_extended = u8::from(id.len() > 3);
        let data = base64(frame.data());
        format!("{},0x{id},{is_extended},0,0,{len},{data}\n", seconds(micros))
    }),
];

fn seconds(micros: u64) -> String {
    format!("{}.{:06}", micros / 1_000_000, micros % 1_000_000)
}

/// Returns identifier, length and bytes as candump prints them.
fn columns(frame: &Frame) -> String {
    let text = frame.to_string();
    let id = text.split('#').next().unwrap_or_default();
    let bytes: Vec<_> = frame.data().iter().map(|byte| format!("{byte:02X}")).collect();
    format!("{id:>8}   [{}]  {}", frame.len(), bytes.join(" "))
}

fn base64(data: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for bytes in data.chunks(3) {
        let bits = bytes.iter().fold(0, |bits, byte| bits << 8 | u32::from(*byte))
            << (24 - 8 * bytes.len());
        for place in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * place) & 63) as usize];
            text.push(if place > bytes.len() { '=' } else { char::from(digit) });
        }
    }
    text
}

/// Writes the frames as [`write`] does, each in a spelling.
fn spell(path: &Path, header: &str, frames: &[Frame], spelling: Spelling) -> usize {
    let epoch = Epoch::from_unix_micros(1_760_000_000_000_000);
    let (mut text, mut count, mut offset) = (header.to_owned(), 0, Duration::ZERO);
    while count < FRAMES {
        for frame in frames {
            let time = frame.time + offset;
            text.push_str(&spelling(frame, epoch.unix_micros(time), time.as_micros()));
        }
        count += frames.len();
        offset += Duration::from_secs(10);
    }
    fs::write(path, text).expect("a file");
    count
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
fn write(path: &Path, frames: &[Frame]) -> usize {
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
fn record() -> Vec<Frame> {
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
