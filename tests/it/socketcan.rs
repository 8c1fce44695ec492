//! SocketCAN on a real kernel, with independent peers: can-utils and the kernel's own ISO-TP.

use crate::common::can;
use crate::common::can::{PATIENCE, Peer, Vcan, controllers, listeners, run, wait_for_listeners};
use crate::common::serial;
use descan::bus::{self, BusSpec, Clock, Options, Port, TransmitError};
use descan::error_report::ErrorReport;
use descan::frame::{BusIndex, CanId, Frame, FrameKind};
use descan::log::candump::{parse_frame, parse_line};
use descan::shell::recorder::{Recorder, Target};
use descan::status::{BusState, BusStatus, Link};
use descan::time::{Duration, Instant};
use descan::wire::isotp::{
    FlowControl, FlowStatus, Pci, Reassembly, ReassemblyProgress, Segmenter,
};
use std::sync::Mutex;
use std::time::Instant as Monotonic;

/// An open port with everything received from it so far, and waits with a timeout.
struct Bus {
    port: Port,
    clock: Clock,
    frames: Vec<Frame>,
    runtime: tokio::runtime::Runtime,
}

impl Bus {
    fn open(interface: &str) -> Self {
        Self::open_with(interface, Options::default())
    }

    fn open_with(interface: &str, options: Options) -> Self {
        let clock = Clock::start();
        let spec = BusSpec::SocketCan(interface.into());
        let port = bus::open(&spec, BusIndex(3), clock.clone(), options).expect("a port");
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        Self { port, clock, frames: Vec::new(), runtime }
    }

    fn status(&self) -> BusStatus {
        self.port.queue().status()
    }

    /// Receives until `condition` holds.
    fn wait_until(&mut self, what: &str, mut condition: impl FnMut(&mut Self) -> bool) {
        let deadline = Monotonic::now() + PATIENCE;
        loop {
            self.port.queue().drain(&mut self.frames, usize::MAX);
            self.port.queue().take_status();
            if condition(self) {
                return;
            }
            let left = deadline.saturating_duration_since(Monotonic::now());
            assert!(!left.is_zero(), "waited in vain for {what}: {:?}", self.status());
            let ready = self.port.queue().ready();
            let _ = self.runtime.block_on(async { tokio::time::timeout(left, ready).await });
        }
    }

    fn wait_for_frames(&mut self, count: usize) -> &[Frame] {
        self.wait_until(&format!("{count} frames"), |bus| bus.frames.len() >= count);
        &self.frames
    }

    fn wait_for_link(&mut self, link: Link) -> BusStatus {
        self.wait_until(&format!("{link:?}"), |bus| bus.status().link == link);
        self.status()
    }

    fn transmit(&mut self, frame: &Frame) {
        self.wait_until("room in the outbox", |bus| match bus.port.transmit(frame) {
            Ok(()) => true,
            Err(TransmitError::Full) => false,
            Err(error) => panic!("{error}"),
        });
    }
}

fn count(frames: &[Frame], wanted: impl Fn(&Frame) -> bool) -> usize {
    frames.iter().filter(|frame| wanted(frame)).count()
}

#[test]
fn missing_interface_is_a_status_with_a_remedy() {
    let bus = Bus::open("vcan-nowhere");
    let status = bus.status();
    assert_eq!((status.link, status.state), (Link::Missing, BusState::Down));
    let message = status.fault.unwrap().to_string();
    assert!(message.contains("ip link add vcan-nowhere type vcan"), "{message}");
}

#[test]
fn non_can_interface_is_reported() {
    if !std::path::Path::new("/sys/class/net/lo").exists() {
        return can::skip("no lo here");
    }
    let status = Bus::open("lo").status();
    assert_eq!(status.link, Link::NotCan);
    assert_eq!(status.fault.unwrap().to_string(), "lo is not a CAN interface");
}

#[test]
fn frames_of_every_kind_are_received() {
    let Some(vcan) = Vcan::new("ds-kinds") else { return };
    let mut bus = Bus::open(vcan.name());
    assert_eq!(bus.status().link, Link::Up);
    assert!(bus.status().fd);
    let texts = [
        "02015402#0444455301",
        "7FF#",
        "123#R4",
        "00000123#R",
        "12345678##0AABBCC",
        "123##3000102030405060708090A0B",
        "20000024#0001000000000000",
    ];
    for text in texts {
        run("cansend", &[vcan.name(), text]);
    }
    let frames = bus.wait_for_frames(texts.len());
    for (frame, text) in frames.iter().zip(texts) {
        let sent =
            parse_frame(text.as_bytes()).unwrap().with_time(frame.time).with_bus(BusIndex(3));
        assert_eq!(*frame, sent);
    }
}

#[test]
fn sent_frames_are_read_by_candump() {
    let Some(vcan) = Vcan::new("ds-sends") else { return };
    let mut bus = Bus::open(vcan.name());
    let mut fd = Frame::fd(0x1ABC_DEF0, &[0x5A; 33], 0xCC);
    fd.error_state = true;
    let frames = [
        Frame::classic(0x0201_5402, &[4, 0x44, 0x45, 0x53, 1]),
        Frame::new(CanId::Standard(0x123), &[1, 2, 3]),
        Frame::remote(CanId::Extended(0x123), 5),
        fd,
    ];
    let candump = Peer::start("candump", &["-L", "-n", "4", vcan.name()]);
    wait_for_listeners(vcan.name(), "raw", 2);
    for frame in &frames {
        bus.transmit(frame);
    }
    let seen = candump.finish();
    let seen: Vec<_> =
        seen.lines().map(|line| parse_line(line.as_bytes()).unwrap().unwrap()).collect();
    for (seen, sent) in seen.iter().zip(&frames) {
        assert_eq!(seen.frame, *sent);
    }

    // Own frames are received back marked as tx, with the time stamps that candump printed.
    let echoes = bus.wait_for_frames(frames.len()).to_vec();
    for (echo, (seen, sent)) in echoes.iter().zip(seen.iter().zip(frames)) {
        assert_eq!(*echo, sent.with_tx().with_time(echo.time).with_bus(BusIndex(3)));
        let dated = bus.clock.epoch().unix_micros(echo.time);
        assert!(dated.abs_diff(seen.time.micros) < 1_000_000, "{dated} {}", seen.time.micros);
    }
    bus.wait_until("confirmation", |bus| bus.status().unconfirmed == 0);
}

#[test]
fn canplayer_plays_recorded_files() {
    let Some(vcan) = Vcan::new("ds-plays") else { return };
    let mut fd = Frame::fd(0x1ABC_DEF0, &[0x5A; 32], 0);
    fd.error_state = true;
    let frames = [
        Frame::classic(0x0201_5402, &[4, 0x44, 0x45, 0x53, 1]).with_tx(),
        Frame::new(CanId::Standard(0x123), &[1, 2, 3]),
        Frame::remote(CanId::Extended(0x123), 5),
        fd,
    ];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.log");
    let recorder = Recorder::create(&Target { path: path.clone(), max_bytes: None }).unwrap();
    recorder.set_epoch(Clock::start().epoch());
    recorder.name_bus(BusIndex(0), "can7");
    recorder.record(&frames);
    assert_eq!(recorder.finish().frames, 4);
    let candump = Peer::start("candump", &["-L", "-n", "4", vcan.name()]);
    wait_for_listeners(vcan.name(), "raw", 1);
    let mapping = format!("{}=can7", vcan.name());
    run("canplayer", &["-I", path.to_str().unwrap(), &mapping]);
    let seen = candump.finish();
    let seen: Vec<_> =
        seen.lines().map(|line| parse_line(line.as_bytes()).unwrap().unwrap().frame).collect();
    // In the log, descan's own frames count as received.
    let played = frames.map(|mut frame| {
        frame.is_tx = false;
        frame
    });
    assert_eq!(seen, played);
}

#[test]
fn equal_foreign_frames_are_not_marked_tx() {
    let Some(vcan) = Vcan::new("ds-ours") else { return };
    let mut bus = Bus::open(vcan.name());
    let cangen =
        ["-g", "0", "-n", "2000", "-e", "-I", "00000123", "-L", "2", "-D", "AABB", vcan.name()];
    let cangen = Peer::start("cangen", &cangen);
    for _ in 0..500 {
        bus.transmit(&Frame::classic(0x123, &[0xAA, 0xBB]));
    }
    cangen.finish();
    let frames = bus.wait_for_frames(2500);
    assert!(frames.iter().all(|frame| frame.same_on_wire(&frames[0])));
    assert_eq!(count(frames, |frame| frame.is_tx), 500);
    assert_eq!(frames.len(), 2500);
}

#[test]
fn frame_times_are_ordered_and_not_in_the_future() {
    let Some(vcan) = Vcan::new("ds-times") else { return };
    let mut bus = Bus::open(vcan.name());
    let mut before = bus.clock.now();
    for id in 0..5 {
        run("cansend", &[vcan.name(), &format!("{id:03X}#")]);
        let after = bus.clock.now();
        let frame = bus.wait_for_frames(id + 1)[id];
        assert!(frame.time >= before && frame.time <= after, "{before} {} {after}", frame.time);
        before = frame.time;
    }
    run("cangen", &["-g", "0", "-n", "5000", vcan.name()]);
    let frames = bus.wait_for_frames(5005);
    assert!(frames.is_sorted_by_key(|frame| frame.time));
}

/// More than the receive queue and the kernel receive buffer hold.
const FLOOD: usize = 40_000;

/// Serializes floods: one of them stops the whole program.
static FLOODS: Mutex<()> = Mutex::new(());

/// Waits until every frame of a flood is received or counted as lost; returns the status then.
fn account_for_flood(bus: &mut Bus) -> BusStatus {
    let lost = |status: &BusStatus| (status.kernel_drops + status.queue_drops) as usize;
    // No later frame reports the frames lost at the end.
    bus.wait_until("the flood", |bus| bus.frames.len() + lost(&bus.status()) >= FLOOD);
    let status = bus.status();
    assert_eq!(bus.frames.len() + lost(&status), FLOOD, "{status:?}");
    status
}

#[test]
fn unread_flood_is_counted_exactly() {
    let _alone = FLOODS.lock();
    let Some(vcan) = Vcan::new("ds-flood") else { return };
    let mut bus = Bus::open(vcan.name());
    run("cangen", &["-g", "0", "-n", &FLOOD.to_string(), vcan.name()]);
    can::wait_until("a full queue", || bus.status().queue_drops > 0);
    account_for_flood(&mut bus);
}

#[test]
fn flood_while_stopped_is_counted_exactly() {
    let _alone = FLOODS.lock();
    let Some(vcan) = Vcan::new("ds-stopped") else { return };
    let mut bus = Bus::open(vcan.name());
    let (us, name) = (std::process::id(), vcan.name());
    let flood = format!("kill -STOP {us}; cangen -g 0 -n {FLOOD} {name}; kill -CONT {us}");
    run("sh", &["-c", &flood]);
    let status = account_for_flood(&mut bus);
    assert!(status.kernel_drops > 0, "{status:?}");
}

#[test]
fn interface_that_returns_is_used_again() {
    let Some(vcan) = Vcan::new("ds-down") else { return };
    let mut bus = Bus::open(vcan.name());
    vcan.down();
    let status = bus.wait_for_link(Link::Down);
    assert_eq!(status.state, BusState::Down);
    let message = status.fault.unwrap().to_string();
    assert_eq!(message, "ds-down is down; sudo ip link set ds-down up");

    bus.transmit(&Frame::classic(1, &[]));
    bus.wait_until("a counted failure", |bus| bus.status().transmit_failures == 1);

    vcan.up();
    let status = bus.wait_for_link(Link::Up);
    assert_eq!((status.state, status.fault), (BusState::Unknown, None));
    run("cansend", &[vcan.name(), "123#01"]);
    bus.wait_for_frames(1);
    bus.transmit(&Frame::classic(1, &[]));
    assert!(bus.wait_for_frames(2)[1].is_tx);
}

#[test]
fn renamed_interface_is_followed() {
    let Some(vcan) = Vcan::new("ds-named") else { return };
    let _renamed = Vcan::later("ds-renamed");
    let mut bus = Bus::open(vcan.name());
    vcan.down();
    bus.wait_for_link(Link::Down);
    vcan.rename("ds-renamed");
    bus.wait_until("the new name", |bus| bus.status().renamed.as_deref() == Some("ds-renamed"));
    // The suggested command uses the current name.
    let message = bus.status().fault.unwrap().to_string();
    assert_eq!(message, "ds-renamed is down; sudo ip link set ds-renamed up");
    run("ip", &["link", "set", "ds-renamed", "up"]);
    bus.wait_for_link(Link::Up);
    run("cansend", &["ds-renamed", "123#01"]);
    bus.wait_for_frames(1);

    // The interface is removed: descan waits for the requested name, not the intermediate one.
    run("ip", &["link", "del", "ds-renamed"]);
    let status = bus.wait_for_link(Link::Unplugged);
    assert_eq!(status.renamed, None);
    assert!(status.fault.unwrap().to_string().contains("ds-named unplugged"));
    vcan.create().unwrap();
    bus.wait_for_link(Link::Up);
    run("cansend", &["ds-named", "123#02"]);
    bus.wait_for_frames(2);
}

#[test]
fn unseen_outage_is_counted() {
    let Some(vcan) = Vcan::new("ds-moment") else { return };
    let mut bus = Bus::open(vcan.name());
    let script = "ip link set ds-moment down; ip link set ds-moment up";
    for outages in 1..=5 {
        run("sh", &["-c", script]);
        bus.wait_until("a counted outage", |bus| bus.status().outages == outages);
        bus.wait_for_link(Link::Up);
    }
    vcan.remove();
    vcan.create().unwrap();
    bus.wait_until("a counted outage", |bus| bus.status().outages == 6);
}

#[test]
fn bus_off_report_is_counted() {
    let Some(vcan) = Vcan::new("ds-off") else { return };
    let mut bus = Bus::open(vcan.name());
    run("cansend", &[vcan.name(), "20000040#0000000000000000"]);
    bus.wait_until("a counted bus-off", |bus| bus.status().bus_offs == 1);
    run("cansend", &[vcan.name(), "20000100#0000000000000000"]);
    bus.wait_for_frames(2);
    assert_eq!((bus.status().bus_offs, bus.status().outages), (1, 0));
}

#[test]
fn unreported_errors_note_names_the_command() {
    let Some(_taken) = controllers() else { return };
    let mut bus = Bus::open("can0");
    assert_eq!(bus.status().note, None);
    run("ip", &["link", "set", "can0", "down"]);
    run("ip", &["link", "set", "can0", "up", "type", "can", "berr-reporting", "off"]);
    bus.wait_until("a note", |bus| bus.status().note.is_some());
    let note = bus.status().note.unwrap();
    let (_, command) = note.split_once(": ").unwrap();
    run("sh", &["-c", &command.replace("sudo ", "")]);
    bus.wait_until("no note", |bus| bus.status().note.is_none() && bus.status().link == Link::Up);
    assert_eq!((bus.status().bitrate, bus.status().fault), (Some(125_000), None));
}

#[test]
fn settings_changed_while_open_are_seen() {
    let Some(_taken) = controllers() else { return };
    let mut bus = Bus::open("can0");
    assert_eq!((bus.status().bitrate, bus.status().restart_ms), (Some(125_000), Some(0)));
    let set = |bitrate: &str, restart_ms: &str, listen_only: &str| {
        let settings = ["bitrate", bitrate, "restart-ms", restart_ms, "listen-only", listen_only];
        run("ip", &["link", "set", "can0", "down"]);
        run("ip", &[&["link", "set", "can0", "up", "type", "can"], &settings[..]].concat());
    };
    set("250000", "100", "on");
    bus.wait_until("the new settings", |bus| {
        let status = bus.status();
        (status.link, status.bitrate, status.restart_ms, status.listen_only)
            == (Link::Up, Some(250_000), Some(100), true)
    });
    set("125000", "0", "off");
    bus.wait_until("the old settings", |bus| {
        let status = bus.status();
        (status.link, status.bitrate, status.restart_ms, status.listen_only)
            == (Link::Up, Some(125_000), Some(0), false)
    });
    run("cansend", &["can1", "123#01"]);
    bus.wait_for_frames(1);
}

#[test]
fn receive_buffer_has_the_allowed_maximum() {
    let Some(vcan) = Vcan::new("ds-buffer") else { return };
    // The kernel doubles the requested size; root gets all of it.
    assert_eq!(Bus::open(vcan.name()).status().receive_buffer, Some(2 * (8 << 20)));
}

#[test]
fn interface_down_at_open_is_waited_for() {
    let Some(vcan) = Vcan::new("ds-asleep") else { return };
    vcan.down();
    let mut bus = Bus::open(vcan.name());
    assert_eq!(bus.status().link, Link::Down);
    vcan.up();
    bus.wait_for_link(Link::Up);
    run("cansend", &[vcan.name(), "123#01"]);
    bus.wait_for_frames(1);
}

#[test]
fn interface_plugged_in_later_is_used() {
    let Some(vcan) = Vcan::later("ds-later") else { return };
    let mut bus = Bus::open(vcan.name());
    assert_eq!(bus.status().link, Link::Missing);
    for round in 1..=2 {
        vcan.create().unwrap();
        bus.wait_for_link(Link::Up);
        run("cansend", &[vcan.name(), "123#01"]);
        bus.wait_for_frames(round);
        vcan.remove();
        let status = bus.wait_for_link(Link::Unplugged);
        assert!(status.fault.unwrap().to_string().contains("ds-later unplugged"));
    }
}

#[test]
fn listen_only_sends_nothing() {
    let Some(vcan) = Vcan::new("ds-listen") else { return };
    let mut bus = Bus::open_with(vcan.name(), Options { listen_only: true, ..Options::default() });
    let refused = bus.port.transmit(&Frame::classic(1, &[]));
    assert_eq!(refused, Err(TransmitError::ListenOnly));
    run("cansend", &[vcan.name(), "123#01"]);
    assert!(!bus.wait_for_frames(1)[0].is_tx);
}

#[test]
fn close_is_prompt_and_leaves_no_socket() {
    let Some(vcan) = Vcan::new("ds-close") else { return };
    let bus = Bus::open(vcan.name());
    wait_for_listeners(vcan.name(), "raw", 1);
    let before = Monotonic::now();
    drop(bus);
    assert!(before.elapsed() < PATIENCE / 2);
    // A child started by another test may hold a copy of the socket until it executes.
    can::wait_until("its socket to be closed", || listeners(vcan.name(), "raw") == 0);
}

#[test]
fn netlink_describes_a_real_controller() {
    let Some(_taken) = controllers() else { return };
    let mut bus = Bus::open("can0");
    let status = bus.status();
    assert_eq!((status.link, status.state), (Link::Up, BusState::ErrorActive));
    assert_eq!((status.bitrate, status.data_bitrate, status.fd), (Some(125_000), None, false));
    assert_eq!((status.tec, status.rec, status.restart_ms), (Some(0), Some(0), Some(0)));
    assert_eq!((status.listen_only, status.fault), (false, None));

    let can1 = bus::interfaces().into_iter().find(|it| it.name == "can1").expect("can1");
    assert_eq!((can1.up, can1.is_virtual, can1.bitrate), (true, false, Some(125_000)));

    run("cansend", &["can1", "02015402#0444455301"]);
    let frame = bus.wait_for_frames(1)[0];
    assert!(frame.same_on_wire(&Frame::classic(0x0201_5402, &[4, 0x44, 0x45, 0x53, 1])));
    assert!(!frame.is_tx);
}

#[test]
fn full_transmit_queue_loses_no_frame() {
    const COUNT: u32 = 1000;
    let Some(_taken) = controllers() else { return };
    let mut bus = Bus::open("can0");
    let mut other = Bus::open("can1");
    for id in 0..COUNT {
        bus.transmit(&Frame::classic(id, &id.to_be_bytes()));
    }
    let is_ours = |frame: &Frame| frame.is_tx;
    bus.wait_until("confirmation", |bus| count(&bus.frames, is_ours) == COUNT as usize);
    let ids: Vec<_> = bus.frames.iter().filter_map(Frame::platform_id).collect();
    assert_eq!(ids, (0..COUNT).collect::<Vec<_>>());
    let status = bus.status();
    assert_eq!((status.transmit_failures, status.unconfirmed), (0, 0));

    // The emulated bus has no bit rate and can overrun the other controller: frames may be lost.
    other.wait_until("the last frame", |other| {
        other.frames.iter().any(|frame| frame.platform_id() == Some(COUNT - 1))
            || other.status().controller_overruns > 0
    });
    assert!(other.frames.iter().filter_map(Frame::platform_id).is_sorted());
    assert!(!other.frames.iter().any(is_ours));
}

#[test]
fn stuck_transmit_queue_is_reported_until_it_drains() {
    const COUNT: u32 = 60;
    let Some(_taken) = controllers() else { return };
    // The kernel's own slcan, with an adapter that rejects frames: they stay in its queue.
    let mut adapter = serial::Pty::new();
    run("slcan_attach", &["-n", "stuck0", adapter.path().to_str().unwrap()]);
    run("ip", &["link", "set", "stuck0", "up", "txqueuelen", "5"]);
    let mut bus = Bus::open("stuck0");
    for id in 0..COUNT {
        bus.transmit(&Frame::classic(id, &[]));
    }
    bus.wait_until("a full queue", |bus| bus.status().is_transmit_queue_full);
    assert!(bus.status().transmit_failures > 0);

    let last = format!("T{:08X}0", COUNT - 1);
    let mut taken = 1;
    while adapter.read_line().expect("the last frame") != last {
        taken += 1;
    }
    bus.wait_until("room", |bus| !bus.status().is_transmit_queue_full);
    let failures = bus.status().transmit_failures;
    assert_eq!(taken + failures, u64::from(COUNT), "each is sent or counted");
    run("slcan_attach", &["-d", adapter.path().to_str().unwrap()]);
}

#[test]
fn bus_off_and_recovery_are_reported() {
    let Some(_taken) = controllers() else { return };
    let mut adapter = serial::Pty::new();
    let path = adapter.path();
    run("slcan_attach", &["-n", "leaves0", path.to_str().unwrap()]);
    run("ip", &["link", "set", "leaves0", "up"]);
    let mut bus = Bus::open("leaves0");
    assert_eq!(bus.status().state, BusState::ErrorActive);
    // The controller state and counters sent by an adapter are the kernel's own state.
    adapter.write(b"sb000255\r");
    bus.wait_until("bus-off", |bus| bus.status().state == BusState::BusOff);
    bus.wait_until("it counted", |bus| bus.status().bus_offs == 1);
    let status = bus.status();
    assert_eq!(status.link, Link::Up);
    let message = status.fault.unwrap().to_string();
    assert!(
        message.contains(
            "leaves0 is bus-off; check wiring, then sudo ip link set leaves0 type can restart"
        ),
        "{message}"
    );
    bus.wait_until("its error frame", |bus| {
        let reports = bus.frames.iter().filter_map(ErrorReport::of);
        reports.filter(ErrorReport::is_bus_off).count() == 1
    });
    let scan = std::process::Command::new(std::env::var_os("DESCAN_BIN").unwrap())
        .args(["scan", "leaves0"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&scan.stderr);
    assert_eq!(scan.status.code(), Some(3), "{said}");
    assert!(said.contains("leaves0 is bus-off; check wiring"), "{said}");

    run("ip", &["link", "set", "leaves0", "down"]);
    run("ip", &["link", "set", "leaves0", "up"]);
    bus.wait_until("error-active", |bus| {
        (bus.status().link, bus.status().state) == (Link::Up, BusState::ErrorActive)
    });
    assert_eq!(bus.status().fault, None);
    adapter.write(b"t12310A\r");
    bus.wait_until("a frame", |bus| bus.frames.iter().any(|frame| frame.data() == [0x0A]));
    run("slcan_attach", &["-d", path.to_str().unwrap()]);
}

#[test]
fn fd_on_classic_controller_is_a_counted_failure() {
    let Some(_taken) = controllers() else { return };
    let mut bus = Bus::open("can0");
    bus.transmit(&Frame::fd(1, &[0; 12], 0));
    bus.wait_until("a counted failure", |bus| bus.status().transmit_failures == 1);
}

const US: u32 = 0x0001_0203;
const KERNEL: u32 = 0x0002_0304;

/// Formats bytes 00, 01, … as isotpsend expects and isotprecv prints them.
fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X} ")).collect::<Vec<_>>().concat()
}

fn isotp_options<'a>(fd: bool, ids: [&'a str; 2], interface: &'a str) -> Vec<&'a str> {
    let link_layer: &[&str] = if fd { &["-L", "72:64:1"] } else { &[] };
    [&["-s", ids[0], "-d", ids[1]], link_layer, &[interface]].concat()
}

#[test]
fn kernel_reassembles_sent_transfers() {
    let Some(vcan) = Vcan::new("ds-isotp-tx") else { return };
    for (fd, len) in [(false, 7), (false, 8), (false, 300), (false, 4095), (true, 62), (true, 900)]
    {
        let message: Vec<u8> = (0..len).map(|at| at as u8).collect();
        let options = isotp_options(fd, ["00020304", "00010203"], vcan.name());
        let peer = Peer::start("isotprecv", &options);
        wait_for_listeners(vcan.name(), "isotp", 1);

        let mut bus = Bus::open(vcan.name());
        let mut segmenter = Segmenter::new(message.clone(), fd);
        let mut seen = 0;
        bus.wait_until("the transfer", |bus| {
            let now = bus.clock.now();
            for frame in &bus.frames[seen..] {
                if let (Some(KERNEL), Ok(Pci::Flow(flow))) =
                    (frame.platform_id(), Pci::decode(frame.data(), frame.is_fd))
                {
                    segmenter.handle_flow(now, flow).unwrap();
                }
            }
            seen = bus.frames.len();
            // descan's own frames are received back, so frames keep coming until all are sent.
            if let Some(segment) = segmenter.poll(now) {
                bus.port.transmit(&segment.into_frame(US, fd, 0xCC)).unwrap();
            }
            segmenter.is_done()
        });
        assert_eq!(peer.finish().trim(), hex(&message).trim(), "{len} bytes, fd {fd}");
    }
}

#[test]
fn kernel_transfers_are_reassembled() {
    let Some(vcan) = Vcan::new("ds-isotp-rx") else { return };
    for (fd, len, block_size) in [(false, 300, 0), (false, 4095, 4), (true, 900, 2)] {
        let message: Vec<u8> = (0..len).map(|at| (at * 7) as u8).collect();
        let mut bus = Bus::open(vcan.name());
        let options = isotp_options(fd, ["00020304", "00010203"], vcan.name());
        let peer = Peer::start_with_input("isotpsend", &options, &hex(&message));
        let go_on = FlowControl { status: FlowStatus::Continue, block_size, st_min: 0 };
        let mut transfer: Option<Reassembly<Vec<u8>>> = None;
        let mut seen = 0;
        bus.wait_until("the message", |bus| {
            let now = bus.clock.now();
            let mut done = false;
            for frame in &bus.frames[seen..] {
                if frame.platform_id() != Some(KERNEL) || frame.kind != FrameKind::Data {
                    continue;
                }
                let progress = match Pci::decode(frame.data(), frame.is_fd).unwrap() {
                    Pci::First { length, data } => {
                        let (len, buffer) = (frame.len(), vec![0; length as usize]);
                        let first = Reassembly::start(now, length, data, len, block_size, buffer);
                        transfer = Some(first.unwrap());
                        ReassemblyProgress::BlockEnd
                    }
                    Pci::Consecutive { sequence, data } => {
                        transfer.as_mut().unwrap().push(now, sequence, data).unwrap()
                    }
                    other => panic!("{other:?}"),
                };
                match progress {
                    ReassemblyProgress::BlockEnd if fd => {
                        bus.port.transmit(&Frame::fd(US, &go_on.encode(), 0xCC)).unwrap();
                    }
                    ReassemblyProgress::BlockEnd => {
                        bus.port.transmit(&Frame::classic(US, &go_on.encode())).unwrap();
                    }
                    ReassemblyProgress::More => {}
                    ReassemblyProgress::Done => done = true,
                }
            }
            seen = bus.frames.len();
            done
        });
        assert_eq!(transfer.unwrap().message(), message, "{len} bytes, fd {fd}");
        peer.finish();
    }
}

#[test]
fn idle_bus_causes_no_wakeups() {
    let Some(vcan) = Vcan::new("ds-idle") else { return };
    let mut bus = Bus::open(vcan.name());
    run("cansend", &[vcan.name(), "123#01"]);
    bus.wait_for_frames(1);
    bus.port.queue().take_status();
    let news = bus.runtime.block_on(async {
        tokio::time::timeout(Duration::from_secs(3), bus.port.queue().ready()).await
    });
    assert!(news.is_err(), "{:?}", bus.status());
    assert!(bus.frames[0].time > Instant::ZERO);
}
