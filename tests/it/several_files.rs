//! Two buses, each with its own des.json, in one program: what is edited, undone, saved and compared is
//! that of the file of its bus.

use crate::common::harness::text_of;
use descan::app::{App, AppOptions, Effect, FileIndex, FileReading, SaveOutcome, Scope};
use descan::diagnostic::Diagnostic;
use descan::discovery::Config;
use descan::document::Document;
use descan::finding::FindingKind;
use descan::frame::BusIndex;
use descan::keymap::Key;
use descan::sim::{Scenario, Sim, SimStation};
use descan::status::{BusStatus, Link};
use descan::theme::Theme;
use descan::time::{Duration, Instant};
use descan::ui;
use ratatui::backend::TestBackend;
use ratatui::{Frame, Terminal};

const NORTH: &str = r#"{ "devices": [
  { "name": "FEED", "address": 10, "static": true },
  { "name": "SENS", "address": 12, "static": true }
] }"#;
const SOUTH: &str = r#"{ "devices": [
  { "name": "IMU", "address": 20, "static": true },
  { "name": "LAMP", "address": 90, "static": true }
] }"#;
const FILES: [FileIndex; 2] = [FileIndex(0), FileIndex(1)];

/// The boiler on the bus `north` and the drone on the bus `south`, each with its file.
struct TwoFiles {
    app: App,
    sims: [(Sim, SimStation); 2],
    disk: [Option<Vec<u8>>; 2],
    /// Saves of this file fail.
    full: Option<FileIndex>,
    effects: Vec<Effect>,
}

impl TwoFiles {
    fn new() -> Self {
        Self::with_files(["/site/north/des.json", "/site/south/des.json"])
    }

    fn with_files(paths: [&str; 2]) -> Self {
        let scenarios = ["boiler", "drone"].map(|name| Scenario::builtin(name).unwrap());
        let buses = ["north", "south"].map(|name| (name.to_owned(), Config::default()));
        let options = AppOptions {
            buses: buses.to_vec(),
            file_path: Some(paths[0].into()),
            own_file_paths: vec![None, Some(paths[1].into())],
            capture_room: Some(1 << 20),
            ..AppOptions::default()
        };
        let mut app = App::new(Instant::ZERO, options);
        let sims = [0, 1].map(|at: u8| {
            let scenario = &scenarios[usize::from(at)];
            let bitrate = Some(scenario.bitrate);
            let status = BusStatus { link: Link::Up, bitrate, ..BusStatus::default() };
            app.handle_bus(Instant::ZERO, BusIndex(at), status);
            let mut sim = Sim::new(scenario, u64::from(at) + 1);
            let station = sim.attach();
            (sim, station)
        });
        let disk = [NORTH, SOUTH].map(|text| Some(text.as_bytes().to_vec()));
        let mut files = Self { app, sims, disk, full: None, effects: Vec::new() };
        files.app.handle_resize(120, 40);
        for file in FILES {
            files.read(file);
        }
        files
    }

    fn read(&mut self, file: FileIndex) {
        let content = FileReading::Content(self.disk[usize::from(file.0)].clone());
        self.app.handle_file(self.app.now(), file, content);
        self.drain();
    }

    /// Another program writes a file.
    fn write(&mut self, file: FileIndex, text: &str) -> &mut Self {
        self.disk[usize::from(file.0)] = Some(text.as_bytes().to_vec());
        self.read(file);
        self
    }

    fn until(&mut self, seconds: u64) -> &mut Self {
        while self.app.now() < Instant::ZERO + Duration::from_secs(seconds) {
            let now = self.app.now() + Duration::from_millis(1);
            for (index, (sim, station)) in self.sims.iter_mut().enumerate() {
                sim.advance(now);
                while let Some(frame) = sim.poll_frame(*station) {
                    self.app.handle_frames(now, &[frame.with_bus(BusIndex(index as u8))]);
                }
            }
            self.app.handle_timeout(now);
            while let Some(frame) = self.app.poll_transmit(now) {
                let (sim, station) = &mut self.sims[usize::from(frame.bus.0)];
                sim.transmit(*station, frame);
            }
        }
        self.app.renew_rows();
        self.drain();
        self
    }

    fn drain(&mut self) {
        while let Some(effect) = self.app.poll_effect() {
            if let Effect::Save { file, expected, content } = &effect {
                let outcome = self.save(*file, expected.as_ref(), content);
                self.app.handle_saved(self.app.now(), *file, outcome);
            }
            self.effects.push(effect);
        }
    }

    fn save(
        &mut self,
        file: FileIndex,
        expected: Option<&Document>,
        content: &Document,
    ) -> SaveOutcome {
        let disk = &mut self.disk[usize::from(file.0)];
        if self.full == Some(file) {
            SaveOutcome::Failed(Diagnostic::new("no space left on the disk"))
        } else if expected.map(Document::source) == disk.as_deref() {
            *disk = Some(content.source().to_vec());
            SaveOutcome::Saved
        } else {
            SaveOutcome::Changed(FileReading::Content(disk.clone()))
        }
    }

    fn keys(&mut self, keys: &str) -> &mut Self {
        for key in keys.split(' ') {
            self.app.handle_key(self.app.now(), Key::parse(key).unwrap());
            self.drain();
        }
        self
    }

    /// Returns true if there is a row with this name.
    fn lists(&self, name: &str) -> bool {
        let mut names = self.app.rows().iter().filter_map(|row| row.name.as_ref());
        names.any(|row| row.to_string() == name)
    }

    /// Selects the row of the device or entry with this name.
    fn select(&mut self, name: &str) -> &mut Self {
        self.keys("1 Home");
        let is_it = |files: &Self| {
            let row = files.app.selected_row().and_then(|row| row.name.clone());
            row.is_some_and(|row| row.to_string() == name)
        };
        for _ in 0..self.app.rows().len() {
            if is_it(self) {
                break;
            }
            self.keys("Down");
        }
        assert!(is_it(self), "{name}: {}", self.screen());
        self
    }

    /// Types an address into the selected row.
    fn pin(&mut self, name: &str, address: u8) -> &mut Self {
        let digits: Vec<String> = address.to_string().chars().map(String::from).collect();
        self.select(name).keys("e Ctrl-u").keys(&digits.join(" ")).keys("Enter")
    }

    fn text(&self, file: FileIndex) -> &str {
        std::str::from_utf8(self.disk[usize::from(file.0)].as_ref().unwrap()).unwrap()
    }

    fn screen(&self) -> String {
        self.screen_of(120, 40)
    }

    fn screen_of(&self, columns: u16, rows: u16) -> String {
        let mut terminal = Terminal::new(TestBackend::new(columns, rows)).unwrap();
        let theme = Theme::built_in("dark").unwrap();
        let draw = |frame: &mut Frame| {
            ui::draw(&self.app, &theme, frame);
        };
        terminal.draw(draw).unwrap();
        text_of(terminal.backend().buffer())
    }
}

#[test]
fn device_is_compared_with_the_file_of_its_bus() {
    let mut files = TwoFiles::new();
    // The names of each file are those of the other bus, too, which do not count.
    files.write(FILES[1], r#"[ { "name": "FEED", "address": 10, "static": true } ]"#).until(20);
    let found = files.app.compare(files.app.now(), Scope::Check);
    let kinds = |kind| found.iter().filter(move |it| it.key.kind == kind);
    let missing: Vec<_> = kinds(FindingKind::Missing).map(|it| it.key.bus).collect();
    assert_eq!(missing, [Some(BusIndex(1))], "FEED is on the north bus");
    let screen = files.screen();
    assert!(screen.contains("2 files ✓ 3 entries"), "{screen}");
    files.keys("4");
    let screen = files.screen();
    assert!(screen.contains("listed in south/des.json"), "{screen}");
}

#[test]
fn edit_is_saved_in_the_file_of_its_bus() {
    let mut files = TwoFiles::new();
    files.until(20).pin("FEED", 40).pin("LAMP", 91);
    assert_eq!(files.text(FILES[0]), NORTH.replace("10", "40"));
    assert_eq!(files.text(FILES[1]), SOUTH.replace("90", "91"));
    let screen = files.screen();
    assert!(screen.contains("south/des.json: address of the entry LAMP: 90 → 91"), "{screen}");
    files.select("LAMP").keys("R Ctrl-u B u l b Enter");
    assert!(files.text(FILES[1]).contains("Bulb"), "{}", files.text(FILES[1]));
    files.select("Bulb").keys("D y");
    assert!(!files.text(FILES[1]).contains("Bulb"), "{}", files.text(FILES[1]));
    assert_eq!(files.text(FILES[0]), NORTH.replace("10", "40"));
}

#[test]
fn edits_are_undone_in_their_order_across_files() {
    let mut files = TwoFiles::new();
    files.until(20).pin("FEED", 40).pin("LAMP", 91).pin("FEED", 41);
    files.keys("u");
    assert!(files.text(FILES[0]).contains("40"), "the last edit is undone first");
    assert!(files.text(FILES[1]).contains("91"));
    files.keys("u");
    assert_eq!(files.text(FILES[1]), SOUTH, "then the one before, of the other file");
    assert!(files.text(FILES[0]).contains("40"));
    files.keys("Ctrl-r");
    assert!(files.text(FILES[1]).contains("91"), "the edit undone last is redone first");
    assert!(files.text(FILES[0]).contains("40"));
    files.keys("u u");
    assert_eq!([files.text(FILES[0]), files.text(FILES[1])], [NORTH, SOUTH]);
    // A new edit ends what can be redone, also of the other file.
    files.pin("LAMP", 93).keys("Ctrl-r");
    assert_eq!(files.text(FILES[0]), NORTH);
    assert!(files.screen().contains("nothing to redo"), "{}", files.screen());
}

#[test]
fn conflict_names_its_file_and_leaves_the_other_alone() {
    let mut files = TwoFiles::new();
    files.until(20);
    files.full = Some(FILES[1]);
    files.pin("LAMP", 91).pin("FEED", 40);
    assert_eq!(files.text(FILES[0]), NORTH.replace("10", "40"), "the other file is saved");
    let screen = files.screen();
    assert!(screen.contains("south/des.json ✗ not saved"), "{screen}");
    files.full = None;
    let theirs = SOUTH.replace("90", "92");
    files.write(FILES[1], &theirs);
    let screen = files.screen();
    assert!(screen.contains("changed the same value in south/des.json"), "{screen}");
    files.until(22).keys("t");
    assert_eq!(files.text(FILES[1]), theirs);
    assert_eq!(files.app.unsaved_edits(), 0);
    assert_eq!(files.text(FILES[0]), NORTH.replace("10", "40"));
}

#[test]
fn conflicts_of_two_files_are_decided_one_after_the_other() {
    let mut files = TwoFiles::new();
    files.until(20);
    for (file, name) in [(0, "FEED"), (1, "LAMP")] {
        files.full = Some(FILES[file]);
        files.pin(name, 60);
    }
    files.full = None;
    files.write(FILES[0], &NORTH.replace("10", "61"));
    files.keys("Esc");
    files.write(FILES[1], &SOUTH.replace("90", "62"));
    assert!(files.screen().contains("same value in north/des.json"), "{}", files.screen());
    files.until(22).keys("o");
    assert!(files.screen().contains("same value in south/des.json"), "{}", files.screen());
    files.keys("t");
    assert_eq!(files.text(FILES[0]), NORTH.replace("10", "60"));
    assert_eq!(files.text(FILES[1]), SOUTH.replace("90", "62"));
}

#[test]
fn broken_file_is_named_and_the_other_can_be_edited() {
    let mut files = TwoFiles::new();
    files.until(20).write(FILES[1], "[ {");
    let screen = files.screen();
    assert!(screen.contains("south/des.json ✗"), "{screen}");
    files.pin("FEED", 40);
    assert_eq!(files.text(FILES[0]), NORTH.replace("10", "40"));
    files.select("LAMP").keys("e");
    let screen = files.screen();
    assert!(screen.contains("south/des.json: file has errors"), "{screen}");
    assert!(files.app.prompt().is_none());
    files.until(22).keys("4");
    assert!(files.screen().contains("✗ south/des.json: "), "{}", files.screen());
}

#[test]
fn devices_are_added_to_the_files_of_their_buses() {
    let mut files = TwoFiles::new();
    files.until(20).keys("A");
    let names = |text: &str| {
        let document = Document::parse(text.as_bytes()).unwrap();
        document.entries().iter().map(|it| it.name_text.clone()).collect::<Vec<_>>()
    };
    let on = |files: &TwoFiles, bus: u8| {
        let devices = files.app.bus(BusIndex(bus)).unwrap().devices().iter();
        devices.filter_map(|it| it.name.as_ref().map(ToString::to_string)).collect::<Vec<_>>()
    };
    for (bus, file) in [(0, FILES[0]), (1, FILES[1])] {
        let listed = names(files.text(file));
        for name in on(&files, bus) {
            assert!(listed.contains(&name), "{name} in {listed:?}");
        }
        assert!(!files.text(file).contains("\"bus\""), "{}", files.text(file));
    }
    assert!(!names(files.text(FILES[0])).contains(&"IMU".to_owned()));
}

#[test]
fn new_entry_is_in_the_file_of_the_selected_row() {
    let mut files = TwoFiles::new();
    files.until(20).select("LAMP").keys("n");
    assert!(files.screen().contains("new entry (south/des.json)"), "{}", files.screen());
    files.keys("F A N Space 4 4 Enter");
    assert!(files.text(FILES[1]).contains("FAN"), "{}", files.text(FILES[1]));
    assert_eq!(files.text(FILES[0]), NORTH);
}

#[test]
fn past_moment_has_what_the_files_were() {
    let mut files = TwoFiles::new();
    files.until(20).keys("Space").write(FILES[1], &SOUTH.replace("LAMP", "BULB"));
    assert_eq!([files.lists("LAMP"), files.lists("BULB")], [true, false]);
    files.keys("Space");
    assert_eq!([files.lists("LAMP"), files.lists("BULB")], [false, true]);
}

#[test]
fn unsaved_edits_of_each_file_are_at_risk() {
    let mut files = TwoFiles::new();
    files.until(20);
    for (file, name) in [(0, "FEED"), (1, "LAMP")] {
        files.full = Some(FILES[file]);
        files.pin(name, 60);
    }
    let at_risk: Vec<_> =
        files.app.edits_at_risk().into_iter().map(|(file, edits, _)| (file, edits)).collect();
    assert_eq!(at_risk, [(FILES[0], 1), (FILES[1], 1)]);
    files.keys("q");
    let screen = files.screen();
    let question = "edits are not saved: north/des.json, south/des.json. Quit anyway?";
    assert!(screen.contains(question), "{screen}");
    files.keys("n").select("FEED").keys("W Enter");
    let Some(Effect::WriteFile { path, bytes }) = files.effects.last().cloned() else {
        panic!("{:?}", files.effects.last())
    };
    assert_eq!(String::from_utf8(bytes).unwrap(), NORTH.replace("10", "60"));
    files.app.handle_written(files.app.now(), &path, Ok(()));
    let at_risk = files.app.edits_at_risk();
    assert_eq!(at_risk.iter().map(|(file, ..)| *file).collect::<Vec<_>>(), [FILES[1]]);
    // The next copy is of the file that has none, whichever row is selected.
    files.keys("q");
    assert!(files.screen().contains("edits are not saved: south/des.json. Quit"));
    files.keys("n W");
    assert!(files.screen().contains("save a copy as (south/des.json)"), "{}", files.screen());
    files.keys("Enter");
    let Some(Effect::WriteFile { path, bytes }) = files.effects.last().cloned() else { panic!() };
    assert_eq!(String::from_utf8(bytes).unwrap(), SOUTH.replace("90", "60"));
    files.app.handle_written(files.app.now(), &path, Ok(()));
    files.keys("q");
    let screen = files.screen();
    assert!(screen.contains("edits of 2 files are saved only in copies. Quit anyway?"), "{screen}");
}

/// Tests that the selection stays on the bus of its row where both files have the same names.
#[test]
fn selection_stays_on_its_bus_after_an_edit() {
    const BOTH: &str = r#"[ { "name": "AAA", "address": 70 }, { "name": "BBB", "address": 71 },
        { "name": "CCC", "address": 72 } ]"#;
    let mut files = TwoFiles::new();
    files.write(FILES[0], BOTH).write(FILES[1], BOTH).until(20).keys("1 End Up");
    let selected = |files: &TwoFiles| {
        let row = files.app.selected_row().unwrap();
        (row.bus, row.name.as_ref().unwrap().to_string())
    };
    let south = Some(BusIndex(1));
    assert_eq!(selected(&files), (south, "BBB".to_owned()));
    files.keys("e Ctrl-u 3 3 Enter");
    assert_eq!(selected(&files), (south, "BBB".to_owned()));
    assert_eq!(files.text(FILES[0]), BOTH);
    let moved = files.text(FILES[1]).replace("33", "34");
    files.write(FILES[1], &moved);
    assert_eq!(selected(&files), (south, "BBB".to_owned()));
    files.keys("D y");
    assert_eq!(selected(&files).0, south);
    assert_eq!(files.text(FILES[0]), BOTH);
}

#[test]
fn equal_events_of_two_files_have_lines_of_their_own() {
    let mut files = TwoFiles::new();
    files.until(20).write(FILES[0], "[ {").write(FILES[1], "[ {");
    files.until(21).keys("3");
    let screen = files.screen();
    for name in ["north/des.json", "south/des.json"] {
        let is_it = |line: &str| {
            line.contains(name) && line.contains("ends inside an object") && line.contains(" ! ")
        };
        assert!(screen.lines().any(is_it), "{name}: {screen}");
    }
    assert!(screen.contains("and 1 more"), "{screen}");
}

#[test]
fn names_cut_at_small_widths_keep_what_differs() {
    let mut files = TwoFiles::with_files([
        "/production-line-north/x/des.json",
        "/production-line-south/x/des.json",
    ]);
    files.until(3).write(FILES[1], "[ {");
    files.app.handle_resize(80, 24);
    let screen = files.screen_of(80, 24);
    let status = screen.lines().nth(2).unwrap();
    assert!(status.contains("south") && !status.contains("north"), "{screen}");
    assert!(screen.contains("line-south "), "{screen}");
}

#[test]
fn past_moment_says_that_a_file_was_broken_or_missing() {
    let mut files = TwoFiles::new();
    files.until(20).write(FILES[1], "[ {").keys("Space");
    let broken = "south/des.json ✗ line 1, column 4";
    assert!(files.screen().contains(broken), "{}", files.screen());
    files.write(FILES[1], SOUTH);
    assert!(files.screen().contains(broken), "it was so then: {}", files.screen());
    files.keys("Space");
    assert!(files.screen().contains("2 files ✓ 4 entries"), "{}", files.screen());
    files.disk[1] = None;
    files.read(FILES[1]);
    files.keys("Space").write(FILES[1], SOUTH);
    assert!(files.screen().contains("south/des.json not found"), "{}", files.screen());
}

#[test]
fn file_that_is_not_there_is_named_beside_the_one_that_is() {
    let mut files = TwoFiles::new();
    files.until(20);
    files.disk[0] = None;
    files.read(FILES[0]);
    let expected = "south/des.json ✓ 2 entries  north/des.json not found";
    assert!(files.screen().contains(expected), "{}", files.screen());
    files.write(FILES[1], "[ {");
    let screen = files.screen();
    assert!(screen.contains("south/des.json ✗ line 1, column 4"), "{screen}");
    assert!(screen.contains("north/des.json not found"), "{screen}");
    files.write(FILES[1], SOUTH).disk[1] = None;
    files.read(FILES[1]);
    assert!(files.screen().contains("2 files not found"), "{}", files.screen());
}

#[test]
fn devices_not_added_are_reported_beside_those_that_are() {
    let mut files = TwoFiles::new();
    files.until(20).write(FILES[1], "[ {").keys("A");
    let message = files.app.message().unwrap().text.clone();
    assert!(message.contains("not added: file has errors, fix it first"), "{message}");
    assert!(message.contains("; north/des.json: 7 new entries"), "{message}");
}

#[test]
fn entry_for_a_bus_with_another_file_is_a_mistake() {
    let mut files = TwoFiles::new();
    let text = r#"[ { "name": "IMU", "bus": "south" }, { "name": "X", "bus": "west" } ]"#;
    files.write(FILES[0], text).until(20);
    let mistakes = files.app.file_mistakes(FILES[0]);
    let texts: Vec<&str> = mistakes.iter().map(|it| it.message.as_str()).collect();
    assert_eq!(texts, ["`bus` is south, whose file is south/des.json; move the entry there"]);
    assert!(files.app.file_mistakes(FILES[1]).is_empty());
}

/// Tests that equal mistakes of two files are two findings, each with its file.
#[test]
fn equal_mistakes_of_two_files_are_told_apart() {
    let mut files = TwoFiles::new();
    let wrong = r#"[ { "name": "A", "address": 300 } ]"#;
    files.write(FILES[0], wrong).write(FILES[1], wrong).until(3);
    let found = files.app.compare(files.app.now(), Scope::Check);
    let shapes = found.iter().filter(|it| it.key.kind == FindingKind::FileShape);
    let texts: Vec<_> = shapes.map(|it| (it.key.bus, it.text.clone())).collect();
    assert_eq!(texts.len(), 2);
    for ((bus, text), (at, file)) in
        texts.iter().zip([(0, "north/des.json"), (1, "south/des.json")])
    {
        assert_eq!(*bus, Some(BusIndex(at)));
        assert!(text.contains(file), "{text}");
    }
    files.keys("4");
    let screen = files.screen();
    for bus in ["north", "south"] {
        let is_it = |line: &str| line.contains(bus) && line.contains("`address` is 300");
        assert_eq!(screen.lines().filter(|line| is_it(line)).count(), 1, "{screen}");
    }
}

/// Tests that the names of files are the shortest ends of their paths that differ.
#[test]
fn files_are_named_by_what_differs_in_their_paths() {
    for (paths, names) in [
        (["/site/a.json", "/site/b.json"], ["a.json", "b.json"]),
        (["/site/north/des.json", "/site/south/des.json"], ["north/des.json", "south/des.json"]),
        (["des.json", "south/des.json"], ["des.json", "south/des.json"]),
        (["/site/des.json", "/site/south/des.json"], ["des.json", "south/des.json"]),
        (["/home/me/site/des.json", "/srv/des.json"], ["site/des.json", "srv/des.json"]),
        (["/a/x/des.json", "/b/x/des.json"], ["a/x/des.json", "b/x/des.json"]),
    ] {
        let files = TwoFiles::with_files(paths);
        let shown: Vec<String> = files.app.files().map(|(_, file)| file.name()).collect();
        assert_eq!(shown, names);
    }
}

/// Tests that a bus that is opened later may bring its file.
#[test]
fn bus_opened_later_brings_its_file() {
    let mut files = TwoFiles::new();
    files.until(5);
    let now = files.app.now();
    files.app.add_bus(now, "west".to_owned(), Config::default());
    let index = BusIndex(2);
    assert_eq!(
        files.app.set_file_of_bus(index, Some("/site/south/des.json".into())),
        None,
        "it is open"
    );
    assert_eq!(files.app.file_of_bus(index), FILES[1]);
    let new = files.app.set_file_of_bus(index, Some("/site/west/des.json".into()));
    assert_eq!(new, Some(FileIndex(2)));
    let content = br#"[ { "name": "PUMP", "address": 5, "static": true } ]"#.to_vec();
    files.app.handle_file(now, FileIndex(2), FileReading::Content(Some(content)));
    files.until(6);
    assert!(files.lists("PUMP"));
    assert!(files.screen().contains("3 files ✓ 5 entries"), "{}", files.screen());
}
