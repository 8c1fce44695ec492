//! Frames that a filter tests in a second, on one core, of a million captured ones, and of a log of four
//! million.
//!
//! The traffic is the simulator's boiler with chatter, replayed in a loop with shifted times. The log is
//! in the page cache.

#[path = "looped.rs"]
mod looped;

use descan::app::{App, Filter, RowKind};
use descan::frame::Frame;
use descan::sim::{Scenario, Sim};
use descan::time::{Duration, Instant};
use looped::LoopedFrames;

const FRAMES: usize = 1_000_000;
const LOG_FRAMES: usize = 4_000_000;
/// Runs of each filter; the fastest counts.
const RUNS: usize = 3;
const BITRATE: u32 = 125_000;
/// Span of the recorded traffic.
const SPAN: Duration = Duration::from_secs(200);
const FILTERS: &[&str] = &[
    "id:0714",
    "at:12,14",
    "src:FEED srv:des",
    "src:FEED (type:req or type:rsp)",
    "dt:>1200ms",
    "data:\"01 ?? 0F\"",
    "len:<8 not name:SENS",
    "since:00:00:10 until:00:05",
    "mode:ufunc",
    "uid:SPARE01",
    "err",
    "text:ACT",
    "feed",
];

fn main() {
    let frames = LoopedFrames { recorded: record(), span: SPAN };
    println!("in memory:");
    measure(&frames.app_of_bus(BITRATE, FRAMES));
    println!("of a log, most of which is read again:");
    measure(&frames.app_of_log(BITRATE, LOG_FRAMES));
}

fn measure(app: &App) {
    let capture = app.capture();
    let frames = capture.end() - capture.first();
    println!("{frames} frames");
    for line in FILTERS {
        let filter = Filter::parse(line, RowKind::Frame).expect("a filter");
        let mut best = Duration::MAX;
        let mut count = 0;
        for _ in 0..RUNS {
            let start = std::time::Instant::now();
            let matcher = filter.for_frames(app.history());
            let all = capture.frames_from(0);
            count = all
                .filter(|(number, frame)| matcher.is_match(frame, Some((capture, *number))))
                .count();
            best = best.min(start.elapsed());
        }
        let rate = frames as f64 / best.as_secs_f64() / 1e6;
        println!("{line:34} {count:8} match   {rate:5.1} million frames/s");
    }
}

/// Records the boiler for 200 s.
fn record() -> Vec<Frame> {
    let scenario = Scenario::builtin("boiler").expect("a built-in scenario");
    let mut sim = Sim::new(&scenario, 1);
    let station = sim.attach();
    let mut frames = Vec::new();
    for second in 1..=200 {
        sim.advance(Instant::from_micros(second * 1_000_000));
        frames.extend(std::iter::from_fn(|| sim.poll_frame(station)));
    }
    frames
}
