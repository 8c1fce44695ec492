//! The help page.

use crate::common::harness::Stage;
use descan::sim::Scenario;
use descan::status::Playback;
use descan::theme::Role;

#[test]
fn every_action_is_in_the_help() {
    let mut stage = Stage::boiler();
    assert!(!stage.size(80, 200).keys("?").screen().contains("The log"), "there is none");
    let now = stage.app.now();
    let playback =
        Playback { speed: 1.0, is_paused: false, is_ended: false, ..Playback::default() };
    stage.app.handle_playback(now, playback);
    let screen = stage.screen();
    for action in descan::keymap::ACTIONS {
        let words: Vec<&str> = action.doc.split(' ').take(3).collect();
        assert!(screen.contains(&words.join(" ")), "{}: {}", action.name, action.doc);
        assert!(screen.contains(action.keys[0]), "{}", action.name);
    }
    for role in [Role::Online, Role::Confirmed] {
        assert!(!role.doc().is_empty());
    }
}

#[test]
fn overscrolled_text_scrolls_back_at_once() {
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), None);
    stage.until(12.0).size(80, 24).keys("?");
    let top = stage.screen();
    let end = stage.keys("G").drawn().screen();
    assert_ne!(end, top);
    assert!(!end.contains("more"), "{end}");
    assert_eq!(stage.keys("Down Down PgDn").drawn().screen(), end, "there is no more");
    assert_ne!(stage.keys("Up").drawn().screen(), end);
    assert_eq!(stage.keys("g").drawn().screen(), top);
    assert!(stage.keys("PgDn PgUp").drawn().screen() == top, "a screenful down and up");
    let details = stage.keys("Esc Right").drawn().screen();
    let end = stage.keys("G Down Down").drawn().screen();
    assert_ne!(end, details);
    assert_ne!(stage.keys("Up").drawn().screen(), end);
}
