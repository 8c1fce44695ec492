//! `descan send` on a simulated bus, without a terminal.

use crate::common::program::{command, text};
use serde_json::Value;
use std::path::Path;

const BUS: &str = r#"
bitrate = 125000
[[device]]
name = "FEED"
address = { fixed = 10 }
settled = true
firmware = [2, 1]
services = [["DES", "1.0"], ["AUGER", "2.1"], ["MOTOR", "3.4"]]
[[device]]
name = "SENS"
label = "one"
address = { fixed = 12 }
settled = true
[[device]]
name = "SENS"
label = "two"
address = { fixed = 13 }
settled = true
"#;

/// Runs it; returns what it printed, what it said, and its exit code.
fn send(folder: &Path, rest: &[&str]) -> (String, String, i32) {
    let words = [&["send", "sim:bus.toml"], rest].concat();
    let output = command(&words, folder).output().expect("the program starts");
    (text(&output.stdout), text(&output.stderr), output.status.code().unwrap())
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bus.toml"), BUS).unwrap();
    std::fs::write(folder.path().join("none.toml"), "bitrate = 125000\n").unwrap();
    folder
}

#[test]
fn send_says_what_is_sent_and_prints_answers() {
    let folder = folder();
    std::fs::write(folder.path().join("firmware.toml"), "[descriptor]\nfw = 0x013\n").unwrap();
    std::fs::write(folder.path().join("short.toml"), "[calls]\ntimeout_ms = 300\n").unwrap();
    // Words, exit code, what it says before, what it prints.
    let cases: [(&[&str], i32, &str, &str); 9] = [
        (
            &["request", "0x013", "to", "FEED", "--yes", "--profile", "firmware.toml"],
            0,
            "service 0x013 (fw), no data.",
            "firmware 2.1 (data 02 00 01 00)\n",
        ),
        (
            &["request", "des", "name", "to", "FEED", "--yes"],
            0,
            "Send 00002802#0444455301 to FEED @10: REQ_CC_TGT from own address 0 to FEED @10, \
             service 0x002 (des), name request, isotp.",
            "sent 00002802#0444455301\nFEED @10  ",
        ),
        (
            &["request des services to @10", "--yes"],
            0,
            "services request",
            "  3 services: DES 1.0, AUGER 2.1, MOTOR 3.4\n",
        ),
        (
            &["request", "des", "name", "to", "all", "working", "--yes"],
            0,
            "to all working devices",
            "3 answers after ",
        ),
        (&["request", "0x123", "01", "to", "FEED", "--yes"], 1, "data 01", "no answer within 1s"),
        (
            &["request", "0x123", "02", "to", "FEED", "--yes", "--profile", "short.toml"],
            1,
            "data 02",
            "no answer within 300 ms",
        ),
        (
            &["request", "mode", "idle", "to", "FEED", "--yes"],
            0,
            "It sets the mode to IDLE, which may end only by switching the power off and on (if the \
             assumed number is right).",
            "FEED @10  ",
        ),
        (
            &["debug", "0x005", "01", "02", "--repeat", "3", "--every", "10", "--yes"],
            0,
            "3 times, one every ",
            "sent 1F01FC05#0102\n3 of 3 copies\n",
        ),
        (
            &["051C0002#0444455301", "--yes"],
            0,
            "The source address is 14, not descan's own: a device at 14 will give its address up",
            "sent 051C0002#0444455301\non the bus\n",
        ),
    ];
    std::thread::scope(|scope| {
        for (rest, code, asked, printed) in cases {
            let folder = folder.path();
            scope.spawn(move || {
                let (told, said, exit) = send(folder, rest);
                assert!(said.contains(asked), "{rest:?}: {said}");
                assert!(told.contains(printed), "{rest:?}: {told}");
                assert_eq!(exit, code, "{rest:?}: {told}{said}");
            });
        }
    });
}

#[test]
fn send_refuses_what_is_wrong_or_cannot_be_sent() {
    let folder = folder();
    std::fs::write(folder.path().join("a.log"), "(1.0) can0 123#00\n").unwrap();
    let cases: [(&[&str], i32, &str); 8] = [
        (&["request", "des", "name", "to", "FEED"], 2, "there is no terminal: give --yes"),
        (&["requst", "des", "--yes"], 2, "did you mean request?"),
        (&["request", "des", "nmae", "to", "FEED", "--yes"], 2, "did you mean name?"),
        (&["request", "des", "name", "to", "SENS", "--yes"], 2, "give the address of one, as @12"),
        (&["request", "des", "name", "to", "FEAD", "--yes"], 3, "did you mean FEED?"),
        (&["debug", "1", "--yes", "--listen-only"], 3, "listen-only: no frames are sent"),
        (&["debug", "1", "--yes", "--repeat", "1001"], 2, "repeat is 1 to 1000, not 1001"),
        (&["123#R", "--yes"], 2, "a remote frame"),
    ];
    std::thread::scope(|scope| {
        for (rest, code, why) in cases {
            let folder = folder.path();
            scope.spawn(move || {
                let (told, said, exit) = send(folder, rest);
                assert!(said.contains(why), "{rest:?}: {said}");
                assert_eq!((exit, told.as_str()), (code, ""), "{rest:?}");
            });
        }
        scope.spawn(|| {
            let run = |bus: &str| {
                let words = ["send", bus, "123#00", "--yes", "--time", "4"];
                let output = command(&words, folder.path()).output().expect("the program starts");
                (text(&output.stderr), output.status.code())
            };
            let (said, code) = run("file:a.log");
            assert!(said.contains("a log has no bus to send to"), "{said}");
            assert_eq!(code, Some(2));
            let (said, code) = run("sim:none.toml");
            // The controller counts missing acknowledgements as errors.
            assert!(said.contains("no ACK"), "{said}");
            assert_eq!(code, Some(3));
        });
    });
}

#[test]
fn send_prints_json_lines() {
    let folder = folder();
    let words = ["request", "des", "services", "to", "FEED", "--json", "--yes"];
    let (told, said, code) = send(folder.path(), &words);
    assert_eq!(code, 0, "{said}");
    let lines: Vec<Value> = told.lines().map(|it| serde_json::from_str(it).unwrap()).collect();
    let events: Vec<&str> = lines.iter().map(|it| it["event"].as_str().unwrap()).collect();
    assert_eq!(events, ["sent", "answer", "end"]);
    assert_eq!(lines[0]["frames"], serde_json::json!(["00002802#0444455302"]));
    assert_eq!(lines[0]["words"], "request des data services to FEED");
    let answer = &lines[1];
    assert_eq!((&answer["address"], &answer["name"]), (&10.into(), &"FEED".into()));
    assert_eq!((&answer["framing"], &answer["complete"]), (&"isotp".into(), &true.into()));
    assert!(answer["latency_ms"].as_f64().unwrap() > 0.1);
    assert!(answer["data"].as_str().unwrap().starts_with("020044455300312E3000"));
    assert_eq!((&lines[2]["outcome"], &lines[2]["sent"]), (&"answered".into(), &1.into()));
    assert_eq!(lines[2]["unanswered"], 0);
}
