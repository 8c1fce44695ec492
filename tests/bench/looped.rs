//! Recorded traffic in a loop: frames with shifted times, in memory and as a log, handled by an app.

use descan::app::{App, AppOptions};
use descan::bus::{self, BusSpec, Clock, Options};
use descan::discovery::Config;
use descan::frame::{BusIndex, Frame};
use descan::log::candump::write_line;
use descan::status::PlaybackCommand;
use descan::time::{Duration, Epoch, Instant};
use std::io::{BufWriter, Write};

/// Recorded frames, and the span of time after which they begin again.
pub struct LoopedFrames {
    pub recorded: Vec<Frame>,
    pub span: Duration,
}

impl LoopedFrames {
    /// The frames over and over, until there are so many.
    pub fn take(&self, count: usize) -> impl Iterator<Item = Frame> {
        let frames = (0..).flat_map(|turn| {
            let offset = self.span * turn;
            self.recorded.iter().map(move |frame| frame.with_time(frame.time + offset))
        });
        frames.take(count)
    }

    /// An app that has received so many of them.
    pub fn app_of_bus(&self, bitrate: u32, count: usize) -> App {
        let mut app = new_app(bitrate);
        for frame in self.take(count) {
            handle(&mut app, frame);
        }
        app
    }

    /// An app that has read them from a log, which it reads again where they are not in memory.
    pub fn app_of_log(&self, bitrate: u32, count: usize) -> App {
        // It is deleted when it is closed.
        let file = tempfile::Builder::new().suffix(".log").tempfile().expect("a file");
        let mut log = BufWriter::new(&file);
        for frame in self.take(count) {
            write_line(&mut log, Epoch::default(), "sim", &frame).expect("a log");
        }
        log.flush().expect("a log");
        let clock = Clock::replaying(Epoch::default(), 1.0);
        let spec = BusSpec::File(file.path().to_owned());
        let port = bus::open(&spec, BusIndex(0), clock.clone(), Options::default());
        let mut port = port.expect("a port");
        let mut app = new_app(bitrate);
        app.set_frame_source(port.take_frame_source().expect("a file"));
        clock.control(PlaybackCommand::ReadTo(Instant::LATEST));
        port.wake();
        let mut frames = Vec::new();
        while !port.queue().is_finished() {
            port.queue().take_status();
            frames.clear();
            port.queue().drain(&mut frames, 4096);
            for frame in &frames {
                handle(&mut app, *frame);
            }
            if frames.is_empty() {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        app
    }
}

fn new_app(bitrate: u32) -> App {
    let config = Config { listen_only: true, bitrate: Some(bitrate), ..Config::default() };
    let options = AppOptions { buses: vec![("sim".to_owned(), config)], ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    app.handle_resize(120, 40);
    app
}

fn handle(app: &mut App, frame: Frame) {
    while let Some(due) = app.poll_timeout().filter(|due| *due <= frame.time) {
        app.handle_timeout(due);
    }
    app.handle_frames(frame.time, &[frame]);
    while app.poll_effect().is_some() {}
    app.take_dirty();
}
