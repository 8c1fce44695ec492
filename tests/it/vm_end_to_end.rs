//! The real program on a CAN bus of a real kernel: devices simulated by a second descan, a device
//! made of can-utils and the kernel's own ISO-TP, and the terminal UI during interface outages.
//!
//! Without CAN in the kernel these tests print the reason and do not run.

use crate::common::can;
use crate::common::can::{Vcan, run};
use crate::common::processor_time::ticks;
use crate::common::pty::Pty;
use crate::common::watch_process::Watching;
use nix::errno::Errno;
use nix::sys::signal::Signal;
use nix::sys::socket::{getsockopt, sockopt};
use rustix::process::{PidfdFlags, PidfdGetfdFlags, pidfd_getfd, pidfd_open};
use serde_json::Value;
use std::collections::HashSet;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_descan"))
}

/// A process that is killed at the end of the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts simulated devices on a bus, and waits until they are online.
fn simulated(bus: &str, system: &str) -> Running {
    let mut child =
        program().args(["sim", bus, "--scenario", system]).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
    let first = said.next().expect("it says that it runs").unwrap();
    assert!(first.ends_with("; Ctrl-C stops"), "{first}");
    Running(child)
}

/// Starts one board in its own process, with its own random numbers: it always keeps address 12.
/// Without a UID it has a fresh one.
fn board(bus: &str, folder: &Path, (name, uid): (&str, &str), seed: u32) -> Running {
    let scenario = format!(
        "bitrate = 125000\nseed = {seed}\n[[device]]\nname = \"{name}\"\nuid = \"{uid}\"\nsettled = true\n\
         address = {{ fixed = 12 }}\nfaults = [\"never-gives-way\"]\n\
         services = [[\"DES\", \"1.0\"], [\"AUGER\", \"2.1\"]]\n"
    );
    let path = folder.join(format!("{name}{uid}.toml"));
    std::fs::write(&path, scenario).unwrap();
    simulated(bus, path.to_str().unwrap())
}

fn scan(bus: &str) -> Output {
    program().args(["scan", bus, "--json", "--time", "40"]).stdin(Stdio::null()).output().unwrap()
}

fn report(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| {
        panic!("{error}: {}", String::from_utf8_lossy(&output.stderr));
    })
}

fn device<'r>(report: &'r Value, name: &str) -> &'r Value {
    let devices = report["devices"].as_array().unwrap();
    devices.iter().find(|it| it["name"] == name).unwrap_or_else(|| panic!("no {name}: {report:#}"))
}

#[test]
fn devices_of_second_descan_are_found_with_services() {
    let Some(vcan) = Vcan::new("dsp-scan") else { return };
    let _devices = simulated(vcan.name(), "boiler");
    let output = scan(vcan.name());
    let report = report(&output);
    assert_eq!(output.status.code(), Some(0), "{report:#}");
    assert_eq!(report["buses"][0]["address"], 0);
    assert_eq!(report["buses"][0]["lost"], 0);
    for (name, address, services) in [("FEED", 10, 5), ("SENS", 12, 4), ("PSU", 30, 3)] {
        let device = device(&report, name);
        assert_eq!(device["address"], address);
        assert_eq!(device["presence"], "online");
        assert_eq!(device["services"].as_array().unwrap().len(), services, "{device:#}");
    }
}

#[test]
fn simulated_devices_wait_for_a_bus_that_is_down() {
    let Some(vcan) = Vcan::new("dsp-sim") else { return };
    let mut sim = program().args(["sim", vcan.name()]).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(sim.stderr.take().unwrap()).lines();
    let _sim = Running(sim);
    assert!(said.next().unwrap().unwrap().contains("devices on"));
    vcan.down();
    assert!(said.next().unwrap().unwrap().contains("dsp-sim is down"));
    vcan.up();
    let report = report(&scan(vcan.name()));
    assert_eq!(device(&report, "FEED")["presence"], "online");
}

/// Runs a device made of candump, cansend and the kernel's ISO-TP: it responds to name requests and
/// to one services request.
fn answer_as_device(bus: &str) -> std::thread::JoinHandle<()> {
    let mut candump = Command::new("candump")
        .args(["-L", bus])
        .stdout(Stdio::piped())
        .spawn()
        .expect("can-utils are there");
    let lines = BufReader::new(candump.stdout.take().unwrap()).lines();
    let bus = bus.to_owned();
    std::thread::spawn(move || {
        let _candump = Running(candump);
        for line in lines.map_while(Result::ok) {
            let frame = line.split_whitespace().nth(2).unwrap_or_default().to_owned();
            // A name request to all working nodes, from address 0, in ISO-TP.
            if frame.starts_with("020") && frame.ends_with("#0444455301") {
                run("cansend", &[&bus, "05180002#06014645454400"]);
            }
            // A services request to address 12. The socket responds even after its process has
            // exited.
            if frame == "00003002#0444455302" {
                let services = "02 00 44 45 53 00 31 2E 30 00 01 41 55 47 45 52 00 32 2E 31 00";
                let arguments = ["-s", "05180002", "-d", "00003002", &bus];
                can::Peer::start_with_input("isotpsend", &arguments, services).finish();
                return;
            }
        }
    })
}

#[test]
fn kernel_isotp_device_is_identified() {
    let Some(vcan) = Vcan::new("dsp-isotp") else { return };
    let device_thread = answer_as_device(vcan.name());
    // Each response takes a process, which on a busy machine starts after the scan's rounds.
    let report = (0..10)
        .map(|_| report(&scan(vcan.name())))
        .find(|report| report["devices"].as_array().is_some_and(|devices| !devices.is_empty()))
        .expect("the device answers one of ten scans");
    let feed = device(&report, "FEED");
    assert_eq!((&feed["address"], &feed["framing"]), (&12.into(), &"isotp".into()));
    assert_eq!(feed["services"][1]["name"], "AUGER", "{feed:#}");
    assert_eq!(feed["services"][1]["version"], "2.1");
    device_thread.join().unwrap();
}

#[test]
fn interface_down_or_missing_has_a_remedy() {
    let Some(vcan) = Vcan::new("dsp-down") else { return };
    vcan.down();
    let output = scan(vcan.name());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.contains("ip link set dsp-down up"), "{said}");
    let output = scan("can99");
    assert_eq!(output.status.code(), Some(3));
    // This is not the name of an interface as users give them: no waiting.
    let output = scan("dsp-none");
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn screen_waits_for_its_interface() {
    let Some(vcan) = Vcan::new("dsp-ui") else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut devices = Some(simulated(vcan.name(), "boiler"));
    let mut pty = Pty::start(&[vcan.name()], folder.path(), (80, 24));
    pty.wait_for("FEED");
    // Another device may have appeared first and be selected.
    pty.send("gg");
    pty.wait_for("AUGER");
    devices.take();
    vcan.down();
    pty.wait_for("down");
    vcan.up();
    devices = Some(simulated(vcan.name(), "boiler"));
    pty.wait_until("devices online again", |screen| {
        let text = screen.contents();
        text.lines().any(|line| line.contains("FEED") && line.contains("online"))
    });
    devices.take();
    vcan.remove();
    pty.wait_until("word that it is gone", |screen| {
        let text = screen.contents().to_lowercase();
        text.contains("unplugged") || text.contains("gone") || text.contains("missing")
    });
    vcan.create().unwrap();
    devices = Some(simulated(vcan.name(), "boiler"));
    pty.wait_until("devices online once more", |screen| {
        let text = screen.contents();
        text.lines().any(|line| line.contains("FEED") && line.contains("online"))
    });
    drop(devices);
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    pty.assert_given_back();
}

#[test]
fn list_of_buses_opens_a_missing_interface_when_it_appears() {
    let Some(vcan) = Vcan::later("vcan-late") else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut pty = Pty::start(&[vcan.name()], folder.path(), (80, 24));
    pty.wait_for("vcan-late not found: waiting for it");
    vcan.create().unwrap();
    let devices = simulated(vcan.name(), "boiler");
    pty.wait_for("FEED");
    drop(devices);
    pty.send("q");
    assert_eq!(pty.wait(), 0);
    pty.assert_given_back();
    // One that is down has the command.
    vcan.down();
    let mut pty = Pty::start(&[vcan.name()], folder.path(), (80, 24));
    pty.wait_for("vcan-late is down: waiting for it");
    pty.wait_for("sudo ip link set vcan-late up");
    vcan.up();
    pty.wait_for("1 Devices");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn list_of_buses_has_what_is_heard_on_interfaces_that_are_up() {
    let Some(one) = Vcan::new("vcan-one") else { return };
    let Some(other) = Vcan::new("vcan-other") else { return };
    let folder = tempfile::tempdir().unwrap();
    let _devices = simulated(other.name(), "boiler");
    let mut pty = Pty::start(&[one.name()], folder.path(), (100, 30));
    pty.wait_for("1 Devices");
    pty.send("B");
    pty.wait_until("what is heard", |screen| {
        let text = screen.contents();
        let line = text.lines().find(|line| line.contains("vcan-other"));
        // The first four that are heard are named.
        line.is_some_and(|line| line.contains("f/s") && line.contains('@'))
    });
    pty.send("/other\r\r");
    pty.wait_for("opened vcan-other");
    pty.wait_for("FEED");
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn two_inspectors_share_one_bus() {
    let Some(vcan) = Vcan::new("dsp-two") else { return };
    let folder = tempfile::tempdir().unwrap();
    let _devices = simulated(vcan.name(), "boiler");
    let mut first = Pty::start(&[vcan.name()], folder.path(), (100, 30));
    first.wait_for("own 0");
    let mut second = Pty::start(&[vcan.name()], folder.path(), (100, 30));
    second.wait_for("FEED");
    second.wait_until("an address of its own", |screen| {
        let text = screen.contents();
        text.contains("own ") && !text.contains("own 0 ") && !text.contains("own –")
    });
    second.wait_for("DSCAN");
    second.send("ggj");
    second.wait_for("AUGER");
    first.send("q");
    second.send("q");
    assert_eq!((first.wait(), second.wait()), (0, 0));
}

#[test]
fn interface_changes_are_events() {
    let Some(vcan) = Vcan::new("dsp-watch") else { return };
    let folder = tempfile::tempdir().unwrap();
    let first = board(vcan.name(), folder.path(), ("FEED", "WATCHED"), 1);
    let mut watching = Watching::start(&[vcan.name(), "--json"], folder.path());
    let is_feed = |it: &Value| it["address"] == 12;
    watching.event_that("bus", |it| it["bus"]["address"] == 0);
    assert_eq!(watching.event_that("services", is_feed)["services"][1]["name"], "AUGER");
    let is_down = |it: &Value| it["bus"]["state"] == "down";
    let is_up = |it: &Value| it["bus"]["state"] != "down";
    vcan.down();
    watching.event_that("bus", is_down);
    drop(first);
    vcan.up();
    watching.event_that("bus", is_up);
    // Only now is the loss certain.
    watching.event_that("lost", is_feed);
    let second = board(vcan.name(), folder.path(), ("FEED", "WATCHED"), 1);
    // If descan's request arrives before its first heartbeat, the response is received first.
    let was = &watching.event_that("returned", is_feed)["was"];
    assert!(was == "lost" || was == "silent", "{was}");
    drop(second);
    vcan.remove();
    watching.event_that("bus", is_down);
    vcan.create().unwrap();
    watching.event_that("bus", is_up);
    watching.event_that("lost", is_feed);
    let _third = board(vcan.name(), folder.path(), ("FEED", "WATCHED"), 1);
    watching.event_that("returned", is_feed);
    watching.signal(nix::sys::signal::Signal::SIGTERM);
    assert_eq!(watching.exit_code(), 0);
    vcan.down();
    let mut refused = Watching::start(&[vcan.name(), "--json"], folder.path());
    assert_eq!(refused.exit_code(), 3);
    assert_eq!(refused.rest(), "");
}

/// Six seconds of other protocols, a frame each 10 ms: CANopen, and NMEA 2000, whose identifiers are
/// those of requests, broadcasts and heartbeats in part.
fn foreign_log(bus: &str) -> String {
    use std::fmt::Write;
    let fast = [0x09F1_1200_u32, 0x0DF1_1900, 0x09F1_1300, 0x09F8_0100, 0x19F5_0B00, 0x09FD_0200];
    let mut log = String::new();
    for step in 0..600_u32 {
        let data = u64::from(step).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let id = match step % 2 {
            0 => format!("{:03X}", 0x180 + step % 20),
            _ => format!("{:08X}", fast[step as usize / 2 % fast.len()] | (step / 12 % 8 + 1)),
        };
        writeln!(log, "({}.{:06}) {bus} {id}#{data:016X}", step / 100, step % 100 * 10_000)
            .unwrap();
    }
    log
}

#[test]
fn nothing_is_sent_into_played_foreign_traffic() {
    let Some(vcan) = Vcan::new("dsp-foreign") else { return };
    let folder = tempfile::tempdir().unwrap();
    let log = foreign_log(vcan.name());
    let (recording, profile) = (folder.path().join("foreign.log"), folder.path().join("node.toml"));
    std::fs::write(&recording, &log).unwrap();
    std::fs::write(&profile, "[heartbeat]\nannounce = true\n").unwrap();
    let id = |line: &str| line.split([' ', '#']).nth(2).unwrap_or_default().to_owned();
    let known: HashSet<String> = log.lines().map(id).collect();

    let candump = can::start_candump(vcan.name(), &["-L", "-T", "1000"]);
    let player = can::Peer::start("canplayer", &["-l", "i", "-I", recording.to_str().unwrap()]);
    let profile = ["--profile", profile.to_str().unwrap()];
    let scan = ["scan", vcan.name(), "--json", "--for", "6"];
    let output = program().args(scan).args(profile).stdin(Stdio::null()).output().unwrap();
    drop(player);

    let report = report(&output);
    assert_eq!(output.status.code(), Some(0), "{report:#}");
    assert_eq!(report["buses"][0]["verdict"], "foreign", "{report:#}");
    assert!(report["buses"][0]["frames"].as_u64().unwrap() >= 300, "{report:#}");
    assert_eq!(report["devices"].as_array().map(Vec::len), Some(0), "{report:#}");
    let heard = candump.finish();
    assert!(heard.lines().count() >= 300, "{heard}");
    let sent: Vec<_> = heard.lines().filter(|line| !known.contains(&id(line))).collect();
    assert_eq!(sent, [""; 0]);
}

#[test]
fn bus_off_restarts_discovery() {
    let Some(vcan) = Vcan::new("dsp-off") else { return };
    let folder = tempfile::tempdir().unwrap();
    let watching = Watching::start(&[vcan.name()], folder.path());
    // The bus has no other nodes, so lines are few.
    let line_with = |part: &str| {
        assert!((0..20).any(|_| watching.line().contains(part)), "no {part}");
    };
    line_with("using address 0");
    run("cansend", &[vcan.name(), "20000040#0000000000000000"]);
    line_with("was briefly bus-off");
    line_with("using address 0");
}

#[test]
fn receive_filter_skips_frames_of_other_devices() {
    let Some(vcan) = Vcan::new("dsp-filter") else { return };
    let folder = tempfile::tempdir().unwrap();
    let arguments = [vcan.name(), "--json", "--listen-only", "--filter", "at:12,14"];
    let watching = Watching::start(&arguments, folder.path());
    watching.event("bus");
    // A heartbeat of 13, a standard and a remote frame; then an error frame, a frame of 12 to 13,
    // one of 13 to 12, a broadcast request.
    for other in ["071A0001#8AFA6C9724110400", "123#01", "07180001#R", "071A3801#01"] {
        run("cansend", &[vcan.name(), other]);
    }
    for of_interest in
        ["20000088#0000000000000000", "00183402#0444455302", "001A3002#0444455302", "02000002#00"]
    {
        run("cansend", &[vcan.name(), of_interest]);
    }
    run("cansend", &[vcan.name(), "071C0001#8AFA6C9724110400"]);
    watching.event_that("appeared", |it| it["address"] == 14);
    vcan.down();
    let bus = watching.event_that("bus", |it| it["bus"]["state"] == "down");
    assert_eq!((&bus["bus"]["frames"], &bus["bus"]["errors"]), (&5.into(), &1.into()), "{bus}");
    assert_eq!(bus["bus"]["load"], Value::Null);
}

/// Returns the number of entries in a folder of /proc.
fn entries(process: u32, folder: &str) -> usize {
    std::fs::read_dir(format!("/proc/{process}/{folder}")).unwrap().count()
}

#[test]
fn unplugging_under_load_recovers_without_leaks() {
    // With DESCAN_REPLUGS=100 the test takes minutes.
    let rounds = std::env::var("DESCAN_REPLUGS").map_or(8, |it| it.parse().unwrap());
    let Some(vcan) = Vcan::new("dsp-replug") else { return };
    let folder = tempfile::tempdir().unwrap();
    let watching = Watching::start(&[vcan.name(), "--json"], folder.path());
    watching.event("bus");
    let name = vcan.name();
    // The heartbeat shows that the bus speaks DES.
    run("cansend", &[name, "07500401#A1A2A3A4A5A60400"]);
    let load = format!("while :; do cangen -g 1 -e -I 07180155 {name} 2>&-; sleep 0.05; done");
    let shell = Command::new("sh").args(["-c", &load]).stdin(Stdio::null()).spawn().unwrap();
    let _load = Running(shell);
    let mut held = Vec::new();
    for round in 1..=rounds {
        vcan.remove();
        watching.event_that("bus", |it| it["bus"]["state"] == "down");
        vcan.create().unwrap();
        watching.event_that("bus", |it| it["bus"]["state"] != "down");
        // A debug message of this round: frames are received.
        let id = 0x1F19_FC00 | round;
        run("cansend", &[name, &format!("{id:08X}#")]);
        watching.event_that("debug", |it| it["code"] == round);
        held.push((entries(watching.id(), "fd"), entries(watching.id(), "task")));
    }
    assert_eq!(held.first(), held.last(), "{held:?}");
}

/// Takes the error that waits at each socket of a process, as another call of the process would. Returns
/// the errors.
fn take_socket_errors(process: u32) -> Vec<i32> {
    let id = rustix::process::Pid::from_raw(process.cast_signed()).unwrap();
    let process_fd = pidfd_open(id, PidfdFlags::empty()).unwrap();
    let folder = format!("/proc/{process}/fd");
    let is_socket = |number: &i32| {
        std::fs::read_link(format!("{folder}/{number}"))
            .is_ok_and(|to| to.to_string_lossy().starts_with("socket:"))
    };
    std::fs::read_dir(&folder)
        .unwrap()
        .filter_map(|entry| entry.unwrap().file_name().to_str()?.parse().ok())
        .filter(is_socket)
        .map(|number| pidfd_getfd(&process_fd, number, PidfdGetfdFlags::empty()).unwrap())
        .map(|socket| getsockopt(&socket, sockopt::SocketError).unwrap())
        .filter(|error| *error != 0)
        .collect()
}

/// Removes the interface while the process is stopped, takes the error from its socket, and lets it run on
/// after `then`.
fn remove_unnoticed(vcan: &Vcan, watching: &Watching, then: impl FnOnce()) {
    watching.signal(Signal::SIGSTOP);
    vcan.remove();
    assert_eq!(take_socket_errors(watching.id()), [Errno::ENODEV as i32]);
    then();
    watching.signal(Signal::SIGCONT);
}

#[test]
fn removal_whose_error_was_overwritten_is_noticed() {
    let Some(vcan) = Vcan::new("dsp-error") else { return };
    let folder = tempfile::tempdir().unwrap();
    let watching = Watching::start(&[vcan.name(), "--json"], folder.path());
    watching.event("bus");
    remove_unnoticed(&vcan, &watching, || {});
    watching.event_that("bus", |it| it["bus"]["state"] == "down");
    vcan.create().unwrap();
    watching.event_that("bus", |it| it["bus"]["state"] != "down");
}

/// An interface that is moved to another network namespace and back keeps its index, and so does one
/// that a script creates with it.
#[test]
fn interface_that_returns_with_its_index_is_opened_again() {
    let Some(vcan) = Vcan::new("dsp-index") else { return };
    let folder = tempfile::tempdir().unwrap();
    let watching = Watching::start(&[vcan.name(), "--json"], folder.path());
    watching.event("bus");
    let name = vcan.name();
    run("cansend", &[name, "07500401#A1A2A3A4A5A60400"]);
    let index = nix::net::if_::if_nametoindex(name).unwrap();
    // Debug messages with the codes 0, 1, 2 … of the device with address 3.
    let load = format!(
        "code=0; while :; do \
         cansend {name} $(printf 1F19%04X $((0xFC00 + code)))# 2>&- && code=$((code + 1)); sleep 0.1; \
         done"
    );
    let shell = Command::new("sh").args(["-c", &load]).stdin(Stdio::null()).spawn().unwrap();
    let _load = Running(shell);
    let next = |after: u64| {
        let event = watching.event_that("debug", |it| it["code"].as_u64() > Some(after));
        event["code"].as_u64().unwrap()
    };
    // The processor time for ten messages, none of which is lost.
    let used = |mut code: u64| {
        let before = ticks(watching.id());
        for _ in 0..10 {
            let following = next(code);
            assert_eq!(following, code + 1);
            code = following;
        }
        (ticks(watching.id()) - before, code)
    };
    let (usual, mut code) = used(next(0));
    for is_noticed in [true, false] {
        if is_noticed {
            vcan.remove();
            watching.event_that("bus", |it| it["bus"]["state"] == "down");
            vcan.create_with_index(index);
        } else {
            remove_unnoticed(&vcan, &watching, || vcan.create_with_index(index));
        }
        // After a message that was sent when it was back.
        let (ticks, last) = used(next(code + 12));
        assert!(ticks < 2 * usual + 10, "{ticks} instead of {usual} ticks, {is_noticed}");
        code = last;
    }
}

/// Tests two boards in two processes at one address: `scan`, `watch` and the screen report a
/// confirmed conflict, and clear it when one of them is gone.
fn collide(bus: &str, (first, second): ((&str, &str), (&str, &str))) {
    let Some(vcan) = Vcan::new(bus) else { return };
    let folder = tempfile::tempdir().unwrap();
    let start = |who, seed: u32| {
        let folder = folder.path().join(seed.to_string());
        std::fs::create_dir(&folder).unwrap();
        board(vcan.name(), &folder, who, seed)
    };
    let _first = start(first, 1);
    let second = start(second, 2);
    let output = scan(vcan.name());
    let report = report(&output);
    assert_eq!(output.status.code(), Some(1), "{report:#}");
    let is_confirmed = |it: &Value| {
        let kind = it["kind"].as_str().unwrap();
        let is_collision =
            ["same-name-same-address", "one-address-two-names", "one-address-two-identities"]
                .contains(&kind);
        is_collision && it["confidence"] == "confirmed" && it["address"] == 12
    };
    let findings = report["findings"].as_array().unwrap();
    assert!(findings.iter().any(is_confirmed), "{report:#}");

    let watching = Watching::start(&[vcan.name(), "--json"], folder.path());
    let mut pty = Pty::start(&[vcan.name()], folder.path(), (100, 30));
    let confirmed = watching.event_that("finding", |it| is_confirmed(&it["finding"]));
    let evidence = &confirmed["finding"]["evidence"];
    assert!(evidence[0]["frame"].as_str().unwrap().contains('#'), "{confirmed:#}");
    pty.wait_for("CONFLICT");

    drop(second);
    let kind = &confirmed["finding"]["kind"];
    watching.event_that("finding", |it| {
        it["finding"]["kind"] == *kind && it["finding"]["confidence"] == "cleared"
    });
    pty.wait_until("word that it is over", |screen| !screen.contents().contains("CONFLICT"));
    pty.send("q");
    assert_eq!(pty.wait(), 0);
}

#[test]
fn two_names_at_one_address_are_a_conflict() {
    collide("dsp-names", (("FEED", "ONE"), ("PUMP", "TWO")));
}

#[test]
fn one_name_twice_at_one_address_is_a_conflict() {
    collide("dsp-name", (("FEED", "ONE"), ("FEED", "TWO")));
}

#[test]
fn two_new_boards_of_one_name_are_a_conflict() {
    collide("dsp-fresh", (("FEED", ""), ("FEED", "")));
}

/// Two devices whose addresses des.json swaps; what they store, they use at once.
const SWAP: &str = r#"bitrate = 125000
[profile.descriptor]
addr = 0x016
[profile.commands]
identify = 0x018
mode = 0x019
[profile.writes]
address = 0x016
[[device]]
name = "FEED"
uid = "BOILER01"
address = { fixed = 10 }
settled = true
services = [["DES", "1.0"], ["AUGER", "2.1"], ["JAM", "1.0"]]
[[device]]
name = "SENS"
uid = "BOILER02"
address = { fixed = 12 }
settled = true
"#;

#[test]
fn commands_frames_and_plans_reach_devices_on_a_bus() {
    let Some(vcan) = Vcan::new("dsp-cmd") else { return };
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("swap.toml", SWAP);
    write(
        "p.toml",
        "[descriptor]\naddr = 0x016\n[commands]\nidentify = 0x018\nmode = 0x019\n[writes]\naddress = 0x016\n",
    );
    write(
        "des.json",
        r#"{ "devices": [ { "name": "FEED", "address": 12, "static": true },
             { "name": "SENS", "address": 10, "static": true } ] }"#,
    );
    let _devices = simulated(vcan.name(), folder.path().join("swap.toml").to_str().unwrap());
    let descan = |arguments: &[&str]| {
        let mut command = program();
        command.args(arguments).args(["--profile", "p.toml", "--yes", "--json"]);
        command.env("XDG_STATE_HOME", folder.path().join("state"));
        let output = command.current_dir(folder.path()).stdin(Stdio::null()).output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {text}{error}");
        text
    };
    let bus = vcan.name();
    let identify: Value = serde_json::from_str(&descan(&["identify", bus, "FEED"])).unwrap();
    assert_eq!(identify["outcome"], "responded");
    // Three services: several frames, with flow control of the kernel's bus.
    let sent = descan(&["send", bus, "request", "des", "services", "to", "FEED"]);
    assert!(sent.contains("AUGER 2.1, JAM 1.0") && sent.contains("\"answered\""), "{sent}");
    let applied: Value = serde_json::from_str(&descan(&["apply", bus])).unwrap();
    assert_eq!(
        (&applied["state"], applied["steps"].as_array().unwrap().len()),
        (&"done".into(), 3)
    );
    let report = report(&scan(bus));
    assert_eq!(device(&report, "FEED")["address"], 12);
    assert_eq!(device(&report, "SENS")["address"], 10);
    assert_eq!(report["buses"][0]["errors"], 0);
}
