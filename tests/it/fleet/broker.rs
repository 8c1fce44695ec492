//! `publish`, `fleet` and `check --fleet` at a real broker (mosquitto): rights, TLS, restarts, cut
//! connections, hostile messages.

use crate::common::mosquitto::{GuardedBroker, Mosquitto, make_certificates, openssl};
use crate::common::program::{command, text};
use crate::common::pty::Pty;
use crate::common::sites::{self, Sites};
use descan::fleet::{Fleet, FleetDocument, FleetTopic, Publication, TopicPath};
use descan::shell::broker::{
    BrokerAccess, BrokerPublisher, BrokerReader, BrokerSettings, PublisherNotice, ReaderNotice,
};
use descan::time::{Duration, Instant};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::fs;
use std::io::{BufRead, BufReader, Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_mins(1);

/// A program that is ended with the value.
struct Running(Child);

impl Running {
    /// Starts `descan publish` and waits until it is connected.
    fn publish(arguments: &[&str], folder: &Path) -> Self {
        let mut command = command(&["publish"], folder);
        let mut child = command.args(arguments).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let mut seen = Vec::new();
        while let Some(Ok(line)) = lines.next() {
            if line.starts_with("publishing to") {
                // It must not block on a full pipe.
                thread::spawn(move || lines.for_each(drop));
                return Self(child);
            }
            seen.push(line);
        }
        panic!("not connected: {seen:?}, {:?}", child.wait());
    }

    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.0.id().try_into().unwrap()), signal).unwrap();
    }

    /// Ends it with SIGTERM.
    fn stop(mut self) -> Option<i32> {
        self.signal(Signal::SIGTERM);
        self.0.wait().unwrap().code()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn run(arguments: &[&str], folder: &Path) -> Output {
    command(arguments, folder).output().unwrap()
}

/// The JSON of `descan fleet`.
fn fleet_json(arguments: &[&str], folder: &Path) -> Value {
    let output = run(&[&["fleet", "--json"], arguments].concat(), folder);
    assert!(matches!(output.status.code(), Some(0 | 1)), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Repeats a query until it has a result.
#[track_caller]
fn wait_for<T>(mut query: impl FnMut() -> Option<T>) -> T {
    let begin = std::time::Instant::now();
    loop {
        if let Some(result) = query() {
            return result;
        }
        assert!(begin.elapsed() < PATIENCE, "waited for {PATIENCE:?}");
        thread::park_timeout(Duration::from_millis(10));
    }
}

/// Waits until the first gateway has devices of these names.
#[track_caller]
fn wait_for_devices(url: &str, folder: &Path, devices: &[&str]) {
    wait_for(|| {
        let fleet = fleet_json(&["--broker", url], folder);
        let names = names_of(&fleet, 0);
        devices.iter().all(|device| names.contains(device)).then_some(())
    });
}

fn state_of(fleet: &Value, gateway: &str) -> Option<String> {
    let gateways = fleet["gateways"].as_array()?;
    let found = gateways.iter().find(|it| it["name"] == gateway)?;
    found["state"].as_str().map(str::to_owned)
}

fn names_of(fleet: &Value, gateway: usize) -> Vec<&str> {
    let devices = fleet["gateways"][gateway]["devices"].as_array();
    devices.into_iter().flatten().filter_map(|it| it["name"].as_str()).collect()
}

/// All retained messages, by topic.
fn retained(broker: &Mosquitto) -> Vec<(String, Value)> {
    let output = Command::new("mosquitto_sub")
        .args(["-h", "127.0.0.1", "-p", &broker.port().to_string(), "-t", "descan/v1/#"])
        .args(["--retained-only", "-W", "2", "-v"])
        .output()
        .unwrap();
    let lines = text(&output.stdout);
    let of_line = |line: &str| {
        let (topic, payload) = line.split_once(' ')?;
        Some((topic.to_owned(), serde_json::from_str(payload).ok()?))
    };
    lines.lines().filter_map(of_line).collect()
}

#[test]
fn published_devices_are_those_of_the_bus() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    let gateway = ["sim:boiler", "--broker", &url, "--gateway", "boiler-17"];
    let publisher = Running::publish(&gateway, folder);
    let fleet = wait_for(|| {
        let fleet = fleet_json(&["--broker", &url], folder);
        let is_there = names_of(&fleet, 0).contains(&"FEED");
        is_there.then_some(fleet)
    });
    assert_eq!(state_of(&fleet, "boiler-17").as_deref(), Some("online"));
    // The members are those of scan --json.
    let scan = run(&["scan", "sim:boiler", "--json", "--time", "5"], folder);
    let scan: Value = serde_json::from_slice(&scan.stdout).unwrap();
    let members = |value: &Value| -> BTreeSet<String> {
        value.as_object().unwrap().keys().filter(|key| *key != "time").cloned().collect()
    };
    let documents = retained(&broker);
    let of = |part: &str| {
        let topic = format!("descan/v1/boiler-17/{part}");
        let found = documents.iter().find(|(it, _)| *it == topic);
        found.unwrap_or_else(|| panic!("{topic} is not in {documents:?}")).1.clone()
    };
    assert_eq!(members(&of("device/sim:boiler/10")), members(&scan["devices"][0]));
    assert_eq!(members(&of("bus/sim:boiler")), members(&scan["buses"][0]));
    assert_eq!(of("status")["online"], true);

    assert_eq!(publisher.stop(), Some(0));
    let fleet = fleet_json(&["--broker", &url], folder);
    assert_eq!(state_of(&fleet, "boiler-17").as_deref(), Some("stopped"));
    assert!(names_of(&fleet, 0).contains(&"FEED"), "the last state is kept");
}

#[test]
fn killed_gateway_is_lost_and_its_next_run_clears_what_is_gone() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    let publisher = Running::publish(&["sim:boiler", "--broker", &url, "--gateway", "g"], folder);
    wait_for(|| (!names_of(&fleet_json(&["--broker", &url], folder), 0).is_empty()).then_some(()));
    publisher.signal(Signal::SIGKILL);
    wait_for(|| {
        let fleet = fleet_json(&["--broker", &url], folder);
        let is_lost = state_of(&fleet, "g").as_deref() == Some("lost");
        // When it was alive, by its last document.
        is_lost.then(|| assert!(fleet["gateways"][0]["time"].as_f64() > Some(1.7e9), "{fleet}"))
    });
    // The next run is on another bus.
    let _publisher = Running::publish(&["sim:drone", "--broker", &url, "--gateway", "g"], folder);
    let is_clean = || {
        let topics: Vec<String> = retained(&broker).into_iter().map(|(topic, _)| topic).collect();
        let has = |part: &str| topics.iter().any(|topic| topic.contains(part));
        (has("/bus/sim:drone") && !has("sim:boiler")).then_some(())
    };
    wait_for(is_clean);
}

#[test]
fn second_gateway_with_the_name_ends_the_first() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    let arguments = ["publish", "sim:boiler", "--broker", &url, "--gateway", "g"];
    let first = command(&arguments, folder).stderr(Stdio::piped()).spawn().unwrap();
    wait_for(|| {
        let fleet = fleet_json(&["--broker", &url], folder);
        (state_of(&fleet, "g").as_deref() == Some("online")).then_some(())
    });
    let _second = Running::publish(&arguments[1..], folder);
    let output = first.wait_with_output().unwrap();
    let errors = text(&output.stderr);
    // No failure that a restart helps with: the unit of systemd lets it rest.
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(errors.contains("another client connected with the same name"), "{errors}");
    assert!(errors.contains("--gateway"), "{errors}");
}

#[test]
fn old_status_that_is_not_renewed_is_of_a_silent_gateway() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    let status = |time: f64| format!(r#"{{"online":true,"time":{time}}}"#);
    let now = sites::unix_time();
    broker.publish("descan/v1/dead/status", status(now - 100.0).as_bytes());
    broker.publish("descan/v1/alive/status", status(now).as_bytes());
    for name in ["dead", "alive"] {
        fs::create_dir_all(folder.join("sites").join(name)).unwrap();
        fs::write(folder.join("sites").join(name).join("des.json"), "[]").unwrap();
    }
    let check = ["check", "--fleet", "sites", "--broker", &url];
    // Too short a time to tell.
    let short = fleet_json(&["--broker", &url, "--time", "2"], folder);
    assert_eq!(state_of(&short, "dead").as_deref(), Some("online"));
    assert_eq!(short["complete"], false);
    let output = run(&[&check[..], &["--time", "2"]].concat(), folder);
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));

    let fleet = command(&["fleet", "--json", "--broker", &url], folder);
    let [mut fleet, mut check] = [fleet, command(&check, folder)];
    let fleet = fleet.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let check = check.stdout(Stdio::piped()).spawn().unwrap().wait_with_output().unwrap();
    assert_eq!(check.status.code(), Some(1));
    let differences = text(&check.stdout);
    assert!(differences.contains("dead: 0 entries, 0 devices: gateway silent"), "{differences}");
    assert!(!differences.contains("alive: 0 entries, 0 devices: gateway"), "{differences}");
    let fleet = fleet.wait_with_output().unwrap();
    let fleet: Value = serde_json::from_slice(&fleet.stdout).unwrap();
    assert_eq!(state_of(&fleet, "dead").as_deref(), Some("silent"));
    assert_eq!(state_of(&fleet, "alive").as_deref(), Some("online"));
    assert_eq!(fleet["complete"], true);
}

/// An unlisted device may be in it.
#[test]
fn gateway_with_an_unusable_document_is_not_compared() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    let status = format!(r#"{{"online":true,"time":{}}}"#, sites::unix_time());
    for name in ["hides", "other"] {
        fs::create_dir_all(folder.join("sites").join(name)).unwrap();
        fs::write(folder.join("sites").join(name).join("des.json"), "[]").unwrap();
        broker.publish(&format!("descan/v1/{name}/status"), status.as_bytes());
    }
    let long = format!(r#"{{"bus":"can0","address":50,"name":"{}"}}"#, "X".repeat(70_000));
    let check = || {
        let output = run(&["check", "--fleet", "sites", "--broker", &url, "--json"], folder);
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        let errors: Vec<Value> = report["gateways"].as_array().unwrap().clone();
        let errors = errors.into_iter().map(|gateway| gateway["error"].clone());
        (output.status.code(), errors.collect::<Vec<_>>())
    };
    broker.publish("descan/v1/hides/device/can0/50", long.as_bytes());
    let (code, errors) = check();
    assert_eq!(code, Some(3), "{errors:?}");
    let cause = "not used: descan/v1/hides/device/can0/50: too long";
    assert_eq!(errors, [Value::from(cause), Value::Null]);
    broker.publish("descan/v1/hides/device/can0/50", b"");
    assert_eq!(check(), (Some(0), vec![Value::Null; 2]));
}

#[test]
fn status_that_is_renewed_is_of_a_gateway_whose_clock_is_late() {
    let Some(broker) = Mosquitto::start() else { return };
    let status = format!(r#"{{"online":true,"time":{}}}"#, sites::unix_time() - 100.0);
    broker.publish("descan/v1/late/status", status.as_bytes());
    let mut fleet = command(&["fleet", "--json", "--broker", &broker.url()], broker.folder());
    let mut fleet = fleet.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(fleet.stderr.as_mut().unwrap()).read_line(&mut line).unwrap();
    assert!(
        line.contains("late: last status is old, or its clock is wrong; waiting for another"),
        "{line}"
    );
    broker.publish("descan/v1/late/status", status.as_bytes());
    let output = fleet.wait_with_output().unwrap();
    let fleet: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(state_of(&fleet, "late").as_deref(), Some("online"));
    assert_eq!(fleet["complete"], true);
}

#[test]
fn broker_that_is_lost_while_a_status_is_waited_for_is_told() {
    let Some(mut broker) = Mosquitto::start() else { return };
    let status = format!(r#"{{"online":true,"time":{}}}"#, sites::unix_time() - 100.0);
    broker.publish("descan/v1/dead/status", status.as_bytes());
    let arguments = ["fleet", "--json", "--broker", &broker.url(), "--time", "8"];
    let mut fleet = command(&arguments, broker.folder());
    let mut fleet = fleet.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(fleet.stderr.as_mut().unwrap()).read_line(&mut line).unwrap();
    assert!(line.contains("dead: last status is old"), "{line}");
    broker.stop();
    let output = fleet.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stdout));
}

/// Starts a reading that waits for the old status of `g`, at a broker that is then restarted without its state.
fn reading_over_a_loss_of_state(broker: &mut Mosquitto, arguments: &[&str]) -> Child {
    let status = format!(r#"{{"online":true,"time":{}}}"#, sites::unix_time() - 100.0);
    broker.publish("descan/v1/g/status", status.as_bytes());
    let mut fleet = command(&["fleet", "--json", "--broker", &broker.url()], broker.folder());
    let mut fleet =
        fleet.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    wait_for_line(&mut fleet, "g: last status is old, or its clock is wrong; waiting for another");
    broker.stop();
    fs::remove_file(broker.folder().join("mosquitto.db")).unwrap();
    assert!(broker.launch());
    wait_for_line(&mut fleet, "g: the broker has no status any more; waiting for one");
    fleet
}

/// Reads the next line of standard error.
#[track_caller]
fn wait_for_line(process: &mut Child, expected: &str) {
    let mut line = String::new();
    let mut byte = [0];
    // Without a buffer: the next reader has the rest.
    while process.stderr.as_mut().unwrap().read(&mut byte).unwrap() == 1 && byte != *b"\n" {
        line.push(char::from(byte[0]));
    }
    assert!(line.contains(expected), "{line}");
}

#[test]
fn gateway_of_a_broker_that_lost_its_state_is_waited_for() {
    let Some(mut broker) = Mosquitto::start() else { return };
    // Not for one that was stopped.
    broker.publish("descan/v1/h/status", br#"{"online":false,"reason":"stopped"}"#);
    let fleet = reading_over_a_loss_of_state(&mut broker, &[]);
    broker.publish("descan/v1/g/status", br#"{"online":true}"#);
    let output = fleet.wait_with_output().unwrap();
    let fleet: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(state_of(&fleet, "g").as_deref(), Some("online"), "{}", text(&output.stderr));
    assert_eq!(fleet["complete"], true);
}

#[test]
fn reading_without_a_gateway_that_the_broker_lost_is_incomplete() {
    let Some(mut broker) = Mosquitto::start() else { return };
    let fleet = reading_over_a_loss_of_state(&mut broker, &["--time", "10"]);
    let output = fleet.wait_with_output().unwrap();
    let fleet: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(fleet["complete"], false);
    let errors = text(&output.stderr);
    assert!(errors.contains("g: not published again since the connection was lost"), "{errors}");
}

#[test]
fn check_waits_for_no_gateway_without_a_folder() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    let status = |time: f64| format!(r#"{{"online":true,"time":{time}}}"#);
    let now = sites::unix_time();
    broker.publish("descan/v1/other/status", status(now - 100.0).as_bytes());
    broker.publish("descan/v1/g/status", status(now).as_bytes());
    let finding = json!({
        "kind": "same-name-same-address", "confidence": "suspected", "bus": "can0", "text": "Perhaps two."
    });
    broker.publish("descan/v1/g/finding/can0/x", finding.to_string().as_bytes());
    fs::create_dir_all(folder.join("sites/g")).unwrap();
    fs::write(folder.join("sites/g/des.json"), "[]").unwrap();
    let output = run(&["check", "--fleet", "sites", "--broker", &url, "--time", "5"], folder);
    let errors = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    assert!(!errors.contains("is old"), "{errors}");
    assert!(errors.contains("suspected: g: can0: Perhaps two."), "{errors}");
    assert!(errors.contains("other: no folder in sites; not compared"), "{errors}");
}

#[test]
fn check_compares_each_gateway_with_its_folder() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    let _publisher = Running::publish(&["sim:boiler", "--broker", &url, "--gateway", "g"], folder);
    wait_for_devices(&url, folder, &["FEED", "SENS"]);
    let site = folder.join("sites/g");
    fs::create_dir_all(&site).unwrap();
    let check = |file: &str, arguments: &[&str]| {
        fs::write(site.join("des.json"), file).unwrap();
        let all = [&["check", "--fleet", "sites", "--broker", &url], arguments].concat();
        let output = run(&all, folder);
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    };
    let (code, out, _) = check(r#"[{"name":"GHOST","address":33}]"#, &[]);
    assert_eq!(code, Some(1), "{out}");
    assert!(out.contains("g missing:\n  GHOST (at 33) is listed but not on the bus.\n"), "{out}");
    assert!(out.contains("FEED at 10 is not in the file."), "{out}");
    let (_, json, _) = check(r#"[{"name":"FEED","address":10}]"#, &["--json"]);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["gateways"][0]["name"], "g");
    assert_eq!(json["gateways"][0]["state"], "online");
    assert_eq!(json["gateways"][0]["entries"], 1);
    let (_, junit, _) = check("[]", &["--report", "junit"]);
    assert!(junit.contains("<testsuite name=\"g\""), "{junit}");
    // A gateway that has published nothing.
    fs::create_dir_all(folder.join("sites/h")).unwrap();
    fs::write(folder.join("sites/h/des.json"), "[]").unwrap();
    let (code, out, _) = check("[]", &[]);
    assert_eq!(code, Some(1));
    assert!(out.contains("h: 0 entries, 0 devices: gateway missing\n"), "{out}");
    let (_, json, _) = check("[]", &["--json"]);
    let json: Value = serde_json::from_str(&json).unwrap();
    let missing = serde_json::json!([{"section": "gateway", "bus": null, "address": null, "text": "missing"}]);
    assert_eq!(json["gateways"][1]["differences"], missing);
    // A folder that no gateway can be named as.
    fs::create_dir_all(folder.join("sites/old sites")).unwrap();
    let (code, out, errors) = check("[]", &[]);
    assert_eq!(code, Some(3));
    assert!(out.contains("g: 0 entries, ") && out.contains("h: 0 entries, "), "{out}");
    assert!(errors.contains("old sites: not compared: sites/old sites: "), "{errors}");
    fs::remove_dir(folder.join("sites/old sites")).unwrap();
    fs::write(folder.join("sites/h/des.json"), "[{").unwrap();
    // A faulty file: the others are compared all the same.
    let (code, out, errors) = check("[]", &[]);
    assert_eq!(code, Some(3));
    assert!(
        out.contains("g: 0 entries, ") && out.contains("h: not compared: sites/h/des.json: "),
        "{out}"
    );
    assert!(errors.contains("h: not compared: sites/h/des.json: "), "{errors}");
    let (_, json, _) = check("[]", &["--json"]);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["gateways"][0]["error"], Value::Null);
    assert!(
        json["gateways"][1]["error"].as_str().unwrap().contains("sites/h/des.json: "),
        "{json}"
    );
    let (code, tap, _) = check("[]", &["--report", "tap"]);
    assert_eq!(code, Some(3));
    let failed = tap.lines().filter(|it| it.starts_with("not ok") && it.contains(" h: ")).count();
    assert!(failed >= 2 && tap.contains("# SKIP"), "{tap}");
}

#[test]
fn check_compares_each_bus_with_its_file_of_the_project() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    for (file, name) in [("first.toml", "PUMP"), ("second.toml", "VALVE")] {
        let device = format!("[[device]]\nname = \"{name}\"\naddress = {{ fixed = 12 }}\n");
        fs::write(folder.join(file), format!("bitrate = 125000\n{device}")).unwrap();
    }
    let buses = ["sim:first.toml", "sim:second.toml"];
    let publish = [&buses[..], &["--broker", &url, "--gateway", "g"]].concat();
    let _publisher = Running::publish(&publish, folder);
    wait_for_devices(&url, folder, &["PUMP", "VALVE"]);
    let site = folder.join("sites/g");
    fs::create_dir_all(&site).unwrap();
    let project = "[[bus]]\nbus = 'sim:first.toml'\nfile = 'first.json'\n\
                   [[bus]]\nbus = 'sim:second.toml'\nfile = 'second.json'\n";
    fs::write(site.join("descan.toml"), project).unwrap();
    let check = |first: &str, second: &str| {
        for (file, name) in [("first.json", first), ("second.json", second)] {
            let content = format!(r#"[{{"name":"{name}","address":12,"services":[]}}]"#);
            fs::write(site.join(file), content).unwrap();
        }
        let output = run(&["check", "--fleet", "sites", "--broker", &url], folder);
        (output.status.code(), text(&output.stdout) + &text(&output.stderr))
    };
    let (code, out) = check("PUMP", "VALVE");
    assert_eq!(code, Some(0), "{out}");
    let (code, out) = check("VALVE", "PUMP");
    assert_eq!(code, Some(1), "{out}");
    assert!(out.contains("sim:first.toml: PUMP at 12 is not in the file."), "{out}");
    assert!(out.contains("sim:second.toml: VALVE at 12 is not in the file."), "{out}");
    let project = project.replacen("[[bus]]", "[[bus]]\nbitrate = 250000", 1);
    fs::write(site.join("descan.toml"), project).unwrap();
    let (code, out) = check("PUMP", "VALVE");
    assert_eq!(code, Some(1), "{out}");
    let differs = "sim:first.toml has 125 kbit/s; the project says 250 kbit/s.";
    assert!(out.contains("g settings differ:\n") && out.contains(differs), "{out}");
    assert!(out.contains("1 settings differ\n"), "{out}");
}

#[test]
fn status_has_the_file_of_each_bus() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    let project = "[[bus]]\nbus = 'sim:boiler'\nfile = 'a.json'\n\
                   [[bus]]\nbus = 'sim:drone'\nfile = 'b.json'\n";
    fs::write(folder.join("descan.toml"), project).unwrap();
    fs::write(folder.join("a.json"), "[]").unwrap();
    fs::write(folder.join("b.json"), "[{").unwrap();
    let _publisher = Running::publish(&["--broker", &url, "--gateway", "g"], folder);
    let files = wait_for(|| {
        let status = retained(&broker).into_iter().find(|(it, _)| it == "descan/v1/g/status")?.1;
        let files = status["files"].as_array()?.clone();
        files.iter().all(|file| !file["ok"].is_null()).then_some(files)
    });
    let short = |file: &Value| (file["ok"].as_bool(), file["buses"][0].as_str().map(str::to_owned));
    let files: Vec<_> = files.iter().map(short).collect();
    let bus = |name: &str| Some(name.to_owned());
    assert_eq!(files, [(Some(true), bus("sim:boiler")), (Some(false), bus("sim:drone"))]);
}

#[test]
fn des_json_that_cannot_be_used_is_said_once_by_publish() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    fs::write(folder.join("des.json"), "[{").unwrap();
    let publish = ["publish", "sim:boiler", "--broker", &url, "--gateway", "g", "--time", "3"];
    let output = run(&publish, folder);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert_eq!(said.matches("descan: des.json: line 1").count(), 1, "{said}");
    // Also while a bus is waited for.
    let publish = ["publish", "vcan-none", "--broker", &url, "--gateway", "g", "--time", "1"];
    let output = run(&publish, folder);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.contains("waiting for vcan-none"), "{said}");
    assert_eq!(said.matches("descan: des.json: line 1").count(), 1, "{said}");
}

// --- rights and TLS -------------------------------------------------------------------------

#[test]
fn gateway_writes_its_own_topics_only_and_viewer_reads() {
    let Some(broker) = GuardedBroker::start(&["boiler-17".to_owned()]) else { return };
    let (folder, url) = (broker.folder(), broker.url());
    let access = ["--broker", &url, "--ca", "ca.pem"];
    let own = [&access[..], &["--credentials", "boiler-17.toml"]].concat();
    let viewer = [&access[..], &["--credentials", "viewer.toml"]].concat();
    let publish = [&["sim:boiler", "--gateway", "boiler-17"], &own[..]].concat();
    let _publisher = Running::publish(&publish, folder);
    let fleet = wait_for(|| {
        let fleet = fleet_json(&viewer, folder);
        (!names_of(&fleet, 0).is_empty()).then_some(fleet)
    });
    assert_eq!(state_of(&fleet, "boiler-17").as_deref(), Some("online"));

    // Another name than that of the user.
    let foreign =
        [&["publish", "sim:boiler", "--time", "6", "--gateway", "other"], &own[..]].concat();
    let output = run(&foreign, folder);
    let errors = text(&output.stderr);
    assert!(errors.contains("the broker refuses descan/v1/other/"), "{errors}");
    assert!(errors.contains("the broker does not have all documents and events"), "{errors}");
    assert_eq!(output.status.code(), Some(3), "{errors}");
    assert!(state_of(&fleet_json(&viewer, folder), "other").is_none());
    // The viewer cannot write, the gateway cannot read others.
    let output = run(
        &[&["publish", "sim:boiler", "--time", "6", "--gateway", "viewer"], &viewer[..]].concat(),
        folder,
    );
    assert!(text(&output.stderr).contains("refuses descan/v1/viewer/"));
}

#[test]
fn certificate_that_tls_does_not_take_is_named_with_its_cause() {
    let cases = [
        ("v1", "the broker's certificate is of X.509 version 1; have the CA sign"),
        ("ca", "the broker's certificate is that of a CA; have the CA sign"),
        ("old", "the broker's certificate is not valid by its dates; renew"),
    ];
    for (name, expected) in cases {
        let settings = |folder: &Path| {
            make_certificates(folder);
            fs::copy(folder.join("broker.key"), folder.join("v1.key")).unwrap();
            fs::copy(folder.join("broker.key"), folder.join("old.key")).unwrap();
            let signed = "x509 -req -in broker.req -CA ca.pem -CAkey ca.key -CAcreateserial";
            openssl(folder, &format!("{signed} -days 2 -out v1.pem"));
            openssl(folder, &format!("{signed} -days -1 -extfile names -out old.pem"));
            let path = |ending: &str| folder.join(format!("{name}.{ending}")).display().to_string();
            format!("allow_anonymous true\ncertfile {}\nkeyfile {}\n", path("pem"), path("key"))
        };
        let Some(broker) = Mosquitto::with_settings(settings) else { return };
        let url = broker.url().replace("mqtt://", "mqtts://").replace("127.0.0.1", "localhost");
        let fleet = ["fleet", "--json", "--broker", &url, "--ca", "ca.pem"];
        let output = run(&fleet, broker.folder());
        let errors = text(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{name}: {errors}");
        assert!(errors.contains(expected), "{name}: {errors}");
        let own = [&fleet[..], &["--cert", "v1.pem", "--key", "v1.key"]].concat();
        let errors = text(&run(&own, broker.folder()).stderr);
        assert!(errors.contains("v1.pem: a certificate of X.509 version 1"), "{errors}");
    }
}

#[test]
fn wrong_certificates_and_passwords_end_it_with_the_way_out() {
    let Some(broker) = GuardedBroker::start(&["boiler-17".to_owned()]) else { return };
    let (folder, url) = (broker.folder(), broker.url());
    fs::write(folder.join("wrong.toml"), "user = \"viewer\"\npassword = \"no\"\n").unwrap();
    fs::write(folder.join("broken.toml"), "password: topsecret\n").unwrap();
    fs::write(folder.join("empty.pem"), "").unwrap();
    let plain = broker.url().replace("mqtts:", "mqtt:");
    let cases: &[(&[&str], &str)] = &[
        (&["--ca", "ca.pem"], "user or password refused"),
        (&["--ca", "ca.pem", "--credentials", "wrong.toml"], "user or password refused"),
        (&["--ca", "ca.pem", "--credentials", "none.toml"], "none.toml: file not found"),
        (&["--ca", "ca.pem", "--credentials", "broken.toml"], "not a file of credentials"),
        (&["--ca", "other.pem", "--credentials", "viewer.toml"], "--ca FILE"),
        (
            &["--credentials", "viewer.toml"],
            "TLS: no trusted CA signed the broker's certificate; name the certificate",
        ),
        (&["--ca", "empty.pem"], "empty.pem: no certificate in it"),
        (
            &["--ca", "ca.pem", "--cert", "ca.key", "--key", "ca.key"],
            "ca.key: no certificate in it",
        ),
        (
            &["--ca", "ca.pem", "--cert", "client.pem", "--key", "ca.pem"],
            "ca.pem: no private key in it",
        ),
    ];
    for (arguments, expected) in cases {
        let all = [&["fleet", "--json", "--broker", &url], *arguments].concat();
        let output = run(&all, folder);
        let errors = text(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{arguments:?}: {errors}");
        assert!(errors.contains(expected), "{arguments:?}: {errors}");
        assert!(!errors.contains("topsecret"), "{errors}");
    }
    // Certificates without TLS; TLS at a port without.
    let cases: [&[&str]; 3] = [
        &["fleet"],
        &["publish", "sim:boiler", "--profile", "none.toml"],
        &["check", "--fleet", "none"],
    ];
    for command in cases {
        let all = [command, &["--broker", &plain, "--ca", "ca.pem"]].concat();
        let output = run(&all, folder);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        assert!(text(&output.stderr).contains("write mqtts://"));
    }
    let without_tls = Mosquitto::start().unwrap();
    let url = without_tls.url().replace("mqtt:", "mqtts:");
    let output = run(&["fleet", "--json", "--broker", &url, "--ca", "ca.pem"], folder);
    let errors = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{errors}");
}

#[test]
fn client_certificate_is_shown_where_the_broker_asks_for_it() {
    let broker = Mosquitto::with_settings(|folder| {
        make_certificates(folder);
        let path = |name: &str| folder.join(name).display().to_string();
        format!(
            "allow_anonymous true\nrequire_certificate true\ncafile {}\ncertfile {}\nkeyfile {}\n",
            path("ca.pem"),
            path("broker.pem"),
            path("broker.key"),
        )
    });
    let Some(broker) = broker else { return };
    let (folder, url) = (broker.folder(), format!("mqtts://127.0.0.1:{}", broker.port()));
    let access = ["fleet", "--json", "--broker", &url, "--ca", "ca.pem"];
    let output =
        run(&[&access[..], &["--cert", "client.pem", "--key", "client.key"]].concat(), folder);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let output = run(&[&access[..], &["--time", "4"]].concat(), folder);
    assert_eq!(output.status.code(), Some(3));
    assert!(text(&output.stderr).contains("--cert FILE"), "{}", text(&output.stderr));
}

#[test]
fn many_documents_that_are_not_used_are_counted_behind_ten() {
    let Some(broker) = Mosquitto::start() else { return };
    for address in 1..=12 {
        broker.publish(&format!("descan/v1/bad/device/can0/{address}"), b"{");
    }
    let output = run(&["fleet", "--json", "--broker", &broker.url()], broker.folder());
    let errors = text(&output.stderr);
    assert_eq!(errors.matches("not used: ").count(), 10, "{errors}");
    assert!(errors.contains("2 more documents not used"), "{errors}");
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["rejects"].as_array().unwrap().len(), 12);
}

#[test]
fn attempt_on_demand_begins_the_waits_again() {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mut reader = BrokerReader::spawn(&settings(port), &["descan/v1/#"]).unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    let next_wait = |reader: &mut BrokerReader| match runtime.block_on(reader.next()) {
        Some(ReaderNotice::Failed(_, Some(wait))) => wait,
        other => panic!("{other:?}"),
    };
    let (first, second) = (next_wait(&mut reader), next_wait(&mut reader));
    assert!(first < second, "{first:?} {second:?}");
    reader.reconnect();
    let third = next_wait(&mut reader);
    assert!(third < second, "{second:?} {third:?}");
}

#[test]
fn broker_that_is_not_there_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let url = format!("mqtt://127.0.0.1:{port}");
    let output = run(&["fleet", "--json", "--broker", &url, "--time", "1"], folder.path());
    let errors = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{errors}");
    assert!(errors.contains("connection refused; check host and port"), "{errors}");
    let publish = ["publish", "sim:boiler", "--broker", &url, "--gateway", "g", "--time", "1"];
    let output = run(&publish, folder.path());
    let errors = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{errors}");
    assert!(errors.contains("connection refused; check host and port"), "{errors}");
    // One that takes the connection, and is silent.
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("mqtt://{}", silent.local_addr().unwrap());
    let publish = ["publish", "sim:boiler", "--broker", &url, "--gateway", "g", "--time", "1"];
    let output = run(&publish, folder.path());
    let errors = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{errors}");
    assert!(errors.contains(&format!("{url}: no response")), "{errors}");
    for bad in
        ["localhost", "http://x", "mqtt://", "mqtt://a:b", "mqtt://user:secret@host", "mqtt://h:0"]
    {
        let output = run(&["fleet", "--broker", bad], folder.path());
        assert_eq!(output.status.code(), Some(2), "{bad}");
    }
}

/// Returns a port at which each connection gets this answer, and is closed.
fn answering(answer: &'static [u8]) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            let _ = stream.read(&mut [0; 4096]).and_then(|_| stream.write_all(answer));
        }
    });
    port
}

#[test]
fn what_is_no_broker_with_mqtt_5_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let answers: [(&[u8], &str); 4] = [
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "no MQTT 5 broker: "),
        (b"SSH-2.0-OpenSSH_9.2\r\n", "no MQTT 5 broker: "),
        // Of MQTT 3: unacceptable protocol version.
        (&[0x20, 2, 0, 1], "or have no MQTT 5"),
        (b"", "or have no MQTT 5"),
    ];
    for (answer, cause) in answers {
        let url = format!("mqtt://127.0.0.1:{}", answering(answer));
        let output = run(&["fleet", "--json", "--broker", &url, "--time", "2"], folder.path());
        let errors = text(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{errors}");
        assert!(errors.contains(cause), "{answer:?}: {errors}");
    }
}

/// The most memory that a process had, in KiB.
fn peak_memory(process: Pid) -> u64 {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let most = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    most.trim().trim_end_matches(" kB").parse().unwrap()
}

// --- hostile messages ------------------------------------------------------------------------

#[test]
fn hostile_messages_are_counted_and_large_ones_are_not_read() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    broker.publish("descan/v1/good/status", br#"{"online":true}"#);
    broker.publish("descan/v1/bad/status", b"\x1b]0;title\x07");
    broker.publish("descan/v1/bad/device/can0/1", "[".repeat(60_000).as_bytes());
    broker.publish("descan/v1/bad/device/can0/2", &vec![b'x'; 100 << 20]);
    broker.publish("descan/v1/bad/device/can0/999", b"{}");
    broker.publish("descan/v1/bad/bus/can0", br#"{"name":"\u001b[31mred"}"#);
    let output = run(&["fleet", "--json", "--broker", &url], folder);
    let errors = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(state_of(&json, "good").as_deref(), Some("online"));
    assert_eq!(json["rejected"], 3, "{json}");
    let rejects = json["rejects"].as_array().unwrap();
    let topics = ["bad/device/can0/1", "bad/device/can0/999", "bad/status"];
    for (rejected, topic) in rejects.iter().zip(topics) {
        assert_eq!(rejected["topic"], format!("descan/v1/{topic}"));
        assert!(errors.contains(&format!("not used: descan/v1/{topic}: ")), "{errors}");
    }
    assert_eq!(rejects.len(), 3);
    assert!(!errors.contains('\u{1b}') && !text(&output.stdout).contains('\u{1b}'));
}

#[test]
fn hostile_messages_are_counted_on_the_screen_in_bounded_memory() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    broker.publish("descan/v1/good/status", br#"{"online":true}"#);
    broker.publish("descan/v1/bad/device/can0/1", "[".repeat(120_000).as_bytes());
    broker.publish("descan/v1/bad/device/can0/2", &vec![b'x'; 100 << 20]);
    // The largest that is read, many times.
    let long = format!(r#"{{"name":"A","uid":"{}"}}"#, "\\u0000".repeat(20_000));
    for address in 3..=127 {
        broker.publish(&format!("descan/v1/long/device/can0/{address}"), long.as_bytes());
    }
    broker.publish("descan/v2/foreign/status", b"{}");
    let mut pty = Pty::start(&["fleet", "--broker", &url], folder, (100, 30));
    pty.wait_for("good");
    pty.wait_for("long");
    pty.wait_for("not used");
    // 10,000 more, while it is open.
    let lines = format!("{}\n", "{".repeat(1000)).repeat(10_000);
    broker.publish_lines("descan/v1/good/device/can0/5", &lines);
    broker.publish(
        "descan/v1/good/device/can0/6",
        br#"{"address":6,"name":"LAST","presence":"online"}"#,
    );
    pty.wait_for("● 1 present");
    pty.wait_for("documents not used; the last is descan/v1/good/device/can0/5: ");
    let most = peak_memory(pty.pid());
    assert!(most < 100 << 10, "{most} KiB");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn nothing_from_the_broker_is_sent_to_the_bus() {
    let Some(broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder(), broker.url());
    let requests = [
        r#"{"send":"1FFFFFFF#DEADBEEF"}"#,
        r#"{"address":10,"mode":"WORK","command":"reboot","frame":{"id":123,"data":"00"}}"#,
        "1FFFFFFF#DEADBEEF",
        r#"{"online":true,"started_ms":1,"buses":["sim:boiler"]}"#,
    ];
    let topics = [
        "device/sim:boiler/10",
        "device/sim:boiler/10/set",
        "bus/sim:boiler",
        "bus/sim:boiler/send",
        "send",
        "cmd",
        "event",
        "finding/sim:boiler/x",
        "status",
    ];
    let publish = |kept: bool| {
        for topic in topics {
            let topic = format!("descan/v1/g/{topic}");
            for request in requests {
                if kept {
                    broker.publish(&topic, request.as_bytes());
                }
            }
            if !kept {
                broker.publish_lines(&topic, &requests.join("\n").repeat(50));
            }
        }
    };
    publish(true);
    // It listens: whatever it sent would be because of these.
    let gateway = ["sim:boiler", "--broker", &url, "--gateway", "g", "--listen-only"];
    let publisher = Running::publish(&[&gateway[..], &["--record", "bus.log"]].concat(), folder);
    let topics_with = |part: &str| {
        let all = retained(&broker).into_iter();
        all.filter(|(topic, _)| topic.contains(part)).count()
    };
    // It has read them: those of no device are cleared.
    wait_for(|| {
        (topics_with("/set") + topics_with("/send") + topics_with("/cmd") == 0).then_some(())
    });
    publish(false);
    broker.publish("descan/v1/g/status", br#"{"online":true,"started_ms":1}"#);
    wait_for(|| {
        let all = retained(&broker);
        let (_, status) = all.iter().find(|(topic, _)| topic == "descan/v1/g/status")?;
        (status["started_ms"] != 1).then_some(())
    });
    assert_eq!(publisher.stop(), Some(0));
    let recorded = fs::read_to_string(folder.join("bus.log")).unwrap();
    assert!(recorded.lines().count() > 10, "{recorded}");
    let sent: Vec<&str> = recorded.lines().filter(|line| line.ends_with(" T")).collect();
    assert_eq!(sent, [""; 0]);
}

// --- restarts and cut connections --------------------------------------------------------------

/// A connection to the broker that can be cut.
struct Wire {
    port: u16,
    streams: Arc<Mutex<Vec<TcpStream>>>,
}

impl Wire {
    fn to(port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let own = listener.local_addr().unwrap().port();
        let streams: Arc<Mutex<Vec<TcpStream>>> = Arc::default();
        let known = Arc::clone(&streams);
        thread::spawn(move || {
            for near in listener.incoming() {
                let Ok(near) = near else { return };
                let Ok(far) = TcpStream::connect(("127.0.0.1", port)) else { continue };
                let both = [near.try_clone().unwrap(), far.try_clone().unwrap()];
                known.lock().unwrap().extend(both);
                let (near_back, far_back) = (near.try_clone().unwrap(), far.try_clone().unwrap());
                thread::spawn(move || copy(near, far));
                thread::spawn(move || copy(far_back, near_back));
            }
        });
        Self { port: own, streams }
    }

    /// Cuts all connections, in the middle of whatever is on the way.
    fn cut(&self) -> bool {
        let streams = std::mem::take(&mut *self.streams.lock().unwrap());
        let is_open = !streams.is_empty();
        for stream in streams {
            let _ = stream.shutdown(Shutdown::Both);
        }
        is_open
    }
}

fn copy(mut from: TcpStream, mut to: TcpStream) {
    let mut buffer = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut buffer) {
        if to.write_all(&buffer[..count]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
    let _ = from.shutdown(Shutdown::Both);
}

/// Returns a port whose first connection to the broker is cut after so many bytes of it.
fn cut_after(broker: u16, bytes: usize) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let own = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        for (number, near) in listener.incoming().flatten().enumerate() {
            let Ok(far) = TcpStream::connect(("127.0.0.1", broker)) else { continue };
            let (mut near_back, mut far_back) =
                (near.try_clone().unwrap(), far.try_clone().unwrap());
            thread::spawn(move || copy(near, far));
            if number > 0 {
                thread::spawn(move || copy(far_back, near_back));
                continue;
            }
            let _ = std::io::copy(&mut (&mut far_back).take(bytes as u64), &mut near_back);
            let _ = far_back.shutdown(Shutdown::Both);
            let _ = near_back.shutdown(Shutdown::Both);
        }
    });
    own
}

#[test]
fn reading_that_was_cut_off_is_completed_and_leaves_no_session() {
    let Some(mut broker) = Mosquitto::start() else { return };
    let url = broker.url();
    let folder = broker.folder().to_owned();
    let _publisher = Running::publish(&["sim:boiler", "--broker", &url, "--gateway", "g"], &folder);
    let devices = ["FEED", "SENS", "PSU"];
    wait_for_devices(&url, &folder, &devices);
    let cut = format!("mqtt://127.0.0.1:{}", cut_after(broker.port(), 2000));
    let fleet = fleet_json(&["--broker", &cut], &folder);
    let names = names_of(&fleet, 0);
    assert!(devices.iter().all(|device| names.contains(device)), "{names:?}");
    // By then the broker has handled that the viewer is gone.
    assert!(!retained(&broker).is_empty());
    broker.stop();
    let state = fs::read(folder.join("mosquitto.db")).unwrap();
    let has = |word: &[u8]| state.windows(word.len()).any(|it| it == word);
    assert!(has(b"descan/v1/g/status"), "the state has what is kept");
    assert!(!has(b"descan-view-"), "a session of a viewer is left");
}

fn settings(port: u16) -> BrokerSettings {
    let address = format!("mqtt://127.0.0.1:{port}").parse().unwrap();
    let access = BrokerAccess { address, ca: None, identity: None, credentials: None };
    BrokerSettings::read(&access).unwrap()
}

/// What a reader received: the numbers of events in order, and the documents.
#[derive(Default)]
struct Received {
    events: Vec<u64>,
    fleet: Fleet,
    is_subscribed: bool,
}

/// Reads on a thread until `stop`.
fn receive(port: u16, stop: Arc<AtomicBool>) -> Arc<Mutex<Received>> {
    let received: Arc<Mutex<Received>> = Arc::default();
    let known = Arc::clone(&received);
    thread::spawn(move || {
        let filters = [&FleetTopic::DOCUMENTS[..], &[FleetTopic::EVENTS]].concat();
        let mut reader = BrokerReader::spawn(&settings(port), &filters).unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        while !stop.load(Ordering::Relaxed) {
            let limit = tokio::time::Duration::from_millis(100);
            let next = runtime.block_on(async { tokio::time::timeout(limit, reader.next()).await });
            let Ok(Some(notice)) = next else { continue };
            let mut received = known.lock().unwrap();
            match notice {
                ReaderNotice::Message(topic, payload, _) if topic.ends_with(b"/event") => {
                    let value: Value = serde_json::from_slice(&payload).unwrap();
                    received.events.push(value["seq"].as_u64().unwrap());
                }
                ReaderNotice::Message(topic, payload, is_kept) => {
                    received.fleet.handle_message(Instant::ZERO, &topic, &payload, is_kept);
                }
                ReaderNotice::Subscribed { refused } => {
                    assert_eq!(refused, 0);
                    received.is_subscribed = true;
                }
                _ => {}
            }
        }
    });
    received
}

/// A gateway whose documents and events change all the time.
struct Load {
    publisher: BrokerPublisher,
    round: u64,
}

impl Load {
    const DEVICES: u64 = 40;

    fn start(port: u16) -> Self {
        let publication = Publication::new("g".parse().unwrap(), 1);
        Self { publisher: BrokerPublisher::spawn(&settings(port), publication).unwrap(), round: 0 }
    }

    /// The documents of a round: device `n` is there in two rounds of three.
    fn documents(round: u64) -> impl Iterator<Item = FleetDocument> {
        let there = (1..=Self::DEVICES).filter(move |number| !(number + round).is_multiple_of(3));
        there.map(move |number| FleetDocument {
            path: TopicPath::Device("can0".to_owned(), number as u8),
            value: json!({"address": number, "name": format!("R{round}"), "presence": "online"}),
            counters: &[],
            counter_period: Duration::from_secs(30),
        })
    }

    fn step(&mut self) {
        self.round += 1;
        let round = self.round;
        self.publisher.update(|publication| {
            let now = Instant::ZERO + Duration::from_secs(round);
            publication.handle_documents(now, 0.0, Self::documents(round));
            publication.handle_status(sites::unix_time(), json!({}));
            for _ in 0..5 {
                publication.handle_event(json!({"round": round}));
            }
        });
    }

    /// Waits for the next connection.
    fn wait_connected(&mut self) {
        wait_for(|| {
            matches!(self.publisher.poll_notice(), Some(PublisherNotice::Connected)).then_some(())
        });
    }

    /// Every event arrived at a subscriber that was connected all the time.
    fn assert_events_arrived(&mut self, received: &Mutex<Received>) {
        self.step();
        let count = self.round * 5;
        wait_for(|| {
            let received = received.lock().unwrap();
            let seen: BTreeSet<u64> = received.events.iter().copied().collect();
            (seen.len() as u64 == count).then_some(())
        });
    }

    /// The broker acknowledged everything, and what it has at the end is the last round.
    fn assert_delivered(mut self, received: &Mutex<Received>) {
        self.step();
        let round = self.round;
        wait_for(|| self.publisher.update(|it| it.is_delivered()).then_some(()));
        let expected: Vec<(u8, String)> = Self::documents(round)
            .map(|it| (it.value["address"].as_u64().unwrap() as u8, format!("R{round}")))
            .collect();
        wait_for(|| {
            let received = received.lock().unwrap();
            let gateway = received.fleet.gateway(&"g".parse().unwrap())?;
            let found: Vec<(u8, String)> = gateway
                .devices()
                .map(|it| (it.address, it.name.clone().unwrap_or_default()))
                .collect();
            (found == expected).then_some(())
        });
        assert_eq!(self.publisher.update(|it| it.dropped_events()), 0);
    }
}

#[test]
fn cut_connections_lose_no_event_and_leave_the_state_right() {
    let Some(broker) = Mosquitto::start() else { return };
    let wire = Wire::to(broker.port());
    let stop = Arc::new(AtomicBool::new(false));
    let received = receive(broker.port(), Arc::clone(&stop));
    wait_for(|| received.lock().unwrap().is_subscribed.then_some(()));
    let mut load = Load::start(wire.port);
    for _ in 0..20 {
        load.wait_connected();
        (0..20).for_each(|_| load.step());
        wait_for(|| wire.cut().then_some(()));
        (0..3).for_each(|_| load.step());
    }
    load.assert_events_arrived(&received);
    load.assert_delivered(&received);
    stop.store(true, Ordering::Relaxed);
}

#[test]
fn restarted_brokers_lose_no_event_and_have_the_state() {
    let Some(mut broker) = Mosquitto::start() else { return };
    let stop = Arc::new(AtomicBool::new(false));
    let received = receive(broker.port(), Arc::clone(&stop));
    wait_for(|| received.lock().unwrap().is_subscribed.then_some(()));
    let mut load = Load::start(broker.port());
    for _ in 0..20 {
        load.wait_connected();
        (0..20).for_each(|_| load.step());
        broker.stop();
        (0..3).for_each(|_| load.step());
        assert!(broker.launch());
    }
    load.assert_events_arrived(&received);
    load.assert_delivered(&received);
    stop.store(true, Ordering::Relaxed);
}

/// Killed brokers continue from what they last wrote: an older state, with the session of the gateway. What
/// they had acknowledged since is sent again, and what came back is cleared.
#[test]
fn killed_brokers_have_the_state_again() {
    let Some(mut broker) = Mosquitto::start() else { return };
    let url = broker.url();
    let folder = broker.folder().to_owned();
    let mut load = Load::start(broker.port());
    for turn in 0..=20 {
        load.wait_connected();
        wait_for(|| load.publisher.update(|it| it.is_delivered()).then_some(()));
        // Nothing changes meanwhile: what the broker has becomes right all the same.
        let round = load.round;
        let expected: Vec<String> = match round {
            0 => Vec::new(),
            _ => Load::documents(round).map(|_| format!("R{round}")).collect(),
        };
        wait_for(|| {
            let fleet = fleet_json(&["--broker", &url], &folder);
            (names_of(&fleet, 0) == expected).then_some(())
        });
        // It continues from here, or from a state of several kills before.
        if turn % 3 == 0 {
            broker.save();
        }
        load.step();
        if turn % 2 == 0 {
            wait_for(|| load.publisher.update(|it| it.is_delivered()).then_some(()));
        }
        broker.kill();
        assert!(broker.launch());
    }
}

#[test]
fn broker_that_forgot_everything_gets_everything_again() {
    let Some(mut broker) = Mosquitto::start() else { return };
    let (url, folder) = (broker.url(), broker.folder().to_owned());
    let mut load = Load::start(broker.port());
    load.wait_connected();
    load.step();
    wait_for(|| load.publisher.update(|it| it.is_delivered()).then_some(()));
    broker.stop();
    fs::remove_file(folder.join("mosquitto.db")).unwrap();
    assert!(broker.launch());
    load.wait_connected();
    wait_for(|| load.publisher.update(|it| it.is_delivered()).then_some(()));
    let fleet = fleet_json(&["--broker", &url], &folder);
    assert_eq!(names_of(&fleet, 0).len(), Load::documents(1).count());
    assert_eq!(state_of(&fleet, "g").as_deref(), Some("online"));
}

#[test]
fn document_above_the_packet_limit_is_left_out() {
    let broker =
        Mosquitto::with_settings(|_| "allow_anonymous true\nmax_packet_size 4000\n".to_owned());
    let Some(broker) = broker else { return };
    let (folder, url) = (broker.folder(), broker.url());
    let mut device =
        "[[device]]\nname = \"LONG\"\naddress = { fixed = 12 }\nservices = [".to_owned();
    let services: Vec<String> =
        (0..150).map(|number| format!("[\"SERVICE{number}\", \"1.0\"]")).collect();
    device.push_str(&services.join(", "));
    device.push_str("]\n[[device]]\nname = \"SHORT\"\naddress = { fixed = 13 }\n");
    fs::write(folder.join("line.toml"), format!("bitrate = 125000\n{device}")).unwrap();
    let mut publisher = command(&["publish", "sim:line.toml", "--broker", &url], folder)
        .args(["--gateway", "g"])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(publisher.stderr.take().unwrap()).lines();
    let publisher = Running(publisher);
    let said = lines.map_while(Result::ok).find(|line| line.contains("refuses")).unwrap();
    assert!(said.contains("it takes no packet of this length"), "{said}");
    // Its document was short until its services were known, and is cleared.
    wait_for(|| {
        let fleet = fleet_json(&["--broker", &url], folder);
        let is_online = state_of(&fleet, "g").as_deref() == Some("online");
        (is_online && names_of(&fleet, 0) == ["SHORT"]).then_some(())
    });
    drop(publisher);
}

/// It continues from what it last wrote, with the session of the viewer.
#[test]
fn viewer_forgets_what_a_killed_broker_lost() {
    let Some(mut broker) = Mosquitto::start() else { return };
    let (folder, url) = (broker.folder().to_owned(), broker.url());
    broker.publish("descan/v1/kept/status", br#"{"online":true}"#);
    let mut pty = Pty::start(&["fleet", "--broker", &url], &folder, (80, 24));
    pty.wait_for("1 gateway ");
    broker.save();
    broker.publish("descan/v1/lost/status", br#"{"online":true}"#);
    pty.wait_for("2 gateways");
    broker.kill();
    pty.wait_for("next attempt");
    assert!(broker.launch());
    pty.wait_for("1 gateway ");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

/// What is published meanwhile has no end; what the broker had does.
#[test]
fn one_reading_ends_while_documents_are_published() {
    let Some(broker) = Mosquitto::start() else { return };
    let stop = Arc::new(AtomicBool::new(false));
    let is_stopped = Arc::clone(&stop);
    let mut load = Load::start(broker.port());
    load.wait_connected();
    let working = thread::spawn(move || {
        while !is_stopped.load(Ordering::Relaxed) {
            load.step();
            thread::park_timeout(Duration::from_millis(20));
        }
    });
    let fleet = fleet_json(&["--broker", &broker.url(), "--time", "60"], broker.folder());
    stop.store(true, Ordering::Relaxed);
    working.join().unwrap();
    assert_eq!(fleet["complete"], true);
}

#[test]
fn view_of_200_gateways_is_complete_in_bounded_memory() {
    const GATEWAYS: usize = 200;
    let names: Vec<String> = (0..GATEWAYS).map(sites::name).collect();
    let Some(broker) = GuardedBroker::start(&names) else { return };
    let mut sites = Sites::start(&broker, GATEWAYS);
    sites.change(0..GATEWAYS);
    let url = broker.url();
    let access = ["--broker", &url, "--ca", "ca.pem", "--credentials", "viewer.toml"];
    let fleet = fleet_json(&access, broker.folder());
    let gateways = fleet["gateways"].as_array().unwrap();
    assert_eq!(gateways.len(), GATEWAYS);
    for gateway in gateways {
        let name = gateway["name"].as_str().unwrap();
        assert_eq!(gateway["state"], "online", "{name}");
        assert_eq!(gateway["devices"].as_array().unwrap().len(), sites::DEVICES, "{name}");
    }
    let all = [&["fleet"], &access[..]].concat();
    let mut pty = Pty::start(&all, broker.folder(), (120, 40));
    pty.wait_for("● 200 online");
    pty.wait_for("● 24,200 present");
    let most = peak_memory(pty.pid());
    assert!(most < 200 << 10, "{most} KiB");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn fleet_on_a_terminal_shows_gateways_and_devices() {
    let Some(mut broker) = Mosquitto::start() else { return };
    let folder = broker.folder().to_owned();
    let url = broker.url();
    let _publisher =
        Running::publish(&["sim:boiler", "--broker", &url, "--gateway", "north"], &folder);
    let mut pty = Pty::start(&["fleet", "--broker", &url], &folder, (80, 24));
    pty.wait_for("north");
    pty.wait_for("● connected");
    pty.send("\r");
    pty.wait_for("FEED");
    pty.send("\x1b");
    pty.wait_for("Gateways");
    broker.stop();
    pty.wait_for("next attempt in");
    pty.wait_for("AS OF");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    pty.assert_given_back();
}
