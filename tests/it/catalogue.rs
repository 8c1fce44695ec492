//! The catalogue of device types, from outside: names and fields of frames, the finding of a device
//! that differs from its type, mistakes in files, and files that are saved meanwhile.

use crate::common::harness::Stage;
use descan::catalogue::{Catalogue, CatalogueText, DeviceType};
use descan::discovery::Config;
use descan::shell::catalogue_folders::{CatalogueFolders, CatalogueWatcher};
use descan::sim::Scenario;
use descan::wire::profile::Profile;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

/// FEED and SENS, with data, a request of FEED's service, and a DEBUG message.
const LOG: &str = "\
(100.000000) can0 05140002#0601464545440000
(100.010000) can0 05180002#060153454E530000
(100.100000) can0 07155D01#0C031F10EC000000
(100.200000) can0 07195D01#0C031F10EC000000
(100.300000) can0 00002901#B004
(100.310000) can0 05140101#
(100.400000) can0 1F14FC21#E803
(100.500000) can0 07155D01#0C03
";

/// Two sensor boards, one of which lacks a service that its type has.
const SCENARIO: &str = r#"
bitrate = 125000
[profile.descriptor]
gid = 0x010
auto = true
[[device]]
name = "SENS"
label = "good"
gid = "000000000022"
address = { fixed = 12 }
settled = true
services = [["DES", "1.0"], ["CFG", "1.3"], ["TEMP", "1.7.2"], ["FILTR", "1.1"]]
[[device]]
name = "SENS"
label = "other"
gid = "000000000022"
address = { fixed = 13 }
settled = true
services = [["DES", "1.0"], ["CFG", "1.3"], ["TEMP", "1.8"], ["SMOKE", "1.0"]]
chatter = [{ service = 0x002, period_ms = 100, length = 3, debug = true }]
"#;

struct Folder(tempfile::TempDir);

impl Folder {
    /// With the example's types of devices, and an empty des.json.
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        folder.write("des.json", "{ \"devices\": [] }");
        folder.write("a.log", LOG);
        folder.write("bus.toml", SCENARIO);
        let devices = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/project/devices");
        std::fs::create_dir(folder.path("devices")).unwrap();
        for file in std::fs::read_dir(devices).unwrap().flatten() {
            let to = folder.path("devices").join(file.file_name());
            std::fs::copy(file.path(), to).unwrap();
        }
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).unwrap();
    }

    /// Returns exit code, standard output and standard error.
    fn run(&self, arguments: &[&str]) -> (i32, String, String) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
        command.args(arguments).current_dir(self.0.path()).env("TZ", "UTC").stdin(Stdio::null());
        command.env("XDG_CONFIG_HOME", self.path("config"));
        command.env("XDG_DATA_HOME", self.path("data"));
        let output = command.output().expect("the program starts");
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("output is UTF-8");
        (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
    }
}

fn texts(folder: &Folder) -> Vec<CatalogueText> {
    CatalogueFolders::only(&folder.path("devices")).read()
}

#[test]
fn log_names_services_and_shows_data_as_fields() {
    let folder = Folder::new();
    let (code, out, error) = folder.run(&["log", "a.log"]);
    assert_eq!((code, &*error), (0, ""), "{out}");
    let lines: Vec<&str> = out.lines().collect();
    let ends = |at: usize, text: &str| assert!(lines[at].ends_with(text), "{}", lines[at]);
    assert!(lines[2].contains("FEED@10→all          AUGER"), "{}", lines[2]);
    ends(2, "turns 780, load 12.4 %, running yes, back no, motor 23.6 °C, + 00 00");
    // The same service number on a device of another type.
    assert!(lines[3].contains("SENS@12→all          0x101"), "{}", lines[3]);
    ends(3, "0C 03 1F 10 EC 00 00 00");
    assert!(lines[4].contains("AUGER"), "{}", lines[4]);
    ends(4, "speed 1200 rpm");
    ends(6, "debug message JAMMED: current 10.00 A, tries –");
    ends(7, "turns 780, load –, running –, back –, motor –");
    let (_, out, _) = folder.run(&["log", "a.log", "--json"]);
    let frames: Vec<Value> = out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let expected = json!({
        "turns": 780, "load": 12.4, "running": true, "back": false, "motor": 23.6
    });
    assert_eq!((&frames[2]["fields"], &frames[2]["service_name"]), (&expected, &json!("AUGER")));
    assert_eq!(frames[3]["fields"], Value::Null);
    assert_eq!(frames[6]["fields"], json!({ "current": 10.0, "tries": null }));
    assert_eq!(frames[6]["service_name"], "JAMMED");
    let (_, out, _) = folder.run(&["log", "a.log", "--stats", "--json"]);
    let stats: Value = serde_json::from_str(&out).unwrap();
    let mut identifiers = stats["identifiers"].as_array().unwrap().iter();
    let debug = identifiers.find(|row| row["kind"] == "dbg").unwrap();
    assert_eq!(debug["service_name"], "JAMMED");
    let found = |filter: &str| folder.run(&["log", "a.log", "--filter", filter]).1.lines().count();
    assert_eq!((found("turns"), found("srv:AUGER"), found("jammed")), (2, 4, 1));
}

#[test]
fn device_that_is_not_as_its_type_is_a_finding_of_check() {
    let folder = Folder::new();
    let (code, out, error) = folder.run(&["check", "sim:bus.toml", "--json", "--time", "30"]);
    assert_eq!(code, 1, "{error}");
    let report: Value = serde_json::from_str(&out).unwrap();
    let found = |kind: &str| -> Vec<&Value> {
        let all = report["findings"].as_array().unwrap();
        all.iter().filter(|finding| finding["kind"] == kind).collect()
    };
    // Their GIDs are not read without their number.
    let by_name = found("catalogue-differs");
    assert_eq!(by_name.len(), 1, "{out}");
    assert_eq!(
        (&by_name[0]["address"], &by_name[0]["confidence"]),
        (&json!(13), &json!("suspected"))
    );
    folder.write("p.toml", "[descriptor]\ngid = 0x010\nauto = true\n");
    let (_, out, _) =
        folder.run(&["check", "sim:bus.toml", "--json", "--profile", "p.toml", "--time", "30"]);
    let report: Value = serde_json::from_str(&out).unwrap();
    let all = report["findings"].as_array().unwrap();
    let found: Vec<&Value> =
        all.iter().filter(|finding| finding["kind"] == "catalogue-differs").collect();
    assert_eq!(found.len(), 1, "{out}");
    assert_eq!(found[0]["confidence"], "confirmed");
    assert_eq!(
        found[0]["text"],
        "SENS at 13 is a Sensor board by its GID, but lacks FILTR; also has SMOKE; has TEMP 1.8, \
         not 1.7."
    );
    let device = |address: u8| -> &Value {
        let all = report["devices"].as_array().unwrap();
        all.iter().find(|device| device["address"] == address).unwrap()
    };
    assert_eq!(device(12)["type"]["by"], "gid");
    assert_eq!(device(12)["type"]["difference"], Value::Null);
    let debug = &device(13)["debug"];
    assert!(debug["count"].as_u64().unwrap() >= 8, "{debug}");
    assert_eq!(
        (&debug["codes"][0]["code"], &debug["codes"][0]["name"]),
        (&json!(2), &json!("ASSERT"))
    );
}

#[test]
fn file_with_a_mistake_is_named_with_its_line() {
    let folder = Folder::new();
    folder.write("devices/feeder.toml", "gid = '00 00 00 00 00 21'\n[[services]]\nnme = 'AUGER'\n");
    let (code, out, error) = folder.run(&["catalogue"]);
    assert_eq!(code, 1);
    assert!(out.contains("Sensor board") && out.ends_with("2 files\n"), "{out}");
    let expected = "devices/feeder.toml: line 3, column 1: unknown field `nme`";
    assert!(error.contains(expected) && error.contains("nme = 'AUGER'"), "{error}");
    let (code, _, error) = folder.run(&["log", "a.log"]);
    assert_eq!(code, 0);
    assert!(error.contains(expected) && error.contains("it is not used"), "{error}");
    let (code, _, error) = folder.run(&["log", "a.log", "--catalogue", "device"]);
    assert_eq!(code, 3);
    assert!(error.contains("catalogue device: not a folder"), "{error}");
    let (code, out, _) = folder.run(&["catalogue", "devices/sensor.toml", "--json"]);
    let files: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(
        (code, &files[0]["title"], &files[0]["services"]),
        (0, &json!("Sensor board"), &json!(4))
    );
    folder.write("devices/copy.toml", "gid = '000000000022'\ntitle = 'copy'");
    let (_, _, error) = folder.run(&["catalogue"]);
    assert!(error.contains("sensor.toml: the GID of devices/copy.toml, too"), "{error}");
}

#[test]
fn mistake_in_a_later_service_has_its_own_line() {
    let head = "name = 'A'\n[[services]]\nname = 'ONE'\nnumber = 0x100\n";
    for (text, place, wrong) in [
        ("[[services]]\nname = 'TWO'\nnumber = 0x400\n", (7, 10), "0 to 0x3FF, not 1024"),
        ("[[services]]\nname = 'ONE'\n", (6, 8), "two services are called ONE"),
        ("[[services]]\nname = 'TWO'\nnumber = 0x100\n", (7, 10), "ONE and TWO have one number"),
        ("[[services]]\nname = 'TWO'\nversion = ''\n", (7, 11), "TWO: a version has"),
        ("[[services]]\nname = 'TWO'\nsummary = \"\\n\"\n", (7, 11), "summary: at most"),
        (
            "[[services]]\nname = 'TWO'\ndata = [{ name = 'f', type = 'u8' }]",
            (6, 8),
            "need a number",
        ),
        (
            "[[services]]\nname = 'TWO'\nnumber = 2\n[[services.request]]\nname = 'f'\n\
             type = 'u8'\n[[services.request]]\nname = 'g'\ntype = 'u7'\n",
            (11, 1),
            "g: a type is one of",
        ),
        (
            "[[services]]\nname = 'TWO'\nnumber = 2\ndata = [\n  { name = 'f', type = 'u8' },\n  \
             { name = 'g', type = 'u8', values = { 256 = 'x' } },\n]\n",
            (10, 3),
            "g: the value 256 is not 0 to 255",
        ),
        (
            "[[debug]]\ncode = 1\nname = 'X'\n[[debug]]\ncode = 1\nname = 'Y'\n",
            (9, 8),
            "stands twice",
        ),
        (
            "[[debug]]\ncode = 1\nname = 'X'\n[[debug]]\ncode = 1024\nname = 'Y'\n",
            (9, 8),
            "0 to 0x3FF",
        ),
    ] {
        let error = DeviceType::parse(&format!("{head}{text}")).unwrap_err();
        assert!(error.message().contains(wrong), "{text}: {error}");
        assert_eq!(error.place(), place, "{text}: {error}");
    }
}

#[test]
fn number_of_two_common_files_is_named() {
    let folder = Folder::new();
    folder.write("devices/zz.toml", "[[debug]]\ncode = 2\nname = 'PANIC'\n");
    let said = "devices/zz.toml: DEBUG code 0x002 is ASSERT in devices/common.toml, too; that one";
    let (code, out, error) = folder.run(&["catalogue"]);
    assert!(code == 1 && error.contains(said) && out.contains("zz.toml"), "{error}{out}");
    let (code, _, error) = folder.run(&["log", "a.log"]);
    assert!(code == 0 && error.contains(said) && !error.contains("not used"), "{error}");
    let (_, out, _) = folder.run(&["catalogue", "--json"]);
    let files: Value = serde_json::from_str(&out).unwrap();
    let last = files.as_array().unwrap().last().unwrap();
    assert!(last["warning"].as_str().unwrap().contains("0x002") && last["fault"].is_null());
    // Both may name the same message; two services with one number contradict each other.
    folder.write("devices/zz.toml", "[[services]]\nname = 'A'\nnumber = 1\n");
    folder.write("devices/common.toml", "[[services]]\nname = 'B'\nnumber = 1\n");
    let (_, _, error) = folder.run(&["catalogue"]);
    assert!(error.contains("service 0x001 is B in devices/common.toml"), "{error}");
    folder.write("devices/zz.toml", "[[services]]\nname = 'B'\nnumber = 1\n");
    assert_eq!(folder.run(&["catalogue"]).0, 0);
}

#[test]
fn own_folder_of_the_user_is_read_behind_that_of_the_file() {
    let folder = Folder::new();
    std::fs::create_dir_all(folder.path("data/descan/devices")).unwrap();
    folder.write("data/descan/devices/a.toml", "gid = '000000000021'\ntitle = 'mine'");
    folder.write("data/descan/devices/b.toml", "gid = '000000000099'\ntitle = 'my other'");
    let (code, out, _) = folder.run(&["catalogue"]);
    assert_eq!(code, 0);
    assert!(out.contains("Pellet feeder") && !out.contains("mine"), "{out}");
    assert!(out.contains("my other"), "{out}");
    std::fs::remove_file(folder.path("des.json")).unwrap();
    let (_, out, _) = folder.run(&["catalogue"]);
    assert!(out.contains("mine") && !out.contains("Pellet"), "without des.json: {out}");
}

#[test]
fn screen_shows_a_saved_file_and_keeps_what_a_wrong_one_said() {
    let folder = Folder::new();
    let scenario = Scenario::parse(SCENARIO).unwrap();
    let profile = Profile::parse("[descriptor]\ngid = 0x010\nauto = true\n").unwrap();
    let config = Config { profile: Arc::new(profile), ..Config::default() };
    let mut stage = Stage::with(&scenario, None, config);
    stage.until(8.0);
    assert!(!stage.keys("enter").screen().contains("Sensor board"));
    let now = stage.app.now();
    let read = |stage: &Stage| Arc::new(stage.app.catalogue().read(texts(&folder)));
    let catalogue = read(&stage);
    stage.app.handle_catalogue(now, catalogue);
    stage.size(120, 50).until(12.0);
    let screen = stage.screen();
    assert!(screen.contains("Sensor board (by its GID)"), "{screen}");
    folder.write("devices/sensor.toml", "gid = 'F2'");
    let catalogue = read(&stage);
    stage.app.handle_catalogue(now, catalogue);
    let screen = stage.until(13.0).screen();
    assert!(screen.contains("Sensor board (by its GID)"), "{screen}");
    assert!(screen.contains("line 1") && screen.contains("12 hexadecimal digits"), "{screen}");
}

#[test]
fn debug_messages_of_a_code_are_one_line_of_the_timeline() {
    let scenario = Scenario::parse(SCENARIO).unwrap();
    let mut stage = Stage::new(&scenario, None);
    stage.size(120, 40).until(9.0).keys("3");
    let screen = stage.screen();
    let lines: Vec<&str> = screen.lines().filter(|line| line.contains("debug message")).collect();
    assert_eq!(lines.len(), 1, "{screen}");
    let times: u32 =
        lines[0].split('×').nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((60..100).contains(&times), "{}", lines[0]);
    assert_eq!(stage.app.timeline().entries().filter(|it| it.debug_code.is_some()).count(), 1);
}

#[test]
fn watcher_notices_files_that_come_change_and_go() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
    let folder = tempfile::tempdir().unwrap();
    // Neither the folder nor the one above it exists yet.
    let devices = folder.path().join("later/devices");
    let folders = CatalogueFolders::only(&devices);
    let watcher = CatalogueWatcher::spawn(folders.clone(), folders.read());
    let next = || {
        let changed =
            async { tokio::time::timeout(Duration::from_secs(30), watcher.changed()).await };
        let texts = runtime.block_on(changed).expect("a change is noticed");
        Catalogue::default().read(texts).len()
    };
    std::fs::create_dir_all(&devices).unwrap();
    std::fs::write(devices.join("a.toml"), "name = 'A'").unwrap();
    assert_eq!(next(), 1);
    std::fs::write(devices.join("b.new"), "name = 'B'").unwrap();
    std::fs::rename(devices.join("b.new"), devices.join("b.toml")).unwrap();
    assert_eq!(next(), 2);
    std::fs::remove_file(devices.join("a.toml")).unwrap();
    assert_eq!(next(), 1);
    std::fs::rename(&devices, folder.path().join("away")).unwrap();
    assert_eq!(next(), 0);
    std::fs::rename(folder.path().join("away"), &devices).unwrap();
    assert_eq!(next(), 1);
}
