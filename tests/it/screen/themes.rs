//! Themes: painted backgrounds, the selected row.

use super::{snapshot, text_snapshot};
use crate::common::harness::Stage;
use descan::app::{Effect, RowState};
use descan::theme::BUILT_IN;
use ratatui::style::Color;
use std::collections::BTreeSet;

/// Themes that paint the whole screen.
const PAINTED: [(&str, Color); 3] = [
    ("dark", Color::Rgb(0x1c, 0x1f, 0x24)),
    ("light", Color::Rgb(0xfa, 0xfa, 0xf7)),
    ("high-contrast", Color::Black),
];

/// Colours of a line of the list: foreground and background of each cell.
fn row_colours(stage: &Stage, theme: &str, line: usize) -> (Vec<Color>, Vec<Color>) {
    let (buffer, list) = (stage.buffer(theme), stage.app.screen().list);
    // The mark of the selected row stands in the first column.
    let cells = (list.left() + 1..list.right()).map(|x| &buffer[(x, list.y + line as u16)]);
    cells.map(|cell| (cell.fg, cell.bg)).unzip()
}

#[test]
fn painted_theme_fills_every_cell_of_every_page() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    for (columns, rows) in [(40, 10), (80, 24), (120, 36), (200, 45)] {
        stage.size(columns, rows);
        for key in ["1", "2", "2 v", "v", "3", "4", "5", "?", "Esc d", "Esc Space", "Space 1"] {
            stage.keys(key);
            for (theme, _) in PAINTED {
                let buffer = stage.buffer(theme);
                let bare = buffer.content().iter().filter(|cell| cell.bg == Color::Reset).count();
                assert_eq!(bare, 0, "{theme} {columns} {key}");
            }
            for theme in ["terminal", "mono"] {
                let buffer = stage.buffer(theme);
                let own = buffer.content().iter().filter(|cell| cell.bg == Color::Reset).count();
                assert!(own * 2 > buffer.content().len(), "{theme} {columns} {key}");
            }
        }
    }
    for (theme, paper) in PAINTED {
        let buffer = stage.buffer(theme);
        let painted = buffer.content().iter().filter(|cell| cell.bg == paper).count();
        assert!(painted * 5 > buffer.content().len() * 4, "{theme}");
    }
}

#[test]
fn selected_row_of_each_state_keeps_its_colours() {
    let mut seen = BTreeSet::new();
    for (seconds, keys) in [(27.0, ""), (45.0, ""), (112.0, "")] {
        let mut stage = Stage::boiler();
        stage.until(seconds).size(120, 36).keys("Space").keys(keys);
        for line in 0..stage.app.rows().len() {
            for (theme, _) in BUILT_IN.into_iter().filter(|(theme, _)| *theme != "mono") {
                stage.keys(if line == 0 { "End" } else { "Home" });
                let (colours, plain) = row_colours(&stage, theme, line);
                stage.keys("Home");
                for _ in 0..line {
                    stage.keys("j");
                }
                assert_eq!(stage.app.selected_row_index(), Some(line));
                let (selected, tint) = row_colours(&stage, theme, line);
                assert_eq!(selected, colours, "{theme}: {:?}", stage.app.rows()[line]);
                assert!(tint.windows(2).all(|two| two[0] == two[1]), "{theme}: one background");
                assert_eq!(tint == plain, theme == "terminal", "{theme}: only its background");
            }
            seen.insert(stage.app.rows()[line].state);
        }
    }
    for state in [RowState::Conflict, RowState::Missing, RowState::Online, RowState::Lost] {
        assert!(seen.contains(&state), "{state:?} of {seen:?}");
    }
}

#[test]
fn styles_of_painted_themes_match_snapshots() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(60, 16);
    for (theme, _) in PAINTED {
        text_snapshot!(format!("styles_{theme}"), super::styles_of(&stage.buffer(theme)));
    }
    stage.keys("Space");
    text_snapshot!("styles_frozen_dark", super::styles_of(&stage.buffer("dark")));
}

#[test]
fn picker_shows_themes_live_and_keeps_one_on_enter() {
    let mut stage = Stage::boiler();
    stage.until(20.0);
    let used = |stage: &mut Stage| {
        let effects = std::mem::take(&mut stage.effects);
        effects
            .into_iter()
            .filter(|it| matches!(it, Effect::UseTheme(_) | Effect::KeepTheme(_)))
            .collect::<Vec<_>>()
    };
    snapshot!("theme_picker_80x24", stage.keys("t"));
    assert!(stage.screen().contains("FEED"), "the page stays: {}", stage.screen());
    assert_eq!(used(&mut stage), [], "the current one is selected");
    stage.keys("Down Down");
    let (dark, light) = (Effect::UseTheme("dark".into()), Effect::UseTheme("light".into()));
    assert_eq!(used(&mut stage), [dark, light]);
    stage.keys("Esc");
    assert_eq!(used(&mut stage), [Effect::UseTheme("terminal".into())], "as before");
    stage.keys("t Down Enter");
    let kept = [Effect::UseTheme("dark".into()), Effect::KeepTheme("dark".into())];
    assert_eq!(used(&mut stage), kept);
    let now = stage.app.now();
    stage.app.handle_kept_theme(now, Ok(()));
    assert!(stage.screen().contains("theme dark kept in config.toml"), "{}", stage.screen());
    stage.app.handle_kept_theme(now, Err("disk full".into()));
    assert!(stage.screen().contains("theme not kept: disk full"), "{}", stage.screen());
}
