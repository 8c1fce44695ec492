//! socketcand over the loopback, with servers that behave, misbehave, hang up and come back.
//!
//! The test itself acts as the server, following the daemon's documentation and source.

use crate::common::open_bus::{OpenBus, PATIENCE};
use descan::bus::TransmitError;
use descan::frame::{BusIndex, CanId, Frame, FrameKind};
use descan::status::{BusState, Link};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::AsFd;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// A simulated server.
struct Server {
    listener: TcpListener,
    client: Option<TcpStream>,
    heard: String,
}

impl Server {
    fn new() -> Self {
        Self::at("127.0.0.1:0").expect("a port of the loopback")
    }

    fn at(address: &str) -> std::io::Result<Self> {
        Ok(Self { listener: TcpListener::bind(address)?, client: None, heard: String::new() })
    }

    fn address(&self) -> SocketAddr {
        self.listener.local_addr().unwrap()
    }

    fn spec(&self) -> String {
        format!("socketcand://{}/can0", self.address())
    }

    fn accept(&mut self) {
        // A missing client fails the test instead of blocking it.
        let coming = &mut [PollFd::new(self.listener.as_fd(), PollFlags::POLLIN)];
        let time = PollTimeout::try_from(PATIENCE).expect("milliseconds");
        assert!(poll(coming, time).unwrap() > 0, "nobody calls");
        let (client, _) = self.listener.accept().unwrap();
        client.set_read_timeout(Some(PATIENCE)).unwrap();
        client.set_nodelay(true).unwrap();
        self.heard.clear();
        self.client = Some(client);
    }

    fn say(&mut self, text: &str) {
        self.client.as_mut().expect("a client").write_all(text.as_bytes()).unwrap();
    }

    /// Returns the next message that it receives.
    fn hear(&mut self) -> String {
        loop {
            if let Some(end) = self.heard.find('>') {
                let rest = self.heard.split_off(end + 1);
                return std::mem::replace(&mut self.heard, rest);
            }
            let mut buffer = [0; 4096];
            let count = self.client.as_mut().expect("a client").read(&mut buffer).expect("words");
            assert!(count > 0, "the client has hung up");
            self.heard += std::str::from_utf8(&buffer[..count]).unwrap();
        }
    }

    /// Accepts a client, up to raw mode.
    fn be_opened(&mut self) {
        self.accept();
        self.say("< hi >");
        assert_eq!(self.hear(), "< open can0 >");
        self.say("< ok >");
        assert_eq!(self.hear(), "< rawmode >");
        self.say("< ok >");
    }

    fn hang_up(&mut self) {
        self.client = None;
    }
}

fn open() -> (Server, OpenBus) {
    let mut server = Server::new();
    let mut bus = OpenBus::open(&server.spec());
    server.be_opened();
    bus.wait_for_link(Link::Up);
    (server, bus)
}

#[test]
fn frames_of_every_kind_are_received() {
    let (mut server, mut bus) = open();
    server.say("< frame 1A220344 23.424242 1A22 >< frame 123 23.424243  >\n");
    server.say("< frame 7FF 23.424244 11 22 33 44 55 66 77 88 >< rtr 123 23.424245 4 >");
    server.say("< rtr 00000123 23.424246 0 >< error 020 23.424247 >");
    let expected = [
        Frame::classic(0x1A22_0344, &[0x1A, 0x22]),
        Frame::new(CanId::Standard(0x123), &[]),
        Frame::new(CanId::Standard(0x7FF), &[0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88]),
        Frame::remote(CanId::Standard(0x123), 4),
        Frame::remote(CanId::Extended(0x123), 0),
        Frame::error(0x20, &[]),
    ];
    let frames = bus.wait_for_frames(expected.len());
    for (frame, expected) in frames.iter().zip(expected) {
        assert_eq!(*frame, expected.with_time(frame.time).with_bus(BusIndex(3)));
    }
    let status = bus.status();
    assert_eq!((status.missing_acks, status.unreadable, status.fault), (1, 0, None));
}

#[test]
fn frame_distances_follow_the_server_clock() {
    let (mut server, mut bus) = open();
    server.say("< frame 123 4000000000.000000 00 >");
    bus.wait_for_frames(1);
    server.say("< frame 123 4000000000.000005 01 >< frame 123 4000000000.000007 02 >");
    let frames = bus.wait_for_frames(3).to_vec();
    let after = |at: usize| frames[at].time.since(frames[0].time).as_micros();
    assert_eq!((after(1), after(2)), (5, 7));
    assert!(frames[2].time <= bus.clock.now());
}

#[test]
fn split_messages_are_joined() {
    let mut server = Server::new();
    let mut bus = OpenBus::open(&server.spec());
    server.accept();
    for piece in ["<", " h", "i >"] {
        server.say(piece);
    }
    assert_eq!(server.hear(), "< open can0 >");
    server.say("< ok ");
    server.say(">");
    assert_eq!(server.hear(), "< rawmode >");
    // The first frames come with the response.
    server.say("< ok >< frame 123 1.000000 AA >< fra");
    bus.wait_for_frames(1);
    for byte in "me 124 1.000001 BB >".chars() {
        server.say(&byte.to_string());
    }
    let frames = bus.wait_for_frames(2);
    assert_eq!((frames[1].id, frames[1].data()), (CanId::Standard(0x124), &[0xBB][..]));
    assert_eq!(bus.status().unreadable, 0);
}

#[test]
fn frames_of_every_kind_but_fd_are_sent() {
    let (mut server, mut bus) = open();
    for (frame, message) in [
        (Frame::new(CanId::Standard(0x123), &[1, 0xF1]), "< send 123 2 1 f1 >"),
        (Frame::classic(0x0201_5402, b"\x04DES\x01"), "< send 02015402 5 4 44 45 53 1 >"),
        (Frame::classic(5, &[]), "< send 00000005 0 >"),
        (Frame::remote(CanId::Extended(5), 8), "< sendrtr 00000005 8 >"),
    ] {
        bus.send(&frame);
        assert_eq!(server.hear(), message);
    }
    // The server sends no own frames back.
    let ours = bus.wait_for_frames(4);
    assert!(ours.iter().all(|frame| frame.is_tx));
    assert_eq!(ours[3].kind, FrameKind::Remote);

    bus.send(&Frame::fd(1, &[0; 12], 0));
    let status = bus.wait_for_status("a failure", |status| status.transmit_failures == 1);
    assert!(status.note.is_some_and(|note| note.contains("FD frames not sent")));
}

#[test]
fn listen_only_sends_nothing() {
    let mut server = Server::new();
    let mut bus = OpenBus::listen(&server.spec());
    server.be_opened();
    bus.wait_for_link(Link::Up);
    assert_eq!(bus.port.transmit(&Frame::classic(1, &[])), Err(TransmitError::ListenOnly));
    drop(bus);
    let mut rest = String::new();
    server.client.unwrap().read_to_string(&mut rest).unwrap();
    assert_eq!(rest, "");
}

#[test]
fn unreadable_message_is_counted_and_next_is_read() {
    let (mut server, mut bus) = open();
    server.say("HTTP/1.1 400 Bad Request\r\n");
    server.say("< frame 123 1.0 1 >< frame 1234 1.0 11 >< frame 123 1.0 112233445566778899 >");
    server.say("< frame 123 1.0 11< stat 1 2 3 4 >");
    server.say(&format!("< frame 123 1.0 {} >", "11".repeat(100_000)));
    server.say("< frame 123 1.0 22 >");
    let frame = bus.wait_for_frames(1)[0];
    assert_eq!(frame.data(), [0x22]);
    assert_eq!(bus.status().unreadable, 7);
    assert_eq!(bus.status().link, Link::Up);
}

#[test]
fn endless_message_uses_no_memory() {
    let (mut server, mut bus) = open();
    server.say("< frame 123 1.0 ");
    let digits = "5".repeat(100_000);
    for _ in 0..50 {
        server.say(&digits);
    }
    server.say("< frame 123 1.0 22 >");
    bus.wait_for_frames(1);
    assert_eq!(bus.status().unreadable, 1);
}

#[test]
fn server_rejecting_the_bus_is_retried() {
    let mut server = Server::new();
    let mut bus = OpenBus::open(&server.spec());
    server.accept();
    server.say("< hi >");
    assert_eq!(server.hear(), "< open can0 >");
    server.say("< error could not\x1b[2J open bus >");
    server.hang_up();
    let status = bus.wait_for_link(Link::Down);
    assert_eq!(status.state, BusState::Down);
    let message = status.fault.unwrap().to_string();
    assert!(message.contains("rejects can0: could not\\x1B[2J open bus"), "{message}");
    bus.send(&Frame::classic(1, &[]));
    bus.wait_for_status("a failure", |status| status.transmit_failures == 1);
    server.be_opened();
    let status = bus.wait_for_link(Link::Up);
    assert_eq!((status.state, status.fault), (BusState::Unknown, None));
}

#[test]
fn missing_server_is_waited_for() {
    let server = Server::new();
    let (address, spec) = (server.address(), server.spec());
    drop(server);
    let mut bus = OpenBus::open(&spec);
    let message = bus.wait_for_link(Link::Down).fault.unwrap().to_string();
    assert!(message.contains(&format!("{address}: connection refused")), "{message}");
    let mut server = Server::at(&address.to_string()).expect("the same port");
    server.be_opened();
    bus.wait_for_link(Link::Up);
}

#[test]
fn silent_server_is_disconnected() {
    let mut server = Server::new();
    let mut bus = OpenBus::open(&server.spec());
    server.accept();
    let message = bus.wait_for_link(Link::Down).fault.unwrap().to_string();
    assert!(message.ends_with("; check that it is socketcand"), "{message}");
    server.be_opened();
    bus.wait_for_link(Link::Up);
}

#[test]
fn closed_connection_is_reopened() {
    let (mut server, mut bus) = open();
    for round in 1..=2 {
        server.say("< frame 123 1.0 11 >< frame 12");
        server.hang_up();
        let status = bus.wait_for_link(Link::Unplugged);
        assert_eq!((status.state, status.unconfirmed), (BusState::Down, 0));
        let message = status.fault.unwrap().to_string();
        assert!(message.contains("reconnecting"), "{message}");
        assert_eq!(bus.frames.len(), round);
        server.be_opened();
        bus.wait_for_link(Link::Up);
    }
    assert_eq!(bus.status().unreadable, 0);
}

#[test]
fn server_that_reads_nothing_does_not_block() {
    let (server, mut bus) = open();
    let frame = Frame::classic(1, &[0; 8]);
    let deadline = Instant::now() + PATIENCE;
    bus.wait_until("frames that are not sent", |bus| {
        assert!(Instant::now() < deadline);
        while bus.port.transmit(&frame).is_ok() {}
        bus.status().transmit_failures >= 100
    });
    assert!(bus.status().unconfirmed <= 32, "{:?}", bus.status());
    let before = Instant::now();
    drop(bus);
    assert!(before.elapsed() < PATIENCE / 4);
    drop(server);
}

#[test]
fn close_is_prompt_in_every_server_state() {
    let mut server = Server::new();
    let bus = OpenBus::open(&server.spec());
    server.accept();
    let before = Instant::now();
    drop(bus);
    assert!(before.elapsed() < PATIENCE / 4);
}

#[test]
fn ipv6_address_is_in_brackets() {
    let Ok(mut server) = Server::at("[::1]:0") else {
        let _ = writeln!(std::io::stderr(), "skipped ipv6_stands_in_brackets: no IPv6 here");
        return;
    };
    let mut bus = OpenBus::open(&server.spec());
    server.be_opened();
    bus.wait_for_link(Link::Up);
}

// --- the program -------------------------------------------------------------------------------

/// Runs a server with one bus for all its clients, like the daemon with one interface: it forwards
/// each client's frames to the others, with time stamps of its own clock.
fn serve(listener: TcpListener) {
    let clients: Arc<Mutex<Vec<Sender<String>>>> = Arc::default();
    let start = Instant::now();
    std::thread::spawn(move || {
        for (number, client) in listener.incoming().enumerate() {
            let mut client = client.unwrap();
            client.set_nodelay(true).unwrap();
            let (sender, messages) = channel::<String>();
            sender.send("< hi >".to_owned()).unwrap();
            clients.lock().unwrap().push(sender);
            let mut output = client.try_clone().unwrap();
            std::thread::spawn(move || {
                for message in messages {
                    if output.write_all(message.as_bytes()).is_err() {
                        return;
                    }
                }
            });
            let clients = Arc::clone(&clients);
            std::thread::spawn(move || {
                let mut heard = String::new();
                let mut buffer = [0; 4096];
                while let Ok(count @ 1..) = client.read(&mut buffer) {
                    heard += std::str::from_utf8(&buffer[..count]).unwrap();
                    while let Some(end) = heard.find('>') {
                        let rest = heard.split_off(end + 1);
                        let message = std::mem::replace(&mut heard, rest);
                        let words: Vec<&str> = message.split_whitespace().collect();
                        let all = clients.lock().unwrap();
                        if words[1] != "send" {
                            let answer = if words[1] == "echo" { "< echo >" } else { "< ok >" };
                            all[number].send(answer.to_owned()).unwrap();
                            continue;
                        }
                        let bytes = words[4..words.len() - 1].iter();
                        let bytes = bytes.map(|byte| format!("{byte:0>2}")).collect::<Vec<_>>();
                        let time = start.elapsed();
                        let (seconds, micros) = (time.as_secs() + 77, time.subsec_micros());
                        let (id, bytes) = (words[2], bytes.concat().to_uppercase());
                        let frame = format!("< frame {id} {seconds}.{micros:06} {bytes} >");
                        for (_, other) in all.iter().enumerate().filter(|(at, _)| *at != number) {
                            let _ = other.send(frame.clone());
                        }
                    }
                }
            });
        }
    });
}

/// The program, killed when dropped.
struct Program(Child);

impl Program {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
        command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
        Self(command.spawn().expect("it starts"))
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn read(source: &mut impl Read) -> String {
    let mut text = String::new();
    source.read_to_string(&mut text).expect("text");
    text
}

#[test]
fn simulated_devices_are_found_by_another_client() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let spec = format!("socketcand://{}/can0", listener.local_addr().unwrap());
    serve(listener);
    let _sim = Program::start(&["sim", &spec]);
    let mut scan = Program::start(&["scan", &spec, "--json", "--file", "/nowhere/des.json"]);
    let out = read(scan.0.stdout.as_mut().unwrap());
    let err = read(scan.0.stderr.as_mut().unwrap());
    assert_eq!(scan.0.wait().unwrap().code(), Some(0), "{out} {err}");
    let report: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    let devices = report["devices"].as_array().expect("devices");
    for name in ["FEED", "SENS", "PSU"] {
        let device = devices.iter().find(|device| device["name"] == name);
        let device = device.unwrap_or_else(|| panic!("no {name}: {out} {err}"));
        assert_eq!(device["services_known"], true, "{device}");
    }
}

#[test]
fn missing_server_ends_scan_with_a_remedy() {
    let address = Server::new().address();
    let mut scan = Program::start(&["scan", &format!("socketcand://{address}/can0")]);
    let err = read(scan.0.stderr.as_mut().unwrap());
    assert_eq!(scan.0.wait().unwrap().code(), Some(3));
    assert!(err.contains("connection refused; start socketcand there"), "{err}");
}

#[test]
fn unopened_bus_is_an_error() {
    for (words, cause) in [("", "no response"), ("HTTP/1.1 400 <>< what ><", "unreadable data")] {
        for command in ["scan", "check", "watch"] {
            let mut server = Server::new();
            let spec = server.spec();
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join("des.json");
            std::fs::write(&file, "[]").unwrap();
            let file = file.to_str().unwrap();
            let arguments = [command, &spec, "--time", "1", "--json", "--file", file];
            let mut program = Program::start(&arguments);
            server.accept();
            server.say(words);
            let out = read(program.0.stdout.as_mut().unwrap());
            let err = read(program.0.stderr.as_mut().unwrap());
            assert_eq!((program.0.wait().unwrap().code(), &*out), (Some(3), ""), "{err}");
            assert!(err.contains(&format!("{spec} is not open")), "{err}");
            assert!(err.contains(cause), "{err}");
            assert_eq!(err.lines().count(), 1, "{err}");
        }
    }
}

#[test]
fn unreadable_data_is_shown_and_in_the_report() {
    let bad = "< frame 123 1.0 112233445566778899 >< frame 123 x.0 11 >< frame 123 1.0 11 >";
    for command in ["scan", "scan --json", "watch"] {
        let mut server = Server::new();
        let spec = server.spec();
        let mut arguments: Vec<&str> = command.split(' ').collect();
        arguments.extend([&spec, "--time", "2", "--listen-only", "--file", "/nowhere/des.json"]);
        let mut program = Program::start(&arguments);
        server.be_opened();
        server.say(bad);
        let out = read(program.0.stdout.as_mut().unwrap());
        assert_eq!(program.0.wait().unwrap().code(), Some(0), "{out}");
        match command {
            "scan" => assert!(out.contains(", 0 lost, 2 messages unreadable\n"), "{out}"),
            "watch" => assert_eq!(out.matches("unreadable data received").count(), 1, "{out}"),
            _ => {
                let report: serde_json::Value = serde_json::from_str(&out).expect("JSON");
                assert_eq!(report["buses"][0]["unreadable"], 2, "{out}");
            }
        }
    }
}
