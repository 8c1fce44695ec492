//! The time bar: its cells, where it is shown, and moving along it.

use super::comparison::boiler;
use super::snapshot;
use crate::common::harness::Stage;
use descan::app::{BAR_LEFT, BarSign, Mouse, MouseKind, TimelineKind};
use descan::status::Playback;
use descan::time::Instant;

/// A large screen after 40 seconds.
fn large() -> Stage {
    let mut stage = boiler();
    stage.size(120, 40).until(40.0);
    stage
}

/// The cell of the moment that is shown.
fn shown_cell(stage: &Stage) -> usize {
    stage.app.time_bar().cell(stage.app.past_moment().unwrap().time)
}

fn mouse(stage: &mut Stage, kind: MouseKind, cell: usize) {
    let (now, row) = (stage.app.now(), stage.app.screen().time_bar.y);
    let column = BAR_LEFT + cell as u16;
    stage.app.handle_mouse(now, Mouse { kind, column, row });
    stage.until(now.as_micros() as f64 / 1e6 + 0.5);
}

#[test]
fn time_bar_on_large_screen_is_live_and_frozen() {
    let mut stage = large();
    snapshot!("time_bar_120x40", stage);
    stage.keys("[ [ [");
    snapshot!("time_bar_frozen_120x40", stage);
}

#[test]
fn time_bar_on_small_screen_shows_when_frozen_or_wanted() {
    let mut stage = boiler();
    stage.until(40.0);
    let is_shown = |stage: &Stage| stage.screen().contains('┤');
    assert!(!is_shown(&stage), "{}", stage.screen());
    stage.keys("T");
    assert!(is_shown(&stage), "{}", stage.screen());
    stage.keys("T");
    assert!(!is_shown(&stage), "{}", stage.screen());
    stage.keys("[ [");
    snapshot!("time_bar_frozen_80x24", stage);
    stage.keys("Space");
    assert!(!is_shown(&stage), "{}", stage.screen());
}

#[test]
fn cells_have_events_findings_and_marks_of_their_time() {
    let mut stage = large();
    let bar = stage.app.time_bar().clone();
    let mut seen = vec![false; bar.cells.len()];
    let mut open = 0;
    for line in stage.app.timeline().entries() {
        let sign = bar.cells[bar.cell(line.time)];
        assert_ne!(sign, BarSign::Quiet, "{line:?}");
        seen[bar.cell(line.time)] = true;
        seen[bar.cell(line.last)] = true;
        if line.kind == TimelineKind::Confirmed {
            assert_eq!(sign, BarSign::Conflict, "{line:?}");
            open += 1;
        }
    }
    assert!(open > 0, "the scenario has a conflict");
    for (cell, sign) in bar.cells.iter().enumerate() {
        let is_empty = matches!(sign, BarSign::Quiet | BarSign::Conflict);
        assert!(seen[cell] || is_empty, "cell {cell}: {sign:?}");
    }
    stage.keys("M Enter");
    let bar = stage.app.time_bar();
    let marked = stage.app.marks().get('a').unwrap().moment.time;
    assert_eq!(bar.cells[bar.cell(marked)], BarSign::Mark('a'));
}

#[test]
fn end_of_a_log_that_stands_is_shown_once_it_is_known() {
    let mut stage = large();
    let now = stage.app.now();
    let playback = |end: u64| Playback {
        is_paused: true,
        end: Some(Instant::from_micros(end * 1_000_000)),
        seeks_end: end < 900,
        ..Playback::default()
    };
    for end in [60, 300, 900] {
        stage.app.handle_playback(now, playback(end));
        assert_eq!(Some(stage.app.time_bar().end), playback(end).end);
    }
}

#[test]
fn arrows_move_by_cells_only_while_frozen() {
    let mut stage = large();
    stage.keys("Left Shift-Left");
    assert_eq!(stage.app.past_moment(), None, "live: no scrubbing");
    let last = stage.app.time_bar().cells.len() - 1;
    stage.keys("Space Left Left Left");
    assert_eq!(shown_cell(&stage), last - 2, "the end is behind the last cell");
    stage.keys("Shift-Left");
    assert_eq!(shown_cell(&stage), last - 12);
    stage.keys("Right");
    assert_eq!(shown_cell(&stage), last - 11);
    stage.keys("Shift-Right Shift-Right Shift-Right");
    assert_eq!(shown_cell(&stage), last, "not behind the present");
}

#[test]
fn mouse_on_the_bar_goes_to_the_moment_of_the_cell() {
    let mut stage = large();
    mouse(&mut stage, MouseKind::Press, 30);
    assert!(shown_cell(&stage).abs_diff(30) <= 1);
    mouse(&mut stage, MouseKind::Drag, 60);
    assert!(shown_cell(&stage).abs_diff(60) <= 2, "{}", shown_cell(&stage));
}

#[test]
fn zoomed_bar_has_the_part_around_the_moment() {
    let mut stage = large();
    stage.until(45.0).keys("Space");
    let step = stage.app.time_bar().cell_duration();
    let before = stage.app.past_moment().unwrap().time;
    stage.keys("+ + Left");
    let bar = stage.app.time_bar();
    let moved = before.since(stage.app.past_moment().unwrap().time);
    assert!(bar.cell_duration() * 4 <= step && moved <= step / 3, "{step:?}, moved {moved:?}");
    assert!(bar.part.0 > bar.begin && bar.part.1 == bar.end, "{bar:?}");
    let line = stage.screen().lines().rev().nth(1).unwrap().to_owned();
    assert!(line.contains("├…") && line.contains('▼'), "{line}");
    // Gone to a moment elsewhere, the bar has that part.
    stage.keys("[").keys("[").keys("[").keys("[");
    let (shown, bar) = (stage.app.past_moment().unwrap().time, stage.app.time_bar());
    assert!(bar.part.0 <= shown && shown <= bar.part.1, "{shown} in {bar:?}");
    let middle = bar.moment(bar.cell(shown));
    assert!(middle.since(shown).max(shown.since(middle)) <= bar.cell_duration());
    stage.keys("- - -");
    assert!(stage.screen().contains("no other scale"));
    let bar = stage.app.time_bar();
    assert_eq!((bar.part.0, bar.part.1), (bar.begin, bar.end));
    // Cells are not shorter than 10 ms.
    stage.keys(&"+ ".repeat(20));
    assert!(stage.app.time_bar().cell_duration().as_millis() >= 10);
    assert!(stage.screen().contains("no other scale"));
}
