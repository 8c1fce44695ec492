//! Logs from outside: a file replayed as a port, and a log piped in while it is written.

use descan::bus::{self, BusSpec, Clock, Options, Port, TransmitError};
use descan::frame::{BusIndex, CanId, Frame};
use descan::log::LogReader;
use descan::log::pcapng::{write_frame, write_interface, write_section};
use descan::status::{Link, PlaybackCommand};
use descan::time::{Duration, Epoch, Instant};
use std::fs::{self, File};
use std::io::{BufReader, Write};
use std::time::Instant as Monotonic;

const PATIENCE: Duration = Duration::from_mins(1);
const LOG: &str = "\
(100.000000) can0 02015402#04
(100.200000) can1 123#R4
garbage
(100.400000) can0 02015402#05 T
";

/// Receives everything until the port reports its end.
fn drain(port: &Port) -> Vec<Frame> {
    take_until(port, |_| port.queue().is_finished())
}

fn take_until(port: &Port, condition: impl Fn(&[Frame]) -> bool) -> Vec<Frame> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
    let mut frames = Vec::new();
    let wait = async {
        loop {
            port.queue().drain(&mut frames, 1000);
            port.queue().take_status();
            if condition(&frames) {
                return;
            }
            port.queue().ready().await;
        }
    };
    runtime.block_on(async { tokio::time::timeout(PATIENCE, wait).await }).expect("in time");
    frames
}

fn open(spec: &BusSpec, clock: Clock) -> Port {
    bus::open(spec, BusIndex(2), clock, Options::default()).expect("a port")
}

fn log_file(text: &str) -> (tempfile::TempDir, BusSpec) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session.log");
    std::fs::write(&path, text).unwrap();
    (folder, BusSpec::File(path))
}

#[test]
fn file_replay_keeps_frame_times() {
    let (_folder, spec) = log_file(LOG);
    let clock = Clock::replaying(Epoch::from_unix_micros(100_000_000), 1.0);
    let before = Monotonic::now();
    let port = open(&spec, clock);
    let frames = drain(&port);
    assert!(before.elapsed() >= Duration::from_millis(400));
    let start = frames[0].time;
    let ages: Vec<_> = frames.iter().map(|frame| frame.time.since(start).as_millis()).collect();
    assert_eq!(ages, [0, 200, 400]);
    let told: Vec<_> = frames.iter().map(|frame| (frame.bus, frame.is_tx)).collect();
    assert_eq!(told, [(BusIndex(2), false), (BusIndex(3), false), (BusIndex(2), true)]);
    assert_eq!(port.queue().names_from(0), ["can0", "can1"]);

    let status = port.queue().status();
    assert_eq!(status.link, Link::Ended);
    assert_eq!(
        status.fault.map(|it| it.to_string()).as_deref(),
        Some(
            "3 frames of 2 interfaces; line 3 cannot be read: it does not begin with \
             (SECONDS.FRACTION)"
        )
    );
    assert_eq!(port.transmit(&Frame::classic(1, &[])), Err(TransmitError::ListenOnly));
}

#[test]
fn faster_clock_replays_faster() {
    let hours = "(0.0) can0 123#\n(7200.0) can0 123#\n";
    let (_folder, spec) = log_file(hours);
    let port = open(&spec, Clock::replaying(Epoch::default(), 100_000.0));
    let frames = drain(&port);
    assert_eq!(frames[1].time.since(frames[0].time), Duration::from_hours(2));
}

#[test]
fn burst_larger_than_the_queue_loses_no_frame() {
    let (_folder, spec) = log_file(&"(1.0) can0 123#\n".repeat(50_000));
    let port = open(&spec, Clock::start());
    let frames = drain(&port);
    assert_eq!((frames.len(), port.queue().status().queue_drops), (50_000, 0));
}

#[test]
fn pipe_is_read_while_it_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pipe");
    nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap();
    let writer = std::thread::spawn({
        let path = path.clone();
        move || File::options().write(true).open(path).unwrap()
    });
    let port = open(&BusSpec::File(path), Clock::start());
    let mut writer = writer.join().unwrap();
    writer.write_all(b"(1.0) can0 00000001#\n(1.0) can0 0000").unwrap();
    assert_eq!(take_until(&port, |frames| frames.len() == 1)[0].platform_id(), Some(1));
    writer.write_all(b"0002#\n").unwrap();
    assert_eq!(take_until(&port, |frames| frames.len() == 1)[0].platform_id(), Some(2));

    // Dropped while it waits for the next line.
    drop(port);
    drop(writer);
}

#[test]
fn dropped_replay_ends_at_once() {
    let (_folder, spec) = log_file("(0.0) can0 123#\n(100000.0) can0 123#\n");
    let port = open(&spec, Clock::start());
    take_until(&port, |frames| frames.len() == 1);
    drop(port);
}

#[test]
fn unopenable_log_error_names_the_file() {
    let clock = Clock::start();
    for path in ["/nowhere/session.log", "/"] {
        let spec = BusSpec::File(path.into());
        let error = bus::open(&spec, BusIndex(0), clock.clone(), Options::default()).unwrap_err();
        let start = format!("file:{path} cannot be read: ");
        assert!(error.to_string().starts_with(&start), "{error}");
    }
}

#[test]
fn log_at_full_speed_uses_log_time() {
    let (_folder, spec) = log_file(LOG);
    let BusSpec::File(path) = spec else { unreachable!() };
    let mut reader = LogReader::new(BufReader::new(bus::open_log(&path).unwrap()));
    let frames: Vec<_> = reader.by_ref().map(Result::unwrap).collect();
    assert_eq!(
        frames[1],
        Frame::remote(CanId::Standard(0x123), 4).with_bus(BusIndex(1)).with_time(frames[1].time)
    );
    assert_eq!(reader.summary().last, Instant::from_micros(400_000));
    assert_eq!(reader.summary().epoch, Some(Epoch::from_unix_micros(100_000_000)));
}

#[test]
fn clock_set_back_continues_from_last_time() {
    let (_folder, spec) = log_file(
        "(7300.0) can0 123#\n(7301.0) can0 123#\n(3701.5) can0 123#\n(3702.5) can0 123#\n",
    );
    let BusSpec::File(path) = &spec else { unreachable!() };
    let mut reader = LogReader::new(BufReader::new(bus::open_log(path).unwrap()));
    let frames = reader.by_ref().map(Result::unwrap);
    let moments: Vec<_> = frames.map(|frame| frame.time.as_micros() / 1_000).collect();
    assert_eq!(moments, [0, 1000, 1000, 2000]);
    assert_eq!(reader.summary().to_string(), "4 frames; time goes backwards 1 time");
    // Events after the last frame are an hour later, not in the past.
    assert_eq!(reader.summary().epoch.unwrap().unix_micros(reader.summary().last), 7_302_000_000);

    let port = open(&spec, Clock::replaying(Epoch::from_unix_micros(7_300_000_000), 1000.0));
    let frames = drain(&port);
    assert_eq!(frames[3].time.since(frames[0].time), Duration::from_secs(2));
}

/// Receives frames until there are so many in total; calls `nudge` repeatedly meanwhile.
fn take_with(port: &Port, frames: &mut Vec<Frame>, count: usize, nudge: impl Fn()) {
    let deadline = Monotonic::now() + PATIENCE;
    while frames.len() < count {
        assert!(Monotonic::now() < deadline, "{frames:?}");
        nudge();
        port.queue().drain(frames, 1000);
        std::thread::yield_now();
    }
    assert_eq!(frames.len(), count, "no more than that");
}

#[test]
fn log_pauses_steps_and_resumes() {
    let day = Duration::from_hours(24);
    let (_folder, spec) = log_file(
        "(000000.0) can0 00000001#\n(086400.0) can0 00000002#\n(172800.0) can0 00000003#\n\
         (172800.0) can0 00000004#\n(172800.1) can0 00000005#\n",
    );
    let clock = Clock::replaying(Epoch::from_unix_micros(0), 1.0);
    clock.control(PlaybackCommand::Pause);
    let port = open(&spec, clock.clone());
    // The next frame may not have been read yet.
    let step_to = |at: Instant| {
        if clock.now() < at {
            clock.control(PlaybackCommand::Step);
            port.wake();
        }
    };
    let start = Instant::ZERO;
    let mut frames = Vec::new();
    // The first frame is at the start.
    take_with(&port, &mut frames, 1, || {});
    take_with(&port, &mut frames, 2, || step_to(start + day));
    assert_eq!(clock.now(), start + day, "that is where it stands");
    // Two frames of the same time come with one step.
    take_with(&port, &mut frames, 4, || step_to(start + day * 2));
    assert_eq!(clock.now(), start + day * 2);
    clock.control(PlaybackCommand::Pause);
    port.wake();
    take_with(&port, &mut frames, 5, || {});
    // At the end of the log the clock stands at exactly that time.
    drain(&port);
    assert_eq!(port.queue().status().percent, Some(100));
    let end = clock.now();
    assert!(end >= start + day * 2 + Duration::from_millis(100));
    assert_eq!(clock.now(), end);
    assert_eq!(clock.playback().map(|it| it.is_ended), Some(true));
}

#[test]
fn growing_file_is_followed_with_its_own_times() {
    let (_folder, spec) = log_file("(1000.0) can0 00000001#\n(1000.5) can0 00000002#\n(1001");
    let BusSpec::File(path) = &spec else { unreachable!() };
    let clock = Clock::replaying(Epoch::from_unix_micros(1_000_000_000), 1000.0);
    let port = open(&spec, clock.clone());
    let mut frames = drain(&port);
    let status = port.queue().status();
    assert_eq!(
        status.fault.map(|it| it.to_string()).as_deref(),
        Some("2 frames; last line incomplete")
    );
    let append = |text: &str| {
        File::options().append(true).open(path).unwrap().write_all(text.as_bytes()).unwrap();
    };
    // An hour later by the log, and at once by descan's clock.
    append(".25) can0 00000003#\n(4600.0) can0 00000004#\n(4600.1) can0 00000005#\n");
    take_with(&port, &mut frames, 5, || {});
    let millis: Vec<_> = frames.iter().map(|it| it.time.as_micros() / 1000).collect();
    assert_eq!(millis, [0, 500, 1_250, 3_600_000, 3_600_100], "dated as it is written");
    assert_eq!(clock.playback().map(|it| it.speed), Some(1.0), "it is live now");
    // A writer with a buffer has more frames: no time passes until they are written.
    let deadline = Monotonic::now() + PATIENCE;
    while clock.until(Instant::from_micros(3_700_000_000)) < Duration::MAX {
        assert!(Monotonic::now() < deadline);
        std::thread::yield_now();
    }
    assert_eq!(port.queue().status().link, Link::Up);
}

#[test]
fn truncated_or_replaced_file_is_read_from_start() {
    let (folder, spec) = log_file("(1000.0) can0 00000001#\n(1000.1) can0 00000002#\n");
    let BusSpec::File(path) = &spec else { unreachable!() };
    let port = open(&spec, Clock::replaying(Epoch::from_unix_micros(1_000_000_000), 1000.0));
    let mut frames = drain(&port);
    // What reads the queue learns of another log after all frames before, and before its first one.
    let next_log = |frames: &mut Vec<Frame>, changes: u64, why: &str| {
        let deadline = Monotonic::now() + PATIENCE;
        let before = frames.len();
        loop {
            port.queue().drain(frames, 1000);
            assert_eq!(frames.len(), before, "no frame before the change is known");
            match port.queue().take_status() {
                Some(status) if status.log_changes == changes => {
                    return assert_eq!(status.note.as_deref(), Some(why));
                }
                _ => assert!(Monotonic::now() < deadline, "{:?}", port.queue().status()),
            }
            std::thread::yield_now();
        }
    };

    fs::write(path, "(2000.0) can0 00000003#\n").unwrap();
    next_log(&mut frames, 1, "log truncated: read from its start, devices start over");
    take_with(&port, &mut frames, 3, || {});

    let next = folder.path().join("next");
    // A log of the other format, in two pieces.
    let mut pcapng = Vec::new();
    write_section(&mut pcapng).unwrap();
    write_interface(&mut pcapng, "can0").unwrap();
    write_frame(&mut pcapng, 0, 3_000_000_000, &Frame::classic(4, &[])).unwrap();
    let first = pcapng.len() - 7;
    fs::write(&next, &pcapng[..first]).unwrap();
    fs::rename(&next, path).unwrap();
    next_log(&mut frames, 2, "log replaced: new one is read, devices start over");
    File::options().append(true).open(path).unwrap().write_all(&pcapng[first..]).unwrap();
    take_with(&port, &mut frames, 4, || {});
    let told: Vec<_> = frames.iter().map(|it| it.platform_id().unwrap()).collect();
    assert_eq!(told, [1, 2, 3, 4]);
    assert!(frames.is_sorted_by_key(|frame| frame.time));
}

/// Tests that the clock does not run ahead of what was written to a pipe.
#[test]
fn pipe_is_read_ahead_only_as_far_as_it_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pipe.log");
    nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap();
    let pipe = path.clone();
    let writer = std::thread::spawn(move || {
        let mut pipe = File::options().write(true).open(pipe).unwrap();
        pipe.write_all(b"(1000.0) can0 00000001#\n(1000.5) can0 00000002#\n").unwrap();
        pipe
    });
    let clock = Clock::replaying(Epoch::from_unix_micros(1_000_000_000), 1.0);
    let port = open(&BusSpec::File(path), clock.clone());
    let _pipe = writer.join().unwrap();
    clock.control(PlaybackCommand::Pause);
    clock.control(PlaybackCommand::ReadTo(Instant::LATEST));
    port.wake();
    let mut frames = Vec::new();
    take_with(&port, &mut frames, 2, || {});
    assert!(clock.now() < Instant::ZERO + Duration::from_hours(1), "{:?}", clock.now());
    clock.control(PlaybackCommand::Pause);
    assert!(clock.now() < Instant::ZERO + Duration::from_hours(1), "{:?}", clock.now());
}

#[test]
fn last_line_without_newline_is_read() {
    let (_folder, spec) = log_file("(1000.0) can0 00000001#\n(1000.1) can0 00000002#");
    let BusSpec::File(path) = &spec else { unreachable!() };
    let long_ago = std::time::SystemTime::now() - Duration::from_mins(1);
    File::options().append(true).open(path).unwrap().set_modified(long_ago).unwrap();
    let port = open(&spec, Clock::replaying(Epoch::from_unix_micros(1_000_000_000), 1000.0));
    assert_eq!(drain(&port).len(), 2);
    let said = port.queue().status().fault.map(|it| it.to_string());
    assert_eq!(said.as_deref(), Some("2 frames; the last line has no end: it may be cut off"));
}
