//! socketcand protocol with one server: a state machine without I/O or clock.
//!
//! The greeting, `< open can0 >`, `< rawmode >`, then frames both ways. Each command waits for the
//! response to the one before: older daemons do not accept several commands at once.

use super::message::{MessagePiece, MessageSplitter, ServerMessage, encode, parse};
use crate::bus::faults::{bus_off, no_response, restart_command};
use crate::bus::remote::stream::{Protocol, ProtocolIo};
use crate::bus::remote::tx_echo::Confirmation;
use crate::bus::remote::{RemoteClock, TxEchoTracker};
use crate::diagnostic::Diagnostic;
use crate::error_report::ErrorReport;
use crate::frame::Frame;
use crate::status::{BusState, Link};
use crate::time::{Duration, Instant};

/// Timeout of a response.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(5);
/// Silence after which `< echo >` is sent.
const ECHO_AFTER: Duration = Duration::from_secs(5);
/// Timeout of the loopback of the first frame; then the server is taken to have no loopback. The
/// daemon has none; other servers may.
const FIRST_ECHO_TIMEOUT: Duration = Duration::from_millis(250);

/// State of the protocol with one server.
#[derive(Debug)]
pub struct Socketcand {
    server: String,
    interface: String,
    stage: SocketcandStage,
    splitter: MessageSplitter,
    own: TxEchoTracker,
    /// Converts timestamps of the server's clock.
    stamps: RemoteClock,
    /// Time of the last message received.
    last_message: Instant,
    /// Time of the `< echo >` that has no response yet. It may be sent long after it was due: the
    /// server then still has all the time to respond.
    echo_requested: Option<Instant>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SocketcandStage {
    Greeting,
    Opening,
    Switching,
    Open,
}

impl Socketcand {
    /// Creates the protocol with `server` for its bus `interface`.
    pub fn new(server: &str, interface: &str) -> Self {
        Self {
            server: server.to_owned(),
            interface: interface.to_owned(),
            stage: SocketcandStage::Greeting,
            splitter: MessageSplitter::default(),
            own: TxEchoTracker::new(Confirmation::Unknown, FIRST_ECHO_TIMEOUT),
            stamps: RemoteClock::default(),
            last_message: Instant::ZERO,
            echo_requested: None,
        }
    }

    fn handle_message(&mut self, now: Instant, message: ServerMessage, exchange: &mut ProtocolIo) {
        match (self.stage, message) {
            (SocketcandStage::Greeting, ServerMessage::Hi) => {
                exchange.write(format!("< open {} >", self.interface).as_bytes());
                self.stage = SocketcandStage::Opening;
            }
            (SocketcandStage::Opening, ServerMessage::Ok) => {
                exchange.write(b"< rawmode >");
                self.stage = SocketcandStage::Switching;
            }
            (SocketcandStage::Switching, ServerMessage::Ok) => {
                self.stage = SocketcandStage::Open;
                let status = &mut exchange.status;
                status.link = Link::Up;
                status.state = BusState::Unknown;
                status.fault = None;
            }
            (SocketcandStage::Open, ServerMessage::Frame(frame, stamp)) => {
                let time = stamp.map_or(now, |stamp| self.stamps.local_time(stamp, now));
                self.process_frame(frame.with_time(time), exchange);
            }
            (SocketcandStage::Open, ServerMessage::Error(cause)) => {
                exchange.status.transmit_failures += 1;
                exchange.status.note = Some(format!("{}: {cause}", self.server));
            }
            (_, ServerMessage::Error(cause)) => {
                let (server, interface) = (&self.server, &self.interface);
                let fault = match self.stage {
                    SocketcandStage::Switching => {
                        Diagnostic::new(format!("{server} does not support raw mode: {cause}"))
                    }
                    _ => Diagnostic::new(format!("{server} rejects {interface}: {cause}"))
                        .with_remedy(format!("export it there: socketcand -i {interface}")),
                };
                exchange.disconnect(Link::Down, fault);
            }
            // Frames received during a mode change, and repeated responses.
            _ => {}
        }
    }

    fn process_frame(&mut self, mut frame: Frame, exchange: &mut ProtocolIo) {
        if let Some(report) = ErrorReport::of(&frame) {
            // The server omits the details, so only bus-off is known of the state.
            if report.is_bus_off() {
                exchange.status.state = BusState::BusOff;
                let remedy = format!(
                    "check wiring and bit rate, then restart it there: {}",
                    restart_command(&self.interface)
                );
                let name = format_args!("{} at {}", self.interface, self.server);
                exchange.status.fault = Some(bus_off(name, remedy));
            }
        } else if exchange.status.state == BusState::BusOff {
            exchange.status.state = BusState::Unknown;
            exchange.status.fault = None;
        }
        frame.is_tx =
            self.own.confirmation() != Confirmation::Never && self.own.confirm_equal(&frame);
        exchange.frames.push(frame);
        self.count_own(exchange);
    }

    fn count_own(&self, exchange: &mut ProtocolIo) {
        exchange.status.unconfirmed = self.own.in_flight();
    }

    fn disconnect_silent(&self, exchange: &mut ProtocolIo) {
        let server = &self.server;
        let fault = match self.stage {
            SocketcandStage::Greeting => Diagnostic::new(format!("no greeting from {server}"))
                .with_remedy("check that it is socketcand"),
            SocketcandStage::Open => Diagnostic::new(format!("{server} stopped responding")),
            _ => no_response(server),
        };
        exchange.disconnect(Link::Down, fault);
    }
}

impl Protocol for Socketcand {
    fn begin(&mut self, now: Instant, _: &mut ProtocolIo) {
        *self = Self::new(&self.server, &self.interface);
        self.last_message = now;
    }

    fn handle_input(&mut self, now: Instant, bytes: &[u8], exchange: &mut ProtocolIo) {
        let mut splitter = std::mem::take(&mut self.splitter);
        splitter.feed(bytes, |piece| {
            let message = match piece {
                MessagePiece::Message(content) => parse(content),
                MessagePiece::Unreadable => None,
            };
            match message {
                Some(message) => {
                    self.last_message = now;
                    self.echo_requested = None;
                    self.handle_message(now, message, exchange);
                }
                None => exchange.status.unreadable += 1,
            }
        });
        self.splitter = splitter;
    }

    fn handle_written(&mut self, now: Instant, total: u64, exchange: &mut ProtocolIo) {
        self.own.written(now, total, &mut exchange.frames);
        self.count_own(exchange);
    }

    fn handle_timeout(&mut self, now: Instant, exchange: &mut ProtocolIo) {
        let given_up = self.own.handle_timeout(now, &mut exchange.frames);
        if given_up > 0 {
            // The loopback may have been an equal frame of another node.
            exchange.status.transmit_failures += given_up;
            self.own.set_confirmation(Confirmation::Unknown);
            // This may make further frames due.
            self.own.handle_timeout(now, &mut exchange.frames);
        }
        self.count_own(exchange);
        let silence = now.since(self.last_message);
        match (self.stage, self.echo_requested) {
            (SocketcandStage::Open, None) if silence >= ECHO_AFTER => {
                self.echo_requested = Some(now);
                exchange.write(b"< echo >");
            }
            (SocketcandStage::Open, Some(at)) if now.since(at) >= RESPONSE_TIMEOUT => {
                self.disconnect_silent(exchange);
            }
            (SocketcandStage::Open, _) => {}
            _ if silence >= RESPONSE_TIMEOUT => self.disconnect_silent(exchange),
            _ => {}
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let response = match (self.stage, self.echo_requested) {
            (SocketcandStage::Open, Some(at)) => at + RESPONSE_TIMEOUT,
            (SocketcandStage::Open, None) => self.last_message + ECHO_AFTER,
            _ => self.last_message + RESPONSE_TIMEOUT,
        };
        [Some(response), self.own.poll_timeout()].into_iter().flatten().min()
    }

    fn has_room(&self) -> bool {
        self.stage == SocketcandStage::Open && self.own.has_room()
    }

    fn send(&mut self, _: Instant, frame: &Frame, exchange: &mut ProtocolIo) {
        let Some(message) = encode(frame) else {
            exchange.status.transmit_failures += 1;
            if frame.is_fd {
                let note = "FD frames not sent: not supported by socketcand";
                exchange.status.note = Some(note.to_owned());
            }
            return;
        };
        let end = exchange.write(message.as_bytes());
        self.own.push(frame, end);
        self.count_own(exchange);
    }

    fn end(&mut self, _: &mut ProtocolIo) {}

    fn break_off(&mut self) -> u64 {
        self.own.clear()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::remote::stream::bench;

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    struct SocketcandTest {
        server: Socketcand,
        exchange: ProtocolIo,
    }

    impl SocketcandTest {
        fn open() -> Self {
            let mut test = Self {
                server: Socketcand::new("host:29536", "can0"),
                exchange: ProtocolIo::default(),
            };
            test.server.begin(at(0), &mut test.exchange);
            assert_eq!(test.handle_message(1, "< hi >"), "< open can0 >");
            assert_eq!(test.handle_message(2, "< ok >"), "< rawmode >");
            assert_eq!(test.handle_message(3, "< ok >"), "");
            assert_eq!(test.exchange.status.link, Link::Up);
            test
        }

        fn handle_message(&mut self, millis: u64, text: &str) -> String {
            self.server.handle_input(at(millis), text.as_bytes(), &mut self.exchange);
            self.sent()
        }

        fn pass(&mut self, until: u64) -> String {
            bench::pass(&mut self.server, &mut self.exchange, at(until));
            self.sent()
        }

        fn sent(&mut self) -> String {
            String::from_utf8(self.exchange.take_output()).unwrap()
        }

        fn send(&mut self, millis: u64, frame: &Frame) {
            self.server.send(at(millis), frame, &mut self.exchange);
            let total = self.exchange.write(b"");
            self.server.handle_written(at(millis), total, &mut self.exchange);
        }
    }

    #[test]
    fn silent_server_is_probed_then_disconnected() {
        let mut test = SocketcandTest::open();
        assert_eq!(test.pass(5_002), "");
        assert_eq!(test.pass(5_003), "< echo >");
        assert_eq!(test.handle_message(6_000, "< echo >"), "");
        assert_eq!(test.pass(11_000), "< echo >");
        assert_eq!(test.exchange.broken, None);
        test.pass(16_000);
        let away = test.exchange.broken.unwrap();
        assert_eq!(away.fault.to_string(), "host:29536 stopped responding");
    }

    #[test]
    fn late_echo_request_has_the_whole_response_timeout() {
        let mut test = SocketcandTest::open();
        // Not called for a minute, as on a suspended computer.
        test.server.handle_timeout(at(60_000), &mut test.exchange);
        assert_eq!(test.sent(), "< echo >");
        test.pass(64_999);
        assert_eq!(test.exchange.broken, None);
        test.pass(65_000);
        assert!(test.exchange.broken.is_some());
    }

    #[test]
    fn server_stopping_during_setup_is_disconnected() {
        for words in [&[][..], &["< hi >"], &["< hi >", "< ok >"]] {
            let mut test = SocketcandTest {
                server: Socketcand::new("host", "can0"),
                exchange: ProtocolIo::default(),
            };
            test.server.begin(at(0), &mut test.exchange);
            for word in words {
                test.handle_message(1, word);
            }
            test.pass(4_999);
            assert_eq!(test.exchange.broken, None);
            test.pass(5_001);
            assert_eq!(test.exchange.broken.map(|away| away.link), Some(Link::Down));
        }
    }

    #[test]
    fn loopback_is_generated_if_server_sends_none() {
        let mut test = SocketcandTest::open();
        let frame = Frame::classic(0x123, &[1]);
        test.send(100, &frame);
        test.pass(349);
        assert_eq!(test.exchange.frames, []);
        test.pass(350);
        assert_eq!(test.exchange.frames, [frame.with_tx().with_time(at(350))]);
        test.send(400, &frame);
        assert_eq!(test.exchange.frames.len(), 2);
        // An equal frame of another node.
        test.handle_message(401, "< frame 00000123 1.0 01 >");
        assert!(!test.exchange.frames[2].is_tx);
    }

    #[test]
    fn server_loopback_is_not_duplicated() {
        let mut test = SocketcandTest::open();
        let frame = Frame::classic(0x123, &[1]);
        for sent in [100, 1_000, 2_000] {
            test.send(sent, &frame);
            test.handle_message(sent + 10, "< frame 00000123 1.0 01 >");
            test.pass(sent + 800);
        }
        let ours = test.exchange.frames.iter().filter(|frame| frame.is_tx).count();
        assert_eq!((ours, test.exchange.frames.len()), (3, 3));
        // A missing loopback is a transmit failure; then the loopback is undecided again.
        test.send(3_000, &frame);
        test.handle_message(5_000, "< echo >");
        test.pass(8_000);
        assert_eq!(test.exchange.status.transmit_failures, 1);
        test.send(8_000, &frame);
        test.pass(8_250);
        assert_eq!(test.exchange.frames.len(), 4);
    }

    #[test]
    fn frame_given_up_leaves_no_deadline_in_the_past() {
        let mut test = SocketcandTest::open();
        let frame = Frame::classic(0x123, &[1]);
        test.send(100, &frame);
        test.handle_message(110, "< frame 00000123 1.0 01 >");
        // The server has stopped its loopback; the second frame is newer than the first.
        test.send(3_000, &frame);
        test.handle_message(4_000, "< echo >");
        test.send(5_000, &frame);
        test.handle_message(7_000, "< echo >");
        test.pass(8_000);
        assert_eq!(test.exchange.status.transmit_failures, 1);
        assert_eq!(test.exchange.frames.len(), 2);
        assert!(test.server.poll_timeout() > Some(at(8_000)));
    }

    #[test]
    fn bus_off_is_a_state_until_frames_come() {
        let mut test = SocketcandTest::open();
        test.handle_message(10, "< error 040 1.0 >");
        assert_eq!(test.exchange.status.state, BusState::BusOff);
        test.handle_message(20, "< error 100 1.1 >< frame 123 1.2 11 >");
        assert_eq!(test.exchange.status.state, BusState::Unknown);
        assert_eq!(test.exchange.status.fault, None);
        assert_eq!(test.exchange.frames.len(), 3);
    }
}
