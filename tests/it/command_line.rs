//! The command line, from outside: output, output stream, and exit codes.

use crate::common::inspection::log;
use descan::frame::Frame;
use descan::log::candump::write_line;
use descan::sim::{DeviceAction, DeviceSpec, Scenario};
use descan::time::{Duration, Epoch};
use serde_json::Value;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn descan(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(arguments)
        .current_dir(folder)
        .env("XDG_CONFIG_HOME", folder.join("config"))
        .env_remove("NO_COLOR")
        .stdin(Stdio::null())
        .output()
        .expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("output is UTF-8")
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {}", text(&output.stdout)))
}

fn two_devices() -> Scenario {
    Scenario::new(125_000)
        .with(DeviceSpec::new("FEED").fixed(12).skips_address_resolution().service("AUGER", "2.1"))
        .with(DeviceSpec::new("SENS").fixed(13).skips_address_resolution().service("TEMP", "1.7"))
}

#[test]
fn device_on_two_buses_lists_its_other_bus() {
    let folder = tempfile::tempdir().unwrap();
    let mut others = two_devices();
    others.devices[1] =
        DeviceSpec::new("SENS").fixed(14).skips_address_resolution().service("LOG", "0.1");
    let mut lines: Vec<String> = log(&two_devices(), 12).lines().map(str::to_owned).collect();
    lines.extend(log(&others, 12).lines().map(|line| line.replace(" can0 ", " can1 ")));
    lines.sort_by_key(|line| line.split(' ').next().map(str::to_owned));
    std::fs::write(folder.path().join("both.log"), lines.join("\n")).unwrap();
    let report = json(&descan(&["scan", "file:both.log", "--json"], folder.path()));
    let devices = report["devices"].as_array().unwrap();
    let also = |bus: &str, name: &str| {
        let device = devices.iter().find(|it| it["bus"] == bus && it["name"] == name).unwrap();
        assert_eq!(device["also"].as_array().unwrap().len(), 1, "{device}");
        let also = &device["also"][0];
        format!("{} {} {}", also["bus"], also["address"], also["redundant"])
    };
    assert_eq!(also("can0", "FEED"), r#""can1" 12 true"#);
    assert_eq!(also("can1", "FEED"), r#""can0" 12 true"#);
    assert_eq!(also("can0", "SENS"), r#""can1" 14 false"#);
    let table = text(&descan(&["scan", "file:both.log"], folder.path()).stdout);
    assert!(
        table.contains("FEED is on can0 @12 and can1 @12, same services: redundant\n"),
        "{table}"
    );
    assert!(
        table.contains("SENS is on can0 @13 and can1 @14, different services: separate networks")
    );
}

#[test]
fn log_scan_uses_log_time() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log(&two_devices(), 12)).unwrap();
    let output = descan(&["scan", "file:session.log", "--json"], folder.path());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let report = json(&output);
    assert_eq!(report["descan"], "0.1.0");
    let bus = &report["buses"][0];
    assert_eq!(bus["name"], "can0");
    assert_eq!(bus["bitrate"], Value::Null, "a log does not say");
    assert_eq!(bus["load"], Value::Null, "nor can the load be known then");
    assert_eq!(bus["state"], "unknown");
    assert_eq!(
        (&bus["errors"], &bus["lost"], &bus["address"]),
        (&0.into(), &0.into(), &Value::Null)
    );
    let devices = report["devices"].as_array().unwrap();
    let named: Vec<_> =
        devices.iter().map(|it| (it["address"].as_u64().unwrap(), it["name"].clone())).collect();
    assert_eq!(named[1..], [(12, "FEED".into()), (13, "SENS".into())]);
    let feed = &devices[1];
    assert_eq!(feed["bus"], "can0");
    assert_eq!(feed["name_hex"], "46454544");
    assert_eq!(feed["presence"], "online");
    assert_eq!(feed["mode"], "WORK");
    assert_eq!(feed["working"], true);
    assert_eq!(feed["uid"], "FEED");
    assert_eq!(feed["framing"], "isotp");
    assert_eq!(feed["services_known"], true);
    let services = serde_json::json!([
        { "index": 0, "name": "DES", "version": "1.0", "extra": [] },
        { "index": 1, "name": "AUGER", "version": "2.1", "extra": [] },
    ]);
    assert_eq!(feed["services"], services);
    assert_eq!(feed["heartbeat"]["missed"], 0);
    let period = feed["heartbeat"]["period_ms"].as_f64().unwrap();
    assert!((990.0..1010.0).contains(&period), "{period}");
    assert_eq!(feed["quirks"], serde_json::json!([]));
    assert_eq!(report["findings"], serde_json::json!([]));
    assert_eq!(report["file"]["ok"], Value::Null, "there is no des.json");
}

/// A log of 40 s: heartbeats of node 12 until 20 s, of node 20 from 10 s on.
fn log_with_two_shifts() -> String {
    let mut lines = Vec::new();
    for second in 0..=40 {
        for (_, id) in [(0..=20, "07183C01"), (10..=40, "07283C01")]
            .into_iter()
            .filter(|(seconds, _)| seconds.contains(&second))
        {
            lines.push(format!("({}.5) can0 {id}#8AFA6C9724110400\n", 1_436_509_052 + second));
        }
    }
    lines.concat()
}

/// Returns the devices of `descan scan` on this log: address, presence, number of heartbeats.
fn shifts(options: &[&str]) -> Vec<(u64, String, u64)> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log_with_two_shifts()).unwrap();
    let arguments = [&["scan", "file:session.log", "--json"], options].concat();
    let output = descan(&arguments, folder.path());
    assert_eq!(text(&output.stderr), "");
    assert_eq!(output.status.code(), Some(0));
    let report = json(&output);
    let devices = report["devices"].as_array().unwrap().iter();
    devices
        .map(|device| {
            let presence = device["presence"].as_str().unwrap().to_owned();
            let beats = device["heartbeat"]["count"].as_u64().unwrap();
            (device["address"].as_u64().unwrap(), presence, beats)
        })
        .collect()
}

#[test]
fn log_scanned_with_time_is_judged_at_that_moment() {
    let device = |address, presence: &str, beats| (address, presence.to_owned(), beats);
    assert_eq!(shifts(&[]), [device(12, "lost", 21), device(20, "online", 31)]);
    assert_eq!(shifts(&["--time", "5"]), [device(12, "online", 6)]);
    assert_eq!(shifts(&["--time", "15"]), [device(12, "online", 16), device(20, "online", 6)]);
    // The log is shorter.
    assert_eq!(shifts(&["--time", "1000"]), shifts(&[]));
}

#[test]
fn log_scanned_from_a_moment_has_nothing_from_before_it() {
    let device = |address, presence: &str, beats| (address, presence.to_owned(), beats);
    assert_eq!(shifts(&["--from", "25"]), [device(20, "online", 16)]);
    assert_eq!(shifts(&["--from", "4.5", "--time", "3"]), [device(12, "online", 3)]);
    // No frame in these two seconds: the time counts from that moment, not from the next frame.
    assert_eq!(shifts(&["--from", "5.1", "--time", "0.8"]), []);
    assert_eq!(shifts(&["--from", "0"]), shifts(&[]));
}

#[test]
fn log_time_advances_between_distant_frames() {
    let folder = tempfile::tempdir().unwrap();
    let mut lines = Vec::new();
    for second in [0, 1, 2, 3, 4, 60] {
        let id = if second == 60 { "07283C01" } else { "07183C01" };
        lines.push(format!("({second}.0) can0 {id}#8AFA6C9724110400\n"));
    }
    std::fs::write(folder.path().join("session.log"), lines.concat()).unwrap();
    let arguments = ["scan", "file:session.log", "--json", "--time", "20"];
    let report = json(&descan(&arguments, folder.path()));
    assert_eq!(report["devices"].as_array().unwrap().len(), 1);
    assert_eq!(report["devices"][0]["presence"], "lost");
}

#[test]
fn log_watched_from_a_moment_begins_there() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log_with_two_shifts()).unwrap();
    for speed in [None, Some("100")] {
        let mut arguments =
            vec!["watch", "file:session.log", "--json", "--from", "25", "--time", "2"];
        arguments.extend(speed.iter().flat_map(|speed| ["--speed", speed]));
        let output = descan(&arguments, folder.path());
        let told: Vec<Value> =
            text(&output.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let appeared = told.iter().filter(|it| it["event"] == "appeared");
        let appeared: Vec<_> = appeared.map(|it| (it["time"].as_f64(), &it["address"])).collect();
        assert_eq!(appeared, [(Some(1_436_509_077.5), &Value::from(20))]);
        assert!(told.iter().all(|it| it["time"].as_f64() >= Some(1_436_509_077.5)), "{told:?}");
        assert_eq!(output.status.code(), Some(0));
    }
}

#[test]
fn unusable_from_is_refused_with_remedy() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log_with_two_shifts()).unwrap();
    std::fs::write(folder.path().join("des.json"), "[]").unwrap();
    for command in ["scan", "check", "watch"] {
        for (arguments, code, cause, way_out) in [
            (&["sim:boiler", "--from", "5"][..], 2, "--from", "file:LOG"),
            (&["nocan7", "--from", "5"], 2, "--from", "file:LOG"),
            (&["file:session.log", "--from", "soon"], 2, "--from", "a number of seconds"),
            (&["file:session.log", "--from", "-1"], 2, "--from", "a number of seconds"),
            (&["file:session.log", "--time", "soon"], 2, "--time", "a number of seconds"),
            (&["file:session.log", "--from", "100"], 3, "40.0 s", "--from"),
        ] {
            let output = descan(&[&[command], arguments].concat(), folder.path());
            let stderr = text(&output.stderr);
            assert_eq!(output.status.code(), Some(code), "{command} {arguments:?}: {stderr}");
            assert!(stderr.contains(cause) && stderr.contains(way_out), "{stderr}");
            assert_eq!(stderr.lines().count(), 1, "{stderr}");
            assert_eq!(text(&output.stdout), "", "{command} {arguments:?}");
        }
    }
}

#[test]
fn log_with_clock_jump_is_scanned_at_once() {
    let folder = tempfile::tempdir().unwrap();
    for first in ["1.0", "0.0"] {
        let log = format!(
            "({first}) can0 07180001#8AFA6C9724110400\n\
             (1780000000.0) can0 07180401#8AFA6C9724110400\n\
             (18446744073709.551615) can0 07180801#8AFA6C9724110400\n"
        );
        std::fs::write(folder.path().join("session.log"), log).unwrap();
        let report = json(&descan(&["scan", "file:session.log", "--json"], folder.path()));
        assert_eq!(report["devices"][0]["presence"], "online");
        assert_eq!(report["devices"][0]["heartbeat"]["count"], 3);
    }
}

#[test]
fn log_with_bus_off_for_years_is_scanned_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let log = "(1.0) can0 07180001#8AFA6C9724110400\n\
               (1.5) can0 20000040#0000000000000000\n\
               (1780000000.0) can0 07180401#8AFA6C9724110400\n\
               (1780000029.0) can0 07180801#8AFA6C9724110400\n";
    let bus_errors = |log: &str| {
        std::fs::write(folder.path().join("session.log"), log).unwrap();
        let report = json(&descan(&["scan", "file:session.log", "--json"], folder.path()));
        let finding = &report["findings"][0];
        assert_eq!(finding["kind"], "bus-errors");
        finding["confidence"].clone()
    };
    assert_eq!(bus_errors(log), "confirmed", "it may be off again in a moment");
    let quiet = format!("{log}(1780000031.0) can0 07180C01#8AFA6C9724110400\n");
    assert_eq!(bus_errors(&quiet), "cleared", "it took part for half a minute");
}

#[test]
fn device_silent_before_log_end_is_lost() {
    let scenario = two_devices().at(Duration::from_secs(4), "SENS", DeviceAction::PowerOff);
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log(&scenario, 12)).unwrap();
    let report = json(&descan(&["scan", "file:session.log", "--json"], folder.path()));
    let sens = report["devices"].as_array().unwrap().iter().find(|it| it["name"] == "SENS");
    assert_eq!(sens.unwrap()["presence"], "lost");
}

#[test]
fn address_conflict_in_log_exits_1() {
    let twin = DeviceSpec::new("FEED")
        .label("second")
        .fixed(12)
        .skips_address_resolution()
        .uid(descan::wire::node::Uid([1, 2, 3, 4, 5, 6]))
        .fault(descan::sim::Fault::KeepsAddress);
    let first = two_devices();
    let mut scenario = first.with(twin);
    scenario.devices[0].faults.set(descan::sim::Fault::KeepsAddress, true);
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log(&scenario, 20)).unwrap();
    let output = descan(&["scan", "file:session.log", "--json"], folder.path());
    assert_eq!(output.status.code(), Some(1));
    let report = json(&output);
    let finding = report["findings"]
        .as_array()
        .unwrap()
        .iter()
        .find(|it| it["confidence"] == "confirmed")
        .expect("a confirmed finding");
    assert_eq!(finding["address"], 12);
    assert_eq!(finding["addresses"], serde_json::json!([12]));
    assert_eq!(finding["bus"], "can0");
    assert!(finding["first"].as_f64().unwrap() > 1_436_509_052.0);
    let evidence = &finding["evidence"][0];
    assert!(evidence["frame"].as_str().unwrap().contains('#'));
    assert!(!finding["text"].as_str().unwrap().is_empty());
    assert!(!finding["remedy"].as_str().unwrap().is_empty());
    let tables = descan(&["scan", "file:session.log"], folder.path());
    assert!(text(&tables.stdout).contains("CONFLICT"), "{}", text(&tables.stdout));
}

/// Returns a log in which two boards respond as FEED and as PUMP from address 12 throughout; at the
/// end, 40 sends a non-conforming identifier.
fn two_boards_at_12() -> Vec<String> {
    let mut lines = Vec::new();
    let mut add = |millis: u32, frame: String| {
        lines.push(format!(
            "({}.{:03}000) can0 {frame}",
            1_436_509_052 + millis / 1000,
            millis % 1000
        ));
    };
    for second in 0..14 {
        let rnd7 = (second * 3 + 1) << 10;
        let at = second * 1000;
        // A name request, then both responses and both heartbeats.
        add(at + 100, format!("{:08X}#0444455301", 0x0200_0002 | rnd7));
        add(at + 110, "05180002#06014645454400".to_owned());
        add(at + 115, "05180002#060150554D5000".to_owned());
        add(at + 200, format!("{:08X}#8AFA6C9724110400", 0x0718_0001 | rnd7));
        add(
            at + 700,
            format!("{:08X}#112233445566 0400", 0x0718_0001 | rnd7 ^ 0x400).replace(' ', ""),
        );
    }
    add(13_800, "07500001#0102030405060400".to_owned());
    add(13_900, "10500001#00".to_owned());
    lines
}

/// Tests a device whose address another one took while it was silent, and gave up when it returned:
/// its name is received when the other one has left.
#[test]
fn device_that_returns_to_its_address_is_one_row() {
    let mut frames: Vec<(u32, String)> = Vec::new();
    let beat = |id: u32, millis: u32, data: &str| {
        (millis, format!("{:08X}#{data}", id | (millis * 7 % 127) << 10))
    };
    let (one, other) = ("8AFA6C97241104", "CFA86C97241904");
    let named = |millis: u32, response: &str| {
        [beat(0x0200_0002, millis, "0444455301"), (millis + 10, format!("05180002#{response}"))]
    };
    frames
        .extend((0..10).map(|second| beat(0x0718_0001, second * 1000 + 200, &format!("{one}00"))));
    frames.extend(named(500, "06014645454400"));
    // It goes to IDLE, and the other one claims its address.
    frames.push(beat(0x1718_0001, 10_200, "8AFA6C9724110600"));
    frames.push(beat(0x1718_0001, 13_600, "CFA86C9724190100"));
    for at in [13_650, 14_650, 15_650, 16_650] {
        frames.extend(named(at, "060150554D5000"));
    }
    frames.extend((14..24).map(|at| beat(0x0718_0001, at * 1000 + 600, &format!("{other}00"))));
    frames.extend((25..50).map(|at| beat(0x0718_0001, at * 1000 + 200, &format!("{one}00"))));
    frames.push(beat(0x1750_0001, 25_900, "CFA86C9724190100"));
    frames.extend((26..50).map(|at| beat(0x0750_0001, at * 1000 + 900, &format!("{other}00"))));
    frames.extend(named(26_500, "06014645454400"));
    frames.sort();
    let line = |(millis, frame): (u32, String)| {
        format!("({}.{:03}000) can0 {frame}\n", 1_436_509_052 + millis / 1000, millis % 1000)
    };
    let folder = tempfile::tempdir().unwrap();
    let log: String = frames.into_iter().map(line).collect();
    std::fs::write(folder.path().join("session.log"), log).unwrap();
    let report = json(&descan(&["scan", "file:session.log", "--json"], folder.path()));
    let devices = report["devices"].as_array().unwrap();
    let found = devices.iter().map(|it| (it["address"].as_u64(), it["name"].as_str()));
    let found: Vec<_> = found.filter(|(address, _)| *address != Some(0)).collect();
    assert_eq!(found, [(Some(12), Some("FEED")), (Some(40), Some("PUMP"))], "{report:#}");
}

#[test]
fn finding_evidence_names_log_lines() {
    let folder = tempfile::tempdir().unwrap();
    let lines = two_boards_at_12();
    std::fs::write(folder.path().join("session.log"), lines.join("\n") + "\n").unwrap();
    let output = descan(&["scan", "file:session.log", "--json"], folder.path());
    assert_eq!(output.status.code(), Some(1));
    let report = json(&output);
    let findings = report["findings"].as_array().unwrap();
    let members = [
        "addresses",
        "address",
        "bus",
        "cleared_at",
        "superseded_by",
        "confidence",
        "evidence",
        "first",
        "kind",
        "last",
        "names",
        "remedy",
        "text",
        "uids",
    ];
    for finding in findings {
        let mut own: Vec<&str> = finding.as_object().unwrap().keys().map(String::as_str).collect();
        own.sort_unstable_by_key(|it| members.iter().position(|member| member == it));
        assert_eq!(own, members, "{finding:#}");
        assert_eq!(finding["bus"], "can0");
        assert!(
            ["suspected", "confirmed", "cleared"]
                .contains(&finding["confidence"].as_str().unwrap())
        );
        let text = |member: &str| finding[member].as_str().unwrap().to_owned();
        assert!(text("text").ends_with('.') && text("remedy").ends_with('.'), "{finding:#}");
        let evidence = finding["evidence"].as_array().unwrap();
        assert!((1..=8).contains(&evidence.len()), "{finding:#}");
        assert_eq!(finding["first"], evidence[0]["time"]);
        for piece in evidence {
            assert!(!piece["what"].as_str().unwrap().is_empty());
            assert!(!piece["meaning"].as_str().unwrap().is_empty());
            assert!(piece["from"].is_u64(), "{piece}");
            let time = piece["time"].as_f64().unwrap();
            let line = format!("({time:.6}) can0 {}", piece["frame"].as_str().unwrap());
            assert!(lines.contains(&line), "{line} is not in the log: {finding:#}");
        }
        let times: Vec<f64> = evidence.iter().map(|it| it["time"].as_f64().unwrap()).collect();
        assert!(times.is_sorted(), "{finding:#}");
    }
    let firsts: Vec<f64> = findings.iter().map(|it| it["first"].as_f64().unwrap()).collect();
    assert!(firsts.is_sorted(), "{firsts:?}");
    let of_kind = |kind: &str| {
        let found = findings.iter().find(|it| it["kind"] == kind);
        found.unwrap_or_else(|| panic!("no {kind}: {findings:#?}"))
    };
    let names = of_kind("one-address-two-names");
    assert_eq!(names["confidence"], "confirmed");
    assert_eq!((&names["address"], &names["addresses"]), (&12.into(), &serde_json::json!([12])));
    let mut both: Vec<&str> =
        names["names"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
    both.sort_unstable();
    assert_eq!(both, ["FEED", "PUMP"]);
    let identities = of_kind("one-address-two-identities");
    assert_eq!(
        (&identities["confidence"], &identities["address"]),
        (&"confirmed".into(), &12.into())
    );
    let odd = of_kind("non-conforming");
    assert_eq!((&odd["confidence"], &odd["address"]), (&"suspected".into(), &40.into()));
    assert_eq!(odd["evidence"][0]["frame"], "10500001#00");
}

#[test]
fn log_is_read_from_standard_input() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(["scan", "-", "--json"])
        .current_dir(folder.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = log(&two_devices(), 5);
    lines.push_str("this is no line of a log\n");
    child.stdin.take().unwrap().write_all(lines.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(json(&output)["devices"].as_array().unwrap().len(), 3);
}

#[test]
fn unreadable_log_lines_are_reported_on_stderr_and_in_json() {
    let folder = tempfile::tempdir().unwrap();
    let lines = format!("{}what?\nand this?\n", log(&two_devices(), 3));
    let number = lines.lines().count() - 1;
    std::fs::write(folder.path().join("session.log"), lines).unwrap();
    let output = descan(&["scan", "file:session.log"], folder.path());
    let said = text(&output.stderr);
    assert!(
        said.contains(&format!("2 lines cannot be read, the first is line {number}")),
        "{said}"
    );
    let report = json(&descan(&["scan", "file:session.log", "--json"], folder.path()));
    assert_eq!(report["buses"][0]["unreadable"], 2, "{report}");
}

#[test]
fn unreadable_lines_are_counted_in_the_part_that_is_read() {
    let folder = tempfile::tempdir().unwrap();
    // One unreadable line in front of each frame.
    let log = log(&two_devices(), 4);
    let lines: String = log.lines().flat_map(|line| ["what?\n", line, "\n"]).collect();
    std::fs::write(folder.path().join("session.log"), lines).unwrap();
    let count = |options: &[&str]| {
        let arguments = [&["scan", "file:session.log", "--json"], options].concat();
        let output = descan(&arguments, folder.path());
        let bus = json(&output)["buses"][0].clone();
        assert_eq!(bus["unreadable"], bus["frames"], "{options:?}");
        let said = text(&output.stderr);
        assert!(said.contains(&format!("{} lines cannot be read", bus["frames"])), "{said}");
        bus["frames"].as_u64().unwrap()
    };
    let all = count(&[]);
    let (start, end) = (count(&["--time", "1"]), count(&["--from", "1"]));
    assert!(start > 0 && end > 0 && start < all && end < all);
    assert_eq!(start + end, all);
}

#[test]
fn log_with_byte_order_mark_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let lines = format!("\u{feff}{}", log(&two_devices(), 3));
    let number = lines.lines().count();
    std::fs::write(folder.path().join("session.log"), lines).unwrap();
    let output = descan(&["scan", "file:session.log", "--json"], folder.path());
    assert_eq!(text(&output.stderr), "");
    assert_eq!(json(&output)["buses"][0]["frames"], number);
}

#[test]
fn unprintable_name_is_escaped() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log(&two_devices(), 3)).unwrap();
    std::fs::write(folder.path().join("des.json"), "{}").unwrap();
    let log = "file:session.log";
    for arguments in [&["scan", log][..], &["check", log], &["watch", log], &["schema"], &["man"]] {
        let output = Command::new(env!("CARGO_BIN_EXE_descan"))
            .args(arguments)
            .current_dir(folder.path())
            .stdout(std::fs::File::options().write(true).open("/dev/full").unwrap())
            .output()
            .unwrap();
        let said = text(&output.stderr);
        let expected = "descan: cannot write to standard output: No space left on device";
        assert!(said.lines().any(|line| line.starts_with(expected)), "{arguments:?}: {said}");
        assert_eq!(output.status.code(), Some(3), "{arguments:?}");
    }
}

#[test]
fn control_characters_in_names_are_escaped() {
    let hostile = DeviceSpec::new("x").name(b"\x1b[2J\x07").fixed(9).skips_address_resolution();
    let hostile = hostile.service("\u{202e}evil", "\u{9b}1");
    let folder = tempfile::tempdir().unwrap();
    let lines = log(&Scenario::new(125_000).with(hostile), 5);
    std::fs::write(folder.path().join("session.log"), lines).unwrap();
    for arguments in [&["scan", "file:session.log"][..], &["scan", "file:session.log", "--json"]] {
        let shown = text(&descan(arguments, folder.path()).stdout);
        assert!(shown.contains("x1B[2J"), "{shown}");
        assert!(!shown.chars().any(|c| c.is_control() && c != '\n'), "{shown:?}");
        assert!(!shown.contains('\u{202e}'));
    }
}

#[test]
fn control_characters_in_interface_name_are_escaped() {
    let folder = tempfile::tempdir().unwrap();
    let lines = "(1.0) ca\u{1b}[2Jn0 07183C01#\n(1.1) ca\u{9b}n0 07183C01#\n(1.2) can0 07183C01#\n";
    std::fs::write(folder.path().join("session.log"), lines).unwrap();
    let output = descan(&["scan", "file:session.log"], folder.path());
    let shown = text(&output.stdout) + &text(&output.stderr);
    assert!(!shown.chars().any(|c| c.is_control() && c != '\n'), "{shown:?}");
    assert!(shown.contains("can0: ") && shown.contains("2 lines cannot be read"), "{shown}");
}

#[test]
fn scan_writes_des_json_and_never_overwrites() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log(&two_devices(), 5)).unwrap();
    let arguments = ["scan", "file:session.log", "--write", "found.json"];
    assert_eq!(descan(&arguments, folder.path()).status.code(), Some(0));
    let written = std::fs::read(folder.path().join("found.json")).unwrap();
    let document = descan::document::Document::parse(&written).unwrap();
    let listed: Vec<_> =
        document.entries().iter().map(|it| (it.name_text.as_str(), it.address)).collect();
    assert_eq!(listed, [("FEED", Some(12)), ("SENS", Some(13))]);
    let again = descan(&arguments, folder.path());
    assert_eq!(again.status.code(), Some(3));
    assert!(text(&again.stderr).contains("found.json: already exists; name another file"));
    let a_folder = descan(&["scan", "sim:drone", "--write", "."], folder.path());
    assert_eq!(a_folder.status.code(), Some(3));
    assert!(text(&a_folder.stderr).contains(".: is a folder; name a file in it"));
    assert_eq!(std::fs::read(folder.path().join("found.json")).unwrap(), written);
}

#[test]
fn scan_without_devices_writes_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let frame = |at: u32| format!("({}.{:03}) can0 181#{at:04X}\n", at / 50, at % 50 * 20);
    let frames: Vec<String> = (0..300).map(frame).collect();
    std::fs::write(folder.path().join("other.log"), frames.concat()).unwrap();
    let output = descan(&["scan", "file:other.log", "--write", "found.json"], folder.path());
    assert_eq!(output.status.code(), Some(0));
    let said = text(&output.stderr);
    assert!(said.contains("found.json: not written: no device with a name"), "{said}");
    assert!(!folder.path().join("found.json").exists());
}

#[test]
fn scan_table_names_all_uids_of_a_conflict() {
    let folder = tempfile::tempdir().unwrap();
    let beat = |at: usize| {
        let uid = ["8AFA6C972411", "9A5964000000"][at % 2];
        let id = 0x0718_0001 | (at * 29 % 128) << 10;
        format!("({}.{}) can0 {id:08X}#{uid}0400\n", at / 2, at % 2 * 4)
    };
    let frames: String = (0..30).map(beat).collect();
    std::fs::write(folder.path().join("both.log"), frames).unwrap();
    let output = descan(&["scan", "file:both.log"], folder.path());
    assert_eq!(output.status.code(), Some(1));
    let table = text(&output.stdout);
    let row = table.lines().find(|line| line.contains("CONFLICT")).unwrap();
    assert!(row.contains(" / "), "{row}");
}

#[test]
fn scan_with_file_lists_differences() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log(&two_devices(), 8)).unwrap();
    std::fs::write(
        folder.path().join("des.json"),
        r#"{"devices":[{"name":"FEED","address":16,"static":true},{"name":"GONE","address":40,"static":true},{"name":"SENS","address":13,"static":true}]}"#,
    )
    .unwrap();
    let report = json(&descan(&["scan", "file:session.log", "--json"], folder.path()));
    assert_eq!(report["file"]["ok"], true);
    assert_eq!(report["file"]["entries"], 3);
    let file = |name: &str| {
        let devices = report["devices"].as_array().unwrap();
        devices.iter().find(|it| it["name"] == name).unwrap()["file"].clone()
    };
    let says = |address: u8, agrees: bool| serde_json::json!({ "listed": true, "address": address, "static": true, "agrees": agrees });
    assert_eq!(file("FEED"), says(16, false));
    assert_eq!(file("SENS"), says(13, true));
    let kinds: Vec<&str> = report["findings"]
        .as_array()
        .unwrap()
        .iter()
        .map(|finding| finding["kind"].as_str().unwrap())
        .collect();
    assert!(kinds.contains(&"wrong-address") && kinds.contains(&"missing"), "{kinds:?}");
}

#[test]
fn broken_file_error_has_line_and_column() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log(&two_devices(), 3)).unwrap();
    std::fs::write(folder.path().join("des.json"), "{\"devices\": [\n  { \"name\": }\n]}").unwrap();
    let report = json(&descan(&["scan", "file:session.log", "--json"], folder.path()));
    assert_eq!(report["file"]["ok"], false);
    let error = report["file"]["error"].as_str().unwrap();
    assert_eq!(error, "line 2, column 13: expected value");
    let said = String::from_utf8(descan(&["scan", "file:session.log"], folder.path()).stdout);
    let excerpt = "      { \"name\": }\n                ^\n";
    let whole = format!("\ndes.json: {error}\n{excerpt}");
    assert!(said.as_ref().unwrap().ends_with(&whole), "{said:?}");
}

#[test]
fn simulated_bus_scan_ends_within_seconds() {
    let folder = tempfile::tempdir().unwrap();
    let output = descan(&["scan", "sim:drone", "--json"], folder.path());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let report = json(&output);
    assert_eq!(report["buses"][0]["bitrate"], 1_000_000);
    assert_eq!(report["buses"][0]["address"], 0);
    let devices = report["devices"].as_array().unwrap();
    assert!(devices.len() >= 9);
    assert!(devices.iter().all(|device| device["services_known"] == true));
}

#[test]
fn bus_without_ack_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("empty.toml"), "bitrate = 125000\n").unwrap();
    let output = descan(&["scan", "sim:empty.toml", "--time", "3", "--json"], folder.path());
    let said = text(&output.stderr);
    assert!(said.contains("no ACK"), "{said}");
    assert_eq!(json(&output)["devices"], serde_json::json!([]));
}

#[test]
fn bus_off_controller_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("noise.toml"), "bitrate = 125000\nerror_rate = 1.0\n")
        .unwrap();
    let output = descan(&["scan", "sim:noise.toml", "--time", "3"], folder.path());
    let said = text(&output.stderr);
    assert!(said.contains("bus-off"), "{said}");
    assert!(text(&output.stdout).contains("bus-off"));
}

#[test]
fn word_that_is_like_no_command_has_no_suggestion() {
    for word in ["foo", "no", "x"] {
        let said = text(&descan(&[word], Path::new("/")).stderr);
        assert!(said.contains(&format!("{word} is not a command or a bus; ")), "{said}");
        assert!(!said.contains("did you mean"), "{said}");
    }
}

#[test]
fn invalid_arguments_are_one_line_with_the_fix() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("folder")).unwrap();
    for (arguments, hint) in [
        (&["scan", "--jsn"][..], "--json"),
        (&["session.logg"], "session.logg: file not found; check the name"),
        (&["folder"], "folder is a folder; name a log in it: descan folder/session.log"),
        (&["help", "scenario"], "did you mean scenarios?"),
        (&["scna", "can0"], "did you mean the command descan scan?"),
        (&["boiler"], "boiler is not a command or a bus"),
        (&["scan", "bus"], "bus is not a command or a bus"),
        (&["scan", "candump"], "candump is not a command or a bus"),
        (&["scan", "sim:boiler", "--for", "3", "--time", "3"], "--time"),
        (&["scan", "file:session.log", "--for", "3"], "--for needs a live bus"),
        (
            &["scan", "--time", "soon"],
            "a number of seconds, 0.001 to 1000000 (see descan scan --help)",
        ),
        (&["prove", "sim:boiler", ""], "a name has at least one character"),
        (&["restart", "sim:boiler", "", "--yes"], "a name has at least one character"),
        (&["sim", "udp:", "--device", ""], "a name has at least one character"),
        (&["prove", "can0"], "<DEVICE>; usage: descan prove <BUS> <DEVICE>"),
        (
            &["send", "can0", "--to", "3"],
            "unexpected argument '--to' found (see descan send --help)",
        ),
        (&["scan", "can0:125k"], "sudo ip link set can0 up type can bitrate 125000"),
        (&["--address", "200"], "0 to 127"),
        (&["demo", "submarine"], "boiler"),
        (&["demo", "--capture", "64"], "a size like 64M or 2G, 1M to 64G"),
        (&["can0", "--capture", "100G"], "a size like 64M or 2G, 1M to 64G"),
        (&["scan", "-", "-"], "only once"),
        (&["scan", "can0", "can0"], "can0 is the same bus as can0"),
        (&["scan", "slcan:/dev/ttyS0@125000", "slcan:/dev/ttyS0"], "the same bus"),
        (&["sim", "sim:boiler"], "descan demo"),
        (&["sim", "udp:", "--scenario", "s.toml", "--profile", "p.toml"], "--profile"),
        (&["demo"], "descan scan or descan watch"),
    ] {
        let output = descan(arguments, folder.path());
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert!(said.starts_with("descan: ") && said.contains(hint), "{arguments:?}: {said}");
        assert!(output.stdout.is_empty());
    }
}

#[test]
fn list_of_buses_is_printed_without_a_terminal() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [&[][..], &["nocan7"]] {
        let output = descan(arguments, folder.path());
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert!(said.contains("descan scan or descan watch"), "{said}");
        let list = text(&output.stdout);
        assert!(list.contains("Simulated\n  sim:boiler "), "{list}");
        assert!(!list.contains('\x1b'), "{list}");
    }
}

#[test]
fn scan_table_has_the_headlines_and_times_of_the_screen() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = Scenario::builtin("boiler").unwrap();
    std::fs::write(folder.path().join("session.log"), log(&scenario, 45)).unwrap();
    let output = descan(&["scan", "file:session.log"], folder.path());
    let table = text(&output.stdout);
    let headline = table.lines().find(|line| line.starts_with("confirmed Address 14: SPARE01 "));
    let headline = headline.unwrap_or_else(|| panic!("{table}"));
    let joined = headline.split("joined ").nth(1).and_then(|rest| rest.split(',').next());
    let joined = joined.unwrap_or_else(|| panic!("{headline}"));
    assert!(headline.contains(", conflicts with BOILER03 (since "), "{headline}");
    for kind in ["one-address-two-identities", "same-name-same-address"] {
        let line = format!("  confirmed {kind}, since {joined}\n");
        assert!(table.contains(&line), "{line}{table}");
    }
    assert!(table.contains("  Two devices answer as ACT at address 14.\n"), "{table}");
    let watched = descan(&["watch", "file:session.log"], folder.path());
    let lines = text(&watched.stdout);
    let line = lines.lines().find(|line| line.contains("confirmed: ")).unwrap();
    assert!(line.contains("SPARE01 joined, conflicts with BOILER03 (since "), "{line}");
    assert!(line.contains("). Two devices "), "{line}");
}

#[test]
fn empty_log_names_the_way_out() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("empty.log"), "").unwrap();
    for (input, way_out) in
        [("empty.log", "check that it is the right log"), ("-", "candump -L can0 | descan scan -")]
    {
        let output = descan(&["scan", input], folder.path());
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{said}");
        assert!(said.contains("0 frames; ") && said.contains(way_out), "{said}");
    }
}

#[test]
fn input_without_frames_ends_with_its_cause() {
    use std::io::Write;
    let folder = tempfile::tempdir().unwrap();
    let scan = |input: &str| {
        let output = descan(&["scan", input], folder.path());
        (output.status.code(), text(&output.stderr))
    };
    let (code, said) = scan("file:/dev/zero");
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains("no line end in 16 MB"), "{said}");
    assert!(said.contains("use candump, pcapng, ASC, BLF, TRC, CSV, SQLite or MF4"), "{said}");
    // As from a pipe that stays open.
    let mut child = Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(["scan", "-"])
        .current_dir(folder.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let block = vec![0; 1 << 20];
    // The reader ends before the writer.
    let written = (0..100).take_while(|_| stdin.write_all(&block).is_ok()).count();
    assert!(written < 40, "{written} MB were read");
    let output = child.wait_with_output().unwrap();
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.contains("the line is too long"), "{said}");
    drop(stdin);
}

#[test]
fn unusable_input_is_named_and_exits_3() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("odd.toml"), "bitrate = 125000\nnoise = 1\n").unwrap();
    std::fs::write(folder.path().join("bad.toml"), "framing = \"morse\"").unwrap();
    std::fs::write(folder.path().join("words.log"), "hello\n").unwrap();
    for (arguments, hint) in [
        (&["scan", "file:nothing.log"][..], "nothing.log"),
        (&["scan", "nothing.log"], "cannot be read: No such file or directory; check the name"),
        (&["watch", "./"], "cannot be read: is a directory; name a log in it"),
        (&["scan", "words.log"], "use candump, pcapng, ASC, BLF, TRC, CSV, SQLite or MF4"),
        (&["scan", "sim:nothing"], "boiler"),
        (&["scan", "sim:boiler", "--profile", "nothing.toml"], "file not found"),
        (&["scan", "sim:boiler", "--profile", "bad.toml"], "morse"),
        (&["scan", "sim:odd.toml"], "line 2, column 1: unknown field `noise`"),
        (&["sim", "udp:", "--scenario", "odd.toml"], "odd.toml: TOML parse error at line 2"),
        // Named once.
        (
            &["kit", "--name", "X", "--write", "words.log"],
            "descan: words.log/des.h: parent is a file, not a folder",
        ),
        (
            &["fleet", "--broker", "mqtt://127.0.0.1:1", "--credentials", "nothing", "--json"],
            "descan: nothing: file not found",
        ),
    ] {
        let output = descan(arguments, folder.path());
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{arguments:?}: {said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert!(said.contains(hint), "{arguments:?}: {said}");
    }
}

#[test]
fn help_has_examples_and_closed_pipe_is_no_error() {
    let folder = tempfile::tempdir().unwrap();
    let help = descan(&["--help"], folder.path());
    assert_eq!(help.status.code(), Some(0));
    assert!(text(&help.stdout).contains("descan scan can0 --json"));
    let completions = text(&descan(&["completions", "bash"], folder.path()).stdout);
    assert!(completions.contains("descan__subcmd__watch"), "{completions}");
    let manual = text(&descan(&["man"], folder.path()).stdout);
    assert!(manual.contains(".TH") && manual.contains("descan\\-watch(1)"), "{manual}");
    let schema: Value = serde_json::from_slice(&descan(&["schema"], folder.path()).stdout).unwrap();
    assert!(schema["$schema"].as_str().unwrap().contains("2020-12"));
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let status = Command::new(env!("CARGO_BIN_EXE_descan"))
        .arg("schema")
        .stdout(writer)
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    assert_eq!((status.status.code(), text(&status.stderr)), (Some(0), String::new()));
}

#[test]
fn frames_are_printed_in_candump_format() {
    let mut line = Vec::new();
    let frame = Frame::classic(0x0201_5402, &[4, 0x44]);
    write_line(&mut line, Epoch::from_unix_micros(1_436_509_052_249_713), "can0", &frame).unwrap();
    assert_eq!(text(&line), "(1436509052.249713) can0 02015402#0444\n");
}

#[test]
fn file_without_log_lines_is_unusable() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("notes.txt"), "hello\nworld\n").unwrap();
    std::fs::write(folder.path().join("silent.log"), "").unwrap();
    for command in ["scan", "watch"] {
        let output = descan(&[command, "file:notes.txt"], folder.path());
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{command}: {said}");
        assert!(
            said.contains("2 lines cannot be read") && said.contains("use candump, pcapng"),
            "{said}"
        );
        let output = descan(&[command, "file:silent.log"], folder.path());
        assert_eq!(output.status.code(), Some(0), "{command}: {}", text(&output.stderr));
    }
}

#[test]
fn log_report_omits_unknowns_and_cleared_remedies() {
    let folder = tempfile::tempdir().unwrap();
    // A spare ACT appears at 28 s and leaves at 50 s.
    let scenario = Scenario::builtin("boiler").unwrap();
    std::fs::write(folder.path().join("session.log"), log(&scenario, 75)).unwrap();
    let output = descan(&["scan", "file:session.log"], folder.path());
    let table = text(&output.stdout);
    assert!(table.starts_with("can0: bit rate unknown, ") && !table.contains("unknown, unknown"));
    assert!(table.contains("\ncleared ") && table.contains("No longer present."), "{table}");
    assert!(!table.contains("Switch one of them off"), "{table}");
}

#[test]
fn unwritable_output_ends_with_exit_code_without_panic() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log(&two_devices(), 12) + "garbage\n")
        .unwrap();
    std::fs::write(folder.path().join("broken.json"), "[\n oops").unwrap();
    let config = folder.path().join("config/descan");
    std::fs::create_dir_all(&config).unwrap();
    // Causes a warning on standard error.
    std::fs::write(config.join("keys.toml"), "rescan = 5").unwrap();
    for (arguments, code) in [
        (&["--help"][..], 0),
        (&["--nonsense"], 2),
        (&[], 2),
        (&["demo"], 2),
        (&["man"], 3),
        (&["schema"], 3),
        (&["completions", "bash"], 3),
        (&["scan", "file:session.log"], 3),
        (&["scan", "file:session.log", "--json", "--record", "copy.log"], 3),
        (&["scan", "sim:boiler", "--time", "1", "--write", "new.json"], 3),
        (&["check", "file:session.log"], 3),
        (&["check", "file:session.log", "--file", "broken.json"], 3),
        (&["watch", "file:session.log"], 3),
        (&["watch", "file:session.log", "--json"], 3),
        (&["watch", "sim:boiler", "--time", "1"], 3),
        (&["speed", "nocan7"], 3),
        (&["sim", "nocan7", "--time", "1"], 3),
    ] {
        let full = || std::fs::File::options().write(true).open("/dev/full").unwrap();
        let status = Command::new(env!("CARGO_BIN_EXE_descan"))
            .args(arguments)
            .current_dir(folder.path())
            .env("XDG_CONFIG_HOME", folder.path().join("config"))
            .stdin(Stdio::null())
            .stdout(full())
            .stderr(full())
            .status()
            .expect("the program starts");
        assert_eq!(status.code(), Some(code), "{arguments:?}");
    }
}

#[test]
fn incomplete_scan_says_why_on_stderr() {
    let folder = tempfile::tempdir().unwrap();
    let stderr = |arguments: &[&str]| text(&descan(arguments, folder.path()).stderr);
    let said = stderr(&["scan", "sim:boiler", "--time", "0.5"]);
    assert!(said.contains("not all responses arrived in time"), "{said}");
    let said = stderr(&["scan", "sim:boiler", "--listen-only", "--time", "2"]);
    assert!(said.contains("listen-only: no requests are sent"), "{said}");
    let said = stderr(&["scan", "sim:boiler", "--no-scan", "--time", "2"]);
    assert!(said.contains("--no-scan: no requests are sent"), "{said}");
}

#[test]
fn findings_on_several_buses_name_their_bus() {
    let folder = tempfile::tempdir().unwrap();
    let mut lines = two_boards_at_12();
    lines.push("(1436509066.000000) can1 00000002#0444455301".to_owned());
    std::fs::write(folder.path().join("session.log"), lines.join("\n") + "\n").unwrap();
    let output = text(&descan(&["scan", "file:session.log"], folder.path()).stdout);
    assert!(output.contains("confirmed one-address-two-names on can0, since "), "{output}");
}

#[test]
fn options_without_effect_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, named) in [
        (&["scan", "sim:boiler", "--time", "1", "--theme", "nope"][..], "--theme"),
        (&["watch", "sim:boiler", "--time", "1", "--speed", "10"], "--speed needs a log"),
        (&["scan", "sim:boiler", "--time", "1", "--speed", "10"], "--speed"),
        (&["scan", "sim:boiler", "sim:boiler", "--time", "1"], "the same bus as"),
    ] {
        let output = descan(arguments, folder.path());
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?} {said}");
        assert!(said.contains(named), "{said}");
    }
}

// ---- unchecked files and arguments ----

/// Tests files of settings, profiles and scenarios that never end, block, or are too long.
#[test]
fn only_short_regular_files_are_read_as_settings() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    nix::unistd::mkfifo(&at("pipe"), nix::sys::stat::Mode::S_IRWXU).unwrap();
    std::fs::write(at("long.toml"), "a = 1\n".repeat(200_000)).unwrap();
    std::fs::write(at("binary.toml"), b"\xFF\n").unwrap();
    std::fs::create_dir_all(at("config/descan/themes")).unwrap();
    for (file, cause) in [
        ("pipe", "not a regular file; name another one"),
        ("/dev/zero", "not a regular file; name another one"),
        (".", "is a folder; name a file in it"),
        ("long.toml", "larger than 1 MiB; check the file name"),
        ("binary.toml", "not UTF-8; save it as UTF-8"),
    ] {
        let scenario = format!("sim:{file}");
        for arguments in [
            &["scan", "sim:boiler", "--profile", file][..],
            &["scan", &scenario],
            &["sim", "vcan0", "--scenario", file],
        ] {
            let output = descan(arguments, folder.path());
            assert_eq!(output.status.code(), Some(3), "{arguments:?}");
            assert_eq!(text(&output.stderr), format!("descan: {file}: {cause}\n"));
        }
        for setting in ["config.toml", "keys.toml"] {
            let path = at("config/descan").join(setting);
            std::os::unix::fs::symlink(at(file), &path).unwrap();
            let said = text(&descan(&["scan", "sim:gone.toml"], folder.path()).stderr);
            assert!(said.contains(&format!("{setting}: {cause} (built-in")), "{said}");
            std::fs::remove_file(path).unwrap();
        }
    }
}

/// Contents of logs of other programs, their file names, and the words of the way out.
const FOREIGN_LOGS: [(&str, &[u8], &str); 5] = [
    ("session.log.bz2", b"BZh91AY&SY\x00\x00\x00", "bunzip2 -c"),
    ("logs.zip", b"PK\x03\x04\x14\x00\x00\x00", "a zip archive; unpack it"),
    ("bus.log", b"***BUSMASTER Ver 3.2.2***\n", "a BUSMASTER log; export it"),
    ("wide.log", b"\xff\xfe(\x001\x00)\x00\n\x00", "UTF-16 text; convert it: iconv"),
    ("logs.tar", &TAR, "a tar archive; unpack it: tar"),
];

/// The head of a tar archive.
const TAR: [u8; 512] = {
    let mut head = [0; 512];
    (head[0], head[257], head[258], head[259]) = (b'a', b'u', b's', b't');
    (head[260], head[261]) = (b'a', b'r');
    head
};

#[test]
fn foreign_log_is_named_with_its_conversion() {
    let folder = tempfile::tempdir().unwrap();
    for (name, content, hint) in FOREIGN_LOGS {
        std::fs::write(folder.path().join(name), content).unwrap();
        let file = format!("file:{name}");
        for (command, bus) in [("scan", &*file), ("watch", name), ("scan", "-")] {
            let output = Command::new(env!("CARGO_BIN_EXE_descan"))
                .args([command, bus])
                .current_dir(folder.path())
                .env("XDG_CONFIG_HOME", folder.path().join("config"))
                .stdin(std::fs::File::open(folder.path().join(name)).unwrap())
                .output()
                .unwrap();
            let said = text(&output.stderr);
            assert_eq!(output.status.code(), Some(3), "{command} {bus} {name}: {said}");
            assert_eq!(said.lines().count(), 1, "{said}");
            assert!(said.contains(hint) && !said.contains("0 frames"), "{name}: {said}");
        }
    }
}

/// Returns the text if it has no control characters but line ends.
fn without_control_characters(bytes: &[u8]) -> String {
    let text = text(bytes);
    assert!(text.chars().all(|c| c == '\n' || descan::text::is_printable(c)), "{text:?}");
    text
}

#[test]
fn escape_codes_in_the_program_name_are_not_printed() {
    use std::os::unix::process::CommandExt as _;
    for argument in ["--help", "--bogus", "scan"] {
        let mut descan = std::process::Command::new(env!("CARGO_BIN_EXE_descan"));
        let output = descan.arg0("\u{9b}X").arg(argument).output().unwrap();
        without_control_characters(&output.stdout);
        without_control_characters(&output.stderr);
    }
}

/// Tests escape codes in arguments, file names, settings, profiles and scenarios: they would change
/// the terminal, or its title, or the order of characters.
#[test]
fn escape_codes_of_the_user_are_escaped() {
    const CODES: &str = "\x1b]0;owned\x07\u{9b}2J\u{202e}";
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let toml = format!("{CODES}.toml");
    std::fs::write(at(&toml), r#""\u001b]0;owned\u0007" = 1"#).unwrap();
    std::fs::write(at(&format!("{CODES}.json")), "[").unwrap();
    std::fs::create_dir_all(at("config/descan")).unwrap();
    for setting in ["config.toml", "keys.toml"] {
        std::fs::copy(at(&toml), at("config/descan").join(setting)).unwrap();
    }
    let with = |start: &str| format!("{start}{CODES}");
    let broken = [
        vec![with("--bogus")],
        vec![with("")],
        vec!["scan".into(), with("bus:")],
        vec!["scan".into(), with("can")],
        vec!["scan".into(), with("file:")],
        vec!["scan".into(), with("sim:")],
        vec!["scan".into(), with("slcan:/dev/")],
        vec!["scan".into(), with("socketcand://")],
        vec!["scan".into(), "sim:boiler".into(), "--profile".into(), with("")],
        vec!["scan".into(), "sim:boiler".into(), "--profile".into(), toml.clone()],
        vec!["scan".into(), format!("sim:{toml}")],
        vec!["scan".into(), "sim:boiler".into(), "--address".into(), with("")],
        vec!["scan".into(), "sim:boiler".into(), "--write".into(), format!("{CODES}/x")],
        vec!["scan".into(), "sim:boiler".into(), "--record".into(), with("")],
        vec!["check".into(), "sim:boiler".into(), "--file".into(), with("")],
        vec!["check".into(), "sim:boiler".into(), "--file".into(), format!("{CODES}.json")],
        vec!["watch".into(), "sim:boiler".into(), "--filter".into(), with("at:")],
        vec!["sim".into(), "vcan0".into(), "--scenario".into(), with("")],
        vec!["sim".into(), with("can")],
        vec!["speed".into(), with("can")],
        vec!["help".into(), with("")],
        vec!["man".into(), with("")],
        vec!["completions".into(), with("")],
    ];
    for arguments in &broken {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let output = descan(&arguments, folder.path());
        let said = without_control_characters(&output.stderr);
        assert!(matches!(output.status.code(), Some(2 | 3)), "{arguments:?}: {said}");
        // The parser of the arguments drops complete escape sequences itself.
        let is_shown = ["\\xC2\\x9B2", "\\u{9b}2"].iter().any(|code| said.contains(code));
        assert!(is_shown, "{arguments:?}: {said}");
        without_control_characters(&output.stdout);
    }
}

/// Tests output that is not an error: names of buses and files, in text and JSON.
#[test]
fn escape_codes_in_names_of_buses_are_escaped() {
    let folder = tempfile::tempdir().unwrap();
    let name = "\u{9b}2J\x1b[2J.toml";
    let scenario = "bitrate = 125000\n[[device]]\nname = \"FEED\"\naddress = { preferred = 12 }\n";
    std::fs::write(folder.path().join(name), scenario).unwrap();
    let bus = format!("sim:{name}");
    let output = descan(&["scan", &bus, "--time", "1"], folder.path());
    let said = without_control_characters(&output.stdout);
    assert!(said.contains("sim:\\xC2\\x9B2J\\x1B[2J.toml"), "{said}");
    without_control_characters(&output.stderr);
    let output = descan(&["scan", &bus, "--time", "1", "--json"], folder.path());
    without_control_characters(&output.stdout);
    assert_eq!(json(&output)["buses"][0]["name"], bus);
}

#[test]
fn name_of_many_combining_marks_is_cut_in_tables() {
    let folder = tempfile::tempdir().unwrap();
    let name = format!("A{}", "\u{301}".repeat(499));
    let device = DeviceSpec::new(&name).fixed(12).skips_address_resolution();
    let recorded = log(&Scenario::new(125_000).with(device), 12);
    std::fs::write(folder.path().join("session.log"), recorded).unwrap();
    let report = json(&descan(&["scan", "session.log", "--json"], folder.path()));
    let devices = report["devices"].as_array().unwrap();
    assert!(devices.iter().any(|it| it["name"] == name), "whole in JSON: {report:.200}");
    let table = text(&descan(&["scan", "session.log"], folder.path()).stdout);
    let row = table.lines().find(|line| line.contains("A\u{301}")).unwrap();
    assert_eq!(row.chars().filter(|c| *c == '\u{301}').count(), descan::text::MAX_MARKS);
    assert!(row.contains('…'), "{row}");
}

#[test]
fn log_is_opened_by_its_name_alone() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("logs")).unwrap();
    for name in ["session.log", "recorded", "logs/today"] {
        std::fs::write(folder.path().join(name), log(&two_devices(), 12)).unwrap();
        let report = json(&descan(&["scan", name, "--json"], folder.path()));
        let devices = report["devices"].as_array().unwrap();
        assert!(devices.iter().any(|device| device["name"] == "FEED"), "{name}: {report}");
    }
}

#[test]
fn scan_waits_for_devices_that_boot() {
    let folder = tempfile::tempdir().unwrap();
    let late = "bitrate = 125000\n\
        [[device]]\nname = \"FEED\"\naddress = { fixed = 12 }\nsettled = true\n\
        [[device]]\nname = \"LATE\"\naddress = { fixed = 20 }\nsettled = true\npower_on = 9.0\n";
    std::fs::write(folder.path().join("late.toml"), late).unwrap();
    let scan = |more: &[&str]| {
        let output = descan(&[&["scan", "sim:late.toml", "--json"], more].concat(), folder.path());
        let names: Vec<String> = json(&output)["devices"]
            .as_array()
            .unwrap()
            .iter()
            .map(|device| device["name"].as_str().unwrap().to_owned())
            .collect();
        (names, output.status.code(), text(&output.stderr))
    };
    let (names, code, _) = scan(&[]);
    assert_eq!((names.len(), code), (1, Some(0)), "without it the scan ends before");
    let (names, code, said) = scan(&["--expect", "2", "--time", "60"]);
    assert_eq!((names, code, &*said), (vec!["FEED".to_owned(), "LATE".to_owned()], Some(0), ""));
    let (names, code, said) = scan(&["--expect", "2", "--time", "4"]);
    assert_eq!((names.len(), code), (1, Some(1)), "{said}");
    assert!(said.contains("expected 2 devices, 1 present and named"), "{said}");
    let (names, code, said) = scan(&["--for", "13"]);
    assert_eq!((names.len(), code, &*said), (2, Some(0), ""));
}
