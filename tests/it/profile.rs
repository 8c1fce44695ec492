//! The profile: its file, the origin of each value, and what needs a value of its own.

use crate::common::harness::Stage;
use crate::common::program::command;
use crate::common::pty::Pty;
use descan::app::TimelineKind;
use descan::discovery::{Config, OwnAddress};
use descan::sim::Scenario;
use descan::wire::id::Address;
use descan::wire::profile::{Profile, ProfileKey, ValueOrigin};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Output;

fn descan(arguments: &[&str], folder: &Path) -> Output {
    command(arguments, folder).output().expect("the program starts")
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

#[test]
fn mistake_has_its_line_column_and_the_line_itself() {
    let folder = tempfile::tempdir().unwrap();
    for (text, message, excerpt) in [
        (
            "[heartbeat]\nperiod_ms = 70000 # slow\n",
            "line 2, column 13: heartbeat.period_ms: 70000 is not 10 to 60000 milliseconds",
            "period_ms = 70000 # slow\n              ^^^^^",
        ),
        (
            "# numbers\n\n[services]\n  des = 0x400\n",
            "line 4, column 9: services.des: 1024 is not a service number, 0 to 0x3FF",
            "  des = 0x400\n          ^^^^^",
        ),
        (
            "services.des = 1",
            "line 1, column 16: services.des: 1 is not another number than services.heartbeat",
            "services.des = 1\n                 ^",
        ),
        (
            "[modes]\nINIT = 1\n",
            "line 2, column 8: modes.ARSLV: 1 is not another code than modes.INIT",
            "INIT = 1\n         ^",
        ),
        (
            "[services]\nheartbeat = 2\n",
            "line 2, column 13: services.des: 2 is not another number than services.heartbeat",
            "heartbeat = 2\n              ^",
        ),
        (
            "[heartbeat]\nuid_offset = 1\nmode_offset = 6\n",
            "line 3, column 15: heartbeat.mode_offset: 6 is a byte of heartbeat.uid_offset, too",
            "mode_offset = 6\n                ^",
        ),
        (
            "[heartbeat]\nperiode_ms = 1000\n",
            "line 2, column 1: unknown field `periode_ms`, expected one of `uid_offset`",
            "periode_ms = 1000\n  ^^^^^^^^^^",
        ),
        (
            "framing = \"morse\"",
            "line 1, column 11: unknown variant `morse`, expected one of `auto`, `isotp`, `raw`",
            "framing = \"morse\"\n            ^^^^^^^",
        ),
        (
            "[heartbeat]\nannounce = \"\u{9b}31mü\"\n",
            "line 2, column 12: announce is true, false or \"auto\", not \"\\x",
            "announce = \"?31mü\"\n             ^^^^^^^",
        ),
        ("services.des = \"x", "line 1, column 18: ", "services.des = \"x\n                   ^"),
        (
            "services.des = 5\nservices.des = 6\n",
            "line 2, column 10: duplicate key",
            "services.des = 6",
        ),
    ] {
        fs::write(folder.path().join("p.toml"), text).unwrap();
        let check = descan(&["profile", "check", "p.toml"], folder.path());
        let said = stderr(&check);
        assert_eq!(check.status.code(), Some(1), "{text}: {said}");
        assert!(said.starts_with(&format!("descan: p.toml: {message}")), "{text}: {said}");
        assert!(said.contains(&format!("\n  {excerpt}")), "{text}: {said}");
        assert!(said.chars().all(|c| c == '\n' || !c.is_control()), "{said:?}");
        // A command that needs it says the same in one line.
        let scan = descan(&["scan", "sim:boiler", "--profile", "p.toml"], folder.path());
        assert_eq!(scan.status.code(), Some(3), "{text}");
        let said = stderr(&scan);
        assert!(said.starts_with(&format!("descan: p.toml: {message}")), "{text}: {said}");
        assert_eq!(said.lines().count(), 1, "{said}");
    }
    let missing = descan(&["profile", "check", "none.toml"], folder.path());
    assert_eq!(missing.status.code(), Some(3), "{}", stderr(&missing));
}

#[test]
fn excerpt_of_a_long_line_is_short_and_marks_the_place() {
    let long = format!("services.des = {}", "9".repeat(10_000));
    let error = Profile::parse(&long).unwrap_err();
    assert!(error.excerpt().lines().all(|line| line.chars().count() <= 120), "{}", error.excerpt());
    let far = format!("uid.alphabet = \"{}\"", "ü".repeat(5000));
    let error = Profile::parse(&far).unwrap_err();
    assert_eq!(error.excerpt().lines().count(), 2);
}

#[test]
fn origin_of_each_value_is_told() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("p.toml"), "[services]\ndes = 0x002\n").unwrap();
    let check = descan(&["profile", "check", "p.toml"], folder.path());
    let table = String::from_utf8(check.stdout).unwrap();
    assert_eq!(check.status.code(), Some(0), "{table}");
    let row = |key: &str| table.lines().find(|line| line.starts_with(key)).unwrap_or(&table);
    assert_eq!(row("services.des").split_whitespace().nth(2), Some("given"));
    assert_eq!(row("services.heartbeat").split_whitespace().nth(2), Some("assumed"));
    assert!(table.ends_with("p.toml: 1 of 41 values given\n"), "{table}");
    let json = descan(&["profile", "check", "p.toml", "--json"], folder.path());
    let values: Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!(values["services.des"], serde_json::json!({ "value": 2, "origin": "given" }));
    assert_eq!(values.as_object().unwrap().len(), ProfileKey::ALL.len());

    let log = "(1436509052.1) can0 07140401#8AFA6C9724110400\n";
    fs::write(folder.path().join("x.log"), log).unwrap();
    let scan = ["scan", "--json", "file:x.log", "--profile", "p.toml"];
    let scan: Value = serde_json::from_slice(&descan(&scan, folder.path()).stdout).unwrap();
    assert_eq!(scan["buses"][0]["profile"], values);

    // The printed profile sets nothing.
    let printed = String::from_utf8(descan(&["profile"], folder.path()).stdout).unwrap();
    let printed = Profile::parse(&printed).unwrap();
    assert!(!printed.reads_otherwise(&Profile::default()));
    assert!(!printed.is_given(ProfileKey::Identify));
}

#[test]
fn each_command_needs_its_own_key() {
    let stage = |profile: &str| {
        let profile = Profile::parse(profile).unwrap().into();
        let config = Config { profile, seed: 7, ..Config::default() };
        let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), None, config);
        stage.until(10.0).keys("i");
        stage.screen()
    };
    for other in ["", "services.des = 0x002", "commands.mode = 0x019", "[commands]"] {
        let screen = stage(other);
        assert!(screen.contains("identify needs a profile with commands.identify"), "{screen}");
    }
    assert!(stage("commands.identify = 0x018").contains("Send identify (service 0x018)"));
}

#[test]
fn sign_of_assumed_values_goes_when_all_that_matter_are_given() {
    let given = "services = { heartbeat = 1, des = 2 }\nheartbeat.uid_offset = 0\n";
    for (profile, is_assumed) in
        [(given.to_owned(), true), (format!("{given}heartbeat.mode_offset = 6"), false)]
    {
        let profile = Profile::parse(&profile).unwrap().into();
        let config = Config { profile, ..Config::default() };
        let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), None, config);
        assert_eq!(stage.until(5.0).screen().contains("≈ assumed"), is_assumed);
    }
}

/// Lines of the timeline of one kind.
fn lines(stage: &Stage, kind: TimelineKind) -> Vec<String> {
    stage.app.timeline().entries().filter(|it| it.kind == kind).map(|it| it.text.clone()).collect()
}

#[test]
fn saved_profile_is_in_force_at_once() {
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), None);
    stage.until(22.0);
    let named = |stage: &Stage| {
        stage.app.buses()[0].devices().iter().filter(|device| device.name.is_some()).count()
    };
    assert!(named(&stage) >= 8);
    let sent = stage.app.buses()[0].counters().frames;
    let save = |stage: &mut Stage, text: &str| {
        let now = stage.app.now();
        stage.app.handle_profile(
            now,
            "line7.toml",
            Profile::parse(text).map_err(|it| it.to_string()),
        );
    };
    // Names of services and numbers of commands change nothing for devices.
    save(&mut stage, "commands.identify = 0x01F\n[service_names]\n\"0x101\" = \"AUGER\"\n");
    assert!(named(&stage) >= 8, "devices stay");
    stage.keys("i");
    assert!(stage.screen().contains("Send identify (service 0x01F)"), "{}", stage.screen());
    stage.keys("n");
    // A wrong one changes nothing at all.
    save(&mut stage, "services.des = 5000");
    let errors = lines(&stage, TimelineKind::Error).join("\n");
    assert!(errors.contains("line7.toml: line 1, column 16: services.des: 5000"), "{errors}");
    assert!(errors.contains("the profile before stays in force"), "{errors}");
    assert!(named(&stage) >= 8);
    assert_eq!(stage.app.buses()[0].config().profile.commands.identify, 0x1F);
    // Another number of DES: devices start over, and no device responds to it.
    save(&mut stage, "services.des = 0x005");
    assert_eq!(stage.app.buses()[0].devices().len(), 0);
    let own = |stage: &Stage| stage.app.buses()[0].own_address();
    assert!(matches!(own(&stage), OwnAddress::Held(Address::DEBUG)), "descan stays where it is");
    let moment = stage.app.now();
    stage.until(32.0);
    assert_eq!(named(&stage), 0);
    assert!(matches!(own(&stage), OwnAddress::Held(Address::DEBUG)), "{:?}", own(&stage));
    assert!(stage.app.buses()[0].devices().len() >= 8, "heartbeats are as before");
    assert!(stage.app.buses()[0].counters().frames > sent, "counters go on");
    let told = lines(&stage, TimelineKind::File).join("\n");
    assert!(told.contains("services.des 0x002 → 0x005"), "{told}");
    assert!(told.contains("devices start over"), "{told}");
    // And back: all as at first.
    save(&mut stage, "");
    stage.until(50.0);
    assert!(named(&stage) >= 8);
    assert_eq!(stage.app.buses()[0].config().profile.origin(ProfileKey::Des), ValueOrigin::Assumed);
    // Without a fitting heartbeat the devices are asked all the same.
    save(&mut stage, "services.heartbeat = 0x3FF");
    stage.until(60.0);
    assert!(named(&stage) >= 8);
    // The past is read by the profile of its time.
    let before = stage
        .app
        .history()
        .moment(stage.app.capture(), moment - descan::time::Duration::from_secs(1));
    let mut replay = stage.app.history().replay(stage.app.capture(), before).unwrap();
    while !replay.run(stage.app.history(), stage.app.capture(), 1000) {}
    let past = replay.into_buses();
    let bus = past.iter().next().unwrap();
    assert!(bus.devices().iter().filter(|it| it.name.is_some()).count() >= 8);
}

fn started(folder: &Path, bus: &str) -> Pty {
    Pty::start(&[bus, "--profile", "p.toml"], folder, (120, 40))
}

#[test]
fn file_of_the_profile_is_watched() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("p.toml");
    fs::write(&path, "services.des = 0x002\n").unwrap();
    let mut pty = started(folder.path(), "sim:boiler");
    pty.wait_for("FEED");
    fs::write(folder.path().join("new"), "services.des = 0x800\n").unwrap();
    fs::rename(folder.path().join("new"), &path).unwrap();
    pty.wait_for("before stays in force");
    fs::write(&path, "services.des = 0x005\n").unwrap();
    pty.wait_for("devices start over");
    pty.send("q");
    assert_eq!(pty.wait(), 0);

    // A log is read again from its start.
    fs::write(&path, "services.heartbeat = 0x3FF\n").unwrap();
    let line = "(1436509000.1) can0 07140401#8AFA6C9724110400\n";
    let log = line.repeat(3);
    fs::write(folder.path().join("x.log"), log).unwrap();
    let mut pty = started(folder.path(), "file:x.log");
    pty.wait_for("end of log");
    fs::write(&path, "services.heartbeat = 0x001\n").unwrap();
    pty.wait_for("BOILER01");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

// ---- learning ------------------------------------------------------------------------------

/// A log of two devices with heartbeats at 0x155, every 500 ms, mode first, for `seconds`.
fn log_of_two(seconds: u32) -> String {
    let mut lines = Vec::new();
    for beat in 0..seconds * 2 {
        for (address, serial) in [(10_u32, 0x11), (12, 0x12)] {
            let time = 1_700_000_000.0 + f64::from(beat) * 0.5 + f64::from(address) * 0.01;
            let claims = beat == 0;
            let (flags, mode) = if claims { (0x17, 1) } else { (0x07, 4) };
            let rnd7 = beat * 37 % 128;
            let id = flags << 24 | address << 17 | rnd7 << 10 | 0x155;
            lines.push(format!("({time:.6}) can0 {id:08X}#{mode:02X}8AFA6C9724{serial:02X}00\n"));
        }
    }
    lines.concat()
}

#[test]
fn learn_prints_values_with_evidence_and_why_others_are_unknown() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("two.log");
    fs::write(&log, log_of_two(12)).unwrap();
    let bus = format!("file:{}", log.display());
    let output = descan(&["profile", "learn", &bus], folder.path());
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    assert_eq!(output.status.code(), Some(0), "{text}");
    for line in [
        "can0: 48 frames in 11.5 s",
        "services.heartbeat     0x001 assumed    ≠ 0x155   certain 2 nodes, every 500 ms",
        "heartbeat.period_ms    1000 assumed     ≠ 500     certain 46 intervals of 2 nodes",
        "heartbeat.mode_offset  6 assumed        ≠ 0       certain 2 values, changes with U in 2 nodes",
        "heartbeat.uid_offset   0 assumed          –       –       fewer than three UIDs",
        "services.des           0x002 assumed      –       –       no name request and a response",
    ] {
        assert!(text.contains(line), "{line}\n{text}");
    }
    let output = descan(&["profile", "learn", &bus, "--json"], folder.path());
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let heartbeat = &json["buses"][0]["proposals"][0];
    assert_eq!(
        (&heartbeat["key"], &heartbeat["value"]),
        (&"services.heartbeat".into(), &0x155.into())
    );
    assert_eq!((&heartbeat["now"], &heartbeat["origin"]), (&1.into(), &"assumed".into()));
    assert!(heartbeat["frames"][0]["frame"].as_str().unwrap().contains('#'), "{heartbeat}");
    let unknown = json["buses"][0]["unknown"].as_array().unwrap();
    assert!(unknown.iter().any(|it| it["key"] == "services.des"), "{json}");
}

#[test]
fn learnt_profile_has_given_values_and_overwrites_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    fs::write(path("two.log"), log_of_two(12)).unwrap();
    fs::write(path("given.toml"), "[services]\ndes = 0x123\n").unwrap();
    let bus = format!("file:{}", path("two.log"));
    let (given, learnt) = (path("given.toml"), path("learnt.toml"));
    let arguments = ["profile", "learn", &bus, "--profile", &given, "--write", &learnt];
    let output = descan(&arguments, folder.path());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let text = fs::read_to_string(&learnt).unwrap();
    let profile = Profile::parse(&text).unwrap_or_else(|error| panic!("{error}: {text}"));
    assert_eq!((profile.services.heartbeat, profile.services.des), (0x155, 0x123), "{text}");
    assert!(text.contains("heartbeat = 0x155  # learnt, certain: 2 nodes, every 500 ms"), "{text}");
    let output = descan(&arguments, folder.path());
    let stderr = stderr(&output);
    assert_eq!((output.status.code(), stderr.lines().count()), (Some(3), 1), "{stderr}");
    assert!(stderr.contains("learnt.toml") && stderr.contains("exists"), "{stderr}");
    assert_eq!(fs::read_to_string(&learnt).unwrap(), text, "not written again");
}

#[test]
fn log_without_known_values_gives_none() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("short.log");
    fs::write(&log, log_of_two(3)).unwrap();
    let (bus, file) = (format!("file:{}", log.display()), folder.path().join("none.toml"));
    let output =
        descan(&["profile", "learn", &bus, "--write", file.to_str().unwrap()], folder.path());
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("frames of 2.5 s; 8 s are needed"), "{text}");
    let stderr = stderr(&output);
    assert!(stderr.contains("not written: no value was learnt"), "{stderr}");
    assert!(!file.exists());
}

#[test]
fn number_of_two_keys_is_a_mistake() {
    for (text, message) in [
        (
            "[descriptor]\ngid = 0x01A\n[commands]\nreboot = 0x01A\n",
            "line 4, column 10: commands.reboot: 0x01A is the number of descriptor.gid, too",
        ),
        (
            "[commands]\nidentify = 0x001\n",
            "line 2, column 12: commands.identify: 0x001 is the number of services.heartbeat, too",
        ),
        (
            "[commands]\nmode = 0x002\n",
            "line 2, column 8: commands.mode: 0x002 is the number of services.des, too",
        ),
        (
            "[writes]\naddress = 0x100\nbitrate = 0x100\n",
            "line 3, column 11: writes.bitrate: 0x100 is the number of writes.address, too",
        ),
        (
            "[descriptor]\ngid = false\n",
            "line 2, column 7: a service number is 0 to 0x3FF (1023), without quotes",
        ),
        (
            "[services]\ndes = \"0x002\"\n",
            "line 2, column 7: a service number is 0 to 0x3FF (1023), without quotes",
        ),
        (
            "[heartbeat]\nperiod_ms = \"1 s\"\n",
            "line 2, column 13: invalid type: string \"1 s\", expected a whole number, 0 to 4294967295",
        ),
        (
            "[descriptor]\nbyte_order = true\n",
            "line 2, column 14: a byte order is \"little\" or \"big\"",
        ),
    ] {
        let error = Profile::parse(text).unwrap_err().to_string();
        assert_eq!(error, message);
    }
    let both =
        "[descriptor]\naddr = 0x016\nbspd = 0x015\n[writes]\naddress = 0x016\nbitrate = 0x015\n";
    assert!(Profile::parse(both).is_ok());
    // An assumed number is neither sent nor read.
    assert!(Profile::parse("[commands]\nreboot = 0x010\n").is_ok());
    // What is learnt takes no number of a command.
    let mut profile = Profile::parse("[commands]\nreboot = 0x123\n").unwrap();
    let number = descan::wire::profile::ProfileValue::Service(0x123);
    assert!(!profile.learn(ProfileKey::Des, &number));
}
