//! The profile: its file, the origin of each value, and what needs a value of its own.

use crate::common::harness::Stage;
use crate::common::pty::Pty;
use descan::app::TimelineKind;
use descan::discovery::{Config, OwnAddress};
use descan::sim::Scenario;
use descan::wire::id::Address;
use descan::wire::profile::{Profile, ProfileKey, ValueOrigin};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn descan(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(arguments)
        .current_dir(folder)
        .env("XDG_CONFIG_HOME", folder.join("config"))
        .stdin(Stdio::null())
        .output()
        .expect("the program starts")
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
            "line 1, column 1: modes: [1, 1, 2, 3, 4, 5, 6] is not seven different codes",
            "[modes]\n  ^^^^^^^",
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
    assert!(table.ends_with("p.toml: 1 of 34 values given\n"), "{table}");
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
