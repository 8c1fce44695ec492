//! `descan watch`, from outside: the lines it prints, when it prints them, and how it ends.

use crate::common::inspection::log;
use crate::common::program::command;
use crate::common::watch_process::Watching;
use descan::app::{App, AppEvent, AppOptions, FileIndex, FileReading, Filter, RowKind};
use descan::diagnostic::Diagnostic;
use descan::discovery::Config;
use descan::finding::{FindingKind, FindingState};
use descan::frame::{BusIndex, CanId, Frame};
use descan::sim::{DeviceSpec, Fault, Scenario, Sim};
use descan::status::{BusStatus, Link};
use descan::time::Instant;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::AsFd;
use std::path::Path;
use std::process::{Output, Stdio};
use std::time::Duration;

/// A log in which FEED appears at 12, reports an error for a second, reboots, is overdue, is lost
/// for a while, and finally returns at 31, where the file lists it.
const LOG: &str = "\
(1436509052.100000) can0 07180001#8AFA6C9724110400
(1436509052.500000) can0 05180002#06014645454400
(1436509052.600000) can0 05180002#100A020044455300
(1436509052.700000) can0 05180002#21312E3000
(1436509053.100000) can0 07180401#8AFA6C9724110400
(1436509054.100001) can0 07180801#8AFA6C9724110500
(1436509055.100000) can0 07180C01#8AFA6C9724110400
(1436509056.100000) can0 07181001#8AFA6C9724110400
(1436509058.450000) can0 0718A001#8AFA6C9724110400
(1436509058.500000) can0 1F19FC2A#01FE
(1436509059.450000) can0 0718A401#8AFA6C9724110400
(1436509060.450000) can0 0718A801#8AFA6C9724110400
(1436509063.450000) can0 0718AC01#8AFA6C9724110400
(1436509070.450000) can0 0718B001#8AFA6C9724110400
(1436509071.450000) can0 0718B401#8AFA6C9724110400
(1436509074.000000) can0 073EA001#8AFA6C9724110400
(1436509075.000000) can0 073EA401#8AFA6C9724110400
";
const FILE: &str = r#"{"devices":[{"name":"FEED","address":31,"static":true}]}"#;

/// The output of `watch --json` for it, byte for byte.
const TOLD: &str = r#"{"time":1436509052.1,"event":"file","file":{"path":"des.json","ok":true,"entries":1,"error":null}}
{"time":1436509052.1,"event":"bus","bus":{"name":"can0","bitrate":null,"state":"unknown","frames":1,"errors":0,"lost":0,"load":null,"address":null,"lost_where":{"kernel":0,"queue":0,"adapter":0},"not_sent":0,"unreadable":0,"verdict":"silent"}}
{"time":1436509052.1,"event":"appeared","bus":"can0","address":12,"name":null}
{"time":1436509052.1,"event":"mode","bus":"can0","address":12,"name":null,"mode":"WORK","from":null}
{"time":1436509052.5,"event":"named","bus":"can0","address":12,"name":"FEED"}
{"time":1436509052.5,"event":"finding","bus":"can0","address":12,"name":"FEED","finding":{"kind":"wrong-address","confidence":"confirmed","bus":"can0","address":12,"addresses":[12],"names":["FEED"],"uids":[],"first":1436509052.5,"last":1436509052.5,"cleared_at":null,"superseded_by":null,"evidence":[],"text":"FEED is at address 12; the file pins it to 31.","remedy":"Move the device to 31, or change the file to 12."}}
{"time":1436509052.7,"event":"services","bus":"can0","address":12,"name":"FEED","services":[{"index":0,"name":"DES","version":"1.0","extra":[]}],"changed":false,"other_device":false}
{"time":1436509054.100001,"event":"mode","bus":"can0","address":12,"name":"FEED","mode":"UFUNC","from":"WORK"}
{"time":1436509055.1,"event":"mode","bus":"can0","address":12,"name":"FEED","mode":"WORK","from":"UFUNC"}
{"time":1436509058.5,"event":"debug","bus":"can0","address":12,"name":"FEED","code":42,"code_name":null,"data":"01FE","fields":null}
{"time":1436509059.45,"event":"rebooted","bus":"can0","address":12,"name":"FEED"}
{"time":1436509062.95,"event":"stale","bus":"can0","address":12,"name":"FEED"}
{"time":1436509063.45,"event":"returned","bus":"can0","address":12,"name":"FEED","was":"stale"}
{"time":1436509065.95,"event":"stale","bus":"can0","address":12,"name":"FEED"}
{"time":1436509068.45,"event":"lost","bus":"can0","address":12,"name":"FEED"}
{"time":1436509068.45,"event":"finding","bus":"can0","address":12,"name":"FEED","finding":{"kind":"wrong-address","confidence":"cleared","bus":"can0","address":12,"addresses":[12],"names":["FEED"],"uids":[],"first":1436509052.5,"last":1436509052.5,"cleared_at":1436509068.45,"superseded_by":null,"evidence":[],"text":"FEED is at address 12; the file pins it to 31.","remedy":"Move the device to 31, or change the file to 12."}}
{"time":1436509068.45,"event":"finding","bus":"can0","address":31,"name":"FEED","finding":{"kind":"missing","confidence":"confirmed","bus":"can0","address":31,"addresses":[31],"names":["FEED"],"uids":[],"first":1436509068.45,"last":1436509068.45,"cleared_at":null,"superseded_by":null,"evidence":[],"text":"FEED (at 31) is listed but not on the bus: last seen at 12, 5s ago.","remedy":""}}
{"time":1436509070.45,"event":"returned","bus":"can0","address":12,"name":"FEED","was":"lost"}
{"time":1436509070.45,"event":"finding","bus":"can0","address":31,"name":"FEED","finding":{"kind":"missing","confidence":"cleared","bus":"can0","address":31,"addresses":[31],"names":["FEED"],"uids":[],"first":1436509068.45,"last":1436509068.45,"cleared_at":1436509070.45,"superseded_by":null,"evidence":[],"text":"FEED (at 31) is listed but not on the bus: last seen at 12, 7s ago.","remedy":""}}
{"time":1436509070.45,"event":"finding","bus":"can0","address":12,"name":"FEED","finding":{"kind":"wrong-address","confidence":"confirmed","bus":"can0","address":12,"addresses":[12],"names":["FEED"],"uids":[],"first":1436509070.45,"last":1436509070.45,"cleared_at":null,"superseded_by":null,"evidence":[],"text":"FEED is at address 12; the file pins it to 31.","remedy":"Move the device to 31, or change the file to 12."}}
{"time":1436509073.95,"event":"stale","bus":"can0","address":12,"name":"FEED"}
{"time":1436509074.0,"event":"appeared","bus":"can0","address":31,"name":null}
{"time":1436509074.0,"event":"mode","bus":"can0","address":31,"name":null,"mode":"WORK","from":null}
{"time":1436509074.0,"event":"moved","bus":"can0","address":31,"name":"FEED","from":12}
{"time":1436509074.0,"event":"finding","bus":"can0","address":12,"name":"FEED","finding":{"kind":"wrong-address","confidence":"cleared","bus":"can0","address":12,"addresses":[12],"names":["FEED"],"uids":[],"first":1436509070.45,"last":1436509070.45,"cleared_at":1436509074.0,"superseded_by":null,"evidence":[],"text":"FEED is at address 12; the file pins it to 31.","remedy":"Move the device to 31, or change the file to 12."}}
{"time":1436509075.0,"event":"bus","bus":{"name":"can0","bitrate":null,"state":"unknown","frames":17,"errors":0,"lost":0,"load":null,"address":null,"lost_where":{"kernel":0,"queue":0,"adapter":0},"not_sent":0,"unreadable":0,"verdict":"des"}}
"#;

const IN_WORDS: &str = "\
06:17:32.100 des.json         1 entry
06:17:32.100 can0             open
06:17:32.100  12 ?            appeared
06:17:32.500  12 FEED         identified as FEED
06:17:32.500  12 FEED         confirmed: FEED (BOILER01) is pinned to 31 in des.json. FEED is at address 12; the file pins it to 31.
06:17:32.700  12 FEED         1 service
06:17:34.100  12 FEED         WORK → UFUNC
06:17:35.100  12 FEED         UFUNC → WORK
06:17:38.500  12 FEED         debug message 0x02A 01 FE
06:17:39.450  12 FEED         rebooted
06:17:42.950  12 FEED         stale: heartbeat overdue
";

fn watch(arguments: &[&str], folder: &Path) -> Output {
    let arguments = [&["watch"], arguments].concat();
    command(&arguments, folder).output().expect("the program starts")
}

fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).expect("output is UTF-8")
}

fn values(output: &[u8]) -> Vec<Value> {
    text(output).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// A folder with the log and the file.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), LOG).unwrap();
    std::fs::write(folder.path().join("des.json"), FILE).unwrap();
    folder
}

#[test]
fn log_events_are_printed_line_by_line() {
    let folder = folder();
    let output = watch(&["file:session.log", "--json"], folder.path());
    assert_eq!(text(&output.stderr), "");
    assert_eq!(output.status.code(), Some(0));
    for (at, (told, expected)) in text(&output.stdout).lines().zip(TOLD.lines()).enumerate() {
        assert_eq!(told, expected, "line {}", at + 1);
    }
    assert_eq!(text(&output.stdout), TOLD);
    let output = watch(&["file:session.log"], folder.path());
    assert_eq!(output.status.code(), Some(0));
    let words = text(&output.stdout);
    assert!(words.starts_with(IN_WORDS), "{words}");
    assert!(words.ends_with("06:17:55.000 can0             end of log\n"), "{words}");
}

#[test]
fn guide_example_matches_the_output() {
    let guide = include_str!("../../src/guide/scripting.md");
    let example = guide.split("```text\n").nth(1).unwrap().split("```").next().unwrap();
    for line in example.lines() {
        assert!(IN_WORDS.lines().any(|told| told == line), "{line}");
    }
    let object = guide.lines().find(|it| it.starts_with(r#"{"time""#)).unwrap();
    // With a shorter name, for 80 columns.
    assert!(TOLD.lines().any(|told| told.replace("FEED", "ACT") == object), "{object}");
    let table = guide.split("| event |").nth(1).unwrap();
    let rows = table.lines().skip(2).take_while(|line| line.starts_with('|'));
    let words: Vec<&str> =
        rows.flat_map(|row| row.split('|').nth(1).unwrap().split('`').skip(1).step_by(2)).collect();
    for value in values(TOLD.as_bytes()) {
        assert!(words.contains(&value["event"].as_str().unwrap()), "{value}");
    }
    assert_eq!(words.len(), 18);
}

#[test]
fn events_of_one_frame_share_one_line() {
    // SENS has 12. FEED claims it, gives way, and claims 31.
    let log = "\
(1436509052.100000) can0 07181001#C35B700000000400
(1436509052.300000) can0 05180002#060153454E5300
(1436509053.100000) can0 07182001#C35B700000000400
(1436509054.100000) can0 07183001#C35B700000000400
(1436509054.500000) can0 1718B001#8AFA6C9724110100
(1436509055.100000) can0 07184001#C35B700000000400
(1436509056.100000) can0 07185001#C35B700000000400
(1436509056.900000) can0 173EC001#8AFA6C9724110100
(1436509057.000000) can0 153E0002#06014645454400
(1436509057.100000) can0 07186001#C35B700000000400
(1436509057.900000) can0 073ED001#8AFA6C9724110400
(1436509058.100000) can0 07187001#C35B700000000400
(1436509058.900000) can0 073EE001#8AFA6C9724110400
(1436509059.100000) can0 07188001#C35B700000000400
(1436509059.900000) can0 073EF001#8AFA6C9724110400
(1436509060.100000) can0 07189001#C35B700000000400
(1436509060.900000) can0 073F0001#8AFA6C9724110400
(1436509061.100000) can0 0718A001#C35B700000000400
";
    let folder = folder();
    std::fs::write(folder.path().join("session.log"), log).unwrap();
    let output = watch(&["file:session.log"], folder.path());
    let of_resolution = text(&output.stdout)
        .lines()
        .filter(|line| {
            ["claims", "gave up", "moved", "appeared"].iter().any(|it| line.contains(it))
        })
        .map(|line| {
            line.split_once(' ').unwrap().1.split_whitespace().collect::<Vec<_>>().join(" ")
        });
    assert_eq!(
        of_resolution.collect::<Vec<_>>(),
        [
            "12 ? appeared",
            "12 ? BOILER01 claims 12 (held by SENS)",
            "12 ? gave up 12 to SENS",
            "31 ? moved from 12, claims 31",
        ]
    );
}

#[test]
fn playback_speed_does_not_change_the_output() {
    let folder = folder();
    // The frame count of a line depends on how frames were batched, and the age of a device on when
    // it was last checked.
    let essence = |text: &str| -> Vec<Value> {
        let mut values = values(text.as_bytes());
        for value in &mut values {
            let member = if value["event"] == "bus" { "frames" } else { "text" };
            let event = value["event"].as_str().unwrap().to_owned();
            let object = value.get_mut(&event).and_then(Value::as_object_mut);
            object.and_then(|object| object.remove(member));
        }
        values
    };
    let timed = watch(&["file:session.log", "--json", "--speed", "50"], folder.path());
    assert_eq!(essence(text(&timed.stdout)), essence(TOLD));
    let mut piped = Watching::start(&["-", "--json"], folder.path());
    piped.write(LOG);
    piped.stdin = None;
    assert_eq!(essence(&piped.rest()), essence(TOLD));
    assert_eq!(piped.exit_code(), 0);
    // Much faster than its lines come.
    let mut slow = Watching::start(&["-", "--json", "--speed", "100000"], folder.path());
    let mut output = String::new();
    let half = LOG.len() / 2 + LOG[LOG.len() / 2..].find('\n').unwrap() + 1;
    slow.write(&LOG[..half]);
    while !output.contains("appeared") {
        output.push_str(&slow.line());
        output.push('\n');
    }
    slow.write(&LOG[half..]);
    slow.stdin = None;
    output += &slow.rest();
    assert_eq!(essence(&output), essence(TOLD));
    assert_eq!(slow.exit_code(), 0);
}

#[test]
fn log_events_have_log_time() {
    let folder = folder();
    for more in [&[][..], &["--speed", "20"]] {
        let arguments = [&["file:session.log", "--json", "--time", "12"], more].concat();
        let output = watch(&arguments, folder.path());
        assert_eq!(output.status.code(), Some(0));
        let last = values(&output.stdout).pop().unwrap();
        assert_eq!((&last["event"], &last["time"]), (&json!("returned"), &json!(1_436_509_063.45)));
    }
}

#[test]
fn standard_input_lines_are_reported_at_once() {
    let folder = folder();
    let mut lines = LOG.split_inclusive('\n');
    let mut watching = Watching::start(&["-", "--json"], folder.path());
    watching.write(lines.next().unwrap());
    assert_eq!(watching.event("appeared")["address"], 12);
    // A line that arrives in two pieces, and an invalid one.
    let (begin, end) = lines.next().unwrap().split_at(20);
    watching.write(begin);
    watching.write(end);
    watching.write("what?\n");
    assert_eq!(watching.event("named")["name"], "FEED");
    // The file is watched, too.
    std::fs::write(folder.path().join("des.json"), "[]").unwrap();
    assert_eq!(watching.event("file")["file"]["entries"], 0);
    assert_eq!(watching.event("finding")["finding"]["confidence"], "cleared");
}

#[test]
fn time_passes_without_input_lines() {
    let folder = folder();
    let profile = "[heartbeat]\nperiod_ms = 100\n";
    std::fs::write(folder.path().join("quick.toml"), profile).unwrap();
    let mut watching = Watching::start(&["-", "--json", "--profile", "quick.toml"], folder.path());
    watching.write(LOG.lines().next().unwrap());
    watching.write("\n");
    assert_eq!(watching.event("stale")["time"], 1_436_509_052.35);
    assert_eq!(watching.event("lost")["time"], 1_436_509_052.6);
    // A line that arrives late: its events are not dated before those already reported.
    watching.write("(1436509052.200000) can0 07180001#8AFA6C9724110400\n");
    let returned = watching.event("returned");
    assert_eq!(returned["was"], "lost");
    assert!(returned["time"].as_f64().unwrap() >= 1_436_509_052.6, "{returned}");
}

#[test]
fn signal_or_time_limit_exits_0() {
    let folder = folder();
    for signal in [Signal::SIGTERM, Signal::SIGINT] {
        // A log without lines so far; a log already reported; a bus.
        for (bus, lines) in [("-", ""), ("-", LOG), ("sim:boiler", "")] {
            let mut watching = Watching::start(&[bus], folder.path());
            watching.write(lines);
            if (bus, lines) == ("-", "") {
                // The program first installs its signal handlers; from then on signals end it
                // cleanly.
                while !handles(watching.id(), signal) {
                    std::thread::yield_now();
                }
            } else {
                watching.line();
            }
            watching.signal(signal);
            assert_eq!(watching.exit_code(), 0, "{signal} {bus}");
        }
    }
    for bus in ["sim:boiler", "-"] {
        let mut watching = Watching::start(&[bus, "--time", "0.3"], folder.path());
        assert_eq!(watching.exit_code(), 0, "{bus}");
    }
}

#[test]
fn signal_ends_watch_with_a_full_pipe() {
    let folder = tempfile::tempdir().unwrap();
    let debug = |at: u32| format!("({}.{:06}) can0 1F19FC2A#01FE\n", at / 1000, at % 1000 * 1000);
    // The heartbeat shows that the bus speaks DES.
    let heartbeat = "(1.000000) can0 07500401#A1A2A3A4A5A60400\n".to_owned();
    let lines = (1000..6000).map(debug);
    let lines: String = std::iter::once(heartbeat).chain(lines).collect();
    std::fs::write(folder.path().join("session.log"), lines).unwrap();
    let (reader, writer) = std::io::pipe().unwrap();
    let other_end = writer.try_clone().unwrap();
    let mut child = command(&["watch", "file:session.log", "--json"], folder.path())
        .stdout(writer)
        .spawn()
        .unwrap();
    // The pipe is full: the next write blocks forever.
    while is_writable(&other_end) {
        std::thread::yield_now();
    }
    kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGTERM).unwrap();
    let deadline = std::time::Instant::now() + Duration::from_mins(1);
    while child.try_wait().unwrap().is_none() {
        if std::time::Instant::now() > deadline {
            child.kill().unwrap();
            panic!("it does not end");
        }
        std::thread::yield_now();
    }
    assert_eq!(child.wait().unwrap().code(), Some(0));
    drop(reader);
}

/// Returns true if a pipe takes more bytes.
fn is_writable(pipe: &std::io::PipeWriter) -> bool {
    let mut watched = [PollFd::new(pipe.as_fd(), PollFlags::POLLOUT)];
    poll(&mut watched, PollTimeout::ZERO).unwrap() > 0
}

/// Returns true if a process has a handler for a signal.
fn handles(process: u32, signal: Signal) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap().trim();
    u64::from_str_radix(caught, 16).unwrap() >> (signal as u32 - 1) & 1 == 1
}

#[test]
fn closed_output_ends_watch() {
    let folder = folder();
    for arguments in [&["watch", "-"][..], &["watch", "sim:boiler", "--json"]] {
        let mut child = command(arguments, folder.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stdin = child.stdin.take().unwrap();
        stdin.write_all(LOG.lines().next().unwrap().as_bytes()).unwrap();
        stdin.write_all(b"\n").unwrap();
        let mut first = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut first).unwrap();
        assert!(first.contains("des.json"), "{first}");
        // Although no more events follow: the input stays open.
        assert_eq!(child.wait().unwrap().code(), Some(0));
        let mut said = String::new();
        child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        assert_eq!(said, "");
        drop(stdin);
    }
}

#[test]
fn conflicts_are_equal_in_watch_and_scan() {
    let board = |label: &str, uid: u8| {
        let uid = descan::wire::node::Uid([uid; 6]);
        let board =
            DeviceSpec::new("FEED").label(label).fixed(12).skips_address_resolution().uid(uid);
        board.service("AUGER", "2.1").fault(Fault::KeepsAddress)
    };
    let other = DeviceSpec::new("SENS").fixed(13).skips_address_resolution();
    let scenario = Scenario::new(125_000).with(board("a", 1)).with(board("b", 2)).with(other);
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.log"), log(&scenario, 20)).unwrap();
    let told = values(&watch(&["file:session.log", "--json"], folder.path()).stdout);
    let findings: Vec<&Value> = told.iter().filter(|it| it["event"] == "finding").collect();
    assert!(!findings.is_empty());
    let scan = command(&["scan", "file:session.log", "--json"], folder.path()).output().unwrap();
    let report: Value = serde_json::from_slice(&scan.stdout).unwrap();
    let reported = report["findings"].as_array().unwrap();
    assert!(reported.iter().any(|it| it["confidence"] == "confirmed"));
    for finding in reported {
        let which = |it: &Value| (it["kind"].clone(), it["address"].clone());
        let of_it: Vec<_> =
            findings.iter().filter(|it| which(&it["finding"]) == which(finding)).collect();
        let last = &of_it.last().expect("each is told")["finding"];
        let members = |it: &Value| it.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
        assert_eq!(members(last), members(finding));
        assert_eq!(
            (&last["confidence"], &last["first"]),
            (&finding["confidence"], &finding["first"])
        );
        assert!(last["evidence"][0]["frame"].as_str().unwrap().contains('#'));
        // Once per change.
        for pair in of_it.windows(2) {
            assert_ne!(pair[0]["finding"]["confidence"], pair[1]["finding"]["confidence"]);
            assert!(pair[0]["time"].as_f64() <= pair[1]["time"].as_f64());
        }
    }
    let times: Vec<f64> = told.iter().map(|it| it["time"].as_f64().unwrap()).collect();
    assert!(times.is_sorted(), "{times:?}");
}

/// Returns the log with a second device at 14 all the time, which sends heartbeats and has no
/// faults.
fn two_devices() -> String {
    let mut log = String::new();
    for line in LOG.lines() {
        log += line;
        log.push('\n');
        if let Some((time, heartbeat)) = line.split_once(" can0 0718") {
            // The same heartbeat from 14, with another UID.
            let (rnd7, _) = heartbeat.split_once('#').unwrap();
            let beat = format!("{time} can0 071C{rnd7}#9BFA6C9724110400\n");
            log += &beat;
        }
    }
    log
}

#[test]
fn filter_limits_the_output() {
    let folder = folder();
    std::fs::write(folder.path().join("two.log"), two_devices()).unwrap();
    let told = |filter: &str| {
        let output = watch(&["file:two.log", "--filter", filter], folder.path());
        assert_eq!(output.status.code(), Some(0));
        text(&output.stdout).to_owned()
    };
    let all = told("");
    let lines_with = |text: &str, part: &str| text.lines().filter(|it| it.contains(part)).count();
    assert!(lines_with(&all, "  14 ?") > 0 && lines_with(&all, " des.json ") > 0, "{all}");

    let feed = told("at:12");
    assert_eq!(lines_with(&feed, "  14 "), 0, "{feed}");
    assert_eq!(lines_with(&feed, " des.json "), 0, "{feed}");
    assert_eq!(lines_with(&feed, "  12 "), lines_with(&all, "  12 "), "{feed}");
    // Its move is an event of the address that it leaves.
    assert_eq!(lines_with(&feed, "moved from 12"), 1, "{feed}");
    // Events of the bus are always reported.
    assert_eq!(lines_with(&feed, " can0 "), lines_with(&all, " can0 "), "{feed}");

    let both = told("at:12,14");
    let devices = lines_with(&all, "  12 ") + lines_with(&all, "  14 ");
    assert_eq!(lines_with(&both, "  12 ") + lines_with(&both, "  14 "), devices, "{both}");
    let rest = told("!at:12,31");
    assert_eq!(lines_with(&rest, "  14 "), lines_with(&all, "  14 "), "{rest}");
    assert_eq!(lines_with(&rest, "  12 "), 0, "{rest}");
    let named = told("name:fee debug");
    assert_eq!(lines_with(&named, "  12 FEED"), 1, "{named}");
    assert!(named.contains("debug message 0x02A 01 FE"), "{named}");

    let output = watch(&["file:two.log", "--json", "--filter", "at:14"], folder.path());
    for value in values(&output.stdout) {
        let is_bus = value["event"] == "bus";
        assert!(is_bus || value["address"] == 14, "{value}");
    }
    let output = watch(&["file:two.log", "--json", "--filter", "at:12"], folder.path());
    let moved = values(&output.stdout).into_iter().find(|it| it["event"] == "moved").unwrap();
    assert_eq!((&moved["from"], &moved["address"]), (&12.into(), &31.into()));
}

#[test]
fn filter_never_hides_lost_frames_or_bus_state() {
    let bus = ("can0".to_owned(), Config::default());
    let options = AppOptions {
        buses: vec![bus],
        emit_events: true,
        event_filter: Filter::parse("at:12 name:feed", RowKind::Event).unwrap(),
        ..AppOptions::default()
    };
    let mut app = App::new(Instant::ZERO, options);
    let mut status = BusStatus { link: Link::Up, ..BusStatus::default() };
    let mut told = |status: &BusStatus| {
        app.handle_bus(Instant::ZERO, BusIndex(0), status.clone());
        let (mut lines, mut values) = (Vec::new(), Vec::new());
        while let Some(happening) = app.poll_app_event() {
            match happening {
                AppEvent::Line(line) => lines.push(line.text),
                AppEvent::Finding(_, finding) => values.push(finding.key.kind.name()),
                AppEvent::Bus(..) => values.push("bus"),
                _ => {}
            }
        }
        (lines.join("; "), values)
    };
    assert_eq!(told(&status), ("open".to_owned(), vec!["bus"]));
    status.kernel_drops = 1;
    let (lines, values) = told(&status);
    assert!(lines.contains("frames lost: the kernel's"), "{lines}");
    assert!(lines.contains("confirmed"), "{lines}");
    assert_eq!(values[..2], ["bus", "frames-lost"]);
    (status.link, status.fault) = (Link::Down, Some(Diagnostic::new("can0 is down")));
    assert_eq!(told(&status), ("can0 is down".to_owned(), vec!["bus"]));
}

#[test]
fn several_buses_have_a_bus_column() {
    let folder = tempfile::tempdir().unwrap();
    let lines = "(1.0) can0 07180001#8AFA6C9724110400\n(1.5) vcan-long 07180001#8AFA6C9724110400\n";
    std::fs::write(folder.path().join("session.log"), lines).unwrap();
    let output = watch(&["file:session.log"], folder.path());
    let shown = text(&output.stdout);
    assert!(shown.contains("00:00:01.500 vcan-long  12 ?            appeared\n"), "{shown}");
    assert!(shown.contains("00:00:01.500 can0                       end of log\n"), "{shown}");
    let told = values(&watch(&["file:session.log", "--json"], folder.path()).stdout);
    let appeared = told.iter().filter(|it| it["event"] == "appeared");
    assert_eq!(appeared.map(|it| &it["bus"]).collect::<Vec<_>>(), ["can0", "vcan-long"]);
}

#[test]
fn file_errors_are_printed_once() {
    let folder = folder();
    let file = "[\n  {\"name\": \"ACT\", \"address\": 300, \"static\": 1}\n]\n";
    std::fs::write(folder.path().join("des.json"), file).unwrap();
    let output = watch(&["file:session.log"], folder.path());
    let shown = text(&output.stdout);
    for told in ["`address` is 300", "`static` is a number"] {
        assert_eq!(shown.matches(told).count(), 1, "{shown}");
    }
    let told = values(&watch(&["file:session.log", "--json"], folder.path()).stdout);
    let shapes = told.iter().filter(|it| it["finding"]["kind"] == "file-shape");
    assert_eq!(shapes.count(), 2);

    std::fs::write(folder.path().join("des.json"), "[\n  {\"name\" \"ACT\"}\n]\n").unwrap();
    let output = watch(&["file:session.log"], folder.path());
    let shown = text(&output.stdout);
    let lines: Vec<&str> = shown.lines().collect();
    let at = lines.iter().position(|line| line.ends_with("line 2, column 11: expected `:`"));
    let at = at.unwrap_or_else(|| panic!("{shown}"));
    assert!(lines[at + 1].ends_with("des.json           {\"name\" \"ACT\"}"), "{shown}");
    assert!(lines[at + 2].ends_with("des.json                   ^"), "{shown}");
    assert_eq!(shown.matches("column 11").count(), 1, "{shown}");
}

#[test]
fn wrong_project_is_named_and_the_one_before_stays() {
    let folder = tempfile::tempdir().unwrap();
    let save = |text: &str| {
        std::fs::write(folder.path().join("new"), text).unwrap();
        std::fs::rename(folder.path().join("new"), folder.path().join("descan.toml")).unwrap();
    };
    let project = |rate: &str| format!("[[bus]]\nbus = \"sim:boiler\"\nbitrate = {rate}\n");
    save(&project("125000"));
    let mut command = command(&["watch", "--json"], folder.path());
    command.env("XDG_STATE_HOME", folder.path()).stdin(Stdio::null());
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut events = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
    let mut words = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    events.find(|line| line.contains("appeared")).unwrap();
    save(&project("125"));
    let said = words.next().unwrap();
    let place = "descan.toml: line 3, column 11: bitrate is 10000";
    assert!(said.contains(place), "{said}");
    assert!(said.ends_with("the project before stays in force"), "{said}");
    save(&project("250000"));
    let next = events.find(|line| line.contains("bit-rate-differs")).unwrap();
    assert!(next.contains("the project says 250 kbit"), "{next}");
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn control_characters_in_names_are_escaped() {
    let name = b"\x1b[2J\xff\\".to_vec();
    let hostile = DeviceSpec::new("x").name(&name).fixed(9).skips_address_resolution();
    let hostile = hostile.service("\u{202e}evil", "\u{9b}1");
    let folder = tempfile::tempdir().unwrap();
    let lines = log(&Scenario::new(125_000).with(hostile), 5);
    std::fs::write(folder.path().join("session.log"), lines).unwrap();
    for arguments in [&["file:session.log"][..], &["file:session.log", "--json"]] {
        let output = watch(arguments, folder.path());
        let shown = text(&output.stdout);
        assert!(shown.contains("x1B[2J"), "{shown}");
        assert!(!shown.chars().any(|c| c.is_control() && c != '\n'), "{shown:?}");
        assert!(!shown.contains('\u{202e}'));
    }
    let told = values(&watch(&["file:session.log", "--json"], folder.path()).stdout);
    let named = told.iter().find(|it| it["event"] == "named" && it["address"] == 9).unwrap();
    assert_eq!(named["name"], r"\x1B[2J\xFF\\");
}

#[test]
fn unusable_bus_is_one_error_line() {
    let folder = folder();
    for (arguments, code, hint) in [
        (&["--time", "soon"][..], 2, "a number of seconds"),
        (&["-", "-"], 2, "only once"),
        (&["sim:boiler", "file:session.log"], 2, "descan watch file:LOG"),
        (&["--jsn"], 2, "--json"),
        (&["file:nothing.log"], 3, "nothing.log"),
        (&["sim:nothing"], 3, "boiler"),
        (&["sim:boiler", "--profile", "nothing.toml"], 3, "file not found"),
    ] {
        let output = watch(arguments, folder.path());
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert!(said.starts_with("descan: ") && said.contains(hint), "{arguments:?}: {said}");
        assert_eq!(text(&output.stdout), "", "{arguments:?}");
    }
    let help = watch(&["--help"], folder.path());
    assert!(text(&help.stdout).contains("descan watch can0"));
}

/// Returns the findings reported by an app without a screen, on a simulated bus, in so many
/// seconds.
fn findings(scenario: &Scenario, file: &str, seconds: u64) -> Vec<(FindingKind, FindingState)> {
    let mut sim = Sim::new(scenario, 7);
    let station = sim.attach();
    let config = Config { bitrate: Some(scenario.bitrate), seed: 7, ..Config::default() };
    let buses = vec![("sim".to_owned(), config)];
    let options = AppOptions {
        buses,
        file_path: Some("des.json".into()),
        emit_events: true,
        ..AppOptions::default()
    };
    let mut app = App::new(Instant::ZERO, options);
    app.handle_file(
        Instant::ZERO,
        FileIndex::default(),
        FileReading::Content(Some(file.as_bytes().to_vec())),
    );
    let mut told = Vec::new();
    let end = Instant::from_micros(seconds * 1_000_000);
    while sim.now() < end {
        let now = sim.now();
        let mut frames = Vec::new();
        while let Some(frame) = sim.poll_frame(station) {
            frames.push(frame);
        }
        app.handle_frames(now, &frames);
        app.handle_timeout(now);
        while let Some(frame) = app.poll_transmit(now) {
            sim.transmit(station, frame);
        }
        while let Some(happening) = app.poll_app_event() {
            if let AppEvent::Finding(_, finding) = happening {
                told.push((finding.key.kind, finding.state));
            }
        }
        let next = [app.poll_timeout(), sim.next_event()].into_iter().flatten().min();
        let least = now + Duration::from_micros(1);
        sim.advance(next.unwrap_or(end).clamp(least, end.max(least)));
    }
    told
}

#[test]
fn file_differences_are_printed_once() {
    // A device that never sends its name is at an address pinned for another: it gets repeated
    // requests.
    let silent = DeviceSpec::new("x").fixed(40).skips_address_resolution().fault(Fault::NoDes);
    let feed = DeviceSpec::new("FEED").fixed(12).skips_address_resolution().service("AUGER", "2.1");
    // A device that starts late causes another broadcast request.
    let late = DeviceSpec::new("LATE").fixed(50).power_on(Duration::from_millis(3200));
    let scenario = Scenario::new(125_000).with(silent).with(feed).with(late);
    let file = r#"{"devices":[{"name":"GONE","address":40,"static":true},{"name":"AWAY","address":41},
        {"name":"FEED","address":13,"static":true}]}"#;
    let mut told = findings(&scenario, file, 130);
    told.sort_by_key(|(kind, _)| kind.name());
    let expected = [
        (FindingKind::Missing, FindingState::Confirmed),
        (FindingKind::Missing, FindingState::Confirmed),
        (FindingKind::StaticAddressTaken, FindingState::Suspected),
        (FindingKind::WrongAddress, FindingState::Confirmed),
    ];
    assert_eq!(told, expected);
}

/// Tests that a filter without possible matches is rejected: the bus would look quiet.
#[test]
fn filter_that_cannot_match_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    for (filter, said) in [
        ("at:abc", "at:abc: \"abc\" is not an address; use 0 to 127"),
        ("feed at:12-14", "at:12-14: \"12-14\" is not an address"),
        ("at:12,128", "\"128\" is not an address"),
        (
            "!foo:bar",
            "foo:bar: unknown field foo; use at: name: dev: type: mode: uid: is: bus: since: until:",
        ),
        ("srv:des", "srv:des: events have no field srv; use at: name:"),
        ("id:0201", "id:0201: events have no field id;"),
        ("from:feed", "from:feed: events have no field from;"),
        ("name:", "name: needs a value, for example name:FEED"),
        ("is:", "is: needs a value, for example is:suspected"),
        ("text:\"\"", "text: needs a value"),
        ("is:foo", "is:foo: \"foo\" is not a state; use suspected, confirmed, cleared, error"),
        (
            "kind:zzz",
            "kind:zzz: \"zzz\" is not a kind of problem, for example kind:uid; the word of an event stands alone: moved",
        ),
        ("type:rsp_cc", "type:rsp_cc: \"rsp_cc\" is not a kind of problem"),
        ("name:\"my", "a quote is not closed"),
    ] {
        let output = watch(&["sim:boiler", "--time", "0.1", "--filter", filter], folder.path());
        assert_eq!(output.status.code(), Some(2), "{filter}");
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(stderr.contains(said), "{stderr}");
    }
    for filter in [
        "at:12,14",
        "12:30",
        "name:feed is:lost !err",
        "boiler",
        "is:sus kind:uid",
        "kind:\"same name\"",
        "type:uid state:ours",
    ] {
        let output = watch(&["sim:boiler", "--time", "0.1", "--filter", filter], folder.path());
        assert_eq!(output.status.code(), Some(0), "{filter}");
    }
}

#[test]
fn unreadable_input_is_reported_before_its_end() {
    let folder = tempfile::tempdir().unwrap();
    for (lines, expected) in
        [(1, "line 1 cannot be read"), (8, "8 lines cannot be read, the first is line 1")]
    {
        let mut child = command(&["watch", "-"], folder.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stdin = child.stdin.take().unwrap();
        stdin.write_all("what?\n".repeat(lines).as_bytes()).unwrap();
        let mut said = BufReader::new(child.stderr.take().unwrap());
        let mut first = String::new();
        // The input stays open.
        said.read_line(&mut first).unwrap();
        assert!(first.contains(expected), "{first}");
        assert!(
            first.contains("use candump, pcapng, ASC, BLF, TRC, CSV, SQLite or MF4"),
            "{first}"
        );
        drop(stdin);
        assert_eq!(child.wait().unwrap().code(), Some(3));
    }
}

#[test]
fn missing_interface_is_waited_for_until_the_time_limit() {
    let folder = tempfile::tempdir().unwrap();
    let output = watch(&["nocan7", "--time", "0.5"], folder.path());
    let said = text(&output.stderr);
    assert_eq!((output.status.code(), text(&output.stdout)), (Some(3), ""), "{said}");
    assert!(said.starts_with("descan: waiting for nocan7: nocan7 not found; "), "{said}");
    assert!(said.lines().nth(1).is_some_and(|line| line.contains("nocan7 not found")), "{said}");
}

#[test]
fn bare_word_matches_no_prose() {
    let folder = folder();
    let told = |filter: &str| {
        let output = watch(&["file:session.log", "--filter", filter], folder.path());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let lines = text(&output.stdout).lines();
        lines.filter(|line| line.contains(" FEED ")).map(str::to_owned).collect::<Vec<_>>()
    };
    assert!(told("text:overdue").iter().all(|line| line.contains("stale: heartbeat overdue")));
    assert_eq!((told("text:overdue"), told("overdue")), (told("stale"), vec![]));
    assert!(!told("stale").is_empty());
    assert!(told("wrong-address").iter().all(|line| line.contains("the file pins it")));
    assert!(!told("wrong-address").is_empty() && told("pins").is_empty());
    let output = watch(&["file:session.log", "--filter", "sim:x"], folder.path());
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("quote a word with a colon: \"sim:x\""));
    assert_eq!(told("\"sim:x\""), [""; 0]);
}

#[test]
fn services_events_of_one_batch_keep_their_values() {
    let options = AppOptions {
        buses: vec![("can0".to_owned(), Config { listen_only: true, ..Config::default() })],
        emit_events: true,
        ..AppOptions::default()
    };
    let mut app = App::new(Instant::ZERO, options);
    let services = |data: &[u8]| Frame::new(CanId::Extended(0x0518_0002), data);
    let beat =
        Frame::new(CanId::Extended(0x0718_0001), &[0x8A, 0xFA, 0x6C, 0x97, 0x24, 0x11, 4, 0]);
    // Services responses without ISO-TP: DES 1, DES 2, TMP 2.
    let batch = [
        beat,
        services(b"\x02\0DES\x001\0"),
        services(b"\x02\0DES\x002\0"),
        services(b"\x02\0TMP\x002\0"),
    ];
    app.handle_frames(Instant::from_micros(1000), &batch);
    let (mut lines, mut values) = (Vec::new(), Vec::new());
    while let Some(event) = app.poll_app_event() {
        match event {
            AppEvent::Line(line) if line.text.contains("service") => lines.push(line.text),
            AppEvent::Event(event) if !event.services.is_empty() => {
                let service = &event.services[0];
                values.push(format!("{} {}", service.name, service.version));
            }
            _ => {}
        }
    }
    assert_eq!(values, ["DES 1", "DES 2", "TMP 2"]);
    let changed = ["1 service", "1 service: DES 1 → 2", "1 service: TMP added, DES removed"];
    assert_eq!(lines, changed);
}

#[test]
fn debug_messages_have_the_names_of_the_profile() {
    let folder = folder();
    let profile = "[debug_names]\n\"0x02A\" = \"UNDERVOLTAGE\"\n";
    std::fs::write(folder.path().join("p.toml"), profile).unwrap();
    let given = ["file:session.log", "--profile", "p.toml"];
    let words = watch(&given, folder.path());
    let words = text(&words.stdout);
    assert!(words.contains("FEED         debug message UNDERVOLTAGE 01 FE\n"), "{words}");
    let json = watch(&[&given[..], &["--json"]].concat(), folder.path());
    let named = values(&json.stdout).into_iter().find(|value| value["event"] == "debug").unwrap();
    assert_eq!((&named["code"], &named["code_name"]), (&42.into(), &"UNDERVOLTAGE".into()));
}
