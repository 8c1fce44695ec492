//! The command `descan prove`: JSON, reports, exit codes, and what it refuses.

use crate::common::program::{command, text};
use crate::common::pty::Pty;
use descan::prove::ConformanceRule;
use nix::sys::signal::Signal;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

/// Heartbeats ten times as fast as the document says: the tests are over sooner.
const PROFILE: &str = "[services]\nheartbeat = 0x001\ndes = 0x002\n[heartbeat]\nperiod_ms = 100\n\
    uid_offset = 0\nmode_offset = 6\n";

const BUS: &str = r#"
bitrate = 1000000
[profile.heartbeat]
period_ms = 100
[[device]]
name = "FEED"
uid = "BOILER01"
address = { fixed = 10 }
settled = true
services = []
[[device]]
name = "ACT"
address = { fixed = 14 }
settled = true
services = []
faults = ["answers-twice"]
"#;

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bus.toml"), BUS).unwrap();
    std::fs::write(folder.path().join("profile.toml"), PROFILE).unwrap();
    folder
}

/// The command on a bus, without a terminal.
fn prove_on(bus: &str, folder: &Path, rest: &[&str]) -> Command {
    command(&[&["prove", bus, "--profile", "profile.toml"], rest].concat(), folder)
}

/// Runs it on the bus without a terminal.
fn prove(folder: &Path, rest: &[&str]) -> Output {
    prove_on("sim:bus.toml", folder, rest).output().expect("the program starts")
}

/// The members of an object that the guide describes in a table of its topic.
fn members(value: &Value) -> Vec<String> {
    value.as_object().unwrap().keys().cloned().collect()
}

#[test]
fn json_has_the_members_and_rules_of_the_guide() {
    let folder = folder();
    let output = prove(folder.path(), &["FEED", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let device = &json["devices"][0];
    assert_eq!((&json["bus"], &device["address"]), (&"sim:bus.toml".into(), &10.into()));
    assert_eq!((&device["name"], &device["uid"]), (&"FEED".into(), &"BOILER01".into()));
    let rules = device["rules"].as_array().unwrap();
    let ids: Vec<&str> = rules.iter().map(|it| it["rule"].as_str().unwrap()).collect();
    let all: Vec<&str> = ConformanceRule::ALL.iter().map(|rule| rule.id()).collect();
    assert_eq!(ids, all);
    assert!(json["kept"].as_u64() >= Some(18), "{}", json["kept"]);
    let guide = descan::guide::topic("conformance").unwrap().markdown();
    for value in [&json, device, &rules[0]] {
        for member in members(value) {
            assert!(guide.contains(&format!("`{member}`")), "{member} is not in the guide");
        }
    }
}

#[test]
fn broken_rule_exits_1_and_is_proved() {
    let folder = folder();
    let args = ["@14", "--report", "junit", "--proof", "act.md"];
    let output = prove(folder.path(), &args);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let xml = text(&output.stdout);
    assert!(xml.starts_with("<?xml") && xml.contains("failures=\"1\""), "{xml}");
    assert!(xml.contains("<testcase name=\"one-answer\" classname=\"ACT at 14\">"), "{xml}");
    let report = std::fs::read_to_string(folder.path().join("act.md")).unwrap();
    assert!(report.contains("### one-answer: broken"), "{report}");
    // Frames are code, as they are.
    assert!(report.contains("| `00003802#0444455301` | descan |"), "{report}");
    assert!(report.contains("| reserved-refused | kept | refused type 0x00 with `"), "{report}");
    assert!(!report.contains("\\#"), "{report}");
    let frames = std::fs::read(folder.path().join("act.pcapng")).unwrap();
    let comment = b"broken: one-answer";
    assert!(frames.windows(comment.len()).any(|part| part == comment));
}

/// The annotations of GitHub Actions: command, title and message of each line, as a runner reads
/// them.
fn annotations(printed: &str) -> Vec<(String, String, String)> {
    let unescaped = |text: &str| {
        let text = text.replace("%0A", "\n").replace("%0D", "\r");
        text.replace("%3A", ":").replace("%2C", ",").replace("%25", "%")
    };
    let of = |line: &str| {
        let (head, message) = line.strip_prefix("::")?.split_once("::")?;
        let (command, title) = head.split_once(" title=")?;
        assert!(!title.contains([':', ',']), "ends the title: {line}");
        Some((command.to_owned(), unescaped(title), unescaped(message)))
    };
    printed.lines().map(|line| of(line).unwrap_or_else(|| panic!("{line}"))).collect()
}

#[test]
fn github_annotations_have_the_failure_of_junit() {
    let folder = folder();
    let output = prove(folder.path(), &["@14", "--report", "github", "--proof", "act.md"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let lines = annotations(&text(&output.stdout));
    let [(command, title, message), (notice, name, sums)] = &lines[..] else { panic!("{lines:?}") };
    assert_eq!((command.as_str(), title.as_str()), ("error", "ACT at 14: one-answer"));
    assert_eq!((notice.as_str(), name.as_str()), ("notice", "descan prove sim:bus.toml"));
    let tests = ConformanceRule::ALL.len();
    assert!(sums.starts_with(&format!("{tests} tests, 1 failed, ")), "{sums}");
    // What was seen, what the rule demands, and the frames, of which there are two answers.
    let message: Vec<&str> = message.lines().collect();
    let rule = ConformanceRule::ALL.iter().find(|rule| rule.id() == "one-answer").unwrap();
    assert!(message[1].starts_with(&format!("{} (", rule.sentence())), "{message:?}");
    assert!(message.iter().filter(|line| line.contains("051C0002#")).count() >= 2, "{message:?}");
    let proof = std::fs::read_to_string(folder.path().join("act.md")).unwrap();
    assert!(message[2..].iter().all(|line| proof.contains(line.split_once(' ').unwrap().1)));
    // JUnit says the same, with the frames of its own run.
    let output = prove(folder.path(), &["@14", "--report", "junit"]);
    let xml = text(&output.stdout);
    assert!(xml.contains(&format!("<failure message=\"{}\">", message[0])), "{xml}");
    assert!(xml.contains(message[1]), "{xml}");
    let skipped = xml.matches("<skipped").count();
    assert!(sums.ends_with(&format!(", {skipped} skipped")), "{sums}");
}

#[test]
fn github_report_of_a_good_device_is_a_notice() {
    let folder = folder();
    let output = prove(folder.path(), &["FEED", "--report", "github"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let lines = annotations(&text(&output.stdout));
    assert_eq!(lines.len(), 1, "{lines:?}");
    let (command, _, sums) = &lines[0];
    assert!(command == "notice" && sums.contains(" tests, 0 failed, "), "{lines:?}");
}

#[test]
fn github_titles_escape_the_name_of_a_device() {
    let folder = folder();
    let bus = BUS.replace("\"ACT\"", "\"A::B,50%\"");
    std::fs::write(folder.path().join("bus.toml"), bus).unwrap();
    let output = prove(folder.path(), &["@14", "--report", "github"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let printed = text(&output.stdout);
    let title = "::error title=A%3A%3AB%2C50%25 at 14%3A one-answer::";
    assert!(printed.starts_with(title), "{printed}");
    assert_eq!(annotations(&printed)[0].1, "A::B,50% at 14: one-answer");
}

#[test]
fn unusable_calls_are_refused() {
    let folder = folder();
    let cases: [(&[&str], i32, &str); 15] = [
        (&["NOPE", "--time", "4"], 3, "NOPE was not found; there are FEED at 10, ACT at 14\n"),
        (&["200", "--time", "4"], 3, "ACT at 14; addresses are 1 to 127, as @12\n"),
        (&["0Ah", "--time", "4"], 3, "ACT at 14; for the address give @10\n"),
        (&["@200"], 2, "@200: no such address; addresses are @1 to @127"),
        (&["@0"], 2, "@0: no such address"),
        (&["@FEED"], 2, "@FEED: no such address"),
        (&["FEED", "--reboot"], 2, "--reboot asks to switch the device off and on"),
        (&["FEED", "--reboot", "--yes"], 2, "there is no terminal"),
        (
            &["FEED", "--load"],
            3,
            "1 other device on the bus; on a test bench give --bench and --yes\n",
        ),
        (&["FEED", "--load", "--bench"], 2, "give --yes"),
        (&["FEED", "--listen-only"], 2, "listen-only"),
        (&["FEED", "--disrupt-device"], 2, "give --yes"),
        (
            &["FEED", "--load", "--yes"],
            3,
            "1 other device on the bus; on a test bench give --bench\n",
        ),
        (&["FEED", "--all"], 2, "--all"),
        (&[], 2, "<DEVICE>"),
    ];
    for (args, code, why) in cases {
        let output = prove(folder.path(), args);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains(why), "{args:?}: {}", text(&output.stderr));
    }
}

/// One device alone, with heartbeats as the document says: the tests take 14 s at least.
const ALONE: &str = r#"
bitrate = 1000000
[[device]]
name = "FEED"
uid = "BOILER01"
address = { fixed = 10 }
settled = true
services = []
"#;

#[test]
fn load_of_a_lone_device_needs_consent() {
    let folder = folder();
    std::fs::write(folder.path().join("alone.toml"), ALONE).unwrap();
    let output = prove_on("sim:alone.toml", folder.path(), &["FEED", "--load"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("give --yes"), "{}", text(&output.stderr));
}

#[test]
fn device_that_joins_before_the_load_ends_the_tests() {
    let folder = folder();
    let late =
        ALONE.replace("FEED", "LATE").replace("BOILER01", "BOILER02").replace("10 }", "11 }");
    let late = late.split_once("[[device]]").unwrap().1;
    let bus = format!("{ALONE}[[device]]{late}power_on = 8.0\n");
    std::fs::write(folder.path().join("late.toml"), bus).unwrap();
    let words = ["FEED", "--load", "--yes"];
    let output = prove_on("sim:late.toml", folder.path(), &words).output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
    let said = text(&output.stderr);
    assert!(
        said.contains("--load: 1 other device on the bus; on a test bench give --bench"),
        "{said}"
    );
}

#[test]
fn missing_bus_is_waited_for_as_long_as_asked() {
    let folder = folder();
    for words in [&["prove", "none9", "FEED"][..], &["descriptor", "none9", "FEED"]] {
        let mut command = command(&[words, &["--time", "2"]].concat(), folder.path());
        let output = command.output().unwrap();
        assert_eq!(output.status.code(), Some(3), "{words:?}");
        assert!(text(&output.stderr).contains("none9"), "{}", text(&output.stderr));
    }
}

/// Two devices with one name at one address.
const CONFLICT: &str = r#"
bitrate = 1000000
[profile.heartbeat]
period_ms = 100
[[device]]
name = "FEED"
uid = "BOILER01"
address = { fixed = 10 }
settled = true
services = []
faults = ["never-gives-way"]
[[device]]
label = "SECOND"
name = "FEED"
uid = "BOILER02"
address = { fixed = 10 }
settled = true
services = []
faults = ["never-gives-way"]
"#;

#[test]
fn confirmed_conflict_is_said_first_and_exits_1() {
    let folder = folder();
    std::fs::write(folder.path().join("conflict.toml"), CONFLICT).unwrap();
    let run = |rest: &[&str]| {
        let words = [&["@10"], rest].concat();
        let output = prove_on("sim:conflict.toml", folder.path(), &words).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let printed = run(&[]);
    let mut lines = printed.lines();
    assert_eq!(lines.next(), Some("FEED at 10:"));
    let conflict = lines.next().unwrap();
    assert!(conflict.starts_with("  address conflict, confirmed by frames: "), "{printed}");
    assert!(printed.ends_with(": 0 kept, 0 broken, 37 not seen\n"), "{printed}");
    let json: Value = serde_json::from_str(&run(&["--json", "--proof", "conflict.md"])).unwrap();
    assert_eq!(json["devices"][0]["conflict_confirmed"], true);
    let report = std::fs::read_to_string(folder.path().join("conflict.md")).unwrap();
    assert!(report.contains("**address conflict, confirmed by frames: "), "{report}");
    let tap = run(&["--report", "tap"]);
    assert!(tap.contains("not ok 1 - FEED at 10: address-conflict"), "{tap}");
}

/// Starts it on the bus of one device, and waits until it tests that.
fn started(folder: &Path, rest: &[&str]) -> Child {
    std::fs::write(folder.join("alone.toml"), ALONE).unwrap();
    std::fs::write(folder.join("profile.toml"), PROFILE.replace("100", "1000")).unwrap();
    let mut command = prove_on("sim:alone.toml", folder, rest);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut error = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    error.read_line(&mut line).unwrap();
    assert!(line.starts_with("device at 10: "), "{line}");
    child.stderr = Some(error.into_inner());
    child
}

/// Interrupts it; returns its output.
fn interrupted(mut child: Child) -> String {
    let id = nix::unistd::Pid::from_raw(child.id().cast_signed());
    nix::sys::signal::kill(id, Signal::SIGINT).unwrap();
    let mut printed = String::new();
    child.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{printed}");
    printed
}

#[test]
fn interrupted_tests_print_what_was_found() {
    let folder = folder();
    let printed = interrupted(started(folder.path(), &["FEED"]));
    assert!(printed.contains("  kept      answers-name-request "), "{printed}");
    let last = printed.lines().last().unwrap();
    assert!(last.starts_with("interrupted after ") && last.contains("incomplete"), "{printed}");
    let printed = interrupted(started(folder.path(), &["FEED", "--json"]));
    let json: Value = serde_json::from_str(&printed).unwrap();
    let tests = json["devices"][0]["tests"].as_array().unwrap();
    assert!(json["complete"] == false && tests[0].as_u64() < tests[1].as_u64(), "{printed}");
}

#[test]
fn progress_line_moves_while_a_test_waits() {
    let folder = folder();
    std::fs::write(folder.path().join("alone.toml"), ALONE).unwrap();
    std::fs::write(folder.path().join("profile.toml"), PROFILE.replace("100", "1000")).unwrap();
    let words = ["prove", "sim:alone.toml", "FEED", "--profile", "profile.toml"];
    let mut terminal = Pty::start(&words, folder.path(), (100, 60));
    for line in ["observes its heartbeats, 1 s", "observes its heartbeats, 2 s"] {
        terminal.wait_for(line);
    }
    terminal.signal(Signal::SIGINT);
    assert_eq!(terminal.wait(), 130);
    let screen = terminal.screen();
    assert!(!screen.contains("observes"), "the line is removed: {screen}");
    assert!(screen.starts_with("FEED at 10:") && screen.contains("interrupted"), "{screen}");
}

#[test]
fn progress_is_printed_in_lines_without_a_terminal() {
    let folder = folder();
    // Heartbeats so slow that it observes them for more than 10 s once all other tests are made.
    let profile = PROFILE.replace("100", "1500");
    std::fs::write(folder.path().join("profile.toml"), profile).unwrap();
    let bus = ALONE.replace("[[device]]", "[profile.heartbeat]\nperiod_ms = 1500\n[[device]]");
    std::fs::write(folder.path().join("slow.toml"), bus).unwrap();
    let output = prove_on("sim:slow.toml", folder.path(), &["FEED"]).output().unwrap();
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    let lines: Vec<&str> =
        said.lines().filter_map(|line| line.strip_prefix("device at 10: ")).collect();
    let tenths = lines.iter().filter_map(|line| line.strip_suffix(" tests")).map(|line| {
        let (made, all) = line.split_once(" of ").expect("made and all");
        10 * made.parse::<usize>().unwrap() / all.parse::<usize>().unwrap()
    });
    assert_eq!(tenths.collect::<Vec<_>>(), (1..=10).collect::<Vec<_>>(), "{said}");
    let waits = "tests; observes its heartbeats";
    assert!(lines.last().is_some_and(|line| line.ends_with(waits)), "{said}");
}

#[test]
fn check_prints_reports_of_tests() {
    let folder = folder();
    let entries = r#"{"devices":[{"name":"FEED","address":10},{"name":"GONE","address":99}]}"#;
    std::fs::write(folder.path().join("des.json"), entries).unwrap();
    let check = |format: &str| {
        let words = ["check", "sim:bus.toml", "--profile", "profile.toml", "--time", "4"];
        let mut command = command(&words, folder.path());
        let output = command.args(["--report", format]).output().expect("the program starts");
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let tap = check("tap");
    assert!(tap.starts_with("TAP version 13\n1.."), "{tap}");
    assert!(tap.contains("- des.json: missing\n  ---\n  message: \"1 missing\""), "{tap}");
    assert_eq!(tap.matches("\nnot ok ").count(), 2, "{tap}");
    let github = check("github");
    assert!(github.contains("::error title=des.json%3A missing::1 missing%0AGONE"), "{github}");
    assert!(github.ends_with("2 failed, 0 skipped\n"), "{github}");
}
