//! `descan log`, from outside: frames and statistics of logs, output and exit codes.

use crate::common::inspection::log;
use descan::sim::{DeviceSpec, Scenario};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::process::{Command, Output, Stdio};

/// Two devices with names and heartbeats, a request with its response, a failed response, a debug
/// message, an 11-bit identifier, a remote frame, FD, and an error frame. FEED is named last.
const LOG: &str = "\
(100.000000) can0 07140001#8A
(100.100000) can0 00002820#0102
(100.112500) can0 05140020#01020304
(100.200000) can0 00002820#03
(100.240000) can0 04140020#EE
(100.300000) can1 123#1122
(100.400000) can1 123#R2
(100.500000) can0 20000008#0000040000000000
(100.600000) can1 07140101##1000102030405060708090A0B T
(101.000000) can0 05140002#0601464545440000
";

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn with(log: impl AsRef<[u8]>) -> Self {
        let folder = Self::new();
        folder.write("a.log", log);
        folder
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        std::fs::write(self.0.path().join(name), content).unwrap();
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
        command.arg("log").args(arguments).current_dir(self.0.path()).env("TZ", "UTC");
        command.env("XDG_CONFIG_HOME", self.0.path().join("config")).stdin(Stdio::null());
        command
    }

    /// Returns exit code, standard output and standard error.
    fn log(&self, arguments: &[&str]) -> (i32, String, String) {
        of(&self.command(arguments).output().expect("the program starts"))
    }

    /// The same with `input` as standard input.
    fn log_input(&self, arguments: &[&str], input: &[u8]) -> (i32, String, String) {
        let mut command = self.command(arguments);
        let command = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        child.stdin.take().unwrap().write_all(input).unwrap();
        of(&child.wait_with_output().unwrap())
    }

    /// Returns the objects that `--json` prints.
    fn objects(&self, arguments: &[&str]) -> Vec<Value> {
        let (code, out, error) = self.log(&[arguments, &["--json"]].concat());
        assert_eq!((code, &*error), (0, ""), "{out}");
        out.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    /// Returns the value of `--stats --json`.
    fn stats(&self, arguments: &[&str]) -> Value {
        let (code, out, error) = self.log(&[arguments, &["--stats", "--json"]].concat());
        assert_eq!((code, &*error), (0, ""), "{out}");
        serde_json::from_str(&out).unwrap()
    }
}

fn of(output: &Output) -> (i32, String, String) {
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).expect("output is UTF-8");
    (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
}

/// A boiler with a device that is named late, as a listen-only node receives it.
fn bus() -> String {
    let device = |name: &str, address| {
        DeviceSpec::new(name).fixed(address).skips_address_resolution().service("AUGER", "2.1")
    };
    let devices = [device("FEED", 10), device("SENS", 12)];
    log(&devices.into_iter().fold(Scenario::new(125_000), Scenario::with), 12)
}

#[test]
fn statistics_of_several_days_have_dates() {
    let day = 86_400;
    // In the second zone the log begins in the day before 1970.
    for (zone, end, expected) in [
        ("UTC", day + 3, "1970-01-01 00:00:01.500 to 1970-01-02 00:00:03.000"),
        ("EST5", day + 3, "1969-12-31 19:00:01.500 to 1970-01-01 19:00:03.000"),
        ("UTC", 3, "frames, 00:00:01.500 to 00:00:03.000"),
    ] {
        let folder = Folder::with(format!("(1.5) can0 123#11\n({end}.0) can0 123#22\n"));
        let mut command = folder.command(&["a.log", "--stats"]);
        let (_, out, _) = of(&command.env("TZ", zone).output().unwrap());
        assert!(out.contains(expected), "{zone}: {out}");
    }
}

#[test]
fn frames_of_another_day_have_its_date_before_them() {
    let folder = Folder::with(
        "(86399.9) can0 123#11\n(86400.0) can0 123#22\n(86401.0) can0 123#33\n(259200.0) can0 123#44\n",
    );
    let mut command = folder.command(&["a.log"]);
    let (_, out, _) = of(&command.env("TZ", "UTC").output().unwrap());
    let begin: Vec<_> = out.lines().map(|line| line.get(..12).unwrap_or(line)).collect();
    let lines = [
        "23:59:59.900",
        "# 1970-01-02",
        "00:00:00.000",
        "00:00:01.000",
        "# 1970-01-04",
        "00:00:00.000",
    ];
    assert_eq!(begin, lines);
    assert!(out.contains("\n# 1970-01-04, after 1970-01-02\n"), "{out}");
    let mut command = folder.command(&["a.log"]);
    let (_, out, _) = of(&command.env("TZ", "EST5").output().unwrap());
    assert_eq!(out.matches("# ").count(), 1, "{out}");
    // What is left out has no date.
    let mut command = folder.command(&["a.log", "--limit", "3"]);
    let (_, out, _) = of(&command.env("TZ", "UTC").output().unwrap());
    assert_eq!(out.matches("# ").count(), 1, "{out}");
}

#[test]
fn frames_of_a_log_are_lines_of_text() {
    let folder = Folder::with(LOG);
    let (code, out, error) = folder.log(&["a.log"]);
    assert_eq!((code, &*error), (0, ""));
    insta::with_settings!({ prepend_module_to_snapshot => false }, {
        insta::assert_snapshot!("log_of_all_kinds", out);
    });
}

#[test]
fn json_has_every_member_of_every_frame() {
    let folder = Folder::with(LOG);
    let frames = folder.objects(&["a.log"]);
    assert_eq!(frames.len(), 10);
    let mut members: Vec<_> = frames[0].as_object().unwrap().keys().cloned().collect();
    members.sort();
    let guide = descan::guide::topic("scripting").unwrap().markdown();
    let section = guide.split("## JSON of log: one").nth(1).unwrap().split("\n## ").next().unwrap();
    for frame in &frames {
        assert_eq!(frame.as_object().unwrap().len(), members.len());
    }
    for member in &members {
        assert!(section.contains(&format!("`{member}`")), "{member} is not documented");
    }
    assert_eq!(
        frames[2],
        json!({
            "time": 100.1125, "bus": "can0", "id": "05140020", "extended": true, "fd": false,
            "kind": "rsp", "from": 10, "to": 0, "from_name": "FEED", "to_name": null,
            "service": 32, "service_name": null, "len": 4, "data": "01020304", "text": null,
            "fields": null, "message": null, "signals": null,
            "failed": false, "error": false, "tx": false, "request": 100.1, "latency_ms": 12.5,
            "ambiguous": false,
        })
    );
    let kinds: Vec<_> = frames.iter().map(|it| it["kind"].as_str().unwrap()).collect();
    let expected = ["data", "req", "rsp", "req", "failed", "std", "rtr", "err", "data", "rsp"];
    assert_eq!(kinds, expected);
    assert_eq!((&frames[4]["failed"], &frames[4]["error"]), (&json!(true), &json!(true)));
    assert_eq!((&frames[5]["id"], &frames[5]["from"]), (&json!("123"), &json!(null)));
    assert_eq!((&frames[7]["id"], &frames[7]["error"]), (&json!(null), &json!(true)));
    assert_eq!((&frames[8]["fd"], &frames[8]["tx"]), (&json!(true), &json!(true)));
    assert_eq!(frames[9]["text"], "name FEED");
}

#[test]
fn late_name_holds_for_earlier_frames_of_a_file() {
    let folder = Folder::with(LOG);
    let names = |frames: Vec<Value>| frames.iter().map(|it| it["from_name"].clone()).collect();
    let of_file: Vec<Value> = names(folder.objects(&["a.log", "--filter", "src:10 bus:can0"]));
    assert_eq!(of_file, [json!("FEED"), json!("FEED"), json!("FEED"), json!("FEED")]);
    let (_, out, _) = folder.log(&["a.log", "--filter", "src:FEED bus:can0"]);
    assert_eq!(out.lines().count(), 4, "{out}");
    // Many frames before the name: from standard input, the first ones are printed without it.
    let others = "(100.300000) can1 123#1122\n".repeat(20_000);
    let (before, name) = LOG.split_at(LOG.rfind("(101").unwrap());
    let lines = format!("{before}{others}{name}");
    folder.write("long.log", &lines);
    let options = ["--json", "--limit", "1"];
    let (_, of_file, _) = folder.log(&[&["long.log"], &options[..]].concat());
    assert!(of_file.contains(r#""from_name":"FEED""#), "{of_file}");
    let (_, of_input, _) =
        folder.log_input(&["-", "--json", "--filter", "src:10"], lines.as_bytes());
    let first = of_input.lines().next().unwrap();
    assert!(first.contains(r#""from_name":null"#), "{first}");
}

#[test]
fn standard_input_prints_the_same_frames_as_they_arrive() {
    let lines = bus();
    let folder = Folder::with(&lines);
    let (_, of_file, _) = folder.log(&["a.log"]);
    let (code, of_input, error) = folder.log_input(&["-"], lines.as_bytes());
    assert_eq!((code, &*error), (0, ""));
    assert_eq!(of_input.lines().count(), lines.lines().count());
    let last = |text: &str| text.lines().last().map(str::to_owned);
    assert_eq!(last(&of_input), last(&of_file));
    // A line is printed before the next one is there.
    let mut child = folder.command(&["-"]);
    let mut child = child.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut input = child.stdin.take().unwrap();
    let mut output = child.stdout.take().unwrap();
    for line in LOG.lines().take(3) {
        writeln!(input, "{line}").unwrap();
        let mut read = Vec::new();
        while read.last() != Some(&b'\n') {
            let mut byte = [0];
            output.read_exact(&mut byte).unwrap();
            read.push(byte[0]);
        }
        assert!(String::from_utf8(read).unwrap().starts_with("00:01:40."));
    }
    drop(input);
    assert!(child.wait().unwrap().success());
}

#[test]
fn filter_without_a_match_says_so() {
    let folder = Folder::with(LOG);
    let (code, out, error) = folder.log(&["a.log", "--filter", "srv:99"]);
    assert_eq!((code, &*out), (0, ""));
    assert_eq!(error, "descan: none of 10 frames match the filter\n");
}

#[test]
fn filter_and_range_select_the_frames() {
    let folder = Folder::with(LOG);
    let count = |arguments: &[&str]| folder.objects(&[&["a.log"], arguments].concat()).len();
    for (filter, frames) in [
        ("id:123", 2),
        ("type:rsp", 3),
        ("type:failed", 1),
        ("is:error", 2),
        ("bus:can1 !id:123", 1),
        ("data:0A0B", 1),
        ("dt:<=130ms id:05140020", 0),
        ("dt:>=100ms id:00002820", 1),
        ("dt:>100ms id:00002820", 0),
        ("since:00:01:41", 1),
        ("until:00:01:40.2", 4),
    ] {
        assert_eq!(count(&["--filter", filter]), frames, "{filter}");
    }
    assert_eq!(count(&["--from", "0.2", "--time", "0.2"]), 4);
    assert_eq!(count(&["--from", "0.2", "--limit", "3"]), 3);
    assert_eq!(count(&["--limit", "1", "--filter", "id:123"]), 1);
    let (code, out, error) = folder.log(&["a.log", "--filter", "type:rsp colour:red"]);
    assert_eq!((code, &*out), (2, ""));
    assert!(error.contains("--filter") && error.contains("column 10"), "{error}");
    let (_, of_input, _) = folder.log_input(&["-", "--filter", "dt:>=100ms"], LOG.as_bytes());
    let (_, of_file, _) = folder.log(&["a.log", "--filter", "dt:>=100ms"]);
    assert_eq!((of_input.lines().count(), of_file.lines().count()), (1, 1), "{of_file}");
}

#[test]
fn clock_times_have_the_offset_of_their_date() {
    // 12:00 in UTC of 1 July and of 1 February.
    let log = "(1751371200.000000) can0 123#11\n(1769947200.000000) can0 123#22\n";
    let folder = Folder::with(log);
    let lines = |arguments: &[&str]| -> Vec<String> {
        let mut command = folder.command(arguments);
        let (_, out, _) = of(&command.env("TZ", "Europe/Berlin").output().unwrap());
        let frames = out.lines().filter(|line| !line.starts_with("# "));
        frames.map(|line| line.split(' ').next().unwrap().to_owned()).collect()
    };
    let (summer, winter) = ("14:00:00.000", "13:00:00.000");
    assert_eq!(lines(&["a.log"]), [summer, winter]);
    assert_eq!(lines(&["a.log", "--filter", "until:2025-07-01T14:00"]), [summer]);
    assert_eq!(lines(&["a.log", "--filter", "since:2026-02-01T13:00"]), [winter]);
    assert_eq!(lines(&["a.log", "--filter", "until:14:00"]), [summer]);
}

#[test]
fn another_protocol_has_no_calls() {
    // Some identifiers are those of a request; most are of no message type.
    let lines = (0..600).map(|at| {
        let id = if at % 3 == 0 { "00002820" } else { "1DF11317" };
        format!("({}.{:03}000) can0 {id}#0102\n", 100 + at / 100, at % 100 * 10)
    });
    let folder = Folder::with(lines.collect::<String>());
    let (_, out, _) = folder.log(&["a.log", "--stats", "--json"]);
    let stats: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((&stats["frames"], &stats["calls"]), (&json!(600), &json!([])), "{stats}");
}

#[test]
fn statistics_are_those_of_the_frames() {
    // Every 100 ms for 20 s, with one gap of 300 ms; 20 calls that take 1 to 20 ms, one unanswered.
    let mut lines: Vec<(u64, String)> = Vec::new();
    for beat in (0..200).filter(|beat| ![50, 51].contains(beat)) {
        lines.push((beat * 100_000, format!("07140101#{beat:04X}")));
    }
    for call in 0..21u64 {
        let at = call * 900_000 + 50_000;
        lines.push((at, "00002820#01".to_owned()));
        let response = if call == 3 { "04140020#01" } else { "05140020#01" };
        if call < 20 {
            lines.push((at + (call + 1) * 1000, response.to_owned()));
        }
    }
    lines.push((19_900_001, "20000008#0000040000000000".to_owned()));
    lines.sort();
    let line = |(at, frame): &(u64, String)| {
        format!("({}.{:06}) can0 {frame}\n", 100 + at / 1_000_000, at % 1_000_000)
    };
    let folder = Folder::with(lines.iter().map(line).collect::<String>());
    let stats = folder.stats(&["a.log"]);
    assert_eq!(stats["frames"], lines.len());
    assert_eq!((&stats["first"], &stats["last"]), (&json!(100.0), &json!(119.900_001)));
    let kinds = &stats["kinds"];
    let counts = ["data", "req", "rsp", "failed", "err", "std"].map(|kind| kinds[kind].clone());
    assert_eq!(counts, [198, 21, 19, 1, 1, 0].map(Value::from));
    assert_eq!(stats["errors"]["stuff"], 1);
    let rows = stats["identifiers"].as_array().unwrap();
    let beat = rows
        .iter()
        .find(|row| row["id"] == "07000101")
        .or_else(|| rows.iter().find(|row| row["service"] == 257));
    let beat = beat.unwrap();
    assert_eq!((&beat["count"], &beat["to"]), (&json!(198), &json!(null)));
    let period = &beat["period_ms"];
    assert_eq!((&period["min"], &period["max"]), (&json!(100.0), &json!(300.0)));
    let mean = 19_900.0 / 197.0;
    assert!((period["mean"].as_f64().unwrap() - mean).abs() < 0.01, "{period}");
    assert!(period["jitter"].as_f64().unwrap() < 2.0, "{period}");
    assert!((beat["rate"].as_f64().unwrap() - 198.0 / 19.9).abs() < 0.01);
    let request = rows.iter().find(|row| row["id"] == "00002820").unwrap();
    assert_eq!(request["period_ms"], Value::Null);
    let [call] = &stats["calls"].as_array().unwrap()[..] else { panic!("{}", stats["calls"]) };
    let of_call = ["calls", "responses", "unanswered", "failed"].map(|it| call[it].clone());
    assert_eq!(of_call, [21, 20, 1, 1].map(Value::from));
    assert_eq!(call["latency_ms"], json!({ "p50": 10.0, "p99": 20.0, "max": 20.0 }));
    // Those of matching frames only, and the same from standard input.
    assert_eq!(folder.stats(&["a.log", "--filter", "type:data"])["frames"], 198);
    assert_eq!(folder.stats(&["a.log", "--filter", "type:data"])["calls"], json!([]));
    let log = std::fs::read(folder.0.path().join("a.log")).unwrap();
    let (_, of_input, _) = folder.log_input(&["-", "--stats", "--json"], &log);
    assert_eq!(serde_json::from_str::<Value>(&of_input).unwrap(), stats);
    let (code, table, _) = folder.log(&["a.log", "--stats"]);
    assert_eq!(code, 0);
    insta::with_settings!({ prepend_module_to_snapshot => false }, {
        insta::assert_snapshot!("log_statistics", table);
    });
}

#[test]
fn statistics_members_are_documented() {
    let guide = descan::guide::topic("scripting").unwrap().markdown();
    let section = guide.split("## JSON of log --stats").nth(1).unwrap();
    let section = section.split("\n## ").next().unwrap();
    let stats = Folder::with(LOG).stats(&["a.log"]);
    for table in [&stats, &stats["identifiers"][0], &stats["calls"][0]] {
        for member in table.as_object().unwrap().keys() {
            assert!(section.contains(member), "{member} is not documented");
        }
    }
}

#[test]
fn hostile_log_prints_no_control_codes() {
    let hostile = "\u{1b}[2J\u{202e}";
    let name = descan::text::hex(b"\x1b[2J\x07", "");
    let lines = format!(
        "(1.0) {hostile} 123#01\n(1.1) can0 07140001#8A\n(1.2) can0 05140002#0601{name}\n\
         {hostile}\n(1.3) can0 123#{hostile}\n(1.4) can0 07140001#8A\n"
    );
    let folder = Folder::with(lines);
    for options in [&["a.log"][..], &["a.log", "--json"], &["a.log", "--stats"]] {
        let (code, out, error) = folder.log(options);
        assert_eq!(code, 0, "{error}");
        for text in [&out, &error] {
            assert!(!text.chars().any(|c| c != '\n' && !descan::text::is_printable(c)), "{text:?}");
        }
        assert!(out.contains("[2J"), "{out}");
        assert_eq!(error.lines().count(), 1, "{error}");
        assert!(error.contains("3 lines cannot be read, the first is line 1"), "{error}");
    }
}

#[test]
fn unusable_logs_are_named_with_cause_and_way_out() {
    let folder = Folder::with(LOG);
    folder.write("words.txt", "hello\nworld\n");
    folder.write("empty.log", "");
    for (arguments, code, said) in [
        (&["none.log"][..], 3, "none.log"),
        (&["."], 3, "cannot be read"),
        (&["words.txt"], 3, "use candump, pcapng, ASC, BLF, TRC, CSV, SQLite or MF4"),
        (&["a.log", "--from", "99"], 3, "use a --from below 1.0, not 99"),
        (&["a.log", "--stats", "--limit", "3"], 2, "--limit"),
        (&["a.log", "--limit", "0"], 2, "--limit"),
        (&[], 2, "<FILE>"),
    ] {
        let (ended, out, error) = folder.log(arguments);
        assert_eq!((ended, &*out), (code, ""), "{arguments:?}: {error}");
        assert!(error.contains(said), "{arguments:?}: {error}");
    }
    let (code, out, error) = folder.log(&["empty.log"]);
    assert_eq!((code, &*out), (0, ""));
    assert!(error.contains("0 frames"), "{error}");
}

#[test]
fn closed_pipe_ends_without_an_error() {
    let folder = Folder::with(
        LOG.lines().cycle().take(100_000).fold(String::new(), |all, it| all + it + "\n"),
    );
    let mut command = folder.command(&["a.log"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut first = [0; 16];
    child.stdout.as_mut().unwrap().read_exact(&mut first).unwrap();
    drop(child.stdout.take());
    let (code, _, error) = of(&child.wait_with_output().unwrap());
    assert_eq!(code, 0);
    assert!(!error.contains("closed") && !error.contains("pipe"), "{error}");
}

#[test]
fn matching_frames_are_written_as_another_log() {
    let folder = Folder::with(LOG);
    let written = |name: &str| {
        let text = std::fs::read_to_string(folder.0.path().join(name)).unwrap();
        text.replace("(0000000", "(")
    };
    // FEED is named last: its name holds for the frames before.
    let (code, out, error) = folder.log(&["a.log", "--filter", "src:FEED", "--write", "b.log"]);
    assert_eq!((code, &*out), (0, ""), "{error}");
    assert!(error.contains("descan: wrote b.log: 4 of 10 frames, "), "{error}");
    let of_feed =
        |line: &&str| [" can0 0714", " can0 0514", " can0 0414"].iter().any(|id| line.contains(id));
    let expected: String = LOG.lines().filter(of_feed).flat_map(|line| [line, "\n"]).collect();
    assert_eq!(written("b.log"), expected);
    // Through pcapng and back.
    folder.log(&["a.log", "--write", "c.pcapng"]);
    let (code, ..) = folder.log(&["c.pcapng", "--limit", "9", "--write", "d.log"]);
    assert_eq!((code, written("d.log").lines().count()), (0, 9));
    assert!(LOG.starts_with(&written("d.log")));
    for (arguments, code, hint) in [
        (&["a.log", "--write", "a.log"][..], 3, "a.log: already exists"),
        (&["a.log", "--write", "e.zip"], 2, ".pcapng"),
        (&["a.log", "--write", "e.log", "--stats"], 2, "--stats"),
        (&["nothing.log", "--write", "e.log"], 3, "nothing.log"),
    ] {
        let (own, _, error) = folder.log(arguments);
        assert_eq!((own, error.contains(hint)), (code, true), "{error}");
    }
    assert!(!folder.0.path().join("e.log").exists());
}

#[test]
fn identifiers_of_another_protocol_are_as_they_are() {
    // Ten senders at regular intervals, whose identifiers differ where RND7 of a broadcast is.
    let line = |number: u32| {
        let id = 0x1E00_0000 | (number % 10) << 10 | 0x0003_0155;
        let time = 1_436_509_000.0 + f64::from(number) / 100.0;
        format!("({time:.6}) can0 {id:08X}#{number:08X}\n")
    };
    let folder = Folder::with((0..600).map(line).collect::<String>());
    let (code, out, error) = folder.log(&["a.log", "--stats", "--json"]);
    assert!(code == 0 && error.contains("does not speak DES"), "{error}");
    let stats: Value = serde_json::from_str(&out).unwrap();
    let rows = stats["identifiers"].as_array().unwrap();
    assert_eq!(rows.len(), 10, "{stats:#}");
    for row in rows {
        assert_eq!((&row["count"], &row["id"].as_str().unwrap()[..2]), (&json!(60), "1E"));
        assert_eq!(row["period_ms"]["mean"], json!(100.0), "{row:#}");
    }
}
