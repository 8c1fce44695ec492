//! The comparison of two moments: screens, keys, and equality with `descan diff` of two logs.

use super::{one_line, snapshot};
use crate::common::harness::{BOILER, Stage};
use crate::common::inspection::log;
use crate::simulation::random_scenario::World;
use descan::app::{App, AppOptions, MomentComparison, Overlay, Page};
use descan::discovery::Config;
use descan::inventory::Difference;
use descan::keymap::Key;
use descan::log::LogReader;
use descan::sim::Scenario;
use descan::time::Instant;
use serde_json::{Value, json};
use std::process::Command;

/// Room for captured frames in which the worlds here need several snapshots.
const ROOM: usize = 16 << 20;

/// The boiler with all its past.
pub fn boiler() -> Stage {
    let config = Config { seed: 7, ..Config::default() };
    let file = Some(BOILER.as_bytes().to_vec());
    Stage::with_room(&Scenario::builtin("boiler").unwrap(), file, config, ROOM)
}

fn comparison(app: &App) -> &MomentComparison {
    app.comparison().expect("a comparison is open")
}

fn whats(stage: &Stage) -> Vec<String> {
    let rows = comparison(&stage.app).rows().expect("both states are known");
    rows.iter().map(|row| row.difference.what()).collect()
}

#[test]
fn comparison_matches_snapshots() {
    let mut stage = boiler();
    stage.until(22.0).keys("M Enter").until(40.0);
    snapshot!("comparison_80x24", stage.keys("d"));
    snapshot!("comparison_120x40", stage.size(120, 40));
    snapshot!("comparison_40x10", stage.size(40, 10));
    // Frozen, from the start.
    stage.size(120, 40).keys("Esc").until(42.0).keys("[ [ [ ' D d");
    snapshot!("comparison_frozen_120x40", stage);
    for columns in [1, 2, 7, 20, 39, 60, 76, 99, 110, 200] {
        for rows in [1, 2, 3, 6, 12, 17, 50] {
            stage.size(columns, rows).screen();
        }
    }
}

#[test]
fn start_before_the_first_device_is_explained() {
    let mut stage = boiler();
    stage.until(30.0).keys("d");
    let hint = "A is before the first device: all are new; Right moves it on";
    assert!(one_line(&stage.screen()).contains(hint), "{}", stage.screen());
    assert!(!one_line(&stage.keys("Right").screen()).contains("before the first device"));
    stage.keys("Left Tab");
    assert!(one_line(&stage.screen()).contains("all are new; Tab Right moves it on"));
}

#[test]
fn row_of_versions_names_the_reboot_between() {
    let mut stage = boiler();
    stage.until(50.0).keys("M Enter").until(75.0).keys("d");
    let rows = comparison(&stage.app).rows().unwrap();
    let row = rows.iter().find(|row| row.difference.what() == "version").unwrap();
    assert!(row.events.contains(" rebooted"), "{}", row.events);
}

#[test]
fn last_mark_before_the_moment_is_compared() {
    let mut stage = boiler();
    stage.until(10.0).keys("M Enter").until(20.0).keys("M Enter").until(30.0).keys("d");
    let label = |stage: &Stage| {
        comparison(&stage.app).sides().each_ref().map(|side| side.label.clone()).join(" ")
    };
    assert_eq!(label(&stage), "mark b shown");
    stage.keys("Esc ' b Enter d");
    assert_eq!(label(&stage), "mark a mark b", "not with itself");
    stage.keys("Esc ' a Enter d");
    assert_eq!(label(&stage), "start mark a");
    assert!(whats(&stage).contains(&"presence".to_owned()));
}

#[test]
fn keys_move_the_chosen_moment_by_events() {
    let mut stage = boiler();
    stage.until(20.0).keys("M Enter").until(45.0).keys("d");
    let times =
        |stage: &Stage| comparison(&stage.app).sides().each_ref().map(|side| side.moment.time);
    let [a, b] = times(&stage);
    stage.keys("Tab Left Left");
    let [same, earlier] = times(&stage);
    assert!(same == a && earlier < b, "{same:?} {earlier:?}");
    stage.keys("Right Right Right");
    assert_eq!(times(&stage), [a, b], "the present is behind the last event");
    stage.keys("Right");
    assert!(stage.screen().contains("no later moment"), "{}", stage.screen());
    stage.keys("Tab");
    while !one_line(&stage.screen()).contains("no earlier moment is kept") {
        let [before, _] = times(&stage);
        stage.keys("Left");
        assert!(times(&stage)[0] <= before);
    }
    assert_eq!(times(&stage)[0], Instant::ZERO);
    // A stays at the left of nothing: B may be the earlier one, too.
    stage.keys("Tab");
    for _ in 0..200 {
        stage.keys("Left");
    }
    assert!(whats(&stage).is_empty() && stage.screen().contains("no difference"));
}

#[test]
fn row_of_a_device_leads_to_it() {
    let mut stage = boiler();
    stage.until(25.0).keys("M Enter").until(45.0).keys("3 d");
    assert_eq!(whats(&stage)[0], "boards");
    stage.keys("Enter");
    assert!(matches!(stage.app.overlay(), Overlay::None) && stage.app.comparison().is_none());
    assert_eq!(stage.app.view().page, Page::Devices);
    assert_eq!(stage.app.selected_device().map(|it| it.address.number()), Some(14));
    stage.keys("Backspace");
    assert_eq!(stage.app.view().page, Page::Timeline);
}

#[test]
fn replay_in_parts_does_not_block_keys() {
    // A full bus: the replay from a snapshot takes several parts.
    let mut stage = boiler();
    let id = descan::frame::CanId::Extended(0x0714_0101);
    for number in 0..200_000 {
        let mut frame = descan::frame::Frame::new(id, &[0xDA, 0, 0x8C, 0x10, 0, 0, 0, 0]);
        frame.time = Instant::from_micros(500 * number);
        stage.app.advance_to(frame.time);
        stage.app.handle_frames(frame.time, &[frame]);
    }
    stage.keys("d");
    let mut parts = 0;
    while comparison(&stage.app).rows().is_none() {
        assert!(stage.screen().contains("a past state is being replayed"), "{}", stage.screen());
        stage.keys("Tab");
        let due = stage.app.poll_timeout().unwrap();
        stage.app.handle_timeout(due);
        parts += 1;
        assert!(parts < 100, "it ends");
    }
    stage.keys("Tab Left");
    assert!(comparison(&stage.app).is_after_chosen() == (parts % 2 == 0));
}

// ---- equality with the command -------------------------------------------------------------

/// Plays a log into the program, as its screen does.
fn played(text: &str) -> App {
    let mut reader = LogReader::new(text.as_bytes());
    let options = AppOptions { capture_room: Some(ROOM), ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    app.handle_resize(120, 40);
    let config = Config { listen_only: true, ..Config::default() };
    while let Some(frame) = reader.next_frame().unwrap() {
        if app.buses().is_empty() {
            app.add_bus(frame.time, "can0".to_owned(), config.clone());
        }
        app.advance_to(frame.time);
        app.handle_frames(frame.time, &[frame]);
    }
    app
}

fn keys(app: &mut App, keys: &str) {
    for key in keys.split(' ') {
        app.handle_key(app.now(), Key::parse(key).unwrap());
    }
    while let Some(due) = app.poll_timeout().filter(|due| *due <= app.now()) {
        app.handle_timeout(due);
    }
}

/// Returns a row as in the JSON of the command.
fn row(difference: &Difference) -> Value {
    let subject = difference.subject().unwrap();
    json!([
        difference.kind.name(),
        difference.detail,
        subject.address,
        subject.name,
        difference.before,
        difference.after
    ])
}

/// Tests that the comparison of two moments has the rows that `descan diff` prints for two logs which
/// end there.
#[test]
fn comparison_equals_diff_of_logs_cut_at_the_moments() {
    let seeds = std::env::var("SEEDS").ok().and_then(|it| it.parse().ok()).unwrap_or(8);
    let folder = tempfile::tempdir().unwrap();
    let mut differences = 0;
    for seed in 0..seeds {
        let mut rng = fastrand::Rng::with_seed(seed);
        let text = log(&World::new(seed).scenario, 30);
        let mut app = played(&text);
        let lines: Vec<&str> = text.lines().collect();
        for _ in 0..3 {
            let mut cuts = [rng.usize(1..lines.len()), rng.usize(1..lines.len())];
            cuts.sort_unstable();
            for (cut, name) in cuts.into_iter().zip(["a.log", "b.log"]) {
                std::fs::write(folder.path().join(name), lines[..cut].join("\n")).unwrap();
            }
            keys(&mut app, "Esc Esc Esc");
            for letter in app.marks().by_letter().iter().map(|it| it.letter).collect::<Vec<_>>() {
                keys(&mut app, &format!("' {letter} D Esc"));
            }
            let go_to = |app: &mut App, number: usize| {
                let digits: Vec<String> = number.to_string().chars().map(String::from).collect();
                keys(app, &format!(": # {} Enter", digits.join(" ")));
            };
            go_to(&mut app, cuts[0]);
            keys(&mut app, "M Enter");
            go_to(&mut app, cuts[1]);
            keys(&mut app, "d");
            if cuts[0] == cuts[1] {
                continue;
            }
            while comparison(&app).rows().is_none() {
                let due = app.poll_timeout().unwrap();
                app.handle_timeout(due);
            }
            let rows = comparison(&app).rows().unwrap().iter();
            let shown: Vec<Value> = rows.map(|it| row(&it.difference)).collect();
            let output = Command::new(env!("CARGO_BIN_EXE_descan"))
                .args(["diff", "a.log", "b.log", "--json"])
                .current_dir(folder.path())
                .env("XDG_CONFIG_HOME", folder.path().join("config"))
                .output()
                .unwrap();
            let report: Value = serde_json::from_slice(&output.stdout)
                .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)));
            let rows = report["differences"].as_array().unwrap().iter();
            let printed: Vec<Value> = rows
                .map(|it| {
                    let detail = it["detail"].as_str().unwrap_or_default();
                    json!([
                        it["kind"],
                        detail,
                        it["address"],
                        it["name"],
                        it["before"],
                        it["after"]
                    ])
                })
                .collect();
            assert_eq!(shown, printed, "seed {seed}, {cuts:?}");
            differences += shown.len();
        }
    }
    assert!(differences > 20, "{differences}");
}
