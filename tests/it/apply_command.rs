//! `descan apply` against simulated devices: the table, the question, the steps, the file of the plan,
//! exit codes.

use descan::address_plan::PlanRecord;
use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};

const PROFILE: &str = "[descriptor]\naddr = 0x016\n[writes]\naddress = 0x016\n";

/// Five devices, `last` with these faults.
fn bus(faults: &str) -> String {
    let mut text = "bitrate = 125000\n[profile.writes]\naddress = 0x016\n".to_owned();
    for (name, uid, address) in [
        ("FEED", "uid = \"BOILER01\"", 10),
        ("SENS", "uid = \"BOILER02\"", 12),
        ("SENS", "uid = \"BOILER05\"", 13),
        ("NEW", "uid = \"\"", 14),
        ("LAST", "uid = \"BOILER09\"", 15),
    ] {
        let faults = if name == "LAST" { faults } else { "" };
        let _ = write!(
            text,
            "[[device]]\nname = \"{name}\"\nlabel = \"{name}{address}\"\n{uid}\n\
             address = {{ fixed = {address} }}\nsettled = true\nfaults = [{faults}]\n"
        );
    }
    text
}

const FILE: &str = r#"{"devices":[
 {"name":"SENS","address":13,"static":true,"uid":"BOILER02"},
 {"name":"SENS","address":12,"static":true,"uid":"BOILER05"},
 {"name":"FEED","address":10,"static":true},
 {"name":"LAST","address":22,"static":true}
]}
"#;

fn folder(faults: &str, file: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bus.toml"), bus(faults)).unwrap();
    std::fs::write(folder.path().join("profile.toml"), PROFILE).unwrap();
    std::fs::write(folder.path().join("des.json"), file).unwrap();
    folder
}

fn apply(folder: &Path, rest: &[&str]) -> (String, String, Option<i32>) {
    let output: Output = Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(["apply", "sim:bus.toml"])
        .args(rest)
        .current_dir(folder)
        .env("XDG_CONFIG_HOME", folder.join("config"))
        .env("XDG_STATE_HOME", folder.join("state"))
        .stdin(Stdio::null())
        .output()
        .expect("the program starts");
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    (text(&output.stdout), text(&output.stderr), output.status.code())
}

/// The files of plans.
fn plans(folder: &Path) -> Vec<PlanRecord> {
    let files = std::fs::read_dir(folder.join("state/descan/plans")).into_iter().flatten();
    let mut paths: Vec<_> = files.map(|file| file.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|it| it == "json"));
    paths.sort();
    paths.iter().map(|path| PlanRecord::parse(&std::fs::read(path).unwrap()).unwrap()).collect()
}

const TABLE: &str = "\
ORDER  DEVICE  UID       FROM  TO   WHY                                STATE
1      LAST    BOILER09  15    22   22 is free                         pending
2      SENS    BOILER02  12    127  through free 127: swaps with SENS  pending
3      SENS    BOILER05  13    12   after step 2                       pending
4      SENS    BOILER02  127   13   after step 3                       pending
–      FEED    BOILER01  10    10   already there                      –
";

#[test]
fn plan_is_shown_asked_for_and_applied() {
    let folder = folder("", FILE);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let (told, _, code) = apply(folder.path(), &["--profile", "profile.toml", "--dry-run"]);
            assert_eq!((told.as_str(), code), (TABLE, Some(0)));
        });
        scope.spawn(|| {
            let (told, said, code) = apply(folder.path(), &["--profile", "profile.toml", "--yes"]);
            let steps = told.strip_prefix(TABLE).unwrap_or_else(|| panic!("{told}"));
            assert_eq!(
                steps,
                "1 of 4  LAST 15 → 22 (00003C16#16): confirmed\n\
                 2 of 4  SENS 12 → 127 (00003016#7F): confirmed\n\
                 3 of 4  SENS 13 → 12 (00003416#0C): confirmed\n\
                 4 of 4  SENS 127 → 13 (0001FC16#0D): confirmed\n"
            );
            let asked = "Change 3 addresses on sim:bus.toml? Sends 4 requests (service 0x016); each device leaves \
                         the bus for some seconds, at most 5 each.";
            assert!(said.starts_with(asked), "{said}");
            assert!(said.contains("all steps are confirmed"), "{said}");
            assert_eq!(code, Some(0));
        });
    });
    let plans = plans(folder.path());
    assert_eq!((plans.len(), plans[0].state.as_str()), (1, "done"));
    // A new simulation has the former addresses: the way back is nothing to do.
    let (_, said, code) = apply(folder.path(), &["--profile", "profile.toml", "--yes", "--undo"]);
    assert!(said.contains("nothing to do"), "{said}");
    assert_eq!(code, Some(0));
}

#[test]
fn refused_write_stops_and_is_told_in_json_and_in_the_file() {
    let folder = folder("\"locked\"", FILE);
    let given = ["--profile", "profile.toml", "--yes", "--json"];
    let (told, said, code) = apply(folder.path(), &given);
    let told: Value = serde_json::from_str(&told).unwrap();
    assert_eq!(told["state"], "stopped");
    assert_eq!(told["stopped"], "step 1, LAST: refused with an error response");
    assert_eq!(
        told["steps"][0],
        serde_json::json!({
            "order": 1, "name": "LAST", "uid": "BOILER09", "from": 15, "to": 22,
            "setting": "fixed 22", "why": "22 is free", "state": "failed",
            "cause": "refused with an error response", "frame": "00003C16#16"
        })
    );
    assert_eq!(told["steps"][1]["state"], "pending");
    assert_eq!(told["left_out"][0]["reason"], "already-there");
    assert!(said.contains("1 of 4  LAST 15 → 22 (00003C16#16): failed: refused"), "{said}");
    assert_eq!(code, Some(1));
    let plan = plans(folder.path()).remove(0);
    let states: Vec<&str> = plan.steps.iter().map(|step| step.state.as_str()).collect();
    assert_eq!(states, ["failed", "pending", "pending", "pending"]);
    assert_eq!(told["plan"].as_str().map(|name| name.ends_with("-sim-bus-toml.json")), Some(true));
    // It goes on with the same aims, and fails in the same way.
    let (told, _, code) = apply(folder.path(), &["--profile", "profile.toml", "--yes", "--resume"]);
    assert!(told.contains("LAST    BOILER09  15    22"), "{told}");
    assert_eq!(code, Some(1));
    assert_eq!(plans(folder.path()).len(), 1, "the same file");
}

#[test]
fn mistakes_of_the_file_are_named_and_are_no_success() {
    let address = |wrong: &str| {
        let entry = format!(r#"[{{"name":"LAST","address":{wrong},"static":true}}]"#);
        (wrong.to_owned(), entry)
    };
    let uid = r#"[{"name":"LAST","address":22,"static":true,"uid":"boiler09"}]"#;
    for nothing in ["", "[]", r#"[{"name":"LAST","address":22,"static":null}]"#] {
        let folder = folder("", nothing);
        let given = ["--profile", "profile.toml", "--dry-run", "--time", "4"];
        let (_, said, code) = apply(folder.path(), &given);
        let why = "nothing to do: des.json pins no address on sim:bus.toml";
        assert!(said.contains(why), "{nothing}: {said}");
        assert_eq!(code, Some(1), "{nothing}");
    }
    let files = ["200", "0", "\"22\""]
        .map(address)
        .into_iter()
        .chain([uid, r#"{"foo":1}"#].map(|file| (file.to_owned(), file.to_owned())));
    for (wrong, file) in files {
        let folder = folder("", &file);
        let given = ["--profile", "profile.toml", "--yes", "--time", "4"];
        let (told, said, code) = apply(folder.path(), &given);
        assert!(said.contains("des.json, line 1, column"), "{wrong}: {said}");
        assert_eq!(code, Some(1), "{wrong}: {told}{said}");
    }
}

#[test]
fn entries_without_a_device_of_their_own_say_why() {
    let file = r#"[{"name":"SENS","address":20,"static":true},
        {"name":"FEED","address":21,"static":true},{"name":"FEED","address":22,"static":true},
        {"name":"LAST","address":23,"static":true,"uid":"BOILER77"},
        {"name":"GONE","address":24,"static":true}]"#;
    let folder = folder("", file);
    let given = ["--profile", "profile.toml", "--dry-run", "--json"];
    let (told, _, _) = apply(folder.path(), &given);
    let told: Value = serde_json::from_str(&told).unwrap();
    let left_out = told["left_out"].as_array().unwrap().iter();
    let left_out: Vec<_> = left_out.map(|it| (it["to"].as_u64(), it["reason"].as_str())).collect();
    let expected = [
        (Some(21), Some("ambiguous-name")),
        (Some(23), Some("another-device")),
        (Some(20), Some("ambiguous-name")),
        (Some(22), Some("ambiguous-name")),
        (Some(24), Some("not-present")),
    ];
    assert_eq!(left_out, expected, "{told}");
    let (_, said, code) = apply(folder.path(), &["--from-bus", "--yes"]);
    assert!(said.contains("left out: SENS: several have its name: give its UID"), "{said}");
    assert!(said.contains("left out: FEED: several have its name"), "{said}");
    assert_eq!(code, Some(1));
}

#[test]
fn addresses_of_the_bus_go_into_the_file() {
    let folder = folder("", FILE);
    let (told, _, code) = apply(folder.path(), &["--from-bus", "--yes"]);
    assert_eq!(
        told,
        "address of the entry SENS: 13 → 12\naddress of the entry SENS: 12 → 13\n\
         address of the entry LAST: 22 → 15\n"
    );
    assert_eq!(code, Some(0));
    let file = std::fs::read_to_string(folder.path().join("des.json")).unwrap();
    let expected = FILE
        .replace("13,\"static\":true,\"uid\":\"BOILER02", "12,\"static\":true,\"uid\":\"BOILER02")
        .replace("12,\"static\":true,\"uid\":\"BOILER05", "13,\"static\":true,\"uid\":\"BOILER05")
        .replace("22", "15");
    assert_eq!(file, expected);
    assert!(plans(folder.path()).is_empty());
}

#[test]
fn last_plan_that_cannot_be_read_is_named() {
    let folder = folder("", FILE);
    let plans = folder.path().join("state/descan/plans");
    std::fs::create_dir_all(&plans).unwrap();
    std::fs::write(plans.join("20261126-120000-sim-bus-toml.json"), "{}").unwrap();
    // Those of other buses are not read.
    std::fs::write(plans.join("20261126-120001-can0.json"), "{}").unwrap();
    let given = ["--profile", "profile.toml", "--dry-run"];
    let (_, said, code) = apply(folder.path(), &given);
    assert!(said.contains("20261126-120000-sim-bus-toml.json: not a plan of descan"), "{said}");
    assert!(said.contains("; remove the file, or give --forget-absent"), "{said}");
    assert_eq!(code, Some(3));
    let (told, _, code) = apply(folder.path(), &[&given[..], &["--forget-absent"]].concat());
    assert_eq!((told.as_str(), code), (TABLE, Some(0)));
}

#[test]
fn plan_of_another_bus_is_refused() {
    let folder = folder("", FILE);
    let given = ["--profile", "profile.toml", "--yes"];
    apply(folder.path(), &given);
    let plans = folder.path().join("state/descan/plans");
    let mut files = std::fs::read_dir(plans).unwrap().map(|file| file.unwrap().path());
    let plan = files.find(|path| path.extension().is_some_and(|it| it == "json")).unwrap();
    let text = std::fs::read_to_string(&plan).unwrap();
    std::fs::write(folder.path().join("o.json"), text.replace("sim:bus.toml", "can7")).unwrap();
    for way in ["--resume=o.json", "--undo=o.json"] {
        let (_, said, code) = apply(folder.path(), &[&given[..], &[way]].concat());
        assert!(said.contains("o.json is a plan of can7, not of sim:bus.toml"), "{said}");
        assert_eq!(code, Some(2));
    }
    // Its own one, however the bus is written.
    std::fs::write(&plan, text.replace("sim:bus.toml", "sim:./bus.toml")).unwrap();
    let (_, said, _) = apply(folder.path(), &[&given[..], &["--undo"]].concat());
    assert!(said.contains("nothing to do"), "{said}");
}

#[test]
fn plan_without_consent_key_file_or_bus_writes_nothing() {
    let folder = folder("", "{\"devices\":[{\"name\":\"PUMP\",\"address\":44,\"static\":true}]}");
    let given = ["--profile", "profile.toml"];
    let log = folder.path().join("session.log");
    std::fs::write(log, "(1436509052.249713) can0 02015402#0444455301\n").unwrap();
    let cases: [(&[&str], i32, &str); 7] = [
        (&[], 2, "no terminal: give --yes or --dry-run"),
        (&["--listen-only", "--yes"], 3, "listen-only: no requests are sent"),
        (&["--restart", "--yes"], 3, "--restart needs a profile with commands.reboot"),
        (&["--undo", "--yes"], 3, "no plan of sim:bus.toml in "),
        (&["--resume=nope", "--yes"], 3, "nope: plan not found"),
        (&["other.json", "--yes"], 3, "other.json: file not found"),
        (&["--yes", "--time", "4"], 1, "no step can be done: see what is left out"),
    ];
    std::thread::scope(|scope| {
        for (rest, code, why) in cases {
            let folder = folder.path();
            scope.spawn(move || {
                let (told, said, got) = apply(folder, &[&given[..], rest].concat());
                assert!(said.contains(why), "{rest:?}: {said}");
                assert_eq!(got, Some(code), "{rest:?}: {told}{said}");
            });
        }
        scope.spawn(|| {
            let (_, said, code) = apply(folder.path(), &["--yes"]);
            let why = "apply needs a profile with writes.address: no number is known for sure";
            assert!(said.contains(why), "{said}");
            assert_eq!(code, Some(3));
        });
        scope.spawn(|| {
            let output = Command::new(env!("CARGO_BIN_EXE_descan"))
                .args(["apply", "file:session.log", "--yes", "--profile", "profile.toml"])
                .current_dir(folder.path())
                .output()
                .unwrap();
            assert_eq!(output.status.code(), Some(2));
        });
    });
    assert!(plans(folder.path()).is_empty());
}

/// `lo` with multicast, in a network namespace of its own: nothing is sent elsewhere.
const NETWORK: &str = "ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo";

/// Devices in one process, three plans in others: what each said.
const UDP_SCRIPT: &str = r#"
"$0" sim udp:239.74.163.2 --scenario bus.toml --time 100 > /dev/null &
for more in --yes "--yes --undo" --dry-run; do
    "$0" apply udp:239.74.163.2 --profile profile.toml $more; echo "exit code $?"
done
kill $!
"#;

#[test]
fn plan_of_devices_in_another_process_is_taken_back() {
    let user = if nix::unistd::geteuid().is_root() { "-n" } else { "-rn" };
    let attempt = Command::new("unshare").args([user, "sh", "-c", NETWORK]).output();
    if !attempt.is_ok_and(|output| output.status.success()) {
        let must_run = std::env::var("CI").is_ok_and(|ci| ci == "true");
        assert!(!must_run, "no network namespace");
        return;
    }
    let order = FILE.replace("FEED\",\"address\":10", "FEED\",\"address\":11");
    let folder = folder("\"locked\"", &order);
    let output = Command::new("unshare")
        .args([user, "sh", "-c", &format!("{NETWORK} && {{ {UDP_SCRIPT} }}")])
        .arg(env!("CARGO_BIN_EXE_descan"))
        .current_dir(folder.path())
        .env("XDG_CONFIG_HOME", folder.path().join("config"))
        .env("XDG_STATE_HOME", folder.path().join("state"))
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let told = String::from_utf8(output.stdout).unwrap();
    let lines: Vec<&str> = told.lines().filter(|line| !line.starts_with("ORDER")).collect();
    let expected = [
        "1      FEED    BOILER01  10    11   11 is free                         pending",
        "2      LAST    BOILER09  15    22   22 is free                         pending",
        "3      SENS    BOILER02  12    127  through free 127: swaps with SENS  pending",
        "4      SENS    BOILER05  13    12   after step 3                       pending",
        "5      SENS    BOILER02  127   13   after step 4                       pending",
        "1 of 5  FEED 10 → 11 (00002816#0B): confirmed",
        "2 of 5  LAST 15 → 22 (00003C16#16): failed: refused with an error response",
        "exit code 1",
        "1      FEED    BOILER01  11    10  10 is free     pending",
        "–      SENS    BOILER02  12    12  already there  –",
        "–      SENS    BOILER05  13    13  already there  –",
        "–      LAST    BOILER09  15    15  already there  –",
        "1 of 1  FEED 11 → 10 (00002C16#0A): confirmed",
        "exit code 0",
    ];
    assert_eq!(&lines[..expected.len().min(lines.len())], expected, "{told}");
    assert!(lines[expected.len()].contains("FEED    BOILER01  10    11"), "as before: {told}");
    let plans = plans(folder.path());
    assert_eq!(plans.len(), 2);
    assert!(plans[1].source.starts_with("undo of "), "{}", plans[1].source);
}
