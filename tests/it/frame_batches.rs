//! Frames handled by the thousand: the same state and the same events as one by one.

use crate::common::inspection;
use descan::app::{App, AppOptions};
use descan::discovery::Config;
use descan::frame::{BusIndex, Frame};
use descan::keymap::Key;
use descan::log::LogReader;
use descan::sim::Scenario;
use descan::time::Instant;

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
