//! Replay faster than frames can be processed: the screen reports the same events as at normal
//! speed, however far the clock runs ahead.

use crate::common::inspection;
use crate::common::pty::Pty;
use descan::sim::{DeviceSpec, Scenario};
use descan::time::Duration;
use std::fs;
use std::path::Path;

/// Writes a log of nine devices and a requester, with more frames than one turn processes.
pub fn write_log(path: &Path) {
    let mut scenario = Scenario::new(125_000);
    for number in 1..=9 {
        let device =
            DeviceSpec::new(&format!("N{number}")).fixed(number).skips_address_resolution();
        scenario = scenario.with(device.periodic_message(0x100, Duration::from_millis(50), 8));
    }
    fs::write(path, inspection::log(&scenario, 40)).unwrap();
}

#[test]
fn playback_speed_does_not_change_events() {
    let folder = tempfile::tempdir().unwrap();
    write_log(&folder.path().join("session.log"));
    for (speed, keys) in [("100000", ""), ("1000", ""), ("4", "P))))))))))))))))))))P")] {
        let arguments = ["file:session.log", "--file", "des.json", "--speed", speed];
        let mut pty = Pty::start(&arguments, folder.path(), (100, 40));
        pty.wait_for("N9");
        pty.send(keys);
        pty.wait_for("end of log");
        pty.send("3G");
        pty.wait_for("06:18:12 · can0         end of log");
        let screen = pty.screen();
        for word in ["suspected", "rebooted", "lost", "silent", "returned"] {
            assert!(!screen.contains(&format!(" {word}")), "speed {speed}: {word}: {screen}");
        }
        assert!(screen.contains("10 present"), "and who asked: {screen}");
        pty.send("q");
        assert_eq!(pty.wait(), 0);
    }
}

/// The log has no frame of DES: nothing happens on the bus when the devices are missing.
#[test]
fn missing_devices_are_so_from_the_same_moment_at_any_speed() {
    let folder = tempfile::tempdir().unwrap();
    let line = |at: u32| format!("({}.000000) can0 123#00\n", 1_700_000_000 + at);
    fs::write(folder.path().join("other.log"), (0..60).map(line).collect::<String>()).unwrap();
    let entry = r#"[{"name": "FEED", "address": 10}]"#;
    fs::write(folder.path().join("des.json"), entry).unwrap();
    for speed in ["30", "1000", "100000"] {
        let arguments = ["file:other.log", "--file", "des.json", "--speed", speed];
        let mut pty = Pty::start(&arguments, folder.path(), (120, 40));
        pty.wait_for("end of log");
        pty.send("4");
        pty.wait_for("@10   22:13:25.000 FEED is missing");
        pty.wait_for("this bus does not speak DES: all 60 frames have 11-bit identifiers");
        pty.send("q");
        assert_eq!(pty.wait(), 0);
    }
}

/// Two rounds of the requester in the log end the search: no event, and no frame, is at that moment.
#[test]
fn missing_devices_have_one_time_wherever_one_seeks() {
    let folder = tempfile::tempdir().unwrap();
    write_log(&folder.path().join("session.log"));
    let entry = r#"[{"name": "FEED", "address": 40}]"#;
    fs::write(folder.path().join("des.json"), entry).unwrap();
    let mut times = Vec::new();
    for seek in ["", "g06:17:38\r", "g06:17:39.5\r", "g06:17:44\r", "g06:17:50\r"] {
        let speed = if seek.is_empty() { "100000" } else { "0.01" };
        let arguments = ["file:session.log", "--file", "des.json", "--speed", speed];
        let mut pty = Pty::start(&arguments, folder.path(), (120, 40));
        if seek.is_empty() {
            pty.wait_for("end of log");
        } else {
            // The end of the log is looked for meanwhile.
            pty.wait_for("┤ 06:18:1");
            pty.send(seek);
            pty.wait_for("FROZEN");
        }
        pty.send("4");
        pty.wait_for("FEED is missing");
        let screen = pty.screen();
        let line = screen.lines().find(|line| line.contains("FEED is missing")).unwrap();
        times.push(line.split_whitespace().find(|word| word.contains(':')).unwrap().to_owned());
        pty.send("q");
        assert_eq!(pty.wait(), 0);
    }
    assert!(times.iter().all(|time| *time == times[0]), "{times:?}");
}

/// Devices join within 200 ms of the end: nothing comes after them.
#[test]
fn log_that_ends_at_an_event_has_its_missing_devices() {
    let folder = tempfile::tempdir().unwrap();
    let line = |millis: u32, address: u32| {
        let id = 0x0700_0001 | address << 17 | address << 10;
        format!("(1700000000.{millis:03}000) can0 {id:08X}#8AFA6C97241{address:X}0400\n")
    };
    let log: String = [(100, 8), (190, 9), (240, 10)].map(|(at, device)| line(at, device)).concat();
    fs::write(folder.path().join("short.log"), log).unwrap();
    let entry = r#"[{"name": "FEED", "address": 40}]"#;
    fs::write(folder.path().join("des.json"), entry).unwrap();
    let arguments = ["file:short.log", "--file", "des.json"];
    let mut pty = Pty::start(&arguments, folder.path(), (120, 40));
    pty.wait_for("end of log");
    pty.wait_for("1 missing");
    pty.send("4");
    pty.wait_for("FEED is missing");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn log_without_a_frame_has_no_missing_devices() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("empty.log"), "").unwrap();
    let entry = r#"[{"name": "FEED", "address": 10}]"#;
    fs::write(folder.path().join("des.json"), entry).unwrap();
    let arguments = ["file:empty.log", "--file", "des.json"];
    let mut pty = Pty::start(&arguments, folder.path(), (120, 40));
    pty.wait_for("check that it is the right log");
    pty.send("4");
    pty.wait_for("4 Problems ─");
    assert!(!pty.screen().contains("is missing"), "{}", pty.screen());
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}
