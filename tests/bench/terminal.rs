//! Bytes to the terminal in a second, by page, size and load, in simulated time; and the real binary on
//! a busy bus: bytes, time to the first screen, memory, and the time from a key to its effect.
//!
//! 60 devices with chatter at 1 Mbit/s: about 7,000 f/s on a simulated bus in the same process. Keys
//! are typed while a hostile bus arrives on standard input: at 8,000 f/s, and as fast as it is read.
//! With `pages` or `program` only the first or the second of both.

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/pty.rs"]
mod pty;

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/hostile.rs"]
mod hostile;

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/busy.rs"]
mod busy;

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/harness.rs"]
mod harness;

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/paced.rs"]
mod paced;

use busy::{Busy, VIEWS};
use pty::Pty;
use std::fmt::Write;
use std::path::Path;
use std::time::{Duration, Instant};

const DEVICES: u32 = 60;
const AT_REST: Duration = Duration::from_secs(20);

/// Frames per second: heartbeats only; a busy bus; two full ones.
const LOADS: [u64; 3] = [127, 2_000, 15_000];
const SIZES: [(u16, u16); 3] = [(80, 24), (120, 40), (200, 50)];

/// Prints the bytes of a second of each page at rest, over a minute.
fn bytes_by_page() {
    print!("{:22}", "bytes in a second");
    for load in LOADS {
        for (columns, rows) in SIZES {
            print!(" {:>10}", format!("{columns}x{rows}"));
        }
        print!("  at {load:>6}/s |");
    }
    println!();
    for view in &VIEWS {
        print!("{:22}", view.name);
        for load in LOADS {
            for size in SIZES {
                let mut busy = Busy::new(load, size, view.has_conflict);
                busy.run(Duration::from_secs(15)).keys(view.keys).run(Duration::from_secs(5));
                let before = busy.screen.bytes;
                busy.run(Duration::from_mins(1));
                print!(" {:>10}", (busy.screen.bytes - before) / 60);
            }
            print!("               |");
        }
        println!();
    }
}

fn main() {
    let is_asked = |part: &str| std::env::args().any(|it| it == part);
    if !is_asked("program") {
        bytes_by_page();
    }
    if is_asked("pages") {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("full.toml"), scenario()).expect("the scenario");
    first_screen(folder.path());
    for size in [(80, 24), (120, 40), (160, 50)] {
        at_rest(folder.path(), size);
    }
    for is_paced in [true, false] {
        keys_on_hostile_input(folder.path(), is_paced);
    }
}

/// Prints how long the program takes to answer a key, and to end on `q`, while it reads hostile
/// frames: at the pace of a full bus, or as fast as it takes them.
fn keys_on_hostile_input(folder: &Path, is_paced: bool) {
    let pipe = folder.join("hostile");
    // Ends when the program does.
    let writer = hostile::feed(&pipe, is_paced);
    let command = format!("exec {} - < hostile", env!("CARGO_BIN_EXE_descan"));
    let mut pty = Pty::run("/bin/sh", &["-c", &command], folder, (120, 40));
    pty.wait_for("1 Devices");
    pty.count_for(Duration::from_secs(20));
    let mut times = Vec::new();
    for (key, effect) in [
        ("3", "LENGTH"),
        ("?", "Keys of Timeline"),
        ("?", "LENGTH"),
        ("4", "PROBLEM"),
        ("1", "NAME"),
    ]
    .repeat(8)
    {
        let start = Instant::now();
        pty.send(key);
        pty.wait_until(key, |screen| screen.contents().contains(effect));
        times.push(start.elapsed().as_secs_f64() * 1e3);
        pty.count_for(Duration::from_millis(130));
    }
    times.sort_by(f64::total_cmp);
    let start = Instant::now();
    pty.send("q");
    let code = pty.wait();
    let pace = if is_paced { "8,000 frames/s" } else { "full speed" };
    println!(
        "keys on a hostile bus at {pace}: median {:.1} ms, worst {:.1} ms of {}; q ends it with \
         code {code} after {:.0} ms",
        times[times.len() / 2],
        times[times.len() - 1],
        times.len(),
        start.elapsed().as_secs_f64() * 1e3
    );
    writer.join().expect("the writer");
    std::fs::remove_file(pipe).expect("the pipe is deleted");
}

/// Returns devices that each send a heartbeat once a second and 8 bytes 116 times a second.
fn scenario() -> String {
    let mut text = "bitrate = 1000000\n".to_owned();
    for address in 1..=DEVICES {
        write!(
            text,
            "[[device]]\nname = \"N{address:03}\"\nuid = \"NODE{address:03}\"\n\
             address = {{ fixed = {address} }}\nsettled = true\n\
             services = [[\"DES\", \"1.0\"], [\"DATA\", \"2.{address}\"]]\n\
             chatter = [{{ service = {}, period_ms = 9 }}, {{ service = {}, period_ms = 200 }}]\n",
            0x100 + address,
            0x180 + address
        )
        .expect("a String takes everything");
    }
    text
}

fn first_screen(folder: &Path) {
    let mut times: Vec<f64> = (0..11)
        .map(|_| {
            let start = Instant::now();
            let mut pty = Pty::start(&["sim:full.toml"], folder, (80, 24));
            pty.wait_until("first screen", |screen| screen.contents().contains("1 Devices"));
            let took = start.elapsed().as_secs_f64() * 1e3;
            pty.send("q");
            pty.wait();
            took
        })
        .collect();
    times.sort_by(f64::total_cmp);
    println!(
        "from start to the first screen: median {:.1} ms, worst {:.1} ms of 11",
        times[5], times[10]
    );
}

fn at_rest(folder: &Path, size: (u16, u16)) {
    let mut pty = Pty::start(&["sim:full.toml"], folder, size);
    pty.wait_until("all devices", |screen| screen.contents().contains("60 present"));
    pty.count_for(Duration::from_secs(5));
    let bytes = pty.count_for(AT_REST);
    let rate = bytes as f64 / AT_REST.as_secs_f64();
    let shown = pty.screen();
    let frames =
        shown.split_whitespace().zip(shown.split_whitespace().skip(1)).find(|it| it.1 == "f/s");
    let frames = frames.map_or("?", |it| it.0).to_owned();
    let status = std::fs::read_to_string(format!("/proc/{}/status", pty.pid())).unwrap_or_default();
    let resident =
        status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap_or("?").trim();
    println!(
        "at rest on Devices, {}×{}: {rate:.0} bytes/s at {frames} frames/s; resident {resident}",
        size.0, size.1
    );
    pty.send("q");
    pty.wait();
}
