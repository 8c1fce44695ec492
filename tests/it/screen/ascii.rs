//! Signs for terminals that have ASCII only.

use super::snapshot;
use crate::common::harness::{BOILER, Stage, text_of};
use descan::app::{App, AppOptions, FileIndex, FileReading, Signs};
use descan::discovery::Config;
use descan::frame::BusIndex;
use descan::sim::Scenario;
use descan::status::{BusStatus, Link};
use descan::time::Instant;

/// The boiler on a terminal with ASCII only, after its conflict.
fn stage() -> Stage {
    let mut stage = Stage::boiler();
    let options = AppOptions {
        buses: vec![("can0".to_owned(), Config { seed: 7, ..Config::default() })],
        file_path: Some("des.json".into()),
        signs: Signs::Ascii,
        themes: vec!["terminal".to_owned()],
        ..AppOptions::default()
    };
    stage.app = App::new(Instant::ZERO, options);
    let bitrate = Some(Scenario::builtin("boiler").unwrap().bitrate);
    let status = BusStatus { link: Link::Up, bitrate, ..BusStatus::default() };
    stage.app.handle_bus(Instant::ZERO, BusIndex(0), status);
    let content = FileReading::Content(Some(BOILER.as_bytes().to_vec()));
    stage.app.handle_file(Instant::ZERO, FileIndex::default(), content);
    stage.size(80, 24).until(45.0);
    stage
}

#[test]
fn all_pages_and_dialogs_are_drawn_in_ascii() {
    let mut stage = stage();
    for (columns, rows) in [(40, 10), (80, 24), (120, 36), (200, 45)] {
        stage.size(columns, rows);
        for keys in [
            "1",
            "Right",
            "2",
            "v",
            "v",
            "v",
            "3",
            "4",
            "5",
            "?",
            "Esc t",
            "Esc M Enter '",
            "Esc d",
            "Esc 1 e",
            "Esc /",
            "Esc Space",
            "[ [",
            "2",
            "Esc 1",
        ] {
            let screen = text_of(&stage.keys(keys).buffer("terminal"));
            let beyond: Vec<char> = screen.chars().filter(|c| !c.is_ascii()).collect();
            assert_eq!(beyond, [], "{keys} {columns}:\n{screen}");
        }
    }
    snapshot!("ascii_80x24", stage.size(80, 24).keys("1"));
    snapshot!("ascii_bus_80x24", stage.keys("5"));
}
