//! Frames handled by the thousand: the same state and the same events as one by one.

use crate::common::inspection;
use descan::app::{
    App, AppOptions, FileIndex, FileReading, ProjectFacts, RedundantTask, TaskDevice,
};
use descan::discovery::Config;
use descan::frame::{BusIndex, Frame};
use descan::keymap::Key;
use descan::log::LogReader;
use descan::sim::Scenario;
use descan::status::{BusStatus, Link, Playback};
use descan::time::{Duration, Instant};
use std::sync::Arc;

/// Returns the frames of a simulated log; every third one is on a second bus.
fn frames_of(scenario: &str) -> Vec<Frame> {
    let log = inspection::log(&Scenario::builtin(scenario).unwrap(), 60);
    let frames = LogReader::new(log.as_bytes()).map(Result::unwrap).enumerate();
    frames.map(|(at, frame)| frame.with_bus(BusIndex(u8::from(at % 3 == 0)))).collect()
}

fn app(page: Option<char>) -> App {
    let buses = ["can0", "can1"].map(|name| {
        (name.to_owned(), Config { listen_only: true, bitrate: Some(250_000), ..Config::default() })
    });
    let options = AppOptions { buses: buses.to_vec(), emit_events: true, ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    if let Some(page) = page {
        app.handle_resize(100, 30);
        app.handle_key(Instant::ZERO, Key::char(page));
        app.take_dirty();
    }
    app
}

/// All that a user or a script may see.
fn described(app: &mut App) -> Vec<String> {
    let mut lines: Vec<String> =
        std::iter::from_fn(|| app.poll_app_event()).map(|event| format!("{event:?}")).collect();
    lines.extend(app.timeline().entries().map(|line| format!("{line:?}")));
    lines.extend(app.buses().iter().map(|bus| format!("{bus:?}")));
    lines.extend(app.identifiers().rows().iter().map(|row| format!("{row:?}")));
    lines.extend(app.calls().rows().iter().map(|row| format!("{row:?}")));
    lines.push(format!("{:?}", app.capture().frames_from(0).collect::<Vec<_>>()));
    lines.push(format!("{:?} {:?} {}", app.now(), app.poll_timeout(), app.is_dirty()));
    lines
}

#[test]
fn frames_by_the_thousand_are_as_frames_one_by_one() {
    for scenario in Scenario::BUILTIN {
        let frames = frames_of(scenario);
        assert!(frames.len() > 1000, "{}", frames.len());
        for page in [None, Some('1'), Some('4')] {
            let (mut one_by_one, mut by_many) = (app(page), app(page));
            for frame in &frames {
                one_by_one.advance_to(frame.time);
                one_by_one.handle_frames(frame.time, &[*frame]);
            }
            for part in frames.chunks(777) {
                by_many.handle_frames(part.last().unwrap().time, part);
            }
            let (expected, found) = (described(&mut one_by_one), described(&mut by_many));
            assert_eq!(found.len(), expected.len(), "{scenario}");
            for (found, expected) in found.iter().zip(&expected) {
                assert_eq!(found, expected, "{scenario}, {page:?}");
            }
        }
    }
}

#[test]
fn nothing_is_captured_where_nothing_reads_it() {
    let frames = frames_of("boiler");
    let mut app = App::new(
        Instant::ZERO,
        AppOptions {
            buses: vec![("can0".to_owned(), Config::default())],
            without_capture: true,
            ..AppOptions::default()
        },
    );
    app.handle_frames(frames.last().unwrap().time, &frames);
    assert!(app.buses()[0].counters().frames > 0);
    assert_eq!(app.capture().end(), 0);
    assert!(app.identifiers().rows().is_empty() && app.calls().rows().is_empty());
}

/// What the timeline says of missing devices and of a lost redundancy, with its times. Each batch is handled when
/// the clock is `ahead` of its last frame, as far as the next one allows.
fn differences(frames: &[Frame], batch: usize, ahead: Duration) -> Vec<String> {
    let device = |bus: &str| TaskDevice {
        bus: bus.to_owned(),
        uid: Some("BOILER0,".to_owned()),
        ..TaskDevice::default()
    };
    let devices = vec![device("can0"), device("can1")];
    let facts = ProjectFacts {
        tasks: vec![RedundantTask { task: "feed".to_owned(), devices }],
        ..ProjectFacts::default()
    };
    let mut app = App::new(
        Instant::ZERO,
        AppOptions {
            buses: vec![
                ("can0".to_owned(), Config { listen_only: true, ..Config::default() }),
                ("can1".to_owned(), Config { listen_only: true, ..Config::default() }),
            ],
            file_path: Some("des.json".into()),
            project: Arc::new(facts),
            ..AppOptions::default()
        },
    );
    app.handle_resize(120, 40);
    let entries = (10..40).map(|at| format!(r#"{{"name":"D{at}","address":{at}}}"#));
    let file = format!("[{}]", entries.collect::<Vec<_>>().join(","));
    let reading = FileReading::Content(Some(file.into_bytes()));
    app.handle_file(Instant::ZERO, FileIndex::default(), reading);
    app.handle_playback(Instant::ZERO, Playback::default());
    let up = BusStatus { link: Link::Up, ..BusStatus::default() };
    for bus in [BusIndex(0), BusIndex(1)] {
        app.handle_bus(Instant::ZERO, bus, up.clone());
    }
    let mut rest = frames;
    while !rest.is_empty() {
        let (part, later) = rest.split_at(batch.min(rest.len()));
        let next = later.first().map_or(Instant::LATEST, |frame| frame.time);
        app.handle_frames((part.last().unwrap().time + ahead).min(next), part);
        // A key is handled by the clock of the replay, of which frames may be late.
        app.handle_key(part.last().unwrap().time + ahead, Key::char('j'));
        rest = later;
    }
    let steps = app.stories().iter().flat_map(|story| story.steps().to_vec());
    let steps = steps.filter(|step| step.entry.finding.is_some());
    steps.map(|step| format!("{:?} {}", step.entry.time, step.entry.text)).collect()
}

#[test]
fn differences_have_their_times_at_any_pace() {
    // Devices that come and go at odd moments.
    let mut frames = Vec::new();
    for address in 10..24_u32 {
        let first = u64::from(address) * 1_003_701;
        for number in 0..20_u64 {
            let rnd7 = (number as u32).wrapping_mul(0x9E37_79B1) >> 25;
            let id = 0x0700_0001 | address << 17 | rnd7 << 10;
            let data = [0x8A, 0xFA, 0x6C, 0x97, 0x24, address as u8, 4, 0];
            let time = Instant::from_micros(first + number * 1_000_113);
            let frame = Frame::classic(id, &data).with_time(time);
            frames.push(frame.with_bus(BusIndex((address % 2) as u8)));
        }
    }
    frames.sort_by_key(|frame| frame.time);
    let expected = differences(&frames, 1, Duration::ZERO);
    assert!(expected.len() > 10, "{expected:#?}");
    for (batch, ahead) in [(1, 3), (1, 40), (1, 300), (5, 0), (5, 33), (64, 150), (1000, 0)] {
        let found = differences(&frames, batch, Duration::from_millis(ahead));
        assert_eq!(found, expected, "batches of {batch}, {ahead} ms ahead");
    }
}
