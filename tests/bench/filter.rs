//! Frames that a filter tests in a second, on one core, of a million captured ones, and of a log of four
//! million.
//!
//! The traffic is the simulator's boiler with chatter, replayed in a loop with shifted times. The log is
//! in the page cache.

use descan::app::{App, AppOptions, Filter, RowKind};
use descan::bus::{self, BusSpec, Clock, Options};
use descan::discovery::Config;
use descan::frame::{BusIndex, Frame};
use descan::log::candump::write_line;
use descan::sim::{Scenario, Sim};
use descan::status::PlaybackCommand;
use descan::time::{Duration, Epoch, Instant};
use std::io::{BufWriter, Write};

const FRAMES: usize = 1_000_000;
const LOG_FRAMES: usize = 4_000_000;
/// Runs of each filter; the fastest counts.
const RUNS: usize = 3;
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
    let recorded = record();
    println!("in memory:");
    let mut app = new_app();
    for frame in looped(&recorded, FRAMES) {
        take(&mut app, frame);
    }
    measure(&app);
    println!("of a log, most of which is read again:");
    measure(&app_of_log(&recorded));
}

fn new_app() -> App {
    let config = Config { listen_only: true, bitrate: Some(125_000), ..Config::default() };
    let options = AppOptions { buses: vec![("sim".to_owned(), config)], ..AppOptions::default() };
    App::new(Instant::ZERO, options)
}

/// The recorded frames over and over, until there are so many.
fn looped(recorded: &[Frame], count: usize) -> impl Iterator<Item = Frame> {
    let frames = (0..).flat_map(|turn| {
        let offset = SPAN * turn;
        recorded.iter().map(move |frame| frame.with_time(frame.time + offset))
    });
    frames.take(count)
}

fn take(app: &mut App, frame: Frame) {
    while let Some(due) = app.poll_timeout().filter(|due| *due <= frame.time) {
        app.handle_timeout(due);
    }
    app.handle_frames(frame.time, &[frame]);
    while app.poll_effect().is_some() {}
}

/// An application that has read a log.
fn app_of_log(recorded: &[Frame]) -> App {
    let file = tempfile::Builder::new().suffix(".log").tempfile().expect("a file");
    let mut log = BufWriter::new(&file);
    for frame in looped(recorded, LOG_FRAMES) {
        write_line(&mut log, Epoch::default(), "sim", &frame).expect("a log");
    }
    log.flush().expect("a log");
    let clock = Clock::replaying(Epoch::default(), 1.0);
    let spec = BusSpec::File(file.path().to_owned());
    let port = bus::open(&spec, BusIndex(0), clock.clone(), Options::default());
    let mut port = port.expect("a port");
    let mut app = new_app();
    app.set_frame_source(port.take_frame_source().expect("a file"));
    clock.control(PlaybackCommand::ReadTo(Instant::LATEST));
    port.wake();
    let mut frames = Vec::new();
    while !port.queue().is_finished() {
        port.queue().take_status();
        frames.clear();
        port.queue().drain(&mut frames, 4096);
        for frame in &frames {
            take(&mut app, *frame);
        }
        if frames.is_empty() {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    app
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
