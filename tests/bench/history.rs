//! Time until a random past moment is on the screen, of a million captured frames, and of a log of
//! ten million.
//!
//! The traffic is the simulator's crowd with chatter, 127 devices and three that share addresses
//! with others, at 1 Mbit/s; replayed in a loop with shifted times. Each of 1,000 moments is gone to
//! from another one, and its page is drawn, in any of its views. The log is in the page cache.

use descan::app::{App, AppOptions};
use descan::bus::{self, BusSpec, Clock, Options};
use descan::discovery::Config;
use descan::frame::{BusIndex, Frame};
use descan::keymap::Key;
use descan::log::candump::write_line;
use descan::sim::{Fault, Scenario, Sim};
use descan::status::PlaybackCommand;
use descan::theme::Theme;
use descan::time::{Duration, Epoch, Instant};
use descan::ui;
use descan::wire::node::Uid;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use std::io::{self, BufWriter, Write};

const FRAMES: usize = 1_000_000;
const LOG_FRAMES: usize = 10_000_000;
const MOMENTS: usize = 1_000;

/// Span of the recorded traffic.
const SPAN: Duration = Duration::from_secs(10);

fn main() {
    let recorded = record();
    let mut app = new_app();
    let start = std::time::Instant::now();
    for frame in looped(&recorded, FRAMES) {
        take(&mut app, frame);
    }
    println!("in memory:");
    measure(app, FRAMES, start.elapsed());

    let mut log = tempfile::Builder::new().suffix(".log").tempfile().expect("a file");
    write_log(&mut log, looped(&recorded, LOG_FRAMES)).expect("a log");
    let clock = Clock::replaying(Epoch::default(), 1.0);
    let spec = BusSpec::File(log.path().to_owned());
    let port = bus::open(&spec, BusIndex(0), clock.clone(), Options::default());
    let mut port = port.expect("a port");
    let mut app = new_app();
    app.set_frame_source(port.take_frame_source().expect("a file"));
    clock.control(PlaybackCommand::ReadTo(Instant::LATEST));
    port.wake();
    let (start, mut frames) = (std::time::Instant::now(), Vec::new());
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
    println!("log:");
    measure(app, LOG_FRAMES, start.elapsed());
}

fn new_app() -> App {
    let config = Config { listen_only: true, bitrate: Some(1_000_000), ..Config::default() };
    let options = AppOptions { buses: vec![("sim".to_owned(), config)], ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    app.handle_resize(120, 40);
    app
}

/// The recorded frames over and over, until there are so many.
fn looped(recorded: &[Frame], count: usize) -> impl Iterator<Item = Frame> {
    let loops = (0..).map(|turn| SPAN * turn);
    let frames = loops
        .flat_map(|offset| recorded.iter().map(move |frame| frame.with_time(frame.time + offset)));
    frames.take(count)
}

fn write_log(to: &mut impl Write, frames: impl Iterator<Item = Frame>) -> io::Result<()> {
    let mut to = BufWriter::new(to);
    for frame in frames {
        write_line(&mut to, Epoch::default(), "sim", &frame)?;
    }
    to.flush()
}

fn take(app: &mut App, frame: Frame) {
    while let Some(due) = app.poll_timeout().filter(|due| *due <= frame.time) {
        app.handle_timeout(due);
    }
    app.handle_frames(frame.time, &[frame]);
    while app.poll_effect().is_some() {}
    app.take_dirty();
}

/// Goes to random moments, and prints how long that takes.
fn measure(mut app: App, frames: usize, taken: Duration) {
    let end = app.now();
    println!(
        "{frames} frames in {:.1} s of bus time, taken in {:.1} s; {} devices, {} findings",
        end.as_secs_f64(),
        taken.as_secs_f64(),
        app.buses()[0].devices().len(),
        app.findings().count(),
    );
    let begin = app.history().begin(app.capture());
    println!("moments from {begin} on; resident {:.1} MiB", resident_mib());
    let theme = Theme::built_in("dark").expect("a built-in theme");
    let mut terminal = Terminal::new(TestBackend::new(120, 40)).expect("a screen in memory");
    let mut rng = fastrand::Rng::with_seed(1);
    let keys = ['1', '2', '3', '4'].map(Key::char);
    let mut took: Vec<Duration> = (0..MOMENTS)
        .map(|_| {
            let time = Instant::from_micros(rng.u64(begin.as_micros()..end.as_micros()));
            app.handle_key(end, *rng.choice(&keys).expect("pages"));
            if rng.bool() {
                // The next view of the page, where it has several.
                app.handle_key(end, Key::char('v'));
            }
            let start = std::time::Instant::now();
            app.go_to_time(time);
            while app.past_moment().is_none_or(|moment| moment.time != time) {
                let due = app.poll_timeout().expect("a replay goes on");
                app.handle_timeout(due);
            }
            while app.uncounted_frames() > 0 {
                let due = app.poll_timeout().expect("the frames are counted");
                app.handle_timeout(due);
            }
            app.take_dirty();
            terminal.draw(|frame| _ = ui::draw(&app, &theme, frame)).expect("drawn in memory");
            start.elapsed()
        })
        .collect();
    took.sort_unstable();
    let millis = |part: f64| took[((MOMENTS - 1) as f64 * part) as usize].as_secs_f64() * 1e3;
    println!(
        "{MOMENTS} random moments: median {:.1} ms, p99 {:.1} ms, longest {:.1} ms; resident {:.1} MiB",
        millis(0.5),
        millis(0.99),
        millis(1.0),
        resident_mib(),
    );
}

/// Returns ten seconds of a crowd with chatter and three conflicts.
fn record() -> Vec<Frame> {
    let mut scenario = Scenario::with_many_devices(1_000_000, 127, 5);
    for (at, device) in scenario.devices.iter_mut().enumerate() {
        let chatter =
            device.clone().periodic_message(0x100 + at as u16, Duration::from_millis(20), 8);
        *device = chatter;
    }
    for at in [10, 20, 30] {
        let mut second = scenario.devices[at].clone().fault(Fault::KeepsAddress);
        scenario.devices[at] = second.clone();
        second.uid = Uid([9, 9, 9, 9, 9, at as u8]);
        second.power_on = Some(Duration::from_millis(300 + at as u64));
        scenario.devices.push(second);
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

fn resident_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap_or("VmRSS: 0");
    let kib: f64 = line.split_whitespace().nth(1).and_then(|kib| kib.parse().ok()).unwrap_or(0.0);
    kib / 1024.0
}
