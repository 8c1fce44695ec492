//! Logs that do not fit into memory: their frames are read again from the file, past moments too.

use descan::app::{App, AppOptions, BusesReplay, Filter, RowKind};
use descan::bus::{self, BusSpec, Clock, Options, Port};
use descan::discovery::Config;
use descan::frame::{BusIndex, Frame};
use descan::keymap::Key;
use descan::log::{LogEntry, LogFormat, LogTime};
use descan::sim::{Fault, Scenario, Sim};
use descan::status::PlaybackCommand;
use descan::time::{Duration, Epoch, Instant};
use descan::wire::node::Uid;
use flate2::Compression;
use flate2::write::GzEncoder;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::Path;
use std::time::Instant as Monotonic;

const PATIENCE: Duration = Duration::from_mins(1);
const EPOCH: Epoch = Epoch::from_unix_micros(1_795_500_000_000_000);

/// Returns seconds of a bus with 40 devices, of which two share an address, and chatter.
fn traffic(seconds: u64) -> Vec<Frame> {
    let mut scenario = Scenario::with_many_devices(1_000_000, 40, 5);
    for (at, device) in scenario.devices.iter_mut().enumerate() {
        let message =
            device.clone().periodic_message(0x100 + at as u16, Duration::from_millis(20), 8);
        *device = message;
    }
    let mut second = scenario.devices[10].clone().fault(Fault::KeepsAddress);
    scenario.devices[10] = second.clone();
    second.uid = Uid([9; 6]);
    second.power_on = Some(Duration::from_secs(3));
    scenario.devices.push(second);
    let mut sim = Sim::new(&scenario, 1);
    let station = sim.attach();
    let mut frames = Vec::new();
    for second in 1..=seconds {
        sim.advance(Instant::from_micros(second * 1_000_000));
        frames.extend(std::iter::from_fn(|| sim.poll_frame(station)));
    }
    frames
}

/// Writes frames as a log, every seventh from a second interface.
fn write_log(path: &Path, frames: &[Frame]) {
    let packed = path.extension().filter(|it| *it == "gz" || *it == "zst");
    let own = path.with_extension("");
    let format = LogFormat::of_written(if packed.is_some() { &own } else { path });
    let format = format.expect("a format");
    let (mut encoder, mut bytes) = (format.encoder(), Vec::new());
    encoder.begin(&mut bytes).unwrap();
    for (at, frame) in frames.iter().enumerate() {
        let (bus, interface) = if at % 7 == 6 { (1, "can1") } else { (0, "can0") };
        let frame = frame.with_bus(BusIndex(bus));
        let time = LogTime::from_micros(EPOCH.unix_micros(frame.time));
        encoder.write(LogEntry { time, interface, frame }, u64::MAX, &mut bytes).unwrap();
    }
    encoder.end(&["can0".into(), "can1".into()], &[0, 0], &mut bytes).unwrap();
    if let Some(head) = encoder.head() {
        bytes[..head.len()].copy_from_slice(&head);
    }
    let packed = packed.and_then(|packed| packed.to_str());
    let bytes = match packed {
        Some("gz") => {
            let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
            packed.write_all(&bytes).unwrap();
            packed.finish().unwrap()
        }
        Some(_) => compress_to_vec(&bytes[..], CompressionLevel::Fastest),
        None => bytes,
    };
    fs::write(path, bytes).unwrap();
}

fn open(path: &Path, clock: &Clock) -> Port {
    let spec = BusSpec::File(path.to_owned());
    bus::open(&spec, BusIndex(0), clock.clone(), Options::default()).expect("a port")
}

/// Receives frames until `is_enough`.
fn receive(port: &Port, mut is_enough: impl FnMut(&[Frame]) -> bool) -> Vec<Frame> {
    let (deadline, mut frames) = (Monotonic::now() + PATIENCE, Vec::new());
    while !is_enough(&frames) {
        assert!(Monotonic::now() < deadline, "{} frames", frames.len());
        port.queue().drain(&mut frames, 10_000);
        port.queue().take_status();
        std::thread::yield_now();
    }
    frames
}

/// An app with a small capture that read a whole log; also the frames.
fn app_of(path: &Path) -> (App, Vec<Frame>) {
    let clock = Clock::replaying(EPOCH, 1.0);
    let mut port = open(path, &clock);
    clock.control(PlaybackCommand::ReadTo(Instant::LATEST));
    port.wake();
    let frames = receive(&port, |_| port.queue().is_finished());
    let config = Config { listen_only: true, bitrate: Some(1_000_000), ..Config::default() };
    let buses = ["can0", "can1"].map(|name| (name.to_owned(), config.clone())).to_vec();
    let options =
        AppOptions { buses, capture_room: Some(4_000_000), epoch: EPOCH, ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    app.set_frame_source(port.take_frame_source().expect("a file"));
    app.handle_resize(120, 40);
    (app, frames)
}

#[test]
fn packed_log_has_the_time_of_its_last_frame_when_it_begins() {
    let folder = tempfile::tempdir().unwrap();
    let frames = traffic(10);
    // Its pauses are its length: nothing is played to the end meanwhile.
    let frames: Vec<Frame> = frames
        .iter()
        .map(|frame| frame.with_time(Instant::from_micros(frame.time.as_micros() * 1000)))
        .collect();
    for name in ["log.log", "log.log.gz", "log.log.zst", "log.pcapng.gz"] {
        let path = folder.path().join(name);
        write_log(&path, &frames);
        let clock = Clock::replaying(EPOCH, 1.0);
        let port = open(&path, &clock);
        let received = receive(&port, |frames| !frames.is_empty());
        let last = frames.last().unwrap().time.since(frames[0].time);
        let deadline = Monotonic::now() + PATIENCE;
        let length = || Some(clock.playback()?.end?.since(received[0].time));
        while length() != Some(last) {
            assert!(Monotonic::now() < deadline, "{name}: {:?}, not {last:?}", length());
            std::thread::yield_now();
        }
    }
}

#[test]
fn frames_of_a_file_are_read_again_by_their_numbers() {
    let frames = traffic(8);
    let folder = tempfile::tempdir().unwrap();
    let text = ["session.log", "session.asc", "session.trc", "session.log.gz", "session.log.zst"];
    for name in [&text[..], &["session.pcapng", "session.blf", "session.blf.gz"]].concat() {
        let path = folder.path().join(name);
        write_log(&path, &frames);
        let clock = Clock::replaying(EPOCH, 1.0);
        let mut port = open(&path, &clock);
        let mut source = port.take_frame_source().expect("a file");
        clock.control(PlaybackCommand::ReadTo(Instant::LATEST));
        port.wake();
        let received = receive(&port, |_| port.queue().is_finished());
        assert_eq!((received.len(), source.numbers()), (frames.len(), 0..frames.len() as u64));
        assert_eq!(
            received.iter().filter(|frame| frame.bus == BusIndex(1)).count(),
            frames.len() / 7
        );
        let start = received[0].time;
        for (from, count) in [(0, 10), (4_090, 20), (4_096, 4_096), (frames.len() - 5, 5)] {
            let mut read = Vec::new();
            source.read(from as u64..(from + count) as u64, &mut |frame| read.push(frame)).unwrap();
            let offset = read[0].time.since(Instant::ZERO);
            let expected = &received[from..from + count];
            assert_eq!(expected[0].time.since(start), offset, "{name}");
            assert!(
                read.iter()
                    .map(|frame| frame.with_time(frame.time + start.since(Instant::ZERO)))
                    .eq(expected.iter().copied()),
                "{name}, from {from}"
            );
        }
    }
}

#[test]
fn log_is_read_ahead_to_a_moment_and_stands_there() {
    let frames = traffic(6);
    let folder = tempfile::tempdir().unwrap();
    for name in ["session.log", "session.pcapng"] {
        let path = folder.path().join(name);
        write_log(&path, &frames);
        let clock = Clock::replaying(EPOCH, 1.0);
        clock.control(PlaybackCommand::SetPaused(true));
        let port = open(&path, &clock);
        let to = Instant::from_micros(4_000_000);
        clock.control(PlaybackCommand::ReadTo(to));
        port.wake();
        let start = frames[0].time;
        let expected =
            frames.iter().filter(|frame| frame.time.since(start) <= to.since(Instant::ZERO));
        let expected = expected.count();
        let received = receive(&port, |received| received.len() >= expected && clock.now() == to);
        assert_eq!(received.len(), expected, "{name}");
        let playback = clock.playback().unwrap();
        assert_eq!((playback.is_paused, playback.reads_to), (true, None));
        // The end of the file shows how long it is.
        let length = frames.last().unwrap().time.since(start);
        assert_eq!(playback.end, Some(Instant::ZERO + length), "{name}");
        std::thread::yield_now();
        assert_eq!(clock.now(), to, "it stands");
    }
}

#[test]
fn past_moments_of_a_log_are_those_that_were() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session.log");
    write_log(&path, &traffic(40));
    let (mut app, frames) = app_of(&path);
    let (mut moments, mut rng) = (Vec::new(), fastrand::Rng::with_seed(3));
    for frame in &frames {
        app.advance_to(frame.time);
        app.handle_frames(frame.time, &[*frame]);
        if rng.u32(0..2000) == 0 {
            let history = app.history();
            moments.push((history.present(app.now()), format!("{:?}", **history)));
        }
    }
    // Frames as 24 bytes would need more than the room.
    assert!(frames.len() > 60_000, "{}", frames.len());
    assert_eq!((app.capture().first(), app.capture().end()), (0, frames.len() as u64));
    assert_eq!(app.history().begin(app.capture()), Instant::ZERO);
    for number in (0..frames.len()).step_by(997) {
        assert_eq!(app.capture().get(number as u64), Some(frames[number]));
    }
    rng.shuffle(&mut moments);
    assert!(moments.len() > 20);
    for (moment, expected) in moments {
        let replay: Option<BusesReplay> = app.history().replay(app.capture(), moment);
        let mut replay = replay.expect("every moment of a log is kept");
        while !replay.run(app.history(), app.capture(), 1000) {}
        assert!(format!("{:?}", replay.into_buses()) == expected, "{moment:?} differs");
    }
    // The filter tests the frames that are not in memory, too.
    for key in "2/id:123".chars() {
        app.handle_key(app.now(), Key::char(key));
    }
    while let Some(due) = app.poll_timeout().filter(|_| app.hidden_frames().is_none()) {
        app.handle_timeout(due);
    }
    let filter = Filter::parse("id:123", RowKind::Frame).unwrap();
    let matcher = app.log_matcher(&filter);
    let hidden = frames.iter().filter(|frame| !matcher.is_match(frame, None)).count();
    assert!(hidden < frames.len());
    assert_eq!(app.hidden_frames(), Some(hidden as u64));
}

#[test]
fn truncated_log_has_no_frames_from_before() {
    let frames = traffic(20);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session.log");
    write_log(&path, &frames);
    let (mut app, received) = app_of(&path);
    for frame in &received {
        app.advance_to(frame.time);
        app.handle_frames(frame.time, &[*frame]);
    }
    assert!(app.capture().get(5).is_some());
    // Other lines of the same length, in place.
    let mut log = OpenOptions::new().write(true).open(&path).unwrap();
    log.write_all(b"(1795500000.000000) can9 123#").unwrap();
    log.set_len(100).unwrap();
    drop(log);
    assert!(app.capture().get(9_000).is_none(), "not the frames of another log");
    assert!(app.capture().first() > 9_000, "{}", app.capture().first());
    let end = app.capture().end();
    assert_eq!(app.capture().get(end - 1), received.last().copied(), "the newest are in memory");
}
