//! Screen tests: keys and simulated buses as input, screens as output; one module for each page.

mod alarm;
mod ascii;
mod bus;
mod bus_choice;
mod buses;
mod calls;
mod candidates;
mod capture_saving;
mod comparison;
mod conflict;
mod conflict_panel;
mod costs;
mod device_views;
mod devices;
mod file;
mod help;
mod input;
mod keys;
mod lanes;
mod marks;
mod moment;
mod plan;
mod play;
mod problems;
mod profile;
mod themes;
mod time_bar;
mod timeline;
mod traffic;
mod two_buses;

use crate::common::harness::{BOILER, Stage, text_of};
use descan::app::Problem;
use descan::frame::BusIndex;
use descan::status::{BusStatus, Link};
use descan::theme::BUILT_IN;
use descan::time::{Duration, Instant};
use ratatui::buffer::Buffer;

/// Compares any text with the snapshot of that name.
macro_rules! text_snapshot {
    ($name:expr, $text:expr) => {
        insta::with_settings!({ prepend_module_to_snapshot => false }, {
            insta::assert_snapshot!($name, $text)
        })
    };
}
pub(crate) use text_snapshot;

/// Compares the screen, as text, with a snapshot.
macro_rules! snapshot {
    ($name:literal, $stage:expr) => {
        $crate::screen::text_snapshot!($name, $stage.screen())
    };
}
use snapshot;

/// Returns the words of a screen on one line, with one blank between them.
fn one_line(screen: &str) -> String {
    screen.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Returns the app with FEED edited to 70 and SENS to 71, both rejected by the disk.
fn with_two_unsaved_edits() -> Stage {
    let mut stage = Stage::boiler();
    stage.slow_disk().until(24.0).keys("e").text("70").keys("Enter j e").text("71").keys("Enter");
    stage.file = Some(BOILER.as_bytes().to_vec());
    stage.refuse_saves();
    stage
}

impl Stage {
    /// Runs without received frames until `seconds` after the start, or until nothing is due.
    fn wait_until(&mut self, seconds: f64) -> &mut Self {
        let end = Instant::ZERO + Duration::from_secs_f64(seconds);
        while let Some(at) = self.app.poll_timeout().filter(|at| *at <= end) {
            self.pass(at);
            self.drain(at);
        }
        self
    }

    fn link(&mut self, link: Link) -> &mut Self {
        let status = BusStatus { link, ..BusStatus::default() };
        self.app.handle_bus(self.app.now(), BusIndex(0), status);
        self
    }
}

/// Returns the problems as listed: sign, muted or not, text.
fn problems(stage: &Stage) -> Vec<String> {
    let shown = stage.app.problems_shown();
    let line = |problem: Problem| {
        let muted = if problem.is_muted { "muted " } else { "" };
        format!("{muted}{} {}", problem.state(), problem.title())
    };
    shown.iter().map(line).collect()
}

/// Returns each row's text, and below it the positions of its styles.
fn styles_of(buffer: &Buffer) -> String {
    use std::fmt::Write;
    let mut text = String::new();
    let width = usize::from(buffer.area.width);
    for (row, line) in buffer.content().chunks(width).zip(text_of(buffer).lines()) {
        let _ = writeln!(text, "{line}");
        let mut at = 0;
        for run in row.chunk_by(|a, b| a.style() == b.style()) {
            let style = run[0].style();
            let _ = write!(text, "    {at}–{}", at + run.len());
            at += run.len();
            let colours = [("", style.fg), ("on ", style.bg)];
            for (word, colour) in colours.into_iter().filter_map(|(word, it)| Some((word, it?))) {
                if colour != ratatui::style::Color::Reset {
                    let _ = write!(text, " {word}{colour}");
                }
            }
            if !style.add_modifier.is_empty() {
                let _ = write!(text, " {:?}", style.add_modifier);
            }
        }
        text.push('\n');
    }
    text
}

#[test]
fn timeline_problems_and_help_match_snapshots() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    snapshot!("timeline_80x24", stage.keys("3"));
    snapshot!("problems_80x24", stage.keys("4"));
    snapshot!("problems_40x10", stage.size(40, 10));
    snapshot!("help_80x24", stage.size(80, 24).keys("?"));
    snapshot!("help_120x40", stage.size(120, 60));
}

#[test]
fn styles_by_role_match_snapshot() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(60, 16);
    for theme in ["terminal", "mono"] {
        text_snapshot!(format!("styles_{theme}"), styles_of(&stage.buffer(theme)));
    }
}

#[test]
fn every_state_is_readable_without_colour() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    for (name, _) in BUILT_IN {
        assert_eq!(text_of(&stage.buffer(name)), stage.screen(), "{name}");
    }
    let screen = stage.screen();
    for words in
        ["● ", "⚠  14A ACT ", "CONFLICT", "missing", "✓ 12", "≠ 3 svc", "✗ 16", "+ new", "SENS²"]
    {
        assert!(screen.contains(words), "{words}\n{screen}");
    }
}

#[test]
fn every_terminal_size_is_drawn() {
    let mut stage = Stage::boiler();
    stage.until(30.0);
    for keys in ["1", "2", "v", "v Enter", "3", "v", "v", "G o", "x", "Esc 4", "5", "?"] {
        stage.keys(keys);
        for columns in [1, 2, 7, 20, 39, 60, 75, 76, 99, 200] {
            for rows in [1, 2, 3, 6, 12, 17, 18, 50] {
                stage.size(columns, rows).screen();
            }
        }
    }
}
