//! Throughput of decoding and program state on one core, and the resident memory after ten million
//! frames; the cost of frames and draws on a hostile bus.
//!
//! The traffic is the simulator's crowd with chatter: 127 devices, heartbeats and data, at 1
//! Mbit/s; replayed in a loop with shifted times. The hostile bus is that of
//! `tests/it/common/hostile.rs`.

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/hostile.rs"]
mod hostile;

use descan::app::{App, AppOptions};
use descan::discovery::Config;
use descan::frame::Frame;
use descan::sim::{Scenario, Sim};
use descan::time::{Duration, Instant};

const FRAMES: usize = 10_000_000;
/// Seconds of a hostile bus.
const HOSTILE: u64 = 30;

fn main() {
    steady_traffic();
    hostile_bus();
}

/// Prints the cost of each part of a hostile bus, with its number of findings: it must not grow
/// with them.
fn hostile_bus() {
    let config = Config { listen_only: true, bitrate: Some(1_000_000), ..Config::default() };
    let options = AppOptions { buses: vec![("can0".to_owned(), config)], ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    app.handle_resize(120, 40);
    let mut frames = hostile::frames(1);
    for part in 1..=6 {
        let (mut busy, mut worst, mut draws) = (Duration::ZERO, Duration::ZERO, Duration::ZERO);
        let count = (hostile::RATE * HOSTILE / 6) as usize;
        let mut timeouts = 0u64;
        for frame in frames.by_ref().take(count) {
            let start = std::time::Instant::now();
            while let Some(due) = app.poll_timeout().filter(|due| *due <= frame.time) {
                app.handle_timeout(due);
                timeouts += 1;
            }
            app.handle_frames(frame.time, &[frame]);
            let took = start.elapsed();
            (busy, worst) = (busy + took, worst.max(took));
            if app.is_dirty() {
                let start = std::time::Instant::now();
                app.take_dirty();
                draws = draws.max(start.elapsed());
            }
        }
        println!(
            "hostile bus, part {part} of 6: {:.0} µs a frame, worst {:.1} ms, rows in at most {:.1} ms, {timeouts} timeouts; \
             devices: {}; findings: {}",
            busy.as_secs_f64() * 1e6 / count as f64,
            worst.as_secs_f64() * 1e3,
            draws.as_secs_f64() * 1e3,
            app.buses()[0].devices().len(),
            app.findings().count(),
        );
    }
}

fn steady_traffic() {
    let recorded = record();
    let span = Duration::from_secs(10);
    let config = Config { listen_only: true, bitrate: Some(1_000_000), ..Config::default() };
    let options = AppOptions { buses: vec![("sim".to_owned(), config)], ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    let mut batch = Vec::with_capacity(64);
    let mut passed = 0;
    let mut offset = Duration::ZERO;
    let mut busy = Duration::ZERO;
    while passed < FRAMES {
        for frames in recorded.chunks(64) {
            batch.clear();
            batch.extend(frames.iter().map(|frame| frame.with_time(frame.time + offset)));
            let now = batch[batch.len() - 1].time;
            let start = std::time::Instant::now();
            app.handle_frames(now, &batch);
            while app.poll_timeout().is_some_and(|due| due <= now) {
                app.handle_timeout(now);
            }
            while app.poll_effect().is_some() {}
            app.take_dirty();
            busy += start.elapsed();
            passed += batch.len();
        }
        offset += span;
    }
    let rate = passed as f64 / busy.as_secs_f64();
    println!("frames through decoding and state: {:.2} million/s ({passed} frames)", rate / 1e6);
    let devices = app.buses()[0].devices().len();
    println!("devices: {devices}; findings: {}", app.findings().count());
    println!(
        "resident: {:.1} MiB (the recorded frames, {:.1} MiB, left out)",
        resident_mib() - recorded_mib(&recorded),
        recorded_mib(&recorded)
    );
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

fn recorded_mib(frames: &[Frame]) -> f64 {
    std::mem::size_of_val(frames) as f64 / f64::from(1 << 20)
}

fn resident_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap_or("VmRSS: 0");
    let kib: f64 = line.split_whitespace().nth(1).and_then(|kib| kib.parse().ok()).unwrap_or(0.0);
    kib / 1024.0
}
