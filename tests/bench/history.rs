//! Time until a random past moment is on the screen, of a million captured frames, and of a log of
//! ten million.
//!
//! The traffic is the simulator's crowd with chatter, 127 devices and three that share addresses
//! with others, at 1 Mbit/s; replayed in a loop with shifted times. Each of 1,000 moments is gone to
//! from another one, and its page is drawn, in any of its views. The log is in the page cache.

#[path = "looped.rs"]
mod looped;

use descan::app::App;
use descan::frame::Frame;
use descan::keymap::Key;
use descan::sim::{Fault, Scenario, Sim};
use descan::theme::Theme;
use descan::time::{Duration, Instant};
use descan::ui;
use descan::wire::node::Uid;
use looped::LoopedFrames;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

const FRAMES: usize = 1_000_000;
const LOG_FRAMES: usize = 10_000_000;
const MOMENTS: usize = 1_000;

const BITRATE: u32 = 1_000_000;
/// Span of the recorded traffic.
const SPAN: Duration = Duration::from_secs(10);

fn main() {
    let frames = LoopedFrames { recorded: record(), span: SPAN };
    let start = std::time::Instant::now();
    let app = frames.app_of_bus(BITRATE, FRAMES);
    println!("in memory:");
    measure(app, FRAMES, start.elapsed());

    let start = std::time::Instant::now();
    let app = frames.app_of_log(BITRATE, LOG_FRAMES);
    println!("of a log that is written and read:");
    measure(app, LOG_FRAMES, start.elapsed());
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
