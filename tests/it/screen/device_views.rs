//! The views of the page Devices: columns at each width, heartbeats, versions, boards of a shared
//! address; and the ways from a device to its frames, events and problem.

use super::{one_line, snapshot, styles_of, text_snapshot};
use crate::common::harness::{BOILER, Stage, text_of};
use descan::app::{BeatKind, Page};
use descan::discovery::Config;
use descan::frame::{BusIndex, Frame};
use descan::sim::{DeviceSpec, Scenario};
use descan::status::{BusStatus, Link};
use descan::time::Instant;
use descan::wire::id::{Address, Header};
use descan::wire::node::Mode;
use descan::wire::profile::Profile;
use ratatui::buffer::Cell;

/// Returns a heartbeat in WORK of the device at an address.
fn heartbeat(millis: u64, address: u8, uid: [u8; 6]) -> Frame {
    let service = Profile::default().heartbeat_service();
    let node = Address::new(address).unwrap();
    let id = Header::unsolicited(node, (millis % 127) as u8, false, service).encode();
    let mut data = uid.to_vec();
    // Codes of the default profile: in the order of the modes.
    data.extend([Mode::Work as u8, 0]);
    Frame::classic(id, &data).with_time(Instant::from_micros(millis * 1000))
}

/// Returns an app that has received heartbeats of address 10 at these milliseconds.
fn with_heartbeats(times: &[u64]) -> Stage {
    let mut stage = Stage::new(&Scenario::default(), None);
    for &millis in times {
        stage.until(millis as f64 / 1000.0);
        let frame = heartbeat(millis, 10, *b"UID-10");
        stage.app.handle_frames(stage.app.now(), &[frame]);
    }
    stage
}

/// Returns the app on the built-in bus, with room for all frames.
fn boiler_with_past() -> Stage {
    let config = Config { seed: 7, ..Config::default() };
    let file = Some(BOILER.as_bytes().to_vec());
    Stage::with_room(&Scenario::builtin("boiler").unwrap(), file, config, 16 << 20)
}

/// Returns the first line of the screen with this text.
fn line(screen: &str, text: &str) -> String {
    let line = screen.lines().find(|line| line.contains(text));
    line.unwrap_or_else(|| panic!("no {text}\n{screen}")).to_owned()
}

/// Selects the row of this name and address.
fn select(stage: &mut Stage, name: &str, address: u8) {
    stage.keys("Home");
    for _ in 0..stage.app.rows().len() {
        let row = stage.app.selected_row().unwrap();
        let is_named = row.name.as_ref().is_some_and(|it| it.to_string() == name);
        if is_named && row.address.is_some_and(|it| it.number() == address) {
            return;
        }
        stage.keys("j");
    }
    panic!("no {name} @{address}\n{}", stage.screen());
}

#[test]
fn views_of_devices_match_snapshots() {
    let mut stage = Stage::boiler();
    stage.until(64.0).size(200, 50);
    snapshot!("devices_200x50", stage);
    snapshot!("devices_services_120x40", stage.size(120, 40).keys("v"));
    snapshot!("devices_services_40x10", stage.size(40, 10));
    snapshot!("devices_heartbeats_120x40", stage.size(120, 40).keys("v"));
    snapshot!("heartbeats_120x40", stage.keys("v h Left Left"));
    snapshot!("heartbeats_80x24", stage.size(80, 24));
    snapshot!("heartbeats_40x10", stage.size(40, 10));
}

#[test]
fn styles_of_devices_match_snapshots() {
    let mut stage = Stage::boiler();
    stage.until(64.0).size(120, 30);
    for theme in ["terminal", "dark", "light", "mono"] {
        text_snapshot!(format!("devices_styles_{theme}"), styles_of(&stage.buffer(theme)));
    }
}

#[test]
fn rows_of_each_width_have_whole_cells() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("v v v");
    for width in 31..=220 {
        stage.size(width, 24);
        let screen = stage.screen();
        let list = usize::from(stage.app.screen().list.width);
        let header: String = line(&screen, "ADDR").chars().take(list).collect();
        let titles: Vec<&str> = header.split_whitespace().collect();
        for title in ["ADDR", "NAME", "STATE", "FILE"] {
            assert!(titles.contains(&title), "{width}: {title}\n{screen}");
        }
        for (name, words) in [
            ("FEED", &["▸●   10", "online", "≠"][..]),
            ("SENS²", &["12", "online", "✓ 12"]),
            ("IGNITER", &[]),
            ("DISP", &["20", "online"]),
            ("PSU", &["30", "online", "+"]),
        ] {
            // The details beside the list have names, too.
            let mut rows = screen.lines().map(|line| line.chars().take(list).collect::<String>());
            let Some(row) = rows.find(|row| row.contains(name)) else { continue };
            for word in words {
                assert!(row.contains(word), "{width}: {word} in {row}");
            }
            // Where a cell ends, there is a blank, or it is cut with a sign.
            for title in titles.iter().skip(1) {
                let column = header.chars().collect::<Vec<_>>();
                let start = header.find(title).map(|at| header[..at].chars().count()).unwrap();
                let before = row.chars().nth(start - 1).unwrap_or(' ');
                let is_number = ["period", "miss"].contains(title);
                assert!(is_number || before == ' ', "{width}: {title} in {row} {column:?}");
            }
        }
        let uid = titles.contains(&"UID");
        assert_eq!(uid, line(&screen, "CONFLICT").contains("ACT"), "{width}\n{screen}");
    }
}

#[test]
fn strip_shows_missed_late_and_double_heartbeats() {
    // On time, missed twice, late, two in one period.
    let times = [0, 1000, 2000, 3000, 6000, 7000, 8200, 9000, 10_000, 10_300, 11_000, 12_000];
    let mut stage = with_heartbeats(&times);
    stage.size(120, 30);
    let row = line(&stage.screen(), "▸●   10");
    assert!(row.contains(" ▂××▂▂▅▂█▂▂ "), "{row}");
    // One more miss, once the next heartbeat is overdue.
    stage.until(13.3);
    assert!(line(&stage.screen(), "  10 ").contains(" ▂××▂▂▅▂█▂▂ "));
    stage.until(13.5);
    let row = line(&stage.screen(), "  10 ");
    assert!(row.contains(" ××▂▂▅▂█▂▂× "), "{row}");
    let screen = stage.size(120, 30).keys("h Left").screen();
    assert!(screen.contains("missed: expected then, nothing received since"), "{screen}");
    let screen = stage.keys("Left Left Left").screen();
    assert!(screen.contains("two heartbeats in one period"), "{screen}");
    let screen = stage.keys("Left Left").screen();
    assert!(screen.contains("12:00:08.200 early or late: 1200.0 ms after"), "{screen}");
    let screen = stage.keys("Left Left Left").screen();
    assert!(screen.contains("missed: expected then, nothing received until 12:00:06.000 (WORK)"));
    assert!(!stage.keys("Esc").screen().contains("missed: expected"), "{screen}");
}

#[test]
fn heartbeats_before_the_capture_are_unknown() {
    let mut stage = with_heartbeats(&[0, 1000, 2000]);
    let row = line(&stage.size(120, 30).screen(), "▸●   10");
    assert!(row.contains(" ·······▂▂▂ "), "{row}");
}

#[test]
fn healthy_rows_do_not_change_for_a_minute() {
    let mut stage = Stage::new(&Scenario::with_many_devices(500_000, 20, 2), None);
    for keys in ["1", "v", "v"] {
        // The jitter of the first seconds is forgotten by then.
        let start = stage.app.now().as_secs_f64() + 300.0;
        stage.keys(keys).size(200, 50).until(start);
        let region = |stage: &Stage| {
            let list = stage.app.screen().list;
            let buffer = stage.buffer("terminal");
            let row = |y| (0..list.width).map(|x| buffer[(x, y)].clone()).collect();
            let rows: Vec<Vec<Cell>> = (list.top()..list.bottom()).map(row).collect();
            rows
        };
        let before = region(&stage);
        for step in 1..=12 {
            stage.until(start + 5.0 * f64::from(step));
            for (now, before) in region(&stage).iter().zip(&before) {
                let text = |cells: &[Cell]| cells.iter().map(Cell::symbol).collect::<String>();
                assert_eq!(text(now), text(before), "{keys} {step}");
                assert_eq!(now, before, "{keys} {step}");
            }
        }
    }
}

#[test]
fn changed_version_is_shown_until_it_is_confirmed() {
    let mut stage = boiler_with_past();
    stage.until(70.0).size(120, 40);
    let change = "AUGER 2.1→2.2";
    assert!(line(&stage.screen(), "▸●   10").contains(change), "{}", stage.screen());
    let details = one_line(&stage.screen());
    assert!(details.contains("AUGER 2.2 2.1 2.1"), "{details}");
    let matrix = stage.keys("v").screen();
    assert!(line(&matrix, "▸●   10").contains("2.1→2.2≠"), "{matrix}");
    let screen = stage.keys("v v c").screen();
    assert!(screen.contains("changes of 1 device confirmed"), "{screen}");
    // The line of the timeline stays.
    let (page, latest) = screen.split_once("─ latest").unwrap();
    assert!(!page.contains("2.1→2.2"), "{screen}");
    assert!(latest.contains("rebooted: AUGER 2.1→2.2"), "{screen}");
    // A past moment has what had changed then.
    stage.keys(":").text("12:01:08").keys("Enter");
    assert!(line(&stage.screen(), "▸●   10").contains(change), "{}", stage.screen());
}

#[test]
fn boards_of_a_shared_address_have_rows() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    let screen = stage.screen();
    let words = |text| line(&screen, text).split_whitespace().take(7).collect::<Vec<_>>().join(" ");
    assert_eq!(words(" 14A "), "⚠ 14A ACT BOILER03 CONFLICT WORK ✗");
    assert_eq!(words(" 14B "), "⚠ 14B ACT SPARE01 CONFLICT WORK +");
    stage.size(120, 40);
    // Each has the heartbeats of its own.
    for side in [" 14A ", " 14B "] {
        let row = line(&stage.screen(), side);
        assert!(row.contains("▂▂▂") && !row.contains('█') && row.contains("1.00 s"), "{row}");
    }
    select(&mut stage, "ACT", 14);
    assert!(stage.screen().contains("ACT @14A · BOILER03"), "{}", stage.screen());
    stage.keys("j");
    let screen = stage.screen();
    assert!(screen.contains("ACT @14B · SPARE01"), "{screen}");
    let joined = one_line(&screen);
    assert!(joined.contains("B SPARE01 joined"), "{joined}");
    for key in ["e", "a", "R", "D"] {
        let screen = stage.keys(key).screen();
        assert!(screen.contains("14 is shared: edit the row 14A"), "{key}\n{screen}");
    }
    let screen = stage.size(40, 10).screen();
    assert!(screen.contains(" 14A BOILER03") && screen.contains(" 14B SPARE01"), "{screen}");
}

#[test]
fn twins_are_compared_in_the_details() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(120, 40);
    select(&mut stage, "SENS", 12);
    let screen = one_line(&stage.size(220, 60).screen());
    for words in ["² same name at 13 (allowed)", "² at 13", "UID BOILER05", "OXYG only there"] {
        assert!(screen.contains(words), "{words}\n{}", stage.screen());
    }
}

#[test]
fn keys_lead_from_a_device_and_back() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(120, 40);
    select(&mut stage, "ACT", 14);
    let page = |stage: &Stage| stage.app.view().page;
    stage.keys("f");
    assert_eq!(
        (page(&stage), stage.app.page_filter(Page::Traffic).text()),
        (Page::Traffic, "at:14")
    );
    stage.keys("Backspace");
    assert_eq!((page(&stage), stage.app.page_filter(Page::Traffic).text()), (Page::Devices, ""));
    stage.keys("l");
    assert_eq!(page(&stage), Page::Timeline);
    assert_eq!(stage.app.page_filter(Page::Timeline).text(), "at:14");
    assert!(stage.app.lines_shown().len() >= 2, "{}", stage.screen());
    stage.keys("Backspace p");
    assert_eq!(page(&stage), Page::Problems);
    stage.keys("Backspace");
    assert_eq!(page(&stage), Page::Devices);
    assert!(stage.keys("Backspace").screen().contains("no page to return to"));
    // Of a heartbeat the frames around it, without the filter.
    stage.keys("h Left Left Left Enter");
    assert_eq!(page(&stage), Page::Traffic);
    let frame = stage.app.selected_frame().expect("the heartbeat");
    let header = Header::decode(match frame.id {
        descan::frame::CanId::Extended(id) => id,
        descan::frame::CanId::Standard(_) => panic!("{frame}"),
    });
    assert_eq!(header.source.number(), 14, "{frame}");
    assert_eq!(header.service, Profile::default().heartbeat_service());
    stage.keys("Backspace");
    assert_eq!(page(&stage), Page::Devices);
    // Of a device that is not there nothing can be shown.
    select(&mut stage, "PUMP", 44);
    assert!(stage.keys("Esc h").screen().contains("no heartbeats: not on the bus"));
}

#[test]
fn go_to_key_typed_twice_selects_the_first_row() {
    let mut stage = boiler_with_past();
    stage.until(20.0).keys("G");
    assert_ne!(stage.app.selected_row_index(), Some(0));
    stage.keys("g g");
    assert!(stage.app.prompt().is_none());
    assert_eq!(stage.app.selected_row_index(), Some(0));
    stage.keys("G Home");
    assert_eq!(stage.app.selected_row_index(), Some(0));
    stage.keys("g").text("12:00:10").keys("Enter");
    assert!(stage.app.past_moment().is_some(), "{}", stage.screen());
}

#[test]
fn address_is_edited_under_a_heading_of_its_own_among_services() {
    for columns in [60, 80, 120] {
        let mut stage = Stage::boiler();
        stage.until(24.0).size(columns, 24).keys("v");
        assert!(!stage.screen().contains(" FILE"), "{}", stage.screen());
        let screen = stage.keys("e").text("55").screen();
        let heading = screen.lines().find(|line| line.contains("ADDR NAME")).unwrap();
        let row = screen.lines().find(|line| line.contains("10 FEED ")).unwrap();
        let column = |line: &str, text: &str| {
            let at = line.find(text).unwrap_or_else(|| panic!("no {text}: {screen}"));
            line[..at].chars().count()
        };
        assert_eq!(column(heading, "FILE"), column(row, "55"), "{columns}: {screen}");
        assert_eq!(row.chars().nth(column(row, "55") - 1), Some(' '), "{columns}: {screen}");
        assert!(!stage.keys("Esc").screen().contains(" FILE"), "{}", stage.screen());
    }
}

#[test]
fn services_that_do_not_fit_are_reached_with_right() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(40, 12).keys("v");
    let header = |stage: &Stage| line(&stage.screen(), "ADDR");
    let first = header(&stage);
    assert!(first.contains("DES") && first.contains('→'), "{first}");
    stage.keys("Right");
    let second = header(&stage);
    assert!(!second.contains("DES") && second.contains("← 1"), "{second}");
    for _ in 0..40 {
        stage.keys("Right");
    }
    let last = header(&stage);
    assert!(last.contains("RTC") && !last.contains('→'), "{last}");
    for _ in 0..40 {
        stage.keys("Left");
    }
    assert_eq!(header(&stage), first);
    // Where all fit, Right goes into the details.
    stage.size(220, 40).keys("Right");
    assert_eq!(stage.app.view().focus, descan::app::Focus::Details);
}

#[test]
fn hostile_devices_are_drawn_in_all_views() {
    let long = "\u{1b}[2J\u{202e}".repeat(500);
    let mut scenario = Scenario::new(1_000_000);
    for at in 0..8 {
        let name = if at % 2 == 0 { long.as_str() } else { "A" };
        let mut device =
            DeviceSpec::new(name).label(&format!("device {at}")).skips_address_resolution();
        device = device.fixed(20 + at);
        device.services = (0..256_u32)
            .map(|service| {
                let name = format!("S{service}");
                let version = if at == 1 { long.clone() } else { format!("{service}.{at}") };
                vec![name.into_bytes(), version.into_bytes()]
            })
            .take(if at == 1 { 2 } else { 256 })
            .collect();
        scenario = scenario.with(device);
    }
    let mut stage = Stage::new(&scenario, Some(BOILER));
    stage.until(40.0);
    let known = stage.app.rows().iter().filter_map(|row| stage.app.device_of(row));
    assert!(known.filter(|device| device.services.is_some()).count() >= 4, "{}", stage.screen());
    for (columns, rows) in [(200, 50), (120, 40), (80, 24), (40, 10), (31, 6)] {
        stage.size(columns, rows);
        for keys in
            ["1", "j", "v", "Right", "v", "j", "h", "Left", "PgUp", "Esc", "v", "Enter", "Esc"]
        {
            stage.keys(keys);
            for cell in stage.buffer("terminal").content() {
                let odd = cell.symbol().chars().find(|&c| !descan::text::is_printable(c));
                assert_eq!(odd, None, "{keys} {:?}", cell.symbol());
            }
        }
    }
}

#[test]
fn many_devices_with_blank_uids_are_drawn() {
    let mut stage = Stage::new(&Scenario::new(1_000_000), None);
    for second in 0..5 {
        for address in 1..=126_u8 {
            let millis = second * 1000 + u64::from(address);
            stage.until(millis as f64 / 1000.0);
            let uid = if address % 2 == 0 { [0; 6] } else { [0xFF; 6] };
            stage.app.handle_frames(stage.app.now(), &[heartbeat(millis, address, uid)]);
        }
    }
    stage.until(5.2).size(120, 40);
    assert!(stage.app.rows().len() >= 126, "{}", stage.app.rows().len());
    let screen = stage.screen();
    assert!(screen.contains("blank") && screen.contains(" ↓"), "{screen}");
    for keys in ["v", "v", "v G h Left"] {
        stage.keys(keys).screen();
    }
}

#[test]
fn lost_device_keeps_its_misses() {
    let mut stage = with_heartbeats(&[0, 1000, 2000, 3000, 4000, 5000]);
    stage.until(30.0).size(120, 30);
    let row = line(&stage.screen(), "  10 ");
    assert!(row.contains("lost") && row.contains("××××××××××") && row.contains("ago"), "{row}");
    let text = text_of(&stage.buffer("mono"));
    assert_eq!(text, stage.screen());
}

#[test]
fn past_moment_has_the_heartbeats_until_then() {
    let mut stage = boiler_with_past();
    stage.until(66.0).size(120, 30);
    // FEED reboots at 61 s.
    assert!(line(&stage.screen(), "  10 ").contains('×'), "{}", stage.screen());
    stage.keys(":").text("12:00:50").keys("Enter");
    assert!(line(&stage.screen(), "  10 ").contains("▂▂▂▂▂▂▂▂▂▂"), "{}", stage.screen());
    let screen = stage.keys("h").screen();
    assert!(!screen.contains("12:01:0") || screen.contains("missed 0"), "{screen}");
}

#[test]
fn heartbeats_while_the_bus_is_down_are_not_missed() {
    let config = Config { listen_only: true, ..Config::default() };
    let mut stage = Stage::with(&Scenario::default(), None, config);
    stage.size(200, 50);
    let status = |link| BusStatus { link, bitrate: Some(125_000), ..BusStatus::default() };
    for second in 1..30 {
        stage.until(f64::from(second));
        let now = stage.app.now();
        match second {
            10 => stage.app.handle_bus(now, BusIndex(0), status(Link::Down)),
            15 => stage.app.handle_bus(now, BusIndex(0), status(Link::Up)),
            _ => {}
        }
        if !(10..15).contains(&second) && second != 25 {
            let frame = heartbeat(now.as_micros() / 1000, 12, *b"BOARD1");
            stage.app.handle_frames(now, &[frame.with_time(now)]);
        }
    }
    stage.until(29.5);
    let row = stage.app.rows()[0].clone();
    let cells = stage.app.beats_of(&row, 25);
    let of = |kind| cells.iter().filter(move |it| it.kind == kind).map(|it| it.time.as_secs_f64());
    let unknown: Vec<f64> = of(BeatKind::Unknown).collect();
    assert!(unknown.len() >= 4 && unknown.iter().all(|it| (9.5..15.5).contains(it)), "{cells:?}");
    let missed: Vec<u64> = of(BeatKind::Missed).map(|it| it.round() as u64).collect();
    assert_eq!(missed, [25], "{cells:?}");
}

#[test]
fn heartbeats_of_a_moved_device_are_shown_from_both_addresses() {
    let config = Config { listen_only: true, ..Config::default() };
    let mut stage = Stage::with(&Scenario::new(125_000), None, config);
    for second in 1..30 {
        let address = if (10..20).contains(&second) { 40 } else { 20 };
        let millis = second * 1000;
        stage.until(millis as f64 / 1000.0);
        let now = stage.app.now();
        stage.app.handle_frames(now, &[heartbeat(millis, address, *b"MOVING")]);
    }
    stage.until(29.5).size(120, 30);
    let row = stage.app.rows().iter().find(|row| row.address.is_some_and(|it| it.number() == 20));
    let beats = stage.app.beats_of(&row.expect("a row at 20").clone(), 100);
    assert_eq!(beats.len(), 29, "{beats:?}");
    assert!(beats.iter().all(|beat| beat.number.is_some()), "{beats:?}");
}
