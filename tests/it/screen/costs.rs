//! What a page at rest costs: bytes to the terminal, in simulated time; and what a slow line gets.

use crate::common::busy::{Busy, VIEWS};
use crate::common::paced::PacedScreen;
use descan::shell::paint_pace::{PaintPace, SCREEN_BUDGET};
use descan::time::Duration;

/// Most bytes of a second at rest, on every page, at any load.
const MOST: usize = 2000;
/// Frames per second: heartbeats only; two full buses.
const LOADS: [u64; 2] = [127, 15_000];
/// Bytes per second of a line of 9,600 baud.
const SLOW: f64 = 960.0;

fn seconds(count: u64) -> Duration {
    Duration::from_secs(count)
}

/// Returns the lines that a terminal of 120 × 40 shows.
fn shown(busy: &Busy) -> Vec<String> {
    let cells = |count: u16| count.try_into().unwrap();
    let mut parser = vt100::Parser::new(cells(40), cells(120), 0);
    parser.process(&busy.screen.screen.output().0);
    let rows = parser.screen().rows(0, 120);
    rows.map(|row| row.trim_end().to_owned()).collect()
}

#[test]
fn page_at_rest_sends_at_most_2_kb_per_second() {
    for view in &VIEWS {
        for (load, size) in [(LOADS[0], (80, 24)), (LOADS[1], (120, 40)), (LOADS[0], (200, 50))] {
            let mut busy = Busy::new(load, size, view.has_conflict);
            busy.run(seconds(15)).keys(view.keys).run(seconds(5));
            let before = busy.screen.bytes;
            busy.run(seconds(20));
            let each = (busy.screen.bytes - before) / 20;
            assert!(each <= MOST, "{}, {size:?}, {load}/s: {each} bytes", view.name);
        }
    }
}

/// The budget is for charts and traffic: devices that change nothing cost no more than their clock.
#[test]
fn devices_at_rest_send_their_clock_only() {
    let mut busy = Busy::new(LOADS[1], (200, 50), false);
    busy.run(seconds(20));
    let before = busy.screen.bytes;
    busy.run(seconds(20));
    let each = (busy.screen.bytes - before) / 20;
    assert!(each <= 250, "{each} bytes");
}

#[test]
fn terminal_shows_what_was_drawn() {
    for line in [None, Some(SLOW)] {
        for view in &VIEWS {
            let mut busy = Busy::new(LOADS[0], (120, 40), view.has_conflict);
            busy.screen = PacedScreen::with(PaintPace::new(SCREEN_BUDGET, line), 120, 40);
            busy.run(seconds(5)).keys(view.keys).run(seconds(3));
            // Frozen: nothing changes until all is sent.
            busy.keys("Space Esc").run(seconds(1)).keys("Space").finish();
            let screen = busy.screen();
            let wanted: Vec<&str> = screen.lines().map(str::trim_end).collect();
            let shown = shown(&busy);
            for (row, (shown, wanted)) in shown.iter().zip(&wanted).enumerate() {
                assert_eq!(shown, wanted, "{}, row {row}, line {line:?}", view.name);
            }
        }
    }
}

#[test]
fn slow_line_gets_no_more_than_it_takes() {
    for keys in ["2", "5", "4"] {
        let mut busy = Busy::new(2000, (80, 24), true);
        busy.screen = PacedScreen::with(PaintPace::new(SCREEN_BUDGET, Some(SLOW)), 80, 24);
        busy.run(seconds(15)).keys(keys).run(seconds(10));
        let before = busy.screen.bytes;
        busy.run(seconds(30));
        let each = (busy.screen.bytes - before) / 30;
        assert!(each <= 600, "{keys}: {each} bytes, half of the line is free for keys");
        // The whole screen of another page, and what changes on it meanwhile.
        let before = busy.screen.bytes;
        busy.keys("1").run(seconds(4));
        let sent = busy.screen.bytes - before;
        assert!(sent <= 4 * 960 + 300, "{keys}: {sent} bytes");
    }
}

/// More frames than can be read: a sample stands until the next, which says how many lie between.
#[test]
fn followed_frames_say_how_many_are_skipped() {
    let mut busy = Busy::new(2000, (120, 40), false);
    busy.run(seconds(15)).keys("2").run(seconds(10));
    let lines = shown(&busy);
    let header = lines.iter().find(|line| line.contains("skipped")).unwrap();
    let count: Vec<&str> = header.split_whitespace().collect();
    let count: u64 = count[count.len() - 2].parse().expect("a number of frames");
    assert!((1000..20_000).contains(&count), "{header}");
    assert!(header.ends_with("skipped"), "{header}");
}
