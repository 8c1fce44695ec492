//! Two buses on one screen.

use super::text_snapshot;
use crate::common::harness::{Stage, text_of};
use descan::app::{App, AppOptions, FileIndex, FileReading, InputCheck, ProjectFacts};
use descan::diagnostic::Diagnostic;
use descan::discovery::Config;
use descan::finding::FindingKind;
use descan::frame::BusIndex;
use descan::keymap::Key;
use descan::project::Project;
use descan::sim::{DeviceAction, Scenario, Sim, SimStation};
use descan::status::{BusStatus, Link};
use descan::theme::Theme;
use descan::time::{Duration, Instant};
use descan::ui;
use descan::wire::node::Mode;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use std::sync::Arc;

/// Two simulated buses in one app.
pub(super) struct Pair {
    app: App,
    sims: [(Sim, SimStation); 2],
}

impl Pair {
    pub(super) fn new(scenarios: [&Scenario; 2]) -> Self {
        Self::with_project(scenarios, ProjectFacts::default())
    }

    fn with_project(scenarios: [&Scenario; 2], project: ProjectFacts) -> Self {
        let buses = ["can0", "can1"].map(|name| (name.to_owned(), Config::default()));
        let file_path = Some("des.json".into());
        let (buses, project) = (buses.to_vec(), Arc::new(project));
        let options = AppOptions { buses, file_path, project, ..AppOptions::default() };
        let mut app = App::new(Instant::ZERO, options);
        app.handle_file(Instant::ZERO, FileIndex::default(), FileReading::Content(None));
        let mut seed = 0;
        let sims = scenarios.map(|scenario| {
            let index = BusIndex(seed as u8);
            seed += 1;
            let bitrate = Some(scenario.bitrate);
            let status = BusStatus { link: Link::Up, bitrate, ..BusStatus::default() };
            app.handle_bus(Instant::ZERO, index, status);
            let mut sim = Sim::new(scenario, seed);
            let station = sim.attach();
            (sim, station)
        });
        Self { app, sims }
    }

    pub(super) fn run(&mut self, seconds: std::ops::Range<u64>) -> &mut Self {
        for millis in seconds.start * 1000 + 1..=seconds.end * 1000 {
            let now = Instant::from_micros(millis * 1000);
            for (index, (sim, station)) in self.sims.iter_mut().enumerate() {
                sim.advance(now);
                while let Some(frame) = sim.poll_frame(*station) {
                    self.app.handle_frames(now, &[frame.with_bus(BusIndex(index as u8))]);
                }
            }
            self.app.handle_timeout(now);
            self.app.renew_rows();
            while let Some(frame) = self.app.poll_transmit(now) {
                let (sim, station) = &mut self.sims[usize::from(frame.bus.0)];
                sim.transmit(*station, frame);
            }
        }
        self
    }

    pub(super) fn keys(&mut self, keys: &str) -> &mut Self {
        for key in keys.split(' ') {
            self.app.handle_key(self.app.now(), Key::parse(key).unwrap());
        }
        self
    }

    pub(super) fn screen(&mut self, width: u16, height: u16) -> String {
        self.app.handle_resize(width, height);
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        let theme = Theme::built_in("dark").unwrap();
        terminal
            .draw(|frame| {
                ui::draw(&self.app, &theme, frame);
            })
            .unwrap();
        text_of(terminal.backend().buffer())
    }
}

#[test]
fn two_buses_are_one_view() {
    let scenarios = ["boiler", "drone"].map(|name| Scenario::builtin(name).unwrap());
    let mut pair = Pair::new([&scenarios[0], &scenarios[1]]);
    text_snapshot!("two_buses", pair.run(0..20).screen(100, 30));
    text_snapshot!("two_buses_problems", pair.run(20..36).keys("4").screen(100, 30));
}

/// The built-in boiler and drone, on buses with these names.
fn named_pair(names: [&str; 2]) -> Pair {
    let scenarios = ["boiler", "drone"].map(|name| Scenario::builtin(name).unwrap());
    let mut pair = Pair::new([&scenarios[0], &scenarios[1]]);
    for (index, name) in (0..).zip(names) {
        pair.app.name_bus(BusIndex(index), name.to_owned());
    }
    pair
}

/// Tests that adapters with equal bit rates are named by the part before it.
#[test]
fn equal_adapters_have_distinct_names() {
    let mut pair = named_pair(["slcan:/dev/ttyACM0@500000", "slcan:/dev/ttyACM1@500000"]);
    pair.run(0..20);
    for (page, width) in [("1", 80), ("2", 80), ("3", 80), ("3", 120)] {
        let screen = pair.keys(page).screen(width, 40);
        assert!(screen.contains("ACM0"), "{page}: {screen}");
        let rows = screen.lines().skip(3);
        assert!(rows.clone().any(|row| row.contains("CM0 ")), "{page}: {screen}");
        assert!(rows.clone().any(|row| row.contains("CM1 ")), "{page}: {screen}");
        assert!(!rows.clone().any(|row| row.contains("…00000")), "{page}: {screen}");
    }
}

#[test]
fn lanes_of_two_buses_name_their_bus() {
    let scenarios = ["boiler", "drone"].map(|name| Scenario::builtin(name).unwrap());
    let mut pair = Pair::new([&scenarios[0], &scenarios[1]]);
    pair.run(0..20).keys("3 v");
    for (width, labels) in [
        (80, ["can0  10 FEED", "can1  10 IMU"]),
        (120, ["can0    10 FEED", "can1    10 IMU"]),
        (50, ["  10 FEED", "  10 IMU"]),
    ] {
        let screen = pair.screen(width, 40);
        let rows = screen.lines().skip(3);
        assert!(labels.iter().all(|label| rows.clone().any(|row| row.contains(label))), "{screen}");
    }
}

/// As two logs of `can0`, or two socketcand hosts, have.
#[test]
fn buses_of_one_name_have_numbers() {
    let mut pair = named_pair(["can0", "can0"]);
    pair.run(0..20);
    for (page, width) in [("1", 80), ("2", 80), ("3", 80), ("3", 120)] {
        let screen = pair.keys(page).screen(width, 40);
        let rows = screen.lines().skip(4);
        assert!(rows.clone().any(|row| row.contains("can0 ")), "{page}: {screen}");
        assert!(rows.clone().any(|row| row.contains("can0#2")), "{page}: {screen}");
    }
    let inventory = pair.app.inventory();
    let buses: Vec<&str> = inventory.buses.iter().map(|bus| bus.name.as_str()).collect();
    assert_eq!(buses, ["can0", "can0 #2"]);
}

#[test]
fn single_status_line_shows_the_failed_bus() {
    let scenarios = ["boiler", "drone"].map(|name| Scenario::builtin(name).unwrap());
    let mut pair = Pair::new([&scenarios[0], &scenarios[1]]);
    assert!(pair.run(0..20).screen(50, 12).lines().next().unwrap().contains("can0"));
    let fault = Some(Diagnostic::new("can1 unplugged").with_remedy("connect it again"));
    let status = BusStatus { link: Link::Unplugged, fault, ..BusStatus::default() };
    pair.app.handle_bus(pair.app.now(), BusIndex(1), status);
    let screen = pair.screen(50, 12);
    assert!(screen.lines().next().unwrap().contains("can1  UNPLUGGED"), "{screen}");
}

#[test]
fn redundant_device_is_one_row() {
    use descan::sim::DeviceSpec;
    let device = |name: &str, address: u8, uid: u8, service: &str| {
        let mut device = DeviceSpec::new(name).fixed(address).skips_address_resolution();
        device.uid = descan::wire::node::Uid([uid, 2, 3, 4, 5, 6]);
        device.service(service, "1.0")
    };
    let one = Scenario::new(125_000)
        .with(device("FEED", 10, 1, "AUGER"))
        .with(device("SENS", 12, 2, "TEMP"))
        .with(device("PUMP", 20, 3, "FLOW"));
    // FEED has another address there, SENS other services, and PUMP is a twin.
    let other = Scenario::new(500_000)
        .with(device("FEED", 11, 1, "AUGER"))
        .with(device("SENS", 12, 2, "LOG"))
        .with(device("PUMP", 20, 4, "FLOW"))
        .at(Duration::from_secs(8), "FEED", DeviceAction::PowerOff)
        .at(Duration::from_secs(20), "FEED", DeviceAction::PowerOn);
    let mut pair = Pair::new([&one, &other]);
    let screen = pair.run(0..6).screen(100, 24);
    text_snapshot!("redundant_100x24", screen);
    assert!(screen.contains("● 5 present"), "{screen}");
    text_snapshot!("redundant_80x24", pair.screen(80, 24));
    // The other address and the other bus find it too.
    assert!(pair.keys("/ 1 1 Enter").screen(100, 24).contains("FEED"));
    let screen = pair.keys("Esc / b u s : c a n 1 Enter").screen(100, 24);
    assert!(screen.contains("FEED"), "{screen}");
    text_snapshot!("two_networks", pair.keys("Esc j").screen(100, 24));

    // Each bus has its own address to pin, and can be added to the file.
    let screen = pair.keys("Home e").screen(100, 24);
    assert!(screen.contains("static address on can0 (Tab: next): "), "{screen}");
    let screen = pair.keys("Tab").screen(100, 24);
    assert!(screen.contains("static address on can1 (Tab: next): "), "{screen}");
    pair.keys("Esc a");
    let entries = pair.app.file().document().entries();
    let taken: Vec<_> = entries.iter().map(|it| (it.bus.as_deref(), it.address)).collect();
    assert_eq!(taken, [(Some("can0"), Some(10)), (Some("can1"), Some(11))]);
    pair.keys("u");

    let screen = pair.run(6..16).keys("Home").screen(100, 24);
    assert!(screen.contains("partial"), "{screen}");
    assert!(screen.contains("@11 lost"), "{screen}");
    assert!(screen.contains("● 5 present"), "one of two is here: {screen}");
    text_snapshot!("redundant_timeline", pair.run(16..24).keys("3").screen(100, 24));
}

/// Tests that an entry with neither twin's address is kept: either twin may be meant.
#[test]
fn entry_edited_while_a_twin_appears_is_kept() {
    let file = r#"[{"name":"SENS","address":15,"static":true}]"#;
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(file));
    stage.until(6.0).keys("/").text("SENS").keys("Enter Home e").text("47");
    let pins = "Enter pins it to 47 in the file; the device stays at 12";
    assert_eq!(stage.app.prompt_check(), Some(InputCheck::Accepted(pins.to_owned())));
    stage.until(30.0);
    let told = "entry may belong to another device now; Enter adds it again";
    assert_eq!(
        stage.app.prompt_check(),
        Some(InputCheck::Warning(told.to_owned())),
        "{}",
        stage.screen()
    );
}

#[test]
fn scheme_is_dropped_before_the_name_is_cut() {
    let mut pair = named_pair(["sim:boiler", "sim:drone"]);
    pair.run(0..36);
    for (page, width) in [("1", 80), ("2", 80), ("3", 80), ("4", 80), ("1", 60), ("4", 40)] {
        let screen = pair.keys(page).screen(width, 40);
        let rows = screen.lines().skip(3);
        for name in ["boiler ", "drone "] {
            assert!(rows.clone().any(|row| row.contains(name)), "{page}: {screen}");
        }
        assert!(!rows.clone().any(|row| row.contains("…oil")), "{page}: {screen}");
    }
}

#[test]
fn names_of_scenario_files_are_told_apart() {
    let mut pair = named_pair(["sim:main.toml", "sim:spare.toml"]);
    pair.run(0..36);
    for (page, width) in [("1", 80), ("2", 80), ("3", 80), ("1", 60)] {
        let screen = pair.keys(page).screen(width, 40);
        let rows = screen.lines().skip(3);
        for name in ["main ", "spare "] {
            assert!(rows.clone().any(|row| row.contains(name)), "{page}: {screen}");
        }
    }
}

/// The boiler of the example project: the water sensor of its first bus is away from 20 to 40 s; that of
/// the second may stop working at 5 s.
fn example_project(spare_stops_working: bool) -> Pair {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/project");
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    let [main, mut spare] =
        ["main.toml", "spare.toml"].map(|name| Scenario::parse(&read(name)).unwrap());
    if spare_stops_working {
        spare = spare.at(Duration::from_secs(5), "SENS", DeviceAction::Mode(Mode::Cfg));
    }
    let project = Project::parse(&read("descan.toml"), &folder).unwrap();
    let mut facts = project.facts(&[]);
    for device in facts.tasks.iter_mut().flat_map(|task| &mut task.devices) {
        let name = if device.bus == "sim:main.toml" { "can0" } else { "can1" };
        name.clone_into(&mut device.bus);
    }
    facts.bitrates = [("can0".to_owned(), 125_000), ("can1".to_owned(), 250_000)].into();
    Pair::with_project([&main, &spare], facts)
}

fn findings(pair: &Pair, kind: FindingKind) -> Vec<(String, Instant)> {
    let all = pair.app.findings().filter(|finding| finding.key.kind == kind);
    all.map(|finding| (finding.text.clone(), finding.first)).collect()
}

#[test]
fn device_that_stands_in_for_another_is_alone_until_it_returns() {
    let mut pair = example_project(false);
    pair.run(0..18);
    assert_eq!(findings(&pair, FindingKind::RedundancyLost), []);
    pair.run(18..23);
    assert_eq!(findings(&pair, FindingKind::RedundancyLost), [], "late heartbeats fail no task");
    pair.run(23..35);
    let [(text, since)] = &findings(&pair, FindingKind::RedundancyLost)[..] else { panic!() };
    assert_eq!(
        text,
        "water temperature: SENS at 12 on can0 is lost; SENS at 12 on can1 does it alone."
    );
    let seconds = since.since(Instant::ZERO).as_secs_f64();
    assert!((20.0..26.5).contains(&seconds), "{seconds}");
    pair.screen(150, 50);
    let screen = pair.keys("down down").screen(150, 50);
    assert!(screen.contains("water temperature"), "{screen}");
    assert!(screen.contains("! alone since"), "{screen}");
    assert!(screen.contains("SENS at 12 on can0 is lost"), "{screen}");
    pair.run(35..50);
    assert_eq!(findings(&pair, FindingKind::RedundancyLost), []);
    let screen = pair.screen(150, 50);
    assert!(screen.contains("SENS at 12 on can0 works"), "{screen}");
}

#[test]
fn task_without_a_working_device_has_failed() {
    let mut pair = example_project(true);
    pair.run(0..10);
    let [(text, _)] = &findings(&pair, FindingKind::RedundancyLost)[..] else { panic!() };
    assert!(text.contains("SENS at 12 on can1 is in CFG; SENS at 12 on can0 does"), "{text}");
    pair.run(10..35);
    assert_eq!(findings(&pair, FindingKind::RedundancyLost), []);
    let [(text, _)] = &findings(&pair, FindingKind::TaskFailed)[..] else { panic!() };
    assert!(text.contains("is lost") && text.contains("is in CFG"), "{text}");
}

#[test]
fn bus_with_another_bit_rate_than_the_project_is_a_finding() {
    let mut pair = example_project(false);
    pair.run(0..3);
    let found = findings(&pair, FindingKind::BitrateDiffers);
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].0, "can1 has 125 kbit/s; the project says 250 kbit/s.");
}

#[test]
fn rows_of_two_buses_have_a_mark_where_bytes_are_left_out() {
    let boiler = Scenario::builtin("boiler").unwrap();
    let mut pair = Pair::new([&boiler, &boiler]);
    let screen = pair.run(0..12).keys("2 v").screen(80, 24);
    let rows: Vec<&str> = screen.lines().filter(|line| line.contains("can0   ")).collect();
    let bytes_before_mark = |line: &&str| {
        let words = line.strip_suffix('…').map(|line| line.split_whitespace().rev());
        let is_byte = |word: &&str| word.len() == 2 && u8::from_str_radix(word, 16).is_ok();
        words.map(|words| words.take_while(is_byte).count())
    };
    let marked: Vec<usize> = rows.iter().filter_map(bytes_before_mark).collect();
    assert!(!marked.is_empty() && marked.len() < rows.len(), "{screen}");
    assert!(marked.iter().all(|bytes| *bytes >= 4), "{screen}");
}
