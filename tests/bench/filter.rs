//! Frames that a filter tests in a second, on one core, of a million captured ones.
//!
//! The traffic is the simulator's boiler with chatter, replayed in a loop with shifted times.

use descan::app::{App, AppOptions, Filter, RowKind};
use descan::discovery::Config;
use descan::frame::Frame;
use descan::sim::{Scenario, Sim};
use descan::time::{Duration, Instant};

const FRAMES: usize = 1_000_000;
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
    let recorded = record();
    let config = Config { listen_only: true, bitrate: Some(125_000), ..Config::default() };
    let options = AppOptions { buses: vec![("sim".to_owned(), config)], ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    let (mut passed, mut offset) = (0, Duration::ZERO);
    while passed < FRAMES {
        let frames: Vec<Frame> =
            recorded.iter().map(|frame| frame.with_time(frame.time + offset)).collect();
        for frame in &frames {
            while let Some(due) = app.poll_timeout().filter(|due| *due <= frame.time) {
                app.handle_timeout(due);
            }
            app.handle_frames(frame.time, std::slice::from_ref(frame));
            while app.poll_effect().is_some() {}
        }
        passed += recorded.len();
        offset += Duration::from_secs(200);
    }
    println!("{passed} frames");
    for line in FILTERS {
        let filter = Filter::parse(line, RowKind::Frame).expect("a filter");
        let capture = app.capture();
        let mut best = Duration::MAX;
        let mut count = 0;
        for _ in 0..5 {
            let start = std::time::Instant::now();
            let matcher = filter.for_frames(app.history());
            let all = capture.frames_from(0);
            count = all
                .filter(|(number, frame)| matcher.is_match(frame, Some((capture, *number))))
                .count();
            best = best.min(start.elapsed());
        }
        let rate = passed as f64 / best.as_secs_f64() / 1e6;
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
