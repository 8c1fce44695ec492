//! What is said to a socketcand server, and what its answers mean.
//!
//! A state machine without I/O or clock: the greeting, `< open can0 >`, `< rawmode >`, then
//! frames both ways. Each command waits for the answer to the one before, for the daemon takes
//! commands that come together only in its newer versions.

use super::message::{MessagePiece, MessageSplitter, ServerMessage, encode, parse};
use crate::bus::remote::stream::{Protocol, ProtocolIo};
use crate::bus::remote::tx_echo::Confirmation;
use crate::bus::remote::{RemoteClock, TxEchoTracker};
use crate::error_report::ErrorReport;
use crate::frame::Frame;
use crate::status::{BusState, Link};
use crate::time::{Duration, Instant};

/// How long an answer may take.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(5);
/// After so long a silence the server is asked whether it is still there.
const ASK_AFTER: Duration = Duration::from_secs(5);
/// How long the first frame may take to come back before we believe that none does. The daemon
/// gives none of ours back; others may.
const FIRST_FRAME: Duration = Duration::from_millis(250);

/// The dialogue with one server.
#[derive(Debug)]
pub(super) struct Socketcand {
    server: String,
    interface: String,
    stage: SocketcandStage,
    splitter: MessageSplitter,
    own: TxEchoTracker,
    /// The server's clock: its stamps count as differences alone, for the two clocks need not
    /// agree.
    stamps: RemoteClock,
    /// When the last word came.
    heard: Instant,
    /// It was asked whether it is there.
    asked: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SocketcandStage {
    Greeting,
    Opening,
    Switching,
    Open,
}

impl Socketcand {
    pub fn new(server: &str, interface: &str) -> Self {
        Self {
            server: server.to_owned(),
            interface: interface.to_owned(),
            stage: SocketcandStage::Greeting,
            splitter: MessageSplitter::default(),
            own: TxEchoTracker::new(Confirmation::Unknown, FIRST_FRAME),
            stamps: RemoteClock::default(),
            heard: Instant::ZERO,
            asked: false,
        }
    }

    fn hear(&mut self, now: Instant, message: ServerMessage, exchange: &mut ProtocolIo) {
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
                status.message = None;
            }
            (SocketcandStage::Open, ServerMessage::Frame(frame, stamp)) => {
                let time = stamp.map_or(now, |stamp| self.stamps.to_local_time(stamp, now));
                self.process_frame(frame.with_time(time), exchange);
            }
            (SocketcandStage::Open, ServerMessage::Error(why)) => {
                exchange.status.transmit_failures += 1;
                exchange.status.note = Some(format!("{}: {why}", self.server));
            }
            (_, ServerMessage::Error(why)) => {
                let (server, interface) = (&self.server, &self.interface);
                let message = match self.stage {
                    SocketcandStage::Switching => {
                        format!("{server} does not support raw mode: {why}")
                    }
                    _ => format!(
                        "{server} rejects {interface}: {why}; is it exported \
                         (socketcand -i {interface})?"
                    ),
                };
                exchange.disconnect(Link::Down, message);
            }
            // What is between two modes, and what was asked twice.
            _ => {}
        }
    }

    fn process_frame(&mut self, mut frame: Frame, exchange: &mut ProtocolIo) {
        if let Some(report) = ErrorReport::of(&frame) {
            // Its details are not passed on, so this is all that is to be had of the state.
            if report.is_bus_off() {
                exchange.status.state = BusState::BusOff;
                exchange.status.message = Some(format!(
                    "{} at {} is bus-off: check wiring and bit rate, then restart it there: sudo \
                     ip link set {} type can restart",
                    self.interface, self.server, self.interface
                ));
            }
        } else if exchange.status.state == BusState::BusOff {
            exchange.status.state = BusState::Unknown;
            exchange.status.message = None;
        }
        frame.is_tx =
            self.own.confirmation() != Confirmation::Never && self.own.confirm_equal(&frame);
        exchange.frames.push(frame);
        self.count_own(exchange);
    }

    fn count_own(&self, exchange: &mut ProtocolIo) {
        exchange.status.unconfirmed = self.own.in_flight();
    }

    fn is_silent(&self, exchange: &mut ProtocolIo) {
        let server = &self.server;
        let message = match self.stage {
            SocketcandStage::Greeting => format!("no greeting from {server}: is it socketcand?"),
            SocketcandStage::Open => format!("{server} stopped responding"),
            _ => format!("no response from {server}"),
        };
        exchange.disconnect(Link::Down, message);
    }
}

impl Protocol for Socketcand {
    fn begin(&mut self, now: Instant, _: &mut ProtocolIo) {
        *self = Self::new(&self.server, &self.interface);
        self.heard = now;
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
                    self.heard = now;
                    self.asked = false;
                    self.hear(now, message, exchange);
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
            // The one that came back was perhaps another's.
            exchange.status.transmit_failures += given_up;
            self.own.set_confirmation(Confirmation::Unknown);
            // This may make further frames due.
            self.own.handle_timeout(now, &mut exchange.frames);
        }
        self.count_own(exchange);
        let silence = now.since(self.heard);
        match self.stage {
            SocketcandStage::Open if self.asked && silence >= ASK_AFTER + RESPONSE_TIMEOUT => {
                self.is_silent(exchange);
            }
            SocketcandStage::Open if !self.asked && silence >= ASK_AFTER => {
                self.asked = true;
                exchange.write(b"< echo >");
            }
            SocketcandStage::Greeting | SocketcandStage::Opening | SocketcandStage::Switching
                if silence >= RESPONSE_TIMEOUT =>
            {
                self.is_silent(exchange);
            }
            _ => {}
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let response = match self.stage {
            SocketcandStage::Open if self.asked => self.heard + ASK_AFTER + RESPONSE_TIMEOUT,
            SocketcandStage::Open => self.heard + ASK_AFTER,
            _ => self.heard + RESPONSE_TIMEOUT,
        };
        [Some(response), self.own.poll_timeout()].into_iter().flatten().min()
    }

    fn has_room(&self) -> bool {
        self.stage == SocketcandStage::Open && self.own.has_room()
    }

    fn send(&mut self, _: Instant, frame: &Frame, exchange: &mut ProtocolIo) {
        let Some(message) = encode(frame) else {
            exchange.status.transmit_failures += 1;
            if frame.fd {
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

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    struct Talk {
        server: Socketcand,
        exchange: ProtocolIo,
    }

    impl Talk {
        fn open() -> Self {
            let mut talk = Self {
                server: Socketcand::new("host:29536", "can0"),
                exchange: ProtocolIo::default(),
            };
            talk.server.begin(at(0), &mut talk.exchange);
            assert_eq!(talk.hear(1, "< hi >"), "< open can0 >");
            assert_eq!(talk.hear(2, "< ok >"), "< rawmode >");
            assert_eq!(talk.hear(3, "< ok >"), "");
            assert_eq!(talk.exchange.status.link, Link::Up);
            talk
        }

        fn hear(&mut self, millis: u64, text: &str) -> String {
            self.server.handle_input(at(millis), text.as_bytes(), &mut self.exchange);
            self.said()
        }

        fn pass(&mut self, until: u64) -> String {
            let mut said = String::new();
            while self.exchange.broken.is_none()
                && let Some(due) = self.server.poll_timeout().filter(|due| *due <= at(until))
            {
                self.server.handle_timeout(due, &mut self.exchange);
                said += &self.said();
                let next = self.server.poll_timeout();
                let is_later = next.is_none_or(|next| next > due);
                assert!(is_later || self.exchange.broken.is_some(), "{next:?} after {due:?}");
            }
            said
        }

        fn said(&mut self) -> String {
            String::from_utf8(self.exchange.take_output()).unwrap()
        }

        fn send(&mut self, millis: u64, frame: &Frame) {
            self.server.send(at(millis), frame, &mut self.exchange);
            let total = self.exchange.write(b"");
            self.server.handle_written(at(millis), total, &mut self.exchange);
        }
    }

    #[test]
    fn a_silent_server_is_asked_and_then_given_up() {
        let mut talk = Talk::open();
        assert_eq!(talk.pass(5_002), "");
        assert_eq!(talk.pass(5_003), "< echo >");
        assert_eq!(talk.hear(6_000, "< echo >"), "");
        assert_eq!(talk.pass(11_000), "< echo >");
        assert_eq!(talk.exchange.broken, None);
        talk.pass(16_000);
        let away = talk.exchange.broken.unwrap();
        assert_eq!(away.message, "host:29536 stopped responding");
    }

    #[test]
    fn a_server_that_stops_in_the_middle_of_the_dialogue_is_given_up() {
        for words in [&[][..], &["< hi >"], &["< hi >", "< ok >"]] {
            let mut talk =
                Talk { server: Socketcand::new("host", "can0"), exchange: ProtocolIo::default() };
            talk.server.begin(at(0), &mut talk.exchange);
            for word in words {
                talk.hear(1, word);
            }
            talk.pass(4_999);
            assert_eq!(talk.exchange.broken, None);
            talk.pass(5_001);
            assert_eq!(talk.exchange.broken.map(|away| away.link), Some(Link::Down));
        }
    }

    #[test]
    fn ours_are_put_back_by_us_where_the_server_does_not() {
        let mut talk = Talk::open();
        let frame = Frame::classic(0x123, &[1]);
        talk.send(100, &frame);
        talk.pass(349);
        assert_eq!(talk.exchange.frames, []);
        talk.pass(350);
        assert_eq!(talk.exchange.frames, [frame.with_tx().with_time(at(350))]);
        talk.send(400, &frame);
        assert_eq!(talk.exchange.frames.len(), 2);
        // Somebody else's, however equal.
        talk.hear(401, "< frame 00000123 1.0 01 >");
        assert!(!talk.exchange.frames[2].is_tx);
    }

    #[test]
    fn ours_that_the_server_gives_back_are_ours_once() {
        let mut talk = Talk::open();
        let frame = Frame::classic(0x123, &[1]);
        for sent in [100, 1_000, 2_000] {
            talk.send(sent, &frame);
            talk.hear(sent + 10, "< frame 00000123 1.0 01 >");
            talk.pass(sent + 800);
        }
        let ours = talk.exchange.frames.iter().filter(|frame| frame.is_tx).count();
        assert_eq!((ours, talk.exchange.frames.len()), (3, 3));
        // One that does not come back any more has not got out; then all is open again.
        talk.send(3_000, &frame);
        talk.hear(5_000, "< echo >");
        talk.pass(8_000);
        assert_eq!(talk.exchange.status.transmit_failures, 1);
        talk.send(8_000, &frame);
        talk.pass(8_250);
        assert_eq!(talk.exchange.frames.len(), 4);
    }

    #[test]
    fn frame_given_up_leaves_no_deadline_in_the_past() {
        let mut talk = Talk::open();
        let frame = Frame::classic(0x123, &[1]);
        talk.send(100, &frame);
        talk.hear(110, "< frame 00000123 1.0 01 >");
        // The server returns no frames any more; the second frame is newer than the first.
        talk.send(3_000, &frame);
        talk.hear(4_000, "< echo >");
        talk.send(5_000, &frame);
        talk.hear(7_000, "< echo >");
        talk.pass(8_000);
        assert_eq!(talk.exchange.status.transmit_failures, 1);
        assert_eq!(talk.exchange.frames.len(), 2);
        assert!(talk.server.poll_timeout() > Some(at(8_000)));
    }

    #[test]
    fn bus_off_is_a_state_until_frames_come() {
        let mut talk = Talk::open();
        talk.hear(10, "< error 040 1.0 >");
        assert_eq!(talk.exchange.status.state, BusState::BusOff);
        talk.hear(20, "< error 100 1.1 >< frame 123 1.2 11 >");
        assert_eq!(talk.exchange.status.state, BusState::Unknown);
        assert_eq!(talk.exchange.status.message, None);
        assert_eq!(talk.exchange.frames.len(), 3);
    }
}
