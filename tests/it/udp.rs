//! The bus of python-can's `udp_multicast`, with python-can itself as the peer.
//!
//! Every test runs in its own network namespace that has only `lo`: no packet reaches the machine's
//! network.

use crate::common::open_bus::OpenBus;
use crate::common::python::{Peer, Python};
use descan::bus::TransmitError;
use descan::frame::{BusIndex, CanId, Frame};
use descan::status::Link;
use std::io::Write;
use std::net::{SocketAddr, UdpSocket};
use std::process::{Child, Command, Stdio};

const V4: &str = "239.74.163.2";
const V6: &str = "ff15:7079:7468:6f6e:6465:6d6f:6d63:6173";
const PACKAGES: [&str; 2] = ["python-can==4.6.1", "msgpack==1.1.2"];

/// `lo` with multicast, like a real network.
const NETWORK: &str = "ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && \
                       ip -6 route add local ff00::/8 dev lo table local";

/// Runs a test of this program in a namespace. Where that is not possible, prints the reason; in CI
/// it must run.
fn in_namespace(test: &str) {
    let user = if nix::unistd::geteuid().is_root() { "-n" } else { "-rn" };
    let attempt = Command::new("unshare").args([user, "sh", "-c", NETWORK]).output();
    let reason = match attempt {
        Ok(output) if output.status.success() => None,
        Ok(output) => Some(String::from_utf8_lossy(&output.stderr).into_owned()),
        Err(error) => Some(format!("unshare: {error}")),
    };
    if let Some(reason) = reason {
        let must_run = std::env::var("CI").is_ok_and(|ci| ci == "true");
        assert!(!must_run, "no network namespace: {reason}");
        let _ = writeln!(std::io::stderr(), "skipped {test}: no network namespace: {reason}");
        return;
    }
    let own = std::env::current_exe().unwrap();
    let script = format!("{NETWORK} && exec \"$0\" --exact udp::{test} --ignored --nocapture");
    let output = Command::new("unshare").args([user, "sh", "-c", &script]).arg(own).output();
    let output = output.unwrap();
    let words = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && words.contains("1 passed"), "{words}");
}

/// Returns true in such a namespace: nothing may be sent elsewhere.
fn check_namespace() {
    let devices = std::fs::read_to_string("/proc/self/net/dev").unwrap();
    let names: Vec<_> = devices.lines().skip(2).filter_map(|line| line.split(':').next()).collect();
    assert_eq!(names.iter().map(|name| name.trim()).collect::<Vec<_>>(), ["lo"]);
}

fn bus_of(group: &str) -> String {
    format!("udp:{group}")
}

/// A frame of every kind that can be sent.
fn frames() -> [Frame; 4] {
    let mut fd = Frame::fd(0x1ABC_DEF0, &[0x5A; 32], 0);
    fd.error_state = true;
    [
        Frame::new(CanId::Standard(0x123), &[1, 2, 3]),
        Frame::classic(0x0201_5402, &[]),
        Frame::remote(CanId::Standard(0x123), 4),
        fd,
    ]
}

/// Returns the frame as it is received from a port.
fn heard(frame: Frame, like: &Frame) -> Frame {
    frame.with_time(like.time).with_bus(BusIndex(3))
}

// --- python-can -----------------------------------------------------------------------------

const SCRIPT: &str = r#"
import can, sys
bus = can.Bus(interface="udp_multicast", channel=sys.argv[1], fd=True)
print("ready", flush=True)
M = can.Message
own = [
    M(arbitration_id=0x456, is_extended_id=False, data=[1, 2, 3]),
    M(arbitration_id=0x12345678, data=[]),
    M(arbitration_id=0x456, is_extended_id=False, is_remote_frame=True, dlc=4),
    M(arbitration_id=0x24, is_error_frame=True, data=range(8)),
    M(arbitration_id=0x1ABCDEF1, is_fd=True, bitrate_switch=True, data=[0x5A] * 32),
    M(arbitration_id=0x1ABCDEF1, is_fd=True, error_state_indicator=True, data=[1]),
]
sys.stdin.readline()
for message in own:
    bus.send(message)
while True:
    m = bus.recv()
    if any(m.arbitration_id == message.arbitration_id for message in own):
        continue
    print(hex(m.arbitration_id), m.is_extended_id, m.is_remote_frame, m.is_error_frame, m.is_fd,
          m.bitrate_switch, m.error_state_indicator, m.dlc, bytes(m.data).hex(),
          1e9 < m.timestamp < 1e10, flush=True)
"#;

fn python_can(group: &str) -> Option<Peer> {
    let mut peer = Python::with(&PACKAGES)?.start(SCRIPT, &[group]);
    assert_eq!(peer.read_line(), "ready");
    Some(peer)
}

fn talks_to_python_can(group: &str) {
    check_namespace();
    let Some(mut python) = python_can(group) else { return };
    let mut bus = OpenBus::open(&bus_of(group));
    bus.wait_for_link(Link::Up);

    python.write_line("go");
    let mut plain_fd = Frame::fd(0x1ABC_DEF1, &[1], 0);
    (plain_fd.bit_rate_switch, plain_fd.error_state) = (false, true);
    let theirs = [
        Frame::new(CanId::Standard(0x456), &[1, 2, 3]),
        Frame::classic(0x1234_5678, &[]),
        Frame::remote(CanId::Standard(0x456), 4),
        Frame::error(0x24, &[0, 1, 2, 3, 4, 5, 6, 7]),
        Frame::fd(0x1ABC_DEF1, &[0x5A; 32], 0),
        plain_fd,
    ];
    let came = bus.wait_for_frames(theirs.len()).to_vec();
    for (came, sent) in came.iter().zip(theirs) {
        assert_eq!(*came, heard(sent, came), "as python-can sent it, and not ours");
    }

    for frame in frames() {
        bus.send(&frame);
    }
    for line in [
        "0x123 False False False False False False 3 010203 True",
        "0x2015402 True False False False False False 0  True",
        "0x123 False True False False False False 4  True",
        "0x1abcdef0 True False False True True True 32 5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a True",
    ] {
        assert_eq!(python.read_line(), line);
    }
    let ours = bus.wait_for_frames(theirs.len() + 4)[theirs.len()..].to_vec();
    for (came, sent) in ours.iter().zip(frames()) {
        assert_eq!(*came, heard(sent.with_tx(), came), "it comes back as ours");
    }
    assert_eq!(bus.status().unreadable, 0);
}

#[test]
fn python_can_exchanges_frames_over_ipv4_and_ipv6() {
    // Created here, where a package index is available.
    if Python::with(&PACKAGES).is_some() {
        in_namespace("python_can_peer_over_ipv4");
        in_namespace("python_can_peer_over_ipv6");
    }
}

#[test]
#[ignore = "run by another test"]
fn python_can_peer_over_ipv4() {
    talks_to_python_can(V4);
}

#[test]
#[ignore = "run by another test"]
fn python_can_peer_over_ipv6() {
    talks_to_python_can(V6);
}

// --- several instances of descan ------------------------------------------------------------

#[test]
fn same_host_peers_keep_own_frames_apart() {
    in_namespace("same_host_peers");
}

#[test]
#[ignore = "run by another test"]
fn same_host_peers() {
    check_namespace();
    for spec in [bus_of(V4), format!("udp:{V4}%lo"), "udp:".to_owned(), "udp:%lo@4000".to_owned()] {
        let mut one = OpenBus::open(&spec);
        let mut other = OpenBus::open(&spec);
        let mut quiet = OpenBus::listen(&spec);
        for bus in [&mut one, &mut other, &mut quiet] {
            bus.wait_for_link(Link::Up);
        }
        for number in 0..100 {
            // Both send the same frame: only the sender differs.
            let frame = Frame::classic(number, &[7]);
            one.send(&frame);
            other.send(&frame);
        }
        for (bus, own) in [(&mut one, 100), (&mut other, 100), (&mut quiet, 0)] {
            let frames = bus.wait_for_frames(200);
            assert_eq!(frames.iter().filter(|frame| frame.is_tx).count(), own, "{spec}");
            assert!(frames.is_sorted_by_key(|frame| frame.time));
        }
        let frame = Frame::classic(1, &[]);
        assert_eq!(quiet.port.transmit(&frame), Err(TransmitError::ListenOnly));
    }
}

#[test]
fn other_groups_and_ports_are_ignored() {
    in_namespace("groups_and_ports");
}

#[test]
#[ignore = "run by another test"]
fn groups_and_ports() {
    check_namespace();
    let specs = [bus_of(V4), "udp:239.74.163.3".to_owned(), format!("udp:{V4}@43114")];
    let mut buses: Vec<_> = specs.iter().map(|spec| OpenBus::open(spec)).collect();
    for (number, bus) in buses.iter_mut().enumerate() {
        bus.wait_for_link(Link::Up);
        bus.send(&Frame::classic(number as u32, &[]));
    }
    for (number, bus) in buses.iter_mut().enumerate() {
        bus.wait_for_frames(1);
        assert_eq!(bus.frames[0].platform_id(), Some(number as u32));
    }
}

// --- errors ---------------------------------------------------------------------------------

#[test]
fn malformed_datagrams_are_counted() {
    in_namespace("malformed_datagrams");
}

#[test]
#[ignore = "run by another test"]
fn malformed_datagrams() {
    check_namespace();
    let mut bus = OpenBus::open(&bus_of(V4));
    bus.wait_for_link(Link::Up);
    let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
    let group: SocketAddr = format!("{V4}:43113").parse().unwrap();
    let long = vec![0; 60_000];
    let odd: [&[u8]; 7] = [
        b"",
        b"\xc1",
        b"not msgpack at all",
        b"\x81\xa3dlc\x02",
        b"\xdf\xff\xff\xff\xff",
        &[0x91; 2_000],
        &long,
    ];
    for datagram in odd {
        stranger.send_to(datagram, group).unwrap();
    }
    bus.send(&Frame::classic(1, &[]));
    bus.wait_for_frames(1);
    let status = bus.wait_for_status("the count", |status| status.unreadable == 7);
    assert!(status.note.is_some_and(|note| note.contains("not python-can frames")));
    assert_eq!((status.link, bus.frames.len()), (Link::Up, 1));
}

#[test]
fn lost_network_is_waited_for() {
    in_namespace("lost_network");
}

#[test]
#[ignore = "run by another test"]
fn lost_network() {
    check_namespace();
    for spec in [bus_of(V4), bus_of(V6)] {
        let mut bus = OpenBus::open(&spec);
        bus.wait_for_link(Link::Up);
        let away = "ip link set lo down; ip -6 route flush table local";
        Command::new("sh").args(["-c", away]).status().unwrap();
        let status = bus.wait_for_link(Link::Unplugged);
        let message = status.fault.unwrap().to_string();
        assert!(message.contains("no route to") && message.contains("ip route add"));
        bus.send(&Frame::classic(1, &[]));
        bus.wait_for_status("the refusal", |status| status.transmit_failures == 1);
        assert!(Command::new("sh").args(["-c", NETWORK]).status().unwrap().success());
        bus.wait_for_link(Link::Up);
        bus.send(&Frame::classic(2, &[]));
        let frames = bus.wait_for_frames(1);
        assert_eq!((frames[0].platform_id(), frames[0].is_tx), (Some(2), true));
    }
    let mut bus = OpenBus::open(&format!("udp:{V4}%eth7"));
    let status = bus.wait_for_link(Link::Down);
    assert!(status.fault.unwrap().to_string().contains("eth7 not found"));
    // One group per link.
    let mut bus = OpenBus::open("udp:ff02::1");
    let message = bus.wait_for_link(Link::Down).fault.unwrap().to_string();
    assert!(message.contains("udp:ff02::1%eth0"), "{message}");
}

#[test]
fn missing_loopback_names_the_route_command() {
    in_namespace("missing_loopback");
}

#[test]
#[ignore = "run by another test"]
fn missing_loopback() {
    check_namespace();
    // The group is joined at lo, and packets to it are sent elsewhere.
    let elsewhere = "ip link add descan0 type veth peer name descan1 && ip link set descan1 up && \
                     ip link set descan0 up multicast on && ip addr add 10.77.0.1/24 dev descan0 && \
                     ip rule add to 239.0.0.0/8 ipproto udp lookup 77 && \
                     ip route add 239.0.0.0/8 dev descan0 table 77";
    assert!(Command::new("sh").args(["-c", elsewhere]).status().unwrap().success());
    let arguments = ["scan", "udp:239.74.163.2", "--time", "4", "--file", "/nowhere/des.json"];
    let output = Command::new(env!("CARGO_BIN_EXE_descan")).args(arguments).output().unwrap();
    let words = String::from_utf8(output.stderr).unwrap();
    assert!(words.contains("ip route get 239.74.163.2"), "{words}");
    assert!(!words.contains("terminated"), "{words}");
}

// --- the program ----------------------------------------------------------------------------

struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn simulated_devices_are_found_by_scan() {
    in_namespace("simulated_devices");
}

#[test]
#[ignore = "run by another test"]
fn simulated_devices() {
    check_namespace();
    let folder = tempfile::tempdir().unwrap();
    let descan = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
        command.args(arguments).current_dir(folder.path()).stdin(Stdio::null());
        command.env("XDG_CONFIG_HOME", folder.path().join("config"));
        command
    };
    let sim = descan(&["sim", "udp:"]).stderr(Stdio::null()).spawn().unwrap();
    let _sim = Running(sim);
    let output = descan(&["scan", "udp:", "--json"]).output().unwrap();
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let devices = report["devices"].as_array().unwrap();
    let feed = devices.iter().find(|device| device["name"] == "FEED").expect("FEED is there");
    assert_eq!((&feed["address"], &feed["services"][0]["name"]), (&10.into(), &"DES".into()));
}

#[test]
fn device_in_another_process_is_proved() {
    in_namespace("proved_device");
}

#[test]
#[ignore = "run by another test"]
fn proved_device() {
    check_namespace();
    let folder = tempfile::tempdir().unwrap();
    // Heartbeats ten times as fast as the document says: the tests are over sooner.
    let profile = "[services]\nheartbeat = 0x001\ndes = 0x002\n\
                   [heartbeat]\nperiod_ms = 100\nuid_offset = 0\nmode_offset = 6\n";
    std::fs::write(folder.path().join("profile.toml"), profile).unwrap();
    let descan = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
        command.args(arguments).args(["--profile", "profile.toml"]);
        command.current_dir(folder.path()).stdin(Stdio::null());
        command.env("XDG_CONFIG_HOME", folder.path().join("config"));
        command
    };
    let device =
        ["sim", "udp:", "--device", "FEED", "--services", "AUGER=2.1", "--node-address", "10"];
    let sim = descan(&device).stderr(Stdio::null()).spawn().unwrap();
    let _sim = Running(sim);
    let output = descan(&["prove", "udp:", "FEED", "--json"]).output().unwrap();
    let words = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{words}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["broken"], 0, "{report:#}");
    let rules = report["devices"][0]["rules"].as_array().unwrap();
    for wanted in [
        "heartbeat-interval",
        "answers-name-request",
        "answers-services-request",
        "transfer-framing",
        "st-min",
        "flow-overflow",
        "survives-endless-requests",
    ] {
        let rule = rules.iter().find(|rule| rule["rule"] == wanted).unwrap();
        assert_eq!(rule["verdict"], "kept", "{rule:#}");
    }
}

#[test]
fn request_to_another_process_is_answered_in_several_frames() {
    in_namespace("composed_request");
}

#[test]
#[ignore = "run by another test"]
fn composed_request() {
    check_namespace();
    let folder = tempfile::tempdir().unwrap();
    let descan = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
        command.args(arguments).current_dir(folder.path()).stdin(Stdio::null());
        command.env("XDG_CONFIG_HOME", folder.path().join("config"));
        command
    };
    let sim = descan(&["sim", "udp:"]).stderr(Stdio::null()).spawn().unwrap();
    let _sim = Running(sim);
    let words = ["send", "udp:", "request", "des", "services", "to", "FEED", "--yes"];
    let output = descan(&words).output().unwrap();
    let words = String::from_utf8_lossy(&output.stdout);
    assert!(words.contains("5 services: DES 1.0, CFG 1.3, AUGER 2.1"), "{words}");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
}

// --- devices in other processes --------------------------------------------------------------

#[test]
fn simulated_device_of_a_shell_is_found_and_takes_commands() {
    in_namespace("device_of_a_shell");
}

#[test]
#[ignore = "called by simulated_device_of_a_shell_is_found_and_takes_commands"]
fn device_of_a_shell() {
    check_namespace();
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("p.toml"), "commands.mode = 0x019\n").unwrap();
    let descan = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
        command.args(arguments).current_dir(folder.path()).stdin(Stdio::null());
        command
    };
    let bus = bus_of(V4);
    let simulate = |more: &[&str]| {
        let arguments = [&["sim", &bus, "--time", "60"][..], more].concat();
        descan(&arguments).stderr(Stdio::null()).spawn().expect("the program starts")
    };
    let feed = ["--device", "FEED", "--services", "AUGER=2.1,MOTOR", "--node-address", "10"];
    let devices: [Child; 2] = [simulate(&feed), simulate(&["--device", "SENS"])];
    let scan = descan(&["scan", &bus, "--json", "--expect", "2", "--time", "30"]).output().unwrap();
    let report: serde_json::Value = serde_json::from_slice(&scan.stdout).unwrap();
    let found = &report["devices"][0];
    let mode = descan(&["mode", &bus, "FEED", "CFG", "--profile", "p.toml", "--yes"]).output();
    let mode = mode.unwrap();
    for mut device in devices {
        device.kill().unwrap();
        device.wait().unwrap();
    }
    assert_eq!((scan.status.code(), &found["name"]), (Some(0), &"FEED".into()), "{report}");
    assert_eq!(found["address"], 10);
    let services = found["services"].as_array().unwrap();
    let text = |value: &serde_json::Value| value.as_str().unwrap().to_owned();
    let services: Vec<_> =
        services.iter().map(|it| text(&it["name"]) + " " + &text(&it["version"])).collect();
    assert_eq!(services, ["DES 1.0", "AUGER 2.1", "MOTOR "]);
    let told = String::from_utf8(mode.stdout).unwrap();
    assert!(told.ends_with("#02): the device responded\n"), "{told}");
}
