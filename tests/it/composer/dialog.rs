//! The dialog of the composer.

use crate::common::harness::Stage;
use crate::screen::text_snapshot;
use descan::app::{App, AppOptions, Effect, SendingResult};
use descan::discovery::Config;
use descan::sim::Scenario;
use descan::time::Instant;

fn boiler() -> Stage {
    let mut stage = Stage::boiler();
    stage.size(80, 24).until(10.0);
    stage
}

#[test]
fn dialog_shows_the_frame_as_it_is_typed() {
    let mut stage = boiler();
    stage.keys("C");
    text_snapshot!("composer_80x24", stage.screen());
    stage.size(120, 40).keys("Ctrl-u").text("FEED wroking");
    let screen = stage.screen();
    assert!(screen.contains("✗        to: wroking is not understood"), "{screen}");
    stage.keys("Enter");
    assert!(!stage.screen().contains("Send 0"), "a mistake is not asked about");
    stage
        .keys("Ctrl-u")
        .text("FEED")
        .keys("Tab Ctrl-u")
        .text("mode")
        .keys("Tab Ctrl-u")
        .text("idle");
    text_snapshot!("composer_change_120x40", stage.screen());
    stage.size(40, 10);
    text_snapshot!("composer_40x10", stage.screen());
    for (columns, rows) in [(20, 5), (31, 8), (60, 15), (200, 50)] {
        stage.size(columns, rows);
        stage.screen();
    }
}

#[test]
fn enter_asks_and_answers_stand_below() {
    let mut stage = boiler();
    stage.keys("C Enter");
    let screen = stage.screen();
    assert!(screen.contains("Send 00002802#0444455301 to FEED @10?"), "{screen}");
    stage.keys("n");
    assert_eq!(stage.app.sent_frames().count(), 0);
    stage.keys("Enter y").until(11.5);
    text_snapshot!("composer_answer_80x24", stage.screen());
    // A services request, chosen in the data; then back to the one before.
    stage.keys("Tab Tab Ctrl-u").text("services").keys("Enter y").until(13.0);
    assert!(stage.screen().contains("5 services: DES 1.0"), "{}", stage.screen());
    let data = |stage: &Stage| stage.app.composer_dialog().unwrap().composition().data;
    stage.keys("Up Up");
    assert_eq!(data(&stage), "name");
    stage.keys("Down");
    assert_eq!(data(&stage), "services");
    stage.keys("Esc");
    assert!(stage.app.composer_dialog().is_none());
    stage.keys("C");
    assert_eq!(data(&stage), "services", "it keeps its content");
}

#[test]
fn earlier_runs_are_recalled_and_sent_frames_remembered() {
    let options = AppOptions {
        buses: vec![("can0".to_owned(), Config::default())],
        recent_frames: vec!["debug 0x005 01".to_owned(), "not words".to_owned()],
        ..AppOptions::default()
    };
    let mut stage = boiler();
    stage.keys("C Enter y");
    let is_remembered = |effect: &Effect| {
        *effect == Effect::RememberFrame("request des data name to @10".to_owned())
    };
    assert!(stage.effects.iter().any(is_remembered), "{:?}", stage.effects);
    let mut stage = boiler();
    stage.app = App::new(Instant::ZERO, options);
    stage.size(80, 24).keys("C Tab Tab Up");
    let composition = stage.app.composer_dialog().unwrap().composition();
    assert_eq!(composition.to_words(), "debug 0x005 data 01");
}

#[test]
fn templates_are_saved_and_opened_in_turn() {
    let mut stage = boiler();
    stage.size(120, 40).keys("C Ctrl-o");
    assert!(stage.screen().contains("no template; Ctrl-s saves one"), "{}", stage.screen());
    let name = "request des data name to @10".to_owned();
    let kept = |stage: &Stage| {
        let keeps = |it: &&Effect| matches!(it, Effect::KeepTemplate(_));
        stage.effects.iter().filter(keeps).cloned().collect::<Vec<Effect>>()
    };
    stage.keys("Ctrl-s");
    assert_eq!(kept(&stage), [Effect::KeepTemplate(name.clone())]);
    stage.keys("Ctrl-s");
    assert!(stage.screen().contains("saved already"), "{}", stage.screen());
    // Words with a mistake are not saved; those of a device that is absent are.
    stage.keys("Ctrl-u").text("@12 wroking").keys("Ctrl-s");
    assert_eq!(kept(&stage).len(), 1);
    stage.keys("Ctrl-u").text("PUMP").keys("Ctrl-s");
    let other = "request des data name to PUMP".to_owned();
    assert_eq!(kept(&stage)[1], Effect::KeepTemplate(other.clone()));
    let words = |stage: &Stage| stage.app.composer_dialog().unwrap().composition().to_words();
    for expected in [&name, &other, &name] {
        stage.keys("Ctrl-o");
        assert_eq!(words(&stage), *expected);
    }
    // One that cannot be stored is none in this run, either.
    let now = stage.app.now();
    stage.app.handle_lost_template(now, &other, "no space left");
    assert!(stage.screen().contains("template not saved: no space left"), "{}", stage.screen());
    stage.keys("Ctrl-o Ctrl-o");
    assert_eq!(words(&stage), name);
    // Those of earlier runs are offered; a line that cannot be read is left out.
    let options = AppOptions {
        buses: vec![("can0".to_owned(), Config::default())],
        templates: vec!["# own".to_owned(), "debug 0x005 data 01".to_owned()],
        ..AppOptions::default()
    };
    stage.app = App::new(Instant::ZERO, options);
    stage.keys("C Ctrl-o");
    assert_eq!(words(&stage), "debug 0x005 data 01");
}

#[test]
fn foreign_source_is_a_second_question() {
    let mut stage = boiler();
    stage.size(120, 40).keys("C Tab Tab Tab Tab").text("@12");
    stage.keys("Enter");
    assert!(stage.screen().contains("Send 00182802#0444455301"), "{}", stage.screen());
    stage.keys("y");
    let screen = stage.screen();
    assert!(screen.contains("SENS @12 will give its address up. Send it?"), "{screen}");
    // The second y of a double press is not an answer to it.
    stage.keys("y");
    assert_eq!(stage.app.sent_frames().count(), 0);
    stage.until(11.0).keys("n");
    assert_eq!(stage.app.sent_frames().count(), 0, "no is no");
    stage.keys("Enter y").until(12.0).keys("y").until(13.0);
    let sent = stage.app.sent_frames().next_back().unwrap();
    assert_eq!(sent.composed.frame_text(), "00182802#0444455301");
    assert!(sent.last_sent.is_some());
}

#[test]
fn escape_stops_the_copies_before_it_closes() {
    let mut stage = boiler();
    stage
        .size(120, 40)
        .keys("C Shift-Tab Shift-Tab Shift-Tab Ctrl-u")
        .text("50")
        .keys("Tab Ctrl-u")
        .text("200");
    stage.keys("Enter");
    assert!(stage.screen().contains("50 times, one every 200.0 ms?"), "{}", stage.screen());
    stage.keys("y").until(11.1);
    assert!(stage.screen().contains("of 50 sent; Esc stops"), "{}", stage.screen());
    stage.keys("Esc").until(13.0);
    assert!(stage.app.composer_dialog().is_some());
    let sent = stage.app.sent_frames().next_back().unwrap();
    assert!((4..=7).contains(&sent.copies), "{}", sent.copies);
    assert!(matches!(sent.result, Some(SendingResult::Ended(_))));
    stage.keys("Esc");
    assert!(stage.app.composer_dialog().is_none());
}

#[test]
fn traffic_fills_the_fields_from_the_selected_frame() {
    let mut stage = boiler();
    stage.size(120, 40).keys("2 /").text("src:10 srv:des").keys("Enter Home").until(10.5);
    let frame = stage.app.selected_frame().expect("a frame of FEED");
    stage.keys("C");
    let dialog = stage.app.composer_dialog().unwrap();
    let composed = stage.app.dialog_frames(dialog).unwrap();
    assert!(composed.frames[0].same_on_wire(&frame), "{:?}", dialog.composition());
    assert!(stage.screen().contains("response"), "{}", stage.screen());
}

#[test]
fn dialog_only_shows_where_nothing_is_sent() {
    let config = Config { listen_only: true, seed: 7, ..Config::default() };
    let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), None, config);
    stage.until(5.0).keys("C Ctrl-u").text("@10");
    text_snapshot!("composer_listen_only_80x24", stage.screen());
    stage.keys("Enter");
    assert!(stage.screen().contains("listen-only: no requests are sent"));
    assert!(stage.app.question().is_none());
    // At a past moment.
    let mut stage = boiler();
    stage.keys("Space C");
    assert!(stage.screen().contains("shown, not sent: frozen"), "{}", stage.screen());
    stage.keys("Enter");
    assert!(stage.app.question().is_none());
}

#[test]
fn receivers_and_services_are_chosen_by_up_and_down() {
    let mut stage = boiler();
    stage.keys("C");
    let to = |stage: &Stage| stage.app.composer_dialog().unwrap().composition().to;
    assert_eq!(to(&stage), "@10");
    stage.keys("Down");
    assert_eq!(to(&stage), "@12");
    stage.keys("Up Up");
    assert_eq!(to(&stage), "all not-working");
    stage.keys("Tab Down");
    assert_eq!(stage.app.composer_dialog().unwrap().composition().service, "heartbeat");
    stage.app.handle_paste(stage.app.now(), "12\n34");
    assert_eq!(stage.app.composer_dialog().unwrap().composition().service, "heartbeat12");
}
