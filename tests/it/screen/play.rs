//! Playing: the shown moment moves in real time, at a pace, in both directions.

use super::comparison::boiler;
use crate::common::harness::Stage;
use descan::app::Effect;
use descan::status::{Playback, PlaybackCommand};
use descan::time::{Duration, Instant};

/// The moment that is shown, in seconds; `None` for the present.
fn shown(stage: &Stage) -> Option<f64> {
    Some(stage.app.past_moment()?.time.as_micros() as f64 / 1e6)
}

fn is_near(stage: &Stage, seconds: f64) -> bool {
    shown(stage).is_some_and(|shown| (shown - seconds).abs() < 0.3)
}

#[test]
fn moment_is_played_backwards_and_forwards_until_live() {
    let mut stage = boiler();
    stage.until(40.0).keys("(");
    assert!((stage.app.play_pace().unwrap().factor() + 1.0).abs() < 1e-9);
    stage.until(44.0);
    assert!(is_near(&stage, 36.0), "{:?}", shown(&stage));
    // Twice as fast backwards.
    stage.keys("(").until(46.0);
    assert!(is_near(&stage, 32.0), "{:?}", shown(&stage));
    stage.keys("Space").until(50.0);
    assert!(is_near(&stage, 32.0), "it stands: {:?}", shown(&stage));
    assert_eq!(stage.app.play_pace(), None);
    stage.keys(")").until(51.0);
    assert!(is_near(&stage, 33.0), "{:?}", shown(&stage));
    // 1024 times as fast: the present is reached at once.
    stage.keys(") ) ) ) ) ) ) ) ) ) ) )").until(52.0);
    assert_eq!((shown(&stage), stage.app.play_pace()), (None, None));
}

#[test]
fn playing_backwards_stops_at_the_first_moment() {
    let mut stage = boiler();
    stage.until(20.0).keys("( ( ( (").until(24.0);
    assert!(is_near(&stage, 0.0), "{:?}", shown(&stage));
    assert_eq!(stage.app.play_pace(), None);
}

#[test]
fn step_to_an_event_stops_playing() {
    let mut stage = boiler();
    stage.until(40.0).keys("(").until(42.0).keys("[");
    let at = shown(&stage);
    stage.until(45.0);
    assert_eq!((shown(&stage), stage.app.play_pace()), (at, None));
}

/// A log of a minute that was read for 20 s.
fn log() -> Stage {
    let mut stage = boiler();
    stage.until(20.0);
    let end = Some(Instant::from_micros(60_000_000));
    stage.app.handle_playback(stage.app.now(), Playback { end, ..Playback::default() });
    effects(&mut stage);
    stage
}

/// The commands to the playback since the last call.
fn effects(stage: &mut Stage) -> Vec<PlaybackCommand> {
    let effects = std::mem::take(&mut stage.effects);
    let commands = effects.into_iter().filter_map(|effect| match effect {
        Effect::Playback(command) => Some(command),
        _ => None,
    });
    commands.collect()
}

#[test]
fn log_is_paused_while_another_moment_is_shown() {
    let mut stage = log();
    stage.keys("[");
    assert_eq!(effects(&mut stage), [PlaybackCommand::SetPaused(true)]);
    stage.keys("[ Esc");
    assert_eq!(effects(&mut stage), [PlaybackCommand::SetPaused(false)]);
    assert_eq!(shown(&stage), None);
}

#[test]
fn paused_log_is_played_by_space() {
    let mut stage = log();
    let playback = Playback { is_paused: true, ..Playback::default() };
    stage.app.handle_playback(stage.app.now(), playback);
    stage.keys("Space");
    assert_eq!(effects(&mut stage), [PlaybackCommand::SetPaused(false)]);
    assert_eq!(shown(&stage), None);
}

#[test]
fn paused_log_is_played_backwards() {
    let mut stage = log();
    let playback = Playback { is_paused: true, ..Playback::default() };
    stage.app.handle_playback(stage.app.now(), playback);
    stage.keys("(");
    assert_eq!(effects(&mut stage), []);
    assert!(stage.app.play_pace().is_some_and(|pace| pace.factor() < 0.0));
    stage.keys("Space Esc");
    let screen = stage.screen();
    assert!(screen.contains("as far as the log was played"), "{screen}");
    // A pace that was raised is lowered first.
    let playback = Playback { is_paused: true, speed: 2.0, ..Playback::default() };
    stage.app.handle_playback(stage.app.now(), playback);
    stage.keys("(");
    assert_eq!(effects(&mut stage), [PlaybackCommand::Slower]);
    assert_eq!(shown(&stage), None);
}

#[test]
fn later_moment_of_a_log_is_read_ahead() {
    let mut stage = log();
    stage.keys(":").text("50%").keys("Enter");
    let to = Instant::from_micros(30_000_000);
    let commands = effects(&mut stage);
    assert_eq!(commands, [PlaybackCommand::SetPaused(true), PlaybackCommand::ReadTo(to)]);
    assert_eq!(stage.app.reading_ahead(), Some(to));
    stage.until(29.0);
    assert_eq!(shown(&stage), None);
    stage.until(30.5);
    assert_eq!((shown(&stage), stage.app.reading_ahead()), (Some(30.0), None));
}

#[test]
fn later_frame_of_a_log_is_read_up_to() {
    let mut stage = log();
    let read = stage.app.capture().end();
    let wanted = read + 100;
    stage.keys(":").text(&format!("#{wanted}"));
    assert!(stage.screen().contains("the log is read up to it"), "{}", stage.screen());
    stage.keys("Enter");
    assert!(matches!(
        effects(&mut stage)[..],
        [PlaybackCommand::SetPaused(true), PlaybackCommand::ReadTo(_)]
    ));
    assert!(stage.screen().contains(&format!("up to frame {wanted}")), "{}", stage.screen());
    stage.until(44.0);
    let commands = effects(&mut stage);
    assert_eq!(commands.last(), Some(&PlaybackCommand::ReadTo(Instant::ZERO)));
    assert_eq!(stage.app.reading_ahead(), None);
    let time = stage.app.capture().time_of(wanted - 1).unwrap();
    assert_eq!(shown(&stage), Some(time.as_micros() as f64 / 1e6), "after that frame");
    // One behind the end.
    stage.keys("Esc :").text("#999999999").keys("Enter");
    let ended = Playback { is_ended: true, ..Playback::default() };
    stage.app.handle_playback(stage.app.now(), ended);
    stage.until(45.5);
    let screen = stage.screen();
    assert!(screen.contains("no such frame: the log has "), "{screen}");
    assert_eq!(stage.app.reading_ahead(), None);
}

#[test]
fn escape_stops_reading_ahead_where_the_log_is() {
    let mut stage = log();
    stage.keys(":").text("100%").keys("Enter").until(25.0).keys("Esc");
    let commands = effects(&mut stage);
    assert_eq!(commands.last(), Some(&PlaybackCommand::ReadTo(Instant::ZERO)));
    assert_eq!(shown(&stage), Some(25.0));
    stage.pass(stage.app.now() + Duration::from_secs(1));
    assert_eq!(shown(&stage), Some(25.0));
}

#[test]
fn next_problem_of_a_log_is_read_up_to() {
    let mut stage = log();
    // The conflict is suspected at 26.8 s, which was not read.
    stage.keys("}");
    let commands = effects(&mut stage);
    // In steps: what is read is the present afterwards.
    let step = PlaybackCommand::ReadTo(stage.app.now() + Duration::from_secs(2));
    assert_eq!(commands, [PlaybackCommand::SetPaused(true), step]);
    assert!(stage.screen().contains("reading the log up to the next one"), "{}", stage.screen());
    stage.until(26.0);
    assert_eq!(shown(&stage), None);
    stage.until(28.0);
    let found = shown(&stage).expect("the finding");
    assert!((26.5..27.0).contains(&found), "{found}");
    let commands = effects(&mut stage);
    let (last, steps) = commands.split_last().expect("commands");
    assert_eq!(*last, PlaybackCommand::ReadTo(Instant::ZERO), "reading stops");
    let is_step =
        |it: &PlaybackCommand| matches!(it, PlaybackCommand::ReadTo(to) if *to < Instant::LATEST);
    assert!(steps.len() > 1 && steps.iter().all(is_step), "{steps:?}");
    // Without a further one the end of the log is shown.
    stage.until(45.0).keys(&"} ".repeat(20));
    assert!(stage.app.reading_ahead().is_some());
    let ended = Playback { is_ended: true, ..Playback::default() };
    stage.app.handle_playback(stage.app.now(), ended);
    stage.until(45.5);
    assert!(stage.app.reading_ahead().is_none() && stage.screen().contains("no later one"));
}
