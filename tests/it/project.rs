//! The project file, from outside: what a folder with `descan.toml` opens, what wins over it, and
//! mistakes in it.

use crate::common::pty::Pty;
use descan::bus::BusSpec;
use descan::project::Project;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

struct Folder(tempfile::TempDir);

impl Folder {
    fn empty() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// A copy of the example project, as a clone of its repository.
    fn example() -> Self {
        let folder = Self::empty();
        let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/project");
        std::fs::create_dir(folder.path("devices")).unwrap();
        for part in ["", "devices"] {
            for entry in std::fs::read_dir(example.join(part)).unwrap().flatten() {
                if entry.path().is_file() {
                    let to = folder.path(part).join(entry.file_name());
                    std::fs::copy(entry.path(), to).unwrap();
                }
            }
        }
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).unwrap();
    }

    /// Runs the program in a folder; returns exit code, standard output and standard error.
    fn run_in(&self, inner: &str, arguments: &[&str]) -> (i32, String, String) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
        command.args(arguments).current_dir(self.path(inner)).stdin(Stdio::null());
        for (name, folder) in [("CONFIG", "config"), ("DATA", "data"), ("STATE", "state")] {
            command.env(format!("XDG_{name}_HOME"), self.path(folder));
        }
        let output = command.output().expect("the program starts");
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("output is UTF-8");
        (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
    }

    fn run(&self, arguments: &[&str]) -> (i32, String, String) {
        self.run_in("", arguments)
    }
}

fn json_of(out: &str) -> Value {
    serde_json::from_str(out).unwrap_or_else(|error| panic!("{error}: {out}"))
}

#[test]
fn folder_of_a_project_opens_all_its_buses_with_names() {
    let folder = Folder::example();
    std::fs::create_dir(folder.path("in")).unwrap();
    let (code, out, error) = folder.run_in("in", &["check", "--json", "--time", "30"]);
    assert_eq!(code, 0, "{out}{error}");
    let report = json_of(&out);
    let bus = |at: usize| report["buses"][at]["name"].clone();
    assert_eq!((bus(0), bus(1)), (json!("sim:main.toml"), json!("sim:spare.toml")));
    let devices = report["devices"].as_array().unwrap();
    let named: Vec<_> = devices
        .iter()
        .map(|it| (it["name"].as_str().unwrap(), it["type"]["title"].as_str().unwrap()))
        .collect();
    let sensor = ("SENS", "Sensor board");
    assert_eq!(named, [("FEED", "Pellet feeder"), sensor, sensor]);
    // The profile of the project is in force.
    assert_eq!(report["buses"][0]["profile"]["descriptor.auto"]["value"], json!(true));
    assert_eq!(report["file"]["entries"], 3);
}

#[test]
fn buses_and_options_of_the_command_line_win() {
    let folder = Folder::example();
    folder.write("other.json", "{ \"devices\": [] }");
    folder.write("other.toml", "[services]\ndes = 0x002\n");
    let options = ["--file", "other.json", "--profile", "other.toml", "--time", "30"];
    let (_, out, error) =
        folder.run(&[&["scan", "sim:spare.toml", "--json"][..], &options].concat());
    let report = json_of(&out);
    assert_eq!(report["buses"].as_array().unwrap().len(), 1, "{error}");
    assert_eq!(report["file"]["entries"], 0);
    let (origin, auto) = ("origin", &report["buses"][0]["profile"]["descriptor.auto"]);
    assert_eq!(auto[origin], "assumed");
    // Its types of devices are still known.
    assert_eq!(report["devices"][0]["type"]["title"], "Sensor board");
    let (_, out, _) =
        folder.run(&["scan", "sim:spare.toml", "--json", "--no-project", "--time", "30"]);
    let report = json_of(&out);
    assert_eq!(report["buses"][0]["name"], "sim:spare.toml");
    assert_eq!(report["file"]["path"], "des.json");
    let file = folder.path("descan.toml");
    let other = Folder::empty();
    let (code, out, error) =
        other.run(&["scan", "--json", "--project", file.to_str().unwrap(), "--time", "30"]);
    assert_eq!((code, json_of(&out)["devices"].as_array().unwrap().len()), (0, 3), "{error}");
}

#[test]
fn device_without_a_name_may_be_that_of_a_task() {
    let folder = Folder::example();
    let (_, out, _) = folder.run(&["check", "--json", "--listen-only", "--time", "7"]);
    let findings = json_of(&out)["findings"].clone();
    let kinds = findings.as_array().unwrap().iter().map(|it| it["kind"].as_str().unwrap());
    let kinds: Vec<&str> = kinds.collect();
    assert!(!kinds.contains(&"task-failed") && !kinds.contains(&"redundancy-lost"), "{kinds:?}");
}

/// A project whose second bus has its own des.json, in a folder of its own.
fn with_own_file() -> Folder {
    let folder = Folder::example();
    std::fs::create_dir(folder.path("south")).unwrap();
    folder.write("south/des.json", "[ { \"name\": \"SENS\", \"address\": 14, \"static\": true } ]");
    let text = std::fs::read_to_string(folder.path("descan.toml")).unwrap();
    let own = "bus = \"sim:spare.toml\"\nfile = \"south/des.json\"\nbitrate";
    folder.write("descan.toml", &text.replace("bus = \"sim:spare.toml\"\nbitrate", own));
    folder
}

#[test]
fn each_bus_is_checked_against_its_own_file() {
    let folder = with_own_file();
    let (code, out, error) = folder.run(&["check", "--time", "20"]);
    assert_eq!(code, 1, "{out}{error}");
    for line in [
        "  sim:spare.toml: SENS is at address 12; the file pins it to 14.\n",
        "`bus` is sim:spare.toml, whose file is south/des.json; move the entry there",
        "\nsouth/des.json: 1 entry, 1 device on sim:spare.toml: 1 wrong address\n",
    ] {
        assert!(out.contains(line), "{line}: {out}");
    }
    let (_, out, _) = folder.run(&["scan", "--json", "--time", "20"]);
    let report = json_of(&out);
    let files: Vec<_> = report["files"].as_array().unwrap().iter().collect();
    assert_eq!(files.len(), 2);
    assert_eq!(files[0]["buses"], json!(["sim:main.toml"]));
    assert_eq!((&files[1]["buses"], &files[1]["entries"]), (&json!(["sim:spare.toml"]), &json!(1)));
    let spare = report["devices"].as_array().unwrap().iter().find(|it| it["uid"] == "BOILER12");
    assert_eq!(spare.unwrap()["file"]["address"], 14);
    // A written file has the devices of all buses, each with its bus.
    folder.run(&["scan", "--write", "all.json", "--time", "20"]);
    let written = std::fs::read_to_string(folder.path("all.json")).unwrap();
    assert_eq!(written.matches("\"bus\": \"sim:").count(), 3, "{written}");
    // One bus alone has its file alone.
    let (_, out, _) = folder.run(&["scan", "sim:spare.toml", "--json", "--time", "20"]);
    assert_eq!(json_of(&out)["files"], Value::Null);
    assert_eq!(json_of(&out)["file"]["entries"], 1);
}

#[test]
fn missing_file_of_one_bus_is_named() {
    let folder = with_own_file();
    std::fs::remove_file(folder.path("south/des.json")).unwrap();
    let (code, _, error) = folder.run(&["check", "--time", "20"]);
    assert_eq!(code, 3);
    assert!(error.contains("south/des.json: file not found"), "{error}");
    assert!(error.contains("descan scan sim:spare.toml --write"), "{error}");
}

#[test]
fn one_file_in_several_spellings_is_one_file() {
    let folder = with_own_file();
    std::os::unix::fs::symlink("des.json", folder.path("link.json")).unwrap();
    std::os::unix::fs::symlink("south", folder.path("again")).unwrap();
    let text = std::fs::read_to_string(folder.path("descan.toml")).unwrap();
    for spelling in ["des.json", "./south/../des.json", "link.json", "new.json", "again/des.json"] {
        let text = text.replace("file = \"south/des.json\"", &format!("file = \"{spelling}\""));
        let first = "bus = \"sim:main.toml\"\n";
        let text = match spelling {
            // Neither of the two exists.
            "new.json" => text.replace(first, &format!("{first}file = \"./south/../new.json\"\n")),
            "again/des.json" => text.replace(first, &format!("{first}file = \"south/des.json\"\n")),
            _ => text,
        };
        folder.write("descan.toml", &text);
        let (_, out, error) = folder.run(&["scan", "--json", "--time", "6"]);
        let report = json_of(&out);
        let found = report["files"].as_array().map_or(1, Vec::len);
        assert_eq!(found, 1, "{spelling}: {error}{}", report["files"]);
    }
}

#[test]
fn test_report_has_a_suite_for_each_file() {
    let folder = with_own_file();
    let (code, out, error) = folder.run(&["check", "--report", "junit", "--time", "20"]);
    assert_eq!(code, 1, "{error}");
    for name in ["des.json", "south/des.json"] {
        assert!(out.contains(&format!("<testsuite name=\"{name}\"")), "{out}");
    }
    assert!(
        out.contains("sim:spare.toml: SENS is at address 12; the file pins it to 14."),
        "{out}"
    );
}

#[test]
fn empty_path_is_a_mistake_with_its_line() {
    for (text, line) in [
        ("file = ''\n", "1:8"),
        ("profile = ''\n", "1:11"),
        ("catalogue = ['']\n", "1:14"),
        ("[[bus]]\nbus = 'can0'\nfile = ''\n", "3:8"),
    ] {
        let error = Project::parse(text, Path::new("/p")).unwrap_err().with_line();
        assert!(error.contains("the path is empty"), "{error}");
        assert!(error.contains(line) || error.contains("line"), "{line}: {error}");
    }
}

#[test]
fn screen_edits_the_file_of_each_bus() {
    let folder = with_own_file();
    let mut pty = Pty::start(&["--theme", "dark"], folder.0.path(), (100, 30));
    pty.wait_for("3 present");
    pty.wait_for("✗ 14");
    // The row of the spare sensor is the last one.
    pty.send("Ge");
    pty.wait_for("static address");
    pty.send("\x1512\r");
    pty.wait_for("✓ 12");
    let saved = || std::fs::read_to_string(folder.path("south/des.json")).unwrap();
    pty.wait_until("saved", |_| saved().contains("\"address\": 12"));
    folder.write("south/des.json", &saved().replace("SENS", "PUMP"));
    pty.wait_for("PUMP");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    let north = std::fs::read_to_string(folder.path("des.json")).unwrap();
    assert_eq!(north.matches("SENS").count(), 2, "the other file is as it was");
}

#[test]
fn bus_spelled_otherwise_is_the_same_bus() {
    let folder = Folder::empty();
    folder.write("a.toml", "");
    std::os::unix::fs::symlink(folder.path("a.toml"), folder.path("link.toml")).unwrap();
    let here = |name: &str| format!("sim:{}", folder.path(name).display());
    let (plain, link, above) = (here("a.toml"), here("link.toml"), here("in/../a.toml"));
    for (one, other, is_same) in [
        ("can0", "can0", true),
        ("can0", "can1", false),
        ("slcan:/dev/ttyX", "slcan:/dev/ttyX@500000", true),
        ("slcan:/dev/ttyX@125000", "slcan:/dev/./ttyX@500000/2000000", true),
        ("slcan:/dev/ttyX", "slcan:/dev/ttyY", false),
        ("udp:239.74.163.2", "udp:239.74.163.2@43113", true),
        ("udp:239.74.163.2", "udp:239.74.163.2@43114", false),
        ("udp:", "udp:ff15:7079:7468:6f6e:6465:6d6f:6d63:6173", true),
        ("udp:ff15::1%lo", "udp:ff15::1%eth0", false),
        ("socketcand://Board/can0", "socketcand://board:29536/can0", true),
        ("socketcand://[::1]/can0", "socketcand://[0:0::1]:29536/can0", true),
        ("socketcand://board/can0", "socketcand://board/can1", false),
        ("file:missing.log", "file:./in/../missing.log", true),
        ("missing.log", "file:missing.log", true),
        ("file:missing.log", "file:other.log", false),
        ("sim:boiler", "sim:boiler", true),
        ("sim:boiler", "sim:./boiler", false),
        (&plain, &link, true),
        (&plain, &above, true),
        ("-", "-", true),
    ] {
        let [left, right] = [one, other].map(|text| text.parse::<BusSpec>().unwrap());
        assert_eq!(left.is_same_bus(&right), is_same, "{one} and {other}");
    }
}

#[test]
fn own_file_of_a_bus_is_used_however_the_bus_is_written() {
    let text = "file = 'all.json'\n[[bus]]\nbus = 'slcan:/dev/ttyX'\nfile = 'own.json'\n\
                bitrate = 125000\n[[bus]]\nbus = 'udp:239.74.163.2'\nfile = 'own.json'\n";
    let project = Project::parse(text, Path::new("/p")).unwrap();
    for bus in ["slcan:/dev/ttyX", "slcan:/dev/ttyX@500000", "udp:239.74.163.2@43113"] {
        let file = project.file_of(&bus.parse().unwrap());
        assert_eq!(file, Path::new("/p/own.json"), "{bus}");
    }
    let file = project.file_of(&"slcan:/dev/ttyY@500000".parse().unwrap());
    assert_eq!(file, Path::new("/p/all.json"));
    let named = |bus: &str| project.name_of(&bus.parse().unwrap());
    assert_eq!(named("slcan:/dev/./ttyX@500000"), "slcan:/dev/ttyX@500000");
    assert_eq!(named("udp:239.74.163.2@43113"), "udp:239.74.163.2");
    // The file may be saved with another spelling while the bus is open.
    let open = [("slcan:/dev/ttyX@500000".parse().unwrap(), "slcan:/dev/../dev/ttyX".to_owned())];
    assert_eq!(project.facts(&open).bitrates["slcan:/dev/../dev/ttyX"], 125_000);
}

#[test]
fn bus_of_a_project_by_another_path_has_its_file_and_facts() {
    let folder = Folder::example();
    std::fs::create_dir(folder.path("in")).unwrap();
    folder.write("one.json", "{ \"devices\": [{ \"name\": \"SENS\" }] }");
    let text = std::fs::read_to_string(folder.path("descan.toml")).unwrap();
    let own = "bus = \"sim:spare.toml\"\nfile = \"one.json\"\nbitrate = 250000";
    let text = text.replace("bus = \"sim:spare.toml\"\nbitrate = 125000", own);
    folder.write("descan.toml", &text);
    for (inner, bus) in [("", "sim:./spare.toml"), ("in", "sim:../spare.toml")] {
        let (_, out, error) = folder.run_in(inner, &["check", bus, "--json", "--time", "30"]);
        let report = json_of(&out);
        let file = report["file"]["path"].as_str().unwrap();
        assert!(file.ends_with("one.json"), "{bus}: {file} {error}");
        assert_eq!(report["buses"][0]["name"], "sim:spare.toml", "{bus}");
        let kinds = report["findings"].as_array().unwrap().iter().map(|it| it["kind"].clone());
        assert!(kinds.into_iter().any(|kind| kind == "bit-rate-differs"), "{bus}: {out}");
    }
}

#[test]
fn mistake_is_named_with_its_line_and_nothing_is_opened() {
    let cases = [
        ("prifile = 'x'", "line 1, column 1: unknown field `prifile`"),
        (
            "[[bus]]\nbus = 'slcan:/dev/ttyACM0@500000'",
            "line 2, column 7: a project sets no bit rate",
        ),
        ("[[bus]]\nbus = '-'", "line 2, column 7: a project has no standard input"),
        ("[[bus]]\nbus = 'pcan:1'", "line 2, column 7: pcan: unknown bus type"),
        ("[[bus]]\nbus = 'can0'\n[[bus]]\nbus = 'can0'", "line 4, column 7: stands twice"),
        ("[[bus]]\nbus = 'can0'\nbitrate = 125", "line 3, column 11: bitrate is 10000"),
        (
            "[[redundant]]\ntask = 't'\ndevices = []",
            "line 2, column 8: a redundant task has at least",
        ),
        (
            "[[bus]]\nbus = 'can0'\n[[redundant]]\ntask = 't'\ndevices = [{ bus = 'can0', name = 'A' },\n\
             { bus = 'can1', name = 'A' }]",
            "line 6, column 1: can1 is no bus of this project",
        ),
        (
            "[[bus]]\nbus = 'can0'\n[[redundant]]\ntask = 't'\ndevices = [{ bus = 'can0' },\n\
             { bus = 'can0', name = 'A' }]",
            "line 5, column 12: a device has a name",
        ),
        (
            "[[bus]]\nbus = 'can0'\n[[redundant]]\ntask = 't'\ndevices = [{ bus = 'can0', address = 200 },\n\
             { bus = 'can0', name = 'A' }]",
            "line 5, column 12: address 200 is not",
        ),
        (
            "[[bus]]\nbus = 'file:a.log'\n[[redundant]]\ntask = 't'\ndevices = [{ bus = 'file:a.log', name = 'A' },\n\
             { bus = 'file:a.log', name = 'B' }]",
            "line 5, column 12: file:a.log is a log",
        ),
        (
            "[[bus]]\nbus = 'sim:a.toml'\n[[bus]]\nbus = 'sim:./a.toml'",
            "line 4, column 7: stands twice",
        ),
        (
            "[[bus]]\nbus = 'udp:239.74.163.2'\n[[bus]]\nbus = 'udp:239.74.163.2@43113'",
            "line 4, column 7: stands twice",
        ),
        ("[[redundant]]\ntask = \"\\u001b\"\ndevices = []", "line 2, column 8: task has 1 to 60"),
    ];
    for (text, expected) in cases {
        let error = Project::parse(text, Path::new("")).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{text}: {error}");
    }
    let folder = Folder::example();
    folder.write("descan.toml", "file = 'des.json'\nbus = 7\n");
    let (code, out, error) = folder.run(&["scan", "sim:main.toml"]);
    assert_eq!((code, &*out), (3, ""));
    assert!(
        error.contains("descan.toml: line 2, column 7") && error.contains("bus = 7"),
        "{error}"
    );
}

#[test]
fn bus_on_another_machine_is_opened_after_asking_once() {
    let folder = Folder::empty();
    // No one is there: it is asked for before it is opened.
    folder.write("descan.toml", "[[bus]]\nbus = 'socketcand://127.0.0.1:1/can0'\n");
    let (code, _, error) = folder.run(&["scan", "--time", "1"]);
    assert_eq!(code, 2);
    assert!(
        error.contains("on another machine") && error.contains("descan socketcand:"),
        "{error}"
    );
    let script = format!(
        "XDG_STATE_HOME={0}/state XDG_CONFIG_HOME={0}/config {1} scan --time 1; echo code $?",
        folder.0.path().display(),
        env!("CARGO_BIN_EXE_descan")
    );
    let ask = |answer: Option<&str>, until: &str| {
        let mut pty = Pty::run("sh", &["-c", &script], folder.0.path(), (120, 30));
        if let Some(answer) = answer {
            pty.wait_for("from now on? [y/N]");
            pty.send(answer);
        }
        pty.wait_for(until);
        assert_eq!(pty.screen().contains("from now on?"), answer.is_some());
        pty.wait();
    };
    ask(Some("n\r"), "code 2");
    ask(Some("y\r"), "code 3");
    ask(None, "code 3");
    // Of another project it is asked again.
    folder.write("descan.toml", "[[bus]]\nbus = 'socketcand://127.0.0.1:2/can0'\n");
    ask(Some("n\r"), "is not opened");
}

#[test]
fn init_writes_a_project_that_is_accepted() {
    let folder = Folder::empty();
    let (code, out, error) = folder.run(&["init", "sim:boiler", "--time", "20"]);
    assert_eq!(code, 0, "{error}");
    assert!(
        error.contains("wrote descan.toml") && error.contains("scan --write des.json"),
        "{error}"
    );
    let text = std::fs::read_to_string(folder.path("descan.toml")).unwrap();
    assert_eq!(text, out);
    assert!(
        text.contains("bus = \"sim:boiler\"\nbitrate = 125000\n# 3 devices: FEED 10"),
        "{text}"
    );
    let (code, out, _) = folder.run(&["scan", "--json", "--time", "20"]);
    assert_eq!((code, &json_of(&out)["buses"][0]["name"]), (0, &json!("sim:boiler")));
    let (code, _, error) = folder.run(&["init", "sim:boiler"]);
    assert_eq!(code, 3);
    assert!(error.contains("already exists; edit it, or move it away first"), "{error}");
}
