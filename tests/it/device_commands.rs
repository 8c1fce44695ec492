//! Commands to one device, on the command line and on the screen, against simulated devices.

use crate::common::harness::Stage;
use crate::common::program::{self, text};
use descan::app::{DeviceCommand, TimelineKind};
use descan::discovery::Config;
use descan::sim::Scenario;
use descan::wire::descriptor::AddressSetting;
use descan::wire::node::Mode;
use descan::wire::profile::{Profile, ProfileKey};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Output;

const PROFILE: &str = "[descriptor]\ngid = 0x010\nfw = 0x013\naddr = 0x016\nbspd = 0x015\n\
    [commands]\nidentify = 0x018\nmode = 0x019\nreboot = 0x01A\n\
    [writes]\naddress = 0x016\nbitrate = 0x015\n";

const BUS: &str = r#"
bitrate = 125000
[profile.commands]
reboot = 0x01A
[profile.writes]
address = 0x016
bitrate = 0x015
[[device]]
name = "FEED"
uid = "BOILER01"
address = { fixed = 10 }
settled = true
firmware = [2, 1]
gid = "000000000021"
[[device]]
name = "SENS"
label = "one"
address = { fixed = 12 }
settled = true
faults = ["short-descriptor"]
[[device]]
name = "SENS"
label = "two"
address = { fixed = 13 }
settled = true
faults = ["locked"]
[[device]]
name = "MUTE"
address = { fixed = 14 }
settled = true
faults = ["no-descriptor"]
"#;

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bus.toml"), BUS).unwrap();
    std::fs::write(folder.path().join("profile.toml"), PROFILE).unwrap();
    folder
}

/// Runs a command on the bus without a terminal.
fn descan(folder: &Path, command: &str, rest: &[&str]) -> Output {
    let words = [&[command, "sim:bus.toml"], rest].concat();
    program::command(&words, folder).output().expect("the program starts")
}

#[test]
fn command_says_what_is_sent_and_how_it_ended() {
    let folder = folder();
    let given = ["--profile", "profile.toml", "--yes"];
    let cases: [(&str, &[&str], i32, &str, &str); 6] = [
        (
            "mode",
            &["FEED", "IDLE"],
            0,
            "Send mode IDLE (service 0x019, data 06) to FEED at 10. It stops working",
            "mode IDLE (00002819#06): the device responded\n",
        ),
        (
            "identify",
            &["BOILER01"],
            0,
            "Send identify (service 0x018) to FEED at 10.",
            "identify (00002818#): the device responded\n",
        ),
        (
            "address",
            &["13", "preferred", "22"],
            1,
            "Send address preferred 22 (service 0x016, data 96) to SENS at 13.",
            "address preferred 22 (00003416#96): refused with an error response\n",
        ),
        (
            "address",
            &["FEED", "fixed 12"],
            0,
            "12 is used by SENS: it stays mute until that is gone.",
            "address fixed 12 (00002816#0C): the device responded\n",
        ),
        (
            "bitrate",
            &["FEED", "250k"],
            0,
            "The bus has 125 kbit/s: it leaves this bus, and is out of reach here.",
            "bit rate fixed 250 kbit/s (00002815#01): the device responded\n",
        ),
        (
            "restart",
            &["MUTE"],
            1,
            "It leaves the bus for some seconds.",
            "restart (0000381A#): no response within 1000 ms",
        ),
    ];
    std::thread::scope(|scope| {
        for (command, rest, code, asked, outcome) in cases {
            let folder = folder.path();
            scope.spawn(move || {
                let output = descan(folder, command, &[rest, &given[..]].concat());
                let (told, said) = (text(&output.stdout), text(&output.stderr));
                assert!(said.contains(asked), "{command}: {said}");
                assert!(told.starts_with(outcome), "{command}: {told}");
                assert_eq!(output.status.code(), Some(code), "{command}");
            });
        }
    });
}

#[test]
fn command_without_consent_key_or_device_sends_nothing() {
    let folder = folder();
    let given = ["--profile", "profile.toml"];
    let cases: [(&str, Vec<&str>, i32, &str); 6] = [
        ("mode", [&["FEED", "IDLE"][..], &given].concat(), 2, "no terminal: give --yes"),
        ("identify", vec!["FEED", "--yes"], 3, "identify needs a profile with commands.identify"),
        (
            "identify",
            [&["SENS", "--yes"][..], &given].concat(),
            2,
            "several devices are SENS, at 12 and at 13: give the address of one",
        ),
        (
            "restart",
            [&["NOPE", "--yes", "--time", "4"][..], &given].concat(),
            3,
            "NOPE was not found; there are FEED at 10, SENS at 12",
        ),
        (
            "restart",
            [&["12", "--yes", "--time", "4", "--listen-only"][..], &given].concat(),
            3,
            "listen-only: no requests are sent",
        ),
        ("mode", vec!["FEED", "INIT", "--yes"], 2, "a device enters INIT by itself"),
    ];
    std::thread::scope(|scope| {
        for (at, (command, rest, code, why)) in cases.into_iter().enumerate() {
            let folder = folder.path();
            scope.spawn(move || {
                let log = format!("{at}.log");
                let recorded = [&rest[..], &["--record", &log]].concat();
                let output = descan(folder, command, &recorded);
                let said = text(&output.stderr);
                assert!(said.contains(why), "{command}: {said}");
                assert_eq!(output.status.code(), Some(code), "{command}: {said}");
                let frames = std::fs::read_to_string(folder.join(log)).unwrap_or_default();
                let is_command = |line: &&str| {
                    let id = line.split([' ', '#']).nth(2).unwrap_or_default();
                    u32::from_str_radix(id, 16)
                        .is_ok_and(|id| (0x010..=0x01A).contains(&(id & 0x3FF)))
                };
                assert_eq!(frames.lines().find(is_command), None, "{command}");
            });
        }
    });
}

#[test]
fn descriptor_is_printed_as_text_and_as_json() {
    let folder = folder();
    let given = ["--profile", "profile.toml"];
    std::thread::scope(|scope| {
        let run = |rest: &[&str]| {
            let output = descan(folder.path(), rest[0], &[&rest[1..], &given[..]].concat());
            (text(&output.stdout), output.status.code())
        };
        scope.spawn(move || {
            let (told, code) = run(&["descriptor", "FEED"]);
            assert_eq!(
                told,
                "GID        0x000000000021\nfirmware   2.1\nbit rate   preferred 125 kbit/s\n\
                 address    fixed 10\n"
            );
            assert_eq!(code, Some(0));
        });
        scope.spawn(move || {
            let (told, code) = run(&["address", "10"]);
            assert_eq!((told.as_str(), code), ("address    fixed 10\n", Some(0)));
        });
        scope.spawn(move || {
            let (told, code) = run(&["descriptor", "12", "--json"]);
            let told: Value = serde_json::from_str(&told).unwrap();
            assert_eq!(told["address"], 12);
            assert_eq!(told["descriptor"]["fw"], Value::Null);
            assert_eq!(
                told["descriptor"]["faults"]["fw"],
                serde_json::json!({ "fault": "malformed", "data": "010000" })
            );
            assert_eq!(code, Some(1));
        });
        scope.spawn(move || {
            let (told, code) = run(&["mode", "FEED", "CFG", "--yes", "--json"]);
            let told: Value = serde_json::from_str(&told).unwrap();
            let expected = serde_json::json!({
                "descan": env!("CARGO_PKG_VERSION"), "bus": "sim:bus.toml", "address": 10,
                "name": "FEED", "command": "mode CFG", "frame": "00002819#02",
                "outcome": "responded", "data": ""
            });
            assert_eq!((told, code), (expected, Some(0)));
        });
    });
}

/// The boiler with a profile that has the keys of all commands.
fn boiler() -> Stage {
    let config =
        Config { profile: Profile::parse(PROFILE).unwrap().into(), seed: 7, ..Config::default() };
    let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), None, config);
    stage.until(10.0);
    stage
}

#[test]
fn command_is_typed_asked_for_and_reported_with_its_frame() {
    let mut stage = boiler();
    stage.size(120, 40).keys("E").text("mode cfg").keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("Send mode CFG (service 0x019, data 02) to FEED at 10?"), "{screen}");
    assert!(screen.contains("It stops working until it is set to WORK or restarts."), "{screen}");
    stage.keys("y").until(12.0);
    let line =
        stage.app.timeline().entries().find(|line| line.text.starts_with("mode CFG")).unwrap();
    assert_eq!(line.text, "mode CFG (00002819#02): the device responded");
    assert_eq!(line.kind, TimelineKind::Improved);
    let feed = stage.app.buses()[0].devices().iter().find(|it| it.is_named(b"FEED")).unwrap();
    assert_eq!(feed.mode, Some(Mode::Cfg));
    // The state of the past has it, too.
    stage.keys("g").text("-1s").keys("Enter").until(12.5);
    stage.keys("E");
    assert!(stage.screen().contains("Space shows the present first"), "{}", stage.screen());
}

#[test]
fn command_in_wrong_words_or_without_its_key_is_not_asked_for() {
    let mut stage = boiler();
    stage.size(120, 40).keys("E").text("mode init").keys("Enter");
    assert!(stage.screen().contains("a device enters INIT by itself"), "{}", stage.screen());
    let config = Config {
        profile: Profile::parse("commands.identify = 0x018").unwrap().into(),
        seed: 7,
        ..Config::default()
    };
    let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), None, config);
    stage.size(120, 40).until(10.0).keys("E").text("restart");
    assert!(stage.screen().contains("needs commands.reboot in a profile"), "{}", stage.screen());
    stage.keys("Enter");
    assert!(!stage.screen().contains("Send restart"), "{}", stage.screen());
}

#[test]
fn learnt_values_allow_no_command() {
    let mut profile = Profile::default();
    for key in [ProfileKey::Identify, ProfileKey::Mode, ProfileKey::WriteAddress] {
        let value = descan::wire::profile::ProfileValue::Service(0x123);
        assert!(!profile.learn(key, &value), "{}", key.name());
    }
    for command in [
        DeviceCommand::Identify,
        DeviceCommand::Mode(Mode::Cfg),
        DeviceCommand::Restart,
        DeviceCommand::Address(AddressSetting::None),
    ] {
        assert_eq!(command.request(&profile), None);
    }
}

#[test]
fn des_is_searched_only_on_a_device_that_does_not_work() {
    let folder = tempfile::tempdir().unwrap();
    let bus = "bitrate = 125000\n[profile.services]\ndes = 0x00A\n\
        [[device]]\nname = \"FEED\"\naddress = { fixed = 10 }\nsettled = true\nautostart = false\n\
        faults = [\"no-descriptor\"]\n\
        [[device]]\nname = \"SENS\"\naddress = { fixed = 12 }\nsettled = true\n\
        [[device]]\nname = \"ACT\"\naddress = { fixed = 14 }\nsettled = true\nautostart = false\n";
    std::fs::write(folder.path().join("bus.toml"), bus).unwrap();
    std::thread::scope(|scope| {
        let learn = |rest: &[&str]| {
            let words = [&["profile", "learn", "sim:bus.toml", "--search"], rest].concat();
            let mut command = program::command(&words, folder.path());
            let output = command.output().expect("the program starts");
            (text(&output.stdout), text(&output.stderr), output.status.code())
        };
        scope.spawn(move || {
            let (told, said, code) = learn(&["10", "--yes"]);
            assert!(said.contains("answered with a DES response on service 0x00A"), "{said}");
            let learnt = "services.des           0x002 assumed    ≠ 0x00A   likely  1 response with \
                          a name, of 1 node, by the search";
            assert!(told.contains(learnt), "{told}");
            assert_eq!(code, Some(0));
            let (told, _, _) = learn(&["10", "--yes", "--search-from", "0x008", "--json"]);
            let told: Value = serde_json::from_str(&told).unwrap();
            assert_eq!(
                told["search"],
                json!({
                    "device": 10, "outcome": "found", "service": 10, "requests": 5,
                    "text": "answered with a DES response on service 0x00A"
                })
            );
        });
        scope.spawn(move || {
            let (_, said, code) = learn(&["12", "--yes"]);
            assert!(said.contains("the device at 12 is working: set it to CFG or BOOT"), "{said}");
            assert_eq!(code, Some(3));
        });
        scope.spawn(move || {
            let (_, said, code) = learn(&["14", "--yes", "--search-from", "0x016"]);
            assert!(said.contains("stopped: answered on service 0x018, with no DES"), "{said}");
            assert_eq!(code, Some(1), "nothing is known");
        });
        scope.spawn(move || {
            let (_, said, code) = learn(&["10"]);
            assert!(said.contains("there is no terminal: give --yes"), "{said}");
            assert_eq!(code, Some(2));
        });
    });
}
