//! The page Timeline.

use super::snapshot;
use crate::common::harness::Stage;
use descan::app::Page;
use descan::time::{Duration, Instant};

#[test]
fn escape_returns_from_frames_to_the_timeline_line() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("3 k k");
    let timeline = stage.screen();
    stage.keys("f");
    assert_eq!(stage.app.view().page, Page::Traffic);
    assert!(stage.screen().contains("Esc back"), "{}", stage.screen());
    stage.keys("Enter").keys("/").text("HR").keys("Enter Esc");
    assert_eq!(stage.app.view().page, Page::Traffic, "the details and the filter are left first");
    stage.keys("Esc Esc");
    assert_eq!(stage.screen(), timeline);
    // After a change of page, Esc does not return to the first one.
    stage.keys("f 1 2 Esc");
    assert_eq!(stage.app.view().page, Page::Traffic);
}

#[test]
fn device_filter_shows_its_whole_timeline() {
    let mut stage = Stage::boiler();
    stage.until(170.0).size(100, 24).keys("3 /").text("heat").keys("Enter");
    // It claimed 16 before it had a row, and held it under a row that is now DIN's.
    snapshot!("story_of_heat", stage);
    stage.keys("Esc /").text("dev:disp").keys("Enter");
    snapshot!("story_of_disp", stage);
}

#[test]
fn timeline_line_opens_its_frames() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("3 k k f");
    assert_eq!(stage.app.view().page, Page::Traffic);
    let number = stage.app.view().traffic.unwrap();
    let frame = stage.app.capture().get(number).unwrap();
    let story = stage.app.story(*stage.app.view().timeline.selected().unwrap()).unwrap();
    assert_eq!(frame.time, story.begin());
    stage.keys("Esc").keys("j j f");
    let frame = stage.app.selected_frame().unwrap();
    assert!(frame.time > Instant::ZERO + Duration::from_secs(26), "{}", frame.time);
}

#[test]
fn timeline_line_shows_its_moment() {
    let config = descan::discovery::Config { seed: 7, ..Default::default() };
    let scenario = descan::sim::Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with_room(&scenario, None, config, 16 << 20);
    stage.until(24.0).keys("3 k k");
    let lines = stage.app.lines_shown();
    let key = lines[lines.len() - 3];
    let time = stage.app.story(key).unwrap().begin();
    stage.keys("Enter");
    assert_eq!(stage.app.view().page, Page::Timeline);
    assert_eq!(stage.app.past_moment().map(|moment| moment.time), Some(time));
    assert_eq!(stage.app.lines_shown().last(), Some(&key));
    stage.keys("Esc");
    assert_eq!(stage.app.past_moment(), None);
}

#[test]
fn device_leads_to_its_frames() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("1 j f");
    assert_eq!(stage.app.page_filter(Page::Traffic).text(), "at:12");
    assert!(stage.screen().contains("/at:12"), "{}", stage.screen());
}

/// The boiler, with room for its whole past.
fn with_past() -> Stage {
    let config = descan::discovery::Config { seed: 7, ..Default::default() };
    let scenario = descan::sim::Scenario::builtin("boiler").unwrap();
    Stage::with_room(&scenario, None, config, 16 << 20)
}

/// The lines of the Timeline page with these words, trimmed.
fn lines_with(stage: &mut Stage, words: &str) -> Vec<String> {
    let screen = stage.size(160, 60).keys("3").screen();
    screen.lines().filter(|line| line.contains(words)).map(|it| it.trim().to_owned()).collect()
}

#[test]
fn conflict_is_one_line_while_its_state_changes() {
    let mut stage = with_past();
    for (seconds, sign, words) in [
        (29.0, "?", "conflict SPARE01 / BOILER03, suspected"),
        (40.0, "⚠", "conflict SPARE01 / BOILER03, confirmed 12:00:31."),
        (70.0, "✓", "conflict SPARE01 / BOILER03, confirmed 12:00:31."),
    ] {
        let lines = lines_with(stage.until(seconds), "SPARE01 / BOILER03");
        assert_eq!(lines.len(), 1, "{seconds}: {lines:?}");
        let (line, is_over) = (&lines[0], sign == "✓");
        assert!(line.starts_with(&format!("{sign} 12:00:26.")), "{line}");
        assert!(line.contains(words), "{line}");
        assert_eq!(line.contains(" … "), !is_over, "{line}");
        assert_eq!(line.ends_with(", over"), is_over, "{line}");
    }
    // At a moment in between it is as it was then.
    stage.keys(":").text("12:00:29").keys("Enter");
    let lines = lines_with(&mut stage, "SPARE01 / BOILER03");
    assert_eq!(lines.len(), 1, "{lines:?}");
    assert!(lines[0].contains(" … ") && lines[0].ends_with("suspected"), "{lines:?}");
}

#[test]
fn steps_of_a_story_have_lines_of_their_own() {
    let mut stage = with_past();
    stage.until(45.0).size(120, 40).keys("3 G o");
    snapshot!("timeline_steps_120x40", stage);
    let lines = stage.app.lines_shown();
    let steps: Vec<u32> = lines.iter().rev().map(|key| key.step).take_while(|it| *it > 0).collect();
    assert!(steps.len() > 3, "{steps:?}");
    // Each step leads to its own moment and frames.
    stage.keys("G k Enter");
    let key = *stage.app.view().timeline.selected().unwrap();
    let step = stage.app.story(key).unwrap().step(key.step).unwrap();
    assert_eq!(stage.app.past_moment().map(|it| it.time), Some(step.entry.time));
    assert_eq!(stage.app.lines_shown().last(), Some(&key), "later steps are not known yet");
    stage.keys("Esc Esc o");
    assert!(stage.app.lines_shown().iter().all(|key| key.step == 0), "closed again");
}

#[test]
fn hidden_kinds_have_no_lines_and_are_counted() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("3");
    let all = stage.app.lines_shown().len();
    assert!(stage.screen().contains("kinds (x): all"), "{}", stage.screen());
    stage.keys("x");
    snapshot!("timeline_kinds_80x24", stage);
    stage.keys("Space Esc");
    let screen = stage.screen();
    let shown = stage.app.lines_shown().len();
    assert!(!screen.contains("joined at") && !screen.contains("appeared at"), "{screen}");
    assert!(screen.contains(&format!(" {shown} lines, {} hidden ", all - shown)), "{screen}");
    assert!(screen.contains("kinds (x): without join"), "{screen}");
    // Only conflicts, then all again.
    stage.keys("x Down Down Down Down Down = Esc");
    assert_eq!(stage.app.lines_shown().len(), 1);
    stage.keys("x Down Down Down Down Down = Esc");
    assert_eq!(stage.app.lines_shown().len(), all);
}

#[test]
fn length_of_a_conflict_is_that_of_the_problems_page() {
    let mut stage = with_past();
    stage.until(75.0).size(120, 40).keys("3");
    let line = lines_with(&mut stage, "conflict SPARE01 / BOILER03").pop().unwrap();
    assert!(line.contains(", over"), "{line}");
    stage.keys("4");
    let screen = stage.screen();
    let problem = screen.lines().find(|line| line.contains("SPARE01 joined, conf")).unwrap();
    let length = problem.split("  ").find(|text| text.trim().ends_with(" s")).unwrap().trim();
    assert!(line.contains(&format!(" {length} ")), "{length}\n{line}\n{problem}");
}

#[test]
fn latest_lines_are_those_of_the_timeline() {
    let mut stage = with_past();
    stage.until(45.0).size(160, 60).keys("1");
    let screen = stage.screen();
    let latest: Vec<&str> =
        screen.lines().skip_while(|line| !line.contains("─ latest ─")).collect();
    let words = "conflict SPARE01 / BOILER03, confirmed 12:00:31.";
    let line = latest.iter().find(|line| line.contains(words)).expect(&screen);
    assert!(line.starts_with(" 12:00:3") && line.contains(" ⚠ ACT @14 "), "{line}");
    let count = latest.iter().filter(|line| line.contains("SPARE01 / BOILER03")).count();
    assert_eq!(count, 1, "a line for each story");
    let lines = latest.iter().skip(1).take_while(|line| !line.contains('├'));
    let times = lines.map(|line| line.get(1..9).unwrap_or_default());
    let times: Vec<&str> = times.take_while(|time| time.contains(':')).collect();
    assert!(times.len() > 3 && times.is_sorted(), "the last change at the bottom: {times:?}");
    assert!(latest.iter().any(|line| line.contains("joined at 107 (claimed), CFG, 2 services")));
    // Of a past moment those of then.
    stage.keys(":").text("12:00:29").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains(" ? ACT @14      conflict SPARE01 / BOILER03, suspected"), "{screen}");
    stage.keys("Esc").until(150.0);
    let words = "Bus errors: ";
    assert!(!lines_with(&mut stage, words).is_empty());
    let screen = stage.keys("5").screen();
    let bus: Vec<&str> =
        screen.lines().skip_while(|line| !line.contains("what happened to")).collect();
    assert!(bus.iter().filter(|line| line.contains(words)).count() == 1, "{screen}");
}
