//! The help page.

use super::snapshot;
use crate::common::harness::Stage;
use descan::sim::Scenario;
use descan::status::Playback;
use descan::theme::Role;

#[test]
fn every_action_is_in_the_help() {
    let mut stage = Stage::boiler();
    assert!(!stage.size(79, 400).keys("?").screen().contains("The log"), "there is none");
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

#[test]
fn keys_of_the_open_page_come_first() {
    let mut stage = Stage::boiler();
    stage.until(12.0);
    for (key, title, first) in [
        ("1", "Keys of Devices", "Devices"),
        ("2", "Keys of Traffic", "Traffic"),
        ("3", "Keys of Timeline", "Timeline"),
        ("4", "Keys of Problems", "Problems"),
        ("5", "Keys of Bus", "Bus"),
    ] {
        let screen = stage.keys(key).keys("?").screen();
        let rule = usize::from(stage.app.screen().tabs.y);
        let lines: Vec<&str> = screen.lines().collect();
        assert!(lines[rule].contains(title), "{screen}");
        assert!(lines[rule + 1].trim_start().starts_with(first), "{screen}");
        stage.keys("Esc");
    }
    let screen = stage.keys("1 ? Tab").screen();
    assert!(screen.contains("Keys of Traffic ─ Tab keys of Timeline"), "{screen}");
    snapshot!("help_200x45", stage.size(200, 45).keys("Esc 1 ?"));
}

#[test]
fn search_keeps_the_lines_with_all_words() {
    let mut stage = Stage::boiler();
    stage.until(12.0).size(120, 36).keys("? /").text("Freeze event");
    let screen = stage.screen();
    assert!(screen.contains("Freeze at the event before"), "{screen}");
    assert!(!screen.contains("Sort by next column"), "{screen}");
    assert!(screen.contains(" / Freeze event"), "{screen}");
    assert!(screen.contains("1 line with it   Enter keep   Esc all lines again"), "{screen}");
    let marked = |stage: &Stage| {
        let buffer = stage.buffer("dark");
        let style = |cell: &&ratatui::buffer::Cell| {
            cell.modifier.contains(ratatui::style::Modifier::UNDERLINED)
        };
        buffer.content().iter().filter(style).map(ratatui::buffer::Cell::symbol).collect::<String>()
    };
    assert_eq!(marked(&stage), "Freezeevent");
    // Keys of the help are typed meanwhile; afterwards they are keys again.
    stage.keys("Ctrl-u").text("q").keys("Enter");
    assert!(stage.screen().contains("Quit; confirms"), "{}", stage.screen());
    stage.keys("Esc");
    assert!(stage.screen().contains("Sort by next column"), "all lines again: {}", stage.screen());
    stage.keys("/").text("zzzz");
    assert!(stage.screen().contains("no line has these words"), "{}", stage.screen());
    stage.keys("Esc Esc");
    assert!(matches!(stage.app.overlay(), descan::app::Overlay::None));
}
