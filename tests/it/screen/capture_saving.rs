//! Saving the captured frames: all, or those that the filter of Traffic shows.

use crate::common::harness::Stage;
use descan::app::{Effect, WrittenFrames};
use descan::diagnostic::Diagnostic;
use std::path::Path;

/// The log that was to be written last: its lines, and the numbers of frames.
fn saved(stage: &mut Stage, name: &str) -> (Vec<String>, WrittenFrames) {
    stage.keys("w Ctrl-u").text(name).keys("Enter");
    let Some(Effect::WriteLog { log, path }) = stage.effects.pop() else { panic!("a log") };
    assert_eq!(path, Path::new(name));
    let mut bytes = Vec::new();
    let frames = log.write_to(&mut bytes).unwrap();
    let now = stage.app.now();
    stage.app.handle_written_log(now, &path, Ok(frames));
    let text = String::from_utf8(bytes).unwrap();
    (text.lines().map(str::to_owned).collect(), frames)
}

#[test]
fn path_that_cannot_be_written_stays_in_the_prompt() {
    let mut stage = Stage::boiler();
    stage.until(20.0).keys("2 w Ctrl-u").text("/no/x.log").keys("Enter");
    let failed = |stage: &mut Stage, path: &str| {
        let (now, why) = (stage.app.now(), Diagnostic::new("no such folder"));
        stage.app.handle_written_log(now, Path::new(path), Err(why));
    };
    failed(&mut stage, "/no/x.log");
    let screen = stage.screen();
    assert!(screen.contains("save frames to: /no/x.log"), "{screen}");
    assert!(screen.contains("✗ not saved: no such folder"), "{screen}");
    let (_, frames) = {
        stage.keys("Esc");
        saved(&mut stage, "x.log")
    };
    assert!(frames.written > 0 && stage.app.prompt().is_none());
    // Another dialog is not replaced.
    stage.keys("w Ctrl-u").text("/no/y.log").keys("Enter ?");
    failed(&mut stage, "/no/y.log");
    assert!(stage.app.prompt().is_none());
    assert!(stage.app.message().is_some_and(|it| it.text.contains("no such folder")));
}

#[test]
fn filter_of_traffic_selects_the_frames_that_are_saved() {
    let mut stage = Stage::boiler();
    stage.until(20.0).size(120, 40).keys("2");
    let (all, frames) = saved(&mut stage, "all.log");
    assert_eq!((frames.written, frames.is_selection), (all.len() as u64, false));
    assert!(stage.screen().contains("saved: all.log"), "{}", stage.screen());
    stage.keys("/").text("src:FEED").keys("Enter");
    let matching = stage
        .app
        .capture()
        .frames_from(0)
        .filter(|(_, frame)| frame.platform_id().is_some_and(|id| id >> 17 & 0x7F == 10));
    let matching = matching.count() as u64;
    assert!(matching > 10);
    stage.keys("w");
    let count = format!("{matching} of {} frames (filter), candump", all.len());
    assert!(stage.screen().contains(&count), "{count}\n{}", stage.screen());
    stage.keys("Esc");
    let (lines, frames) = saved(&mut stage, "feed.log");
    assert_eq!((frames.written, frames.captured), (matching, all.len() as u64));
    assert_eq!(lines.len() as u64, matching);
    assert!(lines.iter().all(|line| all.contains(line)));
    let message = format!("saved {matching} of {} frames (filter): feed.log", all.len());
    assert!(stage.screen().contains(&message), "{}", stage.screen());
    // From another page, too.
    let (lines, _) = saved(stage.keys("5"), "feed2.log");
    assert_eq!(lines.len() as u64, matching);
    stage.keys("2 \\");
    assert_eq!(saved(&mut stage, "all2.log").0, all);
}

#[test]
fn saved_intervals_are_those_of_all_frames() {
    let mut stage = Stage::boiler();
    stage.until(20.0).size(120, 40).keys("2 /").text("dt:>900ms src:FEED").keys("Enter");
    let shown = stage.app.capture().end() - stage.app.hidden_frames().unwrap();
    let (lines, _) = saved(&mut stage, "gaps.log");
    assert!(shown > 5);
    assert_eq!(lines.len() as u64, shown);
}
