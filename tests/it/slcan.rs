//! slcan over a pty, with adapters that respond correctly or wrongly, fail and come back.
//!
//! The test itself acts as the adapter: it waits for commands and responds to them or not. A late
//! response comes after further commands, never after a fixed time.

use crate::common::open_bus::{OpenBus, PATIENCE};
use crate::common::processor_time::ticks;
use crate::common::python::Python;
use crate::common::serial::{Bridge, Pty};
use descan::bus::TransmitError;
use descan::diagnostic::Diagnostic;
use descan::frame::{BusIndex, CanId, Frame};
use descan::status::{BusState, Link};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::process::{Child, Command, Stdio};
use std::time::Instant;

/// A simulated adapter at a pty.
struct Adapter {
    pty: Pty,
    /// All commands and frames that it received.
    heard: Vec<String>,
}

impl Adapter {
    fn new() -> Self {
        Self { pty: Pty::new(), heard: Vec::new() }
    }

    fn spec(&self, rates: &str) -> String {
        format!("slcan:{}{rates}", self.pty.path().display())
    }

    /// Waits for the next line that it receives.
    fn hear(&mut self) -> String {
        let Some(line) = self.pty.read_line() else {
            panic!("nothing more is said after {:?}", self.heard);
        };
        self.heard.push(line.clone());
        line
    }

    /// Waits for this line; does not respond to lines before it.
    fn hear_until(&mut self, wanted: &str) {
        while self.hear() != wanted {}
    }

    fn say(&mut self, text: &str) {
        self.pty.write(text.as_bytes());
    }

    /// Responds as Lawicel's adapters do until the channel is open.
    fn be_opened(&mut self) {
        loop {
            match self.hear().as_str() {
                // The channel is already closed.
                "C" => self.say("\x07"),
                "V" => self.say("V1013\r"),
                "N" => self.say("NA123\r"),
                "F" => self.say("F00\r"),
                "O" | "L" => return self.say("\r"),
                _ => self.say("\r"),
            }
        }
    }

    /// Responds to status flag requests until another line is received; returns that line.
    fn hear_frame(&mut self) -> String {
        loop {
            match self.hear() {
                line if line == "F" => self.say("F00\r"),
                line => return line,
            }
        }
    }
}

/// Opens a bus at an adapter that responds.
fn open(rates: &str) -> (Adapter, OpenBus) {
    let mut adapter = Adapter::new();
    let mut bus = OpenBus::open(&adapter.spec(rates));
    adapter.be_opened();
    bus.wait_for_link(Link::Up);
    (adapter, bus)
}

/// Like `open`, with an adapter that has acknowledged one frame. From then on acknowledgements are
/// waited for, however late they are on a busy machine.
fn open_acknowledging(rates: &str) -> (Adapter, OpenBus) {
    let (mut adapter, mut bus) = open(rates);
    acknowledge_first(&mut adapter, &mut bus);
    (adapter, bus)
}

fn acknowledge_first(adapter: &mut Adapter, bus: &mut OpenBus) {
    bus.send(&Frame::classic(0, &[]));
    assert_eq!(adapter.hear_frame(), "T000000000");
    adapter.say("z\rt7770\r");
    let last = CanId::Standard(0x777);
    bus.wait_until("a mark", |bus| bus.frames.iter().any(|frame| frame.id == last));
    bus.frames.clear();
}

/// Opens a bus at an adapter that never responds.
fn open_mute(rates: &str) -> (Adapter, OpenBus) {
    let mut adapter = Adapter::new();
    let mut bus = OpenBus::open(&adapter.spec(rates));
    adapter.hear_until("O");
    bus.wait_for_link(Link::Up);
    (adapter, bus)
}

fn is_setup(line: &str) -> bool {
    line.len() <= 2 && line.starts_with(['C', 'V', 'N', 'S', 'Y', 'O', 'L'])
}

#[test]
fn adapter_is_set_up_in_order_and_closed() {
    let (mut adapter, mut bus) = open("@500000");
    let setup = ["C", "V", "N", "S6", "O"].map(String::from);
    assert_eq!(adapter.heard, setup);
    let status = bus.wait_for_link(Link::Up);
    assert_eq!((status.bitrate, status.fd, status.listen_only), (Some(500_000), false, false));
    assert_eq!(status.fault, None);
    assert_eq!(status.note.as_deref(), Some("adapter: V1013 NA123"));
    drop(bus);
    adapter.hear_until("C");
}

#[test]
fn missing_bit_rate_keeps_the_adapters_own() {
    let (adapter, bus) = open("");
    assert!(!adapter.heard.iter().any(|line| line.starts_with('S')), "{:?}", adapter.heard);
    let status = bus.status();
    assert_eq!(status.bitrate, None);
    let note = status.note.unwrap();
    assert!(note.contains("bit rate kept (unknown)"), "{note}");
}

#[test]
fn frames_of_every_kind_are_received() {
    let (mut adapter, mut bus) = open("@500000");
    let fd = "5A".repeat(64);
    adapter.say("t1230\rt45631122");
    adapter.say("33\rT12abcdef2AA55\rr1234\rR000001230\r");
    adapter.say(&format!("d1239{}\rB1ABCDEF0F{fd}\r", "01".repeat(12)));
    let mut standard_fd = Frame::new(CanId::Standard(0x123), &[1; 12]);
    standard_fd.is_fd = true;
    let expected = [
        Frame::new(CanId::Standard(0x123), &[]),
        Frame::new(CanId::Standard(0x456), &[0x11, 0x22, 0x33]),
        Frame::classic(0x12AB_CDEF, &[0xAA, 0x55]),
        Frame::remote(CanId::Standard(0x123), 4),
        Frame::remote(CanId::Extended(0x123), 0),
        standard_fd,
        Frame::fd(0x1ABC_DEF0, &[0x5A; 64], 0),
    ];
    let frames = bus.wait_for_frames(expected.len());
    for (frame, expected) in frames.iter().zip(expected) {
        assert_eq!(*frame, expected.with_time(frame.time).with_bus(BusIndex(3)));
    }
    assert!(bus.frames.is_sorted_by_key(|frame| frame.time));
    assert!(bus.frames.iter().all(|frame| frame.time <= bus.clock.now()));
    assert_eq!(bus.status().unreadable, 0);
}

#[test]
fn frames_of_every_kind_are_sent() {
    let (mut adapter, bus) = open("@500000/2000000");
    let mut slow_fd = Frame::new(CanId::Standard(0x7FF), &[9; 16]);
    slow_fd.is_fd = true;
    for (frame, line) in [
        (Frame::new(CanId::Standard(0x12), &[1, 2]), "t01220102".to_owned()),
        (Frame::classic(0x0201_5402, b"\x04DES\x01"), "T0201540250444455301".to_owned()),
        (Frame::remote(CanId::Standard(0x123), 8), "r1238".to_owned()),
        (Frame::remote(CanId::Extended(5), 0), "R000000050".to_owned()),
        (slow_fd, format!("d7FFA{}", "09".repeat(16))),
        (Frame::fd(0x1ABC_DEF0, &[7; 33], 0xCC), {
            format!("B1ABCDEF0E{}{}", "07".repeat(33), "CC".repeat(15))
        }),
    ] {
        bus.send(&frame);
        assert_eq!(adapter.hear_frame(), line);
        adapter.say("z\r");
    }
    assert!(adapter.heard.contains(&"Y2".to_owned()), "{:?}", adapter.heard);
    assert!(bus.status().fd);
}

#[test]
fn fd_frames_are_not_sent_without_known_fd_support() {
    let (mut adapter, mut bus) = open("@500000");
    bus.send(&Frame::fd(1, &[0; 12], 0));
    bus.send(&Frame::classic(2, &[]));
    assert_eq!(adapter.hear_frame(), "T000000020");
    let status = bus.wait_for_status("a failure", |status| status.transmit_failures == 1);
    assert!(
        status.note.as_ref().is_some_and(|note| note.contains("@500000/2000000")),
        "{status:?}"
    );
}

#[test]
fn acknowledged_frame_is_reported_as_tx() {
    let (mut adapter, mut bus) = open_acknowledging("@500000");
    let frames: Vec<_> = (1..=3).map(|id| Frame::classic(id, &[id as u8])).collect();
    for frame in &frames {
        bus.send(frame);
    }
    for id in 1..=3 {
        assert_eq!(adapter.hear_frame(), format!("T0000000{id}10{id}"));
    }
    bus.wait_for_status("three under way", |status| status.unconfirmed == 3);
    assert_eq!(bus.frames, []);
    // The three kinds of positive response in sequence, between received frames.
    adapter.say("z\rT000000050\r");
    bus.wait_for_frames(2);
    adapter.say("\r");
    bus.wait_for_frames(3);
    adapter.say("T000000060\rZ\r");
    let seen: Vec<_> =
        bus.wait_for_frames(5).iter().map(|it| (it.platform_id(), it.is_tx)).collect();
    let ours = |id| (Some(id), true);
    let others = |id| (Some(id), false);
    assert_eq!(seen, [ours(1), others(5), ours(2), others(6), ours(3)]);
    assert_eq!(bus.status().unconfirmed, 0);
}

#[test]
fn rejected_frame_is_counted_and_not_requeued() {
    let (mut adapter, mut bus) = open_acknowledging("@500000");
    for id in 1..=2 {
        bus.send(&Frame::classic(id, &[]));
        adapter.hear_frame();
        adapter.say(if id == 1 { "\x07" } else { "z\r" });
        bus.wait_for_status("an answer", |status| status.unconfirmed == 0);
    }
    let frames = bus.wait_for_frames(1);
    assert_eq!((frames.len(), frames[0].platform_id()), (1, Some(2)));
    assert_eq!(bus.status().transmit_failures, 1);
}

#[test]
fn adapter_without_replies_is_used() {
    let (mut adapter, mut bus) = open_mute("@125000");
    let setup: Vec<_> = adapter.heard.iter().rev().take(2).collect();
    assert_eq!(setup, ["O", "S4"]);
    let note = bus.status().note.unwrap();
    assert!(note.contains("written counts as sent"), "{note}");
    bus.send(&Frame::classic(0x123, &[1]));
    adapter.hear_until("T00000123101");
    let frame = bus.wait_for_frames(1)[0];
    assert_eq!(
        frame,
        Frame::classic(0x123, &[1]).with_tx().with_time(frame.time).with_bus(BusIndex(3))
    );
    adapter.say("t1230\r");
    bus.wait_for_frames(2);
}

#[test]
fn adapter_without_frame_acks_is_detected() {
    let (mut adapter, mut bus) = open("@500000");
    bus.send(&Frame::classic(1, &[]));
    adapter.hear_frame();
    assert!(bus.wait_for_frames(1)[0].is_tx);
    bus.send(&Frame::classic(2, &[]));
    assert!(bus.wait_for_frames(2)[1].is_tx);
}

#[test]
fn late_replies_are_matched_to_their_commands() {
    let mut adapter = Adapter::new();
    let mut bus = OpenBus::open(&adapter.spec("@250000"));
    // Three requests without a response, then six responses at once, none of them to S or O.
    for _ in 0..3 {
        adapter.hear_until("V");
    }
    adapter.say("\x07V1013\r\x07V1013\r\x07V1013\r");
    adapter.be_opened();
    let status = bus.wait_for_link(Link::Up);
    assert_eq!((status.bitrate, status.fault), (Some(250_000), None));
    assert!(status.note.unwrap().contains("V1013 NA123"));
}

#[test]
fn adapter_that_wakes_late_is_reopened() {
    let (mut adapter, mut bus) = open_mute("@250000");
    adapter.heard.clear();
    adapter.hear_until("F");
    adapter.say("\x07");
    adapter.be_opened();
    assert!(adapter.heard.contains(&"S5".to_owned()), "{:?}", adapter.heard);
    bus.wait_for_status("its name", |status| {
        status.note.as_deref() == Some("adapter: V1013 NA123")
    });
}

#[test]
fn adapter_rejecting_bit_rate_is_down_and_retried() {
    let mut adapter = Adapter::new();
    let mut bus = OpenBus::open(&adapter.spec("@800000"));
    loop {
        match adapter.hear().as_str() {
            "S7" => break adapter.say("\x07"),
            _ => adapter.say("\r"),
        }
    }
    let status = bus.wait_for_link(Link::Down);
    assert_eq!(status.state, BusState::Down);
    let message = status.fault.unwrap().to_string();
    assert!(message.contains("rejects 800000 bit/s (S7)"), "{message}");
    assert!(!adapter.heard.contains(&"O".to_owned()));
    // Frames sent meanwhile are not queued for later.
    bus.send(&Frame::classic(1, &[]));
    bus.wait_for_status("a failure", |status| status.transmit_failures == 1);
    adapter.be_opened();
    let status = bus.wait_for_link(Link::Up);
    assert_eq!(status.fault, None);
}

#[test]
fn listen_only_opens_with_l_and_sends_nothing() {
    let mut adapter = Adapter::new();
    let mut bus = OpenBus::listen(&adapter.spec("@500000"));
    adapter.be_opened();
    let status = bus.wait_for_link(Link::Up);
    assert!(status.listen_only);
    assert_eq!(bus.port.transmit(&Frame::classic(1, &[])), Err(TransmitError::ListenOnly));
    adapter.say("t1230\r");
    assert!(!bus.wait_for_frames(1)[0].is_tx);
    drop(bus);
    adapter.hear_until("C");
    assert!(adapter.heard.contains(&"L".to_owned()));
    assert!(adapter.heard.iter().all(|line| *line != "O" && (is_setup(line) || line == "F")));
}

#[test]
fn assumed_bit_rate_is_used_to_send_after_a_valid_frame() {
    let mut adapter = Adapter::new();
    let mut bus = OpenBus::listen_first(&adapter.spec("@500000"));
    adapter.be_opened();
    let status = bus.wait_for_link(Link::Up);
    assert!(status.listens_first && status.listen_only, "{status:?}");
    assert!(adapter.heard.contains(&"L".to_owned()) && !adapter.heard.contains(&"O".to_owned()));
    adapter.say("T123456780\r");
    adapter.be_opened();
    let status = bus.wait_for_status("opened to send", |status| !status.listens_first);
    assert_eq!((status.link, status.listen_only), (Link::Up, false));
    assert_eq!(adapter.heard.last().map(String::as_str), Some("O"));
    assert_eq!(bus.wait_for_frames(1).len(), 1);
    bus.send(&Frame::classic(1, &[]));
    assert_eq!(adapter.hear_frame(), "T000000010");
    // Unplugged and plugged in, it may be at another bus.
    adapter.pty.unplug();
    bus.wait_for_link(Link::Unplugged);
    adapter.pty.plug_in();
    adapter.be_opened();
    bus.wait_for_status("listening again", |status| status.listens_first);
}

#[test]
fn garbage_is_counted_and_next_line_is_read() {
    let (mut adapter, mut bus) = open("@500000");
    adapter.pty.write(b"\xFF\x80\x00half a li");
    adapter.pty.write(b"ne\rt12\rT123456789\r");
    adapter.say("t1230\r");
    bus.wait_for_frames(1);
    bus.wait_for_status("three lines", |status| status.unreadable == 3);
    // An unterminated line, longer than the line buffer.
    for _ in 0..100 {
        adapter.pty.write(&[b'5'; 1000]);
    }
    adapter.say("\rt1240\r");
    bus.wait_for_frames(2);
    assert_eq!(bus.status().unreadable, 4);
    assert_eq!(bus.status().link, Link::Up);
}

#[test]
fn flood_is_received_complete_and_in_order() {
    const COUNT: usize = 50_000;
    let (mut adapter, mut bus) = open("@1000000");
    let flood = std::thread::spawn(move || {
        for chunk in 0..COUNT / 100 {
            let lines =
                (0..100).map(|at| format!("T{:08X}8{}\r", chunk * 100 + at, "5A".repeat(8)));
            adapter.say(&lines.collect::<Vec<_>>().concat());
        }
        adapter
    });
    let frames = bus.wait_for_frames(COUNT);
    assert!(frames.iter().zip(0..).all(|(frame, id)| frame.platform_id() == Some(id)));
    let status = bus.status();
    assert_eq!((status.unreadable, status.queue_drops, status.link), (0, 0, Link::Up));
    flood.join().unwrap();
}

#[test]
fn non_slcan_data_is_reported() {
    let (mut adapter, mut bus) = open_mute("@500000");
    for line in 0..20 {
        adapter.say(&format!("$GPGGA,12351{line}\r\n"));
    }
    let status = bus.wait_for_status("twenty lines", |status| status.unreadable == 20);
    let note = status.note.unwrap();
    assert!(note.contains("does not speak slcan"), "{note}");
}

#[test]
fn status_flags_give_state_and_lost_frames() {
    let (mut adapter, mut bus) = open("@500000");
    let mut tell = |flags: &str, state| {
        adapter.hear_until("F");
        adapter.say(flags);
        bus.wait_for_status(flags, |status| status.state == state)
    };
    assert_eq!(tell("F00\r", BusState::ErrorActive).fault, None);
    tell("F04\r", BusState::ErrorWarning);
    let message = tell("FA4\r", BusState::ErrorPassive).fault.unwrap().to_string();
    assert!(message.contains("error-passive; check bit rate"), "{message}");
    let status = tell("F08\r", BusState::ErrorActive);
    assert_eq!((status.controller_overruns, status.fault), (1, None));
    // A flag that stays set is one event.
    tell("F0C\r", BusState::ErrorWarning);
    assert_eq!(tell("F00\r", BusState::ErrorActive).controller_overruns, 1);
    assert_eq!(tell("F01\r", BusState::ErrorActive).unreadable, 0);
    bus.wait_for_status("two", |status| status.controller_overruns == 2);
}

#[test]
fn adapter_without_status_flags_is_polled_once() {
    let (mut adapter, mut bus) = open("@500000");
    adapter.hear_until("F");
    adapter.say("\x07");
    // Sends frames for longer than the interval of flag requests.
    let start = Instant::now();
    while start.elapsed().as_millis() < 2_500 {
        bus.send(&Frame::classic(1, &[]));
        assert_eq!(adapter.hear(), "T000000010");
        adapter.say("z\r");
        bus.wait_for_status("an answer", |status| status.unconfirmed == 0);
    }
    assert_eq!(bus.status().transmit_failures, 0);
}

#[test]
fn adapter_state_reports_set_the_bus_state() {
    let (mut adapter, mut bus) = open("@500000");
    adapter.say("sp128000\re1a\re2bf\r");
    let status = bus.wait_for_status("passive", |it| it.state == BusState::ErrorPassive);
    assert_eq!((status.tec, status.rec), (Some(0), Some(128)));
    assert_eq!(bus.wait_for_frames(2)[0].to_string(), "200000A8#0000001900000000");
    assert_eq!(bus.status().missing_acks, 1);
    adapter.say("sb000256\r");
    let status = bus.wait_for_status("bus-off", |status| status.state == BusState::BusOff);
    assert!(status.fault.unwrap().to_string().contains("bus-off; check wiring"));
    // Flags carry less information.
    adapter.hear_until("F");
    adapter.say("F20\rt1230\r");
    bus.wait_for_frames(3);
    assert_eq!(bus.status().state, BusState::BusOff);
}

#[test]
fn timestamps_are_used_and_separate_frames() {
    let (mut adapter, mut bus) = open("@500000");
    // 59,999 ms, then 5 and 30 ms later, all at once.
    adapter.say("t1230EA5F\r");
    bus.wait_for_frames(1);
    adapter.say("t1240EA5F\rt1250EA5F\r");
    bus.wait_for_frames(3);
    adapter.say("t126100000A\r");
    let frames = bus.wait_for_frames(4);
    assert_eq!(frames[3].data(), [0]);
    assert!(frames.is_sorted_by_key(|frame| frame.time));
    assert_eq!(bus.status().unreadable, 0);
}

#[test]
fn replugged_adapter_resumes() {
    let (mut adapter, mut bus) = open("@500000");
    for round in 1..=2 {
        acknowledge_first(&mut adapter, &mut bus);
        bus.send(&Frame::classic(1, &[]));
        adapter.hear_frame();
        adapter.pty.unplug();
        let status = bus.wait_for_link(Link::Unplugged);
        assert_eq!((status.state, status.unconfirmed), (BusState::Down, 0));
        assert_eq!(status.transmit_failures, round);
        let message = status.fault.unwrap().to_string();
        assert!(message.contains("unplugged; connect it again"), "{message}");
        adapter.pty.plug_in();
        adapter.be_opened();
        let status = bus.wait_for_link(Link::Up);
        assert_eq!((status.fault, status.bitrate), (None, Some(500_000)));
        adapter.say("t1230\r");
        bus.wait_for_frames(1);
    }
}

#[test]
fn adapter_lost_mid_line_leaves_no_partial_frame() {
    let (mut adapter, mut bus) = open("@500000");
    adapter.say("T000000");
    adapter.pty.unplug();
    bus.wait_for_link(Link::Unplugged);
    adapter.pty.plug_in();
    adapter.be_opened();
    adapter.say("t1230\r");
    assert_eq!(bus.wait_for_frames(1)[0].id, CanId::Standard(0x123));
    assert_eq!(bus.status().unreadable, 0);
}

#[test]
fn missing_port_is_waited_for() {
    let mut adapter = Adapter::new();
    adapter.pty.unplug();
    let mut bus = OpenBus::open(&adapter.spec("@500000"));
    let status = bus.wait_for_link(Link::Missing);
    let message = status.fault.unwrap().to_string();
    assert!(message.contains(" not found") && message.contains("tty"), "{message}");
    adapter.pty.plug_in();
    adapter.be_opened();
    bus.wait_for_link(Link::Up);
}

#[test]
fn non_serial_file_is_reported() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let path = file.path().display();
    let mut bus = OpenBus::open(&format!("slcan:{path}"));
    let status = bus.wait_for_link(Link::NotCan);
    assert_eq!(status.fault, Some(Diagnostic::new(format!("{path} is not a serial port"))));
}

#[test]
fn port_in_use_is_waited_for() {
    let (mut adapter, bus) = open("@500000");
    let mut second = OpenBus::open(&adapter.spec("@500000"));
    let message = second.wait_for_link(Link::Down).fault.unwrap().to_string();
    assert!(message.contains("is in use by another program"), "{message}");
    drop(bus);
    adapter.be_opened();
    second.wait_for_link(Link::Up);
}

#[test]
fn adapter_that_reads_nothing_does_not_block() {
    let (adapter, mut bus) = open_mute("@500000");
    // More than the pty and the transmit queue hold.
    let frame = Frame::classic(1, &[0; 8]);
    bus.wait_until("frames that are not sent", |bus| {
        while bus.port.transmit(&frame).is_ok() {}
        bus.status().transmit_failures >= 100
    });
    let status = bus.status();
    assert!(status.unconfirmed > 0 && status.unconfirmed <= 32, "{status:?}");
    assert_eq!(status.link, Link::Up);
    let before = Instant::now();
    drop(bus);
    assert!(before.elapsed() < PATIENCE / 4, "{:?}", before.elapsed());
    drop(adapter);
}

// --- the program -------------------------------------------------------------------------------

/// The program, killed when dropped.
struct Program(Child);

impl Program {
    fn start(arguments: &[&str]) -> Self {
        Self::run(Command::new(env!("CARGO_BIN_EXE_descan")).args(arguments))
    }

    fn run(command: &mut Command) -> Self {
        Self(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts"))
    }

    /// Waits for the exit; returns the exit code and the output.
    fn finish(self) -> (Option<i32>, String, String) {
        let mut child = std::mem::ManuallyDrop::new(self);
        let read = |source: &mut dyn std::io::Read| {
            let mut text = String::new();
            source.read_to_string(&mut text).expect("text");
            text
        };
        let out = read(child.0.stdout.as_mut().expect("piped"));
        let err = read(child.0.stderr.as_mut().expect("piped"));
        (child.0.wait().expect("it ends").code(), out, err)
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = kill(Pid::from_raw(self.0.id().cast_signed()), Signal::SIGTERM);
        let _ = self.0.wait();
    }
}

#[test]
fn simulated_devices_are_found_through_the_port() {
    let (one, other) = (Pty::new(), Pty::new());
    let spec = |pty: &Pty| format!("slcan:{}@125k", pty.path().display());
    let (sim_at, scan_at) = (spec(&one), spec(&other));
    let _bridge = Bridge::between(&one, &other);
    let _sim = Program::start(&["sim", &sim_at]);
    let scan = Program::start(&["scan", &scan_at, "--json", "--file", "/nowhere/des.json"]);
    let (code, out, err) = scan.finish();
    assert_eq!(code, Some(0), "{out} {err}");
    let report: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    let devices = report["devices"].as_array().expect("devices");
    let names: Vec<&str> = devices.iter().filter_map(|device| device["name"].as_str()).collect();
    for name in ["FEED", "SENS", "PSU"] {
        assert!(names.contains(&name), "{names:?} {err}");
    }
    let feed = devices.iter().find(|device| device["name"] == "FEED").unwrap();
    assert_eq!(feed["services_known"], true, "{feed}");
    assert_eq!(report["buses"][0]["bitrate"], 125_000);
}

/// A device with heartbeats ten times as fast as the document says: its tests are over sooner.
const TESTED_BUS: &str = r#"
bitrate = 500000
[profile.heartbeat]
period_ms = 100
[[device]]
name = "FEED"
uid = "BOILER01"
address = { fixed = 10 }
settled = true
services = [["AUGER", "1.0"], ["MOTOR", "1.2"], ["LOG", "2.0"]]
"#;

#[test]
fn good_device_behind_the_port_breaks_no_rule() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, content: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        path.to_str().expect("UTF-8").to_owned()
    };
    let profile = "[services]\nheartbeat = 0x001\ndes = 0x002\n\
                   [heartbeat]\nperiod_ms = 100\nuid_offset = 0\nmode_offset = 6\n";
    let (bus, profile) = (file("bus.toml", TESTED_BUS), file("profile.toml", profile));
    let (one, other) = (Pty::new(), Pty::new());
    let spec = |pty: &Pty| format!("slcan:{}@500k", pty.path().display());
    let (sim_at, proof_at) = (spec(&one), spec(&other));
    let _bridge = Bridge::between(&one, &other);
    let _sim = Program::start(&["sim", &sim_at, "--scenario", &bus]);
    let proof = Program::start(&["prove", &proof_at, "FEED", "--profile", &profile, "--json"]);
    let (code, out, err) = proof.finish();
    assert_eq!(code, Some(0), "{out} {err}");
    let report: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    let rules = report["devices"][0]["rules"].as_array().expect("rules");
    let needs = |it: &serde_json::Value| it["needs"] == "requests" && it["verdict"] != "kept";
    let missing: Vec<_> = rules.iter().filter(|it| needs(it)).collect();
    assert!(missing.is_empty(), "{missing:#?} {err}");
}

#[test]
fn missing_adapter_ends_scan_with_a_remedy() {
    let (code, out, err) = Program::start(&["scan", "slcan:/dev/ttyACM99@500000"]).finish();
    assert_eq!((code, out.as_str()), (Some(3), ""));
    assert!(err.contains("/dev/ttyACM99 not found"), "{err}");
    let (code, _, err) = Program::start(&["scan", "slcan:/dev/ttyACM99@300000"]).finish();
    assert_eq!(code, Some(2));
    assert!(err.contains("125000, 250000, 500000"), "{err}");
}

#[test]
fn silent_adapter_is_not_an_active_bus() {
    let adapter = Pty::new();
    let spec = format!("slcan:{}@500000", adapter.path().display());
    for json in [false, true] {
        let mut arguments = vec!["scan", &spec, "--time", "4", "--file", "/nowhere/des.json"];
        arguments.extend(json.then_some("--json"));
        let (code, out, err) = Program::start(&arguments).finish();
        assert_eq!(code, Some(0), "{out} {err}");
        let said = format!("{spec}: no response from the adapter; check adapter and baud rate");
        assert!(err.contains(&said), "{err}");
        assert_eq!(err.lines().count(), 1, "{err}");
        if json {
            let report: serde_json::Value = serde_json::from_str(&out).expect("JSON");
            let bus = &report["buses"][0];
            assert_eq!((&bus["frames"], bus["address"].is_null()), (&0.into(), true), "{bus}");
        } else {
            assert!(out.contains(", 0 frames, "), "{out}");
        }
    }
}

#[test]
fn adapter_port_is_not_the_controlling_terminal() {
    let mut adapter = Adapter::new();
    // A session leader without a terminal acquires the first one that it opens.
    let spec = adapter.spec("@500000");
    let program =
        Program::run(Command::new("setsid").args([env!("CARGO_BIN_EXE_descan"), "watch", &spec]));
    adapter.be_opened();
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", program.0.id())).unwrap();
    let fields: Vec<&str> = stat.rsplit(") ").next().unwrap().split(' ').collect();
    let (session, terminal) = (fields[3], fields[4]);
    assert_eq!(session, program.0.id().to_string(), "it leads a session: {stat}");
    assert_eq!(terminal, "0", "{stat}");
    drop(program);
    adapter.hear_until("C");
}

#[test]
fn error_passive_adapter_without_ack_uses_no_cpu_time() {
    let mut adapter = Adapter::new();
    let program = Program::start(&["watch", &adapter.spec("@500000")]);
    adapter.be_opened();
    let mut was_sent = false;
    // One flags request a second. Written frames are never acknowledged.
    let mut respond_to_flags = |count| {
        let mut left = count;
        while left > 0 {
            match adapter.hear().as_str() {
                "F" => {
                    adapter.say("F20\r");
                    left -= 1;
                }
                line => was_sent |= line.starts_with('T'),
            }
        }
        was_sent
    };
    assert!(respond_to_flags(3), "a frame waits for its acknowledgement");
    let (ticks_before, before) = (ticks(program.0.id()), Instant::now());
    respond_to_flags(3);
    let used = ticks(program.0.id()) - ticks_before;
    let per_second = nix::unistd::sysconf(nix::unistd::SysconfVar::CLK_TCK).unwrap().unwrap();
    let passed = before.elapsed().as_secs_f64() * per_second as f64;
    assert!(used as f64 * 5.0 < passed, "{used} of {passed:.0} ticks");
}

// --- python-can --------------------------------------------------------------------------------

/// Sends one frame of each kind, then prints what it receives as JSON, a line each.
const PYTHON_CAN: &str = r#"
import can, json, sys
bus = can.Bus(interface="slcan", channel=sys.argv[1], bitrate=500000, sleep_after_open=0)
def message(id, extended, **rest):
    return can.Message(arbitration_id=id, is_extended_id=extended, **rest)
print("open", flush=True)
for line in sys.stdin:
    if line.strip() == "send":
        bus.send(message(0x123, False, data=b"\x01\x02"))
        bus.send(message(0x1ABCDEF0, True, data=bytes(8)))
        bus.send(message(0x7FF, False, is_remote_frame=True, dlc=4))
        bus.send(message(0x1, True, is_remote_frame=True, dlc=0))
        bus.send(message(0x55, False, data=bytes(range(12)), dlc=12, is_fd=True))
        bus.send(message(0x1ABCDEF0, True, data=bytes(64), dlc=64, is_fd=True, bitrate_switch=True))
    else:
        for _ in range(int(line)):
            got = bus.recv(60)
            print(json.dumps([got.arbitration_id, got.is_extended_id, got.is_remote_frame, got.is_fd,
                              got.bitrate_switch, got.dlc, bytes(got.data or b"").hex()]), flush=True)
bus.shutdown()
"#;

#[test]
fn python_can_exchanges_frames_both_ways() {
    let Some(python) = Python::with(&["python-can==4.6.1", "pyserial==3.5"]) else { return };
    let (one, other) = (Pty::new(), Pty::new());
    let mut bus = OpenBus::open(&format!("slcan:{}@500000/2000000", one.path().display()));
    let path = other.path().display().to_string();
    let _bridge = Bridge::between(&one, &other);
    let mut peer = python.start(PYTHON_CAN, &[&path]);
    assert_eq!(peer.read_line(), "open");
    bus.wait_for_link(Link::Up);

    peer.write_line("send");
    let bytes: Vec<u8> = (0..12).collect();
    let mut slow_fd = Frame::new(CanId::Standard(0x55), &bytes);
    slow_fd.is_fd = true;
    let kinds = [
        Frame::new(CanId::Standard(0x123), &[1, 2]),
        Frame::classic(0x1ABC_DEF0, &[0; 8]),
        Frame::remote(CanId::Standard(0x7FF), 4),
        Frame::remote(CanId::Extended(1), 0),
        slow_fd,
        Frame::fd(0x1ABC_DEF0, &[0; 64], 0),
    ];
    let seen = bus.wait_for_frames(kinds.len()).to_vec();
    for (seen, kind) in seen.iter().zip(kinds) {
        assert_eq!(*seen, kind.with_time(seen.time).with_bus(BusIndex(3)));
    }

    // The peer's own setup commands may make the adapter dialogue begin again, which rejects
    // frames.
    let sent = |bus: &OpenBus| bus.frames.iter().filter(|frame| frame.is_tx).count();
    for (count, kind) in kinds.iter().enumerate() {
        while sent(&bus) == count {
            bus.wait_until("the bus", |bus| bus.status().link == Link::Up);
            let failures = bus.status().transmit_failures;
            bus.send(kind);
            bus.wait_until("the frame", |bus| {
                sent(bus) > count || bus.status().transmit_failures > failures
            });
        }
    }
    peer.write_line(&kinds.len().to_string());
    for kind in &kinds {
        let (id, extended) = match kind.id {
            CanId::Standard(id) => (u32::from(id), false),
            CanId::Extended(id) => (id, true),
        };
        let is_remote = kind.kind == descan::frame::FrameKind::Remote;
        let hex = kind.data().iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().concat();
        let expected = serde_json::json!([
            id,
            extended,
            is_remote,
            kind.is_fd,
            kind.bit_rate_switch,
            kind.len(),
            hex
        ]);
        assert_eq!(serde_json::from_str::<serde_json::Value>(&peer.read_line()).unwrap(), expected);
    }
}
