//! Protocols of adapters and servers: an input is what the other end sends, with steps between.
//!
//! Bytes below 0x80 are received; all others are steps, and end a piece of the received bytes:
//!
//! ```text
//! 80 … 9F  time passes (PAUSES)
//! A0 … A5  a frame is sent, if the bus is open and there is room (FRAMES)
//! B0, B1   the output is written: all, or all but its last bytes
//! D0       the stream is opened anew
//! E0 XX    the byte XX is received
//! others   the piece ends
//! ```

use super::choices::Choices;
use super::{Target, assert_printable};
use descan::bus::{Protocol, ProtocolIo, Slcan, SlcanSettings, Socketcand};
use descan::frame::{CanId, Frame, FrameKind};
use descan::status::Link;
use descan::time::{Duration, Instant};

/// An input of target `slcan` begins with a byte of settings.
pub const SLCAN: Target = Target {
    name: "slcan",
    check: |input| {
        let mut choices = Choices::new(input);
        let settings = SlcanSettings {
            bitrate: choices.one_of(&[None, Some(500_000), Some(1)]),
            data_bitrate: choices.one_of(&[None, Some(2_000_000)]),
            listen_only: choices.flag(),
            listens_first: choices.flag(),
        };
        let mut run = Run::new(Slcan::new("dev", settings));
        run.can_send = !settings.listen_only;
        let mut loopback = open_without_responses();
        run.run(&mut choices, |frame| check_written_frame(&mut loopback, frame));
    },
    words: &[
        b"\r",
        b"\r\r",
        b"\x07",
        b"V1013\r",
        b"NA123\r",
        b"F00\r",
        b"F20\r",
        b"F08\r",
        b"z\r",
        b"t0010\r",
        b"t00",
        b"T000000011AA\r",
        b"r1234\r",
        b"d1239",
        b"sa057033\r",
        b"sb000256\r",
        b"e1a\r",
        b"e2bf\r",
        b"t1230EA5F\r",
        b"\r\x80\r\x80\r\x80\r\x80",
        b"\x07\xB0\xA0\xB0",
        b"\x91F00\r",
        b"\xA0\xB0z\r",
        b"\xA1\xB0\x8B",
        b"\x99\x99\x99",
    ],
};

/// Target `socketcand`.
pub const SOCKETCAND: Target = Target {
    name: "socketcand",
    check: |input| {
        let protocol = Socketcand::new("host:29536", "can0");
        Run::new(protocol).run(&mut Choices::new(input), |_| {});
    },
    words: &[
        b"< hi >",
        b"< ok >",
        b"< echo >",
        b"< frame 00000001 1.0  >",
        b"< frame 123 1.2 11 >",
        b"< frame 1ABCDEF0 23.424242 0102030405060708 >",
        b"< rtr 123 2.5 4 >",
        b"< error 040 1.0 >",
        b"< error ",
        b"< error could not open >",
        b"< nok >",
        b"\xA0\xB0",
        b"\xA1\xB0\x8B",
        b"< frame 00000001 1.0 0102 >",
        b"\x98",
        b"\x99",
        b"9223372036854.775807",
    ],
};

/// Milliseconds of the steps 0x80 to 0x9F: around the deadlines of both protocols.
const PAUSES: [u64; 32] = [
    0,
    1,
    2,
    3,
    5,
    10,
    20,
    50,
    100,
    199,
    249,
    250,
    251,
    299,
    300,
    499,
    500,
    999,
    1_000,
    1_001,
    1_200,
    1_500,
    2_000,
    4_999,
    5_000,
    5_001,
    9_999,
    30_000,
    61_000,
    3_600_000,
    86_400_000,
    31_536_000_000,
];
/// Longest pause in which each deadline is handled in time; after a longer one, as of a suspended
/// computer, one call handles all of them.
const MAX_STEPPED_PAUSE: u64 = 30_000;
/// Number of steps 0xA0 to 0xA5.
const FRAMES: u8 = 6;
/// More frames are never in flight.
const MAX_IN_FLIGHT: u64 = 32;
/// The most bytes that one step writes, besides those for each received byte: setup commands, a
/// frame.
const MAX_OUTPUT: usize = 512;

struct Run<P> {
    protocol: P,
    io: ProtocolIo,
    now: Instant,
    can_send: bool,
    /// Frames sent, returned, and lost with their stream.
    sent: u64,
    returned: u64,
    lost: u64,
    /// Bytes of the stream that are written.
    written: u64,
}

impl<P: Protocol> Run<P> {
    fn new(protocol: P) -> Self {
        let mut run = Self {
            protocol,
            io: ProtocolIo::default(),
            now: Instant::ZERO,
            can_send: true,
            sent: 0,
            returned: 0,
            lost: 0,
            written: 0,
        };
        run.protocol.begin(run.now, &mut run.io);
        run
    }

    /// Runs all steps; passes each received frame to `check_frame`.
    fn run(&mut self, choices: &mut Choices<'_>, mut check_frame: impl FnMut(&Frame)) {
        let mut received = Vec::new();
        while !choices.is_over() {
            match choices.byte() {
                byte @ ..0x80 => received.push(byte),
                0xE0 => received.push(choices.byte()),
                step => {
                    self.receive(&mut received, &mut check_frame);
                    self.step(step);
                    self.finish_step(0, &mut check_frame);
                }
            }
        }
        self.receive(&mut received, &mut check_frame);
        self.protocol.end(&mut self.io);
        self.finish_step(0, &mut check_frame);
    }

    fn receive(&mut self, received: &mut Vec<u8>, check_frame: &mut impl FnMut(&Frame)) {
        if !received.is_empty() {
            self.protocol.handle_input(self.now, received, &mut self.io);
            self.handle_timeouts(self.now);
            self.finish_step(received.len(), check_frame);
            received.clear();
        }
    }

    fn step(&mut self, step: u8) {
        match step {
            0x80..=0x9F => {
                let millis = PAUSES[usize::from(step - 0x80)];
                self.now += Duration::from_millis(millis);
                if millis > MAX_STEPPED_PAUSE {
                    self.handle_timeout(self.now);
                }
            }
            0xA0..0xB0 => self.send((step - 0xA0) % FRAMES),
            0xB0 | 0xB1 => {
                let end = self.io.write(b"");
                self.written = self.written.max(end - u64::from(step - 0xB0) * end.min(7));
                self.protocol.handle_written(self.now, self.written, &mut self.io);
            }
            0xD0 => self.open_anew(),
            _ => {}
        }
        self.handle_timeouts(self.now);
    }

    fn send(&mut self, kind: u8) {
        if !self.can_send || self.io.status.link != Link::Up || !self.protocol.has_room() {
            return;
        }
        let frame = match kind {
            0 => Frame::classic(1, &[]),
            1 => Frame::classic(1, &[1, 2]),
            2 => Frame::new(CanId::Standard(0x123), &[0x11]),
            3 => Frame::remote(CanId::Standard(0x123), 4),
            4 => Frame::fd(1, &[7; 12], 0),
            _ => Frame::error(4, &[0; 8]),
        };
        self.protocol.send(self.now, &frame, &mut self.io);
        self.sent += 1;
    }

    /// Does what the thread of a bus does when its stream ended and was opened again.
    fn open_anew(&mut self) {
        self.lost += self.protocol.break_off();
        let mut io = ProtocolIo::default();
        io.status.clone_from(&self.io.status);
        io.status.link = Link::Down;
        io.status.unconfirmed = 0;
        self.io = io;
        self.written = 0;
        self.protocol.begin(self.now, &mut self.io);
    }

    /// Handles all deadlines up to `until`.
    fn handle_timeouts(&mut self, until: Instant) {
        while self.io.broken.is_none()
            && let Some(due) = self.protocol.poll_timeout().filter(|due| *due <= until)
        {
            self.handle_timeout(due);
        }
    }

    /// Handles a deadline; the next one is later, unless the stream is to be closed.
    fn handle_timeout(&mut self, now: Instant) {
        self.protocol.handle_timeout(now, &mut self.io);
        let next = self.protocol.poll_timeout();
        let is_later = next.is_none_or(|next| next > now);
        assert!(is_later || self.io.broken.is_some(), "due at {next:?}, handled until {now:?}");
    }

    /// Checks and drains the results of a step in which `received` bytes were received.
    fn finish_step(&mut self, received: usize, check_frame: &mut impl FnMut(&Frame)) {
        assert!(self.io.frames.len() <= received + MAX_IN_FLIGHT as usize, "too many frames");
        for frame in std::mem::take(&mut self.io.frames) {
            check_shape(&frame);
            assert!(frame.time <= self.now, "{frame:?} at {}", self.now);
            self.returned += u64::from(frame.is_tx);
            if !frame.is_tx {
                check_frame(&frame);
            }
        }
        let output = self.io.take_output();
        assert!(output.len() <= MAX_OUTPUT + 16 * received, "{} bytes written", output.len());
        assert!(output.iter().all(|byte| matches!(byte, b'\r' | b' '..=b'~')), "{output:?}");
        let status = &self.io.status;
        assert!(status.unconfirmed <= MAX_IN_FLIGHT, "{} frames in flight", status.unconfirmed);
        let ended = self.returned + self.lost + status.unconfirmed;
        assert!(ended <= self.sent, "{} frames sent, {ended} came back", self.sent);
        let faults = status.fault.iter().chain(self.io.broken.iter().map(|it| &it.fault));
        faults.for_each(|fault| assert_printable(&fault.to_string()));
        status.note.iter().for_each(|note| assert_printable(note));
        if self.io.broken.take().is_some() {
            self.open_anew();
        }
    }
}

/// Asserts that a frame can exist on a bus.
///
/// # Panics
///
/// If it cannot.
pub fn check_shape(frame: &Frame) {
    let is_valid = match frame.id {
        CanId::Standard(id) => id <= CanId::MAX_STANDARD,
        CanId::Extended(id) => id <= CanId::MAX_EXTENDED,
    };
    let longest = if frame.is_fd { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA };
    assert!(is_valid && frame.len() <= longest, "{frame:?}");
    assert!(!frame.is_fd || frame.kind == FrameKind::Data, "{frame:?}");
}

/// Returns the protocol with an open adapter that confirms nothing and takes FD frames.
fn open_without_responses() -> (Slcan, ProtocolIo) {
    let settings = SlcanSettings { data_bitrate: Some(2_000_000), ..SlcanSettings::default() };
    let (mut slcan, mut io) = (Slcan::new("dev", settings), ProtocolIo::default());
    slcan.begin(Instant::ZERO, &mut io);
    slcan.handle_timeout(Instant::ZERO + Duration::from_secs(2), &mut io);
    assert_eq!(io.status.link, Link::Up);
    io.take_output();
    (slcan, io)
}

/// Asserts that a received frame is the same when it is written and read again.
fn check_written_frame((slcan, io): &mut (Slcan, ProtocolIo), frame: &Frame) {
    if frame.kind == FrameKind::Error {
        return;
    }
    slcan.send(frame.time, frame, io);
    slcan.break_off();
    let line = io.take_output();
    slcan.handle_input(frame.time, &line, io);
    assert_eq!(std::mem::take(&mut io.frames), [*frame], "{line:?}");
}
