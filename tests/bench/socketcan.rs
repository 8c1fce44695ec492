//! Cost of reading a busy SocketCAN interface, and lost frames: descan beside candump and beside a
//! reader that only calls recvmmsg.
//!
//! Needs root and CAN in the kernel: tests/vm/measure runs it in the virtual machine. Time there is
//! unreliable, so only the ratios within one run count. Arguments: seconds per slice of the CPU
//! measure, slices of each, seconds of each loss measure (0: none), rates; without them it measures
//! nothing. With `send RATE SECONDS` it only sends, to ds-measure: for a profiler.

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/pty.rs"]
mod pty;

use descan::wire::id::{Address, Header, Service};
use nix::cmsg_space;
use nix::sys::socket::{MsgFlags, MultiHeaders, recvmmsg};
use nix::sys::time::TimeSpec;
use pty::Pty;
use serde_json::Value;
use socketcan::{CanFdSocket, CanFrame, EmbeddedFrame, ExtendedId, Socket, SocketOptions};
use std::io::{BufRead, BufReader, IoSliceMut};
use std::os::fd::AsRawFd;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::thread;
use std::time::{Duration, Instant};

const BUS: &str = "ds-measure";
const DESCAN: &str = env!("CARGO_BIN_EXE_descan");

fn main() {
    let mut arguments = std::env::args().skip(1).filter(|it| it != "--bench");
    let first = arguments.next();
    if first.as_deref() == Some("read") {
        read_only(&arguments.next().expect("an interface"));
        return;
    }
    if first.as_deref() == Some("send") {
        let mut number = || arguments.next().and_then(|it| it.parse().ok()).expect("a number");
        let (rate, seconds) = (number(), number());
        send(rate, Duration::from_secs(seconds.into()));
        return;
    }
    let numbers = first.into_iter().chain(arguments).map(|it| it.parse().expect("a number"));
    let [seconds, slices, loss_seconds, rates @ ..] = &numbers.collect::<Vec<u64>>()[..] else {
        println!("SocketCAN: tests/vm/measure measures it");
        return;
    };
    let rates: Vec<u32> = rates.iter().map(|rate| *rate as u32).collect();
    let _ = ip(&["link", "del", BUS]);
    assert!(ip(&["link", "add", BUS, "type", "vcan"]), "interfaces can be made");
    ip(&["link", "set", BUS, "up", "mtu", "72"]);
    let folder = tempfile::tempdir().expect("a temporary folder");
    cost(folder.path(), *seconds, *slices as usize, &rates);
    if *loss_seconds > 0 {
        losses(folder.path(), *loss_seconds, &rates);
    }
    ip(&["link", "del", BUS]);
}

// --- CPU cost ---------------------------------------------------------------------------------

/// The readers compared.
#[derive(Clone, Copy)]
enum Who {
    Candump,
    Bare,
    Watch,
    Screen,
}

const ALL: [(Who, &str); 4] = [
    (Who::Candump, "candump"),
    (Who::Bare, "recvmmsg alone"),
    (Who::Watch, "descan watch"),
    (Who::Screen, "descan's screen"),
];

/// Returns CPU seconds of each reader per million frames, measured in turns, so that other load on
/// the machine affects all of them.
fn cost(folder: &Path, seconds: u64, slices: usize, rates: &[u32]) {
    println!("CPU seconds per million frames, median of {slices} × {seconds} s, by candump's:");
    let heads = rates.iter().map(|rate| format!("{rate:>16}"));
    println!("{:<18}{}", "frames/s", heads.collect::<String>());
    let mut table = vec![vec![0.0; rates.len()]; ALL.len()];
    for (column, rate) in rates.iter().enumerate() {
        let mut costs = vec![Vec::new(); ALL.len()];
        for _ in 0..slices {
            for (row, (who, _)) in ALL.iter().enumerate() {
                costs[row].push(slice(*who, folder, *rate, seconds));
            }
        }
        for (row, mut costs) in costs.into_iter().enumerate() {
            costs.sort_by(f64::total_cmp);
            table[row][column] = costs[costs.len() / 2];
        }
    }
    for (row, (_, name)) in ALL.iter().enumerate() {
        print!("{name:<18}");
        for (cost, candump) in table[row].iter().zip(&table[0]) {
            print!("{cost:>9.1} ({:>4.2})", cost / candump);
        }
        println!();
    }
}

/// Returns CPU seconds per million frames of one reader while frames arrive at `rate`.
fn slice(who: Who, folder: &Path, rate: u32, seconds: u64) -> f64 {
    let own = std::env::current_exe().expect("a path");
    let own = own.to_str().expect("in UTF-8");
    if let Who::Screen = who {
        let mut pty = Pty::start(&[BUS], folder, (120, 40));
        pty.wait_for("1 Devices");
        let id = child_of_this(DESCAN);
        let cost = cost_of(id, rate, seconds);
        pty.send("q");
        pty.wait();
        return cost;
    }
    let (program, arguments): (&str, &[&str]) = match who {
        Who::Candump => ("candump", &[BUS]),
        Who::Bare => (own, &["read", BUS]),
        Who::Watch | Who::Screen => (DESCAN, &["watch", BUS]),
    };
    let child = Command::new(program)
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .expect(program);
    let reader = Running(child);
    cost_of(reader.0.id(), rate, seconds)
}

fn cost_of(process: u32, rate: u32, seconds: u64) -> f64 {
    // Until it has started, and knows the devices.
    send(rate, Duration::from_secs(3));
    let before = cpu_seconds(process);
    let sent = send(rate, Duration::from_secs(seconds));
    thread::sleep(Duration::from_millis(50));
    (cpu_seconds(process) - before) / sent as f64 * 1e6
}

/// Returns user and system time of all threads of a process.
fn cpu_seconds(process: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).expect("it runs");
    let after_name = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
    let ticks: u64 =
        after_name.split_whitespace().skip(11).take(2).map(|it| it.parse::<u64>().unwrap()).sum();
    ticks as f64 / 100.0
}

/// Returns the process id of a child process that runs `program`.
fn child_of_this(program: &str) -> u32 {
    let us = std::process::id().to_string();
    let is_it = |id: &u32| {
        let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
        let parent = stat.rsplit_once(')').and_then(|(_, rest)| rest.split_whitespace().nth(1));
        let runs = std::fs::read_link(format!("/proc/{id}/exe"));
        parent == Some(&us) && runs.is_ok_and(|runs| runs == Path::new(program))
    };
    let processes = std::fs::read_dir("/proc").expect("processes");
    let mut ids =
        processes.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<u32>().ok());
    ids.find(is_it).expect("it runs")
}

/// Sends frames of 127 identifiers with 8 bytes each, evenly spaced; returns their number.
fn send(rate: u32, time: Duration) -> u64 {
    let socket = CanFdSocket::open(BUS).expect("the interface");
    // The sender receives nothing.
    socket.set_filter_drop_all().expect("no filter");
    let start = Instant::now();
    let mut sent = 0;
    while start.elapsed() < time {
        let due = (start.elapsed().as_secs_f64() * f64::from(rate)) as u64;
        while sent < due {
            let address = Address::from_bits((sent % 127) as u8 + 1);
            let service = Service::from_bits(0x100);
            let header = Header::unsolicited(address, address.number(), false, service);
            let id = ExtendedId::new(header.encode()).expect("29 bits");
            let frame = CanFrame::new(id, &sent.to_be_bytes()).expect("8 bytes");
            socket.write_frame_insist(&frame).expect("the interface takes it");
            sent += 1;
        }
        let next = start + Duration::from_secs_f64((sent + 1) as f64 / f64::from(rate));
        thread::sleep(next.saturating_duration_since(Instant::now()));
    }
    sent
}

/// Reads all frames and discards them.
fn read_only(interface: &str) {
    let socket = CanFdSocket::open(interface).expect("the interface");
    socket.set_recv_timestamp(true).expect("stamps");
    let mut buffers = [[0; 72]; 64];
    loop {
        let mut slices: Vec<_> =
            buffers.iter_mut().map(|buffer| [IoSliceMut::new(buffer)]).collect();
        let mut headers = MultiHeaders::<()>::preallocate(64, Some(cmsg_space!(TimeSpec, u32)));
        let (fd, flags) = (socket.as_raw_fd(), MsgFlags::MSG_WAITFORONE);
        let messages = recvmmsg(fd, &mut headers, slices.iter_mut(), flags, None);
        assert!(messages.expect("frames").count() > 0);
    }
}

// --- lost frames ------------------------------------------------------------------------------

/// Compares the numbers of received and lost frames that `watch` reports with the number sent.
fn losses(folder: &Path, seconds: u64, rates: &[u32]) {
    println!();
    println!("Frames in {seconds} s, as descan watch tells them:");
    let columns = ["sent", "heard", "lost by kernel", "lost in queue"];
    println!("{:<26}{:>12}{:>12}{:>16}{:>16}", "", columns[0], columns[1], columns[2], columns[3]);
    for rate in rates {
        told(folder, &format!("{rate} frames/s"), || {
            send(*rate, Duration::from_secs(seconds));
        });
    }
    told(folder, "as fast as cangen goes", || {
        let flood = ["-g", "0", "-e", "-L", "8", BUS];
        let mut cangen = Command::new("cangen").args(flood).spawn().expect("can-utils");
        thread::sleep(Duration::from_secs(seconds));
        let _ = cangen.kill();
        let _ = cangen.wait();
    });
    told(folder, "the same, stopped for 5 s", || {
        let stop = Arc::new(AtomicBool::new(false));
        let over = Arc::clone(&stop);
        let cangen = thread::spawn(move || {
            let flood = ["-g", "0", "-e", "-L", "8", BUS];
            let mut cangen = Command::new("cangen").args(flood).spawn().expect("can-utils");
            while !over.load(Ordering::Acquire) {
                thread::sleep(Duration::from_millis(10));
            }
            let _ = cangen.kill();
            let _ = cangen.wait();
        });
        let watch = child_of_this(DESCAN).to_string();
        let signal = |name: &str| {
            let _ = Command::new("kill").args([name, &watch]).status();
        };
        thread::sleep(Duration::from_secs(1));
        signal("-STOP");
        thread::sleep(Duration::from_secs(5));
        // The flood ends while no reader runs: no later frame reports the loss.
        stop.store(true, Ordering::Release);
        let _ = cangen.join();
        signal("-CONT");
    });
}

/// Measures one row: `descan watch` while `flood` runs. Taking the interface down afterwards
/// triggers its report.
fn told(folder: &Path, name: &str, flood: impl FnOnce()) {
    let child = Command::new(DESCAN)
        .args(["watch", BUS, "--json", "--listen-only"])
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .expect(DESCAN);
    let mut watch = Running(child);
    let lines = BufReader::new(watch.0.stdout.take().expect("piped")).lines();
    let told = lines.map_while(Result::ok).filter_map(|line| {
        let value: Value = serde_json::from_str(&line).ok()?;
        let bus = value.get("bus").filter(|_| value["event"] == "bus")?;
        let number = |value: &Value| value.as_u64().unwrap_or(0);
        let lost = ["kernel", "queue"].map(|place| number(&bus["lost_where"][place]));
        Some((bus["state"] == "down", number(&bus["frames"]), lost))
    });
    // Read as they come: a writer blocked by a full pipe reads no frames.
    let (sender, receiver) = channel();
    thread::spawn(move || told.take_while(|it| sender.send(*it).is_ok()).count());
    let mut told = receiver.iter();
    told.next().expect("it is open");
    let before = transmitted();
    flood();
    let sent = transmitted() - before;
    wait_until_idle(watch.0.id());
    ip(&["link", "set", BUS, "down"]);
    let (_, heard, [kernel, queue]) = told.find(|(is_down, _, _)| *is_down).expect("it says so");
    ip(&["link", "set", BUS, "up"]);
    let verdict = if heard + kernel + queue == sent { "" } else { "  WRONG" };
    println!("{name:<26}{sent:>12}{heard:>12}{kernel:>16}{queue:>16}{verdict}");
}

/// Waits until a process is idle: all frames in progress are counted.
fn wait_until_idle(process: u32) {
    let mut before = cpu_seconds(process);
    loop {
        thread::sleep(Duration::from_secs(2));
        let now = cpu_seconds(process);
        if now - before < 0.1 {
            return;
        }
        before = now;
    }
}

/// Returns the number of frames that went through the interface.
fn transmitted() -> u64 {
    let path = format!("/sys/class/net/{BUS}/statistics/tx_packets");
    std::fs::read_to_string(path).expect("statistics").trim().parse().expect("a number")
}

// ----------------------------------------------------------------------------------------------

/// A process that is killed at the end of its measure.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn ip(arguments: &[&str]) -> bool {
    let output = Command::new("ip").args(arguments).output();
    output.is_ok_and(|output| output.status.success())
}
