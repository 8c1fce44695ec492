//! The page Devices.

use super::{one_line, snapshot};
use crate::common::harness::{BOILER, Stage};
use descan::discovery::Config;
use descan::sim::Scenario;
use descan::wire::id::Address;

#[test]
fn devices_page_at_three_sizes_matches_snapshot() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    snapshot!("devices_80x24", stage);
    snapshot!("devices_120x40", stage.size(120, 40));
    snapshot!("devices_40x10", stage.size(40, 10));
    snapshot!("devices_40x10_details", stage.size(40, 10).keys("j Enter"));
}

#[test]
fn first_second_matches_snapshot() {
    let mut stage = Stage::boiler();
    snapshot!("start_80x24", stage);
    snapshot!("first_second_80x24", stage.until(1.0));
}

#[test]
fn conflict_and_missing_details_match_snapshot() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(100, 30);
    snapshot!("clash", stage.keys("j j j"));
    snapshot!("missing", stage.keys("j j j j"));
}

#[test]
fn missing_device_has_no_last_seen_time() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("4 /").text("missing").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("kind    missing") && !screen.contains("first 12:"), "{screen}");
}

#[test]
fn selection_follows_its_device() {
    let mut stage = Stage::boiler();
    stage.until(3.0);
    let select = |stage: &mut Stage, name: &str| {
        for _ in 0..20 {
            let row = stage.app.selected_row().unwrap();
            if row.name.as_ref().is_some_and(|it| it.to_string() == name) {
                return;
            }
            stage.keys("j");
        }
        panic!("no {name}\n{}", stage.screen());
    };
    select(&mut stage, "PSU");
    stage.until(22.0);
    assert_eq!(stage.app.selected_row().unwrap().name.as_ref().unwrap().to_string(), "PSU");
    // A listed device appears: the row of the entry becomes the row of the device.
    let mut stage = Stage::boiler();
    stage.until(3.0);
    select(&mut stage, "ACT");
    assert!(stage.app.selected_device().is_none());
    stage.until(22.0);
    assert!(stage.app.selected_device().unwrap().is_named(b"ACT"));
}

#[test]
fn own_address_in_use_is_named_as_the_cause() {
    let address = Address::new(12);
    let config = Config { seed: 7, address, ..Config::default() };
    let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), Some(BOILER), config);
    stage.until(8.0);
    snapshot!("address_in_use_80x24", stage);
    snapshot!("address_in_use_40x10", stage.size(40, 10));
    let lines: Vec<_> = stage.app.timeline().entries().map(|line| line.text.as_str()).collect();
    let ours: Vec<_> = lines.iter().filter(|line| line.contains("uses address")).collect();
    assert_eq!(ours, [&"another node uses address 12: requests paused until it is free"]);
}

#[test]
fn sort_key_cycles_through_the_columns() {
    let file = r#"{"devices": [
  {"name": "FEED", "services": [{"name": "OTHER"}]},
  {"name": "SENS", "address": 12, "static": true},
  {"name": "DISP", "address": 21, "static": true},
  {"name": "IGNITER", "address": 17, "static": true}
]}
"#;
    let mut stage =
        Stage::with(&Scenario::builtin("boiler").unwrap(), Some(file), Config::default());
    stage.until(36.0).size(200, 50);
    let first = |stage: &Stage, count: usize| -> Vec<String> {
        let rows = stage.app.rows().iter().take(count);
        rows.map(|row| row.name.as_ref().unwrap().to_string()).collect()
    };
    for (sorted, expected) in [
        ("by name", ["ACT", "ACT", "DIN"]),
        ("by UID", ["NEW", "FEED", "SENS"]),
        ("by severity", ["ACT", "ACT", "IGNITER"]),
        ("by mode", ["NEW", "FEED", "SENS"]),
        ("shortest heartbeat period first", ["FEED", "SENS", "SENS"]),
        ("largest jitter first", ["DIN", "DISP", "GSM-MODEM"]),
        ("most missed heartbeats first", ["FEED", "SENS", "SENS"]),
        ("changed versions first", ["FEED", "SENS", "SENS"]),
        ("by difference from the file", ["IGNITER", "FEED", "DISP"]),
        ("newest first", ["NEW", "GSM-MODEM", "DIN"]),
        ("most services first", ["FEED", "SENS", "DISP"]),
        ("by address", ["FEED", "SENS", "SENS"]),
    ] {
        let screen = stage.keys("s").screen();
        assert!(screen.contains(&format!("sorted {sorted}")), "{screen}");
        assert_eq!(first(&stage, 3), expected, "{sorted}\n{screen}");
        let row = usize::from(stage.app.screen().header.y);
        let header = screen.lines().nth(row).unwrap();
        assert_eq!(header.contains('↓'), sorted != "by address", "{screen}");
    }
    let screen = stage.keys("S s").screen();
    assert!(screen.contains("sorted by name, reversed"), "{screen}");
}

#[test]
fn order_reversed_on_a_page_leaves_that_of_the_others() {
    let mut stage = Stage::boiler();
    stage.until(8.0).size(120, 30);
    let devices =
        |stage: &Stage| -> Vec<_> { stage.app.rows().iter().map(|row| row.key.clone()).collect() };
    let before = devices(&stage);
    let identifiers = |stage: &mut Stage| -> Vec<String> {
        let screen = stage.screen();
        screen.lines().filter(|line| line.contains("→all")).map(one_line).collect()
    };
    let ascending = identifiers(stage.keys("2 v"));
    assert!(stage.keys("S").screen().contains("order reversed"));
    let mut reversed = identifiers(&mut stage);
    assert_ne!(reversed, ascending);
    reversed.reverse();
    assert_eq!(devices(stage.keys("1")), before, "Devices keeps its order");
    let mut expected = before;
    expected.reverse();
    assert_eq!(devices(stage.keys("S")), expected);
    assert!(stage.keys("2 S").screen().contains("order as before"));
}

#[test]
fn frozen_rows_are_sorted_by_key() {
    let mut stage = Stage::boiler();
    stage.until(20.0).keys("Space").until(24.0).keys("s");
    let mut names: Vec<String> = Vec::new();
    for row in stage.app.rows() {
        names.extend(row.name.as_ref().map(ToString::to_string));
    }
    assert!(names.is_sorted(), "{names:?}");
}

#[test]
fn control_characters_in_names_are_escaped() {
    use descan::sim::DeviceSpec;
    let mut scenario = Scenario::new(500_000);
    let names: [&[u8]; 4] = [
        b"\x1b]0;pwned\x07",
        b"\x1b[2J\x9b31m",
        "\u{202e}\u{200b}\u{2028}\u{9b}".as_bytes(),
        b"a\r\nb\tc",
    ];
    for (at, name) in names.into_iter().enumerate() {
        let mut device =
            DeviceSpec::new("x").label(&format!("device {at}")).skips_address_resolution();
        device.name = name.to_vec();
        device = device.fixed(20 + at as u8);
        device.services = vec![vec![name.to_vec(), name.to_vec(), name.to_vec()]];
        scenario = scenario.with(device);
    }
    let mut stage = Stage::new(&scenario, None);
    stage.until(8.0).keys("A");
    for (columns, rows) in [(80, 24), (140, 50), (40, 10)] {
        stage.size(columns, rows);
        for keys in [
            "1",
            "j",
            "j",
            "j",
            "Enter",
            "Esc 2",
            "v",
            "v k k Enter",
            "Esc 3",
            "4",
            "Enter",
            "Enter",
            "Enter",
            "4 m",
            "1 R",
        ] {
            stage.keys(keys);
            let buffer = stage.buffer("terminal");
            for cell in buffer.content() {
                let odd = cell.symbol().chars().find(|&c| !descan::text::is_printable(c));
                assert_eq!(odd, None, "{keys} {:?}", cell.symbol());
            }
        }
        stage.keys("Esc");
    }
    snapshot!("hostile_names", stage.size(80, 24).keys("1"));
}

#[test]
fn frames_alone_do_not_redraw_the_devices_page() {
    let mut stage = Stage::new(&Scenario::with_many_devices(500_000, 20, 2), None);
    stage.until(30.0);
    stage.app.take_dirty();
    let mut draws = 0;
    for step in 1..=400 {
        stage.until(30.0 + f64::from(step) * 0.025);
        draws += u32::from(stage.app.take_dirty());
    }
    assert!(draws <= 12, "{draws} draws in ten quiet seconds");
}

/// A cell of a terminal takes any number of combining marks: one name could send megabytes.
#[test]
fn cells_have_few_combining_marks() {
    let name = format!("A{}", "\u{301}".repeat(2000));
    let file = format!(r#"[{{"name": "{name}", "address": 9}}]"#);
    let mut stage = Stage::new(&Scenario::new(125_000), Some(&file));
    stage.until(3.0);
    let buffer = stage.buffer("terminal");
    let longest = buffer.content.iter().map(|cell| cell.symbol().chars().count()).max();
    assert_eq!(longest, Some(31));
}

/// The details at the right of the list, as one line.
fn details(stage: &Stage) -> String {
    let screen = stage.screen();
    let right = screen.lines().filter_map(|line| line.split('│').nth(1));
    right.flat_map(str::split_whitespace).collect::<Vec<_>>().join(" ")
}

#[test]
fn details_of_a_board_are_its_own() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(200, 60);
    let select = |stage: &mut Stage, side: &str| {
        stage.keys("Home");
        while stage
            .app
            .selected_row()
            .and_then(|row| row.board)
            .is_none_or(|it| it.side.to_string() != side)
        {
            stage.keys("j");
        }
        details(stage)
    };
    let first = select(&mut stage, "A");
    assert!(first.contains("ACT @14A · BOILER03 CONFLICT · online since 12:00:05 "), "{first}");
    assert!(first.contains("mode WORK since 12:00:06 modes ARSLV → WORK"), "{first}");
    assert!(first.contains("services 4 now"), "{first}");
    let second = select(&mut stage, "B");
    assert!(second.contains("ACT @14B · SPARE01 CONFLICT · online since 12:00:26 "), "{second}");
    assert!(second.contains("mode WORK since 12:00:27 modes ARSLV → WORK"), "{second}");
    assert!(second.contains("services not read"), "{second}");
    assert!(second.contains("seen since 12:00:26 requests name "), "{second}");
    assert!(!second.contains("services 1") && first.contains(" services 1"), "{first} {second}");
    // As in its row, in the matrix and in the panel of the problem.
    let row = stage.screen().lines().find(|line| line.contains("14B")).unwrap().to_owned();
    assert!(!row.contains("VALVE"), "{row}");
    stage.keys("v");
    let lines = |stage: &Stage, side: &str| {
        stage.screen().lines().find(|line| line.contains(side)).unwrap().to_owned()
    };
    assert!(lines(&stage, "14A").contains(" 1.2 ") && !lines(&stage, "14B").contains(" 1.2 "));
    stage.keys("v v p");
    assert!(stage.screen().contains("│ not read: responses collide"), "{}", stage.screen());
}

#[test]
fn number_of_present_devices_is_that_of_their_rows() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    let rows = stage.app.rows().iter();
    let present = rows.filter(|row| !["missing", "lost"].contains(&row.state.word())).count();
    let boards = stage.app.rows().iter().filter(|row| row.board.is_some()).count();
    assert_eq!(boards, 2, "each board of the conflict is one");
    assert!(stage.screen().contains(&format!("● {present} present")), "{}", stage.screen());
}

/// Tests that the error of each clock is measured, shown, and marked where it is not like the others.
#[test]
fn error_of_a_clock_is_shown_and_an_outlier_marked() {
    use descan::sim::DeviceSpec;
    let mut scenario = Scenario::new(500_000);
    let errors = [0, 40, -60, 1500, -2500];
    for (at, ppm) in errors.into_iter().enumerate() {
        let mut spec = DeviceSpec::new(&format!("D{at}")).fixed(10 + at as u8);
        spec.tolerance_ppm = ppm;
        scenario = scenario.with(spec);
    }
    let mut stage = Stage::new(&scenario, None);
    stage.size(120, 40).until(8.0);
    let known = |stage: &Stage| {
        let mut devices: Vec<_> = stage.app.buses()[0].devices().iter().collect();
        devices.sort_by_key(|device| device.address);
        let errors = devices.iter().filter_map(|device| device.heartbeat.period_error());
        errors.collect::<Vec<_>>()
    };
    assert_eq!(known(&stage), [], "too early");
    stage.until(120.0);
    let known = known(&stage);
    assert_eq!(known.len(), errors.len());
    for (error, meant) in known.iter().zip(errors) {
        let apart = (error.ppm - f64::from(meant)).abs();
        assert!(apart <= error.uncertainty + 1.0 && error.uncertainty < 50.0, "{meant}: {error:?}");
    }
    let line = |stage: &Stage| {
        let screen = stage.screen();
        let line = screen.lines().find_map(|line| {
            Some(line.split_once("clock  ")?.1.split('│').next()?.trim().to_owned())
        });
        line.unwrap_or_else(|| panic!("{screen}"))
    };
    assert!(line(stage.keys("Home Down")).ends_with("ppm slow"), "{}", line(&stage));
    let slow = line(stage.keys("Down Down"));
    assert!(slow.starts_with("150") && slow.contains(" ppm slow, others "), "{slow}");
    let fast = line(stage.keys("Down"));
    assert!(fast.starts_with("250") && fast.contains(" ppm fast, others "), "{fast}");
}
