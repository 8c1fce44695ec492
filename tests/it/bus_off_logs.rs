//! Logs in which the controller was bus-off: that time does not count for what needs listening.

use crate::common::program::{command, text};
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Start of the logs, in Unix seconds.
const START: u32 = 1_700_000_000;

/// Lines of a log, by time.
#[derive(Default)]
struct LogText(Vec<(f64, String)>);

impl LogText {
    /// A heartbeat in each second from `from` to `until`; the last byte of the UID is `uid`.
    fn beats(mut self, address: u32, uid: u8, from: f64, until: f64) -> Self {
        let mut at = from;
        for number in 0.. {
            if at >= until {
                break;
            }
            let rnd7 = u32::wrapping_mul(number + address + u32::from(uid), 0x9E37_79B1) >> 25;
            let id = 0x0700_0001 | address << 17 | rnd7 << 10;
            self.0.push((at, format!("{id:08X}#8AFA6C9724{uid:02X}0400")));
            at += 1.0;
        }
        self
    }

    fn bus_off(self, at: f64) -> Self {
        self.line(at, "20000040#0000000000000000")
    }

    fn restarted(self, at: f64) -> Self {
        self.line(at, "20000100#0000000000000000")
    }

    /// A frame of no device.
    fn line(mut self, at: f64, frame: &str) -> Self {
        self.0.push((at, frame.to_owned()));
        self
    }

    fn write(mut self, folder: &Path) {
        self.0.sort_by(|one, other| one.0.total_cmp(&other.0));
        let mut log = String::new();
        for (at, frame) in &self.0 {
            let _ = writeln!(log, "({:.6}) can0 {frame}", f64::from(START) + at);
        }
        fs::write(folder.join("session.log"), log).unwrap();
    }
}

/// The events of `watch --json`.
fn events(folder: &Path) -> Vec<Value> {
    let arguments = ["watch", "file:session.log", "--file", "des.json", "--json"];
    let output = command(&arguments, folder).output().unwrap();
    text(&output.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Times of events of a kind, in seconds since the start.
fn times(events: &[Value], event: &str, is_it: impl Fn(&Value) -> bool) -> Vec<f64> {
    let of_kind = events.iter().filter(|it| it["event"] == event && is_it(it));
    of_kind.map(|it| it["time"].as_f64().unwrap() - f64::from(START)).collect()
}

fn is_missing(event: &Value) -> bool {
    event["finding"]["kind"] == "missing"
}

#[track_caller]
fn assert_times(found: &[f64], expected: &[f64]) {
    let are_equal = found.len() == expected.len()
        && found.iter().zip(expected).all(|(one, other)| (one - other).abs() < 0.02);
    assert!(are_equal, "{found:?}, expected {expected:?}");
}

#[test]
fn entry_is_missing_after_five_seconds_on_the_bus() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("des.json"), r#"[{"name":"SENS","address":13}]"#).unwrap();
    // Heard for 2.5 s; bus-off for 20 s; on the bus again.
    let log = || LogText::default().beats(12, 1, 0.5, 3.0).bus_off(3.0).restarted(23.0);
    log().beats(12, 1, 23.2, 40.0).write(folder);
    assert_times(&times(&events(folder), "finding", is_missing), &[25.5]);
    log().beats(12, 1, 23.2, 40.0).beats(13, 2, 24.3, 40.0).write(folder);
    assert_times(&times(&events(folder), "finding", is_missing), &[]);
    // From the first frame on, and without an end.
    LogText::default().bus_off(0.0).line(20.0, "20000040#0000000000000000").write(folder);
    assert_times(&times(&events(folder), "finding", is_missing), &[]);
}

#[test]
fn conflict_stays_confirmed_while_the_bus_is_off() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("des.json"), "[]").unwrap();
    let log = || {
        let both = LogText::default().beats(13, 1, 0.5, 12.0).beats(13, 2, 0.8, 12.0);
        both.bus_off(12.1).line(60.0, "20000040#0000000000000000")
    };
    log().write(folder);
    let check = ["check", "file:session.log", "--file", "des.json"];
    let output = command(&check, folder).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stdout));
    let scan = command(&["scan", "file:session.log"], folder).output().unwrap();
    assert_eq!(scan.status.code(), Some(1), "{}", text(&scan.stdout));
    // Both go on: it is the same conflict. One goes on: it ends.
    let of_conflict = |event: &Value| event["finding"]["kind"] == "one-address-two-identities";
    let states = |log: LogText| -> Vec<String> {
        log.write(folder);
        let found = events(folder);
        let found = found.iter().filter(|it| of_conflict(it));
        found.map(|it| it["finding"]["confidence"].as_str().unwrap().to_owned()).collect()
    };
    let one = || log().restarted(62.0).beats(13, 1, 62.5, 90.0);
    assert_eq!(states(one().beats(13, 2, 62.8, 90.0)), ["suspected", "confirmed"]);
    assert_eq!(states(one()), ["suspected", "confirmed", "cleared"]);
}

#[test]
fn device_does_not_move_for_the_silence_of_bus_off() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("des.json"), "[]").unwrap();
    let log = LogText::default().beats(13, 1, 0.5, 12.0).bus_off(12.1).restarted(22.1);
    log.beats(14, 1, 22.3, 40.0).beats(13, 1, 22.5, 40.0).write(folder);
    let found = events(folder);
    assert_times(&times(&found, "moved", |_| true), &[]);
    let of_uid = |event: &Value| event["finding"]["kind"] == "one-uid-two-addresses";
    assert!(!times(&found, "finding", of_uid).is_empty(), "{found:?}");
}

/// A controller that restarts by itself, and goes bus-off again at once.
#[test]
fn many_short_times_on_the_bus_add_up() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("des.json"), "[]").unwrap();
    for (off, on) in [(0.1, 0.01), (5.0, 0.2)] {
        let mut log = LogText::default().beats(12, 1, 0.5, 10.0);
        let mut at = 10.0;
        for _ in 0..700 {
            log = log.bus_off(at).restarted(at + off);
            at += off + on;
        }
        log.write(folder);
        // Listened since the heartbeat at 9.5: until 10.0, then `on` of each period.
        let after = |listened: f64| {
            let whole = ((listened - 0.5) / on).floor();
            10.0 + whole * (off + on) + off + (listened - 0.5 - whole * on)
        };
        let found = events(folder);
        for (event, periods) in [("stale", 2.5), ("lost", 5.0)] {
            let [at] = times(&found, event, |_| true)[..] else { panic!("{event}: {found:?}") };
            // The moment may be the end of the next outage.
            let expected = after(periods);
            assert!(
                (expected - off..expected + 2.0 * off + 0.1).contains(&at),
                "{event} {at} {expected}"
            );
        }
    }
}

#[test]
fn bus_event_has_each_state_that_error_frames_report() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("des.json"), "[]").unwrap();
    let log = LogText::default().beats(12, 1, 0.5, 30.0).line(5.2, "20000004#0010000000000000");
    log.bus_off(10.1).beats(12, 1, 12.7, 12.8).write(folder);
    let found = events(folder);
    let buses = found.iter().filter(|it| it["event"] == "bus");
    let states: Vec<(i64, &str)> = buses
        .map(|it| (it["time"].as_f64().unwrap() as i64 - i64::from(START), &it["bus"]["state"]))
        .map(|(at, state)| (at, state.as_str().unwrap()))
        .collect();
    let [_, passive, off, on, _] = states[..] else { panic!("{states:?}") };
    assert_eq!([passive, off, on], [(5, "error-passive"), (10, "bus-off"), (10, "unknown")]);
    let output = command(&["watch", "file:session.log"], folder).output().unwrap();
    let lines = text(&output.stdout);
    for line in
        ["22:13:25.200 can0             error-passive", "22:13:30.100 can0             bus-off"]
    {
        assert!(lines.contains(line), "{line}: {lines}");
    }
}

#[test]
fn missing_device_has_one_time_in_scan_watch_and_check() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("des.json"), r#"[{"name":"SENS","address":13}]"#).unwrap();
    LogText::default().beats(12, 1, 0.5, 30.0).write(folder);
    let first = |word: &str| {
        let output =
            command(&[word, "file:session.log", "--file", "des.json", "--json"], folder).output();
        let report: Value = serde_json::from_slice(&output.unwrap().stdout).unwrap();
        let found = report["findings"].as_array().unwrap();
        let missing = found.iter().find(|it| it["kind"] == "missing").unwrap();
        missing["first"].as_f64().unwrap() - f64::from(START)
    };
    let watched = times(&events(folder), "finding", is_missing);
    assert_times(&watched, &[5.5]);
    assert_times(&[first("scan"), first("check")], &[watched[0], watched[0]]);
}

/// More short times on the bus than are stored: a device that is lost does not return without a frame.
#[test]
fn lost_device_stays_lost_through_any_number_of_outages() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("des.json"), "[]").unwrap();
    let mut log = LogText::default().beats(12, 1, 0.5, 10.0);
    let mut at = 10.0;
    for _ in 0..4000 {
        log = log.bus_off(at).restarted(at + 0.01);
        at += 0.014;
    }
    log.write(folder);
    let found = events(folder);
    for (event, count) in [("stale", 1), ("lost", 1), ("returned", 0)] {
        assert_eq!(times(&found, event, |_| true).len(), count, "{event}");
    }
}

/// Heartbeats after bus-off hold a conflict for some seconds, however long it lasted.
#[test]
fn conflict_that_ends_after_bus_off_ends_in_time() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("des.json"), "[]").unwrap();
    for off in [1.0, 60.0, 600.0] {
        let back = 12.1 + off;
        let both = LogText::default().beats(13, 1, 0.5, 12.0).beats(13, 2, 0.8, 12.0);
        let log = both.bus_off(12.1).restarted(back).beats(13, 1, back + 0.3, back + 2.0);
        log.beats(13, 2, back + 2.6, back + 40.0).write(folder);
        let is_over = |event: &Value| {
            event["finding"]["kind"] == "one-address-two-identities"
                && event["finding"]["confidence"] == "cleared"
        };
        let [at] = times(&events(folder), "finding", is_over)[..] else { panic!("{off}") };
        assert!((5.0..12.0).contains(&(at - back)), "{off}: {} s after the restart", at - back);
    }
}

/// Times of a log may be coarse: what follows bus-off with its time was received after it.
#[test]
fn frame_with_the_time_of_bus_off_shows_that_it_is_over() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("des.json"), "[]").unwrap();
    for (frames_at_once, lost_at) in [(0, 25.0), (1, 15.0)] {
        let mut log = LogText::default().beats(12, 1, 1.0, 11.0).bus_off(11.0);
        for _ in 0..frames_at_once {
            log = log.line(11.0, "123#00");
        }
        for second in 21..30 {
            log = log.line(f64::from(second), "123#00");
        }
        log.write(folder);
        let found = events(folder);
        assert_times(&times(&found, "lost", |_| true), &[lost_at]);
        let states = found.iter().filter(|event| event["event"] == "bus");
        let states: Vec<&Value> = states.map(|event| &event["bus"]["state"]).collect();
        assert!(states.len() >= 2, "{states:?}");
    }
}

#[test]
fn bus_off_that_is_over_was_there() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("des.json"), "[]").unwrap();
    let log = LogText::default().beats(12, 1, 0.5, 10.0).bus_off(10.0).restarted(10.3);
    log.beats(12, 1, 10.5, 60.0).write(folder);
    let found = events(folder);
    let of_bus = found.iter().filter(|event| event["finding"]["kind"] == "bus-errors");
    let texts: Vec<(&str, &str, bool)> = of_bus
        .map(|event| {
            let part = |name: &str| event["finding"][name].as_str().unwrap();
            (part("confidence"), part("text"), part("remedy").contains("restart"))
        })
        .collect();
    let [.., ("confirmed", before, true), ("cleared", after, false)] = texts[..] else {
        panic!("{texts:?}")
    };
    assert!(before.starts_with("The controller is bus-off"), "{texts:?}");
    assert!(after.starts_with("The controller was bus-off"), "{texts:?}");
}
